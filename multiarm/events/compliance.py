r"""Contacts that give way: a spring and a damper in place of a constraint.

The contact force is a function of the gap :math:`\varphi` and its rate,

.. math:: \lambda = -(k\,\varphi + d\,\dot\varphi),

on the object along the contact's wrench, :math:`W_o\lambda`, and on the arm :math:`W\lambda`; its
power is :math:`\lambda\dot\varphi`.  It is determined however many contacts there are.  A contact
that can only push does so while it is pressed in (:math:`\varphi < 0`) and the force is positive;
both ends of pushing are events, at which steps end, so that no step sees the kink.  The model:
K.L. Johnson, Contact Mechanics, Cambridge 1985, linearised about a load.
"""

from __future__ import annotations

from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.unilateral import CompliantContacts
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.equations import update_rows
from multiarm.effects.piece import APPLIED, POWER, Piece
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def add_contact_compliance(address, size, at, _t):
    """Own arrays: those of :class:`multiarm.contacts.unilateral.CompliantContacts`."""
    struct, first = struct_at(address, size), int(at)
    _, buffers, _ = open_system(struct)
    slots, links, owners = ints1(struct, first), ints1(struct, first + 1), ints1(struct, first + 2)
    stiffness, damping = floats1(struct, first + 3), floats1(struct, first + 4)
    active, force = ints1(struct, first + 5), floats1(struct, first + 6)
    own = struct_at(links[0], links[1])
    update_rows(own)
    _, rows, work = open_system(own)
    power = 0.0
    for s in range(owners.size):
        i, rate = owners[s], rows.contacts[s, GAP_RATE]
        force[s] = 0.0
        if active[s] != 0:
            force[s] = -(stiffness[s] * rows.contacts[s, GAP] + damping[s] * rate)
        for k in range(6):
            buffers.h_o[k] += rows.Wo[s, k] * force[s]
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            buffers.h[work.dofs[i] + j] += work.Y[i, j, s - work.rows[i]] * force[s]
        power += force[s] * rate
    buffers.power[slots[POWER]] = power
    return 0


def compliance_pieces(springs: CompliantContacts | None) -> list[Piece]:
    """The piece of a scene whose contacts give way."""
    if springs is None:
        return []
    arrays = (
        springs.links, springs.owners, springs.stiffness, springs.damping, springs.active,
        springs.force,
    )  # fmt: skip
    return [Piece("contact_compliance", add_contact_compliance, APPLIED, arrays)]
