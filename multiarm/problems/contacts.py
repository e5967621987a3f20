"""Joints whose contacts are redundant, nearly dependent, or just enough to enclose the object."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiarm.problems.building import (
    DOWN,
    GRAVITY,
    TEXTBOOK_BASES,
    TEXTBOOK_POSTURES,
    grips_on_box,
    joint_pd,
    two_arms,
    two_ur5_and_box,
)
from multiarm.problems.case import Criterion, HardCase, distance_from, largest, sound
from multiarm.scene import Scene

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

ACCURACY = 1e-6
# Angle between contact normals that should be perpendicular [rad].
NEARLY_PARALLEL = 1e-4
# Distance of two contacts of a corner gripper on one face [m]; 0 would lose a constraint.
NEAR_LOSS = 1e-5
# Six points and normals that hold a body: three, two and one, 0.1 m apart, in the tip's frame.
_H = 0.05
POINTS = [[_H, 0, 0], [-_H, _H, 0], [-_H, -_H, 0], [_H, 0, 0], [-_H, 0, 0], [0, 0, 0]]
_Z, _Y, _X = [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]
NORMALS = [_Z, _Z, _Z, _Y, _Y, _X]
CORNERS = (
    {"xyz": [-0.3, -0.25, 0.2], "quaternion_xyzw": [1, 1, 0, 0]},
    {"xyz": [0.3, 0.25, -0.2], "quaternion_xyzw": [0, 0, 1, 0]},
)
# Fingertips of the corner gripper of S.Y. Ho's thesis, example 3.1: points on the block's corner
# [m] and the axis across the face that each touches.
GRIPPER_POINTS = ((0.04, 0.03, 0.0), (0.05, 0.0, 0.06), (0.09, 0.05, 0.0), (0.0, 0.07, 0.05))
GRIPPER_FACES = ("z", "y", "z", "x")
# The fingertips of the second gripper that are kept: with the first's four they enclose the block.
KEPT = (0, 1, 3)
_TORQUES = {
    "kind": "harmonic",
    "frequency": 1.0,
    "amplitude": {"left": [8.0, 8.0, 8.0, 2.0, 2.0, 2.0], "right": [4.0, 4.0, 4.0, 1.0, 1.0, 1.0]},
}


def held_box(name: str, normals: Sequence = NORMALS, times: int = 1) -> Scene:
    """Two UR5 arms swing a box without gravity; the right one holds it by contacts at POINTS."""
    pose = grips_on_box()["right"]
    contacts = [
        {"arm": {"point": p}, "object": {"plane": {"point": p, "normal": n}}}
        for _ in range(times)
        for p, n in zip(POINTS, normals, strict=True)
    ]
    data = two_ur5_and_box(gravity=None)
    data["joints"][1] = {"arm": "right", "kind": "contacts", "at": pose, "contacts": contacts}
    return Scene(
        **data,
        name=name,
        control=_TORQUES,
        effects={"joint_damping": 5.0},
        run={"duration": 1.0, "accuracy": ACCURACY},
    )


def near_parallel_contacts_scene() -> Scene:
    """The normals along y and x are tilted towards z until they nearly coincide with it."""
    along, across = np.cos(NEARLY_PARALLEL), np.sin(NEARLY_PARALLEL)
    tilted = [[0.0, across, along]] * 2 + [[across, 0.0, along]]
    return held_box("nearly parallel contact normals", [*NORMALS[:3], *tilted])


def corner_block(name: str, right: dict, points=GRIPPER_POINTS, **changes) -> Scene:
    """Two textbook arms hold a block at opposite corners; the joint of the right one is given."""
    arms = two_arms(
        TEXTBOOK_BASES,
        TEXTBOOK_POSTURES,
        robot="textbook_6r",
        tool={"robot": "corner_gripper", "mount": "tool"},
        tip="corner",
    )
    left = {"kind": "corner_gripper", "arm": "left", "points": points, "at": CORNERS[0]}
    stiffness = [1500.0, 1500.0, 1500.0, 200.0, 200.0, 100.0]
    damping = [150.0, 150.0, 150.0, 10.0, 10.0, 5.0]
    data = {
        "name": name,
        "gravity": DOWN,
        "object": {"shape": {"box": [0.6, 0.5, 0.4]}, "mass": 15.0, "pose": {"xyz": [0, 0, 0.6]}},
        "arms": arms,
        "joints": [left, {"arm": "right", "at": CORNERS[1], **right}],
        "control": joint_pd(stiffness, damping),
        "run": {"duration": 1.5, "accuracy": ACCURACY},
    }
    return Scene(**{**data, **changes})


def form_closure_rest_scene() -> Scene:
    """Four fingertips at one corner and three at the other; nothing moves for 60 s."""
    contacts = []
    for i in KEPT:
        normal = [-float(axis == GRIPPER_FACES[i]) for axis in "xyz"]
        point = list(GRIPPER_POINTS[i])
        plane = {"point": point, "normal": normal}
        contacts.append({"arm": {"point": point}, "object": {"plane": plane}})
    return corner_block(
        "seven contacts at rest",
        {"kind": "contacts", "contacts": contacts},
        run={"duration": 60.0, "accuracy": ACCURACY, "output_step": 0.5},
    )


def corner_grippers_near_loss_scene() -> Scene:
    """Two fingertips of each gripper nearly at one point of one face, while the block is moved."""
    first = GRIPPER_POINTS[0]
    points = list(GRIPPER_POINTS)
    points[2] = (first[0] + 0.8 * NEAR_LOSS, first[1] + 0.6 * NEAR_LOSS, 0.0)
    scene = corner_block("corner grippers near loss", {"kind": "corner_gripper"}, points)
    joints = [joint.model_copy(update={"points": tuple(points)}) for joint in scene.joints]
    path = [{"time": 1.5, "xyz": [0, 0.05, 0.65], "rpy": [0, 0, 0.1]}]
    control = scene.control.model_dump(exclude={"path"})
    return scene.replace(joints=joints, control={**control, "path": path})


def _forces_shared(run: Trajectory, system: System) -> float:
    """Largest difference of the forces of the two copies of a contact, relative to the largest."""
    forces = run.contact_forces["right"]
    half = forces.shape[1] // 2
    return largest(forces[:, :half] - forces[:, half:]) / largest(forces)


def _moved(run: Trajectory, system: System) -> float:
    return largest(run.object_position - run.object_position[0])


# All these contacts leave the tip no motion on the box, as six plain ones do: what moves is the
# same system.
_SAME_MOTION = distance_from("the plainly held box", 2 * ACCURACY, held_box, "contacts once")
# Weight of the block times the width of its corner.
_WEIGHT = 15.0 * GRAVITY * 0.1

CASES = (
    HardCase(
        "duplicated_rows",
        "Every contact of a grasp twice",
        "Twelve contacts do the work of six: the constraint matrix has two equal rows for each, "
        "and only the sum of two forces is determined.",
        partial(held_box, "contacts twice", times=2),
        (
            *sound(ACCURACY),
            _SAME_MOTION,
            # the minimum-norm forces share equally, to the roundings of a least-squares solution
            Criterion("copies share unequally", 1e-8, "1", _forces_shared),
        ),
        events=True,
    ),
    HardCase(
        "near_parallel_contacts",
        "Contact normals that are parallel to 1e-4 rad",
        "The contacts hold the box as firmly as a weld, but by differences of nearly equal "
        "directions: K is conditioned like the inverse square of the angle, 1e8 and more.",
        near_parallel_contacts_scene,
        (*sound(ACCURACY), _SAME_MOTION),
    ),
    HardCase(
        "form_closure_rest",
        "Seven contacts enclose a block at rest for 60 s",
        "Nothing should move. Errors of roundings, projection and control accumulate for a "
        "minute, and become visible where a solver creeps.",
        form_closure_rest_scene,
        (
            *sound(ACCURACY, scale=_WEIGHT, named="weight x 0.1 m"),
            Criterion("block moved", ACCURACY, "m", _moved),
        ),
    ),
    HardCase(
        "corner_grippers_near_loss",
        "Corner grippers that have nearly lost a constraint",
        "Two fingertips touch one face 0.01 mm apart: their difference, which alone keeps the "
        "block from tipping, is 1e-4 of either.",
        corner_grippers_near_loss_scene,
        sound(ACCURACY),
    ),
)
