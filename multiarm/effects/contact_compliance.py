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

from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.unilateral import CompliantContacts
from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.contact_forces import add_contact_forces
from multiarm.dynamics.effect_kernels import APPLIED, EffectKernel, set_power, view_of_effect
from multiarm.dynamics.equations import update_rows
from multiarm.dynamics.model import Data
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import Floats1, Ints1, struct_at


class Springs(NamedTuple):
    """Compliant contacts, s of them."""

    rows: Ints1  # (2,) address and size of the struct with their rows
    stiffness: Floats1  # [N/m]
    damping: Floats1  # [N s/m]
    active: Ints1  # which act now; the mode of the contacts writes them
    force: Floats1  # at the last evaluation [N]


open_springs = view_of_effect(Springs)


@cfunc
def add_contact_compliance(address, size, at, _t):
    """Add the forces of the springs that act."""
    struct = struct_at(address, size)
    data, springs = open_data(struct), open_springs(struct, at)
    own, force = struct_at(springs.rows[0], springs.rows[1]), springs.force
    update_rows(own)
    _, rows, work = open_system(own)
    power = 0.0
    for s in range(force.size):
        rate = rows.contacts[s, GAP_RATE]
        force[s] = 0.0
        if springs.active[s] != 0:
            gap = rows.contacts[s, GAP]
            force[s] = -(springs.stiffness[s] * gap + springs.damping[s] * rate)
        power += force[s] * rate
    add_contact_forces(work, rows.Wo, work.W, force, data.h_o, data.h)
    set_power(struct, at, power)
    return 0


def compliance_kernel(springs: CompliantContacts) -> EffectKernel:
    """The kernel of a scene with compliant contacts."""

    def connect(data: Data, own: Springs) -> dict:
        rows = data.view(data.model.select(springs.rows))
        own.rows[:] = rows.struct.ctypes.data, rows.struct.size
        data.cache["contact_compliance"] = rows  # the kernel reaches it by its address
        # surfaces of the user may fail in these rows
        return {"contact_compliance": rows.callbacks["surface"]} if rows.surfaces else {}

    arrays = Springs(
        rows=np.zeros(2, dtype=np.int64),
        stiffness=springs.stiffness,
        damping=springs.damping,
        active=springs.always,
        force=np.zeros(len(springs.rows)),
    )
    return EffectKernel(
        "contact_compliance",
        add_contact_compliance,
        APPLIED,
        arrays,
        connect=connect,
        unilateral=True,
    )
