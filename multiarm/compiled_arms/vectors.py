r"""Vectors and symmetric matrices of four arms at once: tuples of lanes.

A vector is a tuple of three, a rotation a tuple of its three columns (the axes that it makes of x,
y, z), a symmetric matrix the tuple ``xx, xy, xz, yy, yz, zz``.  What ends in ``_onto`` adds to a
first argument, term after term, so that every product is added in the instruction that forms it.
"""

from __future__ import annotations

from multiarm.lanes import LANES, lanes_at, lanes_of, put_lanes
from multiarm.lowlevel import inlined


@inlined
def vector_at(array, at):
    """Three lanes that follow each other."""
    return lanes_at(array, at), lanes_at(array, at + LANES), lanes_at(array, at + 2 * LANES)


@inlined
def put_vector(array, at, a):
    """Write three lanes."""
    put_lanes(array, at, a[0])
    put_lanes(array, at + LANES, a[1])
    put_lanes(array, at + 2 * LANES, a[2])


@inlined
def symmetric_at(array, at):
    """Six lanes that follow each other."""
    xx, xy, xz = vector_at(array, at)
    yy, yz, zz = vector_at(array, at + 3 * LANES)
    return xx, xy, xz, yy, yz, zz


@inlined
def put_symmetric(array, at, A):
    """Write six lanes."""
    put_vector(array, at, (A[0], A[1], A[2]))
    put_vector(array, at + 3 * LANES, (A[3], A[4], A[5]))


@inlined
def put_pair(array, at, a, b):
    """Write two vectors, one behind the other."""
    put_vector(array, at, a)
    put_vector(array, at + 3 * LANES, b)


@inlined
def put_columns(array, at, axes):
    """Write a rotation column by column."""
    put_vector(array, at, axes[0])
    put_vector(array, at + 3 * LANES, axes[1])
    put_vector(array, at + 6 * LANES, axes[2])


@inlined
def put_rows(array, at, axes):
    """Write a rotation row by row."""
    x, y, z = axes
    put_columns(array, at, ((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])))


@inlined
def nothing():
    """The vector zero."""
    zero = lanes_of(0.0)
    return zero, zero, zero


@inlined
def everywhere(a):
    """A vector of plain numbers, the same for all arms."""
    return lanes_of(a[0]), lanes_of(a[1]), lanes_of(a[2])


@inlined
def plus(a, b):
    """``a + b``."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def minus(a, b):
    """``a - b``."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def scaled(s, a):
    """``s a``."""
    return s * a[0], s * a[1], s * a[2]


@inlined
def scaled_onto(c, s, a):
    """``c + s a``."""
    return c[0] + s * a[0], c[1] + s * a[1], c[2] + s * a[2]


@inlined
def dot(a, b):
    """``a . b``."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def power(linear, angular, force, couple):
    """``linear . force + angular . couple``."""
    return dot(linear, force) + dot(angular, couple)


@inlined
def cross_onto(c, a, b):
    """``c + a x b``."""
    return (
        c[0] + a[1] * b[2] - a[2] * b[1],
        c[1] + a[2] * b[0] - a[0] * b[2],
        c[2] + a[0] * b[1] - a[1] * b[0],
    )


@inlined
def turned(axes, a):
    """``R a``, the rotation given by its columns."""
    x, y, z = axes
    return (
        x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )


@inlined
def turned_onto(c, axes, a):
    """``c + R a``."""
    x, y, z = axes
    return (
        c[0] + x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        c[1] + x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        c[2] + x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )


@inlined
def turned_symmetric(axes, A):
    """``R A R^T``."""
    u = turned(axes, (A[0], A[1], A[2]))
    v = turned(axes, (A[1], A[3], A[4]))
    w = turned(axes, (A[2], A[4], A[5]))
    x, y, z = axes
    return (
        u[0] * x[0] + v[0] * y[0] + w[0] * z[0],
        u[0] * x[1] + v[0] * y[1] + w[0] * z[1],
        u[0] * x[2] + v[0] * y[2] + w[0] * z[2],
        u[1] * x[1] + v[1] * y[1] + w[1] * z[1],
        u[1] * x[2] + v[1] * y[2] + w[1] * z[2],
        u[2] * x[2] + v[2] * y[2] + w[2] * z[2],
    )


@inlined
def symmetric_sum(A, B):
    """``A + B``."""
    return A[0] + B[0], A[1] + B[1], A[2] + B[2], A[3] + B[3], A[4] + B[4], A[5] + B[5]


@inlined
def product_onto(c, A, a):
    """``c + A a``, A symmetric."""
    return (
        c[0] + A[0] * a[0] + A[1] * a[1] + A[2] * a[2],
        c[1] + A[1] * a[0] + A[3] * a[1] + A[4] * a[2],
        c[2] + A[2] * a[0] + A[4] * a[1] + A[5] * a[2],
    )
