"""Where contacts and joints begin: whether they can be there, and what touches at a state."""

from __future__ import annotations

from multiarm.assembly import scene_size
from multiarm.assembly.contact_checks import place_state
from multiarm.assembly.system import System
from multiarm.contacts.kernel import GAP
from multiarm.contacts.records import JointRow
from multiarm.dynamics.equations import OK, update_kinematics, update_rows
from multiarm.dynamics.state import State
from multiarm.errors import SceneError
from multiarm.events.candidates.units import LIMIT, SURROUNDINGS, Unit
from multiarm.events.edges import beside_units
from multiarm.events.modes import Choice, Modes
from multiarm.events.patches import patch_margin
from multiarm.events.springs import pressed_units
from multiarm.events.transition import closed_units

# Parts of the scene's size that count as touching.
TOUCHING = 1e-9


def check_beginning(full: System, start: State) -> None:
    """Check that nothing that comes and goes is inside of what it may touch, or beyond its range.

    Raises
    ------
    SceneError
        Naming all contacts and joints that are.
    """
    assert full.plan is not None, "something comes and goes"
    full.set_state(0.0, start)
    if update_kinematics(full.struct()) != 0:
        full.reraise()
    allowed, gaps = TOUCHING * scene_size(full), full.buffers.contacts[:, GAP]
    inside = [
        unit
        for unit in full.plan.units
        if gaps[unit.row] < -allowed and not unit.soft and patch_margin(full, unit) >= 0.0
    ]
    faults = [_fault(full, unit, -float(gaps[unit.row])) for unit in inside]
    if faults:
        raise SceneError(faults)


def _fault(full: System, unit: Unit, depth: float) -> str:
    if unit.kind != LIMIT:
        where, remedy = f"'{unit.arm}/{unit.name}' is inside the arm's surface", "the posture"
        if unit.arm == SURROUNDINGS:
            where, remedy = f"'{unit.name}' of the object is below the floor", "'object.pose'"
        return f"at the start {where} by {depth:.3g} m; mend {remedy}, or the surfaces"
    first = full.layout.dofs[full.arm_names.index(unit.arm)]
    limit = full.records[unit.row]
    assert isinstance(limit, JointRow) and limit.bound is not None, "a limit is a joint's"
    at = full.buffers.angles[first + limit.joint]
    end = "below its lower end" if limit.side > 0.0 else "above its upper end"
    return (
        f"$.effects.joint_limits: '{unit.arm}/{full.joint_name(unit.joint)}' starts at {at:.6g}, "
        f"{end} {limit.bound:.6g}; mend the posture, or the range"
    )


def touching_units(modes: Modes, t: float, state: State) -> tuple[set[int], frozenset[int], float]:
    """Write a state into the buffers; units that touch there, and that are beside their patches.

    Compliant contacts that push touch too.  The third is the size of the scene [m].
    """
    full, bare = modes.full, modes.bare
    place_state(bare, t, state)
    if update_kinematics(bare.struct()) != OK:
        bare.reraise()
    update_rows(full.struct())
    size, nothing = scene_size(modes.model), Choice((), ())
    touching = closed_units(modes, TOUCHING * size) | pressed_units(modes, nothing, set())
    return touching, beside_units(modes, nothing, set()), size
