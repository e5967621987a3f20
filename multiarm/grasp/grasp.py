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
    """A grasp: :class:`multiarm.grasp.face_contacts.FaceContacts` that can be made a scene."""

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
