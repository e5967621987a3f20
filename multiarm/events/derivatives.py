"""Derivatives of an evaluation of any scene, with or without unilateral contacts."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics import evaluation
from multiarm.dynamics.derivatives import Derivatives, differentiate
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import SolverError
from multiarm.events.evaluation import evaluate_mode, mode_at


def derivatives(
    system: System, t: float = 0.0, state: State | None = None, *, closed_loop: bool = True
) -> Derivatives:
    """Differentiate accelerations and contact forces with respect to state and torques.

    By implicit differentiation of the equations of motion (:mod:`multiarm.dynamics.derivatives`),
    exact to about 1e-10 of the largest term.  With unilateral contacts, those that are closed at
    the state stay closed, and the forces of open ones are zero.

    >>> D = ma.derivatives(system)
    >>> D.joint_accelerations["left"].d_torques["right"]

    Parameters
    ----------
    system : System
    t : float
        Time, for control and loads [s].
    state : State, optional
        The start when left out.  It need not satisfy the joints.
    closed_loop : bool
        The control's torques depend on the state; False: they are held.

    Raises
    ------
    ModelError
        When ``system`` is no system, ``t`` no time, or ``state`` none of its states.
    SolverError
        When the state cannot be evaluated, or accelerations are not differentiable there: the rank
        of the constraints changes, or contacts slide with friction.
    ControlError
        When a Python controller returns something unusable.
    """
    system = require_system(system, "ma.derivatives(system, t, state)")
    t, state = require_time(t), system.checked(state)
    with system.borrow() as data:
        if data.model.unilateral is None:
            return differentiate(data, evaluation.evaluate(data, t, state), closed_loop)
        mode = mode_at(data, t, state)
        if len(mode.arrays.slides):
            raise SolverError(
                "derivatives: contacts slide with friction at this state, whose direction turns "
                "with the slip; take a state where they stick, or leave friction out"
            )
        own = differentiate(mode.data, evaluation.evaluate(mode.data, t, state), closed_loop)
        layout, moving = data.model.layout, 6 + data.model.layout.joints
        rows = moving + layout.contacts
        held = np.concatenate([np.arange(moving), moving + mode.arrays.held])
        states = np.arange(rows, rows + len(own.effect_state_rates.matrix))
        scattered = np.zeros((rows + len(states), own.matrix.shape[1]))
        scattered[np.concatenate([held, states])] = own.matrix
        found = evaluate_mode(data, mode, t, state)
        return Derivatives(found, scattered, layout, own.message, own.motions)
