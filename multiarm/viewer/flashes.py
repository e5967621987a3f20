"""Draw what happens at a place: a short flash, in the shape and colour of its family of events.

A filled star where a contact is made or hit, a hollow cage where one is lost, a diamond for the
rest. A flash is full in the first frame after its event and shrinks. Each family has a few flashes
that take turns, so that a thousand impacts cost no more than a few; what finds all of them burning
is not shown.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multiarm.results.event_log import FAMILIES, LOST, MADE, Family
from multiarm.viewer import commands
from multiarm.viewer.film import Moment
from multiarm.viewer.marks import HAIR, ring
from multiarm.viewer.mesh import Mesh, merge, revolve, shade
from multiarm.viewer.script import Script

DURATION = 0.4  # [s] of the viewer
AT_ONCE = 4  # flashes of one family
RADIUS = 0.035  # of the film's size
LEAST = 0.4  # of full size: a flash that is seen in one frame only


def draw_flashes(moments: Sequence[Moment], time: np.ndarray, size: float, script: Script) -> None:
    """Draw the flashes of a film.

    Parameters
    ----------
    moments : sequence of Moment
    time : array, shape (K,)
        Of the frames, in seconds of the viewer, as those of the moments.
    size : float
        The film's size [m].
    script : Script
    """
    for place, family in enumerate(FAMILIES):
        own = [moment for moment in moments if moment.family is family]
        for slot, (position, scale) in enumerate(tracks(own, time)):
            path = f"events/{place}_{slot}"
            shape = shade(_shape(family, RADIUS * size))
            color = commands.rgb(family.colour)
            glow = commands.flat(color), commands.ghost(color, 0.5)
            script.put(path, commands.mesh_object(shape, *glow))
            script.set(path, "position", position)
            script.set(path, "scale", np.repeat(scale[:, None], 3, axis=1))


def tracks(moments: Sequence[Moment], time: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return places (K, 3) and sizes (K,) in 0..1 of the flashes that some moments need."""
    slots: list[tuple[np.ndarray, np.ndarray]] = []
    free: list[int] = []  # the first frame in which each may begin again
    for moment in sorted(moments, key=lambda moment: moment.time):
        begin = min(int(np.searchsorted(time, moment.time)), len(time) - 1)
        end = max(int(np.searchsorted(time, moment.time + DURATION)), begin + 1)
        slot = next((i for i, frame in enumerate(free) if frame <= begin), len(free))
        if slot == AT_ONCE:
            continue
        if slot == len(free):
            free.append(0)
            slots.append((np.tile(moment.where, (len(time), 1)), np.full(len(time), HAIR)))
        position, scale = slots[slot]
        position[free[slot] :] = moment.where  # out of sight, it is already there
        left = 1.0 - (time[begin:end] - moment.time) / DURATION
        scale[begin:end] = np.maximum(left, HAIR)
        scale[begin] = max(scale[begin], LEAST)
        free[slot] = end + 1  # between two flashes there is a dark frame
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
