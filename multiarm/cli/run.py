"""``multiarm run``: simulate a scene, store the result, and print its figures and accuracy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.cli.files import check_targets, scene_to_run, write_json
from multiarm.cli.options import (
    FILES,
    METHOD,
    AccuracyOfRun,
    Arms,
    AtPainleve,
    Closing,
    Duration,
    JsonFile,
    Method,
    MostSteps,
    NoCode,
    OutputStep,
    Quiet,
    SceneFile,
    Solver,
    Step,
    Tolerance,
    chosen,
    file_option,
    switch,
)
from multiarm.cli.show import show_replay
from multiarm.errors import Fault, SceneError
from multiarm.jit.compilation import compile_time
from multiarm.notation import count_of, number
from multiarm.reports.run_facts import course_facts, figures_of, motion_facts
from multiarm.results.event_log import counts, who
from multiarm.results.outcome import RunStatus
from multiarm.terminal.console import (
    STATUS_STYLES,
    accuracy,
    facts,
    output,
    print_error,
    print_warnings,
    print_written,
)
from multiarm.terminal.progress import RunProgress

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory
    from multiarm.scene import Scene


# A start that violates the joints by more than this [m] is reported.
NOTABLE_GAP = 1e-3


def run(
    scene: SceneFile,
    duration: Duration = None,
    accuracy: AccuracyOfRun = None,
    integrator: Method = None,
    step: Step = None,
    tolerance: Tolerance = None,
    stabilization: Closing = None,
    output_step: OutputStep = None,
    most_steps: MostSteps = None,
    painleve: AtPainleve = None,
    solver: Solver = None,
    arms: Arms = None,
    certificate: Annotated[
        bool,
        switch(
            "--certificate/--no-certificate",
            "Check whether the accuracy is met, which costs a little more than the run itself; or "
            "make one run and leave it at that.",
            METHOD,
        ),
    ] = True,
    out: Annotated[
        Path | None,
        file_option(
            "HDF5 file of the result; an earlier result there is replaced.",
            "FILE.h5",
            default="SCENE's file name with .h5, in the current folder",
        ),
    ] = None,
    replay: Annotated[bool, switch("--replay", "Show the motion in the browser.", FILES)] = False,
    replay_html: Annotated[
        Path | None, file_option("Write the motion to one HTML file.", "FILE.html")
    ] = None,
    report_html: Annotated[
        Path | None, file_option("Write a report with figures to one HTML file.", "FILE.html")
    ] = None,
    json: JsonFile = None,
    quiet: Quiet = False,
    no_code: NoCode = False,
) -> None:
    """Simulate a scene and keep the result.

    Ctrl-C ends the run and keeps its samples; while the accuracy is checked, it ends the check. The
    exit code is 0 when the run is completed, 1 when it failed or was interrupted, 2 for bad input.
    A warning reports a completed run whose accuracy is not met.

    The JSON has the keys scene, status, message, samples, duration_s, steps, rejected_steps,
    evaluations, wall_time_s (without compilation), compile_time_s (during the run and its check),
    realtime_factor, error_estimate, position_drift_max_m, velocity_drift_max_m_per_s,
    energy_balance_max_J, final_object_position, final_object_quaternion_xyzw (null with several
    objects), final_poses (by object: position, quaternion_xyzw), contact_force_max_N (by arm or
    connection; floor, if there is one), wrench_max (likewise: force_N, force_time_s, moment_N_m,
    moment_time_s; on an object, about its centre of mass, of other connections on the second body,
    about the joint's frame), limit_use (largest shares of effort, speed and range of
    each joint, 1 at the limit, their times in s; and the joints that use most), rank_lowest,
    rank_highest (independent constraints), coupled_steps (steps in which some arm could not be
    eliminated), integrator, stabilization, solver, arms (backend of each), accuracy, tolerance,
    certificate (null where nothing was checked; else met, text, verdict, details, reason, asked,
    estimated_error, by_output, over_time, checks, growth_rate_per_s, safety, attempts), events
    (time, kind, text; arm, contact or joint, where in m, before and after as they apply),
    compiled_kernels (also for the scene), and files (result, replay, report). Numbers are finite,
    or null where there is none.
    """
    from multiarm.results.hdf5 import writable_target

    loaded = scene_to_run(scene, no_code)
    target = out if out is not None else Path(f"{scene.stem}.h5")
    pages = {"replay": replay_html, "report": report_html}
    check_targets(
        {
            "--out": target,
            "--replay-html": replay_html,
            "--report-html": report_html,
            "--json": json,
        },
        source=scene,
    )
    writable_target(target)
    settings = chosen(
        duration=duration,
        accuracy=accuracy,
        integrator=integrator,
        step=step,
        tolerance=tolerance,
        stabilization=stabilization,
        output_step=output_step,
        most_steps=most_steps,
        painleve=painleve,
        solver=solver,
        arms=arms,
    )
    trajectory, system, compilation = _simulate(loaded, settings, certificate, target, quiet)
    print_warnings(_remarks(trajectory, system))
    figures = run_figures(loaded.name, trajectory, {"result": str(target)}, compilation > 0.0)
    if not quiet:
        output().print(summary_table(figures, compilation))
        print_written("result", target)
    if trajectory.status != RunStatus.COMPLETED:
        print_error(f"the run {_ended(trajectory)}; the results up to there are in '{target}'")
    figures["files"] |= _write_pages(trajectory, pages, quiet)
    if json is not None:
        write_json(json, figures)
    if replay and len(trajectory):
        show_replay(trajectory, quiet=quiet)
    if trajectory.status != RunStatus.COMPLETED:
        raise typer.Exit(1)


def _remarks(trajectory: Trajectory, system: System) -> list[str]:
    """Warnings about a run, also about a completed one."""
    from multiarm.dynamics.failures import owner_of
    from multiarm.results.limit_use import joint_uses, limit_warnings, peaks

    start, remarks = system.start_report, [*system.start_warnings]
    gap = max(start.gaps.values(), default=0.0)
    if gap > NOTABLE_GAP:
        owner = max(start.gaps, key=lambda name: start.gaps[name])
        remarks.append(
            f"the written start was {number(gap, 'm')} off at {owner_of(system.model, owner)} and "
            "was assembled: " + "; ".join(start.lines())
        )
    if trajectory.status == RunStatus.COMPLETED:
        remarks += trajectory.remarks
    remarks += limit_warnings(peaks(joint_uses(trajectory)))
    if trajectory.certificate is not None and not trajectory.certificate["met"]:
        remarks.append(f"the accuracy is {trajectory.certificate['text']}")
    return remarks


def _simulate(
    scene: Scene, settings: dict[str, Any], certificate: bool, target: Path, quiet: bool
) -> tuple[Trajectory, System, float]:
    """Compile and simulate behind a progress bar; Ctrl-C ends the run, not the program.

    Returns the trajectory, the system, and how long kernels were compiled [s].
    """
    duration = settings.get("duration", scene.run.duration)
    compiled_before = compile_time()
    with RunProgress(duration, quiet) as progress:
        from multiarm.assembly.compilation import compile_system
        from multiarm.simulation.setup import run_spec
        from multiarm.simulation.simulate import simulate

        try:
            scene = scene.replace(run=run_spec(scene.run, settings))
            system = compile_system(scene)
            trajectory = simulate(system, certificate=certificate, out=target, progress=progress)
        except SceneError as error:
            raise SceneError([_about_options(fault) for fault in error.faults]) from None
        return trajectory, system, compile_time() - compiled_before


def _about_options(fault: Fault) -> Fault:
    """A fault of the run's settings, under the name of the command's option."""
    if fault.parts[:1] != ("run",):
        return fault
    if len(fault.parts) == 1:
        return Fault(fault.problem, "the settings of the run")
    return Fault(fault.problem, f"--{str(fault.parts[1]).replace('_', '-')}")


def _write_pages(
    trajectory: Trajectory, pages: dict[str, Path | None], quiet: bool
) -> dict[str, str]:
    """Write the requested pages; returns their paths."""
    wanted = {what: path for what, path in pages.items() if path is not None}
    if not len(trajectory):
        print_warnings(f"there is no sample, so no {what} was written" for what in wanted)
        return {}
    import multiarm

    for what, path in wanted.items():
        write = multiarm.replay if what == "replay" else multiarm.report
        write(trajectory, path)
        if not quiet:
            print_written(what, path)
    return {what: str(path) for what, path in wanted.items()}


def _ended(trajectory: Trajectory) -> str:
    verb = "was interrupted" if trajectory.status == RunStatus.INTERRUPTED else "failed"
    return f"{verb}: {trajectory.message}"


# Kinds of events named in the summary.
SHOWN_KINDS = 12


def run_figures(
    name: str, trajectory: Trajectory, files: dict[str, str], compiled_kernels: bool
) -> dict[str, Any]:
    """Figures of a run under the keys that ``multiarm run --help`` lists.

    Parameters
    ----------
    name : str
        Of the scene.
    trajectory : Trajectory
    files : dict
        What was written -> where.
    compiled_kernels : bool
        Kernels were compiled, before the run or during it.
    """
    return {
        "scene": name,
        **figures_of(trajectory),
        "compiled_kernels": compiled_kernels,
        "files": files,
    }


def summary_table(figures: dict[str, Any], compilation: float) -> Table:
    """The figures of :func:`run_figures` as a table; kernels were compiled for a time [s]."""
    status = figures["status"]
    rows: dict[str, RenderableType] = {
        "status": Text(status, STATUS_STYLES[status]),
        **course_facts(figures, compilation),
        **_exactness(figures),
        **motion_facts(figures),
        "joint limits used": _limits(figures["limit_use"]["largest"]),
        **_events(figures["events"]),
    }
    return facts(figures["scene"], rows)


def _limits(largest: dict[str, dict[str, Any] | None]) -> RenderableType:
    """The joints that use most of their effort, speed and range."""
    from multiarm.results.limit_use import percent

    known = [peak for peak in largest.values() if peak is not None]
    if not known:
        return Text("not known: the robots' files name none", "dim")
    return Text("\n").join(
        Text(
            f"{peak['quantity']}: {percent(peak['share'])} of {peak['joint']} "
            f"at {number(peak['time'], 's')}",
            "bold yellow" if peak["beyond"] else "",
        )
        for peak in known
    )


def _events(events: list[dict[str, Any]]) -> dict[str, RenderableType]:
    """A line for each kind of event; the first of its kind is named with its time."""
    kinds = counts(events)
    if not kinds:
        return {}
    lines = []
    for count in kinds[:SHOWN_KINDS]:
        times = f", {count.count:,} times, first" if count.count > 1 else ""
        whose = f" ({who(count.first)})" if who(count.first) else ""
        lines.append(f"{count.kind}{times} at {number(float(count.first['time']), 's')}{whose}")
    if len(kinds) > SHOWN_KINDS:
        lines.append(f"and {count_of(len(kinds) - SHOWN_KINDS, 'more kind')}")
    return {"events": "\n".join(lines)}


def _exactness(figures: dict[str, Any]) -> dict[str, RenderableType]:
    """The certificate if there is one, else the error estimate of the steps."""
    certificate = figures["certificate"]
    if certificate is None:
        return {"error": _error(figures)}
    style = "bold green" if certificate["met"] else "bold yellow"
    verdict = Text.assemble((certificate["verdict"], style), f": {certificate['details']}")
    rows: dict[str, RenderableType] = {"accuracy": verdict}
    checked = [row["wall_time_s"] or 0.0 for row in certificate["attempts"] if not row["returned"]]
    if checked:
        runs = count_of(len(checked), "more run")
        rows["checked by"] = f"{runs} with other tolerances, {number(sum(checked), 's')}"
    return rows


def _error(figures: dict[str, Any]) -> str:
    estimate, requested = figures["error_estimate"], figures["accuracy"]
    remark = "" if requested is None else f"; requested accuracy {accuracy(requested)}, not checked"
    if estimate is None:
        return f"not estimated: the step is fixed{remark}"
    return f"about {number(estimate)} m or rad{remark} (an estimate: the steps' errors, summed)"
