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
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.assembly.compilation import arm_files
from multiarm.assembly.inverse_kinematics import (
    InverseKinematics,
    Reach,
    clearance,
    points_on_links,
)
from multiarm.errors import GraspError
from multiarm.grasp.face_contacts import FaceContacts, Gripper
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
# The most promising places are looked at again, from more starts and at every pose.
FINALISTS, FEW, MANY = 8, 2, 16
# An arm below this quality is too near a singular posture to be used.
POOREST = 1e-3

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Stand:
    """One arm's place.

    Attributes
    ----------
    base : ndarray, shape (4, 4)
        In the world.
    mount : ndarray, shape (4, 4)
        The hand's mount in the object's frame.
    reach : Reach
    """

    base: np.ndarray
    mount: np.ndarray
    reach: Reach

    @property
    def quality(self) -> float:
        """That of the posture, less where the arm needs a pedestal."""
        return self.reach.quality * (PEDESTAL_COST if self.base[2, 3] > 0.0 else 1.0)


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
    robots = [InverseKinematics(_robot(spec)) for spec in arms]
    reaches = [_farthest(robot, rng) for robot in robots]
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
        stand = _Search(grasp, gripper, robots[g], poses, tip_radius, rng).best(reaches[g])
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


@dataclass(frozen=True)
class _Search:
    """The search for a place of one arm, with the object at one height."""

    grasp: FaceContacts
    gripper: Gripper
    robot: InverseKinematics
    poses: list[np.ndarray]
    tip_radius: float
    rng: np.random.Generator

    def best(self, reach: float) -> Stand | None:
        """First a quick look at many places at the start pose, then the best of them closely."""
        candidates = []
        for base, mount in self._places(reach):
            found = self._reached(base, mount, self.poses[:1], FEW)
            if found is not None:
                candidates.append(Stand(base, mount, found))
        candidates.sort(key=lambda stand: -stand.quality)
        finals = []
        for stand in candidates[:FINALISTS]:
            found = self._reached(stand.base, stand.mount, self.poses, MANY)
            if found is not None:
                finals.append(replace(stand, reach=found))
        return max(finals, key=lambda stand: stand.quality, default=None)

    def _places(self, reach: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        corner = self.poses[0][:3, :3] @ self.gripper.corner + self.poses[0][:3, 3]
        beyond = np.arctan2(corner[1] - self.poses[0][1, 3], corner[0] - self.poses[0][0, 3])
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
            yield base, hand_pose(self.grasp, self.gripper, turn, self.tip_radius, level)

    def _reached(
        self, base: np.ndarray, mount: np.ndarray, poses: list[np.ndarray], starts: int
    ) -> Reach | None:
        def clear(skeleton: np.ndarray, number: int) -> float:
            points = skeleton @ base[:3, :3].T + base[:3, 3]
            return self._clearance(points[:-1], poses[number])

        home = np.linalg.inv(base)
        places = [home @ pose @ mount for pose in poses]
        return self.robot.search(places, self.rng, starts, clear)

    def _clearance(self, points: np.ndarray, pose: np.ndarray) -> float:
        """1 where the links between these points keep apart from object and ground.

        A body that is not convex counts with the half-spaces of all its faces.
        """
        seen = (points_on_links(points) - pose[:3, 3]) @ pose[:3, :3]
        offsets = np.array([face.offset for face in self.grasp.body.faces])
        outside = np.max(seen @ self.grasp.body.normals.T - offsets, axis=1)
        above = points[2:, 2]  # the shoulder belongs where it is
        return clearance(outside, above)


def _robot(spec: ArmSpec) -> Arm:
    return Arm(spec.robot or "arm", arm_files(spec, resolve_arm(spec)))


def _farthest(robot: InverseKinematics, rng: np.random.Generator) -> float:
    """How far the tip gets from the base, over the ground as well as up [m]."""
    limits = np.clip(robot.arm.position_limits, -np.pi, np.pi)
    tips = [robot.arm.tip_pose(rng.uniform(*limits.T))[:3, 3] for _ in range(400)]
    return float(np.max(np.linalg.norm(tips, axis=1)))


def lifted(height: float) -> np.ndarray:
    """Pose (4, 4) of an upright object at a height [m]."""
    pose = np.eye(4)
    pose[2, 3] = height
    return pose
