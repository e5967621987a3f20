"""Values as people write them: numbers, vectors, angles, names, colours, poses."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from functools import partial
from numbers import Integral, Real
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    TypeAdapter,
    WithJsonSchema,
    model_validator,
)

from multiarm.scene.faults import invalid, shown
from multiarm.scene.spec import Spec

if TYPE_CHECKING:
    import numpy as np


def _as_float(value: Any) -> float:
    truth = isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")  # NumPy's too
    if truth or isinstance(value, str) or not hasattr(value, "__float__"):
        raise invalid(f"must be a number, got {shown(value)}")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise invalid(f"must be a number, got {shown(value)}") from None


def is_integer(value: Any) -> bool:
    """Whether a value is an integer of Python or NumPy; a truth value is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def is_finite(value: Any) -> bool:
    """Whether a value is a real number within the range of floats."""
    try:
        return isinstance(value, Real) and math.isfinite(value)
    except OverflowError:  # of an integer or a fraction
        return False


def finite_number(value: Any) -> float:
    """The value as a finite number."""
    number = _as_float(value)
    if not math.isfinite(number):
        raise invalid(f"must be finite, got {number}")
    return number


def _bound(value: Any) -> float:
    bound = _as_float(value)
    if math.isnan(bound):
        raise invalid(f"must be a number, got {bound}")
    return bound


Number = Annotated[float, BeforeValidator(finite_number)]
# bounds stand within the validator, where they are the number's own in JSON Schema
Positive = Annotated[float, Field(gt=0.0), BeforeValidator(finite_number)]
NonNegative = Annotated[float, Field(ge=0.0), BeforeValidator(finite_number)]
UnitInterval = Annotated[float, Field(ge=0.0, le=1.0), BeforeValidator(finite_number)]
Bound = Annotated[float, BeforeValidator(_bound)]
"""A number, infinite where there is no bound."""
number_list = TypeAdapter(tuple[Number, ...]).validate_python
"""Numbers of a list as floats; every one that is no finite number is a fault at its place."""


def as_list(value: Any) -> Any:
    """Arrays as lists; all else as it is."""
    return value.tolist() if hasattr(value, "tolist") else value


def list_of(text: str, length: int | None = None, least: int = 0) -> BeforeValidator:
    """Raise a fault unless the value is a list of this length, or of at least this length."""

    def check(value: Any) -> Any:
        value = as_list(value)
        if (
            not isinstance(value, (list, tuple))
            or len(value) < least
            or length not in (None, len(value))
        ):
            raise invalid(f"{text}, got {shown(value)}")
        return value

    return BeforeValidator(check)


def _not_zero(vector: tuple[float, ...]) -> tuple[float, ...]:
    if not math.hypot(*vector) > 0.0:
        raise invalid("must have a direction, got a vector of length zero")
    return vector


def rising(ends: tuple[float, float]) -> tuple[float, float]:
    """The ends of a range; a fault unless the first is smaller."""
    if not ends[0] < ends[1]:
        raise invalid(f"must run from a smaller to a larger number, got [{ends[0]:g}, {ends[1]:g}]")
    return ends


_A_TURN = 2.0 * math.pi * (1.0 + 1e-3)  # [rad], however it was rounded


def angle_fault(angle: float, turns: int = 1) -> str:
    """Why this is no angle in radians; empty where it may be one."""
    if abs(angle) <= turns * _A_TURN:
        return ""
    within = "a turn" if turns == 1 else f"{turns} turns"
    return (
        f"must lie within {within}, got {angle:g} rad; angles are in radians, {angle:g} degrees "
        f"are {math.radians(angle):.6g} rad"
    )


def _angle_within(turns: int) -> Any:
    """The type of an angle of so many turns at most; larger ones are taken for degrees."""

    def check(angle: float) -> float:
        text = angle_fault(angle, turns)
        if text:
            raise invalid(text)
        return angle

    bound = turns * _A_TURN
    bounds = Field(json_schema_extra={"minimum": -bound, "maximum": bound})
    return Annotated[Number, AfterValidator(check), bounds]


if TYPE_CHECKING:
    Angle = float
    BaseAngle = float
else:
    Angle = _angle_within(1)
    BaseAngle = _angle_within(3)  # bases around an object are set at multiples of an angle
Vec3 = Annotated[tuple[Number, Number, Number], list_of("must be a list of 3 numbers", 3)]
Vec4 = Annotated[tuple[Number, Number, Number, Number], list_of("must be a list of 4 numbers", 4)]
Vec6 = Annotated[
    tuple[Number, Number, Number, Number, Number, Number], list_of("must be a list of 6 numbers", 6)
]
RollPitchYaw = Annotated[tuple[Angle, Angle, Angle], list_of("must be a list of 3 angles [rad]", 3)]
BaseTurn = Annotated[
    tuple[BaseAngle, BaseAngle, BaseAngle], list_of("must be a list of 3 angles [rad]", 3)
]
Direction = Annotated[Vec3, AfterValidator(_not_zero)]
Range = Annotated[
    tuple[Number, Number],
    list_of("must be a list of two numbers, from and to", 2),
    AfterValidator(rising),
]


def items_of(*lengths: int) -> dict[str, int]:
    """That a list has one of these lengths, in JSON Schema."""
    return {"minItems": min(lengths), "maxItems": max(lengths)}


def _axis_numbers(axes: str, value: Any) -> tuple[float, ...]:
    value = as_list(value)
    if isinstance(value, (int, float)):
        numbers: tuple[float, ...] = (finite_number(value),) * 3
    elif isinstance(value, (list, tuple)) and len(value) == 3:
        numbers = number_list(value)
    else:
        raise invalid(f"must be a number, or a list of 3 for {axes}, got {shown(value)}")
    if min(numbers) < 0.0:
        raise invalid(f"must not be negative, got {shown(value)}")
    return numbers


_AXIS_NUMBER: dict[str, Any] = {"type": "number", "minimum": 0}
_NUMBER_OR_3 = WithJsonSchema(
    {"anyOf": [_AXIS_NUMBER, {"type": "array", "items": _AXIS_NUMBER, **items_of(3)}]}
)

BodyAxes = Annotated[
    tuple[float, float, float],
    BeforeValidator(partial(_axis_numbers, "the object's axes")),
    _NUMBER_OR_3,
]
"""Three numbers for the object's axes, or one for all of them; not negative."""
WorldAxes = Annotated[
    tuple[float, float, float],
    BeforeValidator(partial(_axis_numbers, "the world's axes")),
    _NUMBER_OR_3,
]
"""Three numbers for the world's axes, or one for all of them; not negative."""


SURROUNDINGS = "floor"
"""Owner of contacts between the object and what stands still, beside the arms.

With several objects ``floor/NAME`` for each.
"""


def floor_owner(name: str, objects: Collection[str]) -> str:
    """Owner of the contacts of an object with the floor; ``objects`` are those of the scene."""
    return SURROUNDINGS if len(objects) == 1 else f"{SURROUNDINGS}/{name}"


def of_surroundings(owner: str) -> bool:
    """Whether an owner of rows stands for contacts with what stands still."""
    return owner.partition("/")[0] == SURROUNDINGS


_ARM_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.\-]*"
_HEX_COLOR = "#([0-9a-fA-F]{6}|[0-9a-fA-F]{8})"


_BODIES = ("object", "world")  # which joints name besides the links of robots
_AT_REST = ("world", SURROUNDINGS, "environment")  # what stands still, and its part of results


def _name_of(noun: str, value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(_ARM_NAME, value):
        raise invalid(
            f"{shown(value)} cannot name {noun}; use letters, digits, '_', '-' and '.' "
            "(names become parts of paths such as 'left/elbow_joint')"
        )
    return value


def _arm_name(value: Any) -> str:
    name = _name_of("an arm", value)
    if name == SURROUNDINGS:
        raise invalid(f"no arm can be named {name!r}: results have the floor's forces there")
    return name


def _robot_name(value: Any) -> str:
    name = _name_of("a robot", value)
    if name in (SURROUNDINGS, *_BODIES):
        raise invalid(f"no robot can be named {name!r}, which is the name of another body")
    return name


def _object_name(value: Any) -> str:
    name = _name_of("an object", value)
    if name in _AT_REST:
        raise invalid(f"no object can be named {name!r}, which is the name of what stands still")
    return name


def _color(value: Any) -> tuple[float, ...]:
    remedy = "write '#3b7dd8' or [red, green, blue] from 0 to 1, with opacity as a fourth"
    value = as_list(value)
    if isinstance(value, str) and re.fullmatch(_HEX_COLOR, value):
        parts = tuple(byte / 255.0 for byte in bytes.fromhex(value[1:]))
    elif isinstance(value, (list, tuple)) and len(value) in (3, 4):
        parts = number_list(value)
    else:
        raise invalid(f"unknown colour {shown(value)}; {remedy}")
    if min(parts) < 0.0 or max(parts) > 1.0:
        raise invalid(f"colour parts lie between 0 and 1, got {shown(value)}; {remedy}")
    return parts if len(parts) == 4 else (*parts, 1.0)


ArmName = Annotated[
    str,
    BeforeValidator(_arm_name),
    WithJsonSchema({"type": "string", "pattern": f"^{_ARM_NAME}$"}),
]
RobotName = Annotated[
    str,
    BeforeValidator(_robot_name),
    WithJsonSchema({"type": "string", "pattern": f"^{_ARM_NAME}$"}),
]
ObjectName = Annotated[
    str,
    BeforeValidator(_object_name),
    WithJsonSchema({"type": "string", "pattern": f"^{_ARM_NAME}$"}),
]
TipName = Annotated[
    str,
    BeforeValidator(partial(_name_of, "a tip")),
    WithJsonSchema({"type": "string", "pattern": f"^{_ARM_NAME}$"}),
]
_PART = {"type": "number", "minimum": 0, "maximum": 1}
Color = Annotated[
    tuple[float, float, float, float],
    BeforeValidator(_color),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "string", "pattern": f"^{_HEX_COLOR}$"},
                {"type": "array", "items": _PART, **items_of(3, 4)},
            ]
        }
    ),
]


def one_orientation(part: Any) -> Any:
    """Check, after validation, that a part has at most one of ``rpy`` and ``quaternion_xyzw``."""
    if part.quaternion_xyzw is None:
        return part
    if any(part.rpy):
        raise invalid("gives both 'rpy' and 'quaternion_xyzw'; keep one of them")
    if not math.hypot(*part.quaternion_xyzw) > 1e-12:
        raise invalid("'quaternion_xyzw' has length zero; the identity is [0, 0, 0, 1]")
    return part


def rotation_matrix(
    rpy: Sequence[float], quaternion_xyzw: Sequence[float] | None = None
) -> np.ndarray:
    """Rotation, shape (3, 3): Rz(yaw) Ry(pitch) Rx(roll), or that of a quaternion of any length."""
    import numpy as np

    if quaternion_xyzw is None:
        (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
        return np.array(
            [
                [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
                [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
                [-sp, cp * sr, cp * cr],
            ]
        )
    q = np.array(quaternion_xyzw)
    largest = np.abs(q).max()
    if largest > 1e100:  # its square would overflow
        q = q / largest
    from multiarm.spatial import quaternion_to_matrix

    return quaternion_to_matrix(q / np.linalg.norm(q))


def roll_pitch_yaw(rotation: np.ndarray) -> tuple[float, float, float]:
    """Angles [rad] of a rotation (3, 3): the inverse of :func:`rotation_matrix`.

    Where yaw and roll turn about one axis, the yaw is 0.
    """
    import numpy as np

    R = rotation
    cosine = np.hypot(R[0, 0], R[1, 0])
    pitch = float(np.arctan2(-R[2, 0], cosine))
    if cosine < 1e-9:
        return float(np.arctan2(-R[1, 2], R[1, 1])), pitch, 0.0
    return float(np.arctan2(R[2, 1], R[2, 2])), pitch, float(np.arctan2(R[1, 0], R[0, 0]))


class Pose(Spec):
    """A placement: where a frame's origin is and how its axes are turned."""

    xyz: Vec3 = (0.0, 0.0, 0.0)
    """Origin [m] in the parent frame."""
    rpy: RollPitchYaw = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw [rad] about the fixed axes x, y, z in that order, as in URDF: R = Rz(yaw)
    Ry(pitch) Rx(roll)."""
    quaternion_xyzw: Vec4 | None = None
    """Orientation as a quaternion, scalar last, instead of ``rpy``. Any length but zero."""

    _one_orientation = model_validator(mode="after")(one_orientation)

    def rotation(self) -> np.ndarray:
        """Rotation matrix, shape (3, 3): child components to parent components."""
        return rotation_matrix(self.rpy, self.quaternion_xyzw)

    def matrix(self) -> np.ndarray:
        """Homogeneous transform, shape (4, 4): child coordinates to parent ones."""
        import numpy as np

        X = np.eye(4)
        X[:3, :3] = self.rotation()
        X[:3, 3] = self.xyz
        return X
