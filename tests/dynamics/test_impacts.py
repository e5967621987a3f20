"""Impacts without restitution, against the conditions that define them."""

from __future__ import annotations

import numpy as np
import pytest

from multiarm.dynamics.impacts import inelastic_impact

SIZE = 9
ROUNDING = 1e-12  # some hundred roundings, times the condition of the inertia


@pytest.fixture(params=[0, 4, 7], ids=["no rows", "independent rows", "repeated rows"])
def impact(request):
    """Inertia, rows, velocity, and the impact; of seven rows three are sums of the others."""
    rng, count = np.random.default_rng(8), request.param
    L = np.tril(rng.uniform(-1.0, 1.0, (SIZE, SIZE))) + 3.0 * np.eye(SIZE)
    rows, v = rng.uniform(-1.0, 1.0, (count, SIZE)), rng.uniform(-1.0, 1.0, SIZE)
    if count > 4:
        rows[4:] = rng.uniform(-1.0, 1.0, (count - 4, 4)) @ rows[:4]
    return L @ L.T, rows, v, inelastic_impact(rows, L, v)


def test_an_impact_stops_the_rates_and_obeys_momentum(impact):
    M, rows, v, (change, impulses, _) = impact
    np.testing.assert_allclose(rows @ (v + change), 0.0, atol=ROUNDING)
    np.testing.assert_allclose(M @ change, rows.T @ impulses, atol=ROUNDING)


def test_an_impact_loses_the_kinetic_energy_of_the_change(impact):
    M, _, v, (change, _, lost) = impact
    after = v + change
    assert lost == pytest.approx(0.5 * (v @ M @ v - after @ M @ after), abs=ROUNDING)
    assert lost == pytest.approx(0.5 * change @ M @ change, abs=ROUNDING)


def test_impulses_are_of_least_norm(impact):
    M, rows, v, (_, impulses, _) = impact
    response = rows @ np.linalg.inv(M) @ rows.T
    least = -np.linalg.pinv(response, rcond=1e-10) @ rows @ v
    np.testing.assert_allclose(impulses, least, atol=1e-10)
