"""Other programs on the same scene: which of them can run it, and why the others cannot.

Each peer has its best settings: models are built and torques tabulated outside the measured time,
no Python is in a loop that can do without, and a feedback controller, which is ours and is called
back, costs the peer nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.studies.observables import (
    Sinusoid,
    control_torque,
    inexpressible_effects,
    joint_damping,
    sinusoid,
)
from multiarm.studies.peer_trials import NOT_INSTALLED
from multiarm.studies.time_series import Grid, OutOfTime, TimeSeries
from multiarm.studies.work_precision.points import (
    FAILED,
    Measured,
    Point,
    measured_series,
    too_slow,
)
from multiarm.studies.work_precision.settings import Ladder, Setting, peer_ladder

Follow = Callable[[TimeSeries, State, str, float, Any], None]
"""Runs a series from a state by a method and its step or tolerance, driven by torques."""


@dataclass(frozen=True)
class Peer:
    """A program that can run this scene.

    Attributes
    ----------
    solver : str
    methods : dict
        Integrator -> what sets its accuracy, ``step`` or ``tolerance``.
    follow : callable
    """

    solver: str
    methods: dict[str, str]
    follow: Follow


class Peers:
    """The programs that can run a scene, and why the others cannot.

    Attributes
    ----------
    able : dict of str to Peer
    refusals : dict of str to str
        Program -> the reason.
    """

    def __init__(self, system: System):
        self.system, self.grid = system, Grid.of(system.scene.run)
        self.able: dict[str, Peer] = {}
        self.refusals: dict[str, str] = {}
        self._start = system.initial_state()
        self._drive = sinusoid(system)
        strange = inexpressible_effects(system)
        for solver, make in _MAKERS.items():
            if strange:
                self.refusals[solver] = f"cannot express {', '.join(strange)}"
                continue
            try:
                methods, follow = make(system, joint_damping(system), self.grid)
            except ModelError as error:
                self.refusals[solver] = f"cannot express it: {error}"
            except ImportError:
                self.refusals[solver] = NOT_INSTALLED
            else:
                self.able[solver] = Peer(solver, methods, follow)

    def ladders(self, average: float) -> list[Ladder]:
        """The settings of all peers; ``average`` is the reference's average step [s]."""
        return [
            peer_ladder(peer.solver, method, knob, self.grid.interval, average)
            for peer in self.able.values()
            for method, knob in peer.methods.items()
        ]

    def run(self, setting: Setting, limit_s: float) -> Measured:
        """Run a peer's setting; whatever it raises becomes a failed point."""
        series = TimeSeries(limit_s)
        peer = self.able[setting.solver]
        try:
            with np.errstate(all="ignore"):
                peer.follow(
                    series, self._start, setting.method, setting.value, self._torques(series)
                )
        except OutOfTime:
            return too_slow(setting, limit_s)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            return Measured(Point(setting, FAILED, reason))
        return measured_series(self.system, setting, self.grid, series)

    def _torques(self, series: TimeSeries) -> Sinusoid | Callable[[float, State], np.ndarray]:
        if self._drive is not None:
            return self._drive
        system = self.system
        return series.off_the_clock(lambda t, state: control_torque(system, t, state))


def _mujoco(as_shipped: bool):
    def make(system: System, damping: np.ndarray, grid: Grid):
        from multiarm.studies.mujoco_peer import INTEGRATORS, MujocoModel

        model = MujocoModel(system, damping, as_shipped)

        def follow(series, start, method, value, drive):
            model.follow(series, grid, start, method, value, drive)

        return dict.fromkeys(INTEGRATORS, "step"), follow

    return make


def _pinocchio(system: System, damping: np.ndarray, grid: Grid):
    from multiarm.studies.pinocchio_motion import METHODS, PinocchioMotion

    model = PinocchioMotion(system, damping)

    def follow(series, start, method, value, drive):
        model.follow(series, grid, start, method, value, drive)

    return METHODS, follow


def _drake(system: System, damping: np.ndarray, grid: Grid):
    from multiarm.studies.drake_peer import METHODS, DrakeModel

    DrakeModel(system, damping, grid.interval, Sinusoid.none(damping.size))  # refuses now, or never

    def follow(series, start, method, value, drive):
        DrakeModel(system, damping, value, drive).follow(series, grid, start)

    return METHODS, follow


_MAKERS = {
    "MuJoCo": _mujoco(as_shipped=False),
    "MuJoCo as shipped": _mujoco(as_shipped=True),
    "Pinocchio": _pinocchio,
    "Drake": _drake,
}
SOLVERS = tuple(_MAKERS)
