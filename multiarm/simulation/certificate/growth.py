"""Whether the errors of a run grow exponentially, and how fast.

The motion of closed chains is often unstable or chaotic: two runs that differ by rounding part like
e^(rate t) until they are as far apart as the motion allows. The rate is the slope of the logarithm
of their distance, by the median of the slopes of all pairs of points (Theil and Sen), which single
peaks do not move. What is below the rounding of the coordinates or above the size of things says
nothing and is left out, and so is the beginning, where errors grow as a power of time in any run.
"""

from __future__ import annotations

import numpy as np

FLOOR, SATURATED = 1e-13, 0.03
"""[m, rad] Distances between which growth is seen."""
BEGINNING = 0.2
"""Part of the time that is left out, for it is about the accumulation of errors."""
FEWEST, MOST = 12, 150
"""Points that a rate needs, and that are used."""
NOTABLE = 2.5
"""Natural logarithm of the growth that must be seen before it is spoken of."""
MOST_POWER = 5.0
"""Of time, with which errors grow that add up: those of accelerations twice, and some more."""


def growth_rate(time: np.ndarray, apart: np.ndarray) -> float | None:
    """Exponential growth rate of a distance [1/s]; None when it does not grow so.

    Parameters
    ----------
    time : ndarray, shape (p,)
        [s]
    apart : ndarray, shape (p,)
        Distance of two runs [m, rad].
    """
    if len(time) < FEWEST:
        return None
    seen = (apart > FLOOR) & (apart < SATURATED)
    # what comes after saturation, even if it is small for a moment, is no growth any more
    late = np.flatnonzero(apart >= SATURATED)
    if late.size:
        seen[late[0] :] = False
    if seen.any():
        first, last = time[seen][0], time[seen][-1]
        seen &= time >= first + BEGINNING * (last - first)
    t, y = time[seen], np.log(apart[seen])
    if len(t) < FEWEST:
        return None
    chosen = np.unique(np.linspace(0, len(t) - 1, MOST).astype(int))
    t, y = t[chosen], y[chosen]
    rate, spread = _line(t, y)
    if rate * (t[-1] - t[0]) < NOTABLE or rate * time[-1] < 2 * NOTABLE:
        return None
    # errors that only add up grow as a small power of time: a straight line over its logarithm
    power, spread_of_power = _line(np.log(t), y)
    return float(rate) if spread <= spread_of_power or power > MOST_POWER else None


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Median slope over all pairs of points, and the median distance from that line."""
    i, j = np.triu_indices(len(x), 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
    rest = y - slope * x
    return slope, float(np.median(np.abs(rest - np.median(rest))))
