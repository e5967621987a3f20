r"""Dry friction in the joints, smoothed: :math:`\tau_j = -c_j \tanh(\dot q_j / s)` [N m, N].

The Coulomb law :math:`\tau = -c\,\mathrm{sign}(\dot q)` with its jump at rest drawn out over a
speed ``s``.  A joint under a load ``l < c`` does not stick: it creeps at ``s artanh(l / c)``.
Where joints are slow, the law is a viscous friction of ``c / s``, which makes scenes stiff (such
laws: B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994).
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import PASSIVE, POWER, EffectKernel
from multiarm.effects.context import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at
from multiarm.scene import friction_of


@cfunc
def add_joint_friction(address, size, at, _t):
    """Own arrays: one friction torque a joint; the speed ``s``."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    first = int(at)
    slots, friction, speed = (
        ints1(struct, first),
        floats1(struct, first + 1),
        floats1(struct, first + 2),
    )
    power = 0.0
    for j in range(data.h.size):
        force = -friction[j] * math.tanh(data.v[j] / speed[0])
        data.h[j] += force
        power += force * data.v[j]
    data.power[slots[POWER]] = power
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The piece of a system with smooth dry friction."""
    if spec.model != "smooth":
        return []
    arrays = (context.stacked(spec.torque, friction_of), np.array([spec.smoothing_speed]))
    return [EffectKernel("joint_friction", add_joint_friction, PASSIVE, arrays)]
