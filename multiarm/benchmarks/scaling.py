"""The cost of one acceleration evaluation against the number of arms, beside Pinocchio's own.

Measured side by side in one process on one scene (:func:`multiarm.problems.ring_of_arms`), in short
interleaved bursts of which the fastest counts: other programs on the machine can only slow a burst
down.  *multiarm* is the evaluation as the time loop performs it: Pinocchio's two calls, contact
kinematics, control, node algorithm, slope of the state.  *arm terms* are Pinocchio's two calls
alone, *constraintDynamics* and *lcaba* Pinocchio's own closed-loop algorithms, *dense KKT* the
reference of :mod:`multiarm.node.dense` in place of the node algorithm.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.benchmarks.peers import PinocchioForest
from multiarm.compilation import compile_system
from multiarm.dynamics import evaluate, project_velocity
from multiarm.equations import OK
from multiarm.errors import SolverError
from multiarm.integrators.stepper import evaluate_slope, make_step, store
from multiarm.integrators.tableaus import RK4
from multiarm.lowlevel import call_back, kernel
from multiarm.plant import CALL_TERMS
from multiarm.problems import ring_of_arms
from multiarm.system import System

BURSTS_PER_ROUND = 40
BURST = 1e-3  # [s], about
METHODS = ("multiarm", "terms", "constraintDynamics", "lcaba", "dense")
_TITLES = {
    "multiarm": "multiarm",
    "terms": "  arm terms in it",
    "constraintDynamics": "constraintDynamics",
    "lcaba": "lcaba",
    "dense": "dense KKT",
}


def run_scaling(
    arms: Sequence[int] = (2, 4, 8, 16, 32),
    kinds: Sequence[str] = ("weld", "ball"),
    rounds: int = 7,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Measure all methods on rings of UR5 arms.

    Returns
    -------
    dict
        ``rows``: a list with, for every kind and number of arms, ``kind``, ``arms``,
        ``microseconds`` (method -> fastest burst, an evaluation), ``relative_error`` (method ->
        largest relative deviation from the dense solution) and ``ratio_to_best_peer``.
        ``exponents``: kind -> method -> slope of log cost over log number of arms.
        ``growth``: kind -> cost at the most arms over cost at the fewest.
    """
    import scipy.linalg  # noqa: F401 - loaded before the limit, which binds loaded libraries only
    from threadpoolctl import threadpool_limits

    rows = []
    with threadpool_limits(limits=1):  # one thread each: the others are single-threaded too
        for kind in kinds:
            for count in arms:
                if progress is not None:
                    progress(f"{kind}, {count} arms ...")
                rows.append(_measure(kind, count, rounds))
    exponents: dict[str, dict[str, float | None]] = {}
    growth: dict[str, float | None] = {}
    for kind in kinds:
        own = [row for row in rows if row["kind"] == kind]
        exponents[kind] = {method: _slope(own, method) for method in METHODS}
        first, last = own[0]["microseconds"]["multiarm"], own[-1]["microseconds"]["multiarm"]
        growth[kind] = last / first if len(own) > 1 else None
    return {"rows": rows, "exponents": exponents, "growth": growth}


def print_scaling(result: dict[str, Any], console) -> None:
    """Print the table of :func:`run_scaling` to a rich console."""
    from rich import box
    from rich.table import Table

    for kind in result["exponents"]:
        rows = [row for row in result["rows"] if row["kind"] == kind]
        title = f"one acceleration evaluation, {kind} joints, in microseconds"
        table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)
        table.add_column("", no_wrap=True)
        for row in rows:
            table.add_column(f"n={row['arms']}", justify="right", no_wrap=True)
        table.add_column("slope", justify="right")
        table.add_column("error", justify="right")
        for method in METHODS:
            costs = [f"{row['microseconds'][method]:.1f}" for row in rows]
            slope = result["exponents"][kind][method]
            errors = [row["relative_error"].get(method) for row in rows]
            worst = "" if None in errors else f"{max(errors):.0e}"
            shown = "" if slope is None else f"{slope:.2f}"
            style = "bold" if method == "multiarm" else None
            table.add_row(_TITLES[method], *costs, shown, worst, style=style)
        ratios = [f"{row['ratio_to_best_peer']:.2f}" for row in rows]
        table.add_row("best peer / ours", *ratios, "", "", style="green")
        console.print(table)
        if result["growth"][kind] is not None:
            console.print(
                f"multiarm: cost at n = {rows[-1]['arms']} is {result['growth'][kind]:.1f} times "
                f"that at n = {rows[0]['arms']}"
            )


def plot_scaling(result: dict[str, Any], path: Path | str) -> None:
    """Draw cost over number of arms, log-log, one panel a kind of joint."""
    from matplotlib.figure import Figure

    kinds = list(result["exponents"])
    figure = Figure(figsize=(5.2 * len(kinds), 4.2), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(kinds), sharey=True))
    colors = dict(
        zip(METHODS, ("#1f5fa8", "#8fb4dc", "#d0672b", "#6b9a3c", "#8a8a8a"), strict=True)
    )
    for axis, kind in zip(axes, kinds, strict=True):
        rows = [row for row in result["rows"] if row["kind"] == kind]
        n = [row["arms"] for row in rows]
        for method in METHODS:
            cost = [row["microseconds"][method] for row in rows]
            width = 2.4 if method == "multiarm" else 1.4
            label = _TITLES[method].strip()
            axis.loglog(n, cost, "o-", color=colors[method], lw=width, ms=4, label=label)
        axis.set_title(f"{kind} joints")
        axis.set_xlabel("number of arms")
        axis.set_xticks(n, [str(k) for k in n])
        axis.minorticks_off()
        axis.grid(True, which="major", alpha=0.3)
    axes[0].set_ylabel("one evaluation [microseconds]")
    axes[0].legend(frameon=False, fontsize=9)
    figure.savefig(path)


def _measure(kind: str, count: int, rounds: int) -> dict[str, Any]:
    """All methods on one ring, at a random state with velocity on the constraints."""
    system = compile_system(ring_of_arms(count, kind))
    state = system.initial_state()
    state.velocity[:] = 0.3 * np.random.default_rng(count).normal(size=state.velocity.size)
    state = project_velocity(system, state)
    own = evaluate(system, 0.0, state)
    torque = np.concatenate(list(own.joint_torques.values()))
    dense_system = system.with_solver("dense")
    exact = np.concatenate(list(evaluate(dense_system, 0.0, state).joint_accelerations.values()))
    forest = PinocchioForest(system)
    peers = {
        "constraintDynamics": forest.constraint_dynamics_call(state, torque),
        "lcaba": forest.lcaba_call(state, torque),
    }
    scale = np.max(np.abs(exact))
    found = {name: call()[:-6] for name, call in peers.items()}
    found["multiarm"] = np.concatenate(list(own.joint_accelerations.values()))
    system.set_state(0.0, state)
    bursts = {
        "multiarm": _slope_burst(system),
        "terms": _terms_burst(system),
        **{name: _python_burst(call) for name, call in peers.items()},
        "dense": _slope_burst(dense_system),
    }
    cost = _fastest(bursts, rounds)
    best_peer = min(cost["constraintDynamics"], cost["lcaba"])
    return {
        "kind": kind,
        "arms": count,
        "microseconds": {name: 1e6 * cost[name] for name in METHODS},
        "relative_error": {
            name: float(np.max(np.abs(a - exact)) / scale) for name, a in found.items()
        },
        "ratio_to_best_peer": best_peer / cost["multiarm"],
    }


def _fastest(bursts: dict[str, Callable[[int], None]], rounds: int) -> dict[str, float]:
    """Seconds a call in the fastest burst of each, measured in turn."""
    calls, best = {}, {}
    for name, burst in bursts.items():
        burst(1)
        begin = time.perf_counter()
        burst(2)
        calls[name] = max(1, round(BURST / max((time.perf_counter() - begin) / 2, 1e-7)))
        best[name] = np.inf
    for turn in range(rounds * BURSTS_PER_ROUND):
        for name, burst in bursts.items():
            if name == "dense" and turn % BURSTS_PER_ROUND:
                continue
            begin = time.perf_counter()
            burst(calls[name])
            best[name] = min(best[name], (time.perf_counter() - begin) / calls[name])
    return best


@kernel
def _evaluate_often(book, z, base, slope, count):
    status = OK
    for i in range(count):
        status = evaluate_slope(book, 1e-4 * i, z, base, 0.0, 0.0, slope)
        if status != OK:
            return status
    return status


@kernel
def _terms_often(address, count):
    for _ in range(count):
        call_back(address)


def _slope_burst(system: System) -> Callable[[int], None]:
    step, book = make_step(RK4, system.layout.joints), system.book()
    store(system.buffers, step.base, step.z)

    def burst(count: int) -> None:
        if _evaluate_often(book, step.z, step.base, step.slope, count) != OK:
            system.reraise()
            raise SolverError("an evaluation of the benchmark failed")

    return burst


def _terms_burst(system: System) -> Callable[[int], None]:
    address = int(system.plant.calls[CALL_TERMS])
    return lambda count: _terms_often(address, count)


def _python_burst(call: Callable[[], Any]) -> Callable[[int], None]:
    def burst(count: int) -> None:
        for _ in range(count):
            call()

    return burst


def _slope(rows: list[dict[str, Any]], method: str) -> float | None:
    """Least-squares slope of log cost over log number of arms."""
    if len(rows) < 2:
        return None
    n = np.log([row["arms"] for row in rows])
    cost = np.log([row["microseconds"][method] for row in rows])
    return float(np.polyfit(n, cost, 1)[0])
