"""Numerical bounds of the solvers, each with its reason.

Ranks, pivots and residuals are relative: to the largest singular value, to the pivot without the
other rows, to the largest term of an equation.
"""

from __future__ import annotations

# --- Elimination arm by arm (:mod:`multiarm.dynamics.solver.node`).

# Arms with a relative pivot below this go to the coupled system
# (:mod:`multiarm.dynamics.solver.singular`). Elimination loses about as many digits as the pivot
# has zeros: the choice leaves eleven.
COUPLED_BELOW = 1e-5

# The same for the diagonal of K relative to the arm's mobility.  Entries of W are rounded relative
# to the levers, so that a diagonal loses half as many digits as this has zeros: eleven are left.
IMMOBILE_BELOW = 1e-10

# Brings the second measure to the scale of the first, so that one bound serves both.
MOBILITY_WEIGHT = COUPLED_BELOW / IMMOBILE_BELOW

# Largest residual of the object's equation of motion, relative to the largest force in it.  Arms
# that are eliminated as a whole leave eleven digits, of which two are for cancellation.
IMBALANCE_BOUND = 1e-9

# --- The coupled system of deficient arms (:mod:`multiarm.dynamics.solver.singular`).

# Directions of an arm with a sigma below this fraction of the best are not eliminated.
SPLIT_BY_ARM = 1e-2

# Below this fraction the arm does not move at all.
IMMOVABLE = 1e-11

# The same two, relative to the mobility of the object alone for the same unit force.
SPLIT_BY_OBJECT, IMMOVABLE_BY_OBJECT = 1e-3, 1e-9

# ``gamma``, a bound of ``g``: below it, the joints of an arm hardly move any of its contacts.
HARDLY_ALIGNED = 1e-3

# Singular values below this fraction of their scale count as zero, with friction too, and in all
# that is derived from a solution: derivatives, minimal coordinates, which forces are unique.
# Constraints that depend on each other on the joints only, as those of a loop of Bricard's, are
# independent off them, with singular values of about a tenth of the distance [m, rad].  Stages and
# starts are up to 1e-6 off; a distance of 1e-5 is the largest at which the loop still moves.
COUPLED_RANK_TOLERANCE = 1e-6

# Singular values below this fraction are rounding errors of gaps and sums: they say nothing about
# the distance from a loss of rank.
ROUNDED_SIGMA = 1e-10

# The constraints are near a loss of rank when a singular value is below this fraction: gaps have
# large effects there (:mod:`multiarm.integration.projection`).
NEAR_LOSS = 0.3

# --- Reaction matrices with friction (:mod:`multiarm.dynamics.solver.reactions`).

# Arms (and the node matrix) with relative pivots below this are solved together with the object:
# more work, the same result.  The elimination loses the digits that this number has.
COUPLING_TOLERANCE = 1e-6

# Arms whose mobility is below this fraction of that of the object alone leave no digits of its
# inertia in the node matrix.
STIFFER_THAN_OBJECT = 1e-3

# Singular values of the core (of the order of 1) below this count as zero.
CORE_TOLERANCE = 1e-9

# --- Whole systems (:mod:`multiarm.dynamics.solver.dense`).

# Singular values of the scaled constraint matrix below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-9

# The same for the whole matrix, whose small singular values are the squares of those of W.
SYSTEM_TOLERANCE = 1e-12

# Null vectors with a smaller motion do not move the system: constraints that are dependent up to
# rounding leave motions of the square root of SYSTEM_TOLERANCE.
UNMOVED = 1e-5

# Unknowns with a smaller part in every null vector are determined.
PART_TOLERANCE = 1e-7

# --- Residuals, and what a step records of them (:mod:`multiarm.dynamics.solver_monitor`).

# Smallest scale of accelerations that residuals are compared with [m/s^2].
LEAST_ACCELERATION = 1e-9

# Largest constraint residual of a solution, relative to the largest term of its equation.
RESIDUAL_BOUND = 1e-5

# Largest residual by rounding errors of gaps near a loss of rank.
MOST_ROUNDED_RESIDUAL = 1e-3

# A direction with a sigma below this fraction of the arm's largest is lost, and regained at
# REGAINED times this fraction.
LOST, REGAINED = 1e-3, 2.0

# --- Rows of unilateral contacts (:mod:`multiarm.events.row_dynamics`).

# Rows whose scaled response has smaller eigenvalues are dependent.
DEPENDENT = 1e-7
