"""Claims about the contact kernel: phi, W, dW/dt and c, for every surface on either body.

The oracle is the gap as a textbook draws it (``mechanics.plain_gap``) and differences of it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import (
    body_twist,
    carried,
    first_difference,
    kernel_rows,
    plain_gap,
    pose,
    random_pose,
    second_difference,
)
from repository import WORKED

from multiarm.geometry.records import (
    SURFACE_ON_ARM,
    SURFACE_ON_OBJECT,
    Contact,
    Surface,
    cylinder,
    plane,
    sphere,
)

SURFACES = {
    "plane": plane,
    "cylinder": lambda at, axis: cylinder(at, axis, 1.7),
    "bore": lambda at, axis: cylinder(at, axis, 1.7, inside=True),
    "sphere": lambda at, axis: sphere(at, 1.7),
    "hollow_sphere": lambda at, axis: sphere(at, 1.7, inside=True),
}


def contact_of(tip: Surface, guide: Surface, body: int = SURFACE_ON_OBJECT) -> Contact:
    """A tip on a surface of ``body``."""
    arm, other = (tip, guide) if body == SURFACE_ON_OBJECT else (guide, tip)
    return Contact("c", arm, other)


def some_contact(rng, surface, body, tip_radius, X_WT, X_WO):
    """A contact somewhere near its surface, not on it, and clear of the axis or centre."""
    axis = rng.standard_normal(3)
    X_WP, X_WS = (X_WT, X_WO) if body == SURFACE_ON_OBJECT else (X_WO, X_WT)
    point = 0.5 * rng.standard_normal(3)
    at = (np.linalg.inv(X_WS) @ X_WP @ np.append(point, 1.0))[:3]
    radial = np.cross(axis, rng.standard_normal(3))
    origin = at - rng.uniform(1.5, 2.5) * radial / np.linalg.norm(radial)
    return contact_of(sphere(point, tip_radius), SURFACES[surface](origin, axis), body)


@pytest.fixture(params=[SURFACE_ON_OBJECT, SURFACE_ON_ARM], ids=["on_object", "on_arm"])
def surface_body(request):
    return request.param


@pytest.fixture
def motion(rng):
    """Poses of tip and object and unrelated velocities of both: the contacts come apart."""
    return random_pose(rng), random_pose(rng), rng.standard_normal(6), rng.standard_normal(6)


@pytest.fixture(params=SURFACES)
def contacts(request, surface_body, rng, motion):
    return [
        some_contact(rng, request.param, surface_body, tip_radius, *motion[:2])
        for tip_radius in (0.0, 0.03, 0.2, 0.1, 0.0)
    ]


def along(contacts, motion):
    """Gaps as a function of time when neither body accelerates."""
    X_WT, X_WO, twist_T, twist_O = motion

    def gaps(t):
        arm, body = carried(X_WT, twist_T, t), carried(X_WO, twist_O, t)
        return np.array([plain_gap(contact, arm, body) for contact in contacts])

    return gaps


@pytest.mark.parametrize("count", range(1, 10))
def test_planes_are_right_however_many_are_written_together(count, surface_body, rng, motion):
    contacts = [
        some_contact(rng, "plane", surface_body, 0.01 * k, *motion[:2]) for k in range(count)
    ]
    rows, gaps = kernel_rows(contacts, *motion), along(contacts, motion)
    np.testing.assert_allclose(rows.phi, gaps(0.0), atol=1e-14)
    np.testing.assert_allclose(rows.phi_dot, first_difference(gaps, 1e-2), atol=1e-10)
    np.testing.assert_allclose(-rows.c, second_difference(gaps, 1e-2), atol=1e-8)


def test_gap_is_the_distance_between_the_surfaces(contacts, motion):
    rows = kernel_rows(contacts, motion[0], motion[1])
    np.testing.assert_allclose(rows.phi, along(contacts, motion)(0.0), atol=1e-14)


def test_gap_rate_is_the_gaps_derivative(contacts, motion):
    expected = first_difference(along(contacts, motion), 1e-2)
    np.testing.assert_allclose(kernel_rows(contacts, *motion).phi_dot, expected, atol=1e-10)


def test_c_is_minus_the_gaps_second_derivative_without_accelerations(contacts, motion):
    expected = -second_difference(along(contacts, motion), 1.5e-2)
    np.testing.assert_allclose(kernel_rows(contacts, *motion).c, expected, rtol=1e-8, atol=1e-8)


def test_gap_rate_is_the_power_of_a_unit_push(contacts, motion):
    """W_m^T v_m + W_o^T v_o, each in its own axes, is the gap rate (3.26)."""
    X_WT, X_WO, twist_T, twist_O = motion
    rows = kernel_rows(contacts, *motion)
    power = rows.W_m.T @ body_twist(X_WT, twist_T) + rows.W_o.T @ body_twist(X_WO, twist_O)
    np.testing.assert_allclose(power, rows.phi_dot, atol=1e-13)


def test_action_equals_reaction(contacts, motion):
    """W_o = -X W_m (3.11)."""
    X_WT, X_WO, _, _ = motion
    rows = kernel_rows(contacts, *motion)
    R = X_WO[:3, :3].T @ X_WT[:3, :3]
    x = X_WO[:3, :3].T @ (X_WT[:3, 3] - X_WO[:3, 3])
    moved = np.vstack([R @ rows.W_m[:3], np.cross(x, (R @ rows.W_m[:3]).T).T + R @ rows.W_m[3:]])
    np.testing.assert_allclose(rows.W_o, -moved, atol=1e-14)


def test_w_dot_is_the_time_derivative_of_w(contacts, motion):
    X_WT, X_WO, twist_T, twist_O = motion

    def matrices(t):
        rows = kernel_rows(
            contacts, carried(X_WT, twist_T, t), carried(X_WO, twist_O, t), twist_T, twist_O
        )
        return np.vstack([rows.W_m, rows.W_o])

    rows = kernel_rows(contacts, *motion)
    expected = first_difference(matrices, 1e-2)
    np.testing.assert_allclose(np.vstack([rows.W_m_dot, rows.W_o_dot]), expected, atol=1e-9)


def test_c_follows_from_the_matrices(contacts, motion):
    """c = -Wdot_o^T v_o + W_o^T [R_o^T (w_o x x_o'); 0] - the same for m (Example 4.1)."""
    X_WT, X_WO, twist_T, twist_O = motion
    rows = kernel_rows(contacts, *motion)
    expected = np.zeros(len(contacts))
    for X, twist, W, W_dot in (
        (X_WO, twist_O, rows.W_o, rows.W_o_dot),
        (X_WT, twist_T, rows.W_m, rows.W_m_dot),
    ):
        centripetal = np.concatenate([np.cross(twist[3:], twist[:3]), np.zeros(3)])
        expected += -W_dot.T @ body_twist(X, twist) + W.T @ body_twist(X, centripetal)
    np.testing.assert_allclose(rows.c, expected, atol=1e-12)


def test_normals_point_into_the_object(surface_body):
    """A fingertip 2 m along x from the object's origin pushes it towards -x, whoever is round."""
    arm_at = pose(np.eye(3), [2.0, 0.0, 0.0])
    outward = np.array([1.0, 0.0, 0.0] if surface_body == SURFACE_ON_OBJECT else [-1.0, 0.0, 0.0])
    at = np.zeros(3)
    for surface, gap in (
        (plane(at, outward), 2.0),
        (sphere(at, 0.5), 1.5),
        (cylinder(at, [0, 0, 1], 0.5), 1.5),
    ):
        rows = kernel_rows([contact_of(sphere(at, 0.0), surface, surface_body)], arm_at, np.eye(4))
        np.testing.assert_allclose(rows.normals[0], [-1.0, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(rows.W_o[:3, 0], [-1.0, 0.0, 0.0], atol=1e-15)
        np.testing.assert_allclose(rows.W_m[:3, 0], [1.0, 0.0, 0.0], atol=1e-15)
        assert rows.phi[0] == gap


# --- worked examples -----------------------------------------------------------------------------


def sphere_on_sphere(data):
    """Two spheres: the arm's is the fingertip, the object's the surface."""
    return Contact("spheres", sphere(data["c_m"], data["r_m"]), sphere(data["c_o"], data["r_o"]))


def test_two_spheres_overlap_as_in_the_worked_example():
    example = WORKED["sphere_sphere_contact"]
    data, expected = example["inputs"], example["expected"]
    X_WT = pose(np.array(data["R_m_in_o"]), data["x_m_in_o"])
    rows = kernel_rows([sphere_on_sphere(data)], X_WT, np.eye(4))
    assert rows.phi[0] == pytest.approx(expected["phi"], abs=1e-9)
    # the computed surface points are on the common normal
    p_o = np.array(expected["p_o_tilde"])
    along_normal = np.cross(p_o - data["c_o"], rows.normals[0])
    np.testing.assert_allclose(along_normal, 0.0, atol=1e-9)


def test_rates_of_two_spheres_equal_the_worked_example():
    """The columns depend on the line of the normal only, whichever point on it is used."""
    example = WORKED["sphere_sphere_rates"]
    data, e = example["inputs"], {k: np.array(v) for k, v in example["expected"].items()}
    R, x = np.array(data["R_m_in_o"]), np.array(data["x_m_in_o"])
    twist = np.concatenate([data["xdot"], data["omega"]])
    rows = kernel_rows([sphere_on_sphere(data)], pose(R, x), np.eye(4), twist)
    e_m = -R.T @ e["n_o"]
    expected = {
        "W_o": np.concatenate([e["n_o"], np.cross(e["p_o"], e["n_o"])]),
        "W_m": np.concatenate([e_m, np.cross(e["p_m"], e_m)]),
        "W_o_dot": np.concatenate(
            [e["e_o_dot"], np.cross(e["p_o_dot"], e["n_o"]) + np.cross(e["p_o"], e["e_o_dot"])]
        ),
        "W_m_dot": np.concatenate(
            [e["e_m_dot"], np.cross(e["p_m_dot"], e_m) + np.cross(e["p_m"], e["e_m_dot"])]
        ),
    }
    for name, column in expected.items():
        np.testing.assert_allclose(getattr(rows, name)[:, 0], column, atol=1e-9, err_msg=name)
    assert rows.phi_dot[0] == pytest.approx(0.0, abs=1e-12)


def test_moving_hinge_has_the_worked_examples_matrices_and_bias():
    example = WORKED["revolute_bias"]
    data, expected = example["inputs"], example["expected"]
    z = np.array([0.0, 0.0, 1.0])
    contacts = [
        contact_of(sphere(p, 0.0), cylinder(np.zeros(3), z, data["r"]))
        for p in data["points_m"][:4]
    ]
    end = np.array(data["points_m"][4])
    contacts.append(contact_of(sphere(end, 0.0), plane(end, z)))
    rows = kernel_rows(
        contacts,
        pose(np.array(data["R_m"]), data["x_m"]),
        pose(np.array(data["R_o"]), data["x_o"]),
        np.array(data["v_m"]),
        np.array(data["v_o"]),
    )
    for name in ("W_m", "W_o", "W_m_dot", "W_o_dot"):
        np.testing.assert_allclose(getattr(rows, name), expected[name], atol=1e-9, err_msg=name)
    np.testing.assert_allclose(rows.c, expected["c_operational_space"], atol=1e-9)
    np.testing.assert_allclose(rows.phi, 0.0, atol=1e-12)
    np.testing.assert_allclose(rows.phi_dot, 0.0, atol=1e-12)


def test_contact_near_the_middle_of_a_cylinder_is_still_finite():
    bore = cylinder([0, 0, 0], [0, 0, 1], 0.2, inside=True)
    contact = contact_of(sphere([1e-9, 0.0, 3.0], 0.05), bore)
    rows = kernel_rows([contact], np.eye(4), np.eye(4))
    assert rows.phi[0] == pytest.approx(0.15, abs=1e-8)
    assert math.isclose(np.linalg.norm(rows.normals[0]), 1.0)
