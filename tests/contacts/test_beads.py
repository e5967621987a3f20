"""Claims about a bead that slides without friction on a surface which a sledge carries.

The sledge runs on a straight rail; surface and bead move each other.  The oracle is Lagrange's
equation of the three coordinates that are left: the sledge's way and two on the surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from mechanics import scene_of
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import multiarm as ma

SLEDGE, BEAD, DURATION = 3.0, 0.7, 2.0  # [kg], [kg], [s]
INERTIA = np.array([0.004, 0.007, 0.009])  # [kg m^2], the bead's
GRAVITY = np.array([0.4, -0.7, -9.5])
RAIL = np.array([0.96, 0.0, 0.28])
TURN = (0.5, -0.4, 0.9)  # roll, pitch, yaw of the surface on the sledge
SPIN = np.array([2.0, -3.0, 1.0])  # [rad/s], the bead's

SLEDGE_URDF = """<robot name="sledge"><link name="ground"/>
<joint name="rail" type="prismatic"><parent link="ground"/><child link="runner"/>
<axis xyz="0.96 0 0.28"/><limit lower="-50" upper="50" effort="1000" velocity="100"/></joint>
<link name="runner"><inertial><mass value="3.0"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
<joint name="mount" type="fixed"><parent link="runner"/><child link="tip"/>
<origin xyz="0.1 0.2 0.3" rpy="0.5 -0.4 0.9"/></joint><link name="tip"/></robot>"""


@dataclass(frozen=True)
class Profile:
    """A curve (rho, z) turned about the z axis and stretched: points and their derivatives.

    ``curve(u)`` gives rows of value, first and second derivative of (rho, z).
    """

    geometry: dict
    curve: Callable
    start: tuple[float, float, float, float]  # u, v, u', v'
    stretch: np.ndarray = field(default_factory=lambda: np.ones(3))

    def point(self, u, v):
        rho, z = self.curve(u)[0]
        return self.stretch * [rho * math.cos(v), rho * math.sin(v), z]

    def tangents(self, u, v):
        """dr/du and dr/dv as columns (3, 2)."""
        (rho, _), (rho_u, z_u), _ = self.curve(u)
        c, s = math.cos(v), math.sin(v)
        return self.stretch[:, None] * np.array(
            [[rho_u * c, -rho * s], [rho_u * s, rho * c], [z_u, 0.0]]
        )

    def bend(self, u, v, du, dv):
        """Second derivative of the point along the motion when u'' = v'' = 0."""
        (rho, _), (rho_u, _), (rho_uu, z_uu) = self.curve(u)
        c, s = math.cos(v), math.sin(v)
        out = np.array([c, s, 0.0]) * (rho_uu * du**2 - rho * dv**2)
        out += np.array([-s, c, 0.0]) * (2.0 * rho_u * du * dv)
        out[2] = z_uu * du**2
        return self.stretch * out


def circle(radius, circle_radius=0.0):
    """Of a sphere (or, away from the axis, of a torus); u is the angle above the equator."""
    return lambda u: np.array(
        [
            [circle_radius + radius * math.cos(u), radius * math.sin(u)],
            [-radius * math.sin(u), radius * math.cos(u)],
            [-radius * math.cos(u), -radius * math.sin(u)],
        ]
    )


def line(rho, z):
    """A straight profile through (rho[0], z[0]) with the slopes rho[1], z[1]."""
    return lambda u: np.array([[rho[0] + rho[1] * u, z[0] + z[1] * u], [rho[1], z[1]], [0, 0]])


def paraboloid(k):
    """The curve z = k rho^2."""
    return lambda u: np.array([[u, k * u**2], [1.0, 2 * k * u], [0.0, 2 * k]])


def bowl_surface(u, v):
    """What the user writes for the bowl z = 0.8 (x^2 + y^2), 2 m wide."""
    return np.array([u, v, 0.8 * (u * u + v * v)])


HALF = 0.7  # [rad] of the cones
BEADS = {
    "sphere": Profile({"sphere": {"radius": 0.8}}, circle(0.8), (0.9, 0.3, -0.5, 1.5)),
    "hollow_sphere": Profile(
        {"sphere": {"radius": 0.8, "inside": True}}, circle(0.8), (-0.6, 0.3, 0.4, 2.0)
    ),
    "cylinder": Profile({"cylinder": {"radius": 0.5}}, line((0.5, 0), (0, 1)), (0.1, 0.3, 0.4, 2)),
    "bore": Profile(
        {"cylinder": {"radius": 0.5, "inside": True}}, line((0.5, 0), (0, 1)), (0.1, 0.3, 0.4, 2)
    ),
    "cone": Profile(
        {"cone": {"axis": [0, 0, -1], "half_angle": HALF}},
        line((0, math.sin(HALF)), (0, -math.cos(HALF))), (0.8, 0.3, 0.3, 1.2),
    ),
    "funnel": Profile(
        {"cone": {"half_angle": HALF, "inside": True}},
        line((0, math.sin(HALF)), (0, math.cos(HALF))), (0.8, 0.3, 0.1, 4.0),
    ),
    "torus": Profile(
        {"torus": {"circle_radius": 0.6, "tube_radius": 0.25}},
        circle(0.25, 0.6), (1.2, 0.3, 3.0, 1.0),
    ),
    "inside_of_a_tube": Profile(
        {"torus": {"circle_radius": 0.6, "tube_radius": 0.25, "inside": True}},
        circle(0.25, 0.6), (-1.2, 0.3, 3.0, 1.0),
    ),
    "ellipsoid": Profile(
        {"ellipsoid": {"semi_axes": [0.7, 0.9, 0.5]}},
        circle(1.0), (0.9, 0.3, 0.5, 1.5), np.array([0.7, 0.9, 0.5]),
    ),
    "hollow_ellipsoid": Profile(
        {"ellipsoid": {"semi_axes": [0.7, 0.9, 0.5], "inside": True}},
        circle(1.0), (-0.6, 0.3, 0.5, 1.5), np.array([0.7, 0.9, 0.5]),
    ),
    "bowl_by_its_points": Profile(
        {"surface": {"parametrisation": bowl_surface, "u": [-2, 2], "v": [-2, 2]}},
        paraboloid(0.8), (0.5, 0.3, 0.2, 3.0),
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def sledge(tmp_path_factory):
    path = tmp_path_factory.mktemp("sledge") / "sledge.urdf"
    path.write_text(SLEDGE_URDF)
    return path


def surface_pose():
    """Rotation and origin of the surface in the world while the sledge is at 0."""
    return Rotation.from_euler("xyz", TURN).as_matrix(), np.array([0.1, 0.2, 0.3])


def bead_scene(sledge, profile: Profile, geometry=None, body_contact=None):
    """The bead on its surface, moving along it; sledge and bead have their own velocities."""
    R, origin = surface_pose()
    u, v, du, dv = profile.start
    velocity = 0.3 * RAIL + R @ profile.tangents(u, v) @ [du, dv]
    body = {
        "shape": {"sphere": 0.05},
        "mass": BEAD,
        "inertia": INERTIA.tolist(),
        "pose": {"xyz": (origin + R @ profile.point(u, v)).tolist(), "rpy": [0.3, 0.2, -0.5]},
        "twist": [*velocity.tolist(), *SPIN.tolist()],
    }
    arms = {"sledge": {"urdf": str(sledge), "tip": "tip", "velocity": [0.3]}}
    contact = {"arm": geometry or profile.geometry, "object": body_contact or {"point": [0, 0, 0]}}
    joint = {"arm": "sledge", "kind": "contacts", "contacts": [contact]}
    # one joint cannot move along every normal: where it cannot, the node algorithm stops
    run = {"solver": "dense"}
    return scene_of(arms, [joint], object=body, gravity=GRAVITY.tolist(), run=run)


def lagrange(profile: Profile, times: np.ndarray):
    """Way of the sledge (K,) and position of the bead (K, 3), from Lagrange's equations."""
    R, origin = surface_pose()

    def derivative(_, y):
        _s, u, v, _ds, du, dv = y
        J = np.column_stack([RAIL, R @ profile.tangents(u, v)])  # (3, 3)
        M = BEAD * J.T @ J
        M[0, 0] += SLEDGE
        force = BEAD * J.T @ (GRAVITY - R @ profile.bend(u, v, du, dv))
        force[0] += SLEDGE * GRAVITY @ RAIL
        return np.concatenate([y[3:], np.linalg.solve(M, force)])

    u, v, du, dv = profile.start
    start = [0.0, u, v, 0.3, du, dv]
    run = solve_ivp(derivative, (0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13)
    points = [
        origin + s * RAIL + R @ profile.point(u, v) for s, u, v in zip(*run.y[:3], strict=True)
    ]
    return run.y[0], np.array(points)


def free_rotation(start: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Attitude of a body that nothing turns, quaternions xyzw (K, 4), from Euler's equations."""
    turn = Rotation.from_quat(start)

    def derivative(_, y):
        q, w = y[:4], y[4:]
        rate = 0.5 * np.array([*(q[3] * w + np.cross(q[:3], w)), -q[:3] @ w])
        return np.concatenate([rate, -np.cross(w, INERTIA * w) / INERTIA])

    y0 = np.concatenate([start, turn.inv().apply(SPIN)])
    run = solve_ivp(derivative, (0, times[-1]), y0, "DOP853", times, rtol=1e-12, atol=1e-13)
    return run.y[:4].T


def compare(scene, profile: Profile) -> None:
    """Run a scene and hold sledge, bead and the bead's attitude against their equations."""
    run = ma.simulate(
        ma.compile_system(scene), DURATION, accuracy=1e-10, output_step=0.1, certificate=False
    )
    assert run.status == "completed", run.message
    way, position = lagrange(profile, run.time)
    np.testing.assert_allclose(run.joint_positions["sledge"][:, 0], way, rtol=0, atol=1e-8)
    np.testing.assert_allclose(run.object_position, position, rtol=0, atol=1e-8)
    attitude = free_rotation(run.object_quaternion_xyzw[0], run.time)
    apart = Rotation.from_quat(run.object_quaternion_xyzw) * Rotation.from_quat(attitude).inv()
    np.testing.assert_allclose(apart.magnitude(), 0.0, atol=1e-8)
    # far enough along the surface to mean something
    assert np.max(np.linalg.norm(position - position[0], axis=1)) > 0.2


@pytest.mark.parametrize("name", BEADS)
def test_bead_moves_as_lagrange_says(sledge, name):
    compare(bead_scene(sledge, BEADS[name]), BEADS[name])


TIP, ELLIPSOID = {"sphere": {"radius": 0.05}}, {"ellipsoid": {"semi_axes": [0.05, 0.05, 0.05]}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "thinner", "ball"),
    [
        ("sphere", {"sphere": {"radius": 0.75}}, TIP),
        ("bore", {"cylinder": {"radius": 0.55, "inside": True}}, ELLIPSOID),
        ("torus", {"torus": {"circle_radius": 0.6, "tube_radius": 0.2}}, ELLIPSOID),
        (
            "inside_of_a_tube",
            {"torus": {"circle_radius": 0.6, "tube_radius": 0.3, "inside": True}},
            TIP,
        ),
    ],
)
def test_round_bead_slides_a_radius_away_from_its_surface(sledge, name, thinner, ball):
    """Radius 5 cm on a body 5 cm thinner: the centre has the same path, and nothing turns it."""
    compare(bead_scene(sledge, BEADS[name], thinner, ball), BEADS[name])


@pytest.mark.slow
def test_bead_keeps_its_energy(sledge):
    scene = bead_scene(sledge, BEADS["ellipsoid"])
    run = ma.simulate(ma.compile_system(scene), DURATION, accuracy=1e-9, certificate=False)
    assert np.max(np.abs(run.energy_balance)) < 1e-8
    assert np.max(run.position_drift) < 1e-9
