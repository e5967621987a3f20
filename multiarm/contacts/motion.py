r"""Motions of bodies, and of one body as another sees it.

Seen from body B, in world axes, a body A moves with

.. math::
    V_0 &= \dot x_A - \dot x_B - \omega_B \times r_0, \qquad
    \Omega = \omega_A - \omega_B, \qquad
    \Omega' = \dot\omega_A - \dot\omega_B - \omega_B\times\omega_A \\
    A_0 &= \ddot x_A - \ddot x_B - \dot\omega_B\times r_0 - \omega_B\times(\omega_B\times r_0)
         - 2\,\omega_B\times V_0, \qquad r_0 = x_A - x_B

and its point at ``d = P - x_A`` with

.. math::
    V = V_0 + \Omega\times d, \qquad A = A_0 + \Omega'\times d + \Omega\times(\Omega\times d) .
"""

from __future__ import annotations

from typing import NamedTuple

from multiarm.jit.kernels import inlined
from multiarm.jit.rows import Rotation, Vector, row_of, width
from multiarm.jit.vectors import add, add_cross, add_scaled, cross, sub


class BodyMotion(NamedTuple):
    """Pose and motion of a body in world axes; accelerations are classical."""

    rotation: Rotation
    origin: Vector  # [m]
    velocity: Vector  # of the origin [m/s]
    spin: Vector  # [rad/s]
    acceleration: Vector  # of the origin [m/s^2]
    spin_rate: Vector  # [rad/s^2]


class RelativeRow(NamedTuple):
    """Motion of body A seen from body B: ``r_0, V_0, Omega, A_0, Omega'``."""

    shift: Vector
    velocity: Vector
    spin: Vector
    acceleration: Vector
    spin_rate: Vector


BODY_WIDTH, RELATIVE_WIDTH = width(BodyMotion), width(RelativeRow)
open_body, open_relative = row_of(BodyMotion), row_of(RelativeRow)


@inlined
def motion_relative_to(a, b):
    """The entries of :class:`RelativeRow` of body A seen from body B, two :class:`BodyMotion`."""
    w, w_rate, w_a = b.spin, b.spin_rate, a.spin
    r = sub(a.origin, b.origin)
    c = cross(w, r)
    V = sub(sub(a.velocity, b.velocity), c)
    A = sub(sub(a.acceleration, b.acceleration), cross(w_rate, r))
    # w x (w x r) + 2 w x V = w x (c + 2 V)
    A = sub(A, cross(w, add_scaled(c, 2.0, V)))
    return r, V, sub(w_a, w), A, sub(sub(a.spin_rate, w_rate), cross(w, w_a))


@inlined
def write_relative_motion(a, b, out):
    """Write the motion of body A seen from body B into a row ``out`` (15,) of an array.

    ``a`` and ``b`` (24,) are rows too; their accelerations are those at ``q'' = 0``.
    """
    row = open_relative(out)
    row.shift, row.velocity, row.spin, row.acceleration, row.spin_rate = motion_relative_to(
        open_body(a), open_body(b)
    )


@inlined
def motion_at(relative, d):
    """Velocity and acceleration, seen from B, of A's material point at ``d`` from A's origin."""
    row = open_relative(relative)
    turning = cross(row.spin, d)
    A = add_cross(row.acceleration, row.spin_rate, d)
    return add(row.velocity, turning), add_cross(A, row.spin, turning)
