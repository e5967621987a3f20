r"""The certificate of a run: estimated errors, checks, and the verdict on the accuracy.

**Estimated errors.**  A run is compared with a *tightened rerun*, of the same scene by the same
method with smaller tolerances.  With errors e of the run and e' of the rerun, their difference d
bounds the error of the run,

.. math:: d \ge |e| - |e'| \quad\text{so that}\quad |e| \le d / (1 - r), \quad r = |e'| / |e| ,

if the rerun is better: r < 1.  Were errors proportional to tolerances, r would be the ratio of the
tolerances, some hundredths; ``SAFETY`` covers r up to 1 - 1 / SAFETY.  A difference does not show
errors that both runs share.  Roundings always are: they are added as a floor.  For other shared
errors, the checks look at the run alone.

**Energy.** Along the exact motion the balance

.. math:: B(t) = E(q, v) - E(q_0, v_0) - W(t), \qquad E = T(q, v) + V(q)

is zero. A run with errors :math:`\delta q, \delta v` and an error :math:`\delta W` of its work has,
to first order,

.. math:: |B| \le \sum_i \Big|\frac{\partial E}{\partial q_i}\Big| |\delta q_i|
          + \sum_i |p_i| |\delta v_i| + |\delta W|, \qquad p = \frac{\partial T}{\partial v} = M v .

The generalised forces :math:`\partial E / \partial q` (weight and the change of the inertia with
the posture) are differences of the energy at the sample where the balance is worst, the momenta
:math:`p` those of that sample. For :math:`|\delta q_i|` stands the required accuracy (or else the
estimated error), for :math:`|\delta v_i|` and :math:`|\delta W|` the largest differences that the
two runs show. Gaps that are not closed add the work of the contact forces on them,
:math:`\sum_k |\lambda_k| |\varphi|` and :math:`\sum_k |\lambda_k| \int |\dot\varphi| dt`. The sum,
times 3 for terms of higher order, plus the rounding of the energies, is the bound.

**Residual.** A relative error :math:`\rho` of the accelerations moves things by about :math:`\rho`
times what they move anyway, metres and radians: it must stay below the accuracy. Double precision
leaves about 1e-8 near a loss of rank, which is always allowed.

**Drift.** A gap of a contact is an error of position.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.dynamics.contact_geometry import place_state
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import potential_energy, update_kinematics
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.momenta import write_momenta
from multiarm.dynamics.state import State
from multiarm.errors import MultiarmError
from multiarm.notation import Word, number
from multiarm.results.channels import arm_channel, channels_of, is_floor, object_paths
from multiarm.results.energy import largest_imbalance
from multiarm.results.outcome import RunStatus
from multiarm.results.trajectory import Trajectory
from multiarm.scene import AccuracySpec
from multiarm.simulation.comparison import (
    FORCE,
    OUTPUT_KINDS,
    POSITION,
    ROTATION,
    UNITS,
    Comparison,
    compare,
    growth_rate,
    sample_state,
    undetermined_forces,
)

SAFETY = 2.0
"""Of an estimate: covers reruns whose error is up to half of the run's."""
ROUNDED_ESTIMATE = 1e-14
"""Floor of an estimate, relative to the values (at least 1 m, 1 rad, 1 N)."""


class Reason(Word):
    """Why no more runs were made: the accuracy is met, or a certificate has to do without."""

    MET = "met"
    GROWTH = "growth"  # errors grow with the time, whatever the tolerance
    ROUNDING = "rounding"  # smaller tolerances do not help
    ATTEMPTS = "attempts"  # as many runs as are allowed
    CHECK = "check"  # energy, residual or drift of an accurate run
    FAILED_RERUN = "failed rerun"
    INTERRUPTED = "interrupted"
    MEMORY = "memory"  # a function of the user's answers otherwise when it is called again


@dataclass(frozen=True)
class Check:
    """A number of a run and its bound."""

    value: float
    bound: float
    unit: str
    fault: str  # message for a value above the bound, a clause

    @property
    def passed(self) -> bool:
        """Whether the value is within its bound; a value that is not a number is not."""
        return bool(self.value <= self.bound)

    def as_dict(self) -> dict[str, Any]:
        """Value, bound, unit, passed."""
        return {
            "value": self.value, "bound": self.bound, "unit": self.unit, "passed": self.passed,
        }  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """Result of comparing a run with its tightened rerun."""

    required: dict[str, float | None]  # by kind
    estimated: dict[str, float | None]  # by kind: difference times ``SAFETY``, plus rounding
    comparison: Comparison
    checks: dict[str, Check]
    growth: float | None  # [1/s], exponential growth rate of the difference
    complete: bool = True  # the rerun reached the end too

    @property
    def excess(self) -> float:
        """Largest ratio of an estimated error to the required accuracy."""
        ratios = []
        for kind, required in self.required.items():
            estimated = self.estimated[kind]
            if required is not None and estimated is not None:
                ratios.append(estimated / required)
        return max(ratios, default=0.0)

    @property
    def judged(self) -> bool:
        """Whether an output with a required accuracy could be compared."""
        return any(
            required is not None and self.estimated[kind] is not None
            for kind, required in self.required.items()
        )

    @property
    def accurate(self) -> bool:
        """Whether the estimated errors are within the required accuracy."""
        return self.complete and self.judged and bool(self.excess <= 1.0)

    @property
    def faults(self) -> list[str]:
        """Messages of the failed checks, a clause each."""
        return [check.fault for check in self.checks.values() if not check.passed]

    @property
    def met(self) -> bool:
        """Whether the accuracy was reached, by the estimates and the checks."""
        return self.accurate and not self.faults

    @property
    def undetermined(self) -> list[str]:
        """Outputs with forces that the equations leave open."""
        return [name for name, d in self.comparison.outputs.items() if d.left_out]

    def numbers(self) -> str:
        """``estimated error 2e-09 m, 4e-09 rad, 3e-06 N (asked 1e-06 m, 1e-06 rad)``."""
        known = {kind: value for kind, value in self.estimated.items() if value is not None}
        wanted = {kind: value for kind, value in self.required.items() if value is not None}
        return f"estimated error {_listed(known)} (asked {_listed(wanted)})"

    def as_dict(self) -> dict[str, Any]:
        """In types of JSON, without text and attempts."""
        comparison = self.comparison
        return {
            "met": self.met,
            "asked": dict(self.required),
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
                    kind: (SAFETY * values + ROUNDED_ESTIMATE).tolist()
                    for kind, values in comparison.course.items()
                },
            },
            "checks": {name: check.as_dict() for name, check in self.checks.items()},
            "growth_rate_per_s": self.growth,
        }


def assess(
    data: Data, run: Trajectory, finer: Trajectory, accuracy: AccuracySpec, begin: float = 0.0
) -> Finding:
    """Estimate the errors of a run from a tightened rerun, and check the run itself.

    Parameters
    ----------
    data : Data
    run : Trajectory
        Complete, with at least one sample.
    finer : Trajectory
        The rerun; where it ended early, the common part is compared.
    accuracy : AccuracySpec
    begin : float
        Time at which both begin [s].
    """
    comparison = compare(run, finer, undetermined_forces(data, run))
    required = _required(accuracy)
    estimated: dict[str, float | None] = {}
    for kind in OUTPUT_KINDS:
        worst = comparison.worst(kind)
        estimated[kind] = None if worst is None else _estimate(worst, comparison.size(kind))
    lengths = {k: required[k] or estimated[k] or 0.0 for k in (POSITION, ROTATION)}
    apart = np.maximum(comparison.course[POSITION], comparison.course[ROTATION])
    return Finding(
        required,
        estimated,
        comparison,
        check_run(data, run, comparison, lengths),
        growth_rate(comparison.time - begin, apart),
        complete=finer.status == RunStatus.COMPLETED and len(finer) == len(run),
    )


def certificate(
    finding: Finding | None,
    accuracy: AccuracySpec,
    reason: Reason,
    words: str,
    rows: list[dict[str, Any]],
) -> dict[str, Any]:
    """The certificate as it is stored."""
    if finding is None:
        comparison, verdict, details = unchecked(accuracy), "not met, as far as is known", words
    else:
        comparison, verdict = finding.as_dict(), "met" if finding.met else "not met"
        parts = [finding.numbers(), *finding.faults, words]
        if finding.undetermined:
            names = ", ".join(finding.undetermined)
            parts.append(f"forces that the equations leave open were not judged ({names})")
        details = "; ".join(part for part in parts if part)
    return {
        **comparison,
        "text": f"{verdict}: {details}",
        "verdict": verdict,
        "details": details,
        "reason": reason,
        "safety": SAFETY,
        "attempts": rows,
    }


def unchecked(accuracy: AccuracySpec) -> dict[str, Any]:
    """Of a run that could not be compared with another one."""
    return {
        "met": False,
        "asked": _required(accuracy),
        "estimated_error": dict.fromkeys(OUTPUT_KINDS),
        "by_output": {},
        "over_time": {"time": [], **{kind: [] for kind in OUTPUT_KINDS}},
        "checks": {},
        "growth_rate_per_s": None,
    }


def check_run(
    data: Data, run: Trajectory, comparison: Comparison, accuracy: dict[str, float]
) -> dict[str, Check]:
    """Energy, residual and drift of a run.

    Parameters
    ----------
    data : Data
    run : Trajectory
    comparison : Comparison
        With its tightened rerun.
    accuracy : dict
        [m] under ``position_m`` and [rad] under ``rotation_rad``: required, or else estimated.
    """
    gap = _largest(run, "drift/position")
    residual = _largest(run, "solver/residual")
    smallest = min(accuracy[POSITION], accuracy[ROTATION])
    energy = _energy_check(data, run, comparison, accuracy)
    return {
        **({} if energy is None else {"energy": energy}),
        "residual": Check(
            residual, max(smallest, 1e-8), "1",
            f"the equations were solved to {residual:.2g} only, relative to their largest term",
        ),
        "drift": Check(
            gap, accuracy[POSITION], "m", f"the contacts are open by up to {gap:.2g} m"
        ),
    }  # fmt: skip


def _energy_check(
    data: Data, run: Trajectory, comparison: Comparison, accuracy: dict[str, float]
) -> Check | None:
    """The energy check; None next to a posture where the energy cannot be evaluated."""
    imbalance, k, exchanged = largest_imbalance(run)
    slack = 1e-13 * exchanged + _work_on_gaps(run)  # roundings of many steps
    try:
        state = sample_state(data.model.layout, run, k)
        units = data.model.coordinate_units
        off = np.array([accuracy[POSITION if unit == "m" else ROTATION] for unit in units])
        names = [f"{path}/twist" for path in object_paths(run.channels).values()]
        for name, arm in data.model.robots.items():
            names += [arm_channel(name, "base_twist")] if arm.floats else []
            names.append(arm_channel(name, "joint_velocity"))
        slow = np.concatenate([comparison.velocity[name] for name in names])
        explained = float(
            np.abs(_energy_gradient(data, state)) @ off + np.abs(_momenta(data, state)) @ slow
        )
    except MultiarmError:
        return None
    bound = 3.0 * (explained + comparison.work) + slack
    return Check(
        imbalance, bound, "J",
        f"energy and work are out of balance by {imbalance:.2g} J where errors of the accuracy "
        f"required explain {bound:.2g} J",
    )  # fmt: skip


def _work_on_gaps(run: Trajectory) -> float:
    """Bound of the work of contact forces on gaps that are not closed [J]."""
    owners = channels_of(run.channels, "contact_force")
    forces = [name for owner, name in owners.items() if not is_floor(owner)]
    largest, gap, opened, before = 0.0, 0.0, 0.0, None
    for time, gaps, rates, *blocks in run.blocks(
        "time", "drift/position", "drift/velocity", *forces
    ):
        total = sum((np.abs(values).sum(axis=1) for values in blocks), np.zeros(len(time)))
        largest, gap = np.maximum(largest, total.max()), np.maximum(gap, gaps.max())
        steps = np.diff(time, prepend=time[0] if before is None else before)
        opened += float(rates @ steps)
        before = time[-1]
    return float(largest * (gap + opened))


def _momenta(data: Data, state: State) -> np.ndarray:
    """Generalised momenta M v, shape (6 F + n,)."""
    place_state(data, 0.0, state)
    require_ok(data, update_kinematics(data.struct))
    momenta = np.empty_like(state.velocity)
    write_momenta(data.struct, momenta)
    return momenta


def _energy_gradient(data: Data, state: State) -> np.ndarray:
    """Derivative of the energy with respect to positions, shape (6 F + n,) [N, N m]."""
    change = 1e-5  # [m, rad]

    def energy(displacement: np.ndarray) -> float:
        momenta = _momenta(data, state.displaced(displacement))
        return 0.5 * float(momenta @ state.velocity) + potential_energy(data.struct)

    steps = change * np.eye(state.velocity.size)
    differences = [energy(step) - energy(-step) for step in steps]
    return np.array(differences) / (2.0 * change)


def _largest(run: Trajectory, name: str) -> float:
    return float(np.max([np.abs(values).max() for (values,) in run.blocks(name)]))


def _required(accuracy: AccuracySpec) -> dict[str, float | None]:
    return {POSITION: accuracy.position, ROTATION: accuracy.rotation, FORCE: accuracy.force}


def _estimate(difference: float, size: float) -> float:
    """Estimated error from a difference of two runs, for values of this size."""
    return SAFETY * difference + ROUNDED_ESTIMATE * max(1.0, size)


def _listed(values: dict[str, float]) -> str:
    return ", ".join(number(value, UNITS[kind], digits=2) for kind, value in values.items())
