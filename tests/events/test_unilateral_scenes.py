"""Scenes whose contacts come and go: what is refused, and everything else that takes a system."""

from __future__ import annotations

import numpy as np
import pytest
from commands import multiarm
from event_scenes import ball, on_floor
from loose_scenes import ball_on_cart, body_and_cart, cart_with_box, happened
from mechanics import ur5_pair
from repository import SCENES

import multiarm as ma
from multiarm.dynamics.status import OK
from multiarm.events.evaluation import enter_mode_at, evaluate_mode
from multiarm.integration.projection import project
from multiarm.simulation.inspection import inspect_system

GRAVITY = 9.81


def corner_pair():
    """Two corner grippers that hold a block between them."""
    return ma.load_scene(SCENES / "corner_grippers_block.yaml")


# --- what is refused, and what is warned of -------------------------------------------------------


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        ({"contact_friction": -0.1}, "$.effects.contact_friction.mu: must be at least 0"),
        (
            {"unilateral_contacts": {"restitution": 1.2}},
            "$.effects.unilateral_contacts.restitution",
        ),
        ({"contact_compliance": -1.0}, "$.effects.contact_compliance.stiffness: must be greater"),
        (
            {"contact_compliance": {"stiffness": 1.0, "damping": -1.0}},
            "$.effects.contact_compliance.damping: must be at least 0",
        ),
        (
            {"contact_friction": {"mu": 0.3, "contacts": ["crat"]}},
            "$.effects.contact_friction.contacts[0]: unknown arm 'crat'; did you mean 'cart'?",
        ),
        (
            {"contact_friction": {"mu": 0.3, "contacts": ["cart/plat"]}},
            "$.effects.contact_friction.contacts[0]: unknown contact 'cart/plat'; did you mean "
            "'cart/plate'?",
        ),
        (
            {"unilateral_contacts": {"contacts": []}},
            "$.effects.unilateral_contacts.contacts: is empty",
        ),
        (
            {"contact_friction": 0.3, "contact_compliance": 1e4},
            "contact 'cart/plate' has friction ('mu' or contact_friction), which needs a rigid",
        ),
    ],
)
def test_bad_effects_are_told_with_place_and_remedy(tmp_path, effects, words):
    with pytest.raises(ma.MultiarmError) as caught:
        ma.compile_system(ma.Scene(**ball_on_cart(tmp_path, effects)))
    assert words in str(caught.value)


def test_contacts_that_also_pull_cannot_let_go(tmp_path):
    effects = {"unilateral_contacts": {"contacts": ["cart"]}}
    with pytest.raises(ma.MultiarmError, match="has no contact that only pushes"):
        ma.compile_system(ma.Scene(**cart_with_box(tmp_path, effects)))


def test_effects_of_pushing_contacts_are_warned_of_where_there_are_none(tmp_path):
    for effects in ({"unilateral_contacts": {}}, {"contact_friction": 0.3}):
        scene = ma.Scene(**cart_with_box(tmp_path, effects))
        assert any("adds nothing" in line for line in scene.warnings)
        assert ma.compile_system(scene).model.unilateral is None


def test_rolling_contacts_cannot_let_go(tmp_path):
    data = ball_on_cart(tmp_path, {"unilateral_contacts": {}})
    data["joints"][0]["contacts"][0]["rolling"] = True
    with pytest.raises(ma.MultiarmError, match=r"contact 'cart/plate' rolls"):
        ma.compile_system(ma.Scene(**data))


def test_the_variational_method_is_refused_in_words(tmp_path):
    scene = ma.Scene(**ball_on_cart(tmp_path, {"contact_friction": 0.3}))
    with pytest.raises(ma.MultiarmError, match="'variational' takes its steps as wholes"):
        ma.simulate(ma.compile_system(scene), integrator="variational", step=1e-3)
    run = {"duration": 1.0, "integrator": "variational", "step": 1e-3}
    with pytest.raises(ma.MultiarmError, match="'variational' takes its steps as wholes"):
        scene.replace(run=run)


def test_a_start_inside_a_surface_is_refused(tmp_path):
    effects = {"unilateral_contacts": {"start": "as_written"}}
    data = ball_on_cart(tmp_path, effects, height=-0.02)
    with pytest.raises(ma.MultiarmError) as caught:
        ma.compile_system(ma.Scene(**data))
    assert "'cart/plate' is inside the arm's surface by 0.02 m" in str(caught.value)


# --- evaluations ----------------------------------------------------------------------------------


def sliding_box(tmp_path, **more):
    body = {
        "shape": {"box": [0.4, 0.3, 0.2]},
        "mass": 2.0,
        "pose": {"xyz": [0, 0, 0.1]},
        "twist": [1.0, 0, 0, 0, 0, 0],
    }
    return body_and_cart(tmp_path, body, {"floor": {"mu": 0.3}}, **more)


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_no_force_of_four_sliding_feet_is_unique(tmp_path, yaw):
    """However the box stands: of the four feet on one plane any takes over what others leave."""
    scene = sliding_box(tmp_path)
    scene["object"]["pose"]["rpy"] = [0, 0, yaw]
    evaluation = ma.evaluate(ma.compile_system(ma.Scene(**scene)))
    down = np.array(evaluation.contact_states["floor"]) == "sliding"
    assert down.sum() == 4 and evaluation.rank == 3
    assert not np.any(evaluation.contact_forces_unique["floor"].reshape(8, 3)[down])


def test_an_evaluation_of_a_sliding_box_certifies_itself(tmp_path):
    system = ma.compile_system(ma.Scene(**sliding_box(tmp_path)))
    evaluation = ma.evaluate(system)
    forces = evaluation.contact_forces["floor"].reshape(8, 3)
    assert evaluation.object_acceleration[0] == pytest.approx(-0.3 * GRAVITY, abs=1e-9)
    np.testing.assert_allclose(evaluation.object_acceleration[1:], 0.0, atol=1e-9)
    assert forces[:, 0].sum() == pytest.approx(2.0 * GRAVITY, abs=1e-9)
    down = np.array(evaluation.contact_states["floor"]) == "sliding"
    assert down.sum() == 4
    np.testing.assert_allclose(np.linalg.norm(forces[down, 1:], axis=1), 0.3 * forces[down, 0])
    assert np.all(forces[~down] == 0.0)
    assert evaluation.residuals.object < 1e-12 and evaluation.residuals.constraint < 1e-12
    assert not np.any(evaluation.contact_forces_unique["floor"].reshape(8, 3)[down])
    assert np.all(evaluation.contact_forces_unique["floor"].reshape(8, 3)[~down])
    # the points are the corners, the normals those of the floor
    points = evaluation.contact_points["floor"].reshape(8, 3, 3)
    np.testing.assert_allclose(np.abs(points[:, 0, :2]), [[0.2, 0.15]] * 8, atol=1e-12)
    np.testing.assert_allclose(
        evaluation.contact_normals["floor"].reshape(8, 3, 3)[:, 0], [[0, 0, 1]] * 8, atol=1e-12
    )


@pytest.mark.parametrize("slides", [True, False])
@pytest.mark.parametrize("solver", ["node", "dense"])
def test_given_forces_of_a_mode_are_forces_of_its_contacts(tmp_path, slides, solver):
    """Others than the least ones: the same motion, and the equations hold with their sum."""
    scene = sliding_box(tmp_path)
    if not slides:
        scene["object"] = {**scene["object"], "twist": [0.0] * 6}
    system = ma.compile_system(ma.Scene(**scene)).with_solver(solver)
    state = system.initial_state()
    least = ma.evaluate(system, 0.0, state)
    with system.borrow() as data:
        modes = enter_mode_at(data, 0.0, state)
        given = {int(row): (2.0 + k) ** 2 for k, row in enumerate(modes.data.rows)}
        modes.set_prestress(given)
        evaluation = evaluate_mode(modes, 0.0, state)
    changes = evaluation.contact_forces["floor"] - least.contact_forces["floor"]
    assert np.max(np.abs(changes)) > 0.1
    np.testing.assert_allclose(
        evaluation.object_acceleration, least.object_acceleration, rtol=0, atol=1e-10
    )
    assert evaluation.residuals.object < 1e-12 and evaluation.residuals.arm < 1e-12


@pytest.mark.parametrize("bodies", ["ball on the floor", "box on a cart"])
def test_projections_of_sliding_contacts_are_without_friction(tmp_path, bodies):
    """With both solvers to the same state; a ball off the floor along the normal alone."""
    ball_slides = on_floor(ball(twist=[1.0, 0.5, 0, 0, 0, 0]), mu=0.3)
    scene = ball_slides if bodies == "ball on the floor" else ma.Scene(**sliding_box(tmp_path))
    states = []
    for solver in ("node", "dense"):
        system = ma.compile_system(scene).with_solver(solver)
        with system.borrow() as data:
            sliding = enter_mode_at(data, 0.0, system.initial_state()).data
            raised = sliding.get_state()
            raised.object_position[2] += 1e-3
            raised.object_twist[2] += 1e-2
            sliding.move_to(raised)
            assert project(sliding.struct, 1e-12) == OK
            states.append(sliding.get_state())
    node, dense = states
    np.testing.assert_allclose(dense.position, node.position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(dense.velocity, node.velocity, rtol=0, atol=1e-13)
    if bodies == "ball on the floor":
        np.testing.assert_allclose(dense.object_twist[:2], [1.0, 0.5], rtol=0, atol=1e-15)


def test_evaluations_are_those_of_the_run(tmp_path):
    """At samples of a run, away from events: same accelerations as differences, same forces."""
    system = ma.compile_system(ma.Scene(**sliding_box(tmp_path)))
    trajectory = ma.simulate(system, duration=0.5, certificate=False)
    assert {event["kind"] for event in happened(trajectory)} == {"sticks"}
    early = int(np.searchsorted(trajectory.time, 0.1))
    for k in (early, len(trajectory.time) - 1):
        state = system.state(
            object_position=trajectory.object_position[k],
            object_quaternion_xyzw=trajectory.object_quaternion_xyzw[k],
            object_twist=trajectory.object_twist[k],
            joint_positions={"cart": trajectory.joint_positions["cart"][k]},
            joint_velocities={"cart": trajectory.joint_velocities["cart"][k]},
        )
        evaluation = ma.evaluate(system, trajectory.time[k], state)
        recorded = trajectory.contact_forces["floor"][k].reshape(8, 3)
        found = evaluation.contact_forces["floor"].reshape(8, 3)
        np.testing.assert_allclose(found.sum(axis=0), recorded.sum(axis=0), atol=1e-6)


@pytest.mark.parametrize("solver", ["node", "dense"])
def test_both_solvers_carry_such_scenes(tmp_path, solver):
    data = sliding_box(tmp_path)
    trajectory = ma.simulate(
        ma.compile_system(ma.Scene(**data)),
        duration=0.5,
        solver=solver,
        accuracy=1e-7,
        certificate=False,
    )
    assert trajectory.status == "completed", trajectory.message
    rest = 1.0 / (0.3 * GRAVITY)
    assert happened(trajectory)[-1]["time"] == pytest.approx(rest, abs=1e-7)
    assert trajectory.object_position[-1, 0] == pytest.approx(0.5 * rest, abs=1e-7)


def test_inverse_dynamics_reckons_with_all_contacts_of_the_joints():
    scene = corner_pair()
    loose = scene.replace(effects={"unilateral_contacts": {}, "contact_friction": 0.2})
    wanted = [0.1, -0.2, 0.3, 0.1, 0.0, -0.1]
    results = []
    for each in (scene, loose):
        system = ma.compile_system(each)
        results.append(ma.inverse_dynamics(system, system.initial_state(), wanted))
    for arm, torques in results[0].torques.items():
        np.testing.assert_allclose(results[1].torques[arm], torques, atol=1e-9)


def test_analyses_of_an_evaluation_are_those_of_all_contacts():
    scene = corner_pair()
    loose = scene.replace(effects={"contact_friction": 0.2})
    rigid, free = (ma.evaluate(ma.compile_system(each)) for each in (scene, loose))
    assert free.internal_forces().basis.shape == rigid.internal_forces().basis.shape
    for arm in rigid.contact_terms:
        np.testing.assert_allclose(free.contact_terms[arm].W_o, rigid.contact_terms[arm].W_o)
        assert free.motion_space(arm).T.shape == rigid.motion_space(arm).T.shape
    parts = free.force_decomposition()
    assert set(parts.moving) == set(rigid.contact_terms)


# --- the command line -----------------------------------------------------------------------------


def test_check_tells_what_comes_and_goes(tmp_path):
    system = ma.compile_system(ma.Scene(**sliding_box(tmp_path)))
    found = inspect_system(system)
    assert "floor: contacts with friction (8)" in found.coming_and_going
    assert found.freedom.mobility == 6  # the box is free but for the fingertip far above


@pytest.mark.slow
def test_the_commands_take_such_scenes(tmp_path):
    from multiarm.scene import dump_scene

    path = tmp_path / "box.yaml"
    path.write_text(dump_scene(ma.Scene(**sliding_box(tmp_path, run={"duration": 0.2}))))
    checked = multiarm("check", path)
    assert checked.exit_code == 0, checked.output
    assert "unilateral" in checked.output
    ran = multiarm("run", path, "--out", tmp_path / "box.h5")
    assert ran.exit_code == 0, ran.output
    loaded = ma.load_trajectory(tmp_path / "box.h5")
    assert loaded.contact_forces["floor"].shape[1] == 24
    ma.report(loaded, tmp_path / "box.html")
    assert (tmp_path / "box.html").stat().st_size > 1000


# --- control --------------------------------------------------------------------------------------


def test_corner_grippers_hold_a_box_that_is_squeezed():
    scene = corner_pair().replace(
        effects={"unilateral_contacts": {}},
        control={
            "kind": "object_impedance",
            "stiffness": {"translation": 2000.0, "rotation": 200.0},
            "damping": {"translation": 300.0, "rotation": 30.0},
            "squeeze": 400.0,
        },
    )
    trajectory = ma.simulate(ma.compile_system(scene), duration=0.5, accuracy=1e-5)
    assert trajectory.status == "completed", trajectory.message
    assert not [event for event in happened(trajectory) if event["kind"] == "lets go"]
    for arm in ("left", "right"):
        assert np.all(trajectory.contact_forces[arm] > 0.0)
    assert np.max(np.abs(np.diff(trajectory.object_position, axis=0))) < 1e-3


def test_corner_grippers_without_a_squeeze_lose_the_box():
    scene = corner_pair().replace(effects={"unilateral_contacts": {}}, control={"kind": "none"})
    trajectory = ma.simulate(ma.compile_system(scene), duration=0.2, accuracy=1e-5)
    assert any(event["kind"] == "lets go" for event in happened(trajectory))
    for arm in ("left", "right"):
        assert np.min(trajectory.contact_forces[arm]) > -1e-6


def test_compliant_ur5_grasps_can_be_checked():
    scene = ur5_pair({"kind": "weld"}, {"kind": "ball"}).replace(
        effects={"contact_compliance": {"stiffness": 1e5, "contacts": ["right"]}}
    )
    found = inspect_system(ma.compile_system(scene))
    assert "springs in place of contacts (3)" in found.coming_and_going
    assert found.freedom.rank == 9
