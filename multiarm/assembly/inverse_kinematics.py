r"""Inverse kinematics: joint positions with which an arm holds its tip at wanted poses.

A posture makes the pose error zero but for the components that the joint leaves free; the method
(:mod:`multiarm.assembly.reaching`) goes there from starts spread over the ranges of the joints.  Of
the postures found, the best is farthest from singular ones and from its limits, at every pose.

*What it proves.*  A search that ends without a posture proves nothing.  A place is out of reach for
certain where it is farther from the first joint than the sum of the lengths of all links and of the
travels of all sliding joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy as shallow_copy
from dataclasses import dataclass

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.chain import ChainJoint, require_chain
from multiarm.arms.terms import ArmStructure
from multiarm.assembly.reaching import REACHED, chain_to, reach_place, write_pose
from multiarm.jit.rows import fields_of
from multiarm.scene import Pose
from multiarm.spatial import difference, matrix_to_quaternion

# Length that compares shifts with turns [m]: about half an arm.
LENGTH = 0.5
# Joints without limits are sought within a turn either way, all others this far inside them [rad].
TURN, MARGIN = math.pi, 0.05
# Qualities closer than this part are equal, as those of postures that mirror each other.
TIE = 1e-6
# Joints should keep this far from things that are in the way [m].
APART = 0.1
# Starts of a search of the whole ranges of the joints, which ends after so many postures.
WHOLE_STARTS, WHOLE_POSTURES = 2000, 64
# Joints that move a base, of x, y, z, roll, pitch, yaw: it is turned by yaw, then pitch, then roll.
BASE_JOINTS = (0, 1, 2, 5, 4, 3)


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


@dataclass(frozen=True)
class Miss:
    """The nearest posture to a place that is out of reach.

    Attributes
    ----------
    posture : ndarray, shape (n,)
        [rad or m]
    shift : ndarray, shape (3,)
        From the tip there to the wanted place, world axes [m].
    turn : float
        Angle between the orientations there [rad].
    """

    posture: np.ndarray
    shift: np.ndarray
    turn: float


class InverseKinematics:
    """The search for postures of one arm.

    Parameters
    ----------
    arm : Arm
    free : sequence of int
        Components of the pose that do not count, in the axes of the wanted frame: 0 to 2 are shifts
        along, 3 to 5 turns about x, y, z.
    frame : ndarray, shape (4, 4), optional
        The frame of the tip that is brought to the wanted places, in the tip's frame.
    to_limits : bool
        Whether joints may come up to their limits, as far as sliding joints go, and lengths are
        compared with the arm's.

    Attributes
    ----------
    free : tuple of int
    lower, upper : ndarray, shape (n,)
        Bounds of the search [rad, m].
    """

    def __init__(
        self,
        arm: Arm,
        free: Sequence[int] = (),
        frame: np.ndarray | None = None,
        to_limits: bool = False,
    ) -> None:
        self.arm = arm
        self._structure, tip = require_chain(arm.structure(), arm.tip.joint), np.eye(4)
        tip[:3, :3], tip[:3, 3] = arm.tip.rotation, arm.tip.translation
        self._end = end = tip if frame is None else tip @ frame
        self._to_limits = to_limits
        self._length = 0.5 * float(np.max(arm.levers(end[:3, 3]))) if to_limits else LENGTH
        self.lower, self.upper = _bounds(arm, self._structure.slides if to_limits else None)
        self.free = tuple(free)
        self._counted = np.setdiff1d(np.arange(6), free)
        self._chain = chain_to(self._structure, end)

    def farther_than_it_reaches(self, place: np.ndarray) -> tuple[float, float] | None:
        """Distance of a place from the first joint, and the reach that it exceeds [m].

        None where the place may be within reach: the reach is that of a chain whose every link
        points the same way, with all sliding joints at their farthest.
        """
        joints = fields_of(ChainJoint, self._chain)
        slides = joints.slides[:-1] != 0.0
        travels = np.maximum(np.abs(self.lower), np.abs(self.upper))[slides]
        links = np.linalg.norm(joints.offset[1:], axis=1)
        reach = float(np.sum(links) + np.sum(travels))
        shift = place[:3, :3].T @ (place[:3, 3] - joints.offset[0])
        distance = float(np.linalg.norm(shift[self._counted[self._counted < 3]]))
        return (distance, reach) if distance > reach * (1.0 + TIE) else None

    def on_moving_base(
        self, base: Pose, varied: Mapping[int, tuple[float, float]]
    ) -> InverseKinematics:
        """This search with joints below the arm that move its base.

        Parameters
        ----------
        base : Pose
            Its components count that do not vary.
        varied : mapping component -> (least, greatest)
            What varies, of x, y, z [m], roll, pitch, yaw [rad], and within what bounds; a posture
            begins with them, in the order of :data:`BASE_JOINTS`.
        """
        search = shallow_copy(self)
        frame, ranges = np.eye(4), []
        axes, frames = [], []  # of the joints below the arm
        for k in BASE_JOINTS:
            axis = np.eye(3)[k % 3]
            if k in varied:
                axes.append(axis)
                frames.append(frame)
                ranges.append(varied[k])
                frame = np.eye(4)
            elif k < 3:
                frame[:3, 3] += base.xyz[k] * axis
            elif max(varied) >= 3:
                x, y, z = base.rpy[k - 3] * axis
                frame[:3, :3] = frame[:3, :3] @ Pose(rpy=(x, y, z)).rotation()
        if max(varied) < 3:
            frame[:3, :3] = base.rotation()
        structure, mount = self._structure, np.eye(4)
        mount[:3, :3], mount[:3, 3] = structure.rotations[0], structure.translations[0]
        frames.append(frame @ np.linalg.solve(self.arm.files.base, mount))
        slides = [k < 3 for k in BASE_JOINTS if k in varied]
        search._structure = _on_joints(structure, slides, axes, np.array(frames))
        search._chain = chain_to(search._structure, self._end)
        lower, upper = np.transpose(ranges)
        search.lower = np.concatenate([lower, self.lower])
        search.upper = np.concatenate([upper, self.upper])
        return search

    def search(
        self,
        places: Sequence[np.ndarray],
        rng: np.random.Generator,
        starts: int = 24,
        clear: Callable[[np.ndarray, int], float] | None = None,
        allowed: Callable[[np.ndarray, int], bool] | None = None,
    ) -> Reach | None:
        """The best posture found that reaches a place, and then others.

        Parameters
        ----------
        places : sequence of ndarray, shape (4, 4)
            Poses of the frame in the world; the second is reached from the posture at the first.
        rng : numpy.random.Generator
            Where the search starts.
        starts : int
            How many postures the search begins at.
        clear : callable, optional
            Of a posture (n,) and the number of the place: a factor on the quality, 1 where the arm
            is out of the way of everything, less where it is not.
        allowed : callable, optional
            Of a posture (n,) and the number of the place: whether the arm may have it there.

        Returns
        -------
        Reach or None
            None where no start leads to a posture that reaches all places.
        """
        best: Reach | None = None
        for course in self.courses(places, rng, starts):
            if allowed is not None and not all(allowed(q, k) for k, q in enumerate(course)):
                continue
            reach = self._judge(course, clear)
            if best is None or reach.quality > best.quality * (1.0 + TIE):
                best = reach
        return best

    def courses(
        self, places: Sequence[np.ndarray], rng: np.random.Generator, starts: int
    ) -> Iterator[np.ndarray]:
        """Postures (K, n) that reach places (4, 4), one after the other, from several starts."""
        count = 0
        for _ in range(starts):
            course = self._follow(rng.uniform(self.lower, self.upper), places)
            if course is not None:
                yield course
                count += 1
            if self._to_limits and count == WHOLE_POSTURES:
                return

    def nearest(self, place: np.ndarray, rng: np.random.Generator, starts: int = 24) -> Miss:
        """The nearest posture found to a place that none reaches."""
        ends = [self._solve(place, rng.uniform(self.lower, self.upper)) for _ in range(starts)]
        posture, _ = min(ends, key=lambda end: end[1])
        pose, _ = self.pose(posture)
        turn = difference(*(matrix_to_quaternion(X[:3, :3]) for X in (pose, place)))
        return Miss(posture, place[:3, 3] - pose[:3, 3], float(np.linalg.norm(turn)))

    def pose(self, posture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pose (4, 4) of the frame in the world, and its Jacobian (6, n), world axes."""
        pose, J = np.eye(4), np.zeros((6, len(posture)))
        write_pose(self._chain, np.array(posture, dtype=float), pose, J)
        return pose, J

    def _follow(self, start: np.ndarray, places: Sequence[np.ndarray]) -> np.ndarray | None:
        course = []
        for place in places:
            start, error = self._solve(place, start)
            if not error < REACHED:
                return None
            course.append(start)
        return np.array(course)

    def _solve(self, place: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, float]:
        """A posture, and the largest component of its error."""
        q = start.copy()
        error = reach_place(
            self._chain,
            np.ascontiguousarray(place),
            self._counted,
            self.lower,
            self.upper,
            self._length,
            q,
        )
        return q, error

    def _judge(self, course: np.ndarray, clear: Callable[[np.ndarray, int], float] | None) -> Reach:
        dexterity, clearance = np.inf, 1.0
        for number, q in enumerate(course):
            if clear is not None:
                clearance = min(clearance, clear(q, number))
            pose, J = self.pose(q)
            J = (pose[:3, :3].T @ J.reshape(2, 3, -1)).reshape(6, -1)
            J[:3] /= self._length
            values = np.linalg.svd(J[self._counted], compute_uv=False)
            dexterity = min(dexterity, float(values[-1]))
        limited = np.isfinite(self.arm.position_limits).all(axis=1)
        half = np.maximum(0.5 * (self.upper - self.lower), 1e-9)
        room = np.minimum(course - self.lower, self.upper - course)
        room = (room + MARGIN if self._to_limits else room) / half
        return Reach(course, dexterity, float(np.min(room[:, limited], initial=1.0)), clearance)


def _on_joints(
    arm: ArmStructure, slides: list[bool], axes: list[np.ndarray], frames: np.ndarray
) -> ArmStructure:
    """An arm on massless joints below it; ``frames`` (k + 1, 4, 4) are theirs and its own first."""
    still = ArmStructure(*(np.zeros((len(axes), *part.shape[1:])) for part in arm))
    both = ArmStructure(*map(np.concatenate, zip(still, arm, strict=True)))
    return both._replace(
        parents=np.arange(-1, both.masses.size - 1),
        slides=np.append(slides, arm.slides),
        axes=np.vstack([*axes, arm.axes]),
        rotations=np.concatenate([frames[:, :3, :3], arm.rotations[1:]]),
        translations=np.concatenate([frames[:, :3, 3], arm.translations[1:]]),
    )


def points_on_links(origins: np.ndarray) -> np.ndarray:
    """Points on the lines between origins of joints, (5 (n - 1), 3) of (n, 3) [m]."""
    steps = np.linspace(0.0, 1.0, 5)[:, None, None]
    return (origins[:-1] + steps * np.diff(origins, axis=0)).reshape(-1, 3)


def clearance(*distances: np.ndarray) -> float:
    """A factor of the quality: 1 where all distances [m] are at least ``APART``, never zero."""
    nearest = min(float(np.min(part, initial=APART)) for part in distances)
    return float(np.clip(nearest / APART, 0.02, 1.0))


def _bounds(arm: Arm, far: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Bounds inside the limits, or with ``far`` (n,), whether a joint slides, the limits."""
    endless = ~np.isfinite(arm.position_limits).all(axis=1)
    low, high = np.where(endless, 0.0, arm.position_limits.T)
    middle = 0.5 * (low + high)
    margin = MARGIN if far is None else 0.0
    half = np.where(endless, TURN, 0.5 * (high - low) - margin)
    farthest = TURN if far is None else np.where(far, np.inf, TURN)
    half = np.minimum(np.maximum(half, 0.0), farthest)
    return middle - half, middle + half
