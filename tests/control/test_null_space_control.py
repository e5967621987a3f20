"""Claims about arms that are held at their places on the object where joints leave them free."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import data_of, panda_trio, project_velocity, ur5_pair
from refusals import refused
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.assembly.inverse_kinematics import InverseKinematics
from multiarm.control.null_space import nearest_accelerations
from multiarm.errors import SceneError

PLANAR = {"kind": "planar"}
SPRING = {
    "stiffness": {"translation": 900.0, "rotation": 200.0},
    "damping": {"translation": 300.0, "rotation": 40.0},
}
MOVING = [
    {"time": 0.3, "xyz": [0.02, 0.03, 0.53], "rpy": [0.1, 0.0, 0.2]},
    {"time": 0.6, "xyz": [0, 0, 0.5]},
]


def sliding_pair(**control):
    return ma.compile_system(ur5_pair({"kind": "weld"}, PLANAR).replace(control=control))


def slid(system, shift):
    """The start with the right arm slid over its face, at rest."""
    start = system.initial_state()
    arm, angles = system.arms["right"], start.joint_positions["right"]
    frame = system.frames["right"]
    place = arm.tip_pose(angles)
    place[:3, 3] += place[:3, :3] @ frame.on_tip[:3, :2] @ np.array(shift)
    reach = InverseKinematics(arm).search([place], NearBy(angles))
    positions = {**start.joint_positions, "right": reach.postures[0]}
    return system.state(
        object_position=start.object_position,
        object_quaternion_xyzw=start.object_quaternion_xyzw,
        joint_positions=positions,
    )


class NearBy:
    """Stands for a random generator: the search begins here."""

    def __init__(self, angles):
        self.angles = angles

    def uniform(self, low, high):
        return self.angles.copy()


@pytest.mark.parametrize("path", [None, MOVING], ids=["resting", "moving"])
def test_slides_and_turns_follow_the_springs_equation_while_the_object_follows_its_path(path, rng):
    """Computed torque: x'' = -k x - d x' for every free coordinate, in axes of the object."""
    k, d = 60.0, 16.0
    system = sliding_pair(
        kind="computed_torque", relative_stiffness=k, relative_damping=d, path=path
    )
    state = system.initial_state()
    state.velocity[6:] = 0.2 * rng.standard_normal(state.velocity.size - 6)
    state = project_velocity(system, state)
    run = ma.simulate(system, duration=0.6, state=state, accuracy=1e-8, output_step=0.1)
    slides, rates = run.relative_position["right"], run.relative_motion["right"]
    assert np.max(np.abs(rates[0])) > 0.05
    roots = np.roots([1.0, d, k])
    decay = np.exp(np.outer(run.time, roots)) @ np.array([1.0, -1.0]) / (roots[0] - roots[1])
    np.testing.assert_allclose(slides, np.outer(decay, rates[0]), atol=1e-7)


@pytest.mark.parametrize("kind", ["ball", "universal", "planar", "cylindrical"])
def test_free_rates_change_as_the_springs_say(kind, rng):
    """With everything in motion: the rates in axes of the object, differentiated as frames turn."""
    d = 9.0
    control = {"kind": "computed_torque", "relative_stiffness": 40.0, "relative_damping": d}
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": kind}).replace(control=control))
    state = system.initial_state()
    state.velocity[:] = 0.8 * rng.standard_normal(state.velocity.size)
    state = project_velocity(system, state)
    ev = ma.evaluate(system, 0.0, state)
    frame = system.frames["right"]
    tip = system.arms["right"].terms(
        state.joint_positions["right"], state.joint_velocities["right"]
    )
    tip_change = tip.J @ ev.joint_accelerations["right"] + tip.drift
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix() @ frame.on_object[:3, :3]
    m, omega = tip.tip_rotation @ frame.on_tip[:3, 3], tip.tip_twist[3:]
    j = tip.tip_position + m - state.object_position
    v_o, spin = state.object_twist[:3], state.object_twist[3:]
    a_o, alpha_o = ev.object_acceleration[:3], ev.object_acceleration[3:]
    velocity = tip.tip_twist[:3] + np.cross(omega, m) - v_o - np.cross(spin, j)
    turning = omega - spin
    acceleration = (
        tip_change[:3] + np.cross(tip_change[3:], m) + np.cross(omega, np.cross(omega, m))
    )
    # derivative of R^T (v_M - v_o - omega_o x j), with j' = v_M - v_o
    moved = velocity + np.cross(spin, j)
    slide = acceleration - a_o - np.cross(alpha_o, j) - np.cross(spin, moved)
    slide -= np.cross(spin, velocity)
    turn = tip_change[3:] - alpha_o - np.cross(spin, turning)
    rates = np.concatenate([R.T @ velocity, R.T @ turning])
    changes = np.concatenate([R.T @ slide, R.T @ turn])
    free = list(frame.free)
    assert np.linalg.norm(rates[free]) > 0.1
    assert np.linalg.norm(spin) > 0.1
    np.testing.assert_allclose(changes[free], -d * rates[free], atol=1e-8)


def test_without_stiffness_nothing_draws_the_arm_back(rng):
    system = sliding_pair(kind="computed_torque", relative_damping=16.0)
    state = slid(system, (0.02, -0.01))
    run = ma.simulate(system, duration=0.3, state=state, accuracy=1e-7, output_step=0.1)
    there = run.relative_position["right"]
    np.testing.assert_allclose(there, np.tile(there[0], (len(there), 1)), atol=1e-7)
    assert np.linalg.norm(there[0]) > 0.02


def test_an_impedance_draws_the_arm_back_and_leaves_the_object_alone(rng):
    k = 80.0
    system = sliding_pair(kind="object_impedance", **SPRING, relative_stiffness=k)
    state = slid(system, (0.02, -0.01))
    run = ma.simulate(system, duration=2e-3, state=state, accuracy=1e-8, output_step=1e-3)
    away, speed = run.relative_position["right"][0], run.relative_motion["right"]
    assert np.linalg.norm(away) > 0.02
    ev = ma.evaluate(system, 0.0, state)
    np.testing.assert_allclose(ev.object_acceleration, 0.0, atol=1e-9)
    # over a short time the rate is -k x t, less what the damping takes of it
    np.testing.assert_allclose(speed[-1], -k * away * 2e-3, rtol=0.02, atol=1e-9)


def test_over_a_floor_the_targets_of_all_arms_are_independent():
    """The floor is an owner of contacts without a joint; derivatives stay in closed form."""
    floor = {"floor": {"at": {"xyz": [0, 0, -0.5]}}}
    control = {"kind": "object_impedance", **SPRING, "relative_stiffness": 5.0, "squeeze": 10.0}
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=control)
    torques, slopes = [], []
    for effects in ({}, floor):
        system = ma.compile_system(scene.replace(effects=effects))
        ev = ma.evaluate(system, 0.0, system.initial_state())
        (command,) = filter(None, data_of(system).closed.law_works)
        assert command.targets.independent
        torques.append(np.concatenate([*ev.joint_torques.values()]))
        slopes.append(ma.derivatives(system).matrix[:12])
    np.testing.assert_allclose(torques[1], torques[0], atol=1e-9)
    np.testing.assert_allclose(slopes[1], slopes[0], atol=1e-9 * np.abs(slopes[0]).max())


def test_contact_forces_do_not_feel_the_springs(rng):
    """The joint's rows are obeyed whatever is preferred along them."""
    build = panda_trio({"kind": "revolute"})
    plain = {"kind": "computed_torque", "relative_damping": 5.0}
    systems = [
        ma.compile_system(build.replace(control={**plain, "relative_stiffness": k}))
        for k in (0.0, 50.0)
    ]
    state = systems[0].initial_state()
    state.velocity[:] = 0.5 * rng.standard_normal(state.velocity.size)
    state = project_velocity(systems[0], state)
    one, other = (ma.evaluate(system, 0.0, state) for system in systems)
    np.testing.assert_allclose(other.object_acceleration, one.object_acceleration, atol=1e-8)
    for arm in systems[0].arm_names:
        np.testing.assert_allclose(other.contact_forces[arm], one.contact_forces[arm], atol=1e-7)


@pytest.mark.slow
def test_nearest_accelerations_are_the_constrained_minimum(rng):
    """Against the saddle point of its optimality conditions; rows may depend on each other."""
    for n, m, rank in ((6, 6, 6), (6, 5, 5), (7, 6, 6), (4, 6, 4), (3, 6, 3), (7, 6, 5)):
        root = rng.standard_normal((n, n))
        M = root @ root.T + n * np.eye(n)
        W = rng.standard_normal((n, rank)) @ rng.standard_normal((rank, m))
        wish, target = rng.standard_normal(n), W.T @ rng.standard_normal(n)
        saddle = np.block([[M, -W], [W.T, np.zeros((m, m))]])
        wanted = np.linalg.lstsq(saddle, np.concatenate([M @ wish, target]), rcond=1e-11)[0][:n]
        found, multipliers = np.empty(n), np.empty(m)
        independent = nearest_accelerations(np.tril(M), W, wish, target, found, multipliers)
        assert independent == (rank == m)
        np.testing.assert_allclose(found, wanted, atol=1e-8)
        np.testing.assert_allclose(M @ (found - wish), W @ multipliers, atol=1e-8)


def test_a_negative_stiffness_is_refused():
    with refused(SceneError, "$.control.relative_stiffness"):
        sliding_pair(kind="computed_torque", relative_stiffness=-1.0)
