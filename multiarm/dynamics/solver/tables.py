"""Four arms' numbers on their way into the registers and out of them.

A group's table (:class:`multiarm.dynamics.solver.work.NodeWork`) has one row for each joint and
each contact, and one for the solution.  Its columns are the joints, the contacts, the right-hand
side, and the object's six directions; it is symmetric, and what is left of the diagonal is not
used.
"""

from __future__ import annotations

from multiarm.dynamics.solver.work import CONTACTS, COUNT, FIRST_ARM, JOINTS, START, WIDTH
from multiarm.jit.kernels import inlined
from multiarm.jit.simd import LANES, broadcast, gather_pack, load_pack, store_pack

# Mobility of contacts that fill up a table: no arm is as mobile, and its square is finite [1/kg].
FILLED_UP = 1e100


@inlined
def fill_table(group, work, Wo, h, c, places, present):
    """Write the equations of four arms into their table.

    Parameters
    ----------
    group, places, present
        Rows of ``work.groups``, ``work.places`` and ``work.present``.
    work, Wo, h, c
        As in :func:`multiarm.dynamics.solver.batched.solve_batched`.
    """
    fill_joint_rows(group, work, h, places)
    fill_contact_rows(group, work, Wo, c, places[LANES * work.L.shape[1] :], present)


@inlined
def fill_joint_rows(group, work, h, places):
    """Write ``M``, ``W`` and ``h`` of four arms into their table."""
    d, m, stride = group[JOINTS], group[CONTACTS], LANES * group[WIDTH]
    L, Y, lanes = work.L, work.Y, work.packs
    most, columns = Y.shape[1], Y.shape[2]
    a0, a1 = most * group[FIRST_ARM], most * group[FIRST_ARM + 1]
    a2, a3 = most * group[FIRST_ARM + 2], most * group[FIRST_ARM + 3]
    row = group[START]
    for j in range(d):
        at = row + LANES * j
        for k in range(j, d):
            o = k * most + j
            value = gather_pack(L, a0 * most + o, a1 * most + o, a2 * most + o, a3 * most + o)
            store_pack(lanes, at, value)
            at += LANES
        for o in range(j * columns, j * columns + m):
            y0, y1, y2, y3 = a0 * columns + o, a1 * columns + o, a2 * columns + o, a3 * columns + o
            store_pack(lanes, at, gather_pack(Y, y0, y1, y2, y3))
            at += LANES
        p = places[LANES * j : LANES * j + LANES]
        store_pack(lanes, at, gather_pack(h, p[0], p[1], p[2], p[3]))
        row += stride


@inlined
def fill_contact_rows(group, work, Wo, c, places, present):
    """Write ``c`` and ``W_o^T`` of four arms into their table, and zeros for ``K``."""
    d, m = group[JOINTS], group[CONTACTS]
    lanes, row = work.packs, group[START] + LANES * d * group[WIDTH]
    zero, one, endless = broadcast(0.0), broadcast(1.0), broadcast(FILLED_UP)
    for a in range(m):
        held = load_pack(present, LANES * a)
        at = row + LANES * (d + a)
        store_pack(lanes, at, (held - one) * endless)
        for _ in range(a + 1, m):
            at += LANES
            store_pack(lanes, at, zero)
        at += LANES
        p = places[LANES * a : LANES * a + LANES]
        store_pack(lanes, at, gather_pack(c, p[0], p[1], p[2], p[3]))
        w0, w1, w2, w3 = 6 * p[0], 6 * p[1], 6 * p[2], 6 * p[3]
        for k in range(6):
            at += LANES
            store_pack(lanes, at, held * gather_pack(Wo, w0 + k, w1 + k, w2 + k, w3 + k))
        row += LANES * group[WIDTH]


@inlined
def hand_out(group, work, q, force):
    """Write the unknowns of four arms where they belong."""
    d, right = group[JOINTS], group[JOINTS] + group[CONTACTS]
    x = group[START] + LANES * right * group[WIDTH]
    lanes = work.packs
    for lane in range(group[COUNT]):
        i = group[FIRST_ARM + lane]
        at = x + lane
        for j in range(work.dofs[i], work.dofs[i + 1]):
            q[j] = lanes[at]
            at += LANES
        at = x + LANES * d + lane
        for a in range(work.rows[i], work.rows[i + 1]):
            force[a] = -lanes[at]
            at += LANES
