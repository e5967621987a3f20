"""Claims about the variational integrator: symplectic, symmetric, closed, faithful to the energy.

Its step is taken as a black box: a run of one step is a map of states, whose derivatives,
inverse and invariants are compared with what mechanics says.
"""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from mechanics import (
    chain_urdf,
    data_of,
    first_difference,
    pose,
    random_state,
    scene_of,
    state_at,
    two_arm_block,
    ur5_pair,
)
from rolling_scenes import BALL, CARRIER, RADIUS, rolling_scene
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.dynamics.equations import update_kinematics
from multiarm.integration.methods import make_stepping
from multiarm.problems import HARD_CASES
from multiarm.problems.contacts import held_box
from multiarm.problems.spinning import TUMBLING_INERTIA, free_spin_scene
from multiarm.tableaus import METHODS


def one_step(system, state, h, integrator="variational"):
    """The state after one step of length ``h``, from time 0."""
    run = ma.simulate(
        system, h, integrator=integrator, step=h, output_step=h, stabilization="none", state=state
    )
    assert run.status == "completed", run.message
    return state_at(system, run, -1)


def joints(run):
    """Joint positions of all arms, (K, n)."""
    return np.concatenate([run.joint_positions[arm] for arm in run.arm_names], axis=1)


def turned_back(system, state):
    """The state with all velocities reversed."""
    return system.state(
        state.object_position,
        state.object_quaternion_xyzw,
        state.joint_positions,
        -state.object_twist,
        {arm: -v for arm, v in state.joint_velocities.items()},
    )


# --- symplectic ----------------------------------------------------------------------------------


class Reduced:
    """Independent coordinates ``y`` and momenta ``p`` of two UR5s, one welded, one by a ball.

    The welded arm carries the object along; the other one's first three joints follow the ball, its
    last three are free: nine freedoms.  ``v = G y'`` are all velocities, ``p = G^T M v``.  Poses
    and Jacobians are Pinocchio's, the rest is written down here.
    """

    size = 9

    def __init__(self, system):
        self.system, self.left, self.right = system, *system.arms.values()
        start = system.initial_state()
        q = start.joint_positions
        X_WO = pose(
            Rotation.from_quat(start.object_quaternion_xyzw).as_matrix(), start.object_position
        )
        self.X_TO = np.linalg.inv(self.left.tip_pose(q["left"])) @ X_WO
        self.ball = X_WO[:3, :3].T @ (self.right.tip_pose(q["right"])[:3, 3] - X_WO[:3, 3])
        self.near = q["right"][:3].copy()
        self.y = np.concatenate([q["left"], q["right"][3:]])

    def positions(self, y):
        """Object pose and the right arm's joints, which meet the ball."""
        X_WO = self.left.tip_pose(y[:6]) @ self.X_TO
        target = X_WO[:3, :3] @ self.ball + X_WO[:3, 3]
        q = np.concatenate([self.near, y[6:]])
        for _ in range(12):
            gap = self.right.tip_pose(q)[:3, 3] - target
            q[:3] -= np.linalg.solve(self.right.terms(q, np.zeros(6)).J[:3, :3], gap)
        assert np.max(np.abs(gap)) < 1e-14
        return X_WO, q

    def tangent(self, y):
        """``G`` (18, 9) and the mass matrix (18, 18): object, left, right."""
        X_WO, q = self.positions(y)
        left, right = self.left.terms(y[:6], np.zeros(6)), self.right.terms(q, np.zeros(6))
        at = X_WO[:3, 3] - self.left.tip_pose(y[:6])[:3, 3]
        arm = X_WO[:3, :3] @ self.ball
        G = np.zeros((18, 9))
        G[:6, :6] = left.J
        G[:3, :6] += np.cross(left.J[3:].T, at).T
        G[6:12, :6] = np.eye(6)
        ball = G[:3] + np.cross(G[3:6].T, arm).T
        ball[:, 6:] -= right.J[:3, 3:]
        G[12:15] = np.linalg.solve(right.J[:3, :3], ball)
        G[15:, 6:] = np.eye(3)
        M, R = np.zeros((18, 18)), X_WO[:3, :3]
        M[:3, :3] = self.system.scene.object.mass * np.eye(3)
        M[3:6, 3:6] = R @ self.system.scene.object.inertia_matrix() @ R.T
        M[6:12, 6:12], M[12:, 12:] = left.M, right.M
        return G, M

    def state(self, z):
        """State of ``z = (y, p)``."""
        y, p = z[:9], z[9:]
        X_WO, q = self.positions(y)
        G, M = self.tangent(y)
        v = G @ np.linalg.solve(G.T @ M @ G, p)
        return self.system.state(
            X_WO[:3, 3],
            Rotation.from_matrix(X_WO[:3, :3]).as_quat(),
            {"left": y[:6], "right": q},
            v[:6],
            {"left": v[6:12], "right": v[12:]},
        )

    def coordinates(self, state):
        """``(y, p)`` of a state on the constraints."""
        q = state.joint_positions
        y = np.concatenate([q["left"], q["right"][3:]])
        G, M = self.tangent(y)
        return np.concatenate([y, G.T @ M @ state.velocity])


@pytest.fixture(scope="module")
def reduced(ur5_system):
    return Reduced(ur5_system)


def lively(reduced):
    """Coordinates and momenta of a motion with all joints turning."""
    speed = np.concatenate([[0.5, -1.0, 1.5, 0.5, 1.0, -0.5], [2.0, -1.0, 1.0]])
    G, M = reduced.tangent(reduced.y)
    return np.concatenate([reduced.y, G.T @ M @ G @ speed])


def symplectic_defect(reduced, integrator, h):
    """Largest entries of ``D^T Omega D - Omega`` and of ``D``, the derivative of a step."""
    z = lively(reduced)
    Omega = np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(9))
    image = lambda z: reduced.coordinates(  # noqa: E731
        one_step(reduced.system, reduced.state(z), h, integrator)
    )
    D = np.zeros((18, 18))
    for k, e in enumerate(np.eye(18)):
        D[:, k] = first_difference(lambda t, e=e: image(z + t * e), 1e-3 if k < 9 else 1e-2)
    defect = D.T @ Omega @ D - Omega
    return np.max(np.abs(defect)), np.max(np.abs(D))


@pytest.mark.slow
def test_a_step_keeps_the_symplectic_form(reduced):
    """The derivative of the step, by differences, on the manifold of closed joints.

    Differences of order 8 leave the steps' roundings, some 1e-15 * 50 kg m^2/s over 1e-3.
    """
    defect, size = symplectic_defect(reduced, "variational", 0.02)
    assert size > 2.0  # the step does something
    assert defect < 1e-9
    others = [symplectic_defect(reduced, name, 0.02)[0] for name in ("rk4", "semi_implicit_euler")]
    assert min(others) > 1e-4


# --- symmetric, closed, momenta kept -------------------------------------------------------------


def test_a_step_is_undone_by_one_with_reversed_velocities(reduced):
    """By Runge-Kutta methods it is so only to their error."""
    system, begin = reduced.system, reduced.state(lively(reduced))
    back = {}
    for name in ("variational", "rk4"):
        there = one_step(system, begin, 0.02, name)
        assert np.max(np.abs(there.position - begin.position)) > 1e-2
        again = one_step(system, turned_back(system, there), 0.02, name)
        found = turned_back(system, again)
        back[name] = max(
            np.max(np.abs(found.position - begin.position)),
            np.max(np.abs(found.velocity - begin.velocity)),
        )
    assert back["variational"] < 1e-11 < 1e-7 < back["rk4"]


CLOSED = {
    "weld and ball": lambda: ur5_pair({"kind": "weld"}, {"kind": "ball"}),
    "fingertips": lambda: two_arm_block(torques=False),
    "bricard": lambda: HARD_CASES["bricard"].scene(),
    "redundant rows": lambda: held_box("contacts twice", times=2),
}


@pytest.mark.parametrize("name", CLOSED)
def test_joints_stay_closed_without_stabilization(name):
    """In positions and in velocities, at the end of every step."""
    h = 2e-3
    run = ma.simulate(
        ma.compile_system(CLOSED[name]()), 200 * h, integrator="variational", step=h,
        output_step=h, stabilization="none",
    )  # fmt: skip
    assert run.status == "completed", run.message
    assert len(run) == 201 and np.ptp(joints(run), axis=0).max() > 0.01
    assert np.max(run.position_drift) < 1e-13
    assert np.max(run.velocity_drift) < 1e-12


@pytest.mark.parametrize("gravity", [None, [0, 0, -9.81]], ids=["alone", "while the arm falls"])
def test_angular_momentum_is_kept_exactly(gravity):
    """The arm holds the body by a ball at its centre of mass; 80 mrad a step."""
    system = ma.compile_system(free_spin_scene().replace(gravity=gravity, effects={}))
    run = ma.simulate(system, 1.0, integrator="variational", step=2e-3, output_step=2e-3)
    R = Rotation.from_quat(run.object_quaternion_xyzw).as_matrix()
    spin = np.einsum("kji,kj->ki", R, run.object_twist[:, 3:])
    momentum = np.einsum("kij,kj->ki", R, TUMBLING_INERTIA * spin)
    assert np.ptp(spin[:, 1]) > 60.0  # it turns over
    np.testing.assert_allclose(momentum - momentum[0], 0.0, atol=1e-12)


# --- energy --------------------------------------------------------------------------------------


def quarters(run):
    """Largest energy error of each quarter of a run [J]."""
    return np.array([np.max(np.abs(part)) for part in np.array_split(run.energy_balance, 4)])


@pytest.mark.slow
def test_energy_does_not_drift_where_that_of_rk4_does():
    """A body that turns over for 20 000 steps, 160 mrad each."""
    system = ma.compile_system(free_spin_scene().replace(gravity=None, effects={}))
    run = {"duration": 80.0, "step": 4e-3, "output_step": 2e-2}
    kept = quarters(ma.simulate(system, integrator="variational", **run))
    assert np.ptp(kept) < 0.02 * kept[0] and kept[0] < 1e-3 * 40.2
    lost = quarters(ma.simulate(system, integrator="rk4", **run))
    assert np.all(np.diff(lost) > 0.5 * lost[0])  # on and on


@pytest.mark.slow
def test_energy_of_a_linkage_does_not_drift():
    """Bricard's loop, five redundant rods' worth of constraints, 20 000 steps."""
    system = ma.compile_system(HARD_CASES["bricard"].scene())
    run = ma.simulate(system, 80.0, integrator="variational", step=4e-3, output_step=4e-2)
    kept = quarters(run)
    assert run.status == "completed", run.message
    assert np.ptp(kept) < 0.02 * kept[0] and kept[0] < 2e-5
    assert abs(np.mean(run.energy_balance[:500]) - np.mean(run.energy_balance[-500:])) < 1e-6


@pytest.mark.parametrize("name", ["weld and ball", "bricard"])
def test_energy_error_falls_with_the_square_of_the_step(name):
    system = ma.compile_system(CLOSED[name]())
    worst = []
    for h in (4e-3, 2e-3, 1e-3):
        run = ma.simulate(system, 0.4, integrator="variational", step=h, output_step=0.02)
        worst.append(np.max(np.abs(run.energy_balance)))
    slope = np.polyfit(np.log([4, 2, 1]), np.log(worst), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1), worst


# --- order 2 -------------------------------------------------------------------------------------

HARMONIC = {
    "kind": "harmonic", "frequency": 4.0,
    "amplitude": {"left": [30, 30, 30, 5, 5, 5], "right": [20, -30, 20, 5, 5, 5]},
}  # fmt: skip
FOLLOW = {
    "kind": "joint_pd", "stiffness": 800.0, "damping": 30.0,
    "path": [{"time": 0.4, "xyz": [0.05, 0.05, 0.6]}],
}  # fmt: skip
DRIVEN = {
    "harmonic torques and damping": lambda: ur5_pair(
        {"kind": "weld"}, {"kind": "ball"}, control=HARMONIC, effects={"joint_damping": 20.0}
    ),
    "joint springs": lambda: ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=FOLLOW),
    "redundant rows": lambda: held_box("contacts twice", times=2),
    "bricard": lambda: HARD_CASES["bricard"].scene(),
}


def slope_of(system, duration, steps, reference=None):
    """Fitted order of the joints' positions at the end, and their errors."""
    if reference is None:
        exact = {"integrator": "dop853", "tolerance": 1e-12, "output_step": duration}
        reference = joints(ma.simulate(system, duration, **exact))[-1]
    errors = []
    for n in steps:
        run = ma.simulate(
            system, duration, integrator="variational", step=duration / n, output_step=duration
        )
        assert run.status == "completed", run.message
        errors.append(np.max(np.abs(joints(run)[-1] - reference)))
    return -np.polyfit(np.log(steps), np.log(errors), 1)[0], errors


@pytest.mark.parametrize("name", DRIVEN)
def test_forced_and_damped_motions_converge_with_order_2(name):
    slope, errors = slope_of(ma.compile_system(DRIVEN[name]()), 0.3, [60, 120, 240])
    assert slope == pytest.approx(2.0, abs=0.1), errors
    assert errors[-1] < 1e-5


def test_energy_balance_counts_the_work_of_torques_and_damping():
    """To order 2, like the motion."""
    system, worst = ma.compile_system(DRIVEN["harmonic torques and damping"]()), []
    for h in (2e-3, 1e-3):
        run = ma.simulate(system, 0.3, integrator="variational", step=h, output_step=0.02)
        worst.append(np.max(np.abs(run.energy_balance)))
    assert np.max(np.abs(run.energy - run.energy[0])) > 100 * worst[0]
    assert worst[0] / worst[1] == pytest.approx(4.0, abs=0.3)


def test_works_of_effects_are_no_unknowns_of_a_step(ur5_system):
    """The unknowns are velocities: one more would read and write beyond the joints' arrays."""
    effects = {"joint_damping": 0.5, "drag": {"linear": 1.0}}
    system = ma.compile_system(ur5_system.scene.replace(effects=effects))
    assert len(system.model.effects.works) == 2
    step = make_stepping(data_of(system), METHODS["variational"]).work[0]
    for unknowns in (step.xi, step.start, step.push, step.momentum):
        assert unknowns.size == 6 + system.model.layout.rate_count
    assert step.last.shape == (2, 6 + system.model.layout.rate_count + system.model.layout.contacts)


@pytest.mark.slow
def test_rolling_converges_with_order_2(tmp_path):
    """A ball in a tube on a turntable: no slip is a condition on velocities, not on positions."""
    table = tmp_path / "turntable.urdf"
    table.write_text(CARRIER.format(kind="continuous", axis="0 0 1", rpy="0.2 0 0"))
    d = 0.6 - RADIUS
    scene = rolling_scene(
        str(table), {"cylinder": {"radius": 0.6, "inside": True}}, 2 / 5 * BALL * RADIUS**2,
        [d, 0, 0], [0, 4 * d, 0.3], [1.5, 0.3 / RADIUS, -4 * d / RADIUS], 0.0,
    )  # fmt: skip
    system = ma.compile_system(scene)
    errors, exact = [], ma.simulate(system, 1.0, integrator="dop853", tolerance=1e-11)
    for h in (8e-3, 4e-3, 2e-3):
        run = ma.simulate(system, 1.0, integrator="variational", step=h)
        assert run.status == "completed", run.message
        errors.append(np.max(np.abs(run.object_position[-1] - exact.object_position[-1])))
        assert np.max(run.position_drift) < 1e-12 and np.max(run.velocity_drift) < 1e-10
    slope = np.polyfit(np.log([4, 2, 1]), np.log(errors), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.1), errors


# --- matrices of Coriolis forces -----------------------------------------------------------------


def coriolis_matrices(system):
    """``C`` of every arm at the state in the buffers, read where the kernels read it."""
    coriolis = data_of(system).coriolis()
    calls = coriolis.calls
    update_kinematics(data_of(system).struct)
    if calls.callback:
        ctypes.CFUNCTYPE(None)(calls.callback)()
    if calls.compiled:
        kinds = [ctypes.c_int64] * 3 + [ctypes.c_double] * 2
        ctypes.CFUNCTYPE(*kinds)(calls.compiled)(calls.robots_struct, calls.robots_size, 0.0, 0.0)
    found = []
    for (at, stride), arm in zip(coriolis.matrices, system.arms.values(), strict=True):
        n = arm.dof
        numbers = np.ctypeslib.as_array((ctypes.c_double * (n * stride)).from_address(int(at)))
        found.append(numbers.reshape(n, stride)[:, :n].copy())
    return found


ARMS = {
    "ur5": ("tool0", 6, {}),
    "panda": ("panda_hand_tcp", 7, {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}),
    "textbook_6r": ("tool", 6, {}),
}


@pytest.mark.parametrize("terms", ["pinocchio", "compiled"])
@pytest.mark.parametrize("robot", [*ARMS, "hinges and slides"])
def test_rate_of_the_inertia_is_the_coriolis_matrix_and_its_transpose(robot, terms, rng, tmp_path):
    """Both arms of a group, at a random state; the rate by differences of Pinocchio's inertia."""
    if robot in ARMS:
        tip, n, lock = ARMS[robot]
        source = {"robot": robot, "tip": tip, "lock": lock}
    else:
        n, file = 5, tmp_path / "chain.urdf"
        file.write_text(chain_urdf("xuZyw"))
        source = {"urdf": str(file), "tip": "tip"}
    arms = {
        name: {**source, "posture": rng.uniform(-1, 1, n).tolist(), "base": {"xyz": [x, 0, 0]}}
        for name, x in (("one", -1.0), ("two", 1.0))
    }
    scene = scene_of(arms, [{"arm": name, "kind": "ball"} for name in arms])
    system = ma.compile_system(scene, arms=terms)
    state = random_state(system, rng)
    data_of(system).set_state(0.0, state)
    for (name, arm), C in zip(system.arms.items(), coriolis_matrices(system), strict=True):
        q, v = state.joint_positions[name], state.joint_velocities[name]
        rate = first_difference(lambda t, a=arm, q=q, v=v: a.terms(q + t * v, v).M, 1e-2)
        assert np.max(np.abs(rate)) > 0.1
        np.testing.assert_allclose(C + C.T, rate, atol=1e-9 * np.max(np.abs(rate)))
        # and what it makes of the velocities is the bias without gravity; stored by columns
        bias = arm.terms(q, v).bias - arm.terms(q, np.zeros_like(v)).bias
        np.testing.assert_allclose(C.T @ v, bias, atol=1e-11 * np.max(np.abs(C)))


# --- what it refuses, and how it fails -----------------------------------------------------------


def test_a_step_that_cannot_be_solved_is_told_with_the_remedy(ur5_system):
    run = ma.simulate(ur5_system, 6.0, integrator="variational", step=0.5, output_step=0.5)
    assert run.status == "failed"
    for part in ("at t = ", "variational step", "smaller `step`", "dop853"):
        assert part in run.message
    assert np.all(np.isfinite(joints(run))) and len(run) >= 1


def test_strong_damping_is_told_with_the_remedy():
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"}, effects={"joint_damping": 1e6})
    run = ma.simulate(ma.compile_system(scene), 0.1, integrator="variational", step=1e-3)
    assert run.status == "failed" and "where damping is strong" in run.message


def test_feedback_is_refused(ur5_system):
    with pytest.raises(ma.MultiarmError, match="keeps the joints closed itself"):
        ma.simulate(ur5_system, 1.0, integrator="variational", step=1e-3, stabilization="feedback")


def test_a_controller_in_python_is_asked_half_way(ur5_system):
    """The same torques from Python and from the scene; the midpoint is where they act."""
    harmonic = ma.compile_system(DRIVEN["harmonic torques and damping"]())
    plain = ma.compile_system(harmonic.scene.replace(control={"kind": "none"}))
    times = []

    def control(t, state):
        times.append(t)
        angle = 2 * np.pi * HARMONIC["frequency"] * t
        return {
            arm: hold[arm] + np.array(HARMONIC["amplitude"][arm]) * np.sin(angle)
            for arm in state.joint_positions
        }

    hold = ma.evaluate(harmonic, 0.0).joint_torques
    run = {"duration": 0.1, "integrator": "variational", "step": 2e-3}
    found = ma.simulate(plain, control=control, **run)
    np.testing.assert_allclose(joints(found), joints(ma.simulate(harmonic, **run)), atol=1e-12)
    halves = np.round(np.array(times) / 2e-3, 6) % 1.0
    assert set(halves) == {0.0, 0.5}


def test_an_error_in_the_controller_ends_the_run_in_good_order(ur5_system):
    def control(t, state):
        if t > 0.02:
            raise ValueError("out of ideas")
        return {}

    run = ma.simulate(ur5_system, 0.1, integrator="variational", step=2e-3, control=control)
    assert run.status == "failed" and "out of ideas" in run.message
    assert run.time[-1] == pytest.approx(0.02)
