"""Loads from outside: drag of objects, and wrenches on them or on links of the arms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, model_validator
from typing_extensions import Self

from multiarm.notation import count_of
from multiarm.scene.bodies import BodyName, object_named
from multiarm.scene.code import UserFunction
from multiarm.scene.effects.kind import EffectKind, OfObjects
from multiarm.scene.faults import Faults, invalid, listed, shown, unknown
from multiarm.scene.joint_values import KnownRobots, unknown_robot
from multiarm.scene.spec import FilePath, Spec
from multiarm.scene.values import BodyAxes, NonNegative, Number, Positive, Vec3, list_of

if TYPE_CHECKING:
    from multiarm.scene.object import ObjectSpec

_TABLE_COLUMNS = ("t", "fx", "fy", "fz", "mx", "my", "mz")  # [s], [N], [N m]


class Drag(OfObjects):
    """Resistance of the medium that objects move through.

    Along each axis of the object, with u its velocity relative to the medium and |u| its size,
    force = -(linear + (quadratic + density coefficient area / 2) |u|) u; about each axis,
    torque = -angular times the angular velocity.
    """

    name = "drag"
    picture = "air or water: the object is slowed down as it moves through it, or blown by wind"
    example = "effects: {drag: {linear: 0.4, quadratic: 0.5}}  # [N s/m], [N s^2/m^2]"

    linear: BodyAxes = (0.0, 0.0, 0.0)
    """[N s/m], for all axes of the object or one for each."""
    angular: BodyAxes = (0.0, 0.0, 0.0)
    """[N m s/rad]."""
    quadratic: BodyAxes = (0.0, 0.0, 0.0)
    """[N s^2/m^2]."""
    area: BodyAxes | None = None
    """Cross-section seen along each axis [m^2]; goes with ``coefficient``."""
    coefficient: BodyAxes | None = None
    """Drag coefficient."""
    density: Positive = 1.225
    """Of the medium [kg/m^3]; 1.225 is that of air."""
    wind: Vec3 = (0.0, 0.0, 0.0)
    """Velocity of the medium [m/s], world axes."""

    @model_validator(mode="after")
    def _something_resists(self) -> Self:
        if (self.area is None) != (self.coefficient is None):
            present, missing = ("area", "coefficient")[:: 1 if self.coefficient is None else -1]
            raise invalid(
                f"{present!r} needs {missing!r} too: force = density coefficient area u^2/2"
            )
        if self.area is None and not any((*self.linear, *self.angular, *self.quadratic)):
            raise invalid(
                "resists nothing; give 'linear', 'angular', 'quadratic', or 'area' and "
                "'coefficient', or leave the effect out"
            )
        return self

    def per_axis(self) -> tuple[float, float, float]:
        """Coefficients of |u| u, for each axis of the object [N s^2/m^2]."""
        area, coefficient = self.area or (0.0,) * 3, self.coefficient or (0.0,) * 3
        x, y, z = (
            q + 0.5 * self.density * a * c
            for q, a, c in zip(self.quadratic, area, coefficient, strict=True)
        )
        return x, y, z

    @classmethod
    def typical(cls, body: ObjectSpec) -> Mapping[str, Any] | None:
        """Drag in air, of a blunt body with the faces of the box around the object."""
        solid = body.shape.solid
        box = None if solid is None or body.shape.mesh is not None else solid.bounding_box()
        if box is None:
            return None
        x, y, z = (2.0 * np.max(np.abs(box), axis=0)).tolist()
        return {"area": [y * z, z * x, x * y], "coefficient": 1.0}


class Sinusoid(Spec):
    """The factor sin(2 pi frequency t + phase)."""

    frequency: Positive
    """Of the sine [Hz]."""
    phase: Number = 0.0
    """[rad]"""


class Pulse(Spec):
    """The factor 1 from ``begin`` to ``end`` [s], else 0."""

    begin: NonNegative
    """Time at which it begins [s]."""
    end: Positive
    """Time at which it ends [s]."""

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> Self:
        if not self.begin < self.end:
            raise invalid(f"ends at {self.end:g} s, not after its beginning at {self.begin:g} s")
        return self


def _increasing(times: tuple[float, ...]) -> tuple[float, ...]:
    message = _time_fault(times)
    if message:
        raise invalid(message)
    return times


def _time_fault(times: tuple[float, ...]) -> str:
    """The fault of the times of a table; empty if there is none."""
    if len(times) < 2:
        return f"a table needs at least 2 times, got {len(times)}"
    for number, (before, after) in enumerate(pairwise(times), start=2):
        if not after > before:
            return f"times must increase, but row {number} has {after:g} s after {before:g} s"
    return ""


Numbers = Annotated[tuple[Number, ...], list_of("must be a list of numbers")]


class WrenchTable(Spec):
    """Values over time, interpolated smoothly and without overshoot (PCHIP); zero outside."""

    times: Annotated[Numbers, AfterValidator(_increasing)] | None = None
    """[s], increasing."""
    values: Numbers | None = None
    """Factors on ``force`` and ``torque``, one for each time."""
    file: FilePath | None = None
    """Instead of these: a CSV file with the columns t, fx, fy, fz, mx, my, mz ([s], [N], [N m]),
    which is the wrench itself."""

    @model_validator(mode="after")
    def _one_table(self) -> Self:
        written = (self.times, self.values)
        if self.file is not None and written != (None, None):
            raise invalid("gives both 'file' and 'times' or 'values'; keep one of them")
        if self.file is not None:
            return self
        if self.times is None or self.values is None:
            raise invalid("needs 'times' and 'values', or a 'file'")
        if len(self.times) != len(self.values):
            times, values = count_of(len(self.times), "time"), count_of(len(self.values), "value")
            raise invalid(f"has {times} and {values}; give as many")
        return self


def read_wrench_table(path: Path) -> tuple[list[list[float]], str]:
    """Rows of a CSV file of wrenches, 7 numbers each, and its faults."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return [], f"no file at {path}"
    except UnicodeDecodeError:
        return [], f"{path} is not a text file"
    except OSError as error:
        return [], f"cannot read {path}: {error.strerror or error}"
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or (number == 1 and tuple(cells) == _TABLE_COLUMNS):
            continue
        message = _row_fault(cells)
        if message:
            return [], f"{path}, line {number}: {message}"
        rows.append([float(cell) for cell in cells])
    message = _time_fault(tuple(row[0] for row in rows))
    return (rows, "") if not message else ([], f"{path}: {message}")


def _row_fault(cells: list[str]) -> str:
    if len(cells) != len(_TABLE_COLUMNS):
        return f"has {count_of(len(cells), 'column')}; they are {', '.join(_TABLE_COLUMNS)}"
    for name, cell in zip(_TABLE_COLUMNS, cells, strict=True):
        try:
            finite = math.isfinite(float(cell))
        except ValueError:
            finite = False
        if not finite:
            return f"{name} must be a finite number, got {shown(cell)}"
    return ""


def _some(wrenches: tuple) -> tuple:
    if not wrenches:
        raise invalid("is empty; list wrenches, such as (on: object, force: [0, 0, -1])")
    return wrenches


class ExternalWrench(EffectKind):
    """A force and a torque from outside, at a point of an object or of a link.

    Constant, or times a factor: at most one of ``sinusoid``, ``pulse``, ``table``, ``function``.
    """

    name = "external_wrenches"
    picture = "somebody pushes the object or an arm: once, in a rhythm, or as a table says"
    example = """
effects:
  external_wrenches:
    - {on: object, force: [0, 0, 5], sinusoid: {frequency: 2}}   # [N], [Hz]"""

    on: str
    """Its target: 'object', or an object by its name, or 'arm/link', of robots 'robot/link': a link
    of the robot's URDF or of its tool's."""
    at: Vec3 = (0.0, 0.0, 0.0)
    """The point where the force acts, in the frame of the object or of the link [m]."""
    axes: Literal["world", "body"] = "world"
    """Axes of force and torque: the world's, or those of the object or link."""
    force: Vec3 | None = None
    """[N]"""
    torque: Vec3 | None = None
    """[N m]"""
    sinusoid: Sinusoid | None = None
    """Times sin(2 pi frequency t + phase)."""
    pulse: Pulse | None = None
    """From ``begin`` to ``end`` only."""
    table: WrenchTable | None = None
    """Times interpolated values, or the wrench itself from a file."""
    function: UserFunction | None = None
    """f(t, state) -> 6 numbers, the force [N] and torque [N m]: a Python function, or its name as
    'file.py:name' or 'package.module:name'."""

    @model_validator(mode="after")
    def _one_time_course(self) -> Self:
        courses = ("sinusoid", "pulse", "table", "function")
        present = [name for name in courses if getattr(self, name) is not None]
        if len(present) > 1:
            raise invalid(f"gives {' and '.join(map(repr, present))}; keep one of them")
        gives_wrench = self.function is not None or (self.table is not None and self.table.file)
        sized = [name for name in ("force", "torque") if getattr(self, name) is not None]
        if gives_wrench and sized:
            source = "function" if self.function is not None else "file of the table"
            raise invalid(f"the {source} gives force and torque; remove {listed(sized)}")
        if not gives_wrench and not sized:
            raise invalid("needs 'force', 'torque' or both (3 numbers each)")
        return self

    @classmethod
    def entry(cls) -> Any:
        """A list of wrenches."""
        return Annotated[tuple[ExternalWrench, ...], AfterValidator(_some)]

    @classmethod
    def meaning(cls) -> str:
        """About all of the list."""
        return "Forces and torques from outside, on the object or on links."

    @property
    def target(self) -> BodyName:
        """The object, or the link of an arm or robot, that it acts on."""
        arm, slash, link = self.on.partition("/")
        return BodyName(arm, link) if slash and arm else object_named(self.on)

    def faults(self, arms: KnownRobots) -> Faults:
        """Faults with respect to the arms, and faults of the file."""
        faults: Faults = []
        target = self._target_fault(arms)
        if target:
            faults.append((("on",), target))
        if self.table is not None and self.table.file is not None:
            in_file = read_wrench_table(self.table.file)[1]
            faults += [(("table", "file"), in_file)] if in_file else []
        return faults

    def _target_fault(self, arms: KnownRobots) -> str:
        arm, link = self.target.robot, self.target.tip
        if not (arm and link):
            if self.on in arms.objects:
                return ""
            objects = ", ".join(map(repr, arms.objects))
            return f"must be {objects} or 'arm/link', got {shown(self.on)}"
        if arm not in arms:
            return unknown_robot(arm, arms)
        known = arms[arm]
        if known.links is None or link in known.moving:
            return ""
        if link not in known.links:
            return unknown("link", link, known.moving, command=known.shown_by)
        return f"link {link!r} does not move; links that do are {listed(known.moving)}"
