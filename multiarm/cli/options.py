"""Options of the commands that several share; those of a run's settings have their words."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer

from multiarm.scene.parameters import description_of
from multiarm.scene.run import (
    ARM_TERMS,
    SOLVERS,
    STABILIZATIONS,
    ArmTerms,
    Integrator,
    RunSpec,
    SolverName,
    Stabilization,
)
from multiarm.tableaus import METHODS

__all__ = [
    "FILES",
    "METHOD",
    "Accuracy",
    "Arms",
    "Closing",
    "Code",
    "Duration",
    "JsonFile",
    "Method",
    "MostSteps",
    "NoCode",
    "OutputStep",
    "Quiet",
    "SceneFile",
    "Solver",
    "Step",
    "Tolerance",
    "chosen",
    "file_option",
    "option",
    "setting",
    "switch",
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


def setting(name: str, metavar: str | None = None, text: str = "") -> Any:
    """The option of a setting of runs, which says of itself what it is."""
    words = description_of(RunSpec, name) + text
    return option(words, metavar, default=OF_SCENE, panel=METHOD)


def choice_setting(name: str, choices: Iterable[str]) -> Any:
    """The option of a setting with few values, which its help lists: in its table they break."""
    words = description_of(RunSpec, name)
    unnamed = [choice for choice in choices if choice not in words]
    return setting(name, "NAME", f" One of {', '.join(choices)}." if unnamed else "")


Duration = Annotated[float | None, setting("duration", "S")]
Accuracy = Annotated[float | None, setting("accuracy", "A")]
Method = Annotated[Integrator | None, choice_setting("integrator", METHODS)]
Step = Annotated[float | None, setting("step", "S")]
Tolerance = Annotated[float | None, setting("tolerance", "T")]
Closing = Annotated[Stabilization | None, choice_setting("stabilization", STABILIZATIONS)]
OutputStep = Annotated[float | None, setting("output_step", "S")]
MostSteps = Annotated[float | None, setting("most_steps", "M")]
Solver = Annotated[SolverName | None, choice_setting("solver", SOLVERS)]
Arms = Annotated[ArmTerms | None, choice_setting("arms", ARM_TERMS)]


def chosen(**settings: Any) -> dict[str, Any]:
    """The settings of a run that the command line names; the scene's stand for the others."""
    return {name: value for name, value in settings.items() if value is not None}
