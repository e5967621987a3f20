"""Contacts on the faces of a body, carried by grippers.

All coordinates are in the frame of the body.  A gripper is a rigid pattern of fingertips with its
own frame: at a corner of the body, its axes into the body.  The same pattern fits every body that
has this corner, which makes small grippers for large objects possible (thesis, 2.2.3).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from typing_extensions import Self

from multiarm.errors import GraspError
from multiarm.grasp.body.face import Face
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.closure.form_closure import FormClosure, is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.notation import count_of
from multiarm.public import facts_html

# A contact lies on its face when it is off by no more than this part of the body's size.
ON_FACE = 1e-9
# Its normal is the face's when it is off by no more than this [rad].
ALONG_NORMAL = 1e-6


@dataclass(frozen=True, eq=False)
class Gripper:
    """One gripper: a rigid pattern of fingertips.

    Attributes
    ----------
    name : str
    contacts : tuple of int
        Which contacts of the grasp it carries, numbers from 0.
    frame : ndarray, shape (4, 4)
        Pose of the gripper's frame in the body's frame; at a corner its origin is that corner.
    """

    name: str
    contacts: tuple[int, ...]
    frame: np.ndarray

    @property
    def corner(self) -> np.ndarray:
        """Origin of the frame in the body's frame, shape (3,) [m]."""
        return self.frame[:3, 3]

    @property
    def arm_name(self) -> str:
        """The name as a scene may name an arm."""
        return re.sub(r"\W+", "_", self.name)


@dataclass(frozen=True, eq=False)
class FaceContacts:
    """Contacts of grippers on the faces of a polyhedron.

    Attributes
    ----------
    body : Polyhedron
    contacts : Contacts
        In the body's frame; normals are those of the faces, turned inward.
    faces : tuple of int
        Contact j lies on ``body.faces[faces[j]]``.
    grippers : tuple of Gripper
        Together they carry every contact once.
    notes : tuple of str
        Remarks of the design, in sentences.

    Raises
    ------
    GraspError
        A contact that is not on its face, or not carried by exactly one gripper; grippers whose
        names are the same for a scene.
    """

    body: Polyhedron
    contacts: Contacts
    faces: tuple[int, ...]
    grippers: tuple[Gripper, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if len(self.faces) != len(self.contacts):
            raise GraspError(
                f"{count_of(len(self.contacts), 'contact')} must have as many faces, not "
                f"{len(self.faces)}"
            )
        for j, number in enumerate(self.faces):
            if number not in range(len(self.body.faces)):
                raise GraspError(
                    f"faces of the body are 0 to {len(self.body.faces) - 1}, not {number!r}"
                )
            self._check_contact(j, self.body.faces[number])
        carried = sorted(j for gripper in self.grippers for j in gripper.contacts)
        if carried != list(range(len(self.contacts))):
            raise GraspError(
                f"each of the {len(self.contacts)} contacts is carried by one gripper; the "
                f"grippers carry {[gripper.contacts for gripper in self.grippers]}"
            )

        names = [gripper.name for gripper in self.grippers]
        if len({gripper.arm_name for gripper in self.grippers}) < len(names):
            raise GraspError(
                f"names of grippers differ in letters or digits, each is an arm of a scene; they "
                f"are {names}"
            )

    def _repr_html_(self) -> str:
        facts = {
            "body": repr(self.body).strip("<>"),
            "contacts": f"{len(self.contacts)} by {count_of(len(self.grippers), 'gripper')}",
            "faces": ", ".join(dict.fromkeys(self.body.faces[k].name for k in self.faces)),
            "notes": "; ".join(self.notes),
        }
        return facts_html("Grasp", facts)

    def _check_contact(self, j: int, face: Face) -> None:
        name, size = self.contacts.names[j], self.body.size
        point, normal = self.contacts.points[j], self.contacts.normals[j]
        off = max(abs(float(face.normal @ point) - face.offset), -float(face.room(point)))
        if off > ON_FACE * size:
            raise GraspError(f"{name} is {off:.3g} m off {face.name}")
        if np.linalg.norm(normal + face.normal) > ALONG_NORMAL:
            raise GraspError(f"the normal of {name} is not that of {face.name}, turned inward")

    @cached_property
    def closure(self) -> FormClosure:
        """Whether the contacts hold the body, with the proof."""
        return is_form_closure(self.contacts)

    def gripper_size(self, name: str) -> float:
        """Largest distance between two contacts of a gripper [m].

        Raises
        ------
        GraspError
            When no gripper is called so.
        """
        chosen = [gripper for gripper in self.grippers if gripper.name == name]
        if not chosen:
            names = ", ".join(repr(gripper.name) for gripper in self.grippers)
            raise GraspError(f"no gripper is called {name!r}; grippers are {names}")
        points = self.contacts.points[list(chosen[0].contacts)]
        return float(np.max(np.linalg.norm(points[:, None] - points[None], axis=-1)))

    def placed(self, pose: np.ndarray) -> Self:
        """The contacts in another frame; ``pose`` (4, 4) is this frame in it."""
        moved = [replace(gripper, frame=pose @ gripper.frame) for gripper in self.grippers]
        return replace(
            self,
            body=self.body.placed(pose),
            contacts=self.contacts.placed(pose),
            grippers=tuple(moved),
        )

    def noted(self, *sentences: str) -> Self:
        """A copy with further notes."""
        return replace(self, notes=(*self.notes, *sentences))
