r"""Putting a start on the constraints, with the least change, and telling what was changed.

Positions: the arms move onto the joints with the object held, each on its own; where one cannot, or
only by a large swing for a small gap, the object gives way too.  They stay within the limits of
their joints and on the branch of the written start (:mod:`multiarm.assembly.closing`).  A start
that is too far off, or whose contacts contradict each other, is refused with its residuals.

Velocities: the least change in the metric of the inertia,

.. math:: \min_{\delta v} \tfrac12\, \delta v^T M\, \delta v \ \text{ with }\ W^T(v + \delta v) = 0,

which is an inelastic impact that closes all gap rates; ``W`` may have dependent columns.
"""

from __future__ import annotations

import numpy as np

from multiarm.assembly.closing import CLOSED, close_gaps
from multiarm.assembly.linkage import Linkage, projection_tolerance, scene_size
from multiarm.assembly.refusals import (
    cannot_close,
    gaps_by_arm,
    joint_names,
    joints_at_limit,
    too_far,
)
from multiarm.assembly.velocities import close_rates
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.records import JointRow
from multiarm.contacts.unilateral import LIMIT, SURROUNDINGS, Constraint
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_geometry import patch_margin, place_state
from multiarm.dynamics.diagnosis import lost_contact
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import StartReport
from multiarm.errors import ModelError, SceneError
from multiarm.integration.monitors import DRIVE, FORCE, WATCH_BODY, WATCH_ROW, margin_at
from multiarm.integration.monitors import LIMIT as JOINT_LIMIT
from multiarm.scene import Scene
from multiarm.spatial import difference

# A start whose gaps are larger than this fraction of the scene's size is refused.
CLOSE = 0.1
# Parts of the scene's size that count as touching.
TOUCHING = 1e-9
# What a state given by the user is called in messages.
_GIVEN = "the given state"
# The object is held while no joint of an arm moves more than so many times what closes its worst
# gap by itself; more is a swing near a singular posture.
SWING = 20.0


def assemble(data: Data, scene: Scene, written: State) -> tuple[State, StartReport]:
    """Put the written start of a scene on the constraints.

    Raises
    ------
    SceneError
        When a gap is too large or cannot be closed, with the residuals of the joints.
    SolverError
        When an arm's inertia is not positive definite.
    """
    data.set_state(0.0, written)
    return assemble_placed(data, scene, "the start")


def assemble_placed(data: Data, scene: Scene, what: str) -> tuple[State, StartReport]:
    """Put the state in the data on the constraints; ``what`` it is called in messages.

    A state that satisfies the joints to within :func:`projection_tolerance` is not touched.

    Raises
    ------
    SceneError, SolverError
        As :func:`assemble`.
    """
    written, layout = data.get_state(), data.model.layout
    _update(data)
    lost = np.flatnonzero(~np.isfinite(data.arrays.contacts).all(axis=1))
    if lost.size:
        raise SceneError(
            [f"{lost_contact(data, int(row))}; mend its placement at the start" for row in lost]
        )
    gaps, rates = gaps_by_arm(data), gaps_by_arm(data, GAP_RATE)
    size = scene_size(data)
    if not all(gap <= CLOSE * size for gap in gaps.values()):
        raise SceneError(too_far(data, scene, what, gaps, CLOSE * size))
    limits, outside = _limits(data, written)
    held = _close(data, what, gaps, limits, size)
    energy_lost = close_rates(data, size)
    start = data.get_state()
    moved = np.abs(start.position[7:] - written.position[7:])
    faster = np.abs(start.velocity - written.velocity)
    return start, StartReport(
        gaps=gaps,
        gap_rates=rates,
        gaps_left=gaps_by_arm(data),
        joint_change=float(np.max(moved)),
        joint_changes={arm: float(np.max(own)) for arm, own in layout.split_joints(moved).items()},
        object_held=held,
        object_shift=float(np.linalg.norm(start.position[:3] - written.position[:3])),
        object_turn=float(np.linalg.norm(difference(written.position[3:7], start.position[3:7]))),
        at_limit=joints_at_limit(data),
        outside_limits=outside,
        velocity_change=float(np.max(faster)),
        object_velocity_change=float(np.linalg.norm(faster[:3])),
        object_spin_change=float(np.linalg.norm(faster[3:6])),
        joint_velocity_change=float(np.max(faster[6:])),
        energy_lost=energy_lost,
    )


def _close(data: Data, what: str, gaps: dict[str, float], limits: np.ndarray, size: float) -> bool:
    """Close the gaps of the state in the data; returns whether the object was held."""
    tolerance = projection_tolerance(data, size)
    if max(gaps.values()) <= tolerance:
        return True
    everything = list(range(len(data.model.arm_names)))
    whole = Linkage(data, everything, True, limits)
    begin = whole.here()
    closed, calm = True, True
    for i, gap in enumerate(gaps.values()):
        if gap > tolerance:
            arm = Linkage(data, [i], False, limits)
            near = SWING * arm.here().least_turn
            end = close_gaps(arm, tolerance)
            closed, calm = closed and end.status == CLOSED, calm and end.change <= near
    if closed and calm:
        return True
    arms_alone = whole.here()
    whole.place(begin)
    end = close_gaps(whole, tolerance)
    if end.status == CLOSED:
        return False
    if closed:
        whole.place(arms_alone)
        return True
    raise SceneError(cannot_close(data, what, gaps, whole, end))


def _limits(data: Data, written: State) -> tuple[np.ndarray, tuple[str, ...]]:
    """Limits (n, 2) of all joints, and the joints outside of theirs, which get none."""
    limits = np.vstack([arm.position_limits for arm in data.model.arms.values()])
    angles = written.position[7:]
    out = (angles < limits[:, 0]) | (angles > limits[:, 1])
    limits[out] = -np.inf, np.inf
    return limits, tuple(np.array(joint_names(data.model))[out])


def _update(data: Data) -> None:
    if update_kinematics(data.struct) != OK:
        data.reraise()


def project_start(data: Data, scene: Scene, state: State) -> tuple[State, StartReport]:
    """Put a given state on the constraints as a scene's start is, with the least change.

    Parameters
    ----------
    data : Data
    scene : Scene
    state : State
        Stays as it is.

    Returns
    -------
    state : State
        A copy; the same numbers bit for bit where the state satisfies the joints to within
        :func:`projection_tolerance` and its gap rates are roundings.
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
        raise ModelError(f"{_GIVEN} is not finite; make it with `system.state(...)`")
    try:
        place_state(data, 0.0, state)
        return assemble_placed(data, scene, _GIVEN)
    except SceneError as error:
        raise ModelError(
            f"{_GIVEN} cannot be the beginning of a run:\n"
            + "\n".join(f"  {fault}" for fault in error.faults)
            + "\n`system.initial_state()` satisfies the joints; begin near it"
        ) from error


def check_patches(data: Data, start: State) -> None:
    """Check that the contacts of the assembled start are on their patches.

    Raises
    ------
    SceneError
        Names the contacts that are not.
    """
    data.set_state(0.0, start)
    _update(data)
    faults = _outside(data)
    if faults:
        raise SceneError(faults)


def _outside(data: Data) -> list[str]:
    faults = []
    for k, watch in enumerate(data.model.constants.watches):
        if int(watch[WATCH_BODY]) in (FORCE, JOINT_LIMIT, DRIVE):
            continue
        excess = margin_at(data.struct, k)
        if excess > 0.0:
            arm, contact = data.model.owner(int(watch[WATCH_ROW]))
            faults.append(
                f"arm '{arm}': '{contact.name}' touches {excess:.3g} m outside the patch of its "
                f"surface; mend the posture, or the patch's 'min' and 'max'"
            )
    return faults


def check_unilateral(data: Data, start: State) -> None:
    """Check that unilateral contacts are not closed already, and joints within their ranges.

    Raises
    ------
    SceneError
        Naming all contacts and joints that are.
    """
    assert data.model.unilateral is not None
    data.set_state(0.0, start)
    if update_kinematics(data.struct) != OK:
        data.reraise()
    allowed, gaps = TOUCHING * scene_size(data), data.arrays.contacts[:, GAP]
    faults = []
    for constraint in data.model.unilateral.constraints:
        gap = float(gaps[constraint.row])
        if gap < -allowed and not constraint.compliant and patch_margin(data, constraint) >= 0.0:
            faults.append(_inside(data, constraint, -gap))
    if faults:
        raise SceneError(faults)


def _inside(data: Data, constraint: Constraint, depth: float) -> str:
    if constraint.kind != LIMIT:
        where, remedy = (
            f"'{constraint.arm}/{constraint.name}' is inside the arm's surface",
            "the posture",
        )
        if constraint.arm == SURROUNDINGS:
            where, remedy = f"'{constraint.name}' of the object is below the floor", "'object.pose'"
        return f"at the start {where} by {depth:.3g} m; mend {remedy}, or the surfaces"
    first = data.model.layout.dofs[data.model.arm_names.index(constraint.arm)]
    limit = data.model.records[constraint.row]
    assert isinstance(limit, JointRow) and limit.bound is not None, "a limit is a joint's"
    at = data.arrays.angles[first + limit.joint]
    end = "below its lower end" if limit.side > 0.0 else "above its upper end"
    name = f"{constraint.arm}/{data.model.joint_name(constraint.joint)}"
    return (
        f"$.effects.joint_limits: '{name}' starts at {at:.6g}, {end} {limit.bound:.6g}; "
        f"mend the posture, or the range"
    )
