r"""The problem in columns without units: rows scaled, sliding friction tied to its normal force.

Forces and rates are scaled by :math:`s_i = 1/\sqrt{D_{ii}}`,

.. math:: x = S \hat x, \qquad \hat y = S y, \qquad \hat D = S D S \;\text{with unit diagonal},

so that newtons and newton metres, grams and tonnes compare. The two tangents of a contact share one
scale (from the mean of their responses): the cone stays round, with :math:`\hat\mu = \mu s_n/s_t`.
A row that nothing moves (no response) takes the smallest scale.

Sliding friction follows from its normal force. With E the matrix from the independent forces z to
all, and F the one that picks their rates,

.. math:: x = E z, \qquad w = F y = G z + g, \qquad G = F D E, \qquad g = F b .

E has the columns :math:`s_n (e_n - \mu (s_1 e_i + s_2 e_j))` for sliding units; G is symmetric when
there are none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiarm.events.complementarity.units import Bounded, Friction, Sliding, Unit, rows_of

# A response below this part of the largest is none: masses may differ by a factor of 1e12.
DEAD = 1e-14


@dataclass(frozen=True)
class Cone:
    """A contact with friction: columns of its normal and tangents, scaled coefficient."""

    normal: int
    tangents: slice
    mu: float


@dataclass(frozen=True)
class Problem:
    """Scaled problem with r independent forces.

    Attributes
    ----------
    D, b : ndarray, shapes (m, m), (m,)
        Response and free rates as given.
    units : tuple
        The laws.
    scale : ndarray, shape (m,)
        ``s``: scaled forces are ``x / s``, scaled rates ``s y``.
    E : ndarray, shape (m, r)
        Forces from independent forces.
    G, g : ndarray, shapes (r, r), (r,)
        Scaled response and free rates of these.
    terms : ndarray, shape (r, r)
        Sums of the absolute terms of G, which friction may cancel.
    lower, upper : ndarray, shape (r,)
        Their bounds; infinite for tangents of cones.
    cones : tuple of Cone
        Contacts with friction at zero slip.
    first : tuple of int
        First column of each unit.
    """

    D: np.ndarray
    b: np.ndarray
    units: tuple[Unit, ...]
    scale: np.ndarray
    E: np.ndarray
    G: np.ndarray
    g: np.ndarray
    terms: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    cones: tuple[Cone, ...]
    first: tuple[int, ...]

    @property
    def convex(self) -> bool:
        """No friction: pushing contacts and bounds alone."""
        return not any(isinstance(unit, (Friction, Sliding)) for unit in self.units)

    def size(self, z: np.ndarray) -> float:
        """The scale: the largest sum of absolute terms in any rate (0 when all is zero)."""
        return float(np.max(np.abs(self.g) + self.terms @ np.abs(z), initial=0.0))

    def residual(self, z: np.ndarray) -> float:
        """How far independent forces are from obeying all laws, as a part of the scale.

        The largest entry of :math:`z - P(z - w)`, P the projection on the forces that the laws
        allow. It bounds forces that pull, rates that penetrate, force times gap, what is outside
        of a cone, and friction that does not oppose slip; it is zero for solutions only.
        """
        size = self.size(z)
        if size == 0.0:
            return 0.0
        return float(np.max(np.abs(z - self.project(z - self.G @ z - self.g, z)))) / size

    def without_force(self) -> np.ndarray:
        """No independent force, or the bound nearest to none."""
        return np.clip(np.zeros(self.g.size), self.lower, self.upper)

    def independent(self, x: np.ndarray) -> np.ndarray:
        """The independent forces of forces whose friction is tied as the laws ask."""
        columns = [row for unit in self.units for row in _free_rows(unit)]
        return (x / self.scale)[columns]

    def project(self, p: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Nearest allowed forces; a disk of friction is that of the normal force in ``z``."""
        projected = np.clip(p, self.lower, self.upper)
        for cone in self.cones:
            tangents, radius = p[cone.tangents], cone.mu * max(z[cone.normal], 0.0)
            length = np.hypot(*tangents)
            if length > radius:
                projected[cone.tangents] = tangents * (radius / length)
        return projected


def build(D: np.ndarray, b: np.ndarray, units: Sequence[Unit]) -> Problem:
    """Scale and reduce a problem; the matrices are not copied."""
    scale = _scales(D, units)
    m, width = b.size, sum(3 if isinstance(unit, Friction) else 1 for unit in units)
    E, F = np.zeros((m, width)), np.zeros((width, m))
    lower, upper = np.zeros(width), np.full(width, np.inf)
    cones, first, k = [], [], 0
    for unit in units:
        n = unit.row
        first.append(k)
        E[n, k] = F[k, n] = scale[n]
        if isinstance(unit, Bounded):
            lower[k], upper[k] = unit.lower / scale[n], unit.upper / scale[n]
        elif isinstance(unit, Sliding):
            E[list(unit.tangents), k] = -unit.mu * scale[n] * np.asarray(unit.direction)
        elif isinstance(unit, Friction):
            tangents = slice(k + 1, k + 3)
            for column, row in zip((k + 1, k + 2), unit.tangents, strict=True):
                E[row, column] = F[column, row] = scale[row]
            lower[tangents] = -np.inf
            cones.append(Cone(k, tangents, unit.mu * scale[n] / scale[unit.tangents[0]]))
            k += 2
        k += 1
    G, g, terms = F @ D @ E, F @ b, F @ np.abs(D) @ np.abs(E)
    return Problem(
        D, b, tuple(units), scale, E, G, g, terms, lower, upper, tuple(cones), tuple(first)
    )


def _free_rows(unit: Unit) -> tuple[int, ...]:
    """Rows of a unit whose forces are unknowns of their own."""
    return rows_of(unit) if isinstance(unit, Friction) else (unit.row,)


def _scales(D: np.ndarray, units: Sequence[Unit]) -> np.ndarray:
    response = D.diagonal().copy()
    for unit in units:
        if isinstance(unit, (Friction, Sliding)):
            response[list(unit.tangents)] = np.mean(response[list(unit.tangents)])
    largest = np.max(response, initial=0.0)
    if largest <= 0.0:
        return np.ones(response.size)
    return 1.0 / np.sqrt(np.where(response > DEAD * largest, response, largest))


def covers(units: Sequence[Unit], rows: int) -> bool:
    """Whether every row belongs to exactly one unit."""
    return sorted(row for unit in units for row in rows_of(unit)) == list(range(rows))
