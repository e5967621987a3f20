r"""First-order lag of the drives: :math:`T_j \dot\tau_j = \tau^*_j - \tau_j`.

Each lagging joint has one state of its own, the torque that acts [N m, N].  The command is what the
control commands, within ``torque_limits``.  The torque that acts does the control's work.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import force_columns
from multiarm.dynamics.effect_kernels import ACTUATOR, EffectKernel, first_state, view_of_effect
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc, clear
from multiarm.jit.structs import Floats1, Ints1, struct_at


class ActuatorLag(NamedTuple):
    """Drives that lag, k of them."""

    joints: Ints1
    time_constants: Floats1  # [s]
    commands: Floats1  # at the last evaluation [N m, N]


open_lag = view_of_effect(ActuatorLag)


@cfunc
def lag_torques(address, size, at, _t):
    """Write the torques that act, and their rates."""
    struct = struct_at(address, size)
    data, lag, state = open_data(struct), open_lag(struct, at), first_state(struct, at)
    torque = data.control.torque
    for k in range(lag.joints.size):
        j = lag.joints[k]
        lag.commands[k] = torque[j]
        torque[j] = data.effects.states[state + k]
        data.effects.state_rates[state + k] = (lag.commands[k] - torque[j]) / lag.time_constants[k]
    return 0


@cfunc
def differentiate_lag(address, size, at, _t):
    """Write the derivatives of the torques that act, which are states, and of their rates."""
    struct = struct_at(address, size)
    data, lag, state = open_data(struct), open_lag(struct, at), first_state(struct, at)
    states = force_columns(data).states
    for k in range(lag.joints.size):
        command = data.slopes.torque[lag.joints[k]]
        rate = data.slopes.force[data.state.velocity.size + state + k]
        for c in range(command.size):
            rate[c] += command[c] / lag.time_constants[k]
        rate[states + state + k] -= 1.0 / lag.time_constants[k]
        clear(command)
        command[states + state + k] = 1.0
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of lagging drives; joints without a time constant follow at once."""
    constants = context.stacked(spec.time_constant)
    lagging = np.flatnonzero(constants).astype(np.int64)
    commands = np.zeros(lagging.size)

    def start(lag: ActuatorLag) -> np.ndarray:
        return lag.commands.copy() if spec.start == "command" else np.zeros_like(commands)

    return [
        EffectKernel(
            "actuator_lag",
            lag_torques,
            ACTUATOR,
            ActuatorLag(lagging, constants[lagging], commands),
            works=False,
            states=lagging.size,
            start=start,
            local=True,
            state_joints=tuple(lagging.tolist()),
            derivative=differentiate_lag,
        )
    ]
