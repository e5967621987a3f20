r"""Matrices as functions of time: Chebyshev series over a segment of a run.

With :math:`x = \cos(k\pi/m)`, k = 0 ... m, mapped to the segment, values at the nodes give the
coefficients of the interpolating polynomial of degree m by one product with a constant matrix.
Matrices of a run are smooth between the times at which control or loads are not, so that
coefficients fall geometrically (L.N. Trefethen, Approximation Theory and Approximation Practice,
2013).  The *defect*, the part of the two highest degrees, is larger than the error of the whole
series, and serves as its bound.

A series of twice the degree uses all nodes again.  They lie slightly within the
segment: at its ends the control may jump, and the sides of a jump belong to two segments.
"""

from __future__ import annotations

import math
from copy import copy
from functools import cache

import numpy as np

# Degrees that are tried for a segment before it is divided.
DEGREES = (8, 12, 16, 24, 32)
# How far inside the ends the outer nodes lie, as part of the length.
INSIDE = 1e-11


def nodes(begin: float, end: float, degree: int) -> list[float]:
    """The nodes of a segment [s]; those of half the degree are every second one."""
    middle, half = _range(begin, end)
    return [middle - half * math.cos(math.pi * k / degree) for k in range(degree + 1)]


class Series:
    """A polynomial with array values over a segment.

    Parameters
    ----------
    begin, end : float
        [s]
    values : ndarray, shape (m + 1, ...)
        At the nodes.
    """

    def __init__(self, begin: float, end: float, values: np.ndarray) -> None:
        self._middle, self._half = _range(begin, end)
        self._shape = values.shape[1:]
        self._coefficients = _transform(len(values) - 1) @ values.reshape(len(values), -1)

    def plus(self, change: Series) -> Series:
        """The sum with a series of the same or a lower degree over the same segment."""
        total = copy(self)
        total._coefficients = self._coefficients.copy()
        total._coefficients[: len(change._coefficients)] += change._coefficients
        return total

    @property
    def numbers(self) -> int:
        """How many coefficients there are."""
        return self._coefficients.size

    @property
    def defect(self) -> np.ndarray:
        """Bound of the defect, shape (...)."""
        return np.abs(self._coefficients[-2:]).sum(axis=0).reshape(self._shape)

    def at(self, times: list[float]) -> tuple[np.ndarray, np.ndarray]:
        """Values and defects at some times of the segment, shapes (k, ...)."""
        x = np.clip((np.array(times) - self._middle) / self._half, -1.0, 1.0)
        waves = np.cos(np.arccos(x)[:, None] * np.arange(len(self._coefficients)))
        shape = (len(times), *self._shape)
        defect = waves[:, -2:] @ self._coefficients[-2:]
        return (waves @ self._coefficients).reshape(shape), defect.reshape(shape)


def _range(begin: float, end: float) -> tuple[float, float]:
    """Middle, and half of the length between the outer nodes."""
    return 0.5 * (begin + end), 0.5 * (end - begin) * (1.0 - 2.0 * INSIDE)


@cache
def _transform(degree: int) -> np.ndarray:
    """From values at the nodes to coefficients, shape (m + 1, m + 1)."""
    k = np.arange(degree + 1)
    waves = (-1.0) ** k[:, None] * np.cos(np.pi * np.outer(k, k) / degree)
    waves[:, [0, -1]] *= 0.5
    waves[[0, -1]] *= 0.5
    return 2.0 / degree * waves
