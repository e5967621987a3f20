"""Claims about the times of what a run reports without enforcing it: limits, patches, drives.

A body moves uniformly along x while the cart that it slides on is driven by ``A sin(w t)``, so that
its place on the cart is ``x(t) = v t - (A / M) (t / w - sin(w t) / w^2)``.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import scene_of, sledge_urdf
from scipy.optimize import brentq

import multiarm as ma
from multiarm.dynamics.guards import DIPPED, FIRED, QUIET
from multiarm.integration.event_location import first_event, sign_changes

MASS, SPEED = 3.0, 1.0  # [kg] of the cart, [m/s] of the body
AMPLITUDE, FREQUENCY = 12.0, 2.0  # [N], [Hz]
OMEGA = 2.0 * math.pi * FREQUENCY
END = 0.31  # [m] of the range
ROUNDING = 1e-13  # [s] of times of about 1 s


def place(t: float) -> float:
    return SPEED * t - AMPLITUDE / MASS * (t / OMEGA - math.sin(OMEGA * t) / OMEGA**2)


LEAVES = brentq(lambda t: place(t) - END, 0.0, 1.0, xtol=1e-15)


@pytest.fixture
def driven(tmp_path):
    """A system of the cart and the body, whose joint or contact has an end at ``END``."""

    def build(what: str, effects=None):
        urdf = tmp_path / f"{what}.urdf"
        turned = '<child link="tip"/><origin rpy="0 1.5707963267948966 0"/>'  # a slide is along z
        text = sledge_urdf(MASS)
        urdf.write_text(text.replace('<child link="tip"/>', turned) if what == "limit" else text)
        patch = {"min": [-10, -1, None], "max": [END, 1, None]}
        contact = {
            "name": "c",
            "arm": {"plane": {"normal": [0, 0, 1], "patch": patch}},
            "object": {"point": [0, 0, 0]},
        }
        joints = {
            "limit": {
                "kind": "prismatic",
                "at": {"xyz": [0, 0, 0], "rpy": [0, math.pi / 2, 0]},
                "limits": [-END, 10.0],
            },
            "patch": {"kind": "contacts", "at": {"xyz": [0, 0, 0]}, "contacts": [contact]},
        }
        body = {"shape": {"box": [0.1, 0.1, 0.1]}, "mass": 1.0, "twist": [SPEED, 0, 0, 0, 0, 0]}
        control = {
            "kind": "harmonic",
            "amplitude": {"a": AMPLITUDE},
            "frequency": FREQUENCY,
            "hold": False,
        }
        arm = {"urdf": str(urdf), "tip": "tip", "posture": [0.0]}
        return ma.compile_system(
            scene_of(
                {"a": arm}, [{"arm": "a", **joints[what]}], object=body, gravity=[0, 0, 0],
                control=control, effects=effects or {},
            )
        )  # fmt: skip

    return build


@pytest.mark.parametrize(
    ("what", "kind"), [("limit", "passes its limit"), ("patch", "leaves its patch")]
)
def test_times_of_limits_and_patches_have_the_accuracy_of_the_run(driven, what, kind):
    run = ma.simulate(driven(what), 1.0, accuracy=1e-10, certificate=False)
    (event,) = (event for event in run.events if event["kind"] == kind)
    assert abs(event["time"] - LEAVES) < 1e-10


def test_times_of_limits_have_the_order_of_the_method(driven):
    """RK4 and its dense output: halving the step divides the error by about 16."""
    system, errors = driven("limit"), []
    for step in (0.02, 0.01, 0.005):
        run = ma.simulate(system, 1.0, integrator="rk4", step=step)
        (event,) = (event for event in run.events if event["kind"] == "passes its limit")
        errors.append(abs(event["time"] - LEAVES))
    assert errors[0] > 1e-9  # larger than roundings
    assert errors[0] / errors[2] > 0.5 * 16.0**2


@pytest.mark.parametrize("how", [{"accuracy": 1e-6}, {"integrator": "rk4", "step": 0.05}])
def test_a_drive_reports_every_saturation_even_within_one_step(driven, how):
    """The command alone decides, so that its times are exact whatever the method."""
    limit = 0.97 * AMPLITUDE  # for a twelfth of the half period: 20 ms
    system = driven("patch", {"torque_limits": limit})
    run = ma.simulate(system, 1.0, certificate=False, **how)
    first = math.asin(limit / AMPLITUDE)
    begins = [(first + math.pi * k) / OMEGA for k in range(4)]
    ends = [(math.pi - first + math.pi * k) / OMEGA for k in range(4)]
    times = {
        kind: [event["time"] for event in run.events if event["kind"] == kind]
        for kind in ("saturates", "is no longer saturated")
    }
    assert times["saturates"] == pytest.approx(begins, abs=ROUNDING)
    assert times["is no longer saturated"] == pytest.approx(ends, abs=ROUNDING)


def test_what_is_out_of_its_range_at_the_start_is_reported_there(driven):
    system = driven("limit")
    state = system.initial_state()
    state.object_position[0] += END + 0.1
    run = ma.simulate(system, 0.2, accuracy=1e-8, state=state, certificate=False)
    times = [event["time"] for event in run.events if event["kind"] == "passes its limit"]
    assert times == [0.0]


def polynomial(*roots: float):
    """Guards as functions of the fraction of a step: one with these roots, and one with 0.3."""
    return lambda theta: np.array([np.prod(np.subtract(roots, theta)), 0.3 - theta])


def test_each_guard_of_a_step_has_all_its_own_times():
    values = polynomial(0.05, 0.37, 0.9)
    assert sign_changes(values, 0, True, 1e-9) == pytest.approx([0.05, 0.37, 0.9], abs=1e-12)
    assert sign_changes(values, 1, True, 1e-9) == pytest.approx([0.3], abs=1e-12)


def test_a_guard_that_dips_between_two_points_of_the_grid_has_two_times():
    values = polynomial(0.53, 0.55)
    assert sign_changes(values, 0, False, 1e-9) == pytest.approx([0.53, 0.55], abs=1e-12)
    theta, guards = first_event(values, np.array([DIPPED, QUIET]), np.full(2, 1e-9))
    assert theta == pytest.approx(0.53, abs=1e-12) and guards == [0]
    assert sign_changes(lambda theta: np.array([(theta - 0.54) ** 2]), 0, False, 1e-9) == []


def test_a_sign_change_that_projection_moved_past_the_end_is_at_the_end():
    values = lambda theta: np.array([1.01 - theta])  # noqa: E731
    assert sign_changes(values, 0, True, 1e-9) == [1.0]
    level = np.array([1e-9])
    assert first_event(values, np.array([FIRED]), level) == (1.0, [0])
    assert first_event(values, np.array([DIPPED]), level) == (1.0, [])
