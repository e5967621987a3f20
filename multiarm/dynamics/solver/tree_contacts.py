"""The contacts of a block that is a tree: rows of K beside the right-hand side and ``W_o^T``.

See :mod:`multiarm.dynamics.solver.trees`.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.tree_tables import open_tree, packs_of_row
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import LANES, broadcast, load_pack, packs_of, store_pack


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
    for p in range(first, end):
        subtract_from_rows(
            out + width * LANES * p, width, min(LANES, m - LANES * p), own + tree.left, stride,
            count, trees.scaled, factors + LANES * p, LANES * stride, p, end,
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
def subtract_from_rows(out, width, lines, rows, stride, count, factors, at, step, low, high):
    """:func:`subtract_rows` from up to four rows, ``lines``, whose factors follow each other."""
    if lines < LANES:
        for a in range(lines):
            subtract_rows(out + width * a, rows, stride, count, factors, at + a, step, low, high)
        return
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
    for a in range(m):
        row = LANES * (first + width * a)
        out[row + LANES * packs] -= trees.free[vector + a]
        diagonal = inverse[vector + a] = out[row + a]
        weakest = min(weakest, -diagonal)
    for p in range(packs):
        begin, lines = LANES * p, min(LANES, m - LANES * p)
        for b in range(begin):
            of_four[b] = rows[width * b + p] * broadcast(inverse[vector + b])
        subtract_from_rows(
            rows + width * begin, width, lines, rows, width, begin, factors, 0, LANES, p, width
        )
        for a in range(begin, begin + lines):
            column = a - begin
            subtract_rows(
                rows + width * a, rows + width * begin, width, column, factors,
                LANES * begin + column, LANES, p, width,
            )  # fmt: skip
            pivot, diagonal = out[LANES * (first + width * a) + a], inverse[vector + a]
            if not pivot < 0.0:
                return 0.0, 0.0
            relative = min(relative, pivot / diagonal)
            inverse[vector + a] = 1.0 / pivot
            of_four[a] = rows[width * a + p] * broadcast(1.0 / pivot)
    return relative, weakest


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
        for n in range(lines):
            for p in range(high):
                products[right * n + p] = broadcast(0.0)
        subtract_from_rows(products, right, lines, rows, width, m, trees.factors, 0, LANES, 0, high)
        for n in range(lines):
            for l in range(k + n + 2):
                sums[LANES * ((node + 1) * (k + n) + l)] += trees.products[LANES * right * n + l]


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
