"""Claims about surfaces of the user's: distances, normals and curvatures against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from multiarm.errors import ModelError
from multiarm.geometry.numerical_derivatives import NumericalDerivatives, check_certainty
from multiarm.geometry.smooth_surfaces import ParametricSurface, SignedDistanceSurface

TURN = (0.0, 2.0 * math.pi)
POLES = (-0.5 * math.pi, 0.5 * math.pi)
R, TUBE = 0.3, 0.1
SEMI = np.array([0.35, 0.25, 0.2])
BOWL = 2.5  # z = BOWL (x^2 + y^2), [1/m]


# --- closed forms: distance, gradient and hessian at a point ------------------------------------


def sphere_form(p):
    r = np.linalg.norm(p)
    n = p / r
    return r - R, n, (np.eye(3) - np.outer(n, n)) / r


def torus_form(p):
    radial = math.hypot(p[0], p[1])
    e = np.array([p[0], p[1], 0.0]) / radial
    around = np.array([-e[1], e[0], 0.0])
    out = np.array([radial - R, p[2]])
    distance = np.linalg.norm(out)
    n = (out[0] * e + out[1] * np.array([0, 0, 1.0])) / distance
    across = np.cross(around, n)
    # about the tube's circle the distance is that from its centre line, about the axis from there
    H = np.outer(across, across) / distance + (n @ e) / radial * np.outer(around, around)
    return distance - TUBE, n, H


def from_foot(p, x, n, shape_operator):
    s = n @ (p - x)
    return s, n, shape_operator @ np.linalg.inv(np.eye(3) + s * shape_operator)


def ellipsoid_form(p):
    """The foot from the one root of its Lagrange multiplier, the curvature from F's second form."""
    A = SEMI**2
    t = brentq(lambda t: np.sum((SEMI * p / (t + A)) ** 2) - 1.0, -min(A) * 0.9, 10.0, xtol=1e-16)
    x = A * p / (t + A)
    g, F = x / A, np.diag(1.0 / A)
    n = g / np.linalg.norm(g)
    P = np.eye(3) - np.outer(n, n)
    return from_foot(p, x, n, P @ F @ P / np.linalg.norm(g))


def bowl_form(p):
    """Below the bowl is the body: its normal points up, to the side of the axis."""
    rho = math.hypot(p[0], p[1])
    e = np.array([p[0], p[1], 0.0]) / rho
    r = brentq(lambda r: (r - rho) + 2 * BOWL * r * (BOWL * r * r - p[2]), 0.0, 3.0, xtol=1e-16)
    x = r * e + np.array([0, 0, BOWL * r * r])
    slope = 2 * BOWL * r
    n = np.array([-slope * e[0], -slope * e[1], 1.0]) / math.hypot(1.0, slope)
    along, around = np.cross(np.cross(e, [0, 0, 1.0]), n), np.array([-e[1], e[0], 0.0])
    k_along, k_around = -2 * BOWL / (1 + slope**2) ** 1.5, -2 * BOWL / math.hypot(1.0, slope)
    S = k_along * np.outer(along, along) + k_around * np.outer(around, around)
    return from_foot(p, x, n, S)


# --- the same surfaces as a user writes them ----------------------------------------------------


def sphere_distance(p):
    return (p[0] ** 2 + p[1] ** 2 + p[2] ** 2) ** 0.5 - R


def sphere_distance_real(p):
    return np.linalg.norm(p) - R


def torus_distance(p):
    return (((p[0] ** 2 + p[1] ** 2) ** 0.5 - R) ** 2 + p[2] ** 2) ** 0.5 - TUBE


def ellipsoid_point(u, v):
    return SEMI * np.array([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)])


def sphere_point(u, v):
    return R * ellipsoid_point(u, v) / SEMI


def torus_point(u, v):
    return [
        (R + TUBE * np.cos(v)) * np.cos(u),
        (R + TUBE * np.cos(v)) * np.sin(u),
        TUBE * np.sin(v),
    ]


def real_torus_point(u, v):
    rho = R + TUBE * math.cos(v)
    return [rho * math.cos(u), rho * math.sin(u), TUBE * math.sin(v)]


def bowl_point(x, y):
    return [x, y, BOWL * (x * x + y * y)]


def bowl_derivatives(x, y):
    k = 2 * BOWL
    return [[1, 0, k * x], [0, 1, k * y], [0, 0, k], [0, 0, 0], [0, 0, k]]


def ripples(u, v):
    return [u, v, np.sin(30 * u) / 30]


WIDE = (-0.4, 0.4)
SURFACES = {
    "sphere, complex steps": (lambda: SignedDistanceSurface(sphere_distance), sphere_form),
    "sphere, differences": (lambda: SignedDistanceSurface(sphere_distance_real), sphere_form),
    "sphere, gradient given": (
        lambda: SignedDistanceSurface(sphere_distance, lambda p: p / np.linalg.norm(p)),
        sphere_form,
    ),
    "sphere, all given": (
        lambda: SignedDistanceSurface(
            sphere_distance, lambda p: p / np.linalg.norm(p), lambda p: sphere_form(p)[2]
        ),
        sphere_form,
    ),
    "torus, distance": (lambda: SignedDistanceSurface(torus_distance, length=TUBE), torus_form),
    "sphere, parameters": (lambda: ParametricSurface(sphere_point, TURN, POLES), sphere_form),
    "torus, parameters": (lambda: ParametricSurface(torus_point, TURN, TURN), torus_form),
    "torus, real parameters": (lambda: ParametricSurface(real_torus_point, TURN, TURN), torus_form),
    "torus, flipped": (
        lambda: ParametricSurface(lambda u, v: torus_point(v, u), TURN, TURN, flip=True),
        torus_form,
    ),
    "torus, slanting parameters": (
        lambda: ParametricSurface(lambda u, v: torus_point(u, v + u), TURN, TURN),
        torus_form,
    ),
    "ellipsoid, parameters": (
        lambda: ParametricSurface(ellipsoid_point, TURN, POLES),
        ellipsoid_form,
    ),
    "bowl, parameters": (lambda: ParametricSurface(bowl_point, WIDE, WIDE), bowl_form),
    "bowl, derivatives given": (
        lambda: ParametricSurface(bowl_point, WIDE, WIDE, bowl_derivatives),
        bowl_form,
    ),
}


def places(form, rng, count=12):
    """Points near the surface: up to a third of its least radius of curvature away."""
    if form is bowl_form:
        for x, y in rng.uniform(-0.2, 0.2, (count, 2)):
            yield np.array(bowl_point(x, y)) + [0.0, 0.0, rng.uniform(-0.05, 0.05)]
        return
    for u, v in rng.uniform(-1.3, 1.3, (count, 2)):
        point = {
            sphere_form: sphere_point,
            torus_form: torus_point,
            ellipsoid_form: ellipsoid_point,
        }
        x = np.array(point[form](u + math.pi, v))
        yield x + rng.uniform(-0.03, 0.03) * form(1.0001 * x)[1]


@pytest.mark.parametrize("case", SURFACES)
def test_distance_normal_and_curvature_are_those_of_the_closed_form(case, rng):
    make, form = SURFACES[case]
    surface = make()
    for p in places(form, rng):
        distance, gradient, hessian = surface.closest(p)
        expected = form(p)
        assert distance == pytest.approx(expected[0], abs=1e-12)
        np.testing.assert_allclose(gradient, expected[1], atol=1e-11)
        scale = np.max(np.abs(expected[2]))
        np.testing.assert_allclose(hessian, expected[2], atol=1e-9 * scale)


@pytest.mark.parametrize(
    "make", [SURFACES["torus, parameters"][0], SURFACES["bowl, parameters"][0]]
)
def test_a_contact_that_is_followed_is_the_one_that_is_looked_for(make, rng):
    """Warm and cold starts end at the same point: results do not depend on what came before."""
    followed, form = make(), torus_form if make is SURFACES["torus, parameters"][0] else bowl_form
    for p in places(form, rng):
        warm = followed.closest(p)
        cold = make().closest(p)
        for a, b in zip(warm, cold, strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * np.max(np.abs(b), initial=1))
    followed.reset()
    np.testing.assert_allclose(followed.closest(p)[1], warm[1], atol=1e-13)


def test_a_contact_follows_a_full_turn_across_the_seam_of_the_parameters():
    surface = ParametricSurface(torus_point, TURN, TURN)
    for angle in np.linspace(0.0, 4.0 * math.pi, 60):
        p = np.array(torus_point(angle, -angle)) * 1.01
        assert surface.closest(p)[0] == pytest.approx(torus_form(p)[0], abs=1e-13)


def test_a_normal_through_a_point_far_away_is_still_found():
    surface = ParametricSurface(ellipsoid_point, TURN, POLES)
    for p in ([2.0, -1.0, 0.5], [-0.3, 4.0, -2.0], [0.0, 0.2, 3.0]):
        distance, gradient, _ = surface.closest(np.array(p))
        expected = ellipsoid_form(np.array(p))
        assert distance == pytest.approx(expected[0], abs=1e-12)
        np.testing.assert_allclose(gradient, expected[1], atol=1e-12)


# --- what is refused ------------------------------------------------------------------------------

AT = np.array([0.31, 0.05, 0.02])


def message_of(make, point=AT):
    with pytest.raises(ModelError) as caught:
        make().closest(np.asarray(point, float))
    return str(caught.value)


def test_a_function_that_is_no_distance_is_told_with_its_gradient():
    text = message_of(lambda: SignedDistanceSurface(lambda p: p @ p - R**2))
    assert "is not a signed distance: |gradient| = 0.629285" in text
    assert "[0.31, 0.05, 0.02]" in text


@pytest.mark.parametrize(
    ("make", "expected"),
    [
        (
            lambda: SignedDistanceSurface(sphere_distance, lambda p: -p / np.linalg.norm(p)),
            "the gradient of the surface 'sphere_distance' disagrees with differences of its",
        ),
        (
            lambda: SignedDistanceSurface(sphere_distance, None, lambda p: np.eye(3) / R),
            "the hessian of the surface 'sphere_distance' disagrees",
        ),
        (
            lambda: ParametricSurface(
                bowl_point, WIDE, WIDE, lambda x, y: np.array(bowl_derivatives(x, y)) * 1.001
            ),
            "the derivatives of the surface 'bowl_point' disagrees",
        ),
        (lambda: SignedDistanceSurface(lambda p: math.nan), "is not finite at [0.31, 0.05, 0.02]"),
        (lambda: SignedDistanceSurface(lambda p: p), "must return one number, got shape (3,)"),
        (lambda: SignedDistanceSurface(lambda p: "far"), "must return one number, got <U3"),
        (lambda: SignedDistanceSurface(lambda p: p[3]), "failed at [0.31, 0.05, 0.02]: IndexError"),
        (
            lambda: SignedDistanceSurface(sphere_distance, lambda p: p[:2]),
            "the gradient of the surface 'sphere_distance' must return numbers of shape (3,)",
        ),
        (
            lambda: SignedDistanceSurface(lambda p: np.linalg.norm(p) - R, length=3.0),
            "set 'length' to its smallest radius of curvature",
        ),
        (
            lambda: SignedDistanceSurface(lambda p: np.max(np.abs(p)) - R, length=2.5),
            "uncertain",
        ),
        (lambda: ParametricSurface(lambda u, v: [u, v], WIDE, WIDE), "numbers of shape (3,)"),
        (lambda: ParametricSurface(lambda u, v: [u, u, u], WIDE, WIDE), "do not depend on v"),
        (
            lambda: ParametricSurface(
                lambda u, v: [u, v, np.sin(30 * u) / 30], WIDE, WIDE, length=1
            ),
            "set 'length'",
        ),
        (
            lambda: ParametricSurface(lambda u, v: [u, v, math.log(u)], (0.0, 1.0), WIDE),
            "parametrisation of the surface",
        ),
    ],
)
def test_functions_that_are_not_what_they_should_be_are_refused(make, expected):
    assert expected in message_of(make)


def test_differences_keep_their_steps_where_the_function_fails():
    differences = NumericalDerivatives(lambda x: x, [0.5])

    def fails_at_halved_steps(x):
        if differences.lengths < 0.5:
            raise ModelError("the function failed")
        return x

    with pytest.raises(ModelError):
        check_certainty("the surface", differences, fails_at_halved_steps, np.ones(1), 1.0)
    assert differences.lengths.tolist() == [0.5]


def test_a_branch_that_loses_complex_numbers_is_noticed_when_the_contact_comes_there():
    def floor(p):
        return p[2] if p[0] < 0.1 else p[2].real

    surface = SignedDistanceSurface(floor)
    for x in (0.0, 0.09, 0.101, 0.2, 0.0):
        distance, gradient, hessian = surface.closest(np.array([x, 0.0, 0.01]))
        assert distance == pytest.approx(0.01)
        np.testing.assert_allclose(gradient, [0, 0, 1], atol=1e-9)
        np.testing.assert_allclose(hessian, 0.0, atol=1e-6)


def test_a_contact_on_a_fold_of_the_surface_has_no_normal():
    text = message_of(lambda: ParametricSurface(lambda u, v: [u * u, v, 0], WIDE, WIDE), (-1, 0, 0))
    assert "has no normal at u = " in text


def test_a_contact_at_a_pole_of_the_parameters_has_no_normal():
    text = message_of(lambda: ParametricSurface(sphere_point, TURN, POLES), (0.0, 0.0, 1.1 * R))
    assert "has no normal at u = " in text
    assert "v = 1.5708" in text


def test_a_contact_past_the_edge_is_told_with_the_ranges():
    text = message_of(
        lambda: ParametricSurface(bowl_point, WIDE, (-0.1, 0.3)), bowl_point(0, -0.101)
    )
    assert "u in [-0.4, 0.4] and v in [-0.1, 0.3]" in text
    assert ", v = -0.101)" in text
    assert "past the edge" in text
