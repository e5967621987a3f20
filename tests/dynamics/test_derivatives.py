"""Claims about derivatives of accelerations and contact forces.

The independent answers are differences of evaluations, of order four, which share neither the
implicit function theorem nor a derivative with the code under test; Pinocchio's own derivatives of
constrained dynamics; and, where constraints are dependent, displacements that keep the joints
closed.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from event_scenes import held_box, lifting
from mechanics import (
    UR5_POSTURE,
    chain_urdf,
    difference,
    over_floor,
    panda_trio,
    planar_pair,
    random_state,
    scene_of,
    single_arm,
    two_arm_block,
    ur5_pair,
)
from pinocchio_forest import constrained_forest
from repository import SCENES
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation
from steps import data_at, without_derivatives

import multiarm as ma
from multiarm.assembly.start import project_start
from multiarm.dynamics import evaluation
from multiarm.dynamics.arrays import CalledFunction
from multiarm.dynamics.control_laws import are_differentiable
from multiarm.dynamics.equation_derivatives import write_derivatives
from multiarm.dynamics.force_derivatives import applied_derivatives
from multiarm.dynamics.status import SINGULAR
from multiarm.errors import ModelError, SolverError
from multiarm.events.evaluation import enter_mode_at, evaluate_mode
from multiarm.jit.ahead import argument_types
from multiarm.jit.pointers import function_at
from multiarm.problems import HARD_CASES
from multiarm.spatial import retract

STEP = 1e-4
FEET = [[0.3, 0.2, -0.2], [-0.3, 0.2, -0.2], [0.0, -0.2, -0.2]]


def moved(state, column: int, amount: float):
    """The state displaced along one column of the derivatives."""
    other, n = state.copy(), state.layout.rate_count
    if 3 <= column < 6:
        turn = amount * np.eye(3)[column - 3]
        other.position[3:7] = retract(state.position[3:7], turn)
    elif column < 3:
        other.position[column] += amount
    elif column < 12:
        other.velocity[column - 6] += amount
    elif column < 12 + n:
        other.position[column - 5] += amount
    else:
        other.velocity[column - 6 - n] += amount
    return other


def answers(system, state, t=0.3):
    """Accelerations of object and joints, and contact forces."""
    ev = ma.evaluate(system, t, state)
    return np.concatenate(
        [ev.object_acceleration, *ev.joint_accelerations.values(), *ev.contact_forces.values()]
    )


def by_differences(system, state):
    """Derivatives of the answers by the state."""
    columns = range(12 + 2 * state.layout.rate_count)
    found = [difference(lambda h, c=c: answers(system, moved(state, c, h))) for c in columns]
    return np.array(found).T


def assert_equal(found, expected, tolerance=1e-8):
    size = np.abs(expected).max(axis=1, keepdims=True) + 1.0
    np.testing.assert_allclose(found / size, expected / size, atol=tolerance)


CURVED = {
    "kind": "contacts",
    "contacts": [
        {
            "arm": {"sphere": {"radius": 0.05}},
            "object": {"ellipsoid": {"semi_axes": [0.6, 0.3, 0.2]}},
        },
    ],
}  # fmt: skip
BALL = {"kind": "ball"}
REGULAR = {
    **{
        kind: lambda kind=kind: ur5_pair({"kind": kind}, BALL)
        for kind in (
            "weld", "revolute", "prismatic", "cylindrical", "universal", "planar", "point_on_plane",
        )
    },
    "point_on_cylinder": lambda: ur5_pair({"kind": "point_on_cylinder", "radius": 0.2}, BALL),
    "point_on_sphere": lambda: ur5_pair({"kind": "point_on_sphere", "radius": 0.3}, BALL),
    "fingertips": lambda: two_arm_block(),
    "an ellipsoid": lambda: ur5_pair(CURVED, BALL),
    "rolling": lambda: ma.load_scene(SCENES / "corner_grippers_block.yaml"),
    "damping, drag, a load": lambda: ur5_pair(
        {"kind": "weld"}, BALL, gravity=[0, 0, -9.81], effects={
            "joint_damping": 0.5, "rotor_inertia": {"left": 0.3, "right": 0.1},
            "drag": {"linear": [1, 2, 3], "quadratic": [4, 5, 6]},
            "external_wrenches": [{"on": "left/wrist_3_link", "force": [9, 2, 1]}],
        },
    ),
    "a path": lambda: ur5_pair(
        {"kind": "weld"}, BALL, gravity=[0, 0, -9.81], control={
            "kind": "joint_pd", "stiffness": 100, "damping": 10,
            "path": [{"time": 1, "xyz": [0, 0, 0.55]}],
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REGULAR)
def test_derivatives_are_those_of_differences(name, rng):
    system = ma.compile_system(REGULAR[name]())
    state = random_state(system, rng, turn=0.1, speed=0.5)
    found = ma.derivatives(system, 0.3, state)
    assert found.message == ""
    expected = by_differences(system, state)
    assert_equal(found.matrix[:, : expected.shape[1]], expected)


def test_joints_may_slide_and_be_more_than_six(tmp_path, rng):
    described, joints = {}, []
    for k, (name, kinds) in enumerate({"a": "xuZywzy", "b": "zyxzvyxz"}.items()):
        file = tmp_path / f"{name}.urdf"
        file.write_text(chain_urdf(kinds))
        base = {"xyz": [1.5 * k, 0.3 * k, 0.2], "rpy": [0.1, 0, 2.5 * k]}
        posture = rng.uniform(-0.6, 0.6, len(kinds)).round(2).tolist()
        described[name] = {"urdf": str(file), "tip": "tip", "posture": posture, "base": base}
        joints.append({"arm": name, "kind": "weld"})
    body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 4.0, "pose": {"xyz": [0.7, 0.2, 1.2]}}
    system = ma.compile_system(scene_of(described, joints, object=body, gravity=[1, 2, -9]))
    state = random_state(system, rng, turn=0.1, speed=0.5)
    found = ma.derivatives(system, 0.3, state)
    expected = by_differences(system, state)
    assert_equal(found.matrix[:, : expected.shape[1]], expected)


HOLDING = {
    "gravity": lambda: ur5_pair(
        {"kind": "revolute"}, BALL, control={"kind": "gravity_compensation"}
    ),
    "points": lambda: ur5_pair({"kind": "weld"}, {"kind": "point_on_sphere", "radius": 0.3}),
    "fingertips": lambda: two_arm_block(),
    "an ellipsoid": lambda: ur5_pair(CURVED, {"kind": "weld"}),
    "without gravity": lambda: ur5_pair({"kind": "weld"}, BALL),
}
SPRING = {
    "stiffness": {"translation": [800, 900, 1000], "rotation": [100, 200, 300]},
    "damping": {"translation": 100, "rotation": [10, 20, 30]},
}
TURNING = [{"time": 1, "xyz": [0.1, 0, 0.55], "rpy": [0.3, 0.2, -0.4]}]
CARRYING = {
    "computed torque": lambda: ur5_pair(
        {"kind": "weld"}, BALL, control={"kind": "computed_torque", "path": TURNING}
    ),
    "passive effects": lambda: ur5_pair(
        {"kind": "weld"}, BALL, control={"kind": "computed_torque"}, effects={
            "joint_damping": 3.0, "joint_friction": {"torque": 3.0, "speed": 0.3},
            "rotor_inertia": 0.2,
        },
    ),
    "free motions": lambda: panda_trio(BALL, control={"kind": "computed_torque", "path": TURNING}),
    "impedance": lambda: ur5_pair(
        {"kind": "weld"}, BALL, control={"kind": "object_impedance", "path": TURNING, **SPRING}
    ),
    "impedance, free motions": lambda: panda_trio(
        {"kind": "revolute"}, control={"kind": "object_impedance", **SPRING}
    ),
    "squeezed fingertips": lambda: two_arm_block().replace(
        control={"kind": "object_impedance", "squeeze": 20.0, **SPRING}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CARRYING)
def test_laws_that_move_the_object_have_the_derivatives_of_differences(name, rng):
    """Differences of order four of torques in which M, b, W, the rates of the gaps and A are."""
    system = ma.compile_system(CARRYING[name]().replace(gravity=[1, 2, -9]))
    state = random_state(system, rng, turn=0.1, speed=0.5)
    by_law, by_differences = (
        forces_by_state(own, state) for own in (system, without_derivatives(system))
    )
    assert_equal(by_law, by_differences, 2e-9)
    assert np.abs(by_law).max() > 1.0
    n = state.layout.rate_count
    assert np.abs(by_law[6:, 12 + n :]).max() > 1.0  # by velocities


HOLDING_POSES = {
    "computed torque": lambda: ur5_pair(
        {"kind": "weld"}, {"kind": "planar"}, control={
            "kind": "computed_torque", "path": TURNING, "relative_stiffness": 40.0,
        },
    ),
    "redundant arms": lambda: panda_trio(
        {"kind": "revolute"}, control={
            "kind": "computed_torque", "path": TURNING, "relative_stiffness": 40.0,
        },
    ),
    "impedance": lambda: panda_trio(
        BALL, control={"kind": "object_impedance", "relative_stiffness": 40.0, **SPRING}
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", HOLDING_POSES)
def test_differences_of_arms_that_hold_poses_converge_to_their_derivatives(name, rng):
    """With order four: half the displacement leaves a sixteenth of the error."""
    system = ma.compile_system(HOLDING_POSES[name]().replace(gravity=[1, 2, -9]))
    state = random_state(system, rng, turn=0.05, speed=0.5)
    by_law, errors = forces_by_state(system, state)[6:], []
    size = np.abs(by_law).max(axis=1, keepdims=True) + 1.0

    def torques(column, displacement):
        ev = ma.evaluate(system, 0.3, moved(state, column, displacement))
        return np.concatenate([*ev.joint_torques.values()])

    largest = 1e-2 if name == "impedance" else 1e-3
    for step in (largest, 0.5 * largest):
        columns = [difference(lambda h, c=c: torques(c, h), step) for c in range(by_law.shape[1])]
        errors.append(np.max(np.abs(np.array(columns).T - by_law) / size))
    assert 14.0 < errors[0] / errors[1] < 18.0
    assert errors[1] < 1e-6


def test_a_held_control_has_the_derivatives_of_its_laws(rng):
    system = ma.compile_system(CARRYING["computed torque"]())
    held = replace(system, model=system.model.with_held_control())
    state = random_state(system, rng, turn=0.1, speed=0.5)
    by_law, of_held = (forces_by_state(own, state) for own in (system, held))
    np.testing.assert_array_equal(of_held, by_law)


@pytest.mark.parametrize("name", HOLDING)
def test_control_in_closed_form_has_the_derivatives_of_differences(name, rng):
    scene = HOLDING[name]()
    if name not in ("gravity", "without gravity"):
        scene = scene.replace(gravity=[1, 2, -9])
    if scene.control is None or scene.control.kind != "gravity_compensation":
        gains = {"stiffness": [90, 80, 70, 60, 50, 40], "damping": 10}
        scene = scene.replace(control={"kind": "joint_pd", **gains})
    system = ma.compile_system(scene)
    state = random_state(system, rng, turn=0.2)
    found, expected = (forces_by_state(own, state) for own in (system, without_derivatives(system)))
    assert_equal(found, expected, 1e-9)
    assert np.abs(found).max() > 1.0


def forces_by_state(system, state, t=0.3):
    """Derivatives of the forces of control and effects, and of the rates of effects' states."""
    with system.borrow() as data:
        evaluation.evaluate(data, t, state)
        return applied_derivatives(data, True)


EFFECTS = {
    "joint_damping": {"joint_damping": 30.0},
    "joint_friction": {"joint_friction": {"torque": 3.0, "speed": 0.3}},
    "drag": {"drag": {"linear": [1, 2, 3], "quadratic": [4, 5, 6], "angular": [1, 2, 3],
                      "wind": [1, -2, 0.5]}},
    "actuator_lag": {"actuator_lag": {"left": 0.1, "right": [0.2, 0, 0.1, 0, 0, 0.3]}},
    "torque_limits": {"torque_limits": 2.0},
    "limits before lag": {"torque_limits": 2.0, "actuator_lag": 0.1},
    "loads in axes of the world": {"external_wrenches": [
        {"on": "left/wrist_2_link", "at": [0, 0.1, 0.2], "force": [5, 6, 7], "torque": [1, 2, 3]},
        {"on": "object", "at": [0, 0.1, 0.2], "force": [5, 6, 7], "torque": [1, 2, 3]},
    ]},
    "loads in axes of the body": {"external_wrenches": [
        {"on": "right/forearm_link", "at": [0, 0.1, 0.2], "force": [5, 6, 7],
         "torque": [1, 2, 3], "axes": "body"},
        {"on": "object", "at": [0, 0.1, 0.2], "force": [5, 6, 7], "torque": [1, 2, 3],
         "axes": "body", "sinusoid": {"frequency": 0.4}},
    ]},
}  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_have_the_derivatives_of_differences(name, rng):
    control = {"kind": "joint_pd", "stiffness": 100, "damping": 10, "gravity_compensation": False}
    system = ma.compile_system(
        ur5_pair({"kind": "weld"}, BALL, control=control, effects=EFFECTS[name])
    )
    assert all(own.derivative is not None for own in system.model.effects.kernels)
    state = random_state(system, rng, turn=0.2, speed=0.5)
    found, expected = (forces_by_state(own, state) for own in (system, without_derivatives(system)))
    assert_equal(found, expected, 1e-9)
    free = forces_by_state(
        ma.compile_system(ur5_pair({"kind": "weld"}, BALL, control=control)), state
    )
    assert np.abs(found[: len(free), : free.shape[1]] - free).max() > 0.1


def test_springs_of_contacts_have_the_derivatives_of_differences(rng):
    """Of the forces' directions and sizes, on a plane, a cylinder and in a ball joint."""
    springs = {"contact_compliance": {"stiffness": 2e4, "damping": 300.0}}
    curved = {"kind": "point_on_cylinder", "radius": 0.2}
    for joint in ({"kind": "weld"}, curved):
        system = ma.compile_system(ur5_pair(joint, BALL, effects=springs))
        state = random_state(system, rng, turn=0.2, speed=0.5)
        found, expected = (
            applied_derivatives(data_at(own, state), True)
            for own in (system, without_derivatives(system))
        )
        largest = np.abs(expected).max()  # roundings of these forces, where some are zero
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * largest)
        assert largest > 1e4


def test_contacts_that_cannot_carry_the_weight_leave_differences(rng):
    control = {"kind": "joint_pd", "stiffness": 100, "damping": 10}
    system = ma.compile_system(
        single_arm("ur5", "tool0", UR5_POSTURE, BALL, control=control, gravity=[0, 0, -9.81])
    )
    state = random_state(system, rng, turn=0.1)
    with system.borrow() as data:
        evaluation.evaluate(data, 0.3, state)
        applied_derivatives(data, True)  # prepares those of the law
        law = CalledFunction(*data.model.constants.control[1].tolist())
        call = function_at(law.derivative)
        at = float(law.numbers_at)
        assert call(data.struct.ctypes.data, data.struct.size, at, 0.3) == SINGULAR
    found, expected = ma.derivatives(system, 0.3, state), by_differences(system, state)
    assert_equal(found.matrix[:, : expected.shape[1]], expected)


@pytest.mark.parametrize("effect", [{"actuator_lag": 0.1}, {"torque_limits": 2.0}])
def test_torques_are_what_drives_that_delay_or_limit_them_leave(effect, rng):
    control = {"kind": "joint_pd", "stiffness": 100, "damping": 10, "gravity_compensation": False}
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL, control=control, effects=effect))
    state = random_state(system, rng, turn=0.1)
    found = ma.derivatives(system, 0.3, state)
    if "actuator_lag" in effect:  # torques do not follow the state at once
        held = ma.derivatives(system, 0.3, state, closed_loop=False)
        one, other = (own.object_acceleration.matrix[:, :36] for own in (found, held))
        np.testing.assert_allclose(one, other, atol=1e-8 * np.abs(other).max())
    else:
        expected = by_differences(system, state)
        assert_equal(found.matrix[:, : expected.shape[1]], expected)


def test_torques_move_every_arm():
    """By torques the equations are linear: one difference is the derivative."""
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL))
    state = system.initial_state()
    found = ma.derivatives(system, 0.0, state)
    for arm in system.arm_names:
        for joint in range(6):
            torque = {arm: np.eye(6)[joint]}
            pushed = system.with_control(lambda t, s, torque=torque: torque)
            change = answers(pushed, state) - answers(system, state)
            n = system.model.layout.rate_count
            column = 12 + 2 * n + 6 * system.arm_names.index(arm) + joint
            np.testing.assert_allclose(found.matrix[:, column], change, atol=1e-9)
    block = found.joint_accelerations["left"].d_torques["right"]
    assert block.shape == (6, 6) and np.abs(block).max() > 1e-3
    np.testing.assert_array_equal(found.object_acceleration.d_torques["left"].shape, (6, 6))
    assert found.contact_forces["right"].d_object_pose.shape == (3, 6)


TOUCHING = {
    "kind": "contacts",
    "contacts": [
        {"arm": {"sphere": {"center": [0.1, 0.2, 0.3], "radius": 0.05}},
         "object": {"plane": {"point": [-0.6, 0, 0], "normal": [-1, 0.2, 0.1]}}},
        {"arm": {"sphere": {"center": [0.1, -0.2, 0.1], "radius": 0.02}},
         "object": {"ellipsoid": {"semi_axes": [0.6, 0.3, 0.2]}}},
    ],
}  # fmt: skip


@pytest.mark.slow
def test_parameters_of_the_object_and_places_of_contacts(rng):
    """Against scenes that are compiled with other numbers, at a moving state."""

    def system(mass=20.0, inertia=(1.2, 0.1, -0.2, 2.4, 0.15, 2.9), force=None, moved=None):
        joint = json.loads(json.dumps(TOUCHING))
        for contact in joint["contacts"]:
            centre = np.array(contact["arm"]["sphere"]["center"])
            if moved is not None:
                centre = Rotation.from_rotvec(moved[3:]).apply(centre) + moved[:3]
            contact["arm"]["sphere"]["center"] = centre.tolist()
        body = {
            "shape": {"box": [1.2, 0.6, 0.4]}, "pose": {"xyz": [0, 0, 0.5]}, "mass": mass,
            "inertia": list(inertia),
        }  # fmt: skip
        load = {"on": "object", "force": [5, 0, 0], "torque": [0, 1, 0]}
        if force is not None:
            load = {"on": "object", "force": force[:3].tolist(), "torque": force[3:].tolist()}
        effects = {"external_wrenches": [load], "joint_damping": 0.5}
        scene = ur5_pair(joint, BALL, object=body, gravity=[0, 1, -9.81], effects=effects)
        return ma.compile_system(scene, assemble=False)

    state = random_state(system(), rng, turn=0.1, speed=0.7)
    found = ma.derivatives(system(), 0.3, state, parameters=True)
    rows = slice(found.rows["contact_forces"].stop)
    base = np.array([1.2, 0.1, -0.2, 2.4, 0.15, 2.9])
    turned = system().arms["left"].tip.rotation  # of the tip against the link that carries it

    def along(change):
        return difference(lambda h: answers(system(**change(h)), state))

    expected = [along(lambda h: {"mass": 20.0 + h})]
    expected += [along(lambda h, e=e: {"inertia": base + h * e}) for e in np.eye(6)]
    wrench = np.array([5.0, 0, 0, 0, 1.0, 0])
    expected += [along(lambda h, e=e: {"force": wrench + h * e}) for e in np.eye(6)]
    names = ("object_mass", "object_inertia", "object_wrench")
    columns = np.hstack([found.matrix[rows][:, found.columns[name]] for name in names])
    assert_equal(columns, np.array(expected).T, 1e-8)
    # a displacement of the contacts about the tip, in its axes, is one of the link in its own
    tip = system().arms["left"].tip.translation
    of_left = found.matrix[rows, found.columns["placements"]][:, :6]
    for k, axis in enumerate(np.eye(6)):
        own = np.r_[turned @ axis[:3], turned @ axis[3:]]
        own[:3] += np.cross(tip, own[3:])
        expected = along(lambda h, axis=axis: {"moved": h * axis})
        assert_equal((of_left @ own)[:, None], expected[:, None], 1e-8)
        assert k < 3 or np.abs(expected).max() > 1e-3
    for one in (found.joint_accelerations["right"], found.contact_forces["left"]):
        assert one.d_placements["left"].shape[1] == 6 and one.d_object_mass.ndim == 1
    with pytest.raises(ModelError, match="parameters=True"):
        _ = ma.derivatives(system(), 0.3, state).object_acceleration.d_object_wrench


def test_in_open_loop_the_torques_are_held(rng):
    control = {"kind": "joint_pd", "stiffness": 100, "damping": 10}
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL, control=control))
    state = random_state(system, rng, turn=0.1)
    torques = ma.evaluate(system, 0.0, state).joint_torques
    held = ma.derivatives(system.with_control(lambda t, s: torques), 0.0, state).matrix
    open_loop = ma.derivatives(system, 0.0, state, closed_loop=False)
    np.testing.assert_allclose(open_loop.matrix, held, atol=1e-9 * np.abs(held).max())
    closed = ma.derivatives(system, 0.0, state)
    one, other = (
        found.joint_accelerations["left"].d_joint_velocities["left"]
        for found in (closed, open_loop)
    )
    by_torque = closed.joint_accelerations["left"].d_torques["left"]
    np.testing.assert_allclose(one - other, -10.0 * by_torque, atol=1e-8 * np.abs(one).max())


@pytest.mark.parametrize("kind", ["weld", "ball"])
def test_derivatives_are_those_of_pinocchio(kind):
    """Of its constrained dynamics, along displacements that keep the joints closed.

    Pinocchio's own derivatives serve for rows of six; those of three between two bodies are not the
    differences of its dynamics, which are taken instead.
    """
    system = ma.compile_system(ur5_pair({"kind": kind}, {"kind": kind}, gravity=[0, 0, -9.81]))
    state = system.initial_state()
    contact = pin.ContactType.CONTACT_6D if kind == "weld" else pin.ContactType.CONTACT_3D
    model, q, R, models, datas = constrained_forest(system, state, contact)
    data, still = model.createData(), np.zeros(model.nv)
    settings = pin.ProximalSettings(1e-15, 1e-9, 200)

    def accelerations(at):
        pin.initConstraintDynamics(model, data, models, datas)
        return pin.constraintDynamics(model, data, at, still, still, models, datas, settings).copy()

    accelerations(q)
    pin.computeConstraintDynamicsDerivatives(model, data, models, datas, settings)
    by_q, by_torque = data.ddq_dq.copy(), data.ddq_dtau.copy()
    pin.computeJointJacobians(model, data, q)
    closing = null_space(pin.getConstraintsJacobian(model, data, models, datas))
    if kind == "ball":
        axes = np.eye(model.nv)
        along = [
            difference(lambda h, e=e: accelerations(pin.integrate(model, q, h * e))) for e in axes
        ]
        by_q = np.array(along).T
    n = state.layout.rate_count
    joints = ma.derivatives(system, 0.0, state).matrix[6 : 6 + n]
    assert_equal(joints[:, 12 + 2 * n :], by_torque[:n, :n], 1e-9)
    of_object = np.kron(np.eye(2), R) @ closing[n:]  # in world axes
    found = joints[:, :6] @ of_object + joints[:, 12 : 12 + n] @ closing[:n]
    assert_equal(found, by_q[:n] @ closing, 1e-9)


# --- dependent constraints ------------------------------------------------------------------------


def displacement(base, other):
    """The columns between two states."""
    turn = Rotation.from_quat(other.position[3:7]) * Rotation.from_quat(base.position[3:7]).inv()
    change, faster = other.position - base.position, other.velocity - base.velocity
    return np.concatenate([change[:3], turn.as_rotvec(), faster[:6], change[7:], faster[6:]])


@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("kind", ["weld", "ball"])
def test_dependent_constraints_are_differentiated_along_the_joints(kind, moving, rng):
    """Each of two arms in the plane keeps the disc there: some rows say the same twice."""
    system = ma.compile_system(planar_pair("planar_3r", [0.4, 0.7, -0.5], {"kind": kind}))

    def on_joints(state):
        with system.borrow() as data:
            return project_start(data, system.scene, state)[0]

    state = system.initial_state()
    if moving:
        state = on_joints(random_state(system, rng, turn=0.0))
    found = ma.derivatives(system, 0.3, state)
    # of the arms' ball joints together no row says the same twice
    assert ("repeat others" in found.message) == (kind == "weld")
    unique = np.concatenate([np.ones(12, bool), *found.evaluation.contact_forces_unique.values()])
    assert np.all(np.isfinite(found.matrix[unique])) and np.all(np.isnan(found.matrix[~unique]))
    tangents, seen = [], 0.0
    for _ in range(12):
        direction = rng.standard_normal(12 + 2 * state.layout.rate_count)

        def along(h, direction=direction):
            other = state
            for column, amount in enumerate(direction):
                other = moved(other, column, 0.3 * h * amount)
            return on_joints(other)

        tangent = difference(lambda h: displacement(state, along(h)))
        tangents.append(tangent / np.linalg.norm(tangent))
        expected = difference(lambda h: answers(system, along(h)))[unique]
        one = found.matrix[unique][:, : len(tangent)] @ tangent
        np.testing.assert_allclose(one, expected, atol=1e-7 * (1.0 + np.abs(expected).max()))
        seen = max(seen, np.abs(expected).max())
    assert seen > 1e-3
    if found.message:  # displacements that break the joints count by what is left of them on these
        u, size, _ = np.linalg.svd(np.array(tangents).T, full_matrices=False)
        basis = u[:, size > 1e-6 * size[0]]
        assert basis.shape[1] == 2 * (12 - found.evaluation.rank)
        by_state = found.matrix[unique][:, : len(basis)]
        left = by_state - by_state @ basis @ basis.T
        np.testing.assert_allclose(left, 0.0, atol=1e-6 * np.abs(by_state).max())


# --- contacts that open ---------------------------------------------------------------------------


@pytest.mark.parametrize("gap", [0.1, 0.0])
def test_control_knows_the_contacts_of_joints_only(gap):
    """Its derivatives are those of differences, whatever else is closed."""
    control = {"kind": "joint_pd", "stiffness": 100, "damping": 10}
    welded = {"joints": [{"arm": "arm", "kind": "weld"}], "control": control}
    system = ma.compile_system(over_floor(gap).scene.replace(**welded))
    assert are_differentiable(system.model.laws)
    plain = without_derivatives(system)
    found, expected = (ma.derivatives(own, 0.3).matrix for own in (system, plain))
    fixed = np.isfinite(expected)
    assert_equal(np.where(fixed, found, 0.0), np.where(fixed, expected, 0.0))
    assert np.abs(expected[fixed]).max() > 1.0


def test_open_contacts_have_no_part():
    """Far above the floor the derivatives are those without it."""
    system = over_floor(0.1)
    found = ma.derivatives(system)
    assert set(found.evaluation.contact_states["floor"]) == {"open"}
    free = system.scene.replace(effects={})
    expected = ma.derivatives(ma.compile_system(free)).matrix
    np.testing.assert_allclose(found.matrix[: len(expected)], expected, atol=1e-9)
    assert not found.matrix[len(expected) :].any() and len(found.matrix) == len(expected) + 8


def test_closed_contacts_stay_closed():
    """Four corners on the floor, where three are enough: torques change what is unique."""
    system = over_floor(0.0)
    found = ma.derivatives(system)
    closed = np.array(found.evaluation.contact_states["floor"]) != "open"
    assert closed.sum() == 4 and "constraints that repeat others: 1 of 7" in found.message
    assert np.isnan(found.matrix[-8:][closed]).all() and not found.matrix[-8:][~closed].any()
    assert np.isfinite(found.matrix[:-8]).all()
    assert list(found.contact_forces) == list(found.evaluation.contact_forces) == ["arm", "floor"]
    np.testing.assert_array_equal(found.contact_forces["floor"].matrix, found.matrix[-8:])

    def pushed(torque):
        system_with = system.with_control(lambda t, s: {"arm": torque})
        return answers(system_with, system.initial_state())[:12]

    for joint in range(6):
        change = pushed(np.eye(6)[joint]) - pushed(np.zeros(6))
        np.testing.assert_allclose(found.matrix[:12, 24 + joint], change, atol=1e-9)


def test_a_joint_at_its_stop_stays_there():
    """The box rests on more corners than it needs, the arm on the end of a joint's range."""
    ends = {"arm": {"shoulder_lift_joint": [-3.0, UR5_POSTURE[1]]}}
    found = ma.derivatives(over_floor(0.0, ends))
    assert "repeat others" in found.message
    fixed = np.isfinite(found.matrix).all(axis=1)
    row = found.joint_accelerations["arm"]
    np.testing.assert_allclose(row.matrix[1], 0.0, atol=1e-9)  # whatever is displaced
    np.testing.assert_allclose(found.matrix[fixed][:, [13, 19]], 0.0, atol=1e-9)


def test_the_floor_is_differentiated_by_the_code_that_is_compiled_for_arms():
    ma.derivatives(over_floor(0.0))
    kernel = write_derivatives
    assert kernel.whole.signatures == [argument_types(kernel)]


@pytest.mark.parametrize("seed", range(4))
def test_sliding_contacts_are_differentiated_with_their_friction(seed):
    """On three feet, and of an arm whose fingers slide; all contacts keep what they do."""
    rng = np.random.default_rng(seed)
    if seed < 3:
        system = over_floor(0.0, mu=0.3, points=FEET)
        state = system.initial_state()
        state.velocity[[0, 1, 5, *range(6, 12)]] = rng.uniform(-0.5, 0.5, 9)
    else:
        system = ma.compile_system(held_box(0.3))
        state = system.state(object_twist=[0, 0.1, -0.2, 0, 0, 0])
        held = lifting(0.0)(0.0, state)
        system = system.with_control(lambda t, s: held)
    found = ma.derivatives(system, 0.3, state)
    states = sum(found.evaluation.contact_states.values(), ())
    assert found.message == "" and "sliding" in states
    with system.borrow() as data:
        modes = enter_mode_at(data, 0.3, state)

        def along(column, h):
            ev = evaluate_mode(modes, 0.3, moved(state, column, h))
            motion = [ev.object_acceleration, *ev.joint_accelerations.values()]
            return np.concatenate([*motion, *ev.contact_forces.values()])

        columns = range(12 + 2 * state.layout.rate_count)
        expected = np.array([difference(lambda h, c=c: along(c, h)) for c in columns]).T
    assert_equal(found.matrix[:, : len(columns)], expected)


def test_friction_that_leaves_the_motion_open_is_refused_with_the_reason():
    """A box that spins on four corners."""
    system = over_floor(0.0, mu=0.3)
    state = system.initial_state()
    state.velocity[[0, 1, 5]] = 0.3, 0.2, 0.5
    with pytest.raises(SolverError, match="leave the motion open at this state"):
        ma.derivatives(system, 0.0, state)


def test_dependent_constraints_stay_dependent_beside_the_joints(rng):
    """Off its joints a loop of Bricard's is rigid; roundings and steps of 1e-6 must not stop it."""
    node = ma.compile_system(HARD_CASES["bricard"].scene())
    state = node.initial_state()
    beside = state.copy()
    beside.position[7:] += 1e-6 * rng.normal(size=beside.position.size - 7)
    for system in (node, node.with_solver("dense")):
        on, off = (ma.derivatives(system, 0.0, x) for x in (state, beside))
        assert on.evaluation.rank == off.evaluation.rank == on.layout.contacts - 1
        assert np.linalg.matrix_rank(off.motions.admissible(), tol=1e-3) == 2
        np.testing.assert_allclose(off.matrix, on.matrix, rtol=0, atol=1e-4)
        unique = (x.evaluation.contact_forces_unique for x in (on, off))
        for expected, found in zip(*(own.values() for own in unique), strict=True):
            np.testing.assert_array_equal(found, expected)
        of_motion = (ma.linearise(system, 0.0, x).A for x in (state, beside))
        np.testing.assert_allclose(*of_motion, rtol=0, atol=1e-4)


def test_what_is_no_system_or_state_is_said():
    system = over_floor(0.1)
    with pytest.raises(ModelError, match=r"ma\.derivatives\(system, t, state\)"):
        ma.derivatives(system.scene)
    with pytest.raises(ModelError, match="the order is system, t, state"):
        ma.derivatives(system, system.initial_state())
