r"""First-order lag of the drives: :math:`T_j \dot\tau_j = \tau^*_j - \tau_j`.

Each lagging joint has one state of its own, the torque that acts [N m, N].  The command is what the
control commands, within ``torque_limits``.  The torque that acts does the control's work.
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import ACTUATOR, STATE, Arrays, EffectKernel
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def lag_torques(address, size, at, _t):
    """Own arrays: the lagging joints; their time constants [s]; their commands, written here."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    first = int(at)
    slots, lagging = ints1(struct, first), ints1(struct, first + 1)
    constants, commands = floats1(struct, first + 2), floats1(struct, first + 3)
    torque, state = data.torque, slots[STATE]
    for k in range(lagging.size):
        j = lagging[k]
        commands[k] = torque[j]
        torque[j] = data.inner[state + k]
        data.inner_rate[state + k] = (commands[k] - torque[j]) / constants[k]
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of lagging drives; joints without a time constant follow at once."""
    constants = context.stacked(spec.time_constant)
    lagging = np.flatnonzero(constants).astype(np.int64)
    commands = np.zeros(lagging.size)

    def start(arrays: Arrays) -> np.ndarray:
        return arrays[2].copy() if spec.start == "command" else np.zeros_like(commands)

    arrays = (lagging, constants[lagging], commands)
    return [
        EffectKernel(
            "actuator_lag",
            lag_torques,
            ACTUATOR,
            arrays,
            works=False,
            states=lagging.size,
            start=start,
            local=True,
            state_joints=tuple(lagging.tolist()),
        )
    ]
