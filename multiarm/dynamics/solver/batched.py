r"""The node algorithm on four arms at a time: the same elimination, without roots.

The arms do not know of each other until their shares of the node matrix are added up.  So four of
them are packed into the processor's vector registers (:mod:`multiarm.jit.simd`) and eliminated by
the same instructions.  An arm's equations (:mod:`multiarm.dynamics.solver.regular`), with
:math:`\mu = -\lambda`, are one symmetric table

.. math::
    \begin{bmatrix} M & W & h & 0 \\ W^T & 0 & c & W_o^T \end{bmatrix}, \qquad
    \begin{bmatrix} M & W \\ W^T & 0 \end{bmatrix}
    \begin{bmatrix} q \\ \mu \end{bmatrix} =
    \begin{bmatrix} h \\ c \end{bmatrix} - \begin{bmatrix} 0 \\ W_o^T \end{bmatrix} q_o

and are eliminated row by row (Gauss; Crout's order), with the joints' pivots
:math:`p > 0` first and then the contacts', which are negative: after the joints :math:`-K` stands
where the zeros were.  With :math:`u` the rows that result,

.. math::
    u_{ik} = a_{ik} - \sum_{j<i} \frac{u_{ji}}{p_j}\, u_{jk}, \qquad p_i = u_{ii}, \qquad
    S = M_o - \sum_{\text{contacts}} \frac{1}{p_j}\, u_{jo}^T u_{jo},

which is :math:`Y, G, Z` with the roots of the pivots left out: a root takes as long as thirty
products.  Accelerations and forces follow from the last row to the first.  ``M`` and ``W`` stay
where they are, in ``work.L`` and ``work.Y``.

Arms of fewer joints or contacts than their neighbours are filled up: joints of inertia 1 that
touch nothing, contacts of an enormous mobility that push nothing.  These change no number of the
arm, whatever its neighbours are.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.regular import COUPLED_BELOW, DEFICIENT, ELIMINATED, MOBILITY_WEIGHT
from multiarm.dynamics.solver.tables import fill_table, hand_out
from multiarm.dynamics.solver.work import (
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
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import (
    LANES,
    broadcast,
    load_pack,
    min_positive,
    minimum,
    store_pack,
    sum_pack,
)


@inlined
def reduce_pivot(lanes, start, stride, i, low, high, pivot):
    """Take rows ``low`` to ``high`` off the pivot of row ``i``, and note by how much of each."""
    at = start + LANES * i + low * stride
    diagonal = start + low * (stride + LANES)
    for j in range(low, high):
        u = load_pack(lanes, at)
        factor = u * load_pack(lanes, diagonal)
        store_pack(lanes, FACTORS_AT + LANES * j, factor)
        pivot = pivot - factor * u
        at += stride
        diagonal += stride + LANES
    return pivot


@inlined
def reduce_columns(lanes, start, stride, row, low, high, first, last):
    """Take rows ``low`` to ``high`` off columns ``first`` to ``last`` of the row at ``row``.

    How much of each row is at ``FACTORS_AT``.
    """
    k = first
    while k + 4 <= last:
        at = row + LANES * k
        s0, s1 = load_pack(lanes, at), load_pack(lanes, at + LANES)
        s2, s3 = load_pack(lanes, at + 2 * LANES), load_pack(lanes, at + 3 * LANES)
        other = start + LANES * k + low * stride
        for j in range(low, high):
            factor = load_pack(lanes, FACTORS_AT + LANES * j)
            s0 = s0 - factor * load_pack(lanes, other)
            s1 = s1 - factor * load_pack(lanes, other + LANES)
            s2 = s2 - factor * load_pack(lanes, other + 2 * LANES)
            s3 = s3 - factor * load_pack(lanes, other + 3 * LANES)
            other += stride
        store_pack(lanes, at, s0)
        store_pack(lanes, at + LANES, s1)
        store_pack(lanes, at + 2 * LANES, s2)
        store_pack(lanes, at + 3 * LANES, s3)
        k += 4
    while k < last:
        at = row + LANES * k
        s = load_pack(lanes, at)
        other = start + LANES * k + low * stride
        for j in range(low, high):
            s = s - load_pack(lanes, FACTORS_AT + LANES * j) * load_pack(lanes, other)
            other += stride
        store_pack(lanes, at, s)
        k += 1


@inlined
def eliminate_group(group, work, stiffness):
    """Eliminate the joints and contacts of four arms; ``stiffness`` is a row of ``work.stiffness``.

    Returns the smallest pivot of the inertias or its inverse, 0 where an inertia fails, and how far
    each arm is from being singular, as :func:`multiarm.dynamics.solver.regular.eliminate_arm` does.
    """
    d, m, start, stride = group[JOINTS], group[CONTACTS], group[START], LANES * group[WIDTH]
    lanes, one, zero = work.packs, broadcast(1.0), broadcast(0.0)
    inertia, relative = one, one
    stiffest, weakest = broadcast(math.inf), broadcast(math.inf)
    right, row = d + m, start
    for i in range(d):
        pivot = reduce_pivot(lanes, start, stride, i, 0, i, load_pack(lanes, row + LANES * i))
        inverse = one / pivot
        inertia = min_positive(min_positive(inertia, pivot), inverse)
        stiffest = minimum(stiffest, pivot * load_pack(stiffness, LANES * i))
        store_pack(lanes, row + LANES * i, inverse)
        reduce_columns(lanes, start, stride, row, 0, i, i + 1, right + 1)
        row += stride
    for i in range(d, right):
        diagonal = reduce_pivot(lanes, start, stride, i, 0, d, load_pack(lanes, row + LANES * i))
        pivot = reduce_pivot(lanes, start, stride, i, d, i, diagonal)
        relative = min_positive(relative, pivot / diagonal)
        weakest = minimum(weakest, zero - diagonal)
        store_pack(lanes, row + LANES * i, one / pivot)
        reduce_columns(lanes, start, stride, row, 0, i, i + 1, right + 1)
        reduce_columns(lanes, start, stride, row, d, i, right + 1, right + 7)
        row += stride
    mobile = weakest * stiffest * broadcast(MOBILITY_WEIGHT)  # the diagonal of K over the mobility
    return inertia, min_positive(relative, mobile)


@inlined
def add_group(group, work, share):
    """Add the shares of four eliminated arms to the node matrix: ``share`` is 1, 0 of no arm."""
    d, start, stride = group[JOINTS], group[START], LANES * group[WIDTH]
    lanes, right = work.packs, group[JOINTS] + group[CONTACTS]
    for k in range(6):
        at = start + d * stride + LANES * (right + 1 + k)
        diagonal = start + d * (stride + LANES)
        for j in range(d, right):
            factor = load_pack(lanes, at) * (load_pack(lanes, diagonal) * share)
            store_pack(lanes, FACTORS_AT + LANES * j, factor)
            at += stride
            diagonal += stride + LANES
        row = NODE_AT + LANES * (NODE_WIDTH * k - right)  # the table's right column comes first
        reduce_columns(lanes, start, stride, row, d, right, right, right + 2 + k)


@inlined
def substitute_group(group, work):
    """Unknowns of four eliminated arms, from the last row to the first, into the row behind."""
    d, m, start, stride = group[JOINTS], group[CONTACTS], group[START], LANES * group[WIDTH]
    lanes = work.packs
    right = d + m
    x = start + right * stride  # a row of its own behind the table
    row = start + right * stride
    for i in range(right - 1, -1, -1):
        row -= stride
        at = row + LANES * right
        s = load_pack(lanes, at)
        if i >= d:
            for k in range(6):
                at += LANES
                s = s - load_pack(lanes, at) * load_pack(lanes, OBJECT_AT + LANES * k)
        for k in range(right - 1, i, -1):
            s = s - load_pack(lanes, row + LANES * k) * load_pack(lanes, x + LANES * k)
        store_pack(lanes, x + LANES * i, s * load_pack(lanes, row + LANES * i))


@inlined
def solve_node(work, object_inertia, h_o, q_o):
    """Add up the arms' shares and solve for the object; returns the smallest relative pivot."""
    lanes, S = work.packs, work.S
    for k in range(6):
        at = NODE_AT + LANES * NODE_WIDTH * k
        q_o[k] = h_o[k] + sum_pack(load_pack(lanes, at))
        for l in range(k + 1):  # noqa: E741
            at += LANES
            S[k, l] = object_inertia[k, l] + sum_pack(load_pack(lanes, at))
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
            q_o[j] -= factor * q_o[k]
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
        s = q_o[j] * S[j, j]
        for i in range(5, j, -1):
            s -= S[i, j] * q_o[i]
        q_o[j] = s
    return smallest


@inlined
def solve_batched(work, Wo, object_inertia, h_o, h, c, q_o, q, force):
    """Eliminate the whole system and solve it for one right-hand side.

    Parameters
    ----------
    work : NodeWork
        With the arms' inertias in ``L`` and their ``W`` in ``Y``, which stay there.
    Wo : (N, 6), object_inertia : (6, 6)
        The object's rows, arms stacked, and its inertia; world axes.
    h_o : (6,), h : (sum of joints,), c : (N,)
        Right-hand sides, arms stacked.
    q_o : (6,), q : (sum of joints,), force : (N,), written
        Object's and joints' unknowns, and the physical contact forces ``lambda = -mu``.

    Returns
    -------
    int
        ``ELIMINATED``; or ``DEFICIENT`` when a pivot is below ``COUPLED_BELOW``, so that too many
        digits would be lost, or an inertia fails: then nothing is solved, and the arms are to be
        looked at one by one.  The pivots are left in ``work.pivot``.
    """
    lanes, n = work.packs, work.dofs.size - 1
    if not least_pivot(work, Wo, h, c) > COUPLED_BELOW:
        return DEFICIENT
    work.pivot[n] = solve_node(work, object_inertia, h_o, q_o)
    # arms that hold the object stiffly in some directions drown its inertia in the others
    if not work.pivot[n] > COUPLED_BELOW:
        return DEFICIENT
    for k in range(6):
        store_pack(lanes, OBJECT_AT + LANES * k, broadcast(q_o[k]))
    for g in range(work.groups.shape[0]):
        substitute_group(work.groups[g], work)
        hand_out(work.groups[g], work, q, force)
    return ELIMINATED


@inlined
def least_pivot(work, Wo, h, c):
    """Eliminate all arms, four at a time; returns how far they are from being singular.

    That is 0 where an inertia fails, or where no arm is looked at since one is always deficient.
    """
    lanes, least = work.packs, 1.0 if work.groups.shape[0] > 0 else 0.0
    for k in range(6 * NODE_WIDTH):
        store_pack(lanes, NODE_AT + LANES * k, broadcast(0.0))
    for g in range(work.groups.shape[0]):
        group, present = work.groups[g], work.present[g]
        fill_table(group, work, Wo, h, c, work.places[g], present)
        inertia, relative = eliminate_group(group, work, work.stiffness[g])
        add_group(group, work, load_pack(present, present.size - LANES))
        store_pack(lanes, OBJECT_AT, inertia)
        store_pack(lanes, OBJECT_AT + LANES, relative)
        for lane in range(group[COUNT]):
            pivot = lanes[OBJECT_AT + LANES + lane]
            work.pivot[group[FIRST_ARM + lane]] = pivot
            least = min(least, pivot if lanes[OBJECT_AT + lane] > 0.0 else 0.0)
    return least


@kernel
def largest_free_rate(work):
    """Largest ``|W^T M^-1 h|`` of the last solution: what the contacts would do without forces."""
    lanes, largest = work.packs, 0.0
    for g in range(work.groups.shape[0]):
        group = work.groups[g]
        d, right = group[JOINTS], group[JOINTS] + group[CONTACTS]
        for of_arm in range(group[START], group[START] + group[COUNT]):
            for a in range(d, right):
                rate = 0.0
                for j in range(d):
                    at = of_arm + LANES * group[WIDTH] * j
                    u = lanes[at + LANES * a]
                    rate += u * lanes[at + LANES * j] * lanes[at + LANES * right]
                largest = max(largest, abs(rate))
    return largest
