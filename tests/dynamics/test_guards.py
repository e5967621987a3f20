"""Claims about guards inside a step: what two ends cannot show."""

from __future__ import annotations

import operator
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from multiarm.contacts.kernel import CONTACT_WIDTH, ContactRow
from multiarm.dynamics.guard_functions import (
    FrictionCone,
    OpenGap,
    SlipOnset,
    SpringCompression,
    SpringExtension,
    Touch,
    friction_cone,
    slip_onset,
    spring_compression,
    spring_extension,
    touch,
)
from multiarm.dynamics.guards import (
    DIPPED,
    FIRED,
    QUIET,
    Guard,
    count_events,
    dips,
    follow_scales,
    judge_guards,
    make_guards,
    remember_scales,
)
from multiarm.jit.rows import fields_of

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


def rows_with(gap: float, rate: float, second: float = 0.0) -> SimpleNamespace:
    """Kinematics of rows: a gap and its rate, and the rate of the row after it."""
    kinematics = np.zeros((2, CONTACT_WIDTH))
    contacts = fields_of(ContactRow, kinematics)
    contacts.gap[0], contacts.gap_rate[:] = gap, (rate, second)
    return SimpleNamespace(kinematics=kinematics)


@given(gaps, speeds.map(operator.neg), gaps, speeds, st.floats(1e-3, 1e-1))
def test_a_damped_spring_is_pressed_between_the_ends_of_a_step_where_its_gap_comes_near_zero(
    begin, begin_rate, end, end_rate, h
):
    """While the gap grows the damper makes the spring longer than it, which must not hide a dip."""
    spring = Guard(SpringExtension(row=0, lag=0.05))
    guards = make_guards([spring])
    at_begin = spring_extension.py_func(spring.function, rows_with(begin, begin_rate))
    at_end = spring_extension.py_func(spring.function, rows_with(end, end_rate))
    assert at_begin[0] == begin and at_end[0] == end + 0.05 * end_rate
    guards.before[0], _, guards.rate_before[0] = at_begin
    guards.value[0], guards.course[0], guards.rate[0] = at_end
    guards.armed[0] = 1
    judge_guards(guards, h)
    events = count_events(guards)
    assert events == dips(begin, begin_rate, end, end_rate, h)
    assert guards.result[0] == (DIPPED if events else QUIET)


def test_a_guard_that_reports_fires_beyond_its_threshold_and_one_that_stops_at_zero():
    guards = make_guards([Guard(OpenGap(0), 1e-3, stops=stops) for stops in (True, False)])
    guards.level[:], guards.armed[:] = guards.threshold, 1
    guards.value[:] = -1e-4
    judge_guards(guards, 0.1)
    assert guards.result.tolist() == [FIRED, QUIET]
    guards.value[:] = -2e-3
    judge_guards(guards, 0.1)
    assert guards.result.tolist() == [FIRED, FIRED]


def test_what_guards_watch_is_positive_inside_of_its_range_and_zero_at_its_end():
    assert touch.py_func(Touch(0, 1e-9), rows_with(1e-9, 0.0)) == 0.0
    assert touch.py_func(Touch(0, 1e-9), rows_with(-1e-9, 0.0)) == 0.0
    assert touch.py_func(Touch(0, 1e-9), rows_with(-5e-10, 0.0)) > 0.0
    assert slip_onset.py_func(SlipOnset(0, 0.5), rows_with(0.0, 0.3, 0.4)) == 0.0
    assert slip_onset.py_func(SlipOnset(0, 0.5), rows_with(0.0, -0.3, 0.2)) > 0.0
    # a spring that is pressed by a millimetre and leaves at 0.1 m/s pushes until lag * 0.1 = 1 mm
    assert spring_compression.py_func(SpringCompression(0, 0.01), rows_with(-1e-3, 0.1)) == 0.0
    assert spring_compression.py_func(SpringCompression(0, 0.0), rows_with(-1e-3, 0.1)) == 1e-3


def test_a_friction_cone_has_the_tangents_that_are_held_and_the_sign_of_a_pull():
    force, cone, pull = np.array([10.0, 3.0, -4.0]), FrictionCone(4, 0.5, 5, 6), -0.5
    for (first, second), margin in {(1, 2): 0.0, (1, -1): 2.0, (-1, 2): 1.0}.items():
        held = np.array([-1, -1, -1, -1, 0, first, second])
        assert friction_cone.py_func(cone, held, force) == margin
        assert friction_cone.py_func(cone._replace(mu=pull), held, -force) == margin


@pytest.mark.parametrize("mass", [1e-9, 1.0, 1e9])
def test_scales_of_thresholds_grow_with_the_forces_and_do_not_know_the_unit_of_mass(mass):
    data = SimpleNamespace(
        bodies=SimpleNamespace(object_inertia=mass * np.eye(6)),
        forces=SimpleNamespace(f_o=np.zeros(6), f_j=np.array([-70.0 * mass])),
        rows=SimpleNamespace(force=np.array([3.0, -50.0]) * mass),
    )
    guards = make_guards([])
    scales, now, expected = guards.scales, guards.scales_now, [1.0, 50.0 * mass, 70.0 * mass]
    follow_scales.py_func(scales, now, data)
    np.testing.assert_allclose(now, expected)
    remember_scales(guards)
    data.rows.force[:], data.forces.f_j[:] = 0.0, 0.0  # all forces may vanish for an instant
    follow_scales.py_func(scales, now, data)
    np.testing.assert_allclose(now, expected)
    data.rows.force[0] = np.nan
    follow_scales.py_func(scales, now, data)
    np.testing.assert_allclose(now, expected)
    data.rows.force[0] = 5e9 * mass  # of a mode that is only tried, or of a step that is not taken
    follow_scales.py_func(scales, now, data)
    np.testing.assert_allclose(now[1:], 5e9 * mass)
    data.rows.force[0] = 1.0 * mass
    follow_scales.py_func(scales, now, data)
    np.testing.assert_allclose(now, expected)
