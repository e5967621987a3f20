r"""The linear systems of a Rosenbrock method's stages, block by block: linear in the blocks.

With the blocks A, B, U of :mod:`multiarm.integration.block_matrices`, a stage has the unknowns
:math:`k_i`, the rates of a block's velocities and effects' states, those of the object :math:`k_o`,
and :math:`\chi`, the derivatives along the stage of the couplings: the object's acceleration, and
the multipliers of a control law.  With R of
:mod:`multiarm.integration.rosenbrock`, right-hand sides r (x: of the object's pose, q: of the
joints' positions) and the first 6 F of :math:`\chi`, these rates are functions of the others,

.. math::
    k_o = \gamma (r_o + h \chi), \qquad k_x = R_o (r_x + h k_o), \qquad
    k_{qi} = R_i (r_{qi} + h k_i) .

:math:`R_i` is :math:`\gamma`, but for the turn of a floating base, for which it is like
:math:`R_o`.  What is left is a matrix :math:`E_i` as large as the block's velocities and states,
and one system for :math:`\chi` alone, 6 F equations or 12 F:

.. math::
    E_i &= \frac1\gamma - h A^v_i - h^2 A^q_i R_i, \qquad
    E_i V_i = h\,(h^2 \gamma A^x_{oi} R_o + h \gamma A^v_{oi} + U_i), \qquad
    D_i = B^v_i + h B^q_i R_i, \\
    E_i k^0_i &= r_i + h\,(A^q_i R_i r_{qi} + A^x_{oi} k^0_x + A^v_{oi} k^0_o), \qquad
    k_i = k^0_i + V_i \chi, \\
    &\Big(1 - h^2 \gamma B^x_o R_o - h \gamma B^v_o - \sum_i D_i V_i\Big)\,\chi =
    B^x_o k^0_x + B^v_o k^0_o + \sum_i (B^q_i R_i r_{qi} + D_i k^0_i)

with the superscript 0 where :math:`\chi = 0`.

The rates of the works follow, as powers do not act on the state.
"""

from __future__ import annotations

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.coordinates import chart_places
from multiarm.dynamics.solver.factors import factor_lu, solve_lu, solve_rows
from multiarm.integration.block_matrices import derivative_columns
from multiarm.jit.kernels import clear, inlined, kernel


@kernel
def factor_stages(gamma, blocks, struct, velocity, h):
    """Factors of the stages' systems; returns whether they can be used."""
    _, data, work = open_system(struct)
    d, at, node, usable = blocks.d, derivative_columns(blocks), blocks.node, True
    u = blocks.couplings
    for l in range(u):
        clear(node[l])
        along_object(gamma, h, velocity, blocks.by_object[l], blocks.frames, node[l])
        for c in range(u):
            node[l, c] = (1.0 if l == c else 0.0) - node[l, c]
    for i in range(blocks.counts.size):
        A, B, D, E, V = (
            blocks.derivatives[i],
            blocks.on_object[i],
            blocks.D[i],
            blocks.E[i],
            blocks.V[i],
        )
        n = work.first_joint[i + 1] - work.first_joint[i]
        size = n + blocks.counts[i]
        for r in range(size):
            row = A[r if r < n else d + blocks.m + r - n]
            clear(V[r])
            along_object(gamma, h, velocity, row[at.pose :], blocks.frames, V[r])
            for l in range(u):
                V[r, l] = h * (V[r, l] + row[at.accelerations + l])
            turn_positions(gamma, -0.5 * h, velocity, data, work.first_joint[i], row, E[r, :n])
            for c in range(n):
                E[r, c] = -h * (row[d + c] + h * E[r, c])
            for c in range(n, size):
                E[r, c] = -h * row[2 * d + c - n]
            E[r, r] += 1.0 / gamma
        usable = usable and factor_lu(E, size, blocks.E_pivots[i]) > 0.0
        solve_rows(E, size, blocks.E_pivots[i], V)
        for l in range(u):
            turn_positions(gamma, -0.5 * h, velocity, data, work.first_joint[i], B[l], D[l, :n])
            for c in range(n):
                D[l, c] = B[l, d + c] + h * D[l, c]
            for c in range(n, size):
                D[l, c] = B[l, 2 * d + c - n]
            for k in range(size):
                for c in range(u):
                    node[l, c] -= D[l, k] * V[k, c]
    return usable and factor_lu(node, u, blocks.node_pivots) > 0.0


@inlined
def turn_positions(gamma, half, velocity, data, d0, row, out):
    """``out = R_i row`` for positions of a block whose joints begin at ``d0``.

    ``half`` is ``h / 2``, and ``-h / 2`` for a row vector, ``row R_i``.
    """
    for c in range(out.size):
        out[c] = gamma * row[c]
    for b in range(data.state.floating_bases.size):
        at = data.state.floating_bases[b] - d0 + 3
        if 0 <= at < out.size:
            spin = chart_places(data).joints + d0 + at
            turn(1.0 / gamma, half, velocity[spin : spin + 3], row[at : at + 3], out[at : at + 3])


@inlined
def along_object(gamma, h, velocity, row, frames, out):
    """``h gamma (h R_o^T row_x + row_v)``: a row along the rates that a unit of chi gives.

    ``row`` has the derivatives by pose and twist, ``frames`` numbers each.
    """
    for l in range(frames):
        out[l] = gamma * row[l]
    turn_frames(frames, 1.0 / gamma, -0.5 * h, velocity, row, out)
    for l in range(frames):
        out[l] = h * gamma * (h * out[l] + row[frames + l])


@inlined
def turn_bases(data, a, half, velocity, row, out):
    """As :func:`turn_frames` for the floating bases."""
    for b in range(data.state.floating_bases.size):
        spin = chart_places(data).joints + data.state.floating_bases[b] + 3
        turn(a, half, velocity[spin : spin + 3], row[spin : spin + 3], out[spin : spin + 3])


@inlined
def turn_frames(size, a, half, velocity, row, out):
    """Rotation vectors of ``out = R row`` by :func:`turn`, for frames with ``size`` velocities."""
    for spin in range(3, size, 6):
        turn(a, half, velocity[spin : spin + 3], row[spin : spin + 3], out[spin : spin + 3])


@kernel
def turn(a, half, omega, vector, out):
    """``out = (a - [w]x)^-1 vector``, ``w = half * omega``: for row vectors with ``-half``."""
    w0, w1, w2 = half * omega[0], half * omega[1], half * omega[2]
    v0, v1, v2 = vector[0], vector[1], vector[2]
    along = w0 * v0 + w1 * v1 + w2 * v2
    scale = 1.0 / (a * (a * a + w0 * w0 + w1 * w1 + w2 * w2))
    out[0] = scale * (a * a * v0 + a * (w1 * v2 - w2 * v1) + along * w0)
    out[1] = scale * (a * a * v1 + a * (w2 * v0 - w0 * v2) + along * w1)
    out[2] = scale * (a * a * v2 + a * (w0 * v1 - w1 * v0) + along * w2)


@kernel
def solve_block_stage(gamma, blocks, struct, velocity, h, right, out):
    """Solve a stage's system for the right-hand side ``right``, which is overwritten."""
    _, data, work = open_system(struct)
    places, d, at = chart_places(data), blocks.d, derivative_columns(blocks)
    chi, k_o, frames = blocks.chi, blocks.rates, blocks.frames
    clear(chi)
    write_object_rates(gamma, h, velocity, places, right, chi, k_o)
    for l in range(blocks.couplings):
        s = 0.0
        for c in range(k_o.size):
            s += blocks.by_object[l, c] * k_o[c]
        chi[l] = s
    for i in range(blocks.counts.size):
        A, B, D, k_i = blocks.derivatives[i], blocks.on_object[i], blocks.D[i], blocks.unknowns[i]
        d0, joints = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        size, positions = joints + blocks.counts[i], places.joints + d0
        k_q = out[positions : positions + joints]
        turn_positions(gamma, 0.5 * h, velocity, data, d0, right[positions:], k_q)
        for r in range(size):
            row = A[r if r < joints else d + blocks.m + r - joints]
            s = 0.0
            for c in range(k_o.size):
                s += row[at.pose + c] * k_o[c]
            for c in range(joints):
                s += row[c] * k_q[c]
            k_i[r] = right[unknown_place(blocks, i, places, d0, joints, r)] + h * s
        solve_lu(blocks.E[i], size, blocks.E_pivots[i], k_i)
        for l in range(blocks.couplings):
            s = 0.0
            for c in range(joints):
                s += B[l, c] * k_q[c]
            for c in range(size):
                s += D[l, c] * k_i[c]
            chi[l] += s
    solve_lu(blocks.node, blocks.couplings, blocks.node_pivots, chi)
    write_object_rates(gamma, h, velocity, places, right, chi, k_o)
    for l in range(frames):
        out[l], out[places.velocity + l] = k_o[l], k_o[frames + l]
    for i in range(blocks.counts.size):
        d0, joints = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        for r in range(joints + blocks.counts[i]):
            s = blocks.unknowns[i, r]
            for l in range(blocks.couplings):
                s += blocks.V[i, r, l] * chi[l]
            out[unknown_place(blocks, i, places, d0, joints, r)] = s
            if r < joints:
                right[places.joints + d0 + r] += h * s
        positions = places.joints + d0
        k_q = out[positions : positions + joints]
        turn_positions(gamma, 0.5 * h, velocity, data, d0, right[positions:], k_q)
    add_powers(gamma, blocks, work, places, h, right, out)


@inlined
def unknown_place(blocks, i, places, d0, joints, r):
    """Place in the state of an unknown of a block: a joint's velocity or an effect's state."""
    return places.rates + d0 + r if r < joints else places.states + blocks.states[i, r - joints]


@inlined
def write_object_rates(gamma, h, velocity, places, right, chi, rates):
    """Rates of the object's pose and twist for the derivative ``chi`` of its acceleration."""
    frames = places.joints
    for l in range(frames):
        rates[frames + l] = gamma * (right[places.velocity + l] + h * chi[l])
        rates[l] = right[l] + h * rates[frames + l]
    turn_frames(frames, 1.0 / gamma, 0.5 * h, velocity, rates, rates)
    for l in range(frames):
        if l % 6 < 3:
            rates[l] *= gamma


@inlined
def add_powers(gamma, blocks, work, places, h, right, out):
    """Rates of the works along the rates of the state, which are known."""
    at, first = derivative_columns(blocks), blocks.d + blocks.m + blocks.e
    for k in range(blocks.works):
        total, row = 0.0, blocks.by_object[blocks.couplings + k]
        for c in range(blocks.rates.size):
            total += row[c] * blocks.rates[c]
        for i in range(blocks.counts.size):
            d0, joints = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
            row = blocks.derivatives[i, first + k]
            for c in range(blocks.rates.size):
                total += row[at.pose + c] * blocks.rates[c]
            for l in range(blocks.frames, blocks.couplings):
                total += row[at.accelerations + l] * blocks.chi[l]
            for j in range(joints):
                total += row[j] * out[places.joints + d0 + j]
                total += row[at.rates + j] * out[places.rates + d0 + j]
            for j in range(blocks.counts[i]):
                total += row[at.states + j] * out[places.states + blocks.states[i, j]]
        work_at = places.works + k
        out[work_at] = gamma * (right[work_at] + h * total)
