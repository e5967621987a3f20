"""The use of limits: shares of effort, speed and range against independent computations."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest
from refusals import refused
from repository import SCENES
from sample_run import JOINTS, SCENE, numbered_block, record

import multiarm as ma
from multiarm.errors import TrajectoryError
from multiarm.results.channels import LARGEST
from multiarm.results.limit_use import (
    QUANTITIES,
    joint_uses,
    largest_shares,
    limit_warnings,
    peaks,
)
from multiarm.results.sinks import Hdf5Sink, MemorySink

LEFT, RIGHT = len(JOINTS["left"]), len(JOINTS["right"])
LIMITS = {
    "left": {
        "effort": [4.0, None] + [100.0] * 4,
        "speed": [3.0] * LEFT,
        "range": [[1.0, 5.0], [None, None]] + [[-10.0, 10.0]] * 4,
    },
    "right": {"effort": [None] * RIGHT, "speed": [None] * RIGHT, "range": [[-2.0, 2.0]] * RIGHT},
}


def recorded(limits=LIMITS, sink=None, blocks=None):
    """Samples 0 to 9 [s]; joint j has k + j / 100 at sample k: positions, speeds, torques."""
    blocks = [numbered_block(0, 6), numbered_block(6, 10)] if blocks is None else blocks
    metadata = {"scene": SCENE} if limits is None else {"scene": SCENE, "joint_limits": limits}
    return record(sink or MemorySink(), blocks, metadata=metadata)


def row(table, joint):
    """A joint's shares and times."""
    return table[table["joint"] == joint].iloc[0]


@pytest.fixture(scope="module")
def box():
    """Two UR5s with a box, compiled and run for a second."""
    system = ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))
    return system, ma.simulate(system, duration=0.5, certificate=False)


@pytest.mark.parametrize("sink", [lambda path: MemorySink(), Hdf5Sink])
def test_shares_are_one_at_the_limit_and_the_first_largest_counts(sink, tmp_path):
    table = recorded(sink=sink(tmp_path / "run.h5")).limit_use
    first = row(table, "left/shoulder_pan_joint")
    assert (first["effort"], first["effort_time"]) == (9 / 4, 9.0)
    assert (first["speed"], first["speed_time"]) == (3.0, 9.0)
    # of the range 1 to 5: 9 is 6 from the middle, 0 is 3 from it
    assert (first["range"], first["range_time"]) == (3.0, 9.0)
    still = numbered_block(0, 3)
    still["arms/left/joint_position"][:] = 1.0
    table = recorded(blocks=[still]).limit_use
    first = row(table, "left/shoulder_pan_joint")
    assert (first["range"], first["range_time"]) == (1.0, 0.0)


def test_what_has_no_limit_is_missing():
    run = recorded()
    table = run.limit_use
    assert table["joint"].tolist() == [f"{arm}/{joint}" for arm in JOINTS for joint in JOINTS[arm]]
    second = row(table, "left/shoulder_lift_joint")
    missing = second.index[second.isna()].tolist()
    assert missing == ["effort", "range", "effort_time", "range_time"]
    assert table.tail(RIGHT)[["effort", "speed"]].isna().all(axis=None)
    json.dumps([use.row() for use in joint_uses(run)], allow_nan=False)


def test_results_of_earlier_versions_have_a_table_without_shares():
    run = recorded(limits=None)
    assert len(run.limit_use) == LEFT + RIGHT
    assert run.limit_use.drop(columns="joint").isna().all(axis=None)
    assert largest_shares(run) == dict.fromkeys(QUANTITIES)
    assert limit_warnings(peaks(joint_uses(run))) == []


def test_a_run_without_samples_has_no_shares():
    assert recorded(blocks=[]).limit_use.drop(columns="joint").isna().all(axis=None)


def test_warnings_name_joint_share_time_and_remedy():
    largest = peaks(joint_uses(recorded()))
    effort, speed, span = limit_warnings(largest)
    assert "left/shoulder_pan_joint" in effort and "225 %" in effort and "t = 9 s" in effort
    assert "torque_limits" in effort and "lighter object" in effort
    assert "left/wrist_3_joint" in speed and "6 joints" in speed
    assert largest["range"].joint == "right/tilt" and "joint_limits" in span
    assert largest_shares(recorded()) == {q: largest[q].share for q in QUANTITIES}


def test_a_torque_cut_off_at_its_limit_is_no_warning():
    block = numbered_block(0, 3)
    block["arms/left/joint_torque"][:] = -4.0 * (1.0 + 1e-12)
    largest = peaks(joint_uses(recorded(blocks=[block])))
    assert largest["effort"].joint == "left/shoulder_pan_joint" and largest["effort"].beyond == 0


@pytest.mark.parametrize(
    "limits",
    [
        7,
        {"left": 7},
        {"left": {"effort": "x"}},
        {"left": {"effort": [1.0]}},
        {"left": {"effort": [0.0] * LEFT}},
        {"left": {"speed": ["1"] * (LEFT - 1) + ["x"]}},
        {"left": {"range": [[1.0, 2.0, 3.0]] * LEFT}},
        {"left": {"range": [[2.0, 1.0]] * LEFT}},
    ],
)
def test_limits_that_cannot_be_read_are_named(limits):
    with refused(TrajectoryError, "'left'"):
        _ = recorded(limits).limit_use


def test_positions_as_large_as_numbers_get_have_finite_shares():
    block = numbered_block(0, 3)
    block["arms/left/joint_position"][:] = LARGEST
    narrow = {"left": {"range": [[-1e-300, 1e-300]] * LEFT}}
    table = recorded(narrow, blocks=[block]).limit_use
    assert np.isfinite(table[table["joint"] == "left/shoulder_pan_joint"]["range"].to_numpy()).all()


def limits_in_the_file(path):
    """Joint -> effort, velocity, lower, upper, read as XML."""
    joints = ET.parse(path).getroot().iter("joint")
    limits = {j.get("name"): j.find("limit") for j in joints if j.get("type") == "revolute"}
    keys = ("effort", "velocity", "lower", "upper")
    return {name: [float(limit.get(key)) for key in keys] for name, limit in limits.items()}


def test_shares_of_a_run_are_those_of_inverse_dynamics_and_the_file(box):
    """tau = rnea(q, q', q'') - J^T w, with the wrench w of the object on the tip."""
    system, run = box
    table = run.limit_use
    shares = {name: {q: [] for q in QUANTITIES} for name in table["joint"]}
    for k in range(len(run)):
        state = system.state(
            run.object_position[k], run.object_quaternion_xyzw[k],
            {arm: run.joint_positions[arm][k] for arm in run.arm_names}, run.object_twist[k],
            {arm: run.joint_velocities[arm][k] for arm in run.arm_names},
        )  # fmt: skip
        ev = ma.evaluate(system, run.time[k], state)
        for name, arm in system.arms.items():
            file = limits_in_the_file(arm.files.urdf)
            q, v = state.joint_positions[name], state.joint_velocities[name]
            model = arm.model.copy()
            data = model.createData()
            axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            J = pin.computeFrameJacobian(model, data, q, arm.tip.frame_id, axes)
            force, moment = np.split(-ev.wrenches[name], 2)  # at the object's centre
            lever = run.object_position[k] - arm.tip_pose(q)[:3, 3]
            wrench = np.concatenate([force, moment + np.cross(lever, force)])
            tau = pin.rnea(model, data, q, v, ev.joint_accelerations[name]) - J.T @ wrench
            for j, joint in enumerate(arm.joint_names):
                effort, speed, lower, upper = file[joint]
                of_joint = shares[f"{name}/{joint}"]
                of_joint["effort"].append(abs(tau[j]) / effort)
                of_joint["speed"].append(abs(v[j]) / speed)
                of_joint["range"].append(
                    max((2 * q[j] - lower - upper), (lower + upper - 2 * q[j])) / (upper - lower)
                )
    for _, of_joint in table.iterrows():
        for quantity in QUANTITIES:
            course = np.array(shares[of_joint["joint"]][quantity])
            # torques are good to the solver's residual, 1e-9 of some 100 N m
            assert of_joint[quantity] == pytest.approx(course.max(), rel=1e-7, abs=1e-9)
            k = int(np.flatnonzero(run.time == of_joint[f"{quantity}_time"])[0])
            assert course[k] == pytest.approx(course.max(), rel=1e-7, abs=1e-9)


def test_an_object_that_is_too_heavy_shows_in_the_effort(box):
    system, run = box
    scene = system.scene
    heavy = scene.replace(object=scene.object.model_copy(update={"mass": 500.0}))
    overloaded = ma.simulate(ma.compile_system(heavy), duration=0.1, certificate=False)
    assert largest_shares(run)["effort"] < 0.5
    peak = peaks(joint_uses(overloaded))["effort"]
    assert peak.share > 5.0 and peak.beyond >= 4
    assert overloaded.status == "completed"


def test_many_runs_and_their_files_have_the_same_table(box, tmp_path):
    system, _ = box
    (run,) = ma.simulate_many(system, 0.05, states=[system.initial_state()])
    run.save(tmp_path / "run.h5")
    assert ma.load_trajectory(tmp_path / "run.h5").limit_use.equals(run.limit_use)
    assert run.limit_use["effort"].notna().all()


def test_a_run_stores_the_limits_of_the_robots_file(box):
    system, run = box
    stored = run.provenance["joint_limits"]["left"]
    file = limits_in_the_file(system.arms["left"].files.urdf)
    for j, joint in enumerate(system.arms["left"].joint_names):
        limits = [stored["effort"][j], stored["speed"][j], *stored["range"][j]]
        assert limits == file[joint]
