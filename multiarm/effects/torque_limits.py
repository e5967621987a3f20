r"""Limits of the drives: :math:`\tau_j = \max(-l_j, \min(l_j, \tau^*_j))` of the command [N m, N].

The limits act on the command of the control, before the drives' lag.  They do no work: the limited
torque does the work of the control.  The events of a result say when a drive reaches its limit and
when it leaves it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.effect_kernels import ACTUATOR, EffectKernel, view_of_effect
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc, clear
from multiarm.jit.structs import Floats1, struct_at
from multiarm.scene import effort_limit_of

# Smaller excesses are roundings, as a part of the limit.
ROUNDING = 1e-9


class TorqueLimits(NamedTuple):
    """Limits of the drives, each (n,) [N m, N]."""

    limits: Floats1
    excess: Floats1  # of the command over its limit; negative below it


open_limits = view_of_effect(TorqueLimits)


@cfunc
def limit_torques(address, size, at, _t):
    """Limit the commands, and write their excess."""
    struct = struct_at(address, size)
    torque, drives = open_data(struct).control.torque, open_limits(struct, at)
    for j in range(torque.size):
        command, limit = abs(torque[j]), drives.limits[j]
        drives.excess[j] = command - limit
        if command > limit:
            torque[j] = math.copysign(limit, torque[j])
    return 0


@cfunc
def differentiate_limits(address, size, at, _t):
    """Clear the derivatives of torques beyond their limits."""
    struct = struct_at(address, size)
    data, drives = open_data(struct), open_limits(struct, at)
    for j in range(data.control.torque.size):
        if abs(data.control.torque[j]) > drives.limits[j]:
            clear(data.slopes.torque[j])
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of limited drives."""
    limits = context.stacked(spec, effort_limit_of, default=math.inf)
    excess = np.full_like(limits, -math.inf)
    limited = map(int, np.flatnonzero(np.isfinite(limits)))
    watched = tuple(("excess", j, ROUNDING * float(limits[j])) for j in limited)
    return [
        EffectKernel(
            "torque_limits",
            limit_torques,
            ACTUATOR,
            TorqueLimits(limits, excess),
            works=False,
            watched=watched,
            local=True,
            derivative=differentiate_limits,
        )
    ]
