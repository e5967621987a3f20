r"""Limits of the drives: :math:`\tau_j = \max(-l_j, \min(l_j, \tau^*_j))` of the command [N m, N].

The limits act on what the control asks for, before the drives' lag.  They do no work of their own:
what is left of the torque does the control's work.  When a drive comes to its limit, and when it is
within it again, the events of the result say so.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import ACTUATOR, EffectKernel
from multiarm.effects.context import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, struct_at
from multiarm.scene import effort_limit_of

# A command that exceeds its limit by less than this fraction of it does so by rounding.
ROUNDED = 1e-9


@cfunc
def limit_torques(address, size, at, _t):
    """Own arrays: limits; margins, positive where the command exceeds them."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    limits, margins = floats1(struct, int(at) + 1), floats1(struct, int(at) + 2)
    torque = data.torque
    for j in range(torque.size):
        wanted = abs(torque[j])
        margins[j] = wanted - (1.0 + ROUNDED) * limits[j]
        if wanted > limits[j]:
            torque[j] = math.copysign(limits[j], torque[j])
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The piece of a system whose drives are limited."""
    limits = context.stacked(spec, effort_limit_of, default=math.inf)
    margins = np.full_like(limits, -math.inf)
    watched = tuple((1, int(j)) for j in np.flatnonzero(np.isfinite(limits)))
    return [
        EffectKernel(
            "torque_limits",
            limit_torques,
            ACTUATOR,
            (limits, margins),
            works=False,
            watched=watched,
        )
    ]
