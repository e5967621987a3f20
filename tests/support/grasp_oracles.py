"""Exact arithmetic and a body with a hole, for claims about grasps."""

from __future__ import annotations

from fractions import Fraction

from multiarm.grasp.body.polyhedron import Polyhedron

SQUARE = [(1, 1), (-1, 1), (-1, -1), (1, -1)]


def rational_rank(rows):
    """Rank of rows of whole numbers or fractions, without rounding."""
    rows, rank = [list(map(Fraction, row)) for row in rows], 0
    for column in range(len(rows[0])):
        pivot = next((i for i in range(rank, len(rows)) if rows[i][column]), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for i in range(rank + 1, len(rows)):
            factor = rows[i][column] / rows[rank][column]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[rank], strict=True)]
        rank += 1
    return rank


def plate_with_hole() -> Polyhedron:
    """A square plate of side 4 and thickness 1 with a square hole of side 2 through it."""
    outer, inner = [(2 * x, 2 * y) for x, y in SQUARE], SQUARE
    vertices = [[x, y, z] for z in (0, 1) for x, y in (*outer, *inner)]
    loops = [[[8, 9, 10, 11], [15, 14, 13, 12]], [[3, 2, 1, 0], [4, 5, 6, 7]]]
    for k in range(4):
        n = (k + 1) % 4
        loops += [[[k, n, 8 + n, 8 + k]], [[4 + n, 4 + k, 12 + k, 12 + n]]]
    return Polyhedron(vertices, loops)
