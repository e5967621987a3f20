r"""Recorded control: torques, or references of springs and dampers, from a table over time.

Between two rows every column is a polynomial (:mod:`multiarm.dynamics.piecewise`): a constant
(``hold``), a line (``linear``) or a piece of the cubic spline (``cubic``: continuous up to the
second derivative, not-a-knot at its ends).  Outside the table, values are those of the first and
the last row, at rest, or zero.

* *torque*: :math:`\tau = y(t)`.
* *position*: :math:`\tau = K_p\,(y(t) - q) + K_d\,(\dot y(t) - \dot q)`, as joint PD.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.control.gravity_compensation import carrying_laws, reach_with
from multiarm.control.joint_pd import add_spring, differentiate_springs
from multiarm.control.program import ControlContext, ControlProgram
from multiarm.control.tables import read_table
from multiarm.dynamics.arrays import OPEN_LOOP, open_data
from multiarm.dynamics.control_laws import ControlLaw, view_of_law
from multiarm.dynamics.model import ControlSpan
from multiarm.dynamics.piecewise import polynomial, row_at
from multiarm.jit.kernels import cfunc, kernel
from multiarm.jit.structs import Flag, Floats1, Floats3, struct_at
from multiarm.scene.control import RecordedControl

INTERPOLATIONS = {"hold": 0, "linear": 1, "cubic": 3}


class RecordedTorques(NamedTuple):
    """A table of torques as piecewise polynomials."""

    times: Floats1  # (r,) [s], of the rows
    coefficients: Floats3  # (r - 1, n, degree + 1), highest power first [N m, N]
    last_row: Floats1  # (n,)
    zero_outside: Flag  # outside the table: zero, else its first and its last row


class RecordedPositions(NamedTuple):
    """Springs and dampers, and the table of their references, in the same form."""

    stiffness: Floats1  # (n,) [N m/rad, N/m]
    damping: Floats1  # (n,) [N m s/rad, N s/m]
    times: Floats1
    coefficients: Floats3
    last_row: Floats1
    zero_outside: Flag


open_torques, open_positions = view_of_law(RecordedTorques), view_of_law(RecordedPositions)


@cfunc
def recorded_torques(address, size, at, t):
    """Add the torques."""
    struct = struct_at(address, size)
    data, table = open_data(struct), open_torques(struct, at)
    row = row_at(table.times, t)
    for j in range(data.control.torque.size):
        value, _ = table_point(t, table, row, j)
        data.control.torque[j] += value
    return 0


@cfunc
def recorded_positions(address, size, at, t):
    """Add the torques of the springs and dampers."""
    struct = struct_at(address, size)
    data, law = open_data(struct), open_positions(struct, at)
    row = row_at(law.times, t)
    for j in range(data.control.torque.size):
        reference, rate = table_point(t, law, row, j)
        add_spring(law, j, reference, rate, data)
    return 0


@cfunc
def differentiate_recorded_positions(address, size, at, _t):
    """Add the derivatives of the torques."""
    struct = struct_at(address, size)
    differentiate_springs(open_positions(struct, at), open_data(struct))
    return 0


@kernel
def table_point(t, table, row, joint):
    """Value of one joint and its rate at time ``t``, which is after ``row``, see `row_at`."""
    if row < 0 or row == table.times.size - 1:  # before the first row, from the last one on
        if table.zero_outside:
            return 0.0, 0.0
        if row < 0:
            return table.coefficients[0, joint, table.coefficients.shape[2] - 1], 0.0
        return table.last_row[joint], 0.0
    return polynomial(table.coefficients[row, joint], t - table.times[row])


def recorded_program(control: RecordedControl, context: ControlContext) -> ControlProgram:
    """The law that plays a table back."""
    names, interpolation = context.joint_names, control.interpolation
    driven = [f"{arm}/{joint}" for arm in context.arms for joint in context.arms[arm].joint_names]
    rows = read_table(control, driven)
    times, zero = rows.times, control.outside == "zero"
    span = ControlSpan(
        f"the table {control.file.name}",
        float(times[0]),
        float(times[-1]),
        control.where_no_rows_are,
    )
    follows = control.quantity == "position"
    values = rows.stacked(names, context.start_angles if follows else np.zeros(len(names)))
    table = RecordedTorques(times, polynomials(times, values, interpolation), values[-1], zero)
    breakpoints = rough_times(times, values, interpolation, zero)
    if not follows:
        law = ControlLaw(recorded_torques, table)
        return ControlProgram((law,), breakpoints, span, reach=OPEN_LOOP)
    stiffness, damping = context.stacked(control.stiffness), context.stacked(control.damping)
    numbers, carrying = RecordedPositions(stiffness, damping, *table), carrying_laws(context)
    law = ControlLaw(recorded_positions, numbers, differentiate_recorded_positions)
    return ControlProgram(
        (law, *carrying),
        breakpoints,
        span,
        reach=reach_with(carrying),
    )


def polynomials(times: np.ndarray, values: np.ndarray, interpolation: str) -> np.ndarray:
    """Coefficients between the rows, shape (r - 1, n, degree + 1), highest power first."""
    if interpolation == "hold":
        return values[:-1, :, None]
    if interpolation == "linear":
        slope = np.diff(values, axis=0) / np.diff(times)[:, None]
        return np.stack([slope, values[:-1]], axis=2)
    from scipy.interpolate import CubicSpline

    return np.ascontiguousarray(CubicSpline(times, values).c.transpose(1, 2, 0))


def rough_times(
    times: np.ndarray, values: np.ndarray, interpolation: str, zero: bool
) -> np.ndarray:
    """Times at which steps end: of jumps (hold), of kinks (linear), and the ends of the table."""
    inner = np.zeros(0)
    if interpolation == "hold":
        inner = times[1:][np.any(np.diff(values, axis=0) != 0.0, axis=1)]
    elif interpolation == "linear":
        slope = np.diff(values, axis=0) / np.diff(times)[:, None]
        # the slopes of rows on one line differ by roundings
        scale = np.abs(slope[1:]) + np.abs(slope[:-1])
        inner = times[1:-1][np.any(np.abs(np.diff(slope, axis=0)) > 1e-12 * scale, axis=1)]
    varies = bool(np.any(values != values[0])) or (zero and bool(np.any(values != 0.0)))
    return np.union1d(inner, times[[0, -1]]) if varies else inner
