"""A hard case: a scene, its difficulty, and the bounds that a good run keeps.

A criterion measures something of a finished run and has a bound that was known before the run: it
follows from the requested accuracy, from the roundings of the coordinates, or from an
independent solution.  The bounds that recur, with where they come from:

* ``CLOSED``: projection closes gaps to a hundred roundings of the coordinates, 2e-14 m for each
  metre that the scene is large; a factor of ten for scenes of some metres.
* ``CLOSED_RATE``: the rates are what one linear solve leaves of velocities of some m/s; its
  rounding is eps times the condition of the arms, which 1e-10 leaves room for up to about 1e5.
* ten times the accuracy, of energy: positions and velocities that are off by the accuracy, relative
  to what moves, shift it by twice as much for each of the few coordinates that carry it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import SolverError
from multiarm.results.outcome import RunStatus

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import Scene

CLOSED = 1e-12  # [m]
CLOSED_RATE = 1e-10  # [m/s]

Measure = Callable[["Trajectory", "System"], float]


@dataclass(frozen=True)
class Criterion:
    """A number that a run has to keep below a bound.

    Attributes
    ----------
    quantity : str
        Description of the measured quantity.
    bound : float
        The run passes when the measured number is at most this.
    unit : str
        "m", "J", ...; "1" for pure numbers.
    measure : callable
        ``(trajectory, system) -> float``.
    channel : str
        The recorded quantity that stays below the bound; empty where it is not recorded as such.
    """

    quantity: str
    bound: float
    unit: str
    measure: Measure
    channel: str = ""


@dataclass(frozen=True)
class HardCase:
    """A named system on which solvers break.

    Attributes
    ----------
    name : str
        On the command line.
    title : str
    difficulty : str
        The difficulty, and why solvers break on it.
    scene : callable
        Returns the scene; its ``run`` holds duration and accuracy.
    criteria : tuple of Criterion
    hardest : float
        Time at which the system is at its hardest [s].
    events : bool
        The run is expected to report a lost direction or a change of rank.
    """

    name: str
    title: str
    difficulty: str
    scene: Callable[[], Scene]
    criteria: tuple[Criterion, ...]
    hardest: float = 0.0
    events: bool = False


def completed() -> Criterion:
    """The run reached its end: 0, else 1."""
    return Criterion(
        "run ended early", 0.0, "1", lambda run, system: float(run.status != RunStatus.COMPLETED)
    )


def position_drift(bound: float = CLOSED) -> Criterion:
    """Largest gap of a contact over the run [m]."""
    return Criterion(
        "position drift",
        bound,
        "m",
        lambda run, system: largest(run.position_drift),
        channel="drift/position",
    )


def velocity_drift(bound: float = CLOSED_RATE) -> Criterion:
    """Largest rate of a gap over the run [m/s]."""
    return Criterion(
        "velocity drift",
        bound,
        "m/s",
        lambda run, system: largest(run.velocity_drift),
        channel="drift/velocity",
    )


def energy_error(scale: float | None, bound: float, named: str = "") -> Criterion:
    """Largest energy balance relative to ``scale`` [J]; None: to the largest kinetic energy."""
    named = named or ("largest kinetic energy" if scale is None else f"{scale:g} J")

    def measure(run: Trajectory, system: System) -> float:
        moved = largest(run.kinetic_energy) if scale is None else scale
        return largest(run.energy_balance) / moved

    return Criterion(f"energy error / {named}", bound, "1", measure)


def sound(
    accuracy: float,
    *,
    scale: float | None = None,
    named: str = "",
    closed: float = CLOSED,
    closed_rate: float = CLOSED_RATE,
) -> tuple[Criterion, ...]:
    """The four criteria of every case: completed, closed in position and velocity, energy kept."""
    return (
        completed(),
        position_drift(closed),
        velocity_drift(closed_rate),
        energy_error(scale, 10.0 * accuracy, named),
    )


def distance_from(
    named: str,
    bound: float,
    build: Callable[..., Scene],
    *arguments: Any,
    solver: str | None = None,
) -> Criterion:
    """Object's largest distance from its path in a run of another scene, or by another solver [m].

    Two runs of one problem differ by what each is off.
    """

    def measure(run: Trajectory, system: System) -> float:
        reference = reference_run(build, *arguments, solver=solver)
        return apart(run.object_position, reference.object_position)

    return Criterion(f"distance from {named}", bound, "m", measure)


@cache
def reference_run(
    build: Callable[..., Scene], *arguments: Any, solver: str | None = None
) -> Trajectory:
    """The run of the scene ``build(*arguments)``, by another solver if one is named; made once.

    Raises
    ------
    SolverError
        It fails.
    KeyboardInterrupt
        Ctrl-C ends it, and what asks for it.
    """
    from multiarm.assembly.compilation import compile_system
    from multiarm.simulation.simulate import simulate

    scene = build(*arguments)
    if solver is not None:
        scene = scene.replace(run=scene.run.model_copy(update={"solver": solver}))
    run = simulate(compile_system(scene), certificate=False)
    if run.status == RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    if run.status != RunStatus.COMPLETED:
        raise SolverError(f"the run to compare with, '{scene.name}', {run.status}: {run.message}")
    return run


def largest(values: np.ndarray) -> float:
    """Largest magnitude; infinite where a number is not one, so that no bound passes it."""
    magnitudes = np.abs(np.asarray(values, dtype=float))
    if magnitudes.size == 0 or not np.all(np.isfinite(magnitudes)):
        return float("inf")
    return float(np.max(magnitudes))


def apart(first: np.ndarray, second: np.ndarray) -> float:
    """Largest distance of two sequences of vectors of equal length; infinite where lengths differ.

    A run that ended early has fewer samples than its reference.
    """
    first, second = np.asarray(first), np.asarray(second)
    return largest(first - second) if first.shape == second.shape else float("inf")


def turned_apart(first: np.ndarray, second: np.ndarray) -> float:
    """Largest angle [rad] between two sequences of unit quaternions (K, 4)."""
    if first.shape != second.shape:
        return float("inf")
    gap = np.minimum(np.linalg.norm(first - second, axis=1), np.linalg.norm(first + second, axis=1))
    return 4.0 * float(np.arcsin(np.clip(0.5 * largest(gap), 0.0, 1.0)))
