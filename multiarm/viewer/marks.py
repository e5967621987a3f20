"""Draw contacts: points, normals and forces.

A contact force is an arrow outside the object, along the contact normal: pushing, its head
touches the contact point; pulling, it starts there and points away, in a lighter colour. Its
length is in proportion to the force, its width to the root of that, so that small forces stay
visible. Marks that something hides shine through it faintly.

Where contacts can open, slide or stick, the mark at the point tells their state: a dot with its
normal that touches, with a ring around it while it slides, with a square plate while it sticks; a
ring without normal where it rests; and hardly more than the shade of a ring where it is open.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.results.channels import CONTACT_STATES, OPEN, RESTING, SLIDING, STICKING, TOUCHING
from multiarm.results.event_log import STATE_COLOURS
from multiarm.viewer import commands
from multiarm.viewer.film import ContactTracks, Film, along
from multiarm.viewer.mesh import Mesh, ShadedMesh, box, merge, revolve, shade, sphere
from multiarm.viewer.script import Script

NORMAL_COLOR = np.array([0.25, 0.28, 0.33])
FAINT = 0.25  # opacity of the mark of an open contact
HAIR = 1e-4  # scale of what should not be seen: zero would make a matrix singular
HEAD, WIDTH = 0.17, 0.02  # length of the head and radius of the shaft of an arrow of length 1


class Marks:
    """Shapes and sizes [m] of all marks of a film, in proportion to its size.

    Parameters
    ----------
    film : Film
    size : float
        The film's size [m].
    """

    def __init__(self, film: Film, size: float) -> None:
        self.longest = 0.17 * size  # arrow of the film's `force_scale`
        self._film = film
        body = float(np.linalg.norm(np.ptp(film.bodies[0].mesh.bounds(), axis=0)))
        self._dot = sphere(min(0.006 * size, 0.05 * body))
        normal = min(0.04 * size, 0.3 * body)
        self._needle = arrow(normal, normal / 4, normal / 30).painted(NORMAL_COLOR)
        full = arrow(self.longest, HEAD * self.longest, WIDTH * self.longest)
        down = np.array([1.0, -1.0, -1.0])  # half a turn about x
        to_tip = np.eye(4)
        to_tip[2, 3] = -self.longest
        self._states = _state_shapes(min(0.006 * size, 0.05 * body))
        self._push, self._pull = shade(full.moved(to_tip)), shade(full.scaled(down))

    def draw(self, contacts: ContactTracks, script: Script) -> None:
        """Draw the contacts of one arm."""
        lengths = self._film.arrow_lengths(contacts)  # (K, N)
        turns = along(contacts.normal)
        marks = self._marks(contacts)
        for i in range(contacts.point.shape[1]):
            name = f"{contacts.arm}/{i + 1}"
            if not (contacts.friction and contacts.friction[i]):
                states = None if contacts.state is None else contacts.state[:, i]
                _draw_mark(f"contacts/{name}", marks, states, script)
                script.move(f"contacts/{name}", contacts.point[:, i], turns[:, i])
            push, pull = np.maximum(lengths[:, i], 0), np.maximum(-lengths[:, i], 0)
            if push.any() or pull.any():
                script.move(f"forces/{name}", contacts.point[:, i], turns[:, i])
            _draw_force(f"forces/{name}/push", self._push, push, 0.9 * contacts.color, script)
            _draw_force(f"forces/{name}/pull", self._pull, pull, (1 + contacts.color) / 2, script)

    def _marks(self, contacts: ContactTracks) -> dict[int, dict[str, Any]]:
        """Return the mark of each state, by its code."""
        dot = self._dot.painted(0.75 * contacts.color)
        parts = {TOUCHING: [], **{state: [shape] for state, shape in self._states.items()}}
        marks = {}
        for state, extra in parts.items():
            mark = shade(merge([dot, *([] if state == RESTING else [self._needle]), *extra]))
            marks[state] = seen_through(mark, np.ones(3))
        open_mark = shade(self._states[RESTING].painted(np.ones(3)))
        marks[OPEN] = commands.mesh_object(open_mark, commands.ghost(contacts.color, FAINT))
        return marks


def _state_shapes(dot: float) -> dict[int, Mesh]:
    """Return what a dot of some radius [m] has around it in a state, in the state's colour."""
    shapes = {
        SLIDING: ring(2.0 * dot, 3.0 * dot, 0.35 * dot),
        STICKING: box([4.4 * dot, 4.4 * dot, 0.7 * dot]),
        RESTING: ring(1.5 * dot, 1.9 * dot, 0.35 * dot),
    }
    return {
        state: shape.painted(commands.rgb(STATE_COLOURS[state])) for state, shape in shapes.items()
    }


def ring(inner: float, outer: float, thick: float) -> Mesh:
    """Return a flat ring about z between two radii [m]."""
    low, high = -thick / 2, thick / 2
    return revolve([(inner, low), (outer, low), (outer, high), (inner, high), (inner, low)])


def _draw_mark(
    path: str, marks: dict[int, dict[str, Any]], states: np.ndarray | None, script: Script
) -> None:
    """Draw one mark for each state that a contact has in the film; its codes have shape (K,)."""
    if states is None:
        script.put(path, marks[TOUCHING])
        return
    for code in np.unique(states):
        node = f"{path}/{CONTACT_STATES[code]}"
        script.put(node, marks[int(code)])
        script.set(node, "scale", np.where(states == code, 1.0, HAIR)[:, None] * np.ones(3))


def arrow(length: float, head: float, radius: float) -> Mesh:
    """Return an arrow from the origin along z; `radius` is that of its shaft [m]."""
    neck = length - head
    return revolve([(0, 0), (radius, 0), (radius, neck), (3 * radius, neck), (0, length)])


def seen_through(shape: ShadedMesh, color: np.ndarray) -> dict[str, Any]:
    """Return a shape that shines faintly through what hides it."""
    return commands.mesh_object(shape, commands.shiny(color), commands.ghost(color, 0.38))


def _draw_force(
    path: str, shape: ShadedMesh, length: np.ndarray, color: np.ndarray, script: Script
) -> None:
    """Draw an arrow of changing `length` (K,), 1 being the longest."""
    if length.max() < HAIR:
        return
    script.put(path, seen_through(shape, color))
    width = np.sqrt(length)
    script.set(path, "scale", np.maximum(np.column_stack([width, width, length]), HAIR))
