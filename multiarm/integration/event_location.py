"""Where in a step events are: roots of guards as functions of time on the step's dense output.

A guard of a mode stops the run at its first root; one that only reports may have several.  They are
bracketed on a grid, to which the lowest point is added where a guard may have dipped below zero in
between, and refined by Brent's method.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.coordinates import load_chart
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.guards import FIRED, QUIET, Guards
from multiarm.dynamics.status import OK
from multiarm.integration.dense_output import interpolate
from multiarm.integration.step import open_step
from multiarm.integration.step_control import CLOSE_IN_STEP
from multiarm.jit.kernels import INTS, NUMBER, NUMBERS, Kernel, kernel

# Fractions of the step at which guards are evaluated before roots are refined.
GRID = np.linspace(0.0, 1.0, 9)
# Fractions of a step by which a root and the lowest point of a dip may be off.
ROOT_ERROR, DIP_ERROR = 1e-14, 1e-6


@kernel
def evaluate_in_step(struct: INTS, arrays: INTS, t: NUMBER, h: NUMBER, theta: NUMBER):
    """Evaluate the system with this struct at the fraction ``theta`` of a step; returns a status.

    The gains of the drift feedback are those of the step, so that a force is the one that fired.
    """
    method, step = open_step(arrays)
    _, data, _ = open_system(struct)
    interpolate(method, step, theta, step.z_stage)
    load_chart(step.z_stage, step.base_old, data)
    data.time.now = min(t + theta * h, step.stage.latest)
    return evaluate_state(struct, step.stage.alpha, step.stage.beta)


@kernel
def load_step(struct: INTS, z: NUMBERS, base: NUMBERS):
    """:func:`load_chart` into the system with this struct, for Python."""
    load_chart(z, base, open_data(struct))


class GuardValues:
    """Values of all guards as a function of the fraction of a step.

    Parameters
    ----------
    struct, arrays : ndarray
        Of the system and of its step.
    write : Kernel
        ``write(struct)`` writes the values of the guards at the state evaluated last, and returns a
        status.
    guards : Guards
    begin, end : float
        Of the step [s].
    """

    def __init__(
        self,
        struct: np.ndarray,
        arrays: np.ndarray,
        write: Kernel,
        guards: Guards,
        begin: float,
        end: float,
    ):
        self._struct, self._step = struct, (arrays, begin, end - begin)
        self._write, self._guards = write, guards
        # which way round the guards are now, whatever turns them later
        self._signs = guards.sign.copy()
        self._known: dict[float, np.ndarray] = {}

    def __call__(self, theta: float) -> np.ndarray:
        """Values of all guards; NaN where the state cannot be evaluated."""
        if theta not in self._known:
            status = evaluate_in_step(self._struct, *self._step, theta)
            if status == OK:
                status = self._write(self._struct)
            values = self._guards.value * (self._guards.sign * self._signs)
            self._known[theta] = values if status == OK else np.full_like(values, np.nan)
        return self._known[theta]


def first_event(
    values: Callable[[float], np.ndarray], results: np.ndarray, levels: np.ndarray
) -> tuple[float, list[int]]:
    """Fraction of the step at which the first guard changes its sign, and all that do so there.

    Parameters
    ----------
    values : callable
        All guards as a function of the fraction.
    results : ndarray of int
        Result of each guard for the step, see :mod:`multiarm.dynamics.guards`.
    levels : ndarray
        Smaller values are zero: a guard may begin there, and grow before it falls.

    Returns
    -------
    theta : float
        1 when there is none, and where one has fired that the dense output keeps positive.
    guards : list of int
    """
    roots: dict[int, float] = {}
    for g in map(int, np.flatnonzero(results != QUIET)):
        level = float(levels[g])
        course = _Course(values, g, level, 0.0)
        root = course.fall(0, 1, level, 0.0, level)
        if root is None and results[g] == FIRED:
            root = 1.0  # it is past the end of the dense output, which is not projected
        if root is not None:
            roots[g] = root
    if not roots:
        return 1.0, []
    theta = min(roots.values())
    return theta, [g for g, root in roots.items() if root <= theta + CLOSE_IN_STEP]


def sign_changes(
    values: Callable[[float], np.ndarray], g: int, fired: bool, level: float
) -> list[float]:
    """Fractions of a step at which a guard changes its sign, by more than a level.

    ``fired``: it ends below zero.  Then their number is odd, else even: the projection at the end
    of a step can move a root past it, to the end.
    """
    course = _Course(values, g, 0.0, -level)
    roots: list[float] = []
    first, sign = 0, 1
    while first < len(course.thetas):
        root = course.fall(first, sign, 0.0, -level, level)
        if root is None:
            break
        roots.append(root)
        first, sign = int(np.searchsorted(course.thetas, root, side="right")), -sign
    if (len(roots) % 2 == 1) != fired:
        roots.append(1.0)
    return roots


class _Course:
    """One guard on the grid, and its lowest point where it does not fall to ``below`` there."""

    def __init__(self, values: Callable[[float], np.ndarray], g: int, above: float, below: float):
        self._values, self._g = values, g
        self.thetas = GRID
        self.samples = np.array([values(theta)[g] for theta in GRID])
        high = np.flatnonzero(self.samples > above)
        if high.size and not np.any(self.samples[high[0] :] < below):
            self._add_lowest(int(high[0]))

    def fall(self, first: int, sign: int, above: float, below: float, end: float) -> float | None:
        """First root at which ``sign`` times the guard falls, among samples from ``first`` on.

        From a sample ``above`` a value to one ``below`` another.  The first of these samples where
        none is above, and the last one is below minus ``end``.
        """
        from scipy.optimize import brentq

        thetas, samples = self.thetas[first:], sign * self.samples[first:]
        high = np.flatnonzero(samples > above)
        if not high.size:
            return float(thetas[0]) if samples[-1] < -end else None
        low = np.flatnonzero(samples[high[0] :] < below) + high[0]
        if not low.size:
            return None
        before = high[high < low[0]][-1]
        reached = float(samples[low[0]])

        def value(theta: float) -> float:
            x = sign * float(self._values(theta)[self._g])
            return x if x == x else reached  # where there is no value, the guard does not hold

        return float(brentq(value, thetas[before], thetas[low[0]], xtol=ROOT_ERROR))

    def _add_lowest(self, first: int) -> None:
        """Add the lowest point from a sample on."""
        from scipy.optimize import minimize_scalar

        lowest = first + int(np.nanargmin(self.samples[first:]))
        left, right = GRID[max(lowest - 1, 0)], GRID[min(lowest + 1, len(GRID) - 1)]
        best = minimize_scalar(
            lambda theta: float(self._values(theta)[self._g]),
            bounds=(left, right),
            method="bounded",
            options={"xatol": DIP_ERROR},
        )
        place = int(np.searchsorted(self.thetas, best.x))
        self.thetas = np.insert(self.thetas, place, best.x)
        self.samples = np.insert(self.samples, place, best.fun)
