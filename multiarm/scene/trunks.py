"""Robots with several arms: which arms of a scene are one robot, and what they must agree on.

Arms of one file on one base are one robot, since two robots cannot stand in one place.  Each moves
the joints on the way to its tip; those of the trunk, which are on the way to several tips, must be
locked.  A position at which one arm locks a joint that no arm moves, such as the neck, is the
robot's.

Arms whose way contains that of another are robots of their own: a mechanism may have two equal
chains on one pivot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from multiarm.scene.arms import ArmSpec, Examination
from multiarm.scene.faults import Parts, counted, listed

Arms = Mapping[str, ArmSpec]
Examinations = Mapping[str, Examination]


@dataclass(frozen=True)
class Robot:
    """A robot of a scene.

    Attributes
    ----------
    arms : tuple of str
        In the order of the scene.
    lock : dict of str to float
        Of several arms, joints that one locks and none moves: their positions [rad] or [m].
    """

    arms: tuple[str, ...]
    lock: dict[str, float]


def robots_of(arms: Arms, examinations: Examinations) -> tuple[Robot, ...]:
    """The robots to which the arms belong."""
    groups: list[list[str]] = []
    for name in arms:
        joined = [
            group
            for group in groups
            if all(_same_robot(name, peer, arms, examinations) for peer in group)
        ]
        if joined:
            joined[0].append(name)
        else:
            groups.append([name])
    return tuple(Robot(tuple(group), _lock(group, arms, examinations)) for group in groups)


def _same_robot(name: str, second: str, arms: Arms, examinations: Examinations) -> bool:
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


def robot_faults(
    robot: Robot, arms: Arms, examinations: Examinations
) -> Iterator[tuple[Parts, str]]:
    """Joints that several arms would move, or that they lock at different positions."""
    for k, name in enumerate(robot.arms):
        for second in robot.arms[:k]:
            ours, theirs = arms[name].lock, arms[second].lock
            who = f"arms {second!r} and {name!r} are one robot (of one file, on one base)"
            trunk = [joint for joint in examinations[name].way if joint in examinations[second].way]
            loose = [joint for joint in trunk if joint not in ours or joint not in theirs]
            if loose:
                held = ", ".join(f"{j}: {ours.get(j, theirs.get(j, 0.0)):g}" for j in loose)
                yield (
                    ("arms", name),
                    f"{who}, and both tips hang on {listed(loose)}: hold such joints fixed in both "
                    f"arms, lock: {{{held}}}; or give two robots different bases",
                )
            for joint in robot.lock:
                q = ours.get(joint), theirs.get(joint)
                if None not in q and q[0] != q[1]:
                    yield (
                        ("arms", name, "lock", joint),
                        f"{who}, but {second!r} locks {joint!r} at {q[1]:g}, {name!r} at {q[0]:g}; "
                        "write one position",
                    )


def robot_warnings(
    robot: Robot, arms: Arms, examinations: Examinations
) -> Iterator[tuple[Parts, str]]:
    """The warnings about its arms; a text that several arms share comes once."""
    texts: set[str] = set()
    for name in robot.arms:
        for text in _arm_warnings(name, robot, arms, examinations):
            if text not in texts:
                yield ("arms", name), text
            texts.add(text)


def _arm_warnings(name: str, robot: Robot, arms: Arms, examinations: Examinations) -> Iterator[str]:
    examination, first = examinations[name], name == robot.arms[0]
    for peer in robot.arms:
        moving = examinations[peer].joint_names or ()
        moved = [joint for joint in moving if joint in arms[name].lock]
        if moved and peer != name:
            yield f"'lock' has no effect on {listed(moved)}, which arm {peer!r} moves"
    resting = {
        joint: q
        for joint, q in examination.resting.items()
        if joint not in examination.robot_joints  # a tool's
        or (first and all(joint in examinations[peer].resting for peer in robot.arms))
    }
    if resting:
        positions = [f"{joint}: {q:g}" for joint, q in resting.items()]
        yield (
            f"joints that are not on the way to the tip are locked at {{{counted(positions, 4)}}}; "
            "'lock' chooses other positions"
        )
    yield from examination.warnings
