"""Times of the scene at which joints take hold and let go, as parameters of a run."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.sensitivity import Motions
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SceneError
from multiarm.gradients.phase import Phase
from multiarm.integration.step_control import shortest_step
from multiarm.scene.changes import parse_path, value_at
from multiarm.scene.faults import place
from multiarm.simulation.setup import positive


class SwitchTime:
    """A time of the scene at which a joint takes hold or lets go, as a parameter.

    Attributes
    ----------
    path : str
    size : float
        [s]
    moment : (int, int)
        The timed joint, and which of its moments.

    Raises
    ------
    SceneError
        When the joint switches at the start of the run [s], or at its end.
    """

    def __init__(
        self, system: System, path: str, size: float | None, begin: float, end: float
    ) -> None:
        value, unilateral = value_at(system.scene, path), system.model.unilateral
        _, number, key, *pair = parse_path(path)
        connection = system.scene.joints[int(number)].connection
        names = [] if unilateral is None else [joint.connection for joint in unilateral.timed]
        which = 2 * int(pair[0]) + int(pair[1]) if pair else int(key == "until")
        size = abs(value) or 1.0 if size is None else size
        self.path, self.moment = path, (names.index(connection), which)
        self.size = positive(f"parameters[{path!r}]", size)
        self._states = 2 * system.model.layout.nv
        for at_end, t in enumerate((begin, end)):
            if abs(value - t) <= 2.0 * shortest_step(t):
                why = (
                    "is the end of the run, whose last state is that before the switch; name a "
                    "time before it, or a longer run"
                    if at_end
                    else "is the start of the run, which is assembled with the joints that hold "
                    "there; name a time after it"
                )
                raise SceneError(f"{place(parse_path(path))}: {t:g} s {why}")

    def of_start(self, t: float, state: State | None, phase: Phase) -> np.ndarray:
        """The derivative of the start of a run at a time [s]: none."""
        return np.zeros(self._states)

    def at(
        self, t: float, state: State, motions: Motions, phase: Phase
    ) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of a state's rate, and of the state: none between switches."""
        return np.zeros(2 * state.layout.nv), np.zeros(2 * state.layout.nv)


def is_switch_time(path: str) -> bool:
    """Whether a path is that of a time at which a joint takes hold or lets go."""
    parts = parse_path(path)
    return len(parts) > 2 and parts[0] == "joints" and parts[2] in ("from", "until")
