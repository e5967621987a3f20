"""Form-closure grasps of polyhedra by frictionless contacts: decide, understand, design.

>>> import multiarm as ma
>>> grasp = ma.grasp.design_block_grasp([1.2, 0.8, 0.6])
>>> grasp.closure.margin, grasp.closure.coefficients
>>> scene = grasp.to_scene(arms=["panda", "panda"])

One question a file; see chapter 2 and the appendices A to C of the thesis.  Points are in metres,
in the body's frame; a contact's normal is a unit vector *into* the body.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.grasp.contacts import Contacts
    from multiarm.grasp.form_closure import FormClosure, is_form_closure
    from multiarm.grasp.grasp import Grasp, Gripper
    from multiarm.grasp.many_closures import ManyClosures, closed_many
    from multiarm.grasp.object_frame import (
        FrameCandidate,
        ObjectFrame,
        object_frame_from_contacts,
        object_frame_from_faces,
        object_frame_on_body,
    )
    from multiarm.grasp.polyhedron import Polyhedron
    from multiarm.grasp.seventh_contact import ContactRegion, seventh_contact_region
    from multiarm.grasp.wrench_cone import closes_on_surface

# Public name -> module of this package that has it.  Imported when first used.
_HOMES = {
    "ContactRegion": "seventh_contact",
    "Contacts": "contacts",
    "FormClosure": "form_closure",
    "FrameCandidate": "object_frame",
    "Grasp": "grasp",
    "Gripper": "grasp",
    "ManyClosures": "many_closures",
    "ObjectFrame": "object_frame",
    "Polyhedron": "polyhedron",
    "closed_many": "many_closures",
    "closes_on_surface": "wrench_cone",
    "is_form_closure": "form_closure",
    "object_frame_from_contacts": "object_frame",
    "object_frame_from_faces": "object_frame",
    "object_frame_on_body": "object_frame",
    "seventh_contact_region": "seventh_contact",
}

__all__ = [
    "ContactRegion",
    "Contacts",
    "FormClosure",
    "FrameCandidate",
    "Grasp",
    "Gripper",
    "ManyClosures",
    "ObjectFrame",
    "Polyhedron",
    "closed_many",
    "closes_on_surface",
    "is_form_closure",
    "object_frame_from_contacts",
    "object_frame_from_faces",
    "object_frame_on_body",
    "seventh_contact_region",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'multiarm.grasp' has no attribute {name!r}")
    value = getattr(import_module(f"multiarm.grasp.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
