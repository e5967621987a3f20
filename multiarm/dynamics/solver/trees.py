r"""The node algorithm on one block whose joints are a tree that divides, such as a humanoid robot.

The inertia of two joints is zero where neither is on the way from the base to the other one.
Eliminated from the tips to the base, nothing fills these zeros (R. Featherstone, Rigid Body
Dynamics Algorithms, 2008, 8.5): with :math:`\pi(j)` the joints between base and joint ``j``,

.. math::
    h_{kl} \leftarrow h_{kl} - \frac{h_{jk}}{p_j} h_{jl}, \qquad
    y_k \leftarrow y_k - \frac{h_{jk}}{p_j} y_j \qquad (k, l \in \pi(j)), \qquad p_j = h_{jj}

for all joints ``j``, the last one first, where ``h`` is M at the beginning, and ``y`` are the rows
of W and of :math:`f_j`.  What a contact has of a joint that does not move it stays zero.  Then

.. math::
    K = \sum_j \frac{1}{p_j} y_j^T y_j

is eliminated with the right-hand side and :math:`W_o^T` beside it, as in
:mod:`multiarm.dynamics.solver.batched`.

The row of a joint has one number for each joint on its way from the base: the same column means the
same joint in the rows of all that come after it.  So rows are subtracted from each other in packs
of four columns; numbers beyond the end of a shorter row are never read.  A *run* is a way without
divisions, whose rows are subtracted together from those of the joints before it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.bounds import MOBILITY_WEIGHT
from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.jit.rows import Number, row_of, width
from multiarm.jit.simd import (
    LANES,
    aligned_zeros,
    any_nonzero,
    broadcast,
    load_pack,
    packs_of,
    store_pack,
    sum_pack,
)
from multiarm.jit.structs import Floats1, Ints1, Ints2


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


open_tree = row_of(TreeBlock)


class Trees(NamedTuple):
    """The ``t`` blocks whose joints are trees that divide, with ``J`` joints together.

    The row of a joint in the table has :math:`f_j`, a number for each joint on its way and for
    itself, and after so many packs as the longest way needs its rows of W.
    """

    block: Ints2  # (t, 8) of :class:`TreeBlock`
    # (J,), (J,): joints before each one on its way; where its way begins in ``ways``
    depth: Ints1
    way: Ints1
    ways: Ints1  # the joints on the way to each joint, and itself, counted in the block
    # (r, 2): first joint of every run, a way without divisions, and how many it has
    runs: Ints2
    # (J,), (J,): first pack and end of what contacts have of each joint
    first: Ints1
    end: Ints1
    table: Floats1
    scaled: Floats1  # the same rows over their pivots
    contacts: Floats1  # rows of contacts: -K, right-hand side, W_o^T
    # of contacts: factors of one row, inverted pivots, W^T M^-1 f_j, unknowns; of a way: unknowns
    factors: Floats1
    inverse: Floats1
    free: Floats1
    solution: Floats1
    path: Floats1


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
    runs: list[tuple[int, int]] = []
    blocks, right = [], packs_of_row(1 + node)
    table = of_contacts = vector = most = longest = 0
    for block, before in parents.items():
        of_joints, of_block, packs = ways_of(before), runs_of(before), packs_of_row(contacts[block])
        deepest = max(map(len, of_joints))
        left = packs_of_row(1 + deepest)
        blocks.append(
            TreeBlock(
                block, len(depth), len(runs), len(runs) + len(of_block), left, table, of_contacts,
                vector,
            )
        )  # fmt: skip
        for on_way in of_joints:
            depth.append(len(on_way) - 1)
            way.append(len(ways))
            ways += on_way
        runs += of_block
        table += joints[block] * (left + packs)
        of_contacts += contacts[block] * (packs + right)
        vector, most, longest = vector + packs, max(most, packs), max(longest, left)
    return Trees(
        block=np.array(blocks, dtype=np.int64).reshape(-1, width(TreeBlock)),
        depth=np.array(depth, dtype=np.int64),
        way=np.array(way, dtype=np.int64),
        ways=np.array(ways, dtype=np.int64),
        runs=np.array(runs, dtype=np.int64).reshape(-1, 2),
        first=np.zeros(len(depth), dtype=np.int64),
        end=np.zeros(len(depth), dtype=np.int64),
        table=aligned_zeros(LANES * table),
        scaled=aligned_zeros(LANES * table),
        contacts=aligned_zeros(LANES * of_contacts),
        factors=aligned_zeros(LANES * max(most, right)),
        inverse=aligned_zeros(LANES * vector),
        free=aligned_zeros(LANES * vector),
        solution=aligned_zeros(LANES * most),
        path=aligned_zeros(LANES * longest),
    )


def ways_of(parents: np.ndarray) -> list[list[int]]:
    """The joints from the base to each joint, with it."""
    ways: list[list[int]] = []
    for joint, parent in enumerate(parents.tolist()):
        ways.append([*(ways[parent] if parent >= 0 else []), joint])
    return ways


def runs_of(parents: np.ndarray) -> list[tuple[int, int]]:
    """The first joint of each run, and how many it has: they are numbered one after the other."""
    children = np.bincount(parents[parents >= 0], minlength=parents.size)
    runs: list[tuple[int, int]] = []
    for joint, parent in enumerate(parents.tolist()):
        if parent >= 0 and parent == joint - 1 and children[parent] == 1:
            first, count = runs[-1]
            runs[-1] = first, count + 1
        else:
            runs.append((joint, 1))
    return runs


@plain
def packs_of_row(count):
    """Packs of so many numbers."""
    return (count + LANES - 1) // LANES


# --- elimination ----------------------------------------------------------------------------------


@kernel
def eliminate_tree(t, work, W_o, f_j, c, node):
    """Eliminate a block and add it to the node; writes and returns its ``NodeWork.pivot``."""
    trees = work.trees
    tree = open_tree(trees.block[t])
    i = tree.block
    r0 = work.first_contact[i]
    n, m = work.first_joint[i + 1] - work.first_joint[i], work.first_contact[i + 1] - r0
    work.pivot[i] = 0.0
    if m > n:
        return 0.0
    load_tree(tree, n, m, work, f_j)
    load_contacts(tree, m, r0, trees, W_o, c, node)
    mobility = eliminate_joints(tree, m, trees, work.levers[i], node)
    if not mobility > 0.0:
        return 0.0
    relative, weakest = eliminate_contacts(tree, m, trees, node)
    pivot = min(relative, weakest / mobility * MOBILITY_WEIGHT)
    if pivot > 0.0:
        add_tree(tree, m, trees, work.groups.node, node)
    work.pivot[i] = pivot
    return pivot


@inlined
def load_tree(tree, n, m, work, f_j):
    """Copy M, W and ``f_j`` of a block, and find the packs of W that are not zero."""
    trees, packs = work.trees, packs_of_row(m)
    M, W, d0 = work.M[tree.block], work.W[tree.block], work.first_joint[tree.block]
    depths, starts, ways, table = trees.depth, trees.way, trees.ways, trees.table
    whole, columns = m // LANES, W.shape[1]
    at = LANES * tree.table
    for j in range(n):
        depth, way = depths[tree.first + j], starts[tree.first + j]
        table[at] = f_j[d0 + j]
        load_way(j, depth + 1, M, ways, way, table, at + 1)
        for k in range(depth + 2, LANES * packs_of_row(depth + 2)):
            table[at + k] = 0.0
        at += LANES * tree.left
        first, end = packs, 0
        for p in range(whole):
            pack = load_pack(W, j * columns + LANES * p)
            store_pack(table, at + LANES * p, pack)
            if any_nonzero(pack):
                first, end = min(first, p), p + 1
        if whole < packs:
            store_pack(table, at + LANES * whole, broadcast(0.0))
            for k in range(LANES * whole, m):
                table[at + k] = W[j, k]
            if any_nonzero(load_pack(table, at + LANES * whole)):
                first, end = min(first, whole), packs
        trees.first[tree.first + j], trees.end[tree.first + j] = first, end
        at += LANES * packs


@inlined
def load_way(j, count, M, ways, way, table, at):
    """Copy row ``j`` of M on the way to the joint, from one place of the table on."""
    k, size = 0, M.shape[1]
    while k + LANES <= count:
        column = ways[way + k]
        if ways[way + k + LANES - 1] == column + LANES - 1:
            store_pack(table, at + k, load_pack(M, j * size + column))
        else:
            for l in range(k, k + LANES):
                table[at + l] = M[j, ways[way + l]]
        k += LANES
    for l in range(k, count):
        table[at + l] = M[j, ways[way + l]]


@inlined
def load_contacts(tree, m, r0, trees, W_o, c, node):
    """Write ``c`` and ``W_o^T``, and zeros for K."""
    out, packs, zero = trees.contacts, packs_of_row(m), broadcast(0.0)
    at = LANES * tree.contacts
    for a in range(m):
        for p in range(a // LANES, packs):
            store_pack(out, at + LANES * p, zero)
        at += LANES * packs
        out[at] = c[r0 + a]
        for k in range(node):
            out[at + 1 + k] = W_o[r0 + a, k]
        at += LANES * packs_of_row(1 + node)
    for p in range(packs):
        store_pack(trees.free, LANES * (tree.vector + p), zero)


@inlined
def eliminate_joints(tree, m, trees, levers, node):
    """Eliminate all joints, run by run; returns the mobility, 0 where M is not positive."""
    left, first_row, first_joint, mobility = tree.left, tree.table, tree.first, 0.0
    stride, depths, table, scaled = left + packs_of_row(m), trees.depth, trees.table, trees.scaled
    rows, over_pivots = packs_of(table, first_row), packs_of(scaled, first_row)
    starts, ways, step = trees.way, trees.ways, LANES * stride
    for r in range(tree.end - 1, tree.runs - 1, -1):
        j0, count = trees.runs[r, 0], trees.runs[r, 1]
        first, end = range_of_run(tree, j0, count, trees)
        first, end = left + first, left + end
        depth = depths[first_joint + j0]
        for t in range(count - 1, -1, -1):
            j, column = j0 + t, depth + t + 1
            own, high = rows + stride * j, column // LANES + 1
            next_row, later = own + stride, count - 1 - t
            factors = LANES * (first_row + stride * (j + 1)) + column
            subtract_rows_in_two(
                own, next_row, stride, later, scaled, factors, step, high, first, end
            )
            pivot = table[LANES * (first_row + stride * j) + column]
            if not pivot > 0.0:
                return 0.0
            inverse = 1.0 / pivot
            mobility = max(mobility, levers[j] * levers[j] * inverse)
            out, factor = over_pivots + stride * j, broadcast(inverse)
            for p in range(high):
                out[p] = factor * own[p]
            for p in range(first, end):
                out[p] = factor * own[p]
        add_run(tree, j0, count, m, trees, first - left, end - left, node)
        way, run = starts[first_joint + j0], rows + stride * j0
        factors = LANES * (first_row + stride * j0)
        for k in range(depth):
            out, high = rows + stride * ways[way + k], (k + 1) // LANES + 1
            subtract_rows_in_two(
                out, run, stride, count, scaled, factors + k + 1, step, high, first, end
            )
    return mobility


@inlined
def range_of_run(tree, j0, count, trees):
    """First pack and end of what contacts have of a run; joints before it have that too."""
    first, end = trees.first[tree.first + j0], trees.end[tree.first + j0]
    for j in range(tree.first + j0, tree.first + j0 + count):
        first, end = min(first, trees.first[j]), max(end, trees.end[j])
    end = max(first, end)
    for j in range(tree.first + j0, tree.first + j0 + count):
        trees.first[j], trees.end[j] = first, end
    if trees.depth[tree.first + j0] > 0:
        before = trees.ways[trees.way[tree.first + j0] + trees.depth[tree.first + j0] - 1]
        at = tree.first + before
        trees.first[at], trees.end[at] = min(first, trees.first[at]), max(end, trees.end[at])
    return first, end


@inlined
def subtract_rows(out, rows, stride, count, factors, at, step, low, high):
    """Subtract so many rows, times their factors, from a row, in the packs ``low`` to ``high``.

    The factors are ``factors[at]`` and every ``step`` after it; four packs are in registers.
    """
    k = low
    while k + 4 <= high:
        s0, s1, s2, s3 = out[k], out[k + 1], out[k + 2], out[k + 3]
        row, f = rows + k, at
        for _ in range(count):
            factor = broadcast(factors[f])
            s0 = s0 - factor * row[0]
            s1 = s1 - factor * row[1]
            s2 = s2 - factor * row[2]
            s3 = s3 - factor * row[3]
            row, f = row + stride, f + step
        out[k], out[k + 1], out[k + 2], out[k + 3] = s0, s1, s2, s3
        k += 4
    if k + 2 <= high:
        s0, s1, row, f = out[k], out[k + 1], rows + k, at
        for _ in range(count):
            factor = broadcast(factors[f])
            s0 = s0 - factor * row[0]
            s1 = s1 - factor * row[1]
            row, f = row + stride, f + step
        out[k], out[k + 1] = s0, s1
        k += 2
    if k < high:
        s0, row, f = out[k], rows + k, at
        for _ in range(count):
            s0 = s0 - broadcast(factors[f]) * row[0]
            row, f = row + stride, f + step
        out[k] = s0


@inlined
def subtract_rows_in_two(out, rows, stride, count, factors, at, step, high, first, end):
    """:func:`subtract_rows` in the packs up to ``high``, and from ``first`` to ``end``."""
    k, l = 0, first
    while k + 2 <= high and l + 2 <= end:
        s0, s1, s2, s3 = out[k], out[k + 1], out[l], out[l + 1]
        row, other, f = rows + k, rows + l, at
        for _ in range(count):
            factor = broadcast(factors[f])
            s0 = s0 - factor * row[0]
            s1 = s1 - factor * row[1]
            s2 = s2 - factor * other[0]
            s3 = s3 - factor * other[1]
            row, other, f = row + stride, other + stride, f + step
        out[k], out[k + 1], out[l], out[l + 1] = s0, s1, s2, s3
        k, l = k + 2, l + 2
    subtract_rows(out, rows, stride, count, factors, at, step, k, high)
    subtract_rows(out, rows, stride, count, factors, at, step, l, end)


@inlined
def add_run(tree, j0, count, m, trees, first, end, node):
    """Subtract what a run of joints contributes to K from the rows of contacts."""
    packs = packs_of_row(m)
    stride, width = tree.left + packs, packs + packs_of_row(1 + node)
    rows, scaled = packs_of(trees.table, tree.table), packs_of(trees.scaled, tree.table)
    own, over_pivots = rows + stride * j0, scaled + stride * j0
    free = packs_of(trees.free, tree.vector)
    for p in range(first, end):
        s, row, force = free[p], over_pivots + (tree.left + p), LANES * (tree.table + stride * j0)
        for _ in range(count):
            s = s + broadcast(trees.table[force]) * row[0]
            row, force = row + stride, force + LANES * stride
        free[p] = s
    out = packs_of(trees.contacts, tree.contacts)
    factors = LANES * (tree.table + stride * j0 + tree.left)
    for a in range(LANES * first, min(LANES * end, m)):
        subtract_rows(
            out + width * a, own + tree.left, stride, count, trees.scaled, factors + a,
            LANES * stride, a // LANES, end,
        )  # fmt: skip


@inlined
def eliminate_contacts(tree, m, trees, node):
    """Eliminate the contacts; returns the smallest relative pivot and the least of -K.

    0 where K is not positive definite.
    """
    out, factors, inverse = trees.contacts, trees.factors, trees.inverse
    packs = packs_of_row(m)
    width, vector = packs + packs_of_row(1 + node), LANES * tree.vector
    rows, relative, weakest = packs_of(out, tree.contacts), 1.0, math.inf
    for a in range(m):
        out[LANES * (tree.contacts + width * a + packs)] -= trees.free[vector + a]
    for a in range(m):
        row = LANES * (tree.contacts + width * a)
        diagonal, above = out[row + a], LANES * tree.contacts + a
        for b in range(a):
            factors[b] = out[above] * inverse[vector + b]
            above += LANES * width
        subtract_rows(rows + width * a, rows, width, a, factors, 0, 1, a // LANES, width)
        pivot = out[row + a]
        if not pivot < 0.0:
            return 0.0, 0.0
        relative, weakest = min(relative, pivot / diagonal), min(weakest, -diagonal)
        inverse[vector + a] = 1.0 / pivot
    return relative, weakest


@inlined
def add_tree(tree, m, trees, sums, node):
    """Add an eliminated block to the packs of the node."""
    packs, right = packs_of_row(m), packs_of_row(1 + node)
    width, rows = packs + right, packs_of(trees.contacts, tree.contacts + packs)
    sum_of_row = packs_of(trees.factors, 0)
    for k in range(node):
        for p in range(packs_of_row(k + 2)):
            s, row = broadcast(0.0), rows
            at = LANES * (tree.contacts + packs) + 1 + k
            for a in range(m):
                factor = trees.contacts[at] * trees.inverse[LANES * tree.vector + a]
                s = s - broadcast(factor) * row[p]
                row, at = row + width, at + LANES * width
            sum_of_row[p] = s
        for l in range(k + 2):
            sums[LANES * ((node + 1) * k + l)] += trees.factors[l]


@kernel
def substitute_tree(t, work, a_o, a_j, force, node):
    """Contact forces and joint accelerations of an eliminated block for the node's ``a_o``."""
    trees = work.trees
    tree = open_tree(trees.block[t])
    d0, r0 = work.first_joint[tree.block], work.first_contact[tree.block]
    m = work.first_contact[tree.block + 1] - r0
    find_forces(tree, m, trees, a_o, node)
    for a in range(m):
        force[r0 + a] = -trees.solution[a]
    stride, path, scaled = tree.left + packs_of_row(m), trees.path, trees.scaled
    rows, unknowns = packs_of(scaled, tree.table), packs_of(trees.solution, 0)
    ways = packs_of(path, 0)
    path[0] = -1.0
    for r in range(tree.runs, tree.end):
        j0, count = trees.runs[r, 0], trees.runs[r, 1]
        column = trees.depth[tree.first + j0] + 1
        first, end = trees.first[tree.first + j0], trees.end[tree.first + j0]
        high = packs_of_row(column)
        for k in range(column, LANES * high):
            path[k] = 0.0
        # what the joints before the run and the contacts do, then the joints of the run
        row = rows + stride * j0
        for j in range(d0 + j0, d0 + j0 + count):
            s = broadcast(0.0)
            for p in range(high):
                s = s - row[p] * ways[p]
            for p in range(first, end):
                s = s - row[tree.left + p] * unknowns[p]
            a_j[j] = sum_pack(s)
            row = row + stride
        at = LANES * (tree.table + stride * j0) + column
        for k in range(count):
            rate = path[column + k] = a_j[d0 + j0 + k]
            for l in range(k + 1, count):
                a_j[d0 + j0 + l] -= scaled[at + LANES * stride * l + k] * rate


@inlined
def find_forces(tree, m, trees, a_o, node):
    """Write the contacts' unknowns, by back substitution."""
    x, out = trees.solution, trees.contacts
    packs = packs_of_row(m)
    width = LANES * (packs + packs_of_row(1 + node))
    right = LANES * (tree.contacts + packs)
    for a in range(m):
        s = out[right + width * a]
        for k in range(node):
            s -= out[right + width * a + 1 + k] * a_o[k]
        x[a] = s
    for a in range(m, LANES * packs):
        x[a] = 0.0
    for a in range(m - 1, -1, -1):
        x[a] *= trees.inverse[LANES * tree.vector + a]
        column = LANES * tree.contacts + a
        for b in range(a):
            x[b] -= out[column + width * b] * x[a]


@kernel
def largest_free_rate_of_trees(work):
    """:func:`multiarm.dynamics.solver.batched.largest_free_rate` of these blocks."""
    trees, largest = work.trees, 0.0
    for t in range(trees.block.shape[0]):
        tree = open_tree(trees.block[t])
        for a in range(work.first_contact[tree.block + 1] - work.first_contact[tree.block]):
            largest = max(largest, abs(trees.free[LANES * tree.vector + a]))
    return largest
