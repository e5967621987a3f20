"""Joint positions that the program finds: of arms and robots whose joints have places.

A scene says ``posture: solve``, or gives no posture where the joints of a robot at zero leave its
tips far from their places.  The posture is then the best one that closes its connections: of an arm
that only holds the object (:mod:`multiarm.assembly.arm_postures`), or of a robot with several
connections (:mod:`multiarm.assembly.robot_postures`).  Robots that are joined to each other are
found one after the other: each reaches the links of those before it, and of those whose postures
are written.  Of joints that hold for some of the time, those count that hold at the start; where a
link has none and its robot says ``posture: solve``, the first one that is to hold it: the robot
starts where it takes hold.

Where its links overlap the object or the links of other robots, or links on two of its branches
each other (:mod:`multiarm.assembly.collisions`), the best is taken of those that do not.  Links of
one chain are not compared with each other.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Protocol

import numpy as np

from multiarm.assembly.arm_postures import PostureSearch, joint_places
from multiarm.assembly.collisions import NearestPair, Placed, Surroundings
from multiarm.assembly.robot_postures import RobotPostureSearch
from multiarm.errors import SceneError
from multiarm.robots.robot import Robot
from multiarm.scene import JointSpec, ResolvedRobot, Scene
from multiarm.scene.bodies import BodyName
from multiarm.scene.faults import Parts, fault_at, shown
from multiarm.scene.joint_values import SOLVE

# Joints at zero that bring the tip nearer than this part of the arm's length are assembled instead.
NEAR = 0.1
# A link that overlaps an obstacle by more is in its way; one that gets out of it keeps off [m].
OVERLAP, KEEPS_OFF = 0.001, 0.005
# How often the robots are gone through that are in each other's way.
ROUNDS = 2


class Search(Protocol):
    """A search for a posture."""

    def best(self, allowed: Callable[[np.ndarray], bool] | None = None) -> np.ndarray | None:
        """The best posture (n,) that is ``allowed``, None where none is found."""

    def why_none(self) -> str:
        """What a user may do where there is none."""


def find_postures(
    scene: Scene, arms: Mapping[str, Robot], resolved: Mapping[str, ResolvedRobot]
) -> dict[str, np.ndarray]:
    """Positions [rad, m] of the joints that the scene leaves to the program, by robot.

    Parameters
    ----------
    scene : Scene
    arms : mapping robot -> Robot
    resolved : mapping robot -> ResolvedRobot
        With the postures as the scene has them.

    Raises
    ------
    SceneError
        Naming every robot of which no posture is found that reaches its places, how near it comes,
        and what to move.
    """
    searches: dict[str, Search] = {}
    solved: dict[str, np.ndarray] = {}
    faults = []
    sought = [name for name in robots_in_joints(scene) if _is_sought(scene, arms[name])]
    # where the robots are that others may reach for
    known = {name: robot.posture for name, robot in resolved.items() if name not in sought}
    while sought:
        reachable = [
            name
            for name in sought
            if any(joint.at is not None for joint in _joints_of(scene, name, known).values())
        ]
        name = (reachable or sought)[0]
        sought.remove(name)
        where, posture = posture_of(scene, name)
        joints = _joints_of(scene, name, known)
        known[name] = resolved[name].posture
        if not joints and posture is None:
            continue
        placed = {number: joint for number, joint in joints.items() if joint.at is not None}
        places = ", ".join(f"$.joints[{number}].at" for number in placed or joints)
        if not placed:
            if posture == SOLVE:
                bodies = ", ".join(dict.fromkeys(map(_shown_second, joints.values())))
                problem = f"'solve' needs the joint's place on {bodies}: give {places}"
                if not joints:
                    problem = (
                        "'solve' needs a joint with an object, with the world, or with a robot "
                        "whose posture is written or found; write this posture"
                    )
                faults.append(fault_at(where, problem))
            continue
        at_rest = partial(_pose_of_link, arms, dict(known))
        search = _search_of(scene, [*placed.values()], arms[name], resolved[name], at_rest)
        if search is None:
            continue
        positions = search.best()
        if positions is None:
            faults.append(fault_at(where, f"{search.why_none()} ({places})"))
        else:
            searches[name], solved[name], known[name] = search, positions, positions
    if faults:
        raise SceneError(faults)
    # others reach for robots that are joined to them, which stay where they are
    joined = {body.robot for joint in scene.joints for body in _links_of_two(joint)}
    alone = {name: search for name, search in searches.items() if name not in joined}
    return solved | (_out_of_the_way(scene, arms, alone, known) if alone else {})


def posture_of(scene: Scene, name: str) -> tuple[Parts, object]:
    """Where the posture of an arm or robot is written, and what is written there."""
    if name in scene.arms:
        return ("arms", name, "posture"), scene.arms[name].posture
    return ("robots", name, "posture"), scene.robots[name].posture


def robots_in_joints(scene: Scene) -> list[str]:
    """The robots whose links joints connect, each once, in the order of the joints."""
    bodies = (body for joint in scene.joints for body in (joint.first, joint.second))
    return list(dict.fromkeys(body.robot for body in bodies if body.is_link))


def _is_sought(scene: Scene, arm: Robot) -> bool:
    """Whether a robot's posture is left to the program; assembly moves a base that floats too."""
    posture = posture_of(scene, arm.name)[1]
    return posture == SOLVE or (posture is None and not arm.floats)


def _links_of_two(joint: JointSpec) -> list[BodyName]:
    """The two links of a joint between two robots; none of another joint."""
    bodies = joint.first, joint.second
    return [*bodies] if len({body.robot for body in bodies} - {""}) == 2 else []


def _joints_of(scene: Scene, name: str, known: Collection[str]) -> dict[int, JointSpec]:
    """The joints that connect links of a robot at the start, by their numbers in the scene.

    Those with another robot where it is ``known`` where that is.  With ``posture: solve`` the next
    ones of links that no joint holds at the start.
    """
    of_robot = {
        number: joint
        for number, joint in enumerate(scene.joints)
        if name in (joint.first.robot, joint.second.robot)
        and all(body.robot in (name, *known) for body in _links_of_two(joint))
    }
    if posture_of(scene, name)[1] == SOLVE:
        return first_to_hold(of_robot, name)
    return {number: joint for number, joint in of_robot.items() if joint.holds_at(0.0)}


def first_to_hold(joints: Mapping[int, JointSpec], robot: str) -> dict[int, JointSpec]:
    """Of joints of a robot those that hold at the start, and of links that none holds the next."""
    chosen = {number: joint for number, joint in joints.items() if joint.holds_at(0.0)}
    linked = {link for joint in chosen.values() for link in _links_of(joint, robot)}
    later = {number: joint for number, joint in joints.items() if number not in chosen}
    for number in sorted(later, key=lambda number: _beginning(later[number])):
        if linked.isdisjoint(links := _links_of(later[number], robot)):
            linked |= links
            chosen[number] = later[number]
    return dict(sorted(chosen.items()))


def _links_of(joint: JointSpec, robot: str) -> set[str]:
    """The links of a robot that a joint connects."""
    return {body.tip for body in (joint.first, joint.second) if body.robot == robot}


def _beginning(joint: JointSpec) -> float:
    """When a joint takes hold first, as far as times say [s]."""
    begins = (interval.begin for interval in joint.intervals)
    return min((begin for begin in begins if isinstance(begin, float)), default=math.inf)


def _shown_second(joint: JointSpec) -> str:
    """The body on which a joint has its place, as messages have it."""
    return "the object" if joint.second.is_object else shown(str(joint.second))


def _pose_of_link(
    arms: Mapping[str, Robot], postures: Mapping[str, np.ndarray], body: BodyName
) -> np.ndarray:
    """Pose (4, 4) of a link of a robot, at its posture."""
    return arms[body.robot].tip_pose(postures[body.robot], body.tip)


def _search_of(
    scene: Scene,
    joints: list[JointSpec],
    arm: Robot,
    resolved: ResolvedRobot,
    at_rest: Callable[[BodyName], np.ndarray],
) -> Search | None:
    """The search for the posture of a robot with joints that have places.

    ``at_rest`` gives the poses of other robots' links.  None where its posture is not asked for,
    and the written one leaves gaps that assembly closes.
    """
    wanted = posture_of(scene, arm.name)[1] == SOLVE
    alone = "" in arm.tips and not arm.floats
    if alone and len(joints) == 1 and joints[0].second.is_object:
        wanted = wanted or _is_far(scene, joints[0], arm, resolved.posture)
        return PostureSearch.of_joint(scene, joints[0], arm) if wanted else None
    search = RobotPostureSearch.of_robot(scene, joints, arm, resolved, at_rest)
    gaps = search.distances(resolved.posture)
    listed = {joint.connection for joint in joints if joint.as_listed}  # may be anywhere
    far = any(gap > NEAR * search.longest for name, gap in gaps.items() if name not in listed)
    return search if wanted or far else None


def _out_of_the_way(
    scene: Scene,
    arms: Mapping[str, Robot],
    searches: Mapping[str, Search],
    postures: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Postures of the robots of ``searches``, with others where links overlap what is around them.

    A robot that has no better posture keeps the one that it has; a warning of the start names it.
    """
    surroundings = Surroundings(scene, arms)
    for _ in range(ROUNDS):
        for name, search in searches.items():
            obstacles = surroundings.obstacles(name, postures)
            distance = partial(_distance, surroundings, name, obstacles)
            if distance(postures[name]) < -OVERLAP:
                posture = search.best(partial(_keeps_off, distance))
                postures[name] = postures[name] if posture is None else posture
    return {name: postures[name] for name in searches}


def _distance(
    surroundings: Surroundings, name: str, obstacles: Placed, posture: np.ndarray
) -> float:
    return surroundings.nearest(name, posture, obstacles).distance


def _keeps_off(distance: Callable[[np.ndarray], float], posture: np.ndarray) -> bool:
    return distance(posture) >= KEEPS_OFF


def overlapping_links(
    scene: Scene, arms: Mapping[str, Robot], postures: Mapping[str, np.ndarray]
) -> dict[str, NearestPair]:
    """Of robots whose posture is left to the program, the link that overlaps an obstacle most."""
    left_open = [name for name in arms if posture_of(scene, name)[1] in (None, SOLVE)]
    if not left_open:
        return {}
    surroundings, overlaps = Surroundings(scene, arms), {}
    for name in left_open:
        pair = surroundings.nearest(name, postures[name], surroundings.obstacles(name, postures))
        if pair.distance < -OVERLAP:
            overlaps[name] = pair
    return overlaps


def _is_far(scene: Scene, joint: JointSpec, arm: Robot, posture: np.ndarray) -> bool:
    """Whether a posture leaves a gap in the joint that no assembly would close."""
    if joint.as_listed:  # its contacts may be anywhere
        return False
    on_tip, place = joint_places(scene, joint)
    frame = arm.tip_pose(posture) @ on_tip
    gap = place[:3, :3].T @ (frame[:3, 3] - place[:3, 3])
    gap[[k for k in joint.free or () if k < 3]] = 0.0
    return bool(np.linalg.norm(gap) > NEAR * np.max(arm.levers(on_tip[:3, 3])))
