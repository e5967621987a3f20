"""What each unit contributes to a motion, and the unknown forces that this leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multiarm.events.complementarity.problem import Cone, Problem
from multiarm.events.complementarity.tolerances import MARGIN
from multiarm.events.complementarity.units import Bounded, Friction, Mode, Sliding

TIED = (Mode.SLIDING, Mode.LIMIT)
HELD = (Mode.CLOSED, Mode.STICKING, Mode.HOLDING, *TIED)


@dataclass(frozen=True)
class Part:
    """What one unit contributes: its mode, and the direction of slip that friction opposes."""

    mode: Mode
    direction: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Selection:
    """Forces, and what each unit does.

    Attributes
    ----------
    forces : ndarray, shape (m,)
        ``x``.
    parts : tuple of Part
        One for each unit.
    rows : tuple of int
        Rows to hold.
    bound : bool
        Whether bounds hold the forces back from what the rows alone would make them.
    """

    forces: np.ndarray
    parts: tuple[Part, ...]
    rows: tuple[int, ...]
    bound: bool = False


@dataclass(frozen=True)
class Column:
    """One unknown force: its entries in ``x``, the rows it keeps at rest, its bounds, its unit."""

    entries: tuple[tuple[int, float], ...]
    held: tuple[int, ...]
    lower: float
    upper: float
    unit: int


def columns_of(problem: Problem, parts: tuple[Part, ...]) -> list[Column]:
    """The unknown forces of all units that hold something."""
    columns = []
    for k, (unit, part) in enumerate(zip(problem.units, parts, strict=True)):
        if part.mode not in HELD:
            continue
        n, bounds = unit.row, (0.0, np.inf)
        if isinstance(unit, Bounded):
            bounds = (unit.lower, unit.upper)
        entries: tuple[tuple[int, float], ...] = ((n, 1.0),)
        if part.mode in TIED:
            assert isinstance(unit, (Sliding, Friction))
            pairs = zip(unit.tangents, part.direction, strict=True)
            entries += tuple((row, -unit.mu * s) for row, s in pairs)
        columns.append(Column(entries, (n,), *bounds, k))
        if part.mode == Mode.STICKING:
            assert isinstance(unit, Friction)
            for row in unit.tangents:
                columns.append(Column(((row, 1.0),), (row,), -np.inf, np.inf, k))
    return columns


def parts_of(problem: Problem, z: np.ndarray) -> tuple[Part, ...]:
    """Modes by the motion alone: whatever touches is held."""
    w, zero = problem.G @ z + problem.g, MARGIN * problem.size(z)
    cones = {cone.normal: cone for cone in problem.cones}
    parts = []
    for unit, k in zip(problem.units, problem.first, strict=True):
        if isinstance(unit, Bounded):
            parts.append(Part(_bounded_mode(w[k], problem.upper[k] - problem.lower[k], zero)))
        elif w[k] > zero:
            parts.append(Part(Mode.OPEN))
        elif isinstance(unit, Sliding):
            parts.append(Part(Mode.SLIDING, unit.direction))
        elif isinstance(unit, Friction):
            parts.append(_friction_part(cones[k], z, w, zero))
        else:
            parts.append(Part(Mode.CLOSED))
    return tuple(parts)


def _bounded_mode(rate: float, width: float, zero: float) -> Mode:
    if rate < -zero:
        return Mode.AT_UPPER
    return Mode.AT_LOWER if rate > zero or width <= 2.0 * zero else Mode.HOLDING


def _friction_part(cone: Cone, z: np.ndarray, w: np.ndarray, zero: float) -> Part:
    slip, friction = w[cone.tangents], -z[cone.tangents]
    if np.hypot(*slip) <= zero:
        return Part(Mode.CLOSED if cone.mu == 0.0 else Mode.STICKING)
    # the force knows the direction better, where there is one
    vector = friction if np.hypot(*friction) > zero else slip
    return Part(Mode.SLIDING, unit_vector(vector))


def unit_vector(vector: np.ndarray) -> tuple[float, float]:
    """Direction of a vector of two entries that is not zero."""
    length = np.hypot(*vector)
    return float(vector[0] / length), float(vector[1] / length)


def nothing_held(problem: Problem, z: np.ndarray) -> Selection:
    """Forces that are no solution: they are told as they are, and no row is held."""
    return Selection(problem.E @ z, parts_of(problem, z), ())


def modes_of(parts: tuple[Part, ...]) -> tuple[Mode, ...]:
    """The modes alone."""
    return tuple(part.mode for part in parts)
