"""Evaluations of any scene, with or without unilateral contacts.

The model of a scene with unilateral contacts has all rows that can be closed, and is never solved
as it is: the mode of a state is determined as at the beginning of a run, but without impacts.
:func:`multiarm.dynamics.evaluation.evaluate` solves the equations of that mode; its results are
then scattered to all rows, and the residuals of the equations are those with the friction forces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multiarm.contacts.unilateral import CONTACT
from multiarm.dynamics import evaluation
from multiarm.dynamics.contact_geometry import of_unit_length, scaled_force_directions
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import (
    evaluate_state,
    update_kinematics,
    update_rows,
    write_inertias,
)
from multiarm.dynamics.evaluation import (
    Evaluation,
    Residuals,
    Snapshot,
    residuals_of,
    rows_by_owner,
)
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.guards import forget_forces
from multiarm.dynamics.sliding import friction_of_unit_force
from multiarm.dynamics.solver.bounds import COUPLED_RANK_TOLERANCE
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import SolverError
from multiarm.events.consistent_mode import enter_consistent_mode
from multiarm.events.event_detection import touching_constraints
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.events.taking_hold import HeldJoints, hold_at, hold_placed
from multiarm.events.transition import Participants, Transition

# Speed below which the direction of slip is smoothed [m/s].
SLOW = 1e-9


def evaluate(system: System, t: float = 0.0, state: State | None = None) -> Evaluation:
    """Accelerations and contact forces of a system at one state.

    With unilateral contacts, the result is that of the contacts which are closed at the state:
    ``contact_states`` says what each does, and ``contact_forces`` has all rows, in the order of
    ``system.contacts``, those of open contacts with zeros; ``contact_terms``, motion spaces and
    internal forces are those of all contacts of the joints.

    Joints with times hold at ``t`` as far as times say; one without ``at`` that takes hold within a
    run holds its bodies where they are.

    Parameters
    ----------
    system : System
    t : float
        Time, for the control [s].
    state : State, optional
        The start when left out.  It is evaluated as it is, without projection or impacts.

    Raises
    ------
    ModelError
        When an argument is something else.
    SolverError
        When an inertia is not positive definite, or no motion obeys the contact laws.
    ControlError
        When a Python controller returns something unusable.
    """
    system = require_system(system, "ma.evaluate(system, t, state)")
    t, state = require_time(t), system.checked(state)
    with system.borrow() as data:
        return evaluate_data(data, t, state)


def evaluate_data(data: Data, t: float, state: State) -> Evaluation:
    """:func:`evaluate` with a Data at hand."""
    if data.model.unilateral is None:
        return evaluation.evaluate(data, t, state)
    modes = enter_mode_at(data, t, state)
    return with_contradictions(modes, evaluate_mode(modes, t, state))


def enter_mode_at(data: Data, t: float, state: State, held: HeldJoints | None = None) -> Modes:
    """The modes of a Data, with that of a state entered and evaluated there.

    ``held``: what its timed joints hold; None: as their times say.  Where nothing else opens or
    slides, the mode is not evaluated then.
    """
    modes = modes_of(data, SLOW)
    if held is None:
        hold_at(modes, t, state, modes.unilateral.holding_at(t))
    else:
        hold_placed(modes, held)
        if not modes.unilateral.constraints:
            modes.enter(Mode((), (), holding=modes.holding))
            return modes
    touching, off_patch, _ = touching_constraints(modes, t, state)
    participants = Participants(touching, off_patch=off_patch)
    forget_forces(modes.guards)
    decision = Transition(modes, participants).decide(with_impacts=False)
    decision, holds = enter_consistent_mode(modes, decision)
    if decision.undecided:
        raise SolverError(decision.undecided.message)
    if not holds:  # it is refused where it cannot be evaluated
        require_ok(modes.data, evaluate_state(modes.data.struct, 0.0, 0.0))
    return modes


def modes_of(data: Data, slow: float) -> Modes:
    """The modes of a Data, cached in it."""
    if ("modes", slow) not in data.cache:
        data.cache["modes", slow] = Modes(data, slow)
    return data.cache["modes", slow]


def evaluate_mode(modes: Modes, t: float, state: State) -> Evaluation:
    """The evaluation of the mode that has been entered, in the rows of the whole system."""
    return in_all_rows(modes, evaluation.evaluate(modes.data, t, state))


def with_contradictions(modes: Modes, result: Evaluation) -> Evaluation:
    """An evaluation at the state at which the mode was entered, with what contradicts this mode."""
    names = modes.contradictions
    if not names:
        return result
    other = f"{result.message}; " if result.message else ""
    message = (
        f"{other}no contact mode holds at this state: the gap, the force or the speed of "
        f"{', '.join(names)} contradicts what it does in `contact_states`, for which this is the "
        "solution; correct the state, or take less friction"
    )
    return replace(result, contradictions=names, message=message)


def in_all_rows(modes: Modes, of_held_rows: Evaluation) -> Evaluation:
    """The last evaluation of the mode's data, in the rows of the whole system."""
    full, closed = modes.full, modes.closed
    without_contacts = modes.data.arrays.forces.f.copy()  # kinematics of all rows begin it anew
    forces, unique = _all_forces(modes)
    residuals = _residuals(modes, without_contacts, forces, of_held_rows.residuals.constraint)
    require_ok(closed, update_rows(closed.struct))
    unilateral, layout = modes.unilateral, full.model.layout
    words: dict[str, list[str]] = {}
    for constraint, contact_state in zip(unilateral.constraints, modes.mode.states, strict=True):
        if constraint.kind == CONTACT:
            words.setdefault(constraint.owner, []).append(contact_state.word)
    of_joints = forces[list(unilateral.model)]
    return replace(
        of_held_rows,
        contact_forces=rows_by_owner(layout, forces),
        residuals=residuals,
        contact_states={owner: tuple(states) for owner, states in words.items()},
        _held=Snapshot(closed),
        _all=Snapshot(full),
        _unique=lambda: unique,
        _joint_forces=closed.model.layout.split_contacts(of_joints),
    )


def _all_forces(modes: Modes) -> tuple[np.ndarray, np.ndarray]:
    """Forces of all rows [N], and which of them are unique."""
    count = modes.full.model.layout.contacts
    forces, unique = np.zeros(count), np.ones(count, dtype=bool)
    held, slides, of_held = modes.data.rows, modes.slides, modes.data.arrays.rows.force
    forces[held] = of_held
    require_ok(modes.full, update_kinematics(modes.full.struct))
    write_inertias(modes.full.struct)
    columns = scaled_force_directions(modes.full)
    reactions = columns[:, held]  # of unit forces, with the friction that goes with them
    for s, (row, first) in enumerate(zip(slides.row, slides.tangent_of_all, strict=True)):
        friction = np.array(friction_of_unit_force(slides, s))
        forces[first : first + 2] = friction * of_held[row]
        reactions[:, row] += columns[:, first : first + 2] @ friction
    forces[modes.arrays.springs] = modes.arrays.spring_force
    if held.size:
        unique[held] = null_space(of_unit_length(reactions), COUPLED_RANK_TOLERANCE).untouched
    for row, first in zip(slides.row, slides.tangent_of_all, strict=True):
        unique[first : first + 2] = unique[held[row]]
    return forces, unique


def unique_forces(modes: Modes) -> np.ndarray:
    """Which forces of the held rows are unique, at the last evaluation of the mode's data."""
    _, unique = _all_forces(modes)
    return unique[modes.data.rows]


def _residuals(
    modes: Modes, without_contacts: np.ndarray, forces: np.ndarray, constraint: float
) -> Residuals:
    """Residuals of the equations of motion with the forces of all rows, at their kinematics."""
    full, pushing = modes.full, forces.copy()
    pushing[modes.arrays.springs] = 0.0  # these are among the generalised forces already
    residuals = residuals_of(
        full, modes.data.arrays.accelerations.a, without_contacts, pushing, full.arrays.rows.c
    )
    return replace(residuals, constraint=constraint)  # open contacts move as they like
