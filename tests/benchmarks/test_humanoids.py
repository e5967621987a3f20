"""Claims about the benchmark of a humanoid robot."""

from __future__ import annotations

import humanoids
import pytest


@pytest.mark.slow
def test_all_methods_have_the_accelerations_of_the_dense_solution():
    rows = humanoids.humanoid_costs(rounds=1)
    assert list(rows["method"]) == [*humanoids.METHODS] * 2
    assert set(rows["freedoms"]) == {41} and set(rows["constraints"]) == {12, 24}
    errors = rows.groupby("method")["relative_error"].max()
    assert (errors[[humanoids.COMPILED, humanoids.PINOCCHIO]] < 1e-11).all()
    assert errors[humanoids.DYNAMICS] < 1e-10
    assert (errors[list(humanoids.ITERATIONS)] < 1e-4).all()  # as regularised
    assert (rows["microseconds"] > 0.0).all()


@pytest.mark.slow
def test_humanoids_around_one_box_cost_no_more_each_than_one():
    rows = humanoids.crowd_costs([1, 4], rounds=1)
    assert list(rows["freedoms"]) == [6 + 35, 6 + 4 * 35]
    assert list(rows["constraints"]) == [12, 48]
    alone, each = rows["microseconds_a_humanoid"]
    assert each < 1.2 * alone
