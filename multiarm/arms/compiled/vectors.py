"""Vectors, rotations and symmetric matrices of four arms at once, in arrays of lanes.

What is computed with them is in :mod:`multiarm.jit.vectors`.
"""

from __future__ import annotations

from multiarm.jit.kernels import inlined
from multiarm.jit.simd import LANES, broadcast, load_pack, store_pack
from multiarm.jit.vectors import dot


@inlined
def vector_at(array, at):
    """Three lanes that follow each other."""
    return load_pack(array, at), load_pack(array, at + LANES), load_pack(array, at + 2 * LANES)


@inlined
def put_vector(array, at, a):
    """Write three lanes."""
    store_pack(array, at, a[0])
    store_pack(array, at + LANES, a[1])
    store_pack(array, at + 2 * LANES, a[2])


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
    zero = broadcast(0.0)
    return zero, zero, zero


@inlined
def everywhere(a):
    """A vector of plain numbers, the same for all arms."""
    return broadcast(a[0]), broadcast(a[1]), broadcast(a[2])


@inlined
def power(linear, angular, force, couple):
    """``linear . force + angular . couple``."""
    return dot(linear, force) + dot(angular, couple)
