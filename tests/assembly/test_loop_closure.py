"""Claims about the way from an inconsistent state onto the joints: short, and on its branch."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import (
    EPS,
    UR5_POSTURE,
    data_of,
    first_difference,
    panda_trio,
    plain_gaps,
    scene_of,
    single_arm,
    ur5_pair,
)
from refusals import refused
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.assembly.linkage import projection_tolerance
from multiarm.assembly.start import project_start
from multiarm.errors import ModelError, SceneError

FIRST_LINK, SECOND_LINK = 0.5, 0.4  # of planar_2r [m]
STRETCHED = [0.3, -0.6, 0.0, 0.4, 1.2, 0.0]
WRIST_IN_LINE = [*UR5_POSTURE[:4], 0.0, 0.3]
BOTH_SINGULAR = [0.3, -0.6, 0.0, 0.4, 0.0, 0.0]


def welded_ur5s(posture, solver="dense", names=("left", "right")):
    """Two UR5s that mirror each other, welded to a box wherever their tips are."""
    turned = {"left": [0, 0, 0], "right": [0, 0, math.pi]}
    arms = {
        name: {
            "robot": "ur5",
            "tip": "tool0",
            "posture": list(posture),
            "base": {"xyz": [-1.1 if name == "left" else 1.1, 0, 0], "rpy": turned[name]},
        }
        for name in names
    }
    joints = [{"arm": name, "kind": "weld"} for name in names]
    return scene_of(arms, joints, run={"solver": solver})


def planar_hinges(apart, wider=0.0):
    """Two stretched planar_2r arms hold a disc by hinges; the bases are too far from each other."""
    arms, joints = {}, []
    for name, side in (("left", -1.0), ("right", 1.0)):
        x, turn = side * (apart + 0.5 * wider), 0.0 if side < 0.0 else math.pi
        arms[name] = {"robot": "planar_2r", "tip": "tip", "posture": [0.0, 0.0]}
        arms[name]["base"] = {"xyz": [x, 0, 0], "rpy": [0, 0, turn]}
        at = {"xyz": [side * (apart - FIRST_LINK - SECOND_LINK), 0, 0]}
        joints.append({"arm": name, "kind": "revolute", "at": at})
    body = {"shape": {"cylinder": {"radius": 0.2, "height": 0.05}}, "mass": 3.0}
    return scene_of(arms, joints, object=body, gravity=None, run={"solver": "dense"})


def planar_arm(posture, **more):
    """A planar arm of two links holds a small object at its tip by a ball joint."""
    return single_arm(
        "planar_2r", "tip", posture, {"kind": "ball"}, run={"solver": "dense"}, **more
    )


def perturbed(system, size, rng):
    state = system.initial_state()
    state.position[7:] += size * rng.standard_normal(system.model.layout.rate_count)
    return state


def displaced(system, state, delta):
    """The state moved by ``delta`` (6 + n,): a shift, a rotation vector, joint changes."""
    moved = state.copy()
    moved.position[:3] += delta[:3]
    turned = Rotation.from_rotvec(delta[3:6]) * Rotation.from_quat(state.position[3:7])
    moved.position[3:7] = turned.as_quat()
    moved.position[7:] += delta[6:]
    return moved


def displacement(start, end):
    turn = Rotation.from_quat(end.position[3:7]) * Rotation.from_quat(start.position[3:7]).inv()
    joints = end.position[7:] - start.position[7:]
    return np.concatenate([end.position[:3] - start.position[:3], turn.as_rotvec(), joints])


def plain_rows(system, state):
    """Derivative of the gaps (N, 6 + n), by differences of poses and surfaces."""
    return np.column_stack(
        [
            first_difference(
                lambda h, e=e: plain_gaps(system, displaced(system, state, h * e)), 1e-2
            )
            for e in np.eye(6 + system.model.layout.rate_count)
        ]
    )


def plain_inertia(system, state):
    """Inertia of object and arms (6 + n, 6 + n), world axes."""
    R = Rotation.from_quat(state.position[3:7]).as_matrix()
    M = np.zeros((6 + system.model.layout.rate_count,) * 2)
    M[:3, :3] = system.scene.object.mass * np.eye(3)
    M[3:6, 3:6] = R @ system.scene.object.inertia_matrix() @ R.T
    at = 6
    for name, angles in state.joint_positions.items():
        own = system.arms[name].terms(angles, np.zeros(angles.size)).M
        M[at : at + angles.size, at : at + angles.size] = own
        at += angles.size
    return M


def assert_closed(system, state):
    np.testing.assert_allclose(
        plain_gaps(system, state), 0.0, atol=2 * projection_tolerance(data_of(system))
    )


# --- what is near is closed ----------------------------------------------------------------------


@pytest.mark.parametrize("kinds", [("weld", "weld"), ("weld", "ball"), ("universal", "weld")])
def test_any_slightly_wrong_pair_of_ur5s_is_closed_by_the_arms(kinds, rng):
    system = ma.compile_system(ur5_pair(*({"kind": kind} for kind in kinds)))
    for size in np.repeat([1e-9, 1e-6, 1e-3, 1e-2], 4):
        state, report = project_start(data_of(system), system.scene, perturbed(system, size, rng))
        assert_closed(system, state)
        assert report.object_held and report.joint_change < 20 * size


@pytest.mark.parametrize("posture", [STRETCHED, WRIST_IN_LINE, BOTH_SINGULAR])
@pytest.mark.parametrize("solver", ["node", "dense"])
def test_singular_arms_are_closed_whichever_solver_is_named(posture, solver, rng):
    system = ma.compile_system(welded_ur5s(posture, solver))
    for size in np.repeat([1e-9, 1e-6, 1e-3, 1e-2], 3):
        state, report = project_start(data_of(system), system.scene, perturbed(system, size, rng))
        assert_closed(system, state)
        assert report.joint_change < 30 * size + math.sqrt(projection_tolerance(data_of(system)))


@pytest.mark.parametrize("elbow", [0.8, -0.8, 0.1, -0.1])
def test_the_elbow_stays_on_its_side_and_where_trigonometry_puts_it(elbow, rng):
    system = ma.compile_system(planar_arm([0.3, elbow]))
    start = system.initial_state()
    for _ in range(5):
        shift = 0.02 * rng.standard_normal(2)
        written = start.copy()
        written.position[:2] += shift
        state, report = project_start(data_of(system), system.scene, written)
        tip = system.arms["arm"].tip_pose(np.array([0.3, elbow]))[:2, 3] + shift
        cosine = (tip @ tip - FIRST_LINK**2 - SECOND_LINK**2) / (2 * FIRST_LINK * SECOND_LINK)
        assert cosine <= 1.0 or not report.object_held
        if report.object_held:
            bend = math.copysign(math.acos(cosine), elbow)
            across = math.atan2(SECOND_LINK * math.sin(bend), FIRST_LINK + SECOND_LINK * cosine)
            expected = [math.atan2(tip[1], tip[0]) - across, bend]
            np.testing.assert_allclose(state.position[7:], expected, atol=1e-12)
        assert_closed(system, state)
        assert state.position[8] * elbow > 0.0


def test_an_elbow_that_is_almost_straight_is_not_swung_through_for_a_small_gap(rng):
    system = ma.compile_system(welded_ur5s([0.3, -0.6, 0.01, 0.4, 1.2, 0.0]))
    for _ in range(10):
        written = system.initial_state()
        written.position[:3] += 3e-3 * rng.standard_normal(3)
        state, report = project_start(data_of(system), system.scene, written)
        assert_closed(system, state)
        assert all(angles[2] > 0.0 for angles in state.joint_positions.values())
        assert report.joint_change < 0.3


def test_an_arm_at_full_stretch_lets_the_object_come_to_it():
    system = ma.compile_system(planar_arm([0.3, 0.0]))
    outward = np.array([math.cos(0.3), math.sin(0.3), 0.0])
    for away in (1e-9, 1e-6, 1e-3, 1e-2):
        written = system.initial_state()
        written.position[:3] += away * outward
        state, report = project_start(data_of(system), system.scene, written)
        assert_closed(system, state)
        assert not report.object_held
        assert report.object_shift < 1.1 * away and report.joint_change < 10 * away


# --- the change is the least ---------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("held", [True, False])
def test_the_change_is_the_least_in_the_metric_of_the_inertia(held, rng):
    """For a small inconsistency the change satisfies ``M delta in range(W)``."""
    if held:
        system = ma.compile_system(panda_trio({"kind": "weld"}))
        written = perturbed(system, 1e-6, rng)
    else:
        system = ma.compile_system(planar_arm([0.3, 0.7]))
        written = system.initial_state()
        written.position[:3] += 1e-6 * rng.standard_normal(3)
    state, report = project_start(data_of(system), system.scene, written)
    assert report.object_held == held
    move = slice(6, None) if held else slice(None)
    W = plain_rows(system, state)[:, move].T
    impulse = (plain_inertia(system, state) @ displacement(written, state))[move]
    left = impulse - W @ np.linalg.lstsq(W, impulse, rcond=1e-9)[0]
    assert np.linalg.norm(left) < 1e-4 * np.linalg.norm(impulse)
    assert W.shape[0] > np.linalg.matrix_rank(W, tol=1e-6), "there is a choice"


def test_renumbering_the_arms_changes_nothing(rng):
    changes, ends = 0.01 * rng.standard_normal((2, 6)), []
    for names in (("left", "right"), ("right", "left")):
        system = ma.compile_system(welded_ur5s(BOTH_SINGULAR, names=names))
        state = system.initial_state()
        for name, change in zip(("left", "right"), changes, strict=True):
            state.joint_positions[name][:] += change
        state.position[0] += 0.03
        state, report = project_start(data_of(system), system.scene, state)
        ends.append([*state.position[:7], *state.joint_positions["left"], report.object_turn])
    np.testing.assert_allclose(*ends, atol=1e-9)


# --- limits --------------------------------------------------------------------------------------


def test_a_joint_does_not_leave_its_limits_and_is_named():
    posture = [0.0, -0.4015, 0.0, -2.362, 0.0, 2.7459, 2.89]
    arm = {"robot": "panda", "tip": "panda_hand_tcp", "posture": posture}
    arm["lock"] = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    scene = scene_of({"arm": arm}, [{"arm": "arm", "kind": "weld"}], gravity=None)
    system = ma.compile_system(scene)
    low, high = system.arms["arm"].position_limits.T
    written = system.initial_state()
    turn = Rotation.from_matrix(system.arms["arm"].tip_pose(np.array(posture))[:3, :3])
    axis = turn.apply([0, 0, 1])
    written.position[3:7] = Rotation.from_rotvec(0.05 * axis).as_quat()
    reach = system.arms["arm"].tip_pose(np.array(posture))[:3, 3]
    centre = written.position[:3]
    written.position[:3] = reach + Rotation.from_rotvec(0.05 * axis).apply(centre - reach)
    state, report = project_start(data_of(system), system.scene, written)
    assert_closed(system, state)
    assert np.all(state.position[7:] >= low) and np.all(state.position[7:] <= high)
    assert state.position[13] == high[6] and report.at_limit == ("arm/panda_joint7",)
    words = f"at a limit: arm/panda_joint7 (moved there, from {posture[-1]:.4g})"
    assert any(words in line for line in report.lines())


def test_a_joint_written_outside_its_limits_stays_there_and_is_named():
    posture = [0.0, -0.4015, 0.0, -2.362, 0.0, 2.7459, 2.95]
    arm = {"robot": "panda", "tip": "panda_hand_tcp", "posture": posture}
    scene = scene_of({"arm": arm}, [{"arm": "arm", "kind": "weld"}], gravity=None)
    system = ma.compile_system(scene)
    np.testing.assert_array_equal(system.initial_state().position[7:], posture)
    assert system.start_report.outside_limits == ("arm/panda_joint7",)
    assert "outside its limits" in " ".join(system.start_report.lines())


# --- flat linkages -------------------------------------------------------------------------------


@pytest.mark.parametrize("wider", [0.0, 1e-12, -1e-12, 1e-9, -1e-9, 1e-6, -1e-6, 1e-3, -1e-3])
def test_a_flat_four_bar_closes_to_the_last_digit(wider):
    """Where the constraints lose rank; what is too short for a line has to buckle."""
    system = ma.compile_system(planar_hinges(apart=0.8, wider=wider))
    start, report = system.initial_state(), system.start_report
    assert_closed(system, start)
    bend = np.abs(start.position[7:]).max()
    assert (bend == 0.0) if wider == 0.0 else (bend < 10 * math.sqrt(abs(wider)))
    assert max(report.gaps_left.values()) <= projection_tolerance(data_of(system))


def test_a_chain_that_is_too_short_is_refused_with_what_is_left():
    ma.compile_system(planar_hinges(apart=1.0))
    with pytest.raises(SceneError) as caught:
        ma.compile_system(planar_hinges(apart=1.0, wider=0.02))
    text = str(caught.value)
    assert "left: 0.01 m" in text and "right: 0.01 m" in text and "end of their reach" in text
    assert "nan" not in text


def test_a_flat_chain_that_would_have_to_buckle_far_is_refused():
    # roundings, which change with the processor, decide which of two equal parts buckles
    with pytest.raises(SceneError, match=r"left: .* would have to move by more than 0\.5"):
        ma.compile_system(planar_hinges(apart=1.0, wider=-0.09))


# --- states of the user's ------------------------------------------------------------------------


def test_a_state_on_the_joints_is_taken_bit_for_bit(rng):
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "ball"}))
    state, _ = project_start(data_of(system), system.scene, perturbed(system, 0.01, rng))
    state.velocity[:] = rng.standard_normal(state.velocity.size)
    state, _ = project_start(data_of(system), system.scene, state)
    again, report = project_start(data_of(system), system.scene, state)
    np.testing.assert_array_equal(again.position, state.position)
    np.testing.assert_array_equal(again.velocity, state.velocity)
    assert report.lines() == [] and report.energy_lost == 0.0


def test_the_given_state_is_left_as_it_is(welded_ur5_system, rng):
    written = perturbed(welded_ur5_system, 0.01, rng)
    before = written.position.copy()
    project_start(data_of(welded_ur5_system), welded_ur5_system.scene, written)
    np.testing.assert_array_equal(written.position, before)


def test_a_state_that_is_too_far_is_refused_as_a_state_with_every_gap(welded_ur5_system):
    state = welded_ur5_system.initial_state()
    state.joint_positions["left"][1] += 1.0
    with pytest.raises(ModelError) as caught:
        project_start(data_of(welded_ur5_system), welded_ur5_system.scene, state)
    text = str(caught.value)
    assert text.startswith("the given state") and "initial_state()" in text
    assert "arm 'left'" in text and "gaps of the other joints: right: " in text


def test_a_state_that_is_not_finite_is_refused(welded_ur5_system):
    state = welded_ur5_system.initial_state()
    state.position[9] = math.nan
    with refused(ModelError, "state"):
        project_start(data_of(welded_ur5_system), welded_ur5_system.scene, state)


# --- velocities ----------------------------------------------------------------------------------


@pytest.mark.parametrize("posture", [UR5_POSTURE, STRETCHED, BOTH_SINGULAR])
def test_velocities_change_least_and_the_lost_energy_is_told(posture, rng):
    system = ma.compile_system(welded_ur5s(posture))
    written = system.initial_state()
    written.velocity[:] = rng.standard_normal(written.velocity.size)
    state, report = project_start(data_of(system), system.scene, written)
    np.testing.assert_array_equal(state.position, written.position)
    W, M = plain_rows(system, state).T, plain_inertia(system, state)
    change = state.velocity - written.velocity
    np.testing.assert_allclose(W.T @ state.velocity, 0.0, atol=1e-9)
    impulse = M @ change
    left = impulse - W @ np.linalg.lstsq(W, impulse, rcond=1e-8)[0]
    assert np.linalg.norm(left) < 1e-8 * np.linalg.norm(impulse)
    energies = [0.5 * v @ M @ v for v in (written.velocity, state.velocity)]
    assert report.energy_lost == pytest.approx(energies[0] - energies[1], rel=1e-10)
    assert report.object_velocity_change == pytest.approx(np.linalg.norm(change[:3]))
    assert report.object_spin_change == pytest.approx(np.linalg.norm(change[3:6]))
    assert report.joint_velocity_change == np.max(np.abs(change[6:]))
    assert np.max(np.abs(W.T @ written.velocity)) > 0.1 > 1e6 * EPS
