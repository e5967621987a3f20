"""Claims about what constraints do by the forces of their problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multiarm.contacts.unilateral import CONTACT, Constraint
from multiarm.events.complementarity import ContactMode, Friction, Push, solve
from multiarm.events.states_by_forces import StatesByForces
from multiarm.results.contact_states import ContactState

NORMAL, ALWAYS_HELD = 0, 3


@pytest.mark.parametrize(
    ("dependent", "state", "held"),
    [(True, ContactState.RESTING, []), (False, ContactState.TOUCHING, [NORMAL])],
)
def test_a_contact_is_held_only_if_the_rows_that_always_are_do_not_keep_it_closed(
    dependent, state, held
):
    """One bilateral contact without a force, and a row that is held in any mode.

    The contact cannot open where this row moves exactly as its gap does.
    """
    jacobian = np.eye(4)
    if dependent:
        jacobian[ALWAYS_HELD] = jacobian[NORMAL]
    contact = Constraint(CONTACT, "left", "left", row=10, tangents=(11, 12), mu=0.5, bilateral=True)
    solution = replace(
        solve(np.eye(4), np.zeros(4), [Friction(NORMAL, (1, 2), 0.5), Push(ALWAYS_HELD)]),
        modes=(ContactMode.RESTING, ContactMode.CLOSED),
        active_rows=(ALWAYS_HELD,),
        forces_unique=not dependent,
    )
    rows = {10: NORMAL, 11: 1, 12: 2}
    by_forces = StatesByForces({5: contact}, rows, solution, jacobian @ jacobian.T, {})
    by_forces.keep_closed(set())
    assert by_forces.states == {5: state}
    assert by_forces.held == held
