"""The state of a system: plain arrays with named views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from multiarm.dynamics.layout import Layout
from multiarm.errors import ModelError, MultiarmError
from multiarm.geometry.frame_motion import FrameMotion
from multiarm.notation import count_of
from multiarm.public import public_names
from multiarm.scene.faults import counted, shown, unknown

OfObject = TypeVar("OfObject")
FRAME_PARTS = ("position", "quaternion_xyzw", "twist")
"""What is given of an object or a floating base."""


@dataclass(frozen=True, eq=False, repr=False)
class State:
    """Positions and velocities of objects and robots.

    With F objects and B floating bases, ``n`` counts the joints and six numbers a floating base.

    Attributes
    ----------
    position : ndarray, shape (7 F + 7 B + n,)
        The configuration: centre of mass [m] and quaternion (xyzw) of each object; the same of the
        origins of floating bases; joint positions [rad or m], zero for the six of a floating base.
    velocity : ndarray, shape (6 F + n,)
        Twists of the objects (world axes: velocity of the centre of mass, angular velocity), joint
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
        places = [
            f"{name} at ({', '.join(f'{x:.4g}' for x in moving.position)}) m"
            for name, moving in self.objects.items()
        ]
        return f"State({counted(places, 4)}; {self.layout})"

    @property
    def object_position(self) -> np.ndarray:
        """Centre of mass in world axes, shape (3,) [m]."""
        return self._only_object.position

    @property
    def object_quaternion_xyzw(self) -> np.ndarray:
        """Orientation of the object, scalar last, shape (4,)."""
        return self._only_object.quaternion_xyzw

    @property
    def object_twist(self) -> np.ndarray:
        """Velocity of the centre of mass and angular velocity, world axes, shape (6,)."""
        return self._only_object.twist

    @property
    def objects(self) -> Mapping[str, FrameMotion]:
        """Object -> its motion, that of the centre of mass."""
        poses, twists = self.layout.poses(self.position), self.layout.twists(self.velocity)
        motions = map(FrameMotion, poses, twists)
        return MappingProxyType(dict(zip(self.layout.objects, motions, strict=True)))

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
    def bases(self) -> Mapping[str, FrameMotion]:
        """Robot name -> motion of its base, of robots whose base floats."""
        poses, twists = (
            self.layout.base_poses(self.position),
            self.layout.base_twists(self.velocity),
        )
        pairs = zip(self.layout.floating_robots, poses, twists, strict=True)
        return MappingProxyType(
            {self.layout.names[i]: FrameMotion(pose, twist) for i, pose, twist in pairs}
        )

    def copy(self) -> State:
        """An independent copy."""
        return State(self.position.copy(), self.velocity.copy(), self.layout)

    def displaced(self, displacement: np.ndarray) -> State:
        """A copy moved by a shift [m] and a turn [rad] of each object and by joints, (6 F + n,).

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
        """The displacement, as of :meth:`displaced`, that leads to another state, (6 F + n,).

        Raises
        ------
        ModelError
            For a state of a system with other arms.
        """
        from multiarm.dynamics.coordinates import difference  # as above

        require_same_joints(other, self.layout)
        return difference(self.layout, self.position, other.position)

    @property
    def _only_object(self) -> FrameMotion:
        """The motion of the object, where there is one."""
        return only_object("objects", self.objects)


def only_object(name: str, by_object: Mapping[str, OfObject]) -> OfObject:
    """What the attribute ``name`` has of the object, where there is one.

    Raises
    ------
    ModelError
        Where there are several.
    """
    if len(by_object) > 1:
        first = next(iter(by_object))
        raise ModelError(
            f"there are {len(by_object)} objects, {', '.join(by_object)}; read "
            f"`{name}[{first!r}]` and the like"
        )
    return next(iter(by_object.values()))


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


def fill_frames(what: str, frames: Mapping[str, FrameMotion], given: Any) -> None:
    """Write ``given``, a mapping name -> position, quaternion, twist, into some of the frames.

    ``what`` is ``objects``, or ``bases`` of robots.

    Raises
    ------
    ModelError
        An unknown name or key, a wrong shape, a number that is not finite, a zero quaternion.
    """
    example = f"{what}: {{{next(iter(frames), 'sat')!r}: {{'position': 3 numbers [m]}}}}"
    if not isinstance(given, Mapping):
        raise ModelError(f"{what}: must be a dict by name, such as {example}, got {shown(given)}")
    for name, motion in given.items():
        if name not in frames:
            noun = "object" if what == "objects" else "robot with a floating base"
            known = f"those are {', '.join(frames)}" if frames else "there is none"
            if what == "bases":
                known += "; joints that move a base are among 'joint_positions'"
            raise ModelError(f"{what}: {name!r} is no {noun}; {known}")
        if not isinstance(motion, Mapping):
            raise ModelError(
                f"{what}[{name!r}]: must be a dict with some of {', '.join(FRAME_PARTS)}, got "
                f"{shown(motion)}"
            )
        for key in motion:
            if key not in FRAME_PARTS:
                raise ModelError(f"{what}[{name!r}]: {unknown('key', key, FRAME_PARTS)}")
        for part, values in motion.items():
            where, view = f"{what}[{name!r}][{part!r}]", getattr(frames[name], part)
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
        if not views:
            raise error(f"{what}: the scene has no robots; leave it out, got {shown(given)}")
        arm, values = next(iter(views.items()))
        raise error(
            f"{what}: must be a dict with numbers by {noun}, such as {{{arm!r}: {values.size} "
            f"numbers}}, got {shown(given)}"
        )
    for arm, values in given.items():
        if arm not in views:
            raise error(f"{what}: unknown {noun} {arm!r}; {noun}s are {', '.join(views)}")
        views[arm][:] = checked_vector(f"{what}[{arm!r}]", values, views[arm].size, error)
