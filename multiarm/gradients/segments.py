r"""Segments of a run, and panels over which its variational equation is solved.

Over a segment the matrices are series (:mod:`multiarm.gradients.interpolation`).  A panel of it is
solved as a whole (:mod:`multiarm.gradients.collocation`), and again in two halves; for a method of
order p, the result of the halves is wrong by

.. math:: \frac{y_{\text{whole}} - y_{\text{halves}}}{2^p - 1} .

Panels for which that is too much are divided.
"""

from __future__ import annotations

from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.gradients.collocation import NODES, ORDER, Collocation
from multiarm.gradients.interpolation import Series

# Shortest panels and segments that are tried, as part of the run.
SHORTEST = 1e-6
RICHARDSON = 2.0**ORDER - 1.0
# In place of sizes that are zero.
TINY = 1e-300


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

    @property
    def halves(self) -> tuple[Panel, Panel]:
        """The panel in two."""
        middle = 0.5 * (self.begin + self.end)
        return Panel(self.begin, middle), Panel(middle, self.end)


class Coefficients(NamedTuple):
    """The variational equation at some times, or an error of it.

    Attributes
    ----------
    A : ndarray, shape (k, D, D)
        By the state.
    B : ndarray, shape (k, D, n)
        By torques that are added to the joints.
    beta : ndarray, shape (k, D, P)
        By the parameters.
    rate, slope : ndarray, shapes (k,), (k, D)
        An integrand and its derivatives; zero without one.
    """

    A: np.ndarray
    B: np.ndarray
    beta: np.ndarray
    rate: np.ndarray
    slope: np.ndarray


class Segment:
    """A piece of time over which the matrices are a series.

    Attributes
    ----------
    panel : Panel
        The whole of it.
    defect, error : float
        Of the series, relative to its largest value; the error that it alone may make, relative to
        a displacement.  Twice the degree about squares the first.
    """

    def __init__(self, panel: Panel, values: np.ndarray, joints: int) -> None:
        self.panel, self._joints = panel, joints
        self._series = Series(panel.begin, panel.end, values)
        size = values.shape[1] - 1
        wrong = self._series.defect[:size, :size].max()
        self.defect = float(wrong / np.abs(values[:, :size, :size]).max())
        self.error = float(panel.length * wrong)

    def at(self, times: list[float]) -> tuple[Coefficients, Coefficients]:
        """Coefficients at some times, and their defects."""
        values, defects = self._series.at(times)
        return self._parts(values), self._parts(defects)

    def pieces(self, bounds: np.ndarray) -> list[Piece]:
        """Pieces to begin with, from one of the given times to the next, in order."""
        inner = bounds[(bounds > self.panel.begin) & (bounds < self.panel.end)]
        times = [self.panel.begin, *inner.tolist(), self.panel.end]
        return [Piece(self, Panel(*pair)) for pair in pairwise(times)]

    def _parts(self, values: np.ndarray) -> Coefficients:
        size, n = values.shape[1] - 1, self._joints
        rows, last = values[:, :-1], values[:, -1]
        return Coefficients(
            A=rows[:, :, :size],
            B=rows[:, :, size : size + n],
            beta=rows[:, :, size + n : -1],
            rate=last[:, -1],
            slope=rows[:, :, -1],
        )


class Piece:
    """A panel of a segment, with the solution of its equation.

    Attributes
    ----------
    panel : Panel
    at, defect : Coefficients
        At its nodes, and their defects.
    collocation : Collocation
    """

    def __init__(self, segment: Segment, panel: Panel) -> None:
        self._segment, self.panel = segment, panel
        self.at, self.defect = segment.at(panel.nodes)
        self.collocation = Collocation(self.at.A, panel.length)

    @cached_property
    def halves(self) -> tuple[Piece, Piece]:
        """The piece in two."""
        first, second = self.panel.halves
        return Piece(self._segment, first), Piece(self._segment, second)
