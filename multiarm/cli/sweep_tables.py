"""What a sweep came to, as tables."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.terminal.console import STATUS_STYLES, columns, facts, number

if TYPE_CHECKING:
    from multiarm.sweeps.summary import SweepSummary

__all__ = ["facts_table", "spread_table", "trouble_lines"]

SHOWN = {0.05: "5 %", 0.5: "median", 0.95: "95 %"}
"""Quantiles of the table, of those that a summary has."""


def facts_table(name: str, summary: SweepSummary, paths: tuple[str, ...]) -> Table:
    """How the runs ended.

    Parameters
    ----------
    name : str
        Of the scene.
    summary : SweepSummary
    paths : tuple of str
        What is varied.
    """
    ended = Text(", ").join(
        Text(f"{count:,} {status}", STATUS_STYLES.get(status, ""))
        for status, count in summary.statuses.items()
    )
    rows: dict[str, RenderableType] = {
        "runs": f"{summary.done:,} of {summary.count:,}",
        "ended": ended if summary.done else "-",
        "over": ", ".join(paths),
        "time of all runs": number(summary.wall_time, "s"),
    }
    return facts(name, rows)


def spread_table(summary: SweepSummary) -> Table:
    """One line a quantity: its quantiles, and the run that has the largest."""
    heads = ("quantity", "smallest", *SHOWN.values(), "largest", "in run")
    rows = []
    for own in summary.spreads:
        numbers = [own.smallest, *(own.quantiles[level] for level in SHOWN), own.largest]
        name = f"{own.name} [{own.unit}]" if own.unit else own.name
        rows.append((name, *map(number, numbers), number(own.largest_run)))
    table = columns("Quantities", heads, rows)
    table.padding, table.pad_edge = 0, False
    for column in table.columns[1:]:
        column.justify, column.no_wrap = "right", True
    return table


def trouble_lines(summary: SweepSummary) -> list[str]:
    """What runs that did not complete say, with the first run of each."""
    lines = []
    for own in summary.failures:
        more = "" if own.runs == 1 else f" and {own.runs - 1:,} more"
        lines.append(f"run {own.first_run}{more} {own.status}: {own.message}")
    told = sum(own.runs for own in summary.failures)
    rest = summary.done - summary.statuses.get("completed", 0) - told
    return [*lines, f"and {rest:,} more runs did not complete"] if rest else lines
