"""Claims about the cost of a step."""

from __future__ import annotations

import pytest
import step_cost

import multiarm as ma
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS


@pytest.fixture(scope="module")
def costs():
    """Two arms, measured once: a row for each method."""
    return step_cost.step_costs((2,), rounds=1).set_index("integrator")


@pytest.mark.slow
def test_every_integrator_has_its_overhead(costs):
    assert list(costs.index) == [*FIXED_STEP_INTEGRATORS, *ADAPTIVE_INTEGRATORS]
    product = costs["evaluations"] * costs["evaluation_microseconds"]
    assert list(costs["overhead"]) == pytest.approx(list(costs["microseconds"] / product - 1.0))
    assert set(costs.loc[list(FIXED_STEP_INTEGRATORS), "steps"]) == {step_cost.FIXED_STEPS}


def test_evaluations_of_a_step_are_those_that_the_run_counts(costs):
    system = ma.compile_system(step_cost.ring_of_arms(2, step_cost.KIND))
    duration = step_cost.FIXED_STEPS * step_cost.STEP
    run = ma.simulate(system, duration, integrator="rk4", step=step_cost.STEP)
    steps = run.statistics["steps"]
    assert costs.loc["rk4", "evaluations"] == run.statistics["evaluations"] / steps
    assert costs.loc["rk4", "projections"] == run.statistics["projections"] / steps
