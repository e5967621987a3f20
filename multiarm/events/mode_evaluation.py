"""An evaluation with unilateral constraints: in the mode that follows from the state.

Such a system has all rows that may be held at some time
(:attr:`multiarm.assembly.system.System.unilateral`), and is never solved as it is: which contacts
push, slide, stick or open at a state follows from the state, as it does at the beginning of a run,
but without impacts.  The equations of that mode are solved by
:func:`multiarm.dynamics.evaluation.evaluate`; here its results are spread to all rows, and put into
the equations with the friction forces.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multiarm.assembly.system import System
from multiarm.contacts.unilateral import CONTACT
from multiarm.dynamics import evaluation as dynamics
from multiarm.dynamics.dense_callback import read_inertia
from multiarm.dynamics.equations import OK, evaluate_buffers, update_kinematics, update_rows
from multiarm.dynamics.evaluation import (
    Evaluation,
    Residuals,
    Snapshot,
    constraint_matrix,
    contact_places,
    rows_by_owner,
)
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.errors import SolverError
from multiarm.events.arrays import HELD, TANGENT_OF_ALL, THRESHOLD
from multiarm.events.beginning import touching_constraints
from multiarm.events.kernels import start_guards
from multiarm.events.modes import STATE_NAMES, Mode, Modes
from multiarm.events.selection import held_model
from multiarm.events.transition import Transition

# Slip slower than this has hardly a direction of its own [m/s].
SLOW = 1e-9


def evaluate_mode(system: System, t: float, state: State) -> Evaluation:
    """Accelerations and forces of a system with unilateral constraints, at one state.

    See :func:`multiarm.events.evaluation.evaluate`.
    """
    modes = Modes(system, SLOW)
    return _spread(modes, _standing(modes, t, state), t, state)


def standing_mode(system: System, t: float, state: State) -> Mode:
    """The mode that a state of a system asks for, evaluated there.

    Its ``system`` is valid as long as the mode lives.
    """
    return _standing(Modes(system, SLOW), t, state)


def _standing(modes: Modes, t: float, state: State) -> Mode:
    touching, beside, _ = touching_constraints(modes, t, state)
    decision = Transition(modes, touching, 0.0, beside=beside).stay()
    if decision.trouble:
        raise SolverError(decision.trouble)
    mode = modes.enter(decision.choice, decision.directions)
    if evaluate_buffers(mode.system.struct(), 0.0, 0.0) != OK:
        mode.system.reraise()
    start_guards(mode.system.struct())
    if np.any(mode.arrays.values < -mode.arrays.levels[:, THRESHOLD]):
        mode.set_prestress(decision.forces)  # least forces do not obey the laws, but others do
    return mode


def _spread(modes: Modes, mode: Mode, t: float, state: State) -> Evaluation:
    """The evaluation of a mode, in the rows of the whole system."""
    full, model = modes.full, held_model(modes.full)
    own = dynamics.evaluate(mode.system, t, state)
    forces, unique = _all_forces(full, mode)
    residuals = _residuals(full, mode, forces, own.residuals.constraint)
    contact_places(full, state)
    update_rows(model.struct())
    unilateral = modes.unilateral
    doing: dict[str, list[str]] = {}
    for constraint, does in zip(unilateral.constraints, mode.choice.states, strict=True):
        if constraint.kind == CONTACT:
            doing.setdefault(constraint.arm, []).append(STATE_NAMES[does])
    return replace(
        own,
        state=state,
        contact_forces=rows_by_owner(full.layout, forces),
        residuals=residuals,
        contact_states={owner: tuple(words) for owner, words in doing.items()},
        _held=Snapshot(model),
        _all=Snapshot(full),
        _unique=lambda: unique,
        _joint_forces=model.layout.split_contacts(forces[list(unilateral.model)]),
    )


def _all_forces(full: System, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Forces of all rows [N], and which of them are determined."""
    forces, unique = np.zeros(full.constraint_count), np.ones(full.constraint_count, dtype=bool)
    arrays, own = mode.arrays, mode.system.buffers.force
    forces[arrays.held] = own
    columns = _columns(full)
    reactions = columns[:, arrays.held]
    for s, slide in enumerate(arrays.slides):
        first, drag = slide[TANGENT_OF_ALL], -arrays.slide_mu[s] * arrays.turning[s]
        forces[first : first + 2] = drag * own[slide[HELD]]
        reactions[:, slide[HELD]] += columns[:, first : first + 2] @ drag
    forces[arrays.springs] = arrays.spring_force
    if arrays.held.size:
        unique[arrays.held] = null_space(reactions).untouched
    for slide in arrays.slides:
        first = slide[TANGENT_OF_ALL]
        unique[first : first + 2] = unique[arrays.held[slide[HELD]]]
    return forces, unique


def _columns(full: System) -> np.ndarray:
    """``[W_o; W]`` of all rows at the state in the buffers, shape (6 + n, N), as for a rank.

    Coordinates are scaled by the square root of their inertia, rows to unit length.
    """
    update_kinematics(full.struct())
    return constraint_matrix(full)


def _residuals(full: System, mode: Mode, forces: np.ndarray, constraint: float) -> Residuals:
    """Put forces of all rows into the equations of motion."""
    b, work = mode.system.buffers, full.work
    if evaluate_buffers(mode.system.struct(), 0.0, 0.0) != OK:
        mode.system.reraise()
    q_o, qdd, h, h_o = b.q_o.copy(), b.qdd.copy(), b.h.copy(), b.h_o.copy()
    update_kinematics(full.struct())
    pushing = forces.copy()
    pushing[mode.arrays.springs] = 0.0  # effects have their part in h and h_o
    arm = 0.0
    for i in range(len(full.arm_names)):
        d = slice(work.dofs[i], work.dofs[i + 1])
        r = slice(work.rows[i], work.rows[i + 1])
        W = work.Y[i, : d.stop - d.start, : r.stop - r.start]
        M = read_inertia(full.plant.pointers[i], d.stop - d.start)
        arm = max(arm, float(np.max(np.abs(M @ qdd[d] - h[d] - W @ pushing[r]))))
    on_object = b.inertia @ q_o - h_o - full.buffers.Wo.T @ pushing
    return Residuals(arm, float(np.max(np.abs(on_object))), constraint)
