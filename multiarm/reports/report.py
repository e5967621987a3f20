"""The report of a run: one self-contained HTML page.

The page shows, in this order, whether the run completed, how accurate the result is, motion, forces
and events, and how to repeat the run.  Figures are inline SVG in the colours of the page's light or
dark theme.  The page loads nothing.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from multiarm import plots
from multiarm.errors import TrajectoryError
from multiarm.reports.parts import CSS, NOTHING, grid, inline_svg, number, quantity, words
from multiarm.results.event_log import Event, Group, counts, grouped, who
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
    "Contact states": "The state of each contact. A change that is undone between two samples is "
    "visible as events only.",
    "Energy": "Work is that of control and effects since the start. The balance is the error of "
    "the integration.",
    "Drift": "Gaps of the contacts and their rates. Zeros are drawn at the bottom.",
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
    """The work of each effect, and of the control."""
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
    """The scene's name; the scene itself may not load here, as its robots may be missing."""
    try:
        scene = yaml.safe_load(text)
    except yaml.YAMLError:
        scene = None
    name = scene.get("name") if isinstance(scene, dict) else None
    return str(name) if name else "A run without a name"


KINDS = {
    "position_m": ("Position", "m"),
    "rotation_rad": ("Rotation", "rad"),
    "force_N": ("Contact force", "N"),
}
CHECKS = {
    "energy": "Energy and work in balance",
    "residual": "Equations solved, relative",
    "drift": "Contacts closed",
}


def certificate_section(certificate: Mapping[str, Any] | None, events: Sequence[Event] = ()) -> str:
    """The section of a report; its figure shows the run's events. Empty if nothing was checked."""
    if certificate is None:
        return ""
    if not {"met", "text", "asked", "estimated_error"} <= certificate.keys():
        return _foreign(certificate)
    tone = "completed" if certificate.get("met") else "interrupted"
    verdict = "Accuracy met" if certificate.get("met") else "Accuracy not met"
    text = str(certificate.get("text", "")).partition(": ")[2]
    parts = [
        f"<div class='verdict {tone}'><p class='status'><span>{verdict}</span></p>"
        f"<p class='message'>{escape(text)}</p></div>",
        _tolerances(certificate),
        _course(certificate, events),
        _outputs(certificate),
        _checks(certificate),
        _attempts(certificate),
        f"<p class='note'>{escape(_meaning(certificate))}</p>",
    ]
    return f"<section class='certificate'><h2>Certificate</h2>{''.join(parts)}</section>\n"


def _foreign(certificate: Mapping[str, Any]) -> str:
    """A certificate in the form of another program, unchanged."""
    rows = [(words(str(key)), number(value)) for key, value in certificate.items()]
    return f"<section><h2>Certificate</h2>{grid(('', ''), rows)}</section>\n"


def _meaning(certificate: Mapping[str, Any]) -> str:
    return (
        "Errors are estimates: the differences to a rerun with smaller tolerances, times "
        f"{number(certificate.get('safety'))}, at the worst output time."
    )


def _tolerances(certificate: Mapping[str, Any]) -> str:
    asked, found = certificate["asked"], certificate["estimated_error"]
    rows = [
        (name, quantity(asked[kind], unit), quantity(found[kind], unit), _mark(asked, found, kind))
        for kind, (name, unit) in KINDS.items()
        if asked[kind] is not None or found[kind] is not None
    ]
    return grid(("", "requested", "estimated error", ""), rows)


def _mark(asked: Mapping[str, Any], found: Mapping[str, Any], kind: str) -> str:
    if asked[kind] is None:
        return "not requested"
    if found[kind] is None:
        return "not judged"
    return "met" if found[kind] <= asked[kind] else "not met"


def _outputs(certificate: Mapping[str, Any]) -> str:
    rows = []
    for name, output in certificate["by_output"].items():
        left = output.get("samples_left_out")
        note = f"forces left open by the equations at {number(left)} samples" if left else ""
        when = quantity(output.get("time"), "s") if output["error"] is not None else NOTHING
        rows.append((name, quantity(output["error"], output["unit"]), when, note))
    return grid(("By output", "estimated error", "worst at", ""), rows)


def _checks(certificate: Mapping[str, Any]) -> str:
    rows = []
    for name, check in certificate["checks"].items():
        unit = "" if check["unit"] == "1" else check["unit"]
        value, bound = (quantity(check[key], unit) if unit else number(check[key])
                        for key in ("value", "bound"))  # fmt: skip
        rows.append((CHECKS.get(name, name), value, bound, "yes" if check["passed"] else "no"))
    return grid(("The run on its own", "largest", "bound", "passed"), rows)


def _attempts(certificate: Mapping[str, Any]) -> str:
    rows = []
    for place, row in enumerate(certificate["attempts"], start=1):
        errors = [
            quantity(row[kind], unit) for kind, (_, unit) in KINDS.items() if row[kind] is not None
        ]
        rows.append(
            (
                f"{place}{' (this result)' if row.get('returned') else ''}",
                str(row["integrator"]),
                number(row["tolerance"]),
                number(row["evaluations"]),
                quantity(row["wall_time_s"], "s"),
                ", ".join(errors) or NOTHING,
            )
        )
    heads = ("Runs", "method", "tolerance of a step", "evaluations", "wall time", "estimated error")
    return grid(heads, rows)


def _course(certificate: Mapping[str, Any], events: Sequence[Event]) -> str:
    if not certificate["over_time"]["time"]:
        return ""
    svg = inline_svg(plots.accuracy_course(certificate, events), "accuracy-")
    return (
        f"<figure>{svg}<figcaption>Estimated error over time, and the requested accuracy (dashed)."
        f"{_growth(certificate)}</figcaption></figure>"
    )


def _growth(certificate: Mapping[str, Any]) -> str:
    rate = certificate["growth_rate_per_s"]
    return "" if rate is None else f" Errors grow about e<sup>{rate:.2g} t</sup>, t in s."


SHOWN_EVENTS = 200
HEADS = ("Time", "What", "Where", "Before \N{RIGHTWARDS ARROW} after")


def events_section(events: Sequence[Event]) -> str:
    """The section of a report; empty for a run without events."""
    if not events:
        return ""
    groups = grouped(events)
    rows = [_row(group) for group in groups[:SHOWN_EVENTS]]
    table = f"<div class='events'>{grid(HEADS, rows)}</div>" if rows else ""
    listed = {id(event) for group in groups for event in group.events}
    others = _others([event for event in events if id(event) not in listed])
    parts = [_counted(events), table, others, _rest(groups)]
    return f"<section><h2>Events</h2>{''.join(parts)}</section>\n"


def _row(group: Group) -> tuple[str, str, str, str]:
    first, last = group.first, group.last
    time = f"{number(first['time'])} s"
    if len(group.events) > 1:
        time = f"{number(first['time'])} to {number(last['time'])} s"
    return time, group.what(), _where(first), group.change()


def _where(event: Event) -> str:
    place = event.get("where")
    if not isinstance(place, list | tuple):
        return who(event)
    at = ", ".join(f"{value:.3g}" for value in place)
    return f"{who(event)} at ({at}) m".lstrip()


def _counted(events: Sequence[Event]) -> str:
    kinds = [f"{kind.kind}: {number(kind.count)}" for kind in counts(events)]
    return f"<p class='note'>{escape(', '.join(kinds))}</p>" if len(kinds) > 1 else ""


def _rest(groups: Sequence[Group]) -> str:
    more = sum(len(group.events) for group in groups[SHOWN_EVENTS:])
    if not more:
        return ""
    return f"<p class='note'>and {number(more)} more, in the trajectory's <code>events</code></p>"


def _others(events: Sequence[dict[str, Any]]) -> str:
    """Events in the form of another program, unchanged."""
    if not events:
        return ""
    items = "".join(
        f"<li>{escape(', '.join(f'{name}: {number(value)}' for name, value in event.items()))}</li>"
        for event in events[:SHOWN_EVENTS]
    )
    return f"<ol>{items}</ol>"
