"""The arrays of the node algorithm.

Arms are eliminated four at a time (:mod:`multiarm.dynamics.solver.batched`), those of equal sizes
together.  Each such group has a table in ``NodeWork.packs``, in which the numbers of its four arms
follow each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.jit.simd import LANES, aligned_zeros
from multiarm.jit.structs import Floats1, Floats2, Floats3, Ints1, Ints2

# Columns of NodeWork.groups: joints and contacts of the largest arm, number of arms, place and
# width of the table, the four arms.
JOINTS, CONTACTS, COUNT, START, WIDTH, FIRST_ARM = range(6)
GROUP_WIDTH = FIRST_ARM + LANES

# What stands in NodeWork.packs before the tables: the node matrix's lower triangle, each row behind
# its right-hand side; the object's unknowns, scratch before; scratch for a row's factors.
NODE_AT, NODE_WIDTH = 0, 7
OBJECT_AT = NODE_AT + LANES * 6 * NODE_WIDTH
FACTORS_AT = OBJECT_AT + LANES * 6


class NodeWork(NamedTuple):
    """Arrays of the elimination.  ``n`` arms, at most ``d`` joints and ``m`` contacts an arm.

    dofs, rows : int64 (n + 1,)
        Where each arm's joints and contacts start in the stacked vectors.
    L : (n, d, d), Y : (n, d, m)
        Inertias (lower triangles; 1 on the diagonal beyond an arm's joints) and constraint matrices
        ``W``; or, where arms were eliminated one by one, factors as in
        :mod:`multiarm.dynamics.solver.regular`, diagonals inverted.
    factored : int64 (1,)
        Whether ``L`` and ``Y`` hold the factors.
    G : (n, m, m), Z : (n, m, 6)
        The other factors; lower triangles, diagonals inverted.
    S : (6, 6)
        Factor of the node matrix, lower triangle, diagonal inverted.
    y : (dofs[n],), z : (rows[n],)
        Intermediate vectors of a solution arm by arm.
    levers : (n, d)
        How far a unit turn of each joint may move a contact of its arm, at most [m]; 1 for joints
        that slide.
    pivot : (n + 1,)
        How far each ``K_i`` is from being singular (1 at best, 0 at worst), and ``S`` last.
    groups : int64 (g, 10)
        The groups of four arms; none when an arm has more contacts than joints, so that it is
        deficient in any posture.  A group of fewer arms repeats its first one.
    places : int64 (g, 4 d + 4 m)
        Of every joint and contact of a group, where it stands in the stacked vectors of the arms.
    present : (g, 4 m + 4)
        Of every contact of a group, and last of its arms: 1 where it is there, 0 where it fills up.
    stiffness : (g, 4 d)
        Of every joint of a group, ``1 / lever^2``; infinite where it fills up.
    packs : float64
        Shares of the node matrix, scratch, and the tables.
    """

    dofs: Ints1
    rows: Ints1
    L: Floats3
    Y: Floats3
    factored: Ints1
    G: Floats3
    Z: Floats3
    S: Floats2
    y: Floats1
    z: Floats1
    levers: Floats2
    pivot: Floats1
    groups: Ints2
    places: Ints2
    present: Floats2
    stiffness: Floats2
    packs: Floats1


def make_work(
    dofs: list[int], rows: list[int], levers: Sequence[np.ndarray] | None = None
) -> NodeWork:
    """Allocate for arms with ``dofs[i]`` joints and ``rows[i]`` contacts.

    ``levers[i]`` (dofs[i],) are the levers of the arm's joints [m], 1 m when left out.
    """
    n, d, m = len(dofs), max(dofs), max(rows)
    every_lever = make_levers(dofs, levers)
    L = np.zeros((n, d, d))
    for inertia, own in zip(L, dofs, strict=True):
        inertia[range(own, d), range(own, d)] = 1.0
    groups, size = _group(dofs, rows)
    places, present = _fill_up(groups, dofs, rows)
    return NodeWork(
        dofs=_starts(dofs),
        rows=_starts(rows),
        L=L,
        Y=np.zeros((n, d, m)),
        factored=np.zeros(1, dtype=np.int64),
        G=np.zeros((n, m, m)),
        Z=np.zeros((n, m, 6)),
        S=np.zeros((6, 6)),
        y=np.zeros(sum(dofs)),
        z=np.zeros(sum(rows)),
        levers=every_lever,
        pivot=np.ones(n + 1),
        groups=groups,
        places=places,
        present=present,
        stiffness=_stiffness(groups, dofs, every_lever),
        packs=aligned_zeros(size),
    )


def make_levers(dofs: list[int], levers: Sequence[np.ndarray] | None) -> np.ndarray:
    """``NodeWork.levers``."""
    every = np.ones((len(dofs), max(dofs)))
    if levers is not None:
        for row, own in zip(every, levers, strict=True):
            row[: len(own)] = own
    return every


def _stiffness(groups: np.ndarray, dofs: list[int], levers: np.ndarray) -> np.ndarray:
    """``NodeWork.stiffness``."""
    stiffness = np.full((len(groups), levers.shape[1], LANES), np.inf)
    for g, group in enumerate(groups):
        for lane, i in enumerate(group[FIRST_ARM:]):
            stiffness[g, : dofs[i], lane] = 1.0 / levers[i, : dofs[i]] ** 2
    return stiffness.reshape(len(groups), LANES * levers.shape[1])


def _group(dofs: list[int], rows: list[int]) -> tuple[np.ndarray, int]:
    """``NodeWork.groups`` and the size of ``NodeWork.packs``."""
    groups: list[list[int]] = []
    size = FACTORS_AT + LANES * (max(dofs) + max(rows))
    if all(d >= m for d, m in zip(dofs, rows, strict=True)):
        order = sorted(range(len(dofs)), key=lambda i: (-dofs[i], -rows[i]))
        for first in range(0, len(order), LANES):
            arms = order[first : first + LANES]
            d, m = max(dofs[i] for i in arms), max(rows[i] for i in arms)
            width = d + m + NODE_WIDTH
            spare = arms[:1] * (LANES - len(arms))
            groups.append([d, m, len(arms), size, width, *arms, *spare])
            size += LANES * width * (d + m + 1)  # the last row is for the unknowns
    return np.array(groups, dtype=np.int64).reshape(-1, GROUP_WIDTH), size


def _fill_up(groups: np.ndarray, dofs: list[int], rows: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """``NodeWork.places`` and ``NodeWork.present``."""
    d, m = max(dofs), max(rows)
    places = np.zeros((len(groups), d + m, LANES), dtype=np.int64)
    present = np.zeros((len(groups), m + 1, LANES))
    for g, group in enumerate(groups):
        for lane, i in enumerate(group[FIRST_ARM:]):
            for own, sizes in ((slice(0, d), dofs), (slice(d, d + m), rows)):
                first = sum(sizes[:i])
                # what fills up reads from somewhere
                places[g, own, lane] = first + np.arange(own.stop - own.start)
                places[g, own, lane][sizes[i] :] = first if sizes[i] else 0
            present[g, : rows[i], lane] = 1.0
            present[g, m, lane] = float(lane < group[COUNT])
    shapes = (len(groups), LANES * (d + m)), (len(groups), LANES * (m + 1))
    return places.reshape(shapes[0]), present.reshape(shapes[1])


def _starts(sizes: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
