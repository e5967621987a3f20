r"""How many floating point operations the solvers of the constrained system take.

Every addition, subtraction, multiplication, division and square root counts as one.  For ``n`` arms
of ``d`` joints and ``N`` contacts each, direct elimination of the matrix of order
:math:`k = 6 + n (d + N)` takes :math:`\tfrac23 k^3 + O(k^2)`, cubic in the arms.  The node
algorithm takes, an arm,

.. math::
    \underbrace{\tfrac13 d^3}_{M_i} + \underbrace{2 d^2 (N + 1)}_{M_i^{-1}[W_i, h_i]} +
    \underbrace{2 d N (N + 1)}_{K_i,\, r_i} + \underbrace{\tfrac13 N^3 + 14 N^2}_{K_i^{-1}[W_{oi}^T,
    r_i]} + \underbrace{84 N}_{A,\, b} + \underbrace{12 N}_{\mu_i} +
    \underbrace{2 d N + 2 d^2}_{q_i}

to leading orders when the equations (4.10) - (4.12) of the thesis are carried out as written, and
:math:`\tfrac13 6^3 + 2 \cdot 6^2` for the object: linear.  What
:mod:`multiarm.dynamics.solver.batched` really does is less, since triangular factors and symmetric
halves serve twice; :func:`node_operations` counts it exactly, each arm's own operations.
"""

from __future__ import annotations


def node_operations(arms: int, joints: int = 6, rows: int = 1) -> int:
    """Operations of elimination and solution, as the time loop performs them."""
    d, right = joints, joints + rows
    filling = 8 * rows
    # row i: factors and pivot, its inverse, what is right of it; the pivot's relative size
    elimination = sum(3 * i + 1 + 2 * i * (right - i) for i in range(right)) + rows
    elimination += joints + rows + 2  # the diagonal relative to the mobility
    elimination += sum(12 * (i - d) for i in range(d, right))  # the object's columns
    share = 6 * 2 * rows + 2 * 27 * rows
    backward = right * right + 12 * rows
    addition = 27 * (3 + 1)  # of the four sums of shares, and of the object's own
    node = 75 + 2 * 6 + 40 + 36  # below the diagonal, pivots, above it, backward
    return arms * (filling + elimination + share + backward) + addition + node


def direct_operations(arms: int, joints: int = 6, rows: int = 1) -> int:
    """Operations of Gaussian elimination of the whole matrix and of its two triangular solves."""
    k = order(arms, joints, rows)
    # column by column: k - 1 - j quotients, and twice its square in the rest of the matrix
    factor = k * (k - 1) // 2 + k * (k - 1) * (2 * k - 1) // 3
    return factor + k * (k - 1) + k * k


def order(arms: int, joints: int = 6, rows: int = 1) -> int:
    """Number of unknowns: object, joints and contact forces."""
    return 6 + arms * (joints + rows)


def ratio_as_written(arms: int, joints: int = 6, rows: int = 1) -> float:
    """Operations of direct elimination over those of (4.10) - (4.12) as written, leading orders."""
    k, d, m = order(arms, joints, rows), joints, rows
    direct = 2.0 / 3.0 * k**3 + 2.0 * k**2
    an_arm = (
        d**3 / 3 + 2 * d**2 * (m + 1) + 2 * d * m * (m + 1) + m**3 / 3 + 14 * m**2
        + 84 * m + 12 * m + 2 * d * m + 2 * d**2
    )  # fmt: skip
    return direct / (arms * an_arm + 6**3 / 3 + 2 * 6**2)
