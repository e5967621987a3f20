"""Several arms on one trunk: which arms of a scene are one machine, and what they must agree on.

Arms of one file on one base are one machine, since two cannot stand in one place.  Each moves the
joints on the way to its tip; those of the trunk, which are on the way to several tips, must be
locked, or the arms written as one robot with several tips.  A position at which one arm locks a
joint that no arm moves, such as the neck, is that of the whole.

Arms whose way contains that of another stand alone: a mechanism may have two equal
chains on one pivot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from multiarm.scene.arms import ArmSpec
from multiarm.scene.faults import Parts, listed
from multiarm.scene.resolution import Examination, resting_warning

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
    """

    arms: tuple[str, ...]
    lock: dict[str, float]


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
    return tuple(ArmGroup(tuple(group), _lock(group, arms, examinations)) for group in groups)


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
            if loose:
                held = ", ".join(f"{j}: {ours.get(j, theirs.get(j, 0.0)):g}" for j in loose)
                yield (
                    ("arms", name),
                    f"{who}, and both tips hang on {listed(loose)}: hold such joints fixed in both "
                    f"arms, lock: {{{held}}}; {_as_one_robot(group, arms, examinations)}or give "
                    "two robots different bases",
                )
            for joint in group.lock:
                q = ours.get(joint), theirs.get(joint)
                if None not in q and q[0] != q[1]:
                    yield (
                        ("arms", name, "lock", joint),
                        f"{who}, but {second!r} locks {joint!r} at {q[1]:g}, {name!r} at {q[0]:g}; "
                        "write one position",
                    )


def _as_one_robot(group: ArmGroup, arms: Arms, examinations: Examinations) -> str:
    """The remedy to write the arms of a group as one robot; empty where they have tools."""
    if any(arms[name].tool is not None for name in group.arms):
        return ""
    first = arms[group.arms[0]]
    key = "robot" if first.file is None else "mjcf" if first.mjcf is not None else "urdf"
    ends = {
        name: resolved.tip if (resolved := examinations[name].resolved) else arms[name].tip
        for name in group.arms
    }
    tips = ", ".join(f"{name}: {link}" for name, link in ends.items())
    names = " and ".join(f"'arm: NAME/{name}'" for name in group.arms)
    return (
        f"or let them move, as one robot, robots: {{NAME: {{{key}: {first.robot or first.file}, "
        f"base: ..., tips: {{{tips}}}}}}}, with {names} in the joints; "
    )


def group_warnings(
    group: ArmGroup, arms: Arms, examinations: Examinations
) -> Iterator[tuple[Parts, str]]:
    """The warnings about its arms; a text that several arms share comes once."""
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
