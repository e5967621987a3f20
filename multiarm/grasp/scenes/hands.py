"""Hands on arms: the hand of each gripper, where its arm stands, and the posture of the arm.

A hand's frame ``corner`` is the gripper's frame; in the joint it coincides with the corner of the
object.  The hand comes from outside, along a mean of the inward normals of the faces that it
touches, or where that is too steep along the direction that clears them best, so that its palm and
its fingers stay on the outer side of all of them; how it is turned about this direction is left to
the search for postures.

Each arm holds its corner from a base on the ground or on a pedestal, somewhere beyond the corner as
seen from the middle of the object.  Heights of the object, places of the bases and turns of the
hands are tried in turn; inverse kinematics (:mod:`multiarm.assembly.inverse_kinematics`) decides
about a place, at every pose that the object shall pass.  The best is
the one whose worst arm is farthest from singular postures, from the limits of its joints, from the
object and from the ground.  The object stands upright, as its file has it; where the arms reach it
so from nowhere, it is turned until both hands come from the side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from multiarm.assembly.bases import POOREST, Stand, StandSearch, farthest
from multiarm.assembly.inverse_kinematics import InverseKinematics, clearance, points_on_links
from multiarm.assembly.robots import robot_files
from multiarm.errors import GraspError
from multiarm.grasp.body.face import OFF_PLANE, across, frame_of
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.designs.grippers import clearest_approach
from multiarm.grasp.face_contacts import FaceContacts, Gripper
from multiarm.robots.robot import Robot
from multiarm.scene import ArmSpec, resolve_arm
from multiarm.spatial import matrix_to_quaternion

# Least length of fingers [m], and their length over the size of the gripper.
SHORTEST, SLENDER = 0.1, 0.6
# A hand comes to each of its faces at an angle with at least this sine.
LEAST_CLEARANCE = 0.05
# Clearance of the palm from every face that the gripper touches, in radii of a fingertip.
CLEAR = 6.0
# A rectangle is along axes when its edges are off by less than this part of its size, and so is the
# cosine of its normal.
ALONG_AXES = 1e-9
# Digits of lengths in a scene, and of directions.
DIGITS, DIRECTION_DIGITS = 12, 15


class UnreachableError(GraspError):
    """Hands or arms do not reach the contacts of a grasp; another grasp may do."""


def approach(grasp: FaceContacts, gripper: Gripper, level: float = 1.0) -> np.ndarray:
    """Direction (3,) along which a gripper comes to the body, in the body's frame.

    Parameters
    ----------
    level : float
        Weight of the faces that look up or down, relative to the others: with a small one the hand
        comes from the side.

    Raises
    ------
    UnreachableError
        The gripper touches faces around so sharp an edge that no direction clears them all.
    """
    faces = sorted({grasp.faces[j] for j in gripper.contacts})
    inward = -np.array([grasp.body.faces[k].normal for k in faces])
    weights = np.where(np.abs(inward[:, 2]) > 0.7, level, 1.0)
    mean = weights @ inward
    if np.min(inward @ mean) > LEAST_CLEARANCE * np.linalg.norm(mean):
        return mean / np.linalg.norm(mean)
    direction, clearance = clearest_approach(inward)
    if clearance < LEAST_CLEARANCE:
        raise UnreachableError(
            f"gripper '{gripper.name}' touches faces that look away from each other; no rigid hand "
            "reaches them from one side"
        )
    return direction


def hand_pose(
    grasp: FaceContacts, gripper: Gripper, turn: float, tip_radius: float, level: float = 1.0
) -> np.ndarray:
    """Pose (4, 4) of the mount in the body's frame; its z axis points to the corner.

    It stands off as far as slender fingers need that stay clear of all faces that are touched.

    Parameters
    ----------
    turn : float
        About that axis [rad].
    level : float
        As for :func:`approach`.
    """
    z = approach(grasp, gripper, level)
    return mount_pose(grasp, gripper, z, gripper.corner, turn, tip_radius)


def mount_pose(
    grasp: FaceContacts,
    gripper: Gripper,
    direction: np.ndarray,
    aim: np.ndarray,
    turn: float,
    tip_radius: float,
) -> np.ndarray:
    """Pose (4, 4) of the mount in the body's frame.

    Parameters
    ----------
    direction : ndarray, shape (3,)
        Its z axis, a unit vector that clears all faces that are touched.
    aim : ndarray, shape (3,)
        Where it points to [m].
    turn : float
        About that axis [rad].
    """
    steepest = float(np.min(grasp.contacts.normals[list(gripper.contacts)] @ direction))
    stand_off = max(
        SHORTEST, SLENDER * grasp.gripper_size(gripper.name), CLEAR * tip_radius / steepest
    )
    side = across(direction)
    x = np.cos(turn) * side + np.sin(turn) * np.cross(direction, side)
    return frame_of(direction, x, aim - stand_off * direction)


def fingers(
    grasp: FaceContacts, gripper: Gripper, mount: np.ndarray, tip_radius: float, mass: float
) -> dict[str, Any]:
    """The hand as a scene writes it under ``tool: {fingers: ...}``.

    Parameters
    ----------
    mount : ndarray, shape (4, 4)
        From :func:`hand_pose`.
    """
    return {
        "tips": _rounded(_tips(grasp, gripper, tip_radius)),
        "radius": tip_radius,
        "corner": pose_table(np.linalg.solve(mount, gripper.frame)),
        "mass": mass,
    }


def contacts(grasp: FaceContacts, gripper: Gripper, tip_radius: float) -> list[dict[str, Any]]:
    """The gripper's contacts as a scene writes them, in the frame of the corner."""
    R = gripper.frame[:3, :3]
    tips = _tips(grasp, gripper, tip_radius)
    written = []
    for j, tip in zip(gripper.contacts, tips, strict=True):
        outward = -R.T @ grasp.contacts.normals[j]
        face = grasp.body.faces[grasp.faces[j]]
        corners = (face.vertices - gripper.corner) @ R
        plane: dict[str, Any] = {
            "point": _rounded(corners[0]),
            "normal": _rounded(outward, DIRECTION_DIGITS),
        }
        patch = _patch(corners, outward, grasp.body.rounding)
        if patch is not None:
            plane["patch"] = patch
        written.append(
            {
                "name": f"{grasp.contacts.names[j]} on {face.name}",
                "arm": {"sphere": {"center": _rounded(tip), "radius": tip_radius}},
                "object": {"plane": plane},
            }
        )
    return written


def pose_table(pose: np.ndarray) -> dict[str, list[float]]:
    """A pose (4, 4) as a scene writes it."""
    quaternion = matrix_to_quaternion(pose[:3, :3])
    return {"xyz": _rounded(pose[:3, 3]), "quaternion_xyzw": _rounded(quaternion, DIRECTION_DIGITS)}


def require_room(grasp: FaceContacts, tip_radius: float) -> None:
    """Refuse fingertips that overlap.

    A tip touches its face in one point, which lies on the face: it may stand over the edge.

    Raises
    ------
    UnreachableError
        Naming the contacts, how far apart they are, and the remedy.
    """
    points, names = grasp.contacts.points, grasp.contacts.names
    centres = points - tip_radius * grasp.contacts.normals
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    apart[np.diag_indices(len(centres))] = np.inf
    i, j = divmod(int(np.argmin(apart)), len(centres))
    if apart[i, j] < 2.0 * tip_radius:
        raise UnreachableError(
            f"fingertips of radius {tip_radius:g} m do not fit: those of {names[i]} and {names[j]} "
            f"would be {apart[i, j]:.3g} m apart; choose a smaller tip_radius or larger grippers"
        )


def _tips(grasp: FaceContacts, gripper: Gripper, tip_radius: float) -> np.ndarray:
    """Centres of the fingertips in the gripper's frame, outside the faces."""
    chosen = list(gripper.contacts)
    centres = grasp.contacts.points[chosen] - tip_radius * grasp.contacts.normals[chosen]
    return (centres - gripper.corner) @ gripper.frame[:3, :3]


def _patch(corners: np.ndarray, normal: np.ndarray, rounding: float) -> dict[str, Any] | None:
    """The face as a box in the corner's axes, where it is a rectangle along them."""
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) < 1.0 - ALONG_AXES or len(corners) != 4:
        return None
    low, high = corners.min(axis=0), corners.max(axis=0)
    off = np.minimum(corners - low, high - corners).max()
    if off > max(ALONG_AXES * np.ptp(corners, axis=0).max(), OFF_PLANE * rounding):
        return None
    bounds = [
        [None if k == axis else round(float(end[k]), DIGITS) for k in range(3)]
        for end in (low, high)
    ]
    return {"min": bounds[0], "max": bounds[1]}


def _rounded(values: np.ndarray, digits: int = DIGITS) -> Any:
    return (np.round(values, digits) + 0.0).tolist()


# --- Where the arms stand -------------------------------------------------------------------------

# Heights of the lowest corner that are tried, of pedestals, and distances of a base from its corner
# over the ground, all in reaches of the arm; directions of the base relative to the diagonal; how
# steeply a hand comes, and its turns.
HEIGHTS = (0.2, 0.35)
PEDESTALS = (0.0, 0.2, 0.4)
DISTANCES = (0.3, 0.4, 0.5)
SIDEWAYS = (-0.6, 0.0, 0.6)
LEVELS = (1.0, 0.4)
TURNS = tuple(np.arange(6) * np.pi / 3.0)
# Least gain for which a pedestal is used.
PEDESTAL_COST = 0.8

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Stands:
    """Where the object starts, and where each arm stands.

    Attributes
    ----------
    height : float
        Of the object's centre [m].
    turn : ndarray, shape (4, 4)
        How the object is turned against its upright pose; a rotation.
    arms : list of Stand
        Mounts are in axes of the upright object.
    """

    height: float
    turn: np.ndarray
    arms: list[Stand]

    def pose(self, motion: np.ndarray) -> np.ndarray:
        """Pose (4, 4) of the object after a motion (4, 4) from the start, in upright axes."""
        return lifted(self.height) @ motion @ self.turn


def stand_arms(
    grasp: FaceContacts,
    arms: list[ArmSpec],
    course: list[np.ndarray],
    tip_radius: float,
    height: float | None,
    rng: np.random.Generator,
    progress: Progress,
) -> Stands:
    """A start of the object, and a place for each arm.

    Parameters
    ----------
    grasp : FaceContacts
        Its body centred at the origin.
    arms : list of ArmSpec
        Robots without base and tool, one for each gripper; ``tip`` is the mount.
    course : list of ndarray, shape (4, 4)
        Poses of the object relative to the start, the first the identity.
    tip_radius : float
        Of the fingertips [m].
    height : float, optional
        Of the object's frame at the start [m]; left out: the best of several.
    rng : numpy.random.Generator
        Where searches for postures start.
    progress : callable
        Called with the finished fraction and the current stage.

    Raises
    ------
    UnreachableError
        When an arm reaches its corner from nowhere.
    """
    robots = [InverseKinematics(robot_alone(spec)) for spec in arms]
    reaches = [farthest(robot.arm, rng) for robot in robots]
    turns = [np.eye(4), *_sideways(grasp)]
    tried, missed = [], ""
    for number, turn in enumerate(turns):
        turned = grasp.placed(turn)
        clear = clear_of_body(turned.body)
        lowest = -float(np.min(turned.body.vertices[:, 2]))
        heights = [height] if height is not None else [lowest + h * max(reaches) for h in HEIGHTS]
        starts: list[Stands] = []
        for k, z in enumerate(round(z, 4) for z in heights):  # as they will be written
            tried.append(f"{'turned' if number else 'upright'} at {z:.2f} m")
            stands: list[Stand] = []
            for g, gripper in enumerate(turned.grippers):
                finished = (number + (k + g / len(robots)) / len(heights)) / len(turns)
                progress(finished, f"postures of '{gripper.name}', object {tried[-1]}")
                poses = [lifted(z) @ motion for motion in course]
                search = StandSearch(robots[g], poses, clear, rng)
                stand = search.best(_places(turned, gripper, poses[0], reaches[g], tip_radius))
                if stand is None or stand.reach.quality < POOREST:
                    missed = gripper.name
                    break
                stands.append(stand)
            else:
                starts.append(Stands(z, turn, stands))
        if starts:
            return max(starts, key=lambda start: min(stand.quality for stand in start.arms))
    raise UnreachableError(
        f"the arm of '{missed}' reaches its corner from nowhere nearby at every pose of the path; "
        f"the object was tried {', '.join(tried)}.  Choose a longer arm, another height or a "
        "shorter path"
    )


def _sideways(grasp: FaceContacts) -> list[np.ndarray]:
    """Two turns (4, 4) of an object with which all hands come from the side as far as can be.

    The object's axis that is most nearly perpendicular to all approaches points up, or down.
    """
    ways = np.array([approach(grasp, gripper) for gripper in grasp.grippers])
    axis = np.linalg.eigh(ways.T @ ways)[1][:, 0]
    side = np.eye(3)[int(np.argmin(np.abs(axis)))]
    return [np.linalg.inv(frame_of(up, side, np.zeros(3))) for up in (axis, -axis)]


def _places(
    grasp: FaceContacts, gripper: Gripper, start: np.ndarray, reach: float, tip_radius: float
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Bases, mounts of the hand in the object's frame, and what the bases are worth."""
    corner = start[:3, :3] @ gripper.corner + start[:3, 3]
    beyond = np.arctan2(corner[1] - start[1, 3], corner[0] - start[0, 3])
    for distance, aside, pedestal, level, turn in product(
        DISTANCES, SIDEWAYS, PEDESTALS, LEVELS, TURNS
    ):
        base = base_facing(corner, beyond + aside, distance * reach, pedestal * reach)
        worth = PEDESTAL_COST if base[2, 3] > 0.0 else 1.0
        yield base, hand_pose(grasp, gripper, turn, tip_radius, level), worth


def base_facing(place: np.ndarray, direction: float, distance: float, height: float) -> np.ndarray:
    """Pose (4, 4) of a base that faces a place (3,) from a direction [rad], rounded."""
    base = np.eye(4)
    along = np.array([np.cos(direction), np.sin(direction)])
    base[:3, 3] = *np.round(place[:2] + distance * along, 3), round(height, 2)
    facing = round(float(np.arctan2(*(place[:2] - base[:2, 3])[::-1])), 4)
    base[:2, :2] = [[np.cos(facing), -np.sin(facing)], [np.sin(facing), np.cos(facing)]]
    return base


def clear_of_body(body: Polyhedron) -> Callable[[np.ndarray, np.ndarray, np.ndarray], float]:
    """How well links keep apart from the body, see :class:`StandSearch`, and from the ground.

    A body that is not convex counts with the half-spaces of all its faces.
    """
    offsets = np.array([face.offset for face in body.faces])

    def clear(_base: np.ndarray, skeleton: np.ndarray, pose: np.ndarray) -> float:
        seen = (points_on_links(skeleton[:-1]) - pose[:3, 3]) @ pose[:3, :3]
        outside = np.max(seen @ body.normals.T - offsets, axis=1)
        above = skeleton[2:-1, 2]  # the shoulder belongs where it is
        return clearance(outside, above)

    return clear


def robot_alone(spec: ArmSpec) -> Robot:
    """The robot of an arm, as it is written."""
    return Robot(spec.robot or "arm", robot_files(spec, resolve_arm(spec)))


def lifted(height: float) -> np.ndarray:
    """Pose (4, 4) of an upright object at a height [m]."""
    pose = np.eye(4)
    pose[2, 3] = height
    return pose
