"""Residuals of the equations of motion are those of the whole system's matrices."""

from __future__ import annotations

import numpy as np
import pytest
from matrix_systems import system_matrices
from mechanics import data_of
from repository import SCENES

import multiarm as ma
from multiarm.dynamics.evaluation import evaluate, residuals_of

ROUNDING = 1e-12  # of sums of some tens of terms


@pytest.mark.parametrize("name", ["two_ur5_box", "three_panda_plate"])
def test_residuals_of_any_accelerations_and_forces_are_those_of_the_matrices(name, rng):
    system = ma.compile_system(ma.load_scene(SCENES / f"{name}.yaml"))
    data = data_of(system)
    evaluation = evaluate(data, 0.0, system.initial_state())
    M, f_j, W, c = system_matrices(system, evaluation)
    x, force = rng.standard_normal(len(f_j)), rng.standard_normal(len(c))
    f_j, c = f_j + rng.standard_normal(len(f_j)), c + rng.standard_normal(len(c))
    found = residuals_of(data, x, f_j, force, c)
    motion, gaps = np.abs(M @ x - f_j - W @ force), np.abs(W.T @ x - c)
    expected = [np.max(motion[6:]), np.max(motion[:6]), np.max(gaps)]
    np.testing.assert_allclose(list(vars(found).values()), expected, rtol=ROUNDING)


def test_a_residual_that_is_not_a_number_is_not_hidden_by_larger_ones():
    system = ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))
    data = data_of(system)
    evaluate(data, 0.0, system.initial_state())
    b = data.arrays
    for part, place in (("object", 0), ("arm", 6)):
        x = 1e3 * np.ones_like(b.accelerations.a)
        forces = b.forces.f.copy()
        forces[place] = np.nan
        found = vars(residuals_of(data, x, forces, b.rows.force, b.rows.c))
        assert [name for name, residual in found.items() if np.isnan(residual)] == [part]
