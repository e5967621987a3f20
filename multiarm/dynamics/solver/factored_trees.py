r"""Elimination of a tree by the factors of its inertia.

Where the factors of the inertia are known (:class:`multiarm.robots.terms.JointFactor`), no entry of
it is read.  The entry of two joints is :math:`h_{jk} = p_j\, S_k\cdot V_j` when joint ``j`` is
eliminated (:mod:`multiarm.dynamics.solver.trees`), so what all joints beyond joint ``k`` subtract
from its row is a power of one wrench:

.. math::
    y_k = w_k - S_k\cdot G_k, \qquad G_k = \sum_j V_j\, y_j \quad (k\in\pi(j))

with the rows :math:`w_k` of W, and of :math:`f_j`.  For each contact, a tree hands on six numbers
from joint to joint, whatever its depth.  Likewise the accelerations are, from the base on, with the
acceleration A of the link before a joint and :math:`\mu = -\lambda`,

.. math::
    a_j = \frac{1}{p_j}\big(y_j^f - y_j\,\mu\big) - V_j\cdot A, \qquad A \leftarrow A + S_j\, a_j .

A row of the tables has the force first, and from its second pack on what the contacts have.
"""

from __future__ import annotations

from multiarm.dynamics.solver.tree_contacts import add_run
from multiarm.dynamics.solver.tree_tables import SCREW, open_tree, packs_of_row
from multiarm.jit.kernels import fused, inlined, kernel
from multiarm.jit.simd import (
    LANES,
    any_nonzero,
    broadcast,
    load_pack,
    packs_of,
    store_pack,
    sum_pack,
)
from multiarm.jit.structs import floats_at
from multiarm.jit.vectors import add_scaled, dot, vec
from multiarm.robots.terms import FACTOR_WIDTH, VANISHING_INERTIA

INVERSE, LARGEST_INVERSE = FACTOR_WIDTH - 1, 0.5 / VANISHING_INERTIA


@kernel
def eliminate_by_factors(tree, n, m, work, f_j, node):
    """Eliminate all joints, run by run; returns the mobility, 0 where M is not positive."""
    trees, mobility = work.trees, 0.0
    factors, packs = floats_at(tree.factors, FACTOR_WIDTH * n), packs_of_row(m)
    for r in range(tree.runs, tree.end):
        trees.span[r, 0], trees.span[r, 1] = packs, 0
        for k in range(SCREW):
            trees.carried[r, LANES * k] = 0.0
    for r in range(tree.end - 1, tree.runs - 1, -1):
        j0, count, before = trees.runs[r, 0], trees.runs[r, 1], trees.runs[r, 2]
        first, end = trees.span[r, 0], trees.span[r, 1]
        inner_first, inner_end = first, max(first, end)
        first, end = span_of_run(tree, j0, count, m, first, end, work)
        trees.span[r, 0], trees.span[r, 1] = first, end
        largest = carry_force(tree, r, j0, count, packs, factors, f_j, work)
        if not largest >= 0.0:
            return 0.0
        mobility = max(mobility, largest)
        clear_carried(r, first, inner_first, trees)
        clear_carried(r, inner_end, end, trees)
        if before >= 0:
            widen_span(before, first, end, trees)
        p = first
        while p + 2 <= end:
            carry_two(tree, r, j0, count, p, m, factors, work)
            p += 2
        if p < end:
            carry_one(tree, r, j0, count, p, m, factors, work)
        add_run(tree, j0, count, m, trees, first, end, node)
    return mobility


@inlined
def span_of_run(tree, j0, count, m, first, end, work):
    """First pack and end of the contacts that a run moves, among them those of runs beyond it."""
    W = work.W
    columns, packs = W.shape[2], packs_of_row(m)
    at = (tree.block * W.shape[1] + j0) * columns
    low, high = first, end
    for p in range(packs):
        if low <= p < high:
            continue
        s = broadcast(0.0)
        if LANES * (p + 1) <= m:
            for k in range(count):
                w = load_pack(W, at + LANES * p + columns * k)
                s = s + w * w
        else:
            for k in range(count):
                w = last_pack(W, at + LANES * p + columns * k, m - LANES * p, work.trees.tail)
                s = s + w * w
        if any_nonzero(s):
            first, end = min(first, p), max(end, p + 1)
    return first, max(first, end)


@inlined
def last_pack(W, at, count, tail):
    """Fewer than four numbers from one place of W on, and zeros."""
    numbers = W.reshape(-1)
    store_pack(tail, 0, broadcast(0.0))
    for k in range(count):
        tail[k] = numbers[at + k]
    return load_pack(tail, 0)


@inlined
def clear_carried(r, first, end, trees):
    """Set what the runs beyond a run hand on to it to zero, for some packs of contacts."""
    carried = packs_of(trees.carried[r], SCREW)
    for k in range(SCREW * first, SCREW * end):
        carried[k] = broadcast(0.0)


@inlined
def widen_span(r, first, end, trees):
    """Let a run have the contacts of one beyond it; what it gets from others there is zero yet."""
    low, high = trees.span[r, 0], trees.span[r, 1]
    if end <= first:
        return
    if high <= low:
        clear_carried(r, first, end, trees)
        trees.span[r, 0], trees.span[r, 1] = first, end
        return
    clear_carried(r, first, low, trees)
    clear_carried(r, high, end, trees)
    trees.span[r, 0], trees.span[r, 1] = min(low, first), max(high, end)


@fused
def carry_force(tree, r, j0, count, packs, factors, f_j, work):
    """The rows of a run for the right-hand side, and what it hands on to the run before it.

    Two joints at a time: their rows wait for the same wrench.  Returns the largest mobility of a
    joint, -1 where an inertia is not positive.
    """
    trees, levers, d0 = work.trees, work.levers[tree.block], work.first_joint[tree.block]
    own, stride, before = trees.carried[r], LANES * (1 + packs), trees.runs[r, 2]
    push = own[0], own[LANES], own[2 * LANES]
    turn = own[3 * LANES], own[4 * LANES], own[5 * LANES]
    j, mobility, regular = j0 + count - 1, 0.0, True
    while j >= j0:
        at, out = FACTOR_WIDTH * j, LANES * tree.table + stride * j
        inverse, v, w = factors[at + INVERSE], vec(factors, at + 6), vec(factors, at + 9)
        force = f_j[d0 + j] - (dot(vec(factors, at), push) + dot(vec(factors, at + 3), turn))
        trees.table[out], trees.scaled[out] = force, inverse * force
        regular &= 0.0 < inverse < LARGEST_INVERSE
        mobility = max(mobility, levers[j] * levers[j] * inverse)
        if j > j0:
            at, out, j = at - FACTOR_WIDTH, out - stride, j - 1
            inverse, a, b = factors[at + INVERSE], vec(factors, at), vec(factors, at + 3)
            other = f_j[d0 + j] - (dot(a, push) + dot(b, turn)) - (dot(a, v) + dot(b, w)) * force
            trees.table[out], trees.scaled[out] = other, inverse * other
            regular &= 0.0 < inverse < LARGEST_INVERSE
            mobility = max(mobility, levers[j] * levers[j] * inverse)
            push = add_scaled(add_scaled(push, force, v), other, vec(factors, at + 6))
            turn = add_scaled(add_scaled(turn, force, w), other, vec(factors, at + 9))
        else:
            push, turn = add_scaled(push, force, v), add_scaled(turn, force, w)
        j -= 1
    if before >= 0:
        sums = trees.carried[before]
        for k in range(3):
            sums[LANES * k] += push[k]
            sums[LANES * (3 + k)] += turn[k]
    return mobility if regular else -1.0


@inlined
def less_powers(s, factors, at, x, y, z, u, v, w):
    """``s`` less the powers of four wrenches at the column of a joint."""
    s = s - broadcast(factors[at]) * x - broadcast(factors[at + 1]) * y
    t = broadcast(factors[at + 3]) * u + broadcast(factors[at + 4]) * v
    return (s - broadcast(factors[at + 2]) * z) - (t + broadcast(factors[at + 5]) * w)


@inlined
def carry_one(tree, r, j0, count, p, m, factors, work):
    """The rows of a run for a pack of contacts, and what it hands on to the run before it."""
    trees, W = work.trees, work.W
    packs, columns, before = packs_of_row(m), W.shape[2], trees.runs[r, 2]
    own = packs_of(trees.carried[r], SCREW * (1 + p))
    x, y, z, u, v, w = own[0], own[1], own[2], own[3], own[4], own[5]
    j = j0 + count - 1
    at, row = FACTOR_WIDTH * j, (tree.block * W.shape[1] + j) * columns + LANES * p
    place = tree.table + (1 + packs) * j + 1 + p
    out, scaled = packs_of(trees.table, place), packs_of(trees.scaled, place)
    whole = LANES * (p + 1) <= m
    for _ in range(count):
        s = load_pack(W, row) if whole else last_pack(W, row, m - LANES * p, trees.tail)
        s = less_powers(s, factors, at, x, y, z, u, v, w)
        out[0], scaled[0] = s, broadcast(factors[at + INVERSE]) * s
        x = x + broadcast(factors[at + 6]) * s
        y = y + broadcast(factors[at + 7]) * s
        z = z + broadcast(factors[at + 8]) * s
        u = u + broadcast(factors[at + 9]) * s
        v = v + broadcast(factors[at + 10]) * s
        w = w + broadcast(factors[at + 11]) * s
        at, row, out, scaled = (
            at - FACTOR_WIDTH, row - columns, out + (-1 - packs), scaled + (-1 - packs)
        )  # fmt: skip
    if before >= 0:
        add_carried(packs_of(trees.carried[before], SCREW * (1 + p)), x, y, z, u, v, w)


@inlined
def add_carried(sums, x, y, z, u, v, w):
    """Add what a run hands on for a pack of contacts."""
    sums[0], sums[1], sums[2] = sums[0] + x, sums[1] + y, sums[2] + z
    sums[3], sums[4], sums[5] = sums[3] + u, sums[4] + v, sums[5] + w


@inlined
def carry_two(tree, r, j0, count, p, m, factors, work):
    """:func:`carry_one` for two packs."""
    trees, W = work.trees, work.W
    packs, columns, before = packs_of_row(m), W.shape[2], trees.runs[r, 2]
    own = packs_of(trees.carried[r], SCREW * (1 + p))
    x, y, z, u, v, w = own[0], own[1], own[2], own[3], own[4], own[5]
    a, b, c, d, e, f = own[6], own[7], own[8], own[9], own[10], own[11]
    j = j0 + count - 1
    at, row = FACTOR_WIDTH * j, (tree.block * W.shape[1] + j) * columns + LANES * p
    place = tree.table + (1 + packs) * j + 1 + p
    out, scaled = packs_of(trees.table, place), packs_of(trees.scaled, place)
    whole = LANES * (p + 2) <= m
    for _ in range(count):
        s = less_powers(load_pack(W, row), factors, at, x, y, z, u, v, w)
        t = (
            load_pack(W, row + LANES)
            if whole
            else last_pack(W, row + LANES, m - LANES * (p + 1), trees.tail)
        )
        t = less_powers(t, factors, at, a, b, c, d, e, f)
        inverse = broadcast(factors[at + INVERSE])
        out[0], out[1], scaled[0], scaled[1] = s, t, inverse * s, inverse * t
        V = broadcast(factors[at + 6])
        x, a = x + V * s, a + V * t
        V = broadcast(factors[at + 7])
        y, b = y + V * s, b + V * t
        V = broadcast(factors[at + 8])
        z, c = z + V * s, c + V * t
        V = broadcast(factors[at + 9])
        u, d = u + V * s, d + V * t
        V = broadcast(factors[at + 10])
        v, e = v + V * s, e + V * t
        V = broadcast(factors[at + 11])
        w, f = w + V * s, f + V * t
        at, row, out, scaled = (
            at - FACTOR_WIDTH, row - columns, out + (-1 - packs), scaled + (-1 - packs)
        )  # fmt: skip
    if before >= 0:
        sums = packs_of(trees.carried[before], SCREW * (1 + p))
        add_carried(sums, x, y, z, u, v, w)
        add_carried(sums + SCREW, a, b, c, d, e, f)


@kernel
def substitute_by_factors(tree, n, m, d0, trees, a_j):
    """Accelerations of the joints where the contacts' unknowns are known."""
    packs, factors = packs_of_row(m), floats_at(tree.factors, FACTOR_WIDTH * n)
    rows, unknowns = packs_of(trees.scaled, tree.table), packs_of(trees.solution, 0)
    for r in range(tree.runs, tree.end):
        row, number = (
            rows + (1 + packs) * trees.runs[r, 0],
            LANES * (tree.table + (1 + packs) * trees.runs[r, 0]),
        )
        first, end = trees.span[r, 0], trees.span[r, 1]
        for j in range(d0 + trees.runs[r, 0], d0 + trees.runs[r, 0] + trees.runs[r, 1]):
            s = broadcast(0.0)
            for p in range(first, end):
                s = s - row[1 + p] * unknowns[p]
            a_j[j] = trees.scaled[number] + sum_pack(s)
            row, number = row + (1 + packs), number + LANES * (1 + packs)
        accelerate_run(tree, r, d0, factors, trees, a_j)


@fused
def accelerate_run(tree, r, d0, factors, trees, a_j):
    """Subtract what the acceleration of the link before each joint of a run does.

    Two joints at a time, as in :func:`carry_force`.
    """
    before, own = trees.runs[r, 2], trees.carried[r]
    a = alpha = 0.0, 0.0, 0.0
    if before >= 0:
        A = trees.carried[before]
        a, alpha = (A[0], A[LANES], A[2 * LANES]), (A[3 * LANES], A[4 * LANES], A[5 * LANES])
    j, end = trees.runs[r, 0], trees.runs[r, 0] + trees.runs[r, 1]
    while j < end:
        at = FACTOR_WIDTH * j
        v, w = vec(factors, at), vec(factors, at + 3)
        rate = a_j[d0 + j] - (dot(vec(factors, at + 6), a) + dot(vec(factors, at + 9), alpha))
        a_j[d0 + j] = rate
        if j + 1 < end:
            at, j = at + FACTOR_WIDTH, j + 1
            f, c = vec(factors, at + 6), vec(factors, at + 9)
            other = a_j[d0 + j] - (dot(f, a) + dot(c, alpha)) - (dot(f, v) + dot(c, w)) * rate
            a_j[d0 + j] = other
            a = add_scaled(add_scaled(a, rate, v), other, vec(factors, at))
            alpha = add_scaled(add_scaled(alpha, rate, w), other, vec(factors, at + 3))
        else:
            a, alpha = add_scaled(a, rate, v), add_scaled(alpha, rate, w)
        j += 1
    for k in range(3):
        own[LANES * k], own[LANES * (3 + k)] = a[k], alpha[k]


# --- inertias -------------------------------------------------------------------------------------


@kernel
def complete_inertias(work):
    """Write the inertias of the blocks that are eliminated by factors, which no solution reads."""
    trees = work.trees
    for t in range(trees.block.shape[0]):
        tree = open_tree(trees.block[t])
        if tree.factors != 0:
            n = work.first_joint[tree.block + 1] - work.first_joint[tree.block]
            write_inertia(tree, n, trees, work.M[tree.block])


@inlined
def write_inertia(tree, n, trees, M):
    r"""Write the lower triangle of :math:`M = L^T \operatorname{diag}(p)\, L`."""
    factors, row = floats_at(tree.factors, FACTOR_WIDTH * n), trees.path
    for j in range(n):
        for k in range(j + 1):
            M[j, k] = 0.0
    for j in range(n):
        depth, way, at = trees.depth[tree.first + j], trees.way[tree.first + j], FACTOR_WIDTH * j
        for k in range(depth):
            column, entry = FACTOR_WIDTH * trees.ways[way + k], 0.0
            for l in range(SCREW):
                entry += factors[column + l] * factors[at + SCREW + l]
            row[k] = entry
        row[depth], inverse = 1.0, factors[at + INVERSE]
        p = 1.0 / inverse if inverse < LARGEST_INVERSE else 0.0
        for k in range(depth + 1):
            factor = row[k] * p
            for l in range(k + 1):
                M[trees.ways[way + k], trees.ways[way + l]] += factor * row[l]
