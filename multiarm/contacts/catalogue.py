r"""The catalogue of joints: each kind is a function that returns contact records.

Points sit on the arm, surfaces on the object; both joint frames coincide in the reference position.
``X, Y, Z`` are the joint frame's axes, ``h = size / 2`` (thesis, 3.9.1 with its two omissions
mended: the prismatic joint's second plane needs contacts apart along the slide, the universal
joint's plane must contain the sphere's centre).

=================  ====  ==============================================================
kind               rows  contacts
=================  ====  ==============================================================
weld               6     three on a plane, two on a second, one on a third (3-2-1)
ball               3     three planes through the centre, turning with the object
revolute           5     four on a cylinder about Z, one on its end plane
prismatic          5     three on the plane y = 0, two on x = 0
cylindrical        4     four on a cylinder about Z
universal          4     three on a sphere, one on the plane x = 0
planar             3     three on a plane
point_on_plane, point_on_cylinder, point_on_sphere: one fingertip on that face
corner_gripper     4     four fingertips on the three faces at a corner of a block (Example 3.1)
contacts           N     as listed by the user
=================  ====  ==============================================================

A ball is written with three coincident points on three planes rather than with a sphere: both have
the same wrenches through the centre, and this one has them at every relative orientation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from multiarm.contacts.records import (
    CYLINDER,
    PLANE,
    SPHERE,
    SURFACE_ON_ARM,
    SURFACE_ON_OBJECT,
    Contact,
)

X, Y, Z = np.eye(3)
ZERO = np.zeros(3)


def joint_contacts(joint, object_pose: np.ndarray) -> list[Contact]:
    """Contact records of one joint of a scene.

    Parameters
    ----------
    joint : one of the joints of :mod:`multiarm.scene`
    object_pose : ndarray, shape (4, 4)
        Pose of the joint frame in the object frame.

    Returns
    -------
    list of Contact
        The arm's geometry in the tip frame, the object's in the object frame.
    """
    contacts = CATALOGUE[joint.kind](joint)
    on_tip = joint.at_tip.matrix()
    return [_placed(contact, on_tip, object_pose) for contact in contacts]


def surface_offset(joint) -> np.ndarray:
    """Where the joint frame of a fingertip kind stands from the tip at the start, shape (3,).

    A fingertip touches its face at the start: the face's frame then lies one radius away from the
    fingertip's centre, along -X (cylinder, sphere) or against the normal (plane).
    """
    if joint.kind == "point_on_plane":
        return -joint.tip_radius * _unit(joint.normal)
    if joint.kind == "point_on_cylinder":
        return -_centre_distance(joint) * _basis(joint.axis)[:, 0]
    if joint.kind == "point_on_sphere":
        return -_centre_distance(joint) * X
    return ZERO


def _weld(joint) -> list[Contact]:
    h = joint.size / 2.0
    points = [(h, 0, 0), (-h, h, 0), (-h, -h, 0), (h, 0, 0), (-h, 0, 0), (0, 0, 0)]
    return _on_planes("weld", points, [Z, Z, Z, Y, Y, X])


def _ball(joint) -> list[Contact]:
    return _on_planes("ball", [ZERO, ZERO, ZERO], [X, Y, Z])


def _revolute(joint) -> list[Contact]:
    h = joint.size / 2.0
    end = _on_planes("revolute end", [(0, 0, h)], [Z])
    return _turned(_cylinder_contacts("revolute", h) + end, joint.axis)


def _cylindrical(joint) -> list[Contact]:
    return _turned(_cylinder_contacts("cylindrical", joint.size / 2.0), joint.axis)


def _prismatic(joint) -> list[Contact]:
    h = joint.size / 2.0
    points = [(h, 0, h), (-h, 0, h), (0, 0, -h), (0, 0, h), (0, 0, -h)]
    return _turned(_on_planes("prismatic", points, [Y, Y, Y, X, X]), joint.axis)


def _universal(joint) -> list[Contact]:
    r = joint.size / 2.0
    sphere = [
        Contact(f"universal {k}", SPHERE, SURFACE_ON_OBJECT, r * axis, ZERO, Z, radius=r)
        for k, axis in enumerate((X, Y, Z))
    ]
    return sphere + _on_planes("universal cross", [r * Y], [X])


def _planar(joint) -> list[Contact]:
    h = joint.size / 2.0
    points = [(h, 0, 0), (-h, h, 0), (-h, -h, 0)]
    return _turned(_on_planes("planar", points, [Z, Z, Z]), joint.normal)


def _point_on_plane(joint) -> list[Contact]:
    normal = _unit(joint.normal)
    return [
        Contact(
            "fingertip", PLANE, SURFACE_ON_OBJECT, ZERO, ZERO, normal, tip_radius=joint.tip_radius
        )
    ]


def _point_on_cylinder(joint) -> list[Contact]:
    return [_fingertip(joint, CYLINDER, _unit(joint.axis))]


def _point_on_sphere(joint) -> list[Contact]:
    return [_fingertip(joint, SPHERE, Z)]


def _corner_gripper(joint) -> list[Contact]:
    contacts = []
    for k, (point, face) in enumerate(zip(joint.points, joint.faces, strict=True)):
        into_block = np.eye(3)["xyz".index(face)]
        centre = np.array(point) - joint.tip_radius * into_block
        contacts.append(
            Contact(
                f"fingertip {k + 1} on face {face}",
                PLANE,
                SURFACE_ON_OBJECT,
                centre,
                ZERO,
                -into_block,
                tip_radius=joint.tip_radius,
            )
        )
    return contacts


def _listed(joint) -> list[Contact]:
    contacts = []
    for k, spec in enumerate(joint.contacts):
        tip_on_arm = spec.arm.is_tip and spec.object.is_surface
        tip, surface = (spec.arm, spec.object) if tip_on_arm else (spec.object, spec.arm)
        body = SURFACE_ON_OBJECT if tip_on_arm else SURFACE_ON_ARM
        point, tip_radius = _tip(tip)
        kind, origin, axis, radius, inside = _surface(surface)
        name = spec.name or f"contact {k + 1}"
        contacts.append(Contact(name, kind, body, point, origin, axis, radius, inside, tip_radius))
    return contacts


CATALOGUE: dict[str, Callable[..., list[Contact]]] = {
    "weld": _weld,
    "ball": _ball,
    "revolute": _revolute,
    "prismatic": _prismatic,
    "cylindrical": _cylindrical,
    "universal": _universal,
    "planar": _planar,
    "point_on_plane": _point_on_plane,
    "point_on_cylinder": _point_on_cylinder,
    "point_on_sphere": _point_on_sphere,
    "corner_gripper": _corner_gripper,
    "contacts": _listed,
}


def _on_planes(name: str, points: list, normals: list) -> list[Contact]:
    """Points of the arm, each on a plane of the object through that point."""
    contacts = []
    for k, (p, n) in enumerate(zip(points, normals, strict=True)):
        p = np.array(p, dtype=float)
        contacts.append(Contact(f"{name} {k + 1}", PLANE, SURFACE_ON_OBJECT, p, p, n))
    return contacts


def _cylinder_contacts(name: str, r: float) -> list[Contact]:
    points = [(r, 0, r), (0, r, r), (r, 0, -r), (0, r, -r)]
    return [
        Contact(
            f"{name} {k + 1}", CYLINDER, SURFACE_ON_OBJECT, np.array(p, float), ZERO, Z, radius=r
        )
        for k, p in enumerate(points)
    ]


def _fingertip(joint, surface: int, axis: np.ndarray) -> Contact:
    return Contact(
        "fingertip",
        surface,
        SURFACE_ON_OBJECT,
        ZERO,
        ZERO,
        axis,
        radius=joint.radius,
        inside=joint.inside,
        tip_radius=joint.tip_radius,
    )


def _centre_distance(joint) -> float:
    """Distance of a fingertip's centre from the centre or axis of the surface it touches."""
    return joint.radius + (-joint.tip_radius if joint.inside else joint.tip_radius)


def _tip(geometry) -> tuple[np.ndarray, float]:
    if geometry.point is not None:
        return np.array(geometry.point, dtype=float), 0.0
    return np.array(geometry.sphere.center, dtype=float), geometry.sphere.radius


def _surface(geometry):
    """Kind, origin, axis, radius and side of a surface: the fields of a record."""
    if geometry.plane is not None:
        plane = geometry.plane
        return PLANE, np.array(plane.point, float), _unit(plane.normal), 0.0, False
    if geometry.sphere is not None:
        sphere = geometry.sphere
        return SPHERE, np.array(sphere.center, float), Z, sphere.radius, sphere.inside
    cylinder = geometry.cylinder
    origin, axis = np.array(cylinder.point, float), _unit(cylinder.axis)
    return CYLINDER, origin, axis, cylinder.radius, cylinder.inside


def _turned(contacts: list[Contact], axis) -> list[Contact]:
    """Turn contacts written for the z axis so that it becomes ``axis``."""
    turn = np.eye(4)
    turn[:3, :3] = _basis(axis)
    return [_placed(contact, turn, turn) for contact in contacts]


def _placed(contact: Contact, on_arm: np.ndarray, on_object: np.ndarray) -> Contact:
    """The contact with the arm's geometry moved by one pose and the object's by another."""
    arm_has_point = contact.surface_body == SURFACE_ON_OBJECT
    of_point, of_surface = (on_arm, on_object) if arm_has_point else (on_object, on_arm)
    return replace(
        contact,
        point=of_point[:3, :3] @ contact.point + of_point[:3, 3],
        origin=of_surface[:3, :3] @ contact.origin + of_surface[:3, 3],
        axis=of_surface[:3, :3] @ contact.axis,
    )


def _unit(vector) -> np.ndarray:
    vector = np.array(vector, dtype=float)
    return vector / np.linalg.norm(vector)


def _basis(axis) -> np.ndarray:
    """Rotation whose third column is ``axis``; the identity for the z axis."""
    z = _unit(axis)
    helper = X if abs(z[0]) < 0.9 else Y
    y = np.cross(z, helper)
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])
