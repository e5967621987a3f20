"""Claims about joints without a drive: nothing gives them a torque, and the others do their part.

The references are NumPy's pseudo-inverse of all conditions on the contact forces, the forward
solution under the torques, and a controller that leaves the joint alone.
"""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from commands import command
from held_boxes import WELD as ON_BEAM
from held_boxes import moving_state, two_boxes
from mechanics import panda_trio, single_arm, ur5_pair
from refusals import refused

import multiarm as ma
from multiarm.assembly.start_warnings import start_warnings
from multiarm.dynamics.contact_geometry import force_directions
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.errors import ControlError, ModelError, SceneError, SolverError
from multiarm.scene import dump_scene, parse_scene

WELD = {"kind": "weld"}
JOINT, PLACE = "elbow_joint", 2  # of the left UR5
PATH = [{"time": 0.5, "xyz": [0.03, -0.02, 0.56], "rpy": [0.1, 0.05, -0.1]}]
TRACKING = {"kind": "computed_torque", "path": PATH}
SPRING = {
    "kind": "object_impedance",
    "stiffness": {"translation": 900.0, "rotation": 90.0},
    "damping": {"translation": 150.0, "rotation": 15.0},
}
SERVO = {"kind": "joint_pd", "stiffness": 900.0, "damping": 60.0}


def pair(control="none", passive=(JOINT,), **more) -> ma.System:
    scene = ur5_pair(WELD, WELD, control=control, **more)
    return ma.compile_system(scene.replace({"arms.left.passive": list(passive)}))


def directions(system: ma.System, state: ma.State) -> np.ndarray:
    """What unit contact forces do to the object, and to the passive joint of the left arm."""
    with system.borrow() as data:
        data.set_state(0.0, state)
        require_ok(data, update_kinematics(data.struct))
        every = force_directions(data)
    return np.vstack([every[:6], every[6 + PLACE]])


def test_weight_is_carried_with_the_least_contact_forces_and_no_torque_of_the_joint():
    system = pair("gravity_compensation")
    start = system.initial_state()
    ev = ma.evaluate(system)
    assert np.abs(ev.accelerations).max() < 1e-9
    assert ev.joint_torques["left"][PLACE] == 0.0
    gravity = system.arms["left"].gravity_torque(start.joint_positions["left"], [0, 0, -9.81])
    wanted = np.zeros(7)
    wanted[2], wanted[6] = 9.81 * system.scene.object.mass, gravity[PLACE]
    least = np.linalg.pinv(directions(system, start)) @ wanted
    np.testing.assert_allclose(np.concatenate([*ev.contact_forces.values()]), least, atol=1e-8)
    assert start_warnings(system) == []


@pytest.mark.parametrize("control", [TRACKING, SPRING, SERVO], ids=["path", "spring", "servo"])
def test_no_law_gives_the_joint_a_torque(control):
    system = pair(control)
    state = moving_state(system, 2)
    assert ma.evaluate(system, 0.1, state).joint_torques["left"][PLACE] == 0.0
    driven = ma.compile_system(ur5_pair(WELD, WELD, control=control))
    other = ma.evaluate(driven, 0.1, state).joint_torques["left"]
    assert abs(other[PLACE]) > 0.1


@pytest.mark.parametrize("control", [TRACKING, SPRING], ids=["path", "spring"])
def test_the_object_moves_as_if_the_joint_had_a_drive(control):
    driven, system = ma.compile_system(ur5_pair(WELD, WELD, control=control)), pair(control)
    state = moving_state(system, 2)
    expected = ma.evaluate(driven, 0.1, state)
    ev = ma.evaluate(system, 0.1, state)
    np.testing.assert_allclose(ev.accelerations, expected.accelerations, atol=1e-8)


def test_an_object_follows_its_path_through_a_passive_joint():
    run = ma.simulate(pair(TRACKING), duration=0.7, accuracy=1e-7)
    assert run.status == "completed", run.message
    np.testing.assert_allclose(run.object_position[-1], PATH[0]["xyz"], atol=1e-6)
    assert not np.any(run.joint_torques["left"][:, PLACE])
    assert np.any(run.joint_torques["left"][:, PLACE + 1])


def test_torques_that_a_caller_gives_leave_the_joint_alone():
    system, torques = pair(), {"left": np.arange(1.0, 7.0), "right": np.full(6, -2.0)}
    without = {**torques, "left": torques["left"] * (np.arange(6) != PLACE)}
    states = []
    for given in (torques, without):
        stepper = ma.Stepper(system, accuracy=1e-6)
        states.append(stepper.advance(0.01, torques=given))
    np.testing.assert_array_equal(states[0].position, states[1].position)
    state = moving_state(system, 4)
    ev = ma.evaluate(system.with_control(lambda t, s: torques), 0.0, state)
    driven = ma.compile_system(ur5_pair(WELD, WELD)).with_control(lambda t, s: without)
    expected = ma.evaluate(driven, 0.0, state)
    np.testing.assert_allclose(ev.accelerations, expected.accelerations, atol=1e-9)
    np.testing.assert_array_equal(ev.joint_torques["left"], without["left"])


@pytest.mark.parametrize("control", [TRACKING, SPRING, SERVO], ids=["path", "spring", "servo"])
def test_derivatives_are_those_of_differences(control, rng):
    system = pair(control)
    state = moving_state(system, 2)
    derivatives = ma.derivatives(system, 0.1, state)
    direction = rng.standard_normal(state.layout.nv)

    def accelerations(h):
        moved = state.displaced(h * direction)
        return ma.evaluate(system, 0.1, moved).accelerations

    h = 1e-4
    slope = (8 * (accelerations(h) - accelerations(-h))
             - (accelerations(2 * h) - accelerations(-2 * h))) / (12 * h)  # fmt: skip
    found = derivatives.matrix[: state.layout.nv, state.layout.displacement_columns] @ direction
    np.testing.assert_allclose(found, slope, atol=1e-6 * np.abs(slope).max())


# --- inverse dynamics ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "build",
    [
        lambda: ur5_pair(WELD, WELD).replace({"arms.left.passive": [JOINT]}),
        lambda: ur5_pair(WELD, WELD).replace(
            {"arms.left.passive": [JOINT, "wrist_1_joint"], "arms.right.passive": [JOINT]}
        ),
        lambda: panda_trio(WELD).replace({"arms.east.passive": ["panda_joint4"]}),
        lambda: parse_scene(two_boxes(ON_BEAM)).replace({"arms.right.passive": [JOINT]}),
    ],
    ids=["one", "three", "redundant", "two objects"],
)
def test_torques_of_the_driven_joints_make_the_wanted_motion(build, rng):
    system = ma.compile_system(build())
    state = moving_state(system, 3)
    name = system.model.layout.objects[0]
    wanted = {name: rng.standard_normal(6)}
    answer = ma.inverse_dynamics(system, state, wanted)
    for joint in system.model.layout.passive_joints:
        assert np.concatenate([*answer.torques.values()])[joint] == 0.0
    ev = ma.evaluate(system.with_control(lambda t, s: answer.torques), 0.0, state)
    np.testing.assert_allclose(ev.object_accelerations[name], wanted[name], atol=1e-8)
    for arm, rates in answer.joint_accelerations.items():
        np.testing.assert_allclose(ev.joint_accelerations[arm], rates, atol=1e-7)


def test_contact_forces_change_as_little_as_they_can(rng):
    """From those that are wanted, which are internal ones besides."""
    system = pair()
    state, wanted = moving_state(system, 3), rng.standard_normal(6)
    driven = ma.compile_system(ur5_pair(WELD, WELD))
    mu_I = 10.0 * rng.standard_normal(6)
    plain, passive = (
        ma.inverse_dynamics(peer, state, wanted, internal_forces=mu_I) for peer in (driven, system)
    )
    D = directions(system, state)
    needed = np.append(np.zeros(6), plain.torques["left"][PLACE])
    change = np.linalg.pinv(D) @ needed
    before, after = (np.concatenate([*p.contact_forces.values()]) for p in (plain, passive))
    np.testing.assert_allclose(after - before, change, atol=1e-8)


def test_a_joint_that_no_contact_force_reaches_swings_by_itself():
    """The right arm of a cart holds nothing; of its torques only the shoulder's is missing."""
    spec = {"robot": "dual_arm_cart", "tips": {"left": "left_tool", "right": "right_tool"}}
    posture = [0.15, *[0.0, 0.6, -1.5, 0.0, 0.9, 0.0] * 2]
    scene = ma.Scene(
        gravity=[0, 0, -9.81],
        object={"shape": {"box": [0.3, 0.5, 0.2]}, "mass": 3.0, "pose": {"xyz": [0.8, 0.3, 1.1]}},
        robots={"cart": {**spec, "posture": posture}},
        joints=[{"arm": "cart/left", "kind": "weld"}],
    )
    name = "right_elbow_joint"
    system = ma.compile_system(scene.replace({"robots.cart.passive": [name]}))
    state = system.initial_state()
    answer = ma.inverse_dynamics(system, state, [0.2, 0.1, 0.3, 0.1, 0.0, 0.2])
    place = system.arms["cart"].joint_names.index(name)
    assert answer.torques["cart"][place] == 0.0
    assert abs(answer.joint_accelerations["cart"][place]) > 1.0
    ev = ma.evaluate(system.with_control(lambda t, s: answer.torques), 0.0, state)
    np.testing.assert_allclose(
        ev.joint_accelerations["cart"], answer.joint_accelerations["cart"], atol=1e-8
    )


# --- what says so, and what is refused -----------------------------------------------------------

UR5 = [0, -1.2, 1.5, 0, 0.5, 0]


def one_arm(control="none") -> ma.Scene:
    scene = single_arm("ur5", "tool0", UR5, WELD, control=control)
    return scene.replace({"arms.arm.passive": [JOINT]})


def test_inputs_of_linear_systems_are_those_of_driven_joints():
    linear = ma.linearise(pair("gravity_compensation"))
    names = linear.input_names
    assert len(names) == 11 and not any("left/elbow" in name for name in names)
    assert linear.B.shape[1] == 11


def test_the_check_names_passive_joints(tmp_path):
    path, facts = tmp_path / "pair.yaml", tmp_path / "facts.json"
    scene = ur5_pair(WELD, WELD).replace({"arms.left.passive": [JOINT]})
    path.write_text(dump_scene(scene), encoding="utf-8")
    shown = command("check")(path, "--json", facts).output
    assert re.search(rf"passive\W+{JOINT}", shown)
    assert json.loads(facts.read_text())["arms"]["left"]["passive"] == [JOINT]


def test_weight_on_a_joint_that_nothing_carries_is_said():
    warnings = start_warnings(ma.compile_system(one_arm("gravity_compensation")))
    assert sum("on the passive joint 'arm/elbow_joint'" in warning for warning in warnings) == 1


@pytest.mark.parametrize("control", [{"kind": "computed_torque"}, SPRING])
def test_a_law_that_needs_the_joint_is_refused(control):
    with pytest.raises(ControlError, match="passive joint 'arm/elbow_joint'"):
        ma.compile_system(one_arm(control))


def test_a_motion_that_needs_the_joint_is_refused():
    system = ma.compile_system(one_arm())
    with pytest.raises(SolverError, match="passive joint 'arm/elbow_joint' would need"):
        ma.inverse_dynamics(system, system.initial_state(), [0, 0, 1.0, 0, 0, 0])


def test_a_squeeze_beside_a_passive_joint_is_refused():
    with pytest.raises(ControlError, match=r"control.squeeze: the passive joint 'left/elbow"):
        pair({**TRACKING, "squeeze": 10.0})


def test_a_joint_that_does_not_move_is_no_passive_one():
    with refused(SceneError, "$.arms.left.passive"):
        pair(passive=["elbow"])


def test_a_floating_base_besides_is_refused(tmp_path):
    scene = one_arm()
    robot = {"robot": "ur5", "base": {"moves": "free"}, "tips": {"hand": "tool0"}}
    robot |= {"posture": UR5, "passive": [JOINT]}
    joints = [{"arm": "sat/hand", "kind": "weld"}]
    floating = scene.replace(arms={}, robots={"sat": robot}, joints=joints)
    system = ma.compile_system(floating)
    with pytest.raises(ModelError, match="'sat/elbow_joint' is passive and the base of 'sat'"):
        ma.inverse_dynamics(system, system.initial_state(), np.zeros(6))
