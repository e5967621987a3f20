r"""Frictionless point contacts between fingers and one rigid body.

A contact j is a point :math:`p_j` and a unit normal :math:`e_j` that points **into** the body. It
can only push; pushing with the force :math:`\lambda_j \ge 0` it exerts the wrench
:math:`\lambda_j w_j`, in space and in the plane

.. math::
    w_j = \begin{bmatrix} e_j \\ p_j \times e_j \end{bmatrix} \in \mathbb{R}^6, \qquad
    w_j = \begin{bmatrix} e_j \\ p_{jx} e_{jy} - p_{jy} e_{jx} \end{bmatrix} \in \mathbb{R}^3,

force first, then moment (thesis, 2.1).  All points and normals are in one frame of the body.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from operator import index
from typing import Any, Protocol

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of, unit_vectors
from multiarm.notation import count_of


@dataclass(frozen=True, eq=False)
class Contacts:
    """A set of frictionless contacts.

    Parameters
    ----------
    points : array-like, shape (N, d)
        Where the fingers touch [m], in axes of the body; d = 3 in space, 2 in the plane.
    normals : array-like, shape (N, d)
        Unit vectors into the body.
    names : sequence of str, optional
        Names of the contacts in messages and figures; by default ``contact 1`` to ``contact N``.

    Raises
    ------
    GraspError
        Shapes that do not match, numbers that are not finite, normals that are not of unit length.

    Notes
    -----
    :meth:`along` takes directions of any length.  Numbers may be ``fractions.Fraction``: decisions
    in exact arithmetic use them without rounding (``exact_points``, ``exact_directions``).
    """

    points: np.ndarray
    normals: np.ndarray
    names: tuple[str, ...]
    written: tuple[Any, Any]

    def __init__(self, points: Any, normals: Any, names: Sequence[str] | None = None) -> None:
        directions = _table(normals, "normals")
        unit_vectors(directions, "; Contacts.along takes directions of any length")
        self._fill(points, normals, directions, names)

    @classmethod
    def along(cls, points: Any, directions: Any, names: Sequence[str] | None = None) -> Contacts:
        """Contacts with inward directions of any length but zero in place of unit normals.

        Raises
        ------
        GraspError
            Also for a direction of length zero.
        """
        self = object.__new__(cls)
        self._fill(points, directions, _table(directions, "normals"), names)
        return self

    def _fill(
        self, points: Any, directions: Any, along: np.ndarray, names: Sequence[str] | None
    ) -> None:
        at = _table(points, "points")
        if at.shape != along.shape:
            raise GraspError(
                f"as many normals as points are needed, of one dimension; points have shape "
                f"{at.shape}, normals {along.shape}"
            )
        lengths = np.linalg.norm(along, axis=1)
        if not lengths.all():
            j = int(np.argmin(lengths))
            raise GraspError(f"normal {j + 1} has length zero: it has no direction")
        called = tuple(names) if names is not None else _numbered(len(at))
        if len(called) != len(at):
            raise GraspError(
                f"{count_of(len(at), 'contact')} must have as many names, not {len(called)}"
            )
        unit = along / lengths[:, None]
        for array in (at, along, unit):
            array.setflags(write=False)
        object.__setattr__(self, "points", at)
        object.__setattr__(self, "normals", unit)
        object.__setattr__(self, "names", called)
        object.__setattr__(
            self, "written", (_as_written(points, at), _as_written(directions, along))
        )

    def __len__(self) -> int:
        return len(self.points)

    @property
    def count(self) -> int:
        """Number N of contacts."""
        return len(self.points)

    @property
    def dimension(self) -> int:
        """3 in space, 2 in the plane."""
        return self.points.shape[1]

    @property
    def freedoms(self) -> int:
        """Freedoms of the body, and rows of a wrench: 6 in space, 3 in the plane."""
        return 6 if self.dimension == 3 else 3

    @cached_property
    def wrenches(self) -> np.ndarray:
        """``W``, shape (6, N) or (3, N): unit pushes about the origin, force first [1, m]."""
        return wrenches_of(self.points, self.normals)

    @cached_property
    def centre(self) -> np.ndarray:
        """Mean of the points, shape (d,) [m]."""
        return self.points.mean(axis=0)

    @cached_property
    def length(self) -> float:
        """Root mean square distance of the points from their mean [m]; 1 if they coincide.

        Moments about the mean, divided by this length, compare with forces whatever the size of the
        body and wherever its frame.
        """
        spread = float(np.sqrt(np.mean(np.sum((self.points - self.centre) ** 2, axis=1))))
        return spread if spread > 0.0 else 1.0

    @cached_property
    def scaled_wrenches(self) -> np.ndarray:
        """Wrenches about :attr:`centre`, moments over :attr:`length`; shape as ``wrenches``."""
        W = wrenches_of(self.points - self.centre, self.normals)
        W[self.dimension :] /= self.length
        return W

    @cached_property
    def exact_points(self) -> tuple[tuple[Fraction, ...], ...]:
        """The points without rounding: a float is the fraction that it stands for."""
        return _fractions(self.written[0])

    @cached_property
    def exact_directions(self) -> tuple[tuple[Fraction, ...], ...]:
        """The directions of the normals as the caller wrote them, of any length."""
        return _fractions(self.written[1])

    def subset(self, numbers: Iterable[int]) -> Contacts:
        """Some of the contacts, by their numbers from 0, or by N truth values.

        Raises
        ------
        GraspError
            Numbers of contacts that there are not; none at all.
        """
        chosen = self._chosen(list(numbers))
        at, along = ([entries[j] for j in chosen] for entries in self.written)
        return Contacts.along(at, along, [self.names[j] for j in chosen])

    def _chosen(self, numbers: list[Any]) -> list[int]:
        if numbers and all(isinstance(number, bool | np.bool_) for number in numbers):
            if len(numbers) != self.count:
                raise GraspError(
                    f"{count_of(self.count, 'contact')} must have as many truth values, not "
                    f"{len(numbers)}"
                )
            numbers = [j for j, number in enumerate(numbers) if number]
        if not numbers:
            raise GraspError("a set of contacts has at least one; none was chosen")
        try:
            chosen = [index(number) for number in numbers]
        except TypeError as error:
            raise GraspError(f"contacts are chosen by whole numbers, not {numbers!r}") from error
        if min(chosen) < 0 or max(chosen) >= self.count:
            raise GraspError(f"contacts have the numbers 0 to {self.count - 1}; got {chosen}")
        return chosen

    def joined(self, other: Contacts) -> Contacts:
        """These contacts, then others in the same frame."""
        at, along = ([*a, *b] for a, b in zip(self.written, other.written, strict=True))
        names = [*self.names, *other.names]
        return Contacts.along(at, along, names if len(set(names)) == len(names) else None)

    def placed(self, pose: np.ndarray) -> Contacts:
        """The same contacts in another frame; ``pose`` (d + 1, d + 1) is this frame in it."""
        d = self.dimension
        R, x = np.asarray(pose)[:d, :d], np.asarray(pose)[:d, d]
        return Contacts.along(self.points @ R.T + x, self.normals @ R.T, self.names)


class HeldByContacts(Protocol):
    """An object with contacts, such as a grasp."""

    @property
    def contacts(self) -> Contacts:
        """Those that hold it."""


def as_contacts(holder: Contacts | HeldByContacts) -> Contacts:
    """Contacts as they are, or those of a grasp.

    Raises
    ------
    GraspError
        Something that neither is nor has contacts.
    """
    contacts = getattr(holder, "contacts", holder)
    if not isinstance(contacts, Contacts):
        raise GraspError(
            f"Contacts(points, normals), or a grasp that has some, are needed here, not "
            f"{type(holder).__name__}"
        )
    return contacts


def contacts_in_space(
    holder: Contacts | HeldByContacts, least: int = 1, most: int | None = None
) -> Contacts:
    """Contacts in space, or those of a grasp, of a number from ``least`` to ``most``.

    Raises
    ------
    GraspError
        Contacts in the plane, or another number.
    """
    contacts = as_contacts(holder)
    if contacts.dimension != 3 or not least <= contacts.count <= (most or contacts.count):
        wanted = f"{least} contacts" + (" or more" if most is None else "")
        where = "in space" if contacts.dimension == 3 else "in the plane"
        raise GraspError(f"{wanted} in space are needed here, not {contacts.count} {where}")
    return contacts


def wrenches_of(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Wrenches of unit pushes, shape (6, ...) or (3, ...), from arrays (..., d)."""
    if points.shape[-1] == 3:
        moments = np.cross(points, normals)
        return np.moveaxis(np.concatenate([normals, moments], axis=-1), -1, 0)
    moment = points[..., 0] * normals[..., 1] - points[..., 1] * normals[..., 0]
    return np.concatenate([np.moveaxis(normals, -1, 0), moment[None]])


def nearest_to_lines(points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The point (d,) nearest to lines through points (N, d), and its offsets (N, d) from them."""
    projectors = np.eye(points.shape[1]) - directions[:, :, None] * directions[:, None, :]
    sides = np.einsum("jab,jb->a", projectors, points)
    nearest = np.linalg.lstsq(projectors.sum(axis=0), sides, rcond=None)[0]
    return nearest, np.einsum("jab,jb->ja", projectors, points - nearest)


def _table(values: Any, what: str) -> np.ndarray:
    needed = f"{what} are finite numbers of shape (N, 3) in space or (N, 2) in the plane"
    return numbers_of(values, needed, (-1, 3), (-1, 2))


def _as_written(values: Any, table: np.ndarray) -> Any:
    """A copy of the input: fractions unchanged, all other numbers as floats."""
    entries = np.asarray(values)
    return tuple(map(tuple, entries.tolist())) if entries.dtype == object else table


def _fractions(entries: Any) -> tuple[tuple[Fraction, ...], ...]:
    rows = entries.tolist() if isinstance(entries, np.ndarray) else entries
    return tuple(tuple(map(Fraction, row)) for row in rows)


def _numbered(count: int) -> tuple[str, ...]:
    return tuple(f"contact {j + 1}" for j in range(count))
