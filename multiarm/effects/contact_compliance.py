r"""Compliant contacts: a spring and a damper in place of a constraint.

The contact force is a function of the gap :math:`\varphi` and its rate,

.. math:: \lambda = -(k\,\varphi + d\,\dot\varphi),

on the object along the contact's wrench, :math:`W_o\lambda`, and on the arm :math:`W\lambda`; its
power is :math:`\lambda\dot\varphi`.  The forces are unique for any number of contacts.

A unilateral contact pushes while :math:`\varphi < 0` and the force is positive; the start and the
end of pushing are events, at which steps end, so that no step contains the kink.  The model: K.L.
Johnson, Contact Mechanics, Cambridge 1985, linearised about a load.

*Its derivative* has a part from the directions, that of :math:`W_o\lambda, W\lambda` at fixed
:math:`\lambda`, and one from :math:`\delta\lambda = -(k\,\delta\varphi + d\,\delta\dot\varphi)`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import open_contact
from multiarm.contacts.unilateral import CompliantContacts
from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.contact_forces import add_contact_forces
from multiarm.dynamics.coordinates import (
    block_columns,
    chart_places,
    column_of_state,
    equation_columns,
    force_columns,
)
from multiarm.dynamics.data import Data
from multiarm.dynamics.effect_kernels import APPLIED, EffectKernel, set_power, view_of_effect
from multiarm.dynamics.equation_derivatives import (
    equation_work,
    open_equations,
    write_load_derivatives,
)
from multiarm.dynamics.equations import update_rows
from multiarm.dynamics.references import Reference, References
from multiarm.jit.kernels import cfunc, copy, inlined, kernel
from multiarm.jit.structs import Floats1, Int, Ints1, referenced, struct_at


class SpringStructs(References):
    """Addresses of further structs."""

    rows: Int  # of the system with the rows of the springs
    derivatives: Int  # of the derivatives of these rows


class Springs(NamedTuple):
    """Compliant contacts, s of them."""

    structs: SpringStructs
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
    _, of_springs, work = update_springs(springs)
    force, power = springs.force, 0.0
    for s in range(force.size):
        power += force[s] * open_contact(of_springs.rows.kinematics[s]).gap_rate
    add_contact_forces(work, of_springs.rows.W_o, work.W, force, data.forces.f_o, data.forces.f_j)
    set_power(struct, at, power)
    return 0


@inlined
def update_springs(springs):
    """Update rows and forces of all springs; the views of the system with these rows."""
    struct = referenced(springs.structs.rows)
    system = open_system(struct)
    update_rows(struct)
    write_spring_forces(springs, system[1].rows.kinematics)
    return system


@kernel
def write_spring_forces(springs, contacts):
    """Write the forces of all springs."""
    for s in range(springs.force.size):
        springs.force[s] = 0.0
        if springs.active[s] != 0:
            contact = open_contact(contacts[s])
            pressed = springs.stiffness[s] * contact.gap
            springs.force[s] = -(pressed + springs.damping[s] * contact.gap_rate)


@cfunc
def differentiate_contact_compliance(address, size, at, _t):
    """Add the derivatives of the forces: of their directions, and of their sizes."""
    struct = struct_at(address, size)
    data, springs = open_data(struct), open_springs(struct, at)
    derivatives = referenced(springs.structs.derivatives)
    _, of_springs, work = update_springs(springs)
    copy(springs.force, of_springs.rows.static_force)
    status = write_load_derivatives(referenced(springs.structs.rows), derivatives)
    equations, by = open_equations(derivatives), force_columns(data)
    first = chart_places(data).joints
    for l in range(first):
        for c in range(by.states):
            data.slopes.force[l, c] -= equations.dF_o[l, c]
    for i in range(work.first_joint.size - 1):
        d0, n = work.first_joint[i], work.first_joint[i + 1] - work.first_joint[i]
        columns = block_columns(first, n, 0)
        for j in range(n):
            for c in range(columns.end):
                column = column_of_state(by, columns, d0, c)
                data.slopes.force[first + d0 + j, column] -= equations.dF[i, j, c]
        for s in range(work.first_contact[i], work.first_contact[i + 1]):
            if springs.active[s] != 0:
                add_change_of_force(
                    s, i, d0, n, springs, of_springs, work, equations, first, by, data
                )
    return status


@inlined
def add_change_of_force(s, i, d0, n, springs, of_springs, work, equations, first, by, data):
    """Add what the change of a spring's force, along its contact, does to object and arm."""
    columns, W = block_columns(first, n, 0), work.W[i, :, s - work.first_contact[i]]
    for c in range(columns.end):
        of_rate = columns.twists <= c < columns.positions or c >= columns.rates
        if c < columns.positions:
            rate = of_springs.rows.W_o[s, c % first]
        else:
            rate = W[(c - columns.positions) % n]
        # of the gap's rate by a velocity as of the gap by a displacement
        change = springs.damping[s] * rate
        if not of_rate:
            change = springs.stiffness[s] * rate + springs.damping[s] * equations.rates[s, c]
        column = column_of_state(by, columns, d0, c)
        for l in range(first):
            data.slopes.force[l, column] -= of_springs.rows.W_o[s, l] * change
        for j in range(n):
            data.slopes.force[first + d0 + j, column] -= W[j] * change


def compliance_kernel(springs: CompliantContacts) -> EffectKernel:
    """The kernel of a scene with compliant contacts."""

    def connect(data: Data, arrays: Springs) -> dict:
        rows = data.view(data.model.select(springs.rows))
        _, derivatives = equation_work(rows, equation_columns(data.arrays).torques, masses=False)
        arrays.structs.refer(rows=rows.reference, derivatives=Reference(derivatives, rows))
        # surfaces of the user may fail in these rows
        return {"contact_compliance": rows.callbacks["surface"]} if rows.surfaces else {}

    arrays = Springs(
        structs=SpringStructs(),
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
        derivative=differentiate_contact_compliance,
    )
