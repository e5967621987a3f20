"""Claims about robots whose base floats: their state, their equations, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from mechanics import difference
from scipy.spatial.transform import Rotation
from tree_models import constant_torques, read_tree_scene, start_of
from tree_motion import as_tree_state
from tree_oracle import Motions, evaluation_errors, least_change, solve_minimal, worst_gap
from tree_scenes import (
    DOWN,
    floating_scene,
    hanging_scene,
    hinge_urdf,
    humanoid_scene,
    link_urdf,
    quadruped_scene,
    satellite_scene,
)

import multiarm as ma
from multiarm.assembly.start_warnings import start_warnings
from multiarm.errors import ControlError, ModelError, SceneError, SolverError
from multiarm.gradients.variational_equation import displaced
from multiarm.scene import parse_scene
from multiarm.simulation.holding import carrying_capacity

ROUNDING = 1e-12  # of sums of some tens of terms of order 1 to 100


@pytest.fixture(scope="module")
def satellite() -> ma.System:
    return ma.compile_system(parse_scene(satellite_scene(DOWN)))


def random_state(system: ma.System, rng: np.random.Generator):
    base = {
        "position": rng.normal(size=3),
        "quaternion_xyzw": Rotation.random(random_state=rng).as_quat(),
        "twist": rng.normal(size=6),
    }
    return system.state(
        object_twist=rng.normal(size=6),
        joint_positions={"sat": rng.normal(size=6)},
        joint_velocities={"sat": rng.normal(size=6)},
        bases={"sat": base},
    )


# --- state ---------------------------------------------------------------------------------------


def test_a_state_has_the_base_apart_from_the_joints(satellite, rng):
    state = random_state(satellite, rng)
    assert state.joint_positions["sat"].shape == state.joint_velocities["sat"].shape == (6,)
    base = state.bases["sat"]
    written = satellite.scene.robots["sat"].base
    start = satellite.initial_state().bases["sat"]
    np.testing.assert_allclose(start.position, written.xyz, atol=ROUNDING)
    turn = Rotation.from_quat(start.quaternion_xyzw) * Rotation.from_euler("xyz", written.rpy).inv()
    assert turn.magnitude() < ROUNDING
    as_written = ma.compile_system(satellite.scene, assemble=False).initial_state()
    np.testing.assert_array_equal(as_written.bases["sat"].twist, written.twist)
    again = satellite.state(bases={"sat": {"twist": base.twist}})
    np.testing.assert_array_equal(again.bases["sat"].twist, base.twist)
    np.testing.assert_array_equal(again.bases["sat"].pose, start.pose)


def test_displacements_shift_and_turn_the_base_in_world_axes(satellite, rng):
    state, layout = random_state(satellite, rng), satellite.model.layout
    u = rng.uniform(-1.5, 1.5, layout.nv)
    moved, (twist,) = state.displaced(u), layout.base_twists(u)
    before, after = state.bases["sat"], moved.bases["sat"]
    np.testing.assert_allclose(after.position, before.position + twist[:3], atol=ROUNDING)
    turned = Rotation.from_rotvec(twist[3:]) * Rotation.from_quat(before.quaternion_xyzw)
    assert (turned * Rotation.from_quat(after.quaternion_xyzw).inv()).magnitude() < ROUNDING
    np.testing.assert_allclose(state.displacement_to(moved), u, atol=ROUNDING)
    rates = layout.joint_rates(u)[6:]
    shifts = moved.joint_positions["sat"] - state.joint_positions["sat"]
    np.testing.assert_allclose(shifts, rates, atol=ROUNDING)


@pytest.mark.parametrize(
    "bases",
    [
        {"arm": {"position": [0, 0, 0]}},
        {"sat": {"pose": [0, 0, 0]}},
        {"sat": {"position": [0, 0]}},
        {"sat": {"twist": [0, 0, 0, 0, 0, np.nan]}},
        {"sat": {"quaternion_xyzw": [0, 0, 0, 0]}},
        {"sat": [0, 0, 0]},
        [0, 0, 0],
    ],
)
def test_wrong_bases_are_refused(satellite, bases):
    with pytest.raises(ModelError, match="bases"):
        satellite.state(bases=bases)


def test_a_key_of_a_base_that_is_none_is_named(satellite):
    with pytest.raises(ModelError, match=r"bases\['sat'\]: unknown key 'positon'; did you mean"):
        satellite.state(bases={"sat": {"twist": [0.0] * 6, "positon": [0, 0, 0]}})


def test_a_robot_without_tips_falls_and_turns_as_pinocchio_says(rng):
    """All of its joints move; its accelerations are those of Pinocchio with a free flyer."""
    robot = {"robot": "ur5", "base": {"moves": "free"}}
    box = {"shape": {"sphere": 0.1}, "mass": 1.0, "pose": {"xyz": [0, 0, 9.0]}}
    scene = {"gravity": DOWN, "object": box, "robots": {"sat": robot}, "joints": []}
    system = ma.compile_system(parse_scene(scene))
    assert list(system.kinematics().tips) == ["sat/tool0"]
    ev = ma.evaluate(system, state=random_state(system, rng))
    model = pin.buildModelFromUrdf(str(system.arms["sat"].files.urdf), pin.JointModelFreeFlyer())
    state = ev.state
    base = state.bases["sat"]
    turn = Rotation.from_quat(base.quaternion_xyzw).as_matrix()
    q = np.concatenate([base.position, base.quaternion_xyzw, state.joint_positions["sat"]])
    in_base = [turn.T @ part for part in np.split(base.twist, 2)]
    v = np.concatenate([*in_base, state.joint_velocities["sat"]])
    a = pin.aba(model, model.createData(), q, v, np.zeros(model.nv))
    np.testing.assert_allclose(ev.joint_accelerations["sat"], a[6:], atol=1e-11 * abs(a).max())


def test_tips_move_as_pinocchio_says(satellite, rng):
    state = random_state(satellite, rng)
    tip, base = satellite.kinematics(state).tips["sat/hand"], state.bases["sat"]
    twist = tip.jacobian @ np.concatenate([base.twist, state.joint_velocities["sat"]])
    np.testing.assert_allclose(twist, tip.twist, atol=ROUNDING)
    model = read_tree_scene(satellite_scene(DOWN)).robots["sat"].model
    q = np.concatenate([base.pose, state.joint_positions["sat"]])
    data, R = model.createData(), pin.XYZQUATToSE3(base.pose).rotation
    v = np.concatenate([R.T @ base.twist[:3], R.T @ base.twist[3:], state.joint_velocities["sat"]])
    pin.forwardKinematics(model, data, q, v)
    last = data.oMi[model.njoints - 1]
    turn = last.rotation.T @ tip.rotation
    origin = last.translation + last.rotation @ satellite.arms["sat"].tips["hand"].translation
    np.testing.assert_allclose(origin, tip.position, atol=ROUNDING)
    fixed = satellite.arms["sat"].tips["hand"].rotation
    np.testing.assert_allclose(turn, fixed, atol=ROUNDING)


# --- equations -----------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_accelerations_of_a_satellite_are_those_of_a_free_flyer(solver, rng):
    """Off the joint too: its rows are those of the relative twist of both frames."""
    scene = satellite_scene(DOWN, run={"solver": solver})
    scene["control"] = {"kind": "constant", "torques": {"sat": [1.0, -2.0, 0.5, 0.3, 0.2, -0.1]}}
    trees = read_tree_scene(scene)
    state = least_change(trees, start_of(scene, trees))
    system = ma.compile_system(parse_scene(scene))
    evaluation = ma.evaluate(system, 0.0, system.state(**vars(state)))
    solution = solve_minimal(trees, state, constant_torques(scene, trees))
    about = {"sat/hand": state.object_position}
    assert evaluation_errors(solution, evaluation, about) < ROUNDING
    a = evaluation.accelerations
    np.testing.assert_array_equal(a[6:12], evaluation.base_accelerations["sat"])


@pytest.mark.slow
def test_accelerations_of_a_humanoid_that_holds_a_box():
    scene = humanoid_scene()
    trees = read_tree_scene(scene)
    state = start_of(scene, trees)
    system = ma.compile_system(parse_scene(scene))
    evaluation = ma.evaluate(system)
    assert evaluation.rank == 24
    solution = solve_minimal(trees, state, {})
    assert np.max(np.abs(solution.base_accelerations["g1"])) > 0.01
    hands = {f"g1/{side}": state.object_position for side in ("left", "right")}
    assert evaluation_errors(solution, evaluation, hands) < 1e-9
    total = sum(evaluation.wrenches[f"g1/{side}_foot-world"] for side in ("left", "right"))
    motions = Motions(trees, state)
    mass = sum(pin.computeTotalMass(motions.models[name].model) for name in motions.names)
    assert total[2] < 0.0  # the feet push the ground down
    assert abs(total[2]) < 1.5 * 9.81 * mass


# --- derivatives and inverse dynamics ------------------------------------------------------------


def answers(evaluation) -> np.ndarray:
    return np.concatenate([evaluation.accelerations, *evaluation.contact_forces.values()])


def assert_derivatives_are_differences(system: ma.System, state, tolerance=2e-9) -> None:
    derivatives, size = ma.derivatives(system, 0.3, state), 2 * state.layout.nv
    expected = np.transpose([
        difference(lambda h, e=e: answers(ma.evaluate(system, 0.3, displaced(state, h * e))), 1e-3)
        for e in np.eye(size)
    ])  # fmt: skip
    scale = np.abs(expected).max(axis=1, keepdims=True) + 1.0
    matrix = derivatives.matrix[: len(expected), :size]
    np.testing.assert_allclose(matrix / scale, expected / scale, atol=tolerance)


@pytest.mark.parametrize("gravity", [None, DOWN])
def test_derivatives_are_those_of_differences(gravity, rng):
    """Also off the joint, and with a base that moves and turns fast."""
    system = ma.compile_system(parse_scene(satellite_scene(gravity)))
    assert_derivatives_are_differences(system, random_state(system, rng))


def test_derivatives_of_a_body_without_joints_are_those_of_differences(tmp_path, rng):
    scene = floating_scene(tmp_path / "sat.urdf", link_urdf("root"), "root", [], gravity=DOWN)
    system = ma.compile_system(parse_scene(scene))
    state = system.initial_state()
    state.velocity[:] = rng.normal(size=state.velocity.size)
    assert_derivatives_are_differences(system, state)


@pytest.mark.slow
def test_derivatives_of_a_humanoid_are_those_of_differences(rng):
    system = ma.compile_system(parse_scene(humanoid_scene()))
    state = system.initial_state()
    state.velocity[:] = rng.uniform(-1.0, 1.0, state.velocity.size)
    assert_derivatives_are_differences(system, state)


def test_derivatives_have_the_base_apart_from_the_joints(satellite, rng):
    state = random_state(satellite, rng)
    derivatives = ma.derivatives(satellite, 0.3, state)
    of_base, of_joints = (
        derivatives.base_accelerations["sat"],
        derivatives.joint_accelerations["sat"],
    )
    blocks = [
        [of.d_object_pose, of.d_base_poses["sat"], of.d_joint_positions["sat"]]
        for of in (derivatives.object_acceleration, of_base, of_joints)
    ]
    columns = state.layout.displacement_columns
    np.testing.assert_array_equal(np.block(blocks), derivatives.matrix[:18, columns])
    faster = state.copy()
    faster.velocity[6:12] += 1e-6
    change = ma.evaluate(satellite, 0.3, faster).base_accelerations["sat"]
    change = (change - ma.evaluate(satellite, 0.3, state).base_accelerations["sat"]) / 1e-6
    by_twist = of_base.d_base_twists["sat"].sum(axis=1)
    np.testing.assert_allclose(by_twist, change, atol=1e-4 * np.abs(change).max())


def test_the_response_to_a_wrench_on_the_base_is_that_of_an_effect(satellite, rng):
    """The equations are linear in it: a difference is the derivative."""
    state = random_state(satellite, rng)
    derivatives = ma.derivatives(satellite, 0.0, state)
    rows = slice(0, 18)
    by_wrench = np.vstack([
        of.d_base_wrenches["sat"]
        for of in (
            derivatives.object_acceleration, derivatives.base_accelerations["sat"],
            derivatives.joint_accelerations["sat"],
        )
    ])  # fmt: skip
    before = ma.evaluate(satellite, 0.0, state).accelerations[rows]
    for column, part in enumerate(np.eye(6)):
        load = {"on": "sat/base_link", "force": part[:3].tolist(), "torque": part[3:].tolist()}
        effects = {"external_wrenches": [load]}
        pushed = ma.compile_system(parse_scene(satellite_scene(DOWN, effects=effects)))
        change = ma.evaluate(pushed, 0.0, state).accelerations[rows] - before
        np.testing.assert_allclose(by_wrench[:, column], change, atol=1e-11)


def assert_torques_make_the_motion(system: ma.System, state, acceleration) -> ma.InverseDynamics:
    inverse = ma.inverse_dynamics(system, state, acceleration)
    driven = system.with_control(lambda t, s: inverse.torques)
    evaluation = ma.evaluate(driven, 0.0, state)
    np.testing.assert_allclose(evaluation.object_acceleration, acceleration, atol=1e-10)
    for wanted, found in (
        (inverse.base_accelerations, evaluation.base_accelerations),
        (inverse.joint_accelerations, evaluation.joint_accelerations),
        (inverse.contact_forces, evaluation.contact_forces),
    ):
        assert wanted.keys() == found.keys()
        for name, values in wanted.items():
            size = max(np.abs(values).max(), 1.0)
            np.testing.assert_allclose(found[name], values, atol=1e-10 * size)
    return inverse


@pytest.mark.parametrize("gravity", [None, DOWN])
def test_torques_of_a_wanted_motion_of_the_object_make_that_motion(gravity, rng):
    """A base that nothing holds moves as the wrench of the hand and the joints on it say."""
    system = ma.compile_system(parse_scene(satellite_scene(gravity)))
    state = system.initial_state()
    inverse = assert_torques_make_the_motion(system, state, rng.normal(size=6))
    assert np.linalg.norm(inverse.base_accelerations["sat"]) > 0.01


def test_a_base_on_a_joint_of_the_world_turns_about_it(rng):
    system = ma.compile_system(parse_scene(hanging_scene()))
    state = system.initial_state()
    inverse = assert_torques_make_the_motion(system, state, rng.normal(size=6))
    base = inverse.base_accelerations["sat"]
    np.testing.assert_allclose(base[:3], 0.0, atol=1e-10)  # at rest, at the joint
    assert np.linalg.norm(base[3:]) > 0.01


@pytest.mark.slow
def test_feet_on_the_ground_carry_what_no_drive_can(rng):
    system = ma.compile_system(parse_scene(humanoid_scene()))
    state = system.initial_state()
    still = assert_torques_make_the_motion(system, state, np.zeros(6))
    np.testing.assert_allclose(still.base_accelerations["g1"], 0.0, atol=1e-10)
    assert_torques_make_the_motion(system, state, rng.normal(size=6))


def test_a_motion_that_no_drive_can_make_is_refused(tmp_path):
    """The object is held by the base itself: only the world could move it."""
    links = link_urdf("root") + link_urdf("thumb") + hinge_urdf("thumb")
    scene = floating_scene(tmp_path / "sat.urdf", links, "root", [])
    system = ma.compile_system(parse_scene(scene))
    with pytest.raises(SolverError, match=r"robot 'sat'.*floats"):
        ma.inverse_dynamics(system, system.initial_state(), [1.0, 0, 0, 0, 0, 0])


# --- postures ------------------------------------------------------------------------------------


def test_a_posture_is_found_from_where_the_base_is_written():
    """The hand reaches its place on the object, by Pinocchio, and the base stays."""
    scene = satellite_scene(DOWN)
    assert scene["joints"][0].keys() >= {"at"}
    scene["robots"]["sat"]["posture"] = "solve"
    del scene["robots"]["sat"]["base"]["twist"]
    trees = read_tree_scene(
        {**scene, "robots": {"sat": {**scene["robots"]["sat"], "posture": None}}}
    )
    start = ma.compile_system(parse_scene(scene)).initial_state()
    written = scene["robots"]["sat"]["base"]
    base = start.bases["sat"]
    np.testing.assert_allclose(base.position, written["xyz"], atol=1e-9)
    turn = (
        Rotation.from_quat(base.quaternion_xyzw) * Rotation.from_euler("xyz", written["rpy"]).inv()
    )
    assert turn.magnitude() < 1e-9
    assert worst_gap(trees, as_tree_state(start)) < 1e-9


@pytest.mark.slow
def test_a_quadruped_finds_its_feet():
    """Four feet on their places on the ground, from another posture that is not told."""
    scene = quadruped_scene(0.0)
    below = scene["robots"]["solo"]["base"]["xyz"][2]
    feet = ma.compile_system(parse_scene(scene)).initial_state().joint_positions["solo"]
    legs = {"fl": (0.19, 0.15), "fr": (0.19, -0.15), "hl": (-0.19, 0.15), "hr": (-0.19, -0.15)}
    scene["robots"]["solo"]["posture"] = "solve"
    for joint in scene["joints"][1:]:
        foot = joint["between"][0].split("/")[1]
        joint |= {"kind": "ball", "at": {"xyz": [*legs[foot], 0.0]}}
        del joint["mu"]
    del scene["effects"]
    system = ma.compile_system(parse_scene(scene))
    start = system.initial_state()
    assert start.bases["solo"].position[2] == pytest.approx(below, abs=1e-9)
    assert np.max(np.abs(start.joint_positions["solo"] - feet)) > 0.01
    tips = system.kinematics(start).tips
    for foot, place in legs.items():
        np.testing.assert_allclose(tips[f"solo/{foot}"].position, [*place, 0.0], atol=1e-9)


# --- weight --------------------------------------------------------------------------------------

WELD_TO_WORLD = [
    {"arm": "sat/hand", "kind": "weld"},
    {"between": ["sat/base_link", "world"], "kind": "weld"},
]


def standing_quadruped(**control: Any) -> ma.System:
    """On four feet that push, with friction; springs in the joints unless there is a ``kind``."""
    scene = quadruped_scene(0.0)
    scene["effects"] = {"unilateral_contacts": {}}
    springs = {"kind": "joint_pd", "stiffness": 20.0, "damping": 0.5}
    scene["control"] = control if "kind" in control else {**springs, **control}
    return ma.compile_system(parse_scene(scene))


@pytest.mark.parametrize(
    "control",
    [
        {},
        {"kind": "gravity_compensation"},
        {"kind": "harmonic", "frequency": 1.0, "amplitude": {"solo": [0.0] * 12}, "hold": True},
    ],
)
def test_feet_carry_a_robot_whose_control_compensates_gravity(control):
    system = standing_quadruped(**control)
    evaluation, start = ma.evaluate(system), system.initial_state()
    assert np.max(np.abs(evaluation.accelerations)) < 1e-10
    # the torques are those of inverse dynamics, which distributes forces in another way
    torques = ma.inverse_dynamics(system, start, np.zeros(6)).torques["solo"]
    np.testing.assert_allclose(evaluation.joint_torques["solo"], torques, atol=1e-10)
    assert np.max(np.abs(torques)) > 0.1
    carrying = carrying_capacity(system, evaluation)
    assert carrying is not None and carrying.possible
    assert carrying.force_residual < 1e-9 and carrying.moment_residual < 1e-9


@pytest.mark.slow
def test_a_humanoid_stands_with_a_box_in_its_hands():
    system = ma.compile_system(parse_scene({**humanoid_scene(), "control": "gravity_compensation"}))
    evaluation, start = ma.evaluate(system), system.initial_state()
    assert np.max(np.abs(evaluation.accelerations)) < 1e-9
    torques = ma.inverse_dynamics(system, start, np.zeros(6)).torques["g1"]
    np.testing.assert_allclose(evaluation.joint_torques["g1"], torques, atol=1e-10)


def test_weight_carried_by_the_world_has_the_derivatives_of_differences(rng):
    """Of the law's torques too, which are differences over 1e-4, at a displaced, moving state."""
    scene = hanging_scene(joints=WELD_TO_WORLD, control="gravity_compensation")
    system = ma.compile_system(parse_scene(scene))
    assert np.max(np.abs(ma.evaluate(system).accelerations)) < 1e-10
    start = system.initial_state()
    moved = displaced(start, rng.uniform(-0.3, 0.3, 2 * start.layout.nv))
    assert_derivatives_are_differences(system, moved, tolerance=1e-7)


def test_a_standing_robot_stays_where_it_is_with_stiff_springs():
    system = standing_quadruped(stiffness=2e4, damping=200.0)
    run = ma.simulate(system, 0.1, integrator="rodas5p", tolerance=1e-8)
    assert run.status == "completed", run.message
    assert np.max(np.abs(run.bases["solo"].twist)) < 1e-7


def test_what_of_a_robots_weight_nothing_carries_is_said_at_the_start():
    """A ball joint carries no moment of the robot that hangs on it."""
    scene = hanging_scene(control="gravity_compensation")
    system = ma.compile_system(parse_scene(scene))
    assert any("weight of robot 'sat'" in text for text in start_warnings(system))
    welded = hanging_scene(joints=WELD_TO_WORLD, control="gravity_compensation")
    system = ma.compile_system(parse_scene(welded))
    assert not any("weight" in text for text in start_warnings(system))


# --- what is refused -----------------------------------------------------------------------------


def test_the_variational_method_is_refused(satellite):
    with pytest.raises(SceneError, match=r"robot 'sat'.*use another method"):
        ma.simulate(satellite, 0.01, integrator="variational", step=1e-3)


@pytest.mark.parametrize(
    "control",
    [
        "gravity_compensation",
        {"kind": "joint_pd", "stiffness": 10.0, "damping": 1.0},
        {"kind": "harmonic", "frequency": 1.0, "amplitude": {"sat": [1.0] * 6}, "hold": True},
        {"kind": "computed_torque", "path": [{"time": 1.0, "xyz": [0.5, 0.1, 0.5]}]},
    ],
)
def test_controls_that_rest_on_the_base_are_refused(control):
    with pytest.raises(ControlError, match=r"base that floats.*'sat'"):
        ma.compile_system(parse_scene(satellite_scene(DOWN, control=control)))


def test_a_posture_that_reaches_no_place_from_the_written_base_is_refused():
    scene = satellite_scene()
    scene["robots"]["sat"]["posture"] = "solve"
    scene["joints"][0]["at"]["xyz"] = [3.0, 0.0, 0.0]
    with pytest.raises(SceneError, match=r"robots\.sat\.posture.*move the base by"):
        ma.compile_system(parse_scene(scene))


@pytest.mark.parametrize(
    "key", [{"limits": {"x": [0, 1]}}, {"effort": {"x": 1.0}}, {"moves": ["x"], "twist": [0.0] * 6}]
)
def test_keys_of_other_bases_are_refused(key):
    scene = satellite_scene()
    base = {k: v for k, v in scene["robots"]["sat"]["base"].items() if k != "twist"}
    scene["robots"]["sat"]["base"] = {**base, **key}
    with pytest.raises(SceneError, match=r"robots\.sat\.base"):
        parse_scene(scene)
