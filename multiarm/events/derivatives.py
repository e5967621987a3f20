"""Derivatives of an evaluation of any scene, with or without unilateral contacts."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from multiarm.dynamics import evaluation
from multiarm.dynamics.derivatives import differentiate, differentiate_friction
from multiarm.dynamics.sensitivity import Derivatives, rows_of
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import SolverError
from multiarm.events.evaluation import (
    enter_mode_at,
    in_all_rows,
    unique_forces,
    with_contradictions,
)
from multiarm.events.taking_hold import HeldJoints


def derivatives(
    system: System,
    t: float = 0.0,
    state: State | None = None,
    *,
    closed_loop: bool = True,
    parameters: bool = False,
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
    parameters : bool
        Also with respect to a wrench on the object, its mass and inertia, and placements of the
        contacts on the arms' links.  The control does not know of them.

    Raises
    ------
    ModelError
        When ``system`` is no system, ``t`` no time, or ``state`` none of its states.
    SolverError
        When the state cannot be evaluated, or accelerations are not differentiable there: the rank
        of the constraints changes, or friction leaves the motion open.
    ControlError
        When a Python controller returns something unusable.
    """
    system = require_system(system, "ma.derivatives(system, t, state)")
    t, state = require_time(t), system.checked(state)
    return derivatives_while(None, system, t, state, closed_loop, parameters)


def derivatives_while(
    held: HeldJoints | None,
    system: System,
    t: float,
    state: State,
    closed_loop: bool = True,
    parameters: bool = False,
) -> Derivatives:
    """:func:`derivatives` while some timed joints hold; None: as their times say."""
    with system.borrow() as data:
        if data.model.unilateral is None:
            evaluated = evaluation.evaluate(data, t, state)
            return differentiate(data, evaluated, closed_loop, parameters)
        modes = enter_mode_at(data, t, state, held)
        evaluated = evaluation.evaluate(modes.data, t, state)
        if not modes.data.arrays.solution.motion_unique:
            raise SolverError(
                "derivatives: forces of contacts that slide with friction leave the motion open at "
                "this state; leave out contacts that others make redundant, or friction"
            )
        evaluated = replace(evaluated, _unique=partial(unique_forces, modes))
        of_held_rows = differentiate(modes.data, evaluated, closed_loop, parameters)
        layout, states = data.model.layout, len(of_held_rows.effect_state_rates.matrix)
        rows = rows_of(layout, states)
        matrix = np.zeros((rows["effect_state_rates"].stop, of_held_rows.matrix.shape[1]))
        forces = rows["contact_forces"].start
        solved = np.r_[:forces, forces + modes.data.rows, rows["effect_state_rates"]]
        matrix[solved] = of_held_rows.matrix
        if modes.slides.row.size:
            friction = differentiate_friction(modes.data, modes.slides, of_held_rows)
            for k in range(2):
                matrix[forces + modes.slides.tangent_of_all + k] = friction[:, k]
        return replace(
            of_held_rows,
            evaluation=with_contradictions(modes, in_all_rows(modes, evaluated)),
            matrix=matrix,
            rows=rows,
            layout=layout,
        )
