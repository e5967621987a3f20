"""Figure of a run's joint limits: bars for the largest shares of effort, speed and range."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multiarm.plots.style import BLUE, GRID, INK, RED, STYLE
from multiarm.results.limit_use import QUANTITIES, ROUNDED_SHARE, JointUse, joint_uses
from multiarm.results.trajectory import Trajectory

ROW, EDGES = 0.2, 0.9
"""Heights of a joint's row, and of title and axis together [in]."""
LETTER = 0.066
"""Width of a letter of a joint's name [in]."""
WIDTH = 9.6
MOST_JOINTS = 64
"""Joints in the figure; of more, those that use most."""


def limit_use(trajectory: Trajectory) -> Figure | None:
    """A row for each joint, with its largest shares; None where no limit is known."""
    uses = [use for use in joint_uses(trajectory) if _most(use) is not None]
    if not uses:
        return None
    shown = sorted(uses, key=lambda use: -(_most(use) or 0.0))[:MOST_JOINTS]
    shown = [use for use in uses if use in shown]
    left = LETTER * max(len(use.joint) for use in shown) + 0.3
    with matplotlib.rc_context(STYLE):
        height = ROW * len(shown) + EDGES
        figure = Figure((WIDTH, height))
        figure.subplots_adjust(
            left=left / WIDTH, right=0.98, bottom=0.5 / height, top=1.0 - 0.3 / height, wspace=0.08
        )
        columns = figure.subplots(1, len(QUANTITIES), sharey=True, squeeze=False)[0]
        for axes, quantity in zip(columns, QUANTITIES, strict=True):
            _draw(axes, quantity, shown)
        columns[0].set_yticks(range(len(shown)), [use.joint for use in shown], parse_math=False)
        columns[0].set_ylim(len(shown) - 0.5, -0.5)
        if len(uses) > len(shown):
            columns[0].set_title(f"Effort; {len(uses) - len(shown)} joints use less than these")
    return figure


def _most(use: JointUse) -> float | None:
    shares = (use.effort, use.speed, use.range)
    return max((share.value for share in shares if share is not None), default=None)


def _draw(axes: Axes, quantity: str, uses: list[JointUse]) -> None:
    shares = [getattr(use, quantity) for use in uses]
    values = np.array([0.0 if share is None else 100.0 * share.value for share in shares])
    beyond = values > 100.0 * (1.0 + ROUNDED_SHARE)
    axes.set_title(quantity.capitalize())
    axes.barh(
        range(len(uses)), values, height=0.62, color=[RED if over else BLUE for over in beyond]
    )
    axes.axvline(100.0, color=INK, linewidth=1.0, linestyle="--")
    axes.set_xlim(0.0, 1.05 * max(100.0, values.max()))
    axes.set_xlabel("share of the limit [%]")
    axes.tick_params(axis="y", length=0)
    axes.set_axisbelow(True)
    axes.grid(False, axis="y")
    axes.grid(True, axis="x", color=GRID)
    for row, share in enumerate(shares):
        if share is None:
            axes.text(1.0, row, "no limit", va="center", fontsize=7, color=INK, alpha=0.6)
