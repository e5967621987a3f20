r"""Inverse kinematics: joint positions with which an arm holds its tip at wanted poses.

A posture makes the pose error zero but for the components that the joint leaves free; the method
(:mod:`multiarm.assembly.reaching`) goes there from starts spread over the ranges of the joints.  Of
the postures found, the best is farthest from singular ones and from its limits, at every pose.

*What it proves.*  A search that ends without a posture proves nothing.  A place is out of reach for
certain where it is farther from the first joint than the sum of the lengths of all links and of the
travels of all sliding joints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy as shallow_copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multiarm.assembly.kinematic_tree import (
    MARGIN,
    Coupling,
    LinkFrame,
    Ranges,
    Target,
    kinematic_tree,
    with_places,
)
from multiarm.assembly.reaching import (
    COLUMN_WIDTH,
    REACHED,
    Tree,
    reach_places,
    write_jacobian,
    write_poses,
)
from multiarm.geometry.poses import pose_matrix
from multiarm.jit.rows import fields_of
from multiarm.robots.chain import ChainJoint, require_chain
from multiarm.robots.robot import Robot
from multiarm.robots.terms import POSE_WIDTH, LinkPose, TreeStructure
from multiarm.scene import Pose
from multiarm.spatial import difference, matrix_to_quaternion

# Length that compares shifts with turns [m]: about half an arm.
LENGTH = 0.5
# Qualities closer than this part are equal, as those of postures that mirror each other.
TIE = 1e-6
# Part of the largest singular value below which another one is zero.
VANISHES = 1e-9
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
    """The nearest posture to places that are out of reach.

    Attributes
    ----------
    posture : ndarray, shape (n,)
        [rad or m]
    shifts : ndarray, shape (C, 3)
        From the first frame of each target to the second, world axes [m].
    turns : ndarray, shape (C,)
        Angles between their orientations [rad].
    """

    posture: np.ndarray
    shifts: np.ndarray
    turns: np.ndarray


class TreeKinematics:
    """The search for postures of a robot, a tree of joints, that reach all its targets at once.

    Parameters
    ----------
    structure : TreeStructure
    targets : sequence of Target
    ranges : Ranges
        Of all joints.
    couplings : sequence of Coupling
        Joints that follow others.
    length : float
        Compares shifts with turns [m].
    rest : ndarray, shape (n,), optional
        Where joints stay that move no target [rad or m].

    Attributes
    ----------
    targets : tuple of Target
    lower, upper : ndarray, shape (d,)
        Bounds of the search for the joints that follow none [rad, m].
    """

    def __init__(
        self,
        structure: TreeStructure,
        targets: Sequence[Target],
        ranges: Ranges,
        couplings: Sequence[Coupling] = (),
        length: float = LENGTH,
        rest: np.ndarray | None = None,
    ) -> None:
        self.targets, self._length = tuple(targets), length
        self._set_tree(kinematic_tree(structure, targets, couplings))
        ranges = ranges.of_independent(self._tree, rest)
        self.lower, self.upper = ranges.lower, ranges.upper
        self._limited, self._margin = ranges.limited, ranges.margin

    def _set_tree(self, tree: Tree) -> None:
        at_rest = [target.second is None for target in self.targets]
        self._tree, self._at_rest = tree, tree.second[at_rest]

    def search(
        self,
        places: Sequence[np.ndarray],
        rng: np.random.Generator,
        starts: int = 24,
        clear: Callable[[np.ndarray, int], float] | None = None,
        allowed: Callable[[np.ndarray, int], bool] | None = None,
    ) -> Reach | None:
        """The best posture found that reaches places, and then others.

        Parameters
        ----------
        places : sequence of ndarray, shape (..., 4, 4)
            Places in the world of the targets at rest; the second are reached from the posture at
            the first.
        rng : numpy.random.Generator
            Where the search starts.
        starts : int
            How many postures the search begins at.
        clear : callable, optional
            Of a posture (n,) and the number of the places: a factor on the quality, 1 where the
            robot is out of the way of everything, less where it is not.
        allowed : callable, optional
            Of a posture (n,) and the number of the places: whether the robot may have it there.

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
        """Postures (K, n) that reach places (..., 4, 4) one after the other, from all starts."""
        trees = [with_places(self._tree, self._at_rest, place) for place in places]
        count = 0
        for _ in range(starts):
            course = self._follow(rng.uniform(self.lower, self.upper), trees)
            if course is not None:
                yield course
                count += 1
            if self._margin == 0.0 and count == WHOLE_POSTURES:
                return

    def nearest(self, place: np.ndarray, rng: np.random.Generator, starts: int = 24) -> Miss:
        """The nearest posture found to places (..., 4, 4) that none reaches."""
        tree = with_places(self._tree, self._at_rest, place)
        ends = [self._solve(tree, rng.uniform(self.lower, self.upper)) for _ in range(starts)]
        x, _ = min(ends, key=lambda end: end[1])
        poses, _ = self._poses(tree, x)
        frames = fields_of(LinkPose, poses)
        pairs = zip(frames.axes[tree.first], frames.axes[tree.second], strict=True)
        turns = [difference(*map(matrix_to_quaternion, pair)) for pair in pairs]
        shifts = frames.origin[tree.second] - frames.origin[tree.first]
        return Miss(self._all_joints(x), shifts, np.linalg.norm(turns, axis=1))

    def shifts(self, posture: np.ndarray) -> np.ndarray:
        """From the second frame of each target to the first, axes of the second (C, 3) [m]."""
        poses, _ = self._poses(self._tree, posture[self._tree.independent])
        frames, first, second = fields_of(LinkPose, poses), self._tree.first, self._tree.second
        ways = frames.origin[first] - frames.origin[second]
        return np.einsum("cij,ci->cj", frames.axes[second], ways)

    def pose(self, posture: np.ndarray, number: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Pose (4, 4) of a target's first frame in the world, and its Jacobian (6, d), world axes.

        The Jacobian is that of its motion seen from the link of the second frame.
        """
        x = np.asarray(posture, dtype=float)[self._tree.independent]
        poses, columns = self._poses(self._tree, x)
        frame = fields_of(LinkPose, poses[self._tree.first[number]])
        pose = pose_matrix(frame.axes, frame.origin)
        J = np.empty((6, x.size))
        write_jacobian(self._tree, number, poses, columns, J)
        return pose, J

    def origins(self, posture: np.ndarray) -> np.ndarray:
        """Origins of all joints in the world (n, 3) [m]."""
        x = np.asarray(posture, dtype=float)[self._tree.independent]
        poses, columns = self._poses(self._tree, x)
        return fields_of(LinkPose, poses).origin[: len(columns)]

    def _poses(self, tree: Tree, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses of joints and frames, and the joints' columns, as rows of the kernel."""
        poses = np.empty((tree.parents.size, POSE_WIDTH))
        columns = np.empty((tree.leaders.size, COLUMN_WIDTH))
        write_poses(tree, x, poses, columns)
        return poses, columns

    @cached_property
    def rank(self) -> int:
        """How many directions of its errors the robot can move along, but for special postures.

        Fewer than all where it is a mechanism in a plane, or has too few joints.
        """
        rng, ranks = np.random.default_rng(0), [1]
        for x in rng.uniform(self.lower, self.upper, (4, self.lower.size)):
            values = self._singular_values(self._all_joints(x))
            ranks.append(int(np.sum(values > VANISHES * np.max(values, initial=0.0))))
        return max(ranks)

    def _singular_values(self, posture: np.ndarray) -> np.ndarray:
        """Of the Jacobian of what counts, lengths over that of the search; largest first."""
        rows = []
        for number, target in enumerate(self.targets):
            pose, J = self.pose(posture, number)
            J = (pose[:3, :3].T @ J.reshape(2, 3, -1)).reshape(6, -1)
            J[:3] /= self._length
            rows.append(J[target.counted])
        return np.linalg.svd(np.vstack(rows), compute_uv=False)

    def _follow(self, start: np.ndarray, trees: Sequence[Tree]) -> np.ndarray | None:
        course = []
        for tree in trees:
            start, error = self._solve(tree, start)
            if not error < REACHED:
                return None
            course.append(self._all_joints(start))
        return np.array(course)

    def _solve(self, tree: Tree, start: np.ndarray) -> tuple[np.ndarray, float]:
        """Numbers ``x`` (d,), and the largest component of their error."""
        x = start.copy()
        return x, reach_places(tree, self.lower, self.upper, self._length, x)

    def _all_joints(self, x: np.ndarray) -> np.ndarray:
        """Positions of all joints (n,)."""
        return self._tree.multipliers * x[self._tree.leaders] + self._tree.offsets

    def _judge(self, course: np.ndarray, clear: Callable[[np.ndarray, int], float] | None) -> Reach:
        dexterity, clearance = np.inf, 1.0
        for number, q in enumerate(course):
            if clear is not None:
                clearance = min(clearance, clear(q, number))
            dexterity = min(dexterity, float(self._singular_values(q)[self.rank - 1]))
        half = np.maximum(0.5 * (self.upper - self.lower), 1e-9)
        x = course[:, self._tree.independent]
        room = (np.minimum(x - self.lower, self.upper - x) + (MARGIN - self._margin)) / half
        room = float(np.min(room[:, self._limited], initial=1.0))
        return Reach(course, dexterity, room, clearance)


class InverseKinematics(TreeKinematics):
    """The search for postures of one arm.

    Parameters
    ----------
    arm : Robot
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
        arm: Robot,
        free: Sequence[int] = (),
        frame: np.ndarray | None = None,
        to_limits: bool = False,
    ) -> None:
        self.arm, self.free = arm, tuple(free)
        self._structure = require_chain(arm.structure(), arm.tip.joint)
        tip = pose_matrix(arm.tip.rotation, arm.tip.translation)
        end = tip if frame is None else tip @ frame
        length = 0.5 * float(np.max(arm.levers(end[:3, 3]))) if to_limits else LENGTH
        ranges = Ranges.of_joints(arm.position_limits, self._structure.slides, to_limits)
        target = Target(LinkFrame(arm.tip.joint - 1, end), free=self.free)
        super().__init__(self._structure, [target], ranges, length=length)

    @cached_property
    def rank(self) -> int:
        """All directions count: an arm that moves in a plane is singular everywhere."""
        return min(self._tree.counted.size, self.lower.size)

    def farther_than_it_reaches(self, place: np.ndarray) -> tuple[float, float] | None:
        """Distance of a place from the first joint, and the reach that it exceeds [m].

        None where the place may be within reach: the reach is that of a chain whose every link
        points the same way, with all sliding joints at their farthest.
        """
        joints, n = fields_of(ChainJoint, self._tree.joints), self._tree.leaders.size
        slides = joints.slides[:n] != 0.0
        travels = np.maximum(np.abs(self.lower), np.abs(self.upper))[slides]
        links = np.linalg.norm(joints.offset[1 : n + 1], axis=1)
        reach = float(np.sum(links) + np.sum(travels))
        shift = place[:3, :3].T @ (place[:3, 3] - joints.offset[0])
        counted = self.targets[0].counted
        distance = float(np.linalg.norm(shift[counted[counted < 3]]))
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
        structure = self._structure
        mount = pose_matrix(structure.rotations[0], structure.translations[0])
        frames.append(frame @ np.linalg.solve(self.arm.files.base, mount))
        slides = [k < 3 for k in BASE_JOINTS if k in varied]
        moved = _on_joints(structure, slides, axes, np.array(frames))
        (target,) = self.targets
        tip = LinkFrame(moved.parents.size - 1, target.first.pose)
        search.targets = (replace(target, first=tip),)
        search._set_tree(kinematic_tree(moved, search.targets))
        lower, upper = np.transpose(ranges)
        search._limited = np.append(np.ones(len(ranges), dtype=bool), self._limited)
        search.lower = np.concatenate([lower, self.lower])
        search.upper = np.concatenate([upper, self.upper])
        return search


def _on_joints(
    arm: TreeStructure, slides: list[bool], axes: list[np.ndarray], frames: np.ndarray
) -> TreeStructure:
    """An arm on massless joints below it; ``frames`` (k + 1, 4, 4) are theirs and its own first."""
    still = TreeStructure(*(np.zeros((len(axes), *part.shape[1:])) for part in arm))
    both = TreeStructure(*map(np.concatenate, zip(still, arm, strict=True)))
    return both._replace(
        parents=np.arange(-1, both.masses.size - 1),
        slides=np.append(slides, arm.slides),
        axes=np.vstack([*axes, arm.axes]),
        rotations=np.concatenate([frames[:, :3, :3], arm.rotations[1:]]),
        translations=np.concatenate([frames[:, :3, 3], arm.translations[1:]]),
    )


def points_on_links(origins: np.ndarray) -> np.ndarray:
    """Points on the lines between origins of a chain's joints, (5 (n - 1), 3) of (n, 3) [m]."""
    return points_between(origins[:-1], origins[1:])


def points_between(begins: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Points on lines from beginnings (n, 3) to ends (n, 3), shape (5 n, 3) [m]."""
    steps = np.linspace(0.0, 1.0, 5)[:, None, None]
    return (begins + steps * (ends - begins)).reshape(-1, 3)


def clearance(*distances: np.ndarray) -> float:
    """A factor of the quality: 1 where all distances [m] are at least ``APART``, never zero."""
    nearest = min(float(np.min(part, initial=APART)) for part in distances)
    return float(np.clip(nearest / APART, 0.02, 1.0))
