"""Claims about the parts of an evaluation and of a step."""

from __future__ import annotations

import pytest
import time_shares

import multiarm as ma
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS


@pytest.fixture(scope="module")
def shares():
    """Two arms, measured once."""
    return time_shares.time_shares((2,), rounds=1)


@pytest.mark.slow
def test_parts_and_what_they_leave_make_up_the_whole(shares):
    parts = ["arm terms", "contacts", "forces", "node", "state", "between"]
    for row in shares["rows"]:
        assert list(row["evaluation"]) == parts
        assert list(row["step"]) == [*parts, "stabilisation", "recording", "arithmetic", "rest"]
        assert sum(row["evaluation"].values()) == pytest.approx(row["evaluation_microseconds"])
        assert sum(row["step"].values()) == pytest.approx(row["step_cost"]["microseconds"])


def test_a_step_is_taken_apart_by_what_happens_in_it():
    evaluation = {"node": 2.0, "between": 1.0}
    cost = {"projection": 5.0, "sample": 0.5, "arithmetic": 0.25}
    step = time_shares.StepCost(
        integrator="dop853", arms=2, steps=10, evaluations=9.0, projections=2.0, samples=0.5,
        microseconds=40.0, evaluation_microseconds=3.0, overhead=40.0 / 27.0 - 1.0,
    )  # fmt: skip
    parts = time_shares.step_parts(evaluation, cost, step)
    assert parts == {
        "node": 10.0,  # five of nine evaluations are not projections
        "between": 5.0,
        "stabilisation": 10.0,
        "recording": 0.25,
        "arithmetic": 0.25,
        "rest": 14.5,
    }


def test_every_integrator_has_its_overhead(shares):
    costs = {cost["integrator"]: cost for cost in shares["overheads"]}
    assert list(costs) == [*FIXED_STEP_INTEGRATORS, *ADAPTIVE_INTEGRATORS]
    for name, cost in costs.items():
        product = cost["evaluations"] * cost["evaluation_microseconds"]
        assert cost["overhead"] == pytest.approx(cost["microseconds"] / product - 1.0)
        if name in FIXED_STEP_INTEGRATORS:
            assert cost["steps"] == time_shares.FIXED_STEPS


def test_evaluations_of_a_step_are_those_that_the_run_counts(shares):
    cost = {cost["integrator"]: cost for cost in shares["overheads"]}["rk4"]
    system = ma.compile_system(time_shares.ring_of_arms(2, time_shares.KIND))
    duration = time_shares.FIXED_STEPS * time_shares.STEP
    run = ma.simulate(system, duration, integrator="rk4", step=time_shares.STEP)
    assert cost["evaluations"] == run.statistics["evaluations"] / run.statistics["steps"]
    assert cost["projections"] == run.statistics["projections"] / run.statistics["steps"]
