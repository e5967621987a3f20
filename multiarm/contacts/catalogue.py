r"""The catalogue of joints: each kind is a function that returns contact records.

Points sit on the arm, surfaces on the object; both joint frames coincide in the reference position.
``X, Y, Z`` are the joint frame's axes, ``h = size / 2`` (thesis, 3.9.1, with two corrections: the
prismatic joint's second plane needs contacts apart along the slide, the universal joint's plane
must contain the sphere's centre).

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
contacts           N     as listed in the scene; a rolling one has two rows more
wrenches           N     one contact, or the difference of two, for each wrench listed
=================  ====  ==============================================================

A ball is written with three coincident points on three planes rather than with a sphere: both have
the same wrenches through the centre, and this one has them at every relative orientation.

*A joint given by the wrenches it transmits.*  The wrench on the object is :math:`\gamma` times one
contact, or the difference of two (thesis, appendix C; :func:`multiarm.geometry.screws.zero_pitch`).
Each contact is a plane on the body that carries the wrench, and a point on the other body that
starts on it.  The wrenches determine which motions are free at the start; the finite motion of the
joint depends on the pairs.  They are chosen so that a hinge, a slider, a ball or a universal joint
stays one: forces act near the centre of rotation; if there is a single axis of rotation, they act
where they meet that axis, and couples are a push and a pull across it at two places along it,
which keep their direction in the carrying body at any angle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from multiarm.geometry import records
from multiarm.geometry.records import (
    Contact,
    Patch,
    Surface,
    Vector,
    basis,
    cylinder,
    plane,
    point,
    sphere,
)
from multiarm.geometry.screws import ZeroPitch, zero_pitch
from multiarm.geometry.smooth import ParametricSurface, SignedDistanceSurface

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

    Raises
    ------
    ModelError
        When a user surface cannot be used.
    """
    on_tip = joint.at_tip.matrix()
    return [_placed(one, on_tip, object_pose) for one in CATALOGUE[joint.kind].contacts(joint)]


def joint_frame(joint, object_pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frame in which a joint's free motions are expressed, z its axis or normal.

    Returns
    -------
    on_tip, on_object : ndarray, shape (4, 4)
        Poses in the tip frame and in the object frame.
    """
    turn = np.eye(4)
    turn[:3, :3] = basis(getattr(joint, "axis", getattr(joint, "normal", Z)))
    return joint.at_tip.matrix() @ turn, object_pose @ turn


def surface_offset(joint) -> np.ndarray:
    """Position of the joint frame of a fingertip kind relative to the tip at the start, shape (3,).

    A fingertip touches its face at the start: the face's frame then lies one radius away from the
    fingertip's centre, along -X (cylinder, sphere) or against the normal (plane).
    """
    if joint.kind == "point_on_plane":
        return -joint.tip_radius * basis(joint.normal)[:, 2]
    if joint.kind not in ("point_on_cylinder", "point_on_sphere"):
        return ZERO
    distance = joint.radius + (-joint.tip_radius if joint.inside else joint.tip_radius)
    return -distance * (basis(joint.axis)[:, 0] if joint.kind == "point_on_cylinder" else X)


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


def _listed(joint) -> list[Contact]:
    """Contacts as the scene lists them, whose functions have been loaded already."""
    contacts = []
    for k, spec in enumerate(joint.contacts):
        name = spec.name or f"contact {k + 1}"
        normal = Contact(name, _surface(spec.arm), _surface(spec.object), pushes_only=True)
        contacts.append(normal)
        for tangent in (1, 2) if spec.rolling else ():
            row = f"{name}, no slip {tangent}"
            contacts.append(replace(normal, name=row, tangent=tangent, pushes_only=False))
    return contacts


def _wrenches(joint) -> list[Contact]:
    """One row for each wrench that the joint transmits."""
    wrenches = np.array(joint.wrenches)
    centre, axis = _centre_and_axis(wrenches, joint.size)
    contacts = []
    for k, wrench in enumerate(wrenches):
        force, moment = wrench[:3], wrench[3:] - np.cross(centre, wrench[:3])
        pair = zero_pitch(np.concatenate([force, moment]), length=joint.size)
        if axis is not None and pair.e_2 is None:
            pair = replace(pair, p_1=_nearest_to_axis(pair.p_1, pair.e_1, axis))
        elif axis is not None and np.array_equal(pair.e_1, np.array(pair.e_2)):
            pair = _couple(moment, axis, joint.size)
        contacts.append(_wrench_row(f"wrench {k + 1}", pair, centre, joint.carried_by))
    return contacts


class JointKind(NamedTuple):
    """One kind of joint.

    contacts : callable
        Its contact records in the joint frame.
    free : tuple of int or None
        Components of the relative motion that stay free, in the axes of :func:`joint_frame`: 0 to 2
        are translations along x, y, z, 3 to 5 rotations about them.  None: they depend on the
        geometry and are determined at the start.
    """

    contacts: Callable[..., list[Contact]]
    free: tuple[int, ...] | None = None


CATALOGUE = {
    "weld": JointKind(_weld, ()),
    "ball": JointKind(_ball, (3, 4, 5)),
    "revolute": JointKind(_revolute, (5,)),
    "prismatic": JointKind(_prismatic, (2,)),
    "cylindrical": JointKind(_cylindrical, (2, 5)),
    "universal": JointKind(_universal, (3, 4)),
    "planar": JointKind(_planar, (0, 1, 5)),
    "point_on_plane": JointKind(_point_on_plane),
    "point_on_cylinder": JointKind(_point_on_cylinder),
    "point_on_sphere": JointKind(_point_on_sphere),
    "corner_gripper": JointKind(_corner_gripper),
    "contacts": JointKind(_listed),
    "wrenches": JointKind(_wrenches),
}


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


# --- listed contacts ------------------------------------------------------------------------------


def _surface(geometry) -> Surface:
    """The surface that a :class:`multiarm.scene.Geometry` describes, in the joint frame."""
    found = _SURFACES[geometry.shape](geometry.value)
    patch = None if geometry.shape == "point" else geometry.value.patch
    if patch is None:
        return found
    lower = [-np.inf if bound is None else bound for bound in patch.min]
    upper = [np.inf if bound is None else bound for bound in patch.max]
    return replace(found, patch=Patch(np.array(lower), np.array(upper)))


def _smooth(g) -> Surface:
    shape: SignedDistanceSurface | ParametricSurface
    if g.distance is not None:
        shape = SignedDistanceSurface(g.distance, g.gradient, g.hessian, g.length)
    else:
        shape = ParametricSurface(g.parametrisation, g.u, g.v, g.derivatives, g.flip, g.length)
    return records.smooth(shape, g.origin, g.orientation().rotation(), g.inside)


_SURFACES: dict[str, Callable[..., Surface]] = {
    "point": point,
    "sphere": lambda g: sphere(g.center, g.radius, g.inside),
    "plane": lambda g: plane(g.point, g.normal),
    "cylinder": lambda g: cylinder(g.point, g.axis, g.radius, g.inside),
    "cone": lambda g: records.cone(g.apex, g.axis, g.half_angle, g.inside),
    "torus": lambda g: records.torus(g.center, g.axis, g.circle_radius, g.tube_radius, g.inside),
    "ellipsoid": lambda g: records.ellipsoid(
        g.center, g.orientation().rotation(), g.semi_axes, g.inside
    ),
    "surface": _smooth,
}


# --- wrenches -------------------------------------------------------------------------------------


def _centre_and_axis(wrenches: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray | None]:
    """Centre of the rotations that these wrenches leave free, and their axis if there is only one.

    The centre is the point nearest to the origin that no free rotation moves, other than along a
    free translation.
    """
    scaled = wrenches / ([1.0] * 3 + [size] * 3)
    scaled /= np.linalg.norm(scaled, axis=1)[:, None]
    free = np.linalg.svd(scaled)[2][len(scaled) :].T  # columns: twists [v; size omega], no work
    ways, weights, mixes = np.linalg.svd(free[3:])
    tolerance = 1e-9  # of the rotation in a free motion of unit size
    turns = np.count_nonzero(weights > tolerance)
    slides = np.linalg.qr(free[:3] @ mixes[turns:].T)[0]
    across = np.eye(3) - slides @ slides.T
    equations, right = [np.zeros((0, 3))], [np.zeros(0)]
    for v, w in zip((free[:3] @ mixes[:turns].T).T, (free[3:] @ mixes[:turns].T).T, strict=True):
        equations.append(across @ np.cross(w / size, np.eye(3)).T)  # v + w x centre is a slide
        right.append(-across @ v)
    found = np.linalg.lstsq(np.vstack(equations), np.concatenate(right), rcond=tolerance)[0]
    way = ways[:, 0] * np.sign(ways[np.argmax(np.abs(ways[:, 0])), 0])
    return np.where(np.abs(found) > 1e-12 * size, found, 0.0), way if turns == 1 else None


def _nearest_to_axis(p: np.ndarray, e: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Point of the line through ``p`` along ``e`` that is nearest to the axis through the origin.

    Lines along the axis, to 1e-6 rad, are equally near everywhere: ``p`` is kept.
    """
    across_e, across_p = e - (e @ axis) * axis, p - (p @ axis) * axis
    square = across_e @ across_e
    return p if square < 1e-12 else p - (across_e @ across_p) / square * e


def _couple(moment: np.ndarray, axis: np.ndarray, size: float) -> ZeroPitch:
    """A couple across an axis as a push and a pull across it, ``size`` apart along it.

    At any angle about the axis its direction stays with the body that carries the planes, as that
    of a single force does: rows of both sorts never become dependent.
    """
    gamma = float(np.linalg.norm(moment)) / size
    e, arm = np.cross(moment, axis) / (gamma * size), 0.5 * size * axis
    return ZeroPitch(gamma, e, arm, e, -arm)


def _wrench_row(name: str, pair: ZeroPitch, centre: np.ndarray, carried_by: str) -> Contact:
    def contact(e: np.ndarray, p: np.ndarray) -> Contact:
        p = p + centre
        # e points into the object: out of the arm's plane, against the normal of the object's
        if carried_by == "arm":
            return Contact(name, plane(p, e), point(p))
        return Contact(name, point(p), plane(p, -e))

    weight = 1.0 if abs(pair.gamma - 1.0) < 1e-14 else pair.gamma  # 1 but for rounding
    row = contact(pair.e_1, pair.p_1)
    if pair.e_2 is None or pair.p_2 is None:
        return replace(row, weight=weight)
    return replace(row, weight=weight, minus=contact(pair.e_2, pair.p_2))
