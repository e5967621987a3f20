"""Claims about surfaces that touch: gap, normal, rates, dW/dt and c, on either body.

Of two curved surfaces the pair of points is found, and all that follows from it is exact.

The oracle (``oracles``) knows the surfaces' equations F = 0 only.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import kernel_rows, pose
from oracles import (
    CommonNormal,
    Meeting,
    Side,
    bowl_side,
    claim_gap_and_normal,
    claim_power,
    claim_rates,
    distance_torus_side,
    meeting,
    parametric_ellipsoid_side,
    swapped,
    waves_side,
)
from repository import WORKED

from multiarm.geometry.records import (
    Contact,
    cone,
    cylinder,
    ellipsoid,
    plane,
    sphere,
    torus,
)

ZERO, Z, AXES = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.eye(3)
STEP = 5e-3  # [s] of the order-8 differences
SMALL = ellipsoid(ZERO, AXES, (0.3, 0.2, 0.25))
LARGE = ellipsoid(ZERO, AXES, (0.5, 0.4, 0.6))

# the two surfaces, and the coordinates (u, v) where they touch
PAIRS = {
    "ellipsoid_on_ellipsoid": (SMALL, (0.8, 0.4), LARGE, (2.0, -0.3)),
    "ellipsoid_on_plane": (SMALL, (0.8, 0.4), plane(ZERO, Z), (0.2, -0.3)),
    "ellipsoid_on_sphere": (SMALL, (0.8, 0.4), sphere(ZERO, 0.4), (0.5, 0.6)),
    "ellipsoid_in_hollow_sphere": (SMALL, (0.8, 0.4), sphere(ZERO, 0.9, inside=True), (0.5, 0.6)),
    "ellipsoid_in_bore": (SMALL, (0.8, 0.4), cylinder(ZERO, Z, 0.8, inside=True), (0.5, 0.3)),
    "ellipsoid_in_funnel": (SMALL, (0.8, 0.4), cone(ZERO, Z, 0.8, inside=True), (0.5, 1.4)),
    "ellipsoid_in_ellipsoid": (
        SMALL, (0.8, 0.4), ellipsoid(ZERO, AXES, (0.9, 0.8, 1.0), inside=True), (2.0, -0.3),
    ),
    "ellipsoid_at_the_hole_of_a_torus": (SMALL, (0.8, 0.4), torus(ZERO, Z, 1.0, 0.25), (0.9, 2.8)),
    "torus_on_plane": (torus(ZERO, Z, 0.5, 0.2), (0.8, 0.6), plane(ZERO, Z), (0.2, -0.3)),
    "torus_on_cylinder": (torus(ZERO, Z, 0.5, 0.2), (0.8, 0.6), cylinder(ZERO, Z, 0.4), (0.5, 0.3)),
    "torus_on_sphere": (torus(ZERO, Z, 0.5, 0.2), (0.8, 0.6), sphere(ZERO, 0.4), (0.5, 0.3)),
    "crossed_cylinders": (cylinder(ZERO, Z, 0.3), (0.5, 0.2), cylinder(ZERO, Z, 0.5), (1.5, -0.3)),
    "cone_on_ellipsoid": (cone(ZERO, Z, 0.5), (0.5, 1.1), LARGE, (2.0, -0.3)),
    "cone_on_cylinder": (cone(ZERO, Z, 0.5), (0.5, 1.1), cylinder(ZERO, Z, 0.4), (0.5, 0.3)),
    "cylinder_on_sphere": (cylinder(ZERO, Z, 0.3), (0.5, 0.2), sphere(ZERO, 0.4), (0.5, 0.3)),
}  # fmt: skip
USERS = {
    "ellipsoid_in_bowl": (Side.of(SMALL), (0.8, 0.4), bowl_side(0.5), (0.4, 0.2)),
    "torus_by_its_distance_on_plane": (
        distance_torus_side(0.5, 0.2), (0.8, 0.6), Side.of(plane(ZERO, Z)), (0.2, -0.3),
    ),
    "ellipsoid_by_its_points_on_cylinder": (
        parametric_ellipsoid_side(np.array([0.3, 0.2, 0.25])), (0.8, 0.4),
        Side.of(cylinder(ZERO, Z, 0.4)), (0.5, 0.3),
    ),
    "torus_by_its_distance_in_bowl": (
        distance_torus_side(0.2, 0.15), (0.8, 0.6), bowl_side(0.5), (0.4, 0.2),
    ),
}  # fmt: skip
SIDES = {
    name: (Side.of(one), at_one, Side.of(other), at_other)
    for name, (one, at_one, other, at_other) in PAIRS.items()
} | USERS
GAPS = {"touching": 0.0, "apart": 0.05, "overlapping": -0.02}

# surface, and the coordinates (u, v) of the place where it is touched
SURFACES = {
    "plane": (plane(ZERO, Z), (0.3, -0.2)),
    "sphere": (sphere(ZERO, 0.4), (0.7, 0.5)),
    "hollow_sphere": (sphere(ZERO, 0.7, inside=True), (0.7, 0.5)),
    "cylinder": (cylinder(ZERO, Z, 0.3), (1.1, 0.2)),
    "bore": (cylinder(ZERO, Z, 0.6, inside=True), (1.1, 0.2)),
    "cone": (cone(ZERO, Z, 0.4), (0.4, 0.8)),
    "blunt_cone": (cone(ZERO, Z, 1.3), (0.4, 0.8)),
    "funnel": (cone(ZERO, Z, 0.7, inside=True), (0.4, 0.9)),
    "torus_outside": (torus(ZERO, Z, 0.7, 0.25), (0.9, 0.4)),
    "torus_at_its_hole": (torus(ZERO, Z, 1.0, 0.25), (0.9, 2.8)),
    "torus_on_top": (torus(ZERO, Z, 0.7, 0.25), (0.9, math.pi / 2)),
    "inside_of_a_tube": (torus(ZERO, Z, 1.0, 0.45, inside=True), (0.9, 2.3)),
    "ellipsoid": (ellipsoid(ZERO, AXES, (0.5, 0.4, 0.6)), (0.7, 0.5)),
    "flat_ellipsoid": (ellipsoid(ZERO, AXES, (0.8, 0.7, 0.3)), (0.3, 1.2)),
    "hollow_ellipsoid": (ellipsoid(ZERO, AXES, (0.7, 0.8, 0.9), inside=True), (0.7, 0.5)),
}
USER_SURFACES = {
    "bowl_by_its_points": (bowl_side(0.5), (0.4, 0.2)),
    "waves_by_their_points": (waves_side(), (0.2, 0.3)),
    "ellipsoid_by_its_points": (parametric_ellipsoid_side(np.array([0.5, 0.4, 0.6])), (0.7, 0.5)),
    "hollow_by_its_points": (
        parametric_ellipsoid_side(np.array([0.7, 0.8, 0.9]), inside=True), (3.1, -0.4),
    ),
    "torus_by_its_distance": (distance_torus_side(0.7, 0.25), (0.9, 0.4)),
}  # fmt: skip
# radius of the tip and gap
TIPS = {
    "point_touching": (0.0, 0.0),
    "ball_overlapping": (0.15, -0.04),
}
GUIDES = {name: (Side.of(surface), at) for name, (surface, at) in SURFACES.items()} | USER_SURFACES

MEETINGS = {
    f"{name}, {how}": (*sides, gap) for name, sides in SIDES.items() for how, gap in GAPS.items()
} | {
    f"{tip} of {name}": (Side.of(sphere(ZERO, radius)), (0.4, -0.3), guide, at, gap)
    for name, (guide, at) in GUIDES.items()
    for tip, (radius, gap) in TIPS.items()
}


@pytest.fixture(params=["as_listed", "swapped"])
def way_round(request):
    return request.param


@pytest.fixture(params=MEETINGS)
def met(request, way_round, rng):
    one, at_one, other, at_other, gap = MEETINGS[request.param]
    found = meeting(one.moved(rng), other.moved(rng), at_one, at_other, gap, rng)
    return found if way_round == "as_listed" else swapped(found)


def test_gap_and_normal_are_those_of_the_surfaces_equations(met):
    claim_gap_and_normal(met)


def test_rates_are_the_differences_of_what_the_equations_give(met):
    claim_rates(met, STEP)


def test_gap_rate_is_the_power_of_a_unit_push(met):
    claim_power(met)


# --- the worked example --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def worked():
    """Two ellipsoids 6 cm apart; the object rests, the tip moves."""
    example = WORKED["ellipsoid_ellipsoid_contact"]
    data, expected = example["inputs"], example["expected"]
    surfaces = [
        ellipsoid(e["centre"], np.array(e["R"]), e["semi_axes"])
        for e in (data["ellipsoid_m"], data["ellipsoid_o"])
    ]
    arm, body = map(Side.of, surfaces)
    guess = CommonNormal(
        np.array(expected["p_m"]) + 0.02, np.array(expected["p_o"]) - 0.02, 0.1,
        np.array([-1.0, 0.0, 0.0]),
    )  # fmt: skip
    X_WT, twist = pose(np.array(data["R_m_in_o"]), data["x_m_in_o"]), data["xdot"] + data["omega"]
    found = Meeting(arm, body, X_WT, np.eye(4), np.array(twist), np.zeros(6), guess)
    return found, {name: np.array(value) for name, value in expected.items()}


def test_the_oracle_finds_the_worked_examples_pair(worked):
    met, expected = worked
    pair = met.at(0.0)
    assert pair.gap == pytest.approx(float(expected["phi"]), abs=1e-14)
    np.testing.assert_allclose(pair.on_arm, expected["p_m"], rtol=0, atol=1e-14)
    np.testing.assert_allclose(pair.on_object, expected["p_o"], rtol=0, atol=1e-14)
    np.testing.assert_allclose(pair.into_object, expected["e_o"], rtol=0, atol=1e-14)


def test_two_ellipsoids_have_all_the_numbers_of_the_worked_example(worked):
    met, e = worked
    rows = met.rows()
    assert rows.phi[0] == pytest.approx(float(e["phi"]), abs=1e-10)
    assert rows.phi_dot[0] == pytest.approx(float(e["phi_dot"]), abs=1e-10)
    # the normals turn with the points: e_dot = S p_dot (theory of curvature)
    e_o_dot, e_m_dot = e["S_o"] @ e["p_o_dot"], e["S_m"] @ e["p_m_dot"]
    expected = {
        "W_o": np.concatenate([e["e_o"], np.cross(e["p_o"], e["e_o"])]),
        "W_m": np.concatenate([e["e_m"], np.cross(e["p_m"], e["e_m"])]),
        "W_o_dot": np.concatenate(
            [e_o_dot, np.cross(e["p_o_dot"], e["e_o"]) + np.cross(e["p_o"], e_o_dot)]
        ),
        "W_m_dot": np.concatenate(
            [e_m_dot, np.cross(e["p_m_dot"], e["e_m"]) + np.cross(e["p_m"], e_m_dot)]
        ),
    }
    for name, column in expected.items():
        found = getattr(rows, name)[:, 0]
        np.testing.assert_allclose(found, column, rtol=0, atol=1e-10, err_msg=name)


# --- pairs that a tip can stand for ---------------------------------------------------------------


def test_an_ellipsoid_with_equal_axes_is_a_ball(rng):
    """A ball has the same row whether it is met as a tip or as a surface."""
    guide = Side.of(torus(ZERO, Z, 0.7, 0.25)).moved(rng)
    ball = Side.of(sphere(ZERO, 0.3)).moved(rng)
    as_surface = ellipsoid(ball.surface.origin, ball.surface.axes, (0.3, 0.3, 0.3))
    met = meeting(ball, guide, (0.2, 0.3), (0.9, 0.4), 0.03, rng)
    one = met.rows()
    other = met.rows(contacts=[Contact("pair", as_surface, guide.surface)])
    for name in ("phi", "phi_dot", "c", "W_m", "W_o", "W_m_dot", "W_o_dot"):
        a, b = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11, err_msg=name)


def test_crossed_cylinders_touch_at_the_distance_of_their_axes():
    """Radii 0.3 and 0.5, axes 1 m apart and at any angle: the gap is 0.2."""
    for angle in (0.1, 1.0, math.pi / 2, 2.5):
        axis = [math.cos(angle), math.sin(angle), 0.0]
        contact = Contact("c", cylinder([0, 0, 1.0], axis, 0.3), cylinder(ZERO, [1.0, 0, 0], 0.5))
        rows = kernel_rows([contact], np.eye(4), np.eye(4), near=[[0.1, 0.1, 0.4]])
        assert rows.phi[0] == pytest.approx(0.2, abs=1e-12)
        np.testing.assert_allclose(rows.normals[0], [0.0, 0.0, -1.0], atol=1e-10)
        np.testing.assert_allclose(rows.W_o[:, 0], [0, 0, -1, 0, 0, 0], atol=1e-10)
