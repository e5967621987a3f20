"""From what a user writes to records: surfaces, patches and lists of contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from multiarm.contacts import records
from multiarm.contacts.records import Contact, Patch, Surface
from multiarm.contacts.smooth import ParametricSurface, SignedDistanceSurface


def listed_contacts(joint) -> list[Contact]:
    """Contact records of a joint of kind ``contacts``, in the joint frame.

    Functions of surfaces have been loaded already.

    Raises
    ------
    ModelError
        When a function of the user's is not what it is said to be.
    """
    contacts = []
    for k, spec in enumerate(joint.contacts):
        name = spec.name or f"contact {k + 1}"
        normal = Contact(name, surface(spec.arm), surface(spec.object), pushes_only=True)
        contacts.append(normal)
        for tangent in (1, 2) if spec.rolling else ():
            row = f"{name}, no slip {tangent}"
            contacts.append(replace(normal, name=row, tangent=tangent, pushes_only=False))
    return contacts


def surface(geometry) -> Surface:
    """The surface that a :class:`multiarm.scene.Geometry` describes, in the joint frame."""
    found = _SURFACES[geometry.shape](geometry.value)
    patch = None if geometry.shape == "point" else geometry.value.patch
    if patch is None:
        return found
    lower = [-np.inf if bound is None else bound for bound in patch.min]
    upper = [np.inf if bound is None else bound for bound in patch.max]
    return replace(found, patch=Patch(np.array(lower), np.array(upper)))


def _ellipsoid(g) -> Surface:
    return records.ellipsoid(g.center, g.orientation().rotation(), g.semi_axes, g.inside)


def _smooth(g) -> Surface:
    shape: SignedDistanceSurface | ParametricSurface
    if g.distance is not None:
        shape = SignedDistanceSurface(g.distance, g.gradient, g.hessian, g.length)
    else:
        shape = ParametricSurface(g.parametrisation, g.u, g.v, g.derivatives, g.flip, g.length)
    return records.smooth(shape, g.origin, g.orientation().rotation(), g.inside)


_SURFACES: dict[str, Callable[..., Surface]] = {
    "point": records.point,
    "sphere": lambda g: records.sphere(g.center, g.radius, g.inside),
    "plane": lambda g: records.plane(g.point, g.normal),
    "cylinder": lambda g: records.cylinder(g.point, g.axis, g.radius, g.inside),
    "cone": lambda g: records.cone(g.apex, g.axis, g.half_angle, g.inside),
    "torus": lambda g: records.torus(g.center, g.axis, g.circle_radius, g.tube_radius, g.inside),
    "ellipsoid": _ellipsoid,
    "surface": _smooth,
}
