"""Files of meshes: where the address in a URDF leads, and whether a reader may open the file."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

from multiarm.scene.urdf import read_xml

_MOST_MESH_BYTES = 1 << 30


def readable_shapes(
    urdf: Path, package_dirs: tuple[Path, ...], role: str, loader: Any = None
) -> tuple[str, list[str]]:
    """The text of a URDF without shapes whose meshes cannot be read, and what these are.

    ``role`` is ``visual`` or ``collision``.  Its meshes have their paths.  With a ``loader`` of
    coal's, each is read, which takes long.
    """
    robot, faults, lost = read_xml(urdf), {}, []
    for link in robot.findall("link"):
        for shape in link.findall(role):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            address = mesh.get("filename", "")
            path = resolve_mesh(address, urdf, package_dirs)
            if address not in faults:
                faults[address] = _fault(path, loader)
            if faults[address]:
                lost.append(f"{path or address} of link '{link.get('name')}' ({faults[address]})")
                link.remove(shape)
            mesh.set("filename", str(path))
    return ElementTree.tostring(robot, "unicode"), lost


def _fault(path: Path | None, loader: Any) -> str:
    """Why a mesh of a URDF cannot be read; empty where it can."""
    if path is None:
        return "there is no such file"
    fault = mesh_fault(path)
    if not fault and loader is not None:
        try:
            loader.load(str(path))
        except (ValueError, RuntimeError):
            return "it is no mesh of a known format"
    return fault


def resolve_mesh(address: str, urdf: Path, package_dirs: tuple[Path, ...]) -> Path | None:
    """The file of a mesh address of a URDF, or None if there is none.

    ``package://`` and ``model://`` are looked up in ``package_dirs``, ``file://`` and absolute
    paths taken as they are, other paths relative to the URDF's folder.
    """
    scheme, separator, rest = address.partition("://")
    if not separator:
        candidates = [urdf.parent / address]
    elif scheme == "file":
        candidates = [Path(rest)]
    else:
        candidates = [folder / rest.lstrip("/") for folder in package_dirs]
    return next((path for path in candidates if path.is_file()), None)


def mesh_fault(path: Path) -> str:
    """Why no reader of meshes should open a file; empty where one may.

    Readers trust the counts that a file declares, and compute with whatever numbers it has.
    """
    if not path.is_file():
        return "there is no such file"
    size = path.stat().st_size
    if size > _MOST_MESH_BYTES:
        return f"it has {size:,} bytes, more than {_MOST_MESH_BYTES:,}"
    content = path.read_bytes()
    ending = path.suffix.lower()
    declared = int.from_bytes(content[80:84], "little")
    binary = size == 84 + 50 * declared or not content.startswith(b"solid")  # some say so too
    if ending == ".stl" and binary:
        if not declared or size < 84 + 50 * declared:
            return f"it declares {declared:,} triangles, and has {max(size - 84, 0) // 50:,}"
        import numpy as np

        triangles = np.frombuffer(content, np.dtype("<12f4,u2"), declared, 84)
        corners = triangles["f0"][:, 3:]  # normals are not used
        return "" if np.isfinite(corners).all() else "a number is not finite"
    if ending == ".ply":
        declared = sum(map(int, re.findall(rb"^element \w+ (\d{1,18})", content[:4096], re.M)))
        return "" if 0 < declared <= size else f"it declares {declared:,} vertices and faces"
    lower = content.lower()
    suspicious = b"\0" not in content and (b"nan" in lower or b"inf" in lower)  # found fast
    if suspicious and re.search(rb"(?<![\w#])[-+]?(nan|inf|infinity)(?!\w)", lower):
        return "a number is not finite"
    return ""
