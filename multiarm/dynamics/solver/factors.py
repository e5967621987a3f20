r"""Factorizations of small matrices: Cholesky, LU with pivoting, singular values.

Singular values come from one-sided Jacobi rotations (M. R. Hestenes, J. SIAM 6, 1958): rows are
rotated in pairs until all are orthogonal; their lengths are the singular values.  Small ones are
accurate too, and rows that depend on the others end as zeros, which shows the rank.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.solver.bounds import SEMIDEFINITE_PIVOT
from multiarm.jit.kernels import allocating, inlined, kernel, plain

_EPS = float(np.finfo(float).eps)
# Rows count as orthogonal when the cosine of their angle is below this: the rounding of the sums of
# products.
ORTHOGONAL = 64.0 * _EPS


@kernel
def factor_cholesky(A, n):
    """Cholesky factor of ``A[:n, :n]`` into its lower triangle, the diagonal inverted.

    Returns the smallest pivot relative to its diagonal entry; the factor is usable only when that
    is positive; 0 where a pivot is NaN.
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
def copy_block(source, n, m, out):
    """Write ``source[:n, :m]`` into ``out``, a matrix of the same shape or another."""
    for j in range(n):
        for a in range(m):
            out[j, a] = source[j, a]


@inlined
def forward_columns(L, Y, n, m):
    """Write ``L^-1 Y`` into ``Y`` (n, m), with the factor of :func:`factor_cholesky`."""
    for j in range(n):
        for k in range(j):
            factor = L[j, k]
            for a in range(m):
                Y[j, a] -= factor * Y[k, a]
        inverse = L[j, j]
        for a in range(m):
            Y[j, a] *= inverse


@inlined
def forward(L, n, x):
    """Write ``L^-1 x`` into ``x`` (n,), with the factor of :func:`factor_cholesky`."""
    for j in range(n):
        s = x[j]
        for k in range(j):
            s -= L[j, k] * x[k]
        x[j] = s * L[j, j]


@inlined
def backward(L, n, x):
    """Write ``L^-T x`` into ``x`` (n,), with the factor of :func:`factor_cholesky`."""
    for j in range(n - 1, -1, -1):
        s = x[j]
        for k in range(j + 1, n):
            s -= L[k, j] * x[k]
        x[j] = s * L[j, j]


@inlined
def copy_lower(A, n, out):
    """Write the lower triangle of ``A[:n, :n]`` into ``out``."""
    for j in range(n):
        for k in range(j + 1):
            out[j, k] = A[j, k]


@allocating
def solve_semidefinite(A, b, x):
    """Solve ``A x = b`` for a symmetric, positive semidefinite matrix (n, n); returns its rank.

    Cholesky's method with diagonal pivoting, ``A = L L^T``.  It stops at pivots below a part
    ``SEMIDEFINITE_PIVOT`` of the largest diagonal entry, so that ``L`` has as many columns as the
    rank.  Below full rank ``x`` is the least-squares solution of least norm, which varies
    continuously with ``A`` and ``b`` as long as the rank stays: with the columns ``t`` of ``L``
    rotated until they are orthogonal, the sum of ``t (t . b) / |t|^4``.  Rows should be scaled so
    that the diagonal entries can be compared.  ``A`` becomes ``L``, whose columns are those of the
    pivots, and ``x`` (n,) is written.
    """
    n = b.size
    order = np.empty(n, dtype=np.int64)
    largest = 0.0
    for i in range(n):
        order[i], x[i] = i, 0.0
        largest = max(largest, A[i, i])
    rank = n
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if A[order[i], order[i]] > A[order[best], order[best]]:
                best = i
        order[k], order[best] = order[best], order[k]
        p = order[k]
        if not A[p, p] > SEMIDEFINITE_PIVOT * largest:
            rank = k
            break
        A[p, p] = math.sqrt(A[p, p])
        for i in range(k + 1, n):
            A[order[i], p] /= A[p, p]
        for i in range(k + 1, n):
            for j in range(k + 1, n):
                A[order[i], order[j]] -= A[order[i], p] * A[order[j], p]
    if rank < n:
        columns = np.empty((rank, n))
        for k in range(rank):
            for i in range(n):
                columns[k, order[i]] = A[order[i], order[k]] if i >= k else 0.0
        orthogonalize(columns, rank, n, columns, 0)
        for k in range(rank):
            square = along = 0.0
            for i in range(n):
                square += columns[k, i] * columns[k, i]
                along += columns[k, i] * b[i]
            for i in range(n):
                x[i] += columns[k, i] * along / (square * square)
        return rank
    for k in range(rank):
        p = order[k]
        x[p] = b[p]
        for j in range(k):
            x[p] -= A[p, order[j]] * x[order[j]]
        x[p] /= A[p, p]
    for k in range(rank - 1, -1, -1):
        p = order[k]
        for i in range(k + 1, rank):
            x[p] -= A[order[i], p] * x[order[i]]
        x[p] /= A[p, p]
    return rank


@kernel
def factor_lu(A, n, pivots):
    """LU factors of ``A[:n, :n]`` in place, rows exchanged as ``pivots`` says.

    Returns the smallest pivot relative to the largest (both as magnitudes): 0 when the matrix is
    singular, NaN when it is not finite, infinity when ``n`` is 0.
    """
    smallest, largest = math.inf, 0.0
    for j in range(n):
        best = j
        for i in range(j + 1, n):
            if abs(A[i, j]) > abs(A[best, j]):
                best = i
        pivots[j] = best
        if best != j:
            for k in range(n):
                A[j, k], A[best, k] = A[best, k], A[j, k]
        size = abs(A[j, j])
        if size != size:
            return size
        if size == 0.0:
            return 0.0
        smallest, largest = min(smallest, size), max(largest, size)
        inverse = 1.0 / A[j, j]
        for i in range(j + 1, n):
            factor = A[i, j] * inverse
            A[i, j] = factor
            for k in range(j + 1, n):
                A[i, k] -= factor * A[j, k]
    return smallest / largest if n > 0 else smallest


@kernel
def solve_lu(A, n, pivots, x):
    """Solve ``A x = b`` with the factors of :func:`factor_lu`; ``x`` is ``b`` on entry."""
    for j in range(n):
        x[j], x[pivots[j]] = x[pivots[j]], x[j]
    for i in range(n):
        for k in range(i):
            x[i] -= A[i, k] * x[k]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= A[i, k] * x[k]
        x[i] /= A[i, i]


@kernel
def solve_lu_transposed(A, n, pivots, x):
    """Solve ``A^T x = b`` with the factors of :func:`factor_lu`; ``x`` is ``b`` on entry."""
    for i in range(n):
        for k in range(i):
            x[i] -= A[k, i] * x[k]
        x[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= A[k, i] * x[k]
    for j in range(n - 1, -1, -1):
        x[j], x[pivots[j]] = x[pivots[j]], x[j]


@kernel
def solve_rows(A, n, pivots, X):
    """Solve ``A X = B`` with the factors of ``factor_lu``; ``X[:n]`` is ``B`` on entry."""
    for i in range(n):
        if pivots[i] != i:
            row, pivot_row = X[i], X[pivots[i]]
            for c in range(row.size):
                row[c], pivot_row[c] = pivot_row[c], row[c]
    for i in range(n):
        for k in range(i):
            subtract(A[i, k], X[k], X[i])
    for i in range(n - 1, -1, -1):
        row, inverse = X[i], 1.0 / A[i, i]
        for k in range(i + 1, n):
            subtract(A[i, k], X[k], row)
        for c in range(row.size):
            row[c] *= inverse


@inlined
def subtract(factor, solved_row, row):
    """``row -= factor * solved_row``."""
    for c in range(row.size):
        row[c] -= factor * solved_row[c]


@kernel
def decompose(A, n, m, V, singular):
    r"""Singular values of a matrix of ``n`` columns ``A[k, :m]``.

    On return ``A[k, :m]`` is the left singular vector of ``singular[k]`` (zeros where that is 0),
    ``V[k, :n]`` the right one; the values descend.  Returns False when a number is not finite.
    """
    total = 0.0
    for k in range(n):
        for j in range(n):
            V[k, j] = 1.0 if j == k else 0.0
        for i in range(m):
            total += A[k, i] * A[k, i]
    if not math.isfinite(total):
        return False
    orthogonalize(A, n, m, V, n)
    for k in range(n):
        singular[k] = norm(A[k], m)
        if not singular[k] > _EPS * math.sqrt(total):
            singular[k] = 0.0
        inverse = 1.0 / singular[k] if singular[k] > 0.0 else 0.0
        for i in range(m):
            A[k, i] *= inverse
    _sort(A, n, m, V, singular)
    return True


@plain
def rank_of(singular, tolerance, least_scale=0.0):
    """Number of singular values (k,), in descending order, that do not count as zero.

    Those count that are above ``tolerance`` times the largest, or times ``least_scale`` where that
    is larger.
    """
    rank = 0
    for k in range(singular.size):
        if singular[k] > tolerance * max(singular[0], least_scale):
            rank += 1
    return rank


@kernel
def orthogonalize(A, count, length, follow, width):
    """Rotate the first ``count`` rows of ``A`` against each other until they are orthogonal.

    The rows of ``follow`` (``width`` numbers each) are rotated along.
    """
    total = 0.0
    for i in range(count):
        for k in range(length):
            total += A[i, k] * A[i, k]
    floor = _EPS * _EPS * total  # shorter rows are roundings of zeros
    for _ in range(60):  # sweeps over all pairs of rows; six to ten are usual
        settled = True
        for i in range(count - 1):
            for j in range(i + 1, count):
                aa = bb = ab = 0.0
                for k in range(length):
                    aa += A[i, k] * A[i, k]
                    bb += A[j, k] * A[j, k]
                    ab += A[i, k] * A[j, k]
                if aa <= floor or bb <= floor or not abs(ab) > ORTHOGONAL * math.sqrt(aa * bb):
                    continue
                settled = False
                cotangent = (bb - aa) / (2.0 * ab)  # of twice the angle
                tangent = 1.0 / (abs(cotangent) + math.sqrt(1.0 + cotangent * cotangent))
                if cotangent < 0.0:
                    tangent = -tangent
                cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
                rotate(A[i], A[j], length, cosine, cosine * tangent)
                rotate(follow[i], follow[j], width, cosine, cosine * tangent)
        if settled:
            return


@inlined
def rotate(a, b, length, cosine, sine):
    """Rotate two rows against each other."""
    for k in range(length):
        old = a[k]
        a[k] = cosine * old - sine * b[k]
        b[k] = sine * old + cosine * b[k]


@inlined
def norm(row, length):
    """Length of the first ``length`` entries of a row."""
    total = 0.0
    for k in range(length):
        total += row[k] * row[k]
    return math.sqrt(total)


@kernel
def _sort(A, n, m, V, singular):
    """Put the singular values in descending order."""
    for k in range(n - 1):
        best = k
        for j in range(k + 1, n):
            if singular[j] > singular[best]:
                best = j
        if best == k:
            continue
        singular[k], singular[best] = singular[best], singular[k]
        for i in range(m):
            A[k, i], A[best, i] = A[best, i], A[k, i]
        for i in range(n):
            V[k, i], V[best, i] = V[best, i], V[k, i]
