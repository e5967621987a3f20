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
contacts           N     as listed by the user; a rolling one has two rows more
wrenches           N     one contact, or the difference of two, for each wrench listed
=================  ====  ==============================================================

A ball is written with three coincident points on three planes rather than with a sphere: both have
the same wrenches through the centre, and this one has them at every relative orientation.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multiarm.contacts.records import (
    Contact,
    Surface,
    Vector,
    basis,
    cylinder,
    plane,
    point,
    sphere,
)
from multiarm.contacts.wrench_rows import wrench_contacts
from multiarm.contacts.written import listed_contacts

X, Y, Z = np.eye(3)
ZERO = np.zeros(3)

# Components of the relative motion that stay free, in the axes of the joint's frame (its z axis is
# the joint's axis or normal): 0 to 2 are translations along, 3 to 5 turns about x, y, z.  None:
# to be chosen by the numbers of the start.
FREE: dict[str, tuple[int, ...] | None] = {
    "weld": (),
    "ball": (3, 4, 5),
    "revolute": (5,),
    "prismatic": (2,),
    "cylindrical": (2, 5),
    "universal": (3, 4),
    "planar": (0, 1, 5),
    "point_on_plane": None,
    "point_on_cylinder": None,
    "point_on_sphere": None,
    "corner_gripper": None,
    "contacts": None,
    "wrenches": None,
}


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

    Raises
    ------
    ModelError
        When a surface of the user's cannot be loaded.
    """
    contacts = CATALOGUE[joint.kind](joint)
    on_tip = joint.at_tip.matrix()
    return [_placed(contact, on_tip, object_pose) for contact in contacts]


def joint_frame(joint, object_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frame in which the joint's free motions are told, on both bodies.

    Parameters
    ----------
    joint : one of the joints of :mod:`multiarm.scene`
    object_pose : ndarray, shape (4, 4)
        Pose of the joint frame in the object frame.

    Returns
    -------
    on_tip, on_object : ndarray, shape (4, 4)
        Poses in the tip frame and in the object frame; z is the joint's axis or normal.
    """
    turn = np.eye(4)
    turn[:3, :3] = basis(_own_axis(joint))
    return joint.at_tip.matrix() @ turn, object_pose @ turn


def surface_offset(joint) -> np.ndarray:
    """Where the joint frame of a fingertip kind stands from the tip at the start, shape (3,).

    A fingertip touches its face at the start: the face's frame then lies one radius away from the
    fingertip's centre, along -X (cylinder, sphere) or against the normal (plane).
    """
    if joint.kind == "point_on_plane":
        return -joint.tip_radius * basis(joint.normal)[:, 2]
    if joint.kind == "point_on_cylinder":
        return -_centre_distance(joint) * basis(joint.axis)[:, 0]
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
    ball = [
        Contact(f"universal {k}", point(r * axis), sphere(ZERO, r))
        for k, axis in enumerate((X, Y, Z))
    ]
    return ball + _on_planes("universal cross", [r * Y], [X])


def _planar(joint) -> list[Contact]:
    h = joint.size / 2.0
    points = [(h, 0, 0), (-h, h, 0), (-h, -h, 0)]
    return _turned(_on_planes("planar", points, [Z, Z, Z]), joint.normal)


def _point_on_plane(joint) -> list[Contact]:
    return [_fingertip(joint, plane(ZERO, joint.normal))]


def _point_on_cylinder(joint) -> list[Contact]:
    return [_fingertip(joint, cylinder(ZERO, joint.axis, joint.radius, joint.inside))]


def _point_on_sphere(joint) -> list[Contact]:
    return [_fingertip(joint, sphere(ZERO, joint.radius, joint.inside))]


def _corner_gripper(joint) -> list[Contact]:
    contacts = []
    for k, (at, face) in enumerate(zip(joint.points, joint.faces, strict=True)):
        into_block = np.eye(3)["xyz".index(face)]
        tip = sphere(np.array(at) - joint.tip_radius * into_block, joint.tip_radius)
        name = f"fingertip {k + 1} on face {face}"
        contacts.append(Contact(name, tip, plane(ZERO, -into_block), pushes_only=True))
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
    "contacts": listed_contacts,
    "wrenches": wrench_contacts,
}


def _own_axis(joint) -> Vector:
    for name in ("axis", "normal"):
        if hasattr(joint, name):
            return getattr(joint, name)
    return Z


def _on_planes(name: str, points: list, normals: list) -> list[Contact]:
    """Points of the arm, each on a plane of the object through that point."""
    return [
        Contact(f"{name} {k + 1}", point(p), plane(p, n))
        for k, (p, n) in enumerate(zip(points, normals, strict=True))
    ]


def _cylinder_contacts(name: str, r: float) -> list[Contact]:
    points = [(r, 0, r), (0, r, r), (r, 0, -r), (0, r, -r)]
    return [
        Contact(f"{name} {k + 1}", point(p), cylinder(ZERO, Z, r)) for k, p in enumerate(points)
    ]


def _fingertip(joint, face: Surface) -> Contact:
    return Contact("fingertip", sphere(ZERO, joint.tip_radius), face, pushes_only=True)


def _centre_distance(joint) -> float:
    """Distance of a fingertip's centre from the centre or axis of the surface it touches."""
    return joint.radius + (-joint.tip_radius if joint.inside else joint.tip_radius)


def _turned(contacts: list[Contact], axis: Vector) -> list[Contact]:
    """Turn contacts written for the z axis so that it becomes ``axis``."""
    turn = np.eye(4)
    turn[:3, :3] = basis(axis)
    return [_placed(contact, turn, turn) for contact in contacts]


def _placed(contact: Contact, on_arm: np.ndarray, on_object: np.ndarray) -> Contact:
    """The contact with the arm's geometry moved by one pose and the object's by another."""
    return contact.mapped(
        lambda surface: surface.moved(on_arm[:3, :3], on_arm[:3, 3]),
        lambda surface: surface.moved(on_object[:3, :3], on_object[:3, 3]),
    )
