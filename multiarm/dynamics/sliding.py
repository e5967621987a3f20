r"""Sliding contacts: the direction of slip, and the reaction matrices with friction.

A sliding contact has a normal force, and friction against its slip: with the slip velocity
:math:`s = |s|\,d` in its two tangents, the force on them is :math:`-\mu\lambda_n d`, so that its
columns of the reaction matrices are

.. math:: \tilde W = W_n - \mu\,(d_1 W_{t1} + d_2 W_{t2}),

of object and arm alike, while its constraint stays along the normal (thesis, footnote to 4.9).  Its
power is :math:`-\mu\lambda_n |s|`.  A contact that holds both ways has the friction
:math:`\mu|\lambda_n|`: while its force pulls, :math:`-\mu` stands for :math:`\mu`.

Where slip comes to rest the direction of :math:`s` reverses.  Within a step the force must be
smooth, so that the step can pass that point and the time be located: of :math:`\pm s` the one
nearer to the last step's direction :math:`d_0` is taken.  Where slip begins, velocities orthogonal
to it decay at the rate :math:`\mu a_n / |s|`, which no method can follow.  With
:math:`s = a d_0 + p`, p orthogonal to :math:`d_0`, and a speed :math:`s_0` below the errors of the
run, the direction is therefore that of

.. math:: m(a)\, d_0 + m'(a)\, p, \qquad
    m(a) = s_0 \left( \tfrac38 + \tfrac34 x^2 - \tfrac18 x^4 \right), \quad x = a / s_0,

where :math:`|a| < s_0`; elsewhere :math:`m(a) = |a|`, which goes on twice differentiably, and the
direction is that of :math:`\pm s`.  The force has full size at any speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from multiarm.contacts.kernel import slip_of
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.equations import update_rows
from multiarm.dynamics.guards import Guards
from multiarm.jit.kernels import copy, inlined, kernel, plain
from multiarm.jit.structs import (
    Float,
    Floats1,
    Floats2,
    Int,
    Ints1,
    Numbers,
    count_entries,
    referenced,
    view,
)


class FrictionNumbers(Numbers):
    """Numbers of all sliding contacts."""

    slow: Float  # the speed ``s_0`` [m/s]
    power: Int  # index of the power of sliding friction in ``data.effects.power``


class Slides(NamedTuple):
    """Sliding contacts, s of them."""

    numbers: FrictionNumbers
    row: Ints1  # among the held rows
    block: Ints1
    tangent: Ints1  # first of two, among the rows of the tangents
    tangent_of_all: Ints1  # the same among all rows
    mu: Floats1  # coefficient of friction; negative where the force pulls
    # (s, 2) direction of slip at the end of the last step, and at the state evaluated last
    direction: Floats2
    turning: Floats2
    speed: Floats1  # along the latter [m/s]
    at_end: Floats2  # (s, 2) direction of slip at the end of this step, until it is accepted


# In the struct of a mode they follow its guards.
open_slides = view(Slides, count_entries(Guards))


@inlined
def slides_of(data):
    """The sliding contacts of the mode of these data."""
    return open_slides(referenced(data.modes.mode))


@plain
def smooth_size(a, slow):
    """``m(a)`` of the module's text, and its first and second derivatives."""
    if abs(a) >= slow:
        return abs(a), math.copysign(1.0, a), 0.0
    x = a / slow
    square = x * x
    size = slow * (0.375 + square * (0.75 - 0.125 * square))
    return size, x * (1.5 - 0.5 * square), 1.5 * (1.0 - square) / slow


@kernel
def write_direction(slides, s, first, second):
    """Direction of slip from its two components, near to the last step's."""
    d0, d1 = slides.direction[s, 0], slides.direction[s, 1]
    along = first * d0 + second * d1
    p0, p1 = first - along * d0, second - along * d1
    smooth, slope, _ = smooth_size(along, slides.numbers.slow)
    e0, e1 = smooth * d0 + slope * p0, smooth * d1 + slope * p1
    size = math.sqrt(e0 * e0 + e1 * e1)
    d0, d1 = e0 / size, e1 / size
    slides.turning[s, 0], slides.turning[s, 1] = d0, d1
    slides.speed[s] = first * d0 + second * d1


@plain
def friction_of_unit_force(slides, s):
    """Friction on the two tangents of a sliding contact for a normal force of 1: ``-mu d``."""
    return -slides.mu[s] * slides.turning[s, 0], -slides.mu[s] * slides.turning[s, 1]


@kernel
def write_reactions(data, work, Wr_o, slides, reactions):
    """Reaction matrices at the kinematics in ``data``, into ``Wr_o`` and ``reactions.Wr``.

    Returns ``OK`` or ``CALLBACK_FAILED``.
    """
    struct = referenced(data.modes.tangents)
    status = update_rows(struct)
    _, sideways, tangents = open_system(struct)
    for k in range(data.rows.W_o.shape[0]):
        for l in range(Wr_o.shape[1]):
            Wr_o[k, l] = data.rows.W_o[k, l]
    for i in range(work.first_joint.size - 1):
        for j in range(work.first_joint[i + 1] - work.first_joint[i]):
            for a in range(work.first_contact[i + 1] - work.first_contact[i]):
                reactions.Wr[i, j, a] = work.W[i, j, a]
    for s in range(slides.row.size):
        row, i, t = slides.row[s], slides.block[s], slides.tangent[s]
        along, across = slip_of(sideways.rows.kinematics, t)
        write_direction(slides, s, along, across)
        first, second = friction_of_unit_force(slides, s)
        for k in range(Wr_o.shape[1]):
            Wr_o[row, k] += first * sideways.rows.W_o[t, k] + second * sideways.rows.W_o[t + 1, k]
        column, tangent = row - work.first_contact[i], t - tangents.first_contact[i]
        for j in range(work.first_joint[i + 1] - work.first_joint[i]):
            sideways_W = tangents.W[i, j]
            reactions.Wr[i, j, column] += (
                first * sideways_W[tangent] + second * sideways_W[tangent + 1]
            )
    return status


@kernel
def friction_power(slides, force):
    """Power of sliding friction [W] for the forces of the held rows."""
    power = 0.0
    for s in range(slides.row.size):
        power -= slides.mu[s] * force[slides.row[s]] * slides.speed[s]
    return power


@kernel
def follow_slip(slides, contacts):
    """Write the direction at the end of a step; ``contacts`` are of all rows."""
    for s in range(slides.row.size):
        t = slides.tangent_of_all[s]
        along, across = slip_of(contacts, t)
        write_direction(slides, s, along, across)
        copy(slides.turning[s], slides.at_end[s])


@kernel
def accept_slip(slides):
    """Begin the next step with the direction at the end of this one."""
    for s in range(slides.row.size):
        copy(slides.at_end[s], slides.direction[s])
