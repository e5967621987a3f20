"""Options of the commands that several share, such as those of a run's settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS, METHODS

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


def setting(text: str, metavar: str) -> Any:
    """The option of a setting of runs."""
    return option(text, metavar, default=OF_SCENE, panel=METHOD)


def choice(text: str, *choices: str) -> Any:
    """The option of a setting with few values, which its text lists."""
    unnamed = [name for name in choices if name not in text]
    return setting(f"{text} One of {', '.join(choices)}." if unnamed else text, "NAME")


# Words and choices are those of multiarm.scene.RunSpec, as a test claims: the commands know them
# without what reads scenes. An option takes no tables.
if TYPE_CHECKING:
    Integrator = str
else:
    Integrator = Literal[tuple(METHODS)]
ACCURACY = (
    "Largest error of the whole run at the worst output time: a number [m and rad]. The program "
    "chooses method and steps, checks the result against a tightened rerun and repeats the run "
    "with smaller tolerances if need be. 1e-6 by default."
)
Duration = Annotated[float | None, setting("Simulated time [s].", "S")]
Accuracy = Annotated[float | None, setting(ACCURACY, "A")]
AccuracyOfRun = Annotated[
    float | None,
    setting(
        f"{ACCURACY} Any of this, --integrator, --step, --tolerance replaces the scene's choice of "
        "all four.",
        "A",
    ),
]
Method = Annotated[
    Integrator | None,
    choice(
        f"{', '.join(FIXED_STEP_INTEGRATORS)} have a fixed 'step'; "
        f"{', '.join(ADAPTIVE_INTEGRATORS)} choose their steps by 'accuracy' or 'tolerance'. "
        "Absent: dopri5 or dop853 by the accuracy, and rodas5p where the scene turns out to be "
        "stiff.",
        *METHODS,
    ),
]
Step = Annotated[float | None, setting("Fixed step [s].", "S")]
Tolerance = Annotated[
    float | None,
    setting("Error of one step of an adaptive integrator [m, rad, m/s, rad/s].", "T"),
]
Closing = Annotated[
    Literal["projection", "feedback", "none"] | None,
    choice(
        "How the joints are kept closed although integration errors add up.",
        "projection",
        "feedback",
        "none",
    ),
]
OutputStep = Annotated[float | None, setting("Time between stored samples [s].", "S")]
MostSteps = Annotated[
    float | None,
    setting(
        "Steps for one second of simulated time (for the whole run, if that is shorter): a run "
        "that needs more at the pace of its last thousands of steps, rejected ones and events "
        "counted, fails instead of running for hours.",
        "M",
    ),
]
Solver = Annotated[
    Literal["node", "dense"] | None,
    choice(
        "The node algorithm, or the whole linear system at once, an independent reference to "
        "compare with.",
        "node",
        "dense",
    ),
]
Arms = Annotated[
    Literal["pinocchio", "compiled"] | None,
    choice(
        "Backend of the arms' inertia, forces and motion: Pinocchio, or compiled code, which is "
        "several times as fast and verified against Pinocchio whenever the scene is compiled. An "
        "arm that cannot be compiled stays with Pinocchio and says so.",
        "pinocchio",
        "compiled",
    ),
]


def chosen(**settings: Any) -> dict[str, Any]:
    """The settings of a run that the command line names; the scene's stand for the others."""
    return {name: value for name, value in settings.items() if value is not None}
