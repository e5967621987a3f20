r"""Viscous friction in the joints: :math:`\tau_j = -d_j \dot q_j` [N m s/rad, N s/m]."""

from __future__ import annotations

from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import PASSIVE, POWER, EffectKernel
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at
from multiarm.scene import damping_of


@cfunc
def add_joint_damping(address, size, at, _t):
    """Own array: one coefficient a joint."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    slots, damping = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    power = 0.0
    for j in range(data.h.size):
        force = -damping[j] * data.v[j]
        data.h[j] += force
        power += force * data.v[j]
    data.power[slots[POWER]] = power
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of viscous friction."""
    damping = context.stacked(spec, damping_of)
    return [EffectKernel("joint_damping", add_joint_damping, PASSIVE, (damping,), local=True)]
