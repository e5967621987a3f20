"""Claims about contact surfaces in the replay: they are where the contacts have them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanics import ur5_pair

import multiarm as ma
from multiarm.contacts.surfaces import QUERY_WIDTH, Query, local_distance
from multiarm.contacts.table import pack
from multiarm.geometry import records
from multiarm.geometry.records import Contact, Patch, Surface
from multiarm.geometry.smooth_surfaces import ParametricSurface
from multiarm.jit.rows import fields_of
from multiarm.viewer.animate import animate
from multiarm.viewer.contact_tracks import surface_mesh

AT, AXIS = (0.3, -0.2, 0.5), (0.2, 0.3, 0.9)
SURFACES = {
    "plane": records.plane(AT, AXIS),
    "sphere": records.sphere(AT, 0.4),
    "hollow_sphere": records.sphere(AT, 0.4, inside=True),
    "cylinder": records.cylinder(AT, AXIS, 0.2),
    "bore": records.cylinder(AT, AXIS, 0.2, inside=True),
    "cone": records.cone(AT, AXIS, 0.5),
    "torus": records.torus(AT, AXIS, 0.4, 0.1),
    "ellipsoid": records.ellipsoid(AT, records.basis(AXIS), (0.3, 0.2, 0.4)),
}


def distance(surface: Surface, p: np.ndarray) -> tuple[float, np.ndarray]:
    """Signed distance of the solid body and its gradient at a point, body's frame."""
    egg = records.ellipsoid(AT, np.eye(3), (1, 2, 3))  # a sphere would be its tip
    hollow = replace(surface, inside=True)
    shape = pack([Contact("c", egg, hollow)]).table.shapes[0]
    query = np.zeros(QUERY_WIDTH)
    at = fields_of(Query, query)
    at.point[:] = surface.axes.T @ (p - surface.origin)
    local_distance(shape, query, 0)
    return float(at.distance), surface.axes @ at.gradient


@pytest.mark.parametrize("surface", SURFACES.values(), ids=SURFACES)
def test_mesh_lies_on_its_surface_and_faces_outwards(surface):
    mesh = surface_mesh(surface, np.array(AT) + surface.axes[:, 0] * 0.2, 0.5)
    side = -1.0 if surface.inside else 1.0
    away = [distance(surface, p)[0] for p in mesh.vertices[::7]]
    finite = np.isfinite(away)  # an apex has no normal
    assert finite.mean() > 0.9
    np.testing.assert_allclose(np.array(away)[finite], 0.0, atol=1e-12)
    for triangle in mesh.triangles[5::97]:
        a, b, c = mesh.vertices[triangle]
        across = np.cross(b - a, c - a)
        normal = side * distance(surface, (a + b + c) / 3)[1]
        if np.linalg.norm(across) > 1e-9 and np.isfinite(normal).all():
            assert across @ normal > 0.8 * np.linalg.norm(across)


def test_only_the_patch_is_drawn():
    patch = Patch(np.array([-np.inf, -0.1, -np.inf]), np.array([np.inf, 0.1, np.inf]))
    surface = Surface(records.PLANE, np.zeros(3), patch=patch)
    mesh = surface_mesh(surface, np.zeros(3), 2.0)
    used = mesh.vertices[np.unique(mesh.triangles)]
    assert np.abs(used[:, 1]).max() <= 0.1
    assert np.abs(used[:, 0]).max() == pytest.approx(1.0)


def test_a_point_has_no_surface():
    assert surface_mesh(records.point(AT), np.zeros(3), 1.0) is None


@pytest.mark.parametrize("flip", [False, True])
def test_parametrised_surface_is_drawn_with_its_outside_out(flip):
    def hill(u, v):
        return np.array([u, v, 0.1 * u * u + 0.2 * v * v])

    shape = ParametricSurface(hill, (-0.5, 0.5), (-0.3, 0.4), flip=flip)
    mesh = surface_mesh(records.smooth(shape), np.zeros(3), 1.0)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z, 0.1 * x**2 + 0.2 * y**2, atol=1e-12)
    a, b, c = mesh.vertices[mesh.triangles[100]]
    assert np.sign(np.cross(b - a, c - a)[2]) == (-1.0 if flip else 1.0)


@pytest.mark.slow
def test_an_animation_carries_the_surfaces_of_both_bodies():
    pad = {"ellipsoid": {"center": [0, 0, -0.05], "semi_axes": [0.09, 0.06, 0.05]}}
    face = {"plane": {"point": [0.6, 0, 0], "normal": [1, 0, 0]}}
    scene = ur5_pair(
        {"kind": "weld"}, {"kind": "contacts", "contacts": [{"arm": pad, "object": face}]}
    )
    run = ma.simulate(
        ma.compile_system(scene), 0.1, accuracy=1e-6, output_step=0.05, certificate=False
    )
    animation = animate(run, fps=20.0, speed=1.0, meshes=False)
    shown = {body.name: body for body in animation.bodies if body.name.startswith("surfaces/")}
    assert set(shown) == {"surfaces/right/1_arm", "surfaces/right/1_object"}
    on_object = shown["surfaces/right/1_object"]
    np.testing.assert_allclose(on_object.position, run.object_position, atol=1e-12)
    np.testing.assert_allclose(on_object.mesh.vertices[:, 0], 0.6, atol=1e-9)
    middle = shown["surfaces/right/1_arm"].mesh.vertices.mean(axis=0)
    np.testing.assert_allclose(middle[:2], 0.0, atol=0.01)
