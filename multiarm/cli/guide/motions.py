r"""Which motions a set of constraint rows leaves free, in words.

The rows :math:`W` (6, N) of a joint, as wrenches about the joint frame's origin in its axes, leave
free the relative velocities ``v`` with :math:`W^T v = 0`.  Slides along and turns about single axes
of the frame are told one by one; motions along several axes at once, as those of the corner of a
block among four fingertips, are counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.contacts.screws import column_norms, lever_arm, screw_system

__all__ = ["MOTIONS", "FreeMotions", "free_motions", "seen_from"]

# Components of a relative velocity in the joint frame: three slides and three turns.
MOTIONS = tuple(f"{how} {axis}" for how in ("slide along", "turn about") for axis in "xyz")
# A motion along a single axis is free by itself when less than this part of it violates the rows.
PURE = 1e-6
# A row that has a smaller part in every dependency of the rows is independent of the others.
PART = 1e-7


@dataclass(frozen=True)
class FreeMotions:
    """What rows leave free.

    Attributes
    ----------
    rank : int
        How many rows are independent.
    pure : tuple of int
        Components (places in ``MOTIONS``) that are free by themselves.
    coupled : int
        How many independent motions there are beside these, each along several axes at once.
    untouched : ndarray of bool, shape (N,)
        Rows that no other rows can replace.
    """

    rank: int
    pure: tuple[int, ...]
    coupled: int
    untouched: np.ndarray

    def words(self) -> list[str]:
        """The motions, such as ``slide along x and y``, ``turn about z``."""
        told = [
            f"{how} {_listed([axis for k, axis in enumerate('xyz', first) if k in self.pure])}"
            for how, first in (("slide along", 0), ("turn about", 3))
            if any(first <= k < first + 3 for k in self.pure)
        ]
        if self.coupled:
            told.append(f"{self.coupled} {'more ' * bool(told)}along several axes at once")
        return told


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def free_motions(W: np.ndarray) -> FreeMotions:
    """Judge rows given as the columns of ``W``, shape (6, N), N > 0.

    Parameters
    ----------
    W : ndarray, shape (6, N)
        Wrenches, force first, about the joint frame's origin in its axes; any scale.
    """
    unit = W / column_norms(W, lever_arm(W))
    system = screw_system(unit)
    motions = np.repeat([1.0, system.length], 3)[:, None] * system.reciprocal  # orthonormal
    outside = np.eye(6) - motions @ motions.T  # of each axis: its part that is not free
    pure = tuple(int(k) for k in np.flatnonzero(np.linalg.norm(outside, axis=0) < PURE))
    untouched = np.linalg.norm(system.dependencies, axis=1) < PART
    return FreeMotions(system.rank, pure, 6 - system.rank - len(pure), untouched)


def seen_from(frame: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """Wrenches (6, N) about another frame's origin, in its axes.

    Parameters
    ----------
    frame : ndarray, shape (4, 4)
        Pose of that frame in the one in which the wrenches are given.
    wrenches : ndarray, shape (6, N)
        Force first.
    """
    to_frame = frame[:3, :3].T
    moments = wrenches[3:].T - np.cross(frame[:3, 3], wrenches[:3].T)
    return np.vstack([to_frame @ wrenches[:3], to_frame @ moments.T])
