r"""The matrix of a Rosenbrock method's stages for a whole system, where blocks do not stand alone.

With velocities and states of effects :math:`v`, the derivatives of their rates :math:`J_p, J_v` by
positions and by these, and R and the right-hand sides of :mod:`multiarm.integration.rosenbrock`,

.. math::
    k_p = R\,(r_p + h k_v), \qquad
    \Big(\frac1\gamma - h J_v - h^2 J_p R\Big) k_v = r_v + h J_p R\, r_p, \qquad
    k_w = \gamma\,\big(r_w + h (J_{wp} k_p + J_{wv} k_v)\big):

one matrix as large as there are velocities, half as large as the state, without states of effects.

*The derivatives* are exact where the constraints keep their rank: those of the equations of motion
(:mod:`multiarm.dynamics.equation_derivatives`, :mod:`multiarm.dynamics.open_motion`) and of the
forces of control and effects (:mod:`multiarm.dynamics.force_derivatives`).  With the generalised
forces f, their responses :math:`\partial\dot v/\partial f` are columns of the same solution,

.. math::
    \frac{d\dot v}{dx} = \frac{\partial\dot v}{\partial x}
        + \frac{\partial\dot v}{\partial f}\,\frac{\partial f}{\partial x}.

*Projected stages* have the rates of the projected state, whose positions and velocities
(:mod:`multiarm.integration.projection`) change on the constraints by

.. math::
    dq' = (1 - P\,W^T)\, dq, \qquad
    dv' = (1 - P\,W^T)\, dv - P\, \frac{\partial (W^T v)}{\partial q}\, dq', \qquad
    P = M^{-1} W (W^T M^{-1} W)^{-1},

where P r are the accelerations from the equations without friction for right-hand sides r of the
contacts.  The rates of their positions are those of :math:`v'`: with the derivatives
:math:`B', V'` of these, :math:`R = (1/\gamma - hB')^{-1}` and :math:`R V'` take the places of R in
:math:`k_p` and beside :math:`k_v`.

Elsewhere the derivatives are differences of whole evaluations: where constraints nearly lose rank,
since accelerations are interpolated there from six states, and where contacts slide while stages
are projected.  They are central in the positions, on which everything depends in the most curved
way, and forward in the velocities, of which accelerations are quadratic functions: 3 (6 F + n)
evaluations for n joints of all blocks, one for each state of an effect, and two more, for the time,
where there is control or an effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.coordinates import (
    block_columns,
    chart_places,
    column_of_displacement,
    column_of_state,
    column_of_velocity,
    equation_columns,
    force_columns,
)
from multiarm.dynamics.data import Data
from multiarm.dynamics.equation_derivatives import (
    add_drift_feedback,
    columns_of_block,
    gap_weight,
    open_equations,
    open_links,
    separate_dependent_rows,
    solve_at_once,
    solve_by_blocks,
    stack_matrix,
    write_derivatives,
)
from multiarm.dynamics.force_derivatives import (
    TIME_CHANGE,
    ForceDifferences,
    add_slopes,
    begin_differences,
    clear_table,
    differentiate_forces,
)
from multiarm.dynamics.open_motion import solve_open_motion
from multiarm.dynamics.sliding import slides_of
from multiarm.dynamics.sliding_derivatives import (
    add_friction,
    friction_derivatives,
    open_friction,
)
from multiarm.dynamics.solver.factors import factor_lu, solve_lu, solve_rows
from multiarm.dynamics.solver.solution import WHOLE
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.integration.block_stages import turn_bases, turn_frames
from multiarm.integration.near_singular import ZONE, may_cross
from multiarm.integration.step import Step, slope_at
from multiarm.jit.kernels import allocating, clear, copy, greatest, inlined, kernel, larger
from multiarm.jit.structs import Floats1, Floats2, Ints1
from multiarm.jit.vectors import AXES, cross, vec


class FullMatrix(NamedTuple):
    """Arrays for N positions, ``M = N + e`` velocities and states of effects, and w works."""

    # derivatives of the accelerations, rates of states and, last, of the powers; J_p R
    by_position: Floats2  # (M + w, N)
    by_velocity: Floats2  # (M + w, M)
    turned: Floats2  # (M, N)
    # of projected stages: positions by positions, their rates by velocities and by positions, with
    # N + contacts rows at first; R, and R times the second
    projection: Floats2  # (N + contacts, 3 N)
    positions: Floats2  # (N, N)
    by_rates: Floats2  # (N, N)
    # factors of the linear system
    matrix: Floats2  # (M, M)
    pivots: Ints1  # (M,)
    # of exact derivatives: struct of those of the equations; their solution (N + contacts, columns
    # of the state, torques and wrench on the object); those of forces, rates of states and powers
    # (M + w, columns), and of the powers' places
    equations: Ints1
    friction: Ints1  # struct of multiarm.dynamics.sliding_derivatives
    solution: Floats2
    applied: Floats2
    powers: Ints1
    differences: ForceDifferences
    row: Floats1  # (columns,) scratch
    # (D,) of differences: a displaced vector of the chart, and its rates on either side
    displaced: Floats1
    ahead: Floats1
    behind: Floats1

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        derivatives = self.by_position, self.by_velocity, self.turned, self.matrix
        projected = self.projection, self.positions, self.by_rates
        differences = self.displaced, self.ahead, self.behind
        return (*derivatives, *projected, self.solution, self.applied, self.row, *differences)


def make_full_matrix(data: Data, step: Step, equations: np.ndarray) -> FullMatrix:
    """Allocate for a system; ``equations`` is the struct of the derivatives of its equations."""
    layout, columns = data.model.layout, data.arrays.slopes.torque.shape[1]
    size, n = step.z.size, layout.nv
    m = step.tolerance.size - n
    return FullMatrix(
        by_position=np.zeros((size - n, n)),
        by_velocity=np.zeros((size - n, m)),
        turned=np.zeros((m, n)),
        projection=np.zeros((n + layout.contacts, 3 * n)),
        positions=np.zeros((n, n)),
        by_rates=np.zeros((n, n)),
        matrix=np.zeros((m, m)),
        pivots=np.zeros(m, dtype=np.int64),
        equations=equations,
        friction=friction_derivatives(data, equation_columns(data.arrays).end)[1],
        solution=np.zeros((n + layout.contacts, equation_columns(data.arrays).end)),
        applied=np.zeros((size - n, columns)),
        powers=data.model.effects.powers,
        differences=ForceDifferences(laws=len(data.model.constants.control), order=1),
        row=np.zeros(columns),
        displaced=np.zeros(size),
        ahead=np.zeros(size),
        behind=np.zeros(size),
    )


@kernel
def differentiate_full(step, full, slope, time_slope, t, h):
    """Write the derivatives at the beginning of a step, right after its evaluation.

    ``slope`` is that of the beginning; ``time_slope`` is written.  Returns a status.
    """
    status = SINGULAR
    if is_smooth(step):
        status = differentiate_equations_and_forces(step, full, time_slope, h)
    if status == SINGULAR:
        status = differentiate_by_differences(step, full, slope, time_slope, t, h)
    return status


@inlined
def is_smooth(step):
    """Whether derivatives are exact: the constraints are far from a change of their rank."""
    data = open_data(step.system)
    if step.stage.projects:
        return not may_cross(data) and not data.modes.slides
    return data.solution.margin >= ZONE


# --- exact ----------------------------------------------------------------------------------------


@kernel
def differentiate_equations_and_forces(step, full, time_slope, h):
    """Write exact derivatives; returns a status, ``SINGULAR`` where there are none."""
    struct, stage, differences = step.system, step.stage, full.differences
    model, data, _ = open_system(struct)
    status = write_derivatives(struct, full.equations)
    if status == OK and stage.projects:
        status = differentiate_projection(struct, full)
    if status == OK and data.modes.slides:
        status = add_friction(struct, full.equations, full.friction)
    if status == OK:
        add_drift_feedback(struct, full.equations, stage.alpha, stage.beta)
        status = solve_equations(struct, full)
    if status != OK:
        return status
    begin_differences(model, data, differences, h)
    clear_table(data.slopes.torque)
    clear_table(full.applied)
    status = differentiate_forces(struct, differences, full.powers, add_slopes, full.applied)
    stage.evaluations += differences.evaluations
    if status == OK:
        if data.modes.slides:
            add_friction_power(struct, full)
        write_responses(data, full, time_slope)
        if stage.projects:
            follow_projection(data, full)
    return status


@inlined
def solve_equations(struct, full):
    """Solve for the derivatives at fixed forces and those by forces; returns a status."""
    data = open_data(struct)
    wrench = equation_columns(data).wrench
    dF_o = open_equations(full.equations).dF_o
    for l in range(chart_places(data).joints):
        dF_o[l, wrench + l] = -1.0
    if data.solution.elimination == WHOLE:
        return solve_by_blocks(struct, full.equations, full.solution)
    if data.solution.motion_unique:
        return solve_at_once(struct, full.equations, full.solution)
    return solve_open_motion(struct, full.equations, full.friction, full.solution)


@kernel
def respond_to_forces(data, full, i):
    """Write the derivatives of unknown i of the equations, the forces' too, into ``full.row``."""
    at, places, row, solution = (
        equation_columns(data),
        chart_places(data),
        full.row,
        full.solution[i],
    )
    clear(row)
    for c in range(at.torques):
        row[c] = solution[c]
    for l in range(places.velocity):
        torque = at.torques + l - places.joints
        response = solution[at.wrench + l if l < places.joints else torque]
        for c in range(row.size):
            row[c] += response * full.applied[l, c]


@kernel
def add_friction_power(struct, full):
    """Add the derivatives of the power of sliding friction, ``-mu lambda_n (s . d)``."""
    _, data, work = open_system(struct)
    slides, friction, columns = slides_of(data), open_friction(full.friction), force_columns(data)
    first = data.state.velocity.size + data.effects.states.size
    node = chart_places(data).joints
    for s in range(slides.row.size):
        i, mu, row = slides.block[s], slides.mu[s], slides.row[s]
        of_block = block_columns(node, work.first_joint[i + 1] - work.first_joint[i], 0)
        pull = mu * data.rows.force[row]
        respond_to_forces(data, full, data.state.velocity.size + row)
        for c in range(full.row.size):
            full.row[c] *= mu * slides.speed[s]
        for c in range(of_block.end):
            column = column_of_state(columns, of_block, work.first_joint[i], c)
            full.row[column] += pull * friction.speed[s, c]
        for power in (slides.numbers.power, data.effects.power.size - 1):
            of_power = full.applied[first + power]
            for c in range(full.row.size):
                of_power[c] -= full.row[c]


@inlined
def write_responses(data, full, time_slope):
    """Write what the derivatives of the equations and of the forces amount to."""
    columns, places = force_columns(data), chart_places(data)
    nv, row = data.state.velocity.size, full.row
    clear(time_slope)
    for i in range(full.applied.shape[0]):
        if i < nv:
            respond_to_forces(data, full, i)
        else:
            copy(full.applied[i], row)
        for l in range(nv):
            full.by_position[i, l] = row[column_of_displacement(columns, l)]
            full.by_velocity[i, l] = row[column_of_velocity(columns, l)]
        for k in range(data.effects.states.size):
            full.by_velocity[i, nv + k] = row[columns.states + k]
        time_slope[places.velocity + i] = row[columns.time]


@allocating
def differentiate_projection(struct, full):
    """Write ``full.projection`` after the derivatives of the equations; returns a status."""
    model, data, system = open_system(struct)
    links, equations = open_links(full.equations), open_equations(full.equations)
    Y = full.projection
    size, nv, joints = Y.shape[0], full.turned.shape[1], chart_places(data).joints
    K, pivots = np.zeros((size, size)), np.zeros(size, np.int64)
    stack_matrix(struct, full.equations, K)
    for i in range(size):
        clear(Y[i])
    for i in range(system.first_joint.size - 1):
        d0, n = system.first_joint[i], system.first_joint[i + 1] - system.first_joint[i]
        columns = columns_of_block(i, n, links, equations)
        for k in range(system.first_contact[i], system.first_contact[i + 1]):
            row, by_gap = Y[nv + k], gap_weight(model, k)
            for l in range(nv):
                row[l], row[nv + l] = by_gap * K[nv + k, l], K[nv + k, l]
            for c in range(columns.twists):
                row[2 * nv + c] = equations.rates[k, c]
            for j in range(n):
                row[2 * nv + joints + d0 + j] = equations.rates[k, columns.positions + j]
    separate_dependent_rows(K, nv, data.solution.dependent)
    if not factor_lu(K, size, pivots) > 0.0:
        return SINGULAR
    solve_rows(K, size, pivots, Y)
    for i in range(nv):
        for c in range(3 * nv):
            Y[i, c] = (1.0 if c == i or c == nv + i else 0.0) - Y[i, c]
    for i in range(nv):
        copy(Y[i, 2 * nv :], full.row[:nv])
        multiply(full.row[:nv], Y, 0, Y[i, 2 * nv :])
    return OK


@kernel
def follow_projection(data, full):
    """Make derivatives at a projected state those by the state before its projection.

    The frames' rates of rotation vectors follow the latter.
    """
    Y, of_positions, of_velocities = full.projection, full.ahead, full.behind
    nv, joints = full.turned.shape[1], chart_places(data).joints
    for i in range(full.by_position.shape[0]):
        by_position, by_velocity = full.by_position[i], full.by_velocity[i, :nv]
        copy(by_position, of_positions[:nv])
        copy(by_velocity, of_velocities[:nv])
        multiply(of_positions[:nv], Y, 0, by_position)
        multiply(of_velocities[:nv], Y, nv, by_velocity)
        multiply(of_velocities[:nv], Y, 2 * nv, of_positions[:nv])
        for c in range(nv):
            by_position[c] += of_positions[c]
    for first in range(0, joints, 6):
        add_turning(Y, 2 * nv, first + 3, data)
    for b in range(data.state.floating_bases.size):
        add_turning(Y, 2 * nv, joints + data.state.floating_bases[b] + 3, data)


@inlined
def add_turning(Y, column, turn, data):
    """Add ``[omega]x / 2`` of the rotation vector from entry ``turn`` on of a displacement."""
    spin = vec(data.state.velocity, turn)
    for axis in range(3):
        rate = cross(spin, AXES[axis])
        for k in range(3):
            Y[turn + k, column + turn + axis] += 0.5 * rate[k]


@inlined
def multiply(row, matrix, first, out):
    """``out = row matrix`` with as many columns from ``first`` on as the row has entries."""
    clear(out)
    for l in range(row.size):
        for c in range(out.size):
            out[c] += row[l] * matrix[l, first + c]


# --- differences ----------------------------------------------------------------------------------


@kernel
def differentiate_by_differences(step, full, slope, time_slope, t, h):
    """Write differences of whole evaluations; returns a status."""
    # changes of a position [m, rad]; of a velocity and of a state of effects, relative to the
    # largest one or to 1
    position_change, relative_change = 2e-6, 1e-6
    places = chart_places(open_data(step.system))
    z, ahead, behind = full.displaced, full.ahead, full.behind
    nv, m, rows = places.velocity, full.matrix.shape[0], full.by_position.shape[0]
    fast = larger(1.0, greatest(step.z[places.velocity : places.states]))
    strong = larger(1.0, greatest(step.z[places.states : places.works]))
    copy(step.z, z)
    for j in range(nv):
        z[j] = step.z[j] - position_change
        status = slope_at(step, t, z, behind)
        if status != OK:
            return status
        z[j] = step.z[j] + position_change
        status = slope_at(step, t, z, ahead)
        if status != OK:
            return status
        z[j] = step.z[j]
        for i in range(rows):
            full.by_position[i, j] = (ahead[nv + i] - behind[nv + i]) / (2.0 * position_change)
        for i in range(nv):
            full.projection[i, 2 * nv + j] = (ahead[i] - behind[i]) / (2.0 * position_change)
    for j in range(m):
        change = relative_change * (fast if j < nv else strong)
        z[nv + j] = step.z[nv + j] + change
        status = slope_at(step, t, z, ahead)
        if status != OK:
            return status
        z[nv + j] = step.z[nv + j]
        for i in range(rows):
            full.by_velocity[i, j] = (ahead[nv + i] - slope[nv + i]) / change
        for i in range(nv if j < nv else 0):
            full.projection[i, nv + j] = (ahead[i] - slope[i]) / change
    return differentiate_by_time(step, full, slope, time_slope, t, h)


@kernel
def differentiate_by_time(step, full, slope, time_slope, t, h):
    """``f_t`` from two later times, inside the step: its beginning may be a kink."""
    model, _, _ = open_system(step.system)
    near, far = full.behind, full.ahead
    clear(time_slope)
    if model.control.shape[0] == 0 and model.effects.shape[0] == 0:
        return OK
    change = TIME_CHANGE * min(h, 1.0)  # [s]
    status = slope_at(step, t + 2.0 * change, step.z, far)
    if status != OK:
        return status
    status = slope_at(step, t + change, step.z, near)
    if status != OK:
        return status
    for i in range(time_slope.size):
        time_slope[i] = (4.0 * near[i] - far[i] - 3.0 * slope[i]) / (2.0 * change)
    return OK


# --- the stages -----------------------------------------------------------------------------------


@kernel
def factor_full(gamma, full, struct, projects, velocity, h):
    """Factors of the linear system of all stages; returns whether they can be used.

    ``velocity`` is that at the beginning of the step.
    """
    data = open_data(struct)
    frames, nv = chart_places(data).joints, full.turned.shape[1]
    m, a = full.matrix.shape[0], 1.0 / gamma
    if projects and not factor_positions(full, a, h):
        return False
    for i in range(m):
        row, by_position, line = full.turned[i], full.by_position[i], full.matrix[i]
        for j in range(m):
            line[j] = -h * full.by_velocity[i, j]
        if projects:
            multiply(by_position, full.by_rates, 0, row)
        else:
            for j in range(nv):
                row[j] = by_position[j] / a
            turn_frames(frames, a, -0.5 * h, velocity, by_position, row)
            turn_bases(data, a, -0.5 * h, velocity, by_position, row)
        for j in range(nv):
            line[j] -= h * h * row[j]
        if projects:
            multiply(by_position, full.positions, 0, row)
        line[i] += a
    return factor_lu(full.matrix, m, full.pivots) > 0.0


@allocating
def factor_positions(full, a, h):
    """Write ``full.positions`` and ``by_rates``; returns whether they can be used."""
    R, Y, nv = full.positions, full.projection, full.positions.shape[0]
    matrix, pivots = np.zeros((nv, nv)), np.zeros(nv, np.int64)
    for i in range(nv):
        for j in range(nv):
            R[i, j] = 1.0 if i == j else 0.0
            matrix[i, j] = a * R[i, j] - h * Y[i, 2 * nv + j]
    if not factor_lu(matrix, nv, pivots) > 0.0:
        return False
    solve_rows(matrix, nv, pivots, R)
    for i in range(nv):
        multiply(R[i], Y, nv, full.by_rates[i])
    return True


@kernel
def solve_full_stage(gamma, full, struct, projects, velocity, h, right, out):
    """Solve a stage's system for the right-hand side ``right``, which is overwritten."""
    data = open_data(struct)
    places, m, a = chart_places(data), full.matrix.shape[0], 1.0 / gamma
    nv = places.velocity
    rates = out[nv : nv + m]
    for i in range(m):
        s = right[nv + i]
        for j in range(nv):
            s += h * full.turned[i, j] * right[j]
        rates[i] = s
    solve_lu(full.matrix, m, full.pivots, rates)
    for i in range(nv):
        if projects:
            s = 0.0
            for j in range(nv):
                s += full.positions[i, j] * right[j] + h * full.by_rates[i, j] * rates[j]
            out[i] = s
        else:
            right[i] += h * rates[i]
            out[i] = right[i] / a
    if not projects:
        turn_frames(places.joints, a, 0.5 * h, velocity, right, out)
        turn_bases(data, a, 0.5 * h, velocity, right, out)
    for i in range(m, full.by_position.shape[0]):
        s = right[nv + i]
        for j in range(nv):
            s += h * full.by_position[i, j] * out[j]
        for j in range(m):
            s += h * full.by_velocity[i, j] * rates[j]
        out[nv + i] = s / a
