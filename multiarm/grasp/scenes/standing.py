r"""Where the arms stand, how high they hold the object, and the postures with which they do.

Each arm holds its corner from a base on the ground or on a pedestal, somewhere beyond the corner as
seen from the middle of the object.  Heights of the object, places of the bases and turns of the
hands are tried in turn; whether a place will do is decided by inverse kinematics
(:mod:`multiarm.assembly.inverse_kinematics`) at every pose that the object shall pass.  The best is
the one whose worst arm is farthest from singular postures, from the limits of its joints, from the
object and from the ground.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.assembly.bases import POOREST, Stand, StandSearch, farthest
from multiarm.assembly.compilation import arm_files
from multiarm.assembly.inverse_kinematics import InverseKinematics, clearance, points_on_links
from multiarm.errors import GraspError
from multiarm.grasp.face_contacts import FaceContacts, Gripper
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.scenes.hands import hand_pose
from multiarm.scene import ArmSpec, resolve_arm

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


def stand_arms(
    grasp: FaceContacts,
    arms: list[ArmSpec],
    course: list[np.ndarray],
    tip_radius: float,
    height: float | None,
    rng: np.random.Generator,
    progress: Progress,
) -> tuple[float, list[Stand]]:
    """Height of the object's frame at the start [m], and a place for each arm.

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
    GraspError
        When an arm reaches its corner from nowhere.
    """
    clear = _clear_of(grasp.body)
    robots = [InverseKinematics(_robot(spec)) for spec in arms]
    reaches = [farthest(robot.arm, rng) for robot in robots]
    lowest = -float(np.min(grasp.body.vertices[:, 2]))
    heights = [height] if height is not None else [lowest + h * max(reaches) for h in HEIGHTS]
    heights = [round(z, 4) for z in heights]  # as they will be written
    best: tuple[float, list[Stand]] | None = None
    parts = [(z, g) for z in heights for g in range(len(robots))]
    found: dict[float, list[Stand]] = {z: [] for z in heights}
    missed = ""
    for k, (z, g) in enumerate(parts):
        if len(found[z]) < g:  # an arm before this one found no place
            continue
        gripper = grasp.grippers[g]
        progress(k / len(parts), f"postures of '{gripper.name}', object at {z:.2f} m")
        poses = [lifted(z) @ pose for pose in course]
        search = StandSearch(robots[g], poses, clear, rng)
        stand = search.best(_places(grasp, gripper, poses[0], reaches[g], tip_radius))
        if stand is None or stand.reach.quality < POOREST:
            missed = gripper.name
            continue
        found[z].append(stand)
        if len(found[z]) == len(robots) and (best is None or _worst(found[z]) > _worst(best[1])):
            best = z, found[z]
    if best is None:
        tried = ", ".join(f"{z:.2f}" for z in heights)
        raise GraspError(
            f"the arm of gripper '{missed}' reaches its corner from nowhere nearby at every pose "
            f"of the path, with the object's frame at {tried} m; choose a longer arm, another "
            f"height or a shorter path"
        )
    return best


def _worst(stands: list[Stand]) -> float:
    return min(stand.quality for stand in stands)


def _places(
    grasp: FaceContacts, gripper: Gripper, start: np.ndarray, reach: float, tip_radius: float
) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Bases, mounts of the hand in the object's frame, and what the bases are worth."""
    corner = start[:3, :3] @ gripper.corner + start[:3, 3]
    beyond = np.arctan2(corner[1] - start[1, 3], corner[0] - start[0, 3])
    for distance, aside, pedestal, level, turn in product(
        DISTANCES, SIDEWAYS, PEDESTALS, LEVELS, TURNS
    ):
        direction = beyond + aside
        base = np.eye(4)
        base[:2, 3] = corner[:2] + distance * reach * np.array(
            [np.cos(direction), np.sin(direction)]
        )
        base[:3, 3] = *np.round(base[:2, 3], 3), round(pedestal * reach, 2)
        facing = round(float(np.arctan2(*(corner[:2] - base[:2, 3])[::-1])), 4)
        base[:2, :2] = [
            [np.cos(facing), -np.sin(facing)],
            [np.sin(facing), np.cos(facing)],
        ]
        worth = PEDESTAL_COST if base[2, 3] > 0.0 else 1.0
        yield base, hand_pose(grasp, gripper, turn, tip_radius, level), worth


def _clear_of(body: Polyhedron) -> Callable[[np.ndarray, np.ndarray, np.ndarray], float]:
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


def _robot(spec: ArmSpec) -> Arm:
    return Arm(spec.robot or "arm", arm_files(spec, resolve_arm(spec)))


def lifted(height: float) -> np.ndarray:
    """Pose (4, 4) of an upright object at a height [m]."""
    pose = np.eye(4)
    pose[2, 3] = height
    return pose
