"""Rotations, twists and wrenches: the conventions of the whole package in one place.

* Vectors of six are ``[linear; angular]`` (twists) and ``[force; moment]`` (wrenches).
* A quaternion is ``(x, y, z, w)``, of unit norm, and rotates body components into world
  components: ``a_world = R(q) a_body``.
* Small rotations act from the left, in world axes: ``retract(q, theta) = exp(theta) * q``.  An
  angular velocity in world axes is then the rate of ``theta`` at ``theta = 0``.

Functions that take and return arrays are for Python; those on tuples, and those that write into an
argument, are also compiled into kernels.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.jit.kernels import inlined, kernel, plain
from multiarm.jit.vectors import AXES, add_scaled, cross, put, scale, vec

# Below this angle [rad] the series of a quaternion is exact to rounding, and takes less time.
_SERIES_ANGLE = 1e-2
# Of :func:`_gamma` in powers of the squared angle: with Bernoulli's numbers, |B_2k| / (2 k)! from
# k = 1 on.
_SERIES = (
    1.0 / 12.0, 1.0 / 720.0, 1.0 / 30240.0, 1.0 / 1209600.0, 1.0 / 47900160.0,
    691.0 / 1307674368000.0, 1.0 / 74724249600.0, 3617.0 / 10670622842880000.0,
)  # fmt: skip


@plain
def write_matrix(quaternion: np.ndarray, rotation: np.ndarray) -> None:
    """Write the rotation matrix of a unit quaternion (xyzw) into ``rotation[0:9]``, row by row."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    rotation[0] = 1.0 - 2.0 * (y * y + z * z)
    rotation[1] = 2.0 * (x * y - w * z)
    rotation[2] = 2.0 * (x * z + w * y)
    rotation[3] = 2.0 * (x * y + w * z)
    rotation[4] = 1.0 - 2.0 * (x * x + z * z)
    rotation[5] = 2.0 * (y * z - w * x)
    rotation[6] = 2.0 * (x * z - w * y)
    rotation[7] = 2.0 * (y * z + w * x)
    rotation[8] = 1.0 - 2.0 * (x * x + y * y)


@plain
def rotation_of(quaternion):
    """The columns of the rotation matrix of a unit quaternion (xyzw)."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def quaternion_to_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix, shape (3, 3), of a unit quaternion ``xyzw``, shape (4,)."""
    rotation = np.empty(9)
    write_matrix(quaternion, rotation)
    return rotation.reshape(3, 3)


@plain
def quaternion_of(X, Y, Z):
    """Unit quaternion ``(x, y, z, w)`` with ``w >= 0`` of the columns of a rotation matrix.

    Shepperd's method: the largest of the four components is computed first, so that no division
    is by a small number.
    """
    a, b, c = X[0], Y[1], Z[2]
    trace = a + b + c
    if trace >= max(a, b, c):
        x, y, z, w = Y[2] - Z[1], Z[0] - X[2], X[1] - Y[0], 1.0 + trace
    elif a >= b and a >= c:
        x, y, z, w = 1.0 + 2.0 * a - trace, X[1] + Y[0], X[2] + Z[0], Y[2] - Z[1]
    elif b >= c:
        x, y, z, w = Y[0] + X[1], 1.0 + 2.0 * b - trace, Y[2] + Z[1], Z[0] - X[2]
    else:
        x, y, z, w = Z[0] + X[2], Z[1] + Y[2], 1.0 + 2.0 * c - trace, X[1] - Y[0]
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if w < 0.0:
        norm = -norm
    return x / norm, y / norm, z / norm, w / norm


def matrix_to_quaternion(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion ``xyzw`` with ``w >= 0`` of a rotation matrix, shape (3, 3)."""
    return np.array(quaternion_of(*rotation.T.tolist()))


@plain
def retracted(base, theta):
    """Unit quaternion ``exp(theta) * base`` as a tuple ``xyzw``; ``theta`` (3,) [rad]."""
    square = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
    if square < _SERIES_ANGLE * _SERIES_ANGLE:
        scale = 0.5 - square * (1.0 / 48.0 - square * (1.0 / 3840.0))
        dw = 1.0 - square * (0.125 - square * (1.0 / 384.0 - square * (1.0 / 46080.0)))
    else:
        angle = math.sqrt(square)
        scale, dw = math.sin(0.5 * angle) / angle, math.cos(0.5 * angle)
    dx, dy, dz = scale * theta[0], scale * theta[1], scale * theta[2]
    x, y, z, w = base[0], base[1], base[2], base[3]
    ox = dw * x + dx * w + dy * z - dz * y
    oy = dw * y + dy * w + dz * x - dx * z
    oz = dw * z + dz * w + dx * y - dy * x
    ow = dw * w - dx * x - dy * y - dz * z
    norm = 1.0 / math.sqrt(ox * ox + oy * oy + oz * oz + ow * ow)
    return ox * norm, oy * norm, oz * norm, ow * norm


@plain
def retract_into(base, theta, out):
    """Write :func:`retracted` into ``out[0:4]``, which may be ``base``."""
    out[0], out[1], out[2], out[3] = retracted(base, theta)


def retract(base: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Unit quaternion ``exp(theta) * base``; ``theta`` (3,) is a rotation vector in world axes."""
    return np.array(retracted(base.tolist(), theta.tolist()))


@plain
def rotation_between(base, quaternion):
    """:func:`difference` as a tuple."""
    x, y, z, w = -base[0], -base[1], -base[2], base[3]
    a, b, c, d = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    rx = d * x + a * w + b * z - c * y
    ry = d * y + b * w + c * x - a * z
    rz = d * z + c * w + a * y - b * x
    rw = d * w - a * x - b * y - c * z
    if rw < 0.0:
        rx, ry, rz, rw = -rx, -ry, -rz, -rw
    sine = math.sqrt(rx * rx + ry * ry + rz * rz)
    # atan2 keeps all digits at small and at large angles; 2 is the limit of angle / sine at zero
    scale = 2.0 if sine == 0.0 else 2.0 * math.atan2(sine, rw) / sine
    return scale * rx, scale * ry, scale * rz


def difference(base: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Rotation vector ``theta`` (3,), world axes [rad], with ``retract(base, theta) = quaternion``.

    The shorter way round is taken: ``|theta| <= pi``.
    """
    return np.array(rotation_between(base.tolist(), quaternion.tolist()))


@inlined
def _gamma(square):
    r"""The factor :math:`\gamma = g(|\theta|^2)` of :func:`write_chart_rate`, and ``g'``."""
    if square < 0.25:  # the closed form of g' loses digits with the fourth power of the angle
        gamma = slope = 0.0
        for k in range(len(_SERIES) - 1, -1, -1):
            slope = slope * square + gamma
            gamma = gamma * square + _SERIES[k]
        return gamma, slope
    angle = math.sqrt(square)
    cotangent = 1.0 / math.tan(0.5 * angle)
    gamma = (1.0 - 0.5 * angle * cotangent) / square
    # by the angle, over twice the angle
    by_angle = 0.25 * angle * (1.0 + cotangent * cotangent) - 0.5 * cotangent
    return gamma, (0.5 * by_angle / angle - gamma) / square


@kernel
def write_chart_rate(theta: np.ndarray, omega: np.ndarray, out: np.ndarray) -> None:
    r"""Write the rate of ``theta`` for a body that turns with ``omega`` into ``out[0:3]``.

    With ``R = exp(theta) R_0`` and ``R' = S(omega) R`` (world axes),

    .. math:: \dot\theta = \omega - \tfrac12\,\theta\times\omega
              + \gamma\,\theta\times(\theta\times\omega),\qquad
              \gamma = \frac{1}{|\theta|^2} - \frac{\cot(|\theta|/2)}{2|\theta|}

    (the inverse of the left differential of the exponential; E. Hairer, C. Lubich, G. Wanner,
    Geometric Numerical Integration, III.4).  Regular for ``|theta| < 2 pi``.
    """
    gamma, _ = _gamma(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2)
    turn, rate = vec(theta, 0), vec(omega, 0)
    c = cross(turn, rate)
    put(out, 0, add_scaled(add_scaled(rate, -0.5, c), gamma, cross(turn, c)))


@kernel
def write_chart_rate_slopes(theta: np.ndarray, omega: np.ndarray, out: np.ndarray) -> None:
    r"""Write the derivatives of :func:`write_chart_rate` by ``theta`` into ``out`` (3, 3).

    With :math:`\gamma = g(|\theta|^2)`, along a change :math:`\delta` of :math:`\theta`,

    .. math:: -\tfrac12\,\delta\times\omega + \gamma\,\big(\delta\times(\theta\times\omega)
              + \theta\times(\delta\times\omega)\big)
              + 2 g'\,(\theta\cdot\delta)\,\theta\times(\theta\times\omega) .
    """
    gamma, slope = _gamma(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2)
    turn, rate = vec(theta, 0), vec(omega, 0)
    c = cross(turn, rate)
    twice = cross(turn, c)
    for axis in range(3):
        e = AXES[axis]
        by = add_scaled(cross(e, c), 1.0, cross(turn, cross(e, rate)))
        change = add_scaled(scale(gamma, by), 2.0 * slope * theta[axis], twice)
        put(out[axis], 0, add_scaled(change, -0.5, cross(e, rate)))
