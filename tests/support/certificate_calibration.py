"""Calibration of certificates: estimated errors of random scenes against independent references.

``python tests/support/certificate_calibration.py [COUNT] [FIRST]`` simulates random scenes with
default settings and compares every result with a reference: another method at the tightest
tolerance, for some scenes evaluated by the dense solver. A second reference, by the run's own
method at its tightest, gives the digits of the first one. A certificate is a false positive when it
says *met* and the true error exceeds the requested accuracy. Where the two references differ by
more than a tenth of it, they decide nothing: such scenes are marked with a question mark and
counted separately.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np
from random_scenes import random_scene

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError
from multiarm.results.sinks import MemorySink
from multiarm.results.trajectory import Trajectory
from multiarm.simulation.comparison import LENGTHS, OUTPUT_KINDS, compare, undetermined_forces
from multiarm.simulation.run import Task, carry_out
from multiarm.simulation.setup import run_spec
from multiarm.simulation.simulate import simulate

SCENES = 50
TOLERANCES = (1e-13, 1e-12, 1e-11, 1e-10, 1e-9)
"""Of a step of the references: the first one with which the run gets on."""
MOST_EVALUATIONS = 1_500_000
ORDERS = {"dopri5": 5, "dop853": 8}
UNSURE = 0.1
"""A certificate is judged if the references differ by at most this part of the tolerance."""
DENSE_TOLERANCE = 1e-10
DENSE_EVERY, DENSE_LONGEST = 5, 0.6
"""Every so many-th scene is also run by the dense solver, for at most so long [s]."""
KNOWN = 10.0
"""An error is known if it exceeds the difference of the references by so much."""


@dataclass(frozen=True)
class Trial:
    """One scene.

    Attributes
    ----------
    seed : int
        Of the random numbers that made the scene.
    status : str
        Of the run; "refused" where it could not begin.
    met : bool or None
        What the certificate says; None: there is none.
    text : str
        The certificate, or why there is none.
    requested, estimated, true, unsure : dict of str to float or None
        By kind (position_m, ...): requested accuracy, estimated error, error against the reference,
        difference of the two references.
    first_share : float or None
        Largest ratio of the error estimated of the first run to the requested one.
    runs : int
        Made until the verdict.
    run_s, all_s : float
        Wall time of the first run, and of everything that ``simulate`` did.
    dense : bool
        The reference was evaluated by the dense solver too, and agreed within the tolerance.
    """

    seed: int
    status: str
    met: bool | None = None
    text: str = ""
    requested: dict[str, float | None] = field(default_factory=dict)
    estimated: dict[str, float | None] = field(default_factory=dict)
    true: dict[str, float | None] = field(default_factory=dict)
    unsure: dict[str, float | None] = field(default_factory=dict)
    first_share: float | None = None
    runs: int = 0
    run_s: float = 0.0
    all_s: float = 0.0
    dense: bool = False

    @property
    def decided(self) -> bool:
        """Whether the references are good enough to hold the certificate against them."""
        pairs = [(self.unsure.get(kind), requested) for kind, requested in self.requested.items()]
        return all(
            unsure is not None and unsure <= UNSURE * requested
            for unsure, requested in pairs
            if requested is not None
        )

    @property
    def false_positive(self) -> bool:
        """Says *met*, and the true error exceeds the requested accuracy."""
        share = self.share()
        return bool(self.met) and self.decided and share is not None and share > 1.0

    def ratios(self) -> list[float]:
        """True over estimated errors of positions and rotations, where the true ones are known."""
        found = []
        for kind in LENGTHS:
            true, estimated, unsure = (
                d.get(kind) for d in (self.true, self.estimated, self.unsure)
            )
            if true and estimated and unsure is not None and true > KNOWN * unsure:
                found.append(true / estimated)
        return found

    def share(self) -> float | None:
        """Largest ratio of the true error to the requested one."""
        return _share(self.requested, self.true)


def run_trial(seed: int) -> Trial:
    """Simulate the random scene of a seed and compare it with references."""
    try:
        system = compile_system(random_scene(np.random.default_rng(seed)))
        began = time.perf_counter()
        run = simulate(system)
    except MultiarmError as error:
        return Trial(seed, "refused", text=str(error))
    spent = time.perf_counter() - began
    found = run.certificate
    if found is None:
        return Trial(seed, run.status, text=run.message)
    first = found["attempts"][0]
    own = run.statistics["integrator"]
    other = "dopri5" if own != "dopri5" else "dop853"
    reference = _reference(system, other, run)
    again = _reference(system, "dop853" if own == "dopri5" else own, run)
    usable = reference is not run and again is not run
    nothing: dict[str, float | None] = dict.fromkeys(OUTPUT_KINDS)
    return Trial(
        seed,
        run.status,
        found["met"],
        found["text"],
        found["asked"],
        found["estimated_error"],
        _apart(system, run, reference) if usable else nothing,
        _apart(system, again, reference) if usable else nothing,
        _share(found["asked"], first),
        len(found["attempts"]),
        first["wall_time_s"],
        spent,
        dense=usable
        and seed % DENSE_EVERY == 0
        and _dense_agrees(system, reference, found["asked"]),
    )


def run_trials(seeds: Iterable[int]) -> Iterator[Trial]:
    """The trials of some seeds, one after the other."""
    return map(run_trial, seeds)


def summary(trials: list[Trial]) -> str:
    """Counts, ratios and costs in some lines."""
    judged = [trial for trial in trials if trial.met is not None]
    met = [trial for trial in judged if trial.met]
    ratios = [ratio for trial in judged for ratio in trial.ratios()] or [float("nan")]
    shares = [share for trial in met if trial.decided and (share := trial.share())] or [
        float("nan")
    ]
    costs = [trial.all_s / trial.run_s for trial in judged if trial.run_s > 0] or [float("nan")]
    firsts = [share for trial in judged if (share := trial.first_share) is not None]
    open_ = [trial.seed for trial in met if not trial.decided]
    false_positive = [trial.seed for trial in trials if trial.false_positive]
    return "\n".join(
        (
            f"scenes {len(trials)}: met {len(met)}, not met {len(judged) - len(met)}, "
            f"no certificate {len(trials) - len(judged)}; references by the dense solver too: "
            f"{sum(trial.dense for trial in trials)}",
            f"false positives: {len(false_positive)} {false_positive or ''}; not decided by the "
            f"references: {len(open_)} {open_ or ''}",
            f"first run sufficed: {sum(trial.runs == 2 for trial in met)} of {len(met)}",
            f"estimated error of the first run / requested: {_quantiles(firsts)}",
            f"true / estimated error: median {median(ratios):.2g}, "
            f"{min(ratios):.2g} to {max(ratios):.2g}",
            f"true / requested error of what was met: median {median(shares):.2g}, "
            f"{min(shares):.2g} to {max(shares):.2g}",
            f"everything / first run, wall time: median {median(costs):.2g}, "
            f"{min(costs):.2g} to {max(costs):.2g}",
        )
    )


def report_line(trial: Trial) -> str:
    """One trial in a line."""
    if trial.met is None:
        return f"{trial.seed:5d}  {trial.status}: {trial.text[:90]}"
    numbers = "".join(
        f"  {_number(d.get(kind))}"
        for kind in LENGTHS
        for d in (trial.requested, trial.estimated, trial.true, trial.unsure)
    )
    verdict = "DISHONEST" if trial.false_positive else "met" if trial.met else "not met"
    verdict += "" if trial.decided else "?"
    return f"{trial.seed:5d}  {verdict:9s}{numbers}  {trial.runs} runs, {trial.all_s:.2f} s"


def main() -> None:
    """Run the benchmark and print its table."""
    given = [int(text) for text in sys.argv[1:]]
    count, first = (*given, *(SCENES, 0)[len(given) :])
    print("seed   verdict    position: requested, estimated, true, unsure;  rotation: the same")
    trials = []
    for trial in run_trials(range(first, first + count)):
        print(report_line(trial), flush=True)
        trials.append(trial)
    print(summary(trials))
    if any(trial.false_positive for trial in trials):
        raise SystemExit(1)


def _reference(system: System, method: str, run: Trajectory) -> Trajectory:
    """The tightest run of a method that can be afforded."""
    scene = system.scene.run
    for tolerance in TOLERANCES:
        if _expected(method, run, tolerance) > MOST_EVALUATIONS:
            continue
        settings = {"integrator": method, "tolerance": tolerance}
        with system.borrow() as data:
            task = Task(system, data, run_spec(scene, settings), None, np.inf)
            reference = carry_out(task, MemorySink(), most_evaluations=MOST_EVALUATIONS).trajectory
        if reference.status == "completed":
            return reference
    return run  # which decides nothing


def _expected(method: str, run: Trajectory, tolerance: float) -> float:
    """Evaluations that a method will take, from those of the run."""
    tighter = max(run.statistics["tolerance"] / tolerance, 1.0)
    return run.statistics["evaluations"] * tighter ** (1.0 / ORDERS.get(method, 5))


def _apart(system: System, run: Trajectory, other: Trajectory) -> dict[str, float | None]:
    """Worst differences of two runs, by kind."""
    with system.borrow() as data:
        comparison = compare(run, other, undetermined_forces(data, run))
    return {kind: comparison.worst(kind) for kind in OUTPUT_KINDS}


def _dense_agrees(
    system: System, reference: Trajectory, requested: dict[str, float | None]
) -> bool:
    """Whether the dense solver's run is where the reference is, within the requested accuracy."""
    duration = min(DENSE_LONGEST, system.scene.run.duration)
    dense = simulate(
        system, duration, integrator="dop853", tolerance=DENSE_TOLERANCE, solver="dense",
        certificate=False,
    )  # fmt: skip
    if dense.status != "completed":
        return False
    last = len(dense) - 2  # the last sample may lie between two of the reference
    gap = np.abs(dense.object_position[:last] - reference.object_position[:last]).max()
    return bool(gap <= max(requested["position_m"] or 0.0, 1e3 * DENSE_TOLERANCE))


def _share(requested: Mapping[str, float | None], found: Mapping[str, Any]) -> float | None:
    """Largest ratio of an error to the requested one."""
    pairs = [(found.get(kind), value) for kind, value in requested.items()]
    return max((error / value for error, value in pairs if error and value), default=None)


def _quantiles(values: list[float]) -> str:
    parts = (10, 25, 50, 75, 90, 95)
    return ", ".join(
        f"{part} % below {value:.1e}"
        for part, value in zip(parts, np.percentile(values or [np.nan], parts), strict=True)
    )


def _number(value: float | None) -> str:
    return "      -" if value is None else f"{value:7.1e}"


if __name__ == "__main__":
    main()
