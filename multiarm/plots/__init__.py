"""Figures of a run: motion, forces, energy and accuracy.

Each function takes a trajectory and returns a matplotlib `Figure` without a window; save it with
`figure.savefig`. A joint, and a contact, has the same colour and dashes in the panels of all arms.
Events are thin vertical lines, one style for each family, explained below the axes.

A line has some thousand points at most, however long the run (see `decimation`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from multiarm.plots.limit_figure import limit_use
from multiarm.plots.run_figures import (
    accuracy_course,
    contact_forces,
    contact_states,
    drift,
    energy,
    joint_positions,
    joint_torques,
    object_pose,
    wrenches,
)
from multiarm.results.channels import object_paths

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multiarm.results.trajectory import Trajectory

__all__ = [
    "accuracy_course",
    "contact_forces",
    "contact_states",
    "drift",
    "energy",
    "figures",
    "joint_positions",
    "joint_torques",
    "limit_use",
    "object_pose",
    "wrenches",
]


def figures(trajectory: Trajectory) -> dict[str, Figure]:
    """All figures of a run by title, the motion first."""
    several = len(object_paths(trajectory.channels)) > 1
    drawn = {
        "Objects" if several else "Object": object_pose(trajectory),
        "Joint positions": joint_positions(trajectory),
        "Joint torques": joint_torques(trajectory),
        "Joint limits": limit_use(trajectory),
        "Wrenches": wrenches(trajectory),
        "Contact forces": contact_forces(trajectory),
        "Contact states": contact_states(trajectory),
        "Energy": energy(trajectory),
        "Drift": drift(trajectory),
    }
    return {title: figure for title, figure in drawn.items() if figure is not None}
