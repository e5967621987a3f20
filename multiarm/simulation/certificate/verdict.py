"""From a comparison to a verdict: estimated errors, checks, and the words for them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.model import Data
from multiarm.results.trajectory import Trajectory
from multiarm.scene import AccuracySpec
from multiarm.simulation.certificate.checks import Check, check_run
from multiarm.simulation.certificate.comparison import (
    FORCE,
    KINDS,
    POSITION,
    ROTATION,
    UNITS,
    Comparison,
    compare,
    undetermined_forces,
)
from multiarm.simulation.certificate.growth import growth_rate

SAFETY = 2.0
"""Of an estimate: covers reruns whose error is up to half of the run's."""
ROUNDING = 1e-14
"""What a difference of two runs cannot tell, relative to the values (at least 1 m, 1 rad, 1 N)."""


@dataclass(frozen=True)
class Finding:
    """What a comparison of a run with its tightened rerun says.

    Attributes
    ----------
    asked : dict of str to float or None
        By kind (``KINDS``).
    estimated : dict of str to float or None
        By kind: difference times ``SAFETY``, plus rounding. None where there is nothing of a kind.
    comparison : Comparison
    checks : dict of str to Check
    growth : float or None
        Exponential growth rate of the difference [1/s].
    complete : bool
        Whether the rerun came to the end too.
    """

    asked: dict[str, float | None]
    estimated: dict[str, float | None]
    comparison: Comparison
    checks: dict[str, Check]
    growth: float | None
    complete: bool = True

    @property
    def excess(self) -> float:
        """Largest ratio of an estimated error to what was asked."""
        ratios = []
        for kind, asked in self.asked.items():
            estimated = self.estimated[kind]
            if asked is not None and estimated is not None:
                ratios.append(estimated / asked)
        return max(ratios, default=0.0)

    @property
    def judged(self) -> bool:
        """Whether anything that was asked for could be compared."""
        return any(
            asked is not None and self.estimated[kind] is not None
            for kind, asked in self.asked.items()
        )

    @property
    def accurate(self) -> bool:
        """Whether the estimated errors are as small as was asked."""
        return self.complete and self.judged and bool(self.excess <= 1.0)

    @property
    def faults(self) -> list[str]:
        """What the run itself fails to satisfy, a clause each."""
        return [check.fault for check in self.checks.values() if not check.passed]

    @property
    def met(self) -> bool:
        """Whether the accuracy was reached, as far as can be told."""
        return self.accurate and not self.faults

    @property
    def undetermined(self) -> list[str]:
        """Outputs some forces of which the equations leave open."""
        return [name for name, d in self.comparison.outputs.items() if d.left_out]

    def numbers(self) -> str:
        """``estimated error 2e-09 m, 4e-09 rad, 3e-06 N (asked 1e-06 m, 1e-06 rad)``."""
        known = {kind: value for kind, value in self.estimated.items() if value is not None}
        wanted = {kind: value for kind, value in self.asked.items() if value is not None}
        return f"estimated error {_listed(known)} (asked {_listed(wanted)})"

    def as_dict(self) -> dict[str, Any]:
        """All of it but the words and the attempts, in what JSON knows."""
        comparison = self.comparison
        return {
            "met": self.met,
            "asked": dict(self.asked),
            "estimated_error": dict(self.estimated),
            "by_output": {
                name: {
                    "error": _estimate(d.worst, d.size) if d.compared else None,
                    "unit": UNITS[d.kind],
                    "time": d.time,
                    "samples_left_out": d.left_out,
                }
                for name, d in comparison.outputs.items()
            },
            "over_time": {
                "time": comparison.time.tolist(),
                **{
                    kind: (SAFETY * values + ROUNDING).tolist()
                    for kind, values in comparison.course.items()
                },
            },
            "checks": {name: check.as_dict() for name, check in self.checks.items()},
            "growth_rate_per_s": self.growth,
        }


def unchecked(accuracy: AccuracySpec) -> dict[str, Any]:
    """What is known of a run that could not be compared with another one."""
    return {
        "met": False,
        "asked": _asked(accuracy),
        "estimated_error": dict.fromkeys(KINDS),
        "by_output": {},
        "over_time": {"time": [], **{kind: [] for kind in KINDS}},
        "checks": {},
        "growth_rate_per_s": None,
    }


def judge(data: Data, run: Trajectory, finer: Trajectory, accuracy: AccuracySpec) -> Finding:
    """Estimate the errors of a run from a tightened rerun, and check the run itself.

    Parameters
    ----------
    data : Data
    run : Trajectory
        Complete, with at least one sample.
    finer : Trajectory
        The rerun; where it ended early, the common part is compared.
    accuracy : AccuracySpec
        What was asked.
    """
    comparison = compare(run, finer, undetermined_forces(data, run))
    asked = _asked(accuracy)
    estimated: dict[str, float | None] = {}
    for kind in KINDS:
        worst = comparison.worst(kind)
        estimated[kind] = None if worst is None else _estimate(worst, comparison.size(kind))
    lengths = {k: asked[k] or estimated[k] or 0.0 for k in (POSITION, ROTATION)}
    apart = np.maximum(comparison.course[POSITION], comparison.course[ROTATION])
    return Finding(
        asked,
        estimated,
        comparison,
        check_run(data, run, comparison, lengths),
        growth_rate(comparison.time, apart),
        complete=finer.status == "completed" and len(finer) == len(run),
    )


def _asked(accuracy: AccuracySpec) -> dict[str, float | None]:
    return {POSITION: accuracy.position, ROTATION: accuracy.rotation, FORCE: accuracy.force}


def _estimate(difference: float, size: float) -> float:
    """Estimated error from a difference of two runs, for values of this size."""
    return SAFETY * difference + ROUNDING * max(1.0, size)


def _listed(values: dict[str, float]) -> str:
    return ", ".join(f"{value:.2g} {UNITS[kind]}" for kind, value in values.items())
