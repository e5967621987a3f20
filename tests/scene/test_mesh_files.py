"""Claims about the triangles of mesh files, and about files that no reader may be given."""

from __future__ import annotations

import importlib.metadata
import struct
from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh

from multiarm.scene.meshes import MOST_MESH_BYTES, read_mesh

ROBOT_MESHES = [
    "ur_description/meshes/ur5/visual/upperarm.dae",
    "ur_description/meshes/ur5/visual/wrist3.dae",
    "ur_description/meshes/ur5/collision/wrist3.stl",
    "panda_description/meshes/visual/link6.dae",
]
SINGLE = float(np.finfo(np.float32).eps)  # the readers agree to the rounding of the files


def stl(count: int | None = None, bad: float | None = None) -> bytes:
    """A tetrahedron as binary STL that may declare another number of triangles."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    triangles = corners[np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])]
    if bad is not None:
        triangles[1, 1, 1] = bad
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *t.ravel(), 0) for t in triangles)
    return b"\0" * 80 + struct.pack("<I", 4 if count is None else count) + body


SQUARE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/></asset>
  <library_effects><effect id="violet-effect"><profile_COMMON><technique sid="common"><phong>
    <diffuse><color>1 0 0.5 1</color></diffuse>
  </phong></technique></profile_COMMON></effect></library_effects>
  <library_materials><material id="violet"><instance_effect url="#violet-effect"/></material>
  </library_materials>
  <library_geometries><geometry id="square"><mesh>
    <source id="places"><float_array id="numbers" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
      <technique_common><accessor source="#numbers" count="4" stride="3">AXES</accessor>
      </technique_common></source>
    <source id="normals"><float_array id="ups" count="3">0 0 1</float_array>
      <technique_common><accessor source="#ups" count="1" stride="3">AXES</accessor>
      </technique_common></source>
    <vertices id="corners"><input semantic="POSITION" source="#places"/></vertices>
    <polylist count="1" material="paint">
      <input semantic="VERTEX" source="#corners" offset="1"/>
      <input semantic="NORMAL" source="#normals" offset="0"/>
      <vcount>4</vcount><p>0 0 0 1 0 2 0 3</p>
    </polylist>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="all"><node>
    <translate>3 0 1</translate><rotate>0 0 1 90</rotate>
    <node><scale>2 1 1</scale><instance_geometry url="#square"><bind_material>
      <technique_common><instance_material symbol="paint" target="#violet"/></technique_common>
    </bind_material></instance_geometry></node>
  </node></visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#all"/></scene>
</COLLADA>""".replace("AXES", "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ"))


TEXTURE = """<newparam sid="surface"><surface type="2D"><init_from>picture</init_from></surface>
  </newparam><newparam sid="sampler"><sampler2D><source>surface</source></sampler2D></newparam>"""


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def read_text(folder, text, ending=".dae"):
    path = folder / f"mesh{ending}"
    path.write_text(text)
    return read_mesh(path)


@pytest.mark.parametrize("name", ROBOT_MESHES)
def test_files_of_robots_are_read_as_pinocchios_loader_does(name):
    files = importlib.metadata.files("example-robot-data")
    path = Path(next(f for f in files if str(f).endswith(name)).locate())
    mesh, loaded = read_mesh(path, (1.0, 2.0, 3.0)), coal.MeshLoader().load(str(path), np.ones(3))
    corners, expected = mesh.vertices[mesh.triangles], loaded.vertices() * [1.0, 2.0, 3.0]
    for bound in (np.min, np.max):
        error = bound(corners, axis=(0, 1)) - bound(expected, axis=0)
        assert np.abs(error).max() < 4.0 * SINGLE * np.abs(expected).max()
    if "panda" in name:  # the loader mixes up the corners where a node has several materials
        assert volume(mesh) == pytest.approx(6.0 * loaded.computeVolume(), rel=1e-6)
    if path.suffix == ".dae":
        assert len(np.unique(mesh.colors, axis=0)) > 1


def test_collada_nodes_place_scale_and_colour_their_polygons(tmp_path):
    mesh = read_text(tmp_path, SQUARE)
    corners = mesh.vertices[mesh.triangles].reshape(-1, 3)
    # [0, 2] x [0, 1], turned by 90 degrees about z, moved by (3, 0, 1), in centimetres
    np.testing.assert_allclose(corners.min(axis=0), [0.02, 0, 0.01], atol=4 * SINGLE)
    np.testing.assert_allclose(corners.max(axis=0), [0.03, 0.02, 0.01], atol=4 * SINGLE)
    assert len(mesh.triangles) == 2
    steps = 1 / 255  # of linear light, which the reader rounds to
    np.testing.assert_allclose(mesh.colors, np.tile([1, 0, 0.5 ** (1 / 2.2)], (2, 1)), atol=steps)


def test_a_texture_is_grey_and_its_picture_is_not_opened(tmp_path, monkeypatch):
    picture = tmp_path / "picture.png"
    picture.write_bytes(b"no picture")
    images = "<library_images><image id='picture'><init_from>picture.png</init_from></image>"
    text = SQUARE.replace("<library_effects>", f"{images}</library_images><library_effects>")
    text = text.replace("<profile_COMMON>", f"<profile_COMMON>{TEXTURE}")
    text = text.replace("<color>1 0 0.5 1</color>", "<texture texture='sampler' texcoord='UV'/>")
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(read_text(tmp_path, text).colors, np.full((2, 3), 0.8))


@pytest.mark.parametrize("scale", [(-1.0, 1.0, 1.0), (1.0, 2.0, -0.5), (-1.0, -1.0, 1.0)])
def test_a_mirror_image_keeps_its_outside(tmp_path, scale):
    trimesh.creation.box([1.0, 2.0, 3.0]).export(tmp_path / "box.stl")
    mirrored = read_mesh(tmp_path / "box.stl", scale)
    assert volume(mirrored) == pytest.approx(6.0 * abs(np.prod(scale)), rel=1e-12)


def test_a_mirroring_node_keeps_the_outside(tmp_path):
    upright = read_text(tmp_path, SQUARE)
    mirrored = read_text(tmp_path, SQUARE.replace("<scale>2 1 1", "<scale>-2 1 1"))

    def normal(mesh):
        a, b, c = mesh.vertices[mesh.triangles[0]]
        return np.cross(b - a, c - a)

    np.testing.assert_allclose(normal(mirrored), normal(upright), atol=4 * SINGLE)


def test_further_bytes_of_a_binary_stl_are_passed_over(tmp_path):
    (tmp_path / "mesh.stl").write_bytes(stl() + b"of some exporter")
    assert volume(read_mesh(tmp_path / "mesh.stl")) == pytest.approx(1 / 6)


@pytest.mark.parametrize("ending", ["obj", "off", "ply"])
def test_other_formats_are_read(tmp_path, ending):
    trimesh.creation.box([1.0, 2.0, 3.0]).export(tmp_path / f"box.{ending}")
    mesh = read_mesh(tmp_path / f"box.{ending}")
    assert volume(mesh) == pytest.approx(6.0, rel=1e-6) and mesh.colors is None


PLY = b"ply\nformat ascii 1.0\n%selement vertex 4000000000\nend_header\n"
TRIANGLE = "solid x\nfacet normal 0 0 1\nouter loop\nvertex %s 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
DEEP = b"<COLLADA>" + b"<a>" * 60_000 + b"</a>" * 60_000 + b"</COLLADA>"
# A few bytes more for each level, twice the triangles.
NESTED = SQUARE.replace("</visual_scene>", '<node><instance_node url="#a"/></node></visual_scene>')
MANY = SQUARE.replace("<scene>", "<!-- instance_geometry -->" * 32_000 + "<scene>")


@pytest.mark.parametrize(
    ("file", "content", "reason"),
    [
        ("missing.stl", None, "no such file"),
        ("x.xyz", b"1 2 3", "known format"),
        ("no_ending", stl(), "known format"),
        ("empty.stl", b"", "declares 0 triangles"),
        ("text.stl", b"hello", "declares 0 triangles"),
        ("cut.stl", stl()[:120], "declares 4 triangles, and has 0"),
        ("billions.stl", stl(4_000_000_000), "declares 4,000,000,000 triangles, and has 4"),
        ("nan.stl", stl(bad=float("nan")), "not finite"),
        ("inf.stl", stl(bad=float("inf")), "not finite"),
        ("cut_text.stl", (TRIANGLE % 0)[:60].encode(), "no triangles"),
        ("nan_text.stl", (TRIANGLE % "nan").encode() + b"endloop\nendfacet\nendsolid\n", "finite"),
        ("text.obj", b"hello", "no triangles|damaged"),
        ("points.obj", b"v 0 0 0\nv 1 1 1\n", "no triangles|damaged"),
        ("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n", "damaged|not there"),
        ("minus.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -9 -8 -7\n", "damaged|not there"),
        ("nan.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("billions.ply", PLY % b"", "declares 4,000,000,000"),
        ("remarks.ply", PLY % (b"comment x\n" * 1000), "declares 4,000,000,000"),
        ("billions.off", b"OFF\n4000000000 4000000000 0\n0 0 0\n", "damaged|no triangles"),
        ("text.dae", b"hello", "damaged, or no .dae file"),
        ("nothing.dae", b"<COLLADA><scene/></COLLADA>", "damaged|no triangles"),
        ("entities.dae", b"<!DOCTYPE x []>" + SQUARE.encode(), "document type"),
        ("wide.dae", ("<?xml version='1.0'?>" + SQUARE).encode("utf-16"), "UTF-8"),
        ("deep.dae", DEEP, "damaged"),
        ("nested.dae", NESTED.encode(), "by reference"),
        ("many.dae", MANY.encode(), "too many times"),
        ("nan.dae", SQUARE.replace('meter="0.01"', 'meter="nan"').encode(), "not finite"),
    ],
)  # fmt: skip
def test_files_that_are_no_meshes_are_refused_with_the_reason(tmp_path, file, content, reason):
    if content is not None:
        (tmp_path / file).write_bytes(content)
    with pytest.raises(ValueError, match=reason):
        read_mesh(tmp_path / file)


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    with open(tmp_path / "x.obj", "wb") as file:
        file.truncate(MOST_MESH_BYTES + 1)
    with pytest.raises(ValueError, match=r"1,073,741,825 bytes"):
        read_mesh(tmp_path / "x.obj")
