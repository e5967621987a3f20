r"""One step of a variational integrator: symplectic, for long runs that keep their energy.

The action over a step is replaced by that of its midpoint, with constant velocities
``(v, omega, q')`` over the step,

.. math::
    L_d = h\,L(\bar x, \bar R, \bar q, v, \omega, q'), \qquad
    x_1 = x_0 + h v,\quad R_1 = \exp(h\omega) R_0,\quad q_1 = q_0 + h q'

(bars: at the midpoint), and the motion makes the discrete action stationary among those that keep
the joints closed at both ends (J.E. Marsden, M. West, Acta Numerica 10, 2001; S. Leyendecker, J.E.
Marsden, M. Ortiz, ZAMM 88, 2008).  In terms of momenta at the ends, with ``F`` all forces along the
motion, controls and effects included, and :math:`\Lambda` impulses of the contacts,

.. math::
    p_0 + \tfrac h2 F + W(q_0)\, \Lambda_0 &= \pi, \qquad \varphi(q_1) = 0 \\
    p_1 = \pi + \tfrac h2 F + W(q_1)\, \Lambda_1, &\qquad W(q_1)^T v_1 = 0,\quad p_1 = M(q_1) v_1 .

For the arms :math:`\pi = \bar M q'` and :math:`F = \partial T/\partial q - \partial V/\partial q
+ Q = f + (C + C^T) q'`, with ``f`` the forces of the equations of motion and ``C`` the arm's
matrix of Coriolis forces, for which :math:`\dot M = C + C^T`.  For an object, in world axes and
with the inertia at the beginning of the step,

.. math::
    \pi = l + \tfrac12\theta\times l + \gamma\,\theta\times(\theta\times l), \qquad
    l = I_0\,\omega,\quad \theta = h\omega

(``gamma`` as in :func:`multiarm.spatial.write_chart_rate`): without forces the angular momentum is
kept exactly.  The first line is solved by Newton's method with the node system of the midpoint in
place of the exact derivative, so that a step costs as much per arm as some evaluations; the second
is one projection of the momentum.

The map is symplectic without controls and damping, of order 2 and symmetric: the energy error stays
bounded over times that grow exponentially with 1/h, where other methods drift.  Joints without slip
(rolling) are closed in their velocities at the midpoint; such systems are not Hamiltonian.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from multiarm.contacts.kernel import open_contact
from multiarm.contacts.table import open_code, rolls
from multiarm.dynamics.arrays import open_system
from multiarm.dynamics.contact_forces import add_contact_forces
from multiarm.dynamics.coordinates import chart_places, load_chart, retract_into
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import finite, solve_frictionless, update_kinematics
from multiarm.dynamics.momenta import write_momenta
from multiarm.dynamics.status import CALLBACK_FAILED, NOT_CONVERGED, OK
from multiarm.integration.step import METHOD_WORK, Step, open_step
from multiarm.jit.kernels import cfunc, clear, copy, greatest, inlined, kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.jit.structs import Floats1, Floats2, Floats3, Ints2, floats_at, struct_at, view
from multiarm.robots.joined import copy_matrices
from multiarm.robots.terms import CoriolisCalls, open_matrix
from multiarm.spatial import write_chart_rate


class VariationalWork(NamedTuple):
    """A step's arrays, for F objects, velocities of V numbers, ``N`` contacts, ``a`` blocks."""

    # the blocks' Coriolis matrices, see :class:`multiarm.robots.terms.Coriolis`
    coriolis_calls: CoriolisCalls
    coriolis: Ints2  # (a, 2)
    coriolis_copies: Ints2  # (k, 6)
    # at the beginning of the step: configuration, constraint matrices, the objects' inertias in
    # world axes, momenta (V,)
    begin: Floats1
    W_o: Floats2  # (N, 6 F)
    W: Floats3  # (a, d, m)
    inertia: Floats3  # (F, 3, 3)
    start: Floats1
    push: Floats1  # (V,), half the impulse of everything but the contacts
    xi: Floats1  # (V,), velocities over the step
    impulse: Floats1  # (N,), of the contacts at the beginning
    gap: Floats1  # (N,), rates that close the gaps at the end
    last: Floats2  # (2, V + N), unknowns and their correction in the iteration before
    momentum: Floats1  # (V,)
    # an object's turn back over the step, and its angular momentum at the beginning
    turn: Floats1
    spin: Floats1

    @property
    def memory(self) -> tuple[np.ndarray, ...]:
        """What steps write, which is zero where a run begins."""
        begin = self.begin, self.W_o, self.W, self.inertia, self.start, self.spin
        unknowns = self.xi, self.impulse, self.last, self.turn
        return (*begin, *unknowns, self.push, self.gap, self.momentum)


def make_variational(data: Data, _step: Step) -> tuple[VariationalWork]:
    """Allocate the arrays of the variational method's steps."""
    layout = data.model.layout
    size, rows = layout.nv, layout.contacts
    coriolis = data.coriolis()
    work = VariationalWork(
        coriolis_calls=coriolis.calls,
        coriolis=coriolis.matrices,
        coriolis_copies=coriolis.copies,
        begin=np.zeros(layout.nq),
        W_o=np.zeros((rows, layout.node)),
        W=np.zeros_like(data.work.W),
        inertia=np.zeros((layout.frames, 3, 3)),
        start=np.zeros(size),
        push=np.zeros(size),
        xi=np.zeros(size),
        impulse=np.zeros(rows),
        gap=np.zeros(rows),
        last=np.zeros((2, size + rows)),
        momentum=np.zeros(size),
        turn=np.zeros(3),
        spin=np.zeros(3),
    )
    return (work,)


_view_work = view(VariationalWork, METHOD_WORK)


@cfunc
def variational_step(address, size, t, h):
    """One step of length ``h`` from time ``t``; writes ``z_new`` and returns a status."""
    struct = struct_at(address, size)
    _, step = open_step(struct)
    work = _view_work(struct)
    status = begin_step(step, work, t, h)
    if status != OK:
        return status
    status = find_velocities(step, work, t, h)
    if status != OK:
        return status
    return end_step(step, work, t, h)


@kernel
def begin_step(step, work, t, h):
    """Momenta and constraint matrices at the beginning, and a guess of the unknowns."""
    _, data, node = open_system(step.system)
    velocity = chart_places(data).velocity
    for k in range(data.rows.force.size):  # of the last evaluation, which was here or near
        work.impulse[k] = 0.5 * h * data.rows.force[k]
    load_chart(step.z, step.base, data)
    copy(data.state.configuration, work.begin)
    data.time.now = t
    status = update_kinematics(step.system)
    step.stage.evaluations += 1
    if status != OK:
        return status
    for o in range(work.inertia.shape[0]):
        for a in range(3):
            for b in range(3):
                at = 6 * o + 3
                work.inertia[o, a, b] = data.bodies.object_inertia[at + a, at + b]
    write_momenta(step.system, work.start)
    for k in range(work.W_o.shape[0]):
        copy(data.rows.W_o[k], work.W_o[k])
    for i in range(data.bodies.pointers.shape[0]):
        for j in range(node.first_joint[i + 1] - node.first_joint[i]):
            copy(node.W[i, j], work.W[i, j])
    for k in range(work.xi.size):
        work.xi[k] = step.z[velocity + k] + 0.5 * h * step.k[0, velocity + k]
    return OK


@kernel
def find_velocities(step, work, t, h):
    """Newton's method for the velocities over the step and the contacts' impulses."""
    # the relative error of the velocities; where roundings keep the corrections above it, they may
    # be this large once they no longer shrink
    converged, rounded, shrinks = 2e-15, 1e-8, 0.3
    model, data, _ = open_system(step.system)
    before = math.inf
    for iteration in range(50):
        move_in_step(work, data, h, t + h)
        status = update_kinematics(step.system)
        if status != OK:
            return status
        for k in range(work.gap.size):
            work.gap[k] = -open_contact(data.rows.kinematics[k]).gap / h
        move_in_step(work, data, 0.5 * h, t + 0.5 * h)
        status = midpoint_forces(step, work, h)
        step.stage.evaluations += 2
        if status != OK:
            return status
        momentum_residual(step, work, h)
        for k in range(work.gap.size):
            on_rates = rolls(open_code(model.contacts.codes[k]).kind)
            rate = open_contact(data.rows.kinematics[k]).gap_rate
            data.rows.c[k] = -rate if on_rates else work.gap[k]
        status = solve_frictionless(step.system, 0.0)
        if status != OK:  # far away: inertias were sound at the beginning
            return status if status == CALLBACK_FAILED else NOT_CONVERGED
        change = correct_unknowns(work, data, iteration)
        if not (math.isfinite(change) and finite(work.xi)):  # no NaN is larger than a number
            return NOT_CONVERGED
        scale = 1.0 + greatest(work.xi)
        # corrections shrink by a nearly constant factor: this is the error left after this one
        left = change * min(change / before, 1.0) if iteration > 0 else change
        if left <= converged * scale or (change <= rounded * scale and change > shrinks * before):
            return OK
        before = change
    return NOT_CONVERGED


@kernel
def correct_unknowns(work, data, iteration):
    """Correct the unknowns by the solution in ``data``; returns the largest change proposed.

    The corrections shrink by a nearly constant factor, since the node system is that half way: a
    secant through the last two of them takes most of what is left (D.G. Anderson, J. ACM 12, 1965).
    """
    size, rows = work.xi.size, work.impulse.size
    change, along, square = 0.0, 0.0, 0.0
    for k in range(size):
        delta = data.accelerations.a[k]
        change = max(change, abs(delta))
        difference = delta - work.last[1, k]
        along += delta * difference
        square += difference * difference
    share = 0.0 if iteration == 0 or not square > 0.0 else along / square
    share = min(0.9, max(-0.9, share))
    for k in range(size + rows):
        if k < size:
            delta, old = data.accelerations.a[k], work.xi[k]
        else:
            delta, old = data.rows.force[k - size], work.impulse[k - size]
        new = old + delta - share * (old + delta - work.last[0, k] - work.last[1, k])
        work.last[0, k], work.last[1, k] = old, delta
        if k < size:
            work.xi[k] = new
        else:
            work.impulse[k - size] = new
    return change


@kernel
def move_in_step(work, data, delay, t):
    """Write the state at the time ``delay`` after the beginning of the step into the data."""
    state = data.state
    frames, bases = state.poses.shape[0], state.floating_bases
    retract_into(frames, bases, work.begin, delay, work.xi, state.configuration)
    copy(work.xi, data.state.velocity)
    data.time.now = t


@kernel
def midpoint_forces(step, work, h):
    """Kinematics and forces at the midpoint: ``push = h F / 2``; returns a status."""
    _, data, node = open_system(step.system)
    status = update_kinematics(step.system)
    if status != OK:
        return status
    calls = work.coriolis_calls
    if calls.callback != 0:
        call_python(calls.callback)
    if calls.compiled != 0:
        call_cfunc(calls.compiled, struct_at(calls.robots_struct, calls.robots_size), 0.0, 0.0)
    copy_matrices(work.coriolis_copies)
    if data.status.failed:
        return CALLBACK_FAILED
    status = call_cfunc(data.functions.forces, step.system, 0.0, 0.0)
    if status != OK:
        return status
    push, half = work.push, 0.5 * h
    for o in range(data.state.twists.shape[0]):
        push_object(o, data, push, half)
    first_joint = chart_places(data).joints
    for i in range(data.bodies.pointers.shape[0]):
        d0, d = node.first_joint[i], node.first_joint[i + 1] - node.first_joint[i]
        matrix = open_matrix(work.coriolis[i])
        stride = matrix.stride
        C = floats_at(matrix.at, d * stride)
        for a in range(d):
            s = data.forces.f_j[d0 + a]
            for b in range(d):
                s += (C[a * stride + b] + C[b * stride + a]) * data.state.joint_rates[d0 + b]
            push[first_joint + d0 + a] = half * s
    return OK


@inlined
def push_object(o, data, push, half):
    """Write half the impulse of everything but the contacts on one object."""
    inertia, f_o, w, at = (
        data.bodies.object_inertia,
        data.forces.f_o,
        data.state.twists[o][3:6],
        6 * o,
    )
    u, v, s = at + 3, at + 4, at + 5
    l0 = inertia[u, u] * w[0] + inertia[u, v] * w[1] + inertia[u, s] * w[2]
    l1 = inertia[v, u] * w[0] + inertia[v, v] * w[1] + inertia[v, s] * w[2]
    l2 = inertia[s, u] * w[0] + inertia[s, v] * w[1] + inertia[s, s] * w[2]
    for k in range(at, u):
        push[k] = half * f_o[k]
    # the gyroscopic moment is part of the momentum here
    push[u] = half * (f_o[u] + w[1] * l2 - w[2] * l1)
    push[v] = half * (f_o[v] + w[2] * l0 - w[0] * l2)
    push[s] = half * (f_o[s] + w[0] * l1 - w[1] * l0)


@kernel
def momentum_residual(step, work, h):
    """``p_0 + W_0 Lambda_0 + h F / 2 - pi`` into ``data.forces.f_o`` and ``data.forces.f_j``.

    Needs the kinematics of the midpoint in ``data``.
    """
    _, data, node = open_system(step.system)
    momentum, turn, spin = work.momentum, work.turn, work.spin
    write_momenta(step.system, momentum)
    for o in range(work.inertia.shape[0]):
        at = 6 * o + 3
        for a in range(3):
            turn[a] = -h * work.xi[at + a]
            spin[a] = 0.0
            for b in range(3):
                spin[a] += work.inertia[o, a, b] * work.xi[at + b]
        write_chart_rate(turn, spin, momentum[at : at + 3])
    for k in range(momentum.size):
        momentum[k] = work.start[k] + work.push[k] - momentum[k]
    first = chart_places(data).joints
    add_contact_forces(node, work.W_o, work.W, work.impulse, momentum[:first], momentum[first:])
    copy(momentum, data.forces.f)


@kernel
def end_step(step, work, t, h):
    """Momenta at the end, and from them the velocities that the joints allow: ``z_new``."""
    _, data, node = open_system(step.system)
    places, z, new, momentum = chart_places(data), step.z, step.z_new, work.momentum
    for k in range(momentum.size):
        momentum[k] = work.start[k] + 2.0 * work.push[k]
    first = chart_places(data).joints
    add_contact_forces(node, work.W_o, work.W, work.impulse, momentum[:first], momentum[first:])
    move_in_step(work, data, h, t + h)
    status = update_kinematics(step.system)
    step.stage.evaluations += 1
    if status != OK:
        return status
    copy(momentum, data.forces.f)
    clear(data.rows.c)
    status = solve_frictionless(step.system, 0.0)
    if status != OK:
        return status
    for k in range(work.xi.size):  # the chart's rotation vectors begin at zero
        new[k] = z[k] + h * work.xi[k]
        new[places.velocity + k] = data.accelerations.a[k]
    for k in range(data.effects.power.size):
        new[places.works + k] = z[places.works + k] + h * data.effects.power[k]
    return OK
