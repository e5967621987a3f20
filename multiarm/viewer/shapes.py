"""From descriptions of shapes (a URDF's visual, a scene's object, a mesh file) to meshes.

A shape that cannot be read never ends a replay: a warning names it, and a box of the right size
replaces it.

Pinocchio's mesh loader reads positions and triangles of every common format, but drops materials.
A robot is easier to recognise with its dark joints and bright shells.  Collada is the one usual
format that carries materials, so this module reads geometry, node transforms and diffuse colours
of Collada files, within the subset that exporters of robots write (triangles and polygon lists,
static nodes).  For any other file it uses the plain triangles.  Like the loader, it applies the
file's unit and ignores its up axis.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import coal
import numpy as np

from multiarm.grasp.polyhedron import Polyhedron
from multiarm.scene.meshes import mesh_fault
from multiarm.viewer.mesh import Mesh, box, capsule, cone, cylinder, merge, sphere

if TYPE_CHECKING:
    import pinocchio as pin

    from multiarm.scene import ObjectSpec


LONGEST = 1e9  # [m]: coordinates beyond are no lengths of robots
SATURATION, DARKEST = 0.3, 0.36  # what an arm's own colours keep; black would swallow the tint
PLAIN = np.array([0.88, 0.89, 0.91])  # of a part without a colour of its own


def load_mesh(path: Path, scale: np.ndarray) -> Mesh:
    """Return the mesh of a file, scaled by `scale`, shape (3,).

    Raises
    ------
    ValueError
        The file is missing, larger than any mesh, cut short, of no known format, or has numbers
        that are not finite.
    """
    fault = mesh_fault(path)
    if fault:
        raise ValueError(fault)
    colored = _colored(path, scale)
    return usable(colored or _mesh_of_bvh(coal.MeshLoader().load(str(path), scale)))


def usable(mesh: Mesh) -> Mesh:
    """The mesh, if it has triangles of finite size.

    Raises
    ------
    ValueError
        It has not.
    """
    corners = mesh.vertices[np.ravel(mesh.triangles)]
    if not len(corners) or not np.abs(corners).max() < LONGEST or not np.ptp(corners, 0).any():
        raise ValueError("a mesh without triangles of finite size")
    return mesh


def mesh_loader() -> coal.MeshLoader:
    """Return a loader that reads a mesh file once, for the visuals of any number of arms."""
    return coal.CachedMeshLoader()


def geometry_mesh(item: pin.GeometryObject, subdued: bool = True) -> Mesh:
    """Return the mesh of a visual of Pinocchio's, in the frame of the visual.

    Subdued colours distinguish the parts of an arm, whose tint distinguishes the arms.

    Raises
    ------
    ValueError
        It has no triangles of finite size.
    """
    colored = _colored(Path(item.meshPath), item.meshScale)
    mesh = usable(colored or _mesh_of_geometry(item.geometry))
    if item.overrideMaterial:
        mesh = mesh.painted(item.meshColor[:3])
    colors = PLAIN + 0 * mesh.triangles if mesh.colors is None else mesh.colors
    if subdued:
        grey = colors @ np.array([[0.30], [0.59], [0.11]])  # perceived brightness
        colors = DARKEST + (1 - DARKEST) * (grey + SATURATION * (colors - grey))
    return Mesh(mesh.vertices, mesh.triangles, colors)


def object_mesh(spec: ObjectSpec) -> Mesh:
    """Return the mesh of the common object, in the object frame."""
    shape = spec.shape
    if shape.box is not None:
        return box(shape.box)
    if shape.sphere is not None:
        return sphere(shape.sphere)
    if shape.cylinder is not None:
        return cylinder(shape.cylinder.radius, shape.cylinder.height)
    if shape.hull is not None:
        body = Polyhedron.hull(np.array(shape.hull))
        fans = [
            (loop[0], loop[k], loop[k + 1])
            for (loop,) in body.loops
            for k in range(1, len(loop) - 1)
        ]
        return Mesh(body.vertices, np.array(fans))
    if shape.mesh is not None:
        try:
            return load_mesh(shape.mesh.file, np.array(shape.mesh.scale))
        except ValueError:
            warnings.warn(
                f"cannot read the object's mesh {shape.mesh.file}: the replay shows a box "
                "with the object's inertia instead",
                stacklevel=2,
            )
    return _inertia_box(spec.mass, spec.inertia_matrix())


def _colored(path: Path, scale: np.ndarray) -> Mesh | None:
    """Return the scaled mesh of a file that carries colours, None of any other."""
    mesh = read_collada(path) if path.suffix.lower() == ".dae" else None
    return None if mesh is None else mesh.scaled(scale)


def _mesh_of_geometry(geometry: coal.CollisionGeometry) -> Mesh:
    match geometry:
        case coal.BVHModelBase():
            return _mesh_of_bvh(geometry)
        case coal.Box():
            return box(2 * geometry.halfSide)
        case coal.Sphere():
            return sphere(geometry.radius)
        case coal.Cylinder():
            return cylinder(geometry.radius, 2 * geometry.halfLength)
        case coal.Capsule():
            return capsule(geometry.radius, 2 * geometry.halfLength)
        case coal.Cone():
            return cone(geometry.radius, 2 * geometry.halfLength)
    geometry.computeLocalAABB()
    low, high = geometry.aabb_local.min_, geometry.aabb_local.max_
    return box(high - low).shifted((low + high) / 2)


def _mesh_of_bvh(model: coal.BVHModelBase) -> Mesh:
    corners = (model.tri_indices(i) for i in range(model.num_tris))
    triangles = [(t[0], t[1], t[2]) for t in corners]
    return Mesh(np.array(model.vertices()), np.array(triangles, int).reshape(-1, 3))


def _inertia_box(mass: float, inertia: np.ndarray) -> Mesh:
    """Return the uniform box with the given `inertia` about its centre, shape (3, 3)."""
    event_places, axes = np.linalg.eigh(inertia)
    squares = 6 / mass * (event_places.sum() - 2 * event_places)  # of the sides
    pose = np.eye(4)
    pose[:3, :3] = axes * np.sign(np.linalg.det(axes))
    longest = np.sqrt(squares.max())
    return box(np.sqrt(np.maximum(squares, (0.01 * longest) ** 2))).moved(pose)


GREY = np.array([0.8, 0.8, 0.8])


def read_collada(path: Path) -> Mesh | None:
    """Return the coloured triangles of a Collada file [m], or None if it cannot be read so."""
    try:
        text = path.read_bytes()
        if b"<!DOCTYPE" in text:  # its entities may expand to any length
            return None
        root = ElementTree.fromstring(text)
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]  # drop the namespace
        return _Collada(root).mesh()
    except (ElementTree.ParseError, OSError, ValueError, LookupError, RecursionError):
        return None


class _Collada:
    """One parsed document: look-up by id, then a walk over its visual scene.

    What is missing, or outside the reader's subset, raises a LookupError.
    """

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
            raise LookupError
        return merge(parts)

    def _target(self, element: Element, attribute: str) -> Element:
        """Return what an attribute such as ``url="#id"`` refers to."""
        return self.by_id[element.attrib[attribute].removeprefix("#")]

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
                raise LookupError
            if len(triangles):
                color = self._color(materials.get(group.get("material")))
                parts.append(Mesh(positions, triangles).painted(color))
        return parts

    def _positions(self, group: Element) -> np.ndarray:
        vertices = self._target(_input(group, "VERTEX"), "source")
        source = self._target(_input(vertices, "POSITION"), "source")
        if _child(source, "technique_common/accessor").get("stride") != "3":
            raise LookupError
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
    width = 1 + max(int(entry.attrib["offset"]) for entry in group.findall("input"))
    index = _numbers(_child(group, "p"), int).reshape(-1, width)
    corner = index[:, int(_input(group, "VERTEX").attrib["offset"])]
    if group.tag == "triangles":
        return corner.reshape(-1, 3)
    counts = _numbers(_child(group, "vcount"), int)
    if counts.sum() != len(corner):
        raise LookupError
    starts = np.cumsum(counts) - counts
    fans = [
        (s, s + k, s + k + 1) for s, n in zip(starts, counts, strict=True) for k in range(1, n - 1)
    ]
    return corner[np.array(fans, int).reshape(-1, 3)]


def _refuse(parent: Element, *tags: str) -> None:
    if any(parent.find(tag) is not None for tag in tags):
        raise LookupError


def _child(parent: Element, path: str) -> Element:
    child = parent.find(path)
    if child is None:
        raise LookupError
    return child


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
