"""What timed joints do between two switches of a run, as its variational equation sees it."""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.sensitivity import Motions
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.events.taking_hold import HeldJoints


class Phase:
    """What timed joints do between two switches, first from the start of a run on.

    Attributes
    ----------
    time : float
        Of the switch at its beginning [s].
    size : int
        How many coordinates the places of joints have.
    joints : frozenset of int or None
        Timed joints that hold; None: the system has none.
    """

    time, size = -math.inf, 0

    def __init__(self, joints: frozenset[int] | None) -> None:
        self.joints = joints

    def held(self, system: System, places: np.ndarray | None = None) -> HeldJoints | None:
        """What timed joints hold in a system, itself or with another number, in a nearby motion.

        ``places`` (size,) says which one; None: the run's.
        """
        return None if self.joints is None else HeldJoints(self.joints, {})

    def responses(
        self, t: float, state: State, motions: Motions, A: np.ndarray, roundings: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """By the coordinates of places: of the rate at a state, and of it as it follows the joints.

        Shapes (D, r); ``A`` are the rate's derivatives by the state, gaps that are ``roundings``
        [m] do not count.
        """
        nothing = np.zeros((2 * state.layout.nv, 0))
        return nothing, nothing
