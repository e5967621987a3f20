"""Exact order statistics of numbers that do not fit into memory.

The bits of a float, read as a whole number, are in the order of the floats when those of negative
numbers are turned round.  Four readings of the numbers then find the k-th smallest: the first
counts how many begin with each of the 2^16 highest parts, and so says which part the k-th has; the
second counts the next 16 bits of those that begin so, and so on.  Memory is one count for each
part, however many numbers there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

__all__ = ["kth_smallest", "quantiles"]

Blocks = Callable[[], Iterable[np.ndarray]]
"""Gives the numbers anew every time it is called, in arrays."""
_BITS = 16
_TOP = np.uint64(1 << 63)


def quantiles(blocks: Blocks, count: int, levels: Sequence[float]) -> list[float]:
    """Quantiles, linear between neighbours as ``numpy.quantile`` has them.

    Parameters
    ----------
    blocks : callable
        Gives the numbers, none of them NaN.
    count : int
        How many there are, at least one.
    levels : sequence of float
        0 to 1.
    """
    places = [level * (count - 1) for level in levels]
    ranks = sorted({rank for place in places for rank in (math.floor(place), math.ceil(place))})
    found = dict(zip(ranks, kth_smallest(blocks, ranks), strict=True))
    results = []
    for place in places:
        low, high = found[math.floor(place)], found[math.ceil(place)]
        part = place - math.floor(place)
        results.append(low if low == high else low + part * (high - low))
    return results


def kth_smallest(blocks: Blocks, ranks: Sequence[int]) -> list[float]:
    """The numbers that have some places, from 0 on, when all are sorted."""
    prefixes, left = [0] * len(ranks), list(ranks)
    for shift in range(64 - _BITS, -1, -_BITS):
        counts = {prefix: np.zeros(1 << _BITS, dtype=np.int64) for prefix in prefixes}
        for block in blocks():
            keys = _keys(block) >> np.uint64(shift)
            heads, tails = keys >> np.uint64(_BITS), keys & np.uint64((1 << _BITS) - 1)
            for prefix, count in counts.items():
                own = tails[heads == np.uint64(prefix)].astype(np.int64)
                count += np.bincount(own, minlength=1 << _BITS)
        for k, prefix in enumerate(prefixes):
            ends = np.cumsum(counts[prefix])
            part = int(np.searchsorted(ends, left[k], side="right"))
            left[k] -= int(ends[part] - counts[prefix][part])
            prefixes[k] = prefix << _BITS | part
    return [_number(prefix) for prefix in prefixes]


def _keys(numbers: np.ndarray) -> np.ndarray:
    """Whole numbers in the order of the floats."""
    bits = (np.asarray(numbers, dtype=np.float64) + 0.0).view(np.uint64)  # -0.0 becomes 0.0
    return np.where(bits & _TOP, ~bits, bits | _TOP)


def _number(key: int) -> float:
    """The float of a key."""
    bits = np.array([key], dtype=np.uint64)
    bits = np.where(bits & _TOP, bits ^ _TOP, ~bits)
    return float(bits.view(np.float64)[0])
