"""Claims about motion spaces: T, its rate, the choice of coordinates, the gripper's acceleration.

Oracles: the worked joints; formulas of the thesis; differences along motions of bodies, some of
which slide along their contacts exactly.
"""

from __future__ import annotations

import itertools
import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from mechanics import (
    body_twist,
    carried,
    first_difference,
    kernel_rows,
    pose,
    random_pose,
    random_state,
    second_difference,
)
from repository import WORKED
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.contacts.joint import COMPONENTS, JointFrame
from multiarm.contacts.matrices import (
    RelativeMotion,
    gripper_acceleration,
    gripper_twist,
    relative_wrenches,
    seen_from_object,
)
from multiarm.contacts.motion_space import (
    euler_rates,
    euler_selection,
    joint_selection,
    motion_space,
    motion_space_in_rates,
)
from multiarm.errors import GraspError, ModelError
from multiarm.geometry.records import (
    Contact,
    cylinder,
    plane,
    point,
    sphere,
)

CORNER = WORKED["example_3_1"]
POINTS = np.array(CORNER["inputs"]["points_in_object_frame"])
NORMALS = np.array(CORNER["inputs"]["normals_on_gripper"], float)
JOINTS = {joint["name"]: joint for joint in WORKED["joint_models"]["expected"]}


def wrenches(points, normals):
    """Columns ``[e; p x e]``."""
    return np.hstack([normals, np.cross(points, normals)]).T


def free_rows(T):
    """Rows of T that are unit rows, one for each column, in the columns' order."""
    return [next(r for r in range(6) if np.array_equal(T[r], e)) for e in np.eye(T.shape[1])]


# --- worked joints -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", JOINTS)
def test_worked_joints_have_their_rank_and_motions(name):
    joint = JOINTS[name]
    W = wrenches(np.array(joint["points"]), np.array(joint["normals"]))
    T = np.array(joint["T_columns"]).reshape(-1, 6).T
    found = motion_space(W, rows=free_rows(T))
    assert found.rank == joint["rank"] and found.T.shape == (6, joint["dof"])
    np.testing.assert_allclose(found.T, T, atol=1e-14)
    chosen = motion_space(W)
    np.testing.assert_allclose(W.T @ chosen.T, 0.0, atol=1e-14)
    assert sorted(chosen.rows + chosen.others) == list(range(6))


def test_corner_gripper_moves_as_in_the_worked_example():
    W = wrenches(POINTS - POINTS[0], NORMALS)
    np.testing.assert_allclose(W, CORNER["expected"]["W"], atol=1e-15)
    space = motion_space(W, rows=("slide x", "slide y"))
    np.testing.assert_allclose(space.T, CORNER["expected"]["T"], rtol=1e-9, atol=1e-12)
    assert space.rows == (0, 1) and space.others == (2, 3, 4, 5) and space.rank == 4


@pytest.mark.slow
@given(arrays(float, (4, 3), elements=st.floats(-0.1, 0.1)))
def test_corner_grippers_of_any_shape_move_as_the_thesis_says(points):
    """Equation (3.23) with a = z2 - z1, ...; contacts 1 and 3 at one height."""
    points[2, 2] = points[0, 2]
    (x1, y1, z1), (x2, _, z2), (x3, y3, _), (_, y4, z4) = points
    a, b, c, d, e, f = z2 - z1, x1 - x2, y1 - y3, x3 - x1, z1 - z4, y4 - y1
    delta = a * d * f + b * c * e
    assume(abs(delta) > 1e-5)
    lower = np.array([[-b * d, d * f], [b * c, -c * f], [a * d, c * e]]) / delta
    space = motion_space(wrenches(points - points[0], NORMALS), rows=(0, 1))
    np.testing.assert_allclose(space.T[:3], [[1, 0], [0, 1], [0, 0]], atol=1e-12)
    np.testing.assert_allclose(space.T[3:], lower, rtol=1e-9, atol=1e-9 * np.max(np.abs(lower)))


def along_the_line(tilt):
    """Orientations whose x axis is along the line of contacts 1 and 3; Euler angles z, x, third."""
    line = POINTS[2] - POINTS[0]
    return np.array([math.atan2(line[1], line[0]), tilt, 0.0])


@pytest.mark.parametrize("sequence", ["zxz", "zxy"])
def test_corner_gripper_in_euler_rates_has_columns_of_their_matrix(sequence):
    """Example 3.1 by its second guideline: x axis along contacts 1 and 3, third angle constant."""
    angles = along_the_line(0.4)
    W = wrenches(POINTS - POINTS[0], NORMALS)
    space = motion_space_in_rates(W, euler_selection(angles, sequence=sequence))
    E, _ = euler_rates(angles, np.zeros(3), sequence)
    np.testing.assert_allclose(space.T[3:], E[:, :2], atol=1e-12)
    np.testing.assert_allclose(space.T[2], 0.0, atol=1e-12)
    np.testing.assert_allclose(W.T @ space.T, 0.0, atol=1e-13)


def test_without_the_condition_euler_rates_are_coordinates_but_not_columns():
    """The gripper's x axis elsewhere: the third angle turns along."""
    angles = along_the_line(0.4) + [0.5, 0.0, 0.3]
    W = wrenches(POINTS - POINTS[0], NORMALS)
    selection = euler_selection(angles)
    space = motion_space_in_rates(W, selection)
    E, _ = euler_rates(angles, np.zeros(3))
    np.testing.assert_allclose(selection.matrix @ space.T, np.eye(2), atol=1e-12)
    third = np.linalg.solve(E, space.T[3:])[2]
    assert np.max(np.abs(third)) > 0.1
    np.testing.assert_allclose(space.T[3:], E[:, :2] + np.outer(E[:, 2], third), atol=1e-12)


def test_wrenches_on_the_gripper_become_those_of_the_worked_map():
    """W_m^o moved to the object is -W_o, also its rate (3.11, 3.7.2)."""
    data, expected = WORKED["W_map"]["inputs"], WORKED["W_map"]["expected"]
    W_m, x, x_dot = np.array(data["W_m"]), np.array(data["x_m_in_o"]), np.array(data["xdot"])
    relative = RelativeMotion(np.array(data["R_m_in_o"]), x, np.array(data["xdot"] + data["omega"]))
    W, W_dot = relative_wrenches(SimpleNamespace(W_m=W_m, W_m_dot=np.zeros_like(W_m)), relative)
    cross = lambda a, columns: np.cross(a, columns.T).T  # noqa: E731
    W_o = -np.vstack([W[:3], W[3:] + cross(x, W[:3])])
    W_o_dot = -np.vstack([W_dot[:3], W_dot[3:] + cross(x, W_dot[:3]) + cross(x_dot, W[:3])])
    np.testing.assert_allclose(W_o, expected["W_o"], atol=1e-12)
    np.testing.assert_allclose(W_o_dot, expected["W_o_dot"], atol=1e-12)


# --- any joint -----------------------------------------------------------------------------------


def pushes(rng, count):
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return wrenches(rng.uniform(-0.5, 0.5, (count, 3)), normals)


@pytest.mark.slow
@given(st.integers(0, 6), st.integers(0, 2**32 - 1), st.floats(-3, 3))
def test_rows_found_by_pivoting_always_serve(count, seed, size):
    """Also for joints of a millimetre and of a kilometre; the factor is that of QR pivoting."""
    W = pushes(np.random.default_rng(seed), count)
    W[3:] *= 10.0**size
    space = motion_space(W)
    assert space.T.shape == (6, 6 - space.rank) and space.condition >= 1.0 - 1e-12
    np.testing.assert_array_equal(space.T[list(space.rows)], np.eye(6 - space.rank))
    scale = np.repeat([1.0, 10.0**size], 3)
    np.testing.assert_allclose(
        (scale[:, None] * space.T).T @ (W / scale[:, None]), 0.0,
        atol=1e-12 * np.max(np.abs(scale[:, None] * space.T), initial=1.0),
    )  # fmt: skip
    assert space.condition < 40.0 * max(10.0 ** abs(size), 1.0)


def test_repeated_contacts_leave_the_same_motions(rng):
    W, W_dot = pushes(rng, 4), rng.standard_normal((6, 4))
    twice = motion_space(np.hstack([W, W[:, :2]]), np.hstack([W_dot, W_dot[:, :2]]), (3, 4))
    once = motion_space(W, W_dot, (3, 4))
    assert twice.rank == 4 and twice.mismatch < 1e-12
    np.testing.assert_allclose(twice.T, once.T, atol=1e-10)
    np.testing.assert_allclose(twice.T_dot, once.T_dot, atol=1e-9)


def test_a_rank_that_is_just_changing_is_reported(rng):
    """Two wrenches that are equal only now: T jumps, and the mismatch says so."""
    W, W_dot = pushes(rng, 3), rng.standard_normal((6, 3))
    later = np.hstack([W_dot, rng.standard_normal((6, 1))])
    assert motion_space(np.hstack([W, W[:, :1]]), later).mismatch > 0.1


def test_rows_that_stand_still_are_refused_and_others_offered(rng):
    W = wrenches(POINTS - POINTS[0], NORMALS)
    with pytest.raises(GraspError, match=r"slide x, slide z cannot serve .* all zero") as caught:
        motion_space(W, rows=("slide x", 2))
    offered = re.search(r"the best first: (.*)", str(caught.value)).group(1).split(" (and")[0]
    grades = []
    for rows in offered.split(", "):
        grades.append(motion_space(W, rows=rows.split(" + ")).condition)
    assert len(grades) == 6 and grades == sorted(grades)
    # all of the others were tried: none is better than the last one offered
    for rows in itertools.combinations(COMPONENTS, 2):
        if " + ".join(rows) not in offered:
            try:
                assert motion_space(W, rows=rows).condition >= grades[-1] * (1 - 1e-6)
            except GraspError:
                continue


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ((0,), "leave 2 motions free.*not 1"),
        ((0, 1, 2), "leave 2 motions free.*not 3"),
        ((0, 0), "each once"),
        ((0, 6), "0 to 5"),
        (("slide x", "yaw"), "rows of a twist are slide x"),
    ],
)
def test_a_wrong_choice_of_rows_is_told_in_words(rows, message):
    with pytest.raises(GraspError, match=message):
        motion_space(wrenches(POINTS - POINTS[0], NORMALS), rows=rows)


def test_rates_that_cannot_serve_are_told_in_words():
    W = wrenches(POINTS - POINTS[0], NORMALS)
    with pytest.raises(GraspError, match=r"Euler angles zxz have no rates .* another sequence"):
        euler_selection(np.zeros(3))
    with pytest.raises(GraspError, match="not 'zzx'"):
        euler_selection(np.zeros(3), sequence="zzx")
    one = euler_selection(along_the_line(0.4), chosen=(0,))
    with pytest.raises(GraspError, match=r"leave 2 motions free.*not 1 \(Euler angle 1 of zxz\)"):
        motion_space_in_rates(W, one)
    # the third angle stands still: with it, no choice of two is complete
    third = euler_selection(along_the_line(0.4), chosen=(0, 2))
    with pytest.raises(GraspError, match="cannot serve as coordinates"):
        motion_space_in_rates(W, third)


def test_a_welded_gripper_has_no_rates_to_choose():
    W = wrenches(*(np.array(JOINTS["weld 3-2-1"][key]) for key in ("points", "normals")))
    with pytest.raises(GraspError, match="none can: they leave nothing free"):
        motion_space(W, rows=(0,))
    assert motion_space(W, np.zeros_like(W), rows=()).T_dot.shape == (6, 0)


def test_acceleration_without_a_rate_is_refused():
    space = motion_space(wrenches(POINTS - POINTS[0], NORMALS))
    with pytest.raises(GraspError, match="rate of W"):
        space.acceleration(np.zeros(2), np.zeros(2))


def test_rows_have_the_names_of_a_joints_components():
    assert COMPONENTS == COMPONENTS


# --- rates, by differences -----------------------------------------------------------------------


@pytest.fixture
def motion(rng):
    """Poses of gripper and object and unrelated velocities of both."""
    return random_pose(rng), random_pose(rng), rng.standard_normal(6), rng.standard_normal(6)


def three_contacts(X_WT, X_WO):
    """A point of the arm on a plane, another in a bore, a point of the object on a sphere."""
    X_OT, X_TO = np.linalg.inv(X_WO) @ X_WT, np.linalg.inv(X_WT) @ X_WO
    touch = lambda X, p: X[:3, :3] @ np.array(p) + X[:3, 3]  # noqa: E731
    a, b, c = [0.1, 0.3, -0.2], [-0.2, 0.1, 0.3], [0.3, -0.1, 0.2]
    return [
        Contact("plane", point(a), plane(touch(X_OT, a), [1.0, 2.0, -1.0])),
        Contact(
            "bore", sphere(b, 0.02), cylinder(touch(X_OT, b) + [0.3, 0, 0], [0, 1, 1], 0.4, True)
        ),
        Contact("ball", sphere(touch(X_TO, c) + [0.0, 0.4, 0.0], 0.4), point(c)),
    ]


def moved(motion, t):
    """Gripper and object after ``t``: poses and twists."""
    X_WT, X_WO, twist_T, twist_O = motion
    return carried(X_WT, twist_T, t), carried(X_WO, twist_O, t), twist_T, twist_O


def wrenches_at(contacts, motion, t):
    """Relative motion and ``W_m^o`` with its rate at time ``t`` (kernel's W_m)."""
    X_WT, X_WO, twist_T, twist_O = moved(motion, t)
    relative = seen_from_object(X_WO, twist_O, X_WT, twist_T)
    return relative, *relative_wrenches(
        kernel_rows(contacts, X_WT, X_WO, twist_T, twist_O), relative
    )


def test_relative_motion_is_what_differences_say(motion):
    def relative(t):
        X_WT, X_WO, _, _ = moved(motion, t)
        return np.linalg.inv(X_WO) @ X_WT

    found = seen_from_object(motion[1], motion[3], motion[0], motion[2])
    rate = first_difference(relative, 1e-2)
    np.testing.assert_allclose(found.rotation, relative(0.0)[:3, :3], atol=1e-14)
    np.testing.assert_allclose(found.translation, relative(0.0)[:3, 3], atol=1e-14)
    np.testing.assert_allclose(found.twist[:3], rate[:3, 3], atol=1e-10)
    spin = rate[:3, :3] @ found.rotation.T
    np.testing.assert_allclose(found.twist[3:], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-10)


def test_relative_wrenches_have_the_rate_of_differences(motion):
    contacts = three_contacts(*motion[:2])
    _, W, W_dot = wrenches_at(contacts, motion, 0.0)
    expected = first_difference(lambda t: wrenches_at(contacts, motion, t)[1], 5e-3)
    np.testing.assert_allclose(W_dot, expected, atol=1e-9 * np.max(np.abs(expected)))
    # no work on the free motions, whatever moves
    relative, _, _ = wrenches_at(contacts, motion, 0.0)
    rows = kernel_rows(contacts, *motion)
    np.testing.assert_allclose(W.T @ relative.twist, rows.phi_dot, atol=1e-13)


FRAME = JointFrame(
    on_tip=pose(Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), [0.2, -0.1, 0.3]),
    on_object=pose(Rotation.from_rotvec([-0.4, 0.6, 0.1]).as_matrix(), [0.5, 0.2, -0.3]),
    free=(0, 3, 5),
)


def in_rows(W, W_dot, relative):
    return motion_space(W, W_dot, (1, 3, 5))


def in_euler_rates(W, W_dot, relative):
    angles = Rotation.from_matrix(relative.rotation).as_euler("ZXY")
    E, _ = euler_rates(angles, np.zeros(3), "zxy")
    rates = np.linalg.solve(E, relative.twist[3:])
    selection = euler_selection(angles, rates, "zxy", chosen=(0, 1, 2))
    return motion_space_in_rates(W, selection, W_dot)


def in_joint_axes(W, W_dot, relative):
    return motion_space_in_rates(W, joint_selection(FRAME, relative), W_dot)


@pytest.mark.parametrize("choice", [in_rows, in_euler_rates, in_joint_axes])
def test_rate_of_t_is_that_of_differences_for_every_choice(choice, motion):
    contacts = three_contacts(*motion[:2])

    def space(t):
        relative, W, W_dot = wrenches_at(contacts, motion, t)
        return choice(W, W_dot, relative)

    found = space(0.0)
    expected = first_difference(lambda t: space(t).T, 2e-3)
    np.testing.assert_allclose(found.T_dot, expected, atol=1e-8 * np.max(np.abs(expected)))
    np.testing.assert_allclose(found.selection.matrix @ found.T, np.eye(3), atol=1e-12)
    assert np.max(np.abs(found.T_dot)) > 0.1 and found.mismatch < 1e-12


def test_euler_rates_are_those_of_differences():
    path = lambda t: np.array([0.3 + t, 0.8 - 2 * t, -0.5 + 0.7 * t * t])  # noqa: E731
    rates = np.array([1.0, -2.0, 0.0])
    for sequence in ("zxz", "xyz", "yzx"):
        turn = lambda t, s=sequence: Rotation.from_euler(s.upper(), path(t)).as_matrix()  # noqa: E731
        spin = first_difference(turn, 1e-2) @ turn(0.0).T
        E, E_dot = euler_rates(path(0.0), rates, sequence)
        np.testing.assert_allclose(E @ rates, [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-10)
        expected = first_difference(lambda t, s=sequence: euler_rates(path(t), rates, s)[0], 1e-2)
        np.testing.assert_allclose(E_dot, expected, atol=1e-10)


def test_joint_selection_reads_the_joints_own_coordinates(motion):
    """Slide and turns of the joint's frame on the gripper, seen from the one on the object."""

    def between(t):
        X_WT, X_WO, _, _ = moved(motion, t)
        return np.linalg.inv(X_WO @ FRAME.on_object) @ X_WT @ FRAME.on_tip

    rate = first_difference(between, 5e-3)
    spin = rate[:3, :3] @ between(0.0)[:3, :3].T
    relative = seen_from_object(motion[1], motion[3], motion[0], motion[2])
    rates = joint_selection(FRAME, relative).matrix @ relative.twist
    np.testing.assert_allclose(rates, [rate[0, 3], spin[2, 1], spin[1, 0]], atol=1e-9)


# --- a gripper that slides along its contacts ----------------------------------------------------


def corner_pose(x, y):
    """Pose of the corner gripper in the object with its origin at (x, y): all four gaps closed.

    The gripper's frame is at contact 1 with its x axis along the line to contact 3.
    """
    R = Rotation.from_euler("ZXZ", along_the_line(0.4)).as_matrix()
    on_gripper, faces, origin = (POINTS - POINTS[0]) @ R, [2, 1, 2, 0], np.array([x, y, 0.0])
    normals = np.eye(3)[faces]
    for _ in range(8):  # Newton on height and rotation
        arms = on_gripper @ R.T
        gaps = np.sum((arms + origin) * normals, axis=1)
        step = np.linalg.solve(np.column_stack([normals[:, 2], np.cross(arms, normals)]), -gaps)
        origin[2] += step[0]
        R = Rotation.from_rotvec(step[1:]).as_matrix() @ R
    return pose(R, origin)


def relative_path(t):
    """Where the gripper's origin goes on the block's face, and its velocity and acceleration."""
    at = POINTS[0, :2] + np.array([0.006 * t + 0.002 * t * t, 0.004 * math.sin(t)])
    return at, np.array([0.006, 0.004]), np.array([0.004, 0.0])


def euler_path(t):
    """Euler angles of the gripper in the object."""
    return Rotation.from_matrix(corner_pose(*relative_path(t)[0])[:3, :3]).as_euler("ZXZ")


def object_path(t):
    """Some motion of the object that accelerates in every way."""
    turn = Rotation.from_rotvec([0.3 * t, 0.5 * t * t - 0.2, 0.4 * math.sin(2 * t)])
    return pose(turn.as_matrix(), [0.2 * t * t, 0.3 * math.sin(t), 0.1 - 0.4 * t])


def gripper_path(t):
    return object_path(t) @ corner_pose(*relative_path(t)[0])


def twist_and_acceleration(path, h):
    """Twist and classical acceleration at time 0 of a body, world axes, by differences."""
    X, X_dot, X_ddot = path(0.0), first_difference(path, h), second_difference(path, h)
    spin, spin_dot = X_dot[:3, :3] @ X[:3, :3].T, X_ddot[:3, :3] @ X[:3, :3].T
    pick = lambda S: np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]]) / 2  # noqa: E731
    return (
        np.concatenate([X_dot[:3, 3], pick(spin)]), np.concatenate([X_ddot[:3, 3], pick(spin_dot)])
    )  # fmt: skip


def sliding_corner():
    """The corner gripper at time 0: relative motion and ``W_m^o`` with its rate, by hand."""
    X = np.linalg.inv(object_path(0.0)) @ gripper_path(0.0)
    twist_O, _ = twist_and_acceleration(object_path, 0.03)
    twist_T, _ = twist_and_acceleration(gripper_path, 0.03)
    relative = seen_from_object(object_path(0.0), twist_O, gripper_path(0.0), twist_T)
    arms = POINTS - X[:3, 3]
    turning = np.cross(relative.twist[3:], arms)
    W = wrenches(arms, NORMALS)
    return relative, W, np.vstack([np.zeros((3, 4)), np.cross(turning, NORMALS).T])


def test_rates_of_positions_are_alpha_along_a_finite_motion():
    relative, W, W_dot = sliding_corner()
    space = motion_space(W, W_dot, (0, 1))
    _, alpha, _ = relative_path(0.0)
    np.testing.assert_allclose(space.twist(alpha), relative.twist, atol=1e-9)
    np.testing.assert_allclose(space.rates(relative.twist), alpha, atol=1e-9)


def test_third_euler_angle_stays_along_a_finite_motion():
    """The condition under which two Euler rates are all: x axis along contacts 1 and 3."""

    np.testing.assert_allclose([euler_path(t)[2] for t in (-1, -0.5, 0, 0.5)], 0.0, atol=1e-14)
    relative, W, W_dot = sliding_corner()
    rates = first_difference(euler_path, 0.03)
    space = motion_space_in_rates(W, euler_selection(euler_path(0.0), rates), W_dot)
    np.testing.assert_allclose(space.twist(rates[:2]), relative.twist, atol=1e-8)


def test_gripper_moves_as_relation_3_5_says():
    relative, W, W_dot = sliding_corner()
    space = motion_space(W, W_dot, (0, 1))
    R_O, (twist_O, _) = object_path(0.0)[:3, :3], twist_and_acceleration(object_path, 0.03)
    expected, _ = twist_and_acceleration(gripper_path, 0.03)
    relative = RelativeMotion(
        relative.rotation, relative.translation, space.twist(relative_path(0.0)[1])
    )
    np.testing.assert_allclose(gripper_twist(R_O, twist_O, relative), expected, atol=1e-9)


@pytest.mark.parametrize("rates", ["positions", "euler"])
def test_gripper_accelerates_as_relation_3_6_says(rates):
    relative, W, W_dot = sliding_corner()
    if rates == "positions":
        space = motion_space(W, W_dot, (0, 1))
        _, alpha, alpha_dot = relative_path(0.0)
    else:
        alpha = first_difference(euler_path, 0.03)
        alpha_dot = second_difference(euler_path, 0.03)[:2]
        space = motion_space_in_rates(W, euler_selection(euler_path(0.0), alpha), W_dot)
        alpha = alpha[:2]
    R_O, (twist_O, acceleration_O) = (
        object_path(0.0)[:3, :3], twist_and_acceleration(object_path, 0.03)
    )  # fmt: skip
    _, expected = twist_and_acceleration(gripper_path, 0.03)
    found = gripper_acceleration(
        R_O, twist_O, acceleration_O, relative, space.acceleration(alpha, alpha_dot)
    )
    np.testing.assert_allclose(found, expected, atol=1e-7)
    # the bias T' alpha matters at this tolerance
    assert np.max(np.abs(space.T_dot @ alpha)) > 1e-4


def test_a_welded_gripper_has_the_centripetal_bias():
    data, expected = WORKED["weld_bias"]["inputs"], WORKED["weld_bias"]["expected"]
    relative = RelativeMotion(np.eye(3), np.array(data["x_m_minus_x_o"]), np.zeros(6))
    twist = np.array([*data["xdot_o"], *data["omega"]], float)
    bias = gripper_acceleration(np.eye(3), twist, np.zeros(6), relative, np.zeros(6))
    np.testing.assert_allclose(bias, expected["vdot_m_minus_G_vdot_o"], atol=1e-12)


# --- of a whole system ---------------------------------------------------------------------------


def plain_relative(system, state, arm, twist_T):
    """Pose and twist of a tip relative to the object, from Pinocchio's poses and differences."""
    R_O = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    X_WO = pose(R_O, state.object_position)
    return seen_from_object(
        X_WO, state.object_twist, system.arms[arm].tip_pose(state.joint_positions[arm]), twist_T
    )


def tip_twist(system, state, arm):
    """Twist of a tip by differences of its pose along constant joint velocities."""
    q, v = state.joint_positions[arm], state.joint_velocities[arm]
    twist, _ = twist_and_acceleration(lambda t: system.arms[arm].tip_pose(q + t * v), 5e-3)
    return twist


def test_free_motions_of_the_worked_system_explain_its_velocities(block_system):
    """Its velocities are consistent: they are T alpha with the rates reported, also in rows."""
    ev = ma.evaluate(block_system)
    for arm, free in (("one", 2), ("two", 3)):
        twist = tip_twist(block_system, ev.state, arm)
        expected = plain_relative(block_system, ev.state, arm, twist).twist
        space, alpha = ev.motion_space(arm), ev.relative_rates(arm)
        assert space.T.shape == (6, free) == space.T_dot.shape
        np.testing.assert_allclose(space.twist(alpha), expected, atol=1e-9)
        rows = motion_space(np.linalg.svd(space.T)[0][:, free:]).rows
        chosen = ev.motion_space(arm, rows)
        assert chosen.rows == rows
        np.testing.assert_allclose(chosen.twist(expected[list(rows)]), expected, atol=1e-9)


def test_motion_space_does_not_depend_on_what_the_system_did_since(block_system, rng):
    ev = ma.evaluate(block_system)
    before = ev.motion_space("one"), ev.relative_rates("one")
    ma.evaluate(block_system, 0.0, random_state(block_system, rng))
    np.testing.assert_array_equal(ev.motion_space("one").T_dot, before[0].T_dot)
    np.testing.assert_array_equal(ev.relative_rates("one"), before[1])


def test_relative_rates_hold_for_velocities_that_break_the_joints_too(block_system, rng):
    state = random_state(block_system, rng)
    ev = ma.evaluate(block_system, 0.0, state)
    for arm in block_system.arm_names:
        frame = block_system.frames[arm]
        X_WT = block_system.arms[arm].tip_pose(state.joint_positions[arm])
        twist_T = tip_twist(block_system, state, arm)
        R_O = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
        axes = R_O @ frame.on_object[:3, :3]
        joint = X_WT[:3, :3] @ frame.on_tip[:3, 3]
        arm_O = X_WT[:3, 3] + joint - state.object_position
        velocity = (
            twist_T[:3] + np.cross(twist_T[3:], joint)
            - state.object_twist[:3] - np.cross(state.object_twist[3:], arm_O)
        )  # fmt: skip
        spin = twist_T[3:] - state.object_twist[3:]
        expected = np.concatenate([axes.T @ velocity, axes.T @ spin])[list(frame.free)]
        np.testing.assert_allclose(ev.relative_rates(arm), expected, atol=1e-8)


def test_relative_rates_are_those_of_a_trajectory(block_system):
    run = ma.simulate(block_system, duration=0.01, integrator="rk4", step=5e-3)
    for k in (0, -1):
        state = block_system.state(
            run.object_position[k],
            run.object_quaternion_xyzw[k],
            {arm: q[k] for arm, q in run.joint_positions.items()},
            run.object_twist[k],
            {arm: v[k] for arm, v in run.joint_velocities.items()},
        )
        ev = ma.evaluate(block_system, 0.0, state)
        for arm, rates in run.relative_motion.items():
            np.testing.assert_allclose(ev.relative_rates(arm), rates[k], atol=1e-12)


def test_an_unknown_arm_is_told_with_the_names(block_system):
    ev = ma.evaluate(block_system)
    for ask in (ev.motion_space, ev.relative_rates):
        with pytest.raises(ModelError, match="unknown arm 'three'; arms are one, two"):
            ask("three")


def test_contact_rates_vanish_on_the_free_motions_of_a_system(ur5_system, rng):
    """Power of unit pushes on bodies that move with T alpha: none."""
    state = random_state(ur5_system, rng)
    ev = ma.evaluate(ur5_system, 0.0, state)
    assert ev.motion_space("left").T.shape == (6, 0)
    space, terms = ev.motion_space("right"), ev.contact_terms["right"]
    R_O = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    X_WT = ur5_system.arms["right"].tip_pose(state.joint_positions["right"])
    for twist in space.T.T:
        world = np.concatenate([R_O @ twist[:3], R_O @ twist[3:]])
        np.testing.assert_allclose(terms.W_m.T @ body_twist(X_WT, world), 0.0, atol=1e-12)
