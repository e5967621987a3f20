"""Claims about pictures of grasps: what is drawn is what is meant."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from matplotlib.patches import Circle, FancyArrowPatch, PathPatch

from multiarm.grasp.blocks import design_block_grasp
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face import Face
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.seventh_contact import ContactRegion, seventh_contact_region
from multiarm.grasp.wide_design import design_wide_grasp
from multiarm.plots.grasp_figures import DARK, LIGHT, Eye, draw_face, draw_grasp


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


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_both_pictures_are_saved_as_files_in_both_themes(tmp_path, dark, ending):
    grasp = block()
    face = draw_face(region_of(grasp), last=grasp.contacts.points[6], dark=dark)
    for name, figure in (("face", face), ("grasp", draw_grasp(grasp, dark=dark))):
        figure.savefig(tmp_path / f"{name}.{ending}")
        assert (tmp_path / f"{name}.{ending}").stat().st_size > 2000
        paper = tuple(int((DARK if dark else LIGHT).paper[k : k + 2], 16) / 255 for k in (1, 3, 5))
        assert figure.get_facecolor()[:3] == pytest.approx(paper)


def test_the_region_that_is_drawn_is_the_region():
    region = region_of(block())
    (patch,) = filled(draw_face(region), LIGHT.region)
    drawn = shapely.Polygon(patch.get_path().vertices)
    assert drawn.area == pytest.approx(region.area)
    assert drawn.symmetric_difference(region.shape).area < 1e-12


def test_least_distance_of_the_block_is_marked():
    grasp = block()
    figure = draw_face(region_of(grasp), last=grasp.contacts.points[6])
    assert "$D_x$ = 0.1 m" in texts(figure)
    (circle,) = (p for p in figure.axes[0].patches if isinstance(p, Circle))
    assert circle.radius == pytest.approx(region_of(grasp).depth(grasp.contacts.points[6]))
    slanted = grasp.contacts.points[6] - [0.05, 0.1, 0.0]
    beside = texts(draw_face(region_of(grasp), last=slanted))
    assert any(text.startswith("$D$ = ") for text in beside)


def test_contacts_of_the_face_are_dots_and_others_are_rings():
    region = region_of(block())
    lines = [line for line in draw_face(region).axes[0].lines if line.get_marker() == "o"]
    assert len(lines) == 6
    solid = [line for line in lines if line.get_markeredgecolor() == LIGHT.paper]
    assert len(solid) == 1
    assert solid[0].get_markersize() > max(
        line.get_markersize() for line in lines if line not in solid
    )
    np.testing.assert_allclose(np.ravel(solid[0].get_data()), [0.55, 0.4])


def test_an_empty_region_says_so():
    normals = [[-1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 1, 0], [0, 0, 1], [0, 1, 0]]
    points = [[0.6, 0.4, 0.3], [0.5, 0.5, 0.3], [0.55, 0.4, 0.4], [-0.5, -0.5, -0.3]]
    six = Contacts([*points, [-0.55, -0.4, -0.4], [0.3, -0.5, 0.2]], normals)
    figure = draw_face(seventh_contact_region(six, block().body.faces[2]))
    assert "nowhere: the region is empty" in texts(figure)
    assert not filled(figure, LIGHT.region)


def test_holes_of_a_face_stay_open():
    hole = [[-0.4, 0.3, 0.4], [-0.4, 0.4, 0.4], [-0.2, 0.4, 0.4], [-0.2, 0.3, 0.4]]
    face = Face(block().body.faces[2].vertices, (np.array(hole),))
    region = seventh_contact_region(block().contacts.subset(range(6)), face)
    (patch,) = filled(draw_face(region), LIGHT.region)
    outer, inner = (shapely.LinearRing(ring) for ring in patch.get_path().to_polygons())
    assert outer.is_ccw and not inner.is_ccw  # windings add up to zero in the hole
    areas = [shapely.Polygon(ring).area for ring in (outer, inner)]
    assert areas[0] - areas[1] == pytest.approx(region.area)


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


@pytest.mark.parametrize("regions", [True, False])
def test_each_contact_has_an_arrow_that_ends_at_it_in_its_grippers_colour(regions):
    grasp = design_wide_grasp(Polyhedron.pyramid([(1, 1), (-1, 1), (-1, -1), (1, -1)], [0, 0, 1.5]))
    figure = draw_grasp(grasp, regions=regions)
    arrows = [p for p in figure.axes[0].patches if isinstance(p, FancyArrowPatch)]
    assert len(arrows) == 7
    assert len({arrow.get_edgecolor()[:3] for arrow in arrows}) == 2
    assert {"1", "2", "3", "4", "5", "6", "7"} <= set(texts(figure))
    assert len(filled(figure, LIGHT.region)) == regions
    assert figure.axes[0].get_title(loc="left") == "7 contacts: form closure"


def test_pictures_open_no_window():
    import matplotlib.pyplot as plt

    before = plt.get_fignums()
    draw_grasp(block())
    draw_face(region_of(block()))
    assert plt.get_fignums() == before
