r"""Trees of rigid bodies: the table of their joints, and the equations of one joint and its link.

Every joint turns about, or slides along, the z axis of its own frame.  All vectors are in world
axes; moments, velocities and columns are about the tree's base, the origin of its first joint, so
that no digits are lost far from the world's origin.  Twists :math:`(v, \omega)` and wrenches are
pairs of vectors, and :math:`\times` is the product of two twists.  With ``z`` and ``p`` axis and
origin of a joint its column is

.. math::
    S_j = \begin{bmatrix} p\times z\\ z\end{bmatrix} \text{ (turning)}, \qquad
    S_j = \begin{bmatrix} z\\ 0\end{bmatrix} \text{ (sliding)}.

The force that moves a link with mass m, centre c and inertia I about it is

.. math::
    f = m\,(a + \alpha\times c + \omega\times(v + \omega\times c)), \qquad
    n = I\alpha + \omega\times I\omega + c\times f .

It changes with the link's twist by :math:`2 B m + I_0 (v\times m)`, where I_0 is the inertia about
the base, m the change, and

.. math::
    B = \tfrac12\big[(v\times^*)\,I_0 - I_0\,(v\times) + (I_0 v)\,\bar\times^*\big]

acts on the angular part of m only, as its other terms cancel by Jacobi's identity.  With linear
momentum p, first moment h and second moments I about the base,

.. math::
    2 B m = \begin{bmatrix} 2\,\omega_m\times p\\ G\,\omega_m\end{bmatrix}, \qquad
    G = [\omega] I + ([\omega] I)^T - [I \omega] - 2\,v h^T + 2\,(h\cdot v)\,1 .

The same functions serve numbers, and packs of four robots (:mod:`multiarm.jit.simd`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.errors import ModelError
from multiarm.geometry.screws import skew
from multiarm.jit.kernels import inlined
from multiarm.jit.rows import Axes, Number, Symmetric, Vector, as_row, fields_of, width
from multiarm.jit.vectors import (
    add,
    add_cross,
    add_rotated,
    add_scaled,
    add_times,
    compose,
    cross,
    dot,
    rotate_symmetric,
    scale,
    sub,
    sub_scaled,
    times,
)
from multiarm.robots.terms import TreeStructure


class ChainJoint(NamedTuple):
    """Constants of a joint, and of the link that it moves in the joint's frame."""

    # its frame at zero in that of its parent; without one, from the tree's base in world axes
    axes: Axes
    offset: Vector  # [m]
    centre: Vector  # [m]
    mass: Number  # [kg]
    inertia: Symmetric  # about the centre [kg m^2]
    turns: Number  # 1 for a joint that turns, else 0
    slides: Number  # 1 for a joint that slides, else 0
    armature: Number  # inertia of its drive [kg m^2 or kg]
    link_axes: Axes  # of the link in its URDF


JOINT_WIDTH = width(ChainJoint)


def chain_joints(robot: TreeStructure) -> np.ndarray:
    """The joints of a robot, shape (n, 34); their parents are ``robot.parents``."""
    rows, turns = [], [_turned_to_z(axis) for axis in robot.axes]
    for k, (parent, turned) in enumerate(zip(robot.parents, turns, strict=True)):
        inertia = turned.T @ robot.inertias[k] @ turned
        if parent < 0:
            in_parent, offset = np.eye(3), robot.translations[k] - robot.translations[0]
        else:
            in_parent = turns[parent].T
            offset = in_parent @ robot.translations[k]
        joint = ChainJoint(
            axes=in_parent @ robot.rotations[k] @ turned,
            offset=offset,
            centre=turned.T @ robot.centres[k],
            mass=robot.masses[k],
            inertia=inertia[np.triu_indices(3)],
            turns=not (robot.slides[k] or robot.floats[k]),
            slides=robot.slides[k],
            armature=robot.armature[k],
            link_axes=turned.T,
        )
        rows.append(as_row(joint))
    return np.array(rows)


def require_chain(robot: TreeStructure, tip_joint: int) -> TreeStructure:
    """The robot, where its joints are a chain and the last one carries the tip.

    ``tip_joint`` is Pinocchio's number of the joint that carries the tip.

    Raises
    ------
    ModelError
        When it has branches, or joints after the tip.
    """
    joints = robot.parents.size
    if not np.array_equal(robot.parents, np.arange(-1, joints - 1)):
        raise ModelError("it has branches")
    if tip_joint != joints:
        raise ModelError("joints follow after its tip")
    return robot


def joints_at_rest(count: int) -> np.ndarray:
    """Joints without motion, mass and extent, shape (count, 34).

    Their drives have an inertia of 1, which has no effect on others.
    """
    rows = np.zeros((count, JOINT_WIDTH))
    joints = fields_of(ChainJoint, rows)
    joints.armature[:] = 1.0
    joints.axes[:] = joints.link_axes[:] = np.eye(3)
    return rows


def _turned_to_z(axis: np.ndarray) -> np.ndarray:
    """A rotation that takes z to the axis."""
    x = skew(np.eye(3)[np.argmin(np.abs(axis))]) @ axis
    x /= np.linalg.norm(x)
    return np.column_stack([x, skew(axis) @ x, axis])


# --- kinematics -----------------------------------------------------------------------------------


@inlined
def frame_after(joint, axes, p):
    """Axes and origin of a joint's frame at zero from those of its parent."""
    return compose(axes, joint.axes), add_rotated(p, axes, joint.offset)


@inlined
def next_frame(joint, axes, p, position, sine, cosine):
    """Axes and origin of a joint's frame from those of its parent.

    ``sine`` and ``cosine`` are those of its angle: 0 and 1 where it slides.
    """
    (x, y, z), p = frame_after(joint, axes, p)
    p = add_scaled(p, joint.slides * position, z)
    turned_y = sub_scaled(scale(cosine, y), sine, x)
    return (add_scaled(scale(cosine, x), sine, y), turned_y, z), p


@inlined
def column_of(joint, z, p):
    """The column of a joint: the twist of its link for a unit rate."""
    angular = scale(joint.turns, z)
    return add_cross(scale(joint.slides, z), p, angular), angular


@inlined
def write_motion(body, rotation, p, base, twist, rate, gravity):
    """Write the motion of a link with origin ``p``, of a tree at ``base`` in the world.

    ``rate`` is that of the twist, with the base accelerated by minus gravity.
    """
    (v, w), (a, alpha) = twist, rate
    u = add_cross(v, w, p)
    body.rotation, body.origin = rotation, add(p, base)
    body.velocity, body.spin = u, w
    body.acceleration = add(add_cross(add_cross(a, alpha, p), w, u), gravity)
    body.spin_rate = alpha


# --- links ----------------------------------------------------------------------------------------


@inlined
def link_inertia(joint, axes, p):
    """Mass, centre and inertia about it of a link, world axes."""
    centre = add_rotated(p, axes, joint.centre)
    return joint.mass, centre, rotate_symmetric(axes, joint.inertia)


@inlined
def moments(body):
    """Mass, first moment ``m c`` and second moments ``I + m (c.c - c c^T)`` of a link."""
    mass, c, I = body
    h = scale(mass, c)
    xx, yy, zz = h[0] * c[0], h[1] * c[1], h[2] * c[2]
    xy, xz, yz = h[0] * c[1], h[0] * c[2], h[1] * c[2]
    second = (I[0] + (yy + zz), I[1] - xy, I[2] - xz, I[3] + (xx + zz), I[4] - yz, I[5] + (xx + yy))
    return mass, h, second


@inlined
def inertial_force(body, twist, rate):
    """The force that moves a link, and its moment about the base."""
    (mass, c, inertia), (v, w), (a, alpha) = body, twist, rate
    u = add_cross(v, w, c)
    force = scale(mass, add_cross(add_cross(a, alpha, c), w, u))
    moment = add_cross(cross(w, times(inertia, w)), c, force)
    return force, add_times(moment, inertia, alpha)


@inlined
def times_inertia(mass, moment, second, twist):
    """Momentum of a body, linear and angular, at a twist."""
    linear, angular = twist
    couple = add_times(cross(moment, linear), second, angular)
    return add_cross(scale(mass, linear), angular, moment), couple


@inlined
def twice_turning_matrix(h, second, v, w):
    """The matrix ``G`` of a link, by columns."""
    xx, xy, xz, yy, yz, zz = second
    X, Y, Z = cross(w, (xx, xy, xz)), cross(w, (xy, yy, yz)), cross(w, (xz, yz, zz))
    L, t = times(second, w), add(v, v)
    p, q, r = h[0] * t[0], h[1] * t[1], h[2] * t[2]
    return (
        (X[0] + X[0] + q + r, X[1] + Y[0] - L[2] - t[1] * h[0], X[2] + Z[0] + L[1] - t[2] * h[0]),
        (Y[0] + X[1] + L[2] - t[0] * h[1], Y[1] + Y[1] + p + r, Y[2] + Z[1] - L[0] - t[2] * h[1]),
        (Z[0] + X[2] - L[1] - t[0] * h[2], Z[1] + Y[2] + L[0] - t[1] * h[2], Z[2] + Z[2] + p + q),
    )


# --- twists and wrenches --------------------------------------------------------------------------


@inlined
def twist_product(a, b):
    """``a x b`` of two twists."""
    return add_cross(cross(a[1], b[0]), a[0], b[1]), cross(a[1], b[1])


@inlined
def add_twist_product(c, a, b):
    """``c + a x b`` of three twists."""
    return add_cross(add_cross(c[0], a[1], b[0]), a[0], b[1]), add_cross(c[1], a[1], b[1])


@inlined
def add_pair(a, b):
    """``a + b`` of two twists or wrenches."""
    return add(a[0], b[0]), add(a[1], b[1])


@inlined
def sub_pair(a, b):
    """``a - b`` of two twists or wrenches."""
    return sub(a[0], b[0]), sub(a[1], b[1])


@inlined
def add_scaled_pair(c, s, a):
    """``c + s a`` of two twists or wrenches."""
    return add_scaled(c[0], s, a[0]), add_scaled(c[1], s, a[1])


@inlined
def power(twist, wrench):
    """Power of a wrench at a twist."""
    return dot(twist[0], wrench[0]) + dot(twist[1], wrench[1])
