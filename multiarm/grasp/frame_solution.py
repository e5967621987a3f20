r"""The poses that fit contacts on faces: which of them is chosen, and how well it is known.

*Which pose.* Six contacts leave up to eight poses, seven in general one. A pose in which a contact
lies beyond another touched face of a convex body, or outside the polygon of its own face, is
dropped when another remains. Then the nearest to a previous pose is taken if there is one; else the
best fit, and ``ambiguous`` is said.

*Accuracy.* With :math:`J` of rows :math:`-[n_k^T, ((p_k - p_o) \times n_k)^T]` (world axes), the
residuals change by :math:`J [\delta p_o; \delta\theta] + n_k^T \delta p_k`. Residual k has the
variance :math:`s_k = n_k^T \Sigma_k n_k`, and the pose, by weighted least squares, the covariance
:math:`(J^T \mathrm{diag}(s)^{-1} J)^{-1}`. J is minus the transpose of the wrenches: form closure
gives it rank 6, hence a pose that is locally unique.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.frame_data import ContactData, numbers_of, outside
from multiarm.grasp.rotations_from_planes import (
    RotationEquations,
    angle_between,
    quaternion_of,
    rotations_of,
)

# Largest residual that still is noise, over the size of the grasp, unless the caller says.
CONTRADICTION = 1e-2
# Residuals of exact data over the size of the grasp: rounding, times what the equations amplify.
ROUNDING = 1e-9
# Poses whose residual is within so many times that of the best fit as well as the best.
AS_GOOD = 3.0
# Standard deviations within which a residual is noise.
DEVIATIONS = 5.0
# A point without error counts as known so much better than the least known one.
WITHOUT_ERROR = 1e-5
# Smallest singular value of the scaled J, over the largest, of a locally unique pose.
UNIQUE = 1e-7
# A previous pose is rigid when R R^T is the identity to this.
RIGID = 1e-6
# The nearest pose to the previous one decides when the next is so much farther away.
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
        How far a contact lies outside the face it is said to touch [m]; 0 when all are inside.
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
        return _pose(self.rotation, self.position)


def solved(data: ContactData, previous: Any, tolerance: float | None) -> ObjectFrame:
    """Every pose that fits, then the choice."""
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
    q = quaternion_of(first.rotation)
    if before is not None and q @ quaternion_of(before[:3, :3]) < 0.0:
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
    found = []
    for R in rotations_of(equations, known):
        x = data.position(R, weights)
        gaps = np.abs(data.residuals(R, x))
        pose = FrameCandidate(R, x, float(gaps.max()), outside(data, R, x))
        found.append((float((weights * gaps).max()), pose))
    found.sort(key=lambda pair: pair[0])
    best, pose = found[0]
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
    return tuple(pose for misfit, pose in found if misfit <= limit)


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
    moved[:3, 3:] = np.cross(np.eye(3), lever).T  # theta -> theta x lever
    G = moved @ G
    return conditioning, (G * variances) @ G.T


def _previous_pose(previous: Any) -> np.ndarray | None:
    if previous is None or isinstance(previous, ObjectFrame):
        return None if previous is None else previous.pose
    pose = numbers_of(previous, (4, 4), "previous")
    R = pose[:3, :3]
    turned = np.abs(R @ R.T - np.eye(3)).max() < RIGID and np.linalg.det(R) > 0.0
    if not turned or np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > RIGID:
        raise GraspError("previous is a pose: a rotation (3, 3) and a position, no scale or mirror")
    return pose


def _pose(R: np.ndarray, x: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, x
    return pose
