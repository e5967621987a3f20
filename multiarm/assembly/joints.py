"""The joints of a scene: their contacts, frames and free motions, and the rows of W.

Joints that another system (``like``) has too are shared with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from multiarm.assembly.blocks import Block, blocks_of_group, branch_bounds, joints_of_connection
from multiarm.assembly.contact_effects import (
    JointLaws,
    joints_with_rows,
    unilateral_constraints,
)
from multiarm.assembly.robots import Robots
from multiarm.contacts.joint import COMPONENTS, Joint, JointFrame
from multiarm.contacts.table import JointRow, PackedContacts, WheelRow, pack
from multiarm.contacts.unilateral import UnilateralConstraints
from multiarm.dynamics.connections import Connection
from multiarm.dynamics.contact_geometry import free_components, joint_wrenches, pose_and_twist
from multiarm.dynamics.data import Data
from multiarm.dynamics.failures import joint_of, joint_text
from multiarm.dynamics.layout import TWIST, Layout
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.effects.building import joint_numbers
from multiarm.errors import ModelError
from multiarm.robots.robot import Robot
from multiarm.scene import JointSpec, ResolvedRobot, Scene, friction_of
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.joints.contacts import ContactsJoint
from multiarm.spatial import matrix_to_quaternion

# Name of the row of a robot on wheels.
NO_SIDE_SLIP = "no slip sideways"


@dataclass(frozen=True)
class SceneRows:
    """All rows of W of a scene."""

    layout: Layout
    blocks: list[Block]  # of the robots
    connections: dict[str, Connection]  # in the order of the blocks
    records: Mapping[str, list]  # of every owner, the first body's geometry in its tip's frame
    on_links: dict[str, list]  # the same, geometry on links in that of the joint that moves them
    packed: PackedContacts
    unilateral: UnilateralConstraints | None


def scene_joints(scene: Scene, robots: Robots, like: System | None = None) -> dict[str, Joint]:
    """The joints of a scene by arm; equal ones of ``like`` are shared.

    Raises
    ------
    ModelError
        Naming the joint that cannot be made.
    """
    specs = {joint.connection: joint for joint in scene.joints}
    of_like = {} if like is None else {joint.connection: joint for joint in like.scene.joints}
    joints = {}
    for name in scene_connections(scene, robots):
        spec = specs[name]
        with _named(spec):
            place = _place(spec, scene, robots)
            bodies = [body.robot for body in (spec.first, spec.second) if body.is_link]
            if like is not None and spec == of_like.get(name) and {*bodies} <= {*robots.shared}:
                shared = like.model.joints[name]
                # a joint without ``at`` is where its bodies are at the start
                if np.array_equal(shared.frame.on_object, spec.frames(place)[1]):
                    joints[name] = shared
                    continue
            joints[name] = _make_joint(spec, place)
    return joints


def joint_frames(scene: Scene, data: Data, start: State) -> dict[str, JointFrame]:
    """The frame of every connection, with its free motions."""
    closed, frames = data.closed, {}
    for joint in scene.joints:
        frame = closed.model.frames[joint.connection]
        if joint.free is None or joint.kind not in BUILT_IN:
            state = _where_joined(joint, closed, start)
            if joint.free is not None:
                _check_free(joint, closed, state)
            else:
                frame = replace(frame, free=free_components(closed, joint.connection, state))
        frames[joint.connection] = frame
    return {name: frames[name] for name in closed.model.connections}


def _where_joined(joint: JointSpec, data: Data, start: State) -> State:
    """A state in which a joint's frames coincide: the start, if it holds there.

    For joints that take hold later, with places of their own, an object is put there.  Listed
    contacts touch elsewhere, and are looked at where they are at the start.
    """
    objects = [body for body in (joint.second, joint.first) if body.is_object]
    apart = joint.at is not None and not joint.holds_at(0.0)
    if not (apart and objects) or isinstance(joint, ContactsJoint):
        return start
    state, model = start.copy(), data.model
    frame, pair = model.frames[joint.connection], model.connections[joint.connection]
    (X_W1, _), (X_W2, _) = (pose_and_twist(model, start, at) for at in (pair.first, pair.second))
    X_WO = X_W2 @ frame.on_object @ np.linalg.inv(frame.on_tip)
    if objects[0] == joint.second:
        X_WO = X_W1 @ frame.on_tip @ np.linalg.inv(frame.on_object)
    motion = state.objects[objects[0].tip]
    motion.position[:], motion.quaternion_xyzw[:] = X_WO[:3, 3], matrix_to_quaternion(X_WO[:3, :3])
    return state


def contact_rows(scene: Scene, robots: Robots, joints: Mapping[str, Joint]) -> SceneRows:
    """All rows that can be active, and which of them are unilateral."""
    connections = scene_connections(scene, robots)
    contacts = {name: joint.contacts for name, joint in joints.items()}
    of_joints = {name: _rows_of_joints(resolved) for name, resolved in robots.resolved.items()}
    laws = _joint_laws(scene, robots, contacts, of_joints)
    blocks = scene_blocks(scene, robots, connections, laws, of_joints)
    around = [name for name, connection in connections.items() if not connection.robots]
    unilateral = None
    if laws is not None:
        unilateral = unilateral_constraints(scene, contacts, blocks, around, laws)
    records = _bilateral(blocks, around, contacts, of_joints)
    if unilateral is not None:
        records = unilateral.records
    layout = _layout(tuple(scene.all_objects), robots, blocks, connections, records)
    on_links, owners = {}, layout.owners
    for owner in owners:
        on_links[owner] = records[owner]
        if owner in connections:
            pair = connections[owner]
            first, second = robots.placement(pair.first), robots.placement(pair.second)
            on_links[owner] = [record.moved_on_bodies(first, second) for record in records[owner]]
    starts = [_first_in_block(block) for block in blocks]
    packed = pack(
        [
            _in_block(record, starts[block][owner]) if is_of_joint(record) else record
            for block, (owner, on_link) in zip(layout.block_of, on_links.items(), strict=True)
            for record in on_link
        ]
    )
    return SceneRows(layout, blocks, connections, records, on_links, packed, unilateral)


def _rows_of_joints(robot: ResolvedRobot) -> list[JointRow | WheelRow]:
    """The rows of a robot's joints that copy others, and of its wheels."""
    names = list(robot.joint_names)
    wheels = [WheelRow(NO_SIDE_SLIP, names.index("base_x"))] if robot.on_wheels else []
    first = TWIST if robot.base_floats else 0
    couplings = [
        JointRow(
            f"{coupling.joint} copies {coupling.leader}",
            first + names.index(coupling.joint),
            bound=coupling.offset,
            leader=first + names.index(coupling.leader),
            multiplier=coupling.multiplier,
        )
        for coupling in robot.mimic
    ]
    return [*couplings, *wheels]


def is_of_joint(record: Any) -> bool:
    """Whether a row belongs to joints of a robot."""
    return isinstance(record, JointRow | WheelRow)


def _first_in_block(block: Block) -> dict[str, int]:
    """Place in a block of the first joint of the robot of each owner of joints' rows."""
    places, before = {}, 0
    for part in block.parts:
        places[part.owner] = before - part.joints.start
        before += len(part.joints)
    return places


def _in_block(record: JointRow | WheelRow, first: int) -> JointRow | WheelRow:
    """A record with joints counted from the block's first one; the robot's has place ``first``."""
    if isinstance(record, WheelRow):
        return replace(record, joint=first + record.joint)
    leader = first + record.leader if record.leader >= 0 else -1
    return replace(record, joint=first + record.joint, leader=leader)


def scene_blocks(
    scene: Scene,
    robots: Robots,
    connections: Mapping[str, Connection],
    laws: JointLaws | None,
    of_joints: Mapping[str, list[JointRow | WheelRow]],
) -> list[Block]:
    """The blocks of all robots, in the order of the equations."""
    blocks = []
    with_rows = {name: {row.joint for row in rows} for name, rows in of_joints.items()}
    if laws is not None:
        with_rows = joints_with_rows(scene, laws)
    for group in robots.groups(connections.values()):
        of_group = [pair for pair in connections.values() if group.keys() & pair.robots]
        blocks += blocks_of_group(group, of_group, of_joints, with_rows)
    return blocks


def _layout(
    objects: tuple[str, ...],
    robots: Robots,
    blocks: Sequence[Block],
    connections: Mapping[str, Connection],
    records: Mapping[str, list],
) -> Layout:
    owners = [owner for owner in records if owner in connections or records[owner]]
    block_of = {name: k for k, block in enumerate(blocks) for name in block.connections}
    # a robot is the owner of the rows of joints of one block at most
    rows_of_joints = {
        part.owner: k
        for k, block in enumerate(blocks)
        for part in block.parts
        if any(
            is_of_joint(record) and record.joint in part.joints
            for record in records.get(part.owner, ())
        )
    }
    of_owners = [block_of.get(name, rows_of_joints.get(name, len(blocks))) for name in owners]
    surroundings = [0] if len(blocks) in of_owners else []
    return Layout(
        objects=objects,
        names=tuple(robots.by_name),
        first_joint=_bounds([arm.dof for arm in robots.by_name.values()]),
        first_joint_of_block=_bounds([*(block.joint_count for block in blocks), *surroundings]),
        owners=tuple(owners),
        first_contact=_bounds([len(records[name]) for name in owners]),
        block_of=tuple(of_owners),
        floating_robots=tuple(i for i, arm in enumerate(robots.by_name.values()) if arm.floats),
        passive_joints=_passive_joints(robots),
        noun="arms" if all(arm.noun == "arm" for arm in robots.by_name.values()) else "robots",
    )


def _passive_joints(robots: Robots) -> tuple[int, ...]:
    """Numbers among all joints of those without a drive."""
    numbers, first = [], 0
    for name, robot in robots.by_name.items():
        passive = robots.resolved[name].passive
        names = enumerate(robot.velocity_names, start=first)
        numbers += [number for number, joint in names if joint in passive]
        first += robot.dof
    return tuple(numbers)


def _bilateral(
    blocks: Sequence[Block],
    around: Sequence[str],
    contacts: Mapping[str, list],
    of_joints: Mapping[str, list[JointRow | WheelRow]],
) -> dict[str, list]:
    """All rows by owner, where none is unilateral; those of a block together."""
    records: dict[str, list] = {}
    for block in blocks:
        records |= {name: list(contacts[name]) for name in block.connections}
        for part in block.parts:
            of_part = [row for row in of_joints[part.robot] if row.joint in part.joints]
            if of_part:
                records.setdefault(part.owner, []).extend(of_part)
    return records | {name: list(contacts[name]) for name in around}


def scene_connections(scene: Scene, robots: Robots) -> dict[str, Connection]:
    """The connections of a scene's joints in the order of the equations.

    Those of a robot, or of robots that are joined to each other, are together, in the robots'
    order, and so are those of a part of a robot that shares no joint with others; those without a
    robot are last.
    """
    of_joints = [Connection(joint.connection, joint.first, joint.second) for joint in scene.joints]
    ordered: dict[str, Connection] = {}
    for group in robots.groups(of_joints):
        of_group = [pair for pair in of_joints if group.keys() & pair.robots]
        if len(group) == 1:
            ((name, arm),) = group.items()
            bounds = branch_bounds(arm, of_group, _rows_of_joints(robots.resolved[name]))
            parts = [
                [pair for pair in of_group if _first_joint(arm, pair) in range(*ends)]
                for ends in pairwise(bounds)
            ]
            of_group = [pair for part in parts for pair in part]
        ordered |= {connection.name: connection for connection in of_group}
    return ordered | {pair.name: pair for pair in of_joints if not pair.robots}


def _first_joint(arm: Robot, connection: Connection) -> int:
    """A joint of the robot that moves a body of a connection; its first where none does."""
    return next(iter(joints_of_connection(arm, connection)), 0)


@contextmanager
def _named(joint: JointSpec) -> Iterator[None]:
    """Errors name the joint."""
    try:
        yield
    except ModelError as error:
        pair = Connection(joint.connection, joint.first, joint.second)
        raise ModelError(f"{joint_text(pair).removeprefix('the ')}: {error}") from error


def _place(joint: JointSpec, scene: Scene, robots: Robots) -> np.ndarray:
    """Its pose on the second body, (4, 4); without ``at`` it starts where the first body is."""
    if joint.at is not None:
        return joint.at.matrix()
    first, second = (robots.pose(scene, body) for body in (joint.first, joint.second))
    return np.linalg.solve(second, first @ joint.on_first.matrix() @ joint.start_shift())


def _make_joint(joint: JointSpec, place: np.ndarray) -> Joint:
    """Contacts, frame and limits of a joint at a place on the second body."""
    on_tip, on_object = joint.frames(place)
    frame = JointFrame(on_tip, on_object, joint.free or ())
    return Joint(joint.placed(place), frame, joint.free_limits)


def _check_free(joint: JointSpec, data: Data, start: State) -> None:
    """Raise unless the components that a kind calls free are coordinates of its free motions."""
    free = free_components(data, joint.connection, start)
    space = null_space(joint_wrenches(data, joint.connection)).basis  # (6, m)
    parts = space[list(joint.free or ())]
    if len(parts) != len(free) or np.linalg.matrix_rank(parts, 1e-6) < len(free):
        motions = ", ".join(COMPONENTS[k] for k in free) or "no motion"
        text = joint_of(data.model, joint.connection)
        raise ModelError(
            f"{text.removeprefix('the ')}: joint kind {joint.kind!r} says free = "
            f"{joint.free}, but its contacts leave {motions} free; correct it, or leave it out"
        )


def _joint_laws(
    scene: Scene,
    robots: Robots,
    contacts: Mapping[str, list],
    of_joints: Mapping[str, list[JointRow | WheelRow]],
) -> JointLaws | None:
    """Stops, dry friction, couplings and wheels; None where no row can be unilateral."""
    effects = scene.effects
    has_friction = any(contact.mu for of_joint in contacts.values() for contact in of_joint)
    has_times = any(joint.intervals for joint in scene.joints)
    if not (effects.with_events or has_friction or has_times):
        return None
    limits = {
        name: dict(zip(arm.joint_names, map(tuple, arm.position_limits), strict=True))
        for name, arm in robots.by_name.items()
    }
    dry = None
    if "joint_friction" in effects.with_events and effects.joint_friction is not None:
        outlines = {name: arm.joints for name, arm in robots.resolved.items()}
        dry = joint_numbers(effects.joint_friction.torque, outlines, friction_of)
    of_bases = {name: arm.base_dof for name, arm in robots.by_name.items()}
    return JointLaws(limits, of_joints, dry, of_bases)


def _bounds(sizes: list[int]) -> tuple[int, ...]:
    return (0, *np.cumsum(sizes).tolist())
