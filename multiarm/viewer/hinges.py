"""Glyphs of joints: an axle, a rail, a sleeve or a ball, and their limits.

An axis is a slim rod on the body that carries it: with a head at both ends (it is turned about),
with arrowheads (it is slid along), or with arrowheads and a sleeve (both). A ball is a ball. An
angle with limits is a sector at the upper end of the axis, clear of the arm, with a hand that turns
with the tip; a slide with limits is a rail between two stops with a bead. Hand and bead are red
where they are beyond the limits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.viewer import commands
from multiarm.viewer.animation import Animation, Dial, HingeTracks, continuous, rotations
from multiarm.viewer.commands import Script
from multiarm.viewer.glyphs import HAIR, arrow, seen_through
from multiarm.viewer.mesh import Mesh, cylinder, merge, revolve, shade, sphere

DARK = 0.55  # of the arm's colour: what is drawn on, not part of the arm
BEYOND = np.array([0.84, 0.15, 0.13])
HAND = np.array([0.16, 0.18, 0.22])
SECTOR = 0.45  # radius of a sector, of the length of an axis
HAND_LENGTH = 1.12  # of the radius of its sector
STEP = np.deg2rad(3.0)  # [rad] between the corners of a sector
FULL_TURN = 2 * np.pi


class Hinges:
    """Shapes and sizes [m] of all joints of an animation, in proportion to its size.

    Parameters
    ----------
    animation : Animation
    size : float
        The animation's size [m].
    """

    def __init__(self, animation: Animation, size: float) -> None:
        body = float(np.linalg.norm(np.ptp(animation.bodies[0].mesh.bounds(), axis=0)))
        self.length = min(0.15 * size, 0.5 * body)  # of an axis without limits

    def points(self, hinge: HingeTracks) -> np.ndarray:
        """Return world points whose hull holds a joint at every frame, shape (P, 3)."""
        corners = self._axis(hinge).bounds()
        if any(dial.turns for dial in hinge.dials):
            wide = [[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)]
            around = HAND_LENGTH * SECTOR * self.length * np.array(wide)
            corners = np.concatenate([corners, around + [0, 0, self._upper_end(hinge)]])
        R = rotations(hinge.quaternion_xyzw)  # (K, 3, 3)
        world = np.einsum("kij,cj->kci", R, corners) + hinge.position[:, None]
        return world.reshape(-1, 3)

    def draw(self, hinge: HingeTracks, script: Script) -> None:
        """Draw one joint."""
        node = f"joints/{hinge.name}"
        script.move(node, hinge.position, continuous(hinge.quaternion_xyzw))
        script.put(f"{node}/axis", seen_through(shade(self._axis(hinge)), DARK * hinge.color))
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

    def _axis(self, hinge: HingeTracks) -> Mesh:
        length, (low, high) = self.length, self._ends(hinge)
        thin, wide = length / 90, length / 22
        if hinge.shape == "ball":
            return sphere(length / 14)
        if hinge.shape == "axle":
            heads = [_rod(wide, end - thin, end + thin) for end in (low, high)]
            return merge([_rod(thin, low, high), *heads])
        neck = 2.5 * wide
        head = revolve([(0, -neck), (wide, -neck), (0, 0)])
        parts = [_rod(thin, low + neck, high - neck), head.moved(_lifted(high))]
        parts.append(head.scaled(-np.ones(3)).moved(_lifted(low)))
        if hinge.shape == "sleeve":
            parts.append(_rod(wide, -1.5 * wide, 1.5 * wide))
        return merge(parts)

    def _draw_sector(self, node: str, dial: Dial, color: np.ndarray, script: Script) -> None:
        radius = SECTOR * self.length
        rim = radius * _arc(*dial.limits)
        script.put(f"{node}/sector", commands.mesh_object(shade(_fan(rim)), *_glass(color)))
        outline = _outline(rim, closed=np.ptp(dial.limits) >= FULL_TURN)
        rgba = np.tile(np.append(DARK * color, 0.9), (len(outline), 1))
        script.put(f"{node}/sector/edge", commands.line_object(outline, rgba))
        to_x = np.eye(4)[[2, 0, 1, 3]]  # z -> x
        hand = arrow(HAND_LENGTH * radius, 0.25 * radius, 0.025 * radius).moved(to_x)
        _draw_pointer(f"{node}/hand", hand, dial, script)
        zero, half = 0 * dial.value, dial.value / 2
        turns = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
        script.set(f"{node}/hand", "quaternion", turns)

    def _draw_rail(self, node: str, dial: Dial, color: np.ndarray, script: Script) -> None:
        wide = self.length / 22
        (low, high), stop = dial.limits, wide / 4
        stops = [_rod(1.6 * wide, low - 2 * stop, low), _rod(1.6 * wide, high, high + 2 * stop)]
        rail = merge([_rod(wide / 2, low, high), *stops])
        script.put(f"{node}/rail", seen_through(shade(rail), color))
        _draw_pointer(f"{node}/bead", _rod(1.2 * wide, -0.5 * wide, 0.5 * wide), dial, script)
        zero = 0 * dial.value
        script.set(f"{node}/bead", "position", np.column_stack([zero, zero, dial.value]))


def _draw_pointer(path: str, shape: Mesh, dial: Dial, script: Script) -> None:
    """Draw a pointer in its usual colour, and in another one that takes its place beyond limits."""
    low, high = dial.limits
    slack = 1e-6 * (high - low)  # a stop that is touched is not passed
    within = (dial.value >= low - slack) & (dial.value <= high + slack)
    for name, color, seen in (("within", HAND, within), ("beyond", BEYOND, ~within)):
        if seen.any():
            script.put(f"{path}/{name}", seen_through(shade(shape), color))
            script.set(f"{path}/{name}", "scale", np.where(seen, 1.0, HAIR)[:, None] * np.ones(3))


def _glass(color: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    return commands.shiny(color, 0.45), commands.ghost(color, 0.18)


def _rod(radius: float, low: float, high: float) -> Mesh:
    return cylinder(radius, high - low).moved(_lifted((low + high) / 2))


def _lifted(height: float) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = height
    return pose


def _arc(low: float, high: float) -> np.ndarray:
    """Return points of the unit circle from one angle to the other, shape (P, 3)."""
    high = min(high, low + FULL_TURN)
    angle = np.linspace(low, high, max(2, int(np.ceil((high - low) / STEP)) + 1))
    return np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])


def _fan(rim: np.ndarray) -> Mesh:
    """Return the flat sector between the origin and a rim (P, 3), seen from both sides."""
    step = np.arange(1, len(rim))
    front = np.column_stack([0 * step, step, step + 1])
    vertices = np.concatenate([[np.zeros(3)], rim])
    return Mesh(vertices, np.concatenate([front, front[:, ::-1]]))


def _outline(rim: np.ndarray, closed: bool) -> np.ndarray:
    """Return the segments (2 L, 3) around a sector; of a whole circle only the rim."""
    corners = rim if closed else np.concatenate([[np.zeros(3)], rim, [np.zeros(3)]])
    return np.stack([corners[:-1], corners[1:]], axis=1).reshape(-1, 3)
