r"""Derivatives where friction leaves the motion open.

With reaction matrices :math:`\tilde W \neq W`, dependent constraints leave more than forces open
(:mod:`multiarm.dynamics.solver.reaction_coupling`): the equations :math:`K y = r` of
:mod:`multiarm.dynamics.derivatives` have null vectors with accelerations,

.. math:: K N = 0, \qquad N = \begin{bmatrix} M^{-1} \tilde W\,\nu \\ \nu \end{bmatrix},

and the solution is that of the least contact forces, :math:`\nu^T \lambda = 0`.  With the rank,
this holds in a neighbourhood, so that

.. math::
    K\,dN = -dK\,N, \qquad \nu^T d\lambda = -d\nu^T \lambda, \qquad K\,dy = -\partial F .

As F is affine in y, :math:`dK\,N` is half the difference of its derivatives at :math:`y \pm N`:
equations are differentiated, no state is evaluated.  The parts of dN along N do not count, since
:math:`\nu^T \lambda = 0`.

*Solution.*  The columns of Q are orthonormal with :math:`W Q = 0`.  K with :math:`Q \nu^T` in the
block of the forces, :math:`K'`, is regular, and both conditions are

.. math:: K'\,dy = -(1 - Q Q^T)\,\partial F - Q\,d\nu^T \lambda .

The projection leaves out what contradicts dependent constraints, as the solver does.
"""

from __future__ import annotations

import math

import numpy as np

from multiarm.dynamics.arrays import open_data
from multiarm.dynamics.coordinates import equation_columns
from multiarm.dynamics.equation_derivatives import (
    stack_derivatives,
    stack_matrix,
    write_derivatives,
)
from multiarm.dynamics.sliding_derivatives import add_friction
from multiarm.dynamics.solver.bounds import OPEN_MOTION_PIVOT
from multiarm.dynamics.solver.factors import decompose, factor_lu, solve_rows
from multiarm.dynamics.status import OK, SINGULAR
from multiarm.jit.kernels import allocating, clear


@allocating
def solve_open_motion(struct, equations, of_friction, matrix):
    """Solve for ``dy`` where friction leaves the motion open; returns a status.

    ``matrix`` (6 F + n + N, columns) is written.  ``equations, of_friction`` are the structs of
    :func:`multiarm.dynamics.sliding_derivatives.add_friction`, after which it is called; their
    derivatives are used up.  The result is ``SINGULAR`` where the rank of the equations changes.
    """
    data, size = open_data(struct), matrix.shape[0]
    nv, dependent = data.state.velocity.size, data.solution.dependent
    K, pivots, by_null = np.zeros((size, size)), np.zeros(size, np.int64), np.zeros(matrix.shape)
    for i in range(size):
        clear(matrix[i])
    stack_matrix(struct, equations, K)
    stack_derivatives(struct, equations, -1.0, matrix)
    Q, N = np.zeros((dependent, size)), np.zeros((dependent, size))
    write_null_vectors(K, nv, Q, N)
    for v in range(dependent):
        for a in range(nv, size):
            for b in range(nv, size):
                K[a, b] += Q[v, a] * N[v, b]
    if not factor_lu(K, size, pivots) > OPEN_MOTION_PIVOT:
        return SINGULAR
    for v in range(dependent):
        status = differentiate_null_vector(struct, equations, of_friction, N[v], by_null)
        if status != OK:
            return status
        solve_rows(K, size, pivots, by_null)
        for c in range(matrix.shape[1]):
            part = 0.0
            for a in range(nv, size):
                part += data.rows.force[a - nv] * by_null[a, c] - Q[v, a] * matrix[a, c]
            for a in range(nv, size):
                matrix[a, c] += Q[v, a] * part
    solve_rows(K, size, pivots, matrix)
    return OK


@allocating
def differentiate_null_vector(struct, equations, of_friction, N, by_null):
    """Write ``dK N`` for one null vector; returns a status."""
    data = open_data(struct)
    nv, torques, status = data.state.velocity.size, equation_columns(data).torques, OK
    a, force = data.accelerations.a.copy(), data.rows.force.copy()
    for i in range(N.size):
        clear(by_null[i])
    for side in (-1.0, 1.0):
        for l in range(nv):
            data.accelerations.a[l] = a[l] + side * N[l]
        for k in range(force.size):
            data.rows.force[k] = force[k] + side * N[nv + k]
        if status == OK:
            status = write_derivatives(struct, equations)
        if status == OK:
            status = add_friction(struct, equations, of_friction)
        stack_derivatives(struct, equations, 0.5 * side, by_null)
    for i in range(N.size):
        clear(by_null[i, torques:])
    for l in range(nv):
        data.accelerations.a[l] = a[l]
    for k in range(force.size):
        data.rows.force[k] = force[k]
    return status


@allocating
def write_null_vectors(K, nv, Q, N):
    r"""Write orthonormal Q and null vectors N, one a row, as many as constraints are dependent.

    :math:`\nu` are the null vectors of :math:`\tilde M^{-1} \tilde W` in the directions of the
    independent constraints.
    """
    size = K.shape[0]
    rows, rank = size - nv, size - nv - Q.shape[0]
    M, pivots, reaction = np.zeros((nv, nv)), np.zeros(nv, np.int64), np.zeros((nv, rows))
    G, V, singular = np.zeros((rows, nv)), np.zeros((rows, rows)), np.zeros(rows)
    F, Vr = np.zeros((rows, rows)), np.zeros((rows, rows))
    for l in range(nv):
        for j in range(nv):
            M[l, j] = K[l, j]
        for k in range(rows):
            reaction[l, k] = -K[l, nv + k]
            G[k, l] = K[nv + k, l] / math.sqrt(K[l, l])
    factor_lu(M, nv, pivots)
    solve_rows(M, nv, pivots, reaction)
    decompose(G, rows, nv, V, singular)
    for v in range(Q.shape[0]):
        for k in range(rows):
            Q[v, nv + k] = V[rank + v, k]
    for a in range(rows):
        for r in range(rank):
            for l in range(nv):
                F[a, r] += reaction[l, a] * G[r, l] * math.sqrt(K[l, l])
    decompose(F, rows, rank, Vr, singular)
    for v in range(N.shape[0]):
        for k in range(rows):
            N[v, nv + k] = Vr[rank + v, k]
            for l in range(nv):
                N[v, l] += reaction[l, k] * Vr[rank + v, k]
