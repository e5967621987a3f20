"""Claims about polyhedra: they are solids, weigh what solids weigh, and know their class."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import trimesh
from grasp_oracles import SQUARE, plate_with_hole
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import WORKED
from scipy.optimize import nnls
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import classify, roundness
from multiarm.grasp.body.boundaries import triangles_of
from multiarm.grasp.body.face import Face
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.designs.grippers import convex_corner, corner_frame, shared_corner

# Sums of some hundred products, relative to their size.
ROUNDING = 1e-12
# Coordinates in a file of single precision, relative to the largest.
SINGLE = 1e-6
BENT = np.array([[0.0, 0.0, 0.1]] + [[0.0, 0.0, 0.0]] * 7)
ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]


def round_prism(sides: int, height: float = 3.0) -> Polyhedron:
    angles = 2.0 * np.pi * np.arange(sides) / sides
    return Polyhedron.prism(np.column_stack([np.cos(angles), np.sin(angles)]), height)


def random_pose(rng: np.random.Generator, reach: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    pose[:3, 3] = rng.uniform(-reach, reach, 3)
    return pose


BODIES = {
    "box": Polyhedron.box([1.2, 1.0, 0.8]),
    "prism": Polyhedron.prism(ELL[::-1], 1.5),
    "wedge": Polyhedron.wedge([2.0, 1.0, 1.0]),
    "cut wedge": Polyhedron.wedge([2.0, 1.0, 1.0], 0.7),
    "pyramid": Polyhedron.pyramid(SQUARE, [0.2, 0.1, 1.5]),
    "hanging pyramid": Polyhedron.pyramid(SQUARE, [0.2, 0.1, -1.5]),
    "hull": Polyhedron.hull(np.random.default_rng(0).normal(size=(20, 3))),
    "plate with a hole": plate_with_hole(),
}
VOLUMES = {
    "box": 0.96,
    "prism": 4.5,
    "wedge": 1.0,
    "cut wedge": 1.35,
    "pyramid": 2.0,
    "hanging pyramid": 2.0,
    "plate with a hole": 12.0,
}


# --- solids -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", VOLUMES)
def test_volumes_are_the_closed_forms(name):
    assert BODIES[name].volume == pytest.approx(VOLUMES[name], rel=ROUNDING)


@pytest.mark.parametrize("name", BODIES)
def test_faces_close_the_body_and_enclose_its_volume(name):
    """Area vectors of a closed surface add up to zero; the divergence of x / 3 is one."""
    faces = BODIES[name].faces
    areas = np.array([face.area for face in faces])
    assert np.abs(areas @ BODIES[name].normals).max() < ROUNDING * areas.sum()
    heights = np.array([face.offset for face in faces])
    assert areas @ heights / 3.0 == pytest.approx(BODIES[name].volume, rel=ROUNDING)


@pytest.mark.parametrize("name", BODIES)
def test_mass_properties_are_those_of_the_triangulated_body(name):
    body = BODIES[name]
    theirs = trimesh.Trimesh(body.vertices, triangles_of(body.faces, body.loops), process=False)
    theirs.density = 2.5 / theirs.volume
    ours = body.mass_properties(2.5)
    assert ours.mass == 2.5
    np.testing.assert_allclose(ours.centre, theirs.center_mass, atol=ROUNDING * body.size)
    tol = 10.0 * ROUNDING * 2.5 * body.size**2
    np.testing.assert_allclose(ours.inertia, theirs.moment_inertia, atol=tol)


@given(st.tuples(*[st.floats(1e-3, 1e2)] * 3))
@settings(deadline=None, max_examples=30)
def test_inertia_of_a_block_is_the_textbooks(lengths):
    body = Polyhedron.box(lengths)
    x, y, z = np.square(lengths)
    expected = 3.0 / 12.0 * np.array([y + z, z + x, x + y])
    inertia = body.mass_properties(3.0).inertia
    np.testing.assert_allclose(inertia, np.diag(expected), atol=ROUNDING * expected.max())


@pytest.mark.slow
@given(st.integers(0, 10_000), st.floats(1e-3, 1e3), st.floats(0.0, 1e3))
@settings(deadline=None, max_examples=25)
def test_a_body_is_the_same_of_any_size_at_any_place(seed, factor, reach):
    rng = np.random.default_rng(seed)
    body = Polyhedron.hull(rng.normal(size=(9, 3)))
    pose = random_pose(rng, reach * factor)
    moved = body.scaled(factor).placed(pose)
    far = 1e-12 * (1.0 + reach)  # rounding of coordinates that far away, in sizes of the body
    assert moved.loops == body.loops and moved.convex
    assert moved.volume == pytest.approx(factor**3 * body.volume, rel=1e2 * far)
    R = pose[:3, :3]
    np.testing.assert_allclose(moved.normals, body.normals @ R.T, atol=1e4 * far)
    turned = R @ body.mass_properties(1.0).inertia @ R.T * factor**2
    tol = 1e2 * far * factor**2 * body.size**2
    np.testing.assert_allclose(moved.mass_properties(1.0).inertia, turned, atol=tol)
    at_rest = np.abs(moved.centred().centre).max()
    assert at_rest < far * factor * body.size


@pytest.mark.parametrize("seed", range(5))
def test_hull_is_qhulls(seed):
    points = np.random.default_rng(seed).normal(size=(25, 3))
    body, theirs = Polyhedron.hull(points), ConvexHull(points)
    assert body.convex
    assert body.volume == pytest.approx(theirs.volume, rel=ROUNDING)
    assert len(body.faces) == len(theirs.simplices)
    again = Polyhedron.halfspaces(body.normals, [face.offset for face in body.faces])
    assert again.volume == pytest.approx(body.volume, rel=1e-9)


def test_coplanar_triangles_of_a_hull_are_one_face_anywhere():
    rng = np.random.default_rng(3)
    for reach in (0.0, 1e3):
        block = Polyhedron.box([1.0, 2.0, 3.0]).placed(random_pose(rng, reach))
        middles = 0.5 * (block.vertices[:4] + block.vertices[4:])
        body = Polyhedron.hull(np.vstack([block.vertices, middles]))
        assert [len(face.vertices) for face in body.faces] == [4] * 6
        assert len(body.vertices) == 8


@pytest.mark.parametrize("name", BODIES)
def test_each_edge_has_two_faces_and_each_corner_three_or_more(name):
    body = BODIES[name]
    holes = sum(len(face.holes) for face in body.faces)
    genus = 1 if holes else 0
    euler = len(body.vertices) - len(body.edges) + len(body.faces) - holes
    assert euler == 2 - 2 * genus
    for (u, v), (left, right) in body.edges.items():
        assert left != right
        assert {left, right} <= set(body.corners[u]) & set(body.corners[v])
    assert min(map(len, body.corners)) >= 3


def test_convexity_is_told_of_bodies_and_of_faces():
    assert {n for n, body in BODIES.items() if not body.convex} == {"prism", "plate with a hole"}
    assert [face.convex for face in BODIES["prism"].faces] == [True] * 6 + [False] * 2
    assert not BODIES["plate with a hole"].faces[0].convex
    star = [(np.cos(0.8 * k * np.pi), np.sin(0.8 * k * np.pi), 0.0) for k in range(5)]
    assert not Face(star).convex  # it turns left all the way, but twice around


# --- faces --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BODIES)
def test_face_coordinates_lead_there_and_back(name):
    for face in BODIES[name].faces:
        R = face.frame[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=ROUNDING)
        assert np.linalg.det(R) == pytest.approx(1.0)
        np.testing.assert_allclose(R[:, 2], face.normal, atol=ROUNDING)
        back = face.at(face.outline)
        np.testing.assert_allclose(back, face.vertices, atol=1e-9 * BODIES[name].size)


def test_face_coordinates_of_a_top_are_the_bodys_and_of_a_side_upright():
    x, y, top, *_ = BODIES["box"].faces
    np.testing.assert_array_equal(top.frame[:3, :3], np.eye(3))
    np.testing.assert_array_equal(x.frame[:3, :2].T, [[0, 1, 0], [0, 0, 1]])
    np.testing.assert_array_equal(y.frame[:3, :2].T, [[-1, 0, 0], [0, 0, 1]])


def test_face_coordinates_are_the_offsets_that_make_the_moment():
    """Offset-to-moment rule: p x e = c x e with c from the projected origin (thesis, A.3)."""
    for face in BODIES["hull"].faces:
        p, e = face.vertices[0], -face.normal
        x, y = face.coordinates(p)
        c = x * face.frame[:3, 0] + y * face.frame[:3, 1]
        np.testing.assert_allclose(np.cross(p, e), np.cross(c, e), atol=1e-12)


def test_room_is_the_distance_from_the_nearest_edge():
    plate = BODIES["plate with a hole"].faces[0]
    points = [[1.5, 0, 9], [0, 0, 1], [1.25, 1.9, 1], [3, 0, 1], [1.5, 1.5, 1]]
    np.testing.assert_allclose(plate.room(points), [0.5, -1.0, 0.1, -1.0, 0.5], atol=1e-12)
    assert plate.contains(points).tolist() == [True, False, True, False, True]
    assert plate.room_along([1.25, 0.0, 1.0], np.array([1.0, 0.0, 0.0])) == pytest.approx(0.75)
    assert plate.room_along([1.75, 0.0, 1.0], np.array([-1.0, 0.0, 0.0])) == pytest.approx(0.75)
    assert plate.room_along([1.75, 0.0, 1.0], np.array([0.0, 1.0, 0.0])) == pytest.approx(2.0)


def test_a_pinched_face_is_two_parts_that_touch():
    """An outline that visits a corner twice bounds two squares."""
    outline = [(0, 0), (1, 0), (1, 1), (2, 1), (2, 2), (1, 2), (1, 1), (0, 1)]
    face = Face([[x, y, 0.0] for x, y in outline])
    assert face.area == pytest.approx(2.0) and face.shape.area == pytest.approx(2.0)
    points = [[0.5, 0.5, 0], [1.5, 1.5, 0], [1.5, 0.5, 0], [0.5, 1.5, 0]]
    assert face.contains(points).tolist() == [True, True, False, False]
    assert not face.convex


# --- files --------------------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["stl", "obj"])
@pytest.mark.parametrize("name", BODIES)
def test_a_body_comes_back_from_its_file(tmp_path, name, ending):
    body = BODIES[name]
    body.save(tmp_path / f"body.{ending}")
    back = Polyhedron.mesh(tmp_path / f"body.{ending}", scale=1e-3)
    assert len(back.faces) == len(body.faces)
    assert sorted(len(f.holes) for f in back.faces) == sorted(len(f.holes) for f in body.faces)
    assert back.volume == pytest.approx(1e-9 * body.volume, rel=10.0 * SINGLE)
    np.testing.assert_allclose(back.centre, 1e-3 * body.centre, atol=1e-3 * SINGLE * body.size)


def test_fine_triangles_become_the_faces_they_make_up(tmp_path):
    rng = np.random.default_rng(5)
    for size, reach in ((1.0, 0.0), (1e-3, 0.2), (1e-3, 5.0), (10.0, 100.0), (0.3, 200.0)):
        fine = trimesh.creation.box(np.array([1.0, 2.0, 3.0]) * size)
        fine = fine.subdivide().subdivide().subdivide()
        fine.apply_transform(random_pose(rng, reach))
        fine.export(tmp_path / "fine.stl")
        body = Polyhedron.mesh(tmp_path / "fine.stl")
        assert [len(face.vertices) for face in body.faces] == [4] * 6


@pytest.mark.parametrize("edges", [(1.0, 1.0, 0.01), (0.012, 0.01, 0.008), (300.0, 3.0, 20.0)])
@pytest.mark.parametrize("reach", [1.0, 100.0])
def test_a_block_from_a_file_is_a_block_however_thin_and_far_away(tmp_path, edges, reach):
    """Rounding of corners turns a face by as much more as the face is narrower."""
    rng = np.random.default_rng(1)
    for _ in range(4):
        placed = Polyhedron.box(edges).placed(random_pose(rng, reach * max(edges)))
        placed.save(tmp_path / "plate.stl")
        assert classify(Polyhedron.mesh(tmp_path / "plate.stl")).kind == "block"


def test_a_sheared_block_from_a_file_is_no_block(tmp_path):
    """A shear by a thousandth is more than the rounding of a plate of 10 mm."""
    sheared = Polyhedron.hull(
        BODIES["box"].vertices * [1, 1, 0.0125] @ [[1, 0, 0], [0, 1, 0], [1e-3, 0, 1]]
    )
    sheared.placed(random_pose(np.random.default_rng(1), 1.0)).save(tmp_path / "plate.stl")
    body = Polyhedron.mesh(tmp_path / "plate.stl")
    assert classify(body).kind == "three pairs of parallel faces"


def test_a_small_boss_on_a_large_hull_of_rounded_corners_is_a_plane_face():
    rng = np.random.default_rng(2)
    small = Polyhedron.box([0.005, 0.004, 0.003]).vertices + [0.0, 0.0, 0.28]
    corners = np.vstack([Polyhedron.box([2.0, 1.0, 0.5]).vertices, small])
    for _ in range(40):
        placed = corners @ random_pose(rng, 1.0)[:3, :3].T
        body = Polyhedron.hull(placed.astype(np.float32))
        assert sum(len(face.vertices) == 4 for face in body.faces) >= 2


def test_corners_that_differ_by_rounding_are_one(tmp_path):
    """Each triangle has corners of its own, rounded in its own way to seven digits."""
    rng = np.random.default_rng(6)
    loose = BODIES["pyramid"].placed(random_pose(rng, 1.0))
    soup = loose.vertices[triangles_of(loose.faces, loose.loops)].reshape(-1, 3)
    soup += rng.uniform(-1e-7, 1e-7, soup.shape)
    numbers = np.arange(len(soup)).reshape(-1, 3)
    trimesh.Trimesh(soup, numbers, process=False).export(tmp_path / "loose.stl")
    body = Polyhedron.mesh(tmp_path / "loose.stl")
    assert len(body.vertices) == 5 and len(body.faces) == 5


def test_sheets_are_bodies_until_their_thickness_is_rounding(tmp_path):
    for thickness in (1e-5, 1e-6):
        sheet = Polyhedron.hull(Polyhedron.box([1.0, 1.0, 1e-5]).vertices)
        assert len(sheet.faces) == 6
        trimesh.creation.box([1.0, 1.0, thickness]).export(tmp_path / "sheet.stl")
        sheet = Polyhedron.mesh(tmp_path / "sheet.stl")
        assert len(sheet.faces) == 6 and sheet.volume == pytest.approx(thickness, rel=1e-2)
    trimesh.creation.box([1.0, 1e-5, 1e-5]).export(tmp_path / "wire.stl")
    assert len(Polyhedron.mesh(tmp_path / "wire.stl").faces) == 6
    for thickness in (2e-7, 1e-9):
        with refused(GraspError, "thinner than its coordinates resolve"):
            Polyhedron.hull(Polyhedron.box([1.0, 1.0, thickness]).vertices)
        trimesh.creation.box([1.0, 1.0, thickness]).export(tmp_path / "sheet.stl")
        with refused(GraspError, "thinner than its coordinates resolve"):
            Polyhedron.mesh(tmp_path / "sheet.stl")


def test_a_round_mesh_keeps_its_facets(tmp_path):
    trimesh.creation.cylinder(1.0, 2.0, sections=200).export(tmp_path / "round.stl")
    body = Polyhedron.mesh(tmp_path / "round.stl")
    assert len(body.faces) == 202
    assert max(len(face.vertices) for face in body.faces) == 200


def test_meshes_that_are_no_solids_are_refused_with_a_remedy(tmp_path):
    body, file = BODIES["plate with a hole"], tmp_path / "bad.obj"
    T = triangles_of(body.faces, body.loops)

    def refusal(triangles, vertices=body.vertices) -> str:
        trimesh.Trimesh(vertices, triangles, process=False).export(file)
        with refused(GraspError, "bad.obj") as caught:
            Polyhedron.mesh(file)
        return str(caught.value)

    alone = [tri for tri in T.tolist() if set(tri) <= {12, 13, 8, 9}][:1]
    rest = np.array([tri for tri in T.tolist() if tri not in alone])
    opened = refusal(rest)
    assert f"{3 * len(alone)} open edges" in opened and "repair" in opened
    assert "inside out" in refusal(T[:, ::-1])
    assert "run along twice in one direction: 3 edges" in refusal(np.vstack([T, T[:1]]))
    wrong = T.copy()
    wrong[0] = wrong[0, ::-1]
    assert "turned the wrong way round" in refusal(wrong)
    two = np.vstack([T, T + len(body.vertices)])
    assert "2 separate surfaces" in refusal(two, np.vstack([body.vertices, body.vertices + 9.0]))


def test_files_that_are_no_meshes_are_refused(tmp_path):
    with refused(GraspError, "no such file"):
        Polyhedron.mesh(tmp_path / "nothing.stl")
    (tmp_path / "text.stl").write_text("hello")
    with refused(GraspError, "text.stl"):
        Polyhedron.mesh(tmp_path / "text.stl")
    with refused(GraspError, "positive factor"):
        Polyhedron.mesh(tmp_path / "text.stl", scale=0.0)
    with refused(GraspError, "ends in .stl"):
        BODIES["box"].save(tmp_path / "body.nonsense")


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: Polyhedron.box([1, 2]), "edge lengths"),
        (lambda: Polyhedron.box([1, 2, 0]), "edge lengths"),
        (lambda: Polyhedron.box("abc"), "edge lengths"),
        (lambda: Polyhedron.box([1, 2, np.nan]), "edge lengths"),
        (lambda: Polyhedron.prism([(0, 0), (1, 1), (1, 0), (0, 1)], 1.0), "crosses itself"),
        (lambda: Polyhedron.prism(SQUARE, -1.0), "height of a prism"),
        (lambda: Polyhedron.prism([*SQUARE, SQUARE[0]], 1.0), "leave out the repeated corner"),
        (lambda: Polyhedron.prism([(0, 0), (1, 0)], 1.0), "three corners"),
        (lambda: Polyhedron.wedge([1, 1, 1], 1.0), "top of a wedge"),
        (lambda: Polyhedron.pyramid(SQUARE, [0, 0, 0]), "apex"),
        (lambda: Polyhedron.pyramid(SQUARE, "top"), "not 'top'"),
        (lambda: Polyhedron.hull(np.zeros((5, 3))), "no volume"),
        (lambda: Polyhedron.hull(np.eye(3)), "four or more"),
        (lambda: Polyhedron.hull([[0, 0, 0], [1]]), "rows of three finite numbers"),
        (lambda: Polyhedron.halfspaces(np.vstack([np.eye(3), -np.eye(3)]), -np.ones(6)), "inside"),
        (lambda: Polyhedron.halfspaces(np.eye(3)[[0, 1, 2, 0]], np.ones(4)), "unbounded"),
        (lambda: Polyhedron.halfspaces(np.eye(4, 3), np.ones(4)), "no normal is zero"),
        (lambda: Polyhedron(np.eye(3), [[[0, 1, 5]]]), "name corners"),
        (lambda: Polyhedron(BODIES["box"].vertices, BODIES["box"].loops[1:]), "4 open edges"),
        (
            lambda: Polyhedron(
                BODIES["box"].vertices, [[loop[::-1] for loop in f] for f in BODIES["box"].loops]
            ),
            "inward",
        ),
        (lambda: Face([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "in a line"),
        (lambda: Face([[0, 0, 0], [1, 0, 0], [1, 1, 0.1], [0, 1, 0]]), "out of one plane"),
        (lambda: Face([[0, 0], [1, 0], [1, 1]]), "three finite coordinates"),
        (
            lambda: Face([[0, 0, 0], [1, 1, 0], [1, 0, 0], [0, 1.2, 0]]).room([0, 0, 0]),
            "crosses itself",
        ),
        (lambda: Polyhedron([[0, 0], [1, 1]], [[[0, 1]]]), "shape"),
        (lambda: Polyhedron(BODIES["box"].vertices, [[3]]), "list of loops"),
        (lambda: Polyhedron(BODIES["box"].vertices, [[[0, 1, 1.7]]]), "list of loops"),
        (lambda: Polyhedron(BODIES["box"].vertices, [*BODIES["box"].loops, []]), "one loop"),
        (lambda: Polyhedron(BODIES["box"].vertices, [*BODIES["box"].loops, [[]]]), "three corners"),
        (lambda: Polyhedron(BODIES["box"].vertices, BODIES["box"].loops, ["a"]), "as many names"),
        (lambda: Polyhedron(BODIES["box"].vertices + BENT, BODIES["box"].loops), "plane"),
        (lambda: BODIES["box"].placed(np.eye(3)), "a pose has shape"),
        (lambda: BODIES["box"].placed(np.diag([1.0, 1.0, -1.0, 1.0])), "a rotation matrix"),
        (lambda: BODIES["box"].faces[0].room([0.0, 1.0]), "points are finite, of shape"),
        (lambda: BODIES["box"].faces[0].contains([0.0, 1.0, np.nan]), "points are finite"),
        (lambda: BODIES["box"].faces[0].contains("here"), "points are finite,"),
        (lambda: BODIES["box"].mass_properties(0.0), "positive number of kilograms"),
        (lambda: BODIES["box"].mass_properties("5"), "positive number of kilograms"),
        (lambda: BODIES["box"].scaled(-1.0), "positive factor"),
        (lambda: BODIES["box"].scaled("2"), "positive factor"),
        (lambda: Polyhedron.mesh("body.stl", "0.001"), "positive factor"),
        (lambda: roundness([1, 2, 3]), "Polyhedron is needed, not list"),
    ],
)
def test_numbers_that_make_no_body_are_refused(make, place):
    with refused(GraspError, place):
        make()


# --- classes ------------------------------------------------------------------------------------


def test_bodies_are_told_by_their_class():
    kinds = {name: classify(body).kind for name, body in BODIES.items()}
    assert kinds["box"] == "block"
    assert kinds["wedge"] == kinds["pyramid"] == kinds["hull"] == kinds["prism"] == "wider class"
    oblique = Polyhedron.hull(BODIES["box"].vertices @ [[1, 0, 0], [0.2, 1, 0], [0.1, 0.3, 1]])
    assert classify(oblique).kind == "three pairs of parallel faces"
    assert classify(oblique).pairs[0][0] == 0
    tetrahedron = classify(Polyhedron.hull(np.vstack([np.eye(3), np.zeros(3)])))
    assert tetrahedron.kind == "tetrahedron" and not tetrahedron.triples
    assert "+x and -x" in str(classify(BODIES["box"]))


@pytest.mark.slow
@given(st.integers(0, 10_000), st.floats(1e-3, 1e3))
@settings(deadline=None, max_examples=20)
def test_a_class_does_not_depend_on_size_and_place(seed, factor):
    rng = np.random.default_rng(seed)
    shear = np.eye(3) + 0.3 * rng.normal(size=(3, 3))
    for body in (BODIES["box"], Polyhedron.hull(BODIES["box"].vertices @ shear), BODIES["wedge"]):
        moved = body.scaled(factor).placed(random_pose(rng, 30.0 * factor))
        assert classify(moved).kind == classify(body).kind
        assert classify(moved).triples == classify(body).triples


def test_the_square_pyramid_has_the_worked_triples():
    """No two of its normals are antiparallel, and no four of them span: the class is wider."""
    worked = WORKED["A7_square_pyramid"]
    normals = worked["inputs"]["outward_normals"]
    body = Polyhedron.halfspaces(normals, [0.0, *np.ones(4)])
    np.testing.assert_allclose(body.normals, normals, atol=1e-15)
    expected = {
        tuple(map(int, key.split(","))): tuple(others)
        for key, others in worked["expected"]["triples_with_two_others"].items()
    }
    assert {t.faces: t.opposed for t in classify(body).triples} == expected


def test_half_spaces_that_are_told_twice_make_one_face():
    box = Polyhedron.box([1.0, 2.0, 3.0])
    n, h = box.normals, np.array([face.offset for face in box.faces])
    for again, times in (([0], 1.0), ([0, 0, 4], 1.0 / 3.0), ([1], 1.0 + 1e-12), (range(6), 7.0)):
        more = list(again)
        body = Polyhedron.halfspaces(
            np.vstack([n, times * n[more]]), np.concatenate([h, times * h[more]])
        )
        np.testing.assert_allclose(body.normals, n, atol=1e-15)
        assert body.volume == pytest.approx(6.0, rel=1e-12)


def test_faces_of_half_spaces_have_the_numbers_of_theirs():
    box = Polyhedron.box([1.0, 2.0, 3.0])
    h = [face.offset for face in box.faces]
    body = Polyhedron.halfspaces([[1.0, 1.0, 1.0], *box.normals], [9.0, *h])
    assert body.names == ("face 1", "face 2", "face 3", "face 4", "face 5", "face 6")


@pytest.mark.parametrize("reach", [1e4, 1e6, 1e8])
def test_half_spaces_make_the_same_body_far_from_the_origin(reach):
    box = Polyhedron.box([1.0, 2.0, 3.0]).placed(random_pose(np.random.default_rng(0), 1.0))
    away = reach * np.array([0.3, -0.5, 0.8])
    h = np.array([face.offset for face in box.faces]) + box.normals @ away
    body = Polyhedron.halfspaces(box.normals, h)
    assert body.volume == pytest.approx(6.0, rel=1e-15 * reach)


@pytest.mark.parametrize("seed", range(12))
def test_triples_are_those_of_non_negative_least_squares_and_never_missing(seed):
    """Every convex body with more than four faces is in the class (A.7); a tetrahedron is not."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(int(rng.integers(4, 9)), 3))
    normals[0] = -normals[1:].sum(axis=0)  # so that they span positively
    body = Polyhedron.halfspaces(normals, np.ones(len(normals)))
    n = body.normals
    found = {t.faces: t.opposed for t in classify(body).triples}
    for three in combinations(range(len(n)), 3):
        others = [k for k in range(len(n)) if nnls(-n[list(three)].T, n[k])[1] < 1e-9]
        assert found.get(three, ()) == (tuple(others) if len(others) >= 2 else ())
    assert bool(found) == (len(n) > 4)


@pytest.mark.slow
def test_round_bodies_are_told_from_others():
    assert roundness(round_prism(64)) and not roundness(round_prism(12))
    found = roundness(round_prism(64).placed(random_pose(np.random.default_rng(1), 5.0)))
    assert found.distance == pytest.approx(np.sin(np.pi / 64.0))
    assert not any(map(roundness, BODIES.values()))
    flat = Polyhedron.pyramid(SQUARE, [0.0, 0.0, 0.01])  # its normals are nearly along an axis
    assert not roundness(flat).nearly
    assert roundness(round_prism(24)).nearly and not roundness(round_prism(24))
    ball = trimesh.creation.icosphere(4)
    assert roundness(Polyhedron(ball.vertices, [[tri] for tri in ball.faces]))


# --- corners ------------------------------------------------------------------------------------


def test_grippers_have_corners_where_three_faces_meet_convexly():
    ell = BODIES["prism"]
    dents = [v for v in range(len(ell.vertices)) if not convex_corner(ell, v)]
    np.testing.assert_allclose(ell.vertices[dents][:, :2], [[1, 1], [1, 1]])
    pyramid = BODIES["pyramid"]
    assert not convex_corner(pyramid, 4)  # four faces meet at the apex
    assert shared_corner(pyramid, (0, 1, 4)) is not None
    assert shared_corner(pyramid, (0, 1, 2)) is None


@pytest.mark.parametrize("name", ["box", "cut wedge", "prism"])
def test_a_corner_frame_is_in_its_corner(name):
    body = BODIES[name]
    for vertex, meeting in enumerate(body.corners):
        for seat in meeting if convex_corner(body, vertex) else ():
            frame = corner_frame(body, vertex, seat)
            R = frame[:3, :3]
            np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
            assert np.linalg.det(R) == pytest.approx(1.0)
            np.testing.assert_allclose(R[:, 2], -body.normals[seat], atol=1e-12)
            along = frame[:3, 3] + 1e-3 * R[:, 0]
            assert body.faces[seat].contains(along + 1e-6 * R[:, 1])
            assert not body.faces[seat].contains(along - 1e-6 * R[:, 1])
