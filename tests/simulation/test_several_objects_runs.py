"""Claims about runs of scenes with several objects.

Oracles: SciPy on dense algebra, closed forms, equations of textbooks, conserved momenta and energy.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import yaml
from commands import multiarm
from object_scenes import (
    ASIDE,
    DOWN,
    GRAVITY,
    HIT,
    PENDULUM,
    SLED,
    ball_at_plate,
    body,
    double_pendulum,
    hinged_plates,
    hit_impulse,
    load_on_sled,
    objects_scene,
    peg_acceleration,
    peg_in_socket,
    pendulum_accelerations,
    wing_rate,
)
from random_trees import OF_SEVERAL_OBJECTS, RandomTrees, draw_moving_trees, draw_trees
from scipy.integrate import solve_ivp
from tree_models import WORLD, read_tree_scene
from tree_motion import dense_motion, energy, far_apart, momenta, tree_state

import multiarm as ma
from multiarm.scene import parse_scene

DURATION = 0.05  # [s]
METHODS = {
    "semi_implicit_euler": {"step": 2.5e-4},
    "rk4": {"step": 1e-3},
    "dopri5": {"tolerance": 1e-10},
    "dop853": {"tolerance": 1e-10},
}
FINE = {"integrator": "dop853", "tolerance": 1e-12}


def run_of(scene: dict[str, Any], duration: float, **how: Any) -> ma.Trajectory:
    run = ma.simulate(ma.compile_system(parse_scene(scene)), duration, **how)
    assert run.status == "completed", run.message
    return run


def solved(slope: Any, start: list[float], times: np.ndarray) -> np.ndarray:
    """The motion by SciPy, shape (times, numbers)."""
    return solve_ivp(
        slope, (0.0, times[-1]), start, "DOP853", t_eval=times, rtol=1e-12, atol=1e-13
    ).y.T


# --- random scenes -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("family", OF_SEVERAL_OBJECTS)
def test_the_motion_is_that_of_the_dense_reference(family, seed, tmp_path):
    scene, trees, state, torques = draw_moving_trees(family, np.random.default_rng(seed), tmp_path)
    run = run_of(scene, DURATION, integrator="dop853", tolerance=1e-11)
    # errors of the reference, whose gaps are not closed again: its tolerance times the condition
    assert far_apart(tree_state(run, -1), dense_motion(trees, state, torques, DURATION)) < 2e-8


@pytest.mark.parametrize("method", METHODS)
def test_every_method_conserves_the_energy_to_its_order(method, tmp_path):
    for family in OF_SEVERAL_OBJECTS:
        scene = draw_moving_trees(family, np.random.default_rng(2), tmp_path).scene
        scene = {key: part for key, part in scene.items() if key != "control"}
        run = run_of(scene, DURATION, integrator=method, **METHODS[method])
        size = np.max(run.kinetic_energy) + np.ptp(run.potential_energy)
        bound = {"semi_implicit_euler": 2e-2, "rk4": 1e-6}.get(method, 1e-9)
        assert np.max(np.abs(run.energy_balance)) < bound * size, family
        assert np.max(run.position_drift) < 1e-12
        assert np.max(run.velocity_drift) < 1e-9


@pytest.mark.parametrize("family", OF_SEVERAL_OBJECTS)
def test_energies_are_those_of_all_bodies(family, tmp_path):
    scene, trees, *_ = draw_moving_trees(family, np.random.default_rng(3), tmp_path)
    run = run_of(scene, DURATION, **FINE)
    kinetic_and_potential = run.kinetic_energy + run.potential_energy
    change = kinetic_and_potential[-1] - kinetic_and_potential[0]
    expected = energy(trees, tree_state(run, -1)) - energy(trees, tree_state(run, 0))
    assert change == pytest.approx(expected, abs=1e-10 * np.max(run.kinetic_energy))


def free_clusters(drawn: RandomTrees) -> list[tuple[str, ...]]:
    """Objects that joints connect, where none of them is held by the world."""
    cluster = {name: {name} for name in drawn.trees.objects}
    for connection in drawn.trees.connections:
        pair = (connection.first.body, connection.second.body)
        together = set().union(*(cluster.get(body, {body}) for body in pair))
        cluster |= dict.fromkeys(together & set(cluster), together)
    return sorted({tuple(sorted(names)) for names in cluster.values() if WORLD not in names})


def test_free_clusters_of_objects_keep_their_momenta_and_energy(tmp_path):
    """Each of them, whatever the others do; the centres of mass move straight on."""
    seen, duration = 0, 0.2
    for seed in range(14):
        drawn = draw_trees("objects_alone", np.random.default_rng(20 + seed), tmp_path)
        scene = {**drawn.scene, "gravity": None}
        trees = read_tree_scene(scene)
        run = run_of(scene, duration, **FINE)
        states = [tree_state(run, k) for k in range(0, len(run), max(1, len(run) // 10))]
        for names in free_clusters(drawn):
            seen += 1
            first, *others = [momenta(trees, state, names) for state in states]
            energies = [energy(trees, state, names) for state in states]
            size = max(energies[0], 1.0)
            np.testing.assert_allclose(energies, energies[0], atol=1e-9 * size)
            for later in others:
                np.testing.assert_allclose(later.linear, first.linear, atol=1e-9 * size)
                np.testing.assert_allclose(later.angular, first.angular, atol=1e-9 * size)
            mass = sum(scene["objects"][name]["mass"] for name in names)
            end = momenta(trees, tree_state(run, -1), names).centre
            np.testing.assert_allclose(
                end, first.centre + duration * first.linear / mass, atol=1e-9
            )
    assert seen > 6


@pytest.mark.slow
def test_certificates_of_random_scenes_are_true(tmp_path):
    """Every accuracy that a certificate calls met is met, by the dense reference."""
    accuracy, families = 1e-6, list(OF_SEVERAL_OBJECTS)
    for seed in range(10):
        family = families[seed % len(families)]
        drawn = draw_moving_trees(family, np.random.default_rng(30 + seed), tmp_path)
        run = run_of(drawn.scene, DURATION, accuracy=accuracy)
        assert run.certificate["met"], run.certificate["text"]
        end = tree_state(run, -1)
        exact = dense_motion(drawn.trees, drawn.state, drawn.torques, DURATION)
        apart = [
            frame["position"] - exact.objects[name]["position"]
            for name, frame in end.objects.items()
        ]
        apart += [q - exact.joint_positions[name] for name, q in end.joint_positions.items()]
        assert max(np.max(np.abs(gap)) for gap in apart) < accuracy, f"{family}, seed {seed}"


# --- closed forms --------------------------------------------------------------------------------


def test_a_double_pendulum_of_objects_swings_as_in_textbooks():
    angles, rates = [1.2, -0.7], [0.5, 2.0]
    run = run_of(double_pendulum(angles, rates), 2.0, **FINE)
    swing = solved(
        lambda _, y: [*y[2:], *pendulum_accelerations(y[:2], y[2:])], [*angles, *rates], run.time
    )
    assert np.ptp(swing[:, 0]) > 2.0
    upper, lower = run.objects["upper"], run.objects["lower"]
    np.testing.assert_allclose(upper.twist[:, 4], swing[:, 2], atol=1e-8)
    np.testing.assert_allclose(lower.twist[:, 4], swing[:, 3], atol=1e-8)
    a, L = PENDULUM["to_centre"], PENDULUM["length"]
    along = np.stack([np.sin(swing[:, :2]), np.zeros_like(swing[:, :2]), np.cos(swing[:, :2])])
    np.testing.assert_allclose(upper.position.T, -a[0] * along[..., 0], atol=1e-8)
    np.testing.assert_allclose(
        lower.position.T, -L * along[..., 0] - a[1] * along[..., 1], atol=1e-8
    )


def end_of_pendulum(duration: float, **how: Any) -> np.ndarray:
    """Angular velocities of both objects of a double pendulum."""
    run = run_of(double_pendulum([1.2, -0.7], [0.5, 2.0]), duration, **how)
    return np.array([run.objects[name].twist[-1, 4] for name in ("upper", "lower")])


def test_implicit_steps_move_several_objects():
    finest = end_of_pendulum(0.2, **FINE)
    np.testing.assert_allclose(
        end_of_pendulum(0.2, integrator="rodas5p", tolerance=1e-9), finest, atol=1e-6
    )


def test_variational_steps_of_several_objects_are_of_second_order():
    finest = end_of_pendulum(0.2, **FINE)
    coarse, fine = (
        np.max(np.abs(end_of_pendulum(0.2, integrator="variational", step=step) - finest))
        for step in (4e-3, 2e-3)
    )
    assert 3.8 < coarse / fine < 4.2
    assert fine < 1e-3


def test_plates_on_a_hinge_beat_like_wings():
    start, rate = -0.6, 1.5
    run = run_of(hinged_plates(start, rate), 0.8, **FINE)
    angle = solved(lambda _, y: [wing_rate(y[0], start, rate)], [start], run.time)[:, 0]
    assert np.ptp(angle) > 1.0
    left, right = run.objects["left"], run.objects["right"]
    expected = [wing_rate(x, start, rate) for x in angle]
    np.testing.assert_allclose(left.twist[:, 5], expected, atol=1e-9)
    np.testing.assert_allclose(right.twist[:, 5], -left.twist[:, 5], atol=1e-10)
    np.testing.assert_allclose(left.position[:, 0] + right.position[:, 0], 0.0, atol=1e-10)


@pytest.mark.parametrize("kind", ["prismatic", "cylindrical"])
def test_a_peg_slides_out_of_a_socket_that_turns(kind):
    out, speed, spin = 0.5, -0.4, 1.5
    run = run_of(peg_in_socket(kind, out, speed, spin), 1.5, **FINE)
    peg, socket = run.objects["peg"], run.objects["socket"]
    motion = solved(
        lambda _, y: [y[1], peg_acceleration(y[0], spin, out)[0]], [out, speed], run.time
    )
    apart = np.linalg.norm(peg.position - socket.position, axis=1)
    np.testing.assert_allclose(apart, motion[:, 0], atol=1e-9)
    spins = [peg_acceleration(x, spin, out)[1] for x in motion[:, 0]]
    np.testing.assert_allclose(socket.twist[:, 5], spins, atol=1e-9)


# --- contacts that only push ---------------------------------------------------------------------


def test_a_load_slides_on_a_sled_until_both_move_together():
    """Coulomb's law; then the momentum along the rail is shared."""
    speed, (m, mu) = 1.0, SLED.values()
    braking, pushing = mu * GRAVITY, mu * GRAVITY * m[0] / m[1]
    stop, together = speed / (braking + pushing), speed * m[0] / sum(m)
    run = run_of(load_on_sled(speed), 2.0 * stop, accuracy=1e-9)
    (first, *others) = [event["time"] for event in run.events if event["kind"] == "sticks"]
    assert first == pytest.approx(stop, abs=1e-8)
    np.testing.assert_allclose(others, first, atol=1e-8)
    slides = run.time < stop
    load, sled = (run.objects[name].twist[:, 0] for name in ("load", "sled"))
    np.testing.assert_allclose(load[slides], speed - braking * run.time[slides], atol=1e-8)
    np.testing.assert_allclose(sled[slides], pushing * run.time[slides], atol=1e-8)
    np.testing.assert_allclose([load[-1], sled[-1]], together, atol=1e-9)
    np.testing.assert_allclose(m[0] * load + m[1] * sled, m[0] * speed, atol=1e-9)
    lost = 0.5 * m[0] * speed**2 - 0.5 * sum(m) * together**2
    assert run.channel("effects/contact_friction/work")[-1] == pytest.approx(-lost, rel=1e-7)


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_an_impact_between_two_free_objects_keeps_their_momenta(restitution):
    speed, height, m = 2.0, 0.1, HIT["m"]
    scene = ball_at_plate(speed, restitution, height)
    trees = read_tree_scene(scene)
    shortly = 1e-8  # [s], after the impact
    run = run_of(scene, height / speed + shortly, accuracy=1e-10)
    (hit,) = [event for event in run.events if event["kind"] in ("bounces", "touches")]
    assert hit["time"] == pytest.approx(height / speed, abs=1e-10)
    begin, end = (momenta(trees, tree_state(run, k), ("ball", "plate")) for k in (0, -1))
    np.testing.assert_allclose(end.linear, begin.linear, atol=1e-12)
    np.testing.assert_allclose(end.angular, begin.angular, atol=1e-12)
    impulse = hit_impulse(speed, restitution)
    assert hit["after"]["impulse_N_s"] == pytest.approx(impulse, rel=1e-10)
    turn = HIT["off"] * impulse / HIT["moment"]
    ball, plate = (run.objects[name].twist[-1] for name in ("ball", "plate"))
    accelerated = 10.0 * shortly  # no acceleration is larger where both stay together
    np.testing.assert_allclose(ball, [0, 0, -speed + impulse / m[0], 0, 0, 0], atol=accelerated)
    np.testing.assert_allclose(plate, [0, 0, -impulse / m[1], 0, turn, 0], atol=accelerated)


def test_a_load_that_falls_on_a_sled_takes_it_along():
    """The rail takes the blow; along the rail the momentum of both stays."""
    speed, m, height = 0.5, SLED["m"], 0.05
    scene = load_on_sled(speed)
    scene["objects"]["load"]["pose"]["xyz"][2] += height
    run = run_of(scene, 1.0, accuracy=1e-9)
    fall = np.sqrt(2.0 * height / GRAVITY)
    hits = [
        event["time"]
        for event in run.events
        if event.get("before", {}).get("gap_rate_m_s", 0.0) < -0.1
    ]
    np.testing.assert_allclose(hits, fall, atol=1e-8)
    load, sled = (run.objects[name].twist for name in ("load", "sled"))
    np.testing.assert_allclose(m[0] * load[:, 0] + m[1] * sled[:, 0], m[0] * speed, atol=1e-9)
    np.testing.assert_allclose(load[-1], [speed * m[0] / sum(m), 0, 0, 0, 0, 0], atol=1e-8)
    np.testing.assert_allclose(sled[-1], load[-1], atol=1e-8)


def test_a_stack_slides_on_the_floor_and_comes_to_rest_one_after_the_other():
    """Coulomb's law for both: the lower one is braked by the floor and driven by the upper one."""
    low, high, speed, mu, ground = 2.0, 1.0, 1.0, 0.4, 0.5
    twist = [speed, 0.0, 0.0, 0.0, 0.0, 0.0]
    objects = {
        name: {"shape": {"box": size}, "mass": mass, "pose": {"xyz": [0, 0, z]}, "twist": twist}
        for name, mass, size, z in (
            ("low", low, [0.4, 0.4, 0.2], 0.1), ("high", high, [0.3, 0.3, 0.1], 0.25),
        )
    }  # fmt: skip
    feet = [
        {
            "between": ["high", "low"], "name": f"foot_{k}", "kind": "point_on_plane", "mu": mu,
            "at": {"xyz": [0, 0, 0.1]}, "at_first": {"xyz": [x, y, -0.05]},
        }
        for k, (x, y) in enumerate([(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)])
    ]  # fmt: skip
    effects = {"unilateral_contacts": {"start": "as_written"}, "floor": {"mu": ground}}
    run = run_of(objects_scene(objects, feet, gravity=DOWN, effects=effects), 0.3, accuracy=1e-8)
    braking = {
        "low": (ground * (low + high) - mu * high) / low * GRAVITY,
        "high": mu * GRAVITY,
    }
    stops = sorted({round(event["time"], 8) for event in run.events if event["kind"] == "sticks"})
    np.testing.assert_allclose(stops, [speed / braking[name] for name in braking], atol=2e-8)
    for name, slower in braking.items():
        position, velocity = run.objects[name].position, run.objects[name].twist[:, 0]
        assert position[-1, 0] == pytest.approx(0.5 * speed**2 / slower, abs=1e-8)
        np.testing.assert_allclose(velocity, np.maximum(speed - slower * run.time, 0.0), atol=1e-7)
        np.testing.assert_allclose(np.ptp(position[:, 1:], axis=0), 0.0, atol=1e-9)


# --- steppers and threads ------------------------------------------------------------------------


def test_a_stepper_moves_objects_as_a_run_does(tmp_path):
    drawn = draw_moving_trees("several_objects", np.random.default_rng(4), tmp_path)
    system = ma.compile_system(parse_scene(drawn.scene))
    run = ma.simulate(system, 0.01, integrator="rk4", step=1e-3)
    stepper = ma.Stepper(system, integrator="rk4", step=1e-3)
    for _ in range(10):
        state = stepper.advance(1e-3, drawn.torques)
    for name, motion in run.objects.items():
        np.testing.assert_allclose(state.objects[name].position, motion.position[-1], atol=1e-12)
        np.testing.assert_allclose(state.objects[name].twist, motion.twist[-1], atol=1e-10)
    assert list(stepper.wrenches) == list(run.wrenches)


def test_runs_in_threads_are_those_of_one():
    scene = double_pendulum([0.4, -0.9], [1.1, -0.6])
    system = ma.compile_system(parse_scene(scene))
    state = system.initial_state()
    alone = ma.simulate(system, 0.05, integrator="rk4", step=1e-3)
    many = ma.simulate_many(system, 0.05, states=[state] * 2, integrator="rk4", step=1e-3)
    for run in many:
        for name, motion in run.objects.items():
            np.testing.assert_array_equal(motion.position, alone.objects[name].position)


def test_bodies_that_nothing_joins_move_for_themselves(tmp_path):
    objects = {
        "slowed": body(2.0, [0.1] * 3, [0.0, 0.0, 0.0], twist=[1.0, 0.0, 0.0, 0.0, 0.0, 0.5]),
        "free": body(1.0, [0.1] * 3, [3.0, 0.0, 0.0], twist=[0.0, 2.0, 0.0, 0.0, 0.0, 0.0]),
    }
    drag = {"linear": 4.0, "object": "slowed"}
    alone = {"effects": {"drag": drag}, "run": {"duration": 0.1}}
    scene = objects_scene(objects, [], robots=ASIDE, **alone)
    path, facts = tmp_path / "scene.yaml", tmp_path / "check.json"
    path.write_text(yaml.safe_dump(scene))
    run = ma.simulate(ma.compile_system(ma.load_scene(path)), accuracy=1e-8)
    assert run.certificate is not None and run.certificate["met"]
    slowed, free = run.objects["slowed"].twist[-1], run.objects["free"].twist[-1]
    np.testing.assert_allclose(slowed, [np.exp(-0.2), 0, 0, 0, 0, 0.5], atol=1e-8)
    np.testing.assert_allclose(free, objects["free"]["twist"], atol=1e-12)
    result = multiarm("check", path, "--json", facts)
    assert result.exit_code == 0, result.output
    freedom = json.loads(facts.read_text())["freedom"]
    assert (freedom["constraints"], freedom["rank"], freedom["mobility"]) == (0, 0, 18)
