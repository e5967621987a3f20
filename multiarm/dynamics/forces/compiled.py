r"""Distribution of wrenches over the contacts: forces of least norm, and internal forces.

The contact forces that put desired wrenches ``w`` on the objects are (thesis, 3.4)

.. math:: \lambda = W_o^+ w + (1 - W_o^+ W_o)\,\lambda_s

the forces of least norm, plus the internal part of desired forces :math:`\lambda_s`, which does not
move the objects.  Both come from one solution, :math:`\lambda = \lambda_s + W_o^+ (w - W_o
\lambda_s)`.
"""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.solver.factors import factor_lu, norm, solve_lu, solve_semidefinite
from multiarm.jit.kernels import allocating, clear, copy, inlined, kernel

# Contacts that carry wrenches in some direction by so much less than in others leave the forces of
# least norm to rounding, and to differences their derivatives.
CARRIED = 1e-10
# Shorter lever arms are rounding errors, which must not be scaled up to a direction [m].
SHORTEST_LEVER = 1e-6


@kernel
def write_wrench_products(W_o, A, scale):
    """Write ``W_o W_o^T`` into ``A``, its rows and columns times ``scale``, written.

    ``W_o`` (N, 6 K) has six columns a body.  Moments are divided by the longest lever arm, so that
    all rows are forces.
    """
    longest, size = SHORTEST_LEVER, W_o.shape[1]
    for k in range(W_o.shape[0]):
        for turn in range(3, size, 6):
            longest = max(longest, norm(W_o[k, turn : turn + 3], 3))
    for i in range(size):
        scale[i] = 1.0 if i % 6 < 3 else 1.0 / longest
    for i in range(size):
        for j in range(size):
            A[i, j] = 0.0
            for k in range(W_o.shape[0]):
                A[i, j] += W_o[k, i] * W_o[k, j]
            A[i, j] *= scale[i] * scale[j]


@kernel
def factor_wrench_products(W_o, A, scale, pivots):
    """Write the factors of :func:`write_wrench_products`; returns whether any wrench is carried."""
    write_wrench_products(W_o, A, scale)
    return factor_lu(A, scale.size, pivots) > CARRIED


@inlined
def solve_wrench_products(A, scale, pivots, x):
    """Solve ``W_o W_o^T x = b`` with these factors; ``x`` is ``b`` on entry."""
    for i in range(x.size):
        x[i] *= scale[i]
    solve_lu(A, x.size, pivots, x)
    for i in range(x.size):
        x[i] *= scale[i]


@allocating
def static_forces(W_o, weight, force):
    r"""Write the contact forces of least norm with :math:`W_o \lambda = w` into ``force`` (N,).

    ``W_o`` (N, 6 K) has one row a contact, ``weight`` (6 K,) a wrench on each body.  The solution
    is exact when the contacts can carry the wrenches, else that of least squares, with moments over
    the longest lever arm.
    """
    y = np.empty(weight.size)
    write_multipliers(W_o, weight, y)
    for k in range(W_o.shape[0]):
        force[k] = 0.0
        for i in range(y.size):
            force[k] += W_o[k, i] * y[i]


@allocating
def write_multipliers(W_o, wrench, y):
    """Write the multipliers ``y`` of these forces :math:`W_o^T y` for wrenches (6 K,)."""
    size = wrench.size
    A, b, scale = np.empty((size, size)), np.empty(size), np.empty(size)
    write_wrench_products(W_o, A, scale)
    for i in range(size):
        b[i] = scale[i] * wrench[i]
    solve_semidefinite(A, b, y)
    for i in range(size):
        y[i] *= scale[i]


@kernel
def pressing_wrench(rotation, on_object, world):
    """Write a connection's wrench on the object in world axes; returns whether there is any."""
    presses = False
    for a in range(6):
        world[a], presses = 0.0, presses or on_object[a] != 0.0
    for a in range(3):
        for b in range(3):
            world[a] += rotation[3 * a + b] * on_object[b]
            world[3 + a] += rotation[3 * a + b] * on_object[3 + b]
    return presses


@allocating
def distribute_wrench(wrench, W_o, rows, rotations, pressed, of_contacts, of_connections, force):
    r"""Write the contact forces that put ``wrench`` on the objects, with internal forces.

    Parameters
    ----------
    wrench : (6 K,)
        On each object about its centre of mass, world axes [N, N m].
    W_o : (N, 6 K), rows : int (C + 1,)
        Rows of all contacts in world axes, and where each connection's begin.
    rotations : (K, 9)
        Of the objects, row by row.
    pressed : int (C,)
        The object that each connection presses.
    of_contacts : (N,), of_connections : (C, 6)
        Desired forces of the contacts, and a desired wrench of every connection on its object
        (about its centre of mass, its axes).  Only their internal part remains.
    force : (N,), written
    """
    desired, remaining = np.empty(of_contacts.size), np.empty(wrench.size)
    world = np.zeros(wrench.size)
    copy(of_contacts, desired)
    for c in range(of_connections.shape[0]):
        at = 6 * pressed[c]
        if pressing_wrench(rotations[pressed[c]], of_connections[c], world[at : at + 6]):
            r0, r1 = rows[c], rows[c + 1]
            static_forces(W_o[r0:r1], world, force[r0:r1])
            for k in range(r0, r1):
                desired[k] += force[k]
        clear(world)
    copy(wrench, remaining)
    for k in range(desired.size):
        for i in range(remaining.size):
            remaining[i] -= W_o[k, i] * desired[k]
    static_forces(W_o, remaining, force)
    for k in range(desired.size):
        force[k] += desired[k]
