r"""Independent reference: the whole constrained system as one dense matrix, in plain NumPy.

.. math::
    \begin{bmatrix} \mathrm{blkdiag}(M_o, M_1 \dots M_n) & -\tilde W \\ W^T & 0 \end{bmatrix}
    \begin{bmatrix} q \\ \lambda \end{bmatrix} = \begin{bmatrix} h \\ c \end{bmatrix}

with the stacked constraint matrix ``W`` and reaction matrix ``W~`` (equal without friction; thesis,
4.9).  Its cost is cubic in the number of arms; it shares no code with the node algorithm.  When the
constraints are linearly dependent it returns the contact forces of least norm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.terms import NodeSolution

# Singular values of the scaled constraint matrix below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-9
# Unknowns with a smaller part in every null vector are determined.
PART_TOLERANCE = 1e-7


def solve_dense(
    M_o: np.ndarray,
    h_o: np.ndarray,
    M: list[np.ndarray],
    h: list[np.ndarray],
    W_o: list[np.ndarray],
    W: list[np.ndarray],
    c: list[np.ndarray],
    reaction_o: list[np.ndarray] | None = None,
    reaction: list[np.ndarray] | None = None,
) -> NodeSolution:
    """Solve the constrained system at once.

    Parameters
    ----------
    M_o, h_o : (6, 6), (6,)
        Object's inertia and right-hand side.
    M, h : lists of (n_i, n_i), (n_i,)
        Arms' inertias and right-hand sides.
    W_o, W, c : lists of (6, N_i), (n_i, N_i), (N_i,)
        Constraints ``W_o^T q_o + W_i^T q_i = c_i``.
    reaction_o, reaction : lists like W_o, W, optional
        Where the contact forces act when that differs from the constraints (friction).

    Returns
    -------
    NodeSolution
        Forces are physical, positive = pushing.
    """
    sizes, rows = [m.shape[0] for m in M], [w.shape[1] for w in W]
    inertia = _block_diagonal([M_o, *M])
    constraint = _stack(W_o, W)
    reactions = constraint
    if reaction is not None and reaction_o is not None:
        reactions = _stack(reaction_o, reaction)
    size, count = inertia.shape[0], constraint.shape[1]
    matrix = np.zeros((size + count, size + count))
    matrix[:size, :size] = inertia
    matrix[:size, size:] = -reactions
    matrix[size:, :size] = constraint.T
    right = np.concatenate([h_o, *h, *c])
    # scale so that metres and radians, kilograms and grams weigh the same
    scale = 1.0 / np.sqrt(np.diag(inertia))
    norms = np.linalg.norm(scale[:, None] * constraint, axis=0)
    D = np.concatenate([scale, 1.0 / np.where(norms > 0.0, norms, 1.0)])
    scaled, target = D[:, None] * matrix * D, D * right
    solution, rank, unique = _solve_regular(scaled, target), count, np.ones(count, dtype=bool)
    if solution is None:
        null, rank, _ = space = null_space(scale[:, None] * constraint * D[size:])
        solution = np.linalg.lstsq(scaled, target, rcond=RANK_TOLERANCE)[0]
        unique = space.untouched
        # the least norm is meant in newtons, not in scaled units
        force, free = D[size:] * solution[size:], D[size:, None] * null
        solution[size:] = (force - free @ np.linalg.lstsq(free, force, rcond=None)[0]) / D[size:]
    solution = D * solution
    q, force = solution[6:size], solution[size:]
    return NodeSolution(
        object_acceleration=solution[:6],
        joint_accelerations=np.split(q, np.cumsum(sizes)[:-1]),
        contact_forces=np.split(force, np.cumsum(rows)[:-1]),
        unique=np.split(unique, np.cumsum(rows)[:-1]),
        rank=rank,
    )


def _solve_regular(matrix: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    """Solution by LU with partial pivoting, or None when the matrix is singular or nearly so."""
    from scipy.linalg import lapack

    lu, pivots, failed = lapack.dgetrf(matrix)
    if failed:
        return None
    reciprocal_condition, _ = lapack.dgecon(lu, np.linalg.norm(matrix, 1))
    if not reciprocal_condition > RANK_TOLERANCE * 1e-3:
        return None
    return lapack.dgetrs(lu, pivots, right)[0]


def _stack(W_o: list[np.ndarray], W: list[np.ndarray]) -> np.ndarray:
    """Stacked matrix (6 + sum n_i, sum N_i): the object's rows above the arms' blocks."""
    return np.vstack([np.hstack(W_o), _block_diagonal(W)])


def _block_diagonal(blocks: list[np.ndarray]) -> np.ndarray:
    out = np.zeros((sum(b.shape[0] for b in blocks), sum(b.shape[1] for b in blocks)))
    row = column = 0
    for block in blocks:
        out[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return out


class NullSpace(NamedTuple):
    """Null space of a matrix, its rank decided by ``RANK_TOLERANCE``.

    basis : (n, n - rank)
        Orthonormal columns.
    rank : int
    singular : (min(m, n),)
        Singular values relative to the largest, descending.
    """

    basis: np.ndarray
    rank: int
    singular: np.ndarray

    @property
    def untouched(self) -> np.ndarray:
        """Which unknowns have no part in the null space, i.e. are determined, shape (n,)."""
        return np.linalg.norm(self.basis, axis=1) < PART_TOLERANCE


def null_space(matrix: np.ndarray) -> NullSpace:
    """Null space of a matrix (m, n) whose rows and columns are scaled to be comparable."""
    _, singular, vt = np.linalg.svd(matrix)
    singular = singular / singular[0]
    rank = int(np.sum(singular > RANK_TOLERANCE))
    return NullSpace(vt[rank:].T, rank, singular)
