"""Contacts while both bodies' frames coincide: their wrenches, and what they are in words."""

from __future__ import annotations

from collections import Counter

import numpy as np

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

_NOUNS = {
    PLANE: "plane",
    SPHERE: "sphere",
    CYLINDER: "cylinder",
    CONE: "cone",
    TORUS: "torus",
    ELLIPSOID: "ellipsoid",
    SMOOTH: "surface",
}


def wrench_row(contact: Contact) -> np.ndarray:
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


def made_of(contacts: list[Contact]) -> str:
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
