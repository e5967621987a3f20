"""From what a user writes to records: surfaces, patches and lists of contacts."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from multiarm.contacts import records
from multiarm.contacts.records import Contact, Patch, Surface
from multiarm.contacts.smooth import ParametricSurface, SignedDistanceSurface
from multiarm.errors import ModelError


def listed_contacts(joint) -> list[Contact]:
    """Contact records of a joint of kind ``contacts``, in the joint frame.

    Raises
    ------
    ModelError
        When a function of the user's cannot be found, or is not what it is said to be.
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


def load_function(given: Callable | str) -> Callable:
    """The function that a scene names as ``file.py:name`` or ``package.module:name``.

    Raises
    ------
    ModelError
        When there is no such file, module or name, or when loading it fails.
    """
    if not isinstance(given, str):
        return given
    place, _, name = given.rpartition(":")
    if name.startswith("<"):
        raise ModelError(
            f"the function {given!r} has no name by which it can be found again; give the function "
            "itself, or name one as 'file.py:name' or 'package.module:name'"
        )
    if place.endswith(".py") and not Path(place).is_file():
        raise ModelError(
            f"cannot load the function {given!r}: there is no file {place}; mend the path, which "
            "starts at the scene's folder"
        )
    try:
        module = _file_module(Path(place)) if place.endswith(".py") else _module(place)
    except Exception as error:
        raise ModelError(
            f"cannot load the function {given!r}: {type(error).__name__}: {error}; mend the module "
            "(functions are named 'file.py:name' or 'package.module:name')"
        ) from error
    found: object = module
    for part in name.split("."):
        if not hasattr(found, part):
            raise ModelError(f"there is no {name!r} in {place}; {_functions_in(module)}")
        found = getattr(found, part)
    if not callable(found):
        raise ModelError(f"{name!r} in {place} is not a function; {_functions_in(module)}")
    return found


def _ellipsoid(g) -> Surface:
    return records.ellipsoid(g.center, g.orientation().rotation(), g.semi_axes, g.inside)


def _smooth(g) -> Surface:
    shape: SignedDistanceSurface | ParametricSurface
    given = g.parametrisation if g.distance is None else g.distance
    function = load_function(given)
    name = f"the surface {given!r}" if isinstance(given, str) else None
    if g.distance is not None:
        gradient, hessian = _loaded(g.gradient), _loaded(g.hessian)
        shape = SignedDistanceSurface(function, gradient, hessian, g.length, name)
    else:
        derivatives = _loaded(g.derivatives)
        shape = ParametricSurface(function, g.u, g.v, derivatives, g.flip, g.length, name)
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


def _loaded(given: Callable | str | None) -> Callable | None:
    return None if given is None else load_function(given)


def _module(name: str) -> ModuleType:
    return importlib.import_module(name)


_LOADED = itertools.count()


def _file_module(path: Path) -> ModuleType:
    """Run a file as a module, anew each time; it is not left among the imported ones."""
    name = f"surfaces_of_{path.stem}_{next(_LOADED)}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None, "a name that ends in .py has a loader"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # data classes look for their module while it is run
    try:
        spec.loader.exec_module(module)
    finally:
        sys.modules.pop(name, None)
    return module


def _functions_in(module: ModuleType) -> str:
    names = [n for n, value in vars(module).items() if callable(value) and not n.startswith("_")]
    return (
        f"its functions are {', '.join(map(repr, names[:8]))}" if names else "it has no functions"
    )
