"""Building the effects of a scene: from its parameters to compiled kernels and their arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.callbacks import UserCallback
from multiarm.dynamics.data import Data
from multiarm.dynamics.effect_kernels import (
    APPLIED,
    EffectKernel,
    EffectProgram,
    set_power,
    view_of_effect,
)
from multiarm.dynamics.layout import Layout
from multiarm.errors import ModelError
from multiarm.jit.kernels import cfunc
from multiarm.jit.pointers import call_python
from multiarm.jit.structs import Floats1, Ints1, struct_at
from multiarm.robots.robot import Robot
from multiarm.scene import EFFECTS, JointOutline, Scene, joint_vector
from multiarm.scene.faults import shown
from multiarm.scene.registry import called


class Link(NamedTuple):
    """A link of an arm or robot on which an effect acts."""

    # index in ``EffectVariables.link_poses`` of the address of its joint's pose: 12 numbers,
    # rotation by columns, origin
    number: int
    # the block of the equations that has the joints which move the link; its row of
    # ``BodyVariables.pointers`` has the address of its Jacobian (columns of 6, world axes, about
    # the world's origin)
    block: int
    first: int  # the block's first joint among all
    chain: np.ndarray  # (d,) the joints that move the link, counted from it, from base to link
    base: int  # how many of these are those of a floating base: the first six, or none
    # the link's frame in the frame of the joint that carries it, (3, 3) and (3,)
    rotation: np.ndarray
    translation: np.ndarray


@dataclass
class BuildContext:
    """The system for which an effect is built.

    Attributes
    ----------
    scene : Scene
    arms : dict of str to Robot
    layout : Layout
        Where each arm's joints and contacts are in stacked vectors.
    outlines : dict of str to tuple of JointOutline
        Each arm's joints as its URDF has them.
    links : list of (int, int)
        Arm and joint of every link that some effect acts on; :meth:`link` adds them.
    """

    scene: Scene
    arms: dict[str, Robot]
    layout: Layout
    outlines: dict[str, tuple[JointOutline, ...]]
    links: list[tuple[int, int]] = field(default_factory=list)

    def stacked(
        self,
        values: Any,
        from_urdf: Callable[[JointOutline], float] | None = None,
        default: float = 0.0,
    ) -> np.ndarray:
        """One number for every joint of all arms; see :func:`joint_numbers`.

        Those of floating bases have the default.
        """
        numbers, layout = np.full(self.layout.rate_count, default), self.layout
        by_arm = joint_numbers(values, self.outlines, from_urdf, default).values()
        for i, of_arm in enumerate(by_arm):
            numbers[layout.tree_joints(i)] = of_arm
        return numbers

    def link(self, arm: str, name: str) -> Link:
        """A link of an arm; its pose will be computed at every evaluation."""
        joint, rotation, translation = self.arms[arm].link(name)
        number, layout = self.layout.names.index(arm), self.layout
        self.links.append((number, joint))
        block, chain = layout.chain_in_block(number, self.arms[arm].chain_of(joint))
        return Link(
            number=len(self.links) - 1,
            block=block,
            first=layout.first_joint_of_block[block],
            chain=chain,
            base=self.arms[arm].base_dof,
            rotation=rotation,
            translation=translation,
        )


def effect_program(context: BuildContext, further: Sequence[EffectKernel] = ()) -> EffectProgram:
    """The kernels of the effects that the scene names, and further ones."""
    effects, kernels = context.scene.effects, [*further]
    for name, spec in effects.named.items():
        if name in effects.with_events:
            continue  # those of contacts and stops are among the further ones
        if name in type(effects).model_fields:
            kernels += import_module(f"multiarm.effects.{name}").build(spec, context)
        else:
            kernels += _user_kernels(name, spec, context)
    return EffectProgram.of(kernels)


class UserLoads(NamedTuple):
    """Loads that a Python function computes."""

    function: Ints1  # (1,) address
    loads: Floats1  # (6 F + n,) its result: generalised forces [N, N m]


open_loads = view_of_effect(UserLoads)


@cfunc
def add_loads(address, size, at, _t):
    """Call the function, and add its loads."""
    struct = struct_at(address, size)
    data, user, power = open_data(struct), open_loads(struct, at), 0.0
    if data.status.failed:
        return 0  # another function failed
    call_python(user.function[0])
    for k in range(user.loads.size):
        data.forces.f[k] += user.loads[k]
        power += user.loads[k] * data.state.velocity[k]
    set_power(struct, at, power)
    return 0


def forces_kernel(
    name: str, make: Callable[[], Callable], read: Callable[[Any], np.ndarray], layout: Layout
) -> EffectKernel:
    """The kernel of an effect whose forces a Python function ``f(t, state)`` computes.

    ``make`` returns the function; it is called once for every Data.  ``read`` returns the result of
    the function as wrenches on the objects and joint torques, shape (6 F + n,).
    """
    arrays = UserLoads(np.zeros(1, dtype=np.int64), np.zeros(layout.nv))

    def connect(data: Data, user: UserLoads) -> dict[str, UserCallback]:
        who = f"the effect {name!r}"
        call = UserCallback(make(), who, read, user.loads, layout, data.arrays, owner=make)
        user.function[0] = call.address
        return {f"effects/{name}": call}

    return EffectKernel(
        name,
        add_loads,
        APPLIED,
        arrays,
        connect=connect,
        calls_user=True,
        knows_state_alone=True,
    )


def joint_numbers(
    values: Any,
    outlines: Mapping[str, Sequence[JointOutline]],
    from_urdf: Callable[[JointOutline], float] | None = None,
    default: float = 0.0,
) -> dict[str, np.ndarray]:
    """One number for every joint, by arm, from a scene's number, list or table.

    ``from_urdf`` gives the number for the text ``urdf``; joints without a name have the default.
    """
    by_arm = {}
    for arm, joints in outlines.items():
        of_arm = values.get(arm) if isinstance(values, Mapping) else values
        if isinstance(of_arm, str):
            assert from_urdf is not None, "a text means the numbers of the URDF"
            by_arm[arm] = np.array([from_urdf(joint) for joint in joints])
        else:
            by_arm[arm] = joint_vector(of_arm, [joint.name for joint in joints], default)
    return by_arm


def _user_kernels(name: str, spec: Any, context: BuildContext) -> list[EffectKernel]:
    """The kernels of a user-defined effect."""
    effect = EFFECTS.find(name)
    assert effect is not None, "it has read its parameters"
    who = f"effects.{name}: build"
    kernels = called(lambda: effect(spec).build(context), who)
    if not isinstance(kernels, list) or not all(isinstance(k, EffectKernel) for k in kernels):
        raise ModelError(
            f"{who} returned {shown(kernels)}; return a list of multiarm.effects.EffectKernel"
        )
    for kernel in kernels:
        kernel.require_usable(who)
    if context.layout.splits_robots:  # what is local in a robot need not be so in its blocks
        kernels = [replace(kernel, local=False) for kernel in kernels]
    return kernels
