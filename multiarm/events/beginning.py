"""What touches at a state."""

from __future__ import annotations

from multiarm.assembly.loop_closure import scene_size
from multiarm.assembly.start import TOUCHING
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.equations import update_kinematics, update_rows
from multiarm.dynamics.state import State
from multiarm.events.edges import beside_constraints
from multiarm.events.modes import Choice, Modes
from multiarm.events.springs import pressed_constraints
from multiarm.events.transition import closed_constraints


def touching_constraints(
    modes: Modes, t: float, state: State
) -> tuple[set[int], frozenset[int], float]:
    """Move to a state; constraints that touch there, and that are beside their patches.

    Compliant contacts that push touch too.  The third is the size of the scene [m].
    """
    full, bare = modes.full, modes.bare
    place_state(bare, t, state)
    if update_kinematics(bare.struct) != OK:
        bare.reraise()
    update_rows(full.struct)
    size, nothing = scene_size(modes.closed), Choice((), ())
    touching = closed_constraints(modes, TOUCHING * size) | pressed_constraints(
        modes, nothing, set()
    )
    return touching, beside_constraints(modes, nothing, set()), size
