"""Evaluations of any scene, also of those with unilateral constraints."""

from __future__ import annotations

from multiarm.assembly.system import System
from multiarm.dynamics import evaluation as dynamics
from multiarm.dynamics.evaluation import Evaluation
from multiarm.dynamics.state import State


def evaluate(system: System, t: float = 0.0, state: State | None = None) -> Evaluation:
    """Accelerations and contact forces of a system at one state.

    With unilateral contacts, the result is that of the contact mode that follows from the state:
    ``contact_states`` says what each does, and ``contact_forces`` has all rows, in the order of
    ``system.contacts``, those of contacts that are open with zeros; ``contact_terms``, motion
    spaces and internal forces are those of all contacts of the joints.

    Parameters
    ----------
    system : System
    t : float
        Time, for the control [s].
    state : State, optional
        The start when left out.  It is taken as it is: nothing is projected, and contacts that hit
        something do not bounce.

    Raises
    ------
    SolverError
        When an inertia is not positive definite, or nothing meets the laws of the contacts.
    ControlError
        When a Python controller returns something unusable.
    """
    if system.unilateral is None:
        return dynamics.evaluate(system, t, state)
    from multiarm.events.mode_evaluation import evaluate_mode

    return evaluate_mode(system, t, system.initial_state() if state is None else state.copy())
