r"""Form closure decided in rational arithmetic, without rounding or tolerance (thesis, 2.1).

Points and directions are fractions (every float is one), so are the wrenches
``[d_j; (p_j - c) x d_j]`` of the directions as the user wrote them, about the middle c of the
points.  Two steps decide:

1. elimination finds the rank, and when it is too small, a ``v != 0`` with ``W^T v = 0``;
2. the simplex method minimises the sum of ``s >= 0`` in ``W mu + s = -W 1`` with ``mu >= 0``.  The
   minimum 0 proves closure with the pushes ``lam = 1 + mu``.  Otherwise the dual variables y of
   the optimum have ``W^T y <= 0`` and ``-1^T W^T y > 0``, and ``v = -y`` is a motion that no
   contact resists.

Bland's rule (1977) ends the simplex method however degenerate the contacts are.  Both steps use
integers: division by the previous pivot is exact (Bareiss 1968; Edmonds 1967), and entries stay
determinants of the data instead of growing with every step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm

from multiarm.grasp.contacts import Contacts

Table = list[list[int]]


@dataclass(frozen=True)
class ExactBalance:
    """Outcome of the exact decision.

    Attributes
    ----------
    rank : int
    pushes : tuple of Fraction, length N, or None
        Of sum 1, all positive, along the directions as given; when closed.
    motion : tuple of Fraction, length n, or None
        Twist about ``about`` that no contact resists; when open.
    about : tuple of Fraction, length d
        Mean of the points.
    """

    rank: int
    pushes: tuple[Fraction, ...] | None
    motion: tuple[Fraction, ...] | None
    about: tuple[Fraction, ...]

    @property
    def motion_about_origin(self) -> tuple[Fraction, ...] | None:
        """The motion, as a twist about the origin of the frame."""
        if self.motion is None:
            return None
        d = len(self.about)
        linear, angular = self.motion[:d], self.motion[d:]
        turned = _cross(angular, self.about)
        return (*(v - t for v, t in zip(linear, turned, strict=True)), *angular)


def exact_balance(contacts: Contacts) -> ExactBalance:
    """Decide form closure of contacts as given, without rounding."""
    about = tuple(sum(x) / contacts.count for x in zip(*contacts.exact_points, strict=True))
    pairs = zip(contacts.exact_points, contacts.exact_directions, strict=True)
    columns = [_wrench([x - c for x, c in zip(p, about, strict=True)], e) for p, e in pairs]
    scales = [lcm(*(x.denominator for x in column)) for column in columns]
    integers = [[int(x * s) for x in column] for column, s in zip(columns, scales, strict=True)]
    rows = [list(row) for row in zip(*integers, strict=True)]
    rank, resting = eliminate(rows)
    if resting is not None:
        return ExactBalance(rank, None, tuple(map(Fraction, resting)), about)
    pushes, motion = positive_balance(rows)
    if pushes is None:
        return ExactBalance(rank, None, motion, about)
    along_directions = [push * s for push, s in zip(pushes, scales, strict=True)]
    total = sum(along_directions)
    return ExactBalance(rank, tuple(push / total for push in along_directions), None, about)


def eliminate(rows: Table) -> tuple[int, list[int] | None]:
    """Rank of an integer matrix W, and ``v != 0`` with ``v^T W = 0`` if rows are dependent."""
    n, width = len(rows), len(rows[0])
    table = [[*row, *(int(i == k) for k in range(n))] for i, row in enumerate(rows)]
    rank, last = 0, 1
    for column in range(width):
        pivot_row = next((i for i in range(rank, n) if table[i][column]), None)
        if pivot_row is None:
            continue
        table[rank], table[pivot_row] = table[pivot_row], table[rank]
        _clear(table, range(rank + 1, n), rank, column, last)
        last, rank = table[rank][column], rank + 1
        if rank == n:
            return rank, None
    return rank, table[rank][width:]


def positive_balance(
    rows: Table,
) -> tuple[tuple[Fraction, ...] | None, tuple[Fraction, ...] | None]:
    """Pushes ``lam >= 1`` with ``W lam = 0``, or a motion with ``W^T v >= 0`` and a positive sum.

    One of the two is None.  ``W``, of integers, has full row rank or any other.
    """
    n, count = len(rows), len(rows[0])
    signs = [1 if sum(row) <= 0 else -1 for row in rows]
    table = [
        [*(s * x for x in row), *(int(i == k) for k in range(n)), -s * sum(row)]
        for i, (s, row) in enumerate(zip(signs, rows, strict=True))
    ]
    sums = [-sum(column) for column in zip(*table, strict=True)]
    table.append([*sums[:count], *([0] * n), sums[-1]])
    basis = list(range(count, count + n))
    last = 1
    while table[n][-1]:
        entering = next((j for j in range(count) if table[n][j] < 0), None)
        if entering is None:
            prices = [1 - Fraction(x, last) for x in table[n][count:-1]]
            return None, tuple(-s * y for s, y in zip(signs, prices, strict=True))
        leaving = _shortest(table, basis, entering)
        _clear(table, [i for i in range(n + 1) if i != leaving], leaving, entering, last)
        last, basis[leaving] = table[leaving][entering], entering
    pushes = [Fraction(1)] * count
    for i, j in enumerate(basis):
        if j < count:
            pushes[j] += Fraction(table[i][-1], last)
    return tuple(pushes), None


def _shortest(table: Table, basis: list[int], entering: int) -> int:
    """Row that bounds the entering variable first; among equals, of the lowest variable (Bland).

    There is one: the objective, a sum of non-negative numbers, is bounded.
    """
    rows = [i for i in range(len(basis)) if table[i][entering] > 0]
    return min(rows, key=lambda i: (Fraction(table[i][-1], table[i][entering]), basis[i]))


def _clear(table: Table, targets: Sequence[int], row: int, column: int, last: int) -> None:
    """Make a column zero in the other rows; division by the last pivot leaves no remainder."""
    pivot, source = table[row][column], table[row]
    for i in targets:
        factor = table[i][column]
        table[i] = [(x * pivot - factor * y) // last for x, y in zip(table[i], source, strict=True)]


def _wrench(p: Sequence[Fraction], e: Sequence[Fraction]) -> list[Fraction]:
    if len(p) == 2:
        return [*e, p[0] * e[1] - p[1] * e[0]]
    return [*e, *_cross(p, e)]


def _cross(a: Sequence[Fraction], b: Sequence[Fraction]) -> list[Fraction]:
    """``a x b``; in the plane ``a`` is one number, along the third axis."""
    if len(a) == 1:
        return [-a[0] * b[1], a[0] * b[0]]
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
