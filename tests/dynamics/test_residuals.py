"""Residuals of the equations of motion are those of the whole system's matrices."""

from __future__ import annotations

import numpy as np
import pytest
from matrix_systems import system_matrices
from mechanics import data_of
from repository import SCENES

import multiarm as ma
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.evaluation import evaluate, residuals_of
from multiarm.dynamics.residuals import imbalance
from multiarm.dynamics.solver.bounds import IMBALANCE_BOUND
from multiarm.jit.kernels import kernel

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


@pytest.mark.parametrize("components", [[0], [3], [0, 3]], ids=["force", "moment", "both"])
def test_no_imbalance_above_the_bound_counts_as_none(components):
    """Of contact forces in one direction, whose sum is much larger than each of them."""
    data = data_of(ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml")))
    evaluate(data, 0.0, data.get_state())
    b = data.arrays
    mass, push = b.bodies.object_inertia[0, 0], float(len(b.rows.force))
    radius = np.sqrt(np.trace(b.bodies.object_inertia[3:, 3:]) / mass)
    b.rows.W_o[:], b.forces.f_o[:], b.accelerations.a_o[:], b.rows.force[:] = 0.0, 0.0, 0.0, 1.0
    b.rows.W_o[:, 0], b.accelerations.a_o[0] = 1.0, push / mass
    scale = np.array([push] * 3 + [push * radius] * 3)
    shares, found = np.geomspace(0.1, 10.0, 40) * IMBALANCE_BOUND, []
    for share in shares:
        b.forces.f_o[components] = share * scale[components]
        found.append(imbalance_of(data.struct))
    expected, found = len(components) * shares, np.array(found)
    assert found[0] == 0.0
    np.testing.assert_allclose(found[found > 0.0], expected[found > 0.0], rtol=1e-4)
    assert np.all(found[expected > IMBALANCE_BOUND] > 0.0)


@kernel
def imbalance_of(struct):
    data = open_data(struct)
    return imbalance(data, data.rows.W_o)


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
