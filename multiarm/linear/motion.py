"""The modes of a linear system as a trajectory, to be replayed.

Every mode swings once about the state, whatever its frequency, with its largest displacement as
amplitude; the joints are closed at every sample.  Nothing is integrated: every sample is at rest,
with the forces that act there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from multiarm.dynamics.arrays import OK
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError, SolverError
from multiarm.integration.samples import sample_columns
from multiarm.linear.linearisation import LinearSystem, displaced
from multiarm.linear.modes import Mode
from multiarm.results.sinks import MemorySink
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.driver import failure_of
from multiarm.simulation.run import begin, run_metadata
from multiarm.simulation.setup import Task

SAMPLES = 48  # a swing
SWING, PAUSE = 1.6, 0.4  # [s]


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
        For a mode that does not exist, or an amplitude that is not greater than 0.
    """
    if not (math.isfinite(amplitude) and amplitude > 0.0):
        raise SolverError(f"amplitude: expected a number greater than 0, got {amplitude!r}")
    count = len(linear.modes)
    chosen = range(1, count + 1) if modes is None else modes
    for number in chosen:
        if not 1 <= number <= count:
            raise SolverError(f"mode {number}: the system has modes 1 to {count}")
    rest, times, states, events = linear.state.copy(), [], [], []
    rest.velocity[:] = 0.0
    for place, number in enumerate(chosen):
        mode, first = linear.modes[number - 1], place * (SWING + PAUSE)
        events.append({"time": first, "kind": "mode", "text": mode_text(number, mode)})
        phases = np.linspace(0.0, 2.0 * math.pi, SAMPLES + 1)
        states += _swing(linear, rest, mode.shape, phases, amplitude)
        times += [first + SWING * phase / (2.0 * math.pi) for phase in phases]
    return _recorded(linear.system, times, states, events)


def mode_text(number: int, mode: Mode) -> str:
    """A mode in a line."""
    what = mode.kind
    if mode.frequency:
        what += f", {mode.frequency:.4g} Hz, damping ratio {mode.damping_ratio:.3g}"
    elif math.isfinite(mode.time_constant):
        what += f" by the factor e in {mode.time_constant:.4g} s"
    moving = ", ".join(mode.moving)
    return f"mode {number}: {what}{f'; moves {moving}' if moving else ''}"


def _swing(
    linear: LinearSystem, rest: State, shape: np.ndarray, phases: np.ndarray, amplitude: float
) -> list[State]:
    """States of a swing ``Re(-i shape e^(i phase))``, which begins where nothing is displaced.

    Raises
    ------
    SolverError
        When the joints cannot be closed, however small the amplitude.
    """
    p = len(linear.coordinates.positions)
    while amplitude > 1e-6:
        states = []
        try:
            for phase in phases:
                y = np.zeros(len(linear.A))
                moved = displaced(rest, amplitude * (-1j * shape * np.exp(1j * phase)).real)
                y[:p] = linear.coordinates_of(moved)[:p]
                states.append(linear.state_at(y))
            return states
        except ModelError:
            amplitude *= 0.5
    raise SolverError("the joints cannot be closed near this state: its modes cannot be shown")


def _recorded(
    system: System, times: Sequence[float], states: Sequence[State], events: list[dict]
) -> Trajectory:
    """A trajectory of given states, each evaluated as the start of a run."""
    spec = system.scene.run.model_copy(update={"duration": times[-1]})
    sink, data = MemorySink(), system.model.data()
    sink.open(system.channels, run_metadata(system, spec, True), sample_columns)
    for t, state in zip(times, states, strict=True):
        state.velocity[:] = 0.0
        driver = begin(Task(system, data, spec, state, math.inf), MemorySink())
        row = np.zeros(driver.run.block.shape[1])
        status = driver.observe(row)
        if status != OK:
            raise SolverError(failure_of(driver.run, status)[1])
        row[0] = t
        sink.append(row[None])
    message = f"{len(events)} modes, {SWING + PAUSE:.0f} s each; nothing was simulated"
    return sink.finish("completed", message, {"simulated_s": times[-1]}, events).of(system.scene)
