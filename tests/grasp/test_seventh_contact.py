"""Claims about the region of the last contact: it is where linear programming finds closure."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from refusals import refused
from repository import WORKED
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from multiarm.errors import GraspError
from multiarm.grasp.body.face import Face
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.seventh_contact.contact_region import (
    ContactRegion,
    region_of,
    seventh_contact_region,
)
from multiarm.grasp.seventh_contact.moment_route import basic_solutions, circuits
from multiarm.grasp.seventh_contact.wrench_cones import (
    closes_on_surface,
    is_independent,
    wrench_cone,
)

METHODS = ("inverse", "moments")
BLOCK = WORKED["example_2_1"]
SIX = Contacts(BLOCK["inputs"]["points"], BLOCK["inputs"]["normals"])
BOX = Polyhedron.box(2.0 * np.array(BLOCK["inputs"]["half_size"]))
TOP = BOX.faces[2]
TOL = BLOCK["tol"]
# A linear program is right where the smallest push (of sum 1) is farther from zero than the
# tolerance of its solver, 1e-7; points this close to the border, in face sizes, are left out.
UNDECIDED, BORDER = 1e-6, 1e-6
ELL = [(-1, -1), (2, -1), (2, 0), (0, 0), (0, 2), (-1, 2)]


def smallest_push(contacts: Contacts) -> float:
    """t* of the linear program: maximise t with W lam = 0, sum lam = 1, lam >= t."""
    W = contacts.scaled_wrenches
    n = contacts.count
    found = linprog(
        np.r_[np.zeros(n), -1.0],
        A_ub=np.hstack([-np.eye(n), np.ones((n, 1))]),
        b_ub=np.zeros(n),
        A_eq=np.block([[W, np.zeros((6, 1))], [np.ones((1, n)), np.zeros((1, 1))]]),
        b_eq=np.r_[np.zeros(6), 1.0],
        bounds=[(None, None)] * (n + 1),
    )
    return -np.inf if found.x is None else float(found.x[-1])


def with_last(contacts: Contacts, face: Face, point: np.ndarray) -> Contacts:
    return contacts.joined(Contacts.along([point], [-face.normal]))


def points_on(face: Face, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points drawn evenly from a face."""
    low, high = face.outline.min(axis=0), face.outline.max(axis=0)
    found = np.empty((0, 3))
    while len(found) < count:
        drawn = face.at(rng.uniform(low, high, (8 * count, 2)))
        found = np.vstack([found, drawn[face.contains(drawn)]])
    return found[:count]


def random_contacts(body: Polyhedron, count: int, rng: np.random.Generator) -> Contacts:
    numbers = rng.integers(0, len(body.faces), count)
    points = [points_on(body.faces[k], 1, rng)[0] for k in numbers]
    return Contacts.along(points, -body.normals[numbers])


def closable(body: Polyhedron, count: int, rng: np.random.Generator) -> Contacts:
    """Contacts of rank 6 to which some face has a region, if any of a few draws is such."""
    for _ in range(8):
        contacts = random_contacts(body, count, rng)
        if is_independent(contacts) and any(
            seventh_contact_region(contacts, f) for f in body.faces
        ):
            return contacts
    while not is_independent(contacts):
        contacts = random_contacts(body, count, rng)
    return contacts


def same_region(a: ContactRegion, b: ContactRegion, tol: float) -> bool:
    return bool(a) == bool(b) and a.shape.symmetric_difference(b.shape).area <= tol * a.face.area


def bodies() -> list[Polyhedron]:
    rng = np.random.default_rng(11)
    hulls = [Polyhedron.hull(rng.normal(size=(n, 3))) for n in (4, 5, 6, 8)]
    return [*hulls, BOX, Polyhedron.prism(ELL, 1.5), Polyhedron.wedge([2.0, 1.0, 1.0])]


# --- the worked block ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_region_on_the_block_is_the_worked_polygon(method):
    region, expected = seventh_contact_region(SIX, TOP, method), BLOCK["expected"]
    assert region.area == pytest.approx(expected["region_area"], abs=TOL)
    worked = np.array(expected["region_vertices"])
    assert region.vertices.shape == (4, 3)
    np.testing.assert_allclose(region.vertices[:, 2], BLOCK["inputs"]["z7"], atol=TOL)
    start = int(np.argmin(np.abs(worked - region.vertices[0, :2]).sum(axis=1)))
    np.testing.assert_allclose(region.vertices[:, :2], np.roll(worked, -start, axis=0), atol=TOL)


@pytest.mark.parametrize("method", METHODS)
def test_half_planes_of_the_block_are_the_worked_lines(method):
    region, expected = seventh_contact_region(SIX, TOP, method), BLOCK["expected"]
    for line in ("line1", "line2"):
        row = np.array([*expected[line]["coef"], expected[line]["rhs"]])
        row /= np.linalg.norm(row[:2])
        assert min(np.abs(region.half_planes - row).max(axis=1)) < TOL


def test_samples_of_the_block_have_the_worked_pushes_and_verdicts():
    region = seventh_contact_region(SIX, TOP)
    for sample in BLOCK["expected"]["samples"]:
        point = [*sample["xy"], BLOCK["inputs"]["z7"]]
        np.testing.assert_allclose(region.coefficients(point), sample["W6inv_w7"], atol=TOL)
        assert bool(region.contains(point)) == sample["form_closure"]


def test_moments_of_the_block_have_the_worked_generators():
    e, m = SIX.wrenches[:3], SIX.wrenches[3:]
    B = basic_solutions(e, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(B @ m.T, [BLOCK["expected"]["b1"]], atol=TOL)
    C = circuits(e)
    rays = np.array(BLOCK["expected"]["c_rays"])
    assert len(C) == 3
    for ray in rays:  # of a pair of opposed contacts: twice the moment of one
        assert min(np.abs(C @ m.T - 2.0 * ray).max(axis=1)) < TOL


def test_border_of_the_block_is_found_by_fractions_to_be_outside():
    """On the line y = f the region ends at x = 9/20 exactly, and 9/20 itself is not in it."""
    thirds = [(Fraction(6, 10), Fraction(4, 10), Fraction(3, 10))]
    thirds += [(Fraction(5, 10), Fraction(5, 10), Fraction(3, 10))]
    thirds += [(Fraction(55, 100), Fraction(4, 10), Fraction(4, 10))]
    points = thirds + [tuple(-x for x in p) for p in thirds]
    normals = [tuple(Fraction(int(x)) for x in n) for n in SIX.normals]
    end = Fraction(BLOCK["expected"]["boundary_x_on_y_eq_f"]).limit_denominator(1000)
    for x, closed in ((end - Fraction(1, 10**9), True), (end, False)):
        seven = Contacts([*points, (x, Fraction(4, 10), Fraction(4, 10))], [*normals, normals[2]])
        assert is_form_closure(seven, exact=True).closed == closed


# --- linear programs ----------------------------------------------------------------------------


@pytest.mark.parametrize("count", [6, 7, 8, 9])
def test_region_is_what_the_linear_program_accepts(count):
    rng = np.random.default_rng(count)
    decided = {True: 0, False: 0}
    for body in bodies():
        contacts = closable(body, count, rng)
        for face in body.faces:
            region = seventh_contact_region(contacts, face)
            points = points_on(face, 3, rng)
            if region:
                points = np.vstack([points, region.best_point()])
            for point in points:
                away = abs(float(region.depth(point)))
                push = smallest_push(with_last(contacts, face, point))
                if away > BORDER * np.sqrt(face.area) and abs(push) > UNDECIDED:
                    assert bool(region.contains(point)) == (push > 0.0)
                    decided[push > 0.0] += 1
    assert decided[True] >= 10 and decided[False] >= 40


@pytest.mark.parametrize("count", [6, 7, 8, 9])
def test_both_routes_give_the_same_region(count):
    rng = np.random.default_rng(100 + count)
    found = 0
    for body in bodies() if count < 9 else bodies()[::2]:
        for _ in range(2 if count < 8 else 1):
            contacts = closable(body, count, rng)
            for face in body.faces:
                one, other = (seventh_contact_region(contacts, face, m) for m in METHODS)
                assert same_region(one, other, 1e-7)
                found += bool(one)
    assert found >= 8


@pytest.mark.parametrize("count", [6, 7, 9])
def test_grasp_opens_at_every_border_of_its_region(count):
    """Just inside each half-plane's line the grasp is closed, just outside it is open."""
    rng = np.random.default_rng(200 + count)
    crossed = 0
    for body in bodies():
        contacts = closable(body, count, rng)
        for face in body.faces:
            region = seventh_contact_region(contacts, face)
            middle = face.coordinates(region.best_point()) if region else None
            for outline in region.outlines[:1]:
                sides = 0.5 * (outline + np.roll(outline, -1, axis=0))
                for side in sides:
                    room = region.half_planes[:, 2] - region.half_planes[:, :2] @ side
                    if np.abs(room).min(initial=np.inf) > 1e-9:
                        continue  # an edge of the face
                    step = 1e-4 * (side - middle)
                    inside, outside = (
                        with_last(contacts, face, face.at(side + s * step)) for s in (-1.0, 1.0)
                    )
                    assert is_form_closure(inside) and not is_form_closure(outside)
                    crossed += 1
    assert crossed >= 10


def test_contacts_that_close_already_leave_the_whole_face():
    last = [[0.0, 0.3, 0.4], [0.4, 0.4, 0.4]]
    for k in (1, 2):
        closed = SIX.joined(Contacts.along(last[:k], [[0, 0, -1]] * k))
        assert is_form_closure(closed)
        for face in BOX.faces:
            for method in METHODS:
                region = seventh_contact_region(closed, face, method)
                assert region.area == pytest.approx(face.area, rel=1e-12)
                assert len(region.half_planes) == 0 and "already" in region.reason
                assert region.contains(face.centre) and not region.contains(face.centre + 9.0)


def test_a_contact_that_cannot_push_leaves_no_region():
    """Nothing here balances a push along -x, so that not all forces can be positive."""
    normals = [[-1, 0, 0], [0, -1, 0], [0, 0, -1], [0, 1, 0], [0, 0, 1], [0, 1, 0]]
    points = [[0.6, 0.4, 0.3], [0.5, 0.5, 0.3], [0.55, 0.4, 0.4], [-0.5, -0.5, -0.3]]
    six = Contacts([*points, [-0.55, -0.4, -0.4], [0.3, -0.5, 0.2]], normals)
    for method in METHODS:
        region = seventh_contact_region(six, TOP, method)
        assert not region and region.vertices.shape == (0, 3) and region.area == 0.0
        assert not region.contains(TOP.centre) and region.depth(TOP.centre) == -np.inf
        with refused(GraspError, "no contact on +z closes"):
            region.best_point()
        with refused(GraspError, "no contact on +z closes"):
            region.contact(TOP.centre)


def test_a_push_that_is_zero_is_not_positive_by_its_rounding():
    """Contact 1 alone pushes along y: all others balance, and it never can."""
    normals = [[0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1], [0, 0, -1], [0, 0, -1]]
    points = [[0.4, -0.5, -0.3], [0.6, 0, 0], [-0.6, 0.2, -0.3], [-0.5, 0.1, -0.4]]
    six = Contacts([*points, [-0.2, 0.4, 0.4], [0.4, -0.1, 0.4]], normals)
    levels = wrench_cone(six).levels([0.6, 0.4, 0.1], [-1, 0, 0])
    assert levels[0] == pytest.approx(0.0, abs=1e-12) and levels[1:].max() < -0.4
    pose = np.eye(4)
    for seed in range(20):
        pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
        turned, face = six.placed(pose), BOX.placed(pose).faces[0]
        near = BOX.faces[0].at([0.4, 0.1] + 0.02 * np.random.default_rng(seed).normal(size=(40, 2)))
        points = near @ pose[:3, :3].T
        assert not closes_on_surface(turned, points, -face.normal).any()
        for method in METHODS:
            assert not seventh_contact_region(turned, face, method)


# --- faces of any form --------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_a_face_that_is_not_convex_takes_its_part_of_the_region(method):
    """Cutting with a larger convex face first and with the outline afterwards is the same."""
    z = 0.4
    ell = 0.24 * np.array(ELL, dtype=float)
    hole = np.array([(-0.2, 0.1), (-0.1, 0.1), (-0.1, 0.2), (-0.2, 0.2)])[::-1]
    lift = np.column_stack([ell, np.full(len(ell), z)])
    face = Face(lift, (np.column_stack([hole, np.full(4, z)]),))
    region = seventh_contact_region(SIX, face, method)
    whole = seventh_contact_region(SIX, TOP, method)
    expected = whole.shape.intersection(shapely.Polygon(ell, [hole]))
    assert region.area == pytest.approx(expected.area, abs=TOL)
    assert region.shape.symmetric_difference(expected).area < TOL
    assert len(region.outlines) == len(shapely.get_parts(expected))
    assert sum(map(len, region.holes)) == 1
    best = region.best_point()
    assert region.contains(best) and region.depth(best) > 0.0


def test_pieces_of_a_region_come_with_the_largest_first():
    """Two teeth in the region, on a bar outside it, are two pieces."""
    fork = [(-0.6, -0.5), (0.6, -0.5), (0.6, -0.48), (0.0, -0.48), (0.0, 0.4), (-0.1, 0.4)]
    fork += [(-0.1, -0.48), (-0.3, -0.48), (-0.3, 0.4), (-0.5, 0.4), (-0.5, -0.48), (-0.6, -0.48)]
    face = Face(np.column_stack([fork, np.full(len(fork), 0.4)]))
    region = seventh_contact_region(SIX, face)
    areas = [shapely.Polygon(outline).area for outline in region.outlines]
    assert len(areas) == 2 and areas == sorted(areas, reverse=True)
    assert sum(areas) == pytest.approx(region.area)
    assert np.all(region.contains([polygon.mean(axis=0) for polygon in region.polygons]))
    assert len(region.vertices) == sum(map(len, region.polygons))
    best = region.best_point()
    assert -0.5 < best[0] < -0.3
    assert region.depth(best) == pytest.approx(0.1, abs=1e-3)


def test_a_face_may_be_given_by_its_corners():
    region = seventh_contact_region(SIX, TOP.vertices)
    assert same_region(region, seventh_contact_region(SIX, TOP), 1e-12)


# --- invariance ---------------------------------------------------------------------------------


@pytest.mark.slow
@given(st.integers(0, 10_000), st.floats(1e-3, 1e2), st.floats(0.0, 1e3), st.sampled_from(METHODS))
@settings(deadline=None, max_examples=15)
def test_region_moves_with_the_body_and_grows_with_it(seed, factor, reach, method):
    rng = np.random.default_rng(seed)
    body = Polyhedron.hull(rng.normal(size=(6, 3)))
    contacts = random_contacts(body, int(rng.integers(6, 9)), rng)
    # The contacts hold their own: rounding far away is seen through the condition of W.
    s = np.linalg.svd(contacts.scaled_wrenches, compute_uv=False)
    assume(s[-1] > 1e-3 * s[0])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    pose[:3, 3] = rng.uniform(-reach, reach, 3) * factor
    moved = body.scaled(factor).placed(pose)
    grown = Contacts.along(contacts.points * factor, contacts.normals).placed(pose)
    order = rng.permutation(len(grown))
    tol = 1e3 * np.finfo(float).eps * (1.0 + reach) * s[0] / s[-1] * 1e2
    for here, there in zip(body.faces, moved.faces, strict=True):
        one = seventh_contact_region(contacts, here, method)
        other = seventh_contact_region(grown.subset(order), there, method)
        assert other.area == pytest.approx(factor**2 * one.area, abs=factor**2 * tol * here.area)
        for point in points_on(here, 4, rng):
            depth = float(one.depth(point)) if one else -np.inf
            if abs(depth) > tol * np.sqrt(here.area) and abs(depth) < np.inf:
                at = pose[:3, :3] @ point * factor + pose[:3, 3]
                assert bool(other.contains(at)) == (depth > 0.0)


# --- what a region offers -----------------------------------------------------------------------


def test_depth_is_the_room_to_slip():
    """Any slip by less than the depth keeps the grasp closed, some slip by more opens it."""
    region = seventh_contact_region(SIX, TOP)
    rng = np.random.default_rng(4)
    for point in points_on(TOP, 40, rng):
        depth = float(region.depth(point))
        if depth < 1e-3:
            continue
        turns = rng.uniform(0.0, 2.0 * np.pi, 20)
        around = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(20)])
        assert region.contains(point + 0.999 * depth * around).all()
        fine = np.linspace(0.0, 2.0 * np.pi, 2000)
        ring = np.column_stack([np.cos(fine), np.sin(fine), np.zeros(2000)])
        assert not region.contains(point + 1.001 * depth * ring).all()


def test_best_point_is_the_deepest():
    rng = np.random.default_rng(9)
    region = seventh_contact_region(SIX, TOP)
    best = float(region.depth(region.best_point()))
    assert best >= region.depth(points_on(TOP, 2000, rng)).max() - 1e-4
    assert region.depth(np.array([0.0, -0.4, 0.4])) < 0.0


def test_contact_joins_the_last_one_and_refuses_what_does_not_close():
    region = seventh_contact_region(SIX, TOP)
    seven = region.contact([0.4, 0.4, 0.7])
    assert is_form_closure(seven) and seven.names[6] == "contact 7"
    np.testing.assert_allclose(seven.points[6], [0.4, 0.4, 0.4])
    with refused(GraspError, "0.01874 m outside the region"):
        region.contact([0.48, 0.4, 0.4])


def test_coefficients_are_for_six_contacts_only():
    seven = SIX.joined(Contacts.along([[0.5, 0.4, 0.4]], [[0, 0, -1]]))
    region = seventh_contact_region(seven, BOX.faces[0])
    with refused(GraspError, "not unique"):
        region.coefficients([0.6, 0.0, 0.0])


# --- curved faces and cones ---------------------------------------------------------------------


def test_curved_faces_have_the_worked_pushes():
    worked = WORKED["curved_seventh"]
    (x, y), lz = worked["inputs"]["xy"], BLOCK["inputs"]["half_size"][2]
    for key, expected in worked["expected"].items():
        k = float(key.split("=")[1])
        point = [x, y, lz - 0.5 * k * ((x - 0.4) ** 2 + (y - 0.4) ** 2)]
        inward = -np.array([k * (x - 0.4), k * (y - 0.4), 1.0])
        inward /= np.linalg.norm(inward)
        levels = wrench_cone(SIX).levels(point, inward)
        np.testing.assert_allclose(levels, expected, atol=worked["tol"])
        assert closes_on_surface(SIX, point, inward)


def test_a_surface_is_judged_point_by_point_as_the_linear_program_does():
    turns, heights = np.meshgrid(np.linspace(-0.4, 0.4, 7), np.linspace(-0.5, 0.5, 6))
    outward = np.stack([np.sin(turns), np.zeros_like(turns), np.cos(turns)], axis=-1)
    points = np.stack([np.zeros_like(turns), heights, np.full_like(turns, -0.6)], axis=-1) + outward
    closes = closes_on_surface(SIX, points, -outward)
    assert closes.shape == turns.shape and 5 < closes.sum() < closes.size - 5
    for at in np.ndindex(turns.shape):
        seven = SIX.joined(Contacts.along([points[at]], [-outward[at]]))
        push = smallest_push(seven)
        assert abs(push) > UNDECIDED and bool(closes[at]) == (push > 0.0)


@pytest.mark.parametrize("count", [6, 7, 8, 9, 12])
def test_facets_of_the_cone_are_those_of_all_sets_of_five_wrenches(count):
    """Each facet is spanned by five wrenches and has all others on its inner side.

    Pushes that nearly balance, on faces that are nearly parallel, are no balance.
    """
    rng = np.random.default_rng(count)
    for body, tilt in ((bodies()[3], 0.0), (BOX, 0.0), (BOX, 1e-4), (BOX, 1e-4)):
        contacts = random_contacts(body, count, rng)
        while not is_independent(contacts):
            contacts = random_contacts(body, count, rng)
        tilted = contacts.normals + tilt * rng.normal(size=contacts.normals.shape)
        contacts = Contacts.along(contacts.points, tilted)
        W = contacts.scaled_wrenches
        expected = []
        for five in combinations(range(count), 5):
            _, s, Vt = np.linalg.svd(W[:, five].T)
            if s[-1] < 1e-9:
                continue
            sides = Vt[5] @ W
            if sides.min() > -1e-9 or sides.max() < 1e-9:
                expected.append(Vt[5] * np.sign(sides.sum()))
        facets = wrench_cone(contacts).facets
        facets = facets / np.linalg.norm(facets, axis=1)[:, None]
        for n in facets:
            assert min(np.abs(n - other).max() for other in expected) < 1e-7
        for n in expected:
            assert min(np.abs(n - other).max() for other in facets) < 1e-7


def turned(seed: int, reach: float = 0.0) -> np.ndarray:
    """A pose with a random rotation, some way off."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    pose[:3, 3] = reach * np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    return pose


def thin() -> Contacts:
    """Eight contacts with a thin cone; 2 and 6 push along -y, none along +y."""
    points = [[0.0, 0.384892, -0.086063], [0.260121, 2.0, 0.178422], [0.71564, 0.932012, -0.5]]
    points += [[2.0, 0.29981, -0.091044], [2.0, 0.631473, -0.071578], [1.42533, 1.0, -0.230397]]
    points += [[0.813866, 1.367544, 0.5], [1.357081, 0.035508, -0.5]]
    normals = [[1, 0, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 0], [-1, 0, 0], [0, -1, 0]]
    return Contacts(points, [*normals, [0, 0, -1], [0, 0, 1]])


def test_a_thin_cone_closes_nothing_that_its_contacts_cannot_balance():
    """Nothing balances contacts 2 and 6 when one more pushes along x: their facet says so."""
    face = Face([[2.0, 0.0, -0.5], [2.0, 1.0, -0.5], [2.0, 1.0, 0.5], [2.0, 0.0, 0.5]])
    for seed in range(12):
        pose = turned(seed, 3.0) if seed else np.eye(4)
        moved = Face(face.vertices @ pose[:3, :3].T + pose[:3, 3])
        contacts = thin().placed(pose)
        points = points_on(moved, 50, np.random.default_rng(seed))
        for method in METHODS:
            region = seventh_contact_region(contacts, moved, method)
            assert not region and not region.contains(points).any()
        assert not closes_on_surface(contacts, points, -moved.normal).any()


def test_facets_hold_their_generators_to_the_last_digits():
    rng = np.random.default_rng(8)
    tol = 1e2 * np.finfo(float).eps
    minus_y = np.array([0.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    assert np.abs(wrench_cone(thin()).facets - minus_y).max(axis=1).min() < tol
    for body in bodies():
        for count in (7, 8, 10):
            contacts = closable(body, count, rng)
            W = contacts.scaled_wrenches / np.linalg.norm(contacts.scaled_wrenches, axis=0)
            for n in wrench_cone(contacts).facets:
                heights = np.abs(n @ W)
                assert np.sum(heights < 1e2 * tol) >= 5 and (n @ W).min() > -1e2 * tol


def test_region_and_surface_draw_the_border_at_one_place():
    """Contact 7 on the line y = f, at distances from the border at x = 9/20 down to rounding."""
    steps = np.concatenate([-np.logspace(-14, -6, 200), [0.0], np.logspace(-14, -6, 200)])
    here = np.column_stack([0.45 + steps, np.full((len(steps), 2), 0.4)])
    for seed in range(6):
        pose = turned(seed, 10.0**seed)
        contacts = SIX.placed(pose)
        points = here @ pose[:3, :3].T + pose[:3, 3]
        face = Face(TOP.vertices @ pose[:3, :3].T + pose[:3, 3])
        region = seventh_contact_region(contacts, face)
        inside = region.contains(points)
        assert np.array_equal(inside, closes_on_surface(contacts, points, -face.normal))
        assert inside[steps == steps.min()].all() and not inside[steps >= 0.0].any()


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [1e-9, 3e-7])
def test_moments_refuse_normals_that_are_nearly_parallel(tilt):
    """What hangs on the difference of such normals is decided by the inverse alone, and rightly."""
    rng = np.random.default_rng(3)
    decided = {True: 0, False: 0}
    for _ in range(12):
        drawn = closable(BOX, int(rng.integers(6, 11)), rng)
        tilted = drawn.normals + tilt * rng.normal(size=drawn.normals.shape)
        contacts = Contacts.along(drawn.points, tilted)
        with refused(GraspError, "contact"):
            seventh_contact_region(contacts, TOP, "moments")
        for face in BOX.faces:
            region = seventh_contact_region(contacts, face)
            for point in points_on(face, 4, rng):
                seven = with_last(contacts, face, point)
                if not is_form_closure(seven).borderline:
                    closed = is_form_closure(seven, exact=True).closed
                    assert bool(region.contains(point)) == closed
                    decided[closed] += 1
    assert min(decided.values()) >= 10


@pytest.mark.slow
def test_both_routes_agree_on_normals_with_rounding_errors():
    rng = np.random.default_rng(4)
    for _ in range(20):
        drawn = closable(BOX, int(rng.integers(6, 9)), rng)
        noise = 1e-14 * rng.normal(size=drawn.normals.shape)
        contacts = Contacts.along(drawn.points, drawn.normals + noise)
        for face in BOX.faces:
            one, other = (seventh_contact_region(contacts, face, m) for m in METHODS)
            assert same_region(one, other, 1e-7)


def test_pushes_that_balance_without_a_moment_open_no_region():
    """Normal lines of four contacts meet, and their moment is rounding: it has no side."""
    k = 1.0 / np.sqrt(3.0)
    normals = [[-k, -k, -k], [1, 0, 0], [0, 0, 1], [-k, -k, -k], [0, 1, 0], [0, 1, 0], [0, 1, 0]]
    points = [[0.25, 0.25, 0.5], [0, 0.25, 0.75], [0.5, 0.25, 0], [0.5, 0.5, 0], [0.25, 0, 0.5]]
    seven = Contacts([*points, [0.5, 0, 0.25], [0, 0, 0.25]], normals)
    face = Face([[0, 0, 0], [1, 0, 0], [0, 0, 1]])
    eight = with_last(seven, face, np.array([0.25, 0.0, 0.25]))
    assert not is_form_closure(eight, exact=True)
    for method in METHODS:
        assert not seventh_contact_region(seven, face, method)


@pytest.mark.parametrize("count", [7, 8, 10])
def test_region_of_a_contact_is_where_the_others_may_have_it(count):
    rng = np.random.default_rng(count)
    contacts = closable(BOX, count, rng)
    for j in range(count):
        others = contacts.subset(k for k in range(count) if k != j)
        region = region_of(contacts, j, TOP)
        assert (region is not None) == is_independent(others)
        if region is not None:
            assert same_region(region, seventh_contact_region(others, TOP), 1e-12)


def test_a_region_of_small_grippers_is_the_same_on_a_face_of_any_size(rng):
    """Contacts within 1 mm on a body of 1 m and of 300 m: the region is as large as they."""
    bounded = 0
    while bounded < 5:
        contacts = Contacts.along(1e-3 * rng.normal(size=(7, 3)), rng.normal(size=(7, 3)))
        if not is_form_closure(contacts):
            continue
        square = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        across = np.linalg.svd(contacts.normals[6:])[2][1:]
        if np.linalg.det([*across, -contacts.normals[6]]) < 0.0:
            across = across[::-1]
        faces = [contacts.points[6] + np.array(square) @ (size * across) for size in (0.5, 150.0)]
        small, large = (region_of(contacts, 6, face) for face in faces)
        if small.area < 1e-3:
            bounded += 1
            assert large.area == pytest.approx(small.area, rel=1e-5)


def test_no_region_for_a_contact_whose_others_are_dependent():
    twice = SIX.subset([0, 1, 2, 3, 4, 4]).joined(SIX.subset([5]))
    assert region_of(twice, 6, TOP) is None and region_of(twice, 5, TOP) is not None
    with refused(GraspError, "three or more corners"):
        region_of(twice, 6, [[0, 0, 0]])


# --- refusals -----------------------------------------------------------------------------------


def test_dependent_contacts_are_refused_with_the_reason():
    normals = np.vstack([-np.eye(3), np.eye(3)])
    with refused(GraspError, "have rank 3, not 6"):
        seventh_contact_region(Contacts(-normals, normals), TOP)
    with refused(GraspError, "rank 5"):
        seventh_contact_region(SIX.subset([0, 1, 2, 3, 4]), TOP)


def test_questions_without_sense_are_refused():
    with refused(GraspError, 'methods are "inverse" and "moments"'):
        seventh_contact_region(SIX, TOP, "magic")  # type: ignore[arg-type]
    with refused(GraspError, "not list"):
        seventh_contact_region([1, 2, 3], TOP)  # type: ignore[arg-type]
    with refused(GraspError, "three finite coordinates"):
        seventh_contact_region(SIX, [[0, 0], [1, 0], [0, 1]])
    flat = Contacts([[0, 0], [1, 0], [0, 1]], [[0, 1], [1, 0], [0, -1]])
    with refused(GraspError, "in the plane"):
        seventh_contact_region(flat, TOP)
    many = SIX.joined(SIX).joined(SIX)
    with refused(GraspError, "at most 12 contacts"):
        seventh_contact_region(many, TOP, "moments")
    with refused(GraspError, "arrays"):
        closes_on_surface(SIX, [[0, 0]], [[0, 0, 1]])
    with refused(GraspError, "arrays"):
        closes_on_surface(SIX, [[0, 0, np.nan]], [[0, 0, 1]])
    with refused(GraspError, "arrays"):
        closes_on_surface(SIX, np.zeros((2, 3)), np.zeros((4, 3)))
    with refused(GraspError, "normal 2"):
        wrench_cone(SIX).levels([0.4, 0.4, 0.4], [[0, 0, -1], [0, 0, -3]])
    for points in ([0.4, 0.4], [0.4, np.nan, 0.4], "ab"):
        region = seventh_contact_region(SIX, TOP)
        for ask in (region.contains, region.depth, region.contact, TOP.room):
            with refused(GraspError, "points are"):
                ask(points)
