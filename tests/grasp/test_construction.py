"""Claims about designed grasps: they hold, open at their bound, and have fixed grippers."""

from __future__ import annotations

from functools import cache
from itertools import permutations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import WORKED
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import classify
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.assembling import (
    assembled,
    crosses,
    largest_gripper,
    proven,
    sized,
)
from multiarm.grasp.designs.blocks import BlockDesign, block_design, design_block_grasp
from multiarm.grasp.designs.construction import design_grasp
from multiarm.grasp.designs.corner_design import CornerDesign
from multiarm.grasp.designs.corner_pattern import corner_pattern
from multiarm.grasp.designs.drawn_contacts import search_grasp
from multiarm.grasp.designs.grippers import clearest_approach, hands_reach, two_groups
from multiarm.grasp.designs.parallel_bodies import (
    ParallelDesign,
    centred_corner,
    design_parallel_grasp,
    parallel_design,
)
from multiarm.grasp.designs.wide_bodies import deep_point, design_wide_grasp, wide_design
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.seventh_contact.contact_region import seventh_contact_region

TOL = 1e-9
# A bound is crossed by this part of itself: the smallest push then is some 1e-5, which a linear
# program with a tolerance of 1e-9 tells from zero.
ACROSS = 1e-3
SQUARE = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
ELL = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
BOX = Polyhedron.box([1.2, 1.0, 0.8])
WIDE = {
    "pyramid": Polyhedron.pyramid(SQUARE, [0.0, 0.0, 1.5]),
    "wedge": Polyhedron.wedge([2.0, 1.0, 1.0]),
    "cut wedge": Polyhedron.wedge([2.0, 1.0, 1.0], 0.7),
    "triangle": Polyhedron.prism([(0, 0), (2, 0), (0.7, 1.5)], 1.0),
    "hexagon": Polyhedron.prism([(2, 0), (1, 2), (-1, 2), (-2, 0), (-1, -2), (1, -2)], 2.0),
    "L": Polyhedron.prism(ELL, 1.0),
    "octahedron": Polyhedron.hull(np.vstack([np.eye(3), -np.eye(3)])),
    "hull": Polyhedron.hull(np.random.default_rng(2).normal(size=(9, 3))),
}


def closed(contacts: Contacts) -> bool:
    """By linear programming: the largest smallest push is positive (rank 6 follows for seven)."""
    W, n = contacts.scaled_wrenches, contacts.count
    found = linprog(
        np.r_[np.zeros(n), -1.0],
        A_ub=np.hstack([-np.eye(n), np.ones((n, 1))]),
        b_ub=np.zeros(n),
        A_eq=np.block([[W, np.zeros((6, 1))], [np.ones((1, n)), np.zeros((1, 1))]]),
        b_eq=np.r_[np.zeros(6), 1.0],
        bounds=[(None, None)] * (n + 1),
        options={"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9},
    )
    return found.x is not None and bool(found.x[-1] > 1e-9)


def moved_last(grasp: Grasp, point: np.ndarray) -> Contacts:
    last = Contacts.along([point], [grasp.contacts.normals[6]])
    return grasp.contacts.subset(range(6)).joined(last)


def opens_at(grasp: Grasp, beside: int, bound: float) -> bool:
    """Closed beyond the bound from a contact toward the last one, open before it."""
    start = grasp.contacts.points[beside]
    way = grasp.contacts.points[6] - start
    way /= np.linalg.norm(way)
    beyond, before = (start + (1.0 + s * ACROSS) * bound * way for s in (1.0, -1.0))
    return closed(moved_last(grasp, beyond)) and not closed(moved_last(grasp, before))


def sound(grasp: Grasp) -> bool:
    """Seven contacts inside their faces, normals inward, closed by both tests."""
    body, c = grasp.body, grasp.contacts
    inside = [body.faces[k].contains(p) for k, p in zip(grasp.faces, c.points, strict=True)]
    inward = np.allclose(c.normals, -body.normals[list(grasp.faces)], atol=1e-12)
    return len(c) == 7 and all(inside) and inward and bool(grasp.closure) and closed(c)


def patterns(grasp: Grasp) -> list[np.ndarray]:
    """Contacts of each gripper in its own frame."""
    return [
        (grasp.contacts.points[list(gripper.contacts)] - gripper.corner) @ gripper.frame[:3, :3]
        for gripper in grasp.grippers
    ]


def pose_of(seed: int, reach: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    pose[:3, 3] = np.random.default_rng(seed).uniform(-reach, reach, 3)
    return pose


def oblique(seed: int) -> Polyhedron:
    """A parallelepiped with angles between its edges from some 50 to 130 degrees."""
    rng = np.random.default_rng(seed)
    edges = np.eye(3) + 0.35 * rng.uniform(-1, 1, (3, 3))
    edges *= rng.uniform(0.6, 1.6, (3, 1))
    return Polyhedron.hull(Polyhedron.box([1, 1, 1]).vertices @ edges)


def worked_body(entry: dict) -> Polyhedron:
    n, distances = -np.array(entry["normals"]), entry["face_distances"]
    return Polyhedron.halfspaces(n, [*distances, *distances])


# --- blocks -------------------------------------------------------------------------------------


def test_block_grasp_has_the_worked_contacts():
    worked = WORKED["example_2_1"]["inputs"]
    grasp = design_block_grasp(
        2.0 * np.array(worked["half_size"]), offset=worked["A"], seventh=worked["E"]
    )
    np.testing.assert_allclose(grasp.contacts.points[:6], worked["points"], atol=TOL)
    np.testing.assert_allclose(grasp.contacts.normals[:6], worked["normals"], atol=TOL)
    assert grasp.faces == (0, 1, 2, 3, 4, 5, 2)
    assert [g.contacts for g in grasp.grippers] == [(0, 1, 2, 6), (3, 4, 5)]
    assert sound(grasp)


def test_bound_of_the_last_contact_is_the_same_for_all_sizes():
    worked = WORKED["Dx_size_independence"]
    design = block_design(worked["inputs"]["A"], worked["inputs"]["E"])
    own = None
    for half, bound in zip(worked["inputs"]["half_sizes"], worked["expected"]["Dx"], strict=True):
        assert design.minimum_distance == pytest.approx(bound, abs=TOL)
        grasp = design.grasp(2.0 * np.array(half))
        assert sound(grasp) and opens_at(grasp, 2, bound)
        own = own or patterns(grasp)
        for fixed, here in zip(own, patterns(grasp), strict=True):
            np.testing.assert_allclose(here, fixed, atol=TOL)  # the grippers are rigid


@pytest.mark.slow
@given(
    st.floats(0.01, 1.0),
    st.floats(0.05, 1.9),
    st.floats(1.05, 3.0),
    st.tuples(*[st.floats(1.05, 30.0)] * 3),
    st.integers(0, 1000),
)
@settings(deadline=None, max_examples=40)
def test_the_grippers_hold_every_block_above_the_smallest(A, ratio, beyond, factors, seed):
    assume(abs(ratio - 1.0) > 0.05)
    E = ratio * A
    distance = beyond * 2.0 * abs(A - E)
    assume(A > E or distance < 0.99 * E)
    design = block_design(A, E, distance)
    lengths = design.smallest * factors
    grasp = design.grasp(Polyhedron.box(lengths).placed(pose_of(seed, 10.0 * A)))
    assert design.fits(lengths) and bool(grasp.closure)
    at = zip(grasp.faces, grasp.contacts.points, strict=True)
    assert min(grasp.body.faces[k].room(p) for k, p in at) > 0.0
    assert largest_gripper(grasp) == pytest.approx(design.gripper_size)
    for axis in range(3):
        short = lengths.copy()
        short[axis] = 0.999 * design.smallest[axis]
        assert not design.fits(short)
        with pytest.raises(GraspError, match=f"edge {'xyz'[axis]} is"):
            design.grasp(short)


def test_what_holds_by_less_than_rounding_is_refused():
    with refused(GraspError, "hangs on rounding"):
        block_design(1.0, 0.5, 1.0 + 1e-10).grasp([10.0, 10.0, 10.0])
    holds = design_block_grasp([1.0, 1.0, 1.0])
    assert proven(holds, True) is holds
    with refused(GraspError, "hangs on rounding: choose others"):
        proven(holds, False, "choose others")


def test_a_small_gripper_holds_a_block_a_thousand_times_its_size():
    for offset in (0.1, 1e-4):
        grasp = design_block_grasp(np.array([1000.0, 800.0, 1200.0]) * offset, offset=offset)
        assert largest_gripper(grasp) < 3.0 * offset
        assert grasp.closure


@pytest.mark.parametrize("faces", [(0, 1, 2), (1, 0, 2), (3, 4, 2), (5, 1, 0)])
def test_a_block_is_the_square_case_of_parallel_faces(faces):
    """p_x = -(l_x - A)(l_z - A), p_y = -(l_y - A)(l_z - A), Q = A - E, with either handedness."""
    A, E = 0.12, 0.05
    opposite = tuple((face + 3) % 6 for face in faces)
    l_x, l_y, l_z = 0.5 * np.array([1.2, 1.0, 0.8])[np.mod(faces, 3)]
    depths = [[A, A, A], [A, A, A], [E, A, A]]
    pattern = centred_corner(BOX, faces, opposite).at_depths(depths)
    expected = np.array([-(l_x - A), -(l_y - A)]) * (l_z - A)
    np.testing.assert_allclose(pattern.direction * [1.0, np.cos(pattern.beta)], expected, atol=TOL)
    assert pattern.reach == pytest.approx(A - E, abs=TOL)
    as_parallel = CornerDesign(BOX, faces, opposite, pattern, 0.2)
    assert block_design(A, E).minimum_distance == pytest.approx(as_parallel.minimum_distance)
    designed = design_block_grasp(BOX, offset=A, seventh=E, distance=0.2, faces=faces)
    np.testing.assert_array_equal(designed.contacts.points, as_parallel.grasp().contacts.points)
    np.testing.assert_allclose(pattern.points, designed.contacts.points[:3], atol=TOL)


@pytest.mark.slow
def test_any_corner_and_order_of_faces_holds_a_block():
    for corner in ((0, 1, 2), (3, 1, 2), (0, 4, 5), (3, 4, 5)):
        for faces in permutations(corner):
            grasp = design_block_grasp([1.2, 1.0, 0.8], faces=faces)
            assert grasp.faces[:3] == faces and sound(grasp)
            assert opens_at(grasp, 2, block_design(0.12).minimum_distance)


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: block_design(0.1, 0.1), "both 0.1 m"),
        (lambda: block_design(0.1, 0.05, 0.1), "closed only beyond"),
        (lambda: block_design(0.1, 0.15, 0.15), "lies toward the edge"),
        (lambda: block_design(0.1, 0.25), "contact 7"),
        (lambda: block_design(-0.1), "are positive"),
        (lambda: block_design(0.1, 0.05, np.nan), "distance is a finite length"),
        (lambda: design_block_grasp(WIDE["wedge"]), "construction for blocks needs one"),
        (lambda: design_block_grasp([1, 1, 1], faces=(0, 1, 3)), "do not meet at a corner"),
        (lambda: design_block_grasp([1, 1, 1], offset=0.6), "edge x is 1 m, more than 1.5 m"),
    ],
)
def test_blocks_and_lengths_that_do_not_go_together_are_refused(make, place):
    with refused(GraspError, place):
        make()


def test_a_gripper_size_that_no_depth_leads_to_is_refused():
    grasp = design_block_grasp([1.0, 1.0, 1.0])
    with refused(GraspError, "grippers of 2 m"):
        sized(lambda _depth: grasp, 0.1, 2.0)


# --- three pairs of parallel faces --------------------------------------------------------------


@pytest.mark.parametrize("name", ["example_2_3", "example_2_3_b"])
def test_parallel_design_has_the_worked_numbers(name):
    inputs, expected = WORKED[name]["inputs"], WORKED[name]["expected"]
    offsets = tuple(inputs[key] for key in ("E", "F", "G1", "G2"))
    design = parallel_design(worked_body(expected), (0, 1, 2), (3, 4, 5), offsets)
    p = design.pattern
    angles = np.rad2deg([p.theta, p.beta, p.gamma])
    np.testing.assert_allclose(angles, inputs["theta_beta_gamma_deg"], atol=1e-7)
    np.testing.assert_allclose(p.corner, inputs["corner"], atol=TOL)
    np.testing.assert_allclose(p.direction, [expected["px"], expected["py"]], atol=TOL)
    in_face = np.ravel(p.in_face_offsets)
    np.testing.assert_allclose(in_face, [expected[k] for k in "abcd"], atol=TOL)
    np.testing.assert_allclose([p.e, p.f, *p.g], [expected[k] for k in ("e", "f", "g1", "g2")])
    assert p.reach == pytest.approx(expected["Q"], abs=TOL)
    assert design.minimum_distance == pytest.approx(expected["Dx_min"], abs=TOL)
    grasp = design.grasp()
    np.testing.assert_allclose(grasp.contacts.points[:6], expected["points"], atol=TOL)
    assert sound(grasp) and opens_at(grasp, 2, expected["Dx_min"])
    away = grasp.contacts.points[6] - grasp.contacts.points[2]
    assert np.sign(away[0]) == np.sign(expected["edge_x_minus_e"]) and abs(away[1]) < TOL
    for factor, verdict in ((1.02, True), (0.98, False), (0.75, False)):
        point = p.last_point(factor * expected["Dx_min"])
        assert closed(moved_last(grasp, point)) == verdict


def test_block_is_the_case_of_zero_angles():
    """p_x = -b c, p_y = -a d, and the half-plane of Example 2.1 ends at the same place."""
    body = Polyhedron.box([1.2, 1.0, 0.8])
    design = parallel_design(body, (0, 1, 2), (3, 4, 5), (0.15, 0.1, 0.17, 0.12))
    (a, b), (c, d) = design.pattern.in_face_offsets
    np.testing.assert_allclose(design.pattern.direction, [-b * c, -a * d], atol=TOL)
    grasp = design.grasp()
    region = seventh_contact_region(grasp.contacts.subset(range(6)), body.faces[2])
    assert region.depth(design.pattern.last_point(design.minimum_distance)) == pytest.approx(0.0)


@pytest.mark.parametrize("seed", range(4))
def test_the_same_grippers_hold_higher_bodies_and_no_lower_ones(seed):
    """Angles, Lx and Ly stay; only the height of the corner over the centre changes."""
    rng = np.random.default_rng(seed)
    worked = WORKED["example_2_3"]
    n = -np.array(worked["expected"]["normals"])[:3]
    offsets = (0.2, 0.3, 0.3 - 0.05 * rng.random(), 0.15)
    L = np.array(worked["inputs"]["corner"]) * [1.0, 1.0 + 0.2 * rng.random(), 1.0]

    def design(height: float, distance: float | None) -> ParallelDesign:
        h = n @ [L[0], L[1], height]
        body = Polyhedron.halfspaces(np.vstack([n, -n]), [*h, *h])
        return parallel_design(body, (0, 1, 2), (3, 4, 5), offsets, distance)

    first = design(L[2], None)
    limit = first.smallest_height
    assert limit < L[2]
    for height, holds in ((limit * 1.001, True), (limit * 0.999, False), (3.0 * L[2], True)):
        other = design(height, first.distance)
        contacts = Contacts.along(
            np.vstack(
                [
                    other.pattern.points,
                    -other.pattern.points,
                    other.pattern.last_point(first.distance),
                ]
            ),
            np.vstack([-n, n, -n[2:]]),
        )
        assert (other.minimum_distance < first.distance) == holds
        assert closed(contacts) == holds
    for fixed, here in zip(
        patterns(first.grasp()), patterns(design(1.2 * L[2], first.distance).grasp()), strict=True
    ):
        np.testing.assert_allclose(here, fixed, atol=TOL)


@pytest.mark.slow
@given(st.integers(0, 100_000), st.floats(1e-3, 1e2), st.floats(0.0, 100.0))
@settings(deadline=None, max_examples=10)
def test_every_parallelepiped_is_held_of_any_size_anywhere(seed, factor, reach):
    body = oblique(seed)
    moved = body.scaled(factor).placed(pose_of(seed, reach * factor))
    grasp = design_grasp(moved)
    assert sound(grasp)
    assert classify(body).kind in str(grasp.notes[-1])
    assert grasp.closure.distance == pytest.approx(design_grasp(body).closure.distance, rel=1e-6)
    bound = float(grasp.notes[0].split("= ")[1].split(" m")[0])
    assert opens_at(grasp, 2, bound)


@pytest.mark.slow
def test_gripper_size_is_what_was_asked_for():
    for body in (oblique(3), Polyhedron.box([1.2, 1.0, 0.8]), WIDE["hexagon"]):
        for size in (0.2, 0.02):
            grasp = design_grasp(body, gripper_size=size)
            assert largest_gripper(grasp) == pytest.approx(size, rel=1e-5)
            assert sound(grasp)


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: design_parallel_grasp(WIDE["wedge"]), "three pairs of parallel faces are needed"),
        (lambda: design_parallel_grasp(oblique(1), faces=(0, 1, 3)), "faces (0, 1, 3)"),
        (lambda: design_parallel_grasp(oblique(1), gripper_size=5.0), "too large for the object"),
        (lambda: design_parallel_grasp(oblique(1), gripper_size=-1.0), "positive length"),
        (lambda: design_parallel_grasp(oblique(1), offsets=(0.1, 0.1, 0.1, 0.1)), "one point"),
        (lambda: design_parallel_grasp(oblique(1), distance=1e-4), "closed only beyond"),
    ],
)
def test_parallelepipeds_and_lengths_that_do_not_go_together_are_refused(make, place):
    with refused(GraspError, place):
        make()


def test_left_handed_faces_are_refused():
    with refused(GraspError, "exchange front and side"):
        parallel_design(BOX, (1, 0, 2), (4, 3, 5), (0.1, 0.1, 0.2, 0.1))


# --- the wider class ----------------------------------------------------------------------------


def test_bound_of_the_wider_class_is_the_worked_one():
    """Three normals meet in the origin: the region begins |Q| from contact 6, and not 2 |Q|."""
    worked = WORKED["class_2_2_3_3"]
    six = Contacts(worked["inputs"]["points"], worked["inputs"]["normals"])
    z, f = worked["inputs"]["z7"], worked["inputs"]["y7"]
    top = [[x, y, z] for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))]
    region = seventh_contact_region(six, top)
    e = worked["inputs"]["points"][5][0]
    edge = np.array([e + worked["expected"]["edge_x_minus_e"], f, z])
    assert region.depth(edge) == pytest.approx(0.0, abs=TOL)
    assert region.contains(edge - [1e-6, 0, 0]) and not region.contains(edge + [1e-6, 0, 0])
    n = -six.normals[3:]
    levels = np.sum(n * six.points[3:], axis=1)
    inputs = WORKED["example_2_3"]["inputs"]
    lengths = [inputs[key] for key in ("E", "F", "G1", "G2")]
    pattern = corner_pattern(n, levels, np.zeros(3)).stepped(*lengths)
    assert -abs(pattern.reach) == pytest.approx(worked["expected"]["edge_x_minus_e"], abs=TOL)
    np.testing.assert_allclose(pattern.points, six.points[3:], atol=TOL)


@pytest.mark.parametrize("name", WIDE)
def test_bodies_of_the_wider_class_are_held(name):
    grasp = design_wide_grasp(WIDE[name])
    assert sound(grasp)
    groups, designed = [g.contacts for g in grasp.grippers], [(0, 1, 2), (3, 4, 5, 6)]
    assert hands_reach(grasp.contacts.normals, groups)
    assert groups == designed or not hands_reach(grasp.contacts.normals, designed)
    assert grasp.faces[5] == grasp.faces[6] and len(set(grasp.faces[:3])) == 3
    opposed = next(t for t in classify(WIDE[name]).triples if t.faces == grasp.faces[:3]).opposed
    assert set(grasp.faces[3:]) <= set(opposed)
    n, p = grasp.contacts.normals[:3], grasp.contacts.points[:3]
    meet = np.linalg.lstsq(
        np.vstack([np.eye(3) - np.outer(e, e) for e in n]),
        np.concatenate([x - e * (e @ x) for e, x in zip(n, p, strict=True)]),
    )
    residual = np.linalg.norm(np.cross(p - meet[0], n))
    assert residual < 1e-9 * WIDE[name].size  # the three normal lines meet in one point


def test_progress_of_a_design_goes_through_the_triples_of_faces():
    told = []
    design_grasp(WIDE["hull"], progress=lambda *news: told.append(news))
    corners, places = (
        [news for news in told if where in news[2]] for where in ("corners", "places")
    )
    for stage in (corners, places):
        assert [done for done, _, _ in stage] == list(range(stage[0][1]))
    assert told == corners + places


@pytest.mark.parametrize("name", ["cut wedge", "hexagon", "L"])
def test_wide_designs_open_at_their_bound(name):
    body = WIDE[name]
    grasp = design_wide_grasp(body)
    assert opens_at(grasp, 5, float(grasp.notes[0].split("|Q| = ")[1].split(" m")[0]))
    design = wide_design(body, grasp.faces[:3], grasp.faces[3:6], 0.1, 0.05)
    if design.pattern.obstacle is None:
        assert opens_at(design.grasp(), 5, design.minimum_distance)


@pytest.mark.parametrize("name", ["pyramid", "wedge", "octahedron"])
def test_wide_designs_with_a_region_open_at_its_border(name):
    grasp = design_wide_grasp(WIDE[name])
    region = seventh_contact_region(
        grasp.contacts.subset(range(6)), grasp.body.faces[grasp.faces[6]]
    )
    depth = float(region.depth(grasp.contacts.points[6]))
    assert depth > 0.05 * np.sqrt(region.area)
    last = grasp.contacts.points[6]
    for x, y, level in region.half_planes:
        outward = region.face.frame[:3, :2] @ [x, y]
        room = level - region.face.coordinates(last) @ [x, y]
        assert closed(moved_last(grasp, last + (1.0 - ACROSS) * depth * outward))
        assert not closed(moved_last(grasp, last + (1.0 + ACROSS) * room * outward))


@pytest.mark.slow
@given(st.integers(0, 100_000), st.floats(1e-3, 1e2))
@settings(deadline=None, max_examples=8)
def test_every_hull_is_held_of_any_size_anywhere(seed, factor):
    rng = np.random.default_rng(seed)
    body = Polyhedron.hull(rng.normal(size=(int(rng.integers(4, 8)), 3)))
    moved = body.scaled(factor).placed(pose_of(seed, 10.0 * factor))
    grasp = design_grasp(moved)
    assert sound(grasp)


def test_wider_construction_refuses_what_is_not_of_the_class():
    tetrahedron = Polyhedron.hull(np.vstack([np.eye(3), np.zeros(3)]))
    with refused(GraspError, "does not fit: a tetrahedron"):
        design_wide_grasp(tetrahedron)
    with refused(GraspError, "class with grippers of 0"):
        design_wide_grasp(WIDE["octahedron"], gripper_size=0.01)


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (3, 0), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)],
        [
            ((1 + k % 2) * np.cos(k * np.pi / 5), (1 + k % 2) * np.sin(k * np.pi / 5))
            for k in range(10)
        ],
    ],
    ids=["U", "star"],
)
def test_bodies_that_are_not_convex_are_held(outline):
    grasp = design_grasp(Polyhedron.prism(outline, 1.0))
    assert not grasp.body.convex and sound(grasp)


@pytest.mark.slow
def test_a_body_from_a_file_is_held_although_its_corners_are_rounded(tmp_path):
    WIDE["hexagon"].placed(pose_of(3, 1.0)).save(tmp_path / "body.stl")
    body = Polyhedron.mesh(tmp_path / "body.stl", scale=1e-3)
    for grasp in (design_grasp(body), search_grasp(body)):
        assert sound(grasp)


@pytest.mark.parametrize("shear", [0.0, 0.3])
def test_a_block_from_a_file_is_a_block(tmp_path, shear):
    made = Polyhedron.hull(
        Polyhedron.box([1.2, 1.0, 0.8]).vertices @ [[1, shear, 0], [0, 1, 0], [0, 0, 1]]
    )
    for seed in range(5):
        made.placed(pose_of(seed, 0.5)).save(tmp_path / "block.stl")
        body = Polyhedron.mesh(tmp_path / "block.stl")
        assert classify(body).kind == classify(made).kind != "wider class"
        assert sound(design_grasp(body))


def test_the_deepest_point_of_three_faces_grows_with_the_body():
    for triple in classify(WIDE["hull"]).triples[:10]:
        deepest = deep_point(WIDE["hull"], triple.faces)
        for factor in (1e-6, 1e6):
            scaled = deep_point(WIDE["hull"].scaled(factor), triple.faces)
            assert (deepest is None) == (scaled is None)
            if deepest is not None:
                np.testing.assert_allclose(scaled, factor * deepest, atol=TOL * factor)


BODIES = {**WIDE, "box": BOX, "oblique": oblique(3), "tetrahedron": Polyhedron.hull(np.eye(4, 3))}


@cache
def design_of(name: str) -> Grasp:
    """The grasp of a body where it is, with which those of the moved one are compared."""
    return design_grasp(BODIES[name])


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("factor", [1e-5, 300.0])
def test_the_design_of_a_moved_body_is_the_moved_design(name, factor):
    """design(s R x + p) = s R design(x) + p, of microns and of hundreds of metres, far away."""
    body, pose = BODIES[name], pose_of(4, 100.0 * factor)
    grasp, moved = design_of(name), design_grasp(body.scaled(factor).placed(pose))
    assert moved.closure.distance == pytest.approx(grasp.closure.distance, rel=1e-6)
    if name not in ("cut wedge", "hull", "box", "oblique", "tetrahedron"):
        return  # symmetry leaves equal designs to choose from
    assert moved.faces == grasp.faces
    expected = factor * grasp.contacts.points @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(moved.contacts.points, expected, atol=1e-6 * factor * body.size)


@pytest.mark.parametrize("name", ["cut wedge", "hexagon", "L", "octahedron", "box", "oblique"])
@pytest.mark.parametrize(("factor", "reach"), [(300.0, 1.0), (1.0, 50.0)])
def test_the_design_of_a_body_from_a_file_is_that_of_the_body(tmp_path, name, factor, reach):
    body = BODIES[name]
    body.scaled(factor).placed(pose_of(4, reach * factor)).save(tmp_path / "body.stl")
    grasp, moved = design_of(name), design_grasp(Polyhedron.mesh(tmp_path / "body.stl"))
    assert classify(moved.body).kind == classify(body).kind
    assert sound(moved)
    assert len(moved.notes) == len(grasp.notes)  # by the same construction


# --- searching and choosing ---------------------------------------------------------------------


@pytest.mark.slow
def test_a_tetrahedron_is_held_by_seven_contacts_that_are_searched():
    for seed in range(4):
        corners = np.random.default_rng(seed).normal(size=(4, 3))
        grasp = design_grasp(Polyhedron.hull(corners))
        assert sound(grasp) and set(grasp.faces) == {0, 1, 2, 3}
        assert "found by search" in grasp.notes[0] and "tetrahedron" in grasp.notes[1]


@pytest.mark.slow
def test_a_search_is_the_same_with_the_same_generator():
    body = Polyhedron.hull(np.vstack([np.eye(3), np.zeros(3)]))
    first, again, other = (search_grasp(body, np.random.default_rng(s)) for s in (5, 5, 6))
    np.testing.assert_array_equal(first.contacts.points, again.contacts.points)
    assert not np.allclose(first.contacts.points, other.contacts.points)


def test_the_two_groups_of_a_search_are_the_most_compact():
    rng = np.random.default_rng(0)
    near = rng.normal(size=(4, 3)) * 0.1
    points = np.vstack([near[:2], [9, 0, 0] + near[2:], near[:1] + 0.05])
    first, second = two_groups(Contacts.along(points, np.ones((5, 3))))
    assert (first, second) == ((0, 1, 4), (2, 3))


def test_compact_groups_that_no_hand_reaches_are_passed_over():
    """Two pairs on opposite faces of a plate: each hand takes one face."""
    points = [[0, 0, 0.1], [0, 0, -0.1], [9, 0, 0.1], [9, 0, -0.1]]
    opposite = [[0, 0, -1], [0, 0, 1], [0, 0, -1], [0, 0, 1]]
    assert two_groups(Contacts(points, [[0, 0, 1]] * 4)) == ((2, 3), (0, 1))
    assert two_groups(Contacts(points, opposite)) == ((1, 3), (0, 2))


def test_two_hands_reach_any_seven_contacts_from_one_side_each(rng):
    for _ in range(30):
        contacts = Contacts.along(rng.normal(size=(7, 3)), rng.normal(size=(7, 3)))
        for group in two_groups(contacts):
            inward = contacts.normals[list(group)]
            direction, clearance = clearest_approach(inward)
            assert clearance >= (1.0 - 1e-9) / 7.0
            assert np.min(inward @ direction) == pytest.approx(clearance)


def test_the_clearest_approach_is_not_beaten_by_any_other(rng):
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reached = 0
    for count in (1, 2, 3, 6):
        for _ in range(10):
            inward = rng.normal(size=(count, 3)) + [0.0, 0.0, 0.3]
            inward /= np.linalg.norm(inward, axis=1, keepdims=True)
            best = float(np.max(np.min(directions @ inward.T, axis=1)))
            clearance = clearest_approach(inward)[1]
            assert max(best, 0.0) <= clearance + 1e-12 and clearance <= max(best, 0.0) + 0.1
            reached += clearance > 0.0
    assert 10 < reached < 40


@pytest.mark.slow
def test_a_search_improves_what_it_draws():
    """The regular tetrahedron is held more firmly than by the best of the draws."""
    corners = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], dtype=float)
    for seed, drawn in ((0, 0.052), (1, 0.080), (2, 0.048)):
        grasp = search_grasp(Polyhedron.hull(corners), np.random.default_rng(seed))
        assert grasp.closure.distance > 1.1 * drawn


def test_a_wrong_bound_is_seen_by_stepping_across_it():
    grasp = design_block_grasp([1.2, 1.0, 0.8], offset=0.1, seventh=0.05)

    def point_at(distance: float) -> np.ndarray:
        return grasp.contacts.points[2] - [distance, 0.0, 0.0]

    assert crosses(grasp, point_at, 0.1)
    assert not crosses(grasp, point_at, 0.05) and not crosses(grasp, point_at, 0.15)


def test_contacts_beside_their_faces_are_refused():
    grasp = design_block_grasp([1.2, 1.0, 0.8])
    frames = [gripper.frame for gripper in grasp.grippers]
    points = grasp.contacts.points.copy()
    points[1, 0] = 0.75
    with refused(GraspError, "contact 2 would be 0.15 m outside +y"):
        assembled(grasp.body, points, grasp.faces, [(0, 1, 2, 6), (3, 4, 5)], frames)


def test_design_takes_the_construction_of_the_class():
    block = design_grasp(Polyhedron.box([1.2, 1.0, 0.8]), offset=0.1, seventh=0.05)
    np.testing.assert_allclose(
        block.contacts.points[:6], WORKED["example_2_1"]["inputs"]["points"], atol=TOL
    )
    assert "2 |A - E|" in block.notes[0] and "a block" in block.notes[-1]
    assert "2 |Q|" in design_grasp(oblique(0)).notes[0]
    assert "|Q| =" in design_grasp(WIDE["hexagon"]).notes[0]
    assert "share a face" in design_grasp(WIDE["pyramid"]).notes[0]


@pytest.mark.slow
def test_a_body_that_may_be_a_round_one_is_held_with_a_word_about_it():
    angles = 2.0 * np.pi * np.arange(20) / 20
    body = Polyhedron.prism(np.column_stack([np.cos(angles), np.sin(angles)]), 2.0)
    grasp = design_grasp(body)
    assert sound(grasp)
    assert any("nearly one of revolution" in note for note in grasp.notes)


@pytest.mark.parametrize("sides", [64, 200])
def test_bodies_of_revolution_are_refused_for_what_they_stand_for(sides):
    angles = 2.0 * np.pi * np.arange(sides) / sides
    body = Polyhedron.prism(np.column_stack([np.cos(angles), np.sin(angles)]), 2.0)
    with refused(GraspError, "one of revolution about the axis"):
        design_grasp(body.placed(pose_of(1, 3.0)))


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (lambda: design_grasp(WIDE["wedge"], offset=0.1), "construction for blocks"),
        (lambda: design_grasp([1, 2, 3]), "Polyhedron is needed, not list"),
        (
            lambda: design_grasp(Polyhedron.box([1, 1, 1]), offset=0.1, gripper_size=0.2),
            "not both",
        ),
        (lambda: design_grasp(Polyhedron.box([1, 1, 1]), gripper_size=3.0), "too large"),
        (lambda: design_grasp(Polyhedron.box([1, 1, 1]), gripper_size=0.0), "positive length"),
        (lambda: design_grasp(WIDE["octahedron"], gripper_size=0.01), "smallest grippers found"),
    ],
)
def test_questions_without_a_grasp_are_refused(make, place):
    with refused(GraspError, place):
        make()


@pytest.mark.parametrize(
    ("make", "place"),
    [
        (
            lambda: design_parallel_grasp(WIDE["wedge"].vertices),
            "Polyhedron is needed, not ndarray",
        ),
        (lambda: design_parallel_grasp(BOX, offsets=(0.1, 0.1, 0.1)), "four lengths E, F, G1, G2"),
        (lambda: design_parallel_grasp(BOX, offsets=0.1), "four lengths E, F, G1, G2"),
        (lambda: design_parallel_grasp(BOX, offsets=(0.1, 0.1, "a", 0.1)), "'a'"),
        (lambda: design_parallel_grasp(BOX, distance="a"), "finite length in metres, not 'a'"),
        (lambda: design_parallel_grasp(BOX, gripper_size="a"), "finite length in metres, not 'a'"),
        (lambda: design_block_grasp(BOX, offset="a"), "the offset is a finite length"),
        (lambda: design_block_grasp(BOX, seventh="a"), "the seventh offset is a finite length"),
        (lambda: design_block_grasp(BOX, distance="a"), "the distance is a finite length"),
        (lambda: BlockDesign("a", 0.1, 0.1), "the offset is a finite length"),
        (lambda: design_grasp(BOX, gripper_size="a"), "size of a gripper is a finite length"),
        (lambda: design_grasp(BOX, gripper_size=[0.1]), "size of a gripper is a finite length"),
        (lambda: design_grasp(BOX, offset="a"), "the offset is a finite length"),
        (lambda: design_wide_grasp(WIDE["wedge"], gripper_size="a"), "size of a gripper is"),
        (lambda: design_grasp([1, 1, 1]), "Polyhedron is needed, not list"),
    ],
)
def test_lengths_that_are_none_are_refused_in_words(make, place):
    with refused(GraspError, place):
        make()


def test_offsets_may_be_an_array():
    offsets = (0.15, 0.1, 0.17, 0.12)
    made = [design_parallel_grasp(BOX, offsets=given) for given in (offsets, np.array(offsets))]
    assert np.array_equal(made[0].contacts.points, made[1].contacts.points)
