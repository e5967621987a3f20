"""Claims about effects of one's own: what they do to a motion, how they are found and refused."""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
import pytest
from object_scenes import DOWN, double_pendulum
from refusals import refused
from repository import ROOT, SCENES
from user_classes import empty_registries, offered

import multiarm as ma
from multiarm.dynamics.status import SINGULAR
from multiarm.effects import APPLIED, EffectKernel
from multiarm.effects.defaults import defaults
from multiarm.errors import SolverError
from multiarm.jit.interpretation import INTERPRETED
from multiarm.jit.kernels import cfunc, kernel
from multiarm.jit.pointers import CFUNC
from multiarm.jit.structs import Floats1, Ints1
from multiarm.scene import EFFECTS, dump_scene, parse_scene, with_code

RING = parse_scene((SCENES / "ring_weld.yaml").read_text(), SCENES)


@pytest.fixture(autouse=True)
def _only_ours(monkeypatch):
    empty_registries(monkeypatch)


def effect_of(function, name: str = "push", **body) -> type[ma.Effect]:
    """A registered effect without parameters that calls ``function(t, state)``."""
    body = {"name": name, "forces": lambda self, t, state: function(t, state), **body}
    return ma.register_effect(type(name.title(), (ma.Effect,), body))


class Spring(ma.Effect):
    """Pulls the object to the world's origin."""

    name = "spring"

    class Spec(ma.Effect.Spec):
        """Parameters."""

        stiffness: float
        label: str = "soft"

    def forces(self, t, state):
        """A linear force."""
        return ma.Loads(object_wrench=[*(-self.spec.stiffness * state.object_position), 0, 0, 0])


# --- mechanics ------------------------------------------------------------------------------------


def test_gravity_written_as_an_effect_moves_everything_as_gravity_does():
    heavy = ma.compile_system(RING.replace(control={"kind": "none"}))
    assert any(RING.gravity)

    def weights(_t, state):
        torques = {
            name: -arm.gravity_torque(state.joint_positions[name], np.array(RING.gravity))
            for name, arm in heavy.arms.items()
        }
        weight = RING.object.mass * np.array(RING.gravity)
        return ma.Loads([*weight, 0.0, 0.0, 0.0], torques)

    effect_of(weights)
    scene = heavy.scene.replace(gravity=None, effects={"push": {}})
    exact, found = (ma.simulate(s, 0.3) for s in (heavy, ma.compile_system(scene)))
    assert np.ptp(exact.object_position, axis=0).max() > 1e-3, "it falls"
    assert found.object_position == pytest.approx(exact.object_position, abs=1e-7)
    fallen = exact.potential_energy[0] - exact.potential_energy
    assert found.channel("effects/push/work") == pytest.approx(fallen, abs=1e-6)


def test_torques_of_an_effect_act_as_those_of_a_controller():
    names = list(RING.arms)
    torques = {names[0]: [1.0, -2.0, 3.0, 0.5, -0.5, 0.2]}
    effect_of(lambda _t, _state: ma.Loads(joint_torques=torques))
    driven = RING.replace(control={"kind": "constant", "torques": torques})
    pushed = RING.replace(control={"kind": "none"}, effects={"push": {}})
    a, b = (ma.evaluate(ma.compile_system(scene)) for scene in (driven, pushed))
    free = ma.evaluate(ma.compile_system(RING.replace(control={"kind": "none"})))
    assert np.abs(a.object_acceleration - free.object_acceleration).max() > 0.1
    assert a.object_acceleration == pytest.approx(b.object_acceleration, rel=1e-12)
    for arm in names:
        assert a.joint_accelerations[arm] == pytest.approx(b.joint_accelerations[arm], rel=1e-11)
    assert all(np.all(torque == 0.0) for torque in b.joint_torques.values())


def hanging(effects: dict | None = None, **more) -> ma.System:
    """Two objects that hang from each other, and from the world."""
    scene = double_pendulum([0.4, -0.9], [1.1, -0.6]) | {"effects": effects or {}} | more
    return ma.compile_system(parse_scene(scene))


def test_wrenches_by_name_act_on_the_objects_as_their_weights_do():
    heavy = hanging()
    masses = {name: body.mass for name, body in heavy.scene.all_objects.items()}
    weights = {name: [*(mass * np.array(DOWN)), 0, 0, 0] for name, mass in masses.items()}
    effect_of(lambda _t, _state: ma.Loads(object_wrenches=weights))
    expected, pushed = ma.evaluate(heavy), ma.evaluate(hanging({"push": {}}, gravity=None))
    for name, acceleration in expected.object_accelerations.items():
        assert np.abs(acceleration).max() > 1.0
        assert pushed.object_accelerations[name] == pytest.approx(acceleration, abs=1e-11)


def test_the_only_object_may_be_named():
    wrench = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    loads = [ma.Loads(wrench)]
    effect_of(lambda _t, _state: loads[-1])
    system = ma.compile_system(RING.replace(effects={"push": {}}))
    expected = ma.evaluate(system).object_acceleration
    loads.append(ma.Loads(object_wrenches={"object": wrench}))
    np.testing.assert_array_equal(ma.evaluate(system).object_acceleration, expected)


@pytest.mark.slow
def test_the_recorded_work_is_that_of_wrench_and_torques_along_the_motion():
    arm = next(iter(RING.arms))

    def loads(t, state):
        spin = state.object_twist[3:]
        return ma.Loads(
            [3.0 * np.sin(5.0 * t), 0.0, 1.0, *(-0.2 * spin), ],
            {arm: -0.3 * state.joint_velocities[arm]},
        )  # fmt: skip

    effect_of(loads)
    system = ma.compile_system(RING.replace(effects={"push": {}}))
    run = ma.simulate(system, 0.4, output_step=1e-3)
    power = []
    for k in range(len(run)):
        state = system.state(
            object_twist=run.object_twist[k],
            joint_velocities={name: run.joint_velocities[name][k] for name in run.arm_names},
        )
        given = loads(run.time[k], state)
        power.append(
            np.dot(given.object_wrench, state.object_twist)
            + np.dot(given.joint_torques[arm], state.joint_velocities[arm])
        )
    steps = 0.5 * (np.array(power[1:]) + np.array(power[:-1])) * np.diff(run.time)
    work = run.channel("effects/push/work")
    assert np.abs(work).max() > 1e-3
    assert work[1:] == pytest.approx(np.cumsum(steps), abs=1e-5 * np.abs(work).max() + 1e-6)
    assert np.abs(run.energy_balance).max() < 1e-5 * np.abs(run.kinetic_energy).max()


def test_a_time_that_an_effect_is_shown_is_the_run_s():
    seen = []
    effect_of(lambda t, _state: seen.append(t) or ma.Loads())
    ma.simulate(ma.compile_system(RING.replace(effects={"push": {}})), 0.05)
    assert seen[0] == 0.0
    assert max(seen) == pytest.approx(0.05)


def test_an_effect_cannot_change_the_state_that_it_is_shown():
    def greedy(_t, state):
        state.position[:] = 7.0
        state.velocity[:] = 7.0
        return ma.Loads()

    effect_of(greedy)
    a = ma.evaluate(ma.compile_system(RING))
    b = ma.evaluate(ma.compile_system(RING.replace(effects={"push": {}})))
    assert np.array_equal(a.object_acceleration, b.object_acceleration)


# --- what goes wrong in an effect -----------------------------------------------------------------


@pytest.mark.parametrize(
    "function",
    [
        lambda t, s: 1 / 0,
        lambda t, s: None,
        lambda t, s: ma.Loads([1.0, 2.0]),
        lambda t, s: ma.Loads(["a"] * 6),
        lambda t, s: ma.Loads([np.nan] * 6),
        lambda t, s: ma.Loads(joint_torques={"rigth": [0.0]}),
        lambda t, s: ma.Loads(joint_torques={"arm0": [0.0]}),
        lambda t, s: ma.Loads(joint_torques=[0.0]),
        lambda t, s: ma.Loads(object_wrenches=[0.0] * 6),
        lambda t, s: ma.Loads(object_wrenches={"beam": [0.0] * 6}),
    ],
)
def test_what_an_effect_must_not_return_is_one_clear_error(function):
    effect_of(function)
    scene = RING.replace(effects={"push": {}})
    with refused(ma.MultiarmError, "'push'"):
        ma.simulate(ma.compile_system(scene), 0.1)


@pytest.mark.parametrize(
    "loads",
    [
        ma.Loads([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        ma.Loads(object_wrenches={"uper": [0.0] * 6}),
        ma.Loads(object_wrenches={"upper": [0.0]}),
    ],
)
def test_wrenches_on_several_objects_name_them(loads):
    effect_of(lambda _t, _state: loads)
    with refused(ma.MultiarmError, "'push'", "object_wrench"):
        ma.evaluate(hanging({"push": {}}))


def test_torques_by_number_are_refused_where_there_are_no_robots():
    effect_of(lambda _t, _state: ma.Loads(joint_torques=[0.0]))
    with refused(ma.MultiarmError, "'push'", "joint_torques"):
        ma.evaluate(hanging({"push": {}}, robots={}))


def test_an_effect_that_fails_on_the_way_ends_the_run_with_what_was_recorded():
    def late(t, _state):
        if t > 0.05:
            raise RuntimeError("out of order")
        return ma.Loads()

    effect_of(late)
    run = ma.simulate(ma.compile_system(RING.replace(effects={"push": {}})), 0.1)
    assert run.status == "failed"
    assert "the effect 'push' raised RuntimeError: out of order" in run.message
    assert 0.0 < run.time[-1] < 0.06


def test_a_system_that_failed_in_an_effect_works_again():
    broken = [True]

    def sometimes(_t, _state):
        if broken[0]:
            raise RuntimeError("not now")
        return ma.Loads()

    effect_of(sometimes)
    system = None
    with refused(ma.MultiarmError, "effect 'push'"):
        system = ma.compile_system(RING.replace(effects={"push": {}}))
        ma.evaluate(system)
    assert system is not None
    broken[0] = False
    assert np.all(np.isfinite(ma.evaluate(system).object_acceleration))


def test_an_effect_may_not_evaluate_the_system_that_runs():
    effect_of(lambda _t, _state: ma.evaluate(systems[0]) and ma.Loads())
    systems = [ma.compile_system(RING.replace(effects={"push": {}}))]
    with refused(ma.MultiarmError, "effect 'push'"):
        ma.evaluate(systems[0])


# --- scenes ---------------------------------------------------------------------------------------


def test_a_scene_with_an_effect_of_one_s_own_is_written_and_read_again():
    ma.register_effect(Spring)
    scene = RING.replace(effects={"spring": {"stiffness": 2.0}, "joint_damping": 0.1})
    text = dump_scene(scene)
    assert "spring: {stiffness: 2.0}" in text
    again = parse_scene(text)
    assert again == scene
    assert list(again.effects.named) == ["joint_damping", "spring"]
    assert again.effects.named["spring"] == Spring.Spec(stiffness=2.0)


def test_all_faults_of_a_scene_are_told_together_each_at_its_place():
    ma.register_effect(Spring)
    with pytest.raises(ma.MultiarmError) as caught:
        RING.replace(
            effects={"joint_damping": -1, "spring": {"stifness": 1, "label": 3}, "sprung": {}},
            gravity=[0, 0],
        )
    assert set(caught.value.faults) == {
        "$.gravity: must be a list of 3 numbers, got [0, 0]",
        "$.effects.joint_damping: must not be negative, got -1.0",
        "$.effects.spring.stiffness: is missing",
        "$.effects.spring.label: must be text, got 3",
        "$.effects.spring.stifness: unknown key 'stifness'; did you mean 'stiffness'? keys are "
        "'stiffness', 'label'",
        next(fault for fault in caught.value.faults if "sprung" in fault),
    }
    assert any(
        fault.startswith("$.effects.sprung: unknown effect 'sprung'; did you mean 'spring'? effects"
                         " are 'spring', ")
        for fault in caught.value.faults
    )  # fmt: skip


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_parameters_are_finite(value):
    ma.register_effect(Spring)
    with refused(ma.MultiarmError, "$.effects.spring.stiffness"):
        RING.replace(effects={"spring": {"stiffness": value}})


def test_a_spec_that_breaks_is_a_fault_of_the_effect():
    from pydantic import field_validator

    class Spec(ma.Effect.Spec):
        size: float

        @field_validator("size")
        @classmethod
        def _look_up(cls, value):
            return {}[value]

    effect_of(lambda t, s: ma.Loads(), Spec=Spec)
    with refused(ma.MultiarmError, "$.effects.push"):
        RING.replace(effects={"push": {"size": 1.0}})


def test_null_leaves_an_effect_out_as_it_does_ours():
    ma.register_effect(Spring)
    scene = RING.replace(effects={"spring": None, "joint_damping": None})
    assert scene.effects.named == {}
    assert len(ma.compile_system(scene).model.effects.kernels) == 0


def test_a_stored_run_is_looked_at_without_the_effect(tmp_path):
    ma.register_effect(Spring)
    scene = RING.replace(effects={"spring": {"stiffness": 2.0}})
    ma.simulate(ma.compile_system(scene), 0.05).save(tmp_path / "run.h5")
    EFFECTS.registered.clear()
    run = ma.load_trajectory(tmp_path / "run.h5")
    assert run.scene.effects.named == {"spring": {"stiffness": 2.0}}
    assert "effects/spring/work" in run.channels
    with refused(ma.MultiarmError, "$.effects.spring"):
        ma.compile_system(run.scene)
    with refused(ma.MultiarmError, "'spring'"):
        parse_scene(run.scene_text)


# --- how effects are found ------------------------------------------------------------------------


def test_an_installed_effect_is_found_by_its_entry_point(monkeypatch):
    offered(monkeypatch, f"effects spring {__name__}:Spring")
    scene = RING.replace(effects={"spring": {"stiffness": 2.0}})
    (kernel,) = ma.compile_system(scene).model.effects.kernels
    assert kernel.name == "spring"


def test_an_installed_effect_that_no_scene_names_is_not_imported(monkeypatch):
    offered(monkeypatch, "effects bomb a_module_that_is_not_there:Bomb")
    assert RING.replace(effects={"joint_damping": 1.0}).effects.joint_damping == 1.0
    with refused(ma.MultiarmError, "'bomb'"):
        RING.replace(effects={"bombe": {}})


class Nameless(ma.Effect):
    """Has forces, and no name."""

    def forces(self, t, state):
        """Nothing."""
        return ma.Loads()


class Idle(ma.Effect):
    """Has a name, and nothing else."""

    name = "spring"


class Vague(Nameless):
    """Has parameters that are no model."""

    name = "spring"
    Spec = dict


class Other(Spring):
    """Another one of the same name."""


NOT_A_CLASS = 3


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("nowhere:Spring", "cannot be loaded, ModuleNotFoundError: No module named 'nowhere'"),
        (f"{__name__}:Sprung", "cannot be loaded, AttributeError"),
        (f"{__name__}:NOT_A_CLASS", "it is no subclass of multiarm.Effect"),
        (f"{__name__}:np", "it is no subclass of multiarm.Effect"),
        (f"{__name__}:Nameless", "'name' must be a word that a scene can have as a key, it is ''"),
        (f"{__name__}:Idle", "it defines neither 'forces' nor 'build'"),
        (f"{__name__}:Vague", "'Spec' must be a pydantic model"),
    ],
)
def test_a_broken_package_is_one_clear_fault(value, message, monkeypatch):
    offered(monkeypatch, f"effects spring {value}")
    scene = RING.replace(effects={"spring": {"stiffness": 2.0}})  # which loads nothing
    with pytest.raises(ma.MultiarmError) as caught:
        ma.compile_system(scene)
    assert len(caught.value.faults) == 1
    assert caught.value.faults[0].startswith("$.effects.spring: ")
    assert message in caught.value.faults[0]


def test_an_effect_must_have_the_name_that_its_package_offers(monkeypatch):
    offered(monkeypatch, f"effects sprung {__name__}:Spring")
    with refused(ma.MultiarmError, "'spring'"):
        ma.compile_system(RING.replace(effects={"sprung": {"stiffness": 2.0}}))


def test_two_packages_with_one_name_are_ambiguous(monkeypatch):
    values = [f"{__name__}:Spring", f"{__name__}:Other"]
    offered(monkeypatch, *(f"effects spring {value}" for value in values))
    with refused(ma.MultiarmError, "'spring'"):
        ma.compile_system(RING.replace(effects={"spring": {"stiffness": 2.0}}))


def test_registering_refuses_names_that_are_taken(monkeypatch):
    ma.register_effect(Spring)
    with refused(ma.MultiarmError, "effect 'spring'"):
        ma.register_effect(Other)
    with refused(ma.MultiarmError, "effect 'joint_damping'"):
        effect_of(lambda t, s: ma.Loads(), "joint_damping")
    offered(monkeypatch, "effects push elsewhere:Push")
    with refused(ma.MultiarmError, "effect 'push'"):
        effect_of(lambda t, s: ma.Loads())


def test_a_class_that_is_defined_again_replaces_the_former_one():
    first = effect_of(lambda t, s: ma.Loads())
    again = effect_of(lambda t, s: ma.Loads())
    assert first is not again
    assert EFFECTS.find("push") is again


def test_what_build_returns_is_checked():
    for build in (
        lambda self, site: "a kernel",
        lambda self, site: [5],
        lambda self, site: [site.nothing_like_this],
        lambda self, site: sys.exit(),
    ):
        effect_of(lambda t, s: None, build=build)
        with refused(ma.MultiarmError, "effects.push"):
            ma.compile_system(RING.replace(effects={"push": {}}))


@cfunc
def overload(_address, _size, _at, t):
    """Fails after 0.05 s."""
    return 3 if t > 0.05 else 0


class Table(NamedTuple):
    """Arrays of an effect."""

    places: Ints1
    points: Floats1


class Nested(NamedTuple):
    """A table within a table."""

    table: Table


PLACES, POINTS = np.zeros(2, dtype=np.int64), np.zeros(3)


@pytest.mark.parametrize(
    "kernel",
    [
        EffectKernel("push", overload, APPLIED, Table(np.zeros(2), POINTS)),
        EffectKernel("push", overload, APPLIED, Table(PLACES, np.zeros((3, 4)))),
        EffectKernel("push", overload, APPLIED, Table(PLACES, np.zeros(6)[::2])),
        EffectKernel("push", overload, APPLIED, Nested(Table(PLACES, POINTS))),
        EffectKernel("push", lambda *arguments: 0, APPLIED),
        EffectKernel("push", overload, APPLIED, derivative=kernel(lambda *arguments: 0)),
        EffectKernel("push", overload, APPLIED + 1),
    ],
    ids=[
        "floats for integers",
        "two axes",
        "strided",
        "nested",
        "Python",
        "not by address",
        "no phase",
    ],
)
def test_kernels_and_arrays_of_users_are_what_compiled_code_expects(kernel):
    effect_of(lambda t, s: None, build=lambda self, site: [kernel])
    with refused(ma.MultiarmError, "effects.push"):
        ma.compile_system(RING.replace(effects={"push": {}}))


def test_an_effect_with_usual_parameters_is_a_candidate():
    effect_of(lambda t, s: ma.Loads(), default={"size": 2.0})
    effect_of(lambda t, s: ma.Loads(), "pull")
    found = defaults(RING)
    assert found["push"] == {"size": 2.0}
    assert "pull" not in found


# --- the example's package ------------------------------------------------------------------------


@pytest.fixture
def package(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "examples" / "own_effect")
    import magnet_effect

    return magnet_effect


def test_the_package_of_the_example_offers_effects_that_scenes_can_name(package, monkeypatch):
    text = (ROOT / "examples" / "own_effect" / "pyproject.toml").read_text(encoding="utf-8")
    table = text.split('[project.entry-points."multiarm.effects"]')[1].split("[")[0]
    lines = [line.split("=") for line in table.strip().splitlines()]
    points = {name.strip(): value.strip().strip('"') for name, value in lines}
    assert list(points) == ["magnet", "compiled_magnet"]
    offered(monkeypatch, *(f"effects {name} {value}" for name, value in points.items()))
    for name in points:
        scene = with_code(RING.replace(effects={name: {"at": [0, 0, 1], "strength": 1.0}}))
        assert type(scene.effects.named[name]) is package.Magnet.Spec


class Overload(ma.Effect):
    """A kernel that fails after a while."""

    name = "overload"

    def build(self, _context):
        """The kernel."""
        return [EffectKernel(self.name, overload, APPLIED, works=False)]


def test_what_a_kernel_returns_beside_success_ends_the_run_and_is_in_its_message():
    ma.register_effect(Overload)
    scene = RING.replace(effects={"overload": {}})
    run = ma.simulate(ma.compile_system(scene), 0.1, certificate=False)
    assert run.status == "failed" and 0.0 < run.time[-1] <= 0.05
    assert "effect `overload` returned 3" in run.message


@cfunc
def no_force(_address, _size, _at, _t):
    """No force."""
    return 0


@cfunc
def no_derivative(_address, _size, _at, _t):
    """What laws return where they have no derivative; effects return 0 only."""
    return SINGULAR


class Underivable(ma.Effect):
    """A kernel whose derivative always fails."""

    name = "underivable"

    def build(self, _context):
        """The kernel."""
        return [EffectKernel(self.name, no_force, APPLIED, works=False, derivative=no_derivative)]


def test_the_derivative_of_an_effect_that_fails_as_one_of_a_law_may_is_named():
    ma.register_effect(Underivable)
    system = ma.compile_system(RING.replace(effects={"underivable": {}}))
    with refused(SolverError, f"effect `no_derivative` returned {SINGULAR};"):
        ma.derivatives(system, 0.0, system.initial_state())


@pytest.mark.skipif(INTERPRETED, reason="nothing is compiled")
def test_a_kernel_that_failed_is_named_without_compiling_others():
    @cfunc
    def derivative(_address, _size, _at, _t):
        return 0

    class Before(ma.Effect):
        """Another effect, with a derivative."""

        name = "before"

        def build(self, _context):
            """The kernel."""
            return [EffectKernel(self.name, no_force, APPLIED, works=False, derivative=derivative)]

    for effect in (Before, Overload):
        ma.register_effect(effect)
    system = ma.compile_system(RING.replace(effects={"before": {}, "overload": {}}))
    run = ma.simulate(system, 0.1, integrator="rk4", step=1e-2, certificate=False)
    assert "effect `overload` returned 3" in run.message
    assert not derivative.is_compiled(CFUNC.args)


def test_an_effect_in_python_and_its_kernel_move_things_alike(package):
    runs = []
    for kind in (package.Magnet, package.CompiledMagnet):
        ma.register_effect(kind)
        effects = {kind.name: {"at": [0.1, 0.0, 0.6], "strength": 0.5}}
        system = ma.compile_system(RING.replace(effects=effects))
        runs.append(ma.simulate(system, 0.3, accuracy=1e-8, max_step=0.01))
        assert system.model.calls_user == (kind is package.Magnet)
    called, compiled = runs
    assert called.object_position == pytest.approx(compiled.object_position, abs=1e-12)
    works = [run.channel(f"effects/{name}/work") for run, name in
             ((called, "magnet"), (compiled, "compiled_magnet"))]  # fmt: skip
    assert np.abs(works[0]).max() > 1e-5
    assert works[0] == pytest.approx(works[1], rel=1e-9, abs=1e-12)
    # the potential of the softened magnet is -k / sqrt(d^2 + r^2)
    distance = np.linalg.norm(compiled.object_position - [0.1, 0.0, 0.6], axis=1)
    potential = -0.5 / np.hypot(distance, 0.05)
    assert works[1] == pytest.approx(potential[0] - potential, abs=1e-8)
