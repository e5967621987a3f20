"""Figures of a run: what moved, what it took, and how far the result can be trusted.

Each function takes a trajectory and returns a matplotlib `Figure` that belongs to no window; save
it with `figure.savefig`. Every arm has its own family of colours, in all figures the same.

A line has some thousand points at most, however long the run (see `decimation`).
"""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multiarm.channels import Channel
from multiarm.decimation import POINTS, RotationSinceStart, decimate

if TYPE_CHECKING:
    from multiarm.trajectory import Trajectory

INK, GRID = "#2b3440", "#d9dee5"
"""Colours of text and axes, and of the grid."""
DRIFT_DECADES = 6
"""Drift further below its peak is drawn at this depth: 0 has no place on a logarithmic axis."""
FIGURE_POINTS = 60_000
"""Points of all lines of a figure together: many arms get fewer points each."""
LABEL_HEIGHT = 0.155
"""Of a label at the end of a line [in]."""
SMALLEST_SPAN = 1e-3
"""A quantity that varies less, relative to its size, is drawn as what it is: constant."""

_AXIS_COLOURS = ("#d1495b", "#2f9e67", "#3b7dd8")  # x, y, z as in every viewer
_ROLES = {"kinetic": "#d9822b", "potential": "#3b7dd8", "work": "#2f9e67", "balance": "#c2417c"}
_HUES = (0.59, 0.07, 0.41, 0.87, 0.72, 0.49, 0.98, 0.14)
STYLE: dict[Any, Any] = {
    "axes.edgecolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.5,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 8,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.formatter.limits": (-4, 5),
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
    "font.family": "sans-serif",
    "font.size": 9,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "lines.solid_joinstyle": "round",
    "text.color": INK,
    "text.usetex": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
}
"""Settings of matplotlib under which all figures are drawn."""
_DEGREES = 180 / np.pi
_SHOWN = {
    ("joint_position", "rad"): ("angle [deg]", _DEGREES),
    ("joint_position", "m"): ("displacement [m]", 1.0),
    ("joint_torque", "N m"): ("torque [N m]", 1.0),
    ("joint_torque", "N"): ("force [N]", 1.0),
    ("contact_force", "N"): ("force [N]", 1.0),
}
_PREFIXES = {1e9: "G", 1e6: "M", 1e3: "k", 1: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n", 1e-12: "p"}


def figures(trajectory: Trajectory) -> dict[str, Figure]:
    """All figures of a run, by title, in the order in which one wants to see them."""
    return {
        "Object": object_pose(trajectory),
        "Joint positions": joint_positions(trajectory),
        "Joint torques": joint_torques(trajectory),
        "Contact forces": contact_forces(trajectory),
        "Energy": energy(trajectory),
        "Drift": drift(trajectory),
    }


def object_pose(trajectory: Trajectory) -> Figure:
    """Position of the centre of mass, and rotation vector since the start, in world axes."""
    time, position = decimate(trajectory, ["object/position"])
    angle_time, rotation = decimate(
        trajectory, ["object/quaternion_xyzw"], RotationSinceStart(trajectory)
    )
    panels = [
        _Panel(
            "Position of the centre of mass", "position [m]",
            time, position, tuple("xyz"), _AXIS_COLOURS,
        ),
        _Panel(
            "Rotation since the start, as a rotation vector", "angle [deg]",
            angle_time, rotation * _DEGREES, tuple("xyz"), _AXIS_COLOURS,
        ),
    ]  # fmt: skip
    return _draw(panels)


def joint_positions(trajectory: Trajectory) -> Figure:
    """Joint angles (deg) and displacements (m), a panel per arm."""
    return _draw(_arm_panels(trajectory, "joint_position"))


def joint_torques(trajectory: Trajectory) -> Figure:
    """Torques (N m) and forces (N) of the controller, a panel per arm."""
    return _draw(_arm_panels(trajectory, "joint_torque"))


def contact_forces(trajectory: Trajectory) -> Figure:
    """Force at each contact along its normal (N), a panel per arm; positive pushes."""
    return _draw(_arm_panels(trajectory, "contact_force"), zero_line=True)


def energy(trajectory: Trajectory) -> Figure:
    """Kinetic energy, change of potential energy and work; below, what does not add up."""
    names = ["energy/kinetic", "energy/potential", "energy/work"]
    kinetic_start, potential_start = (trajectory.read(name, 0, 1).sum() for name in names[:2])

    def combine(kinetic: np.ndarray, potential: np.ndarray, work: np.ndarray) -> np.ndarray:
        balance = kinetic + potential - (kinetic_start + potential_start) - work
        return np.column_stack([kinetic, potential - potential_start, work, balance])

    time, values = decimate(trajectory, names, combine)
    colours = tuple(_ROLES.values())
    labels = ("kinetic", "potential, change", "work")
    unit, scale = _prefixed("J", values[:, 3])
    panels = [
        _Panel("Energy and work", "energy [J]", time, values[:, :3], labels, colours[:3]),
        _Panel(
            "Energy gained less work done: 0 for an exact run", f"balance [{unit}]",
            time, values[:, 3:] / scale, ("",), colours[3:],
        ),
    ]  # fmt: skip
    return _draw(panels, zero_line=True)


def drift(trajectory: Trajectory) -> Figure:
    """Largest gap of a contact, and largest rate of a gap, on logarithmic axes."""
    time, values = decimate(trajectory, ["drift/position", "drift/velocity"])
    peaks = values.max(axis=0, initial=0.0)
    floors = np.where(peaks > 0, peaks, 1e-12) * 10.0**-DRIFT_DECADES
    shown = np.maximum(values, floors)
    colours = (_ROLES["potential"], _ROLES["work"])
    panels = [
        _Panel("Largest gap of a contact", "|φ| [m]", time, shown[:, :1], ("",), colours[:1]),
        _Panel("Largest rate of a gap", "|Wᵀv| [m/s]", time, shown[:, 1:], ("",), colours[1:]),
    ]
    figure = _draw(panels)
    for axes, floor in zip(figure.axes, floors, strict=False):
        axes.set_yscale("log")
        axes.set_ylim(floor / 2, 10.0**DRIFT_DECADES * floor * 3)
        axes.minorticks_off()
    return figure


def accuracy_course(certificate: Mapping[str, Any]) -> Figure:
    """Estimated errors over time on logarithmic axes, and what was asked as dashed lines.

    Forces have axes of their own, where an accuracy of forces was asked.
    """
    course, asked = certificate["over_time"], certificate["asked"]
    time = np.array(course["time"])
    groups: list[tuple[str, str, tuple[str, ...]]] = [
        ("Estimated error", "error [m, rad]", ("position_m", "rotation_rad"))
    ]
    if asked["force_N"] is not None:
        groups.append(("Estimated error of contact forces", "error [N]", ("force_N",)))
    names = {"position_m": "position", "rotation_rad": "rotation", "force_N": "force"}
    colours = dict(zip(names, (*_AXIS_COLOURS[1:], _ROLES["kinetic"]), strict=True))
    panels = [
        _Panel(
            title, quantity, time, np.column_stack([course[kind] for kind in kinds]),
            tuple(names[kind] for kind in kinds), [colours[kind] for kind in kinds],
            log=True, levels=tuple(asked[kind] for kind in kinds),
        )
        for title, quantity, kinds in groups
    ]  # fmt: skip
    return _draw(panels)


def family(arm: int, members: int) -> list[str]:
    """Colours of one arm: neighbours in hue, from deep to light.

    Parameters
    ----------
    arm : int
        Number of the arm in the scene.
    members : int
        How many lines there are to tell apart.
    """
    rounds, place = divmod(arm, len(_HUES))
    hue = _HUES[place] + 0.035 * rounds
    shades = np.linspace(0.0, 1.0, members) if members > 1 else [0.4]
    return [
        matplotlib.colors.to_hex(
            colorsys.hls_to_rgb((hue + 0.11 * (s - 0.5)) % 1, 0.38 + 0.21 * s, 0.66)
        )
        for s in shades
    ]


@dataclass(frozen=True)
class _Panel:
    """One pair of axes: lines (columns of values) over time; dashed levels in their colours."""

    title: str
    quantity: str
    time: np.ndarray
    values: np.ndarray
    labels: tuple[str, ...]
    colours: Sequence[str]
    log: bool = False
    levels: tuple[float | None, ...] = ()


def _arm_panels(trajectory: Trajectory, quantity: str) -> list[_Panel]:
    channels = [trajectory.channels[f"arms/{arm}/{quantity}"] for arm in trajectory.arm_names]
    lines = sum(len(channel.column_units) for channel in channels)
    points = min(POINTS, max(200, FIGURE_POINTS // max(1, lines)))
    panels = []
    for number, (arm, channel) in enumerate(zip(trajectory.arm_names, channels, strict=True)):
        time, values = decimate(trajectory, [channel.name], points=points)
        colours, labels = family(number, values.shape[1]), _short(_labels(channel))
        for unit in dict.fromkeys(channel.column_units):
            chosen = [i for i, other in enumerate(channel.column_units) if other == unit]
            shown, factor = _SHOWN[quantity, unit]
            panels.append(
                _Panel(
                    arm, shown, time, factor * values[:, chosen],
                    tuple(labels[i] for i in chosen), [colours[i] for i in chosen],
                )
            )  # fmt: skip
    return panels


def _labels(channel: Channel) -> tuple[str, ...]:
    return channel.labels or tuple(str(i + 1) for i in range(int(np.prod(channel.shape))))


def _short(labels: Sequence[str]) -> list[str]:
    """Labels without the words that all of them share at the beginning and the end."""
    words = [label.split("_") for label in labels]
    while len(words) > 1 and all(len(w) > 1 for w in words) and len({w[-1] for w in words}) == 1:
        words = [w[:-1] for w in words]
    while len(words) > 1 and all(len(w) > 1 for w in words) and len({w[0] for w in words}) == 1:
        words = [w[1:] for w in words]
    return [" ".join(w) for w in words]


def _prefixed(unit: str, values: np.ndarray) -> tuple[str, float]:
    """Unit with the prefix that suits the largest value, and what to divide by."""
    peak = float(np.abs(values).max()) if values.size else 0.0
    scale = next((s for s in _PREFIXES if peak >= s), 1.0 if peak == 0 else 1e-12)
    return f"{_PREFIXES[scale]}{unit}", scale


def _draw(panels: list[_Panel], zero_line: bool = False) -> Figure:
    columns = 1 if len(panels) <= 3 else 2 if len(panels) <= 12 else 4
    rows = max(1, -(-len(panels) // columns))
    with matplotlib.rc_context(STYLE):
        figure, height = _sheet(panels, rows, columns)
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
        for axes in grid[len(panels) :]:
            axes.set_visible(False)
        for axes, panel in zip(grid, panels, strict=False):
            _draw_panel(axes, panel, height, zero_line)
        for axes in grid[max(0, len(panels) - columns) : len(panels)]:
            axes.set_xlabel("time [s]")
            axes.tick_params(labelbottom=True)
    return figure


def _sheet(panels: list[_Panel], rows: int, columns: int) -> tuple[Figure, float]:
    """An empty figure with room around its axes, and the height of the axes. All in inches.

    Left edges are at the same place in all figures of one column, so that times line up.
    """
    longest = max((len(label) for panel in panels for label in panel.labels), default=0)
    most = max((len(panel.labels) for panel in panels), default=0)
    height = max(1.8, LABEL_HEIGHT * most)
    left, right, top, bottom = 0.8, 0.2 + 0.067 * longest, 0.4, 0.5
    width = (9.6 if columns == 1 else 12.0 if columns == 2 else 16.0) / columns - left - right
    size = columns * (left + width + right), rows * (top + height) + bottom
    figure = Figure(figsize=size)
    figure.patch.set_alpha(0)
    figure.subplots_adjust(
        left=left / size[0],
        right=1 - right / size[0],
        bottom=bottom / size[1],
        top=1 - top / size[1],
        wspace=(left + right) / width,
        hspace=top / height,
    )
    return figure, height


def _draw_panel(axes: Axes, panel: _Panel, height: float, zero_line: bool) -> None:
    axes.set_title(panel.title, parse_math=False)
    axes.set_ylabel(panel.quantity)
    axes.set_axisbelow(True)
    if zero_line:
        axes.axhline(0, color=INK, linewidth=0.6)
    if not len(panel.time):
        axes.text(0.5, 0.5, "no samples", transform=axes.transAxes, ha="center")
        return
    marker = "o" if len(panel.time) == 1 else None
    if panel.log:
        axes.set_yscale("log")
        axes.minorticks_off()
    for values, colour in zip(panel.values.T, panel.colours, strict=True):
        axes.plot(panel.time, values, color=colour, marker=marker, markersize=4)
    for level, colour in zip(panel.levels, panel.colours, strict=False):
        if level is not None:
            axes.axhline(level, color=colour, linewidth=1.0, linestyle="--")
    axes.margins(x=0)
    low, high = panel.values.min(), panel.values.max()
    span = SMALLEST_SPAN * max(abs(low), abs(high))
    if high - low < span:
        axes.set_ylim((low + high - span) / 2, (low + high + span) / 2)
    if any(panel.labels):
        _label_ends(axes, panel, LABEL_HEIGHT / height)


def _label_ends(axes: Axes, panel: _Panel, gap: float) -> None:
    """Write each line's name at its right end, moved apart where ends are close."""
    axes.autoscale_view()
    ends = [(panel.time[-1], value) for value in panel.values[-1]]
    places = axes.transAxes.inverted().transform(axes.transData.transform(ends))[:, 1]
    spread = _moved_apart(places, gap)
    for label, colour, place in zip(panel.labels, panel.colours, spread, strict=True):
        style: dict[str, Any] = {
            "color": colour,
            "fontsize": 8.5,
            "va": "center",
            "parse_math": False,
        }
        axes.text(1.012, place, label, transform=axes.transAxes, **style)


def _moved_apart(places: np.ndarray, gap: float) -> np.ndarray:
    """Places on [0, 1], in their order, at least `gap` apart: pushed up, then below the top."""
    order = np.argsort(places, kind="stable")
    steps = gap * np.arange(len(places))
    pushed_up = np.maximum.accumulate(np.clip(places[order], 0, 1) - steps) + steps
    moved = np.empty_like(places)
    moved[order] = np.minimum(pushed_up, max(1.0, steps[-1]) - steps[::-1])
    return moved
