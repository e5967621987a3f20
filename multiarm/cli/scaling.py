"""``multiarm scaling``: how the cost of one evaluation grows with the number of arms."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from multiarm.cli.files import check_targets, write_json
from multiarm.cli.terminal import messages, output
from multiarm.errors import MultiarmError

__all__ = ["scaling"]


class Kind(str, Enum):
    """Joints between the arms and the object."""

    weld = "weld"
    ball = "ball"
    all = "all"


def scaling(
    arms: Annotated[
        str, typer.Option(help="Numbers of arms, separated by commas.", metavar="N,N,...")
    ] = "2,4,8,16,32",
    kind: Annotated[Kind, typer.Option(help="Joint between each arm and the object.")] = Kind.all,
    rounds: Annotated[
        int, typer.Option(help="Repetitions of every measurement; more smooth out noise.", min=1)
    ] = 7,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw the result to a file; its ending (png, svg, pdf) is the format.",
            show_default="none",
            metavar="FILE",
        ),
    ] = None,
    json: Annotated[
        Path | None,
        typer.Option(help="Write the figures as JSON.", show_default="none", metavar="FILE.json"),
    ] = None,
) -> None:
    """Measure how the cost of one evaluation grows with the number of arms, and print a table.

    A second table has the cost of one row of W for every kind of surface. The JSON holds what
    multiarm.benchmarks.scaling.run_scaling returns, and the rows' microseconds under contact_rows.
    """
    counts = _counts(arms)
    check_targets({"--plot": plot, "--json": json})
    from multiarm.benchmarks import contact_rows
    from multiarm.benchmarks import scaling as benchmark

    kinds = ("weld", "ball") if kind is Kind.all else (kind.value,)
    with messages().status("measuring ...") as status:
        result = benchmark.run_scaling(
            arms=counts, kinds=kinds, rounds=rounds, progress=status.update
        )
        result["contact_rows"] = contact_rows.measure_rows(rounds, progress=status.update)
    benchmark.print_scaling(result, output())
    contact_rows.print_rows(result["contact_rows"], output())
    if json is not None:
        write_json(json, result)
    if plot is not None:
        benchmark.plot_scaling(result, plot)


def _counts(text: str) -> tuple[int, ...]:
    try:
        counts = tuple(int(part) for part in text.split(","))
    except ValueError:
        counts = ()
    if not counts or min(counts) < 1:
        raise MultiarmError(
            f"--arms: '{text}' is not a list of whole numbers from 1 up; write for example 2,4,8"
        )
    return counts
