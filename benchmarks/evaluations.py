"""The cost of one evaluation over the number of arms, compared with Pinocchio's algorithms.

    python benchmarks/evaluations.py [--arms 2,4,8] [--kind weld] [--rounds N] [--json FILE]

Measured on one scene (:func:`multiarm.problems.ring_of_arms`) at one random state that moves with
the constraints.  *multiarm* is the evaluation as the time loop performs it: Pinocchio's two calls,
contact kinematics, control, node algorithm, slope of the state; *compiled arms* is the same with
copies of the arms in place of Pinocchio.  *arm terms* are Pinocchio's two calls alone,
*constraintDynamics* and *lcaba* Pinocchio's own closed-loop algorithms, called from Python (which
adds about a microsecond): with the object as a free body, and (*tree*) attached to the last arm,
which is one loop less.  *dense KKT* is the reference of :mod:`multiarm.dynamics.solver.dense` in
place of the node algorithm.  The fastest burst of each counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import output
import pandas
from matplotlib.figure import Figure
from peer_solvers import ConstraintDynamics, Lcaba, Tree, memory_needed
from timing import (
    fastest,
    fitted_slope,
    measure,
    python_burst,
    slope_burst,
    terms_burst,
    upper_half,
)

from multiarm.assembly.compilation import compile_system
from multiarm.assembly.start import project_start
from multiarm.dynamics.data import Data
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.events.evaluation import evaluate
from multiarm.plots.style import BLUE, GREEN, ORANGE, PINK
from multiarm.problems import ring_of_arms
from multiarm.threads import one_thread

BURSTS_PER_ROUND = 40
SHARE_OF_MEMORY = 0.5
"""Of the free memory, which Pinocchio's Data may take."""
OURS, COMPILED, TERMS, DENSE = "multiarm", "compiled", "terms", "dense"
PEERS = ("constraintDynamics", "tree", "lcaba")
METHODS = (OURS, COMPILED, TERMS, *PEERS, DENSE)
ARMS = (2, 4, 8, 16, 32, 64)
KINDS = ("weld", "ball", "revolute")
LINES = {
    OURS: ("multiarm, Pinocchio's arms", BLUE, "-"),
    COMPILED: ("multiarm, compiled arms", PINK, "-"),
    TERMS: ("Pinocchio's arm terms", BLUE, ":"),
    "lcaba": ("lcaba", GREEN, "-"),
    "constraintDynamics": ("constraintDynamics", ORANGE, "-"),
    "tree": ("the same, object on one arm", ORANGE, ":"),
    DENSE: ("dense KKT, NumPy", "#8a94a0", "-"),
}
"""Method -> its name, colour and dashes in the figure."""


def main(words: Sequence[str] | None = None) -> None:
    """Measure, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "evaluations", ARMS)
    parser.add_argument("--kind", action="append", choices=KINDS, dest="kinds",
                        help="joint of each arm; may be repeated (default weld, ball)")  # fmt: skip
    arguments = parser.parse_args(words)
    kinds = arguments.kinds or ["weld", "ball"]
    with output.Clock() as clock:
        costs = evaluation_costs(arguments.arms, kinds, arguments.rounds)
    output.save(arguments, clock, "evaluations", table(costs), figure, costs)


def table(costs: dict[str, Any]) -> pandas.DataFrame:
    """A row for every kind of joint, method and number of arms."""
    return pandas.DataFrame(
        {
            "kind": kind,
            "method": method,
            "arms": row["arms"],
            "microseconds": row["microseconds"][method],
            "relative_error": row["relative_error"].get(method),
        }
        for kind in costs["exponents"]
        for method in METHODS
        for row in costs["rows"]
        if row["kind"] == kind
    )


def figure(rows: pandas.DataFrame) -> Figure:
    """Cost over the number of arms, a panel for each kind of joint."""
    kinds = list(rows["kind"].unique())
    drawing, axes = output.panels(len(kinds))
    for kind, panel in zip(kinds, axes, strict=True):
        of_kind = rows[rows["kind"] == kind]
        for method, (name, colour, dashes) in LINES.items():
            line = of_kind[of_kind["method"] == method].dropna(subset="microseconds")
            panel.plot(line["arms"], line["microseconds"], dashes, color=colour, marker="o", ms=3,
                       label=name)  # fmt: skip
        arms = sorted(of_kind["arms"].unique())
        output.over_arms(panel, arms, f"One evaluation, {kind} joints", "microseconds")
    return drawing


def evaluation_costs(arms: Sequence[int], kinds: Sequence[str], rounds: int) -> dict[str, Any]:
    """Measure all methods on rings of UR5 arms.

    Returns
    -------
    dict
        ``rows``: a list with, for every kind and number of arms, ``kind``, ``arms``,
        ``microseconds`` (method -> an evaluation; None where it was not run), ``relative_error``
        (method -> largest relative deviation from the dense solution), ``ratio_to_best_peer``
        (for ``multiarm`` and ``compiled``) and ``remarks`` (method -> why it was not run).
        ``exponents``, ``upper_exponents``: kind -> method -> slope of log cost over log number of
        arms, over all numbers and over the larger half of them.
        ``growth``: kind -> cost at the most arms over cost at the fewest.
    """
    rows = []
    with one_thread():
        for kind in kinds:
            for count in arms:
                print(f"{kind}, {count} arms", flush=True)
                rows.append(_measure(kind, count, rounds))
    result: dict[str, Any] = {"rows": rows, "exponents": {}, "upper_exponents": {}, "growth": {}}
    for kind in kinds:
        of_kind = [row for row in rows if row["kind"] == kind]
        sizes, costs = [row["arms"] for row in of_kind], [row["microseconds"] for row in of_kind]
        for key, part in (("exponents", slice(None)), ("upper_exponents", upper_half(of_kind))):
            result[key][kind] = {
                method: fitted_slope(sizes[part], [cost[method] for cost in costs[part]])
                for method in METHODS
            }
        growth = costs[-1][OURS] / costs[0][OURS]
        result["growth"][kind] = growth if len(of_kind) > 1 else None
    return result


def moving_state(system: System, seed: int) -> State:
    """The start with a random velocity of some tenths [rad/s, m/s] that the joints allow."""
    state = system.initial_state()
    state.velocity[:] = 0.3 * np.random.default_rng(seed).normal(size=state.velocity.size)
    with system.borrow() as data:
        return project_start(data, system.scene, state)[0]


def _measure(kind: str, count: int, rounds: int) -> dict[str, Any]:
    """All methods on one ring."""
    scene = ring_of_arms(count, kind)
    system, compiled = compile_system(scene), compile_system(scene, arms="compiled")
    state = moving_state(system, seed=count)
    evaluation = evaluate(system, 0.0, state)
    torque = np.concatenate(list(evaluation.joint_torques.values()))
    dense_system = system.with_solver("dense")
    exact = evaluate(dense_system, 0.0, state).accelerations[6:]
    accelerations = {
        OURS: evaluation.accelerations[6:],
        COMPILED: evaluate(compiled, 0.0, state).accelerations[6:],
    }
    remark = too_large_for_pinocchio(system.model.layout.rate_count)
    peers: dict[str, Callable[[], np.ndarray]] = {}
    if not remark:
        peers = {
            "constraintDynamics": ConstraintDynamics(system).evaluation(state, torque),
            "tree": Tree(system).evaluation(state, torque),
            "lcaba": Lcaba(system).evaluation(state, torque),
        }
        accelerations |= {name: call()[: torque.size].copy() for name, call in peers.items()}
    ours, copies, dense = (Data(each.model) for each in (system, compiled, dense_system))
    for data in (ours, copies, dense):
        data.set_state(0.0, state)
    bursts = {
        OURS: slope_burst(ours),
        COMPILED: slope_burst(copies),
        TERMS: terms_burst(ours),
        **{name: python_burst(call) for name, call in peers.items()},
        DENSE: slope_burst(dense),
    }
    cost: dict[str, float | None] = dict.fromkeys(METHODS)
    cost.update(fastest(measure(bursts, rounds * BURSTS_PER_ROUND)))
    scale = np.max(np.abs(exact))
    return {
        "kind": kind,
        "arms": count,
        "microseconds": cost,
        "relative_error": {
            name: float(np.max(np.abs(a - exact)) / scale) for name, a in accelerations.items()
        },
        "ratio_to_best_peer": {name: ratio_to_best_peer(cost, name) for name in (OURS, COMPILED)},
        "remarks": dict.fromkeys(PEERS, remark) if remark else {},
    }


def ratio_to_best_peer(cost: dict[str, float | None], method: str = OURS) -> float | None:
    """Cost of the cheapest peer over that of one of ours; None when no peer was run."""
    ours, peers = cost[method], [cost[name] for name in PEERS]
    known = [peer for peer in peers if peer is not None]
    return min(known) / ours if known and ours is not None else None


def too_large_for_pinocchio(joints: int, free: float | None = None) -> str:
    """Why a system of so many joints is not handed to Pinocchio; empty when it fits.

    ``free`` is the free memory [bytes], by default this machine's.
    """
    free = free_memory() if free is None else free
    need = memory_needed(joints)  # both algorithms' Data together
    if need <= SHARE_OF_MEMORY * free:
        return ""
    return f"not run: Pinocchio's Data would take {need / 1e9:.1f} of {free / 1e9:.1f} GB free"


def free_memory() -> float:
    """Memory [bytes] that this machine can give; infinite where it does not say."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
    except OSError:
        return math.inf
    available = next((line for line in lines if line.startswith("MemAvailable:")), "")
    return 1024.0 * float(available.split()[1]) if available else math.inf


if __name__ == "__main__":
    main()
