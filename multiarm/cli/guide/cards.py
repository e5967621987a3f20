"""A card for every kind of joint and of surface: what it is, what it leaves free, how to write it.

Only pictures and examples are typed (:mod:`multiarm.cli.guide.words`).  Parameters, their defaults,
meanings and units are those of the scene's schema; rows, rank and free motions are computed from
the contact records of the example, both joint frames coinciding as they do at the start.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np

from multiarm.cli.guide.motions import free_motions, seen_from
from multiarm.cli.guide.schema import Parameter, parameters_of
from multiarm.cli.guide.words import JOINTS, SURFACES
from multiarm.contacts.catalogue import joint_contacts, joint_frame, surface_offset
from multiarm.contacts.records import (
    CONE,
    CYLINDER,
    ELLIPSOID,
    PLANE,
    SMOOTH,
    SPHERE,
    SURFACE_ON_OBJECT,
    TORUS,
    Contact,
    Surface,
    basis,
)
from multiarm.scene import ContactSpec, Geometry, JointBase, JointSpec

__all__ = [
    "JointCard",
    "SurfaceCard",
    "common_parameters",
    "contact_parameters",
    "joint_cards",
    "joint_models",
    "read_joint",
    "reference_rows",
    "surface_cards",
]

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
    rows, rank : int
        Constraint rows, and how many are independent.
    free : list of str
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
    rows: int
    rank: int
    free: list[str]
    made_of: str
    row_names: list[str]
    parameters: list[Parameter]
    example: str

    def as_dict(self) -> dict[str, Any]:
        """Plain tables and lists under the names above."""
        return asdict(self)


@dataclass(frozen=True)
class SurfaceCard:
    """One kind of surface for contacts: a picture, its parameters, and one side of a contact."""

    name: str
    picture: str
    parameters: list[Parameter]
    example: str

    def as_dict(self) -> dict[str, Any]:
        """Plain tables and lists under the names above."""
        return asdict(self)


def joint_cards() -> dict[str, JointCard]:
    """A card for every kind of joint that a scene may name, in the schema's order."""
    models = {model.model_fields["kind"].default: model for model in joint_models()}
    return {kind: _joint_card(kind, model) for kind, model in models.items()}


def surface_cards() -> dict[str, SurfaceCard]:
    """A card for every surface that may take part in a contact, in the schema's order."""
    return {
        name: SurfaceCard(
            name, SURFACES[name].picture, _surface_parameters(field), SURFACES[name].example
        )
        for name, field in Geometry.model_fields.items()
    }


def common_parameters() -> list[Parameter]:
    """The parameters that all kinds of joint share."""
    return parameters_of(JointBase)


def contact_parameters() -> list[Parameter]:
    """The parameters of one entry of a joint's list of contacts."""
    return parameters_of(ContactSpec)


def joint_models() -> tuple[type[JointBase], ...]:
    """The models of all kinds of joint."""
    union, *_ = get_args(JointSpec)
    return get_args(union)


def read_joint(example: str) -> JointBase:
    """The joint that an example describes.

    Parameters
    ----------
    example : str
        YAML with one entry in its list ``joints``.
    """
    import yaml

    (entry,) = yaml.safe_load(example)["joints"]
    models = {model.model_fields["kind"].default: model for model in joint_models()}
    return models[entry["kind"]].model_validate(entry)


def reference_rows(contacts: list[Contact]) -> np.ndarray:
    """Rows of contacts (columns) while the tip's and the object's frame coincide, shape (6, N).

    Wrenches ``[e; p x e]`` about the origin of these frames, in which the contacts are given.
    """
    return np.column_stack([_row(contact) for contact in contacts])


def _joint_card(kind: str, model: type[JointBase]) -> JointCard:
    words = JOINTS[kind]
    joint = read_joint(words.example)
    on_object = joint.at_tip.matrix()  # the object's frame where the tip's is
    on_object[:3, 3] += on_object[:3, :3] @ surface_offset(joint)
    contacts = joint_contacts(joint, on_object)
    frame = joint_frame(joint, on_object)[1]
    motions = free_motions(seen_from(frame, reference_rows(contacts)))
    shared = JointBase.model_fields
    return JointCard(
        kind=kind,
        picture=words.picture,
        as_listed=words.as_listed,
        rows=len(contacts),
        rank=motions.rank,
        free=motions.words(),
        made_of=_made_of(contacts),
        row_names=[contact.name for contact in contacts],
        parameters=[p for p in parameters_of(model) if p.name not in shared],
        example=words.example.strip("\n"),
    )


def _row(contact: Contact) -> np.ndarray:
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


def _normal(guide: Surface, at: np.ndarray) -> np.ndarray:
    """Normal of a plane, sphere or cylinder, towards the side from which it is touched."""
    assert guide.kind in (PLANE, SPHERE, CYLINDER), "examples keep to these"
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


def _place(guide: Surface) -> tuple:
    """What tells surfaces of one kind apart: of a plane its normal and height."""
    axis = guide.axes[:, 2]
    where = [axis @ guide.origin] if guide.kind == PLANE else guide.origin
    return tuple(np.round([*axis, *where], 9) + 0.0)


def _surface_parameters(field: Any) -> list[Parameter]:
    """Parameters of one side of a contact; a point is written without any."""
    models = [part for part in get_args(field.annotation) if hasattr(part, "model_fields")]
    return [parameter for model in models for parameter in parameters_of(model)]
