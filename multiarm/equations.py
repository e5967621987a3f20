r"""The equations of motion of a compiled scene, evaluated in compiled code.

One evaluation is: compiled code or Pinocchio (one callback) updates the terms of all arms and the
motion of their last links, then come for every arm its contact rows and the elimination of the node
algorithm, then the object's 6 by 6 system and the accelerations.  Data flow, all in world axes:

.. code-block:: text

    positions, velocities -> arms      -> M, b, J, link motion --+
                          -> object     -> pose, inertia, bias --+-> contacts -> W_o, W, c, phi
                          -> control, effects -> h                              |
                                         accelerations, contact forces <- node <+

The arrays are those of :mod:`multiarm.plant`.  The three large parts (kinematics, forces, solution)
are entries: whoever needs them calls them by address, so that each is compiled once.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.books import book_at, floats_at, ints1
from multiarm.compiled_arms.arrays import energy_of_arms, open_arms
from multiarm.contacts.kernel import (
    ACCELERATION,
    AT,
    COUPLE,
    GAP,
    GAP_BIAS,
    GAP_RATE,
    NORMAL,
    ORIGIN_AT,
    SPIN,
    SPIN_RATE,
    VELOCITY,
)
from multiarm.contacts.records import COMBINED, KIND, RADIUS, SIDE, WEIGHT
from multiarm.contacts.rows import write_row, write_rows
from multiarm.control import control_torques
from multiarm.lanes import LANES, lanes_at, lanes_of, put_lanes
from multiarm.late_entries import LateEntry
from multiarm.lowlevel import address_of, call_back, call_entry, entry, inlined, kernel
from multiarm.node.regular import ELIMINATED, eliminate_arms
from multiarm.node.side_by_side import solve_side_by_side
from multiarm.node.singular import ARMS, couple, solve_coupled
from multiarm.plant import (
    ARMS_BOOK,
    ARMS_SIZE,
    CALL_ARMS,
    CALL_CLOSE,
    CALL_COUPLED,
    CALL_DENSE,
    CALL_FORCES,
    CALL_KINEMATICS,
    CALL_POTENTIAL,
    CALL_ROW,
    CALL_SOLVE,
    CALL_SURFACE,
    CALL_TERMS,
    CALLS,
    COUPLED_COUNTS,
    open_book,
    open_coupled,
)
from multiarm.spatial import write_matrix
from multiarm.terms import BIAS_AT, DRIFT_AT, GRAVITY_AT, J_AT, M_AT, M_STRIDE, POSE_AT, TWIST_AT

# Results of an evaluation; k >= 0 means that the elimination failed at arm k (or at the object).
OK, CALLBACK_FAILED, NOT_FINITE, CONTRADICTION = -1, -2, -4, -5


@inlined
def fill_configuration(plant, buffers):
    """Write Pinocchio's configuration from the positions of its arms' joints."""
    for j in range(buffers.angles.size):
        slot = plant.q_slots[j]
        if slot < 0:
            continue
        if plant.circular[j] != 0:
            buffers.q[slot] = np.cos(buffers.angles[j])
            buffers.q[slot + 1] = np.sin(buffers.angles[j])
        else:
            buffers.q[slot] = buffers.angles[j]


@inlined
def arm_terms(plant, buffers):
    """All terms of the arms, and the motion of the links that carry their tips."""
    calls = plant.calls
    if calls[CALL_ARMS] != 0:
        call_entry(calls[CALL_ARMS], book_at(calls[ARMS_BOOK], calls[ARMS_SIZE]), 0.0, 0.0)
    if calls[CALL_TERMS] != 0:
        fill_configuration(plant, buffers)
        call_back(calls[CALL_TERMS])
    for i in range(plant.pointers.shape[0]):
        if plant.pointers[i, TWIST_AT] != 0:
            link_motion(plant.pointers[i], plant.gravity, buffers.arms[i])


@inlined
def object_terms(plant, buffers):
    """Pose, motion, inertia ``blkdiag(m I, R I R^T)`` and bias of the object (thesis, 3.2)."""
    body, inertia, h_o = buffers.body, buffers.inertia, buffers.h_o
    write_matrix(buffers.position[3:7], body)
    for k in range(3):
        body[ORIGIN_AT + k] = buffers.position[k]
        body[VELOCITY + k] = buffers.twist[k]
        body[SPIN + k] = buffers.twist[3 + k]
    I = plant.object_inertia  # noqa: E741
    for a in range(3):
        t0 = body[3 * a] * I[0, 0] + body[3 * a + 1] * I[1, 0] + body[3 * a + 2] * I[2, 0]
        t1 = body[3 * a] * I[0, 1] + body[3 * a + 1] * I[1, 1] + body[3 * a + 2] * I[2, 1]
        t2 = body[3 * a] * I[0, 2] + body[3 * a + 1] * I[1, 2] + body[3 * a + 2] * I[2, 2]
        inertia[a, a] = plant.object_mass[0]
        for b in range(3):
            inertia[3 + a, 3 + b] = t0 * body[3 * b] + t1 * body[3 * b + 1] + t2 * body[3 * b + 2]
    w0, w1, w2 = body[SPIN], body[SPIN + 1], body[SPIN + 2]
    l0 = inertia[3, 3] * w0 + inertia[3, 4] * w1 + inertia[3, 5] * w2
    l1 = inertia[4, 3] * w0 + inertia[4, 4] * w1 + inertia[4, 5] * w2
    l2 = inertia[5, 3] * w0 + inertia[5, 4] * w1 + inertia[5, 5] * w2
    for k in range(3):
        h_o[k] = plant.object_mass[0] * plant.gravity[k]
    h_o[3] = w2 * l1 - w1 * l2
    h_o[4] = w0 * l2 - w2 * l0
    h_o[5] = w1 * l0 - w0 * l1


@inlined
def link_motion(pointers, gravity, row):
    """Motion of the link that carries an arm's tip, in world axes, from Pinocchio's own arrays.

    Pinocchio gives twist and spatial acceleration in link axes, the latter with gravity taken off;
    the classical acceleration of the origin is ``a + omega x v``.
    """
    pose = floats_at(pointers[POSE_AT], 12)
    v = floats_at(pointers[TWIST_AT], 6)
    a = floats_at(pointers[DRIFT_AT], 6)
    l0 = a[0] + v[4] * v[2] - v[5] * v[1]
    l1 = a[1] + v[5] * v[0] - v[3] * v[2]
    l2 = a[2] + v[3] * v[1] - v[4] * v[0]
    for k in range(3):
        r0, r1, r2 = pose[k], pose[3 + k], pose[6 + k]  # stored by columns
        row[3 * k], row[3 * k + 1], row[3 * k + 2] = r0, r1, r2
        row[ORIGIN_AT + k] = pose[9 + k]
        row[VELOCITY + k] = r0 * v[0] + r1 * v[1] + r2 * v[2]
        row[SPIN + k] = r0 * v[3] + r1 * v[4] + r2 * v[5]
        row[ACCELERATION + k] = r0 * l0 + r1 * l1 + r2 * l2 + gravity[k]
        row[SPIN_RATE + k] = r0 * a[3] + r1 * a[4] + r2 * a[5]


@inlined
def arm_rows(i, book, plant, buffers, work):
    """Contact kinematics of arm ``i``, its rows of ``W_o`` and its ``W`` (into ``work.Y``).

    ``plant, buffers, work`` are the views of ``book``.
    """
    d = work.dofs[i + 1] - work.dofs[i]
    first = work.rows[i]
    m = work.rows[i + 1] - first
    J = floats_at(plant.pointers[i, J_AT], 6 * d)  # column by column
    x0, x1, x2 = buffers.body[ORIGIN_AT], buffers.body[ORIGIN_AT + 1], buffers.body[ORIGIN_AT + 2]
    Y, wrench = work.Y[i], buffers.wrench
    write_rows(
        first, m, buffers.arms[i], buffers.body, buffers.relative, plant.codes, plant.geometry,
        buffers.contacts, book, i, plant.calls[CALL_ROW],
    )  # fmt: skip
    for k in range(m):
        row = buffers.contacts[first + k]
        e0, e1, e2 = row[NORMAL], row[NORMAL + 1], row[NORMAL + 2]
        p0, p1, p2 = row[AT], row[AT + 1], row[AT + 2]
        Wo = buffers.Wo[first + k]
        Wo[0], Wo[1], Wo[2] = e0, e1, e2
        Wo[3] = (p1 - x1) * e2 - (p2 - x2) * e1
        Wo[4] = (p2 - x2) * e0 - (p0 - x0) * e2
        Wo[5] = (p0 - x0) * e1 - (p1 - x1) * e0
        # the arm takes the opposite wrench; its Jacobian is about the world's origin
        wrench[0, k], wrench[1, k], wrench[2, k] = -e0, -e1, -e2
        wrench[3, k] = p2 * e1 - p1 * e2
        wrench[4, k] = p0 * e2 - p2 * e0
        wrench[5, k] = p1 * e0 - p0 * e1
        if plant.codes[first + k, KIND] == COMBINED:
            for j in range(3):
                Wo[3 + j] += row[COUPLE + j]
                wrench[3 + j, k] -= row[COUPLE + j]
    if m < LANES:
        for j in range(d):
            j0, j1, j2 = J[6 * j], J[6 * j + 1], J[6 * j + 2]
            j3, j4, j5 = J[6 * j + 3], J[6 * j + 4], J[6 * j + 5]
            for k in range(m):
                a = j0 * wrench[0, k] + j1 * wrench[1, k] + j2 * wrench[2, k]
                b = j3 * wrench[3, k] + j4 * wrench[4, k] + j5 * wrench[5, k]
                Y[j, k] = a + b
        return
    k = 0
    while k < m:
        k = min(k, m - LANES)  # the last four may be among those before
        write_columns(i, k, d, J, wrench, work)
        k += LANES


@inlined
def write_columns(i, k, d, J, wrench, work):
    """Four columns of ``W``, contacts ``k`` to ``k + 3``, side by side."""
    N, Y = wrench.shape[1], work.Y
    w0, w1, w2 = lanes_at(wrench, k), lanes_at(wrench, N + k), lanes_at(wrench, 2 * N + k)
    w3, w4, w5 = (
        lanes_at(wrench, 3 * N + k),
        lanes_at(wrench, 4 * N + k),
        lanes_at(wrench, 5 * N + k),
    )
    at = i * Y.shape[1] * Y.shape[2] + k
    for j in range(d):
        a = lanes_of(J[6 * j]) * w0 + lanes_of(J[6 * j + 1]) * w1 + lanes_of(J[6 * j + 2]) * w2
        b = lanes_of(J[6 * j + 3]) * w3 + lanes_of(J[6 * j + 4]) * w4 + lanes_of(J[6 * j + 5]) * w5
        put_lanes(Y, at, a + b)
        at += Y.shape[2]


@inlined
def write_joint_rows(plant, buffers, work):
    """Rows that belong to joints: their gaps, and their columns of ``W``."""
    for k in range(plant.joint_rows.shape[0]):
        i, row, joint = plant.joint_rows[k, 0], plant.joint_rows[k, 1], plant.joint_rows[k, 2]
        side, geometry = plant.geometry[row, SIDE], plant.geometry[row]
        buffers.contacts[row, GAP] = (
            geometry[WEIGHT] * side * (buffers.angles[joint] - geometry[RADIUS])
        )
        buffers.contacts[row, GAP_RATE] = side * buffers.v[joint]
        work.Y[i, joint - work.dofs[i], row - work.rows[i]] = side


@inlined
def load_inertia(i, plant, work):
    """Copy the arm's inertia (lower triangle of the C-ordered view) into ``work.L``."""
    d = work.dofs[i + 1] - work.dofs[i]
    stride = plant.pointers[i, M_STRIDE]
    M = floats_at(plant.pointers[i, M_AT], d * stride)
    L = work.L[i]
    for a in range(d):
        for b in range(a + 1):
            L[a, b] = M[a * stride + b]


@entry
def _kinematics(address, size, _a, _b):
    """See :func:`update_kinematics`."""
    book = book_at(address, size)
    plant, buffers, work = open_book(book)
    arm_terms(plant, buffers)
    if buffers.flag[0] != 0:
        return CALLBACK_FAILED
    object_terms(plant, buffers)
    work.factored[0] = 0
    for i in range(plant.pointers.shape[0]):
        arm_rows(i, book, plant, buffers, work)
        load_inertia(i, plant, work)
    write_joint_rows(plant, buffers, work)
    # a surface of the user's may have failed
    return OK if buffers.flag[0] == 0 else CALLBACK_FAILED


@entry
def _right_hand_sides(address, size, alpha, beta):
    """Forces ``h`` from bias, control and effects, and ``c`` with feedback on the drift.

    ``c = -phi''|_0 - 2 alpha phi' - beta^2 phi`` (thesis, 4.3 and Example 4.2).  Returns ``OK`` or
    ``CALLBACK_FAILED``.
    """
    plant, buffers, work = open_book(book_at(address, size))
    passive_forces(address, size, plant, buffers, work)
    power = 0.0
    if plant.control.shape[0] > 0:
        load_gravity_torque(plant, buffers, work)
        control_torques(address, size, buffers.time[0], plant, buffers)
        power = add_torques(address, size, plant, buffers)
    applied_forces(address, size, plant, buffers, power)
    drift_terms(buffers, alpha, beta)
    return OK if buffers.flag[0] == 0 else CALLBACK_FAILED


@inlined
def passive_forces(address, size, plant, buffers, work):
    """``h = -b``, and what the joints do by themselves."""
    for i in range(plant.pointers.shape[0]):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        bias = floats_at(plant.pointers[i, BIAS_AT], d)
        for j in range(d):
            buffers.h[d0 + j] = -bias[j]
    for k in range(plant.phases[0]):
        call_effect(plant.effects[k], address, size, buffers)


@inlined
def add_torques(address, size, plant, buffers):
    """Add the control's torques, as the actuators pass them on; returns their power [W]."""
    for k in range(plant.phases[0], plant.phases[1]):
        call_effect(plant.effects[k], address, size, buffers)
    power = 0.0
    for j in range(buffers.h.size):
        buffers.h[j] += buffers.torque[j]
        power += buffers.torque[j] * buffers.v[j]
    return power


@inlined
def applied_forces(address, size, plant, buffers, power):
    """Add what comes from outside, and write the power of all: the control's is ``power`` [W]."""
    for k in range(plant.phases[1], plant.phases[2]):
        call_effect(plant.effects[k], address, size, buffers)
    last = buffers.power.size - 1
    for k in range(last):
        power += buffers.power[k]
    buffers.power[last] = power


@inlined
def drift_terms(buffers, alpha, beta):
    """``c``, with feedback on the drift."""
    for k in range(buffers.c.size):
        row = buffers.contacts[k]
        buffers.c[k] = -(row[GAP_BIAS] + 2.0 * alpha * row[GAP_RATE] + beta * beta * row[GAP])


@inlined
def call_effect(effect, address, size, buffers):
    """Let one effect add its part; ``effect`` is its row of ``Plant.effects``."""
    call_entry(effect[0], book_at(address, size), float(effect[1]), buffers.time[0])


@inlined
def load_gravity_torque(plant, buffers, work):
    """Copy the joints' gravity forces; they are computed only when the control asks for them."""
    for i in range(plant.pointers.shape[0]):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        g = floats_at(plant.pointers[i, GRAVITY_AT], d)
        for j in range(d):
            buffers.gravity_torque[d0 + j] = g[j]


@entry
def _solve(address, size, _a, _b):
    """See :func:`solve_constrained`."""
    plant, buffers, work = open_book(book_at(address, size))
    if plant.dense[0] != 0:
        ints1(book_at(address, size), COUPLED_COUNTS)[ARMS] = 0
        call_back(plant.calls[CALL_DENSE])
        return CALLBACK_FAILED if buffers.flag[0] != 0 else OK
    result = solve_side_by_side(
        work, buffers.Wo, buffers.inertia, buffers.h_o, buffers.h, buffers.c, buffers.q_o,
        buffers.qdd, buffers.force,
    )  # fmt: skip
    if result != ELIMINATED:
        return call_entry(plant.calls[CALL_COUPLED], book_at(address, size), 0.0, 0.0)
    ints1(book_at(address, size), COUPLED_COUNTS)[ARMS] = 0
    return OK


@entry
def _solve_coupled(address, size, _a, _b):
    """Solve a system with deficient arms, arm by arm; returns a status."""
    book = book_at(address, size)
    plant, buffers, work = open_book(book)
    coupled = open_coupled(book)
    failed = eliminate_arms(work, buffers.Wo)
    if failed != ELIMINATED:
        return failed
    pivot = couple(work, coupled, buffers.Wo, buffers.inertia)
    work.pivot[plant.pointers.shape[0]] = pivot
    if not pivot > 0.0:
        return plant.pointers.shape[0] if pivot == pivot else NOT_FINITE
    solve_coupled(
        work, coupled, buffers.h_o, buffers.h, buffers.c, buffers.q_o, buffers.qdd, buffers.force
    )
    return OK


@entry
def _other_row(address, size, row, arm):
    """Write a row of an arm that is not a tip on a plane, a sphere or a cylinder."""
    plant, buffers, _ = open_book(book_at(address, size))
    write_row(
        int(row), buffers.arms[int(arm)], buffers.body, plant.codes, plant.geometry, plant.shapes,
        plant.calls[CALL_SURFACE], buffers.contacts, buffers.parts, buffers.query, buffers.places,
        buffers.located,
    )  # fmt: skip
    return OK


def connect_entries(calls: np.ndarray) -> dict[str, LateEntry]:
    """Write the addresses of the compiled parts of an evaluation into ``Plant.calls``.

    Returns those that are compiled when they are called: what regular scenes of idealised joints
    do without.
    """
    calls[CALL_KINEMATICS] = address_of(_kinematics)
    calls[CALL_FORCES] = address_of(_right_hand_sides)
    calls[CALL_SOLVE] = calls[CALL_CLOSE] = address_of(_solve)
    coupled = LateEntry(_solve_coupled, CALL_COUPLED, CALLBACK_FAILED)
    row = LateEntry(_other_row, CALL_ROW, CALLBACK_FAILED)
    calls[CALL_COUPLED], calls[CALL_ROW] = coupled.address, row.address
    return {"coupled": coupled, "row": row}


@kernel
def update_kinematics(book):
    """The arms' terms, the object's, and all contact rows at the state in the buffers.

    Leaves W in ``work.Y`` and the inertias in ``work.L``, ready for the elimination.  Returns
    ``OK`` or ``CALLBACK_FAILED``.
    """
    return call_entry(ints1(book, CALLS)[CALL_KINEMATICS], book, 0.0, 0.0)


@kernel
def update_rows(book):
    """Contact rows alone, of a system that shares its bodies' motion with one that has it."""
    plant, buffers, work = open_book(book)
    for i in range(plant.pointers.shape[0]):
        arm_rows(i, book, plant, buffers, work)
    write_joint_rows(plant, buffers, work)


@kernel
def solve_constrained(book):
    """Solve for ``q_o, qdd, force`` with the right-hand sides ``h_o, h, c`` in ``buffers``.

    Contacts push along their normals here, as impulses that close gaps do; friction has its part in
    evaluations only.  Needs :func:`update_kinematics` before.  Returns ``OK``, ``CALLBACK_FAILED``,
    or the number of the arm (or of the object, behind the arms) whose inertia is not positive
    definite.
    """
    return call_entry(ints1(book, CALLS)[CALL_CLOSE], book, 0.0, 0.0)


@kernel
def evaluate_buffers(book, alpha, beta):
    """Evaluate the state in the buffers; returns ``OK`` or what went wrong.

    Reads ``time, position, angles, twist, v``; writes everything else.  ``alpha`` [1/s] and
    ``beta`` [1/s] are the gains of the drift feedback (0: none).
    """
    calls = ints1(book, CALLS)
    status = call_entry(calls[CALL_KINEMATICS], book, 0.0, 0.0)
    if status != OK:
        return status
    status = call_entry(calls[CALL_FORCES], book, alpha, beta)
    if status != OK:
        return status
    return call_entry(calls[CALL_SOLVE], book, 0.0, 0.0)


@kernel
def kinetic_energy(plant, buffers, work):
    """Kinetic energy of arms and object [J] at the state evaluated last."""
    energy = 0.0
    for i in range(plant.pointers.shape[0]):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        stride = plant.pointers[i, M_STRIDE]
        M = floats_at(plant.pointers[i, M_AT], d * stride)
        for a in range(d):
            va = buffers.v[d0 + a]
            energy += 0.5 * M[a * stride + a] * va * va
            for b in range(a):
                energy += M[a * stride + b] * va * buffers.v[d0 + b]
    twist = buffers.twist
    for a in range(6):
        for b in range(6):
            energy += 0.5 * twist[a] * buffers.inertia[a, b] * twist[b]
    return energy


@kernel
def potential_energy(plant, buffers):
    """Potential energy of arms and object [J] at the state evaluated last, zero at the origin."""
    calls, energy = plant.calls, 0.0
    for k in range(3):
        energy -= plant.object_mass[0] * plant.gravity[k] * buffers.position[k]
    if calls[CALL_ARMS] != 0:
        energy += energy_of_arms(open_arms(book_at(calls[ARMS_BOOK], calls[ARMS_SIZE])))
    if calls[CALL_POTENTIAL] != 0:
        call_back(calls[CALL_POTENTIAL])
        energy += buffers.energy[0]
    return energy


@kernel
def largest(contacts, column):
    """Largest magnitude in one column of the contact kinematics (NaN stays NaN)."""
    worst = 0.0
    for k in range(contacts.shape[0]):
        size = abs(contacts[k, column])
        if size != size:
            return size
        worst = max(worst, size)
    return worst


@kernel
def finite(vector):
    """Whether all entries are finite."""
    for i in range(vector.size):  # noqa: SIM110  compiled code has no generators
        if not math.isfinite(vector[i]):
            return False
    return True
