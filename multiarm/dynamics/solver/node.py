r"""The node algorithm: the objects' accelerations first, then each block on its own.

In the thesis a block is an arm; here it is a part of a robot that shares neither inertia nor rows
with others (:mod:`multiarm.dynamics.layout`).  The system (thesis, 4.9; :math:`\lambda = -\mu` is
the physical contact force, positive = pushing)

.. math::
    M_o a_o = f_o + \sum_i W_{oi} \lambda_i, \qquad
    M_i a_i = f_i + W_i \lambda_i, \qquad
    W_{oi}^T a_o + W_i^T a_i = c_i

is solved without ever assembling it.  With every block's Cholesky factor :math:`M_i = L_i L_i^T`,

.. math::
    Y_i = L_i^{-1} W_i, \quad K_i = Y_i^T Y_i = G_i G_i^T, \quad Z_i = G_i^{-1} W_{oi}^T, \quad
    S = M_o + \sum_i Z_i^T Z_i

is the *elimination*, which depends on the configuration only, and

.. math::
    y_i = L_i^{-1} f_i, \quad z_i = G_i^{-1}(c_i - Y_i^T y_i), \quad
    a_o = S^{-1}\big(f_o + \sum_i Z_i^T z_i\big), \quad
    \lambda_i = G_i^{-T}(z_i - Z_i a_o), \quad a_i = L_i^{-T}(y_i + Y_i \lambda_i)

the *solution* for one right-hand side: accelerations, velocity projections and position corrections
alike (thesis, 4.10 - 4.12).  The work grows linearly with the number of blocks; ``S`` is 6 F by 6 F
for the F objects.  Rows among objects, or between an object and the world, belong to a block
without joints, whose K is zero: they are solved together with the node, as those of singular blocks
are.

It exists when every ``K_i`` is regular: each block can move along all of its constraint directions.
Two numbers measure the distance from a singular ``K_i``: its smallest pivot relative to its
diagonal (the pivot after Jacobi scaling), and that diagonal relative to the *mobility* of the
block, :math:`\max_j r_j^2 / p_j` with the lever :math:`r_j` of each joint and the pivots
:math:`p_j` of the inertia.  The second is needed because ``K_i`` of a block that cannot move along
its contact at all consists of rounding errors, which are large relative to each other.  Blocks for
which either is small are solved by :mod:`multiarm.dynamics.solver.singular`.

This module has the arrays and the elimination of one block;
:mod:`multiarm.dynamics.solver.batched` eliminates four regular blocks at a time.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.bounds import COUPLED_BELOW, MOBILITY_WEIGHT
from multiarm.dynamics.solver.factors import copy_block, factor_cholesky, forward_columns
from multiarm.dynamics.solver.tree_tables import NO_TREES, Trees, tree_blocks
from multiarm.dynamics.status import BLOCK_INERTIA, BLOCK_NOT_FINITE, OK
from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.jit.rows import Number, row_of, width
from multiarm.jit.simd import LANES, aligned_zeros
from multiarm.jit.structs import Flag, Floats1, Floats2, Floats3, Ints1, Ints2, Numbers

NODE = 6
"""Unknowns of the node with one object: its acceleration."""


class BlockGroup(NamedTuple):
    """Numbers of a group of four blocks: a row of ``BlockGroups.group``."""

    joints: Number  # of the block with the most
    contacts: Number  # of the block with the most
    count: Number  # blocks; a group of fewer than four repeats its first one
    first: Number  # pack of its table in ``BlockGroups.tables``
    width: Number  # packs of a row of its table: joints, contacts, right-hand side, node


open_group = row_of(BlockGroup)


class BlockGroups(NamedTuple):
    """``g`` groups of four blocks (:mod:`multiarm.dynamics.solver.batched`), and their packs.

    There is none when a block has more contacts than joints: it is deficient in any posture.
    """

    group: Ints2  # (g, 5) of :class:`BlockGroup`
    blocks: Ints2  # (g, 4)
    # (g, 4 d), (g, 4 m): index of every joint and contact of the four blocks in the stacked
    # vectors; padding has that of another one
    joint_index: Ints2
    contact_index: Ints2
    # (g, 4 m), (g, 4): 1 for contacts and blocks, 0 for padding
    contact_present: Floats2
    block_present: Floats2
    stiffness: Floats2  # (g, 4 d) 1 / lever^2 of every joint; infinite for padding
    # packs: lower triangle of the node matrix, each row after its right-hand side, summed over the
    # groups; the object's unknowns; the factors of one row, as many as joints and contacts; the
    # smallest pivots of the inertia and of all; tables
    node: Floats1
    object: Floats1
    factors: Floats1
    pivot: Floats1
    tables: Floats1


class NodeStatus(Numbers):
    """How the last system was eliminated."""

    block_by_block: Flag  # else four blocks at a time: its factors are in ``BlockGroups.tables``


class NodeWork(NamedTuple):
    """Arrays of the elimination; ``n`` blocks with at most ``d`` joints and ``m`` contacts each."""

    # (n + 1,): first joint and first contact of each block in the stacked vectors
    first_joint: Ints1
    first_contact: Ints1
    # (n, d, d), (n, d, m): inertias (lower triangles; 1 on the diagonal beyond a block's joints)
    # and constraint matrices, which the kinematics write and no solver changes
    M: Floats3
    W: Floats3
    # (n, d): largest distance by which a unit turn of each joint can move a contact of its block
    # [m]; 1 for prismatic joints
    levers: Floats2
    # (n + 1,): distance of each K, and last of S, from a singular matrix (1 at best, 0 at worst)
    pivot: Floats1
    status: NodeStatus
    # of an elimination block by block (n, d, d), (n, d, m), (n, m, m), (n, m, 6 F); lower
    # triangles, diagonals inverted
    L: Floats3
    Y: Floats3
    G: Floats3
    Z: Floats3
    S: Floats2  # (6 F, 6 F) factor of the node matrix, lower triangle, diagonal inverted
    # (all joints,), (all contacts,): intermediate vectors of a solution block by block
    y: Floats1
    z: Floats1
    groups: BlockGroups
    trees: Trees


def make_work(
    joints: list[int],
    contacts: list[int],
    levers: Sequence[np.ndarray] | None = None,
    node: int = NODE,
    parents: Mapping[int, np.ndarray] = NO_TREES,
) -> NodeWork:
    """Allocate for blocks with ``joints[i]`` joints, ``contacts[i]`` contacts, and levers [m]."""
    n, d = len(joints), max(joints)
    every_lever = np.ones((n, d))
    if levers is not None:
        for row, lever in zip(every_lever, levers, strict=True):
            row[: len(lever)] = lever
    M = np.zeros((n, d, d))
    for inertia, count in zip(M, joints, strict=True):
        inertia[range(count, d), range(count, d)] = 1.0
    shapes = work_shapes(joints, contacts, node)
    work = NodeWork(
        first_joint=first_indices(joints),
        first_contact=first_indices(contacts),
        M=M,
        levers=every_lever,
        pivot=np.ones(n + 1),
        status=NodeStatus(),
        L=np.zeros((n, d, d)),
        S=np.zeros((node, node)),
        y=np.zeros(sum(joints)),
        groups=_make_groups(joints, contacts, node, parents),
        trees=tree_blocks(joints, contacts, parents, node),
        **{name: np.zeros(shape) for name, shape in shapes.items()},
    )
    tables = aligned_zeros(LANES * write_groups(group_order(joints, contacts, parents), work))
    return work._replace(groups=work.groups._replace(tables=tables))


def work_shapes(joints: list[int], contacts: list[int], node: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of :class:`NodeWork` that depend on the contacts."""
    n, d, m = len(joints), max(joints), max(contacts)
    return {
        "W": (n, d, m), "Y": (n, d, m), "G": (n, m, m), "Z": (n, m, node), "z": (sum(contacts),),
    }  # fmt: skip


def group_shapes(
    joints: list[int], contacts: list[int], trees: Collection[int] = ()
) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays of :class:`BlockGroups` that depend on the contacts."""
    d, m = max(joints), max(contacts)
    g = -(-(len(joints) - len(trees)) // LANES) if all(map(operator.ge, joints, contacts)) else 0
    return {
        "group": (g, width(BlockGroup)), "blocks": (g, LANES), "joint_index": (g, LANES * d),
        "contact_index": (g, LANES * m), "contact_present": (g, LANES * m),
        "block_present": (g, LANES), "stiffness": (g, LANES * d),
    }  # fmt: skip


def _make_groups(
    joints: list[int], contacts: list[int], node: int, trees: Collection[int]
) -> BlockGroups:
    """Allocate the groups, but for their tables."""
    whole, shapes = (
        {"group", "blocks", "joint_index", "contact_index"},
        group_shapes(joints, contacts, trees),
    )
    return BlockGroups(
        node=aligned_zeros(LANES * node * (node + 1)),
        object=aligned_zeros(LANES * node),
        factors=aligned_zeros(LANES * (max(joints) + max(contacts))),
        pivot=aligned_zeros(LANES * 2),
        tables=np.zeros(0),
        **{name: np.zeros(s, np.int64 if name in whole else float) for name, s in shapes.items()},
    )


def group_order(joints: list[int], contacts: list[int], trees: Collection[int] = ()) -> np.ndarray:
    """The blocks in the order in which they are put into groups: similar ones stand together."""
    small = [i for i in range(len(joints)) if i not in trees]
    order = sorted(small, key=lambda i: (-joints[i], -contacts[i]))
    return np.array(order, dtype=np.int64)


@plain
def write_groups(order, work):
    """Write the groups for blocks in an order; returns the number of packs of all tables."""
    groups, packs = work.groups, 0
    for g in range(groups.group.shape[0]):
        group = open_group(groups.group[g])
        group.joints = group.contacts = 0
        group.count = min(LANES, order.size - LANES * g)
        for lane in range(LANES):
            block = order[LANES * g + (lane if lane < group.count else 0)]
            groups.blocks[g, lane] = block
            groups.block_present[g, lane] = 1.0 if lane < group.count else 0.0
            write_lane(g, lane, block, work)
            group.joints = max(group.joints, joint_count(block, work))
            group.contacts = max(group.contacts, contact_count(block, work))
        unknowns = group.joints + group.contacts
        group.first, group.width = packs, unknowns + 1 + work.S.shape[0]
        packs += group.width * (unknowns + 1)  # the last row is for the unknowns
    return packs


@plain
def write_lane(g, lane, block, work):
    """Write what a group has of the joints and contacts of one of its blocks."""
    groups, d, m = work.groups, joint_count(block, work), contact_count(block, work)
    for j in range(groups.joint_index.shape[1] // LANES):
        lever, at = work.levers[block, j], LANES * j + lane
        groups.joint_index[g, at] = index_or_another(work.first_joint[block], d, j)
        groups.stiffness[g, at] = 1.0 / (lever * lever) if j < d else math.inf
    for k in range(groups.contact_index.shape[1] // LANES):
        at = LANES * k + lane
        groups.contact_index[g, at] = index_or_another(work.first_contact[block], m, k)
        groups.contact_present[g, at] = 1.0 if k < m else 0.0


@plain
def index_or_another(first, count, k):
    """Index of number ``k`` of ``count`` that begin at ``first``; one that exists for padding."""
    if k < count:
        return first + k
    return first if count > 0 else 0


@plain
def joint_count(i, work):
    """Number of joints of a block."""
    return work.first_joint[i + 1] - work.first_joint[i]


@plain
def contact_count(i, work):
    """Number of contacts of a block."""
    return work.first_contact[i + 1] - work.first_contact[i]


def first_indices(counts: list[int]) -> np.ndarray:
    """Index of the first of each block in a vector of all, and last the number of all, (n + 1,)."""
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


# --- vectors of the node --------------------------------------------------------------------------


@inlined
def set_vector(row, out):
    """``out = row``."""
    for k in range(row.size):
        out[k] = row[k]


@inlined
def scale_vector(factor, out):
    """``out *= factor``."""
    for k in range(out.size):
        out[k] *= factor


@inlined
def add_multiple(factor, row, out):
    """``out += factor row``."""
    for k in range(row.size):
        out[k] += factor * row[k]


@inlined
def less_product(s, row, x):
    """``s - row . x``."""
    for k in range(row.size):
        s -= row[k] * x[k]
    return s


@inlined
def add_square(z, S):
    """``S += z z^T``, in the lower triangle."""
    for k in range(z.size):
        for l in range(k + 1):
            S[k, l] += z[k] * z[l]


# --- elimination and solution, block by block -----------------------------------------------------


@kernel
def mobility(L, n, levers):
    """Largest possible acceleration by a unit force [1/kg]; ``L`` is the factor of the inertia."""
    most = 0.0
    for j in range(n):
        reach = levers[j] * L[j, j]
        most = max(most, reach * reach)
    return most


@kernel
def failure_of_inertia(M, n):
    """The status of a block whose inertia has no Cholesky factor."""
    for j in range(n):
        for k in range(j + 1):
            if not math.isfinite(M[j, k]):
                return BLOCK_NOT_FINITE
    return BLOCK_INERTIA


@inlined
def eliminate_block(i, work, W_o):
    """Factor block ``i``, and write its ``NodeWork.pivot``; returns a status.

    ``work.M[i]`` is the block's inertia (lower triangle), ``work.W[i]`` its ``W`` (one column a
    contact) and ``W_o`` (N, 6 F) the objects' rows.
    """
    n, first, m = joint_count(i, work), work.first_contact[i], contact_count(i, work)
    L, Y, G, Z = work.L[i], work.Y[i], work.G[i], work.Z[i]
    copy_block(work.M[i], n, n, L)
    copy_block(work.W[i], n, m, Y)
    inertia_pivot = factor_cholesky(L, n)
    if not inertia_pivot > 0.0:
        work.pivot[i] = 0.0
        return failure_of_inertia(work.M[i], n)
    forward_columns(L, Y, n, m)
    for a in range(m):
        for b in range(a + 1):
            G[a, b] = 0.0
    for j in range(n):
        for a in range(m):
            factor = Y[j, a]
            for b in range(a + 1):
                G[a, b] += factor * Y[j, b]
    least = mobility(L, n, work.levers[i]) / MOBILITY_WEIGHT
    pivot = 1.0
    for a in range(m):
        pivot = min(pivot, G[a, a] / least)
    work.pivot[i] = pivot = min(pivot, factor_cholesky(G, m))
    if not pivot > COUPLED_BELOW:
        return OK
    reduce_object_rows(G, W_o, first, m, Z)
    return OK


@inlined
def reduce_object_rows(G, W_o, first, m, Z):
    """Write ``Z = G^-1 W_o^T`` of a block with ``m`` contacts, of which ``first`` is the first."""
    for a in range(m):
        set_vector(W_o[first + a], Z[a])
        for b in range(a):
            add_multiple(-G[a, b], Z[b], Z[a])
        scale_vector(G[a, a], Z[a])


@inlined
def add_to_node(i, work):
    """Add ``Z^T Z`` of an eliminated block to the node matrix."""
    for a in range(contact_count(i, work)):
        add_square(work.Z[i, a], work.S)


@kernel
def eliminate_blocks(work, W_o):
    """Factor all blocks, one after the other, from what :func:`eliminate_block` describes.

    Returns a status, and the block whose inertia failed where it is not ``OK``.  The pivots are
    left in ``work.pivot``: blocks for which it is not above ``COUPLED_BELOW`` have only ``L`` and
    ``Y``.
    """
    work.status.block_by_block = True
    for i in range(work.first_joint.size - 1):
        status = eliminate_block(i, work, W_o)
        if status != OK:
            return status, i
    return OK, 0


@inlined
def unconstrained_motion(i, work, f_j):
    """``y = L^-1 f_j`` of a block."""
    d0, d = work.first_joint[i], joint_count(i, work)
    L, y = work.L[i], work.y
    for j in range(d):
        s = f_j[d0 + j]
        for k in range(j):
            s -= L[j, k] * y[d0 + k]
        y[d0 + j] = s * L[j, j]


@inlined
def reduce_constraints(i, work, c, a_o):
    """``z`` of a block; adds ``Z^T z`` to the object's right-hand side ``a_o``."""
    d0, d = work.first_joint[i], joint_count(i, work)
    r0, m = work.first_contact[i], contact_count(i, work)
    Y, G, Z, y, z = work.Y[i], work.G[i], work.Z[i], work.y, work.z
    for a in range(m):
        z[r0 + a] = c[r0 + a]
    for j in range(d):
        s = y[d0 + j]
        for a in range(m):
            z[r0 + a] -= Y[j, a] * s
    for a in range(m):
        s = z[r0 + a]
        for b in range(a):
            s -= G[a, b] * z[r0 + b]
        s *= G[a, a]
        z[r0 + a] = s
        add_multiple(s, Z[a], a_o)


@inlined
def recover_forces(i, work, a_o, force):
    """Contact forces of a block for the object's ``a_o``."""
    r0, m = work.first_contact[i], contact_count(i, work)
    G, Z, z = work.G[i], work.Z[i], work.z
    for a in range(m):
        force[r0 + a] = less_product(z[r0 + a], Z[a], a_o)
    for a in range(m - 1, -1, -1):
        s = force[r0 + a] * G[a, a]
        force[r0 + a] = s
        for b in range(a):
            force[r0 + b] -= G[a, b] * s


@inlined
def recover_joints(i, work, Y, force, a_j):
    """Joint accelerations of a block for its contact forces; ``Y`` is ``L^-1 W``, or of ``W~``."""
    d0, d = work.first_joint[i], joint_count(i, work)
    r0, m = work.first_contact[i], contact_count(i, work)
    L, y = work.L[i], work.y
    for j in range(d):
        s = y[d0 + j]
        for a in range(m):
            s += Y[j, a] * force[r0 + a]
        a_j[d0 + j] = s
    for j in range(d - 1, -1, -1):
        s = a_j[d0 + j] * L[j, j]
        a_j[d0 + j] = s
        for k in range(j):
            a_j[d0 + k] -= L[j, k] * s
