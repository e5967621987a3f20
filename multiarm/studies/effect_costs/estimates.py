r"""Differences of times that were measured in turn, and how far they can be trusted.

Of pairs :math:`(a_k, b_k)`, one after the other, the median of :math:`a_k - b_k` is taken: what
slows the machine down hits both of a pair.  The uncertainty is twice the standard error of that
median, :math:`\sigma \sqrt{\pi / 2 n}`, with :math:`\sigma` from the quartiles of the differences,
so that single disturbed pairs do not count.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

QUARTILES = 1.349
"""Distance of the quartiles of a normal distribution, in standard deviations."""


@dataclass(frozen=True)
class Estimate:
    """A measured difference.

    Attributes
    ----------
    value : float
    uncertainty : float
        Twice its standard error.
    """

    value: float
    uncertainty: float

    @property
    def within_noise(self) -> bool:
        """Whether it may as well be zero."""
        return not abs(self.value) > self.uncertainty

    def scaled(self, factor: float) -> Estimate:
        """The estimate in another unit."""
        return Estimate(factor * self.value, abs(factor) * self.uncertainty)


def paired_difference(first: np.ndarray, second: np.ndarray) -> Estimate:
    """Estimate of ``first - second``, measured in turn, shapes (n,)."""
    assert first.shape == second.shape and first.size, "measured in turn"
    apart = first - second
    low, high = np.percentile(apart, (25.0, 75.0))
    error = (high - low) / QUARTILES * math.sqrt(math.pi / 2.0 / apart.size)
    return Estimate(float(np.median(apart)), 2.0 * float(error))
