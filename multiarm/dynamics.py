"""Accelerations and contact forces at one state, with their own proof.

:func:`evaluate` is one evaluation as the time loop performs it, opened up for people: named
results, contact matrices, and the residuals of all three equations: a result certifies itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from multiarm.contact_checks import place_state, points_and_normals
from multiarm.contacts.internal_forces import InternalForces
from multiarm.contacts.kernel import (
    BODY_WIDTH,
    GAP,
    GAP_BIAS,
    GAP_RATE,
)
from multiarm.contacts.matrices import contact_matrices
from multiarm.contacts.motion_space import MotionSpace
from multiarm.deficiency import lost_motions
from multiarm.dense_call import read_inertia
from multiarm.equations import (
    CONTRADICTION,
    NOT_FINITE,
    OK,
    evaluate_buffers,
    update_kinematics,
)
from multiarm.errors import SolverError
from multiarm.grips import (
    ForceDecomposition,
    force_decomposition_of,
    internal_forces_of,
    motion_space_of,
    relative_rates_of,
)
from multiarm.node.dense import null_space
from multiarm.node.regular import NO_INERTIA
from multiarm.node.singular import ARMS, PART_TOLERANCE, loose_rows
from multiarm.plant import COUPLED_ARMS, IMBALANCE, RANK_OF_ALL, RESIDUAL
from multiarm.solver_watch import believable, note_solution
from multiarm.stabilization import PROJECTION_FAILED, project_velocities
from multiarm.state import State
from multiarm.system import System
from multiarm.terms import ContactTerms


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


@dataclass(frozen=True)
class Evaluation:
    """Result of one evaluation.

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
    contact_forces_unique : mapping arm -> ndarray of bool, shape (N_i,)
        Which of them the equations determine.
    contact_points, contact_normals : mapping arm -> ndarray, shape (N_i, 3)
        World axes; normals point into the object.
    contact_terms : mapping arm -> ContactTerms
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
    lost_motions : mapping arm -> tuple of str
        What these arms cannot do, in words.
    message : str
        Empty when accelerations and forces solve the equations; else what is left over and why.
    contact_states : mapping arm -> tuple of str
        Of contacts that come and go: what each does ("open", "touching", "sticking", ...). Those
        with a floor are named ``floor``, here and among forces, points and normals.
    """

    time: float
    state: State
    object_acceleration: np.ndarray
    joint_accelerations: Mapping[str, np.ndarray]
    joint_torques: Mapping[str, np.ndarray]
    contact_forces: Mapping[str, np.ndarray]
    contact_forces_unique: Mapping[str, np.ndarray]
    contact_points: Mapping[str, np.ndarray]
    contact_normals: Mapping[str, np.ndarray]
    contact_terms: Mapping[str, ContactTerms] = field(repr=False)
    position_residual: float
    velocity_residual: float
    residuals: Residuals
    conditioning: Mapping[str, float]
    rank: int
    coupled_arms: tuple[str, ...]
    lost_motions: Mapping[str, tuple[str, ...]]
    _system: System = field(repr=False, compare=False)
    message: str = ""
    contact_states: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    _joint_forces: Mapping[str, np.ndarray] | None = field(repr=False, default=None)

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
        return motion_space_of(self._system, self.state, self.contact_terms, arm, rows)

    def relative_rates(self, arm: str) -> np.ndarray:
        """Rates ``alpha`` of the free components of an arm's joint, along its own axes, shape (m,).

        [m/s, rad/s]; ``system.frames[arm].labels`` says which they are.
        """
        return relative_rates_of(self._system, self.state, arm)

    def internal_forces(
        self, form: str = "orthonormal", rows: Sequence[int | str] | None = None
    ) -> InternalForces:
        """Contact forces that do not move the object: basis ``A_o`` (thesis, 3.7.3).

        One row a contact, arm after arm.  ``form`` is ``orthonormal``, ``nonnegative`` or
        ``echelon``; see :func:`multiarm.contacts.internal_forces.internal_forces`.
        """
        return internal_forces_of(self._system, self.contact_terms, form, rows)

    def force_decomposition(
        self, internal: InternalForces | None = None, length: float | None = None
    ) -> ForceDecomposition:
        """Contact forces as those that move the object and those that only squeeze it [N].

        The resultant is about the centre of mass, in object axes [N, N m].  ``internal`` is the
        basis of its coordinates ``mu_I``, orthonormal when left out.  Friction has no part in it.
        """
        own = self.contact_forces if self._joint_forces is None else self._joint_forces
        return force_decomposition_of(self._system, self.contact_terms, own, internal, length)


def evaluate(system: System, t: float = 0.0, state: State | None = None) -> Evaluation:
    """Accelerations and contact forces of a system at one state.

    Parameters
    ----------
    system : System
    t : float
        Time, for the control [s].
    state : State, optional
        The start when left out.  It is taken as it is: nothing is projected.  Effects that have
        states of their own, such as lagging drives, are as at the start of a run.

    Raises
    ------
    SolverError
        When an inertia is not positive definite.
    ControlError
        When a Python controller returns something unusable.
    """
    state = system.initial_state() if state is None else state.copy()
    place_state(system, t, state)
    status = evaluate_buffers(system.book(), 0.0, 0.0)
    if status == OK and system.pieces.states:
        system.buffers.inner[:] = system.pieces.start(system)
        status = evaluate_buffers(system.book(), 0.0, 0.0)
    if status != OK:
        try:
            system.reraise()
        except SolverError as error:  # of the dense solver, which knows numbers only
            raise SolverError(lost_contact_text(system) or str(error)) from error
        raise SolverError(failure_text(system, status))
    b, layout = system.buffers, system.layout
    note_solution(system.book())
    forces, torques = b.force.copy(), b.torque.copy()
    object_acceleration, qdd, h_o = b.q_o.copy(), b.qdd.copy(), b.h_o.copy()
    rank, coupled = int(b.solved[RANK_OF_ALL]), _coupled_arms(system)
    solved = believable(system.book(), b.solved[RESIDUAL])
    message = "" if solved else _contradiction_text(system)
    pivots = (
        {}
        if system.plant.dense[0]
        else dict(zip(layout.names, system.work.pivot.copy(), strict=False))
    )
    unique = _unique_forces(system)
    residuals = _residuals(system, h_o, object_acceleration, qdd, forces)
    terms = contact_terms(system)
    b.h_o[:] = h_o  # kinematics alone leave out the loads from outside
    return Evaluation(
        time=float(t),
        state=state,
        object_acceleration=object_acceleration,
        joint_accelerations=layout.split_joints(qdd),
        joint_torques=layout.split_joints(torques),
        contact_forces=layout.split_contacts(forces),
        contact_forces_unique=layout.split_contacts(unique),
        contact_points={arm: term.points for arm, term in terms.items()},
        contact_normals={arm: term.normals for arm, term in terms.items()},
        contact_terms=terms,
        position_residual=float(np.max(np.abs(b.contacts[:, GAP]), initial=0.0)),
        velocity_residual=float(np.max(np.abs(b.contacts[:, GAP_RATE]), initial=0.0)),
        residuals=residuals,
        conditioning={arm: max(float(p), 0.0) for arm, p in pivots.items()},
        rank=rank,
        coupled_arms=coupled,
        lost_motions=lost_motions(system, coupled) if coupled else {},
        _system=system,
        message=message,
    )


def project_velocity(system: System, state: State) -> State:
    """Project the velocities of a state on the constraints, in the inertia metric (thesis, 4.2).

    The correction is the one that loses the least kinetic energy: an inelastic impact that closes
    all gap rates.  Positions stay.
    """
    place_state(system, 0.0, state)
    status = update_kinematics(system.book())
    if status == OK:
        status = project_velocities(system.book())
    if status != OK:
        system.reraise()
        raise SolverError(failure_text(system, status))
    return system.get_state()


def failure_text(system: System, status: int) -> str:
    """What a status of the compiled code means, with the remedy."""
    names = system.arm_names
    lost = lost_contact_text(system)
    if lost:
        return lost
    if 0 <= status < len(names) and system.work.pivot[status] == NO_INERTIA:
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
        return _contradiction_text(system)
    if status == NOT_FINITE:
        return "the state is not finite; take smaller steps, or check the controller"
    return f"the evaluation failed (status {status})"


def _contradiction_text(system: System) -> str:
    residual = float(system.buffers.solved[RESIDUAL])
    if system.buffers.solved[IMBALANCE] >= residual:
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


def lost_contact_text(system: System) -> str:
    """What to say when a contact has no normal at the state in the buffers; else nothing."""
    b = system.buffers
    lost = np.flatnonzero(~np.isfinite(b.contacts).all(axis=1))
    if not lost.size or not (np.isfinite(b.position).all() and np.isfinite(b.angles).all()):
        return ""
    return f"{lost_contact(system, int(lost[0]))}; {_FIND_CONTACT}"


def lost_contact(system: System, row: int) -> str:
    """Say that a contact has no normal at the state in the buffers."""
    arm, contact = system.owner(row)
    return (
        f"contact '{contact.name}' of arm '{arm}' has no normal where it is: an axis, a centre, an "
        f"apex or the end of a surface was reached, or two surfaces lost each other"
    )


def _residuals(
    system: System, h_o: np.ndarray, q_o: np.ndarray, qdd: np.ndarray, force: np.ndarray
) -> Residuals:
    """Put the result back into the equations, with matrices that were not factored."""
    plant, b, work = system.plant, system.buffers, system.work
    h, c = b.h.copy(), b.c.copy()
    update_kinematics(system.book())
    arm = constraint = 0.0
    on_object = b.inertia @ q_o - h_o - b.Wo.T @ force
    for i in range(len(system.arm_names)):
        d = slice(work.dofs[i], work.dofs[i + 1])
        r = slice(work.rows[i], work.rows[i + 1])
        W = work.Y[i, : d.stop - d.start, : r.stop - r.start]
        M = read_inertia(plant.pointers[i], d.stop - d.start)
        arm = max(arm, float(np.max(np.abs(M @ qdd[d] - h[d] - W @ force[r]))))
        gap = b.Wo[r] @ q_o + W.T @ qdd[d] - c[r]
        constraint = max(constraint, float(np.max(np.abs(gap), initial=0.0)))
    return Residuals(arm, float(np.max(np.abs(on_object))), constraint)


def _coupled_arms(system: System) -> tuple[str, ...]:
    """Arms that went through the coupled system in the last solution."""
    if not system.buffers.solved[COUPLED_ARMS]:
        return ()
    deficient = system.coupled.deficient
    return tuple(name for name, is_so in zip(system.arm_names, deficient, strict=False) if is_so)


def _unique_forces(system: System) -> np.ndarray:
    """Which contact forces are determined: all, when every arm's elimination succeeded."""
    if not system.plant.dense[0]:
        if not system.coupled.counts[ARMS]:
            return np.ones(system.constraint_count, dtype=bool)
        return loose_rows(system.work, system.coupled) < PART_TOLERANCE
    update_kinematics(system.book())
    return null_space(constraint_matrix(system)).untouched


def constraint_matrix(system: System) -> np.ndarray:
    """Stacked constraint matrix ``[W_o; W]`` at the kinematics in the buffers, (6 + n, N).

    Columns and rows are scaled so that its singular values can be compared: joint and object
    coordinates by the square root of their inertia, contacts to unit length.
    """
    b, work = system.buffers, system.work
    matrix = np.zeros((6 + system.layout.joints, system.constraint_count))
    scale = np.empty(6 + system.layout.joints)
    matrix[:6] = b.Wo.T
    scale[:6] = np.sqrt(np.diag(b.inertia))
    for i in range(len(system.arm_names)):
        d = slice(work.dofs[i], work.dofs[i + 1])
        r = slice(work.rows[i], work.rows[i + 1])
        n = d.stop - d.start
        matrix[6 + d.start : 6 + d.stop, r] = work.Y[i, :n, : r.stop - r.start]
        scale[6 + d.start : 6 + d.stop] = np.sqrt(
            np.diag(read_inertia(system.plant.pointers[i], n))
        )
    matrix /= scale[:, None]
    return matrix / np.linalg.norm(matrix, axis=0)


def contact_places(system: System, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] and normals into the object of all rows, world axes, shapes (N, 3).

    Rows of all arms, then those of the surroundings: see ``Layout``.  Nothing is solved.

    Raises
    ------
    SolverError
        When a surface of the user's own fails.
    """
    place_state(system, 0.0, state)
    status = update_kinematics(system.book())
    if status != OK:
        system.reraise()
        raise SolverError(failure_text(system, status))
    return points_and_normals(system, slice(None))


def contact_terms(system: System) -> dict[str, ContactTerms]:
    """Contact matrices of every arm at the kinematics in the buffers."""
    b, plant = system.buffers, system.plant
    every_row = np.vstack([b.contacts, b.parts])
    terms = {}
    for i, name in enumerate(system.arm_names):
        rows = slice(system.layout.rows[i], system.layout.rows[i + 1])
        matrices = contact_matrices(
            plant.codes, plant.geometry, every_row, np.arange(rows.start, rows.stop),
            b.arms[i], b.body, _tip_kinematics(system, name, b.arms[i]),
        )  # fmt: skip
        contacts = b.contacts[rows]
        points, normals = points_and_normals(system, rows)
        terms[name] = ContactTerms(
            *matrices,
            c=-contacts[:, GAP_BIAS],
            phi=contacts[:, GAP].copy(),
            phi_dot=contacts[:, GAP_RATE].copy(),
            points=points,
            normals=normals,
        )
    return terms


def _tip_kinematics(system: System, name: str, link: np.ndarray) -> np.ndarray:
    """Kinematics of the tip frame from those of the link it is fixed to, a row of 24."""
    arm = system.arms[name]
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
