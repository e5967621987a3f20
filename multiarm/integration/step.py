r"""The arrays of one step, and evaluations inside it.

The state is the vector z of a chart of the configuration manifold
(:mod:`multiarm.dynamics.coordinates`).  Its last entries, the works, take no part in the error
norm.

A method of integration (:mod:`multiarm.integration.methods`) makes a step of a given length from
the arrays here: it reads ``step.z`` and the first slope ``step.k[0]``, and writes ``step.z_new``
and the other slopes.  Its work arrays follow in the same struct.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import guards_of_mode, open_data, open_reports
from multiarm.dynamics.coordinates import (
    load_chart,
    write_chart_slope,
    write_new_chart,
)
from multiarm.dynamics.equations import evaluate_state, finite
from multiarm.dynamics.guards import follow_stage
from multiarm.dynamics.layout import Layout, places_in_chart
from multiarm.dynamics.status import NOT_FINITE, OK
from multiarm.integration.near_singular import evaluate_on_branch
from multiarm.integration.projection import cost_of_projection, project
from multiarm.jit.kernels import INTS, NUMBER, NUMBERS, cfunc, copy, inlined, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import (
    Flag,
    Float,
    Floats1,
    Floats2,
    Int,
    Ints1,
    Numbers,
    count_entries,
    struct_at,
    view,
)
from multiarm.tableaus import Tableau


class Coefficients(NamedTuple):
    """What kernels know of a method; see :class:`multiarm.tableaus.Tableau`."""

    step: Int  # address of the kernel that makes a step
    closes_gaps: Flag
    order: Int
    error_order: Int
    stages: Int
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


class Stage(Numbers):
    """How the stages of a step are evaluated."""

    # gains of the feedback on the drift [1/s]
    alpha: Float
    beta: Float
    projects: Flag  # states are projected before they are evaluated
    gap: Float  # largest gap that this leaves [m]
    latest: Float  # later times are replaced by it [s]: a step that ends at a jump stays before it
    repeats: Flag  # the step begins where the one before it began, which was rejected
    evaluations: Int  # that were made and are not in the run's statistics yet

    def begin(self) -> None:
        """As a run begins: states are evaluated as they are, at their times."""
        self.projects, self.latest, self.evaluations = False, math.inf, 0


class StepEnd(Numbers):
    """What the end of a step has shown, until the step is accepted."""

    reports: Int  # guards that report an event in it
    limited: Flag  # it is as long as stability allows


class Step(NamedTuple):
    """Arrays of one step for ``D`` numbers of a chart's vector, ``w`` of them works."""

    system: Ints1  # struct of the system
    stage: Stage
    at_end: StepEnd
    # state at the beginning, at the end before projection, at a stage, after projection: (D,)
    z: Floats1
    z_new: Floats1
    z_stage: Floats1
    z_next: Floats1
    # base of the chart (7 F + n,): of this step, of the next one, of the last one
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

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        states = self.z, self.z_new, self.z_stage, self.z_next, self.z_old
        bases = self.base, self.base_next, self.base_old
        return (*states, *bases, self.k, self.slope, self.slope_next, self.dense)


@cache
def coefficients(tableau: Tableau, step: int) -> Coefficients:
    """A method in the kernels' form (all have the same types: nothing recompiles).

    ``step`` is the address of the kernel that makes a step.  Runs share the arrays, which nothing
    writes.
    """

    def matrix(rows: tuple) -> np.ndarray:
        return np.array(rows, dtype=float) if rows else np.zeros((0, 0))

    return Coefficients(
        step=step,
        closes_gaps=tableau.closes_gaps,
        order=tableau.order,
        error_order=tableau.error_order,
        stages=len(tableau.b),
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


def make_step(
    tableau: Tableau, layout: Layout, system: np.ndarray, states: int = 0, works: int = 1
) -> Step:
    """Allocate for a method and a system, its struct, its number of effects' states and works."""
    size = places_in_chart(layout.nv, layout.rate_count, states).works + works
    slopes = max(len(tableau.b) + 1, len(tableau.A))
    base, stage = np.zeros(layout.nq), Stage()
    layout.poses(base)[:, 6] = layout.base_poses(base)[:, 6] = 1.0  # upright
    stage.begin()
    return Step(
        system=system,
        stage=stage,
        at_end=StepEnd(),
        z=np.zeros(size),
        z_new=np.zeros(size),
        z_stage=np.zeros(size),
        z_next=np.zeros(size),
        base=base,
        base_next=base.copy(),
        base_old=base.copy(),
        k=np.zeros((slopes, size)),
        slope=np.zeros(size),
        slope_next=np.zeros(size),
        dense=np.zeros((7, size)),  # DOP853 needs the most
        z_old=np.zeros(size),
        tolerance=np.ones(size - works),
    )


_view_method, _view_step = view(Coefficients), view(Step, count_entries(Coefficients))
# Where a method's work arrays stand in the struct: after its coefficients and the step.
METHOD_WORK = count_entries(Coefficients) + count_entries(Step)


@inlined
def open_step(struct):
    """Views ``method, step`` of ``struct_of(coefficients, step)`` and of longer structs."""
    return _view_method(struct), _view_step(struct)


@kernel
def begin_chart(struct: INTS, base: NUMBERS, z: NUMBERS):
    """Begin a chart at the state of the system with this struct, see :func:`write_new_chart`."""
    write_new_chart(open_data(struct), base, z)


@kernel
def evaluate_slope(struct, stage, t, z, base, slope):
    """Rate of ``z`` at time ``t`` of the system with this struct; returns a status.

    With ``stage.projects``, the rate is that at the projection of ``z`` onto the
    constraints: the same on the constraints, and smooth where they lose rank, while the rate off
    them would drive ``z`` away.
    """
    if not finite(z):
        return NOT_FINITE
    data = open_data(struct)
    load_chart(z, base, data)
    stage.evaluations += 1
    if stage.projects:
        status = project(struct, stage.gap)
        stage.evaluations += cost_of_projection(data)
        if status != OK:
            return status
    data.time.now = min(t, stage.latest)
    if stage.projects:
        status = evaluate_on_branch(struct, stage.gap, True, stage.alpha, stage.beta)
        stage.evaluations += data.interpolation.numbers.evaluations
    else:
        status = evaluate_state(struct, stage.alpha, stage.beta)
    if status == OK:
        write_chart_slope(z, data, slope)
    return status


@inlined
def slope_at(step, t, z, slope):
    """Evaluate the rate of a state in the chart of the step; returns a status."""
    return evaluate_slope(step.system, step.stage, t, z, step.base, slope)


@inlined
def stage_slope(step, t, z, slope):
    """:func:`slope_at` at a stage, whose forces the guards watch; returns a status."""
    status = slope_at(step, t, z, slope)
    if status == OK:
        functions = open_data(step.system).functions
        if functions.watch != 0:
            call_cfunc(functions.watch, step.system, 0.0, 0.0)
    return status


@cfunc
def watch_stage(address, size, _a, _b):
    """Let the guards see the forces of a stage that has been evaluated."""
    struct = struct_at(address, size)
    data = open_data(struct)
    follow_stage(open_reports(struct), struct, data.rows.force)
    if data.functions.guards != 0:
        follow_stage(guards_of_mode(data), struct, data.rows.force)
    return OK


@kernel
def write_slope(arrays: INTS, t: NUMBER, z: NUMBERS, slope: NUMBERS):
    """:func:`slope_at` for the step with this struct, for Python; returns a status."""
    _, step = open_step(arrays)
    return slope_at(step, t, z, slope)


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
    # the squares of errors below 1e-162, of a mechanism that is locked, are zero
    if method.error.shape[0] == 1 or first * first == 0.0:
        return first
    return first * first / math.sqrt(first * first + 0.01 * second * second)
