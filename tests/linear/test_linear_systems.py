"""Claims about linearised systems: minimal coordinates, modes, equilibria.

The independent answers are closed forms (a sledge on a spring, a pendulum on a cart, the poles that
a control law asks for), differences of evaluations on the joints, and simulated motions.
"""

from __future__ import annotations

import json
import math
from typing import NamedTuple

import numpy as np
import pytest
from commands import multiarm
from mechanics import (
    difference,
    moved_state,
    over_floor,
    planar_pair,
    random_state,
    scene_of,
    sledge_urdf,
    ur5_pair,
)
from random_scenes import random_scene
from refusals import refused
from repository import SCENES
from scipy.linalg import expm, solve_continuous_are
from scipy.optimize import brentq
from user_classes import empty_registries

import multiarm as ma
from multiarm.assembly.start import project_start
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.effect_kernels import (
    ACTUATOR,
    EffectKernel,
    first_state,
    view_of_effect,
)
from multiarm.errors import ModelError, SolverError
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Float, Floats1, struct_at
from multiarm.linear import equilibrium as equilibrium_module
from multiarm.linear.equilibrium import _Search
from multiarm.linear.modes_trajectory import modes_trajectory
from multiarm.problems import HARD_CASES
from multiarm.problems.loops import bricard_motion

G = 9.81
CART, BOB, LEVER, TURNING = 3.0, 2.0, 0.4, 0.05  # [kg, kg, m, kg m^2]


@pytest.fixture
def cart(tmp_path):
    """Compiles a sledge along x from which a body hangs by a hinge, or stands on it."""
    urdf = tmp_path / "sledge.urdf"
    urdf.write_text(sledge_urdf(CART))

    def build(axis="y", upright=False, kind="revolute", at=0.0, **more):
        arm = {"urdf": str(urdf), "tip": "tip", "posture": [at]}
        up = 1.0 if upright else -1.0
        body = {
            "shape": {"box": [0.1, 0.1, 0.1]}, "mass": BOB, "inertia": [TURNING] * 3,
            "pose": {"xyz": [at, 0, up * LEVER]},
        }  # fmt: skip
        rpy = [-math.pi / 2, 0, 0] if axis == "y" else [0, math.pi / 2, 0]
        joint = {
            "arm": "a",
            "kind": kind,
            "at": {"xyz": [0, 0, -up * LEVER], "rpy": rpy},
            "at_tip": {"rpy": rpy},
        }
        return ma.compile_system(scene_of({"a": arm}, [joint], object=body, **more))

    return build


def eigenvalues(linear) -> np.ndarray:
    return np.sort_complex(np.linalg.eigvals(linear.A))


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("lag", [None, 0.03])
def test_a_sledge_on_a_spring(cart, lag):
    """``(M + m) s^2 + c s + k``, with a lag ``T s`` more: what textbooks write."""
    k, c = 500.0, 20.0
    control = {"kind": "joint_pd", "stiffness": k, "damping": c}
    effects = {} if lag is None else {"actuator_lag": lag}
    linear = ma.linearise(cart(kind="weld", control=control, effects=effects))
    whole = [CART + BOB, c, k]
    if lag is not None:
        whole = [lag * (CART + BOB), CART + BOB, c, k]
    np.testing.assert_allclose(eigenvalues(linear), np.sort_complex(np.roots(whole)), rtol=1e-9)
    gain = linear.C[0] @ np.linalg.solve(-linear.A, linear.B[:, 0])
    assert gain == pytest.approx(1.0 / k, rel=1e-9)
    assert linear.stability == "stable" and linear.controllable
    slow = linear.modes[0] if lag is None else next(m for m in linear.modes if m.frequency)
    if lag is None:
        assert slow.natural_frequency == pytest.approx(math.sqrt(k / (CART + BOB)))
        assert slow.damping_ratio == pytest.approx(c / (2.0 * math.sqrt(k * (CART + BOB))))
    held = ma.linearise(cart(kind="weld", control=control, effects=effects), closed_loop=False)
    assert {mode.kind for mode in held.modes} <= {"drifts", "decays"}
    if lag is not None:  # the drive's torque, which goes to the one that is held, moves the cart
        open_loop = [[0, 1, 0], [0, 0, 1.0 / (CART + BOB)], [0, 0, -1.0 / lag]]
        np.testing.assert_allclose(held.A, open_loop, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("upright", [False, True])
def test_a_pendulum_on_a_cart(cart, upright):
    """R. Murray's and K. Astrom's example: poles of a body on a cart that rolls freely."""
    system = cart(upright=upright)
    linear = ma.linearise(system)
    J = TURNING + BOB * LEVER**2
    mu = (CART + BOB) * J - (BOB * LEVER) ** 2
    square = BOB * G * LEVER * (CART + BOB) / mu
    found = [mode for mode in linear.modes if mode.kind != "drifts"]
    if upright:
        values = sorted(mode.eigenvalue.real for mode in found)
        np.testing.assert_allclose(values, [-math.sqrt(square), math.sqrt(square)], rtol=1e-9)
        assert linear.stability == "unstable"
    else:
        assert [mode.kind for mode in found] == ["oscillates for ever"]
        assert found[0].frequency == pytest.approx(math.sqrt(square) / (2.0 * math.pi), rel=1e-9)
        assert linear.stability == "undecided", "the cart may roll away"
    assert linear.controllable
    # a force on the cart moves the cart by J / mu
    force = (
        linear.B[linear.state_names.index("object/x'")] if "object/x'" in linear.state_names else 0
    )
    by_cart = linear.C[linear.output_names.index("a/rail'")] @ linear.B
    assert by_cart == pytest.approx(J / mu, rel=1e-9) and force is not None


@pytest.mark.parametrize("drag", [0.0, 3.0])
def test_what_swings_across_the_cart_is_not_reached(cart, drag):
    effects = {"drag": {"linear": [drag] * 3}} if drag else {}
    linear = ma.linearise(cart(axis="x", effects=effects))
    swing = next(mode for mode in linear.modes if mode.frequency)
    J = TURNING + BOB * LEVER**2
    assert swing.natural_frequency == pytest.approx(math.sqrt(BOB * G * LEVER / J), rel=1e-9)
    assert swing.eigenvalue.real == pytest.approx(-0.5 * drag * LEVER**2 / J, rel=1e-9, abs=1e-9)
    assert not swing.controllable and not linear.controllable
    assert "object/turn_x" in swing.moving


def test_poles_are_those_that_the_control_asks_for():
    """Computed torque makes every motion that torques reach ``s^2 + 20 s + 100``."""
    linear = ma.linearise(ma.compile_system(ma.load_scene(SCENES / "corner_grippers_block.yaml")))
    np.testing.assert_allclose(
        linear.A @ linear.A + 20.0 * linear.A, -100.0 * np.eye(len(linear.A)), atol=1e-4
    )
    assert {mode.kind for mode in linear.modes} == {"decays"} and linear.stability == "stable"
    assert all(mode.time_constant == pytest.approx(0.1, rel=1e-3) for mode in linear.modes)


@pytest.mark.slow
def test_bricards_loop_swings_as_its_closed_form():
    """``omega^2 = V'' / A`` where V is least: one freedom of six hinges, with dependent rows."""
    loop = bricard_motion()
    system = ma.compile_system(HARD_CASES["bricard"].scene())
    found = ma.find_equilibrium(system)
    low, high = loop.span
    places = np.linspace(low, high, 4001)[:-1]
    least = min(places, key=lambda s: loop.inertia_and_potential(s)[1])
    bottom = brentq(lambda s: loop.series(s)[2], least - 0.01, least + 0.01, xtol=1e-14)
    h = 1e-4
    curvature = (loop.series(bottom + h)[2] - loop.series(bottom - h)[2]) / (2.0 * h)
    (swing,) = found.linear.modes
    assert swing.kind == "oscillates for ever"
    omega = math.sqrt(curvature / loop.inertia_and_potential(bottom)[0])
    assert swing.natural_frequency == pytest.approx(omega, rel=1e-7)
    middle = loop.centres(2, np.array([bottom]))[0]
    np.testing.assert_allclose(found.state.object_position, middle, atol=1e-9)


# --- differences on the joints --------------------------------------------------------------------


def rates(linear, state) -> np.ndarray:
    """``y'`` at a state on the joints, by the velocities there and an evaluation."""
    h, p = 1e-6, len(linear.coordinates.positions)
    system = linear.system
    ahead, behind = (linear.coordinates_of(moved_state(system, state, step)) for step in (h, -h))
    accelerations = ma.evaluate(system, 0.0, state).accelerations
    chosen = accelerations[list(linear.coordinates.velocities)]
    return np.concatenate([(ahead - behind)[:p] / (2.0 * h), chosen])


BALL, SPRING = {"kind": "ball"}, {"kind": "joint_pd", "stiffness": 200, "damping": 20}
ON_JOINTS = {
    "weld and ball": lambda: ur5_pair({"kind": "weld"}, BALL),
    "balls, closed loop": lambda: ur5_pair(BALL, BALL, control=SPRING),
    "hinge and slide": lambda: ur5_pair({"kind": "revolute"}, {"kind": "cylindrical"}),
    "dependent constraints": lambda: planar_pair("planar_3r", [0.4, 0.7, -0.5], {"kind": "weld"}),
    "rolling": lambda: ma.load_scene(SCENES / "corner_grippers_block.yaml"),
}  # fmt: skip


@pytest.mark.parametrize("name", ON_JOINTS)
def test_the_matrix_is_that_of_differences_on_the_joints(name, rng):
    """Moving states, so that the joints' own rates count."""
    system = ma.compile_system(ON_JOINTS[name]())
    with system.borrow() as data:
        wild = random_state(system, rng, turn=0.0 if "rolling" in name else 0.05, speed=0.4)
        state = project_start(data, system.scene, wild)[0]
    linear = ma.linearise(system, 0.0, state)
    np.testing.assert_allclose(rates(linear, state), linear.rate, atol=1e-7)
    size = len(linear.A)
    assert size == len(linear.coordinates.positions) + len(linear.coordinates.velocities)
    for _ in range(6):
        y = rng.standard_normal(size)
        direction = difference(lambda h, y=y: linear.coordinates_of(linear.state_at(h * y)))
        np.testing.assert_allclose(direction, y, atol=1e-6)
        found = difference(lambda h, y=y: rates(linear, linear.state_at(h * y)))
        np.testing.assert_allclose(linear.A @ direction, found, rtol=3e-6, atol=3e-6)


def test_contacts_that_touch_stay_closed():
    linear = ma.linearise(over_floor(0.0))
    assert not {"object/z", "object/turn_x", "object/turn_y"} & set(linear.state_names)
    assert len(linear.A) == 2 * 6, "three of the box on the floor, three of the ball's arm"


# --- motions --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_small_motion_is_that_of_the_linear_system(rng):
    """Frequencies, decay and shapes at once: a second of a damped pair of arms."""
    control = {"kind": "joint_pd", "stiffness": 200, "damping": 2}
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL, control=control))
    linear = ma.linearise(system)
    assert np.abs(linear.rate).max() < 1e-9, "gravity is compensated"
    size = 1e-6
    start = linear.state_at(size * rng.standard_normal(len(linear.A)))
    run = ma.simulate(system, 1.0, state=start, output_step=0.25, accuracy=1e-10)
    y0 = linear.coordinates_of(start)
    for k, t in enumerate(run.time):
        now = system.state(
            run.object_position[k], run.object_quaternion_xyzw[k],
            {arm: q[k] for arm, q in run.joint_positions.items()},
            run.object_twist[k], {arm: v[k] for arm, v in run.joint_velocities.items()},
        )  # fmt: skip
        expected = expm(linear.A * t) @ y0
        tolerance = 1e-4 * np.abs(expected).max()
        np.testing.assert_allclose(linear.coordinates_of(now), expected, atol=tolerance)


@pytest.mark.slow
def test_a_regulator_balances_the_pendulum(cart):
    """With the feedback of an LQR the upright pendulum comes back from a push."""
    system = cart(upright=True)
    linear = ma.linearise(system)
    X = solve_continuous_are(linear.A, linear.B, 100.0 * np.eye(4), np.eye(1))
    K = linear.B.T @ X
    closed = system.with_control(lambda t, state: {"a": -K @ linear.coordinates_of(state)})
    pushed = linear.state_at([0.05, 0.0, 0.0, 0.0])
    run = ma.simulate(closed, 12.0, state=pushed, accuracy=1e-6, certificate=False)
    assert run.status == "completed", run.message
    away = np.linalg.norm(run.object_position - linear.state.object_position, axis=1)
    assert away[-1] < 1e-3 < 0.03 < away.max()
    near = ma.linearise(closed)
    np.testing.assert_allclose(near.A, linear.A - linear.B @ K, atol=1e-6 * np.abs(near.A).max())


# --- equilibria -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_springs_under_a_load_come_to_rest_where_the_search_ends():
    """The end of a long damped run is an equilibrium that shares nothing with the search."""
    load = {"external_wrenches": [{"on": "object", "force": [0, 300, -200], "torque": [20, 0, 0]}]}
    control = {"kind": "joint_pd", "stiffness": 1500, "damping": 400}
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL, control=control, effects=load))
    found = ma.find_equilibrium(system)
    lagging = ma.compile_system(system.scene.replace(effects={**load, "actuator_lag": 0.02}))
    same = ma.find_equilibrium(lagging)
    assert same.steps == found.steps, "torques that lag are those at rest"
    np.testing.assert_allclose(same.state.position, found.state.position, atol=1e-9)
    assert found.stability == "stable" and found.steps < 15 and found.acceleration < 1e-9
    run = ma.simulate(system, 12.0, accuracy=1e-7, certificate=False, integrator="rodas5p")
    np.testing.assert_allclose(found.state.object_position, run.object_position[-1], atol=1e-6)
    assert np.linalg.norm(run.object_position[0] - run.object_position[-1]) > 0.01
    for arm, q in found.state.joint_positions.items():
        np.testing.assert_allclose(q, run.joint_positions[arm][-1], atol=1e-6)


def soft_scene(seed):
    """Arms drawn at random whose servos are soft springs, with a weight and a load."""
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    stiffness = float(10.0 ** rng.uniform(0.5, 2.5))
    compensated, load = bool(rng.random() < 0.2), {}
    if rng.random() < 0.5:
        wrench = {"force": rng.uniform(-60, 60, 3), "torque": rng.uniform(-8, 8, 3)}
        load["external_wrenches"] = [{"on": "object"} | {k: v.tolist() for k, v in wrench.items()}]
    control = {
        "kind": "joint_pd", "stiffness": stiffness, "damping": 5.0,
        "gravity_compensation": compensated,
    }  # fmt: skip
    return scene.replace(control=control, effects=load, gravity=[0, 0, -9.81])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1017, 1022, 1034])
def test_a_minimum_of_the_potential_is_found_where_accelerations_have_others(seed):
    """Each joint has a spring, so that there is one; accelerations alone lead elsewhere here."""
    system = ma.compile_system(soft_scene(seed))
    least = _Search(ma.linearise(system), 0.0)
    least.run(1e-9)
    assert least.here.largest_acceleration > 1.0
    found = ma.find_equilibrium(system)
    assert found.stability == "stable" and found.acceleration < 1e-9
    # a push, much damped, comes back
    pushed = found.linear.state_at(1e-3 * np.ones(len(found.linear.A)))
    damped = ma.compile_system(
        system.scene.replace({"control.damping": 60.0, "effects.joint_damping": 20.0})
    )
    run = ma.simulate(damped, 30.0, state=pushed, accuracy=1e-6, certificate=False)
    away = np.abs(run.object_position[[0, -1]] - found.state.object_position).max(axis=1)
    assert run.status == "completed" and away[1] < 0.1 * away[0] + 1e-6


def test_a_search_that_ends_too_early_claims_nothing_of_what_is_elsewhere(monkeypatch):
    monkeypatch.setattr(equilibrium_module, "MOST_STEPS", 2)
    with pytest.raises(SolverError, match="is not known"):
        ma.find_equilibrium(ma.compile_system(soft_scene(1034)))


def test_a_force_without_a_spring_drives_on_without_end(cart):
    system = cart(kind="weld", control={"kind": "constant", "torques": {"a": 3.0}})
    with pytest.raises(SolverError, match="drive the system on without end"):
        ma.find_equilibrium(system)


@pytest.mark.parametrize("upright", [False, True])
def test_a_tilted_pendulum_finds_the_equilibrium_on_its_side(cart, upright):
    linear = ma.linearise(cart(upright=upright))
    tilted = linear.state_at(0.3 * (np.arange(4) == linear.state_names.index("object/turn_y")))
    found = ma.find_equilibrium(linear.system, tilted)
    turn = abs(found.state.object_quaternion_xyzw[1])
    assert turn < 1e-9 and found.stability == ("unstable" if upright else "undecided")


def test_drives_that_do_not_start_at_rest_are_refused(cart):
    lag = {"actuator_lag": {"time_constant": 0.03, "start": "zero"}}
    system = cart(kind="weld", control={"kind": "constant", "torques": {"a": 3.0}}, effects=lag)
    assert ma.linearise(system).rate[-1] == pytest.approx(3.0 / 0.03)
    with refused(SolverError, "`start: command`"):
        ma.find_equilibrium(system)


class Pump(NamedTuple):
    parts: Floats1  # two parts of its pressure
    time_constant: Float


open_pump = view_of_effect(Pump)


@cfunc
def leaking_pressure(address, size, at, _t):
    """A pump whose pressure leaks."""
    struct = struct_at(address, size)
    data, pump, state = open_data(struct), open_pump(struct, at), first_state(struct, at)
    data.control.torque[0] += data.effects.states[state]
    pressure = pump.parts[0] + pump.parts[1]
    data.effects.state_rates[state] = (pressure - data.effects.states[state]) / pump.time_constant
    return 0


class LeakingCylinder(ma.Effect):
    name = "leaking_cylinder"

    class Spec(ma.Effect.Spec):
        start: float

    def build(self, context):
        more = {"states": 1, "start": lambda arrays: np.array([self.spec.start]), "works": False}
        pump = Pump(np.array([0.1, 0.2]), 0.05)
        return [EffectKernel(self.name, leaking_pressure, ACTUATOR, pump, **more)]


def test_states_of_own_effects_may_start_at_rest_but_for_roundings(cart, monkeypatch):
    """0.1 + 0.2 is not 0.3: the rates are those of a rounding; the spring takes the 0.3 N."""
    empty_registries(monkeypatch)
    ma.register_effect(LeakingCylinder)
    control = {"kind": "joint_pd", "stiffness": 500.0, "damping": 20.0}
    for start, rests in ((0.3, True), (0.3 + 1e-6, False)):
        effects = {"leaking_cylinder": {"start": start}}
        system = cart(kind="weld", control=control, effects=effects)
        assert ma.linearise(system).rate[-1] != 0.0
        if rests:
            found = ma.find_equilibrium(system)
            assert found.state.joint_positions["a"][0] == pytest.approx(0.3 / 500.0, rel=1e-9)
            assert found.stability == "stable"
        else:
            with refused(SolverError, "effects"):
                ma.find_equilibrium(system)


def test_given_torques_hold_a_posture():
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL))
    squeeze = 40.0 * np.eye(system.constraint_count - 6)[0]
    held = ma.inverse_dynamics(system, system.initial_state(), np.zeros(6), internal_forces=squeeze)
    found = ma.find_equilibrium(system, torques=held.torques)
    assert found.steps == 0 and found.acceleration < 1e-10
    for arm, torques in held.torques.items():
        np.testing.assert_allclose(found.torques[arm], torques)
    hanging = ma.find_equilibrium(system, torques={})
    low, high = (state.object_position[2] for state in (hanging.state, system.initial_state()))
    assert low < high - 0.1 and hanging.stability != "unstable", "arms without torques hang down"
    with refused(ModelError, "'third'"):
        ma.find_equilibrium(system, torques={"third": [0.0]})


# --- what is shown, and to whom -------------------------------------------------------------------


def test_the_system_goes_to_scipy_with_its_names(cart):
    linear = ma.linearise(cart())
    whole = linear.to_scipy()
    assert whole.A.shape == (4, 4) and whole.D.shape == (len(linear.output_names), 1)
    some = linear.to_scipy(outputs=["object/z", "a/rail"])
    np.testing.assert_array_equal(some.C[1], linear.C[linear.output_names.index("a/rail")])
    with refused(SolverError, "'a/railing'"):
        linear.to_scipy(outputs=["a/railing"])
    # forces: the weight at rest, to first order unchanged by a swing
    force = [name for name in linear.output_names if name.endswith("/force")]
    assert len(force) == 5 and np.isfinite(linear.C).all() and np.isfinite(linear.D).all()


def test_the_system_goes_to_the_package_control(cart):
    control = pytest.importorskip("control")
    linear = ma.linearise(cart())
    found = linear.to_control(inputs=["a/rail/torque"], outputs=["a/rail"])
    assert isinstance(found, control.StateSpace) and found.output_labels == ["a/rail"]
    assert linear.to_control(inputs=[]).input_labels == []
    np.testing.assert_allclose(np.sort_complex(control.poles(found)), eigenvalues(linear))


@pytest.mark.slow
def test_modes_move_on_the_joints():
    system = ma.compile_system(ur5_pair({"kind": "weld"}, BALL, control=SPRING))
    linear = ma.linearise(system)
    shown = modes_trajectory(linear, modes=[1, 3], amplitude=0.05)
    assert shown.status == "completed" and shown.position_drift.max() < 1e-10
    assert [event["text"][:7] for event in shown.events] == ["mode 1:", "mode 3:"]
    moved = np.concatenate(
        [shown.object_position - shown.object_position[0],
         *(q - q[0] for q in shown.joint_positions.values())], axis=1,
    )  # fmt: skip
    assert 0.03 < np.abs(moved).max() < 0.06
    assert "damping ratio" in shown.events[0]["text"]
    for wrong in ({"modes": [99]}, {"modes": []}, {"amplitude": 0.0}):
        with refused(SolverError, *wrong):
            modes_trajectory(linear, **wrong)
    shown = modes_trajectory(linear, modes=[1], amplitude=1e-7)
    assert 1e-8 < np.ptp(shown.object_position, axis=0).max() < 1e-6
    assert shown.message.startswith("1 mode, ")


@pytest.mark.slow
def test_the_command_shows_modes_and_writes_them(tmp_path):
    out, page = tmp_path / "modes.json", tmp_path / "modes.html"
    scene = SCENES / "two_ur5_box.yaml"
    done = multiarm("modes", scene, "--equilibrium", "--json", out, "--replay-html", page)
    assert done.exit_code == 0, done.output
    assert "stability" in done.output and "Hz" in done.output
    found = json.loads(out.read_text(encoding="utf-8"))
    assert found["stability"] == "stable" and len(found["A"]) == len(found["states"]) == 12
    assert found["largest_acceleration"] < 1e-8 and page.stat().st_size > 1e5
    falling = multiarm("modes", SCENES / "ring_ball.yaml")
    assert falling.exit_code == 0 and "is no equilibrium" in " ".join(falling.output.split())


def test_what_is_no_system_is_said():
    with refused(ModelError, "ma.linearise"):
        ma.linearise("scene")
    with refused(ModelError, "ma.find_equilibrium"):
        ma.find_equilibrium(None)
