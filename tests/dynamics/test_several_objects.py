"""Claims about evaluations of scenes with several objects.

Oracles: closed forms.  That random scenes agree with dense algebra is among the claims of
``test_tree_oracle.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from object_scenes import (
    ASIDE,
    GRAVITY,
    PENDULUM,
    PLATE,
    SLED,
    body,
    double_pendulum,
    hinged_plates,
    load_on_sled,
    objects_scene,
    peg_acceleration,
    peg_in_socket,
    pendulum_accelerations,
)
from random_trees import OF_SEVERAL_OBJECTS, draw_trees
from repository import SCENES
from scipy.spatial.transform import Rotation
from tree_models import constant_torques, read_tree_scene, start_of
from tree_oracle import TreeSolution, solve_minimal, worst_gap

import multiarm as ma
from multiarm.assembly.start import project_start
from multiarm.errors import ModelError
from multiarm.scene import parse_scene

ROUNDING = 1e-12
PER_FAMILY = 4
ANGLES, RATES = [0.4, -0.9], [1.1, -0.6]


def system_of(scene: dict[str, Any]) -> ma.System:
    return ma.compile_system(parse_scene(scene))


def reference(scene: dict[str, Any]) -> TreeSolution:
    """The solution of dense algebra."""
    trees = read_tree_scene(scene)
    state = start_of(scene, trees)
    assert worst_gap(trees, state) < ROUNDING
    return solve_minimal(trees, state, constant_torques(scene, trees))


def node(scene: dict[str, Any]) -> ma.Evaluation:
    return ma.evaluate(system_of(scene))


def dense(scene: dict[str, Any]) -> ma.Evaluation:
    return ma.evaluate(system_of({**scene, "run": {"solver": "dense"}}))


SOLVED = pytest.mark.parametrize("solved", [reference, node, dense])


# --- closed forms --------------------------------------------------------------------------------


@SOLVED
def test_a_double_pendulum_of_objects_is_that_of_textbooks(solved):
    solution = solved(double_pendulum(ANGLES, RATES))
    expected = pendulum_accelerations(np.array(ANGLES), np.array(RATES))
    accelerations = solution.object_accelerations
    angular = [accelerations[name][4] for name in ("upper", "lower")]
    np.testing.assert_allclose(angular, expected, rtol=ROUNDING)
    # Newton's law of both objects together: the pin pulls the world with what holds them
    force = sum(
        m * (np.array([0.0, 0.0, -GRAVITY]) - accelerations[name][:3])
        for m, name in zip(PENDULUM["m"], ("upper", "lower"), strict=True)
    )
    np.testing.assert_allclose(solution.wrenches["pin"][:3], force, atol=ROUNDING * 100.0)


@SOLVED
def test_plates_on_a_hinge_beat_like_wings(solved):
    angle, rate = 0.3, 1.0
    accelerations = solved(hinged_plates(angle, rate)).object_accelerations
    m, I, a = PLATE.values()
    inertia = I + m * a**2 * np.cos(angle) ** 2
    expected = m * a**2 * np.cos(angle) * np.sin(angle) * rate**2 / inertia
    assert accelerations["left"][5] == pytest.approx(expected, rel=ROUNDING)
    np.testing.assert_allclose(
        accelerations["right"], [1, -1, 1, 1, 1, -1] * accelerations["left"], atol=ROUNDING
    )


@SOLVED
@pytest.mark.parametrize("kind", ["prismatic", "cylindrical"])
def test_a_peg_is_thrown_out_of_a_socket_that_turns(kind, solved):
    out, spin = 0.5, 1.5
    accelerations = solved(peg_in_socket(kind, out, 0.2, spin)).object_accelerations
    seen_at_rest = accelerations["peg"][0] - accelerations["socket"][0]
    outward, _ = peg_acceleration(out, spin, out)
    assert seen_at_rest + out * spin**2 == pytest.approx(outward, rel=ROUNDING)


@pytest.mark.parametrize("solved", [node, dense])
def test_friction_brakes_a_load_and_drives_the_sled_below_it(solved):
    """Coulomb's law: the load's weight, times mu, acts on both."""
    ev = solved(load_on_sled(1.0))
    (load, sled), mu = SLED.values()
    drag = mu * load * GRAVITY
    along = [ev.object_accelerations[name][0] for name in ("load", "sled")]
    np.testing.assert_allclose(along, [-drag / load, drag / sled], rtol=1e-10)
    assert set(ev.contact_states.values()) == {("sliding",)}
    feet = sum(ev.wrenches[f"foot_{k}"][:3] for k in range(3))
    np.testing.assert_allclose(feet, [drag, 0.0, -load * GRAVITY], atol=1e-9)
    # the rail carries both
    rail = ev.wrenches["rail"][:3]
    np.testing.assert_allclose(rail, [0.0, 0.0, -(load + sled) * GRAVITY], atol=1e-9)


# --- effects -------------------------------------------------------------------------------------


def drag_on(**named: str) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Accelerations of two free bodies in a medium, and their derivatives by the first's twist."""
    speeds = {"first": [2.0, 0.0, 0.0, 0.0, 0.0, 3.0], "second": [0.0, 4.0, 0.0, 5.0, 0.0, 0.0]}
    objects = {
        name: body(0.5 * (1 + k), [0.1, 0.1, 0.1], [3.0 * k, 0.0, 0.0], twist=twist)
        for k, (name, twist) in enumerate(speeds.items())
    }
    drag = {"linear": 3.0, "angular": 0.2, **named}
    system = system_of(objects_scene(objects, [], robots=ASIDE, effects={"drag": drag}))
    derivatives = ma.derivatives(system, 0.0, system.initial_state())
    by_twist = np.vstack([a.d_object_twist for a in derivatives.object_accelerations.values()])
    return dict(derivatives.evaluation.object_accelerations), np.diag(by_twist)


def test_a_medium_resists_every_object_or_the_one_that_is_named():
    of_first, of_second = [-12.0, 0, 0, 0, 0, -6.0], [0, -12.0, 0, -10.0, 0, 0]
    slopes = np.repeat([-6.0, -2.0, -3.0, -2.0], 3)
    for named, acts in (
        ({}, (1.0, 1.0)),
        ({"object": "first"}, (1.0, 0.0)),
        ({"object": "second"}, (0.0, 1.0)),
    ):
        accelerations, by_twist = drag_on(**named)
        np.testing.assert_allclose(accelerations["first"], acts[0] * np.array(of_first))
        np.testing.assert_allclose(accelerations["second"], acts[1] * np.array(of_second))
        np.testing.assert_allclose(by_twist, np.repeat(acts, 6) * slopes)


# --- random scenes -------------------------------------------------------------------------------


@pytest.mark.parametrize("family", OF_SEVERAL_OBJECTS)
def test_evaluations_certify_themselves(family, tmp_path):
    for seed in range(PER_FAMILY):
        drawn = draw_trees(family, np.random.default_rng(seed), tmp_path)
        ev = ma.evaluate(system_of(drawn.scene))
        size = max(
            1.0, *(np.max(np.abs(force), initial=0.0) for force in ev.contact_forces.values())
        )
        assert ev.message == ""
        assert ev.residuals.object < 1e-11 * size, f"seed {seed}"
        assert ev.residuals.arm < 1e-11 * size, f"seed {seed}"
        assert ev.residuals.constraint < 1e-9, f"seed {seed}"


# --- states --------------------------------------------------------------------------------------


def test_states_have_their_objects_by_name():
    scene = double_pendulum(ANGLES, RATES)
    trees = read_tree_scene(scene)
    system, state = system_of(scene), start_of(scene, trees)
    again = system.state(objects=state.objects)
    for name, written in state.objects.items():
        for part, values in written.items():
            np.testing.assert_allclose(getattr(again.objects[name], part), values, atol=1e-15)
    np.testing.assert_allclose(again.velocity[:12], system.initial_state().velocity[:12])
    pose = system.state(objects={"lower": {"position": [1.0, 2.0, 3.0]}}).objects
    np.testing.assert_array_equal(pose["lower"].position, [1.0, 2.0, 3.0])
    with pytest.raises(ModelError, match="2 objects, upper, lower"):
        _ = again.object_position
    with pytest.raises(ModelError, match="2 objects"):
        _ = ma.evaluate(system).object_acceleration
    with pytest.raises(ModelError, match="uper"):
        system.state(objects={"uper": {"position": [0.0, 0.0, 0.0]}})


# --- forces that move no object ------------------------------------------------------------------


@pytest.fixture(scope="module")
def stack() -> tuple[ma.System, ma.Evaluation]:
    """Two arms hold a box, on which another is welded, in motion."""
    system = ma.compile_system(ma.load_scene(SCENES / "two_arms_stack.yaml"))
    state = system.initial_state()
    rates = {"left": [0.3, -0.2, 0.4, 0.1, -0.3, 0.2]}
    moving = system.state(objects={}, joint_positions=state.joint_positions, joint_velocities=rates)
    with system.borrow() as data:
        moving = project_start(data, system.scene, moving)[0]
    return system, ma.evaluate(system, 0.0, moving)


def resultants(scene: ma.Scene, ev: ma.Evaluation) -> dict[str, np.ndarray]:
    """Of the contact forces on each object by Newton and Euler, in its axes."""
    wrenches = {}
    for name, spec in scene.all_objects.items():
        moving, a = ev.state.objects[name], ev.object_accelerations[name]
        R, omega = Rotation.from_quat(moving.quaternion_xyzw).as_matrix(), moving.twist[3:]
        size, m = np.array(spec.shape.box), spec.mass
        moments = m / 12.0 * (size @ size - size**2)
        inertia = R @ np.diag(moments) @ R.T
        moment = inertia @ a[3:] + np.cross(omega, inertia @ omega)
        wrenches[name] = np.concatenate([R.T @ (m * (a[:3] + [0, 0, GRAVITY])), R.T @ moment])
    return wrenches


def test_forces_are_split_by_what_moves_any_object(stack):
    system, ev = stack
    parts, forces = ev.force_decomposition(), ev.contact_forces
    assert ev.W_o.shape == (12, 18) and ev.internal_forces().count == 6
    for name, wrench in resultants(system.scene, ev).items():
        np.testing.assert_allclose(parts.resultants[name], wrench, atol=1e-8)
    stacked = [np.concatenate(list(part.values())) for part in (parts.moving, parts.squeezing)]
    together = np.concatenate([forces[name] for name in parts.moving])
    np.testing.assert_allclose(ev.W_o @ together, np.hstack([*parts.resultants.values()]))
    least = np.linalg.pinv(ev.W_o) @ (ev.W_o @ together)
    np.testing.assert_allclose(stacked[0], least, atol=1e-8)
    np.testing.assert_allclose(stacked[0] + stacked[1], together, atol=1e-9)
    np.testing.assert_allclose(parts.squeezing["upper-lower"], 0.0, atol=1e-8)
    with pytest.raises(ModelError, match="2 objects, lower, upper"):
        _ = parts.wrench


@pytest.mark.parametrize("name, count", [("lower", 12), ("upper", 0)])
def test_forces_are_split_by_what_moves_one_object(stack, name, count):
    system, ev = stack
    parts = ev.force_decomposition(object=name)
    assert ev.internal_forces(object=name).count == count
    np.testing.assert_allclose(
        parts.resultants[name], resultants(system.scene, ev)[name], atol=1e-8
    )
    expected = {"lower": ["left", "right", "upper-lower"], "upper": ["upper-lower"]}
    assert list(parts.squeezing) == expected[name]
    with pytest.raises(ModelError, match="unknown object 'midle'"):
        ev.internal_forces(object="midle")


def test_objects_that_nothing_touches_have_no_internal_forces():
    scene = objects_scene({"ball": body(1.0, [0.1] * 3, [0, 0, 2.0])}, [])
    scene |= {"robots": {name: {**spec} for name, spec in ASIDE.items()}}
    ev = node({**scene, "gravity": [0.0, 0.0, -GRAVITY]})
    parts = ev.force_decomposition()
    assert parts.internal.count == 0 and parts.squeezing == {}
    np.testing.assert_array_equal(parts.wrench, np.zeros(6))
