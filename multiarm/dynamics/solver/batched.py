r"""The node algorithm on four arms at a time: the same elimination, without square roots.

The arms are independent of each other until their contributions to the node matrix are summed.  So
four of them are packed into the processor's vector registers (:mod:`multiarm.jit.simd`) and
eliminated by the same instructions.  The equations of an arm
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
joints, the contacts, the right-hand side, and the object's six directions.  Arms with fewer joints
or contacts than others of their group are padded by decoupled joints of inertia 1, and by contacts
of enormous mobility without force.  Padding changes no number of the arm.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.bounds import COUPLED_BELOW, MOBILITY_WEIGHT
from multiarm.dynamics.solver.node import (
    CONTACTS,
    COUNT,
    FACTORS_AT,
    FIRST_ARM,
    JOINTS,
    NODE_AT,
    NODE_WIDTH,
    OBJECT_AT,
    START,
    WIDTH,
)
from multiarm.dynamics.status import DEFICIENT, OK
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import (
    LANES,
    broadcast,
    gather_pack,
    load_pack,
    min_positive,
    minimum,
    store_pack,
    sum_pack,
)


@inlined
def solve_batched(work, W_o, object_inertia, f_o, f_j, c, a_o, a_j, force):
    """Eliminate the whole system and solve it for one right-hand side.

    Parameters
    ----------
    work : NodeWork
        With the arms' inertias ``M`` and their ``W``.
    W_o : (N, 6), object_inertia : (6, 6)
        The object's rows, arms stacked, and its inertia; world axes.
    f_o : (6,), f_j : (sum of joints,), c : (N,)
        Right-hand sides, arms stacked.
    a_o : (6,), a_j : (sum of joints,), force : (N,), written
        Object's and joints' unknowns, and the physical contact forces ``lambda = -mu``.

    Returns
    -------
    int
        ``OK``; or ``DEFICIENT`` when a pivot is below ``COUPLED_BELOW``, so that too many
        digits would be lost, or an inertia is not positive definite: then nothing is solved, and
        the arms must be eliminated one by one.  The pivots are in ``work.pivot``.
    """
    packs, n = work.packs, work.first_joint.size - 1
    work.by_arm[0] = 0
    if not least_pivot(work, W_o, f_j, c) > COUPLED_BELOW:
        return DEFICIENT
    work.pivot[n] = solve_node(work, object_inertia, f_o, a_o)
    # arms that are stiff in some directions leave no digits of the object's inertia in the others
    if not work.pivot[n] > COUPLED_BELOW:
        return DEFICIENT
    for k in range(6):
        store_pack(packs, OBJECT_AT + LANES * k, broadcast(a_o[k]))
    for g in range(work.groups.shape[0]):
        substitute_group(work.groups[g], work)
        scatter_unknowns(work.groups[g], work, a_j, force)
    return OK


@inlined
def least_pivot(work, W_o, f_j, c):
    """Eliminate all arms, four at a time; returns the smallest ``NodeWork.pivot``.

    It is 0 where an inertia is not positive definite, and where there are no groups since some arm
    is always deficient.
    """
    packs, least = work.packs, 1.0 if work.groups.shape[0] > 0 else 0.0
    for k in range(6 * NODE_WIDTH):
        store_pack(packs, NODE_AT + LANES * k, broadcast(0.0))
    for g in range(work.groups.shape[0]):
        group, present = work.groups[g], work.present[g]
        fill_table(group, work, W_o, f_j, c, work.places[g], present)
        inertia, relative = eliminate_group(group, work, work.stiffness[g])
        add_group(group, work, load_pack(present, present.size - LANES))
        store_pack(packs, OBJECT_AT, inertia)
        store_pack(packs, OBJECT_AT + LANES, relative)
        for lane in range(group[COUNT]):
            pivot = packs[OBJECT_AT + LANES + lane]
            work.pivot[group[FIRST_ARM + lane]] = pivot
            least = min(least, pivot if packs[OBJECT_AT + lane] > 0.0 else 0.0)
    return least


@inlined
def solve_node(work, object_inertia, f_o, a_o):
    """Sum over the arms and solve for the object; returns the smallest relative pivot."""
    packs, S = work.packs, work.S
    for k in range(6):
        at = NODE_AT + LANES * NODE_WIDTH * k
        a_o[k] = f_o[k] + sum_pack(load_pack(packs, at))
        for l in range(k + 1):
            at += LANES
            S[k, l] = object_inertia[k, l] + sum_pack(load_pack(packs, at))
    smallest = 1.0
    for j in range(6):
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
        for i in range(j + 1, 6):
            s = S[i, j]
            for k in range(j):
                s -= S[i, k] * S[j, k]
            S[i, j] = s
    for j in range(5, -1, -1):
        s = a_o[j] * S[j, j]
        for i in range(5, j, -1):
            s -= S[i, j] * a_o[i]
        a_o[j] = s
    return smallest


@inlined
def eliminate_group(group, work, stiffness):
    """Eliminate the joints and contacts of four arms; ``stiffness`` is a row of ``work.stiffness``.

    Returns the smallest pivot of each inertia or its inverse, 0 where an inertia is not positive
    definite, and ``NodeWork.pivot`` of each arm.
    """
    d, m, start, stride = group[JOINTS], group[CONTACTS], group[START], LANES * group[WIDTH]
    packs, one, zero = work.packs, broadcast(1.0), broadcast(0.0)
    inertia, relative = one, one
    stiffest, weakest = broadcast(math.inf), broadcast(math.inf)
    right, row = d + m, start
    for i in range(d):
        pivot = reduce_pivot(packs, start, stride, i, 0, i, load_pack(packs, row + LANES * i))
        inverse = one / pivot
        inertia = min_positive(min_positive(inertia, pivot), inverse)
        stiffest = minimum(stiffest, pivot * load_pack(stiffness, LANES * i))
        store_pack(packs, row + LANES * i, inverse)
        reduce_columns(packs, start, stride, row, 0, i, i + 1, right + 1)
        row += stride
    for i in range(d, right):
        diagonal = reduce_pivot(packs, start, stride, i, 0, d, load_pack(packs, row + LANES * i))
        pivot = reduce_pivot(packs, start, stride, i, d, i, diagonal)
        relative = min_positive(relative, pivot / diagonal)
        weakest = minimum(weakest, zero - diagonal)
        store_pack(packs, row + LANES * i, one / pivot)
        reduce_columns(packs, start, stride, row, 0, i, i + 1, right + 1)
        reduce_columns(packs, start, stride, row, d, i, right + 1, right + 7)
        row += stride
    mobile = weakest * stiffest * broadcast(MOBILITY_WEIGHT)  # the diagonal of K over the mobility
    return inertia, min_positive(relative, mobile)


@inlined
def reduce_pivot(packs, start, stride, i, low, high, pivot):
    """Subtract rows ``low`` to ``high`` from the pivot of row ``i``; factors to ``FACTORS_AT``."""
    at = start + LANES * i + low * stride
    diagonal = start + low * (stride + LANES)
    for j in range(low, high):
        u = load_pack(packs, at)
        factor = u * load_pack(packs, diagonal)
        store_pack(packs, FACTORS_AT + LANES * j, factor)
        pivot = pivot - factor * u
        at += stride
        diagonal += stride + LANES
    return pivot


@inlined
def reduce_columns(packs, start, stride, row, low, high, first, last):
    """Subtract rows ``low`` to ``high`` from columns ``first`` to ``last`` of the row at ``row``.

    The factors of the rows are at ``FACTORS_AT``.
    """
    k = first
    while k + 4 <= last:
        at = row + LANES * k
        s0, s1 = load_pack(packs, at), load_pack(packs, at + LANES)
        s2, s3 = load_pack(packs, at + 2 * LANES), load_pack(packs, at + 3 * LANES)
        above = start + LANES * k + low * stride
        for j in range(low, high):
            factor = load_pack(packs, FACTORS_AT + LANES * j)
            s0 = s0 - factor * load_pack(packs, above)
            s1 = s1 - factor * load_pack(packs, above + LANES)
            s2 = s2 - factor * load_pack(packs, above + 2 * LANES)
            s3 = s3 - factor * load_pack(packs, above + 3 * LANES)
            above += stride
        store_pack(packs, at, s0)
        store_pack(packs, at + LANES, s1)
        store_pack(packs, at + 2 * LANES, s2)
        store_pack(packs, at + 3 * LANES, s3)
        k += 4
    while k < last:
        at = row + LANES * k
        s = load_pack(packs, at)
        above = start + LANES * k + low * stride
        for j in range(low, high):
            s = s - load_pack(packs, FACTORS_AT + LANES * j) * load_pack(packs, above)
            above += stride
        store_pack(packs, at, s)
        k += 1


@inlined
def add_group(group, work, share):
    """Add four eliminated arms to the node matrix; ``share`` is 1 for arms, 0 for padding."""
    d, start, stride = group[JOINTS], group[START], LANES * group[WIDTH]
    packs, right = work.packs, group[JOINTS] + group[CONTACTS]
    for k in range(6):
        at = start + d * stride + LANES * (right + 1 + k)
        diagonal = start + d * (stride + LANES)
        for j in range(d, right):
            factor = load_pack(packs, at) * (load_pack(packs, diagonal) * share)
            store_pack(packs, FACTORS_AT + LANES * j, factor)
            at += stride
            diagonal += stride + LANES
        row = NODE_AT + LANES * (NODE_WIDTH * k - right)  # the table's right column comes first
        reduce_columns(packs, start, stride, row, d, right, right, right + 2 + k)


@inlined
def substitute_group(group, work):
    """Back substitution for four arms; writes the unknowns into the row after the table."""
    d, m, start, stride = group[JOINTS], group[CONTACTS], group[START], LANES * group[WIDTH]
    packs = work.packs
    right = d + m
    x = row = start + right * stride
    for i in range(right - 1, -1, -1):
        row -= stride
        at = row + LANES * right
        s = load_pack(packs, at)
        if i >= d:
            for k in range(6):
                at += LANES
                s = s - load_pack(packs, at) * load_pack(packs, OBJECT_AT + LANES * k)
        for k in range(right - 1, i, -1):
            s = s - load_pack(packs, row + LANES * k) * load_pack(packs, x + LANES * k)
        store_pack(packs, x + LANES * i, s * load_pack(packs, row + LANES * i))


@inlined
def fill_table(group, work, W_o, f_j, c, places, present):
    """Write the equations of four arms into their table.

    ``group, places, present`` are rows of ``work.groups``, ``work.places``, ``work.present``.
    """
    fill_joint_rows(group, work, f_j, places)
    fill_contact_rows(group, work, W_o, c, places[LANES * work.M.shape[1] :], present)


@inlined
def fill_joint_rows(group, work, f_j, places):
    """Write ``M``, ``W`` and ``f_j`` of four arms into their table."""
    d, m, stride = group[JOINTS], group[CONTACTS], LANES * group[WIDTH]
    M, W, packs = work.M, work.W, work.packs
    most, columns = W.shape[1], W.shape[2]
    a0, a1 = most * group[FIRST_ARM], most * group[FIRST_ARM + 1]
    a2, a3 = most * group[FIRST_ARM + 2], most * group[FIRST_ARM + 3]
    row = group[START]
    for j in range(d):
        at = row + LANES * j
        for k in range(j, d):
            o = k * most + j
            value = gather_pack(M, a0 * most + o, a1 * most + o, a2 * most + o, a3 * most + o)
            store_pack(packs, at, value)
            at += LANES
        for o in range(j * columns, j * columns + m):
            w0, w1, w2, w3 = a0 * columns + o, a1 * columns + o, a2 * columns + o, a3 * columns + o
            store_pack(packs, at, gather_pack(W, w0, w1, w2, w3))
            at += LANES
        p = places[LANES * j : LANES * j + LANES]
        store_pack(packs, at, gather_pack(f_j, p[0], p[1], p[2], p[3]))
        row += stride


@inlined
def fill_contact_rows(group, work, W_o, c, places, present):
    """Write ``c`` and ``W_o^T`` of four arms into their table, and zeros for ``K``."""
    d, m = group[JOINTS], group[CONTACTS]
    packs, row = work.packs, group[START] + LANES * d * group[WIDTH]
    zero, one = broadcast(0.0), broadcast(1.0)
    padding = broadcast(1e100)  # mobility [1/kg]: no arm has as much, and its square is finite
    for a in range(m):
        held = load_pack(present, LANES * a)
        at = row + LANES * (d + a)
        store_pack(packs, at, (held - one) * padding)
        for _ in range(a + 1, m):
            at += LANES
            store_pack(packs, at, zero)
        at += LANES
        p = places[LANES * a : LANES * a + LANES]
        store_pack(packs, at, gather_pack(c, p[0], p[1], p[2], p[3]))
        w0, w1, w2, w3 = 6 * p[0], 6 * p[1], 6 * p[2], 6 * p[3]
        for k in range(6):
            at += LANES
            store_pack(packs, at, held * gather_pack(W_o, w0 + k, w1 + k, w2 + k, w3 + k))
        row += LANES * group[WIDTH]


@inlined
def scatter_unknowns(group, work, a_j, force):
    """Copy the unknowns of four arms into the stacked vectors."""
    d, right = group[JOINTS], group[JOINTS] + group[CONTACTS]
    x = group[START] + LANES * right * group[WIDTH]
    packs = work.packs
    for lane in range(group[COUNT]):
        i = group[FIRST_ARM + lane]
        at = x + lane
        for j in range(work.first_joint[i], work.first_joint[i + 1]):
            a_j[j] = packs[at]
            at += LANES
        at = x + LANES * d + lane
        for a in range(work.first_contact[i], work.first_contact[i + 1]):
            force[a] = -packs[at]
            at += LANES


@kernel
def largest_free_rate(work):
    """Largest ``|W^T M^-1 f_j|`` of the last solution: contact accelerations without forces."""
    packs, largest = work.packs, 0.0
    for g in range(work.groups.shape[0]):
        group = work.groups[g]
        d, right = group[JOINTS], group[JOINTS] + group[CONTACTS]
        for of_arm in range(group[START], group[START] + group[COUNT]):
            for a in range(d, right):
                rate = 0.0
                for j in range(d):
                    at = of_arm + LANES * group[WIDTH] * j
                    u = packs[at + LANES * a]
                    rate += u * packs[at + LANES * j] * packs[at + LANES * right]
                largest = max(largest, abs(rate))
    return largest
