"""Joints in a replay: axes, limits and pointers, checked against poses and in a real browser."""

from __future__ import annotations

import numpy as np
import pytest
from replay_pages import POSE, SEEK, opened
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.contacts.joint import axis_travel
from multiarm.scene import parse_scene
from multiarm.viewer import replay
from multiarm.viewer.animate import animate
from multiarm.viewer.animation import Animation, Body, Dial, HingeTracks
from multiarm.viewer.drawing import draw
from multiarm.viewer.glyphs import Hinges
from multiarm.viewer.solids import box

SCENE = """
name: a gate between two arms
gravity: [0, 0, -9.81]
object: {shape: {box: [0.8, 0.3, 0.2]}, mass: 6.0, pose: {xyz: [0, 0, 0.9]}}
arms:
  left: {robot: textbook_6r, base: {xyz: [-0.9, 0, 0.1]}, tip: tool, posture: POSTURE}
  right: {robot: textbook_6r, base: {xyz: [0.9, 0, 0.1], rpy: [0, 0, 3.141592653589793]},
          tip: tool, posture: POSTURE}
joints: [LEFT, RIGHT]
run: {duration: 0.5, accuracy: 1.0e-5, output_step: 0.01}
""".replace("POSTURE", "[0.1, 0.4, 0.9, 0.0, 0.5, 0.0]")
HINGE = "{arm: left, kind: revolute, axis: [0, 1, 0], limits: [-0.1, 0.8]}"
SLIDE = "{arm: right, kind: cylindrical, axis: [1, 0, 0], slide_limits: [-0.02, 0.05]}"
PARTS = """(path) => {
  const found = {};
  viewer.scene_tree.find(path).object.traverse((node) => { if (node.name) found[node.name] = 1; });
  return Object.keys(found);
}"""
WORLD = """(path) => {
  const node = viewer.scene_tree.find(path).object, {THREE} = MeshCat;
  viewer.scene.updateMatrixWorld(true);
  const world = viewer.scene_tree.find(["world"]).object.matrixWorld.clone().invert();
  return world.multiply(node.matrixWorld).toArray();
}"""
DIALS = "() => [...document.querySelectorAll('.dial')].map((dial) => dial.textContent)"

BEYOND = """() => [...document.querySelectorAll('.dial')].map(
  (dial) => dial.classList.contains('beyond'))"""


def run(left: str, right: str) -> ma.Trajectory:
    scene = parse_scene(SCENE.replace("LEFT", left).replace("RIGHT", right))
    return ma.simulate(ma.compile_system(scene), duration=0.5, accuracy=1e-5)


@pytest.fixture(scope="module")
def trajectory():
    return run(HINGE, SLIDE)


@pytest.fixture(scope="module")
def animation(trajectory):
    return animate(trajectory, fps=1000, speed=1, meshes=False)


def pose(rotation, position) -> np.ndarray:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = rotation, position
    return X


def poses_of(trajectory, arm: str) -> tuple[np.ndarray, np.ndarray]:
    """World poses of object and tip at all samples, (K, 4, 4) each."""
    turns = Rotation.from_quat(trajectory.object_quaternion_xyzw).as_matrix()
    bodies = [pose(R, p) for R, p in zip(turns, trajectory.object_position, strict=True)]
    model = ma.compile_system(trajectory.scene).arms[arm]
    tips = [model.tip_pose(angles) for angles in trajectory.joint_positions[arm]]
    return np.array(bodies), np.array(tips)


def block(hinge: HingeTracks) -> Animation:
    body = Body("object", box([1.0, 0.4, 0.2]), *still(len(hinge.position)), np.ones(3))
    return Animation("block", np.arange(len(hinge.position), dtype=float), [body], hinges=[hinge])


def still(frames: int) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((frames, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (frames, 1))


def hinge_of(shape: str, *dials: Dial, frames: int = 3) -> HingeTracks:
    return HingeTracks("left", "left", shape, np.ones(3), *still(frames), dials)


# --- where the axes are, and how far they are turned ---------------------------------------------


def test_hinge_turns_as_the_object_turns_in_the_hand(trajectory, animation):
    bodies, tips = poses_of(trajectory, "left")
    relative = np.linalg.inv(bodies) @ tips
    turns = Rotation.from_matrix(relative[:, :3, :3] @ relative[0, :3, :3].T).as_rotvec()
    hinge = next(h for h in animation.hinges if h.arm == "left")
    axis = Rotation.from_quat(hinge.quaternion_xyzw[0]).apply([0, 0, 1])  # world, at the start
    np.testing.assert_allclose(np.abs(axis @ tips[0, :3, :3]), [0, 1, 0], atol=1e-9)
    expected = turns @ bodies[0, :3, :3].T @ axis
    (dial,) = hinge.dials
    assert dial.turns and np.ptp(expected) > 0.1
    np.testing.assert_allclose(dial.value, expected, atol=1e-9)


def test_slide_is_the_way_of_the_tip_along_the_axis(trajectory, animation):
    bodies, tips = poses_of(trajectory, "right")
    hinge = next(h for h in animation.hinges if h.arm == "right")
    (dial,) = hinge.dials
    assert hinge.shape == "sleeve" and not dial.turns
    axis = tips[0, :3, 0]  # the joint's x axis, world, at the start
    on_object = bodies[0, :3, :3].T @ axis
    start = bodies[0, :3, :3].T @ (tips[0, :3, 3] - bodies[0, :3, 3])
    away = np.einsum("kji,kj->ki", bodies[:, :3, :3], tips[:, :3, 3] - bodies[:, :3, 3]) - start
    np.testing.assert_allclose(dial.value, away @ on_object, atol=1e-9)
    # and there is no other motion
    np.testing.assert_allclose(away, np.outer(dial.value, on_object), atol=1e-6)


def test_axes_travel_with_the_object(trajectory, animation):
    bodies, _ = poses_of(trajectory, "left")
    for hinge in animation.hinges:
        R = Rotation.from_quat(hinge.quaternion_xyzw).as_matrix()
        relative = np.array(
            [
                np.linalg.inv(X) @ pose(r, p)
                for X, r, p in zip(bodies, R, hinge.position, strict=True)
            ]
        )
        np.testing.assert_allclose(relative, np.tile(relative[0], (len(R), 1, 1)), atol=1e-9)


def test_universal_joint_has_an_axle_on_each_body():
    trajectory = run("{arm: left, kind: universal}", "{arm: right, kind: weld}")
    animation = animate(trajectory, fps=1000, speed=1, meshes=False)
    on_object, on_arm = animation.hinges  # a weld has none
    assert [hinge.name for hinge in animation.hinges] == ["left/1", "left/2"]
    bodies, tips = poses_of(trajectory, "left")
    z = [Rotation.from_quat(h.quaternion_xyzw).as_matrix()[:, :, 2] for h in (on_object, on_arm)]
    fixed = np.einsum("kji,kj->ki", bodies[:, :3, :3], z[0])
    np.testing.assert_allclose(fixed, np.tile(fixed[0], (len(fixed), 1)), atol=1e-9)
    np.testing.assert_allclose(z[1], tips[:, :3, 1], atol=1e-9)
    np.testing.assert_allclose(np.einsum("ki,ki->k", *z), 0.0, atol=1e-6)  # they stay square


def test_turns_beyond_half_a_turn_are_counted_on():
    angles = np.linspace(0.0, 7.0, 50)
    tips = np.array([pose(Rotation.from_rotvec([0, 0, a]).as_matrix(), [0, 0, a]) for a in angles])
    turn, slide = axis_travel(np.tile(np.eye(4), (50, 1, 1)), tips)
    np.testing.assert_allclose(turn, angles, atol=1e-12)
    np.testing.assert_allclose(slide, angles, atol=1e-12)


# --- what is drawn -------------------------------------------------------------------------------


def paths(animation: Animation) -> list[str]:
    return [command["path"] for command in draw(animation) if command["type"] == "set_object"]


def corners(animation: Animation, path: str) -> np.ndarray:
    """Corners of the shape at a path of the scene tree, shape (V, 3)."""
    (shape,) = [
        command["object"]["geometries"][0]["data"]["attributes"]["position"]
        for command in draw(animation)
        if command["type"] == "set_object" and command["path"].endswith(path)
    ]
    return shape["array"].reshape(-1, 3)


def test_joint_without_limits_is_only_an_axis():
    drawn = [path for path in paths(block(hinge_of("axle"))) if "/joints/" in path]
    assert drawn == ["/world/joints/left/axis"]


def test_sector_spans_exactly_the_limits():
    dial = Dial(True, (-0.4, 1.1), np.zeros(3))
    points = corners(block(hinge_of("axle", dial)), "/turn/sector")
    rim = points[np.linalg.norm(points, axis=1) > 1e-9]
    angles = np.arctan2(rim[:, 1], rim[:, 0])
    assert angles.min() == pytest.approx(-0.4, abs=1e-6)
    assert angles.max() == pytest.approx(1.1, abs=1e-6)
    np.testing.assert_allclose(np.ptp(np.linalg.norm(rim, axis=1)), 0.0, atol=1e-6)


def test_sector_without_end_is_a_disc():
    points = corners(block(hinge_of("axle", Dial(True, (-9.0, 9.0), np.zeros(3)))), "/turn/sector")
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.02 * np.ptp(points))


def test_rail_reaches_from_stop_to_stop():
    dial = Dial(False, (-0.2, 0.9), np.zeros(3))
    heights = corners(block(hinge_of("rail", dial)), "/slide/rail")[:, 2]
    for end in dial.limits:
        assert np.abs(heights - end).min() < 1e-6
    assert heights.min() < -0.2 and heights.max() > 0.9  # the stops are beyond
    assert not np.any((heights > -0.19) & (heights < 0.89))


def test_pointer_is_red_exactly_while_it_is_beyond_the_limits():
    dial = Dial(True, (-0.5, 0.5), np.array([0.0, 0.5, 0.51, -0.7, 0.2]))
    commands = draw(block(hinge_of("axle", dial, frames=5)))
    (animation,) = [c for c in commands if c["type"] == "set_animation"]
    scales = {
        entry["path"].rpartition("/")[2]: track["values"].reshape(-1, 3)[:, 0] > 0.5
        for entry in animation["animations"]
        for track in entry["clip"]["tracks"]
        if track["name"] == ".scale" and "/hand/" in entry["path"]
    }
    assert scales["beyond"].tolist() == [False, False, True, True, False]
    assert scales["within"].tolist() == [True, True, False, False, True]


def test_all_of_a_joint_is_in_the_picture():
    dial = Dial(False, (-3.0, 5.0), np.zeros(3))
    animation = block(hinge_of("rail", dial))
    points = Hinges(animation, animation.size()).points(animation.hinges[0])
    assert points[:, 2].min() < -3.0 and points[:, 2].max() > 5.0


# --- in the browser ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def exported(trajectory, tmp_path_factory):
    path = tmp_path_factory.mktemp("joints") / "gate.html"
    return replay(trajectory, path, meshes=False)


@pytest.mark.slow
def test_page_shows_axes_limits_and_positions(view, exported, trajectory, animation):
    page = opened(view, exported)
    assert view.complaints == []
    assert {"axis", "sector", "hand"} <= set(page.evaluate(PARTS, ["world", "joints", "left"]))
    assert {"axis", "rail", "bead"} <= set(page.evaluate(PARTS, ["world", "joints", "right"]))
    hinge, slide = (next(h for h in animation.hinges if h.arm == arm) for arm in ("left", "right"))
    for row in (0, len(trajectory) - 1):
        page.evaluate(SEEK, float(trajectory.time[row]))
        place = page.evaluate(POSE, ["world", "joints", "left"])
        np.testing.assert_allclose(place["position"], hinge.position[row], atol=2e-3)
        hand = page.evaluate(WORLD, ["world", "joints", "left", "turn", "hand"])
        frame = Rotation.from_quat(hinge.quaternion_xyzw[row])
        angle = hinge.dials[0].value[row]
        x = frame.apply([np.cos(angle), np.sin(angle), 0.0])
        np.testing.assert_allclose(hand[:3], x, atol=5e-3)
        bead = page.evaluate(POSE, ["world", "joints", "right", "slide", "bead"])
        assert bead["position"][2] == pytest.approx(slide.dials[0].value[row], abs=1e-4)
    page.get_by_label("joint axes").uncheck()
    assert page.evaluate("viewer.scene_tree.find(['world', 'joints']).object.visible") is False


@pytest.mark.slow
def test_legend_tells_where_a_joint_is_between_its_limits(view, exported, animation):
    page = opened(view, exported)
    page.wait_for_function("document.querySelectorAll('.dial').length === 2")
    page.fill("#seek", "0.5")
    page.wait_for_function("document.querySelector('#clock').textContent === '0.50 / 0.50 s'")
    turn, slide = page.evaluate(DIALS)
    (hinge,) = [h for h in animation.hinges if h.arm == "left"]
    degrees = round(float(np.rad2deg(hinge.dials[0].value[-1])))
    assert turn.replace("\u2212", "-") == f"{degrees}° in -6 … 46°"
    assert slide.replace("\u2212", "-").endswith("mm in -20 … 50 mm")


@pytest.mark.slow
def test_position_beyond_the_limits_is_marked_in_the_legend(view, animation, tmp_path):
    (turned,) = [h.dials[0].value for h in animation.hinges if h.arm == "left"]
    narrow = HINGE.replace("[-0.1, 0.8]", f"[{0.5 * turned.min() - 1e-3}, {0.5 * turned.max()}]")
    page = opened(view, replay(run(narrow, SLIDE), tmp_path / "narrow.html", meshes=False))
    for time, beyond in (("0", False), ("0.5", True)):
        page.fill("#seek", time)
        page.wait_for_function(f"({BEYOND})()[0] === {str(beyond).lower()}")
