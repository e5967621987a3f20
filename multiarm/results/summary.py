"""A run in a few numbers, read in blocks, so that memory does not grow with its length."""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.results.channels import channels_of, named_object_paths
from multiarm.results.energy import largest_imbalance
from multiarm.results.limit_use import limit_summary
from multiarm.results.outcome import plain
from multiarm.results.recorded_run import RecordedRun

POSE = ("position", "quaternion_xyzw")
"""What a summary has of an object."""


def summarise(run: RecordedRun) -> dict[str, Any]:
    """What `Trajectory.summary` returns."""
    counted = (
        "steps", "rejected_steps", "evaluations", "wall_time_s", "compile_time_s",
        "realtime_factor", "error_estimate",
    )  # fmt: skip
    forces, wrenches = (
        channels_of(run.channels, quantity) for quantity in ("contact_force", "wrench")
    )
    statistics, poses = run.statistics, _final_poses(run)
    only = next(iter(poses.values())) if len(poses) == 1 else dict.fromkeys(POSE)
    return {
        "status": run.status,
        "message": run.message,
        "samples": len(run),
        "duration_s": _duration(run),
        **{key: plain(statistics.get(key)) for key in counted},
        "position_drift_max_m": _largest(run, "drift/position"),
        "velocity_drift_max_m_per_s": _largest(run, "drift/velocity"),
        "energy_balance_max_J": largest_imbalance(run).value if len(run) else None,
        **{f"final_object_{part}": only[part] for part in POSE},
        "final_poses": poses,
        "contact_force_max_N": {arm: _largest(run, name) for arm, name in forces.items()},
        "limit_use": limit_summary(run),
        "wrench_max": {arm: _largest_wrench(run, name) for arm, name in wrenches.items()},
        "rank_lowest": plain(statistics.get("lowest_rank")),
        "rank_highest": plain(statistics.get("highest_rank")),
        "coupled_steps": plain(statistics.get("coupled_steps")),
    }


def _final_poses(run: RecordedRun) -> dict[str, dict[str, list[float] | None]]:
    """Object -> its position [m] and its quaternion xyzw at the last sample; None without any."""
    paths = named_object_paths(run.channels, run.provenance)
    return {
        name: {part: _last(run, f"{path}/{part}") for part in POSE} for name, path in paths.items()
    }


def _duration(run: RecordedRun) -> float | None:
    if not len(run):
        return None
    return float(run.read("time", len(run) - 1)[0] - run.read("time", 0, 1)[0])


def _last(run: RecordedRun, name: str) -> list[float] | None:
    return run.read(name, len(run) - 1)[0].tolist() if len(run) else None


def _largest(run: RecordedRun, name: str) -> float | None:
    """The largest magnitude of a channel's numbers."""
    peaks = [np.abs(values).max() for (values,) in run.blocks(name) if values.size]
    return float(max(peaks)) if peaks else None


def _largest_wrench(run: RecordedRun, name: str) -> dict[str, float | None]:
    """The largest force and moment of a channel of wrenches, and their times."""
    force, force_time = _longest(run, name, slice(0, 3))
    moment, moment_time = _longest(run, name, slice(3, 6))
    return {
        "force_N": force,
        "force_time_s": force_time,
        "moment_N_m": moment,
        "moment_time_s": moment_time,
    }


def _longest(run: RecordedRun, name: str, part: slice) -> tuple[float | None, float | None]:
    """The largest length of a vector in a channel, and its time [s]."""
    longest, when = -1.0, 0.0
    for time, values in run.blocks("time", name):
        with np.errstate(over="ignore"):
            lengths = np.hypot.reduce(values[:, part], axis=1)  # without overflow of squares
        k = int(lengths.argmax())
        if lengths[k] > longest:
            longest, when = float(lengths[k]), float(time[k])
    return (plain(longest), when) if len(run) else (None, None)
