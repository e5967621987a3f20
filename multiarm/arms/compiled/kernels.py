r"""Batched RNEA and CRBA: one outward and one inward sweep along four arms at once.

Every joint rotates about, or slides along, the z axis of its own frame.  All vectors are in world
axes; moments, velocities and columns are about the arm's base, so that no digits are lost far from
the world's origin.  With ``z`` and ``p`` axis and origin of a joint its column is

.. math::
    S_j = \begin{bmatrix} p\times z\\ z\end{bmatrix} \text{ (turning)}, \qquad
    S_j = \begin{bmatrix} z\\ 0\end{bmatrix} \text{ (sliding)}.

Outwards (recursive Newton-Euler; R. Featherstone, Rigid Body Dynamics Algorithms, 2008, 5.3), the
base being accelerated by minus gravity,

.. math::
    v_j = v_{j-1} + S_j \dot q_j, \qquad a_j = a_{j-1} + v_{j-1}\times S_j \dot q_j

and each link needs, with ``c`` its centre, the force

.. math::
    f = m\,(a + \alpha\times c + \omega\times(v + \omega\times c)), \qquad
    n = I\alpha + \omega\times I\omega + c\times f .

Inwards the forces of all links beyond a joint are summed, and their inertias to that of one
composite body (6.2), which gives

.. math::
    b_j = S_j\cdot f_j, \qquad M_{jk} = S_k\cdot I^c_j S_j \quad (k\le j).

Potential energy and gravity torques follow from mass and first moment of the composite bodies.
"""

from __future__ import annotations

import math

from multiarm.arms.compiled.tables import (
    ARMATURE,
    AXES,
    BIAS,
    CENTRE,
    COLUMN,
    ENERGY,
    FIRST,
    FORCE,
    GRAVITY_TORQUE,
    INERTIA,
    JACOBIAN,
    JOINT_WIDTH,
    JOINTS,
    LINK_INERTIA,
    LINK_WIDTH,
    MASS,
    OFFSET,
    PLACES,
    POSES,
    SLIDES,
    TERMS,
    TURNS,
    URDF_AXES,
    WIDTH,
    WITH_GRAVITY_TORQUE,
    WITH_POSES,
    open_arms,
)
from multiarm.contacts.kernel import ACCELERATION, BODY_WIDTH, ORIGIN_AT, VELOCITY
from multiarm.jit.kernels import cfunc, inlined, kernel
from multiarm.jit.simd import LANES, broadcast, load_pack, store_pack, transpose_four
from multiarm.jit.structs import struct_at
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_rotated,
    add_scaled,
    add_symmetric,
    add_times,
    cross,
    dot,
    rotate,
    rotate_symmetric,
    scale,
    sub,
    times,
)


@cfunc
def update_arms(address, size, _a, _b):
    """Write all terms of compiled arms, and the motion of the links that carry their tips."""
    tables, work = open_arms(struct_at(address, size))
    load_joints(tables, work)
    for b in range(tables.blocks.shape[0]):
        outwards(tables, work, b)
        inwards(tables, work, b)
        transpose_terms(tables, work, b)
    return 0


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


@inlined
def place_joint(tables, work, joint, at, axes, p):
    """Axes and origin of a joint's frame from those of the joint before."""
    constants = tables.constants
    sine, cosine = load_pack(work.sine, joint), load_pack(work.cosine, joint)
    p = add_rotated(p, axes, vector_at(constants, at + LANES * OFFSET))
    x = rotate(axes, vector_at(constants, at + LANES * AXES))
    y = rotate(axes, vector_at(constants, at + LANES * (AXES + 3)))
    z = rotate(axes, vector_at(constants, at + LANES * (AXES + 6)))
    p = add_scaled(p, load_pack(constants, at + LANES * SLIDES) * load_pack(work.angle, joint), z)
    backwards = broadcast(0.0) - sine
    axes = add_scaled(scale(cosine, x), sine, y), add_scaled(scale(cosine, y), backwards, x), z
    return axes, p


@inlined
def column(constants, at, z, p):
    """Linear and angular part of a joint's column."""
    angular = scale(load_pack(constants, at + LANES * TURNS), z)
    linear = scale(load_pack(constants, at + LANES * SLIDES), z)
    return add_cross(linear, p, angular), angular


@inlined
def link_inertia(constants, at, axes, p):
    """Mass, centre and inertia about it of a link, world axes."""
    centre = add_rotated(p, axes, vector_at(constants, at + LANES * CENTRE))
    inertia = rotate_symmetric(axes, symmetric_at(constants, at + LANES * INERTIA))
    return load_pack(constants, at + LANES * MASS), centre, inertia


@inlined
def put_link_inertia(links, at, body):
    """Write mass, first moment and second moments ``I + m (c.c - c c^T)`` of a link."""
    mass, c, inertia = body
    moment = scale(mass, c)
    xx, yy, zz = moment[0] * c[0], moment[1] * c[1], moment[2] * c[2]
    xy, xz, yz = moment[0] * c[1], moment[0] * c[2], moment[1] * c[2]
    zero = broadcast(0.0)
    store_pack(links, at, mass)
    put_vector(links, at + LANES, moment)
    shifted = (yy + zz, zero - xy, zero - xz, xx + zz, zero - yz, xx + yy)
    put_symmetric(links, at + 4 * LANES, add_symmetric(inertia, shifted))


@inlined
def put_force(links, at, body, v, w, a, alpha):
    """Write the force that moves a link, and its moment about the base."""
    mass, c, inertia = body
    u = add_cross(v, w, c)
    force = scale(mass, add_cross(add_cross(a, alpha, c), w, u))
    momentum = times(inertia, w)
    moment = add_cross(cross(w, momentum), c, force)
    put_pair(links, at, force, add_times(moment, inertia, alpha))


@kernel
def outwards(tables, work, b):
    """Columns, inertias and forces of the links of one block; Jacobians, poses and bodies."""
    constants, links, leaves, block = tables.constants, work.links, work.leaves, tables.blocks[b]
    zero, gravity = zero_vector(), broadcast_vector(tables.gravity)
    one, none = broadcast(1.0), broadcast(0.0)
    axes, origin = (
        ((one, none, none), (none, one, none), (none, none, one)),
        vector_at(tables.bases[b], 0),
    )
    p = v = w = alpha = zero
    a = sub(zero, gravity)
    joint, link = LANES * block[FIRST], 0
    at, jacobian, pose = JOINT_WIDTH * joint, LANES * block[JACOBIAN], LANES * block[POSES]
    for _ in range(block[JOINTS]):
        rate = load_pack(work.rate, joint)
        axes, p = place_joint(tables, work, joint, at, axes, p)
        linear, angular = column(constants, at, axes[2], p)
        put_pair(links, link + LANES * COLUMN, linear, angular)
        put_pair(leaves, jacobian, add_cross(linear, origin, angular), angular)
        linear, angular = scale(rate, linear), scale(rate, angular)
        a = add_cross(add_cross(a, w, linear), v, angular)
        alpha = add_cross(alpha, w, angular)
        v, w = add(v, linear), add(w, angular)
        body = link_inertia(constants, at, axes, p)
        put_force(links, link + LANES * FORCE, body, v, w, a, alpha)
        put_link_inertia(links, link + LANES * LINK_INERTIA, body)
        if tables.wanted[WITH_POSES] != 0:
            put_columns(leaves, pose, urdf_axes(constants, at, axes))
            put_vector(leaves, pose + LANES * ORIGIN_AT, add(p, origin))
        at, link, joint = at + LANES * JOINT_WIDTH, link + LANES * LINK_WIDTH, joint + LANES
        jacobian, pose = jacobian + 6 * LANES, pose + 12 * LANES
    body = LANES * block[WIDTH]
    put_rows(leaves, body, urdf_axes(constants, at - LANES * JOINT_WIDTH, axes))
    put_vector(leaves, body + LANES * ORIGIN_AT, add(p, origin))
    u = add_cross(v, w, p)
    put_pair(leaves, body + LANES * VELOCITY, u, w)
    a = add_cross(add_cross(a, alpha, p), w, u)
    put_pair(leaves, body + LANES * ACCELERATION, add(a, gravity), alpha)


@inlined
def urdf_axes(constants, at, axes):
    """Axes of a link in its URDF."""
    at += LANES * URDF_AXES
    x, y = vector_at(constants, at), vector_at(constants, at + 3 * LANES)
    z = vector_at(constants, at + 6 * LANES)
    return rotate(axes, x), rotate(axes, y), rotate(axes, z)


@inlined
def times_inertia(mass, moment, second, linear, angular):
    """Momentum of a body, linear and angular, at a velocity."""
    couple = add_times(cross(moment, linear), second, angular)
    return add_cross(scale(mass, linear), angular, moment), couple


@kernel
def inwards(tables, work, b):
    """Bias, inertia and energy of the arms of one block; gravity torques if wanted."""
    constants, links, leaves, block = tables.constants, work.links, work.leaves, tables.blocks[b]
    n, zero, gravity = block[JOINTS], zero_vector(), broadcast_vector(tables.gravity)
    mass, moment, force, couple = broadcast(0.0), zero, zero, zero
    second = zero + zero
    for j in range(n - 1, -1, -1):
        link = LANES * LINK_WIDTH * j
        at = link + LANES * LINK_INERTIA
        mass = mass + load_pack(links, at)
        moment = add(moment, vector_at(links, at + LANES))
        second = add_symmetric(second, symmetric_at(links, at + 4 * LANES))
        at = link + LANES * FORCE
        force = add(force, vector_at(links, at))
        couple = add(couple, vector_at(links, at + 3 * LANES))
        linear, angular = vector_at(links, link), vector_at(links, link + 3 * LANES)
        store_pack(leaves, LANES * (block[BIAS] + j), power(linear, angular, force, couple))
        # momentum of the composite body for a unit rate of the joint
        f, c = times_inertia(mass, moment, second, linear, angular)
        row = LANES * n * j
        for k in range(j):
            at = LANES * LINK_WIDTH * k
            axis = vector_at(links, at), vector_at(links, at + 3 * LANES)
            store_pack(leaves, row + LANES * k, power(axis[0], axis[1], f, c))
        drive = load_pack(constants, LANES * (JOINT_WIDTH * (block[FIRST] + j) + ARMATURE))
        store_pack(leaves, row + LANES * j, power(linear, angular, f, c) + drive)
        if tables.wanted[WITH_GRAVITY_TORQUE] != 0:
            weight = scale(mass, gravity), cross(moment, gravity)
            held = broadcast(0.0) - power(linear, angular, weight[0], weight[1])
            store_pack(leaves, LANES * (block[GRAVITY_TORQUE] + j), held)
    moment = add_scaled(moment, mass, vector_at(tables.bases[b], 0))
    energy = broadcast(0.0) - dot(moment, gravity)
    store_pack(leaves, LANES * block[ENERGY], energy)


@inlined
def transpose_terms(tables, work, b):
    """Copy the terms of each arm of a block from the lanes to the arm's own array."""
    block = tables.blocks[b]
    width, at0 = block[WIDTH], block[TERMS]
    at1, at2, at3 = at0 + width, at0 + 2 * width, at0 + 3 * width
    for k in range(0, width if tables.wanted[WITH_POSES] != 0 else block[POSES], LANES):
        transpose_four(work.leaves, LANES * k, work.terms, at0 + k, at1 + k, at2 + k, at3 + k)
    at0, at1 = BODY_WIDTH * block[PLACES], BODY_WIDTH * block[PLACES + 1]
    at2, at3 = BODY_WIDTH * block[PLACES + 2], BODY_WIDTH * block[PLACES + 3]
    for k in range(0, BODY_WIDTH, LANES):
        source = LANES * (width + k)
        transpose_four(work.leaves, source, work.bodies, at0 + k, at1 + k, at2 + k, at3 + k)


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


# --- vectors and matrices of four arms at once ---------------------------------------------------


@inlined
def vector_at(array, at):
    """Vector in three consecutive lanes."""
    return load_pack(array, at), load_pack(array, at + LANES), load_pack(array, at + 2 * LANES)


@inlined
def put_vector(array, at, a):
    """Write a vector."""
    store_pack(array, at, a[0])
    store_pack(array, at + LANES, a[1])
    store_pack(array, at + 2 * LANES, a[2])


@inlined
def symmetric_at(array, at):
    """Symmetric matrix in six consecutive lanes."""
    xx, xy, xz = vector_at(array, at)
    yy, yz, zz = vector_at(array, at + 3 * LANES)
    return xx, xy, xz, yy, yz, zz


@inlined
def put_symmetric(array, at, A):
    """Write a symmetric matrix."""
    put_vector(array, at, (A[0], A[1], A[2]))
    put_vector(array, at + 3 * LANES, (A[3], A[4], A[5]))


@inlined
def put_pair(array, at, a, b):
    """Write two vectors, one after the other."""
    put_vector(array, at, a)
    put_vector(array, at + 3 * LANES, b)


@inlined
def put_columns(array, at, axes):
    """Write a rotation column by column."""
    put_vector(array, at, axes[0])
    put_vector(array, at + 3 * LANES, axes[1])
    put_vector(array, at + 6 * LANES, axes[2])


@inlined
def put_rows(array, at, axes):
    """Write a rotation row by row."""
    x, y, z = axes
    put_columns(array, at, ((x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2])))


@inlined
def zero_vector():
    """The vector zero."""
    zero = broadcast(0.0)
    return zero, zero, zero


@inlined
def broadcast_vector(a):
    """A vector of plain numbers in all lanes."""
    return broadcast(a[0]), broadcast(a[1]), broadcast(a[2])


@inlined
def power(linear, angular, force, couple):
    """``linear . force + angular . couple``."""
    return dot(linear, force) + dot(angular, couple)
