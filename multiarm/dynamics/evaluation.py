"""Accelerations and contact forces at one state, with their own proof.

:func:`evaluate` is one evaluation as the time loop performs it, opened up for people: named
results, contact matrices, and the residuals of all three equations: a result certifies itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from multiarm.contacts.internal_forces import InternalForces
from multiarm.contacts.kernel import BODY_WIDTH, GAP, GAP_BIAS, GAP_RATE
from multiarm.contacts.matrices import ContactTerms, contact_matrices
from multiarm.contacts.motion_space import MotionSpace
from multiarm.contacts.records import Contact
from multiarm.contacts.unilateral import SURROUNDINGS
from multiarm.dynamics.arrays import CONTRADICTION, NOT_FINITE, OK, PROJECTION_FAILED, Variables
from multiarm.dynamics.contact_analysis import (
    ForceDecomposition,
    force_decomposition_of,
    internal_forces_of,
    motion_space_of,
    relative_rates_of,
)
from multiarm.dynamics.contact_geometry import place_state, points_and_normals
from multiarm.dynamics.equations import evaluate_state, update_kinematics
from multiarm.dynamics.model import Data, Evaluated
from multiarm.dynamics.rank_diagnosis import lost_motions
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver.regular import NO_INERTIA
from multiarm.dynamics.solver.singular import PART_TOLERANCE, CoupledWork, loose_rows
from multiarm.dynamics.solver.work import NodeWork
from multiarm.dynamics.solver_monitor import evaluate_and_check
from multiarm.dynamics.state import Layout, State
from multiarm.errors import SolverError

Rows = TypeVar("Rows", np.ndarray, tuple)
Arrays = TypeVar("Arrays", Variables, NodeWork, CoupledWork)


@dataclass(frozen=True)
class Residuals:
    """What is left over when the result is put back into the equations (largest magnitude).

    Attributes
    ----------
    arm : float
        ``M q'' + b - tau - W lambda`` over all arms [N m, N].
    object : float
        ``M_o v_o' - h_o - W_o lambda`` [N, N m].
    constraint : float
        ``W_o^T v_o' + W^T q'' - c`` [m/s^2].
    """

    arm: float
    object: float
    constraint: float


# Variables that are copied for what is computed later: for all evaluations, and where some arm
# could not be eliminated as a whole, or the dense solver was used.
_MOTION = ("arms", "body", "contacts", "parts", "Wo")
_COORDINATES = ("angles", "inertia")


class Snapshot:
    """Copies of what an evaluation left in a Data, for results that are computed later.

    It is read like the Data itself, as before the arms were eliminated.  Of a ``regular`` one, in
    which all arms were eliminated as a whole, only motion and contacts are copied.

    Attributes
    ----------
    model : Model
    arrays, work, coupled : Variables, NodeWork, CoupledWork
        Arrays that are not copied go on to other states.
    regular : bool
    """

    def __init__(self, data: Data) -> None:
        self.model = data.model
        self.regular = not (data.model.constants.dense or data.coupled.status.arms)
        self.arrays = _copied(data.arrays, _MOTION if self.regular else _MOTION + _COORDINATES)
        self.work, self.coupled = data.work, data.coupled
        if not self.regular:
            self.work = _copied(data.work, ("L", "Y"))
            self.coupled = _copied(data.coupled, data.coupled._fields)


def _copied(arrays: Arrays, names: Sequence[str]) -> Arrays:
    return arrays._replace(**{name: getattr(arrays, name).copy() for name in names})


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Result of one evaluation.

    It stays as it is, whatever the system is used for afterwards.  What takes longer than the
    evaluation itself is computed when it is first asked for: what the contacts look like, which
    forces are unique, and ``lost_motions``.

    Attributes
    ----------
    time : float
    state : State
    object_acceleration : ndarray, shape (6,)
        Acceleration of the centre of mass (classical) and angular acceleration, world axes.
    joint_accelerations, joint_torques : mapping arm -> ndarray, shape (n_i,)
        [rad/s^2, m/s^2]; torques of the drives [N m, N]: what the control wants, or what their
        limits and lag leave of it.
    contact_forces : mapping arm -> ndarray, shape (N_i,)
        Magnitudes [N]; positive pushes the object along ``contact_normals``.
    position_residual, velocity_residual : float
        Largest gap [m] and gap rate [m/s].
    residuals : Residuals
    conditioning : mapping arm -> float
        Smallest relative pivot of ``K = W^T M^-1 W``: how far the arm is from a singular posture
        (1 at best, 0 at worst; empty with the dense solver).
    rank : int
        Independent constraints.
    coupled_arms : tuple of str
        Arms that could not be eliminated as a whole: along some of their joint's directions they
        hardly move, or not at all.
    message : str
        Empty when accelerations and forces solve the equations; else what is left over and why.
    contact_states : mapping arm -> tuple of str
        Of contacts that come and go: what each does ("open", "touching", "sticking", ...).  Those
        with a floor are named ``floor``, here and among forces, wrenches, points and normals.
    """

    time: float
    state: State
    object_acceleration: np.ndarray
    joint_accelerations: Mapping[str, np.ndarray]
    joint_torques: Mapping[str, np.ndarray]
    contact_forces: Mapping[str, np.ndarray]
    position_residual: float
    velocity_residual: float
    residuals: Residuals
    conditioning: Mapping[str, float]
    rank: int
    coupled_arms: tuple[str, ...]
    message: str
    contact_states: Mapping[str, tuple[str, ...]]
    _held: Snapshot  # of the contacts that joints hold
    _all: Snapshot  # of all rows that have forces: others where contacts come and go
    _unique: Callable[[], np.ndarray]
    _lost_motions: Callable[[], Mapping[str, tuple[str, ...]]]
    _joint_forces: Mapping[str, np.ndarray]

    def __repr__(self) -> str:
        left = self.residuals
        forces = [np.max(np.abs(own), initial=0.0) for own in self.contact_forces.values()]
        return (
            f"Evaluation(time={self.time:g}, rank={self.rank}, largest contact force "
            f"{max(forces, default=0.0):.3g} N,\n  residuals: arm {left.arm:.2g}, "
            f"object {left.object:.2g}, constraint {left.constraint:.2g})"
        )

    @cached_property
    def contact_forces_unique(self) -> Mapping[str, np.ndarray]:
        """Which contact forces the equations determine, arm -> ndarray of bool, shape (N_i,)."""
        return rows_by_owner(self._all.model.layout, self._unique())

    @cached_property
    def contact_points(self) -> Mapping[str, np.ndarray]:
        """Contact points [m], world axes, arm -> ndarray, shape (N_i, 3)."""
        return rows_by_owner(self._all.model.layout, self._points_and_normals[0])

    @cached_property
    def contact_normals(self) -> Mapping[str, np.ndarray]:
        """Unit normals into the object, world axes, arm -> ndarray, shape (N_i, 3).

        Of rows of friction, the tangents.
        """
        return rows_by_owner(self._all.model.layout, self._points_and_normals[1])

    @cached_property
    def _points_and_normals(self) -> tuple[np.ndarray, np.ndarray]:
        return points_and_normals(self._all, slice(None))

    @cached_property
    def contact_terms(self) -> Mapping[str, ContactTerms]:
        """Contact matrices of the joints, arm -> ContactTerms."""
        return contact_terms(self._held)

    @cached_property
    def lost_motions(self) -> Mapping[str, tuple[str, ...]]:
        """What the ``coupled_arms`` cannot do, in words, arm -> tuple of str."""
        return self._lost_motions()

    @cached_property
    def wrenches(self) -> Mapping[str, np.ndarray]:
        """What the contact forces of each arm add up to on the object, arm -> ndarray, shape (6,).

        Force [N] and moment [N m] about the object's centre of mass, world axes, with friction.
        """
        rows = rows_by_owner(self._all.model.layout, self._all.arrays.Wo)
        return {owner: rows[owner].T @ force for owner, force in self.contact_forces.items()}

    @cached_property
    def normal_forces(self) -> Mapping[str, np.ndarray]:
        """Forces of the contacts along their normals [N], arm -> ndarray, shape (k,).

        One a contact: those of ``contact_forces`` without friction and without the rows that belong
        to the arm's own joints.
        """
        rows = self._normal_rows
        return {owner: force[rows[owner]] for owner, force in self.contact_forces.items()}

    @cached_property
    def tangential_forces(self) -> Mapping[str, np.ndarray]:
        """Friction forces of the contacts in ``normal_forces`` [N], arm -> ndarray, shape (k, 2).

        Along the two tangents that follow the contact's normal in ``contact_normals``; zero where a
        contact has no friction.
        """
        model, found = self._all.model, {}
        for owner, records in rows_by_owner(model.layout, model.records).items():
            found[owner] = np.zeros((len(self._normal_rows[owner]), 2))
            for pair, row in zip(found[owner], self._normal_rows[owner], strict=True):
                if any(record.tangent for record in records[row + 1 : row + 2]):
                    pair[:] = self.contact_forces[owner][row + 1 : row + 3]
        return found

    @cached_property
    def _normal_rows(self) -> dict[str, list[int]]:
        """Rows of each owner that are contacts along their normals."""
        model = self._all.model
        return {
            owner: [
                row
                for row, record in enumerate(records)
                if isinstance(record, Contact) and not record.tangent
            ]
            for owner, records in rows_by_owner(model.layout, model.records).items()
        }

    def motion_space(self, arm: str, rows: Sequence[int | str] | None = None) -> MotionSpace:
        """Motions that an arm's joint leaves free, ``v = T alpha``, and ``dT/dt`` (thesis, 3.8).

        ``v`` is the twist of the arm's tip frame relative to the object, at the tip's origin and in
        object axes.  ``alpha`` are the rates of the joint's free components (``relative_rates``),
        or the ``rows`` of ``v`` that are named: 0 to 5, slide x ... turn z.

        Raises
        ------
        ModelError
            For an unknown arm.
        GraspError
            When these rates cannot be coordinates; the message lists rows that can.
        """
        return motion_space_of(self._held.model, self.state, self.contact_terms, arm, rows)

    def relative_rates(self, arm: str) -> np.ndarray:
        """Rates ``alpha`` of the free components of an arm's joint, along its own axes, shape (m,).

        [m/s, rad/s]; ``data.model.frames[arm].labels`` says which they are.
        """
        return relative_rates_of(self._held.model, self.state, arm)

    def internal_forces(
        self, form: str = "orthonormal", rows: Sequence[int | str] | None = None
    ) -> InternalForces:
        """Contact forces that do not move the object: basis ``A_o`` (thesis, 3.7.3).

        One row a contact, arm after arm.  ``form`` is ``orthonormal``, ``nonnegative`` or
        ``echelon``; see :func:`multiarm.contacts.internal_forces.internal_forces`.
        """
        return internal_forces_of(self._held.model, self.contact_terms, form, rows)

    def force_decomposition(
        self, internal: InternalForces | None = None, length: float | None = None
    ) -> ForceDecomposition:
        """Contact forces as those that move the object and those that only squeeze it [N].

        The resultant is about the centre of mass, in object axes [N, N m].  ``internal`` is the
        basis of its coordinates ``mu_I``, orthonormal when left out.  Friction has no part in it.
        """
        return force_decomposition_of(
            self._held.model, self.contact_terms, self._joint_forces, internal, length
        )


def evaluate(data: Data, t: float, state: State) -> Evaluation:
    """Accelerations and contact forces at one state, of a model whose rows are all closed.

    Parameters
    ----------
    data : Data
    t : float
        Time, for the control [s].
    state : State
        Taken as it is: nothing is projected.  Effects that have states of their own, such as
        lagging drives, are as at the start of a run.

    Raises
    ------
    SolverError
        When an inertia is not positive definite.
    ControlError
        When a Python controller returns something unusable.
    """
    state = state.copy()
    place_state(data, t, state)
    b, layout, status, found = data.arrays, data.model.layout, OK, np.empty(6)
    if data.model.effects.states:
        status = evaluate_state(data.struct, 0.0, 0.0)
        if status == OK:
            b.inner[:] = data.effect_states()
    if status == OK:
        status = evaluate_and_check(data.struct, found)
    if status != OK:
        try:
            data.reraise()
        except SolverError as error:  # of the dense solver, which knows numbers only
            raise SolverError(lost_contact_text(data) or str(error)) from error
        raise SolverError(failure_text(data, status))
    arm, on_object, constraint, gap, gap_rate, solved = found.tolist()
    qdd, torques, snapshot = b.qdd.copy(), b.torque.copy(), Snapshot(data)
    forces = layout.split_contacts(b.force.copy())
    coupled = _coupled_arms(data)
    pivots = () if data.model.constants.dense else data.work.pivot.tolist()
    return Evaluation(
        time=float(t),
        state=state,
        object_acceleration=b.q_o.copy(),
        joint_accelerations=layout.split_joints(qdd),
        joint_torques=layout.split_joints(torques),
        contact_forces=forces,
        position_residual=gap,
        velocity_residual=gap_rate,
        residuals=Residuals(arm, on_object, constraint),
        conditioning={
            name: max(pivot, 0.0) for name, pivot in zip(layout.names, pivots, strict=False)
        },
        rank=b.status.rank,
        coupled_arms=coupled,
        message="" if solved else _contradiction_text(data),
        contact_states={},
        _held=snapshot,
        _all=snapshot,
        _unique=partial(_unique_forces, snapshot),
        _lost_motions=partial(_lost_motions, snapshot, coupled),
        _joint_forces=forces,
    )


def rows_by_owner(layout: Layout, values: Rows) -> dict[str, Rows]:
    """Values of all rows, shape (N, ...), by arm, and of the surroundings where there are any."""
    bounds, around = layout.rows, values[layout.surroundings]
    found = {arm: values[bounds[i] : bounds[i + 1]] for i, arm in enumerate(layout.names)}
    return {**found, SURROUNDINGS: around} if len(around) else found


def failure_text(data: Data, status: int) -> str:
    """What a status of the compiled code means, with the remedy."""
    names = data.model.arm_names
    lost = lost_contact_text(data)
    if lost:
        return lost
    if 0 <= status < len(names) and data.work.pivot[status] == NO_INERTIA:
        return (
            f"the inertia matrix of arm '{names[status]}' is not positive definite: a joint moves "
            f"links without mass or inertia; give them some in the URDF, or lock the joint"
        )
    if status == len(names):
        return (
            "the object's node matrix is not positive definite; check the object's mass and "
            "inertia and that all numbers of the state are finite"
        )
    if status == PROJECTION_FAILED:
        return (
            "the state could not be projected back onto the joints; take smaller steps (a smaller "
            "`accuracy` or `step`), or look for a motion that the joints cannot follow"
        )
    if status == CONTRADICTION:
        return _contradiction_text(data)
    if status == NOT_FINITE:
        return "the state is not finite; take smaller steps, or check the controller"
    return f"the evaluation failed (status {status})"


def _contradiction_text(data: Data) -> str:
    residual = float(data.arrays.status.residual)
    if data.arrays.status.imbalance >= residual:
        return (
            f"the contact forces do not balance the object (relative residual {residual:.2g}): too "
            f"few digits determine them next to a posture in which arms cannot move; start "
            f"elsewhere, or use `solver: dense`"
        )
    return (
        f"no acceleration meets all constraints (relative residual {residual:.2g}): some of them "
        f"contradict each other, or the chains have come to where they lose a direction with a "
        f"velocity that fits none of the ways on, and the motion is undetermined; take smaller "
        f"steps, start elsewhere, or mend contacts that say the same twice"
    )


_FIND_CONTACT = (
    "look where the motion takes it, take smaller steps, or choose a surface that goes on there"
)


def lost_contact_text(data: Data) -> str:
    """What to say when a contact has no normal at the state in the data; else nothing."""
    b = data.arrays
    lost = np.flatnonzero(~np.isfinite(b.contacts).all(axis=1))
    if not lost.size or not (np.isfinite(b.position).all() and np.isfinite(b.angles).all()):
        return ""
    return f"{lost_contact(data, int(lost[0]))}; {_FIND_CONTACT}"


def lost_contact(data: Data, row: int) -> str:
    """Say that a contact has no normal at the state in the data."""
    arm, contact = data.model.owner(row)
    return (
        f"contact '{contact.name}' of arm '{arm}' has no normal where it is: an axis, a centre, an "
        f"apex or the end of a surface was reached, or two surfaces lost each other"
    )


def _coupled_arms(data: Data) -> tuple[str, ...]:
    """Arms that went through the coupled system in the last solution."""
    if not data.arrays.status.coupled_arms:
        return ()
    deficient = data.coupled.deficient
    return tuple(
        name for name, is_so in zip(data.model.arm_names, deficient, strict=False) if is_so
    )


def _lost_motions(snapshot: Snapshot, arms: Sequence[str]) -> dict[str, tuple[str, ...]]:
    return lost_motions(snapshot, arms) if arms else {}


def _unique_forces(snapshot: Snapshot) -> np.ndarray:
    """Which contact forces are determined: all, when every arm's elimination succeeded."""
    if snapshot.regular:
        return np.ones(snapshot.model.layout.contacts, dtype=bool)
    if snapshot.model.constants.dense:
        return null_space(constraint_matrix(snapshot)).untouched
    return loose_rows(snapshot.work, snapshot.coupled) < PART_TOLERANCE


def constraint_matrix(data: Evaluated) -> np.ndarray:
    """Stacked constraint matrix ``[W_o; W]`` at the kinematics in the data, (6 + n, N).

    Columns and rows are scaled so that its singular values can be compared: joint and object
    coordinates by the square root of their inertia, contacts to unit length.
    """
    b, work = data.arrays, data.work
    matrix = np.zeros((6 + data.model.layout.joints, data.model.layout.contacts))
    scale = np.empty(6 + data.model.layout.joints)
    matrix[:6] = b.Wo.T
    scale[:6] = np.sqrt(np.diag(b.inertia))
    for i in range(len(data.model.arm_names)):
        d = slice(work.dofs[i], work.dofs[i + 1])
        r = slice(work.rows[i], work.rows[i + 1])
        n = d.stop - d.start
        matrix[6 + d.start : 6 + d.stop, r] = work.Y[i, :n, : r.stop - r.start]
        scale[6 + d.start : 6 + d.stop] = np.sqrt(np.diag(work.L[i])[:n])
    matrix /= scale[:, None]
    return matrix / np.linalg.norm(matrix, axis=0)


def contact_places(data: Data, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and normals into the object of all rows, world axes, shapes (N, 3).

    Rows of all arms, then those of the surroundings: see ``Layout``.  Nothing is solved.

    Raises
    ------
    SolverError
        When a surface of the user's own fails.
    """
    place_state(data, 0.0, state)
    status = update_kinematics(data.struct)
    if status != OK:
        data.reraise()
        raise SolverError(failure_text(data, status))
    return points_and_normals(data, slice(None))


def contact_terms(data: Evaluated) -> dict[str, ContactTerms]:
    """Contact matrices of every arm at the kinematics in the data."""
    b, constants = data.arrays, data.model.constants
    every_row = np.vstack([b.contacts, b.parts])
    terms = {}
    for i, name in enumerate(data.model.arm_names):
        rows = slice(data.model.layout.rows[i], data.model.layout.rows[i + 1])
        matrices = contact_matrices(
            constants.codes, constants.geometry, every_row, np.arange(rows.start, rows.stop),
            b.arms[i], b.body, _tip_kinematics(data, name, b.arms[i]),
        )  # fmt: skip
        contacts = b.contacts[rows]
        points, normals = points_and_normals(data, rows)
        terms[name] = ContactTerms(
            *matrices,
            c=-contacts[:, GAP_BIAS],
            phi=contacts[:, GAP].copy(),
            phi_dot=contacts[:, GAP_RATE].copy(),
            points=points,
            normals=normals,
        )
    return terms


def _tip_kinematics(data: Evaluated, name: str, link: np.ndarray) -> np.ndarray:
    """Kinematics of the tip frame from those of the link it is fixed to, a row of 24."""
    arm = data.model.arms[name]
    tip = np.zeros(BODY_WIDTH)
    rotation = link[:9].reshape(3, 3)
    offset = rotation @ arm.tip_translation
    omega, alpha = link[15:18], link[21:24]
    tip[:9] = (rotation @ arm.tip_rotation).ravel()
    tip[9:12] = link[9:12] + offset
    tip[12:15] = link[12:15] + np.cross(omega, offset)
    tip[15:18] = omega
    tip[18:21] = link[18:21] + np.cross(alpha, offset) + np.cross(omega, np.cross(omega, offset))
    tip[21:24] = alpha
    return tip
