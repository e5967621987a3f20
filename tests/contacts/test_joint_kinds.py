"""Claims about the kinds of joint: how many rows, which motions are free, which are not."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import carried, kernel_rows, pose, random_pose
from repository import WORKED
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from multiarm.contacts.table import COMBINED, ON_PLANE, TANGENT, Code, pack
from multiarm.errors import ModelError
from multiarm.jit.rows import fields_of
from multiarm.scene import (
    BallJoint,
    ContactsJoint,
    CornerGripperJoint,
    CylindricalJoint,
    PlanarJoint,
    PointOnCylinderJoint,
    PointOnPlaneJoint,
    PointOnSphereJoint,
    Pose,
    PrismaticJoint,
    RevoluteJoint,
    UniversalJoint,
    WeldJoint,
    WrenchesJoint,
)
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.loading import loaded_functions

AXIS = (0.3, -0.5, 0.9)
# our joint -> name of the worked example
WORKED_NAME = {
    WeldJoint: "weld 3-2-1",
    RevoluteJoint: "revolute z",
    PrismaticJoint: "prismatic z",
    CylindricalJoint: "cylindrical z",
    UniversalJoint: "universal (u=x on body1, w=y on body2)",
    BallJoint: "hard finger (point with friction, 3 coincident)",
    PlanarJoint: "planar (normal z)",
    PointOnPlaneJoint: "point on plane (normal z)",
}


def turn(axis, angle):
    axis = np.asarray(axis, float)
    return Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()


def along(axis, way):
    return way * np.asarray(axis, float) / np.linalg.norm(axis)


def across(axis):
    return null_space(np.array([axis], float)).T


def free_motion(joint, s):
    """Pose of the tip in the object frame after the free motion with coordinates ``s``, (4, 4)."""
    kind = joint.kind
    if kind == "weld":
        return np.eye(4)
    if kind == "revolute":
        return pose(turn(joint.axis, s[0]), np.zeros(3))
    if kind == "prismatic":
        return pose(np.eye(3), along(joint.axis, s[0]))
    if kind == "cylindrical":
        return pose(turn(joint.axis, s[0]), along(joint.axis, s[1]))
    if kind == "universal":
        return pose(turn([1, 0, 0], s[0]) @ turn([0, 1, 0], s[1]), np.zeros(3))
    if kind == "ball":
        return pose(Rotation.from_rotvec(s[:3]).as_matrix(), np.zeros(3))
    if kind == "planar":
        u, v = across(joint.normal)
        return pose(turn(joint.normal, s[0]), s[1] * u + s[2] * v)
    if kind == "point_on_plane":
        u, v = across(joint.normal)
        touching = along(joint.normal, joint.tip_radius)
        return pose(Rotation.from_rotvec(s[:3]).as_matrix(), touching + s[3] * u + s[4] * v)
    radius = joint.radius + (-1 if joint.inside else 1) * joint.tip_radius
    R = Rotation.from_rotvec(s[:3]).as_matrix()
    if kind == "point_on_cylinder":
        u, _ = across(joint.axis)
        return pose(R, turn(joint.axis, s[3]) @ (radius * u) + along(joint.axis, s[4]))
    return pose(R, Rotation.from_rotvec(s[2:5]).as_matrix() @ [radius, 0, 0])


FREE = {
    "weld": 0, "ball": 3, "revolute": 1, "prismatic": 1, "cylindrical": 2, "universal": 2,
    "planar": 3, "point_on_plane": 5, "point_on_cylinder": 5, "point_on_sphere": 5,
}  # fmt: skip
JOINTS = [
    WeldJoint(arm="a", size=0.07),
    BallJoint(arm="a"),
    RevoluteJoint(arm="a"),
    RevoluteJoint(arm="a", axis=AXIS, size=0.23),
    PrismaticJoint(arm="a", axis=AXIS),
    CylindricalJoint(arm="a", axis=AXIS),
    UniversalJoint(arm="a", size=0.05),
    PlanarJoint(arm="a", normal=AXIS),
    PointOnPlaneJoint(arm="a", normal=AXIS),
    PointOnPlaneJoint(arm="a", normal=AXIS, tip_radius=0.02),
    PointOnCylinderJoint(arm="a", axis=AXIS, radius=0.3, tip_radius=0.02),
    PointOnCylinderJoint(arm="a", axis=AXIS, radius=0.3, tip_radius=0.02, inside=True),
    PointOnSphereJoint(arm="a", radius=0.3, tip_radius=0.02),
    PointOnSphereJoint(arm="a", radius=0.3, tip_radius=0.02, inside=True),
]
IDS = [f"{joint.kind}_{k}" for k, joint in enumerate(JOINTS)]


def rows_at(joint, X_OT, X_WO=None):
    X_WO = np.eye(4) if X_WO is None else X_WO
    return kernel_rows(joint.placed(np.eye(4)), X_WO @ X_OT, X_WO)


@pytest.mark.parametrize("cls", WORKED_NAME, ids=lambda cls: cls.__name__)
def test_rows_rank_and_free_directions_are_those_of_the_thesis(cls):
    expected = {e["name"]: e for e in WORKED["joint_models"]["expected"]}[WORKED_NAME[cls]]
    W = rows_at(cls(arm="a"), np.eye(4)).W_m
    assert W.shape[1] == expected["N"]
    assert np.linalg.matrix_rank(W, tol=1e-9) == expected["rank"]
    T = np.array(expected["T_columns"]).reshape(-1, 6).T
    assert T.shape[1] == expected["dof"] == 6 - expected["rank"]
    np.testing.assert_allclose(W.T @ T, 0.0, atol=1e-12)


@pytest.mark.parametrize("joint", JOINTS, ids=IDS)
def test_finite_motions_along_the_free_directions_keep_all_gaps_closed(joint, rng):
    for _ in range(5):
        X_OT = free_motion(joint, rng.uniform(-1.2, 1.2, 5))
        rows = rows_at(joint, X_OT, random_pose(rng))
        np.testing.assert_allclose(rows.phi, 0.0, atol=1e-12)
        assert np.linalg.matrix_rank(rows.W_o, tol=1e-6) == 6 - FREE[joint.kind]


@pytest.mark.parametrize("joint", JOINTS, ids=IDS)
def test_every_other_motion_opens_a_gap(joint, rng):
    X_OT = free_motion(joint, rng.uniform(-0.5, 0.5, 5))
    W = rows_at(joint, X_OT).W_m
    T = null_space(W.T, rcond=1e-9)
    assert T.shape[1] == FREE[joint.kind]
    for held in null_space(T.T).T if T.size else np.eye(6):
        twist = np.concatenate([X_OT[:3, :3] @ held[:3], X_OT[:3, :3] @ held[3:]])
        opened = rows_at(joint, carried(X_OT, twist, 1e-4)).phi
        assert np.max(np.abs(opened)) > 1e-4 * 0.01


@pytest.mark.parametrize("joint", JOINTS, ids=IDS)
def test_joint_frames_may_stand_anywhere(joint, rng):
    """Moved frames on both bodies change where a joint is, not what it is."""
    at_tip, X_OJ = Pose(xyz=(0.1, -0.2, 0.3), rpy=(0.4, -0.8, 1.2)), random_pose(rng)
    moved = joint.model_copy(update={"at_tip": at_tip}).placed(X_OJ)
    X_OT = X_OJ @ free_motion(joint, rng.uniform(-1, 1, 5)) @ np.linalg.inv(at_tip.matrix())
    X_WO = random_pose(rng)
    np.testing.assert_allclose(kernel_rows(moved, X_WO @ X_OT, X_WO).phi, 0.0, atol=1e-12)


@pytest.mark.parametrize("joint", JOINTS, ids=IDS)
def test_a_joint_placed_where_the_tip_is_is_closed(joint):
    """The offset puts a fingertip's face one radius away from its centre."""
    X_JT = pose(np.eye(3), -joint.offset())
    np.testing.assert_allclose(rows_at(joint, X_JT).phi, 0.0, atol=1e-15)


def test_corner_gripper_is_example_3_1_of_the_thesis():
    example = WORKED["example_3_1"]
    first = np.array(example["inputs"]["points_in_object_frame"][0])
    # the gripper's frame is at its first contact
    joint = CornerGripperJoint(
        arm="a", points=example["inputs"]["points_in_object_frame"], at_tip=Pose(xyz=tuple(-first))
    )
    contacts = joint.placed(np.eye(4))
    rows = kernel_rows(contacts, pose(np.eye(3), first), np.eye(4))
    np.testing.assert_allclose(rows.W_m, example["expected"]["W"], atol=1e-12)
    np.testing.assert_allclose(rows.W_m.T @ example["expected"]["T"], 0.0, atol=1e-9)
    np.testing.assert_allclose(rows.phi, 0.0, atol=1e-15)


def test_round_fingertips_of_the_corner_gripper_touch_the_same_points():
    sharp, tipped = CornerGripperJoint(arm="a"), CornerGripperJoint(arm="a", tip_radius=0.01)
    for joint in (sharp, tipped):
        rows = rows_at(joint, np.eye(4))
        np.testing.assert_allclose(rows.phi, 0.0, atol=1e-15)
        np.testing.assert_allclose(rows.W_o, rows_at(sharp, np.eye(4)).W_o, atol=1e-15)


def test_welded_bodies_that_turn_need_a_centripetal_acceleration():
    """v_m' - G v_o' = (-4, 0, 0, 0, 0, 0) although nothing moves in the joint (thesis, 3.6)."""
    example = WORKED["weld_bias"]
    data = example["inputs"]
    omega, x = np.array(data["omega"], float), np.array(data["x_m_minus_x_o"])
    contacts = WeldJoint(arm="a").placed(pose(np.eye(3), x))
    twist_O = np.concatenate([data["xdot_o"], omega])
    twist_T = np.concatenate([data["xdot_o"] + np.cross(omega, x), omega])
    rows = kernel_rows(contacts, pose(np.eye(3), x), np.eye(4), twist_T, twist_O)
    bias = np.linalg.solve(rows.W_m.T, rows.c)  # W_m^T v_m' = c at v_o' = 0
    np.testing.assert_allclose(bias, example["expected"]["vdot_m_minus_G_vdot_o"], atol=1e-12)


def test_listed_contacts_meet_either_way_round():
    plane = {"plane": {"point": [0, 0, 0.2], "normal": [0, 0, 2.0]}}
    ball = {"sphere": {"center": [0, 0, 0.25], "radius": 0.05}}
    for arm, body in ((ball, plane), (plane, ball)):
        joint = ContactsJoint(arm="a", contacts=[{"arm": arm, "object": body}])
        rows = rows_at(joint, np.eye(4))
        assert rows.phi[0] == pytest.approx(0.0, abs=1e-15)
        # the arm's ball pushes the object's face down, the arm's face pushes the object's ball up
        assert rows.W_o[2, 0] == (-1.0 if arm is ball else 1.0)


def test_every_kind_is_covered_here():
    tested = {joint.kind for joint in JOINTS} | {"corner_gripper", "contacts", "wrenches"}
    assert tested == set(BUILT_IN)


# --- the frame in which free motions are told -----------------------------------------------------


@pytest.mark.parametrize("joint", [j for j in JOINTS if j.free], ids=lambda j: j.kind)
def test_free_components_are_the_motion_space_in_the_joints_frame(joint):
    at_tip, X_OJ = (
        Pose(xyz=(0.1, -0.2, 0.3), rpy=(0.4, -0.8, 1.2)),
        pose(turn([1, 2, 3], 0.7), AXIS),
    )
    joint = joint.model_copy(update={"at_tip": at_tip})
    on_tip, on_object = joint.frames(X_OJ)
    R, x = on_tip[:3, :3], on_tip[:3, 3]
    W = kernel_rows(joint.placed(X_OJ), on_object @ np.linalg.inv(on_tip), np.eye(4)).W_m
    for k, way in enumerate(np.eye(6)):
        # a twist of the tip that is one component at the joint's frame, in the axes of the tip
        v, w = R @ way[:3], R @ way[3:]
        work = W.T @ np.concatenate([v + np.cross(x, w), w])
        free = k in joint.free
        assert (np.max(np.abs(work)) < 1e-12) == free


def test_the_joints_frame_has_the_axis_as_its_z_axis():
    on_tip, on_object = RevoluteJoint(arm="a", axis=AXIS).frames(np.eye(4))
    np.testing.assert_allclose(on_tip[:3, 2], along(AXIS, 1.0), atol=1e-15)
    np.testing.assert_array_equal(on_tip, on_object)
    np.testing.assert_array_equal(UniversalJoint(arm="a").frames(np.eye(4))[0], np.eye(4))


# --- wrenches -------------------------------------------------------------------------------------

FORCES = [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0]]
U, V = across(AXIS)


def couple(way):
    return [0, 0, 0, *way]


def through(force, at):
    return [*force, *np.cross(at, force)]


@pytest.mark.parametrize("carried_by", ["object", "arm"])
def test_rows_of_wrenches_exert_the_wrenches_that_are_written(carried_by, rng):
    wrenches = rng.uniform(-2, 2, (6, 6))
    wrenches[1, 3:], wrenches[2, :3] = 0.0, 0.0  # a force through the origin, and a couple
    joint = WrenchesJoint(arm="a", wrenches=wrenches, carried_by=carried_by)
    rows = rows_at(joint, np.eye(4))
    np.testing.assert_allclose(rows.W_o, wrenches.T, atol=1e-13)
    np.testing.assert_allclose(rows.W_m, -wrenches.T, atol=1e-13)
    np.testing.assert_allclose(rows.phi, 0.0, atol=1e-15)


@pytest.mark.parametrize("carried_by", ["object", "arm"])
def test_directions_are_fixed_to_the_body_that_carries_them(carried_by, rng):
    joint = WrenchesJoint(arm="a", wrenches=[[1, 2, 2, 0, 0, 0]], carried_by=carried_by)
    X_OT = random_pose(rng)
    rows = rows_at(joint, X_OT)
    W = rows.W_o if carried_by == "object" else -rows.W_m
    np.testing.assert_allclose(W[:3, 0], [1, 2, 2], atol=1e-14)


def test_a_unit_force_is_a_plain_contact_and_other_wrenches_are_combinations():
    joint = WrenchesJoint(arm="a", wrenches=[[0.6, 0, 0.8, 0, 0.1, 0], couple([1, 0, 0])])
    plain, combined = joint.placed(np.eye(4))
    assert (plain.is_combined, combined.is_combined) == (False, True)
    codes = fields_of(Code, pack([plain, combined]).table.codes)
    assert list(codes.kind[:2]) == [ON_PLANE, COMBINED]
    assert [plain.name, combined.name] == ["wrench 1", "wrench 2"]


AT = np.array([0.4, -0.3, 0.2])
AXIS_WAY = np.array(along(AXIS, 1.0))
# a hinge about AXIS through AT, a ball at AT, ...: wrenches in a basis of no particular shape
WRENCH_JOINTS = {
    "hinge": (
        [through(f[:3], AT) for f in FORCES] + [couple(U + 0.3 * V), couple(V - 2 * U)],
        lambda s: pose(R := turn(AXIS, s[0]), AT - R @ AT),
    ),
    "hinge of forces": (
        [
            through(f, AT + h * AXIS_WAY)
            for f, h in ((U, 0.1), (V + AXIS_WAY, 0.1), (U + V, -0.2), (V, -0.1), (AXIS_WAY, 0))
        ],
        lambda s: pose(R := turn(AXIS, s[0]), AT - R @ AT),
    ),
    "ball": (
        [through(f, AT) for f in np.eye(3) + 0.2],
        lambda s: pose(R := Rotation.from_rotvec(s[:3]).as_matrix(), AT - R @ AT),
    ),
    "slider": (
        [through(U, AT), through(V + U, -AT), *map(couple, np.eye(3) + 0.1)],
        lambda s: pose(np.eye(3), along(AXIS, s[0])),
    ),
    "cylindrical": (
        [through(U, AT), through(V + U, AT), couple(U), couple(U + V)],
        lambda s: pose(R := turn(AXIS, s[0]), AT - R @ AT + along(AXIS, s[1])),
    ),
    "planar": (
        [[*AXIS_WAY, *(0.1 * U)], couple(U + V), couple(V)],
        lambda s: pose(turn(AXIS, s[0]), s[1] * U + s[2] * V),
    ),
}


@pytest.mark.parametrize("carried_by", ["object", "arm"])
@pytest.mark.parametrize("name", WRENCH_JOINTS)
def test_joints_of_wrenches_stay_closed_when_they_move_far(name, carried_by, rng):
    wrenches, motion = WRENCH_JOINTS[name]
    joint = WrenchesJoint(arm="a", wrenches=wrenches, carried_by=carried_by)
    for _ in range(5):
        rows = rows_at(joint, motion(rng.uniform(-1.5, 1.5, 3)), random_pose(rng))
        np.testing.assert_allclose(rows.phi, 0.0, atol=2e-13)
        assert np.linalg.matrix_rank(rows.W_o, tol=1e-6) == len(wrenches)


# --- what a user lists ----------------------------------------------------------------------------


def listed(arm, body, **more):
    joint = ContactsJoint(arm="a", contacts=[{"arm": arm, "object": body, **more}])
    return loaded_functions(joint).placed(np.eye(4))


HERE = [0.2, 0.0, 0.1]
TOUCHING = {  # each surface passes through HERE with a normal that is easily told
    "plane": ({"point": HERE, "normal": [3, 0, 4]}, [0.6, 0, 0.8]),
    "sphere": ({"radius": 0.2, "center": [0, 0, 0.1]}, [1, 0, 0]),
    "cylinder": ({"radius": 0.2}, [1, 0, 0]),
    "cone": ({"half_angle": np.pi / 4, "apex": [0.1, 0, 0]}, [0.5**0.5, 0, -(0.5**0.5)]),
    "torus": ({"circle_radius": 0.2, "tube_radius": 0.1}, [0, 0, 1]),
    "ellipsoid": ({"semi_axes": [0.3, 0.1, 0.2], "rpy": [0, np.pi / 2, 0]}, None),
    "surface": ({"distance": lambda p: (p @ p) ** 0.5 - 0.3, "origin": [0.2, 0, -0.2]}, [0, 0, 1]),
}


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("shape", TOUCHING)
def test_every_surface_is_touched_where_it_is_written(shape, inside):
    given, normal = TOUCHING[shape]
    given, here = dict(given), HERE
    if shape == "ellipsoid":  # turned: its short half axis is y, its long one is -z
        here, normal = [0.0, 0.0, 0.3], [0, 0, 1]
    if inside and shape != "plane":
        given, normal = {**given, "inside": True}, -np.array(normal)
    for arm, body, way in (
        ({"point": here}, {shape: given}, -1.0),
        ({shape: given}, {"point": here}, 1.0),
    ):
        rows = kernel_rows(listed(arm, body), np.eye(4), np.eye(4))
        np.testing.assert_allclose(rows.phi, 0.0, atol=1e-15)
        np.testing.assert_allclose(rows.normals[0], way * np.array(normal), atol=1e-12)


def test_a_rolling_contact_has_two_rows_more():
    contacts = listed(
        {"sphere": {"radius": 0.1, "center": [0, 0, 0.1]}},
        {"plane": {"normal": [0, 0, 1]}},
        rolling=True,
        name="wheel",
    )
    assert [c.name for c in contacts] == ["wheel", "wheel, no slip 1", "wheel, no slip 2"]
    assert [c.pushes_only for c in contacts] == [True, False, False]
    assert list(fields_of(Code, pack(contacts).table.codes).kind) == [ON_PLANE, TANGENT, TANGENT]
    W = kernel_rows(contacts, np.eye(4), np.eye(4)).W_o
    np.testing.assert_allclose(W[:3].T @ W[:3], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(W[3:], 0.0, atol=1e-15)  # they touch at the origin


def test_contacts_that_stand_for_real_ones_are_known_to_push_only():
    real = {"point_on_plane", "point_on_cylinder", "point_on_sphere"}
    for joint in JOINTS:
        told = {contact.pushes_only for contact in joint.placed(np.eye(4))}
        assert told == {joint.kind in real}


def test_a_patch_is_a_box_in_the_frame_of_the_joint_and_moves_with_it():
    joint = ContactsJoint(
        arm="a",
        at=Pose(xyz=(1, 0, 0)),
        contacts=[
            {
                "arm": {"point": [0, 0, 0]},
                "object": {
                    "plane": {
                        "normal": [0, 0, 1],
                        "patch": {"min": [-0.1, None, None], "max": [0.2] * 3},
                    }
                },
            }
        ],
    )
    (contact,) = joint.placed(joint.at.matrix())
    patch = contact.object.patch
    assert contact.arm.patch is None
    assert patch.excess(np.array([1.25, -9.0, -9.0])) == pytest.approx(0.05)
    assert patch.excess(np.array([0.85, 0.0, 0.0])) == pytest.approx(0.05)
    assert patch.excess(np.array([1.05, 0.0, 0.0])) == pytest.approx(-0.15)


# --- functions ------------------------------------------------------------------------------------


def test_functions_are_found_in_files_and_in_modules(tmp_path, monkeypatch):
    text = "def ball(p):\n    return (p @ p) ** 0.5 - 0.3\n"
    (tmp_path / "user_shapes_file.py").write_text(text)
    (tmp_path / "user_shapes_module.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    for given in (f"{tmp_path}/user_shapes_file.py:ball", "user_shapes_module:ball"):
        contacts = listed({"point": [0, 0, 0.3]}, {"surface": {"distance": given}})
        rows = kernel_rows(contacts, np.eye(4), np.eye(4))
        np.testing.assert_allclose(rows.phi, 0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("no_such_module:ball", "cannot load the function 'no_such_module:ball': ModuleNotFound"),
        ("no_such_file.py:ball", "there is no file no_such_file.py"),
        ("mechanics:no_such_name", "there is no 'no_such_name' in mechanics; its functions are"),
        ("numpy:pi", "'pi' in numpy is not a function"),
        ("mechanics:np.save", "'np.save' is not a plain name; name a function that stands in"),
        ("tests:<lambda>", "has no name by which it can be found again"),
    ],
)
def test_functions_that_cannot_be_found_are_told(given, expected):
    with pytest.raises(ModelError) as caught:
        listed({"point": [0, 0, 0.3]}, {"surface": {"distance": given}})
    assert expected in str(caught.value)


def test_a_file_that_fails_is_told_with_its_error(tmp_path):
    (tmp_path / "broken.py").write_text("1 / 0")
    with pytest.raises(ModelError, match=r"broken\.py:ball.*ZeroDivisionError"):
        listed({"point": [0, 0, 1]}, {"surface": {"distance": f"{tmp_path}/broken.py:ball"}})
