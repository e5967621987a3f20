"""Other programs on the same scene: which of them can run it, and why the others cannot.

A feedback controller, which is ours and is called back, costs the peer nothing.
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.system import System
from multiarm.errors import ModelError
from multiarm.studies.observables import (
    control_torque,
    inexpressible_effects,
    joint_damping,
    sinusoid,
)
from multiarm.studies.peers import NOT_INSTALLED, Drive, Peer
from multiarm.studies.time_series import Grid, OutOfTime, TimeSeries
from multiarm.studies.work_precision.points import (
    FAILED,
    Measured,
    Point,
    measured_series,
    too_slow,
)
from multiarm.studies.work_precision.settings import Ladder, Setting, peer_ladder

SOLVERS = ("MuJoCo", "MuJoCo as shipped", "Pinocchio", "Drake")


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
        for solver in SOLVERS:
            if strange:
                self.refusals[solver] = f"cannot express {', '.join(strange)}"
                continue
            try:
                self.able[solver] = _make_peer(solver, system, joint_damping(system))
            except ModelError as error:
                self.refusals[solver] = f"cannot express it: {error}"
            except ImportError:
                self.refusals[solver] = NOT_INSTALLED

    def ladders(self, average: float) -> list[Ladder]:
        """The settings of all peers; ``average`` is the reference's average step [s]."""
        return [
            peer_ladder(solver, method, knob, self.grid.interval, average)
            for solver, peer in self.able.items()
            for method, knob in peer.methods.items()
        ]

    def run(self, setting: Setting, limit_s: float) -> Measured:
        """Run a peer's setting; whatever it raises becomes a failed point."""
        series = TimeSeries(limit_s)
        peer = self.able[setting.solver]
        try:
            with np.errstate(all="ignore"):
                peer.follow(
                    series, self.grid, self._start, setting.method, setting.value,
                    self._torques(series),
                )  # fmt: skip
        except OutOfTime:
            return too_slow(setting, limit_s)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}".splitlines()[0]
            return Measured(Point(setting, FAILED, reason))
        return measured_series(self.system, setting, self.grid, series)

    def _torques(self, series: TimeSeries) -> Drive:
        if self._drive is not None:
            return self._drive
        system = self.system
        return series.off_the_clock(lambda t, state: control_torque(system, t, state))


def _make_peer(solver: str, system: System, damping: np.ndarray) -> Peer:
    """The model of one of ``SOLVERS``.

    Raises
    ------
    ModelError
        The program cannot express the system.
    ImportError
        It is not installed.
    """
    if solver == "Pinocchio":
        from multiarm.studies.pinocchio_peer import PinocchioMotion

        return PinocchioMotion(system, damping)
    if solver == "Drake":
        from multiarm.studies.drake_peer import DrakePeer

        return DrakePeer(system, damping)
    from multiarm.studies.mujoco_peer import MujocoModel

    return MujocoModel(system, damping, as_shipped=solver == "MuJoCo as shipped")
