r"""Batched RNEA and CRBA: one outward and one inward sweep along four branches at once.

The equations of a joint and its link are those of :mod:`multiarm.robots.chain`.  Outwards
(recursive Newton-Euler; R. Featherstone, Rigid Body Dynamics Algorithms, 2008, 5.3), the base being
accelerated by minus gravity and p the joint before j,

.. math::
    v_j = v_p + S_j \dot q_j, \qquad a_j = a_p + v_p\times S_j \dot q_j .

Inwards the forces of all links beyond a joint are summed, and their inertias to that of one
composite body (6.2), which gives

.. math::
    b_j = S_j\cdot f_j, \qquad M_{jk} = S_k\cdot I^c_j S_j

for all k on the way from the base to j; between branches M is zero.  Potential energy and gravity
torques follow from mass and first moment of the composite bodies.

A branch begins with what the outward sweep leaves at its parent, and adds to its parent what the
inward sweep sums up.

A floating base is a link that no joint moves: at rest, it would be that of a fixed base.  Its twist
:math:`(v, \omega)` in world axes is its velocity, and moments are about its origin.  At an
acceleration of zero the rate of the twist there is :math:`(v\times\omega, 0)`, less gravity.  Its
six columns are the unit twists: so the force of the whole robot is the bias, the inertia of the
composite body is the inertia, and :math:`I^c_j S_j` are the six columns of a joint's row.
"""

from __future__ import annotations

import math

from multiarm.contacts.motion import BODY_WIDTH
from multiarm.jit.kernels import cfunc, inlined, kernel
from multiarm.jit.simd import (
    LANES,
    broadcast,
    gather_pack,
    load_pack,
    store_pack,
    transpose_four,
)
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_scaled,
    add_symmetric,
    broadcast_vector,
    compose,
    cross,
    dot,
    scale,
    sub,
    vec,
)
from multiarm.robots.chain import (
    add_pair,
    add_twist_product,
    column_of,
    inertial_force,
    link_inertia,
    moments,
    next_frame,
    power,
    times_inertia,
    write_motion,
)
from multiarm.robots.compiled.factors import (
    begin_articulated,
    factor_base,
    factor_inwards,
)
from multiarm.robots.compiled.tables import (
    ARTICULATED_LANES,
    BODY_LANES,
    FIXED_BASE,
    FLOATING_BASE,
    FRAME_AXES,
    FRAME_LANES,
    FRAME_ORIGIN,
    FRAME_RATE,
    FRAME_TWIST,
    JACOBIAN_LANES,
    JOINT_LANES,
    LINK,
    LINK_LANES,
    LINK_SUMS,
    POSE_LANES,
    open_body,
    open_frame,
    open_jacobian,
    open_joint,
    open_link,
    open_pose,
    open_robots,
)
from multiarm.spatial import rotation_of


@cfunc
def update_robots(address, size, _a, _b):
    """Write all terms of compiled robots, and the motion of links that take part in connections."""
    tables, work = open_robots(struct_at(address, size))
    load_joints(tables, work)
    groups = tables.groups
    for g in range(groups.plain.size):
        first, end = groups.first_block[g], groups.first_block[g + 1]
        if groups.floats[g]:
            place_bases(tables, work, g)
        for b in range(first, end):
            outwards(tables, work, b)
        for b in range(end - 1, first - 1, -1):
            if tables.blocks.start[b] == FLOATING_BASE:
                write_base_terms(tables, work, b)
            else:
                inwards(tables, work, b)
        if tables.wanted.factors and not groups.plain[g]:
            factor(tables, work, first, end)
        if groups.plain[g]:
            transpose_terms(tables, work, g)
        else:
            move_terms(tables, work, g)
    return 0


@inlined
def factor(tables, work, first, end):
    """Factors of the inertias of a group, whose blocks are ``first`` to ``end``."""
    blocks, size = tables.blocks, ARTICULATED_LANES // LANES
    for b in range(end - 1, first - 1, -1):
        if blocks.start[b] == FLOATING_BASE:
            factor_base(tables, work, b)
            continue
        factor_inwards(tables, work, b)
        if blocks.start[b] == LINK:
            add_to_parents(blocks, b, work.articulated_sum, work.articulated, 0, size)


@kernel
def load_joints(tables, work):
    """Positions and velocities of every lane's joint, sine and cosine of its angle."""
    for k in range(tables.sources.size):
        joint = tables.sources[k]
        work.angle[k] = work.angles[joint]
        work.rate[k] = work.rates[joint]
    if write_sines(work.angle, tables.turns, work.sine, work.cosine) > 0:
        for k in range(tables.sources.size):
            angle = work.angle[k] * tables.turns[k]
            if not abs(angle) <= FAR:
                work.sine[k], work.cosine[k] = math.sin(angle), math.cos(angle)


@kernel
def outwards(tables, work, b):
    """Columns, inertias and forces of the links of one block; Jacobians, poses and motions."""
    blocks, constants, leaves = tables.blocks, tables.constants, work.leaves
    gravity, origin = broadcast_vector(tables.gravity), vector_at(work.origins[b], 0)
    axes, p, twist, rate_of_twist = base_frame(gravity)
    first, row = blocks.first_joint[b], blocks.first_link[b] + blocks.ancestors[b]
    if blocks.start[b] == LINK:
        gather_start(tables, work, b)
    if blocks.start[b] != FIXED_BASE:
        start = open_frame(work.start, 0)
        axes, p, twist, rate_of_twist = start.axes, start.origin, start.twist, start.rate
    jacobian, pose = LANES * blocks.jacobian[b], LANES * blocks.poses[b]
    motion = LANES * blocks.motions[b]
    for k in range(blocks.joints[b]):
        lanes = LANES * (first + k)
        joint = open_joint(constants, JOINT_LANES * (first + k))
        link, rate = open_link(work.links, LINK_LANES * (row + k)), load_pack(work.rate, lanes)
        axes, p = next_frame(
            joint, axes, p, load_pack(work.angle, lanes), load_pack(work.sine, lanes),
            load_pack(work.cosine, lanes),
        )  # fmt: skip
        linear, angular = column_of(joint, axes[2], p)
        link.column = linear, angular
        about_world = open_jacobian(leaves, jacobian + JACOBIAN_LANES * k)
        about_world.column = add_cross(linear, origin, angular), angular
        step = scale(rate, linear), scale(rate, angular)
        rate_of_twist = add_twist_product(rate_of_twist, twist, step)
        twist = add_pair(twist, step)
        inertia = link_inertia(joint, axes, p)
        link.force = inertial_force(inertia, twist, rate_of_twist)
        link.mass, link.moment, link.second = moments(inertia)
        if tables.wanted.poses:
            placed = open_pose(leaves, pose + POSE_LANES * k)
            placed.axes, placed.origin = compose(axes, joint.link_axes), add(p, origin)
        if tables.carries[first + k] >= 0:
            at = motion + BODY_LANES * tables.carries[first + k]
            write_motion(
                open_body(leaves, at), compose(axes, joint.link_axes), p, origin, twist,
                rate_of_twist, gravity,
            )  # fmt: skip
        if tables.divides[first + k]:
            frame = open_frame(work.frames, FRAME_LANES * (row + k))
            frame.axes, frame.origin, frame.twist, frame.rate = axes, p, twist, rate_of_twist
            if tables.wanted.factors:
                begin_articulated(work.articulated, row + k, link.mass, link.moment, link.second)


@inlined
def base_frame(gravity):
    """Axes, origin, twist and rate of the twist with which branches begin at a fixed base."""
    one, none, zero = broadcast(1.0), broadcast(0.0), zero_vector()
    axes = (one, none, none), (none, one, none), (none, none, one)
    return axes, zero, (zero, zero), (sub(zero, gravity), zero)


@inlined
def gather_start(tables, work, b):
    """Copy the frames with which the lanes of a block begin."""
    size = FRAME_LANES // LANES
    copy_lanes(work.frames, size, size, tables.blocks.parents[b], work.start, 0)


@kernel
def place_bases(tables, work, g):
    """Begin with the floating bases of a group: their frames, and where all its blocks are."""
    blocks, groups, zero = tables.blocks, tables.groups, (0.0, 0.0, 0.0)
    gravity = vec(tables.gravity, 0)
    b = groups.first_block[g]
    for lane in range(LANES):
        base, rate = blocks.base[b, lane], blocks.base_rate[b, lane]
        x, y, z = rotation_of(work.base_poses[base, 3:7])
        v, omega = vec(work.rates, rate), vec(work.rates, rate + 3)
        axes = lane + LANES * FRAME_AXES
        put_lane(work.start, axes, x)
        put_lane(work.start, axes + 3 * LANES, y)
        put_lane(work.start, axes + 6 * LANES, z)
        put_lane(work.start, lane + LANES * FRAME_ORIGIN, zero)
        twist, twist_rate = lane + LANES * FRAME_TWIST, lane + LANES * FRAME_RATE
        put_lane(work.start, twist, v)
        put_lane(work.start, twist + 3 * LANES, omega)
        put_lane(work.start, twist_rate, sub(cross(v, omega), gravity))
        put_lane(work.start, twist_rate + 3 * LANES, zero)
    for b in range(groups.first_block[g], groups.first_block[g + 1]):
        for lane in range(LANES):
            for k in range(3):
                pose = work.base_poses[blocks.base[b, lane]]
                work.origins[b, LANES * k + lane] = pose[k]


@inlined
def gather_columns(tables, work, b):
    """Copy the columns of the ancestors of a block, each lane's own."""
    blocks, size = tables.blocks, LINK_LANES // LANES
    for k in range(blocks.ancestors[b]):
        places, at = blocks.lineage[blocks.first_ancestor[b] + k], blocks.first_link[b] + k
        copy_lanes(work.links, size, LINK_SUMS, places, work.links, LINK_LANES * at)


@inlined
def copy_lanes(scratch, size, count, places, out, at):
    """Copy the first packs of a row of ``size``, each of whose lanes is in another place."""
    at0, at1, at2, at3 = (
        place_in(size, places[0]), place_in(size, places[1]), place_in(size, places[2]),
        place_in(size, places[3]),
    )  # fmt: skip
    for k in range(0, LANES * count, LANES):
        store_pack(out, at + k, gather_pack(scratch, at0 + k, at1 + k, at2 + k, at3 + k))


@inlined
def place_in(size, place):
    """The first number of a lane in scratch with ``size`` packs a row."""
    return LANES * size * (place // LANES) + place % LANES


@kernel
def inwards(tables, work, b):
    """Bias, inertia and energy of one block; gravity torques if wanted."""
    blocks, constants, links, leaves = tables.blocks, tables.constants, work.links, work.leaves
    gravity = broadcast_vector(tables.gravity)
    n, first, zero = blocks.joints[b], blocks.first_joint[b], zero_vector()
    before, row = blocks.ancestors[b], blocks.first_link[b]
    inertia, bias, gravity_torque = blocks.inertia[b], blocks.bias[b], blocks.gravity_torque[b]
    base = blocks.base_columns[b]
    whole = tables.wanted.inertias or blocks.factors[b] == 0  # those of plain arms have none
    if whole:
        gather_columns(tables, work, b)
    mass, moment, force = broadcast(0.0), zero, (zero, zero)
    second = zero + zero
    for j in range(n - 1, -1, -1):
        link = open_link(links, LINK_LANES * (row + before + j))
        mass, moment = mass + link.mass, add(moment, link.moment)
        second, force = add_symmetric(second, link.second), add_pair(force, link.force)
        column = link.column
        store_pack(leaves, LANES * (bias + j), power(column, force))
        if whole:
            # momentum of the composite body for a unit rate of the joint
            momentum = times_inertia(mass, moment, second, column)
            at = LANES * (inertia + (base + before + n) * j)
            if base > 0:
                store_pair(leaves, at, momentum)
                at += LANES * base
            for k in range(before + j):
                ancestor = open_link(links, LINK_LANES * (row + k))
                store_pack(leaves, at + LANES * k, power(ancestor.column, momentum))
            drive = open_joint(constants, JOINT_LANES * (first + j)).armature
            store_pack(leaves, at + LANES * (before + j), power(column, momentum) + drive)
        if tables.wanted.gravity_torque:
            weight = scale(mass, gravity), cross(moment, gravity)
            held = broadcast(0.0) - power(column, weight)
            store_pack(leaves, LANES * (gravity_torque + j), held)
    if blocks.start[b] == LINK:
        sums = open_link(work.link_sum, 0)
        sums.mass, sums.moment, sums.second, sums.force = mass, moment, second, force
        add_to_parents(blocks, b, work.link_sum, links, LINK_SUMS, LINK_LANES // LANES)
    else:
        write_energy(tables, work, b, mass, moment)


@inlined
def write_base_columns(k, axis, origin, mass, moment, second, tables, b, leaves):
    """Rows of the inertia and columns of the Jacobian along and about axis number ``k``."""
    blocks, zero, width = tables.blocks, zero_vector(), 6 * LANES
    at, jacobian = LANES * blocks.inertia[b] + width * k, LANES * blocks.jacobian[b] + width * k
    if tables.wanted.inertias:
        store_pair(leaves, at, (scale(mass, axis), zero))
        store_pair(leaves, at + 3 * width, times_inertia(mass, moment, second, (zero, axis)))
    store_pair(leaves, jacobian, (axis, zero))
    store_pair(leaves, jacobian + 3 * width, (cross(origin, axis), axis))


@inlined
def write_energy(tables, work, b, mass, moment):
    """Write the potential energy of a block, all of whose robots' masses have been summed."""
    gravity = broadcast_vector(tables.gravity)
    moment = add_scaled(moment, mass, vector_at(work.origins[b], 0))
    store_pack(work.leaves, LANES * tables.blocks.energy[b], broadcast(0.0) - dot(moment, gravity))


@kernel
def write_base_terms(tables, work, b):
    """What :func:`inwards` writes, and Jacobians, of a block of floating bases."""
    blocks, leaves = tables.blocks, work.leaves
    gravity, origin = broadcast_vector(tables.gravity), vector_at(work.origins[b], 0)
    link = open_link(work.links, LINK_LANES * blocks.first_link[b])
    mass, moment, second = link.mass, link.moment, link.second
    store_pair(leaves, LANES * blocks.bias[b], link.force)
    one, none, zero = broadcast(1.0), broadcast(0.0), zero_vector()
    write_base_columns(0, (one, none, none), origin, mass, moment, second, tables, b, leaves)
    write_base_columns(1, (none, one, none), origin, mass, moment, second, tables, b, leaves)
    write_base_columns(2, (none, none, one), origin, mass, moment, second, tables, b, leaves)
    if tables.wanted.gravity_torque:
        held = sub(zero, scale(mass, gravity)), cross(gravity, moment)
        store_pair(leaves, LANES * blocks.gravity_torque[b], held)
    write_energy(tables, work, b, mass, moment)


@inlined
def add_to_parents(blocks, b, sums, scratch, first, size):
    """Add what a block sums up, from number ``first`` of a row on, to the rows of its parents.

    The last lane is the first: so the order of sums does not depend on how branches share blocks.
    """
    for lane in range(blocks.branches[b] - 1, -1, -1):
        at = place_in(size, blocks.parents[b, lane])
        for k in range(LANES * first, LANES * size, LANES):
            scratch[at + k] += sums[k + lane]


@inlined
def transpose_terms(tables, work, g):
    """Copy the terms of each arm of a group of plain arms from the lanes to its own array."""
    groups, b = tables.groups, tables.groups.first_block[g]
    width, rows = groups.term_count[g], groups.bodies[g]
    written = width if tables.wanted.poses else tables.blocks.poses[b]
    transpose_to_robots(work.leaves, 0, written, work.terms, groups.first_term[g], width)
    for k in range(0, BODY_WIDTH, LANES):
        transpose_four(
            work.leaves, LANES * (width + k), work.bodies, BODY_WIDTH * rows[0] + k,
            BODY_WIDTH * rows[1] + k, BODY_WIDTH * rows[2] + k, BODY_WIDTH * rows[3] + k,
        )  # fmt: skip


@inlined
def transpose_to_robots(leaves, at, count, out, first, width):
    """Copy ``count`` numbers of each lane to an array in which a robot has ``width``."""
    for k in range(0, count, LANES):
        transpose_four(
            leaves, at + LANES * k, out, first + k, first + width + k, first + 2 * width + k,
            first + 3 * width + k,
        )  # fmt: skip


@inlined
def move_terms(tables, work, g):
    """Move the leaves of a group of trees to the robots' terms, and to the bodies."""
    move(work.leaves, tables.groups.terms, g, work.terms)
    if tables.wanted.gravity_torque:
        move(work.leaves, tables.groups.gravity_torques, g, work.terms)
    if tables.wanted.inertias:
        move(work.leaves, tables.groups.inertias, g, work.terms)
    if tables.wanted.factors:
        move(work.leaves, tables.groups.factors, g, work.terms)
    if tables.wanted.poses:
        move(work.leaves, tables.groups.poses, g, work.terms)
    motions = tables.groups.motions
    for m in range(motions.first[g], motions.first[g + 1]):
        source, target = motions.sources[m], motions.targets[m]
        for k in range(BODY_WIDTH):
            work.bodies[target + k] = work.leaves[source + LANES * k]


@kernel
def move(leaves, moves, g, out):
    """Move numbers of the leaves of a group."""
    for k in range(moves.first_quad[g], moves.first_quad[g + 1]):
        to = moves.places[k]
        transpose_four(leaves, moves.quads[k], out, to[0], to[1], to[2], to[3])
    for k in range(moves.first_single[g], moves.first_single[g + 1]):
        out[moves.targets[k]] = leaves[moves.sources[k]]


# --- vectorised sine and cosine ------------------------------------------------------------------
#
# The angle is reduced to |y| <= pi/4 by subtracting the nearest multiple of pi/2 = P1 + P2 + P3,
# whose first two parts are so short that their products are exact (W.J. Cody, W. Waite, Software
# Manual for the Elementary Functions, 1980).  There the polynomials of FreeBSD's library
# (S. Moshier, K.C. Ng; k_sin.c, k_cos.c) are accurate to one unit in the last place, given the
# rounding error of y.

# Angles beyond this need more digits of pi [rad].
FAR = 1e5
# Parts of pi/2: 33 digits each, and the rest.
_P1, _P2, _P3 = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
_PER_QUARTER = 6.36619772367581382433e-01  # 2/pi
# Adding and subtracting this rounds to the nearest whole number.
_ROUND = 6755399441055744.0
_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


@kernel
def write_sines(angle, factor, sine, cosine):
    """Sine and cosine of ``angle * factor``; returns how many angles are beyond ``FAR`` (or NaN).

    Their results are invalid.
    """
    far = 0
    for k in range(angle.size):
        x = angle[k] * factor[k]
        far += 0 if abs(x) <= FAR else 1
        quarters = (x * _PER_QUARTER + _ROUND) - _ROUND
        r = x - quarters * _P1
        w = quarters * _P2
        y = r - w
        rest = (r - y) - w - quarters * _P3
        r = y + rest
        rest = (y - r) + rest
        y = r
        z = y * y
        p = _S2 + z * (_S3 + z * (_S4 + z * (_S5 + z * _S6)))
        s = y - ((z * (0.5 * rest - z * y * p) - rest) - z * y * _S1)
        p = z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * (_C5 + z * _C6)))))
        half = 0.5 * z
        c = 1.0 - half
        c = c + (((1.0 - c) - half) + (z * p - y * rest))
        # quarters modulo four: 0, 1, 2, 3
        turn = quarters - 4.0 * ((0.25 * quarters - 0.375 + _ROUND) - _ROUND)
        odd = (turn == 1.0) | (turn == 3.0)
        a = c if odd else s
        b = s if odd else c
        sine[k] = -a if turn >= 2.0 else a
        cosine[k] = -b if (turn == 1.0) | (turn == 2.0) else b
    return far


# --- numbers in the four lanes --------------------------------------------------------------------


@inlined
def vector_at(array, at):
    """Vector in three consecutive lanes."""
    return load_pack(array, at), load_pack(array, at + LANES), load_pack(array, at + 2 * LANES)


@inlined
def zero_vector():
    """The vector zero."""
    zero = broadcast(0.0)
    return zero, zero, zero


@inlined
def store_pair(array, at, pair):
    """Write a twist or a wrench into six consecutive lanes."""
    store_vector(array, at, pair[0])
    store_vector(array, at + 3 * LANES, pair[1])


@inlined
def store_vector(array, at, a):
    """Write a vector into three consecutive lanes."""
    store_pack(array, at, a[0])
    store_pack(array, at + LANES, a[1])
    store_pack(array, at + 2 * LANES, a[2])


@inlined
def put_lane(array, at, a):
    """Write a vector of plain numbers into one lane of three."""
    array[at], array[at + LANES], array[at + 2 * LANES] = a
