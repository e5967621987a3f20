"""Claims about the kinds of joint: how many rows, which motions are free, which are not."""

from __future__ import annotations

import numpy as np
import pytest
from mechanics import WORKED, carried, kernel_rows, pose, random_pose
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from multiarm.contacts.catalogue import CATALOGUE, joint_contacts, surface_offset
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
)

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
    return kernel_rows(joint_contacts(joint, np.eye(4)), X_WO @ X_OT, X_WO)


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
    moved = joint_contacts(joint.model_copy(update={"at_tip": at_tip}), X_OJ)
    X_OT = X_OJ @ free_motion(joint, rng.uniform(-1, 1, 5)) @ np.linalg.inv(at_tip.matrix())
    X_WO = random_pose(rng)
    np.testing.assert_allclose(kernel_rows(moved, X_WO @ X_OT, X_WO).phi, 0.0, atol=1e-12)


@pytest.mark.parametrize("joint", JOINTS, ids=IDS)
def test_a_joint_placed_where_the_tip_is_is_closed(joint):
    """The offset puts a fingertip's face one radius away from its centre."""
    X_JT = pose(np.eye(3), -surface_offset(joint))
    np.testing.assert_allclose(rows_at(joint, X_JT).phi, 0.0, atol=1e-15)


def test_corner_gripper_is_example_3_1_of_the_thesis():
    example = WORKED["example_3_1"]
    first = np.array(example["inputs"]["points_in_object_frame"][0])
    # the gripper's frame is at its first contact
    joint = CornerGripperJoint(
        arm="a", points=example["inputs"]["points_in_object_frame"], at_tip=Pose(xyz=tuple(-first))
    )
    contacts = joint_contacts(joint, np.eye(4))
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
    contacts = joint_contacts(WeldJoint(arm="a"), pose(np.eye(3), x))
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
    tested = {joint.kind for joint in JOINTS} | {"corner_gripper", "contacts"}
    assert tested == set(CATALOGUE)
