r"""Assembling a start: it is put on the constraints with the least change, which is reported.

*Positions.*  The robots move onto the joints with the object held, each on its own; where one
cannot, or only by a large swing for a small gap, or where the world holds the object elsewhere, the
object moves too.  The joints stay within their limits
and on the branch of the written start (:mod:`multiarm.assembly.loop_closure`).  A start that is too
far off, or whose contacts contradict each other, is refused with its residuals.

*Velocities.*  The least change in the metric of the inertia, an inelastic impact that closes all
gap rates (:mod:`multiarm.dynamics.impacts`).  Rates close also along directions that an arm has
almost lost, which the projection of a run (:mod:`multiarm.integration.projection`), linear in the
arms, leaves with those that depend on others.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from multiarm.assembly.linkage import (
    Linkage,
    gap_rates_by_owner,
    gaps_by_owner,
    joints_at_limit,
    projection_tolerance,
    scene_size,
)
from multiarm.assembly.loop_closure import close_gaps
from multiarm.assembly.robots import Robots
from multiarm.assembly.start_faults import cannot_close, inside, listed_gaps, too_far
from multiarm.contacts.motion import BodyMotion
from multiarm.dynamics.contact_geometry import locate_pairs, patch_margin, place_state
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import (
    is_tip_of_arm,
    joint_of,
    lost_contact,
    owner_of,
    require_ok,
)
from multiarm.dynamics.impacts import inelastic_impact
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.state import State
from multiarm.dynamics.system import StartReport
from multiarm.errors import ModelError, SceneError
from multiarm.integration.reporting_guards import contacts_off_patch
from multiarm.jit.rows import fields_of
from multiarm.scene import Scene
from multiarm.spatial import matrix_to_quaternion

# Joints that assembly moves by less [rad, m] were at their limits before.
MOVED = 1e-9
# Gaps below this part of the scene's size count as touching.
TOUCHING = 1e-9


def assemble(data: Data, scene: Scene, name: str | None = None) -> tuple[State, StartReport]:
    """Put the state in the data on the constraints; ``name`` is its name in messages.

    Without a name it is the start of the scene.

    A state that satisfies the joints to within :func:`projection_tolerance` is not changed.

    Raises
    ------
    SceneError
        When a gap is too large or cannot be closed, with the residuals of the joints.
    SolverError
        When an arm's inertia is not positive definite.
    """
    written, layout = data.get_state(), data.model.layout
    require_ok(data, update_kinematics(data.struct))
    lost = np.flatnonzero(~np.isfinite(data.arrays.rows.kinematics).all(axis=1))
    if lost.size:
        raise SceneError(
            [f"{lost_contact(data, int(row))}; correct its placement at the start" for row in lost]
        )
    gaps, rates = gaps_by_owner(data), gap_rates_by_owner(data)
    size = scene_size(data)
    of_scene, name = name is None, name or "the start"
    faults = too_far(data, scene, name, size, of_scene)
    if faults:
        raise SceneError(faults)
    limits, outside = _limits(data, written)
    held = _close(data, name, gaps, limits, size)
    _check_way_round(data, scene, name)
    energy_lost = _close_rates(data, size)
    start = data.get_state()
    displacement = np.abs(written.displacement_to(start))
    moved, shifts = layout.joint_rates(displacement), layout.twists(displacement)
    faster = np.abs(start.velocity - written.velocity)
    of_objects, at_limit = layout.twists(faster), joints_at_limit(data)
    joint_changes, base_shifts, base_turns = _changes(layout, displacement)
    rate_changes, base_velocity_changes, base_spin_changes = _changes(layout, faster)
    before = dict(
        zip(data.model.joint_names, layout.joint_positions(written.position), strict=True)
    )
    moves = dict(zip(data.model.joint_names, moved, strict=True))
    return start, StartReport(
        gaps=gaps,
        gap_rates=rates,
        gaps_left=gaps_by_owner(data),
        joint_change=max(joint_changes.values(), default=0.0),
        joint_changes=joint_changes,
        base_shifts=base_shifts,
        base_turns=base_turns,
        object_held=held,
        object_shift=largest_norm(shifts[:, :3]),
        object_turn=largest_norm(shifts[:, 3:]),
        at_limit=at_limit,
        pushed_to_limit={name: before[name] for name in at_limit if moves[name] > MOVED},
        outside_limits=outside,
        velocity_change=float(np.max(faster)),
        object_velocity_change=largest_norm(of_objects[:, :3]),
        object_spin_change=largest_norm(of_objects[:, 3:]),
        joint_velocity_change=max(rate_changes.values(), default=0.0),
        base_velocity_changes=base_velocity_changes,
        base_spin_changes=base_spin_changes,
        energy_lost=energy_lost,
    )


def largest_norm(vectors: np.ndarray) -> float:
    """Length of the longest of some vectors, shape (k, 3)."""
    return float(np.linalg.norm(vectors, axis=1).max())


def written_start(scene: Scene, robots: Robots, layout: Layout) -> State:
    """The start as written in the scene, before it is assembled."""
    state = State(np.zeros(layout.nq), np.zeros(layout.nv), layout)
    for name, motion in state.objects.items():
        body = scene.all_objects[name]
        pose = body.pose.matrix()
        motion.position[:], motion.quaternion_xyzw[:] = (
            pose[:3, 3],
            matrix_to_quaternion(pose[:3, :3]),
        )
        if body.twist is not None:
            motion.twist[:] = body.twist
    for name, robot in robots.resolved.items():
        state.joint_positions[name][:] = robots.postures[name]
        state.joint_velocities[name][:] = robot.velocity
    for name, base in state.bases.items():
        base.pose[:] = robots.by_name[name].base_pose
        written = scene.robots[name].base.twist
        base.twist[:] = np.zeros(6) if written is None else written
    return state


def closed_at_start(data: Data) -> Data:
    """Data in which the contacts closed at the start hold both ways; they share a state."""
    unilateral = data.model.unilateral
    if unilateral is None:
        return data
    return data.view(replace(data.model.select(unilateral.assembled), unilateral=None))


def held_at_start(data: Data) -> Data:
    """Data with all contacts closed of the joints that hold at the start; they share a state."""
    unilateral = data.model.unilateral
    if unilateral is None or not unilateral.timed:
        return data.closed
    return data.view(data.model.with_contacts_closed(unilateral.holding_at(0.0)))


def with_contacts_located(data: Data, closed: Data, state: State) -> Data:
    """Data in which contacts of two surfaces are found from where the ``closed`` touch at a state.

    They share what moves with ``data``.
    """
    return data.view(replace(data.model, pair_places=locate_pairs(closed, state)))


def assembled_start(scene: Scene, data: Data, written: State) -> tuple[State, StartReport]:
    """The start, assembled on the contacts that are closed there."""
    closed = closed_at_start(data)
    closed.set_state(0.0, written)
    start, report = assemble(closed, scene)
    check_patches(data, start)
    if data.model.unilateral is not None:
        check_unilateral(data, start)
    return start, report


def unassembled_start(data: Data, written: State) -> tuple[State, StartReport]:
    """The start as written, with its gaps."""
    data.set_state(0.0, written)
    require_ok(data, update_kinematics(data.struct))
    gaps = gaps_by_owner(data)
    rates = gap_rates_by_owner(data)
    return written, StartReport(gaps=gaps, gap_rates=rates, gaps_left=gaps, assembled=False)


def project_start(data: Data, scene: Scene, state: State) -> tuple[State, StartReport]:
    """Put a copy of a given state on the constraints, as a scene's start.

    The copy is equal bit for bit where the state satisfies the joints to within
    :func:`projection_tolerance` and its gap rates are roundings.

    Raises
    ------
    ModelError
        When the state belongs to another system, is not finite, or is too far off.
    SolverError
        When an arm's inertia is not positive definite.
    """
    described = "the given state"
    if not (np.all(np.isfinite(state.position)) and np.all(np.isfinite(state.velocity))):
        raise ModelError(f"{described} is not finite; make it with `system.state(...)`")
    try:
        place_state(data, 0.0, state)
        return assemble(data, scene, described)
    except SceneError as error:
        remedy = "`system.initial_state()` satisfies the joints; begin near it"
        if any(joint.intervals for joint in scene.joints):
            remedy = (
                "`system.initial_state()` satisfies the joints that hold at t = 0; begin then, or "
                "with the state of a run at this time"
            )
        raise ModelError(
            f"{described} cannot be the beginning of a run:\n"
            + "\n".join(f"  {fault}" for fault in error.faults)
            + f"\n{remedy}"
        ) from error


def check_patches(data: Data, start: State) -> None:
    """Check that the contacts of the assembled start are on their patches.

    Raises
    ------
    SceneError
        Names the contacts that are not.
    """
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    faults = [
        f"{owner_of(data.model, owner)}: '{contact}' touches {excess:.3g} m outside the patch of "
        f"its surface; correct the posture, or the patch's 'min' and 'max'"
        for owner, contact, excess in contacts_off_patch(data)
    ]
    if faults:
        raise SceneError(faults)


def check_unilateral(data: Data, start: State) -> None:
    """Check that unilateral contacts are not closed already, and joints within their ranges.

    Raises
    ------
    SceneError
        Naming all contacts and joints that are.
    """
    assert data.model.unilateral is not None
    data.set_state(0.0, start)
    require_ok(data, update_kinematics(data.struct))
    allowed, gaps = TOUCHING * scene_size(data), data.contact_rows.gap
    faults = []
    for constraint in data.model.unilateral.constraints:
        gap = float(gaps[constraint.row])
        if constraint.compliant or constraint.bilateral:
            continue
        if gap < -allowed and patch_margin(data, constraint) >= 0.0:
            faults.append(inside(data, constraint, -gap))
    if faults:
        raise SceneError(faults)


def _close(data: Data, name: str, gaps: dict[str, float], limits: np.ndarray, size: float) -> bool:
    """Close the gaps of the state in the data; returns whether the object was held."""
    tolerance = projection_tolerance(data, size)
    if max(gaps.values(), default=0.0) <= tolerance:
        return True
    linkage = Linkage(data, list(range(data.model.layout.block_count)), True, limits)
    begin, gaps_in_words = linkage.posture(), listed_gaps(data)
    of_blocks, of_world = _gaps_by_block(data, gaps)
    closed, swings = of_world <= tolerance, False
    for i, gap in enumerate(of_blocks if closed else []):
        if gap > tolerance:
            arm = Linkage(data, [i], False, limits)
            # a larger motion than this for its gap is a swing past a singular posture
            far = 20.0 * arm.posture().least_turn
            end = close_gaps(arm, tolerance)
            closed, swings = closed and end.closed, swings or not end.change <= far
    if closed and not swings:
        return True
    arms_alone = linkage.posture()
    linkage.place(begin)
    end = close_gaps(linkage, tolerance)
    if end.closed:
        return False
    if closed:
        linkage.place(arms_alone)
        return True
    raise SceneError(cannot_close(data, name, gaps_in_words, linkage, end))


def _gaps_by_block(data: Data, gaps: dict[str, float]) -> tuple[list[float], float]:
    """Largest gap of every block of a robot, and between object and world [m].

    ``gaps`` are those of the owners of rows.
    """
    layout = data.model.layout
    largest = [
        max((gaps.get(layout.owners[c], 0.0) for c in layout.owners_of_block(i)), default=0.0)
        for i in range(layout.block_count)
    ]
    count = len(layout.blocks_of_robots)
    return largest[:count], max(largest[count:], default=0.0)


def _check_way_round(data: Data, scene: Scene, name: str) -> None:
    """Raise where a joint is closed upside down.

    Contacts are rows of distances, and those of a weld or a slide vanish too where the joint's
    frames on arm and object differ by half a turn.  Joints that take hold later are left out.
    """
    faults, rotations = [], fields_of(BodyMotion, data.arrays.bodies.motion).rotation
    for joint in scene.joints:
        turns = None if joint.free is None else [k - 3 for k in joint.free if k >= 3]
        if turns is None or len(turns) > 1 or not joint.holds_at(0.0):
            continue
        frames = data.model.frames_on_bodies(joint.connection)
        first, second = data.model.bodies_of(joint.connection)
        R = (rotations[second] @ frames.on_object).T @ rotations[first] @ frames.on_link
        # the cosine of the turn between both frames, or between the axes about which they may turn
        cosine = R[turns[0], turns[0]] if turns else 0.5 * (np.trace(R) - 1.0)
        if cosine < 0.0:
            angle = math.degrees(math.acos(max(cosine, -1.0)))
            pair = data.model.connections[joint.connection]
            on_first = "arm" if is_tip_of_arm(pair) else str(pair.first)
            faults.append(
                f"{name} closes {joint_of(data.model, joint.connection)} the wrong way round: its "
                f"frame on the {on_first} is turned by {angle:.0f} degrees against that on the "
                f"{pair.second}; correct the posture or `at`, or let `posture: solve` find it"
            )
    if faults:
        raise SceneError(faults)


def _limits(data: Data, written: State) -> tuple[np.ndarray, tuple[str, ...]]:
    """Limits (n, 2) of all joints, and the names of joints outside theirs, which get no limits."""
    limits = data.model.position_limits.copy()
    angles = data.model.layout.joint_positions(written.position)
    out = (angles < limits[:, 0]) | (angles > limits[:, 1])
    limits[out] = -np.inf, np.inf
    return limits, tuple(np.array(data.model.joint_names)[out])


def _changes(
    layout: Layout, change: np.ndarray
) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
    """Sizes of a change like a velocity, by robot.

    The largest entry of the joints, and of floating bases the norms of both parts of the twist.
    """
    joints = layout.split_joints(layout.joint_rates(change))
    of_joints = {robot: float(np.max(np.abs(v))) for robot, v in joints.items() if v.size}
    names = [layout.names[i] for i in layout.floating_robots]
    twists = dict(zip(names, layout.base_twists(change), strict=True))
    linear = {robot: float(np.linalg.norm(twist[:3])) for robot, twist in twists.items()}
    angular = {robot: float(np.linalg.norm(twist[3:])) for robot, twist in twists.items()}
    return of_joints, linear, angular


def _close_rates(data: Data, size: float) -> float:
    """Project the velocities in the data, with its kinematics; returns the energy lost [J].

    Velocities whose gap rates are roundings are not changed.
    """
    b, joints = data.arrays, data.model.layout.rate_count
    free = np.full((joints, 2), [-np.inf, np.inf])
    blocks = list(range(data.model.layout.block_count))
    linkage = Linkage(data, blocks, True, free, True, size)
    place, lost = linkage.posture(), 0.0
    v = b.state.velocity / linkage.unit
    # 100 roundings of the terms that cancel in a rate
    terms = float(np.max(np.abs(place.rows) @ np.abs(v), initial=0.0))
    closed = 100 * np.finfo(float).eps * terms
    for _ in range(3):
        if not np.max(np.abs(data.contact_rows.gap_rate), initial=0.0) > closed:
            break
        impact = inelastic_impact(place.rows, place.factor, v)
        v += impact.change
        lost += impact.energy_lost
        b.state.velocity[:] = linkage.unit * v
        require_ok(data, update_kinematics(data.struct))
    return lost
