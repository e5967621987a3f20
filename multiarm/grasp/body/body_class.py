r"""Which construction of a grasp a body admits: the classes of chapter 2 of the thesis.

- **block**: three pairs of parallel faces, perpendicular to each other (2.2.3.1);
- **three pairs of parallel faces**: a parallelepiped (2.2.3.2);
- **wider class** (2.2.3.3): three faces with independent normals and at least two more faces whose
  normals are combinations of the three with no positive coefficient,

  .. math::  n_l = \sum_{k=1}^{3} \kappa_k n_k, \qquad \kappa_k \le 0 .

  Every convex polyhedron with more than four faces has such a triple (A.7), every block too.
- **tetrahedron**: four faces; each normal is a negative combination of the other three, so that
  there is one such face and not two.

A mesh with many facets around an axis stands for a body of revolution.  No frictionless contact
keeps such a body from turning about its axis: every normal line meets the axis.  On the mesh a
contact still has a lever, half a facet wide, but the body that the mesh stands for has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.polyhedron import Polyhedron

Kind = Literal["block", "three pairs of parallel faces", "wider class", "tetrahedron", "none"]

# Faces are parallel or perpendicular within this angle [rad], and by what rounding tilts them.
PARALLEL = 1e-6
# Normals with a smaller determinant are dependent, coefficients below it are zero.
DEPENDENT = 1e-6
# Only so many of the largest faces are searched for triples: their number grows with its cube.
MOST_FACES = 40
# A body whose normal lines all pass its axis within this part of its radius counts as one of
# revolution, such as a prism of 32 sides; within the second number, 16 sides, it may be one.
ROUND, NEARLY_ROUND = 0.1, 0.2
# A face whose normal is along the axis, within this angle [rad], has no part in that.
LEVEL = 1e-3


@dataclass(frozen=True)
class Triple:
    """Three faces with independent normals, and those that their normals oppose.

    Attributes
    ----------
    faces : tuple of int
        The three.
    opposed : tuple of int
        Faces whose normals are combinations of the three with no positive coefficient.
    """

    faces: tuple[int, int, int]
    opposed: tuple[int, ...]


@dataclass(frozen=True)
class BodyClass:
    """To which class a body belongs, and by which faces.

    Attributes
    ----------
    kind : str
        ``"block"``, ``"three pairs of parallel faces"``, ``"wider class"``, ``"tetrahedron"`` or
        ``"none"``.
    pairs : tuple of (int, int)
        Parallel faces that look in opposite directions.
    triples : tuple of Triple
        All triples that oppose at least two faces.
    words : str
        The verdict with its reason in a sentence or two.
    """

    kind: Kind
    pairs: tuple[tuple[int, int], ...]
    triples: tuple[Triple, ...]
    words: str

    def __str__(self) -> str:
        return self.words


def as_polyhedron(body: Any) -> Polyhedron:
    """The body, if it is one; a GraspError otherwise."""
    if not isinstance(body, Polyhedron):
        raise GraspError(
            f"a Polyhedron is needed, not {type(body).__name__}; make one with Polyhedron.box, "
            f".prism, .hull or .mesh"
        )
    return body


def classify(body: Polyhedron) -> BodyClass:
    """To which class of the thesis a body belongs, and by which faces."""
    chosen = _largest(as_polyhedron(body))
    tilts = np.array([face.tilt for face in body.faces])
    pairs = tuple(
        (i, j)
        for i, j in combinations(chosen, 2)
        if np.linalg.norm(body.normals[i] + body.normals[j]) <= PARALLEL + tilts[i] + tilts[j]
    )
    triples = _triples(body.normals, tilts, chosen)
    kind = _kind(body, pairs, triples)
    left_out = len(body.faces) - len(chosen)
    words = _words(body, kind, pairs, triples)
    if left_out:
        words += f" (its {left_out} smallest faces were not looked at)"
    return BodyClass(kind, pairs, triples, words)


@dataclass(frozen=True)
class Roundness:
    """How nearly a body is one of revolution; true when it is.

    Attributes
    ----------
    axis : ndarray, shape (3,)
        Direction of the axis, through the centre of mass.
    distance : float
        Largest distance at which the normal line of a contact passes the axis [m].
    radius : float
        Largest distance of the body from the axis [m].
    """

    axis: np.ndarray
    distance: float
    radius: float

    def __bool__(self) -> bool:
        return self.distance < ROUND * self.radius

    @property
    def nearly(self) -> bool:
        """Whether the body may stand for one of revolution."""
        return self.distance < NEARLY_ROUND * self.radius


def roundness(body: Polyhedron) -> Roundness:
    r"""The axis that normal lines pass most closely.

    The axis of a body of revolution is a principal axis of inertia through the centre of mass, so
    that only those are looked at.  The distance of normal lines from it is convex on a face and
    therefore largest at a corner,

    .. math::  |a \cdot (p \times n)| \, / \, |a \times n| .
    """
    axes = np.linalg.eigh(as_polyhedron(body).mass_properties(1.0).inertia)[1].T
    candidates = [_roundness(body, axis) for axis in axes]
    return min(candidates, key=lambda candidate: candidate.distance / candidate.radius)


def _roundness(body: Polyhedron, axis: np.ndarray) -> Roundness:
    distance = 0.0
    for face in body.faces:
        across = float(np.linalg.norm(np.cross(axis, face.normal)))
        if across > LEVEL:
            moments = np.cross(face.vertices - body.centre, face.normal) @ axis
            distance = max(distance, float(np.abs(moments).max()) / across)
    about = body.vertices - body.centre
    radius = float(np.linalg.norm(about - np.outer(about @ axis, axis), axis=1).max())
    return Roundness(axis, distance, radius)


def _largest(body: Polyhedron) -> list[int]:
    """Numbers of the largest faces, in their order."""
    areas = np.array([face.area for face in body.faces])
    return sorted(np.argsort(-areas, kind="stable")[:MOST_FACES].tolist())


def _triples(normals: np.ndarray, tilts: np.ndarray, chosen: list[int]) -> tuple[Triple, ...]:
    triples = []
    for three in combinations(chosen, 3):
        N, turned = normals[list(three)].T, tilts[list(three)]
        if abs(np.linalg.det(N)) <= DEPENDENT + turned.sum():
            continue
        inverse = np.linalg.inv(N)
        kappa = inverse @ normals[chosen].T  # (3, F)
        zero = np.linalg.norm(inverse, axis=1)[:, None] * (tilts[chosen] + turned @ np.abs(kappa))
        against = np.all(kappa <= DEPENDENT + zero, axis=0)
        opposed = [m for m, is_opposed in zip(chosen, against, strict=True) if is_opposed]
        if len(opposed) >= 2:
            triples.append(Triple(three, tuple(opposed)))
    return tuple(triples)


def _kind(
    body: Polyhedron, pairs: tuple[tuple[int, int], ...], triples: tuple[Triple, ...]
) -> Kind:
    if len(body.faces) == 6 and len(pairs) == 3 and body.convex:
        square = all(
            abs(body.normals[i] @ body.normals[j])
            <= PARALLEL + body.faces[i].tilt + body.faces[j].tilt
            for i, j in combinations([i for i, _ in pairs], 2)
        )
        return "block" if square else "three pairs of parallel faces"
    if triples:
        return "wider class"
    return "tetrahedron" if len(body.faces) == 4 else "none"


def _words(
    body: Polyhedron,
    kind: Kind,
    pairs: tuple[tuple[int, int], ...],
    triples: tuple[Triple, ...],
) -> str:
    names = body.names
    listed = ", ".join(f"{names[i]} and {names[j]}" for i, j in pairs)
    if kind == "block":
        return f"a block: {listed} are parallel, and the pairs are perpendicular to each other"
    if kind == "three pairs of parallel faces":
        return f"three pairs of parallel faces: {listed}"
    if kind == "wider class":
        first = triples[0]
        three = ", ".join(names[k] for k in first.faces)
        opposed = " and ".join(names[k] for k in first.opposed)
        return (
            f"of the wider class: the normals of {opposed} are combinations of those of {three} "
            f"with no positive coefficient ({len(triples)} such triples)"
        )
    if kind == "tetrahedron":
        return (
            "a tetrahedron: each normal is a negative combination of the other three, so that "
            "three faces oppose one face only, and the constructions need two"
        )
    return "of no class: no three faces with independent normals oppose two others"
