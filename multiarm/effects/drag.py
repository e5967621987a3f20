r"""Resistance of a medium to the object: forces against its motion, in its own axes.

With :math:`u = R_o^T(v_o - w)` the velocity of the centre of mass relative to the medium, whose own
is ``w``, and component by component along the object's axes,

.. math::
    f_k = -\big(c_k + (q_k + \tfrac12\varrho\, C_k A_k)\,|u|\big)\,u_k, \qquad
    m_k = -d_k\,\omega_k ,

Stokes's law at low, Newton's at high Reynolds numbers.  The force acts at the centre of mass.  Its
power is that on the object, :math:`f\cdot v_o + m\cdot\omega_o`: wind may drive it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import SPIN, VELOCITY
from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.effect_kernels import APPLIED, EffectKernel, set_power, view_of_effect
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Floats1, struct_at


class Drag(NamedTuple):
    """Resistance along and about the object's axes, each (3,)."""

    linear: Floats1  # c [N s/m]
    quadratic: Floats1  # q + rho C A / 2 [N s^2/m^2]
    angular: Floats1  # d [N m s/rad]
    wind: Floats1  # velocity of the medium, world axes [m/s]


open_drag = view_of_effect(Drag)


@cfunc
def add_drag(address, size, at, _t):
    """Add the wrench of the medium."""
    struct = struct_at(address, size)
    data, drag = open_data(struct), open_drag(struct, at)
    body, h_o, power = data.body, data.h_o, 0.0
    square = 0.0
    for a in range(3):
        square += (body[VELOCITY + a] - drag.wind[a]) ** 2
    speed = math.sqrt(square)
    for k in range(3):
        u = turn = 0.0
        for a in range(3):
            u += body[3 * a + k] * (body[VELOCITY + a] - drag.wind[a])
            turn += body[3 * a + k] * body[SPIN + a]
        force = -(drag.linear[k] + drag.quadratic[k] * speed) * u
        moment = -drag.angular[k] * turn
        power += moment * turn
        for a in range(3):
            h_o[a] += body[3 * a + k] * force
            h_o[3 + a] += body[3 * a + k] * moment
            power += body[3 * a + k] * force * body[VELOCITY + a]
    set_power(struct, at, power)
    return 0


def build(spec, _context: BuildContext) -> list[EffectKernel]:
    """The kernel of an object that moves through a medium."""
    coefficients = spec.linear, spec.per_axis(), spec.angular, spec.wind
    drag = Drag(*(np.array(numbers, dtype=float) for numbers in coefficients))
    return [EffectKernel("drag", add_drag, APPLIED, drag, local=True)]
