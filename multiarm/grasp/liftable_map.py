r"""The loads of a plane that contacts can exert: a convex polygon and its queries.

The loads are :math:`w_0 + x d_1 + y d_2`, the polygon is in (x, y).  The algorithm is in
:mod:`multiarm.grasp.load_maps`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.errors import GraspError

# Part of the map's size by which an edge may give way and still count as found.
CORNER = 1e-8


@dataclass(frozen=True, eq=False)
class LiftableMap:
    """The loads ``w_0 + x d_1 + y d_2`` that can be exerted; its truth value says whether any can.

    Attributes
    ----------
    vertices : ndarray, shape (K, 2)
        Corners (x, y) of a convex polygon, counter-clockwise, in units of the directions; one or
        two points where it has no area, none where nothing can be exerted.
    """

    vertices: np.ndarray

    def __bool__(self) -> bool:
        return len(self.vertices) > 0

    @property
    def area(self) -> float:
        """Area of the polygon."""
        x, y = self.vertices.T
        return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))

    @property
    def margin(self) -> float:
        """How far (x, y) may be from (0, 0) in any direction; negative when ``w_0`` is outside.

        The distance of (0, 0) from the polygon's edge, with a minus sign outside; minus infinity
        where nothing can be exerted.
        """
        if not self:
            return -np.inf
        nearest = self._distance(np.zeros(2))
        return nearest if self.contains((0.0, 0.0)) else 0.0 - nearest

    def contains(self, point: Any) -> bool:
        """Whether the load at (x, y) can be exerted; the edge belongs to the map.

        Raises
        ------
        GraspError
            Something else than two finite numbers.
        """
        at = _pair(point)
        if not self:
            return False
        on_edge = self._distance(at) <= CORNER * float(np.abs(self.vertices).max())
        a, b = self._edges()
        sides, arms = b - a, at - a
        turns = sides[:, 0] * arms[:, 1] - sides[:, 1] * arms[:, 0]
        return on_edge or bool(np.all(turns > 0.0))

    def reach(self, direction: Any) -> float:
        """The largest s such that ``s`` times a direction (x, y) is in the map.

        0 when (0, 0) is outside, and when the map has no area.

        Raises
        ------
        GraspError
            Something else than two finite numbers, or both are 0.
        """
        along = _pair(direction)
        if not along.any():
            raise GraspError("the direction (0, 0) leads nowhere: every multiple of it is the same")
        if len(self.vertices) < 3 or not self.contains((0.0, 0.0)):
            return 0.0
        a, b = self._edges()
        outward = np.column_stack([(b - a)[:, 1], (a - b)[:, 0]])
        speeds, rooms = outward @ along, np.sum(outward * a, axis=1)
        ahead = speeds > 0.0
        return max(float(np.min(rooms[ahead] / speeds[ahead])), 0.0)

    def _edges(self) -> tuple[np.ndarray, np.ndarray]:
        return self.vertices, np.roll(self.vertices, -1, axis=0)

    def _distance(self, point: np.ndarray) -> float:
        """Distance of a point from the edge."""
        a, b = self._edges()
        ways, arms = b - a, point - a
        lengths = np.sum(ways**2, axis=1)
        shares = np.sum(arms * ways, axis=1) / np.where(lengths > 0.0, lengths, 1.0)
        return float(np.linalg.norm(arms - np.clip(shares, 0.0, 1.0)[:, None] * ways, axis=1).min())


def _pair(values: Any) -> np.ndarray:
    """Coordinates (x, y) in the map."""
    try:
        pair = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise GraspError(f"a place in the map is two numbers (x, y), not {values!r}") from error
    if pair.shape != (2,) or not np.all(np.isfinite(pair)):
        raise GraspError(f"a place in the map is two finite numbers (x, y), not {values!r}")
    return pair
