"""A joint between an arm and the object, as a scene has it."""

from __future__ import annotations

from typing import NamedTuple

from multiarm.contacts.frames import JointFrame
from multiarm.contacts.records import Contact


class Joint(NamedTuple):
    """A joint between an arm and the object.

    contacts : list of Contact
        The arm's geometry in the tip frame.
    frame : JointFrame
        Which motions it leaves free is left open where the catalogue does not say.
    limits : dict
        By component of the relative motion, see :attr:`multiarm.scene.JointBase.free_limits`.
    """

    contacts: list[Contact]
    frame: JointFrame
    limits: dict[int, tuple[float, float]]
