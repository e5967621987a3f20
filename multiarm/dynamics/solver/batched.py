r"""The node algorithm on four blocks at a time: the same elimination, without square roots.

The blocks are independent of each other until their contributions to the node matrix are summed.
So four of them are packed into the processor's vector registers (:mod:`multiarm.jit.simd`) and
eliminated by the same instructions.  The equations of a block
(:mod:`multiarm.dynamics.solver.node`), with :math:`\mu = -\lambda`, are one symmetric table

.. math::
    \begin{bmatrix} M & W & f_j & 0 \\ W^T & 0 & c & W_o^T \end{bmatrix}, \qquad
    \begin{bmatrix} M & W \\ W^T & 0 \end{bmatrix}
    \begin{bmatrix} a_j \\ \mu \end{bmatrix} =
    \begin{bmatrix} f_j \\ c \end{bmatrix} - \begin{bmatrix} 0 \\ W_o^T \end{bmatrix} a_o

They are eliminated row by row (Gauss; Crout's order): first the joints, with pivots :math:`p > 0`,
then the contacts, with negative pivots, since the elimination of the joints turns the zero block
into :math:`-K`.  With :math:`u` the resulting rows,

.. math::
    u_{ik} = a_{ik} - \sum_{j<i} \frac{u_{ji}}{p_j}\, u_{jk}, \qquad p_i = u_{ii}, \qquad
    S = M_o - \sum_{\text{contacts}} \frac{1}{p_j}\, u_{jo}^T u_{jo},

which are :math:`Y, G, Z` without the square roots of the pivots: a root takes as long as thirty
products.  Back substitution gives accelerations and forces.

A table has one row for each joint and each contact, and one for the solution.  Its columns are the
joints, the contacts, the right-hand side, and the node's 6 F directions.  Its packs follow each
other row by row, and a row stands for the packs from its first one on.  Blocks with fewer joints or
contacts than others of their group are padded by decoupled joints of inertia 1, and by contacts of
enormous mobility without force.  Padding changes no number of the block.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.bounds import COUPLED_BELOW, MOBILITY_WEIGHT
from multiarm.dynamics.solver.node import NODE, open_group
from multiarm.dynamics.solver.tree_contacts import largest_free_rate_of_trees
from multiarm.dynamics.solver.trees import eliminate_tree, substitute_tree
from multiarm.dynamics.status import DEFICIENT, OK
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import (
    LANES,
    broadcast,
    gather_pack,
    min_positive,
    minimum,
    packs_of,
    sum_pack,
)

PADDED_MOBILITY = 1e100
"""Of the contacts that pad a group [1/kg]: no block has as much, and its square is finite."""


@inlined
def solve_batched(work, W_o, object_inertia, f_o, f_j, c, a_o, a_j, force, node=NODE):
    """Eliminate the whole system and solve it for one right-hand side.

    Parameters
    ----------
    work : NodeWork
        With the blocks' inertias ``M`` and their ``W``.
    W_o : (N, 6 F), object_inertia : (6 F, 6 F)
        The objects' rows, blocks stacked, and its inertia; world axes.
    f_o : (6 F,), f_j : (sum of joints,), c : (N,)
        Right-hand sides, blocks stacked.
    a_o : (6 F,), a_j : (sum of joints,), force : (N,), written
        Objects' and joints' unknowns, and the physical contact forces ``lambda = -mu``.
    node : int
        Unknowns of the node, 6 F; a constant for one object, whose loops are unrolled.

    Returns
    -------
    int
        ``OK``; or ``DEFICIENT`` when a pivot is below ``COUPLED_BELOW``, so that too many
        digits would be lost, or an inertia is not positive definite: then nothing is solved, and
        the blocks must be eliminated one by one.  The pivots are in ``work.pivot``.
    """
    groups, n = work.groups, work.first_joint.size - 1
    work.status.block_by_block = False
    if not least_pivot(work, W_o, f_j, c, node) > COUPLED_BELOW:
        return DEFICIENT
    work.pivot[n] = solve_node(work, object_inertia, f_o, a_o, node)
    # blocks that are stiff in some directions leave no digits of the object's inertia in the others
    if not work.pivot[n] > COUPLED_BELOW:
        return DEFICIENT
    of_object = packs_of(groups.object, 0)
    for k in range(node):
        of_object[k] = broadcast(a_o[k])
    for g in range(groups.group.shape[0]):
        group = open_group(groups.group[g])
        substitute_group(group, packs_of(groups.tables, group.first), of_object, node)
        scatter_unknowns(g, group, work, a_j, force)
    for t in range(work.trees.block.shape[0]):
        substitute_tree(t, work, a_o, a_j, force, node)
    return OK


@inlined
def least_pivot(work, W_o, f_j, c, node):
    """Eliminate all blocks, four at a time; returns the smallest ``NodeWork.pivot``.

    It is 0 where an inertia is not positive definite, and where there are no groups since some
    block is always deficient.
    """
    groups, count = work.groups, work.groups.group.shape[0]
    trees = work.trees.block.shape[0]
    least = 1.0 if count > 0 or trees == work.first_joint.size - 1 else 0.0
    sums, factors = packs_of(groups.node, 0), packs_of(groups.factors, 0)
    for k in range(node * (node + 1)):
        sums[k] = broadcast(0.0)
    for g in range(count):
        group = open_group(groups.group[g])
        table = packs_of(groups.tables, group.first)
        fill_joint_rows(g, group, table, work, f_j)
        fill_contact_rows(g, group, table, groups, W_o, c, node)
        inertia, relative = eliminate_group(group, table, factors, groups.stiffness[g], node)
        add_group(group, table, factors, sums, groups.block_present[g], node)
        least = min(least, write_pivots(g, group, work, inertia, relative))
    for t in range(trees):
        least = min(least, eliminate_tree(t, work, W_o, f_j, c, node))
    return least


@inlined
def write_pivots(g, group, work, inertia, relative):
    """Write the results of :func:`eliminate_group` by block; returns the smallest pivot."""
    groups, least = work.groups, 1.0
    lanes = packs_of(groups.pivot, 0)
    lanes[0], lanes[1] = inertia, relative
    for lane in range(group.count):
        pivot = groups.pivot[LANES + lane]
        work.pivot[groups.blocks[g, lane]] = pivot
        least = min(least, pivot if groups.pivot[lane] > 0.0 else 0.0)
    return least


@inlined
def solve_node(work, object_inertia, f_o, a_o, node):
    """Sum over the blocks and solve for the object; returns the smallest relative pivot."""
    sums, S = packs_of(work.groups.node, 0), work.S
    for k in range(node):
        row = (node + 1) * k
        a_o[k] = f_o[k] + sum_pack(sums[row])
        for l in range(k + 1):
            S[k, l] = object_inertia[k, l] + sum_pack(sums[row + 1 + l])
    smallest = 1.0
    for j in range(node):
        diagonal = S[j, j]
        pivot = diagonal
        for k in range(j):
            # row j holds u so far; it becomes u / p
            u = S[j, k]
            factor = u * S[k, k]
            S[j, k] = factor
            pivot -= factor * u
            a_o[j] -= factor * a_o[k]
        relative = pivot / diagonal
        if not (pivot > 0.0 and relative > 0.0):
            return 0.0
        smallest = min(smallest, relative)
        S[j, j] = 1.0 / pivot
        for i in range(j + 1, node):
            s = S[i, j]
            for k in range(j):
                s -= S[i, k] * S[j, k]
            S[i, j] = s
    for j in range(node - 1, -1, -1):
        s = a_o[j] * S[j, j]
        for i in range(node - 1, j, -1):
            s -= S[i, j] * a_o[i]
        a_o[j] = s
    return smallest


@inlined
def eliminate_group(group, table, factors, stiffness, node):
    """Eliminate the joints and contacts of four blocks; ``stiffness`` is that of their joints.

    Returns the smallest pivot of each inertia or its inverse, 0 where an inertia is not positive
    definite, and ``NodeWork.pivot`` of each block.
    """
    d, right, width = group.joints, group.joints + group.contacts, group.width
    one, zero, stiffness = broadcast(1.0), broadcast(0.0), packs_of(stiffness, 0)
    inertia, relative = one, one
    stiffest, weakest = broadcast(math.inf), broadcast(math.inf)
    row = table
    for i in range(d):
        pivot = reduce_pivot(table, width, factors, i, 0, i, row[i])
        inverse = one / pivot
        inertia = min_positive(min_positive(inertia, pivot), inverse)
        stiffest = minimum(stiffest, pivot * stiffness[i])
        row[i] = inverse
        reduce_columns(table, width, factors, 0, i, row, i + 1, right + 1)
        row = row + width
    for i in range(d, right):
        diagonal = reduce_pivot(table, width, factors, i, 0, d, row[i])
        pivot = reduce_pivot(table, width, factors, i, d, i, diagonal)
        relative = min_positive(relative, pivot / diagonal)
        weakest = minimum(weakest, zero - diagonal)
        row[i] = one / pivot
        reduce_columns(table, width, factors, 0, i, row, i + 1, right + 1)
        reduce_columns(table, width, factors, d, i, row, right + 1, right + 1 + node)
        row = row + width
    mobile = weakest * stiffest * broadcast(MOBILITY_WEIGHT)  # the diagonal of K over the mobility
    return inertia, min_positive(relative, mobile)


@inlined
def reduce_pivot(table, width, factors, i, low, high, pivot):
    """``pivot`` of row ``i`` less rows ``low`` to ``high``; writes their factors ``u_ji / p_j``."""
    above, diagonal = table + (low * width + i), table + low * (width + 1)
    for j in range(low, high):
        u = above[0]
        factor = u * diagonal[0]
        factors[j] = factor
        pivot = pivot - factor * u
        above, diagonal = above + width, diagonal + (width + 1)
    return pivot


@inlined
def reduce_columns(table, width, factors, low, high, row, first, last):
    """Subtract rows ``low`` to ``high`` of a table, times their factors, from another row.

    In the columns ``first`` to ``last``; four are in registers at a time.
    """
    k = first
    while k + 4 <= last:
        out, above = row + k, table + (low * width + k)
        s0, s1, s2, s3 = out[0], out[1], out[2], out[3]
        for j in range(low, high):
            factor = factors[j]
            s0 = s0 - factor * above[0]
            s1 = s1 - factor * above[1]
            s2 = s2 - factor * above[2]
            s3 = s3 - factor * above[3]
            above = above + width
        out[0], out[1], out[2], out[3] = s0, s1, s2, s3
        k += 4
    while k < last:
        s, above = row[k], table + (low * width + k)
        for j in range(low, high):
            s = s - factors[j] * above[0]
            above = above + width
        row[k] = s
        k += 1


@inlined
def add_group(group, table, factors, sums, present, node):
    """Add four eliminated blocks to the node matrix; ``present`` is 1 for blocks, 0 for padding."""
    d, right, width = group.joints, group.joints + group.contacts, group.width
    share = packs_of(present, 0)[0]
    for k in range(node):
        above, diagonal = table + (d * width + right + 1 + k), table + d * (width + 1)
        for j in range(d, right):
            factors[j] = above[0] * (diagonal[0] * share)
            above, diagonal = above + width, diagonal + (width + 1)
        row = sums + ((node + 1) * k - right)  # the table's right column comes first
        reduce_columns(table, width, factors, d, right, row, right, right + 2 + k)


@inlined
def substitute_group(group, table, of_object, node):
    """Back substitution for four blocks; writes the unknowns into the row after the table."""
    d, right, width = group.joints, group.joints + group.contacts, group.width
    solution = row = table + right * width
    for i in range(right - 1, -1, -1):
        row = row + (-width)
        s = row[right]
        if i >= d:
            for k in range(node):
                s = s - row[right + 1 + k] * of_object[k]
        for k in range(right - 1, i, -1):
            s = s - row[k] * solution[k]
        solution[i] = s * row[i]


@inlined
def fill_joint_rows(g, group, table, work, f_j):
    """Write ``M``, ``W`` and ``f_j`` of four blocks into their table."""
    M, W, d, m, width = work.M, work.W, group.joints, group.contacts, group.width
    blocks, index = work.groups.blocks[g], work.groups.joint_index[g]
    most, columns = W.shape[1], W.shape[2]
    a0, a1, a2, a3 = most * blocks[0], most * blocks[1], most * blocks[2], most * blocks[3]
    row = table
    for j in range(d):
        for k in range(j, d):
            o = k * most + j
            row[k] = gather_pack(M, a0 * most + o, a1 * most + o, a2 * most + o, a3 * most + o)
        for k in range(m):
            o = j * columns + k
            w0, w1, w2, w3 = a0 * columns + o, a1 * columns + o, a2 * columns + o, a3 * columns + o
            row[d + k] = gather_pack(W, w0, w1, w2, w3)
        p = index[LANES * j : LANES * j + LANES]
        row[d + m] = gather_pack(f_j, p[0], p[1], p[2], p[3])
        row = row + width


@inlined
def fill_contact_rows(g, group, table, groups, W_o, c, node):
    """Write ``c`` and ``W_o^T`` of four blocks into their table, and zeros for ``K``."""
    d, m, width = group.joints, group.contacts, group.width
    present, index = packs_of(groups.contact_present[g], 0), groups.contact_index[g]
    zero, one, padding = broadcast(0.0), broadcast(1.0), broadcast(PADDED_MOBILITY)
    row = table + d * width
    for a in range(m):
        held = present[a]
        row[d + a] = (held - one) * padding
        for b in range(a + 1, m):
            row[d + b] = zero
        p = index[LANES * a : LANES * a + LANES]
        row[d + m] = gather_pack(c, p[0], p[1], p[2], p[3])
        w0, w1, w2, w3 = node * p[0], node * p[1], node * p[2], node * p[3]
        for k in range(node):
            row[d + m + 1 + k] = held * gather_pack(W_o, w0 + k, w1 + k, w2 + k, w3 + k)
        row = row + width


@inlined
def scatter_unknowns(g, group, work, a_j, force):
    """Copy the unknowns of four blocks into the stacked vectors."""
    groups, tables, d = work.groups, work.groups.tables, group.joints
    solution = LANES * (group.first + (d + group.contacts) * group.width)
    for lane in range(group.count):
        i = groups.blocks[g, lane]
        at = solution + lane
        for j in range(work.first_joint[i], work.first_joint[i + 1]):
            a_j[j] = tables[at]
            at += LANES
        at = solution + LANES * d + lane
        for a in range(work.first_contact[i], work.first_contact[i + 1]):
            force[a] = -tables[at]
            at += LANES


@kernel
def largest_free_rate(work):
    """Largest ``|W^T M^-1 f_j|`` of the last solution: contact accelerations without forces."""
    groups, largest = work.groups, 0.0
    for g in range(groups.group.shape[0]):
        group = open_group(groups.group[g])
        d, right = group.joints, group.joints + group.contacts
        for lane in range(group.count):
            for a in range(d, right):
                rate, row = 0.0, LANES * group.first + lane
                for j in range(d):
                    u, inverse = groups.tables[row + LANES * a], groups.tables[row + LANES * j]
                    rate += u * inverse * groups.tables[row + LANES * right]
                    row += LANES * group.width
                largest = max(largest, abs(rate))
    return max(largest, largest_free_rate_of_trees(work))
