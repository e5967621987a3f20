"""Settings, the ladders that a study climbs, and points: one run by one setting, measured."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError
from multiarm.results.trajectory import plain
from multiarm.studies.peers import Grid, Peer, TimeSeries, control_torque, largest_gap, sinusoid
from multiarm.studies.records import error_text
from multiarm.studies.timing import OutOfTime
from multiarm.studies.work_precision.reference import Motion, limited, motion_error
from multiarm.tableaus import (
    ADAPTIVE_INTEGRATORS,
    FIXED_STEP_INTEGRATORS,
    METHODS,
    VARIATIONAL,
)

COMPLETED, FAILED, TOO_SLOW = "completed", "failed", "too slow"
OURS = "multiarm"
BY_ACCURACY = "accuracy"
"""The method of settings that name an accuracy only: the program chooses the rest."""
STABILIZATIONS = ("projection", "feedback", "none")
DECADES_OF_ACCURACY = range(1, 13)
DECADES_OF_TOLERANCE = range(2, 14)
HALVINGS = 24
"""Most halvings of a step; time limit and rounding errors end a ladder long before."""
COARSEST = 8.0
"""The first fixed step, at most, in units of the reference's average step."""
UNITS = {"step": "s", "tolerance": "", "accuracy": ""}


@dataclass(frozen=True)
class Setting:
    """How a run is done.

    Attributes
    ----------
    solver : str
        The program: ``multiarm``, or a peer with what matters of its options.
    method : str
        Integrator; ``accuracy`` where the program chooses it.
    stabilization : str
        Empty where there is none to choose.
    knob : {"step", "tolerance", "accuracy"}
        What is varied.
    value : float
        [s] for a step.
    """

    solver: str
    method: str
    stabilization: str
    knob: str
    value: float

    @property
    def ours(self) -> bool:
        """Whether it is a setting of this program."""
        return self.solver == OURS

    @property
    def series(self) -> str:
        """The method in words: what all settings of a ladder have in common."""
        if not self.ours:
            return f"{self.solver}, {self.method}"
        if self.method == BY_ACCURACY:
            return "chosen by accuracy"
        return f"{self.method}, {self.stabilization}" if self.stabilization else self.method

    @property
    def knob_text(self) -> str:
        """``step 0.0025 s``"""
        return f"{self.knob} {short(self.value)} {UNITS[self.knob]}".rstrip()

    @property
    def text(self) -> str:
        """The setting in words."""
        return f"{self.series}, {self.knob_text}"

    @property
    def key(self) -> str:
        """The setting as one word, different for different settings."""
        parts = (self.solver, self.method, self.stabilization, f"{self.knob}={self.value:.12g}")
        return "/".join(parts)

    @property
    def options(self) -> dict[str, Any]:
        """The setting as options of ``simulate``."""
        options: dict[str, Any] = {self.knob: self.value}
        if self.method != BY_ACCURACY:
            options["integrator"] = self.method
        return {**options, "stabilization": self.stabilization or "projection"}


Ladder = tuple[Setting, ...]
"""Settings of one method, from coarse to fine."""


def our_ladders(output_step: float, duration: float, average: float) -> list[Ladder]:
    """All methods of this program, with each stabilisation that goes with them.

    Parameters
    ----------
    output_step, duration : float
        [s]
    average : float
        Average step of the reference [s], from which the fixed steps follow.
    """
    ladders = [_ladder(OURS, BY_ACCURACY, "", "accuracy", _powers(DECADES_OF_ACCURACY))]
    tolerances = _powers(DECADES_OF_TOLERANCE)
    steps = halved_steps(output_step, min(COARSEST * average, duration / 4.0))
    for names, knob, values in (
        (ADAPTIVE_INTEGRATORS, "tolerance", tolerances),
        (FIXED_STEP_INTEGRATORS, "step", steps),
    ):
        for name in names:
            # a variational method keeps the joints closed itself
            for kind in ("",) if METHODS[name].kind == VARIATIONAL else STABILIZATIONS:
                ladders.append(_ladder(OURS, name, kind, knob, values))
    return ladders


def peer_ladders(peers: Mapping[str, Peer], interval: float, average: float) -> list[Ladder]:
    """The settings of all methods of peers by name; steps divide the time between two outputs.

    ``average`` is the reference's average step [s].
    """
    steps = halved_steps(interval, min(COARSEST * average, interval))
    values = {"step": steps, "tolerance": _powers(DECADES_OF_TOLERANCE)}
    return [
        _ladder(name, method, "", knob, values[knob])
        for name, peer in peers.items()
        for method, knob in peer.methods.items()
    ]


def halved_steps(output_step: float, coarsest: float) -> tuple[float, ...]:
    """The output step, doubled or halved to at most ``coarsest``, and then halved again and again.

    Every step that is not longer than the output step divides it.
    """
    first = math.floor(math.log2(coarsest / output_step) + 1e-9)
    return tuple(math.ldexp(output_step, first - k) for k in range(HALVINGS))


def short(value: float) -> str:
    """A number as one would type it: ``1e-6``, ``0.0025``."""
    if value and (abs(value) < 1e-3 or abs(value) >= 1e5):
        mantissa, exponent = f"{value:.6e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.7g}"


def _powers(decades: range) -> tuple[float, ...]:
    return tuple(float(f"1e-{k}") for k in decades)


def _ladder(solver: str, method: str, kind: str, knob: str, values: tuple[float, ...]) -> Ladder:
    return tuple(Setting(solver, method, kind, knob, value) for value in values)


# --- points ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """One setting, measured; None where there is no number.

    Attributes
    ----------
    setting : Setting
    status : {"completed", "failed", "too slow"}
    message : str
        Why there is no result.
    wall_time_s : float or None
        Of the fastest of ``repeats`` runs, from the first step to the last output.
    repeats : int
    steps, evaluations : int or None
    errors : mapping
        position [m], rotation [rad], joints [rad, m], force [N]: the worst at an output time.
    gap_m : float or None
        Largest gap of a contact at an output time (position drift).
    gap_rate_m_per_s : float or None
        Its rate (velocity drift).
    energy_J : float or None
        Largest error of the energy balance.
    used : str
        The integrator, where the program chose it.
    """

    setting: Setting
    status: str
    message: str = ""
    wall_time_s: float | None = None
    repeats: int = 1
    steps: int | None = None
    evaluations: int | None = None
    errors: Mapping[str, float | None] = field(default_factory=dict)
    gap_m: float | None = None
    gap_rate_m_per_s: float | None = None
    energy_J: float | None = None
    used: str = ""

    @property
    def completed(self) -> bool:
        """Whether there is a result."""
        return self.status == COMPLETED

    def error(self, quantity: str) -> float | None:
        """The error of a quantity (``reference.QUANTITIES``)."""
        return motion_error(self.errors) if quantity == "motion" else self.errors.get(quantity)

    def again(self, wall_time_s: float | None) -> Point:
        """The point after one more run; the fastest one counts."""
        if wall_time_s is None or self.wall_time_s is None:
            return replace(self, repeats=self.repeats + 1)
        fastest = min(self.wall_time_s, wall_time_s)
        return replace(self, repeats=self.repeats + 1, wall_time_s=fastest)

    def as_dict(self) -> dict[str, Any]:
        """The point in what JSON knows."""
        return plain(asdict(self))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Point:
        """The point that :meth:`as_dict` wrote."""
        return cls(**{**data, "setting": Setting(**data["setting"])})


@dataclass(frozen=True)
class Measured:
    """A run: its point, whose errors are found when it is compared, and its motion if it has one.

    Attributes
    ----------
    point : Point
    motion : Motion or None
    """

    point: Point
    motion: Motion | None = None

    def against(self, exact: Motion) -> Point:
        """The point with its errors."""
        if self.motion is None:
            return self.point
        return replace(self.point, errors=self.motion.errors(exact))


def run_ours(system: System, setting: Setting, limit_s: float) -> Measured:
    """Run one of our settings."""
    try:
        run = limited(system, limit_s, **setting.options)
    except OutOfTime:
        return too_slow(setting, limit_s)
    except MultiarmError as error:
        return Measured(Point(setting, FAILED, str(error)))
    if run.status != "completed":
        return Measured(Point(setting, FAILED, run.message))
    counted = run.statistics
    point = Point(
        setting,
        COMPLETED,
        wall_time_s=counted["wall_time_s"],
        steps=counted["steps"],
        evaluations=counted["evaluations"],
        gap_m=float(np.max(run.position_drift)),
        gap_rate_m_per_s=float(np.max(run.velocity_drift)),
        energy_J=float(np.max(np.abs(run.energy_balance))),
        used=counted["integrator"],
    )
    return Measured(point, Motion.of(run))


def run_peer(system: System, peer: Peer, setting: Setting, limit_s: float) -> Measured:
    """Run a peer's setting; whatever it raises becomes a failed point.

    A feedback controller, which is ours and is called back, costs the peer nothing.
    """
    series = TimeSeries(Grid.of(system.scene.run), limit_s)
    drive = sinusoid(system) or series.off_the_clock(partial(control_torque, system))
    try:
        with np.errstate(all="ignore"):
            peer.follow(series, system.initial_state(), setting.method, setting.value, drive)
    except OutOfTime:
        return too_slow(setting, limit_s)
    except Exception as error:
        return Measured(Point(setting, FAILED, error_text(error).splitlines()[0]))
    if len(series.states) <= series.grid.intervals:
        reason = f"the state is no longer finite after {series.reached:.3g} s"
        return Measured(Point(setting, FAILED, reason))
    point = Point(
        setting,
        COMPLETED,
        wall_time_s=series.wall_time_s,
        steps=series.steps,
        evaluations=series.evaluations,
        gap_m=max(largest_gap(system, state) for state in series.states),
    )
    return Measured(point, Motion(np.array([state.position for state in series.states])))


def too_slow(setting: Setting, limit_s: float) -> Measured:
    """A run that was ended by its time limit."""
    return Measured(Point(setting, TOO_SLOW, f"not done after {limit_s:.2g} s"))
