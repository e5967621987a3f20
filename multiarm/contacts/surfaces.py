r"""The signed distance of every built-in surface, with its first and second derivatives, compiled.

A surface is known by its signed distance :math:`s(p)`: positive outside, negative inside the solid
body.  Its gradient is the outward unit normal :math:`n` at the foot of ``p`` on the surface, and

.. math:: \nabla^2 s = S\,(I + s\,S)^{-1}

with the shape operator ``S`` at that foot (for a sphere of radius r: ``(I - n n^T) / (r + s)``).
Contacts need nothing else, see :mod:`multiarm.contacts.kernel`: a fingertip's gap is the distance
at its centre less its radius, the gap of two surfaces is the stationary value of the sum of their
distances.

Here a surface stands in its own frame: a plane is ``z = 0`` with normal ``z``; sphere and ellipsoid
are centred; cylinder, torus and cone are about the z axis, the cone's apex at the origin and its
opening along z.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from multiarm.contacts.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SHAPE_AXES,
    SHAPE_FUNCTION,
    SHAPE_KIND,
    SHAPE_ORIGIN,
    SHAPE_SIDE,
    SHAPE_SIZES,
    SPHERE,
    TORUS,
    SmoothShape,
)
from multiarm.lowlevel import call_back, inlined, kernel

# Entries of a query: number of the user's function and the place where it is asked (surface's own
# frame), then the answer: signed distance, gradient, second derivatives (xx, xy, xz, yy, yz, zz).
FUNCTION, PLACE, DISTANCE, GRADIENT, SECOND, QUERY_WIDTH = 0, 1, 4, 5, 8, 14

_NEWTON_STEPS = 100


def answering(functions: list[SmoothShape], query: np.ndarray) -> Callable[[], None]:
    """Function that answers the kernel's queries about the user's surfaces, for a callback."""
    upper = np.triu_indices(3)

    def answer() -> None:
        surface = functions[int(query[FUNCTION])]
        distance, gradient, second = surface.closest(query[PLACE : PLACE + 3].copy())
        query[DISTANCE] = distance
        query[GRADIENT : GRADIENT + 3] = gradient
        query[SECOND : SECOND + 6] = second[upper]

    return answer


@inlined
def _write(query, s, n0, n1, n2):
    query[DISTANCE] = s
    query[GRADIENT], query[GRADIENT + 1], query[GRADIENT + 2] = n0, n1, n2


@inlined
def _curve(query, k, t0, t1, t2, fresh):
    """Curvature ``k`` along the unit tangent ``t``: set, or add to, the second derivatives."""
    if fresh:
        for i in range(6):
            query[SECOND + i] = 0.0
    query[SECOND] += k * t0 * t0
    query[SECOND + 1] += k * t0 * t1
    query[SECOND + 2] += k * t0 * t2
    query[SECOND + 3] += k * t1 * t1
    query[SECOND + 4] += k * t1 * t2
    query[SECOND + 5] += k * t2 * t2


@kernel
def local_distance(shape, query, function_call):
    """Answer the query at ``query[PLACE:]`` for the surface ``shape`` (18,) in its own frame.

    Where there is no normal (on an axis, at a centre) the answer is not finite.
    """
    kind = int(shape[SHAPE_KIND])
    y0, y1, y2 = query[PLACE], query[PLACE + 1], query[PLACE + 2]
    a, b, c = shape[SHAPE_SIZES], shape[SHAPE_SIZES + 1], shape[SHAPE_SIZES + 2]
    radial = math.sqrt(y0 * y0 + y1 * y1)
    r0, r1 = (y0 / radial, y1 / radial) if radial > 0.0 else (math.nan, math.nan)
    if kind == PLANE:
        _write(query, y2, 0.0, 0.0, 1.0)
        _curve(query, 0.0, 0.0, 0.0, 0.0, True)
    elif kind == SPHERE:
        distance = math.sqrt(radial * radial + y2 * y2)
        n0, n1, n2 = y0 / distance, y1 / distance, y2 / distance
        _write(query, distance - a, n0, n1, n2)
        _curve(query, -1.0 / distance, n0, n1, n2, True)
        query[SECOND] += 1.0 / distance
        query[SECOND + 3] += 1.0 / distance
        query[SECOND + 5] += 1.0 / distance
    elif kind == CYLINDER:
        _write(query, radial - a, r0, r1, 0.0)
        _curve(query, 1.0 / radial, -r1, r0, 0.0, True)
    elif kind == CONE:
        # behind the apex no part of the cone is near
        there = radial * a + y2 * b > 0.0
        _write(query, radial * b - y2 * a if there else math.nan, b * r0, b * r1, -a)
        _curve(query, b / radial, -r1, r0, 0.0, True)
    elif kind == TORUS:
        out = radial - a
        distance = math.sqrt(out * out + y2 * y2)
        cosine, sine = out / distance, y2 / distance
        _write(query, distance - b, cosine * r0, cosine * r1, sine)
        _curve(query, 1.0 / distance, -sine * r0, -sine * r1, cosine, True)
        _curve(query, cosine / radial, -r1, r0, 0.0, False)
    elif kind == ELLIPSOID:
        _ellipsoid(query, a, b, c)
    else:
        query[FUNCTION] = shape[SHAPE_FUNCTION]
        call_back(function_call)


@inlined
def _ratio(numerator, denominator):
    """Their ratio; 0 over anything is 0: a zero coordinate has no part, wherever its pole is."""
    return numerator / denominator if numerator != 0.0 else 0.0


@inlined
def _ellipsoid(query, a, b, c):
    r"""Foot ``x_i = a_i^2 y_i / (t + a_i^2)`` of a place ``y``, where ``t`` is the largest root of
    ``sum (a_i y_i / (t + a_i^2))^2 = 1`` (D. Eberly, Distance from a Point to an Ellipsoid, 2013).

    The left side falls and is convex right of its last pole: Newton's method from a place left of
    the root never oversteps it.
    """
    y0, y1, y2 = query[PLACE], query[PLACE + 1], query[PLACE + 2]
    # the unknown is e = t + the least a_i^2, so that nothing cancels near the planes of symmetry
    A, B, C = a * a, b * b, c * c
    least = min(A, min(B, C))
    A, B, C = A - least, B - least, C - least
    e = max(0.0, max(a * abs(y0) - A, max(b * abs(y1) - B, c * abs(y2) - C)))
    if (y0 / a) ** 2 + (y1 / b) ** 2 + (y2 / c) ** 2 >= 1.0:
        e = max(e, least)
    for _ in range(_NEWTON_STEPS):
        u0, u1, u2 = a * _ratio(y0, e + A), b * _ratio(y1, e + B), c * _ratio(y2, e + C)
        value = u0 * u0 + u1 * u1 + u2 * u2 - 1.0
        slope = 2.0 * (_ratio(u0 * u0, e + A) + _ratio(u1 * u1, e + B) + _ratio(u2 * u2, e + C))
        step = value / slope
        e += step
        if not abs(step) > 4e-16 * e:
            break
    t = e - least
    # gradient of F / 2 = (sum x_i^2 / a_i^2 - 1) / 2 at the foot, and its length; on the middle of
    # the inside there is no nearest point
    g0, g1, g2 = _ratio(y0, e + A), _ratio(y1, e + B), _ratio(y2, e + C)
    if not e > 0.0:
        t = math.nan
    length = math.sqrt(g0 * g0 + g1 * g1 + g2 * g2)
    n0, n1, n2 = g0 / length, g1 / length, g2 / length
    _write(query, t * length, n0, n1, n2)
    # S = P diag(1 / a_i^2) P / length, P = I - n n^T; then the offset by s = t length
    d0, d1, d2 = 1.0 / (a * a * length), 1.0 / (b * b * length), 1.0 / (c * c * length)
    m0, m1, m2 = d0 * n0, d1 * n1, d2 * n2
    along = n0 * m0 + n1 * m1 + n2 * m2
    query[SECOND] = d0 - 2.0 * m0 * n0 + along * n0 * n0
    query[SECOND + 1] = -m0 * n1 - n0 * m1 + along * n0 * n1
    query[SECOND + 2] = -m0 * n2 - n0 * m2 + along * n0 * n2
    query[SECOND + 3] = d1 - 2.0 * m1 * n1 + along * n1 * n1
    query[SECOND + 4] = -m1 * n2 - n1 * m2 + along * n1 * n2
    query[SECOND + 5] = d2 - 2.0 * m2 * n2 + along * n2 * n2
    _offset(query)


@inlined
def _offset(query):
    """Turn the shape operator ``S`` in the answer into ``S (I + s S)^-1``.

    ``S`` has the eigenvalues 0 (along n), k_1 and k_2, so that with the sum ``k`` and the product
    ``g`` of the last two the result is ``(S + s g P) / (1 + s k + s^2 g)``.
    """
    s = query[DISTANCE]
    xx, xy, xz = query[SECOND], query[SECOND + 1], query[SECOND + 2]
    yy, yz, zz = query[SECOND + 3], query[SECOND + 4], query[SECOND + 5]
    k = xx + yy + zz
    g = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    scale = 1.0 / (1.0 + s * k + s * s * g)
    n0, n1, n2 = query[GRADIENT], query[GRADIENT + 1], query[GRADIENT + 2]
    query[SECOND] = scale * (xx + s * g * (1.0 - n0 * n0))
    query[SECOND + 1] = scale * (xy - s * g * n0 * n1)
    query[SECOND + 2] = scale * (xz - s * g * n0 * n2)
    query[SECOND + 3] = scale * (yy + s * g * (1.0 - n1 * n1))
    query[SECOND + 4] = scale * (yz - s * g * n1 * n2)
    query[SECOND + 5] = scale * (zz + s * g * (1.0 - n2 * n2))


@kernel
def world_distance(shape, body, d0, d1, d2, query, function_call):
    """Answer at ``query[DISTANCE:]`` for a surface on a body, world axes; its hollow side counts.

    ``body`` (24,) is a row of body kinematics, ``d`` the place seen from the body's origin, world
    axes [m].
    """
    axes, origin, place, gradient, second = SHAPE_AXES, SHAPE_ORIGIN, PLACE, GRADIENT, SECOND
    p0 = body[0] * d0 + body[3] * d1 + body[6] * d2 - shape[origin]
    p1 = body[1] * d0 + body[4] * d1 + body[7] * d2 - shape[origin + 1]
    p2 = body[2] * d0 + body[5] * d1 + body[8] * d2 - shape[origin + 2]
    for j in range(3):
        query[place + j] = (
            shape[axes + j] * p0 + shape[axes + 3 + j] * p1 + shape[axes + 6 + j] * p2
        )
    local_distance(shape, query, function_call)
    side = shape[SHAPE_SIDE]
    s = side * query[DISTANCE]
    # into the body's axes, then into the world's
    for turn in range(2):
        R, at = (shape, axes) if turn == 0 else (body, 0)
        g0, g1, g2 = query[gradient], query[gradient + 1], query[gradient + 2]
        h0, h1, h2 = query[second], query[second + 1], query[second + 2]
        h3, h4, h5 = query[second + 3], query[second + 4], query[second + 5]
        entry = second
        for i in range(3):
            a0, a1, a2 = R[at + 3 * i], R[at + 3 * i + 1], R[at + 3 * i + 2]
            query[gradient + i] = a0 * g0 + a1 * g1 + a2 * g2
            t0 = a0 * h0 + a1 * h1 + a2 * h2
            t1 = a0 * h1 + a1 * h3 + a2 * h4
            t2 = a0 * h2 + a1 * h4 + a2 * h5
            for j in range(i, 3):
                b0, b1, b2 = R[at + 3 * j], R[at + 3 * j + 1], R[at + 3 * j + 2]
                query[entry] = t0 * b0 + t1 * b1 + t2 * b2
                entry += 1
    if side < 0.0:
        for i in range(9):
            query[gradient + i] = -query[gradient + i]
    query[DISTANCE] = s
