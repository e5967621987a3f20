r"""Six contacts whose wrenches are independent: the base of every grasp with seven (thesis, 2.2).

With :math:`e_A = [e_1\,e_2\,e_3]`, :math:`e_B = [e_4\,e_5\,e_6]` and the moments
:math:`a_A = [p_1 \times e_1 \;..]`, :math:`a_B` likewise,

.. math::
    T_1 = -e_A^{-1} e_B, \qquad a = a_A T_1 + a_B, \qquad T_2 = -a^{-1} a_A,

.. math::
    \begin{bmatrix} e_A & e_B \\ a_A & a_B \end{bmatrix}^{-1} =
    \begin{bmatrix} (I + T_1 T_2) e_A^{-1} & T_1 a^{-1} \\ T_2 e_A^{-1} & a^{-1} \end{bmatrix},
    \qquad \det W = \det e_A \, \det a

(thesis, 2.2): the wrenches are independent exactly when :math:`e_A` and :math:`a` are regular.
Conditions on the
normal lines say more about a failure than a determinant does
(:mod:`multiarm.grasp.six_contacts.necessary_conditions`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.closure.balances import tolerance_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space
from multiarm.grasp.six_contacts.necessary_conditions import (
    INCIDENCE,
    Violation,
    named,
    violated_conditions,
)


@dataclass(frozen=True, eq=False)
class BlockInverse:
    """Inverse of six wrenches by blocks.

    Attributes
    ----------
    order : tuple of int
        The contacts (numbers from 0) of e_A, then those of e_B: 0 to 5, unless the first three
        normals are dependent or nearly so.
    T1, a, T2 : ndarray, shape (3, 3)
        [1], [m], [1], of the contacts in that order; moments about the frame's origin.
    inverse : ndarray, shape (6, 6)
        ``W^-1``; row j belongs to contact j of the set as given.
    determinant : float
        ``det W`` of the set as given [m^3].
    """

    order: tuple[int, ...]
    T1: np.ndarray
    a: np.ndarray
    T2: np.ndarray
    inverse: np.ndarray
    determinant: float


@dataclass(frozen=True, eq=False)
class Independence:
    """Whether six wrenches are independent; its truth value is ``independent``.

    Attributes
    ----------
    independent : bool
    rank : int
    determinant : float
        ``det W`` [m^3]; it does not depend on the frame's origin.
    smallest_singular_value : float
        Of the scaled wrenches: how far the nearest dependent ones are.
    violations : tuple of Violation
        Necessary conditions that are not met; possibly none although the wrenches are dependent.
    dependent : tuple of int
        Contacts (numbers from 0) that take part in a dependency.
    message : str
    """

    independent: bool
    rank: int
    determinant: float
    smallest_singular_value: float
    violations: tuple[Violation, ...]
    dependent: tuple[int, ...]
    message: str

    def __bool__(self) -> bool:
        return self.independent


def block_inverse(contacts: Contacts | HeldByContacts) -> BlockInverse:
    """Invert the wrenches of six contacts by blocks (thesis, 2.2).

    Raises
    ------
    GraspError
        Not six contacts in space, or dependent ones; the message says why.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    verdict = independence(contacts)
    if not verdict:
        raise GraspError(f"{verdict.message}: there is no inverse")
    order = _leading_order(contacts.normals)
    picked = list(order)
    e, m = contacts.normals[picked].T, np.cross(contacts.points, contacts.normals)[picked].T
    e_A_inverse = np.linalg.inv(e[:, :3])
    T1, a = blocks_of(contacts.points[picked], contacts.normals[picked])
    a_inverse = np.linalg.inv(a)
    T2 = -a_inverse @ m[:, :3]
    inverse = np.empty((6, 6))
    inverse[picked[:3]] = np.hstack([(np.eye(3) + T1 @ T2) @ e_A_inverse, T1 @ a_inverse])
    inverse[picked[3:]] = np.hstack([T2 @ e_A_inverse, a_inverse])
    sign = float(np.round(np.linalg.det(np.eye(6)[picked])))
    determinant = sign * float(np.linalg.det(e[:, :3]) * np.linalg.det(a))
    return BlockInverse(order, T1, a, T2, inverse, determinant)


def blocks_of(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``T_1`` and ``a`` (3, 3) of six contacts, of which the first three make up ``e_A``."""
    e, m = normals.T, np.cross(points, normals).T
    T1 = -np.linalg.solve(e[:, :3], e[:, 3:])
    return T1, m[:, :3] @ T1 + m[:, 3:]


def independence(contacts: Contacts | HeldByContacts) -> Independence:
    """Decide whether the wrenches of six contacts are independent, and say why if not.

    They are dependent when the smallest singular value of the scaled wrenches is no more than
    1e-10 of the largest, and the rounding of points far from the origin.

    Raises
    ------
    GraspError
        Not six contacts in space.
    """
    contacts = contacts_in_space(contacts, 6, 6)
    W = contacts.scaled_wrenches
    _, s, Vt = np.linalg.svd(W)
    rank = int(np.count_nonzero(s > tolerance_of(contacts) * s[0]))
    determinant = float(np.linalg.det(W)) * contacts.length**3
    if rank == 6:
        words = "the six wrenches are independent"
        return Independence(True, 6, determinant, float(s[-1]), (), (), words)
    violations = violated_conditions(contacts)
    parts = np.linalg.norm(Vt[rank:], axis=0)
    dependent = tuple(np.flatnonzero(parts > INCIDENCE * parts.max()).tolist())
    reason = "; ".join(violation.words for violation in violations)
    if not reason:
        reason = f"the wrenches of {named(contacts, dependent)} depend on each other"
    words = f"the six wrenches are dependent (rank {rank}): {reason}"
    return Independence(False, rank, determinant, float(s[-1]), violations, dependent, words)


def _leading_order(normals: np.ndarray) -> tuple[int, ...]:
    """Contacts of e_A first: the first three unless others are far more independent."""
    triples = list(combinations(range(6), 3))
    sizes = np.abs(np.linalg.det(normals[np.array(triples)]))
    chosen = triples[0] if sizes[0] > 1e-3 * sizes.max() else triples[int(np.argmax(sizes))]
    return (*chosen, *(j for j in range(6) if j not in chosen))
