"""Claims about loads from outside: drag of the object, wrenches on it and on links.

Closed forms on a gantry of three slides that carries a body, 4 kg along x, 3 kg along y, 2 kg along
z, and on a turntable.
"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from linkages import compiled, state_on
from mechanics import (
    UR5_POSTURE,
    data_of,
    random_state,
    scene_of,
    single_arm,
    slides,
    ur5_pair,
)
from refusals import refused
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

import multiarm as ma
import multiarm.robots.backends
from multiarm.dynamics.status import OK
from multiarm.errors import ControlError, ModelError
from multiarm.integration.near_singular import evaluate_on_branch

MASSES = np.array([4.0, 3.0, 2.0])  # [kg] along x, y, z, with the body
TIGHT = {"accuracy": 1e-9, "output_step": 0.01, "certificate": False}
INERTIA = (0.02, 0.03, 0.05)


TURNTABLE = """<robot name="turntable"><link name="ground"/>
<joint name="turn" type="continuous"><parent link="ground"/><child link="plate"/>
<axis xyz="0 0 1"/></joint>
<link name="plate"><inertial><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.15"/></inertial></link>
<joint name="mount" type="fixed"><parent link="plate"/><child link="tip"/></joint>
<link name="tip"/></robot>"""


@pytest.fixture
def carried(tmp_path):
    """Compiles a body on the gantry, or on the turntable, with some effects."""

    def build(effects, speed=(0, 0, 0), rpy=(0, 0, 0), urdf=None, spin=0.0, **more):
        path = tmp_path / ("turntable.urdf" if urdf else "gantry.urdf")
        path.write_text(urdf or slides())
        velocity = [spin] if urdf else list(speed)
        arm = {"urdf": str(path), "tip": "tip", "posture": [0.0] * len(velocity)}
        body = {
            "shape": {"box": [0.1, 0.1, 0.1]}, "mass": 1.0, "inertia": list(INERTIA),
            "pose": {"rpy": list(rpy)}, "twist": [*speed, 0, 0, spin],
        }  # fmt: skip
        return ma.compile_system(
            scene_of(
                {"a": {**arm, "velocity": velocity}}, [{"arm": "a", "kind": "weld"}], object=body,
                gravity=None, effects=effects, **more,
            )
        )  # fmt: skip

    return build


def velocity(run) -> np.ndarray:
    return run.object_twist[:, :3]


# --- drag ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "written",
    [{"quadratic": 0.5}, {"area": 0.2, "coefficient": 2.0, "density": 2.5}],
    ids=["quadratic", "area"],
)
def test_a_pushed_body_nears_its_terminal_speed_as_a_hyperbolic_tangent(carried, written):
    push, q = 8.0, 0.5
    control = {"kind": "constant", "torques": {"a": [push, 0, 0]}}
    run = ma.simulate(carried({"drag": written}, control=control), duration=4.0, **TIGHT)
    terminal = math.sqrt(push / q)
    wanted = terminal * np.tanh(push * run.time / (MASSES[0] * terminal))
    np.testing.assert_allclose(velocity(run)[:, 0], wanted, atol=1e-8)
    assert wanted[-1] > 0.95 * terminal
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-7)


def test_linear_drag_brings_a_body_to_the_speed_of_the_wind(carried):
    wind = np.array([1.0, -2.0, 0.5])
    run = ma.simulate(
        carried({"drag": {"linear": 2.0, "wind": wind.tolist()}}), duration=4.0, **TIGHT
    )
    wanted = wind * (1.0 - np.exp(-2.0 * run.time[:, None] / MASSES))
    np.testing.assert_allclose(velocity(run), wanted, atol=1e-8)
    gained = 0.5 * np.sum(MASSES * wanted**2, axis=1)
    np.testing.assert_allclose(run.effect_works["drag"], gained, atol=1e-7)


def test_coefficients_belong_to_the_axes_of_the_object(carried):
    """Turned about z by a right angle, the body's x axis is the world's y axis."""
    drag = {"linear": [1.0, 5.0, 0.0]}
    system = carried({"drag": drag}, speed=(1.0, 1.0, 1.0), rpy=(0, 0, math.pi / 2))
    run = ma.simulate(system, duration=1.0, **TIGHT)
    wanted = np.exp(-np.array([5.0, 1.0, 0.0]) * run.time[:, None] / MASSES)
    np.testing.assert_allclose(velocity(run), wanted, atol=1e-8)


def test_quadratic_drag_is_against_the_motion_and_as_its_speed_squared(carried, rng):
    u, c, q, d = rng.standard_normal((4, 3))
    c, q, d = np.abs(c), np.abs(q), np.abs(d)
    wind = rng.standard_normal(3)
    scene = single_arm("ur5", "tool0", UR5_POSTURE, {"kind": "ball"})
    drag = {
        "linear": c.tolist(), "quadratic": q.tolist(), "angular": d.tolist(),
        "wind": wind.tolist(),
    }  # fmt: skip
    plain, resisted = (ma.compile_system(scene.replace(effects=e)) for e in ({}, {"drag": drag}))
    state = random_state(plain, rng)
    ma.evaluate(plain, 0.0, state)
    before = data_of(plain).arrays.forces.f_o.copy()
    ma.evaluate(resisted, 0.0, state)
    found = data_of(resisted).arrays.forces.f_o - before
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    u, w = R.T @ (state.object_twist[:3] - wind), R.T @ state.object_twist[3:]
    force, moment = -(c + q * np.linalg.norm(u)) * u, -d * w
    np.testing.assert_allclose(found, np.concatenate([R @ force, R @ moment]), atol=1e-12)


def test_angular_drag_slows_a_turntable_exponentially(carried):
    system = carried({"drag": {"angular": [9.0, 9.0, 0.1]}}, urdf=TURNTABLE, spin=3.0)
    run = ma.simulate(system, duration=2.0, **TIGHT)
    wanted = 3.0 * np.exp(-0.1 * run.time / (0.15 + INERTIA[2]))
    np.testing.assert_allclose(run.object_twist[:, 5], wanted, atol=1e-8)


# --- wrenches over time --------------------------------------------------------------------------

FORCE = np.array([2.0, -1.0, 0.5])


def forced(carried, course: dict | None = None, **more):
    wrench = {"on": "object", "force": FORCE.tolist(), **(course or {}), **more}
    return carried({"external_wrenches": [wrench]})


def test_a_constant_force_accelerates_evenly(carried):
    run = ma.simulate(forced(carried), duration=1.0, **TIGHT)
    np.testing.assert_allclose(velocity(run), FORCE * run.time[:, None] / MASSES, atol=1e-10)
    work = velocity(run)[-1] @ FORCE / 2 * run.time[-1]
    assert run.effect_works["external_wrenches"][-1] == pytest.approx(work, abs=1e-9)


def test_a_sinusoid_shakes_by_its_closed_form(carried):
    rate, phase = 2 * math.pi * 1.5, 0.4
    course = {"sinusoid": {"frequency": 1.5, "phase": phase}}
    run = ma.simulate(forced(carried, course), duration=1.0, **TIGHT)
    t = run.time[:, None]
    wanted = FORCE / MASSES * (math.cos(phase) - np.cos(rate * t + phase)) / rate
    np.testing.assert_allclose(velocity(run), wanted, atol=1e-9)


METHODS = [
    {"integrator": "dop853", "tolerance": 1e-8},
    {"integrator": "dopri5", "tolerance": 1e-8},
    {"integrator": "rodas5p", "tolerance": 1e-8},
    {"integrator": "rk4", "step": 0.01},
]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m["integrator"])
def test_a_pulse_gives_its_impulse_without_a_rejected_step(carried, method):
    """Steps end at the pulse's ends and see one side only; at samples between steps, too."""
    begin, end = 0.1234567, 0.3210987
    if method["integrator"] == "rk4":
        begin, end = 0.12, 0.32
    system = forced(carried, {"pulse": {"begin": begin, "end": end}})
    run = ma.simulate(system, duration=0.5, output_step=0.01, **method)
    wanted = FORCE / MASSES * np.clip(run.time[:, None] - begin, 0.0, end - begin)
    np.testing.assert_allclose(velocity(run), wanted, atol=1e-11)
    assert run.statistics["rejected_steps"] == 0
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-11)


@pytest.mark.parametrize("feedback", [False, True])
def test_pulses_may_touch_and_begin_at_once(carried, feedback):
    pulses = [(0.0, 0.1), (0.1, 0.2), (0.15, 0.4)]
    wrenches = [
        {"on": "object", "force": [k, 0, 0], "pulse": {"begin": a, "end": b}}
        for k, (a, b) in enumerate(pulses, start=1)
    ]
    stabilization = "feedback" if feedback else "projection"
    run = ma.simulate(
        carried({"external_wrenches": wrenches}),
        duration=0.4, stabilization=stabilization, **TIGHT,
    )  # fmt: skip
    impulse = sum(k * np.clip(run.time - a, 0.0, b - a) for k, (a, b) in enumerate(pulses, start=1))
    np.testing.assert_allclose(velocity(run)[:, 0], impulse / MASSES[0], atol=1e-10)


TIMES, VALUES = [0.1, 0.25, 0.4, 0.7, 0.8], [0.0, 1.0, 1.0, -0.5, 0.25]


def test_a_table_is_its_interpolation_and_nothing_outside(carried):
    table = forced(carried, {"table": {"times": TIMES, "values": VALUES}})
    factor = PchipInterpolator(TIMES, VALUES)
    run = ma.simulate(table, duration=1.0, **TIGHT)
    inside = np.clip(run.time, TIMES[0], TIMES[-1])
    impulse = factor.antiderivative()(inside) - factor.antiderivative()(TIMES[0])
    np.testing.assert_allclose(velocity(run), np.outer(impulse, FORCE / MASSES), atol=1e-10)
    assert run.statistics["rejected_steps"] == 0


def test_a_table_moves_like_its_function(carried):
    table = forced(carried, {"table": {"times": TIMES, "values": VALUES}})
    factor = PchipInterpolator(TIMES, VALUES)

    def wrench(t, _):
        inside = TIMES[0] <= t < TIMES[-1]
        return [*(FORCE * factor(t) * inside), 0, 0, 0]

    function = carried({"external_wrenches": [{"on": "object", "function": wrench}]})
    first, second = (ma.simulate(s, duration=1.0, **TIGHT) for s in (table, function))
    np.testing.assert_allclose(first.object_position, second.object_position, atol=1e-8)


@pytest.mark.parametrize("header", ["t,fx,fy,fz,mx,my,mz\n", ""])
def test_a_file_holds_the_wrench_itself(carried, tmp_path, header):
    rows = np.column_stack([TIMES, np.outer(VALUES, [*FORCE, 0, 0, 0])])
    path = tmp_path / "wrench.csv"
    path.write_text(header + "\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n\n")
    table = forced(carried, {"table": {"times": TIMES, "values": VALUES}})
    file = carried({"external_wrenches": [{"on": "object", "table": {"file": str(path)}}]})
    first, second = (ma.simulate(s, duration=1.0, **TIGHT) for s in (table, file))
    np.testing.assert_allclose(velocity(first), velocity(second), atol=1e-13)


def test_a_function_of_the_state_is_a_spring(carried):
    stiffness = 60.0

    def spring(t, state):
        return [*(-stiffness * state.object_position), 0, 0, 0]

    system = carried(
        {"external_wrenches": [{"on": "object", "function": spring}]}, speed=(1.0, 0.0, 0.0)
    )
    run = ma.simulate(system, duration=1.0, **TIGHT)
    rate = math.sqrt(stiffness / MASSES[0])
    np.testing.assert_allclose(run.object_position[:, 0], np.sin(rate * run.time) / rate, atol=1e-8)
    stored = -0.5 * stiffness * run.object_position[:, 0] ** 2
    np.testing.assert_allclose(run.effect_works["external_wrenches"], stored, atol=1e-7)


# --- where a wrench acts -------------------------------------------------------------------------


def added(scene, wrenches, state, t=0.0):
    """What wrenches add to the right-hand sides: on the object (6,), on the joints (n,)."""
    plain = ma.compile_system(scene)
    ma.evaluate(plain, t, state)
    before = data_of(plain).arrays.forces
    f_o, f_j = before.f_o.copy(), before.f_j.copy()
    loaded = ma.compile_system(scene.replace(effects={"external_wrenches": wrenches}))
    ma.evaluate(loaded, t, state)
    forces = data_of(loaded).arrays.forces
    return forces.f_o - f_o, forces.f_j - f_j


@pytest.mark.parametrize("axes", ["world", "body"])
def test_a_force_on_the_object_turns_it_about_its_centre_of_mass(axes, rng):
    scene = single_arm("ur5", "tool0", UR5_POSTURE, {"kind": "ball"})
    state = random_state(ma.compile_system(scene), rng)
    f, m, at = rng.standard_normal((3, 3))
    wrench = {"on": "object", "at": at, "axes": axes, "force": f, "torque": m}
    on_object, on_joints = added(scene, [wrench], state)
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    f, m = (R @ f, R @ m) if axes == "body" else (f, m)
    wanted = np.concatenate([f, m + np.cross(R @ at, f)])
    np.testing.assert_allclose(on_object, wanted, atol=1e-12)
    np.testing.assert_array_equal(on_joints, 0.0)


GRIPPER = {
    "robot": "ur5", "base": {"xyz": [0.1, 0.2, 0.3], "rpy": [0.1, 0.2, 0.3]},
    "tool": {"robot": "corner_gripper", "mount": "tool0", "at": {"xyz": [0, 0, 0.05]}},
    "tip": "corner", "posture": UR5_POSTURE,
}  # fmt: skip


def pose_of_link(system, arm: str, link: str, q) -> pin.SE3:
    model = system.arms[arm].model
    data = model.createData()
    pin.framesForwardKinematics(model, data, system.arms[arm].configuration(q))
    return data.oMf[model.getFrameId(link, pin.FrameType.BODY)].copy()


@pytest.mark.parametrize("axes", ["world", "body"])
@pytest.mark.parametrize("link", ["shoulder_link", "forearm_link", "tool0", "corner"])
def test_a_wrench_on_a_link_does_the_work_of_its_motion(link, axes, rng):
    """Generalised forces are the work of force and torque on small motions of the link."""
    body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 2.0}
    other = {"robot": "ur5", "tip": "tool0", "base": {"xyz": [3, 0, 0]}, "posture": UR5_POSTURE}
    scene = scene_of(
        {"other": other, "arm": GRIPPER},
        [{"arm": name, "kind": "weld"} for name in ("other", "arm")],
        object=body,
    )
    # far from closed: only right-hand sides are looked at
    scene = scene.replace(joints=[{"arm": "arm", "kind": "weld"}], arms={"arm": GRIPPER})
    system = ma.compile_system(scene)
    state = random_state(system, rng)
    f, m, at = rng.standard_normal((3, 3))
    wrench = {"on": f"arm/{link}", "at": at, "axes": axes, "force": f, "torque": m}
    on_object, on_joints = added(scene, [wrench], state)
    q, h = state.joint_positions["arm"].copy(), 1e-6
    place = pose_of_link(system, "arm", link, q)
    f, m = (place.rotation @ f, place.rotation @ m) if axes == "body" else (f, m)
    for j in range(q.size):
        step = h * np.eye(q.size)[j]
        ahead, behind = (pose_of_link(system, "arm", link, q + s) for s in (step, -step))
        moved = (ahead.act(at) - behind.act(at)) / (2 * h)
        turned = Rotation.from_matrix(ahead.rotation @ behind.rotation.T).as_rotvec() / (2 * h)
        assert on_joints[j] == pytest.approx(f @ moved + m @ turned, abs=1e-8)
    np.testing.assert_array_equal(on_object, 0.0)


def test_wrenches_find_their_arm_among_several_pinocchio_models(monkeypatch, rng):
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    state = random_state(ma.compile_system(scene), rng)
    wrench = {"on": "right/forearm_link", "at": [0.1, 0.2, 0.3], "force": [1.0, 2.0, 3.0]}
    _, together = added(scene, [wrench], state)
    monkeypatch.setattr(multiarm.robots.backends, "ROBOTS_PER_GROUP", 1)
    _, apart = added(scene, [wrench], state)
    np.testing.assert_allclose(together, apart, atol=1e-12)
    assert np.all(together[:6] == 0.0) and np.all(together[9:] == 0.0)
    assert np.abs(together[6:9]).max() > 0.1


def test_the_same_wrench_on_the_tip_moves_a_weld_as_on_the_object(rng):
    """Through a weld it does not matter on which side a wrench acts."""
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"})
    system = ma.compile_system(scene)
    state = system.initial_state()
    f, m = rng.standard_normal((2, 3)) * 20
    tip = system.arms["left"].tip_pose(state.joint_positions["left"])[:3, 3]
    on_object = {
        "on": "object", "force": f, "torque": m, "axes": "world",
        "at": Rotation.from_quat(state.object_quaternion_xyzw).as_matrix().T
        @ (tip - state.object_position),
    }  # fmt: skip
    on_tip = {"on": "left/tool0", "force": f, "torque": m}
    first, second = (
        ma.evaluate(ma.compile_system(scene.replace(effects={"external_wrenches": [w]})))
        for w in (on_object, on_tip)
    )
    np.testing.assert_allclose(first.object_acceleration, second.object_acceleration, atol=1e-9)
    assert np.abs(first.object_acceleration - ma.evaluate(system).object_acceleration).max() > 0.1


def test_inverse_dynamics_carries_the_loads_on_object_and_links(rng):
    """Torques of a wanted motion make that motion, with everything that acts from outside."""
    effects = {
        "drag": {"linear": 30.0, "wind": [1.0, 2.0, -1.0]},
        "external_wrenches": [
            {"on": "object", "force": [20.0, 5, -8], "at": [0.2, 0, 0]},
            {"on": "right/forearm_link", "torque": [3.0, 4, 5]},
        ],
    }
    system = ma.compile_system(ur5_pair({"kind": "weld"}, {"kind": "weld"}, effects=effects))
    wanted = rng.standard_normal(6)
    found = ma.inverse_dynamics(system, system.initial_state(), wanted)
    driven = ma.evaluate(system.with_control(lambda t, state: found.torques))
    np.testing.assert_allclose(driven.object_acceleration, wanted, atol=1e-8)


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_residuals_know_the_loads(solver):
    effects = {"external_wrenches": [{"on": "object", "force": [50.0, 20.0, 5.0]}]}
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, effects=effects)
    found = ma.evaluate(ma.compile_system(scene).with_solver(solver)).residuals
    assert max(found.arm, found.object, found.constraint) < 1e-7


def test_loads_on_links_cost_no_call_of_pinocchio(monkeypatch):
    counts: dict[str, int] = {}

    def counted(name):
        function = getattr(pin, name)

        def call(*arguments):
            counts[name] = counts.get(name, 0) + 1
            return function(*arguments)

        return call

    names = ("crba", "nonLinearEffects", "computeGeneralizedGravity", "forwardKinematics")
    for name in names:
        monkeypatch.setattr(multiarm.robots.backends.pin, name, counted(name))
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    wrench = {"on": "left/forearm_link", "force": [0.0, 0.0, 1e-9]}
    effects = {
        "external_wrenches": [wrench], "drag": {"linear": 1e-9}, "rotor_inertia": 1e-9,
        "joint_friction": 1e-9,
    }  # fmt: skip
    found = []
    for own in ({}, effects):
        counts.clear()
        system = ma.compile_system(scene.replace(effects=own))
        ma.simulate(system, duration=0.1, integrator="rk4", step=0.01)
        found.append(dict(counts))
    assert found[0] == found[1] and found[0]["crba"] > 40


# --- functions -----------------------------------------------------------------------------------


def with_function(carried, function):
    return carried({"external_wrenches": [{"on": "object", "function": function}]})


@pytest.mark.parametrize(
    "answer",
    [
        [1.0, 2.0],
        None,
        "north",
        [0, 0, 0, 0, 0, math.nan],
    ],
)
def test_unusable_answers_are_told(carried, answer):
    system = with_function(carried, lambda t, state: answer)
    with refused(ControlError, "external_wrenches[0]"):
        ma.evaluate(system)


def test_an_exception_on_the_way_ends_the_run_with_what_there_is(carried):
    def breaks(t, state):
        if t > 0.05:
            raise ValueError("out of paper")
        return np.zeros(6)

    run = ma.simulate(with_function(carried, breaks), duration=0.2, **TIGHT)
    assert run.status == "failed" and len(run) >= 5
    assert "the function of external_wrenches[0] raised ValueError: out of paper" in run.message


def test_a_function_cannot_evaluate_the_system_that_it_is_part_of(carried):
    def asks(t, state):
        ma.evaluate(holder[0], t, state)
        return np.zeros(6)

    holder = [with_function(carried, asks)]
    with refused(ControlError, "external_wrenches[0]"):
        ma.evaluate(holder[0])


def test_a_function_is_asked_about_the_state_itself_where_motions_cross():
    """Without one, states before and behind are evaluated too."""
    asked = []

    def watch(t, state):
        asked.append(state.position.copy())
        return np.zeros(6)

    scene = compiled("four_bar").scene
    wrenches = [{"on": "object", "function": watch}]
    system = ma.compile_system(scene.replace(effects={"external_wrenches": wrenches}))
    state = state_on("four_bar", math.pi + 1e-4, 6.0)
    data_of(system).set_state(0.0, state)
    assert evaluate_on_branch(data_of(system).struct, 1e-13, False, 0.0, 0.0) == OK
    assert asked
    for position in asked:
        np.testing.assert_array_equal(position, state.position)


def test_a_function_that_remembers_gets_no_certificate(carried):
    noise = np.random.default_rng(1)
    noisy = with_function(carried, lambda t, state: [1 + 1e-3 * noise.random(), 0, 0, 0, 0, 0])
    run = ma.simulate(noisy, duration=0.1, integrator="dopri5", accuracy=1e-2)
    assert run.certificate["reason"] == "memory" and not run.certificate["met"]
    assert "the function of external_wrenches[0] answers otherwise" in run.certificate["text"]
    steady = with_function(carried, lambda t, state: [math.sin(t), 0, 0, 0, 0, 0])
    assert ma.simulate(steady, duration=0.1, accuracy=1e-6).certificate["met"]


def test_sudden_forces_of_a_function_are_not_stepped_over(carried):
    """As with controllers, steps are no longer than the time between samples."""

    def hit(t, state):
        return [100.0 if 0.501 < t < 0.502 else 0.0, 0, 0, 0, 0, 0]

    run = ma.simulate(
        with_function(carried, hit), duration=1.0, accuracy=1e-6, output_step=1e-3,
        certificate=False,
    )  # fmt: skip
    assert run.statistics["largest_step_s"] <= 1.0001e-3
    assert velocity(run)[-1, 0] == pytest.approx(0.1 / MASSES[0], rel=1e-3)


def test_functions_are_found_beside_the_scene(tmp_path):
    (tmp_path / "push.py").write_text("def push(t, state):\n    return [t, 0, 0, 0, 0, 0]\n")
    (tmp_path / "gantry.urdf").write_text(slides())
    text = """
object: {shape: {sphere: 0.1}, mass: 1.0}
arms: {a: {urdf: gantry.urdf, tip: tip}}
joints: [{arm: a, kind: weld}]
effects: {external_wrenches: [{on: object, function: "push.py:push"}]}
"""
    (tmp_path / "scene.yaml").write_text(text)
    scene = ma.load_scene(tmp_path / "scene.yaml")
    assert scene.effects.external_wrenches[0].function == f"{tmp_path}/push.py:push"
    found = ma.evaluate(ma.compile_system(scene), 2.0)
    assert found.object_acceleration[0] == pytest.approx(2.0 / MASSES[0], abs=1e-12)
    missing = text.replace("push:push", "push:pull").replace("py:push", "py:pull")
    (tmp_path / "scene.yaml").write_text(missing)
    with refused(ModelError, "'pull'"):
        ma.compile_system(ma.load_scene(tmp_path / "scene.yaml"))
