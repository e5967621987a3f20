"""The kinds of control of a scene: ours, and users'."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field, SerializeAsAny, ValidationInfo, WrapValidator

from multiarm.scene.control.joint_control import (
    ConstantControl,
    FunctionControl,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    NoControl,
    RecordedControl,
)
from multiarm.scene.control.kind import ControlKind, UnloadedControl
from multiarm.scene.control.object_control import ComputedTorqueControl, ObjectImpedanceControl
from multiarm.scene.registry import AnyClass, Registry

_OURS = (
    NoControl,
    ConstantControl,
    GravityCompensationControl,
    JointPDControl,
    HarmonicControl,
    ComputedTorqueControl,
    ObjectImpedanceControl,
    RecordedControl,
    FunctionControl,
)
BUILT_IN: dict[str, type[ControlKind]] = {own.kind_name(): own for own in _OURS}
"""Our kinds by name."""
CONTROLS: Registry[ControlKind] = Registry(
    sort="control",
    noun="control kind",
    plural="kinds",
    built_in=lambda: BUILT_IN,
    name_of=lambda own: own.kind_name(),
)
"""User kinds of control; what the class must offer says :class:`multiarm.Control`."""


def register_control(control: AnyClass) -> AnyClass:
    """Let scenes name a user kind of control, a subclass of :class:`multiarm.Control`; a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        It lacks something, or another kind has its name.
    """
    return CONTROLS.add(control)


def _with_kind(value: Any) -> Any:
    """Write out ``control: gravity_compensation`` and ``control: {function: ...}``."""
    if value is None or isinstance(value, str):
        return {"kind": "none" if value is None else value}
    if isinstance(value, Mapping) and "function" in value and "kind" not in value:
        return {"kind": "function", **value}
    return value


def _read(value: Any, handler: Callable[[Any], Any], info: ValidationInfo) -> Any:
    if type(value) is ControlKind:  # one that was left out, see :func:`without_code`
        return value
    return CONTROLS.read_kind(value, handler, info, UnloadedControl)


if TYPE_CHECKING:
    ControlSpec = ControlKind
else:
    ControlSpec = Annotated[
        SerializeAsAny[Annotated[reduce(or_, _OURS), Field(discriminator="kind")]],
        WrapValidator(_read),
        BeforeValidator(_with_kind),
    ]
