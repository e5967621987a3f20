r"""The matrix of a Rosenbrock method's stages for a whole system, where arms do not stand alone.

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

Elsewhere, and where stages are projected, they are differences of whole evaluations, central in the
positions, on which everything depends in the most curved way, and forward in the velocities, of
which accelerations are quadratic functions: 3 (6 + n) evaluations for n joints of all arms, one for
each state of an effect, and two more, for the time, where there is control or an effect.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.arrays import open_data, open_system
from multiarm.dynamics.contact_derivatives import arm_columns, column_of_state
from multiarm.dynamics.coordinates import chart_places, force_columns, state_columns
from multiarm.dynamics.equation_derivatives import (
    add_drift_feedback,
    open_equations,
    solve_at_once,
    solve_by_arms,
    write_derivatives,
)
from multiarm.dynamics.force_derivatives import (
    TIME_CHANGE,
    Differences,
    add_slopes,
    begin_differences,
    clear_table,
    differentiate_forces,
)
from multiarm.dynamics.model import Data
from multiarm.dynamics.open_motion import solve_open_motion
from multiarm.dynamics.sliding import slides_of
from multiarm.dynamics.sliding_derivatives import (
    add_friction,
    friction_derivatives,
    open_friction,
)
from multiarm.dynamics.solver.factors import factor_lu, solve_lu
from multiarm.dynamics.solver.solution import WHOLE
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.integration.arm_stages import turn_frames
from multiarm.integration.near_singular import ZONE
from multiarm.integration.step import Step, slope_at
from multiarm.jit.kernels import clear, copy, greatest, inlined, kernel, larger
from multiarm.jit.structs import Floats1, Floats2, Ints1


class FullMatrix(NamedTuple):
    """Arrays for N positions, ``M = N + e`` velocities and states of effects, and w works."""

    # derivatives of the accelerations, rates of states and, last, of the powers; J_p R
    by_position: Floats2  # (M + w, N)
    by_velocity: Floats2  # (M + w, M)
    turned: Floats2  # (M, N)
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
    differences: Differences
    row: Floats1  # (columns,) scratch
    # (D,) of differences: a displaced vector of the chart, and its rates on either side
    displaced: Floats1
    ahead: Floats1
    behind: Floats1

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        derivatives = self.by_position, self.by_velocity, self.turned, self.matrix
        differences = self.displaced, self.ahead, self.behind
        return (*derivatives, self.solution, self.applied, self.row, *differences)


def make_full_matrix(data: Data, step: Step, equations: np.ndarray) -> FullMatrix:
    """Allocate for a system; ``equations`` is the struct of the derivatives of its equations."""
    layout, columns = data.model.layout, data.arrays.slopes.torque.shape[1]
    size, n = step.z.size, layout.nv
    m = step.tolerance.size - n
    return FullMatrix(
        by_position=np.zeros((size - n, n)),
        by_velocity=np.zeros((size - n, m)),
        turned=np.zeros((m, n)),
        matrix=np.zeros((m, m)),
        pivots=np.zeros(m, dtype=np.int64),
        equations=equations,
        friction=friction_derivatives(data, state_columns(data.arrays).end)[1],
        solution=np.zeros((n + layout.contacts, state_columns(data.arrays).end)),
        applied=np.zeros((size - n, columns)),
        powers=data.model.effects.powers,
        differences=Differences(laws=len(data.model.constants.control), order=1),
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
    """Whether the constraints are far from a change of their rank."""
    return not step.stage.projects and open_data(step.system).solution.margin >= ZONE


# --- exact ----------------------------------------------------------------------------------------


@kernel
def differentiate_equations_and_forces(step, full, time_slope, h):
    """Write exact derivatives; returns a status, ``SINGULAR`` where there are none."""
    struct, stage, differences = step.system, step.stage, full.differences
    model, data, _ = open_system(struct)
    status = write_derivatives(struct, full.equations)
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
    return status


@inlined
def solve_equations(struct, full):
    """Solve for the derivatives at fixed forces and those by forces; returns a status."""
    data = open_data(struct)
    wrench = state_columns(data).wrench
    dF_o = open_equations(full.equations).dF_o
    for l in range(chart_places(data).joints):
        dF_o[l, wrench + l] = -1.0
    if data.solution.elimination == WHOLE:
        return solve_by_arms(struct, full.equations, full.solution)
    if data.solution.motion_unique:
        return solve_at_once(struct, full.equations, full.solution)
    return solve_open_motion(struct, full.equations, full.friction, full.solution)


@kernel
def respond_to_forces(data, full, i):
    """Write the derivatives of unknown i of the equations, the forces' too, into ``full.row``."""
    at, places, row, solution = state_columns(data), chart_places(data), full.row, full.solution[i]
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
    for s in range(slides.row.size):
        i, mu, row = slides.arm[s], slides.mu[s], slides.row[s]
        own, pull = arm_columns(work.dofs[i + 1] - work.dofs[i], False), mu * data.rows.force[row]
        respond_to_forces(data, full, data.state.velocity.size + row)
        for c in range(full.row.size):
            full.row[c] *= mu * slides.speed[s]
        for c in range(own.end):
            full.row[column_of_state(columns, own, work.dofs[i], c)] += pull * friction.speed[s, c]
        for power in (slides.numbers.power, data.effects.power.size - 1):
            of_power = full.applied[first + power]
            for c in range(full.row.size):
                of_power[c] -= full.row[c]


@inlined
def write_responses(data, full, time_slope):
    """Write what the derivatives of the equations and of the forces amount to."""
    at, columns, places = state_columns(data), force_columns(data), chart_places(data)
    nv, row = data.state.velocity.size, full.row
    clear(time_slope)
    for i in range(full.applied.shape[0]):
        if i < nv:
            respond_to_forces(data, full, i)
        else:
            copy(full.applied[i], row)
        for l in range(nv):
            joint = l - places.joints
            of_frame = l < places.joints
            full.by_position[i, l] = row[l if of_frame else at.positions + joint]
            full.by_velocity[i, l] = row[at.twists + l if of_frame else at.rates + joint]
        for k in range(data.effects.states.size):
            full.by_velocity[i, nv + k] = row[columns.states + k]
        time_slope[places.velocity + i] = row[columns.time]


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
    for j in range(m):
        change = relative_change * (fast if j < nv else strong)
        z[nv + j] = step.z[nv + j] + change
        status = slope_at(step, t, z, ahead)
        if status != OK:
            return status
        z[nv + j] = step.z[nv + j]
        for i in range(rows):
            full.by_velocity[i, j] = (ahead[nv + i] - slope[nv + i]) / change
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
def factor_full(gamma, full, struct, velocity, h):
    """Factors of the linear system of all stages; returns whether they can be used.

    ``velocity`` is that at the beginning of the step.
    """
    frames = chart_places(open_data(struct)).joints
    m, a = full.matrix.shape[0], 1.0 / gamma
    for i in range(m):
        row, by_position = full.turned[i], full.by_position[i]
        for j in range(row.size):
            row[j] = by_position[j] / a
        turn_frames(frames, a, -0.5 * h, velocity, by_position, row)
        for j in range(m):
            full.matrix[i, j] = -h * full.by_velocity[i, j]
        for j in range(row.size):
            full.matrix[i, j] -= h * h * row[j]
        full.matrix[i, i] += a
    return factor_lu(full.matrix, m, full.pivots) > 0.0


@kernel
def solve_full_stage(gamma, full, struct, velocity, h, right, out):
    """Solve a stage's system for the right-hand side ``right``, which is overwritten."""
    places = chart_places(open_data(struct))
    m, a = full.matrix.shape[0], 1.0 / gamma
    nv = places.velocity
    rates = out[nv : nv + m]
    for i in range(m):
        s = right[nv + i]
        for j in range(nv):
            s += h * full.turned[i, j] * right[j]
        rates[i] = s
    solve_lu(full.matrix, m, full.pivots, rates)
    for i in range(nv):
        right[i] += h * rates[i]
        out[i] = right[i] / a
    turn_frames(places.joints, a, 0.5 * h, velocity, right, out)
    for i in range(m, full.by_position.shape[0]):
        s = right[nv + i]
        for j in range(nv):
            s += h * full.by_position[i, j] * out[j]
        for j in range(m):
            s += h * full.by_velocity[i, j] * rates[j]
        out[nv + i] = s / a
