"""Facts of a run as people read them: the same rows on the terminal and in the run's report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from multiarm.notation import count_of, number, numbers, value_text

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

SETTINGS = ("integrator", "stabilization", "solver", "arms", "accuracy", "tolerance")
"""Entries of a run's statistics that say how it was computed."""
COURSE = (
    "simulated_s", "steps", "rejected_steps", "evaluations", "wall_time_s", "compile_time_s",
    "realtime_factor",
)  # fmt: skip
"""Entries of a run's statistics that :func:`course_facts` shows, besides the settings."""


def figures_of(trajectory: Trajectory) -> dict[str, Any]:
    """The summary of a run, its settings, certificate and events."""
    statistics = trajectory.statistics
    return {
        **trajectory.summary(),
        **{key: statistics.get(key) for key in SETTINGS},
        "certificate": trajectory.certificate,
        "events": trajectory.events,
    }


def course_facts(figures: Mapping[str, Any], compilation: float) -> dict[str, str]:
    """How a run went, from :func:`figures_of`; kernels were compiled for a time [s]."""
    compiling = f"{number(compilation, 's')}, only the first time on this machine"
    return {
        "simulated": f"{number(figures['duration_s'], 's')}, "
        f"{count_of(figures['samples'], 'sample')}",
        "method": _method(figures),
        "steps": f"{_counted(figures['steps'])} ({_counted(figures['rejected_steps'])} rejected), "
        f"{_counted(figures['evaluations'], 'evaluation')}",
        "wall time": f"{number(figures['wall_time_s'], 's')}, "
        f"{number(figures['realtime_factor'])} x real time",
        **({"compiling kernels": compiling} if compilation > 0.0 else {}),
        "largest gap (position drift)": number(figures["position_drift_max_m"], "m"),
        "largest gap rate (velocity drift)": number(figures["velocity_drift_max_m_per_s"], "m/s"),
        "largest energy balance error": number(figures["energy_balance_max_J"], "J"),
    }


def motion_facts(figures: Mapping[str, Any]) -> dict[str, str]:
    """Where the objects are at the end of a run, and largest forces, from :func:`figures_of`."""
    from multiarm.results.channels import is_floor

    poses = figures["final_poses"]
    rows = {
        f"{name} at the end": numbers(pose["position"], "m")
        for name, pose in poses.items()
        if pose["position"] is not None
    }
    robots, wrenches = figures["arms"], figures["wrench_max"]
    for name, force in figures["contact_force_max_N"].items():
        wrench = wrenches.get(name)
        if wrench is None and wrenches:
            rows[f"largest forces, {name}"] = f"{number(force)} N or N m at joints that are held"
            continue
        of_robot = not isinstance(robots, Mapping) or name in robots or is_floor(name)
        # of other connections on the second body, which is one of several objects, too
        where = " on the object" if of_robot and len(poses) == 1 else ""
        rows[f"largest forces, {name}"] = _forces(wrench, force, where)
    return rows


def _counted(count: Any, noun: str = "") -> str:
    """A count with its noun; files of other programs may have anything in its place."""
    if isinstance(count, int):
        return count_of(count, noun) if noun else number(count)
    return f"{value_text(count)} {noun and noun + 's'}".rstrip()


def _method(figures: Mapping[str, Any]) -> str:
    tolerance = figures["tolerance"]
    steps = "" if tolerance is None else f" (tolerance of a step {number(tolerance)})"
    return (
        f"{figures['integrator']}{steps}, stabilization {figures['stabilization']}, "
        f"solver {figures['solver']}, {_arms(figures['arms'])}"
    )


def _arms(backends: Any) -> str:
    """The backend of the arms; results of earlier versions do not name it."""
    if not isinstance(backends, Mapping) or not backends:
        return "arms pinocchio"
    kinds = sorted({str(kind) for kind in backends.values()})
    if len(kinds) == 1:
        return f"arms {kinds[0]}"
    return "arms " + ", ".join(f"{name} {kind}" for name, kind in backends.items())


def _forces(wrench: Mapping[str, Any] | None, contact_force: float | None, where: str) -> str:
    """The largest force and moment, and the largest force of a contact."""
    at_contact = f"{number(contact_force, 'N')} at a contact"
    if wrench is None:  # a result of an earlier version
        return f"{at_contact} (the wrench on the object was not recorded)"
    force, moment = (
        f"{number(wrench[what], unit)} at {number(wrench[when], 's')}"
        for what, unit, when in (
            ("force_N", "N", "force_time_s"),
            ("moment_N_m", "N m", "moment_time_s"),
        )
    )
    return f"{force} and {moment}{where}; {at_contact}"
