r"""Signed distances of all surfaces, with first and second derivatives, compiled.

A surface is represented by its signed distance :math:`s(p)`: positive outside, negative inside the
solid body.  Its gradient is the outward unit normal :math:`n` at the foot of ``p``, and

.. math:: \nabla^2 s = S\,(I + s\,S)^{-1}

with the shape operator ``S`` at that foot (for a sphere of radius r: ``(I - n n^T) / (r + s)``).
Contacts need nothing else (:mod:`multiarm.contacts.kernel`): a fingertip's gap is the distance at
its centre less its radius, the gap of two surfaces is the stationary value of the sum of their
distances.

Each surface has its own frame: a plane is ``z = 0`` with normal ``z``; sphere and ellipsoid
are centred; cylinder, torus and cone are about the z axis, the cone's apex at the origin and its
opening along z.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from multiarm.contacts.table import (
    SHAPE_AXES,
    SHAPE_FUNCTION,
    SHAPE_KIND,
    SHAPE_ORIGIN,
    SHAPE_SIDE,
    SHAPE_SIZES,
)
from multiarm.geometry.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SPHERE,
    TORUS,
    SmoothShape,
)
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.pointers import call_python
from multiarm.jit.vectors import (
    add_outer,
    add_symmetric,
    compose,
    diagonal,
    dot,
    norm,
    put,
    put_symmetric,
    rotate,
    rotate_back,
    rotate_symmetric,
    rotation,
    scale,
    sub,
    symmetric,
    vec,
)

# Entries of a query: number of the user function and the point (surface's own frame), then the
# results: signed distance, gradient, second derivatives (xx, xy, xz, yy, yz, zz).
FUNCTION, PLACE, DISTANCE, GRADIENT, SECOND, QUERY_WIDTH = 0, 1, 4, 5, 8, 14

_FLAT = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def user_surface_callback(functions: list[SmoothShape], query: np.ndarray) -> Callable[[], None]:
    """Function that evaluates the user surfaces at the kernel's queries."""
    upper = np.triu_indices(3)

    def evaluate() -> None:
        surface = functions[int(query[FUNCTION])]
        distance, gradient, second = surface.closest(query[PLACE : PLACE + 3].copy())
        query[DISTANCE] = distance
        query[GRADIENT : GRADIENT + 3] = gradient
        query[SECOND : SECOND + 6] = second[upper]

    return evaluate


@inlined
def _write_result(query, s, n, H):
    query[DISTANCE] = s
    put(query, GRADIENT, n)
    put_symmetric(query, SECOND, H)


@inlined
def _isotropic(k, n):
    """Curvature ``k`` along both tangents, ``k (I - n n^T)``."""
    return add_outer(diagonal((k, k, k)), -k, n)


@kernel
def local_distance(shape, query, function_call):
    """Evaluate the surface ``shape`` (18,) at ``query[PLACE:]``, in its own frame.

    Where there is no normal (on an axis, at a centre) the result is not finite.
    """
    kind = int(shape[SHAPE_KIND])
    y, (a, b, c) = vec(query, PLACE), vec(shape, SHAPE_SIZES)
    height, radial = y[2], _hypotenuse(y[0], y[1])
    r0, r1 = (y[0] / radial, y[1] / radial) if radial > 0.0 else (math.nan, math.nan)
    around = (-r1, r0, 0.0)
    if kind == PLANE:
        _write_result(query, height, (0.0, 0.0, 1.0), _FLAT)
    elif kind == SPHERE:
        distance = norm(y)
        n = scale(1.0 / distance, y)
        _write_result(query, distance - a, n, _isotropic(1.0 / distance, n))
    elif kind == CYLINDER:
        _write_result(query, radial - a, (r0, r1, 0.0), add_outer(_FLAT, 1.0 / radial, around))
    elif kind == CONE:
        # outside of the polar cone of the apex
        regular = radial * a + height * b > 0.0
        H = add_outer(_FLAT, b / radial, around)
        _write_result(
            query, radial * b - height * a if regular else math.nan, (b * r0, b * r1, -a), H
        )
    elif kind == TORUS:
        out = radial - a
        distance = _hypotenuse(out, height)
        cosine, sine = out / distance, height / distance
        H = add_outer(_FLAT, 1.0 / distance, (-sine * r0, -sine * r1, cosine))
        H = add_outer(H, cosine / radial, around)
        _write_result(query, distance - b, (cosine * r0, cosine * r1, sine), H)
    elif kind == ELLIPSOID:
        _ellipsoid(query, y, a, b, c)
    else:
        query[FUNCTION] = shape[SHAPE_FUNCTION]
        call_python(function_call)


@inlined
def _hypotenuse(x, y):
    return math.sqrt(x * x + y * y)


@inlined
def _ratio(numerator, denominator):
    """Their ratio, where 0 / 0 is 0: a zero coordinate has no part in the sum."""
    return numerator / denominator if numerator != 0.0 else 0.0


@inlined
def _ratios(a, b):
    """Component by component."""
    return _ratio(a[0], b[0]), _ratio(a[1], b[1]), _ratio(a[2], b[2])


@inlined
def _ellipsoid(query, y, a, b, c):
    r"""Foot ``x_i = a_i^2 y_i / (t + a_i^2)`` of a point ``y``, where ``t`` is the largest root of
    ``sum (a_i y_i / (t + a_i^2))^2 = 1`` (D. Eberly, Distance from a Point to an Ellipsoid, 2013).

    The left side decreases and is convex right of its last pole: Newton's method from the left of
    the root never oversteps it.
    """
    # the unknown is e = t + the least a_i^2, so that nothing cancels near the planes of symmetry
    A, B, C = a * a, b * b, c * c
    least = min(A, min(B, C))
    A, B, C = A - least, B - least, C - least
    ay = (a * y[0], b * y[1], c * y[2])
    e = max(0.0, max(abs(ay[0]) - A, max(abs(ay[1]) - B, abs(ay[2]) - C)))
    if (y[0] / a) ** 2 + (y[1] / b) ** 2 + (y[2] / c) ** 2 >= 1.0:
        e = max(e, least)
    for _ in range(100):
        poles = (e + A, e + B, e + C)
        u = _ratios(ay, poles)
        step = 0.5 * (dot(u, u) - 1.0) / dot(u, _ratios(u, poles))
        e += step
        if not abs(step) > 4e-16 * e:
            break
    # gradient of F / 2 = (sum x_i^2 / a_i^2 - 1) / 2 at the foot, and its length; the centre has no
    # unique foot
    g, t = _ratios(y, (e + A, e + B, e + C)), (e - least if e > 0.0 else math.nan)
    length = norm(g)
    n = scale(1.0 / length, g)
    # S = P diag(1 / a_i^2) P / length, P = I - n n^T; then the offset by s = t length
    d = (1.0 / (a * a * length), 1.0 / (b * b * length), 1.0 / (c * c * length))
    m = (d[0] * n[0], d[1] * n[1], d[2] * n[2])
    _write_result(query, t * length, n, _offset(t * length, _projected(d, m, n), n))


@inlined
def _projected(d, m, n):
    """``P diag(d) P`` with ``P = I - n n^T``, where ``m = diag(d) n``."""
    along = dot(n, m)
    u = sub(scale(0.5 * along, n), m)
    return (
        d[0] + 2.0 * u[0] * n[0],
        u[0] * n[1] + n[0] * u[1],
        u[0] * n[2] + n[0] * u[2],
        d[1] + 2.0 * u[1] * n[1],
        u[1] * n[2] + n[1] * u[2],
        d[2] + 2.0 * u[2] * n[2],
    )


@inlined
def _offset(s, S, n):
    """``S (I + s S)^-1`` for a shape operator ``S``.

    ``S`` has the eigenvalues 0 (along n), k_1 and k_2, so that with the sum ``k`` and the product
    ``g`` of the last two the result is ``(S + s g P) / (1 + s k + s^2 g)``.
    """
    xx, xy, xz, yy, yz, zz = S
    k = xx + yy + zz
    g = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    f = 1.0 / (1.0 + s * k + s * s * g)
    H = add_symmetric(S, _isotropic(s * g, n))
    return f * H[0], f * H[1], f * H[2], f * H[3], f * H[4], f * H[5]


@kernel
def world_distance(shape, body, d, query, function_call):
    """Evaluate a surface on a body into ``query[DISTANCE:]``, world axes, hollow side included.

    ``body`` (24,) is a row of body kinematics, ``d`` the point relative to the body's origin, a
    tuple in world axes [m].
    """
    Q, side = rotation(shape, SHAPE_AXES), shape[SHAPE_SIDE]
    R = compose(rotation(body, 0), Q)
    put(query, PLACE, sub(rotate_back(R, d), rotate_back(Q, vec(shape, SHAPE_ORIGIN))))
    local_distance(shape, query, function_call)
    n = scale(side, rotate(R, vec(query, GRADIENT)))
    H = rotate_symmetric(R, symmetric(query, SECOND))
    _write_result(query, side * query[DISTANCE], n, H)
    if side < 0.0:
        for i in range(SECOND, QUERY_WIDTH):
            query[i] = -query[i]
