"""The grasp in a scene: which contacts hold the object, on which faces, and where they could go.

A contact that only pushes is one contact.  One that holds both ways, such as those of a weld,
counts twice, with opposite normals.  Rows that are no contacts in points (couples, slip, limits of
joints) are left out and named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiarm.dynamics.contact_geometry import contact_places
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import GraspError
from multiarm.geometry.records import Contact
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.form_closure import FormClosure, is_form_closure
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.polyhedron import Polyhedron
from multiarm.grasp.seventh_contact import ContactRegion, region_of
from multiarm.scene import ObjectSpec
from multiarm.spatial import quaternion_to_matrix

# A contact lies on a face of the object when its point [parts of the object's size] and its normal
# are off by less.
ON_FACE = 1e-6


@dataclass(frozen=True, eq=False)
class SceneGrasp:
    """The contacts that hold the object of a scene, in the object's frame.

    Attributes
    ----------
    contacts : Contacts
        Named ``arm/contact``.
    rows : tuple of (str, int)
        Of each contact: its arm, and its number among the rows of that arm's joint.
    pulls : tuple of bool
        Whether it is the pulling side of a contact that holds both ways.
    faces : tuple of int or None
        The face of ``body`` that it lies on.
    body : Polyhedron or None
        The object, where its shape is a box or a hull, or a mesh that is closed.
    left_out : tuple of str
        Rows that are no contacts in points.
    frames : table 'arm: pose (4, 4)'
        Of the joints' frames on the object.
    """

    contacts: Contacts
    rows: tuple[tuple[str, int], ...]
    pulls: tuple[bool, ...]
    faces: tuple[int | None, ...]
    body: Polyhedron | None
    left_out: tuple[str, ...]
    frames: Mapping[str, np.ndarray]

    @property
    def only_pushes(self) -> bool:
        """Whether no contact holds both ways."""
        return not any(self.pulls)

    @cached_property
    def closure(self) -> FormClosure:
        """Whether the contacts hold the object while the arms hold still."""
        return is_form_closure(self.contacts)

    @cached_property
    def regions(self) -> tuple[ContactRegion | None, ...]:
        """Where on its face each contact closes the grasp while all others stay as they are.

        None where the face is not known, where the others leave the object more than one freedom,
        where no place on the face closes the grasp, or where a contact holds both ways.
        """
        return tuple(self._region(j) for j in range(len(self.contacts)))

    def as_grasp(self) -> Grasp:
        """The same as a grasp of a polyhedron, one gripper an arm.

        Raises
        ------
        GraspError
            When the object has no plane faces, or a contact holds both ways or is on none of them.
        """
        faces = tuple(face for face in self.faces if face is not None)
        if self.body is None or len(faces) < len(self.contacts):
            off = [n for n, k in zip(self.contacts.names, self.faces, strict=True) if k is None]
            raise GraspError(
                "this is no grasp of a polyhedron: "
                + ("the object has no plane faces" if self.body is None else "")
                + (f"on none of its faces is {', '.join(off)}" if self.body is not None else "")
            )
        grippers = tuple(
            Gripper(arm, tuple(j for j, (owner, _) in enumerate(self.rows) if owner == arm), frame)
            for arm, frame in self.frames.items()
            if any(owner == arm for owner, _ in self.rows)
        )
        return Grasp(self.body, self.contacts, faces, grippers)

    def _region(self, j: int) -> ContactRegion | None:
        face = self.faces[j]
        if self.body is None or face is None or not self.only_pushes or len(self.contacts) < 7:
            return None
        return region_of(self.contacts, j, self.body.faces[face]) or None


def read_grasp(system: System, state: State | None = None) -> SceneGrasp:
    """The grasp of a scene at a state, by default at its start.

    Raises
    ------
    GraspError
        When no row of the scene's joints is a contact in a point.
    """
    state = system.initial_state() if state is None else state
    with system.borrow() as data:
        points, normals = contact_places(data, state)
    R = quaternion_to_matrix(state.object_quaternion_xyzw.copy())
    points, normals = (points - state.object_position) @ R, normals @ R
    body = body_of(system.scene.object)
    found: list[tuple[int, str, int, bool]] = []
    left_out, row = [], -1
    for arm in system.arm_names:
        for k, contact in enumerate(system.contacts[arm]):
            row += 1
            if not _in_a_point(contact):
                left_out.append(f"{arm}/{contact.name}")
                continue
            found.append((row, arm, k, False))
            if not contact.pushes_only:
                found.append((row, arm, k, True))
    if not found:
        raise GraspError("no joint of this scene holds the object by contacts in points")
    names = [
        f"{arm}/{system.contacts[arm][k].name}{', pulling' if pulls else ''}"
        for _, arm, k, pulls in found
    ]
    rows = [row for row, *_ in found]
    signs = np.array([-1.0 if pulls else 1.0 for *_, pulls in found])
    contacts = Contacts(points[rows], signs[:, None] * normals[rows], names)
    faces = tuple(
        None if body is None or pulls else _face_of(body, point, normal)
        for point, normal, (*_, pulls) in zip(contacts.points, contacts.normals, found, strict=True)
    )
    return SceneGrasp(
        contacts=contacts,
        rows=tuple((arm, k) for _, arm, k, _ in found),
        pulls=tuple(pulls for *_, pulls in found),
        faces=faces,
        body=body,
        left_out=tuple(left_out),
        frames={arm: system.frames[arm].on_object for arm in system.arm_names},
    )


def body_of(spec: ObjectSpec) -> Polyhedron | None:
    """The object as a polyhedron in its own frame; None where it is round or its mesh is open."""
    shape = spec.shape
    if shape.box is not None:
        return Polyhedron.box(shape.box)
    if shape.hull is not None:
        return Polyhedron.hull(np.array(shape.hull))
    if shape.mesh is not None and len(set(shape.mesh.scale)) == 1:
        try:
            return Polyhedron.mesh(shape.mesh.file, shape.mesh.scale[0])
        except GraspError:
            return None
    return None


def _in_a_point(contact: object) -> bool:
    return isinstance(contact, Contact) and contact.tangent == 0 and contact.minus is None


def _face_of(body: Polyhedron, point: np.ndarray, normal: np.ndarray) -> int | None:
    heights = body.normals @ point - np.array([face.offset for face in body.faces])
    turned = np.linalg.norm(body.normals + normal, axis=1)
    close = (np.abs(heights) < ON_FACE * body.size) & (turned < ON_FACE)
    on = [int(k) for k in np.flatnonzero(close) if body.faces[k].contains(point)]
    return on[0] if on else None
