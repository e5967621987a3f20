"""What a solver finds out about a system, beside accelerations and contact forces.

Every solver writes the whole :class:`Solution`, by :func:`write_solution`: the elimination of whole
blocks (:mod:`multiarm.dynamics.solver.batched`), of some blocks by directions
(:mod:`multiarm.dynamics.solver.singular`), with friction
(:mod:`multiarm.dynamics.solver.reactions`), and the dense reference
(:mod:`multiarm.dynamics.solver.dense`).  So nobody who reads it needs to know which solver it was.
"""

from __future__ import annotations

import math
from enum import IntEnum

from multiarm.jit.kernels import plain
from multiarm.jit.structs import Flag, Float, Int, Numbers


class Elimination(IntEnum):
    """How the contact forces were eliminated, and so whose arrays have the factors."""

    WHOLE = 0  # every block as a whole
    SPLIT = 1  # deficient blocks by directions
    FRICTION = 2  # with reaction matrices
    DENSE = 3  # not at all


# Numba reads them as constants.
WHOLE = int(Elimination.WHOLE)
SPLIT = int(Elimination.SPLIT)
FRICTION = int(Elimination.FRICTION)
DENSE = int(Elimination.DENSE)


class Solution(Numbers):
    """Of the system that was solved last: an evaluation, a projection, an impulse."""

    elimination: Int  # an ``Elimination``
    coupled_blocks: Int  # that could not be eliminated as a whole, see ``DeficientBlocks``
    rank: Int  # of the constraints
    dependent: Int  # constraints that depend on others; if any, some contact forces are not unique
    motion_unique: Flag  # no other accelerations meet the equations; may fail with friction only
    # smallest singular value in the decision on the rank that is not a rounding error: distance
    # from a loss of rank, infinite where every block is far from it; now, and least since the reset
    margin: Float
    least_margin: Float
    imbalance: Float  # residual of the object's equation, relative to the largest force in it
    # largest residual relative to the largest term, see multiarm.dynamics.solver_monitor
    residual: Float

    def forget(self) -> None:
        """As before any system was solved."""
        self.struct[:] = UNSOLVED.struct


UNSOLVED = Solution(motion_unique=True, margin=math.inf, least_margin=math.inf)


@plain
def write_solution(data, elimination, coupled_blocks, dependent, margin, motion_unique):
    """Write into ``data.solution`` what a solver has found out, apart from the residuals."""
    solution = data.solution
    solution.elimination, solution.coupled_blocks = elimination, coupled_blocks
    solution.rank, solution.dependent = data.rows.force.size - dependent, dependent
    solution.motion_unique = motion_unique
    solution.margin = margin
    solution.least_margin = min(solution.least_margin, margin)
