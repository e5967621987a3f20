r"""The node algorithm: the object's acceleration first, then each arm on its own.

The system (thesis, 4.9; :math:`\lambda = -\mu` is the physical contact force, positive = pushing)

.. math::
    M_o a_o = f_o + \sum_i W_{oi} \lambda_i, \qquad
    M_i a_i = f_i + W_i \lambda_i, \qquad
    W_{oi}^T a_o + W_i^T a_i = c_i

is solved without ever assembling it.  With every arm's Cholesky factor :math:`M_i = L_i L_i^T`,

.. math::
    Y_i = L_i^{-1} W_i, \quad K_i = Y_i^T Y_i = G_i G_i^T, \quad Z_i = G_i^{-1} W_{oi}^T, \quad
    S = M_o + \sum_i Z_i^T Z_i

is the *elimination*, which depends on the configuration only, and

.. math::
    y_i = L_i^{-1} f_i, \quad z_i = G_i^{-1}(c_i - Y_i^T y_i), \quad
    a_o = S^{-1}\big(f_o + \sum_i Z_i^T z_i\big), \quad
    \lambda_i = G_i^{-T}(z_i - Z_i a_o), \quad a_i = L_i^{-T}(y_i + Y_i \lambda_i)

the *solution* for one right-hand side: accelerations, velocity projections and position corrections
alike (thesis, 4.10 - 4.12).  The work grows linearly with the number of arms; ``S`` stays 6 by 6.

It exists when every ``K_i`` is regular: each arm can move along all of its constraint directions.
Two numbers measure the distance from a singular ``K_i``: its smallest pivot relative to its
diagonal (the pivot after Jacobi scaling), and that diagonal relative to the *mobility* of the arm,
:math:`\max_j r_j^2 / p_j` with the lever :math:`r_j` of each joint and the pivots :math:`p_j` of
the inertia.  The second is needed because ``K_i`` of an arm that cannot move along its contact at
all consists of rounding errors, which are large relative to each other.  Arms for which either is
small are solved by :mod:`multiarm.dynamics.solver.singular`.

This module has the arrays and the elimination of one arm;
:mod:`multiarm.dynamics.solver.batched` eliminates four regular arms at a time.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.bounds import COUPLED_BELOW, MOBILITY_WEIGHT
from multiarm.dynamics.solver.factors import copy_block, factor_cholesky, forward_columns
from multiarm.dynamics.status import ARM_INERTIA, ARM_NOT_FINITE, OK
from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.jit.simd import LANES, aligned_zeros
from multiarm.jit.structs import Floats1, Floats2, Floats3, Ints1, Ints2

# Columns of NodeWork.groups: joints and contacts of the largest arm, number of arms, offset and
# width of the table, the four arms.
JOINTS, CONTACTS, COUNT, START, WIDTH, FIRST_ARM = range(6)
GROUP_WIDTH = FIRST_ARM + LANES

# Offsets in NodeWork.packs before the tables: lower triangle of the node matrix, each row after its
# right-hand side; the object's unknowns (scratch at first); scratch for a row's factors.
NODE_AT, NODE_WIDTH = 0, 7
OBJECT_AT = NODE_AT + LANES * 6 * NODE_WIDTH
FACTORS_AT = OBJECT_AT + LANES * 6


class NodeWork(NamedTuple):
    """Arrays of the elimination; ``n`` arms with at most ``d`` joints and ``m`` contacts each."""

    # (n + 1,): first joint and first contact of each arm in the stacked vectors
    first_joint: Ints1
    first_contact: Ints1
    # (n, d, d), (n, d, m): inertias (lower triangles; 1 on the diagonal beyond an arm's joints) and
    # constraint matrices, which the kinematics write and no solver changes
    M: Floats3
    W: Floats3
    by_arm: Ints1  # (1,) whether the last system was eliminated arm by arm; else in packs
    # of an elimination arm by arm (n, d, d), (n, d, m), (n, m, m), (n, m, 6); lower triangles,
    # diagonals inverted
    L: Floats3
    Y: Floats3
    G: Floats3
    Z: Floats3
    S: Floats2  # (6, 6) factor of the node matrix, lower triangle, diagonal inverted
    # (all joints,), (all contacts,): intermediate vectors of a solution arm by arm
    y: Floats1
    z: Floats1
    # (n, d): largest distance by which a unit turn of each joint can move a contact of its arm [m];
    # 1 for prismatic joints
    levers: Floats2
    # (n + 1,): distance of each K, and last of S, from a singular matrix (1 at best, 0 at worst)
    pivot: Floats1
    # (g, 10): groups of four arms; none when an arm has more contacts than joints, so that it is
    # deficient in any posture.  A group of fewer arms repeats its first one.
    groups: Ints2
    places: Ints2  # (g, 4 d + 4 m) index of every joint and contact in the stacked vectors
    present: Floats2  # (g, 4 m + 4) 1 for every contact, and last for each arm; 0 for padding
    stiffness: Floats2  # (g, 4 d) 1 / lever^2 of every joint; infinite for padding
    packs: Floats1  # contributions to the node matrix, scratch, and the tables


def make_work(
    joints: list[int], contacts: list[int], levers: Sequence[np.ndarray] | None = None
) -> NodeWork:
    """Allocate for arms with ``joints[i]`` joints, ``contacts[i]`` contacts, and levers [m]."""
    n, d = len(joints), max(joints)
    every_lever = np.ones((n, d))
    if levers is not None:
        for row, lever in zip(every_lever, levers, strict=True):
            row[: len(lever)] = lever
    M = np.zeros((n, d, d))
    for inertia, count in zip(M, joints, strict=True):
        inertia[range(count, d), range(count, d)] = 1.0
    whole, shapes = (
        {"groups", "places"},
        work_shapes(joints, contacts) | group_shapes(joints, contacts),
    )
    work = NodeWork(
        first_joint=_starts(joints),
        first_contact=_starts(contacts),
        M=M,
        by_arm=np.zeros(1, dtype=np.int64),
        L=np.zeros((n, d, d)),
        S=np.zeros((6, 6)),
        y=np.zeros(sum(joints)),
        levers=every_lever,
        pivot=np.ones(n + 1),
        packs=np.zeros(0),
        **{name: np.zeros(s, np.int64 if name in whole else float) for name, s in shapes.items()},
    )
    size = write_groups(group_order(joints, contacts), work)
    return work._replace(packs=aligned_zeros(size))


def work_shapes(joints: list[int], contacts: list[int]) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that depend on the contacts."""
    n, d, m = len(joints), max(joints), max(contacts)
    return {"W": (n, d, m), "Y": (n, d, m), "G": (n, m, m), "Z": (n, m, 6), "z": (sum(contacts),)}


def group_shapes(joints: list[int], contacts: list[int]) -> dict[str, tuple[int, ...]]:
    """Shapes of ``groups, places, present, stiffness`` of :class:`NodeWork`."""
    d, m = max(joints), max(contacts)
    g = -(-len(joints) // LANES) if all(map(operator.ge, joints, contacts)) else 0
    return {
        "groups": (g, GROUP_WIDTH), "places": (g, LANES * (d + m)),
        "present": (g, LANES * (m + 1)), "stiffness": (g, LANES * d),
    }  # fmt: skip


def group_order(joints: list[int], contacts: list[int]) -> np.ndarray:
    """The arms in the order in which they are put into groups: similar ones stand together."""
    order = sorted(range(len(joints)), key=lambda i: (-joints[i], -contacts[i]))
    return np.array(order, dtype=np.int64)


@plain
def write_groups(order, work):
    """Write the tables of the groups for arms in an order; returns the size of ``packs``."""
    n, all_joints = order.size, work.stiffness.shape[1] // LANES
    all_contacts = work.places.shape[1] // LANES - all_joints
    size = FACTORS_AT + LANES * (all_joints + all_contacts)
    for g in range(work.groups.shape[0]):
        group, places, present = work.groups[g], work.places[g], work.present[g]
        group[JOINTS] = group[CONTACTS] = 0
        group[COUNT] = min(LANES, n - LANES * g)
        for lane in range(LANES):
            arm = order[LANES * g + (lane if lane < group[COUNT] else 0)]
            group[FIRST_ARM + lane] = arm
            d, m = (
                work.first_joint[arm + 1] - work.first_joint[arm],
                work.first_contact[arm + 1] - work.first_contact[arm],
            )
            group[JOINTS], group[CONTACTS] = max(group[JOINTS], d), max(group[CONTACTS], m)
            for j in range(all_joints):
                lever = work.levers[arm, j]
                places[LANES * j + lane] = place_in_vector(work.first_joint, arm, j)
                work.stiffness[g, LANES * j + lane] = 1.0 / (lever * lever) if j < d else math.inf
            for k in range(all_contacts):
                places[LANES * (all_joints + k) + lane] = place_in_vector(
                    work.first_contact, arm, k
                )
                present[LANES * k + lane] = 1.0 if k < m else 0.0
            present[LANES * all_contacts + lane] = 1.0 if lane < group[COUNT] else 0.0
        unknowns = group[JOINTS] + group[CONTACTS]
        group[START], group[WIDTH] = size, unknowns + NODE_WIDTH
        size += LANES * group[WIDTH] * (unknowns + 1)  # the last row is for the unknowns
    return size


@plain
def place_in_vector(starts, arm, k):
    """Index of a joint or contact of an arm in a stacked vector; padding reads from somewhere."""
    first, end = starts[arm], starts[arm + 1]
    if first + k < end:
        return first + k
    return first if first < end else 0


def _starts(sizes: list[int]) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)


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
    """The status of an arm whose inertia has no Cholesky factor."""
    for j in range(n):
        for k in range(j + 1):
            if not math.isfinite(M[j, k]):
                return ARM_NOT_FINITE
    return ARM_INERTIA


@inlined
def eliminate_arm(i, work, W_o):
    """Factor arm ``i``, and write its ``NodeWork.pivot``; returns a status.

    ``work.M[i]`` is the arm's inertia (lower triangle), ``work.W[i]`` its ``W`` (one column a
    contact) and ``W_o`` (N, 6) the object's rows.
    """
    n = work.first_joint[i + 1] - work.first_joint[i]
    first = work.first_contact[i]
    m = work.first_contact[i + 1] - first
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
    for a in range(m):
        for k in range(6):
            Z[a, k] = W_o[first + a, k]
        for b in range(a):
            factor = G[a, b]
            for k in range(6):
                Z[a, k] -= factor * Z[b, k]
        inverse = G[a, a]
        for k in range(6):
            Z[a, k] *= inverse
    return OK


@inlined
def add_to_node(i, work):
    """Add ``Z^T Z`` of an eliminated arm to the node matrix."""
    Z, S = work.Z[i], work.S
    for a in range(work.first_contact[i + 1] - work.first_contact[i]):
        for k in range(6):
            factor = Z[a, k]
            for l in range(k + 1):
                S[k, l] += factor * Z[a, l]


@kernel
def eliminate_arms(work, W_o):
    """Factor all arms, one after the other, from what :func:`eliminate_arm` describes.

    Returns a status, and the arm whose inertia failed where it is not ``OK``.  The pivots are left
    in ``work.pivot``: arms for which it is not above ``COUPLED_BELOW`` have ``L`` and ``Y`` only.
    """
    work.by_arm[0] = 1
    for i in range(work.first_joint.size - 1):
        status = eliminate_arm(i, work, W_o)
        if status != OK:
            return status, i
    return OK, 0


@inlined
def unconstrained_motion(i, work, f_j):
    """``y = L^-1 f_j`` of an arm."""
    d0, d = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
    L, y = work.L[i], work.y
    for j in range(d):
        s = f_j[d0 + j]
        for k in range(j):
            s -= L[j, k] * y[d0 + k]
        y[d0 + j] = s * L[j, j]


@inlined
def reduce_constraints(i, work, c, a_o):
    """``z`` of an arm; adds ``Z^T z`` to the object's right-hand side ``a_o``."""
    d0, d = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
    r0, m = work.first_contact[i], work.first_contact[i + 1] - work.first_contact[i]
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
        for k in range(6):
            a_o[k] += Z[a, k] * s


@inlined
def node_forward(S, a_o):
    """``L_S^-1 a_o``, in place."""
    for j in range(6):
        s = a_o[j]
        for k in range(j):
            s -= S[j, k] * a_o[k]
        a_o[j] = s * S[j, j]


@inlined
def node_backward(S, a_o):
    """``L_S^-T a_o``, in place."""
    for j in range(5, -1, -1):
        s = a_o[j]
        for k in range(j + 1, 6):
            s -= S[k, j] * a_o[k]
        a_o[j] = s * S[j, j]


@inlined
def recover_forces(i, work, a_o, force):
    """Contact forces of an arm for the object's ``a_o``."""
    r0, m = work.first_contact[i], work.first_contact[i + 1] - work.first_contact[i]
    G, Z, z = work.G[i], work.Z[i], work.z
    for a in range(m):
        s = z[r0 + a]
        for k in range(6):
            s -= Z[a, k] * a_o[k]
        force[r0 + a] = s
    for a in range(m - 1, -1, -1):
        s = force[r0 + a] * G[a, a]
        force[r0 + a] = s
        for b in range(a):
            force[r0 + b] -= G[a, b] * s


@inlined
def recover_joints(i, work, Y, force, a_j):
    """Joint accelerations of an arm for its contact forces; ``Y`` is ``L^-1 W``, or of ``W~``."""
    d0, d = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
    r0, m = work.first_contact[i], work.first_contact[i + 1] - work.first_contact[i]
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
