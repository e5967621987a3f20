"""Accelerations and contact forces at one state, with their residuals.

:func:`evaluate` performs one evaluation of the time loop
(:func:`multiarm.dynamics.equations.evaluate_state`) and returns its results by name, with contact
matrices and the residuals of all three equations, by which a result certifies itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from multiarm.contacts.matrices import ContactTerms, relative_wrenches
from multiarm.contacts.motion_space import (
    MotionSpace,
    joint_selection,
    motion_space,
    motion_space_in_rates,
)
from multiarm.dynamics.contact_forces import uncarried_wrench
from multiarm.dynamics.contact_geometry import (
    constraint_matrix,
    contact_terms,
    place_state,
    points_and_normals,
    relative_motion,
    wrench_rows,
)
from multiarm.dynamics.data import Data
from multiarm.dynamics.diagnosis import lost_motions
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.failures import ambiguity_text, contradiction_text, require_ok
from multiarm.dynamics.forces.internal_forces import InternalForces, decompose, internal_forces
from multiarm.dynamics.layout import TWIST, Layout
from multiarm.dynamics.residuals import write_residuals
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE, PART_TOLERANCE
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver.singular import undetermined_parts
from multiarm.dynamics.solver.solution import Elimination
from multiarm.dynamics.solver_monitor import evaluate_and_check
from multiarm.dynamics.state import State, only_object
from multiarm.dynamics.variables import Check
from multiarm.errors import ModelError
from multiarm.geometry.records import Contact, tangent_rows
from multiarm.notation import numbers
from multiarm.public import facts_html, public_names
from multiarm.scene.faults import unknown
from multiarm.scene.values import of_surroundings

Rows = TypeVar("Rows", np.ndarray, tuple)


@dataclass(frozen=True)
class Residuals:
    """Residuals of the equations of motion (largest magnitudes).

    Attributes
    ----------
    arm : float
        ``M q'' + b - tau - W lambda`` over all arms [N m, N].
    object : float
        ``M_o v_o' - f_o - W_o lambda`` [N, N m].
    constraint : float
        ``W_o^T v_o' + W^T q'' - c`` [m/s^2].
    """

    arm: float
    object: float
    constraint: float


def residuals_of(
    data: Data,
    acceleration: np.ndarray,
    generalised_forces: np.ndarray,
    force: np.ndarray,
    c: np.ndarray,
) -> Residuals:
    """Residuals of accelerations (6 F + n,) and contact forces (N,) at the kinematics in the data.

    ``generalised_forces`` (6 F + n,) and ``c`` (N,) are the right-hand sides.
    """
    write_residuals(data.struct, acceleration, generalised_forces, force, c)
    return _residuals(data.arrays.check)


def _residuals(check: Check) -> Residuals:
    return Residuals(check.block, check.on_object, check.constraint)


class Snapshot:
    """Copies of the arrays of a Data after an evaluation, for results that are computed later.

    It has those of the Data's attributes and arrays that these results need: of a ``regular`` one,
    in which all arms were eliminated as a whole, motion and contacts alone.
    """

    work: Any
    coupled: Any

    def __init__(self, data: Data) -> None:
        self.model, solution = data.model, data.arrays.solution
        self.dense = solution.elimination == Elimination.DENSE
        self.regular = not (self.dense or solution.coupled_blocks)
        self.arrays, b = SimpleNamespace(), data.arrays
        self.arrays.bodies = _copied(b.bodies, ("motion", "objects", "object_inertia"))
        self.arrays.rows = _copied(b.rows, ("kinematics", "parts", "W_o"))
        if not self.regular:
            self.arrays.state = _copied(b.state, ("joint_positions",))
            self.work = _copied(data.work, ("first_contact", "M", "W"))
            self.coupled = _copied(data.coupled, data.coupled._fields)


def _copied(arrays: tuple, names: Sequence[str]) -> SimpleNamespace:
    return SimpleNamespace(**{name: getattr(arrays, name).copy() for name in names})


@dataclass(frozen=True, eq=False)
class ForceDecomposition:
    """Contact forces as what moves the objects and what squeezes them.

    Attributes
    ----------
    moving : mapping connection -> ndarray, shape (N_i,)
        The smallest contact forces with the same resultants [N].  Of the connections of the
        objects, that of an arm by its name.
    squeezing : mapping connection -> ndarray, shape (N_i,)
        The rest, which does not move the objects [N].
    internal : InternalForces
        Basis ``A_o`` over all these contacts, connection after connection.
    coordinates : ndarray, shape (k,)
        ``mu_I`` in that basis.
    resultants : mapping object -> ndarray, shape (6,)
        Of the contact forces: force [N] and moment [N m] about the object's centre of mass, in
        object axes.
    """

    moving: Mapping[str, np.ndarray]
    squeezing: Mapping[str, np.ndarray]
    internal: InternalForces
    coordinates: np.ndarray
    resultants: Mapping[str, np.ndarray]

    @property
    def wrench(self) -> np.ndarray:
        """The resultant on the object, where there is one, shape (6,).

        Raises
        ------
        ModelError
            Where there are several.
        """
        return only_object("resultants", self.resultants)


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """Result of one evaluation.

    Later evaluations do not change it.  Results that take longer than the evaluation itself are
    computed at their first use: geometry of the contacts, which forces are unique, and
    ``lost_motions``.

    Attributes
    ----------
    time : float
    state : State
    object_accelerations : mapping object -> ndarray, shape (6,)
        Acceleration of the centre of mass (classical) and angular acceleration, world axes.
    joint_accelerations, joint_torques : mapping arm or robot -> ndarray, shape (n_i,)
        [rad/s^2, m/s^2]; torques of the drives [N m, N]: those of the control, after limits and
        lag.
    base_accelerations : mapping robot -> ndarray, shape (6,)
        Of robots whose base floats: acceleration of the base frame's origin and angular
        acceleration, world axes.
    control_power : mapping arm -> float
        Power of these torques, the sum of torque times joint velocity [W]; empty without control.
    contact_forces : mapping arm or connection -> ndarray, shape (N_i,)
        Magnitudes [N]; positive pushes the second body of the connection, that of an arm the
        object, along ``contact_normals``.  A robot whose joints have rows of their own, such as
        couplings and stops, has these under its name; those of an arm, or of a finger with one
        connection, follow the contacts of the connection.
    position_residual, velocity_residual : float
        Largest gap [m] and gap rate [m/s].
    residuals : Residuals
    conditioning : mapping arm -> float
        Smallest relative pivot of ``K = W^T M^-1 W``: distance of the arm from a singular posture
        (1 at best, 0 at worst; empty with the dense solver).
    rank : int
        Independent constraints.
    coupled_arms : tuple of str
        Arms that could not be eliminated as a whole: along some of their joint's directions they
        hardly move, or not at all.
    message : str
        Empty when accelerations and forces solve the equations; else the residual and its reason.
    uncarried_wrench : ndarray, shape (6 F,)
        What the contacts cannot put on the F objects of the wrenches that the control commands,
        such as their weight: force [N] and moment [N m] about the centre of mass, world axes.
    effect_state_rates : ndarray, shape (e,)
        Rates of the states of effects, such as the torques of lagging drives, at a run's start.
    contact_states : mapping arm -> tuple of str
        Of unilateral contacts: the state of each ("open", "touching", "sticking", ...).  Contacts
        with a floor have the key ``floor``, here and among forces, wrenches, points and normals.
    contradictions : tuple of str
        Contacts and joints whose gap, force or speed contradicts their state, as no contact mode
        holds at this one: such as a box below the floor.
    """

    time: float
    state: State
    object_accelerations: Mapping[str, np.ndarray]
    joint_accelerations: Mapping[str, np.ndarray]
    base_accelerations: Mapping[str, np.ndarray]
    joint_torques: Mapping[str, np.ndarray]
    control_power: Mapping[str, float]
    contact_forces: Mapping[str, np.ndarray]
    position_residual: float
    velocity_residual: float
    residuals: Residuals
    conditioning: Mapping[str, float]
    rank: int
    coupled_arms: tuple[str, ...]
    message: str
    uncarried_wrench: np.ndarray
    effect_state_rates: np.ndarray
    contact_states: Mapping[str, tuple[str, ...]]
    contradictions: tuple[str, ...]
    _held: Snapshot  # of the contacts of the joints, all closed
    _all: Snapshot  # of all rows that can have forces
    _unique: Callable[[], np.ndarray]
    _lost_motions: Callable[[], Mapping[str, tuple[str, ...]]]
    _joint_forces: Mapping[str, np.ndarray]

    __dir__ = public_names

    def __repr__(self) -> str:
        left = self.residuals
        totals = [np.linalg.norm(wrench[:3]) for wrench in self.wrenches.values()]
        forces = [np.max(np.abs(force), initial=0.0) for force in self.contact_forces.values()]
        return (
            f"Evaluation(time={self.time:g}, rank={self.rank}, forces up to "
            f"{max(totals, default=0.0):.3g} N of a joint, {max(forces, default=0.0):.3g} N at one "
            f"contact,\n  residuals: arm {left.arm:.2g}, object {left.object:.2g}, "
            f"constraint {left.constraint:.2g})"
        )

    def _repr_html_(self) -> str:
        shown = partial(numbers, rounding=1e-6)  # written starts leave small forces
        facts = {
            **{
                f"acceleration of {name} [m/s², rad/s²]": shown(acceleration)
                for name, acceleration in self.object_accelerations.items()
            },
            **{f"wrench of {a} [N, N m]": shown(w) for a, w in self.wrenches.items()},
            **{f"contact forces of {a} [N]": shown(f) for a, f in self.contact_forces.items()},
            "rank": self.rank,
            "residuals": ", ".join(f"{k} {v:.1g}" for k, v in vars(self.residuals).items()),
            "message": self.message,
        }
        return facts_html(f"Evaluation at {self.time:g} s", facts)

    @property
    def object_acceleration(self) -> np.ndarray:
        """That of the object, where there is one, shape (6,).

        Raises
        ------
        ModelError
            Where there are several.
        """
        return only_object("object_accelerations", self.object_accelerations)

    @property
    def accelerations(self) -> np.ndarray:
        """Of objects and all joints, in the order of a state's velocity, shape (6 F + n,)."""
        layout = self.state.layout
        stacked = np.zeros(layout.nv)
        layout.twists(stacked)[:] = [*self.object_accelerations.values()]
        for name, of_joints in layout.split_joints(layout.joint_rates(stacked)).items():
            of_joints[:] = self.joint_accelerations[name]
        of_bases = layout.base_twists(stacked)
        for twist, acceleration in zip(of_bases, self.base_accelerations.values(), strict=True):
            twist[:] = acceleration
        return stacked

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
        """Constraint normals into the second body, world axes, arm -> ndarray, shape (N_i, 3).

        For rows of friction the tangents.
        """
        return rows_by_owner(self._all.model.layout, self._points_and_normals[1])

    @cached_property
    def _points_and_normals(self) -> tuple[np.ndarray, np.ndarray]:
        return points_and_normals(self._all, slice(None))

    @cached_property
    def contact_terms(self) -> Mapping[str, ContactTerms]:
        """Contact matrices of the joints, arm or connection -> ContactTerms."""
        return contact_terms(self._held)

    @cached_property
    def lost_motions(self) -> Mapping[str, tuple[str, ...]]:
        """Motions that the ``coupled_arms`` have lost, in words, arm or robot -> tuple of str."""
        return self._lost_motions()

    @cached_property
    def wrenches(self) -> Mapping[str, np.ndarray]:
        """Resultant of the contact forces of each connection on its second body, (6,) each.

        Force [N] and moment [N m] with friction, world axes; about the object's centre of mass, on
        another body about the origin of the joint's frame there.
        """
        model = self._all.model
        rows = rows_by_owner(model.layout, wrench_rows(self._all))
        return {
            owner: rows[owner].T @ force
            for owner, force in self.contact_forces.items()
            if owner in model.connections or of_surroundings(owner)
        }

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

        Along the contact's two tangents in ``contact_normals``; zero where it has no friction.
        """
        model, forces = self._all.model, {}
        for owner, records in rows_by_owner(model.layout, model.records).items():
            forces[owner] = np.zeros((len(self._normal_rows[owner]), 2))
            tangents = tangent_rows(records)
            for pair, row in zip(forces[owner], self._normal_rows[owner], strict=True):
                for tangent in tangents.get(row, ()):
                    pair[records[tangent].tangent - 1] = self.contact_forces[owner][tangent]
        return forces

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
        object axes; of another connection, named by it, the twist of its first body relative to the
        second one.  ``alpha`` are the rates of the joint's free components (``relative_rates``),
        or the ``rows`` of ``v`` that are named: 0 to 5, slide x ... turn z.

        Raises
        ------
        ModelError
            For an unknown arm.
        GraspError
            When these rates cannot be coordinates; the message lists rows that can.
        """
        model = self._held.model
        relative = relative_motion(model, self.state, arm)
        W, W_dot = relative_wrenches(self.contact_terms[arm], relative)
        if rows is not None:
            return motion_space(W, W_dot, rows)
        return motion_space_in_rates(W, joint_selection(model.frames[arm], relative), W_dot)

    def relative_rates(self, arm: str) -> np.ndarray:
        """Rates ``alpha`` of the free components of an arm's joint, along its own axes, shape (m,).

        [m/s, rad/s]; ``system.frames[arm].labels`` names them.
        """
        model = self._held.model
        relative = relative_motion(model, self.state, arm)
        return joint_selection(model.frames[arm], relative).matrix @ relative.twist

    def internal_forces(
        self,
        form: str = "orthonormal",
        rows: Sequence[int | str] | None = None,
        object: str | None = None,
    ) -> InternalForces:
        """Contact forces that do not move the objects: basis ``A_o`` (thesis, 3.7.3).

        One row a contact, connection after connection, named ``arm/contact``.  ``form`` is
        ``orthonormal``, ``nonnegative`` or ``echelon``; see
        :func:`multiarm.dynamics.forces.internal_forces.internal_forces`.

        With several objects, forces are internal that leave the acceleration of each as it is; with
        the name of an ``object``, forces of the contacts of this one that leave its own, which also
        has what presses between it and the others.

        Raises
        ------
        ModelError
            For an unknown object.
        GraspError
            As the function.
        """
        contacts = self._held.model.contacts
        names = [
            f"{name}/{contacts[name][row].name}"
            for name, rows in self._contacts_of(object).items()
            for row in rows
        ]
        return internal_forces(self._wrench_matrix(object), form, rows, names)

    def force_decomposition(
        self,
        internal: InternalForces | None = None,
        length: float | None = None,
        object: str | None = None,
    ) -> ForceDecomposition:
        """Contact forces as those that move the objects and those that only squeeze them [N].

        Friction is left out, and so are couplings of joints.  ``internal`` is the basis of the
        coordinates, orthonormal when left out.  With ``length``, forces are measured in newtons and
        couples over this lever arm [m]; else multipliers as they are.  ``object`` as in
        :meth:`internal_forces`.

        Raises
        ------
        ModelError
            For an unknown object.
        """
        holding = self._contacts_of(object)
        internal = internal or self.internal_forces(object=object)
        forces = [self._joint_forces[name][rows] for name, rows in holding.items()]
        stacked = np.concatenate([np.zeros(0), *forces])
        parts = decompose(self._wrench_matrix(object), stacked, internal, length)
        bounds = np.cumsum([len(force) for force in forces])[:-1]

        def by_connection(stacked: np.ndarray) -> dict[str, np.ndarray]:
            return dict(zip(holding, np.split(stacked, bounds), strict=False))

        objects = self._held.model.layout.objects if object is None else (object,)
        return ForceDecomposition(
            moving=by_connection(parts.moving),
            squeezing=by_connection(parts.squeezing),
            internal=internal,
            coordinates=parts.coordinates,
            resultants=dict(zip(objects, parts.wrench.reshape(-1, TWIST), strict=True)),
        )

    @property
    def W_o(self) -> np.ndarray:
        """``W_o`` of all contacts of the joints with objects, (6 F, N), in each object's axes.

        Of a joint that acts on another object or the world, its opposite acts on its first body.
        """
        return self._wrench_matrix(None)

    def _wrench_matrix(self, object: str | None) -> np.ndarray:
        """``W_o`` (6 F, N) of all objects, or (6, N) of one and its contacts."""
        model, holding = self._held.model, self._contacts_of(object)
        objects = model.layout.objects if object is None else (object,)
        parts = [np.zeros((TWIST * len(objects), 0))]
        for name, rows in holding.items():
            pair, terms = model.connections[name], self.contact_terms[name]
            directions = np.zeros((len(objects), TWIST, len(rows)))
            for body, wrenches in ((pair.first, terms.W_m), (pair.second, terms.W_o)):
                if body.is_object and body.tip in objects:
                    directions[objects.index(body.tip)] = wrenches[:, rows]
            parts.append(directions.reshape(-1, len(rows)))
        return np.hstack(parts)

    def _contacts_of(self, object: str | None) -> dict[str, list[int]]:
        """The connections of all objects, or of one, with those of their rows that are contacts.

        Raises
        ------
        ModelError
            For an unknown object.
        """
        model, contacts = self._held.model, {}
        if object is not None and object not in model.layout.objects:
            raise ModelError(unknown("object", object, model.layout.objects))
        for name, pair in model.connections.items():
            if object in pair.objects or (object is None and pair.objects):
                rows = enumerate(model.contacts[name])
                contacts[name] = [k for k, record in rows if isinstance(record, Contact)]
        return contacts


def evaluate(data: Data, t: float, state: State) -> Evaluation:
    """Accelerations and contact forces at one state, of a model whose rows are all closed.

    Parameters
    ----------
    data : Data
    t : float
        Time, for the control [s].
    state : State
        It is not projected onto the joints.  Effects with states, such as lagging drives, have
        those of the start of a run.

    Raises
    ------
    SolverError
        When an inertia is not positive definite.
    ControlError
        When a Python controller returns something unusable.
    """
    state = state.copy()
    place_start(data, t, state)
    b, layout = data.arrays, data.model.layout
    require_ok(data, evaluate_and_check(data.struct))
    check = b.check
    a_j, torques, snapshot = b.accelerations.a_j.copy(), b.control.torque.copy(), Snapshot(data)
    forces = layout.split_contacts(b.rows.force.copy())
    coupled = _coupled_arms(data)
    pivots = () if snapshot.dense else data.work.pivot.tolist()
    powers = b.control.power.tolist() if data.model.controlled else ()
    return Evaluation(
        time=float(t),
        state=state,
        object_accelerations=dict(
            zip(layout.objects, layout.twists(b.accelerations.a.copy()), strict=True)
        ),
        joint_accelerations=layout.split_joints(a_j),
        base_accelerations={
            layout.names[i]: a_j[first : first + TWIST]
            for i, first in zip(layout.floating_robots, layout.first_of_bases, strict=True)
        },
        joint_torques=layout.split_joints(torques),
        control_power=dict(zip(layout.names, powers, strict=False)),
        contact_forces=forces,
        position_residual=check.gap,
        velocity_residual=check.gap_rate,
        residuals=_residuals(check),
        conditioning=_conditioning(layout, pivots),
        rank=b.solution.rank,
        coupled_arms=coupled,
        message=ambiguity_text(data) if check.solved else contradiction_text(data),
        uncarried_wrench=uncarried_wrench(data.of_laws),
        effect_state_rates=b.effects.state_rates.copy(),
        contact_states={},
        contradictions=(),
        _held=snapshot,
        _all=snapshot,
        _unique=partial(_unique_forces, snapshot),
        _lost_motions=partial(_lost_motions, snapshot, coupled),
        _joint_forces=forces,
    )


def place_start(data: Data, t: float, state: State) -> None:
    """Place a state as the start of a run, with the states that effects have there."""
    place_state(data, t, state)
    if data.model.effects.states:
        require_ok(data, evaluate_state(data.struct, 0.0, 0.0))
        data.arrays.effects.states[:] = data.effect_states()


def rows_by_owner(layout: Layout, values: Rows) -> dict[str, Rows]:
    """Values of all rows, shape (N, ...), by owner; of the surroundings where they have any."""
    parts = {owner: values[layout.contacts_of(c)] for c, owner in enumerate(layout.owners)}
    return {owner: part for owner, part in parts.items() if len(part) or not of_surroundings(owner)}


def _conditioning(layout: Layout, pivots: Sequence[float]) -> dict[str, float]:
    """The least pivot of each robot, from those of the blocks; empty without."""
    if not pivots:
        return {}
    return {
        name: max(min(pivots[blocks.start : blocks.stop]), 0.0)
        for name, blocks in layout.blocks_by_robot.items()
    }


def _coupled_arms(data: Data) -> tuple[str, ...]:
    """Arms that could not be eliminated as a whole in the last solution."""
    if not data.arrays.solution.coupled_blocks:
        return ()
    coupled, robots = data.arrays.deficient.coupled, data.model.layout.blocks_by_robot
    return tuple(name for name, blocks in robots.items() if np.any(coupled[blocks]))


def _lost_motions(snapshot: Snapshot, arms: Sequence[str]) -> dict[str, tuple[str, ...]]:
    return lost_motions(snapshot, arms) if arms else {}


def _unique_forces(snapshot: Snapshot) -> np.ndarray:
    """Which contact forces are determined: all, when every arm was eliminated as a whole."""
    if snapshot.regular:
        return np.ones(snapshot.model.layout.contacts, dtype=bool)
    if snapshot.dense:
        return null_space(constraint_matrix(snapshot), COUPLED_RANK_TOLERANCE).untouched
    return undetermined_parts(snapshot.work, snapshot.coupled) < PART_TOLERANCE
