"""A mode that its own guards do not contradict at once.

At the instant at which a bound is reached several modes solve the contact laws, and forces of
minimum norm may be at a bound that other forces of the same motion are far from.  The forces of the
decision obey the laws in any case, if only at this instant.  Where none of them holds, the modes of
the instant cannot tell what comes next: the run goes on in impulse steps
(:mod:`multiarm.events.impulse_steps`).
"""

from __future__ import annotations

from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.status import OK
from multiarm.events.kernels import start_guards
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.events.transition import Decision


def enter_consistent_mode(
    modes: Modes, decision: Decision, ended: Mode | None = None
) -> tuple[Decision, bool]:
    """Enter the mode of a decision, with forces of minimum norm, central ones, or its own.

    Parameters
    ----------
    modes : Modes
    decision : Decision
    ended : Mode, optional
        The one that has just ended: without an impact it would come to the same event with the
        same forces.  Central ones are tried first then, and where others let contacts slide that
        may stick.

    Returns
    -------
    decision : Decision
        With the mode that has been entered; none has been where it is undecided.
    holds : bool
        Whether no guard of that mode is violated.
    """
    if decision.undecided:
        return decision, False
    again = decision.mode == ended and not decision.hits
    central_first = again or decision.at_bound
    for with_central_forces in (central_first, not central_first):
        choice = decision.with_central_forces() if with_central_forces else decision
        if choice is None:
            continue
        modes.enter(choice.mode)
        if with_central_forces:
            modes.set_prestress(choice.forces)
        if _holds(modes):
            return choice, True
    # forces that obey the laws at this instant, whatever follows
    modes.enter(decision.mode)
    modes.set_prestress(decision.forces)
    return decision, _holds(modes)


def _holds(modes: Modes) -> bool:
    """Whether no guard of the mode is violated at the state in its data."""
    struct = modes.data.struct
    if evaluate_state(struct, 0.0, 0.0) != OK or start_guards(struct) != OK:
        modes.data.reraise()
        return False
    return not modes.contradicted
