"""Write commands as one HTML file that needs nothing else: no server, no network.

The page holds Meshcat's own viewer, a small player (``player.html``) and the commands: JSON in
which every typed array is a place in one block of bytes. Equal arrays are stored once, so that
arms of a kind share their meshes, and the block is compressed; the browser unpacks it by itself.
"""

from __future__ import annotations

import base64
import gzip
import html
import importlib.util
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from multiarm.errors import ReplayError
from multiarm.viewer.commands import Command

ALIGNMENT = 8  # [bytes] of the arrays in the block


def render(commands: list[Command], facts: dict[str, Any]) -> str:
    """Return the text of the page.

    Parameters
    ----------
    commands : list of dict
        What the viewer is told, in order.
    facts : dict
        What the player shows and needs: ``title``, ``note``, ``start`` [s], ``speed``, ``aspect``,
        ``legend`` (pairs of name and colour), ``force_scale`` and ``peak_force`` [N], ``times``
        (K,) [s], ``states`` of contacts (name, sign, colour), ``events`` (see
        `happenings.time_line`) and ``dials``: coordinates with limits, each a table of ``arm``,
        ``unit``, ``limits`` and ``values`` (K,).
    """
    block = _Block()
    text = json.dumps(block.lower({"facts": facts, "commands": commands}), allow_nan=False)
    header = text.encode()
    payload = len(header).to_bytes(ALIGNMENT, "little") + header
    payload += b" " * (-len(payload) % ALIGNMENT) + bytes(block.data)
    filling = {
        "{{title}}": html.escape(facts["title"]),
        "{{viewer}}": _viewer_script(),
        "{{payload}}": base64.b64encode(gzip.compress(payload, mtime=0)).decode(),
    }
    page = resources.files("multiarm.viewer").joinpath("player.html").read_text("utf-8")
    # in one pass: a mark in what was filled in stays as it is
    return re.sub("|".join(map(re.escape, filling)), lambda found: filling[found[0]], page)


class _Block:
    """Bytes of all arrays, each content once."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.places: dict[tuple[str, bytes], int] = {}

    def lower(self, value: Any) -> Any:
        """Return `value` with arrays replaced by places in the block."""
        if isinstance(value, dict):
            return {key: self.lower(item) for key, item in value.items()}
        if isinstance(value, (list, tuple)):
            return [self.lower(item) for item in value]
        if isinstance(value, np.ndarray):
            kind, content = f"{value.dtype.name.capitalize()}Array", value.tobytes()
            place = self.places.setdefault((kind, content), len(self.data))
            if place == len(self.data):
                self.data += content + bytes(-len(content) % ALIGNMENT)
            return {"typed": kind, "start": place, "length": value.size}
        return value.item() if isinstance(value, np.generic) else value


def _viewer_script() -> str:
    # Importing Meshcat would start ZeroMQ and print warnings: its file is all that is needed.
    found = importlib.util.find_spec("meshcat")
    if found is None or found.origin is None:
        raise ReplayError("a replay needs the package meshcat; install it: pip install meshcat")
    viewer = Path(found.origin).parent / "viewer" / "dist" / "main.min.js"
    return viewer.read_text("utf-8").replace("</script", "<\\/script")
