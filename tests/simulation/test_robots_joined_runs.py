"""Claims about runs of robots that hold each other.

Oracles: SciPy on dense algebra, closed forms, conserved momenta and energy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from joined_robots import (
    BLOW,
    colliding_satellites,
    hammer_and_anvil,
    load_on_sled,
    satellites,
    welded_arms,
    welded_motion,
)
from object_scenes import GRAVITY, SLED
from random_trees import draw_moving_trees
from tree_models import read_tree_scene
from tree_motion import dense_motion, energy, far_apart, momenta, tree_state

import multiarm as ma
from multiarm.problems.loops import WELDED_START
from multiarm.scene import parse_scene

DURATION = 0.05  # [s]
METHODS = {
    "semi_implicit_euler": {"step": 2.5e-4},
    "rk4": {"step": 1e-3},
    "dopri5": {"tolerance": 1e-10},
    "dop853": {"tolerance": 1e-10},
    "rodas5p": {"tolerance": 1e-10},
}
FINE = {"integrator": "dop853", "tolerance": 1e-12}
BOTH = ("left", "right")


def run_of(scene: dict[str, Any], duration: float, **how: Any) -> ma.Trajectory:
    run = ma.simulate(ma.compile_system(parse_scene(scene)), duration, **how)
    assert run.status == "completed", run.message
    return run


# --- random scenes -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 7))
def test_the_motion_is_that_of_the_dense_reference(seed, tmp_path):
    rng = np.random.default_rng(seed)
    scene, trees, state, torques = draw_moving_trees("hand_shakes", rng, tmp_path)
    run = run_of(scene, DURATION, integrator="dop853", tolerance=1e-11)
    # errors of the reference, whose gaps are not closed again: its tolerance times the condition
    assert far_apart(tree_state(run, -1), dense_motion(trees, state, torques, DURATION)) < 2e-8


@pytest.mark.parametrize("seed", range(3))
def test_a_run_records_the_start_and_its_evaluation(seed, tmp_path):
    scene = draw_moving_trees("hand_shakes", np.random.default_rng(seed), tmp_path).scene
    system = ma.compile_system(parse_scene(scene))
    start, ev = system.initial_state(), ma.evaluate(system)
    run = ma.simulate(system, 1e-4, step=1e-4, integrator="rk4")
    for name in scene["robots"]:
        np.testing.assert_array_equal(run.joint_positions[name][0], start.joint_positions[name])
        np.testing.assert_array_equal(run.joint_velocities[name][0], start.joint_velocities[name])
    for name, wrench in ev.wrenches.items():
        size = {"atol": 1e-12 * max(1.0, *np.abs(wrench))}
        np.testing.assert_allclose(run.wrenches[name][0], wrench, **size)
        np.testing.assert_allclose(run.contact_forces[name][0], ev.contact_forces[name], **size)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_conserves_the_energy_to_its_order(method, tmp_path):
    scene = draw_moving_trees("hand_shakes", np.random.default_rng(2), tmp_path).scene
    scene = {key: part for key, part in scene.items() if key != "control"}
    run = run_of(scene, DURATION, integrator=method, **METHODS[method])
    size = np.max(run.kinetic_energy) + np.ptp(run.potential_energy)
    bound = {"semi_implicit_euler": 2e-2, "rk4": 1e-6}.get(method, 1e-9)
    assert np.max(np.abs(run.energy_balance)) < bound * size
    assert np.max(run.position_drift) < 1e-12
    assert np.max(run.velocity_drift) < 1e-9


# --- satellites ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["weld", "ball", "revolute", "cylindrical"])
def test_satellites_hand_in_hand_keep_their_momenta_while_their_arms_move(kind):
    amplitudes = {
        "left": [4.0, -6.0, 5.0, 0.8, 0.6, -0.4],
        "right": [-3.0, 5.0, 4.0, 0.7, 0.5, 0.3],
    }
    control = {"kind": "harmonic", "hold": False, "frequency": 0.5, "amplitude": amplitudes}
    scene = satellites({"kind": kind}, control=control)
    trees = read_tree_scene(scene)
    run = run_of(scene, 2.0, integrator="dop853", tolerance=1e-13, output_step=0.2)
    assert np.max(np.ptp(run.joint_positions["left"], axis=0)) > 0.5
    courses = [
        np.concatenate(momenta(trees, tree_state(run, k), BOTH)[:2]) for k in range(len(run))
    ]
    centres = [momenta(trees, tree_state(run, k), BOTH).centre for k in range(len(run))]
    # errors of the steps add up, at most as many as there are steps
    steps = run.statistics["steps"]
    np.testing.assert_allclose(courses, np.zeros_like(courses), atol=1e-13 * steps)
    np.testing.assert_allclose(centres, centres[:1] * len(run), atol=1e-12 * steps)
    np.testing.assert_allclose(run.energy_balance, 0.0, atol=1e-10)


def test_satellites_that_turn_together_keep_their_energy():
    scene = satellites({"kind": "ball"})
    twists = {"left": [0.1, -0.2, 0.05, 0.2, 0.1, -0.3], "right": [0.0, 0.1, 0.1, -0.2, 0.3, 0.1]}
    for name, twist in twists.items():
        scene["robots"][name]["base"]["twist"] = twist
    trees = read_tree_scene(scene)
    run = run_of(scene, 1.0, **FINE)
    first, last = (tree_state(run, k) for k in (0, -1))
    before, after = (momenta(trees, state, BOTH) for state in (first, last))
    np.testing.assert_allclose(after.linear, before.linear, atol=1e-10)
    np.testing.assert_allclose(after.angular, before.angular, atol=1e-10)
    assert energy(trees, last, BOTH) == pytest.approx(energy(trees, first, BOTH), rel=1e-10)
    assert np.max(np.abs(run.wrenches["shake"])) > 0.1


# --- closed forms --------------------------------------------------------------------------------


def test_arms_welded_to_each_other_are_a_four_bar():
    run = run_of(welded_arms(), 0.6, accuracy=1e-9)
    angle = welded_motion().motion(WELDED_START, 0.0, run.time)
    assert np.ptp(angle) > 0.3
    np.testing.assert_allclose(run.joint_positions["left"][:, 0], angle, atol=1e-8)


# --- contacts that only push ---------------------------------------------------------------------


def test_a_robots_load_slides_on_the_sled_of_another_until_both_move_together():
    """Coulomb's law; then the momentum along the slides is shared."""
    speed, (m, mu) = 1.0, SLED.values()
    braking, pushing = mu * GRAVITY, mu * GRAVITY * m[0] / m[1]
    stop, together = speed / (braking + pushing), speed * m[0] / sum(m)
    run = run_of(load_on_sled(speed), 2.0 * stop, accuracy=1e-9)
    (time,) = [event["time"] for event in run.events if event["kind"] == "sticks"]
    assert time == pytest.approx(stop, abs=1e-8)
    slides = run.time < stop
    load, sled = run.joint_velocities["load"][:, 1], run.joint_velocities["sled"][:, 0]
    np.testing.assert_allclose(load[slides], speed - braking * run.time[slides], atol=1e-8)
    np.testing.assert_allclose(sled[slides], pushing * run.time[slides], atol=1e-8)
    np.testing.assert_allclose([load[-1], sled[-1]], together, atol=1e-9)
    on_sled = run.wrenches["load-sled"][slides][:, :3]
    np.testing.assert_allclose(
        on_sled, [[mu * m[0] * GRAVITY, 0, -m[0] * GRAVITY]] * len(on_sled), atol=1e-7
    )
    lost = 0.5 * m[0] * speed**2 - 0.5 * sum(m) * together**2
    assert run.channel("effects/contact_friction/work")[-1] == pytest.approx(-lost, rel=1e-7)


@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_a_hammer_hits_an_anvil(restitution):
    speed, (m, height) = 2.0, BLOW.values()
    run = run_of(hammer_and_anvil(speed, restitution), 1.5 * height / speed, accuracy=1e-10)
    (hit,) = [event for event in run.events if event["kind"] in ("bounces", "touches")]
    assert hit["time"] == pytest.approx(height / speed, abs=1e-10)
    impulse = (1.0 + restitution) * speed / (1.0 / m[0] + 1.0 / m[1])
    assert hit["after"]["impulse_N_s"] == pytest.approx(impulse, rel=1e-10)
    hammer, anvil = (run.joint_velocities[name][-1, 0] for name in ("hammer", "anvil"))
    assert hammer == pytest.approx(-speed + impulse / m[0], abs=1e-9)
    assert anvil == pytest.approx(-impulse / m[1], abs=1e-9)


@pytest.mark.parametrize(("restitution", "mu"), [(0.0, 0.0), (0.7, 0.0), (0.4, 0.5)])
def test_satellites_that_hit_each_other_keep_their_momenta(restitution, mu):
    speed, gap = 0.5, 0.02
    contact = {"mu": mu} if mu else {}
    scene = colliding_satellites(speed, gap, restitution=restitution, **contact)
    trees = read_tree_scene(scene)
    run = run_of(scene, 1.2 * gap / speed, accuracy=1e-9)
    (hit,) = [event for event in run.events if event["kind"] in ("bounces", "touches")]
    assert hit["time"] == pytest.approx(gap / speed, abs=1e-8)
    rates = [hit[when]["gap_rate_m_s"] for when in ("before", "after")]
    assert rates[0] == pytest.approx(-speed, abs=1e-8)
    assert rates[1] == pytest.approx(restitution * speed, abs=1e-8)
    before, after = (momenta(trees, tree_state(run, k), BOTH) for k in (0, -1))
    np.testing.assert_allclose(after.linear, before.linear, atol=1e-9)
    np.testing.assert_allclose(after.angular, before.angular, atol=1e-9)
    lost = energy(trees, tree_state(run, 0), BOTH) - energy(trees, tree_state(run, -1), BOTH)
    assert lost > 1e-3
