"""The tables of the study: the cheapest settings, the methods, all points."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from multiarm.reports.pages import quantity as with_prefix
from multiarm.reports.pages import scientific
from multiarm.studies.tables import TEXT, Cell, Column, Table
from multiarm.studies.work_precision.choice import (
    CLAIMED,
    Decade,
    all_series,
    cheapest,
    decades,
    digits_of,
    wall_time,
)
from multiarm.studies.work_precision.points import Point
from multiarm.studies.work_precision.reference import QUANTITIES
from multiarm.studies.work_precision.settings import short
from multiarm.studies.work_precision.store import Results
from multiarm.studies.work_precision.words import described

LEVELS = (1e-3, *CLAIMED)
"""The errors for which the methods are compared."""
_seconds = partial(with_prefix, unit="s")
_count = "{:,}".format


def decade_table(results: Results, quantity: str) -> Table:
    """The cheapest setting for each power of ten, and the best peer's where there is one."""
    what, unit = QUANTITIES[quantity]
    found = decades(results, quantity)
    columns = [
        Column("below", TEXT, short, scientific),
        Column("multiarm", TEXT, described),
        Column("time", write=_seconds),
        Column("evals", write=_count, wide=True),
    ]
    if any(decade.peer for decade in found):
        columns += [
            Column("best peer", TEXT, described),
            Column("time", write=_seconds),
            Column("peer/ours", write="{:.1f}".format),
        ]
    rows = [_decade_row(decade)[: len(columns)] for decade in found]
    return Table(f"Cheapest for an error below, {what} [{unit}]", tuple(columns), tuple(rows))


def _decade_row(decade: Decade) -> tuple[Any, ...]:
    ours, peer = decade.ours, decade.peer
    return (
        decade.level,
        Cell(ours, "strong"),
        ours and ours.wall_time_s,
        ours and ours.evaluations,
        peer,
        peer and peer.wall_time_s,
        decade.ratio,
    )


def method_table(results: Results, quantity: str) -> Table:
    """One line a method: its time for some errors, and what it is at its most precise."""
    digits = digits_of(results, quantity)
    columns = (
        Column("method", TEXT),
        *(Column(short(level), write=_seconds) for level in LEVELS),
        *_errors("least", "gap m", "energy J"),
        Column("failed", about="of its settings"),
    )

    def rows() -> Iterator[tuple[Any, ...]]:
        for item in all_series(results):
            name = Cell(item.name, "" if item.ours else "pale")
            best = item.best(quantity)
            failed = f"{len(item.failures)}/{len(item.points)}"
            if best is None:
                yield name, Cell(item.points[-1].message)
                continue
            found = [cheapest(item.points, level, quantity, digits) for level in LEVELS]
            least = max(best.error(quantity) or 0.0, digits)
            times = (None if point is None else wall_time(point) for point in found)
            yield (name, *times, least, best.gap_m, best.energy_J, failed)

    title = "Methods: wall time to an error, and what they are at their most precise"
    return Table(title, columns, tuple(rows()))


def point_table(results: Results) -> Table:
    """Every point, in the order of the methods."""
    columns = (
        Column("setting", TEXT),
        Column("time", write=_seconds),
        Column("steps", write=_count, wide=True),
        Column("evals", write=_count),
        *_errors("pos.", "rot.", "joints", "force", "gap"),
        *_errors("gap rate", wide=True),
        *_errors("energy"),
    )

    def row(point: Point) -> tuple[Any, ...]:
        if not point.completed:
            return point.setting.text, Cell(f"{point.status}: {point.message}", "bad")
        errors = (point.errors.get(name) for name in ("position", "rotation", "joints", "force"))
        return (
            point.setting.text, point.wall_time_s, point.steps, point.evaluations, *errors,
            point.gap_m, point.gap_rate_m_per_s, point.energy_J,
        )  # fmt: skip

    title = "All points: errors [m, rad, rad, N], gap [m], its rate [m/s], energy [J]"
    points = (point for item in all_series(results) for point in item.points)
    return Table(title, columns, tuple(row(point) for point in points))


def _errors(*heads: str, wide: bool = False) -> Iterator[Column]:
    return (Column(head, write="{:.0e}".format, on_page=scientific, wide=wide) for head in heads)
