"""Axes of a sweep: what may stand beside a path of the scene.

    a list of values, {linspace: [5, 50, 10]}, ...         gone through, one value after the other
    {uniform: [-0.01, 0.01]}, {normal: {mean: ...}}, ...   drawn at random, anew for every run

What is gone through is a sequence that is computed entry by entry, however long it is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

from pydantic import BeforeValidator, model_validator
from typing_extensions import Self

from multiarm.scene.faults import fault, listed
from multiarm.scene.values import Number, Positive, Spec
from multiarm.sweeps.axis_values import (
    bounds,
    counted,
    exponents,
    items,
    positive_bounds,
    ratios,
    spaced,
    whole_bounds,
)
from multiarm.sweeps.draws import Law, LogNormal, LogUniform, Normal, OneOf, Uniform

__all__ = ["Axis", "AxisSpec", "paths_of"]


@dataclass(frozen=True)
class Axis:
    """What happens to one path of the scene, or to several that move together.

    Attributes
    ----------
    paths : tuple of str
    written : str
        How the key is written in the sweep file.
    spec : AxisSpec
    """

    paths: tuple[str, ...]
    written: str
    spec: AxisSpec

    @property
    def drawn(self) -> bool:
        """Whether its values are drawn at random."""
        return self.spec.law is not None

    @property
    def count(self) -> int:
        """How many values are gone through; 1 of what is drawn."""
        return 1 if self.drawn else len(self.spec.steps)

    def at(self, number: int) -> dict[str, Any]:
        """Path -> value, of a value that is gone through, counted from 0."""
        return self._changes(self.spec.steps[number])

    def drawn_at(self, u: float) -> dict[str, Any]:
        """Path -> value, of the value below which a share ``u`` of all lies."""
        assert self.spec.law is not None, "the axis is drawn"
        return self._changes(self.spec.law.quantile(u))

    def _changes(self, value: Any) -> dict[str, Any]:
        own = value if self.spec.rows is not None else [value] * len(self.paths)
        return dict(zip(self.paths, own, strict=True))


@dataclass(frozen=True)
class _Spaced(Sequence):
    """Values from one bound to the other: at equal differences, or as ``between`` has them."""

    start: float
    stop: float
    size: int
    between: Callable[[float, float, float], float] | None = None

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, number: Any) -> Any:
        k = range(self.size)[number]
        if k == 0:
            return self.start
        if k == self.size - 1:
            return self.stop
        if self.between is not None:
            return self.between(self.start, self.stop, k / (self.size - 1))
        # the steps that NumPy takes
        return self.start + k * ((self.stop - self.start) / (self.size - 1))


def _in_ratio(start: float, stop: float, share: float) -> float:
    low, high = math.log10(start), math.log10(stop)
    return 10.0 ** (low + share * (high - low))


def paths_of(key: str) -> tuple[str, ...]:
    """The paths in a key of ``over``: one, or several with commas between them."""
    parts = re.split(r""",(?=(?:[^'"]|'[^']*'|"[^"]*")*$)""", key)
    return tuple(part.strip() for part in parts)


# So many deviations above its median a drawn value may be.
FARTHEST = 9.0


class NormalSpec(Spec):
    """Bell curve: mean and standard deviation, in the unit of the value."""

    mean: Number
    deviation: Positive


class LogNormalSpec(Spec):
    """Median, and the standard deviation of the natural logarithm, about the relative one."""

    median: Positive
    deviation: Positive

    @model_validator(mode="after")
    def _stays_finite(self) -> Self:
        if math.log(self.median) + FARTHEST * self.deviation > math.log(1e300):
            raise fault(
                f"values {FARTHEST:g} deviations above the median are beyond all numbers; the "
                f"deviation is that of the logarithm, 0.1 spreads by a tenth"
            )
        return self


class AxisSpec(Spec):
    """One of these.

    Attributes
    ----------
    values : list
        Gone through; may be written as the list alone.
    linspace, logspace, geomspace : [first, last, how many]
        With equal differences; powers of ten with equally spaced exponents; with equal ratios.
    range : [stop], [start, stop] or [start, stop, step]
        Whole numbers, without the stop.
    rows : list of lists
        For several paths that move together: a value for each of them.
    uniform, loguniform : [lowest, highest]
        Drawn.
    normal : {mean, deviation}
    lognormal : {median, deviation}
    integers : [lowest, highest]
        Both can be drawn.
    choice : list
    """

    values: Annotated[list[Any] | None, BeforeValidator(items)] = None
    linspace: Annotated[list[Any] | None, BeforeValidator(spaced)] = None
    logspace: Annotated[list[Any] | None, BeforeValidator(exponents)] = None
    geomspace: Annotated[list[Any] | None, BeforeValidator(ratios)] = None
    range: Annotated[list[int] | None, BeforeValidator(counted)] = None
    rows: Annotated[list[Any] | None, BeforeValidator(items)] = None
    uniform: Annotated[list[float] | None, BeforeValidator(bounds)] = None
    loguniform: Annotated[list[float] | None, BeforeValidator(positive_bounds)] = None
    normal: NormalSpec | None = None
    lognormal: LogNormalSpec | None = None
    integers: Annotated[list[int] | None, BeforeValidator(whole_bounds)] = None
    choice: Annotated[list[Any] | None, BeforeValidator(items)] = None

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        if len(self.model_fields_set) != 1:
            given = listed(self.model_fields_set) if self.model_fields_set else "nothing"
            raise fault(
                f"must be a list of values or a table with one of "
                f"{', '.join(type(self).model_fields)}; got {given}"
            )
        if getattr(self, self.name) is None:
            raise fault(f"'{self.name}' is empty; write what it takes behind it")
        return self

    @property
    def name(self) -> str:
        """Which of them it is."""
        return next(iter(self.model_fields_set))

    @cached_property
    def steps(self) -> Sequence[Any]:
        """The values that are gone through; empty where they are drawn."""
        given = getattr(self, self.name)
        return _STEPS[self.name](given) if self.name in _STEPS else ()

    @cached_property
    def law(self) -> Law | None:
        """The law by which values are drawn; None where they are gone through."""
        given = getattr(self, self.name)
        return _LAWS[self.name](given) if self.name in _LAWS else None

    def written(self) -> Any:
        """The axis as it stands in a sweep file."""
        return self.values if self.values is not None else self.model_dump(exclude_unset=True)


_STEPS: dict[str, Callable[[Any], Sequence[Any]]] = {
    "values": lambda given: given,
    "rows": lambda given: given,
    "range": lambda given: range(*given),
    "linspace": lambda given: _Spaced(*given),
    "geomspace": lambda given: _Spaced(given[0], given[1], given[2], _in_ratio),
    "logspace": lambda given: _Spaced(10.0 ** given[0], 10.0 ** given[1], given[2], _in_ratio),
}
_LAWS: dict[str, Callable[[Any], Law]] = {
    "uniform": lambda given: Uniform(*given),
    "loguniform": lambda given: LogUniform(*given),
    "normal": lambda given: Normal(given.mean, given.deviation),
    "lognormal": lambda given: LogNormal(given.median, given.deviation),
    "integers": lambda given: OneOf(range(given[0], given[1] + 1)),
    "choice": OneOf,
}
