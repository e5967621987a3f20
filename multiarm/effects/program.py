"""The compiled switchboard of the effects' program."""

from __future__ import annotations

from multiarm.effects.joint_damping import add_joint_damping
from multiarm.lowlevel import inner

JOINT_DAMPING = 0


@inner
def apply_effects(program, parameters, velocity, h):
    """Add every active effect's generalised forces to ``h``; returns their power [W]."""
    power = 0.0
    for k in range(program.shape[0]):
        if program[k, 0] == JOINT_DAMPING:
            power += add_joint_damping(velocity, parameters, program[k, 1], h)
    return power
