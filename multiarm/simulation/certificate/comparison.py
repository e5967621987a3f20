"""How far two runs of one scene are apart at their output times, and where.

Both are read side by side in blocks, so that memory does not grow with the length of the run. What
is compared are the outputs: position of the object [m], its rotation (the angle of the relative
quaternion) [rad], the joints of every arm (those that slide in m, those that turn in rad) and the
contact forces of every arm [N].

Where the constraints are dependent, the equations leave some forces open, and which of them is
reported depends on roundings: at samples whose rank is below the number of contacts such forces
take no part. `undetermined_forces` finds them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from multiarm.dynamics.callbacks import NO_CONTROL
from multiarm.dynamics.model import Data
from multiarm.dynamics.state import Layout, State
from multiarm.errors import MultiarmError
from multiarm.events.evaluation import evaluate_data
from multiarm.results.trajectory import Trajectory

POSITION, ROTATION, FORCE = "position_m", "rotation_rad", "force_N"
KINDS = (POSITION, ROTATION, FORCE)
"""Kinds of output, by which accuracy is asked."""
LENGTHS = (POSITION, ROTATION)
UNITS = {POSITION: "m", ROTATION: "rad", FORCE: "N"}

MOST_POINTS = 400
"""Points of the course over time; each is the worst of its samples."""
BLOCK_SAMPLES = 4096
_MOTION = ("position", "velocity")
EVALUATED_STATES = 8
"""States at which it is evaluated which forces are determined."""


@dataclass(frozen=True)
class Output:
    """Columns of a channel that are compared together.

    Attributes
    ----------
    name : str
        As it is told: ``left: joints``.
    kind : str
        One of ``KINDS``.
    channel : str
    columns : ndarray of int
    arm : str
        Empty for the object.
    """

    name: str
    kind: str
    channel: str
    columns: np.ndarray
    arm: str = ""


@dataclass
class Difference:
    """Of one output: the worst over time, the time of it [s], the size of the values themselves.

    ``left_out`` counts samples at which some forces took no part.
    """

    kind: str
    worst: float = 0.0
    time: float = 0.0
    size: float = 0.0
    left_out: int = 0
    compared: bool = False


@dataclass
class Comparison:
    """Two runs, compared.

    Attributes
    ----------
    outputs : dict of str to Difference
    time : ndarray, shape (p,)
        [s]
    course : dict of str to ndarray, shape (p,)
        By kind: the worst difference of all outputs of that kind around each time.
    velocity : dict of str to ndarray
        By channel: the largest difference of each velocity.
    work : float
        The largest difference of the work done [J].
    samples : int
        How many were compared; fewer than a run has, where the other one ended early.
    """

    outputs: dict[str, Difference]
    time: np.ndarray
    course: dict[str, np.ndarray]
    velocity: dict[str, np.ndarray]
    work: float
    samples: int

    def worst(self, kind: str) -> float | None:
        """The worst difference of all outputs of a kind; None where there is none."""
        found = [d.worst for d in self.outputs.values() if d.kind == kind and d.compared]
        return max(found, default=None)

    def size(self, kind: str) -> float:
        """The largest value of all outputs of a kind."""
        return max((d.size for d in self.outputs.values() if d.kind == kind), default=0.0)


@dataclass
class _Course:
    """What is collected on the way."""

    time: list[float] = field(default_factory=list)
    worst: dict[str, list[float]] = field(default_factory=lambda: {kind: [] for kind in KINDS})


def outputs_of(run: Trajectory) -> list[Output]:
    """What is compared: one entry for the object's position and rotation, and some for each arm."""
    found = [
        Output("object position", POSITION, "object/position", np.arange(3)),
        Output("object rotation", ROTATION, "object/quaternion_xyzw", np.arange(4)),
    ]
    for arm in run.arm_names:
        joints = run.channels[f"arms/{arm}/joint_position"]
        units = np.array(joints.column_units)
        for kind, noun in ((ROTATION, "joints"), (POSITION, "sliding joints")):
            columns = np.flatnonzero(units == UNITS[kind])
            if columns.size:
                found.append(Output(f"{arm}: {noun}", kind, joints.name, columns, arm))
        forces = run.channels[f"arms/{arm}/contact_force"]
        columns = np.arange(forces.shape[0])
        if columns.size:
            found.append(Output(f"{arm}: contact forces", FORCE, forces.name, columns, arm))
    return found


def compare(
    run: Trajectory,
    other: Trajectory,
    undetermined: Mapping[str, np.ndarray] | None = None,
) -> Comparison:
    """Compare two runs of one scene with the same output times.

    Parameters
    ----------
    run, other : Trajectory
    undetermined : mapping of str to ndarray of bool, optional
        By arm: forces that take no part where the constraints are dependent.
    """
    outputs, samples = outputs_of(run), min(len(run), len(other))
    velocities = [name for name in run.channels if name.endswith(("twist", "joint_velocity"))]
    contacts = sum(output.columns.size for output in outputs if output.kind == FORCE)
    result = {output.name: Difference(output.kind) for output in outputs}
    apart = {name: np.zeros(run.channels[name].shape) for name in velocities}
    width, course, work = max(1, -(-samples // MOST_POINTS)), _Course(), 0.0
    rows = width * max(1, BLOCK_SAMPLES // width)
    for start in range(0, samples, rows):
        stop = min(start + rows, samples)
        time = run.read("time", start, stop)
        dependent = np.minimum(*(r.read("solver/rank", start, stop) for r in (run, other)))
        dependent = dependent < contacts
        block = {kind: np.zeros(len(time)) for kind in KINDS}
        for output in outputs:
            first, second = (r.read(output.channel, start, stop) for r in (run, other))
            found = _apart(output, first, second)
            size = _sizes(output, first)
            lost = (undetermined or {}).get(output.arm) if output.kind == FORCE else None
            if lost is not None and lost.any():
                open_here = dependent[:, None] & lost
                found, size = np.where(open_here, 0.0, found), np.where(open_here, 0.0, size)
                result[output.name].left_out += int(dependent.sum())
                _note(result[output.name], time, found, size, not bool(open_here.all()))
            else:
                _note(result[output.name], time, found, size, True)
            np.maximum(block[output.kind], found.max(axis=1), out=block[output.kind])
        for name, worst in apart.items():
            gap = np.abs(run.read(name, start, stop) - other.read(name, start, stop))
            np.maximum(worst, gap.max(axis=0), out=worst)
        gap = run.read("energy/work", start, stop) - other.read("energy/work", start, stop)
        work = max(work, float(np.abs(gap).max()))
        _extend(course, time, block, width)
    times = np.array(course.time)
    courses = {kind: np.array(values) for kind, values in course.worst.items()}
    return Comparison(result, times, courses, apart, work, samples)


def undetermined_forces(data: Data, run: Trajectory) -> dict[str, np.ndarray]:
    """By arm: which contact forces the equations leave open where the constraints are dependent.

    Evaluated at some states at which the rank is below the number of contacts; an arm
    that is not named has none.
    """
    dependent, start = [], 0
    for (rank,) in run.blocks("solver/rank", samples=BLOCK_SAMPLES):
        found = np.flatnonzero(rank < data.model.layout.contacts)
        dependent += (start + found[:: max(1, len(found) // EVALUATED_STATES)]).tolist()
        start += len(rank)
    if not dependent:
        return {}
    chosen = {
        dependent[i] for i in np.linspace(0, len(dependent) - 1, EVALUATED_STATES).astype(int)
    }
    if data.model.python_control is not None:  # it has no part in this, and may have a memory
        data = data.view(data.model.with_constants(control=NO_CONTROL))
    lost: dict[str, np.ndarray] = {}
    for k in sorted(chosen):
        try:
            t = float(run.read("time", k, k + 1)[0])
            evaluation = evaluate_data(data, t, state_of(data.model.layout, run, k))
        except MultiarmError:
            continue
        for arm, unique in evaluation.contact_forces_unique.items():
            lost[arm] = lost.get(arm, np.zeros(len(unique), dtype=bool)) | ~np.asarray(unique)
    return {arm: flags for arm, flags in lost.items() if flags.any()}


def state_of(layout: Layout, run: Trajectory, k: int) -> State:
    """The state of a sample."""

    def read(name: str) -> np.ndarray:
        return run.read(name, k, k + 1)[0]

    joints = [[read(f"arms/{arm}/joint_{what}") for arm in run.arm_names] for what in _MOTION]
    pose = [read("object/position"), read("object/quaternion_xyzw")]
    return State(
        np.concatenate([*pose, *joints[0]]),
        np.concatenate([read("object/twist"), *joints[1]]),
        layout,
    )


def rotation_apart(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angles between two sequences of unit quaternions xyzw, shapes (k, 4), to (k,) [rad]."""
    vector = first[:, 3:] * second[:, :3] - second[:, 3:] * first[:, :3]
    vector -= np.cross(first[:, :3], second[:, :3])
    scalar = np.einsum("ij,ij->i", first, second)
    return 2.0 * np.arctan2(np.linalg.norm(vector, axis=1), np.abs(scalar))


def _apart(output: Output, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Differences of an output, shape (k, columns); a rotation and a position have one."""
    if output.channel == "object/quaternion_xyzw":
        return rotation_apart(first, second)[:, None]
    gap = first[:, output.columns] - second[:, output.columns]
    if output.channel == "object/position":
        return np.linalg.norm(gap, axis=1)[:, None]
    return np.abs(gap)


def _sizes(output: Output, values: np.ndarray) -> np.ndarray:
    """Magnitudes of an output, in the shape of its differences."""
    if output.channel == "object/quaternion_xyzw":
        return np.ones((len(values), 1))
    sizes = np.abs(values[:, output.columns])
    return sizes.max(axis=1)[:, None] if output.channel == "object/position" else sizes


def _note(
    difference: Difference, time: np.ndarray, found: np.ndarray, size: np.ndarray, compared: bool
) -> None:
    row = int(np.argmax(found.max(axis=1)))
    if found[row].max() > difference.worst:
        difference.worst, difference.time = float(found[row].max()), float(time[row])
    difference.size = max(difference.size, float(size.max()))
    difference.compared |= compared


def _extend(course: _Course, time: np.ndarray, block: dict[str, np.ndarray], width: int) -> None:
    starts = np.arange(0, len(time), width)
    course.time += time[np.minimum(starts + width, len(time)) - 1].tolist()
    for kind, values in block.items():
        course.worst[kind] += np.maximum.reduceat(values, starts).tolist()
