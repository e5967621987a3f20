r"""Dry friction in the joints, smooth or with a jump.

*Smooth*: :math:`\tau_j = -c_j \tanh(\dot q_j / s)` [N m, N], the Coulomb law with its jump at rest
smoothed over a speed ``s``.  A joint under a load ``l < c`` does not stick: it creeps at
``s artanh(l / c)``.  At low speeds the law is a viscous friction of ``c / s``, which makes scenes
stiff (B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994).

*Coulomb*: a moving joint has a constant torque against its motion,
:math:`\tau_j = -c_j \operatorname{sign}\dot q_j`; a joint at rest is held by a row of W instead.
The mode of a run says which (:mod:`multiarm.events`).
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import PASSIVE, POWER, EffectKernel
from multiarm.effects.building import BuildContext
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


@cfunc
def add_coulomb_friction(address, size, at, _t):
    """Own array: the torque on every joint."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    slots, torque = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    power = 0.0
    for j in range(data.h.size):
        data.h[j] += torque[j]
        power += torque[j] * data.v[j]
    data.power[slots[POWER]] = power
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of smooth friction."""
    arrays = (context.stacked(spec.torque, friction_of), np.array([spec.smoothing_speed]))
    return [EffectKernel("joint_friction", add_joint_friction, PASSIVE, arrays, local=True)]


def coulomb_kernel(joints: int) -> EffectKernel:
    """The kernel of Coulomb friction; a mode writes the torques."""
    arrays = (np.zeros(joints),)
    return EffectKernel(
        "joint_friction", add_coulomb_friction, PASSIVE, arrays, unilateral=True, local=True
    )
