"""Claims about the pose of the body that contacts tell.

Oracles: poses that the data were made from; the thesis's own way through a quadratic for three
pairs of parallel faces; SciPy's least squares from many random starts; differences of the pose.
"""

from __future__ import annotations

import numpy as np
import pytest
from grasp_oracles import plate_with_hole
from refusals import refused
from repository import WORKED
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from multiarm.errors import GraspError
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.pose.object_frame import (
    THESIS_FACES,
    object_frame_from_contacts,
    object_frame_from_faces,
    object_frame_on_body,
)

PAIR = np.array([0, 1, 2, 0, 1, 2, 0])
SIDE = np.array([1, 1, 1, -1, -1, -1, 1])
# Rounding 1e-16 of the size, divided by the smallest conditioning met, 1e-3, and rounded up.
EXACT = 1e-10


def rotation(rng):
    return Rotation.random(rng=rng).as_matrix()


def parallelepiped(rng, *, oblique):
    """Outward normals, the first along x, and face distances."""
    n = np.eye(3)
    if oblique:
        n[1:] += rng.uniform(-0.35, 0.35, (2, 3))
        n /= np.linalg.norm(n, axis=1, keepdims=True)
    return n, rng.uniform(0.5, 2.0, 3)


def contacts_on(rng, n, L, faces=THESIS_FACES):
    """Points inside the faces of a parallelepiped, in its own frame."""
    points = []
    for face in faces:
        w = rng.uniform(-0.45, 0.45, 3) * L
        w[abs(face) - 1] = np.sign(face) * L[abs(face) - 1] / 2
        points.append(np.linalg.solve(n, w))
    return np.array(points)


def well_placed(points, n):
    """Smallest over largest singular value of the wrenches of seven contacts."""
    e = -(SIDE[:, None] * n[PAIR])
    W = np.hstack([e, np.cross(points - points.mean(axis=0), e)])
    s = np.linalg.svd(W, compute_uv=False)
    return s[-1] / s[0]


def thesis_way(points, n, L):
    """Rotation and position by (2.5)-(2.17), put right for oblique bodies and for E = 0."""
    d1, d2 = points[0] - points[3], points[6] - points[3]
    d3, d4 = points[1] - points[4], points[2] - points[5]
    foot = np.linalg.pinv(np.array([d1, d2])) @ [L[0], L[0]]
    k = np.cross(d1, d2) / np.linalg.norm(np.cross(d1, d2))
    rise = np.sqrt(max(0.0, 1.0 - foot @ foot))
    found = []
    for n1 in (foot + rise * k, foot - rise * k):
        n1 = n1 / np.linalg.norm(n1)
        u = np.cross(n1, np.eye(3)[np.argmin(np.abs(n1))])
        u /= np.linalg.norm(u)
        v = np.cross(n1, u)
        A = [[d @ (m[1] * u + m[2] * v), d @ (m[1] * v - m[2] * u)] for m, d in
             ((n[1], d3), (n[2], d4))]  # fmt: skip
        b = [L[1] - n[1][0] * (d3 @ n1), L[2] - n[2][0] * (d4 @ n1)]
        c, s = np.linalg.solve(A, b)
        size = np.hypot(c, s)
        c, s = c / size, s / size
        found.append((abs(size - 1.0), np.column_stack([n1, c * u + s * v, c * v - s * u])))
    R = min(found, key=lambda pair: pair[0])[1]
    world = n @ R.T
    return R, np.linalg.solve(world, np.sum(world * points[:3], axis=1) - L / 2)


# --- three pairs of parallel faces ---------------------------------------------------------------


@pytest.mark.parametrize("name", ["object_frame_block", "object_frame_oblique"])
def test_worked_poses_are_found(name):
    given, expected = WORKED[name]["inputs"], WORKED[name]["expected"]
    frame = object_frame_from_contacts(
        given["points"], given["normals_in_object_frame"], given["distances"]
    )
    np.testing.assert_allclose(frame.rotation, expected["R"], atol=1e-12)
    np.testing.assert_allclose(frame.position, expected["p_o"], atol=1e-12)
    assert not frame.ambiguous and len(frame.candidates) == 1
    turned = Rotation.from_quat(frame.quaternion_xyzw).as_matrix()
    np.testing.assert_allclose(turned, frame.rotation, atol=1e-14)


def test_axes_in_which_the_quadratic_of_the_thesis_breaks_are_not_special():
    given = WORKED["object_frame_E_zero"]["inputs"]
    frame = object_frame_from_contacts(
        given["points"], given["normals_in_object_frame"], given["distances"]
    )
    np.testing.assert_allclose(frame.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(frame.position, 0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("oblique", [False, True])
def test_random_poses_are_found_and_agree_with_the_thesis(rng, oblique):
    checked = 0
    while checked < 150:
        n, L = parallelepiped(rng, oblique=oblique)
        p = contacts_on(rng, n, L)
        if well_placed(p, n) < 1e-3:
            continue
        checked += 1
        R, x = rotation(rng), rng.uniform(-3, 3, 3)
        world = p @ R.T + x
        frame = object_frame_from_contacts(world, n, L)
        poses = [frame, *frame.candidates]
        off = min(np.abs(c.rotation - R).max() + np.abs(c.position - x).max() for c in poses)
        assert off < EXACT
        if not frame.ambiguous:
            R_2, x_2 = thesis_way(world, n, L)
            # The quadratic's root loses half the digits where its two roots meet.
            np.testing.assert_allclose(frame.rotation, R_2, atol=1e-6)
            np.testing.assert_allclose(frame.position, x_2, atol=1e-5)


def test_any_numbering_of_the_faces_gives_the_same_pose(rng):
    n, L = parallelepiped(rng, oblique=True)
    p = contacts_on(rng, n, L) @ (R := rotation(rng)).T + 0.3
    frame = object_frame_from_contacts(p, n, L)
    order = [6, 3, 2, 5, 0, 1, 4]
    other = object_frame_from_contacts(p[order], n, L, faces=[THESIS_FACES[j] for j in order])
    np.testing.assert_allclose(other.pose, frame.pose, atol=EXACT)
    np.testing.assert_allclose(frame.rotation, R, atol=EXACT)


def test_more_than_seven_contacts_are_used(rng):
    n, L = parallelepiped(rng, oblique=True)
    faces = (*THESIS_FACES, -2, 3)
    p = contacts_on(rng, n, L, faces)
    R = rotation(rng)
    frame = object_frame_from_contacts(p @ R.T, n, L, faces=faces)
    np.testing.assert_allclose(frame.rotation, R, atol=EXACT)
    assert frame.residuals.shape == (9,)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e4])
def test_size_and_distance_of_the_body_do_not_matter(rng, size):
    given, expected = (WORKED["object_frame_oblique"][key] for key in ("inputs", "expected"))
    points = size * np.array(given["points"])
    frame = object_frame_from_contacts(
        points, given["normals_in_object_frame"], size * np.array(given["distances"])
    )
    far = object_frame_from_contacts(
        points + 1e3 * size, given["normals_in_object_frame"], size * np.array(given["distances"])
    )
    np.testing.assert_allclose(frame.rotation, expected["R"], atol=EXACT)
    np.testing.assert_allclose(frame.position, size * np.array(expected["p_o"]), atol=size * EXACT)
    np.testing.assert_allclose(far.rotation, frame.rotation, atol=EXACT * 10)
    np.testing.assert_allclose(far.position - 1e3 * size, frame.position, atol=1e-9 * size)
    assert far.conditioning == pytest.approx(frame.conditioning, rel=1e-8)


def test_two_poses_that_fit_are_both_found_and_a_previous_pose_decides(rng):
    """Every contact in its face for two poses at once, both with the body's centre at 0."""
    n, L = np.eye(3), np.array([1.0, 1.2, 0.8])
    Q = Rotation.from_rotvec([0.3, -0.2, 0.25]).as_matrix()
    points = []
    for face in THESIS_FACES:
        a = np.sign(face) * n[abs(face) - 1]
        both = np.array([a, Q @ a])
        along = np.cross(*both) / np.linalg.norm(np.cross(*both))
        foot = np.linalg.pinv(both) @ np.full(2, L[abs(face) - 1] / 2)
        points.append(foot + rng.uniform(-0.25, 0.25) * along)
    frame = object_frame_from_contacts(points, n, L)
    assert frame.ambiguous and "previous" in frame.reason and len(frame.candidates) == 2
    for R in (np.eye(3), Q):
        assert min(np.abs(c.rotation - R).max() for c in frame.candidates) < 1e-9
        near = np.eye(4)
        near[:3, :3] = R @ Rotation.from_rotvec([0.02, 0.01, 0.0]).as_matrix()
        chosen = object_frame_from_contacts(points, n, L, previous=near)
        np.testing.assert_allclose(chosen.rotation, R, atol=1e-9)
        assert not chosen.ambiguous and "nearest" in chosen.reason
        again = object_frame_from_contacts(points, n, L, previous=chosen)
        np.testing.assert_allclose(again.pose, chosen.pose, atol=1e-12)


# --- general bodies ------------------------------------------------------------------------------


def general_contacts(rng, count):
    """Random planes that bound a body about the origin, and a point on each."""
    n = rng.standard_normal((count, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    h = rng.uniform(0.8, 1.2, count)
    side = rng.standard_normal((count, 3))
    side -= np.sum(side * n, axis=1, keepdims=True) * n
    return h[:, None] * n + 0.5 * side, n, h


@pytest.mark.slow
def test_all_poses_of_six_contacts_are_found(rng):
    """Least squares from 300 random starts each finds no pose that is missing."""
    for _ in range(6):
        p, n, h = general_contacts(rng, 6)
        frame = object_frame_from_faces(p, n, h, convex=False)
        known = [c.rotation for c in frame.candidates]
        assert len(known) % 2 == 0 and len(known) <= 8  # real roots of eight
        assert frame.ambiguous == (len(known) > 1)

        def gaps(z, p=p, n=n, h=h):
            return (
                np.sum(n * Rotation.from_rotvec(z[:3]).apply(p - z[3:], inverse=True), axis=1) - h
            )

        for _ in range(40):
            start = np.r_[Rotation.random(rng=rng).as_rotvec(), rng.standard_normal(3)]
            end = least_squares(gaps, start, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=60)
            if np.abs(end.fun).max() < 1e-12:
                R = Rotation.from_rotvec(end.x[:3]).as_matrix()
                assert min(np.abs(R - S).max() for S in known) < 1e-6
        assert min(np.abs(np.eye(3) - S).max() for S in known) < 1e-9


@pytest.mark.parametrize("count", [7, 8, 12])
def test_seven_or_more_contacts_of_a_general_body_fix_the_pose(rng, count):
    for _ in range(20):
        p, n, h = general_contacts(rng, count)
        R, x = rotation(rng), rng.uniform(-2, 2, 3)
        frame = object_frame_from_faces(p @ R.T + x, n, h, convex=False)
        assert frame.conditioning > 0.0 and not frame.ambiguous
        np.testing.assert_allclose(frame.rotation, R, atol=EXACT)
        np.testing.assert_allclose(frame.position, x, atol=10 * EXACT)


def test_the_frame_of_the_body_may_be_anywhere(rng):
    p, n, h = general_contacts(rng, 7)
    shift = np.array([300.0, -200.0, 500.0])
    frame = object_frame_from_faces(p, n, h + n @ shift, convex=False)
    np.testing.assert_allclose(frame.rotation, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(frame.position, -shift, atol=1e-7)


def test_poses_that_miss_the_faces_are_dropped(rng):
    """Six contacts of an oblique box: the convex body and the polygons leave fewer poses."""
    fewer = 0
    for _ in range(10):
        n, L = parallelepiped(rng, oblique=True)
        p = contacts_on(rng, n, L)[:6]
        normals, offsets = SIDE[:6, None] * n[PAIR[:6]], L[PAIR[:6]] / 2
        every = object_frame_from_faces(p, normals, offsets, convex=False)
        inside = object_frame_from_faces(p, normals, offsets)
        cells = [
            np.linalg.solve(n, (np.array(corners) * L[:, None] / 2)).T
            for corners in (_face_corners(face) for face in THESIS_FACES[:6])
        ]
        held = object_frame_from_faces(p, normals, offsets, polygons=cells, convex=False)
        assert len(held.candidates) == len(inside.candidates)
        fewer += len(inside.candidates) < len(every.candidates)
        assert all(candidate.outside < 1e-8 for candidate in inside.candidates)
        assert min(np.abs(c.rotation - np.eye(3)).max() for c in inside.candidates) < 1e-8
    assert fewer > 0


def _face_corners(face):
    """Corners of a face of the cube [-1, 1]^3 in order, as columns."""
    axis = abs(face) - 1
    around = np.array([[1, 1, -1, -1], [1, -1, -1, 1]])
    return np.insert(around, axis, np.sign(face), axis=0)


def test_a_body_tells_its_faces():
    given, expected = (WORKED["object_frame_block"][key] for key in ("inputs", "expected"))
    body = Polyhedron.box(given["distances"])  # faces +x, +y, +z, -x, -y, -z
    frame = object_frame_on_body(given["points"], body, [0, 1, 2, 3, 4, 5, 0])
    np.testing.assert_allclose(frame.rotation, expected["R"], atol=1e-10)


def test_a_pose_with_a_contact_over_a_hole_is_dropped():
    body = plate_with_hole()
    faces = [1, 1, 1, 0, 2, 4, 6]
    points = [[1.5, 1.5, 0], [-1.5, 1, 0], [0.5, -1.5, 0], [1.5, 0, 1]]
    points += [body.faces[k].vertices.mean(axis=0) for k in faces[4:]]
    points = body.on_faces(faces, points)
    assert object_frame_on_body(points, body, faces).candidates[0].outside < 1e-9
    points[3] = [0.0, 0.5, 1.0]
    assert object_frame_on_body(points, body, faces).candidates[0].outside == pytest.approx(0.5)


def test_a_free_motion_is_said():
    """Six contacts, three pairs in line with the centre: no moment is taken."""
    n = np.vstack([np.eye(3), -np.eye(3)])
    p = 0.5 * n
    frame = object_frame_from_faces(p, n, np.full(6, 0.5))
    assert frame.ambiguous and "motion" in frame.reason
    assert frame.conditioning < 1e-7


# --- noise ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_covariance_is_that_of_the_pose_s_derivative_by_the_points(rng):
    given, expected = (WORKED["object_frame_oblique"][key] for key in ("inputs", "expected"))
    points = np.array(given["points"])
    spread = rng.standard_normal((7, 3, 3)) * 1e-5
    sigma = np.einsum("kab,kcb->kac", spread, spread)
    R_0, x_0 = np.array(expected["R"]), np.array(expected["p_o"])

    def pose_error(noise):
        frame = object_frame_from_contacts(
            points + noise, given["normals_in_object_frame"], given["distances"],
            point_covariance=sigma,
        )  # fmt: skip
        assert not frame.ambiguous
        turned = Rotation.from_matrix(frame.rotation @ R_0.T).as_rotvec()
        return np.r_[frame.position - x_0, turned], frame.covariance

    unbiased, covariance = pose_error(np.zeros((7, 3)))
    assert np.abs(unbiased).max() < EXACT
    # each column is what one deviation of one direction of one point does to the pose
    columns = []
    for deviation in [np.eye(7)[k][:, None] * spread[k, :, i] for k in range(7) for i in range(3)]:
        (plus, _), (minus, _) = pose_error(deviation), pose_error(-deviation)
        columns.append((plus - minus) / 2)
    expected = np.transpose(columns) @ columns
    # points are off by 1e-5 of a size of 1: what is of third order is 1e-10 of the differences;
    # the solution's rounding is 1e-12 of them
    whitened = np.linalg.solve(root := np.linalg.cholesky(expected), covariance)
    np.testing.assert_allclose(np.linalg.solve(root, whitened.T), np.eye(6), atol=1e-6)


def test_one_deviation_is_the_same_as_equal_covariances():
    given = WORKED["object_frame_block"]["inputs"]
    args = (given["points"], given["normals_in_object_frame"], given["distances"])
    frames = [
        object_frame_from_contacts(*args, point_covariance=noise)
        for noise in (
            1e-3,
            np.full(7, 1e-3),
            1e-6 * np.eye(3),
            np.tile(1e-6 * np.eye(3), (7, 1, 1)),
        )
    ]
    for frame in frames:
        np.testing.assert_allclose(frame.covariance, frames[0].covariance, rtol=1e-9)
    np.testing.assert_allclose(frames[0].covariance, frames[0].covariance.T, rtol=1e-9)
    assert object_frame_from_contacts(*args).covariance is None
    none = object_frame_from_contacts(*args, point_covariance=0.0)
    np.testing.assert_allclose(none.covariance, 0.0, atol=0.0)


def test_points_known_better_count_more(rng):
    """A point off by a millimetre, and said to be, moves the pose less than one trusted."""
    given, expected = (WORKED["object_frame_block"][key] for key in ("inputs", "expected"))
    args = (given["normals_in_object_frame"], given["distances"])
    points = np.array(given["points"])
    points[0] += 1e-3 * np.array(expected["R"])[:, 0]
    doubt = np.full(7, 1e-6)
    doubt[0] = 1e-3
    plain = object_frame_from_contacts(points, *args)
    weighted = object_frame_from_contacts(points, *args, point_covariance=doubt)
    off = [np.abs(frame.rotation - expected["R"]).max() for frame in (plain, weighted)]
    assert off[1] < 1e-2 * off[0]


def test_rounded_points_are_not_called_a_contradiction():
    given, expected = (WORKED["object_frame_oblique"][key] for key in ("inputs", "expected"))
    rounded = np.round(given["points"], 4)
    frame = object_frame_from_contacts(
        rounded, given["normals_in_object_frame"], given["distances"]
    )
    np.testing.assert_allclose(frame.rotation, expected["R"], atol=2e-3)
    assert 0.0 < np.abs(frame.residuals).max() < 1e-4


# --- what is refused -----------------------------------------------------------------------------


def block(**changes):
    given = WORKED["object_frame_block"]["inputs"]
    values = {
        "points": np.array(given["points"]),
        "normals_in_object_frame": np.array(given["normals_in_object_frame"]),
        "distances": np.array(given["distances"]),
    }
    return {**values, **changes}


def test_contradictions_are_refused_with_the_offender():
    with refused(GraspError, "contacts 1 and 4 are on faces 1 and -1, 2 m apart"):
        object_frame_from_contacts(**block(distances=[2.0, 1.2, 1.0]))
    with refused(GraspError, "no pose of the body fits"):
        object_frame_from_contacts(**block(distances=[0.4, 1.2, 1.0]))
    coincident = block()["points"].copy()
    coincident[6] = coincident[0]
    with refused(GraspError, "contacts 1 and 7, both on face 1, coincide"):
        object_frame_from_contacts(**block(points=coincident))
    with refused(GraspError, "[-2]"):
        object_frame_from_contacts(**block(faces=[1, 2, 3, -1, 2, -3, 1]))
    with refused(GraspError, "7 numbers for 6 points"):
        object_frame_from_contacts(**block(points=block()["points"][:6]))
    with refused(GraspError, "positive"):
        object_frame_from_contacts(**block(distances=[0.8, 0.0, 1.0]))
    with refused(GraspError, "distances has shape (3,)"):
        object_frame_from_contacts(**block(distances=[0.8, 1.0]))
    noisy = block()["points"] + 1e-3 * np.random.default_rng(1).standard_normal((7, 3))
    with refused(GraspError, "point_covariance or tolerance"):
        object_frame_from_contacts(**block(points=noisy, point_covariance=1e-6))


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"points": np.zeros((5, 3))}, "six contacts at least"),
        ({"points": np.zeros((6, 3))}, "coincide"),
        ({"points": np.full((6, 3), np.nan)}, "finite"),
        ({"points": "seven"}, "vectors of three numbers, not 'seven'"),
        ({"normals": np.tile([[1.0, 0, 0], [0, 1.0, 0]], (3, 1))}, "lie in one plane"),
        ({"normals": 2 * np.eye(3)[[0, 1, 2, 0, 1, 2]]}, "has length 2"),
        ({"offsets": [1.0]}, "finite offsets"),
        ({"offsets": ["far"] * 6}, "finite offsets, not ['far'"),
        ({"point_covariance": "small"}, "point_covariance is"),
        ({"point_covariance": -1.0}, "not negative"),
        ({"point_covariance": np.zeros(4)}, "one for each of the 6 points"),
        ({"point_covariance": np.diag([1.0, 1.0, -1.0])}, "negative eigenvalue"),
        ({"point_covariance": np.triu(np.ones((3, 3)))}, "symmetric"),
        ({"polygons": [np.eye(3)]}, "as many polygons"),
        ({"previous": np.eye(3)}, "previous is a pose"),
    ],
)
def test_unusable_data_are_refused_by_name(change, place):
    n = np.vstack([np.eye(3), -np.eye(3)])
    turned = n @ Rotation.from_rotvec([0.3, 0.2, -0.4]).as_matrix().T
    values = {"points": 0.5 * n + 0.2 * turned, "normals": n, "offsets": np.full(6, 0.5)}
    with refused(GraspError, place):
        object_frame_from_faces(**{**values, **change})


# --- bodies that are not convex, and arguments that are none -------------------------------------

L_PRISM = Polyhedron.prism([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], 1.0)


def on_surface(body, count, rng):
    """Contacts at random places of faces that look in many directions: points and face numbers."""
    numbers = rng.permutation(np.arange(count) % len(body.faces))
    points = []
    for number in numbers:
        face = body.faces[number]
        while True:
            low, high = face.vertices.min(axis=0), face.vertices.max(axis=0)
            point = rng.uniform(low, high)
            point -= (face.normal @ point - face.offset) * face.normal
            if face.contains(point):
                break
        points.append(point)
    return np.array(points), numbers


def test_the_pose_of_a_body_that_is_not_convex_is_among_those_found(rng):
    """A contact in the notch lies beyond the plane of a face that another one touches."""
    assert not L_PRISM.convex
    single = 0
    for trial in range(25):
        points, numbers = on_surface(L_PRISM, 8, rng)
        R, x = Rotation.random(random_state=trial).as_matrix(), rng.normal(size=3)
        found = object_frame_on_body(points @ R.T + x, L_PRISM, numbers)
        off = [np.abs(c.rotation - R).max() for c in found.candidates]
        assert min(off) < 1e-8
        if not found.ambiguous:
            single += 1
            assert off[0] < 1e-8
    assert single > 5


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"faces": [0, 1, 2, 3, 4, 5, 99]}, "faces of the body are 0 to 7, not 99"),
        ({"faces": [0, 1, 2, 3, 4, 5, -1]}, "faces of the body are 0 to 7, not -1"),
        ({"faces": [0.5, 1, 2, 3, 4, 5, 6]}, "faces are whole numbers"),
        ({"faces": "abcdefg"}, "faces are whole numbers"),
        ({"tolerance": np.nan}, "tolerance is a length greater than 0"),
        ({"tolerance": -1.0}, "tolerance is a length greater than 0"),
        ({"previous": np.zeros((4, 4))}, "previous is a pose"),
        ({"previous": np.diag([1.0, 1.0, -1.0, 1.0])}, "previous is a pose"),
    ],
)
def test_what_is_no_face_tolerance_or_pose_is_refused(change, place, rng):
    points, numbers = on_surface(L_PRISM, 7, rng)
    given = {"faces": numbers, **change}
    with refused(GraspError, place):
        object_frame_on_body(points, L_PRISM, **given)
