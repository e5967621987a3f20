"""Claims about how the benchmarks measure time."""

from __future__ import annotations

import math

import numpy as np
import pytest
import timing
from timing import calls_a_burst, fastest, fitted_slope, measure, median, upper_half


def test_everyone_is_measured_in_turn(monkeypatch):
    monkeypatch.setattr(timing, "PATIENCE", math.inf)
    order_of_bursts = []

    def contestant(name):
        return lambda count: order_of_bursts.append(name)

    times = measure({name: contestant(name) for name in "ab"}, 3)
    assert {name: len(seconds) for name, seconds in times.items()} == {"a": 3, "b": 3}
    assert order_of_bursts[-6:] == [*"ababab"]  # those before say how many calls make a burst


def test_who_takes_long_gets_few_bursts(monkeypatch):
    monkeypatch.setattr(timing, "PATIENCE", -1.0)
    found = measure({"a": lambda count: None}, 50)
    assert len(found["a"]) == timing.FEWEST


def test_what_it_takes_to_enter_a_loop_is_no_part_of_a_call(monkeypatch):
    clock = [0.0]

    def burst(count):
        clock[0] += 3e-5 + 1e-6 * count

    monkeypatch.setattr(timing.time, "thread_time", lambda: clock[0])
    assert calls_a_burst(burst) == pytest.approx(1e6 * timing.BURST, rel=0.05)
    assert fastest(measure({"a": burst}, 5))["a"] == pytest.approx(1.0, rel=0.05)


def test_fastest_and_median_are_microseconds_a_call():
    times = {"a": np.array([3e-6, 1e-6, 2.5e-6])}
    assert fastest(times)["a"] == pytest.approx(1.0)
    assert median(times)["a"] == pytest.approx(2.5)


def test_slopes_are_exponents_and_skip_what_was_not_measured():
    sizes = [2, 4, 8, 16]
    assert fitted_slope(sizes, [7.0 * n**1.5 for n in sizes]) == pytest.approx(1.5)
    assert fitted_slope(sizes, [1.0, 2.0, 4.0, None]) == pytest.approx(1.0)
    assert fitted_slope([2], [1.0]) is None
    assert [2, 4, 8, 16, 32, 64][upper_half(range(6))] == [16, 32, 64]
    assert [2, 3, 5][upper_half(range(3))] == [3, 5]
    assert [2][upper_half(range(1))] == [2]
