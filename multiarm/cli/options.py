"""Options of the commands that several share, such as those of a run's settings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from multiarm.scene.settings import (
    ARM_TERMS,
    MEANINGS,
    STABILIZATIONS,
    ArmTerms,
    Integrator,
    Painleve,
    SolverName,
    Stabilization,
)
from multiarm.tableaus import METHODS

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


def plot_option(text: str) -> Any:
    """An option that names the file of a figure."""
    return file_option(f"{text}; the file's ending (png, svg, pdf) is the format.")


SceneFile = Annotated[Path, typer.Argument(help="The scene, a YAML file.", metavar="SCENE")]
JsonFile = Annotated[Path | None, file_option("Write the figures as JSON.", "FILE.json")]
Quiet = Annotated[bool, switch("--quiet -q", "Print only warnings and errors.", FILES)]
NoCode = Annotated[
    bool,
    switch(
        "--no-code",
        "Refuse a file that names functions or effects of packages, whose code would be run.",
    ),
]


def setting(key: str, metavar: str, *choices: str, more: str = "") -> Any:
    """The option of a setting of runs; its text lists its choices."""
    text = MEANINGS[key] + more
    if any(name not in text for name in choices):
        text += f" One of {', '.join(choices)}."
    return option(text, metavar, default=OF_SCENE, panel=METHOD)


Duration = Annotated[float | None, setting("duration", "S")]
Accuracy = Annotated[float | None, setting("accuracy", "A")]
AccuracyOfRun = Annotated[
    float | None,
    setting(
        "accuracy",
        "A",
        more=" Any of this, --integrator, --step, --tolerance replaces the scene's choice of all "
        "four.",
    ),
]
Method = Annotated[Integrator | None, setting("integrator", "NAME", *METHODS)]
Step = Annotated[float | None, setting("step", "S")]
Tolerance = Annotated[float | None, setting("tolerance", "T")]
Closing = Annotated[Stabilization | None, setting("stabilization", "NAME", *STABILIZATIONS)]
OutputStep = Annotated[float | None, setting("output_step", "S")]
MostSteps = Annotated[float | None, setting("most_steps", "M")]
AtPainleve = Annotated[Painleve | None, setting("painleve", "NAME", *get_args(Painleve))]
Solver = Annotated[SolverName | None, setting("solver", "NAME", *get_args(SolverName))]
Arms = Annotated[ArmTerms | None, setting("arms", "NAME", *ARM_TERMS)]


def chosen(**settings: Any) -> dict[str, Any]:
    """The settings of a run that the command line names; the scene's stand for the others."""
    return {name: value for name, value in settings.items() if value is not None}
