"""The contacts of a block that is a tree: rows of K beside the right-hand side and ``W_o^T``.

See :mod:`multiarm.dynamics.solver.trees`.  The rows are eliminated four at a time: to whole packs
they are padded by rows without entries, whose pivots are -1.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.tree_tables import open_tree, packs_of_row
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import LANES, broadcast, load_pack, packs_of, store_pack, sum_pack


@inlined
def load_contacts(tree, m, r0, trees, W_o, c, node):
    """Write ``c`` and ``W_o^T``, zeros for K, and the rows of the padding."""
    out, packs, zero = trees.contacts, packs_of_row(m), broadcast(0.0)
    width, rows = packs + packs_of_row(1 + node), packs_of(out, tree.contacts)
    for k in range(LANES * packs * width):
        rows[k] = zero
    at = LANES * tree.contacts
    for a in range(m):
        right = at + LANES * packs
        out[right] = c[r0 + a]
        for k in range(node):
            out[right + 1 + k] = W_o[r0 + a, k]
        at += LANES * width
    for a in range(m, LANES * packs):
        out[at + a] = -1.0
        at += LANES * width
    for p in range(packs):
        store_pack(trees.free, LANES * (tree.vector + p), zero)


@inlined
def add_run(tree, j0, count, m, trees, first, end, node):
    """Subtract what a run of joints contributes to K from the rows of contacts."""
    packs = packs_of_row(m)
    stride, width = tree.left + packs, packs + packs_of_row(1 + node)
    rows, scaled = packs_of(trees.table, tree.table), packs_of(trees.scaled, tree.table)
    own, over_pivots = rows + stride * j0, scaled + stride * j0
    free = packs_of(trees.free, tree.vector)
    first_force, k = LANES * (tree.table + stride * j0), first
    while k + 2 <= end:
        s, t, row, at = free[k], free[k + 1], over_pivots + (tree.left + k), first_force
        for _ in range(count):
            force = broadcast(trees.table[at])
            s, t = s + force * row[0], t + force * row[1]
            row, at = row + stride, at + LANES * stride
        free[k], free[k + 1] = s, t
        k += 2
    if k < end:
        s, row, at = free[k], over_pivots + (tree.left + k), first_force
        for _ in range(count):
            s = s + broadcast(trees.table[at]) * row[0]
            row, at = row + stride, at + LANES * stride
        free[k] = s
    out = packs_of(trees.contacts, tree.contacts)
    factors = LANES * (tree.table + stride * j0 + tree.left)
    for p in range(first, end):
        subtract_from_rows(
            out + width * LANES * p, width, own + tree.left, stride, count, trees.scaled,
            factors + LANES * p, LANES * stride, p, end,
        )  # fmt: skip


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
def subtract_from_rows(out, width, rows, stride, count, factors, at, step, low, high):
    """:func:`subtract_rows` from four rows, whose factors follow each other."""
    first, second, third, fourth = out, out + width, out + 2 * width, out + 3 * width
    k = low
    while k + 2 <= high:
        a, b, c, d = first[k], second[k], third[k], fourth[k]
        e, f, g, h = first[k + 1], second[k + 1], third[k + 1], fourth[k + 1]
        row, n = rows + k, at
        for _ in range(count):
            left, right = row[0], row[1]
            factor = broadcast(factors[n])
            a, e = a - factor * left, e - factor * right
            factor = broadcast(factors[n + 1])
            b, f = b - factor * left, f - factor * right
            factor = broadcast(factors[n + 2])
            c, g = c - factor * left, g - factor * right
            factor = broadcast(factors[n + 3])
            d, h = d - factor * left, h - factor * right
            row, n = row + stride, n + step
        first[k], second[k], third[k], fourth[k] = a, b, c, d
        first[k + 1], second[k + 1], third[k + 1], fourth[k + 1] = e, f, g, h
        k += 2
    if k < high:
        a, b, c, d = first[k], second[k], third[k], fourth[k]
        row, n = rows + k, at
        for _ in range(count):
            left = row[0]
            a, b = a - broadcast(factors[n]) * left, b - broadcast(factors[n + 1]) * left
            c, d = c - broadcast(factors[n + 2]) * left, d - broadcast(factors[n + 3]) * left
            row, n = row + stride, n + step
        first[k], second[k], third[k], fourth[k] = a, b, c, d


@inlined
def eliminate_contacts(tree, m, trees, node):
    """Eliminate the contacts, four rows at a time.

    Returns the smallest relative pivot and the least of -K; 0 where K is not positive definite.
    """
    out, factors, inverse = trees.contacts, trees.factors, trees.inverse
    packs = packs_of_row(m)
    width, vector, first = packs + packs_of_row(1 + node), LANES * tree.vector, tree.contacts
    rows, relative, weakest = packs_of(out, first), 1.0, math.inf
    of_four = packs_of(factors, 0)
    for a in range(LANES * packs):
        row = LANES * (first + width * a)
        diagonal = inverse[vector + a] = out[row + a]
        if a < m:
            out[row + LANES * packs] -= trees.free[vector + a]
            weakest = min(weakest, -diagonal)
    for p in range(packs):
        begin = LANES * p
        for b in range(begin):
            of_four[b] = rows[width * b + p] * broadcast(inverse[vector + b])
        four = rows + width * begin
        subtract_from_rows(four, width, rows, width, begin, factors, 0, LANES, p, width)
        pivot = eliminate_four(p, out, first + width * begin, width, inverse, vector + begin)
        if not pivot > 0.0:
            return 0.0, 0.0
        relative = min(relative, pivot)
    return relative, weakest


@inlined
def eliminate_four(p, numbers, first, width, inverse, place):
    """Eliminate the four rows that begin at pack ``first``, whose pivots are in their pack ``p``.

    From ``place`` on, ``inverse`` has what the pivots were; writes their inverses there.  Returns
    the smallest pivot over what it was; 0 where one is not negative.
    """
    rows, at = packs_of(numbers, first), LANES * (first + p)
    second, third, fourth = at + LANES * width, at + 2 * LANES * width, at + 3 * LANES * width
    a, ab, ac, ad = numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3]
    b, bc, bd = numbers[second + 1], numbers[second + 2], numbers[second + 3]
    c, cd, d = numbers[third + 2], numbers[third + 3], numbers[fourth + 3]
    over_a = 1.0 / a
    b_a, c_a, d_a = ab * over_a, ac * over_a, ad * over_a
    b, bc, bd = b - b_a * ab, bc - b_a * ac, bd - b_a * ad
    over_b = 1.0 / b
    c, cd, d = c - c_a * ac, cd - c_a * ad, d - d_a * ad
    c_b, d_b = bc * over_b, bd * over_b
    c, cd, d = c - c_b * bc, cd - c_b * bd, d - d_b * bd
    over_c = 1.0 / c
    d_c = cd * over_c
    d -= d_c * cd
    if not (a < 0.0 and b < 0.0 and c < 0.0 and d < 0.0):
        return 0.0
    relative = min(
        min(a / inverse[place], b / inverse[place + 1]),
        min(c / inverse[place + 2], d / inverse[place + 3]),
    )
    inverse[place], inverse[place + 1] = over_a, over_b
    inverse[place + 2], inverse[place + 3] = over_c, 1.0 / d
    of_b, of_c, of_d = broadcast(b_a), broadcast(c_a), broadcast(d_a)
    of_cb, of_db, of_dc = broadcast(c_b), broadcast(d_b), broadcast(d_c)
    for k in range(p, width):
        x = rows[k]
        y = rows[width + k] - of_b * x
        z = rows[2 * width + k] - of_c * x - of_cb * y
        rows[width + k], rows[2 * width + k] = y, z
        rows[3 * width + k] = rows[3 * width + k] - of_d * x - of_db * y - of_dc * z
    return relative


@inlined
def add_tree(tree, m, trees, sums, node):
    """Add an eliminated block to the packs of the node."""
    packs, right = packs_of_row(m), packs_of_row(1 + node)
    width, first = packs + right, tree.contacts + packs
    rows, products = packs_of(trees.contacts, first), packs_of(trees.products, 0)
    of_four = packs_of(trees.factors, 0)
    for k in range(0, node, LANES):
        lines, high = min(LANES, node - k), packs_of_row(min(node, k + LANES) + 1)
        at = LANES * first + 1 + k
        for a in range(m):
            inverse = broadcast(trees.inverse[LANES * tree.vector + a])
            of_four[a] = load_pack(trees.contacts, at + LANES * width * a) * inverse
        for n in range(right * LANES):
            products[n] = broadcast(0.0)
        subtract_from_rows(products, right, rows, width, m, trees.factors, 0, LANES, 0, high)
        for n in range(lines):
            for l in range(k + n + 2):
                sums[LANES * ((node + 1) * (k + n) + l)] += trees.products[LANES * right * n + l]


@inlined
def find_forces(tree, m, trees, a_o, node):
    """Write the contacts' unknowns, by back substitution, four at a time."""
    x, out, inverse, zero = trees.solution, trees.contacts, trees.inverse, broadcast(0.0)
    packs, right = packs_of_row(m), packs_of_row(1 + node)
    width = packs + right
    rows, unknowns, of_node = packs_of(out, tree.contacts), packs_of(x, 0), packs_of(trees.side, 0)
    trees.side[0] = 1.0
    for k in range(node):
        trees.side[1 + k] = -a_o[k]
    for p in range(packs - 1, -1, -1):
        for a in range(LANES * p, LANES * p + LANES):
            row, s = rows + width * a, zero
            for q in range(right):
                s = s + row[packs + q] * of_node[q]
            for q in range(p + 1, packs):
                s = s - row[q] * unknowns[q]
            x[a] = sum_pack(s)
        first, at = LANES * p, LANES * (tree.contacts + width * LANES * p + p)
        over = LANES * tree.vector + first
        second, third = at + LANES * width, at + 2 * LANES * width
        d = x[first + 3] * inverse[over + 3]
        c = (x[first + 2] - out[third + 3] * d) * inverse[over + 2]
        b = x[first + 1] - out[second + 3] * d - out[second + 2] * c
        b *= inverse[over + 1]
        a = x[first] - out[at + 3] * d - out[at + 2] * c - out[at + 1] * b
        x[first], x[first + 1], x[first + 2], x[first + 3] = a * inverse[over], b, c, d


@kernel
def largest_free_rate_of_trees(work):
    """:func:`multiarm.dynamics.solver.batched.largest_free_rate` of these blocks."""
    trees, largest = work.trees, 0.0
    for t in range(trees.block.shape[0]):
        tree = open_tree(trees.block[t])
        for a in range(work.first_contact[tree.block + 1] - work.first_contact[tree.block]):
            largest = max(largest, abs(trees.free[LANES * tree.vector + a]))
    return largest
