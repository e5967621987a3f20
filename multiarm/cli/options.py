"""Options that several commands share."""

from __future__ import annotations

from enum import Enum

import typer

__all__ = ["ARMS", "METHOD", "OF_SCENE", "Arms"]

OF_SCENE = "the scene's"
METHOD = "How exactly"


class Arms(str, Enum):
    """Who computes inertia, forces and motion of the arms."""

    pinocchio = "pinocchio"
    compiled = "compiled"


ARMS = typer.Option(
    help="Who computes the arms: Pinocchio, or compiled copies of its models, which are several "
    "times as fast and are verified against Pinocchio first.",
    show_default=OF_SCENE,
    rich_help_panel=METHOD,
)
