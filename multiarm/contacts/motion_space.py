r"""Motion space of a joint: which motions it leaves free, and the coordinates of these motions.

The contacts of an arm constrain the motion of the gripper relative to the object, in object axes
and at the gripper's origin: ``W^T v = 0`` with ``W = W_m^o``, columns ``[-e_o; e_o x (p_o - x)]``
(thesis, 3.21).  ``T`` spans the free motions (3.20):

.. math:: v = T \alpha, \qquad W^T T = 0, \qquad S\, T = I .

*The rates alpha are a choice*, made by a matrix ``S`` with ``alpha = S v`` (thesis, 3.8.1): rows of
the identity, for components of the twist; rows of ``[0, E^-1]``, for rates of Euler angles with
``omega = E theta'``; or components at the joint's own centre along its own axes, such as the angle
of a hinge, whatever the gripper's origin does meanwhile.  From any basis ``N`` of the null space,
and any solution ``D`` of ``W^T D = -(dW/dt)^T T``,

.. math:: T = N (S N)^{-1}, \qquad \dot T = D - T (S D + \dot S\, T) .

The choice is a good one when ``S N`` is well conditioned, and impossible when it is singular:
along some free motion all of the chosen rates are then zero.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.contacts.joint import COMPONENTS, JointFrame
from multiarm.contacts.matrices import RelativeMotion
from multiarm.errors import GraspError
from multiarm.geometry.screws import (
    RANK_TOLERANCE,
    ScrewSystem,
    chosen_rows,
    column_norms,
    pivots,
    row_scale,
    screw_system,
    skew,
    wrench_matrix,
)
from multiarm.notation import count_of

# Rates whose smallest singular value on the free motions is below this cannot be coordinates.
COORDINATE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Selection:
    """Rates ``alpha = S v`` of a relative twist.

    Attributes
    ----------
    matrix : ndarray, shape (m, 6)
        ``S``; ``v = [velocity of the gripper's origin; angular velocity]``, object axes.
    rate : ndarray, shape (m, 6)
        ``dS/dt``.
    labels : tuple of str
        Names of the rates, for messages.
    """

    matrix: np.ndarray
    rate: np.ndarray
    labels: tuple[str, ...]


@dataclass(frozen=True)
class MotionSpace:
    """The free motions ``v = T alpha``, twists of the gripper's frame relative to the object.

    Velocity of the gripper's origin [m/s] and angular velocity [rad/s], both in object axes.

    Attributes
    ----------
    T : ndarray, shape (6, m)
        ``m = 6 - rank W``.
    T_dot : ndarray, shape (6, m), or None
        Its rate; None when the rate of ``W`` was not given.
    selection : Selection
        The rates ``alpha``.
    rows, others : tuple of int
        The components of the twist that are ``alpha``, and the rest; both empty for other rates.
    rank : int
        Number of independent wrenches.
    condition : float
        Inverse of the smallest singular value of ``S`` on the free motions (lengths in lever arms
        of the contacts): 1 at best, the larger the nearer ``alpha`` is to failing.
    mismatch : float
        Largest entry of ``W^T T_dot + W_dot^T T``, scaled [1/s]: zero unless the rank of redundant
        wrenches is just changing, where ``T`` has no rate.  0 without ``T_dot``.
    """

    T: np.ndarray
    T_dot: np.ndarray | None
    selection: Selection
    rows: tuple[int, ...]
    others: tuple[int, ...]
    rank: int
    condition: float
    mismatch: float = 0.0

    def rates(self, twist: np.ndarray) -> np.ndarray:
        """``alpha = S v`` of a relative twist, shape (m,)."""
        return self.selection.matrix @ twist

    def twist(self, alpha: np.ndarray) -> np.ndarray:
        """Relative twist ``T alpha``, shape (6,)."""
        return self.T @ np.asarray(alpha, dtype=float)

    def acceleration(self, alpha: np.ndarray, alpha_dot: np.ndarray) -> np.ndarray:
        """Rate ``T alpha' + T' alpha`` of the components of the relative twist, shape (6,).

        Raises
        ------
        GraspError
            Without ``T_dot``.
        """
        if self.T_dot is None:
            raise GraspError("the motion space has no rate: give it the rate of W (`W_dot`)")
        return self.T @ np.asarray(alpha_dot, float) + self.T_dot @ np.asarray(alpha, float)


def motion_space(
    W: np.ndarray,
    W_dot: np.ndarray | None = None,
    rows: Sequence[int | str] | None = None,
) -> MotionSpace:
    """Motion space with rows of the relative twist as rates alpha (thesis, 3.8).

    Parameters
    ----------
    W : ndarray, shape (6, N)
        ``W_m^o``: wrenches on the gripper about its origin, object axes.  They may be dependent.
    W_dot : ndarray, shape (6, N), optional
        Their rates, component by component.
    rows : sequence of int or str, optional
        Which components of the twist are ``alpha``: 0 to 5, or slide x, ..., turn z.  Left out:
        well-conditioned ones, found by pivoting.

    Raises
    ------
    GraspError
        When the rows cannot serve; the message lists rows that can.
    """
    W = wrench_matrix(W)
    screws = screw_system(W)
    if rows is None:
        chosen = pivots(_scaled_null(screws))
    else:
        chosen = chosen_rows(rows, COMPONENTS, "rows of a twist")
    labels = tuple(COMPONENTS[row] for row in chosen)
    selection = Selection(np.eye(6)[list(chosen)], np.zeros((len(chosen), 6)), labels)
    return _space(W, W_dot, screws, selection, chosen)


def motion_space_in_rates(
    W: np.ndarray, selection: Selection, W_dot: np.ndarray | None = None
) -> MotionSpace:
    """Motion space with any linear rates ``alpha = S v`` of the relative twist.

    Parameters are those of :func:`motion_space`; see :func:`euler_selection` and
    :func:`joint_selection` for choices of ``S``.

    Raises
    ------
    GraspError
        When the rates cannot serve; the message lists rows of the twist that can.
    """
    W = wrench_matrix(W)
    return _space(W, W_dot, screw_system(W), selection, None)


def euler_selection(
    angles: np.ndarray,
    rates: np.ndarray | None = None,
    sequence: str = "zxz",
    chosen: Sequence[int] = (0, 1),
) -> Selection:
    r"""Rates of Euler angles as ``alpha``.

    The gripper's orientation in the object is ``R = R_1(theta_1) R_2(theta_2) R_3(theta_3)`` about
    the axes of the sequence, so that ``omega = E theta'`` and ``theta' = E^{-1} omega``.

    Parameters
    ----------
    angles, rates : ndarray, shape (3,)
        ``theta`` [rad] and ``theta'`` [rad/s]; ``T_dot`` needs the latter.
    sequence : str
        Three letters of x, y, z, neighbours different.
    chosen : sequence of int
        Which of the three rates are ``alpha``.

    Raises
    ------
    GraspError
        At the singular orientation of the angles.
    """
    E, E_dot = euler_rates(angles, np.zeros(3) if rates is None else rates, sequence)
    if not np.linalg.cond(E) < 1.0 / COORDINATE_TOLERANCE:
        raise GraspError(
            f"the Euler angles {sequence} have no rates at {np.asarray(angles).tolist()} rad: two "
            f"of their axes coincide; take another sequence"
        )
    inverse = np.linalg.inv(E)
    matrix, rate = np.zeros((3, 6)), np.zeros((3, 6))
    matrix[:, 3:], rate[:, 3:] = inverse, -inverse @ E_dot @ inverse
    picked = list(chosen)
    labels = tuple(f"Euler angle {k + 1} of {sequence}" for k in picked)
    return Selection(matrix[picked], rate[picked], labels)


def euler_rates(
    angles: np.ndarray, rates: np.ndarray, sequence: str = "zxz"
) -> tuple[np.ndarray, np.ndarray]:
    """Matrix ``E`` with ``omega = E theta'`` and its rate, both of shape (3, 3).

    Column k is the axis of turn k in the axes of the fixed body.
    """
    valid = len(sequence) == 3 and set(sequence) <= set("xyz")
    if not valid or any(a == b for a, b in itertools.pairwise(sequence)):
        raise GraspError(
            f"Euler angles turn about three of x, y, z, no two neighbours alike (zxz, zxy, ...), "
            f"not {sequence!r}"
        )
    E, E_dot = np.zeros((3, 3)), np.zeros((3, 3))
    turned, omega = np.eye(3), np.zeros(3)
    for k, (letter, angle, rate) in enumerate(zip(sequence, angles, rates, strict=True)):
        number = "xyz".index(letter)
        # this axis turns with the rotations before it
        E[:, k] = turned[:, number]
        E_dot[:, k] = np.cross(omega, E[:, k])
        omega = omega + rate * E[:, k]
        turned = turned @ _turn(number, angle)
    return E, E_dot


def joint_selection(frame: JointFrame, relative: RelativeMotion) -> Selection:
    """The free components of a joint, at its own origin and along its own axes, as ``alpha``.

    With ``r = R x_J`` from the gripper's origin to the joint's, the latter moves with
    ``v + omega x r``; the joint's axes are fixed in the object.
    """
    axes = frame.on_object[:3, :3]
    arm = relative.rotation @ frame.on_tip[:3, 3]
    matrix, rate = np.zeros((6, 6)), np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = axes.T
    matrix[:3, 3:] = -axes.T @ skew(arm)
    rate[:3, 3:] = -axes.T @ skew(np.cross(relative.twist[3:], arm))
    free = list(frame.free)
    return Selection(matrix[free], rate[free], tuple(f"{k} of the joint" for k in frame.labels))


def _space(
    W: np.ndarray,
    W_dot: np.ndarray | None,
    screws: ScrewSystem,
    selection: Selection,
    rows: tuple[int, ...] | None,
) -> MotionSpace:
    """``T``, ``T_dot`` for any rates; ``rows`` are the components of the twist among these."""
    count, free, labels = len(selection.matrix), 6 - screws.rank, ", ".join(selection.labels)
    if count != free:
        raise GraspError(
            f"the contacts leave {count_of(free, 'motion')} free, which takes as many "
            f"{'rates' if rows is None else 'rows'}, not {count} ({labels}){_alternatives(screws)}"
        )
    smallest = _smallest(selection.matrix, screws)
    if smallest < COORDINATE_TOLERANCE:
        raise GraspError(
            f"{labels} cannot serve as coordinates of the relative motion: they are all zero along "
            f"a motion that the contacts leave free{_alternatives(screws)}"
        )
    N = screws.reciprocal
    T = N @ np.linalg.inv(selection.matrix @ N)
    others = () if rows is None else tuple(row for row in range(6) if row not in rows)
    rows = rows or ()
    if rows:
        T[list(rows)] = np.eye(len(rows))  # without rounding
    T_dot, mismatch = None, 0.0
    if W_dot is not None:
        T_dot, mismatch = _rate(W, wrench_matrix(W_dot, "W_dot"), T, selection, screws.length)
        T_dot[list(rows)] = 0.0
    return MotionSpace(T, T_dot, selection, rows, others, screws.rank, 1.0 / smallest, mismatch)


def _rate(
    W: np.ndarray, W_dot: np.ndarray, T: np.ndarray, selection: Selection, length: float
) -> tuple[np.ndarray, float]:
    """``T_dot``, and the largest residual of ``W^T T_dot = -W_dot^T T`` (scaled)."""
    if W_dot.shape != W.shape:
        raise GraspError(f"W_dot has the shape {W_dot.shape}, W {W.shape}")
    scale, norms = row_scale(length), column_norms(W, length)
    left = (scale[:, None] * W / norms).T  # (N, 6)
    right = -(W_dot / norms).T @ T  # (N, m)
    particular = scale[:, None] * np.linalg.lstsq(left, right, rcond=RANK_TOLERANCE)[0]
    T_dot = particular - T @ (selection.matrix @ particular + selection.rate @ T)
    over = left @ (T_dot / scale[:, None]) - right
    return T_dot, float(np.max(np.abs(over), initial=0.0))


def _scaled_null(screws: ScrewSystem) -> np.ndarray:
    """Orthonormal free motions ``[v; length omega]`` as columns, (6, m)."""
    return screws.reciprocal / row_scale(screws.length)[:, None]


def _smallest(S: np.ndarray, screws: ScrewSystem) -> float:
    """Smallest singular value of the rates on the free motions, rates of unit size; 1 for none."""
    if not len(S):
        return 1.0
    scaled = S * row_scale(screws.length)
    size = np.linalg.norm(scaled, axis=1, keepdims=True)
    on_free = scaled / np.where(size > 0.0, size, 1.0) @ _scaled_null(screws)
    return float(np.linalg.svd(on_free, compute_uv=False)[-1])


def _alternatives(screws: ScrewSystem) -> str:
    """End of a message: components that can be coordinates, the best first."""
    free = 6 - screws.rank
    if free == 0:
        return "; none can: they leave nothing free"
    graded = [
        (_smallest(np.eye(6)[list(rows)], screws), rows)
        for rows in itertools.combinations(range(6), free)
    ]
    # sorted by rounded grade, so that equals stay in the order of the rows
    good = [g for g in sorted(graded, key=lambda g: -round(g[0], 6)) if g[0] > COORDINATE_TOLERANCE]
    texts = [" + ".join(COMPONENTS[row] for row in rows) for _, rows in good]
    more = f" (and {len(texts) - 6} more)" if len(texts) > 6 else ""
    return f"; rows that can, the best first: {', '.join(texts[:6])}{more}"


def _turn(axis: int, angle: float) -> np.ndarray:
    """Rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = c
    R[j, k], R[k, j] = -s, s
    return R
