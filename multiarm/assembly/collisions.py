"""Distances of an arm's links from the object and from the links of other arms.

Links and objects count with their convex hulls: a URDF's collision shapes (where it has none, the
visual ones), a box, sphere, cylinder or hull as it is, a mesh by its hull.  What holds the object
touches it by design: the hand, that is, the last link and those within a tenth of the arm's length
of the joint, is not compared with the object, nor with other hands.  Links on the way from the base
to each other are not compared with each other, nor the first links of two branches, nor what two
arms of one robot have in common; the ground is no shape either.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from multiarm.robots.robot import Robot
from multiarm.scene import ObjectSpec, Scene
from multiarm.scene.faults import counted
from multiarm.scene.meshes import read_mesh
from multiarm.scene.shapes import Box, Cylinder, Hull, Mesh, Sphere

# Distances beyond this one need not be known [m].
HORIZON = 0.05
# Links within this part of the arm's length of the joint are the hand's.
HAND = 0.1
OBJECT = "the object"


@dataclass(frozen=True)
class Solid:
    """A convex shape of a link, or of the object.

    Attributes
    ----------
    name : str
        In messages.
    shape : coal.CollisionGeometry
    joint : int
        That moves it, Pinocchio's number; 0 of what stands.
    holds : bool
        Whether it touches the object, or is the object.
    """

    name: str
    shape: Any
    joint: int
    holds: bool


@dataclass(frozen=True)
class Placed:
    """Solids of an arm, or of several, at a posture.

    Attributes
    ----------
    solids : tuple of Solid
    poses : list of pinocchio.SE3
        In the world.
    centres, radii : ndarray, shapes (k, 3) and (k,)
        Of balls around them [m], in the world.
    """

    solids: tuple[Solid, ...]
    poses: list[pin.SE3]
    centres: np.ndarray
    radii: np.ndarray


@dataclass(frozen=True)
class NearestPair:
    """A link and an obstacle that are nearest to each other.

    Attributes
    ----------
    distance : float
        [m], below zero where they overlap.
    link, obstacle : str
        Their names in messages; empty where none are nearer than the horizon.
    """

    distance: float
    link: str = ""
    obstacle: str = ""


class Surroundings:
    """The solids of a scene: its arms, at whatever postures, and its objects.

    Parameters
    ----------
    scene : Scene
    arms : mapping arm -> Robot
        Those that are looked at.
    """

    def __init__(self, scene: Scene, arms: Mapping[str, Robot]) -> None:
        self._arms = arms
        places: dict[str, dict[str, np.ndarray]] = {name: {} for name in arms}
        for joint in scene.joints:
            at = np.eye(4) if joint.at is None else joint.at.matrix()
            for body, pose in ((joint.first, joint.on_first.matrix()), (joint.second, at)):
                if body.robot in arms:
                    places[body.robot].setdefault(body.tip, pose[:3, 3])
        self._links = {name: _links(arm, places[name]) for name, arm in arms.items()}
        self._objects: list[tuple[Solid, pin.SE3]] = []
        for name, spec in scene.all_objects.items():
            hull, words = object_hull(spec), OBJECT if scene.objects is None else f"object {name!r}"
            if hull is not None:
                hull.computeLocalAABB()
                solid = Solid(words, hull, 0, holds=True)
                self._objects.append((solid, pin.SE3(spec.pose.matrix())))
        self._robots = {
            name: scene.group_of(name) if name in scene.arms else arm for name, arm in arms.items()
        }
        self._branches = {name: _on_two_branches(arm.model) for name, arm in arms.items()}

    def placed(
        self, name: str, posture: np.ndarray, standing: bool, shift: np.ndarray | None = None
    ) -> Placed:
        """The links of an arm at a posture, with those that no joint moves if ``standing``.

        Parameters
        ----------
        shift : ndarray, shape (4, 4), optional
            Motion of the base from where the arm's model has it.
        """
        arm, (geometry, solids) = self._arms[name], self._links[name]
        data = geometry.createData()
        q = arm.configuration(posture)
        pin.updateGeometryPlacements(arm.model, arm.model.createData(), geometry, data, q)
        moved = pin.SE3.Identity() if shift is None else pin.SE3(shift)
        pairs = [
            (solid, moved * pose)
            for solid, pose in zip(solids, data.oMg.tolist(), strict=True)
            if standing or solid.joint > 0
        ]
        return _placed(pairs)

    def nearest(self, name: str, posture: np.ndarray, obstacles: Placed) -> NearestPair:
        """The nearest pair of a moving link and an obstacle, or a link on another branch."""
        links = self.placed(name, posture, standing=False)
        joints = [solid.joint for solid in links.solids]
        branches = np.triu(self._branches[name][np.ix_(joints, joints)])  # each pair once
        pairs = nearest(links, obstacles), nearest(links, links, branches)
        return min(pairs, key=lambda pair: pair.distance)

    def obstacles(self, name: str, postures: Mapping[str, np.ndarray]) -> Placed:
        """The objects, and the links of all other arms that have a posture."""
        pairs = [*self._objects]
        for neighbour in self._arms:
            if neighbour == name or neighbour not in postures:
                continue
            shared = self._robots[neighbour] is self._robots[name]
            links = self.placed(neighbour, postures[neighbour], standing=not shared)
            pairs += zip(links.solids, links.poses, strict=True)
        return _placed(pairs)


def nearest(links: Placed, obstacles: Placed, compared: np.ndarray | bool = True) -> NearestPair:
    """The nearest pair of a link and an obstacle, up to the horizon.

    Parameters
    ----------
    compared : ndarray of bool, shape (links, obstacles)
        Which pairs may be it; by default all.
    """
    ways = links.centres[:, None] - obstacles.centres
    gaps = np.linalg.norm(ways, axis=2) - links.radii[:, None] - obstacles.radii
    pair = NearestPair(HORIZON)
    for i, j in np.argwhere((gaps < HORIZON) & compared):
        link, obstacle = links.solids[i], obstacles.solids[j]
        if (link.holds and obstacle.holds) or gaps[i, j] >= pair.distance:
            continue
        distance = coal.distance(
            link.shape,
            _transform(links.poses[i]),
            obstacle.shape,
            _transform(obstacles.poses[j]),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        if distance < pair.distance:
            pair = NearestPair(distance, link.name, obstacle.name)
    return pair


def _on_two_branches(model: pin.Model) -> np.ndarray:
    """Whether the links of two joints are on two branches of a tree, but not the first of both.

    Shape (n + 1, n + 1), joints counted as Pinocchio does.
    """
    parents = np.array([*model.parents])
    carried = np.eye(parents.size, dtype=bool)  # a joint by another one, or it itself
    for joint, parent in enumerate(parents[1:], 1):
        carried[joint] |= carried[parent]
    return ~(carried | carried.T | (parents[:, None] == parents))


def object_hull(body: ObjectSpec) -> Any:
    """The convex shape of the object in its frame; None where it has none that can be read."""
    match body.shape.solid:
        case Box(edges):
            return coal.Box(*edges)
        case Sphere(radius):
            return coal.Sphere(radius)
        case Cylinder(radius=radius, height=height):
            return coal.Cylinder(radius, height)
        case Hull(points):
            return _hull(np.array(points))
        case Mesh() as shape:
            mesh = shape.triangle_mesh()
            return None if mesh is None else _hull(mesh.vertices)
    return None


def _hull(points: np.ndarray) -> Any:
    """The convex hull of points (N, 3); None where they lie in a plane."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    numbers, triangles = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    vertices.extend(list(points[numbers]))
    faces.extend([coal.Triangle(*face) for face in triangles.reshape(-1, 3).tolist()])
    return coal.Convex(vertices, faces)


def _hand(arm: Robot, tip: str, place: np.ndarray) -> set[int]:
    """The joints, Pinocchio's numbers, of the hand that holds something at a place (3,) [m]."""
    end, levers = arm.tips[tip], arm.levers(place, tip)
    longest = np.max(levers[end.chain], initial=0.0)
    return {end.joint} | {int(k) + 1 for k in end.chain if levers[k] <= HAND * longest}


def _links(
    arm: Robot, places: Mapping[str, np.ndarray]
) -> tuple[pin.GeometryModel, tuple[Solid, ...]]:
    """The shapes of a robot's links; ``places`` (3,) are where its tips hold something [m]."""
    geometry, noun = arm.collision_model(), "arm" if "" in arm.tips else "robot"
    hand = {joint for tip, place in places.items() for joint in _hand(arm, tip, place)}
    solids: list[Solid] = []
    lost: dict[str, None] = {}  # each file once
    unreadable: list[str] = []
    for item in geometry.geometryObjects.tolist():
        shape, link = item.geometry, arm.model.frames[item.parentFrame].name
        name = f"link {link!r} of {noun} {arm.name!r}"
        if isinstance(shape, coal.BVHModelBase):
            path = Path(item.meshPath)
            stamp = path.stat().st_mtime_ns if path.is_file() else 0
            try:
                shape = _hull_of_mesh(path, stamp, tuple(item.meshScale))
            except ValueError as error:
                lost[f"{item.meshPath} of link '{link}' ({error})"] = None
                unreadable.append(item.name)
                continue
        shape.computeLocalAABB()
        solids.append(Solid(name, shape, item.parentJoint, item.parentJoint in hand))
    for shape_name in unreadable:  # not while the objects, which are no copies, are gone through
        geometry.removeGeometryObject(shape_name)
    if lost:
        warnings.warn(
            f"{arm.files.urdf.name}: postures are found without regard to {counted([*lost], 3)}",
            stacklevel=2,
        )
    return geometry, tuple(solids)


@lru_cache(maxsize=256)
def _hull_of_mesh(path: Path, _stamp: int, scale: tuple[float, ...]) -> Any:
    """The hull of a file's mesh; the mesh itself where its points lie in a plane."""
    mesh = read_mesh(path, scale)
    hull = _hull(mesh.vertices[np.unique(mesh.triangles)])
    if hull is not None:
        return hull
    sheet = coal.BVHModelOBBRSS()
    sheet.beginModel(len(mesh.triangles), len(mesh.vertices))
    sheet.addVertices(mesh.vertices)
    sheet.addTriangles(mesh.triangles)
    sheet.endModel()
    return sheet


def _placed(pairs: list[tuple[Solid, pin.SE3]]) -> Placed:
    centres = [pose.act(np.array(solid.shape.aabb_center)) for solid, pose in pairs]
    radii = [solid.shape.aabb_radius for solid, _ in pairs]
    solids, poses = tuple(solid for solid, _ in pairs), [pose for _, pose in pairs]
    return Placed(solids, poses, np.reshape(centres, (-1, 3)), np.array(radii))


def _transform(pose: pin.SE3) -> Any:
    return coal.Transform3s(pose.rotation, pose.translation)
