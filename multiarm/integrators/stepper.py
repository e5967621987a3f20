r"""One step of any explicit method, in a chart of the configuration manifold.

Within a step the object's orientation is :math:`R = \exp(\theta) R_0` with ``R_0`` that at the
beginning of the step, so that the state is a plain vector

.. math:: z = [\,x_o\ (3),\ \theta\ (3),\ q\ (n),\ v_o\ (6),\ \dot q\ (n),\ \text{work}\ (1)\,]

with :math:`\dot\theta` from :func:`multiarm.spatial.write_chart_rate`.  Runge-Kutta methods keep
their order and their dense output in it (H. Munthe-Kaas, BIT 38, 1998); after the step the rotation
goes into the full quaternion and the next chart begins at :math:`\theta = 0`.

The last entry is the work of control and effects: a quadrature carried along for the energy
balance, not part of the error norm.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.crossing import evaluate_on_branch
from multiarm.equations import NOT_FINITE, OK, finite
from multiarm.integrators.tableaus import HERMITE, POLYNOMIAL, Tableau
from multiarm.lowlevel import (
    address_book,
    copy,
    floats1,
    floats2,
    inlined,
    inner,
    inner_inlined,
    kernel,
)
from multiarm.plant import open_book
from multiarm.spatial import retract_into, write_chart_rate
from multiarm.stabilization import project

# Rows that dense output needs at the most (DOP853: 7 coefficients).
_DENSE_ROWS = 7


class Method(NamedTuple):
    """A tableau as the kernels see it; see :class:`multiarm.integrators.tableaus.Tableau`."""

    order: int
    error_order: int
    stages: int
    semi_implicit: bool
    A: np.ndarray
    b: np.ndarray
    c: np.ndarray
    error: np.ndarray
    dense: np.ndarray
    dense_kind: int


class Step(NamedTuple):
    """Arrays of one step for ``n`` joints, ``D = 13 + 2 n``.

    z, z_new, z_stage : (D,)
        State at the beginning, at the end (before projection), at a stage.
    z_next : (D,), base_next : (4,)
        State (after projection) and chart in which the next step begins.
    base, base_old : (4,)
        Quaternions of the chart now and of the step before.
    k : (slopes, D)
        Slopes of the stages, at the end, and of the dense output's further stages.
    slope, slope_next : (D,)
        Slope at the beginning of this step and of the next one, each in its own chart.
    dense : (7, D), z_old : (D,)
        Dense output of the step before.
    """

    z: np.ndarray
    z_new: np.ndarray
    z_stage: np.ndarray
    z_next: np.ndarray
    base: np.ndarray
    base_next: np.ndarray
    base_old: np.ndarray
    k: np.ndarray
    slope: np.ndarray
    slope_next: np.ndarray
    dense: np.ndarray
    z_old: np.ndarray


def make_method(tableau: Tableau) -> Method:
    """The tableau in the kernels' form (all methods have the same types: nothing recompiles)."""
    return Method(
        order=tableau.order,
        error_order=tableau.error_order,
        stages=tableau.b.size,
        semi_implicit=tableau.name == "semi_implicit_euler",
        A=np.ascontiguousarray(tableau.A),
        b=np.ascontiguousarray(tableau.b),
        c=np.ascontiguousarray(tableau.c),
        error=np.ascontiguousarray(tableau.error),
        dense=np.ascontiguousarray(tableau.dense),
        dense_kind=tableau.dense_kind,
    )


def make_step(tableau: Tableau, joints: int) -> Step:
    """Allocate for a method and a number of joints."""
    size = 13 + 2 * joints
    slopes = max(tableau.b.size + 1, tableau.A.shape[0])
    return Step(
        z=np.zeros(size),
        z_new=np.zeros(size),
        z_stage=np.zeros(size),
        z_next=np.zeros(size),
        base=np.array([0.0, 0.0, 0.0, 1.0]),
        base_next=np.array([0.0, 0.0, 0.0, 1.0]),
        base_old=np.array([0.0, 0.0, 0.0, 1.0]),
        k=np.zeros((slopes, size)),
        slope=np.zeros(size),
        slope_next=np.zeros(size),
        dense=np.zeros((_DENSE_ROWS, size)),
        z_old=np.zeros(size),
    )


def step_book(method: Method, step: Step) -> np.ndarray:
    """Address book of a method and its step; :func:`open_step` is its inverse."""
    return address_book([*method[4:9], *step])


@inner_inlined
def open_step(book, method):
    """Views of the arrays in a step's book; ``method`` supplies the scalars."""
    opened = Method(
        order=method.order,
        error_order=method.error_order,
        stages=method.stages,
        semi_implicit=method.semi_implicit,
        A=floats2(book, 0),
        b=floats1(book, 1),
        c=floats1(book, 2),
        error=floats2(book, 3),
        dense=floats2(book, 4),
        dense_kind=method.dense_kind,
    )
    step = Step(
        z=floats1(book, 5),
        z_new=floats1(book, 6),
        z_stage=floats1(book, 7),
        z_next=floats1(book, 8),
        base=floats1(book, 9),
        base_next=floats1(book, 10),
        base_old=floats1(book, 11),
        k=floats2(book, 12),
        slope=floats1(book, 13),
        slope_next=floats1(book, 14),
        dense=floats2(book, 15),
        z_old=floats1(book, 16),
    )
    return opened, step


@inner_inlined
def load(z, base, buffers):
    """Write the state of a chart into the evaluation's buffers."""
    n = buffers.angles.size
    for k in range(3):
        buffers.position[k] = z[k]
    retract_into(base, z[3:6], buffers.position[3:7])
    for k in range(6):
        buffers.twist[k] = z[6 + n + k]
    for j in range(n):
        buffers.angles[j] = z[6 + j]
        buffers.v[j] = z[12 + n + j]


@inlined
def store(buffers, base, z):
    """Begin a chart at the state in the buffers: ``theta = 0``; the work entry stays."""
    n = buffers.angles.size
    for k in range(3):
        z[k] = buffers.position[k]
        z[3 + k] = 0.0
    for k in range(4):
        base[k] = buffers.position[3 + k]
    for k in range(6):
        z[6 + n + k] = buffers.twist[k]
    for j in range(n):
        z[6 + j] = buffers.angles[j]
        z[12 + n + j] = buffers.v[j]


@inner_inlined
def write_slope(z, buffers, slope):
    """Rate of ``z`` from the accelerations in the buffers."""
    n = buffers.angles.size
    for k in range(3):
        slope[k] = buffers.twist[k]
    write_chart_rate(z[3:6], buffers.twist[3:6], slope[3:6])
    for k in range(6):
        slope[6 + n + k] = buffers.q_o[k]
    for j in range(n):
        slope[6 + j] = buffers.v[j]
        slope[12 + n + j] = buffers.qdd[j]
    slope[12 + 2 * n] = buffers.power[0]


@kernel
def evaluate_slope(book, t, z, base, alpha, beta, slope):
    """Rate of ``z`` at time ``t`` of the system with this address book; returns a status.

    With ``buffers.stage_gap`` not negative it is the rate at the projection of ``z``: the same on
    the constraints, and smooth where they lose rank, since ``z`` beside them would be driven away.
    """
    if not finite(z):
        return NOT_FINITE
    _, buffers, _ = open_book(book)
    load(z, base, buffers)
    if buffers.stage_gap[0] >= 0.0:
        status = project(book, buffers.stage_gap[0])
        if status != OK:
            return status
    buffers.time[0] = t
    status = evaluate_on_branch(book, buffers.stage_gap[0], alpha, beta)
    if status == OK:
        write_slope(z, buffers, slope)
    return status


@inner_inlined
def add_slopes(step, weights, count, h, out):
    """``out += h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    for j in range(count):
        if weights[j] != 0.0:
            factor = h * weights[j]
            for i in range(out.size):
                out[i] += factor * step.k[j, i]


@inner_inlined
def combine(step, weights, count, h, out):
    """``out = z + h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    copy(step.z, out)
    add_slopes(step, weights, count, h, out)


@inner_inlined
def weighted_slopes(step, weights, count, h, out):
    """``out = h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    out[:] = 0.0
    add_slopes(step, weights, count, h, out)


@inner
def run_stages(book, joints, method, step, t, h, alpha, beta):
    """Stages 1.. of a step whose first slope is known, then ``z_new``; returns a status."""
    if method.semi_implicit:
        semi_implicit_euler(step, h, joints)
        return OK
    for i in range(1, method.stages):
        combine(step, method.A[i], i, h, step.z_stage)
        status = evaluate_slope(
            book, t + method.c[i] * h, step.z_stage, step.base, alpha, beta, step.k[i]
        )
        if status != OK:
            return status
    combine(step, method.b, method.stages, h, step.z_new)
    return OK


@inner
def semi_implicit_euler(step, h, n):
    """New velocities from the old accelerations, then positions with the new velocities."""
    z, new, k = step.z, step.z_new, step.k[0]
    for i in range(6 + n, z.size):
        new[i] = z[i] + h * k[i]
    for i in range(3):
        new[i] = z[i] + h * new[6 + n + i]
        new[3 + i] = h * new[9 + n + i]
    for j in range(n):
        new[6 + j] = z[6 + j] + h * new[12 + n + j]


@inner
def error_estimate(method, step, h, position_tolerance, velocity_tolerance, joints):
    """Largest estimated error of the step in units of the tolerances (NaN stays NaN)."""
    first = second = 0.0
    for i in range(12 + 2 * joints):
        scale = h / (position_tolerance if i < 6 + joints else velocity_tolerance)
        a = b = 0.0
        for j in range(method.stages + 1):
            a += method.error[0, j] * step.k[j, i]
            if method.error.shape[0] > 1:
                b += method.error[1, j] * step.k[j, i]
        a, b = abs(scale * a), abs(scale * b)
        if a != a or b != b:
            return math.nan
        first, second = max(first, a), max(second, b)
    if method.error.shape[0] == 1 or first == 0.0:
        return first
    return first * first / math.sqrt(first * first + 0.01 * second * second)


@inner
def prepare_dense(book, method, step, t, h, alpha, beta):
    """Coefficients of the dense output of the step just made; its end slope is ``k[stages]``."""
    z, new, k, dense = step.z, step.z_new, step.k, step.dense
    copy(z, step.z_old)
    copy(step.base, step.base_old)
    end = method.stages
    if method.dense_kind == POLYNOMIAL:
        for r in range(method.dense.shape[0]):
            weighted_slopes(step, method.dense[r], end + 1, h, dense[r])
        return OK
    for i in range(z.size):
        delta = new[i] - z[i]
        dense[0, i] = delta
        dense[1, i] = h * k[0, i] - delta
        dense[2, i] = 2.0 * delta - h * (k[end, i] + k[0, i])
    if method.dense_kind == HERMITE:
        return OK
    for s in range(end + 1, method.A.shape[0]):
        combine(step, method.A[s], s, h, step.z_stage)
        status = evaluate_slope(
            book, t + method.c[s] * h, step.z_stage, step.base, alpha, beta, k[s]
        )
        if status != OK:
            return status
    for r in range(method.dense.shape[0]):
        weighted_slopes(step, method.dense[r], k.shape[0], h, dense[3 + r])
    return OK


@kernel
def interpolate(method, step, theta, out):
    """State at the fraction ``theta`` of the step before, in its chart (``base_old``)."""
    dense = step.dense
    out[:] = 0.0
    if method.dense_kind == POLYNOMIAL:
        for r in range(method.dense.shape[0] - 1, -1, -1):
            for i in range(out.size):
                out[i] = theta * (out[i] + dense[r, i])
    else:
        rows = 3 if method.dense_kind == HERMITE else 3 + method.dense.shape[0]
        for count in range(rows):
            factor = theta if count % 2 == 0 else 1.0 - theta
            for i in range(out.size):
                out[i] = factor * (out[i] + dense[rows - 1 - count, i])
    for i in range(out.size):
        out[i] += step.z_old[i]
