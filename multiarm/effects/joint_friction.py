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
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import chart_places, force_columns
from multiarm.dynamics.effect_kernels import (
    PASSIVE,
    EffectKernel,
    keep_forces,
    set_power,
    view_of_effect,
)
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Float, Floats1, struct_at
from multiarm.scene import friction_of


class SmoothFriction(NamedTuple):
    """Smooth friction in the joints."""

    torque: Floats1  # (n,) c [N m, N]
    smoothing_speed: Float  # s [rad/s, m/s]


class CoulombFriction(NamedTuple):
    """Friction of joints that move; the mode of a run writes the torques."""

    torque: Floats1  # (n,) on the joints [N m, N]; zero on those at rest


open_smooth, open_coulomb = view_of_effect(SmoothFriction), view_of_effect(CoulombFriction)


@cfunc
def add_joint_friction(address, size, at, _t):
    """Add the torques of smooth friction."""
    struct = struct_at(address, size)
    data, friction, power = open_data(struct), open_smooth(struct, at), 0.0
    rates = data.state.joint_rates
    for j in range(rates.size):
        torque = -friction.torque[j] * math.tanh(rates[j] / friction.smoothing_speed)
        data.forces.f_j[j] += torque
        power += torque * rates[j]
    set_power(struct, at, power)
    return 0


@cfunc
def differentiate_joint_friction(address, size, at, _t):
    """Add the derivatives of smooth friction: ``-c (1 - tanh^2) / s``."""
    struct = struct_at(address, size)
    data, friction = open_data(struct), open_smooth(struct, at)
    joints, rates = chart_places(data).joints, force_columns(data).rates
    for j in range(data.forces.f_j.size):
        part = math.tanh(data.state.joint_rates[j] / friction.smoothing_speed)
        slope = friction.torque[j] * (1.0 - part * part) / friction.smoothing_speed
        data.slopes.force[joints + j, rates + j] -= slope
    return 0


@cfunc
def add_coulomb_friction(address, size, at, _t):
    """Add the torques of Coulomb friction."""
    struct = struct_at(address, size)
    data, friction, power = open_data(struct), open_coulomb(struct, at), 0.0
    for j in range(data.forces.f_j.size):
        data.forces.f_j[j] += friction.torque[j]
        power += friction.torque[j] * data.state.joint_rates[j]
    set_power(struct, at, power)
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of smooth friction."""
    friction = SmoothFriction(context.stacked(spec.torque, friction_of), spec.smoothing_speed)
    return [
        EffectKernel(
            "joint_friction",
            add_joint_friction,
            PASSIVE,
            friction,
            local=True,
            derivative=differentiate_joint_friction,
        )
    ]


def coulomb_kernel(joints: int) -> EffectKernel:
    """The kernel of Coulomb friction."""
    friction = CoulombFriction(np.zeros(joints))
    return EffectKernel(
        "joint_friction",
        add_coulomb_friction,
        PASSIVE,
        friction,
        unilateral=True,
        local=True,
        derivative=keep_forces,
    )
