"""Hard cases in other programs: their accelerations at the hardest instant, and a short run.

    python benchmarks/peer_trials.py [NAMES] [--json FILE]

Each solver gets two tasks, at states of our own run.

1. The accelerations at the case's hardest instant, compared with the dense minimum-norm reference
   (:mod:`multiarm.dynamics.solver.dense`).  An error is relative to the largest of them, or to 1
   m/s^2 and 1 rad/s^2 where all are smaller.
2. The same motion for ``WINDOW`` seconds around that instant by the peer's best method: largest gap
   of the loops and error of the energy after its steps.  Pinocchio's algorithms, which have no
   integrator, are integrated together with the work by SciPy's DOP853 at a tolerance of 1e-10;
   MuJoCo has its own steps, over which the power is integrated by Simpson's rule.

A run ends after ``PATIENCE``.  A peer's exception or NaN is an answer.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import output
import pandas
from matplotlib.figure import Figure
from peer_solvers import Solver, memory_needed
from scipy.integrate import cumulative_simpson

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.equations import potential_energy, update_kinematics
from multiarm.dynamics.kinematics import read_inertia
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError
from multiarm.events.evaluation import evaluate
from multiarm.plots.style import BLUE
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import sample_state
from multiarm.simulation.simulate import simulate
from multiarm.studies.hard_cases import choose_cases
from multiarm.studies.peers import (
    Clock,
    Drive,
    Grid,
    Sample,
    Sinusoid,
    control_torque,
    is_controlled,
    joint_damping,
    largest_gap,
    make_peers,
)
from multiarm.studies.timing import OutOfTime

WINDOW = 0.5
"""Length of the short run [s], or to the end of the case; at least from sample to sample."""
PATIENCE = 1.0
"""A solver's wall time for the short run [s]."""
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
APART = 10.0
"""A short run has broken when the loops are apart by this many metres."""


def main(words: Sequence[str] | None = None) -> None:
    """Run the hard cases, ask all solvers, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "peer_trials", rounds=1)
    parser.add_argument("names", nargs="*", help="hard cases; multiarm stability --list has them")
    arguments = parser.parse_args(words)
    answers = {}
    with output.Clock() as clock:
        for case in choose_cases(arguments.names):
            print(case.name, flush=True)
            system = compile_system(case.scene())
            run = simulate(system, certificate=False)
            if len(run):
                answers[case.name] = all_answers(Trial(system, run, case.hardest))
    numbers = {name: [asdict(answer) for answer in each] for name, each in answers.items()}
    output.save(arguments, clock, "peer_trials", numbers, table(answers), figure)


def table(answers: dict[str, tuple[Answer, ...]]) -> pandas.DataFrame:
    """A row for each case and solver."""
    return pandas.DataFrame(
        {"case": case}
        | {key: value if value != "" else None for key, value in asdict(answer).items()}
        for case, each in answers.items()
        for answer in each
    )


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
    """What one solver made of a case; None where it gave no number.

    Attributes
    ----------
    solver : str
    refusal : str
        Why it was not run: it cannot express the case, or is not installed.  Else empty.
    object_error, joint_error : float or None
        Relative errors of the accelerations at the hardest moment.
    accelerations : str
        Empty, or what came instead of numbers.
    simulated : float or None
        How far the short run came [s].
    drift, energy_error : float or None
        Largest gap [m] and largest error of the energy balance [J] in the short run.
    ended : str
        Empty when the short run was finished; else what ended it.
    out_of_time : bool
        It was ended by ``PATIENCE`` alone: nothing broke.
    """

    solver: str
    refusal: str = ""
    object_error: float | None = None
    joint_error: float | None = None
    accelerations: str = ""
    simulated: float | None = None
    drift: float | None = None
    energy_error: float | None = None
    ended: str = ""
    out_of_time: bool = False

    @property
    def broken(self) -> bool:
        """Whether something broke: there are no accelerations, or the short run fell apart."""
        return bool(self.accelerations or (self.ended and not self.out_of_time))


class Trial:
    """The two questions about one case, and the yardsticks for the answers.

    Parameters
    ----------
    system : System
    trajectory : Trajectory
        Our run; not empty.
    hardest : float
        [s] The moment at which it is hardest.
    """

    def __init__(self, system: System, trajectory: Trajectory, hardest: float):
        self.system, self.trajectory = system, trajectory
        times = trajectory.time
        self.time, self.worst = self._worst(hardest)
        self.first = _sample_at(times, max(times[0], self.time - WINDOW / 2))
        last = _sample_at(times, min(times[-1], times[self.first] + WINDOW))
        self.last = min(max(last, self.first + 1), len(times) - 1)
        self.begin = float(times[self.first])
        self.window = float(times[self.last]) - self.begin
        self.damping = joint_damping(system)
        self.drive: Drive = lambda t, state: self._torques(t, state())
        if not is_controlled(system):
            self.drive = Sinusoid.none(self.damping.size)
        self.reference: np.ndarray | None = None
        try:
            dense = evaluate(system.with_solver("dense"), self.time, self.worst)
        except (MultiarmError, np.linalg.LinAlgError):
            return  # without a reference there are no errors
        self.reference = dense.accelerations

    def _worst(self, hardest: float) -> tuple[float, State]:
        """Time and state at the hardest moment: run to it when it is between two samples."""
        times = self.trajectory.time
        nearest = _sample_at(times, hardest)
        between = abs(times[nearest] - hardest) > 1e-9 and times[0] < hardest < times[-1]
        if between:
            run = simulate(self.system, duration=hardest, output_step=hardest, certificate=False)
            if run.status == "completed":
                last = sample_state(self.system.model.layout, run, len(run) - 1)
                return float(run.time[-1]), last
        return float(times[nearest]), self.state(nearest)

    def state(self, sample: int) -> State:
        """The state of a sample of our run."""
        return sample_state(self.system.model.layout, self.trajectory, sample)

    def _torques(self, t: float, state: State) -> np.ndarray:
        """Torques of the scene's control at a time of the short run, shape (n,)."""
        return control_torque(self.system, self.begin + t, state)

    def energy_errors(self, samples: Sequence[Sample]) -> np.ndarray:
        """Energy of each sample of a short run that no work explains [J]."""
        energy = np.array([total_energy(self.system, sample.state) for sample in samples])
        works = [sample.work for sample in samples if sample.work is not None]
        if works:
            return np.abs(energy - energy[0] - works)
        power = np.zeros(len(energy))
        for k, sample in enumerate(samples):
            v = sample.state.velocity[6:]
            power[k] = (self._torques(sample.time, sample.state) - self.damping * v) @ v
        times = [sample.time for sample in samples]
        work = cumulative_simpson(power, x=times, initial=0.0)
        return np.abs(energy - energy[0] - work)[::2]  # two steps are one of Simpson's

    def errors(self, accelerations: np.ndarray) -> tuple[float | None, float | None]:
        """Relative errors of the object's and the joints' accelerations (6 + n,)."""
        if self.reference is None:
            return None, None
        off = np.abs(accelerations - self.reference)
        parts = (slice(None, 6), slice(6, None))
        object_error, joint_error = (
            float(np.max(off[part]) / max(1.0, np.max(np.abs(self.reference[part]))))
            for part in parts
        )
        return object_error, joint_error


def total_energy(system: System, state: State) -> float:
    """Kinetic and potential energy [J]."""
    with system.borrow() as data:
        data.set_state(0.0, state)
        update_kinematics(data.struct)
        twist, b = state.object_twist, data.arrays
        kinetic = twist @ b.bodies.object_inertia @ twist
        for i, v in enumerate(state.joint_velocities.values()):
            kinetic += v @ read_inertia(b.bodies.pointers[i], v.size) @ v
        return 0.5 * float(kinetic) + potential_energy(data.struct)


def all_answers(trial: Trial) -> tuple[Answer, ...]:
    """The answers of all solvers, ours first."""
    joints = trial.system.model.layout.joints
    memory = memory_needed(joints)
    spared = PINOCCHIO if memory > MOST_MEMORY else {}
    asked = {name: place for name, place in SOLVERS.items() if name not in spared}
    able, refusals = make_peers(trial.system, asked)
    text = f"not run: Pinocchio's Data for it takes about {memory / 1e9:.1f} GB"
    refusals |= dict.fromkeys(spared, text)
    answers = [_our_answer(trial)]
    for name in SOLVERS:
        if name in refusals:
            answers.append(Answer(name, refusal=refusals[name]))
            continue
        peer = able[name]
        assert isinstance(peer, Solver), "all of SOLVERS tell their accelerations"
        answers.append(answer_of(trial, name, peer))
    return tuple(answers)


def answer_of(trial: Trial, name: str, peer: Solver) -> Answer:
    """Give both tasks to a peer; the answer reports any exception."""

    def accelerations() -> np.ndarray:
        torque = control_torque(trial.system, trial.time, trial.worst)
        return peer.accelerations(trial.worst, torque)

    with np.errstate(all="ignore"):
        return _short_run(trial, peer, _compared(trial, name, accelerations))


def _our_answer(trial: Trial) -> Answer:
    """Our own evaluation, and the same window of our own run."""
    answer = _compared(
        trial, OURS, lambda: evaluate(trial.system, trial.time, trial.worst).accelerations
    )
    run = trial.trajectory
    window = slice(trial.first, trial.last + 1)
    balance = run.energy_balance[window]
    return replace(
        answer,
        simulated=trial.window,
        drift=float(np.max(run.position_drift[window])),
        energy_error=float(np.max(np.abs(balance - balance[0]))),
    )


def _compared(trial: Trial, name: str, accelerations: Callable[[], np.ndarray]) -> Answer:
    """The answer to the first task."""
    try:
        values = accelerations()
    except Exception as error:
        return Answer(name, accelerations=_error_text(error))
    if not np.all(np.isfinite(values)):
        return Answer(name, accelerations="NaN")
    object_error, joint_error = trial.errors(values)
    return Answer(name, object_error=object_error, joint_error=joint_error)


def _reached(samples: Sequence[Sample]) -> float:
    return samples[-1].time if samples else 0.0


def _short_run(trial: Trial, peer: Solver, answer: Answer) -> Answer:
    """Follow the motion of the window to its end, or to what ends it, and add its judgement."""
    method, value = peer.best
    count = 1
    if peer.methods[method] == "step":
        count = math.ceil(trial.window / value - 1e-9)
        value = trial.window / count
    grid, start = Grid(trial.window / count, count), trial.state(trial.first)
    samples: list[Sample] = []
    ended, late = "", False
    try:
        course = peer.follow(Clock(PATIENCE), grid, start, method, value, trial.drive)
        for sample in itertools.takewhile(lambda sample: sample.is_finite, course):
            samples.append(sample)
        if _reached(samples) < trial.window * (1.0 - 1e-9):
            ended = "NaN"
    except OutOfTime:
        ended, late = f"only {_reached(samples):.3g} s in {PATIENCE:g} s of wall time", True
    except Exception as error:
        ended = _error_text(error)
    gaps = np.array([largest_gap(trial.system, sample.state) for sample in samples])
    apart = np.flatnonzero(~(gaps <= APART))
    if apart.size:
        ended, late = f"the loops are more than {APART:g} m apart", False
        del samples[apart[0] + 1 :]
    reached = _reached(samples)
    if ended and not late:
        ended += f" after {reached:.3g} s"
    answer = replace(answer, simulated=reached, ended=ended, out_of_time=late)
    if not reached:  # then nothing is known but the start itself
        return answer
    off = trial.energy_errors(samples)
    return replace(
        answer,
        drift=float(np.max(gaps[: len(samples)])),
        energy_error=float(np.max(off[np.isfinite(off)])),
    )


def _sample_at(times: np.ndarray, t: float) -> int:
    return int(np.argmin(np.abs(times - t)))


def _error_text(error: Exception) -> str:
    """The first line of what was raised."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else type(error).__name__
    return text if len(text) <= 120 else f"{text[:117]}..."


if __name__ == "__main__":
    main()
