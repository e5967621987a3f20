"""Claims about which values of guards count in a step, and where in it an event is found."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import ur5_pair

import multiarm as ma
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.guard_functions import STATIC_FRICTION
from multiarm.dynamics.status import OK
from multiarm.simulation import event_handling
from multiarm.simulation.run import begin
from multiarm.simulation.setup import Task, run_spec


@pytest.fixture(scope="module")
def dry():
    """Two UR5s whose joints stick and slip."""
    effects = {"joint_friction": {"torque": 4.0, "model": "set_valued"}}
    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}, effects=effects))


def test_guards_are_located_with_the_gains_of_the_step_in_which_they_fired(dry, monkeypatch):
    """At its end the dense output is the state at which the guards were checked."""
    differences, first_event = [], event_handling.first_event

    def compare(values, results, levels):
        checked = values._guards.value.copy()
        differences.append(np.max(np.abs(values(1.0) - checked)) / np.max(np.abs(checked)))
        return first_event(values, results, levels)

    monkeypatch.setattr(event_handling, "first_event", compare)
    feedback = {"kind": "feedback", "alpha": 50.0, "beta": 50.0}
    ma.simulate(dry, 0.2, integrator="rk4", step=5e-3, stabilization=feedback)
    assert differences and max(differences) < 1e-13


def test_only_the_stages_of_a_step_count_between_its_ends(dry):
    """Not what was evaluated before it: samples, rejected steps, displaced states."""
    with dry.borrow() as data:
        times = {"duration": 1e-3, "step": 1e-3, "output_step": 1e-3}
        spec = run_spec(dry.scene.run, {"integrator": "rk4", **times})
        driver = begin(Task(dry, data, spec, None, np.inf), None)
        guards = driver.events.modes.guards
        forces = guards.kind == STATIC_FRICTION
        assert np.any(forces)
        guards.least[:] = -1e6
        driver.advance(10_000)
        assert driver.run.clock.steps == 1 and driver.event_stops == 0
        stages = guards.least[forces]
        assert np.all(np.abs(stages - guards.value[forces]) < 1.0)  # [N m] in a millisecond
        driver.run.data.arrays.state.velocity[:] += 1.0  # other forces
        assert evaluate_state(driver.run.data.struct, 0.0, 0.0) == OK
        assert np.array_equal(guards.least[forces], stages)
