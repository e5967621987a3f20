"""Claims about what joints and drives do: damping, friction, rotors, torque limits, lag.

Most of them have closed forms on a sledge of 3 kg that carries an object of 1 kg along a rail.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import (
    chain_urdf,
    data_of,
    project_velocity,
    random_state,
    scene_of,
    single_arm,
    sledge_urdf,
    ur5_pair,
)
from random_scenes import random_scene
from refusals import refused

import multiarm as ma
from multiarm.dynamics.arrays import EFFECTS
from multiarm.dynamics.contact_geometry import block_inertias
from multiarm.errors import SceneError

MASS = 4.0  # [kg] sledge and object
TIGHT = {"accuracy": 1e-9, "output_step": 0.01, "certificate": False}


@pytest.fixture
def sledge(tmp_path):
    """Compiles the sledge with some effects, control and speed."""

    def build(effects: dict, speed: float = 0.0, mass: float = 3.0, **more):
        urdf = tmp_path / f"sledge_{mass}.urdf"
        urdf.write_text(sledge_urdf(mass))
        arm = {"urdf": str(urdf), "tip": "tip", "posture": [0.0], "velocity": [speed]}
        body = {"shape": {"box": [0.1, 0.1, 0.1]}, "mass": 1.0, "twist": [speed, 0, 0, 0, 0, 0]}
        joint = {"arm": "a", "kind": "weld"}
        scene = scene_of({"a": arm}, [joint], object=body, gravity=None, effects=effects, **more)
        return ma.compile_system(scene)

    return build


def push(force: float) -> dict:
    return {"kind": "constant", "torques": {"a": force}}


def speed_of(run) -> np.ndarray:
    return run.joint_velocities["a"][:, 0]


# --- damping and friction ------------------------------------------------------------------------


@pytest.mark.parametrize("written", [0.8, {"a": 0.8}, {"a": {"rail": 0.8}}, "urdf", {"a": "urdf"}])
def test_damping_brings_a_sledge_to_rest_exponentially(sledge, written):
    run = ma.simulate(sledge({"joint_damping": written}, 2.0), duration=5.0, **TIGHT)
    wanted = 2.0 * np.exp(-0.8 * run.time / MASS)
    np.testing.assert_allclose(speed_of(run), wanted, atol=1e-8)
    lost = 0.5 * MASS * (wanted**2 - wanted[0] ** 2)
    np.testing.assert_allclose(run.effect_works["joint_damping"], lost, atol=1e-7)


@pytest.mark.parametrize("written", [0.6, "urdf", {"torque": {"a": "urdf"}, "model": "smooth"}])
def test_smooth_friction_slows_a_sledge_by_its_closed_form(sledge, written):
    """``m v' = -c tanh(v/s)`` has ``sinh(v/s) = sinh(v_0/s) exp(-c t / (m s))``."""
    c, s, v0 = 0.6, 0.01, 0.2
    run = ma.simulate(sledge({"joint_friction": written}, v0), duration=1.6, **TIGHT)
    wanted = s * np.arcsinh(np.sinh(v0 / s) * np.exp(-c * run.time / (MASS * s)))
    assert wanted[-1] < 1e-3 < 0.1 < wanted[50]
    np.testing.assert_allclose(speed_of(run), wanted, atol=1e-8)
    lost = 0.5 * MASS * (speed_of(run) ** 2 - v0**2)
    np.testing.assert_allclose(run.effect_works["joint_friction"], lost, atol=1e-8)


def test_smooth_friction_creeps_under_a_load_that_it_could_hold(sledge):
    system = sledge({"joint_friction": {"torque": 2.0, "speed": 0.05}}, control=push(1.5))
    run = ma.simulate(system, duration=6.0, **TIGHT)
    assert speed_of(run)[-1] == pytest.approx(0.05 * math.atanh(1.5 / 2.0), abs=1e-8)


def test_friction_at_rest_is_none_and_never_exceeds_its_torque(rng):
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    plain = ma.compile_system(scene)
    rough = ma.compile_system(scene.replace(effects={"joint_friction": {"torque": 3.0}}))
    rest = rough.initial_state()
    np.testing.assert_array_equal(
        ma.evaluate(plain, 0.0, rest).object_acceleration,
        ma.evaluate(rough, 0.0, rest).object_acceleration,
    )
    state = random_state(rough, rng, turn=0.0)
    ma.evaluate(plain, 0.0, state)
    before = data_of(plain).arrays.forces.f_j.copy()
    ma.evaluate(rough, 0.0, state)
    added = data_of(rough).arrays.forces.f_j - before
    np.testing.assert_allclose(added, -3.0 * np.tanh(state.velocity[6:] / 0.01), atol=1e-12)


def test_model_based_control_compensates_what_the_joints_do(rng):
    """Computed torque moves the object as it wants, whatever the friction."""
    control = {
        "kind": "computed_torque",
        "stiffness": {"translation": 50.0, "rotation": 50.0},
        "damping": {"translation": 15.0, "rotation": 15.0},
    }
    effects = {"joint_friction": 4.0, "joint_damping": 2.0, "rotor_inertia": 0.3}
    plain = ur5_pair({"kind": "weld"}, {"kind": "weld"}, control=control)
    systems = [ma.compile_system(s) for s in (plain, plain.replace(effects=effects))]
    state = project_velocity(systems[0], random_state(systems[0], rng, turn=0.0))
    first, second = (ma.evaluate(system, 0.0, state) for system in systems)
    np.testing.assert_allclose(first.object_acceleration, second.object_acceleration, atol=1e-9)
    assert np.abs(first.joint_torques["left"] - second.joint_torques["left"]).max() > 1.0


def test_set_valued_friction_is_not_the_smooth_one(sledge):
    system = sledge({"joint_friction": {"torque": 0.6, "model": "set_valued"}})
    assert "add_joint_friction" not in {
        p.kernel.__name__ for p in system.model.effects.kernels if p.kernel
    }


# --- rotors --------------------------------------------------------------------------------------


def test_a_rotor_moves_a_sledge_like_as_much_mass(sledge):
    rotor = sledge({"rotor_inertia": {"a": 1.7}}, control=push(2.0))
    heavy = sledge({}, mass=4.7, control=push(2.0))
    light = sledge({}, control=push(2.0))
    first, second, third = (ma.simulate(s, duration=1.0, **TIGHT) for s in (rotor, heavy, light))
    np.testing.assert_allclose(speed_of(first), 2.0 * first.time / (MASS + 1.7), atol=1e-10)
    np.testing.assert_allclose(first.kinetic_energy, second.kinetic_energy, atol=1e-10)
    assert speed_of(third)[-1] > 1.2 * speed_of(first)[-1]


def chain_with_disc(tmp_path, disc: float):
    """A chain whose first link has a disc about the axis of the first joint, which is z."""
    path = tmp_path / f"chain_{disc}.urdf"
    path.write_text(chain_urdf("zxy").replace("izz='0.01'", f"izz='{0.01 + disc}'", 1))
    return str(path)


def test_a_rotor_of_the_first_joint_is_a_disc_on_its_link(tmp_path, rng):
    """... in motion with gravity, for accelerations and energy."""
    scenes = []
    for disc, effects in ((0.4, {}), (0.0, {"rotor_inertia": {"arm": {"joint_1": 0.4}}})):
        body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 2.0}
        arm = {"urdf": chain_with_disc(tmp_path, disc), "tip": "tip", "posture": [0.3, 0.5, -0.4]}
        joint = {"arm": "arm", "kind": "weld"}
        scenes.append(scene_of({"arm": arm}, [joint], object=body, effects=effects))
    disc, rotor = (ma.compile_system(scene) for scene in scenes)
    state = project_velocity(disc, random_state(disc, rng, turn=0.0))
    first, second = (ma.evaluate(system, 0.0, state) for system in (disc, rotor))
    np.testing.assert_allclose(
        first.joint_accelerations["arm"], second.joint_accelerations["arm"], rtol=1e-9
    )
    q, v = state.joint_positions["arm"], state.joint_velocities["arm"]
    M = [system.arms["arm"].terms(q, v).M for system in (disc, rotor)]
    np.testing.assert_allclose(*M, atol=1e-13)
    runs = [ma.simulate(s, duration=0.4, state=state, **TIGHT) for s in (disc, rotor)]
    np.testing.assert_allclose(*(run.kinetic_energy for run in runs), atol=1e-8)
    np.testing.assert_allclose(runs[1].energy_balance, 0.0, atol=1e-7)


def test_inverse_dynamics_turns_the_rotors_too():
    scene = ur5_pair({"kind": "weld"}, {"kind": "weld"})
    plain = ma.compile_system(scene)
    rotors = ma.compile_system(scene.replace(effects={"rotor_inertia": 0.5}))
    wanted = np.array([0.3, -0.2, 0.4, 0.1, 0.5, -0.3])
    state = plain.initial_state()
    first, second = (ma.inverse_dynamics(s, state, wanted) for s in (plain, rotors))
    for arm in plain.arm_names:
        added = second.torques[arm] - first.torques[arm]
        np.testing.assert_allclose(added, 0.5 * second.joint_accelerations[arm], atol=1e-9)


def test_rotors_of_arms_in_several_pinocchio_models_stay_with_their_arms(monkeypatch):
    import multiarm.robots.backends

    monkeypatch.setattr(multiarm.robots.backends, "ROBOTS_PER_GROUP", 1)
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"})
    system = ma.compile_system(scene.replace(effects={"rotor_inertia": {"right": 0.7}}))
    plain = ma.compile_system(scene)
    for s in (system, plain):
        ma.evaluate(s)
    added = np.subtract(block_inertias(data_of(system)), block_inertias(data_of(plain)))
    np.testing.assert_allclose(added[0], 0.0, atol=1e-14)
    np.testing.assert_allclose(added[1], 0.7 * np.eye(6), atol=1e-14)


# --- torque limits -------------------------------------------------------------------------------

SWING = {"kind": "harmonic", "frequency": 0.5, "amplitude": {"a": 10.0}, "hold": False}


def test_limits_cut_the_command_off_and_tell_when(sledge):
    run = ma.simulate(sledge({"torque_limits": 6.0}, control=SWING), duration=2.0, **TIGHT)
    wanted = np.clip(10.0 * np.sin(math.pi * run.time), -6.0, 6.0)
    np.testing.assert_allclose(run.joint_torques["a"][:, 0], wanted, atol=1e-9)
    # the impulse of half a swing: two flanks and a plateau
    first = math.asin(0.6) / math.pi
    impulse = 2 * 10.0 * (1 - math.cos(math.pi * first)) / math.pi + 6.0 * (1 - 2 * first)
    assert speed_of(run)[100] == pytest.approx(impulse / MASS, abs=1e-8)
    told = [e for e in run.events if e["kind"] in ("saturates", "is no longer saturated")]
    kinds = [e["kind"] for e in told]
    assert kinds == ["saturates", "is no longer saturated"] * 2
    assert all(e["arm"] == "a" and e["joint"] == "rail" for e in told)
    times = [first, 1 - first, 1 + first, 2 - first]
    np.testing.assert_allclose([e["time"] for e in told], times, atol=5e-3)
    assert "drives came to their torque limits: a: rail" in run.message


def test_limits_of_the_urdf_are_the_arms_own(sledge):
    system = sledge({"torque_limits": "urdf"}, control=push(9.0))
    run = ma.simulate(system, duration=0.1, **TIGHT)
    assert np.all(run.joint_torques["a"] == 7.0) and system.arms["a"].effort_limits == [7.0]
    assert [e["time"] for e in run.events if e["kind"] == "saturates"] == [0.0]
    later = ma.simulate(system, duration=0.1, start_time=5.0, **TIGHT)
    assert [e["time"] for e in later.events if e["kind"] == "saturates"] == [5.0]


def test_joints_that_are_not_named_are_not_limited():
    control = {"kind": "constant", "torques": {"left": 500.0, "right": -500.0}}
    limits = {"left": {"elbow_joint": 20.0}}
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=control)
    found = ma.evaluate(ma.compile_system(scene.replace(effects={"torque_limits": limits})))
    assert found.joint_torques["left"].tolist() == [500.0, 500.0, 20.0, 500.0, 500.0, 500.0]
    assert found.joint_torques["right"].tolist() == [-500.0] * 6


def test_a_controller_in_python_is_limited_like_a_built_in_one(sledge):
    system = sledge({"torque_limits": 6.0}, control=SWING)
    python = ma.simulate(
        system, duration=1.0, control=lambda t, _: {"a": [10 * math.sin(math.pi * t)]}, **TIGHT
    )
    built_in = ma.simulate(system, duration=1.0, **TIGHT)
    np.testing.assert_allclose(speed_of(python), speed_of(built_in), atol=1e-8)


# --- lag -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", [None, "dopri5", "dop853", "rodas5p", "rk4"])
def test_a_lagging_drive_answers_a_step_exponentially(sledge, integrator):
    T, f = 0.2, 3.0
    lag = {"time_constant": T, "start": "zero"}
    system = sledge({"actuator_lag": lag}, control=push(f))
    chosen = {"accuracy": 1e-9}
    if integrator == "rk4":
        chosen = {"integrator": "rk4", "step": 1e-3}
    elif integrator:
        chosen = {"integrator": integrator, "tolerance": 1e-10}
    run = ma.simulate(system, duration=1.0, output_step=0.01, certificate=False, **chosen)
    rise = 1.0 - np.exp(-run.time / T)
    np.testing.assert_allclose(run.joint_torques["a"][:, 0], f * rise, atol=1e-8)
    np.testing.assert_allclose(speed_of(run), f / MASS * (run.time - T * rise), atol=1e-8)
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-8)


def test_drives_start_at_the_command_when_nothing_else_is_said(sledge):
    system = sledge({"actuator_lag": 0.2}, control=push(3.0))
    run = ma.simulate(system, duration=0.5, **TIGHT)
    np.testing.assert_allclose(run.joint_torques["a"], 3.0, atol=1e-12)
    assert ma.evaluate(system).joint_torques["a"] == [3.0]
    zero = sledge({"actuator_lag": {"time_constant": 0.2, "start": "zero"}}, control=push(3.0))
    assert ma.evaluate(zero).joint_torques["a"] == [0.0]


def test_limits_act_on_the_command_before_the_lag(sledge):
    T = 0.1
    effects = {"torque_limits": 2.0, "actuator_lag": {"time_constant": T, "start": "zero"}}
    run = ma.simulate(sledge(effects, control=push(3.0)), duration=0.5, **TIGHT)
    wanted = 2.0 * (1.0 - np.exp(-run.time / T))
    np.testing.assert_allclose(run.joint_torques["a"][:, 0], wanted, atol=1e-8)


def test_only_joints_with_a_time_constant_lag():
    lag = {"time_constant": {"left": {"elbow_joint": 0.1}, "right": [0, 0, 0, 0.2, 0, 0]}}
    control = {"kind": "constant", "torques": {"left": 5.0, "right": 5.0}}
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}, control=control)
    system = ma.compile_system(scene.replace(effects={"actuator_lag": {**lag, "start": "zero"}}))
    assert system.model.effects.states == 2
    found = ma.evaluate(system).joint_torques
    assert found["left"].tolist() == [5.0, 5.0, 0.0, 5.0, 5.0, 5.0]
    assert found["right"].tolist() == [5.0, 5.0, 5.0, 0.0, 5.0, 5.0]


def test_a_system_without_control_forgets_the_lag_of_one_that_has(sledge):
    system = sledge({"actuator_lag": 0.2})
    driven = system.with_control(lambda t, _: {"a": [math.sin(9 * t)]})
    ma.simulate(driven, duration=0.1, **TIGHT)
    run = ma.simulate(system, duration=0.1, **TIGHT)
    assert np.all(run.joint_torques["a"] == 0.0) and np.all(speed_of(run) == 0.0)


@pytest.mark.parametrize("method", ["dopri5", "rodas5p"])
def test_states_of_effects_keep_a_methods_order(sledge, method):
    """Two lagging springs: errors at fixed steps fall with the order, the torques' too."""
    control = {"kind": "joint_pd", "stiffness": 90.0, "damping": 3.0}
    lag = {"actuator_lag": {"time_constant": 0.15, "start": "zero"}}
    system = sledge(lag, 1.0, control=control)
    errors, steps = [], [0.05, 0.025, 0.0125]
    # torque tau, position x, speed v: a linear system, exact by its matrix exponential
    A = np.array([[0, 1, 0], [0, 0, 1 / MASS], [-90 / 0.15, -3 / 0.15, -1 / 0.15]])
    values, vectors = np.linalg.eig(A)
    exact = (vectors @ np.diag(np.exp(values)) @ np.linalg.solve(vectors, [0.0, 1.0, 0.0])).real
    for h in steps:
        run = ma.simulate(
            system, duration=1.0, integrator=method, tolerance=1e3, max_step=h, output_step=1.0
        )
        got = [run.joint_positions["a"][-1, 0], speed_of(run)[-1], run.joint_torques["a"][-1, 0]]
        errors.append(np.abs(np.array(got) - exact))
        assert run.statistics["steps"] == round(1.0 / h)
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all(slopes > 4.6) and np.all(slopes < 6.5)


def test_the_variational_method_refuses_states_that_it_does_not_know(sledge):
    run = {"integrator": "variational", "step": 0.01}
    system = sledge({"actuator_lag": 0.1})
    with refused(SceneError, "'dop853'"):
        ma.simulate(system, duration=0.1, **run)
    with refused(SceneError, "$.run.integrator"):
        system.scene.replace(run={"duration": 0.1, **run})
    damped = sledge({"joint_damping": 0.8, "joint_friction": 0.6}, 1.0)
    assert ma.simulate(damped, duration=0.1, **run).status == "completed"


# --- all together --------------------------------------------------------------------------------

ALL = {
    "joint_damping": 0.7,
    "joint_friction": {"torque": 0.5, "speed": 0.1},
    "rotor_inertia": 0.05,
    "torque_limits": 60.0,
    "actuator_lag": 0.04,
    "drag": {"linear": 1.0, "quadratic": [1, 2, 3], "angular": 0.2, "wind": [1.0, 0, 0.5]},
    "external_wrenches": [
        {"on": "object", "force": [3, 0, 1], "sinusoid": {"frequency": 1.5}},
        {"on": "object", "torque": [0, 2, 0], "pulse": {"begin": 0.06, "end": 0.11}},
    ],
}


@pytest.mark.parametrize("seed", range(4))
def test_random_scenes_with_all_effects_balance_their_energy(seed):
    scene = random_scene(np.random.default_rng(seed)).replace(effects=ALL)
    run = ma.simulate(ma.compile_system(scene), duration=0.25, accuracy=1e-8, certificate=False)
    assert run.status == "completed", run.message
    works = run.effect_works
    assert set(works) == {"joint_damping", "joint_friction", "drag", "external_wrenches"}
    exchanged = sum(np.ptp(work) for work in works.values()) + np.ptp(run.work)
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-6 * max(1.0, exchanged))
    assert all(np.all(np.diff(works[name]) <= 0.0) for name in ("joint_damping", "joint_friction"))


def test_a_run_with_all_effects_is_as_accurate_as_asked():
    system = ma.compile_system(
        ur5_pair({"kind": "weld"}, {"kind": "ball"}, effects=ALL, control={"kind": "none"})
    )
    control = {"kind": "joint_pd", "stiffness": 300.0, "damping": 20.0}
    system = ma.compile_system(system.scene.replace(control=control))
    run = ma.simulate(system, duration=0.3, accuracy=1e-5)
    assert run.certificate["met"], run.certificate["text"]
    exact = ma.simulate(system, duration=0.3, accuracy=1e-10, certificate=False)
    assert np.abs(run.object_position - exact.object_position).max() <= 1e-5


def test_each_effect_alone_adds_what_it_adds_to_all(rng):
    """Right-hand sides of the node system add up, but for the drives, which act on each other."""
    scene = single_arm("ur5", "tool0", [0.1, -1.0, 1.2, 0.3, 0.4, 0.5], {"kind": "ball"})
    names = ("joint_damping", "joint_friction", "drag", "external_wrenches")
    state = random_state(ma.compile_system(scene), rng, turn=0.0)

    def right_hand_sides(effects):
        system = ma.compile_system(scene.replace(effects=effects))
        ma.evaluate(system, 0.07, state)
        return np.concatenate(
            [data_of(system).arrays.forces.f_o, data_of(system).arrays.forces.f_j]
        )

    nothing = right_hand_sides({})
    alone = [right_hand_sides({name: ALL[name]}) - nothing for name in names]
    together = right_hand_sides({name: ALL[name] for name in names}) - nothing
    assert all(np.abs(part).max() > 0.1 for part in alone)
    np.testing.assert_allclose(together, sum(alone), atol=1e-11)


def test_a_scene_without_effects_has_nothing_of_them(sledge):
    system = sledge({})
    assert system.model.constants.effects.size == 0 and data_of(system).effects == []
    assert data_of(system).struct.size == 4 * EFFECTS
    assert (
        data_of(system).arrays.effects.states.size == 0
        and data_of(system).arrays.effects.power.size == 1
    )
    assert not system.model.guards
