"""Which settings of a study are worth their time, judged by what has been measured.

A measured setting *dominates* another one when it is clearly cheaper, and at least as accurate in
every quantity that is compared:

    CLEARLY * its time <= the other's time,  its errors <= the other's errors,

where errors below the digits of the reference count as the digits.  Along a ladder, from coarse to
fine, times rise and errors fall.  A setting that has not been measured therefore takes at least the
time of its next coarser neighbour, and its errors are at least those of its next finer one, with a
margin (``LUCK``), or the digits where no finer one has been measured.  If even that is dominated,
so is the setting.  Peers dominate peers only, since the best of them is shown too; settings that
name an accuracy only are always measured, since that is what most users do.

Dominance is judged anew whenever it is asked for: a time that was disturbed, or a coarse first
reference, excludes nothing for good.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from multiarm.studies.work_precision.points import BY_ACCURACY, TOO_SLOW, Ladder, Point, Setting

CLEARLY = 1.5
"""Ratio of two times from which on one setting is clearly cheaper: disturbances are smaller."""
LUCK = 0.5
"""An error between two neighbours may be smaller than both by this factor."""
GROWTH = 2.0
"""The next finer setting of a ladder takes at most so many times as long."""
STALE = 3
"""A ladder ends when it is no better so many settings later."""
BETTER = 0.7
"""Fraction to which an error must fall to count as better."""
COMPARED = ("position", "rotation", "joints", "force")


@dataclass(frozen=True)
class Plan:
    """What is to be measured.

    Attributes
    ----------
    points : mapping of str to Point
        What has been measured, by the key of its setting; the plan follows it as it grows.
    digits : mapping of str to float
        Quantity -> digits of the reference.
    limit_s : float
        The longest wall time of a run.
    thorough : bool
        Dominated settings are measured too.
    """

    points: Mapping[str, Point]
    digits: Mapping[str, float]
    limit_s: float
    thorough: bool = False

    def open(self, ladders: Iterable[Ladder], stride: int = 1) -> list[Setting]:
        """Every ``stride``-th setting that is still to be measured, cheapest first."""
        found = self._open(ladders, stride)
        return [setting for _, setting in sorted(found, key=lambda item: item[0])]

    def expected_times(self, ladders: Iterable[Ladder], stride: int = 1) -> list[float]:
        """About how long a run of each of these settings takes [s]."""
        return [min(expected, self.limit_s) for expected, _ in self._open(ladders, stride)]

    def _open(self, ladders: Iterable[Ladder], stride: int) -> list[tuple[float, Setting]]:
        """Settings that are still to be measured, with their expected times."""
        fronts = self._fronts()
        return [
            (self._expected_time(ladder, k), ladder[k])
            for ladder in ladders
            for k in self._wanted(ladder, fronts)
            if k % stride == 0
        ]

    def leaves_out(self, ladders: Iterable[Ladder], stride: int = 1) -> bool:
        """Whether there are settings that would be measured, were they not dominated."""
        thorough = Plan(self.points, self.digits, self.limit_s, thorough=True)
        ladders = list(ladders)
        return len(thorough.open(ladders, stride)) > len(self.open(ladders, stride))

    def dominated(self) -> set[str]:
        """Keys of the measured settings that are dominated; none in a thorough study."""
        fronts = self._fronts()
        return {
            key
            for key, point in self.points.items()
            if point.completed
            and self._can_be_dominated(point.setting)
            and fronts[point.setting.ours].dominates(point.wall_time_s or 0.0, self._errors(point))
        }

    def _fronts(self) -> dict[bool, _Front]:
        """What dominates settings of ours, and those of peers."""
        done = [point for point in self.points.values() if point.completed]
        sides = {ours: [p for p in done if p.setting.ours == ours] for ours in (True, False)}
        return {
            ours: _Front(
                np.array([point.wall_time_s for point in side]),
                np.array([self._errors(point) for point in side]).reshape(-1, len(COMPARED)),
            )
            for ours, side in sides.items()
        }

    def _can_be_dominated(self, setting: Setting) -> bool:
        return not self.thorough and setting.method != BY_ACCURACY

    def _wanted(self, ladder: Ladder, fronts: Mapping[bool, _Front]) -> Iterator[int]:
        """The places of a ladder's settings that are to be measured, from coarse to fine."""
        coarser: Point | None = None
        left_out: bool | None = None  # the same for all settings between two measured ones
        for k in range(self._end(ladder)):
            setting = ladder[k]
            point = self.points.get(setting.key)
            if point is not None:
                if point.completed:
                    coarser, left_out = point, None
                continue
            if left_out is None:
                left_out = self._can_be_dominated(setting) and self._between(
                    coarser, ladder[k + 1 :], fronts[setting.ours]
                )
            if not left_out:
                yield k

    def _between(self, coarser: Point | None, finer: Iterable[Setting], front: _Front) -> bool:
        """Whether settings between a measured one and the next finer ones are dominated."""
        if coarser is None:
            return False
        resolved = self._resolved(coarser.setting.ours)
        known = (self.points.get(setting.key) for setting in finer)
        fine = next((point for point in known if point is not None and point.completed), None)
        least = resolved
        if fine is not None:
            least = LUCK * np.minimum(self._errors(coarser), self._errors(fine))
        return front.dominates(coarser.wall_time_s or 0.0, np.maximum(least, resolved))

    def _errors(self, point: Point) -> np.ndarray:
        """Errors as far as the reference resolves them; infinite where there is none."""
        errors = [point.errors.get(name) for name in COMPARED]
        found = np.array([math.inf if error is None else error for error in errors])
        return np.maximum(found, self._resolved(point.setting.ours))

    def _resolved(self, ours: bool) -> np.ndarray:
        """Least errors that the reference resolves; peers give no forces."""
        least = np.array([self.digits.get(name, 0.0) for name in COMPARED])
        return least if ours else np.where(np.array(COMPARED) == "force", math.inf, least)

    def _expected_time(self, ladder: Ladder, k: int) -> float:
        """At most what a setting takes, by its coarser neighbours; 0 where there are none."""
        for i in range(k - 1, -1, -1):
            point = self.points.get(ladder[i].key)
            if point is not None and point.completed:
                return (point.wall_time_s or 0.0) * GROWTH ** (k - i)
        return 0.0

    def _end(self, ladder: Ladder) -> int:
        """How many settings of a ladder may be worth their time, without regard to others.

        It ends where errors reach the digits of the reference or no longer fall, and where runs
        would take longer than the limit.
        """
        best, best_at, end = math.inf, 0, len(ladder)
        for k, setting in enumerate(ladder):
            point = self.points.get(setting.key)
            if point is None:
                continue
            if point.status == TOO_SLOW:
                return k
            error = point.error("motion")
            if error is not None and error < BETTER * best:
                best_at = k
            if error is not None:
                best = min(best, error)
            # before the first success, finer settings are the hope
            no_better = best < math.inf and k >= best_at + STALE
            if no_better or best <= self.digits.get("motion", 0.0):
                return k
            if point.wall_time_s:
                ratio = self.limit_s / point.wall_time_s
                farther = math.floor(math.log(ratio, GROWTH)) if ratio >= 1.0 else 0
                end = min(len(ladder), k + 1 + farther)
        return end


@dataclass(frozen=True)
class _Front:
    """Times and errors of measured settings, shapes (P,) and (P, quantities)."""

    times: np.ndarray
    errors: np.ndarray

    def dominates(self, time_s: float, errors: np.ndarray) -> bool:
        """Whether one of the settings dominates another one of this time and these errors."""
        cheaper = CLEARLY * self.times <= time_s
        return bool(np.any(cheaper & np.all(self.errors <= errors, axis=1)))
