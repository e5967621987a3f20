"""Several arms on one trunk: which arms of a scene are one machine, and what they must agree on.

Arms of one file on one base are one machine, since two cannot stand in one place.  Each moves the
joints on the way to its tip.  Those of the trunk are on the way to several tips.  Where all arms
lock them, the arms are simulated one by one; where none does, as one robot whose tips have the
names of the arms.  A position at which one arm locks a joint that no arm moves, such as the neck,
is that of the whole.

Arms whose way contains that of another stand alone: a mechanism may have two equal
chains on one pivot.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multiarm.scene.arms import ArmSpec
from multiarm.scene.code import nodes
from multiarm.scene.faults import Parts, listed
from multiarm.scene.joint_values import SOLVE
from multiarm.scene.resolution import Examination, resting_warning
from multiarm.scene.robot_spec import RobotBaseSpec, RobotSpec

Arms = Mapping[str, ArmSpec]
Examinations = Mapping[str, Examination]


@dataclass(frozen=True)
class ArmGroup:
    """Arms of one file on one base; an arm that stands alone is a group by itself.

    Attributes
    ----------
    arms : tuple of str
        In the order of the scene.
    lock : dict of str to float
        Of several arms, joints that one locks and none moves: their positions [rad] or [m].
    robot : RobotSpec or None
        The arms as one robot, with tips of their names, where they have a trunk that moves.
    joints : dict of str to tuple of str
        Moving joints of each arm, from base to tip.
    """

    arms: tuple[str, ...]
    lock: dict[str, float]
    robot: RobotSpec | None = None
    joints: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """That of the robot, under which results have its joints."""
        return "_and_".join(self.arms)


def arm_groups(arms: Arms, examinations: Examinations) -> tuple[ArmGroup, ...]:
    """The groups to which the arms belong."""
    groups: list[list[str]] = []
    for name in arms:
        joined = [
            group
            for group in groups
            if all(_same_machine(name, peer, arms, examinations) for peer in group)
        ]
        if joined:
            joined[0].append(name)
        else:
            groups.append([name])
    return tuple(_group(group, arms, examinations) for group in groups)


def _group(names: list[str], arms: Arms, examinations: Examinations) -> ArmGroup:
    joints = {name: examinations[name].joint_names or () for name in names}
    lock = _lock(names, arms, examinations)
    if not _trunk(joints):
        return ArmGroup(tuple(names), lock, None, joints)
    return ArmGroup(tuple(names), lock, _robot(names, joints, lock, arms, examinations), joints)


def _trunk(joints: Mapping[str, tuple[str, ...]]) -> list[str]:
    """The joints that several arms move."""
    counts = Counter(joint for names in joints.values() for joint in names)
    return [joint for joint, count in counts.items() if count > 1]


def _robot(
    names: list[str],
    joints: Mapping[str, tuple[str, ...]],
    lock: dict[str, float],
    arms: Arms,
    examinations: Examinations,
) -> RobotSpec | None:
    """The arms as one robot; None where they do not agree, or have tools or faults."""
    ours = [arms[name] for name in names]
    resolved = [examinations[name].resolved for name in names]
    if any(arm.tool is not None for arm in ours) or any(found is None for found in resolved):
        return None
    moved = {joint for of_arm in joints.values() for joint in of_arm}
    if any(joint in arm.lock for arm in ours for joint in _trunk(joints)):
        return None
    first = ours[0]
    base = {key: getattr(first.base, key) for key in ("xyz", "rpy", "quaternion_xyzw")}
    return RobotSpec(
        robot=first.robot,
        urdf=first.urdf,
        mjcf=first.mjcf,
        package_dirs=tuple(dict.fromkeys(path for arm in ours for path in arm.package_dirs)),
        base=RobotBaseSpec(**{key: base[key] for key in first.base.model_fields_set & base.keys()}),
        tips={name: found.tip for name, found in zip(names, resolved, strict=True) if found},
        lock=lock | {j: q for arm in ours for j, q in arm.lock.items() if j not in moved},
        posture=_merged("posture", names, joints, arms),
        velocity=_merged("velocity", names, joints, arms),
        passive=tuple(dict.fromkeys(joint for arm in ours for joint in arm.passive)),
        color=next((arm.color for arm in ours if arm.color is not None), None),
    )


def _by_joint(values: Any, joints: tuple[str, ...]) -> dict[str, float]:
    """Values of an arm, a list from base to tip or a table, as a table; empty where none."""
    if values is None or values == SOLVE:
        return {}
    return dict(values) if isinstance(values, Mapping) else dict(zip(joints, values, strict=True))


def _merged(key: str, names: list[str], joints: Mapping[str, tuple[str, ...]], arms: Arms) -> Any:
    """Positions or velocities of all arms."""
    written = {name: getattr(arms[name], key) for name in names}
    if SOLVE in written.values():
        return SOLVE
    tables = [_by_joint(values, joints[name]) for name, values in written.items()]
    merged = {joint: value for table in tables for joint, value in table.items()}
    return merged or None


def _same_machine(name: str, second: str, arms: Arms, examinations: Examinations) -> bool:
    ours, theirs = examinations[name], examinations[second]
    ways = set(ours.way), set(theirs.way)
    if ours.urdf != theirs.urdf or ways[0] <= ways[1] or ways[1] <= ways[0]:
        return False
    if arms[name].open_base or arms[second].open_base:  # each is found by itself
        return False
    return np.allclose(arms[name].base.matrix(), arms[second].base.matrix(), rtol=0.0, atol=1e-9)


def _lock(group: list[str], arms: Arms, examinations: Examinations) -> dict[str, float]:
    if len(group) == 1:
        return {}
    moved = {joint for name in group for joint in examinations[name].joint_names or ()}
    fixed = examinations[group[0]].robot_joints - moved
    return {j: q for name in group for j, q in arms[name].lock.items() if j in fixed}


def group_faults(
    group: ArmGroup, arms: Arms, examinations: Examinations
) -> Iterator[tuple[Parts, str]]:
    """Joints that several arms would move, or that they lock at different positions."""
    for k, name in enumerate(group.arms):
        for second in group.arms[:k]:
            ours, theirs = arms[name].lock, arms[second].lock
            who = f"arms {second!r} and {name!r} are one machine (of one file, on one base)"
            trunk = [joint for joint in examinations[name].way if joint in examinations[second].way]
            loose = [joint for joint in trunk if joint not in ours or joint not in theirs]
            agree = not any(joint in ours or joint in theirs for joint in loose)
            faulty = any(examinations[arm].faults for arm in group.arms)
            if loose and group.robot is None and not (agree and faulty):
                with_tools = [arm for arm in group.arms if arms[arm].tool is not None]
                tools = f", without the tool of {listed(with_tools)}" if with_tools else ""
                held = ", ".join(f"{j}: {ours.get(j, theirs.get(j, 0.0)):g}" for j in loose)
                yield (
                    ("arms", name),
                    f"{who}, and both tips hang on {listed(loose)}: hold such joints fixed in both "
                    f"arms, lock: {{{held}}}, or let them move in both, as one robot{tools}; or "
                    "give two robots different bases",
                )
            for joint in group.lock:
                q = ours.get(joint), theirs.get(joint)
                if None not in q and q[0] != q[1]:
                    yield (
                        ("arms", name, "lock", joint),
                        f"{who}, but {second!r} locks {joint!r} at {q[1]:g}, {name!r} at {q[0]:g}; "
                        "write one position",
                    )


def one_robot_faults(
    group: ArmGroup, arms: Arms, parts: Mapping[str, Any]
) -> Iterator[tuple[Parts, str]]:
    """What arms on a trunk that moves cannot say for themselves.

    ``parts`` are further parts of the scene, control and effects, by their keys.
    """
    if group.robot is None:
        return
    who = f"arms {listed(group.arms)} move on one trunk and are one robot"
    remedy = _as_written_robot(group, arms)
    for key in ("posture", "velocity"):
        written = {name: getattr(arms[name], key) for name in group.arms}
        values: dict[str, float] = {}
        for name, value in written.items():
            if value != SOLVE and SOLVE in written.values() and value is not None:
                text = f"{who}, of which either all or no postures are sought; write 'solve' in all"
                yield ("arms", name, key), text
                continue
            for joint, q in _by_joint(value, group.joints[name]).items():
                if values.setdefault(joint, q) != q:
                    yield (
                        ("arms", name, key),
                        f"{who}, but {joint!r} is written as {values[joint]:g} and as {q:g}; "
                        "write one number",
                    )
    for key, part in parts.items():
        named = {
            name: (key, *where)
            for where, leaf in nodes(part)
            for name in group.arms
            if name in where or (isinstance(leaf, str) and leaf.partition("/")[0] == name)
        }
        for name, where in named.items():
            yield where, f"{who}, which has no numbers of arm {name!r} alone; {remedy}"


def _as_written_robot(group: ArmGroup, arms: Arms) -> str:
    """The remedy to write the arms of a group as one robot."""
    assert group.robot is not None, "the arms are one robot"
    first, tips = arms[group.arms[0]], group.robot.tips
    key = "robot" if first.file is None else "mjcf" if first.mjcf is not None else "urdf"
    links = ", ".join(f"{name}: {link}" for name, link in tips.items())
    names = " and ".join(f"'arm: NAME/{name}'" for name in group.arms)
    return (
        f"write the robot, robots: {{NAME: {{{key}: {first.robot or first.file}, base: ..., tips: "
        f"{{{links}}}}}}}, with {names} in the joints, and numbers of NAME"
    )


def group_warnings(
    group: ArmGroup, arms: Arms, examinations: Examinations
) -> Iterator[tuple[Parts, str]]:
    """The warnings about its arms; a text that several arms share comes once."""
    if group.robot is not None:
        yield (
            ("arms",),
            f"{listed(group.arms)} are one machine (of one file, on one base), whose trunk moves "
            f"by {listed(_trunk(group.joints))}: they are simulated as robot {group.name!r}, by "
            "which results have their joints; lock the trunk in all of them to have arms",
        )
    texts: set[str] = set()
    for name in group.arms:
        for text in _arm_warnings(name, group, arms, examinations):
            if text not in texts:
                yield ("arms", name), text
            texts.add(text)


def _arm_warnings(
    name: str, group: ArmGroup, arms: Arms, examinations: Examinations
) -> Iterator[str]:
    examination, first = examinations[name], name == group.arms[0]
    for peer in group.arms:
        moving = examinations[peer].joint_names or ()
        moved = [joint for joint in moving if joint in arms[name].lock]
        if moved and peer != name:
            yield f"'lock' has no effect on {listed(moved)}, which arm {peer!r} moves"
    resting = {
        joint: q
        for joint, q in examination.resting.items()
        if joint not in examination.robot_joints  # a tool's
        or (first and all(joint in examinations[peer].resting for peer in group.arms))
    }
    if resting:
        yield resting_warning(resting, "not on the way to the tip")
    yield from examination.warnings
