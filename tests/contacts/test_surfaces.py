"""Claims about a tip on every kind of surface: gap, rates, dW/dt and c, on either body.

The oracle (``oracles``) knows the surfaces' equations F = 0 only.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import (
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

from multiarm.geometry.records import (
    cone,
    cylinder,
    ellipsoid,
    plane,
    sphere,
    torus,
)

ZERO, Z, AXES = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.eye(3)
STEP = 5e-3  # [s] of the order-8 differences

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
USERS = {
    "bowl_by_its_points": (bowl_side(0.5), (0.4, 0.2)),
    "waves_by_their_points": (waves_side(), (0.2, 0.3)),
    "ellipsoid_by_its_points": (parametric_ellipsoid_side(np.array([0.5, 0.4, 0.6])), (0.7, 0.5)),
    "hollow_by_its_points": (
        parametric_ellipsoid_side(np.array([0.7, 0.8, 0.9]), inside=True), (3.1, -0.4),
    ),
    "torus_by_its_distance": (distance_torus_side(0.7, 0.25), (0.9, 0.4)),
}  # fmt: skip
SIDES = {name: (Side.of(surface), there) for name, (surface, there) in SURFACES.items()} | USERS
# radius of the tip and gap
TIPS = {
    "point_touching": (0.0, 0.0),
    "point_apart": (0.0, 0.07),
    "ball_apart": (0.15, 0.07),
    "ball_overlapping": (0.15, -0.04),
}


@pytest.fixture(params=["tip_on_arm", "tip_on_object"])
def way_round(request):
    return request.param


@pytest.fixture(params=TIPS)
def tip(request):
    return TIPS[request.param]


@pytest.fixture(params=SIDES)
def met(request, way_round, tip, rng):
    guide, there = SIDES[request.param]
    radius, gap = tip
    ball = Side.of(sphere(ZERO, radius))
    found = meeting(ball.moved(rng), guide.moved(rng), (0.4, -0.3), there, gap, rng)
    return found if way_round == "tip_on_arm" else swapped(found)


def test_gap_and_normal_are_those_of_the_surfaces_equations(met):
    claim_gap_and_normal(met)


def test_rates_are_the_differences_of_what_the_equations_give(met):
    claim_rates(met, STEP)


def test_gap_rate_is_the_power_of_a_unit_push(met):
    claim_power(met)
