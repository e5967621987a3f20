"""Figures of a run: what moved, what it took, and how far the result can be trusted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from multiarm.plots.decimation import POINTS, RotationSinceStart, decimate
from multiarm.plots.panels import Panel, draw
from multiarm.plots.style import AXIS_COLOURS, ROLES, family
from multiarm.results.channels import Channel, channels_of
from multiarm.results.event_log import Event

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

DRIFT_DECADES = 6
"""Drift further below its peak is drawn at this depth: 0 has no place on a logarithmic axis."""
FIGURE_POINTS = 60_000
"""Points of all lines of a figure together: many arms get fewer points each."""

_DEGREES = 180 / np.pi
_SHOWN = {
    ("joint_position", "rad"): ("angle [deg]", _DEGREES),
    ("joint_position", "m"): ("displacement [m]", 1.0),
    ("joint_torque", "N m"): ("torque [N m]", 1.0),
    ("joint_torque", "N"): ("force [N]", 1.0),
    ("contact_force", "N"): ("force [N]", 1.0),
}
_PREFIXES = {1e9: "G", 1e6: "M", 1e3: "k", 1: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n", 1e-12: "p"}


def object_pose(trajectory: Trajectory) -> Figure:
    """Position of the centre of mass, and rotation vector since the start, in world axes."""
    time, position = decimate(trajectory, ["object/position"])
    angle_time, rotation = decimate(
        trajectory, ["object/quaternion_xyzw"], RotationSinceStart(trajectory)
    )
    panels = [
        Panel(
            "Position of the centre of mass", "position [m]",
            time, position, tuple("xyz"), AXIS_COLOURS,
        ),
        Panel(
            "Rotation since the start, as a rotation vector", "angle [deg]",
            angle_time, rotation * _DEGREES, tuple("xyz"), AXIS_COLOURS,
        ),
    ]  # fmt: skip
    return draw(panels, events=trajectory.events)


def joint_positions(trajectory: Trajectory) -> Figure:
    """Joint angles (deg) and displacements (m), a panel per arm."""
    return draw(_arm_panels(trajectory, "joint_position"), events=trajectory.events)


def joint_torques(trajectory: Trajectory) -> Figure:
    """Torques (N m) and forces (N) of the controller, a panel per arm."""
    return draw(_arm_panels(trajectory, "joint_torque"), events=trajectory.events)


def contact_forces(trajectory: Trajectory) -> Figure:
    """Force at each contact along its normal (N), a panel per arm, and one for the floor.

    Positive pushes.
    """
    panels = _arm_panels(trajectory, "contact_force")
    return draw(panels, zero_line=True, events=trajectory.events)


def energy(trajectory: Trajectory) -> Figure:
    """Kinetic energy, change of potential energy and work; below, what does not add up.

    The work of each effect by name has axes of its own, where the run has effects.
    """
    names = ["energy/kinetic", "energy/potential", "energy/work"]
    kinetic_start, potential_start = (trajectory.read(name, 0, 1).sum() for name in names[:2])

    def combine(kinetic: np.ndarray, potential: np.ndarray, work: np.ndarray) -> np.ndarray:
        balance = kinetic + potential - (kinetic_start + potential_start) - work
        return np.column_stack([kinetic, potential - potential_start, work, balance])

    time, values = decimate(trajectory, names, combine)
    colours = tuple(ROLES.values())
    labels = ("kinetic", "potential, change", "work")
    unit, scale = _prefixed("J", values[:, 3])
    panels = [
        Panel("Energy and work", "energy [J]", time, values[:, :3], labels, colours[:3]),
        Panel(
            "Energy gained less work done: 0 for an exact run", f"balance [{unit}]",
            time, values[:, 3:] / scale, ("",), colours[3:],
        ),
    ]  # fmt: skip
    return draw([*panels, *_work_panels(trajectory)], zero_line=True, events=trajectory.events)


def drift(trajectory: Trajectory) -> Figure:
    """Largest gap of a contact, and largest rate of a gap, on logarithmic axes."""
    time, values = decimate(trajectory, ["drift/position", "drift/velocity"])
    peaks = values.max(axis=0, initial=0.0)
    floors = np.where(peaks > 0, peaks, 1e-12) * 10.0**-DRIFT_DECADES
    shown = np.maximum(values, floors)
    colours = (ROLES["potential"], ROLES["work"])
    panels = [
        Panel("Largest gap of a contact", "|φ| [m]", time, shown[:, :1], ("",), colours[:1]),
        Panel("Largest rate of a gap", "|Wᵀv| [m/s]", time, shown[:, 1:], ("",), colours[1:]),
    ]
    figure = draw(panels, events=trajectory.events)
    for axes, floor in zip(figure.axes, floors, strict=False):
        axes.set_yscale("log")
        axes.set_ylim(floor / 2, 10.0**DRIFT_DECADES * floor * 3)
        axes.minorticks_off()
    return figure


def accuracy_course(certificate: Mapping[str, Any], events: Iterable[Event] = ()) -> Figure:
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
    colours = dict(zip(names, (*AXIS_COLOURS[1:], ROLES["kinetic"]), strict=True))
    panels = [
        Panel(
            title, quantity, time, np.column_stack([course[kind] for kind in kinds]),
            tuple(names[kind] for kind in kinds), [colours[kind] for kind in kinds],
            log=True, levels=tuple(asked[kind] for kind in kinds),
        )
        for title, quantity, kinds in groups
    ]  # fmt: skip
    return draw(panels, events=events)


def work_channels(channels: Iterable[str]) -> dict[str, str]:
    """Effect -> name of the channel of its work, of the channels of a run."""
    names = (name for name in channels if name.startswith("effects/") and name.endswith("/work"))
    return {name.removeprefix("effects/").removesuffix("/work"): name for name in names}


def _work_panels(trajectory: Trajectory) -> list[Panel]:
    works = work_channels(trajectory.channels)
    if not works:
        return []
    time, values = decimate(trajectory, list(works.values()))
    colours = [family(number, 1)[0] for number in range(len(works))]
    return [Panel("Work done by each effect", "work [J]", time, values, tuple(works), colours)]


def _arm_panels(trajectory: Trajectory, quantity: str) -> list[Panel]:
    named = channels_of(trajectory.channels, quantity)
    channels = [trajectory.channels[name] for name in named.values()]
    lines = sum(len(channel.column_units) for channel in channels)
    points = min(POINTS, max(200, FIGURE_POINTS // max(1, lines)))
    panels = []
    for number, (arm, channel) in enumerate(zip(named, channels, strict=True)):
        time, values = decimate(trajectory, [channel.name], points=points)
        colours, labels = family(number, values.shape[1]), _short(_labels(channel))
        for unit in dict.fromkeys(channel.column_units):
            chosen = [i for i, other in enumerate(channel.column_units) if other == unit]
            shown, factor = _SHOWN[quantity, unit]
            panels.append(
                Panel(
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
