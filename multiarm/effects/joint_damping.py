r"""Viscous friction in the joints: :math:`\tau_j = -d_j \dot q_j` [N m s/rad, N s/m]."""

from __future__ import annotations

from multiarm.dynamics.arrays import open_system
from multiarm.effects.piece import PASSIVE, POWER, Piece, Site
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at
from multiarm.scene import damping_of


@cfunc
def add_joint_damping(address, size, at, _t):
    """Own array: one coefficient a joint."""
    struct = struct_at(address, size)
    _, buffers, _ = open_system(struct)
    slots, damping = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    power = 0.0
    for j in range(buffers.h.size):
        force = -damping[j] * buffers.v[j]
        buffers.h[j] += force
        power += force * buffers.v[j]
    buffers.power[slots[POWER]] = power
    return 0


def build(spec, site: Site) -> list[Piece]:
    """The piece of a system with viscous friction."""
    damping = site.stacked(spec, damping_of)
    return [Piece("joint_damping", add_joint_damping, PASSIVE, (damping,))]
