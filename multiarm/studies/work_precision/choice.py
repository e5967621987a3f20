"""The results of a study: the cheapest setting for each decade of accuracy.

A point counts for a level when its error plus the reference's digits is within it: errors that the
reference cannot resolve are not ranked.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from multiarm.studies.work_precision.points import Point
from multiarm.studies.work_precision.store import Results

LEVELS = tuple(float(f"1e-{k}") for k in range(1, 14))
CLAIMED = (1e-6, 1e-9)
"""The levels at which we are compared with the best peer."""


@dataclass(frozen=True)
class Decade:
    """The cheapest settings for one level of accuracy; None where none reaches it.

    Attributes
    ----------
    level : float
        Largest error.
    ours, peer : Point or None
    """

    level: float
    ours: Point | None
    peer: Point | None

    @property
    def ratio(self) -> float | None:
        """Wall time of the best peer over ours."""
        if self.ours is None or self.peer is None:
            return None
        assert self.ours.wall_time_s and self.peer.wall_time_s, "completed points have a time"
        return self.peer.wall_time_s / self.ours.wall_time_s


@dataclass(frozen=True)
class Series:
    """One method: its points from coarse to fine."""

    name: str
    points: tuple[Point, ...]

    @property
    def ours(self) -> bool:
        """Whether it is a method of this program."""
        return self.points[0].setting.ours

    def best(self, quantity: str) -> Point | None:
        """The point of the least error; None if no point has one."""
        able = [point for point in self.points if point.error(quantity) is not None]
        return min(able, key=lambda point: point.error(quantity) or 0.0, default=None)

    @property
    def failures(self) -> tuple[Point, ...]:
        """Points without a result."""
        return tuple(point for point in self.points if not point.completed)


def all_series(results: Results) -> list[Series]:
    """All methods, ours first, each in the order of its ladder."""
    found: dict[str, list[Point]] = {}
    for point in results.points.values():
        found.setdefault(point.setting.series, []).append(point)
    series = [
        Series(name, tuple(sorted(points, key=lambda point: -point.setting.value)))
        for name, points in found.items()
    ]
    return sorted(series, key=lambda item: not item.ours)


def decades(results: Results, quantity: str = "motion") -> list[Decade]:
    """The cheapest settings for each power of ten down to the digits of the reference."""
    digits = digits_of(results, quantity)
    points = list(results.points.values())
    ours = [point for point in points if point.setting.ours]
    peers = [point for point in points if not point.setting.ours]
    found = [
        Decade(
            level,
            cheapest(ours, level, quantity, digits),
            cheapest(peers, level, quantity, digits),
        )
        for level in LEVELS
        if level > digits
    ]
    return [decade for decade in found if decade.ours or decade.peer]


def cheapest(
    points: Iterable[Point], level: float, quantity: str, digits: float = 0.0
) -> Point | None:
    """The fastest point whose error is within a level; None when there is none."""
    able = (point for point in points if reaches(point, level, quantity, digits))
    return min(able, key=wall_time, default=None)


def reaches(point: Point, level: float, quantity: str, digits: float) -> bool:
    """Whether a point's error is within a level, beyond doubt."""
    error = point.error(quantity) if point.completed else None
    return error is not None and error + digits <= level


def digits_of(results: Results, quantity: str) -> float:
    """The digits of the reference for a quantity."""
    assert results.reference is not None, "a study begins with its reference"
    return results.reference["digits"].get(quantity, 0.0)


def wall_time(point: Point) -> float:
    """The time of a completed point [s]."""
    assert point.wall_time_s is not None, "a completed point has a time"
    return point.wall_time_s
