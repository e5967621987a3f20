"""Draw an animation: the Meshcat commands that show it in any Meshcat viewer.

The stage (background, lights, floor, world frame) and the camera scale with the size of the
animation, so that a finger-sized mechanism and a scene of ten metres look alike.

The camera keeps all bodies in the picture at all times.  A point p is inside a picture of
half-angle tangents (t_x, t_y), seen from distance d along the unit direction f towards the target
c, when

    |(p - c) . right| <= t_x (d + (p - c) . f),    |(p - c) . up| <= t_y (d + (p - c) . f),

which is linear in d: the smallest distance that holds every point is a maximum over the points.
The target starts at the middle of the points and is moved until the picture is centred.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multiarm.geometry.triangle_mesh import TriangleMesh, merge, sharp_edges
from multiarm.viewer import commands
from multiarm.viewer.animation import Animation, Body, rotations
from multiarm.viewer.commands import ROOT, Command, Script
from multiarm.viewer.glyphs import Hinges, Marks, arrow, draw_events
from multiarm.viewer.sight import AZIMUTH, ELEVATION, clear_azimuth, view_axes
from multiarm.viewer.solids import Z_TO_X

FAINT = 0.3  # of a surface's opacity, while nothing touches it
TINT = 0.8  # of a body's own colour; the rest is light, which keeps dark parts readable
LAYERS = 32  # more would shift depths visibly


def draw(animation: Animation, speed: float = 1.0) -> list[Command]:
    """Return the commands that show an animation.

    Everything in the world hangs below the node ``/world``, where poses are those of the animation,
    `speed` seconds of it per second of the viewer.
    """
    script, points, size = Script(), animation.extent(), animation.size()
    marks, hinges = Marks(animation, size), Hinges(animation, size)
    reach = [hinges.points(hinge) for hinge in animation.hinges]
    shown = np.concatenate([points, animation.tails(marks.longest), *reach])
    view = frame(shown, clear_azimuth(animation))
    draw_stage(script, view, points, size, animation.floor)
    for i, body in enumerate(animation.bodies):
        _draw_body(body, i % LAYERS, script)
    for contacts in animation.contacts:
        marks.draw(contacts, script)
    for hinge in animation.hinges:
        hinges.draw(hinge, script)
    time = (animation.time - animation.time[0]) / speed
    start = animation.time[0]
    events = [replace(e, time=(e.time - start) / speed) for e in animation.event_places]
    draw_events(events, time, size, script)
    return script.finished(time)


def _draw_body(body: Body, layer: int, script: Script) -> None:
    shown: list[tuple[str, float, np.ndarray | None]] = [(body.name, 1.0, None)]
    if body.touched is not None and not body.touched.all():
        shown = [(f"{body.name}/open", FAINT, ~body.touched)]
        if body.touched.any():
            shown = [(f"{body.name}/touched", 1.0, body.touched), *shown]
    for path, strength, seen in shown:
        opacity = strength * body.opacity
        material = commands.shiny(1 - TINT * (1 - body.color), opacity, layer)
        script.put(path, commands.mesh_object(body.mesh, material), seen)
        if opacity < 1:  # glass needs its outline
            ends = sharp_edges(body.mesh).reshape(-1, 3)
            rgba = np.append(0.45 * body.color, 0.9 * strength)
            script.put(f"{path}/edges", commands.line_object(ends, rgba))
    script.move(body.name, body.position, body.quaternion_xyzw)


TOP_COLOR, BOTTOM_COLOR = [0.80, 0.85, 0.90], [0.97, 0.97, 0.96]
GRID_COLOR = np.array([0.42, 0.48, 0.56])
LIGHT_DIRECTION = np.array([0.42, -0.48, 1.0]) / np.linalg.norm([0.42, -0.48, 1.0])
FILL_DIRECTION = np.array([-0.8, -0.35, 0.45])
DEFAULTS = (
    "/Grid",
    "/Axes",
    "/Lights/PointLightNegativeX",
    "/Lights/PointLightPositiveX",
    "/Lights/FillLight",
    "/Lights/AmbientLight",
)  # of Meshcat's own


def draw_stage(script: Script, view: Camera, points: np.ndarray, size: float, floor: float) -> None:
    """Draw background, lights, floor and world frame around `points`, and set the camera.

    Points, shape (P, 3), and the floor's height are in the world [m], as the scene's `size`.
    """
    script.add(*_look(view, size), *_light(points - view.target, size, view.azimuth - AZIMUTH))
    x, y = (points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2
    ground = np.array([x, y, floor - 1e-3 * size])  # nothing on the floor flickers through it
    script.put("floor/shadows", commands.shadow_catcher(8 * size, 0.17))
    script.set("floor/shadows", "position", ground[None])
    script.put("floor/grid", _grid(ground, size))
    script.put("frame", commands.mesh_object(_axes(0.06 * size), commands.flat(np.ones(3))))


def _look(view: Camera, size: float) -> list[Command]:
    """Aim the camera. Meshcat's looks at the origin always: the world is moved instead."""
    x, y, z = view.position - view.target
    path = "/Cameras/default/rotated/<object>"
    return [
        commands.set_property(ROOT, "position", (-view.target).tolist()),
        commands.set_property(path, "position", [x, z, -y]),  # this camera's own up is y
        commands.set_property(path, "fov", FIELD_OF_VIEW),
        commands.set_property(path, "near", view.distance / 200),
        commands.set_property(path, "far", view.distance + 20 * size),
    ]


def _light(points: np.ndarray, size: float, turn: float) -> list[Command]:
    """Return background and lights for `points` (P, 3) about the origin of the view.

    They are turned with the camera, from its usual place by an angle [rad].
    """
    turned = rotations(np.array([[0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)]]))[0]
    sky = commands.light("HemisphereLight", np.array([0, 0, 1]), 0.62, groundColor=0xC9C2B8)
    fill = commands.light("DirectionalLight", turned @ FILL_DIRECTION, 0.22)
    return [
        commands.set_property("/Background", "top_color", TOP_COLOR),
        commands.set_property("/Background", "bottom_color", BOTTOM_COLOR),
        *(commands.set_property(path, "visible", False) for path in DEFAULTS),
        commands.set_object("/Lights/Sky", sky),
        commands.set_property("/Lights/Sky/<object>", "castShadow", False),
        commands.set_object("/Lights/Fill", fill),
        commands.set_property("/Lights/Fill/<object>", "castShadow", False),
        commands.set_object("/Lights/Key", _key_light(points, size, turned @ LIGHT_DIRECTION)),
    ]


def _key_light(points: np.ndarray, size: float, direction: np.ndarray) -> dict[str, Any]:
    """Return the light that casts shadows; its shadow camera covers just the `points`, (P, 3)."""
    right = np.cross([0, 0, 1], direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    x, y, height = points @ right, points @ up, points @ direction
    distance, pad = height.max() + size, 0.05 * size
    lens = {
        "type": "OrthographicCamera",
        "left": x.min() - pad,
        "right": x.max() + pad,
        "bottom": y.min() - pad,
        "top": y.max() + pad,
        "near": 0.5 * size,
        "far": distance - height.min() + 4 * size,
    }
    shadow = {
        "camera": lens,
        "mapSize": [2048, 2048],
        "bias": -4e-4,
        "normalBias": 1.5e-3 * size,
        "radius": 3,
    }
    return commands.light("DirectionalLight", distance * direction, 0.52, shadow=shadow)


def _grid(ground: np.ndarray, size: float) -> dict[str, Any]:
    """Return floor lines at round distances that fade out away from the scene."""
    cell = _round_length(size / 14)
    cells = int(np.ceil(1.4 * size / cell))
    ticks = np.arange(-cells, cells + 1)
    origin = np.round(ground[:2] / cell)  # lines stay at multiples of the cell
    a, b = np.meshgrid(ticks[:-1], ticks, indexing="ij")
    starts = np.column_stack([a.reshape(-1), b.reshape(-1)])
    ends = starts + [1, 0]
    segments = np.stack([starts, ends], axis=1)  # (L, 2, 2), along x
    segments = np.concatenate([segments, segments[..., ::-1]]).reshape(-1, 2)
    radius = np.linalg.norm(segments, axis=1) / cells
    alpha = 0.55 * np.clip(1 - radius, 0, 1) ** 1.5
    xy = (segments + origin) * cell
    points = np.column_stack([xy, np.full(len(xy), ground[2])])
    return commands.line_object(points, np.column_stack([np.tile(GRID_COLOR, (len(xy), 1)), alpha]))


def _round_length(length: float) -> float:
    """Return the nearest of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return power * min((1, 2, 5, 10), key=lambda n: abs(np.log(length / (n * power))))


def _axes(length: float) -> TriangleMesh:
    """Return the world frame: x red, y green, z blue."""
    z = arrow(length, 0.25 * length, 0.02 * length)
    x, y = z.moved(Z_TO_X.T), z.moved(Z_TO_X)
    colors = ([0.83, 0.29, 0.27], [0.35, 0.64, 0.34], [0.25, 0.44, 0.78])
    return merge([m.painted(np.array(c)) for m, c in zip((x, y, z), colors, strict=True)])


FIELD_OF_VIEW = 26.0  # vertical [deg]; a long lens keeps parallels nearly parallel
ASPECT = 1.6  # width / height of the picture that is framed
MARGIN = 0.82  # of the picture that the scene may fill; the rest is for title and time bar
LIFT = 0.03  # of the picture's half height: the time bar is taller than the title


@dataclass(frozen=True)
class Camera:
    """A camera that looks from `position` at `target`, shape (3,), world [m], z upwards."""

    position: np.ndarray
    target: np.ndarray
    azimuth: float = AZIMUTH  # of the position, seen from the target [rad]

    @property
    def distance(self) -> float:
        """Distance from the camera to its target [m]."""
        return float(np.linalg.norm(self.position - self.target))


def frame(points: np.ndarray, azimuth: float = AZIMUTH) -> Camera:
    """Return a view from above that holds all `points`, (P, 3), world [m]; from the front right."""
    towards, right, up = view_axes(azimuth, ELEVATION)
    tan_y = np.tan(np.deg2rad(FIELD_OF_VIEW) / 2) * MARGIN
    tan_x = tan_y * ASPECT
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    distance = 0.0
    for _ in range(8):
        x, y, depth = ((points - target) @ axis for axis in (right, up, towards))
        distance = max((np.abs(x) / tan_x - depth).max(), (np.abs(y) / tan_y - depth).max())
        x_seen, y_seen = x / (distance + depth), y / (distance + depth)
        target = (
            target
            + (x_seen.min() + x_seen.max()) / 2 * distance * right
            + (y_seen.min() + y_seen.max()) / 2 * distance * up
        )
    target = target - LIFT * tan_y * distance * up
    return Camera(target - distance * towards, target, azimuth)
