"""The report of a run: one self-contained HTML page, to be read, mailed, printed and kept.

The page answers in this order: did the run end well, how good is the result, what happened, and
how can it be repeated. Figures are inline SVG whose ink follows the page's light or dark theme.
Nothing is loaded from anywhere.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from multiarm import plots
from multiarm.errors import TrajectoryError
from multiarm.reports.certificate import certificate_section
from multiarm.reports.events import events_section
from multiarm.reports.parts import NOTHING, grid, inline_svg, number, quantity, words
from multiarm.reports.style import CSS
from multiarm.results.files import atomic_file, printable

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

TIMES = "\N{MULTIPLICATION SIGN}"
_CAPTIONS = {
    "Object": "Centre of mass and orientation in world axes. The rotation vector is the axis of "
    "the turn since the start times its angle.",
    "Joint positions": "One panel per arm and unit; joints from base to tip.",
    "Joint torques": "What the controller applied. Passive effects are not included.",
    "Contact forces": "Along the contact normals; positive pushes the object. Friction is along "
    "the surface.",
    "Contact states": "What each contact does. A change and its undoing between two samples are "
    "seen by their events only.",
    "Energy": "Work is that of control and effects since the start. What does not add up is "
    "error of the integration.",
    "Drift": "How far the contacts are from closing. Zeros are drawn at the bottom.",
}
_STATISTICS = {
    "steps": "Steps",
    "rejected_steps": "Rejected steps",
    "evaluations": "Evaluations of the dynamics",
    "wall_time_s": "Wall time [s]",
    "realtime_factor": "Simulated time / wall time",
    "error_estimate": "Error estimate",
}


def report(trajectory: Trajectory, path: str | os.PathLike = "report.html") -> Path:
    """Write the report of a run.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like
        The HTML file; replaced if it exists.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TrajectoryError
        The file cannot be written.
    """
    target = Path(path).expanduser()
    page = render(trajectory)
    try:
        with atomic_file(target) as partial:
            partial.write_text(printable(page), encoding="utf-8")
    except OSError as error:
        raise TrajectoryError(
            f"cannot write '{path}': {os.strerror(error.errno or 0)}; "
            "name a file in a folder that exists and that you may write to"
        ) from error
    return target


def render(trajectory: Trajectory) -> str:
    """The page as text."""
    summary = trajectory.summary()
    title = _scene_name(trajectory.scene_text)
    parts = [
        _header(title, summary),
        _cards(trajectory, summary),
        certificate_section(trajectory.certificate, trajectory.events),
        *_figures(trajectory),
        _table("How the run went", _statistics(trajectory, summary)),
        events_section(trajectory.events),
        _scene(trajectory.scene_text),
        _footer(trajectory.provenance),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)} · multiarm report</title>\n<style>{CSS}</style>\n</head>\n"
        f"<body>\n<main>\n{''.join(parts)}</main>\n</body>\n</html>\n"
    )


def _header(title: str, summary: dict[str, Any]) -> str:
    status = summary["status"]
    message = f"<p class='message'>{escape(summary['message'])}</p>" if summary["message"] else ""
    return (
        f"<header class='{status}'><p class='kicker'>multiarm · report of a run</p>"
        f"<h1>{escape(title)}</h1><p class='status'><span>{status}</span></p>{message}</header>\n"
    )


def _cards(trajectory: Trajectory, summary: dict[str, Any]) -> str:
    forces = {arm: f for arm, f in summary["contact_force_max_N"].items() if f is not None}
    arm = max(forces, key=lambda name: forces[name], default=None)
    force = quantity(forces[arm] if arm else None, "N")
    factor = summary["realtime_factor"]
    wall, count = summary["wall_time_s"], number(summary["samples"])
    pace = NOTHING if wall is None else f"real time, in {quantity(wall, 's')}"
    cards = [
        ("Simulated", quantity(summary["duration_s"], "s"), f"{count} samples"),
        ("Speed", NOTHING if factor is None else f"{factor:.3g} {TIMES}", pace),
        ("Largest gap", quantity(summary["position_drift_max_m"], "m"),
         f"rate {quantity(summary['velocity_drift_max_m_per_s'], 'm/s')}"),
        ("Energy balance", quantity(summary["energy_balance_max_J"], "J"), "largest deviation"),
        ("Largest contact force", force, _bearer(arm, trajectory)),
    ]  # fmt: skip
    items = "".join(
        f"<li><h2>{name}</h2><p class='value'>{value}</p><p class='note'>{escape(note)}</p></li>"
        for name, value, note in cards
    )
    return f"<ul class='cards'>{items}</ul>\n"


def _bearer(name: str | None, trajectory: Trajectory) -> str:
    return "" if name is None else f"arm {name}" if name in trajectory.arm_names else name


def _figures(trajectory: Trajectory) -> Iterable[str]:
    for place, (title, figure) in enumerate(plots.figures(trajectory).items()):
        yield (
            f"<section><h2>{title}</h2><figure>{inline_svg(figure, f'f{place}-')}"
            f"<figcaption>{_CAPTIONS[title]}</figcaption></figure>"
            f"{_works(trajectory) if title == 'Energy' else ''}</section>\n"
        )


def _works(trajectory: Trajectory) -> str:
    """What each effect has done, and the rest: the control."""
    works = plots.work_channels(trajectory.channels)
    if not works or not len(trajectory):
        return ""
    end = len(trajectory) - 1
    done = {name: float(trajectory.read(channel, end)[0]) for name, channel in works.items()}
    total = float(trajectory.read("energy/work", end)[0])
    done |= {"control": total - sum(done.values()), "all together": total}
    rows = [(name, quantity(work, "J")) for name, work in done.items()]
    return grid(("Work done by", "at the end"), rows)


def _statistics(trajectory: Trajectory, summary: dict[str, Any]) -> dict[str, Any]:
    counted = trajectory.statistics
    rows = {name: counted.get(key) for key, name in _STATISTICS.items() if key in counted}
    rows |= {words(key): value for key, value in counted.items() if key not in _STATISTICS}
    rows["Object at the end, position [m]"] = summary["final_object_position"]
    rows["Object at the end, quaternion x y z w"] = summary["final_object_quaternion_xyzw"]
    for arm, force in summary["contact_force_max_N"].items():
        rows[f"Largest contact force of {arm} [N]"] = force
    return rows


def _table(title: str, rows: dict[str, Any]) -> str:
    body = "".join(
        f"<tr><th scope='row'>{escape(name)}</th><td>{escape(number(value))}</td></tr>"
        for name, value in rows.items()
    )
    return f"<section><h2>{escape(title)}</h2><table>{body}</table></section>\n"


def _scene(text: str) -> str:
    if not text.strip():
        return ""
    return (
        "<section><details><summary>The scene, as it was run</summary>"
        f"<pre>{escape(text)}</pre></details></section>\n"
    )


def _footer(provenance: dict[str, Any]) -> str:
    flat: dict[str, Any] = {}
    for key, value in provenance.items():
        if key == "dependencies":
            flat |= value
        elif key != "scene":
            flat[words(key)] = value
    items = "".join(
        f"<div><dt>{escape(key)}</dt><dd>{escape(number(value))}</dd></div>"
        for key, value in flat.items()
    )
    return f"<footer><h2>Provenance</h2><dl>{items}</dl></footer>\n"


def _scene_name(text: str) -> str:
    """The name in the scene, which need not be loadable here: its robots may be elsewhere."""
    try:
        scene = yaml.safe_load(text)
    except yaml.YAMLError:
        scene = None
    name = scene.get("name") if isinstance(scene, dict) else None
    return str(name) if name else "A run without a name"
