"""Glyphs of contacts, joints and events.

A contact force is an arrow outside the object, along the contact normal: pushing, its head
touches the contact point; pulling, it starts there and points away, in a lighter colour.  Its
length is proportional to the force, its width to the square root, so that small forces stay
visible.  Hidden glyphs shine through faintly.

Where contacts can open, slide or stick, the mark at the point shows their state: a dot with its
normal for touching, with a ring for sliding, with a square plate for sticking; a ring without
normal for resting; and a faint ring for open.

A joint's axis is a slim rod on the body that carries it: with a head at both ends (it is turned
about), with arrowheads (it is slid along), or with arrowheads and a sleeve (both).  A ball joint
is drawn as a ball.
An angle with limits is a sector at the upper end of the axis, clear of the arm, with a hand that
turns with the tip; a slide with limits is a rail between two stops with a bead. Hand and bead are
red where they are beyond the limits.

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

from multiarm.geometry.triangle_mesh import TriangleMesh, merge
from multiarm.results.contact_states import STATE_STYLES, ContactState
from multiarm.results.event_kinds import FAMILIES, LOST, MADE, Family
from multiarm.viewer import commands
from multiarm.viewer.animation import (
    Animation,
    ContactTracks,
    Dial,
    EventPlace,
    HingeTracks,
    along,
    moving,
    rotations,
)
from multiarm.viewer.commands import HAIR, Script
from multiarm.viewer.solids import Z_TO_X, box, cylinder, revolve, sphere

NORMAL_COLOR = np.array([0.25, 0.28, 0.33])
FAINT = 0.25  # opacity of the mark of an open contact
HEAD, WIDTH = 0.17, 0.02  # length of the head and radius of the shaft of an arrow of length 1


class Marks:
    """Shapes and sizes [m] of all contacts of an animation, in proportion to its `size` [m]."""

    def __init__(self, animation: Animation, size: float) -> None:
        self.longest = 0.17 * size  # arrow of the animation's `force_scale`
        self._animation = animation
        body = _object_size(animation)
        dot = min(0.006 * size, 0.05 * body)  # its radius
        normal = min(0.04 * size, 0.3 * body)
        self._needle = arrow(normal, normal / 4, normal / 30).painted(NORMAL_COLOR)
        full = arrow(self.longest, HEAD * self.longest, WIDTH * self.longest)
        down = np.array([1.0, -1.0, -1.0])  # half a turn about x
        self._dot, self._states = sphere(dot), _state_shapes(dot)
        self._push = full.shifted([0, 0, -self.longest])
        self._pull = full.scaled(down)

    def draw(self, contacts: ContactTracks, script: Script) -> None:
        """Draw the contacts of one arm."""
        lengths = self._animation.arrow_lengths(contacts)  # (K, N)
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
        parts = {state: [shape] for state, shape in self._states.items()}
        parts[ContactState.TOUCHING] = []
        marks = {}
        for state, extra in parts.items():
            mark = merge([dot, *([] if state == ContactState.RESTING else [self._needle]), *extra])
            marks[state] = seen_through(mark, np.ones(3))
        open_mark = self._states[ContactState.RESTING].painted(np.ones(3))
        faint = commands.ghost(contacts.color, FAINT)
        marks[ContactState.OPEN] = commands.mesh_object(open_mark, faint)
        return marks


def _state_shapes(dot: float) -> dict[int, TriangleMesh]:
    """Return the shapes around a dot of some radius [m] for each state, in the state's colour."""
    shapes = {
        ContactState.SLIDING: ring(2.0 * dot, 3.0 * dot, 0.35 * dot),
        ContactState.STICKING: box([4.4 * dot, 4.4 * dot, 0.7 * dot]),
        ContactState.RESTING: ring(1.5 * dot, 1.9 * dot, 0.35 * dot),
    }
    return {
        state: shape.painted(commands.rgb(STATE_STYLES[state].colour))
        for state, shape in shapes.items()
    }


def ring(inner: float, outer: float, thick: float) -> TriangleMesh:
    """Return a flat ring about z between two radii [m]."""
    low, high = -thick / 2, thick / 2
    return revolve([(inner, low), (outer, low), (outer, high), (inner, high), (inner, low)])


def _draw_mark(
    path: str, marks: dict[int, dict[str, Any]], states: np.ndarray | None, script: Script
) -> None:
    """Draw one mark for each state that occurs in ``states``, codes of shape (K,)."""
    if states is None:
        script.put(path, marks[ContactState.TOUCHING])
        return
    for code in np.unique(states):
        script.put(f"{path}/{ContactState(code).word}", marks[int(code)], states == code)


def arrow(length: float, head: float, radius: float) -> TriangleMesh:
    """Return an arrow from the origin along z; `radius` is that of its shaft [m]."""
    neck = length - head
    return revolve([(0, 0), (radius, 0), (radius, neck), (3 * radius, neck), (0, length)])


def seen_through(shape: TriangleMesh, color: np.ndarray) -> dict[str, Any]:
    """Return a shape that shines faintly through bodies in front of it."""
    return commands.mesh_object(shape, commands.shiny(color), commands.ghost(color, 0.38))


def _draw_force(
    path: str, shape: TriangleMesh, length: np.ndarray, color: np.ndarray, script: Script
) -> None:
    """Draw an arrow of changing `length` (K,), 1 being the longest."""
    if length.max() < HAIR:
        return
    script.put(path, seen_through(shape, color))
    width = np.sqrt(length)
    script.set(path, "scale", np.maximum(np.column_stack([width, width, length]), HAIR))


DARK = 0.55  # of the arm's colour: what is drawn on, not part of the arm
BEYOND = np.array([0.84, 0.15, 0.13])
HAND = np.array([0.16, 0.18, 0.22])
SECTOR = 0.45  # radius of a sector, of the length of an axis
HAND_LENGTH = 1.12  # of the radius of its sector
STEP = np.deg2rad(3.0)  # [rad] between the corners of a sector
FULL_TURN = 2 * np.pi


class Hinges:
    """Shapes and sizes [m] of all joints of an animation, in proportion to its `size` [m]."""

    def __init__(self, animation: Animation, size: float) -> None:
        self.length = min(0.15 * size, 0.5 * _object_size(animation))  # of an axis without limits

    def points(self, hinge: HingeTracks) -> np.ndarray:
        """Return world points whose hull holds a joint at every frame, shape (P, 3)."""
        corners = self._axis(hinge).bounds()
        if any(dial.turns for dial in hinge.dials):
            wide = [[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]
            around = HAND_LENGTH * SECTOR * self.length * np.array(wide)
            corners = np.concatenate([corners, around + [0, 0, self._upper_end(hinge)]])
        return moving(corners, hinge.position, hinge.quaternion_xyzw).reshape(-1, 3)

    def draw(self, hinge: HingeTracks, script: Script) -> None:
        """Draw one joint."""
        node = f"joints/{hinge.name}"
        script.move(node, hinge.position, hinge.quaternion_xyzw)
        if hinge.shown is not None:
            script.set(node, "scale", np.where(hinge.shown, 1.0, HAIR)[:, None] * np.ones(3))
        script.put(f"{node}/axis", seen_through(self._axis(hinge), DARK * hinge.color))
        for dial in hinge.dials:
            if dial.turns:
                script.set(f"{node}/turn", "position", np.array([[0, 0, self._upper_end(hinge)]]))
                self._draw_sector(f"{node}/turn", dial, hinge.color, script)
            else:
                self._draw_rail(f"{node}/slide", dial, hinge.color, script)

    def _ends(self, hinge: HingeTracks) -> tuple[float, float]:
        """Return where the rod of an axis begins and ends along the axis [m]."""
        low, high = -self.length / 2, self.length / 2
        for dial in hinge.dials:
            if not dial.turns:
                over = self.length / 6  # room for stop and arrowhead
                low, high = min(low, dial.limits[0] - over), max(high, dial.limits[1] + over)
        return low, high

    def _upper_end(self, hinge: HingeTracks) -> float:
        """Return the end of an axis that is the higher one in the first frame [m]."""
        low, high = self._ends(hinge)
        upwards = rotations(hinge.quaternion_xyzw[:1])[0, 2, 2] > -1e-6
        clear = self.length / 45  # of the head
        return high + clear if upwards else low - clear

    def _axis(self, hinge: HingeTracks) -> TriangleMesh:
        length, (low, high) = self.length, self._ends(hinge)
        thin, wide = length / 90, length / 22
        if hinge.shape == "ball":
            return sphere(length / 14)
        if hinge.shape == "axle":
            heads = [_rod(wide, end - thin, end + thin) for end in (low, high)]
            return merge([_rod(thin, low, high), *heads])
        neck = 2.5 * wide
        head = revolve([(0, -neck), (wide, -neck), (0, 0)])
        parts = [_rod(thin, low + neck, high - neck), head.shifted([0, 0, high])]
        parts.append(head.scaled(-np.ones(3)).shifted([0, 0, low]))
        if hinge.shape == "sleeve":
            parts.append(_rod(wide, -1.5 * wide, 1.5 * wide))
        return merge(parts)

    def _draw_sector(self, node: str, dial: Dial, color: np.ndarray, script: Script) -> None:
        radius = SECTOR * self.length
        rim = radius * _arc(*dial.limits)
        glass = commands.shiny(color, 0.45), commands.ghost(color, 0.18)
        script.put(f"{node}/sector", commands.mesh_object(_fan(rim), *glass))
        outline = _outline(rim, closed=np.ptp(dial.limits) >= FULL_TURN)
        edge = commands.line_object(outline, np.append(DARK * color, 0.9))
        script.put(f"{node}/sector/edge", edge)
        hand = arrow(HAND_LENGTH * radius, 0.25 * radius, 0.025 * radius).moved(Z_TO_X)
        _draw_pointer(f"{node}/hand", hand, dial, script)
        zero, half = 0 * dial.value, dial.value / 2
        turns = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
        script.set(f"{node}/hand", "quaternion", turns)

    def _draw_rail(self, node: str, dial: Dial, color: np.ndarray, script: Script) -> None:
        wide = self.length / 22
        (low, high), stop = dial.limits, wide / 4
        stops = [_rod(1.6 * wide, low - 2 * stop, low), _rod(1.6 * wide, high, high + 2 * stop)]
        rail = merge([_rod(wide / 2, low, high), *stops])
        script.put(f"{node}/rail", seen_through(rail, color))
        _draw_pointer(f"{node}/bead", _rod(1.2 * wide, -0.5 * wide, 0.5 * wide), dial, script)
        zero = 0 * dial.value
        script.set(f"{node}/bead", "position", np.column_stack([zero, zero, dial.value]))


def _draw_pointer(path: str, shape: TriangleMesh, dial: Dial, script: Script) -> None:
    """Draw a pointer in its usual colour, and in another one that takes its place beyond limits."""
    least, most = dial.passed_at
    within = (dial.value >= least) & (dial.value <= most)
    for name, color, seen in (("within", HAND, within), ("beyond", BEYOND, ~within)):
        if seen.any():
            script.put(f"{path}/{name}", seen_through(shape, color), seen)


def _rod(radius: float, low: float, high: float) -> TriangleMesh:
    return cylinder(radius, high - low).shifted([0, 0, (low + high) / 2])


def _arc(low: float, high: float) -> np.ndarray:
    """Return points of the unit circle from one angle to the other, shape (P, 3)."""
    high = min(high, low + FULL_TURN)
    angle = np.linspace(low, high, max(2, int(np.ceil((high - low) / STEP)) + 1))
    return np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])


def _fan(rim: np.ndarray) -> TriangleMesh:
    """Return the flat sector between the origin and a rim (P, 3), seen from both sides."""
    step = np.arange(1, len(rim))
    front = np.column_stack([0 * step, step, step + 1])
    vertices = np.concatenate([[np.zeros(3)], rim])
    return TriangleMesh(vertices, np.concatenate([front, front[:, ::-1]]))


def _outline(rim: np.ndarray, closed: bool) -> np.ndarray:
    """Return the segments (2 L, 3) around a sector; of a whole circle only the rim."""
    corners = rim if closed else np.concatenate([[np.zeros(3)], rim, [np.zeros(3)]])
    return np.stack([corners[:-1], corners[1:]], axis=1).reshape(-1, 3)


DURATION = 0.4  # [s] of the viewer
AT_ONCE = 4  # glyphs of one family
RADIUS = 0.035  # of the animation's size
LEAST = 0.4  # of full size: a glyph that is seen in one frame only


def draw_events(
    events: Sequence[EventPlace], time: np.ndarray, size: float, script: Script
) -> None:
    """Draw the events of an animation of some size [m].

    Times of events and of the frames, shape (K,), are seconds of the viewer.
    """
    for k, family in enumerate(FAMILIES):
        of_family = [event for event in events if event.family is family]
        for slot, (position, scale) in enumerate(event_tracks(of_family, time)):
            path = f"events/{k}_{slot}"
            shape = _shape(family, RADIUS * size)
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


def _shape(family: Family, radius: float) -> TriangleMesh:
    if family is MADE:
        spike = revolve([(0, -radius), (0.14 * radius, 0), (0, radius)])
        return merge([spike.moved(turn) for turn in _turns_of_z(_STAR)])
    if family is LOST:
        hoop = ring(0.8 * radius, radius, 0.08 * radius)
        return merge([hoop.moved(turn) for turn in _turns_of_z(np.eye(3))])
    return revolve([(0, -0.7 * radius), (0.4 * radius, 0), (0, 0.7 * radius)])


_STAR = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], *([i, j, 1] for i in (-1, 1) for j in (-1, 1))])


def _turns_of_z(axes: np.ndarray) -> np.ndarray:
    """Return poses (A, 4, 4) that turn z onto each of some axes (A, 3)."""
    poses = np.tile(np.eye(4), (len(axes), 1, 1))
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    poses[:, :3, :3] = rotations(along(unit[None])[0])
    return poses


def _object_size(animation: Animation) -> float:
    """Return the shortest diagonal of the objects' bounding boxes [m]."""
    objects = animation.bodies[: animation.objects]
    return min(float(np.linalg.norm(np.ptp(body.mesh.bounds(), axis=0))) for body in objects)
