r"""From joint positions and the object's pose to motions, inertias and the rows of W.

The terms of all arms come first, and with them the motion of the links that carry their tips; then
the object's; then every arm's contacts.  What is written is in :mod:`multiarm.plant`; all of it is
in world axes.
"""

from __future__ import annotations

import numpy as np

from multiarm.books import book_at, floats_at
from multiarm.contacts.kernel import (
    ACCELERATION,
    AT,
    COUPLE,
    GAP,
    GAP_RATE,
    NORMAL,
    ORIGIN_AT,
    SPIN,
    SPIN_RATE,
    VELOCITY,
)
from multiarm.contacts.records import COMBINED, KIND, RADIUS, SIDE, WEIGHT
from multiarm.contacts.rows import write_rows
from multiarm.lanes import LANES, lanes_at, lanes_of, put_lanes
from multiarm.lowlevel import call_back, call_entry, inlined
from multiarm.plant import ARMS_BOOK, ARMS_SIZE, CALL_ARMS, CALL_ROW, CALL_TERMS
from multiarm.spatial import write_matrix
from multiarm.terms import DRIFT_AT, J_AT, M_AT, M_STRIDE, POSE_AT, TWIST_AT


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
