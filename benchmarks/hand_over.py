"""A box that goes from arm to arm, here and in MuJoCo: gaps, errors and cost.

    python benchmarks/hand_over.py

The left UR5 holds the box at the start, the right one takes hold while it is carried, then a Panda:
one arm, both, the other, twice.  Springs and dampers pull all joints along the same references.
Those who take hold move against the box, so that each grip is an impact.

MuJoCo holds by ``weld`` constraints, ``eq_active`` at the same times; each is put where both bodies
are when it takes hold.  It has the joints' springs and dampers as its own, and references from a
tape: no Python is in its loop.  It is run as shipped, with the stiffest time constant that it
allows (``solref`` of two steps), and hardened besides, see :mod:`multiarm.studies.mujoco_peer`.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import output
import pandas
from matplotlib.figure import Figure
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.control.recorded import RecordedPositions
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.scene import parse_scene
from multiarm.simulation.comparison import sample_state
from multiarm.studies.mujoco_peer import INTEGRATORS, MujocoPeer, TorqueTape, quiet

DURATION, INTERVAL = 3.0, 2e-3
"""Of the run, and between two samples [s]."""
HOLDS = {"left": (0.0, 1.2), "right": (0.8, 2.2), "third": (1.8, DURATION)}
"""When each arm holds the box [s]."""
SETTLED = 0.01
"""After a grip, when the momentum of the box is compared [s]."""
ACCURACY, REFERENCE = 1e-6, 1e-9
STEPS = (2e-3, 1e-3, 1e-4)
"""Of MuJoCo [s]."""
OURS = "multiarm"
ARMS = {
    "left": {"robot": "ur5", "tip": "tool0", "base": {"xyz": [-0.75, 0.0, 0.0]},
             "posture": [-0.2355, -0.2763, -1.1772, 1.4535, 1.3352, -1.5708]},
    "right": {"robot": "ur5", "tip": "tool0",
              "base": {"xyz": [0.75, 0.0, 0.0], "rpy": [0, 0, np.pi]},
              "posture": [-0.2355, -0.2763, -1.1772, 1.4535, 1.3352, 1.5708]},
    "third": {"robot": "panda", "tip": "panda_hand_tcp",
              "base": {"xyz": [0.0, 0.65, 0.0], "rpy": [0, 0, -np.pi / 2]},
              "lock": {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
              "posture": [1.4154, -1.4077, -1.1709, -2.4981, -2.6303, 2.3104, 0.6488]},
}  # fmt: skip
AWAY = {"left": (-0.1, 0, 0), "right": (0.1, 0, 0), "third": (0, 0.1, 0)}
"""Where each arm is while it does not hold, from where it does [m]."""
CARRY = np.array([0.04, 0.06, 0.05])
"""Of the box, to and fro [m]."""
STIFFNESS = {6: [2000.0] * 3 + [100.0] * 3, 7: [2000.0] * 4 + [100.0] * 3}  # [N m/rad]
DAMPING = {6: [200.0] * 3 + [2.0] * 3, 7: [200.0] * 4 + [2.0] * 3}  # [N m s/rad]


class Setting(NamedTuple):
    """How MuJoCo is run."""

    name: str
    method: str
    hardened: bool
    stiff: bool  # the time constant of the constraints is two steps, else 20 ms


SETTINGS = (
    Setting("MuJoCo as shipped", "Euler", False, False),
    Setting("MuJoCo, solref 2 dt", "Euler", False, True),
    Setting("MuJoCo, hardened, RK4", "RK4", True, True),
)


def main(words: Sequence[str] | None = None) -> None:
    """Hand the box over in both programs, and write the table, the figure and the numbers."""
    parser = output.options(__doc__, "hand_over", rounds=3)
    arguments = parser.parse_args(words)
    with output.Clock() as clock, tempfile.TemporaryDirectory() as folder:
        system = ma.compile_system(parse_scene(scene(Path(folder) / "references.csv")))
        rows = compare(system, STEPS, arguments.rounds)
        costs = {name: f"{1e3 * cost:.2f} ms" for name, cost in switch_costs(system).items()}
    print("a switch:", ", ".join(f"{name} {cost}" for name, cost in costs.items()))
    output.save(arguments, clock, "hand_over", pandas.DataFrame(rows), figure)


def figure(rows: pandas.DataFrame) -> Figure:
    """Largest gap over the cost."""
    drawing, (axes,) = output.panels(1)
    for name, of_program in rows.groupby("program", sort=False):
        axes.plot(of_program["cpu_s"], of_program["gap_m"], "o-", label=name)
    axes.set(xscale="log", yscale="log", xlabel="processor's time per second [s]",
             ylabel="largest gap [m]", title="A box goes from arm to arm")  # fmt: skip
    axes.legend(fontsize=7.5, frameon=False)
    return drawing


# --- the scene ------------------------------------------------------------------------------------


def scene(table: Path) -> dict[str, Any]:
    """The scene, whose references are written to a table."""
    joints = []
    for arm, (begin, end) in HOLDS.items():
        times = {"from": begin} if begin > 0.0 else {}
        times |= {"until": end} if end < DURATION else {}
        joints.append({"arm": arm, "kind": "weld", **times})
    counts = {arm: len(written["posture"]) for arm, written in ARMS.items()}
    body = {"shape": {"box": [0.4, 0.2, 0.2]}, "mass": 3.0, "pose": {"xyz": [0.0, 0.0, 0.5]}}
    written = {"gravity": [0, 0, -9.81], "object": body, "arms": ARMS, "joints": joints}
    carried = parse_scene({**written, "control": "gravity_compensation"})
    write_references(ma.compile_system(carried), table)
    control = {
        "kind": "recorded", "file": str(table), "quantity": "position", "interpolation": "cubic",
        "stiffness": {arm: STIFFNESS[count] for arm, count in counts.items()},
        "damping": {arm: DAMPING[count] for arm, count in counts.items()},
        "gravity_compensation": False,
    }  # fmt: skip
    run = {"duration": DURATION, "accuracy": ACCURACY, "output_step": INTERVAL}
    return {**written, "control": control, "run": run}


def write_references(system: System, table: Path) -> None:
    """References of all joints: they carry the box to and fro, and come and go.

    They are above the posture by as much as the springs give way at the start.
    """
    times = np.linspace(0.0, DURATION, 61)
    state, columns = system.initial_state(), {"time": times}
    weight = ma.evaluate(system, 0.0, state).joint_torques
    for arm, tip in system.kinematics(state).tips.items():
        place = np.zeros((times.size, 6))
        place[:, :3] = CARRY * np.sin(2.0 * np.pi * times / DURATION)[:, None] ** 2
        place[:, :3] += np.array(AWAY[arm]) * distance(arm, times)[:, None]
        start = np.array(ARMS[arm]["posture"])
        start += weight[arm] / STIFFNESS[start.size]
        angles = start + place @ np.linalg.pinv(tip.jacobian).T
        for k, joint in enumerate(system.arms[arm].joint_names):
            columns[f"{arm}/{joint}"] = angles[:, k]
    pandas.DataFrame(columns).to_csv(table, index=False)


def distance(arm: str, times: np.ndarray) -> np.ndarray:
    """How far an arm is on its way off the box [1]; it comes at a speed, and leaves after 50 ms."""
    begin, end = HOLDS[arm]
    comes = np.clip((begin - times) / 0.6, 0.0, 1.0) if begin > 0.0 else 0.0 * times
    goes = np.clip((times - end - 0.05) / 0.6, 0.0, 1.0) if end < DURATION else 0.0 * times
    return comes * (2.0 - comes) + goes**2 * (3.0 - 2.0 * goes)


# --- what is compared -----------------------------------------------------------------------------


class Motion(NamedTuple):
    """A run: its samples, and the processor's time that it takes [s]."""

    states: list[State]
    cpu_s: float

    @property
    def diverged(self) -> bool:
        """Whether its numbers are none, or absurd."""
        last = self.states[-1]
        return not bool(np.all(np.abs([*last.position, *last.velocity]) < 1e3))


def phases() -> list[tuple[float, float]]:
    """Stretches of time in which the same arms hold."""
    times = sorted({0.0, DURATION, *(t for pair in HOLDS.values() for t in pair)})
    return list(pairwise(times))


def compare(system: System, steps: Sequence[float], rounds: int) -> list[dict[str, Any]]:
    """Figures of our run and of MuJoCo's, whose errors are those against our run at 1e-9."""
    exact, _ = ours(system, REFERENCE, 1)
    measured, certificate = ours(system, ACCURACY, rounds)
    welds = Welds(system, SETTINGS[0], steps[0])
    rows = [{"program": OURS, "step": None, **figures(welds, measured, exact)}]
    print(certificate, flush=True)
    for setting in SETTINGS:
        for step in steps:
            motion = Welds(system, setting, step).motion(rounds)
            print(f"{setting.name}, {step:g} s", flush=True)
            row = {} if motion.diverged else figures(welds, motion, exact)
            rows.append({"program": setting.name, "step": step, **row})
    return rows


def ours(system: System, accuracy: float, rounds: int) -> tuple[Motion, str]:
    """Our run, and its certificate's text."""
    seconds = []
    for _ in range(rounds):
        begin = time.thread_time()
        ma.simulate(system, accuracy=accuracy, certificate=False, output_step=DURATION)
        seconds.append(time.thread_time() - begin)
    run = ma.simulate(system, accuracy=accuracy)
    if run.status != "completed":
        raise SolverError(f"the run {run.status}: {run.message}")
    layout = system.model.layout
    states = [sample_state(layout, run, k) for k in samples_of(run.time)]
    return Motion(states, min(seconds)), run.certificate["text"]


def switch_costs(system: System, count: int = 30) -> dict[str, float]:
    """Processor's time in which the second arm takes hold, and lets go [s]: medians."""
    stepper = ma.Stepper(system, accuracy=ACCURACY)
    switches = {"take hold": stepper.attach, "let go": stepper.detach}
    seconds: dict[str, list[float]] = {name: [] for name in switches}
    for _ in range(count):
        for name, switch in switches.items():
            stepper.advance(INTERVAL)
            begin = time.thread_time()
            switch("right")
            seconds[name].append(time.thread_time() - begin)
    return {name: float(np.median(of_name)) for name, of_name in seconds.items()}


def samples_of(times: np.ndarray) -> list[int]:
    """The samples on the grid; at a switch, those after it."""
    grid = INTERVAL * np.arange(round(DURATION / INTERVAL) + 1)
    return (np.searchsorted(times, grid + 0.5 * INTERVAL) - 1).tolist()


def figures(welds: Welds, motion: Motion, exact: Motion) -> dict[str, Any]:
    """Largest gaps of each phase and of all, errors, and the cost per second of motion.

    The error of the jump is that of the box's momentum over a grip.
    """
    gaps = np.array([welds.gaps(motion.states, begin, end) for begin, end in phases()])
    apart = np.array([pose_error(a, b) for a, b in zip(motion.states, exact.states, strict=True)])
    mass = welds.system.model.constants.object_masses[0]
    jumps = [
        mass * np.linalg.norm(change(motion.states, begin) - change(exact.states, begin))
        for begin, _ in HOLDS.values()
        if begin > 0.0
    ]
    named = {f"gap_{k}_m": gap for k, gap in enumerate(gaps[:, 0], start=1)}
    return {
        **named, "gap_m": gaps[:, 0].max(), "gap_rad": gaps[:, 1].max(),
        "error_m": apart[:, 0].max(), "error_rad": apart[:, 1].max(),
        "jump_error_N_s": max(jumps), "cpu_s": motion.cpu_s / DURATION,
    }  # fmt: skip


def change(states: Sequence[State], t: float) -> np.ndarray:
    """Change of the box's velocity [m/s] over a grip, up to ``SETTLED`` after it."""
    k = round(t / INTERVAL)
    after = states[k + round(SETTLED / INTERVAL)]
    return after.object_twist[:3] - states[k - 1].object_twist[:3]


def pose_error(state: State, exact: State) -> tuple[float, float]:
    """Distance of two poses of the box [m, rad]."""
    turn = Rotation.from_quat(state.object_quaternion_xyzw).inv() * Rotation.from_quat(
        exact.object_quaternion_xyzw
    )
    return (
        float(np.linalg.norm(state.object_position - exact.object_position)),
        float(turn.magnitude()),
    )


# --- MuJoCo ---------------------------------------------------------------------------------------


class Welds(MujocoPeer):
    """The scene in MuJoCo, whose welds are active while the arms hold."""

    def __init__(self, system: System, setting: Setting, step: float):
        self.hardened = setting.hardened  # before the model is built
        super().__init__(system)
        self.step, model = step, self.model
        model.opt.integrator, self.stages = INTEGRATORS[setting.method]
        model.opt.timestep = step
        if setting.stiff:
            model.eq_solref[:] = 2.0 * step, 1.0
        (law,) = system.model.laws
        numbers = law.numbers
        assert isinstance(numbers, RecordedPositions), "references are from a table"
        n = system.model.layout.rate_count
        model.jnt_stiffness[:n], model.qpos_spring[:n] = numbers.stiffness, 0.0
        model.dof_damping[:n] = numbers.damping
        self._references = PPoly(numbers.coefficients.transpose(2, 0, 1), numbers.times)
        self._gains = numbers
        self._sites = {
            arm: [model.site(f"{arm}/{side}0").id for side in ("arm", "object")] for arm in HOLDS
        }

    def motion(self, rounds: int) -> Motion:
        """The run in samples, as far as it goes, and the fastest of those without."""
        states = [state for state, _ in self._run(INTERVAL)]
        return Motion(states, min(self._time() for _ in range(rounds)))

    def _time(self) -> float:
        *_, (_, seconds) = self._run(None)
        return seconds

    def _run(self, interval: float | None) -> Iterator[tuple[State, float]]:
        """States after intervals, or after phases, and the processor's time of the steps so far."""
        d, n = self.data, self.system.model.layout.rate_count
        self.place(self.system.initial_state())
        tape, seconds = TorqueTape(d.qfrc_applied[:n]), 0.0
        yield self.state(), seconds
        with quiet(tape.play):
            for begin, end in phases():
                self._hold(begin)
                length = end - begin if interval is None else interval
                count = round(length / self.step)
                offsets = (np.arange(count)[:, None] + np.array(self.stages)).ravel() * self.step
                for k in range(round((end - begin) / length)):
                    tape.load(self._torques(begin + k * length + offsets))
                    start = time.thread_time()
                    mujoco.mj_step(self.model, d, nstep=count)
                    seconds += time.thread_time() - start
                    yield self.state(), seconds
                    if not np.isfinite(d.qpos).all():
                        return

    def _torques(self, times: np.ndarray) -> np.ndarray:
        """Torques of the references; MuJoCo's springs and dampers pull to zero."""
        gains, y = self._gains, self._references
        return gains.stiffness * y(times) + gains.damping * y(times, 1)

    def _hold(self, t: float) -> None:
        """Let the arms hold that hold from a time on; those that take hold do so where they are."""
        mujoco.mj_kinematics(self.model, self.data)
        for k, (arm, (begin, end)) in enumerate(HOLDS.items()):
            holds = begin <= t < end
            if holds and not (self.data.eq_active[k] and t > 0.0):
                position, turn = self._relative(arm)
                site = self._sites[arm][1]
                # the site of the object, in the object's axes
                self.model.site_pos[site] += self._on_object(site).apply(position)
                moved = self._on_object(site) * turn
                self.model.site_quat[site] = np.roll(moved.as_quat(), 1)
            self.data.eq_active[k] = holds

    def _on_object(self, site: int) -> Rotation:
        return Rotation.from_quat(np.roll(self.model.site_quat[site], -1))

    def _relative(self, arm: str) -> tuple[np.ndarray, Rotation]:
        """Pose of the frame on the arm in that on the box, at the kinematics in the data."""
        d = self.data
        (of_arm, x), (of_box, y) = (
            (Rotation.from_matrix(d.site_xmat[site].reshape(3, 3)), d.site_xpos[site].copy())
            for site in self._sites[arm]
        )
        return of_box.inv().apply(x - y), of_box.inv() * of_arm

    def gaps(self, states: Sequence[State], begin: float, end: float) -> np.ndarray:
        """Largest gaps [m, rad] of the arms that hold in a phase, from where they took hold."""
        largest = np.zeros(2)
        for arm, (since, until) in HOLDS.items():
            if not since <= begin < until:
                continue
            at, turned = self._placed(states[round(since / INTERVAL)], arm)
            for state in states[round(begin / INTERVAL) : round(end / INTERVAL) + 1]:
                x, turn = self._placed(state, arm)
                gap = np.linalg.norm(x - at), (turned.inv() * turn).magnitude()
                largest = np.maximum(largest, gap)
        return largest

    def _placed(self, state: State, arm: str) -> tuple[np.ndarray, Rotation]:
        self.place(state)
        mujoco.mj_kinematics(self.model, self.data)
        return self._relative(arm)


if __name__ == "__main__":
    main()
