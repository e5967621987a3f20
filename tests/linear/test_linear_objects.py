"""Linear systems of several objects, against the textbook's double pendulum."""

from __future__ import annotations

import numpy as np
import pytest
from object_scenes import DOWN, GRAVITY, PENDULUM, double_pendulum
from scipy.linalg import eigh

import multiarm as ma
from multiarm.linear.modes_trajectory import modes_trajectory
from multiarm.scene import parse_scene


def hanging(angles: list[float]) -> ma.System:
    return ma.compile_system(parse_scene({**double_pendulum(angles, [0.0, 0.0]), "gravity": DOWN}))


def small_swings() -> np.ndarray:
    """Frequencies of a double pendulum about hanging [Hz], from its mass and its stiffness."""
    (m, I, a), L = (PENDULUM[key] for key in ("m", "I", "to_centre")), PENDULUM["length"]
    across = m[1] * L * a[1]
    mass = [[I[0] + m[0] * a[0] ** 2 + m[1] * L**2, across], [across, I[1] + m[1] * a[1] ** 2]]
    stiffness = np.diag([(m[0] * a[0] + m[1] * L) * GRAVITY, m[1] * a[1] * GRAVITY])
    return np.sqrt(eigh(stiffness, mass, eigvals_only=True)) / (2.0 * np.pi)


def test_modes_of_two_objects_are_those_of_a_double_pendulum():
    linear = ma.linearise(hanging([0.0, 0.0]))
    swings = [mode for mode in linear.modes if mode.frequency > 0.0]
    found = sorted(mode.frequency for mode in swings)
    np.testing.assert_allclose(found, small_swings(), rtol=1e-8)
    for mode in swings:
        assert {name.partition("/")[0] for name in mode.moving} <= {"upper", "lower"}
    for name in ("upper/x", "lower/turn_y'"):
        assert name in linear.output_names


def test_an_equilibrium_of_two_objects_is_found_where_they_hang():
    equilibrium = ma.find_equilibrium(hanging([0.3, -0.2]))
    (_, _, a), L = (PENDULUM[key] for key in ("m", "I", "to_centre")), PENDULUM["length"]
    objects = equilibrium.state.objects
    np.testing.assert_allclose(objects["upper"].position, [0.0, 0.0, -a[0]], atol=1e-9)
    np.testing.assert_allclose(objects["lower"].position, [0.0, 0.0, -L - a[1]], atol=1e-9)


def test_modes_of_two_objects_are_shown():
    linear = ma.linearise(hanging([0.0, 0.0]))
    number = next(k for k, mode in enumerate(linear.modes, 1) if mode.frequency > 0.0)
    shown = modes_trajectory(linear, [number], amplitude=0.05)
    swing = np.ptp(shown.objects["lower"].quaternion_xyzw, axis=0).max()
    assert shown.status == "completed" and swing == pytest.approx(0.05, rel=0.2)
