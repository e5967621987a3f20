"""Places of bases that the program finds: where an arm stands best to hold its place on the object.

Places are tried in turn; whether one will do is decided by inverse kinematics
(:mod:`multiarm.assembly.inverse_kinematics`).  The best is the one whose posture is farthest from
singular postures, from the limits of its joints, from the object and from the ground.

A scene says with ``base: {solve: [x, y, yaw]}`` what may vary.  Of such a base, places are drawn
from all within reach, then, in rounds, from ever smaller surroundings of the best one.  They keep a
distance from the bases of other arms.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.assembly.inverse_kinematics import (
    InverseKinematics,
    Reach,
    clearance,
    points_on_links,
)
from multiarm.assembly.postures import clear_of, joint_places
from multiarm.errors import SceneError
from multiarm.scene import BaseSpec, JointSpec, Scene
from multiarm.scene.faults import listed, place

# The most promising places are looked at again, from more starts and at every pose.
FINALISTS, FEW, MANY = 8, 2, 16
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
        """That of the posture, times what the place is worth."""
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
    """

    robot: InverseKinematics
    poses: list[np.ndarray]
    clear: Callable[[np.ndarray, np.ndarray, np.ndarray], float]
    rng: np.random.Generator

    def best(self, places: Iterable[tuple[np.ndarray, np.ndarray, float]]) -> Stand | None:
        """The best of some places (base, mount, worth), None where the arm reaches from none.

        First a quick look at all of them at the start pose, then the best of them closely.
        """
        candidates = []
        for base, mount, worth in places:
            found = self._reached(base, mount, self.poses[:1], FEW)
            if found is not None:
                candidates.append(Stand(base, mount, found, worth))
        candidates.sort(key=lambda stand: -stand.quality)
        finals = []
        for stand in candidates[:FINALISTS]:
            found = self._reached(stand.base, stand.mount, self.poses, MANY)
            if found is not None:
                finals.append(replace(stand, reach=found))
        return max(finals, key=lambda stand: stand.quality, default=None)

    def _reached(
        self, base: np.ndarray, mount: np.ndarray, poses: list[np.ndarray], starts: int
    ) -> Reach | None:
        own = self.robot.arm.files.base
        there, home = base @ np.linalg.inv(own), own @ np.linalg.inv(base)

        def clear(skeleton: np.ndarray, number: int) -> float:
            points = skeleton @ there[:3, :3].T + there[:3, 3]
            return self.clear(base, points, poses[number])

        return self.robot.search([home @ X @ mount for X in poses], self.rng, starts, clear)


def farthest(arm: Arm, rng: np.random.Generator) -> float:
    """How far the tip gets from the base [m]."""
    limits = np.clip(arm.position_limits, -np.pi, np.pi)
    tips = [arm.tip_pose(rng.uniform(*limits.T))[:3, 3] for _ in range(400)]
    return float(np.max(np.linalg.norm(tips - arm.files.base[:3, 3], axis=1)))


def find_bases(scene: Scene, arms: Mapping[str, Arm]) -> dict[str, BaseSpec]:
    """The bases that the scene leaves to the program, of ``arms`` that stand as written so far.

    Raises
    ------
    SceneError
        Naming every arm that reaches its place from nowhere.
    """
    bases = {n: spec.base.matrix()[:3, 3] for n, spec in scene.arms.items() if n not in arms}
    found, faults = {}, []
    for number, joint in enumerate(scene.joints):
        if joint.arm not in arms:
            continue
        written, where = scene.arms[joint.arm].base, place(("arms", joint.arm, "base", "solve"))
        if joint.at is None:
            faults.append(
                f"{where}: needs the joint's place on the object: give $.joints[{number}].at"
            )
            continue
        arm = arms[joint.arm]
        reach = farthest(arm, np.random.default_rng(0))
        base = _best_base(scene, joint, arm, reach, list(bases.values()))
        if base is None:
            faults.append(
                f"{where}: from nowhere with other {listed(written.solve)} does the arm reach its "
                f"place on the object ($.joints[{number}].at); it reaches {reach:.2f} m far and "
                f"keeps {BASES_APART * reach:.2f} m from other bases; let more vary, of x, y, z, "
                "roll, pitch, yaw, or choose another place"
            )
            continue
        found[joint.arm], bases[joint.arm] = base, base.matrix()[:3, 3]
    if faults:
        raise SceneError(faults)
    return found


def _best_base(
    scene: Scene, joint: JointSpec, arm: Arm, reach: float, others: list[np.ndarray]
) -> BaseSpec | None:
    """The best base of an arm, apart from the places (3,) of others; None where there is none."""
    written, pose = scene.arms[joint.arm].base, scene.object.pose.matrix()
    on_tip, there = joint_places(scene, joint)
    mount, rng = np.linalg.solve(pose, there), np.random.default_rng(0)
    near, apart = reach + np.linalg.norm(on_tip[:3, 3]), BASES_APART * reach
    clear_of_object = clear_of(scene.object, there)

    def clear(base: np.ndarray, points: np.ndarray, _pose: np.ndarray) -> float:
        ways = points_on_links(points)[:, None] - np.reshape(others, (-1, 3))
        return min(
            clear_of_object(base, points), clearance(np.linalg.norm(ways, axis=2) - FROM_BASES)
        )

    def allowed(base: BaseSpec) -> bool:
        distances = [np.linalg.norm(np.subtract(base.xyz, other)) for other in others]
        return np.linalg.norm(base.xyz - there[:3, 3]) <= near and all(
            d >= apart for d in distances
        )

    for free in dict.fromkeys([(), joint.free or ()]):
        search = StandSearch(InverseKinematics(arm, free, on_tip), [pose], clear, rng)
        best, quality = None, POOREST
        for count, part in ROUNDS:
            drawn = _drawn(best or written, written.solve, there[:3, 3], part * reach, part, count)
            bases = [base for base in drawn if allowed(base)]
            stand = search.best((base.matrix(), mount, 1.0) for base in bases)
            if stand is not None and stand.quality > quality:
                quality = stand.quality
                best = next(base for base in bases if np.array_equal(base.matrix(), stand.base))
            if best is None:
                break
        if best is not None:
            return best
    return None


def _drawn(
    around: BaseSpec, names: Sequence[str], there: np.ndarray, reach: float, part: float, count: int
) -> list[BaseSpec]:
    """Bases around one, or around the place (3,) that it is found for, that differ in ``names``.

    They are up to ``reach`` [m] and this part of half a turn away.
    """
    varied = [COMPONENTS.index(name) for name in names]
    values = np.tile([*around.xyz, *around.rpy], (count, 1))
    if around.solve:
        shifts = [k for k in varied if k < 3]
        values[:, shifts] = there[shifts]
    spans = np.array([reach] * 3 + [part * np.pi] * 3)[varied]
    draws = np.random.default_rng(0).uniform(-1.0, 1.0, (count, len(varied)))
    values[:, varied] = np.round(values[:, varied] + spans * draws, DECIMALS)
    if "z" in names and there[2] > 0.0:  # nothing stands below the ground
        values[:, 2] = np.maximum(values[:, 2], 0.0)
    bases = []
    for *xyz, roll, pitch, yaw in values.tolist():
        change: dict[str, tuple[float, ...]] = {"solve": ()}
        change |= {"xyz": tuple(xyz)} if min(varied) < 3 else {}
        change |= {"rpy": (roll, pitch, yaw)} if max(varied) >= 3 else {}
        bases.append(around.model_copy(update=change))
    return bases
