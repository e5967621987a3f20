r"""The node algorithm with friction: contact forces have other directions than the constraints.

Sliding friction turns the force of a contact away from its normal, while the constraint stays along
the normal: the *reaction matrices* :math:`\tilde W` differ from the constraint matrices ``W``
(thesis, 4.9 and its footnote; :math:`\lambda = -\mu` is the physical contact force)

.. math::
    M_o a_o = f_o + \sum_i \tilde W_{oi} \lambda_i, \qquad
    M_i a_i = f_i + \tilde W_i \lambda_i, \qquad
    W_{oi}^T a_o + W_i^T a_i = c_i

With :math:`M_i = L_i L_i^T`, :math:`Y_i = L_i^{-1} W_i`, :math:`\tilde Y_i = L_i^{-1} \tilde W_i`,
the elimination is that of :mod:`multiarm.dynamics.solver.node` with matrices that are not
symmetric, and LU factors with pivoting instead of Cholesky's:

.. math::
    K_i = Y_i^T \tilde Y_i, \qquad S = M_o + \sum_i \tilde W_{oi} K_i^{-1} W_{oi}^T, \qquad
    a_o = S^{-1} \big(f_o + \sum_i \tilde W_{oi} K_i^{-1} z_i\big), \qquad
    \lambda_i = K_i^{-1} (z_i - W_{oi}^T a_o)

with :math:`z_i = c_i - Y_i^T L_i^{-1} f_i`.  Blocks whose ``K_i`` is singular, or nearly so, are
solved together with the object (:mod:`multiarm.dynamics.solver.reaction_coupling`); if ``S`` is,
all blocks are.  The cost grows linearly with the number of the other blocks.

With friction a solution need not exist, nor be unique (Painleve): ``ReactionWork.null_constraint``
and ``ReactionStatus.motions`` say so.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.bounds import (
    COUPLING_TOLERANCE,
    MOBILITY_WEIGHT,
    STIFFER_THAN_OBJECT,
)
from multiarm.dynamics.solver.factors import (
    backward,
    copy_block,
    copy_lower,
    factor_cholesky,
    factor_lu,
    forward,
    forward_columns,
)
from multiarm.dynamics.solver.node import (
    NODE,
    add_multiple,
    add_square,
    contact_count,
    failure_of_inertia,
    first_indices,
    joint_count,
    less_product,
    mobility,
    recover_joints,
    reduce_object_rows,
    unconstrained_motion,
)
from multiarm.dynamics.solver.reaction_coupling import (
    decompose_coupled,
    solve_block,
    solve_object,
)
from multiarm.dynamics.status import BLOCK_NOT_FINITE, NOT_FINITE, OBJECT_INERTIA, OK
from multiarm.jit.kernels import clear, copy, inlined, kernel
from multiarm.jit.structs import Float, Floats1, Floats2, Floats3, Int, Ints1, Ints2, Numbers


class ReactionStatus(Numbers):
    """How the coupled system was decomposed."""

    contacts: Int  # of the coupled blocks
    length: Int  # entries of a column of G: of the node, and of the joints of the coupled blocks
    rank: Int  # of G
    reaction_rank: Int  # of G~
    core_rank: Int
    null_forces: Int  # number of vectors in ``null_force``
    null_constraints: Int  # number of vectors in ``null_constraint``
    motions: Int  # number of null forces that move the system: if any, the motion is not unique
    evenness: Float  # how evenly the blocks stiffen the object, 1 at best


class ReactionWork(NamedTuple):
    """Arrays of the elimination: ``n`` blocks, at most ``d`` joints and ``m`` contacts a block.

    Together they have D joints and N contacts.
    """

    # as in NodeWork
    first_joint: Ints1
    first_contact: Ints1
    levers: Floats2
    # (n, d, d), (n, d, m): inertias (lower triangles), W and W~; none of them is changed
    M: Floats3
    W: Floats3
    Wr: Floats3
    # (n, d, d), (n, d, m): factors of the inertias (lower triangles, diagonals inverted); L^-1 W,
    # L^-1 W~
    L: Floats3
    Y: Floats3
    Yr: Floats3
    # (n, m, m), (n, m), (N,): LU factors of K scaled by rows and columns; the scales
    K: Floats3
    K_pivots: Ints2
    block_scale: Floats1
    block_scale_r: Floats1
    # (6 F, 6 F): factors of the objects' inertia and of the node matrix without friction
    Lo: Floats2
    Ls: Floats2
    # (6 F, 6 F), (6 F,): LU factors of Ls^-1 S Ls^-T
    node: Floats2
    node_pivots: Ints1
    coupled: Ints1  # (n,) which blocks are coupled
    undetermined: Ints1  # (n,) whose forces take part in an undetermined motion
    # (n + 1,): distance of each K from a singular matrix, with and without friction; last of the
    # node's
    pivot: Floats1
    whitened: Floats2  # (6 F, 6 F) scratch: the same in units of the object's inertia
    status: ReactionStatus
    place: Ints1  # (N,) row of each coupled contact in the stacked vectors
    # (N,): scales of the columns of G and G~
    scale: Floats1
    scale_r: Floats1
    # (N, 6 F + D), (N, N), (N,): decompositions of G and G~, one vector a row
    U: Floats2
    Ur: Floats2
    V: Floats2
    Vr: Floats2
    sigma: Floats1
    sigma_r: Floats1
    # (N, N), (N,): decompositions of the core and of its transpose
    core: Floats2
    core_V: Floats2
    core_left: Floats2
    core_left_V: Floats2
    core_sigma: Floats1
    core_left_sigma: Floats1
    # (N, N + 6 F): contact forces without effect on the constraints, with the object's motion that
    # they cause; combinations of constraints that no contact force affects
    null_force: Floats2
    null_constraint: Floats2
    # (D,), (N,): accelerations without contacts, times L^T; what the contact forces must cause
    y: Floats1
    z: Floats1
    # (N,): intermediate vectors
    left: Floats1
    right: Floats1
    unloaded: Floats1  # (6 F,) the objects' accelerations without contacts
    without_friction: Floats2  # (m, m) factor of ``Y^T Y`` of a block
    # scratch (6 F,), (m,), (m, 6 F)
    node_vector: Floats1
    block_vector: Floats1
    block_rows: Floats2


def make_reaction_work(joints: list[int], contacts: list[int], node: int = NODE) -> ReactionWork:
    """Allocate for blocks with ``joints[i]`` joints, ``contacts[i]`` contacts, levers of 1 m."""
    n, d, D = len(joints), max(joints), sum(joints)
    shapes = {
        "M": (n, d, d), "L": (n, d, d), "levers": (n, d), "Lo": (node, node), "Ls": (node, node),
        "node": (node, node), "node_pivots": (node,), "coupled": (n,), "undetermined": (n,),
        "pivot": (n + 1,), "whitened": (node, node), "y": (D,), "unloaded": (node,),
        "node_vector": (node,),
        **reaction_shapes(joints, contacts, node),
    }  # fmt: skip
    whole = {"K_pivots", "node_pivots", "coupled", "undetermined", "place"}
    work = ReactionWork(
        first_joint=first_indices(joints),
        first_contact=first_indices(contacts),
        status=ReactionStatus(),
        **{name: np.zeros(s, np.int64 if name in whole else float) for name, s in shapes.items()},
    )
    work.levers[:] = 1.0
    return work


def reaction_shapes(
    joints: list[int], contacts: list[int], node: int
) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that depend on the contacts."""
    n, d, m, D, N = len(joints), max(joints), max(contacts), sum(joints), sum(contacts)
    return {
        "W": (n, d, m), "Wr": (n, d, m), "Y": (n, d, m), "Yr": (n, d, m), "K": (n, m, m),
        "K_pivots": (n, m),
        "block_scale": (N,), "block_scale_r": (N,), "place": (N,), "scale": (N,), "scale_r": (N,),
        "U": (N, node + D), "Ur": (N, node + D), "V": (N, N), "Vr": (N, N), "sigma": (N,),
        "sigma_r": (N,), "core": (N, N), "core_V": (N, N), "core_left": (N, N),
        "core_left_V": (N, N), "core_sigma": (N,), "core_left_sigma": (N,),
        "null_force": (N, N + node), "null_constraint": (N, N + node), "z": (N,), "left": (N,),
        "right": (N,), "without_friction": (m, m), "block_vector": (m,), "block_rows": (m, node),
    }  # fmt: skip


@kernel
def eliminate_with_reactions(work, W_o, Wr_o, object_inertia, couple_all=False):
    """Factor the whole system; returns a status, and the block that ``BLOCK_...`` speak of.

    With ``couple_all`` every block is solved together with the object, whatever its pivots are.

    ``work.M[i]`` are the blocks' inertias (lower triangles), ``work.W[i]`` and ``work.Wr[i]`` their
    ``W`` and ``W~`` (one column a contact), ``W_o`` and ``Wr_o`` (N, 6 F) the objects' rows.
    """
    n, node = work.coupled.size, work.Lo.shape[0]
    copy_lower(object_inertia, node, work.Lo)
    if not factor_cholesky(work.Lo, node) > 0.0:
        return OBJECT_INERTIA, 0
    for i in range(n):
        status = factor_block(i, work)
        if status != OK:
            return status, i
        work.coupled[i] = 0 if work.pivot[i] > COUPLING_TOLERANCE and not couple_all else 1
    work.pivot[n] = factor_node(work, W_o, Wr_o, object_inertia)
    if not work.status.evenness > COUPLING_TOLERANCE:
        for i in range(n):
            # blocks that are stiffer than the object alone leave no digits of its inertia
            if relative_mobility(i, work, W_o) < STIFFER_THAN_OBJECT:
                work.coupled[i] = 1
        work.pivot[n] = factor_node(work, W_o, Wr_o, object_inertia)
    if not work.pivot[n] > COUPLING_TOLERANCE:
        for i in range(n):
            work.coupled[i] = 1
        factor_node(work, W_o, Wr_o, object_inertia)
    return (OK if decompose_coupled(work, W_o, Wr_o) else NOT_FINITE), 0


@kernel
def factor_block(i, work):
    """Factor a block's inertia and ``K``, write its ``ReactionWork.pivot``; returns a status."""
    n, first, m = joint_count(i, work), work.first_contact[i], contact_count(i, work)
    L, Y, Yr, K = work.L[i], work.Y[i], work.Yr[i], work.K[i]
    copy_block(work.M[i], n, n, L)
    copy_block(work.W[i], n, m, Y)
    copy_block(work.Wr[i], n, m, Yr)
    if not factor_cholesky(L, n) > 0.0:
        work.pivot[i] = 0.0
        return failure_of_inertia(work.M[i], n)
    forward_columns(L, Y, n, m)
    forward_columns(L, Yr, n, m)
    gram(Y, Y, n, m, K)
    least, mobile = mobility(L, n, work.levers[i]) / MOBILITY_WEIGHT, 1.0
    for a in range(m):
        norm, norm_r = 0.0, 0.0
        for j in range(n):
            norm += Y[j, a] * Y[j, a]
            norm_r += Yr[j, a] * Yr[j, a]
        if not math.isfinite(norm + norm_r):
            work.pivot[i] = math.nan
            return BLOCK_NOT_FINITE
        mobile = min(mobile, norm / least, norm_r / least)
        work.block_scale[first + a] = 1.0 / math.sqrt(norm) if norm > 0.0 else 1.0
        work.block_scale_r[first + a] = 1.0 / math.sqrt(norm_r) if norm_r > 0.0 else 1.0
    without_friction = factor_cholesky(K, m)
    gram(Y, Yr, n, m, K)
    for a in range(m):
        for b in range(m):
            K[a, b] *= work.block_scale[first + a] * work.block_scale_r[first + b]
    regular = factor_lu(K, m, work.K_pivots[i])
    work.pivot[i] = max(0.0, min(mobile, without_friction, regular))
    return OK


@kernel
def relative_mobility(i, work, W_o):
    """Smallest mobility of a block along its contacts, relative to that of the object alone."""
    smallest, x = 1.0, work.node_vector
    for row in range(work.first_contact[i], work.first_contact[i + 1]):
        square = 0.0
        copy(W_o[row], x)
        forward(work.Lo, x.size, x)
        for k in range(x.size):
            square += x[k] * x[k]
        square *= work.block_scale[row] * work.block_scale[row]  # one over that of the block
        if square > 1.0:
            smallest = min(smallest, 1.0 / square)
    return smallest


@inlined
def gram(A, B, n, m, K):
    """Write ``A^T B``."""
    for a in range(m):
        for b in range(m):
            s = 0.0
            for j in range(n):
                s += A[j, a] * B[j, b]
            K[a, b] = s


@kernel
def factor_node(work, W_o, Wr_o, object_inertia):
    """Node matrix of blocks that are not coupled, in inertia coordinates; its relative pivot."""
    S, C, node = work.node, work.block_rows, work.node.shape[0]
    copy_block(object_inertia, node, node, S)
    copy_lower(object_inertia, node, work.Ls)
    for i in range(work.coupled.size):
        if work.coupled[i] != 0:
            continue
        first = work.first_contact[i]
        solve_object_rows(i, work, W_o, C)
        for a in range(contact_count(i, work)):
            for k in range(node):
                add_multiple(Wr_o[first + a, k], C[a], S[k])
        add_without_friction(i, work, W_o)
    work.status.evenness = evenness(work)
    if not factor_cholesky(work.Ls, node) > 0.0:
        return 0.0
    whiten(S, work.Ls)
    return factor_lu(S, node, work.node_pivots)


@inlined
def evenness(work):
    """Smallest pivot of the node matrix without friction, in units of the object's inertia.

    Relative to its largest entry: 1 without any block.
    """
    T, node, largest, smallest = work.whitened, work.Ls.shape[0], 0.0, math.inf
    for k in range(node):
        for l in range(k + 1):
            T[k, l] = T[l, k] = work.Ls[k, l]
    whiten(T, work.Lo)
    for k in range(node):
        largest = max(largest, T[k, k])
    if not factor_cholesky(T, node) > 0.0:
        return 0.0
    for k in range(node):
        smallest = min(smallest, 1.0 / (T[k, k] * T[k, k]))
    return smallest / largest


@kernel
def whiten(S, L):
    """Write ``L^-1 S L^-T`` in place."""
    node = L.shape[0]
    for _ in range(2):  # S becomes S^T L^-T = (L^-1 S)^T
        for k in range(node):
            for l in range(k):
                S[k, l], S[l, k] = S[l, k], S[k, l]
        for k in range(node):
            forward(L, node, S[k])


@inlined
def solve_object_rows(i, work, W_o, C):
    """Write ``K^-1 W_o^T`` of one block, (m, 6 F)."""
    first, m, u = work.first_contact[i], contact_count(i, work), work.block_vector
    for k in range(W_o.shape[1]):
        for a in range(m):
            u[a] = W_o[first + a, k]
        solve_block(i, work, u, False)
        for a in range(m):
            C[a, k] = u[a]


@inlined
def add_without_friction(i, work, W_o):
    """Add ``W_o (Y^T Y)^-1 W_o^T`` of one block to ``Ls``."""
    m, G, Z = contact_count(i, work), work.without_friction, work.block_rows
    gram(work.Y[i], work.Y[i], joint_count(i, work), m, G)
    factor_cholesky(G, m)
    reduce_object_rows(G, W_o, work.first_contact[i], m, Z)
    for a in range(m):
        add_square(Z[a], work.Ls)


@kernel
def solve_for_reactions(work, W_o, Wr_o, f_o, f_j, c, a_o, a_j, force):
    """Solve the eliminated system for one right-hand side.

    Parameters
    ----------
    W_o, Wr_o : (N, 6 F)
        The objects' rows, as in :func:`eliminate_with_reactions`.
    f_o : (6 F,), f_j : (D,), c : (N,)
        Right-hand sides, blocks stacked.
    a_o : (6 F,), a_j : (D,), force : (N,), written
        Object's and joints' unknowns, and the physical contact forces ``lambda = -mu``.
    """
    unconstrained_motions(work, W_o, f_o, f_j, c)
    accelerate_object(work, W_o, Wr_o, f_o, a_o, force)
    for i in range(work.coupled.size):
        if work.coupled[i] == 0:
            first, end = work.first_contact[i], work.first_contact[i + 1]
            part = force[first:end]
            for a in range(end - first):
                part[a] = less_product(work.z[first + a], W_o[first + a], a_o)
            solve_block(i, work, part, False)
    take_least_forces(work, a_o, force)
    if work.status.null_forces > work.status.motions:
        keep_constraints(work, W_o, Wr_o, a_o, force)
    for i in range(work.coupled.size):
        recover_joints(i, work, work.Yr[i], force, a_j)


@inlined
def unconstrained_motions(work, W_o, f_o, f_j, c):
    """Accelerations without contacts, and ``z``, which the contact forces must cause.

    Contradictions are removed from ``z`` by the least change.
    """
    copy(f_o, work.unloaded)
    forward(work.Lo, f_o.size, work.unloaded)
    backward(work.Lo, f_o.size, work.unloaded)
    for i in range(work.coupled.size):
        d0, first = work.first_joint[i], work.first_contact[i]
        unconstrained_motion(i, work, f_j)
        for a in range(contact_count(i, work)):
            work.z[first + a] = c[first + a]
            for j in range(joint_count(i, work)):
                work.z[first + a] -= work.Y[i, j, a] * work.y[d0 + j]
    for v in range(work.status.null_constraints):
        vector, along = work.null_constraint[v], 0.0
        for row in range(c.size):
            along += vector[row] * work.z[row]
            for k in range(f_o.size):
                along -= vector[row] * W_o[row, k] * work.unloaded[k]
        for row in range(c.size):
            work.z[row] -= along * vector[row]


@inlined
def accelerate_object(work, W_o, Wr_o, f_o, a_o, force):
    """The object's acceleration ``a_o`` and the forces of the coupled blocks."""
    copy(f_o, a_o)
    for i in range(work.coupled.size):
        if work.coupled[i] == 0:  # with the forces that hold it still
            first, end = work.first_contact[i], work.first_contact[i + 1]
            part = force[first:end]
            for a in range(end - first):
                part[a] = work.z[first + a]
            solve_block(i, work, part, False)
            for a in range(end - first):
                add_multiple(part[a], Wr_o[first + a], a_o)
    if work.status.contacts > 0:
        x, missing, place = work.node_vector, work.left, work.place
        copy(a_o, x)
        solve_object(work, x)
        for a in range(work.status.contacts):
            missing[a] = less_product(work.z[place[a]], W_o[place[a]], x)
            force[place[a]] = 0.0
        add_coupled_forces(work, Wr_o, force, a_o)
    solve_object(work, a_o)


@inlined
def take_least_forces(work, a_o, force):
    """Take from the forces what has no effect on the constraints: they are of least norm."""
    total = force.size
    for v in range(work.status.null_forces):
        vector, along = work.null_force[v], 0.0
        for a in range(total):
            along += vector[a] * force[a]
        for a in range(total):
            force[a] -= along * vector[a]
        add_multiple(-along, vector[total:], a_o)


@kernel
def keep_constraints(work, W_o, Wr_o, a_o, force):
    """Let the coupled blocks keep their constraints to the last digits.

    Forces that nearly balance each other, and were taken as if they did, have moved the system.
    """
    missing, x, k = work.left, work.node_vector, 0
    for i in range(work.coupled.size):
        if work.coupled[i] == 0:
            continue
        first, m, Y, Yr = work.first_contact[i], contact_count(i, work), work.Y[i], work.Yr[i]
        for a in range(m):
            missing[k] = less_product(work.z[first + a], W_o[first + a], a_o)
            for j in range(joint_count(i, work)):
                for b in range(m):
                    missing[k] -= Y[j, a] * Yr[j, b] * force[first + b]
            k += 1
    clear(x)
    add_coupled_forces(work, Wr_o, force, x)
    solve_object(work, x)
    add_multiple(1.0, x, a_o)
    for i in range(work.coupled.size):
        if work.coupled[i] != 0:
            continue
        first, m, change = work.first_contact[i], contact_count(i, work), work.block_vector
        for a in range(m):
            change[a] = less_product(0.0, W_o[first + a], x)
        solve_block(i, work, change, False)
        for a in range(m):
            force[first + a] += change[a]


@kernel
def add_coupled_forces(work, Wr_o, force, wrench):
    """Add the solution of ``F lambda = d`` to the forces, and its wrench to the one on the object.

    By the decompositions; ``d`` is in ``work.left``, which is overwritten.
    """
    status, count, place = work.status, work.status.contacts, work.place
    left, right = work.left, work.right
    for a in range(count):
        left[a] *= work.scale[a]
    for i in range(status.rank):
        s = 0.0
        for a in range(count):
            s += work.V[i, a] * left[a]
        right[i] = s / work.sigma[i]
    for p in range(status.core_rank):
        s = 0.0
        for i in range(status.rank):
            s += work.core[p, i] * right[i]
        left[p] = s / work.core_sigma[p]
    for j in range(status.reaction_rank):
        s = 0.0
        for p in range(status.core_rank):
            s += work.core_V[p, j] * left[p]
        right[j] = s / work.sigma_r[j]
    for a in range(count):
        s = 0.0
        for j in range(status.reaction_rank):
            s += work.Vr[j, a] * right[j]
        change = work.scale_r[a] * s
        force[place[a]] += change
        add_multiple(change, Wr_o[place[a]], wrench)
