"""Torques that hold the object: against Pinocchio with the load appended, and another program."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from repository import SCENES
from scipy.optimize import linprog

import multiarm as ma
from multiarm.simulation.holding import carrying_capacity

G = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def box():
    """Two UR5s, welded to a box of 20 kg."""
    return ma.load_scene(SCENES / "two_ur5_box.yaml")


def heavier(scene, mass):
    return scene.replace(object=scene.object.model_copy(update={"mass": mass}))


def carrying(scene):
    system = ma.compile_system(scene)
    return system, carrying_capacity(system, ma.evaluate(system))


def alone(scene):
    """The left arm, welded to the end of a box of 2 kg."""
    return heavier(scene, 2.0).replace(
        arms={"left": scene.arms["left"]},
        joints=[{"arm": "left", "kind": "weld"}],
        control={"kind": "gravity_compensation"},
    )


def test_an_arm_alone_has_no_choice_and_holds_what_is_appended_to_it(box):
    system, capacity = carrying(alone(box))
    state, arm = system.initial_state(), system.arms["left"]
    q = state.joint_positions["left"]
    X = pin.SE3(arm.tip_pose(q))
    at_tip = X.inverse().act(state.object_position)
    model = arm.model.copy()
    load = pin.Inertia(2.0, at_tip, np.eye(3))
    place = pin.SE3(arm.tip.rotation, arm.tip.translation)
    model.appendBodyToJoint(arm.tip.joint, load, place)
    torques = pin.computeGeneralizedGravity(model, model.createData(), q)
    shares = dict(zip(arm.joint_names, np.abs(torques) / model.effortLimit, strict=True))
    assert capacity.possible and capacity.verdict == "carried"
    for found in (capacity.least, capacity.control):
        for joint, share in shares.items():  # torques are exact to roundings of 100 N m
            assert found.by_joint[f"left/{joint}"] == pytest.approx(share, abs=1e-9)
        assert found.largest == max(found.by_joint.values()) == found.by_joint[found.joint]


def least_by_wrenches(system):
    """The same program for the wrenches that welded tips exert: unknowns (6 an arm) and s."""
    state, rows, right, sums = system.initial_state(), [], [], []
    for k, (name, arm) in enumerate(system.arms.items()):
        q, model = state.joint_positions[name], arm.model.copy()
        data, axes = model.createData(), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(model, data, q, arm.tip.frame_id, axes)
        gravity = pin.computeGeneralizedGravity(model, data, q) / model.effortLimit
        # tau = g + J^T w, w on the object at the tip
        slope = J.T / model.effortLimit[:, None]
        wide = np.zeros((len(q), 6 * len(system.arms)))
        wide[:, 6 * k : 6 * k + 6] = slope
        rows += [np.hstack([s * wide, -np.ones((len(q), 1))]) for s in (1.0, -1.0)]
        right += [-gravity, gravity]
        lever = arm.tip_pose(q)[:3, 3] - state.object_position
        about_centre = np.eye(6)
        about_centre[3:, :3] = pin.skew(lever)
        sums.append(about_centre)
    weight = np.append(-system.scene.object.mass * G, np.zeros(3))
    best = linprog(
        np.append(np.zeros(6 * len(system.arms)), 1.0),
        A_ub=np.concatenate(rows), b_ub=np.concatenate(right),
        A_eq=np.hstack([*sums, np.zeros((6, 1))]), b_eq=weight,
        bounds=(None, None),
    )  # fmt: skip
    assert best.status == 0
    return best.x[-1]


@pytest.mark.parametrize("mass", [20.0, 500.0])
def test_the_least_share_is_that_of_a_program_for_the_wrenches_of_the_tips(box, mass):
    system, capacity = carrying(heavier(box, mass))
    expected = least_by_wrenches(system)
    assert capacity.least.largest == pytest.approx(expected, rel=1e-6)
    assert capacity.possible == (expected < 1.0)
    assert capacity.control.largest >= capacity.least.largest


def test_too_heavy_an_object_cannot_be_carried_although_the_forces_balance(box):
    _, capacity = carrying(heavier(box, 500.0))
    assert capacity.verdict == "effort" and not capacity.possible
    assert capacity.force_residual < 1e-9 * 500.0 * 9.81
    assert capacity.least.largest > 5.0
    assert capacity.control.largest > 8.0


def fingertips(side):
    face = {"plane": {"point": [side * 0.6, 0, 0], "normal": [side, 0, 0]}}
    return [
        {
            "name": f"finger {k + 1}",
            "arm": {"sphere": {"center": [y, z, -0.02], "radius": 0.02}},
            "object": face,
        }
        for k, (y, z) in enumerate([(0.06, 0.036), (-0.06, 0.036), (0.0, -0.06)])
    ]


def gripped(scene, effects):
    """Three fingertips on each end of the box, 6 kg, whose weight only friction can carry."""
    joints = [
        {"arm": arm, "kind": "contacts", "contacts": fingertips(side)}
        for arm, side in (("left", -1.0), ("right", 1.0))
    ]
    return heavier(scene, 6.0).replace(
        joints=joints, control={"kind": "gravity_compensation"}, effects=effects
    )


def test_fingertips_on_the_ends_carry_by_friction_only(box):
    _, capacity = carrying(gripped(box, {}))
    assert capacity.verdict == "wrench"
    assert capacity.force_residual == pytest.approx(6.0 * 9.81, rel=1e-9)
    _, capacity = carrying(gripped(box, {"contact_friction": 0.8}))
    assert capacity.verdict == "carried"


def test_less_friction_takes_more_squeeze_and_so_more_torque(box):
    least = [carrying(gripped(box, {"contact_friction": mu}))[1].least.largest for mu in (0.5, 0.1)]
    assert least[0] < least[1]


@pytest.mark.parametrize("mu", [0.8, 0.1])
def test_the_largest_force_is_the_squeeze_that_friction_needs(box, mu):
    """Six equal normal forces: in all they are the weight over mu, and no other six are smaller."""
    _, capacity = carrying(gripped(box, {"contact_friction": mu}))
    smallest = 9.81 / mu  # of 6 kg; the polygon in the cone takes up to 1 / cos(pi / 16) of it
    assert smallest * (1.0 - 1e-6) < capacity.largest_force
    assert capacity.largest_force < smallest / np.cos(np.pi / 16) * (1.0 + 1e-6)


def test_where_no_forces_carry_there_is_no_largest_one(box):
    assert carrying(gripped(box, {}))[1].largest_force is None


@pytest.mark.parametrize(("gravity", "verdict"), [(-9.81, "carried"), (9.81, "pushing")])
def test_fingertips_push_an_object_and_do_not_pull_it(box, gravity, verdict):
    """One arm behind the box, which weighs along the normals: onto the fingertips, or off them."""
    scene = alone(box).replace(
        gravity=[gravity, 0.0, 0.0],
        joints=[{"arm": "left", "kind": "contacts", "contacts": fingertips(-1.0)}],
    )
    _, capacity = carrying(scene)
    assert capacity.verdict == verdict and capacity.force_residual < 1e-9
    assert (capacity.least is None) == (verdict == "pushing")


def test_without_weight_or_on_a_floor_or_without_control_there_is_no_verdict(box):
    for changes in (
        {"gravity": None},
        {"control": {"kind": "none"}},
        {"effects": {"floor": {"at": {"xyz": [0, 0, 0.3]}, "mu": 0.5}}},
    ):
        assert carrying(box.replace(**changes))[1] is None
