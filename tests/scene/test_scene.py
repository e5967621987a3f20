"""Claims about scenes: what is accepted, what is refused, and in which words."""

from __future__ import annotations

import copy
import math
import pydoc
import re
from types import MappingProxyType

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import ROOT, SCENES

import multiarm as ma
from multiarm.errors import MultiarmError, SceneError
from multiarm.scene import (
    ArmSpec,
    BallJoint,
    ContactsJoint,
    CylindricalJoint,
    Geometry,
    ObjectSpec,
    Pose,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    WeldJoint,
    dump_scene,
    function_text,
    gain_vector,
    joint_vector,
    load_scene,
    parse_scene,
)
from multiarm.scene.run import RunSpec
from multiarm.scene.spec import Spec
from multiarm.scene.text import parse_yaml, written_yaml

EXAMPLES = sorted(SCENES.glob("*.yaml"))

TWO_ARMS = {
    "name": "two arms",
    "gravity": [0, 0, -9.81],
    "object": {"shape": {"box": [1.2, 0.6, 0.4]}, "mass": 20.0, "pose": {"xyz": [0, 0, 0.5]}},
    "arms": {
        "left": {"robot": "textbook_6r", "tip": "tool", "base": {"xyz": [-0.9, 0, 0]}},
        "right": {"robot": "textbook_6r", "tip": "tool", "base": {"xyz": [0.9, 0, 0]}},
    },
    "joints": [
        {"arm": "left", "kind": "weld"},
        {"arm": "right", "kind": "ball", "at": {"xyz": [0.6, 0, 0]}},
    ],
}


def scene_with(path: str, value: object) -> dict:
    """Return the two-arm scene with the entry at ``a.b.0.c`` set to ``value``."""
    data = copy.deepcopy(TWO_ARMS)
    *way, last = [int(part) if part.isdigit() else part for part in path.split(".")]
    table = data
    for part in way:
        table = table.setdefault(part, {}) if isinstance(table, dict) else table[part]
    table[last] = value
    return data


def faults_of(data: object, *places: str) -> list[str]:
    with refused(SceneError, *places) as caught:
        parse_scene(data)
    return caught.value.faults


def only_fault(path: str, value: object) -> str:
    """The fault of a scene with this value; it is named where the value stands, or next to it."""
    (fault,) = faults_of(scene_with(path, value))
    assert is_at(path, fault), fault
    return fault


def is_at(path: str, fault: str) -> bool:
    """Whether a fault names the value at ``a.b.0.c``, a part of it, or the table around it."""
    place = re.sub(r"\.(\d+)", r"[\1]", f"$.{path}")
    return fault.startswith((place, place.rpartition(".")[0] + ":"))


# --- what is accepted --------------------------------------------------------------------------


def test_yaml_and_python_give_the_same_scene():
    from_yaml = parse_scene(yaml.safe_dump(TWO_ARMS))
    from_python = Scene(
        name="two arms",
        gravity=np.array([0, 0, -9.81]),
        object=ObjectSpec(shape={"box": (1.2, 0.6, 0.4)}, mass=20, pose=Pose(xyz=(0, 0, 0.5))),
        arms={
            "left": ArmSpec(robot="textbook_6r", tip="tool", base=Pose(xyz=[-0.9, 0, 0])),
            "right": {"robot": "textbook_6r", "tip": "tool", "base": {"xyz": [0.9, 0, 0]}},
        },
        joints=[WeldJoint(arm="left"), BallJoint(arm="right", at=Pose(xyz=(0.6, 0, 0)))],
    )
    assert from_yaml == from_python
    assert from_yaml != parse_scene(scene_with("object.mass", 21.0))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_written_scenes_load_again_to_equal_scenes(path, tmp_path):
    scene = load_scene(path)
    copied = tmp_path / "copy.yaml"
    copied.write_text(dump_scene(scene))
    assert load_scene(copied) == scene


def test_every_kind_of_part_survives_writing_and_reading():
    data = scene_with(
        "control", {"kind": "harmonic", "frequency": 2, "amplitude": {"left": [1] * 6}}
    )
    data["effects"] = {"joint_damping": {"left": 0.5, "right": {"joint_2": 1e-3}}}
    data["run"] = {
        "integrator": "rk4",
        "step": 1e-3,
        "stabilization": {"kind": "feedback", "alpha": 5},
    }
    data["object"]["inertia"] = [1.0, 0.1, 0.0, 1.2, 0.0, 1.5]
    data["object"]["pose"] = {"quaternion_xyzw": [0, 0, 1, 1]}
    data["object"]["color"] = "#3b7dd8"
    data["joints"][1] = {
        "arm": "right",
        "kind": "contacts",
        "contacts": [
            {"arm": {"sphere": {"radius": 0.02}}, "object": {"plane": {"normal": [0, 0, 1]}}},
            {"arm": {"point": [0, 0, 0.1]}, "object": {"cylinder": {"radius": 0.1}}},
        ],
    }
    scene = parse_scene(data)
    assert parse_scene(dump_scene(scene)) == scene


SURFACES = [
    {"point": [0, 0, 0.1]},
    {"sphere": {"radius": 0.02, "patch": {"min": [None, -0.1, None], "max": [0.5, 0.1, None]}}},
    {"plane": {"normal": [0, 1, 1], "patch": {"max": [0.5, 0.1, 0.2]}}},
    {"cylinder": {"radius": 0.1, "inside": True}},
    {"cone": {"half_angle": 0.4, "apex": [0, 0, 1], "axis": [0, 1, 0], "inside": True}},
    {"torus": {"circle_radius": 0.2, "tube_radius": 0.05, "center": [1, 0, 0], "inside": True}},
    {"ellipsoid": {"semi_axes": [0.1, 0.2, 0.3], "rpy": [0.1, 0.2, 0.3]}},
    {"ellipsoid": {"semi_axes": [0.1, 0.2, 0.3], "quaternion_xyzw": [0, 0, 1, 1]}},
    {"surface": {"distance": "no_such_package.shapes:blob", "length": 0.2, "inside": True}},
    {
        "surface": {
            "parametrisation": "/no/such/file.py:bowl",
            "derivatives": "/no/such/file.py:rates.of_bowl",
            "u": [-1, 1],
            "v": [0, 2],
            "flip": True,
            "origin": [0, 0, 1],
            "quaternion_xyzw": [0, 0, 1, 1],
        }
    },
]


@pytest.mark.parametrize("surface", SURFACES, ids=lambda surface: next(iter(surface)))
def test_every_surface_survives_writing_and_reading(surface):
    """Functions too, whose file or module is absent: they are looked up when they are needed."""
    contact = {"arm": {"sphere": {"radius": 0.01}}, "object": surface, "rolling": True}
    contacts = [contact, {"arm": surface, "object": {"sphere": {"radius": 0.01}}}]
    scene = parse_scene(
        scene_with("joints.1", {"arm": "right", "kind": "contacts", "contacts": contacts})
    )
    assert scene.joints[1].contacts[0].object == Geometry(**surface)
    again = parse_scene(dump_scene(scene))
    assert again == scene
    assert again.joints[1].contacts[0].rolling


def test_every_joint_with_parameters_of_its_own_survives_writing_and_reading():
    for joint in (
        {"kind": "revolute", "limits": [-1.5, 0]},
        {"kind": "prismatic", "limits": [0, 0.2]},
        {"kind": "cylindrical", "turn_limits": [-1, 1], "slide_limits": [-0.1, 0.2]},
        {"kind": "wrenches", "wrenches": [[1, 0, 0, 0, 0, 0], [0] * 5 + [2]], "carried_by": "arm"},
    ):
        scene = parse_scene(scene_with("joints.0", {"arm": "left", **joint}))
        assert parse_scene(dump_scene(scene)) == scene
        assert scene.joints[0].kind == joint["kind"]


def test_limits_are_told_by_component_of_the_motion():
    assert RevoluteJoint(arm="a", limits=(-1, 2)).free_limits == {5: (-1, 2)}
    assert PrismaticJoint(arm="a", limits=(-1, 2)).free_limits == {2: (-1, 2)}
    assert CylindricalJoint(arm="a", turn_limits=(0, 2)).free_limits == {5: (0, 2)}
    both = CylindricalJoint(arm="a", turn_limits=(0, 2), slide_limits=(-3, 0))
    assert both.free_limits == {2: (-3, 0), 5: (0, 2)}
    assert RevoluteJoint(arm="a").free_limits == BallJoint(arm="a").free_limits == {}


def distance_from_a_ball(p):
    return (p @ p) ** 0.5 - 0.1


class Shape:
    def distance(self, p):
        return distance_from_a_ball(p)

    def __call__(self, p):
        return distance_from_a_ball(p)


def with_functions(**surface):
    contact = {"arm": {"point": [0, 0, 0.1]}, "object": {"surface": surface}}
    return scene_with("joints.1", {"arm": "right", "kind": "contacts", "contacts": [contact]})


def test_functions_given_in_python_are_written_by_name():
    scene = parse_scene(with_functions(distance=distance_from_a_ball))
    surface = scene.joints[1].contacts[0].object.surface
    assert surface.distance is distance_from_a_ball
    again = parse_scene(dump_scene(scene))
    written = again.joints[1].contacts[0].object.surface.distance
    assert written == f"{__name__}:distance_from_a_ball"
    assert again == scene
    assert scene.replace(name="other").joints[1].contacts[0].object.surface == surface


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (lambda p: 0.0, "<lambda>"),
        (Shape().distance, "<Shape.distance>"),
        (Shape(), "<Shape object>"),
    ],
    ids=["lambda", "method", "object"],
)
def test_functions_without_a_name_are_written_in_angle_brackets(function, name):
    assert function_text(function) == f"{__name__}:{name}"
    scene = parse_scene(with_functions(distance=function))
    assert parse_scene(dump_scene(scene)) == scene


def test_functions_of_the_running_script_are_written_with_its_file(monkeypatch):
    monkeypatch.setattr(distance_from_a_ball, "__module__", "__main__")
    monkeypatch.setattr("__main__.__file__", "/some/script.py", raising=False)
    assert function_text(distance_from_a_ball) == "/some/script.py:distance_from_a_ball"


def test_files_of_functions_start_at_the_scene(tmp_path):
    scene = Scene.from_mapping(with_functions(distance="shapes.py:blob"), tmp_path)
    surface = scene.joints[1].contacts[0].object.surface
    assert surface.distance == f"{tmp_path.resolve()}/shapes.py:blob"
    assert parse_scene(dump_scene(scene)) == scene


def test_numbers_such_as_1e_6_are_numbers():
    scene = parse_scene(yaml.safe_dump(TWO_ARMS) + "\nrun: {accuracy: 1e-8, duration: 2E0}\n")
    assert scene.run.accuracy == 1e-8
    assert scene.run.duration == 2.0


def test_a_run_that_names_nothing_aims_at_1e_6():
    assert parse_scene(TWO_ARMS).run.accuracy == 1e-6
    assert RunSpec.model_validate(MappingProxyType({"duration": 1.0})).accuracy == 1e-6
    stepped = parse_scene(scene_with("run", {"integrator": "rk4", "step": 0.01}))
    assert stepped.run.accuracy is None


def test_relative_paths_start_at_the_scene(tmp_path):
    robot = ROOT / "robots" / "planar_2r" / "planar_2r.urdf"
    (tmp_path / "arm.urdf").write_text(robot.read_text())
    data = {
        "object": {"shape": {"sphere": 0.1}, "mass": 1},
        "arms": {"a": {"urdf": "arm.urdf", "tip": "tip"}},
        "joints": [{"arm": "a", "kind": "weld"}],
    }
    (tmp_path / "my_scene.yaml").write_text(yaml.safe_dump(data))
    scene = load_scene(tmp_path / "my_scene.yaml")
    assert scene.arms["a"].urdf == tmp_path.resolve() / "arm.urdf"
    assert scene.folder == tmp_path.resolve()
    assert scene.name == "my scene"
    assert parse_scene(dump_scene(scene)) == scene


UR5 = SCENES / "two_ur5_box.yaml"
JOINT = {"arm": "right", "kind": "revolute"}


@pytest.mark.parametrize(
    ("changes", "place", "radians"),
    [
        ({"object.pose.rpy": [0, 90, 0]}, "$.object.pose.rpy[1]", "1.5708 rad"),
        ({"arms.left.base.rpy": [0, 0, -180]}, "$.arms.left.base.rpy[2]", "-3.14159 rad"),
        ({"control.path[1].rpy": [7, 0, 0]}, "$.control.path[1].rpy[0]", "0.122173 rad"),
        ({"joints[0].at": {"rpy": [0, 45, 0]}}, "$.joints[0].at.rpy[1]", "0.785398 rad"),
        ({"arms.left.posture.elbow_joint": 90}, "$.arms.left.posture.elbow_joint", "1.5708 rad"),
        ({"arms.left.posture": [0, 0, 0, 0, 0, 30]}, "$.arms.left.posture[5]", "0.523599 rad"),
        ({"arms.left.lock": {"elbow_joint": 60}}, "$.arms.left.lock.elbow_joint", "1.0472 rad"),
    ],
    ids=str,
)
def test_angles_beyond_a_turn_are_taken_for_degrees(changes, place, radians):
    with pytest.raises(SceneError) as caught:
        load_scene(UR5).replace(changes)
    (text,) = (fault for fault in caught.value.faults if fault.startswith(f"{place}: "))
    assert "angles are in radians" in text and text.endswith(radians)


def test_a_full_turn_is_an_angle_however_it_is_rounded():
    scene = load_scene(UR5)
    for turn in (2.0 * np.pi, 6.2832, 6.284, -6.28319):
        assert scene.replace({"object.pose.rpy[2]": turn}).object.pose.rpy[2] == turn


def test_a_joint_without_limits_may_turn_more_than_once_which_is_a_warning():
    crank = {"robot": "crank", "tip": "tip", "posture": [7.0]}
    scene = parse_scene(
        {
            "object": {"shape": {"sphere": 0.1}, "mass": 1},
            "arms": {"a": crank},
            "joints": [{"arm": "a", "kind": "weld"}],
        }
    )
    (warning,) = scene.warnings
    assert warning.startswith("$.arms.a: posture of ") and "7 rad, more than a turn" in warning


def test_a_scene_shows_itself_in_a_line():
    scene = load_scene(UR5)
    shown = {"'two UR5s carry a box'", "20 kg", "left (ur5, weld)", "joint_pd", "5 s"}
    assert all(fact in repr(scene) for fact in shown) and len(repr(scene)) < 200
    table = scene._repr_html_()
    assert "left (ur5, weld)" in table and table.startswith("<table>")
    assert (
        repr(scene.run)
        == "RunSpec(duration=5.0, accuracy=AccuracySpec(position=1e-06, rotation=1e-06))"
    )


@pytest.mark.parametrize("shown", [ma.Joint, ma.Surface, ma.Control, ma.Scene])
def test_help_of_a_part_shows_what_is_ours_before_what_is_its_librarys(shown):
    text = pydoc.render_doc(shown, renderer=pydoc.plaintext)
    ours, inherited, _ = text.partition("inherited from pydantic.main.BaseModel")
    assert inherited and ("Methods defined here" in ours or "properties defined here" in ours)
    assert not any(name in ours for name in ("model_json_schema", "schema_json"))
    assert len(ours.splitlines()) < 300


def test_replace_validates_again():
    scene = parse_scene(TWO_ARMS)
    assert scene.replace(run={"duration": 3.0}).run.duration == 3.0
    with refused(SceneError, "$.run.duration"):
        scene.replace(run={"duration": -3.0})


# --- geometry and inertia ----------------------------------------------------------------------


def test_rpy_is_the_fixed_axis_convention_of_urdf():
    pin = pytest.importorskip("pinocchio")
    rpy = (0.3, -0.7, 1.9)
    pose = Pose(xyz=(1, 2, 3), rpy=rpy)
    np.testing.assert_allclose(pose.matrix()[:3, :3], pin.rpy.rpyToMatrix(*rpy), atol=1e-15)
    np.testing.assert_array_equal(pose.matrix()[:3, 3], [1, 2, 3])
    np.testing.assert_array_equal(pose.matrix()[3], [0, 0, 0, 1])


def test_quaternion_is_scalar_last_and_of_any_length():
    quarter_turn = Pose(quaternion_xyzw=(0, 0, 3, 3)).rotation()
    np.testing.assert_allclose(quarter_turn, Pose(rpy=(0, 0, np.pi / 2)).rotation(), atol=1e-15)


def test_uniform_inertia_is_the_integral_over_the_body():
    rng = np.random.default_rng(1)
    n = 200_000
    u = rng.uniform(-0.5, 0.5, (n, 3))
    angle, root = 2 * np.pi * u[:, 0], np.sqrt(u[:, 1] + 0.5)
    ball = rng.normal(size=(n, 3))
    ball *= 0.3 * ((u[:, 2] + 0.5) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    bodies = [
        ({"box": [1.2, 0.6, 0.4]}, u * [1.2, 0.6, 0.4]),
        (
            {"cylinder": {"radius": 0.3, "height": 0.8}},
            np.c_[0.3 * root * np.cos(angle), 0.3 * root * np.sin(angle), 0.8 * u[:, 2]],
        ),
        ({"sphere": 0.3}, ball),
    ]
    for shape, points in bodies:
        expected = 7.0 * (np.mean(points**2) * 3 * np.eye(3) - points.T @ points / n)
        inertia = ObjectSpec(shape=shape, mass=7.0).inertia_matrix()
        np.testing.assert_allclose(inertia, expected, atol=6 * np.trace(expected) / np.sqrt(n))


def test_three_forms_of_inertia_mean_the_same():
    shape = {"box": [1, 1, 1]}
    full = [[1.0, 0.1, -0.2], [0.1, 1.3, 0.05], [-0.2, 0.05, 1.1]]
    by_matrix = ObjectSpec(shape=shape, mass=1, inertia=np.array(full))
    by_entries = ObjectSpec(shape=shape, mass=1, inertia=[1.0, 0.1, -0.2, 1.3, 0.05, 1.1])
    assert by_matrix == by_entries
    diagonal = ObjectSpec(shape=shape, mass=1, inertia=[1, 2, 2.5]).inertia_matrix()
    np.testing.assert_array_equal(diagonal, np.diag([1, 2, 2.5]))


def test_an_object_of_known_inertia_needs_no_shape():
    """Its motion is that of a box of this inertia, and the replay shows that box."""
    box = ObjectSpec(shape={"box": [1.2, 0.6, 0.4]}, mass=20)
    bare = ObjectSpec(mass=20, inertia=box.inertia_matrix())
    from multiarm.viewer.shapes import object_mesh

    seen = object_mesh(bare).vertices
    np.testing.assert_allclose(np.ptp(seen, axis=0), [1.2, 0.6, 0.4], rtol=1e-12)
    written = yaml.safe_dump({**TWO_ARMS, "object": {"mass": 20, "inertia": [1.0, 2.0, 2.5]}})
    scene = parse_scene(written)
    assert parse_scene(dump_scene(scene)) == scene and "shape" not in dump_scene(scene)
    assert only_fault("object", {"mass": 20}).startswith("$.object: needs its 'shape', or 'iner")
    floor = {"object": {"mass": 20, "inertia": [1, 2, 2.5]}, "effects": {"floor": {}}}
    with refused(SceneError, "'shape'"):
        ma.compile_system(parse_scene(yaml.safe_dump({**TWO_ARMS, **floor})))


@pytest.mark.parametrize(
    "inertia",
    [
        [1, 1, 5],
        [1, 2, 0, 1, 0, 1],
        [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]],
        [1, 1],
        [1, 1, float("nan")],
        [[1, 0], [0, 1], [0, 0]],
    ],
)
def test_inertias_that_no_body_has_are_refused(inertia):
    only_fault("object.inertia", inertia)


# --- faults of single values -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("object.mass", -2),
        ("object.mass", "heavy"),
        ("object.mass", True),
        ("object.mass", float("inf")),
        ("gravity", [0, 0]),
        ("gravity", [0, 0, "g"]),
        ("object.shape", {"box": [1, 1, 0]}),
        ("object.shape", {"sphere": 1, "box": [1, 1, 1]}),
        ("object.shape", {"cone": 1}),
        ("object.shape", {"mesh": {"file": "a.stl"}}),
        ("object.pose", {"quaternion_xyzw": [0, 0, 0, 0]}),
        ("object.pose", {"rpy": [1, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}),
        ("object.color", "blueish"),
        ("object.twist", [0] * 5),
        ("arms.left.robot", None),
        ("arms.left.urdf", "x.urdf"),
        ("arms.left.tip", "tol"),
        ("arms.left.robot", "ur6"),
        ("arms.left.posture", [0, 1]),
        ("arms.left.posture", {"joint_7": 1}),
        ("arms.left.velocity", [0] * 7),
        ("arms.left.posture", [0, 0, 0, 0, 0, "x"]),
        ("arms.left.lock", {"finger": 0}),
        ("arms.left.tol", {}),
        ("joints.0.kind", "hing"),
        ("joints.0.kind", ["weld"]),
        ("joints.0.arm", "lefd"),
        ("joints.1.axis", [0, 0, 1]),
        ("joints.1.size", 0),
        ("joints.1.at", {"xzy": [0, 0, 0]}),
        ("control", {"kind": "pd"}),
        ("control", {"stiffness": 3}),
        ("control", {"kind": "constant"}),
        ("control", {"kind": "constant", "torques": {"leg": 1}}),
        ("control", {"kind": "constant", "torques": {"left": [1]}}),
        ("effects", {"wind": 3}),
        ("effects", {"joint_damping": -1}),
        ("effects", {"joint_damping": {"left": {"joint_9": 1}}}),
        ("run", {"duration": 0}),
        ("run", {"accuracy": 1e-6, "step": 0.1}),
        ("run", {"integrator": "rk4"}),
        ("run", {"integrator": "rk5", "step": 0.1}),
        ("run", {"integrator": "dopri5", "step": 0.1}),
        ("run", {"integrator": "rk4", "accuracy": 1e-3}),
        ("run", {"step": 0.1}),
        ("run", {"stabilization": "springs"}),
        ("arms", {}),
        ("arms.floor", {"robot": "ur5"}),
        ("joints", {"left": "weld"}),
        ("objet", 1),
        ("effects", {"drag": {"linear": 10**310}}),
        ("control", {"kind": "computed_torque", "stiffness": 10**310}),
    ],
)
def test_each_fault_is_told_at_its_place_with_a_way_out(path, value):
    assert any(is_at(path, fault) for fault in faults_of(scene_with(path, value)))


@pytest.mark.parametrize(
    "joint",
    [
        {"kind": "corner_gripper", "faces": ["x", "y", "z"]},
        {"kind": "corner_gripper", "faces": ["x", "y", "z", "x"]},
        {"kind": "point_on_cylinder"},
        {"kind": "point_on_sphere", "radius": 0.1, "inside": True, "tip_radius": 0.2},
        {"kind": "revolute", "axis": [0, 0, 0]},
        {"kind": "contacts", "contacts": []},
        {"kind": "contacts", "contacts": [{"arm": {"point": [0, 0, 0]}, "object": {}}]},
        {
            "kind": "contacts",
            "contacts": [{"arm": {"point": [0, 0, 0]}, "object": {"point": [0, 0, 0]}}],
        },
    ],
)
def test_faults_of_joints_are_told(joint):
    only_fault("joints.0", {"arm": "left", **joint})


BALL = {"sphere": {"radius": 0.1}}
ROD = {"cylinder": {"radius": 0.1}}
FACE = {"plane": {"normal": [0, 0, 1]}}
EGG = {"ellipsoid": {"semi_axes": [0.3, 0.2, 0.1]}}
RING = {"torus": {"circle_radius": 0.3, "tube_radius": 0.1}}
HORN = {"cone": {"half_angle": 0.3}}
BLOB = {"surface": {"distance": "shapes:blob"}}


def hollow(geometry, **changes):
    ((shape, value),) = geometry.items()
    return {shape: {**value, "inside": True, **changes}}


@pytest.mark.parametrize(
    ("arm", "body"),
    [
        (FACE, FACE),
        (FACE, ROD),
        (ROD, FACE),
        (FACE, HORN),
        (FACE, hollow(BALL)),
        (ROD, hollow(ROD, radius=0.5)),
        (hollow(EGG), HORN),
        (hollow(BALL), hollow(ROD)),
        (hollow(BLOB), hollow(BALL)),
        (BALL, hollow(BALL)),
        (hollow(ROD), BALL),
        (BALL, hollow(RING)),
        (EGG, hollow(BALL, radius=0.13)),
        (RING, hollow(BALL, radius=0.35)),
        (RING, hollow(ROD, radius=0.1)),
        ({"point": [0, 0, 0]}, {"point": [0, 0, 0]}),
        (BALL, {"cone": {"half_angle": 1.6}}),
        (BALL, {"torus": {"circle_radius": 1, "tube_radius": 1}}),
        (BALL, {"ellipsoid": {"semi_axes": [1, 0, 1]}}),
        (BALL, {"ellipsoid": {"semi_axes": [1, 1]}}),
        (
            BALL,
            {"ellipsoid": {"semi_axes": [1, 1, 1], "rpy": [1, 0, 0], "quaternion_xyzw": [1] * 4}},
        ),
        (BALL, {"plane": {"normal": [0, 0, 1], "inside": True}}),
        (BALL, {"ball": {}}),
        (BALL, {**FACE, **ROD}),
        (BALL, {"surface": {}}),
        (BALL, {"surface": {"distance": 3}}),
        (BALL, {"surface": {"distance": "blob"}}),
        (BALL, {"surface": {"distance": "a:b", "parametrisation": "a:b"}}),
        (BALL, {"surface": {"distance": "a:b", "u": [0, 1]}}),
        (BALL, {"surface": {"parametrisation": "a:b", "u": [0, 1]}}),
        (BALL, {"surface": {"parametrisation": "a:b", "u": [1, 0], "v": [0, 1]}}),
        (BALL, {"surface": {"distance": "a:b", "length": 0}}),
        (BALL, hollow(ROD, radius=1, patch={"min": [0, 0]})),
        (BALL, hollow(ROD, radius=1, patch={"min": [0, "a", 0]})),
        (BALL, hollow(ROD, radius=1, patch={"min": [None, 1, 0], "max": [0, 1, None]})),
    ],
)
def test_surfaces_that_cannot_be_or_touch_are_refused_with_one_fault(arm, body):
    contact = {"arm": arm, "object": body}
    fault = only_fault("joints.0", {"arm": "left", "kind": "contacts", "contacts": [contact]})
    assert fault.startswith("$.joints[0].contacts[0]")


@pytest.mark.parametrize(
    ("arm", "body"),
    [
        (ROD, ROD),
        (ROD, HORN),
        (HORN, HORN),
        (RING, FACE),
        (EGG, FACE),
        (EGG, EGG),
        (RING, ROD),
        (BLOB, FACE),
        (BLOB, hollow(BALL)),
        (BALL, hollow(HORN)),
        (EGG, hollow(HORN)),
        (EGG, hollow(BALL, radius=0.14)),
        (RING, hollow(ROD, radius=0.11)),
        (RING, hollow(BALL, radius=0.41)),
        (ROD, hollow(RING, tube_radius=0.11)),
        # a shallow dish, cut from an ellipsoid, holds a ball larger than its own depth
        (BALL, hollow(EGG, semi_axes=[0.3, 0.3, 0.05])),
        ({"point": [0, 0, 0]}, hollow(EGG)),
    ],
)
def test_surfaces_that_can_touch_in_a_point_are_accepted_either_way_round(arm, body):
    for contact in ({"arm": arm, "object": body}, {"arm": body, "object": arm}):
        assert ContactsJoint(arm="a", contacts=[contact]).contacts


@pytest.mark.parametrize(
    "joint",
    [
        {"kind": "wrenches"},
        {"kind": "wrenches", "wrenches": []},
        {"kind": "wrenches", "wrenches": [[1, 0, 0]]},
        {"kind": "wrenches", "wrenches": [[0] * 6]},
        {"kind": "wrenches", "wrenches": [[1] * 6], "carried_by": "tip"},
        {
            "kind": "wrenches",
            "wrenches": [
                [1, 0, 0, 0, 0, 0],
                [0, 1, 0, 0, 0, 1],
                [0, 0, 1, 0, 0, 0],
                [3, -2, 0, 0, 0, -2],
                [0, 0, 1e-9, 0, 0, 0],
            ],
        },
        {"kind": "revolute", "limits": [0.1, 1]},
        {"kind": "revolute", "limits": [1, -1]},
        {"kind": "prismatic", "limits": 0.5},
        {"kind": "cylindrical", "limits": [-1, 1]},
        {"kind": "ball", "limits": [-1, 1]},
    ],
)
def test_faults_of_wrenches_and_limits_are_told(joint):
    only_fault("joints.0", {"arm": "left", **joint})


def test_a_seventh_wrench_is_always_too_many():
    rows = np.random.default_rng(3).normal(size=(7, 6)).tolist()
    fault = only_fault("joints.0", {"arm": "left", "kind": "wrenches", "wrenches": rows})
    assert "wrench 7 is a combination of wrenches 1, 2, 3, 4, 5 and 6" in fault


def test_path_times_must_increase():
    path = [{"time": 1, "xyz": [0, 0, 1]}, {"time": 1, "xyz": [0, 0, 2]}]
    control = {"kind": "joint_pd", "stiffness": 1, "damping": 1, "path": path}
    assert "times of 'path' must increase" in only_fault("control", control)


# --- faults of the whole -----------------------------------------------------------------------


def test_all_faults_of_all_groups_are_told_at_once():
    data = copy.deepcopy(TWO_ARMS)
    data["object"]["mass"] = -1
    data["arms"]["left"]["tip"] = "tol"
    data["joints"][1]["arm"] = "rigth"
    data["joints"][0]["kind"] = "wold"
    data["effects"] = {"wind": 1}
    message = "\n".join(faults := faults_of(data))
    for part in ("object.mass", "arms.left.tip", "joints[1].arm", "joints[0].kind", "effects.wind"):
        assert f"$.{part}" in message
    assert "arm 'right' is connected by no joint" in message
    assert len(faults) == 6


def test_message_lists_every_fault_on_its_own_line():
    with pytest.raises(SceneError) as caught:
        parse_scene(scene_with("run", {"duration": -1, "output_step": 0}))
    head, *lines = str(caught.value).splitlines()
    assert head == "the scene has 2 faults:"
    assert [line.strip() for line in lines] == caught.value.faults


def test_an_arm_without_a_joint_is_a_fault():
    data = copy.deepcopy(TWO_ARMS)
    del data["joints"][1]
    (fault,) = faults_of(data)
    assert "arm 'right' is connected by no joint" in fault
    assert "{arm: right, kind: weld}" in fault


def test_an_arm_with_two_joints_is_a_fault():
    data = copy.deepcopy(TWO_ARMS)
    data["joints"].append({"arm": "left", "kind": "ball"})
    (fault,) = faults_of(data)
    assert "arm 'left' has 2 joints" in fault
    assert "'contacts'" in fault


def test_parts_built_in_python_refuse_with_the_same_error():
    with refused(SceneError, "Pose.xyz[1]"):
        Pose(xyz=[0, "a", 0])
    with refused(SceneError, "'raduis'"):
        ObjectSpec(shape={"cylinder": {"raduis": 1, "height": 2}}, mass=1)


def test_no_word_of_the_validation_library_reaches_the_user():
    data = scene_with("joints.0", 3)
    data["arms"]["left"] = []
    data["run"] = None
    data["control"] = [1]
    data["object"]["shape"] = "box"
    text = "\n".join(faults_of(data))
    for word in ("pydantic", "Input should", "input_value", "instance of", "Spec"):
        assert word not in text


# --- files -------------------------------------------------------------------------------------


def test_missing_file_is_told_with_its_neighbours(tmp_path):
    (tmp_path / "other.yaml").write_text("")
    with refused(SceneError, "scene.yaml"):
        load_scene(tmp_path / "scene.yaml")
    with refused(SceneError, str(tmp_path)):
        load_scene(tmp_path)


def test_broken_yaml_is_told_with_line_and_column(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_text("name: x\nobject: {mass: 1\narms: [\n")
    with refused(SceneError, str(path)) as caught:
        load_scene(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("010", 10), ("08", 8), ("+7", 7), ("0x1F", 31), ("-0x1F", -31), ("0o17", 15),
        ("1e3", 1000.0), (".5", 0.5), ("-.5", -0.5), ("1.", 1.0), ("1.5e3", 1500.0),
        (".inf", math.inf), ("1:30", "1:30"), ("1:30.5", "1:30.5"), ("1_0", "1_0"),
        ("1_0.5", "1_0.5"), ("0b11", "0b11"), ("!!int 010", 10), ("!!float 5", 5.0),
    ],
)  # fmt: skip
def test_numbers_are_those_of_yaml_1_2_and_texts_like_them_stay_texts(written, value):
    read = parse_yaml(f"a: {written}")["a"]
    assert (read, type(read)) == (value, type(value))
    for data in (written, value):
        again = parse_yaml(written_yaml({"a": data}))["a"]
        assert (again, type(again)) == (data, type(data))


@pytest.mark.parametrize("text", ["1:30", "1_0", "!!int 1_0", "!!float 1:30.5"])
def test_what_only_yaml_1_1_calls_a_number_is_refused_where_one_is_needed(text):
    with refused(SceneError, "1_0" if "1_0" in text else "1:30"):
        parse_scene(
            yaml.safe_dump({**TWO_ARMS, "gravity": None}) + f"\nrun: {{duration: {text}}}\n"
        )


def test_a_key_that_stands_twice_is_a_fault():
    text = yaml.safe_dump(TWO_ARMS) + "\ngravity: [0, 0, 0]\n"
    with refused(SceneError, "'gravity'"):
        parse_scene(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("b: &b {mass: 1, xyz: 2}\nc: {<<: *b, xyz: 3}", {"mass": 1, "xyz": 3}),
        ("b: &b {mass: 1}\nc: {<<: [*b, {mass: 2, xyz: 2}]}", {"mass": 1, "xyz": 2}),
        ("b: &b {mass: 1}\nl: [&j {<<: *b, mass: 2}]\nc: {<<: *j, z: 3}", {"mass": 2, "z": 3}),
        ("b: &b {x: 1}\nl: [&j {<<: *b, x: 2}]\nc: {<<: *j, z: 3}", {"x": 2, "z": 3}),
    ],
    ids=["overridden", "several", "of a table that overrides too", "of one letter"],
)
def test_a_merge_takes_over_the_entries_that_a_table_does_not_have(text, value):
    assert parse_yaml(text)["c"] == value


@pytest.mark.parametrize("text", ["a: {<<: 3}", "a: {<<: [{b: 1}, c]}", "a: <<"])
def test_a_merge_of_what_is_no_table_is_refused(text):
    with refused(SceneError, "'<<'"):
        parse_yaml(text)


def test_a_key_that_is_a_list_is_refused():
    with refused(SceneError, "line 1, column 7"):
        parse_yaml("a: {? [1] : 2}")


@pytest.mark.parametrize("text", ["", "[]", "3", "just words"])
def test_a_text_that_is_no_table_is_refused(text):
    with refused(SceneError, "$: "):
        parse_scene(text)


def test_binary_file_is_refused(tmp_path):
    path = tmp_path / "scene.yaml"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with refused(SceneError, str(path)):
        load_scene(path)


def test_errors_are_one_family_and_can_be_sent_between_processes():
    import pickle

    error = SceneError(["$.a: wrong", "$.b: wrong"], source="scene.yaml")
    assert isinstance(error, MultiarmError)
    again = pickle.loads(pickle.dumps(error))
    assert (again.faults, str(again)) == (error.faults, str(error))


# --- values per joint --------------------------------------------------------------------------


def test_joint_values_in_all_forms():
    names = ("a", "b", "c")
    np.testing.assert_array_equal(joint_vector(2.0, names), [2, 2, 2])
    np.testing.assert_array_equal(joint_vector([1, 2, 3], names), [1, 2, 3])
    np.testing.assert_array_equal(joint_vector({"b": 5}, names, default=1.0), [1, 5, 1])
    np.testing.assert_array_equal(joint_vector(None, names), [0, 0, 0])
    np.testing.assert_array_equal(gain_vector({"left": {"c": 4}}, "left", names), [0, 0, 4])
    np.testing.assert_array_equal(gain_vector({"left": 4}, "right", names), [0, 0, 0])
    np.testing.assert_array_equal(gain_vector((1, 2, 3), "left", names), [1, 2, 3])
    with pytest.raises(ValueError, match="unknown joint 'd'"):
        joint_vector({"d": 1}, names)


# --- whatever is written, the answer is a scene or a SceneError ---------------------------------

_junk = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 3) | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(max_size=5) | st.integers(), inner, max_size=3)
    ),
    max_leaves=6,
)
_places = st.sampled_from(
    [
        *TWO_ARMS,
        "run",
        "control",
        "effects",
        "object.shape",
        "object.inertia",
        "object.pose",
        "arms.left",
        "arms.left.posture",
        "arms.left.lock",
        "arms.left.tool",
        "arms.left.base.rpy",
        "joints.0",
        "joints.1.at",
        "joints.1.contacts.0.object",
        "joints.1.contacts.0.arm.surface",
        "joints.1.contacts.0.arm.surface.distance",
        "joints.1.wrenches",
        "control.torques",
        "control.kind",
        "effects.joint_damping",
        "run.stabilization",
    ]
)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(path=_places, value=_junk)
def test_junk_anywhere_gives_a_scene_or_a_scene_error(path, value):
    data = with_functions(distance="shapes:blob") if "contacts" in path else scene_with(path, value)
    if "contacts" in path:
        contact = data["joints"][1]["contacts"][0]
        contact["object"], contact["arm"] = contact["arm"], contact["object"]
        *way, last = path.split(".")[4:]
        table = contact
        for part in way:
            table = table[part]
        table[last] = value
    if path == "joints.1.wrenches":
        data["joints"][1]["kind"] = "wrenches"
        del data["joints"][1]["at"]
    if path == "control.torques":
        data["control"]["kind"] = "constant"
    try:
        scene = parse_scene(data)
    except SceneError as error:
        assert error.faults
        assert all(fault.startswith("$") for fault in error.faults)
    else:
        assert parse_scene(dump_scene(scene)) == scene


@settings(max_examples=30, deadline=None)
@given(text=st.text(max_size=60))
def test_any_text_gives_a_scene_error(text):
    with pytest.raises(SceneError):
        parse_scene(text)


def test_a_part_with_its_own_init_is_read_by_it_and_others_have_all_faults_told():
    class Rod(Spec):
        length: float

        def __init__(self, **data):
            super().__init__(**{"length": 2.0, **data})

    class Pair(Spec):
        rod: Rod
        left: Pose
        right: Pose

    assert Pair(rod={}, left={}, right={}).rod.length == 2.0
    with pytest.raises(SceneError) as told:
        Pair(rod={}, left={"xyz": [1]}, right={"rpy": 3})
    assert [fault.place for fault in told.value.faults] == ["Pair.left.xyz", "Pair.right.rpy"]
