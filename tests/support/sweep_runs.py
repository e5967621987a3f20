"""What tests of many runs share: a cheap sweep, functions that kill, rows but for clocks."""

from __future__ import annotations

MASS, LIFT, GRIP = "object.mass", "arms.left.base.xyz[2]", "joints[0].at"
OVER = {MASS: [5.0, 10.0, 20.0], LIFT: {"uniform": [-1e-3, 1e-3]}}
RUN = {"duration": 0.02, "arms": "compiled"}
KEEP = ["final_x", "final_z", "largest_contact_force", "energy_balance", "estimated_error"]
FUNCTIONS = """
import os
import signal
from pathlib import Path

HERE = Path(__file__).parent

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def once(trajectory):
    mark = HERE / "died"
    if trajectory.scene.object.mass == 20.0 and not mark.exists():
        mark.touch()
        die()
    return 1.0

def always(trajectory):
    if trajectory.scene.object.mass == 10.0:
        die()
    return 1.0
"""
MEASURED = ["wall_time", "worker"]


def jobs_of(plan, runs=None):
    """Number and values of all runs, or of some."""
    numbers = range(1, plan.spec.count + 1) if runs is None else runs
    return [(number, plan.spec.values(number)) for number in numbers]


def same(row):
    """What of a row can be repeated."""
    return {**row, "wall_time": 0.0, "worker": ""}


def repeatable(rows):
    """Rows by their runs, without what is measured; every run once."""
    rows = list(rows)
    assert len({row["run"] for row in rows}) == len(rows)
    assert all(row["wall_time"] >= 0.0 for row in rows)
    return sorted(map(same, rows), key=lambda row: row["run"])


def statuses(rows):
    return {row["run"]: (row["status"], row["message"]) for row in rows}
