r"""One step of any method, in a chart of the configuration manifold.

Within a step the object's orientation is :math:`R = \exp(\theta) R_0` with ``R_0`` that at the
beginning of the step, so that the state is a plain vector

.. math::
    z = [\,x_o\ (3),\ \theta\ (3),\ q\ (n),\ v_o\ (6),\ \dot q\ (n),\ \text{inner}\ (e),\
        \text{work}\ (w)\,]

with :math:`\dot\theta` from :func:`multiarm.spatial.write_chart_rate`.  Runge-Kutta methods keep
their order and their dense output in it (H. Munthe-Kaas, BIT 38, 1998); after the step the rotation
goes into the full quaternion and the next chart begins at :math:`\theta = 0`.

*inner* are the states of effects that have their own.  The last entries are the work of each effect
and of control and effects together: quadratures carried along for the energy balance, not part of
the error norm.

Explicit methods are carried out here.  Other methods are entries of their own, compiled when they
are first used (:mod:`multiarm.integration.rosenbrock`, :mod:`multiarm.integration.variational`);
``Step.own`` says where.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import NOT_FINITE, OK, open_data, open_system
from multiarm.dynamics.equations import finite
from multiarm.integration.near_singular import evaluate_on_branch
from multiarm.integration.projection import project
from multiarm.integration.tableaus import EXPLICIT, SEMI_IMPLICIT, Tableau
from multiarm.jit.kernels import clear, copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import Float, Floats1, Floats2, Int, Ints1, struct_at, struct_of, view
from multiarm.spatial import retract_into, write_chart_rate

# Rows that dense output needs at the most (DOP853: 7 coefficients).
_DENSE_ROWS = 7

# Entries of Step.own.
OWN_STEP, OWN_STRUCT, OWN_SIZE, OWN_EVALUATIONS = range(4)


class Method(NamedTuple):
    """A tableau as the kernels see it; see :class:`multiarm.integration.tableaus.Tableau`."""

    order: Int
    error_order: Int
    stages: Int
    kind: Int
    stability: Float
    dense_kind: Int
    A: Floats2
    b: Floats1
    c: Floats1
    error: Floats2
    dense: Floats2


class Step(NamedTuple):
    """Arrays of one step for ``n`` joints, ``D = 12 + 2 n + e + w``.

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
    tolerance : (D - w,)
        Largest accepted error estimate of one step, of every entry but the works.
    gains : (2,)
        Feedback gains of the step at hand [1/s].
    own : int64 (4,)
        Of a method that is not explicit: its entry, address and size of its struct, and the
        evaluations that its last step took.  All 0 for explicit ones.
    """

    z: Floats1
    z_new: Floats1
    z_stage: Floats1
    z_next: Floats1
    base: Floats1
    base_next: Floats1
    base_old: Floats1
    k: Floats2
    slope: Floats1
    slope_next: Floats1
    dense: Floats2
    z_old: Floats1
    tolerance: Floats1
    gains: Floats1
    own: Ints1


def make_method(tableau: Tableau) -> Method:
    """The tableau in the kernels' form (all methods have the same types: nothing recompiles)."""
    return Method(
        order=tableau.order,
        error_order=tableau.error_order,
        stages=tableau.b.size,
        kind=tableau.kind,
        stability=float(tableau.stability),
        dense_kind=tableau.dense_kind,
        A=np.ascontiguousarray(tableau.A),
        b=np.ascontiguousarray(tableau.b),
        c=np.ascontiguousarray(tableau.c),
        error=np.ascontiguousarray(tableau.error),
        dense=np.ascontiguousarray(tableau.dense),
    )


def make_step(tableau: Tableau, joints: int, states: int = 0, works: int = 1) -> Step:
    """Allocate for a method, a number of joints, of effects' own states and of works."""
    size = 12 + 2 * joints + states + works
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
        tolerance=np.ones(size - works),
        gains=np.zeros(2),
        own=np.zeros(4, dtype=np.int64),
    )


_open_method, _open_arrays = view(Method), view(Step, len(Method._fields))


def step_struct(method: Method, step: Step) -> np.ndarray:
    """Struct of a method and its step; :func:`open_step` is its inverse."""
    return struct_of(method, step)


@inlined
def open_step(struct):
    """Views ``method, step`` of a step's struct."""
    return _open_method(struct), _open_arrays(struct)


@inlined
def load(z, base, data):
    """Write the state of a chart into the evaluation's data."""
    n = data.angles.size
    for k in range(3):
        data.position[k] = z[k]
    retract_into(base, z[3:6], data.position[3:7])
    for k in range(6):
        data.twist[k] = z[6 + n + k]
    for j in range(n):
        data.angles[j] = z[6 + j]
        data.v[j] = z[12 + n + j]
    for k in range(data.inner.size):
        data.inner[k] = z[12 + 2 * n + k]


@inlined
def store(data, base, z):
    """Begin a chart at the state in ``data``: ``theta = 0``; the works stay."""
    n = data.angles.size
    for k in range(3):
        z[k] = data.position[k]
        z[3 + k] = 0.0
    for k in range(4):
        base[k] = data.position[3 + k]
    for k in range(6):
        z[6 + n + k] = data.twist[k]
    for j in range(n):
        z[6 + j] = data.angles[j]
        z[12 + n + j] = data.v[j]
    for k in range(data.inner.size):
        z[12 + 2 * n + k] = data.inner[k]


@kernel
def begin_chart(struct, base, z):
    """Begin a chart at the state of the system with this struct, see :func:`store`."""
    store(open_data(struct), base, z)


@inlined
def write_slope(z, data, slope):
    """Rate of ``z`` from the accelerations in ``data``."""
    n = data.angles.size
    for k in range(3):
        slope[k] = data.twist[k]
    write_chart_rate(z[3:6], data.twist[3:6], slope[3:6])
    for k in range(6):
        slope[6 + n + k] = data.q_o[k]
    for j in range(n):
        slope[6 + j] = data.v[j]
        slope[12 + n + j] = data.qdd[j]
    at = 12 + 2 * n
    for k in range(data.inner_rate.size):
        slope[at + k] = data.inner_rate[k]
    at += data.inner_rate.size
    for k in range(data.power.size):
        slope[at + k] = data.power[k]


@kernel
def evaluate_slope(struct, t, z, base, alpha, beta, slope):
    """Rate of ``z`` at time ``t`` of the system with this struct; returns a status.

    Later times than ``data.time.latest`` count as that: a step that ends where something jumps does
    not see what comes after.
    With ``data.stage_gap`` not negative it is the rate at the projection of ``z``: the same on
    the constraints, and smooth where they lose rank, since ``z`` beside them would be driven away.
    """
    if not finite(z):
        return NOT_FINITE
    _, data, _ = open_system(struct)
    load(z, base, data)
    if data.status.stage_gap >= 0.0:
        status = project(struct, data.status.stage_gap)
        if status != OK:
            return status
    data.time.now = min(t, data.time.latest)
    status = evaluate_on_branch(struct, data.status.stage_gap, alpha, beta)
    if status == OK:
        write_slope(z, data, slope)
    return status


@inlined
def add_slopes(step, weights, count, h, out):
    """``out += h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    for j in range(count):
        if weights[j] != 0.0:
            factor = h * weights[j]
            for i in range(out.size):
                out[i] += factor * step.k[j, i]


@inlined
def combine(step, weights, count, h, out):
    """``out = z + h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    copy(step.z, out)
    add_slopes(step, weights, count, h, out)


@inlined
def weighted_slopes(step, weights, count, h, out):
    """``out = h sum_j weights[j] k[j]`` over the first ``count`` slopes."""
    clear(out)
    add_slopes(step, weights, count, h, out)


@kernel
def run_stages(struct, joints, method, step, t, h, alpha, beta):
    """Stages 1.. of a step whose first slope is known, then ``z_new``; returns a status."""
    if method.kind == SEMI_IMPLICIT:
        semi_implicit_euler(step, h, joints)
        return OK
    if method.kind != EXPLICIT:
        step.gains[0], step.gains[1] = alpha, beta
        return call_cfunc(
            step.own[OWN_STEP], struct_at(step.own[OWN_STRUCT], step.own[OWN_SIZE]), t, h
        )
    for i in range(1, method.stages):
        combine(step, method.A[i], i, h, step.z_stage)
        status = evaluate_slope(
            struct, t + method.c[i] * h, step.z_stage, step.base, alpha, beta, step.k[i]
        )
        if status != OK:
            return status
    combine(step, method.b, method.stages, h, step.z_new)
    return OK


@kernel
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


@kernel
def error_estimate(method, step, h, floor):
    """Largest estimated error of the step in units of the tolerances (NaN stays NaN).

    Tolerances below ``floor`` count as that.
    """
    first = second = 0.0
    for i in range(step.tolerance.size):
        scale = h / max(step.tolerance[i], floor)
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
