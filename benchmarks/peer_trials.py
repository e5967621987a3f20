"""Hard cases in other programs: their accelerations at the hardest instant.

    python benchmarks/peer_trials.py [NAMES] [--json FILE]

Each solver is asked at the state that our own run has then, and compared with the dense
minimum-norm reference (:mod:`multiarm.dynamics.solver.dense`).  An error is relative to the largest
acceleration, or to 1 m/s^2 and 1 rad/s^2 where all are smaller.  A peer's exception or NaN is an
answer.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import output
import pandas
from matplotlib.figure import Figure
from peer_solvers import Solver, memory_needed

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError, SolverError
from multiarm.events.evaluation import evaluate
from multiarm.plots.style import BLUE
from multiarm.simulation.comparison import sample_state
from multiarm.simulation.simulate import simulate
from multiarm.studies.hard_cases import choose_cases
from multiarm.studies.peers import control_torque, make_peers

OURS = "multiarm"
PINOCCHIO = {
    "constraintDynamics as shipped": "peer_solvers:AsShipped",
    "constraintDynamics": "peer_solvers:ConstraintDynamics",
    "lcaba": "peer_solvers:Lcaba",
}
SOLVERS = PINOCCHIO | {
    "MuJoCo as shipped": "mujoco_solver:AsShipped",
    "MuJoCo": "mujoco_solver:Mujoco",
}
MOST_MEMORY = 1e9
"""Of Pinocchio's Data [bytes]."""


def main(words: Sequence[str] | None = None) -> None:
    """Run the hard cases, ask all solvers, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "peer_trials", rounds=1)
    parser.add_argument("names", nargs="*", help="hard cases; multiarm stability --list has them")
    arguments = parser.parse_args(words)
    tables = []
    with output.Clock() as clock:
        for case in choose_cases(arguments.names):
            print(case.name, flush=True)
            system = compile_system(case.scene())
            answers = all_answers(system, *state_at(system, case.hardest))
            tables.append(pandas.DataFrame(answers).assign(case=case.name))
    rows = pandas.concat(tables).replace("", None)
    rows.insert(0, "case", rows.pop("case"))
    output.save(arguments, clock, "peer_trials", rows, figure)


def figure(rows: pandas.DataFrame) -> Figure:
    """Errors of the accelerations of each solver, a dot for each case."""
    drawing, (axes,) = output.panels(1)
    solvers = list(rows["solver"].unique())
    for place, solver in enumerate(solvers):
        errors = rows.loc[rows["solver"] == solver, ["object_error", "joint_error"]].max(axis=1)
        axes.plot(
            errors.clip(lower=1e-17), np.full(len(errors), place), "o", color=BLUE, mfc="none"
        )
    axes.set_yticks(range(len(solvers)), solvers)
    axes.set(xscale="log", xlabel="relative error", title="Accelerations at the hardest instant")
    axes.invert_yaxis()
    return drawing


@dataclass(frozen=True)
class Answer:
    """What one solver made of a case.

    Attributes
    ----------
    solver : str
    refusal : str
        Why it was not run: it cannot express the case, or is not installed.  Else empty.
    object_error, joint_error : float or None
        Relative errors of the accelerations; None where there are none.
    accelerations : str
        Empty, or what came instead of numbers.
    """

    solver: str
    refusal: str = ""
    object_error: float | None = None
    joint_error: float | None = None
    accelerations: str = ""


def state_at(system: System, time: float) -> tuple[float, State]:
    """The time [s] and the state at the end of our own run to that time.

    Raises
    ------
    SolverError
        The run ends earlier.
    """
    if time == 0.0:
        return time, system.initial_state()
    run = simulate(system, duration=time, output_step=time, certificate=False)
    if run.status != "completed":
        raise SolverError(f"our own run to {time:g} s {run.status}: {run.message}")
    return float(run.time[-1]), sample_state(system.model.layout, run, len(run) - 1)


def all_answers(system: System, time: float, state: State) -> list[Answer]:
    """The answers of all solvers, ours first."""
    memory = memory_needed(system.model.layout.rate_count)
    spared = PINOCCHIO if memory > MOST_MEMORY else {}
    asked = {name: place for name, place in SOLVERS.items() if name not in spared}
    able, refusals = make_peers(system, asked)
    text = f"not run: Pinocchio's Data for it takes about {memory / 1e9:.1f} GB"
    refusals |= dict.fromkeys(spared, text)
    try:
        reference = evaluate(system.with_solver("dense"), time, state).accelerations
    except (MultiarmError, np.linalg.LinAlgError):
        reference = None  # then there are no errors
    answers = [answer_of(OURS, lambda: evaluate(system, time, state).accelerations, reference)]
    for name in SOLVERS:
        if name in refusals:
            answers.append(Answer(name, refusal=refusals[name]))
            continue
        peer = able[name]
        assert isinstance(peer, Solver), "all of SOLVERS tell their accelerations"
        ask = partial(peer.accelerations, state, control_torque(system, time, state))
        with np.errstate(all="ignore"):
            answers.append(answer_of(name, ask, reference))
    return answers


def answer_of(
    name: str, accelerations: Callable[[], np.ndarray], reference: np.ndarray | None
) -> Answer:
    """The accelerations (6 + n,) of a solver compared, or what came instead."""
    try:
        values = accelerations()
    except Exception as error:
        lines = str(error).strip().splitlines()
        return Answer(name, accelerations=lines[0][:120] if lines else type(error).__name__)
    if not np.all(np.isfinite(values)):
        return Answer(name, accelerations="NaN")
    if reference is None:
        return Answer(name)
    return Answer(
        name,
        object_error=_relative_error(values[:6], reference[:6]),
        joint_error=_relative_error(values[6:], reference[6:]),
    )


def _relative_error(values: np.ndarray, reference: np.ndarray) -> float:
    return float(np.max(np.abs(values - reference)) / max(1.0, np.max(np.abs(reference))))


if __name__ == "__main__":
    main()
