"""Values as people write them: tables with known keys, numbers, vectors, poses, values by joint.

A quantity of joints (posture, torque, gain, ...) may be written as one number for all joints, as a
list from base to tip, or as a table ``joint: value``.  A quantity of all arms may be one of these
for every arm alike, or a table ``arm: value``; where robots' files have such numbers too, ``urdf``
stands for these, for all arms or for one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    SerializerFunctionWrapHandler,
    TypeAdapter,
    ValidationError,
    WithJsonSchema,
    model_serializer,
    model_validator,
)
from pydantic_core import core_schema
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.notation import count_of
from multiarm.public import public_names
from multiarm.scene.faults import (
    Parts,
    explain,
    fault_at,
    invalid,
    listed,
    path_fault,
    shown,
    unknown,
)
from multiarm.scene.urdf import JointOutline

if TYPE_CHECKING:
    import numpy as np

Faults = list[tuple[Parts, str]]
"""Pairs of a place, relative to that of the value, and the fault there."""
URDF = "urdf"
"""Stands for the numbers in the robot's file."""
SOLVE = "solve"
"""Stands for a posture that the program finds."""


class Spec(BaseModel):
    """Base of all parts of a scene: frozen, strict about keys.

    A part built in Python (``Pose(xyz=[0, 0, 1])``) is validated like one read from YAML, and
    raises the same :class:`~multiarm.errors.SceneError`.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        arbitrary_types_allowed=True,
        defer_build=True,  # at its first use: a scene uses few of all parts
    )

    def __dir__(self) -> list[str]:
        return [name for name in public_names(self) if not hasattr(BaseModel, name)]

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        return written(self).items()

    def __init__(self, /, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            raise SceneError(explain(error, type(self), type(self).__name__)) from None

    @classmethod
    def __get_pydantic_core_schema__(
        cls, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Read nested parts without their ``__init__``, where the first fault ends the search."""
        schema = handler(source)
        model: Any = handler.resolve_ref_schema(schema)
        while model["type"] != "model":  # its validators are around it
            model = model["schema"]
        model["custom_init"] = False
        return schema

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            super().__setattr__(name, value)
        except ValidationError:
            problem = (
                "parts of a scene are not changed in place; another scene is made by "
                "scene.replace, such as scene.replace({'object.mass': 20})"
            )
            raise SceneError([fault_at((name,), problem, type(self).__name__)]) from None

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """Validate a mapping or an instance; raises SceneError."""
        try:
            return super().model_validate(obj, **options)
        except ValidationError as error:
            raise SceneError(explain(error, cls, cls.__name__)) from None

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """A copy, with other values for some keys, which are validated; raises SceneError."""
        if not update:
            return super().model_copy(deep=deep)
        return type(self).model_validate({**written(self), **update})

    @model_serializer(mode="wrap")
    def _kind_is_always_written(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data = handler(self)
        kind = getattr(self, "kind", None)
        return data if kind is None else {"kind": kind, **data}


def written(value: Any) -> dict[str, Any]:
    """The entries of a table; of a part of a scene those that are written, and its kind."""
    if not isinstance(value, BaseModel):
        return dict(value) if isinstance(value, Mapping) else {}
    return {name: v for name, v in value if name in value.model_fields_set or name == "kind"}


def shorthand(key: str, written: Any, *types: type) -> BeforeValidator:
    """Let a value of some types stand for a table with one key; ``written`` is what may stand."""

    def table(value: Any) -> Any:
        bare = isinstance(value, types) and not isinstance(value, bool)
        return {key: value} if bare else value

    return BeforeValidator(table, json_schema_input_type=written)


class OneOf(Spec):
    """A table that has exactly one of its keys."""

    model_config = ConfigDict(json_schema_extra={"minProperties": 1})

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        written = [name for name, value in self if value is not None]
        if len(written) != 1:
            known = listed(type(self).model_fields)
            raise invalid(f"needs exactly one of {known}, got {written or 'none'}")
        return self


def _file_path(value: Any) -> Any:
    """Refuse the path of no file; whether there is a file is another question."""
    wrong = path_fault(value) if isinstance(value, (str, Path)) else ""
    if wrong:
        raise invalid(wrong)
    return value


FilePath = Annotated[Path, BeforeValidator(_file_path)]


# --- numbers and vectors -------------------------------------------------------------------------


def _as_float(value: Any) -> float:
    truth = isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")  # NumPy's too
    if truth or isinstance(value, str) or not hasattr(value, "__float__"):
        raise invalid(f"must be a number, got {shown(value)}")
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise invalid(f"must be a number, got {shown(value)}") from None


def _number(value: Any) -> float:
    number = _as_float(value)
    if not math.isfinite(number):
        raise invalid(f"must be finite, got {number}")
    return number


def _bound(value: Any) -> float:
    bound = _as_float(value)
    if math.isnan(bound):
        raise invalid(f"must be a number, got {bound}")
    return bound


Number = Annotated[float, BeforeValidator(_number)]
# bounds stand within the validator, where they are the number's own in JSON Schema
Positive = Annotated[float, Field(gt=0.0), BeforeValidator(_number)]
NonNegative = Annotated[float, Field(ge=0.0), BeforeValidator(_number)]
UnitInterval = Annotated[float, Field(ge=0.0, le=1.0), BeforeValidator(_number)]
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
        numbers: tuple[float, ...] = (_number(value),) * 3
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
"""Owner of contacts between the object and what stands still, beside the arms."""
_ARM_NAME = r"[A-Za-z0-9_][A-Za-z0-9_.\-]*"
_HEX_COLOR = "#([0-9a-fA-F]{6}|[0-9a-fA-F]{8})"


def _arm_name(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(_ARM_NAME, value):
        raise invalid(
            f"{shown(value)} cannot name an arm; use letters, digits, '_', '-' and '.' "
            "(names become parts of paths such as 'left/elbow_joint')"
        )
    if value == SURROUNDINGS:
        raise invalid(f"no arm can be named {value!r}: results have the floor's forces there")
    return value


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


# --- values by joint and by arm ------------------------------------------------------------------


def _with_text_keys(value: Mapping) -> Mapping:
    for key in value:
        if not isinstance(key, str):
            raise invalid(f"names must be text, got {shown(key)}; put quotes around it")
    return value


_joint_table = TypeAdapter(dict[str, Number]).validate_python


def _joint_values(value: Any) -> tuple[float, ...] | dict[str, float]:
    value = as_list(value)
    if isinstance(value, Mapping):
        return _joint_table(_with_text_keys(value))
    if isinstance(value, (list, tuple)):
        return number_list(value)
    raise invalid(f"must be a list (base to tip) or a table 'joint: value', got {shown(value)}")


def _number_or_joint_values(value: Any) -> Any:
    value = as_list(value)
    many = isinstance(value, (list, tuple, Mapping))
    return _joint_values(value) if many else _number(value)


_arm_table = TypeAdapter(
    dict[str, Annotated[Any, BeforeValidator(_number_or_joint_values)]]
).validate_python


def _per_arm(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise invalid(f"must be a table 'arm: values', got {shown(value)}")
    return _arm_table(_with_text_keys(value))


def _gain(value: Any) -> Any:
    value = as_list(value)
    gain = _per_arm(value) if isinstance(value, Mapping) else _number_or_joint_values(value)
    lowest = min(_leaves(gain), default=0.0)
    if lowest < 0.0:
        raise invalid(f"must not be negative, got {lowest}")
    return gain


def _leaves(value: Any) -> list[float]:
    if isinstance(value, Mapping):
        return [leaf for item in value.values() for leaf in _leaves(item)]
    return list(value) if isinstance(value, tuple) else [value]


def _gain_or_urdf(value: Any) -> Any:
    if _is_urdf(value):
        return value
    if isinstance(value, str):
        raise invalid(f"must be a number, a list, a table or {URDF!r}, got {shown(value)}")
    if not isinstance(value, Mapping):
        return _gain(value)
    numbers = _gain({arm: 0.0 if _is_urdf(gain) else gain for arm, gain in value.items()})
    return {arm: URDF if _is_urdf(value[arm]) else gain for arm, gain in numbers.items()}


def _is_urdf(value: Any) -> bool:
    return isinstance(value, str) and value == URDF


def _posture(value: Any) -> Any:
    if not isinstance(value, str):
        return _joint_values(value)
    if value != SOLVE:
        raise invalid(f"must be a list, a table 'joint: value' or {SOLVE!r}, got {shown(value)}")
    return value


JointValues = Annotated[tuple[float, ...] | dict[str, float], BeforeValidator(_joint_values)]
Posture = Annotated[
    tuple[float, ...] | dict[str, float] | Literal["solve"], BeforeValidator(_posture)
]
PerArm = Annotated[
    dict[str, float | tuple[float, ...] | dict[str, float]], BeforeValidator(_per_arm)
]
Gain = Annotated[
    float | tuple[float, ...] | dict[str, float | tuple[float, ...] | dict[str, float]],
    BeforeValidator(_gain),
]
_Urdf = Literal["urdf"]
UrdfGain = Annotated[
    float
    | _Urdf
    | tuple[float, ...]
    | dict[str, float | _Urdf | tuple[float, ...] | dict[str, float]],
    BeforeValidator(_gain_or_urdf),
]


def joint_vector(
    values: float | Sequence[float] | Mapping[str, float] | None,
    joint_names: Sequence[str],
    default: np.ndarray | float = 0.0,
) -> np.ndarray:
    """One value per movable joint from base to tip, shape (n,).

    Joints that ``values`` does not name get the default, one number or shape (n,).

    Raises
    ------
    ValueError
        If a list has another length than n, or a table names other joints.
    """
    import numpy as np

    names = list(joint_names)
    faults = [message for _, message in joint_value_faults(values, names)]
    if faults:
        raise ValueError("; ".join(faults))
    result = np.full(len(names), default, dtype=float)
    if isinstance(values, Mapping):
        for joint, value in values.items():
            result[names.index(joint)] = value
    elif values is not None:
        result[:] = values
    return result


def gain_vector(
    gain: float | Sequence[float] | Mapping[str, Any] | None,
    arm: str,
    joint_names: Sequence[str],
) -> np.ndarray:
    """One value per joint of ``arm``, shape (n,); zero for joints and arms that are not named."""
    value = gain.get(arm) if isinstance(gain, Mapping) else gain
    return joint_vector(value, joint_names)


def joint_value_faults(
    values: float | Sequence[float] | Mapping[str, float] | None, joint_names: Sequence[str]
) -> Faults:
    """Faults with respect to the joints."""
    names = list(joint_names)
    if isinstance(values, Mapping):
        return [((j,), unknown("joint", j, names)) for j in values if j not in names]
    if values is None or isinstance(values, (float, Real)) or len(values) == len(names):
        return []
    message = (
        f"{count_of(len(values), 'value')} for {count_of(len(names), 'movable joint')}; "
        f"give one each, base to tip: {listed(names)}"
    )
    return [((), message)]


@dataclass
class KnownArm:
    """The facts of an arm for the checks of a scene; None if the arm has faults.

    Attributes
    ----------
    joints : tuple of JointOutline
        The movable ones from base to tip.
    links : tuple of str
        All links, of the robot and of its tool.
    moving : tuple of str
        Those that the movable joints carry.
    shown_by : str or None
        The command that shows all links.
    """

    joints: tuple[JointOutline, ...] | None = None
    links: tuple[str, ...] | None = None
    moving: tuple[str, ...] = ()
    shown_by: str | None = None

    @property
    def joint_names(self) -> tuple[str, ...] | None:
        """Names of the movable joints."""
        return None if self.joints is None else tuple(joint.name for joint in self.joints)


def gain_faults(
    value: Any,
    arms: Mapping[str, KnownArm],
    in_urdf: Callable[[JointOutline], float] | None = None,
    what: str = "",
) -> Faults:
    """Faults of a value for all arms, or of a table by arm, with respect to the arms.

    ``in_urdf`` gives a joint the number, called ``what``, of the robot's file, which must not be
    negative where ``value`` refers to it.
    """
    if value is None:
        return []
    by_arm = isinstance(value, Mapping)
    faults: Faults = []
    for arm, gain in (value if by_arm else dict.fromkeys(arms, value)).items():
        where: Parts = (arm,) if by_arm else ()
        if arm not in arms:
            faults.append((where, unknown("arm", arm, arms)))
            continue
        names = arms[arm].joint_names
        if names is None or _is_urdf(gain):
            continue
        subject = "" if by_arm else f"arm {arm!r}: "
        for further, text in joint_value_faults(gain, names):
            faults.append(((*where, *further), f"{subject}{text}"))
    if in_urdf is None:
        return faults
    for where, arm in _arms_by_urdf(value, arms):
        wrong = [j.name for j in arms[arm].joints or () if not in_urdf(j) >= 0.0]
        if wrong:
            text = f"the URDF of arm {arm!r} gives {listed(wrong)} a {what} that is no number >= 0"
            faults.append((where, f"{text}; correct the file, or write numbers here"))
    return faults


def below(where: Parts, faults: Faults) -> Faults:
    """Faults of a part, which is at the place ``where`` in its owner."""
    return [((*where, *further), text) for further, text in faults]


def urdf_warnings(
    value: Any, arms: Mapping[str, KnownArm], in_urdf: Callable[[JointOutline], Any], what: str
) -> Faults:
    """Arms whose robots' files have no such number, where ``value`` refers to these files."""
    return [
        (where, f"the URDF of arm {arm!r} gives no joint a {what}; write numbers to give them some")
        for where, arm in _arms_by_urdf(value, arms)
        if not any(in_urdf(joint) for joint in arms[arm].joints or ())
    ]


def _arms_by_urdf(value: Any, arms: Iterable[str]) -> list[tuple[Parts, str]]:
    """Arms whose numbers are those of their robots' files, and where a scene says so."""
    if isinstance(value, Mapping):
        return [((arm,), arm) for arm in arms if _is_urdf(value.get(arm))]
    return [((), arm) for arm in arms] if _is_urdf(value) else []
