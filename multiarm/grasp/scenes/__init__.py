r"""From a grasp to a scene that runs: hands on real arms, postures, a path, control that squeezes.

:mod:`.hands` makes a hand of each gripper and looks for places and postures of the arms, and the
squeeze says how hard the fingertips must press.

**The squeeze** keeps all fingertips in contact along a path.  The control lets the contacts share a
wrench ``w`` with the forces (:mod:`multiarm.dynamics.forces.compiled`)

.. math:: \lambda(w) = W_o^+ w + s\,\lambda_s, \qquad W_o \lambda_s = 0,

where :math:`\lambda_s > 0` has the mean 1.  Weight and inertia of the object along the path give
the wrenches; the smallest squeeze ``s`` with which every force is at least ``f`` is

.. math:: s = \max_{j, w} \frac{f - (W_o^+ w)_j}{(\lambda_s)_j} .
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.assembly.bases import Stand
from multiarm.control.object_path import pose_path, reference_motion
from multiarm.dynamics.forces.internal_forces import distribute, pressing_forces
from multiarm.errors import GraspError
from multiarm.grasp.arguments import generator_of, number_of
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face_contacts import FaceContacts, Gripper
from multiarm.grasp.scenes.hands import (
    Progress,
    UnreachableError,
    contacts,
    fingers,
    pose_table,
    require_room,
    stand_arms,
)
from multiarm.notation import count_of
from multiarm.scene import ArmSpec, Scene, Waypoint, available_robots, find_robot, resolve_arm
from multiarm.spatial import quaternion_to_matrix
from multiarm.terminal.progress import PartProgress, displayed

__all__ = ["UnreachableError", "grasp_scene", "motion_wrenches", "needed_squeeze"]

GRAVITY = (0.0, 0.0, -9.81)
# The usual path, as parts of a 10 s run: lift and shift, turn, and back to the start.
USUAL_PATH = (
    (0.3, (0.0, 0.06, 0.08), (0.0, 0.0, 0.15)),
    (0.65, (0.05, -0.04, 0.04), (0.1, -0.08, -0.1)),
    (0.95, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
)
# Stiffness [1/s^2] and damping [1/s] of the control, critically damped.
STIFFNESS, DAMPING = 100.0, 20.0
# The weakest contact shall press with so much of the object's weight, shared by the contacts.
LEAST_SHARE = 0.25


def grasp_scene(
    grasp: FaceContacts,
    arms: Sequence[str] = ("panda", "panda"),
    *,
    mass: float = 5.0,
    tip_radius: float = 0.01,
    hand_mass: float = 0.4,
    height: float | None = None,
    path: Sequence[Waypoint] | None = None,
    duration: float = 10.0,
    accuracy: float = 1e-6,
    squeeze: float | None = None,
    name: str | None = None,
    mesh: str | Path | None = None,
    seed: int = 0,
    progress: bool | Progress | None = None,
) -> Scene:
    """A scene in which arms hold a grasp's body and move it.

    Parameters
    ----------
    grasp : FaceContacts
        In form closure.
    arms : sequence of str
        Robots by name, one for each gripper.
    mass, hand_mass : float
        Of the object, evenly spread, and of each hand [kg].
    tip_radius : float
        Of the spherical fingertips [m].
    height : float, optional
        Of the object's centre at the start [m]; left out: where the arms reach best.
    path : sequence of Waypoint, optional
        Motions of the object from the start, by their times, about its centre in axes of the world.
        Left out: it is lifted, shifted, turned and brought back.
    duration, accuracy : float
        Of the run [s], and its accuracy.
    squeeze : float, optional
        Mean internal force [N]; left out: such that the weakest contact presses with a quarter of
        its share of the weight throughout the path.
    name : str, optional
        Title of the scene.
    mesh : path, optional
        STL file that is written for a body that is not convex, and that the scene names.
    seed : int
        Of the search for postures.
    progress : bool or callable, optional
        True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function is
        called with the finished fraction, 0 to 1, and the current stage.

    Raises
    ------
    GraspError
        A grasp without closure, another number of arms; as `UnreachableError`, hands or postures
        that cannot be.
    SceneError
        Robots that do not exist.
    """
    _require_hold(grasp, arms)
    _require_numbers(
        {"mass": mass, "hand_mass": hand_mass, "tip_radius": tip_radius, "duration": duration},
        {"height": height, "squeeze": squeeze},
    )
    grasp = _centred(grasp)
    require_room(grasp, tip_radius)
    body = object_table(grasp.body, mass, mesh)
    specs = [ArmSpec(robot=robot, tip=find_robot(robot).tip) for robot in arms]
    way = path_of(path, duration)
    course = [waypoint.matrix() for waypoint in way]
    rng = generator_of(seed, "seed")
    with displayed(progress, PartProgress) as show:
        start = stand_arms(grasp, specs, course, tip_radius, height, rng, show)
    upright = grasp.placed(start.turn)
    if squeeze is None:
        squeeze = _usual_squeeze(upright, way, mass)
    if mesh is not None and "mesh" in body["shape"]:  # last: it may replace a file
        grasp.body.save(mesh)
    return Scene(
        name=name
        or f"{len(arms)} arms hold a body of {len(grasp.body.faces)} faces by its corners",
        gravity=GRAVITY,
        object={**body, "pose": pose_table(start.pose(np.eye(4)))},
        arms={
            gripper.arm_name: arm_table(upright, gripper, spec, stand, tip_radius, hand_mass)
            for gripper, spec, stand in zip(upright.grippers, specs, start.arms, strict=True)
        },
        joints=[
            {
                "arm": gripper.arm_name,
                "kind": "contacts",
                "at": pose_table(gripper.frame),
                "contacts": contacts(grasp, gripper, tip_radius),
            }
            for gripper in grasp.grippers
        ],
        control={
            "kind": "computed_torque",
            "stiffness": STIFFNESS,
            "damping": DAMPING,
            "relative_damping": DAMPING,
            "relative_stiffness": STIFFNESS,
            "squeeze": _upwards(squeeze),
            "path": [
                {"time": waypoint.time, **pose_table(start.pose(waypoint.matrix()))}
                for waypoint in way[1:]
            ],
        },
        effects={"unilateral_contacts": {}},
        run={"duration": duration, "accuracy": accuracy, "arms": "compiled"},
    )


def _require_hold(grasp: FaceContacts, arms: Sequence[str]) -> None:
    if not grasp.closure:
        raise GraspError(f"the grasp does not hold the body: {grasp.closure.message}")
    if len(arms) != len(grasp.grippers):
        raise GraspError(
            f"the grasp has {count_of(len(grasp.grippers), 'gripper')} and takes as many arms, not "
            f"{len(arms)}; robots are {', '.join(available_robots())}"
        )


def _require_numbers(positive: dict[str, Any], chosen: dict[str, Any]) -> None:
    """Check the numbers before the long search; ``chosen`` ones may be left out."""
    numbers = {**positive, **{name: value for name, value in chosen.items() if value is not None}}
    for name, value in numbers.items():
        number_of(value, f"{name} is a finite number")
        if name in positive:
            number_of(value, f"{name} is greater than 0", above=0.0)
        if name == "squeeze":
            number_of(value, "squeeze is at least 0", at_least=0.0)


def _centred(grasp: FaceContacts) -> FaceContacts:
    """The grasp with the origin of its frame at the centre of mass, as that of an object."""
    shift = np.eye(4)
    shift[:3, 3] = -grasp.body.centre
    return grasp.placed(shift)


def path_of(path: Sequence[Waypoint] | None, duration: float) -> list[Waypoint]:
    """Poses relative to the start, the start first; the usual path where none is given.

    Raises
    ------
    GraspError
        A path of no poses, or one whose times do not increase.
    """
    if path is None:
        usual = [
            Waypoint(time=round(part * duration, 6), xyz=xyz, rpy=rpy)
            for part, xyz, rpy in USUAL_PATH
        ]
        return [Waypoint(time=0.0), *usual]
    start, later = Waypoint(time=0.0), [waypoint for waypoint in path if waypoint.time != 0.0]
    if any(np.any(w.matrix() != start.matrix()) for w in path if w.time == 0.0):
        raise GraspError(
            "poses of the path are relative to the start: at 0 s there is none but the start itself"
        )
    way = [start, *later]
    if len(way) < 2:
        raise GraspError("the path has no pose after the start; leave it out for the usual one")
    for before, after in pairwise(way):
        if not after.time > before.time:
            raise GraspError(
                f"the times of the path must increase, but {after.time:g} s comes after "
                f"{before.time:g} s"
            )
    return way


def arm_table(
    grasp: FaceContacts,
    gripper: Gripper,
    spec: ArmSpec,
    stand: Stand,
    tip_radius: float,
    hand_mass: float,
) -> dict[str, Any]:
    """An arm that stands with the hand of a gripper, as a scene writes it."""
    hand = fingers(grasp, gripper, stand.mount, tip_radius, hand_mass)
    yaw = math.atan2(stand.base[1, 0], stand.base[0, 0])
    return {
        "robot": spec.robot,
        "base": {"xyz": stand.base[:3, 3].round(6).tolist(), "rpy": [0.0, 0.0, yaw]},
        "tool": {"mount": spec.tip, "fingers": hand},
        "tip": "corner",
        "posture": stand.reach.postures[0].tolist(),
        "lock": resolve_arm(spec).locked,
    }


def object_table(body: Polyhedron, mass: float, mesh: str | Path | None) -> dict[str, Any]:
    """A block along the axes as such, other convex bodies by their corners, the rest by a file."""
    edges = np.ptp(body.vertices, axis=0)
    if len(body.vertices) == 8 and np.allclose(
        np.abs(body.vertices), 0.5 * edges, rtol=0.0, atol=1e-12 * body.size
    ):
        return {"shape": {"box": edges.tolist()}, "mass": mass}
    if body.convex:
        return {"shape": {"hull": body.vertices.tolist()}, "mass": mass}
    if mesh is None:
        raise GraspError(
            "the body is not convex, and a scene takes such an object from a mesh file: say with "
            "`mesh` which STL file is to be written"
        )
    return {
        "shape": {"mesh": {"file": str(Path(mesh).expanduser().resolve())}},
        "mass": mass,
        "inertia": body.mass_properties(mass).inertia.tolist(),
    }


def _upwards(number: float) -> float:
    """Rounded up to two digits that count."""
    if number <= 0.0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(number)) - 1)
    return float(f"{math.ceil(number / unit) * unit:.3g}")


# --- The squeeze ----------------------------------------------------------------------------------


def _usual_squeeze(grasp: FaceContacts, path: list[Waypoint], mass: float) -> float:
    """The squeeze [N] with which the weakest contact presses with its least share of the weight."""
    inertia = grasp.body.mass_properties(mass).inertia
    wrenches = motion_wrenches(path, mass, inertia, np.array(GRAVITY))
    least = LEAST_SHARE * mass * abs(GRAVITY[2]) / len(grasp.contacts)
    return needed_squeeze(grasp.contacts, wrenches, least)


# Places of a way from rest to rest at which its wrenches are looked at.
SAMPLES = np.linspace(0.0, 1.0, 13)


def motion_wrenches(
    path: list[Waypoint], mass: float, inertia: np.ndarray, gravity: np.ndarray
) -> np.ndarray:
    r"""Wrenches that carry the object along a path, shape (K, 6): force [N], moment [N m].

    Newton and Euler, :math:`[m(a - g);\ I\dot\omega + \omega \times I\omega]` about the centre of
    mass in object axes, along the reference of the control laws, from rest to rest at every pose.

    Parameters
    ----------
    path : list of Waypoint
        The first is the start.
    inertia : ndarray, shape (3, 3)
        About the centre of mass, object axes [kg m^2].
    gravity : ndarray, shape (3,)
        World axes [m/s^2].
    """
    reference = pose_path([w.time for w in path], [w.matrix() for w in path])
    wrenches = []
    for begin, end in pairwise(path):
        for x in SAMPLES:
            t = begin.time + x * (end.time - begin.time)
            quaternion, twist, change = reference_motion(t, reference)
            R = quaternion_to_matrix(quaternion)
            omega, alpha = R.T @ twist[3:], R.T @ change[3:]
            force = mass * R.T @ (change[:3] - gravity)
            moment = inertia @ alpha + np.cross(omega, inertia @ omega)
            wrenches.append(np.concatenate([force, moment]))
    return np.array(wrenches)


def needed_squeeze(contacts: Contacts, wrenches: np.ndarray, least: float) -> float:
    """Mean internal force [N] with which no contact presses with less than ``least`` [N].

    Parameters
    ----------
    contacts : Contacts
        In form closure; their frame's origin is the centre of mass.
    wrenches : ndarray, shape (K, 6)
        The wrenches that the contacts are to exert.

    Raises
    ------
    GraspError
        When the contacts are not in form closure.
    """
    pressing = pressing_forces(contacts.wrenches, contacts.names)
    shares = np.array([distribute(contacts.wrenches, wrench) for wrench in wrenches])
    return float(np.max((least - shares) / pressing, initial=0.0))
