"""A grasp: contacts of grippers on the faces of a body, which can be made a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from multiarm.grasp.face_contacts import FaceContacts

if TYPE_CHECKING:
    from multiarm.scene import Scene


@dataclass(frozen=True, eq=False)
class Grasp(FaceContacts):
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
        A contact that is not on its face, or not carried by exactly one gripper.
    """

    def to_scene(self, arms: Sequence[str] = ("panda", "panda"), **options: Any) -> Scene:
        """A scene that runs: hands on arms, postures, a path, a control that squeezes.

        Parameters
        ----------
        arms : sequence of str
            Robots by name, one for each gripper.
        **options
            Those of :func:`multiarm.grasp.scenes.grasp_scene`: mass, path, duration, ...
        """
        from multiarm.grasp.scenes import grasp_scene

        return grasp_scene(self, arms, **options)
