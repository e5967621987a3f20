"""A sweep file: which values of the scene vary and how, and which outputs are kept.

The values of all runs are a table, which follows from the file alone.

    run = 1 + point * repeat + repetition

The points of the grid go through the axes with the last one fastest.  A random value is the
quantile Q(u) of a number u in (0, 1), so that one sampler serves all kinds:

    random            u = Philox(seed, run), independent for every run
    latin_hypercube   the runs of one grid point fill `repeat` layers of every axis once
    sobol             the runs of one grid point are a scrambled Sobol sequence

The last two are SciPy's; every grid point has its own sample, keyed by the seed and the point.
:mod:`multiarm.sweeps.plan` checks a sweep against a scene.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import pandas
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, WithJsonSchema

from multiarm.errors import Fault, SceneError, SweepError
from multiarm.scene import STEPS_CHOSEN_BY
from multiarm.scene.code import located
from multiarm.scene.faults import explain, fault_at, invalid, shown, unknown
from multiarm.scene.spec import Spec
from multiarm.scene.text import parse_yaml, read_text, written_yaml
from multiarm.scene.values import is_integer
from multiarm.sweeps.axes import (
    AxisSpec,
    Count,
    NonNegativeCount,
    paths_of,
    plain_value,
)
from multiarm.sweeps.quantities import KNOWN, MEASURED, UserQuantity

DEFAULT_KEEP = (
    "final_position_error",
    "final_rotation_error",
    "largest_contact_force",
    "position_drift",
    "energy_balance",
)
"""Outputs of a sweep that names none."""


def _entry(value: Any) -> Any:
    """A quantity by name, or a function: a table, the text that names it, or the function."""
    if callable(value) or (isinstance(value, str) and ":" in value):
        value = {"function": value}
    if isinstance(value, (Mapping, UserQuantity)):
        return TypeAdapter(UserQuantity).validate_python(value)
    if isinstance(value, str) and (value in KNOWN or value == MEASURED):
        return value
    names = [*KNOWN, MEASURED]
    problem = unknown("quantity", value, names, "quantities")
    raise invalid(f"{problem}; your own quantity is 'file.py:name', f(trajectory) -> number")


_Name = Annotated[
    str,
    WithJsonSchema({"anyOf": [{"enum": [*KNOWN, MEASURED]}, {"type": "string", "pattern": ":"}]}),
]
QuantityEntry = Annotated[UserQuantity | _Name, BeforeValidator(_entry)]
"""An entry of ``keep``: the name of a quantity, or an :class:`UserQuantity`."""


def _axis(value: Any) -> Any:
    if isinstance(value, (Mapping, AxisSpec)):
        return value
    return {"values": value}


_AXIS = BeforeValidator(_axis, json_schema_input_type=AxisSpec | list[Any])


def _by_text(value: Any) -> Any:
    """The table with strings as keys; in Python a key may be a tuple of paths."""
    if not isinstance(value, Mapping) or not value:
        raise invalid(
            "must be a table 'path: values' with at least one path of the scene, such as "
            f"(object.mass: [5, 10, 20]), got {shown(value)}"
        )
    return {
        ", ".join(key) if isinstance(key, tuple) else str(key): axis for key, axis in value.items()
    }


def _plain_table(value: Any) -> Any:
    if not isinstance(value, Mapping):
        raise invalid(f"must be a table of entries of the scene's 'run', got {shown(value)}")
    return plain_value(value)


class Column(NamedTuple):
    """A column of a sweep's table."""

    name: str
    unit: str = ""
    words: str = ""


FIRST = (
    Column("run", words="number of the run, from 1 on"),
    Column("status", words="how it ended"),
    Column("message", words="why it did not complete"),
)
LAST = (
    Column("wall_time", "s", "time that it took"),
    Column("worker", words="computer and process that ran it"),
)
"""Columns that may differ when a run is repeated."""
_TAKEN = {column.name for column in (*FIRST, *LAST)}


class SweepSpec(Spec):
    """A sweep as it is written.

    Attributes
    ----------
    over : table
        A table 'path: values' of what varies, such as (object.mass: [5, 10]).  Several paths of the
        scene, separated by commas, vary together.
    combine : 'product' or 'zip'
        Every value of an axis with every one of the others; or the first with the first, and so on.
    repeat : int
        Runs of each point of the grid; needs random axes.
    sampling : 'random', 'latin_hypercube' or 'sobol'
        How the random axes are sampled.
    seed : int
        Of all random samples.
    keep : list
        Outputs: quantities.
    certificate : bool
        Check runs of some accuracy, as :func:`multiarm.simulate` does.
    run : table
        Replaces entries of the scene's ``run``.
    """

    over: Annotated[dict[str, Annotated[AxisSpec, _AXIS]], BeforeValidator(_by_text)]
    combine: Literal["product", "zip"] = "product"
    repeat: Count = 1
    sampling: Literal["random", "latin_hypercube", "sobol"] = "random"
    seed: NonNegativeCount = 0
    keep: tuple[QuantityEntry, ...] = DEFAULT_KEEP
    certificate: bool = True
    run: Annotated[dict[str, Any], BeforeValidator(_plain_table)] = Field(default_factory=dict)

    @property
    def count(self) -> int:
        """Number of runs."""
        counts = [axis.count for axis in self.over.values() if not axis.drawn]
        return self.repeat * math.prod(counts[:1] if self.combine == "zip" else counts)

    @property
    def paths(self) -> tuple[str, ...]:
        """The paths that vary, each the name of a column: ``$.run`` is the path ``run``."""
        paths = [path for key in self.over for path in paths_of(key)]
        return tuple(f"$.{path}" if path in _TAKEN else path for path in paths)

    @property
    def outputs(self) -> tuple[Column, ...]:
        """The quantities, each by its own name."""
        outputs: list[Column] = []
        for entry in self.keep:
            if isinstance(entry, UserQuantity):
                outputs += [Column(name, entry.unit, entry.words) for name in entry.names]
            elif entry != MEASURED:
                outputs.append(Column(entry, *KNOWN[entry][:2]))
        return tuple(outputs)

    @property
    def quantities(self) -> tuple[Column, ...]:
        """Columns of the quantities; one whose name another column has is prefixed."""
        taken = {*_TAKEN, *self.paths}
        return tuple(
            column._replace(name=f"quantity {column.name}") if column.name in taken else column
            for column in self.outputs
        )

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the table."""
        values = (Column(path, words="value in the scene") for path in self.paths)
        return (*FIRST, *values, *self.quantities, *LAST)

    @cached_property
    def table(self) -> pandas.DataFrame:
        """The values of all runs, numbered from 1 on: a row for each, a column for each path."""
        counts = [range(axis.count) for axis in self.over.values() if not axis.drawn]
        zipped = self.combine == "zip" and bool(counts)
        points = list(zip(*counts, strict=True) if zipped else itertools.product(*counts))
        grid = np.array(points, dtype=int).reshape(len(points), len(counts))
        in_turn = iter(np.repeat(grid, self.repeat, axis=0).T.tolist())
        quantiles = iter(_samples(self, len(points)).T.tolist())
        columns: list[Sequence[Any]] = []
        for key, axis in self.over.items():
            places = next(quantiles if axis.drawn else in_turn)
            columns += zip(*(axis.at(at, len(paths_of(key))) for at in places), strict=True)
        runs = pandas.RangeIndex(1, self.count + 1, name="run")
        table = dict(zip(self.paths, map(list, columns), strict=True))
        return pandas.DataFrame(table, index=runs, dtype=object)

    def values(self, run: int) -> dict[str, Any]:
        """Path -> value in the scene of a run; raises a SweepError when there is no such run."""
        if not is_integer(run) or not 1 <= run <= self.count:
            raise SweepError(f"there is no run {run}; runs are 1 to {self.count}")
        return self.table.loc[run].to_dict()

    def text(self) -> str:
        """Canonical YAML that :func:`parse_sweep` reads back."""
        data = {
            "over": {key: axis.written() for key, axis in self.over.items()},
            **self.model_dump(mode="json", exclude_none=True, exclude={"over", "run"}),
            "run": self.run,
        }
        return written_yaml(data)


_SMALLEST = 2.0**-54
"""Distance of u from 0 and 1, where many quantiles are infinite."""


def _samples(spec: SweepSpec, points: int) -> np.ndarray:
    """Numbers in (0, 1) for the drawn axes, shape (points * repeat, axes)."""
    from scipy.stats.qmc import LatinHypercube, Sobol

    axes, repeat = sum(axis.drawn for axis in spec.over.values()), spec.repeat

    def generator(key: int) -> np.random.Generator:
        return np.random.Generator(
            np.random.Philox(np.random.SeedSequence(spec.seed, spawn_key=(key,)))
        )

    if axes == 0:
        return np.zeros((points * repeat, 0))
    if spec.sampling == "random":
        u = np.array([generator(run).random(axes) for run in range(1, points * repeat + 1)])
    elif spec.sampling == "latin_hypercube":
        u = np.vstack(
            [LatinHypercube(axes, rng=generator(p)).random(repeat) for p in range(points)]
        )
    else:
        sequences = (Sobol(axes, rng=generator(point)) for point in range(points))
        u = np.vstack([sequence.random(1) for sequence in sequences for _ in range(repeat)])
    return np.clip(u, _SMALLEST, 1.0 - 2.0 * _SMALLEST)


def parse_sweep(source: str | Mapping[str, Any]) -> SweepSpec:
    """The sweep that a YAML text or a table describes.

    Raises
    ------
    SweepError
        Naming every fault.
    """
    try:
        spec, faults = examined(parse_yaml(source) if isinstance(source, str) else source)
    except SceneError as error:
        raise SweepError(error.faults) from None
    if faults or spec is None:
        raise SweepError(faults)
    return spec


def read_sweep(
    source: str | os.PathLike | Mapping[str, Any] | None, changes: Mapping[str, Any]
) -> tuple[Any, Path]:
    """The table of a sweep, from a file or from Python, and the folder of its relative paths.

    Parameters
    ----------
    source : path or mapping, optional
        A YAML file, its content as a table, or its ``over`` alone.
    changes : mapping
        Keys of a sweep that replace those in ``source``.  Entries of ``run`` are replaced one by
        one.

    Raises
    ------
    SweepError
        When the file cannot be read, or is not YAML; when the source is none of these.
    """
    if not (source is None or isinstance(source, (str, os.PathLike, Mapping))):
        problem = (
            "must be the path of a sweep file, or a table 'path: values' of what varies, such as "
            f"{{'object.mass': [5, 10]}}, got {shown(source)}"
        )
        raise SweepError([fault_at(("over",), problem)])
    if source is None or isinstance(source, Mapping):
        data: Any = source or {}
        folder = Path()
        if data and "over" not in data:
            data = {"over": data}
    else:
        path = None
        try:
            text = read_text(source, "sweep")
            path = str(source)  # where the faults of the text are
            data = parse_yaml(text)
        except SceneError as error:
            raise SweepError(error.faults, source=path) from None
        folder = Path(source).expanduser().parent
    if not isinstance(data, Mapping):
        return data, folder
    merged = {**data, **changes}
    old, new = data.get("run"), changes.get("run")
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        replaced = STEPS_CHOSEN_BY if set(STEPS_CHOSEN_BY).intersection(new) else ()
        merged["run"] = {**{k: v for k, v in old.items() if k not in replaced}, **new}
    return merged, folder


def examined(data: Any, folder: Path = Path()) -> tuple[SweepSpec | None, list[Fault]]:
    """The sweep that a table describes, without its faulty parts, and the faults.

    The sweep is None if too little is valid. Relative paths of functions start at ``folder``.
    """
    if not isinstance(data, Mapping):
        keys = ", ".join(SweepSpec.model_fields)
        problem = f"a sweep is a table with the keys {keys}; got {shown(data)}"
        return None, [fault_at((), problem)]
    faults: list[Fault] = []
    reader = TypeAdapter(SweepSpec)
    for _ in range(2):
        try:
            return located(reader.validate_python(data), folder.expanduser().resolve()), faults
        except ValidationError as error:
            faults = faults or explain(error, SweepSpec)
            data = _without(data, [details["loc"] for details in error.errors()])
    return None, faults


def _without(data: Mapping[str, Any], places: Sequence[tuple]) -> dict[str, Any]:
    """A sweep's table without its faulty parts: single paths, single quantities, else keys."""
    faulty = {at[:2] if at[0] in ("over", "keep") else at[:1] for at in places}
    valid = {key: value for key, value in data.items() if (key,) not in faulty}
    if isinstance(valid.get("over"), Mapping):
        over = _by_text(valid["over"]).items()
        valid["over"] = {key: axis for key, axis in over if ("over", key) not in faulty}
    if isinstance(valid.get("keep"), (list, tuple)):
        keep = enumerate(valid["keep"])
        valid["keep"] = [entry for k, entry in keep if ("keep", k) not in faulty]
    return valid
