r"""Internal forces: contact forces that do not move the object, or any of several objects.

The contacts of all arms together push the object with ``W_o lambda``.  With more contacts than the
rank of ``W_o`` many forces exert the same wrench (thesis, 3.4 and 3.7.3):

.. math:: \lambda = W_o^+ f_o + A_o \mu_I, \qquad W_o A_o = 0 .

The first part, of minimum norm, *moves* the object; the second part only *squeezes* it.
``W_o`` is about the object's centre of mass, in object axes: ``f_o`` is a force [N] and a moment
[N m] there.  Of K objects that share contacts, ``W_o`` (6 K, N) has six rows each, in its own axes;
forces are internal that move none of them.  A multiplier ``lambda_j`` is the force of contact j
[N], positive where it pushes; of a row that is a couple it is a moment in units of that row.

The basis ``A_o`` is a choice, and with it the meaning of the coordinates ``mu_I``:

* ``orthonormal``: ``|A_o mu_I| = |mu_I|``;
* ``nonnegative``: no entry is negative, so that a positive coordinate raises forces only.  It
  exists when some combination presses all contacts, as in every form-closure grasp;
* ``echelon``: as many rows as columns are unit rows; a coordinate is the deviation of one contact
  force from the smallest: ``mu_I,j = lambda_j - (W_o^+ f_o)_j``.

The norm is that of the multipliers as they are, for the plain pseudo-inverse.  With a ``length`` it
is in newtons: a contact counts with its force, a couple with its moment over that lever arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.dynamics.forces.distribution import (
    ForceFamily,
    forces_for,
    pressed,
    smallest_load,
)
from multiarm.dynamics.state import checked_vector
from multiarm.errors import GraspError
from multiarm.geometry.screws import (
    COUPLE_TOLERANCE,
    RANK_TOLERANCE,
    canonical_basis,
    chosen_rows,
    column_norms,
    pivots,
    row_scale,
    screw_system,
    wrench_matrix,
)
from multiarm.notation import count_of

FORMS = ("orthonormal", "nonnegative", "echelon")
# A combination presses all contacts when the weakest has this part of the strongest.
PRESSING_TOLERANCE = 1e-7
# Part of a wrench, or of its largest component, that counts as rounding.
WRENCH_ROUNDING = 1e-9
# Smallest singular value of coordinates' rows: other forces are up to 1e6 times the coordinates.
LEAST_COORDINATE = 1e-6


@dataclass(frozen=True, eq=False)
class InternalForces:
    """A basis of the internal forces.

    Attributes
    ----------
    basis : ndarray, shape (N, N - rank)
        ``A_o``, with ``W_o A_o = 0``.
    rank : int
        Rank of ``W_o``; with 6 an object the contacts hold the objects fully.
    rows : tuple of int
        Echelon form: the contacts whose forces are the coordinates.  Else empty.
    form : str
        ``orthonormal``, ``nonnegative`` or ``echelon``.
    """

    basis: np.ndarray
    rank: int
    rows: tuple[int, ...]
    form: str

    @property
    def count(self) -> int:
        """Number of coordinates ``mu_I``."""
        return self.basis.shape[1]


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Contact forces as what moves the object and what squeezes it, of all contacts in one vector.

    :class:`multiarm.dynamics.evaluation.ForceDecomposition` has them arm by arm.

    Attributes
    ----------
    moving : ndarray, shape (N,)
        The minimum-norm forces with the same resultant, ``W_o^+ f_o`` [N].
    squeezing : ndarray, shape (N,)
        The rest, ``A_o mu_I`` [N].
    coordinates : ndarray, shape (N - rank,)
        ``mu_I``.
    wrench : ndarray, shape (6 K,)
        Resultant ``f_o`` on each object: force [N] and moment [N m] about the centre of mass,
        object axes.
    """

    moving: np.ndarray
    squeezing: np.ndarray
    coordinates: np.ndarray
    wrench: np.ndarray


def internal_forces(
    W_o: np.ndarray,
    form: str = "orthonormal",
    rows: Sequence[int | str] | None = None,
    names: Sequence[str] | None = None,
) -> InternalForces:
    """Basis of the internal forces of a grasp.

    Parameters
    ----------
    W_o : ndarray, shape (6 K, N)
        Wrenches of unit pushes of all contacts on each object, about one point of it.
    form : str
        ``orthonormal``, ``nonnegative`` (columns with largest entry 1; the first presses all
        contacts) or ``echelon``.
    rows : sequence of int or str, optional
        Echelon form: the contacts whose forces become the coordinates, in their order.  Left out:
        contacts found by pivoting, which keeps the other entries small.
    names : sequence of str, optional
        Names of the contacts, which messages then use and ``rows`` may.

    Raises
    ------
    GraspError
        An unknown form; no combination presses all contacts; rows that cannot be coordinates.
    """
    W_o = _on_objects(W_o)
    labels = [f"contact {j}" for j in range(W_o.shape[1])] if names is None else list(names)
    if form not in FORMS:
        raise GraspError(f"unknown form {form!r} of internal forces; forms are {', '.join(FORMS)}")
    if rows is not None and form != "echelon":
        raise GraspError(f"rows can be chosen in the echelon form only, not in the {form} one")
    screws = screw_system(W_o)
    A = screws.dependencies
    chosen: tuple[int, ...] = ()
    if form == "orthonormal":
        # signs are free: the more contacts a column presses, the better it reads
        A = A * np.where(A.sum(axis=0) < -PRESSING_TOLERANCE, -1.0, 1.0)
    elif form == "nonnegative":
        A = _nonnegative(A, labels)
    else:
        A, chosen = _echelon(A, rows, labels)
    return InternalForces(A, screws.rank, chosen, form)


def pressing_forces(W_o: np.ndarray, names: Sequence[str] | None = None) -> np.ndarray:
    """Internal forces (N,) that press all contacts, as evenly as they can, 1 N in the mean.

    Raises
    ------
    GraspError
        No combination presses all contacts.
    """
    forces = internal_forces(W_o, "nonnegative", names=names).basis[:, 0]
    return forces / np.mean(forces)


def distribute(
    W_o: np.ndarray,
    wrench: np.ndarray,
    internal: np.ndarray | None = None,
    basis: InternalForces | None = None,
    length: float | None = None,
) -> np.ndarray:
    """Contact forces ``W_o^+ f_o + A_o mu_I`` with a given resultant wrench, (N,) [N].

    Parameters
    ----------
    W_o : ndarray, shape (6 K, N)
        Wrenches on each object about its centre of mass, object axes.
    wrench : array-like, shape (6 K,)
        Forces [N] and moments [N m] there.
    internal : array-like, shape (N - rank,), optional
        ``mu_I``; none when left out.
    basis : InternalForces, optional
        Of the coordinates ``internal``; the orthonormal form when left out.
    length : float, optional
        Measure the forces in newtons, couples over this lever arm [m]; left out: as they are.

    Raises
    ------
    GraspError
        When the contacts cannot exert the wrench, or ``internal`` has another length or a number
        that is not finite.
    """
    W_o, wrench = _on_objects(W_o), np.asarray(wrench, dtype=float)
    objects = len(W_o) // 6
    if wrench.shape != (6 * objects,) or not np.all(np.isfinite(wrench)):
        raise GraspError(f"a wrench is six finite numbers, not {wrench.tolist()}")
    screws = screw_system(W_o)
    scale, norms = row_scale(screws.length, objects), column_norms(W_o, screws.length)
    scaled = scale[:, None] * W_o / norms
    family, _ = forces_for(scaled, scale * wrench, RANK_TOLERANCE)
    some = family.least_norm / norms
    missing = wrench - W_o @ some
    if np.linalg.norm(scale * missing) > WRENCH_ROUNDING * np.linalg.norm(scale * wrench):
        raise GraspError(
            f"the contacts cannot exert this wrench on the object: {_shown(missing)} (force [N], "
            f"moment [N m] about the centre of mass, object axes) is left over; their rank is "
            f"{screws.rank} of {len(W_o)}"
        )
    force = _minimum_norm(W_o, screws.dependencies, some, length)
    if internal is None:
        return force
    A, mu_I = basis or internal_forces(W_o), np.atleast_1d(internal)
    if A.basis.shape != (W_o.shape[1], mu_I.size):
        raise GraspError(
            f"{count_of(W_o.shape[1], 'contact')} of rank {screws.rank}, so "
            f"{count_of(W_o.shape[1] - screws.rank, 'internal coordinate')}; got {mu_I.size} "
            f"of them and a basis of shape {A.basis.shape}"
        )
    return force + A.basis @ checked_vector("internal forces", mu_I, mu_I.size, GraspError)


def decompose(
    W_o: np.ndarray,
    forces: np.ndarray,
    basis: InternalForces | None = None,
    length: float | None = None,
) -> Decomposition:
    """Split contact forces into those that move the object and those that squeeze it.

    Parameters
    ----------
    W_o : ndarray, shape (6 K, N)
        Wrenches on each object about its centre of mass, object axes.
    forces : array-like, shape (N,)
        Contact forces [N], positive pushes.
    basis : InternalForces, optional
        Of the coordinates; the orthonormal form when left out.
    length : float, optional
        As in :func:`distribute`.

    Raises
    ------
    GraspError
        When the number of forces is not that of the contacts, or one of them is not finite.
    """
    W_o, forces = _on_objects(W_o), np.asarray(forces, dtype=float)
    if forces.shape != (W_o.shape[1],):
        raise GraspError(
            f"W_o has {count_of(W_o.shape[1], 'contact')}, the forces have shape {forces.shape}"
        )
    forces = checked_vector("forces", forces, forces.size, GraspError)
    A = basis or internal_forces(W_o)
    moving = _minimum_norm(W_o, A.basis, forces, length)
    squeezing = forces - moving
    mu_I = np.linalg.lstsq(A.basis, squeezing, rcond=None)[0]
    return Decomposition(moving, squeezing, mu_I, W_o @ forces)


def _minimum_norm(
    W_o: np.ndarray, null: np.ndarray, force: np.ndarray, length: float | None
) -> np.ndarray:
    """Minimum-norm forces with the same resultant: without their part in the null space."""
    metric = np.ones(force.size)
    if length is not None:
        if not length > 0.0:
            raise GraspError(f"length: a lever arm [m] greater than 0 is needed, got {length:g}")
        on_objects = W_o.reshape(len(W_o) // 6, 6, W_o.shape[1])  # a force acts on two
        push, turn = (np.linalg.norm(on_objects[:, k], axis=1).max(axis=0) for k in np.s_[:3, 3:])
        turn = turn / length
        metric = np.where(push > COUPLE_TOLERANCE * turn, push, turn)
    weighted = metric[:, None] * null
    return force - null @ np.linalg.lstsq(weighted, metric * force, rcond=None)[0]


def _nonnegative(A: np.ndarray, labels: list[str]) -> np.ndarray:
    """Basis without negative entries: a column that presses all contacts, and others plus it."""
    if A.shape[1] == 0:
        raise GraspError(
            f"the forces of {', '.join(labels)} are determined by what they do to the object: "
            f"there are no internal forces that could press; add contacts"
        )
    pressing = _pressing(A, labels)
    across = A - np.outer(pressing, pressing @ A) / (pressing @ pressing)
    # the basis without its part along `pressing`, one column fewer
    across = canonical_basis(np.linalg.svd(across)[0][:, : A.shape[1] - 1])
    columns = [pressing]
    for column in across.T:
        # as little of the pressing column as keeps every contact from pulling
        least = np.max(-column / pressing, initial=0.0)
        columns.append(np.maximum(column + least * pressing, 0.0))
    return np.column_stack([column / np.max(column) for column in columns])


def _pressing(A: np.ndarray, labels: list[str]) -> np.ndarray:
    """Internal force that presses all contacts: the one nearest to equal forces, if it does.

    Otherwise the one that maximises the smallest contact force, by linear programming.
    """
    even = A @ A.sum(axis=0)
    if np.min(even) > PRESSING_TOLERANCE * np.max(np.abs(even)):
        return even
    # forces up to 1 of which the weakest is as large as can be
    eye, family = np.eye(len(A)), ForceFamily(np.zeros(len(A)), A)
    strongest = smallest_load(family, (-eye, np.zeros(len(A))), (eye, np.ones(len(A))))
    if strongest.forces is not None and -strongest.largest > PRESSING_TOLERANCE:
        return strongest.forces
    shares = pressed(A)
    idle = [] if shares is None else np.flatnonzero(shares < PRESSING_TOLERANCE).tolist()
    raise GraspError(
        f"no combination of internal forces presses all contacts at once: "
        f"{', '.join(labels[j] for j in idle) or 'some'} would have to pull; the contacts do not "
        f"hold the object by pushing (no form closure), take the orthonormal or echelon form"
    )


def _echelon(
    A: np.ndarray, rows: Sequence[int | str] | None, labels: list[str]
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Basis with unit rows at the chosen contacts."""
    size = A.shape[1]
    chosen = pivots(A) if rows is None else chosen_rows(rows, labels, "contacts")
    if len(chosen) != size:
        raise GraspError(
            f"the contacts have {count_of(size, 'internal coordinate')}, which takes as many of "
            f"them, not {len(chosen)}{_advice(A, labels)}"
        )
    block = A[list(chosen)]
    smallest = np.linalg.svd(block, compute_uv=False)[-1] if size else 1.0
    if smallest < LEAST_COORDINATE:
        raise GraspError(
            f"the forces of {', '.join(labels[j] for j in chosen)} cannot be coordinates of the "
            f"internal forces: there are internal forces in which none of them changes"
            f"{_advice(A, labels)}"
        )
    echelon = A @ np.linalg.inv(block)
    if size:
        echelon[list(chosen)] = np.eye(size)  # without rounding
    return echelon, chosen


def _advice(A: np.ndarray, labels: list[str]) -> str:
    """End of a message: contacts whose forces can be coordinates."""
    if A.shape[1] == 0:
        return "; the contacts have no internal forces"
    return f"; {' + '.join(labels[j] for j in pivots(A))} can"


def _on_objects(W_o: np.ndarray) -> np.ndarray:
    return wrench_matrix(W_o, "W_o", max(len(W_o) // 6, 1))


def _shown(values: np.ndarray) -> str:
    shown = np.where(np.abs(values) > WRENCH_ROUNDING * np.max(np.abs(values)), values, 0.0)
    return "[" + ", ".join(f"{value:.3g}" for value in shown) + "]"
