"""Claims about stiff scenes: the linearly implicit method, and how runs come to it by themselves.

The scenes are spatial: two UR5s welded to a box, in joints with up to 1e8 N m s/rad of damping.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import box, on_floor
from mechanics import (
    chain_urdf,
    first_difference,
    over_floor,
    random_state,
    scene_of,
    ur5_pair,
)
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from steps import coupled, derivatives_of, state_of, step_of_the_package, without_derivatives

import multiarm as ma
from multiarm.integration.step import coefficients
from multiarm.problems import HARD_CASES, ring_of_arms
from multiarm.tableaus import METHODS

WELD, BALL = {"kind": "weld"}, {"kind": "ball"}
FEET = [[0.3, 0.2, -0.2], [-0.3, 0.2, -0.2], [0.0, -0.2, -0.2]]
AMPLITUDE = {
    "left": np.array([60.0, 80, 60, 20, 20, 10]),
    "right": np.array([40.0, -50, 30, 10, 5, 5]),
}


def harmonic(scale=1.0, frequency=1.0, **more):
    """Torques that begin at what holds the start."""
    amplitude = {arm: (scale * a).tolist() for arm, a in AMPLITUDE.items()}
    return {"kind": "harmonic", "frequency": frequency, "amplitude": amplitude, **more}


def damped_pair(damping, right=WELD, **more):
    """The compiled scene; ``more`` are its control and run."""
    more = {"control": harmonic(), **more}
    return ma.compile_system(ur5_pair(WELD, right, effects={"joint_damping": damping}, **more))


def joints(run):
    """Joint positions of all arms, (K, n)."""
    return np.concatenate([run.joint_positions[arm] for arm in run.arm_names], axis=1)


def method_events(run):
    return [event for event in run.events if event["kind"] == "method changes"]


# --- a step, against the textbook written down in NumPy ------------------------------------------


class Textbook:
    """``z' = f(t, z)`` in the chart of the start, by :func:`multiarm.evaluate` only.

    ``z`` is object position, rotation vector (world axes, from the left), joints, velocities, work.
    """

    def __init__(self, system, start):
        self.system, self.start = system, start
        self.n = 6 + system.model.layout.rate_count
        self.damping = system.scene.effects.joint_damping or 0.0
        v, works = start.velocity, np.zeros(2 if self.damping else 1)
        self.z = np.concatenate([start.object_position, np.zeros(3), start.position[7:], v, works])

    def slope(self, t, z):
        n, theta = self.n, z[3:6]
        base = Rotation.from_quat(self.start.object_quaternion_xyzw)
        q = self.system.model.layout.split_joints(z[6:n])
        twist, v = z[n : n + 6], z[n + 6 : 2 * n]
        rates = self.system.model.layout.split_joints(v)
        state = self.system.state(
            z[:3], (Rotation.from_rotvec(theta) * base).as_quat(), q, twist, rates
        )
        found = ma.evaluate(self.system, t, state)
        torque = np.concatenate([found.joint_torques[arm] for arm in self.system.arm_names])
        acceleration = np.concatenate(
            [found.object_acceleration, *found.joint_accelerations.values()]
        )
        lost = -self.damping * v @ v
        powers = ([lost] if self.damping else []) + [v @ torque + lost]
        turning = np.linalg.solve(left_jacobian(theta), twist[3:])
        return np.concatenate([twist[:3], turning, v, acceleration, powers])

    def jacobian(self, t):
        """By differences of order 8."""
        along = lambda e: lambda s: self.slope(t, self.z + s * e)  # noqa: E731
        return np.column_stack([first_difference(along(e), 1e-3) for e in np.eye(self.z.size)])

    def time_slope(self, t):
        return first_difference(lambda s: self.slope(t + s, self.z), 1e-3)

    def step(self, t, h):
        """Stages ``U_i = h k_i`` and the end of the step, with the whole matrix."""
        m = coefficients(METHODS["rodas5p"], 0)
        J, f_t = self.jacobian(t), self.time_slope(t)
        matrix, stages = np.eye(self.z.size) / (h * m.gamma) - J, np.zeros((8, self.z.size))
        for i in range(8):
            right = self.slope(t + m.c[i] * h, self.z + m.A[i, :i] @ stages[:i])
            right += m.C[i, :i] @ stages[:i] / h + h * m.d[i] * f_t
            stages[i] = np.linalg.solve(matrix, right)
        return stages / h, self.z + m.b @ stages


def left_jacobian(theta):
    """``omega = J(theta) theta'``: the series of ``(exp(S) - 1) / S``."""
    S = np.cross(np.eye(3), theta)
    terms = [np.linalg.matrix_power(S, k) / math.factorial(k + 1) for k in range(20)]
    return np.sum(terms, axis=0)


SPUN = {
    "weld and ball": lambda tmp: ur5_pair(
        WELD, BALL, control=harmonic(phase={"left": [0.7] * 6}), effects={"joint_damping": 30.0}
    ),
    "springs": lambda tmp: ur5_pair(
        WELD, BALL, control={"kind": "joint_pd", "stiffness": 900.0, "damping": 40.0}
    ),
    "hinges and slides": lambda tmp: sliding_scene(tmp),
}


def sliding_scene(tmp):
    """One arm of hinges and slides holds a box; no control."""
    file = tmp / "chain.urdf"
    file.write_text(chain_urdf("xuZyw"))
    arm = {"urdf": str(file), "tip": "tip", "posture": [0.3, 0.1, -0.4, 0.5, -0.05]}
    body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 2.0}
    return scene_of(
        {"arm": arm}, [{"arm": "arm", "kind": "weld"}], object=body,
        effects={"joint_damping": 20.0},
    )  # fmt: skip


@pytest.fixture(params=SPUN)
def spun(request, rng, tmp_path):
    """A system, a state in fast motion (the object turns at some rad/s), the textbook's view."""
    system = ma.compile_system(SPUN[request.param](tmp_path))
    state = random_state(system, rng, turn=0.05, speed=2.0)
    return system, state, Textbook(system, state)


def test_derivatives_of_a_step_are_those_of_the_accelerations(spun):
    """Against differences of order 8."""
    system, state, textbook = spun
    stepping, n, J = step_of_the_package(system, state, 1e-3), textbook.n, textbook.jacobian(0.0)
    by_position, by_velocity = derivatives_of(system, stepping)
    for found, exact in (
        (by_position, J[n:, :n]),
        (by_velocity, J[n:, n : 2 * n]),
        (stepping.work[0].time_slope[:, None], textbook.time_slope(0.0)[:, None]),
    ):
        scale = np.maximum(np.max(np.abs(exact), axis=0), 1.0)
        assert np.all(np.max(np.abs(found - exact), axis=0) < 2e-5 * scale)
    changing = np.max(np.abs(stepping.work[0].time_slope))
    assert changing > 10.0 if system.scene.control.kind == "harmonic" else changing < 1e-3


@pytest.mark.parametrize("h", [3e-3, 0.02])
def test_a_step_is_that_of_the_whole_matrix(spun, h):
    """Every stage as the textbook has it, although only accelerations are differentiated."""
    system, state, textbook = spun
    stepping = step_of_the_package(system, state, h)
    stages, end = textbook.step(0.0, h)
    scale = np.max(np.abs(stages), axis=0) + 1.0
    assert np.max(np.abs(stages[:, 3:6])) > 2.0  # the object turns
    np.testing.assert_allclose(stepping.step.k[:8] / scale, stages / scale, rtol=0, atol=3e-5)
    step = np.max(np.abs(end - textbook.z))
    np.testing.assert_allclose(stepping.step.z_new, end, rtol=0, atol=1e-6 * step)


def test_stages_solve_the_whole_system_to_rounding(spun):
    """With the step's own derivatives in the matrix of all unknowns, works included."""
    system, state, textbook = spun
    h, n, z, m = 0.03, textbook.n, textbook.z, coefficients(METHODS["rodas5p"], 0)
    stepping = step_of_the_package(system, state, h)
    J = np.zeros((z.size, z.size))
    J[:n, n : 2 * n] = np.eye(n)
    J[3:6, 3:6] = np.cross(np.eye(3), z[n + 3 : n + 6]) / 2  # of omega - theta x omega / 2
    J[n:, :n], J[n:, n : 2 * n] = derivatives_of(system, stepping)
    matrix = np.eye(z.size) / m.gamma - h * J
    for i in range(8):
        right = textbook.slope(m.c[i] * h, z + h * m.A[i, :i] @ stepping.step.k[:i])
        right += m.C[i, :i] @ stepping.step.k[:i] + h * m.d[i] * stepping.work[0].time_slope
        exact = np.linalg.solve(matrix, right)
        slopes = stepping.step.k
        np.testing.assert_allclose(slopes[i], exact, rtol=0, atol=1e-10 * np.max(np.abs(slopes)))


# --- order ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [1e2, 1e3, 1e4])
def test_error_falls_with_order_5_under_stiff_damping(damping, monkeypatch):
    """Steps of up to 600 times the fastest time constant; torques change all the while."""
    system = damped_pair(damping, control=harmonic(frequency=2.0))
    exact = joints(ma.simulate(system, 0.5, integrator="dop853", tolerance=1e-12, output_step=0.5))[
        -1
    ]
    monkeypatch.setitem(METHODS, "rk4", METHODS["rodas5p"]._replace(error_order=0))
    errors, steps = [], [12, 16, 24, 32]
    for n in steps:
        run = ma.simulate(system, 0.5, integrator="rk4", step=0.5 / n, output_step=0.5)
        errors.append(np.max(np.abs(joints(run)[-1] - exact)))
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(5.0, abs=0.2), errors


@pytest.mark.parametrize("name", ["parallelogram", "duplicated_rows"])
def test_error_falls_with_order_5_under_dependent_constraints(name):
    """With few evaluations a step: its derivatives take one.  The methods choose the steps."""
    system, run = ma.compile_system(HARD_CASES[name].scene()), {"output_step": 0.3}
    exact = ma.simulate(system, 0.3, integrator="dop853", tolerance=1e-12, **run)
    errors, steps = [], []
    for tolerance in (1e-5, 1e-6, 1e-7, 1e-8, 1e-9):
        found = ma.simulate(system, 0.3, integrator="rodas5p", tolerance=tolerance, **run)
        errors.append(np.max(np.abs(joints(found)[-1] - joints(exact)[-1])))
        steps.append(found.statistics["steps"])
        assert found.statistics["evaluations"] < 11 * steps[-1] + 5
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(5.0, abs=0.4), errors


def test_error_falls_with_order_5_while_friction_leaves_the_motion_open():
    """A box spins on four corners, and the least forces decide at every stage."""
    system = ma.compile_system(on_floor(box(twist=[1.0, 0.3, 0, 0, 0, 2.0]), mu=0.3))
    run = {"duration": 0.2, "output_step": 0.2, "certificate": False}
    exact = ma.simulate(system, integrator="dop853", tolerance=1e-12, **run)
    errors, steps = [], []
    for tolerance in (1e-7, 1e-8, 1e-9, 1e-10):
        found = ma.simulate(system, integrator="rodas5p", tolerance=tolerance, **run)
        errors.append(np.max(np.abs(found.object_twist[-1] - exact.object_twist[-1])))
        steps.append(found.statistics["steps"])
        assert f"{steps[-1]} steps ended where friction leaves the motion open" in found.message
        assert found.statistics["evaluations"] < 11 * steps[-1] + 5
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(5.0, abs=0.4), errors


@pytest.mark.slow
def test_samples_between_long_steps_are_as_accurate_as_their_ends():
    system = damped_pair(1e4)
    run = {"duration": 1.0, "output_step": 1.0 / 211}
    found = ma.simulate(system, integrator="rodas5p", tolerance=1e-8, **run)
    exact = ma.simulate(system, integrator="dop853", tolerance=1e-10, **run)
    assert found.statistics["steps"] < 70 < len(found)
    np.testing.assert_allclose(joints(found), joints(exact), rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.object_twist, exact.object_twist, rtol=0, atol=1e-8)
    for arm in found.arm_names:
        forces = found.contact_forces[arm] - exact.contact_forces[arm]
        assert np.max(np.abs(forces)) < 2e-3 * np.max(np.abs(exact.contact_forces[arm]))


# --- what damping costs --------------------------------------------------------------------------


def test_steps_do_not_shrink_with_damping():
    """Under given torques; the explicit method's steps shrink in proportion."""
    steps = []
    for damping in (1e2, 1e6, 1e8):
        run = ma.simulate(damped_pair(damping), 1.0, integrator="rodas5p", tolerance=1e-6)
        assert run.status == "completed", run.message
        steps.append(run.statistics["steps"])
    assert max(steps) == steps[0] < 120, steps
    costs = [
        ma.simulate(damped_pair(d), 0.1, integrator="dop853", tolerance=1e-6).statistics
        for d in (1e3, 1e4)
    ]
    assert costs[1]["steps"] > 5 * costs[0]["steps"]


@pytest.mark.parametrize("damping", [1e3, 1e4])
def test_stiff_method_agrees_with_the_explicit_one_where_that_is_feasible(damping):
    system = damped_pair(damping)
    run = {"duration": 0.5, "output_step": 0.05}
    found = ma.simulate(system, integrator="rodas5p", tolerance=1e-10, **run)
    exact = ma.simulate(system, integrator="dop853", tolerance=1e-11, **run)
    np.testing.assert_allclose(joints(found), joints(exact), rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.work, exact.work, rtol=0, atol=1e-7)
    assert found.statistics["evaluations"] < 0.5 * exact.statistics["evaluations"] or damping < 1e4


def quasi_static(system, damping, times):
    """Joint positions without inertia: ``d q' = tau + W lambda``, nothing else on the object.

    Of all motions that the welds allow it is the nearest to ``tau / d``: least squares for the
    object's twist, since both arms follow it by their Jacobians.
    """
    arms = list(system.arms.values())
    start = system.initial_state()
    q_0 = np.concatenate([start.joint_positions[name] for name in system.arm_names])
    amplitude = np.concatenate([AMPLITUDE[name] for name in system.arm_names])
    tip = arms[0].tip_pose(q_0[:6])
    at = tip[:3, :3].T @ (start.object_position - tip[:3, 3])

    def rates(t, q):
        centre = arms[0].tip_pose(q[:6])
        centre = centre[:3, :3] @ at + centre[:3, 3]
        maps = []
        for k, arm in enumerate(arms):
            own = q[6 * k : 6 * k + 6]
            lever = arm.tip_pose(own)[:3, 3] - centre
            carried = np.eye(6)
            carried[:3, 3:] = np.cross(np.eye(3), lever).T
            maps.append(np.linalg.solve(arm.terms(own, np.zeros(6)).J, carried))
        follow = np.vstack(maps)
        wanted = amplitude * np.sin(2 * np.pi * t)
        return follow @ np.linalg.lstsq(follow, wanted)[0] / 100.0

    span = (0.0, times[-1])
    return solve_ivp(rates, span, q_0, "DOP853", times, rtol=1e-9, atol=1e-11).y.T


@pytest.mark.parametrize("damping", [1e6, 1e8])
def test_strongest_damping_leaves_the_quasi_static_motion(damping):
    """What inertia still does is of the size M / d, some 1e-7 of the motion per kg m^2 at 1e8."""
    system = damped_pair(damping, control=harmonic(damping / 100.0), gravity=None)
    found = ma.simulate(system, 0.6, integrator="rodas5p", tolerance=1e-6, output_step=0.1)
    limit = quasi_static(system, damping, found.time)
    moved = np.max(np.ptp(limit, axis=0))
    assert moved > 0.1
    np.testing.assert_allclose(joints(found), limit, rtol=0, atol=20.0 / damping + 2e-8)
    assert np.max(found.position_drift) < 1e-12


def test_stiff_gains_cost_hardly_more_than_soft_ones():
    """A damping gain of 1e5 N m s/rad instead of 1e3 carries the box along the same path."""
    path = [{"time": 0.5, "xyz": [0.0, 0.05, 0.6]}]
    steps = []
    for damping in (1e3, 1e5):
        control = {"kind": "joint_pd", "stiffness": 10.0 * damping, "damping": damping}
        system = ma.compile_system(ur5_pair(WELD, WELD, control={**control, "path": path}))
        run = ma.simulate(system, 0.6, integrator="rodas5p", tolerance=1e-6)
        steps.append(run.statistics["steps"])
    assert steps[1] < 2 * steps[0], steps
    np.testing.assert_allclose(run.object_position[-1], path[0]["xyz"], rtol=0, atol=1e-4)


# --- runs that come to it by themselves ----------------------------------------------------------


def test_a_stiff_scene_goes_on_with_the_stiff_method():
    """The same motion as dop853's, for a tenth of its evaluations; it is told once."""
    system, run = damped_pair(1e4), {"duration": 0.6, "output_step": 0.05}
    found = ma.simulate(system, accuracy=1e-6, certificate=False, **run)
    assert found.statistics["integrator"] == "rodas5p"
    (event,) = method_events(found)
    assert event["text"] == "the scene is stiff: the run goes on with rodas5p"
    assert 0.0 < event["time"] < 0.1
    named = ma.simulate(system, integrator="dop853", tolerance=1e-8, **run)
    assert named.statistics["integrator"] == "dop853" and not method_events(named)
    assert found.statistics["evaluations"] < 0.1 * named.statistics["evaluations"]
    np.testing.assert_allclose(joints(found), joints(named), rtol=0, atol=1e-7)
    # what the named method does not do, it says
    assert "the scene is stiff from t = " in named.message
    assert "`integrator: rodas5p` takes longer steps there" in named.message
    assert "the scene is stiff: rodas5p took over at t = " in found.message


def test_both_explicit_methods_notice_stiffness():
    """A coarse run begins with dopri5."""
    found = ma.simulate(damped_pair(1e4), 0.6, accuracy=1e-3, certificate=False)
    assert found.statistics["integrator"] == "rodas5p" and len(method_events(found)) == 1


@pytest.mark.parametrize("accuracy", [1e-3, 1e-8])
def test_scenes_that_are_not_stiff_never_change_the_method(accuracy, welded_ur5_system):
    chosen = "dopri5" if accuracy > 3e-4 else "dop853"
    soft = ring_of_arms(2).replace(effects={"joint_damping": 1.0})
    for system in (ma.compile_system(soft), welded_ur5_system):
        run = ma.simulate(system, 0.3, accuracy=accuracy, certificate=False)
        assert run.statistics["integrator"] == chosen
        assert not method_events(run) and "stiff" not in run.message


@pytest.mark.slow
def test_a_trial_that_does_not_pay_is_given_up():
    """Many joints, mild damping, high accuracy: a long step costs more than some short ones, where
    two effects that state no derivative may act on everybody.
    """
    effects = {"joint_damping": 1000.0, "drag": {"linear": 1.0}}
    scene = ring_of_arms(8).replace(effects=effects)
    system = coupled(without_derivatives(ma.compile_system(scene)))
    run = {"duration": 0.5, "output_step": 0.05}
    found = ma.simulate(system, accuracy=1e-6, certificate=False, **run)
    told = [event["text"] for event in method_events(found)]
    assert told == [
        "the scene is stiff: the run goes on with rodas5p",
        "steps of rodas5p are too costly here: the run goes on with dop853",
    ]
    assert found.status == "completed" and found.statistics["integrator"] == "dop853"
    exact = ma.simulate(system, integrator="dop853", tolerance=1e-11, **run)
    np.testing.assert_allclose(joints(found), joints(exact), rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.work, exact.work, rtol=0, atol=1e-4)


def test_a_trial_is_not_given_up_after_the_end():
    """A run that ends during the trial does not go on with anything."""
    scene = ring_of_arms(2).replace(effects={"joint_damping": 300.0})
    found = ma.simulate(ma.compile_system(scene), 0.5, accuracy=1e-4, certificate=False)
    assert found.statistics["integrator"] == "rodas5p"
    assert len(method_events(found)) == 1 and method_events(found)[0]["time"] < 0.4


def test_a_certified_run_of_a_stiff_scene_is_met():
    run = ma.simulate(damped_pair(1e4), 0.3, accuracy=1e-6)
    assert run.statistics["integrator"] == "rodas5p" and run.certificate["met"]


# --- where else it has to work -------------------------------------------------------------------


def agrees(system, duration, tolerance=1e-9, within=1e-7, **more):
    """A run of the stiff method ends where dop853 ends."""
    run = {"duration": duration, "output_step": duration / 10, **more}
    found = ma.simulate(system, integrator="rodas5p", tolerance=tolerance, **run)
    exact = ma.simulate(system, integrator="dop853", tolerance=1e-11, **run)
    assert found.status == "completed", found.message
    np.testing.assert_allclose(joints(found), joints(exact), rtol=0, atol=within)
    assert np.max(np.ptp(joints(exact), axis=0)) > 100 * within
    return found


@pytest.mark.parametrize("name", ["bricard", "parallelogram", "duplicated_rows"])
def test_redundant_constraints_do_not_disturb_the_stiff_method(name):
    found = agrees(ma.compile_system(HARD_CASES[name].scene()), 0.3)
    assert np.max(found.position_drift) < 1e-12


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8])
def test_a_loop_closed_once_too_often_takes_few_attempts_with_long_steps(tolerance):
    """The rank changes where the stages are off the joints: steps go on with projected ones, which
    count as two evaluations; a third of the steps or less begins with an attempt without."""
    system = ma.compile_system(HARD_CASES["bricard"].scene())
    run = ma.simulate(system, 2.0, integrator="rodas5p", tolerance=tolerance, output_step=2.0)
    s = run.statistics
    assert s["rejected_steps"] <= s["steps"] / 3.0 + 1.0
    assert s["evaluations"] < 20 * s["steps"]


def test_contacts_that_slide_do_not_disturb_the_stiff_method():
    """A box on three feet, which a damped arm drags and turns: 11 evaluations a step, few steps."""
    scene = over_floor(0.0, mu=0.2, points=FEET).scene
    keys = scene.model_dump(exclude_unset=True)
    pushed = {**keys["object"], "twist": [0, 0.3, 0, 0, 0, 0.2]}
    effects = {**keys["effects"], "joint_damping": 200.0}
    system = ma.compile_system(scene.replace(object=pushed, effects=effects))
    after_impacts = ma.simulate(system, 0.01, accuracy=1e-8, certificate=False)
    run = {"state": state_of(system, after_impacts, -1), "certificate": False}
    found = agrees(system, 0.1, 1e-7, 1e-8, **run)
    assert np.all(found.contact_states["floor"] == 2.0) and not found.events  # sliding
    steps, rejected = found.statistics["steps"], found.statistics["rejected_steps"]
    assert steps < 30 and found.statistics["evaluations"] < 11 * steps + 8 * rejected + 40


def test_one_arm_with_slides_under_stiff_damping(tmp_path):
    scene = sliding_scene(tmp_path).replace(effects={"joint_damping": 2000.0})
    found = agrees(ma.compile_system(scene), 0.3)
    assert found.statistics["steps"] < 100


@pytest.mark.parametrize("kind", ["feedback", "none"])
def test_other_stabilizations_under_stiff_damping(kind):
    found = agrees(damped_pair(1e3), 0.3, within=1e-6, stabilization=kind)
    assert np.max(found.position_drift) < (1e-6 if kind == "feedback" else 1e-5)


def test_a_stiff_controller_in_python():
    """The scene's own springs, written in Python: both are differentiated."""
    pd = {"kind": "joint_pd", "stiffness": 1e4, "damping": 1e4, "gravity_compensation": False}
    built_in = ma.compile_system(ur5_pair(WELD, WELD, control=pd))
    plain = ma.compile_system(ur5_pair(WELD, WELD))
    start = plain.initial_state().joint_positions

    def control(t, state):
        return {
            arm: 1e4 * (start[arm] - q) - 1e4 * state.joint_velocities[arm]
            for arm, q in state.joint_positions.items()
        }

    run = {"duration": 0.5, "integrator": "rodas5p", "tolerance": 1e-8}
    found = ma.simulate(plain, control=control, max_step=np.inf, **run)
    same = ma.simulate(built_in, **run)
    np.testing.assert_allclose(joints(found), joints(same), rtol=0, atol=1e-9)
    assert found.statistics["steps"] < 100


# --- how it fails --------------------------------------------------------------------------------


def test_an_error_of_the_controller_ends_a_stiff_run_in_good_order():
    """Also when it is raised while derivatives are taken."""

    def control(t, state):
        if t > 0.02:
            raise ValueError("out of ideas")
        return {}

    system = damped_pair(1e4)
    run = ma.simulate(
        system, 0.1, integrator="rodas5p", tolerance=1e-6, control=control, output_step=1e-3
    )
    assert run.status == "failed" and "out of ideas" in run.message
    assert np.all(np.isfinite(joints(run))) and run.time[-1] < 0.021
    again = ma.simulate(system, 0.1, integrator="rodas5p", tolerance=1e-6)
    assert again.status == "completed"


def test_an_unreachable_tolerance_is_told():
    """A torque that jumps at random cannot be followed."""
    rng = np.random.default_rng(1)
    control = lambda t, state: {"left": 1e3 * rng.standard_normal(6)}  # noqa: E731
    run = ma.simulate(damped_pair(1e2), 0.1, integrator="rodas5p", tolerance=1e-10, control=control)
    assert run.status == "failed"
    assert "the step became too small" in run.message and "discontinuous" in run.message


def test_a_fixed_step_is_refused_with_the_alternatives(ur5_system):
    with pytest.raises(ma.MultiarmError, match="'rodas5p' chooses its own steps"):
        ma.simulate(ur5_system, 1.0, integrator="rodas5p", step=1e-3)
