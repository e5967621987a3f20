"""Send commands to a live Meshcat server, as MessagePack with typed arrays."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import umsgpack

from multiarm.errors import ReplayError
from multiarm.viewer.commands import Command

with warnings.catch_warnings():  # Meshcat imports a module that pyzmq calls deprecated
    warnings.simplefilter("ignore", DeprecationWarning)
    import meshcat

# MessagePack extension types by which the viewer knows typed arrays.
EXTENSIONS = {
    "int8": 0x11,
    "uint8": 0x12,
    "int16": 0x13,
    "uint16": 0x14,
    "int32": 0x15,
    "uint32": 0x16,
    "float32": 0x17,
    "float64": 0x18,
}


def serve(commands: list[Command]) -> meshcat.Visualizer:
    """Start a Meshcat server that shows what the `commands` say; return its visualizer.

    Raises
    ------
    ReplayError
        The server does not start.
    """
    try:
        visualizer = meshcat.Visualizer()
    except (RuntimeError, OSError) as error:
        raise ReplayError(
            f"the Meshcat server does not start: {error}; write the replay to a file instead"
        ) from error
    for command in commands:
        visualizer.window.send(_Message(command))
    return visualizer


class _Message:
    """A command in the shape that Meshcat's window sends."""

    def __init__(self, command: Command) -> None:
        self.command = command

    def lower(self) -> Command:
        return _lower(self.command)


def _lower(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _lower(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_lower(item) for item in value]
    if isinstance(value, np.ndarray):
        return umsgpack.Ext(EXTENSIONS[value.dtype.name], value.tobytes())
    return value.item() if isinstance(value, np.generic) else value
