"""The modes of a linear system as a trajectory, to be replayed.

Every mode swings once about the state, whatever its frequency, with its largest displacement as
amplitude; the joints are closed at every sample.  Nothing is integrated: every sample is at rest,
with the forces that act there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multiarm.dynamics.data import Data
from multiarm.dynamics.status import OK
from multiarm.errors import ModelError, SolverError
from multiarm.linear.linearisation import LinearSystem
from multiarm.linear.modes import Mode
from multiarm.notation import count_of
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import RunEvent
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import MemorySink
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.driver import failure_of
from multiarm.simulation.record import open_sink
from multiarm.simulation.run import begin
from multiarm.simulation.setup import Task

SAMPLES = 48  # a swing
SWING, PAUSE = 1.6, 0.4  # [s]
# How often an amplitude is halved that the joints do not allow.
MOST_HALVINGS = 16


def modes_trajectory(
    linear: LinearSystem, modes: Sequence[int] | None = None, amplitude: float = 0.1
) -> Trajectory:
    """Show modes one after another, two seconds each.

    Parameters
    ----------
    linear : LinearSystem
    modes : sequence of int, optional
        Places in ``linear.modes``, from 1 on; all when left out.
    amplitude : float
        Largest displacement [m, rad]; smaller where the joints do not allow it.

    Raises
    ------
    SolverError
        For no mode or one that does not exist, or an amplitude that is not greater than 0.
    """
    if not (math.isfinite(amplitude) and amplitude > 0.0):
        raise SolverError(f"amplitude: expected a number greater than 0, got {amplitude!r}")
    count = len(linear.modes)
    chosen = range(1, count + 1) if modes is None else modes
    if not chosen:
        raise SolverError(f"modes: none is chosen; the system has {count_of(count, 'mode')}")
    for number in chosen:
        if not 1 <= number <= count:
            raise SolverError(f"mode {number}: the system has modes 1 to {count}")
    rest, phases = linear.state.copy(), np.linspace(0.0, 2.0 * math.pi, SAMPLES + 1)
    rest.velocity[:] = 0.0
    end = len(chosen) * (SWING + PAUSE) - PAUSE
    system, events, sink = linear.system, [], MemorySink()
    spec = system.scene.run.model_copy(update={"duration": end})
    task = Task(system, Data(system.model), spec, rest, math.inf)
    open_sink(sink, system, spec, True)
    for place, number in enumerate(chosen):
        mode, first = linear.modes[number - 1], place * (SWING + PAUSE)
        events.append(RunEvent(first, EventKind.SHOWS_MODE, mode_text(number, mode)).entry())
        rows = _swing(task, mode.shape, phases, amplitude)
        rows[:, 0] = first + SWING * phases / (2.0 * math.pi)
        sink.append(rows)
    shown = count_of(len(events), "mode")
    message = f"{shown}, {SWING + PAUSE:.0f} s each; nothing was simulated"
    return sink.finish(RunStatus.COMPLETED, message, {"simulated_s": end}, events).of(system.scene)


def mode_text(number: int, mode: Mode) -> str:
    """A mode in a line."""
    what = mode.kind
    if mode.frequency:
        what += f", {mode.frequency:.4g} Hz, damping ratio {mode.damping_ratio:.3g}"
    elif math.isfinite(mode.time_constant):
        what += f" by the factor e in {mode.time_constant:.4g} s"
    moving = ", ".join(mode.moving)
    return f"mode {number}: {what}{f'; moves {moving}' if moving else ''}"


def _swing(task: Task, shape: np.ndarray, phases: np.ndarray, amplitude: float) -> np.ndarray:
    """Samples of a swing ``Re(-i shape e^(i phase))``, which begins where nothing is displaced.

    Each is that of the start of a run, which closes the joints.

    Raises
    ------
    SolverError
        When the joints cannot be closed, however small the amplitude.
    """
    for halvings in range(MOST_HALVINGS + 1):
        moves = amplitude * 0.5**halvings * np.real(-1j * np.exp(1j * phases)[:, None] * shape)
        try:
            return np.array([_sample(task, move) for move in moves])
        except ModelError:
            continue
    raise SolverError("the joints cannot be closed near this state: its modes cannot be shown")


def _sample(task: Task, move: np.ndarray) -> np.ndarray:
    assert task.state is not None, "the state that is displaced"
    driver = begin(replace(task, state=task.state.displaced(move)), MemorySink())
    row = np.zeros(driver.run.block.shape[1])
    status = driver.observe(row)
    if status != OK:
        raise SolverError(failure_of(driver.run, status).message)
    return row
