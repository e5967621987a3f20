r"""Loop closure: moving onto the joints with the least motion.

*The gaps.*  A displacement ``u`` of the parts that may move (arms alone, or object and arms) is
dimensionless: angles in radians, lengths as fractions of the scene's size.  To first order

.. math:: \varphi(u) = \varphi + J u, \qquad T(u) = \tfrac12\, |L^T u|^2

with the rows ``J`` [m] of :math:`[W_o^T, W^T]` and the factor of the inertia
:math:`M = L L^T` [kg m^2], both in the units of ``u``.  Rows without a position function (no slip)
are left out.

*The method* is Levenberg and Marquardt's in the inertia metric.  A step ``u`` solves

.. math:: \min_u\; |\varphi + J u|^2 + \mu\, |L^T u|^2
    \quad\text{within the joints' limits and } |u|_\infty \le \Delta

with the smallest :math:`\mu` that keeps it within the trust region.  As the gaps close
:math:`\mu` falls to a floor far below every singular value that matters, so that the step becomes
Newton's, of least kinetic energy: the method converges quadratically, and needs no decision about
rank where arms are singular or rows redundant (H. Yamashita, M. Fukushima, Computing Suppl. 15,
2001).  Steps are short and must reduce the gaps, so that the path leads from the start to the next
closed posture on its branch.

*Branches.*  An arm's branch (elbow up or down) ends where its own rows lose rank.  Between two near
postures that has happened when the determinant of its rows, compressed to the directions that it
moves along in the first, changes its sign.  At the end of a branch a step goes along it.

*Buckling.*  Where no motion reduces the gaps to first order, a flat linkage may still buckle: then
the curvature :math:`\sum_k \varphi_k \nabla^2\varphi_k` on the null space of ``J`` has a negative
eigenvalue, and the path continues along its eigenvector.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import TANGENT, Code
from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.coordinates import difference, retract
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.kinematics import read_inertia
from multiarm.errors import MultiarmError, SolverError
from multiarm.jit.rows import fields_of

# Largest radius of the trust region [rad, fractions of the scene's size].
RADIUS = 0.1
# Largest motion of any part altogether [rad, fractions of the scene's size].
FARTHEST = 0.5
MOST_STEPS = 120


def scene_size(data: Data) -> float:
    """Characteristic length of the scene [m]: of its lever arms, its object and its arms."""
    arrays, constants = data.arrays, data.model.constants
    levers = arrays.rows.kinematics[:, :3] - arrays.state.object_pose[:3]
    origins = fields_of(BodyMotion, arrays.bodies.links).origin
    reaches = origins[: len(data.model.bases)] - data.model.bases
    squares = [np.square(ways).sum(axis=1).max(initial=0.0) for ways in (levers, reaches)]
    gyration = constants.object_inertia.trace() / constants.object_mass
    return math.sqrt(max(*squares, gyration))


def projection_tolerance(data: Data, size: float | None = None) -> float:
    """Gap [m] that counts as closed: 100 roundings of the coordinates involved.

    ``size`` is the scene's, if it is known already.
    """
    contacts = data.arrays.rows.kinematics[:, :3]
    far = float(max(np.abs(places).max(initial=0.0) for places in (contacts, data.model.bases)))
    return 100 * sys.float_info.epsilon * max(far, scene_size(data) if size is None else size)


def gaps_by_arm(data: Data) -> dict[str, float]:
    """Largest magnitude of a gap, by arm [m]."""
    return _largest_by_arm(data, data.contact_rows.gap)


def gap_rates_by_arm(data: Data) -> dict[str, float]:
    """Largest magnitude of a gap rate, by arm [m/s]."""
    return _largest_by_arm(data, data.contact_rows.gap_rate)


def _largest_by_arm(data: Data, values: np.ndarray) -> dict[str, float]:
    parts = data.model.layout.split_contacts(np.abs(values))
    return {arm: float(np.max(values, initial=0.0)) for arm, values in parts.items()}


def joints_at_limit(data: Data) -> tuple[str, ...]:
    """Joints at one of their limits in the data."""
    limits = np.vstack([arm.position_limits for arm in data.model.arms.values()])
    near = np.min(np.abs(limits - data.arrays.state.joint_positions[:, None]), axis=1) <= 1e-9
    return tuple(name for name, at in zip(data.model.joint_names, near, strict=True) if at)


class Outcome(Enum):
    """How :func:`close_gaps` ended."""

    CLOSED = "the gaps are closed"
    STUCK = "no motion reduces the gaps"
    FAR = "a part moved too far"
    TOO_SLOW = "gaps were left after the last step"


@dataclass(frozen=True)
class Closing:
    """Result of :func:`close_gaps`; the kinematics at the end are in the data."""

    outcome: Outcome
    changes: np.ndarray  # (k,), magnitude of the displacement in the units of ``u``

    @property
    def closed(self) -> bool:
        """Whether the gaps are closed."""
        return self.outcome is Outcome.CLOSED

    @property
    def change(self) -> float:
        """Largest change [rad, fractions of the scene's size]."""
        return float(np.max(self.changes))


def close_gaps(linkage: Linkage, tolerance: float) -> Closing:
    """Close the gaps of a linkage, from the posture in the data (with its kinematics).

    Parameters
    ----------
    tolerance : float
        Largest gap that counts as closed [m].

    Raises
    ------
    SolverError
        When the inertia of an arm is not positive definite.
    """
    begin = posture = linkage.posture()
    radius, crossings, ranks = RADIUS, 0, linkage.branches(begin)
    guards = np.zeros((0, linkage.unit.size))
    outcome = Outcome.TOO_SLOW
    for _ in range(MOST_STEPS):
        if posture.worst <= tolerance:
            outcome = Outcome.CLOSED
            break
        if np.max(linkage.changes(begin, posture)) > FARTHEST:
            outcome = Outcome.FAR
            break
        u = _step(posture, guards, radius, *linkage.room(posture))
        promised = 1.0 - (np.linalg.norm(posture.gaps + posture.rows @ u) / posture.norm) ** 2
        if not promised > 1e-8:  # of the squared gaps
            out = None if guards.size else _buckled(linkage, posture)
            if out is None:
                outcome = Outcome.STUCK
                break
            posture, radius = out, RADIUS
            continue
        trial = linkage.moved(posture, u)
        progress = -1.0 if trial is None else (1.0 - (trial.norm / posture.norm) ** 2) / promised
        if trial is None or not (progress >= 0.1 or trial.worst <= tolerance):
            radius = 0.5 * min(radius, float(np.max(np.abs(u))))
            continue
        ends = linkage.branch_ends(posture, trial, ranks)
        if ends:
            crossings += 1
            # three steps that would leave the branch are shortened, later ones led along its end
            if crossings > 3 and not guards.size:
                guards = np.array([linkage.guard(posture, k, ranks[k]) for k in ends])
            else:
                radius = 0.5 * min(radius, float(np.max(np.abs(u))))
            continue
        posture, guards = trial, guards[:0]
        if progress > 0.5:
            radius = min(RADIUS, 2.0 * radius)
    linkage.place(posture)
    return Closing(outcome, linkage.changes(begin, posture))


@dataclass(frozen=True)
class Posture:
    """A posture of the system, with its gaps."""

    configuration: np.ndarray  # (7 + n,)
    gaps: np.ndarray  # (N,) [m], of the rows of the linkage
    rows: np.ndarray  # (N, k) [m], their derivative J with respect to ``u``
    factor: np.ndarray  # (k, k), lower triangular factor of the inertia in the units of ``u``

    @property
    def worst(self) -> float:
        """Largest gap [m]."""
        return float(np.max(np.abs(self.gaps), initial=0.0))

    @property
    def least_turn(self) -> float:
        """Largest motion, in the units of ``u``, that closes one row by itself."""
        reach = np.linalg.norm(self.rows, axis=1)
        counts = reach > 1e-9 * np.max(reach, initial=0.0)
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
        Its arrays hold the posture at the beginning, with its kinematics.
    arms : sequence of int
        Arms that may move.
    with_object : bool
        Whether the object may move.
    limits : ndarray, shape (n, 2)
        Of all joints of the system; infinite where there are none.
    every_row : bool
        Whether rows without a position function belong to it too, as for velocities.
    size : float, optional
        The scene's, if it is known already [m].

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
        work, self._layout = data.work, data.model.layout
        self._data, self._arms, self.with_object = data, arms, with_object
        self._limits = limits
        self.size = scene_size(data) if size is None else size
        self.joints = np.concatenate([np.arange(*work.first_joint[i : i + 2]) for i in arms])
        units = np.array([u for arm in data.model.arms.values() for u in arm.joint_units.values()])
        self.unit = np.where(units[self.joints] == "m", self.size, 1.0)
        if with_object:
            self.unit = np.concatenate([[self.size] * 3, [1.0] * 3, self.unit])
        table = data.model.constants.contacts
        codes = fields_of(Code, table.codes[: work.first_contact[-1]])
        holds = every_row | (codes.kind != TANGENT)
        self._held_rows = [
            np.flatnonzero(holds[slice(*work.first_contact[i : i + 2])]) for i in arms
        ]
        self.rows = np.concatenate(
            [work.first_contact[i] + held for i, held in zip(arms, self._held_rows, strict=True)]
        )
        frames = np.arange(self._layout.of_frames.stop)
        self._first = len(frames) if with_object else 0
        # places of what may move in displacements of the whole system
        self._moving = np.concatenate([frames[: self._first], len(frames) + self.joints])
        self.blocks = self._blocks()

    def _blocks(self) -> list[tuple[slice, slice]]:
        """Place of every arm in ``J``: its rows and its columns."""
        blocks, r, c = [], 0, self._first
        for i, held in zip(self._arms, self._held_rows, strict=True):
            n = int(self._data.work.first_joint[i + 1] - self._data.work.first_joint[i])
            blocks.append((slice(r, r + held.size), slice(c, c + n)))
            r, c = r + held.size, c + n
        return blocks

    def posture(self) -> Posture:
        """The posture in the data, whose kinematics are current."""
        b = self._data.arrays
        J = force_directions(self._data)[np.ix_(self._moving, self.rows)].T.copy()
        L = np.zeros((self.unit.size, self.unit.size))
        if self.with_object:
            frames = self._layout.of_frames
            L[frames, frames] = np.linalg.cholesky(b.bodies.object_inertia)
        for i, (_, c) in zip(self._arms, self.blocks, strict=True):
            L[c, c] = self._factor(i, c.stop - c.start)
        gaps = self._data.contact_rows.gap[self.rows]
        return Posture(b.state.configuration.copy(), gaps, J * self.unit, self.unit[:, None] * L)

    def _factor(self, i: int, n: int) -> np.ndarray:
        data = self._data
        try:
            return np.linalg.cholesky(read_inertia(data.arrays.bodies.pointers[i], n))
        except np.linalg.LinAlgError:
            raise SolverError(
                f"the inertia matrix of arm '{data.model.arm_names[i]}' is not positive definite: "
                f"a joint moves links without mass or inertia; give them some in the URDF, or lock "
                f"the joint"
            ) from None

    def place(self, posture: Posture, u: np.ndarray | None = None) -> None:
        """Write a posture, displaced by ``u``, and its kinematics into the data."""
        b = self._data.arrays
        b.state.configuration[:] = posture.configuration
        if u is not None:
            displacement = np.zeros(self._layout.nv)
            displacement[self._moving] = self.unit * u
            b.state.configuration[:] = retract(self._layout, posture.configuration, displacement)
            self._snap(b.state.joint_positions)
        require_ok(self._data, update_kinematics(self._data.struct))

    def moved(self, posture: Posture, u: np.ndarray) -> Posture | None:
        """The posture displaced by ``u``; None where a contact has no normal."""
        try:
            self.place(posture, u)
        except MultiarmError:  # a surface ends
            self._data.forgive()
            return None
        if not np.all(np.isfinite(self._data.arrays.rows.kinematics)):
            return None
        return self.posture()

    def _snap(self, angles: np.ndarray) -> None:
        """Remove roundings from the positions of joints at a limit."""
        at = np.clip(angles, *self._limits.T)
        near = np.abs(at - angles) <= 1e-12 * np.maximum(1.0, np.abs(at))
        angles[:] = np.where(near, at, angles)

    def room(self, posture: Posture) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest ``u`` that keep the joints within their limits."""
        limits = self._limits
        low, high = np.full(self.unit.size, -np.inf), np.full(self.unit.size, np.inf)
        angles = self._layout.joint_positions(posture.configuration)[self.joints]
        unit = self.unit[self._first :]
        low[self._first :] = np.minimum((limits[self.joints, 0] - angles) / unit, 0.0)
        high[self._first :] = np.maximum((limits[self.joints, 1] - angles) / unit, 0.0)
        return low, high

    def changes(self, begin: Posture, end: Posture) -> np.ndarray:
        """Magnitude of the displacement between two postures, in the units of ``u`` (k,)."""
        moved = difference(self._layout, begin.configuration, end.configuration)
        return np.abs(moved[self._moving]) / self.unit

    def branches(self, posture: Posture) -> list[int]:
        """Rank of every arm's rows, whose directions distinguish its branches."""
        singular = [np.linalg.svd(posture.rows[block], compute_uv=False) for block in self.blocks]
        return [int(np.sum(s > 1e-4 * np.max(s, initial=0.0))) for s in singular]

    def branch_ends(self, posture: Posture, trial: Posture, ranks: list[int]) -> list[int]:
        """Arms (numbers of their blocks) that passed a singular posture between two near ones."""
        return [
            k
            for k, (block, rank) in enumerate(zip(self.blocks, ranks, strict=True))
            if _determinant(*_compression(posture.rows[block], rank), trial.rows[block]) <= 0.0
        ]

    def guard(self, posture: Posture, k: int, rank: int) -> np.ndarray:
        """Direction in ``u`` (k,) in which arm ``k`` approaches the end of its branch fastest."""
        block, change = self.blocks[k], 1e-6
        frame, row = _compression(posture.rows[block], rank), np.zeros(self.unit.size)
        for j in range(block[1].start, block[1].stop):
            values = []
            for h in (change, -change):
                moved = self.moved(posture, h * np.eye(self.unit.size)[j])
                rows = posture.rows if moved is None else moved.rows
                values.append(_determinant(*frame, rows[block]))
            row[j] = (values[0] - values[1]) / (2 * change)
        size = np.linalg.norm(row)
        return row / size if size > 0.0 else row


def _step(
    posture: Posture, guards: np.ndarray, radius: float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Levenberg and Marquardt's step (k,) within radius and bounds, normal to the ``guards``."""
    heavy = 1e3 * np.linalg.norm(posture.rows) * guards
    rows, gaps = np.vstack([posture.rows, heavy]), np.append(posture.gaps, np.zeros(len(guards)))
    U, s, Vt = np.linalg.svd(np.linalg.solve(posture.factor, rows.T).T, full_matrices=False)
    back = np.linalg.solve(posture.factor.T, Vt.T)  # (k, r)
    target, mu = -U.T @ gaps, (1e-9 * s[0]) ** 2
    if not s[0] > 0.0:
        return np.zeros(low.size)
    u = back @ (s / (s * s + mu) * target)
    while np.max(np.abs(u)) > radius:
        mu *= 2.0
        u = back @ (s / (s * s + mu) * target)
    if np.all(u >= low) and np.all(u <= high):
        return u
    from scipy.optimize import lsq_linear

    bounds = np.maximum(low, -radius), np.minimum(high, radius)
    matrix = np.vstack([rows, np.sqrt(mu) * posture.factor.T])
    right = np.append(-gaps, np.zeros(low.size))
    return np.clip(lsq_linear(matrix, right, bounds, method="bvls").x, *bounds)


def _buckled(linkage: Linkage, posture: Posture) -> Posture | None:
    """A posture on the path along which a flat linkage buckles, if there is one.

    Both directions are equal; the one in which the farthest moving part grows is taken.
    """
    probe = 1e-4  # displacement over which the curvature is measured
    _, s, Vt = np.linalg.svd(posture.rows)
    null = Vt[int(np.sum(s > 1e-6 * s[0])) :]
    curvature = np.zeros((len(null), len(null)))
    for column, v in enumerate(null):
        sides = [linkage.moved(posture, h * v) for h in (probe, -probe)]
        if sides[0] is None or sides[1] is None:
            return None
        slope = (sides[0].rows - sides[1].rows).T @ posture.gaps / (2 * probe)
        curvature[:, column] = null @ slope
    if not len(null):
        return None
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    if not values[0] < -1e-6 * posture.norm * linkage.size:
        return None
    way = vectors[:, 0] @ null
    way *= np.sign(way[np.argmax(np.abs(way))]) / np.max(np.abs(way))
    length = min(RADIUS, 2.0 * posture.norm / np.sqrt(-values[0]))
    low, high = linkage.room(posture)
    for _ in range(40):
        for u in (length * way, -length * way):
            trial = linkage.moved(posture, u) if np.all((low <= u) & (u <= high)) else None
            if trial is not None and trial.norm < 0.9 * posture.norm:
                return trial
        length *= 0.7
    return None


def _compression(rows: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Left and right factors that turn these rows into the identity, for use on near rows."""
    U, s, Vt = np.linalg.svd(rows, full_matrices=False)
    return U[:, :rank].T / s[:rank, None], Vt[:rank].T


def _determinant(left: np.ndarray, right: np.ndarray, rows: np.ndarray) -> float:
    """1 at the posture of the compression; its sign is that of the branch."""
    return float(np.linalg.det(left @ rows @ right))
