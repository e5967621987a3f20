r"""Arms that are solved together with the object, when reactions differ from constraints.

With the other arms eliminated, the contact forces of these arms obey (thesis, 4.2, the system
``F mu = d``; :math:`\lambda = -\mu`, tildes throughout)

.. math::
    F \lambda = d, \qquad F_{ij} = W_{oi}^T S^{-1} \tilde W_{oj} + \delta_{ij} K_i, \qquad
    d_i = z_i - W_{oi}^T S^{-1} \tilde h_o

``F`` is never formed.  In inertia coordinates (:math:`L_s L_s^T` is the node matrix without
friction) it is :math:`G^T P \tilde G` with

.. math::
    G = \begin{bmatrix} L_s^{-1} W_o \\ L_i^{-1} W_i \end{bmatrix} = U \Sigma V^T, \quad
    \tilde G = \begin{bmatrix} L_s^{-1} \tilde W_o \\ L_i^{-1} \tilde W_i \end{bmatrix}
    = \tilde U \tilde\Sigma \tilde V^T, \quad
    P = \begin{bmatrix} L_s^T S^{-1} L_s & 0 \\ 0 & I \end{bmatrix}

(columns scaled to unit length).  The three ways of being singular then stand apart:

- ``G`` has null vectors: constraints depend on each other;
- ``G~`` has null vectors: forces balance each other and move nothing;
- the *core* :math:`U^T P \tilde U`, which is the identity without friction, has: forces move the
  system in a way that no constraint sees (Painleve's case), and the motion is not unique.

Without friction the condition of ``F`` is that of ``G`` squared; here it is that of ``G``.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.factors import decompose, solve_lu, solve_lu_transposed
from multiarm.dynamics.solver.regular import node_backward, node_forward
from multiarm.jit.kernels import inlined, kernel

# Singular values of G below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-6
# Singular values of the core (of the order of 1) below this count as zero.
CORE_TOLERANCE = 1e-9
# A null vector has a part in a contact force when it is larger than this.
PART_TOLERANCE = 1e-7

# Entries of ReactionWork.counts.
ROWS, LENGTH, RANK, REACTION_RANK, CORE_RANK, FREE, UNSERVED, MOVING, COUNTS = range(9)


@kernel
def couple(work, Wo, Wr):
    """Decompose the coupled system; False when a number is not finite."""
    counts = work.counts
    for k in range(FREE, COUNTS):
        counts[k] = 0
    for i in range(work.loose.size):
        work.loose[i] = 0
    _gather(work, Wo, Wr)
    rows, length = counts[ROWS], counts[LENGTH]
    if not decompose(work.U, rows, length, work.V, work.sigma):
        return False
    if not decompose(work.Ur, rows, length, work.Vr, work.sigma_r):
        return False
    counts[RANK] = _rank(work.sigma, rows)
    counts[REACTION_RANK] = _rank(work.sigma_r, rows)
    _form_core(work)
    if not decompose(work.core, counts[REACTION_RANK], counts[RANK], work.core_V, work.core_sigma):
        return False
    counts[CORE_RANK] = 0
    least = CORE_TOLERANCE * max(1.0, work.core_sigma[0])
    for k in range(min(counts[RANK], counts[REACTION_RANK])):
        if work.core_sigma[k] > least:
            counts[CORE_RANK] += 1
    _collect_free(work, Wo, Wr)
    return _collect_unserved(work, Wo, Wr)


@inlined
def _gather(work, Wo, Wr):
    """Columns of G and G~, scaled to unit length (zeros stay)."""
    row, length = 0, 6
    for i in range(work.coupled.size):
        if work.coupled[i] == 0:
            continue
        d = work.dofs[i + 1] - work.dofs[i]
        first = work.rows[i]
        for a in range(work.rows[i + 1] - first):
            work.place[row] = first + a
            for k in range(work.U.shape[1]):
                work.U[row, k] = 0.0
                work.Ur[row, k] = 0.0
            for k in range(6):
                work.U[row, k] = Wo[first + a, k]
                work.Ur[row, k] = Wr[first + a, k]
            node_forward(work.Ls, work.U[row])
            node_forward(work.Ls, work.Ur[row])
            for j in range(d):
                work.U[row, length + j] = work.Y[i, j, a]
                work.Ur[row, length + j] = work.Yr[i, j, a]
            row += 1
        length += d
    work.counts[ROWS], work.counts[LENGTH] = row, length
    for k in range(row):
        work.scale[k] = _to_unit(work.U[k], length)
        work.scale_r[k] = _to_unit(work.Ur[k], length)


@kernel
def _to_unit(x, n):
    """Scale a vector to unit length; the factor."""
    square = 0.0
    for i in range(n):
        square += x[i] * x[i]
    if square == 0.0:
        return 1.0
    inverse = 1.0 / math.sqrt(square)
    for i in range(n):
        x[i] *= inverse
    return inverse


@inlined
def _rank(sigma, n):
    rank = 0
    for k in range(n):
        if sigma[k] > RANK_TOLERANCE * sigma[0]:
            rank += 1
    return rank


@inlined
def _form_core(work):
    """Write ``U^T P U~`` by columns, and its transpose."""
    rank, reaction_rank = work.counts[RANK], work.counts[REACTION_RANK]
    x = work.six
    for j in range(reaction_rank):
        for k in range(6):
            x[k] = work.Ur[j, k]
        solve_lu(work.node, 6, work.node_pivots, x)
        for i in range(rank):
            s = 0.0
            for k in range(6):
                s += work.U[i, k] * x[k]
            for k in range(6, work.counts[LENGTH]):
                s += work.U[i, k] * work.Ur[j, k]
            work.core[j, i] = s
            work.core_left[i, j] = s


@inlined
def _collect_free(work, Wo, Wr):
    """Forces that no constraint sees, orthonormal in newtons, each with the object's motion."""
    counts, free = work.counts, work.free
    rows, total = counts[ROWS], Wo.shape[0]
    for k in range(counts[REACTION_RANK], rows):
        _begin(free[counts[FREE]])
        for a in range(rows):
            free[counts[FREE], work.place[a]] = work.scale_r[a] * work.Vr[k, a]
        counts[FREE] += 1
    for k in range(counts[CORE_RANK], counts[REACTION_RANK]):
        vector = free[counts[FREE]]
        _begin(vector)
        for j in range(counts[REACTION_RANK]):
            part = work.core_V[k, j] / work.sigma_r[j]
            for a in range(rows):
                vector[work.place[a]] += part * work.scale_r[a] * work.Vr[j, a]
        x = work.six
        _on_object(work, Wr, vector, x)
        object_motion(work, x)
        for k6 in range(6):
            vector[total + k6] = x[k6]
        _extend(work, Wo, x, vector, False)
        _to_unit_force(vector, total)
        for i in range(work.loose.size):
            for a in range(work.rows[i], work.rows[i + 1]):
                if abs(vector[a]) > PART_TOLERANCE:
                    work.loose[i] = 1
        counts[FREE] += 1
        counts[MOVING] += 1
    _orthonormalise(free, counts[FREE], total)


@inlined
def _collect_unserved(work, Wo, Wr):
    """Combinations of constraints that no contact force serves, orthonormal."""
    counts, unserved = work.counts, work.unserved
    rows, total = counts[ROWS], Wo.shape[0]
    for k in range(counts[RANK], rows):
        _begin(unserved[counts[UNSERVED]])
        for a in range(rows):
            unserved[counts[UNSERVED], work.place[a]] = work.scale[a] * work.V[k, a]
        counts[UNSERVED] += 1
    if counts[CORE_RANK] < counts[RANK]:
        # right singular vectors of the transposed core: those of the core from the left
        if not decompose(
            work.core_left, counts[RANK], counts[REACTION_RANK], work.core_left_V, work.z
        ):
            return False
        for k in range(counts[CORE_RANK], counts[RANK]):
            vector = unserved[counts[UNSERVED]]
            _begin(vector)
            for j in range(counts[RANK]):
                part = work.core_left_V[k, j] / work.sigma[j]
                for a in range(rows):
                    vector[work.place[a]] += part * work.scale[a] * work.V[j, a]
            x = work.six
            _on_object(work, Wo, vector, x)
            node_forward(work.Ls, x)
            solve_lu_transposed(work.node, 6, work.node_pivots, x)
            node_backward(work.Ls, x)
            _extend(work, Wr, x, vector, True)
            counts[UNSERVED] += 1
    _orthonormalise(unserved, counts[UNSERVED], total)
    return True


@kernel
def object_motion(work, x):
    """Solve with the node matrix ``S`` of the arms that are not coupled, in place."""
    node_forward(work.Ls, x)
    solve_lu(work.node, 6, work.node_pivots, x)
    node_backward(work.Ls, x)


@kernel
def over_arm(i, work, x, transposed):
    """Solve with ``K_i`` of an arm that is not coupled (or with its transpose), in place."""
    first = work.rows[i]
    m = work.rows[i + 1] - first
    if transposed:
        for a in range(m):
            x[a] *= work.arm_scale_r[first + a]
        solve_lu_transposed(work.K[i], m, work.K_pivots[i], x)
        for a in range(m):
            x[a] *= work.arm_scale[first + a]
    else:
        for a in range(m):
            x[a] *= work.arm_scale[first + a]
        solve_lu(work.K[i], m, work.K_pivots[i], x)
        for a in range(m):
            x[a] *= work.arm_scale_r[first + a]


@inlined
def _begin(vector):
    for k in range(vector.size):
        vector[k] = 0.0


@inlined
def _on_object(work, Wo, force, x):
    """Wrench of the coupled arms' entries of ``force`` on the object."""
    for k in range(6):
        x[k] = 0.0
    for a in range(work.counts[ROWS]):
        row = work.place[a]
        for k in range(6):
            x[k] += Wo[row, k] * force[row]


@inlined
def _extend(work, Wo, x, vector, transposed):
    """Forces of the other arms that keep their own constraints when the object moves by ``x``."""
    u = work.contacts
    for i in range(work.coupled.size):
        if work.coupled[i] != 0:
            continue
        first = work.rows[i]
        m = work.rows[i + 1] - first
        for a in range(m):
            s = 0.0
            for k in range(6):
                s -= Wo[first + a, k] * x[k]
            u[a] = s
        over_arm(i, work, u, transposed)
        for a in range(m):
            vector[first + a] = u[a]


@inlined
def _to_unit_force(vector, total):
    """Scale forces (and the motion behind them) to unit length of the forces."""
    factor = _to_unit(vector, total)
    for k in range(total, vector.size):
        vector[k] *= factor


@inlined
def _orthonormalise(vectors, count, total):
    """Gram and Schmidt, twice, by the first ``total`` entries; the rest follows."""
    for k in range(count):
        for _ in range(2):
            _to_unit_force(vectors[k], total)
            for j in range(k):
                s = 0.0
                for a in range(total):
                    s += vectors[k, a] * vectors[j, a]
                for a in range(vectors.shape[1]):
                    vectors[k, a] -= s * vectors[j, a]
        _to_unit_force(vectors[k], total)
