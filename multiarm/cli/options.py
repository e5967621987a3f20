"""Options of the commands: those that several share, and those that derive from the run's schema.

A command with :func:`with_settings` has an option for each key of a scene's ``run``: its type,
choices and help are those of :class:`multiarm.scene.RunSpec`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache, cached_property, update_wrapper
from pathlib import Path
from typing import Annotated, Any

import typer

__all__ = [
    "FILES",
    "METHOD",
    "OF_SCENE",
    "Code",
    "JsonFile",
    "NoCode",
    "Quiet",
    "SceneFile",
    "file_option",
    "option",
    "switch",
    "with_settings",
]

OF_SCENE = "the scene's"
METHOD, FILES = "How exactly", "Results"


def option(
    text: str,
    metavar: str | None = None,
    *,
    default: bool | str = True,
    panel: str | None = None,
    **limits: Any,
) -> Any:
    """An option: its help, a letter for its value, its default in words, the panel of the help."""
    return typer.Option(
        help=text, metavar=metavar, show_default=default, rich_help_panel=panel, **limits
    )


def switch(name: str, text: str, panel: str | None = None) -> Any:
    """An option without a value: ``--name``, ``--name -n`` or ``--name/--no-name``."""
    return typer.Option(*name.split(), help=text, rich_help_panel=panel)


def file_option(text: str, metavar: str = "FILE", default: str = "none") -> Any:
    """An option that names a file to be written."""
    return option(text, metavar, default=default, panel=FILES)


SceneFile = Annotated[Path, typer.Argument(help="The scene, a YAML file.", metavar="SCENE")]
JsonFile = Annotated[Path | None, file_option("Write the figures as JSON.", "FILE.json")]
Quiet = Annotated[bool, switch("--quiet -q", "Print only warnings and errors.", FILES)]
Code = Annotated[
    bool,
    switch(
        "--code",
        "Load the functions and effects that the file names, which runs their code; without, they "
        "are left out.",
    ),
]
NoCode = Annotated[
    bool,
    switch(
        "--no-code",
        "Refuse a file that names functions or effects of packages, whose code would be run.",
    ),
]


def with_settings(*names: str) -> Callable[[Callable[..., None]], _WithSettings]:
    """Let a command's parameter ``settings`` be options: of a run, all or those that are named.

    The command gets a table with the settings that are given.
    """
    return lambda command: _WithSettings(command, names)


class _WithSettings:
    """A command whose options are read from the schema when they are needed, not on import."""

    def __init__(self, command: Callable[..., None], names: tuple[str, ...]) -> None:
        update_wrapper(self, command, ("__module__", "__name__", "__qualname__", "__doc__"))
        self._command, self._names = command, names

    def __call__(self, **arguments: Any) -> None:
        given = {name: arguments.pop(name, None) for name in self._options}
        settings = {
            name: value.value if isinstance(value, Enum) else value
            for name, value in given.items()
            if value is not None
        }
        self._command(**arguments, settings=settings)

    @property
    def __signature__(self) -> inspect.Signature:
        """The command's, with options in place of ``settings``."""
        written = inspect.signature(self._command, eval_str=True)
        parameters: list[inspect.Parameter] = []
        for parameter in written.parameters.values():
            further = self._options.values() if parameter.name == "settings" else [parameter]
            parameters += [own.replace(kind=inspect.Parameter.KEYWORD_ONLY) for own in further]
        return written.replace(parameters=parameters)

    @property
    def __annotations__(self) -> dict[str, Any]:  # type: ignore[override]
        return {own.name: own.annotation for own in self.__signature__.parameters.values()}

    @cached_property
    def _options(self) -> dict[str, inspect.Parameter]:
        from multiarm.scene.run import STEPS_CHOSEN_BY, RunSpec

        found = {}
        for name, own in _settings_of(RunSpec).items():
            sort = _type(name, own)
            if sort is None or (self._names and name not in self._names):
                continue
            text = own.get("description", "")
            if name == STEPS_CHOSEN_BY[0] and not self._names:
                others = ", ".join(f"--{other}" for other in STEPS_CHOSEN_BY[1:])
                text += f" Any of this, {others} replaces the scene's choice of all four."
            if issubclass(sort, Enum) and any(choice.value not in text for choice in sort):
                text += f" One of {', '.join(choice.value for choice in sort)}."
            metavar = _metavar(name, text, sort)
            declared = option(text, metavar, default=OF_SCENE, panel=METHOD)
            found[name] = inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=None,
                annotation=Annotated[sort | None, declared],
            )
        return found


@cache
def _settings_of(model: Any) -> dict[str, Any]:
    """The schema of each setting, made once for all commands."""
    from multiarm.scene.json_schema import json_schema

    return json_schema(model)["properties"]


def _metavar(name: str, text: str, sort: type) -> str:
    """A letter for a value; choices have names, which the help lists: in its table they break."""
    if issubclass(sort, Enum):
        return "NAME"
    return "S" if "[s]" in text else name[0].upper()


_TYPES: Mapping[str, type] = {"number": float, "integer": int, "boolean": bool, "string": str}


def _type(name: str, schema: Mapping[str, Any]) -> type | None:
    """What may be written on the command line; None where a setting is a table only."""
    for one in schema.get("anyOf", [schema]):
        if "enum" in one:
            return Enum(name, {value: value for value in one["enum"]}, type=str)  # type: ignore[return-value]
        if one.get("type") in _TYPES:
            return _TYPES[one["type"]]
    return None
