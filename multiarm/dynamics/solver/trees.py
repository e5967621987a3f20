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

from multiarm.dynamics.solver.bounds import MOBILITY_WEIGHT
from multiarm.dynamics.solver.factored_trees import eliminate_by_factors, substitute_by_factors
from multiarm.dynamics.solver.tree_contacts import (
    add_run,
    add_tree,
    eliminate_contacts,
    find_forces,
    load_contacts,
    subtract_rows,
)
from multiarm.dynamics.solver.tree_tables import open_tree, packs_of_row
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import (
    LANES,
    any_nonzero,
    broadcast,
    load_pack,
    packs_of,
    store_pack,
    sum_pack,
)

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
    load_contacts(tree, m, r0, trees, W_o, c, node)
    if tree.factors != 0:
        mobility = eliminate_by_factors(tree, n, m, work, f_j, node)
    else:
        load_tree(tree, n, m, work, f_j)
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


@kernel
def substitute_tree(t, work, a_o, a_j, force, node):
    """Contact forces and joint accelerations of an eliminated block for the node's ``a_o``."""
    trees = work.trees
    tree = open_tree(trees.block[t])
    d0, r0 = work.first_joint[tree.block], work.first_contact[tree.block]
    n, m = work.first_joint[tree.block + 1] - d0, work.first_contact[tree.block + 1] - r0
    find_forces(tree, m, trees, a_o, node)
    for a in range(m):
        force[r0 + a] = -trees.solution[a]
    if tree.factors != 0:
        substitute_by_factors(tree, n, m, d0, trees, a_j)
        return
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
