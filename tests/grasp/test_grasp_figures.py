"""Claims about pictures of grasps: what is drawn is what is meant."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import shapely
from matplotlib.patches import FancyArrowPatch, PathPatch

from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.blocks import design_block_grasp
from multiarm.grasp.designs.wide_bodies import design_wide_grasp
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.seventh_contact.contact_region import ContactRegion, seventh_contact_region
from multiarm.plots.grasp_figures import REGION, Eye, draw_grasp


def block() -> Grasp:
    return design_block_grasp([1.2, 1.0, 0.8], offset=0.1, seventh=0.05)


def region_of(grasp: Grasp) -> ContactRegion:
    return seventh_contact_region(grasp.contacts.subset(range(6)), grasp.body.faces[grasp.faces[6]])


def filled(figure, colour: str) -> list[PathPatch]:
    """Patches of one colour, without an outline."""
    patches = figure.axes[0].patches
    return [p for p in patches if isinstance(p, PathPatch) and _hex(p) == colour and p.get_fill()]


def _hex(patch: PathPatch) -> str:
    return "#" + "".join(f"{round(255 * x):02x}" for x in patch.get_facecolor()[:3])


def texts(figure) -> list[str]:
    return [text.get_text() for text in figure.axes[0].texts]


@pytest.mark.parametrize("ending", ["png", "svg"])
def test_the_picture_is_saved_as_a_file(tmp_path, ending):
    figure = draw_grasp(block())
    figure.savefig(tmp_path / f"grasp.{ending}")
    assert (tmp_path / f"grasp.{ending}").stat().st_size > 2000


def test_the_region_that_is_drawn_is_the_region():
    grasp = block()
    region = region_of(grasp)
    (patch,) = filled(draw_grasp(grasp), REGION)
    drawn = shapely.Polygon(patch.get_path().vertices)
    eyes = [Eye.at(azimuth) for azimuth in np.arange(-178.0, 180.0, 5.0)]
    (outline,) = region.outlines
    seen = [shapely.Polygon(eye.places(region.face.at(outline))) for eye in eyes]
    assert min(drawn.symmetric_difference(shape).area for shape in seen) < 1e-12
    assert drawn.area > 0.3 * region.area, "the face is seen well"


def test_numbers_of_contacts_do_not_cover_each_other():
    grasp = block()
    points = grasp.contacts.points.copy()
    points[6] = points[2] + [1e-3, 0.0, 0.0]  # both are on the top
    figure = draw_grasp(replace(grasp, contacts=Contacts(points, grasp.contacts.normals)))
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert len(boxes) == 7
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))


@pytest.mark.parametrize("azimuth", [-170.0, 12.0, 95.0])
def test_the_eye_has_right_handed_axes_with_z_up(azimuth):
    eye = Eye.at(azimuth)
    np.testing.assert_allclose(eye.axes @ eye.axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(eye.axes) == pytest.approx(1.0)
    assert eye.places([0.0, 0.0, 1.0])[0] == pytest.approx(0.0)
    assert eye.places([0.0, 0.0, 1.0])[1] > 0.0


def test_a_block_shows_nine_edges_and_hides_three():
    lines = [line for line in draw_grasp(block()).axes[0].lines if line.get_marker() != "o"]
    assert sorted(line.get_linestyle() for line in lines) == ["-"] * 9 + ["--"] * 3


def test_each_contact_has_an_arrow_that_ends_at_it_in_its_grippers_colour():
    grasp = design_wide_grasp(Polyhedron.pyramid([(1, 1), (-1, 1), (-1, -1), (1, -1)], [0, 0, 1.5]))
    figure = draw_grasp(grasp)
    arrows = [p for p in figure.axes[0].patches if isinstance(p, FancyArrowPatch)]
    assert len(arrows) == 7
    assert len({arrow.get_edgecolor()[:3] for arrow in arrows}) == 2
    assert {"1", "2", "3", "4", "5", "6", "7"} <= set(texts(figure))
    assert len(filled(figure, REGION)) == 1
    assert figure.axes[0].get_title(loc="left") == "7 contacts: form closure"
