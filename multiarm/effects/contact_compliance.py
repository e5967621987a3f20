r"""Compliant contacts: a spring and a damper in place of a constraint.

The contact force is a function of the gap :math:`\varphi` and its rate,

.. math:: \lambda = -(k\,\varphi + d\,\dot\varphi),

on the object along the contact's wrench, :math:`W_o\lambda`, and on the arm :math:`W\lambda`; its
power is :math:`\lambda\dot\varphi`.  The forces are unique for any number of contacts.

A unilateral contact pushes while :math:`\varphi < 0` and the force is positive; the start and the
end of pushing are events, at which steps end, so that no step contains the kink.  The model: K.L.
Johnson, Contact Mechanics, Cambridge 1985, linearised about a load.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.unilateral import CompliantContacts
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.effect_kernels import APPLIED, POWER, Arrays, EffectKernel
from multiarm.dynamics.equations import update_rows
from multiarm.dynamics.model import Data
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def add_contact_compliance(address, size, at, _t):
    """Own arrays: struct with the rows of the springs; owners, stiffness [N/m] and damping [N s/m];
    which springs act now; their forces [N].
    """
    struct, first = struct_at(address, size), int(at)
    _, data, _ = open_system(struct)
    slots, place, owners = ints1(struct, first), ints1(struct, first + 1), ints1(struct, first + 2)
    stiffness, damping = floats1(struct, first + 3), floats1(struct, first + 4)
    active, force = ints1(struct, first + 5), floats1(struct, first + 6)
    own = struct_at(place[0], place[1])
    update_rows(own)
    _, rows, work = open_system(own)
    power = 0.0
    for s in range(owners.size):
        i, rate = owners[s], rows.contacts[s, GAP_RATE]
        force[s] = 0.0
        if active[s] != 0:
            force[s] = -(stiffness[s] * rows.contacts[s, GAP] + damping[s] * rate)
        for k in range(6):
            data.h_o[k] += rows.Wo[s, k] * force[s]
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            data.h[work.dofs[i] + j] += work.Y[i, j, s - work.rows[i]] * force[s]
        power += force[s] * rate
    data.power[slots[POWER]] = power
    return 0


def compliance_kernel(springs: CompliantContacts) -> EffectKernel:
    """The kernel of a scene with compliant contacts."""

    def connect(data: Data, arrays: Arrays) -> dict:
        rows = data.view(data.model.select(springs.rows))
        arrays[0][:] = rows.struct.ctypes.data, rows.struct.size
        data.cache["contact_compliance"] = rows  # the kernel reaches it by its address
        return {}

    # the mode of the contacts writes the last but one, and reads the last (`multiarm.events.modes`)
    arrays = (
        np.zeros(2, dtype=np.int64), springs.owners, springs.stiffness, springs.damping,
        springs.always, np.zeros(len(springs.rows)),
    )  # fmt: skip
    return EffectKernel(
        "contact_compliance",
        add_contact_compliance,
        APPLIED,
        arrays,
        connect=connect,
        unilateral=True,
    )
