"""Postures of robots with several tips: all connections of a robot are closed at once.

A connection brings a tip to its place on the object, to a place in the world, or two links of the
robot together.  The joints that may move the robot's base are joints like all others.  The posture
is one with which the two frames of every connection coincide, or, where there is none, coincide but
for the motions that the connections leave free; of many, the best one is taken, as for an arm
(:mod:`multiarm.assembly.postures`).  Joints that move no connection stay as they are written.

*What it proves.*  A place is out of reach for certain where it is farther from the first joint, or
from the place of another tip, than the links between them are long, with all sliding joints between
them at their farthest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from multiarm.assembly.arm_postures import (
    NO_TURN,
    STARTS,
    apart_from,
    best_posture,
    helpful_shift,
    move_base_by,
)
from multiarm.assembly.inverse_kinematics import (
    LENGTH,
    TIE,
    WHOLE_STARTS,
    Miss,
    TreeKinematics,
    points_between,
)
from multiarm.assembly.kinematic_tree import Coupling, LinkFrame, Ranges, Target, way_to
from multiarm.assembly.reaching import REACHED
from multiarm.geometry.poses import pose_matrix
from multiarm.geometry.records import basis
from multiarm.notation import number
from multiarm.robots.robot import Robot
from multiarm.robots.terms import TreeStructure
from multiarm.scene import JointSpec, ObjectSpec, ResolvedRobot, Scene
from multiarm.scene.bodies import BodyName
from multiarm.scene.faults import counted, shown
from multiarm.spatial import quaternion_to_matrix

# Connections of which a message tells how far they are from closed.
MOST_TOLD = 4
# Gaps below this [m, rad] are those of angles with five digits.
ROUNDED = 1e-5
# Places of a search all of whose frames are written in its targets.
ALL_WRITTEN = np.zeros((0, 4, 4))


@dataclass(frozen=True)
class RobotPostureSearch:
    """The search for a posture with which a robot closes all its connections.

    Attributes
    ----------
    structure : TreeStructure
        Joints that move the base first.
    targets : mapping connection -> Target
        Both frames of each; those at rest, such as a place on the object, are on joint -1.
    limits : ndarray, shape (n, 2)
        Of the joints; infinite where they have none [rad or m].
    written : ndarray, shape (n,)
        The posture as the scene has it [rad or m].
    base : ndarray, shape (4, 4)
        The base in the world, with the joints that move it at zero.
    base_joints : int
        How many joints move the base.
    bodies : list of ObjectSpec
        The objects.
    couplings : tuple of Coupling
        Joints that follow others.
    floats : bool
        Whether the base floats; it is sought where it is written.
    """

    structure: TreeStructure
    targets: Mapping[str, Target]
    limits: np.ndarray
    written: np.ndarray
    base: np.ndarray
    base_joints: int
    bodies: Sequence[ObjectSpec]
    couplings: tuple[Coupling, ...] = ()
    floats: bool = False

    @classmethod
    def of_robot(
        cls,
        scene: Scene,
        joints: Sequence[JointSpec],
        arm: Robot,
        resolved: ResolvedRobot,
        at_rest: Callable[[BodyName], np.ndarray],
    ) -> RobotPostureSearch:
        """The search that joints of a robot ask for, all of which have a place.

        ``at_rest`` gives the poses of other robots' links.
        """
        number = {name: k for k, name in enumerate(arm.joint_names)}
        return cls(
            structure=arm.structure().standing_on(_base_of(arm)) if arm.floats else arm.structure(),
            targets={joint.connection: target_of(scene, joint, arm, at_rest) for joint in joints},
            limits=arm.position_limits,
            written=resolved.posture,
            base=arm.files.base,
            base_joints=len(resolved.base_joints),
            floats=arm.floats,
            bodies=[*scene.all_objects.values()],
            couplings=tuple(
                Coupling(number[c.joint], number[c.leader], c.multiplier, c.offset)
                for c in resolved.mimic
            ),
        )

    @property
    def longest(self) -> float:
        """The longest stretch of links to a place, without the joints that move the base [m]."""
        return self._lengths.longest

    def distances(self, posture: np.ndarray) -> dict[str, float]:
        """How far both frames of the connections are apart at a posture (n,), but for what is free.

        In metres; motions along directions that a connection leaves free do not count.
        """
        search, _ = self._searches()[0]
        gaps = search.shifts(posture)
        for gap, target in zip(gaps, self.targets.values(), strict=True):
            gap[[k for k in target.free if k < 3]] = 0.0
        return dict(zip(self.targets, _lengths(gaps).tolist(), strict=True))

    def best(self, allowed: Callable[[np.ndarray], bool] | None = None) -> np.ndarray | None:
        """The best of the postures (n,) found that are ``allowed``, None where none is.

        Where none is found well inside the limits, the whole ranges of the joints are searched.
        Frames are shifted against each other only where they cannot coincide.
        """
        if self.out_of_reach() is not None:
            return None
        searches = self._searches()
        clear = self._clear(searches[0][0], meshes=allowed is not None)
        return best_posture(searches, ALL_WRITTEN, clear, allowed)

    def _searches(self) -> list[tuple[TreeKinematics, int]]:
        """Searches, and their starts: well inside the limits first, and with nothing left free."""
        loose = tuple(self.targets.values())
        closed = tuple(replace(target, free=()) for target in loose)
        return [
            (self._kinematics(targets, to_limits), starts)
            for to_limits, starts in ((False, STARTS), (True, WHOLE_STARTS))
            for targets in ([closed] if _free(loose) == _free(closed) else [closed, loose])
        ]

    def _kinematics(self, targets: tuple[Target, ...], to_limits: bool) -> TreeKinematics:
        length = 0.5 * self._lengths.longest if to_limits else LENGTH
        ranges = self._lengths.ranges(to_limits)
        return TreeKinematics(self.structure, targets, ranges, self.couplings, length, self.written)

    @cached_property
    def _lengths(self) -> _Lengths:
        return _Lengths(self)

    def out_of_reach(self) -> str | None:
        """Why no posture can close the connections; None where one might."""
        lengths = self._lengths
        for name in lengths.at_rest:
            distance, reach = lengths.from_base(name)
            if distance > reach * (1.0 + TIE):
                return (
                    f"the place of {shown(name)} is out of reach: it is {distance:.3f} m from the "
                    "first joint that moves its tip, and the links between stretch to "
                    f"{reach:.3f} m"
                )
        for pair in combinations(lengths.at_rest, 2):
            distance, reach = lengths.between(*pair)
            if distance > reach * (1.0 + TIE):
                return (
                    f"the places of {shown(pair[0])} and {shown(pair[1])} are {distance:.3f} m "
                    f"apart, and the links between both tips stretch to {reach:.3f} m"
                )
        return None

    def why_none(self) -> str:
        """What a user may do where :meth:`best` finds nothing."""
        searches, text = self._searches(), self.out_of_reach()
        if text is None:
            names = counted([shown(name) for name in self.targets], MOST_TOLD)
            total = sum(starts for _, starts in searches)
            text = (
                f"no joint positions were found that close {names}"
                f"{' at once' if len(self.targets) > 1 else ''}, in {total} searches that began "
                "all over the ranges of the joints"
            )
        loosest = searches[-1][0].targets
        misses = [
            search.nearest(ALL_WRITTEN, np.random.default_rng(0), starts)
            for search, starts in searches
            if search.targets == loosest
        ]
        weights = np.array([0.0 if target.free else LENGTH for target in loosest])
        miss = min(misses, key=lambda m: np.sum(m.shifts**2) + np.sum((weights * m.turns) ** 2))
        return f"{text}; the nearest posture found leaves {self._gaps(miss)}; {self._remedy(miss)}"

    def _gaps(self, miss: Miss) -> str:
        """The gaps of a posture, the widest first."""
        distances = np.linalg.norm(miss.shifts, axis=1)
        rows = zip(distances, np.rad2deg(miss.turns), self.targets.items(), strict=True)
        gaps = [
            f"{_millimetres(distance)} m{f' and {turn:.0f} deg' if turned else ''} at {shown(name)}"
            for distance, turn, (name, target) in sorted(rows, key=lambda row: -row[0])
            if (turned := turn > NO_TURN and not target.free) or distance > REACHED
        ]
        return counted(gaps, MOST_TOLD)

    def _remedy(self, miss: Miss) -> str:
        held = np.array([not target.free for target in self.targets.values()])
        if np.max(np.abs(miss.shifts)) < ROUNDED and np.all(miss.turns[held] < ROUNDED):
            return (
                "gaps this small come from rounded numbers: write angles with all digits, such as "
                "1.5707963267948966"
            )
        if self.base_joints or len(self._lengths.at_rest) < len(self.targets):
            return "choose other places, or let more joints move"
        shift = helpful_shift(np.mean(miss.shifts, axis=0), self._reaches_from)
        move = "" if shift is None else f"{move_base_by(shift)}, "
        moving = "" if self.floats else "let it move (base: {moves: [x, y, yaw]}) "
        return f"{move}{moving}or choose other places" if move or moving else "choose other places"

    def _reaches_from(self, shift: np.ndarray) -> bool:
        """Whether a posture is found with the base moved by a shift (3,) [m]."""
        structure, base = self.structure, self.base.copy()
        on_base = structure.parents < 0
        translations = structure.translations + np.outer(on_base, shift)
        base[:3, 3] += shift
        moved = replace(self, structure=structure._replace(translations=translations), base=base)
        return moved.best() is not None

    def _clear(
        self, kinematics: TreeKinematics, meshes: bool
    ) -> Callable[[np.ndarray, int], float]:
        """How well the links keep apart from the objects' boxes and from the ground."""
        parents, first, base = self.structure.parents, self.base_joints, self.base.copy()
        places = self._lengths.places
        height = np.min(places[:, 2], initial=np.inf)
        apart = [apart_from(body, height, meshes) for body in self.bodies]
        links = np.flatnonzero(parents >= first)  # their parent is no joint that moves the base
        high = links[parents[parents[links]] >= first]

        def clear(posture: np.ndarray, _number: int) -> float:
            origins = kinematics.origins(posture)
            if first > 0:
                base[:3, 3] = origins[first - 1]
            points = points_between(origins[parents[links]], origins[links])
            return min(clear_of_body(base, points, origins[high, 2]) for clear_of_body in apart)

        return clear


def target_of(
    scene: Scene, joint: JointSpec, arm: Robot, at_rest: Callable[[BodyName], np.ndarray]
) -> Target:
    """The two frames that a joint of a robot brings together, z the joint's axis.

    The first one is on a link of the robot.  Which motions are free is the same for both.
    """
    assert joint.at is not None, "the joint has a place"
    turn = np.eye(4)
    turn[:3, :3] = basis(joint.z_axis)
    at_first = joint.on_first.matrix() @ joint.start_shift() @ turn
    at_second = joint.at.matrix() @ turn
    if joint.second.is_object:
        at_second = scene.all_objects[joint.second.tip].pose.matrix() @ at_second
    pairs = [(joint.first, at_first), (joint.second, at_second)]
    if joint.first.robot != arm.name:
        pairs.reverse()
    first, second = (_link_frame(arm, body, pose, at_rest) for body, pose in pairs)
    return Target(first, second, tuple(joint.free or ()))


def _link_frame(
    arm: Robot, body: BodyName, pose: np.ndarray, at_rest: Callable[[BodyName], np.ndarray]
) -> LinkFrame:
    if not body.is_link:  # it is at rest
        return LinkFrame(-1, pose)
    if body.robot != arm.name:
        return LinkFrame(-1, at_rest(body) @ pose)
    tip = arm.tips[body.tip]
    frame = pose_matrix(tip.rotation, tip.translation)
    if tip.chain.size == arm.base_dof:  # on the base
        return LinkFrame(-1, _base_of(arm) @ frame @ pose if arm.floats else frame @ pose)
    return LinkFrame(int(tip.chain[-1]) - arm.base_dof, frame @ pose)


def _base_of(robot: Robot) -> np.ndarray:
    """Pose (4, 4) of a floating base as written."""
    return pose_matrix(quaternion_to_matrix(robot.base_pose[3:]), robot.base_pose[:3])


class _Lengths:
    """How far a robot's links stretch between its base and the places that it holds.

    Attributes
    ----------
    at_rest : tuple of str
        Connections whose second frame is at rest.
    places : ndarray, shape (k, 3)
        Origins of these frames in the world [m].
    longest : float
        The longest stretch of links to one of them, without the joints that move the base [m].
    """

    def __init__(self, search: RobotPostureSearch) -> None:
        self._search, self._slides = search, search.structure.slides
        self._endless = ~np.isfinite(search.limits).all(axis=1)
        whole = Ranges.of_joints(search.limits, self._slides, to_limits=True)
        farthest = np.maximum(np.abs(whole.lower), np.abs(whole.upper))
        self._travels = np.where(self._slides, farthest, 0.0)
        self._at_rest = {
            name: target
            for name, target in search.targets.items()
            if target.second is not None and target.second.joint < 0
        }
        self.at_rest = tuple(self._at_rest)
        self.places = np.reshape([self._place(name)[:3, 3] for name in self.at_rest], (-1, 3))
        stretches = [self._stretch(name) for name in self.at_rest]
        self.longest = max(stretches, default=2.0 * LENGTH)

    def _place(self, name: str) -> np.ndarray:
        second = self._at_rest[name].second
        assert second is not None, "the connection has a place"
        return second.pose

    def _way(self, name: str) -> tuple[list[int], np.ndarray]:
        """The joints on the way to a first frame, and the links (k + 1, 3) up to each and to it."""
        structure, first = self._search.structure, self._at_rest[name].first
        joints = way_to(structure.parents, first.joint)
        return joints, np.vstack([structure.translations[joints], first.pose[:3, 3]])

    def _stretch(self, name: str) -> float:
        joints, links = self._way(name)
        carried = [joint for joint in joints if joint >= self._search.base_joints]
        first = max(len(joints) - len(carried), 1)  # a fixed base is where it is
        return float(np.sum(_lengths(links[first:])) + np.sum(self._travels[carried]))

    def ranges(self, to_limits: bool) -> Ranges:
        """Of all joints; a base slides as far as it needs to, to hold the places."""
        search, structure = self._search, self._search.structure
        ranges = Ranges.of_joints(search.limits, self._slides, to_limits)
        R, p = np.eye(3), np.zeros(3)
        for k in range(search.base_joints if self.at_rest else 0):
            p, R = p + R @ structure.translations[k], R @ structure.rotations[k]
            if self._slides[k] and self._endless[k]:
                ways = (self.places - p) @ R @ structure.axes[k]
                ranges.lower[k] = np.min(ways) - self.longest
                ranges.upper[k] = np.max(ways) + self.longest
        return ranges

    def from_base(self, name: str) -> tuple[float, float]:
        """Distance of a place from the first joint, and the reach up to it [m]."""
        joints, links = self._way(name)
        place, free = self._place(name), self._at_rest[name].free
        shift = place[:3, :3].T @ (place[:3, 3] - links[0])
        shift[[k for k in free if k < 3]] = 0.0
        return float(np.linalg.norm(shift)), float(
            np.sum(_lengths(links[1:])) + np.sum(self._farthest(joints))
        )

    def between(self, name: str, second: str) -> tuple[float, float]:
        """Distance of two places from each other, and the reach between both tips [m]."""
        ways = self._way(name), self._way(second)
        fork = sum(a == b for a, b in zip(ways[0][0], ways[1][0], strict=False))
        reach = _lengths(ways[0][1][fork] - ways[1][1][fork])
        for joints, links in ways:
            reach += np.sum(_lengths(links[fork + 1 :])) + np.sum(self._farthest(joints[fork:]))
        if any(k < 3 for part in (name, second) for k in self._at_rest[part].free):
            return 0.0, float(reach)
        distance = np.linalg.norm(self._place(name)[:3, 3] - self._place(second)[:3, 3])
        return float(distance), float(reach)

    def _farthest(self, joints: list[int]) -> np.ndarray:
        """How far sliding joints go [m]; without limits, as far as they want."""
        endless = self._slides[joints] & self._endless[joints]
        return np.where(endless, np.inf, self._travels[joints])


def _millimetres(gap: float) -> str:
    """A gap [m] to a millimetre; a smaller one, as roundings leave, by its digits."""
    return f"{gap:.3f}" if gap > 1e-3 or gap < REACHED else number(gap)


def _lengths(links: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(links, axis=-1))


def _free(targets: tuple[Target, ...]) -> list[tuple[int, ...]]:
    return [target.free for target in targets]
