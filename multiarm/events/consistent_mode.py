"""A mode that its own guards do not contradict at once.

At the instant at which a bound is reached several modes solve the contact laws, and forces of
minimum norm may contradict a mode that other forces of the same motion obey.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.status import OK
from multiarm.events.kernels import start_guards
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.events.transition import Decision

# Where a mode is contradicted, it is decided again these parts of the longest step later.
LATER = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)


def enter_consistent_mode(
    modes: Modes,
    decide: Callable[[float], Decision],
    longest_step: float = 0.0,
    ended: Mode | None = None,
) -> tuple[Decision, bool]:
    """Decide, and enter a mode; with whether it holds.

    Parameters
    ----------
    modes : Modes
    decide : callable
        The decision with the accelerations of a time ahead [s].
    longest_step : float
        That led to an event [s]; 0: a state that no motion has led to.
    ended : Mode, optional
        The one that has just ended: it would come to the same event with the same forces.

    Returns
    -------
    decision : Decision
        No mode has been entered where it is undecided.  Where no mode holds: that of the instant.
    holds : bool
    """
    decisions: list[Decision] = []
    for ahead in (0.0, *(share * longest_step for share in LATER if longest_step > 0.0)):
        decision = decide(ahead)
        if decision.undecided:  # later on, the displaced contacts may contradict each other
            break
        if decisions:
            first = decisions[0]
            decision = replace(decision, hits=first.hits, energy=first.energy, rested=first.rested)
        decisions.append(decision)
        modes.enter(decision.mode)
        if decision.mode != ended and _holds(modes):
            return decision, True
    if not decisions:
        return decision, False
    for decision in reversed(decisions):  # forces that are not the least may obey the laws
        modes.enter(decision.mode)
        modes.set_prestress(decision.forces)
        if _holds(modes):
            return decision, True
    return decisions[0], False  # which has been entered last


def _holds(modes: Modes) -> bool:
    """Whether no guard of the mode is violated at the state in its data."""
    struct = modes.data.struct
    if evaluate_state(struct, 0.0, 0.0) != OK or start_guards(struct) != OK:
        modes.data.reraise()
        return False
    return not modes.contradicted
