"""A card for every kind of joint and of surface, with its free motions.

Rows, rank and free motions are computed from the contact records of the example; both joint frames
coincide, as they do at the start.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.cli.catalogue import Card, Section
from multiarm.errors import MultiarmError
from multiarm.geometry.records import CYLINDER, PLANE, SPHERE, Contact
from multiarm.geometry.screws import FreeMotions, free_motions, wrenches_in_frame
from multiarm.geometry.words import made_of, wrench_row
from multiarm.scene import JOINTS, SURFACES, ContactSpec, Joint
from multiarm.scene.joints import BUILT_IN as KINDS
from multiarm.scene.joints.contacts import BUILT_IN as SHAPES
from multiarm.scene.parameters import Parameter, example_of, parameters_of, picture_of
from multiarm.scene.surfaces import PointGeometry


@dataclass(frozen=True)
class JointCard(Card):
    """One kind of joint.

    Attributes
    ----------
    as_listed : bool
        Rows, contacts and free motions are whatever the user lists; here those of the example.
    rows, rank : int or None
        Constraint rows, and how many are independent; None where that depends on the scene.
    free : list of str or None
        Motions of the tip on the object that stay free.
    made_of : str
        The contacts, in words.
    row_names : list of str
        As they appear in results.
    """

    as_listed: bool
    rows: int | None
    rank: int | None
    free: list[str] | None
    made_of: str
    row_names: list[str]

    @property
    def count(self) -> str:
        """The number of rows."""
        return "any" if self.as_listed else str(self.rows or "")

    @property
    def facts(self) -> dict[str, str]:
        """Rows, free motions and contacts."""
        here = "; those of the example" if self.as_listed else ""
        return {
            "rows": f"{self.rows}, rank {self.rank}{here}" if self.rank else str(self.rows or ""),
            "free motions": self._motions("none"),
            "made of": self.made_of,
            "names of the rows": ", ".join(self.row_names),
        }

    @property
    def listed(self) -> dict[str, str]:
        """Free motions and contacts, where they do not depend on what a user lists."""
        if self.as_listed:
            return {}
        return {"free": self._motions("nothing"), "made of": self.made_of}

    def figures(self) -> dict[str, Any]:
        """What is shown, the name as that of a kind."""
        figures = super().figures()
        return {"kind": figures.pop("name"), **figures}

    def _motions(self, none: str) -> str:
        if self.free is None:
            return "depend on the scene, see multiarm check"
        return ", ".join(self.free) or none


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
        shared={"Parameters of every joint": (common_parameters(), True)},
        note="x, y, z: axes of the joint frame, turned until z is the axis or normal",
    )


def surface_section() -> Section:
    """The surfaces of contacts."""
    cards, faults = surface_cards()
    options = [p for p in contact_parameters() if p.name not in ("arm", "object")]
    return Section(
        "Surfaces for joints of kind 'contacts'",
        "surface",
        "surfaces",
        cards,
        faults,
        heads=("surface", "what it is"),
        shared={"Parameters of a contact, besides its two sides": (options, False)},
        with_examples=True,
    )


def joint_cards() -> tuple[dict[str, JointCard], list[str]]:
    """A card for every kind of joint that a scene may name, and why others cannot be used."""
    own, faults = JOINTS.classes()
    return {kind: _joint_card(kind, model) for kind, model in {**KINDS, **own}.items()}, faults


def surface_cards() -> tuple[dict[str, Card], list[str]]:
    """A card for every surface that may take part in a contact, and why others cannot be used."""
    own, faults = SURFACES.classes()
    cards = {}
    for name, model in {**SHAPES, **own}.items():
        keys = [] if model is PointGeometry else parameters_of(model)  # a point is 3 numbers
        cards[name] = Card(name, picture_of(model), keys, example_of(model))
    return cards, faults


def common_parameters() -> list[Parameter]:
    """The parameters that all kinds of joint share."""
    return parameters_of(Joint)


def contact_parameters() -> list[Parameter]:
    """The parameters of one entry of a joint's list of contacts."""
    return parameters_of(ContactSpec)


def _joint_card(kind: str, model: type[Joint]) -> JointCard:
    shared = Joint.model_fields
    contacts, motions = _sample(model)
    return JointCard(
        name=kind,
        picture=picture_of(model),
        parameters=[p for p in parameters_of(model) if p.name not in shared],
        example=example_of(model),
        as_listed=model.as_listed,
        rows=len(contacts) or None,
        rank=None if motions is None else motions.rank,
        free=None if motions is None else motions.words(),
        made_of=made_of(contacts),
        row_names=[contact.name for contact in contacts],
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
