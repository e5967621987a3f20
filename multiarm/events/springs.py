"""Compliant contacts that only push: when they do."""

from __future__ import annotations

from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.events.kernels import spring_length
from multiarm.events.modes import GAP_THRESHOLD, OPEN, Choice, Modes


def pressed_constraints(modes: Modes, before: Choice, came: set[int]) -> set[int]:
    """Compliant contacts that push from now on, at the state in the data.

    One that has just come to the end of pushing, or of being apart, is at zero: it does the other
    thing from now on.  ``before`` has no states at the beginning of a run.
    """
    unilateral, pressed = modes.unilateral, set()
    for u, constraint in enumerate(unilateral.constraints):
        if not constraint.compliant:
            continue
        assert unilateral.compliant is not None, "a compliant contact is a spring"
        gap, rate = modes.full.arrays.contacts[constraint.row, [GAP, GAP_RATE]]
        lag = unilateral.compliant.lags[unilateral.compliant.number(constraint.row)]
        length = spring_length(gap, rate, lag)
        pushes = length < 0.0
        if abs(length) <= GAP_THRESHOLD:
            pushes = rate <= 0.0 if not before.states else (before.states[u] == OPEN) == (u in came)
        if pushes:
            pressed.add(u)
    return pressed
