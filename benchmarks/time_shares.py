"""Where the time goes: the parts of one evaluation and of one step, and the overhead of a step.

    python benchmarks/time_shares.py [--arms 2,8,32] [--rounds N] [--json FILE]

Every part is a compiled loop over the function that the time loop calls, timed in interleaved
bursts on the ring of welded UR5 arms (:func:`multiarm.problems.ring_of_arms`); a step is that of a
real run.  The remainder of the measured whole is shown, not distributed: it is calls, checks and
decisions in between, and the error of measurement.

*Arm terms* are Pinocchio's two calls, *contacts* the contact kinematics with the object's terms,
*forces* control and effects, *node* elimination and solution, *state* the transfer of the state
into the evaluation and of the slope out of it.  Of a step furthermore: *stabilisation*, the
projection of a state that violates its joints; *recording*, writing samples; *arithmetic*, the sums
over stages and the error estimate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import output
import pandas
from evaluations import moving_state
from matplotlib.figure import Figure
from timing import (
    Burst,
    call_burst,
    calls_a_burst,
    fastest,
    loop_burst,
    measure,
    one_thread,
    slope_burst,
    terms_burst,
)

from multiarm.assembly.compilation import compile_system
from multiarm.assembly.loop_closure import projection_tolerance
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import load_chart, write_chart_slope
from multiarm.dynamics.equations import finite
from multiarm.dynamics.evaluation import evaluate
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import Data
from multiarm.dynamics.status import OK
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.integration.projection import project
from multiarm.integration.samples import write_sample
from multiarm.integration.step import (
    begin_chart,
    coefficients,
    combine,
    error_estimate,
    make_step,
    open_step,
)
from multiarm.jit.kernels import kernel
from multiarm.jit.structs import struct_of
from multiarm.plots.style import BLUE, GREEN, ORANGE, PINK
from multiarm.problems import ring_of_arms
from multiarm.results.channels import width_of
from multiarm.results.trajectory import Trajectory
from multiarm.studies.timing import clocked_run
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS, METHODS, RK4

ARMS = (2, 8, 32)
KIND = "weld"
INTEGRATOR = "dop853"
"""Whose steps are taken apart."""
TOLERANCE, STEP = 1e-8, 1e-3
"""Of the runs: tolerance of an adaptive step [m, rad; m/s, rad/s], fixed step [s]."""
DURATION, FIXED_STEPS = 1.0, 1000
"""Simulated time of an adaptive run [s], steps of the others."""
LEAST_RUNS, PATIENCE, BURSTS_A_RUN = 3, 0.05, 5
"""Runs of each integrator, at least; seconds spent on them in a round; evaluations in between."""
BURSTS_PER_ROUND = 15
TARGET = 0.25
"""The overhead of a step over its evaluations should be below this."""
COLOURS = {
    "arm terms": BLUE, "contacts": "#6aa5ea", "forces": "#a9c9f2", "node": GREEN,
    "state": "#8fd0af", "between": "#cfd6dd", "stabilisation": ORANGE, "recording": "#ecb679",
    "arithmetic": PINK, "rest": "#8a94a0",
}  # fmt: skip
"""Of the parts, in the figure."""


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "time_shares")
    parser.add_argument("--arms", type=output.counts, default=ARMS, metavar="N,N,...",
                        help="numbers of arms (default 2,8,32)")  # fmt: skip
    arguments = parser.parse_args(words)
    with output.Clock() as clock:
        shares = time_shares(arguments.arms, arguments.rounds)
    output.save(arguments, clock, "shares", shares, table(shares), figure)
    print(f"cost of a step besides its evaluations, {arguments.arms[0]} arms "
          f"(should be below {TARGET:.0%}):")  # fmt: skip
    for cost in shares["overheads"]:
        print(f"  {cost['integrator']}: {cost['overhead']:+.0%}")


def table(shares: dict[str, Any]) -> pandas.DataFrame:
    """A row for each part of an evaluation and of a step, at each number of arms."""
    rows = []
    for row in shares["rows"]:
        for whole in ("evaluation", "step"):
            sum_of_parts = sum(row[whole].values())
            rows += [
                {"of": whole, "arms": row["arms"], "part": part, "microseconds": cost,
                 "percent": 100.0 * cost / sum_of_parts}
                for part, cost in row[whole].items()
            ]  # fmt: skip
    return pandas.DataFrame(rows)


def figure(rows: pandas.DataFrame) -> Figure:
    """Stacked bars in percent; a remainder that errors of measurement make negative is left out."""
    drawing, panels = output.panels(2)
    for whole, axes in zip(("evaluation", "step"), panels, strict=True):
        shares = rows[rows["of"] == whole].pivot(index="arms", columns="part", values="percent")
        shares = shares[[part for part in COLOURS if part in shares]].clip(lower=0.0)
        shares = shares.div(shares.sum(axis=1), axis=0).mul(100.0).iloc[::-1]
        shares.plot.barh(stacked=True, ax=axes, color=COLOURS, width=0.72, legend=False)
        axes.set(title=f"Where {'an' if whole == 'evaluation' else 'a'} {whole} goes",
                 xlabel="percent", ylabel="arms", xlim=(0, 100))  # fmt: skip
        axes.grid(False)
        axes.legend(fontsize=7.5, frameon=False, ncols=3, loc="upper center",
                    bbox_to_anchor=(0.5, -0.16))  # fmt: skip
    return drawing


class StepCost(NamedTuple):
    """Cost of one step of a real run.

    integrator : str
    arms, steps : int
    evaluations : float
        A step, rejected ones and samples included; a projection counts as two.
    projections, samples : float
        A step.
    microseconds, evaluation_microseconds : float
        A step, its share of recording included, and one evaluation by itself.
    overhead : float
        ``microseconds / (evaluations * evaluation_microseconds) - 1``.
    """

    integrator: str
    arms: int
    steps: int
    evaluations: float
    projections: float
    samples: float
    microseconds: float
    evaluation_microseconds: float
    overhead: float


def time_shares(arms: Sequence[int] = ARMS, rounds: int = 7) -> dict[str, Any]:
    """Take evaluations and steps apart.

    Returns
    -------
    dict
        ``rows``: a list with, for every number of arms, ``arms``; ``evaluation`` (part ->
        microseconds) and ``evaluation_microseconds``; ``step`` (part -> microseconds), and the
        fields of :class:`StepCost` under ``step_cost``.
        ``overheads``: the fields of :class:`StepCost` of every integrator, at the fewest arms.
        ``kind``, ``duration_s``, ``tolerance``, ``fixed_steps``, ``fixed_step_s``: of the runs.
    """
    rows, overheads = [], []
    with one_thread():
        for count in arms:
            print(f"where the time goes: {count} arms", flush=True)
            rows.append(_measure(count, rounds))
        system = compile_system(ring_of_arms(arms[0], KIND))
        for name in integrators():
            print(f"a step of {name}", flush=True)
            overheads.append(step_cost(system, name, rounds)._asdict())
    return {
        "rows": rows,
        "overheads": overheads,
        "kind": KIND,
        "duration_s": DURATION,
        "fixed_steps": FIXED_STEPS,
        "tolerance": TOLERANCE,
        "fixed_step_s": STEP,
    }


def integrators() -> tuple[str, ...]:
    """All integrators, fixed-step ones first."""
    return (*FIXED_STEP_INTEGRATORS, *ADAPTIVE_INTEGRATORS)


def step_cost(system: System, integrator: str, rounds: int) -> StepCost:
    """The cheapest of some runs, and the cheapest evaluations measured between them."""
    data = system.model.data()
    data.set_state(0.0, moving_state(system, seed=len(system.arm_names)))
    evaluations = slope_burst(data)
    calls, cost, best, runs, spent = calls_a_burst(evaluations), math.inf, math.inf, 0, 0.0
    while runs < LEAST_RUNS or spent < PATIENCE * rounds:
        run, took = _run(system, integrator)
        best, runs, spent = min(best, took), runs + 1, spent + took
        for _ in range(BURSTS_A_RUN):
            begin = time.thread_time()
            evaluations(calls)
            cost = min(cost, (time.thread_time() - begin) / calls)
    statistics, steps = run.statistics, run.statistics["steps"]
    wall, each = best / steps, statistics["evaluations"] / steps
    return StepCost(
        integrator=integrator,
        arms=len(system.arm_names),
        steps=steps,
        evaluations=each,
        projections=statistics["projections"] / steps,
        samples=len(run) / steps,
        microseconds=1e6 * wall,
        evaluation_microseconds=1e6 * cost,
        overhead=wall / (each * cost) - 1.0,
    )


def evaluation_parts(cost: dict[str, float], whole: float) -> dict[str, float]:
    """Microseconds of the parts of an evaluation from those of the measured loops."""
    parts = {
        "arm terms": cost["terms"],
        "contacts": cost["kinematics"] - cost["terms"],
        "forces": cost["forces"],
        "node": cost["solve"],
        "state": cost["state"],
    }
    return {**parts, "between": whole - sum(parts.values())}


def step_parts(
    evaluation: dict[str, float], cost: dict[str, float], step: StepCost
) -> dict[str, float]:
    """Microseconds of the parts of a step: its evaluations, and everything else."""
    pure = step.evaluations - 2.0 * step.projections
    parts = {name: pure * value for name, value in evaluation.items()}
    parts["stabilisation"] = step.projections * cost["projection"]
    parts["recording"] = step.samples * cost["sample"]
    parts["arithmetic"] = cost["arithmetic"]
    return {**parts, "rest": step.microseconds - sum(parts.values())}


def _measure(count: int, rounds: int) -> dict[str, Any]:
    system = compile_system(ring_of_arms(count, KIND))
    data = system.model.data()
    data.set_state(0.0, moving_state(system, seed=count))
    turns = rounds * BURSTS_PER_ROUND
    cost = fastest(measure(part_bursts(system, data, INTEGRATOR), turns))
    evaluation = evaluation_parts(cost, cost["evaluation"])
    step = step_cost(system, INTEGRATOR, rounds)
    return {
        "arms": count,
        "evaluation": evaluation,
        "evaluation_microseconds": cost["evaluation"],
        "step": step_parts(evaluation, cost, step),
        "step_cost": step._asdict(),
    }


def _run(system: System, integrator: str) -> tuple[Trajectory, float]:
    """A run, and the time that the processor spent on it [s]."""
    if integrator in FIXED_STEP_INTEGRATORS:
        options = {"duration": FIXED_STEPS * STEP, "step": STEP}
    else:
        options = {"duration": DURATION, "tolerance": TOLERANCE}
    run, seconds = clocked_run(system, integrator=integrator, **options)
    if run.status != "completed":
        raise SolverError(f"the run of {integrator} for the benchmark {run.status}: {run.message}")
    return run, seconds


OPEN = 1e-9
"""How far the object is moved off its joints before it is projected [m]."""


def part_bursts(system: System, data: Data, integrator: str) -> dict[str, Burst]:
    """The loops over the parts, all at the state in the data."""
    state = data.get_state()
    slopes = make_step(RK4, data.model.layout, data.struct)
    begin_chart(data.struct, slopes.base, slopes.z)
    pushed = slopes.z.copy()
    pushed[:3] += OPEN
    parts = data.arrays.functions
    call_burst(data, parts.kinematics)(1)
    sample = np.zeros(width_of(system.channels))
    closed = projection_tolerance(data)
    evaluate(data, 0.0, state)  # all that samples are made of

    return {
        "evaluation": slope_burst(data),
        "terms": terms_burst(data),
        "kinematics": call_burst(data, parts.kinematics),
        "forces": call_burst(data, parts.forces),
        "solve": call_burst(data, parts.solve),
        "state": loop_burst(data, _pass_often, slopes.z, slopes.base, slopes.slope),
        "sample": loop_burst(data, _sample_often, sample),
        "arithmetic": _arithmetic_burst(data.model.layout, integrator),
        # last: it moves the state in the data, which the next turn's evaluations load again
        "projection": loop_burst(data, _project_often, pushed, slopes.base, closed),
    }


def _arithmetic_burst(layout: Layout, integrator: str) -> Burst:
    """Sums over the stages of made-up slopes."""
    tableau = METHODS[integrator]
    no_system = np.zeros(0, dtype=np.int64)
    method, step = coefficients(tableau, 0), make_step(tableau, layout, no_system)
    step.k[:] = np.random.default_rng(layout.joints).normal(size=step.k.shape)
    arrays = struct_of(method, step)

    def burst(count: int) -> None:
        _combine_often(arrays, count)
        assert np.all(np.isfinite(step.z_new)), "the sums of finite slopes are finite"

    return burst


@kernel
def _pass_often(struct, z, base, slope, count):
    """The state's way into the arrays, and the slope's out of them."""
    data = open_data(struct)
    good = True
    for _ in range(count):
        good = finite(z) and good
        load_chart(z, base, data)
        write_chart_slope(z, data, slope)
    return OK if good else 1


@kernel
def _sample_often(struct, row, count):
    data = open_data(struct)
    for i in range(count):
        write_sample(struct, 1e-3 * i, data.effects.power, row)
    return OK


@kernel
def _combine_often(arrays, count):
    """The sums of a step over its stages, and the estimate of its error."""
    method, step = open_step(arrays)
    error = 0.0
    for _ in range(count):
        for i in range(1, method.stages):
            combine(step, method.A[i], i, 1e-3, step.z_stage)
        combine(step, method.b, method.stages, 1e-3, step.z_new)
        error += error_estimate(method, step, 1e-3, 1e-8)
    return error


@kernel
def _project_often(struct, z, base, closed, count):
    """Projection of a state whose joints are open."""
    data = open_data(struct)
    status = OK
    for _ in range(count):
        load_chart(z, base, data)
        status = project(struct, closed)
    return status


if __name__ == "__main__":
    main()
