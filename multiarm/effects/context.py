"""What an effect is built into, and numbers for every joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.dynamics.state import Layout
from multiarm.scene import JointOutline, Scene, joint_vector


class Link(NamedTuple):
    """A link of an arm on which an effect acts.

    number : int
        Place of the address of its joint's pose in ``Variables.link_poses``: 12 numbers, rotation
        by columns, origin.
    arm : int
        The arm's number; ``Variables.pointers[arm, J_AT]`` is the address of its Jacobian (columns
        of 6, world axes, about the world's origin).
    first, joints : int
        The arm's first joint among all, and how many of them carry the link.
    rotation, translation : (3, 3), (3,)
        The link's frame in the frame of the joint that carries it.
    """

    number: int
    arm: int
    first: int
    joints: int
    rotation: np.ndarray
    translation: np.ndarray


@dataclass(frozen=True)
class BuildContext:
    """What an effect is built into.

    Attributes
    ----------
    scene : Scene
    arms : dict of str to Arm
    layout : Layout
        Where each arm's joints and contacts are in stacked vectors.
    outlines : dict of str to tuple of JointOutline
        Each arm's joints as its URDF has them.
    links : list of (int, int)
        Arm and joint of every link that some effect acts on.
    """

    scene: Scene
    arms: dict[str, Arm]
    layout: Layout
    outlines: dict[str, tuple[JointOutline, ...]]
    links: list[tuple[int, int]] = field(default_factory=list)

    def stacked(
        self,
        values: Any,
        from_urdf: Callable[[JointOutline], float] | None = None,
        default: float = 0.0,
    ) -> np.ndarray:
        """One number for every joint of all arms; see :func:`joint_numbers`."""
        return np.concatenate(
            list(joint_numbers(values, self.outlines, from_urdf, default).values())
        )

    def link(self, arm: str, name: str) -> Link:
        """A link of an arm, whose pose is then computed at every evaluation."""
        joint, rotation, translation = self.arms[arm].link(name)
        number = self.layout.names.index(arm)
        self.links.append((number, joint))
        return Link(
            number=len(self.links) - 1,
            arm=number,
            first=self.layout.dofs[number],
            joints=joint,
            rotation=rotation,
            translation=translation,
        )


def joint_numbers(
    values: Any,
    outlines: Mapping[str, Sequence[JointOutline]],
    from_urdf: Callable[[JointOutline], float] | None = None,
    default: float = 0.0,
) -> dict[str, np.ndarray]:
    """One number for every joint, by arm, from a scene's number, list or table.

    ``from_urdf`` finds the number where ``urdf`` stands for it; joints that are not named have
    the default.
    """
    found = {}
    for name, joints in outlines.items():
        own = values.get(name) if isinstance(values, Mapping) else values
        if isinstance(own, str):
            assert from_urdf is not None, "a text stands for the robot's own numbers"
            found[name] = np.array([from_urdf(joint) for joint in joints])
        else:
            found[name] = joint_vector(own, [joint.name for joint in joints], default)
    return found
