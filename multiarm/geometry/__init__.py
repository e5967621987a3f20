"""Contacts between surfaces, as plain data: what joints and surfaces of one's own return.

A joint returns a list of :class:`Contact`, each with two surfaces, one of the arm and one of the
object, that touch in a point.  The functions :func:`point` to :func:`ellipsoid` make surfaces;
:func:`smooth` makes one from a :class:`SignedDistanceSurface` or a :class:`ParametricSurface`.
"""

from multiarm.geometry.records import (
    Contact,
    Patch,
    Surface,
    basis,
    cone,
    cylinder,
    ellipsoid,
    plane,
    point,
    smooth,
    sphere,
    torus,
)
from multiarm.geometry.smooth_surfaces import ParametricSurface, SignedDistanceSurface

__all__ = [
    "Contact",
    "ParametricSurface",
    "Patch",
    "SignedDistanceSurface",
    "Surface",
    "basis",
    "cone",
    "cylinder",
    "ellipsoid",
    "plane",
    "point",
    "smooth",
    "sphere",
    "torus",
]
