"""Replays of real runs, looked at with a real browser."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from refusals import refused
from replay_pages import POSE, SCENE, SEEK, opened
from sample_run import earlier_run, rows_of

import multiarm as ma
from multiarm.assembly.collisions import Surroundings
from multiarm.errors import ReplayError
from multiarm.results.sinks import MemorySink
from multiarm.scene import find_robot, parse_scene
from multiarm.viewer import replay
from multiarm.viewer.animate import animate
from multiarm.viewer.animation import rotations

# Where every corner of every shape is in the picture: x, y, z in -1..1 if it is seen.
IN_PICTURE = """() => {
  const {THREE} = MeshCat, world = viewer.scene_tree.find(["world"]).object, seen = [];
  viewer.scene.updateMatrixWorld(true);
  viewer.camera.updateMatrixWorld(true);
  for (const branch of world.children) {
    if (!["object", "arms", "contacts", "forces", "joints"].includes(branch.name)) continue;
    branch.traverse((node) => {
      if (!node.isMesh) return;
      node.geometry.computeBoundingBox();
      const {min, max} = node.geometry.boundingBox;
      for (let i = 0; i < 8; i++) {
        const corner = new THREE.Vector3(
          i & 1 ? min.x : max.x, i & 2 ? min.y : max.y, i & 4 ? min.z : max.z);
        seen.push(node.localToWorld(corner).project(viewer.camera).toArray());
      }
    });
  }
  return seen;
}"""


@pytest.fixture(scope="module")
def trajectory():
    scene = parse_scene(SCENE, folder=None)
    return ma.simulate(ma.compile_system(scene), duration=0.5, accuracy=1e-5)


@pytest.fixture(scope="module")
def exported(trajectory, tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "beam.html"
    assert replay(trajectory, path) == path
    return path


def shortened(trajectory, samples, status, message, **changes):
    """The first samples of a run, as if it had ended there; `changes` are channels."""
    sink, channels = MemorySink(), list(trajectory.channels.values())
    sink.open(channels, trajectory.provenance)
    if samples:
        block = {name: trajectory.read(name, 0, samples) for name in trajectory.channels}
        sink.append(rows_of(channels, {**block, **changes}))
    return sink.finish(status, message, {})


def robot_text(name):
    return find_robot(name).urdf.read_text()


@pytest.mark.slow
def test_exported_page_shows_the_run_without_network_or_complaints(view, exported, trajectory):
    page = opened(view, exported)
    page.wait_for_function("viewer.animator.time > 0.05", timeout=60_000)  # it plays by itself
    assert view.complaints == []
    assert view.requests == [exported.as_uri()]
    assert page.inner_text("#about h1") == "two arms swing <a beam>"
    assert page.inner_text("#note") == ""
    assert page.evaluate("viewer.animator.duration") == pytest.approx(trajectory.time[-1])


@pytest.mark.slow
def test_object_and_tips_move_as_computed(view, exported, trajectory):
    page = opened(view, exported)
    system = ma.compile_system(trajectory.scene)
    positions = []
    for row in (0, len(trajectory) // 2, len(trajectory) - 1):
        time = trajectory.time[row]
        page.evaluate(SEEK, time - trajectory.time[0])
        pose = page.evaluate(POSE, ["world", "object"])
        positions.append(pose["position"])
        # Frames are a thirtieth of a second apart, and the beam moves smoothly in between.
        np.testing.assert_allclose(pose["position"], trajectory.object_position[row], atol=2e-3)
        alignment = np.dot(pose["quaternion"], trajectory.object_quaternion_xyzw[row])
        assert abs(alignment) > 1 - 1e-4
        tip = system.arms["right"].tip_pose(trajectory.joint_positions["right"][row])[:3, 3]
        contact = page.evaluate(POSE, ["world", "contacts", "right", "1"])["position"]
        assert np.linalg.norm(np.subtract(contact, tip)) < 0.2
    assert np.linalg.norm(np.subtract(positions[2], positions[0])) > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("size", [(480, 800), (1200, 450)])
def test_whole_scene_is_in_the_picture_all_the_time(view, exported, trajectory, size):
    view.page.set_viewport_size({"width": size[0], "height": size[1]})
    page = opened(view, exported)
    for time in np.linspace(0, trajectory.time[-1], 4):
        page.evaluate(SEEK, float(time))
        corners = np.array(page.evaluate(IN_PICTURE))
        assert len(corners) > 100
        assert np.abs(corners).max() < 1
    assert np.ptp(corners[:, :2], axis=0).max() > 0.6  # and not lost in it


@pytest.mark.slow
def test_legend_has_the_forces_of_arms_beside_those_of_contacts(view, exported, trajectory):
    page = opened(view, exported)
    at_contact = max(np.abs(force).max() for force in trajectory.contact_forces.values())
    of_arm = {
        arm: np.linalg.norm(wrench[:, :3], axis=1).max()
        for arm, wrench in trajectory.wrenches.items()
    }
    told = [float(number) for number in re.findall(r"([\d.]+) N", page.inner_text("#scale"))]
    expected = {at_contact, max(of_arm.values())}
    assert {told[0], told[-1]} == {float(f"{force:.3g}") for force in expected}
    titles = page.eval_on_selector_all(".chip", "chips => chips.map(chip => chip.title)")
    assert all(
        f"{force:.3g} N" in title for force, title in zip(of_arm.values(), titles, strict=True)
    )


@pytest.mark.slow
def test_a_run_of_an_earlier_version_has_a_legend_without_forces_of_arms(
    view, trajectory, tmp_path
):
    path = replay(earlier_run(trajectory), tmp_path / "old.html", meshes=False)
    page = opened(view, path)
    assert view.complaints == []
    assert page.inner_text("#scale").endswith("N at a contact")
    assert page.eval_on_selector_all(".chip", "chips => chips.map(chip => chip.title)") == ["", ""]


@pytest.mark.slow
def test_time_bar_and_layers_work(view, exported):
    page = opened(view, exported)
    page.evaluate(SEEK, 0.3)
    page.wait_for_function("!viewer.animator.playing")
    page.fill("#seek", "0.2")
    page.wait_for_function("document.querySelector('#clock').textContent === '0.20 / 0.50 s'")
    page.click("#play")
    page.wait_for_function("viewer.animator.playing")
    page.uncheck("#layers input >> nth=0")
    assert page.evaluate("viewer.scene_tree.find(['world', 'forces']).object.visible") is False


def test_links_stand_where_the_joint_angles_put_them(trajectory):
    animation = animate(trajectory, fps=1000, speed=1, meshes=True)
    link = next(body for body in animation.bodies if body.name == "arms/left/link_2_1")
    shoulder, upper_arm, middle = [-0.9, 0, 0.1 + 0.3], [0, 0.1, 0.1], [0, 0.045, 0.225]
    for row, angles in enumerate(trajectory.joint_positions["left"]):
        about_z, about_y = np.eye(3), np.eye(3)
        (c, s), (c2, s2) = ((np.cos(a), np.sin(a)) for a in angles[:2])
        about_z[:2, :2] = [[c, -s], [s, c]]
        about_y[::2, ::2] = [[c2, s2], [-s2, c2]]
        expected = shoulder + about_z @ (upper_arm + about_y @ middle)
        np.testing.assert_allclose(link.position[row], expected, atol=1e-12)
        turn = rotations(link.quaternion_xyzw[row : row + 1])[0]
        np.testing.assert_allclose(turn, about_z @ about_y, atol=1e-12)


@pytest.mark.parametrize("meshes", [True, False])
def test_every_cylinder_has_the_size_of_the_urdf(trajectory, meshes):
    """Two links of a robot may differ by their size only."""
    sizes = {
        body.name: np.ptp(body.mesh.vertices, axis=0)
        for body in animate(trajectory, fps=30, speed=1, meshes=meshes).bodies
    }
    robot = ElementTree.fromstring(robot_text("textbook_6r"))
    for link in robot.findall("link"):
        for number, visual in enumerate(link.findall("visual")):
            cylinder = visual.find("geometry/cylinder")
            if cylinder is not None:
                radius, length = float(cylinder.get("radius")), float(cylinder.get("length"))
                size = sizes[f"arms/left/{link.get('name')}_{number}"]
                np.testing.assert_allclose(size, [2 * radius, 2 * radius, length], rtol=1e-12)


@pytest.mark.slow
def test_a_replay_seeks_no_posture_assembles_no_start_and_has_no_control(monkeypatch, trajectory):
    def refuse(*given, **more):
        raise AssertionError("all that is recorded")

    expected = animate(trajectory, fps=30, speed=1.0, meshes=False)
    for name in ("robots.find_postures", "compilation.assembled_start", "compilation.control_law"):
        monkeypatch.setattr(f"multiarm.assembly.{name}", refuse)
    found = animate(trajectory, fps=30, speed=1.0, meshes=False)
    np.testing.assert_array_equal(found.contacts[0].point, expected.contacts[0].point)
    np.testing.assert_array_equal(found.bodies[1].position, expected.bodies[1].position)


@pytest.mark.slow
def test_failed_run_is_shown_up_to_where_it_came(view, trajectory, tmp_path):
    cut = shortened(trajectory, 30, "failed", "the joints cannot follow; take smaller steps")
    page = opened(view, replay(cut, tmp_path / "cut.html"))
    assert page.evaluate("viewer.animator.duration") == pytest.approx(trajectory.time[29])
    assert page.inner_text("#note") == "failed: the joints cannot follow; take smaller steps"


@pytest.mark.slow
def test_single_sample_is_a_still_picture(view, trajectory, tmp_path):
    page = opened(view, replay(shortened(trajectory, 1, "failed", "at once"), tmp_path / "1.html"))
    assert view.complaints == []
    assert not page.is_visible("#bar")
    pose = page.evaluate(POSE, ["world", "object"])
    np.testing.assert_allclose(pose["position"], trajectory.object_position[0])


def test_run_without_samples_is_refused_in_words(trajectory, tmp_path):
    with refused(ReplayError):
        replay(shortened(trajectory, 0, "failed", "at once"), tmp_path / "nothing.html")


def test_run_that_ended_in_a_singular_posture_is_shown(trajectory):
    angles = trajectory.read("arms/right/joint_position", 0, 20).copy()
    angles[-1] = [0, 0.4, 0, 0, 0, 0]  # stretched: it cannot follow a weld in all directions
    end = {"arms/right/joint_position": angles}
    run = shortened(trajectory, 20, "failed", "the posture is singular", **end)
    system = ma.compile_system(run.scene)
    state = system.state(joint_positions={"right": angles[-1]})
    assert "right" in ma.evaluate(system, 0.0, state).coupled_arms
    animation = animate(run, fps=1000, speed=1, meshes=False)
    assert len(animation.time) == 20
    assert all(np.isfinite(contacts.point).all() for contacts in animation.contacts)


def test_missing_mesh_is_a_warning_and_bars_stand_in(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        re.sub(
            r"<geometry>.*?</geometry>",
            '<geometry><mesh filename="lost.stl"/></geometry>',
            robot_text("textbook_6r"),
            flags=re.DOTALL,
        )
    )
    text = SCENE.replace("left: {robot: textbook_6r", f"left: {{urdf: '{urdf}'")
    run = ma.simulate(ma.compile_system(parse_scene(text, folder=None)), duration=0.02)
    with pytest.warns(UserWarning, match="lost.stl"):
        bodies = animate(run, fps=30, speed=1, meshes=True).bodies
    left, right = (
        [body.name for body in bodies if body.name.startswith(f"arms/{arm}/")]
        for arm in ("left", "right")
    )
    assert len(left) >= 5 and all(name.endswith("_bar") for name in left)
    assert right and not any(name.endswith("_bar") for name in right)


@pytest.mark.parametrize(
    ("file", "content", "fault"),
    [
        ("lost.stl", None, "there is no such file"),
        ("package://nowhere/lost.stl", None, "there is no such file"),
        ("bad.obj", b"hello", "it has no triangles"),
    ],
)
def test_a_mesh_that_cannot_be_read_takes_only_its_link_out_of_replays_and_postures(
    tmp_path, trajectory, file, content, fault
):
    urdf, text = tmp_path / "arm.urdf", robot_text("textbook_6r")
    if content is not None:
        (tmp_path / file).write_bytes(content)
    link = re.search(r'<link name="link_3">.*?</link>', text, re.DOTALL).group()
    geometry = f'<geometry><mesh filename="{file}"/></geometry>'
    urdf.write_text(
        text.replace(link, re.sub(r"<geometry>.*?</geometry>", geometry, link, flags=re.S))
    )
    scene = SCENE.replace("left: {robot: textbook_6r", f"left: {{urdf: '{urdf}'")
    system = ma.compile_system(parse_scene(scene, folder=None))
    run = ma.simulate(system, duration=0.02)
    with pytest.warns(UserWarning, match=f"{file} of link 'link_3' .*{fault}"):
        bodies = animate(run, fps=1000, speed=1, meshes=True).bodies
    with pytest.warns(UserWarning, match=f"without regard to .*{file} of link 'link_3' .*{fault}"):
        Surroundings(system.scene, system.arms)
    whole = animate(trajectory, fps=1000, speed=1, meshes=True).bodies
    left, healthy = (
        [body.name for body in shown if "arms/left" in body.name] for shown in (bodies, whole)
    )
    assert left == [*(name for name in healthy if "link_3" not in name), "arms/left/joint_3_bar"]


@pytest.mark.slow
def test_a_home_folder_may_be_named_by_its_sign(monkeypatch, trajectory, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert replay(trajectory, "~/run.html", meshes=False) == tmp_path / "run.html"
    assert (tmp_path / "run.html").exists()


@pytest.mark.slow
def test_without_meshes_the_file_is_small(trajectory, tmp_path):
    text = SCENE.replace("robot: textbook_6r", "robot: ur5").replace("tip: tool,", "tip: tool0,")
    run = ma.simulate(ma.compile_system(parse_scene(text, folder=None)), duration=0.02)
    full = replay(run, tmp_path / "full.html").stat().st_size
    small = replay(run, tmp_path / "small.html", meshes=False).stat().st_size
    assert small + 500_000 < full < 5_000_000


@pytest.mark.parametrize(
    "options",
    [
        {"fps": 0},
        {"speed": float("nan")},
        {"path": "."},
        {"path": "no/such/folder/a.html"},
        {"fps": 1e300, "speed": 1e-300},
        {"speed": 1e-320},
        {"fps": "30"},
    ],
)
def test_unusable_options_are_named(trajectory, options):
    with refused(ReplayError):
        replay(trajectory, **{"path": "never.html", **options})
