"""A card for every kind of joint and of surface, with its free motions.

Rows, rank and free motions are computed from the contact records of the example; both joint frames
coincide, as they do at the start.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from multiarm.cli.catalogue import Card, Section
from multiarm.errors import MultiarmError
from multiarm.geometry.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SMOOTH,
    SPHERE,
    SURFACE_ON_OBJECT,
    TORUS,
    Contact,
    basis,
)
from multiarm.geometry.records import Surface as Body
from multiarm.geometry.screws import FreeMotions, free_motions, wrenches_in_frame
from multiarm.scene import JOINTS, SURFACES, ContactSpec, Joint, Surface
from multiarm.scene.joints import BUILT_IN as KINDS
from multiarm.scene.parameters import example_of, parameters_of, picture_of
from multiarm.scene.surfaces import BUILT_IN as SHAPES

_NOUNS = {
    PLANE: "plane",
    SPHERE: "sphere",
    CYLINDER: "cylinder",
    CONE: "cone",
    TORUS: "torus",
    ELLIPSOID: "ellipsoid",
    SMOOTH: "surface",
}


def joint_section() -> Section:
    """The joints between an arm and the object."""
    return Section.of_kinds(
        "Joints",
        KINDS,
        JOINTS,
        _joint_card,
        heads=("kind", "rows", "what it is"),
        shared={"Parameters of every joint": (parameters_of(Joint), True)},
        note="x, y, z: axes of the joint frame, turned until z is the axis or normal",
    )


def surface_section() -> Section:
    """The surfaces of contacts."""
    options = [p for p in parameters_of(ContactSpec) if p.name not in ("arm", "object")]
    return Section.of_kinds(
        "Surfaces for joints of kind 'contacts'",
        SHAPES,
        SURFACES,
        _surface_card,
        heads=("surface", "what it is"),
        shared={"Parameters of a contact, besides its two sides": (options, False)},
    )


def _surface_card(name: str, model: type[Surface], parameters: Any) -> Card:
    """One surface; its example is one side of a contact, whose second side is simple."""
    card = Card.of(name, model, parameters)
    if name == "point":  # 3 numbers
        card = replace(card, parameters=[])
    if not card.example:
        return card
    sides = ["arm: {point: [0, 0, 0]}", *card.example.splitlines()]
    if card.example.startswith("arm:"):
        sides = [*card.example.splitlines(), "object: {plane: {normal: [0, 0, 1]}}"]
    head = "joints:\n  - arm: left\n    kind: contacts\n    contacts:\n"
    listed = {"as one side of a contact": " ".join(card.example.split())}
    return replace(card, example=f"{head}      - " + "\n        ".join(sides), listed=listed)


def _joint_card(kind: str, model: type[Joint], parameters: Any) -> Card:
    """One kind of joint; where the user lists contacts, rows and motions are the example's."""
    contacts, motions = _sample(model)
    rows, rank = len(contacts) or None, None if motions is None else motions.rank
    free = None if motions is None else motions.words()
    surfaces, names = _made_of(contacts), [contact.name for contact in contacts]
    moves = "depend on the scene, see multiarm check" if free is None else ", ".join(free)
    here = "; those of the example" if model.as_listed else ""
    return Card(
        kind,
        picture_of(model),
        [p for p in parameters_of(parameters) if p.name not in Joint.model_fields],
        example_of(model),
        count="any" if model.as_listed else str(rows or ""),
        facts={
            "rows": f"{rows}, rank {rank}{here}" if rank else str(rows or ""),
            "free motions": moves or "none",
            "made of": surfaces,
            "names of the rows": ", ".join(names),
        },
        listed={} if model.as_listed else {"free": moves or "nothing", "made of": surfaces},
        key="kind",
        further={
            "as_listed": model.as_listed,
            "rows": rows,
            "rank": rank,
            "free": free,
            "made_of": surfaces,
            "row_names": names,
        },
    )


def _sample(model: type[Joint]) -> tuple[list[Contact], FreeMotions | None]:
    """Contacts of the example, and its free motions where these are found without a scene.

    A user class may need parameters of which it gives no example.
    """
    try:
        joint = model.sample()
        on_object = joint.on_first.matrix() @ joint.start_shift()  # the object's frame at the tip's
        contacts = joint.placed(on_object)
    except MultiarmError:
        return [], None
    if not all(contact.guide.kind in (PLANE, SPHERE, CYLINDER) for contact in contacts):
        return contacts, None
    rows = np.column_stack([_wrench_row(contact) for contact in contacts])  # (6, N)
    return contacts, free_motions(wrenches_in_frame(joint.frames(on_object)[1], rows))


def _wrench_row(contact: Contact) -> np.ndarray:
    """Wrench ``[e; p x e]`` while the tip's and the object's frame coincide, about their origin."""
    if contact.is_combined:
        minus = np.zeros(6) if contact.minus is None else _wrench(contact.minus)
        return contact.weight * (_wrench(contact) - minus)
    return _wrench(contact)


def _wrench(contact: Contact) -> np.ndarray:
    guide, at = contact.guide, contact.follower.origin
    normal = _normal(guide, at)
    if contact.tangent:
        at = at - contact.follower.sizes[0] * normal  # where the two bodies touch
        normal = basis(normal)[:, contact.tangent - 1]
    return np.concatenate([normal, np.cross(at, normal)])


def _normal(guide: Body, at: np.ndarray) -> np.ndarray:
    """Normal of a plane, sphere or cylinder, towards the side from which it is touched."""
    if guide.kind == PLANE:
        return guide.axes[:, 2]
    away = at - guide.origin
    if guide.kind == CYLINDER:
        away = away - guide.axes[:, 2] * (guide.axes[:, 2] @ away)
    return (-1.0 if guide.inside else 1.0) * away / np.linalg.norm(away)


def _made_of(contacts: list[Contact]) -> str:
    """``4 points on a cylinder, 1 point on a plane``: what touches what, and how often."""
    counts: Counter[tuple[str, str]] = Counter()
    places: dict[tuple[str, str], set[tuple]] = {}
    for contact in contacts:
        phrase = _phrase(contact)
        counts[phrase] += 1
        places.setdefault(phrase, set()).add(_place(contact.guide))
    parts = []
    for (touching, noun), count in counts.items():
        head, _, ending = touching.partition(" ")
        words = [str(count), f"{head}{'s' * (count > 1)}", ending]
        if noun:
            several = len(places[touching, noun])
            words += ["on", f"{several} {noun}s" if several > 1 else f"a {noun}"]
        parts.append(" ".join(filter(None, words)))
    return ", ".join(parts)


def _phrase(contact: Contact) -> tuple[str, str]:
    """What touches, and the kind of surface that it touches; a fingertip on the object is usual."""
    if contact.tangent:
        return "direction without slip", ""
    if contact.minus is not None:
        return "difference of two points on planes", ""
    guide = contact.guide
    noun = ("hollow " if guide.inside else "") + _NOUNS[guide.kind]
    touching = "fingertip" if contact.follower.sizes[0] > 0.0 else "point"
    if contact.surface_body != SURFACE_ON_OBJECT:
        touching = f"{touching} of the object"
    return touching, noun


def _place(guide: Body) -> tuple:
    """What distinguishes surfaces of one kind: of a plane its normal and height."""
    axis = guide.axes[:, 2]
    where = [axis @ guide.origin] if guide.kind == PLANE else guide.origin
    return tuple(np.round([*axis, *where], 9) + 0.0)
