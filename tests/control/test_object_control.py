"""Claims about the control laws that move the object: computed torque and object impedance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import G, panda_trio, project_velocity, single_arm, two_arm_block, ur5_pair
from refusals import refused
from repository import SCENES
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.control.object_control import write_spring_wrench
from multiarm.control.object_law import ObjectLaw
from multiarm.control.object_path import PosePath, PosePaths
from multiarm.dynamics.solver.factors import solve_semidefinite
from multiarm.errors import ControlError, SceneError

WELD, HINGE = {"kind": "weld"}, {"kind": "revolute"}
PATH = [
    {"time": 0.5, "xyz": [0, 0.02, 0.55], "rpy": [0, 0.1, 0.2]},
    {"time": 1.0, "xyz": [0.03, 0, 0.5]},
]
SHIFTED = {"xyz": [0.02, -0.01, 0.53], "rpy": [0, 0, 0.2]}
SPRING = {
    "stiffness": {"translation": [900.0, 1200.0, 1500.0], "rotation": [100.0, 200.0, 350.0]},
    "damping": {"translation": [300.0, 350.0, 400.0], "rotation": [30.0, 40.0, 50.0]},
}


def resting_at(pose):
    """A path that stays at one pose from the beginning."""
    return [{"time": 0.0, **pose}, {"time": 1.0, **pose}]


def computed_torque(build=lambda: ur5_pair(WELD, HINGE), **control):
    control = {"kind": "computed_torque", **control}
    return ma.compile_system(build().replace(control=control))


def impedance(build=lambda: ur5_pair(WELD, HINGE), **control):
    control = {"kind": "object_impedance", **SPRING, **control}
    return ma.compile_system(build().replace(control=control))


def corner_grippers():
    return ma.load_scene(SCENES / "corner_grippers_block.yaml")


def moving(system, rng):
    """A state on the constraints, everything in motion."""
    state = system.initial_state()
    state.velocity[:] = 0.5 * rng.standard_normal(state.velocity.size)
    return project_velocity(system, state)


def stacked_forces(ev):
    return np.concatenate(list(ev.contact_forces.values()))


def quintic(s):
    """Way, and its first and second derivatives."""
    s = np.clip(s, 0.0, 1.0)
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        30 * s**2 * (1 - s) ** 2,
        60 * s * (1 - s) * (1 - 2 * s),
    )


def reference(t, start=(0, 0, 0.5)):
    """Pose, twist and acceleration that ``PATH`` asks for, from the start's pose on."""
    points = [np.array(start), *(np.array(w["xyz"]) for w in PATH)]
    turns = [np.eye(3), *(Rotation.from_euler("xyz", w.get("rpy", [0, 0, 0])).as_matrix()
                          for w in PATH)]  # fmt: skip
    leg = 0 if t < 0.5 else 1
    way, rate, second = quintic((t - 0.5 * leg) / 0.5)
    shift = points[leg + 1] - points[leg]
    turn = Rotation.from_matrix(turns[leg + 1] @ turns[leg].T).as_rotvec()
    both = np.concatenate([shift, turn])
    rotation = Rotation.from_rotvec(way * turn) * Rotation.from_matrix(turns[leg])
    return points[leg] + way * shift, rotation, rate / 0.5 * both, second / 0.25 * both


def pose_error(state, position, rotation):
    """Shift and shortest turn (world axes) from a state to a pose."""
    turn = rotation * Rotation.from_quat(state.object_quaternion_xyzw).inv()
    return np.concatenate([position - state.object_position, turn.as_rotvec()])


# --- computed torque -----------------------------------------------------------------------------


def test_object_follows_its_path_to_the_accuracy_of_the_run():
    system = computed_torque(path=PATH)
    run = ma.simulate(system, duration=1.2, accuracy=1e-7, output_step=0.05)
    assert run.status == "completed"
    for t, x, q in zip(run.time, run.object_position, run.object_quaternion_xyzw, strict=True):
        position, rotation, _, _ = reference(t)
        np.testing.assert_allclose(x, position, atol=1e-7)
        assert (rotation * Rotation.from_quat(q).inv()).magnitude() < 1e-7
    assert np.max(np.abs(run.energy_balance)) < 1e-5
    assert system.model.breakpoints.tolist() == [0.0, 0.5, 1.0]


BUILDS = {
    "weld_and_hinge": lambda: ur5_pair(WELD, HINGE),
    "damped_joints": lambda: ur5_pair(WELD, HINGE).replace(effects={"joint_damping": 4.0}),
    "three_pandas": lambda: panda_trio({"kind": "ball"}),
    "no_gravity": lambda: ur5_pair(WELD, WELD).replace(gravity=None),
    "fingertips": lambda: two_arm_block(),
    "dense": lambda: ur5_pair(WELD, WELD).replace(run={"solver": "dense"}),
}


@pytest.mark.parametrize("build", BUILDS)
def test_object_accelerates_exactly_as_commanded(build, rng):
    """Whatever moves, whatever joints and effects there are (errors of pose and velocity too)."""
    gains = {
        "stiffness": {"translation": [90, 100, 110], "rotation": 70},
        "damping": {"translation": 17, "rotation": [13, 14, 15]},
    }
    path = [{"time": 0.0, **SHIFTED}, {"time": 2.0, "xyz": [0.1, 0.1, 0.6]}]
    system = computed_torque(BUILDS[build], path=path, **gains)
    state, t = moving(system, rng), 0.7
    way, rate, second = quintic(t / 2.0)
    begin = Rotation.from_euler("xyz", SHIFTED["rpy"])
    shift = np.array(path[1]["xyz"]) - SHIFTED["xyz"]
    both = np.concatenate([shift, begin.inv().as_rotvec()])
    e = pose_error(
        state, SHIFTED["xyz"] + way * shift, Rotation.from_rotvec(way * both[3:]) * begin
    )
    expected = second / 4.0 * both
    expected += np.array([90, 100, 110, 70, 70, 70]) * e
    expected += np.array([17, 17, 17, 13, 14, 15]) * (rate / 2.0 * both - state.object_twist)
    ev = ma.evaluate(system, t, state)
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(ev.object_acceleration, expected, atol=1e-9 * scale)


@pytest.mark.parametrize(("stiffness", "damping"), [(60.0, 4.0), (100.0, 25.0)])
def test_errors_die_out_by_their_own_equation(stiffness, damping):
    """e'' + D e' + K e = 0 from rest, with a shift and a turn about a fixed axis."""
    system = computed_torque(path=resting_at(SHIFTED), stiffness=stiffness, damping=damping)
    run = ma.simulate(system, duration=0.8, accuracy=1e-8, output_step=0.1)
    roots = np.roots([1.0, damping, stiffness])
    factors = np.array([roots[1], -roots[0]]) / (roots[1] - roots[0])
    left = np.real(np.exp(np.outer(run.time, roots)) @ factors)
    start = np.array([0.02, -0.01, 0.03])
    np.testing.assert_allclose(
        np.array(SHIFTED["xyz"]) - run.object_position, np.outer(left, start), atol=1e-8
    )
    yaw = Rotation.from_quat(run.object_quaternion_xyzw).as_rotvec()
    np.testing.assert_allclose(yaw[:, 2], 0.2 - 0.2 * left, atol=1e-8)
    np.testing.assert_allclose(yaw[:, :2], 0.0, atol=1e-8)


def test_motions_that_the_object_does_not_need_are_damped(rng):
    """Joint accelerations are, along free motions, those of free motions that die out."""
    system = computed_torque(lambda: panda_trio({"kind": "revolute"}), relative_damping=7.0)
    state = moving(system, rng)
    ev = ma.evaluate(system, 0.0, state)
    for arm in system.arm_names:
        terms = system.arms[arm].terms(state.joint_positions[arm], state.joint_velocities[arm])
        W_m = np.kron(np.eye(2), terms.tip_rotation) @ ev.contact_terms[arm].W_m
        free = null_space(W_m.T @ terms.J)
        assert free.shape == (7, 2)
        left = ev.joint_accelerations[arm] + 7.0 * state.joint_velocities[arm]
        np.testing.assert_allclose(free.T @ terms.M @ left, 0.0, atol=1e-9)


@pytest.mark.parametrize("n, rank", [(6, 5), (6, 4), (5, 1)])
def test_semidefinite_solution_below_full_rank_is_that_of_the_pseudoinverse(n, rank, rng):
    """Also for a right-hand side that the matrix cannot meet, and whatever its pivots are."""
    root = rng.standard_normal((n, rank))
    A, b, x = root @ root.T, rng.standard_normal(n), np.full(n, np.nan)
    assert solve_semidefinite(A.copy(), b, x) == rank
    np.testing.assert_allclose(x, np.linalg.pinv(A, rcond=1e-10) @ b, atol=1e-9 * np.abs(x).max())


def test_weight_that_a_joint_cannot_carry_is_shared_without_jumps():
    """One ball beside the centre of mass: where pivots decided, steps fell to 1e-9 s."""
    scene = ma.Scene(
        gravity=[0, 0, -9.81],
        object={"shape": {"sphere": 0.1}, "mass": 2.0, "pose": {"xyz": [0.6, 0, 0.5]}},
        arms={"arm": {"robot": "ur5", "posture": "solve"}},
        joints=[{"arm": "arm", "kind": "ball", "at": {"xyz": [-0.1, 0, 0]}}],
        control={"kind": "gravity_compensation"},
    )
    run = ma.simulate(ma.compile_system(scene), duration=0.3, accuracy=1e-6)
    assert run.status == "completed" and run.certificate["met"]
    assert run.statistics["steps"] < 200


def test_semidefinite_solution_finds_the_rank(rng):
    for n, rank in ((6, 6), (6, 4), (5, 1), (3, 0)):
        root = rng.standard_normal((n, rank))
        A, wish = root @ root.T, rng.standard_normal(n)
        b, x = A @ wish, np.full(n, np.nan)
        assert solve_semidefinite(A.copy(), b, x) == rank
        np.testing.assert_allclose(A @ x, b, atol=1e-9)


# --- internal forces -----------------------------------------------------------------------------


@pytest.mark.parametrize("law", [computed_torque, impedance])
def test_squeezed_arms_press_towards_each_other(law, rng):
    """Beside what moves the object, weld and hinge push with 30 N along the line of the grips."""
    plain, squeezed = law(), law(squeeze=30.0)
    state = moving(plain, rng)
    one, other = (ma.evaluate(system, 0.0, state) for system in (plain, squeezed))
    np.testing.assert_allclose(other.object_acceleration, one.object_acceleration, atol=1e-9)
    frames = plain.frames
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    line = R @ (frames["right"].on_object[:3, 3] - frames["left"].on_object[:3, 3])
    line /= np.linalg.norm(line)
    for arm, sign in (("left", 1.0), ("right", -1.0)):
        more = other.contact_forces[arm] - one.contact_forces[arm]
        push = more @ other.contact_normals[arm]
        np.testing.assert_allclose(push, 30.0 * sign * line, atol=1e-8)
        about = R @ frames[arm].on_object[:3, 3] + state.object_position
        moment = np.cross(other.contact_points[arm] - about, other.contact_normals[arm])
        np.testing.assert_allclose(more @ moment, 0.0, atol=1e-8)


def test_three_arms_press_towards_the_middle():
    build = lambda: panda_trio({"kind": "ball"})  # noqa: E731
    plain, squeezed = (ma.evaluate(computed_torque(build, squeeze=s)) for s in (0.0, 12.0))
    pushes = []
    for arm in plain.contact_forces:
        more = squeezed.contact_forces[arm] - plain.contact_forces[arm]
        pushes.append(more @ squeezed.contact_normals[arm])
    np.testing.assert_allclose(np.linalg.norm(pushes, axis=1), 12.0, rtol=1e-3)
    np.testing.assert_allclose(np.sum(pushes, axis=0), 0.0, atol=1e-9)
    inward = [-np.cos(2 * math.pi * k / 3) for k in range(3)]
    np.testing.assert_allclose(np.array(pushes)[:, 0] / 12.0, inward, atol=1e-2)


@pytest.mark.parametrize("build", [corner_grippers, two_arm_block])
def test_squeezed_fingertips_only_push_harder(build):
    """Every contact is pressed; the mean over all of them is the squeeze."""
    plain, squeezed = (ma.evaluate(computed_torque(build, squeeze=s)) for s in (0.0, 40.0))
    more = stacked_forces(squeezed) - stacked_forces(plain)
    assert np.min(more) > 1.0
    assert np.mean(more) == pytest.approx(40.0, rel=1e-9)
    W_o = squeezed.W_o
    np.testing.assert_allclose(W_o @ more, 0.0, atol=1e-8)


def test_squeeze_is_kept_on_the_way():
    """In a run from pose to pose: the force along the line of the grips stays as told."""
    run = {"duration": 1.0, "accuracy": 1e-6, "output_step": 0.25}
    plain, squeezed = (ma.simulate(computed_torque(path=PATH, squeeze=s), **run) for s in (0, 25.0))
    system = computed_torque(path=PATH)
    for k in range(len(plain.time)):
        state = system.state(
            squeezed.object_position[k], squeezed.object_quaternion_xyzw[k],
            {arm: q[k] for arm, q in squeezed.joint_positions.items()},
        )  # fmt: skip
        normals = ma.evaluate(system, 0.0, state).contact_normals["left"]
        more = squeezed.contact_forces["left"][k] - plain.contact_forces["left"][k]
        assert np.linalg.norm(more @ normals) == pytest.approx(25.0, rel=1e-4)


def test_wanted_contact_forces_come_as_far_as_they_are_internal(rng):
    wanted = {"left": 10 * rng.standard_normal(6), "right": 10 * rng.standard_normal(5)}
    named = {arm: forces.tolist() for arm, forces in wanted.items()}
    plain, pressed = (
        ma.evaluate(computed_torque(**more)) for more in ({}, {"internal_forces": named})
    )
    W_o = pressed.W_o
    offsets = np.concatenate(list(wanted.values()))
    expected = offsets - np.linalg.pinv(W_o) @ (W_o @ offsets)
    np.testing.assert_allclose(stacked_forces(pressed) - stacked_forces(plain), expected, atol=1e-8)


# --- object impedance ----------------------------------------------------------------------------


def test_spring_moment_is_the_slope_of_its_energy(rng):
    """1/2 e^T K e with a stiffness of its own about each axis, also in large turns."""
    stiffness = np.array([900.0, 1200.0, 1500.0, 100.0, 200.0, 350.0])
    for _ in range(20):
        rest, q = Rotation.random(random_state=rng), Rotation.random(random_state=rng)
        x, x_r = rng.standard_normal((2, 3))
        zero = np.zeros((1, 3))
        still = PosePath(np.array([0.0, 1.0]), x_r[None], zero, rest.as_quat()[None], zero)
        no_friction = np.zeros(0, dtype=int), np.zeros(0), 0.0
        no_forces = *no_friction, np.zeros(0), np.zeros((0, 6)), np.zeros(0, dtype=int)
        paths = PosePaths.of([still])
        law = ObjectLaw(np.array([0]), stiffness, np.zeros(6), 0.0, 0.0, False, *no_forces, *paths)

        def energy(step, q=q, rest=rest, x=x, x_r=x_r):
            turned = Rotation.from_rotvec(step[3:]) * q
            e = np.concatenate([x_r - x - step[:3], (rest * turned.inv()).as_rotvec()])
            return 0.5 * stiffness @ e**2

        if (rest * q.inv()).magnitude() > 3.0:  # at half a turn the energy has a ridge
            continue
        wrench, h = np.empty(6), 1e-4
        pose = np.concatenate([x, q.as_quat()])
        write_spring_wrench(0.0, law, still, pose, np.zeros(6), wrench)
        slope = [(energy(h * d) - energy(-h * d)) / (2 * h) for d in np.eye(6)]
        np.testing.assert_allclose(wrench, -np.array(slope), atol=1e-3)


def contact_wrench(system, ev, state):
    """Wrench (world axes) that the arms' torques put on an object at rest, from their statics."""
    total = np.zeros(6)
    for arm in system.arm_names:
        terms = system.arms[arm].terms(state.joint_positions[arm], state.joint_velocities[arm])
        contact = ev.contact_terms[arm]
        W = terms.J.T @ np.kron(np.eye(2), terms.tip_rotation) @ contact.W_m
        weight = system.arms[arm].gravity_torque(state.joint_positions[arm], np.array(G))
        force = np.linalg.lstsq(W, weight - ev.joint_torques[arm], rcond=None)[0]
        R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
        total += np.kron(np.eye(2), R) @ contact.W_o @ force
    return total


def test_at_rest_the_arms_put_weight_and_spring_on_the_object():
    """W_o lambda = K e + weight, for a shift and a turn about the vertical."""
    system = impedance(path=resting_at(SHIFTED))
    state = system.initial_state()
    ev = ma.evaluate(system, 0.0, state)
    e = np.array([0.02, -0.01, 0.03, 0, 0, 0.2])
    expected = np.array([900, 1200, 1500, 100, 200, 350]) * e
    expected[2] += 9.81 * system.scene.object.mass
    np.testing.assert_allclose(contact_wrench(system, ev, state), expected, atol=1e-7)


def test_a_constant_load_is_held_where_the_spring_balances_it():
    """3 kg more than the law knows of: the object rests below the reference by m g / k."""
    sag = 3.0 * 9.81 / 1500.0
    model = impedance(path=resting_at({"xyz": [0, 0, 0.5 + sag]}))
    scene = ur5_pair(WELD, HINGE)
    body = scene.object.model_copy(update={"mass": scene.object.mass + 3.0})
    loaded = ma.compile_system(
        scene.replace(object=body), control=lambda t, s: ma.evaluate(model, t, s).joint_torques
    )
    ev = ma.evaluate(loaded)
    np.testing.assert_allclose(ev.object_acceleration, 0.0, atol=1e-8)
    for a_j in ev.joint_accelerations.values():
        np.testing.assert_allclose(a_j, 0.0, atol=1e-8)


def spring_energy(run, pose):
    turn = Rotation.from_euler("xyz", pose["rpy"])
    quaternions = Rotation.from_quat(run.object_quaternion_xyzw)
    e = np.hstack([pose["xyz"] - run.object_position, (turn * quaternions.inv()).as_rotvec()])
    return 0.5 * e**2 @ np.array([900.0, 1200.0, 1500.0, 100.0, 200.0, 350.0])


def test_without_damping_the_spring_keeps_the_energy():
    """Kinetic energy and the spring's stay constant: gravity is carried, in large turns too."""
    pose = {"xyz": [0.02, -0.03, 0.54], "rpy": [0.3, -0.2, 0.4]}
    none = {"translation": 0.0, "rotation": 0.0}
    system = impedance(path=resting_at(pose), damping=none, relative_damping=0.0)
    run = ma.simulate(system, duration=0.5, accuracy=1e-8, output_step=0.02)
    assert run.status == "completed"
    total = run.kinetic_energy + spring_energy(run, pose)
    assert np.max(run.kinetic_energy) > 5.0
    np.testing.assert_allclose(total, total[0], rtol=1e-7)


def test_with_damping_the_object_comes_to_rest_at_the_reference():
    """Passive: energy only falls; and what is booked as work closes the balance."""
    pose = {"xyz": [0.02, -0.03, 0.54], "rpy": [0.1, -0.1, 0.2]}
    system = impedance(path=resting_at(pose), squeeze=15.0)
    run = ma.simulate(system, duration=3.0, accuracy=1e-6, output_step=0.02)
    total = run.kinetic_energy + spring_energy(run, pose)
    assert np.all(np.diff(total) < 1e-7 * total[0])
    assert total[-1] < 1e-4 * total[0]
    assert np.max(np.abs(run.energy_balance)) < 1e-4
    np.testing.assert_allclose(run.object_position[-1], pose["xyz"], atol=1e-3)


def test_free_motions_of_the_arms_are_damped_and_move_nothing_else(rng):
    """The damping acts on them alone: neither object nor contact forces feel its gain."""
    build = lambda: panda_trio({"kind": "revolute"})  # noqa: E731
    soft, hard = (impedance(build, relative_damping=d) for d in (0.0, 8.0))
    state = moving(soft, rng)
    one, other = (ma.evaluate(system, 0.0, state) for system in (soft, hard))
    np.testing.assert_allclose(other.object_acceleration, one.object_acceleration, atol=1e-9)
    np.testing.assert_allclose(stacked_forces(other), stacked_forces(one), atol=1e-8)
    power = 0.0
    for arm in soft.arm_names:
        v = state.joint_velocities[arm]
        terms = soft.arms[arm].terms(state.joint_positions[arm], v)
        W_m = np.kron(np.eye(2), terms.tip_rotation) @ one.contact_terms[arm].W_m
        free = null_space(W_m.T @ terms.J)
        gone = other.joint_accelerations[arm] - one.joint_accelerations[arm]
        np.testing.assert_allclose(free.T @ terms.M @ (gone + 8.0 * v), 0.0, atol=1e-9)
        power += v @ (other.joint_torques[arm] - one.joint_torques[arm])
    assert power < -1e-3


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("law", [computed_torque, impedance])
def test_an_object_that_the_joints_leave_free_is_refused(law):
    ball = {"kind": "ball"}
    with refused(ControlError, "control: "):
        law(lambda: ur5_pair(ball, ball))


@pytest.mark.parametrize(
    ("build", "control"),
    [
        (lambda: ur5_pair(WELD, HINGE), {"internal_forces": {"right": [1, 2, 3]}}),
        (lambda: ur5_pair(WELD, {"kind": "prismatic"}), {"squeeze": 5.0}),
        (lambda: single_arm("ur5", "tool0", [0, -1.2, 1.5, 0, 0.5, 0], WELD), {"squeeze": 5.0}),
        (
            lambda: single_arm("ur5", "tool0", [0, -1.2, 1.5, 0, 0.5, 0], WELD),
            {"internal_forces": {"arm": [1, 2, 3, 4, 5, 6]}},
        ),
    ],
)
def test_internal_forces_that_cannot_be_are_refused(build, control):
    with refused(ControlError, *control):
        computed_torque(build, **control)


@pytest.mark.parametrize(
    "parameters",
    [
        {"internal_forces": {"rigth": [1.0]}},
        {"internal_forces": {"left": [1.0, "x"]}},
        {"internal_forces": {"left": 3.0}},
        {"squeeze": -1.0},
        {"relative_damping": -1.0},
        {"stiffness": -1.0},
        {"stiffness": {"translation": 1.0}},
        {"damping": {"translation": [1, 2], "rotation": 1}},
        {"path": [PATH[1], PATH[0]]},
        {"stifness": 3.0},
    ],
)
def test_faults_of_the_laws_are_told_in_the_scene(parameters):
    with refused(SceneError, *parameters):
        ur5_pair(WELD, HINGE, control={"kind": "computed_torque", **parameters})


def test_all_faults_of_a_law_are_told_at_once():
    control = {"kind": "object_impedance", "stiffness": 5.0, "squeeze": "much", "path": []}
    with pytest.raises(SceneError) as caught:
        ur5_pair(WELD, HINGE, control=control)
    text = str(caught.value)
    for part in ("stiffness: must be a table", "damping: is missing", "squeeze", "path' is empty"):
        assert part in text
    assert len(caught.value.faults) == 4
