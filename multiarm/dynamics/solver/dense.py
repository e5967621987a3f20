r"""Independent reference: the whole constrained system as one dense matrix, in plain NumPy.

.. math::
    \begin{bmatrix} \mathrm{blkdiag}(M_o, M_1 \dots M_n) & -\tilde W \\ W^T & 0 \end{bmatrix}
    \begin{bmatrix} a_j \\ \lambda \end{bmatrix} = \begin{bmatrix} f_j \\ c \end{bmatrix}

with the stacked constraint matrix ``W`` and reaction matrix ``W~`` (equal without friction; thesis,
4.9).  Its cost is cubic in the number of blocks; it shares no factors with the node algorithm.

A singular matrix is solved by its singular value decomposition.  A right null vector is a
combination of contact forces without effect on the constraints, with the motion that it causes: the
returned forces are of least norm [N].  When that motion is not zero, which takes friction, the
equations do not determine the motion, and the result says so.  A left null vector is a combination
of constraints that no contact force affects: where they contradict each other, the least change
[m/s^2] of the right-hand side ``c`` removes the contradiction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.bounds import (
    PART_TOLERANCE,
    RANK_TOLERANCE,
    ROUNDED_ROW,
    SYSTEM_TOLERANCE,
    UNMOVED,
)
from multiarm.dynamics.solver.factors import rank_of


class SystemSolution(NamedTuple):
    """Solution of the constrained system for one right-hand side."""

    object_acceleration: np.ndarray  # (6 F,) of the objects, world axes, classical
    joint_accelerations: list[np.ndarray]  # (n_i,)
    contact_forces: list[np.ndarray]  # (N_i,) positive = pushing, the thesis's -mu
    unique: list[np.ndarray]  # (N_i,) which contact forces the equations determine
    rank: int  # of the stacked constraint matrix
    motion_unique: bool = True  # whether the accelerations are unique; may fail with friction only
    # blocks whose contact forces take part in the undetermined motion
    undetermined_blocks: tuple[int, ...] = ()


def solve_dense(
    M_o: np.ndarray,
    f_o: np.ndarray,
    M: list[np.ndarray],
    f_j: list[np.ndarray],
    W_o: list[np.ndarray],
    W: list[np.ndarray],
    c: list[np.ndarray],
    reaction_o: list[np.ndarray] | None = None,
    reaction: list[np.ndarray] | None = None,
    tolerance: float = 0.0,
) -> SystemSolution:
    """Solve the constrained system as one dense matrix.

    Parameters
    ----------
    M_o, f_o : (6 F, 6 F), (6 F,)
        Objects' inertia and right-hand side.
    M, f_j : lists of (n_i, n_i), (n_i,)
        Blocks' inertias and right-hand sides.
    W_o, W, c : lists of (6 F, N_i), (n_i, N_i), (N_i,)
        Constraints ``W_o^T a_o + W_i^T a_i = c_i``.
    reaction_o, reaction : lists like W_o, W, optional
        Matrices of the contact forces where these differ from the constraints (friction).
    tolerance : float
        Without friction: singular values of the scaled constraint matrix below this part of the
        largest count as zero, where that is more than rounding.
    """
    from scipy.linalg import block_diag

    inertia = block_diag(M_o, *M)
    # scale so that metres and radians, kilograms and grams weigh the same
    scale = 1.0 / np.sqrt(np.diag(inertia))
    constraint = reactions = np.vstack([np.hstack(W_o), block_diag(*W)])
    if reaction is not None and reaction_o is not None:
        reactions = np.vstack([np.hstack(reaction_o), block_diag(*reaction)])
    elif tolerance > SYSTEM_TOLERANCE**0.5:
        constraint = reactions = _of_lower_rank(constraint, scale, tolerance)
    size, count = constraint.shape
    matrix = np.zeros((size + count, size + count))
    matrix[:size, :size] = inertia
    matrix[:size, size:] = -reactions
    matrix[size:, :size] = constraint.T
    right = np.concatenate([f_o, *f_j, *c])
    rows = np.concatenate([scale, _column_factors(scale[:, None] * constraint)])
    columns = np.concatenate([scale, _column_factors(scale[:, None] * reactions)])
    scaled = rows[:, None] * matrix * columns
    x, rank = _solve_regular(scaled, rows * right), count
    unique, moving = np.ones(count, dtype=bool), np.zeros((count, 0))
    if x is not None:
        x = columns * x
    else:
        rank = null_space(scale[:, None] * constraint * rows[size:], SYSTEM_TOLERANCE**0.5).rank
        x, free = _solve_singular(scaled, right, rows, columns, size)
        unique = np.linalg.norm(free[size:], axis=1) < PART_TOLERANCE
        moving = _moving(free, size)
    bounds, node = np.cumsum([w.shape[1] for w in W])[:-1], len(f_o)
    return SystemSolution(
        object_acceleration=x[:node],
        joint_accelerations=np.split(x[node:size], np.cumsum([m.shape[0] for m in M])[:-1]),
        contact_forces=np.split(x[size:], bounds),
        unique=np.split(unique, bounds),
        rank=rank,
        motion_unique=not moving.size,
        undetermined_blocks=tuple(
            i
            for i, parts in enumerate(np.split(moving, bounds))
            if np.any(np.linalg.norm(parts, axis=1) > PART_TOLERANCE)
        ),
    )


def _solve_singular(
    scaled: np.ndarray, right: np.ndarray, rows: np.ndarray, columns: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Solution by singular values, and the scaled right null vectors as columns."""
    u, singular, vt = np.linalg.svd(scaled)
    rank = rank_of(singular, SYSTEM_TOLERANCE)
    left, free = rows[:, None] * u[:, rank:], vt[rank:].T
    right = right.copy()
    right[size:] -= np.linalg.lstsq(left[size:].T, left.T @ right, rcond=None)[0]
    x = columns * (vt[:rank].T @ ((u[:, :rank].T @ (rows * right)) / singular[:rank]))
    # the least norm is meant in newtons, not in scaled units
    null = columns[:, None] * free
    return x - null @ np.linalg.lstsq(null[size:], x[size:], rcond=None)[0], free


def _solve_regular(matrix: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    """Solution by LU with partial pivoting, or None when the matrix is singular or nearly so."""
    from scipy.linalg import lapack

    lu, pivots, failed = lapack.dgetrf(matrix)
    if failed:
        return None
    reciprocal_condition, _ = lapack.dgecon(lu, np.linalg.norm(matrix, 1))
    if not reciprocal_condition > SYSTEM_TOLERANCE:
        return None
    return lapack.dgetrs(lu, pivots, right)[0]


def _moving(free: np.ndarray, size: int) -> np.ndarray:
    """Force parts (N, k) of those combinations of null vectors that move the system."""
    _, motion, vt = np.linalg.svd(free[:size], full_matrices=False)
    return free[size:] @ vt[motion > UNMOVED].T


def _of_lower_rank(constraint: np.ndarray, scale: np.ndarray, tolerance: float) -> np.ndarray:
    """A constraint matrix (n, N) without what its small singular values contribute."""
    norms = _column_factors(scale[:, None] * constraint)
    u, singular, vt = np.linalg.svd(scale[:, None] * constraint * norms, full_matrices=False)
    rank = rank_of(singular, tolerance)
    if rank == singular.size:
        return constraint
    return (u[:, :rank] * singular[:rank]) @ vt[:rank] / scale[:, None] / norms


def reciprocal_lengths(lengths: np.ndarray) -> np.ndarray:
    """Factors (..., m) that give rows of these lengths length 1, but keep those that are roundings.

    The lengths of a matrix are those along the last axis.
    """
    longest = np.max(lengths, axis=-1, keepdims=True, initial=0.0)
    longest = np.where(longest > 0.0, longest, 1.0)
    return 1.0 / np.where(lengths > ROUNDED_ROW * longest, lengths, longest)


def _column_factors(matrix: np.ndarray) -> np.ndarray:
    """Factors that give the columns length 1."""
    return reciprocal_lengths(np.linalg.norm(matrix, axis=0))


class NullSpace(NamedTuple):
    """Null space of a matrix (m, n), its rank decided by a relative tolerance."""

    basis: np.ndarray  # (n, n - rank) orthonormal columns
    rank: int
    singular: np.ndarray  # (min(m, n),) singular values relative to the largest, descending

    @property
    def untouched(self) -> np.ndarray:
        """Which unknowns have no part in the null space: they are determined, shape (n,)."""
        return np.linalg.norm(self.basis, axis=1) < PART_TOLERANCE


def null_space(matrix: np.ndarray, tolerance: float = RANK_TOLERANCE) -> NullSpace:
    """Null space of a matrix (m, n) whose rows and columns are scaled to be comparable."""
    _, singular, vt = np.linalg.svd(matrix)
    rank = rank_of(singular, tolerance)
    relative = singular / singular[0] if rank else singular
    return NullSpace(vt[rank:].T, rank, relative)
