"""The figures of a run: what its summary shows and its JSON holds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from multiarm.results.event_log import counts, who
from multiarm.terminal.console import STATUS_STYLES, accuracy, facts, number, vector

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

__all__ = ["run_figures", "summary_table"]

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
        The wall time contains a first compilation.
    """
    keys = ("integrator", "stabilization", "solver", "arms", "accuracy", "tolerance")
    counted = trajectory.statistics
    return {
        "scene": name,
        **trajectory.summary(),
        **{key: counted.get(key) for key in keys},
        "certificate": trajectory.certificate,
        "events": trajectory.events,
        "compiled_kernels": compiled_kernels,
        "files": files,
    }


def summary_table(figures: dict[str, Any]) -> Table:
    """The figures of :func:`run_figures` as a table."""
    status = figures["status"]
    rows: dict[str, RenderableType] = {
        "status": Text(status, STATUS_STYLES[status]),
        "simulated": f"{number(figures['duration_s'], 's')}, {number(figures['samples'])} samples",
        "method": _method(figures),
        "steps": f"{number(figures['steps'])} ({number(figures['rejected_steps'])} rejected), "
        f"{number(figures['evaluations'])} evaluations",
        "wall time": _pace(figures),
        "largest gap (position drift)": number(figures["position_drift_max_m"], "m"),
        "largest gap rate (velocity drift)": number(figures["velocity_drift_max_m_per_s"], "m/s"),
        "largest energy balance error": number(figures["energy_balance_max_J"], "J"),
        **_exactness(figures),
    }
    if figures["final_object_position"] is not None:
        rows["object at the end"] = vector(figures["final_object_position"], "m")
    for arm, force in figures["contact_force_max_N"].items():
        rows[f"largest contact force, {arm}"] = number(force, "N")
    rows |= _events(figures["events"])
    return facts(figures["scene"], rows)


def _events(events: list[dict[str, Any]]) -> dict[str, RenderableType]:
    """A line for each kind of event; the first of its kind is named with its time."""
    kinds = counts(events)
    if not kinds:
        return {}
    lines = []
    for kind in kinds[:SHOWN_KINDS]:
        times = f", {number(kind.count)} times, first" if kind.count > 1 else ""
        whose = f" ({who(kind.first)})" if who(kind.first) else ""
        lines.append(f"{kind.kind}{times} at {number(float(kind.first['time']), 's')}{whose}")
    if len(kinds) > SHOWN_KINDS:
        lines.append(f"and {len(kinds) - SHOWN_KINDS} more kinds")
    return {"events": "\n".join(lines)}


def _method(figures: dict[str, Any]) -> str:
    tolerance = figures["tolerance"]
    steps = "" if tolerance is None else f" (tolerance of a step {number(tolerance)})"
    return (
        f"{figures['integrator']}{steps}, stabilization {figures['stabilization']}, "
        f"solver {figures['solver']}, {_arms(figures['arms'])}"
    )


def _arms(terms: dict[str, str] | None) -> str:
    """Who computed the arms; results of earlier versions do not say."""
    kinds = set((terms or {}).values())
    if len(kinds) < 2:
        return f"arms {kinds.pop() if kinds else 'pinocchio'}"
    return "arms " + ", ".join(f"{name} {kind}" for name, kind in (terms or {}).items())


def _exactness(figures: dict[str, Any]) -> dict[str, RenderableType]:
    """The certificate where there is one, else what the steps say of themselves."""
    certificate = figures["certificate"]
    if certificate is None:
        return {"error": _error(figures)}
    style = "bold green" if certificate["met"] else "bold yellow"
    verdict, _, rest = certificate["text"].partition(":")
    rows: dict[str, RenderableType] = {"accuracy": Text.assemble((verdict, style), f":{rest}")}
    checked = [row["wall_time_s"] or 0.0 for row in certificate["attempts"] if not row["returned"]]
    if checked:
        runs = f"{len(checked)} more run{'s' if len(checked) > 1 else ''}"
        rows["checked by"] = f"{runs} with other tolerances, {number(sum(checked), 's')}"
    return rows


def _error(figures: dict[str, Any]) -> str:
    estimate, asked_for = figures["error_estimate"], figures["accuracy"]
    asked = "" if asked_for is None else f"; asked accuracy {accuracy(asked_for)}, not checked"
    if estimate is None:
        return f"not estimated: the step is fixed{asked}"
    return f"about {number(estimate)} m or rad{asked} (an estimate: the steps' errors, summed)"


def _pace(figures: dict[str, Any]) -> str:
    pace = (
        f"{number(figures['wall_time_s'], 's')}, {number(figures['realtime_factor'])} x real time"
    )
    return f"{pace}, after compiling the kernels" if figures["compiled_kernels"] else pace
