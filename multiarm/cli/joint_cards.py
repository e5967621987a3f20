"""A card for every kind of joint and of surface: a picture, free motions, parameters, an example.

All of it comes from the classes.  Rows, rank and free motions are computed from the contact records
of the example; both joint frames coincide, as they do at the start.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from multiarm.cli.parameters import Parameter, parameters_of
from multiarm.errors import MultiarmError
from multiarm.geometry import records
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
from multiarm.geometry.screws import FreeMotions, free_motions, wrenches_in_frame
from multiarm.scene import JOINTS, SURFACES, ContactSpec, Joint, Surface
from multiarm.scene.joints import BUILT_IN as KINDS
from multiarm.scene.joints.contacts import BUILT_IN as SHAPES
from multiarm.scene.surfaces import PointGeometry

_NOUNS = {
    PLANE: "plane",
    SPHERE: "sphere",
    CYLINDER: "cylinder",
    CONE: "cone",
    TORUS: "torus",
    ELLIPSOID: "ellipsoid",
    SMOOTH: "surface",
}


@dataclass(frozen=True)
class JointCard:
    """One kind of joint.

    Attributes
    ----------
    kind, picture, example : str
        The example is YAML.
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
    parameters : list of Parameter
        Those of this kind; all joints share ``common_parameters``.
    """

    kind: str
    picture: str
    as_listed: bool
    rows: int | None
    rank: int | None
    free: list[str] | None
    made_of: str
    row_names: list[str]
    parameters: list[Parameter]
    example: str


@dataclass(frozen=True)
class SurfaceCard:
    """One kind of surface for contacts: a picture, its parameters, and one side of a contact."""

    name: str
    picture: str
    parameters: list[Parameter]
    example: str


def joint_cards() -> tuple[dict[str, JointCard], list[str]]:
    """A card for every kind of joint that a scene may name, and why others cannot be used."""
    own, faults = JOINTS.classes()
    return {kind: _joint_card(kind, model) for kind, model in {**KINDS, **own}.items()}, faults


def surface_cards() -> tuple[dict[str, SurfaceCard], list[str]]:
    """A card for every surface that may take part in a contact, and why others cannot be used."""
    own, faults = SURFACES.classes()
    cards = {name: _surface_card(name, model) for name, model in {**SHAPES, **own}.items()}
    return cards, faults


def common_parameters() -> list[Parameter]:
    """The parameters that all kinds of joint share."""
    return parameters_of(Joint)


def contact_parameters() -> list[Parameter]:
    """The parameters of one entry of a joint's list of contacts."""
    return parameters_of(ContactSpec)


def _surface_card(name: str, model: type[Surface]) -> SurfaceCard:
    parameters = [] if model is PointGeometry else parameters_of(model)  # 3 numbers
    return SurfaceCard(name, model.picture, parameters, model.example)


def _joint_card(kind: str, model: type[Joint]) -> JointCard:
    shared = Joint.model_fields
    contacts, motions = _sample(model)
    return JointCard(
        kind=kind,
        picture=model.picture,
        as_listed=model.as_listed,
        rows=len(contacts) or None,
        rank=None if motions is None else motions.rank,
        free=None if motions is None else motions.words(),
        made_of=_made_of(contacts),
        row_names=[contact.name for contact in contacts],
        parameters=[p for p in parameters_of(model) if p.name not in shared],
        example=model.example_text(),
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
    rows = np.column_stack([_row(contact) for contact in contacts])  # (6, N)
    return contacts, free_motions(wrenches_in_frame(joint.frames(on_object)[1], rows))


# --- rows and words from contact records ---------------------------------------------------------


def _row(contact: Contact) -> np.ndarray:
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


def _normal(guide: records.Surface, at: np.ndarray) -> np.ndarray:
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
    for (thing, noun), count in counts.items():
        head, _, rest = thing.partition(" ")
        words = [str(count), f"{head}{'s' * (count > 1)}", rest]
        if noun:
            several = len(places[thing, noun])
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
    thing = "fingertip" if contact.follower.sizes[0] > 0.0 else "point"
    return (thing if contact.surface_body == SURFACE_ON_OBJECT else f"{thing} of the object"), noun


def _place(guide: records.Surface) -> tuple:
    """What distinguishes surfaces of one kind: of a plane its normal and height."""
    axis = guide.axes[:, 2]
    where = [axis @ guide.origin] if guide.kind == PLANE else guide.origin
    return tuple(np.round([*axis, *where], 9) + 0.0)
