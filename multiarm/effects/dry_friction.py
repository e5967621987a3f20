r"""What unilateral constraints do between their events.

*Dry friction of a joint* that moves is a constant torque against its motion,
:math:`\tau = -\tau_c \operatorname{sign}\dot q`; a joint at rest is held by a row of W, and nothing
is added here.  The mode that a run is in says which (:mod:`multiarm.events`).  Sliding friction of
contacts and impacts have their work noted under names of their own.
"""

from __future__ import annotations

from multiarm.contacts.unilateral import DRY_JOINT, UnilateralConstraints
from multiarm.dynamics.arrays import open_system
from multiarm.effects.piece import APPLIED, PASSIVE, POWER, Piece
from multiarm.jit.kernels import cfunc
from multiarm.jit.structs import floats1, ints1, struct_at


@cfunc
def add_dry_friction(address, size, at, _t):
    """Own array: the torque on every joint."""
    struct = struct_at(address, size)
    _, buffers, _ = open_system(struct)
    slots, torque = ints1(struct, int(at)), floats1(struct, int(at) + 1)
    power = 0.0
    for j in range(buffers.h.size):
        buffers.h[j] += torque[j]
        power += torque[j] * buffers.v[j]
    buffers.power[slots[POWER]] = power
    return 0


def friction_pieces(unilateral: UnilateralConstraints) -> list[Piece]:
    """The pieces of a scene with unilateral constraints."""
    pieces = [Piece("impacts", None, APPLIED)]
    if any(one.tangents for one in unilateral.constraints):
        pieces.append(Piece("contact_friction", None, APPLIED))
    if any(one.kind == DRY_JOINT for one in unilateral.constraints):
        pieces.append(Piece("joint_friction", add_dry_friction, PASSIVE, (unilateral.dry,)))
    return pieces
