r"""The contact problem of one instant: contact laws, scaling, and the residual of a solution.

x are the forces of m rows, y the rates that they meet, D the symmetric positive semidefinite
response and b the rates without these forces: :math:`y = D x + b`. Every row belongs to one contact
law, a normal row together with its two tangents:

=============  ====================================================================================
``Push``       :math:`0 \le x \perp y \ge 0`
``Bounded``    :math:`l \le x \le u`; y = 0 between, :math:`y \ge 0` at l, :math:`y \le 0` at u
``Friction``   :math:`0 \le x_n \perp y_n \ge 0`, :math:`|x_t| \le \mu x_n`, and
               :math:`x_t = -\mu x_n y_t / |y_t|` where :math:`y_t \ne 0` (Coulomb at zero slip)
``Sliding``    :math:`0 \le x_n \perp y_n \ge 0`, :math:`x_t = -\mu x_n s` with the slip direction s
=============  ====================================================================================

Bounds may be infinite: a row that is always active is ``Bounded(row, -inf, inf)``.

**Scaling.** Forces and rates are scaled by :math:`s_i = 1/\sqrt{D_{ii}}`,

.. math:: x = S \hat x, \qquad \hat y = S y, \qquad \hat D = S D S \;\text{with unit diagonal},

so that newtons and newton metres, grams and tonnes compare: both have the unit root of a power per
time (or of an energy). The two tangents of a contact share one scale, from the mean of their
responses: the cone stays round, with :math:`\hat\mu = \mu s_n/s_t`. A row without response takes
the smallest scale.

**Independent forces.** Sliding friction follows from its normal force. With E the matrix from the
independent forces z to all, and F the one that picks their rates,

.. math:: x = E z, \qquad w = F y = G z + g, \qquad G = F D E, \qquad g = F b .

E has the columns :math:`s_n (e_n - \mu (s_1 e_i + s_2 e_j))` for sliding contacts; G is symmetric
when there are none.

**Thresholds** are relative. The scale is the largest sum of absolute terms in any scaled rate, up
to ``GROWN`` times the largest free rate; every threshold except ``RANK`` is a part of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from multiarm.dynamics.solver.factors import rank_of

ROUNDED_RESIDUAL = 1e-12
"""A residual below this is rounding: some thousand machine epsilons, for sums of forty terms."""

RANK = 1e-10
"""A singular value of the scaled response below this part of the largest is zero.

The response is a square, J M^-1 J', so that this is 1e-5 in the rows: two contacts closer to
dependent than that would share their load by digits that are not there. It stands far above the
rounding of a response, 1e-13 or so."""

MARGIN = 1e-9
"""Forces this near to zero, to a bound or to the cone are taken to be there, rates to be zero.

An event leaves the quantity that caused it at zero within the accuracy to which it was located.
A row kept active with such a force would cause the same event again at once."""

RESOLVED = 0.1 * MARGIN
"""A residual that modes do not show: what the rounding of rows that depend on each other leaves."""

CONSISTENT = 4e-9
"""A motion is reproduced when the rates agree to this: what a few forces within ``MARGIN`` make."""

GROWN = 1e6
"""The scale is at most so many times the largest free rate: forces that grow without end, against
rates that contradict each other, do not pass for a solution."""

NO_RESPONSE = 1e-14
"""A response below this part of the largest is none: masses may differ by a factor of 1e12."""


class ContactMode(str, Enum):
    """What the rows of a contact law do from now on."""

    OPEN = "open"
    """No force; the contact separates."""
    RESTING = "resting"
    """Touches without force; inactive, because other rows keep it closed or nothing moves it."""
    CLOSED = "closed"
    """Pushes; of a contact with friction: without friction, other rows keep it from slipping."""
    STICKING = "sticking"
    """Pushes, and the force stays inside the friction cone."""
    SLIDING = "sliding"
    """Pushes, and slips or begins to: friction at its bound against the direction of slip."""
    AT_BOUND = "at the limit of friction"
    """Pushes, with friction at its bound against a direction; it does not slip yet: the bound has
    just been reached, or other rows keep it from slipping."""
    HOLDING = "holding"
    """Between its bounds, at rate zero."""
    AT_LOWER = "at lower bound"
    """The force is the lower bound, a constant from now on."""
    AT_UPPER = "at upper bound"
    """The force is the upper bound, a constant from now on."""


@dataclass(frozen=True)
class Push:
    """A contact without friction, or a joint limit.

    Attributes
    ----------
    row : int
        Its row: force [N] or [N m], positive pushes; rate, positive separates.
    """

    row: int


@dataclass(frozen=True)
class Bounded:
    """A force between two bounds that opposes motion: dry friction of a joint at rest.

    Attributes
    ----------
    row : int
        Its row; force times rate is power.
    lower, upper : float
        Bounds of the force [N] or [N m]; may be infinite.
    """

    row: int
    lower: float
    upper: float

    def __post_init__(self) -> None:
        assert self.lower <= self.upper, "the lower bound is above the upper one"


@dataclass(frozen=True)
class Friction:
    """A contact with Coulomb friction that does not slip at this instant.

    Attributes
    ----------
    row : int
        Normal row.
    tangents : tuple of int
        Rows of two orthogonal tangents, measured in one unit of length.
    mu : float
        Coefficient of friction; zero is allowed.
    """

    row: int
    tangents: tuple[int, int]
    mu: float

    def __post_init__(self) -> None:
        assert self.mu >= 0.0, "a coefficient of friction is not negative"


@dataclass(frozen=True)
class Sliding:
    """A contact that slips at this instant, so that the direction of friction is given.

    Attributes
    ----------
    row, tangents, mu
        As in :class:`Friction`.
    direction : tuple of float
        Unit vector of the slip velocity, in the tangents.
    """

    row: int
    tangents: tuple[int, int]
    mu: float
    direction: tuple[float, float]

    def __post_init__(self) -> None:
        assert self.mu >= 0.0, "a coefficient of friction is not negative"
        assert abs(self.direction[0] ** 2 + self.direction[1] ** 2 - 1.0) < 1e-9, "a unit vector"


ContactLaw = Push | Bounded | Friction | Sliding


def rows_of(law: ContactLaw) -> tuple[int, ...]:
    """The rows of a law, the normal one first."""
    return (law.row,) if isinstance(law, (Push, Bounded)) else (law.row, *law.tangents)


@dataclass(frozen=True)
class Cone:
    """Friction at zero slip: column of the normal force, scaled coefficient."""

    normal: int
    mu: float

    @property
    def tangents(self) -> slice:
        """Columns of the tangential forces."""
        return slice(self.normal + 1, self.normal + 3)


@dataclass(frozen=True)
class Problem:
    """Scaled problem with r independent forces.

    Attributes
    ----------
    D, b : ndarray, shapes (m, m), (m,)
        Response and free rates as given.
    laws : tuple
        The contact laws.
    scale : ndarray, shape (m,)
        ``s``: scaled forces are ``x / s``, scaled rates ``s y``.
    rows : ndarray, shape (r,)
        The row of each independent force.
    columns : tuple of int
        The first independent force of each law.
    E : ndarray, shape (m, r)
        Forces from independent forces.
    G, g : ndarray, shapes (r, r), (r,)
        Scaled response and free rates of these.
    terms : ndarray, shape (r, r)
        Sums of the absolute terms of G, which friction may cancel.
    lower, upper : ndarray, shape (r,)
        Their bounds; infinite for tangents of cones.
    cones : mapping of int to Cone
        Contacts with friction at zero slip, by the column of the normal force.
    """

    D: np.ndarray
    b: np.ndarray
    laws: tuple[ContactLaw, ...]
    scale: np.ndarray
    rows: np.ndarray
    columns: tuple[int, ...]
    E: np.ndarray
    G: np.ndarray
    g: np.ndarray
    terms: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    cones: dict[int, Cone]

    @property
    def convex(self) -> bool:
        """No friction: pushing contacts and bounds alone."""
        return not any(isinstance(law, (Friction, Sliding)) for law in self.laws)

    def size(self, z: np.ndarray) -> float:
        """The scale: the largest sum of absolute terms in any rate (0 when all is zero)."""
        size = float(np.max(np.abs(self.g) + self.terms @ np.abs(z), initial=0.0))
        free = float(np.max(np.abs(self.g), initial=0.0))
        return min(size, GROWN * free) if free > 0.0 else size

    def residual(self, z: np.ndarray) -> float:
        """How far independent forces are from obeying all laws, as a part of the scale.

        The largest entry of :math:`z - P(z - w)`, P the projection on the forces that the laws
        allow. It bounds forces that pull, rates that penetrate, force times gap, what is outside
        of a cone, and friction that does not oppose slip; it is zero for solutions only.
        """
        size = self.size(z)
        if size == 0.0:
            return 0.0
        return float(np.max(np.abs(z - self._project(z - self.G @ z - self.g, z)))) / size

    def without_force(self) -> np.ndarray:
        """No independent force, or the bound nearest to none."""
        return np.clip(np.zeros(self.g.size), self.lower, self.upper)

    def independent(self, forces: np.ndarray) -> np.ndarray:
        """Independent forces of given ones, within their bounds."""
        return np.clip((forces / self.scale)[self.rows], self.lower, self.upper)

    def _project(self, p: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Nearest allowed forces; a friction disk has its radius from the normal force in ``z``."""
        projected = np.clip(p, self.lower, self.upper)
        for cone in self.cones.values():
            tangents, radius = p[cone.tangents], cone.mu * max(z[cone.normal], 0.0)
            length = np.hypot(*tangents)
            if length > radius:
                projected[cone.tangents] = tangents * (radius / length)
        return projected


def build(D: np.ndarray, b: np.ndarray, laws: Sequence[ContactLaw]) -> Problem:
    """Scale and reduce a problem; the matrices are not copied."""
    covered = sorted(row for law in laws for row in rows_of(law))
    assert covered == list(range(b.size)), "every row belongs to one law"
    scale = _scales(D, laws)
    rows: list[int] = []
    lower, upper, columns = [], [], []
    cones: dict[int, Cone] = {}
    for law in laws:
        k, s = len(rows), scale[law.row]
        columns.append(k)
        rows.append(law.row)
        low, high = (law.lower, law.upper) if isinstance(law, Bounded) else (0.0, np.inf)
        lower.append(low / s)
        upper.append(high / s)
        if isinstance(law, Friction):
            rows += law.tangents
            lower += [-np.inf, -np.inf]
            upper += [np.inf, np.inf]
            cones[k] = Cone(k, law.mu * s / scale[law.tangents[0]])
    picked = np.array(rows, dtype=int)
    E = np.zeros((b.size, picked.size))
    E[picked, np.arange(picked.size)] = scale[picked]
    for k, law in zip(columns, laws, strict=True):
        if isinstance(law, Sliding):
            E[list(law.tangents), k] = -law.mu * scale[law.row] * np.asarray(law.direction)
    picks = scale[picked, None]
    return Problem(
        D=D,
        b=b,
        laws=tuple(laws),
        scale=scale,
        rows=picked,
        columns=tuple(columns),
        E=E,
        G=picks * D[picked] @ E,
        g=scale[picked] * b[picked],
        terms=picks * np.abs(D[picked]) @ np.abs(E),
        lower=np.array(lower),
        upper=np.array(upper),
        cones=cones,
    )


def _scales(D: np.ndarray, laws: Sequence[ContactLaw]) -> np.ndarray:
    response = D.diagonal().copy()
    for law in laws:
        if isinstance(law, (Friction, Sliding)):
            response[list(law.tangents)] = np.mean(response[list(law.tangents)])
    largest = np.max(response, initial=0.0)
    if largest <= 0.0:
        return np.ones(response.size)
    return 1.0 / np.sqrt(np.where(response > NO_RESPONSE * largest, response, largest))


def matrix_rank(A: np.ndarray) -> int:
    """Rank of a scaled response, or of part of one."""
    return rank_of(np.linalg.svd(A, compute_uv=False), RANK, 1.0)
