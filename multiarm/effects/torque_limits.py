r"""Limits of the drives: :math:`\tau_j = \max(-l_j, \min(l_j, \tau^*_j))` of the command [N m, N].

The limits act on the command of the control, before the drives' lag.  They do no work: the limited
torque does the work of the control.  The events of a result say when a drive reaches its limit and
when it leaves it.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import ACTUATOR, EffectKernel
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, struct_at
from multiarm.scene import effort_limit_of


@cfunc
def limit_torques(address, size, at, _t):
    """Own arrays: limits; margins, positive where the command exceeds them."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    limits, margins = floats1(struct, int(at) + 1), floats1(struct, int(at) + 2)
    torque = data.torque
    for j in range(torque.size):
        command = abs(torque[j])
        margins[j] = command - (1.0 + 1e-9) * limits[j]  # less is a rounding error
        if command > limits[j]:
            torque[j] = math.copysign(limits[j], torque[j])
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of limited drives."""
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
            local=True,
        )
    ]
