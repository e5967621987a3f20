r"""The node algorithm: the object's acceleration first, then each arm on its own.

The system (thesis, 4.9; :math:`\lambda = -\mu` is the physical contact force, positive = pushing)

.. math::
    M_o q_o = h_o + \sum_i W_{oi} \lambda_i, \qquad
    M_i q_i = h_i + W_i \lambda_i, \qquad
    W_{oi}^T q_o + W_i^T q_i = c_i

is solved without ever assembling it.  With every arm's Cholesky factor :math:`M_i = L_i L_i^T`,

.. math::
    Y_i = L_i^{-1} W_i, \quad K_i = Y_i^T Y_i = G_i G_i^T, \quad Z_i = G_i^{-1} W_{oi}^T, \quad
    S = M_o + \sum_i Z_i^T Z_i

is the *elimination*, which depends on the configuration only, and

.. math::
    y_i = L_i^{-1} h_i, \quad z_i = G_i^{-1}(c_i - Y_i^T y_i), \quad
    q_o = S^{-1}\big(h_o + \sum_i Z_i^T z_i\big), \quad
    \lambda_i = G_i^{-T}(z_i - Z_i q_o), \quad q_i = L_i^{-T}(y_i + Y_i \lambda_i)

the *solution* for one right-hand side: accelerations, velocity projections and position corrections
alike (thesis, 4.10 - 4.12).  The work grows linearly with the number of arms; ``S`` stays 6 by 6.

It exists when every ``K_i`` is regular, that is when each arm can move along all of its own
constraint directions.  The smallest pivot of ``K_i`` relative to its diagonal (the pivot after
Jacobi scaling) measures how far that is from failing; arms for which it is small are left to
:mod:`multiarm.node.singular`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.books import Floats1, Floats2, Floats3, Ints1
from multiarm.lowlevel import inlined, kernel

# Arms with a relative pivot below this go to the coupled system (:mod:`multiarm.node.singular`).
# Elimination loses about as many digits as the pivot has zeros: the choice leaves eleven.
COUPLED_BELOW = 1e-5
# What :func:`eliminate` returns when all arms, or not all of them, were eliminated.
ELIMINATED, DEFICIENT = -1, -6
# Stands in for the pivot of an arm whose inertia matrix is not positive definite.
NO_INERTIA = -2.0


class NodeWork(NamedTuple):
    """Arrays of the elimination.  ``n`` arms, at most ``d`` joints and ``m`` contacts an arm.

    dofs, rows : int64 (n + 1,)
        Where each arm's joints and contacts start in the stacked vectors.
    L : (n, d, d), Y : (n, d, m), G : (n, m, m), Z : (n, m, 6)
        Factors as in the module's text; the lower triangles of L and G, diagonals inverted.
    S : (6, 6)
        Cholesky factor of the node matrix, lower triangle, diagonal inverted.
    y : (dofs[n],), z : (rows[n],)
        Intermediate vectors of a solution.
    pivot : (n + 1,)
        Smallest relative pivot of each ``K_i``, and of ``S`` last.
    """

    dofs: Ints1
    rows: Ints1
    L: Floats3
    Y: Floats3
    G: Floats3
    Z: Floats3
    S: Floats2
    y: Floats1
    z: Floats1
    pivot: Floats1


def make_work(dofs: list[int], rows: list[int]) -> NodeWork:
    """Allocate for arms with ``dofs[i]`` joints and ``rows[i]`` contacts."""
    n, d, m = len(dofs), max(dofs), max(rows)
    return NodeWork(
        dofs=np.concatenate([[0], np.cumsum(dofs)]).astype(np.int64),
        rows=np.concatenate([[0], np.cumsum(rows)]).astype(np.int64),
        L=np.zeros((n, d, d)),
        Y=np.zeros((n, d, m)),
        G=np.zeros((n, m, m)),
        Z=np.zeros((n, m, 6)),
        S=np.zeros((6, 6)),
        y=np.zeros(sum(dofs)),
        z=np.zeros(sum(rows)),
        pivot=np.ones(n + 1),
    )


@kernel
def factor_in_place(A, n):
    """Cholesky factor of ``A[:n, :n]`` into its lower triangle, the diagonal inverted.

    Returns the smallest pivot relative to its diagonal entry; the factor is usable only when that
    is positive (and not NaN).
    """
    smallest = 1.0
    for j in range(n):
        diagonal = A[j, j]
        if not diagonal > 0.0:
            return 0.0
        pivot = diagonal
        for k in range(j):
            pivot -= A[j, k] * A[j, k]
        relative = pivot / diagonal
        if not relative > 0.0:
            return relative if relative < 0.0 else 0.0
        smallest = min(smallest, relative)
        inverse = 1.0 / math.sqrt(pivot)
        A[j, j] = inverse
        for i in range(j + 1, n):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            A[i, j] = s * inverse
    return smallest


@inlined
def eliminate_arm(i, work, Wo):
    """Factor arm ``i`` and add its share to the node matrix.

    On entry ``work.L[i]`` holds the arm's inertia (lower triangle), ``work.Y[i]`` its ``W`` (one
    column a contact) and ``Wo`` (sum of rows, 6) the object's rows; on return the factors.
    Returns the smallest relative pivot (0 when the arm is singular), or ``NO_INERTIA``.
    """
    n = work.dofs[i + 1] - work.dofs[i]
    first = work.rows[i]
    m = work.rows[i + 1] - first
    L, Y, G, Z = work.L[i], work.Y[i], work.G[i], work.Z[i]
    inertia_pivot = factor_in_place(L, n)
    if not inertia_pivot > 0.0:
        return NO_INERTIA
    for j in range(n):
        for k in range(j):
            factor = L[j, k]
            for a in range(m):
                Y[j, a] -= factor * Y[k, a]
        inverse = L[j, j]
        for a in range(m):
            Y[j, a] *= inverse
    for a in range(m):
        for b in range(a + 1):
            G[a, b] = 0.0
    for j in range(n):
        for a in range(m):
            factor = Y[j, a]
            for b in range(a + 1):
                G[a, b] += factor * Y[j, b]
    pivot = factor_in_place(G, m)
    if not pivot > COUPLED_BELOW:
        return pivot
    for a in range(m):
        for k in range(6):
            Z[a, k] = Wo[first + a, k]
        for b in range(a):
            factor = G[a, b]
            for k in range(6):
                Z[a, k] -= factor * Z[b, k]
        inverse = G[a, a]
        for k in range(6):
            Z[a, k] *= inverse
    add_arm(i, work)
    return pivot


@inlined
def add_arm(i, work):
    """Add the share of an eliminated arm to the node matrix."""
    Z, S = work.Z[i], work.S
    for a in range(work.rows[i + 1] - work.rows[i]):
        for k in range(6):
            factor = Z[a, k]
            for l in range(k + 1):  # noqa: E741
                S[k, l] += factor * Z[a, l]


@inlined
def eliminate(work, Wo, object_inertia):
    """Factor the whole system.

    Parameters
    ----------
    object_inertia : (6, 6)
        The object's M_o in world axes; the arms' data are on entry as in :func:`eliminate_arm`.

    Returns
    -------
    int
        ``ELIMINATED``; ``DEFICIENT`` when a pivot is below ``COUPLED_BELOW``, so that too many
        digits would be lost (``work.S`` is then of no use); or the number of the arm whose inertia
        failed.  The pivots are left in ``work.pivot``.
    """
    n = work.dofs.size - 1
    for k in range(6):
        for l in range(k + 1):  # noqa: E741
            work.S[k, l] = object_inertia[k, l]
    deficient = 0
    for i in range(n):
        pivot = eliminate_arm(i, work, Wo)
        work.pivot[i] = pivot
        if not pivot > COUPLED_BELOW:
            if pivot == NO_INERTIA:
                return i
            deficient += 1
    if deficient > 0:
        return DEFICIENT
    pivot = factor_in_place(work.S, 6)
    work.pivot[n] = pivot
    # arms that hold the object stiffly in some directions drown its inertia in the others
    return ELIMINATED if pivot > COUPLED_BELOW else DEFICIENT


@inlined
def free_arm(i, work, h):
    """``y = L^-1 h`` of an arm."""
    d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
    L, y = work.L[i], work.y
    for j in range(d):
        s = h[d0 + j]
        for k in range(j):
            s -= L[j, k] * y[d0 + k]
        y[d0 + j] = s * L[j, j]


@inlined
def reduce_arm(i, work, c, q_o):
    """``z`` of an arm, and its share of the object's right-hand side."""
    d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
    r0, m = work.rows[i], work.rows[i + 1] - work.rows[i]
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
            q_o[k] += Z[a, k] * s


@inlined
def node_forward(S, q_o):
    """``L_S^-1 q_o``, in place."""
    for j in range(6):
        s = q_o[j]
        for k in range(j):
            s -= S[j, k] * q_o[k]
        q_o[j] = s * S[j, j]


@inlined
def node_backward(S, q_o):
    """``L_S^-T q_o``, in place."""
    for j in range(5, -1, -1):
        s = q_o[j]
        for k in range(j + 1, 6):
            s -= S[k, j] * q_o[k]
        q_o[j] = s * S[j, j]


@inlined
def push_arm(i, work, q_o, force):
    """Contact forces of an arm."""
    r0, m = work.rows[i], work.rows[i + 1] - work.rows[i]
    G, Z, z = work.G[i], work.Z[i], work.z
    for a in range(m):
        s = z[r0 + a]
        for k in range(6):
            s -= Z[a, k] * q_o[k]
        force[r0 + a] = s
    for a in range(m - 1, -1, -1):
        s = force[r0 + a] * G[a, a]
        force[r0 + a] = s
        for b in range(a):
            force[r0 + b] -= G[a, b] * s


@inlined
def move_arm(i, work, force, q):
    """The joints' unknowns of an arm."""
    d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
    r0, m = work.rows[i], work.rows[i + 1] - work.rows[i]
    L, Y, y = work.L[i], work.Y[i], work.y
    for j in range(d):
        s = y[d0 + j]
        for a in range(m):
            s += Y[j, a] * force[r0 + a]
        q[d0 + j] = s
    for j in range(d - 1, -1, -1):
        s = q[d0 + j] * L[j, j]
        q[d0 + j] = s
        for k in range(j):
            q[d0 + k] -= L[j, k] * s


@inlined
def solve(work, h_o, h, c, q_o, q, force):
    """Solve the eliminated system for one right-hand side.

    Parameters
    ----------
    h_o : (6,), h : (sum of joints,), c : (sum of rows,)
        Right-hand sides, arms stacked.
    q_o : (6,), q : (sum of joints,), force : (sum of rows,), written
        Object's and joints' unknowns, and the physical contact forces ``lambda = -mu``.
    """
    n = work.dofs.size - 1
    for k in range(6):
        q_o[k] = h_o[k]
    for i in range(n):
        free_arm(i, work, h)
        reduce_arm(i, work, c, q_o)
    node_forward(work.S, q_o)
    node_backward(work.S, q_o)
    for i in range(n):
        push_arm(i, work, q_o, force)
        move_arm(i, work, force, q)
