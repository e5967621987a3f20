"""Collects the commands of a film, and what moves in it."""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.viewer import commands
from multiarm.viewer.commands import Command

ROOT = "/world"  # the node below which poses are those of the film
STILL = 1e-9  # a property that changes less than this does not move


class Script:
    """Commands in order, and the tracks of all that moves; paths are below the world's node."""

    def __init__(self) -> None:
        self._commands: list[Command] = []
        self._tracks: dict[str, dict[str, np.ndarray]] = {}

    def add(self, *given: Command) -> None:
        """Append commands as they are."""
        self._commands += given

    def put(self, path: str, thing: dict[str, Any]) -> None:
        """Put an object, made by a function of `commands`, at a path."""
        self.add(commands.set_object(f"{ROOT}/{path}", thing))

    def set(self, path: str, name: str, values: np.ndarray) -> None:
        """Give a property its values (K, n): the first now, all in the animation if they differ."""
        node = f"{ROOT}/{path}"
        self.add(commands.set_property(node, name, values[0].tolist()))
        if np.ptp(values, axis=0).max() > STILL:
            self._tracks.setdefault(node, {})[name] = values

    def move(self, path: str, position: np.ndarray, quaternion_xyzw: np.ndarray) -> None:
        """Move a node through positions (K, 3) [m] and orientations (K, 4)."""
        self.set(path, "position", position)
        self.set(path, "quaternion", quaternion_xyzw)

    def finished(self, time: np.ndarray) -> list[Command]:
        """Return all commands; frame k is shown `time[k]` [s] after the start."""
        if len(time) < 2 or not self._tracks:
            return self._commands
        return [*self._commands, commands.set_animation(time, self._tracks)]
