"""Claims about guards inside a step: what two ends cannot show."""

from __future__ import annotations

import operator

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from multiarm.dynamics.guards import dips

NEAR = 0.05  # part of the smaller gap at the ends that counts as touching, as in `dips`
ROUNDING = 1e-12  # of the cubic's terms

gaps = st.floats(1e-4, 1e-2)  # [m]
speeds = st.floats(1e-3, 2.0)  # [m/s]


@given(gaps, speeds.map(operator.neg), gaps, speeds, st.floats(1e-3, 1e-1))
def test_a_gap_dips_where_the_cubic_through_both_ends_comes_near_zero_in_between(
    begin, begin_rate, end, end_rate, h
):
    """It is asked of gaps that close at the beginning of a step and open at its end."""
    cubic = CubicHermiteSpline([0.0, h], [begin, end], [begin_rate, end_rate])
    stationary = cubic.derivative().roots(extrapolate=False)
    bottoms = [t for t in stationary if 0.0 < t < h and cubic(t, 2) > 0.0]
    lowest = min(cubic(bottoms), default=np.inf)
    level = NEAR * min(begin, end)
    assume(abs(lowest - level) > ROUNDING * (begin + end + h * (abs(begin_rate) + abs(end_rate))))
    assert dips(begin, begin_rate, end, end_rate, h) == (lowest < level)


def test_a_gap_whose_rate_is_unknown_does_not_dip():
    assert not dips(1e-3, np.nan, 1e-3, 1.0, 0.1)
