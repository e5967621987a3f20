"""What contact forces do to the object and to the joints: wrenches and generalised forces."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.data import Data
from multiarm.jit.kernels import clear, kernel


@kernel
def add_contact_forces(work, W_o, W, force, on_object, on_joints):
    """Add ``W_o force`` to the wrench on the object (6,) and ``W force`` to the joints' forces.

    ``W_o`` (N, 6) and ``W`` (arms, d, m) are the directions of the forces, which need not be those
    of the constraints; ``work`` has the joints and the contacts of each arm.
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
def write_wrenches(rows, bounds, forces, wrenches):
    """Write the wrench of each owner of rows on the object, the sum of its ``rows * forces``.

    ``rows`` (N, 6) are those of ``W_o``, ``bounds`` (o + 1,) where those of each owner begin.
    """
    for i in range(wrenches.shape[0]):
        wrench = wrenches[i]
        clear(wrench)
        for k in range(bounds[i], bounds[i + 1]):
            for l in range(wrench.size):
                wrench[l] += rows[k, l] * forces[k]


def uncarried_wrench(data: Data) -> np.ndarray:
    """What the contacts leave of the wrench on the object that the control commands, shape (6,).

    After the laws have been evaluated in these data; zeros where none commands one.
    """
    if not data.model.laws:
        return np.zeros(6)
    rows = data.arrays.rows
    return data.arrays.control.object_wrench - rows.W_o.T @ rows.static_force
