"""A card for every kind of joint and of surface: a picture, free motions, parameters, an example.

Only pictures and examples are written here.  Parameters, defaults, meanings and units come from the
scene's schema: a meaning is the class's documentation of an attribute, or the field's description,
and the unit is the text in brackets therein, ``[m]``.  Rows, rank and free motions are computed
from the contact records of the example; both joint frames coincide, as they do at the start.
"""

from __future__ import annotations

import inspect
import re
from collections import Counter
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import yaml

from multiarm.contacts.catalogue import joint_contacts, joint_frame, surface_offset
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
    Surface,
    basis,
)
from multiarm.geometry.screws import free_motions, wrenches_in_frame
from multiarm.scene import ContactSpec, Geometry, JointBase, JointSpec

# Kind of joint: an everyday example, and the lines after its kind in a scene.
_JOINTS = {
    "weld": ("glued or clamped: tip and object are one body", ""),
    "ball": (
        "a trailer hitch: the tip turns every way about one point of the object",
        """
    at: {xyz: [0.3, 0, 0]}   # that point, in the object frame""",
    ),
    "revolute": (
        "a door hinge: the tip turns about one line fixed in the object",
        """
    axis: [0, 0, 1]          # that line, in the joint frame
    limits: [-0.5, 1.2]      # from the start; drawn and reported""",
    ),
    "prismatic": (
        "a drawer: the tip slides along one line of the object and does not turn",
        """
    axis: [1, 0, 0]
    limits: [-0.05, 0.20]""",
    ),
    "cylindrical": (
        "a rod in a sleeve: the tip turns about one line of the object and slides along it",
        """
    axis: [0, 0, 1]""",
    ),
    "universal": (
        "the cross of a drive shaft: the tip turns about the object's x and about its own y axis",
        "",
    ),
    "planar": (
        "a puck on ice: the tip slides over a flat face and turns on it, but never lifts or tilts",
        """
    normal: [0, 0, 1]""",
    ),
    "point_on_plane": (
        "a fingertip on a table: it slides and rolls any way, but stays on the flat face",
        """
    normal: [0, 0, 1]        # out of the object's face
    tip_radius: 0.01""",
    ),
    "point_on_cylinder": (
        "a fingertip on a pipe, or within one: it slides along and around it",
        """
    radius: 0.05
    axis: [0, 0, 1]
    tip_radius: 0.01""",
    ),
    "point_on_sphere": (
        "a fingertip on a ball, or in a bowl: it slides anywhere on it",
        """
    radius: 0.05
    inside: true             # a bowl
    tip_radius: 0.01""",
    ),
    "corner_gripper": (
        "four fingertips around the corner of a block: it can be pushed and tipped, not pulled off",
        """
    tip_radius: 0.01
    at: {xyz: [-0.3, -0.25, 0.2], quaternion_xyzw: [1, 1, 0, 0]}   # the block's corner""",
    ),
    "contacts": (
        "a hand of your own: any list of fingertips and surfaces, each touching in one point",
        """
    contacts:
      - arm: {sphere: {center: [0, 0.1, 0.21], radius: 0.01}}
        object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1]}}
        name: finger on the lid
      - arm: {sphere: {center: [0.2, -0.1, 0.21], radius: 0.01}}
        object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1]}}
        rolling: true        # no slip""",
    ),
    "wrenches": (
        "a joint given by the forces and moments that it transmits; all other motions are free",
        """           # forces and moments, joint frame: a screw
    wrenches:
      - [1, 0, 0, 0, 0, 0]
      - [0, 1, 0, 0, 0, 0]
      - [0, 0, 1, 0, 0, -0.01]
      - [0, 0, 0, 1, 0, 0]
      - [0, 0, 0, 0, 1, 0]""",
    ),
}
# Kind of surface: an everyday example, and one side of a contact.
_SURFACES = {
    "point": (
        "a needle's tip: it touches any surface of the other body",
        "arm: {point: [0, 0, 0.1]}",
    ),
    "sphere": (
        "a fingertip or a ball; inside: a socket or a bowl",
        "object: {sphere: {center: [0, 0, 0], radius: 0.05, inside: true}}",
    ),
    "plane": (
        "a table top; here with its edges, a patch",
        "object: {plane: {point: [0, 0, 0.2], normal: [0, 0, 1], "
        "patch: {min: [-0.3, -0.2, null], max: [0.3, 0.2, null]}}}",
    ),
    "cylinder": (
        "a pipe or a rail; inside: a bore",
        "object: {cylinder: {point: [0, 0, 0], axis: [0, 0, 1], radius: 0.05}}",
    ),
    "cone": (
        "a sharpened pencil; inside: a funnel",
        "object: {cone: {apex: [0, 0, 0], axis: [0, 0, 1], half_angle: 0.6, inside: true}}",
    ),
    "torus": (
        "a ring or a doughnut; inside: a curved tube",
        "object: {torus: {center: [0, 0, 0], axis: [0, 0, 1], circle_radius: 0.1, "
        "tube_radius: 0.02}}",
    ),
    "ellipsoid": (
        "an egg or a melon; inside: a dish",
        "object: {ellipsoid: {center: [0, 0, 0], semi_axes: [0.1, 0.07, 0.05]}}",
    ),
    "surface": (
        "any smooth shape of your own, a Python function: its signed distance or its "
        "parametrisation",
        'object: {surface: {distance: "shapes.py:bump"}}',
    ),
}
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
class Parameter:
    """A key that a scene may write: its default as it would be written, meaning and unit."""

    name: str
    default: str
    meaning: str
    unit: str


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


@dataclass(frozen=True)
class SurfaceCard:
    """One kind of surface for contacts: a picture, its parameters, and one side of a contact."""

    name: str
    picture: str
    parameters: list[Parameter]
    example: str


def joint_cards() -> dict[str, JointCard]:
    """A card for every kind of joint that a scene may name, in the schema's order."""
    return {kind: _joint_card(kind, model) for kind, model in joint_models().items()}


def surface_cards() -> dict[str, SurfaceCard]:
    """A card for every surface that may take part in a contact, in the schema's order."""
    cards = {}
    for name, field in Geometry.model_fields.items():
        picture, example = _SURFACES[name]
        models = [part for part in get_args(field.annotation) if hasattr(part, "model_fields")]
        parameters = [parameter for model in models for parameter in _parameters_of(model)]
        cards[name] = SurfaceCard(name, picture, parameters, example)
    return cards


def common_parameters() -> list[Parameter]:
    """The parameters that all kinds of joint share."""
    return _parameters_of(JointBase)


def contact_parameters() -> list[Parameter]:
    """The parameters of one entry of a joint's list of contacts."""
    return _parameters_of(ContactSpec)


def joint_models() -> dict[str, type[JointBase]]:
    """The models of all kinds of joint."""
    union, *_ = get_args(JointSpec)
    return {model.model_fields["kind"].default: model for model in get_args(union)}


def _joint_card(kind: str, model: type[JointBase]) -> JointCard:
    picture, rest = _JOINTS[kind]
    example = f"joints:\n  - arm: left\n    kind: {kind}{rest}"
    (entry,) = yaml.safe_load(example)["joints"]
    joint = model.model_validate(entry)
    on_object = joint.at_tip.matrix()  # the object's frame where the tip's is
    on_object[:3, 3] += on_object[:3, :3] @ surface_offset(joint)
    contacts = joint_contacts(joint, on_object)
    frame = joint_frame(joint, on_object)[1]
    rows = np.column_stack([_row(contact) for contact in contacts])  # (6, N)
    motions = free_motions(wrenches_in_frame(frame, rows))
    shared = JointBase.model_fields
    return JointCard(
        kind=kind,
        picture=picture,
        as_listed=kind in ("contacts", "wrenches"),
        rows=len(contacts),
        rank=motions.rank,
        free=motions.words(),
        made_of=_made_of(contacts),
        row_names=[contact.name for contact in contacts],
        parameters=[p for p in _parameters_of(model) if p.name not in shared],
        example=example,
    )


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
    """What distinguishes surfaces of one kind: of a plane its normal and height."""
    axis = guide.axes[:, 2]
    where = [axis @ guide.origin] if guide.kind == PLANE else guide.origin
    return tuple(np.round([*axis, *where], 9) + 0.0)


# --- parameters from the schema ------------------------------------------------------------------


def _parameters_of(model: Any) -> list[Parameter]:
    """The parameters of a part of a scene but its kind: its own, then those of its bases."""
    documented = _documented(model)
    own = inspect.get_annotations(model)
    found = []
    for name, field in sorted(model.model_fields.items(), key=lambda item: item[0] not in own):
        meaning, unit = _split(field.description or "")
        if not unit:
            meaning, unit = documented.get(name, (meaning, ""))
        if name != "kind":
            default = field.get_default(call_default_factory=True)
            written = "required" if field.is_required() else _written(default)
            found.append(Parameter(name, written, meaning, unit))
    return found


def _documented(model: Any) -> dict[str, tuple[str, str]]:
    """Meaning and unit of every attribute that a model or one of its bases documents."""
    found: dict[str, tuple[str, str]] = {}
    for base in reversed(model.__mro__):
        _, _, section = inspect.cleandoc(base.__doc__ or "").partition("Attributes\n----------\n")
        _, *entries = re.split(r"(?m)^(\w+(?:, \w+)*) : ", section)
        for names, text in zip(entries[::2], entries[1::2], strict=True):
            _, _, body = text.partition("\n")
            body = " ".join(body.split())
            # A unit within a text about several attributes need not be that of all.
            shared = "," in names and not body.startswith("[")
            for name in names.split(", "):
                found[name] = (body, "") if shared else _split(body)
    return found


def _split(text: str) -> tuple[str, str]:
    """Meaning and unit of a text with one unit in brackets; other texts stay as they are."""
    units = list(re.finditer(r"\s*\[(m|rad|N|N m)\]", text))
    if len(units) != 1:
        return text, ""
    (unit,) = units
    return (text[: unit.start()] + text[unit.end() :]).lstrip("; "), unit[1]


def _written(value: Any) -> str:
    """A value as a scene would write it."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return f"{value:g}"
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(_written(item) for item in value)}]"
    return "identity" if hasattr(value, "model_fields_set") else str(value)  # a pose, a word
