"""The tables of ``multiarm accuracy``: cheapest for each accuracy, a line a method, all points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.terminal.console import columns, number

if TYPE_CHECKING:
    from multiarm.studies.work_precision.points import Point
    from multiarm.studies.work_precision.store import Results

__all__ = ["decade_table", "method_table", "point_table"]


def decade_table(results: Results, quantity: str) -> Table:
    """The cheapest setting for each power of ten, and the best peer's."""
    from multiarm.studies.work_precision.choice import decades
    from multiarm.studies.work_precision.reference import QUANTITIES
    from multiarm.studies.work_precision.settings import short
    from multiarm.studies.work_precision.words import told

    what, unit = QUANTITIES[quantity]
    found = decades(results, quantity)
    with_peers = any(decade.peer for decade in found)
    heads = ["below", "cheapest setting", "ms"]
    heads += ["best peer", "ms", "peer/ours"] if with_peers else []
    rows: list[list[str]] = []
    for decade in found:
        row = [short(decade.level)]
        for point in (decade.ours, decade.peer)[: 2 if with_peers else 1]:
            row += ["-", "-"] if point is None else [told(point), _time(point)]
        if with_peers:
            row.append("-" if decade.ratio is None else f"{decade.ratio:.1f}")
        rows.append(row)
    table = columns(f"Cheapest for an error below, {what} [{unit}]", heads, rows)
    return _right(table, 2, 4, 5)


def method_table(results: Results, quantity: str) -> Table:
    """One line a method."""
    from multiarm.studies.work_precision.choice import (
        CLAIMED,
        all_series,
        cheapest,
        digits_of,
    )
    from multiarm.studies.work_precision.settings import short

    digits = digits_of(results, quantity)
    levels = (1e-3, *CLAIMED)
    heads = ["method", *(short(level) for level in levels), "least", "gap m", "energy J", "failed"]

    def rows() -> Iterator[list[RenderableType]]:
        for item in all_series(results):
            found = [cheapest(item.points, level, quantity, digits) for level in levels]
            best = item.best(quantity)
            least = None if best is None else max(best.error(quantity) or 0.0, digits)
            yield [
                Text(item.name, "" if item.ours else "dim"),
                *("-" if point is None else _time(point) for point in found),
                _small(least),
                _small(None if best is None else best.gap_m),
                _small(None if best is None else best.energy_J),
                f"{len(item.failures)}/{len(item.points)}" if item.failures else "",
            ]

    title = "Methods: ms of wall time to an error, and what they are at their most precise"
    return _right(columns(title, heads, rows()), *range(1, 8))


def point_table(results: Results) -> Table:
    """Every point, in the order of the methods."""
    from multiarm.studies.work_precision.choice import all_series

    heads = ("setting", "ms", "evaluations", "position", "rotation", "joints", "force",
             "gap [m]", "energy [J]")  # fmt: skip

    def rows() -> Iterator[list[RenderableType]]:
        for item in all_series(results):
            for point in item.points:
                if not point.completed:
                    reason = (f"\n{point.status}: {point.message}", "red")
                    yield [Text.assemble(point.setting.text, reason)]
                    continue
                errors = (point.errors.get(k) for k in ("position", "rotation", "joints", "force"))
                yield [
                    point.setting.text,
                    _time(point),
                    number(point.evaluations),
                    *(_small(value) for value in (*errors, point.gap_m, point.energy_J)),
                ]

    return _right(columns("All points", heads, rows()), *range(1, len(heads)))


def _right(table: Table, *numbers: int) -> Table:
    """The table, set close, with its columns of numbers to the right and whole."""
    table.padding, table.pad_edge = (0, 1, 0, 0), False
    table.min_width = len(str(table.title))
    for k in numbers:
        if k < len(table.columns):
            table.columns[k].justify = "right"
            table.columns[k].no_wrap = True
    return table


def _time(point: Point) -> str:
    """Milliseconds."""
    value = 1e3 * (point.wall_time_s or 0.0)
    return f"{value:,.0f}" if value >= 1e3 else f"{value:.3g}"


def _small(value: float | None) -> str:
    return "-" if value is None else f"{value:.0e}"
