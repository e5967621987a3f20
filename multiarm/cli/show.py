"""``multiarm replay`` and ``multiarm report``: show the result of a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from multiarm.cli.files import check_targets
from multiarm.cli.options import file_option, option, switch
from multiarm.errors import MultiarmError, TrajectoryError
from multiarm.notation import count_of
from multiarm.results.files import resolved
from multiarm.results.outcome import RunStatus
from multiarm.terminal.console import messages, print_warnings, print_written

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

RESULT = typer.Argument(
    help="The file of multiarm run, or the folder of multiarm sweep with --run.",
    metavar="RESULT",
)
REPORT = Path("report.html")
RUN = option("Number of a run of a sweep, which is simulated again.", "N", default="none")


def replay(
    result: Annotated[Path, RESULT],
    run: Annotated[int | None, RUN] = None,
    html: Annotated[
        Path | None,
        file_option("Write one HTML file, which needs no network, and open nothing.", "FILE.html"),
    ] = None,
    fps: Annotated[float, option("Frames per second of the viewer.")] = 30.0,
    speed: Annotated[
        float, option("Seconds of the run shown in one second; 0.5 is slow motion.")
    ] = 1.0,
    no_open: Annotated[
        bool, switch("--no-open", "Do not open a browser; the place of the page is printed.")
    ] = False,
    host: Annotated[
        str | None,
        option(
            "Address of this computer at which the replay is served. Only this computer reaches "
            "the default; every computer that reaches another address can watch. 0.0.0.0: all "
            "addresses.",
            "ADDRESS",
            default="127.0.0.1 with --port",
        ),
    ] = None,
    port: Annotated[
        int | None,
        option(
            "Serve the replay at this port until Ctrl-C; 0 takes a free one.",
            "N",
            default="none, a free one with --host",
            min=0,
            max=65535,
        ),
    ] = None,
) -> None:
    """Show the motion of a run in the browser, or write it to one HTML file.

    Shown are arms, object, joints with their axes and limits, contacts and contact forces. A run
    that failed or was interrupted is shown as far as it came. Of a sweep, --run names the run.
    Code that a result names is not loaded: surfaces by functions are left out.

    The browser reads a temporary file, which is kept for a day at least. For a browser on another
    computer, forward a port: ssh -L 8000:127.0.0.1:8000 COMPUTER, there multiarm replay RESULT.h5
    --port 8000 --no-open.
    """
    check_targets({"--html": html}, source=result)
    trajectory = _open_with_samples(result, run)
    show_replay(
        trajectory, html, fps=fps, speed=speed, open_browser=not no_open, host=host, port=port
    )


def report(
    result: Annotated[Path, RESULT],
    html: Annotated[
        Path | None,
        option(
            "The HTML file; one that is named here is replaced if it exists.",
            "FILE.html",
            default=f"{REPORT}, which must not exist",
        ),
    ] = None,
    run: Annotated[int | None, RUN] = None,
) -> None:
    """Write a report of a run: figures of motion, forces, energy and drift, in one HTML file.

    Of a sweep, --run names the run.
    """
    if html is None and REPORT.exists():
        raise MultiarmError(f"'{REPORT}' exists; name the file to be written or replaced: --html")
    html = html or REPORT
    check_targets({"--html": html}, source=result)
    trajectory = _open_with_samples(result, run)
    import multiarm

    multiarm.report(trajectory, html)
    print_written("report", html)


def show_replay(
    trajectory: Trajectory, html: Path | None = None, *, quiet: bool = False, **options: Any
) -> None:
    """Show or write a replay and say where its page is; `options` as of ``multiarm.replay``."""
    import multiarm

    page = multiarm.replay(trajectory, html, **options)
    if isinstance(page, Path) and not quiet:
        print_written("replay", page)


def _open_with_samples(result: Path, run: int | None) -> Trajectory:
    """The trajectory in a file, or of a sweep's run; warns if it did not complete."""
    from multiarm.sweeps.folder import is_sweep

    if is_sweep(resolved(result)):
        trajectory = _run_of_sweep(result, run)
    else:
        trajectory = _open_result(result)
        if run is not None:
            raise MultiarmError(f"--run: '{result}' is the result of one run, not of a sweep")
    which = f"'{result}'" if run is None else f"run {run} of '{result}'"
    if not len(trajectory):
        raise MultiarmError(f"{which} has no samples to show: {trajectory.message}")
    if trajectory.status != RunStatus.COMPLETED:
        print_warnings([f"this run {trajectory.status}: {trajectory.message}"])
    return trajectory


def _open_result(path: Path) -> Trajectory:
    """The trajectory of a finished run; the message about another file recognises a scene."""
    if path.suffix.lower() in (".yaml", ".yml") and resolved(path).is_file():
        raise TrajectoryError(
            f"'{path}' is a scene, not the result of a run; first simulate it: "
            f"multiarm run {path} --out {path.stem}.h5"
        )
    from multiarm.results.trajectory import load_trajectory

    return load_trajectory(path)


def _run_of_sweep(result: Path, run: int | None) -> Trajectory:
    """Simulate a run of a sweep again, unless that needs code that its scene names."""
    from multiarm.scene import named_code
    from multiarm.sweeps.result import load_sweep

    sweep = load_sweep(result)
    if run is None:
        raise MultiarmError(
            f"'{result}' is a sweep of {count_of(sweep.count, 'run')}; choose the one to show: "
            f"--run 1 to --run {sweep.count}"
        )
    values = ", ".join(f"{path} = {value}" for path, value in sweep.values_of(run).items())
    messages().print(Text(f"simulating run {run}: {values}"), soft_wrap=True)
    failed = sweep.table.query("run == @run and status == 'failed'")
    if len(failed):
        print_warnings([f"this run is a failed one of the sweep: {failed['message'].item()}"])
    named = named_code(sweep.scene_of(run))
    if named:
        raise MultiarmError(
            f"run {run} of '{result}' is simulated again, which needs "
            f"{', '.join(dict.fromkeys(code.what for code in named))}: code that a result names is "
            "not loaded; if you trust its author, simulate it in Python: "
            "ma.load_sweep(path, code=True).trajectory(run)"
        )
    return sweep.trajectory(run)
