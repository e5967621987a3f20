"""Numerical bounds of the solvers, each with its reason.

Ranks, pivots and residuals are relative: to the largest singular value, to the pivot without the
other rows, to the largest term of an equation.
"""

from __future__ import annotations

# --- Factors (:mod:`multiarm.dynamics.solver.factors`).

# Pivots of a semidefinite matrix below this fraction of its largest diagonal entry count as zero:
# some thousand roundings of sums of products.
SEMIDEFINITE_PIVOT = 1e-12

# --- Elimination block by block (:mod:`multiarm.dynamics.solver.node`).

# Blocks with a relative pivot below this go to the coupled system
# (:mod:`multiarm.dynamics.solver.singular`). Elimination loses about as many digits as the pivot
# has zeros: the choice leaves eleven.
COUPLED_BELOW = 1e-5

# The same for the diagonal of K relative to the block's mobility.  Entries of W are rounded
# relative to the levers, so that a diagonal loses half as many digits as this has zeros: eleven are
# left.
IMMOBILE_BELOW = 1e-10

# Brings the second measure to the scale of the first, so that one bound serves both.
MOBILITY_WEIGHT = COUPLED_BELOW / IMMOBILE_BELOW

# Largest residual of the object's equation of motion, relative to the largest force in it.  Blocks
# that are eliminated as a whole leave eleven digits, of which two are for cancellation.
IMBALANCE_BOUND = 1e-9

# --- The coupled system of deficient blocks (:mod:`multiarm.dynamics.solver.singular`).

# Directions of a block with a sigma below this fraction of the best are not eliminated.
SPLIT_BY_BLOCK = 1e-2

# Below this fraction the block does not move at all.
IMMOVABLE = 1e-11

# The same two, relative to the mobility of the object alone for the same unit force.
SPLIT_BY_OBJECT, IMMOVABLE_BY_OBJECT = 1e-3, 1e-9

# ``gamma``, a bound of ``g``: below it, the joints of a block hardly move any of its contacts.
HARDLY_ALIGNED = 1e-3

# Singular values below this fraction of their scale count as zero, with friction too, and in all
# that is derived from a solution: derivatives, minimal coordinates, which forces are unique.
# Constraints that depend on each other on the joints only, as those of a loop of Bricard's, are
# independent off them, with singular values of about a tenth of the distance [m, rad].  Stages and
# starts are up to 1e-6 off; a distance of 1e-5 is the largest at which the loop still moves.
COUPLED_RANK_TOLERANCE = 1e-6

# The same at a state with gaps, which a projection closes: singular values below this part of the
# largest gap over the lever of the contacts may be due to the gaps alone, and count as zero up to
# the second.  A correction that closed the gap along such a direction would be longer than three
# levers, and lead to another point of the path.  If the direction is no such one, the gap along it
# is left to the next corrections, after which the other gaps are smaller.
RANK_PER_GAP, MOST_RANK_TOLERANCE = 0.3, 1e-3

# Singular values below this fraction are rounding errors of gaps and sums: they say nothing about
# the distance from a loss of rank.
ROUNDED_SIGMA = 1e-10

# The constraints are near a loss of rank when a singular value is below this fraction: gaps have
# large effects there (:mod:`multiarm.integration.projection`).
NEAR_LOSS = 0.3

# --- Reaction matrices with friction (:mod:`multiarm.dynamics.solver.reactions`).

# Blocks (and the node matrix) with relative pivots below this are solved together with the object:
# more work, the same result.  The elimination loses the digits that this number has.
COUPLING_TOLERANCE = 1e-6

# Blocks whose mobility is below this fraction of that of the object alone leave no digits of its
# inertia in the node matrix.
STIFFER_THAN_OBJECT = 1e-3

# Singular values of the core (of the order of 1) below this count as zero.
CORE_TOLERANCE = 1e-9

# --- Whole systems (:mod:`multiarm.dynamics.solver.dense`).

# Singular values of a matrix with comparable rows and columns below this fraction of the largest
# count as zero, where no other tolerance is asked for: motions of joints, forces for a wrench.
RANK_TOLERANCE = 1e-9

# The same for the scaled matrix of the whole system, whose small singular values are the squares of
# those of W: for the scaled W it is the root of this number.
SYSTEM_TOLERANCE = 1e-12

# Rows of constraints shorter than this part of the longest are roundings of terms that cancel, as
# those of a hinge of a plane linkage that hold it in its plane: they are zero.
ROUNDED_ROW = 1e-12

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

# Gaps are known to about this [m]: some dozen roundings of positions of the order of 1 m.  Near a
# loss of rank they are errors of the state over the margin, the distance from that loss, and errors
# of velocities over its square; but never more than MOST_ROUNDED_CORRECTION.
ROUNDED_GAP, MOST_ROUNDED_CORRECTION = 1e-14, 1e-5

# Residuals have the roundings of W and of the right-hand sides besides, over the square, too.
ROUNDED_RESIDUAL = 1e-13

# Error of a step with projected stages: the first over the cube of the margin, at most the second
# [m, rad; m/s, rad/s].
ROUNDED_STEP, MOST_ROUNDED_STEP = 2e-15, 1e-9

# A direction with a sigma below this fraction of the block's largest is lost, and regained at
# REGAINED times this fraction.
LOST, REGAINED = 1e-3, 2.0

# --- Rows of unilateral contacts (:mod:`multiarm.events.row_dynamics`).

# Rows whose scaled response has smaller eigenvalues are dependent.
DEPENDENT = 1e-7

# Rows whose response is a smaller part of their mobility are kept from moving by the held rows:
# what remains is rounding, as of pivots of a semidefinite matrix.
HELD_RESPONSE = SEMIDEFINITE_PIVOT

# Rows can move while others are held when more than this part of their response is left: 1e-3 in
# motions.
MOVABLE = 1e-6

# --- Transitions (:mod:`multiarm.events.transition`).

# Accelerations below this are rounding errors [m/s^2, rad/s^2].
NO_ACCELERATION = 1e-10

# Energy that an impact adds, as a part of what its impulses exchange, by rounding.
ROUNDED_ENERGY = 1e-12

# Largest residual of velocities after an impact for which no solution was proved: smaller ones are
# removed by the projection that follows.
IMPACT_RESIDUAL = 1e-6

# Forces below this part of the largest one carry nothing: far above the digits to which the time at
# which a force vanishes is found.
UNLOADED = 1e-7

# Motions whose gaps have accelerations that differ by less than this part of the largest one are
# one motion.
SAME_MOTION = 1e-6

# --- Open motions (:mod:`multiarm.dynamics.open_motion`).

# Smallest pivot of K', relative to the largest: below, a further rank is lost.
OPEN_MOTION_PIVOT = 1e-13

# --- Inverse dynamics (:mod:`multiarm.dynamics.inverse`).

# Singular values of a block's equations, scaled to rows of length 1, below this fraction of the
# largest count as zero.
BLOCK_RANK_TOLERANCE = 1e-10

# A block misses the desired motion when it differs by more than this, relative to 1 and to the
# largest desired acceleration: far above rounding, far below any motion that is meant.
MISSED_MOTION = 1e-7
