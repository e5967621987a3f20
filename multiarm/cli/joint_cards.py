"""A card for every kind of joint and of surface, with its free motions.

Rows, rank and free motions are computed from the contact records of the example; both joint frames
coincide, as they do at the start.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from multiarm.cli.catalogue import Card, Section
from multiarm.errors import MultiarmError
from multiarm.geometry.records import CYLINDER, PLANE, SPHERE, Contact
from multiarm.geometry.screws import FreeMotions, free_motions, wrenches_in_frame
from multiarm.geometry.words import made_of, wrench_row
from multiarm.scene import JOINTS, SURFACES, ContactSpec, Joint, Surface
from multiarm.scene.joints import BUILT_IN as KINDS
from multiarm.scene.joints.contacts import BUILT_IN as SHAPES
from multiarm.scene.parameters import example_of, parameters_of, picture_of


def joint_section() -> Section:
    """The joints between an arm and the object."""
    cards, faults = joint_cards()
    return Section(
        "Joints",
        "joint kind",
        "kinds",
        cards,
        faults,
        heads=("kind", "rows", "what it is"),
        shared={"Parameters of every joint": (parameters_of(Joint), True)},
        note="x, y, z: axes of the joint frame, turned until z is the axis or normal",
    )


def surface_section() -> Section:
    """The surfaces of contacts."""
    cards, faults = surface_cards()
    options = [p for p in parameters_of(ContactSpec) if p.name not in ("arm", "object")]
    return Section(
        "Surfaces for joints of kind 'contacts'",
        "surface",
        "surfaces",
        cards,
        faults,
        heads=("surface", "what it is"),
        shared={"Parameters of a contact, besides its two sides": (options, False)},
    )


def joint_cards() -> tuple[dict[str, Card], list[str]]:
    """A card for every kind of joint that a scene may name, and why others cannot be used."""
    own, faults = JOINTS.classes()
    return {kind: _joint_card(kind, model) for kind, model in {**KINDS, **own}.items()}, faults


def surface_cards() -> tuple[dict[str, Card], list[str]]:
    """A card for every surface that may take part in a contact, and why others cannot be used."""
    own, faults = SURFACES.classes()
    cards = {name: _surface_card(name, model) for name, model in {**SHAPES, **own}.items()}
    cards["point"] = replace(cards["point"], parameters=[])  # a point is 3 numbers
    return cards, faults


def _surface_card(name: str, model: type[Surface]) -> Card:
    """One surface; its example is one side of a contact, which stands against a simple other."""
    card = Card.of(name, model)
    if not card.example:
        return card
    sides = ["arm: {point: [0, 0, 0]}", *card.example.splitlines()]
    if card.example.startswith("arm:"):
        sides = [*card.example.splitlines(), "object: {plane: {normal: [0, 0, 1]}}"]
    head = "joints:\n  - arm: left\n    kind: contacts\n    contacts:\n"
    listed = {"as one side of a contact": " ".join(card.example.split())}
    return replace(card, example=f"{head}      - " + "\n        ".join(sides), listed=listed)


def _joint_card(kind: str, model: type[Joint]) -> Card:
    """One kind of joint; of a list of the user's, rows and motions are those of the example."""
    contacts, motions = _sample(model)
    rows, rank = len(contacts) or None, None if motions is None else motions.rank
    free = None if motions is None else motions.words()
    made, names = made_of(contacts), [contact.name for contact in contacts]
    moves = "depend on the scene, see multiarm check" if free is None else ", ".join(free)
    here = "; those of the example" if model.as_listed else ""
    return Card(
        kind,
        picture_of(model),
        [p for p in parameters_of(model) if p.name not in Joint.model_fields],
        example_of(model),
        count="any" if model.as_listed else str(rows or ""),
        facts={
            "rows": f"{rows}, rank {rank}{here}" if rank else str(rows or ""),
            "free motions": moves or "none",
            "made of": made,
            "names of the rows": ", ".join(names),
        },
        listed={} if model.as_listed else {"free": moves or "nothing", "made of": made},
        key="kind",
        further={
            "as_listed": model.as_listed,
            "rows": rows,
            "rank": rank,
            "free": free,
            "made_of": made,
            "row_names": names,
        },
    )


def _sample(model: type[Joint]) -> tuple[list[Contact], FreeMotions | None]:
    """Contacts of the example, and its free motions where these are found without a scene.

    A user class may need parameters of which it gives no example.
    """
    try:
        joint = model.sample()
        on_object = joint.at_tip.matrix() @ joint.start_shift()  # the object's frame at the tip's
        contacts = joint.placed(on_object)
    except MultiarmError:
        return [], None
    if not all(contact.guide.kind in (PLANE, SPHERE, CYLINDER) for contact in contacts):
        return contacts, None
    rows = np.column_stack([wrench_row(contact) for contact in contacts])  # (6, N)
    return contacts, free_motions(wrenches_in_frame(joint.frames(on_object)[1], rows))
