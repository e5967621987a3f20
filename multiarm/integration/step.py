r"""One step of any method, in a chart of the configuration manifold.

The state is the vector z of a chart of the configuration manifold
(:mod:`multiarm.dynamics.coordinates`).  Its last entries, the works, take no part in the error
norm.

Explicit methods are carried out here.  Implicit methods have compiled steps of their own
(:mod:`multiarm.integration.rosenbrock`, :mod:`multiarm.integration.variational`), which
``Step.implicit`` names; they are compiled when they are first used.

*Dense output* is the state between the ends of a step, in the step's chart.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import NOT_FINITE, OK, open_data, open_system
from multiarm.dynamics.coordinates import (
    chart_places,
    load_chart,
    store_chart,
    write_chart_slope,
)
from multiarm.dynamics.equations import finite
from multiarm.dynamics.layout import Layout
from multiarm.integration.near_singular import evaluate_on_branch
from multiarm.integration.projection import project
from multiarm.jit.kernels import INTS, NUMBER, NUMBERS, clear, copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import Float, Floats1, Floats2, Int, Numbers, view
from multiarm.tableaus import EXPLICIT, HERMITE, POLYNOMIAL, QUARTIC, SEMI_IMPLICIT, Tableau


class Method(NamedTuple):
    """A tableau as the kernels see it; see :class:`multiarm.tableaus.Tableau`."""

    order: Int
    error_order: Int
    stages: Int
    kind: Int
    stability: Float
    dense_kind: Int
    gamma: Float
    A: Floats2
    b: Floats1
    c: Floats1
    error: Floats2
    dense: Floats2
    C: Floats2
    d: Floats1


class ImplicitStep(Numbers):
    """The step of a method that is not explicit."""

    function: Int  # address of the compiled step; 0 for an explicit method
    # gains of the feedback during the step [1/s]
    alpha: Float
    beta: Float
    evaluations: Int  # that the last step took


class Step(NamedTuple):
    """Arrays of one step for ``D`` numbers of a chart's vector, ``w`` of them works."""

    # state at the beginning, at the end before projection, at a stage, after projection: (D,)
    z: Floats1
    z_new: Floats1
    z_stage: Floats1
    z_next: Floats1
    # base of the chart (4 F,): of this step, of the next one, of the last one
    base: Floats1
    base_next: Floats1
    base_old: Floats1
    k: Floats2  # (slopes, D), of the stages, of the end, of further stages of the dense output
    # slope at the beginning of this step and of the next one, each in its own chart: (D,)
    slope: Floats1
    slope_next: Floats1
    # dense output of the last step, (7, D), and the state at its beginning
    dense: Floats2
    z_old: Floats1
    tolerance: Floats1  # (D - w,), largest accepted error estimate of one step, without the works
    implicit: ImplicitStep


@cache
def make_method(tableau: Tableau) -> Method:
    """The tableau in the kernels' form (all methods have the same types: nothing recompiles).

    Runs share the arrays, which nothing writes.
    """

    def matrix(rows: tuple) -> np.ndarray:
        return np.array(rows, dtype=float) if rows else np.zeros((0, 0))

    return Method(
        order=tableau.order,
        error_order=tableau.error_order,
        stages=len(tableau.b),
        kind=tableau.kind,
        stability=tableau.stability,
        dense_kind=tableau.dense_kind,
        gamma=tableau.gamma,
        A=matrix(tableau.A),
        b=np.array(tableau.b),
        c=np.array(tableau.c),
        error=matrix(tableau.error),
        dense=matrix(tableau.dense),
        C=matrix(tableau.C),
        d=np.array(tableau.d),
    )


def make_step(tableau: Tableau, layout: Layout, states: int = 0, works: int = 1) -> Step:
    """Allocate for a method, a system, its number of effects' states and of works."""
    size = 2 * layout.nv + states + works
    slopes = max(len(tableau.b) + 1, len(tableau.A))
    upright = np.tile([0.0, 0.0, 0.0, 1.0], layout.frames)
    return Step(
        z=np.zeros(size),
        z_new=np.zeros(size),
        z_stage=np.zeros(size),
        z_next=np.zeros(size),
        base=upright,
        base_next=upright.copy(),
        base_old=upright.copy(),
        k=np.zeros((slopes, size)),
        slope=np.zeros(size),
        slope_next=np.zeros(size),
        dense=np.zeros((7, size)),  # DOP853 needs the most
        z_old=np.zeros(size),
        tolerance=np.ones(size - works),
        implicit=ImplicitStep(),
    )


_view_method, _view_step = view(Method), view(Step, len(Method._fields))
# Where the arrays of an implicit method stand in the struct: after the method and the step.
IMPLICIT_WORK = len(Method._fields) + len(Step._fields)


@inlined
def open_step(struct):
    """Views ``method, step`` of ``struct_of(method, step)`` and of longer structs."""
    return _view_method(struct), _view_step(struct)


@kernel
def begin_chart(struct: INTS, base: NUMBERS, z: NUMBERS):
    """Begin a chart at the state of the system with this struct, see :func:`store_chart`."""
    store_chart(open_data(struct), base, z)


@kernel
def evaluate_slope(
    struct: INTS, t: NUMBER, z: NUMBERS, base: NUMBERS, alpha: NUMBER, beta: NUMBER, slope: NUMBERS
):
    """Rate of ``z`` at time ``t`` of the system with this struct; returns a status.

    Times after ``data.time.latest`` are replaced by it: a step that ends at a discontinuity must
    not see what follows.  With ``data.status.stage_gap`` not negative, the rate is that at the
    projection of ``z`` onto the constraints: the same on the constraints, and smooth where they
    lose rank, while the rate off them would drive ``z`` away.
    """
    if not finite(z):
        return NOT_FINITE
    _, data, _ = open_system(struct)
    load_chart(z, base, data)
    if data.status.stage_gap >= 0.0:
        status = project(struct, data.status.stage_gap)
        if status != OK:
            return status
    data.time.now = min(t, data.time.latest)
    status = evaluate_on_branch(struct, data.status.stage_gap, alpha, beta)
    if status == OK:
        write_chart_slope(z, data, slope)
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
def run_stages(struct, arrays, t, h, alpha, beta):
    """Stages 1.. of a step whose first slope is known, then ``z_new``; returns a status."""
    method, step = open_step(arrays)
    if method.kind == SEMI_IMPLICIT:
        semi_implicit_euler(step, h, open_data(struct))
        return OK
    if method.kind != EXPLICIT:
        step.implicit.alpha = alpha
        step.implicit.beta = beta
        return call_cfunc(step.implicit.function, arrays, t, h)
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
def semi_implicit_euler(step, h, data):
    """New velocities from the old accelerations, then positions with the new velocities."""
    z, new, k, velocity = step.z, step.z_new, step.k[0], chart_places(data).velocity
    for i in range(velocity, z.size):
        new[i] = z[i] + h * k[i]
    for i in range(velocity):  # the chart's rotation vectors begin at zero
        new[i] = z[i] + h * new[velocity + i]


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


@kernel
def prepare_dense(struct, method, step, t, h, alpha, beta):
    """Coefficients of the dense output of the last step, whose end slope is ``k[stages]``."""
    z, new, k, dense = step.z, step.z_new, step.k, step.dense
    copy(z, step.z_old)
    copy(step.base, step.base_old)
    end = method.stages
    if method.dense_kind == POLYNOMIAL:
        for r in range(method.dense.shape[0]):
            weighted_slopes(step, method.dense[r], end + 1, h, dense[r])
        return OK
    if method.dense_kind == QUARTIC:
        for i in range(z.size):
            dense[0, i] = new[i] - z[i]
        for r in range(3):
            weighted_slopes(step, method.dense[r], end, h, dense[1 + r])
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
            struct, t + method.c[s] * h, step.z_stage, step.base, alpha, beta, k[s]
        )
        if status != OK:
            return status
    for r in range(method.dense.shape[0]):
        weighted_slopes(step, method.dense[r], k.shape[0], h, dense[3 + r])
    return OK


@kernel
def interpolate(method, step, theta, out):
    """State at the fraction ``theta`` of the last step, in its chart (``base_old``)."""
    dense = step.dense
    clear(out)
    if method.dense_kind == POLYNOMIAL:
        for r in range(method.dense.shape[0] - 1, -1, -1):
            for i in range(out.size):
                out[i] = theta * (out[i] + dense[r, i])
    elif method.dense_kind == QUARTIC:
        for i in range(out.size):
            bend = dense[1, i] + theta * (dense[2, i] + theta * dense[3, i])
            out[i] = theta * (dense[0, i] + (1.0 - theta) * bend)
    else:
        rows = 3 if method.dense_kind == HERMITE else 3 + method.dense.shape[0]
        for count in range(rows):
            factor = theta if count % 2 == 0 else 1.0 - theta
            for i in range(out.size):
                out[i] = factor * (out[i] + dense[rows - 1 - count, i])
    for i in range(out.size):
        out[i] += step.z_old[i]
