r"""The linkage of a scene: the parts that may move, with their gaps and branches.

*The gaps.*  A displacement ``u`` of the parts that may move (arms alone, or object and arms) is
dimensionless: angles in radians, lengths as fractions of the scene's size.  To first order

.. math:: \varphi(u) = \varphi + J u, \qquad T(u) = \tfrac12\, |L^T u|^2

with the rows ``J`` [m] of :math:`[W_o^T, W^T]` and the factor of the inertia
:math:`M = L L^T` [kg m^2], both in the units of ``u``.  Rows without a position function (no slip)
are left out.  :mod:`multiarm.assembly.loop_closure` closes the gaps.

*Branches.*  A robot's branch (elbow up or down) ends where its own rows lose rank.  Between two
near postures that has happened when the determinant of its rows, compressed to the directions that
it moves along in the first, changes its sign.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import Code, is_of_joints, rolls
from multiarm.dynamics.contact_geometry import block_inertias, force_directions
from multiarm.dynamics.coordinates import difference, retract
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import inertia_text, require_ok
from multiarm.dynamics.model import Model
from multiarm.errors import MultiarmError, SolverError
from multiarm.jit.rows import fields_of


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
        Blocks whose rows belong to it: those of robots that may move, and the surroundings.
    with_object : bool
        Whether the objects may move.
    limits : ndarray, shape (n, 2)
        Of all joints of the system; infinite where there are none.
    every_row : bool
        Whether rows without a position function belong to it too, as for velocities.
    size : float, optional
        The scene's, if it is known already [m].

    Attributes
    ----------
    joints : ndarray of int, shape (k or k - 6 F,)
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
        units = np.array(data.model.joint_units)
        self.unit = np.where(units[self.joints] == "m", self.size, 1.0)
        if with_object:
            of_object = [self.size] * 3 + [1.0] * 3
            self.unit = np.concatenate([of_object * self._layout.frames, self.unit])
        table = data.model.constants.contacts
        codes = fields_of(Code, table.codes[: work.first_contact[-1]])
        holds = every_row | ~rolls(codes.kind)
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
        inertias = block_inertias(self._data)
        for i, (_, c) in zip(self._arms, self.blocks, strict=True):
            L[c, c] = self._factor(i, inertias[i])
        gaps = self._data.contact_rows.gap[self.rows]
        return Posture(b.state.configuration.copy(), gaps, J * self.unit, self.unit[:, None] * L)

    def _factor(self, i: int, inertia: np.ndarray) -> np.ndarray:
        try:
            return np.linalg.cholesky(inertia)
        except np.linalg.LinAlgError:
            raise SolverError(inertia_text(self._data.model, i)) from None

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


def scene_size(data: Data) -> float:
    """Characteristic length of the scene [m]: of its lever arms, its objects and its robots."""
    arrays, constants = data.arrays, data.model.constants
    places = arrays.rows.kinematics[~rows_of_joints(data.model), :3]
    levers = places[:, None] - arrays.state.poses[:, :3]
    levers = levers[_objects_of_rows(data.model)[~rows_of_joints(data.model)]]
    origins = fields_of(BodyMotion, arrays.bodies.links).origin
    robots = np.array([robot for robot, _ in data.model.backends.links], dtype=np.int64)
    reaches = origins - _places_of_bases(data)[robots]
    squares = [np.square(ways).sum(axis=1).max(initial=0.0) for ways in (levers, reaches)]
    gyrations = np.trace(constants.object_inertias, axis1=1, axis2=2) / constants.object_masses
    return math.sqrt(max(*squares, *gyrations))


def _objects_of_rows(model: Model) -> np.ndarray:
    """Which objects the connection of each row has; all of one that has none, bool (N, F)."""
    layout, pairs = model.layout, model.constants.connections
    numbers = len(model.backends.links) + np.arange(layout.frames)
    of_owners = (pairs.first[:, None] == numbers) | (pairs.second[:, None] == numbers)
    of_owners[~of_owners.any(axis=1)] = True
    return np.repeat(of_owners, np.diff(layout.first_contact), axis=0)


def projection_tolerance(data: Data, size: float | None = None) -> float:
    """Gap [m] that counts as closed: 100 roundings of the coordinates involved.

    ``size`` is the scene's, if it is known already.
    """
    contacts, origins = data.arrays.rows.kinematics[:, :3], data.model.base_origins
    far = float(max(np.abs(places).max(initial=0.0) for places in (contacts, origins)))
    return 100 * sys.float_info.epsilon * max(far, scene_size(data) if size is None else size)


def rows_of_joints(model: Model) -> np.ndarray:
    """Which rows belong to robots' joints alone, such as couplings: bool (N,)."""
    codes = fields_of(Code, model.constants.contacts.codes[: model.layout.contacts])
    return is_of_joints(codes.kind)


def _places_of_bases(data: Data) -> np.ndarray:
    """Where the robots stand, world axes, of bases that move where they are now, (n, 3) [m]."""
    model, places = data.model, data.model.base_origins.copy()
    for i, arm in enumerate(model.robots.values()):
        positions = data.arrays.state.joint_positions[model.layout.joints_of(i)]
        slides = [j for j, joint in enumerate(arm.files.base_joints) if joint.kind == "prismatic"]
        for j in slides:
            axis = np.array(arm.files.base_joints[j].axis)
            places[i] += arm.files.base[:3, :3] @ axis * positions[j]
    for i, pose in zip(model.layout.floating_robots, data.arrays.state.base_poses, strict=True):
        places[i] = pose[:3]
    return places


def gaps_by_owner(data: Data) -> dict[str, float]:
    """Largest magnitude of a gap, by owner of rows [m]; of couplings [rad, m]."""
    return _largest_by_owner(data, data.contact_rows.gap)


def gap_rates_by_owner(data: Data) -> dict[str, float]:
    """Largest magnitude of a gap rate, by owner of rows [m/s]; of couplings [rad/s, m/s]."""
    return _largest_by_owner(data, data.contact_rows.gap_rate)


def _largest_by_owner(data: Data, values: np.ndarray) -> dict[str, float]:
    parts = data.model.layout.split_contacts(np.abs(values))
    return {owner: float(np.max(values, initial=0.0)) for owner, values in parts.items()}


def joints_at_limit(data: Data) -> tuple[str, ...]:
    """Joints at one of their limits in the data."""
    limits = data.model.position_limits
    near = np.min(np.abs(limits - data.arrays.state.joint_positions[:, None]), axis=1) <= 1e-9
    return tuple(name for name, at in zip(data.model.joint_names, near, strict=True) if at)


def _compression(rows: np.ndarray, rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Left and right factors that turn these rows into the identity, for use on near rows."""
    U, s, Vt = np.linalg.svd(rows, full_matrices=False)
    return U[:, :rank].T / s[:rank, None], Vt[:rank].T


def _determinant(left: np.ndarray, right: np.ndarray, rows: np.ndarray) -> float:
    """1 at the posture of the compression; its sign is that of the branch."""
    return float(np.linalg.det(left @ rows @ right))
