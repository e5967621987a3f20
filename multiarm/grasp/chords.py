r"""Affine upper bounds over cells, from sums of positive parts of affine functions.

Over cells (a product of polygons) an affine :math:`z(y)` ranges over an interval [l, h]. Its
positive part is convex, so the chord from l to h is above it,

.. math:: [z]_+ \le \frac{h}{h - l} (z - l) \quad (l < 0 < h),

and it is z itself, or 0, when the interval lies on one side of 0. A sum of chords is affine in y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Cuts:
    """Affine upper bounds ``constant + sum_i slope_i . y_i`` on the score, one for each twist.

    Attributes
    ----------
    twists : ndarray, shape (C, 6)
        Those that say something.
    slopes : ndarray, shape (C, 7, 2)
    constants : ndarray, shape (C,)
    term_slopes, term_values : ndarray, shape (C, T, 7, 2) and (C, T)
        The cut is a sum over terms z, affine in y; each stands as [z]_+ in the true bound.
    rises, bends : ndarray, shape (C, T)
        The chord of each term is ``rise * z + bend``.
    """

    twists: np.ndarray
    slopes: np.ndarray
    constants: np.ndarray
    term_slopes: np.ndarray
    term_values: np.ndarray
    rises: np.ndarray
    bends: np.ndarray


def with_chords(
    twists: np.ndarray,
    value: np.ndarray,
    slope: np.ndarray,
    cells: list[np.ndarray],
    level: np.ndarray,
) -> Cuts:
    """``level + sum_t [z_t]_+`` with z = value + slope . y over cells, each [.]_+ by its chord."""
    low, high = ranges(value, slope, cells)
    bent = (low < 0.0) & (high > 0.0)
    rise = np.where(bent, high / np.where(bent, high - low, 1.0), (low >= 0.0).astype(float))
    bend = np.where(bent, -rise * low, 0.0)
    return Cuts(
        twists=twists,
        slopes=np.einsum("ct,ctia->cia", rise, slope),
        constants=level + np.sum(rise * value + bend, axis=1),
        term_slopes=slope,
        term_values=value,
        rises=rise,
        bends=bend,
    )


def ranges(
    value: np.ndarray, slope: np.ndarray, cells: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest ``value + slope . y`` over cells."""
    spans = [slope[:, :, i] @ cell.T for i, cell in enumerate(cells)]
    low = value + np.sum([span.min(axis=2) for span in spans], axis=0)
    return low, value + np.sum([span.max(axis=2) for span in spans], axis=0)
