"""The schema of a sweep file: which values of the scene vary, how, and which outputs are kept.

This module checks the text only; :mod:`multiarm.sweeps.checking` checks it against a scene.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError, WithJsonSchema

from multiarm.errors import Fault, SceneError, SweepError
from multiarm.scene import STEPS_CHOSEN_BY, function_text
from multiarm.scene.code import UserFunction, located
from multiarm.scene.faults import explain, fault, fault_at, shown, unknown
from multiarm.scene.text import parse_yaml, read_text
from multiarm.scene.values import Spec
from multiarm.sweeps.axes import Axis, AxisSpec, Count, NonNegativeCount, paths_of, plain_value
from multiarm.sweeps.quantities import KNOWN, MEASURED, Quantity, digest

__all__ = [
    "DEFAULT_KEEP",
    "QuantityEntry",
    "SweepSpec",
    "UserQuantity",
    "examined",
    "parse_sweep",
    "read_sweep",
]


DEFAULT_KEEP = (
    "final_position_error",
    "final_rotation_error",
    "largest_contact_force",
    "position_drift",
    "energy_balance",
)
"""Outputs of a sweep that names none."""


def _column(value: Any) -> str:
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_][\w.\-]*", value):
        raise fault(
            f"{shown(value)} cannot name a quantity; use letters, digits, '_', '-' and '.', with "
            "a letter first (names become columns of tables)"
        )
    return value


Column = Annotated[str, BeforeValidator(_column)]


class UserQuantity(Spec):
    """A user-defined function of a run's trajectory.

    Attributes
    ----------
    function : callable or str
        ``f(trajectory) -> number``, or its place: ``file.py:name``, ``package.module:name``.
    name : str, optional
        Of the quantity; by default the function's name.
    gives : list of str, optional
        The function returns a table with these names; each is a quantity ``name.entry``.
    unit, words : str
        Unit and description of the number.
    """

    function: UserFunction = Field(description="file.py:name of a function of the trajectory")
    name: Column | None = None
    gives: Annotated[tuple[Column, ...], Field(min_length=1)] | None = None
    unit: str = "1"
    words: str = ""

    def quantities(self) -> list[Quantity]:
        """The quantities that the function gives."""
        function_name = re.sub(
            r"\W", "", function_text(self.function).rpartition(":")[2].split(".")[-1]
        )
        name, text = self.name or function_name or "quantity", digest(self.function)
        if self.gives is None:
            return [Quantity(name, self.unit, self.words, self.function, None, text)]
        return [
            Quantity(f"{name}.{key}", self.unit, self.words, self.function, key, text)
            for key in self.gives
        ]


def _entry(value: Any) -> Any:
    """A quantity by name, or a function: a table, the text that names it, or the function."""
    if isinstance(value, (Mapping, UserQuantity)):
        return TypeAdapter(UserQuantity).validate_python(value)
    if callable(value) or (isinstance(value, str) and ":" in value):
        return TypeAdapter(UserQuantity).validate_python({"function": value})
    if isinstance(value, str) and (value in KNOWN or value == MEASURED):
        return value
    names = [*KNOWN, MEASURED]
    problem = unknown("quantity", value, names, "quantities")
    raise fault(f"{problem}; your own quantity is 'file.py:name', f(trajectory) -> number")


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
        raise fault(
            "must be a table 'path: values' with at least one path of the scene, such as "
            f"(object.mass: [5, 10, 20]), got {shown(value)}"
        )
    return {
        ", ".join(key) if isinstance(key, tuple) else str(key): axis for key, axis in value.items()
    }


def _plain_table(value: Any) -> Any:
    if not isinstance(value, Mapping):
        raise fault(f"must be a table of entries of the scene's 'run', got {shown(value)}")
    return plain_value(value)


class SweepSpec(Spec):
    """A sweep as it is written.

    Attributes
    ----------
    over : table
        Path of the scene, or several separated by commas, -> values.
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

    over: Annotated[dict[str, Annotated[AxisSpec, _AXIS]], BeforeValidator(_by_text)] = Field(
        description="a table 'path: values' of what varies, such as (object.mass: [5, 10])"
    )
    combine: Literal["product", "zip"] = "product"
    repeat: Count = 1
    sampling: Literal["random", "latin_hypercube", "sobol"] = "random"
    seed: NonNegativeCount = 0
    keep: tuple[QuantityEntry, ...] = DEFAULT_KEEP
    certificate: bool = True
    run: Annotated[dict[str, Any], BeforeValidator(_plain_table)] = Field(default_factory=dict)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """The axes, in the order of the file."""
        return tuple(Axis(paths_of(key), key, spec) for key, spec in self.over.items())

    def quantities(self) -> tuple[Quantity, ...]:
        """The outputs, except the wall time, which every record has anyway."""
        quantities: list[Quantity] = []
        for entry in self.keep:
            if isinstance(entry, UserQuantity):
                quantities += entry.quantities()
            elif entry != MEASURED:
                known = KNOWN[entry]
                quantities.append(Quantity(entry, known.unit, known.words))
        return tuple(quantities)

    def text(self) -> str:
        """Canonical YAML that :func:`parse_sweep` reads back."""
        data = {
            "over": {key: axis.written() for key, axis in self.over.items()},
            **self.model_dump(mode="json", exclude_none=True, exclude={"over", "run"}),
            "run": self.run,
        }
        return yaml.safe_dump(
            data, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100
        )


def parse_sweep(source: str | Mapping[str, Any], folder: Path | str | None = None) -> SweepSpec:
    """The sweep that a YAML text or a table describes; paths of functions start at ``folder``.

    Raises
    ------
    SweepError
        Naming every fault.
    """
    try:
        data = parse_yaml(source) if isinstance(source, str) else source
    except SceneError as error:
        raise SweepError(error.faults) from None
    spec, faults = examined(data, Path(folder or "."))
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
        When the file cannot be read, or is not YAML.
    """
    if source is None or isinstance(source, Mapping):
        data: Any = source or {}
        if data and "over" not in data:
            data = {"over": data}
        return _with(data, changes), Path()
    try:
        text = read_text(source, "sweep")
    except SceneError as error:
        raise SweepError(error.faults) from None
    try:
        data = parse_yaml(text)
    except SceneError as error:
        raise SweepError(error.faults, source=str(source)) from None
    folder = Path(source).expanduser().parent
    return _with(data, changes) if isinstance(data, Mapping) else data, folder


def examined(data: Any, folder: Path) -> tuple[SweepSpec | None, list[Fault]]:
    """The sweep that a table describes, without its faulty parts, and the faults.

    The sweep is None if too little is valid. Relative paths of functions start at ``folder``.
    """
    if not isinstance(data, Mapping):
        keys = ", ".join(SweepSpec.model_fields)
        problem = f"a sweep is a table with the keys {keys}; got {shown(data)}"
        return None, [fault_at((), problem)]
    folder = folder.expanduser().resolve()
    reader = TypeAdapter(SweepSpec)
    try:
        return located(reader.validate_python(dict(data)), folder), []
    except ValidationError as error:
        faults = explain(error, SweepSpec)
        valid = _without(data, [details["loc"] for details in error.errors()])
    try:
        return located(reader.validate_python(valid), folder), faults
    except ValidationError:
        return None, faults


def _without(data: Mapping[str, Any], faults: Sequence[Sequence[Any]]) -> dict[str, Any]:
    """A sweep's table without its faulty parts: single paths, single quantities, else keys."""
    places = [tuple(loc) for loc in faults]
    faulty_keys = {loc[0] for loc in places if len(loc) == 1 or loc[0] not in ("over", "keep")}
    valid = {key: value for key, value in data.items() if key not in faulty_keys}
    if isinstance(valid.get("over"), Mapping):
        bad = {loc[1] for loc in places if loc[0] == "over" and len(loc) > 1}
        valid["over"] = {k: v for k, v in _by_text(valid["over"]).items() if k not in bad}
    if isinstance(valid.get("keep"), (list, tuple)):
        wrong = {loc[1] for loc in places if loc[0] == "keep" and len(loc) > 1}
        valid["keep"] = [entry for k, entry in enumerate(valid["keep"]) if k not in wrong]
    return valid


def _with(data: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = {**data, **changes}
    old, new = data.get("run"), changes.get("run")
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        replaced = STEPS_CHOSEN_BY if set(STEPS_CHOSEN_BY).intersection(new) else ()
        merged["run"] = {**{k: v for k, v in old.items() if k not in replaced}, **new}
    return merged
