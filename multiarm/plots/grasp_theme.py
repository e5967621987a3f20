"""Colours of the pictures of grasps, for light and for dark pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.path import Path

from multiarm.plots.style import GRID, INK, STYLE, family


@dataclass(frozen=True)
class Theme:
    """Colours of paper, ink, thin lines, a face and a region."""

    paper: str
    ink: str
    grid: str
    face: str
    region: str

    @property
    def style(self) -> dict[Any, Any]:
        """Settings of matplotlib."""
        inked = [key for key in STYLE if str(STYLE[key]) == INK]
        own = dict.fromkeys(inked, self.ink) | {"axes.grid": False}
        return STYLE | own | {"figure.facecolor": self.paper, "savefig.facecolor": self.paper}


LIGHT = Theme("#ffffff", INK, GRID, "#8fa3b8", "#2f9e67")
DARK = Theme("#151a21", "#e4e8ee", "#3a4450", "#6f87a0", "#46c98b")


def colours_of(count: int, grippers: Sequence[Sequence[int]]) -> list[str]:
    """A colour for each contact: that of its gripper."""
    colours = [family(0, 1)[0]] * count
    for k, numbers in enumerate(grippers):
        for j in numbers:
            if j < count:  # the last contact is not yet among those of a region
                colours[j] = family(k, 1)[0]
    return colours


def path_of(outline: np.ndarray, holes: Sequence[np.ndarray]) -> Path:
    """A path around a polygon (K, 2) and its holes."""
    rings = [Path(np.vstack([ring, ring[:1]]), closed=True) for ring in (outline, *holes)]
    return Path.make_compound_path(*rings)
