r"""Derivatives of the forces of control and effects.

Control may have closed forms (:attr:`multiarm.control.program.ControlProgram.derivative`); all else
is differentiated by differences of order four,

.. math:: f' = \frac{8 (f_1 - f_{-1}) - f_2 + f_{-2}}{12 h} .
"""

from __future__ import annotations

import numpy as np

from multiarm.arms.terms import BIAS_AT
from multiarm.dynamics.arrays import OPEN_LOOP, open_data, open_system
from multiarm.dynamics.contact_derivatives import OFFSETS, STEP, difference_weight
from multiarm.dynamics.coordinates import chart_places, state_columns
from multiarm.dynamics.model import Data
from multiarm.dynamics.status import OK
from multiarm.jit.kernels import INTS, TABLE, TRUTH, clear, kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.structs import floats_at
from multiarm.spatial import retract_into


def applied_derivatives(data: Data, closed_loop: bool) -> np.ndarray | None:
    """Derivatives of what control and effects add to the forces, at the state in the data.

    Of generalised forces and rates of effects' states (e), by the columns of the state
    (:mod:`multiarm.dynamics.layout`) and effects' states, shape (6 + n + e, 12 + 2 n + e); None
    where nothing depends on these.  Without ``closed_loop`` the control's torques are held.
    """
    model, layout, e = data.model, data.model.layout, data.arrays.inner.size
    follows = len(model.constants.control) > 0 and model.constants.control_reach > OPEN_LOOP
    by_law = _law_derivatives(data) if closed_loop and follows else None
    by_differences = closed_loop and follows and by_law is None
    by_state = np.zeros((2 * layout.nv + e, layout.nv + e))
    if by_differences or model.effects.kernels:
        if differentiate_forces(data.struct, by_differences, by_state) != OK:
            data.reraise()
    elif by_law is None:
        return None
    if by_law is not None:
        by_state[: 2 * layout.nv, layout.of_joints] += by_law.T
    return by_state.T


def _law_derivatives(data: Data) -> np.ndarray | None:
    """Derivatives of the torques in closed form, where these act as they are commanded."""
    law, constants = data.model.control_derivative, data.model.constants
    drives_act = constants.actuator_end > constants.passive_end
    contacts_open = data.arrays.modes.closed != 0
    return None if law is None or drives_act or contacts_open else law(data)


@kernel
def differentiate_forces(struct: INTS, closed_loop: TRUTH, by_state: TABLE):
    """Write what :func:`applied_derivatives` describes, transposed; returns a status.

    At the end the data are as they were.
    """
    data = open_data(struct)
    for column in range(by_state.shape[0]):
        row = by_state[column]
        clear(row)
        status = differentiate_by_entry(struct, data, column, closed_loop, row)
        if status != OK:
            return status
    return add_forces(struct, 0.0, closed_loop, by_state[0])


@kernel
def differentiate_by_entry(struct, data, column, closed_loop, row):
    """Add the derivatives by one column of the state; returns a status."""
    at = state_columns(data)
    if column < at.twists:
        return differentiate_by_pose(struct, data, column // 6, column % 6, closed_loop, row)
    if column < at.positions:
        values, place = data.velocity, column - at.twists
    elif column < at.rates:
        values, place = data.angles, column - at.positions
    elif column < at.end:
        values, place = data.v, column - at.rates
    else:
        values, place = data.inner, column - at.end
    return differentiate_by_number(struct, values, place, closed_loop, row)


@kernel
def differentiate_by_number(struct, values, place, closed_loop, row):
    """Add the derivatives by one number in the data; returns a status."""
    before = values[place]
    for offset in OFFSETS:
        values[place] = before + offset * STEP
        status = add_forces(struct, difference_weight(offset), closed_loop, row)
        if status != OK:
            return status
    values[place] = before
    return OK


@kernel
def differentiate_by_pose(struct, data, frame, axis, closed_loop, row):
    """Add the derivatives by a displacement of one frame along or about an axis of the world."""
    if axis < 3:
        return differentiate_by_number(struct, data.poses[frame], axis, closed_loop, row)
    quaternion = data.poses[frame, 3:7]
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    for offset in OFFSETS:
        h = offset * STEP
        about_x, about_y = h if axis == 3 else 0.0, h if axis == 4 else 0.0
        retract_into((x, y, z, w), (about_x, about_y, h - about_x - about_y), quaternion)
        status = add_forces(struct, difference_weight(offset), closed_loop, row)
        if status != OK:
            return status
    quaternion[0], quaternion[1], quaternion[2], quaternion[3] = x, y, z, w
    return OK


@kernel
def add_forces(struct, weight, closed_loop, row):
    """Add the forces of control and effects at the state in the data, times a weight, to a row."""
    _, data, work = open_system(struct)
    status = call_cfunc(data.functions.kinematics, struct, 0.0, 0.0)
    if status != OK:
        return status
    places = chart_places(data)
    for k in range(places.joints):  # weight and gyroscopic moment
        row[k] -= weight * data.generalised_forces[k]
    status = call_cfunc(data.functions.forces, struct, 0.0, 0.0)
    if status != OK:
        return status
    for k in range(data.generalised_forces.size):
        row[k] += weight * data.generalised_forces[k]
    for i in range(work.dofs.size - 1):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        bias = floats_at(data.pointers[i, BIAS_AT], d)
        for j in range(d):
            row[places.joints + d0 + j] += weight * bias[j]
    if not closed_loop:
        for k in range(data.torque.size):
            row[places.joints + k] -= weight * data.torque[k]
    for k in range(data.inner_rate.size):
        row[places.velocity + k] += weight * data.inner_rate[k]
    return OK
