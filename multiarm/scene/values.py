"""Numbers as people write them: scalars, vectors, one value per joint, one value per arm.

A joint quantity (posture, torque, gain, ...) may be written as one number for all joints, as a
list in the order base to tip, or as a table ``joint: value``. The annotated types below validate
each form and tell every fault at its own place; :func:`joint_vector` turns any of them into an
array once the joints of the arm are known.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from numbers import Real
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from multiarm.scene.words import listed, shown, unknown

__all__ = [
    "ArmName",
    "Color",
    "Direction",
    "Gain",
    "JointValues",
    "NonNegative",
    "Number",
    "PerArm",
    "Positive",
    "Vec3",
    "Vec4",
    "Vec6",
    "fault",
    "gain_vector",
    "joint_value_faults",
    "joint_vector",
    "non_negative_gain",
    "number_list",
    "positive",
]

Parts = tuple[str | int, ...]


def fault(message: str) -> PydanticCustomError:
    """Return the error that a validator raises: ``message`` is shown to the user as it is."""
    return PydanticCustomError("fault", message.replace("{", "(").replace("}", ")"))


def joint_vector(
    values: float | Sequence[float] | Mapping[str, float] | None,
    joint_names: Sequence[str],
    default: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Return one value per joint.

    Parameters
    ----------
    values : float, sequence, mapping or None
        One number for all joints, one per joint (base to tip), or ``joint: value``.
    joint_names : sequence of str, length n
        The movable joints from base to tip.
    default : float or ndarray, shape (n,)
        Used for joints that ``values`` does not name.

    Returns
    -------
    ndarray, shape (n,)
        In the unit of ``values``.

    Raises
    ------
    ValueError
        If a list has another length than n, or a table names other joints.
    """
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
    """Return one value per joint of ``arm`` from a value for all arms or a table ``arm: value``.

    Returns
    -------
    ndarray, shape (n,)
        Zero for joints and arms that ``gain`` does not name.
    """
    own = gain.get(arm) if isinstance(gain, Mapping) else gain
    return joint_vector(own, joint_names)


def joint_value_faults(
    values: float | Sequence[float] | Mapping[str, float] | None, joint_names: Sequence[str]
) -> list[tuple[Parts, str]]:
    """Return what does not fit the joints: pairs (place below the value, message)."""
    names = list(joint_names)
    if isinstance(values, Mapping):
        return [((j,), unknown("joint", j, names)) for j in values if j not in names]
    if values is None or isinstance(values, (float, Real)) or len(values) == len(names):
        return []
    message = (
        f"{len(values)} values for {len(names)} movable joints; "
        f"give one each, base to tip: {listed(names)}"
    )
    return [((), message)]


def _real(value: Any) -> float:
    if isinstance(value, (str, bool, np.bool_)) or not hasattr(value, "__float__"):
        raise fault(f"must be a number, got {shown(value)}")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise fault(f"must be a number, got {shown(value)}") from None
    if not math.isfinite(number):
        raise fault(f"must be finite, got {number}")
    return number


def positive(value: Any) -> float:
    """Return ``value`` as a float, refusing what is not a finite number above zero."""
    number = _real(value)
    if not number > 0.0:
        raise fault(f"must be greater than 0, got {number}")
    return number


def _as_list(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _collect(items: list[tuple[str | int, Any]], convert: Callable, title: str) -> list:
    """Convert every item, and raise all faults together, each at its own place."""
    results, errors = [], []
    for key, item in items:
        try:
            results.append(convert(item))
        except PydanticCustomError as error:
            errors.append(InitErrorDetails(type=error, loc=(key,), input=item))
        except ValidationError as error:
            errors.extend(_nested(key, error))
    if errors:
        raise ValidationError.from_exception_data(title, errors)
    return results


def _nested(key: str | int, error: ValidationError) -> list[InitErrorDetails]:
    return [
        InitErrorDetails(type=fault(e["msg"]), loc=(key, *e["loc"]), input=e["input"])
        for e in error.errors()
    ]


def _joint_values(value: Any) -> tuple[float, ...] | dict[str, float]:
    value = _as_list(value)
    if isinstance(value, Mapping):
        keys = [_text_key(key) for key in value]
        return dict(zip(keys, _collect(list(value.items()), _real, "joint values"), strict=True))
    if isinstance(value, (list, tuple)):
        return tuple(number_list(value))
    raise fault(f"must be a list (base to tip) or a table 'joint: value', got {shown(value)}")


def _scalar_or_joint_values(value: Any) -> float | tuple[float, ...] | dict[str, float]:
    if isinstance(value, (list, tuple, Mapping, np.ndarray)):
        return _joint_values(value)
    return _real(value)


def _per_arm(value: Any) -> dict[str, Any]:
    if not isinstance(value, Mapping):
        raise fault(f"must be a table 'arm: values', got {shown(value)}")
    keys = [_text_key(key) for key in value]
    items = list(value.items())
    return dict(zip(keys, _collect(items, _scalar_or_joint_values, "arms"), strict=True))


def _gain(value: Any) -> float | tuple[float, ...] | dict[str, Any]:
    value = _as_list(value)
    if isinstance(value, Mapping):
        return _per_arm(value)
    return _scalar_or_joint_values(value)


def non_negative_gain(value: Any) -> float | tuple[float, ...] | dict[str, Any]:
    """Return a value for the joints of all arms, or a table by arm, refusing negative numbers."""
    gain = _gain(value)
    lowest = min(_leaves(gain), default=0.0)
    if lowest < 0.0:
        raise fault(f"must not be negative, got {lowest}")
    return gain


def _leaves(value: Any) -> list[float]:
    if isinstance(value, Mapping):
        return [leaf for item in value.values() for leaf in _leaves(item)]
    return list(value) if isinstance(value, tuple) else [value]


def _text_key(key: Any) -> str:
    if not isinstance(key, str):
        raise fault(f"names must be text, got {shown(key)}; put quotes around it")
    return key


_COLOR_TEXT = re.compile(r"#(?:[0-9a-fA-F]{6}|[0-9a-fA-F]{8})")


def _color(value: Any) -> tuple[float, ...]:
    remedy = "write '#3b7dd8' or [red, green, blue] from 0 to 1, with opacity as a fourth"
    if isinstance(value, str):
        if not _COLOR_TEXT.fullmatch(value):
            raise fault(f"unknown colour {shown(value)}; {remedy}")
        parts = tuple(int(value[i : i + 2], 16) / 255.0 for i in range(1, len(value), 2))
    else:
        value = _as_list(value)
        if not isinstance(value, (list, tuple)) or len(value) not in (3, 4):
            raise fault(f"unknown colour {shown(value)}; {remedy}")
        parts = tuple(number_list(value))
        if min(parts) < 0.0 or max(parts) > 1.0:
            raise fault(f"colour parts lie between 0 and 1, got {shown(value)}; {remedy}")
    return parts if len(parts) == 4 else (*parts, 1.0)


def _arm_name(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.\-]*", value):
        raise fault(
            f"{shown(value)} cannot name an arm; use letters, digits, '_', '-' and '.' "
            "(names become parts of paths such as 'left/elbow_joint')"
        )
    return value


def number_list(values: Sequence[Any]) -> list[float]:
    """Return ``values`` as floats, refusing each one that is not a finite number."""
    return _collect(list(enumerate(values)), _real, "numbers")


def _vector(length: int, value: Any) -> tuple[float, ...]:
    value = _as_list(value)
    if not isinstance(value, (list, tuple)) or len(value) != length:
        raise fault(f"must be a list of {length} numbers, got {shown(value)}")
    return tuple(number_list(value))


def _direction(value: Any) -> tuple[float, ...]:
    vector = _vector(3, value)
    if not math.hypot(*vector) > 0.0:
        raise fault("must have a direction, got a vector of length zero")
    return vector


Number = Annotated[float, BeforeValidator(_real)]
Positive = Annotated[float, BeforeValidator(_real), Field(gt=0.0)]
NonNegative = Annotated[float, BeforeValidator(_real), Field(ge=0.0)]
Vec3 = Annotated[tuple[float, float, float], BeforeValidator(partial(_vector, 3))]
Vec4 = Annotated[tuple[float, float, float, float], BeforeValidator(partial(_vector, 4))]
Vec6 = Annotated[
    tuple[float, float, float, float, float, float], BeforeValidator(partial(_vector, 6))
]
Direction = Annotated[tuple[float, float, float], BeforeValidator(_direction)]
ArmName = Annotated[str, BeforeValidator(_arm_name)]
Color = Annotated[tuple[float, float, float, float], BeforeValidator(_color)]
JointValues = Annotated[tuple[float, ...] | dict[str, float], BeforeValidator(_joint_values)]
PerArm = Annotated[
    dict[str, float | tuple[float, ...] | dict[str, float]], BeforeValidator(_per_arm)
]
Gain = Annotated[
    float | tuple[float, ...] | dict[str, float | tuple[float, ...] | dict[str, float]],
    BeforeValidator(non_negative_gain),
]
