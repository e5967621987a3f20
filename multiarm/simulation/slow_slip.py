r"""Slow slip: which slips are at rest at an event, and the first step of those that begin.

Errors of the integration are as large as slow slips are.

*A slip that ends.*  Contacts of one body that come to rest together do so at times that differ by
these errors.  Where one of them ends, all that slow down and are within some tolerances of rest are
at rest: an impulse takes the velocity nearest to the present one, in the metric of the inertia, in
which they do not slip.  It takes energy, of second order in the tolerance.

*A slip that begins* at an impact with less than the tolerance is at rest, too: the accelerations
decide whether it goes on, and where to.

*Its direction* turns at the rate :math:`\mu a_n / |s|`.  The first step is one in which the slip
grows by as much as it is, but at least by the speed below which its direction is smoothed
(:mod:`multiarm.dynamics.sliding`); the next ones grow with it by the step control.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.equations import update_kinematics, update_rows
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.status import OK
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.events.row_dynamics import RowDynamics
from multiarm.integration.projection import project_velocities
from multiarm.simulation.setup import Tolerance

# Slips that end are at rest up to so many tolerances; faster ones have only turned around.
ENDING = 10.0
# Speeds that are left at rest are as small as the step's errors, times this factor.
LEFT = 4.0
# Speeds of slip below which its direction is smoothed in steps of adaptive methods: the tolerance,
# between these [m/s].  Smaller ones take more steps, larger ones let contacts creep.
SLOWEST, SLOW = 1e-9, 1e-7
# Shortest first step [s].
SHORTEST = 1e-12


def smoothing_speed(tolerance: Tolerance | None, step: float | None) -> float:
    """Speed of slip below which its direction is smoothed [m/s]."""
    if tolerance is not None:
        return max(min(tolerance.position, SLOW), SLOWEST)
    assert step is not None, "steps are either fixed or chosen"
    return max(10.0 * step, SLOWEST)  # the slip that 10 m/s^2 make in one step


class SlowSlips:
    """The slow slips of a run, at the state in the data of its modes.

    Parameters
    ----------
    modes : Modes
    tolerance : Tolerance or None
        None: the step is fixed, and errors are unknown.
    """

    def __init__(self, modes: Modes, tolerance: Tolerance | None) -> None:
        self._modes, self._tolerance = modes, tolerance
        self._constraints = modes.unilateral.constraints

    def end(self, slowest: set[int]) -> dict[int, float]:
        """Put slips to rest where some constraints' have become the ``slowest`` in their direction.

        Returns
        -------
        dict
            By constraint at rest: speeds up to which it is at rest [m/s, rad/s].
        """
        if not slowest:
            return {}
        if self._tolerance is None:
            return {u: LEFT * self._speed(u) for u in slowest}
        bound = ENDING * max(self._tolerance.smallest, SLOWEST)
        rates = self._modes.full.contact_rows.gap_rate
        slowing = {u for u, a in self._accelerations().items() if a @ rates[self._rows(u)] < 0.0}
        return self._stop(
            self._modes.mode, [u for u in slowest | slowing if self._speed(u) <= bound]
        )

    def end_new(self, mode: Mode) -> dict[int, float]:
        """Put slips to rest that an impact lets begin slowly in the next mode; as :meth:`end`."""
        if self._tolerance is None:
            return {}
        sliding = set(mode.sliding(self._constraints))
        sliding.difference_update(self._modes.mode.sliding(self._constraints))
        if not sliding:
            return {}
        rows = RowDynamics(self._modes)
        rows.update()
        rest, bound = rows.rest_rate, self._tolerance.smallest
        return self._stop(mode, [u for u in sliding if rest < self._speed(u) <= bound])

    def first_step(self) -> float:
        """Longest first step of the mode that has been entered and evaluated [s]."""
        require_ok(self._modes.full, update_rows(self._modes.full.struct))
        steps = [
            max(self._speed(u), self._modes.slow) / size
            for u, size in ((u, np.linalg.norm(a)) for u, a in self._accelerations().items())
            if size > 0.0
        ]
        return max(SHORTEST, min(steps, default=np.inf))

    def _stop(self, mode: Mode, slips: Iterable[int]) -> dict[int, float]:
        """Put slips to rest, with the rows of a mode held; speeds that are left, and errors."""
        speeds, rest = {u: self._speed(u) for u in slips}, RowDynamics(self._modes).rest_rate
        stopped = {row for u, speed in speeds.items() if speed > rest for row in self._rows(u)}
        if not stopped:
            return {u: LEFT * speed for u, speed in speeds.items()}
        entered, data = self._modes.mode, self._modes.data
        self._modes.enter(replace(mode, rows=tuple(sorted(stopped.union(mode.rows)))))
        status = update_kinematics(data.struct)
        if status != OK or project_velocities(data.struct) != OK:
            data.reraise()  # else they are left as they are
        if entered.holding == self._modes.holding:  # else it has ended in any case
            self._modes.enter(entered)
        RowDynamics(self._modes).update()
        return {u: LEFT * self._speed(u) for u in slips}

    def _accelerations(self) -> dict[int, np.ndarray]:
        """Accelerations of the slips of the mode, as evaluated last [m/s^2]."""
        sliding, full = self._modes.mode.sliding(self._constraints), self._modes.full
        if not sliding:
            return {}
        W, a = force_directions(full), self._modes.data.arrays.accelerations.a
        bias = full.contact_rows.gap_bias
        return {u: a @ W[:, rows] + bias[rows] for u, rows in ((u, self._rows(u)) for u in sliding)}

    def _rows(self, u: int) -> list[int]:
        """The rows whose rates are the slip of a constraint, or the speed of a dry joint."""
        constraint = self._constraints[u]
        return list(constraint.tangents or (constraint.row,))

    def _speed(self, u: int) -> float:
        return float(np.linalg.norm(self._modes.full.contact_rows.gap_rate[self._rows(u)]))
