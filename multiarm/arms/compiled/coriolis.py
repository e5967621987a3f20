r"""Matrices of Coriolis forces: ``C`` for which the rate of the inertia is ``C + C^T``.

With :math:`\dot S_j = v_j\times S_j` and :math:`B^c_j` the sum of the matrices B of
:mod:`multiarm.arms.chain` over all links beyond joint ``j``,

.. math::
    C_{kj} = S_k\cdot(I^c_j \dot S_j + B^c_j S_j), \qquad
    C_{jk} = \dot S_k\cdot I^c_j S_j + S_k\cdot (B^c_j)^T S_j \quad (k\le j)

(S. Echeandia, P.M. Wensing, ASME J. Comput. Nonlinear Dyn. 16, 2021).
"""

from __future__ import annotations

from multiarm.arms.chain import (
    add_scaled_pair,
    power,
    times_inertia,
    twice_turning_matrix,
    twist_product,
)
from multiarm.arms.compiled.kernels import (
    load_joints,
    outwards,
    transpose_to_arms,
    zero_vector,
)
from multiarm.arms.compiled.tables import (
    LINK_LANES,
    TURN_LANES,
    open_arms,
    open_link,
    open_turn,
)
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


@cfunc
def update_coriolis(address, size, _a, _b):
    """Write the matrices of Coriolis forces of compiled arms, column by column."""
    tables, work = open_arms(struct_at(address, size))
    load_joints(tables, work)
    for b in range(tables.block_joints.size):
        outwards(tables, work, b)
        rates_outwards(tables, work, b)
        coriolis_inwards(tables, work, b)
        transpose_to_arms(
            work.leaves, 0, tables.block_joints[b] ** 2, work.coriolis, tables.first_term[b],
            tables.term_count[b],
        )  # fmt: skip
    return 0


@kernel
def rates_outwards(tables, work, b):
    """Rates of the columns, linear momentum and ``G`` of every link of one block."""
    zero = zero_vector()
    twist = zero, zero
    for k in range(tables.block_joints[b]):
        link, turn = (
            open_link(work.links, LINK_LANES * k),
            open_turn(work.link_turns, TURN_LANES * k),
        )
        rate = load_pack(work.rate, LANES * (tables.first_joint[b] + k))
        twist = add_scaled_pair(twist, rate, link.column)
        turn.column_rate = twist_product(twist, link.column)
        mass, moment, second = link.mass, link.moment, link.second
        turn.momentum, _ = times_inertia(mass, moment, second, twist)
        turn.turning = twice_turning_matrix(moment, second, twist[0], twist[1])


@kernel
def coriolis_inwards(tables, work, b):
    """Matrices of one block into ``leaves``."""
    links, turns, leaves, n = work.links, work.link_turns, work.leaves, tables.block_joints[b]
    zero, mass, half = zero_vector(), broadcast(0.0), broadcast(0.5)
    moment, p = zero, zero
    second, G = zero + zero, (zero, zero, zero)
    for j in range(n - 1, -1, -1):
        link, turn = open_link(links, LINK_LANES * j), open_turn(turns, TURN_LANES * j)
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
            before, change = open_link(links, LINK_LANES * k), open_turn(turns, TURN_LANES * k)
            axis = before.column
            below = power(change.column_rate, momentum) + dot(axis[1], transposed)
            store_pack(leaves, LANES * (n * k + j), below)
            store_pack(leaves, LANES * (n * j + k), power(axis, wrench))
