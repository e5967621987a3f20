"""Claims about inverse dynamics: the round trip through the forward solver, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import (
    first_difference,
    panda_trio,
    planar_pair,
    project_velocity,
    two_arm_block,
    ur5_pair,
)
from repository import WORKED
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.dynamics.forces.internal_forces import InternalForces
from multiarm.errors import GraspError, ModelError, SolverError

HINGES = ({"kind": "revolute"}, {"kind": "revolute", "axis": [1, 0, 0]})
SYSTEMS = {
    "two_arm_block": lambda: two_arm_block(),
    "ur5_welds": lambda: ur5_pair({"kind": "weld"}, {"kind": "weld"}),
    "ur5_hinges": lambda: ur5_pair(*HINGES),
    "ur5_slide_and_ball": lambda: ur5_pair({"kind": "prismatic"}, {"kind": "ball"}),
    "three_pandas_balls": lambda: panda_trio({"kind": "ball"}),
    "three_pandas_welds": lambda: panda_trio({"kind": "weld"}),
    "damped": lambda: ur5_pair(*HINGES).replace(
        effects={"joint_damping": {"left": [9, 8, 7, 6, 5, 4], "right": 3.0}}
    ),
}


@pytest.fixture(scope="module", params=SYSTEMS)
def system(request):
    return ma.compile_system(SYSTEMS[request.param]())


def moving(system, rng):
    """A state on the constraints, everything in motion."""
    state = system.initial_state()
    state.velocity[:] = rng.standard_normal(state.velocity.size)
    return project_velocity(system, state)


def together(mapping):
    return np.concatenate(list(mapping.values()))


def driven(system, torques, state):
    """What the system does under given torques."""
    return ma.evaluate(system.with_control(lambda t, s: torques), 0.0, state)


def advanced(system, state, ev, t):
    """The state after ``t``, right to second order, when everything accelerates evenly."""
    turn = Rotation.from_rotvec(
        t * state.object_twist[3:] + 0.5 * t**2 * ev.object_acceleration[3:]
    )
    move = lambda x, v, a: x + t * v + 0.5 * t**2 * a  # noqa: E731
    return system.state(
        object_position=move(
            state.object_position, state.object_twist[:3], ev.object_acceleration[:3]
        ),
        object_quaternion_xyzw=(turn * Rotation.from_quat(state.object_quaternion_xyzw)).as_quat(),
        joint_positions={
            arm: move(q, state.joint_velocities[arm], ev.joint_accelerations[arm])
            for arm, q in state.joint_positions.items()
        },
        object_twist=state.object_twist + t * ev.object_acceleration,
        joint_velocities={
            arm: v + t * ev.joint_accelerations[arm] for arm, v in state.joint_velocities.items()
        },
    )


def relative_rates(system, state, arm):
    """Rates of a joint's free motions, from the velocities of both bodies where the joint is."""
    frame = system.frames[arm]
    terms = system.arms[arm].terms(state.joint_positions[arm], state.joint_velocities[arm])
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    at = terms.tip_position + terms.tip_rotation @ frame.on_tip[:3, 3]
    v, w = state.object_twist[:3], state.object_twist[3:]
    tip_v, tip_w = terms.tip_twist[:3], terms.tip_twist[3:]
    slide = tip_v + np.cross(tip_w, at - terms.tip_position)
    slide -= v + np.cross(w, at - state.object_position)
    axes = R @ frame.on_object[:3, :3]
    return np.concatenate([axes.T @ slide, axes.T @ (tip_w - w)])[list(frame.free)]


def relative_accelerations(system, state, ev):
    return {
        arm: first_difference(
            lambda t, arm=arm: relative_rates(system, advanced(system, state, ev, t), arm), 1e-3
        )
        for arm in system.arm_names
    }


def test_torques_of_a_wanted_motion_make_that_motion(system, rng):
    """All three groups of unknowns come back: v_o', alpha' and mu_I (thesis, 3.10)."""
    state = moving(system, rng)
    acceleration = rng.standard_normal(6)
    alpha = {arm: rng.standard_normal(len(f.free)) for arm, f in system.frames.items()}
    basis = ma.evaluate(system, 0.0, state).internal_forces()
    mu_I = 30.0 * rng.standard_normal(basis.count)
    found = ma.inverse_dynamics(system, state, acceleration, alpha, mu_I)
    ev = driven(system, found.torques, state)
    np.testing.assert_allclose(ev.object_acceleration, acceleration, atol=1e-10)
    a_j = together(found.joint_accelerations)
    np.testing.assert_allclose(
        together(ev.joint_accelerations), a_j, atol=1e-10 * np.max(np.abs(a_j))
    )
    force = together(found.contact_forces)
    np.testing.assert_allclose(
        together(ev.contact_forces), force, atol=1e-10 * np.max(np.abs(force))
    )
    np.testing.assert_allclose(basis.basis.T @ together(ev.contact_forces), mu_I, atol=1e-9)
    for arm, rates in relative_accelerations(system, state, ev).items():
        np.testing.assert_allclose(rates, alpha[arm], atol=1e-7)
    assert max(vars(found.residuals).values()) < 1e-10 * max(1.0, np.max(np.abs(force)))


def test_a_motion_that_happens_gives_its_own_torques_back(system, rng):
    """The other way round, with torques drawn at random; Pandas need their own posture for it."""
    state = moving(system, rng)
    torques = {arm: 10.0 * rng.standard_normal(a.dof) for arm, a in system.arms.items()}
    ev = driven(system, torques, state)
    found = ma.inverse_dynamics(
        system,
        state,
        ev.object_acceleration,
        relative_accelerations(system, state, ev),
        ev.internal_forces().basis.T @ together(ev.contact_forces),
        posture_acceleration=ev.joint_accelerations,
    )
    for arm, torque in torques.items():
        np.testing.assert_allclose(found.torques[arm], torque, atol=1e-5)  # alpha' has 1e-7


def test_worked_example_has_its_torques_and_internal_force(block_system):
    """6 + 5 + 1 unknowns: the thesis's (3.9) and (3.10)."""
    data, state = WORKED["two_arm_block_system"], block_system.initial_state()
    expected = data["expected"]
    column = np.array(expected["Ao"])[:, None]
    ev = ma.evaluate(block_system)
    found = ma.inverse_dynamics(
        block_system,
        state,
        expected["vdot"],
        relative_accelerations(block_system, state, ev),
        [expected["mu_I"]],
        basis=InternalForces(column, 6, (0,), "echelon"),
    )
    np.testing.assert_allclose(together(found.contact_forces), expected["mu_phys"], rtol=1e-8)
    np.testing.assert_allclose(together(found.joint_accelerations), expected["qdd"], rtol=1e-6)
    np.testing.assert_allclose(together(found.torques), np.ravel(data["inputs"]["tau"]), atol=1e-6)


@pytest.mark.parametrize("form", ["nonnegative", "echelon"])
def test_internal_forces_are_told_in_the_basis_that_is_named(block_system, form):
    state = block_system.initial_state()
    plain = ma.inverse_dynamics(block_system, state, np.zeros(6), basis=form)
    pressed = ma.inverse_dynamics(block_system, state, np.zeros(6), None, [50.0], basis=form)
    A = ma.evaluate(block_system).internal_forces(form).basis
    more = together(pressed.contact_forces) - together(plain.contact_forces)
    np.testing.assert_allclose(more, 50.0 * A[:, 0], atol=1e-10)


def test_joints_to_spare_come_as_near_as_they_can_to_the_posture_acceleration(rng):
    """What is left to wish for is orthogonal, in the inertia, to all motions that stay free."""
    system = ma.compile_system(panda_trio({"kind": "weld"}))
    state = moving(system, rng)
    wish = {arm: 5.0 * rng.standard_normal(7) for arm in system.arm_names}
    found = ma.inverse_dynamics(
        system, state, rng.standard_normal(6), posture_acceleration=wish
    ).joint_accelerations
    plain = ma.inverse_dynamics(system, state, np.zeros(6)).joint_accelerations
    for arm in system.arm_names:
        terms = system.arms[arm].terms(state.joint_positions[arm], state.joint_velocities[arm])
        spare = null_space(terms.J)
        assert spare.shape == (7, 1)
        np.testing.assert_allclose(spare.T @ terms.M @ (found[arm] - wish[arm]), 0.0, atol=1e-11)
        np.testing.assert_allclose(spare.T @ terms.M @ plain[arm], 0.0, atol=1e-11)


def test_a_relative_motion_left_free_takes_the_least_effort(rng):
    """The hinge may then do as it likes: the deviation has no part along its free motion."""
    system = ma.compile_system(ur5_pair(*HINGES))
    state, wanted = moving(system, rng), rng.standard_normal(6)
    found = ma.inverse_dynamics(system, state, wanted, {"left": None})
    ev = driven(system, found.torques, state)
    np.testing.assert_allclose(ev.object_acceleration, wanted, atol=1e-10)
    turning = relative_accelerations(system, state, ev)
    np.testing.assert_allclose(turning["right"], 0.0, atol=1e-7)
    assert abs(turning["left"][0]) > 1e-3
    arm = system.arms["left"].terms(state.joint_positions["left"], state.joint_velocities["left"])
    term = ev.contact_terms["left"]
    R = arm.tip_rotation
    free = null_space((np.kron(np.eye(2), R) @ term.W_m).T @ arm.J)
    assert free.shape == (6, 1)
    effort = free.T @ arm.M @ found.joint_accelerations["left"]
    np.testing.assert_allclose(effort, 0.0, atol=1e-11)


def test_arms_of_few_joints_move_the_object_where_they_can_and_name_what_they_cannot():
    system = ma.compile_system(planar_pair("planar_3r", [0.7, -1.4, 0.5], {"kind": "weld"}))
    state = system.initial_state()
    in_plane = np.array([0.3, -0.2, 0, 0, 0, 1.5])
    found = ma.inverse_dynamics(system, state, in_plane)
    np.testing.assert_allclose(
        driven(system, found.torques, state).object_acceleration, in_plane, atol=1e-9
    )
    with pytest.raises(
        SolverError, match=r"arm 'left' \(3 joints\) misses it by .*; arm 'right' \(3 joints\)"
    ):
        ma.inverse_dynamics(system, state, [0, 0, 1.0, 0, 0, 0])


def test_an_arm_that_cannot_choose_its_relative_motion_may_be_left_to_it():
    system = ma.compile_system(planar_pair("planar_2r", [0.7, -1.4], {"kind": "ball"}))
    state, wanted = system.initial_state(), np.array([0.3, -0.2, 0, 0, 0, 0])
    with pytest.raises(SolverError, match=r"relative_acceleration=\{arm: None\}"):
        ma.inverse_dynamics(system, state, wanted)
    found = ma.inverse_dynamics(system, state, wanted, dict.fromkeys(system.arm_names))
    np.testing.assert_allclose(
        driven(system, found.torques, state).object_acceleration, wanted, atol=1e-9
    )


def test_a_wrench_that_the_contacts_cannot_carry_is_refused():
    """Two balls leave the object free about the line through them."""
    system = ma.compile_system(ur5_pair({"kind": "ball"}, {"kind": "ball"}))
    with pytest.raises(GraspError, match="rank is 5 of 6"):
        ma.inverse_dynamics(system, system.initial_state(), [0, 0, 0, 1.0, 0, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"object_acceleration": [1, 2, 3]}, r"object_acceleration: expected shape \(6,\)"),
        ({"object_acceleration": [np.nan] * 6}, "not finite"),
        ({"relative_acceleration": {"one": [1.0]}}, r"relative_acceleration\['one'\].*\(2,\)"),
        ({"relative_acceleration": {"oen": None}}, "unknown arm 'oen'; arms are one, two"),
        ({"relative_acceleration": [0.0, 0.0]}, "relative_acceleration: must be a dict"),
        ({"posture_acceleration": np.zeros(6)}, "posture_acceleration: must be a dict"),
        ({"posture_acceleration": {"two": "fast"}}, r"posture_acceleration\['two'\]: expected 6"),
    ],
)
def test_wishes_of_the_wrong_form_are_named(block_system, change, message):
    wish = {"object_acceleration": np.zeros(6), **change}
    with pytest.raises(ModelError, match=message):
        ma.inverse_dynamics(block_system, block_system.initial_state(), **wish)


def test_internal_forces_of_the_wrong_number_are_named(block_system):
    with pytest.raises(GraspError, match="1 internal coordinate"):
        ma.inverse_dynamics(
            block_system, block_system.initial_state(), np.zeros(6), None, [1.0, 2.0]
        )
