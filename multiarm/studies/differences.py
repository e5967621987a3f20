"""How far two runs of a scene are apart, by quantity: the largest differences at output times.

Forces that dependent constraints leave open depend on roundings, and are not compared.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.system import System
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import Difference, compare, undetermined_forces


class Quantity(NamedTuple):
    """What runs are compared by."""

    what: str  # in a sentence
    unit: str
    nouns: tuple[str, ...] = ()  # of the compared outputs (multiarm.simulation.comparison)


def largest_differences(
    run: Trajectory,
    other: Trajectory,
    undetermined: Mapping[str, np.ndarray],
    quantities: Mapping[str, Quantity],
) -> dict[str, Difference]:
    """Of each quantity the output that differs most, at the output times that both runs have.

    Quantities are left out where there is nothing to compare, such as forces of which the equations
    determine none.
    """
    compared = [d for d in compare(run, other, undetermined).outputs.values() if d.compared]
    differences = {}
    for name, quantity in quantities.items():
        outputs = [difference for difference in compared if difference.noun in quantity.nouns]
        if outputs:
            differences[name] = max(outputs, key=lambda difference: difference.worst)
    return differences


def open_forces(system: System, run: Trajectory) -> dict[str, np.ndarray]:
    """By arm: contact forces that the equations of a system leave open in a run."""
    with system.borrow() as data:
        return undetermined_forces(data, run)
