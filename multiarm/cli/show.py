"""``multiarm replay`` and ``multiarm report``: look at the result of a run."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from multiarm.cli.files import check_targets, open_result
from multiarm.cli.terminal import messages, print_warnings, print_written
from multiarm.errors import MultiarmError

if TYPE_CHECKING:
    from multiarm.trajectory import Trajectory

__all__ = ["replay", "report", "serve_until_interrupt"]

RESULT = typer.Argument(help="A result of multiarm run, an HDF5 file.", metavar="RESULT.h5")


def replay(
    result: Annotated[Path, RESULT],
    html: Annotated[
        Path | None,
        typer.Option(
            help="Write one HTML file, which needs no network, instead of serving.",
            show_default="none",
            metavar="FILE.html",
        ),
    ] = None,
    fps: Annotated[float, typer.Option(help="Frames per second of the viewer.")] = 30.0,
    speed: Annotated[
        float, typer.Option(help="Seconds of the run shown in one second; 0.5 is slow motion.")
    ] = 1.0,
    no_open: Annotated[
        bool, typer.Option("--no-open", help="Do not open a browser; the address is printed.")
    ] = False,
) -> None:
    """Show the motion of a run in the browser, until Ctrl-C, or write it to one HTML file.

    Shown are arms, object, joints with their axes and limits, contacts and contact forces. A run
    that failed or was interrupted is shown as far as it came.
    """
    check_targets({"--html": html}, source=result)
    trajectory = _open_with_samples(result)
    if html is None:
        serve_until_interrupt(trajectory, fps=fps, speed=speed, open_browser=not no_open)
        return
    import multiarm

    multiarm.replay(trajectory, html, fps=fps, speed=speed)
    print_written("replay", html)


def report(
    result: Annotated[Path, RESULT],
    out: Annotated[
        Path, typer.Option(help="The HTML file; replaced if it exists.", metavar="FILE.html")
    ] = Path("report.html"),
) -> None:
    """Write a report of a run: figures of motion, forces, energy and drift, in one HTML file."""
    check_targets({"--out": out}, source=result)
    trajectory = _open_with_samples(result)
    import multiarm

    multiarm.report(trajectory, out)
    print_written("report", out)


def serve_until_interrupt(
    trajectory: Trajectory,
    *,
    fps: float = 30.0,
    speed: float = 1.0,
    open_browser: bool = True,
    quiet: bool = False,
) -> None:
    """Serve a live replay and wait for Ctrl-C; parameters as of ``multiarm.replay``."""
    import multiarm

    viewer = multiarm.replay(trajectory, fps=fps, speed=speed, open_browser=open_browser)
    assert not isinstance(viewer, Path), "without a path the replay is live"
    try:
        if not quiet:
            line = Text.assemble("replay at ", (viewer.url(), "bold"), "; Ctrl-C ends it")
            messages().print(line, soft_wrap=True)
        Event().wait()
    except KeyboardInterrupt:
        return


def _open_with_samples(result: Path) -> Trajectory:
    """The trajectory in a file; one that did not end well is said to be so."""
    trajectory = open_result(result)
    if not len(trajectory):
        raise MultiarmError(f"'{result}' has no samples to show: {trajectory.message}")
    if trajectory.status != "completed":
        print_warnings([f"this run {trajectory.status}: {trajectory.message}"])
    return trajectory
