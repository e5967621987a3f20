"""A state of the user's as the beginning of a run: put on the constraints as a scene's start is."""

from __future__ import annotations

import numpy as np

from multiarm.assembly import StartReport, assemble_placed
from multiarm.assembly.contact_checks import place_state
from multiarm.assembly.system import System
from multiarm.dynamics.state import State
from multiarm.errors import ModelError, SceneError

_WHAT = "the given state"


def adopt_state(system: System, state: State) -> tuple[State, StartReport]:
    """Put a state on the constraints, with the least change.

    Parameters
    ----------
    system : System
    state : State
        Stays as it is.

    Returns
    -------
    state : State
        A copy; the same numbers bit for bit where the state satisfies the joints to within
        :func:`multiarm.assembly.linkage.projection_tolerance` and its gap rates are roundings.
    report : StartReport
        How far it was off, and what was corrected.

    Raises
    ------
    ModelError
        When the state belongs to another system, is not finite, or is too far off.
    SolverError
        When an arm's inertia is not positive definite.
    """
    if not (np.all(np.isfinite(state.position)) and np.all(np.isfinite(state.velocity))):
        raise ModelError(f"{_WHAT} is not finite; make it with `system.state(...)`")
    try:
        place_state(system, 0.0, state)
        return assemble_placed(system, _WHAT)
    except SceneError as error:
        raise ModelError(
            f"{_WHAT} cannot be the beginning of a run:\n"
            + "\n".join(f"  {fault}" for fault in error.faults)
            + "\n`system.initial_state()` satisfies the joints; begin near it"
        ) from error
