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
from multiarm.scene.faults import shown


@dataclass(frozen=True, eq=False, repr=False)
class State:
    """Positions and velocities of object and robots.

    Attributes
    ----------
    position : ndarray, shape (7 + n,)
        The configuration: object's centre of mass [m], its quaternion (xyzw), joint positions
        [rad or m].
    velocity : ndarray, shape (6 + n,)
        Object's twist (world axes: velocity of the centre of mass, angular velocity), joint
        velocities.
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

    def copy(self) -> State:
        """An independent copy."""
        return State(self.position.copy(), self.velocity.copy(), self.layout)

    def displaced(self, displacement: np.ndarray) -> State:
        """A copy moved by a shift [m] and a turn [rad] of the object and by joints, (6 + n,).

        World axes; the velocities stay as they are.

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
            f"({count_of(state.layout.joints, 'joint')}), not to this one; make it with "
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


def fill_by_arm(
    what: str,
    views: Mapping[str, np.ndarray],
    given: Any,
    error: type[MultiarmError] = ModelError,
) -> None:
    """Write ``given``, a mapping arm -> numbers, into the ``views`` of some or all arms."""
    if not isinstance(given, Mapping):
        arm, values = next(iter(views.items()))
        raise error(
            f"{what}: must be a dict with numbers by arm, such as {{{arm!r}: {values.size} "
            f"numbers}}, got {shown(given)}"
        )
    for arm, values in given.items():
        if arm not in views:
            noun = "robot" if "/" in str(arm) else "arm"  # a tip in place of its robot
            raise error(f"{what}: unknown {noun} {arm!r}; {noun}s are {', '.join(views)}")
        views[arm][:] = checked_vector(f"{what}[{arm!r}]", values, views[arm].size, error)
