"""Hard cases in other programs: their accelerations at the hardest instant, and a short run.

Each solver gets two tasks, at states of our own run.

1. The accelerations at the case's hardest instant, compared with the dense minimum-norm reference
   (:mod:`multiarm.dynamics.solver.dense`).  An error is relative to the largest of them, or to 1
   m/s^2 and 1 rad/s^2 where all are smaller.
2. The same motion for ``WINDOW`` seconds around that instant: largest gap of the loops and error of
   the energy.  Pinocchio's algorithms, which have no integrator, are integrated by SciPy's DOP853
   at a relative tolerance of 1e-9; MuJoCo has its own steps.

A run ends after ``PATIENCE``.  A peer's exception or NaN is an answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, MultiarmError
from multiarm.events.evaluation import evaluate
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.simulate import simulate
from multiarm.studies.observables import (
    control_torque,
    inexpressible_effects,
    is_controlled,
    joint_damping,
    largest_gap,
    total_energy,
)
from multiarm.studies.peers import NOT_INSTALLED

if TYPE_CHECKING:
    from multiarm.studies.mujoco_peer import MujocoModel

WINDOW = 0.5
"""Length of the short run [s], or to the end of the case; at least from sample to sample."""
PATIENCE = 1.0
"""A solver's wall time for the short run [s]."""
OURS = "multiarm"
PINOCCHIO = ("constraintDynamics as shipped", "constraintDynamics", "lcaba")
MUJOCO = {"MuJoCo as shipped": True, "MuJoCo": False}
STEPS_PER_LOOK = 10
"""Steps of MuJoCo's (an even number) between two looks at gaps and energy."""
BYTES_PER_CUBE, MOST_MEMORY = 64, 1e9
"""Memory of Pinocchio's Data, as measured, grows with the cube of the number of joints."""
APART = 10.0
"""A short run has broken when the loops are apart by this many metres."""


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
        self.controlled = is_controlled(system)
        self.reference: np.ndarray | None = None
        try:
            dense = evaluate(system.with_solver("dense"), self.time, self.worst)
        except (MultiarmError, np.linalg.LinAlgError):
            return  # without a reference there are no errors
        self.reference = np.concatenate(
            [dense.object_acceleration, *dense.joint_accelerations.values()]
        )

    def _worst(self, hardest: float) -> tuple[float, State]:
        """Time and state at the hardest moment: run to it when it is between two samples."""
        times = self.trajectory.time
        nearest = _sample_at(times, hardest)
        between = abs(times[nearest] - hardest) > 1e-9 and times[0] < hardest < times[-1]
        if between:
            run = simulate(self.system, duration=hardest, output_step=hardest, certificate=False)
            if run.status == "completed":
                return float(run.time[-1]), self.state(-1, run)
        return float(times[nearest]), self.state(nearest)

    def state(self, sample: int, run: Trajectory | None = None) -> State:
        """The state of a sample of our run, or of another of this system."""
        run = run or self.trajectory
        return self.system.state(
            object_position=run.object_position[sample],
            object_quaternion_xyzw=run.object_quaternion_xyzw[sample],
            object_twist=run.object_twist[sample],
            joint_positions={arm: q[sample] for arm, q in run.joint_positions.items()},
            joint_velocities={arm: v[sample] for arm, v in run.joint_velocities.items()},
        )

    def control(self, t: float, state: State) -> np.ndarray:
        """Torques of the scene's control at time ``t`` of our run, shape (n,), without damping."""
        return control_torque(self.system, t, state)

    def gap(self, state: State) -> float:
        """Largest gap of a contact [m]."""
        return largest_gap(self.system, state)

    def energy(self, state: State) -> float:
        """Kinetic and potential energy [J]."""
        return total_energy(self.system, state)

    def errors(self, accelerations: np.ndarray) -> tuple[float | None, float | None]:
        """Relative errors of the object's and the joints' accelerations (6 + n,)."""
        if self.reference is None:
            return None, None
        off = np.abs(accelerations - self.reference)
        parts = (slice(None, 6), slice(6, None))
        found = [
            float(np.max(off[part]) / max(1.0, np.max(np.abs(self.reference[part]))))
            for part in parts
        ]
        return found[0], found[1]


class Refused(Exception):
    """A peer is spared the question; the text says why."""


class Stopped(Exception):
    """A short run cannot go on; the text says why."""


Motion = Iterator[tuple[float, State, float]]
"""States of a short run: time since its start [s], state, work done since then [J]."""


def all_answers(trial: Trial) -> tuple[Answer, ...]:
    """The answers of all solvers, ours first."""
    answers = [_our_answer(trial)]
    for algorithm in PINOCCHIO:
        answers.append(answer_of(trial, algorithm, pinocchio_peer(trial, algorithm)))
    for name, as_shipped in MUJOCO.items():
        answers.append(answer_of(trial, name, mujoco_peer(trial, as_shipped)))
    return tuple(answers)


MakePeer = Callable[[], tuple[Callable[[State, np.ndarray], np.ndarray], Callable[[State], Motion]]]
"""Makes a peer's model; returns its accelerations (6 + n,) and its motion as functions."""


def answer_of(trial: Trial, solver: str, make: MakePeer) -> Answer:
    """Give both tasks to a peer; the answer reports any exception."""
    strange = inexpressible_effects(trial.system)
    if strange:
        return Answer(solver, refusal=f"cannot express {', '.join(strange)}")
    with np.errstate(all="ignore"):
        try:
            accelerations, motion = make()
        except ModelError as error:
            return Answer(solver, refusal=f"cannot express it: {error}")
        except Refused as reason:
            return Answer(solver, refusal=f"not run: {reason}")
        except ImportError:
            return Answer(solver, refusal=NOT_INSTALLED)
        object_error = joint_error = None
        trouble = ""
        try:
            state = trial.worst
            torque = trial.control(trial.time, state) - trial.damping * state.velocity[6:]
            found = accelerations(state, torque)
            if np.all(np.isfinite(found)):
                object_error, joint_error = trial.errors(found)
            else:
                trouble = "NaN"
        except Exception as error:
            trouble = _error_text(error)
        course = _short_run(trial, motion)
    return Answer(solver, "", object_error, joint_error, trouble, *course)


class _ShortRun(NamedTuple):
    """How a short run went; the fields are those of :class:`Answer`."""

    simulated: float
    drift: float | None
    energy_error: float | None
    ended: str
    out_of_time: bool


def _short_run(trial: Trial, motion: Callable[[State], Motion]) -> _ShortRun:
    """Watch a short run to its end, or to what ends it."""
    start = trial.state(trial.first)
    energy = trial.energy(start)
    reached, drift, off, ended, late = 0.0, trial.gap(start), 0.0, "", False
    deadline = time.perf_counter() + PATIENCE
    try:
        for t, state, work in motion(start):
            gap, error = trial.gap(state), abs(trial.energy(state) - energy - work)
            if not (np.isfinite(gap) and np.isfinite(error)):
                raise Stopped("NaN")
            reached, drift, off = t, max(drift, gap), max(off, error)
            if gap > APART:
                raise Stopped(f"the loops are more than {APART:g} m apart")
            if t >= trial.window * (1.0 - 1e-9):
                break
            if time.perf_counter() > deadline:
                raise TimeoutError
        else:
            raise Stopped("NaN")
    except TimeoutError:
        late, ended = True, f"only {reached:.3g} s in {PATIENCE:g} s of wall time"
    except Exception as error:
        ended = f"{_error_text(error)} after {reached:.3g} s"
    if not reached:  # then nothing was found but the start itself
        return _ShortRun(reached, None, None, ended, late)
    return _ShortRun(reached, drift, off, ended, late)


def _our_answer(trial: Trial) -> Answer:
    """Our own evaluation, and the same window of our own run."""
    object_error = joint_error = None
    trouble = ""
    try:
        own = evaluate(trial.system, trial.time, trial.worst)
        found = np.concatenate([own.object_acceleration, *own.joint_accelerations.values()])
        object_error, joint_error = trial.errors(found)
    except MultiarmError as error:
        trouble = str(error)
    run = trial.trajectory
    window = slice(trial.first, trial.last + 1)
    balance = run.energy_balance[window]
    return Answer(
        OURS,
        object_error=object_error,
        joint_error=joint_error,
        accelerations=trouble,
        simulated=trial.window,
        drift=float(np.max(run.position_drift[window])),
        energy_error=float(np.max(np.abs(balance - balance[0]))),
    )


def pinocchio_peer(trial: Trial, algorithm: str) -> MakePeer:
    """A function that makes one of Pinocchio's algorithms."""

    def make():
        from multiarm.studies.pinocchio_peer import PinocchioForest

        memory = BYTES_PER_CUBE * (6 + trial.system.model.layout.joints) ** 3
        if memory > MOST_MEMORY:
            raise Refused(f"Pinocchio's Data for it takes about {memory / 1e9:.1f} GB")
        forest = PinocchioForest(trial.system)

        def accelerations(state: State, torque: np.ndarray) -> np.ndarray:
            return np.concatenate(forest.accelerations(state, torque, algorithm))

        return accelerations, lambda start: _integrated(trial, accelerations, start)

    return make


def mujoco_peer(trial: Trial, as_shipped: bool) -> MakePeer:
    """A function that makes the MuJoCo model."""

    def make():
        from multiarm.studies.mujoco_peer import MujocoModel

        model = MujocoModel(trial.system, trial.damping, as_shipped)

        def accelerations(state: State, torque: np.ndarray) -> np.ndarray:
            damping = trial.damping * state.velocity[6:]  # MuJoCo adds its own
            return np.concatenate(model.accelerations(state, torque + damping))

        return accelerations, lambda start: _stepped(trial, model, start)

    return make


def _integrated(
    trial: Trial, accelerations: Callable[[State, np.ndarray], np.ndarray], start: State
) -> Motion:
    """Motion by DOP853; the unknowns are positions, velocities and the work."""
    from scipy.integrate import DOP853

    split, layout = start.position.size, start.layout
    deadline = time.perf_counter() + PATIENCE

    def unpacked(y: np.ndarray) -> State:
        position = y[:split].copy()
        position[3:7] /= np.linalg.norm(position[3:7])
        return State(position, y[split:-1].copy(), layout)

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        if time.perf_counter() > deadline:
            raise TimeoutError
        state = unpacked(y)
        torque = trial.control(trial.begin + t, state) - trial.damping * state.velocity[6:]
        found = accelerations(state, torque)
        if not np.all(np.isfinite(found)):
            raise Stopped("NaN")
        turning = _quaternion_rate(y[3:7], state.object_twist[3:])
        rates = [state.object_twist[:3], turning, state.velocity[6:]]
        return np.concatenate([*rates, found, [torque @ state.velocity[6:]]])

    begin = np.concatenate([start.position, start.velocity, [0.0]])
    stepper = DOP853(slope, 0.0, begin, trial.window, rtol=1e-9, atol=1e-10)
    while stepper.status == "running":
        fault = stepper.step()
        if stepper.status == "failed":
            raise Stopped(str(fault))
        yield float(stepper.t), unpacked(stepper.y), float(stepper.y[-1])


def _stepped(trial: Trial, model: MujocoModel, start: State) -> Motion:
    """Motion by MuJoCo's own steps; the work is their powers' integral by Simpson's rule."""

    def torque(t: float, state: State) -> np.ndarray:
        return trial.control(trial.begin + t, state)

    def power(t: float, state: State) -> float:
        v = state.velocity[6:]
        return float((torque(t, state) - trial.damping * v) @ v)

    work, last, between = 0.0, power(0.0, start), 0.0
    motion = model.steps(start, torque if trial.controlled else None)
    for number, (t, state) in enumerate(motion, start=1):
        now = power(t, state)
        if number % 2:
            between = now
            continue
        work += model.step * (last + 4.0 * between + now) / 3.0  # two steps are one of Simpson's
        last = now
        if number % STEPS_PER_LOOK == 0 or t >= trial.window:
            yield t, state, work


def _quaternion_rate(q: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """``dq/dt`` of a quaternion xyzw, the angular velocity in world axes."""
    vector = q[3] * omega + np.cross(omega, q[:3])
    return 0.5 * np.concatenate([vector, [-omega @ q[:3]]])


def _sample_at(times: np.ndarray, t: float) -> int:
    return int(np.argmin(np.abs(times - t)))


def _error_text(error: Exception) -> str:
    """The first line of what was raised."""
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else type(error).__name__
    return text if len(text) <= 120 else f"{text[:117]}..."
