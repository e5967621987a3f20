"""Whether the joints of a scene connect bodies that exist, and that can be connected.

A connection is the set of contact rows between two bodies, the first and the second: a joint.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Any

from multiarm.scene.bodies import (
    WORLD,
    BodyName,
    body_named,
    connection_name,
    object_named,
    tip_named,
)
from multiarm.scene.faults import Parts, listed, shown, unknown
from multiarm.scene.joint_values import KnownRobot
from multiarm.scene.values import floor_owner

Robots = Mapping[str, KnownRobot]
Faults = Iterator[tuple[Parts, str]]


@dataclass(frozen=True)
class WrittenJoint:
    """What a joint connects, as it is written, valid or not; None where it is not written."""

    arm: Any
    object: Any
    between: Any
    name: Any
    objects: tuple[str, ...]  # names of the scene's objects

    @classmethod
    def of(cls, joint: Any, objects: tuple[str, ...]) -> WrittenJoint:
        """That of a joint, or of the table that is to be one."""
        read = joint.get if isinstance(joint, Mapping) else lambda key: getattr(joint, key, None)
        arm = read("arm")
        written = not isinstance(arm, str) or bool(arm)
        names = read("object"), read("between"), read("name")
        return cls(arm if written else None, *names, objects)

    @property
    def two_bodies(self) -> tuple[str, str] | None:
        """``between`` where it is two names."""
        names = self.between
        if not isinstance(names, (list, tuple)) or len(names) != 2:
            return None
        return (names[0], names[1]) if all(isinstance(name, str) for name in names) else None

    @property
    def bodies(self) -> tuple[BodyName, BodyName] | None:
        """The first and the second; None where it does not say so."""
        if self.between is None:
            if not isinstance(self.arm, str):
                return None
            name = self.object if isinstance(self.object, str) else self.objects[0]
            return tip_named(self.arm), object_named(name)
        if self.two_bodies is None or self.arm is not None:
            return None
        first, second = self.two_bodies
        return body_named(first, self.objects), body_named(second, self.objects)

    @property
    def connection(self) -> str | None:
        """Its name in results; None where the bodies are not known."""
        if self.bodies is None:
            return None
        name = self.name if isinstance(self.name, str) else None
        return connection_name(self.arm or "", self.two_bodies, name)


def links_of(robot: str, joints: Sequence[WrittenJoint], tips: Mapping[str, str]) -> list[str]:
    """The links of a robot that joints name besides its tips, each once, in the scene's order."""
    bodies = [body for joint in joints for body in joint.bodies or ()]
    names = (body.tip for body in bodies if body.robot == robot)
    return list(dict.fromkeys(name for name in names if name and name not in tips))


def connection_faults(
    joints: Sequence[WrittenJoint] | None, robots: Robots, objects_known: bool = True
) -> Faults:
    """Faults of what the joints connect: their places in the scene, and texts.

    What they name as an object is looked at where the scene's objects are known.
    """
    for k, joint in enumerate(joints or ()):
        yield from _joint_faults(joint, ("joints", k), robots, objects_known)
    yield from _name_faults(joints or (), robots)
    if joints is None or any(joint.bodies is None for joint in joints):
        return
    joined = {body.robot for joint in joints for body in joint.bodies or ()}
    for name, robot in robots.items():
        if robot.tips is None and name not in joined:
            yield (
                ("joints",),
                f"arm {name!r} is connected by no joint; add one, such as "
                f"{{arm: {name}, kind: weld}}, or remove the arm",
            )


def idle_tips(
    name: str, robot: KnownRobot, joints: Sequence[WrittenJoint], named: AbstractSet[str]
) -> dict[str, list[str]]:
    """The tips of a robot that nothing in the scene uses, and the joints that move for them alone.

    ``named`` are names that control and effects mention, of joints, and of links as ``robot/link``.
    """
    tips, bodies = robot.tips or {}, {body for joint in joints for body in joint.bodies or ()}
    in_joints = {body.tip for body in bodies if body.robot == name}
    used = [
        end
        for end in robot.ways
        if not in_joints.isdisjoint({end, tips.get(end, end)})
        or not named.isdisjoint({f"{name}/{end}", f"{name}/{tips.get(end, end)}"})
    ]
    moved = {joint for end in used for joint in robot.ways[end]}
    alone = {tip: [j for j in robot.ways.get(tip, ()) if j not in moved] for tip in tips}
    return {
        tip: joints_of_tip
        for tip, joints_of_tip in alone.items()
        if tip not in used and named.isdisjoint(joints_of_tip)
    }


def _name_faults(joints: Sequence[WrittenJoint], robots: Robots) -> Faults:
    """Joints with the name of another joint, of a robot or of a floor: results have them by name.

    The joint of an arm, ``arm: NAME``, has the arm's.
    """
    of_bodies = [
        joint
        for joint in joints
        if joint.bodies is not None
        and all(body.robot in robots or not body.is_link for body in joint.bodies)
    ]
    names = Counter(
        joint.connection
        for joint in of_bodies
        if joint.between is None or joint.connection not in robots
    )
    tips = {joint.arm for joint in of_bodies if joint.between is None}
    objects = joints[0].objects if joints else ()
    floors = [floor_owner(name, objects) for name in objects]
    for name, count in names.items():
        if count == 1:
            continue
        if name in tips:
            noun = "arm" if name in robots else "tip"
            yield (
                ("joints",),
                f"{noun} {name!r} has {count} joints; one joint per {noun} is possible, list "
                "their contacts in one joint of kind 'contacts', or write the others as "
                f"'between: [{name}, {objects[0]}]'",
            )
        else:
            yield (
                ("joints",),
                f"{count} joints have the name {name!r}; give all but one a 'name' of their own",
            )
    for k, joint in enumerate(joints):
        connection = joint.connection
        if joint.between is None or connection is None:
            continue
        if connection in floors:
            text = f"no joint can be named {connection!r}: results have the floor's forces there"
            yield ("joints", k, "name"), text
        elif connection in robots:
            noun = "arm" if robots[connection].tips is None else "robot"
            text = (
                f"the joint has the name of {noun} {connection!r}, under which results have "
                f"what belongs to the {noun}; give it another 'name'"
            )
            yield ("joints", k, "name"), text


def _joint_faults(joint: WrittenJoint, where: Parts, robots: Robots, objects_known: bool) -> Faults:
    """Faults of the bodies of one joint."""
    if joint.between is None:
        if joint.arm is not None:
            text = _arm_fault(joint, robots)
            if text:
                yield (*where, "arm"), text
            if objects_known:
                yield from _object_faults(joint, where)
        return
    if joint.bodies is None or not objects_known:
        return
    texts = [_body_fault(body, robots, joint.objects) for body in joint.bodies]
    for k, text in enumerate(texts):
        if text:
            yield (*where, "between", k), text
    if not any(texts):
        text = _pair_fault(*joint.bodies, robots)
        if text:
            yield (*where, "between"), text


def _object_faults(joint: WrittenJoint, where: Parts) -> Faults:
    """Why it is not known which object a tip holds."""
    if joint.object is None and len(joint.objects) > 1:
        text = f"needs 'object', the one that the tip holds; objects are {listed(joint.objects)}"
        yield where, text
    elif isinstance(joint.object, str) and joint.object not in joint.objects:
        yield (*where, "object"), unknown("object", joint.object, joint.objects)


def _names_of_tips(robots: Robots) -> list[str]:
    """How joints name the tips of all arms and robots."""
    tips = {name: ("",) if robot.tips is None else robot.tips for name, robot in robots.items()}
    return [str(BodyName(name, tip)) for name, of_robot in tips.items() for tip in of_robot]


def _arm_fault(joint: WrittenJoint, robots: Robots) -> str:
    """Why ``arm`` names no tip; empty where it does."""
    name = joint.arm
    tips = _names_of_tips(robots)
    if isinstance(name, str) and name in tips:
        return ""
    body = tip_named(name) if isinstance(name, str) else BodyName("", "")
    robot = robots.get(body.robot)
    if robot is None:
        with_tips = any(robot.tips is not None for robot in robots.values())
        if with_tips:
            return unknown("arm or tip", name, tips, "arms and tips")
        return unknown("arm", name, tips)
    if robot.tips is None:
        return f"arm {body.robot!r} has one tip and is named alone, 'arm: {body.robot}'"
    return _tip_fault(body, robot, links=f"write 'between: [{name}, {joint.objects[0]}]'")


def _body_fault(body: BodyName, robots: Robots, objects: Sequence[str]) -> str:
    """Why there is no such body; empty where there is."""
    if not body.is_link:
        known = body == WORLD or body.tip in objects
        return "" if known else f"{shown(str(body))} names no body"
    robot = robots.get(body.robot)
    if robot is None:
        bodies = [*objects, str(WORLD), *_names_of_tips(robots)]
        return unknown("body", str(body), bodies, "bodies")
    if robot.tips is None:
        if not body.tip:
            return ""
        return (
            f"arm {body.robot!r} has one tip and is named alone, {body.robot!r}; to join its link "
            f"{body.tip!r}, write the arm as a robot, below 'robots', with tips"
        )
    return _tip_fault(body, robot)


def _tip_fault(body: BodyName, robot: KnownRobot, links: str = "") -> str:
    """Why a robot has no such tip, or link; where ``links`` says what to do, links are none."""
    assert robot.tips is not None, "an arm has no tips by name"
    if not body.tip:
        choices = [str(BodyName(body.robot, tip)) for tip in robot.tips]
        if choices:
            return f"{body.robot!r} is a robot; name one of its tips, {listed(choices)}"
        return (
            f"{body.robot!r} is a robot without tips; write some, 'tips: {{hand: LINK}}', and name "
            f"one, '{body.robot}/hand'"
        )
    if body.tip in robot.tips or robot.links is None:  # without links, the robot has faults
        return ""
    if body.tip in robot.links:
        text = f"{body.tip!r} is a link of {body.robot!r} and no tip; {links}, or "
        return f"{text}name the link below 'tips'" if links else ""
    if links:
        return unknown("tip", body.tip, robot.tips)
    known = [*robot.tips, *robot.links]
    return unknown("tip or link", body.tip, known, "tips and links", robot.shown_by)


def _pair_fault(first: BodyName, second: BodyName, robots: Robots) -> str:
    """Why two bodies that exist cannot be connected; empty where they can."""
    if first == second:
        return f"a joint connects two bodies, got {str(first)!r} twice"
    for body in (first, second):
        if body.is_link and _rests(body, robots):
            return f"no joint that moves carries {str(body)!r}; write 'world' in its place"
    if first == WORLD or (first.is_object and second.is_link):
        return (
            f"{str(first)!r} can only be the second body; write between: [{second}, {first}], with "
            "'at' and 'at_first' exchanged"
        )
    if not (first.is_link and second.is_link) or first.robot != second.robot:
        return ""
    carriers = [_carrier(body, robots) for body in (first, second)]
    if carriers[0] is not None and carriers[0] == carriers[1]:
        return (
            f"{str(first)!r} and {str(second)!r} are parts of one rigid body, which joint "
            f"{carriers[0]!r} moves; name two links that a joint moves against each other"
        )
    return ""


def _carrier(body: BodyName, robots: Robots) -> str | None:
    """The last joint that moves a link of a robot; None where it is not known, or there is none."""
    robot = robots[body.robot]
    return robot.carriers.get((robot.tips or {}).get(body.tip, body.tip))


def _rests(body: BodyName, robots: Robots) -> bool:
    """Whether it is known that nothing moves the link."""
    robot = robots[body.robot]
    return robot.tips is not None and robot.joints is not None and _carrier(body, robots) is None
