r"""The equations of motion of a compiled scene, evaluated in compiled code.

One evaluation is: compiled code or Pinocchio (one callback) updates the terms of all arms and the
motion of their last links, then come for every arm its contact rows and the elimination of the node
algorithm, then the object's 6 by 6 system and the accelerations.  Data flow, all in world axes:

.. code-block:: text

    positions, velocities -> arms      -> M, b, J, link motion --+
                          -> object     -> pose, inertia, bias --+-> contacts -> W_o, W, c, phi
                          -> control, effects -> h                              |
                                         accelerations, contact forces <- node <+

The arrays are those of :mod:`multiarm.dynamics.arrays`.  The three large parts (kinematics, forces,
solution) are entries: whoever needs them calls them by address, so that each is compiled once.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.arms.compiled.tables import energy_of_arms, open_arms
from multiarm.arms.terms import BIAS_AT, GRAVITY_AT, M_AT, M_STRIDE
from multiarm.contacts.kernel import (
    GAP,
    GAP_BIAS,
    GAP_RATE,
)
from multiarm.contacts.rows import write_row
from multiarm.control.torques import control_torques
from multiarm.dynamics.arrays import (
    ARMS_SIZE,
    ARMS_STRUCT,
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
    CALLS,
    COUPLED_COUNTS,
    FLAG,
    IMBALANCE,
    open_coupled,
    open_system,
)
from multiarm.dynamics.kinematics import (
    arm_rows,
    arm_terms,
    load_inertia,
    object_terms,
    write_joint_rows,
)
from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.factors import norm
from multiarm.dynamics.solver.regular import ELIMINATED, IMBALANCE_BOUND, eliminate_arms
from multiarm.dynamics.solver.singular import ARMS, couple, solve_coupled
from multiarm.jit.kernels import cfunc, inlined, kernel
from multiarm.jit.lazy import LazyFunction
from multiarm.jit.pointers import address_of, call_cfunc, call_python
from multiarm.jit.simd import broadcast, load_pack, store_pack
from multiarm.jit.structs import floats_at, ints1, struct_at

# Accelerations below this are no scale for what is left of an equation [m/s^2].
AT_REST = 1e-9

# Results of an evaluation; k >= 0 means that the elimination failed at arm k (or at the object).
OK, CALLBACK_FAILED, NOT_FINITE, CONTRADICTION = -1, -2, -4, -5


@cfunc
def _kinematics(address, size, _a, _b):
    """See :func:`update_kinematics`."""
    struct = struct_at(address, size)
    plant, buffers, work = open_system(struct)
    arm_terms(plant, buffers)
    if buffers.flag[0] != 0:
        return CALLBACK_FAILED
    object_terms(plant, buffers)
    work.factored[0] = 0
    for i in range(plant.pointers.shape[0]):
        arm_rows(i, struct, plant, buffers, work)
        load_inertia(i, plant, work)
    write_joint_rows(plant, buffers, work)
    # a surface of the user's may have failed
    return OK if buffers.flag[0] == 0 else CALLBACK_FAILED


@cfunc
def _right_hand_sides(address, size, alpha, beta):
    """Forces ``h`` from bias, control and effects, and ``c`` with feedback on the drift.

    ``c = -phi''|_0 - 2 alpha phi' - beta^2 phi`` (thesis, 4.3 and Example 4.2).  Returns ``OK`` or
    ``CALLBACK_FAILED``.
    """
    plant, buffers, work = open_system(struct_at(address, size))
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
    call_cfunc(effect[0], struct_at(address, size), float(effect[1]), buffers.time[0])


@inlined
def load_gravity_torque(plant, buffers, work):
    """Copy the joints' gravity forces; they are computed only when the control asks for them."""
    for i in range(plant.pointers.shape[0]):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        g = floats_at(plant.pointers[i, GRAVITY_AT], d)
        for j in range(d):
            buffers.gravity_torque[d0 + j] = g[j]


@cfunc
def _solve(address, size, _a, _b):
    """See :func:`solve_constrained`."""
    plant, buffers, work = open_system(struct_at(address, size))
    if plant.dense[0] != 0:
        ints1(struct_at(address, size), COUPLED_COUNTS)[ARMS] = 0
        call_python(plant.calls[CALL_DENSE])
        buffers.solved[IMBALANCE] = imbalance(buffers, work, buffers.Wo)
        return CALLBACK_FAILED if buffers.flag[0] != 0 else OK
    result = solve_batched(
        work, buffers.Wo, buffers.inertia, buffers.h_o, buffers.h, buffers.c, buffers.q_o,
        buffers.qdd, buffers.force,
    )  # fmt: skip
    if result == ELIMINATED:
        ints1(struct_at(address, size), COUPLED_COUNTS)[ARMS] = 0
        buffers.solved[IMBALANCE] = imbalance(buffers, work, buffers.Wo)
        if buffers.solved[IMBALANCE] <= IMBALANCE_BOUND:
            return OK
    return call_cfunc(plant.calls[CALL_COUPLED], struct_at(address, size), 0.0, 0.0)


@inlined
def imbalance(buffers, work, Wo):
    """What is left of ``M_o q_o = h_o + W_o force``, relative to the largest force in it.

    ``Wo`` (N, 6) are the rows along which the forces act.  Moments are compared with moments, or
    with that force at the object's radius of gyration.  Zero where it is clearly less than
    ``IMBALANCE_BOUND``; NaN where the solution is not finite.
    """
    inertia, h_o, q_o, m = buffers.inertia, buffers.h_o, buffers.q_o, buffers.inertia[0, 0]
    total = work.packs  # scratch: the solution has been handed out
    front, back = load_pack(h_o, 0), load_pack(h_o, 2)  # six numbers, two of them twice
    for a in range(buffers.force.size):
        force = broadcast(buffers.force[a])
        front = front + force * load_pack(Wo, 6 * a)
        back = back + force * load_pack(Wo, 6 * a + 2)
    store_pack(total, 0, front)
    store_pack(total, 2, back)
    x, y, z = q_o[3], q_o[4], q_o[5]
    forces = abs(total[0] - m * q_o[0]) + abs(total[1] - m * q_o[1]) + abs(total[2] - m * q_o[2])
    moments = (
        abs(total[3] - inertia[3, 3] * x - inertia[3, 4] * y - inertia[3, 5] * z)
        + abs(total[4] - inertia[4, 3] * x - inertia[4, 4] * y - inertia[4, 5] * z)
        + abs(total[5] - inertia[5, 3] * x - inertia[5, 4] * y - inertia[5, 5] * z)
    )
    largest = m * max(abs(q_o[0]), abs(q_o[1]), abs(q_o[2]))
    small = IMBALANCE_BOUND * max(largest, abs(h_o[0]), abs(h_o[1]), abs(h_o[2]))
    square = inertia[3, 3] + inertia[4, 4] + inertia[5, 5]  # m times that of the radius of gyration
    if forces <= small and m * moments * moments <= small * small * square:
        return 0.0
    return relative_imbalance(buffers, Wo, forces, moments)


@kernel
def relative_imbalance(buffers, Wo, forces, moments):
    """Sums of what is left of forces [N] and moments [N m] relative to the largest ones in play."""
    inertia = buffers.inertia
    radius = math.sqrt((inertia[3, 3] + inertia[4, 4] + inertia[5, 5]) / inertia[0, 0])
    push = max(AT_REST * inertia[0, 0], norm(buffers.h_o[:3], 3))
    turn = norm(buffers.h_o[3:6], 3)
    for a in range(buffers.force.size):
        force = abs(buffers.force[a])
        push = max(push, force * norm(Wo[a, :3], 3))
        turn = max(turn, force * norm(Wo[a, 3:6], 3))
    # NaN stays NaN
    return forces / push + moments / max(turn, push * radius)


@cfunc
def _solve_coupled(address, size, decompose_all, _b):
    """Solve a system with deficient arms, arm by arm; returns a status.

    Where that leaves too much of the object's equation, or when ``decompose_all`` is not zero, no
    arm is eliminated as a whole.
    """
    struct = struct_at(address, size)
    plant, buffers, work = open_system(struct)
    coupled = open_coupled(struct)
    status = solve_by_arms(plant, buffers, work, coupled, decompose_all != 0.0)
    if status != OK or buffers.solved[IMBALANCE] <= IMBALANCE_BOUND:
        return status
    if decompose_all != 0.0 or coupled.counts[ARMS] == plant.pointers.shape[0]:
        return status
    return solve_again(struct)


@kernel
def solve_again(struct):
    """Solve the equations at hand once more, no arm eliminated as a whole; returns a status."""
    plant, _, _ = open_system(struct)
    status = renew_kinematics(struct)
    if status != OK:
        return status
    return call_cfunc(plant.calls[CALL_COUPLED], struct, 1.0, 0.0)


@kernel
def renew_kinematics(struct):
    """Compute anew the kinematics that an elimination has used up; returns a status."""
    plant, buffers, _ = open_system(struct)
    h_o = buffers.h_o  # kinematics alone leave out the loads from outside
    s0, s1, s2, s3, s4, s5 = h_o[0], h_o[1], h_o[2], h_o[3], h_o[4], h_o[5]
    status = call_cfunc(plant.calls[CALL_KINEMATICS], struct, 0.0, 0.0)
    h_o[0], h_o[1], h_o[2], h_o[3], h_o[4], h_o[5] = s0, s1, s2, s3, s4, s5
    return status


@kernel
def solve_by_arms(plant, buffers, work, coupled, decompose_all):
    """Eliminate and couple all arms at the kinematics in the buffers; returns a status."""
    failed = eliminate_arms(work, buffers.Wo)
    if failed != ELIMINATED:
        return failed
    pivot = couple(work, coupled, buffers.Wo, buffers.inertia, decompose_all)
    work.pivot[plant.pointers.shape[0]] = pivot
    if not pivot > 0.0:
        return plant.pointers.shape[0] if pivot == pivot else NOT_FINITE
    solve_coupled(
        work, coupled, buffers.h_o, buffers.h, buffers.c, buffers.q_o, buffers.qdd, buffers.force
    )
    buffers.solved[IMBALANCE] = imbalance(buffers, work, buffers.Wo)
    return OK


@cfunc
def _other_row(address, size, row, arm):
    """Write a row of an arm that is not a tip on a plane, a sphere or a cylinder."""
    plant, buffers, _ = open_system(struct_at(address, size))
    write_row(
        int(row), buffers.arms[int(arm)], buffers.body, plant.codes, plant.geometry, plant.shapes,
        plant.calls[CALL_SURFACE], buffers.contacts, buffers.parts, buffers.query, buffers.places,
        buffers.located,
    )  # fmt: skip
    return OK


def connect_functions(calls: np.ndarray) -> dict[str, LazyFunction]:
    """Write the addresses of the compiled parts of an evaluation into ``Plant.calls``.

    Returns those that are compiled when they are called: what regular scenes of idealised joints
    do without.
    """
    calls[CALL_KINEMATICS] = address_of(_kinematics)
    calls[CALL_FORCES] = address_of(_right_hand_sides)
    calls[CALL_SOLVE] = calls[CALL_CLOSE] = address_of(_solve)
    coupled = LazyFunction(_solve_coupled, CALLS, CALL_COUPLED, FLAG, CALLBACK_FAILED)
    row = LazyFunction(_other_row, CALLS, CALL_ROW, FLAG, CALLBACK_FAILED)
    calls[CALL_COUPLED], calls[CALL_ROW] = coupled.address, row.address
    return {"coupled": coupled, "row": row}


@kernel
def update_kinematics(struct):
    """The arms' terms, the object's, and all contact rows at the state in the buffers.

    Leaves W in ``work.Y`` and the inertias in ``work.L``, ready for the elimination.  Returns
    ``OK`` or ``CALLBACK_FAILED``.
    """
    return call_cfunc(ints1(struct, CALLS)[CALL_KINEMATICS], struct, 0.0, 0.0)


@kernel
def update_rows(struct):
    """Contact rows alone, of a system that shares its bodies' motion with one that has it."""
    plant, buffers, work = open_system(struct)
    for i in range(plant.pointers.shape[0]):
        arm_rows(i, struct, plant, buffers, work)
    write_joint_rows(plant, buffers, work)


@kernel
def solve_constrained(struct):
    """Solve for ``q_o, qdd, force`` with the right-hand sides ``h_o, h, c`` in ``buffers``.

    Contacts push along their normals here, as impulses that close gaps do; friction has its part in
    evaluations only.  Needs :func:`update_kinematics` before.  Returns ``OK``, ``CALLBACK_FAILED``,
    or the number of the arm (or of the object, behind the arms) whose inertia is not positive
    definite.
    """
    return call_cfunc(ints1(struct, CALLS)[CALL_CLOSE], struct, 0.0, 0.0)


@kernel
def evaluate_buffers(struct, alpha, beta):
    """Evaluate the state in the buffers; returns ``OK`` or what went wrong.

    Reads ``time, position, angles, twist, v``; writes everything else.  ``alpha`` [1/s] and
    ``beta`` [1/s] are the gains of the drift feedback (0: none).
    """
    calls = ints1(struct, CALLS)
    status = call_cfunc(calls[CALL_KINEMATICS], struct, 0.0, 0.0)
    if status != OK:
        return status
    status = call_cfunc(calls[CALL_FORCES], struct, alpha, beta)
    if status != OK:
        return status
    return call_cfunc(calls[CALL_SOLVE], struct, 0.0, 0.0)


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
        energy += energy_of_arms(open_arms(struct_at(calls[ARMS_STRUCT], calls[ARMS_SIZE])))
    if calls[CALL_POTENTIAL] != 0:
        call_python(calls[CALL_POTENTIAL])
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
