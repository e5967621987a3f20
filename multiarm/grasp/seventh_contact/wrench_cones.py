r"""Which wrench completes a grasp: the cone of the contacts that are there, seen from outside.

Contacts that can only push exert the wrenches of the cone
:math:`K = \{W \lambda : \lambda \ge 0\}`.  When W has rank 6, K has an inside, and one more contact
with the wrench w gives form closure exactly when :math:`-w` is inside (thesis, 2.1): with
:math:`-w = W \lambda`, :math:`\lambda > 0`, all contacts together balance.  With the inward normals
:math:`n_f` of the facets of K, :math:`K = \{w : n_f \cdot w \ge 0\}`, the condition is

.. math::  n_f \cdot w < 0 \quad \text{for all } f .

For six contacts the :math:`n_f` are the rows of :math:`W^{-1}` (thesis, eq. 2.3), and the numbers
:math:`n_f \cdot w` are the coefficients :math:`W^{-1} w`.  For more, K may contain whole lines: the
span L of all contacts that take part in some balance.  L is divided out, what is left is a pointed
cone, and its facets are those of the convex hull of a slice through it.  If L is the whole space
the grasp is closed already, and no facet restricts anything.

Wrenches are taken about the mean of the contacts with moments over their spread, so that neither
the size nor the place of the body matters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of, unit_vectors
from multiarm.grasp.body.face import distinct
from multiarm.grasp.closure.balances import BAND, rank_of, rounding
from multiarm.grasp.contacts import Contacts, HeldByContacts, contacts_in_space, wrenches_of
from multiarm.programs import least_distance, nonnegative_least_squares

ILL = (
    "contacts that nearly coincide, or faces that are nearly parallel, make it ill-conditioned; "
    "remove one of each such pair"
)
# A level is negative only when it is below zero by this part of what it is made of.  The origin is
# no farther inside the hull of all wrenches than a level says, so that this is the band in which
# form closure is not relied on either.
STRICT = BAND
# Generators this close to a facet that Qhull found are on it: Qhull merges facets that nearly agree
# and is good to some 1e-12 where the cone is thin.  Facets are found again from these generators,
# if they span one.
ON_FACET, SPANNING = 1e-10, 1e-7


@dataclass(frozen=True, eq=False)
class WrenchCone:
    """All wrenches that some frictionless contacts can exert, as the facets of their cone.

    Attributes
    ----------
    contacts : Contacts
        N >= 6 contacts of rank 6.
    facets : ndarray, shape (F, 6)
        Inward normals of the facets, for wrenches about ``contacts.centre`` with moments over
        ``contacts.length``; rows of the inverse when N = 6, unit vectors otherwise; none when the
        contacts alone give form closure.
    """

    contacts: Contacts
    facets: np.ndarray

    @cached_property
    def closed(self) -> bool:
        """Whether the contacts give form closure without another one."""
        return not len(self.facets)

    def levels(self, points: Any, normals: Any) -> np.ndarray:
        """``n_f . w`` of one more contact, shape (..., F): it closes when all are negative.

        Parameters
        ----------
        points, normals : array-like, shape (..., 3)
            Candidates for the contact, on any surface, and their normals into the body (of unit
            length) [m].

        Raises
        ------
        GraspError
            No such arrays; normals that are not of unit length.

        Notes
        -----
        For six contacts they are :math:`W_6^{-1} w_7`, minus the forces of the six that balance a
        unit push of the seventh.
        """
        w = self._wrenches(points, normals)
        return np.moveaxis(np.tensordot(self.facets, w, axes=1), 0, -1)

    def closes(self, points: Any, normals: Any) -> np.ndarray:
        """Which candidates (...) close the grasp: their levels are negative by more than rounding.

        A level within 1e-10 of zero, relative to the sizes of facet and wrench, is zero; and so is
        one within the rounding of points that are far from the origin.
        """
        w = self._wrenches(points, normals)
        sizes = np.linalg.norm(self.facets, axis=1) * np.linalg.norm(w, axis=0)[..., None]
        strict = strictness(self.contacts, np.asarray(points, dtype=float))
        return np.all(self.levels(points, normals) < -strict * sizes, axis=-1)

    def _wrenches(self, points: Any, normals: Any) -> np.ndarray:
        """Scaled wrenches (6, ...) of candidates."""
        needed = "points and normals are arrays (..., 3) of finite numbers"
        at, along = (numbers_of(values, needed, (..., 3)) for values in (points, normals))
        try:
            at, along = np.broadcast_arrays(at, along)
        except ValueError as error:
            raise GraspError(f"{needed}, not of shapes {at.shape} and {along.shape}") from error
        unit_vectors(along, ": divide by it")
        return wrenches_of((at - self.contacts.centre) / self.contacts.length, along)


def wrench_cone(contacts: Contacts | HeldByContacts) -> WrenchCone:
    """The cone of the wrenches of at least six contacts in space.

    Raises
    ------
    GraspError
        Contacts in the plane; fewer than six; wrenches of a rank below 6.
    """
    contacts = contacts_in_space(contacts)
    W, rank = contacts.scaled_wrenches, rank_of(contacts)
    if rank < 6:
        teller = "independence says what depends on what"
        if contacts.count != 6:
            teller = "is_form_closure says which motion is free"
        raise GraspError(
            f"the {contacts.count} contacts have rank {rank}, not 6: in a balance with one more "
            f"contact that contact would have to carry no force, so it cannot close the grasp; "
            f"move or add contacts so that six are independent ({teller})"
        )
    if contacts.count == 6:
        return WrenchCone(contacts, np.linalg.inv(W))
    return WrenchCone(contacts, _facets(W / np.linalg.norm(W, axis=0)))


def strictness(contacts: Contacts, points: np.ndarray) -> float:
    """Part of its size by which the level of one more contact at such points is negative."""
    reach = max(float(np.abs(at).max(initial=0.0)) for at in (points, contacts.points))
    return STRICT + float(rounding(reach, contacts.length))


def is_independent(contacts: Contacts) -> bool:
    """Whether the wrenches of contacts in space have rank 6."""
    return rank_of(contacts) == 6


def closes_on_surface(contacts: Contacts | HeldByContacts, points: Any, normals: Any) -> np.ndarray:
    """Which points of a surface, curved or plane, close the grasp with one more contact.

    Parameters
    ----------
    contacts : Contacts, or a grasp
        At least six, of rank 6.
    points, normals : array-like, shape (..., 3)
        Points of the surface [m] and unit normals there, into the body.

    Returns
    -------
    ndarray of bool, shape (...)

    Notes
    -----
    Equation 2.3 of the thesis with the normal as a function of the point.  A region on a curved
    face need not be convex (A.6).  `wrench_cone(contacts).levels` gives the distances.
    """
    return wrench_cone(contacts).closes(points, normals)


def _facets(W: np.ndarray) -> np.ndarray:
    """Inward unit normals (F, 6) of the cone of unit columns (6, N) that span the space."""
    balanced = _balanced(W)
    U, s, _ = np.linalg.svd(W[:, balanced], full_matrices=True)
    lines = int(np.sum(s > BAND * s[0])) if s.size else 0
    Q = U[:, lines:]  # (6, m): what the lines leave
    if not Q.shape[1]:
        return np.empty((0, 6))
    G = Q.T @ W[:, ~balanced]  # (m, n): generators of a pointed cone
    if G.shape[1] < G.shape[0]:
        raise GraspError(f"the cone of the contacts is flat: {ILL}")
    return _pointed_facets(G / np.linalg.norm(G, axis=0)) @ Q.T


def _balanced(W: np.ndarray) -> np.ndarray:
    """Which unit columns take part in some balance ``W lam = 0, lam >= 0``; bool, shape (N,).

    Those whose opposite is in the cone, by non-negative least squares: an active-set method, right
    to the last digits where a linear program's tolerance would decide.
    """
    left = [np.linalg.norm(W @ nonnegative_least_squares(W, -w) + w) for w in W.T]
    return np.array(left) <= BAND


def _pointed_facets(G: np.ndarray) -> np.ndarray:
    """Inward unit normals (F, m) of the pointed cone of unit columns (m, n) that span R^m."""
    from scipy.spatial import ConvexHull, QhullError

    m, n = G.shape
    if m == 1:
        return np.sign(G[:1, :1])
    h = least_distance(G.T, np.ones(n)).direction  # nearest to all generators
    if not (h @ G).min() > 0.0:
        raise GraspError(f"the cone of the contacts is flat: {ILL}")
    h = h / np.linalg.norm(h)
    B = np.linalg.svd(h[None])[2][1:].T  # (m, m - 1): across h
    slice_ = (B.T @ G / (h @ G)).T  # (n, m - 1): the cone cut at h . w = 1
    if m == 2:
        equations = np.array([[1.0, -slice_.max()], [-1.0, slice_.min()]])
    else:
        try:
            equations = ConvexHull(slice_).equations  # a . y + b <= 0 inside
        except QhullError as error:
            raise GraspError(f"the cone of the contacts is flat: {ILL}") from error
    normals = -(equations[:, :-1] @ B.T + equations[:, -1:] * h)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return distinct(np.array([_refined(n, G) for n in distinct(normals)]))


def _refined(n: np.ndarray, G: np.ndarray) -> np.ndarray:
    """A facet's normal (m,) to the last digits: the null vector of the generators (m, n) on it."""
    on = G[:, np.abs(n @ G) <= ON_FACET]
    U, s, _ = np.linalg.svd(on, full_matrices=True)
    if np.count_nonzero(s > SPANNING) < len(n) - 1:
        return n  # a facet so small that its generators do not determine its position
    exact = U[:, -1] * np.sign(U[:, -1] @ n)
    return exact if (exact @ G).min() >= -ON_FACET else n
