"""Trees as branches, and branches in lanes.

A *branch* is a run of joints along which a tree does not divide.  Branches that begin equally far
from the base, counted in branches, are independent of each other; so four of them, of one robot or
of several, are computed at once, one in each lane of a SIMD pack.  So are branches from which
equally many follow one after the other: whichever makes shorter blocks decides for a robot.  The
legs of a humanoid share a block with its arms then, and not with its waist.  Four branches are a
*block*.  A
*group* is what is swept outwards as a whole before it is swept inwards: the branches of up to four
robots, or one block of *plain arms*: chains whose last link is the only one that takes part in
connections.

A floating base is a branch by itself, and the robots of a group have floating bases all or none.
The first block of a group with floating bases is that of these bases.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.jit.simd import LANES
from multiarm.robots.terms import TreeStructure

FLOATING_BASE = 0
"""The joint of a floating base."""


class Branch(NamedTuple):
    """Joints of a robot, counted from 0, each the only one after that before it."""

    robot: int
    joints: tuple[int, ...]
    ancestors: tuple[int, ...]  # the joints between base and branch
    level: int  # number of branches before it; a floating base is one

    @property
    def parent(self) -> int:
        """The joint after which it begins; -1: none."""
        if self.ancestors:
            return self.ancestors[-1]
        return FLOATING_BASE if self.level > 0 else -1


class Group(NamedTuple):
    """Blocks of branches, those that others begin at first."""

    blocks: tuple[tuple[Branch, ...], ...]
    plain: bool  # whether its only block is one of plain arms
    floats: bool = False  # whether its first block is one of floating bases


def branches_of(robot: int, parents: np.ndarray, base_floats: bool = False) -> list[Branch]:
    """The branches of a robot, each after that from which it begins."""
    children = np.bincount(parents[parents >= 0], minlength=parents.size)
    branches: list[Branch] = []
    of_joint: list[int] = []  # the branch of each joint
    for joint, parent in enumerate(parents.tolist()):
        after_base = base_floats and parent == FLOATING_BASE
        if parent >= 0 and children[parent] == 1 and not after_base:
            number = of_joint[parent]
            branch = branches[number]
            branches[number] = branch._replace(joints=(*branch.joints, joint))
        else:
            before = branches[of_joint[parent]] if parent >= 0 else Branch(robot, (), (), -1)
            ancestors = () if after_base else (*before.ancestors, *before.joints)
            number = len(branches)
            branches.append(Branch(robot, (joint,), ancestors, before.level + 1))
        of_joint.append(number)
    return branches


def most_in_a_row(parents: np.ndarray) -> int:
    """Number of joints on the longest way from the base to a link."""
    depth: list[int] = []
    for parent in parents.tolist():
        depth.append(1 + (depth[parent] if parent >= 0 else 0))
    return max(depth)


def make_groups(
    structures: Sequence[TreeStructure], carriers: Sequence[Sequence[int]]
) -> list[Group]:
    """Groups of all robots, plain ones first.

    ``carriers`` are each robot's joints, counted from 0, whose links take part in connections.
    """
    branches = [
        branches_of(k, robot.parents, robot.base_floats) for k, robot in enumerate(structures)
    ]
    joints = [robot.parents.size for robot in structures]
    is_plain = [
        len(branches[k]) == 1 and list(carriers[k]) == [joints[k] - 1] and not robot.base_floats
        for k, robot in enumerate(structures)
    ]
    plain = sorted(np.flatnonzero(is_plain).tolist(), key=lambda robot: -joints[robot])
    groups = [
        Group((tuple(branches[robot][0] for robot in four),), plain=True) for four in _fours(plain)
    ]
    # those alike side by side, so that their branches share blocks
    trees = sorted(
        np.flatnonzero(np.logical_not(is_plain)).tolist(),
        key=lambda robot: (-joints[robot], structures[robot].parents.tolist()),
    )
    for floats in (False, True):
        for four in _fours([robot for robot in trees if structures[robot].base_floats == floats]):
            together = [placed for robot in four for placed in _at_levels(branches[robot])]
            groups.append(Group(_blocks(together), plain=False, floats=floats))
    return groups


def _at_levels(branches: Sequence[Branch]) -> list[tuple[int, Branch]]:
    """The branches of a robot, each with its level, at which it is computed.

    It does not depend on other robots, so that sums over branches do not.
    """
    first = [(branch.level, branch) for branch in branches]
    deepest, last = max(branch.level for branch in branches), []
    for branch in branches:
        after = [x.level for x in branches if branch.joints[-1] in x.ancestors]
        beyond = max(after, default=branch.level) - branch.level
        last.append((deepest - beyond if branch.level > 0 else 0, branch))
    return min(first, last, key=lambda placed: _length(_blocks(placed)))


def _blocks(placed: Sequence[tuple[int, Branch]]) -> tuple[tuple[Branch, ...], ...]:
    """Blocks of the branches at each level, long ones first."""
    blocks: list[tuple[Branch, ...]] = []
    for level in range(max(level for level, _ in placed) + 1):
        at_level = [branch for number, branch in placed if number == level]
        blocks += _fours(sorted(at_level, key=lambda branch: -len(branch.joints)))
    return tuple(map(tuple, blocks))


def _length(blocks: Sequence[Sequence[Branch]]) -> int:
    """Joints of all blocks, each as long as the longest of its branches."""
    return sum(max(len(branch.joints) for branch in block) for block in blocks)


def _fours(items: Sequence) -> list:
    return [items[k : k + LANES] for k in range(0, len(items), LANES)]
