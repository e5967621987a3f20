"""Bodies as written on a command line: ``box:1.2,0.8,0.6``, ``prism:6,0.3,0.8``, mesh files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from multiarm.errors import MultiarmError

if TYPE_CHECKING:
    from multiarm.grasp.polyhedron import Polyhedron

__all__ = ["FORMS", "body_of_text"]

# Kind -> (how it is written, with how many numbers at least and at most).
FORMS: dict[str, tuple[str, int, int]] = {
    "box": ("box:LX,LY,LZ", 3, 3),
    "wedge": ("wedge:LX,LY,LZ[,TOP]", 3, 4),
    "prism": ("prism:SIDES,RADIUS,HEIGHT", 3, 3),
    "pyramid": ("pyramid:SIDES,RADIUS,HEIGHT", 3, 3),
}
MESHES = (".stl", ".obj")
MOST_SIDES = 1000


def body_of_text(text: str, scale: float = 1.0) -> Polyhedron:
    """The body that a text stands for: numbers in metres, or a mesh file times ``scale``.

    Raises
    ------
    MultiarmError
        A text that stands for nothing, with the forms that do.
    GraspError
        Numbers of which no body can be made; a mesh that is no closed body.
    """
    if Path(text).suffix.lower() in MESHES:
        from multiarm.grasp.polyhedron import Polyhedron

        return Polyhedron.mesh(Path(text).expanduser(), scale)
    kind, _, numbers = text.partition(":")
    if kind not in FORMS:
        raise _unknown(text)
    _, least, most = FORMS[kind]
    try:
        values = [float(number) for number in numbers.split(",")]
    except ValueError:
        raise _unknown(text) from None
    if not least <= len(values) <= most or not all(map(math.isfinite, values)):
        raise _unknown(text)
    return _BUILDERS[kind](values)


def _unknown(text: str) -> MultiarmError:
    forms = ", ".join(form for form, *_ in FORMS.values())
    return MultiarmError(
        f"'{text}' is no body; write {forms} (lengths in metres), or name an STL or OBJ file"
    )


def _box(values: list[float]) -> Polyhedron:
    from multiarm.grasp.polyhedron import Polyhedron

    return Polyhedron.box(values)


def _wedge(values: list[float]) -> Polyhedron:
    from multiarm.grasp.polyhedron import Polyhedron

    return Polyhedron.wedge(values[:3], *values[3:])


def _prism(values: list[float]) -> Polyhedron:
    from multiarm.grasp.polyhedron import Polyhedron

    return Polyhedron.prism(_regular(values[0], values[1]), values[2])


def _pyramid(values: list[float]) -> Polyhedron:
    from multiarm.grasp.polyhedron import Polyhedron

    return Polyhedron.pyramid(_regular(values[0], values[1]), [0.0, 0.0, values[2]])


def _regular(sides: float, radius: float) -> list[list[float]]:
    """Corners of a regular polygon."""
    if sides != int(sides) or not 3 <= sides <= MOST_SIDES:
        raise MultiarmError(f"a polygon has 3 to {MOST_SIDES} sides, not {sides:g}")
    if radius <= 0.0:
        raise MultiarmError(f"the radius of a polygon is greater than 0, not {radius:g}")
    turns = [2.0 * math.pi * k / int(sides) for k in range(int(sides))]
    return [[radius * math.cos(turn), radius * math.sin(turn)] for turn in turns]


_BUILDERS: dict[str, Callable[[list[float]], Polyhedron]] = {
    "box": _box,
    "wedge": _wedge,
    "prism": _prism,
    "pyramid": _pyramid,
}
