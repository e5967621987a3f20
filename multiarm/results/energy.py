"""The energy balance of a run, which is 0 when it is exact.

    E(t) - E(0) - W(t),   E = kinetic + potential energy, W = work done since the start

Functions read a run in blocks, so that memory does not grow with its length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.results.recorded_run import RecordedRun

ENERGIES = ("energy/kinetic", "energy/potential", "energy/work")
"""Channels of which the energy balance is made."""


class Imbalance(NamedTuple):
    """The largest magnitude of the energy balance.

    Attributes
    ----------
    value : float
        [J]
    sample : int
        The first at which it is so large.
    exchanged : float
        The largest energy or work in the run [J].
    """

    value: float
    sample: int
    exchanged: float


def energy_balance(
    kinetic: np.ndarray, potential: np.ndarray, work: np.ndarray, at_start: float
) -> np.ndarray:
    """Energy gained since the start less the work done, shape (K,) [J].

    ``at_start`` is what :func:`energy_at_start` returns.
    """
    return kinetic + potential - at_start - work


def energy_at_start(run: RecordedRun) -> float:
    """Energy less work done at the first sample [J]: the energy at the start, if exact."""
    kinetic, potential, work = (run.read(name, 0, 1).sum() for name in ENERGIES)
    return float(kinetic + potential - work)


def largest_imbalance(run: RecordedRun) -> Imbalance:
    """The largest magnitude of the energy balance of a run with samples."""
    at_start = energy_at_start(run)
    worst, sample, exchanged, first = -1.0, 0, abs(at_start), 0
    for energies in run.blocks(*ENERGIES):
        kinetic, potential, work = energies
        balance = np.abs(energy_balance(kinetic, potential, work, at_start))
        k = int(np.argmax(balance))
        if balance[k] > worst:
            worst, sample = float(balance[k]), first + k
        exchanged = max(exchanged, *(float(np.abs(values).max()) for values in energies))
        first += len(balance)
    return Imbalance(worst, sample, exchanged)
