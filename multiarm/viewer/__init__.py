"""Replays in the browser: a trajectory as a live Meshcat scene, or as one HTML file.

    trajectory --animate--> Animation --drawing--> Meshcat commands --page--> HTML file
                                                                   --server--> live viewer

The animation is independent of robots and browsers; the drawing reads only the animation.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, tostring

from multiarm.errors import ReplayError
from multiarm.public import in_notebook
from multiarm.results.files import atomic_file, printable_texts, resolved

if TYPE_CHECKING:
    from meshcat import Visualizer

    from multiarm.results.trajectory import Trajectory

__all__ = ["replay"]


def replay(
    trajectory: Trajectory,
    path: str | os.PathLike | None = None,
    *,
    open_browser: bool = True,
    fps: float = 30,
    speed: float = 1.0,
    meshes: bool = True,
    host: str = "127.0.0.1",
    port: int = 0,
    code: bool = False,
) -> Path | Visualizer | InlineReplay:
    """Show a trajectory in the browser.

    The replay shows the arms, each in its colour, the translucent object, the contacts with their
    normals into the object, and the contact forces as arrows. A pushing arrow ends at its contact;
    a pulling one is lighter and begins there. The longest arrow is the largest force of the run; a
    short spike far above the rest is clipped to it, and the page gives its value. Hinges, slides
    and balls are drawn with their axes; limits as a sector or a rail with a pointer, which is red
    beyond them. Contacts that can open, slide or stick have a mark for each state, and no arrow
    while they are open. Events are shown briefly at their place; the page lists them and marks them
    on its time line. A failed run is shown up to its last sample.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like, optional
        Write one HTML file, which needs no network. By default a live Meshcat server, which ends
        with the program; in a Jupyter notebook the page itself, below the cell.
    open_browser : bool
        Open the live scene in the browser; a file is only written.
    fps : float
        Frames per second of the viewer; frames are samples of the trajectory.
    speed : float
        Seconds of the trajectory per second of the viewer.
    meshes : bool
        False shows simple bars in place of the robots' mesh files: a small file.
    host : str
        Address of this computer at which a live server listens. Only this computer reaches the
        default; every computer that reaches another address can watch. ``"0.0.0.0"``: all
        addresses.
    port : int
        Of a live server; 0 takes a free one.
    code : bool
        Load the functions that the scene of a stored run names, to draw their surfaces. Without it,
        a warning lists what is not drawn.  A run of this process has its functions already.

    Returns
    -------
    Path, meshcat.Visualizer or InlineReplay
        The file written; the live visualizer, whose address is ``url()``; in a notebook the page.

    Raises
    ------
    ReplayError
        The trajectory has no samples, the file cannot be written, nothing can listen at `host` and
        `port`, or `fps` or `speed` is not a number greater than 0.
    """
    from multiarm.results.trajectory import require_trajectory

    trajectory = require_trajectory(trajectory, "ma.replay(trajectory)")
    for name, value in (("fps", fps), ("speed", speed)):
        if not (math.isfinite(value) and value > 0):
            raise ReplayError(f"{name} must be a number greater than 0, got {value}")
    from multiarm.viewer.animate import animate
    from multiarm.viewer.drawing import draw

    target = None if path is None else _target(path)
    animation = animate(trajectory, fps=fps, speed=speed, meshes=meshes, code=code)
    commands = printable_texts(draw(animation, speed))
    if target is None and not in_notebook():
        from multiarm.viewer.server import serve

        visualizer = serve(commands, host, port)
        if open_browser:
            visualizer.open()
        return visualizer
    from multiarm.viewer.page import page_facts, render

    page = render(commands, printable_texts(page_facts(animation, speed)))
    if target is None:
        return InlineReplay(page)
    _write(target, page)
    return target


@dataclass(frozen=True, repr=False)
class InlineReplay:
    """A replay as a notebook shows it: the whole page in a frame below the cell."""

    page: str

    def __repr__(self) -> str:
        return f"InlineReplay({len(self.page) / 1e6:.1f} MB)"

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 480px; border: 1px solid #ccc"
        frame = Element("iframe", srcdoc=self.page, style=style)
        return tostring(frame, encoding="unicode", method="html")


def _target(path: str | os.PathLike) -> Path:
    """Return the path of the page; raise before the work if it cannot be written."""
    target = resolved(path, ReplayError)
    if target.is_dir():
        raise ReplayError(
            f"cannot write the replay to {target}: it is a folder; name a file "
            f"such as {target / 'replay.html'}"
        )
    if not target.parent.is_dir():
        raise ReplayError(
            f"cannot write the replay to {target}: there is no folder "
            f"{target.parent}; create it first"
        )
    return target


def _write(target: Path, page: str) -> None:
    try:
        with atomic_file(target) as partial:
            partial.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ReplayError(
            f"cannot write the replay to {target}: {error.strerror}; choose another place"
        ) from error
