r"""Blocks that are solved together with the object, when contact forces have other directions.

With the other blocks eliminated, the contact forces of these blocks obey (thesis, 4.2, the system
``F mu = d``; :math:`\lambda = -\mu`, tildes throughout)

.. math::
    F \lambda = d, \qquad F_{ij} = W_{oi}^T S^{-1} \tilde W_{oj} + \delta_{ij} K_i, \qquad
    d_i = z_i - W_{oi}^T S^{-1} \tilde f_o

``F`` is never formed.  In inertia coordinates (:math:`L_s L_s^T` is the node matrix without
friction) it is :math:`G^T P \tilde G` with

.. math::
    G = \begin{bmatrix} L_s^{-1} W_o \\ L_i^{-1} W_i \end{bmatrix} = U \Sigma V^T, \quad
    \tilde G = \begin{bmatrix} L_s^{-1} \tilde W_o \\ L_i^{-1} \tilde W_i \end{bmatrix}
    = \tilde U \tilde\Sigma \tilde V^T, \quad
    P = \begin{bmatrix} L_s^T S^{-1} L_s & 0 \\ 0 & I \end{bmatrix}

(columns scaled to unit length).  There are three ways of being singular, which this separates:

- ``G`` has null vectors: constraints depend on each other;
- ``G~`` has null vectors: forces balance each other and move nothing;
- the *core* :math:`U^T P \tilde U`, which is the identity without friction, has null vectors:
  forces move the system without effect on any constraint (Painleve), and the motion is not unique.

Without friction the condition of ``F`` is that of ``G`` squared; here it is that of ``G``.
"""

from __future__ import annotations

import math

from multiarm.dynamics.solver.bounds import (
    CORE_TOLERANCE,
    COUPLED_RANK_TOLERANCE,
    PART_TOLERANCE,
    ROUNDED_ROW,
)
from multiarm.dynamics.solver.factors import (
    backward,
    decompose,
    forward,
    norm,
    rank_of,
    solve_lu,
    solve_lu_transposed,
)
from multiarm.dynamics.solver.node import (
    add_multiple,
    contact_count,
    joint_count,
    less_product,
    set_vector,
)
from multiarm.jit.kernels import clear, inlined, kernel


@kernel
def decompose_coupled(work, W_o, Wr_o):
    """Decompose the coupled system; False when a number is not finite."""
    status = work.status
    status.null_forces = status.null_constraints = status.motions = 0
    for i in range(work.undetermined.size):
        work.undetermined[i] = 0
    write_columns(work, W_o, Wr_o)
    count, length = status.contacts, status.length
    if not decompose(work.U, count, length, work.V, work.sigma):
        return False
    if not decompose(work.Ur, count, length, work.Vr, work.sigma_r):
        return False
    status.rank = rank_of(work.sigma[:count], COUPLED_RANK_TOLERANCE)
    status.reaction_rank = rank_of(work.sigma_r[:count], COUPLED_RANK_TOLERANCE)
    form_core(work)
    if not decompose(work.core, status.reaction_rank, status.rank, work.core_V, work.core_sigma):
        return False
    size = min(status.rank, status.reaction_rank)
    status.core_rank = rank_of(work.core_sigma[:size], CORE_TOLERANCE, 1.0)
    find_null_forces(work, W_o, Wr_o)
    return find_null_constraints(work, W_o, Wr_o)


@inlined
def write_columns(work, W_o, Wr_o):
    """Columns of G and G~, scaled to unit length (columns of zeros and roundings stay such)."""
    count, length, node = 0, W_o.shape[1], W_o.shape[1]
    for i in range(work.coupled.size):
        if work.coupled[i] == 0:
            continue
        first, d = work.first_contact[i], joint_count(i, work)
        for a in range(contact_count(i, work)):
            u, ur = work.U[count], work.Ur[count]
            work.place[count] = first + a
            clear(u)
            clear(ur)
            set_vector(W_o[first + a], u)
            set_vector(Wr_o[first + a], ur)
            forward(work.Ls, node, u)
            forward(work.Ls, node, ur)
            for j in range(d):
                u[length + j], ur[length + j] = work.Y[i, j, a], work.Yr[i, j, a]
            count += 1
        length += d
    work.status.contacts, work.status.length = count, length
    normalize_columns(work.U, count, length, work.scale)
    normalize_columns(work.Ur, count, length, work.scale_r)


@kernel
def normalize_columns(vectors, count, n, factors):
    """Scale vectors to unit length, but for roundings of the longest, and write the factors."""
    longest = 0.0
    for k in range(count):
        factors[k] = norm(vectors[k], n)
        longest = max(longest, factors[k])
    for k in range(count):
        if factors[k] == 0.0:
            factors[k] = 1.0
            continue
        factors[k] = 1.0 / (factors[k] if factors[k] > ROUNDED_ROW * longest else longest)
        for i in range(n):
            vectors[k, i] *= factors[k]


@kernel
def normalize(x, n):
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
def form_core(work):
    """Write ``U^T P U~`` by columns, and its transpose."""
    rank, reaction_rank = work.status.rank, work.status.reaction_rank
    x, node = work.node_vector, work.node_vector.size
    for j in range(reaction_rank):
        for k in range(node):
            x[k] = work.Ur[j, k]
        solve_lu(work.node, node, work.node_pivots, x)
        for i in range(rank):
            s = 0.0
            for k in range(node):
                s += work.U[i, k] * x[k]
            for k in range(node, work.status.length):
                s += work.U[i, k] * work.Ur[j, k]
            work.core[j, i] = s
            work.core_left[i, j] = s


@inlined
def find_null_forces(work, W_o, Wr_o):
    """Forces without effect on the constraints, orthonormal in newtons, and the object's motion."""
    status, vectors = work.status, work.null_force
    count, total = status.contacts, W_o.shape[0]
    for k in range(status.reaction_rank, count):
        vector = vectors[status.null_forces]
        clear(vector)
        for a in range(count):
            vector[work.place[a]] = work.scale_r[a] * work.Vr[k, a]
        add_motion(work, W_o, Wr_o, vector, total)
        status.null_forces += 1
    for k in range(status.core_rank, status.reaction_rank):
        vector = vectors[status.null_forces]
        clear(vector)
        for j in range(status.reaction_rank):
            part = work.core_V[k, j] / work.sigma_r[j]
            for a in range(count):
                vector[work.place[a]] += part * work.scale_r[a] * work.Vr[j, a]
        add_motion(work, W_o, Wr_o, vector, total)
        normalize_forces(vector, total)
        for i in range(work.undetermined.size):
            for a in range(work.first_contact[i], work.first_contact[i + 1]):
                if abs(vector[a]) > PART_TOLERANCE:
                    work.undetermined[i] = 1
        status.null_forces += 1
        status.motions += 1
    orthonormalize(vectors, status.null_forces, total)


@kernel
def add_motion(work, W_o, Wr_o, vector, total):
    """Add the object's motion, and the other blocks' forces, to a vector of ``null_force``."""
    x = work.node_vector
    object_wrench(work, Wr_o, vector, x)
    solve_object(work, x)
    set_vector(x, vector[total:])
    extend_to_regular_blocks(work, W_o, x, vector, False)


@inlined
def find_null_constraints(work, W_o, Wr_o):
    """Combinations of constraints that no contact force affects, orthonormal."""
    status, vectors = work.status, work.null_constraint
    count, total = status.contacts, W_o.shape[0]
    for k in range(status.rank, count):
        clear(vectors[status.null_constraints])
        for a in range(count):
            vectors[status.null_constraints, work.place[a]] = work.scale[a] * work.V[k, a]
        status.null_constraints += 1
    if status.core_rank < status.rank:
        # right singular vectors of the transposed core: those of the core from the left
        if not decompose(
            work.core_left, status.rank, status.reaction_rank, work.core_left_V,
            work.core_left_sigma,
        ):  # fmt: skip
            return False
        for k in range(status.core_rank, status.rank):
            vector = vectors[status.null_constraints]
            clear(vector)
            for j in range(status.rank):
                part = work.core_left_V[k, j] / work.sigma[j]
                for a in range(count):
                    vector[work.place[a]] += part * work.scale[a] * work.V[j, a]
            x = work.node_vector
            object_wrench(work, W_o, vector, x)
            forward(work.Ls, x.size, x)
            solve_lu_transposed(work.node, x.size, work.node_pivots, x)
            backward(work.Ls, x.size, x)
            extend_to_regular_blocks(work, Wr_o, x, vector, True)
            status.null_constraints += 1
    orthonormalize(vectors, status.null_constraints, total)
    return True


@kernel
def solve_object(work, x):
    """Solve with the node matrix ``S`` of the blocks that are not coupled, in place."""
    forward(work.Ls, x.size, x)
    solve_lu(work.node, x.size, work.node_pivots, x)
    backward(work.Ls, x.size, x)


@kernel
def solve_block(i, work, x, transposed):
    """Solve with ``K_i`` of a block that is not coupled (or with its transpose), in place."""
    first, end, pivots = work.first_contact[i], work.first_contact[i + 1], work.K_pivots[i]
    m, scale, scale_r = end - first, work.block_scale[first:end], work.block_scale_r[first:end]
    if transposed:
        for a in range(m):
            x[a] *= scale_r[a]
        solve_lu_transposed(work.K[i], m, pivots, x)
        for a in range(m):
            x[a] *= scale[a]
    else:
        for a in range(m):
            x[a] *= scale[a]
        solve_lu(work.K[i], m, pivots, x)
        for a in range(m):
            x[a] *= scale_r[a]


@inlined
def object_wrench(work, W_o, force, x):
    """Wrench of the coupled blocks' entries of ``force`` on the object, into ``x``."""
    clear(x)
    for k in range(work.status.contacts):
        row = work.place[k]
        add_multiple(force[row], W_o[row], x)


@inlined
def extend_to_regular_blocks(work, W_o, x, vector, transposed):
    """Forces with which the other blocks keep their constraints when the object moves by ``x``."""
    for i in range(work.coupled.size):
        if work.coupled[i] == 0:
            first, end = work.first_contact[i], work.first_contact[i + 1]
            part = vector[first:end]
            for a in range(end - first):
                part[a] = less_product(0.0, W_o[first + a], x)
            solve_block(i, work, part, transposed)


@inlined
def normalize_forces(vector, total):
    """Scale forces, and the motion that they cause, to unit length of the forces."""
    factor = normalize(vector, total)
    for k in range(total, vector.size):
        vector[k] *= factor


@inlined
def orthonormalize(vectors, count, total):
    """Gram-Schmidt, twice, by the first ``total`` entries; the others are scaled alike."""
    for k in range(count):
        for _ in range(2):
            normalize_forces(vectors[k], total)
            for j in range(k):
                s = 0.0
                for a in range(total):
                    s += vectors[k, a] * vectors[j, a]
                for a in range(vectors.shape[1]):
                    vectors[k, a] -= s * vectors[j, a]
        normalize_forces(vectors[k], total)
