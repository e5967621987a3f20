"""Claims about events of robots with several connections: they are those of separate arms.

Oracle: the arms of a scene written as one robot with several tips; both move alike.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from event_scenes import held_box, lifting
from mechanics import ur5_pair
from merged_arms import ROBOT, as_one_robot, joints_by_arm
from tree_models import read_tree_scene
from tree_scenes import arm_joined_twice, gripper_scene

import multiarm as ma
from multiarm.dynamics.contact_geometry import place_state
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


def check_motion(pair: Pair) -> None:
    arms, robot, system = pair
    assert arms.status == robot.status == "completed", f"{arms.message}\n{robot.message}"
    np.testing.assert_allclose(robot.object_position, arms.object_position, atol=SAME)
    for name, positions in joints_by_arm(system, robot.joint_positions[ROBOT]).items():
        np.testing.assert_allclose(positions, arms.joint_positions[name], atol=SAME)
    np.testing.assert_allclose(robot.work, arms.work, atol=1e2 * SAME)


def check(pair: Pair, events: bool = True, forces: bool = True) -> None:
    check_motion(pair)
    arms, robot, _ = pair
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
    """Forces of redundant contacts at rest are not unique, nor is which of these slides first."""
    scene = ur5_pair(
        {"kind": "prismatic", "axis": [0, 1, 0], "mu": 0.05}, {"kind": "revolute", "mu": 0.2}
    )
    pair = both(scene, tmp_path, 0.15)
    check_motion(pair)
    assert any(event["kind"] == "slides" for event in pair.robot.events)


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


# --- inner loops and couplings -------------------------------------------------------------------


def crank_inertia(scene, angle: float) -> float:
    """Inertia of a four-bar gripper, all of whose joints have the crank's angle [kg m^2]."""
    model = read_tree_scene(scene).robots["gripper"].model
    inertia = pin.crba(model, model.createData(), angle * np.ones(6))
    ones = np.ones(6)
    return float(ones @ (np.triu(inertia) + np.triu(inertia, 1).T) @ ones)


@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_both_fingers_come_to_their_stops_at_once(restitution):
    """The stops of coupled joints are redundant: together they reverse the crank."""
    scene = gripper_scene(0.6)
    weld = {"between": ["object", "world"], "kind": "weld", "at": scene["object"]["pose"]}
    scene["joints"] = [*scene["joints"][2:], weld]
    scene["control"] = {"kind": "constant", "torques": {"gripper": [0.3, *[0.0] * 5]}}
    scene["effects"] = {"joint_limits": {"range": "urdf", "restitution": restitution}}
    system = ma.compile_system(parse_scene(scene))
    run = ma.simulate(system, 0.03, integrator="dop853", tolerance=1e-10)
    assert run.status == "completed", run.message
    hits = [event for event in run.events if "after" in event]
    assert {hit["joint"] for hit in hits} == {"left_driver_joint", "right_driver_joint"}
    before, after = (np.array([h[s]["gap_rate_rad_s"] for h in hits]) for s in ("before", "after"))
    np.testing.assert_allclose(after, -restitution * before, atol=1e-8)
    impulse = sum(hit["after"]["impulse_N_m_s"] for hit in hits)
    expected = crank_inertia(scene, 0.7) * (1.0 + restitution) * -before[0]
    assert impulse == pytest.approx(expected, rel=1e-7)
    assert np.max(run.joint_positions["gripper"]) < 0.7 + 1e-9
    assert np.max(np.abs(run.energy_balance)) < 1e-9


def squeezed_box(torque: float, mu: float) -> dict:
    """A gripper with three round bumps on each pad, between which there is a box."""
    scene, radius = gripper_scene(0.3), 0.004
    tips = ma.compile_system(parse_scene(scene)).kinematics().tips
    left, right = tips["gripper/left"], tips["gripper/right"]
    middle = 0.5 * (left.position + right.position)
    half, joints = 0.5 * abs(left.position[0] - right.position[0]) - radius, []
    for name, tip in (("left", left), ("right", right)):
        side = float(np.sign(tip.position[0] - middle[0]))
        face = {"plane": {"point": [side * half, 0, 0], "normal": [side, 0, 0]}}
        contacts = [
            {
                "arm": {"sphere": {"center": (tip.rotation.T @ place).tolist(), "radius": radius}},
                "object": face,
            }
            for place in ([0, 0.01, 0], [0, -0.005, 0.0087], [0, -0.005, -0.0087])
        ]
        joints.append({"arm": f"gripper/{name}", "kind": "contacts", "contacts": contacts})
    box = {"shape": {"box": [2 * half, 0.05, 0.08]}, "mass": 0.4, "pose": {"xyz": middle.tolist()}}
    return {
        **scene,
        "object": box,
        "joints": [*joints, *scene["joints"][2:]],
        "effects": {"unilateral_contacts": {"start": "as_written"}, "contact_friction": mu},
        "control": {"kind": "constant", "torques": {"gripper": [torque, *[0.0] * 5]}},
    }


def test_a_gripper_holds_a_box_by_friction_and_lets_it_slip():
    """Held at rest, by the principle of virtual work the crank balances weight and pads."""
    scene = squeezed_box(2.0, 1.0)
    system = ma.compile_system(parse_scene(scene))
    run = ma.simulate(system, 0.05, integrator="dop853", tolerance=1e-10)
    assert run.status == "completed", run.message
    np.testing.assert_allclose(run.object_position[-1], run.object_position[0], atol=1e-12)
    assert set(run.contact_states["gripper/left"].ravel()) <= {3.0, 4.0}  # sticking, resting
    pads = [run.wrenches[f"gripper/{name}"][-1] for name in ("left", "right")]
    np.testing.assert_allclose(sum(pads), [0, 0, 0.4 * 9.81, 0, 0, 0], atol=1e-9)
    tips, work = system.kinematics().tips, 2.0
    for name, wrench in zip(("left", "right"), pads, strict=True):
        tip = tips[f"gripper/{name}"]
        about_tip = wrench[3:] - np.cross(tip.position - run.object_position[0], wrench[:3])
        work -= np.concatenate([wrench[:3], about_tip]) @ tip.jacobian @ np.ones(6)
    gravity = system.arms["gripper"].gravity_torque(0.3 * np.ones(6), np.array([0, 0, -9.81]))
    assert work == pytest.approx(gravity.sum(), abs=1e-9)
    slipping = ma.simulate(ma.compile_system(parse_scene(squeezed_box(0.2, 0.3))), 0.05)
    assert slipping.status == "completed", slipping.message
    assert slipping.object_position[-1, 2] < slipping.object_position[0, 2] - 1e-4


def test_an_evaluation_with_friction_certifies_itself():
    system = ma.compile_system(parse_scene(squeezed_box(2.0, 1.0)))
    ev = ma.evaluate(system)
    assert ev.message == ""
    assert set(ev.contact_states["gripper/left"]) <= {"sticking", "resting"}
    size = max(np.max(np.abs(force)) for force in ev.contact_forces.values())
    assert max(ev.residuals.arm, ev.residuals.object) < 1e-12 * max(size, 1.0)
    assert ev.residuals.constraint < 1e-9
    assert ev.contact_forces.keys() == ev.contact_forces_unique.keys()
    assert ev.contact_forces["gripper"].shape == (1,)  # the coupling of the cranks
    assert {name: f.size for name, f in ev.normal_forces.items()}["gripper/left"] == 3


def test_stops_of_an_arm_with_two_connections_are_where_its_joints_end():
    """Their gaps are the distances of the joints from the ends of their ranges, 2 rad."""
    system = ma.compile_system(parse_scene(arm_joined_twice(effects={"joint_limits": {}})))
    start = system.initial_state()
    with system.borrow() as data:
        place_state(data, 0.0, start)
        gaps = data.contact_rows.gap.copy()
    stops = {constraint.name: constraint.row for constraint in system.model.unilateral.constraints}
    ends = {}
    for joint, position in zip(("j1", "j2"), start.joint_positions["left"], strict=True):
        ends[f"{joint} at its lower limit"] = 2.0 + position
        ends[f"{joint} at its upper limit"] = 2.0 - position
    assert {name: gaps[row] for name, row in stops.items()} == pytest.approx(ends, abs=1e-15)
