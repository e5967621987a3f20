"""Derivatives of an evaluation as a user reads them: blocks with names, of one matrix.

Displacements of the object are a shift of its centre of mass and a rotation vector, world axes:
``position + shift``, ``retract(quaternion, turn)``.  Those of a floating base are the same of its
frame; in the stacked vectors they stand before its robot's joints.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, NoReturn, TypeVar

import numpy as np

from multiarm.dynamics.evaluation import Evaluation, rows_by_owner
from multiarm.dynamics.layout import STATE, Layout
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE
from multiarm.dynamics.solver.dense import null_space, reciprocal_lengths
from multiarm.dynamics.state import only_object
from multiarm.errors import ModelError
from multiarm.notation import count_of

INPUTS = ("torques", "effect_states")
PARAMETERS = ("object_wrench", "object_mass", "object_inertia", "placements")


def columns_of(layout: Layout, states: int, parameters: bool) -> dict[str, slice]:
    """Where the quantities are by which an evaluation is differentiated.

    ``states``: number of states of effects.
    """
    sizes = {name: part.stop - part.start for name, part in layout.columns.items()}
    sizes |= dict(zip(INPUTS, (layout.rate_count, states), strict=True))
    if parameters:
        placements = 6 * len(layout.owners_of_robots)
        sizes |= dict(zip(PARAMETERS, (6, 1, 6, placements), strict=True))
    return in_sequence(sizes)


def rows_of(layout: Layout, states: int) -> dict[str, slice]:
    """Where the quantities are that are differentiated."""
    return in_sequence(
        {
            "object_acceleration": 6 * layout.frames,
            "joint_accelerations": layout.rate_count,
            "contact_forces": layout.contacts,
            "effect_state_rates": states,
        }
    )


def in_sequence(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Slices of these sizes, one after the other."""
    slices, end = {}, 0
    for name, size in sizes.items():
        slices[name] = slice(end, end + size)
        end += size
    return slices


Derivative = TypeVar("Derivative", float, np.ndarray)


class ByPath(dict[str, Derivative]):
    """Derivatives by numbers of the scene, path -> derivative."""

    def __missing__(self, path: str) -> NoReturn:
        known = f"they have those by {', '.join(self)}" if self else "`parameters` named none"
        raise ModelError(f"these derivatives have none by {path}: {known}")


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of one quantity, shape (m,), as blocks of one matrix.

    Attributes
    ----------
    matrix : ndarray, shape (m, C)
        By all columns; of a number (C,), at many times (K, m, C), and so with all blocks.
    layout : Layout
    columns : mapping str -> slice
    """

    matrix: np.ndarray
    layout: Layout
    columns: Mapping[str, slice]

    @property
    def d_object_pose(self) -> np.ndarray:
        """By a shift [m] and a turn [rad] of each object, world axes, shape (m, 6 F)."""
        return self._block("object_pose")

    @property
    def d_object_twist(self) -> np.ndarray:
        """By the objects' twists, shape (m, 6 F)."""
        return self._block("object_twist")

    @property
    def d_joint_positions(self) -> Mapping[str, np.ndarray]:
        """By the joint positions [rad, m], arm -> (m, n_i)."""
        return self.layout.split_joints(self._block("joint_positions"))

    @property
    def d_joint_velocities(self) -> Mapping[str, np.ndarray]:
        """By the joint velocities, arm -> (m, n_i)."""
        return self.layout.split_joints(self._block("joint_velocities"))

    @property
    def d_base_poses(self) -> Mapping[str, np.ndarray]:
        """By a shift [m] and a turn [rad] of a floating base, world axes, robot -> (m, 6)."""
        return self._by_base("joint_positions")

    @property
    def d_base_twists(self) -> Mapping[str, np.ndarray]:
        """By the twist of a floating base, world axes, robot -> (m, 6)."""
        return self._by_base("joint_velocities")

    @property
    def d_base_wrenches(self) -> Mapping[str, np.ndarray]:
        """By a force [N] and a moment about its origin [N m] on a floating base, robot -> (m, 6).

        World axes.
        """
        return self._by_base("torques")

    @property
    def d_torques(self) -> Mapping[str, np.ndarray]:
        """By torques [N m] or forces [N] that are added to the joints, arm -> (m, n_i)."""
        return self.layout.split_joints(self._block("torques"))

    @property
    def d_effect_states(self) -> np.ndarray:
        """By the states of effects, shape (m, e)."""
        return self._block("effect_states")

    @property
    def d_object_wrench(self) -> np.ndarray:
        """By a force [N] and a moment about the centre of mass [N m], world axes, shape (m, 6)."""
        return self._block("object_wrench")

    @property
    def d_object_mass(self) -> np.ndarray:
        """By the object's mass [kg], shape (m,); its inertia and centre of mass stay."""
        return self._block("object_mass")[..., 0]

    @property
    def d_object_inertia(self) -> np.ndarray:
        """By ``xx, xy, xz, yy, yz, zz`` of the inertia [kg m^2], object axes, shape (m, 6)."""
        return self._block("object_inertia")

    @property
    def d_placements(self) -> Mapping[str, np.ndarray]:
        """By a shift [m] and a turn [rad] of contacts against their first body, name -> (m, 6).

        By connection; in the axes, and about the origin, of the joint's frame that moves the link
        with the tip.
        """
        block, names = self._block("placements"), self.layout.owners_of_robots
        return {name: block[..., 6 * c : 6 * c + 6] for c, name in enumerate(names)}

    @property
    def parameters(self) -> Mapping[str, np.ndarray]:
        """By numbers of the scene, of those given to :func:`multiarm.sensitivities`, (K, m)."""
        paths = [path for path in self.columns if path not in (*STATE, *INPUTS, *PARAMETERS)]
        return ByPath({path: self.matrix[..., self.columns[path].start] for path in paths})

    def _by_base(self, name: str) -> dict[str, np.ndarray]:
        return self.layout.split_bases(self._block(name))

    def _block(self, name: str) -> np.ndarray:
        if name not in self.columns:
            ask = "ask for them, ma.derivatives(system, t, state, parameters=True)"
            known = f"they have those by {', '.join(self.columns)}"
            remedy = ask if name in PARAMETERS else known
            raise ModelError(f"these derivatives have none by {name}: {remedy}")
        return self.matrix[..., self.columns[name]]


class Motions(NamedTuple):
    """The inertia of the system, and the derivatives of its gaps.

    Displacements and velocities have ``6 F + n`` numbers: of objects (world axes), of joints.

    Attributes
    ----------
    layout : Layout
    inertia : ndarray, shape (6 F + n, 6 F + n)
        Kinetic energy is half its square form of the velocities.
    closed : bool ndarray, shape (N,)
        Rows whose gaps joints keep closed; rolling rows have no gap.
    rates : ndarray, shape (N, 6 F + n)
        Of the rates of all N rows, by the velocities; of their gaps, by a displacement.
    rates_by_position : ndarray, shape (N, 6 F + n)
        Of these rates, by a displacement.
    independent : bool
        Whether no row repeats others.
    """

    layout: Layout
    inertia: np.ndarray
    closed: np.ndarray
    rates: np.ndarray
    rates_by_position: np.ndarray
    independent: bool

    @property
    def gaps(self) -> np.ndarray:
        """Derivatives of the K gaps that joints keep closed, by a displacement, (K, 6 F + n)."""
        return self.rates[self.closed]

    @property
    def constraint(self) -> np.ndarray:
        """Derivatives of gaps and gap rates by displacements and velocities, (K + N, 12 F + 2 n).

        In the order of the columns of :class:`Derivatives`.
        """
        gaps, layout = self.gaps, self.layout
        matrix, K = np.zeros((len(gaps) + len(self.rates), 2 * layout.nv)), len(gaps)
        matrix[:K, layout.displacement_columns] = gaps
        matrix[K:, layout.displacement_columns] = self.rates_by_position
        matrix[K:, layout.velocity_columns] = self.rates
        return matrix

    def admissible(self) -> np.ndarray:
        """Projector on what keeps gaps and gap rates, (12 F + 2 n, 12 F + 2 n).

        In the order of the columns of :class:`Derivatives`.
        """
        (basis,) = free_bases([self])
        return basis @ basis.T


def free_bases(motions: Sequence[Motions]) -> list[np.ndarray]:
    """Of each, orthonormal displacements and velocities that keep gaps and rates, (12 F + 2 n, d).

    In the order of the columns of :class:`Derivatives`.
    """
    constraints = np.stack([motion.constraint for motion in motions])
    lengths = np.linalg.norm(constraints, axis=2)
    constraints *= reciprocal_lengths(lengths)[:, :, None]
    if all(motion.independent for motion in motions):
        whole = np.linalg.qr(constraints.transpose(0, 2, 1), mode="complete").Q
        return list(whole[:, :, constraints.shape[1] :])
    return [
        null_space(matrix[np.any(matrix, axis=1)], COUPLED_RANK_TOLERANCE).basis
        for matrix in constraints
    ]


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of an evaluation by a displacement of the state, by torques and by parameters.

    Attributes
    ----------
    evaluation : Evaluation
        What is differentiated.
    matrix : ndarray, shape (R, C)
        All of them.  NaN for forces that the equations leave open.
    rows : mapping str -> slice
        Of the matrix: ``object_acceleration``, ``joint_accelerations``, ``contact_forces`` (arm
        after arm), and the rates of states of effects, ``effect_state_rates``.
    columns : mapping str -> slice
        ``object_pose``, ``object_twist``, ``joint_positions``, ``joint_velocities``, ``torques``,
        ``effect_states``, and with ``parameters`` ``object_wrench``, ``object_mass``,
        ``object_inertia``, ``placements``.
    layout : Layout
    message : str
        What does not exist in this form, and why; else empty.
    """

    evaluation: Evaluation
    matrix: np.ndarray
    rows: Mapping[str, slice]
    columns: Mapping[str, slice]
    layout: Layout
    message: str
    _motions: Callable[[], Motions]

    @cached_property
    def motions(self) -> Motions:
        """Inertia, and which displacements keep the joints closed."""
        return self._motions()

    @property
    def object_acceleration(self) -> Sensitivity:
        """Of the object's acceleration, where there is one, six rows.

        Raises
        ------
        ModelError
            Where there are several.
        """
        return only_object("object_accelerations", self.object_accelerations)

    @cached_property
    def object_accelerations(self) -> Mapping[str, Sensitivity]:
        """Of the accelerations of the objects, by object, six rows each."""
        matrix = self.matrix[self.rows["object_acceleration"]]
        blocks = (matrix[6 * o : 6 * o + 6] for o in range(self.layout.frames))
        return dict(zip(self.layout.objects, map(self._sensitivity, blocks), strict=True))

    @cached_property
    def joint_accelerations(self) -> Mapping[str, Sensitivity]:
        """Of the joint accelerations, by arm."""
        matrix = self.matrix[self.rows["joint_accelerations"]]
        blocks = (matrix[self.layout.tree_joints(i)] for i in range(len(self.layout.names)))
        return dict(zip(self.layout.names, map(self._sensitivity, blocks), strict=True))

    @cached_property
    def base_accelerations(self) -> Mapping[str, Sensitivity]:
        """Of the accelerations of floating bases, by robot, six rows each."""
        blocks = self.layout.split_bases(self.matrix[self.rows["joint_accelerations"]].T)
        return {name: self._sensitivity(block.T) for name, block in blocks.items()}

    @cached_property
    def contact_forces(self) -> Mapping[str, Sensitivity]:
        """Of the contact forces, by arm; those with a floor have the key ``floor``."""
        blocks = rows_by_owner(self.layout, self.matrix[self.rows["contact_forces"]])
        return {owner: self._sensitivity(block) for owner, block in blocks.items()}

    @property
    def effect_state_rates(self) -> Sensitivity:
        """Of the rates of the states of effects, such as the torques of lagging drives."""
        return self._sensitivity(self.matrix[self.rows["effect_state_rates"]])

    def _sensitivity(self, block: np.ndarray) -> Sensitivity:
        return Sensitivity(block, self.layout, self.columns)

    def __repr__(self) -> str:
        rows, columns = self.matrix.shape
        size = f"{count_of(rows, 'row')} by {count_of(columns, 'column')}"
        return f"Derivatives({size}{self.message and '; '}{self.message})"
