"""What a step of each method costs, beside the evaluations in it.

    python benchmarks/step_cost.py [--arms 2] [--rounds N] [--json FILE]

Runs on the ring of welded UR5 arms (:func:`multiarm.problems.ring_of_arms`), and evaluations as the
time loop performs them, in turn; the fastest of each count.  What a step costs besides is the sums
over its stages, its error estimate, samples, checks and decisions.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import output
import pandas
from evaluations import moving_state
from matplotlib.figure import Figure
from timing import calls_a_burst, slope_burst

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.data import Data
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.plots.style import BLUE
from multiarm.problems import ring_of_arms
from multiarm.results.trajectory import Trajectory
from multiarm.studies.timing import clocked_run
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS
from multiarm.threads import one_thread

KIND = "weld"
TOLERANCE, STEP = 1e-8, 1e-3
"""Of the runs: tolerance of an adaptive step [m, rad; m/s, rad/s], fixed step [s]."""
DURATION, FIXED_STEPS = 1.0, 1000
"""Simulated time of an adaptive run [s], steps of the others."""
LEAST_RUNS, PATIENCE, BURSTS_A_RUN = 3, 0.05, 5
"""Runs of each method, at least; seconds spent on them in a round; evaluations in between."""


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "step_cost", (2,))
    arguments = parser.parse_args(words)
    with output.Clock() as clock:
        costs = step_costs(arguments.arms, arguments.rounds)
    output.save(arguments, clock, "step_costs", costs, figure)


def figure(costs: pandas.DataFrame) -> Figure:
    """The overhead of each method, a bar for every number of arms."""
    drawing, (axes,) = output.panels(1)
    costs.pivot(index="integrator", columns="arms", values="overhead").mul(100.0).plot.barh(
        ax=axes, color=BLUE, legend=costs["arms"].nunique() > 1
    )
    axes.set(xlabel="percent of its evaluations", ylabel="", title="What a step costs besides")
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


def step_costs(arms: Sequence[int], rounds: int) -> pandas.DataFrame:
    """A row, with the fields of :class:`StepCost`, for every number of arms and every method."""
    costs = []
    with one_thread():
        for count in arms:
            system = compile_system(ring_of_arms(count, KIND))
            for name in (*FIXED_STEP_INTEGRATORS, *ADAPTIVE_INTEGRATORS):
                print(f"{count} arms, {name}", flush=True)
                costs.append(step_cost(system, name, rounds))
    return pandas.DataFrame(costs)


def step_cost(system: System, integrator: str, rounds: int) -> StepCost:
    """The cheapest of some runs, and the cheapest evaluations measured between them."""
    data = Data(system.model)
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


if __name__ == "__main__":
    main()
