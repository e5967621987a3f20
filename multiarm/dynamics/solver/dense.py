r"""Independent reference: the whole constrained system as one dense matrix, in plain NumPy.

.. math::
    \begin{bmatrix} \mathrm{blkdiag}(M_o, M_1 \dots M_n) & -\tilde W \\ W^T & 0 \end{bmatrix}
    \begin{bmatrix} q \\ \lambda \end{bmatrix} = \begin{bmatrix} h \\ c \end{bmatrix}

with the stacked constraint matrix ``W`` and reaction matrix ``W~`` (equal without friction; thesis,
4.9).  Its cost is cubic in the number of arms; it shares no code with the node algorithm.

A singular matrix is taken apart by its singular values.  A null vector from the right is a
combination of contact forces that no constraint sees, with the motion that it causes: the forces
returned are of least norm [N], and when that motion is not zero, which takes friction, the
equations do not determine the motion, and the result says so.  A null vector from the left is a
combination of constraints that no contact force can serve: where they contradict each other, the
right-hand side ``c`` is mended by the least change [m/s^2].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Singular values of the scaled constraint matrix below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-9
# The same for the whole matrix, whose small singular values are the squares of those of W.
SYSTEM_TOLERANCE = 1e-12
# Unknowns with a smaller part in every null vector are determined.
PART_TOLERANCE = 1e-7
# A null vector whose motion is smaller than this part of it moves nothing.  Where the constraints
# are dependent up to rounding only, a motion of the square root of SYSTEM_TOLERANCE is left.
MOTION_TOLERANCE = 1e-5


class NodeSolution(NamedTuple):
    """Solution of the constrained system for one right-hand side.

    object_acceleration : (6,)
        World axes, classical.
    joint_accelerations : list of (n_i,)
    contact_forces : list of (N_i,)
        Physical magnitudes, positive = pushing (the thesis's ``mu`` with the sign turned).
    unique : list of bool (N_i,)
        Which contact forces the equations determine.
    rank : int
        Rank of the stacked constraint matrix.
    motion_unique : bool
        Whether the equations determine the accelerations.  Only friction can make them fail to,
        when contact forces that no constraint sees move the system.
    loose_arms : tuple of int
        Arms whose contact forces take part in what is not determined of the motion.
    residual : float
        Largest constraint residual relative to the largest of its terms; beyond rounding where
        the constraints contradict each other.
    """

    object_acceleration: np.ndarray
    joint_accelerations: list[np.ndarray]
    contact_forces: list[np.ndarray]
    unique: list[np.ndarray]
    rank: int
    motion_unique: bool = True
    loose_arms: tuple[int, ...] = ()
    residual: float = 0.0


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
    inertia = _block_diagonal([M_o, *M])
    constraint = _stack(W_o, W)
    reactions = constraint
    if reaction is not None and reaction_o is not None:
        reactions = _stack(reaction_o, reaction)
    size, count = constraint.shape
    matrix = np.zeros((size + count, size + count))
    matrix[:size, :size] = inertia
    matrix[:size, size:] = -reactions
    matrix[size:, :size] = constraint.T
    right = np.concatenate([h_o, *h, *c])
    # scale so that metres and radians, kilograms and grams weigh the same
    scale = 1.0 / np.sqrt(np.diag(inertia))
    rows = np.concatenate([scale, _reciprocal_norms(scale[:, None] * constraint)])
    columns = np.concatenate([scale, _reciprocal_norms(scale[:, None] * reactions)])
    scaled = rows[:, None] * matrix * columns
    x, rank = _solve_regular(scaled, rows * right), count
    unique, loose = np.ones(count, dtype=bool), np.zeros((count, 0))
    if x is not None:
        x = columns * x
    else:
        rank = null_space(scale[:, None] * constraint * rows[size:], SYSTEM_TOLERANCE**0.5).rank
        x, free = _solve_singular(scaled, right, rows, columns, size)
        unique = np.linalg.norm(free[size:], axis=1) < PART_TOLERANCE
        loose = _moving(free, size)
    bounds = np.cumsum([w.shape[1] for w in W])[:-1]
    return NodeSolution(
        object_acceleration=x[:6],
        joint_accelerations=np.split(x[6:size], np.cumsum([m.shape[0] for m in M])[:-1]),
        contact_forces=np.split(x[size:], bounds),
        unique=np.split(unique, bounds),
        rank=rank,
        motion_unique=not loose.size,
        loose_arms=_arms_of(np.linalg.norm(loose, axis=1) > PART_TOLERANCE, bounds),
        residual=_residual([M_o, *M], constraint, right, x),
    )


def _solve_singular(
    scaled: np.ndarray, right: np.ndarray, rows: np.ndarray, columns: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Solution by singular values, and the null vectors from the right, scaled, as columns."""
    u, singular, vt = np.linalg.svd(scaled)
    rank = int(np.sum(singular > SYSTEM_TOLERANCE * singular[0]))
    unserved, free = rows[:, None] * u[:, rank:], vt[rank:].T
    right = right.copy()
    right[size:] -= np.linalg.lstsq(unserved[size:].T, unserved.T @ right, rcond=None)[0]
    x = columns * (vt[:rank].T @ ((u[:, :rank].T @ (rows * right)) / singular[:rank]))
    # the least norm is meant in newtons, not in scaled units
    loose = columns[:, None] * free
    return x - loose @ np.linalg.lstsq(loose[size:], x[size:], rcond=None)[0], free


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
    return free[size:] @ vt[motion > MOTION_TOLERANCE].T


def _arms_of(contacts: np.ndarray, bounds: np.ndarray) -> tuple[int, ...]:
    """Numbers of the arms that have one of the marked contacts."""
    return tuple(i for i, own in enumerate(np.split(contacts, bounds)) if np.any(own))


def _residual(
    inertias: list[np.ndarray], constraint: np.ndarray, right: np.ndarray, x: np.ndarray
) -> float:
    """Largest ``W^T q - c`` relative to the largest of the terms that should cancel there.

    These are c and, of object and arms, the parts without contact forces and due to them.
    """
    size = sum(len(inertia) for inertia in inertias)
    bounds = np.cumsum([len(inertia) for inertia in inertias])[:-1]
    loads = np.split(right[:size], bounds)
    without = np.concatenate([_over(m, load) for m, load in zip(inertias, loads, strict=True)])
    terms = [right[size:]]
    for part in (slice(0, 6), slice(6, size)):  # object, arms
        W = constraint[part]
        terms += [W.T @ without[part], W.T @ (x[part] - without[part])]
    largest = max(float(np.max(np.abs(term), initial=0.0)) for term in terms)
    left = float(np.max(np.abs(constraint.T @ x[:size] - right[size:]), initial=0.0))
    return left / largest if largest > 0.0 else 0.0


def _over(inertia: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Acceleration without contacts; the smallest one where an inertia matrix is singular."""
    try:
        return np.linalg.solve(inertia, load)
    except np.linalg.LinAlgError:
        return np.linalg.lstsq(inertia, load, rcond=None)[0]


def _reciprocal_norms(matrix: np.ndarray) -> np.ndarray:
    """One over the length of every column; 1 for columns of zeros."""
    norms = np.linalg.norm(matrix, axis=0)
    return 1.0 / np.where(norms > 0.0, norms, 1.0)


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
    """Null space of a matrix, its rank decided by a relative tolerance.

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


def null_space(matrix: np.ndarray, tolerance: float = RANK_TOLERANCE) -> NullSpace:
    """Null space of a matrix (m, n) whose rows and columns are scaled to be comparable."""
    _, singular, vt = np.linalg.svd(matrix)
    singular = singular / singular[0]
    rank = int(np.sum(singular > tolerance))
    return NullSpace(vt[rank:].T, rank, singular)
