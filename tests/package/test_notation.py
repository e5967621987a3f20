"""Claims about how numbers and counts are written."""

from __future__ import annotations

import numpy as np
import pytest

from multiarm.notation import NOTHING, count_of, number, numbers, short, value_text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0 m"), (-0.0, "0 m"), (5.4e-11, "5.4e-11 m"), (0.9999, "1 m"), (-0.0123, "-0.0123 m"),
     (135.4, "135 m"), (12345.0, "12300 m"), (1000.0, "1000 m"), (1234567.0, "1.23e+06 m"),
     (12345, "12,345 m"), (np.int64(12345), "12,345 m"), (None, NOTHING)],
)  # fmt: skip
def test_a_number_has_three_digits_its_unit_and_no_prefix(value, text):
    assert number(value, "m") == text


def test_roundings_of_zero_beside_larger_numbers_are_zero():
    assert numbers([1e-13, -0.0, -9.81], "m/s^2") == "0, 0, -9.81 m/s^2"
    assert numbers([1e-10, 0.5]) == "0, 0.5"
    assert numbers([1e-5, 49.0]) == "1e-05, 49"
    assert numbers([1e-5, 49.0], rounding=1e-6) == "0, 49"
    assert numbers([1e-3, 2e-3]) == "0.001, 0.002"
    assert numbers([]) == ""


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 joints"), (1, "1 joint"), (2, "2 joints"), (1234, "1,234 joints")]
)
def test_only_one_has_no_s(count, text):
    assert count_of(count, "joint") == text


def test_a_plural_may_be_told():
    assert [count_of(n, "more body", "more bodies") for n in (1, 2)] == [
        "1 more body", "2 more bodies",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ({"left": "pinocchio", "right": "compiled"}, "left: pinocchio, right: compiled"),
        ({}, NOTHING), ([], NOTHING), (None, NOTHING), (True, "yes"), (1234, "1,234"),
        ([0.0, -1e-17, -1.0], "0, 0, -1"), (0.1234567, "0.123457"), ("rk4", "rk4"),
        ({"position": 1e-6, "force": None}, f"position: 1e-06, force: {NOTHING}"),
        (["a", 2], "a, 2"),
    ],
)  # fmt: skip
def test_a_value_of_a_file_is_written_without_the_signs_of_json(value, text):
    assert value_text(value) == text


def test_a_short_number_is_what_one_would_type():
    assert [short(x) for x in (1e-6, 2.5e-3, 0.0, 2.5e-7, 1e5, 20.0)] == [
        "1e-6", "0.0025", "0", "2.5e-7", "1e5", "20",
    ]  # fmt: skip
