r"""Derivatives of the forces of control and effects.

Control may have closed forms (:attr:`multiarm.control.program.ControlProgram.derivative`); all else
is differentiated by differences of order four,

.. math:: f' = \frac{8 (f_1 - f_{-1}) - f_2 + f_{-2}}{12 h} .
"""

from __future__ import annotations

import numpy as np

from multiarm.arms.terms import BIAS_AT
from multiarm.dynamics.arrays import OK, OPEN_LOOP, open_data, open_system
from multiarm.dynamics.contact_derivatives import OFFSETS, STEP, difference_weight
from multiarm.dynamics.model import Data
from multiarm.jit.kernels import INTS, TABLE, TRUTH, clear, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import floats_at
from multiarm.spatial import retract_into


def applied_derivatives(data: Data, closed_loop: bool) -> np.ndarray | None:
    """Derivatives of what control and effects add to the forces, at the state in the data.

    Of wrench on the object (6), forces on the joints (n) and rates of effects' states (e), by
    displacements of the object's pose, its twist, joint positions, joint velocities and effects'
    states, shape (6 + n + e, 12 + 2 n + e); None where nothing depends on these.  Without
    ``closed_loop`` the control's torques are held.
    """
    model, n, e = data.model, data.model.layout.joints, data.arrays.inner.size
    follows = len(model.constants.control) > 0 and model.constants.control_reach > OPEN_LOOP
    by_law = _law_derivatives(data) if closed_loop and follows else None
    by_differences = closed_loop and follows and by_law is None
    found = np.zeros((12 + 2 * n + e, 6 + n + e))
    if by_differences or model.effects.kernels:
        if differentiate_forces(data.struct, by_differences, found) != OK:
            data.reraise()
    elif by_law is None:
        return None
    if by_law is not None:
        found[: 12 + 2 * n, 6 : 6 + n] += by_law.T
    return found.T


def _law_derivatives(data: Data) -> np.ndarray | None:
    """Derivatives of the torques in closed form, where these act as they are commanded."""
    law, constants = data.model.control_derivative, data.model.constants
    drives_act = constants.actuator_end > constants.passive_end
    contacts_open = data.arrays.modes.closed != 0
    return None if law is None or drives_act or contacts_open else law(data)


@kernel
def differentiate_forces(struct: INTS, closed_loop: TRUTH, found: TABLE):
    """Write what :func:`applied_derivatives` describes, transposed; returns a status.

    At the end the data are as they were.
    """
    data = open_data(struct)
    x, y, z, w = data.position[3], data.position[4], data.position[5], data.position[6]
    for column in range(found.shape[0]):
        clear(found[column])
        values, place = state_entry(data, column)
        before = values[place]
        for offset in OFFSETS:
            if 3 <= column < 6:
                h = offset * STEP
                about_x, about_y = h if column == 3 else 0.0, h if column == 4 else 0.0
                turn = (about_x, about_y, h - about_x - about_y)
                retract_into((x, y, z, w), turn, data.position[3:7])
            else:
                values[place] = before + offset * STEP
            status = add_forces(struct, difference_weight(offset), closed_loop, found[column])
            if status != OK:
                return status
        values[place] = before
        data.position[3], data.position[4], data.position[5], data.position[6] = x, y, z, w
    return add_forces(struct, 0.0, closed_loop, found[0])


@kernel
def state_entry(data, column):
    """The array and the place in it of a coordinate of the state; of a turn, any place."""
    n = data.angles.size
    if column < 6:
        return data.position, min(column, 2)
    if column < 12:
        return data.twist, column - 6
    if column < 12 + n:
        return data.angles, column - 12
    if column < 12 + 2 * n:
        return data.v, column - 12 - n
    return data.inner, column - 12 - 2 * n


@kernel
def add_forces(struct, weight, closed_loop, row):
    """Add the forces of control and effects at the state in the data, times a weight, to a row."""
    _, data, work = open_system(struct)
    status = call_cfunc(data.functions.kinematics, struct, 0.0, 0.0)
    if status != OK:
        return status
    for k in range(6):  # weight and gyroscopic moment
        row[k] -= weight * data.h_o[k]
    status = call_cfunc(data.functions.forces, struct, 0.0, 0.0)
    if status != OK:
        return status
    n = data.angles.size
    for k in range(6):
        row[k] += weight * data.h_o[k]
    for i in range(work.dofs.size - 1):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        bias = floats_at(data.pointers[i, BIAS_AT], d)
        for j in range(d):
            row[6 + d0 + j] += weight * (data.h[d0 + j] + bias[j])
    if not closed_loop:
        for k in range(n):
            row[6 + k] -= weight * data.torque[k]
    for k in range(data.inner_rate.size):
        row[6 + n + k] += weight * data.inner_rate[k]
    return OK
