"""Loads from outside: drag of the object, and wrenches on it or on links of the arms."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec, absolute
from multiarm.scene.functions import UserFunction, located_function
from multiarm.scene.per_axis import axis_numbers
from multiarm.scene.per_joint import Faults, KnownArm
from multiarm.scene.values import NonNegative, Number, Positive, Vec3, fault
from multiarm.scene.words import listed, shown, unknown
from multiarm.scene.wrench_table import WrenchTable, read_wrench_table

__all__ = ["Drag", "ExternalWrench", "Pulse", "Sinusoid"]

OBJECT = "object"
"""What a wrench acts on that does not act on a link."""

AxisNumbers = Annotated[
    tuple[float, float, float], BeforeValidator(partial(axis_numbers, "the object's axes"))
]


class Drag(Spec):
    """Resistance of the medium that the object moves through.

    Along each axis of the object, with u its velocity relative to the medium and |u| its size,
    force = -(linear + (quadratic + density coefficient area / 2) |u|) u; about each axis,
    torque = -angular times the angular velocity.

    Attributes
    ----------
    linear : number or 3 numbers
        [N s/m], for all axes of the object or one for each.
    angular : number or 3 numbers
        [N m s/rad].
    quadratic : number or 3 numbers
        [N s^2/m^2].
    area : number or 3 numbers, optional
        Cross-section seen along each axis [m^2]; goes with ``coefficient``.
    coefficient : number or 3 numbers, optional
        Drag coefficient.
    density : float
        Of the medium [kg/m^3]; 1.225 is that of air.
    wind : 3 numbers
        Velocity of the medium [m/s], world axes.
    """

    linear: AxisNumbers = (0.0, 0.0, 0.0)
    angular: AxisNumbers = (0.0, 0.0, 0.0)
    quadratic: AxisNumbers = (0.0, 0.0, 0.0)
    area: AxisNumbers | None = None
    coefficient: AxisNumbers | None = None
    density: Positive = 1.225
    wind: Vec3 = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _something_resists(self) -> Self:
        if (self.area is None) != (self.coefficient is None):
            given, lacking = ("area", "coefficient")[:: 1 if self.coefficient is None else -1]
            raise fault(f"{given!r} needs {lacking!r} too: force = density coefficient area u^2/2")
        if self.area is None and not any((*self.linear, *self.angular, *self.quadratic)):
            raise fault(
                "resists nothing; give 'linear', 'angular', 'quadratic', or 'area' and "
                "'coefficient', or leave the effect out"
            )
        return self

    def per_axis(self) -> tuple[float, float, float]:
        """Return what multiplies |u| u, for each axis of the object [N s^2/m^2]."""
        area, coefficient = self.area or (0.0,) * 3, self.coefficient or (0.0,) * 3
        x, y, z = (
            q + 0.5 * self.density * a * c
            for q, a, c in zip(self.quadratic, area, coefficient, strict=True)
        )
        return x, y, z


class Sinusoid(Spec):
    """The factor sin(2 pi frequency t + phase).

    Attributes
    ----------
    frequency : float
        [Hz]
    phase : float
        [rad]
    """

    frequency: Positive = Field(description="in Hz")
    phase: Number = 0.0


class Pulse(Spec):
    """The factor 1 from ``begin`` to ``end`` [s], else 0."""

    begin: NonNegative = Field(description="in s")
    end: Positive = Field(description="in s")

    @model_validator(mode="after")
    def _ends_after_it_begins(self) -> Self:
        if not self.begin < self.end:
            raise fault(f"ends at {self.end:g} s, not after its beginning at {self.begin:g} s")
        return self


_COURSES = ("sinusoid", "pulse", "table", "function")


class ExternalWrench(Spec):
    """A force and a torque from outside, at a point of the object or of a link.

    Constant, or times a factor: at most one of ``sinusoid``, ``pulse``, ``table``, ``function``.

    Attributes
    ----------
    on : 'object' or 'arm/link'
        What it acts on; the link is one of the robot's URDF or of its tool's.
    at : 3 numbers
        The point where the force acts, in the frame of the object or of the link [m].
    axes : 'world' or 'body'
        Axes of force and torque: the world's, or those of the object or link.
    force : 3 numbers, optional
        [N]
    torque : 3 numbers, optional
        [N m]
    sinusoid : Sinusoid, optional
        Times sin(2 pi frequency t + phase).
    pulse : Pulse, optional
        From ``begin`` to ``end`` only.
    table : WrenchTable, optional
        Times interpolated values, or the wrench itself from a file.
    function : function, optional
        f(t, state) -> 6 numbers, the force [N] and torque [N m]: a Python function, or its name
        as 'file.py:name' or 'package.module:name'.
    """

    on: str = Field(description="'object' or 'arm/link'")
    at: Vec3 = (0.0, 0.0, 0.0)
    axes: Literal["world", "body"] = "world"
    force: Vec3 | None = None
    torque: Vec3 | None = None
    sinusoid: Sinusoid | None = None
    pulse: Pulse | None = None
    table: WrenchTable | None = None
    function: UserFunction | None = None

    @model_validator(mode="after")
    def _one_course(self) -> Self:
        given = [name for name in _COURSES if getattr(self, name) is not None]
        if len(given) > 1:
            raise fault(f"gives {' and '.join(map(repr, given))}; keep one of them")
        whole = self.function is not None or (self.table is not None and self.table.file)
        sized = [name for name in ("force", "torque") if getattr(self, name) is not None]
        if whole and sized:
            source = "function" if self.function is not None else "file of the table"
            raise fault(f"the {source} gives force and torque; remove {listed(sized)}")
        if not whole and not sized:
            raise fault("needs 'force', 'torque' or both (3 numbers each)")
        return self

    @property
    def target(self) -> tuple[str, str] | None:
        """Arm and link that it acts on; None: the object."""
        arm, _, link = self.on.partition("/")
        return None if self.on == OBJECT else (arm, link)

    def located(self, folder: Path) -> Self:
        """Return this wrench with file paths made absolute, relative ones below ``folder``."""
        changes: dict[str, Any] = {"function": located_function(self.function, folder)}
        if self.table is not None and self.table.file is not None:
            file = absolute(self.table.file, folder)
            changes["table"] = self.table.model_copy(update={"file": file})
        return self.model_copy(update=changes)

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """What does not fit the arms, or is wrong in the file."""
        found: Faults = [(("on",), text) for text in self._target_faults(arms)]
        if self.table is not None and self.table.file is not None:
            fault_in_file = read_wrench_table(self.table.file)[1]
            found += [(("table", "file"), fault_in_file)] if fault_in_file else []
        return found

    def _target_faults(self, arms: Mapping[str, KnownArm]) -> list[str]:
        if self.target is None:
            return []
        arm, link = self.target
        if not link:
            return [f"must be 'object' or 'arm/link', got {shown(self.on)}"]
        if arm not in arms:
            return [unknown("arm", arm, arms)]
        known = arms[arm]
        if known.links is None or link in known.moving:
            return []
        if link not in known.links:
            return [unknown("link", link, known.moving)]
        return [f"link {link!r} does not move; links that do are {listed(known.moving)}"]
