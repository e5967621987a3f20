"""Places of bases that the program finds: where an arm stands best to hold its place on the object.

Places are tried in turn; whether one will do is decided by inverse kinematics
(:mod:`multiarm.assembly.inverse_kinematics`).  The best is the one whose posture is farthest from
singular postures, from the limits of its joints, from the object and from the ground.

A scene says with ``base: {solve: [x, y, yaw]}`` what may vary.  Of such a base, places are drawn
from all within reach, then, in rounds, from ever smaller surroundings of the best one.  Where the
arm reaches its place on the object from none of the first, inverse kinematics finds the first ones:
what may vary is then joints below the arm.  Bases keep a distance from the bases of other arms.

Where the arm would overlap the object or an arm that stands already, the best place is taken of
those where it does not (:mod:`multiarm.assembly.collisions`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from multiarm.assembly.arm_postures import PostureSearch, clear_of, joint_places
from multiarm.assembly.collisions import Surroundings, nearest
from multiarm.assembly.inverse_kinematics import (
    BASE_JOINTS,
    WHOLE_STARTS,
    InverseKinematics,
    Reach,
    clearance,
    points_on_links,
)
from multiarm.assembly.postures import KEEPS_OFF, OVERLAP, first_to_hold, robots_in_joints
from multiarm.errors import SceneError
from multiarm.robots.robot import Robot
from multiarm.scene import BaseSpec, JointSpec, ObjectSpec, Scene
from multiarm.scene.faults import fault_at, listed

# The most promising places are looked at again, from more starts and at every pose.
FINALISTS, FEW, MANY = 8, 2, 16
# Starts at a place where the whole ranges of the joints are searched, and how many places are that
# come from searches of base and joints together.
WHOLE_FEW, MOST_BASES = 128, 12
# A place below this quality is too near a singular posture to be used.
POOREST = 1e-3
# Places tried in each round, and the part of the reach, or of half a turn, that they are apart.
ROUNDS = ((160, 1.0), (48, 0.25), (48, 0.08))
# Bases are at least this part of the reach apart, and links this far from other bases [m].
BASES_APART, FROM_BASES = 0.3, 0.1
# Decimals of what is found [m, rad].
DECIMALS = 3
# Names of what may vary, in the order of xyz and rpy.
COMPONENTS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclass(frozen=True)
class Stand:
    """A place of an arm.

    Attributes
    ----------
    base : ndarray, shape (4, 4)
        In the world.
    mount : ndarray, shape (4, 4)
        Where the arm holds the object, in the object's frame.
    reach : Reach
    worth : float
        A factor on the quality.
    """

    base: np.ndarray
    mount: np.ndarray
    reach: Reach
    worth: float = 1.0

    @property
    def quality(self) -> float:
        """Quality of the posture, times the worth of the place."""
        return self.reach.quality * self.worth


@dataclass(frozen=True)
class StandSearch:
    """The search for the best place of one arm.

    Attributes
    ----------
    robot : InverseKinematics
        Of the arm, wherever it stands.
    poses : list of ndarray, shape (4, 4)
        That the object shall pass, the start first.
    clear : callable
        Of a base (4, 4), the origins of the joints and the tip in the world (n + 1, 3) and a pose
        of the object: a factor on the quality, 1 where the arm is out of the way of everything.
    rng : numpy.random.Generator
        Where searches for postures start.
    allowed : callable, optional
        Of a base (4, 4) and a posture (n,): whether the arm may stand there so.
    starts : tuple of 2 ints
        Of the searches for postures in the quick look, and in the close one.
    """

    robot: InverseKinematics
    poses: list[np.ndarray]
    clear: Callable[[np.ndarray, np.ndarray, np.ndarray], float]
    rng: np.random.Generator
    allowed: Callable[[np.ndarray, np.ndarray], bool] | None = None
    starts: tuple[int, int] = (FEW, MANY)

    def best(self, places: Iterable[tuple[np.ndarray, np.ndarray, float]]) -> Stand | None:
        """The best of some places (base, mount, worth), None where the arm reaches from none.

        First a quick look at all of them at the start pose, then the best of them closely.
        """
        candidates = []
        for base, mount, worth in places:
            reach = self._reached(base, mount, self.poses[:1], self.starts[0])
            if reach is not None:
                candidates.append(Stand(base, mount, reach, worth))
        candidates.sort(key=lambda stand: -stand.quality)
        finals = []
        for stand in candidates[:FINALISTS]:
            reach = self._reached(stand.base, stand.mount, self.poses, self.starts[1])
            if reach is not None:
                finals.append(replace(stand, reach=reach))
        return max(finals, key=lambda stand: stand.quality, default=None)

    def _reached(
        self, base: np.ndarray, mount: np.ndarray, poses: list[np.ndarray], starts: int
    ) -> Reach | None:
        arm = self.robot.arm
        motion, back = moved_base(arm, base), arm.files.base @ np.linalg.inv(base)

        def clear(posture: np.ndarray, number: int) -> float:
            points = arm.skeleton(posture) @ motion[:3, :3].T + motion[:3, 3]
            return self.clear(base, points, poses[number])

        def allowed(posture: np.ndarray, _number: int) -> bool:
            return self.allowed is None or self.allowed(base, posture)

        places = [back @ X @ mount for X in poses]
        return self.robot.search(places, self.rng, starts, clear, allowed)


def moved_base(arm: Robot, base: np.ndarray) -> np.ndarray:
    """Motion (4, 4), in the world, of an arm whose base comes to a pose (4, 4)."""
    return base @ np.linalg.inv(arm.files.base)


def farthest(arm: Robot, rng: np.random.Generator) -> float:
    """How far the tip gets from the base [m]."""
    limits = np.clip(arm.position_limits, -np.pi, np.pi)
    tips = [arm.tip_pose(rng.uniform(*limits.T))[:3, 3] for _ in range(400)]
    return float(np.max(np.linalg.norm(tips - arm.files.base[:3, 3], axis=1)))


@dataclass(frozen=True)
class Standing:
    """An arm on its base, at a posture (n,)."""

    arm: Robot
    posture: np.ndarray


def find_bases(
    scene: Scene, arms: Mapping[str, Robot], written: Mapping[str, Standing]
) -> dict[str, BaseSpec]:
    """The bases that the scene leaves to the program.

    Parameters
    ----------
    scene : Scene
    arms : mapping arm -> Robot
        Whose bases these are, on the written ones so far.
    written : mapping arm -> Standing
        Other arms, of which base and posture are written.

    Raises
    ------
    SceneError
        Naming every arm for which no place is found.
    """
    bases = {n: spec.base.matrix()[:3, 3] for n, spec in scene.arms.items() if n not in arms}
    standing = dict(written)
    found: dict[str, BaseSpec] = {}
    faults = []
    in_joints = [name for name in robots_in_joints(scene) if name in arms]
    for name in dict.fromkeys([*in_joints, *arms]):
        where, joints = ("arms", name, "base", "solve"), _joints_with_objects(scene, name)
        if not joints:
            problem = "needs a joint of the arm with an object, and its 'at'; or remove 'solve'"
            faults.append(fault_at(where, problem))
            continue
        placed = {number: joint for number, joint in joints.items() if joint.at is not None}
        if not placed:
            (number, *_) = joints
            problem = f"needs the joint's place on the object: give $.joints[{number}].at"
            faults.append(fault_at(where, problem))
            continue
        number, joint = next(iter(placed.items()))
        search = _BaseSearch.of_joint(scene, joint, arms[name], list(bases.values()))
        base = search.best()
        if base is None:
            problem = (
                f"no {listed(search.written.solve)} of the base were found with which "
                f"the arm reaches its place on the object ($.joints[{number}].at), at "
                f"{ROUNDS[0][0]} places and in {WHOLE_STARTS} searches of base and joints "
                f"together; it reaches {search.reach:.2f} m far and keeps {search.apart:.2f} m "
                "from other bases; let more vary, of x, y, z, roll, pitch, yaw, or choose another "
                "place"
            )
            faults.append(fault_at(where, problem))
            continue
        base, standing[name] = _out_of_the_way(scene, joint, search, base, standing)
        found[name], bases[name] = base, base.matrix()[:3, 3]
    if faults:
        raise SceneError(faults)
    return found


def _joints_with_objects(scene: Scene, arm: str) -> dict[int, JointSpec]:
    """The joints of an arm with objects that hold at the start, or else the first one to hold."""
    joints = {
        number: joint
        for number, joint in enumerate(scene.joints)
        if joint.first.robot == arm and joint.second.is_object
    }
    return first_to_hold(joints, arm)


def _out_of_the_way(
    scene: Scene,
    joint: JointSpec,
    search: _BaseSearch,
    base: BaseSpec,
    standing: Mapping[str, Standing],
) -> tuple[BaseSpec, Standing]:
    """This base and the posture there, or others where the arm overlaps what is around it."""
    arm = search.stand_on(base)
    postures = PostureSearch.of_joint(scene, joint, arm)
    posture = postures.best()
    assert posture is not None, "the arm reaches its place from the base that was found"
    neighbours = {name: stand.arm for name, stand in standing.items()}
    surroundings = Surroundings(scene, {**neighbours, arm.name: arm})
    obstacles = surroundings.obstacles(
        arm.name, {name: stand.posture for name, stand in standing.items()}
    )

    def distance(base: np.ndarray, posture: np.ndarray) -> float:
        moved = moved_base(arm, base)
        links = surroundings.placed(arm.name, posture, standing=True, shift=moved)
        return nearest(links, obstacles).distance

    def keeps_off(base: np.ndarray, posture: np.ndarray) -> bool:
        return distance(base, posture) >= KEEPS_OFF

    if distance(arm.files.base, posture) < -OVERLAP:
        better = search.best(keeps_off)
        if better is not None:
            base = better
            arm = search.stand_on(base)
            postures = PostureSearch.of_joint(scene, joint, arm)
            apart = postures.best(lambda q: keeps_off(base.matrix(), q))
            posture = postures.best() if apart is None else apart
            assert posture is not None, "the arm reaches its place from the base that was found"
    return base, Standing(arm, posture)


@dataclass(frozen=True)
class _BaseSearch:
    """The search for a base of an arm.

    Attributes
    ----------
    arm : Robot
    written : BaseSpec
    body : ObjectSpec
    on_tip, place : ndarray, shape (4, 4)
        The joint's frame in the tip's; its place in the world.
    free : tuple of int
        Components of the pose that the joint leaves free.
    reach : float
        How far the tip gets from the base [m].
    bases : list of ndarray, shape (3,)
        Places of other arms.
    """

    arm: Robot
    written: BaseSpec
    body: ObjectSpec
    on_tip: np.ndarray
    place: np.ndarray
    free: tuple[int, ...]
    reach: float
    bases: list[np.ndarray]

    @classmethod
    def of_joint(
        cls, scene: Scene, joint: JointSpec, arm: Robot, bases: list[np.ndarray]
    ) -> _BaseSearch:
        """The search that a joint of a scene asks for."""
        written, places = scene.arms[arm.name].base, joint_places(scene, joint)
        assert isinstance(written, BaseSpec), "its base is to be found"
        reach = farthest(arm, np.random.default_rng(0))
        body = scene.all_objects[joint.second.tip]
        return cls(arm, written, body, *places, tuple(joint.free or ()), reach, bases)

    @property
    def near(self) -> float:
        """How far the base may be from the joint's place [m]."""
        return self.reach + float(np.linalg.norm(self.on_tip[:3, 3]))

    @property
    def apart(self) -> float:
        """How far it must be from other bases [m]."""
        return BASES_APART * self.reach

    def stand_on(self, base: BaseSpec) -> Robot:
        """The arm on a base."""
        return Robot(self.arm.name, replace(self.arm.files, base=base.matrix()))

    def best(
        self, allowed: Callable[[np.ndarray, np.ndarray], bool] | None = None
    ) -> BaseSpec | None:
        """The best base found from which a posture is ``allowed``, None where none is.

        Parameters
        ----------
        allowed : callable, optional
            Of a base (4, 4) and a posture (n,) there: whether the arm may stand so.
        """
        pose, rng = self.body.pose.matrix(), np.random.default_rng(0)
        mount = np.linalg.solve(pose, self.place)
        clear_of_object = clear_of(self.body, self.place, meshes=allowed is not None)

        def clear(base: np.ndarray, points: np.ndarray, _pose: np.ndarray) -> float:
            ways = points_on_links(points)[:, None] - np.reshape(self.bases, (-1, 3))
            return min(
                clear_of_object(base, points), clearance(np.linalg.norm(ways, axis=2) - FROM_BASES)
            )

        for to_limits in (False, True):
            for free in dict.fromkeys([(), self.free]):
                arm = InverseKinematics(self.arm, free, self.on_tip, to_limits)
                starts = (WHOLE_FEW, WHOLE_FEW) if to_limits else (FEW, MANY)
                search = StandSearch(arm, [pose], clear, rng, allowed, starts)
                best, quality = None, 0.0 if to_limits else POOREST
                for number, (count, part) in enumerate(ROUNDS):
                    if to_limits and number == 0:
                        bases = self._reaching(arm, rng)
                    else:
                        bases = self._drawn(best or self.written, part, count)
                    bases = [base for base in bases if self._has_room(base)]
                    stand = search.best((base.matrix(), mount, 1.0) for base in bases)
                    if stand is not None and stand.quality > quality:
                        quality = stand.quality
                        best = next(b for b in bases if np.array_equal(b.matrix(), stand.base))
                    if best is None:
                        break
                if best is not None:
                    return best
        return None

    def _has_room(self, base: BaseSpec) -> bool:
        distances = [
            np.linalg.norm(np.subtract(base.xyz, base_of_another)) for base_of_another in self.bases
        ]
        near = np.linalg.norm(base.xyz - self.place[:3, 3]) <= self.near
        return bool(near) and all(distance >= self.apart for distance in distances)

    @property
    def _varied(self) -> list[int]:
        return [COMPONENTS.index(name) for name in self.written.solve]

    @property
    def _above_ground(self) -> bool:
        """Whether the base must be above the ground, as its place is."""
        return "z" in self.written.solve and self.place[2, 3] > 0.0

    def _drawn(self, around: BaseSpec, part: float, count: int) -> list[BaseSpec]:
        """Bases around one, or where it is to be found around the place that it is found for.

        They are up to this part of the reach and of half a turn away.
        """
        varied = self._varied
        values = np.tile([*around.xyz, *around.rpy], (count, 1))
        if around.solve:
            shifts = [k for k in varied if k < 3]
            values[:, shifts] = self.place[shifts, 3]
        spans = np.array([part * self.near] * 3 + [part * np.pi] * 3)[varied]
        draws = np.random.default_rng(0).uniform(-1.0, 1.0, (count, len(varied)))
        values[:, varied] = np.round(values[:, varied] + spans * draws, DECIMALS)
        if self._above_ground:
            values[:, 2] = np.maximum(values[:, 2], 0.0)
        return [self._base(numbers) for numbers in values]

    def _reaching(self, search: InverseKinematics, rng: np.random.Generator) -> list[BaseSpec]:
        """Bases from which the arm reaches its place, and those rounded."""
        numbers = np.array([*self.written.xyz, *self.written.rpy])
        spans = [self.near] * 3 + [np.pi] * 3
        middle = [*self.place[:3, 3], *numbers[3:]]
        varied = {k: (middle[k] - spans[k], middle[k] + spans[k]) for k in self._varied}
        if self._above_ground:
            varied[2] = (max(varied[2][0], 0.0), varied[2][1])
        bases = []
        moving = search.on_moving_base(self.written, varied)
        for course in islice(moving.courses([self.place], rng, WHOLE_STARTS), MOST_BASES):
            numbers[[k for k in BASE_JOINTS if k in varied]] = course[0][: len(varied)]
            bases += [self._base(np.round(numbers, DECIMALS)), self._base(numbers)]
        return bases

    def _base(self, numbers: np.ndarray) -> BaseSpec:
        """The written base with numbers (6,) in place of those that are sought."""
        *xyz, roll, pitch, yaw = numbers.tolist()
        change: dict[str, tuple[float, ...]] = {"solve": ()}
        change |= {"xyz": tuple(xyz)} if min(self._varied) < 3 else {}
        change |= {"rpy": (roll, pitch, yaw)} if max(self._varied) >= 3 else {}
        return self.written.model_copy(update=change)
