"""Glyphs of contacts and events.

A contact force is an arrow outside the object, along the contact normal: pushing, its head
touches the contact point; pulling, it starts there and points away, in a lighter colour.  Its
length is proportional to the force, its width to the square root, so that small forces stay
visible.  Hidden glyphs shine through faintly.

Where contacts can open, slide or stick, the mark at the point shows their state: a dot with its
normal for touching, with a ring for sliding, with a square plate for sticking; a ring without
normal for resting; and a faint ring for open.

An event is shown at its place for a short time, in the shape and colour of its family: a filled
star where a contact is made or hit, a hollow cage where one is lost, a diamond for the rest.  A
glyph has full size in the first frame after its event and shrinks.  Each family has a few glyphs
that are reused, so that a thousand impacts cost no more than a few; an event that finds all of
them in use is not shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from multiarm.results.channels import CONTACT_STATES, OPEN, RESTING, SLIDING, STICKING, TOUCHING
from multiarm.results.event_log import FAMILIES, LOST, MADE, STATE_COLOURS, Family
from multiarm.viewer import commands
from multiarm.viewer.animation import Animation, ContactTracks, EventPlace, along
from multiarm.viewer.commands import Script
from multiarm.viewer.mesh import Mesh, ShadedMesh, box, merge, revolve, shade, sphere

NORMAL_COLOR = np.array([0.25, 0.28, 0.33])
FAINT = 0.25  # opacity of the mark of an open contact
HAIR = 1e-4  # scale of an invisible shape: zero would make its matrix singular
HEAD, WIDTH = 0.17, 0.02  # length of the head and radius of the shaft of an arrow of length 1


class Marks:
    """Shapes and sizes [m] of all marks of an animation, in proportion to its size.

    Parameters
    ----------
    animation : Animation
    size : float
        The animation's size [m].
    """

    def __init__(self, animation: Animation, size: float) -> None:
        self.longest = 0.17 * size  # arrow of the animation's `force_scale`
        self._film = animation
        body = float(np.linalg.norm(np.ptp(animation.bodies[0].mesh.bounds(), axis=0)))
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
    """Return the shapes around a dot of some radius [m] for each state, in the state's colour."""
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
    """Draw one mark for each state that occurs in ``states``, codes of shape (K,)."""
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
    """Return a shape that shines faintly through bodies in front of it."""
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


DURATION = 0.4  # [s] of the viewer
AT_ONCE = 4  # glyphs of one family
RADIUS = 0.035  # of the animation's size
LEAST = 0.4  # of full size: a glyph that is seen in one frame only


def draw_events(
    events: Sequence[EventPlace], time: np.ndarray, size: float, script: Script
) -> None:
    """Draw the events of an animation.

    Parameters
    ----------
    events : sequence of EventPlace
    time : array, shape (K,)
        Of the frames, in seconds of the viewer, as those of the events.
    size : float
        The animation's size [m].
    script : Script
    """
    for k, family in enumerate(FAMILIES):
        own = [event for event in events if event.family is family]
        for slot, (position, scale) in enumerate(event_tracks(own, time)):
            path = f"events/{k}_{slot}"
            shape = shade(_shape(family, RADIUS * size))
            color = commands.rgb(family.colour)
            glow = commands.flat(color), commands.ghost(color, 0.5)
            script.put(path, commands.mesh_object(shape, *glow))
            script.set(path, "position", position)
            script.set(path, "scale", np.repeat(scale[:, None], 3, axis=1))


def event_tracks(
    events: Sequence[EventPlace], time: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return places (K, 3) and sizes (K,) in 0..1 of the glyphs of some events."""
    slots: list[tuple[np.ndarray, np.ndarray]] = []
    free: list[int] = []  # the first frame in which each slot is free
    for event in sorted(events, key=lambda event: event.time):
        begin = min(int(np.searchsorted(time, event.time)), len(time) - 1)
        end = max(int(np.searchsorted(time, event.time + DURATION)), begin + 1)
        slot = next((i for i, frame in enumerate(free) if frame <= begin), len(free))
        if slot == AT_ONCE:
            continue
        if slot == len(free):
            free.append(0)
            slots.append((np.tile(event.where, (len(time), 1)), np.full(len(time), HAIR)))
        position, scale = slots[slot]
        position[free[slot] :] = event.where  # moved while it is invisible
        left = 1.0 - (time[begin:end] - event.time) / DURATION
        scale[begin:end] = np.maximum(left, HAIR)
        scale[begin] = max(scale[begin], LEAST)
        free[slot] = end + 1  # one frame without a glyph between two events
    return slots


def _shape(family: Family, radius: float) -> Mesh:
    if family is MADE:
        spike = revolve([(0, -radius), (0.14 * radius, 0), (0, radius)])
        return merge([spike.moved(turn) for turn in _turns(_STAR)])
    if family is LOST:
        hoop = ring(0.8 * radius, radius, 0.08 * radius)
        return merge([hoop.moved(turn) for turn in _turns(np.eye(3))])
    return revolve([(0, -0.7 * radius), (0.4 * radius, 0), (0, 0.7 * radius)])


_STAR = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], *([i, j, 1] for i in (-1, 1) for j in (-1, 1))])


def _turns(axes: np.ndarray) -> list[np.ndarray]:
    """Return rotations (4, 4) that turn z onto each of some axes (A, 3)."""
    turns = []
    for axis in axes / np.linalg.norm(axes, axis=1, keepdims=True):
        x = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
        x /= np.linalg.norm(x)
        turn = np.eye(4)
        turn[:3, :3] = np.column_stack([x, np.cross(axis, x), axis])
        turns.append(turn)
    return turns
