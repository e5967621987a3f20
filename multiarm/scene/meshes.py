"""Files of meshes: where the address in a URDF leads, and their triangles.

trimesh reads all formats.  It trusts the counts that a file declares and computes with whatever
numbers it has, so that a file is inspected first; and it never opens a further file, such as a
texture.  Collada is the one usual format of robots whose colours are read.
"""

from __future__ import annotations

import io
import re
import warnings
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from multiarm.scene.urdf import read_xml

if TYPE_CHECKING:
    import numpy as np

    from multiarm.geometry.triangle_mesh import TriangleMesh

MESH_FORMATS = (".dae", ".obj", ".off", ".ply", ".stl")
MOST_MESH_BYTES = 1 << 30
_TEXTURED = 0.8  # brightness of what has a texture in place of a colour


class ShapeMesh(NamedTuple):
    """The mesh of a shape of a URDF."""

    path: str
    """Where it is, or where it is missing; the address of one in an unknown package."""
    scale: tuple[float, ...]
    """Along the axes of the mesh."""


def read_mesh(path: Path, scale: Sequence[float] = (1.0, 1.0, 1.0)) -> TriangleMesh:
    """Read the triangles of a file, scaled along its axes.

    The unit of a Collada file is applied and its up axis is not, as readers of URDFs do.  Colours
    are those of Collada files; meshes of other formats have none.

    Raises
    ------
    ValueError
        There is no such file, its format is none of :data:`MESH_FORMATS`, it is damaged or too
        large, or it has no triangles, or numbers that are not finite; the message says which.
    """
    import numpy as np

    from multiarm.geometry.triangle_mesh import TriangleMesh

    if not path.is_file():
        raise ValueError("there is no such file")
    ending, size = path.suffix.lower(), path.stat().st_size
    if ending not in MESH_FORMATS:
        raise ValueError(f"it has no known format; these are {', '.join(MESH_FORMATS)}")
    if size > MOST_MESH_BYTES:
        raise ValueError(f"it has {size:,} bytes, more than {MOST_MESH_BYTES:,}")
    content = _inspected(path.read_bytes(), ending)
    try:
        with warnings.catch_warnings():  # of what is wrong with a text; its numbers are checked
            warnings.simplefilter("ignore")
            vertices, triangles, colors = _triangles(content, ending)
    except Exception as error:  # readers of the formats raise what they please
        raise ValueError(f"it is damaged, or no {ending} file") from error
    if not len(triangles):
        raise ValueError("it has no triangles")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise ValueError("a triangle has a corner that is not there")
    mesh = TriangleMesh(vertices, triangles, colors if ending == ".dae" else None).scaled(scale)
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("a number is not finite")
    return mesh


def _inspected(content: bytes, ending: str) -> bytes:
    """The part of a file that is to be read, if it holds what it declares.

    Raises
    ------
    ValueError
        It does not.
    """
    size = len(content)
    if ending == ".stl":
        declared = int.from_bytes(content[80:84], "little")
        end = 84 + 50 * declared
        if size == end or not content.startswith(b"solid"):  # some binary files begin so, too
            if not declared or size < end:
                raise ValueError(
                    f"it declares {declared:,} triangles, and has {max(size - 84, 0) // 50:,}"
                )
            return content[:end]
    elif ending == ".ply":
        header = content.partition(b"end_header")[0]
        declared = sum(map(int, re.findall(rb"^element \w+ (\d{1,18})", header, re.M)))
        if not 0 < declared <= size:
            raise ValueError(f"it declares {declared:,} vertices and faces")
    elif ending == ".dae":
        if b"\0" in content:
            raise ValueError("it is not written in UTF-8")
        if b"<!DOCTYPE" in content:
            raise ValueError("it has a document type, whose entities may expand to any length")
        if b"instance_node" in content:
            raise ValueError("its nodes contain other nodes by reference; export it without")
        largest = max(map(len, re.split(rb"</[\w.:-]*geometry\s*>", content)))
        if content.count(b"instance_geometry") * largest > MOST_MESH_BYTES:
            raise ValueError("it shows its geometry too many times")
    return content


def _triangles(content: bytes, ending: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners [m], triangles and their colours, of all nodes of a file."""
    import numpy as np
    import trimesh

    scene: Any = trimesh.load_scene(
        io.BytesIO(content),
        file_type=ending[1:],
        resolver=_grey_textures(),
        process=False,
        skip_materials=True,  # of OBJ, which are in further files
    )
    parts: list[tuple[np.ndarray, ...]] = []
    start = 0
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh):
            continue
        faces = np.array(part.faces, int)
        inward = np.linalg.det(pose[:3, :3]) < 0.0
        parts.append(
            (
                part.vertices @ pose[:3, :3].T + pose[:3, 3],
                (faces[:, ::-1] if inward else faces) + start,
                np.tile(_color(part), (len(faces), 1)),
            )
        )
        start += len(part.vertices)
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3), int), np.empty((0, 3))
    vertices, triangles, colors = (np.concatenate(pieces) for pieces in zip(*parts, strict=True))
    unit = trimesh.units.unit_conversion(scene.units, "meters") if scene.units else 1.0
    return unit * vertices, triangles, colors


def _color(part: Any) -> np.ndarray:
    """The colour of a part of a mesh, sRGB (3,) in 0..1: grey if it has none, or a texture."""
    import numpy as np

    material: Any = getattr(part.visual, "material", None)
    base = getattr(material, "baseColorFactor", None)
    if base is None or material.baseColorTexture is not None:
        return np.full(3, _TEXTURED)
    # Exporters write linear light; screens expect sRGB.
    return (np.asarray(base, float)[:3] / 255.0) ** (1.0 / 2.2)


def _grey_textures() -> Any:
    """What trimesh asks for the textures of a file: each is a grey pixel, and no file is opened."""
    from PIL import Image
    from trimesh.resolvers import Resolver

    class GreyTextures(Resolver):
        def __init__(self) -> None:
            pixel = io.BytesIO()
            Image.new("L", (1, 1)).save(pixel, "png")
            self._pixel = pixel.getvalue()

        def get(self, key: str) -> bytes:
            return self._pixel

        def write(self, name: str, data: Any) -> None:
            raise NotImplementedError

        def namespaced(self, namespace: str) -> Resolver:
            return self

        def keys(self) -> tuple[str, ...]:
            return ()

    return GreyTextures()


# --- The shapes of a URDF -------------------------------------------------------------------------


def shapes_without_meshes(
    urdf: Path, package_dirs: tuple[Path, ...], role: str
) -> tuple[str, dict[str, ShapeMesh]]:
    """The text of a URDF with spheres in place of the meshes of its shapes, and these meshes.

    ``role`` is ``visual`` or ``collision``.  Names are those of Pinocchio: the link's, and the
    number of the shape in it.

    Raises
    ------
    ValueError
        A mesh has no scale of three numbers.
    """
    robot, meshes = read_xml(urdf), {}
    for link in robot.findall("link"):
        for number, shape in enumerate(link.findall(role)):
            geometry, mesh = shape.find("geometry"), shape.find("geometry/mesh")
            if geometry is None or mesh is None:
                continue
            address = mesh.get("filename", "")
            missing = address if "://" in address else urdf.parent / address
            path = resolve_mesh(address, urdf, package_dirs) or missing
            x, y, z = map(float, mesh.get("scale", "1 1 1").split())
            meshes[f"{link.get('name')}_{number}"] = ShapeMesh(str(path), (x, y, z))
            geometry.remove(mesh)
            ElementTree.SubElement(geometry, "sphere", radius="1")
    return ElementTree.tostring(robot, "unicode"), meshes


def resolve_mesh(address: str, urdf: Path, package_dirs: tuple[Path, ...]) -> Path | None:
    """The file of a mesh address of a URDF, or None if there is none.

    ``package://`` and ``model://`` are looked up in ``package_dirs``, ``file://`` and absolute
    paths taken as they are, other paths relative to the URDF's folder.
    """
    scheme, separator, path = address.partition("://")
    if not separator:
        candidates = [urdf.parent / address]
    elif scheme == "file":
        candidates = [Path(path)]
    else:
        candidates = [folder / path.lstrip("/") for folder in package_dirs]
    return next((file for file in candidates if file.is_file()), None)
