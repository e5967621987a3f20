"""Claims about the solver where solvers break: every hard case is within its criteria."""

from __future__ import annotations

import pytest

from multiarm.problems import HARD_CASES


@pytest.mark.parametrize("name", HARD_CASES)
def test_hard_case_is_within_its_criteria(name):
    from multiarm.studies.hard_cases import run_case

    case = run_case(HARD_CASES[name])
    assert case.failures == ()
    assert case.passed
