"""Figures of a run: motion, forces, energy, drift, estimated errors and contact states.

Contact states have one row a contact with a bar for each state.  The height and the fill of a bar
show the state, as its colour does: a thin line for open, a low bar for touching, a dotted one for
resting, a hatched one for sliding, a full one for sticking.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from multiarm.notation import count_of, number
from multiarm.plots.decimation import POINTS, RotationSinceStart, decimate
from multiarm.plots.panels import DECADES, LEGEND_ROW, EventMarks, Panel, draw, sheet
from multiarm.plots.style import (
    AXIS_COLOURS,
    DASHES,
    GRID,
    PALETTE,
    ROLES,
    STYLE,
)
from multiarm.results.channels import channels_of, object_paths, work_channels
from multiarm.results.contact_states import STATE_STYLES, ContactState
from multiarm.results.energy import ENERGIES, energy_balance
from multiarm.results.event_log import Event
from multiarm.results.trajectory import Trajectory

FIGURE_POINTS = 60_000
"""Points of all lines of a figure together: many arms get fewer points each."""

_DEGREES = 180 / np.pi
_SHOWN = {
    ("joint_position", "rad"): ("angle [deg]", _DEGREES),
    ("joint_position", "m"): ("displacement [m]", 1.0),
    ("joint_torque", "N m"): ("torque [N m]", 1.0),
    ("joint_torque", "N"): ("force [N]", 1.0),
    ("contact_force", "N"): ("force [N]", 1.0),
    ("wrench", "N"): ("force [N]", 1.0),
    ("wrench", "N m"): ("moment [N m]", 1.0),
}


def object_pose(trajectory: Trajectory) -> Figure:
    """Position of the centre of mass, and rotation vector since the start, in world axes.

    Several objects have two panels each.
    """
    panels, paths = [], object_paths(trajectory.channels)
    for name, path in paths.items():
        panels += _pose_panels(trajectory, path, f"{name}: " if len(paths) > 1 else "")
    return draw(panels, events=trajectory.events)


def _pose_panels(trajectory: Trajectory, path: str, whose: str) -> list[Panel]:
    time, position = decimate(trajectory, [f"{path}/position"])
    quaternion = f"{path}/quaternion_xyzw"
    since_start = RotationSinceStart(trajectory.read(quaternion, 0, 1))
    angle_time, rotation = decimate(trajectory, [quaternion], since_start)
    return [
        Panel(
            f"{whose}Position of the centre of mass", "position [m]",
            time, position, tuple("xyz"), AXIS_COLOURS,
        ),
        Panel(
            f"{whose}Rotation since the start, as a rotation vector", "angle [deg]",
            angle_time, rotation * _DEGREES, tuple("xyz"), AXIS_COLOURS,
        ),
    ]  # fmt: skip


def joint_positions(trajectory: Trajectory) -> Figure:
    """Joint angles (deg) and displacements (m), a panel per robot."""
    return draw(_arm_panels(trajectory, "joint_position"), events=trajectory.events)


def joint_torques(trajectory: Trajectory) -> Figure:
    """Torques (N m) and forces (N) of the drives, a panel per robot."""
    return draw(_arm_panels(trajectory, "joint_torque"), events=trajectory.events)


def contact_forces(trajectory: Trajectory) -> Figure:
    """Force at each contact along its normal (N), a panel per arm or connection, and for the floor.

    Positive pushes the object, or the second body of a connection.
    """
    panels = _arm_panels(trajectory, "contact_force")
    return draw(panels, zero_line=True, events=trajectory.events)


def wrenches(trajectory: Trajectory) -> Figure | None:
    """Force (N) and moment (N m) on the object, two panels per arm, connection and for the floor.

    In world axes, the moment about the object's centre of mass; of a connection with another second
    body on that body, about the joint's frame there.  None where none were recorded.
    """
    panels = _arm_panels(trajectory, "wrench")
    if not panels:
        return None
    return draw(panels, zero_line=True, events=trajectory.events)


def energy(trajectory: Trajectory) -> Figure:
    """Kinetic energy, change of potential energy and work; below them the balance error.

    If the run has effects, the work of each of them has another pair of axes; so has the power of a
    control on each arm.
    """
    start, potential_start = trajectory.energy_at_start, trajectory.read(ENERGIES[1], 0, 1).sum()

    def combine(kinetic: np.ndarray, potential: np.ndarray, work: np.ndarray) -> np.ndarray:
        balance = energy_balance(kinetic, potential, work, start)
        return np.column_stack([kinetic, potential - potential_start, work, balance])

    time, values = decimate(trajectory, ENERGIES, combine)
    colours = tuple(ROLES.values())
    labels = ("kinetic", "potential, change", "work")
    peak = float(np.abs(values[:, 3]).max(initial=0.0))
    scale = 10.0 ** (3 * math.floor(math.log10(peak) / 3)) if 0.0 < peak < 1.0 else 1.0
    unit = "J" if scale == 1.0 else number(scale, "J")
    panels = [
        Panel("Energy and work", "energy [J]", time, values[:, :3], labels, colours[:3]),
        Panel(
            "Energy gained less work done: 0 for an exact run", f"balance [{unit}]",
            time, values[:, 3:] / scale, ("",), colours[3:],
        ),
    ]  # fmt: skip
    panels += _work_panels(trajectory) + _power_panels(trajectory)
    return draw(panels, zero_line=True, events=trajectory.events)


def drift(trajectory: Trajectory) -> Figure:
    """Largest gap of a contact, and largest rate of a gap, on logarithmic axes."""
    time, values = decimate(trajectory, ["drift/position", "drift/velocity"])
    peaks = values.max(axis=0, initial=0.0)
    floors = np.where(peaks > 0, peaks, 1e-12) * 10.0**-DECADES
    shown = np.maximum(values, floors)
    colours = (ROLES["potential"], ROLES["work"])
    panels = [
        Panel("Largest gap of a contact", "|φ| [m]", time, shown[:, :1], ("",), colours[:1]),
        Panel("Largest rate of a gap", "|Wᵀv| [m/s]", time, shown[:, 1:], ("",), colours[1:]),
    ]
    figure = draw(panels, events=trajectory.events)
    for axes, floor in zip(figure.axes, floors, strict=False):
        axes.set_yscale("log")
        axes.set_ylim(floor / 2, 10.0**DECADES * floor * 3)
        axes.minorticks_off()
    return figure


def accuracy_course(certificate: Mapping[str, Any], events: Iterable[Event] = ()) -> Figure:
    """Estimated errors over time on logarithmic axes, and the tolerances as dashed lines.

    If the run has a tolerance of forces, their errors have another pair of axes.
    """
    course, tolerances = certificate["over_time"], certificate["asked"]
    time = np.array(course["time"])
    groups: list[tuple[str, str, tuple[str, ...]]] = [
        ("Estimated error", "error [m, rad]", ("position_m", "rotation_rad"))
    ]
    if tolerances["force_N"] is not None:
        groups.append(("Estimated error of contact forces", "error [N]", ("force_N",)))
    names = {"position_m": "position", "rotation_rad": "rotation", "force_N": "force"}
    colours = dict(zip(names, (*AXIS_COLOURS[1:], ROLES["kinetic"]), strict=True))
    panels = [
        Panel(
            title, quantity, time, np.column_stack([course[kind] for kind in kinds]),
            tuple(names[kind] for kind in kinds), [colours[kind] for kind in kinds],
            log=True, levels=tuple(tolerances[kind] for kind in kinds),
        )
        for title, quantity, kinds in groups
    ]  # fmt: skip
    return draw(panels, events=events)


def _work_panels(trajectory: Trajectory) -> list[Panel]:
    works = work_channels(trajectory.channels)
    if not works:
        return []
    time, values = decimate(trajectory, list(works.values()))
    colours = [PALETTE[number % len(PALETTE)] for number in range(len(works))]
    return [Panel("Work done by each effect", "work [J]", time, values, tuple(works), colours)]


def _power_panels(trajectory: Trajectory) -> list[Panel]:
    powers = channels_of(trajectory.channels, "control_power")
    if not powers:
        return []
    time, values = decimate(trajectory, list(powers.values()))
    colours = [PALETTE[number % len(PALETTE)] for number in range(len(powers))]
    return [Panel("Power of the control", "power [W]", time, values, tuple(powers), colours)]


def _arm_panels(trajectory: Trajectory, quantity: str) -> list[Panel]:
    named = channels_of(trajectory.channels, quantity)
    channels = [trajectory.channels[name] for name in named.values()]
    lines = sum(len(channel.column_units) for channel in channels)
    points = min(POINTS, max(200, FIGURE_POINTS // max(1, lines)))
    panels = []
    for arm, channel in zip(named, channels, strict=True):
        time, values = decimate(trajectory, [channel.name], points=points)
        labels = _short(channel.column_labels)
        for unit in dict.fromkeys(channel.column_units):
            chosen = [i for i, of_column in enumerate(channel.column_units) if of_column == unit]
            shown, factor = _SHOWN[quantity, unit]
            colours = [PALETTE[i % len(PALETTE)] for i in chosen]
            dashes = [DASHES[(i + i // len(PALETTE)) % len(DASHES)] for i in chosen]
            if quantity == "wrench":
                colours, dashes = list(AXIS_COLOURS), []
            panels.append(
                Panel(
                    arm, shown, time, factor * values[:, chosen],
                    tuple(labels[i] for i in chosen), colours, dashes,
                )
            )  # fmt: skip
    return panels


def _short(labels: Sequence[str]) -> list[str]:
    """Labels without the words that all of them share at the beginning and the end."""
    words = [label.split("_") for label in labels]
    while len(words) > 1 and all(len(w) > 1 for w in words) and len({w[-1] for w in words}) == 1:
        words = [w[:-1] for w in words]
    while len(words) > 1 and all(len(w) > 1 for w in words) and len({w[0] for w in words}) == 1:
        words = [w[1:] for w in words]
    return [" ".join(w) for w in words]


ROW = 0.24
"""Height of a row [in]."""
MOST_ROWS = 64
"""Contacts in the figure; of more, the first are shown and the others counted."""
STRIP_POINTS = 12_000
"""Changes of all rows together."""


def contact_states(trajectory: Trajectory) -> Figure | None:
    """A row for each contact that can open, slide or stick; None for a run without such contacts.

    Bars change at samples, those of a long run at some of them; changes in between are visible as
    events only.
    """
    named = channels_of(trajectory.channels, "contact_state")
    rows = [
        (channel, column, f"{bearer}: {label}")
        for bearer, channel in named.items()
        for column, label in enumerate(trajectory.channels[channel].labels)
    ]
    if not rows:
        return None
    shown, left_out = rows[:MOST_ROWS], len(rows) - MOST_ROWS
    marks = EventMarks(trajectory.events)
    with matplotlib.rc_context(STYLE):
        longest = max(len(name) for _, _, name in shown)
        figure = sheet(1, 1, ROW * len(shown) + LEGEND_ROW, longest, marks)
        (axes,) = figure.subplots(1, 1, squeeze=False).ravel()
        axes.set_title("Contact states", parse_math=False)
        used = _draw_rows(axes, trajectory, shown)
        _dress(axes, [name for _, _, name in shown], left_out)
        _add_legend(axes, used)
        if len(trajectory):
            marks.draw(axes)
    return figure


def _draw_rows(axes: Axes, trajectory: Trajectory, rows: list[tuple[str, int, str]]) -> set[int]:
    """Draw the bars; returns the codes that occur."""
    points = min(POINTS, max(200, STRIP_POINTS // len(rows)))
    used: set[int] = set()
    columns: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for place, (channel, column, _) in enumerate(rows):
        if channel not in columns:
            columns[channel] = decimate(trajectory, [channel], points=points)
        time, codes = columns[channel]
        if not len(time):
            continue
        begins, ends, states = spans(time, codes[:, column])
        for code in np.unique(states):
            used.add(int(code))
            of_it = states == code
            bars = np.column_stack([begins[of_it], (ends - begins)[of_it]])
            height = STATE_STYLES[code].height
            low = place + 0.5 - height / 2
            axes.broken_barh([(b, w) for b, w in bars], (low, height), **_style(int(code)))
    return used


def spans(time: np.ndarray, codes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Begin, end (the next one's begin) and code of intervals of one state; samples have (K,)."""
    states = np.round(codes).astype(int)
    first = np.flatnonzero(np.diff(states, prepend=-1))
    ends = np.append(time[first[1:]], time[-1])
    return time[first], ends, states[first]


def _dress(axes: Axes, names: list[str], left_out: int) -> None:
    axes.set_ylim(len(names), 0)
    axes.set_yticks([])
    axes.margins(x=0)
    axes.autoscale_view(scaley=False)
    axes.grid(False)
    axes.set_axisbelow(True)
    for place in range(1, len(names)):
        axes.axhline(place, color=GRID, linewidth=0.6, zorder=0.5)
    style: dict[str, Any] = {"va": "center", "fontsize": 8.5, "parse_math": False}
    for place, name in enumerate(names):
        axes.text(1.012, place + 0.5, name, transform=axes.get_yaxis_transform(), **style)
    more = f"; {count_of(left_out, 'more contact')} not shown" if left_out > 0 else ""
    axes.set_xlabel(f"time [s]{more}")


def _add_legend(axes: Axes, used: set[int]) -> None:
    keys = [Patch(**_style(code), label=ContactState(code).word) for code in sorted(used)]
    if keys:
        axes.legend(
            handles=keys, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=len(keys),
            frameon=False, fontsize=8.5, borderaxespad=0.2, handlelength=1.6, columnspacing=1.4,
        )  # fmt: skip


def _style(code: int) -> dict[str, Any]:
    style = STATE_STYLES[ContactState(code)]
    return {
        "facecolor": "none" if style.hatch else style.colour,
        "edgecolor": style.colour,
        "hatch": style.hatch,
        "linewidth": 0.6,
    }
