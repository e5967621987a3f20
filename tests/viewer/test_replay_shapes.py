"""Meshes, animations and the camera of a replay: geometry, checked against closed forms."""

import gzip
import importlib.metadata
import json
import re
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pytest
from refusals import refused

from multiarm.errors import ReplayError
from multiarm.geometry.triangle_mesh import merge, shade, sharp_edges
from multiarm.scene import ObjectSpec
from multiarm.viewer import drawing, page, sight
from multiarm.viewer.animate import frame_rows
from multiarm.viewer.animation import Animation, Body, ContactTracks, along, continuous, rotations
from multiarm.viewer.drawing import draw
from multiarm.viewer.shapes import object_mesh
from multiarm.viewer.solids import SEGMENTS, box, capsule, cone, cylinder, sphere

POLYGON = SEGMENTS / 2 * np.sin(2 * np.pi / SEGMENTS)  # area of the polygon in a unit circle


def robot_mesh(name):
    files = importlib.metadata.files("example-robot-data")
    return Path(next(f for f in files if str(f).endswith(name)).locate())


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box([0.3, 0.5, 0.7]), 0.3 * 0.5 * 0.7),
        (cylinder(0.2, 0.9), POLYGON * 0.2**2 * 0.9),
        (cone(0.2, 0.9), POLYGON * 0.2**2 * 0.9 / 3),
    ],
)
def test_flat_faced_solids_enclose_their_exact_volume(mesh, expected):
    assert volume(mesh) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (sphere(0.4), 4 / 3 * np.pi * 0.4**3),
        (capsule(0.4, 0.5), 4 / 3 * np.pi * 0.4**3 + np.pi * 0.4**2 * 0.5),
    ],
)
def test_round_solids_lie_inside_and_near_their_volume(mesh, expected):
    assert 0.98 * expected < volume(mesh) < expected


def test_mirroring_keeps_the_outside_out():
    mirrored = box([0.3, 0.5, 0.7]).scaled(np.array([1.0, -2.0, 1.0]))
    assert volume(mirrored) == pytest.approx(2 * 0.3 * 0.5 * 0.7)


def test_box_keeps_sharp_edges():
    shaded = shade(box([0.3, 0.5, 0.7]))
    assert len(shaded.vertices) == 24  # three normals at each of eight corners
    np.testing.assert_allclose(np.sort(np.abs(shaded.normals)), np.tile([0, 0, 1.0], (24, 1)))


def test_sphere_is_shaded_as_if_it_were_round():
    shaded = shade(sphere(0.4))
    cosines = np.einsum("ij,ij->i", shaded.normals, shaded.vertices) / 0.4
    assert cosines.min() > np.cos(np.deg2rad(2))


def test_sharp_edges_are_those_that_one_would_draw():
    assert len(sharp_edges(box([0.3, 0.5, 0.7]))) == 12
    assert len(sharp_edges(cylinder(0.2, 0.9))) == 2 * SEGMENTS
    assert len(sharp_edges(sphere(0.4))) == 0


def test_shading_keeps_surface_and_colours():
    two = merge([box([1, 1, 1]).painted(np.array([1.0, 0, 0])), sphere(1.0)])
    shaded = shade(two)
    assert volume(shaded) == pytest.approx(volume(two))
    red = np.all(shaded.colors == [1, 0, 0], axis=1)
    assert red.sum() == 24


def test_object_with_a_lost_mesh_is_shown_as_the_box_of_its_inertia(tmp_path):
    mass, sides = 3.0, np.array([0.2, 0.5, 0.9])
    inertia = mass / 12 * (sum(sides**2) - sides**2)
    lost = {"mesh": {"file": tmp_path / "lost.stl"}}
    with pytest.warns(UserWarning, match="lost.stl"):
        stand_in = object_mesh(ObjectSpec(shape=lost, mass=mass, inertia=list(inertia)))
    np.testing.assert_allclose(np.ptp(stand_in.vertices, axis=0), sides, rtol=1e-9)
    assert volume(stand_in) == pytest.approx(np.prod(sides))


def test_object_mesh_is_read_and_scaled():
    wrist = {"mesh": {"file": robot_mesh("ur5/collision/wrist3.stl"), "scale": [1, 2, 3]}}
    shape = ObjectSpec(shape=wrist, mass=1.0, inertia=[1, 1, 1])
    plain = coal.MeshLoader().load(str(robot_mesh("ur5/collision/wrist3.stl")), np.ones(3))
    expected = np.ptp(plain.vertices(), axis=0) * [1, 2, 3]
    np.testing.assert_allclose(np.ptp(object_mesh(shape).vertices, axis=0), expected, rtol=1e-5)


def test_directions_that_reverse_are_followed_without_a_jump():
    angle = np.linspace(0, 2 * np.pi, 60)
    circle = np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])
    cone = np.column_stack([0.6 * np.sin(angle), 0.6 * np.cos(angle), 0.8 + 0 * angle])
    directions = np.stack([circle, -circle, cone], axis=1)
    quaternions = along(directions)
    for k in range(3):
        turned = rotations(quaternions[:, k])[:, :, 2]
        np.testing.assert_allclose(turned, directions[:, k], atol=1e-12)
    assert np.abs(np.diff(quaternions, axis=0)).max() < 0.06  # half the angle between frames


def test_direction_may_flip_from_one_frame_to_the_next():
    flip = np.array([[[0, 0, 1.0]], [[0, 0, -1.0]]])
    np.testing.assert_allclose(rotations(along(flip)[:, 0])[:, :, 2], flip[:, 0], atol=1e-12)


def test_quaternion_signs_do_not_flip_between_frames():
    angle = np.linspace(0, 8, 50)
    smooth = np.column_stack([0 * angle, 0 * angle, np.sin(angle / 2), np.cos(angle / 2)])
    flipped = smooth * np.where(np.arange(50) % 3 == 0, -1, 1)[:, None]
    result = continuous(flipped)
    np.testing.assert_allclose(result, -smooth)  # the first frame was flipped


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_camera_holds_all_points_and_uses_the_picture(size):
    points = size * (np.random.default_rng(3).normal(size=(200, 3)) * [2, 1, 0.5] + [7, -3, 1])
    view = drawing.frame(points)
    towards, right, up = sight.view_axes(sight.AZIMUTH, sight.ELEVATION)
    np.testing.assert_allclose(view.target - view.position, view.distance * towards, rtol=1e-9)
    depth = (points - view.position) @ towards
    tan_y = np.tan(np.deg2rad(drawing.FIELD_OF_VIEW) / 2)
    across = np.abs((points - view.position) @ right / depth).max() / (tan_y * drawing.ASPECT)
    upward = np.abs((points - view.position) @ up / depth).max() / tan_y
    assert max(across, upward) < 0.95
    assert max(across, upward) > 0.75


def test_frames_are_samples_near_the_wanted_rate():
    time = np.sort(np.random.default_rng(5).uniform(0, 4, 3000))
    rows = frame_rows(time, 30.0)
    assert rows[0] == 0 and rows[-1] == len(time) - 1
    assert np.all(np.diff(time[rows]) > 0)
    np.testing.assert_allclose(np.diff(time[rows]), 1 / 30, atol=0.01)


def test_coarse_samples_are_all_shown():
    np.testing.assert_array_equal(frame_rows(np.arange(5) * 0.5, 30.0), np.arange(5))
    np.testing.assert_array_equal(frame_rows(np.array([2.0]), 30.0), [0])


def test_endless_run_is_thinned_with_a_warning():
    with pytest.warns(UserWarning, match="one every 0.6 s"):
        rows = frame_rows(np.linspace(0, 3600, 40000), 30.0)
    assert len(rows) == 6000


def test_trajectory_without_samples_is_refused():
    with refused(ReplayError):
        frame_rows(np.zeros(0), 30.0)


def still(frames):
    return np.zeros((frames, 3)), np.tile([0.0, 0, 0, 1], (frames, 1))


def push_and_pull():
    """A box on which one contact at x = -0.5 pushes with 8 N, then pulls with 4 N."""
    position, quaternion = still(3)
    shape = Body("object", box([1, 1, 1]), position, quaternion, np.ones(3), 0.6)
    point = np.tile([-0.5, 0, 0], (3, 1, 1))
    normal = np.tile([1.0, 0, 0], (3, 1, 1))
    force = np.array([[8.0], [0.0], [-4.0]])
    contact = ContactTracks("left", np.array([0.2, 0.4, 0.8]), point, normal, force)
    return Animation("push and pull", np.array([0.0, 1.0, 2.0]), [shape], [contact])


def tracks(commands):
    animation = next(c for c in commands if c["type"] == "set_animation")
    return {
        (item["path"].removeprefix("/world"), track["name"]): track["values"].reshape(3, -1)
        for item in animation["animations"]
        for track in item["clip"]["tracks"]
    }


def heights(commands, path):
    """Lowest and highest z of the mesh at a path of the contact frame."""
    shape = next(c for c in commands if c["type"] == "set_object" and c["path"].endswith(path))
    points = shape["object"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    return points[2::3].min(), points[2::3].max()


def test_pushing_arrow_ends_at_the_contact_and_pulling_arrow_begins_there():
    commands = draw(push_and_pull())
    widest = {}
    for kind in ("push", "pull"):
        low, high = heights(commands, f"/forces/left/1/{kind}")
        assert low < 0 and high == pytest.approx(0, abs=1e-6)  # outside the object
        widest[kind] = widest_height(commands, f"/forces/left/1/{kind}") / low
    assert widest["push"] < 0.5 < widest["pull"]  # where the head is, from contact to far end
    moved = tracks(commands)
    push = moved["/forces/left/1/push", ".scale"][:, 2]
    pull = moved["/forces/left/1/pull", ".scale"][:, 2]
    np.testing.assert_allclose(push, [1, 0, 0], atol=2e-4)
    np.testing.assert_allclose(pull, [0, 0, 0.5], atol=2e-4)  # 4 N against 8 N


def widest_height(commands, path):
    """The z at which the mesh at a path is widest."""
    shape = next(c for c in commands if c["type"] == "set_object" and c["path"].endswith(path))
    points = shape["object"]["geometries"][0]["data"]["attributes"]["position"]["array"]
    x, y, z = points.reshape(-1, 3).T
    return z[np.argmax(np.hypot(x, y))]


def test_arrow_lengths_do_not_depend_on_the_unit_of_force():
    animation = push_and_pull()
    strong = replace(animation.contacts[0], force=1e6 * animation.contacts[0].force)
    weak, big = tracks(draw(animation)), tracks(draw(replace(animation, contacts=[strong])))
    assert weak.keys() == big.keys()
    for key, values in weak.items():
        np.testing.assert_allclose(values, big[key], rtol=1e-6)


def test_spike_does_not_shrink_all_other_arrows():
    animation = push_and_pull()
    force = np.full((100, 1), 8.0)
    force[50] = 8000.0
    shape = replace(animation.bodies[0], position=still(100)[0], quaternion_xyzw=still(100)[1])
    contact = ContactTracks("left", np.ones(3), np.zeros((100, 1, 3)), np.ones((100, 1, 3)), force)
    spiky = Animation("spike", np.arange(100.0), [shape], [contact])
    assert (spiky.force_scale, spiky.peak_force) == (8.0, 8000.0)
    np.testing.assert_allclose(spiky.arrow_lengths(contact), 1.0)
    assert animation.force_scale == animation.peak_force == 8.0
    scale = page.page_facts(spiky, 1.0)["scale"]
    assert scale == "longest arrow 8 N at a contact (peak 8000 N)"


def test_slow_motion_stretches_the_animation():
    animation = draw(push_and_pull(), speed=0.25)[-1]
    times = animation["animations"][0]["clip"]["tracks"][0]["times"]
    np.testing.assert_allclose(times, [0, 4, 8])


def test_standing_bodies_are_not_animated():
    assert not any(path == "/object" for path, _ in tracks(draw(push_and_pull())))


def payload(text):
    packed = re.search(r'id="payload">([^<]*)<', text).group(1)
    data = gzip.decompress(b64decode(packed))
    length = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + length]), data[8 + length + -length % 8 :]


def test_arms_of_a_kind_share_their_meshes_in_the_page():
    position, quaternion = still(1)
    mesh = sphere(0.3)
    facts = {"title": "one & <many>"}
    sizes = []
    for count in (1, 12):
        bodies = [
            Body(f"arms/{i}", mesh, position + i, quaternion, np.ones(3)) for i in range(count)
        ]
        text = page.render(draw(Animation("", np.zeros(1), bodies)), facts)
        assert "<title>one &amp; &lt;many&gt;</title>" in text
        document, block = payload(text)
        sizes.append(len(block))
        shown = [c for c in document["commands"] if c["path"].startswith("/world/arms")]
        assert len([c for c in shown if c["type"] == "set_object"]) == count
    grid = 1.6  # the floor differs a little with the extent of the scene
    assert sizes[1] < grid * sizes[0]


def test_page_refers_to_no_other_file_and_no_server():
    text = page.render(draw(push_and_pull()), {"title": "alone"})
    own = text.replace(page._viewer_script(), "")
    assert not re.findall(r"https?://|<link[^>]+href=\"(?!data:)|<script[^>]+src=", own)
