"""Claims about the search for good grasps: bounds are never beaten, limits are kept.

Oracles: margins by general linear programs; placements drawn by the thousand and grids of them,
none of which may be better than a bound; dense checks of regions; choices of faces counted one by
one; symmetry under size and motion.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations_with_replacement, permutations, product

import numpy as np
import pytest
from refusals import refused
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from multiarm.errors import GraspError
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.designs.grippers import clearest_approach
from multiarm.grasp.optimisation import placements
from multiarm.grasp.optimisation.face_search import margin_bound, margins, quick_bounds
from multiarm.grasp.optimisation.optimisation import optimise_grasp
from multiarm.grasp.optimisation.placements import (
    face_choices,
    positively_spanning,
    seven_touches,
    touch_regions,
)

BLOCK = Polyhedron.box([1.2, 1.0, 0.8])
REACH = 0.25
# Two opposite corners: six choices of faces.
CORNERS = np.array([[0.6, 0.5, 0.4], [-0.6, -0.5, -0.4]])
# Linear programs are solved to 1e-7; bounds may be lower by that.
SOLVED = 1e-6


def dodecahedron():
    phi = (1 + np.sqrt(5.0)) / 2
    corners = list(product((-1.0, 1.0), repeat=3))
    for s, t in product((-1.0, 1.0), repeat=2):
        corners += [(0, s / phi, t * phi), (s / phi, t * phi, 0), (s * phi, 0, t / phi)]
    return Polyhedron.hull(0.5 * np.array(corners))


def block_touches(number=0, reach=REACH):
    """One choice of faces on the block, with grippers at opposite corners."""
    regions = touch_regions(BLOCK, BLOCK.vertices, reach)
    choices = face_choices(regions, (4, 3))
    return seven_touches(choices[number], np.asarray(BLOCK.centre), BLOCK.size)


def good_placement(touches, rng):
    y = touches.drawn(400, rng)
    scores = margins(touches, y)
    assert scores.max() > 0.0
    return y[int(np.argmax(scores))]


# --- where fingertips may be ---------------------------------------------------------------------


@pytest.mark.parametrize("body", [BLOCK, Polyhedron.wedge([1.0, 0.8, 0.6]), dodecahedron()])
def test_regions_hold_what_is_on_a_face_within_reach_and_clear_of_edges(rng, body):
    reach, clearance = 0.35, 0.03
    regions = touch_regions(body, body.vertices[:3], reach, clearance=clearance)
    for place, own in zip(body.vertices[:3], regions, strict=True):
        for number, face in enumerate(body.faces):
            weights = rng.dirichlet(np.full(len(face.vertices), 0.7), 400)
            points = weights @ face.vertices
            usable = face.room(points) > clearance
            usable &= np.linalg.norm(points - place, axis=1) < reach
            region = [r for r in own if r.face == number]
            assert usable.any() <= bool(region)
            for r in region:
                inner, outer = (face.coordinates(c) for c in (r.inner, r.outer))
                assert np.all(in_polygon(outer, face.coordinates(points[usable])))
                np.testing.assert_allclose(r.normal, -face.normal, atol=1e-12)
                assert np.all(np.linalg.norm(r.inner - place, axis=1) < reach * (1 + 1e-9))
                assert np.all(face.room(r.inner) > clearance * (1 - 1e-6))
                assert np.all(in_polygon(outer, inner, slack=1e-9))


def in_polygon(corners, points, slack=1e-12):
    after = np.roll(corners, -1, axis=0) - corners
    to = points[:, None] - corners
    return np.all(after[:, 0] * to[..., 1] - after[:, 1] * to[..., 0] > -slack, axis=1)


def test_a_face_that_is_not_convex_is_cut_into_pieces_that_cover_it():
    corner = Polyhedron.prism([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], 1.0)
    regions = touch_regions(corner, np.array([[1.0, 1.0, 0.0]]), 10.0)[0]
    top = [r for r in regions if r.normal[2] < -0.5]
    assert len(top) > 1
    areas = [abs(np.cross(r.inner - r.inner[0], np.roll(r.inner, -1, 0) - r.inner[0]).sum(0)[2]) / 2
             for r in top]  # fmt: skip
    assert sum(areas) == pytest.approx(3.0, rel=1e-9)


def test_parts_of_faces_may_be_named():
    square = np.array([[0.6, 0.3, 0.2], [0.6, 0.4, 0.2], [0.6, 0.4, 0.3], [0.6, 0.3, 0.3]])
    corner = np.array([[0.6, 0.5, 0.4]])
    regions = touch_regions(BLOCK, corner, 1.0, faces={0: square, 1: None})[0]
    assert sorted(r.face for r in regions) == [0, 1]
    assert np.ptp(regions[0].inner, axis=0).max() == pytest.approx(0.1)
    assert [r.face for r in touch_regions(BLOCK, corner, 0.2, faces=[2, 5])[0]] == [2]
    with refused(GraspError, "faces 0 to 5, not 9"):
        touch_regions(BLOCK, corner, 0.2, faces=[9])
    with refused(GraspError, "face 0:", "corners (K, 3)"):
        touch_regions(BLOCK, corner, 0.2, faces={0: [1.0, 2.0]})
    with refused(GraspError, "do not go round"):
        touch_regions(BLOCK, corner, 0.2, faces={0: square[[0, 2, 1, 3]]})


# --- which faces ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_positive_span_is_what_a_linear_program_says(rng):
    seen = set()
    for count in (3, 4, 5, 6, 8):
        for _ in range(60):
            normals = rng.integers(-1, 2, (count, 3)).astype(float)
            normals = normals[np.any(normals, axis=1)]
            if len(normals) == 0:
                continue
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            program = linprog(
                np.zeros(len(normals)), A_eq=normals.T, b_eq=np.zeros(3), bounds=(1, None)
            )
            # A strictly positive balance of normals that span space.
            expected = program.status == 0 and np.linalg.matrix_rank(normals) == 3
            seen.add(expected)
            assert positively_spanning(normals) == expected
    assert seen == {True, False}


def test_choices_on_a_block_are_those_of_opposite_corners():
    regions = touch_regions(BLOCK, BLOCK.vertices, REACH)
    choices = face_choices(regions, (4, 3))
    assert len(choices) == 24  # four pairs, two ways round, three faces to double
    for number in range(24):
        choice = choices[number]
        a, b = (BLOCK.vertices[region.place] for region in (choice[0], choice[-1]))
        np.testing.assert_allclose(a, -b)
        assert len({region.face for region in choice}) == 6


def possible_choices(regions):
    """By definition, one after the other: contacts that close can have these normals."""
    for a, b in permutations(regions, 2):
        for first in combinations_with_replacement(a, 4):
            for second in combinations_with_replacement(b, 3):
                e = np.array([region.normal for region in (*first, *second)])
                hands = [clearest_approach(e[:4])[1], clearest_approach(e[4:])[1]]
                parallel = (np.abs(e @ e.T) > 1.0 - 1e-9).sum(axis=1).max()
                if min(hands) > 1 / 7 - 1e-9 and parallel <= 3 and positively_spanning(e):
                    yield (*first, *second)


def keys(choices):
    return [tuple((region.place, region.face) for region in choice) for choice in choices]


@pytest.mark.slow
def test_choices_are_all_that_may_close_and_hands_reach():
    """From places in the middle of a body hands would have to come from several sides."""
    body = Polyhedron.wedge([1.0, 0.8, 0.6])
    regions = touch_regions(body, np.array([body.centre, body.vertices[0]]), 0.75)
    choices = face_choices(regions, (4, 3))
    assert len(choices) > 0
    listed = [choices[number] for number in range(len(choices))]
    assert keys(listed) == keys(possible_choices(regions))


def test_more_choices_than_can_be_bounded_are_refused(monkeypatch):
    regions = touch_regions(BLOCK, BLOCK.vertices, REACH)
    monkeypatch.setattr(placements, "MOST_CHOICES", 1199)
    with refused(GraspError, "more than 1,199 choices of faces"):
        face_choices(regions, (4, 3))
    monkeypatch.setattr(placements, "MOST_CHOICES", 1200)
    assert len(face_choices(regions, (4, 3))) == 24


def test_too_many_choices_are_refused_before_they_are_counted(rng):
    """A ball of 40 corners, each of which reaches all 76 faces: 1e14 choices."""
    directions = rng.normal(size=(40, 3))
    ball = Polyhedron.hull(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    with refused(GraspError, "smaller grippers, or named faces or places"):
        optimise_grasp(ball, gripper_size=3.0)


# --- margins and their bounds ---------------------------------------------------------------------


def test_scores_are_the_margin(rng):
    touches = block_touches()
    y = touches.drawn(60, rng)
    closed = 0
    for placement, margin in zip(y, margins(touches, y), strict=True):
        verdict = is_form_closure(Contacts(touches.points(placement), touches.normals))
        assert bool(verdict) == (margin > 0.0)
        if verdict:
            closed += 1
            assert margin == pytest.approx(verdict.margin, rel=1e-7)
    assert closed > 5


def shrunk(touches, about, size):
    """The regions shrunk towards a placement."""
    outer = tuple(z + size * (cell - z) for z, cell in zip(about, touches.outer, strict=True))
    return replace(touches, outer=outer)


def quick_bound(touches, twists):
    rates = zip(touches.outer, touches.base, touches.rates, strict=True)
    work = [(base + np.einsum("va,af->vf", cell, rate)) @ twists.T for cell, base, rate in rates]
    return quick_bounds(np.array([w.max(axis=0) for w in work])[None])[0]


def test_quick_bounds_are_above_every_margin_and_those_of_a_choice_as_sharp_as_its_twists(rng):
    touches = block_touches()
    best = margins(touches, touches.drawn(500, rng)).max()
    anything = np.concatenate([rng.standard_normal((50, 6)), np.eye(6), -np.eye(6)])
    bound = margin_bound(touches)
    assert quick_bound(touches, anything) >= best * (1 - 1e-9)
    assert quick_bound(touches, bound.twists) == pytest.approx(bound.top, rel=1e-6)


def test_quick_bound_of_a_margin_is_sharp_for_the_best_twist(rng):
    touches = block_touches()
    y = touches.drawn(300, rng)
    values = margins(touches, y)
    for k in np.argsort(-values)[:5]:
        bound = margin_bound(shrunk(touches, y[k], 1e-9))
        work = touches.wrenches(y[k]) @ bound.twists.T  # (7, 2)
        assert quick_bounds(work[None])[0] == pytest.approx(values[k], rel=1e-5)


def test_no_placement_beats_the_bound_of_its_choice(rng):
    """In regions that shrink about a random placement, with placements drawn from them."""
    touches = block_touches()
    about, bounds = touches.drawn(1, rng)[0], []
    for size in (1.0, 0.7, 0.4, 0.2):
        part = shrunk(touches, about, size)
        drawn = np.stack([rng.dirichlet(np.ones(len(c)), 400) @ c for c in part.outer], axis=1)
        bounds.append(margin_bound(part).top)
        assert margins(touches, drawn).max() <= bounds[-1] * (1 + SOLVED)
    assert np.all(np.diff(bounds) <= SOLVED)


def test_bounds_close_in_on_the_margin_as_regions_shrink(rng):
    touches = block_touches()
    best = good_placement(touches, rng)
    value = margins(touches, best[None])[0]
    ratios = [
        margin_bound(shrunk(touches, best, size)).top / value for size in (0.1, 0.03, 0.01, 0.001)
    ]
    assert all(ratio >= 1.0 - SOLVED for ratio in ratios)
    assert ratios[0] > ratios[1] > ratios[2] > ratios[3] and ratios[3] < 1.02


def test_the_margin_of_regions_is_one_linear_program_without_loss():
    """Its bound is the margin of the placement that it proposes."""
    for number in (0, 7, 20):
        touches = block_touches(number)
        bound = margin_bound(touches)
        W = touches.wrenches(bound.placement).T
        program = linprog(  # coincident contacts leave balances to choose from
            np.r_[np.zeros(7), -1.0],
            A_ub=np.c_[-np.eye(7), np.ones(7)], b_ub=np.zeros(7),
            A_eq=np.c_[np.vstack([W, np.ones(7)]), np.zeros(7)], b_eq=np.r_[np.zeros(6), 1.0],
            bounds=[(0, None)] * 7 + [(None, None)],
        )  # fmt: skip
        assert -program.fun == pytest.approx(bound.top, rel=1e-6)


# --- whole searches ------------------------------------------------------------------------------


def search(**options):
    """The best grasp of the block by grippers at two opposite corners, unless options say else."""
    options = {"body": BLOCK, "gripper_size": REACH, "places": CORNERS, **options}
    return optimise_grasp(options.pop("body"), **options)


@pytest.fixture(scope="module")
def best_of_block():
    """What a search with nothing but defaults says about the block."""
    return search()


def checked(result, body, reach, tip=0.0):
    """What every result must keep to."""
    grasp = result.grasp
    assert grasp.closure
    assert len(grasp.contacts) == 7 and [len(g.contacts) for g in grasp.grippers] == [4, 3]
    for gripper in grasp.grippers:
        assert np.min(np.linalg.norm(body.vertices - gripper.corner, axis=1)) < 1e-12
        np.testing.assert_allclose(np.linalg.det(gripper.frame[:3, :3]), 1.0)
        for j in gripper.contacts:
            point, face = grasp.contacts.points[j], body.faces[grasp.faces[j]]
            assert np.linalg.norm(point - gripper.corner) <= reach * (1 + 1e-9)
            assert face.room(point[None])[0] >= tip * (1 - 1e-6)
            np.testing.assert_allclose(grasp.contacts.normals[j], -face.normal, atol=1e-12)
    apart = np.linalg.norm(grasp.contacts.points[:, None] - grasp.contacts.points[None], axis=-1)
    assert (apart + 10.0 * np.eye(7)).min() >= 2 * tip * (1 - 1e-9)
    assert result.conditioning >= 1e-3
    assert result.value <= result.bound * (1 + SOLVED)
    assert result.gap == pytest.approx(1 - result.value / result.bound)
    assert result.value == pytest.approx(grasp.closure.margin, rel=1e-6)
    for gripper in grasp.grippers:
        assert clearest_approach(grasp.contacts.normals[list(gripper.contacts)])[1] > 1 / 7 - 1e-9


@pytest.mark.slow
def test_grasps_of_a_block_keep_to_the_limits_and_say_what_is_proven():
    result = search(tip_radius=0.015, nodes=12)
    checked(result, BLOCK, REACH, tip=0.015)
    assert result.choices == 6 and result.nodes <= 12
    assert result.finished and result.gap <= 0.05 + 1e-12
    assert "no sharper bound is known" not in result.message
    tight = search(tip_radius=0.015, gap=1e-6)
    assert not tight.finished and "no sharper bound is known" in tight.message


@pytest.mark.slow
def test_no_placement_drawn_from_all_choices_beats_the_bound(best_of_block, rng):
    for number in range(24):  # the block is its own mirror image: all corners are alike
        touches = block_touches(number)
        assert margins(touches, touches.drawn(300, rng)).max() <= best_of_block.bound * (1 + SOLVED)


@pytest.mark.slow
def test_small_grippers_hold_a_large_body():
    """Their conditioning falls with their size over that of the body, and the floor with it."""
    large = search(body=BLOCK.scaled(100.0), places=100.0 * CORNERS, gripper_size=0.05)
    assert large.finished and large.grasp.closure
    assert 1e-5 < large.conditioning < 1e-3
    with refused(GraspError, "a lower conditioning than 0.001 may help"):
        search(
            body=BLOCK.scaled(100.0), places=100.0 * CORNERS, gripper_size=0.05, conditioning=1e-3
        )


@pytest.mark.slow
def test_a_grid_over_few_parameters_finds_nothing_better():
    """Six fingertips may stay on small squares, the seventh on a strip: a grid covers it."""
    patch = 0.01
    faces = {}
    spots = [(0, [0.6, 0.4, 0.3]), (1, [0.5, 0.5, 0.3]), (2, None), (3, [-0.6, -0.4, -0.3]),
             (4, [-0.5, -0.5, -0.3]), (5, [-0.55, -0.4, -0.4])]  # fmt: skip
    for number, spot in spots:
        face = BLOCK.faces[number]
        if spot is None:
            faces[number] = np.array(
                [[0.2, 0.3, 0.4], [0.6, 0.3, 0.4], [0.6, 0.5, 0.4], [0.2, 0.5, 0.4]]
            )
            continue
        u, v = face.frame[:3, 0], face.frame[:3, 1]
        corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        faces[number] = np.array([spot + patch / 2 * (a * u + b * v) for a, b in corners])
    result = search(gripper_size=0.5, faces=faces, nodes=80, conditioning=0.0)
    regions = touch_regions(BLOCK, CORNERS, 0.5, faces=faces)
    best = 0.0
    choices = face_choices(regions, (4, 3))
    for number in range(len(choices)):
        touches = seven_touches(choices[number], np.zeros(3), BLOCK.size)
        on_strip = [i for i, region in enumerate(touches.regions) if region.face == 2]
        if len(on_strip) != 2:
            continue
        xs = [np.linspace(c.min(axis=0) * 0.98, c.max(axis=0) * 0.98, 9) for c in
              (touches.inner[i] for i in on_strip)]  # fmt: skip
        grid = [(a, b, c, d) for a in xs[0][:, 0] for b in xs[0][:, 1] for c in xs[1][:, 0]
                for d in xs[1][:, 1]]  # fmt: skip
        y = np.zeros((len(grid), 7, 2))
        y[:, on_strip] = np.array(grid).reshape(-1, 2, 2)
        best = max(best, float(margins(touches, touches.within(y)).max()))
    assert best > 0.0
    assert best <= result.bound * (1 + SOLVED)
    assert result.value >= best / 1.15


@pytest.mark.slow
def test_a_body_with_twelve_faces_is_done_within_the_gap():
    body = dodecahedron()
    told = []
    result = optimise_grasp(
        body, gripper_size=0.4, tip_radius=0.02, progress=lambda *news: told.append(news)
    )
    checked(result, body, 0.4, tip=0.02)
    assert result.finished and result.gap <= 0.05 + 1e-12
    assert told[0][2].startswith("looking") and told[-1][2] == "done"
    assert all(done <= total == 300 for done, total, _ in told)


@pytest.mark.slow
def test_contacts_keep_their_distance_and_the_floor_of_the_conditioning(best_of_block):
    def nearest(result):
        points = result.grasp.contacts.points
        return (np.linalg.norm(points[:, None] - points[None], axis=-1) + 10.0 * np.eye(7)).min()

    distance, conditioning = 1.2 * nearest(best_of_block), 0.8 * best_of_block.conditioning
    assert nearest(search(nodes=1, spacing=distance)) >= distance * (1 - 1e-9)
    assert search(nodes=1, conditioning=conditioning).conditioning >= conditioning


@pytest.mark.slow
def test_the_same_seed_gives_the_same_grasp_and_size_and_place_do_not_matter(best_of_block):
    def best(body, places):
        size = REACH * body.size / BLOCK.size
        options = {"gripper_size": size, "places": places, "nodes": 3, "rng": 5}
        return search(body=body, **options)

    plain, again = best(BLOCK, CORNERS), best(BLOCK, CORNERS)
    np.testing.assert_array_equal(plain.grasp.contacts.points, again.grasp.contacts.points)
    assert (plain.value, plain.bound) == (again.value, again.bound)
    small = best(BLOCK.scaled(1e-2), 1e-2 * CORNERS)
    pose = np.eye(4)
    pose[:3, 3] = [500.0, -300.0, 800.0]
    large = best(BLOCK.scaled(100.0).placed(pose), 100.0 * CORNERS + pose[:3, 3])
    for scaled in (small, large):  # margins do not depend on size; rounding may lead another way
        assert scaled.bound == pytest.approx(plain.bound, rel=1e-6)
        assert scaled.value == pytest.approx(plain.value, rel=0.05)
    pose[:3, :3] = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    places = CORNERS @ pose[:3, :3].T + pose[:3, 3]
    turned = search(body=BLOCK.placed(pose), places=places)
    assert turned.bound == pytest.approx(best_of_block.bound, rel=0.06)


@pytest.mark.slow
def test_more_nodes_never_raise_the_bound_and_no_value_is_above_any_of_them():
    few, more = (search(nodes=n, gap=1e-6) for n in (1, 20))
    assert max(few.value, more.value) <= more.bound * (1 + SOLVED)
    assert more.bound <= few.bound


@pytest.mark.slow
def test_fingers_and_places_may_be_given():
    light = search(fingers=(3, 4), nodes=8)
    assert [len(g.contacts) for g in light.grasp.grippers] == [3, 4]
    some = search(places=0.95 * CORNERS, nodes=10)
    assert all(np.allclose(np.abs(g.corner), 0.95 * CORNERS[0]) for g in some.grasp.grippers)
    quick = search(gap=1e-6, seconds=0.0)
    assert quick.nodes == 0 and quick.bound > quick.value


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"body": [1, 2, 3]}, "a Polyhedron is needed, not list"),
        ({"fingers": (4, 4)}, "seven contacts together, not (4, 4)"),
        ({"fingers": 7}, "seven contacts together, not 7"),
        ({"fingers": (4.5, 2.5)}, "seven contacts together, not (4.5, 2.5)"),
        ({"gripper_size": 0.0}, "gripper_size is a length"),
        ({"gripper_size": np.inf}, "gripper_size is a finite number"),
        ({"gripper_size": "x"}, "gripper_size is a finite number"),
        ({"tip_radius": -1.0}, "tip_radius is a finite number and not negative"),
        ({"spacing": np.nan}, "spacing is a finite number and not negative"),
        ({"spacing": -0.1}, "spacing is a finite number and not negative"),
        ({"conditioning": np.nan}, "conditioning is a finite number"),
        ({"conditioning": -1.0}, "conditioning is a finite number"),
        ({"seconds": "x"}, "seconds is a finite number"),
        ({"gap": 0.0}, "gap lies between 0 and 1"),
        ({"nodes": 0}, "nodes is positive"),
        ({"faces": 3}, "faces are the numbers of some"),
        ({"faces": [0.5]}, "faces 0 to 5, not 0.5"),
        ({"places": [[0.0, 0.0, 0.0]]}, "places have shape (M, 3), two at least"),
        ({"faces": [0, 1, 2]}, "no two places from which seven contacts can close"),
        ({"tip_radius": 0.2}, "no two places"),
        ({"conditioning": 0.9, "nodes": 30}, "lower conditioning than 0.9 may help"),
    ],
)
def test_impossible_searches_are_refused_with_a_reason(change, place):
    with refused(GraspError, place):
        search(**{"places": None, **change})
