"""Run until the accuracy is met, within a limit, or say why it cannot be met.

    run -> tightened rerun -> met? -> the run, with its certificate
                              not met -> the rerun, or a run at a tolerance that the errors suggest,
                                         takes the run's place, and is checked in the same way

A rerun is itself the next candidate when its predicted error suffices, so that nothing is wasted;
what is returned is always the run whose error was estimated. Errors are predicted as proportional
to tolerances, with a margin. The repetition ends early where it is of no use: when the difference
does not fall any more, when tolerances would have to be smaller than double precision has a use
for: runs that have parted are taken to go on parting at the rate at which they did.

Samples may go to a file. The first run goes to its place; later ones to a temporary file beside it,
which is moved there when it is chosen. Until then the file holds a complete run that has no
certificate, and so it does if the process is killed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import MultiarmError, TrajectoryError
from multiarm.results.sinks import Hdf5Sink, MemorySink
from multiarm.results.trajectory import Trajectory, amend_file, load_trajectory
from multiarm.scene import AccuracySpec
from multiarm.simulation.certificate import KINDS, LENGTHS, SAFETY, Finding, judge
from multiarm.simulation.certificate.words import (
    ATTEMPTS,
    CHECK,
    EXHAUSTED,
    FAILED_RERUN,
    GROWTH,
    INTERRUPTED,
    INTERRUPTED_WORDS,
    MEMORY,
    REMEDY,
    ROUNDING_WORDS,
    UNDETERMINED_WORDS,
    certificate,
    failed_words,
    growth_words,
    memory_words,
)
from multiarm.simulation.driver import BUDGET, TOO_MANY, Progress, Task, carry_out
from multiarm.simulation.setup import SMALLEST_TOLERANCE

TIGHTER = 30.0
"""How much smaller the tolerances of a rerun are."""
SMALLEST_CHECKED = 8.0 * SMALLEST_TOLERANCE
"""Of a run that can be checked: a rerun that is hardly any tighter says too little."""
MOST_RUNS = 7
"""Of one call, reruns too."""
AIM = 0.3
"""Part of the accuracy at which a repetition aims."""
MOST_EVALUATIONS = 12.0
"""Of a rerun, times those of the run before it: what takes more is stuck in roundings."""
STILL_FALLING = 0.5
"""An estimate that falls by less than this, while tolerances fall so much, does not fall."""
PARTED = 0.01
"""[m, rad] Two runs that are further apart have parted."""
STEPS_SHRINK = 1.0 / 8.0
"""Power of the tolerance with which the longest step of a rerun shrinks: as with order 8."""
FEWER = 0.95
"""Steps of a run over those of a tighter one, at most: else the tolerance had no say in them."""


@dataclass
class Attempt:
    """One run.

    Attributes
    ----------
    trajectory : Trajectory
        Closed, or empty, once nobody will look at it again.
    path : Path or None
        Its file.
    row : dict
        What it cost, and its estimated errors once they are known.
    """

    trajectory: Trajectory
    path: Path | None
    row: dict[str, Any]

    @property
    def tolerance(self) -> float:
        """Error of one step that it accepted."""
        return float(self.row["tolerance"])


class _Stopped(Exception):
    """A rerun did not come to its end."""

    def __init__(self, reason: str, words: str) -> None:
        super().__init__(words)
        self.reason, self.words = reason, words


@dataclass
class Attempts:
    """The runs of one task, until one of them is as accurate as was asked.

    Attributes
    ----------
    task : Task
    out : Path or None
        Where the samples are to be in the end.
    progress : callable or None
        Called with the simulated time of the first run. Of a rerun it is told through its method
        ``checking(time, number)``, where it has one; else it is called with the end of the run.
    """

    task: Task
    out: Path | None
    progress: Progress | None
    _made: list[Attempt] = field(default_factory=list)
    _judged: list[tuple[Attempt, Finding]] = field(default_factory=list)

    def first(self) -> Trajectory:
        """Carry out the task as it was given."""
        sink = MemorySink() if self.out is None else Hdf5Sink(self.out)
        trajectory = carry_out(self.task, sink, self.progress)
        self._made.append(Attempt(trajectory, self.out, _row(trajectory)))
        return trajectory

    def certify(self) -> Trajectory:
        """Check the first run, repeat it if need be, and return the chosen one."""
        try:
            reason, words = self._settle()
        except _Stopped as stop:
            reason, words = stop.reason, stop.words
        except KeyboardInterrupt:
            reason, words = INTERRUPTED, ""
        try:
            return self._finish(reason, words)
        finally:
            for attempt in self._made:
                if attempt.path != self.out:
                    self._remove(attempt.path)

    def _settle(self) -> tuple[str, str]:
        """Runs until one is accurate enough, or there is no use in another; returns why."""
        for function in self.task.data.user_callbacks:
            if function.remembers():
                return MEMORY, memory_words(function.name)
        candidate, finer = self._first_pair()
        while True:
            finding = judge(self.task.data, candidate.trajectory, finer.trajectory, self._accuracy)
            candidate.row.update(finding.estimated)
            if self._judged:
                self._drop(self._judged[-1][0])
            self._judged.append((candidate, finding))
            if finding.met:
                return "", ""
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
        """The first run and a tighter one; where there is none, a looser one and the first run."""
        first = self._made[0]
        if first.tolerance >= SMALLEST_CHECKED:
            try:
                return first, self._rerun(first.tolerance / TIGHTER, first)
            except _Stopped as stop:
                if stop.reason != EXHAUSTED:
                    raise
        looser = self._rerun(TIGHTER * max(first.tolerance, SMALLEST_TOLERANCE))
        if looser.row["steps"] > FEWER * first.row["steps"]:
            raise _Stopped(EXHAUSTED, ROUNDING_WORDS)  # then their difference says nothing
        return looser, first

    @property
    def _accuracy(self) -> AccuracySpec:
        assert self.task.spec.accuracy is not None, "only a run of some accuracy is certified"
        return self.task.spec.accuracy

    def _why_stop(self, candidate: Attempt, finding: Finding) -> tuple[str, str] | None:
        """Why no further run is of use: the reason, and the words for it; None to go on."""
        if not finding.judged:
            return CHECK, UNDETERMINED_WORDS
        rate = finding.growth
        spent = (EXHAUSTED, ROUNDING_WORDS) if rate is None else (GROWTH, growth_words(rate))
        if finding.accurate and candidate.tolerance <= SMALLEST_CHECKED:
            return CHECK, ""
        hopeless = _excess(finding) * SMALLEST_CHECKED > candidate.tolerance
        if not finding.accurate and hopeless and (rate is not None or len(self._judged) > 1):
            return spent
        if len(self._judged) > 1:
            before, earlier = self._judged[-2]
            fell = finding.excess <= STILL_FALLING * earlier.excess
            if not finding.accurate and not fell and before.tolerance > candidate.tolerance:
                return spent
            if finding.accurate and earlier.accurate:
                return CHECK, ""
        if len(self._made) + 2 > MOST_RUNS:
            return ATTEMPTS, (
                f"{len(self._made)} runs were made, which is the limit: ask for less, or give a "
                f"smaller `tolerance` yourself"
            )
        return None

    def _rerun(self, tolerance: float, coarser: Attempt | None = None) -> Attempt:
        """A run with the tolerances that correspond to ``tolerance``."""
        first = self._made[0]
        tolerance = max(tolerance, SMALLEST_TOLERANCE)
        most = math.inf if coarser is None else _most(coarser, tolerance)
        path = self._place(len(self._made))
        sink = MemorySink() if path is None else Hdf5Sink(path)
        try:
            task = self._with_shorter_steps(tolerance, coarser)
            run = carry_out(task, sink, self._watch(), tolerance / first.tolerance, most)
        except MultiarmError as error:
            self._remove(path)
            raise _Stopped(FAILED_RERUN, failed_words(str(error))) from error
        except BaseException:
            self._remove(path)
            raise
        attempt = Attempt(run, path, _row(run))
        self._made.append(attempt)
        if run.status == "interrupted":
            raise _Stopped(INTERRUPTED, "")
        if run.status != "completed" and TOO_MANY in run.message:
            raise _Stopped(EXHAUSTED, f"{TOO_MANY} at a tolerance of {tolerance:.1g}: {REMEDY}")
        if run.status != "completed":
            raise _Stopped(FAILED_RERUN, failed_words(run.message))
        return attempt

    def _with_shorter_steps(self, tolerance: float, coarser: Attempt | None) -> Task:
        """The task for a rerun: where something else than the tolerance limits the steps, the same
        steps would make the same errors, so that the rerun's longest step is shorter too.
        """
        if coarser is None:
            return self.task
        ratio = min(1.0, tolerance / coarser.tolerance) ** STEPS_SHRINK
        before = coarser.trajectory.statistics["largest_step_s"] or math.inf
        return replace(self.task, longest_step=ratio * min(self.task.longest_step, before))

    def _watch(self) -> Callable[[float], None] | None:
        progress, number = self.progress, len(self._made)
        if progress is None:
            return None
        checking = getattr(progress, "checking", None)
        if checking is not None:
            return lambda t: checking(t, number)
        return lambda _t: progress(self.task.spec.duration)

    def _place(self, number: int) -> Path | None:
        """Where the samples of a rerun go."""
        if self.out is None:
            return None
        target = self.out.expanduser().resolve()
        path = target.with_name(f".{target.name}.check{number}")
        path.unlink(missing_ok=True)  # left by a run that was killed
        return path

    def _drop(self, attempt: Attempt) -> None:
        """Let go of the samples of an attempt that nobody will look at again."""
        attempt.trajectory.close()
        if attempt.path != self.out:
            self._remove(attempt.path)

    def _remove(self, path: Path | None) -> None:
        if path is not None:
            with suppress(OSError):
                path.unlink(missing_ok=True)

    def _finish(self, reason: str, words: str) -> Trajectory:
        """The chosen run with what was found out about it."""
        chosen, finding = self._judged[-1] if self._judged else (self._made[0], None)
        changes: dict[str, Any] = {}
        if finding is None and reason == INTERRUPTED:
            changes["message"] = f"{chosen.trajectory.message}; {INTERRUPTED_WORDS}"
        else:
            if reason == INTERRUPTED:
                words = "the repetition with smaller tolerances was interrupted by the user"
            rows = [
                {**attempt.row, "returned": attempt is chosen} for attempt in self._made
            ]  # fmt: skip
            changes["certificate"] = certificate(finding, self._accuracy, reason, words, rows)
        if chosen.path is None:
            return chosen.trajectory.with_outcome(**changes)
        return self._store(chosen, changes)

    def _store(self, chosen: Attempt, changes: dict[str, Any]) -> Trajectory:
        """Write what was found out into the chosen run's file, and move it to its place."""
        assert self.out is not None and chosen.path is not None
        for attempt in self._made:
            attempt.trajectory.close()
        try:
            amend_file(chosen.path, changes)
            if chosen.path != self.out:
                chosen.path.replace(self.out.expanduser().resolve())
        except (TrajectoryError, OSError) as error:
            kept = load_trajectory(self.out)
            fault = f"the certificate could not be stored in the file: {error}"
            return kept.with_outcome(message=f"{kept.message}; {fault}")
        return load_trajectory(self.out)


def _wanted(candidate: Attempt, finding: Finding) -> float:
    """Tolerance at which the errors are expected to be as small as asked."""
    if finding.accurate:  # but its checks failed
        return candidate.tolerance / TIGHTER
    return candidate.tolerance * AIM / _excess(finding)


def _excess(finding: Finding) -> float:
    """Largest ratio of error to accuracy, as it would be if runs that part could part for ever."""
    comparison, excess = finding.comparison, finding.excess
    lengths = [v for k, v in finding.asked.items() if v is not None and k in LENGTHS]
    apart = np.maximum(*(comparison.course[kind] for kind in LENGTHS))
    parted = np.flatnonzero(apart >= PARTED)
    if finding.growth is None or not parted.size or not lengths:
        return excess
    left = float(comparison.time[-1] - comparison.time[parted[0]])
    return max(excess, SAFETY * PARTED * _grown(finding.growth, left) / min(lengths))


def _grown(rate: float | None, time: float) -> float:
    """Factor by which errors grow in a time."""
    return math.exp(min((rate or 0.0) * time, 700.0))


def _most(coarser: Attempt, tolerance: float) -> float:
    """How many evaluations a rerun may take; methods of low order take more than others."""
    tighter = max(coarser.tolerance / tolerance / TIGHTER, 1.0)
    return MOST_EVALUATIONS * tighter**0.25 * coarser.row["evaluations"] + BUDGET


def _row(run: Trajectory) -> dict[str, Any]:
    counted = run.statistics
    keys = ("tolerance", "integrator", "steps", "evaluations", "wall_time_s")
    return {**{key: counted.get(key) for key in keys}, **dict.fromkeys(KINDS)}
