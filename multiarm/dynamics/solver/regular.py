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
constraint directions.  Two numbers measure how far that is from failing: the smallest pivot of
``K_i`` relative to its diagonal (the pivot after Jacobi scaling), and that diagonal relative to
the *mobility* of the arm, :math:`\max_j r_j^2 / p_j` with the lever :math:`r_j` of each joint and
the pivots :math:`p_j` of the inertia.  The second is needed because an arm that cannot move along
its contact at all leaves a ``K_i`` of roundings, which are large relative to themselves.  Arms for
which either is small are left to :mod:`multiarm.dynamics.solver.singular`.

Here is what is done to one arm; the arms of regular systems are taken four at a time, in
:mod:`multiarm.dynamics.solver.batched`.
"""

from __future__ import annotations

import math

from multiarm.jit.kernels import inlined, kernel

# Arms with a relative pivot below this go to the coupled system
# (:mod:`multiarm.dynamics.solver.singular`). Elimination loses about as many digits as the pivot
# has zeros: the choice leaves eleven.
COUPLED_BELOW = 1e-5
# The same for the diagonal of K relative to the arm's mobility.  Entries of W are rounded relative
# to the levers, so that a diagonal loses half as many digits as this has zeros: eleven are left.
IMMOBILE_BELOW = 1e-10
# Brings the second measure to the scale of the first, so that one bound serves both.
MOBILITY_WEIGHT = COUPLED_BELOW / IMMOBILE_BELOW
# What the object's equation of motion may leave over, relative to the largest force in it.
# Arms that are eliminated as a whole leave eleven digits, of which two are for cancellation.
IMBALANCE_BOUND = 1e-9
# Results when all arms, or not all of them, were eliminated.
ELIMINATED, DEFICIENT = -1, -6
# Stands in for the pivot of an arm whose inertia matrix is not positive definite.
NO_INERTIA = -2.0


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


@kernel
def mobility(L, n, levers):
    """How far the joints could give way to a unit push, at most [1/kg]; ``L`` is the factor."""
    most = 0.0
    for j in range(n):
        reach = levers[j] * L[j, j]
        most = max(most, reach * reach)
    return most


@inlined
def eliminate_arm(i, work, Wo):
    """Factor arm ``i``.

    On entry ``work.L[i]`` holds the arm's inertia (lower triangle), ``work.Y[i]`` its ``W`` (one
    column a contact) and ``Wo`` (sum of rows, 6) the object's rows; on return the factors.
    Returns how far the arm is from being singular (1 at best, 0 when it is), or ``NO_INERTIA``.
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
    least = mobility(L, n, work.levers[i]) / MOBILITY_WEIGHT
    pivot = 1.0
    for a in range(m):
        pivot = min(pivot, G[a, a] / least)
    pivot = min(pivot, factor_in_place(G, m))
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


@kernel
def eliminate_arms(work, Wo):
    """Factor all arms, one after the other; the data are on entry as in :func:`eliminate_arm`.

    Returns ``ELIMINATED``, or the number of the arm whose inertia failed.  The pivots are left in
    ``work.pivot``: arms for which it is not above ``COUPLED_BELOW`` have ``L`` and ``Y`` only.
    """
    work.factored[0] = 1
    for i in range(work.dofs.size - 1):
        work.pivot[i] = eliminate_arm(i, work, Wo)
        if work.pivot[i] == NO_INERTIA:
            return i
    return ELIMINATED


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
