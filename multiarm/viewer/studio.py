"""The studio in which a film is shown: background, lights, floor, world frame, camera.

All is measured by the film's own size, so that a finger-sized mechanism and a scene of ten metres
look alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from multiarm.viewer import camera, commands
from multiarm.viewer.commands import Command
from multiarm.viewer.marks import arrow
from multiarm.viewer.mesh import Mesh, merge, shade
from multiarm.viewer.script import ROOT, Script

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


def furnish(script: Script, view: camera.Camera, points: np.ndarray, floor: float) -> None:
    """Set up everything around a film whose bodies fill `points`, shape (P, 3) [m].

    Parameters
    ----------
    script : Script
    view : Camera
    points : array, shape (P, 3)
        World positions [m].
    floor : float
        Height of the floor [m].
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    script.add(*_look(view, size), *_light(points - view.target, size))
    x, y = (points[:, :2].min(axis=0) + points[:, :2].max(axis=0)) / 2
    ground = np.array([x, y, floor - 1e-3 * size])  # nothing on the floor flickers through it
    script.put("floor/shadows", commands.shadow_catcher(8 * size, 0.17))
    script.set("floor/shadows", "position", ground[None])
    script.put("floor/grid", _grid(ground, size))
    frame = shade(_axes(0.06 * size))
    script.put("frame", commands.mesh_object(frame, commands.flat(np.ones(3))))


def _look(view: camera.Camera, size: float) -> list[Command]:
    """Aim the camera. Meshcat's looks at the origin always: the world is moved instead."""
    x, y, z = view.position - view.target
    path = "/Cameras/default/rotated/<object>"
    return [
        commands.set_property(ROOT, "position", (-view.target).tolist()),
        commands.set_property(path, "position", [x, z, -y]),  # this camera's own up is y
        commands.set_property(path, "fov", camera.FIELD_OF_VIEW),
        commands.set_property(path, "near", view.distance / 200),
        commands.set_property(path, "far", view.distance + 20 * size),
    ]


def _light(points: np.ndarray, size: float) -> list[Command]:
    """Return background and lights for `points` (P, 3) about the origin of the view."""
    sky = commands.light("HemisphereLight", np.array([0, 0, 1]), 0.62, groundColor=0xC9C2B8)
    fill = commands.light("DirectionalLight", FILL_DIRECTION, 0.22)
    return [
        commands.set_property("/Background", "top_color", TOP_COLOR),
        commands.set_property("/Background", "bottom_color", BOTTOM_COLOR),
        *(commands.set_property(path, "visible", False) for path in DEFAULTS),
        commands.set_object("/Lights/Sky", sky),
        commands.set_property("/Lights/Sky/<object>", "castShadow", False),
        commands.set_object("/Lights/Fill", fill),
        commands.set_property("/Lights/Fill/<object>", "castShadow", False),
        commands.set_object("/Lights/Key", _key_light(points, size)),
    ]


def _key_light(points: np.ndarray, size: float) -> dict[str, Any]:
    """Return the light that casts shadows; its shadow camera covers just the film's `points`."""
    right = np.cross([0, 0, 1], LIGHT_DIRECTION)
    right /= np.linalg.norm(right)
    up = np.cross(LIGHT_DIRECTION, right)
    x, y, height = points @ right, points @ up, points @ LIGHT_DIRECTION
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
    return commands.light("DirectionalLight", distance * LIGHT_DIRECTION, 0.52, shadow=shadow)


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


def _axes(length: float) -> Mesh:
    """Return the world frame: x red, y green, z blue."""
    z = arrow(length, 0.25 * length, 0.02 * length)
    cycle = np.eye(4)[[2, 0, 1, 3]]  # z -> x -> y -> z
    x, y = z.moved(cycle.T), z.moved(cycle)
    colors = ([0.83, 0.29, 0.27], [0.35, 0.64, 0.34], [0.25, 0.44, 0.78])
    return merge([m.painted(np.array(c)) for m, c in zip((x, y, z), colors, strict=True)])
