"""The elimination of :mod:`multiarm.dynamics.solver.reactions`, compiled.

``work`` is a :class:`multiarm.dynamics.solver.reactions.ReactionWork`.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.factors import factor_lu
from multiarm.dynamics.solver.reaction_coupling import couple, over_arm
from multiarm.dynamics.solver.regular import (
    MOBILITY_WEIGHT,
    NO_INERTIA,
    factor_in_place,
    mobility,
    node_forward,
)
from multiarm.jit.kernels import inlined, kernel

# Arms (and the node matrix) with relative pivots below this are solved together with the object:
# more work, the same result.  The elimination loses the digits that this number has.
COUPLING_TOLERANCE = 1e-6
# Where the arms stiffen the node matrix so unevenly that it would lose as many digits of the
# object's inertia, arms that give way by less than this part of what the object does are too.
STIFF = 1e-3


@kernel
def eliminate_with_reactions(work, Wo, Wr, object_inertia, couple_all=False):
    """Factor the whole system; -1, or the number of the arm (n: the object) that failed.

    With ``couple_all`` every arm is solved together with the object, whatever its pivots are.

    On entry ``work.L[i]`` holds the arms' inertias (lower triangles), ``work.Y[i]`` and
    ``work.Yr[i]`` their ``W`` and ``W~`` (one column a contact), ``Wo`` and ``Wr`` (N, 6) the
    object's rows.  An arm fails when its inertia is not positive definite (``NO_INERTIA`` is left
    in ``work.pivot``) or its numbers are not finite, the object likewise.
    """
    n = work.coupled.size
    for k in range(6):
        for l in range(k + 1):  # noqa: E741
            work.Lo[k, l] = object_inertia[k, l]
    if not factor_in_place(work.Lo, 6) > 0.0:
        return n
    for i in range(n):
        pivot = _factor_arm(i, work)
        work.pivot[i] = pivot
        if not pivot >= 0.0:
            return i
        work.coupled[i] = 0 if pivot > COUPLING_TOLERANCE and not couple_all else 1
    work.pivot[n] = _factor_node(work, Wo, Wr, object_inertia)
    if not work.evenness[0] > COUPLING_TOLERANCE:
        for i in range(n):
            if _give(i, work, Wo) < STIFF:
                work.coupled[i] = 1
        work.pivot[n] = _factor_node(work, Wo, Wr, object_inertia)
    if not work.pivot[n] > COUPLING_TOLERANCE:
        for i in range(n):
            work.coupled[i] = 1
        _factor_node(work, Wo, Wr, object_inertia)
    return -1 if couple(work, Wo, Wr) else n


@kernel
def _factor_arm(i, work):
    """Factor an arm's inertia and ``K``; how far it is from being singular, or ``NO_INERTIA``."""
    n = work.dofs[i + 1] - work.dofs[i]
    first = work.rows[i]
    m = work.rows[i + 1] - first
    L, Y, Yr, K = work.L[i], work.Y[i], work.Yr[i], work.K[i]
    if not factor_in_place(L, n) > 0.0:
        return NO_INERTIA
    _forward(L, Y, n, m)
    _forward(L, Yr, n, m)
    _gram(Y, Y, n, m, K)
    least, mobile = mobility(L, n, work.levers[i]) / MOBILITY_WEIGHT, 1.0
    for a in range(m):
        norm, norm_r = 0.0, 0.0
        for j in range(n):
            norm += Y[j, a] * Y[j, a]
            norm_r += Yr[j, a] * Yr[j, a]
        if not math.isfinite(norm + norm_r):
            return math.nan
        mobile = min(mobile, norm / least, norm_r / least)
        work.arm_scale[first + a] = 1.0 / math.sqrt(norm) if norm > 0.0 else 1.0
        work.arm_scale_r[first + a] = 1.0 / math.sqrt(norm_r) if norm_r > 0.0 else 1.0
    without_friction = factor_in_place(K, m)
    _gram(Y, Yr, n, m, K)
    for a in range(m):
        for b in range(m):
            K[a, b] *= work.arm_scale[first + a] * work.arm_scale_r[first + b]
    return max(0.0, min(mobile, without_friction, factor_lu(K, m, work.K_pivots[i])))


@kernel
def _give(i, work, Wo):
    """How far an arm gives way to its contacts compared with the object alone, at the least."""
    give, x = 1.0, work.six
    for row in range(work.rows[i], work.rows[i + 1]):
        square = 0.0
        for k in range(6):
            x[k] = Wo[row, k]
        node_forward(work.Lo, x)
        for k in range(6):
            square += x[k] * x[k]
        square *= work.arm_scale[row] * work.arm_scale[row]  # one over that of the arm
        if square > 1.0:
            give = min(give, 1.0 / square)
    return give


@inlined
def _forward(L, Y, n, m):
    """Write ``L^-1 Y`` into ``Y``."""
    for j in range(n):
        for k in range(j):
            for a in range(m):
                Y[j, a] -= L[j, k] * Y[k, a]
        for a in range(m):
            Y[j, a] *= L[j, j]


@inlined
def _gram(A, B, n, m, K):
    """Write ``A^T B``."""
    for a in range(m):
        for b in range(m):
            s = 0.0
            for j in range(n):
                s += A[j, a] * B[j, b]
            K[a, b] = s


@kernel
def _factor_node(work, Wo, Wr, object_inertia):
    """Node matrix of the arms that are not coupled, in inertia coordinates; its relative pivot."""
    S, Ls, C = work.node, work.Ls, work.six_columns
    for k in range(6):
        for l in range(k + 1):  # noqa: E741
            S[k, l] = S[l, k] = Ls[k, l] = object_inertia[k, l]
    for i in range(work.coupled.size):
        if work.coupled[i] != 0:
            continue
        first = work.rows[i]
        m = work.rows[i + 1] - first
        _over_rows(i, work, Wo, C)
        for a in range(m):
            for k in range(6):
                for l in range(6):  # noqa: E741
                    S[k, l] += Wr[first + a, k] * C[a, l]
        _add_without_friction(i, work, Wo)
    work.evenness[0] = _evenness(work)
    if not factor_in_place(Ls, 6) > 0.0:
        return 0.0
    _whiten(S, Ls, work.six)
    return factor_lu(S, 6, work.node_pivots)


@inlined
def _evenness(work):
    """Smallest pivot of the node matrix without friction, in units of the object's inertia.

    Relative to its largest entry: 1 without any arm.
    """
    T, largest, smallest = work.spread, 0.0, math.inf
    for k in range(6):
        for l in range(k + 1):  # noqa: E741
            T[k, l] = T[l, k] = work.Ls[k, l]
    _whiten(T, work.Lo, work.six)
    for k in range(6):
        largest = max(largest, T[k, k])
    if not factor_in_place(T, 6) > 0.0:
        return 0.0
    for k in range(6):
        smallest = min(smallest, 1.0 / (T[k, k] * T[k, k]))
    return smallest / largest


@kernel
def _whiten(S, L, x):
    """Write ``L^-1 S L^-T`` in place."""
    for _ in range(2):  # L^-1 (L^-1 S)^T is the result's transpose
        for l in range(6):  # noqa: E741
            for k in range(6):
                x[k] = S[k, l]
            node_forward(L, x)
            for k in range(6):
                S[k, l] = x[k]
        for k in range(6):
            for l in range(k):  # noqa: E741
                S[k, l], S[l, k] = S[l, k], S[k, l]


@inlined
def _over_rows(i, work, Wo, C):
    """Write ``K^-1 W_o^T`` of one arm, (m, 6)."""
    first = work.rows[i]
    m = work.rows[i + 1] - first
    u = work.contacts
    for k in range(6):
        for a in range(m):
            u[a] = Wo[first + a, k]
        over_arm(i, work, u, False)
        for a in range(m):
            C[a, k] = u[a]


@inlined
def _add_without_friction(i, work, Wo):
    """Add ``W_o (Y^T Y)^-1 W_o^T`` of one arm to ``Ls``."""
    n = work.dofs[i + 1] - work.dofs[i]
    first = work.rows[i]
    m = work.rows[i + 1] - first
    G, Z = work.core, work.six_columns  # the core is not there yet
    _gram(work.Y[i], work.Y[i], n, m, G)
    factor_in_place(G, m)
    for a in range(m):
        for k in range(6):
            s = Wo[first + a, k]
            for b in range(a):
                s -= G[a, b] * Z[b, k]
            Z[a, k] = s * G[a, a]
        for k in range(6):
            for l in range(k + 1):  # noqa: E741
                work.Ls[k, l] += Z[a, k] * Z[a, l]
