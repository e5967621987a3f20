"""What contact forces do to the objects and to the joints: wrenches and generalised forces."""

from __future__ import annotations

import numpy as np

from multiarm.contacts.joint import open_frames
from multiarm.contacts.kernel import open_contact
from multiarm.contacts.motion import open_body
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.data import Data
from multiarm.dynamics.kinematics import object_of, write_object_row
from multiarm.jit.kernels import INTS, NUMBERS, clear, kernel
from multiarm.jit.vectors import add_rotated


@kernel
def add_contact_forces(work, W_o, W, force, on_object, on_joints):
    """Add ``W_o force`` to the wrenches on the objects (6 F,), ``W force`` to the joints' forces.

    ``W_o`` (N, 6 F) and ``W`` (blocks, d, m) are the directions of the forces, which need not be
    those of the constraints; ``work`` has the joints and the contacts of each block.
    """
    for k in range(force.size):
        for l in range(on_object.size):
            on_object[l] += W_o[k, l] * force[k]
    add_joint_forces(work, W, force, 1.0, on_joints)


@kernel
def add_joint_forces(work, W, force, sign, on_joints):
    """Add ``sign W force`` to the joints' forces."""
    for i in range(work.first_joint.size - 1):
        d0, first = work.first_joint[i], work.first_contact[i]
        for k in range(first, work.first_contact[i + 1]):
            for j in range(work.first_joint[i + 1] - d0):
                on_joints[d0 + j] += sign * W[i, j, k - first] * force[k]


@kernel
def write_wrenches(model, data, forces):
    """Write the wrench of each owner of rows on its second body into ``data.sample.wrenches``.

    World axes; about the object's centre of mass, or on another body about the origin of the
    joint's frame there.  ``forces`` (N,) are those of the rows.
    """
    pairs, wrenches, first = model.connections, data.sample.wrenches, data.rows.first
    for c in range(wrenches.shape[0]):
        wrench, second = wrenches[c], pairs.second[c]
        clear(wrench)
        o = object_of(second, data)
        body, frames = open_body(data.bodies.motion[second]), open_frames(model.joint_frames[c])
        x = add_rotated(body.origin, body.rotation, frames.origin_on_object)
        for k in range(first[c], first[c + 1]):
            if o < 0:
                write_object_row(open_contact(data.rows.kinematics[k]), x, data.rows.about_joint, 0)
            row, at = (data.rows.W_o[k], 6 * o) if o >= 0 else (data.rows.about_joint, 0)
            for l in range(wrench.size):
                wrench[l] += row[at + l] * forces[k]


@kernel
def update_wrenches(struct: INTS, forces: NUMBERS):
    """:func:`write_wrenches` at the kinematics in the data of a struct."""
    model, data, _ = open_system(struct)
    write_wrenches(model, data, forces)


def wrenches_of(data: Data, forces: np.ndarray) -> np.ndarray:
    """The wrenches (o, 6) of all owners of rows for forces or impulses (N,) of the rows."""
    update_wrenches(data.struct, forces)
    return data.arrays.sample.wrenches.copy()


def uncarried_wrench(data: Data) -> np.ndarray:
    """What the contacts leave of the wrenches on the objects that the control commands, (6 F,).

    After the laws have been evaluated in these data; zeros where none commands one.
    """
    if not data.model.laws:
        return np.zeros(data.model.layout.node)
    rows = data.arrays.rows
    return data.arrays.control.object_wrench - rows.W_o.T @ rows.static_force
