r"""The best grasp of a polyhedron by two small grippers, and how much better any other could be.

Seven fingertips, four on one gripper and three on the other as a rule, each gripper within reach of
a corner of the body, from one side. The objective is the margin (thesis, 5.1): the smallest
coefficient t* of the balance with sum 1, at most 1/7.

**How.** All choices of faces are listed (:mod:`multiarm.grasp.optimisation.placements`) and
searched (:mod:`multiarm.grasp.optimisation.face_search`): evolution yields good placements, at the
start and from what linear programs propose, one choice of faces after the other. No placement on
those faces has a larger margin than its program, which is without loss. The choice with the highest
bound comes next. So at any time

.. math:: \text{value} \le \text{optimum} \le \text{bound} .

The search ends when they are within ``gap``, when no other choice can be better, or when its budget
of choices is used up; then the gap is larger. Of bodies with many faces and corners there may be
too many choices to bound them all, which is refused.

The margin alone says nothing about leverage: contacts can share the load evenly and yet hardly
resist a rotation. So there is a floor on the conditioning of the scaled wrenches, and among
placements whose margin is good enough the best conditioned is taken.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.arguments import generator_of, number_of, numbers_of
from multiarm.grasp.body.body_class import as_polyhedron
from multiarm.grasp.body.face import across, frame_of
from multiarm.grasp.closure.form_closure import is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.face_contacts import Gripper
from multiarm.grasp.grasp import Grasp
from multiarm.grasp.optimisation.face_search import Limits, Search
from multiarm.grasp.optimisation.placements import face_choices, touch_regions
from multiarm.terminal.progress import Progress, displayed

if TYPE_CHECKING:
    from multiarm.grasp.body.polyhedron import Polyhedron

# Choices of faces that are bounded before the search gives up, by default.
NODES = 300
# Smallest over largest singular value of the scaled wrenches, at least, by default; small grippers
# on a large body have about their size over that of the body, so this part of it at most.
CONDITIONING, CONDITIONING_OF_SIZE = 1e-3, 1e-2
# Contacts of the two grippers.
SPLITS = [[count, 7 - count] for count in range(1, 7)]
# Of gaps.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class OptimisedGrasp:
    """The best grasp found, and the proven bound of all others.

    Attributes
    ----------
    grasp : Grasp
    value : float
        The margin.
    bound : float
        No grasp of this kind has a larger margin.
    gap : float
        How much of the bound the value falls short: ``1 - value / bound``.
    finished : bool
        Whether the requested gap was reached.
    conditioning : float
        Smallest over largest singular value of the grasp's scaled wrenches.
    choices : int
        Choices of faces that can close.
    nodes : int
        Choices of faces that were bounded.
    seconds : float
    message : str
    """

    grasp: Grasp
    value: float
    bound: float
    gap: float
    finished: bool
    conditioning: float
    choices: int
    nodes: int
    seconds: float
    message: str


def optimise_grasp(
    body: Polyhedron,
    *,
    gripper_size: float,
    fingers: tuple[int, int] = (4, 3),
    places: Any = None,
    faces: Iterable[int] | dict[int, Any] | None = None,
    tip_radius: float = 0.0,
    spacing: float | None = None,
    conditioning: float | None = None,
    gap: float = 0.05,
    nodes: int = NODES,
    seconds: float | None = None,
    progress: bool | Callable[[int, int, str], None] | None = None,
    rng: np.random.Generator | int | None = 0,
) -> OptimisedGrasp:
    """Search the placements of seven contacts on a polyhedron for the largest margin.

    Parameters
    ----------
    body : Polyhedron
    gripper_size : float
        All contacts of a gripper are within this distance of its place [m].
    fingers : tuple of int
        Contacts of the two grippers; together seven.
    places : array-like, shape (M, 3), optional
        Where a gripper may sit, in the body's frame [m]; by default the corners of the body.
    faces : iterable of int, or dict, optional
        Faces that may be touched, by default all; a dict also says where: the corners (K, 3) of a
        polygon in the face, or None for all of it.
    tip_radius : float
        Of a fingertip: contacts keep this distance from the edges of their faces [m].
    spacing : float, optional
        Contacts keep this distance from each other [m]; by default twice ``tip_radius``.
    conditioning : float, optional
        Floor of the smallest over the largest singular value of the scaled wrenches; by default
        1e-3, or a hundredth of ``gripper_size`` over the size of the body if that is less.
    gap : float
        The search ends when this is reached.
    nodes : int
        It also ends after this number of choices of faces.
    seconds : float, optional
        And after this time; results then depend on the machine.
    progress : bool or callable, optional
        True: a bar on the terminal, elsewhere a line on stderr every few seconds.  A function is
        called as ``progress(done, total, words)``, in nodes.
    rng : Generator or int
        The same seed gives the same result.

    Returns
    -------
    OptimisedGrasp

    Raises
    ------
    GraspError
        Unusable limits; no two places from which seven contacts can close, or too many choices of
        faces from which they may; no grasp found.
    """
    started = time.perf_counter()
    body = as_polyhedron(body)
    _check_fingers(fingers)
    _check_numbers(
        {"gripper_size": gripper_size, "gap": gap, "nodes": nodes, "tip_radius": tip_radius},
        {"spacing": spacing, "conditioning": conditioning, "seconds": seconds},
    )
    needed = "places have shape (M, 3), two at least, and are finite"
    where = body.vertices if places is None else numbers_of(places, needed, (-2, 3))
    size, middle = body.size, np.asarray(body.centre, dtype=float)
    if conditioning is None:
        conditioning = min(CONDITIONING, CONDITIONING_OF_SIZE * gripper_size / size)
    regions = touch_regions(body, where, gripper_size, clearance=tip_radius, faces=faces)
    limits = Limits(
        spacing=(2.0 * tip_radius if spacing is None else spacing) / size,
        conditioning=conditioning,
        gap=gap,
        nodes=nodes,
        until=None if seconds is None else started + seconds,
    )
    generator = generator_of(rng, "rng")
    with displayed(progress, Progress) as show:
        choices = face_choices(regions, fingers)
        if not len(choices):
            raise GraspError(
                "no two places from which seven contacts can close: the normals within reach do "
                "not span space, or no hand reaches them from one side; take larger grippers, "
                "other places or more faces"
            )
        search = Search(choices, limits, middle, size, generator, show)
        search.run()
    grasp, conditioned = _grasp(body, search, where, fingers)
    return OptimisedGrasp(
        grasp=grasp,
        value=search.value,
        bound=search.bound,
        gap=search.gap,
        finished=search.gap <= gap + ROUNDING,
        conditioning=conditioned,
        choices=len(choices),
        nodes=search.done,
        seconds=time.perf_counter() - started,
        message=_message(search, gap),
    )


def _check_fingers(fingers: Any) -> None:
    if list(fingers if isinstance(fingers, tuple | list) else ()) not in SPLITS:
        raise GraspError(f"two grippers carry seven contacts together, not {fingers!r}")


def _check_numbers(required: dict[str, Any], chosen: dict[str, Any]) -> None:
    """Finite numbers that are not negative; ``chosen`` ones may be left out."""
    numbers = {**required, **{name: value for name, value in chosen.items() if value is not None}}
    for name, value in numbers.items():
        number_of(value, f"{name} is a finite number and not negative", at_least=0.0)
    number_of(required["gripper_size"], "gripper_size is a length", above=0.0)
    if not 0.0 < required["gap"] < 1.0 or required["nodes"] < 1:
        raise GraspError(
            f"gap lies between 0 and 1, nodes is positive; given: {required['gap']}, "
            f"{required['nodes']}"
        )


def _grasp(
    body: Polyhedron, search: Search, where: np.ndarray, fingers: tuple[int, int]
) -> tuple[Grasp, float]:
    """The grasp with its grippers, and its conditioning."""
    assert search.best is not None
    touches, y = search.best
    points = touches.points(y) * search.size + search.middle
    numbers = (tuple(range(fingers[0])), tuple(range(fingers[0], 7)))
    names = [f"gripper {g + 1} tip {k + 1}" for g in range(2) for k in range(fingers[g])]
    contacts = Contacts(points, touches.normals, names)
    grippers = []
    for g, carried in enumerate(numbers):
        place = where[touches.regions[carried[0]].place]
        inward = touches.normals[list(carried)].mean(axis=0)
        grippers.append(Gripper(f"gripper {g + 1}", carried, _frame(place, inward)))
    closure = is_form_closure(contacts)
    grasp = Grasp(body, contacts, tuple(region.face for region in touches.regions), tuple(grippers))
    return grasp, closure.conditioning


def _frame(place: np.ndarray, inward: np.ndarray) -> np.ndarray:
    """A frame at a place with its z axis into the body."""
    z = inward / np.linalg.norm(inward) if np.linalg.norm(inward) > 1e-9 else np.eye(3)[2]
    return frame_of(z, across(z), place)


def _message(search: Search, gap: float) -> str:
    text = (
        f"margin {search.value:.4g}, at most {search.bound:.4g} is possible: within "
        f"{100 * search.gap:.1f} per cent, after {search.done} nodes over {len(search.choices)} "
        f"choices of faces"
    )
    if search.gap > gap + ROUNDING and search.settled:
        text += "; no sharper bound is known"
    elif search.gap > gap + ROUNDING:
        text += "; the budget ended before the gap was reached, more nodes narrow it"
    return text
