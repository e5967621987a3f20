"""Event detection: which constraints touch at a state, are off their patches or below them.

*At the edge of a patch*, such as a table top.  A contact beyond the edge is *off* its patch and
touches nothing, however low it is; crossing the edge is an event that is not reported.  A contact
under the patch is *below* it: it touches nothing until it is off the patch again, or has come up
through it.
"""

from __future__ import annotations

from collections.abc import Set

from multiarm.assembly.linkage import scene_size
from multiarm.assembly.start import TOUCHING
from multiarm.contacts.unilateral import DRY_JOINT
from multiarm.dynamics.contact_geometry import patch_margin
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics, update_rows
from multiarm.dynamics.evaluation import place_start
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.guard_functions import spring_length
from multiarm.dynamics.state import State
from multiarm.events.mode import Mode
from multiarm.events.mode_guards import GAP_THRESHOLD
from multiarm.events.modes import Modes
from multiarm.results.contact_states import ContactState

# Contacts are below their patch when they are this far under its surface [m].
BELOW = 1e-8


def touching_constraints(
    modes: Modes, t: float, state: State
) -> tuple[set[int], frozenset[int], float]:
    """Move to the start of a run; constraints that touch there, are off their patches, and size.

    Compliant contacts that push touch too.  The size is that of the scene [m].
    """
    full, bilateral = modes.full, modes.bilateral
    place_start(bilateral, t, state)
    require_ok(bilateral, update_kinematics(bilateral.struct))
    require_ok(full, update_rows(full.struct))
    size, nothing = scene_size(modes.closed), Mode((), ())
    touching = closed_constraints(modes, TOUCHING * size)
    touching |= pressed_constraints(modes, nothing, set())
    return touching, off_patch_constraints(modes, nothing, set()), size


def closed_constraints(modes: Modes, tolerance: float) -> set[int]:
    """Contacts that cannot open, and contacts and limits whose gaps are closed."""
    gaps = modes.full.contact_rows.gap
    return {
        u
        for u, constraint in enumerate(modes.unilateral.constraints)
        if constraint.kind != DRY_JOINT
        and not constraint.compliant
        and u not in modes.idle
        and (constraint.bilateral or abs(gaps[constraint.row]) <= tolerance)
    }


def pressed_constraints(modes: Modes, before: Mode, fired: Set[int]) -> set[int]:
    """Compliant contacts that push from now on, at the state in the data.

    One whose guard has just ``fired`` is at zero and changes its state.  ``before`` has no states
    at the beginning of a run.
    """
    pressed, contacts = set(), modes.full.contact_rows
    for u, constraint in enumerate(modes.unilateral.constraints):
        if not constraint.compliant:
            continue
        gap, rate = contacts.gap[constraint.row], contacts.gap_rate[constraint.row]
        length = spring_length(gap, rate, constraint.lag)
        pushes = length < 0.0
        if abs(length) <= GAP_THRESHOLD:
            started = bool(before.states)
            was_open = started and before.states[u] == ContactState.OPEN
            pushes = was_open == (u in fired) if started else rate <= 0.0
        if pushes:
            pressed.add(u)
    return pressed


def off_patch_constraints(modes: Modes, before: Mode, crossed: Set[int]) -> frozenset[int]:
    """Constraints whose contacts are off their patches from now on, at the state in the data.

    One that has just ``crossed`` an edge is on it, and on its other side from now on.
    """
    off_patch = set()
    for u, constraint in enumerate(modes.unilateral.constraints):
        margin = patch_margin(modes.full, constraint)
        off = margin < 0.0
        if u in crossed or abs(margin) <= GAP_THRESHOLD:
            off = (u in before.off_patch) != (u in crossed)
        if off:
            off_patch.add(u)
    return frozenset(off_patch)


def below_patch_constraints(full: Data, above: Set[int]) -> frozenset[int]:
    """Constraints whose contacts are below their patches; those ``above`` are known not to be."""
    assert full.model.unilateral is not None
    gaps = full.contact_rows.gap
    return frozenset(
        u
        for u, constraint in enumerate(full.model.unilateral.constraints)
        if u not in above
        and gaps[constraint.row] < -BELOW
        and patch_margin(full, constraint) != float("inf")
    )
