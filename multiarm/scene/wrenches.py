"""Which of the wrenches that a user lists add nothing to those before them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

__all__ = ["dependent_rows"]

# A row that stands out of the span of those before it by less than this fraction of itself is
# taken for a combination of them: as many digits as a person may write.
SPAN_TOLERANCE = 1e-9
# Rows that take part in a combination with less than this weight are not named.
NAMED_WEIGHT = 1e-6


def dependent_rows(
    wrenches: Sequence[Sequence[float]], length: float
) -> dict[int, tuple[int, ...]]:
    """Return the rows that are combinations of earlier ones.

    Parameters
    ----------
    wrenches : sequence of 6 numbers each
        Forces [N] and moments [N m].
    length : float
        Moments count as forces at this lever arm [m].

    Returns
    -------
    dict
        Number of the row, from 1, to the numbers of the earlier rows that make it up; none of them
        when the row is zero.
    """
    scaled = np.array(wrenches, dtype=float) / ([1.0] * 3 + [length] * 3)
    sizes = np.max(np.abs(scaled), axis=1)
    found: dict[int, tuple[int, ...]] = {}
    kept: list[int] = []
    for row, size in enumerate(sizes):
        if size == 0.0:
            found[row + 1] = ()
            continue
        own = scaled[row] / size
        basis = (scaled[kept] / sizes[kept, None]).T  # (6, K)
        weights = np.linalg.lstsq(basis, own, rcond=None)[0] if kept else np.zeros(0)
        if np.linalg.norm(own - basis @ weights) > SPAN_TOLERANCE * np.linalg.norm(own):
            kept.append(row)
            continue
        parts = [k + 1 for k, w in zip(kept, weights, strict=True) if abs(w) > NAMED_WEIGHT]
        found[row + 1] = tuple(parts)
    return found
