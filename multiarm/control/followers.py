r"""The accelerations with which objects follow that are not commanded, beside others that are.

With the accelerations :math:`a_c` of the objects that are commanded, those of the others,
:math:`a_u`, obey

.. math::
    W_k^T a = c_k \ \text{(joints without a robot)}, \qquad
    Z^T (I a - f_o) = 0, \quad Z^T W_o = 0 .

The second equation says that no contact puts a wrench on the objects along Z: a plate on a hinge
swings as gravity and its inertia want.  Of all accelerations with these properties, the objects
have the nearest to :math:`-\delta v_u` in the metric of their inertia, as the free motions of
robots have (:mod:`multiarm.control.null_space`): what hands could move, but nobody commands, dies
out at the rate :math:`\delta`.

``Z`` is all of :math:`1 - A A^+` with :math:`A = W_o W_o^T`, whose rows depend on each other.
"""

from __future__ import annotations

import numpy as np

from multiarm.contacts.kernel import open_contact
from multiarm.control.null_space import nearest_accelerations
from multiarm.dynamics.forces.compiled import write_wrench_products
from multiarm.dynamics.solver.factors import solve_semidefinite
from multiarm.jit.kernels import allocating, clear, inlined

# Entries of the projector ``1 - A A^+`` that count as roundings.
UNCARRIED = 1e-8


@inlined
def is_commanded(objects, o):
    """Whether an object is among those that are commanded."""
    commanded = False
    for p in range(objects.size):
        commanded = commanded or objects[p] == o
    return commanded


@allocating
def write_followers(law, model, data, work, acceleration):
    """Write the accelerations of the objects that are not commanded into ``acceleration`` (6 F,).

    Those of the others stand there.
    """
    node, f_o, inertia = acceleration.size, data.forces.f_o, data.bodies.object_inertia
    places, u = np.empty(node, dtype=np.int64), 0
    for o in range(node // 6):
        if is_commanded(law.objects, o):
            continue
        for k in range(6):
            places[u] = 6 * o + k
            acceleration[6 * o + k] = 0.0
            u += 1
    passive = 0
    for i in range(work.first_joint.size - 1):
        if work.first_joint[i] == work.first_joint[i + 1]:
            passive += work.first_contact[i + 1] - work.first_contact[i]
    W, target = np.zeros((u, passive + node)), np.zeros(passive + node)
    m = 0
    for i in range(work.first_joint.size - 1):
        if work.first_joint[i] < work.first_joint[i + 1]:
            continue
        for k in range(work.first_contact[i], work.first_contact[i + 1]):
            row = data.rows.W_o[k]
            target[m] = -open_contact(data.rows.kinematics[k]).gap_bias
            for l in range(node):
                target[m] -= row[l] * acceleration[l]
            for l in range(u):
                W[l, m] = row[places[l]]
            m += 1
    Z = np.empty((node, node))
    write_uncarried(data.rows.W_o, Z)
    for r in range(node):
        for l in range(node):
            target[m] += Z[r, l] * f_o[l]
            for k in range(node):
                target[m] -= Z[r, l] * inertia[l, k] * acceleration[k]
            for k in range(u):
                W[k, m] += Z[r, l] * inertia[l, places[k]]
        m += 1
    M, preferred, result, multipliers = np.empty((u, u)), np.empty(u), np.empty(u), np.empty(m)
    for k in range(u):
        o = places[k] // 6
        preferred[k] = -law.free_rate * data.state.twists[o, places[k] - 6 * o]
        for l in range(u):
            M[k, l] = inertia[places[k], places[l]]
    nearest_accelerations(M, W, preferred, target, result, multipliers)
    for k in range(u):
        acceleration[places[k]] = result[k]


@allocating
def write_uncarried(W_o, Z):
    """Write the part of a wrench that no contacts carry, ``1 - A A^+``, in scaled rows (6 F, 6 F).

    Row by row with moments over the longest lever arm; those of wrenches that are carried are zero.
    """
    size = Z.shape[0]
    products, scale = np.empty((size, size)), np.empty(size)
    b, x, left = np.empty(size), np.empty(size), np.empty(size)
    write_wrench_products(W_o, products, scale)
    A = np.empty((size, size))
    for r in range(size):
        clear(b)
        b[r] = 1.0
        for i in range(size):
            for j in range(size):
                A[i, j] = products[i, j]
        solve_semidefinite(A, b, x)
        for i in range(size):
            left[i] = b[i]
            for j in range(size):
                left[i] -= products[i, j] * x[j]
        for i in range(size):
            # zero but for roundings
            Z[r, i] = left[i] * scale[i] if abs(left[i]) > UNCARRIED else 0.0
