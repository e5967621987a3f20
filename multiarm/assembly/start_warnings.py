"""Warnings about a start that is possible but probably not meant."""

from __future__ import annotations

from collections.abc import Mapping, Set

import numpy as np

from multiarm.assembly.linkage import scene_size
from multiarm.assembly.postures import overlapping_links, posture_of
from multiarm.assembly.start import TOUCHING
from multiarm.control.gravity_compensation import (
    uncarried_bases,
    uncarried_joints,
    uncarried_weight,
)
from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import joint_of, require_ok
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.notation import number, numbers
from multiarm.robots.robot import Robot
from multiarm.scene import JointSpec
from multiarm.scene.bodies import object_named
from multiarm.scene.faults import place
from multiarm.scene.values import floor_owner

# A joint may be off the object's shape by a fingertip [m], beside the surface that it states.
FINGERTIP = 0.02
# Part of the weight that contacts may leave: joints are closed to roundings of the scene's size.
UNCARRIED = 1e-6


def start_warnings(system: System) -> list[str]:
    """What a start has that is possible but probably not meant.

    Weight that the control is to carry and the contacts cannot, joints off the object's shape,
    written postures that assembly pushed into a limit, and links of arms without a written posture
    that overlap the object or other arms.
    """
    return [
        *_objects_without_a_place(system),
        *_weight_not_carried(system),
        *_joints_off_the_object(system),
        *_joints_at_limits(system),
        *_links_in_the_way(system),
    ]


def _objects_without_a_place(system: System) -> list[str]:
    """Of several objects those without a pose that no joint places either."""
    bodies = system.scene.objects or {}
    return [
        f"{place(('objects', name))}: no 'pose' is written, and no joint says where it is; it "
        "starts at the world's origin"
        for name, body in bodies.items()
        if len(bodies) > 1 and "pose" not in body.model_fields_set
    ]


def _weight_not_carried(system: System) -> list[str]:
    scene, python = system.scene, system.model.python_control
    if python is not None and not python.in_scene:
        return []
    if scene.gravity is None or not any(scene.gravity) or not scene.control.carries:
        return []
    with system.borrow() as data:
        of_laws, unilateral = data.of_laws, data.model.unilateral
        if unilateral is not None and unilateral.timed:
            of_laws = data.view(data.model.of_laws(unilateral.holding_at(0.0)))
        start, size = system.initial_state(), scene_size(of_laws)
        left = uncarried_weight(of_laws, start)
        hanging = uncarried_bases(of_laws, start)
        idle = uncarried_joints(of_laws, start)
        lying = _lying_on_the_floor(data, start)
    return [
        *_objects_not_carried(system, left, size, lying),
        *(
            f"{place(('control',))}: no contact carries {numbers(wrench[:3], 'N')} and "
            f"{numbers(wrench[3:], 'N m')} of the weight of robot '{name}', about the origin of "
            "its base, world axes, and it gives way there; join it to the world with fewer free "
            "motions"
            for name, wrench in hanging.items()
            if np.linalg.norm([*wrench[:3], *wrench[3:] / size])
            > UNCARRIED * np.linalg.norm(scene.gravity) * _mass_of(system.arms[name])
        ),
        *_passive_joints_not_carried(system, idle, size),
    ]


def _passive_joints_not_carried(
    system: System, left: Mapping[int, float], size: float
) -> list[str]:
    """Warnings of passive joints whose gravity torque is ``left`` to nobody."""
    warnings, layout = [], system.model.layout
    gravity = float(np.linalg.norm(system.model.constants.gravity))
    for joint, torque in left.items():
        name = layout.names[layout.robot_of_joint(joint)]
        lever = 1.0 if system.model.joint_units[joint] == "m" else size
        if abs(torque) > UNCARRIED * gravity * _mass_of(system.arms[name]) * lever:
            unit = "N" if system.model.joint_units[joint] == "m" else "N m"
            warnings.append(
                f"{place(('control',))}: no contact carries {number(torque, unit)} of the weight "
                f"on the passive joint '{system.model.joint_names[joint]}', and it gives way "
                "there; give it a drive, or start where it hangs"
            )
    return warnings


def _lying_on_the_floor(data: Data, start: State) -> set[str]:
    """The objects that stand on the floor at a start, on points that touch it around below them."""
    if data.model.unilateral is None:
        return set()
    objects, constraints = data.model.layout.objects, data.model.unilateral.constraints
    owners = {floor_owner(name, objects): name for name in objects}
    place_state(data, 0.0, start)
    require_ok(data, update_kinematics(data.struct))
    gaps, touching = data.contact_rows.gap, TOUCHING * scene_size(data)
    points: dict[str, list[np.ndarray]] = {}
    for constraint in constraints:
        if constraint.owner in owners and gaps[constraint.row] <= touching:
            point = data.contact_rows.point[constraint.row]
            points.setdefault(owners[constraint.owner], []).append(point)
    gravity = data.model.constants.gravity
    return {
        name
        for name, of_object in points.items()
        if _carry(np.array(of_object) - start.objects[name].position, gravity, touching)
    }


def _carry(arms: np.ndarray, gravity: np.ndarray, small: float) -> bool:
    """Whether points (P, 3) from a centre of mass lie around below it, or just below it [m]."""
    sideways = np.linalg.svd(gravity[None, :])[2][1:]
    flat = arms @ sideways.T
    if np.linalg.norm(flat, axis=1).min() <= small:
        return True
    angles = np.sort(np.arctan2(flat[:, 1], flat[:, 0]))
    return bool(np.max(np.diff(angles, append=angles[0] + 2.0 * np.pi)) <= np.pi + 1e-9)


def _objects_not_carried(
    system: System, left: np.ndarray, size: float, lying: Set[str]
) -> list[str]:
    """Warnings of the objects of whose weight some is ``left``, wrenches (6 F,).

    Those ``lying`` on the floor need no joint.
    """
    warnings, objects, gravity = [], system.scene.all_objects, system.model.constants.gravity
    where = place(("control",))
    at_start = {joint.connection for joint in system.scene.joints if joint.holds_at(0.0)}
    connections = [pair for pair in system.model.connections.values() if pair.name in at_start]
    for (name, body), wrench in zip(objects.items(), left.reshape(-1, 6), strict=True):
        weight = body.mass * float(np.linalg.norm(gravity))
        if np.linalg.norm([*wrench[:3], *wrench[3:] / size]) <= UNCARRIED * weight:
            continue
        of_object = "the object" if len(objects) == 1 else f"object '{name}'"
        bodies = object_named(name)
        holding = [repr(pair.name) for pair in connections if bodies in (pair.first, pair.second)]
        if not holding:
            if name in lying:
                continue
            when = "" if len(at_start) == len(system.scene.joints) else " at the start"
            warnings.append(f"{where}: no joint holds {of_object}{when}, and it falls")
            continue
        owner = "the object's" if len(objects) == 1 else f"the '{name}' object's"
        warnings.append(
            f"{where}: the contacts of {', '.join(holding)} cannot carry all of {owner} "
            f"weight, {number(weight, 'N')}: {numbers(wrench[:3], 'N')} and "
            f"{numbers(wrench[3:], 'N m')} about its centre of mass, world axes, are left, and it "
            "gives way there; add an arm, or join one with fewer free motions (`uncarried_wrench` "
            "of an evaluation has what is left)"
        )
    return warnings


def _mass_of(robot: Robot) -> float:
    return float(sum(inertia.mass for inertia in robot.model.inertias))


def _joints_off_the_object(system: System) -> list[str]:
    """Of joints whose kind states the contacts; listed contacts have surfaces of their own."""
    warnings = []
    for place_of_joint, joint in enumerate(system.scene.joints):
        pair = system.model.connections[joint.connection]
        located_later = joint.at is None and not joint.holds_at(0.0)
        if not pair.on_object or located_later:
            continue
        point = system.frames[joint.connection].on_object[:3, 3]
        body = system.scene.all_objects[pair.second.tip]
        solid = None if joint.as_listed else body.shape.solid
        nearest = None if solid is None else solid.nearest(point)
        if nearest is None:
            continue
        distance = float(np.linalg.norm(point - nearest))
        if distance <= FINGERTIP + _own_size(joint):
            continue
        where, remedy = place(("joints", place_of_joint)), "'at'"
        if joint.at is None:
            remedy = "the posture or the base, since without 'at' the joint is where the tip is"
            if pair.first.is_object:
                remedy = f"the pose of either object, or 'at', the joint's place on '{pair.second}'"
        there = ", ".join(f"{x:.3g}" for x in nearest)
        of_object = "the object's shape"
        if len(system.scene.all_objects) > 1:
            of_object = f"the shape of '{pair.second}'"
        warnings.append(
            f"{where}: {joint_of(system.model, joint.connection)} is {distance:.3g} m off "
            f"{of_object}, whose nearest point is [{there}] in the object's frame; correct "
            f"{remedy}, or leave it if the object has a handle there"
        )
    return warnings


def _own_size(joint: JointSpec) -> float:
    """Radii of the fingertip and of the surface on the object, where the joint has them [m]."""
    return sum(getattr(joint, name, None) or 0.0 for name in ("tip_radius", "radius"))


def _joints_at_limits(system: System) -> list[str]:
    start, warnings = system.initial_state().joint_positions, []
    for path, written in system.start_report.pushed_to_limit.items():
        arm, joint = path.split("/", 1)
        limit = start[arm][system.arms[arm].joint_names.index(joint)]
        unit = system.arms[arm].joint_units[joint]
        where, _ = posture_of(system.scene, arm)
        warnings.append(
            f"{place(where)}: {joint!r} is written at {written:.6g} {unit}; "
            f"to close the joints, assembly pushed it into its limit {limit:.6g} {unit}; "
            "correct the posture, the base or the joint's place"
        )
    return warnings


def _links_in_the_way(system: System) -> list[str]:
    postures = system.initial_state().joint_positions
    return [
        f"{place(posture_of(system.scene, robot)[0])}: {pair.link} overlaps {pair.obstacle} by "
        f"{-pair.distance:.2g} m (convex hulls), and no posture was found that does not; move "
        "the base, choose other places of its joints, or write a posture"
        for robot, pair in overlapping_links(system.scene, system.arms, postures).items()
    ]
