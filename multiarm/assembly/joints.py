"""The joints of a scene: their contacts, frames and free motions, and the rows of W.

Joints that another system (``like``) has too are shared with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multiarm.assembly.contact_effects import JointLaws, unilateral_constraints
from multiarm.assembly.robots import Robots
from multiarm.contacts.joint import COMPONENTS, Joint, JointFrame
from multiarm.contacts.table import JointRow, PackedContacts, pack
from multiarm.contacts.unilateral import UnilateralConstraints
from multiarm.dynamics.connections import Connection
from multiarm.dynamics.contact_geometry import free_components, joint_wrenches
from multiarm.dynamics.data import Data
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.effects.building import joint_numbers
from multiarm.errors import ModelError
from multiarm.scene import JointSpec, ResolvedRobot, Scene, friction_of
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.values import SURROUNDINGS


@dataclass(frozen=True)
class Rows:
    """All rows of W of a scene."""

    layout: Layout
    connections: dict[str, Connection]
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
    shared, specs = {}, {joint.connection: joint for joint in scene.joints}
    if like is not None:
        # a joint without ``at`` is where its bodies are at the start
        moved = scene.object.pose != like.scene.object.pose
        joints_of_like = {joint.connection: joint for joint in like.scene.joints}
        for name, joint in specs.items():
            placed = joint.at is not None or not moved
            bodies = [body.robot for body in (joint.first, joint.second) if body.is_link]
            at_rest = all(robot in robots.shared for robot in bodies)
            if at_rest and placed and joint == joints_of_like.get(name):
                shared[name] = like.model.joints[name]
    connections = scene_connections(scene, robots)
    return {
        name: shared.get(name) or _make_joint(specs[name], scene, robots) for name in connections
    }


def joint_frames(scene: Scene, data: Data, start: State) -> dict[str, JointFrame]:
    """The frame of every connection, with its free motions."""
    closed, frames = data.closed, {}
    for joint in scene.joints:
        frame = closed.model.frames[joint.connection]
        if joint.free is None:
            frame = replace(frame, free=free_components(closed, joint.connection, start))
        elif joint.kind not in BUILT_IN:
            _check_free(joint, closed, start)
        frames[joint.connection] = frame
    return {name: frames[name] for name in closed.model.connections}


def contact_rows(scene: Scene, robots: Robots, joints: Mapping[str, Joint]) -> Rows:
    """All rows that can be active, and which of them are unilateral."""
    arms, connections = robots.arms, scene_connections(scene, robots)
    contacts = {name: joint.contacts for name, joint in joints.items()}
    couplings = {name: _coupling_rows(resolved) for name, resolved in robots.resolved.items()}
    unilateral = _unilateral(scene, robots, connections, contacts, couplings)
    records = _bilateral(connections, contacts, couplings)
    if unilateral is not None:
        records = unilateral.records
    owners = [owner for owner in records if owner in connections or records[owner]]
    of_owners = [
        (connections[owner].robot if owner in connections else owner) or SURROUNDINGS
        for owner in owners
    ]
    blocks = [*arms, *([SURROUNDINGS] if SURROUNDINGS in of_owners else [])]
    robot_of = [blocks.index(robot) for robot in of_owners]
    layout = Layout(
        names=tuple(arms),
        first_joint=_bounds([arms[name].dof if name in arms else 0 for name in blocks]),
        owners=tuple(owners),
        first_contact=_bounds([len(records[name]) for name in owners]),
        robot_of=tuple(robot_of),
    )
    on_links = {}
    for owner in owners:
        on_links[owner] = records[owner]
        if owner in connections:
            pair = connections[owner]
            first, second = robots.placement(pair.first), robots.placement(pair.second)
            on_links[owner] = [record.moved_on_bodies(first, second) for record in records[owner]]
    packed = pack([record for on_link in on_links.values() for record in on_link])
    return Rows(layout, connections, records, on_links, packed, unilateral)


def _coupling_rows(robot: ResolvedRobot) -> list[JointRow]:
    """The rows of a robot's joints that copy others."""
    names = list(robot.joint_names)
    return [
        JointRow(
            f"{coupling.joint} copies {coupling.leader}",
            names.index(coupling.joint),
            bound=coupling.offset,
            leader=names.index(coupling.leader),
            multiplier=coupling.multiplier,
        )
        for coupling in robot.mimic
    ]


def _bilateral(
    connections: Mapping[str, Connection],
    contacts: Mapping[str, list],
    couplings: Mapping[str, list[JointRow]],
) -> dict[str, list]:
    """All rows by owner, where none is unilateral; those of a robot together."""
    records: dict[str, list] = {}
    for robot in (*couplings, ""):
        for name, connection in connections.items():
            if connection.robot == robot:
                records[name] = list(contacts[name])
        if robot:
            records.setdefault(robot, []).extend(couplings[robot])
    return records


def scene_connections(scene: Scene, robots: Robots) -> dict[str, Connection]:
    """The connections of a scene's joints, those of a robot together, in the robots' order."""
    of_joints = [Connection(joint.connection, joint.first, joint.second) for joint in scene.joints]
    order = [*robots.arms, ""]  # those without a robot are last
    of_joints.sort(key=lambda connection: order.index(connection.robot))
    return {connection.name: connection for connection in of_joints}


def _make_joint(joint: Any, scene: Scene, robots: Robots) -> Joint:
    """Contacts, frame and limits of a joint; without ``at`` it is where FIRST is at the start."""
    try:
        if joint.at is not None:
            pose = joint.at.matrix()
        else:
            first, second = (robots.pose(scene, body) for body in (joint.first, joint.second))
            frame = first @ joint.on_first.matrix() @ joint.start_shift()
            pose = np.linalg.solve(second, frame)
        contacts, (on_tip, on_object) = joint.placed(pose), joint.frames(pose)
    except ModelError as error:
        raise ModelError(f"joint of arm '{joint.connection}': {error}") from error
    frame = JointFrame(on_tip, on_object, joint.free or ())
    return Joint(contacts, frame, joint.free_limits)


def _check_free(joint: JointSpec, data: Data, start: State) -> None:
    """Raise unless the components that a kind calls free are coordinates of its free motions."""
    free = free_components(data, joint.connection, start)
    space = null_space(joint_wrenches(data, joint.connection)).basis  # (6, m)
    parts = space[list(joint.free or ())]
    if len(parts) != len(free) or np.linalg.matrix_rank(parts, 1e-6) < len(free):
        motions = ", ".join(COMPONENTS[k] for k in free) or "no motion"
        raise ModelError(
            f"joint of arm '{joint.connection}': joint kind {joint.kind!r} says free = "
            f"{joint.free}, but its contacts leave {motions} free; correct it, or leave it out"
        )


def _unilateral(
    scene: Scene,
    robots: Robots,
    connections: Mapping[str, Connection],
    contacts: Mapping[str, list],
    couplings: Mapping[str, list[JointRow]],
) -> UnilateralConstraints | None:
    effects = scene.effects
    has_friction = any(contact.mu for of_joint in contacts.values() for contact in of_joint)
    if not (effects.with_events or has_friction):
        return None
    limits = {
        name: dict(zip(arm.joint_names, map(tuple, arm.position_limits), strict=True))
        for name, arm in robots.arms.items()
    }
    dry = None
    if "joint_friction" in effects.with_events and effects.joint_friction is not None:
        outlines = {name: arm.joints for name, arm in robots.resolved.items()}
        dry = joint_numbers(effects.joint_friction.torque, outlines, friction_of)
    robot_of = {name: connection.robot for name, connection in connections.items()}
    return unilateral_constraints(scene, contacts, robot_of, JointLaws(limits, couplings, dry))


def _bounds(sizes: list[int]) -> tuple[int, ...]:
    return (0, *np.cumsum(sizes).tolist())
