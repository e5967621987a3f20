"""Comparison of two runs at their output times, and the growth of their difference.

Both are read in blocks, so that memory does not grow with the length of the run.  Compared are
position of every object and floating base [m], its rotation (the angle of the relative quaternion)
[rad], the joints of every arm (sliding ones in m, turning ones in rad) and the contact forces of
every arm and of the floor [N], of those contacts that both runs have.

*Undetermined forces.*  Where the constraints are dependent, the equations leave some forces open,
and the reported ones depend on roundings.  At samples whose rank is below the number of contacts
such forces, which :func:`undetermined_forces` finds, are left out.

*Growth.*  The motion of closed chains is often unstable or chaotic: two runs that differ by
rounding separate like e^(rate t) until their distance is as large as the motion allows.  The rate
is the slope of the logarithm of the distance, by the median of the slopes of all pairs of points
(Theil and Sen), which is robust against peaks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from multiarm.dynamics.control_laws import NO_CONTROL
from multiarm.dynamics.data import Data
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.state import State
from multiarm.errors import MultiarmError
from multiarm.events.evaluation import evaluate_data
from multiarm.results.channels import arm_channel, base_names, channels_of, object_paths
from multiarm.results.trajectory import Trajectory

POSITION, ROTATION, FORCE = "position_m", "rotation_rad", "force_N"
OUTPUT_KINDS = (POSITION, ROTATION, FORCE)
"""Kinds of output for which an accuracy can be set."""
LENGTHS = (POSITION, ROTATION)
UNITS = {POSITION: "m", ROTATION: "rad", FORCE: "N"}

VELOCITIES = ("twist", "joint_velocity", "base_twist")
"""Of which the largest difference of each number is kept: those of the state."""
BLOCK_SAMPLES = 4096


class Measure(Enum):
    """How far apart two samples of an output are."""

    EACH = auto()  # magnitude of the difference of each number
    LENGTH = auto()  # of the difference of two points
    ANGLE = auto()  # between two orientations


@dataclass(frozen=True)
class Output:
    """Columns of a channel that are compared together."""

    noun: str  # what it is, such as ``joints``
    kind: str  # one of ``OUTPUT_KINDS``
    channel: str
    columns: np.ndarray
    others: np.ndarray  # the columns of the other run
    arm: str = ""  # or "floor", or one of several objects; empty for the only one
    measure: Measure = Measure.EACH

    @property
    def name(self) -> str:
        """Such as ``left: joints``."""
        return f"{self.arm}: {self.noun}" if self.arm else self.noun


@dataclass
class Difference:
    """Largest difference of one output."""

    kind: str
    noun: str  # of the output
    arm: str = ""  # or "floor", or one of several objects; empty for the only one
    worst: float = 0.0
    time: float = 0.0  # [s], of the largest difference
    size: float = 0.0  # of the values themselves
    left_out: int = 0  # samples at which some forces were left out
    compared: bool = False


@dataclass
class Comparison:
    """Differences of two runs."""

    outputs: dict[str, Difference]
    time: np.ndarray  # (p,) [s], ends of intervals
    course: dict[str, np.ndarray]  # by kind, (p,): the largest difference in each interval
    velocity: dict[str, np.ndarray]  # by channel: the largest difference of each velocity
    work: float  # [J], the largest difference
    samples: int  # that both runs have

    def worst(self, kind: str) -> float | None:
        """The largest difference of all outputs of a kind; None without such outputs."""
        worst = [d.worst for d in self.outputs.values() if d.kind == kind and d.compared]
        return max(worst, default=None)

    def size(self, kind: str) -> float:
        """The largest value of all outputs of a kind."""
        return max((d.size for d in self.outputs.values() if d.kind == kind), default=0.0)


def outputs_of(run: Trajectory, other: Trajectory) -> list[Output]:
    """Outputs that are compared: objects' poses, joints and bases of robots, contact forces."""
    outputs, paths = [], object_paths(run.channels)
    for name, path in paths.items():
        outputs += _pose("object", f"{path}/", name if len(paths) > 1 else "")
    for arm in run.arm_names:
        joints = run.channels[arm_channel(arm, "joint_position")]
        units = np.array(joints.column_units)
        for kind, noun in ((ROTATION, "joints"), (POSITION, "sliding joints")):
            columns = np.flatnonzero(units == UNITS[kind])
            if columns.size:
                outputs.append(Output(noun, kind, joints.name, columns, columns, arm))
    for robot in base_names(run.channels):
        outputs += _pose("base", arm_channel(robot, "base_"), robot)
    for owner, name in channels_of(run.channels, "contact_force").items():
        if name not in other.channels:
            continue
        labels, others = (r.channels[name].labels for r in (run, other))
        columns = np.flatnonzero([label in others for label in labels])
        if columns.size:
            same = np.flatnonzero([label in labels for label in others])
            outputs.append(Output("contact forces", FORCE, name, columns, same, owner))
    return outputs


def _pose(noun: str, prefix: str, owner: str) -> list[Output]:
    """Position and rotation of a frame; ``prefix`` is that of its channels."""
    place, turn = np.arange(3), np.arange(4)
    position, rotation = f"{prefix}position", f"{prefix}quaternion_xyzw"
    return [
        Output(f"{noun} position", POSITION, position, place, place, owner, Measure.LENGTH),
        Output(f"{noun} rotation", ROTATION, rotation, turn, turn, owner, Measure.ANGLE),
    ]


def compare(
    run: Trajectory,
    other: Trajectory,
    undetermined: Mapping[str, np.ndarray] | None = None,
) -> Comparison:
    """Compare two runs of one scene, or of one with other effects, at the same output times.

    Parameters
    ----------
    run, other : Trajectory
    undetermined : mapping of str to ndarray of bool, optional
        By arm: forces that are left out where the constraints are dependent.
    """
    outputs, samples = outputs_of(run, other), min(len(run), len(other))
    velocities = [c.name for c in run.channels.values() if c.quantity in VELOCITIES]
    contacts = sum(output.columns.size for output in outputs if output.kind == FORCE)
    result = {o.name: Difference(o.kind, o.noun, o.arm) for o in outputs}
    apart = {name: np.zeros(run.channels[name].shape) for name in velocities}
    width = max(1, -(-samples // 400))  # at most 400 points of the course, each of its worst sample
    times: list[float] = []
    course: dict[str, list[float]] = {kind: [] for kind in OUTPUT_KINDS}
    work = 0.0
    rows = width * max(1, BLOCK_SAMPLES // width)
    for start in range(0, samples, rows):
        stop = min(start + rows, samples)
        time = run.read("time", start, stop)
        dependent = np.minimum(*(r.read("solver/rank", start, stop) for r in (run, other)))
        dependent = dependent < contacts
        block = {kind: np.zeros(len(time)) for kind in OUTPUT_KINDS}
        for output in outputs:
            first, second = (r.read(output.channel, start, stop) for r in (run, other))
            gaps = _apart(output, first, second)
            size = _sizes(output, first)
            lost = (undetermined or {}).get(output.arm) if output.kind == FORCE else None
            if lost is not None and lost[output.columns].any():
                open_here = dependent[:, None] & lost[output.columns]
                gaps, size = np.where(open_here, 0.0, gaps), np.where(open_here, 0.0, size)
                result[output.name].left_out += int(dependent.sum())
                _note(result[output.name], time, gaps, size, not bool(open_here.all()))
            else:
                _note(result[output.name], time, gaps, size, True)
            np.maximum(block[output.kind], gaps.max(axis=1), out=block[output.kind])
        for name, worst in apart.items():
            gap = np.abs(run.read(name, start, stop) - other.read(name, start, stop))
            np.maximum(worst, gap.max(axis=0), out=worst)
        gap = run.read("energy/work", start, stop) - other.read("energy/work", start, stop)
        work = max(work, float(np.abs(gap).max()))
        starts = np.arange(0, len(time), width)
        times += time[np.minimum(starts + width, len(time)) - 1].tolist()
        for kind, values in block.items():
            course[kind] += np.maximum.reduceat(values, starts).tolist()
    courses = {kind: np.array(values) for kind, values in course.items()}
    return Comparison(result, np.array(times), courses, apart, work, samples)


def growth_rate(time: np.ndarray, apart: np.ndarray) -> float | None:
    """Exponential growth rate of a distance [1/s]; None when it does not grow exponentially.

    Parameters
    ----------
    time : ndarray, shape (p,)
        Since the start of the runs [s].
    apart : ndarray, shape (p,)
        Distance of two runs [m, rad].
    """
    fewest = 12  # points that a rate needs
    if len(time) < fewest:
        return None
    # between roundings and the size of the motion [m, rad]
    seen = (apart > 1e-13) & (apart < 0.03)
    # after saturation a small distance is no growth any more
    late = np.flatnonzero(apart >= 0.03)
    if late.size:
        seen[late[0] :] = False
    if seen.any():
        # errors of any run grow as a power of time in the beginning, by accumulation
        first, last = time[seen][0], time[seen][-1]
        seen &= time >= first + 0.2 * (last - first)
    t, y = time[seen], np.log(apart[seen])
    if len(t) < fewest:
        return None
    chosen = np.unique(np.linspace(0, len(t) - 1, 150).astype(int))
    t, y = t[chosen], y[chosen]
    rate, spread = _line(t, y)
    if rate * (t[-1] - t[0]) < 2.5 or rate * time[-1] < 5.0:  # less growth is not significant
        return None
    # errors that accumulate grow as a small power of time (of accelerations: its square, and a
    # little more): a straight line over the logarithm of time
    power, spread_of_power = _line(np.log(t), y)
    return float(rate) if spread <= spread_of_power or power > 5.0 else None


def undetermined_forces(data: Data, run: Trajectory) -> dict[str, np.ndarray]:
    """By arm: which contact forces the equations leave open where the constraints are dependent.

    From evaluations of some states at which the rank is below the number of contacts.  Arms without
    such forces are left out.
    """
    dependent, start, states = [], 0, 8
    for (rank,) in run.blocks("solver/rank", samples=BLOCK_SAMPLES):
        samples = np.flatnonzero(rank < data.model.layout.contacts)
        dependent += (start + samples[:: max(1, len(samples) // states)]).tolist()
        start += len(rank)
    if not dependent:
        return {}
    chosen = {dependent[i] for i in np.linspace(0, len(dependent) - 1, states).astype(int)}
    if data.model.python_control is not None:  # does not matter here, and may depend on its calls
        data = data.view(data.model.with_constants(control=NO_CONTROL))
    lost: dict[str, np.ndarray] = {}
    for k in sorted(chosen):
        try:
            t = float(run.read("time", k, k + 1)[0])
            evaluation = evaluate_data(data, t, sample_state(data.model.layout, run, k))
        except MultiarmError:
            continue
        for arm, unique in evaluation.contact_forces_unique.items():
            lost[arm] = lost.get(arm, np.zeros(len(unique), dtype=bool)) | ~np.asarray(unique)
    return {arm: flags for arm, flags in lost.items() if flags.any()}


def sample_state(layout: Layout, run: Trajectory, k: int) -> State:
    """The state of a sample."""

    def read(name: str) -> np.ndarray:
        return run.read(name, k, k + 1)[0]

    state = State(np.zeros(layout.nq), np.zeros(layout.nv), layout)
    paths = object_paths(run.channels).values()
    for moving, path in zip(state.objects.values(), paths, strict=True):
        moving.position[:] = read(f"{path}/position")
        moving.quaternion_xyzw[:] = read(f"{path}/quaternion_xyzw")
        moving.twist[:] = read(f"{path}/twist")
    for robot in layout.names:
        state.joint_positions[robot][:] = read(arm_channel(robot, "joint_position"))
        state.joint_velocities[robot][:] = read(arm_channel(robot, "joint_velocity"))
    for robot, base in state.bases.items():
        base.position[:] = read(arm_channel(robot, "base_position"))
        base.quaternion_xyzw[:] = read(arm_channel(robot, "base_quaternion_xyzw"))
        base.twist[:] = read(arm_channel(robot, "base_twist"))
    return state


def rotation_apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles between two sequences of unit quaternions xyzw, shapes (..., 4), to (...) [rad]."""
    vector = first[..., 3:] * second[..., :3] - second[..., 3:] * first[..., :3]
    vector -= np.cross(first[..., :3], second[..., :3])
    scalar = np.einsum("...j,...j->...", first, second)
    return 2.0 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar))


def object_poses(run: Trajectory) -> np.ndarray:
    """Poses of the F objects: position [m] and quaternion xyzw, shape (K, F, 7)."""
    parts = "position", "quaternion_xyzw"
    poses = [
        np.hstack([run.channel(f"{path}/{part}") for part in parts])
        for path in object_paths(run.channels).values()
    ]
    return np.stack(poses, axis=1)


def pose_differences(poses: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """Largest distance [m] and largest angle [rad] between poses, shapes (..., 7)."""
    distances = np.linalg.norm(poses[..., :3] - others[..., :3], axis=-1)
    return float(np.max(distances)), float(np.max(rotation_apart(poses[..., 3:], others[..., 3:])))


def _apart(output: Output, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Differences of an output, shape (k, columns); a rotation and a position have one."""
    if output.measure is Measure.ANGLE:
        return rotation_apart(first, second)[:, None]
    gap = first[:, output.columns] - second[:, output.others]
    if output.measure is Measure.LENGTH:
        return np.linalg.norm(gap, axis=1)[:, None]
    return np.abs(gap)


def _sizes(output: Output, values: np.ndarray) -> np.ndarray:
    """Magnitudes of an output, in the shape of its differences."""
    if output.measure is Measure.ANGLE:
        return np.ones((len(values), 1))
    sizes = np.abs(values[:, output.columns])
    return sizes.max(axis=1)[:, None] if output.measure is Measure.LENGTH else sizes


def _note(
    difference: Difference, time: np.ndarray, apart: np.ndarray, size: np.ndarray, compared: bool
) -> None:
    row = int(np.argmax(apart.max(axis=1)))
    if apart[row].max() > difference.worst:
        difference.worst, difference.time = float(apart[row].max()), float(time[row])
    difference.size = max(difference.size, float(size.max()))
    difference.compared |= compared


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Median slope over all pairs of points, and the median distance from that line."""
    i, j = np.triu_indices(len(x), 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
    rest = y - slope * x
    return slope, float(np.median(np.abs(rest - np.median(rest))))
