r"""Derivatives of robots: of the motion of their links, of the inverse dynamics.

A robot is a tree of rigid bodies with the equations of :mod:`multiarm.robots.chain`;
:math:`\times^*` is the product of a twist and a wrench.  Outwards, with the base accelerated by
minus gravity, and with p the parent of joint j,

.. math::
    v_j = v_p + S_j \dot q_j, \qquad
    a_j = a_p + S_j \ddot q_j + v_j \times S_j \dot q_j, \\
    \dot\Psi_j = v_j \times S_j, \qquad
    \ddot\Psi_j = a_j \times S_j + v_j \times \dot\Psi_j .

*A link* with twist v and acceleration a moves, for a displacement of a joint of its *chain*, which
are the joints from the base to the link,

.. math::
    \delta v &= \dot\Psi_j + S_j\times v, \qquad
    \delta a = \ddot\Psi_j + \dot\Psi_j\times v + S_j\times a \quad &&\text{(of its position)} \\
    \delta v &= S_j, \qquad \delta a = 2\dot\Psi_j + S_j\times v \quad &&\text{(of its rate)} ,

and not at all for one of any other joint.

*Inverse dynamics.*  The force f that moves a link changes with its twist by
:math:`2 B m + I (v\times m)`, I the inertia about the base.  Inwards, I, B and f of all links
beyond a joint are summed, f without the loads that are fixed in these links.  For j in the chain
of i,

.. math::
    \frac{\partial\tau_j}{\partial q_i} &= S_j\cdot(I\ddot\Psi_i + 2B\dot\Psi_i + S_i\times^* f),
    \qquad & \frac{\partial\tau_i}{\partial q_j} &= S_i\cdot(I\ddot\Psi_j + 2B\dot\Psi_j) \\
    \frac{\partial\tau_j}{\partial\dot q_i} &= S_j\cdot 2(I\dot\Psi_i + B S_i),
    \qquad & \frac{\partial\tau_i}{\partial\dot q_j} &= S_i\cdot 2(I\dot\Psi_j + B S_j) ;

for joints of two branches all four are zero.

*A floating base* is moved by six numbers, its displacement in world axes, and its velocities are
its twist.  Twists here are about where its origin is.  Of its columns :math:`S = (e, 0)` and
:math:`(0, e)` the latter neither turn with the base nor with each other, while its twist
:math:`v_0 = (v, \omega)` and acceleration stay what they are where it is displaced.  So the
formulas hold with :math:`\dot\Psi = \ddot\Psi = 0` for a shift, and

.. math::
    \dot\Psi = v_0 \times S, \qquad \ddot\Psi = a_0 \times S + v_0 \times \dot\Psi

for a turn, with all of the base's velocity and acceleration; by its angular velocity with

.. math:: \dot\Phi = (v\times e, \tfrac12\,\omega\times e)

in place of :math:`\dot\Psi`, as turns about the axes of the world are no rates of coordinates.
Three entries remain, as its own columns do not turn: the moment on the base by its turns has
:math:`S_k\cdot(S_j\times^* f)` also for :math:`k > j`.

Reference: S. Singh, R.P. Russell, P.M. Wensing, Efficient Analytical Derivatives of Rigid-Body
Dynamics Using Spatial Vector Algebra, IEEE Robotics and Automation Letters 7, 2022; written out
here for joints with one degree of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import open_body
from multiarm.jit.kernels import clear, inlined, kernel
from multiarm.jit.rows import Axes, Number, Pair, Rotation, Symmetric, Vector, row_of, width
from multiarm.jit.structs import Floats1, Floats2, Ints1
from multiarm.jit.vectors import (
    AXES,
    ZERO,
    add,
    add_cross,
    add_rotated,
    add_scaled,
    add_symmetric,
    compose,
    cross,
    dot,
    put,
    rotate,
    rotate_back,
    scale,
    sub,
    vec,
)
from multiarm.robots.chain import (
    JOINT_WIDTH,
    ChainJoint,
    add_pair,
    add_scaled_pair,
    chain_joints,
    column_of,
    inertial_force,
    joints_at_rest,
    link_inertia,
    moments,
    next_frame,
    power,
    sub_pair,
    times_inertia,
    twice_turning_matrix,
    twist_product,
    write_motion,
)
from multiarm.robots.terms import BASE_DOF, TreeStructure
from multiarm.spatial import rotation_of


class Displacement(NamedTuple):
    """Derivative of a :class:`multiarm.contacts.motion.BodyMotion` by one coordinate."""

    shift: Vector
    turn: Vector
    velocity: Vector
    spin: Vector
    acceleration: Vector
    spin_rate: Vector


class Link(NamedTuple):
    """A joint and its link: their motion; then, of all links beyond, their inertia and force."""

    axes: Axes  # of the joint's frame
    rotation: Rotation  # axes of the link
    origin: Vector
    column: Pair
    twist: Pair
    rate: Pair  # of the twist
    column_rate: Pair  # by its position
    column_drift: Pair  # the same by its rate
    column_acceleration: Pair
    mass: Number
    moment: Vector
    second: Symmetric
    momentum: Vector  # linear
    turning: Axes  # the matrix G
    force: Pair


DISPLACEMENT_WIDTH, LINK_WIDTH = width(Displacement), width(Link)
open_displacement, open_joint = row_of(Displacement), row_of(ChainJoint)
open_link = row_of(Link)


class TreeLinks(NamedTuple):
    """Joints and links of all blocks, which have one tree, or several of robots that are joined.

    Attributes
    ----------
    first : int64 ndarray, shape (n + 1,)
        First joint of each block.
    first_tree : int64 ndarray, shape (n + 1,)
        First tree of each block.
    roots : int64 ndarray, shape (T + 1,)
        First joint of each tree.
    parents : int64 ndarray, shape (joints,)
        As in :class:`multiarm.robots.terms.TreeStructure`, counted from the block's first joint.
    joints : ndarray, shape (joints, 34)
        Every :class:`multiarm.robots.chain.ChainJoint`.
    bases : ndarray, shape (T, 3)
        Origins of the first joints in the world [m]; of floating bases where they were at the last
        call of :func:`write_motions`.
    floats : int64 ndarray, shape (T,)
        Number of the floating base of each tree, which is then its first six joints; -1 without.
    gravity : ndarray, shape (3,)
    """

    first: Ints1
    first_tree: Ints1
    roots: Ints1
    parents: Ints1
    joints: Floats2
    bases: Floats2
    floats: Ints1
    gravity: Floats1


def tree_links(blocks: Sequence[Sequence[TreeStructure]], gravity: np.ndarray) -> TreeLinks:
    """The joints and links of the trees of some blocks, which may be none."""
    trees = [tree for block in blocks for tree in block]
    floats = np.array([tree.base_floats for tree in trees], dtype=bool)
    roots = np.cumsum([0, *(tree.dof for tree in trees)]).astype(np.int64)
    first_tree = np.cumsum([0, *map(len, blocks)]).astype(np.int64)
    first, parents = roots[first_tree], np.zeros(roots[-1], dtype=np.int64)
    for tree, begin, end in zip(trees, roots[:-1], roots[1:], strict=True):
        before = begin - first[np.searchsorted(first, begin, side="right") - 1]
        of_tree = _parents_of_numbers(tree)
        parents[begin:end] = np.where(of_tree < 0, -1, before + of_tree)
    return TreeLinks(
        first,
        first_tree,
        roots,
        parents,
        np.concatenate([np.zeros((0, JOINT_WIDTH)), *map(_joints_of_numbers, trees)]),
        np.reshape([tree.translations[0] for tree in trees], (-1, 3)),
        np.where(floats, np.cumsum(floats) - 1, -1),
        np.array(gravity, dtype=float),
    )


def _parents_of_numbers(robot: TreeStructure) -> np.ndarray:
    """Parents of a robot's joints, where a floating base is six, one after the other."""
    if not robot.base_floats:
        return robot.parents
    return np.append(np.arange(-1, BASE_DOF - 1), robot.parents[1:] + BASE_DOF - 1)


def _joints_of_numbers(robot: TreeStructure) -> np.ndarray:
    """The same of :func:`multiarm.robots.chain.chain_joints`: the sixth carries the base."""
    joints = chain_joints(robot)
    if not robot.base_floats:
        return joints
    return np.vstack([joints_at_rest(BASE_DOF - 1), joints])


@kernel
def write_motions(links, i, base_poses, angles, rates, accelerations, scratch):
    """Write the motions of a block's links.

    Parameters
    ----------
    links : view of TreeLinks
    i : int
        Number of the block.
    base_poses : (B, 7)
        Position and quaternion xyzw of every floating base.
    angles, rates, accelerations : (joints,)
        Of all robots.
    scratch : (n_i, 85), written
        Every :class:`Link`.
    """
    for t in range(links.first_tree[i], links.first_tree[i + 1]):
        _write_tree(links, i, t, base_poses, angles, rates, accelerations, scratch)


@inlined
def _write_tree(links, i, t, base_poses, angles, rates, accelerations, scratch):
    """Write the motions of the links of tree ``t``, one of block ``i``."""
    d0, first = links.first[i], links.roots[t] - links.first[i]
    at_base = (scale(-1.0, vec(links.gravity, 0)), ZERO)
    if links.floats[t] >= 0:
        pose = base_poses[links.floats[t]]
        _write_base(links, t, pose, rates, accelerations, scratch[first:])
        first += BASE_DOF
    for k in range(first, links.roots[t + 1] - d0):
        joint, link, q = open_joint(links.joints[d0 + k]), open_link(scratch[k]), angles[d0 + k]
        angle, parent = joint.turns * q, links.parents[d0 + k]
        axes, p, twist, rate = AXES, ZERO, (ZERO, ZERO), at_base
        if parent >= 0:
            before = open_link(scratch[parent])
            axes, p, twist, rate = before.axes, before.origin, before.twist, before.rate
        axes, p = next_frame(joint, axes, p, q, math.sin(angle), math.cos(angle))
        S = column_of(joint, axes[2], p)
        twist = add_scaled_pair(twist, rates[d0 + k], S)
        column_rate = twist_product(twist, S)
        rate = add_scaled_pair(rate, accelerations[d0 + k], S)
        rate = add_scaled_pair(rate, rates[d0 + k], column_rate)
        link.rotation, link.column = compose(axes, joint.link_axes), S
        link.column_rate = link.column_drift = column_rate
        link.column_acceleration = add_pair(
            twist_product(rate, S), twist_product(twist, column_rate)
        )
        _move_link(joint, axes, p, twist, rate, link)


@inlined
def _write_base(links, t, pose, rates, accelerations, scratch):
    """Write the motions of the six joints of a floating base, of which the last has its link."""
    d0, R = links.roots[t], rotation_of(pose[3:7])
    put(links.bases[t], 0, vec(pose, 0))
    v, w = vec(rates, d0), vec(rates, d0 + 3)
    a = sub(sub(vec(accelerations, d0), vec(links.gravity, 0)), cross(w, v))
    twist, rate = (v, w), (a, vec(accelerations, d0 + 3))
    for k in range(BASE_DOF):
        joint, link = open_joint(links.joints[d0 + k]), open_link(scratch[k])
        e, S = AXES[k % 3], (AXES[k % 3], ZERO)
        column_rate = drift = column_acceleration = (ZERO, ZERO)
        if k >= 3:
            S = (ZERO, e)
            column_rate, drift = twist_product(twist, S), (cross(v, e), scale(0.5, cross(w, e)))
            column_acceleration = add_pair(
                twist_product(rate, S), twist_product(twist, column_rate)
            )
        link.rotation, link.column = R, S
        link.column_rate, link.column_drift = column_rate, drift
        link.column_acceleration = column_acceleration
        Q = joint.link_axes
        axes = compose(
            R, (rotate_back(Q, AXES[0]), rotate_back(Q, AXES[1]), rotate_back(Q, AXES[2]))
        )
        _move_link(joint, axes, ZERO, twist, rate, link)


@inlined
def _move_link(joint, axes, p, twist, rate, link):
    """Write the motion of a joint's link, its inertia and the force that moves it."""
    link.axes, link.origin, link.twist, link.rate = axes, p, twist, rate
    inertia = link_inertia(joint, axes, p)
    mass, moment, second = moments(inertia)
    link.mass, link.moment, link.second = mass, moment, second
    link.momentum, _ = times_inertia(mass, moment, second, twist)
    link.turning = twice_turning_matrix(moment, second, twist[0], twist[1])
    link.force = inertial_force(inertia, twist, rate)


@kernel
def write_link(links, i, k, scratch, body, moved):
    """Write the motion of link ``k`` of a block, and how the joints of the block displace it.

    After :func:`write_motions` with the same scratch.

    Parameters
    ----------
    body : (24,), written
        Its :class:`multiarm.contacts.motion.BodyMotion`.
    moved : (2 n_i, 18), written
        Its :class:`Displacement` by the positions, and by the velocities, world axes.
    """
    d0, n = links.first[i], links.first[i + 1] - links.first[i]
    for j in range(2 * n):
        clear(moved[j])
    t = links.first_tree[i]
    while links.roots[t + 1] <= d0 + k:
        t += 1
    link, base, gravity = open_link(scratch[k]), vec(links.bases[t], 0), vec(links.gravity, 0)
    p, twist, rate = link.origin, link.twist, link.rate
    write_motion(open_body(body), link.rotation, p, base, twist, rate, gravity)
    j = k
    while j >= 0:
        displace_by_position(open_link(scratch[j]), p, twist, rate, open_displacement(moved[j]))
        displace_by_rate(open_link(scratch[j]), p, twist, open_displacement(moved[n + j]))
        j = links.parents[d0 + j]


@inlined
def displace_by_position(link, p, twist, rate, out):
    """Write how a link with origin ``p`` is displaced by the position of a joint before it."""
    (v, w), alpha = twist, rate[1]
    S, column_rate = link.column, link.column_rate
    of_twist = add_pair(column_rate, twist_product(S, twist))
    of_rate = add_pair(twist_product(column_rate, twist), twist_product(S, rate))
    of_rate = add_pair(link.column_acceleration, of_rate)
    u, shift = add_cross(v, w, p), add_cross(S[0], S[1], p)
    of_u = add_cross(add_cross(of_twist[0], of_twist[1], p), w, shift)
    rate_of_u = add_cross(add_cross(of_rate[0], of_rate[1], p), alpha, shift)
    out.shift, out.turn = shift, S[1]
    out.velocity, out.spin = of_u, of_twist[1]
    out.acceleration = add_cross(add_cross(rate_of_u, of_twist[1], u), w, of_u)
    out.spin_rate = of_rate[1]


@inlined
def displace_by_rate(link, p, twist, out):
    """Write how its motion changes with the rate of that joint: the pose does not."""
    (v, w), S = twist, link.column
    # the origin moves by ``shift`` in a unit of time
    u, shift = add_cross(v, w, p), add_cross(S[0], S[1], p)
    of_rate = add_scaled_pair(twist_product(S, twist), 2.0, link.column_drift)
    rate_of_u = add_cross(add_cross(of_rate[0], of_rate[1], p), S[1], u)
    out.velocity, out.spin = shift, S[1]
    out.acceleration, out.spin_rate = add_cross(rate_of_u, w, shift), of_rate[1]


@kernel
def subtract_load(k, wrench, scratch):
    """Subtract a wrench (6,) on link ``k`` from the forces that move the block's links.

    After :func:`write_motions`, before :func:`write_inverse_dynamics`.  The wrench is about the
    link's origin in its axes [N, N m], and stays constant in these.
    """
    link = open_link(scratch[k])
    link.force = sub_pair(link.force, _about_base(link, wrench))


@kernel
def write_inverse_dynamics(links, i, scratch, by_q, by_v):
    """Write the derivatives of a block's inverse dynamics, ``M q'' + b - J^T f``.

    By positions and velocities, (n_i, n_i) each, after :func:`write_motions`, and after
    :func:`subtract_load` for every wrench f on a link, with the same scratch, which is used up.
    """
    d0, n = links.first[i], links.first[i + 1] - links.first[i]
    for k in range(n):
        clear(by_q[k])
        clear(by_v[k])
    for k in range(n - 1, -1, -1):
        link = open_link(scratch[k])
        S, rate, drift, f = link.column, link.column_rate, link.column_drift, link.force
        m, h, inertia = link.mass, link.moment, link.second
        P, G = link.momentum, link.turning
        # the columns of the joint
        of_q = times_inertia(m, h, inertia, link.column_acceleration)
        of_q = (
            add_cross(add_scaled(of_q[0], 2.0, cross(rate[1], P)), S[1], f[0]),
            add_rotated(add_cross(add_cross(of_q[1], S[1], f[1]), S[0], f[0]), G, rate[1]),
        )
        of_v = times_inertia(m, h, inertia, drift)
        of_v = (
            scale(2.0, add_cross(of_v[0], S[1], P)),
            add_rotated(scale(2.0, of_v[1]), G, S[1]),
        )
        # its rows, by twists and accelerations of the joints before
        momentum = times_inertia(m, h, inertia, S)
        turning = add_scaled(rotate_back(G, S[1]), 2.0, cross(P, S[0]))
        by_q[k, k], by_v[k, k] = power(S, of_q), power(S, of_v)
        j = parent = links.parents[d0 + k]
        while j >= 0:
            before = open_link(scratch[j])
            S_j, rate_j = before.column, before.column_rate
            by_q[j, k], by_v[j, k] = power(S_j, of_q), power(S_j, of_v)
            by_q[k, j] = power(before.column_acceleration, momentum) + dot(rate_j[1], turning)
            by_v[k, j] = 2.0 * power(before.column_drift, momentum) + dot(S_j[1], turning)
            j = links.parents[d0 + j]
        if parent >= 0:
            _add_beyond(open_link(scratch[parent]), link)
    for t in range(links.first_tree[i], links.first_tree[i + 1]):
        if links.floats[t] >= 0:
            a = links.roots[t] - d0 + 3  # the first of the base's turns
            x, y, z = open_link(scratch[a - 3]).force[1]
            by_q[a + 1, a] -= z
            by_q[a + 2, a] += y
            by_q[a + 2, a + 1] -= x


@inlined
def _add_beyond(link, beyond):
    """Add inertia and force of the links beyond a link to its own."""
    x, y, z = beyond.turning
    X, Y, Z = link.turning
    link.mass += beyond.mass
    link.moment, link.second = (
        add(link.moment, beyond.moment), add_symmetric(link.second, beyond.second)
    )  # fmt: skip
    link.momentum, link.turning = (
        add(link.momentum, beyond.momentum),
        (add(X, x), add(Y, y), add(Z, z)),
    )
    link.force = add_pair(link.force, beyond.force)


@kernel
def subtract_torques(links, i, k, wrench, scratch, table, column):
    """Subtract the torques of a wrench (6,) on link ``k`` of a block from a column.

    The wrench is about the link's origin in its axes; the torques of joints that do not move the
    link are zero.
    """
    about_base = _about_base(open_link(scratch[k]), wrench)
    d0, j = links.first[i], k
    while j >= 0:
        table[j, column] -= power(open_link(scratch[j]).column, about_base)
        j = links.parents[d0 + j]


@inlined
def _about_base(link, wrench):
    R = link.rotation
    force = rotate(R, vec(wrench, 0))
    return force, add_cross(rotate(R, vec(wrench, 3)), link.origin, force)
