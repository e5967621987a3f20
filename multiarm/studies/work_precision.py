"""Work and precision of a scene: the cost of each accuracy by every method, and by other programs.

A *point* is the cost and the error of a setting (:mod:`multiarm.studies.settings`).  Errors are
measured against a reference whose digits are known, because an independent path through the program
arrives at them too (:mod:`multiarm.studies.reference`).

1. *First results.*  Runs by accuracy, tighter and tighter as time allows; the tightest is the first
   reference, and settings of all methods are compared with it.
2. *The reference.*  It replaces the first one, and errors are computed again.
3. *All settings*: of each ladder first every fourth setting, then every second one, then the
   others; coarse ones of all methods first, and those of peers last.
4. *Repetitions*, in rounds over all settings, so that disturbances affect all of them alike; the
   fastest run counts.

A point counts for a level of accuracy when its error plus the reference's digits is within it:
errors that the reference cannot resolve are not ranked.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import pandas

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.errors import MultiarmError
from multiarm.results.outcome import RunStatus, plain
from multiarm.results.trajectory import Trajectory
from multiarm.scene import Scene
from multiarm.studies.differences import open_forces
from multiarm.studies.peers import (
    PEERS,
    Clock,
    Grid,
    Peer,
    control_torque,
    largest_gap,
    make_peers,
    sinusoid,
)
from multiarm.studies.records import about_scene, accuracies, error_text, machine
from multiarm.studies.reference import (
    QUANTITIES,
    Motion,
    Reference,
    digits_of,
    make_reference,
    motion_error,
)
from multiarm.studies.settings import (
    BY_ACCURACY,
    OURS,
    Ladder,
    Setting,
    our_ladders,
    peer_ladders,
)
from multiarm.studies.timing import OutOfTime, clocked_run
from multiarm.terminal.progress import Progress, Report, displayed
from multiarm.threads import one_thread

COMPLETED, FAILED, TOO_SLOW = RunStatus.COMPLETED, RunStatus.FAILED, "too slow"
LEVELS = tuple(float(f"1e-{k}") for k in range(1, 14))
NUMBERS = (
    "wall_time_s", "steps", "evaluations", "gap_m", "gap_rate_m_per_s", "energy_J", *QUANTITIES,
)  # fmt: skip
"""Columns of a study's table in which numbers may be missing."""
DEFAULT_FORCE_ACCURACY = 1e-3
"""Target error of contact forces if the scene requests none [N]."""

FIRST_RESULTS, LEAST_FIRST = 10.0, 2.0
"""First results are shown after so long [s], but so long after the first reference at least."""
FIRST_REFERENCE, FIRST_PATIENCE = 4.0, 8.0
"""The runs for the first reference take so long together, about, and each of them at most [s]."""
FIRST_ACCURACIES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
TIGHTER_TAKES = 3.0
"""The next of the first accuracies takes about so many times as long."""
LEAST_PATIENCE, PATIENCE = 1.0, 5.0
"""A run may take so many seconds of wall time at least, and so many times that of the reference."""
STRIDES, QUICK_STRIDES = (4, 2, 1), (4, 2)
GROWTH = 2.0
"""The next finer setting of a ladder takes at most so many times as long."""
STALE = 3
"""A ladder ends when it is no better so many settings later."""
BETTER = 0.7
"""Fraction to which an error must fall to count as better."""
REPEATS, QUICK_REPEATS = 8, 4
REPEAT_BUDGET = 0.5
"""The runs of one setting take about so long together [s]: slow ones are repeated less."""

clock = time.perf_counter


# --- points ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """One setting, measured; None where there is no number."""

    setting: Setting
    status: str  # completed, failed, too slow
    message: str = ""  # why there is no result
    # of the fastest of ``repeats`` runs, from the first step to the last output
    wall_time_s: float | None = None
    repeats: int = 1
    steps: int | None = None
    evaluations: int | None = None
    # position [m], rotation [rad], joints [rad, m], force [N]: the worst at an output time
    errors: Mapping[str, float | None] = field(default_factory=dict)
    # largest gap of a contact at an output time (position drift)
    gap_m: float | None = None
    # largest rate of a gap at an output time (velocity drift)
    gap_rate_m_per_s: float | None = None
    energy_J: float | None = None  # largest error of the energy balance
    used: str = ""  # the integrator, where the program chose it
    # our run or a peer's motion, until the errors are those from the checked reference
    course: Trajectory | Motion | None = None

    def error(self, quantity: str) -> float | None:
        """The error of a quantity (``reference.QUANTITIES``); None where there is no result."""
        if self.status != COMPLETED:
            return None
        return motion_error(self.errors) if quantity == "motion" else self.errors.get(quantity)

    def judged(self, reference: Reference) -> Point:
        """The point with its errors, which a first reference tells for the time being."""
        if self.course is None:
            return self
        errors = reference.errors(self.course)
        return replace(self, errors=errors, course=self.course if reference.first else None)

    def again(self, wall_time_s: float | None) -> Point:
        """The point after one more run; the fastest one counts."""
        times = [seconds for seconds in (self.wall_time_s, wall_time_s) if seconds is not None]
        return replace(self, repeats=self.repeats + 1, wall_time_s=min(times, default=None))


def run_ours(system: System, setting: Setting, limit_s: float) -> Point:
    """Run one of our settings, for so much wall time at most; the point has no errors yet."""
    try:
        run, _ = clocked_run(system, limit_s, solver="node", **setting.options)
    except OutOfTime:
        return too_slow(setting, limit_s)
    except MultiarmError as error:
        return Point(setting, FAILED, str(error))
    if run.status != RunStatus.COMPLETED:
        return Point(setting, FAILED, run.message)
    statistics = run.statistics
    return Point(
        setting,
        COMPLETED,
        wall_time_s=statistics["wall_time_s"],
        steps=statistics["steps"],
        evaluations=statistics["evaluations"],
        gap_m=float(np.max(run.position_drift)),
        gap_rate_m_per_s=float(np.max(run.velocity_drift)),
        energy_J=float(np.max(np.abs(run.energy_balance))),
        used=statistics["integrator"],
        course=run,
    )


def run_peer(system: System, peer: Peer, setting: Setting, limit_s: float) -> Point:
    """Run a peer's setting; whatever it raises becomes a failed point.

    A feedback controller, which is ours and is called back, costs the peer nothing.
    """
    timer, grid, start = Clock(limit_s), Grid.of(system.scene.run), system.initial_state()
    control = timer.off_the_clock(lambda t, state: control_torque(system, t, state()))
    drive = sinusoid(system) or control
    try:
        with np.errstate(all="ignore"):
            course = peer.follow(timer, grid, start, setting.method, setting.value, drive)
            samples = list(itertools.takewhile(lambda sample: sample.is_finite, course))
    except OutOfTime:
        return too_slow(setting, limit_s)
    except Exception as error:
        return Point(setting, FAILED, error_text(error).splitlines()[0])
    if len(samples) <= grid.intervals:
        reason = f"the state is no longer finite after {samples[-1].time:.3g} s"
        return Point(setting, FAILED, reason)
    return Point(
        setting,
        COMPLETED,
        wall_time_s=timer.wall_time_s,
        steps=timer.steps,
        evaluations=timer.evaluations,
        gap_m=max(largest_gap(system, sample.state) for sample in samples),
        course=Motion(np.array([sample.state.position for sample in samples])),
    )


def too_slow(setting: Setting, limit_s: float) -> Point:
    """A setting that was not done in so much time."""
    return Point(setting, TOO_SLOW, f"not done after {limit_s:.2g} s")


# --- the study ------------------------------------------------------------------------------------


@dataclass
class Study:
    """What has been measured so far."""

    # name, duration_s, output_step_s, text, and accuracy: the error that is aimed at, for each
    # quantity
    scene: Mapping[str, Any]
    machine: Mapping[str, Any]
    reference: Reference | None = None  # what points are compared with
    # by the setting's key, in the order in which they were measured
    points: dict[str, Point] = field(default_factory=dict)
    refusals: Mapping[str, str] = field(default_factory=dict)  # peer -> why it has no points
    wall_time_s: float = 0.0  # that the study took
    planned: int = 0  # how many points there will be, as far as that is known
    finished: bool = False
    left_out: bool = True  # not every setting was measured: the study is quick, or was interrupted

    @classmethod
    def of(cls, scene: Scene) -> Study:
        """An empty study of a scene on this machine."""
        aims = accuracies(scene.run, DEFAULT_FORCE_ACCURACY)
        return cls({**about_scene(scene), "accuracy": aims | {"joints": aims["motion"]}}, machine())

    @property
    def table(self) -> pandas.DataFrame:
        """A row for each point, ours first, each method from coarse to fine.

        Columns are those of :class:`Setting` and :class:`Point`; ``key``, ``series``, ``text`` and
        ``advice`` of the setting; whether it is ``ours``; and an error for each of ``QUANTITIES``.
        """
        rows = [
            {
                **vars(point),
                **point.setting._asdict(),
                "key": key,
                "series": point.setting.series,
                "text": point.setting.text,
                "advice": point.setting.advice(point.used),
                "ours": point.setting.solver == OURS,
                **{name: point.error(name) for name in QUANTITIES},
            }
            for key, point in self.points.items()
        ]
        table = pandas.DataFrame(rows).drop(columns=["errors", "course"])
        table = table.astype(dict.fromkeys(NUMBERS, float))
        series = {name: place for place, name in enumerate(table["series"].unique())}
        order = pandas.DataFrame(
            {"peer": ~table["ours"], "series": table["series"].map(series), "fine": -table["value"]}
        )
        return table.loc[order.sort_values(list(order)).index].reset_index(drop=True)

    def digits(self, quantity: str) -> float:
        """The digits of the reference for a quantity."""
        assert self.reference is not None, "a study begins with its reference"
        return self.reference.digits.get(quantity, 0.0)

    def as_dict(self) -> dict[str, Any]:
        """The study in what JSON knows, without motions."""
        known = {} if self.reference is None else dict(vars(self.reference))
        for key in ("run", "undetermined"):
            known.pop(key, None)
        points = [
            {**vars(point), "setting": point.setting._asdict()} for point in self.points.values()
        ]
        for point in points:
            del point["course"]
        about = {key: getattr(self, key) for key in ("scene", "machine", "refusals", "left_out")}
        about["wall_time_s"] = self.wall_time_s
        return plain({**about, "reference": known, "points": points})


def decades(study: Study, quantity: str) -> pandas.DataFrame:
    """The cheapest setting for each power of ten down to the digits of the reference.

    A row for each ``level`` that any setting reaches, with the columns of ``Study.table`` of our
    cheapest point and, ending in ``_peer``, of the best peer's; ``peer_over_ours`` is the ratio of
    their wall times.
    """
    digits, points = study.digits(quantity), study.table
    fastest = {}
    for level in LEVELS:
        able = points[(points[quantity] + digits <= level) & (level > digits)]
        fastest[level] = able.loc[able.groupby("ours")["wall_time_s"].idxmin()]
    rows = pandas.concat(fastest, names=["level"]).reset_index("level")
    ours, peers = rows[rows["ours"]], rows[~rows["ours"]]
    pairs = ours.merge(peers, on="level", how="outer", suffixes=("", "_peer"))
    ratio = pairs["wall_time_s_peer"] / pairs["wall_time_s"]
    return pairs.assign(peer_over_ours=ratio).sort_values("level", ascending=False)


def run_study(
    scene: Scene,
    *,
    peers: bool = True,
    quick: bool = False,
    progress: bool | Report | None = None,
) -> Iterator[Study]:
    """Measure all methods on a scene: the study as it grows, first results first.

    Parameters
    ----------
    scene : Scene
        Its run gives duration and output times; how exactly it is to be run has no say here.
    peers : bool
        Run other programs too.
    quick : bool
        Half the settings, fewer repeats.
    progress : bool or callable, optional
        ``progress(done, total, words)``, in settings; True: on stderr.

    Yields
    ------
    Study
        The same one, whenever more of it is known; finished at the end.

    Raises
    ------
    MultiarmError
        Where the scene has no reference to compare with.
    KeyboardInterrupt
        Ctrl-C; what was measured is in the study.
    """
    begin, study = clock(), Study.of(scene)
    with one_thread(), displayed(progress, Progress) as report:
        for _ in _Measurement(compile_system(scene), study, quick, report).stages(peers):
            study.wall_time_s = clock() - begin
            yield study


class _Measurement:
    """A study as it goes on."""

    def __init__(self, system: System, study: Study, quick: bool, report: Report) -> None:
        self.system, self.study, self.report = system, study, report
        self.quick = quick
        self.strides = QUICK_STRIDES if quick else STRIDES
        self.repeats = QUICK_REPEATS if quick else REPEATS
        self.peers: dict[str, Peer] = {}
        self.limit_s = LEAST_PATIENCE

    def stages(self, peers: bool) -> Iterator[None]:
        """First results, the reference, all settings, repetitions."""
        study, run = self.study, self.system.scene.run
        until = clock() + FIRST_RESULTS
        first = self._first_reference()
        if first is not None:
            ladders = our_ladders(run.output_step, run.duration, first.average_step_s)
            until = max(until, clock() + LEAST_FIRST)
            coarse = self._climb(ladders, self.strides[:1])
            for _ in itertools.takewhile(lambda _: clock() < until, coarse):
                pass
            yield
        reference = make_reference(self.system, partial(self.report, 0.0, 0.0))
        if first is not None:  # the ladders of fixed steps stay as they are
            reference = replace(reference, average_step_s=first.average_step_s)
        self.limit_s = max(LEAST_PATIENCE, PATIENCE * reference.wall_time_s)
        study.points = {
            key: point.judged(reference)
            for key, point in study.points.items()
            if point.status != TOO_SLOW  # there is more time now
        }
        study.reference = reference
        if study.points:
            yield
        average = reference.average_step_s
        self.peers, study.refusals = make_peers(self.system, PEERS if peers else {})
        ladders = our_ladders(run.output_step, run.duration, average)
        interval = Grid.of(run).interval
        yield from self._climb(ladders, self.strides)
        yield from self._climb(peer_ladders(self.peers, interval, average), self.strides)
        study.planned = len(study.points)
        yield from self._repeat()
        study.finished, study.left_out = True, self.quick
        yield

    def _first_reference(self) -> Reference | None:
        """The tightest of the first accuracies, which the next one checks; None without two."""
        points: list[tuple[Point, Trajectory]] = []
        settings = [Setting(OURS, BY_ACCURACY, "", "accuracy", x) for x in FIRST_ACCURACIES]
        self.report(0.0, 0.0, "first reference")
        run_ours(self.system, settings[0], FIRST_PATIENCE)  # loads what is compiled
        begin = clock()
        for setting in settings:
            self.report(0.0, 0.0, f"first reference: {setting.text}")
            before = clock()
            point = run_ours(self.system, setting, FIRST_PATIENCE)
            if not isinstance(point.course, Trajectory):
                break
            points.append((point, point.course))
            ends = clock() + TIGHTER_TAKES * (clock() - before)
            if len(points) >= 2 and ends > begin + FIRST_REFERENCE:
                break
        if len(points) < 2:
            return None
        (coarse, coarse_run), (fine, run) = points[-2:]
        assert fine.wall_time_s is not None and fine.steps is not None, "it has a result"
        check, about = (
            {
                "integrator": point.used,
                "accuracy": point.setting.value,
                "evaluations": point.evaluations,
            }
            for point in (coarse, fine)
        )
        undetermined = open_forces(self.system, run)
        self.study.reference = Reference(
            run,
            undetermined,
            digits_of(coarse_run, run, undetermined),
            self.system.scene.run.duration / max(1, fine.steps),
            fine.wall_time_s,
            {**about, "check": check},
            first=True,
        )
        for point, _ in points:
            self._add(point)
        return self.study.reference

    def _climb(self, ladders: Sequence[Ladder], strides: Sequence[int]) -> Iterator[None]:
        """Measure every fourth setting of the ladders, then every second one, ..., coarse first."""
        points = self.study.points
        for stride in strides:
            for k in range(0, max(map(len, ladders), default=0), stride):
                for ladder in ladders:
                    if k < self._end(ladder) and ladder[k].key not in points:
                        ahead = sum(
                            rung.key not in points
                            for rungs in ladders
                            for rung in rungs[: self._end(rungs) : self.strides[-1]]
                        )
                        self.study.planned = len(points) + ahead
                        self.report(len(points), self.study.planned, ladder[k].text)
                        self._add(self._run_first(ladder[k]))
                        yield

    def _end(self, ladder: Ladder) -> int:
        """How many settings of a ladder may be worth their time, by those that were measured.

        It ends where errors reach the digits of the reference or no longer fall, and where runs
        would take longer than the limit.
        """
        best, best_at, end = math.inf, 0, len(ladder)
        for k, setting in enumerate(ladder):
            point = self.study.points.get(setting.key)
            if point is None:
                continue
            if point.status == TOO_SLOW:
                return k
            error = point.error("motion")
            if error is not None:
                best_at = k if error < BETTER * best else best_at
                best = min(best, error)
            # before the first success, finer settings are the hope
            no_better = best < math.inf and k >= best_at + STALE
            if no_better or best <= self.study.digits("motion"):
                return k
            if point.wall_time_s:
                farther = math.floor(math.log(self.limit_s / point.wall_time_s, GROWTH))
                end = min(len(ladder), k + 1 + max(0, farther))
        return end

    def _repeat(self) -> Iterator[None]:
        """Repeat what is quick, in rounds over all settings."""
        points = self.study.points
        completed = [key for key, point in points.items() if point.status == COMPLETED]
        for turn in range(1, self.repeats):
            for number, key in enumerate(completed):
                point = points[key]
                spent = (point.wall_time_s or 0.0) * (turn + 1)
                if point.repeats > turn or spent > REPEAT_BUDGET:
                    continue
                done, total = number + turn * len(completed), self.repeats * len(completed)
                self.report(done, total, f"once more: {point.setting.text}")
                points[key] = point.again(self._run(point.setting).wall_time_s)
                yield

    def _run(self, setting: Setting) -> Point:
        if setting.solver == OURS:
            return run_ours(self.system, setting, self.limit_s)
        return run_peer(self.system, self.peers[setting.solver], setting, self.limit_s)

    def _run_first(self, setting: Setting) -> Point:
        """Run a setting, a second time if it is the first of its ladder: the first loads code."""
        point = self._run(setting)
        measured = self.study.points.values()
        if any(earlier.setting.series == setting.series for earlier in measured):
            return point
        again = self._run(setting)
        return point.again(again.wall_time_s) if point.status == COMPLETED else again

    def _add(self, point: Point) -> None:
        assert self.study.reference is not None, "the reference comes first"
        self.study.points[point.setting.key] = point.judged(self.study.reference)
