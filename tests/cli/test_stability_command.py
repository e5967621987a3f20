"""Claims about the hard-case suite: which cases pass, and how that is reported."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from commands import command, finite_json, promised_keys
from mechanics import ur5_pair
from page_reader import Page

import multiarm as ma
from multiarm import problems
from multiarm.cli import stability as stability_command
from multiarm.problems import Criterion, HardCase
from multiarm.studies.hard_cases import CaseResult, run_case, run_suite
from multiarm.studies.hard_cases_page import render

stability = command("stability", 80)
RUN = {"duration": 0.2, "accuracy": 1e-8}


def most_drift(run, system) -> float:
    return float(np.max(run.position_drift))


def not_completed(run, system) -> float:
    return float(run.status != "completed")


CLOSED = Criterion("position drift", 1e-10, "m", most_drift)
COMPLETED = Criterion("run ended early", 0.0, "1", not_completed)


def pair(left: str, right: str, **more):
    """A scene of two UR5s that fall with a box."""
    return lambda: ur5_pair({"kind": left}, {"kind": right}, run=RUN, **more)


def raising(run, system) -> float:
    raise IndexError("there is no such sample")


def no_scene():
    return ma.Scene(
        name="nobody",
        object={"shape": {"sphere": 0.1}, "mass": 1.0},
        arms={"arm": {"robot": "nobody", "tip": "tool0"}},
        joints=[{"arm": "arm", "kind": "weld"}],
    )


HEALTHY = HardCase(
    "healthy", "Two welded arms", "Nothing is hard.", pair("weld", "weld"), (COMPLETED, CLOSED), 0.1
)
CASES = {
    case.name: case
    for case in (
        HEALTHY,
        replace(
            HEALTHY,
            name="hinged",
            title="Two hinges & <damping>",
            scene=pair(
                "revolute", "revolute",
                control={
                    "kind": "harmonic", "frequency": 4.0,
                    "amplitude": {arm: [9.0, 9.0, 9.0, 3.0, 3.0, 3.0] for arm in ("left", "right")},
                },
                effects={"joint_damping": 5.0},
            ),
        ),
        replace(HEALTHY, name="face", scene=pair("weld", "point_on_plane")),
        replace(
            HEALTHY,
            name="strict",
            criteria=(COMPLETED, Criterion("position drift", 1e-30, "m", most_drift)),
        ),
        replace(HEALTHY, name="no_scene", scene=no_scene),
        replace(
            HEALTHY,
            name="unmeasurable",
            criteria=(
                Criterion("not a number", 1.0, "m", lambda run, system: math.nan),
                Criterion("out of range", 1.0, "m", raising),
            ),
        ),
        replace(HEALTHY, name="eventless", events=True),
    )
}  # fmt: skip
GOOD = {"healthy", "hinged", "face"}


@pytest.fixture(scope="module")
def suite():
    """All cases of this file."""
    return run_suite(cases=CASES)


@pytest.fixture
def own_cases(monkeypatch):
    """The command knows the cases of this file."""
    monkeypatch.setattr(problems, "HARD_CASES", CASES)


def case_of(suite, name: str) -> CaseResult:
    return next(case for case in suite.cases if case.name == name)


# --- the verdict ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_case_passes_when_it_is_completed_within_all_criteria(suite):
    assert {case.name for case in suite.cases if case.passed} == GOOD
    assert (suite.passed, len(suite.cases)) == (len(GOOD), len(CASES))


def test_measured_is_what_the_criterion_measures():
    case = run_case(HEALTHY)
    system = ma.compile_system(HEALTHY.scene())
    again = ma.simulate(system)
    assert [item.measured for item in case.criteria] == [0.0, most_drift(again, system)]
    assert [item.bound for item in case.criteria] == [0.0, 1e-10]


def test_a_measure_on_the_bound_passes_and_the_next_number_above_does_not():
    def at(bound):
        return replace(HEALTHY, criteria=(Criterion("two", bound, "1", lambda run, system: 2.0),))

    assert run_case(at(2.0)).passed
    assert not run_case(at(np.nextafter(2.0, 0.0))).passed


def test_a_run_that_breaks_off_fails_whatever_its_criteria_say():
    def diverging():
        run = {"duration": 2.0, "integrator": "semi_implicit_euler", "step": 0.2}
        return pair("weld", "weld")().replace(run={**run, "stabilization": "none"})

    easy = (Criterion("nothing", 1.0, "1", lambda run, system: 0.0),)
    case = run_case(replace(HEALTHY, scene=diverging, criteria=easy))
    assert (case.status, case.passed) == ("failed", False)
    assert case.failures == (f"failed: {case.message}",)


@pytest.mark.slow
def test_a_case_that_raises_is_a_failing_row_with_its_message(suite):
    case = case_of(suite, "no_scene")
    assert (case.passed, case.status) == (False, "not run")
    assert "unknown robot 'nobody'" in case.message
    assert suite.cases[-1].status == "completed", "the suite went on"


def test_what_cannot_be_measured_fails_with_the_reason(suite):
    first, second = case_of(suite, "unmeasurable").criteria
    assert (first.measured, first.passed, first.message) == (None, False, "measured nan")
    assert (second.measured, second.passed) == (None, False)
    assert second.message == "IndexError: there is no such sample"


def test_events_that_are_expected_but_missing_fail_a_case(suite):
    case = case_of(suite, "eventless")
    assert [item.quantity for item in case.criteria if not item.passed] == [
        "expected events missing"
    ]


def test_ctrl_c_in_a_case_ends_the_suite():
    def interrupt(done: float, total: float, text: str) -> None:
        if "simulating" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_suite(["healthy"], cases=CASES, progress=interrupt)


def test_progress_grows_to_the_number_of_cases():
    told: list[float] = []
    run_suite(["healthy", "face"], cases=CASES, progress=lambda done, *_: told.append(done))
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 2.0)


# --- the command ----------------------------------------------------------------------------------


def test_exit_code_is_0_when_all_pass(own_cases):
    result = stability("healthy")
    assert result.exit_code == 0, result.output
    assert "1 of 1 within their criteria" in result.stdout


def test_an_unknown_case_is_refused_with_the_alternatives(own_cases):
    result = stability("healty")
    assert result.exit_code == 2
    assert "unknown hard case 'healty'; did you mean 'healthy'?" in result.stderr
    assert "'strict'" in result.stderr


def test_cases_run_once_and_in_their_own_order(own_cases):
    result = stability("strict", "healthy", "healthy", "--list")
    assert result.exit_code == 0
    names = [name for name in re.findall(r"^ +(\w+)", result.stdout, re.M) if name in CASES]
    assert names == ["healthy", "strict"]


def test_listing_tells_every_shipped_case_and_runs_none():
    result = stability("--list")
    assert result.exit_code == 0
    for name in problems.HARD_CASES:
        assert name in result.stdout
    assert "within their criteria" not in result.stdout


@pytest.mark.parametrize("option", ["--html", "--json"])
def test_listing_writes_no_files(option, tmp_path):
    result = stability("--list", option, tmp_path / "file")
    assert result.exit_code == 2
    assert f"error: {option}: " in result.stderr and "--list" in result.stderr


def test_a_failed_case_is_named_and_the_files_are_written_all_the_same(own_cases, tmp_path):
    page, figures = tmp_path / "page.html", tmp_path / "figures.json"
    result = stability("healthy", "no_scene", "strict", "--html", page, "--json", figures)
    assert result.exit_code == 1
    assert "1 of 3 within their criteria" in result.stdout
    assert re.search(r"error: strict: position drift: \S+, bound 1e-30 m", result.stderr)
    assert "error: healthy" not in result.stderr  # its progress may be told
    written = finite_json(figures.read_text(encoding="utf-8"))
    assert promised_keys(stability_command) == set(written)
    assert [case["name"] for case in written["cases"]] == ["healthy", "strict", "no_scene"]
    assert "unknown robot" in page.read_text(encoding="utf-8")


# --- JSON and page --------------------------------------------------------------------------------


def test_json_is_complete_and_finite(suite):
    cases = finite_json(json.dumps(suite.as_dict(), allow_nan=False))["cases"]
    assert [case["name"] for case in cases] == list(CASES)
    assert all(set(case) == set(CaseResult.__dataclass_fields__) for case in cases)
    assert cases[0]["criteria"][1]["measured"] == suite.cases[0].criteria[1].measured
    assert cases[5]["criteria"][0]["measured"] is None


def test_history_keeps_the_peaks_that_are_judged(suite):
    case = case_of(suite, "healthy")
    assert max(case.history["gap"]) == case.criteria[1].measured
    assert {len(values) for values in case.history.values()} == {len(case.history["time"])}


@pytest.mark.slow
def test_page_is_whole_well_formed_and_needs_nothing_else(suite):
    page = render(suite)
    reader = Page(page)
    assert reader.sources == []
    assert reader.ids.issuperset(CASES)
    for case in suite.cases:
        assert case.difficulty in page
        assert f"multiarm stability {case.name}" in page
    assert "3 of 7 within their criteria" in page
    assert "Two hinges &amp; &lt;damping&gt;" in page
