r"""A grasp for a given body: the construction that fits its class, or a search.

===============================  ==============================  ==========================
body                             construction                    source
===============================  ==============================  ==========================
block                            `design_block_grasp`            thesis, 2.2.3.1
three pairs of parallel faces    `design_parallel_grasp`         2.2.3.2, Example 2.3
wider class                      `design_wide_grasp`             2.2.3.3
others, such as a tetrahedron    `search_grasp`                  2.2.2, region by region
===============================  ==============================  ==========================

A body of revolution is refused: no frictionless contacts hold it.  So is a mesh of such a body,
although its facets would give the contacts a little lever.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.body.body_class import BodyClass, as_polyhedron, classify, roundness
from multiarm.grasp.body.polyhedron import Polyhedron
from multiarm.grasp.designs.assembling import (
    largest_gripper,
    size_of_gripper,
    sized,
)
from multiarm.grasp.designs.blocks import design_block_grasp, usual_offset
from multiarm.grasp.designs.drawn_contacts import search_grasp
from multiarm.grasp.designs.parallel_bodies import design_parallel_grasp
from multiarm.grasp.designs.wide_bodies import design_wide_grasp
from multiarm.grasp.grasp import Grasp


def design_grasp(
    body: Polyhedron,
    *,
    gripper_size: float | None = None,
    offset: float | None = None,
    seventh: float | None = None,
    generator: np.random.Generator | None = None,
    progress: bool | Callable[[int, int, str], None] | None = None,
) -> Grasp:
    """A form-closure grasp of a polyhedron by two grippers, without friction.

    Parameters
    ----------
    body : Polyhedron
        Of any size and anywhere.
    gripper_size : float, optional
        Largest distance between two contacts of one gripper [m]; the constructions give grippers
        of this size, a search gives smaller ones or none.
    offset, seventh : float, optional
        A and E of the construction for blocks [m] (see `design_block_grasp`).
    generator : numpy.random.Generator, optional
        For the search, where one is needed.
    progress : bool or callable, optional
        Of the wider class, as in `design_wide_grasp`.

    Returns
    -------
    Grasp
        Seven contacts.  It is form-closed, and it opens where its last contact comes nearer than
        the bound in its notes.

    Raises
    ------
    GraspError
        A body of revolution; grippers that are too large for the body; offsets for a body that is
        no block; no grasp found.
    """
    body, gripper_size = as_polyhedron(body), size_of_gripper(gripper_size)
    nearly_round = _refuse_round(body)
    body_class = classify(body)
    if body_class.kind == "block":
        grasp = _block_grasp(body, body_class.pairs, gripper_size, offset, seventh)
    elif offset is not None or seventh is not None:
        raise GraspError(
            f"offset and seventh are lengths of the construction for blocks; this body is "
            f"{body_class.words}.  Give gripper_size, or nothing"
        )
    elif body_class.kind == "three pairs of parallel faces":
        grasp = design_parallel_grasp(body, gripper_size=gripper_size)
    else:
        grasp = _general_grasp(body, body_class, gripper_size, generator, progress)
    return grasp.noted(*nearly_round, f"the body is {body_class.words}")


def _refuse_round(body: Polyhedron) -> tuple[str, ...]:
    """Refuse a body of revolution; return a remark on one that may approximate such a body."""
    revolution = roundness(body)
    axis = ", ".join(f"{x:.3g}" for x in np.round(revolution.axis, 3) + 0.0)
    if revolution:
        raise GraspError(
            f"the body is one of revolution about the axis ({axis}) through its centre, or a mesh "
            f"of one: all normal lines pass within {revolution.distance:.3g} m of the axis, so "
            f"that no frictionless contact keeps it from turning; give it a flat, a groove or a key"
        )
    if not revolution.nearly:
        return ()
    return (
        f"the body is nearly one of revolution about the axis ({axis}): contacts have levers of "
        f"{revolution.distance:.3g} m at most; if it is a mesh of a round body, nothing holds that",
    )


def _block_grasp(
    body: Polyhedron,
    pairs: tuple[tuple[int, int], ...],
    gripper_size: float | None,
    offset: float | None,
    seventh: float | None,
) -> Grasp:
    if gripper_size is None or offset is not None:
        if gripper_size is not None:
            raise GraspError("give the size of the grippers or the offset, not both")
        return design_block_grasp(body, offset=offset, seventh=seventh)

    def with_offset(A: float) -> Grasp:
        return design_block_grasp(body, offset=A, seventh=seventh)

    return sized(with_offset, usual_offset(body, pairs), gripper_size)


def _general_grasp(
    body: Polyhedron,
    body_class: BodyClass,
    gripper_size: float | None,
    generator: np.random.Generator | None,
    progress: bool | Callable[[int, int, str], None] | None,
) -> Grasp:
    """The wider class when it can be, and a search otherwise."""
    if body_class.triples:
        try:
            return design_wide_grasp(body, gripper_size=gripper_size, progress=progress)
        except GraspError:
            pass  # the search may still find one; its notes say that it was a search
    grasp = search_grasp(body, generator)
    if gripper_size is not None and largest_gripper(grasp) > gripper_size:
        raise GraspError(
            f"the smallest grippers found for this body are {largest_gripper(grasp):.4g} m, not "
            f"{gripper_size:g} m; it is {body_class.words}, and small grippers need two corners "
            f"whose faces oppose each other"
        )
    return grasp
