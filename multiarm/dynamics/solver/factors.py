r"""Factors of small matrices in compiled code: LU with pivoting, singular values.

The singular values come from one-sided Jacobi rotations: vectors are turned in pairs until all are
orthogonal, and their lengths are the singular values.  They are accurate even where they are small,
and vectors that depend on the others end as zeros, which is how a rank shows.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.jit.kernels import inlined, kernel

_EPS = float(np.finfo(float).eps)
# Rows count as orthogonal when the cosine between them is below this: what the sums of their
# products are rounded by.
ORTHOGONAL = 64.0 * _EPS
# Sweeps over all pairs of rows; six to ten are usual.
MOST_SWEEPS = 60


@kernel
def factor_lu(A, n, pivots):
    """LU factors of ``A[:n, :n]`` in place, rows exchanged as ``pivots`` says.

    Returns the smallest pivot relative to the largest (both as magnitudes): 0 when the matrix is
    singular, NaN when it is not finite.
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
    return smallest / largest


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


@kernel
def orthogonalize(A, count, length, follow, width):
    """Rotate the first ``count`` rows of ``A`` against each other until they are orthogonal.

    The rows of ``follow`` (``width`` numbers each) are rotated along; one-sided Jacobi method
    (M. R. Hestenes, J. SIAM 6, 1958), which finds small singular values as exactly as large ones.
    """
    total = 0.0
    for i in range(count):
        for k in range(length):
            total += A[i, k] * A[i, k]
    floor = _EPS * _EPS * total  # shorter rows are roundings of zeros
    for _ in range(MOST_SWEEPS):
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
                slope = (bb - aa) / (2.0 * ab)
                tangent = 1.0 / (abs(slope) + math.sqrt(1.0 + slope * slope))
                if slope < 0.0:
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
