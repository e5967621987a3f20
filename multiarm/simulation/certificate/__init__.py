"""Is a run as accurate as was asked? The evidence, and how it is told.

A run is compared with a *tightened rerun*, of the same scene by the same method with tolerances
smaller by some factor. With errors e of the run and e' of the rerun, the difference d of the two
bounds the error of the run,

    d >= |e| - |e'|    so that    |e| <= d / (1 - r),   r = |e'| / |e| ,

if the rerun is better: r < 1. Were errors proportional to tolerances, r would be the ratio of the
tolerances, some hundredths; ``SAFETY`` covers r up to 1 - 1 / SAFETY. What both runs share (and
roundings always are) is not seen by a difference: roundings are added as a floor, and the checks of
:mod:`multiarm.simulation.certificate.checks` look at the run on its own.

It is an estimate, and is called one.
"""

from multiarm.simulation.certificate.comparison import (
    FORCE,
    KINDS,
    LENGTHS,
    POSITION,
    ROTATION,
    UNITS,
    Comparison,
    Difference,
    compare,
    rotation_apart,
    undetermined_forces,
)
from multiarm.simulation.certificate.growth import growth_rate
from multiarm.simulation.certificate.verdict import SAFETY, Finding, judge, unchecked

__all__ = [
    "FORCE",
    "KINDS",
    "LENGTHS",
    "POSITION",
    "ROTATION",
    "SAFETY",
    "UNITS",
    "Comparison",
    "Difference",
    "Finding",
    "compare",
    "growth_rate",
    "judge",
    "rotation_apart",
    "unchecked",
    "undetermined_forces",
]
