"""Claims about runs that two runs alone might call accurate although they are not."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from mechanics import SHORT, true_error
from refusals import refused

import multiarm as ma
from multiarm.errors import TrajectoryError
from multiarm.problems import HARD_CASES, ring_of_arms
from multiarm.simulation import driver as driver_module
from multiarm.simulation import setup as preparation


@pytest.fixture(scope="module")
def ring():
    return ma.compile_system(ring_of_arms(2))


@pytest.mark.slow
def test_a_rerun_takes_shorter_steps_where_not_the_tolerance_limits_them():
    """A controller in Python limits the steps to the time between samples: both runs took these."""
    swing = ma.compile_system(ring_of_arms(2, "ball").replace(control={"kind": "none"}))
    asked = {"duration": 6.0, "output_step": 2e-3}
    run = ma.simulate(swing, accuracy=1e-3, control=lambda t, state: {}, **asked)
    rows = run.certificate["attempts"]
    assert rows[1]["steps"] > 1.2 * rows[0]["steps"]
    error = true_error(swing, run, control=lambda t, state: {})
    assert not run.certificate["met"] or error <= 1e-3
    assert not run.certificate["met"] or run.certificate["estimated_error"]["rotation_rad"] > 1e-12


@pytest.mark.slow
def test_a_pulse_that_the_run_steps_over_is_seen_by_the_rerun():
    rest = ring_of_arms(2, "weld").replace(gravity=None, control={"kind": "none"})
    system = ma.compile_system(rest)

    def pulse(t, state):
        push = np.zeros(6)
        push[0] = 200.0 if 0.1036 < t < 0.1058 else 0.0
        return {"arm0": push}

    run = ma.simulate(system, duration=0.2, accuracy=1e-6, output_step=0.01, control=pulse)
    wanted = ma.simulate(
        system, duration=0.2, accuracy=1e-6, output_step=0.01, control=pulse, max_step=1e-4,
        certificate=False,
    )  # fmt: skip
    off = np.abs(run.object_position - wanted.object_position).max()
    assert np.abs(np.diff(wanted.object_position, axis=0)).max() > 1e-4  # it does push
    assert off <= 1e-6 or not run.certificate["met"]


def test_a_controller_that_remembers_is_not_run_again(ring):
    class Integrating:
        def __init__(self):
            self.before, self.sum = 0.0, 0.0

        def __call__(self, t, state):
            if t > self.before:
                self.sum += (t - self.before) * (state.object_position[2] - 0.3)
                self.before = t
            return {arm: np.full(6, -50.0 * self.sum) for arm in ("arm0", "arm1")}

    asked = {"duration": 0.2, "accuracy": 1e-5}
    checked = ma.simulate(ring, control=Integrating(), **asked)
    alone = ma.simulate(ring, control=Integrating(), certificate=False, **asked)
    np.testing.assert_array_equal(checked.object_position, alone.object_position)
    assert not checked.certificate["met"] and checked.certificate["reason"] == "memory"
    assert "certificate=False" in checked.certificate["text"]


def test_nothing_is_met_where_nothing_that_was_asked_could_be_judged():
    linkage = ma.compile_system(HARD_CASES["parallelogram"].scene())
    certificate = ma.simulate(linkage, duration=0.2, accuracy={"force": 1e-3}).certificate
    assert not certificate["met"] and certificate["reason"] == "check"
    assert "determine none of the forces" in certificate["text"]


def test_a_trajectory_in_memory_can_be_pickled(ring):
    run = ma.simulate(ring, **SHORT)
    again = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(again.object_position, run.object_position)
    assert again.scene_text == run.scene_text and again.certificate == run.certificate


@pytest.mark.parametrize("stored", [False, True])
def test_reading_a_closed_trajectory_says_that_it_is_closed(ring, tmp_path, stored):
    run = ma.simulate(ring, certificate=False, out=tmp_path / "r.h5" if stored else None, **SHORT)
    run.close()
    with refused(TrajectoryError):
        run.read("object/twist")


@pytest.mark.slow
def test_a_failed_trial_of_a_stiff_method_leaves_the_pending_samples_right(ring, monkeypatch):
    """With a full block of samples still to come, the method must not be exchanged yet."""
    damped = ma.compile_system(ring_of_arms(2).replace(effects={"joint_damping": 1e4}))
    asked = {"duration": 0.02, "accuracy": 1e-6, "certificate": False}
    calm = ma.simulate(damped, output_step=2e-6, **asked)
    assert [event["kind"] for event in calm.events].count("method changes") == 1
    monkeypatch.setattr(driver_module.Switch, "_is_faster", lambda self, run: False)
    monkeypatch.setattr(driver_module, "TRIAL_STEPS", 4)
    hasty = ma.simulate(damped, output_step=2e-6, **asked)
    assert [event["kind"] for event in hasty.events].count("method changes") == 2
    assert len(hasty) > preparation.BLOCK_NUMBERS // 100
    np.testing.assert_allclose(hasty.object_position, calm.object_position, atol=1e-6)
