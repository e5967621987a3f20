r"""How the contacts share a load: forces of least norm, and forces that squeeze.

The contact forces that put a wanted wrench ``w`` on the object are (thesis, 3.4)

.. math:: \lambda = W_o^+ w + (1 - W_o^+ W_o)\,\lambda_s

the forces of least norm, plus that part of a set of wanted forces :math:`\lambda_s` that does not
move the object.  Both come from one solution, :math:`\lambda = \lambda_s + W_o^+ (w - W_o
\lambda_s)`.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.jit.kernels import allocating

# [m]; contacts whose lines all pass the centre of mass closer than this have no moments
SHORTEST_LEVER = 1e-6
# Pivots below this fraction of the largest mean that the rank is reached.
RANK_TOLERANCE = 1e-12


@allocating
def solve_semidefinite(A, b, x):
    """Solve ``A x = b`` for a symmetric, positive semidefinite matrix (n, n); returns its rank.

    Cholesky's method with diagonal pivoting; where ``A`` has lost rank the remaining directions are
    left alone (a basic solution, exact whenever there is one).  Rows should be scaled so that the
    diagonal entries can be compared.  ``A`` is destroyed, ``x`` (n,) is written.
    """
    n = b.size
    L, y, order = np.zeros((n, n)), np.zeros(n), np.arange(n)
    largest = 0.0
    for i in range(n):
        largest = max(largest, A[i, i])
    rank = n
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if A[order[i], order[i]] > A[order[best], order[best]]:
                best = i
        order[k], order[best] = order[best], order[k]
        p = order[k]
        if not A[p, p] > RANK_TOLERANCE * largest:
            rank = k
            break
        L[p, k] = math.sqrt(A[p, p])
        for i in range(k + 1, n):
            L[order[i], k] = A[order[i], p] / L[p, k]
        for i in range(k + 1, n):
            for j in range(k + 1, n):
                A[order[i], order[j]] -= L[order[i], k] * L[order[j], k]
    x[:] = 0.0
    for k in range(rank):
        p = order[k]
        y[k] = b[p]
        for j in range(k):
            y[k] -= L[p, j] * y[j]
        y[k] /= L[p, k]
    for k in range(rank - 1, -1, -1):
        p = order[k]
        s = y[k]
        for i in range(k + 1, rank):
            s -= L[order[i], k] * x[order[i]]
        x[p] = s / L[p, k]
    return rank


@allocating
def static_forces(Wo, weight, force):
    r"""Write the contact forces of least norm with :math:`W_o \lambda = w` into ``force`` (N,).

    ``Wo`` (N, 6) has one row a contact, ``weight`` is a wrench (6,).  Directions in which the
    contacts cannot push are left alone: the solution is exact whenever they can carry the wrench.
    """
    # moments are measured at the longest lever arm, so that all rows are forces; a lever arm at
    # rounding level must not be scaled up to a direction of its own
    longest = SHORTEST_LEVER
    for k in range(Wo.shape[0]):
        longest = max(longest, math.sqrt(Wo[k, 3] ** 2 + Wo[k, 4] ** 2 + Wo[k, 5] ** 2))
    scale = np.ones(6)
    scale[3:] = 1.0 / longest
    A, b, x = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    for i in range(6):
        b[i] = scale[i] * weight[i]
        for j in range(6):
            for k in range(Wo.shape[0]):
                A[i, j] += Wo[k, i] * Wo[k, j]
            A[i, j] *= scale[i] * scale[j]
    solve_semidefinite(A, b, x)
    for k in range(Wo.shape[0]):
        force[k] = 0.0
        for i in range(6):
            force[k] += Wo[k, i] * scale[i] * x[i]


@allocating
def add_wrench_forces(Wo, wrench, rotation, force):
    """Add the forces of least norm that put a wrench, given in object axes (6,), on the object.

    ``Wo`` (m, 6) has the rows of one arm's contacts in world axes, ``rotation`` (9,) turns the
    object's components into the world's, row by row.
    """
    world, part = np.zeros(6), np.zeros(Wo.shape[0])
    for i in range(3):
        for j in range(3):
            world[i] += rotation[3 * i + j] * wrench[j]
            world[3 + i] += rotation[3 * i + j] * wrench[3 + j]
    static_forces(Wo, world, part)
    for k in range(part.size):
        force[k] += part[k]


@allocating
def share_load(wrench, Wo, rows, rotation, offsets, pressing, force):
    r"""Write the contact forces that put ``wrench`` on the object and squeeze it besides.

    Parameters
    ----------
    wrench : (6,)
        About the centre of mass, world axes [N, N m].
    Wo : (N, 6), rows : int (n + 1,)
        Rows of all contacts in world axes, and where each arm's begin.
    rotation : (9,)
        Of the object, row by row.
    offsets : (N,), pressing : (6 n,)
        Wanted forces of the contacts, and a wanted wrench of every arm on the object (about its
        centre of mass, its axes); what is not internal in them is taken away.
    force : (N,), written
    """
    wanted = offsets.copy()
    for i in range(rows.size - 1):
        own = pressing[6 * i : 6 * i + 6]
        if np.any(own != 0.0):
            r0, r1 = rows[i], rows[i + 1]
            add_wrench_forces(Wo[r0:r1], own, rotation, wanted[r0:r1])
    rest = wrench.copy()
    for k in range(wanted.size):
        for i in range(6):
            rest[i] -= Wo[k, i] * wanted[k]
    static_forces(Wo, rest, force)
    for k in range(wanted.size):
        force[k] += wanted[k]
