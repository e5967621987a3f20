"""The state of a system: plain arrays with named views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from multiarm.dynamics.layout import Layout
from multiarm.errors import ModelError, MultiarmError
from multiarm.notation import count_of
from multiarm.public import public_names
from multiarm.robots.base_motion import BaseMotion
from multiarm.scene.faults import shown

BASE_PARTS = ("position", "quaternion_xyzw", "twist")
"""What is given of a floating base."""


@dataclass(frozen=True, eq=False, repr=False)
class State:
    """Positions and velocities of object and robots.

    With B floating bases, ``n`` counts the joints and six numbers a floating base.

    Attributes
    ----------
    position : ndarray, shape (7 + 7 B + n,)
        The configuration: object's centre of mass [m], its quaternion (xyzw); the same of the
        origins of floating bases; joint positions [rad or m], zero for the six of a floating base.
    velocity : ndarray, shape (6 + n,)
        Object's twist (world axes: velocity of the centre of mass, angular velocity), joint
        velocities.  The twist of a floating base stands before those of its robot's joints.
    layout : Layout
        Where these are in the two vectors.

    The named attributes are views into these two arrays.
    """

    position: np.ndarray
    velocity: np.ndarray
    layout: Layout

    __dir__ = public_names

    def __repr__(self) -> str:
        place = ", ".join(f"{x:.4g}" for x in self.object_position)
        return f"State(object at ({place}) m; {self.layout})"

    @property
    def object_position(self) -> np.ndarray:
        """Centre of mass in world axes, shape (3,) [m]."""
        return self._pose[:3]

    @property
    def object_quaternion_xyzw(self) -> np.ndarray:
        """Orientation of the object, scalar last, shape (4,)."""
        return self._pose[3:]

    @property
    def object_twist(self) -> np.ndarray:
        """Velocity of the centre of mass and angular velocity, world axes, shape (6,)."""
        return self.layout.twists(self.velocity)[0]

    @property
    def joint_positions(self) -> Mapping[str, np.ndarray]:
        """Arm or robot -> joint positions, one number a joint, shape (n_i,).

        Of a robot on a base that moves, the joints of the base come first.
        """
        return MappingProxyType(
            self.layout.split_joints(self.layout.joint_positions(self.position))
        )

    @property
    def joint_velocities(self) -> Mapping[str, np.ndarray]:
        """Arm or robot -> joint velocities, shape (n_i,)."""
        return MappingProxyType(self.layout.split_joints(self.layout.joint_rates(self.velocity)))

    @property
    def bases(self) -> Mapping[str, BaseMotion]:
        """Robot name -> motion of its base, of robots whose base floats."""
        poses, twists = (
            self.layout.base_poses(self.position),
            self.layout.base_twists(self.velocity),
        )
        pairs = zip(self.layout.floating_robots, poses, twists, strict=True)
        return MappingProxyType(
            {self.layout.names[i]: BaseMotion(pose, twist) for i, pose, twist in pairs}
        )

    def copy(self) -> State:
        """An independent copy."""
        return State(self.position.copy(), self.velocity.copy(), self.layout)

    def displaced(self, displacement: np.ndarray) -> State:
        """A copy moved by a shift [m] and a turn [rad] of the object and by joints, (6 + n,).

        Those of a floating base stand before its robot's joints.  World axes; the velocities stay
        as they are.

        Raises
        ------
        ModelError
            A wrong shape, or a number that is not finite.
        """
        from multiarm.dynamics.coordinates import retract  # with Numba, which takes long

        displacement = checked_vector("displacement", displacement, self.layout.nv)
        position = retract(self.layout, self.position, displacement)
        return State(position, self.velocity.copy(), self.layout)

    def displacement_to(self, other: State) -> np.ndarray:
        """The displacement, as of :meth:`displaced`, that leads to another state, (6 + n,).

        Raises
        ------
        ModelError
            For a state of a system with other arms.
        """
        from multiarm.dynamics.coordinates import difference  # as above

        require_same_joints(other, self.layout)
        return difference(self.layout, self.position, other.position)

    @property
    def _pose(self) -> np.ndarray:
        return self.layout.poses(self.position)[0]


def require_same_joints(state: State, layout: Layout) -> None:
    """Refuse a state of a system with other arms.

    Raises
    ------
    ModelError
    """
    if not state.layout.same_joints(layout):
        raise ModelError(
            f"this state belongs to a system with {state.layout.noun} "
            f"{', '.join(state.layout.names)} "
            f"({count_of(state.layout.tree_joint_count, 'joint')}), not to this one; make it with "
            "`system.state(...)`"
        )


def checked_vector(
    what: str, values: Any, size: int, error: type[MultiarmError] = ModelError
) -> np.ndarray:
    """A new vector of a given size with finite numbers, or an error that names ``what``."""
    try:
        vector = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise error(f"{what}: expected {count_of(size, 'number')}, got {shown(values)}") from None
    if vector.shape != (size,):
        raise error(f"{what}: expected shape ({size},), got {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise error(f"{what}: a number is not finite: {shown(vector.tolist())}")
    return vector


def checked_quaternion(what: str, values: Any) -> np.ndarray:
    """A quaternion of four finite numbers that are not all zero, of unit length."""
    quaternion = checked_vector(what, values, 4)
    if np.abs(quaternion).max() > 1e100:  # its square would overflow
        quaternion /= np.abs(quaternion).max()
    norm = np.linalg.norm(quaternion)
    if not norm > 1e-12:
        raise ModelError(f"{what} has length zero")
    return quaternion / norm


def fill_bases(state: State, given: Any) -> None:
    """Write ``given``, a mapping robot -> position, quaternion, twist, into the floating bases.

    Raises
    ------
    ModelError
        An unknown robot or key, a wrong shape, a number that is not finite, a zero quaternion.
    """
    bases, example = state.bases, "bases: {'sat': {'position': 3 numbers [m]}}"
    if not isinstance(given, Mapping):
        raise ModelError(f"bases: must be a dict by robot, such as {example}, got {shown(given)}")
    for robot, motion in given.items():
        if robot not in bases:
            known = f"robots with one are {', '.join(bases)}" if bases else "no robot has one"
            raise ModelError(f"bases: {robot!r} is no robot with a floating base; {known}")
        if not isinstance(motion, Mapping) or motion.keys() - set(BASE_PARTS):
            raise ModelError(
                f"bases[{robot!r}]: must be a dict with some of {', '.join(BASE_PARTS)}, got "
                f"{shown(motion)}"
            )
        for part, values in motion.items():
            where, view = f"bases[{robot!r}][{part!r}]", getattr(bases[robot], part)
            if part == "quaternion_xyzw":
                view[:] = checked_quaternion(where, values)
            else:
                view[:] = checked_vector(where, values, view.size)


def fill_by_arm(
    what: str,
    layout: Layout,
    joints: np.ndarray,
    given: Any,
    error: type[MultiarmError] = ModelError,
) -> None:
    """Write ``given``, a mapping arm or robot -> numbers, into a vector of all joints, (n,)."""
    views, noun = layout.split_joints(joints), layout.noun.removesuffix("s")
    if not isinstance(given, Mapping):
        arm, values = next(iter(views.items()))
        raise error(
            f"{what}: must be a dict with numbers by {noun}, such as {{{arm!r}: {values.size} "
            f"numbers}}, got {shown(given)}"
        )
    for arm, values in given.items():
        if arm not in views:
            raise error(f"{what}: unknown {noun} {arm!r}; {noun}s are {', '.join(views)}")
        views[arm][:] = checked_vector(f"{what}[{arm!r}]", values, views[arm].size, error)
