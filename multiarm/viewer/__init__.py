"""Replays in the browser: a trajectory as a live Meshcat scene, or as one HTML file.

    trajectory --filming--> Film --drawing--> Meshcat commands --page--> HTML file
                                                              --server--> live viewer

The film knows neither robots nor browsers; the drawing knows only the film.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiarm.errors import ReplayError
from multiarm.results.files import atomic_file, printable_texts

if TYPE_CHECKING:
    from meshcat import Visualizer

    from multiarm.results.trajectory import Trajectory
    from multiarm.viewer.film import Dial, Film, HingeTracks

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
) -> Path | Visualizer:
    """Show a trajectory in the browser.

    Shown are the arms, each in its colour, the object, slightly translucent, the contacts with
    their normals into the object, and the contact forces as arrows. A pushing arrow ends at its
    contact, a pulling one, lighter, begins there; the longest stands for the largest force of the
    run (a short spike far above the rest is drawn no longer, and the page gives its value). Hinges,
    slides and balls are drawn with their axes; limits as a sector or a rail with a pointer, which
    is red beyond them. Contacts that can open, slide or stick have a mark for each state, and no
    arrow while they are open; what happens at a place flashes there, and the page lists the events
    beside ticks on its time line. A run that failed is shown up to where it came.

    Parameters
    ----------
    trajectory : Trajectory
    path : path-like, optional
        Write one HTML file, which needs no network, there. Absent: a live Meshcat server, which
        ends with the program.
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
        usual one; whoever reaches another can watch, ``"0.0.0.0"`` stands for all.
    port : int
        Of a live server; 0 takes a free one.
    code : bool
        Load the functions that the scene of a stored run names, to draw their surfaces. Without, a
        warning says what is not drawn.  A run made in this process has its functions already.

    Returns
    -------
    Path or meshcat.Visualizer
        The file written, or the live visualizer (its ``url()`` is where to look).

    Raises
    ------
    ReplayError
        The trajectory has no samples, the file cannot be written, nothing can listen at `host` and
        `port`, or `fps` or `speed` is not a number greater than 0.
    """
    for name, value in (("fps", fps), ("speed", speed)):
        if not (math.isfinite(value) and value > 0):
            raise ReplayError(f"{name} must be a number greater than 0, got {value}")
    from multiarm.viewer.drawing import draw
    from multiarm.viewer.filming import film_of

    target = None if path is None else _target(path)
    film = film_of(trajectory, fps=fps, speed=speed, meshes=meshes, code=code)
    commands = printable_texts(draw(film, speed))
    if target is None:
        from multiarm.viewer.server import serve

        visualizer = serve(commands, host, port)
        if open_browser:
            visualizer.open()
        return visualizer
    from multiarm.viewer.page import render

    _write(target, render(commands, printable_texts(_facts(film, speed))))
    return target


def _facts(film: Film, speed: float) -> dict[str, Any]:
    """Return what the page tells about a film beside the scene itself."""
    from multiarm.viewer.camera import ASPECT
    from multiarm.viewer.commands import hexadecimal
    from multiarm.viewer.happenings import time_line

    return {
        "title": film.title,
        "note": film.note,
        "start": float(film.time[0]),
        "speed": speed,
        "aspect": ASPECT,
        "legend": [[c.arm, f"#{hexadecimal(c.color):06x}"] for c in film.contacts],
        "force_scale": film.force_scale,
        "peak_force": film.peak_force,
        "times": film.time - film.time[0],
        "states": _states(film),
        "events": time_line(film.events, film.time, speed),
        "dials": [_dial(hinge, dial) for hinge in film.hinges for dial in hinge.dials],
    }


def _states(film: Film) -> list[list[str]]:
    """Return name, sign and colour of each state that a contact of the film has."""
    from multiarm.results.channels import CONTACT_STATES
    from multiarm.results.event_log import STATE_COLOURS, STATE_SIGNS

    found = {int(code) for c in film.contacts if c.state is not None for code in set(c.state.flat)}
    return [[CONTACT_STATES[k], STATE_SIGNS[k], STATE_COLOURS[k]] for k in sorted(found)]


def _dial(hinge: HingeTracks, dial: Dial) -> dict[str, Any]:
    """Return a joint's coordinate as people read it: degrees or millimetres."""
    scale, unit = (180 / math.pi, "°") if dial.turns else (1000.0, " mm")
    limits = [scale * limit for limit in dial.limits]
    return {"arm": hinge.arm, "unit": unit, "limits": limits, "values": scale * dial.value}


def _target(path: str | os.PathLike) -> Path:
    """Return the path of the page; a folder that does not exist is found out before the work."""
    target = Path(path)
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
