"""Numbers and lists of axes as people write them: what is taken, and what is refused in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator

from multiarm.scene.faults import fault, shown
from multiarm.scene.values import number_list

__all__ = [
    "Count",
    "NonNegativeCount",
    "bounds",
    "counted",
    "exponents",
    "items",
    "plain_value",
    "positive_bounds",
    "ratios",
    "spaced",
    "whole_bounds",
]


def plain_value(value: Any) -> Any:
    """The value in what a YAML file can hold.

    Raises
    ------
    PydanticCustomError
        When it cannot.
    """
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", exclude_unset=True)
    if isinstance(value, (np.ndarray, np.generic)):
        return plain_value(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): plain_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_value(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    raise fault(f"{shown(value)} is nothing that a YAML file can hold; give numbers, texts, lists")


def _whole(least: int, value: Any) -> int:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise fault(f"must be a whole number, got {shown(value)}")
    if value < least:
        raise fault(f"must be at least {least}, got {value}")
    return int(value)


def _from_zero(value: Any) -> int:
    return _whole(0, value)


def _from_one(value: Any) -> int:
    return _whole(1, value)


# Values that an axis may have, and the largest whole number in it: those of a float are exact.
MOST_VALUES, LARGEST = 10**9, 2**53


Count = Annotated[int, BeforeValidator(_from_one)]
NonNegativeCount = Annotated[int, BeforeValidator(_from_zero)]


def items(value: Any) -> list[Any]:
    """A list of at least one value."""
    value = plain_value(value)
    if not isinstance(value, list) or not value:
        raise fault(f"must be a list of at least one value, got {shown(value)}")
    return value


def spaced(value: Any) -> list[Any]:
    """First and last value, and how many there are."""
    value = items(value)
    if len(value) != 3:
        raise fault(f"must be [first, last, how many], got {shown(value)}")
    try:
        count = _whole(1, value[2])
    except Exception as error:
        raise fault(f"how many values there are, the third entry, {error}") from None
    if count > MOST_VALUES:
        raise fault(f"has at most {MOST_VALUES:,} values, got {count:,}")
    return [*number_list(value[:2]), count]


def exponents(value: Any) -> list[Any]:
    """The same of exponents of ten."""
    value = spaced(value)
    if max(abs(value[0]), abs(value[1])) > 300.0:
        raise fault(f"are exponents of ten, of at most 300, got {shown(value)}")
    return value


def ratios(value: Any) -> list[Any]:
    """The same with equal ratios."""
    value = spaced(value)
    if not (value[0] > 0.0 and value[1] > 0.0):
        raise fault(f"has equal ratios, so that both bounds must be positive, got {shown(value)}")
    return value


def counted(value: Any) -> list[int]:
    """What Python's range takes."""
    value = items(value)
    whole = all(isinstance(item, int) and not isinstance(item, bool) for item in value)
    if len(value) > 3 or not whole:
        raise fault(
            f"must be whole numbers [stop], [start, stop] or [start, stop, step] as Python's range "
            f"takes them, got {shown(value)}; of other numbers make a 'linspace'"
        )
    if max(map(abs, value)) > LARGEST:
        raise fault(f"must be whole numbers of at most {LARGEST:,}, got {shown(value)}")
    if value[2:] != [0] and len(range(*value)) > MOST_VALUES:
        raise fault(f"has at most {MOST_VALUES:,} values, got {len(range(*value)):,}")
    if value[2:] == [0] or not range(*value):
        raise fault(f"has no values: range({', '.join(map(str, value))}) is empty")
    return value


def bounds(value: Any) -> list[float]:
    """The lowest and the highest value."""
    value = items(value)
    if len(value) != 2:
        raise fault(f"must be [lowest, highest], got {shown(value)}")
    low, high = number_list(value)
    if not low < high:
        raise fault(f"the lowest must be below the highest, got {shown(value)}")
    return [low, high]


def positive_bounds(value: Any) -> list[float]:
    """The same, both positive."""
    value = bounds(value)
    if not value[0] > 0.0:
        raise fault(f"has equal ratios, so that both bounds must be positive, got {shown(value)}")
    return value


def whole_bounds(value: Any) -> list[int]:
    """The same in whole numbers."""
    low, high = bounds(value)
    if not (low.is_integer() and high.is_integer()):
        raise fault(f"must be whole numbers, got {shown(value)}; of others make it 'uniform'")
    if max(abs(low), abs(high)) > LARGEST:
        raise fault(f"must be whole numbers of at most {LARGEST:,}, got {shown(value)}")
    return [int(low), int(high)]
