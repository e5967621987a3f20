"""Runs of scenes with several objects: what is recorded, certified, stored and refused."""

from __future__ import annotations

import h5py
import numpy as np
import pytest
from recorded_objects import GRAVITY, HINGE, ON_PLATE, START, TWIST, boxes_on_a_floor, thrown_ball
from refusals import refused
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import multiarm as ma
from multiarm.cli import app
from multiarm.errors import ModelError, SweepError, TrajectoryError
from multiarm.grasp.scenes.judging import read_grasp
from multiarm.scene import dump_scene, parse_scene
from multiarm.simulation.comparison import sample_state
from multiarm.studies.peers import make_peers
from multiarm.sweeps.plan import make_plan
from multiarm.sweeps.quantities import measure


@pytest.fixture(scope="module")
def system() -> ma.System:
    return ma.compile_system(parse_scene(thrown_ball()))


@pytest.fixture(scope="module")
def stored(system, tmp_path_factory):
    """The certified run, and its file."""
    path = tmp_path_factory.mktemp("objects") / "run.h5"
    return ma.simulate(system, out=path), path


@pytest.fixture(scope="module")
def on_floor() -> ma.Trajectory:
    return ma.simulate(ma.compile_system(parse_scene(boxes_on_a_floor())))


# --- what is recorded ---------------------------------------------------------------------------


def test_a_ball_that_nothing_holds_falls_as_galileo_has_it(stored):
    run, _ = stored
    ball, t = run.objects["ball"], run.time[:, None]
    np.testing.assert_allclose(
        ball.position, START + TWIST[:3] * t + 0.5 * GRAVITY * t**2, atol=1e-9
    )
    np.testing.assert_allclose(ball.twist[:, :3], TWIST[:3] + GRAVITY * t, atol=1e-9)
    np.testing.assert_allclose(ball.twist[:, 3:], np.tile(TWIST[3:], (len(t), 1)), atol=1e-9)
    turned = Rotation.from_rotvec(TWIST[3:] * t)
    assert np.max((Rotation.from_quat(ball.quaternion_xyzw) * turned.inv()).magnitude()) < 1e-8


def test_the_hinge_between_two_objects_is_closed_in_the_recorded_poses(stored):
    run, _ = stored
    beam, plate = run.objects["beam"], run.objects["plate"]
    on_beam = beam.position + Rotation.from_quat(beam.quaternion_xyzw).apply(HINGE)
    on_plate = plate.position + Rotation.from_quat(plate.quaternion_xyzw).apply(ON_PLATE)
    np.testing.assert_allclose(on_plate, on_beam, atol=1e-10)
    axes = [Rotation.from_quat(o.quaternion_xyzw).apply([0.0, 1.0, 0.0]) for o in (beam, plate)]
    np.testing.assert_allclose(axes[0], axes[1], atol=1e-10)
    # the plate swings on it
    assert np.ptp(run.relative_position["plate-beam"]) > 0.05


def test_the_state_of_a_sample_has_the_motions_of_all_objects(system, stored):
    run, _ = stored
    state = sample_state(system.model.layout, run, 3)
    for name, motion in state.objects.items():
        np.testing.assert_array_equal(motion.position, run.objects[name].position[3])
        np.testing.assert_array_equal(motion.twist, run.objects[name].twist[3])
    ev = ma.evaluate(system, run.time[3], state)
    np.testing.assert_allclose(ev.wrenches["plate-beam"], run.wrenches["plate-beam"][3], rtol=1e-9)
    np.testing.assert_allclose(ev.wrenches["left"], run.wrenches["left"][3], rtol=1e-9)


def test_the_floor_carries_each_object(on_floor):
    assert on_floor.status == "completed", on_floor.message
    assert list(on_floor.wrenches) == ["left", "floor/held", "floor/light", "floor/heavy"]
    for name, mass in (("held", 0.0), ("light", 2.0), ("heavy", 5.0)):
        weight = [0.0, 0.0, 9.81 * mass, 0.0, 0.0, 0.0]
        wrench = on_floor.wrenches[f"floor/{name}"]
        np.testing.assert_allclose(wrench, np.tile(weight, (len(wrench), 1)), atol=1e-9)
        normal = on_floor.contact_forces[f"floor/{name}"].sum(axis=1)
        np.testing.assert_allclose(normal, 9.81 * mass, atol=1e-9)
    assert set(on_floor.contact_states["floor/held"].flat) == {0.0}
    assert set(on_floor.contact_states["floor/light"][-1]) == {0.0, 3.0}  # above, and below


def test_a_stepper_has_the_floor_of_each_object():
    stepper = ma.Stepper(ma.compile_system(parse_scene(boxes_on_a_floor())))
    stepper.advance(1e-3)
    assert stepper.wrenches["floor/heavy"][2] == pytest.approx(49.05, rel=1e-9)
    assert stepper.state.objects["light"].position[2] == pytest.approx(0.1, abs=1e-9)


# --- certificates -------------------------------------------------------------------------------


def test_a_certificate_judges_every_object(stored):
    run, _ = stored
    certificate = run.certificate
    assert certificate["met"], certificate["text"]
    errors = certificate["by_output"]
    assert {f"{name}: object position" for name in run.objects} <= errors.keys()
    worst = max(output["error"] for output in errors.values() if output["unit"] == "m")
    assert certificate["estimated_error"]["position_m"] == pytest.approx(worst, abs=1e-13)
    # the ball's true error is below its estimate
    ball, t = run.objects["ball"], run.time[:, None]
    truth = START + TWIST[:3] * t + 0.5 * GRAVITY * t**2
    true_error = np.max(np.linalg.norm(ball.position - truth, axis=1))
    assert true_error <= errors["ball: object position"]["error"]
    assert set(certificate["checks"]) == {"energy", "residual", "drift"}


# --- files --------------------------------------------------------------------------------------


def test_a_stored_run_knows_its_objects(stored, tmp_path):
    run, path = stored
    loaded = ma.load_trajectory(path)
    assert list(loaded.objects) == ["beam", "ball", "plate"]
    assert list(loaded.scene.all_objects) == list(loaded.objects)
    for name, motion in loaded.objects.items():
        np.testing.assert_array_equal(motion.twist, run.objects[name].twist)
    with h5py.File(path) as file:
        assert list(file["objects"]) == ["ball", "beam", "plate"] and "object" not in file
    with refused(TrajectoryError, "beam, ball, plate"):
        _ = loaded.object_position


def test_one_object_by_name_is_stored_as_the_one_of_object(tmp_path):
    scene = thrown_ball()
    beam = scene.pop("objects")["beam"]
    scene["joints"] = [{"arm": "left", "kind": "weld", "at": {"xyz": [-0.2, 0.0, 0.0]}}]
    runs = []
    for key, part in (("object", beam), ("objects", {"beam": beam})):
        system, path = ma.compile_system(parse_scene({**scene, key: part})), tmp_path / f"{key}.h5"
        ma.simulate(system, 0.1, integrator="dop853", tolerance=1e-8, out=path)
        runs.append(ma.load_trajectory(path))
    one, named = runs
    assert list(one.objects) == ["object"] and list(named.objects) == ["beam"]
    assert list(one.channels) == list(named.channels)
    for name in one.channels:
        np.testing.assert_array_equal(one.channel(name), named.channel(name))
    np.testing.assert_array_equal(named.objects["beam"].position, one.object_position)


def test_run_check_and_report_show_every_object(stored, tmp_path):
    _, path = stored
    scene = tmp_path / "scene.yaml"
    scene.write_text(dump_scene(ma.load_trajectory(path).scene))
    shown = CliRunner().invoke(app, ["check", str(scene)])
    assert shown.exit_code == 0, shown.output
    for words in ("6 of each object", "inertia of plate", "Connections", "left-"):
        assert words in shown.output
    page = tmp_path / "report.html"
    assert CliRunner().invoke(app, ["report", str(path), "--html", str(page)]).exit_code == 0
    text = page.read_text()
    assert "Objects" in text and "ball: Position of the centre of mass" in text


# --- studies and what needs one object ----------------------------------------------------------


def test_sweeps_measure_the_largest_over_the_objects(stored):
    run, _ = stored
    numbers, fault = measure(["largest_speed", "final_position_error"], run)
    speeds = [np.linalg.norm(o.twist[:, :3], axis=1).max() for o in run.objects.values()]
    moved = [np.linalg.norm(o.position[-1] - o.position[0]) for o in run.objects.values()]
    assert fault == ""
    assert numbers["largest_speed"] == pytest.approx(max(speeds), rel=1e-15)
    assert numbers["final_position_error"] == pytest.approx(max(moved), rel=1e-15)


def test_a_sweep_refuses_quantities_of_the_object():
    scene = parse_scene(thrown_ball())
    with refused(SweepError, "keep", "final_x"):
        make_plan(scene, {"objects.ball.mass": [1.0, 2.0]}, keep=["final_x", "steps"])


def test_what_is_of_one_object_says_so(system):
    state = system.initial_state()
    with refused(ModelError, "beam, ball, plate"):
        ma.inverse_dynamics(system, state, np.zeros(6))
    with refused(ModelError, "beam, ball, plate"):
        read_grasp(system)
    peers, refusals = make_peers(system)
    assert peers == {} and "beam, ball, plate" in refusals["Pinocchio"]
