r"""The gaps of a system as a function of what may move: arms alone, or object and arms together.

A displacement ``u`` of the parts that may move is dimensionless: angles in radians, lengths as
fractions of the scene's size.  To first order

.. math:: \varphi(u) = \varphi + J u, \qquad T(u) = \tfrac12\, |L^T u|^2

with the rows ``J`` [m] of :math:`[W_o^T, W^T]` and the factor of the inertia
:math:`M = L L^T` [kg m^2], both in the units of ``u``.  Rows without a position function (no slip)
take no part.

An arm's *branch* (elbow up or down) ends where its own rows lose rank.  Between two near postures
that has happened when the determinant of its rows, compressed to the directions that it moves along
in the first, changes its sign.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiarm.contacts.kernel import GAP
from multiarm.contacts.records import KIND, TANGENT
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.kinematics import read_inertia
from multiarm.dynamics.model import Data
from multiarm.errors import MultiarmError, SolverError
from multiarm.spatial import difference, retract

# Relative singular value below which an arm is between its branches: it may take either.
NO_BRANCH = 1e-4
_DIFFERENCE = 1e-6  # of a joint, for the rate of a determinant
_SNAP = 1e-12  # [rad, m]
_NO_REACH = 1e-9  # of the longest row: nothing moves along it


def scene_size(data: Data) -> float:
    """A length that is typical of the scene [m]: of its lever arms, its object and its arms."""
    arrays, constants = data.arrays, data.model.constants
    levers = arrays.contacts[:, :3] - arrays.position[:3]
    reaches = arrays.arms[: len(data.model.bases), 9:12] - data.model.bases
    squares = [np.square(ways).sum(axis=1).max(initial=0.0) for ways in (levers, reaches)]
    gyration = constants.object_inertia.trace() / constants.object_mass
    return math.sqrt(max(*squares, gyration))


def projection_tolerance(data: Data, size: float | None = None) -> float:
    """Gap [m] that counts as closed: some roundings of the coordinates involved.

    ``size`` is the scene's, where it is known already.
    """
    contacts = data.arrays.contacts[:, :3]
    far = float(max(np.abs(places).max(initial=0.0) for places in (contacts, data.model.bases)))
    return 100 * sys.float_info.epsilon * max(far, scene_size(data) if size is None else size)


@dataclass(frozen=True)
class Posture:
    """The system at one place.

    Attributes
    ----------
    position : ndarray, shape (7,)
        The object's pose, as in the state.
    angles : ndarray, shape (n,)
        Positions of all joints.
    gaps : ndarray, shape (N,)
        [m], of the rows that take part.
    rows : ndarray, shape (N, k)
        Their derivative J with respect to ``u`` [m].
    factor : ndarray, shape (k, k)
        Lower triangular factor of the inertia in the units of ``u``; empty before it is asked for.
    """

    position: np.ndarray
    angles: np.ndarray
    gaps: np.ndarray
    rows: np.ndarray
    factor: np.ndarray

    @property
    def worst(self) -> float:
        """Largest gap [m]."""
        return float(np.max(np.abs(self.gaps), initial=0.0))

    @property
    def least_turn(self) -> float:
        """Largest motion, in the units of ``u``, that a row by itself takes to be closed."""
        reach = np.linalg.norm(self.rows, axis=1)
        counts = reach > _NO_REACH * np.max(reach, initial=0.0)
        return float(np.max(np.abs(self.gaps[counts]) / reach[counts], initial=0.0))

    @cached_property
    def norm(self) -> float:
        """Root of the sum of the squared gaps [m]."""
        return float(np.linalg.norm(self.gaps))


class Linkage:
    """The parts of a system that may move.

    Parameters
    ----------
    data : Data
        Its arrays hold the place to begin at, kinematics included.
    arms : sequence of int
        Arms that may move.
    with_object : bool
        Whether the object may move.
    limits : ndarray, shape (n, 2)
        Within which the joints stay, of all joints of the system; infinite where there are none.
    every_row : bool
        Whether rows without a position function take part too, as they do in velocities.
    size : float, optional
        The scene's, where it is known already [m].

    Attributes
    ----------
    joints : ndarray of int, shape (k or k - 6,)
        Places of the joints that may move in the stacked vectors.
    unit : ndarray, shape (k,)
        One unit of ``u`` in radians or metres.
    size : float
        The scene's size [m].
    """

    def __init__(
        self,
        data: Data,
        arms: list[int],
        with_object: bool,
        limits: np.ndarray,
        every_row: bool = False,
        size: float | None = None,
    ) -> None:
        work = data.work
        self._data, self._arms, self.with_object = data, arms, with_object
        self._limits = limits
        self.size = scene_size(data) if size is None else size
        self.joints = np.concatenate([np.arange(*work.dofs[i : i + 2]) for i in arms])
        units = np.array([u for arm in data.model.arms.values() for u in arm.joint_units.values()])
        self.unit = np.where(units[self.joints] == "m", self.size, 1.0)
        if with_object:
            self.unit = np.concatenate([[self.size] * 3, [1.0] * 3, self.unit])
        holds = every_row | (data.model.constants.codes[: work.rows[-1], KIND] != TANGENT)
        self._own = [np.flatnonzero(holds[slice(*work.rows[i : i + 2])]) for i in arms]
        self.rows = np.concatenate(
            [work.rows[i] + own for i, own in zip(arms, self._own, strict=True)]
        )
        self._first = 6 if with_object else 0
        self.blocks = self._blocks()

    def _blocks(self) -> list[tuple[slice, slice]]:
        """Place of every arm in ``J``: its rows and its columns."""
        blocks, r, c = [], 0, self._first
        for i, own in zip(self._arms, self._own, strict=True):
            n = int(self._data.work.dofs[i + 1] - self._data.work.dofs[i])
            blocks.append((slice(r, r + own.size), slice(c, c + n)))
            r, c = r + own.size, c + n
        return blocks

    def here(self) -> Posture:
        """The system at the place in its arrays, whose kinematics are fresh."""
        b, work = self._data.arrays, self._data.work
        J = np.zeros((self.rows.size, self.unit.size))
        L = np.zeros((self.unit.size, self.unit.size))
        if self.with_object:
            J[:, :6] = b.Wo[self.rows]
            L[:6, :6] = np.linalg.cholesky(b.inertia)
        for i, own, (r, c) in zip(self._arms, self._own, self.blocks, strict=True):
            J[r, c] = work.Y[i, : c.stop - c.start, own]
            L[c, c] = self._factor(i, c.stop - c.start)
        gaps = b.contacts[self.rows, GAP].copy()
        return Posture(
            b.position.copy(), b.angles.copy(), gaps, J * self.unit, self.unit[:, None] * L
        )

    def _factor(self, i: int, n: int) -> np.ndarray:
        data = self._data
        try:
            return np.linalg.cholesky(read_inertia(data.arrays.pointers[i], n))
        except np.linalg.LinAlgError:
            raise SolverError(
                f"the inertia matrix of arm '{data.model.arm_names[i]}' is not positive definite: "
                f"a joint moves links without mass or inertia; give them some in the URDF, or lock "
                f"the joint"
            ) from None

    def place(self, posture: Posture, u: np.ndarray | None = None) -> None:
        """Bring the kinematics of a posture, displaced by ``u``, into the data."""
        b = self._data.arrays
        b.position[:], b.angles[:] = posture.position, posture.angles
        if u is not None:
            move = self.unit * u
            b.angles[self.joints] += move[self._first :]
            self._snap(b.angles)
            if self.with_object:
                b.position[:3] += move[:3]
                b.position[3:7] = retract(posture.position[3:7], move[3:6])
        if update_kinematics(self._data.struct) != OK:
            self._data.reraise()

    def moved(self, posture: Posture, u: np.ndarray) -> Posture | None:
        """The posture displaced by ``u``; None where some contact has no normal."""
        try:
            self.place(posture, u)
        except MultiarmError:  # a surface ends there
            self._data.forgive()
            return None
        if not np.all(np.isfinite(self._data.arrays.contacts)):
            return None
        return self.here()

    def _snap(self, angles: np.ndarray) -> None:
        """Take roundings off the positions of joints that arrived at a limit."""
        at = np.clip(angles, *self._limits.T)
        angles[:] = np.where(np.abs(at - angles) <= _SNAP * np.maximum(1.0, np.abs(at)), at, angles)

    def room(self, posture: Posture) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest ``u`` that keep the joints within their limits."""
        limits = self._limits
        low, high = np.full(self.unit.size, -np.inf), np.full(self.unit.size, np.inf)
        angles, unit = posture.angles[self.joints], self.unit[self._first :]
        low[self._first :] = np.minimum((limits[self.joints, 0] - angles) / unit, 0.0)
        high[self._first :] = np.maximum((limits[self.joints, 1] - angles) / unit, 0.0)
        return low, high

    def changes(self, begin: Posture, end: Posture) -> np.ndarray:
        """How far everything moved between two postures, in the units of ``u`` (k,)."""
        moved = (end.angles - begin.angles)[self.joints]
        if self.with_object:
            shift = end.position[:3] - begin.position[:3]
            turn = difference(begin.position[3:7], end.position[3:7])
            moved = np.concatenate([shift, turn, moved])
        return np.abs(moved) / self.unit

    def branches(self, posture: Posture) -> list[int]:
        """Number of directions, of every arm, that tell its branch: the rank of its rows."""
        singular = [np.linalg.svd(posture.rows[block], compute_uv=False) for block in self.blocks]
        return [int(np.sum(s > NO_BRANCH * np.max(s, initial=0.0))) for s in singular]

    def branch_ends(self, here: Posture, there: Posture, ranks: list[int]) -> list[int]:
        """Arms (numbers of their blocks) that passed a singular posture between two near ones."""
        return [
            k
            for k, (block, rank) in enumerate(zip(self.blocks, ranks, strict=True))
            if _determinant(*_compression(here.rows[block], rank), there.rows[block]) <= 0.0
        ]

    def guard(self, posture: Posture, k: int, rank: int) -> np.ndarray:
        """The direction in ``u`` (k,) along which arm ``k`` nears the end of its branch fastest."""
        block = self.blocks[k]
        frame, row = _compression(posture.rows[block], rank), np.zeros(self.unit.size)
        for j in range(block[1].start, block[1].stop):
            values = []
            for h in (_DIFFERENCE, -_DIFFERENCE):
                there = self.moved(posture, h * np.eye(self.unit.size)[j])
                rows = posture.rows if there is None else there.rows
                values.append(_determinant(*frame, rows[block]))
            row[j] = (values[0] - values[1]) / (2 * _DIFFERENCE)
        size = np.linalg.norm(row)
        return row / size if size > 0.0 else row


def _compression(rows: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Factors left and right of rows near these that make them the identity here."""
    U, s, Vt = np.linalg.svd(rows, full_matrices=False)
    return U[:, :rank].T / s[:rank, None], Vt[:rank].T


def _determinant(left: np.ndarray, right: np.ndarray, rows: np.ndarray) -> float:
    """1 at the posture of the compression; its sign is that of the branch."""
    return float(np.linalg.det(left @ rows @ right))
