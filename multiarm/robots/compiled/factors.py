r"""Factors of the inertia of trees, by articulated bodies: a sweep inwards.

With the inertia :math:`I^A` of the body that begins at a link, articulated beyond it, and p the
link before joint j,

.. math::
    U_j = I^A_j S_j, \qquad p_j = S_j\cdot U_j, \qquad
    I^A_p = I_p + \sum_j \Big(I^A_j - \frac{1}{p_j} U_j U_j^T\Big)

(R. Featherstone, Rigid Body Dynamics Algorithms, 2008, 7.3).  All are in world axes about the base
of the robot, so that nothing is turned or shifted from link to link.  What they are factors of is
said in :class:`multiarm.robots.terms.JointFactor`.
"""

from __future__ import annotations

from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import LANES, broadcast
from multiarm.jit.vectors import (
    add,
    add_outer,
    add_symmetric,
    add_times,
    rotate,
    rotate_back,
    scale,
    sub_scaled,
)
from multiarm.robots.chain import power
from multiarm.robots.compiled.tables import (
    ARTICULATED_LANES,
    FACTOR_LANES,
    JOINT_LANES,
    LINK_LANES,
    open_articulated,
    open_factor,
    open_joint,
    open_link,
)
from multiarm.robots.terms import VANISHING_INERTIA


@inlined
def rigid_body(mass, moment, second):
    """The fields of :class:`ArticulatedBody` of a rigid body."""
    none = broadcast(0.0)
    x, y, z = moment
    coupling = (none, none - z, y), (z, none, none - x), (none - y, x, none)  # e x h
    return (mass, none, none, mass, none, mass), coupling, second


@inlined
def begin_articulated(articulated, row, mass, moment, second):
    """Begin the sum of articulated bodies at a link where branches begin."""
    body = open_articulated(articulated, ARTICULATED_LANES * row)
    body.linear, body.coupling, body.angular = rigid_body(mass, moment, second)


@inlined
def add_bodies(a, b):
    """Sum of two inertias."""
    (p, B, q), (r, C, s) = a, b
    coupling = add(B[0], C[0]), add(B[1], C[1]), add(B[2], C[2])
    return add_symmetric(p, r), coupling, add_symmetric(q, s)


@inlined
def without(body, force, ratio, factor):
    """The inertia less ``force force^T / p``; ``ratio`` is ``force / p``, ``factor`` ``-1 / p``."""
    linear, coupling, angular = body
    f, c = force
    coupling = (
        sub_scaled(coupling[0], c[0], ratio[0]),
        sub_scaled(coupling[1], c[1], ratio[0]),
        sub_scaled(coupling[2], c[2], ratio[0]),
    )
    return add_outer(linear, factor, f), coupling, add_outer(angular, factor, c)


@kernel
def factor_inwards(tables, work, b):
    """Factors of the joints of one block into ``leaves``."""
    blocks, leaves, n = tables.blocks, work.leaves, tables.blocks.joints[b]
    first, row = blocks.first_joint[b], blocks.first_link[b] + blocks.ancestors[b]
    at, none = LANES * blocks.factors[b], broadcast(0.0)
    zero = none, none, none
    body = zero + zero, (zero, zero, zero), zero + zero
    for j in range(n - 1, -1, -1):
        link = open_link(work.links, LINK_LANES * (row + j))
        if tables.divides[first + j]:
            own = open_articulated(work.articulated, ARTICULATED_LANES * (row + j))
            body = add_bodies(body, (own.linear, own.coupling, own.angular))
        else:
            body = add_bodies(body, rigid_body(link.mass, link.moment, link.second))
        column = link.column
        linear, coupling, angular = body
        v, w = column
        force = (
            add_times(rotate(coupling, w), linear, v),
            add_times(rotate_back(coupling, v), angular, w),
        )
        drive = open_joint(tables.constants, JOINT_LANES * (first + j)).armature
        inverse = inverse_of(power(column, force) + drive)
        ratio = scale(inverse, force[0]), scale(inverse, force[1])
        factor = open_factor(leaves, at + FACTOR_LANES * j)
        factor.column, factor.force, factor.inverse = column, ratio, inverse
        body = without(body, force, ratio, none - inverse)
    total = open_articulated(work.articulated_sum, 0)
    total.linear, total.coupling, total.angular = body


@kernel
def factor_base(tables, work, b):
    """Factors of a block of floating bases, along and about the axes of the world."""
    leaves, at = work.leaves, LANES * tables.blocks.factors[b]
    base = open_articulated(work.articulated, ARTICULATED_LANES * tables.blocks.first_link[b])
    body = base.linear, base.coupling, base.angular
    one, none = broadcast(1.0), broadcast(0.0)
    zero, x, y, z = (none, none, none), (one, none, none), (none, one, none), (none, none, one)
    body = factor_along((zero, z), body, 2, leaves, at + 5 * FACTOR_LANES)
    body = factor_along((zero, y), body, 1, leaves, at + 4 * FACTOR_LANES)
    body = factor_along((zero, x), body, 0, leaves, at + 3 * FACTOR_LANES)
    linear, _, _ = body
    fz, ratio, inverse = column_over((linear[2], linear[4], linear[5]), linear[5])
    put_factor((z, zero), (ratio, zero), inverse, leaves, at + 2 * FACTOR_LANES)
    linear = add_outer(linear, none - inverse, fz)
    fy, ratio, inverse = column_over((linear[1], linear[3], linear[4]), linear[3])
    put_factor((y, zero), (ratio, zero), inverse, leaves, at + FACTOR_LANES)
    linear = add_outer(linear, none - inverse, fy)
    _, ratio, inverse = column_over((linear[0], linear[1], linear[2]), linear[0])
    put_factor((x, zero), (ratio, zero), inverse, leaves, at)


@inlined
def column_over(force, pivot):
    """A column of an inertia, the same over its pivot, and the inverse of the pivot."""
    inverse = inverse_of(pivot)
    return force, scale(inverse, force), inverse


@inlined
def factor_along(column, body, k, leaves, at):
    """Factor of the turn about axis number ``k``; returns what is left of the inertia."""
    _, coupling, angular = body
    columns = (
        (angular[0], angular[1], angular[2]),
        (angular[1], angular[3], angular[4]),
        (angular[2], angular[4], angular[5]),
    )
    force = coupling[k], columns[k]
    inverse = inverse_of(columns[k][k])
    ratio = scale(inverse, force[0]), scale(inverse, force[1])
    put_factor(column, ratio, inverse, leaves, at)
    return without(body, force, ratio, broadcast(0.0) - inverse)


@inlined
def inverse_of(pivot):
    """``1 / p``, finite where p is zero."""
    return broadcast(1.0) / (pivot + broadcast(VANISHING_INERTIA))


@inlined
def put_factor(column, force, inverse, leaves, at):
    """Write a factor."""
    factor = open_factor(leaves, at)
    factor.column, factor.force, factor.inverse = column, force, inverse
