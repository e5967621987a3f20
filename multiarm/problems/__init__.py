"""Named systems with known properties, shared by tests, examples and benchmarks.

:data:`HARD_CASES` are the systems on which solvers break, each with the criteria of a good run;
:func:`ring_of_arms` is the family of the benchmarks.
"""

from __future__ import annotations

from multiarm.problems import closure, contacts, extremes, loops, postures, ring, spinning
from multiarm.problems.case import Criterion, HardCase
from multiarm.problems.ring import ring_of_arms

__all__ = ["HARD_CASES", "Criterion", "HardCase", "ring_of_arms"]

HARD_CASES: dict[str, HardCase] = {
    case.name: case
    for family in (postures, loops, contacts, closure, ring, spinning, extremes)
    for case in family.CASES
}
