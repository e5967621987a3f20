"""Replays in the browser: a trajectory as one HTML page, with Meshcat's viewer inside.

    trajectory --animate--> Animation --drawing--> Meshcat commands --page--> HTML page

The animation is independent of robots and browsers; the drawing reads only the animation.  The
page is written to a file, shown from a temporary one (`browser`), served (`server`) or shown in
a notebook.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, tostring

from multiarm.errors import ReplayError
from multiarm.public import in_notebook
from multiarm.results.files import printable_texts, resolved, target_fault, write_text
from multiarm.scene.faults import shown

if TYPE_CHECKING:
    from multiarm.results.trajectory import Trajectory

__all__ = ["replay"]

LARGEST_RATE = 1e9
"""Of ``fps`` and ``speed``, and the reciprocal of their smallest: times on a page stay finite."""


def replay(
    trajectory: Trajectory,
    path: str | os.PathLike | None = None,
    *,
    open_browser: bool = True,
    fps: float = 30,
    speed: float = 1.0,
    meshes: bool = True,
    host: str | None = None,
    port: int | None = None,
) -> Path | InlineReplay | None:
    """Show a trajectory in the browser.

    The replay shows the arms, each in its colour, of a robot with several tips each branch in that
    of its tip, the translucent object, the contacts with their normals into the object (or into the
    second body of a connection), and the contact forces as arrows. A pushing arrow ends at its
    contact; a pulling one is lighter and begins there. The longest arrow is the largest force of
    the run; a short spike far above the rest is clipped to it, and the page gives its value.
    Hinges, slides and balls are drawn with their axes; limits as a sector or a rail with a pointer,
    which is red beyond them. Contacts that can open, slide or stick have a mark for each state, and
    no arrow while they are open. Events are shown briefly at their place; the page lists them and
    marks them on its time line. A failed run is shown up to its last sample. Functions that the
    scene of a stored run names are not loaded: a warning says which surfaces are not drawn. A run
    of this process has its functions.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like, optional
        Write the page, which needs no network, to this HTML file. By default it is opened in the
        browser from a temporary file, which is kept for a day at least; in a Jupyter notebook it
        is shown below the cell.
    open_browser : bool
        Open the page in the browser; one that is written to `path` is not opened.
    fps : float
        Frames per second of the viewer; frames are samples of the trajectory.
    speed : float
        Seconds of the trajectory per second of the viewer.
    meshes : bool
        False shows simple bars in place of the robots' mesh files: a small file.
    host, port : str and int, optional
        Serve the page to browsers elsewhere until Ctrl-C: at an address of this computer, by
        default 127.0.0.1, which only this computer (or an SSH tunnel to it) reaches; every
        computer that reaches another address can watch. ``"0.0.0.0"``: all addresses. Port 0, the
        default where only `host` is given, takes a free one.

    Returns
    -------
    Path, InlineReplay or None
        The file written; in a notebook the page; None after serving.

    Raises
    ------
    ReplayError
        The trajectory has no samples, the file cannot be written, nothing can listen at `host` and
        `port`, these are given beside `path`, or `fps` or `speed` is not a number from 1e-9 to 1e9.

    Warns
    -----
    UserWarning
        No browser can be opened here; says where the page is.
    """
    from multiarm.results.trajectory import require_trajectory

    trajectory = require_trajectory(trajectory, "ma.replay(trajectory)")
    for name, value in (("fps", fps), ("speed", speed)):
        if not isinstance(value, Real) or not 1.0 / LARGEST_RATE <= value <= LARGEST_RATE:
            raise ReplayError(
                f"{name} must be a number from {1.0 / LARGEST_RATE:g} to {LARGEST_RATE:g}, got "
                f"{shown(value)}"
            )
    from multiarm.viewer.animate import animate
    from multiarm.viewer.browser import open_in_browser, temporary_page
    from multiarm.viewer.drawing import draw
    from multiarm.viewer.page import page_facts, render
    from multiarm.viewer.server import LOOPBACK, serve

    served = host is not None or port is not None
    if served and path is not None:
        raise ReplayError(
            "a replay is either written to a file or served; leave out the file, or the address "
            "and port"
        )
    target = None if path is None else resolved(path, ReplayError)
    fault = "" if target is None else target_fault(target)
    if fault:  # before the work
        raise ReplayError(f"cannot write the replay to '{path}': {fault}")
    animation = animate(trajectory, fps=fps, speed=speed, meshes=meshes)
    commands = printable_texts(draw(animation, speed))
    page = render(commands, printable_texts(page_facts(animation, speed)))
    if target is not None:
        write_text(target, page, error=ReplayError)
        return target
    if served:
        serve(page, LOOPBACK if host is None else host, port or 0, open_browser)
        return None
    if in_notebook():
        return InlineReplay(page)
    target = temporary_page(page)
    if open_browser and not open_in_browser(target.as_uri()):
        warnings.warn(
            f"no browser can be opened here; open {target} in one, or serve the replay to a "
            "browser on another computer: multiarm replay RESULT.h5 --port 8000 "
            "(`port=8000` in Python)",
            stacklevel=2,
        )
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
