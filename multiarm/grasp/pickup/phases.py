r"""The phases of a pick-up: which contacts, which edge, how far to tilt, and what presses when.

=============  ==================================================  ==========================
phase          contacts that press                                 the floor
=============  ==================================================  ==========================
``grip``       those of the hands on faces that are free           at all corners
``tilt``       the same                                            at the edge: it pivots
``take hold``  all seven, also those on the face that is freed     at the edge
``lift``       all seven                                           has let go
=============  ==================================================  ==========================

In every phase the forces of least norm, each a part of the weight at least, carry the weight
(:mod:`multiarm.grasp.pickup.tilting`).  The body is tilted so far that the lowest of the late
contacts, at the distance d from the edge, has the height that a finger needs,
:math:`\sin\theta = f / d`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiarm.errors import GraspError
from multiarm.grasp.closure.form_closure import FormClosure, is_form_closure
from multiarm.grasp.contacts import Contacts
from multiarm.grasp.pickup.lying_body import PivotEdge
from multiarm.notation import count_of

GRIP, TILT, TAKE_HOLD, LIFT = "grip", "tilt", "take hold", "lift"


@dataclass(frozen=True, eq=False)
class PickupPhase:
    """A part of a pick-up in which the same contacts press.

    Attributes
    ----------
    name : str
        ``grip``, ``tilt``, ``take hold`` or ``lift``.
    contacts : tuple of int
        Those of the grasp that press.
    floor : tuple of int
        Vertices of the body at which the floor presses.
    angles : ndarray, shape (K,)
        Of the tilt [rad].
    forces : ndarray, shape (K, N)
        At these angles: of the contacts, then of the floor, over the weight; of least norm.
    pushes : Contacts
        All of them at the last angle, in the body's frame.
    """

    name: str
    contacts: tuple[int, ...]
    floor: tuple[int, ...]
    angles: np.ndarray
    forces: np.ndarray
    pushes: Contacts

    @cached_property
    def closure(self) -> FormClosure:
        """Whether hands and floor hold the body against every motion, the floor as a third hand.

        Where not, the weight presses the body into the contacts all the same: every force that
        carries it is positive.
        """
        return is_form_closure(self.pushes)

    @property
    def largest(self) -> float:
        """The largest force of a hand's contact, over the weight."""
        return float(self.forces[:, : len(self.contacts)].max())

    def __str__(self) -> str:
        held = "form closure" if self.closure else "held by its weight"
        return (
            f"{self.name}: {count_of(len(self.contacts), 'contact')} of the hands, "
            f"{len(self.floor)} of the floor, {held}; hands press with {self.largest:.2f} weights "
            "at most"
        )


@dataclass(frozen=True, eq=False)
class PickupRefusal:
    """Why a body is not picked up in one way.

    Attributes
    ----------
    edge : PivotEdge or None
        About which it would be tilted; None: without tilting.
    reason : str
    motion : ndarray, shape (6,), or None
        Where it is proven that no contacts on the free faces would do, the proof: a twist [linear;
        angular] in the body's frame.  It lifts the weight, and no push does work in it; or, where
        contacts do not close the body, none of them opposes it.
    """

    edge: PivotEdge | None
    reason: str
    motion: np.ndarray | None = None

    def __str__(self) -> str:
        about = "without tilting" if self.edge is None else f"about {self.edge.name}"
        return f"{about}: {self.reason}"


class PickupError(GraspError):
    """No way was found to pick a body up, or there is none.

    Attributes
    ----------
    refusals : tuple of PickupRefusal
        One without tilting, and one for each edge.
    """

    def __init__(self, message: str, refusals: Sequence[PickupRefusal] = ()) -> None:
        super().__init__(message)
        self.refusals = tuple(refusals)
