r"""Contacts on planes, and all rotations that place them there.

Points are kept from their mean, planes from the point of the body that lies nearest to all of them:
a body far from the origin of its own frame, or far from that of the world, loses no digits.

**Quadrics in the quaternion, solved completely.**  Contact k touches the plane of the body with
outward normal :math:`n_k` and offset :math:`h_k`. In the world it is seen at :math:`p_k`. The pose
(R, x) of the body satisfies

.. math:: n_k^T R^T (p_k - x) = h_k, \qquad k = 1 \dots N .

With :math:`y = R^T x` this is linear in R and y together. With C a basis of the left null space of
:math:`[n_1 \dots n_N]^T`, C takes y out: what remains are N - 3 equations for the rotation alone,

.. math::
    \langle R, M_i \rangle = g_i, \qquad
    M_i = \sum_k C_{ik}\, p_k n_k^T, \quad g_i = \sum_k C_{ik} h_k .

In a unit quaternion q each is a quadric :math:`q^T (K(M_i) - g_i I) q = 0` (Davenport's K). Three
general combinations of them are three quadrics in projective space. When these meet in finitely
many points there are eight, complex ones counted with multiplicity (Bezout), and every exact
solution of all N - 3 equations is one of the eight. They are found from the null space of the
Macaulay matrix of degree 4 (all products of the quadrics with the ten monomials of degree 2): it is
spanned by the vectors of monomials at the eight points, and multiplication by one linear form over
another is an eigenvalue problem of size 8. No start values, no choice of axes.

With noise there need be no exact solution. The eight points, and for N > 6 also a grid of
rotations, are then starts of Levenberg-Marquardt's method on the N - 3 residuals; C has orthonormal
rows, so that their sum of squares is the least over all positions x.

References: Cox, Little, O'Shea, *Using Algebraic Geometry*, 2005, ch. 3; Horn, "Closed-form
solution of absolute orientation using unit quaternions", JOSA A 4, 1987.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of, unit_vectors
from multiarm.grasp.body.face import Face, as_face
from multiarm.notation import count_of

# Normals span space when the third singular value is above this part of the first.
SPANNING = 1e-9
# A covariance is symmetric and not negative within this part of its largest entry.
COVARIANCE_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class ContactData:
    """Contacts on faces of a body whose pose is sought.

    Attributes
    ----------
    points : ndarray, shape (N, 3)
        Contact points less ``centre``, world axes [m].
    normals : ndarray, shape (N, 3)
        Outward normals of the faces, object axes.
    offsets : ndarray, shape (N,)
        Offsets of the faces from ``origin`` [m].
    centre : ndarray, shape (3,)
        Mean of the points in the world [m].
    origin : ndarray, shape (3,)
        The point of the body, in its own frame, that offsets count from [m].
    length : float
        Root mean square distance of the points from their mean [m].
    faces : tuple of Face, or None
        That each contact touches, in the body's frame.
    convex : bool
        Whether the body lies on the inner side of all its faces.
    covariance : ndarray, shape (N, 3, 3), or None
        Of the points, world axes [m^2].
    """

    points: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    centre: np.ndarray
    origin: np.ndarray
    length: float
    faces: tuple[Face, ...] | None
    convex: bool
    covariance: np.ndarray | None

    @property
    def count(self) -> int:
        """Number N of contacts."""
        return len(self.points)

    @property
    def deviation(self) -> float:
        """Largest standard deviation of a point in any direction [m]; 0 if none is known."""
        if self.covariance is None:
            return 0.0
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[:, -1].max().clip(0.0)))

    def variances(self, R: np.ndarray) -> np.ndarray:
        """Variance of each residual, ``n^T Sigma n`` [m^2], shape (N,); 0 if not known."""
        if self.covariance is None:
            return np.zeros(self.count)
        n = self.normals @ R.T
        return np.einsum("ka,kab,kb->k", n, self.covariance, n).clip(0.0)

    def position(self, R: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Origin of the body's frame in the world, by weighted least squares, shape (3,)."""
        gaps = np.sum(self.normals * (self.points @ R), axis=1) - self.offsets
        rows = weights[:, None] * self.normals
        y = np.linalg.lstsq(rows, weights * gaps, rcond=None)[0]
        return self.centre + R @ (y - self.origin)

    def in_body(self, R: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Points in the body's frame, from ``origin``, shape (N, 3)."""
        return (self.points + (self.centre - x)) @ R - self.origin

    def residuals(self, R: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Distances from the planes, outside positive [m], shape (N,)."""
        return np.sum(self.normals * self.in_body(R, x), axis=1) - self.offsets

    def jacobian(self, R: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Rows ``-[n, (p - x) x n]`` in world axes, shape (N, 6)."""
        n = self.normals @ R.T
        return -np.hstack([n, np.cross(self.points + (self.centre - x), n)])


def contact_data(
    points: Any,
    normals: Any,
    offsets: Any,
    *,
    polygons: Sequence[Any] | None = None,
    convex: bool = True,
    point_covariance: Any = None,
) -> ContactData:
    """Check and centre the caller's data.

    Raises
    ------
    GraspError
        Shapes, numbers that are not finite, fewer than six contacts, normals that do not span.
    """
    p = table_of(points, "points")
    if len(p) < 6:
        raise GraspError(f"six contacts at least fix a pose; {len(p)} were given")
    needed = f"{len(p)} points need as many normals and finite offsets"
    n = unit_vectors(numbers_of(normals, needed, p.shape))
    h = numbers_of(offsets, needed, (len(p),))
    singular = np.linalg.svd(n, compute_uv=False)
    if singular[2] <= SPANNING * singular[0]:
        raise GraspError(
            "the normals of the touched faces lie in one plane: the body can slide along the "
            "direction perpendicular to them; touch a face across it"
        )
    centre = p.mean(axis=0)
    p = p - centre
    length = float(np.sqrt(np.mean(np.sum(p * p, axis=1))))
    if length == 0.0:
        raise GraspError("all contact points coincide; contacts on different faces are needed")
    origin = np.linalg.lstsq(n, h, rcond=None)[0]
    return ContactData(
        points=p,
        normals=n,
        offsets=h - n @ origin,
        centre=centre,
        origin=origin,
        length=length,
        faces=_faces(polygons, len(p)),
        convex=convex,
        covariance=_covariances(point_covariance, len(p)),
    )


def outside(data: ContactData, R: np.ndarray, x: np.ndarray) -> float:
    """Largest distance of a contact from the inside of its face [m]; 0 when all are inside."""
    at = data.in_body(R, x)
    worst = 0.0
    if data.convex:
        worst = max(worst, float((at @ data.normals.T - data.offsets).max()))
    if data.faces is not None:
        for point, face in zip(at + data.origin, data.faces, strict=True):
            worst = max(worst, -float(face.room(point)))
    return worst


def table_of(values: Any, what: str) -> np.ndarray:
    """Finite vectors, shape (N, 3), own memory."""
    return numbers_of(values, f"{what} are finite vectors of three numbers", (-1, 3))


def _faces(polygons: Sequence[Any] | None, count: int) -> tuple[Face, ...] | None:
    if polygons is None:
        return None
    if len(polygons) != count:
        raise GraspError(
            f"{count_of(count, 'contact')} must have as many polygons, not {len(polygons)}"
        )
    return tuple(map(as_face, polygons))


def _covariances(deviations: Any, count: int) -> np.ndarray | None:
    """Covariance of every point (N, 3, 3) from a deviation, one per point, or matrices."""
    if deviations is None:
        return None
    needed = (
        f"point_covariance is one standard deviation, one for each of the {count} points, or "
        f"covariances of shape (3, 3) or ({count}, 3, 3)"
    )
    value = numbers_of(deviations, needed, (), (count,), (3, 3), (count, 3, 3))
    if value.ndim < 2:
        spread = np.broadcast_to(value, (count,))
        matrices = spread[:, None, None] ** 2 * np.eye(3)
    else:
        matrices = np.broadcast_to(value, (count, 3, 3)).copy()
    largest = float(np.abs(matrices).max())
    skewed = np.abs(matrices - matrices.transpose(0, 2, 1)).max()
    if skewed > COVARIANCE_ROUNDING * largest:
        raise GraspError("point_covariance must be symmetric")
    if value.ndim < 2 and np.any(value < 0.0):
        raise GraspError("point_covariance: standard deviations are not negative")
    lowest = np.linalg.eigvalsh(matrices)[:, 0]
    if np.any(lowest < -COVARIANCE_ROUNDING * largest):
        raise GraspError("point_covariance has a negative eigenvalue: it is no covariance")
    return matrices


# --- All rotations that place points on planes ----------------------------------------------------

# The Macaulay matrix has no further null vectors when its 27th singular value is above this part
# of the first; rounding leaves about 1e-15, a family of solutions 0.
NULL_TOLERANCE = 1e-11
# Residuals of exact data, over the size of their terms: rounding, amplified.
EXACT = 1e-10
# Two rotations [rad] this near are one solution.
SAME_ROTATION = 1e-6
# Levenberg-Marquardt ends when the step [rad] is below this, when even a heavily damped step is no
# better, or after this number of steps.
SMALLEST_STEP = 1e-15
LARGEST_DAMPING = 1e3
STEPS = 60
# An end is a minimum when a further step would take off at most this part of the residual.
STATIONARY = 1e-3


@dataclass(frozen=True, eq=False)
class RotationEquations:
    """The equations ``<R, M_i> = g_i``, position taken out.

    Attributes
    ----------
    M : ndarray, shape (N - 3, 3, 3)
    g : ndarray, shape (N - 3,)
    """

    M: np.ndarray
    g: np.ndarray

    @classmethod
    def of(
        cls, points: np.ndarray, normals: np.ndarray, offsets: np.ndarray, weights: np.ndarray
    ) -> RotationEquations:
        """Equations of contacts at ``points`` (N, 3); each row of the N weighted.

        The weights are the reciprocals of the standard deviations of the N residuals, up to a
        common factor.
        """
        rows = weights[:, None] * normals
        U, _, _ = np.linalg.svd(rows, full_matrices=True)
        C = U[:, 3:].T * weights  # (N - 3, N): takes the weighted y out
        return cls(np.einsum("ik,ka,kb->iab", C, points, normals), C @ offsets)

    def residuals(self, R: np.ndarray) -> np.ndarray:
        """``<R, M_i> - g_i`` for rotations (..., 3, 3): shape (..., N - 3)."""
        return np.einsum("...ab,iab->...i", R, self.M) - self.g

    def jacobian(self, R: np.ndarray) -> np.ndarray:
        """Derivative for ``R <- exp(theta) R``, shape (..., N - 3, 3): axial(M_i R^T)."""
        turned = np.einsum("iab,...cb->...iac", self.M, R)
        return _axial(turned)

    def quadrics(self) -> np.ndarray:
        """``K(M_i) - g_i I``, shape (N - 3, 4, 4), for quaternions xyzw."""
        trace = np.trace(self.M, axis1=1, axis2=2)
        A = np.empty((len(self.g), 4, 4))
        A[:, :3, :3] = self.M + self.M.transpose(0, 2, 1) - trace[:, None, None] * np.eye(3)
        A[:, :3, 3] = A[:, 3, :3] = _axial(self.M)
        A[:, 3, 3] = trace
        return A - self.g[:, None, None] * np.eye(4)


def rotations_of(equations: RotationEquations, known: np.ndarray | None = None) -> np.ndarray:
    """Rotations at which the sum of squared residuals is least nearby, shape (K, 3, 3), best first.

    ``known`` (K, 3, 3) are such rotations for other weights; they take the place of the grid.

    Exact solutions of exact data are all among them, whatever their number (at most eight if
    finite).  For data with noise the least squares from a grid of rotations are there too.
    """
    from scipy.spatial.transform import Rotation

    starts = intersections(equations.quadrics())
    rotations = refined(equations, Rotation.from_quat(starts).as_matrix())
    exact = len(rotations) and np.abs(equations.residuals(rotations[:1])).max() < EXACT * _size(
        equations
    )
    if not exact or len(starts) < 8:
        more = cube_rotations() if known is None else known
        rotations = refined(equations, np.concatenate([rotations, more]))
    return rotations


def intersections(quadrics: np.ndarray) -> np.ndarray:
    """Real parts of the common points of three general combinations, quaternions (8, 4).

    Fewer (or none) when the combinations meet in more than finitely many points.
    """
    A = quadrics / np.linalg.norm(quadrics, axis=(1, 2)).max().clip(np.finfo(float).tiny)
    if len(A) > 3:  # a fixed general choice: the result is the same on every call
        mix = np.random.default_rng(7).standard_normal((3, len(A)))
        A = np.einsum("ij,jab->iab", mix, A)
    null = _macaulay_null_space(A)
    if null is None:
        return np.zeros((0, 4))
    forms = np.random.default_rng(11).standard_normal((2, 4))
    S = null[_SHIFTS]  # (4, 20, 8): monomials of degree 3 times each coordinate
    upper, lower = np.einsum("fi,imk->fmk", forms, S)
    _, vectors = np.linalg.eig(np.linalg.lstsq(lower, upper, rcond=None)[0])
    outer = np.einsum("imk,ke->eim", S, vectors)  # q times its monomials: of rank one
    q = np.linalg.svd(outer, full_matrices=False)[0][:, :, 0]
    squared = np.sum(q * q, axis=1)
    q = q * np.exp(-0.5j * np.angle(squared))[:, None]
    real = q.real + np.where(np.linalg.norm(q.real, axis=1) < 1e-3, 1.0, 0.0)[:, None] * q.imag
    return real / np.linalg.norm(real, axis=1, keepdims=True)


def refined(equations: RotationEquations, starts: np.ndarray) -> np.ndarray:
    """Levenberg-Marquardt's method from every start at once; different ends only, best first."""
    from scipy.spatial.transform import Rotation

    R = starts.copy()
    damping = np.full(len(R), 1e-4)
    cost = np.sum(equations.residuals(R) ** 2, axis=1)
    at_work = np.arange(len(R))
    for _ in range(STEPS):
        J, r = equations.jacobian(R[at_work]), equations.residuals(R[at_work])
        H = np.einsum("kia,kib->kab", J, J)
        scale = np.trace(H, axis1=1, axis2=2) / 3.0 + np.finfo(float).tiny
        H = H + (damping[at_work] * scale)[:, None, None] * np.eye(3)
        step = -np.linalg.solve(H, np.einsum("kia,ki->ka", J, r)[..., None])[..., 0]
        tried = Rotation.from_rotvec(step).as_matrix() @ R[at_work]
        new = np.sum(equations.residuals(tried) ** 2, axis=1)
        better = new < cost[at_work]
        R[at_work[better]], cost[at_work[better]] = tried[better], new[better]
        damping[at_work] *= np.where(better, 0.1, 4.0)
        damping = np.maximum(damping, 1e-15)
        moving = np.linalg.norm(step, axis=1) > SMALLEST_STEP
        at_work = at_work[moving & (damping[at_work] < LARGEST_DAMPING)]
        if not len(at_work):
            break
    best = int(np.argmin(cost)) if len(R) else 0
    ended = _stationary(equations, R) | (np.arange(len(R)) == best)
    return _different(R[ended][np.argsort(cost[ended], kind="stable")])


def angle_between(R: np.ndarray, S: np.ndarray) -> np.ndarray:
    """Angle of ``R^T S`` [rad], exact also for small ones."""
    half = np.linalg.norm(R - S, axis=(-2, -1)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.clip(half, 0.0, 1.0))


def cube_rotations() -> np.ndarray:
    """The 24 rotations of a cube, shape (24, 3, 3), turned off the axes by a fixed amount."""
    from scipy.spatial.transform import Rotation

    return (Rotation.from_rotvec([0.1, 0.2, -0.3]) * Rotation.create_group("O")).as_matrix()


def _stationary(equations: RotationEquations, R: np.ndarray) -> np.ndarray:
    """Whether the residual is exact, or no step of first order takes off more of it."""
    r = equations.residuals(R)
    U, s, _ = np.linalg.svd(equations.jacobian(R), full_matrices=False)
    felt = s > SAME_ROTATION * s.max(axis=1, keepdims=True)
    gain = np.linalg.norm(np.einsum("kia,ki->ka", U, r) * felt, axis=1)
    return gain <= STATIONARY * np.linalg.norm(r, axis=1) + EXACT * _size(equations)


def _size(equations: RotationEquations) -> float:
    """Size of the terms that residuals are differences of."""
    return float(np.linalg.norm(equations.M, axis=(1, 2)).max())


def _different(R: np.ndarray) -> np.ndarray:
    """The first of every group of equal rotations."""
    distinct: list[int] = []
    for k in range(len(R)):
        if not distinct or angle_between(R[distinct], R[k]).min() > SAME_ROTATION:
            distinct.append(k)
    return R[distinct]


def _axial(M: np.ndarray) -> np.ndarray:
    """z with ``<S(v), M> = v . z``, shape (..., 3)."""
    return np.stack(
        [
            M[..., 2, 1] - M[..., 1, 2],
            M[..., 0, 2] - M[..., 2, 0],
            M[..., 1, 0] - M[..., 0, 1],
        ],
        axis=-1,
    )


def _macaulay_null_space(A: np.ndarray) -> np.ndarray | None:
    """Null space (35, 8) of all products of three quadrics with monomials of degree 2."""
    rows = np.zeros((3, 10, 35))
    for (i, j), places in zip(_DEGREE_2, _PRODUCTS, strict=True):
        rows[:, np.arange(10), places] += (1.0 if i == j else 2.0) * A[:, i, j, None]
    _, s, Vt = np.linalg.svd(rows.reshape(30, 35), full_matrices=True)
    return Vt[27:].T if s[26] > NULL_TOLERANCE * s[0] else None


def _monomials(degree: int) -> list[tuple[int, ...]]:
    return list(combinations_with_replacement(range(4), degree))


_DEGREE_2 = _monomials(2)
_PLACE = {monomial: k for k, monomial in enumerate(_monomials(4))}
# Where the product of two monomials of degree 2 stands, shape (10, 10).
_PRODUCTS = np.array([[_PLACE[tuple(sorted(a + b))] for b in _DEGREE_2] for a in _DEGREE_2])
# Where a monomial of degree 3 times each coordinate stands, shape (4, 20).
_SHIFTS = np.array([[_PLACE[tuple(sorted((*m, i)))] for m in _monomials(3)] for i in range(4)])
