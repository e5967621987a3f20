"""Claims about frozen results: they are today's, and a comparison sees what differs."""

from __future__ import annotations

import copy

import golden
import pytest

CASES = {case.name: case for case in golden.cases()}


@pytest.fixture(scope="module")
def frozen():
    return golden.load()


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_results_are_the_frozen_ones(name, frozen):
    outcome = golden.compare(CASES[name], frozen[name])
    assert not outcome.faults, "\n".join([str(outcome), *outcome.faults])


def test_every_frozen_case_is_compared(frozen):
    assert list(frozen) == list(CASES)


def test_nearly_every_frozen_number_is_sharp(frozen):
    results = [entry for case in frozen.values() for entry in case["results"].values()]
    tolerances = [entry["tolerance"] for entry in results if "tolerance" in entry]
    assert sum(tolerance <= golden.TOLERANCE for tolerance in tolerances) > 0.85 * len(tolerances)
    assert sum(tolerance <= 1e-8 for tolerance in tolerances) > 0.95 * len(tolerances)
    assert sum("unsteady" in entry for entry in results) < 0.01 * len(results)


@pytest.mark.parametrize("change", ["number", "flag", "residual", "count", "missing", "shape"])
def test_a_comparison_sees(change, frozen):
    case = frozen["example ring_weld pinocchio"]["results"]
    found = {name: copy.deepcopy(entry["value"]) for name, entry in case.items()}
    assert not golden.compared("", case, found).faults
    if change == "number":
        found["run/channels/arms/arm0/joint_velocity"][-1][2] *= 1.0 + 1e-8
    elif change == "flag":
        found["state 1/contact_forces_unique/arm1"][3] ^= True
    elif change == "residual":
        found["start/residuals/arm"] = 1e-9
    elif change == "count":
        found["run/counts/evaluations"] += 1
    elif change == "missing":
        del found["run/channels/energy/kinetic"]
    else:
        found["beside the joints/contact_terms/arm0/W_m"].pop()
    assert len(golden.compared("", case, found).faults) == 1
