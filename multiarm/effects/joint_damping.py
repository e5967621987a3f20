r"""Viscous friction in the joints: :math:`\tau_j = -d_j \dot q_j` [N m s/rad, N s/m]."""

from __future__ import annotations

from typing import NamedTuple

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import chart_places, force_columns
from multiarm.dynamics.effect_kernels import PASSIVE, EffectKernel, set_power, view_of_effect
from multiarm.effects.building import BuildContext
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Floats1, struct_at
from multiarm.scene import damping_of


class JointDamping(NamedTuple):
    """Viscous friction in the joints."""

    coefficients: Floats1  # (n,) [N m s/rad, N s/m]


open_damping = view_of_effect(JointDamping)


@cfunc
def add_joint_damping(address, size, at, _t):
    """Add the torques."""
    struct = struct_at(address, size)
    data, damping, power = open_data(struct), open_damping(struct, at), 0.0
    for j in range(data.forces.f_j.size):
        torque = -damping.coefficients[j] * data.state.joint_rates[j]
        data.forces.f_j[j] += torque
        power += torque * data.state.joint_rates[j]
    set_power(struct, at, power)
    return 0


@cfunc
def differentiate_joint_damping(address, size, at, _t):
    """Add the derivatives of the torques."""
    struct = struct_at(address, size)
    data, damping = open_data(struct), open_damping(struct, at)
    joints, rates = chart_places(data).joints, force_columns(data).rates
    for j in range(data.forces.f_j.size):
        data.slopes.force[joints + j, rates + j] -= damping.coefficients[j]
    return 0


def build(spec, context: BuildContext) -> list[EffectKernel]:
    """The kernel of viscous friction."""
    damping = JointDamping(context.stacked(spec, damping_of))
    return [
        EffectKernel(
            "joint_damping",
            add_joint_damping,
            PASSIVE,
            damping,
            local=True,
            derivative=differentiate_joint_damping,
        )
    ]
