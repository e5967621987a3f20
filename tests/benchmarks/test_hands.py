"""Claims about the benchmark of hands."""

from __future__ import annotations

import hands
import pytest


@pytest.mark.slow
def test_all_methods_have_the_accelerations_of_the_dense_solution():
    rows = hands.hand_costs((1,), rounds=1)
    assert list(rows["method"]) == list(hands.METHODS)
    assert set(rows["freedoms"]) == {22} and set(rows["constraints"]) == {12}
    errors = rows.set_index("method")["relative_error"]
    assert (errors[list(hands.OURS)] < 1e-11).all()
    assert errors["constraintDynamics"] < 1e-10
    assert (errors[["lcaba, 1 iteration", "lcaba, 3 iterations"]] < 1e-5).all()  # as regularised
    assert (rows["microseconds"] > 0.0).all()
