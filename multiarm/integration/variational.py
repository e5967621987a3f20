r"""One step of a variational integrator: symplectic, for long runs that keep their energy.

The action over a step is replaced by that of its midpoint, with constant velocities
``(v, omega, q')`` over the step,

.. math::
    L_d = h\,L(\bar x, \bar R, \bar q, v, \omega, q'), \qquad
    x_1 = x_0 + h v,\quad R_1 = \exp(h\omega) R_0,\quad q_1 = q_0 + h q'

(bars: half way), and the motion makes the discrete action stationary among those that keep the
joints closed at both ends (J.E. Marsden, M. West, Acta Numerica 10, 2001; S. Leyendecker, J.E.
Marsden, M. Ortiz, ZAMM 88, 2008).  In terms of momenta at the ends, with ``F`` all that acts along
the motion, controls and effects included, and ``S`` impulses of the contacts,

.. math::
    p_0 + \tfrac h2 F + W(q_0)\, S_0 &= \pi, \qquad \varphi(q_1) = 0 \\
    p_1 = \pi + \tfrac h2 F + W(q_1)\, S_1, &\qquad W(q_1)^T v_1 = 0,\quad p_1 = M(q_1) v_1 .

For the arms :math:`\pi = \bar M q'` and :math:`F = \partial T/\partial q - \partial V/\partial q
+ Q = h + (C + C^T) q'`, with ``h`` the forces of the equations of motion and ``C`` the arm's
matrix of Coriolis forces, for which :math:`\dot M = C + C^T`.  For the object, in world axes and
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

from multiarm.arms.terms import M_AT, M_STRIDE
from multiarm.contacts.kernel import GAP, GAP_RATE
from multiarm.contacts.records import KIND, TANGENT
from multiarm.dynamics.arrays import CALLBACK_FAILED, OK, open_system
from multiarm.dynamics.equations import finite, solve_constrained, update_kinematics
from multiarm.integration.stepper import OWN_EVALUATIONS, Step, load
from multiarm.jit.kernels import cfunc, clear, copy, kernel
from multiarm.jit.pointers import call_cfunc, call_python
from multiarm.jit.structs import Floats1, Floats2, Floats3, Ints1, Ints2, floats_at, struct_at, view
from multiarm.spatial import retract_into, write_chart_rate

# Velocities that are off by less than this, relative to the fastest, are found; where roundings
# keep them from it, they are when they change by less than ROUNDED and no longer get better.
CONVERGED, ROUNDED, BETTER = 2e-15, 1e-8, 0.3
MOST_ITERATIONS = 50
# What a step returns when the iteration does not converge.
NOT_CONVERGED = -18


class VariationalWork(NamedTuple):
    """A step's arrays, for ``n`` joints, ``N`` contacts, ``a`` arms.

    system : int64
        Struct of the system.
    z, z_new, base, k, own
        Of :class:`multiarm.integration.stepper.Step`; ``k[0]`` holds the first slope on entry.
    call : int64 (4,)
        What updates the matrices of Coriolis forces: address of a callback (0: none), and of an
        entry (0: none) with its struct and size.
    coriolis : int64 (a, 2)
        Address and stride of each arm's.
    Wo : (N, 6), W : (a, d, m)
        Constraint matrices at the beginning of the step.
    inertia : (3, 3)
        The object's there, world axes.
    start : (6 + n,), push : (6 + n,)
        Momenta there; half the impulse of everything but the contacts.
    xi : (6 + n,)
        Velocities over the step.
    impulse, gap : (N,)
        Impulses of the contacts at the beginning; rates that close the gaps at the end.
    last : (2, 6 + n + N)
        Unknowns and their correction in the iteration before.
    scratch : (6 + n,)
    """

    system: Ints1
    z: Floats1
    z_new: Floats1
    base: Floats1
    k: Floats2
    own: Ints1
    call: Ints1
    coriolis: Ints2
    Wo: Floats2
    W: Floats3
    inertia: Floats2
    start: Floats1
    push: Floats1
    xi: Floats1
    impulse: Floats1
    gap: Floats1
    last: Floats2
    scratch: Floats1


def make_variational(
    step: Step,
    system_struct: np.ndarray,
    joints: int,
    W_shape: tuple[int, ...],
    rows: int,
    call: np.ndarray,
    coriolis: np.ndarray,
) -> VariationalWork:
    """Allocate the arrays of the variational method's steps.

    ``W_shape`` is that of ``NodeWork.Y``, ``rows`` the number of contacts; ``call`` and
    ``coriolis`` are described in :class:`VariationalWork`.
    """
    size = 6 + joints
    return VariationalWork(
        system=system_struct,
        z=step.z,
        z_new=step.z_new,
        base=step.base,
        k=step.k,
        own=step.own,
        call=call,
        coriolis=coriolis,
        Wo=np.zeros((rows, 6)),
        W=np.zeros(W_shape),
        inertia=np.zeros((3, 3)),
        start=np.zeros(size),
        push=np.zeros(size),
        xi=np.zeros(size),
        impulse=np.zeros(rows),
        gap=np.zeros(rows),
        last=np.zeros((2, size + rows)),
        scratch=np.zeros(size),
    )


_open = view(VariationalWork)


@cfunc
def variational_step(address, size, t, h):
    """One step of length ``h`` from time ``t``; writes ``z_new`` and returns a status."""
    own = _open(struct_at(address, size))
    own.own[OWN_EVALUATIONS] = 0
    status = begin(own, t, h)
    if status != OK:
        return status
    status = find_velocities(own, t, h)
    if status != OK:
        return status
    return end(own, t, h)


@kernel
def begin(own, t, h):
    """Momenta and constraint matrices at the beginning, and a guess of what is unknown."""
    model, data, work = open_system(own.system)
    n = data.angles.size
    for k in range(data.force.size):  # of the last evaluation, which was here or near
        own.impulse[k] = 0.5 * h * data.force[k]
    load(own.z, own.base, data)
    data.time.now = t
    status = update_kinematics(own.system)
    own.own[OWN_EVALUATIONS] += 1
    if status != OK:
        return status
    for a in range(3):
        for b in range(3):
            own.inertia[a, b] = data.inertia[3 + a, 3 + b]
    momenta(model, data, work, own.start)
    for k in range(own.Wo.shape[0]):
        copy(data.Wo[k], own.Wo[k])
    for i in range(data.pointers.shape[0]):
        for j in range(work.dofs[i + 1] - work.dofs[i]):
            copy(work.Y[i, j], own.W[i, j])
    for k in range(6 + n):
        own.xi[k] = own.z[6 + n + k] + 0.5 * h * own.k[0, 6 + n + k]
    return OK


@kernel
def momenta(model, data, work, out):
    """``M v`` of object and arms at the kinematics in ``data``, from ``twist`` and ``v``."""
    for a in range(6):
        s = 0.0
        for b in range(6):
            s += data.inertia[a, b] * data.twist[b]
        out[a] = s
    for i in range(data.pointers.shape[0]):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        stride = data.pointers[i, M_STRIDE]
        M = floats_at(data.pointers[i, M_AT], d * stride)
        for a in range(d):
            s = 0.0
            for b in range(d):  # one triangle is filled
                s += M[a * stride + b if b <= a else b * stride + a] * data.v[d0 + b]
            out[6 + d0 + a] = s


@kernel
def find_velocities(own, t, h):
    """Newton's method for the velocities over the step and the contacts' impulses."""
    model, data, _ = open_system(own.system)
    n, before = data.angles.size, math.inf
    for iteration in range(MOST_ITERATIONS):
        place(own, data, h, t + h)
        status = update_kinematics(own.system)
        if status != OK:
            return status
        for k in range(own.gap.size):
            own.gap[k] = -data.contacts[k, GAP] / h
        place(own, data, 0.5 * h, t + 0.5 * h)
        status = drive(own, h)
        own.own[OWN_EVALUATIONS] += 2
        if status != OK:
            return status
        imbalance(own, h)
        for k in range(own.gap.size):
            rolls = model.codes[k, KIND] == TANGENT
            data.c[k] = -data.contacts[k, GAP_RATE] if rolls else own.gap[k]
        status = solve_constrained(own.system)
        if status != OK:  # far away: inertias were sound at the beginning
            return status if status == CALLBACK_FAILED else NOT_CONVERGED
        change = correct(own, data, iteration)
        fastest = 0.0
        for k in range(6 + n):
            fastest = max(fastest, abs(own.xi[k]))
        if not (math.isfinite(change) and finite(own.xi)):  # no NaN is larger than a number
            return NOT_CONVERGED
        scale = 1.0 + fastest
        # corrections shrink by a nearly constant factor: so much is left after this one
        left = change * min(change / before, 1.0) if iteration > 0 else change
        if left <= CONVERGED * scale or (change <= ROUNDED * scale and change > BETTER * before):
            return OK
        before = change
    return NOT_CONVERGED


@kernel
def correct(own, data, iteration):
    """Correct the unknowns by the solution in ``data``; returns the largest change proposed.

    The corrections shrink by a nearly constant factor, since the node system is that half way: a
    secant through the last two of them takes most of what is left (D.G. Anderson, J. ACM 12, 1965).
    """
    size, rows = own.xi.size, own.impulse.size
    change, along, square = 0.0, 0.0, 0.0
    for k in range(size):
        delta = data.q_o[k] if k < 6 else data.qdd[k - 6]
        change = max(change, abs(delta))
        difference = delta - own.last[1, k]
        along += delta * difference
        square += difference * difference
    share = 0.0 if iteration == 0 or not square > 0.0 else along / square
    share = min(0.9, max(-0.9, share))
    for k in range(size + rows):
        if k < size:
            delta, old = data.q_o[k] if k < 6 else data.qdd[k - 6], own.xi[k]
        else:
            delta, old = data.force[k - size], own.impulse[k - size]
        new = old + delta - share * (old + delta - own.last[0, k] - own.last[1, k])
        own.last[0, k], own.last[1, k] = old, delta
        if k < size:
            own.xi[k] = new
        else:
            own.impulse[k - size] = new
    return change


@kernel
def place(own, data, delay, t):
    """Write the state ``delay`` after the beginning of the step, on its way, into the data."""
    n, turn = data.angles.size, own.scratch[:3]
    for k in range(3):
        data.position[k] = own.z[k] + delay * own.xi[k]
        turn[k] = delay * own.xi[3 + k]
    retract_into(own.base, turn, data.position[3:7])
    for k in range(6):
        data.twist[k] = own.xi[k]
    for j in range(n):
        data.angles[j] = own.z[6 + j] + delay * own.xi[6 + j]
        data.v[j] = own.xi[6 + j]
    data.time.now = t


@kernel
def drive(own, h):
    """Kinematics and forces half way: ``push = h F / 2``; returns a status."""
    _, data, work = open_system(own.system)
    status = update_kinematics(own.system)
    if status != OK:
        return status
    update_coriolis(own.call)
    if data.status.failed:
        return CALLBACK_FAILED
    status = call_cfunc(data.functions.forces, own.system, 0.0, 0.0)
    if status != OK:
        return status
    inertia, w, push, half = data.inertia, data.twist[3:6], own.push, 0.5 * h
    l0 = inertia[3, 3] * w[0] + inertia[3, 4] * w[1] + inertia[3, 5] * w[2]
    l1 = inertia[4, 3] * w[0] + inertia[4, 4] * w[1] + inertia[4, 5] * w[2]
    l2 = inertia[5, 3] * w[0] + inertia[5, 4] * w[1] + inertia[5, 5] * w[2]
    for k in range(3):
        push[k] = half * data.h_o[k]
    # the gyroscopic moment is part of the momentum here
    push[3] = half * (data.h_o[3] + w[1] * l2 - w[2] * l1)
    push[4] = half * (data.h_o[4] + w[2] * l0 - w[0] * l2)
    push[5] = half * (data.h_o[5] + w[0] * l1 - w[1] * l0)
    for i in range(data.pointers.shape[0]):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        stride = own.coriolis[i, 1]
        C = floats_at(own.coriolis[i, 0], d * stride)
        for a in range(d):
            s = data.h[d0 + a]
            for b in range(d):
                s += (C[a * stride + b] + C[b * stride + a]) * data.v[d0 + b]
            push[6 + d0 + a] = half * s
    return OK


@kernel
def update_coriolis(call):
    """Matrices of Coriolis forces of all arms."""
    if call[0] != 0:
        call_python(call[0])
    if call[1] != 0:
        call_cfunc(call[1], struct_at(call[2], call[3]), 0.0, 0.0)


@kernel
def imbalance(own, h):
    """What the momenta at the beginning lack, into ``data.h_o`` and ``data.h``.

    ``p_0 + W_0 S_0 + h F / 2 - pi``; needs the kinematics half way in ``data``.
    """
    model, data, work = open_system(own.system)
    n, momentum = data.angles.size, own.scratch
    momenta(model, data, work, momentum)
    l, theta = data.weight[:3], data.weight[3:]  # noqa: E741  free between evaluations
    for a in range(3):
        theta[a] = -h * own.xi[3 + a]
        l[a] = 0.0
        for b in range(3):
            l[a] += own.inertia[a, b] * own.xi[3 + b]
    write_chart_rate(theta, l, momentum[3:6])
    for k in range(6 + n):
        momentum[k] = own.start[k] + own.push[k] - momentum[k]
    add_impulses(own.Wo, own.W, own.impulse, work, momentum)
    for k in range(6):
        data.h_o[k] = momentum[k]
    for j in range(n):
        data.h[j] = momentum[6 + j]


@kernel
def add_impulses(Wo, W, impulse, work, out):
    """Add what contact impulses do to the momenta."""
    for i in range(work.dofs.size - 1):
        d0, first = work.dofs[i], work.rows[i]
        for k in range(first, work.rows[i + 1]):
            s = impulse[k]
            for a in range(6):
                out[a] += Wo[k, a] * s
            for j in range(work.dofs[i + 1] - d0):
                out[6 + d0 + j] += W[i, j, k - first] * s


@kernel
def end(own, t, h):
    """Momenta at the end, and the velocities on the joints that have them: ``z_new``."""
    _, data, work = open_system(own.system)
    n, z, new = data.angles.size, own.z, own.z_new
    momentum = own.scratch
    for k in range(6 + n):
        momentum[k] = own.start[k] + 2.0 * own.push[k]
    add_impulses(own.Wo, own.W, own.impulse, work, momentum)
    copy(momentum, own.push)  # `place` needs the scratch
    place(own, data, h, t + h)
    status = update_kinematics(own.system)
    own.own[OWN_EVALUATIONS] += 1
    if status != OK:
        return status
    for k in range(6):
        data.h_o[k] = own.push[k]
    for j in range(n):
        data.h[j] = own.push[6 + j]
    clear(data.c)
    status = solve_constrained(own.system)
    if status != OK:
        return status
    for k in range(6):
        new[k] = h * own.xi[k] + (z[k] if k < 3 else 0.0)
        new[6 + n + k] = data.q_o[k]
    for j in range(n):
        new[6 + j] = z[6 + j] + h * own.xi[6 + j]
        new[12 + n + j] = data.qdd[j]
    for k in range(data.power.size):
        new[12 + 2 * n + k] = z[12 + 2 * n + k] + h * data.power[k]
    return OK
