"""Colours of Collada files: the triangles of a `.dae` with the diffuse colour of each.

Pinocchio's mesh loader yields positions and triangles of every common format, but drops the
materials. A robot is easier to read with its dark joints and bright shells, so for Collada, the
one format of the usual robots that carries materials, this reader follows geometry, node
transforms and materials. It knows what exporters of robots write (triangles and polygon lists,
static nodes) and answers None for anything else: the caller then uses the plain triangles.
Like the loader, it applies the file's unit and ignores its up axis.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from multiarm.viewer.mesh import Mesh, merge

GREY = np.array([0.8, 0.8, 0.8])


class _UnsupportedError(Exception):
    """The file uses, or lacks, something outside the reader's subset."""


def read_collada(path: Path) -> Mesh | None:
    """Return the coloured triangles of a Collada file [m], or None if it cannot be read so."""
    try:
        root = ElementTree.parse(path).getroot()
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]  # drop the namespace
        return _Collada(root).mesh()
    except (ElementTree.ParseError, OSError, ValueError, _UnsupportedError):
        return None


class _Collada:
    """One parsed document: look-up by id, then a walk over its visual scene."""

    def __init__(self, root: Element) -> None:
        self.root = root
        self.by_id = {e.get("id"): e for e in root.iter() if e.get("id")}

    def mesh(self) -> Mesh:
        unit = self.root.find("asset/unit")
        meter = 1.0 if unit is None else float(unit.get("meter", 1.0))
        scene = self._target(_child(self.root, "scene/instance_visual_scene"), "url")
        parts: list[Mesh] = []
        for node in scene.findall("node"):
            self._walk(node, np.diag([meter, meter, meter, 1.0]), parts)
        if not parts:
            raise _UnsupportedError
        return merge(parts)

    def _target(self, element: Element, attribute: str) -> Element:
        """Return what an attribute such as ``url="#id"`` refers to."""
        target = self.by_id.get(_word(element, attribute).removeprefix("#"))
        if target is None:
            raise _UnsupportedError
        return target

    def _walk(self, node: Element, pose: np.ndarray, parts: list[Mesh]) -> None:
        _refuse(node, "instance_node", "instance_controller", "lookat", "skew")
        for child in node:
            pose = pose @ _transform(child)
        for instance in node.findall("instance_geometry"):
            materials = {m.get("symbol"): m for m in instance.iter("instance_material")}
            parts += [mesh.moved(pose) for mesh in self._geometry(instance, materials)]
        for child in node.findall("node"):
            self._walk(child, pose, parts)

    def _geometry(self, instance: Element, materials: dict[str | None, Element]) -> list[Mesh]:
        mesh = _child(self._target(instance, "url"), "mesh")
        _refuse(mesh, "polygons", "tristrips", "trifans")
        parts = []
        for group in mesh.findall("triangles") + mesh.findall("polylist"):
            triangles, positions = _triangles(group), self._positions(group)
            if len(triangles) and triangles.max() >= len(positions):
                raise _UnsupportedError
            if len(triangles):
                color = self._color(materials.get(group.get("material")))
                parts.append(Mesh(positions, triangles).painted(color))
        return parts

    def _positions(self, group: Element) -> np.ndarray:
        vertices = self._target(_input(group, "VERTEX"), "source")
        source = self._target(_input(vertices, "POSITION"), "source")
        if _child(source, "technique_common/accessor").get("stride") != "3":
            raise _UnsupportedError
        return _numbers(_child(source, "float_array"), float).reshape(-1, 3)

    def _color(self, instance: Element | None) -> np.ndarray:
        if instance is None:
            return GREY
        material = self._target(instance, "target")
        effect = self._target(_child(material, "instance_effect"), "url")
        color = effect.find(".//diffuse/color")
        if color is None:  # a texture: the arm's tint alone colours the part
            return GREY
        # Exporters write linear light; screens expect sRGB.
        return np.clip(_numbers(color, float)[:3], 0, 1) ** (1 / 2.2)


def _triangles(group: Element) -> np.ndarray:
    """Return the corners (T, 3) of a group of triangles, or of polygons cut into fans."""
    width = 1 + max(int(_word(i, "offset")) for i in group.findall("input"))
    index = _numbers(_child(group, "p"), int).reshape(-1, width)
    corner = index[:, int(_word(_input(group, "VERTEX"), "offset"))]
    if group.tag == "triangles":
        return corner.reshape(-1, 3)
    counts = _numbers(_child(group, "vcount"), int)
    if counts.sum() != len(corner):
        raise _UnsupportedError
    starts = np.cumsum(counts) - counts
    fans = [
        (s, s + k, s + k + 1) for s, n in zip(starts, counts, strict=True) for k in range(1, n - 1)
    ]
    return corner[np.array(fans, int).reshape(-1, 3)]


def _refuse(parent: Element, *tags: str) -> None:
    if any(parent.find(tag) is not None for tag in tags):
        raise _UnsupportedError


def _child(parent: Element, path: str) -> Element:
    child = parent.find(path)
    if child is None:
        raise _UnsupportedError
    return child


def _word(element: Element, attribute: str) -> str:
    word = element.get(attribute)
    if word is None:
        raise _UnsupportedError
    return word


def _input(parent: Element, semantic: str) -> Element:
    return _child(parent, f"input[@semantic='{semantic}']")


def _numbers(element: Element, kind: type) -> np.ndarray:
    return np.array((element.text or "").split(), kind)


def _transform(element: Element) -> np.ndarray:
    """Return the (4, 4) matrix of a node's transform element; identity for any other element."""
    pose = np.eye(4)
    if element.tag == "matrix":
        pose = _numbers(element, float).reshape(4, 4)
    elif element.tag == "translate":
        pose[:3, 3] = _numbers(element, float)
    elif element.tag == "scale":
        pose[:3, :3] = np.diag(_numbers(element, float))
    elif element.tag == "rotate":
        x, y, z, degrees = _numbers(element, float)
        K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        angle = np.deg2rad(degrees)
        pose[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return pose
