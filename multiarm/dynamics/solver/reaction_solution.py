"""The solution of :mod:`multiarm.dynamics.solver.reactions` for one right-hand side, compiled.

``work`` is a :class:`multiarm.dynamics.solver.reactions.ReactionWork`, eliminated.
"""

from __future__ import annotations

from multiarm.dynamics.solver.reaction_coupling import (
    CORE_RANK,
    FREE,
    RANK,
    REACTION_RANK,
    ROWS,
    UNSERVED,
    object_motion,
    over_arm,
)
from multiarm.dynamics.solver.regular import node_backward, node_forward
from multiarm.jit.kernels import inlined, kernel


@kernel
def solve_for_reactions(work, Wo, Wr, h_o, h, c, q_o, q, force):
    """Solve the eliminated system for one right-hand side; the relative residual.

    Parameters
    ----------
    Wo, Wr : (N, 6)
        The object's rows, as in :func:`eliminate_with_reactions`.
    h_o : (6,), h : (D,), c : (N,)
        Right-hand sides, arms stacked.
    q_o : (6,), q : (D,), force : (N,), written
        Object's and joints' unknowns, and the physical contact forces ``lambda = -mu``.
    """
    _load(work, Wo, h_o, h, c)
    _solve_object(work, Wo, Wr, h_o, q_o, force)
    u = work.contacts
    for i in range(work.coupled.size):
        if work.coupled[i] != 0:
            continue
        first = work.rows[i]
        m = work.rows[i + 1] - first
        for a in range(m):
            u[a] = work.z[first + a]
            for k in range(6):
                u[a] -= Wo[first + a, k] * q_o[k]
        over_arm(i, work, u, False)
        for a in range(m):
            force[first + a] = u[a]
    total = force.size
    for k in range(work.counts[FREE]):  # the least norm of all forces
        part = 0.0
        for a in range(total):
            part += work.free[k, a] * force[a]
        for a in range(total):
            force[a] -= part * work.free[k, a]
        for k6 in range(6):
            q_o[k6] -= part * work.free[k, total + k6]
    return _move_arms(work, Wo, c, q_o, q, force)


@inlined
def _load(work, Wo, h_o, h, c):
    """Motions without contacts, and ``z``: what the contact forces have to bring about.

    What no force can is taken off: the least change of ``c`` that leaves no contradiction.
    """
    for k in range(6):
        work.unloaded[k] = h_o[k]
    node_forward(work.Lo, work.unloaded)
    node_backward(work.Lo, work.unloaded)
    for i in range(work.coupled.size):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        L = work.L[i]
        for j in range(d):
            s = h[d0 + j]
            for k in range(j):
                s -= L[j, k] * work.y[d0 + k]
            work.y[d0 + j] = s * L[j, j]
        for row in range(work.rows[i], work.rows[i + 1]):
            work.z[row] = c[row]
            for j in range(d):
                work.z[row] -= work.Y[i, j, row - work.rows[i]] * work.y[d0 + j]
    for v in range(work.counts[UNSERVED]):
        vector, left = work.unserved[v], 0.0
        for row in range(c.size):
            left += vector[row] * work.z[row]
            for k in range(6):
                left -= vector[row] * Wo[row, k] * work.unloaded[k]
        for row in range(c.size):
            work.z[row] -= left * vector[row]


@inlined
def _solve_object(work, Wo, Wr, h_o, q_o, force):
    """The object's acceleration and the forces of the coupled arms."""
    u = work.contacts
    for k in range(6):
        q_o[k] = h_o[k]
    for i in range(work.coupled.size):
        if work.coupled[i] != 0:
            continue
        first = work.rows[i]
        m = work.rows[i + 1] - first
        for a in range(m):
            u[a] = work.z[first + a]
        over_arm(i, work, u, False)
        for a in range(m):
            for k in range(6):
                q_o[k] += Wr[first + a, k] * u[a]
    if work.counts[ROWS] > 0:
        x = work.six
        for k in range(6):
            x[k] = q_o[k]
        object_motion(work, x)
        _solve_coupled(work, Wo, x, force)
        for a in range(work.counts[ROWS]):
            row = work.place[a]
            for k in range(6):
                q_o[k] += Wr[row, k] * force[row]
    object_motion(work, q_o)


@inlined
def _solve_coupled(work, Wo, x, force):
    """``F lambda = d`` by the three decompositions; ``x`` is the object without these forces."""
    counts, rows, place = work.counts, work.counts[ROWS], work.place
    left, right = work.left, work.right
    for a in range(rows):  # the right-hand side, scaled
        d = work.z[place[a]]
        for k in range(6):
            d -= Wo[place[a], k] * x[k]
        left[a] = work.scale[a] * d
    for i in range(counts[RANK]):
        s = 0.0
        for a in range(rows):
            s += work.V[i, a] * left[a]
        right[i] = s / work.sigma[i]
    for p in range(counts[CORE_RANK]):
        s = 0.0
        for i in range(counts[RANK]):
            s += work.core[p, i] * right[i]
        left[p] = s / work.core_sigma[p]
    for j in range(counts[REACTION_RANK]):
        s = 0.0
        for p in range(counts[CORE_RANK]):
            s += work.core_V[p, j] * left[p]
        right[j] = s / work.sigma_r[j]
    for a in range(rows):
        s = 0.0
        for j in range(counts[REACTION_RANK]):
            s += work.Vr[j, a] * right[j]
        force[place[a]] = work.scale_r[a] * s


@inlined
def _move_arms(work, Wo, c, q_o, q, force):
    """Joint accelerations; the largest constraint residual relative to its largest term."""
    worst, largest = 0.0, 0.0
    for i in range(work.coupled.size):
        d0, d = work.dofs[i], work.dofs[i + 1] - work.dofs[i]
        first = work.rows[i]
        m = work.rows[i + 1] - first
        L, Y, Yr = work.L[i], work.Y[i], work.Yr[i]
        for j in range(d):
            s = 0.0
            for a in range(m):
                s += Yr[j, a] * force[first + a]
            q[d0 + j] = s
        for a in range(m):
            without, due, on_object, moved = 0.0, 0.0, 0.0, 0.0
            for j in range(d):
                without += Y[j, a] * work.y[d0 + j]
                due += Y[j, a] * q[d0 + j]
            for k in range(6):
                on_object += Wo[first + a, k] * work.unloaded[k]
                moved += Wo[first + a, k] * q_o[k]
            left = abs(moved + without + due - c[first + a])
            worst = left if left != left else max(worst, left)
            for term in (abs(c[first + a]), abs(without), abs(due), abs(on_object)):
                largest = max(largest, term)
            largest = max(largest, abs(moved - on_object))
        for j in range(d):
            q[d0 + j] += work.y[d0 + j]
        for j in range(d - 1, -1, -1):
            s = q[d0 + j] * L[j, j]
            q[d0 + j] = s
            for k in range(j):
                q[d0 + k] -= L[j, k] * s
    return worst / largest if largest > 0.0 else worst
