"""Options that several commands share."""

from __future__ import annotations

from enum import Enum

import typer

__all__ = ["ARMS", "CODE", "METHOD", "NO_CODE", "OF_SCENE", "Arms"]

OF_SCENE = "the scene's"
METHOD = "How exactly"


class Arms(str, Enum):
    """The backend that computes inertia, forces and motion of the arms."""

    pinocchio = "pinocchio"
    compiled = "compiled"


ARMS = typer.Option(
    help="Backend of the arms: Pinocchio, or compiled copies of its models, which are several "
    "times as fast and are verified against Pinocchio first.",
    show_default=OF_SCENE,
    rich_help_panel=METHOD,
)

CODE = typer.Option(
    "--code",
    help="Load the functions and effects that the file names, which runs their code; without, "
    "they are left out.",
)
NO_CODE = typer.Option(
    "--no-code",
    help="Refuse a file that names functions or effects of packages, whose code would be run.",
)
