r"""The node algorithm for blocks that cannot move along all of their constraint directions.

An arm with a stretched elbow, with too few joints, or with redundant contacts has a singular
:math:`K_i = W_i^T M_i^{-1} W_i` (thesis, 4.2; S. McMillan, Ohio State University, 1994).  It is not
coupled to the object as a whole.  The singular value decomposition of its

.. math:: Y_i = L_i^{-1} W_i, \qquad Y_i v_a = \sigma_a u_a

turns its constraints into orthogonal *directions* ``v``.  Those with a large ``sigma`` are
eliminated like any regular block, with :math:`K = \sigma^2`.  Large is relative to

.. math:: \sigma_{best} = \max_a \sigma_a \; \max\big(1, (\gamma / g)^2\big), \qquad
    g = \max_{a, j} |W_{ja}| / r_j ,

with the levers :math:`r_j` of the joints, so that ``g`` is 1 where a joint moves a contact as much
as it can.  The second factor is for blocks whose joints all move along their contacts: every
``sigma`` is a rounding error then, and these are large relative to each other.

The other directions, along which the block can hardly move or not at all, remain as unknown forces
of one *coupled system* with the objects; with :math:`C = W_o v` and the node matrix
:math:`S = L_S L_S^T` of all eliminated directions,

.. math::
    \big(C^T S^{-1} C + \mathrm{diag}(\sigma^2)\big)\,\lambda = B^T B\,\lambda = d, \qquad
    B = \begin{bmatrix} L_S^{-1} C \\ \mathrm{diag}(\sigma) \end{bmatrix}.

Directions with :math:`\sigma = 0` bind objects alone, as rows among objects do: they add a column
to ``B`` and no row, so that the cost stays linear in the number of blocks.  Nothing is regularised:
a small ``sigma`` enters as it is, and the result is continuous with that of the regular path.

*Rank.*  Some combinations of these forces may move neither the object nor a block (dependent
contacts, redundant loops).  Rank is a question of geometry, not of masses.  So it is that of ``B``
with objects measured in unit directions and lever arms, each block by its own ``sigma_best``:
combinations that move less than ``COUPLED_RANK_TOLERANCE`` of these have no force (or more, at a
state with gaps: constraints may depend on each other only where they are closed).  Since the
directions are orthonormal combinations of the contacts, the contact forces have the least norm in
newtons; contradicting constraints are met in the sense of least squares.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.bounds import (
    COUPLED_BELOW,
    COUPLED_RANK_TOLERANCE,
    HARDLY_ALIGNED,
    IMMOVABLE,
    IMMOVABLE_BY_OBJECT,
    MOST_RANK_TOLERANCE,
    RANK_PER_GAP,
    ROUNDED_SIGMA,
    SPLIT_BY_BLOCK,
    SPLIT_BY_OBJECT,
)
from multiarm.dynamics.solver.factors import (
    backward,
    copy_lower,
    factor_cholesky,
    forward,
    norm,
    orthogonalize,
)
from multiarm.dynamics.solver.node import (
    NODE,
    NodeWork,
    add_multiple,
    add_square,
    add_to_node,
    contact_count,
    joint_count,
    less_product,
    recover_forces,
    recover_joints,
    reduce_constraints,
    unconstrained_motion,
)
from multiarm.jit.kernels import copy, inlined, kernel, plain
from multiarm.jit.structs import Float, Floats1, Floats2, Floats3, Int, Ints1, Numbers


class CoupledStatus(Numbers):
    """How the coupled system was solved; all integers are 0 when no block is deficient."""

    blocks: Int  # deficient blocks
    unknowns: Int  # unknown forces
    movable: Int  # those with a sigma
    rank: Int  # of the coupled system
    margin: Float  # ``Solution.margin``, of the order of 1 when a loss of rank is far


class CoupledWork(NamedTuple):
    """Arrays of the coupled system: ``n`` blocks, ``N`` contacts, at most ``d``, ``m`` a block."""

    # (n, m, m), (n, m, d), (N,): directions v of the deficient blocks (one a row), Y v, its length
    V: Floats3
    A: Floats3
    sigma: Floats1
    deficient: Ints1  # (n,) 1 for the blocks that are not eliminated as a whole
    scale: Floats1  # (n,) sigma_best of each deficient block
    split: Floats1  # (n,) smallest sigma that is eliminated
    inertia: Floats2  # (6 F, 6 F) Cholesky factor of the objects' own inertia
    wrench: Floats1  # (6 F,) of a contact on the objects, over that factor
    # (N,): block of every unknown, and which of the block's directions it is along
    block: Ints1
    direction: Ints1
    # (N, 6 F): wrench of every unknown on the objects, and L_S^-1 times it
    C: Floats2
    B: Floats2
    # (6 F + N, N), (6 F + N, 6 F + N): orthonormal combinations of unknowns outside the null
    # space, and B times these
    basis: Floats2
    images: Floats2
    z: Floats1  # (N,) as in NodeWork, by the directions v of the deficient blocks
    # (N,): right-hand side and forces of the coupled system
    right: Floats1
    unknown: Floats1
    pivots: Ints1  # (m,) scratch: order of rows of a block
    status: CoupledStatus


def make_coupled(joints: list[int], contacts: list[int], node: int = NODE) -> CoupledWork:
    """Allocate for blocks with ``joints[i]`` joints and ``contacts[i]`` contacts."""
    n, whole = len(joints), {"block", "direction", "pivots"}
    shapes = coupled_shapes(joints, contacts, node)
    return CoupledWork(
        deficient=np.zeros(n, dtype=np.int64),
        scale=np.zeros(n),
        split=np.zeros(n),
        inertia=np.zeros((node, node)),
        wrench=np.zeros(node),
        status=CoupledStatus(margin=np.inf),
        **{name: np.zeros(s, np.int64 if name in whole else float) for name, s in shapes.items()},
    )


def coupled_shapes(joints: list[int], contacts: list[int], node: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the arrays that depend on the contacts."""
    n, d, m, N = len(joints), max(joints), max(contacts), sum(contacts)
    return {
        "V": (n, m, m), "A": (n, m, d), "sigma": (N,), "block": (N,), "direction": (N,),
        "C": (N, node), "B": (N, node), "basis": (node + N, N), "images": (node + N, node + N),
        "z": (N,), "right": (N,), "unknown": (N,), "pivots": (m,),
    }  # fmt: skip


def undetermined_parts(work: NodeWork, coupled: CoupledWork) -> np.ndarray:
    """Part of every contact in the null space, shape (N,): 0 (force is determined) to 1."""
    p, rank = coupled.status.unknowns, coupled.status.rank
    directions = np.zeros((p, work.first_contact[-1]))
    for u, (i, a) in enumerate(zip(coupled.block[:p], coupled.direction[:p], strict=True)):
        first, end = work.first_contact[i : i + 2]
        directions[u, first:end] = coupled.V[i, a, : end - first]
    basis = coupled.basis[:rank, :p]
    return np.linalg.norm(directions - basis.T @ (basis @ directions), axis=0)


@kernel
def object_mobility(row, coupled):
    """``sqrt(w^T M_o^-1 w)``, which ``sigma`` is compared with."""
    wrench = coupled.wrench
    copy(row, wrench)
    forward(coupled.inertia, wrench.size, wrench)
    return norm(wrench, wrench.size)


@kernel
def aligned_share(W, n, m, levers):
    """Largest ``|W_ja| / r_j`` of a block with ``n`` joints and ``m`` contacts."""
    largest = 0.0
    for j in range(n):
        for a in range(m):
            largest = max(largest, abs(W[j, a]) / levers[j])
    return largest


@kernel
def split_block(i, work, coupled, W_o):
    """Decompose ``Y`` of a deficient block: directions are added to ``S`` or to the unknowns.

    Returns whether all numbers are finite.
    """
    d, first, m = joint_count(i, work), work.first_contact[i], contact_count(i, work)
    Y, V, A = work.Y[i], coupled.V[i], coupled.A[i]
    for a in range(m):
        for j in range(d):
            A[a, j] = Y[j, a]
        for b in range(m):
            V[a, b] = 1.0 if a == b else 0.0
    orthogonalize(A, m, d, V, m)
    scale = by_object = total = 0.0
    aligned = aligned_share(work.W[i], d, m, work.levers[i])
    for a in range(m):
        coupled.sigma[first + a] = norm(A[a], d)
        scale = max(scale, coupled.sigma[first + a])
        by_object = max(by_object, object_mobility(W_o[first + a], coupled))
        total += coupled.sigma[first + a]
    if not math.isfinite(total):
        return False
    if aligned < HARDLY_ALIGNED:
        scale *= (HARDLY_ALIGNED / aligned) ** 2 if aligned > 0.0 else 1.0
    coupled.scale[i] = scale
    coupled.split[i] = max(SPLIT_BY_BLOCK * scale, SPLIT_BY_OBJECT * by_object)
    least = max(IMMOVABLE * scale, IMMOVABLE_BY_OBJECT * by_object)
    for a in range(m):
        wrench, sigma = work.Z[i, a], coupled.sigma[first + a]
        for k in range(wrench.size):
            wrench[k] = 0.0
            for b in range(m):
                wrench[k] += V[a, b] * W_o[first + b, k]
        if sigma > coupled.split[i]:
            for k in range(wrench.size):
                wrench[k] /= sigma
            add_square(wrench, work.S)
            continue
        if not sigma > least:
            coupled.sigma[first + a] = 0.0
        p = coupled.status.unknowns
        coupled.block[p], coupled.direction[p] = i, a
        copy(wrench, coupled.C[p])
        coupled.status.unknowns = p + 1
    return True


@inlined
def sigma_of(u, work, coupled):
    """``sigma`` of an unknown."""
    return coupled.sigma[work.first_contact[coupled.block[u]] + coupled.direction[u]]


@kernel
def lever_length(W_o):
    """Largest moment of a unit contact force on an object [m]; 1 when there is none."""
    longest = 0.0
    for k in range(W_o.shape[0]):
        for turn in range(3, W_o.shape[1], 6):
            longest = max(longest, norm(W_o[k, turn : turn + 3], 3))
    return longest if longest > 0.0 else 1.0


@plain
def rank_tolerance(gap, lever):
    """Below which singular values count as zero where a gap [m] is closed; ``lever`` [m]."""
    return max(COUPLED_RANK_TOLERANCE, min(RANK_PER_GAP * gap / lever, MOST_RANK_TOLERANCE))


@kernel
def find_rank(work, coupled, lever, gap):
    """Write an orthonormal basis of the unknowns outside the null space, and the rank."""
    basis, status = coupled.basis, coupled.status
    tolerance = rank_tolerance(gap, lever)
    p, rows, node = status.unknowns, coupled.C.shape[1], coupled.C.shape[1]
    for u in range(p):
        for k in range(node):
            basis[k, u] = coupled.C[u, k] / (1.0 if k % 6 < 3 else lever)
        sigma = sigma_of(u, work, coupled)
        if sigma > 0.0:
            for w in range(p):
                basis[rows, w] = 0.0
            basis[rows, u] = sigma / coupled.scale[coupled.block[u]]
            rows += 1
    status.movable = rows - node
    orthogonalize(basis, rows, p, basis, 0)
    rank = 0
    status.margin = math.inf
    for r in range(rows):
        size = norm(basis[r], p)
        if size > ROUNDED_SIGMA:
            status.margin = min(status.margin, size)
        if size > tolerance:
            for u in range(p):
                basis[rank, u] = basis[r, u] / size
            rank += 1
    status.rank = rank


@kernel
def image_basis(work, coupled):
    """``coupled.images`` of ``coupled.basis``, both rotated until the images are orthogonal."""
    basis, images, status = coupled.basis, coupled.images, coupled.status
    p, node = status.unknowns, coupled.C.shape[1]
    for u in range(p):
        copy(coupled.C[u], coupled.B[u])
        forward(work.S, node, coupled.B[u])
    for r in range(status.rank):
        for k in range(node):
            images[r, k] = 0.0
        for u in range(p):
            add_multiple(basis[r, u], coupled.B[u], images[r])
        column = node
        for u in range(p):
            sigma = sigma_of(u, work, coupled)
            if sigma > 0.0:
                images[r, column] = basis[r, u] * sigma
                column += 1
    orthogonalize(images, status.rank, node + status.movable, basis, p)


@inlined
def couple(work, coupled, W_o, object_inertia, decompose_all=False, gap=0.0):
    """Factor a system with deficient blocks, after
    :func:`multiarm.dynamics.solver.node.eliminate_blocks`.

    With ``decompose_all`` no block is eliminated as a whole, whatever its pivots are.  ``gap`` is
    the largest one [m] that the solution is to close: the rank is uncertain by as much.  Returns
    the smallest relative pivot of the object's inertia or of the node matrix; the factors are
    usable only when that is positive (and not NaN).
    """
    node = object_inertia.shape[0]
    copy_lower(object_inertia, node, coupled.inertia)
    pivot = factor_cholesky(coupled.inertia, node)
    if not pivot > 0.0:
        return pivot
    pivot = build_node(work, coupled, W_o, object_inertia, decompose_all)
    if not pivot > COUPLED_BELOW and coupled.status.blocks < work.first_joint.size - 1:
        pivot = build_node(work, coupled, W_o, object_inertia, True)
    if pivot > 0.0:
        find_rank(work, coupled, lever_length(W_o), gap)
        image_basis(work, coupled)
    return pivot


@kernel
def build_node(work, coupled, W_o, object_inertia, decompose_all):
    """Factor the node matrix of all eliminated directions; returns its smallest relative pivot.

    Deficient blocks are decomposed, or with ``decompose_all`` all blocks.
    """
    status = coupled.status
    status.blocks = status.unknowns = 0
    copy_lower(object_inertia, work.S.shape[0], work.S)
    for i in range(work.first_joint.size - 1):
        coupled.deficient[i] = 1 if decompose_all or not work.pivot[i] > COUPLED_BELOW else 0
        if coupled.deficient[i] != 0:
            status.blocks += 1
            if not split_block(i, work, coupled, W_o):
                return math.nan
        else:
            add_to_node(i, work)
    return factor_cholesky(work.S, work.S.shape[0])


@kernel
def reduce_deficient_constraints(i, work, coupled, c, a_o):
    """``V (c - Y^T y)`` into ``coupled.z``; adds the eliminated directions to ``a_o``."""
    d0, d = work.first_joint[i], joint_count(i, work)
    r0, m = work.first_contact[i], contact_count(i, work)
    V, A, Z, y, z = coupled.V[i], coupled.A[i], work.Z[i], work.y, coupled.z
    for a in range(m):
        s = 0.0
        for b in range(m):
            s += V[a, b] * c[r0 + b]
        for j in range(d):
            s -= A[a, j] * y[d0 + j]
        if coupled.sigma[r0 + a] > coupled.split[i]:
            s /= coupled.sigma[r0 + a]
            add_multiple(s, Z[a], a_o)
        z[r0 + a] = s


@kernel
def solve_coupled_forces(work, coupled, a_o):
    """Forces of the coupled system; adds ``B`` times these to ``a_o``, given as ``L_S^-1 a_o``."""
    status = coupled.status
    p, width = status.unknowns, a_o.size + status.movable
    for u in range(p):
        z = coupled.z[work.first_contact[coupled.block[u]] + coupled.direction[u]]
        coupled.right[u], coupled.unknown[u] = less_product(z, coupled.B[u], a_o), 0.0
    for r in range(status.rank):
        size = norm(coupled.images[r], width)
        s = 0.0
        for u in range(p):
            s += coupled.basis[r, u] * coupled.right[u]
        s /= size * size
        for u in range(p):
            coupled.unknown[u] += s * coupled.basis[r, u]
    for u in range(p):
        add_multiple(coupled.unknown[u], coupled.B[u], a_o)


@kernel
def recover_deficient_forces(i, work, coupled, a_o, force):
    """Contact forces of a deficient block along its eliminated directions."""
    r0, m = work.first_contact[i], contact_count(i, work)
    V, Z, z = coupled.V[i], work.Z[i], coupled.z
    for b in range(m):
        force[r0 + b] = 0.0
    for a in range(m):
        sigma = coupled.sigma[r0 + a]
        if sigma > coupled.split[i]:
            s = less_product(z[r0 + a], Z[a], a_o) / sigma
            for b in range(m):
                force[r0 + b] += V[a, b] * s


@inlined
def solve_coupled(work, coupled, f_o, f_j, c, a_o, a_j, force):
    """Solve the factored system for one right-hand side.

    Parameters
    ----------
    f_o : (6 F,), f_j : (sum of joints,), c : (sum of contacts,)
        Right-hand sides, blocks stacked.
    a_o : (6 F,), a_j : (sum of joints,), force : (sum of contacts,), written
        Objects' and joints' unknowns, and the physical contact forces ``lambda = -mu``.
    """
    n = work.first_joint.size - 1
    copy(f_o, a_o)
    for i in range(n):
        unconstrained_motion(i, work, f_j)
        if coupled.deficient[i] == 0:
            reduce_constraints(i, work, c, a_o)
        else:
            reduce_deficient_constraints(i, work, coupled, c, a_o)
    forward(work.S, a_o.size, a_o)
    solve_coupled_forces(work, coupled, a_o)
    backward(work.S, a_o.size, a_o)
    for i in range(n):
        if coupled.deficient[i] == 0:
            recover_forces(i, work, a_o, force)
        else:
            recover_deficient_forces(i, work, coupled, a_o, force)
    for u in range(coupled.status.unknowns):
        i = coupled.block[u]
        r0, m = work.first_contact[i], contact_count(i, work)
        for b in range(m):
            force[r0 + b] += coupled.unknown[u] * coupled.V[i, coupled.direction[u], b]
    for i in range(n):
        recover_joints(i, work, work.Y[i], force, a_j)
