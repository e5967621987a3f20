"""Moving the arms with a given object: joint positions along a path of object poses."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multiarm.assembly.closing import CLOSED, close_gaps
from multiarm.assembly.linkage import Linkage, projection_tolerance
from multiarm.contacts.kernel import GAP
from multiarm.dynamics.equations import OK, update_kinematics
from multiarm.errors import ControlError
from multiarm.integration.projection import project_positions
from multiarm.spatial import difference, matrix_to_quaternion, retract

if TYPE_CHECKING:
    from multiarm.assembly.system import System
    from multiarm.dynamics.state import State

# Steps between two nodes of a path: an arm's free motions on the way depend little on them.
_SUBSTEPS = 3
_LONGEST_JOINT_CHANGE = 0.3  # [rad, m] an iteration
_ITERATIONS = 60
# An object that is so many times heavier than it is stays where it is.
_HEAVY = 1e8


def follow_object(
    system: System,
    start: State,
    begin: np.ndarray,
    end: np.ndarray,
    law: np.ndarray,
    segment: int,
) -> tuple[np.ndarray, State]:
    """Joint positions that close the chains while the object moves from one pose to another.

    The joints' limits are left to the run, which does not enforce them either.

    Parameters
    ----------
    start : State
        A closed state near the first pose.
    begin, end : ndarray, shape (4, 4)
        Object poses; positions are interpolated along a line, orientations about a fixed axis.
    law : ndarray, shape (K,)
        Fractions of the way, increasing from 0 to 1.
    segment : int
        For messages.

    Returns
    -------
    angles : ndarray, shape (K, n)
    state : State
        Closed, with the object at the end pose.
    """
    plant = system.plant._replace(
        object_mass=_HEAVY * system.plant.object_mass,
        object_inertia=_HEAVY * system.plant.object_inertia,
    )
    heavy, tolerance = replace(system, plant=plant), projection_tolerance(system)
    base = matrix_to_quaternion(np.ascontiguousarray(begin[:3, :3]))
    turn = difference(base, matrix_to_quaternion(np.ascontiguousarray(end[:3, :3])))
    state, angles = start.copy(), []
    state.velocity[:] = 0.0
    before = 0.0
    for fraction in law:
        for part in np.linspace(before, fraction, _SUBSTEPS + 1)[1:]:
            state.position[:3] = begin[:3, 3] + part * (end[:3, 3] - begin[:3, 3])
            state.position[3:7] = retract(base, part * turn)
            if not _arms_close(system, heavy, state, tolerance):
                raise _cannot_follow(system, segment, part)
            state = system.get_state()
        before = fraction
        angles.append(state.position[7:].copy())
    return np.array(angles), state


def _arms_close(system: System, heavy: System, state: State, tolerance: float) -> bool:
    """Close the gaps from ``state`` with the object held; the result is left in the buffers.

    ``heavy`` is the system with an object that does not move.  The compiled projection is fast;
    where it fails, near singular postures, the arms are led.
    """
    system.set_state(0.0, state)
    if project_positions(heavy.struct(), tolerance, True, _LONGEST_JOINT_CHANGE, _ITERATIONS) == OK:
        return True
    system.reraise()
    system.set_state(0.0, state)
    free = np.full((system.layout.joints, 2), [-np.inf, np.inf])
    for i in range(len(system.arm_names)):
        if update_kinematics(system.struct()) != OK:
            system.reraise()
        if close_gaps(Linkage(system, [i], False, free), tolerance).status != CLOSED:
            return False
    return True


def _cannot_follow(system: System, segment: int, part: float) -> ControlError:
    gaps = system.layout.split_contacts(np.abs(system.buffers.contacts[:, GAP]))
    arm, gap = max(((arm, float(np.max(own))) for arm, own in gaps.items()), key=lambda a: a[1])
    return ControlError(
        f"control.path: on the way to waypoint {segment} the arms cannot follow the object beyond "
        f"{100 * part:.0f} % (arm '{arm}' is {gap:.3g} m off); choose a nearer pose or other base "
        f"placements"
    )
