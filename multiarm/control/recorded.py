r"""Recorded control: torques, or references of springs and dampers, from a table over time.

Between two rows :math:`t_s \le t < t_{s+1}` every column is a polynomial of degree ``D``,

.. math:: y(t) = \sum_{k=0}^{D} a_{sk}\,(t - t_s)^{D - k},

a constant (``hold``), a line (``linear``) or a piece of the cubic spline
(``cubic``: continuous up to the second derivative, not-a-knot at its ends).  The row is found by
bisection.  Outside the table, values are those of the first and the last row, at rest, or zero.

* *torque*: :math:`\tau = y(t)`.
* *position*: :math:`\tau = K\,(y(t) - q) + D\,(\dot y(t) - \dot q)`.
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.jit.kernels import cfunc, kernel
from multiarm.jit.structs import struct_at

DEGREES = {"hold": 0, "linear": 1, "cubic": 3}

# Offsets of the numbers of a table; the times of its rows follow, then the coefficients
# [interval, joint, power].
INTERVALS, DEGREE, ZERO_OUTSIDE, TIMES = 0, 1, 2, 3


def pack_table(times: np.ndarray, values: np.ndarray, interpolation: str, zero: bool) -> np.ndarray:
    """Parameters of a table: ``times`` (r,), ``values`` (r, n); ``zero``: outside it."""
    coefficients = polynomials(times, values, interpolation)
    head = [len(times) - 1, coefficients.shape[2] - 1, float(zero)]
    return np.concatenate([head, times, coefficients.ravel(), values[-1]])


def polynomials(times: np.ndarray, values: np.ndarray, interpolation: str) -> np.ndarray:
    """Coefficients between the rows, shape (r - 1, n, degree + 1), highest power first."""
    if interpolation == "hold":
        return values[:-1, :, None]
    if interpolation == "linear":
        slope = np.diff(values, axis=0) / np.diff(times)[:, None]
        return np.stack([slope, values[:-1]], axis=2)
    from scipy.interpolate import CubicSpline

    return np.ascontiguousarray(CubicSpline(times, values).c.transpose(1, 2, 0))


def rough_times(
    times: np.ndarray, values: np.ndarray, interpolation: str, zero: bool
) -> np.ndarray:
    """Times at which steps end: of jumps (hold), of kinks (linear), and the ends of the table."""
    inner = np.zeros(0)
    if interpolation == "hold":
        inner = times[1:][np.any(np.diff(values, axis=0) != 0.0, axis=1)]
    elif interpolation == "linear":
        slope = np.diff(values, axis=0) / np.diff(times)[:, None]
        # the slopes of rows on one line differ by roundings
        scale = np.abs(slope[1:]) + np.abs(slope[:-1])
        inner = times[1:-1][np.any(np.abs(np.diff(slope, axis=0)) > 1e-12 * scale, axis=1)]
    varies = bool(np.any(values != values[0])) or (zero and bool(np.any(values != 0.0)))
    return np.union1d(inner, times[[0, -1]]) if varies else inner


# --- kernels -------------------------------------------------------------------------------------


@cfunc
def recorded_torque(address, size, place, t):
    """Numbers: the table."""
    model, data, _ = open_system(struct_at(address, size))
    parameters, at, n = model.parameters, int(place), data.torque.size
    row = find_row(t, parameters, at)
    for j in range(n):
        value, _ = table_point(t, parameters, at, row, n, j)
        data.torque[j] += value
    return 0


@cfunc
def recorded_position(address, size, place, t):
    """Numbers: stiffness and damping of every joint, then the table."""
    model, data, _ = open_system(struct_at(address, size))
    parameters, at, n = model.parameters, int(place), data.torque.size
    table = at + 2 * n
    row = find_row(t, parameters, table)
    for j in range(n):
        reference, rate = table_point(t, parameters, table, row, n, j)
        data.torque[j] += parameters[at + j] * (reference - data.angles[j])
        data.torque[j] += parameters[at + n + j] * (rate - data.v[j])
    return 0


@kernel
def find_row(t, parameters, at):
    """The last row whose time is not after ``t``; -1 before the first one."""
    times = at + TIMES
    low, high = -1, int(parameters[at + INTERVALS])
    while low < high:
        middle = (low + high + 1) // 2
        if parameters[times + middle] <= t:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def table_point(t, parameters, at, row, joints, joint):
    """Value of one joint and its rate at time ``t``, which is after ``row``, see `find_row`."""
    intervals, degree = int(parameters[at + INTERVALS]), int(parameters[at + DEGREE])
    times, width = at + TIMES, degree + 1
    table = times + intervals + 1
    if row < 0 or row == intervals:  # before the first row, from the last one on
        if parameters[at + ZERO_OUTSIDE] != 0.0:
            return 0.0, 0.0
        if row < 0:
            return parameters[table + joint * width + degree], 0.0
        return parameters[table + intervals * joints * width + joint], 0.0
    x = t - parameters[times + row]
    first = table + (row * joints + joint) * width
    value = rate = 0.0
    for k in range(width):
        rate = rate * x + value
        value = value * x + parameters[first + k]
    return value, rate
