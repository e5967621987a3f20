"""Where contacts and joints begin: whether they can be there, and what touches at a state."""

from __future__ import annotations

from multiarm.assembly import scene_size
from multiarm.assembly.contact_checks import place_state
from multiarm.assembly.system import System
from multiarm.contacts.kernel import GAP
from multiarm.contacts.records import JointRow
from multiarm.contacts.unilateral import LIMIT, SURROUNDINGS, Constraint
from multiarm.dynamics.equations import OK, update_kinematics, update_rows
from multiarm.dynamics.state import State
from multiarm.errors import SceneError
from multiarm.events.edges import beside_constraints
from multiarm.events.modes import Choice, Modes
from multiarm.events.patches import patch_margin
from multiarm.events.springs import pressed_constraints
from multiarm.events.transition import closed_constraints

# Parts of the scene's size that count as touching.
TOUCHING = 1e-9


def check_beginning(full: System, start: State) -> None:
    """Check that no contact starts inside of what it may touch, and no joint beyond its range.

    Raises
    ------
    SceneError
        Naming all contacts and joints that are.
    """
    assert full.unilateral is not None, "a system with unilateral constraints"
    full.set_state(0.0, start)
    if update_kinematics(full.struct()) != 0:
        full.reraise()
    allowed, gaps = TOUCHING * scene_size(full), full.buffers.contacts[:, GAP]
    inside = [
        constraint
        for constraint in full.unilateral.constraints
        if gaps[constraint.row] < -allowed
        and not constraint.compliant
        and patch_margin(full, constraint) >= 0.0
    ]
    faults = [_fault(full, constraint, -float(gaps[constraint.row])) for constraint in inside]
    if faults:
        raise SceneError(faults)


def _fault(full: System, constraint: Constraint, depth: float) -> str:
    if constraint.kind != LIMIT:
        where = f"'{constraint.arm}/{constraint.name}' is inside the arm's surface"
        remedy = "the posture"
        if constraint.arm == SURROUNDINGS:
            where, remedy = f"'{constraint.name}' of the object is below the floor", "'object.pose'"
        return f"at the start {where} by {depth:.3g} m; correct {remedy}, or the surfaces"
    first = full.layout.dofs[full.arm_names.index(constraint.arm)]
    limit = full.records[constraint.row]
    assert isinstance(limit, JointRow) and limit.bound is not None, "a limit is a joint's"
    joint = f"{constraint.arm}/{full.joint_name(constraint.joint)}"
    at = full.buffers.angles[first + limit.joint]
    end = "below its lower end" if limit.side > 0.0 else "above its upper end"
    return (
        f"$.effects.joint_limits: '{joint}' starts at {at:.6g}, {end} {limit.bound:.6g}; "
        f"correct the posture, or the range"
    )


def touching_constraints(
    modes: Modes, t: float, state: State
) -> tuple[set[int], frozenset[int], float]:
    """Write a state into the buffers; constraints that touch there, and those beside their patches.

    Compliant contacts that push touch too.  The third is the size of the scene [m].
    """
    full, bare = modes.full, modes.bare
    place_state(bare, t, state)
    if update_kinematics(bare.struct()) != OK:
        bare.reraise()
    update_rows(full.struct())
    size, nothing = scene_size(modes.model), Choice((), ())
    touching = closed_constraints(modes, TOUCHING * size) | pressed_constraints(
        modes, nothing, set()
    )
    return touching, beside_constraints(modes, nothing, set()), size
