"""Axes of a sweep: the values of one path of the scene, or of several that vary together.

a list of values, {linspace: [5, 50, 10]}, ...         enumerated, one value after the other
{uniform: [-0.01, 0.01]}, {normal: {mean: ...}}, ...   drawn at random, independently each run
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from typing_extensions import Self

from multiarm.errors import SceneError
from multiarm.scene import parse_path
from multiarm.scene.faults import invalid, shown
from multiarm.scene.spec import OneOf, Spec
from multiarm.scene.values import Number, Positive, Range, is_integer, list_of, rising


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
    raise invalid(
        f"{shown(value)} is nothing that a YAML file can hold; give numbers, texts, lists"
    )


def _whole(value: Any) -> Any:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not is_integer(value):
        raise invalid(f"must be a whole number, got {shown(value)}")
    return int(value)


# Values that an axis may have, and its largest whole number: up to there floats are exact.
MOST_VALUES, LARGEST = 10**6, 2**53

Count = Annotated[int, Field(ge=1), BeforeValidator(_whole)]
NonNegativeCount = Annotated[int, Field(ge=0), BeforeValidator(_whole)]
_ValueCount = Annotated[int, Field(ge=1, le=MOST_VALUES), BeforeValidator(_whole)]
_Whole = Annotated[int, Field(ge=-LARGEST, le=LARGEST), BeforeValidator(_whole)]
_Spaced = Annotated[
    tuple[Number, Number, _ValueCount], list_of("must be [first, last, how many]", 3)
]


def _exponents(numbers: tuple) -> tuple:
    if max(abs(numbers[0]), abs(numbers[1])) > 300.0:
        raise invalid(f"are exponents of ten, of at most 300, got {shown(numbers)}")
    return numbers


def _in_ratio(numbers: tuple) -> tuple:
    """The numbers, of which the first two are bounds of values with equal ratios."""
    first, last = numbers[:2]
    if not (first > 0.0 and last > 0.0):
        raise invalid(
            f"has equal ratios, so that both bounds must be positive, got {shown(numbers)}"
        )
    if not 0.0 < last / first < math.inf:
        raise invalid(f"spans more than floats have room for, got {shown(numbers)}")
    return numbers


def _with_values(arguments: tuple[int, ...]) -> tuple[int, ...]:
    if len(arguments) not in (1, 2, 3) or arguments[2:] == (0,) or not range(*arguments):
        raise invalid(
            "must be [stop], [start, stop] or [start, stop, step] as Python's range takes them, "
            f"with at least one value, got {shown(arguments)}"
        )
    if len(range(*arguments)) > MOST_VALUES:
        raise invalid(f"has at most {MOST_VALUES:,} values, got {len(range(*arguments)):,}")
    return arguments


_WholeRange = Annotated[
    tuple[_Whole, _Whole],
    list_of("must be whole numbers [lowest, highest]", 2),
    AfterValidator(rising),
]
_Values = Annotated[
    list[Any],
    list_of("must be a list of at least one value", least=1),
    BeforeValidator(plain_value),
]


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
            raise invalid(
                "values 9 deviations above the median exceed the range of floats; the deviation "
                "is that of the logarithm: 0.1 is a relative deviation of a tenth"
            )
        return self


def _standard_normal(u: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(u))


def paths_of(key: str) -> tuple[str, ...]:
    """The paths in a key of ``over``: one, or several separated by commas."""
    parts = re.split(r""",(?=(?:[^'"]|'[^']*'|"[^"]*")*$)""", key)
    return tuple(part.strip() for part in parts)


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


class AxisSpec(OneOf):
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

    values: _Values | None = None
    linspace: _Spaced | None = None
    logspace: Annotated[_Spaced, AfterValidator(_exponents)] | None = None
    geomspace: Annotated[_Spaced, AfterValidator(_in_ratio)] | None = None
    range: Annotated[tuple[_Whole, ...], AfterValidator(_with_values)] | None = None
    rows: _Values | None = None
    uniform: Range | None = None
    loguniform: Annotated[Range, AfterValidator(_in_ratio)] | None = None
    normal: NormalSpec | None = None
    lognormal: LogNormalSpec | None = None
    integers: _WholeRange | None = None
    choice: _Values | None = None

    @property
    def name(self) -> str:
        """The key that is there."""
        return next(name for name, content in self if content is not None)

    @property
    def drawn(self) -> bool:
        """Whether values are drawn at random."""
        return self.name in QUANTILES

    @cached_property
    def values_in_turn(self) -> list[Any]:
        """The enumerated values; none if they are drawn."""
        return [] if self.drawn else VALUES[self.name](getattr(self, self.name))

    @property
    def count(self) -> int:
        """Number of enumerated values; 1 if they are drawn."""
        return 1 if self.drawn else len(self.values_in_turn)

    def at(self, place: Any, paths: int) -> Sequence[Any]:
        """The values of so many paths that vary together.

        ``place`` is the number of an enumerated value, from 0 on; of a drawn one the quantile u in
        (0, 1).
        """
        if self.rows is not None:
            return self.rows[int(place)]
        if self.drawn:
            value = QUANTILES[self.name](getattr(self, self.name), place)
        else:
            value = self.values_in_turn[int(place)]
        return [value] * paths

    def problems(self, key: str) -> Iterator[str]:
        """What is wrong with the paths in its key, and with their number."""
        paths = paths_of(key)
        for path in paths:
            try:
                parse_path(path)
            except SceneError as error:
                yield from (fault.problem for fault in error.faults)
        for k, row in enumerate(self.rows or ()):
            if not isinstance(row, list) or len(row) != len(paths):
                yield (
                    f"rows[{k}] must be a list of {len(paths)}, a value for each path, got "
                    f"{shown(row)}"
                )

    def written(self) -> Any:
        """The axis as in a sweep file."""
        written = self.model_dump(mode="json", include={self.name})
        return written.get("values", written)
