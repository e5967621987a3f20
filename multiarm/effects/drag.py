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

import numpy as np

from multiarm.contacts.kernel import SPIN, VELOCITY
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import APPLIED, POWER, EffectKernel
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def add_drag(address, size, at, _t):
    """Own array: linear, quadratic and angular coefficients of the axes; the medium's velocity."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    slots, own = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    body, h_o, power = data.body, data.h_o, 0.0
    square = 0.0
    for a in range(3):
        square += (body[VELOCITY + a] - own[9 + a]) ** 2
    speed = math.sqrt(square)
    for k in range(3):
        u = turn = 0.0
        for a in range(3):
            u += body[3 * a + k] * (body[VELOCITY + a] - own[9 + a])
            turn += body[3 * a + k] * body[SPIN + a]
        force, moment = -(own[k] + own[3 + k] * speed) * u, -own[6 + k] * turn
        power += moment * turn
        for a in range(3):
            h_o[a] += body[3 * a + k] * force
            h_o[3 + a] += body[3 * a + k] * moment
            power += body[3 * a + k] * force * body[VELOCITY + a]
    data.power[slots[POWER]] = power
    return 0


def build(spec, _context: BuildContext) -> list[EffectKernel]:
    """The kernel of an object that moves through a medium."""
    own = np.array([*spec.linear, *spec.per_axis(), *spec.angular, *spec.wind])
    return [EffectKernel("drag", add_drag, APPLIED, (own,), local=True)]
