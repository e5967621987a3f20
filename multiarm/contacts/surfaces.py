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
from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import open_body
from multiarm.contacts.table import open_shape
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
from multiarm.jit.rows import Number, Symmetric, Vector, fields_of, row_of, width
from multiarm.jit.vectors import (
    add_outer,
    add_symmetric,
    compose,
    diagonal,
    dot,
    norm,
    rotate,
    rotate_back,
    rotate_symmetric,
    scale,
    sub,
)


class Query(NamedTuple):
    """A point at which a surface is evaluated, and the results."""

    function: Number  # number of a user's function
    point: Vector  # in the surface's own frame [m]
    distance: Number  # signed [m]
    gradient: Vector
    second: Symmetric  # derivatives [1/m]


QUERY_WIDTH, open_query = width(Query), row_of(Query)

_FLAT = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def user_surface_callback(functions: list[SmoothShape], query: np.ndarray) -> Callable[[], None]:
    """Function that evaluates the user surfaces at the kernel's queries."""
    upper, fields = np.triu_indices(3), fields_of(Query, query)

    def evaluate() -> None:
        surface = functions[int(fields.function)]
        distance, gradient, second = surface.closest(fields.point.copy())
        fields.distance[...], fields.gradient[:], fields.second[:] = (
            distance, gradient, second[upper]
        )  # fmt: skip

    return evaluate


@inlined
def _isotropic(k, n):
    """Curvature ``k`` along both tangents, ``k (I - n n^T)``."""
    return add_outer(diagonal((k, k, k)), -k, n)


@kernel
def local_distance(shape, query, function_call):
    """Evaluate a surface at the point of a query, in its own frame; both are rows.

    Where there is no normal (on an axis, at a centre) the result is not finite.
    """
    surface, at = open_shape(shape), open_query(query)
    kind = int(surface.kind)
    y, (a, b, c) = at.point, surface.sizes
    height, radial = y[2], _hypotenuse(y[0], y[1])
    r0, r1 = (y[0] / radial, y[1] / radial) if radial > 0.0 else (math.nan, math.nan)
    around = (-r1, r0, 0.0)
    if kind == PLANE:
        s, n, H = height, (0.0, 0.0, 1.0), _FLAT
    elif kind == SPHERE:
        distance = norm(y)
        n = scale(1.0 / distance, y)
        s, H = distance - a, _isotropic(1.0 / distance, n)
    elif kind == CYLINDER:
        s, n, H = radial - a, (r0, r1, 0.0), add_outer(_FLAT, 1.0 / radial, around)
    elif kind == CONE:
        # outside of the polar cone of the apex
        regular = radial * a + height * b > 0.0
        s, n = radial * b - height * a if regular else math.nan, (b * r0, b * r1, -a)
        H = add_outer(_FLAT, b / radial, around)
    elif kind == TORUS:
        out = radial - a
        distance = _hypotenuse(out, height)
        cosine, sine = out / distance, height / distance
        s, n = distance - b, (cosine * r0, cosine * r1, sine)
        H = add_outer(_FLAT, 1.0 / distance, (-sine * r0, -sine * r1, cosine))
        H = add_outer(H, cosine / radial, around)
    elif kind == ELLIPSOID:
        s, n, H = _ellipsoid(y, a, b, c)
    else:
        at.function = surface.function
        call_python(function_call)
        return
    at.distance, at.gradient, at.second = s, n, H


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
def _ellipsoid(y, a, b, c):
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
    return t * length, n, _offset(t * length, _projected(d, m, n), n)


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
    """Evaluate a surface on a body, world axes, hollow side included; results in the query.

    ``body`` (24,) is a row of body kinematics, ``d`` the point relative to the body's origin, a
    tuple in world axes [m].
    """
    surface, at = open_shape(shape), open_query(query)
    Q, side = surface.axes, surface.side
    R = compose(open_body(body).rotation, Q)
    at.point = sub(rotate_back(R, d), rotate_back(Q, surface.origin))
    local_distance(shape, query, function_call)
    n, H = scale(side, rotate(R, at.gradient)), rotate_symmetric(R, at.second)
    if side < 0.0:
        H = (-H[0], -H[1], -H[2], -H[3], -H[4], -H[5])
    at.distance, at.gradient, at.second = side * at.distance, n, H
