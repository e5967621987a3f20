r"""What unilateral contacts and joints with dry friction do between their events.

*Dry friction of a joint* that moves is a constant torque against its motion,
:math:`\tau = -\tau_c \operatorname{sign}\dot q`; a joint at rest is held by a row of W, and nothing
is added here.  The mode that a run is in says which (:mod:`multiarm.events`).  Sliding friction of
contacts and impacts have their work noted under names of their own.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.unilateral import DRY_JOINT, UnilateralConstraints
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import APPLIED, PASSIVE, POWER, EffectKernel
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def add_dry_friction(address, size, at, _t):
    """Own array: the torque on every joint."""
    struct = struct_at(address, size)
    _, data, _ = open_system(struct)
    slots, torque = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    power = 0.0
    for j in range(data.h.size):
        data.h[j] += torque[j]
        power += torque[j] * data.v[j]
    data.power[slots[POWER]] = power
    return 0


def unilateral_kernels(unilateral: UnilateralConstraints, joints: int) -> list[EffectKernel]:
    """The kernels of a scene with unilateral contacts and ``joints`` joints."""
    kernels = [EffectKernel("impacts", None, APPLIED)]
    if any(one.tangents for one in unilateral.constraints):
        kernels.append(EffectKernel("contact_friction", None, APPLIED))
    if any(one.kind == DRY_JOINT for one in unilateral.constraints):
        torques = np.zeros(joints)
        kernels.append(
            EffectKernel("joint_friction", add_dry_friction, PASSIVE, (torques,), unilateral=True)
        )
    return kernels
