"""Points of a work-precision diagram: one run by one setting, what it cost and how wrong it was."""

from __future__ import annotations

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
from multiarm.studies.work_precision.settings import Setting

COMPLETED, FAILED, TOO_SLOW = "completed", "failed", "too slow"


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
