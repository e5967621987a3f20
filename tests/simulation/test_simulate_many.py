"""Claims about `simulate_many`: the same numbers as one run at a time, in order, in any company."""

from __future__ import annotations

import pickle
import threading

import numpy as np
import pytest
from many_runs import assert_same_run, random_states
from mechanics import (
    ur5_pair,
)
from refusals import refused

import multiarm as ma
from multiarm.errors import ModelError, SceneError, SolverError, TrajectoryError
from multiarm.simulation.many import describe, run_case

RUN = {"duration": 0.1, "accuracy": 1e-6}


@pytest.fixture(scope="module")
def system():
    return ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}))


@pytest.fixture(scope="module")
def states(system):
    return random_states(system, 7)


@pytest.fixture(scope="module")
def expected(system, states):
    return [ma.simulate(system, state=state, **RUN) for state in states]


@pytest.mark.parametrize("threads", [1, 2, 4, None])
def test_runs_come_back_in_order_with_the_numbers_of_single_runs(system, states, expected, threads):
    found = ma.simulate_many(system, states=states, threads=threads, **RUN)
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        assert_same_run(one, other)
    ends = {tuple(run.object_position[-1]) for run in found}
    assert len(ends) == len(states)  # so that a wrong order would be seen


def test_a_run_does_not_depend_on_those_before_it(system, states, expected):
    backwards = ma.simulate_many(system, states=states[::-1], threads=1, **RUN)
    for one, other in zip(backwards, expected[::-1], strict=True):
        assert_same_run(one, other)


def test_parameters_are_scenes_that_are_written_so():
    joints = {"kind": "weld"}, {"kind": "ball"}
    control = {"kind": "joint_pd", "stiffness": 100.0, "damping": 20.0}
    scene = ur5_pair(*joints, control=control)
    written = [
        scene.replace(object={**vars(scene.object), "mass": 10.0}),
        ur5_pair(*joints, control={**control, "stiffness": 300.0}),
        ur5_pair(*joints, control=control, effects={"joint_damping": 2.0}),
        ur5_pair(joints[0], {"kind": "revolute"}, control=control),
    ]
    parameters = [
        {"object.mass": 10.0},
        {"object.mass": 20.0, "control.stiffness": 300.0},  # the mass is what it was
        {"effects.joint_damping": 2.0},
        {"joints[1].kind": "revolute"},
    ]
    found = ma.simulate_many(ma.compile_system(scene), parameters=parameters, threads=2, **RUN)
    for run, own in zip(found, written, strict=True):
        assert_same_run(run, ma.simulate(ma.compile_system(own), **RUN))


def test_bases_and_postures_are_parameters_too():
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"})
    lifted = {
        "arms.left.base.xyz[2]": 0.2, "arms.right.base.xyz[2]": 0.2, "object.pose.xyz[2]": 0.7,
    }  # fmt: skip
    parameters = [lifted, {"arms.left.posture[5]": 0.1, "joints[0].at": None}, {}]
    found = ma.simulate_many(ma.compile_system(scene), parameters=parameters, **RUN)
    assert [run.status for run in found] == ["completed"] * 3
    rise = found[0].object_position - found[2].object_position
    np.testing.assert_allclose(rise, np.tile([0, 0, 0.2], (len(rise), 1)), atol=1e-6)
    assert found[1].joint_positions["left"][0, 5] == pytest.approx(0.1, abs=1e-9)


def test_states_and_parameters_go_together_one_of_each_a_run(system, states):
    masses = [5.0, 40.0]
    found = ma.simulate_many(
        system, states=states[:2], parameters=[{"object.mass": m} for m in masses], threads=2, **RUN
    )
    for run, state, mass in zip(found, states, masses, strict=False):
        scene = system.scene.replace(object={**vars(system.scene.object), "mass": mass})
        assert_same_run(run, ma.simulate(ma.compile_system(scene), state=state, **RUN))


def test_a_case_can_be_sent_to_another_process(system, states, expected):
    (case,) = describe(system, states[:1], None, None, RUN)
    sent = pickle.loads(pickle.dumps(case))
    assert sent.scene == case.scene
    there = ma.compile_system(sent.scene)
    assert_same_run(run_case(sent, there, None), expected[0])


def test_no_runs_are_no_results(system):
    assert ma.simulate_many(system, states=[]) == []
    assert ma.simulate_many(system, parameters=[], out=None) == []


def test_settings_are_those_of_simulate(system, states):
    settings = {
        "duration": 0.05, "integrator": "rk4", "step": 1e-3, "stabilization": "feedback",
        "output_step": 0.005, "solver": "dense",
    }  # fmt: skip
    (found,) = ma.simulate_many(system, states=states[:1], **settings)
    assert_same_run(found, ma.simulate(system, state=states[0], **settings))
    pushed = {"control": lambda t, state: {"left": np.full(6, t)}, "max_step": 0.01}
    (found,) = ma.simulate_many(system, states=states[:1], certificate=False, **RUN, **pushed)
    alone = ma.simulate(system, state=states[0], certificate=False, **RUN, **pushed)
    assert_same_run(found, alone)
    assert found.certificate is None and found.provenance["control"] == "python function"


# --- what is wrong ------------------------------------------------------------------------------


def test_all_faults_of_parameters_are_told_before_any_run(system):
    parameters = [{"object.mas": 1.0}, {"object.mass": 2.0}, {"arms.rigth.base.xyz": [0, 0, 0]}]
    with refused(SceneError, "parameters: ", "run 1: $.object.mas: ", "run 3: $.arms.rigth: "):
        ma.simulate_many(system, parameters=parameters)


@pytest.mark.parametrize(
    ("asked", "error"),
    [
        ({}, ModelError),
        ({"parameters": {"object.mass": 1.0}}, ModelError),
        ({"states": [3]}, ModelError),
        ({"parameters": [{}], "threads": 0}, ModelError),
        ({"parameters": [{}], "step": 1e-3}, SceneError),
        ({"parameters": [{}], "max_step": -1.0}, SolverError),
        ({"parameters": [{}, {}], "out": "one.h5{"}, TrajectoryError),
        ({"parameters": [{}, {}], "out": "{{}}.h5"}, TrajectoryError),
        ({"parameters": [{}], "out": "nowhere/{}.h5"}, TrajectoryError),
    ],
)  # fmt: skip
def test_what_cannot_be_asked_is_refused_before_any_run(
    system, asked, error, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with refused(error):
        ma.simulate_many(system, **asked)
    assert list(tmp_path.iterdir()) == []


def test_states_are_as_many_as_parameters_finite_and_of_these_arms(
    system, states, free_block_system
):
    with refused(ModelError, "2 states"):
        ma.simulate_many(system, states=states[:2], parameters=[{}])
    broken = states[0].copy()
    broken.velocity[3] = np.nan
    with refused(ModelError, "run 2: state: ", "run 3: "):
        ma.simulate_many(system, states=[states[0], broken, free_block_system.initial_state()])


def test_one_state_is_no_list_of_states(system, states):
    with refused(ModelError, "states is one state"):
        ma.simulate_many(system, states=states[0])


def test_a_run_that_cannot_begin_is_a_failed_one_and_the_others_go_on(system, states, tmp_path):
    far = system.state(object_position=[0, 0, 3.0])
    found = ma.simulate_many(
        system, states=[states[0], far, states[1]], threads=2, out=tmp_path, **RUN
    )
    assert [run.status for run in found] == ["completed", "failed", "completed"]
    with pytest.raises(ModelError) as caught:
        ma.simulate(system, state=far, **RUN)
    assert found[1].message == f"the run could not begin: {caught.value}"
    assert len(found[1]) == 0 and found[1].arm_names == ("left", "right")
    stored = ma.load_trajectory(tmp_path / "run_0002.h5")
    assert (stored.status, stored.message, len(stored)) == ("failed", found[1].message, 0)
    too_far = {"arms.left.base.xyz": [-5.0, 0, 0], "joints[0].at.xyz": [-0.6, 0, 0]}
    found = ma.simulate_many(system, parameters=[{}, too_far], **RUN)
    assert [run.status for run in found] == ["completed", "failed"]
    assert "does not satisfy the joint of arm 'left'" in found[1].message
    assert found[1].scene.arms["left"].base.xyz[0] == -5.0


def test_a_run_that_fails_on_the_way_keeps_its_samples_and_leaves_the_others_alone(monkeypatch):
    monkeypatch.setattr("multiarm.scene.EFFECTS.registered", {})

    class Breaks(ma.Effect):
        name = "breaks"

        class Spec(ma.Effect.Spec):
            at: float = 1.0

        def forces(self, t, state):
            if t > self.spec.at:
                raise RuntimeError("the drive is broken")
            return ma.Loads()

    ma.register_effect(Breaks)
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "weld"}, effects={"breaks": {}}))
    parameters = [{}, {"effects.breaks.at": 0.055}, {}]
    found = ma.simulate_many(system, parameters=parameters, threads=3, **RUN)
    assert [run.status for run in found] == ["completed", "failed", "completed"]
    assert "the drive is broken" in found[1].message
    assert found[1].time[-1] == pytest.approx(0.05) and len(found[0]) == 11
    assert_same_run(found[0], found[2])


def test_what_is_no_trouble_of_a_run_is_raised_after_the_others_ended(monkeypatch):
    def compiled(scene, *given, **more):
        if scene.object.mass == 7.0:
            raise ZeroDivisionError("a bug")
        return ma.compile_system(scene, *given, **more)

    monkeypatch.setattr("multiarm.simulation.many.compile_system", compiled)
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "weld"}))
    with pytest.raises(ZeroDivisionError):
        ma.simulate_many(system, parameters=[{}, {"object.mass": 7.0}, {}], threads=2, **RUN)
    assert [t.name for t in threading.enumerate() if t.name.startswith("multiarm")] == []
