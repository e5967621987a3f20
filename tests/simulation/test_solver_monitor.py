"""Claims about what a run says of its own solution: rank, coupled arms, residual, events in words.

Oracles: singular values and determinants by NumPy of matrices from the arms' Jacobians, and the
equations written down once more.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from linkages import compiled, state_on
from matrix_systems import system_matrices
from mechanics import (
    data_of,
    project_velocity,
    single_arm,
    state_at,
)
from repository import SCENES

import multiarm as ma
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.residuals import constraint_residual
from multiarm.dynamics.solver.bounds import (
    COUPLED_BELOW,
    LOST,
    MOST_ROUNDED_RESIDUAL,
    REGAINED,
    RESIDUAL_BOUND,
)
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import kernel
from multiarm.problems import HARD_CASES, loops
from multiarm.problems.postures import stretched_and_released_scene

POSTURE = [0.3, -0.6, 1.1, 0.4, 0.7, -0.2]


@cache
def straight():
    """Two arms that leave the straight posture."""
    system = ma.compile_system(HARD_CASES["straight_elbow"].scene())
    return system, ma.simulate(system, 0.1, output_step=1e-3)


@cache
def released():
    """Two arms that are driven through the straight posture."""
    return ma.compile_system(stretched_and_released_scene())


def arm_matrix(system, trajectory, arm, k):
    """``L^-1 W`` of an arm at a sample: how the arm alone gives way to unit contact forces."""
    evaluation = ma.evaluate(system, 0.0, state_at(system, trajectory, k))
    M, _, W, _ = system_matrices(system, evaluation)
    i = system.arm_names.index(arm)
    d, r = system.model.layout.first_joint, system.model.layout.first_contact
    own = slice(6 + d[i], 6 + d[i + 1])
    return np.linalg.solve(np.linalg.cholesky(M[own, own]), W[own, r[i] : r[i + 1]])


def of_kind(trajectory, *kinds):
    return [event for event in trajectory.events if event["kind"] in kinds]


# --- channels ------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_channels_are_those_of_the_evaluations_at_the_samples(solver):
    system = straight()[0].with_solver(solver)
    trajectory = ma.simulate(system, 0.05, output_step=5e-3, solver=solver)
    for k in range(len(trajectory)):
        evaluation = ma.evaluate(system, 0.0, state_at(system, trajectory, k))
        assert trajectory.rank[k] == evaluation.rank == 12
        assert trajectory.coupled_arms[k] == len(evaluation.coupled_arms)
    if solver == "node":
        assert trajectory.coupled_arms[0] == 2 and trajectory.coupled_arms[-1] == 0
    else:
        assert not trajectory.coupled_arms.any()
    assert np.all(trajectory.residual < 1e-12)


def test_rank_is_that_of_the_whole_constraint_matrix():
    for build, rank in ((loops.two_joint_arms_scene, 9), (loops.bricard_scene, 9)):
        system = ma.compile_system(build())
        trajectory = ma.simulate(system, 0.2, output_step=0.05)
        for k in range(len(trajectory)):
            evaluation = ma.evaluate(system, 0.0, state_at(system, trajectory, k))
            W = system_matrices(system, evaluation)[2]
            assert trajectory.rank[k] == np.linalg.matrix_rank(W, tol=1e-9) == rank


# --- statistics ----------------------------------------------------------------------------------


def test_statistics_count_the_steps_that_ended_with_deficient_arms():
    statistics = ma.simulate(straight()[0], 0.1, max_step=1e-3, certificate=False).statistics
    assert 0 < statistics["coupled_steps"] < statistics["steps"]
    assert (statistics["lowest_rank"], statistics["highest_rank"]) == (12, 12)
    assert 0.0 <= statistics["residual_max"] < 1e-12


def test_arms_of_two_joints_are_coupled_in_every_step():
    system = ma.compile_system(loops.two_joint_arms_scene())
    statistics = ma.simulate(system, 0.2).statistics
    assert statistics["coupled_steps"] == statistics["steps"] > 0
    assert (statistics["lowest_rank"], statistics["highest_rank"]) == (9, 9)


# --- directions lost and had again ---------------------------------------------------------------


@pytest.mark.slow
def test_lost_directions_are_told_in_words_and_again_when_they_are_back():
    system, trajectory = straight()
    longest = trajectory.statistics["largest_step_s"]
    for arm in system.arm_names:
        lost, again = [event for event in trajectory.events if event.get("arm") == arm]
        assert (lost["time"], lost["kind"]) == (0.0, "loses a direction")
        assert lost["text"] == f"{arm}: no motion along its own reach"
        assert again["kind"] == "regains a direction"
        assert again["text"] == f"{arm}: can move along its joint's directions again"
        # how much is left of the weakest direction
        values = [
            np.linalg.svd(arm_matrix(system, trajectory, arm, k))[1] for k in range(len(trajectory))
        ]
        share = np.array([one[-1] / one[0] for one in values])
        assert share[0] < LOST
        assert np.all(np.diff(share) > 0.0)
        # there again within a step, at twice the share or when the elimination takes it whole
        assert np.interp(again["time"], trajectory.time, share) > LOST
        before = np.interp(again["time"] - longest, trajectory.time, share)
        assert before < REGAINED * LOST


def test_a_direction_lost_for_one_step_is_told_twice():
    """Steps of 1 ms end within the posture: both elbows lose their reach and have it again."""
    trajectory = ma.simulate(released(), 0.1, integrator="rk4", step=1e-3, output_step=1e-3)
    kinds = ["loses a direction", "regains a direction"]
    for arm in ("left", "right"):
        events = [event for event in trajectory.events if event["arm"] == arm]
        assert [event["kind"] for event in events] == kinds
        elbow = trajectory.joint_positions[arm][:, 2]
        straight_at = np.interp(0.0, -elbow, trajectory.time)
        for event in events:
            assert event["time"] == pytest.approx(straight_at, abs=2e-3)
        assert events[0]["text"] == f"{arm}: little motion along its own reach"


def test_connections_of_a_robot_that_repeat_each_other_are_counted():
    """Hinges that are all parallel: hands at one box cannot move apart in three directions."""
    system = ma.compile_system(ma.load_scene(SCENES / "free_flyer.yaml"))
    file = str(SCENES / "free_flyer.urdf")
    model = pin.buildModelFromUrdf(file, pin.JointModelFreeFlyer())
    data, q = model.createData(), pin.neutral(model)
    q[7:] = system.initial_state().joint_positions["sat"]
    hands = [model.getFrameId(name) for name in ("left_hand", "right_hand")]
    rows = np.vstack([pin.computeFrameJacobian(model, data, q, hand, pin.LOCAL) for hand in hands])
    repeated = len(rows) - np.linalg.matrix_rank(rows)
    (event,) = of_kind(ma.simulate(system, 0.01, certificate=False), "loses a direction")
    assert event["text"] == f"sat: its connections repeat each other in {repeated} directions"


@pytest.mark.slow
def test_sides_of_a_singular_posture_are_those_of_the_determinants_sign():
    system = released()
    trajectory = ma.simulate(system, 0.3, output_step=1e-3)
    longest = trajectory.statistics["largest_step_s"]
    for arm in system.arm_names:
        signs = [
            np.sign(np.linalg.det(arm_matrix(system, trajectory, arm, k)))
            for k in range(len(trajectory))
        ]
        turned = trajectory.time[1:][np.diff(signs) != 0.0]
        passed = [e for e in of_kind(trajectory, "passes a singular posture") if e["arm"] == arm]
        assert len(passed) == len(turned) == 1
        assert turned[0] - 1e-3 <= passed[0]["time"] <= turned[0] + longest
        assert passed[0]["text"].startswith(f"{arm}: passed a singular posture, ")
        assert passed[0]["text"].endswith("motion along its own reach")


@pytest.mark.parametrize("bend", [0.3, -0.3, 1.2, -2.0])
@pytest.mark.parametrize("turn", [-0.9, 0.4, 1.9])
def test_the_remembered_side_is_the_sign_of_the_determinant(bend, turn):
    """Many postures, far from singular ones, so that the rows are exchanged in many ways."""
    posture = [turn, -0.9, bend, -0.6 + turn, 1.2 * turn, 0.3]
    system = ma.compile_system(single_arm("ur5", "tool0", posture, {"kind": "weld"}))
    trajectory = ma.simulate(system, 1e-4, integrator="rk4", step=1e-4)
    remembered = float(data_of(system).arrays.last_step.determinant_signs[0])
    assert ma.evaluate(system).conditioning["arm"] > COUPLED_BELOW
    expected = np.sign(np.linalg.det(arm_matrix(system, trajectory, "arm", 0)))
    assert remembered == expected != 0.0


# --- changes of rank -----------------------------------------------------------------------------


def test_a_step_that_ends_in_the_flat_position_tells_of_both_changes_of_rank():
    """The third step of 1 ms of a parallelogram at 4 rad/s; its start follows from its energy."""
    motion, rate, flat = loops.parallelogram_motion(2), 4.0, 0.003
    inertia, potential = motion.inertia_and_potential(0.0)
    energy = 0.5 * inertia * rate**2 + potential
    begin = motion.motion(0.0, rate, np.array([0.0, -flat]))[-1]
    inertia, potential = motion.inertia_and_potential(begin)
    start = state_on("parallelogram", begin, math.sqrt(2.0 * (energy - potential) / inertia))
    trajectory = ma.simulate(
        compiled("parallelogram"), 0.01, integrator="rk4", step=1e-3, output_step=1e-3, state=start
    )
    assert trajectory.status == "completed"
    assert trajectory.rank.tolist() == [7, 7, 7, 6] + 7 * [7]
    falls, rises = of_kind(trajectory, "rank falls", "rank rises")
    assert falls["time"] == pytest.approx(0.003) and rises["time"] == pytest.approx(0.004)
    assert falls["text"] == (
        "rank falls from 7 to 6 independent constraints: more than one way to move on"
    )
    assert rises["text"] == "rank rises from 6 to 7 independent constraints"
    assert "arm" not in falls and "arm" not in rises
    statistics = trajectory.statistics
    assert (statistics["lowest_rank"], statistics["highest_rank"]) == (6, 7)


# --- constraints that contradict each other ------------------------------------------------------


@cache
def dome_on_table():
    """A point on a plane and on a sphere that touches the plane there: it cannot go anywhere, but
    to first order it may slide."""
    ball = ma.compile_system(single_arm("textbook_6r", "tool", POSTURE, {"kind": "ball"}))
    tip = ball.arms["arm"].tip_pose(np.array(POSTURE))
    at = np.linalg.solve(ball.scene.object.pose.matrix(), tip)[:3, 3].tolist()
    point = {"point": [0, 0, 0]}
    table = {"plane": {"normal": [0, 0, 1]}}
    dome = {"sphere": {"center": [0, 0, -0.1], "radius": 0.1}}
    contacts = [
        {"name": "table", "arm": point, "object": table},
        {"name": "dome", "arm": point, "object": dome},
    ]
    joint = {"kind": "contacts", "contacts": contacts, "at": {"xyz": at}}
    return ma.compile_system(single_arm("textbook_6r", "tool", POSTURE, joint))


@pytest.mark.slow
@pytest.mark.parametrize(
    "settings",
    [{"accuracy": 1e-6, "integrator": "dopri5"}, {"integrator": "rk4", "step": 1e-3}],
    ids=["adaptive", "rk4"],
)
def test_constraints_that_contradict_each_other_end_the_run_with_what_to_do(settings):
    trajectory = ma.simulate(dome_on_table(), 0.3, output_step=1e-4, **settings)
    assert trajectory.status == "failed"
    message = trajectory.message
    no_acceleration = "no acceleration meets all constraints" in message
    assert no_acceleration or "could not be projected back onto the joints" in message
    assert "t = " in message and "take smaller steps" in message
    if no_acceleration:
        assert "contradict each other" in message and "or remove redundant contacts" in message
    # all data so far, and none that is no solution
    assert len(trajectory) >= 1 and trajectory.time[-1] < 0.02
    if "accuracy" in settings:
        assert len(trajectory) > 5
    # steps are judged at their ends; samples lie between
    assert np.all(trajectory.residual <= 2.0 * MOST_ROUNDED_RESIDUAL)
    assert trajectory.statistics["residual_max"] <= MOST_ROUNDED_RESIDUAL
    assert np.all(np.isfinite(trajectory.object_position))
    assert np.max(trajectory.position_drift) < 1e-8


def test_the_residual_is_the_largest_gap_acceleration_over_the_largest_term():
    """A tip that slides on the dome must leave the table: half of v^2 / r is left on either."""
    system = dome_on_table()
    state = system.initial_state()
    state.object_twist[:] = [0.3, 0.1, 0.0, 0.0, 0.0, 0.0]
    state = project_velocity(system, state)
    evaluation = ma.evaluate(system, 0.0, state)
    assert evaluation.velocity_residual < 1e-13 and evaluation.rank == 1
    M, f_j, W, c = system_matrices(system, evaluation)
    x = np.concatenate([evaluation.object_acceleration, evaluation.joint_accelerations["arm"]])
    left = W.T @ x - c
    # both walk away from c by as much, in the sense of least squares
    assert left[0] == pytest.approx(-left[1], rel=1e-9)
    assert evaluation.residuals.constraint == pytest.approx(np.max(np.abs(left)), rel=1e-9)
    relative_motion = np.ptp(c)
    assert np.max(np.abs(left)) == pytest.approx(0.5 * relative_motion, rel=1e-9)
    run = ma.simulate(system, 0.1, state=state)
    assert run.status == "failed" and "contradict" in run.message
    free = np.linalg.solve(M[6:, 6:], f_j[6:])  # of the arm without contacts
    terms = (W[:6].T @ x[:6], W[6:].T @ x[6:], W[6:].T @ free, c, system.scene.gravity)
    scale = max(np.max(np.abs(term)) for term in terms)
    assert run.residual[0] == pytest.approx(np.max(np.abs(left)) / scale, rel=1e-6)
    assert run.residual[0] > RESIDUAL_BOUND


@kernel
def residual_of(struct):
    model, data, work = open_system(struct)
    return constraint_residual(model, data, work)


def test_the_largest_term_may_be_what_contact_forces_hold_back(welded_ur5_system):
    """Regular arms at rest: the links would fall faster than the object, did it not hold them."""
    system = welded_ur5_system
    evaluation = ma.evaluate(system, 0.0, system.initial_state())
    M, f_j, W, c = system_matrices(system, evaluation)
    assert evaluate_state(data_of(system).struct, 0.0, 0.0) == OK
    x = data_of(system).arrays.accelerations.a
    x[6] += 1e-3
    free = W[6:].T @ np.linalg.solve(M[6:, 6:], f_j[6:])
    others = (W[:6].T @ x[:6], W[6:].T @ x[6:], c, f_j[:3] / M[0, 0])
    assert np.max(np.abs(free)) > 1.01 * max(np.max(np.abs(term)) for term in others)
    expected = np.max(np.abs(W.T @ x - c)) / np.max(np.abs(free))
    found = residual_of(data_of(system).struct)
    assert found == pytest.approx(expected, rel=1e-9)


# --- states given to a run -----------------------------------------------------------------------


def test_a_state_beside_the_joints_is_assembled_and_told(welded_ur5_system):
    system = welded_ur5_system
    state = system.initial_state()
    state.position[7:10] += [2e-3, -1e-3, 1.5e-3]
    state.velocity[6:9] += [0.05, 0.02, -0.03]
    before = state.copy()
    assert ma.evaluate(system, 0.0, state).position_residual > 1e-4
    trajectory = ma.simulate(system, 0.02, state=state)
    told = of_kind(trajectory, "start")
    assert told and all(e["time"] == 0.0 and e["text"].startswith("start: ") for e in told)
    assert trajectory.position_drift[0] < 1e-13 and trajectory.velocity_drift[0] < 1e-12
    np.testing.assert_array_equal(state.position, before.position)
    np.testing.assert_array_equal(state.velocity, before.velocity)
    feedback = ma.simulate(system, 0.02, state=state, stabilization="feedback")
    assert feedback.position_drift[0] > 1e-4 and not of_kind(feedback, "start")


def test_a_state_on_the_joints_is_taken_bit_by_bit(welded_ur5_system):
    system = welded_ur5_system
    first = ma.simulate(system, 0.1, output_step=0.05)
    state = state_at(system, first, 1)
    trajectory = ma.simulate(system, 0.05, state=state)
    assert not of_kind(trajectory, "start")
    np.testing.assert_array_equal(trajectory.object_position[0], state.object_position)
    np.testing.assert_array_equal(trajectory.object_twist[0], state.object_twist)
    for arm in system.arm_names:
        found = trajectory.joint_positions[arm][0], trajectory.joint_velocities[arm][0]
        np.testing.assert_array_equal(found[0], state.joint_positions[arm])
        np.testing.assert_array_equal(found[1], state.joint_velocities[arm])
