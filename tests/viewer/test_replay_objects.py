"""Replays of several objects: each with its shape, colour and motion, and joints between them."""

from __future__ import annotations

import numpy as np
import pytest
from recorded_objects import HINGE, boxes_on_a_floor, thrown_ball
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.scene import parse_scene
from multiarm.viewer.animate import animate, ground_bodies
from multiarm.viewer.animation import Animation, Body
from multiarm.viewer.contact_tracks import placed
from multiarm.viewer.drawing import draw
from multiarm.viewer.sight import clear_azimuth
from multiarm.viewer.solids import box, sphere

NAMES = ["beam", "ball", "plate"]


def run_of(scene: dict, duration: float) -> ma.Trajectory:
    system = ma.compile_system(parse_scene(scene))
    return ma.simulate(
        system, duration, integrator="dop853", tolerance=1e-8, output_step=0.02, certificate=False
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> ma.Trajectory:
    """As it is loaded from its file."""
    path = tmp_path_factory.mktemp("replay") / "run.h5"
    run_of(thrown_ball(), 0.2).save(path)
    return ma.load_trajectory(path)


@pytest.fixture(scope="module")
def animation(run) -> Animation:
    return animate(run, fps=50, speed=1, meshes=False)


def test_every_object_moves_as_it_did(run, animation):
    assert animation.objects == 3
    bodies = animation.bodies[:3]
    assert [body.name for body in bodies] == [f"objects/{name}" for name in NAMES]
    for body, name in zip(bodies, NAMES, strict=True):
        np.testing.assert_array_equal(body.position, run.objects[name].position)
        np.testing.assert_array_equal(body.quaternion_xyzw, run.objects[name].quaternion_xyzw)


def test_every_object_has_its_shape_and_colour(animation):
    beam, ball, plate = animation.bodies[:3]
    np.testing.assert_allclose(np.ptp(beam.mesh.vertices, axis=0), [0.4, 0.1, 0.1])
    np.testing.assert_allclose(np.linalg.norm(ball.mesh.vertices, axis=1), 0.1, rtol=1e-6)
    np.testing.assert_allclose(np.ptp(plate.mesh.vertices, axis=0), [0.3, 0.2, 0.02])
    np.testing.assert_allclose(plate.color, np.array([0x33, 0xAA, 0x55]) / 255.0)
    assert np.abs(beam.color - ball.color).max() > 0.1


def test_a_hinge_between_objects_travels_with_them(run, animation):
    hinge = next(hinge for hinge in animation.hinges if hinge.arm == "plate-beam")
    beam = run.objects["beam"]
    turned = Rotation.from_quat(beam.quaternion_xyzw)
    np.testing.assert_allclose(hinge.position, beam.position + turned.apply(HINGE), atol=1e-12)
    axes = Rotation.from_quat(hinge.quaternion_xyzw).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(axes, turned.apply([0.0, 1.0, 0.0]), atol=1e-12)


def test_contacts_between_objects_are_where_these_are(run, animation):
    tracks = {contacts.arm: contacts for contacts in animation.contacts}
    assert list(tracks) == ["left", "plate-beam"]
    np.testing.assert_array_equal(tracks["plate-beam"].force, run.contact_forces["plate-beam"])
    on_hinge = tracks["plate-beam"].point - tracks["plate-beam"].point[:, :1]
    assert np.abs(on_hinge).max() < 2.0  # they stay together


def test_each_object_has_its_contacts_with_the_floor_below_all_of_them():
    run = run_of(boxes_on_a_floor(), 0.04)
    animation = animate(run, fps=50, speed=1, meshes=False)
    tracks = {contacts.arm: contacts for contacts in animation.contacts}
    assert {"floor/light", "floor/heavy"} <= tracks.keys()
    for name, half in (("light", 0.1), ("heavy", 0.15)):
        away = tracks[f"floor/{name}"].point[0, :, :2] - run.objects[name].position[0, :2]
        np.testing.assert_allclose(np.abs(away), half, atol=1e-9)
    floor = next(body for body in animation.bodies if body.name == "floor")
    corners = floor.mesh.vertices + floor.position[0]
    for motion in run.objects.values():
        assert (corners[:, :2].min(axis=0) < motion.position[0, :2]).all()
        assert (motion.position[0, :2] < corners[:, :2].max(axis=0)).all()


def test_the_floor_lies_below_upright_robots_too():
    run, away, hung = run_of(boxes_on_a_floor(), 0.02), np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])
    away[:3, 3], hung[:3, 3] = [4.0, -3.0, 0.5], [0.0, 20.0, 3.0]

    def corners(feet):
        (floor,) = ground_bodies(run, np.array([0]), 0.1, feet)
        return (floor.mesh.vertices + floor.position[0])[:, :2]

    low, high = (np.min(corners({}), axis=0), np.max(corners({}), axis=0))
    assert high[0] < 4.0 and low[1] > -3.0
    wide = corners({"away": away, "hung": hung})
    np.testing.assert_allclose(wide.min(axis=0), [low[0], -3.2], rtol=1e-9)
    np.testing.assert_allclose(wide.max(axis=0), [4.2, high[1]], rtol=1e-9)


# --- from where they are seen ---------------------------------------------------------------------


def staged(*walls: tuple[float, float]) -> Animation:
    """A ball at the origin, and upright walls of a robot at places (x, y) that face it."""
    ball = Body("objects/ball", sphere(0.1), *placed([np.eye(4)]), np.ones(3))
    bodies = [ball]
    for k, (x, y) in enumerate(walls):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("z", np.arctan2(y, x)).as_matrix()
        pose[:2, 3] = x, y
        bodies.append(Body(f"arms/a/{k}", box([0.02, 0.6, 2.0]), *placed([pose]), np.ones(3)))
    return Animation("", np.zeros(1), bodies)


def ahead(turn: float) -> tuple[float, float]:
    """A place in front of the origin for a camera that is turned by an angle [deg]."""
    angle = np.deg2rad(-58.0 + turn)
    return 0.5 * np.cos(angle), 0.5 * np.sin(angle)


@pytest.mark.parametrize(
    ("walls", "turn"),
    [([], 0.0), ([180.0], 0.0), ([0.0], -60.0), ([0.0, -60.0], 60.0), ([-60, 0.0, 60], -120.0)],
    ids=["nothing before it", "behind it", "in front", "one beside", "both beside"],
)
def test_the_camera_looks_from_where_robots_do_not_hide_the_objects(walls, turn):
    azimuth = clear_azimuth(staged(*map(ahead, walls)))
    np.testing.assert_allclose(np.rad2deg(azimuth), -58.0 + turn)


def test_lights_are_turned_with_the_camera():
    def fill(animation):
        (light,) = [c for c in draw(animation) if c["path"] == "/Lights/Fill"]
        return np.array(light["object"]["object"]["matrix"][12:15])

    turned = Rotation.from_euler("z", -60.0, degrees=True).apply(fill(staged()))
    np.testing.assert_allclose(fill(staged(ahead(0.0))), turned, atol=1e-12)
