"""Meshcat's protocol: commands as plain data, with NumPy arrays as leaves.

A command is a dictionary as the Meshcat viewer takes it.  Typed arrays stay NumPy arrays until
the page stores them in a block of bytes (`page`).  Animations are written as whole tracks, not
key by key.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from multiarm.geometry.triangle_mesh import TriangleMesh
from multiarm.viewer.animation import continuous

Command = dict[str, Any]
FOREVER = 10**9  # repetitions of an animation
FRONT_SIDE, BOTH_SIDES = 0, 2  # of three.js

_counter = itertools.count()


def set_object(path: str, parts: dict[str, Any]) -> Command:
    """Put an object, made by one of the functions below, at a path of the scene tree."""
    data = {"metadata": {"version": 4.5, "type": "Object"}, "geometries": [], "materials": []}
    return {"type": "set_object", "path": path, "object": {**data, **parts}}


def set_property(path: str, name: str, value: Any) -> Command:
    """Set a property of a node; ``path/<object>`` addresses the object at the node itself."""
    return {"type": "set_property", "path": path, "property": name, "value": value}


def set_animation(time: np.ndarray, tracks: dict[str, dict[str, np.ndarray]]) -> Command:
    """Animate nodes: ``{path: {property: values (K, n)}}`` at instants `time`, shape (K,) [s]."""
    stamps = time.astype(np.float32)
    animations = []
    for path, properties in tracks.items():
        lowered = [
            {
                "name": f".{name}",
                "type": "quaternion" if name == "quaternion" else "vector3",
                "times": stamps,
                "values": values.astype(np.float32).reshape(-1),
            }
            for name, values in properties.items()
        ]
        animations.append({"path": path, "clip": {"fps": 1, "name": "default", "tracks": lowered}})
    options = {"play": True, "repetitions": FOREVER}
    return {"type": "set_animation", "path": "", "animations": animations, "options": options}


def mesh_object(mesh: TriangleMesh, *materials: dict[str, Any]) -> dict[str, Any]:
    """Return a mesh; several materials are drawn one over the other."""
    shaded = mesh.shaded
    kind = np.uint16 if len(shaded.vertices) < 2**16 else np.uint32
    index = shaded.triangles.reshape(-1).astype(kind)
    geometry = _buffer_geometry(
        {
            "position": _attribute(shaded.vertices.astype(np.float32)),
            "normal": _attribute(np.round(127 * shaded.normals).astype(np.int8)),
            "color": _attribute(np.round(255 * shaded.colors).astype(np.uint8)),
        }
    )
    geometry["data"]["index"] = {"type": array_type(index), "array": index}
    geometry["data"]["groups"] = [
        {"start": 0, "count": len(index), "materialIndex": i} for i in range(len(materials))
    ]
    return _drawable("Mesh", geometry, *materials)


def line_object(points: np.ndarray, rgba: np.ndarray) -> dict[str, Any]:
    """Return line segments between pairs of `points` (2 L, 3); `rgba` (2 L, 4) or (4,), 0..1."""
    rgba = np.broadcast_to(rgba, (len(points), 4))
    geometry = _buffer_geometry(
        {
            "position": _attribute(points.astype(np.float32)),
            "color": _attribute(np.round(255 * rgba).astype(np.uint8)),
        }
    )
    lines = _material("LineBasicMaterial", transparent=True, vertexColors=True, depthWrite=False)
    return _drawable("LineSegments", geometry, lines)


def shadow_catcher(side: float, opacity: float) -> dict[str, Any]:
    """Return a square in the x-y plane that shows only the shadows on it."""
    plane = {"uuid": _uuid(), "type": "PlaneGeometry", "width": side, "height": side}
    look = {"color": 0x1B2A41, "opacity": opacity, "transparent": True, "depthWrite": False}
    return _drawable("Mesh", plane, _material("ShadowMaterial", **look))


def shiny(color: np.ndarray, opacity: float = 1.0, layer: int = 0) -> dict[str, Any]:
    """Return a plastic-like material; its colour multiplies the colours of the mesh.

    Where surfaces coincide, as parts of a link often do, the higher `layer` is the one seen.
    """
    solid = opacity == 1
    return _material(
        "MeshPhongMaterial",
        color=hexadecimal(color),
        specular=0x2A2A2A if solid else 0x101010,
        shininess=38,
        vertexColors=True,
        side=BOTH_SIDES if solid else FRONT_SIDE,
        opacity=opacity,
        transparent=not solid,
        depthWrite=solid,
        polygonOffset=True,
        polygonOffsetUnits=-8 * layer,
    )


def flat(color: np.ndarray) -> dict[str, Any]:
    """Return a material that keeps its colour in light and shade."""
    return _material("MeshBasicMaterial", color=hexadecimal(color), vertexColors=True)


def ghost(color: np.ndarray, opacity: float) -> dict[str, Any]:
    """Return a material that shines faintly through bodies in front of it."""
    return _material(
        "MeshBasicMaterial",
        color=hexadecimal(color),
        vertexColors=True,
        opacity=opacity,
        transparent=True,
        depthTest=False,
        depthWrite=False,
    )


def light(kind: str, position: np.ndarray, intensity: float, **settings: Any) -> dict[str, Any]:
    """Return a three.js light of the given `kind`."""
    matrix = np.eye(4)
    matrix[:3, 3] = position
    return {
        "object": {
            "uuid": _uuid(),
            "type": kind,
            "color": 0xFFFFFF,
            "intensity": intensity,
            "matrix": matrix.T.reshape(-1).tolist(),
            **settings,
        }
    }


def hexadecimal(color: np.ndarray) -> int:
    """Return 0xRRGGBB of an sRGB colour in 0..1, shape (3,)."""
    r, g, b = (int(c) for c in np.round(255 * np.clip(np.asarray(color, float), 0, 1)))
    return r << 16 | g << 8 | b


def rgb(text: str) -> np.ndarray:
    """Return the sRGB colour in 0..1, shape (3,), of ``#rrggbb``."""
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)]) / 255


def lowered(value: Any, array: Callable[[np.ndarray], Any]) -> Any:
    """A command in types of JSON, with arrays as the encoder ``array`` makes them."""
    if isinstance(value, dict):
        return {key: lowered(item, array) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [lowered(item, array) for item in value]
    if isinstance(value, np.ndarray):
        return array(value)
    return value.item() if isinstance(value, np.generic) else value


def _drawable(kind: str, geometry: Command, *materials: Command) -> dict[str, Any]:
    names = [m["uuid"] for m in materials]
    body = {
        "uuid": _uuid(),
        "type": kind,
        "geometry": geometry["uuid"],
        "material": names if len(names) > 1 else names[0],
    }
    return {"geometries": [geometry], "materials": list(materials), "object": body}


def _buffer_geometry(attributes: dict[str, Any]) -> dict[str, Any]:
    return {"uuid": _uuid(), "type": "BufferGeometry", "data": {"attributes": attributes}}


def _attribute(values: np.ndarray) -> dict[str, Any]:
    return {
        "itemSize": values.shape[1],
        "type": array_type(values),
        "array": values.reshape(-1),
        "normalized": values.dtype.itemsize == 1,
    }


def array_type(values: np.ndarray) -> str:
    """The name of JavaScript's typed array for some values."""
    return values.dtype.name.capitalize() + "Array"


def _material(kind: str, **properties: Any) -> dict[str, Any]:
    return {"uuid": _uuid(), "type": kind, **properties}


def _uuid() -> str:
    """Return a name unique within this process; equal animations still compress to equal pages."""
    return f"multiarm-{next(_counter)}"


ROOT = "/world"  # the node below which poses are those of the animation
STILL = 1e-9  # a property that changes less than this does not move
HAIR = 1e-4  # scale of an invisible shape: zero would make its matrix singular


class Script:
    """Commands in order, and the tracks of moving nodes; paths are below the world's node."""

    def __init__(self) -> None:
        self._commands: list[Command] = []
        self._tracks: dict[str, dict[str, np.ndarray]] = {}

    def add(self, *commands: Command) -> None:
        """Append commands as they are."""
        self._commands += commands

    def put(self, path: str, drawn: dict[str, Any], seen: np.ndarray | None = None) -> None:
        """Put an object, made by a function of `commands`, at a path.

        It is visible in all frames, or in those of `seen`, (K,) of truth values.
        """
        self.add(set_object(f"{ROOT}/{path}", drawn))
        if seen is not None:
            self.set(path, "scale", np.where(seen, 1.0, HAIR)[:, None] * np.ones(3))

    def set(self, path: str, name: str, values: np.ndarray) -> None:
        """Give a property its values (K, n): the first now, all in the animation if they differ."""
        node = f"{ROOT}/{path}"
        self.add(set_property(node, name, values[0].tolist()))
        if np.ptp(values, axis=0).max() > STILL:
            self._tracks.setdefault(node, {})[name] = values

    def move(self, path: str, position: np.ndarray, quaternion_xyzw: np.ndarray) -> None:
        """Move a node through positions (K, 3) [m] and orientations (K, 4)."""
        self.set(path, "position", position)
        self.set(path, "quaternion", continuous(quaternion_xyzw))

    def finished(self, time: np.ndarray) -> list[Command]:
        """Return all commands; frame k is shown `time[k]` [s] after the start."""
        if len(time) < 2 or not self._tracks:
            return self._commands
        return [*self._commands, set_animation(time, self._tracks)]
