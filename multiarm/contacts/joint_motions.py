r"""Which motions a joint leaves free, and where it is between its limits.

The rows :math:`W` (6, N) of a joint, as wrenches about the joint frame's origin in its axes, leave
free the relative velocities ``v`` with :math:`W^T v = 0`.  Slides along and turns about single axes
of the frame are named; motions along several axes at once, as those of the corner of a block among
four fingertips, are counted.

With the joint's frames on the object and on the arm's tip, which coincide at the start and whose z
axes are the joint's axis, ``X = F_object^-1 F_tip`` is a screw about z: its translation is the
slide, its rotation the turn.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.contacts.screws import column_norms, lever_arm, screw_system
from multiarm.scene import JointBase

# Components of a relative velocity in the joint frame: three slides and three turns.
_MOTIONS = tuple(f"{how} {axis}" for how in ("slide along", "turn about") for axis in "xyz")
# A motion along a single axis is free by itself when less than this part of it violates the rows.
_PURE = 1e-6
# A row that has a smaller part in every dependency of the rows is independent of the others.
_PART = 1e-7


@dataclass(frozen=True)
class FreeMotions:
    """What rows leave free.

    Attributes
    ----------
    rank : int
        How many rows are independent.
    pure : tuple of int
        Components that are free by themselves: slides along x, y, z, turns about x, y, z.
    coupled : int
        How many further independent motions there are, each along several axes at once.
    untouched : ndarray of bool, shape (N,)
        Rows that no other rows can replace.
    """

    rank: int
    pure: tuple[int, ...]
    coupled: int
    untouched: np.ndarray

    def words(self) -> list[str]:
        """The motions, such as ``slide along x and y``, ``turn about z``."""
        words = [
            f"{how} {_listed([axis for k, axis in enumerate('xyz', first) if k in self.pure])}"
            for how, first in (("slide along", 0), ("turn about", 3))
            if any(first <= k < first + 3 for k in self.pure)
        ]
        if self.coupled:
            words.append(f"{self.coupled} {'more ' * bool(words)}along several axes at once")
        return words


def free_motions(W: np.ndarray) -> FreeMotions:
    """Motions that rows leave free.

    Parameters
    ----------
    W : ndarray, shape (6, N), N > 0
        Wrenches, force first, about the joint frame's origin in its axes; any scale.
    """
    unit = W / column_norms(W, lever_arm(W))
    system = screw_system(unit)
    motions = np.repeat([1.0, system.length], 3)[:, None] * system.reciprocal  # orthonormal
    outside = np.eye(6) - motions @ motions.T  # of each axis: its part that is not free
    pure = tuple(int(k) for k in np.flatnonzero(np.linalg.norm(outside, axis=0) < _PURE))
    untouched = np.linalg.norm(system.dependencies, axis=1) < _PART
    return FreeMotions(system.rank, pure, 6 - system.rank - len(pure), untouched)


def seen_from(frame: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """Wrenches (6, N), force first, about another frame's origin, in its axes.

    ``frame``, shape (4, 4), is the pose of that frame in the one in which they are given.
    """
    to_frame = frame[:3, :3].T
    moments = wrenches[3:].T - np.cross(frame[:3, 3], wrenches[:3].T)
    return np.vstack([to_frame @ wrenches[:3], to_frame @ moments.T])


@dataclass(frozen=True)
class Limit:
    """The limits of one coordinate, 0 where the joint's two frames coincide.

    Attributes
    ----------
    component : int
        A slide along x, y, z (0 to 2) or a turn about x, y, z (3 to 5) of the joint's frame.
    low, high : float
        [m] or [rad].
    """

    component: int
    low: float
    high: float

    @property
    def turns(self) -> bool:
        """Whether the coordinate is an angle."""
        return self.component >= 3

    @property
    def motion(self) -> str:
        """What the coordinate counts, in words."""
        return _MOTIONS[self.component]

    @property
    def unit(self) -> str:
        """The unit of the coordinate: rad or m."""
        return "rad" if self.turns else "m"


def limits_of(joint: JointBase) -> tuple[Limit, ...]:
    """The limits of a scene's joint: none, or one for each coordinate that has them."""
    return tuple(Limit(component, *ends) for component, ends in joint.free_limits.items())


def axis_travel(on_object: np.ndarray, on_tip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn about and slide along the z axis of a joint's frames through K instants.

    Parameters
    ----------
    on_object, on_tip : ndarray, shape (K, 4, 4)
        World poses of the joint's frame on the object and of that on the tip.

    Returns
    -------
    turn, slide : ndarray, shape (K,)
        [rad], continuous from instant to instant, the first within half a turn of 0; [m].
    """
    R, p = on_object[:, :3, :3], on_object[:, :3, 3]
    slide = np.einsum("ki,ki->k", R[..., 2], on_tip[:, :3, 3] - p)
    x_tip = on_tip[:, :3, 0]
    along_x, along_y = (np.einsum("ki,ki->k", R[..., j], x_tip) for j in (0, 1))
    return np.unwrap(np.arctan2(along_y, along_x)), slide


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
