r"""Matrices of Coriolis forces: ``C`` for which the rate of the inertia is ``C + C^T``.

With :math:`\dot S_j = v_j\times S_j` and :math:`B^c_j` the sum of the matrices B of
:mod:`multiarm.robots.chain` over all links beyond joint ``j``,

.. math::
    C_{kj} = S_k\cdot(I^c_j \dot S_j + B^c_j S_j), \qquad
    C_{jk} = \dot S_k\cdot I^c_j S_j + S_k\cdot (B^c_j)^T S_j \quad (k\le j)

(S. Echeandia, P.M. Wensing, ASME J. Comput. Nonlinear Dyn. 16, 2021).
"""

from __future__ import annotations

from multiarm.jit.kernels import cfunc, kernel
from multiarm.jit.simd import LANES, broadcast, load_pack, store_pack
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_scaled,
    add_symmetric,
    dot,
    rotate,
    rotate_back,
    scale,
)
from multiarm.robots.chain import (
    add_scaled_pair,
    power,
    times_inertia,
    twice_turning_matrix,
    twist_product,
)
from multiarm.robots.compiled.kernels import (
    add_to_parents,
    copy_lanes,
    gather_columns,
    load_joints,
    move,
    outwards,
    transpose_to_robots,
    zero_vector,
)
from multiarm.robots.compiled.tables import (
    LINK_LANES,
    LINK_SUMS,
    TURN_LANES,
    TURN_SUMS,
    open_frame,
    open_link,
    open_robots,
    open_turn,
)


@cfunc
def update_coriolis(address, size, _a, _b):
    """Write the matrices of Coriolis forces of compiled robots on fixed bases, column by column."""
    tables, work = open_robots(struct_at(address, size))
    load_joints(tables, work)
    groups = tables.groups
    for g in range(groups.plain.size):
        if groups.floats[g]:
            continue
        first, end = groups.first_block[g], groups.first_block[g + 1]
        for b in range(first, end):
            outwards(tables, work, b)
            rates_outwards(tables, work, b)
        for b in range(end - 1, first - 1, -1):
            coriolis_inwards(tables, work, b)
        if groups.plain[g]:
            transpose_to_robots(
                work.leaves, 0, tables.blocks.joints[first] ** 2, work.coriolis,
                groups.first_term[g], groups.term_count[g],
            )  # fmt: skip
        else:
            move(work.leaves, groups.coriolis, g, work.coriolis)
    return 0


@kernel
def rates_outwards(tables, work, b):
    """Rates of the columns, linear momentum and ``G`` of every link of one block.

    After :func:`outwards` of the same block.
    """
    blocks, zero = tables.blocks, zero_vector()
    twist, row = (zero, zero), blocks.first_link[b] + blocks.ancestors[b]
    gather_columns(tables, work, b)
    if blocks.ancestors[b] > 0:
        twist = open_frame(work.start, 0).twist
        for k in range(blocks.ancestors[b]):
            places, at = blocks.lineage[blocks.first_ancestor[b] + k], blocks.first_link[b] + k
            size = TURN_LANES // LANES
            copy_lanes(work.link_turns, size, size, places, work.link_turns, TURN_LANES * at)
    for k in range(blocks.joints[b]):
        link, turn = (
            open_link(work.links, LINK_LANES * (row + k)),
            open_turn(work.link_turns, TURN_LANES * (row + k)),
        )
        rate = load_pack(work.rate, LANES * (blocks.first_joint[b] + k))
        twist = add_scaled_pair(twist, rate, link.column)
        turn.column_rate = twist_product(twist, link.column)
        mass, moment, second = link.mass, link.moment, link.second
        turn.momentum, _ = times_inertia(mass, moment, second, twist)
        turn.turning = twice_turning_matrix(moment, second, twist[0], twist[1])


@kernel
def coriolis_inwards(tables, work, b):
    """Matrices of one block into ``leaves``."""
    blocks, links, turns, leaves = tables.blocks, work.links, work.link_turns, work.leaves
    before, row = blocks.ancestors[b], blocks.first_link[b]
    n, at = before + blocks.joints[b], blocks.inertia[b]
    zero, mass, half = zero_vector(), broadcast(0.0), broadcast(0.5)
    moment, p = zero, zero
    second, G = zero + zero, (zero, zero, zero)
    for j in range(n - 1, before - 1, -1):
        link, turn = (
            open_link(links, LINK_LANES * (row + j)),
            open_turn(turns, TURN_LANES * (row + j)),
        )
        mass, moment = mass + link.mass, add(moment, link.moment)
        second, p = add_symmetric(second, link.second), add(p, turn.momentum)
        x, y, z = turn.turning
        G = add(G[0], x), add(G[1], y), add(G[2], z)
        column = link.column
        linear, angular = column
        momentum = times_inertia(mass, moment, second, column)
        # the transpose of B times the column, a couple
        transposed = add_cross(scale(half, rotate_back(G, angular)), p, linear)
        f, c = times_inertia(mass, moment, second, turn.column_rate)
        wrench = add_cross(f, angular, p), add_scaled(c, half, rotate(G, angular))
        for k in range(j + 1):
            ancestor, change = (
                open_link(links, LINK_LANES * (row + k)),
                open_turn(turns, TURN_LANES * (row + k)),
            )
            axis = ancestor.column
            below = power(change.column_rate, momentum) + dot(axis[1], transposed)
            store_pack(leaves, LANES * (at + n * k + j), below)
            store_pack(leaves, LANES * (at + n * j + k), power(axis, wrench))
    if before > 0:
        sums, turn_sums = open_link(work.link_sum, 0), open_turn(work.turn_sum, 0)
        sums.mass, sums.moment, sums.second, sums.force = mass, moment, second, (zero, zero)
        turn_sums.momentum, turn_sums.turning = p, G
        add_to_parents(blocks, b, work.link_sum, links, LINK_SUMS, LINK_LANES // LANES)
        add_to_parents(blocks, b, work.turn_sum, turns, TURN_SUMS, TURN_LANES // LANES)
