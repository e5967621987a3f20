"""Certified runs: repeated until the accuracy is met, or cannot be met.

    run -> tightened rerun -> met:     the run is returned, with its certificate
                              not met: the rerun, or a run at the tolerance that the errors
                                       suggest, is the next candidate, and is checked likewise

A rerun is itself the next candidate when its predicted error suffices; the run that is returned is
always one whose error was estimated.  Errors are predicted as proportional to tolerances, with a
margin.  The repetition ends early when the difference no longer decreases, or when it would take
tolerances below rounding; runs that have separated are assumed to separate further at this rate.

Samples may go to a file.  The first run is written to its place, later ones to a temporary file in
the same folder, which is moved there when it is chosen.  Until then, and if the process is killed,
the file holds a complete run without certificate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import MultiarmError, TrajectoryError
from multiarm.results.outcome import RunStatus
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import Trajectory, amend_file, load_trajectory
from multiarm.scene import AccuracySpec
from multiarm.simulation.certificate import SAFETY, Finding, Reason, assess, certificate
from multiarm.simulation.comparison import LENGTHS, OUTPUT_KINDS
from multiarm.simulation.driver import BUDGET, TOO_MANY, End
from multiarm.simulation.record import RunStatistics
from multiarm.simulation.run import carry_out
from multiarm.simulation.setup import SMALLEST_TOLERANCE, Task
from multiarm.terminal.progress import RunWatcher

INTERRUPTED_WORDS = "the check of its accuracy was interrupted, so that there is no certificate"
REMEDY = "ask for less accuracy, or simulate a shorter time"
FAILED_WORDS = "the tightened rerun that checks it failed"
ROUNDING_WORDS = f"smaller tolerances do not help any more, what is left is rounding: {REMEDY}"

TIGHTER = 30.0
"""Ratio of the tolerances of a run and its rerun."""
SMALLEST_CHECKED = 8.0 * SMALLEST_TOLERANCE
"""Smallest tolerance of a run that can be checked: its rerun must be noticeably tighter."""
MOST_RUNS = 7
"""A candidate and its rerun are begun while there are at most so many with them."""
PARTED = 0.01
"""[m, rad] Distance from which on two runs count as separated."""


@dataclass
class Attempt:
    """One run."""

    trajectory: Trajectory  # closed once it is no longer needed
    statistics: RunStatistics
    path: Path | None
    # by kind of output; None until they are estimated
    errors: Mapping[str, float | None] = field(default_factory=lambda: dict.fromkeys(OUTPUT_KINDS))

    @property
    def tolerance(self) -> float:
        """Largest accepted error of one step: runs of some accuracy choose their steps."""
        assert self.statistics.tolerance is not None
        return self.statistics.tolerance

    def row(self, returned: bool) -> dict[str, Any]:
        """Cost and errors for the certificate, in types of JSON."""
        s = self.statistics
        return {
            "tolerance": s.tolerance,
            "integrator": s.integrator,
            "steps": s.steps,
            "evaluations": s.evaluations,
            "wall_time_s": s.wall_time_s,
            "compile_time_s": s.compile_time_s,
            **self.errors,
            "returned": returned,
        }


class _Stopped(Exception):
    """The repetition ended without a verdict."""

    def __init__(self, reason: Reason, words: str) -> None:
        super().__init__(words)
        self.reason, self.words = reason, words


@dataclass
class Attempts:
    """The runs of one task, until one of them meets the accuracy.

    Attributes
    ----------
    task : Task
    out : Path or None
        Final place of the samples.
    watcher : RunWatcher
    """

    task: Task
    out: Path | None
    watcher: RunWatcher
    _attempts: list[Attempt] = field(default_factory=list)
    _judged: list[tuple[Attempt, Finding]] = field(default_factory=list)

    def first(self) -> Trajectory:
        """Carry out the task as given."""
        sink = MemorySink() if self.out is None else Hdf5Sink(self.out)
        trajectory, _, statistics = carry_out(self.task, sink, self.watcher)
        self._attempts.append(Attempt(trajectory, statistics, self.out))
        return trajectory

    def certify(self) -> Trajectory:
        """Check the first run, repeat it if need be, and return the chosen one."""
        try:
            reason, words = self._repeat()
        except _Stopped as stop:
            reason, words = stop.reason, stop.words
        except KeyboardInterrupt:
            reason, words = Reason.INTERRUPTED, ""
        try:
            return self._finish(reason, words)
        finally:
            for attempt in self._attempts:
                if attempt.path != self.out:
                    self._remove(attempt.path)

    def _repeat(self) -> tuple[Reason, str]:
        """Run until the accuracy is met, or cannot be met: reason and words for that."""
        for function in self.task.data.user_callbacks:
            if function.remembers():
                return Reason.MEMORY, (
                    f"{function.name} answers otherwise when it is called again for the same time "
                    f"and state, so that a rerun would not be the same motion; simulate with "
                    f"`certificate=False`"
                )
        candidate, finer = self._first_pair()
        while True:
            finding = assess(
                self.task.data,
                candidate.trajectory,
                finer.trajectory,
                self._accuracy,
                self.task.begin,
            )
            candidate.errors = finding.estimated
            if self._judged:
                self._drop(self._judged[-1][0])
            self._judged.append((candidate, finding))
            if finding.met:
                return Reason.MET, ""
            stop = self._why_stop(candidate, finding)
            if stop:
                return stop
            tolerance = max(_wanted(candidate, finding), SMALLEST_CHECKED)
            if SMALLEST_CHECKED <= finer.tolerance <= tolerance:
                candidate = finer
            else:
                self._drop(finer)
                candidate = self._rerun(tolerance, candidate)
            finer = self._rerun(candidate.tolerance / TIGHTER, candidate)

    def _first_pair(self) -> tuple[Attempt, Attempt]:
        """The first run and a tighter one, or else a looser one and the first run."""
        first = self._attempts[0]
        if first.tolerance >= SMALLEST_CHECKED:
            try:
                return first, self._rerun(first.tolerance / TIGHTER, first)
            except _Stopped as stop:
                if stop.reason != Reason.ROUNDING:
                    raise
        looser = self._rerun(TIGHTER * max(first.tolerance, SMALLEST_TOLERANCE))
        if looser.statistics.steps > 0.95 * first.statistics.steps:
            # the tolerance does not limit the steps: the difference of the runs means nothing
            raise _Stopped(Reason.ROUNDING, ROUNDING_WORDS)
        return looser, first

    @property
    def _accuracy(self) -> AccuracySpec:
        assert self.task.spec.accuracy is not None, "only a run of some accuracy is certified"
        return self.task.spec.accuracy

    def _why_stop(self, candidate: Attempt, finding: Finding) -> tuple[Reason, str] | None:
        """Why a further run cannot help, as reason and words; None if it can."""
        if not finding.judged:
            return Reason.CHECK, (
                "the equations determine none of the forces asked for; ask for position or rotation"
            )
        rate = finding.growth
        exhausted = Reason.ROUNDING, ROUNDING_WORDS
        if rate is not None:
            exhausted = (
                Reason.GROWTH,
                (
                    f"errors grow about e^({rate:.2g} t) in this motion, whatever the tolerance: "
                    f"simulate a shorter time, ask for less accuracy, or add damping"
                ),
            )
        if finding.accurate and candidate.tolerance <= SMALLEST_CHECKED:
            return Reason.CHECK, ""
        hopeless = _excess(finding) * SMALLEST_CHECKED > candidate.tolerance
        if not finding.accurate and hopeless and (rate is not None or len(self._judged) > 1):
            return exhausted
        if len(self._judged) > 1:
            before, earlier = self._judged[-2]
            decreases = finding.excess <= 0.5 * earlier.excess
            if not finding.accurate and not decreases and before.tolerance > candidate.tolerance:
                return exhausted
            if finding.accurate and earlier.accurate:
                return Reason.CHECK, ""
        if len(self._attempts) + 2 > MOST_RUNS:
            return Reason.ATTEMPTS, (
                f"{len(self._attempts)} runs were made, which is the limit: ask for less, or give "
                f"a smaller `tolerance` yourself"
            )
        return None

    def _rerun(self, tolerance: float, coarser: Attempt | None = None) -> Attempt:
        """A run with the tolerances that correspond to ``tolerance``."""
        first = self._attempts[0]
        tolerance = max(tolerance, SMALLEST_TOLERANCE)
        most = math.inf if coarser is None else _most(coarser, tolerance)
        number = len(self._attempts)
        path = self._rerun_file(number)
        sink = MemorySink() if path is None else Hdf5Sink(path)
        try:
            task = self._with_shorter_steps(tolerance, coarser)
            trajectory, end, statistics = carry_out(
                task,
                sink,
                lambda t: self.watcher.checking(t, number),
                tolerance / first.tolerance,
                most,
            )
        except MultiarmError as error:
            self._remove(path)
            raise _Stopped(Reason.FAILED_RERUN, f"{FAILED_WORDS} {error}") from error
        except BaseException:
            self._remove(path)
            raise
        attempt = Attempt(trajectory, statistics, path)
        self._attempts.append(attempt)
        if end is End.INTERRUPTED:
            raise _Stopped(Reason.INTERRUPTED, "")
        if end is End.STALLED:
            raise _Stopped(
                Reason.ROUNDING, f"{TOO_MANY} at a tolerance of {tolerance:.1g}: {REMEDY}"
            )
        if trajectory.status != RunStatus.COMPLETED:
            raise _Stopped(Reason.FAILED_RERUN, f"{FAILED_WORDS} {trajectory.message}")
        return attempt

    def _with_shorter_steps(self, tolerance: float, coarser: Attempt | None) -> Task:
        """The task for a rerun, with a shorter longest step.

        Where the tolerance does not limit the steps, equal steps would make equal errors.
        """
        if coarser is None:
            return self.task
        ratio = min(1.0, tolerance / coarser.tolerance) ** (1.0 / 8.0)  # as with order 8
        before = coarser.statistics.largest_step_s or math.inf
        return replace(self.task, longest_step=ratio * min(self.task.longest_step, before))

    def _rerun_file(self, number: int) -> Path | None:
        """File for the samples of a rerun."""
        if self.out is None:
            return None
        target = self.out.expanduser().resolve()
        path = target.with_name(f".{target.name}.check{number}")
        self._remove(path)  # left by a run that was killed
        return path

    def _drop(self, attempt: Attempt) -> None:
        """Release the samples of an attempt that is no longer needed."""
        attempt.trajectory.close()
        if attempt.path != self.out:
            self._remove(attempt.path)

    def _remove(self, path: Path | None) -> None:
        if path is not None:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def _finish(self, reason: Reason, words: str) -> Trajectory:
        """The chosen run with its certificate."""
        chosen, finding = self._judged[-1] if self._judged else (self._attempts[0], None)
        changes: dict[str, Any] = {}
        if finding is None and reason == Reason.INTERRUPTED:
            changes["remarks"] = [*chosen.trajectory.remarks, INTERRUPTED_WORDS]
        else:
            if reason == Reason.INTERRUPTED:
                words = "the repetition with smaller tolerances was interrupted by the user"
            rows = [attempt.row(attempt is chosen) for attempt in self._attempts]
            changes["certificate"] = certificate(finding, self._accuracy, reason, words, rows)
        waited = sum(attempt.statistics.compile_time_s for attempt in self._attempts)
        changes["statistics"] = replace(chosen.statistics, compile_time_s=waited).as_dict()
        if chosen.path is None:
            return chosen.trajectory.with_outcome(**changes)
        return self._store(chosen, changes)

    def _store(self, chosen: Attempt, changes: dict[str, Any]) -> Trajectory:
        """Write the certificate into the chosen run's file, and move it to its place."""
        assert self.out is not None and chosen.path is not None
        for attempt in self._attempts:
            attempt.trajectory.close()
        try:
            amend_file(chosen.path, changes)
            if chosen.path != self.out:
                chosen.path.replace(self.out.expanduser().resolve())
        except (TrajectoryError, OSError) as error:
            trajectory = load_trajectory(self.out)
            fault = f"the certificate could not be stored in the file: {error}"
            return trajectory.with_outcome(remarks=[*trajectory.remarks, fault])
        return load_trajectory(self.out)


def _wanted(candidate: Attempt, finding: Finding) -> float:
    """Tolerance at which the errors are expected to be within the accuracy, by a margin."""
    if finding.accurate:  # but its checks failed
        return candidate.tolerance / TIGHTER
    return candidate.tolerance * 0.3 / _excess(finding)


def _excess(finding: Finding) -> float:
    """Largest ratio of error to accuracy, extrapolated to the end for runs that have separated."""
    comparison, excess = finding.comparison, finding.excess
    lengths = [v for k, v in finding.required.items() if v is not None and k in LENGTHS]
    apart = np.maximum(*(comparison.course[kind] for kind in LENGTHS))
    parted = np.flatnonzero(apart >= PARTED)
    if finding.growth is None or not parted.size or not lengths:
        return excess
    left = float(comparison.time[-1] - comparison.time[parted[0]])
    grown = math.exp(min(finding.growth * left, 700.0))
    return max(excess, SAFETY * PARTED * grown / min(lengths))


def _most(coarser: Attempt, tolerance: float) -> float:
    """How many evaluations a rerun may take: one that takes many more is limited by roundings."""
    tighter = max(coarser.tolerance / tolerance / TIGHTER, 1.0)
    return 12.0 * tighter**0.25 * coarser.statistics.evaluations + BUDGET
