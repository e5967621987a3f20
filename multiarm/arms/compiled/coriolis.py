r"""Matrices of Coriolis forces: ``C`` for which the rate of the inertia is ``C + C^T``.

With :math:`v_j = (v, \omega)` the velocity of link ``j`` at the base,
:math:`\dot S_j = v_j\times S_j`, and :math:`B^c_j` the sum over all links beyond joint ``j`` of

.. math::
    B = \tfrac12\big[(v\times^*)\,I - I\,(v\times) + (I v)\,\bar\times^*\big],

.. math::
    C_{kj} = S_k\cdot(I^c_j \dot S_j + B^c_j S_j), \qquad
    C_{jk} = \dot S_k\cdot I^c_j S_j + S_k\cdot (B^c_j)^T S_j \quad (k\le j)

(S. Echeandia, P.M. Wensing, ASME J. Comput. Nonlinear Dyn. 16, 2021).  For a rigid body of mass
``m``, first moment ``c`` and second moments ``I`` about the base, only two of the blocks of B are
not zero, those that act on angular velocities:

.. math::
    B_{l\omega} = -[h]_\times, \quad h = m v + \omega\times c, \qquad
    B_{\omega\omega} = \tfrac12\big(A + A^T - [I\omega]_\times\big) + (c\cdot v) - v\,c^T,
    \quad A = [\omega]_\times I .
"""

from __future__ import annotations

from multiarm.arms.compiled.kernels import (
    load_joints,
    outwards,
    power,
    put_columns,
    put_pair,
    put_vector,
    symmetric_at,
    times_inertia,
    vector_at,
    zero_vector,
)
from multiarm.arms.compiled.tables import (
    COLUMN_RATE,
    FIRST,
    JOINTS,
    LINK_INERTIA,
    LINK_WIDTH,
    MATRIX,
    MOMENTUM,
    TERMS,
    TURN_WIDTH,
    WIDTH,
    open_arms,
)
from multiarm.jit.kernels import cfunc, inlined, kernel
from multiarm.jit.simd import LANES, broadcast, load_pack, store_pack, transpose_four
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_scaled,
    add_symmetric,
    cross,
    dot,
    rotate,
    scale,
    times,
)


@cfunc
def update_coriolis(address, size, _a, _b):
    """Write the matrices of Coriolis forces of compiled arms, column by column."""
    tables, work = open_arms(struct_at(address, size))
    load_joints(tables, work)
    for b in range(tables.blocks.shape[0]):
        outwards(tables, work, b)
        rates_outwards(tables, work, b)
        coriolis_inwards(tables, work, b)
        block = tables.blocks[b]
        at0, width = block[TERMS], block[WIDTH]
        at1, at2, at3 = at0 + width, at0 + 2 * width, at0 + 3 * width
        for k in range(0, block[JOINTS] * block[JOINTS], LANES):
            transpose_four(
                work.leaves, LANES * k, work.coriolis, at0 + k, at1 + k, at2 + k, at3 + k
            )
    return 0


@kernel
def rates_outwards(tables, work, b):
    """Rates of the columns, and ``h`` and ``B`` of every link of one block."""
    links, out = work.links, work.link_turns
    v = w = zero_vector()
    for k in range(tables.blocks[b, JOINTS]):
        link, at = LANES * LINK_WIDTH * k, LANES * TURN_WIDTH * k
        rate = load_pack(work.rate, LANES * (tables.blocks[b, FIRST] + k))
        linear, angular = vector_at(links, link), vector_at(links, link + 3 * LANES)
        v, w = add_scaled(v, rate, linear), add_scaled(w, rate, angular)
        linear = add_cross(cross(w, linear), v, angular)
        put_pair(out, at + LANES * COLUMN_RATE, linear, cross(w, angular))
        link += LANES * LINK_INERTIA
        mass, moment = load_pack(links, link), vector_at(links, link + LANES)
        inertia = symmetric_at(links, link + 4 * LANES)
        put_vector(out, at + LANES * MOMENTUM, add_cross(scale(mass, v), w, moment))
        put_columns(out, at + LANES * MATRIX, turning_matrix(moment, inertia, v, w))


@inlined
def turning_matrix(c, inertia, v, w):
    """Columns of the block of B that makes moments of angular velocities."""
    half = broadcast(0.5)
    xx, xy, xz, yy, yz, zz = inertia
    x, y, z = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
    a, b, d = cross(w, x), cross(w, y), cross(w, z)
    h = times(inertia, w)
    p, q, r = c[0] * v[0], c[1] * v[1], c[2] * v[2]
    return (
        (
            a[0] + q + r,
            half * (a[1] + b[0] - h[2]) - v[1] * c[0],
            half * (a[2] + d[0] + h[1]) - v[2] * c[0],
        ),
        (
            half * (b[0] + a[1] + h[2]) - v[0] * c[1],
            b[1] + p + r,
            half * (b[2] + d[1] - h[0]) - v[2] * c[1],
        ),
        (
            half * (d[0] + a[2] - h[1]) - v[0] * c[2],
            half * (d[1] + b[2] + h[0]) - v[1] * c[2],
            d[2] + p + q,
        ),
    )


@kernel
def coriolis_inwards(tables, work, b):
    """Matrices of one block into ``leaves``."""
    links, turns, leaves, n = work.links, work.link_turns, work.leaves, tables.blocks[b, JOINTS]
    zero, mass, moment, h = zero_vector(), broadcast(0.0), zero_vector(), zero_vector()
    second, B = zero + zero, (zero, zero, zero)
    for j in range(n - 1, -1, -1):
        link, turn = LANES * LINK_WIDTH * j, LANES * TURN_WIDTH * j
        at = link + LANES * LINK_INERTIA
        mass = mass + load_pack(links, at)
        moment = add(moment, vector_at(links, at + LANES))
        second = add_symmetric(second, symmetric_at(links, at + 4 * LANES))
        h = add(h, vector_at(turns, turn + LANES * MOMENTUM))
        at = turn + LANES * MATRIX
        x, y = add(B[0], vector_at(turns, at)), add(B[1], vector_at(turns, at + 3 * LANES))
        B = x, y, add(B[2], vector_at(turns, at + 6 * LANES))
        linear, angular = vector_at(links, link), vector_at(links, link + 3 * LANES)
        force, couple = times_inertia(mass, moment, second, linear, angular)
        # the transpose of B times the column, a couple
        transposed = add_cross((dot(x, angular), dot(y, angular), dot(B[2], angular)), h, linear)
        rate = vector_at(turns, turn), vector_at(turns, turn + 3 * LANES)
        f, c = times_inertia(mass, moment, second, rate[0], rate[1])
        f, c = add_cross(f, angular, h), add(c, rotate(B, angular))
        for k in range(j + 1):
            at, rates = LANES * LINK_WIDTH * k, LANES * TURN_WIDTH * k
            axis = vector_at(links, at), vector_at(links, at + 3 * LANES)
            change = vector_at(turns, rates), vector_at(turns, rates + 3 * LANES)
            below = power(change[0], change[1], force, couple) + dot(axis[1], transposed)
            store_pack(leaves, LANES * (n * k + j), below)
            store_pack(leaves, LANES * (n * j + k), power(axis[0], axis[1], f, c))
