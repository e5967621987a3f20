"""The study: all settings of a scene are measured, and then repeated in rounds.

First every ladder is run from coarse to fine, one setting of each in turn, until its error reaches
the digits of the reference, no longer falls, or a run exceeds its time limit.  Then all runs are
repeated in rounds, so that disturbances affect all of them alike; the fastest run counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.scene import Scene
from multiarm.studies.hard_cases import machine
from multiarm.studies.timing import one_thread
from multiarm.studies.work_precision.peers import Peers
from multiarm.studies.work_precision.points import TOO_SLOW, Point, measure_ours
from multiarm.studies.work_precision.reference import Reference, make_reference
from multiarm.studies.work_precision.settings import Ladder, Setting, our_ladders
from multiarm.studies.work_precision.store import Results

LEAST_PATIENCE, PATIENCE = 1.0, 5.0
"""A run may take so many seconds of wall time at least, and so many times that of the reference."""
REPEATS, QUICK_REPEATS = 8, 4
REPEAT_BUDGET = 0.5
"""The runs of one setting take about so long together [s]: slow ones are repeated less."""
STALE = 3
"""A ladder ends when so many settings in a row have made it no better."""
BETTER = 0.7
"""Fraction to which an error must fall to count as better."""

Progress = Callable[[str, float, float], None]
"""Called with what is being done, how much is done, and how much there is at most."""


def run_study(
    scene: Scene,
    results: Results | None = None,
    *,
    peers: bool = True,
    quick: bool = False,
    progress: Progress | None = None,
) -> Results:
    """Measure all methods on a scene.

    Parameters
    ----------
    scene : Scene
        Its run gives duration and output times; how exactly it is to be run has no say here.
    results : Results, optional
        Where points are kept as they come in; those that it has are not measured again.
    peers : bool
        Run other programs too.
    quick : bool
        Half the settings, fewer repeats.
    progress : callable, optional

    Raises
    ------
    MultiarmError
        Where the scene has no reference to compare with.
    KeyboardInterrupt
        Ctrl-C; what was measured is in the results.
    """
    results = Results.of(scene, machine()) if results is None else results
    report = progress or (lambda _text, _done, _total: None)
    begin = time.perf_counter()
    try:
        with one_thread():
            system = compile_system(scene)
            reference = make_reference(
                system, lambda text: report(text, 0.0, 0.0), results.reference
            )
            results.found_reference(reference)
            others = Peers(system) if peers else None
            results.refusals = {} if others is None else others.refusals
            bench = _Bench(system, reference, others, results)
            digits = reference.digits["motion"]
            climbs = [_Climb(ladder, digits) for ladder in bench.ladders(scene, quick)]
            _climb_all(climbs, bench, report)
            _repeat_all(climbs, bench, report, QUICK_REPEATS if quick else REPEATS)
    finally:
        results.wall_time_s += time.perf_counter() - begin
        results.write()
    return results


@dataclass(frozen=True)
class _Bench:
    """What measures a setting."""

    system: System
    reference: Reference
    peers: Peers | None
    results: Results

    @property
    def limit_s(self) -> float:
        return max(LEAST_PATIENCE, PATIENCE * self.reference.wall_time_s)

    def ladders(self, scene: Scene, quick: bool) -> list[Ladder]:
        average, run = self.reference.average_step_s, scene.run
        found = our_ladders(run.output_step, run.duration, average, quick)
        return found + ([] if self.peers is None else self.peers.ladders(average, quick))

    def measure(self, setting: Setting) -> Point:
        if setting.ours:
            return measure_ours(self.system, setting, self.reference, self.limit_s)
        assert self.peers is not None, "settings of peers come from them"
        return self.peers.measure(setting, self.reference, self.limit_s)


class _Climb:
    """The way down a ladder, from coarse to fine."""

    def __init__(self, ladder: Ladder, digits: float):
        self.points: list[Point] = []
        self._left = list(ladder.settings)
        self._best, self._stale = float("inf"), 0
        self._digits = digits

    @property
    def left(self) -> int:
        return len(self._left)

    def take(self) -> Setting:
        return self._left.pop(0)

    def saw(self, point: Point, limit_s: float) -> None:
        """Decide whether finer settings are worth their time."""
        self.points.append(point)
        error = point.error("motion")
        if error is not None and error < BETTER * self._best:
            self._stale = 0
        elif self._best < float("inf"):  # before the first success, finer settings are the hope
            self._stale += 1
        if error is not None:
            self._best = min(self._best, error)
        next_takes = 2.0 * (point.wall_time_s or 0.0)
        done = error is not None and error <= self._digits
        if done or self._stale >= STALE or point.status == TOO_SLOW or next_takes > limit_s:
            self._left = []


def _climb_all(climbs: list[_Climb], bench: _Bench, report: Progress) -> None:
    """Measure each setting once, one of each ladder in turn."""
    done = 0
    while any(climb.left for climb in climbs):
        for climb in climbs:
            if not climb.left:
                continue
            setting = climb.take()
            point = bench.results.points.get(setting.key)
            if point is None:
                report(setting.text, done, done + 1 + sum(other.left for other in climbs))
                point = bench.measure(setting)
                if point.status == TOO_SLOW and not climb.points:
                    point = bench.measure(setting)  # the only check that the time was no outlier
                bench.results.add(point)
            climb.saw(point, bench.limit_s)
            done += 1


def _repeat_all(climbs: list[_Climb], bench: _Bench, report: Progress, repeats: int) -> None:
    """Repeat what is quick, in rounds over all settings."""
    settings = [point.setting for climb in climbs for point in climb.points if point.completed]
    for turn in range(1, repeats):
        for number, setting in enumerate(settings):
            known = bench.results.points[setting.key]
            spent = (known.wall_time_s or 0.0) * (turn + 1)
            if known.repeats > turn or spent > REPEAT_BUDGET:
                continue
            report(f"once more: {setting.text}", number + turn * len(settings),
                 repeats * len(settings))  # fmt: skip
            bench.results.add(known.again(bench.measure(setting).wall_time_s))
