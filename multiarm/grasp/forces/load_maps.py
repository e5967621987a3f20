r"""Loads that contacts of limited force can carry: the worst of some loads, multiples, a map.

With forces :math:`0 \le \lambda \le \lambda_{\max}` the contacts exert the wrenches of a convex
polytope, :math:`\{W \lambda\}`.  Three questions about it (conventions of
:mod:`multiarm.grasp.forces.force_distribution`):

- the largest force that a set of loads calls for.  It is a convex function of the load, so that the
  worst of finitely many loads is the worst of all their mixtures;
- the largest multiple of each load that can be exerted;
- the section of the polytope with a plane of loads, :math:`w_0 + x d_1 + y d_2`: a polygon.  A
  linear program yields the point farthest in a direction; repeated along the outward normal of
  every known edge, until no edge moves outward, it yields all corners (exact except for rounding).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import numbers_of
from multiarm.grasp.contacts import Contacts, HeldByContacts, as_contacts
from multiarm.grasp.forces.force_distribution import (
    ForceDistribution,
    bounds_of,
    distribute_forces,
    wrench_of,
)
from multiarm.programs import linear_program

if TYPE_CHECKING:
    from shapely.geometry import LineString, Point, Polygon


@dataclass(frozen=True, eq=False)
class WorstForce:
    """The load of a set that calls for the largest force.

    Attributes
    ----------
    force : float
        The largest force of any contact for any of the loads and their mixtures [N]; infinite if
        one of the loads cannot be exerted.
    load : int
        Which load it is, from 0.
    distributions : tuple of ForceDistribution
        Those of all loads.
    """

    force: float
    load: int
    distributions: tuple[ForceDistribution, ...]


@dataclass(frozen=True, eq=False)
class LoadCapacity:
    """How much of each load the contacts can exert.

    Attributes
    ----------
    multiples : ndarray, shape (M,)
        The largest s such that ``s`` times the load can be exerted.
    weakest : int
        The load with the smallest one, from 0.
    """

    multiples: np.ndarray
    weakest: int


def worst_force(
    contacts: Contacts | HeldByContacts, wrenches: Any, *, minimum: Any = 0.0, limit: Any = None
) -> WorstForce:
    """The largest force that any of the loads, or any mixture of them, calls for.

    Parameters
    ----------
    contacts : Contacts, or a grasp
    wrenches : array-like, shape (M, 6); (M, 3) in the plane
        Loads that the contacts exert on the body, about the frame's origin [N, N m].
    minimum, limit
        Bounds of each force [N], as in :func:`distribute_forces`.

    Raises
    ------
    GraspError
        No loads, or numbers of the wrong kind.
    """
    contacts, loads = as_contacts(contacts), _listed(wrenches)
    if not loads:
        raise GraspError("the worst of no loads is none: give at least one wrench")
    distributions = tuple(
        distribute_forces(contacts, w, minimum=minimum, limit=limit) for w in loads
    )
    load = int(np.argmax([distribution.value for distribution in distributions]))
    return WorstForce(distributions[load].value, load, distributions)


def load_capacity(contacts: Contacts | HeldByContacts, wrenches: Any, limit: Any) -> LoadCapacity:
    """The largest multiple of each load that the contacts can exert with limited forces.

    Parameters
    ----------
    contacts : Contacts, or a grasp
    wrenches : array-like, shape (M, 6); (M, 3) in the plane
        Loads, about the frame's origin [N, N m]; not zero.
    limit : float or array-like, shape (N,)
        Largest push of each contact [N].

    Raises
    ------
    GraspError
        No loads, a load of zero, or numbers of the wrong kind.
    """
    contacts = as_contacts(contacts)
    loads = [wrench_of(contacts, w) for w in _listed(wrenches)]
    if not loads:
        raise GraspError("the capacity for no loads is none: give at least one wrench")
    multiples = []
    for number, load in enumerate(loads):
        size = float(np.linalg.norm(load))
        if size == 0.0:
            raise GraspError(f"load {number + 1} is zero: every multiple of it can be exerted")
        program = _Exerted(contacts, limit, np.zeros(len(load)), load[None] / size)
        farthest = program.farthest(np.ones(1))
        assert farthest is not None  # no forces at all exert the multiple 0
        multiples.append(max(float(farthest[0]), 0.0) * program.unit / size)
    return LoadCapacity(np.array(multiples) + 0.0, int(np.argmin(multiples)))  # no -0


def liftable(
    contacts: Contacts | HeldByContacts,
    limit: Any,
    wrench: Any,
    directions: Any,
    *,
    minimum: Any = 0.0,
) -> LiftableMap:
    """The loads of a plane that the contacts can exert with limited forces.

    Parameters
    ----------
    contacts : Contacts, or a grasp
    limit : float or array-like, shape (N,)
        Largest push of each contact [N].
    wrench : array-like, shape (6,); (3,) in the plane
        ``w_0``: the load at (0, 0), about the frame's origin [N, N m].
    directions : array-like, shape (2, 6) or (2, 3)
        ``d_1`` and ``d_2``: the loads of unit x and y.
    minimum : float or array-like, shape (N,)
        Least push of each contact [N].

    Raises
    ------
    GraspError
        Two directions that are parallel, a limit that is infinite, numbers of the wrong kind.
    """
    contacts, axes = as_contacts(contacts), _listed(directions)
    if len(axes) != 2:
        raise GraspError(f"a map has two directions of wrenches, not {len(axes)}")
    rows = np.array([wrench_of(contacts, direction) for direction in axes])
    sizes = np.linalg.norm(rows, axis=1)
    if not sizes.all():
        raise GraspError("a direction of the map is zero: it adds nothing to the load")
    rows = rows / sizes[:, None]
    if np.linalg.svd(rows, compute_uv=False)[-1] <= CORNER:
        raise GraspError("the two directions of the map are parallel: they span no plane of loads")
    program = _Exerted(contacts, limit, wrench_of(contacts, wrench), rows, minimum)
    return LiftableMap(_polygon(program) * program.unit / sizes + 0.0)  # no -0


def _listed(wrenches: Any) -> list[Any]:
    try:
        return list(wrenches)
    except TypeError as error:
        raise GraspError(f"several wrenches are a list of them, not {wrenches!r}") from error


class _Exerted:
    """Linear programs over the loads ``start + x rows`` that bounded forces exert.

    Forces are in units of the largest limit.
    """

    def __init__(
        self,
        contacts: Contacts,
        limit: Any,
        start: np.ndarray,
        rows: np.ndarray,
        minimum: Any = 0.0,
    ) -> None:
        least, most = bounds_of(contacts, minimum, limit)
        if limit is None or not np.all(np.isfinite(most)):
            raise GraspError("without a limit of the forces, the loads have none; give a limit [N]")
        self.unit = float(most.max())
        if self.unit == 0.0:
            raise GraspError("with a limit of 0 N no contact pushes; give a positive limit [N]")
        self.equations = np.hstack([contacts.scaled_wrenches, -rows.T])
        self.start = start / self.unit
        self.bounds = np.column_stack([least, most]) / self.unit

    def farthest(self, direction: np.ndarray) -> np.ndarray | None:
        """The point x farthest in a direction; None when no load can be exerted."""
        size = len(direction)
        solved = linear_program(
            np.concatenate([np.zeros(self.equations.shape[1] - size), -direction]),
            equal=(self.equations, self.start),
            bounds=self.bounds,
            signed=size,
        )
        if solved.infeasible:
            return None
        if solved.x is None:
            raise GraspError(f"the linear program for the load ended with {solved.message!r}")
        return solved.x[-size:]


def _polygon(program: _Exerted) -> np.ndarray:
    """Corners of a section, counter-clockwise, shape (K, 2)."""
    for axis in np.eye(2):
        first, last = program.farthest(-axis), program.farthest(axis)
        if first is None or last is None:
            return np.empty((0, 2))
        if _apart(first, last):
            corners = [*_between(program, first, last), *_between(program, last, first)]
            return _without_straight(np.array(corners))
    return np.array([first])


def _between(program: _Exerted, a: np.ndarray, b: np.ndarray) -> list[np.ndarray]:
    """The corners from a to b, without b, on the right of the way from a to b."""
    way = b - a
    outward = np.array([way[1], -way[0]]) / np.linalg.norm(way)
    beyond = program.farthest(outward)
    if beyond is None or outward @ (beyond - a) <= CORNER * max(1.0, float(np.abs(beyond).max())):
        return [a]
    return _between(program, a, beyond) + _between(program, beyond, b)


def _apart(p: np.ndarray, q: np.ndarray) -> bool:
    return bool(np.abs(p - q).max() > CORNER * max(1.0, float(np.abs(p).max())))


def _without_straight(corners: np.ndarray) -> np.ndarray:
    """Leave out corners at which the way goes straight on."""
    if len(corners) < 3:
        return corners
    before, after = corners - np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0) - corners
    turns = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return corners[np.abs(turns) > CORNER * sizes]


# --- The map of a plane of loads ------------------------------------------------------------------

# An edge that moves outward by less than this part of the map's size is final.
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

    @cached_property
    def shape(self) -> Polygon | LineString | Point:
        """The map as a polygon of shapely; a line or a point where it has no area."""
        from shapely.geometry import MultiPoint

        return MultiPoint(self.vertices).convex_hull

    @property
    def area(self) -> float:
        """Area of the polygon."""
        return float(self.shape.area)

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
        from shapely.geometry import Point

        at = _pair(point)
        if not self:
            return False
        slack = CORNER * float(np.abs(self.vertices).max())
        return bool(self.shape.distance(Point(at)) <= slack)

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
        a, b = self.vertices, np.roll(self.vertices, -1, axis=0)
        outward = np.column_stack([(b - a)[:, 1], (a - b)[:, 0]])
        speeds, rooms = outward @ along, np.sum(outward * a, axis=1)
        ahead = speeds > 0.0
        return max(float(np.min(rooms[ahead] / speeds[ahead])), 0.0)

    def _distance(self, point: np.ndarray) -> float:
        """Distance of a point from the edge."""
        from shapely.geometry import Point

        edge = self.shape.boundary if len(self.vertices) > 2 else self.shape
        return float(edge.distance(Point(point)))


def _pair(values: Any) -> np.ndarray:
    """Coordinates (x, y) in the map."""
    return numbers_of(values, "a place in the map is two finite numbers (x, y)", (2,))
