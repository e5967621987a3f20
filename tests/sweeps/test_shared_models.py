"""Claims about models and data: nothing that a run writes is shared, in scenes of all kinds."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from event_scenes import arm, ball, ball_on_plate, box, on_floor
from many_runs import assert_same_run, random_states
from mechanics import (
    arrays_by_name,
    ur5_pair,
)

import multiarm as ma
from multiarm.dynamics.data import Data
from multiarm.jit.rows import offset_of
from multiarm.jit.structs import Numbers
from multiarm.robots.terms import TermAddresses

WELD = {"kind": "weld"}


def beating():
    """A controller whose torques depend on time alone."""
    return lambda t, state: {"left": np.full(6, np.sin(9.0 * t)), "right": -2.0 * np.ones(6) * t}


def dome(p):
    """Distance from a sphere through the right tip, as a function in Python."""
    return np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2) - 0.6


DOME = {"arm": {"point": [0, 0, 0]}, "object": {"surface": {"distance": dome, "length": 0.6}}}
PUSH = {
    "on": "object",
    "force": [3.0, 0, 0],
    "at": [0, 0.1, 0],
    "pulse": {"begin": 0.02, "end": 0.05},
}
ON_LINK = {"on": "left/forearm_link", "force": [0, 4.0, 0], "sinusoid": {"frequency": 5.0}}


def pulled(t, state):
    """A wrench from outside that a function in Python gives."""
    return [0.0, 0.0, -30.0 * state.object_position[1], 0.0, 0.1 * t, 0.0]


KINDS = {
    "a path to follow": lambda: ur5_pair(
        WELD, WELD,
        control={
            "kind": "joint_pd", "stiffness": 300.0, "damping": 40.0,
            "path": [{"time": 0.1, "xyz": [0, 0, 0.55]}],
        },
    ),
    "object impedance": lambda: ur5_pair(
        WELD, {"kind": "ball"},
        control={
            "kind": "object_impedance",
            "stiffness": {"translation": 200.0, "rotation": 20.0},
            "damping": {"translation": 50.0, "rotation": 5.0},
        },
    ),
    "effects, some with states": lambda: ur5_pair(
        WELD, {"kind": "revolute"},
        control={"kind": "joint_pd", "stiffness": 300.0, "damping": 40.0},
        effects={
            "joint_damping": 0.5, "rotor_inertia": 0.1, "torque_limits": "urdf",
            "actuator_lag": {"time_constant": 0.02, "start": "command"},
            "drag": {"linear": 2.0}, "external_wrenches": [PUSH, ON_LINK],
        },
    ),
    "a wrench of a function": lambda: ur5_pair(
        WELD, WELD, effects={"external_wrenches": [{"on": "object", "function": pulled}]}
    ),
    "a surface of a function": lambda: ur5_pair(WELD, {"kind": "contacts", "contacts": [DOME]}),
    "a ball that bounces and rolls": lambda: ball_on_plate(
        arm("zY", mass=2.0), ball(mass=0.5, twist=[0.3, 0, 0, 0, 0, 0]), 0.5, 0.3,
        control={"kind": "harmonic", "amplitude": {"plate": [50.0, 0.0]}, "frequency": 2.0},
    ),
    "a box that tumbles on the floor": lambda: on_floor(
        box(height=0.1, rpy=(0.3, 0.2, 0), twist=[0.5, 0, 0, 0, 1, 0]), 0.3, 0.4
    ),
    "contacts that give way": lambda: ball_on_plate(
        arm("z", mass=2.0), ball(height=0.01, mass=0.5),
        effects={"contact_compliance": {"stiffness": 1e4, "damping": 10.0}},
    ),
}  # fmt: skip


@pytest.fixture(scope="module", params=["pinocchio", "compiled"])
def arms(request):
    return request.param


@pytest.fixture(scope="module", params=KINDS)
def system(request, arms):
    return ma.compile_system(KINDS[request.param](), arms=arms)


def test_runs_side_by_side_have_the_numbers_of_single_runs(system):
    states = [system.initial_state(), *random_states(system, 3, size=1e-3)]
    run = {"duration": 0.15, "accuracy": 1e-5, "certificate": False}
    expected = [ma.simulate(ma.compile_system(system.scene), state=s, **run) for s in states]
    assert {run.status for run in expected} == {"completed"}, expected[0].message
    found = ma.simulate_many(system, states=[*states, *states], threads=3, **run)
    for one, other in zip(found, [*expected, *expected], strict=True):
        assert_same_run(one, other)


@pytest.mark.parametrize(
    "method",
    [
        {"integrator": "rodas5p", "accuracy": 1e-5},
        {"integrator": "variational", "step": 2e-3},
        {"integrator": "semi_implicit_euler", "step": 1e-3},
        {"integrator": "dopri5", "accuracy": 1e-5, "solver": "dense"},
    ],
    ids=lambda method: method["integrator"],
)
def test_all_methods_run_side_by_side(method, welded_ur5_system):
    states = random_states(welded_ur5_system, 4)
    found = ma.simulate_many(welded_ur5_system, 0.05, states=states, threads=4, **method)
    for run, state in zip(found, states, strict=True):
        assert_same_run(run, ma.simulate(welded_ur5_system, 0.05, state=state, **method))


@pytest.mark.parametrize("terms", ["pinocchio", "compiled"])
def test_variational_runs_side_by_side_have_the_numbers_of_single_runs_after_one_of_them(terms):
    """The first run makes matrices of Coriolis forces, which no other thread may use."""
    scene, run = ur5_pair(WELD, {"kind": "ball"}), {"integrator": "variational", "step": 1e-3}
    system = ma.compile_system(scene, arms=terms)
    states = random_states(system, 3, size=0.1)
    expected = [
        ma.simulate(ma.compile_system(scene, arms=terms), 0.05, state=s, certificate=False, **run)
        for s in states
    ]
    ma.simulate(system, 0.01, certificate=False, **run)
    found = ma.simulate_many(
        system, 0.05, states=states, threads=3, progress=None, certificate=False, **run
    )
    for one, other in zip(found, expected, strict=True):
        assert_same_run(one, other)


def test_a_controller_in_python_is_asked_by_all(welded_ur5_system):
    system = welded_ur5_system.with_control(beating())
    states = random_states(system, 4)
    found = ma.simulate_many(system, 0.1, states=states, threads=4, accuracy=1e-5)
    for run, state in zip(found, states, strict=True):
        assert_same_run(run, ma.simulate(system, 0.1, state=state, accuracy=1e-5))
    assert found[0].certificate["met"]
    (heavy,) = ma.simulate_many(system, 0.1, parameters=[{"object.mass": 30.0}], accuracy=1e-5)
    assert heavy.provenance["control"] == "python function"
    np.testing.assert_array_equal(heavy.joint_torques["left"], found[0].joint_torques["left"])


def test_every_thread_has_an_instance_of_an_own_effect(monkeypatch, welded_ur5_system):
    """One that remembers is seen to give the numbers of a run alone, if its instance is its own."""
    monkeypatch.setattr("multiarm.scene.EFFECTS.registered", {})
    used: dict[int, int] = {}  # thread -> instance
    all_run = threading.Barrier(4)

    class Scratch(ma.Effect):
        name = "scratch"

        def __init__(self, spec):
            super().__init__(spec)
            self.wrench = np.zeros(6)  # reused at every call

        def forces(self, t, state):
            thread = threading.get_ident()
            if thread != threading.main_thread().ident and thread not in used:
                used[thread] = id(self)
                all_run.wait(60)
            self.wrench[:] = 0.0
            for k in range(3):
                self.wrench[k] = -5.0 * state.object_twist[k]
            return ma.Loads(object_wrench=self.wrench)

    ma.register_effect(Scratch)
    system = ma.compile_system(ur5_pair(WELD, WELD, effects={"scratch": {}}))
    states = random_states(system, 4)
    expected = [ma.simulate(system, 0.1, state=s, accuracy=1e-4) for s in states]
    found = ma.simulate_many(system, 0.1, states=states, threads=4, accuracy=1e-4)
    assert len(used) == len(set(used.values())) == 4
    for one, other in zip(found, expected, strict=True):
        assert_same_run(one, other)


def written_arrays(data) -> dict[str, np.ndarray]:
    """All arrays that kernels may write, by name."""
    arrays = {
        **arrays_by_name(data.arrays, "arrays"),
        **arrays_by_name(data.work, "work"),
        **arrays_by_name(data.coupled, "coupled"),
    }
    for k, (slots, of_effect) in enumerate(data.effects):
        for i, part in enumerate((slots, *of_effect)):
            if isinstance(part, np.ndarray):  # numbers never change
                arrays[f"effects.{k} {i}"] = part
    memory = {n: a.struct if isinstance(a, Numbers) else a for n, a in arrays.items()}
    return {name: array for name, array in memory.items() if array.size}


def where_terms_are(data) -> set[int]:
    """Addresses of the arms' terms, and of what computes them."""
    pointers = data.arrays.bodies.pointers[: len(data.model.robots)]
    places = set(np.delete(pointers, offset_of(TermAddresses, "stride"), axis=1).ravel())
    functions = data.arrays.functions
    return (places | {functions.pinocchio, functions.dense, functions.robots_struct}) - {0}


def test_data_of_one_model_share_no_array_that_is_written(system):
    both = Data(system.model), Data(system.model)
    own, others = map(written_arrays, both)
    assert own.keys() == others.keys() and len(own) > 50
    shared = [n for n in own for other in others.values() if np.shares_memory(own[n], other)]
    assert shared == []
    terms = [where_terms_are(data) for data in both]
    assert terms[0] and not terms[0] & terms[1]
    surfaces = [set(map(id, data.surfaces)) for data in both]
    assert not surfaces[0] & surfaces[1]  # they remember where they were


def entries_of(holder, group="") -> dict[str, np.ndarray]:
    """Copies of the entries of a NamedTuple, and of those of its groups."""
    entries = {}
    for name, entry in holder._asdict().items():
        if isinstance(entry, tuple):
            entries |= entries_of(entry, f"{group}{name}.")
        else:
            entries[group + name] = np.copy(entry)
    return entries


def test_a_model_is_not_written_by_runs_and_evaluations(system):
    before = entries_of(system.model.constants)
    ma.evaluate(system)
    ma.simulate(system, 0.02, accuracy=1e-3)
    for name, array in entries_of(system.model.constants).items():
        np.testing.assert_array_equal(array, before[name], err_msg=name)


def test_a_system_like_another_is_the_one_that_is_compiled_anew(monkeypatch):
    scene = ur5_pair(WELD, {"kind": "ball"})
    system = ma.compile_system(scene)
    heavier = scene.replace(object={**vars(scene.object), "mass": 30.0})
    alone = ma.simulate(ma.compile_system(heavier), 0.1, accuracy=1e-6)

    def never(*_):
        raise AssertionError("an arm that did not change is not made anew")

    monkeypatch.setattr("multiarm.assembly.robots._make_robot", never)
    monkeypatch.setattr("multiarm.assembly.robots.resolve_arm", never)
    monkeypatch.setattr("multiarm.assembly.joints._make_joint", never)
    like = ma.compile_system(heavier, like=system)
    assert_same_run(ma.simulate(like, 0.1, accuracy=1e-6), alone)
    moved = scene.replace(object={**vars(scene.object), "pose": {"xyz": [0, 0, 0.51]}})
    with pytest.raises(AssertionError):  # joints without `at` are where the tips are
        ma.compile_system(moved, like=system)


LIKE = {
    "another gravity": {"gravity": [0, 1.0, -1.6]},
    "no gravity": {"gravity": None},
    "gravity torques": {"control": {"kind": "gravity_compensation"}},
    "a force on a link": {"effects.external_wrenches": [ON_LINK]},
    "drives with inertia": {"effects.rotor_inertia": 0.2},
    "other terms of arms": {"run.arms": "pinocchio"},
    "one arm elsewhere": {"arms.left.base.xyz[1]": 0.02, "joints[0].at": None},
    "another posture": {"arms.right.posture[5]": 0.3},
    "another joint": {"joints[1].kind": "revolute"},
    "another solver": {"run.solver": "dense"},
}


@pytest.mark.parametrize("change", LIKE)
def test_what_differs_is_made_anew(change, arms):
    system = ma.compile_system(ur5_pair(WELD, {"kind": "ball"}), arms=arms)
    scene = system.scene.replace(LIKE[change])
    run = {"duration": 0.05, "accuracy": 1e-5, "certificate": False}
    found = ma.simulate(ma.compile_system(scene, like=system), **run)
    assert_same_run(found, ma.simulate(ma.compile_system(scene), **run))
    assert found.status == "completed"


def test_threads_are_one_where_evaluations_call_python(welded_ur5_system, monkeypatch):
    asked = []
    monkeypatch.setattr(
        "multiarm.simulation.many.run_cases",
        lambda cases, system, threads, bar: asked.append(threads),
    )
    monkeypatch.setattr("multiarm.simulation.many.processors", lambda: 12)
    ma.simulate_many(welded_ur5_system, parameters=[{}])
    ma.simulate_many(welded_ur5_system, parameters=[{}], threads=5)
    compiled = ma.compile_system(welded_ur5_system.scene, arms="compiled")
    ma.simulate_many(compiled, parameters=[{}])
    ma.simulate_many(compiled, parameters=[{}], control=lambda t, state: {})
    assert asked == [1, 5, 12, 1]


def test_python_goes_on_while_a_run_is_in_its_loop(welded_ur5_system, monkeypatch):
    """One call of the loop makes the whole run: a thread that held the lock would stop others."""
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 10**9)
    system = ma.compile_system(welded_ur5_system.scene, arms="compiled")
    run = {"integrator": "rk4", "step": 1e-4, "duration": 1.0, "output_step": 0.5}
    ma.simulate(system, **{**run, "duration": 0.01})  # what must be compiled is
    found = []
    thread = threading.Thread(target=lambda: found.append(ma.simulate(system, **run)))
    thread.start()
    looks = 0
    while thread.is_alive():
        time.sleep(1e-4)
        looks += 1
    assert found[0].statistics["evaluations"] > 4e4
    assert looks > 20
