"""Claims about control of robots with several tips: on a moving base, with couplings and loops.

The reference is solved densely from Pinocchio's inertias and Jacobians (``tree_oracle``), never by
the package.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from mechanics import data_of
from random_trees import FAMILIES, draw_trees
from refusals import refused
from scipy.linalg import block_diag
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation
from tree_models import OBJECT, BodyFrame, TreeState, read_tree_scene, start_of
from tree_oracle import Motions, collect, least_change
from tree_scenes import cart_scene, gripper_scene, together

import multiarm as ma
from multiarm.control.null_space import nearest_accelerations
from multiarm.dynamics.coordinates import retract
from multiarm.errors import ControlError, ModelError, SolverError
from multiarm.scene import parse_scene
from multiarm.simulation.holding import carrying_capacity

EPS = float(np.finfo(float).eps)
# Roundings of some hundred products at a condition of the equations of 1e4, relative.
ROUNDED = 1e-9
RAIL, GUIDE = "cart/base-world", "guide"
SPRING = {
    "stiffness": {"translation": [900.0, 800.0, 700.0], "rotation": [200.0, 150.0, 100.0]},
    "damping": {"translation": 300.0, "rotation": 40.0},
}
FLOOR = {"at": {"xyz": [0, 0, -0.5]}}
AHEAD = {"time": 0.0, "xyz": [0.83, 0.02, 1.08], "rpy": [0.1, -0.05, 0.15]}
PATH = [AHEAD, {**AHEAD, "time": 5.0, "xyz": [0.9, 0.0, 1.2]}]


def busy_cart(right: str = "weld", *, twice: bool = False) -> dict[str, Any]:
    """The cart on a rail, one upper arm on a plane of the other, elbows coupled."""
    scene = cart_scene()
    scene["robots"]["cart"]["mimic"] = {"right_elbow_joint": {"of": "left_elbow_joint"}}
    plane = {"kind": "point_on_plane", "tip_radius": 0.0}
    guide = {"between": ["cart/left_upper_arm", "cart/right_upper_arm"], "name": GUIDE}
    scene["joints"][1]["kind"] = right
    scene["joints"] += [
        {"between": ["cart/base", "world"], **plane, "normal": [0.2, 1.0, 0.0]},
        {**guide, **plane, "normal": [0.3, -0.2, 1.0]},
    ]
    scene = together(scene)
    if twice:  # one row that depends on another
        scene["joints"].append({**scene["joints"][-1], "name": "again"})
    return scene


def without_torso(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene with the cart's torso locked where it is."""
    cart = scene["robots"]["cart"]
    lock = {"torso_lift_joint": cart["posture"][3]}
    posture = [*cart["posture"][:3], *cart["posture"][4:]]
    robots = {"cart": {**cart, "lock": lock, "posture": posture}}
    return {**scene, "robots": robots}


def controlled(scene: dict[str, Any], control: Any, **more: Any) -> ma.System:
    return ma.compile_system(parse_scene({**scene, "control": control, **more}))


def in_motion(scene: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """The scene with random velocities that its rows allow."""
    trees = read_tree_scene(scene)
    start = start_of(scene, trees)
    rates = {name: rng.uniform(-0.3, 0.3, q.size) for name, q in start.joint_positions.items()}
    held = {OBJECT: {**start.objects[OBJECT], "twist": rng.uniform(-0.3, 0.3, 6)}}
    state = least_change(trees, TreeState(held, start.joint_positions, rates))
    body = {**scene["object"], "twist": state.object_twist.tolist()}
    robots = {
        name: {**spec, "velocity": state.joint_velocities[name].tolist()}
        for name, spec in scene["robots"].items()
    }
    return {**scene, "object": body, "robots": robots}


class Plant(NamedTuple):
    """Equations of the one robot of a scene at its start.

    Rows are ``A_o a_o + A q'' = gamma``; ``jacobians`` are those of the links that hold the object,
    at its centre of mass, world axes.
    """

    M: np.ndarray
    bias: np.ndarray
    gravity_torque: np.ndarray
    A_o: np.ndarray
    A: np.ndarray
    gamma: np.ndarray
    jacobians: dict[str, np.ndarray]
    rates: np.ndarray
    twist: np.ndarray
    inertia: np.ndarray


def plant_of(scene: dict[str, Any]) -> Plant:
    trees = read_tree_scene(scene)
    state = start_of(scene, trees)
    motions = Motions(trees, state)
    (name,) = trees.robots
    robot, body = motions.models[name], motions.frame(BodyFrame(OBJECT, 1, pin.SE3.Identity()))
    couplings = collect(trees, motions.frame, motions.coordinates.size, motions.coordinates.rates)
    of_object, of_robot = motions.coordinates.bodies[OBJECT], motions.coordinates.bodies[name]
    A_o = couplings.A[:, of_object] @ np.linalg.inv(body.jacobian[:, of_object])
    jacobians = {}
    for connection in trees.connections:
        if connection.second.body == OBJECT:
            frame = motions.frame(connection.first)
            J = frame.jacobian[:, of_robot].copy()
            lever = state.object_position - frame.origin
            J[:3] += np.cross(J[3:], lever, axis=0)
            jacobians[connection.name] = J
    model, R = robot.model, body.rotation
    gravity = pin.computeGeneralizedGravity(model, model.createData(), robot.position)
    box = trees.objects[OBJECT].inertias[1]
    inertia = block_diag(box.mass * np.eye(3), R @ box.inertia @ R.T)
    return Plant(
        robot.inertia, robot.bias, gravity.copy(), A_o, couplings.A[:, of_robot],
        A_o @ body.bias - couplings.gamma, jacobians, robot.velocity, state.object_twist, inertia,
    )  # fmt: skip


def nearest(M: np.ndarray, preferred: np.ndarray, A: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``q''`` nearest to the preferred ones in the metric of M with ``A q'' = right``."""
    saddle = np.block([[M, A.T], [A, np.zeros((len(A), len(A)))]])
    return np.linalg.lstsq(saddle, np.r_[M @ preferred, right], rcond=1e-12)[0][: len(M)]


def shared(ev: Any, wrench: np.ndarray, names: list[str]) -> dict[str, np.ndarray]:
    """Wrenches of connections on the object by the contact forces of least norm, world axes."""
    R = Rotation.from_quat(ev.state.object_quaternion_xyzw).as_matrix()
    to_world = np.kron(np.eye(2), R)
    parts = {name: to_world @ ev.contact_terms[name].W_o for name in names}
    forces = np.linalg.lstsq(np.hstack(list(parts.values())), wrench, rcond=None)[0]
    bounds = np.cumsum([W.shape[1] for W in parts.values()])[:-1]
    pieces = np.split(forces, bounds)
    return {name: W @ f for (name, W), f in zip(parts.items(), pieces, strict=True)}


def error_of_pose(state: Any) -> np.ndarray:
    """Displacement and rotation vector to ``AHEAD``, world axes."""
    R = Rotation.from_quat(state.object_quaternion_xyzw)
    turn = (Rotation.from_euler("xyz", AHEAD["rpy"]) * R.inv()).as_rotvec()
    return np.r_[np.array(AHEAD["xyz"]) - state.object_position, turn]


# --- laws -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("twice", [False, True], ids=["independent", "redundant"])
def test_computed_torque_commands_object_and_joints(twice, rng):
    """The object's acceleration as commanded; joints the nearest that all rows allow."""
    scene = in_motion(busy_cart(twice=twice), rng)
    control = {"kind": "computed_torque", "path": PATH, "relative_damping": 7.0}
    ev = ma.evaluate(controlled(scene, control))
    plant = plant_of(scene)
    desired = 100.0 * error_of_pose(ev.state) - 20.0 * plant.twist
    joints = nearest(plant.M, -7.0 * plant.rates, plant.A, plant.gamma - plant.A_o @ desired)
    assert np.max(np.abs(plant.rates)) > 0.1
    size = np.max(np.abs(joints))
    np.testing.assert_allclose(ev.object_acceleration, desired, atol=ROUNDED * size)
    np.testing.assert_allclose(ev.joint_accelerations["cart"], joints, atol=ROUNDED * size)
    # weight and inertia are shared with least norm; nothing else carries
    spin = plant.twist[3:]
    weight = np.r_[plant.inertia[:3, :3] @ [0.0, 0.0, 9.81], np.zeros(3)]
    gyroscopic = np.r_[np.zeros(3), np.cross(spin, plant.inertia[3:, 3:] @ spin)]
    wrenches = shared(ev, plant.inertia @ desired + weight + gyroscopic, list(plant.jacobians))
    torque = plant.M @ joints + plant.bias
    for name, J in plant.jacobians.items():
        torque += J.T @ wrenches[name]
    size = np.max(np.abs(torque))
    np.testing.assert_allclose(ev.joint_torques["cart"], torque, atol=ROUNDED * size)
    if not twice:
        for name in (RAIL, GUIDE, "cart"):
            np.testing.assert_allclose(ev.contact_forces[name], 0.0, atol=ROUNDED * size)


def test_an_impedance_carries_the_weight_and_damps_what_the_rows_allow(rng):
    scene = in_motion(busy_cart(), rng)
    control = {"kind": "object_impedance", **SPRING, "path": PATH, "relative_damping": 7.0}
    ev = ma.evaluate(controlled(scene, control))
    plant, error = plant_of(scene), error_of_pose(ev.state)
    stiffness = np.r_[SPRING["stiffness"]["translation"], SPRING["stiffness"]["rotation"]]
    wrench = stiffness * error - np.r_[[300.0] * 3, [40.0] * 3] * plant.twist
    wrench[2] += plant.inertia[0, 0] * 9.81
    # the moment of the spring is J_r^-T(theta) K theta: work along a turn that changes theta
    theta, h = error[3:], 1e-5
    for axis in range(3):
        energy = [
            0.5 * stiffness[3:] @ (Rotation.from_rotvec(theta) * turn.inv()).as_rotvec() ** 2
            for turn in (Rotation.from_rotvec(s * h * np.eye(3)[axis]) for s in (1.0, -1.0))
        ]
        wrench[3 + axis] = -40.0 * plant.twist[3 + axis] - (energy[0] - energy[1]) / (2.0 * h)
    wrenches = shared(ev, wrench, list(plant.jacobians))
    damping = nearest(plant.M, -7.0 * plant.rates, plant.A, np.zeros(len(plant.A)))
    torque = plant.gravity_torque + plant.M @ damping
    for name, J in plant.jacobians.items():
        torque += J.T @ wrenches[name]
    # the difference of energies is known to h^2 of its third derivatives, and to EPS / h
    np.testing.assert_allclose(ev.joint_torques["cart"], torque, atol=1e-8 * np.max(np.abs(torque)))


@pytest.mark.parametrize("build", [busy_cart, gripper_scene], ids=["cart", "gripper"])
def test_gravity_compensation_holds_still_and_nothing_else_carries(build):
    scene = build()
    system = controlled(scene, "gravity_compensation")
    ev, weight = ma.evaluate(system), 9.81 * scene["object"]["mass"]
    np.testing.assert_allclose(ev.object_acceleration, 0.0, atol=1e-9)
    plant = plant_of(scene)
    wrenches = shared(ev, np.array([0.0, 0.0, weight, 0.0, 0.0, 0.0]), list(plant.jacobians))
    torque = plant.gravity_torque.copy()
    for name, J in plant.jacobians.items():
        torque += J.T @ wrenches[name]
    (robot,) = scene["robots"]
    size = np.max(np.abs(torque))
    np.testing.assert_allclose(ev.joint_torques[robot], torque, atol=ROUNDED * size)
    run = ma.simulate(system, duration=1.0, accuracy=1e-7, output_step=0.5)
    moved = np.abs(run.object_position - run.object_position[0])
    assert run.status == "completed"
    assert np.max(moved) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_gravity_compensation_holds_robots_of_all_sorts(family, tmp_path):
    """At rest, where the contacts carry the whole weight."""
    drawn = draw_trees(family, np.random.default_rng(0), tmp_path)
    scene = {**drawn.scene, "object": {**drawn.scene["object"], "twist": [0.0] * 6}}
    for part in ("arms", "robots"):
        specs = scene.get(part, {})
        scene[part] = {
            name: {**spec, "velocity": [0.0] * len(spec["posture"])} for name, spec in specs.items()
        }
    ev = ma.evaluate(controlled(scene, "gravity_compensation"))
    torques = np.concatenate(list(ev.joint_torques.values()))
    if np.max(np.abs(ev.uncarried_wrench)) < 1e-9:
        scale = np.max(np.abs(torques)) / 1e-2  # of light links
        np.testing.assert_allclose(ev.accelerations, 0.0, atol=ROUNDED * scale)


LAWS = {
    "gravity": "gravity_compensation",
    "joint_pd": {"kind": "joint_pd", "stiffness": 300.0, "damping": {"cart": {"base_x": 50.0}}},
    "computed_torque": {"kind": "computed_torque", "path": PATH, "squeeze": 20.0},
    "held": {"kind": "computed_torque", "path": PATH, "relative_stiffness": 30.0},
    "impedance": {
        "kind": "object_impedance", **SPRING, "path": PATH, "relative_stiffness": 30.0,
        "squeeze": 20.0,
    },
}  # fmt: skip


@pytest.mark.parametrize("build", [cart_scene, busy_cart], ids=["cart", "busy"])
@pytest.mark.parametrize("law", LAWS)
def test_derivatives_of_torques_are_those_of_central_differences(law, build, rng):
    scene, control = build(), LAWS[law]
    if law == "held":  # what holds a hand that cannot move does not show
        scene["joints"][0]["kind"] = "planar"
    scene = in_motion(scene, rng)
    if build is busy_cart and law in ("computed_torque", "impedance"):
        control = {**control, "internal_forces": {RAIL: [12.0], GUIDE: [-5.0]}}
    system = controlled(scene, control)
    state, layout = system.initial_state(), system.initial_state().layout
    matrix = ma.derivatives(system).matrix

    def accelerations(direction, h):
        moved = state.copy()
        moved.position[:] = retract(layout, state.position, h * direction[: layout.nv])
        moved.velocity[:] += h * direction[layout.nv :]
        return ma.evaluate(system, 0.0, moved).accelerations

    columns = np.r_[layout.displacement_columns, layout.velocity_columns]
    h = 1e-4  # order four: errors h^4 of fifth derivatives, EPS / h of the accelerations
    for _ in range(3):
        direction = rng.standard_normal(2 * layout.nv)
        steps = {k: accelerations(direction, k * h) for k in (-2, -1, 1, 2)}
        slope = (8.0 * (steps[1] - steps[-1]) - (steps[2] - steps[-2])) / (12.0 * h)
        stated = matrix[: layout.nv, columns] @ direction
        np.testing.assert_allclose(stated, slope, atol=1e-6 * np.max(np.abs(slope)))
    works = [work for work in data_of(system).closed.law_works if hasattr(work, "targets")]
    for work in works:  # poses beside other rows have no closed form
        assert work.targets.independent == (build is cart_scene or law == "computed_torque")


@pytest.mark.parametrize("build", [cart_scene, busy_cart], ids=["cart", "busy"])
def test_poses_are_held_at_all_tips_of_a_robot(build, rng):
    """x'' = -k x - d x' for the slides and turns of a hand, whatever other rows there are."""
    k, d = 60.0, 16.0
    scene = build()
    scene["joints"][1]["kind"] = "planar"
    scene = in_motion(scene, rng)
    control = {"kind": "computed_torque", "relative_stiffness": k, "relative_damping": d}
    run = ma.simulate(controlled(scene, control), duration=0.4, accuracy=1e-8, output_step=0.1)
    places, rates = run.relative_position["cart/right"], run.relative_motion["cart/right"]
    assert np.max(np.abs(rates[0])) > 0.05
    roots = np.roots([1.0, d, k])
    decay = np.exp(np.outer(run.time, roots)) @ np.array([1.0, -1.0]) / (roots[0] - roots[1])
    np.testing.assert_allclose(places - places[0], np.outer(decay, rates[0]), atol=1e-7)


def test_rows_of_roundings_do_not_count(rng):
    """Joints that a row does not move, but for roundings, do not move to satisfy it."""
    M, W = np.diag([2.0, 1.0, 0.5]), rng.standard_normal((3, 3))
    W[:, 1] = 1e-17 * rng.standard_normal(3)
    preferred, target = rng.standard_normal(3), np.array([1.0, 1e-16, -2.0])
    result, multipliers = np.empty(3), np.empty(3)
    assert not nearest_accelerations(M, W, preferred, target, result, multipliers)
    expected = nearest(M, preferred, W[:, ::2].T, target[::2])
    np.testing.assert_allclose(result, expected, atol=1e-12 / np.abs(np.linalg.det(W[::2, ::2])))


@pytest.mark.parametrize(
    "effects", [{"floor": FLOOR}, {"joint_limits": {}}], ids=["floor", "stops"]
)
def test_rows_that_may_open_change_no_law(effects, rng):
    """Laws take all contacts of the joints as closed, and couplings as they are."""
    scene = in_motion(busy_cart(right="planar"), rng)
    forces = {"internal_forces": {RAIL: [12.0]}, "relative_stiffness": 5.0}
    control = {"kind": "object_impedance", **SPRING, **forces}
    torques = [
        ma.evaluate(controlled(scene, control, effects=more)).joint_torques["cart"]
        for more in ({}, effects)
    ]
    np.testing.assert_allclose(torques[1], torques[0], atol=1e-9)


def test_stiff_steps_have_the_derivatives_of_laws(rng):
    """The method that uses them makes the motion of one that does not, in few steps."""
    system = controlled(in_motion(cart_scene(), rng), LAWS["impedance"])
    runs = [
        ma.simulate(system, duration=0.1, integrator=name, tolerance=1e-9)
        for name in ("rodas5p", "dop853")
    ]
    apart = np.abs(runs[0].object_position[-1] - runs[1].object_position[-1])
    assert np.max(apart) < 1e-9
    assert runs[0].statistics["steps"] < 300


# --- internal forces ------------------------------------------------------------------------------


def test_hands_of_one_robot_press_towards_each_other():
    ev = ma.evaluate(controlled(cart_scene(), {"kind": "computed_torque", "squeeze": 30.0}))
    plain = ma.evaluate(controlled(cart_scene(), {"kind": "computed_torque"}))
    hands = "cart/left", "cart/right"
    left, right = (ev.wrenches[hand] - plain.wrenches[hand] for hand in hands)
    np.testing.assert_allclose(left, -right, atol=1e-9)
    system = controlled(cart_scene(), "none")
    grips = [system.frames[hand].on_object[:3, 3] for hand in hands]
    inward = (grips[1] - grips[0]) / np.linalg.norm(grips[1] - grips[0])
    np.testing.assert_allclose(left[:3], 30.0 * inward, atol=1e-9)


def test_internal_forces_are_those_of_any_connection():
    """A robot presses on the world, and its links on each other, as hard as it is told."""
    forces = {RAIL: [12.0], GUIDE: [-5.0]}
    ev = ma.evaluate(
        controlled(busy_cart(), {"kind": "computed_torque", "internal_forces": forces})
    )
    np.testing.assert_allclose(ev.contact_forces[RAIL], 12.0, atol=1e-7)
    np.testing.assert_allclose(ev.contact_forces[GUIDE], -5.0, atol=1e-7)
    np.testing.assert_allclose(ev.accelerations, 0.0, atol=1e-7)
    with refused(ControlError, f"control.internal_forces.{RAIL}"):
        wrong = {"kind": "computed_torque", "internal_forces": {RAIL: [1.0, 2.0]}}
        controlled(busy_cart(), wrong)


def test_a_joint_that_gives_way_is_named():
    scene = cart_scene()
    scene["joints"][1]["kind"] = "planar"
    with pytest.raises(ControlError, match="'cart/right'"):
        controlled(
            {**scene, "joints": [{**scene["joints"][0], "kind": "weld"}, sliding(scene)]},
            {"kind": "computed_torque", "squeeze": 5.0},
        )


def sliding(scene: dict[str, Any]) -> dict[str, Any]:
    """The right hand free to slide along the line to the other."""
    return {**scene["joints"][1], "kind": "prismatic", "axis": [0.0, 1.0, 0.0]}


# --- by robot and joint ---------------------------------------------------------------------------


def test_controllers_gains_and_tables_name_robots_and_joints(tmp_path, rng):
    scene = cart_scene()
    wanted = rng.uniform(-1.0, 1.0, 16)
    ev = ma.evaluate(controlled(scene, "none").with_control(lambda t, s: {"cart": wanted}))
    np.testing.assert_array_equal(ev.joint_torques["cart"], wanted)
    table = tmp_path / "push.csv"
    table.write_text("time,cart/base_yaw,cart/torso_lift_joint\n0,3,1\n1,5,1\n")
    system = controlled(scene, {"kind": "recorded", "file": str(table)})
    torques = ma.evaluate(system, 0.5).joint_torques["cart"]
    np.testing.assert_allclose(torques, [0.0, 0.0, 4.0, 1.0, *[0.0] * 12])
    gains = {"kind": "joint_pd", "stiffness": {"cart": {"base_y": 80.0}}, "damping": 0.0}
    system = controlled(scene, {**gains, "gravity_compensation": False})
    state = system.initial_state()
    state.joint_positions["cart"][:3] += [0.1, 0.2, 0.0]
    np.testing.assert_allclose(
        ma.evaluate(system, 0.0, state).joint_torques["cart"][:3], [0.0, -16.0, 0.0]
    )
    with refused(ModelError, "posture_acceleration: unknown robot 'left'"):
        ma.inverse_dynamics(system, state, np.zeros(6), posture_acceleration={"left": np.zeros(3)})


def test_a_stepper_holds_torques_by_robot():
    system = controlled(cart_scene(), "gravity_compensation")
    hold = ma.evaluate(system).joint_torques
    stepper = ma.Stepper(system, accuracy=1e-6)
    before = stepper.state.object_position.copy()
    after = stepper.advance(0.01, torques=hold)
    np.testing.assert_allclose(after.object_position, before, atol=1e-9)
    push = {"cart": hold["cart"] + np.r_[10.0, np.zeros(15)]}
    assert stepper.advance(0.01, torques=push).joint_velocities["cart"][0] > 1e-4


def test_joints_follow_a_path_with_a_hand_that_could_turn():
    """The reference closes all connections, and a hand on a ball keeps its place."""
    scene = cart_scene()
    scene["joints"][1]["kind"] = "ball"
    path = [{"time": 0.5, "xyz": [0.84, 0.03, 1.13], "rpy": [0.0, 0.0, 0.1]}]
    control = {"kind": "joint_pd", "stiffness": 1.0, "damping": 0.0, "gravity_compensation": False}
    system = controlled(scene, {**control, "path": path})
    start = system.initial_state()
    q = start.joint_positions["cart"]
    end = ma.evaluate(system, 0.5).joint_torques["cart"] + q
    state = system.state(
        object_position=path[0]["xyz"],
        object_quaternion_xyzw=Rotation.from_euler("xyz", path[0]["rpy"]).as_quat(),
        joint_positions={"cart": end},
    )
    ev = ma.evaluate(system, 0.5, state)
    assert ev.position_residual < 1e-7
    hand = [system.arms["cart"].tip_pose(x, "right")[:3, :3] for x in (q, end)]
    turn = Rotation.from_euler("xyz", path[0]["rpy"]).as_matrix()
    np.testing.assert_allclose(hand[1], turn @ hand[0], atol=1e-7)


# --- inverse dynamics -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_a_motion_that_happens_gives_its_own_torques_back(family, tmp_path):
    """Torques of the inverse dynamics make the object, and the joints, accelerate as wanted."""
    for seed in range(2):
        rng, folder = np.random.default_rng(seed), tmp_path / str(seed)
        folder.mkdir()
        scene = draw_trees(family, rng, folder).scene
        system = controlled(scene, "none")
        state, connections = system.initial_state(), system.model.connections
        drawn = {name: rng.standard_normal(arm.dof) for name, arm in system.arms.items()}
        happens = driven(system, drawn, state)
        free = {name: None for name, pair in connections.items() if pair.robots}
        inverse = ma.inverse_dynamics(
            system, state, happens.object_acceleration, free,
            posture_acceleration=happens.joint_accelerations,
        )  # fmt: skip
        ev = driven(system, inverse.torques, state)
        size = max(1.0, np.max(np.abs(happens.accelerations)))
        np.testing.assert_allclose(ev.accelerations, happens.accelerations, atol=1e-7 * size)
        for name, forces in inverse.contact_forces.items():
            if name not in connections or not connections[name].of_object:
                np.testing.assert_array_equal(forces, 0.0)


def driven(system, torques, state):
    return ma.evaluate(system.with_control(lambda t, s: torques), 0.0, state)


def test_relative_accelerations_are_those_of_connections(rng):
    """Also of a hand against the world and of two links, by differences along the motion."""
    # the torso would move both upper arms alike, and leave all that is asked for as it is
    scene = in_motion(without_torso(busy_cart(right="ball")), rng)
    system = controlled(scene, "none")
    state, layout = system.initial_state(), system.initial_state().layout
    hold = ma.evaluate(controlled(scene, "gravity_compensation")).joint_torques["cart"]
    happens = driven(system, {"cart": hold + 0.1 * rng.standard_normal(15)}, state)
    h, rates = 1e-4, {}
    for s in (1.0, -1.0):
        moved = state.copy()
        shift = s * h * state.velocity + 0.5 * h * h * happens.accelerations
        moved.position[:] = retract(layout, state.position, shift)
        moved.velocity[:] += s * h * happens.accelerations
        there = ma.evaluate(system, 0.0, moved)
        rates[s] = {name: there.relative_rates(name) for name in system.model.connections}
    changes = {name: (rates[1.0][name] - rates[-1.0][name]) / (2.0 * h) for name in rates[1.0]}
    inverse = ma.inverse_dynamics(system, state, happens.object_acceleration, changes)
    wanted = happens.joint_accelerations["cart"]
    # differences are right to h^2 of third derivatives
    np.testing.assert_allclose(
        inverse.joint_accelerations["cart"], wanted, atol=1e-5 * np.max(np.abs(wanted))
    )
    with pytest.raises(SolverError, match="robot 'cart'"):
        ma.inverse_dynamics(system, state, np.zeros(6), {GUIDE: np.ones(5)})


# --- holding --------------------------------------------------------------------------------------


def test_the_least_torques_that_hold_are_those_of_a_linear_program_over_wrenches():
    """Of welds, any two wrenches with the sum of the weight are possible."""
    scene = without_torso(cart_scene())  # which always has the largest share
    scene["object"]["pose"] = {"xyz": [0.8, 0.15, 1.1]}
    joints = [{"arm": joint["arm"], "kind": "weld"} for joint in scene["joints"]]
    scene = together({**scene, "joints": joints})
    system = controlled(scene, "gravity_compensation")
    holding = carrying_capacity(system, ma.evaluate(system))
    plant, limits = plant_of(scene), system.arms["cart"].effort_limits
    known = np.isfinite(limits)
    J_left, J_right = plant.jacobians.values()
    weight = np.array([0.0, 0.0, 9.81 * scene["object"]["mass"], 0.0, 0.0, 0.0])
    constant = (plant.gravity_torque + J_right.T @ weight)[known] / limits[known]
    slope = (J_left - J_right).T[known] / limits[known, None]
    ones = -np.ones((known.sum(), 1))
    program = linprog(
        np.r_[np.zeros(6), 1.0],
        np.block([[slope, ones], [-slope, ones]]),
        np.r_[-constant, constant],
        bounds=[(None, None)] * 7,
    )
    assert holding.verdict == "carried"
    assert holding.least.largest == pytest.approx(program.x[-1], rel=1e-6)
    torques = ma.evaluate(system).joint_torques["cart"]
    shares = np.abs(torques[known]) / limits[known]
    assert holding.control.largest == pytest.approx(np.max(shares), rel=1e-9)
    assert holding.least.largest < holding.control.largest
