r"""Segments of a run, and panels over which its variational equation is solved.

*Coordinates.*  Displacements that keep the joints closed are a space with a basis N(t).  Over a
segment they have the coordinates :math:`\eta = R^T\delta` in the basis R of its middle,

.. math::
    \delta = E\,\eta + n\,\delta p, \qquad E = N (R^T N)^{-1}, \qquad R^T n = 0,

with n for joints that parameters move.  As R is constant, :math:`\dot\eta = R^T\dot\delta`:

.. math::
    \dot\eta = R^T A E\,\eta + R^T B\,\delta\tau + R^T (\beta + A n)\,\delta p .

Two welded arms of six joints have 12 coordinates in place of 36, and more such arms no more.  At
the ends of segments the coordinates change by way of :math:`\delta`, which stays on the joints
thereby.

Over a segment these matrices are series (:mod:`multiarm.gradients.interpolation`).  A panel of it
is solved as a whole (:mod:`multiarm.gradients.collocation`), and again in two halves; for a method
of order p, the result of the halves is wrong by

.. math:: \frac{y_{\text{whole}} - y_{\text{halves}}}{2^p - 1} .

The estimate takes p = 5, the order of the stages: long panels and strong damping leave no more of
the method's order nine.  Panels with a larger error than allowed are divided.

*The comparison run.*  Along it (:mod:`multiarm.gradients.run_series`), the matrices differ by
as little as the states.  In the same basis R, their differences are series of a low degree, from
few evaluations; with them added, a segment of the run is one of the comparison run.

*Roundings.*  Derivatives by parameters are exact to a part ``ROUNDING`` of their typical size, that
of a parameter whose change by its size changes the accelerations as a whole.  Smaller derivatives,
such as those that vanish by symmetry, are not resolved any finer.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.sensitivity import free_bases
from multiarm.errors import SolverError
from multiarm.gradients.collocation import COUNT, NODES, Collocation
from multiarm.gradients.interpolation import Series, nodes
from multiarm.gradients.variational_equation import TINY, VariationalEquation

# Shortest panels and segments that are tried, as part of the run.
SHORTEST = 1e-6
RICHARDSON = 2.0**COUNT - 1.0
# Dividing a piece of time pays as long as it lessens the error by this factor; panels may miss that
# so many times in a row.
LESSENED, PATIENCE = 0.5, 6
# Of derivatives by parameters, relative to what they are as a rule.
ROUNDING = 1e-9


class Panel(NamedTuple):
    """A piece of time over which the equation is solved at once [s]."""

    begin: float
    end: float

    @property
    def length(self) -> float:
        """[s]"""
        return self.end - self.begin

    @property
    def nodes(self) -> list[float]:
        """The nodes of the collocation [s]."""
        return (self.begin + NODES * self.length).tolist()

    def parts(self, count: int) -> list[Panel]:
        """The panel in equal parts."""
        times = np.linspace(self.begin, self.end, count + 1).tolist()
        return [Panel(*pair) for pair in pairwise(times)]


class Halving(NamedTuple):
    """What halving a panel has gained; panels are halved as long as that lessens their errors."""

    error: float = math.inf  # of the panel that was halved last
    without_gain: int = 0  # halvings in sequence that have not lessened the error

    def next(self, error: float, part: float) -> Halving | None:
        """What comes after this error of a panel, a part of the run; None: no further division."""
        without_gain = self.without_gain + 1 if error > LESSENED * self.error else 0
        divided = part > SHORTEST and without_gain < PATIENCE
        return Halving(error, without_gain) if divided else None


WHOLE = Halving()


class Coefficients(NamedTuple):
    """The variational equation at some times, or an error of it, in d coordinates.

    Attributes
    ----------
    A : ndarray, shape (k, d, d)
        By the state.
    B : ndarray, shape (k, d, n)
        By torques that are added to the joints.
    beta : ndarray, shape (k, d, P)
        By the parameters.
    slope : ndarray, shape (k, d)
        Derivatives of an integrand; zero without one.
    rates : ndarray, shape (k, 1 + P)
        The integrand, and what parameters change of it as they move the joints.
    """

    A: np.ndarray
    B: np.ndarray
    beta: np.ndarray
    slope: np.ndarray
    rates: np.ndarray


class Segment:
    """A piece of time over which the equation is a series.

    Parameters
    ----------
    panel : Panel
    values : sequence of VariationalEquation
        At the nodes of a series of even degree.

    Attributes
    ----------
    panel : Panel
        The whole of it.
    basis : ndarray, shape (D, d)
        R.
    scale : ndarray, shape (d, P)
        What derivatives by the parameters are as a rule, for each coordinate.
    steepest : float
        The largest derivative of the integrand by any displacement.
    defect, error : float
        Of the series, relative to its largest value; the error that it alone may make, relative to
        a displacement.  Twice the degree about squares the first.

    Raises
    ------
    SolverError
        When the number of displacements that keep the joints closed changes.
    """

    def __init__(self, panel: Panel, values: Sequence[VariationalEquation]) -> None:
        bases = _bases(panel, values)
        self.panel, self.basis = panel, bases[len(bases) // 2]
        self._joints, (_, d) = values[0].B.shape[1], self.basis.shape
        self.scale = np.abs(self.basis.T) @ np.max([value.scale for value in values], axis=0)
        self.steepest = float(np.abs([value.slope for value in values]).max())
        matrices, lifts = _in_coordinates(values, bases, self.basis)
        self._series, self._lift = Series(*panel, matrices), Series(*panel, lifts)
        defect = self._series.defect[:d, :d].max(initial=0.0)
        self.defect = float(defect / np.abs(matrices[:, :d, :d]).max(initial=TINY))
        of_lift = self._lift.defect[:, :d].max(initial=0.0)
        self.error = float(max(panel.length * defect, of_lift))

    def of_comparison_run(self, values: Sequence[VariationalEquation]) -> Segment:
        """The segment of the comparison run, with values at the nodes of a low degree."""
        panel, segment = self.panel, copy(self)
        times = nodes(*panel, len(values) - 1)
        moved = _in_coordinates(values, _bases(panel, values), self.basis)
        series = self._series, self._lift
        changes = [
            Series(*panel, matrices - of_run.at(times)[0])
            for of_run, matrices in zip(series, moved, strict=True)
        ]
        segment._series, segment._lift = map(Series.plus, series, changes)
        return segment

    @property
    def numbers(self) -> int:
        """How many numbers its series have."""
        return self._series.numbers + self._lift.numbers

    def at(self, times: list[float]) -> tuple[Coefficients, Coefficients]:
        """Coefficients at some times, and their defects."""
        values, defects = self._series.at(times)
        return self._parts(values), self._parts(defects)

    def lift(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """``E`` and ``n`` at a time, shapes (D, d) and (D, P)."""
        both = self._lift.at([t])[0][0]
        return both[:, : self.basis.shape[1]], both[:, self.basis.shape[1] :]

    def panels(self, bounds: np.ndarray) -> list[CollocatedPanel]:
        """Pieces to begin with, from each of some times to the next, in order."""
        inner = bounds[(bounds > self.panel.begin) & (bounds < self.panel.end)]
        times = [self.panel.begin, *inner.tolist(), self.panel.end]
        return [CollocatedPanel(self, Panel(*pair)) for pair in pairwise(times)]

    def _parts(self, values: np.ndarray) -> Coefficients:
        size, n = values.shape[1] - 1, self._joints
        rows, last = values[:, :-1], values[:, -1]
        return Coefficients(
            A=rows[:, :, :size],
            B=rows[:, :, size : size + n],
            beta=rows[:, :, size + n : -1],
            slope=rows[:, :, -1],
            rates=np.roll(last[:, size + n :], 1, axis=1),
        )


def _bases(panel: Panel, values: Sequence[VariationalEquation]) -> list[np.ndarray]:
    """N at the nodes of a segment, with the components of places."""
    bases = free_bases([value.motions for value in values])
    states, size = values[0].motions.constraint.shape[1], len(values[0].A)
    if size > states:
        bases = [
            _with_places(N, value.place_offset, size)
            for N, value in zip(bases, values, strict=True)
        ]
    if len({N.shape for N in bases}) > 1:
        raise SolverError(
            f"the rank of the constraints changes between {panel.begin:.6g} s and "
            f"{panel.end:.6g} s, where the run has no derivatives"
        )
    return bases


def _with_places(N: np.ndarray, offset: np.ndarray, size: int) -> np.ndarray:
    """N for displacements with components of places, of which the last ones may be of no use."""
    (states, d), r = N.shape, offset.shape[1]
    whole = np.zeros((size, d + r))
    whole[:states, :d], whole[:states, d:] = N, offset
    whole[states : states + r, d:] = np.eye(r)
    return np.linalg.qr(whole).Q


def _in_coordinates(
    values: Sequence[VariationalEquation], bases: Sequence[np.ndarray], R: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """All matrices of the equation in the coordinates of a basis, and (E, n), at each node.

    Shapes (k, d + 1, d + n + P + 1) and (k, D, d + P).  The last row is that of the integrand, the
    last column its slope.
    """
    columns = "A", "B", "beta", "offset", "slope"
    A, B, beta, offset, slope = (np.stack([getattr(v, name) for v in values]) for name in columns)
    N, to, joints, d = np.stack(bases), R.T, B.shape[2], R.shape[1]
    E = N @ np.linalg.inv(to @ N)
    n = offset - E @ (to @ offset)
    matrices = np.zeros((len(values), d + 1, d + joints + beta.shape[2] + 1))
    by_slope = np.einsum("kd,kde->ke", slope, np.dstack([E, n]))
    matrices[:, :d, :-1] = np.dstack([to @ (A @ E), to @ B, to @ (beta + A @ n)])
    matrices[:, :d, -1], matrices[:, d, d + joints : -1] = by_slope[:, :d], by_slope[:, d:]
    matrices[:, d, -1] = [value.rate for value in values]
    return matrices, np.dstack([E, n])


class CollocatedPanel:
    """A panel of a segment, with the solution of its equation.

    Attributes
    ----------
    panel : Panel
    at, defect : Coefficients
        At its nodes, and their defects.
    collocation : Collocation
    scale : ndarray, shape (d, P)
        That of the segment.
    """

    def __init__(self, segment: Segment, panel: Panel) -> None:
        self._segment, self.panel, self.scale = segment, panel, segment.scale
        self.at, self.defect = segment.at(panel.nodes)
        self.collocation = Collocation(self.at.A, panel.length)

    @cached_property
    def halves(self) -> tuple[CollocatedPanel, CollocatedPanel]:
        """Solutions over the two halves of the panel."""
        first, second = self.panel.parts(2)
        return CollocatedPanel(self._segment, first), CollocatedPanel(self._segment, second)
