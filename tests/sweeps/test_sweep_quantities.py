"""Claims about what a sweep keeps of a run: numbers told otherwise, functions of the user's."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import ur5_pair
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.sweeps.quantities import KNOWN, UserQuantity, measure

GOAL, TURN = np.array([0.02, 0.0, 0.53]), [0.0, 0.0, 0.2]
PATH = [{"time": 0.4, "xyz": GOAL.tolist(), "rpy": TURN}]
RUN = {"duration": 0.1, "accuracy": 1e-6, "arms": "compiled"}


@pytest.fixture(scope="module")
def run():
    control = {"kind": "joint_pd", "stiffness": 500.0, "damping": 50.0, "path": PATH}
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}, control=control, run=RUN)
    return ma.simulate(ma.compile_system(scene))


def test_the_final_error_is_that_to_the_path_at_the_end_of_the_run(run):
    """A quarter of the way in time, by the quintic that begins and ends at rest."""
    s = 0.25
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    numbers, fault = measure(["final_position_error", "final_rotation_error"], run)
    target = run.object_position[0] + share * (GOAL - run.object_position[0])
    turned = Rotation.from_quat(run.object_quaternion_xyzw)
    wanted = Rotation.from_rotvec(share * np.array(TURN)) * turned[0]
    assert fault == ""
    assert numbers["final_position_error"] == pytest.approx(
        np.linalg.norm(run.object_position[-1] - target), rel=1e-9
    )
    assert numbers["final_rotation_error"] == pytest.approx(
        (turned[-1] * wanted.inv()).magnitude(), rel=1e-6
    )


def test_after_the_last_waypoint_the_final_error_is_that_to_it(run):
    early = [{**PATH[0], "time": 0.05}]
    control = {**run.scene.control.model_dump(), "path": early}
    late = run.with_outcome()
    late._scene = run.scene.replace(control=control)
    numbers, _ = measure(["final_position_error"], late)
    expected = np.linalg.norm(run.object_position[-1] - GOAL)
    assert numbers["final_position_error"] == pytest.approx(expected, rel=1e-12)


def test_without_a_path_the_final_error_is_that_to_the_start(run):
    still = run.with_outcome()
    still._scene = run.scene.replace(control={"kind": "none"})
    numbers, _ = measure(["final_position_error", "final_rotation_error"], still)
    moved = np.linalg.norm(run.object_position[-1] - run.object_position[0])
    assert numbers["final_position_error"] == pytest.approx(moved, rel=1e-12)
    turned = Rotation.from_quat(run.object_quaternion_xyzw)
    angle = (turned[-1] * turned[0].inv()).magnitude()
    assert numbers["final_rotation_error"] == pytest.approx(angle, rel=1e-6)


def test_the_others_are_what_the_summary_of_the_run_says(run):
    summary = run.summary()
    numbers, fault = measure([*KNOWN], run)
    x, y, z = summary["final_object_position"]
    expected = {
        "final_x": x,
        "final_y": y,
        "final_z": z,
        "largest_contact_force": max(summary["contact_force_max_N"].values()),
        "position_drift": summary["position_drift_max_m"],
        "velocity_drift": summary["velocity_drift_max_m_per_s"],
        "energy_balance": summary["energy_balance_max_J"],
        "steps": summary["steps"],
        "evaluations": summary["evaluations"],
        "estimated_error": run.certificate["estimated_error"]["position_m"],
        "events": len(run.events),
        "final_energy": run.energy[-1],
        "work": run.work[-1],
        "largest_joint_torque": max(np.abs(t).max() for t in run.joint_torques.values()),
        "largest_effort_share": run.limit_use["effort"].max(),
        "largest_speed_share": run.limit_use["speed"].max(),
        "largest_range_share": run.limit_use["range"].max(),
        "largest_speed": np.linalg.norm(run.object_twist[:, :3], axis=1).max(),
        "largest_turn_rate": np.linalg.norm(run.object_twist[:, 3:], axis=1).max(),
    }
    assert fault == ""
    assert expected.items() <= numbers.items()
    assert set(numbers) == set(KNOWN)
    assert all(type(number) is float for number in numbers.values())


def test_an_unchecked_run_has_no_estimated_error(run):
    unchecked = run.with_outcome(certificate=None)
    assert measure(["estimated_error"], unchecked) == ({"estimated_error": None}, "")


def test_functions_of_ones_own_are_kept_by_their_names(run, tmp_path):
    file = tmp_path / "own.py"
    file.write_text(
        "calls = []\n"
        "def last(trajectory):\n"
        "    return trajectory.time[-1]\n"
        "def both(trajectory):\n"
        "    calls.append(1)\n"
        "    return {'a': 1, 'b': len(calls)}\n"
    )
    quantities = [
        UserQuantity(function=f"{file}:last", unit="s", words="the end"),
        UserQuantity(function=f"{file}:both", gives=["a", "b"]),
        UserQuantity(function=lambda trajectory: True, name="yes"),
        UserQuantity(function=lambda trajectory: np.array([[2.5]])),
    ]
    numbers, fault = measure(quantities, run)
    assert fault == ""
    assert numbers == {"last": 0.1, "both.a": 1.0, "both.b": 1.0, "yes": 1.0, "lambda": 2.5}


@pytest.mark.parametrize(
    ("function", "more", "text"),
    [
        (lambda trajectory: 1 / 0, {}, "raised ZeroDivisionError: division by zero"),
        (lambda trajectory: float("nan"), {}, "gave nan, which is not finite"),
        (lambda trajectory: None, {}, "quantity 'mine' must give a number, it gave None"),
        (lambda trajectory: "1", {}, "must give a number, it gave '1'"),
        (lambda trajectory: 1.0, {"gives": ["a"]}, "must give a table of numbers, it gave 1.0"),
        (lambda trajectory: {"a": 1}, {"gives": ["a", "b"]}, "gave a; its 'gives' lists a, b"),
        (lambda trajectory: {"a": 1j}, {"gives": ["a"]}, "quantity 'mine [a]' must give a number"),
    ],
)  # fmt: skip
def test_a_function_that_fails_says_so_and_leaves_the_others_alone(run, function, more, text):
    mine = UserQuantity(function=function, name="mine", **more)
    numbers, fault = measure(["steps", mine, "final_z"], run)
    assert text in fault
    assert {numbers[name] for name in mine.names} == {None}
    assert numbers["steps"] > 0 and numbers["final_z"] is not None
