"""The report of a run: one self-contained HTML page.

The page shows, in this order, whether the run completed, how accurate the result is, motion, forces
and events, and how to repeat the run.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from multiarm import plots
from multiarm.errors import SceneError, TrajectoryError
from multiarm.notation import number, numbers, value_text
from multiarm.plots.style import inline_svg
from multiarm.reports import pages
from multiarm.reports.pages import heading
from multiarm.reports.run_facts import COURSE, SETTINGS, course_facts, figures_of, motion_facts
from multiarm.results.channels import channels_of, work_channels
from multiarm.results.event_log import Event, Group, counts, grouped, who
from multiarm.results.files import printable, resolved, write_text
from multiarm.results.limit_use import (
    LIMITS,
    QUANTITIES,
    Share,
    joint_uses,
    limit_warnings,
    peaks,
    percent,
)
from multiarm.results.trajectory import Trajectory, require_trajectory
from multiarm.scene.text import parse_yaml

SHOWN_EVENTS = 200
# What a certificate has that this program wrote; one of another program is shown unchanged.
_CERTIFICATE = {"met", "text", "asked", "estimated_error"}


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
    target = resolved(path, TrajectoryError)
    page = render(require_trajectory(trajectory, "ma.report(trajectory, path)"))
    write_text(target, printable(page), error=TrajectoryError)
    return target


def render(trajectory: Trajectory) -> str:
    """The page as text."""
    figures, certificate = figures_of(trajectory), trajectory.certificate or {}
    ours = certificate if certificate.keys() >= _CERTIFICATE else None
    return pages.render(
        "report.html",
        name=_scene_name(trajectory.scene_text),
        summary=figures,
        largest_force=_largest_force(trajectory, figures),
        certificate=ours,
        certificate_figure=_course(ours, trajectory.events) if ours else "",
        foreign_certificate={} if ours else _flat(certificate),
        figures={
            title: inline_svg(figure, f"f{place}-")
            for place, (title, figure) in enumerate(plots.figures(trajectory).items())
        },
        limits=_limits(trajectory),
        works=_works(trajectory),
        statistics=_statistics(trajectory, figures),
        events=_events(trajectory.events),
        scene_text=trajectory.scene_text,
        provenance=_flat(trajectory.provenance),
    )


def _scene_name(text: str) -> str:
    """The scene's name; the scene itself may not load here, as its robots may be missing."""
    try:
        scene = parse_yaml(text)
    except SceneError:
        scene = None
    name = scene.get("name") if isinstance(scene, dict) else None
    return str(name) if name else "A run without a name"


def _largest_force(trajectory: Trajectory, summary: dict[str, Any]) -> dict[str, Any]:
    """The largest force of an arm, or of the floor, on the object [N], and at a contact."""
    forces = {arm: f for arm, f in summary["contact_force_max_N"].items() if f is not None}
    if not forces:
        return {"value": None, "note": ""}
    at_contact = max(forces, key=lambda name: forces[name])
    wrenches = {arm: w for arm, w in summary["wrench_max"].items() if w["force_N"] is not None}
    if not wrenches:
        note = f"{_bearer(trajectory, at_contact)}, at a contact; wrenches were not recorded"
        return {"value": forces[at_contact], "note": note}
    arm = max(wrenches, key=lambda name: wrenches[name]["force_N"])
    force, when = wrenches[arm]["force_N"], number(wrenches[arm]["force_time_s"], "s")
    whose = "" if arm == at_contact else f" of {_bearer(trajectory, at_contact)}"
    contact_force = number(forces[at_contact], "N")
    note = f"{_bearer(trajectory, arm)} at {when}; {contact_force} at a contact{whose}"
    return {"value": force, "note": note}


def _bearer(trajectory: Trajectory, arm: str) -> str:
    if arm not in trajectory.arm_names:
        return arm
    return f"arm {arm}" if arm in channels_of(trajectory.channels, "wrench") else f"joints of {arm}"


def _course(certificate: Mapping[str, Any], events: Sequence[Event]) -> str:
    """The figure of the estimated errors; empty where they are not known over time."""
    if not certificate["over_time"]["time"]:
        return ""
    return inline_svg(plots.accuracy_course(certificate, events), "accuracy-")


def _limits(trajectory: Trajectory) -> dict[str, Any]:
    """The use of the limits by each joint, and what is beyond them."""
    uses = joint_uses(trajectory)
    rows = [(use.joint, *_shares([getattr(use, name) for name in QUANTITIES])) for use in uses]
    return {"rows": rows, "warnings": limit_warnings(peaks(uses))}


def _shares(shares: Sequence[Share | None]) -> list[str]:
    """Share and time of each, as text."""
    cells = []
    for share in shares:
        cells += (
            [number(None), ""] if share is None else [percent(share.value), number(share.time, "s")]
        )
    return cells


def _works(trajectory: Trajectory) -> list[tuple[str, str]]:
    """The work of each effect, and of the control; empty without effects."""
    works = work_channels(trajectory.channels)
    if not works or not len(trajectory):
        return []
    end = len(trajectory) - 1
    done = {name: float(trajectory.read(channel, end)[0]) for name, channel in works.items()}
    total = float(trajectory.read("energy/work", end)[0])
    done |= {"control": total - sum(done.values()), "all together": total}
    return [(name, number(work, "J")) for name, work in done.items()]


def _statistics(trajectory: Trajectory, figures: dict[str, Any]) -> dict[str, Any]:
    """How the run went: the rows of the terminal, then what is counted besides."""
    counted = trajectory.statistics
    facts = {**course_facts(figures, counted.get("compile_time_s") or 0.0), **motion_facts(figures)}
    rows: dict[str, Any] = {heading(name): text for name, text in facts.items()}
    poses = figures["final_poses"]
    for name, pose in poses.items():
        whose = f" of {name}" if len(poses) > 1 else ""
        rows[f"Orientation{whose} at the end, quaternion x y z w"] = pose["quaternion_xyzw"]
    return rows | {
        heading(key): value
        for key, value in counted.items()
        if key not in (*SETTINGS, *COURSE) and value not in (None, {})
    }


def _events(events: Sequence[Event]) -> dict[str, Any]:
    """The events by kind, in groups, and those that another program wrote, unchanged."""
    groups = grouped(events)
    listed = {id(event) for group in groups for event in group.events}
    foreign = [event for event in events if id(event) not in listed]
    return {
        "any": bool(events),
        "kinds": counts(events),
        "rows": [_row(group) for group in groups[:SHOWN_EVENTS]],
        "foreign": [
            ", ".join(f"{name}: {value_text(value)}" for name, value in event.items())
            for event in foreign[:SHOWN_EVENTS]
        ],
        "unlisted": sum(len(group.events) for group in groups[SHOWN_EVENTS:]),
    }


def _row(group: Group) -> tuple[str, str, str, str]:
    """Time, kind, place and change of a group."""
    first, last = group.first, group.last
    time = value_text(first["time"])
    if len(group.events) > 1:
        time += f" to {value_text(last['time'])}"
    where, place = who(first), first.get("where")
    if isinstance(place, list | tuple):
        where += f" at ({numbers(place, digits=3)}) m"
    return f"{time} s", group.what(), where.lstrip(), group.change()


def _flat(table: Mapping[str, Any]) -> dict[str, Any]:
    """The values under headings; versions of dependencies by their own names.

    Without the scene and the limits of joints, which have sections of their own.
    """
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if key == "dependencies":
            flat |= value
        elif key not in ("scene", LIMITS):
            flat[heading(str(key))] = value
    return flat
