"""Axes of a sweep: the values of one path of the scene, or of several that vary together.

a list of values, {linspace: [5, 50, 10]}, ...         enumerated, one value after the other
{uniform: [-0.01, 0.01]}, {normal: {mean: ...}}, ...   drawn at random, independently each run
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from numbers import Integral
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from typing_extensions import Self

from multiarm.scene.faults import fault, listed, shown
from multiarm.scene.values import Number, Positive, Spec, number_list

__all__ = ["Axis", "AxisSpec", "Count", "NonNegativeCount", "is_integer", "paths_of", "plain_value"]


def plain_value(value: Any) -> Any:
    """The value in types that a YAML file can hold; a fault if there are none."""
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


def is_integer(value: Any) -> bool:
    """Whether a value is an integer of Python or NumPy; a truth value is none."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def _integer(least: int, value: Any) -> int:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not is_integer(value):
        raise fault(f"must be a whole number, got {shown(value)}")
    if value < least:
        raise fault(f"must be at least {least}, got {value}")
    return int(value)


# Values that an axis may have, and its largest whole number: up to there floats are exact.
MOST_VALUES, LARGEST = 10**6, 2**53


Count = Annotated[int, Field(ge=1), BeforeValidator(partial(_integer, 1))]
NonNegativeCount = Annotated[int, Field(ge=0), BeforeValidator(partial(_integer, 0))]


def items(value: Any) -> list[Any]:
    """A list of at least one value."""
    value = plain_value(value)
    if not isinstance(value, list) or not value:
        raise fault(f"must be a list of at least one value, got {shown(value)}")
    return value


def spaced(value: Any) -> list[Any]:
    """First value, last value and number of values."""
    value = items(value)
    if len(value) != 3:
        raise fault(f"must be [first, last, how many], got {shown(value)}")
    try:
        count = _integer(1, value[2])
    except Exception as error:
        raise fault(f"how many values there are, the third entry, {error}") from None
    if count > MOST_VALUES:
        raise fault(f"has at most {MOST_VALUES:,} values, got {count:,}")
    return [*number_list(value[:2]), count]


def exponents(value: Any) -> list[Any]:
    """First exponent of ten, last one and number of values."""
    value = spaced(value)
    if max(abs(value[0]), abs(value[1])) > 300.0:
        raise fault(f"are exponents of ten, of at most 300, got {shown(value)}")
    return value


def in_ratio(value: list[Any]) -> list[Any]:
    """The list, whose first two numbers are bounds of values with equal ratios."""
    if not (value[0] > 0.0 and value[1] > 0.0):
        raise fault(f"has equal ratios, so that both bounds must be positive, got {shown(value)}")
    if not 0.0 < value[1] / value[0] < math.inf:
        raise fault(f"spans more than floats have room for, got {shown(value)}")
    return value


def counted(value: Any) -> list[int]:
    """Arguments of Python's range."""
    value = items(value)
    if len(value) > 3 or not all(map(is_integer, value)):
        raise fault(
            f"must be whole numbers [stop], [start, stop] or [start, stop, step] as Python's range "
            f"takes them, got {shown(value)}; of other numbers make a 'linspace'"
        )
    if max(map(abs, value)) > LARGEST:
        raise fault(f"must be whole numbers of at most {LARGEST:,}, got {shown(value)}")
    numbers = () if value[2:] == [0] else range(*value)
    if len(numbers) > MOST_VALUES:
        raise fault(f"has at most {MOST_VALUES:,} values, got {len(numbers):,}")
    if not numbers:
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


def whole_bounds(value: Any) -> list[int]:
    """The lowest and the highest value, both whole numbers."""
    low, high = bounds(value)
    if not (low.is_integer() and high.is_integer()):
        raise fault(f"must be whole numbers, got {shown(value)}; of others make it 'uniform'")
    if max(abs(low), abs(high)) > LARGEST:
        raise fault(f"must be whole numbers of at most {LARGEST:,}, got {shown(value)}")
    return [int(low), int(high)]


class NormalSpec(Spec):
    """Normal distribution: mean and standard deviation, in the unit of the value."""

    mean: Number
    deviation: Positive


class LogNormalSpec(Spec):
    """Median, and the standard deviation of the natural logarithm, about the relative one."""

    median: Positive
    deviation: Positive

    @model_validator(mode="after")
    def _stays_finite(self) -> Self:
        if math.log(self.median) + 9.0 * self.deviation > math.log(1e300):
            raise fault(
                "values 9 deviations above the median exceed the range of floats; the deviation "
                "is that of the logarithm: 0.1 is a relative deviation of a tenth"
            )
        return self


def _standard_normal(u: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(u))


VALUES: dict[str, Callable[[Any], list[Any]]] = {
    "values": list,
    "linspace": lambda v: np.linspace(*v).tolist(),
    "logspace": lambda v: np.logspace(*v).tolist(),
    "geomspace": lambda v: np.geomspace(*v).tolist(),
    "range": lambda v: list(range(*v)),
    "rows": list,
}
"""Kinds of axes whose values come one after the other: all of them, as given."""
QUANTILES: dict[str, Callable[[Any, float], Any]] = {
    "uniform": lambda v, u: v[0] + u * (v[1] - v[0]),
    "loguniform": lambda v, u: v[0] * (v[1] / v[0]) ** u,
    "normal": lambda v, u: v.mean + v.deviation * _standard_normal(u),
    "lognormal": lambda v, u: v.median * math.exp(v.deviation * _standard_normal(u)),
    "integers": lambda v, u: v[0] + int(u * (v[1] + 1 - v[0])),
    "choice": lambda v, u: v[int(u * len(v))],
}
"""Kinds whose values are random: the quantile Q(u), a share u in (0, 1) of all values is below."""


class AxisSpec(Spec):
    """The values of an axis; exactly one of these keys.

    Attributes
    ----------
    values : list
        Enumerated; the list alone means the same.
    linspace, logspace, geomspace : [first, last, how many]
        With equal differences; powers of ten with equally spaced exponents; with equal ratios.
    range : [stop], [start, stop] or [start, stop, step]
        Whole numbers, without the stop.
    rows : list of lists
        For several paths that vary together: a value for each of them.
    uniform, loguniform : [lowest, highest]
        Drawn at random, like the following ones.
    normal : {mean, deviation}
        Drawn from a normal distribution.
    lognormal : {median, deviation}
        Drawn so that its logarithm is normally distributed.
    integers : [lowest, highest]
        Whole numbers; both ends are included.
    choice : list
        One of these, drawn at random.
    """

    model_config = ConfigDict(json_schema_extra={"minProperties": 1, "maxProperties": 1})

    values: Annotated[list[Any] | None, BeforeValidator(items)] = None
    linspace: Annotated[list[Any] | None, BeforeValidator(spaced)] = None
    logspace: Annotated[list[Any] | None, BeforeValidator(exponents)] = None
    geomspace: Annotated[
        list[Any] | None, BeforeValidator(lambda value: in_ratio(spaced(value)))
    ] = None
    range: Annotated[list[int] | None, BeforeValidator(counted)] = None
    rows: Annotated[list[Any] | None, BeforeValidator(items)] = None
    uniform: Annotated[list[float] | None, BeforeValidator(bounds)] = None
    loguniform: Annotated[
        list[float] | None, BeforeValidator(lambda value: in_ratio(bounds(value)))
    ] = None
    normal: NormalSpec | None = None
    lognormal: LogNormalSpec | None = None
    integers: Annotated[list[int] | None, BeforeValidator(whole_bounds)] = None
    choice: Annotated[list[Any] | None, BeforeValidator(items)] = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        known = type(self).model_fields
        keys = [key for key in known if key in self.model_fields_set]
        if len(keys) != 1:
            raise fault(
                f"must be a list of values or a table with one of {', '.join(known)}; got "
                f"{listed(keys) if keys else 'nothing'}"
            )
        if self.content is None:
            raise fault(f"'{self.name}' is empty; write its values after the colon")
        return self

    @property
    def name(self) -> str:
        """The key."""
        return next(iter(self.model_fields_set))

    @property
    def content(self) -> Any:
        """What stands below the key."""
        return getattr(self, self.name)

    @property
    def drawn(self) -> bool:
        """Whether values are drawn at random."""
        return self.name in QUANTILES

    @cached_property
    def values_in_turn(self) -> list[Any]:
        """The enumerated values; none if they are drawn."""
        return [] if self.drawn else VALUES[self.name](self.content)

    def value(self, place: Any) -> Any:
        """The enumerated value of a number from 0 on; a drawn one at the quantile u in (0, 1)."""
        if self.drawn:
            return QUANTILES[self.name](self.content, place)
        return self.values_in_turn[place]

    def written(self) -> Any:
        """The axis as in a sweep file."""
        return self.values if self.values is not None else self.model_dump(exclude_unset=True)


@dataclass(frozen=True)
class Axis:
    """The values of one path of the scene, or of several that vary together."""

    paths: tuple[str, ...]
    written: str  # the key in the sweep file
    spec: AxisSpec

    @property
    def drawn(self) -> bool:
        """Whether its values are drawn at random."""
        return self.spec.drawn

    @property
    def count(self) -> int:
        """Number of enumerated values; 1 if they are drawn."""
        return 1 if self.drawn else len(self.spec.values_in_turn)

    def at(self, place: Any) -> dict[str, Any]:
        """Path -> value, see :meth:`AxisSpec.value`."""
        value = self.spec.value(place)
        values = value if self.spec.rows is not None else [value] * len(self.paths)
        return dict(zip(self.paths, values, strict=True))


def paths_of(key: str) -> tuple[str, ...]:
    """The paths in a key of ``over``: one, or several separated by commas."""
    parts = re.split(r""",(?=(?:[^'"]|'[^']*'|"[^"]*")*$)""", key)
    return tuple(part.strip() for part in parts)
