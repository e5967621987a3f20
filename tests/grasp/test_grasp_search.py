"""Claims about the search for good grasps: bounds are never beaten, limits are kept.

Oracles: scores by general linear programs; placements drawn by the thousand and grids of them, none
of which may be better than a bound; dense checks of regions; symmetry under size and motion.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from multiarm.errors import GraspError
from multiarm.grasp.closure_radii import closure_radius
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.form_closure import is_form_closure
from multiarm.grasp.grasp_objectives import Force, Margin, Stability, felt_by
from multiarm.grasp.optimisation import optimise_grasp
from multiarm.grasp.placements import (
    face_choices,
    positively_spanning,
    seven_touches,
    touch_regions,
)
from multiarm.grasp.polyhedron import Polyhedron

BLOCK = Polyhedron.box([1.2, 1.0, 0.8])
REACH = 0.25
# Two opposite corners: six choices of faces.
CORNERS = np.array([[0.6, 0.5, 0.4], [-0.6, -0.5, -0.4]])
UNIT_LOADS = np.vstack([np.eye(6), -np.eye(6)])
OBJECTIVES = [Margin(), Force(UNIT_LOADS), Stability()]
NAMES = ["margin", "force", "stability"]
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
    choices = list(face_choices(regions, (4, 3)))
    return seven_touches(choices[number], np.asarray(BLOCK.centre), BLOCK.size)


def contacts_of(touches, y):
    return Contacts(touches.points(y), touches.normals)


def good_placement(objective, touches, rng):
    y = touches.drawn(400, rng)
    scores = objective.scores(touches, y)
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
    with pytest.raises(GraspError, match=r"faces 0 to 5, not 9"):
        touch_regions(BLOCK, corner, 0.2, faces=[9])
    with pytest.raises(GraspError, match=r"face 0: .* corners \(K, 3\)"):
        touch_regions(BLOCK, corner, 0.2, faces={0: [1.0, 2.0]})
    with pytest.raises(GraspError, match=r"do not go round"):
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
    choices = list(face_choices(regions, (4, 3)))
    assert len(choices) == 24  # four pairs, two ways round, three faces to double
    for choice in choices:
        a, b = (BLOCK.vertices[region.place] for region in (choice[0], choice[-1]))
        np.testing.assert_allclose(a, -b)
        assert len({region.face for region in choice}) == 6


# --- scores and cuts -----------------------------------------------------------------------------


def least_worst_force(contacts, loads, middle, size):
    """By one linear program for each load, forces at will."""
    arms = (contacts.points - middle) / size
    W = np.vstack([contacts.normals.T, np.cross(arms, contacts.normals).T])
    worst = []
    for load in loads:
        count = W.shape[1]
        program = linprog(
            np.r_[np.zeros(count), 1.0],
            A_ub=np.c_[np.eye(count), -np.ones(count)], b_ub=np.zeros(count),
            A_eq=np.c_[W, np.zeros(6)], b_eq=-load,
        )  # fmt: skip
        worst.append(program.fun if program.status == 0 else np.inf)
    return max(worst)


@pytest.mark.slow
def test_scores_are_the_margin_the_worst_force_and_the_radius(rng):
    touches = block_touches()
    y = touches.drawn(60, rng)
    margin, force, radius = (objective.scores(touches, y) for objective in OBJECTIVES)
    closed = 0
    for k in range(60):
        contacts = contacts_of(touches, y[k])
        verdict = is_form_closure(contacts)
        assert bool(verdict) == (margin[k] > 0.0) == (force[k] > 0.0) == (radius[k] > 0.0)
        if verdict:
            closed += 1
            assert margin[k] == pytest.approx(verdict.margin, rel=1e-7)
            worst = least_worst_force(contacts, UNIT_LOADS, np.zeros(3), 1.0)
            assert 1.0 / force[k] == pytest.approx(worst, rel=1e-6)
            found = closure_radius(contacts)
            assert found.lower * (1 - 1e-9) <= radius[k] <= found.upper * 1.02
    assert closed > 5


def shrunk(touches, about, size):
    """The regions shrunk towards a placement."""
    outer = tuple(z + size * (cell - z) for z, cell in zip(about, touches.outer, strict=True))
    return replace(touches, outer=outer)


def quick_bound(objective, touches, twists):
    rates = zip(touches.outer, touches.base, touches.rates, strict=True)
    work = [(base + np.einsum("va,af->vf", cell, rate)) @ twists.T for cell, base, rate in rates]
    low, high = (np.array([getattr(w, how)(axis=0) for w in work]) for how in ("min", "max"))
    felt = felt_by(touches.normals, twists).T
    return objective.quick_bounds(low[None], high[None], felt[None], twists)[0]


@pytest.mark.parametrize("objective", OBJECTIVES, ids=NAMES)
def test_quick_bounds_are_above_every_score_and_those_of_a_choice_as_sharp_as_its_twists(
    rng, objective
):
    touches = block_touches()
    y = touches.drawn(500, rng)
    best = objective.scores(touches, y).max()
    anything = np.concatenate([rng.standard_normal((50, 6)), np.eye(6), -np.eye(6)])
    found = objective.bound(touches, y[:20])
    assert quick_bound(objective, touches, anything) >= best * (1 - 1e-9)
    assert quick_bound(objective, touches, found.twists) == pytest.approx(found.top, rel=1e-6)


def test_quick_bound_of_a_margin_is_sharp_for_the_best_twist(rng):
    touches = block_touches()
    y = touches.drawn(300, rng)
    margins = Margin().scores(touches, y)
    for k in np.argsort(-margins)[:5]:
        found = Margin().bound(shrunk(touches, y[k], 1e-9), y[k][None])
        work = touches.wrenches(y[k]) @ found.twists.T  # (7, 2)
        bound = Margin().quick_bounds(work[None], work[None], work[None], found.twists)[0]
        assert bound == pytest.approx(margins[k], rel=1e-5)


@pytest.mark.parametrize("objective", OBJECTIVES, ids=NAMES)
def test_no_placement_beats_the_bound_of_its_choice(rng, objective):
    """In regions that shrink about a random placement, with placements drawn from them."""
    touches = block_touches()
    about, bounds = touches.drawn(1, rng)[0], []
    for size in (1.0, 0.7, 0.4, 0.2):
        part = shrunk(touches, about, size)
        drawn = np.stack([rng.dirichlet(np.ones(len(c)), 400) @ c for c in part.outer], axis=1)
        scores = objective.scores(touches, drawn)
        k = int(np.argmax(scores))
        bounds.append(objective.bound(part, drawn[:10]).top)
        assert objective.certain(touches, drawn[k]) <= bounds[-1] * (1 + SOLVED)
    if not isinstance(objective, Stability):  # its twists are those of the placements drawn
        assert np.all(np.diff(bounds) <= SOLVED)


@pytest.mark.parametrize("objective", OBJECTIVES, ids=NAMES)
def test_bounds_close_in_on_the_score_as_regions_shrink(rng, objective):
    touches = block_touches()
    best = good_placement(objective, touches, rng)
    value = objective.certain(touches, best)
    ratios = [
        objective.bound(shrunk(touches, best, size), best[None]).top / value
        for size in (0.1, 0.03, 0.01, 0.001)
    ]
    assert all(ratio >= 1.0 - SOLVED for ratio in ratios)
    assert ratios[0] > ratios[1] > ratios[2] > ratios[3] and ratios[3] < 1.02


def test_the_margin_of_regions_is_one_linear_program_without_loss():
    """Its bound is the score of the placement that it proposes."""
    for number in (0, 7, 20):
        touches = block_touches(number)
        found = Margin().bound(touches, np.zeros((0, 7, 2)))
        assert len(found.placements) == 1
        W = touches.wrenches(found.placements[0]).T
        program = linprog(  # coincident contacts leave balances to choose from
            np.r_[np.zeros(7), -1.0],
            A_ub=np.c_[-np.eye(7), np.ones(7)], b_ub=np.zeros(7),
            A_eq=np.c_[np.vstack([W, np.ones(7)]), np.zeros(7)], b_eq=np.r_[np.zeros(6), 1.0],
            bounds=[(0, None)] * 7 + [(None, None)],
        )  # fmt: skip
        assert -program.fun == pytest.approx(found.top, rel=1e-6)


def test_the_bound_of_a_force_is_met_by_the_placement_for_the_worst_load():
    touches = block_touches()
    found = Force(UNIT_LOADS).bound(touches, np.zeros((0, 7, 2)))
    contacts = contacts_of(touches, found.placements[0])
    least = [least_worst_force(contacts, [load], np.zeros(3), 1.0) for load in UNIT_LOADS]
    assert np.abs(np.array(least) * found.top - 1.0).min() < SOLVED


# --- whole searches ------------------------------------------------------------------------------


def search(**options):
    """The best grasp of the block by grippers at two opposite corners, unless options say else."""
    options = {"body": BLOCK, "gripper_size": REACH, "places": CORNERS, **options}
    return optimise_grasp(options.pop("body"), **options)


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
    if result.objective == "force":
        assert result.value >= result.bound * (1 - SOLVED)
        assert result.gap == pytest.approx(1 - result.bound / result.value)
        worst = least_worst_force(grasp.contacts, UNIT_LOADS, np.asarray(body.centre), body.size)
        assert result.value == pytest.approx(worst, rel=1e-6)
    else:
        assert result.value <= result.bound * (1 + SOLVED)
        assert result.gap == pytest.approx(1 - result.value / result.bound)
    if result.objective == "margin":
        assert result.value == pytest.approx(grasp.closure.margin, rel=1e-6)
    if result.objective == "stability":
        assert result.value == pytest.approx(closure_radius(grasp.contacts).lower, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("objective", NAMES)
def test_grasps_of_a_block_keep_to_the_limits_and_say_what_is_proven(objective):
    result = search(objective=objective, tip_radius=0.015, nodes=12)
    checked(result, BLOCK, REACH, tip=0.015)
    assert result.choices == 6 and result.nodes <= 12
    assert result.finished == (result.gap <= 0.05 + 1e-12)
    assert (objective == "margin") <= result.finished
    assert ("no sharper bound is known" in result.message) != result.finished


@pytest.mark.slow
@pytest.mark.parametrize("objective", NAMES)
def test_no_placement_drawn_from_all_choices_beats_the_bound(rng, objective):
    result = search(objective=objective, nodes=25)
    score = OBJECTIVES[NAMES.index(objective)]
    top = {"margin": 1.0, "force": 1.0, "stability": BLOCK.size}[objective]
    for number in range(24):  # the block is its own mirror image: all corners are alike
        touches = block_touches(number)
        y = touches.drawn(300, rng)
        scores = score.scores(touches, y)
        best = score.certain(touches, y[int(np.argmax(scores))])
        if objective == "force":
            assert best == 0.0 or 1.0 / best >= result.bound * (1 - SOLVED)
        else:
            assert top * best <= result.bound * (1 + SOLVED)


@pytest.mark.slow
@pytest.mark.parametrize("objective", NAMES)
def test_a_grid_over_few_parameters_finds_nothing_better(objective):
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
    result = search(gripper_size=0.5, objective=objective, faces=faces, nodes=80, conditioning=0.0)
    score = OBJECTIVES[NAMES.index(objective)]
    regions = touch_regions(BLOCK, CORNERS, 0.5, faces=faces)
    best = 0.0
    for choice in face_choices(regions, (4, 3)):
        touches = seven_touches(choice, np.zeros(3), BLOCK.size)
        on_strip = [i for i, region in enumerate(touches.regions) if region.face == 2]
        if len(on_strip) != 2:
            continue
        xs = [np.linspace(c.min(axis=0) * 0.98, c.max(axis=0) * 0.98, 9) for c in
              (touches.inner[i] for i in on_strip)]  # fmt: skip
        grid = [(a, b, c, d) for a in xs[0][:, 0] for b in xs[0][:, 1] for c in xs[1][:, 0]
                for d in xs[1][:, 1]]  # fmt: skip
        y = np.zeros((len(grid), 7, 2))
        y[:, on_strip] = np.array(grid).reshape(-1, 2, 2)
        scores = score.scores(touches, touches.within(y))
        best = max(best, float(scores.max()))
    assert best > 0.0
    if objective == "stability":
        best *= BLOCK.size / 1.02  # scores are estimates from above
    if objective == "force":
        assert 1.0 / best >= result.bound * (1 - SOLVED)
        assert result.value <= 1.15 / best
    else:
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
def test_contacts_keep_their_distance_and_the_floor_of_the_conditioning():
    def best(**limits):
        return search(objective="force", nodes=1, **limits)

    def nearest(result):
        points = result.grasp.contacts.points
        return (np.linalg.norm(points[:, None] - points[None], axis=-1) + 10.0 * np.eye(7)).min()

    free = best()
    apart = best(spacing=1.2 * nearest(free))
    assert nearest(apart) >= 1.2 * nearest(free) * (1 - 1e-9)
    assert apart.value >= free.bound
    firm = best(conditioning=0.8 * free.conditioning)
    assert firm.conditioning >= 0.8 * free.conditioning


@pytest.mark.slow
def test_the_same_seed_gives_the_same_grasp_and_size_and_place_do_not_matter():
    def best(body, places):
        size = REACH * body.size / BLOCK.size
        options = {"gripper_size": size, "places": places, "nodes": 8, "rng": 5}
        return search(body=body, objective="force", **options)

    plain, again = best(BLOCK, CORNERS), best(BLOCK, CORNERS)
    np.testing.assert_array_equal(plain.grasp.contacts.points, again.grasp.contacts.points)
    assert (plain.value, plain.bound) == (again.value, again.bound)
    small = best(BLOCK.scaled(1e-2), 1e-2 * CORNERS)
    pose = np.eye(4)
    pose[:3, 3] = [500.0, -300.0, 800.0]
    large = best(BLOCK.scaled(100.0).placed(pose), 100.0 * CORNERS + pose[:3, 3])
    for other in (small, large):  # forces do not depend on size; rounding may lead another way
        assert other.value == pytest.approx(plain.value, rel=0.2)
        assert other.bound <= other.value and plain.bound <= other.value * (1 + SOLVED)
    pose[:3, :3] = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    places = CORNERS @ pose[:3, :3].T + pose[:3, 3]
    margins = [
        search(body=body, places=where)
        for body, where in ((BLOCK, CORNERS), (BLOCK.placed(pose), places))
    ]
    assert margins[1].bound == pytest.approx(margins[0].bound, rel=0.06)


@pytest.mark.slow
def test_more_nodes_never_raise_the_bound_nor_lower_the_value():
    few, more = (search(objective="force", nodes=n) for n in (1, 60))
    assert few.bound <= more.bound <= more.value <= few.value


@pytest.mark.slow
def test_loads_and_fingers_and_places_may_be_given():
    weight = np.array([[0.0, 0.0, -1.0, 0.0, 0.0, 0.0]])
    light, heavy = (
        search(objective="force", wrenches=factor * weight, fingers=(3, 4), nodes=8)
        for factor in (1, 3)
    )
    assert [len(g.contacts) for g in light.grasp.grippers] == [3, 4]
    assert heavy.bound == pytest.approx(3 * light.bound, rel=0.2)
    assert light.value >= 1.0 / 3.0  # three contacts at most push up
    some = search(places=0.95 * CORNERS, nodes=10)
    assert all(np.allclose(np.abs(g.corner), 0.95 * CORNERS[0]) for g in some.grasp.grippers)
    quick = search(objective="force", seconds=0.0)
    assert quick.nodes == 0 and quick.bound < quick.value


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"objective": "beauty"}, r"margin, force, stability, not 'beauty'"),
        ({"fingers": (4, 4)}, r"seven contacts together, not \(4, 4\)"),
        ({"gripper_size": 0.0}, r"gripper_size is a length"),
        ({"gripper_size": np.inf}, r"gripper_size is a length"),
        ({"tip_radius": -1.0}, r"tip_radius not negative"),
        ({"gap": 0.0}, r"gap lies between 0 and 1"),
        ({"nodes": 0}, r"nodes is positive"),
        ({"places": [[0.0, 0.0, 0.0]]}, r"places have shape \(M, 3\), two at least"),
        ({"objective": "force", "wrenches": np.ones(6)}, r"wrenches have shape \(K, 6\)"),
        ({"objective": "force", "wrenches": np.zeros((2, 6))}, r"zero loads nothing"),
        ({"faces": [0, 1, 2]}, r"no two places from which seven contacts can close"),
        ({"tip_radius": 0.2}, r"no two places"),
        ({"conditioning": 0.9, "nodes": 30}, r"floor of the conditioning was found"),
    ],
)
def test_impossible_searches_are_refused_with_a_reason(change, says):
    with pytest.raises(GraspError, match=says):
        optimise_grasp(BLOCK, **{"gripper_size": REACH, **change})
