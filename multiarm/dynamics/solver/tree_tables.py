"""Tables of blocks whose joints are trees that divide.

See :mod:`multiarm.dynamics.solver.trees`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from multiarm.jit.kernels import plain
from multiarm.jit.rows import Number, offset_of, row_of, width
from multiarm.jit.simd import LANES, aligned_zeros
from multiarm.jit.structs import Floats1, Floats2, Ints1, Ints2
from multiarm.robots.terms import JointFactor


class TreeBlock(NamedTuple):
    """A block: a row of ``Trees.block``."""

    block: Number
    first: Number  # of its joints in the arrays of joints
    runs: Number  # the first of its runs
    end: Number  # of its runs
    left: Number  # packs of a row for the right-hand side and the way of a joint
    table: Number  # first pack of its joints' rows
    contacts: Number  # first pack of its contacts' rows
    vector: Number  # first pack of its vectors of contacts
    factors: Number  # address of the factors of its inertia; 0: it is eliminated by its entries


open_tree = row_of(TreeBlock)


class Trees(NamedTuple):
    """The ``t`` blocks whose joints are trees that divide, with ``J`` joints together.

    The row of a joint in the table has :math:`f_j`, a number for each joint on its way and for
    itself, and after so many packs as the longest way needs its rows of W.
    """

    block: Ints2  # (t, 9) of :class:`TreeBlock`
    # (J,), (J,): joints before each one on its way; where its way begins in ``ways``
    depth: Ints1
    way: Ints1
    ways: Ints1  # the joints on the way to each joint, and itself, counted in the block
    # (r, 3): first joint of every run, a way without divisions, how many it has, and the run before
    # it among all, or -1
    runs: Ints2
    span: Ints2  # (r, 2): first pack and end of what contacts have of each run
    carried: Floats2  # (r, c): forces of its joints that each run hands on, a pack for each contact
    # (J,), (J,): first pack and end of what contacts have of each joint
    first: Ints1
    end: Ints1
    table: Floats1
    scaled: Floats1  # the same rows over their pivots
    contacts: Floats1  # rows of contacts: -K, right-hand side, W_o^T
    # of contacts: factors of four rows, inverted pivots, W^T M^-1 f_j, unknowns; of a way: unknowns
    factors: Floats1
    inverse: Floats1
    free: Floats1
    solution: Floats1
    path: Floats1
    products: Floats1  # four rows of the node
    side: Floats1  # 1, and the node's unknowns with the opposite sign
    tail: Floats1  # scratch: the last pack of a row of W


SCREW = offset_of(JointFactor, "force")
"""Numbers of a twist or a wrench."""
FEWEST_JOINTS = 12
"""Smaller blocks are eliminated in less time in packs."""
NO_TREES: Mapping[int, np.ndarray] = {}


def pays_as_tree(parents: np.ndarray) -> bool:
    """Whether a block is eliminated in less time as a tree than in packs of four blocks.

    Its joints have to be numbered branch by branch.
    """
    children, ways = np.bincount(parents[parents >= 0], minlength=parents.size), ways_of(parents)
    before = zip(parents[1:].tolist(), ways, strict=False)
    by_branch = all(parent < 0 or parent in way for parent, way in before)
    return parents.size >= FEWEST_JOINTS and bool(np.any(children > 1)) and by_branch


def tree_blocks(
    joints: list[int], contacts: list[int], parents: Mapping[int, np.ndarray], node: int
) -> Trees:
    """Allocate for the blocks with ``parents``, the number of the joint before each one, or -1."""
    depth: list[int] = []
    way: list[int] = []
    ways: list[int] = []
    runs: list[tuple[int, int, int]] = []
    blocks, right = [], packs_of_row(1 + node)
    table = of_contacts = vector = most = longest = 0
    for block, before in parents.items():
        of_joints, of_block, packs = ways_of(before), runs_of(before), packs_of_row(contacts[block])
        deepest = max(map(len, of_joints))
        left = packs_of_row(1 + deepest)
        blocks.append(
            TreeBlock(
                block, len(depth), len(runs), len(runs) + len(of_block), left, table, of_contacts,
                vector, 0,
            )
        )  # fmt: skip
        for on_way in of_joints:
            depth.append(len(on_way) - 1)
            way.append(len(ways))
            ways += on_way
        runs += [
            (first, count, before + len(runs) if before >= 0 else -1)
            for first, count, before in of_block
        ]
        table += joints[block] * (left + packs)
        of_contacts += LANES * packs * (packs + right)
        vector, most, longest = vector + packs, max(most, packs), max(longest, left)
    room = LANES * SCREW * (1 + most)
    return Trees(
        block=np.array(blocks, dtype=np.int64).reshape(-1, width(TreeBlock)),
        depth=np.array(depth, dtype=np.int64),
        way=np.array(way, dtype=np.int64),
        ways=np.array(ways, dtype=np.int64),
        runs=np.array(runs, dtype=np.int64).reshape(-1, 3),
        span=np.zeros((len(runs), 2), dtype=np.int64),
        carried=aligned_zeros(len(runs) * room).reshape(len(runs), room),
        first=np.zeros(len(depth), dtype=np.int64),
        end=np.zeros(len(depth), dtype=np.int64),
        table=aligned_zeros(LANES * table),
        scaled=aligned_zeros(LANES * table),
        contacts=aligned_zeros(LANES * (of_contacts + 1)),
        factors=aligned_zeros(LANES * LANES * most),
        inverse=aligned_zeros(LANES * vector),
        free=aligned_zeros(LANES * vector),
        solution=aligned_zeros(LANES * most),
        path=aligned_zeros(LANES * longest),
        products=aligned_zeros(LANES * LANES * right),
        side=aligned_zeros(LANES * right),
        tail=aligned_zeros(LANES),
    )


def ways_of(parents: np.ndarray) -> list[list[int]]:
    """The joints from the base to each joint, with it."""
    ways: list[list[int]] = []
    for joint, parent in enumerate(parents.tolist()):
        ways.append([*(ways[parent] if parent >= 0 else []), joint])
    return ways


def runs_of(parents: np.ndarray) -> list[tuple[int, int, int]]:
    """First joint of each run, how many it has, numbered one after the other, the run before it."""
    children = np.bincount(parents[parents >= 0], minlength=parents.size)
    runs: list[tuple[int, int, int]] = []
    of_joint: list[int] = []
    for joint, parent in enumerate(parents.tolist()):
        if parent >= 0 and parent == joint - 1 and children[parent] == 1:
            first, count, before = runs[-1]
            runs[-1] = first, count + 1, before
        else:
            runs.append((joint, 1, of_joint[parent] if parent >= 0 else -1))
        of_joint.append(len(runs) - 1)
    return runs


def use_factors(trees: Trees, factors: np.ndarray) -> None:
    """Eliminate blocks by the factors of their inertias at the addresses of all blocks, not 0.

    See :mod:`multiarm.dynamics.solver.factored_trees`.
    """
    for row in trees.block:
        tree = open_tree(row)
        if factors[tree.block]:
            tree.factors, tree.left = int(factors[tree.block]), 1


@plain
def packs_of_row(count):
    """Packs of so many numbers."""
    return (count + LANES - 1) // LANES
