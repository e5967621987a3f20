"""What every benchmark writes: a CSV that names its machine and date, one figure, and JSON.

A CSV begins with a line `# machine; date; versions`, which `read` leaves out.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import pandas
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from multiarm.plots.style import STYLE
from multiarm.results.files import save_figure
from multiarm.results.outcome import plain
from multiarm.studies.records import machine

RESULTS = Path(__file__).parent / "results"
"""The tables that the documentation shows."""
DISTURBED = 0.05
"""Share of the time that a benchmark had to wait, above which it warns."""


def options(
    description: str | None, name: str, arms: Sequence[int] = (), rounds: int = 7
) -> argparse.ArgumentParser:
    """The options that all benchmarks have, and ``--arms`` for those over the number of ``arms``.

    The CSV is ``NAME.csv`` unless named.
    """
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    if arms:
        usual = ",".join(map(str, arms))
        parser.add_argument("--arms", type=_counts, default=arms, metavar="N,N,...",
                            help=f"numbers of arms (default {usual})")  # fmt: skip
    parser.add_argument("--rounds", type=_at_least_one, default=rounds,
                        help=f"repetitions of every measurement (default {rounds})")  # fmt: skip
    parser.add_argument("--csv", type=Path, default=Path(f"{name}.csv"), metavar="FILE",
                        help="the table (default %(default)s); the documentation shows "
                        f"benchmarks/results/{name}.csv")  # fmt: skip
    parser.add_argument("--figure", type=Path, metavar="FILE", help="the figure, png, svg or pdf")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all numbers")
    return parser


def _counts(text: str) -> tuple[int, ...]:
    """Numbers of arms from a text such as ``2,4,8``, increasing; a ring has at least two."""
    try:
        numbers = tuple(sorted({int(part) for part in text.split(",")}))
    except ValueError:
        numbers = ()
    if not numbers or numbers[0] < 2:
        raise argparse.ArgumentTypeError(f"{text!r}: write numbers of arms from 2 up, as 2,4,8")
    return numbers


def _at_least_one(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1")
    return number


class Clock:
    """Wall time of a benchmark, and the share of it in which other programs ran."""

    def __enter__(self) -> Clock:
        self._begin = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_: object) -> None:
        wall = time.perf_counter() - self._begin[0]
        self.wall_time_s = wall
        self.waited = max(0.0, 1.0 - (time.process_time() - self._begin[1]) / wall)


def save(
    arguments: argparse.Namespace,
    clock: Clock,
    study: str,
    table: pandas.DataFrame,
    figure: Callable[[pandas.DataFrame], Figure],
    numbers: Any = None,
) -> None:
    """Write what was asked for, print the table, and warn where other programs disturbed.

    The JSON has the ``numbers``, or the rows of the table, by the name of the study.
    """
    arguments.csv.parent.mkdir(parents=True, exist_ok=True)
    about = machine()
    versions = ", ".join(
        f"{name} {about['dependencies'][name]}" for name in ("pin", "numpy", "numba")
    )
    processor = f"{about['processor']}, {os.cpu_count()} processors"
    date = about["created_utc"].partition("T")[0]
    text = table.to_csv(index=False, float_format="%.5g")
    arguments.csv.write_text(f"# {processor}; {date}; {versions}\n{text}", encoding="utf-8")
    written = [arguments.csv]
    if arguments.figure is not None:
        save_figure(figure(table), arguments.figure)
        written.append(arguments.figure)
    if arguments.json is not None:
        everything = {
            "machine": about, "rounds": arguments.rounds,
            study: table.to_dict("records") if numbers is None else numbers,
            "wall_time_s": clock.wall_time_s, "waited": clock.waited,
        }  # fmt: skip
        arguments.json.write_text(json.dumps(plain(everything), indent=1), encoding="utf-8")
        written.append(arguments.json)
    with pandas.option_context("display.width", 160, "display.max_columns", None):
        print(table.to_string(index=False, float_format="{:.4g}".format, na_rep="-"))
    if clock.waited > DISTURBED:
        print(f"other programs ran for {clock.waited:.0%} of the time, which is not counted; but "
              "they shared the caches: repeat on a quiet machine for the best figures")  # fmt: skip
    print("written:", *written)


def read(name: str) -> tuple[pandas.DataFrame, str]:
    """A table of ``results``, and its machine, date and versions."""
    path = RESULTS / f"{name}.csv"
    with open(path, encoding="utf-8") as lines:
        about = next(lines).strip("# \n")
    return pandas.read_csv(path, skiprows=1), about


def panels(count: int) -> tuple[Figure, list[Axes]]:
    """A figure of panels in a row, in the style of the package."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.8 * count, 3.9), layout="constrained")
        return figure, list(figure.subplots(1, count, squeeze=False)[0])


def over_arms(axes: Axes, arms: list[int], title: str, unit: str) -> None:
    """Logarithmic axes, with ticks at the numbers of arms that have room."""
    axes.set(xscale="log", yscale="log", xlabel="number of arms", ylabel=unit, title=title)
    shown: list[int] = []
    for n in reversed(arms):
        if not shown or shown[-1] >= 1.24 * n:
            shown.append(n)
    axes.set_xticks(shown, [str(n) for n in shown])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.legend(fontsize=7.5, frameon=False)
