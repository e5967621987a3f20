"""Putting a start on the constraints, and moving the arms with a given object.

The start of a scene is assembled when it is close: the arms move onto the joints with the object
held; only if they cannot, the object gives way too.  What was changed is reported, and a start that
is too far off is refused with its residuals.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.equations import OK, update_kinematics
from multiarm.errors import ControlError, SceneError, SolverError
from multiarm.plant import system_book
from multiarm.spatial import difference, matrix_to_quaternion, retract
from multiarm.stabilization import PROJECTION_FAILED, project_positions, project_velocities

if TYPE_CHECKING:
    from multiarm.state import State
    from multiarm.system import System

# A start whose gaps are larger than this fraction of the object's or the arms' size is refused.
CLOSE = 0.1
_LONGEST_JOINT_CHANGE = 0.3  # [rad, m] an iteration
_ITERATIONS = 60
# Steps between two nodes of a path: an arm's free motions on the way depend little on them.
_SUBSTEPS = 3


@dataclass(frozen=True)
class StartReport:
    """How the written start was corrected.

    Attributes
    ----------
    gaps : dict arm -> float
        Largest gap of the written start [m].
    gap_rates : dict arm -> float
        Largest gap rate of the written start [m/s].
    joint_change : float
        Largest change of one joint [rad, m].
    object_shift, object_turn : float
        Displacement [m] and rotation [rad] of the object.
    velocity_change : float
        Largest change of a velocity component [m/s, rad/s].
    """

    gaps: dict[str, float] = field(default_factory=dict)
    gap_rates: dict[str, float] = field(default_factory=dict)
    joint_change: float = 0.0
    object_shift: float = 0.0
    object_turn: float = 0.0
    velocity_change: float = 0.0


def scene_size(system: System) -> float:
    """A length that is typical of the scene [m]: of its lever arms, its object and its arms."""
    buffers, plant = system.buffers, system.plant
    levers = np.linalg.norm(buffers.contacts[:, :3] - buffers.position[:3], axis=1)
    gyration = np.sqrt(np.trace(plant.object_inertia) / plant.object_mass[0])
    bases = np.array([arm.files.base[:3, 3] for arm in system.arms.values()])
    reach = np.linalg.norm(buffers.arms[:, 9:12] - bases, axis=1)
    return float(max(np.max(levers, initial=0.0), gyration, np.max(reach)))


def projection_tolerance(system: System) -> float:
    """Gap [m] that counts as closed: some roundings of the coordinates involved."""
    bases = [np.max(np.abs(arm.files.base[:3, 3])) for arm in system.arms.values()]
    far = max(float(np.max(np.abs(system.buffers.contacts[:, :3]), initial=0.0)), *bases, 0.0)
    return 100 * np.finfo(float).eps * max(far, scene_size(system))


def assemble(system: System, written: State) -> tuple[State, StartReport]:
    """Put the written start on the constraints.

    Raises
    ------
    SceneError
        When a gap is too large or the arms cannot close it.
    """
    _kinematics(system, written)
    lost = np.flatnonzero(~np.isfinite(system.buffers.contacts).all(axis=1))
    if lost.size:
        from multiarm.dynamics import lost_contact

        raise SceneError(
            [f"{lost_contact(system, int(row))}; mend its placement at the start" for row in lost]
        )
    gaps = _by_arm(system, GAP)
    rates = _by_arm(system, GAP_RATE)
    size = scene_size(system)
    far = {arm: gap for arm, gap in gaps.items() if not gap <= CLOSE * size}
    if far:
        raise SceneError(_too_far(system, far, CLOSE * size))
    start = _close(system, written, gaps)
    status = project_velocities(system.book())
    if status != OK:
        _explain(system, status)
    start.velocity[:] = system.get_state().velocity
    report = StartReport(
        gaps=gaps,
        gap_rates=rates,
        joint_change=float(np.max(np.abs(start.position[7:] - written.position[7:]))),
        object_shift=float(np.linalg.norm(start.position[:3] - written.position[:3])),
        object_turn=float(np.linalg.norm(difference(written.position[3:7], start.position[3:7]))),
        velocity_change=float(np.max(np.abs(start.velocity - written.velocity))),
    )
    return start, report


def follow_object(
    system: System,
    start: State,
    begin: np.ndarray,
    end: np.ndarray,
    law: np.ndarray,
    segment: int,
) -> tuple[np.ndarray, State]:
    """Joint positions that close the chains while the object moves from one pose to another.

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
    base = matrix_to_quaternion(np.ascontiguousarray(begin[:3, :3]))
    turn = difference(base, matrix_to_quaternion(np.ascontiguousarray(end[:3, :3])))
    state, angles = start.copy(), []
    state.velocity[:] = 0.0
    before = 0.0
    for fraction in law:
        for part in np.linspace(before, fraction, _SUBSTEPS + 1)[1:]:
            state.position[:3] = begin[:3, 3] + part * (end[:3, 3] - begin[:3, 3])
            state.position[3:7] = retract(base, part * turn)
            if _solve(system, state, hold_object=True) != OK:
                raise _cannot_follow(system, segment, part)
            state = system.get_state()
        before = fraction
        angles.append(state.position[7:].copy())
    return np.array(angles), state


def _cannot_follow(system: System, segment: int, part: float) -> ControlError:
    system.reraise()
    arm, gap = max(_by_arm(system, GAP).items(), key=lambda item: item[1])
    return ControlError(
        f"control.path: on the way to waypoint {segment} the arms cannot follow the object beyond "
        f"{100 * part:.0f} % (arm '{arm}' is {gap:.3g} m off); choose a nearer pose or other base "
        f"placements"
    )


def _close(system: System, written: State, gaps: dict[str, float]) -> State:
    """Positions on the constraints: the arms alone if they can, else everything."""
    for hold_object in (True, False):
        status = _solve(system, written, hold_object)
        if status == OK:
            return system.get_state()
        system.reraise()
    if status != PROJECTION_FAILED:
        _explain(system, status)
    raise SceneError(
        "the start does not satisfy the joints and could not be closed from there "
        f"(gaps {_listed(gaps)}); move the postures or `at` closer together, "
        "or leave out `at` to join the object where the tip is"
    )


def _solve(system: System, state: State, hold_object: bool) -> int:
    """Close the gaps from ``state``; the result is left in the system's buffers."""
    system.set_state(0.0, state)
    plant = system.plant
    if hold_object:
        # an object that is far heavier than anything stays where it is
        heavy = 1e8
        plant = plant._replace(
            object_mass=heavy * plant.object_mass, object_inertia=heavy * plant.object_inertia
        )
    tolerance = projection_tolerance(system)
    book = system_book(plant, system.buffers, system.work)
    return project_positions(book, tolerance, hold_object, _LONGEST_JOINT_CHANGE, _ITERATIONS)


def _kinematics(system: System, state: State) -> None:
    system.set_state(0.0, state)
    if update_kinematics(system.book()) != OK:
        system.reraise()


def _by_arm(system: System, column: int) -> dict[str, float]:
    """Largest magnitude of one column of the contact kinematics, by arm."""
    parts = system.layout.split_contacts(np.abs(system.buffers.contacts[:, column]))
    return {arm: float(np.max(values)) for arm, values in parts.items()}


def _too_far(system: System, far: dict[str, float], limit: float) -> list[str]:
    kinds = {joint.arm: joint.kind for joint in system.scene.joints}
    phi = system.layout.split_contacts(np.abs(system.buffers.contacts[:, GAP]))
    faults = []
    for arm, gap in far.items():
        contact = system.contacts[arm][int(np.argmax(phi[arm]))]
        remedy = "or `at` (or leave `at` out to join the object where the tip is)"
        if kinds[arm] == "contacts":
            remedy = (
                "or the contact's geometry (of the arm in the tip's frame, of the object in its)"
            )
        faults.append(
            f"the start does not satisfy the joint of arm '{arm}': a gap of {gap:.4g} m is left "
            f"at '{contact.name}', up to {limit:.3g} m is assembled; mend the posture, the base "
            f"{remedy}"
        )
    return faults


def _listed(gaps: dict[str, float]) -> str:
    return ", ".join(f"{arm}: {gap:.3g} m" for arm, gap in gaps.items())


def _explain(system: System, status: int) -> None:
    from multiarm.dynamics import failure_text

    system.reraise()
    raise SolverError(failure_text(system, status))
