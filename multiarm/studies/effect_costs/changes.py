"""How far two runs are apart: the largest difference of each quantity, and when.

With an effect a contact may have forces that it has not without it, such as those of friction; what
only one of two runs has is not compared.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from multiarm.dynamics.system import System
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import compare, rotation_apart, undetermined_forces
from multiarm.studies.effect_costs.entries import FORCE, JOINTS, PATH, SLIDES, TURN, Change

_QUANTITY_OF = {
    "object position": PATH,
    "object rotation": TURN,
    "joints": JOINTS,
    "sliding joints": SLIDES,
    "contact forces": FORCE,
}


def changes(system: System, run: Trajectory, other: Trajectory) -> dict[str, Change]:
    """Largest differences of two runs with the same output times, as far as both go.

    Parameters
    ----------
    system : System
        Of the first run; says which contact forces its equations leave open.
    run, other : Trajectory
    """
    found: dict[str, Change] = {}
    if not len(run) or not len(other):
        return found
    first, second = _Shared(run, other), _Shared(other, run)
    with system.borrow() as data:
        # of the floor too, which is not compared
        open_forces = undetermined_forces(data, run)
    lost = {arm: first.own(arm, open_forces[arm]) for arm in run.arm_names if arm in open_forces}
    for name, difference in compare(_seen(first), _seen(second), lost).outputs.items():
        arm, _, noun = name.rpartition(": ")
        quantity = _QUANTITY_OF[noun]
        worse = quantity not in found or difference.worst > found[quantity].value
        if difference.compared and worse:
            found[quantity] = Change(difference.worst, difference.time, arm)
    return found


def last_changes(_system: System, run: Trajectory, other: Trajectory) -> dict[str, Change]:
    """Differences of the object's pose at the end of two runs, whatever they recorded before."""
    time = float(run.time[-1])
    off = np.linalg.norm(run.object_position[-1] - other.object_position[-1])
    turned = rotation_apart(run.object_quaternion_xyzw[-1:], other.object_quaternion_xyzw[-1:])
    return {PATH: Change(float(off), time), TURN: Change(float(turned[0]), time)}


class _Shared:
    """A run, of whose contact forces only those are seen that another run has too."""

    def __init__(self, run: Trajectory, other: Trajectory) -> None:
        self._run, self._columns = run, {}  # type: ignore[var-annotated]
        self.arm_names, self.channels = run.arm_names, dict(run.channels)
        for arm in run.arm_names:
            name = _forces(arm)
            labels, others = (r.channels[name].labels for r in (run, other))
            kept = [k for k, label in enumerate(labels) if label in others]
            self._columns[name] = np.array(kept, dtype=int)
            self.channels[name] = replace(
                self.channels[name], shape=(len(kept),), labels=tuple(labels[k] for k in kept)
            )

    def __len__(self) -> int:
        return len(self._run)

    def read(self, name: str, start: int = 0, stop: int | None = None) -> np.ndarray:
        """Samples start..stop of a channel."""
        values = self._run.read(name, start, stop)
        return values[:, self._columns[name]] if name in self._columns else values

    def own(self, arm: str, values: np.ndarray) -> np.ndarray:
        """Of one value for each contact of an arm, those of the contacts that are seen."""
        return values[self._columns[_forces(arm)]]


def _forces(arm: str) -> str:
    return f"arms/{arm}/contact_force"


def _seen(run: _Shared) -> Any:
    """As what it stands for: a trajectory, as far as :func:`compare` reads one."""
    return run
