"""Random samples that depend only on the seed and the number of the run.

A value is the quantile Q(u) of a number u in (0, 1), so that one sampler serves all distributions.
The numbers u of a run come from a generator that is keyed by the seed and the run:

    random            u = Philox(seed, run), independent for every run
    latin_hypercube   the runs of one grid point fill `repeat` layers of every axis once
    sobol             the runs of one grid point are a scrambled Sobol sequence

The last two are SciPy's; every grid point has its own sample, keyed by the seed and the point.
Sobol points are computed one at a time.  A Latin hypercube is made as a whole: it needs 8 bytes for
each axis and repetition, whatever the number of grid points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

SMALLEST = 2.0**-54
"""Distance of u from 0 and 1, where many quantiles are infinite."""


class Distribution(Protocol):
    """A distribution, by its quantile function: a share ``u`` of all values lies below Q(u)."""

    def quantile(self, u: float) -> Any:
        """Q(u), u in (0, 1)."""
        ...


@dataclass(frozen=True)
class Uniform:
    """All values between two bounds are equally likely."""

    low: float
    high: float

    def quantile(self, u: float) -> float:
        """Q(u), u in (0, 1)."""
        return self.low + u * (self.high - self.low)


@dataclass(frozen=True)
class LogUniform:
    """All ratios between two positive bounds are equally likely."""

    low: float
    high: float

    def quantile(self, u: float) -> float:
        """Q(u), u in (0, 1)."""
        return self.low * (self.high / self.low) ** u


@dataclass(frozen=True)
class Normal:
    """The normal distribution, by its mean and standard deviation."""

    mean: float
    deviation: float

    def quantile(self, u: float) -> float:
        """Q(u), u in (0, 1)."""
        from scipy.special import ndtri

        return self.mean + self.deviation * float(ndtri(u))


@dataclass(frozen=True)
class LogNormal:
    """A positive value whose logarithm is normal: its median, and the logarithm's deviation."""

    median: float
    deviation: float

    def quantile(self, u: float) -> float:
        """Q(u), u in (0, 1)."""
        from scipy.special import ndtri

        return self.median * math.exp(self.deviation * float(ndtri(u)))


@dataclass(frozen=True)
class OneOf:
    """One of several values, all equally likely."""

    values: Sequence[Any]

    def quantile(self, u: float) -> Any:
        """The value whose interval of (0, 1) contains u."""
        return self.values[int(u * len(self.values))]


@dataclass
class Sampler:
    """Numbers in (0, 1), one for each drawn axis, for any run.

    Parameters
    ----------
    sampling : {"random", "latin_hypercube", "sobol"}
    seed : int
    axes : int
        How many numbers a run needs.
    repeat : int
        Runs of one grid point.
    """

    sampling: str
    seed: int
    axes: int
    repeat: int
    # the sample of the last grid point: runs mostly come in order
    _point: int = field(default=-1, init=False)
    _sample: Any = field(default=None, init=False, repr=False)

    def at(self, run: int) -> np.ndarray:
        """The numbers of a run, counted from 1, shape (axes,)."""
        if self.axes == 0:
            return np.zeros(0)
        point, repetition = divmod(run - 1, self.repeat)
        if self.sampling == "random":
            u = self._generator(run).random(self.axes)
        elif self.sampling == "latin_hypercube":
            u = self._hypercube(point)[repetition]
        else:
            u = self._sobol(point, repetition)
        return np.clip(u, SMALLEST, 1.0 - 2.0 * SMALLEST)

    def _generator(self, key: int) -> np.random.Generator:
        own = np.random.SeedSequence(self.seed, spawn_key=(key,))
        return np.random.Generator(np.random.Philox(own))

    def _hypercube(self, point: int) -> np.ndarray:
        if point != self._point:
            from scipy.stats.qmc import LatinHypercube

            hypercube = LatinHypercube(self.axes, rng=self._generator(point))
            self._point, self._sample = point, hypercube.random(self.repeat)
        return self._sample

    def _sobol(self, point: int, repetition: int) -> np.ndarray:
        if point != self._point or repetition < self._sample.num_generated:
            from scipy.stats.qmc import Sobol

            self._point, self._sample = point, Sobol(self.axes, rng=self._generator(point))
        skipped = repetition - self._sample.num_generated
        if skipped:
            self._sample.fast_forward(skipped)
        return self._sample.random(1)[0]
