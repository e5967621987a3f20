"""Claims about systems whose arms are compiled: the same motion, and nothing enters Python."""

from __future__ import annotations

import json
import warnings

import event_scenes as events
import numpy as np
import pytest
from commands import figures, multiarm
from event_scenes import ball, ball_on_plate, run
from mechanics import (
    PANDA_FINGERS,
    PANDA_POSTURE,
    UR5_POSTURE,
    data_of,
    panda_trio,
    random_state,
    scene_of,
    two_arm_block,
    ur5_pair,
)
from refusals import refused
from repository import SCENES

import multiarm as ma
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import potential_energy
from multiarm.errors import ModelError, SceneError
from multiarm.jit.pointers import PythonCallback
from multiarm.problems import ring_of_arms
from multiarm.robots.compiled import backend as compiled_backend

WELD, BALL = {"kind": "weld"}, {"kind": "ball"}
SWING = {
    "kind": "harmonic",
    "amplitude": {"left": [3.0] * 6, "right": [2.0, -3.0, 2.0, 1.0, 1.0, 1.0]},
    "frequency": 1.5,
}
# What two sums of the same numbers in another order may differ by, after a second of motion.
SAME = 1e-11


def pair(**more):
    return ur5_pair(WELD, BALL, **more)


def three_kinds(**more):
    """A Panda between two UR5s: arms of unlike length, in an order that no sorting keeps."""
    ur5 = {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE}
    arms = {
        "left": {**ur5, "base": {"xyz": [-1.1, 0, 0]}},
        "middle": {
            "robot": "panda", "tip": "panda_hand_tcp", "posture": PANDA_POSTURE,
            "lock": PANDA_FINGERS, "base": {"xyz": [0, -0.9, 0], "rpy": [0, 0, 1.5]},
        },
        "right": {**ur5, "base": {"xyz": [1.1, 0, 0], "rpy": [0, 0, np.pi]}},
    }  # fmt: skip
    return scene_of(arms, [{"arm": name, "kind": "ball"} for name in arms], **more)


def systems(scene, control=None):
    """The scene with Pinocchio's arms and with compiled ones."""
    found = [ma.compile_system(scene, control, arms=arms) for arms in ("pinocchio", "compiled")]
    assert set(found[1].arm_terms.values()) == {"compiled"} and not found[1].not_compiled
    return found


def assert_same(one: ma.Trajectory, other: ma.Trajectory, tolerance: float = SAME) -> None:
    """Every channel of two runs, relative to what is largest in it, at least to 1."""
    assert one.status == other.status == "completed", (one.message, other.message)
    assert len(one) == len(other)
    for name in one.channels:
        if name.startswith("solver/"):
            continue
        a, b = one.channel(name), other.channel(name)
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        scale = max(1.0, float(np.nanmax(np.abs(a), initial=0.0)))
        apart = float(np.nanmax(np.abs(a - b), initial=0.0))
        assert apart <= tolerance * scale, (name, apart, scale)


# --- evaluations ---------------------------------------------------------------------------------

SCENES_OF_ALL_KINDS = {
    "pair": pair,
    "three kinds": three_kinds,
    "block": two_arm_block,
    "pandas": lambda **more: panda_trio({"kind": "revolute"}, **more),
    "ring": lambda **more: ring_of_arms(9, "weld").replace(**more),
    "without gravity": lambda **more: pair(gravity=None, **more),
    "rotors": lambda **more: pair(effects={"rotor_inertia": 0.7}, **more),
}


@pytest.mark.parametrize("kind", SCENES_OF_ALL_KINDS)
@pytest.mark.parametrize("solver", ["node", "dense"])
def test_evaluations_are_the_same(kind, solver, rng):
    two = [s.with_solver(solver) for s in systems(SCENES_OF_ALL_KINDS[kind]())]
    state = random_state(two[0], rng)
    one, other = (ma.evaluate(system, 0.3, state) for system in two)
    scale = np.max(np.abs(one.object_acceleration)) + 1.0
    np.testing.assert_allclose(
        other.object_acceleration, one.object_acceleration, atol=1e-10 * scale
    )
    for name in two[0].arm_names:
        a, b = one.joint_accelerations[name], other.joint_accelerations[name]
        np.testing.assert_allclose(b, a, atol=1e-10 * (1.0 + np.max(np.abs(a))))
        a, b = one.contact_forces[name], other.contact_forces[name]
        np.testing.assert_allclose(b, a, atol=1e-10 * (1.0 + np.max(np.abs(a))))
    pinocchio, compiled = (potential_energy(data_of(system).struct) for system in two)
    assert compiled == pytest.approx(pinocchio, rel=1e-12)
    assert (pinocchio == 0.0) == (kind == "without gravity")


# --- trajectories --------------------------------------------------------------------------------

METHODS = {
    "accuracy": {"accuracy": 1e-7},
    "dop853": {"integrator": "dop853", "tolerance": 1e-8, "stabilization": "none"},
    "dopri5": {"integrator": "dopri5", "tolerance": 1e-7},
    "rodas5p": {"integrator": "rodas5p", "tolerance": 1e-7},
    "rk4": {"integrator": "rk4", "step": 1e-3, "stabilization": "feedback"},
    "euler": {"integrator": "semi_implicit_euler", "step": 1e-3},
    "variational": {"integrator": "variational", "step": 1e-3},
    "dense": {"integrator": "rk4", "step": 2e-3, "solver": "dense"},
}


@pytest.mark.parametrize("method", METHODS)
def test_trajectories_are_the_same_with_every_method(method):
    two = systems(pair(control=SWING))
    # a method that factors differences of accelerations multiplies what they differ by
    tolerance = 1e-9 if method == "rodas5p" else SAME
    runs = [ma.simulate(system, 0.2, certificate=False, **METHODS[method]) for system in two]
    assert_same(*runs, tolerance)
    assert runs[0].statistics["steps"] == runs[1].statistics["steps"]


CONTROLS = {
    "constant": {"kind": "constant", "torques": {"left": [2.0] * 6, "right": [-1.0] * 6}},
    "gravity compensation": {"kind": "gravity_compensation"},
    "joint pd": {"kind": "joint_pd", "stiffness": 20.0, "damping": 1.0},
    "computed torque": {
        "kind": "computed_torque",
        "path": [{"time": 0.2, "xyz": [0, 0.02, 0.55], "rpy": [0, 0.1, 0.2]}],
    },
    "impedance": {
        "kind": "object_impedance",
        "stiffness": {"translation": 900.0, "rotation": 100.0},
        "damping": {"translation": 300.0, "rotation": 30.0},
    },
}


@pytest.mark.parametrize("law", CONTROLS)
@pytest.mark.parametrize("build", [pair, three_kinds])
def test_trajectories_are_the_same_under_every_control(law, build):
    two = systems(build(control=CONTROLS[law]))
    assert_same(*(ma.simulate(system, 0.2, integrator="rk4", step=1e-3) for system in two))


EFFECTS = {
    "joints": {"joint_damping": 2.0, "joint_friction": 1.0},
    "actuators": {"torque_limits": "urdf", "actuator_lag": 0.01},
    "drag": {"drag": {"linear": 5.0}},
    "loads": {
        "external_wrenches": [
            {"on": "object", "force": [30.0, 0, 10.0]},
            {"on": "left/forearm_link", "at": [0.1, 0, 0.2], "force": [10.0, 20.0, 5.0]},
            {"on": "right/upper_arm_link", "torque": [1, 2, 3], "axes": "body"},
        ]
    },
}  # fmt: skip


@pytest.mark.parametrize("effect", EFFECTS)
@pytest.mark.parametrize("build", [pair, three_kinds])
def test_trajectories_are_the_same_with_effects(effect, build):
    two = systems(build(effects=EFFECTS[effect], control=SWING))
    assert_same(*(ma.simulate(system, 0.2, integrator="rk4", step=1e-3) for system in two))


@pytest.mark.slow
def test_a_controller_in_python_drives_them_alike():
    def control(t, state):
        return {"left": np.full(6, np.sin(9 * t)), "right": -2.0 * state.joint_velocities["right"]}

    two = systems(pair(), control)
    assert_same(*(ma.simulate(system, 0.2, integrator="rk4", step=1e-3) for system in two))


EVENT_SCENES = {
    "a bouncing ball": lambda: ball_on_plate(
        events.arm("z"), ball(height=0.1), restitution=0.5, control={"kind": "gravity_compensation"}
    ),
    "a ball on hinges": lambda: ball_on_plate(
        events.arm("YX", posture=[0.05, 0.02]), ball(height=0.02), mu=0.3,
        control={"kind": "joint_pd", "stiffness": 100.0, "damping": 5.0},
    ),
    "a box on the floor": lambda: events.on_floor(events.box(height=0.05), mu=0.4),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("kind", EVENT_SCENES)
def test_events_happen_at_the_same_times(kind):
    scene = EVENT_SCENES[kind]()
    found = [run(_with_arms(scene, arms), 0.4) for arms in ("pinocchio", "compiled")]
    assert [e["kind"] for e in found[0].events] == [e["kind"] for e in found[1].events]
    assert len(found[0].events) > 0
    times = [np.array([e["time"] for e in r.events]) for r in found]
    np.testing.assert_allclose(times[1], times[0], atol=1e-9)
    assert_same(*found, 1e-8)


def _with_arms(scene, arms: str):
    return scene.replace(run=scene.run.model_copy(update={"arms": arms}))


def test_certificates_are_the_same():
    runs = [ma.simulate(system, 0.3, accuracy=1e-6) for system in systems(pair(control=SWING))]
    assert all(r.certificate["met"] for r in runs)
    assert_same(*runs)


# --- Python stays out ----------------------------------------------------------------------------


@pytest.fixture
def entered(monkeypatch):
    """Names of the functions in Python that compiled code has called."""
    names: list[str] = []
    begin = PythonCallback.__init__

    def counting(self, function, status):
        def counted():
            names.append(function.__qualname__)
            function()

        begin(self, counted, status)

    monkeypatch.setattr(PythonCallback, "__init__", counting)
    return names


@pytest.mark.slow
@pytest.mark.parametrize("method", [m for m in METHODS if m != "dense"])
def test_a_run_of_compiled_arms_enters_python_never(method, entered):
    scene = pair(control=CONTROLS["joint pd"], effects={**EFFECTS["joints"], **EFFECTS["loads"]})
    system = ma.compile_system(scene, arms="compiled")
    data = data_of(system)
    functions = data.arrays.functions
    assert functions.pinocchio == functions.pinocchio_energy == 0 and functions.robots != 0
    lazy = {"coupled", "decomposed", "solve_again", "near_singular", "general_rows", "command"}
    assert set(data.callbacks) == {"dense", *lazy}
    ma.simulate(system, 0.1, certificate=False, **METHODS[method])
    assert entered == []
    for name in lazy:  # none was called: all still stand in
        assert getattr(functions, name) == data.callbacks[name].address


def test_pinocchios_arms_are_counted(entered):
    system = ma.compile_system(pair(control=SWING))
    ma.simulate(system, 0.1, integrator="rk4", step=1e-2)
    assert len(entered) > 40


@pytest.mark.slow
def test_a_run_with_events_enters_python_never(entered):
    for build in EVENT_SCENES.values():
        assert run(_with_arms(build(), "compiled"), 0.3).status == "completed"
    assert entered == []


def test_scenes_without_compiled_arms_have_nothing_of_them():
    functions = data_of(ma.compile_system(pair())).arrays.functions
    assert functions.robots == 0 and functions.pinocchio != 0


# --- mixed systems -------------------------------------------------------------------------------


@pytest.fixture(params=[6, 7], ids=["panda stays", "all compiled"])
def mixed(request, monkeypatch):
    """Function ``scene, control -> system``, in which arms of more joints stay with Pinocchio."""

    def build(scene, control=None):
        monkeypatch.setattr(compiled_backend, "MOST_JOINTS", request.param)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ma.compile_system(scene, control, arms="compiled")

    return build


@pytest.mark.slow
@pytest.mark.parametrize("law", CONTROLS)
def test_mixed_systems_move_like_those_of_one_kind(law, mixed):
    scene = three_kinds(control=CONTROLS[law], effects=EFFECTS["loads"])
    one, other = ma.compile_system(scene), mixed(scene)
    assert_same(*(ma.simulate(system, 0.2, integrator="rk4", step=1e-3) for system in (one, other)))


@pytest.mark.parametrize("method", ["rodas5p", "variational", "dense"])
def test_mixed_systems_move_alike_with_other_methods(method, mixed):
    scene = three_kinds(control=SWING)
    one, other = ma.compile_system(scene), mixed(scene)
    options = {"certificate": False, **METHODS[method]}
    tolerance = 1e-9 if method == "rodas5p" else SAME
    assert_same(*(ma.simulate(system, 0.1, **options) for system in (one, other)), tolerance)


@pytest.mark.parametrize("compiled_ones", [(), (0,), (1,), (2,), (0, 2), (0, 1), (1, 2)])
def test_any_arm_may_be_the_one_that_stays(compiled_ones, monkeypatch, rng):
    """Groups of Pinocchio's have neighbours only; their places are those of the scene."""
    structure, numbers = compiled_backend._structure, {"left": 0, "middle": 1, "right": 2}

    def some(arm):
        if numbers[arm.name] not in compiled_ones:
            raise ModelError("it was told so")
        return structure(arm)

    scene = three_kinds(effects=EFFECTS["loads"], control={"kind": "gravity_compensation"})
    whole = ma.compile_system(scene)
    monkeypatch.setattr(compiled_backend, "_structure", some)
    with pytest.warns(UserWarning, match="stays with Pinocchio: it was told so"):
        system = ma.compile_system(scene, arms="compiled")
    assert [k for k, w in enumerate(system.arm_terms.values()) if w == "compiled"] == list(
        compiled_ones
    )
    state = random_state(whole, rng)
    one, other = (ma.evaluate(s, 0.0, state).object_acceleration for s in (whole, system))
    np.testing.assert_allclose(other, one, atol=1e-10 * np.max(np.abs(one)))
    own, theirs = data_of(system), data_of(whole)
    own, theirs = data_of(system), data_of(whole)
    energy = potential_energy(theirs.struct)
    assert potential_energy(own.struct) == pytest.approx(energy, rel=1e-12)
    other = Data(system.model)
    assert other.arrays.bodies.pointers.shape == own.arrays.bodies.pointers.shape
    assert not set(other.arrays.bodies.pointers[:, 0]) & set(
        own.arrays.bodies.pointers[:, 0].tolist()
    )


def test_an_arm_that_stays_says_so(monkeypatch):
    monkeypatch.setattr(compiled_backend, "MOST_JOINTS", 6)
    reason = "it has 7 joints between base and a link; at most 6 are compiled"
    with pytest.warns(UserWarning, match=f"arm 'middle' stays with Pinocchio: {reason}") as told:
        system = ma.compile_system(three_kinds(), arms="compiled")
    assert len(told) == 1
    terms = {"left": "compiled", "middle": "pinocchio", "right": "compiled"}
    assert system.arm_terms == terms and system.not_compiled == {"middle": reason}
    trajectory = ma.simulate(system, 0.05, integrator="rk4", step=1e-2)
    assert trajectory.statistics["arms"] == terms
    assert trajectory.statistics["not_compiled"] == {"middle": reason}


# --- what a user sees ----------------------------------------------------------------------------


def test_the_scene_says_who_computes_the_arms(tmp_path):
    assert pair().run.arms == "pinocchio"
    assert ma.compile_system(pair()).arm_terms == {"left": "pinocchio", "right": "pinocchio"}
    system = ma.compile_system(_with_arms(pair(), "compiled"))
    assert system.arm_terms == {"left": "compiled", "right": "compiled"}
    back = ma.compile_system(system.scene, arms="pinocchio")
    assert set(back.arm_terms.values()) == {"pinocchio"} and back.scene.run.arms == "pinocchio"
    out = tmp_path / "run.h5"
    ma.simulate(system, 0.05, integrator="rk4", step=1e-2, out=out)
    loaded = ma.load_trajectory(out)
    assert loaded.scene.run.arms == "compiled"
    assert loaded.statistics["arms"] == {"left": "compiled", "right": "compiled"}


def test_an_unknown_word_is_refused_with_the_alternatives():
    with refused(ModelError, "'numba'"):
        ma.compile_system(pair(), arms="numba")
    with refused(SceneError, "$.run.arms"):
        pair(run={"arms": "numba"})


@pytest.mark.slow
def test_run_and_check_take_the_choice(tmp_path):
    scene = SCENES / "two_ur5_box.yaml"
    result = multiarm(
        "run", scene, "--arms", "compiled", "--duration", 0.05, "--no-certificate",
        "--out", tmp_path / "run.h5", "--json", tmp_path / "run.json",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert set(json.loads((tmp_path / "run.json").read_text())["arms"].values()) == {"compiled"}
    assert "arms compiled" in result.stdout
    result = multiarm("check", scene, "--arms", "compiled", "--json", tmp_path / "check.json")
    assert result.exit_code == 0, result.output
    arms = figures(tmp_path / "check.json")["arms"]
    assert {arm["terms"] for arm in arms.values()} == {"compiled"}
    assert {arm["not_compiled"] for arm in arms.values()} == {None}
    assert "compiled code, verified against Pinocchio" in result.stdout


def test_check_says_why_an_arm_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled_backend, "MOST_JOINTS", 5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = multiarm("check", SCENES / "two_ur5_box.yaml", "--arms", "compiled")
    assert result.exit_code == 0, result.output
    assert "it has 6 joints" in " ".join(result.stdout.split())


def test_a_copy_that_is_not_the_arm_ends_the_compilation(monkeypatch):
    make = compiled_backend.make_tables

    def wrong(*arguments):
        tables = make(*arguments)
        tables.constants[tables.constants.size // 2] += 0.1
        return tables

    monkeypatch.setattr(compiled_backend, "make_tables", wrong)
    with refused(ModelError, "arm 'left'"):
        ma.compile_system(pair(), arms="compiled")


def test_a_wrong_coriolis_matrix_is_refused_when_it_is_needed(monkeypatch):
    from multiarm.robots.compiled.backend import CompiledBackend

    system = ma.compile_system(pair(), arms="compiled")
    terms = CompiledBackend.terms
    monkeypatch.setattr(
        CompiledBackend,
        "terms",
        lambda self, arm: (found := terms(self, arm))._replace(coriolis=1.001 * found.coriolis),
    )
    ma.simulate(system, 0.01, integrator="rk4", step=1e-3)
    with refused(ModelError, "arm 'left'"):
        ma.simulate(system, 0.01, integrator="variational", step=1e-3)
