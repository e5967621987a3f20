"""Claims about contacts that do not slip: rows for velocities only, and balls that roll by them.

The closed forms are those of a ball that rolls on an inclined plate, carried by a sledge on a
rail, and in a vertical tube on a turntable (where it does not sink, but swings up and down).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mechanics import body_twist, first_difference
from oracles import Side, meeting, swapped
from rolling_scenes import BALL, CARRIER, GRAVITY, RADIUS, SLEDGE, rolling_scene
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.geometry.records import (
    cone,
    cylinder,
    ellipsoid,
    plane,
    sphere,
    torus,
)

ZERO, Z, AXES = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.eye(3)
EGG = ellipsoid(ZERO, AXES, (0.3, 0.2, 0.25))

# --- rows of the kernel --------------------------------------------------------------------------

ROLLING = {
    "ball_on_plane": (sphere(ZERO, 0.2), plane(ZERO, Z), (0.3, -0.2)),
    "ball_on_sphere": (sphere(ZERO, 0.2), sphere(ZERO, 0.4), (0.7, 0.5)),
    "ball_in_bore": (sphere(ZERO, 0.2), cylinder(ZERO, Z, 0.6, inside=True), (1.1, 0.2)),
    "ball_on_cone": (sphere(ZERO, 0.2), cone(ZERO, Z, 0.5), (0.4, 0.8)),
    "ball_on_torus": (sphere(ZERO, 0.2), torus(ZERO, Z, 0.7, 0.25), (0.9, 0.4)),
    "egg_on_plane": (EGG, plane(ZERO, Z), (0.3, -0.2)),
    "egg_on_ellipsoid": (EGG, ellipsoid(ZERO, AXES, (0.5, 0.4, 0.6)), (2.0, -0.3)),
    "torus_on_cylinder": (torus(ZERO, Z, 0.5, 0.2), cylinder(ZERO, Z, 0.4), (0.5, 0.3)),
}


@pytest.fixture(params=["as_listed", "swapped"])
def way_round(request):
    return request.param


@pytest.fixture(params=ROLLING)
def met(request, way_round, rng):
    one, other, there = ROLLING[request.param]
    sides = Side.of(one).moved(rng), Side.of(other).moved(rng)
    found = meeting(*sides, (0.8, 0.4), there, 0.0, rng)
    return found if way_round == "as_listed" else swapped(found)


def rolling_rows(met, t=0.0):
    """A contact's rows after ``t``: normal force, no slip one way, no slip the other."""
    return met.rows(t, [replace(met.contact, tangent=k) for k in range(3)])


def test_rows_without_slip_lie_in_the_tangent_plane(met):
    rows = rolling_rows(met)
    np.testing.assert_allclose(rows.normals @ rows.normals.T, np.eye(3), atol=1e-14)
    pair = met.at(0.0)
    into_object = met.X_WO[:3, :3] @ pair.into_object
    np.testing.assert_allclose(rows.normals[0], into_object, atol=1e-10)
    # forces act at the contact point
    for name, point in (("W_m", pair.on_arm), ("W_o", pair.on_object)):
        W = getattr(rows, name)
        np.testing.assert_allclose(W[3:], np.cross(point, W[:3].T).T, atol=1e-10, err_msg=name)


def test_slip_does_not_depend_on_the_weight_of_the_normal_row(met):
    contacts = [replace(met.contact, tangent=k, weight=1.0 if k else 2.0) for k in range(3)]
    rows, weighted = rolling_rows(met), met.rows(0.0, contacts)
    np.testing.assert_allclose(weighted.W_o[:, 0], 2.0 * rows.W_o[:, 0], atol=1e-14)
    for name in ("W_m", "W_o", "c", "phi_dot"):
        expected = getattr(rows, name)[..., 1:]
        np.testing.assert_allclose(getattr(weighted, name)[..., 1:], expected, atol=1e-12)


def test_slip_is_the_difference_of_the_material_velocities(met):
    rows, pair = rolling_rows(met), met.at(0.0)
    at = met.X_WO[:3, :3] @ pair.on_object + met.X_WO[:3, 3]
    velocities = [
        twist[:3] + np.cross(twist[3:], at - X[:3, 3])
        for X, twist in ((met.X_WO, met.twist_O), (met.X_WT, met.twist_T))
    ]
    slip = rows.normals[1:] @ (velocities[0] - velocities[1])
    np.testing.assert_allclose(rows.phi_dot[1:], slip, rtol=0, atol=1e-10)
    power = rows.W_m.T @ body_twist(met.X_WT, met.twist_T)
    power += rows.W_o.T @ body_twist(met.X_WO, met.twist_O)
    np.testing.assert_allclose(power, rows.phi_dot, rtol=0, atol=1e-12)


def test_rates_of_rows_without_slip_are_differences(met):
    def matrices(t):
        rows = rolling_rows(met, t)
        return np.vstack([rows.W_m, rows.W_o])

    rows = rolling_rows(met)
    found = np.vstack([rows.W_m_dot, rows.W_o_dot])
    np.testing.assert_allclose(found, first_difference(matrices, 5e-3), rtol=0, atol=2e-8)
    slip_rate = first_difference(lambda t: rolling_rows(met, t).phi_dot, 5e-3)
    np.testing.assert_allclose(rows.c, -slip_rate, rtol=1e-8, atol=1e-8)


def test_no_slip_has_no_position(met):
    """A gap of the bodies is the normal row's alone."""
    rows = rolling_rows(met, 0.1)
    assert rows.phi[0] != 0.0
    assert rows.phi[1:].tolist() == [0.0, 0.0]


# --- a ball on an inclined plate ------------------------------------------------------------------

RAIL = np.array([1.0, 0.0, 0.0])
TILT = (0.3, 0.25, -0.4)  # roll, pitch, yaw of the plate
SPIN = np.array([3.0, -1.0, 2.0])  # [rad/s], the ball's at the start


@pytest.fixture(scope="module")
def carriers(tmp_path_factory):
    """URDF files of a sledge along x and of a turntable about z."""
    folder = tmp_path_factory.mktemp("carriers")
    sledge, table = folder / "sledge.urdf", folder / "turntable.urdf"
    sledge.write_text(CARRIER.format(kind="prismatic", axis="1 0 0", rpy="0.3 0.25 -0.4"))
    table.write_text(CARRIER.format(kind="continuous", axis="0 0 1", rpy="0 0 0"))
    return {"sledge": str(sledge), "turntable": str(table)}


def slip(run, contact_points, carrier_velocity):
    """Velocity of the ball's material at the contact less the carrier's (K, 3)."""
    arm = np.cross(run.object_twist[:, 3:], contact_points - run.object_position)
    return run.object_twist[:, :3] + arm - carrier_velocity


FEEDBACK = {"kind": "feedback", "alpha": 5.0, "beta": 5.0}


@pytest.mark.slow
@pytest.mark.parametrize("stabilization", ["projection", FEEDBACK], ids=["projection", "feedback"])
@pytest.mark.parametrize("roundness", [2 / 5, 2 / 3], ids=["solid", "shell"])
def test_ball_rolls_down_a_plate_on_a_sledge(carriers, roundness, stabilization):
    """u' = (g_t - A_t) / (1 + I / m r^2) across the normal: 5/7 g sin(slope) for a solid ball."""
    normal = Rotation.from_euler("xyz", TILT).as_matrix()[:, 2]
    start = RADIUS * normal
    u_0 = RADIUS * np.cross(SPIN, normal)  # relative to the plate
    sledge_0 = 0.4
    scene = rolling_scene(
        carriers["sledge"], {"plane": {"normal": [0, 0, 1]}}, roundness * BALL * RADIUS**2,
        start, sledge_0 * RAIL + u_0, SPIN, sledge_0,
    )  # fmt: skip
    run = ma.simulate(
        ma.compile_system(scene), 2.0, accuracy=1e-10, output_step=0.2,
        stabilization=stabilization, certificate=False,
    )  # fmt: skip
    assert run.status == "completed", run.message

    across = np.eye(3) - np.outer(normal, normal)
    g_t, a_t, share = across @ GRAVITY, across @ RAIL, 1.0 / (1.0 + roundness)
    # the sledge carries the ball's mass but for what rolls freely
    pull = (SLEDGE + BALL) * GRAVITY @ RAIL - BALL * share * g_t @ RAIL
    A = pull / (SLEDGE + BALL - BALL * share * a_t @ a_t)
    u_rate = share * (g_t - A * a_t)
    t = run.time[:, None]
    way = sledge_0 * t + 0.5 * A * t**2
    u = u_0 + u_rate * t
    position = start + way * RAIL + u_0 * t + 0.5 * u_rate * t**2
    spin = (SPIN @ normal) * normal + np.cross(normal, u) / RADIUS
    np.testing.assert_allclose(run.joint_positions["carrier"], way, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.object_position, position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.object_twist[:, 3:], spin, rtol=0, atol=1e-7)
    touching = run.object_position - RADIUS * normal
    carried = run.joint_velocities["carrier"] * RAIL
    np.testing.assert_allclose(slip(run, touching, carried), 0.0, atol=1e-9)


@pytest.mark.slow
def test_ball_in_a_tube_swings_up_and_down(carriers):
    """While it runs around n times, it swings sqrt(2/7) n times and does not sink.

    z'' = -5/7 g - 2/7 W^2 (z - z_0) - 2/7 r W w_0, with the running speed W and the ball's spin w_0
    about the outward direction at the start; the tube, free to turn, stays at rest.
    """
    tube, W, w_0, rise = 0.6, 4.0, 1.5, 0.3
    d = tube - RADIUS
    # touching at +x: no slip there
    spin = [w_0, rise / RADIUS, -d * W / RADIUS]
    scene = rolling_scene(
        carriers["turntable"], {"cylinder": {"radius": tube, "inside": True}},
        2 / 5 * BALL * RADIUS**2, [d, 0, 0], [0, d * W, rise], spin,
    ).model_copy(update={"gravity": (0.0, 0.0, -9.81)})  # fmt: skip
    run = ma.simulate(
        ma.compile_system(scene), 3.0, accuracy=1e-10, output_step=0.25, certificate=False
    )
    assert run.status == "completed", run.message

    k = math.sqrt(2 / 7) * W
    middle = -(5 / 7 * 9.81 + 2 / 7 * RADIUS * W * w_0) / k**2
    t = run.time
    z = middle * (1.0 - np.cos(k * t)) + rise / k * np.sin(k * t)
    position = np.column_stack([d * np.cos(W * t), d * np.sin(W * t), z])
    np.testing.assert_allclose(run.object_position, position, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.joint_positions["carrier"], 0.0, atol=1e-8)
    touching = position * [tube / d, tube / d, 1.0]
    np.testing.assert_allclose(slip(run, touching, np.zeros(3)), 0.0, atol=1e-9)
    assert np.ptp(z) > 0.5
