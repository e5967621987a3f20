r"""Where the arms stand, how high they hold the object, and the postures with which they do.

Each arm holds its corner from a base on the ground or on a pedestal, somewhere beyond the corner as
seen from the middle of the object.  Heights of the object, places of the bases and turns of the
hands are tried in turn; whether a place will do is decided by inverse kinematics
at every pose that the object shall pass.  The best is the one whose worst arm is
farthest from singular postures,
from the limits of its joints, from the object and from the ground.

**Postures**: inverse kinematics with many starts.  A posture is found by least squares on the pose
error

.. math:: \begin{bmatrix} (x(q) - x_r) / \ell \\ \theta(q) \end{bmatrix} ,

``theta`` the rotation vector from the wanted orientation to the tip's, within the joints' limits,
from starts spread over them.  Of the postures found the one is best that is farthest from singular
postures and from its limits, in every requested place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.assembly.compilation import arm_files
from multiarm.errors import GraspError
from multiarm.grasp.face_contacts import FaceContacts, Gripper
from multiarm.grasp.scenes.hands import hand_pose
from multiarm.scene import ArmSpec, resolve_arm
from multiarm.spatial import difference, matrix_to_quaternion

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
# Joints should keep this far from object and ground [m].
APART = 0.1
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
    progress: Progress | None = None,
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
    progress : callable, optional
        Called with the finished fraction and the current stage.

    Raises
    ------
    GraspError
        When an arm reaches its corner from nowhere.
    """
    robots = [_robot(spec) for spec in arms]
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
        if progress is not None:
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
    robot: Arm
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
        return find_posture(self.robot, places, self.rng, starts, clear)

    def _clearance(self, points: np.ndarray, pose: np.ndarray) -> float:
        """1 where the links between these points keep apart from object and ground.

        A body that is not convex counts with the half-spaces of all its faces.
        """
        steps = np.linspace(0.0, 1.0, 5)[:, None, None]
        links = (points[:-1] + steps * np.diff(points, axis=0)).reshape(-1, 3)
        seen = (links - pose[:3, 3]) @ pose[:3, :3]
        offsets = np.array([face.offset for face in self.grasp.body.faces])
        outside = np.max(seen @ self.grasp.body.normals.T - offsets, axis=1)
        above = points[2:, 2]  # the shoulder belongs where it is
        nearest = min(float(np.min(outside)), float(np.min(above, initial=APART)))
        return float(np.clip(nearest / APART, 0.02, 1.0))


def _robot(spec: ArmSpec) -> Arm:
    return Arm(spec.robot or "arm", arm_files(spec, resolve_arm(spec)))


def _farthest(robot: Arm, rng: np.random.Generator) -> float:
    """How far the tip gets from the base, over the ground as well as up [m]."""
    limits = np.clip(robot.position_limits, -np.pi, np.pi)
    tips = [robot.tip_pose(rng.uniform(*limits.T))[:3, 3] for _ in range(400)]
    return float(np.max(np.linalg.norm(tips, axis=1)))


def lifted(height: float) -> np.ndarray:
    """Pose (4, 4) of an upright object at a height [m]."""
    pose = np.eye(4)
    pose[2, 3] = height
    return pose


# --- Postures for wanted places -------------------------------------------------------------------

# Length that compares shifts with turns [m]: about half an arm.
LENGTH = 0.5
# A posture reaches a place when shift [m] and turn [rad] are off by less.
REACHED = 1e-8
# Joints without limits are sought within a turn either way, all others this far inside them [rad].
TURN, MARGIN = np.pi, 0.05
# Steps of Levenberg and Marquardt's method from one start.
_STEPS = 60


@dataclass(frozen=True)
class Reach:
    """A posture that reaches one or several places.

    Attributes
    ----------
    postures : ndarray, shape (K, n)
        Joint positions, place after place [rad or m].
    dexterity : float
        Smallest singular value of the Jacobian, lengths over 0.5 m, at the worst place.
    room : float
        Smallest distance of a joint from its limits, as a part of half its range (1 in the middle).
    clearance : float
        Worst factor for being in the way of something, 1 where there is nothing.
    """

    postures: np.ndarray
    dexterity: float
    room: float
    clearance: float = 1.0

    @property
    def quality(self) -> float:
        """The score that the best posture maximises."""
        return self.dexterity * min(1.0, 2.0 * self.room) * self.clearance


def find_posture(
    arm: Arm,
    places: Sequence[np.ndarray],
    rng: np.random.Generator,
    starts: int = 24,
    clear: Callable[[np.ndarray, int], float] | None = None,
) -> Reach | None:
    """The best posture found with which an arm reaches a place, and then others.

    Parameters
    ----------
    arm : Arm
    places : sequence of ndarray, shape (4, 4)
        Poses of the tip in the world; the second is reached from the posture at the first, ...
    rng : numpy.random.Generator
        Where the search starts.
    starts : int
        How many postures the search begins at.
    clear : callable, optional
        Of the origins of all joints and of the tip in the world, shape (n + 1, 3) [m], and of the
        number of the place: a factor on the quality, 1 where the arm is out of the way of
        everything, less where it is not.

    Returns
    -------
    Reach or None
        None where no start leads to a posture that reaches all places.
    """
    low, high = _bounds(arm)
    best: Reach | None = None
    for _ in range(starts):
        q = rng.uniform(low, high)
        course = []
        for place in places:
            found = _solve(arm, place, q, low, high)
            if found is None:
                break
            q = found
            course.append(q)
        if len(course) < len(places):
            continue
        reach = _judged(arm, np.array(course), low, high, clear)
        if best is None or reach.quality > best.quality:
            best = reach
    return best


def _bounds(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    low, high = arm.position_limits.T
    middle = 0.5 * (low + high)
    endless = ~np.isfinite(middle)
    middle[endless] = 0.0
    half = np.where(endless, TURN, 0.5 * (high - low) - MARGIN)
    half = np.minimum(np.maximum(half, 0.0), TURN)
    return middle - half, middle + half


def _error(arm: Arm, place: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose error (6,) and its Jacobian (6, n), lengths over :data:`LENGTH`."""
    terms = arm.terms(q, np.zeros(arm.dof))
    wanted = matrix_to_quaternion(place[:3, :3])
    turn = difference(wanted, matrix_to_quaternion(terms.tip_rotation))
    error = np.concatenate([(terms.tip_position - place[:3, 3]) / LENGTH, turn])
    J = terms.J.copy()
    J[:3] /= LENGTH
    return error, J


def _solve(
    arm: Arm, place: np.ndarray, start: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray | None:
    """Levenberg and Marquardt's method within bounds: a joint at a bound it presses on rests."""
    q, mu = start.copy(), 1e-2
    error, J = _error(arm, place, q)
    for _ in range(_STEPS):
        size = float(error @ error)
        if np.max(np.abs(error)) < REACHED:
            return q
        gradient = J.T @ error
        free = ~(((q <= low) & (gradient > 0.0)) | ((q >= high) & (gradient < 0.0)))
        step = np.zeros(q.size)
        A = J[:, free]
        rows = np.vstack([A, np.sqrt(mu * size) * np.eye(A.shape[1])])
        step[free] = -np.linalg.lstsq(rows, np.append(error, np.zeros(A.shape[1])))[0]
        step *= min(1.0, 0.5 / max(float(np.max(np.abs(step))), 1e-300))
        trial = np.clip(q + step, low, high)
        there, J_there = _error(arm, place, trial)
        if there @ there < size:
            q, error, J, mu = trial, there, J_there, max(0.3 * mu, 1e-6)
        else:
            mu *= 5.0
            if mu > 1e6:
                return None
    return None


def _judged(
    arm: Arm,
    course: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    clear: Callable[[np.ndarray, int], float] | None,
) -> Reach:
    dexterity, clearance = np.inf, 1.0
    for number, q in enumerate(course):
        if clear is not None:
            clearance = min(clearance, clear(arm.skeleton(q), number))
        J = arm.terms(q, np.zeros(arm.dof)).J.copy()
        J[:3] /= LENGTH
        dexterity = min(dexterity, float(np.linalg.svd(J, compute_uv=False)[-1]))
    limited = np.isfinite(arm.position_limits).all(axis=1)
    half = np.maximum(0.5 * (high - low), 1e-9)
    room = np.minimum(course - low, high - course) / half
    nearest = float(np.min(room[:, limited], initial=1.0))
    return Reach(course, dexterity, nearest, clearance)
