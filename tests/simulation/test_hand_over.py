"""Claims about a certified hand-over: one arm holds a box, two do, the other, and a third one.

Oracle: the same run a thousand times as accurate; gaps from the poses of tips and box; works.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import UR5_POSTURE
from scipy.spatial.transform import Rotation
from timed_scenes import Table, switches

import multiarm as ma
from multiarm.scene import parse_scene

ACCURACY, REFERENCE = 1e-6, 1e-9
PHASES = {"left": (0.0, 0.5), "right": (0.3, 0.9), "third": (0.7, math.inf)}
"""When each arm holds the box [s]."""
END = 1.1
# Gaps are closed to the roundings of positions of a metre.
GAP, ENERGY = 1e-12, 1e-9


def hand_over(arms: str) -> Table:
    """UR5s whose joints are springs and dampers carry a box that the left one has swung."""
    bases = {
        "left": {"xyz": [-1.1, 0.0, 0.0]},
        "right": {"xyz": [1.1, 0.0, 0.0], "rpy": [0.0, 0.0, math.pi]},
        "third": {"xyz": [0.0, -1.1, 0.0], "rpy": [0.0, 0.0, 0.5 * math.pi]},
    }
    robot = {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE}
    swing = {"velocity": [0.3, -0.2, 0.3, 0.2, -0.3, 0.4]}
    joints = []
    for name, (begin, end) in PHASES.items():
        joint: Table = {"arm": name, "kind": "weld"}
        if begin > 0.0:
            joint["from"] = begin
        if end < math.inf:
            joint["until"] = end
        joints.append(joint)
    return {
        "gravity": [0.0, 0.0, -9.81],
        "object": {"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 3.0, "pose": {"xyz": [0, 0, 0.5]}},
        "arms": {
            name: {**robot, **(swing if name == "left" else {}), "base": base}
            for name, base in bases.items()
        },
        "joints": joints,
        "control": {"kind": "joint_pd", "stiffness": 60.0, "damping": 2.0,
                    "gravity_compensation": True},
        "run": {"duration": END, "accuracy": ACCURACY, "output_step": 0.02, "arms": arms},
    }  # fmt: skip


@pytest.fixture(scope="module", params=["pinocchio", "compiled"])
def runs(request):
    system = ma.compile_system(parse_scene(hand_over(request.param)))
    return ma.simulate(system), ma.simulate(system, accuracy=REFERENCE, certificate=False)


def test_the_certificate_is_met_and_true(runs):
    run, reference = runs
    assert run.status == reference.status == "completed"
    assert run.certificate["met"]
    apart = np.max(np.linalg.norm(run.object_position - reference.object_position, axis=1))
    turned = (
        Rotation.from_quat(run.object_quaternion_xyzw)
        * Rotation.from_quat(reference.object_quaternion_xyzw).inv()
    )
    angles = [
        np.max(np.abs(run.joint_positions[name] - reference.joint_positions[name]))
        for name in PHASES
    ]
    assert max(apart, np.max(turned.magnitude()), *angles) < ACCURACY
    assert apart < 2.0 * run.certificate["estimated_error"]["position_m"] + 1e-9


def test_arms_take_hold_and_let_go_in_turn(runs):
    run, reference = runs
    log = [(e["kind"], e["arm"], e["time"]) for e in switches(run)]
    assert log == [
        ("attached", "right", 0.3), ("detached", "left", 0.5),
        ("attached", "third", 0.7), ("detached", "right", 0.9),
    ]  # fmt: skip
    for event, accurate in zip(switches(run), switches(reference), strict=True):
        np.testing.assert_allclose(event["impulse"], accurate["impulse"], atol=1e-4)
        np.testing.assert_allclose(event["energy_loss"], accurate["energy_loss"], atol=1e-5)
    assert all(e["energy_loss"] > 1e-4 for e in switches(run) if e["kind"] == "attached")


def test_what_holds_is_closed_in_every_phase(runs):
    """The pose of each tip that holds, as the box sees it, is the one with which it took hold."""
    for run in runs:
        assert np.max(run.position_drift) < GAP
        boxes = Rotation.from_quat(run.object_quaternion_xyzw)
        for name, (begin, end) in PHASES.items():
            held = (run.time > begin + 1e-9) & (run.time <= end)
            held |= (run.time == begin) & (begin == 0.0)
            lever = boxes.inv().apply(run.tip_positions[name] - run.object_position)[held]
            turn = (boxes.inv() * Rotation.from_quat(run.tip_quaternions_xyzw[name]))[held]
            assert np.max(np.abs(lever - lever[0])) < GAP, name
            assert np.max((turn * turn[0].inv()).magnitude()) < GAP, name
            loose = ~held & (run.time != begin)
            assert not np.any(run.wrenches[name][loose]), name
            assert np.all(np.linalg.norm(run.wrenches[name][held], axis=1) > 0.1), name


def test_works_and_losses_balance_the_energy(runs):
    run, reference = runs
    losses = sum(e["energy_loss"] for e in switches(reference))
    np.testing.assert_allclose(reference.effect_works["impacts"][-1], -losses, rtol=1e-12)
    assert np.max(np.abs(reference.energy_balance)) < ENERGY
    assert np.max(np.abs(run.energy_balance)) < ENERGY
