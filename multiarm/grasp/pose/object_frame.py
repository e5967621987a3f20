r"""The pose of the body from the positions of the fingertips (thesis, 2.4).

In a form-closure grasp the body cannot move while the grippers stand still; so the contact points,
and the face that each touches, determine the pose (R, p_o) of its frame (thesis, 2.4). For contact
k on a face with outward normal :math:`n_k` and offset :math:`h_k` in the body's frame

.. math:: n_k^T R^T (p_k - p_o) = h_k, \qquad k = 1 \dots N .

For three pairs of parallel faces at distances :math:`l_i`, the origin half way between them, h is
l / 2 on both faces of a pair: (2.5)-(2.9) and (2.15)-(2.17) in one. The thesis solves a quadratic
in one component of :math:`n_1`, which breaks when E = 0 in (2.10), and its (2.11)-(2.13) hold for
rectangular blocks only. Here all N equations are solved together, for any body
(:mod:`multiarm.grasp.pose.rotations_from_planes`): no axes are special, oblique and general bodies
are no harder, and the result has all poses that fit.

*Which pose.* Six contacts leave up to eight poses, seven in general one. A pose in which a contact
lies beyond another touched face of a convex body, or outside the polygon of its own face, is
dropped when another remains. Then the nearest to a previous pose is taken if there is one; else the
best fit, and the result is ``ambiguous``.

*Accuracy.* With :math:`J` of rows :math:`-[n_k^T, ((p_k - p_o) \times n_k)^T]` (world axes), the
residuals change by :math:`J [\delta p_o; \delta\theta] + n_k^T \delta p_k`. Residual k has the
variance :math:`s_k = n_k^T \Sigma_k n_k`, and the pose, by weighted least squares, the covariance
:math:`(J^T \mathrm{diag}(s)^{-1} J)^{-1}`. J is minus the transpose of the wrenches: form closure
gives it rank 6, hence a pose that is locally unique.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.geometry.poses import pose_matrix
from multiarm.geometry.screws import skew
from multiarm.grasp.arguments import numbers_of, pose_of
from multiarm.grasp.pose.rotations_from_planes import (
    ContactData,
    RotationEquations,
    angle_between,
    contact_data,
    outside,
    rotations_of,
    table_of,
)
from multiarm.notation import count_of

if TYPE_CHECKING:
    from multiarm.grasp.body.polyhedron import Polyhedron

__all__ = [
    "FrameCandidate",
    "ObjectFrame",
    "object_frame_from_contacts",
    "object_frame_from_faces",
    "object_frame_on_body",
]

# The thesis's numbering: contacts 1 and 7 on face +1, 2 and 3 on +2 and +3, 4 to 6 opposite.
THESIS_FACES = (1, 2, 3, -1, -2, -3, 1)


def object_frame_from_contacts(
    points: Any,
    normals_in_object_frame: Any,
    distances: Any,
    *,
    faces: Sequence[int] = THESIS_FACES,
    point_covariance: Any = None,
    previous: ObjectFrame | Any = None,
    tolerance: float | None = None,
) -> ObjectFrame:
    """Pose of a body with three pairs of parallel faces, thesis (2.5)-(2.17).

    Parameters
    ----------
    points : array-like, shape (N, 3)
        Contact points in the world [m], N >= 7.
    normals_in_object_frame : array-like, shape (3, 3)
        Row i: outward unit normal of face +(i + 1), in object axes.
    distances : array-like, shape (3,)
        Distance between the two faces of each pair [m].
    faces : sequence of int
        Face of each contact: 1, 2, 3, or -1, -2, -3 for the opposite one.  Each occurs.  As in the
        thesis by default: contacts 1 and 7 on +1, 2 on +2, 3 on +3, 4, 5, 6 opposite.
    point_covariance, previous, tolerance
        As in :func:`object_frame_from_faces`.

    Returns
    -------
    ObjectFrame
        Its origin is half way between the faces of every pair.

    Raises
    ------
    GraspError
        Shapes; a pair of faces without a contact on both; contacts of one face that coincide, so
        that fewer than seven remain; distances that no pose fits.
    """
    needed = "normals_in_object_frame has shape (3, 3): a finite normal for each pair of faces"
    normals = numbers_of(normals_in_object_frame, needed, (3, 3))
    lengths = numbers_of(distances, "distances has shape (3,) and finite numbers", (3,))
    if np.any(lengths <= 0.0):
        raise GraspError(f"distances between parallel faces are positive, not {lengths.tolist()}")
    at = table_of(points, "points")
    numbers = _pairs(faces, at)
    pair, side = np.abs(numbers) - 1, np.sign(numbers)
    data = contact_data(
        at, side[:, None] * normals[pair], 0.5 * lengths[pair], point_covariance=point_covariance
    )
    _far_enough(data, numbers, lengths)
    return solved(data, previous, tolerance)


def object_frame_from_faces(
    points: Any,
    normals: Any,
    offsets: Any,
    *,
    polygons: Sequence[Any] | None = None,
    convex: bool = True,
    point_covariance: Any = None,
    previous: ObjectFrame | Any = None,
    tolerance: float | None = None,
) -> ObjectFrame:
    """Pose of any body with plane faces, from N >= 6 contacts.

    Parameters
    ----------
    points : array-like, shape (N, 3)
        Contact points in the world [m].
    normals : array-like, shape (N, 3)
        Row k: outward unit normal of the face that contact k touches, in object axes.
    offsets : array-like, shape (N,)
        ``n_k . b`` for points b of that face, in the object's frame [m].
    polygons : sequence of Face or array-like, shape (K, 3) each, optional
        That face, or its corners in order, in the object's frame.
    convex : bool
        The body is convex: no contact lies beyond a face that another one touches.
    point_covariance : float or array-like, optional
        Of the points: one standard deviation [m], one per point (N,), or covariances (3, 3) or
        (N, 3, 3) in world axes [m^2].
    previous : ObjectFrame or array-like, shape (4, 4), optional
        A pose nearby; chooses when several fit.
    tolerance : float, optional
        Largest residual that is taken for noise [m]; five standard deviations, or a hundredth of
        the size of the grasp without ``point_covariance``.

    Returns
    -------
    ObjectFrame

    Raises
    ------
    GraspError
        Shapes, fewer than six contacts, normals that do not span space, data that no pose fits.
    """
    data = contact_data(
        points,
        normals,
        offsets,
        polygons=polygons,
        convex=convex,
        point_covariance=point_covariance,
    )
    return solved(data, previous, tolerance)


def object_frame_on_body(
    points: Any,
    body: Polyhedron,
    faces: Sequence[int],
    *,
    point_covariance: Any = None,
    previous: ObjectFrame | Any = None,
    tolerance: float | None = None,
) -> ObjectFrame:
    """Pose of a polyhedron; contact k touches ``body.faces[faces[k]]``.

    Otherwise as :func:`object_frame_from_faces`, which it calls with the faces' polygons, and with
    what is known of the body: on one that is not convex a contact may lie beyond the plane of a
    face that another one touches.

    Raises
    ------
    GraspError
        Numbers that are those of no face; and as there.
    """
    numbers = _integers(faces)
    wrong = [k for k in numbers.tolist() if k not in range(len(body.faces))]
    if wrong:
        raise GraspError(f"faces of the body are 0 to {len(body.faces) - 1}, not {wrong[0]}")
    touched = [body.faces[k] for k in numbers]
    return object_frame_from_faces(
        points,
        [face.normal for face in touched],
        [face.offset for face in touched],
        polygons=touched,
        convex=body.convex,
        point_covariance=point_covariance,
        previous=previous,
        tolerance=tolerance,
    )


def _integers(faces: Sequence[int]) -> np.ndarray:
    numbers = np.asarray(list(faces))
    if numbers.ndim != 1 or numbers.dtype.kind not in "iuf" or np.any(numbers != np.round(numbers)):
        raise GraspError(f"faces are whole numbers, one for each contact, not {list(faces)!r}")
    return numbers.astype(int)


def _pairs(faces: Sequence[int], points: np.ndarray) -> np.ndarray:
    """Face numbers as an array; every face of the three pairs must be touched."""
    numbers = _integers(faces)
    if len(numbers) != len(points):
        raise GraspError(
            f"each contact needs the number of its face: {count_of(len(numbers), 'number')} for "
            f"{count_of(len(points), 'point')}; seven in the thesis's order need none, others "
            "need faces="
        )
    missing = [k for k in (1, 2, 3, -1, -2, -3) if k not in numbers]
    if missing or np.any(np.abs(numbers) > 3) or np.any(numbers == 0):
        raise GraspError(
            f"faces are 1, 2, 3 and -1, -2, -3 for the opposite ones, each with a contact; missing "
            f"in {numbers.tolist()}: {missing}. Form closure needs a contact on each face"
        )
    return numbers


def _far_enough(data: ContactData, numbers: np.ndarray, lengths: np.ndarray) -> None:
    """Seven different contacts; those on opposite faces at least the faces' distance apart."""
    apart = np.linalg.norm(data.points[:, None] - data.points[None], axis=-1)
    same = [
        (i + 1, j + 1)
        for i in range(data.count)
        for j in range(i)
        if numbers[i] == numbers[j] and apart[i, j] <= ROUNDING * data.length
    ]
    if data.count - len(same) < 7:
        if same:
            j, i = sorted(same[0])
            raise GraspError(
                f"contacts {j} and {i}, both on face {numbers[i - 1]}, coincide; seven different "
                f"contacts are needed, two of them apart on one face"
            )
        raise GraspError(f"seven contacts are needed, not {data.count}")
    slack = max(CONTRADICTION * data.length, DEVIATIONS * data.deviation)
    for i, j in np.argwhere(numbers[:, None] + numbers[None] == 0):
        if apart[i, j] < lengths[abs(numbers[i]) - 1] - slack:
            raise GraspError(
                f"contacts {i + 1} and {j + 1} are on faces {numbers[i]} and {numbers[j]}, "
                f"{lengths[abs(numbers[i]) - 1]:.6g} m apart, but only {apart[i, j]:.6g} m from "
                f"each other"
            )


# --- Which pose, and how well it is known ---------------------------------------------------------

# Largest residual that counts as noise, over the size of the grasp, by default.
CONTRADICTION = 1e-2
# Residuals of exact data over the size of the grasp: rounding, times what the equations amplify.
ROUNDING = 1e-9
# Poses with a residual up to this multiple of the smallest fit as well as the best.
AS_GOOD = 3.0
# Standard deviations within which a residual is noise.
DEVIATIONS = 5.0
# A point without error counts as known by this factor better than the least known one.
WITHOUT_ERROR = 1e-5
# Smallest singular value of the scaled J, over the largest, of a locally unique pose.
UNIQUE = 1e-7
# The pose nearest to the previous one is chosen if the next is this factor farther away.
NEARER = 1.5


@dataclass(frozen=True, eq=False)
class FrameCandidate:
    """One pose that fits the contacts.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        Object axes to world axes.
    position : ndarray, shape (3,)
        Origin of the object's frame in the world [m].
    residual : float
        Largest distance of a contact from the plane of its face [m].
    outside : float
        How far a contact lies outside its face [m]; 0 when all are inside.
    """

    rotation: np.ndarray
    position: np.ndarray
    residual: float
    outside: float


@dataclass(frozen=True, eq=False)
class ObjectFrame:
    """Pose of the object's frame in the world.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
        R, object axes to world axes.
    position : ndarray, shape (3,)
        p_o, origin of the object's frame in the world [m].
    quaternion_xyzw : ndarray, shape (4,)
        The rotation; w >= 0, or on the side of the previous pose.
    residuals : ndarray, shape (N,)
        Distance of each contact from the plane of its face, outside positive [m].
    candidates : tuple of FrameCandidate
        All poses that fit, the chosen one first.
    ambiguous : bool
        Whether the contacts leave more than this pose.
    reason : str
        Why it is ambiguous, or how the choice was made; empty when there was none to make.
    conditioning : float
        Smallest singular value of the scaled J over the largest; 0: a motion is possible.
    covariance : ndarray, shape (6, 6), or None
        Of [position; rotation vector], world axes [m^2, m, 1]; None without ``point_covariance``.
    """

    rotation: np.ndarray
    position: np.ndarray
    quaternion_xyzw: np.ndarray
    residuals: np.ndarray
    candidates: tuple[FrameCandidate, ...]
    ambiguous: bool
    reason: str
    conditioning: float
    covariance: np.ndarray | None

    @property
    def pose(self) -> np.ndarray:
        """Homogeneous matrix, object to world, shape (4, 4)."""
        return pose_matrix(self.rotation, self.position)


def solved(data: ContactData, previous: Any, tolerance: float | None) -> ObjectFrame:
    """Every pose that fits, then the choice."""
    from scipy.spatial.transform import Rotation

    if tolerance is not None and not tolerance > 0.0:
        raise GraspError(f"tolerance is a length greater than 0 [m], not {tolerance!r}")
    before = _previous_pose(previous)
    noise = DEVIATIONS * data.deviation
    candidates = _candidates(data, np.ones(data.count), noise, tolerance)
    if data.covariance is not None and noise > 0.0:
        deviations = _deviations(data, candidates[0].rotation)
        known = np.array([candidate.rotation for candidate in candidates])
        weights, noise = deviations.min() / deviations, DEVIATIONS * float(deviations.min())
        candidates = _candidates(data, weights, noise, tolerance, known)
    chosen, ambiguous, reason = _choice(candidates, data, before)
    first = chosen[0]
    conditioning, covariance = _certainty(data, first)
    if conditioning < UNIQUE:
        ambiguous = True
        reason = "the contacts leave a motion free: the pose is not even locally unique"
    q = Rotation.from_matrix(first.rotation).as_quat(canonical=True)
    if (
        before is not None
        and q @ Rotation.from_matrix(before[:3, :3]).as_quat(canonical=True) < 0.0
    ):
        q = -q
    return ObjectFrame(
        rotation=first.rotation,
        position=first.position,
        quaternion_xyzw=q,
        residuals=data.residuals(first.rotation, first.position),
        candidates=chosen,
        ambiguous=ambiguous,
        reason=reason,
        conditioning=conditioning,
        covariance=covariance,
    )


def _candidates(
    data: ContactData,
    weights: np.ndarray,
    noise: float,
    tolerance: float | None,
    known: np.ndarray | None = None,
) -> tuple[FrameCandidate, ...]:
    """Poses that fit about as well as the best, best first; residuals count by their weights."""
    L = data.length
    equations = RotationEquations.of(data.points / L, data.normals, data.offsets / L, weights)
    poses = []
    for R in rotations_of(equations, known):
        x = data.position(R, weights)
        gaps = np.abs(data.residuals(R, x))
        pose = FrameCandidate(R, x, float(gaps.max()), outside(data, R, x))
        poses.append((float((weights * gaps).max()), pose))
    poses.sort(key=lambda pair: pair[0])
    best, pose = poses[0]
    expected = CONTRADICTION * L if data.covariance is None else noise
    limit = tolerance if tolerance is not None else max(expected, ROUNDING * L)
    if best > limit:
        raise GraspError(
            f"no pose of the body fits: the best leaves a contact {pose.residual:.3g} m off its "
            f"face, where {limit:.3g} m would pass for noise; check the order of the contacts, the "
            f"faces they are said to touch and the distances, or give point_covariance or "
            f"tolerance for noisy points"
        )
    limit = max(AS_GOOD * best, noise, ROUNDING * L)
    return tuple(pose for misfit, pose in poses if misfit <= limit)


def _choice(
    candidates: tuple[FrameCandidate, ...], data: ContactData, before: np.ndarray | None
) -> tuple[tuple[FrameCandidate, ...], bool, str]:
    """Candidates, the chosen one first; whether others remain; why."""
    slack = max(ROUNDING * data.length, DEVIATIONS * data.deviation)
    inside = [c for c in candidates if c.outside <= max(slack, AS_GOOD * c.residual)]
    remain = inside or list(candidates)
    if len(remain) == 1:
        return (remain[0],), False, ""
    if before is None:
        return tuple(remain), True, f"{len(remain)} poses fit these contacts; give a previous pose"
    off = [_apart(candidate, before, data.length) for candidate in remain]
    order = np.argsort(off)
    ordered = tuple(remain[k] for k in order)
    if off[order[1]] < NEARER * off[order[0]]:
        return ordered, True, f"{len(remain)} poses fit, and two are as near to the previous pose"
    return ordered, False, f"{len(remain)} poses fit; the nearest to the previous one was taken"


def _apart(candidate: FrameCandidate, pose: np.ndarray, length: float) -> float:
    """Distance of poses [m]: translation, and rotation times the size of the grasp."""
    turned = float(angle_between(candidate.rotation, pose[:3, :3]))
    return float(np.linalg.norm(candidate.position - pose[:3, 3])) + length * turned


def _deviations(data: ContactData, R: np.ndarray) -> np.ndarray:
    """Standard deviation of each residual [m]; a point without error counts as nearly so."""
    deviations = np.sqrt(data.variances(R))
    return np.maximum(deviations, WITHOUT_ERROR * deviations.max())


def _certainty(data: ContactData, pose: FrameCandidate) -> tuple[float, np.ndarray | None]:
    """Conditioning of J, and the covariance of [position; rotation vector]."""
    scale = np.r_[np.ones(3), np.full(3, 1.0 / data.length)]
    J = data.jacobian(pose.rotation, data.centre) * scale  # about the middle of the contacts
    singular = np.linalg.svd(J, compute_uv=False)
    conditioning = float(singular[-1] / singular[0])
    if data.covariance is None or conditioning < UNIQUE:
        return conditioning, None
    variances = data.variances(pose.rotation)
    if not variances.any():
        return conditioning, np.zeros((6, 6))
    w = 1.0 / _deviations(data, pose.rotation)
    G = scale[:, None] * np.linalg.pinv(w[:, None] * J) * w  # (6, N)
    lever = pose.position - data.centre
    moved = np.eye(6)  # from the middle of the contacts to the origin of the body's frame
    moved[:3, 3:] = -skew(lever)  # theta -> theta x lever
    G = moved @ G
    return conditioning, (G * variances) @ G.T


def _previous_pose(previous: Any) -> np.ndarray | None:
    if previous is None or isinstance(previous, ObjectFrame):
        return None if previous is None else previous.pose
    needed = "previous is a pose (4, 4): a rotation and a position, no scale or mirror"
    return pose_of(previous, needed)
