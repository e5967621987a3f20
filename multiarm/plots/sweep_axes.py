"""What figures of a sweep are drawn over: a varied value, its levels, and the runs at each of them.

A value has levels when it takes few different ones, as on a grid.  One that is different in every
run is cut into parts with equally many runs, so that quantiles can be told of each.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np

__all__ = ["BAND", "Variable", "bands", "cells", "is_wide", "variable"]

LEVELS = 24
"""Different values that are told apart, at most; of more, parts are made."""
PARTS = 12
"""Parts of a value without levels, at most, and the runs in each, at least."""
PART_RUNS = 8
BAND = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles that are drawn."""
DECADES = 30.0
"""Ratio of largest and smallest from which an axis is logarithmic."""


@dataclass(frozen=True)
class Variable:
    """A varied value, as an axis of a figure.

    Attributes
    ----------
    name : str
    at : ndarray, shape (K,)
        Where each run lies on the axis.
    levels : ndarray or None
        Places of the levels, ascending; None where there are too many.
    labels : tuple of str
        Of the levels, where they are no numbers.
    log : bool
    """

    name: str
    at: np.ndarray
    levels: np.ndarray | None
    labels: tuple[str, ...]
    log: bool

    def groups(self) -> list[tuple[float, np.ndarray]]:
        """Place on the axis, and runs there: of each level, or of each part."""
        if self.levels is not None:
            return [(float(level), np.flatnonzero(self.at == level)) for level in self.levels]
        order = np.argsort(self.at, kind="stable")
        count = max(1, min(PARTS, len(order) // PART_RUNS))
        return [(float(np.median(self.at[own])), own) for own in np.array_split(order, count)]


def variable(name: str, values: np.ndarray) -> Variable | None:
    """A column of values as an axis; None of texts and lists that nearly all differ."""
    if values.dtype.kind in "if":
        at = values.astype(float)
        levels = np.unique(at)
        few = len(levels) <= LEVELS
        return Variable(name, at, levels if few else None, (), is_wide(at))
    texts = [_text(value) for value in values.tolist()]
    labels = tuple(dict.fromkeys(texts))
    if len(labels) > LEVELS:
        return None
    place = {label: float(k) for k, label in enumerate(labels)}
    at = np.array([place[text] for text in texts])
    return Variable(name, at, np.arange(len(labels), dtype=float), labels, False)


def bands(axis: Variable, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places on the axis, shape (L,), and the quantiles ``BAND`` of the values there, (L, 5)."""
    places, found = [], []
    for place, runs in axis.groups():
        own = values[runs]
        own = own[np.isfinite(own)]
        if len(own):
            places.append(place)
            found.append(np.quantile(own, BAND))
    return np.array(places), np.array(found).reshape(-1, len(BAND))


def cells(x: Variable, y: Variable, values: np.ndarray) -> np.ndarray | None:
    """Median of the values at every pair of levels, NaN where there is none, (levels of y, of x).

    None where one of the two has no levels.
    """
    if x.levels is None or y.levels is None:
        return None
    table = np.full((len(y.levels), len(x.levels)), np.nan)
    finite = np.isfinite(values)
    for i, row in enumerate(y.levels):
        for k, column in enumerate(x.levels):
            own = values[finite & (x.at == column) & (y.at == row)]
            if len(own):
                table[i, k] = np.median(own)
    return table


def is_wide(values: np.ndarray) -> bool:
    """Whether positive values spread over so much that an axis must be logarithmic."""
    finite = values[np.isfinite(values)]
    return bool(len(finite) and finite.min() > 0.0 and finite.max() > DECADES * finite.min())


def _text(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 28 else f"{text[:27]}…"
