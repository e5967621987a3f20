"""The study: first results soon, then the full reference, all settings, and repetitions.

1. *First results.*  Runs by accuracy, tighter and tighter as time allows; the tightest is the first
   reference, and settings of all methods are compared with it.
2. *The reference.*  It replaces the first one, and errors are computed again from stored motions.
3. *All settings* that are worth their time (:mod:`multiarm.studies.work_precision.plan`): of each
   ladder first every fourth setting, then every second one, then the others; cheap ones first, and
   those of peers last.
4. *Repetitions*, in rounds over all settings, so that disturbances affect all of them alike; the
   fastest run counts.

Every stage takes up what is already in the results, so that a study can be interrupted anywhere.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from multiarm.assembly.compilation import compile_system
from multiarm.scene import Scene
from multiarm.studies.peers import PEERS, Grid, Peer, make_peers
from multiarm.studies.records import machine
from multiarm.studies.timing import one_thread
from multiarm.studies.work_precision.plan import Plan
from multiarm.studies.work_precision.points import (
    BY_ACCURACY,
    OURS,
    TOO_SLOW,
    Ladder,
    Measured,
    Setting,
    our_ladders,
    peer_ladders,
    run_ours,
    run_peer,
)
from multiarm.studies.work_precision.reference import Reference, difference, make_reference
from multiarm.studies.work_precision.results import Results
from multiarm.terminal.progress import Progress, Report, displayed

FIRST_RESULTS, LEAST_FIRST = 10.0, 2.0
"""First results are shown after so long [s], but so long after the first reference at least."""
FIRST_REFERENCE, FIRST_PATIENCE = 4.0, 8.0
"""The runs for the first reference take so long together, about, and each of them at most [s]."""
FIRST_ACCURACIES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
TIGHTER_TAKES = 3.0
"""The next of the first accuracies takes about so many times as long."""
LEAST_PATIENCE, PATIENCE = 1.0, 5.0
"""A run may take so many seconds of wall time at least, and so many times that of the reference."""
STRIDES = (4, 2, 1)
QUICK_STRIDES = (4, 2)
REPEATS, QUICK_REPEATS = 8, 4
LEAST_REPEATS = 3
"""Dominated settings are run so often too: their first time may have been disturbed."""
REPEAT_BUDGET = 0.5
"""The runs of one setting take about so long together [s]: slow ones are repeated less."""
BETWEEN = 0.02
"""What a run takes besides its wall time, about [s]: setup, samples, comparison."""

Watch = Callable[[Results], None]
"""Called with results that are worth showing, whenever there are more of them."""

clock = time.perf_counter


def run_study(
    scene: Scene,
    results: Results | None = None,
    *,
    peers: bool = True,
    quick: bool = False,
    thorough: bool = False,
    progress: bool | Report | None = None,
    watch: Watch | None = None,
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
    thorough : bool
        Measure dominated settings too.
    progress : bool or callable, optional
        ``progress(done, total, words)``, in settings; True: on stderr.
    watch : callable, optional
        Called with the results whenever there are more of them.

    Raises
    ------
    MultiarmError
        Where the scene has no reference to compare with.
    KeyboardInterrupt
        Ctrl-C; what was measured is in the results.
    """
    results = Results.of(scene, machine()) if results is None else results
    begin = clock()
    try:
        with one_thread(), displayed(progress, Progress) as report:
            study = _Study(scene, results, quick, thorough, report, watch)
            if results.reference is None:
                study.first_results(begin + FIRST_RESULTS)
            study.find_reference()
            study.measure_all(peers)
    finally:
        results.wall_time_s += clock() - begin
        results.write()
    return results


class _Study:
    """A study as it goes on."""

    def __init__(
        self,
        scene: Scene,
        results: Results,
        quick: bool,
        thorough: bool,
        report: Report,
        watch: Watch | None,
    ) -> None:
        self.scene, self.results = scene, results
        self.strides = QUICK_STRIDES if quick else STRIDES
        self.repeats = QUICK_REPEATS if quick else REPEATS
        self.thorough = thorough
        self.report = report
        self.watch = watch or (lambda _results: None)
        self.system = compile_system(scene)
        self.peers: dict[str, Peer] = {}

    def first_results(self, until: float) -> None:
        """Find a first reference, and measure with it until a time of the clock."""
        reference = self._first_reference()
        if reference is None:
            return
        until = max(until, clock() + LEAST_FIRST)
        ladders, plan = self._our_ladders(), self._plan()
        given_up: set[str] = set()
        while clock() < until:
            left = [ladder for ladder in ladders if ladder[0].series not in given_up]
            settings = plan.open(left, STRIDES[0])
            if not settings:
                break
            self._count(plan, ladders)
            self._report(settings[0].text)
            measured = self._run_first(settings[0], LEAST_PATIENCE)
            if measured.point.status == TOO_SLOW:  # there will be more time for it
                given_up.add(settings[0].series)
            else:
                self.results.add(measured)
        self._count(plan, ladders)
        self.results.write()
        self.watch(self.results)

    def find_reference(self) -> None:
        """Replace the first reference, unless that was done before."""
        known = self.results.reference
        if known is not None and not known.first:
            return
        if known is not None:
            self.watch(self.results)
        found = make_reference(self.system, partial(self.report, 0.0, 0.0))
        if known is not None:  # the ladders of fixed steps stay as they are
            found = replace(found, average_step_s=known.average_step_s)
        self.results.found_reference(found)

    def measure_all(self, peers: bool) -> None:
        """Measure all settings that are worth their time, and repeat them."""
        self.peers, self.results.refusals = make_peers(self.system, PEERS if peers else {})
        interval = Grid.of(self.scene.run).interval
        theirs = peer_ladders(self.peers, interval, self._reference.average_step_s)
        ours = self._our_ladders()
        ladders, plan = [*ours, *theirs], self._plan()
        while True:
            for lot in (ours, theirs):
                for stride in self.strides:
                    self._measure(plan, lot, stride, ladders)
            self._repeat(plan)
            if not plan.open(ladders, self.strides[-1]):  # times that were disturbed are better now
                break
        self.results.planned = None
        self.results.left_out = plan.leaves_out(ladders, self.strides[-1])
        self.watch(self.results)

    @property
    def _reference(self) -> Reference:
        found = self.results.reference
        assert found is not None, "points are measured when there is a reference"
        return found

    def _plan(self) -> Plan:
        reference = self._reference
        limit = max(LEAST_PATIENCE, PATIENCE * reference.wall_time_s)
        return Plan(self.results.points, reference.digits, limit, self.thorough)

    def _our_ladders(self) -> list[Ladder]:
        run = self.scene.run
        return our_ladders(run.output_step, run.duration, self._reference.average_step_s)

    def _first_reference(self) -> Reference | None:
        """The tightest of the first accuracies; None where fewer than two have a result."""
        settings = [Setting(OURS, BY_ACCURACY, "", "accuracy", x) for x in FIRST_ACCURACIES]
        self.report(0.0, 0.0, "first reference")
        self._run(settings[0], FIRST_PATIENCE)  # loads what is compiled
        done: list[Measured] = []
        begin = clock()
        for setting in settings:
            self.report(0.0, 0.0, f"first reference: {setting.text}")
            before = clock()
            measured = self._run(setting, FIRST_PATIENCE)
            if measured.motion is None:
                break
            done.append(measured)
            now = clock()
            ends = now + TIGHTER_TAKES * (now - before)
            if len(done) >= 2 and ends > begin + FIRST_REFERENCE:
                break
        if len(done) < 2:
            return None
        reference = _standing_in(done[-2], done[-1], self.scene.run.duration)
        self.results.found_reference(reference)
        for measured in done:
            self.results.add(measured)
        return reference

    def _run(self, setting: Setting, limit_s: float) -> Measured:
        if setting.ours:
            return run_ours(self.system, setting, limit_s)
        return run_peer(self.system, self.peers[setting.solver], setting, limit_s)

    def _run_first(self, setting: Setting, limit_s: float) -> Measured:
        """Run a setting, a second time if it is the first of its ladder: the first loads code."""
        measured = self._run(setting, limit_s)
        if any(p.setting.series == setting.series for p in self.results.points.values()):
            return measured
        again = self._run(setting, limit_s)
        if not measured.point.completed:
            return again
        return replace(measured, point=measured.point.again(again.point.wall_time_s))

    def _measure(
        self, plan: Plan, ladders: Sequence[Ladder], stride: int, all_ladders: Sequence[Ladder]
    ) -> None:
        """Measure every ``stride``-th setting that is worth its time, cheap ones first."""
        while settings := plan.open(ladders, stride):
            self._count(plan, all_ladders)
            self._report(settings[0].text)
            self.results.add(self._run_first(settings[0], plan.limit_s))
            self.watch(self.results)

    def _repeat(self, plan: Plan) -> None:
        """Repeat what is quick, in rounds over all settings; soon without the dominated ones."""
        self.results.planned = len(self.results.points)
        for turn in range(1, self.repeats):
            dominated = plan.dominated() if turn >= LEAST_REPEATS else set()
            points = [point for point in self.results.points.values() if point.completed]
            for number, point in enumerate(points):
                spent = (point.wall_time_s or 0.0) * (turn + 1)
                setting = point.setting
                if point.repeats > turn or spent > REPEAT_BUDGET or setting.key in dominated:
                    continue
                done, total = number + turn * len(points), self.repeats * len(points)
                self.report(done, total, f"once more: {setting.text}")
                once_more = self._run(setting, plan.limit_s)
                self.results.replace(point.again(once_more.point.wall_time_s))
                self.watch(self.results)

    def _count(self, plan: Plan, ladders: Sequence[Ladder]) -> None:
        """How many points there will be, and how long that takes, by what is known now."""
        left = plan.expected_times(ladders, self.strides[-1])
        self.results.planned = len(self.results.points) + len(left)
        done = [point for point in self.results.points.values() if point.completed]
        self.results.expected_s = sum(self._takes(expected) for expected in left) + sum(
            self._takes(point.wall_time_s or 0.0, point.repeats) for point in done
        )

    def _takes(self, wall_time_s: float, repeats: int = 0) -> float:
        """About how long the runs of a setting take that are still to be made [s]."""
        runs = min(self.repeats, 1.0 + REPEAT_BUDGET / max(wall_time_s, BETWEEN))
        return max(0.0, runs - repeats) * (wall_time_s + BETWEEN)

    def _report(self, text: str) -> None:
        self.report(len(self.results.points), self.results.planned or 0, text)


def _standing_in(coarse: Measured, fine: Measured, duration: float) -> Reference:
    """The finer one of two runs by accuracy as a reference until there is a better one."""
    assert coarse.motion is not None and fine.motion is not None, "both have a result"
    made, check = (
        {
            "integrator": run.point.used,
            "accuracy": run.point.setting.value,
            "evaluations": run.point.evaluations,
        }
        for run in (fine, coarse)
    )
    assert fine.point.wall_time_s is not None and fine.point.steps is not None
    return Reference(
        fine.motion,
        difference(coarse.motion, fine.motion),
        duration / max(1, fine.point.steps),
        fine.point.wall_time_s,
        {**made, "check": check},
        first=True,
    )
