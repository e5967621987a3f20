"""Claims about events of robots with several connections: they are those of separate arms.

Oracle: the arms of a scene written as one robot with several tips; both move alike.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from event_scenes import held_box, lifting
from mechanics import ur5_pair
from merged_arms import ROBOT, as_one_robot, joints_by_arm

import multiarm as ma
from multiarm.scene import parse_scene

WELD, BALL = {"kind": "weld"}, {"kind": "ball"}
# Both runs have errors of the tolerance of a step, 1e-9, times a growth of some hundreds.
TOLERANCE, SAME = 1e-9, 1e-6


class Pair(NamedTuple):
    """A run of arms, and that of the robot that is made of them."""

    arms: ma.Trajectory
    robot: ma.Trajectory
    system: ma.System  # of the robot


def both(scene, folder, duration, control=None, **more) -> Pair:
    more = {"tolerance": TOLERANCE, "integrator": "dop853", **more}
    system = ma.compile_system(scene)
    merged = ma.compile_system(parse_scene(as_one_robot(system, folder)))
    of_robot = None if control is None else as_robot(control, merged)
    return Pair(
        ma.simulate(system, duration, control=control, **more),
        ma.simulate(merged, duration, control=of_robot, **more),
        merged,
    )


def as_robot(control: Callable, system: ma.System) -> Callable:
    """The controller of the arms for the robot."""
    names = system.arms[ROBOT].joint_names

    class ArmsState(NamedTuple):
        joint_positions: dict[str, np.ndarray]
        joint_velocities: dict[str, np.ndarray]

    def torques(t, state):
        of_arms = ArmsState(
            joints_by_arm(system, state.joint_positions[ROBOT]),
            joints_by_arm(system, state.joint_velocities[ROBOT]),
        )
        stacked = np.zeros(len(names))
        for arm, row in control(t, of_arms).items():
            stacked[[k for k, name in enumerate(names) if name.startswith(f"{arm}_")]] = row
        return {ROBOT: stacked}

    return torques


def alike(event) -> tuple:
    """What must be the same of an event, with the arm's names."""
    joint, arm = event.get("joint", ""), event.get("arm", "").removeprefix(f"{ROBOT}/")
    if arm == ROBOT:  # joints are the robot's
        arm, _, joint = joint.partition("_")
    return event["kind"], arm, event.get("contact", ""), joint


def check(pair: Pair, events: bool = True, forces: bool = True) -> None:
    arms, robot, system = pair
    assert arms.status == robot.status == "completed", f"{arms.message}\n{robot.message}"
    np.testing.assert_allclose(robot.object_position, arms.object_position, atol=SAME)
    for name, positions in joints_by_arm(system, robot.joint_positions[ROBOT]).items():
        np.testing.assert_allclose(positions, arms.joint_positions[name], atol=SAME)
    np.testing.assert_allclose(robot.work, arms.work, atol=1e2 * SAME)
    if forces:
        for name in arms.arm_names:
            rows = robot.contact_forces[f"{ROBOT}/{name}"]
            of_arm = arms.contact_forces[name][:, : rows.shape[1]]
            size = np.max(np.abs(of_arm))
            np.testing.assert_allclose(rows, of_arm, atol=1e2 * SAME * max(size, 1.0))
            np.testing.assert_array_equal(
                robot.contact_states[f"{ROBOT}/{name}"], arms.contact_states[name]
            )
    mine, theirs = (
        [e for e in run.events if e["kind"] not in ("start", "loses a direction")]
        for run in (robot, arms)
    )
    assert sorted(map(alike, mine)) == sorted(map(alike, theirs))
    for first, second in zip(sorted(mine, key=_order), sorted(theirs, key=_order), strict=True):
        assert first["time"] == pytest.approx(second["time"], abs=10.0 * SAME)
    if events:
        assert mine


def _order(event) -> tuple:
    return alike(event), event["time"]


@pytest.mark.parametrize(("mu", "rise", "events"), [(0.5, 6.0, False), (0.2, 0.0, True)])
def test_two_hands_hold_a_box_or_let_it_slip(tmp_path, mu, rise, events):
    check(both(held_box(mu), tmp_path, 0.2, lifting(rise)), events)


def test_joints_with_friction_slide_and_stick(tmp_path):
    scene = ur5_pair(
        {"kind": "prismatic", "axis": [0, 1, 0], "mu": 0.05}, {"kind": "revolute", "mu": 0.2}
    )
    check(both(scene, tmp_path, 0.15))


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_an_elbow_stops(tmp_path, restitution):
    scene = ur5_pair(WELD, BALL)
    start = ma.compile_system(scene).initial_state().joint_positions["left"][2]
    ends = {"range": {"left": {"elbow_joint": [start - 0.02, start + 0.02]}}}
    effects = {"joint_limits": {**ends, "restitution": restitution}}
    check(both(scene.replace(effects=effects), tmp_path, 0.3), forces=False)


def test_dry_friction_holds_some_joints(tmp_path):
    scene = ur5_pair(WELD, BALL).replace(
        gravity=None,
        effects={"joint_friction": {"torque": 2.0, "model": "set_valued"}},
        control={"kind": "constant", "torques": {"left": [9.0, 3.0, 1.0, 1.0, 1.0, 1.0]}},
    )
    check(both(scene, tmp_path, 0.3), forces=False)


def test_compliant_contacts_press(tmp_path):
    spring = {"stiffness": 2e4, "damping": 50.0}
    scene = held_box(0.5)
    effects = {"unilateral_contacts": {"start": "as_written"}, "contact_compliance": spring}
    check(both(scene.replace(effects=effects), tmp_path, 0.1, lifting(0.0)), events=False)


def test_the_object_lands_on_the_floor(tmp_path):
    scene = held_box(0.2)
    floor = {"at": {"xyz": [0, 0, scene.object.pose.xyz[2] - 0.17]}, "mu": 0.3}
    effects = {
        "unilateral_contacts": {"start": "as_written"}, "contact_friction": 0.2, "floor": floor,
    }  # fmt: skip
    pair = both(scene.replace(effects=effects), tmp_path, 0.25, lifting(0.0))
    check(pair)
    floors = [run.contact_forces["floor"] for run in (pair.robot, pair.arms)]
    np.testing.assert_allclose(*floors, atol=1e2 * SAME * np.max(floors[1]))
    assert np.max(floors[1]) > 0.5
