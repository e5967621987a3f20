r"""Screws: wrenches as one or two contact forces; span and null spaces of a set of wrenches.

A frictionless point contact exerts a wrench of zero pitch, ``[e; p x e]``.  Every wrench
``[f; m]`` is a multiple of one, or of the difference of two (thesis, appendix C):

.. math:: \begin{bmatrix} f \\ m \end{bmatrix} = \gamma \left(
          \begin{bmatrix} e_1 \\ p_1 \times e_1 \end{bmatrix} -
          \begin{bmatrix} e_2 \\ p_2 \times e_2 \end{bmatrix} \right)

so that two contacts are enough for any constraint of a joint.  With ``u`` a unit vector across
``f`` and ``h = f / |f|``,

.. math:: e_{1,2} = \cos\psi\, u \pm \sin\psi\, h, \qquad \gamma = |f| / (2 \sin\psi), \qquad
          a_1 - a_2 = m / \gamma, \quad a_i \perp e_i, \qquad p_i = e_i \times a_i .

Here ``u`` is across ``m`` too.  The equations for ``a_1, a_2`` (of least norm) then stay regular as
``psi`` goes to zero, and a couple is the limit: ``e_1 = e_2``.

Many such pairs exert the same wrench.  But contacts are fixed to their bodies, and *the choice of
the pair decides the finite motion of the joint*.  The pair chosen here is a function of the wrench
alone, symmetrical about the origin for a couple.

The wrenches of a joint, columns of ``W``, have two null spaces, found together by
:func:`screw_system`: twists ``t`` with ``W^T t = 0`` are the motions that the joint leaves free,
multipliers ``lambda`` with ``W lambda = 0`` are the internal forces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.errors import GraspError
from multiarm.notation import count_of

# A force this small relative to its moment (over `length`) is zero: the wrench is a couple.
COUPLE_TOLERANCE = 1e-12
# Singular values of a scaled wrench matrix below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-9
# Smallest lever arm by which moments are scaled [m]: the moments of wrenches through the origin are
# rounding errors.
SHORTEST_LEVER = 1e-3


@dataclass(frozen=True)
class ZeroPitch:
    """A wrench as ``gamma ([e_1; p_1 x e_1] - [e_2; p_2 x e_2])``.

    Attributes
    ----------
    gamma : float
        Positive factor [the unit of the wrench's force].
    e_1, p_1 : ndarray, shape (3,)
        Direction (unit) and point [m] of the push.
    e_2, p_2 : ndarray, shape (3,), or None
        Those of the pull; None when the push is enough.
    """

    gamma: float
    e_1: np.ndarray
    p_1: np.ndarray
    e_2: np.ndarray | None = None
    p_2: np.ndarray | None = None

    @property
    def wrench(self) -> np.ndarray:
        """What the contacts exert together, shape (6,)."""
        pair = np.concatenate([self.e_1, np.cross(self.p_1, self.e_1)])
        if self.e_2 is not None and self.p_2 is not None:
            pair -= np.concatenate([self.e_2, np.cross(self.p_2, self.e_2)])
        return self.gamma * pair


def zero_pitch(wrench: np.ndarray, psi: float = math.pi / 6, length: float = 1.0) -> ZeroPitch:
    """Write a wrench as one wrench of zero pitch or as the difference of two.

    Parameters
    ----------
    wrench : array-like, shape (6,)
        Force and moment about the origin.
    psi : float
        Half the angle between the two contact normals [rad], between 0 and pi / 2.  It is made
        smaller for wrenches that are nearly couples: the contacts then stay near.
    length : float
        How large the joint is [m]: the contacts of a couple are that far apart, those of other
        pairs about that far from the origin or nearer.

    Raises
    ------
    GraspError
        When the wrench is zero, not finite, or an argument is out of range.
    """
    values = np.asarray(wrench, dtype=float)
    if values.shape != (6,) or not np.all(np.isfinite(values)):
        raise GraspError(
            f"a wrench is six finite numbers [fx, fy, fz, mx, my, mz], not {values.tolist()}"
        )
    if not 0.0 < psi < math.pi / 2 or not 0.0 < length < math.inf:
        raise GraspError(
            f"a wrench is split with 0 < psi < pi / 2 and a length > 0, not psi = {psi:g} rad and "
            f"length = {length:g} m"
        )
    # the result is the same for a multiple of the wrench; this one neither over- nor underflows
    scale = float(np.max(np.abs(values)))
    if scale == 0.0:
        raise GraspError("the wrench is zero; a contact needs a force or a moment")
    f, m = values[:3] / scale, values[3:] / scale
    force, moment = float(np.linalg.norm(f)), float(np.linalg.norm(m)) / length
    if force <= COUPLE_TOLERANCE * moment:
        gamma, e = moment, _across(m / np.linalg.norm(m))
        arm = np.cross(e, m) / (2.0 * gamma)
        return ZeroPitch(scale * gamma, e, arm, e, -arm)
    if abs(f @ m) <= 1e-12 * force * length * max(force, moment):  # zero pitch: one contact
        return ZeroPitch(scale * force, f / force, np.cross(f, m) / force**2)
    return _pair(f, m, max(force / (2.0 * math.sin(psi)), moment), scale)


@dataclass(frozen=True)
class ScrewSystem:
    """Rank and null spaces of wrenches ``W`` (6 K, N) on K bodies.

    Attributes
    ----------
    rank : int
        How many of the wrenches are independent.
    reciprocal : ndarray, shape (6 K, 6 K - rank)
        Twists on which no wrench does work; columns ``t`` orthonormal as ``[v; length omega]``.
    dependencies : ndarray, shape (N, N - rank)
        Orthonormal columns ``lambda`` with ``W lambda = 0``, in canonical form.
    singular : ndarray, shape (min(6 K, N),)
        Singular values on which the rank was decided, relative to the largest.
    length : float
        The longest lever arm [m], by which moments were divided for that.
    """

    rank: int
    reciprocal: np.ndarray
    dependencies: np.ndarray
    singular: np.ndarray
    length: float


def screw_system(W: np.ndarray) -> ScrewSystem:
    """Rank and both null spaces of a set of wrenches, (6 K, N): six rows a body on which they act.

    The rank is decided on a scaled matrix: moments over the longest lever arm, columns of unit
    length, so that metres and millimetres, strong and weak rows weigh alike.

    Raises
    ------
    GraspError
        When ``W`` does not have 6 rows a body, or is not finite.
    """
    W = wrench_matrix(W, bodies=max(len(W) // 6, 1))
    length = lever_arm(W)
    scale = row_scale(length, len(W) // 6)
    norms = column_norms(W, length)
    left, singular, right = np.linalg.svd(scale[:, None] * W / norms)
    singular = singular / max(singular[0], 1e-300) if singular.size else singular
    rank = int(np.sum(singular > RANK_TOLERANCE))
    dependencies, _ = np.linalg.qr(right[rank:].T / norms[:, None])
    reciprocal = scale[:, None] * left[:, rank:]
    return ScrewSystem(rank, reciprocal, canonical_basis(dependencies), singular, length)


@dataclass(frozen=True)
class FreeMotions:
    """The motions that the rows of a joint leave free, in the axes of its frame.

    Translations along and rotations about single axes of the frame are named; motions along several
    axes at once, as those of the corner of a block among four fingertips, are counted.

    Attributes
    ----------
    rank : int
        How many rows are independent.
    pure : tuple of int
        Components that are free by themselves: slides along x, y, z, turns about x, y, z.
    coupled : int
        How many further independent motions there are, each along several axes at once.
    independent : ndarray of bool, shape (N,)
        Rows that no other rows can replace.
    """

    rank: int
    pure: tuple[int, ...]
    coupled: int
    independent: np.ndarray

    def words(self) -> list[str]:
        """The motions, such as ``slide along x and y``, ``turn about z``."""
        words = []
        for motion, first in (("slide along", 0), ("turn about", 3)):
            axes = [axis for k, axis in enumerate("xyz", first) if k in self.pure]
            if axes:
                listed = " and ".join(filter(None, [", ".join(axes[:-1]), axes[-1]]))
                words.append(f"{motion} {listed}")
        if self.coupled:
            motions = count_of(self.coupled, "more motion" if words else "motion")
            words.append(f"{motions} along several axes at once")
        return words


def free_motions(W: np.ndarray) -> FreeMotions:
    """Relative velocities ``v`` with ``W^T v = 0``.

    Parameters
    ----------
    W : ndarray, shape (6, N), N > 0
        Wrenches, force first, about the joint frame's origin in its axes; any scale.
    """
    system = screw_system(W / column_norms(W, lever_arm(W)))
    motions = np.repeat([1.0, system.length], 3)[:, None] * system.reciprocal  # orthonormal
    violation = np.linalg.norm(np.eye(6) - motions @ motions.T, axis=0)  # of each axis alone
    pure = tuple(int(k) for k in np.flatnonzero(violation < 1e-6))
    independent = np.linalg.norm(system.dependencies, axis=1) < 1e-7
    return FreeMotions(system.rank, pure, 6 - system.rank - len(pure), independent)


def wrenches_in_frame(frame: np.ndarray, wrenches: np.ndarray) -> np.ndarray:
    """Wrenches (6, N), force first, about another frame's origin, in its axes.

    ``frame``, shape (4, 4), is the pose of that frame in the one in which they are given.
    """
    to_frame = frame[:3, :3].T
    moments = wrenches[3:].T - np.cross(frame[:3, 3], wrenches[:3].T)
    return np.vstack([to_frame @ wrenches[:3], to_frame @ moments.T])


def pivots(basis: np.ndarray) -> tuple[int, ...]:
    """As many rows of orthonormal columns (n, m) as columns, far from dependent, increasing.

    Found by QR with pivoting: the row with the largest part orthogonal to those before.
    """
    left, chosen = basis.copy(), []
    for _ in range(basis.shape[1]):
        size = np.linalg.norm(left, axis=1)
        best = first_largest(size)
        chosen.append(best)
        q = left[best] / size[best]
        left = left - np.outer(left @ q, q)
    return tuple(sorted(chosen))


def first_largest(sizes: np.ndarray) -> int:
    """The first of the numbers that are as large as the largest (positive) but for rounding."""
    # within 1e-6: rounding, which changes with the processor, must not choose between equals
    return int(np.argmax(sizes > (1.0 - 1e-6) * np.max(sizes)))


def canonical_basis(basis: np.ndarray) -> np.ndarray:
    """The canonical orthonormal basis (n, m) of the space that a basis spans.

    A singular value decomposition leaves the basis of a null space to rounding.  Here the rows of
    `pivots` are triangular, with a positive diagonal.
    """
    turned, triangle = np.linalg.qr(basis[list(pivots(basis))].T)
    return basis @ (turned * np.sign(np.diag(triangle)))


def lever_arm(W: np.ndarray) -> float:
    """Longest lever arm of wrenches (6 K, N) on K bodies [m]; 1 when none has a force."""
    on_bodies = W.reshape(len(W) // 6, 6, W.shape[1])
    if not np.any(on_bodies[:, :3]):
        return 1.0
    force, moment = (np.linalg.norm(on_bodies[:, part], axis=1) for part in np.s_[:3, 3:])
    pushes = force > COUPLE_TOLERANCE * np.max(force)
    return max(float(np.max(moment[pushes] / force[pushes])), SHORTEST_LEVER)


def row_scale(length: float, bodies: int = 1) -> np.ndarray:
    """Factors (6 K,) that make moments forces at a lever arm, and ``[v; l omega]`` to twists."""
    return np.tile(np.repeat([1.0, 1.0 / length], 3), bodies)


def column_norms(W: np.ndarray, length: float) -> np.ndarray:
    """Sizes (N,) of wrenches (6 K, N), moments over ``length``; 1 for a zero wrench."""
    norms = np.linalg.norm(row_scale(length, len(W) // 6)[:, None] * W, axis=0)
    return np.where(norms > 0.0, norms, 1.0)


def chosen_rows(rows: Sequence[int | str], names: Sequence[str], what: str) -> tuple[int, ...]:
    """Numbers of rows given by name or number, each once; ``what`` begins the error message."""
    numbers: list[int] = []
    for row in rows:
        number = names.index(row) if row in names else row
        if isinstance(number, str) or number not in range(len(names)) or int(number) in numbers:
            raise GraspError(
                f"{what} are {', '.join(names)} or 0 to {len(names) - 1}, each once; not "
                f"{', '.join(str(r) for r in rows)}"
            )
        numbers.append(int(number))
    return tuple(numbers)


def wrench_matrix(W: np.ndarray, name: str = "W", bodies: int = 1) -> np.ndarray:
    """The matrix as floats, its shape (6 K, N) for K bodies and its numbers checked."""
    W = np.asarray(W, dtype=float)
    if W.ndim != 2 or W.shape[0] != 6 * bodies:
        raise GraspError(f"{name} has one column of six numbers a wrench, not shape {W.shape}")
    if not np.all(np.isfinite(W)):
        column = int(np.argmin(np.all(np.isfinite(W), axis=0)))
        raise GraspError(f"{name}: column {column} is not finite")
    return W


def skew(a: np.ndarray) -> np.ndarray:
    """Matrix ``S(a)``, shape (3, 3), with ``S(a) @ b = a x b``."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def _pair(f: np.ndarray, m: np.ndarray, gamma: float, scale: float) -> ZeroPitch:
    """The two contacts of a wrench with pitch, for a given factor."""
    force = float(np.linalg.norm(f))
    along = f / force
    sine = force / (2.0 * gamma)
    cosine = math.sqrt((1.0 - sine) * (1.0 + sine))
    u = _across(along, m)
    w = np.cross(along, u)
    m_along, m_u, m_w = (m @ along) / gamma, (m @ u) / gamma, (m @ w) / gamma
    difference, total = m_along / cosine, -m_u / sine
    a_1 = (total + difference) / 2.0 * (cosine * along - sine * u) + m_w / 2.0 * w
    a_2 = (total - difference) / 2.0 * (cosine * along + sine * u) - m_w / 2.0 * w
    e_1, e_2 = cosine * u + sine * along, cosine * u - sine * along
    return ZeroPitch(scale * gamma, e_1, np.cross(e_1, a_1), e_2, np.cross(e_2, a_2))


def _across(axis: np.ndarray, other: np.ndarray | None = None) -> np.ndarray:
    """Unit vector across a unit vector, and across another vector unless the two are parallel."""
    u = np.zeros(3) if other is None else np.cross(axis, other)
    if other is None or not np.linalg.norm(u) > 1e-12 * np.linalg.norm(other):
        u = np.cross(axis, np.eye(3)[first_largest(1.0 - np.abs(axis))])
    u = u / np.linalg.norm(u)
    u = u - (u @ axis) * axis
    return u / np.linalg.norm(u)
