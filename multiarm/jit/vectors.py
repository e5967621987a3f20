r"""Small vectors and matrices in compiled code: tuples of numbers, or of SIMD packs.

A vector is a tuple of three.  A rotation is the tuple of its columns, the axes that it makes of x,
y, z; arrays hold it row by row.  A symmetric matrix is the tuple ``xx, xy, xz, yy, yz, zz``.

The numbers are float64, or packs (:mod:`multiarm.jit.simd`): what does not read or write an array
is the same for both.  Tuples live in registers: read all that is needed first, and write last, so
that no number is read twice.  Functions ``add_...`` add to their first argument term after
term, so that every product is added in the instruction that forms it; ``cross`` rounds its products
first, so that ``a x a`` is zero.
"""

from __future__ import annotations

import math

from multiarm.jit.kernels import fused, inlined
from multiarm.jit.simd import broadcast

ZERO = (0.0, 0.0, 0.0)
AXES = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

# Below this size of the skew part near half a turn, its direction has lost too many digits.
HALF_TURN = 1e-4


@inlined
def vec(array, at):
    """The vector ``array[at : at + 3]``."""
    return array[at], array[at + 1], array[at + 2]


@inlined
def put(array, at, a):
    """Write a vector into ``array[at : at + 3]``."""
    array[at], array[at + 1], array[at + 2] = a


@inlined
def rotation(array, at):
    """The rotation ``array[at : at + 9]``, row by row."""
    x, y, z = vec(array, at), vec(array, at + 3), vec(array, at + 6)
    return (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])


@inlined
def broadcast_vector(a):
    """A vector of plain numbers in all lanes."""
    return broadcast(a[0]), broadcast(a[1]), broadcast(a[2])


@inlined
def add(a, b):
    """``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def sub(a, b):
    """``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scale(s, a):
    """``s a``."""
    return s * a[0], s * a[1], s * a[2]


@fused
def add_scaled(c, s, a):
    """``c + s a``."""
    return c[0] + s * a[0], c[1] + s * a[1], c[2] + s * a[2]


@fused
def sub_scaled(c, s, a):
    """``c - s a``."""
    return c[0] - s * a[0], c[1] - s * a[1], c[2] - s * a[2]


@fused
def dot(a, b):
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def norm(a):
    """``|a|``."""
    return math.sqrt(dot(a, a))


@inlined
def across(n, a):
    """Part of ``a`` perpendicular to the unit vector ``n``."""
    return add_scaled(a, -dot(n, a), n)


@inlined
def cross(a, b):
    """``a x b``."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@fused
def add_cross(c, a, b):
    """``c + a x b``."""
    return (
        c[0] + a[1] * b[2] - a[2] * b[1],
        c[1] + a[2] * b[0] - a[0] * b[2],
        c[2] + a[0] * b[1] - a[1] * b[0],
    )


@fused
def rotate(R, a):
    """``R a``."""
    x, y, z = R
    return (
        x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )


@fused
def add_rotated(c, R, a):
    """``c + R a``."""
    x, y, z = R
    return (
        c[0] + x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        c[1] + x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        c[2] + x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )


@inlined
def rotate_back(R, a):
    """``R^T a``."""
    return dot(R[0], a), dot(R[1], a), dot(R[2], a)


@inlined
def compose(R, Q):
    """``R Q``."""
    return rotate(R, Q[0]), rotate(R, Q[1]), rotate(R, Q[2])


@inlined
def rotation_vector(R):
    """Rotation vector ``theta`` of a rotation ``exp(theta)``, up to half a turn [rad].

    The skew part is ``2 sin |theta|`` along it, the trace ``1 + 2 cos |theta|``.  Near half a turn,
    where the skew part vanishes, it lies along each column of the symmetric part less
    ``cos |theta|``; the largest one tells it best.
    """
    x, y, z = R
    q, c = (y[2] - z[1], z[0] - x[2], x[1] - y[0]), x[0] + y[1] + z[2] - 1.0
    size = norm(q)
    angle = math.atan2(size, c)
    if c < 0.0 and size < HALF_TURN:
        k = 0
        if y[1] > x[0] or z[2] > x[0]:
            k = 1 if y[1] > z[2] else 2
        unit = AXES[k]
        along = add_scaled(add(R[k], rotate_back(R, unit)), -c, unit)
        return scale((angle if dot(along, q) >= 0.0 else -angle) / norm(along), along)
    return scale(0.5 if size == 0.0 else angle / size, q)


@fused
def rotate_symmetric(R, A):
    """``R A R^T``."""
    u, v, w = rotate(R, A[0:3]), rotate(R, (A[1], A[3], A[4])), rotate(R, (A[2], A[4], A[5]))
    x, y, z = R
    return (
        u[0] * x[0] + v[0] * y[0] + w[0] * z[0],
        u[0] * x[1] + v[0] * y[1] + w[0] * z[1],
        u[0] * x[2] + v[0] * y[2] + w[0] * z[2],
        u[1] * x[1] + v[1] * y[1] + w[1] * z[1],
        u[1] * x[2] + v[1] * y[2] + w[1] * z[2],
        u[2] * x[2] + v[2] * y[2] + w[2] * z[2],
    )


@inlined
def add_symmetric(A, B):
    """``A + B``."""
    return A[0] + B[0], A[1] + B[1], A[2] + B[2], A[3] + B[3], A[4] + B[4], A[5] + B[5]


@fused
def add_outer(A, s, a):
    """``A + s a a^T``."""
    b = scale(s, a)
    return (
        A[0] + b[0] * a[0],
        A[1] + b[0] * a[1],
        A[2] + b[0] * a[2],
        A[3] + b[1] * a[1],
        A[4] + b[1] * a[2],
        A[5] + b[2] * a[2],
    )


@inlined
def diagonal(a):
    """``diag(a)``."""
    return a[0], 0.0, 0.0, a[1], 0.0, a[2]


@inlined
def times(A, a):
    """``A a``, A symmetric."""
    return dot(A[0:3], a), dot((A[1], A[3], A[4]), a), dot((A[2], A[4], A[5]), a)


@fused
def add_times(c, A, a):
    """``c + A a``, A symmetric."""
    return (
        c[0] + A[0] * a[0] + A[1] * a[1] + A[2] * a[2],
        c[1] + A[1] * a[0] + A[3] * a[1] + A[4] * a[2],
        c[2] + A[2] * a[0] + A[4] * a[1] + A[5] * a[2],
    )


@inlined
def solve(A, b):
    """Solution of ``A x = b``, A symmetric, by its adjugate."""
    xx, xy, xz, yy, yz, zz = A
    c = (yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - yy * xz)
    inverse = 1.0 / (xx * c[0] + xy * c[1] + xz * c[2])
    rest = (xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy)
    return scale(inverse, times(c + rest, b))
