r"""The node algorithm where contact forces act along other directions than the constraints.

Sliding friction turns the force of a contact away from its normal, while the constraint stays along
the normal: the *reaction matrices* :math:`\tilde W` differ from the constraint matrices ``W``
(thesis, 4.9 and its footnote; :math:`\lambda = -\mu` is the physical contact force)

.. math::
    M_o q_o = h_o + \sum_i \tilde W_{oi} \lambda_i, \qquad
    M_i q_i = h_i + \tilde W_i \lambda_i, \qquad
    W_{oi}^T q_o + W_i^T q_i = c_i

With :math:`M_i = L_i L_i^T`, :math:`Y_i = L_i^{-1} W_i`, :math:`\tilde Y_i = L_i^{-1} \tilde W_i`,
the elimination is that of :mod:`multiarm.dynamics.solver.regular` with matrices that are not
symmetric, which LU factors with pivoting take the place of Cholesky's:

.. math::
    K_i = Y_i^T \tilde Y_i, \qquad S = M_o + \sum_i \tilde W_{oi} K_i^{-1} W_{oi}^T, \qquad
    q_o = S^{-1} \big(h_o + \sum_i \tilde W_{oi} K_i^{-1} z_i\big), \qquad
    \lambda_i = K_i^{-1} (z_i - W_{oi}^T q_o)

with :math:`z_i = c_i - Y_i^T L_i^{-1} h_i`.  Arms whose ``K_i`` is singular, or nearly so, are
solved together with the object (:mod:`multiarm.dynamics.solver.reaction_coupling`); if ``S`` is,
all arms are. The cost grows linearly with the number of the other arms.

With friction a solution need not exist, nor be the only one (Painleve).  Both are told, never
repaired in silence: see :class:`multiarm.arms.terms.NodeSolution`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.dynamics.solver.dense import NodeSolution
from multiarm.dynamics.solver.reaction_coupling import (
    COUNTS,
    FREE,
    MOVING,
    PART_TOLERANCE,
    RANK,
    ROWS,
)
from multiarm.dynamics.solver.reaction_elimination import eliminate_with_reactions
from multiarm.dynamics.solver.reaction_solution import solve_for_reactions
from multiarm.dynamics.solver.regular import IMBALANCE_BOUND
from multiarm.jit.structs import Floats1, Floats2, Floats3, Ints1, Ints2


class ReactionWork(NamedTuple):
    """Arrays of the elimination: ``n`` arms, at most ``d`` joints and ``m`` contacts an arm.

    Together they have D joints and N contacts.

    dofs, rows : int64 (n + 1,)
        Where each arm's joints and contacts start in the stacked vectors.
    levers : (n, d)
        As in :class:`multiarm.dynamics.solver.work.NodeWork`.
    L : (n, d, d), Y, Yr : (n, d, m)
        Factors of the inertias (lower triangles, diagonals inverted); ``L^-1 W``, ``L^-1 W~``.
    K : (n, m, m), K_pivots : int64 (n, m), arm_scale, arm_scale_r : (N,)
        LU factors of ``K`` scaled by rows and columns; the scales.
    Lo, Ls : (6, 6)
        Factors of the object's inertia and of the node matrix without friction.
    node : (6, 6), node_pivots : int64 (6,)
        LU factors of ``Ls^-1 S Ls^-T``.
    coupled, loose : int64 (n,)
        Which arms are coupled; whose forces take part in what is not determined of the motion.
    pivot : (n + 1,)
        How far each arm's ``K`` is from being singular, with and without friction; the node last.
    spread : (6, 6), evenness : (1,)
        How evenly the arms stiffen the object, 1 at best.
    counts : int64 (8,)
        Numbers of the coupled system, see :mod:`multiarm.dynamics.solver.reaction_coupling`.
    place : int64 (N,), scale, scale_r : (N,)
        Row of each coupled contact in the stacked vectors; scales of the columns of G and G~.
    U, Ur : (N, 6 + D), V, Vr : (N, N), sigma, sigma_r : (N,)
        Decompositions of G and G~, one vector a row.
    core, core_V, core_left, core_left_V : (N, N), core_sigma : (N,)
        Decompositions of the core and of its transpose.
    free, unserved : (N, N + 6)
        Contact forces that no constraint sees, with the object's motion behind them; constraints
        that no contact force serves.
    y : (D,), z, left, right : (N,), unloaded : (6,)
        Intermediate vectors; the object's acceleration without contacts.
    six : (6,), contacts : (m,), six_columns : (m, 6)
        Scratch.
    """

    dofs: Ints1
    rows: Ints1
    levers: Floats2
    L: Floats3
    Y: Floats3
    Yr: Floats3
    K: Floats3
    K_pivots: Ints2
    arm_scale: Floats1
    arm_scale_r: Floats1
    Lo: Floats2
    Ls: Floats2
    node: Floats2
    node_pivots: Ints1
    coupled: Ints1
    loose: Ints1
    pivot: Floats1
    spread: Floats2
    evenness: Floats1
    counts: Ints1
    place: Ints1
    scale: Floats1
    scale_r: Floats1
    U: Floats2
    Ur: Floats2
    V: Floats2
    Vr: Floats2
    sigma: Floats1
    sigma_r: Floats1
    core: Floats2
    core_V: Floats2
    core_left: Floats2
    core_left_V: Floats2
    core_sigma: Floats1
    free: Floats2
    unserved: Floats2
    y: Floats1
    z: Floats1
    left: Floats1
    right: Floats1
    unloaded: Floats1
    six: Floats1
    contacts: Floats1
    six_columns: Floats2


def make_reaction_work(dofs: list[int], rows: list[int]) -> ReactionWork:
    """Allocate for arms with ``dofs[i]`` joints and ``rows[i]`` contacts; all levers are 1."""
    n, d, m, D, N = len(dofs), max(dofs), max(rows), sum(dofs), sum(rows)
    shapes = {
        "L": (n, d, d), "Y": (n, d, m), "Yr": (n, d, m), "K": (n, m, m), "K_pivots": (n, m),
        "arm_scale": N, "arm_scale_r": N, "Lo": (6, 6), "Ls": (6, 6), "node": (6, 6),
        "node_pivots": 6, "coupled": n, "loose": n, "pivot": n + 1, "spread": (6, 6),
        "evenness": 1, "counts": COUNTS, "place": N,
        "scale": N, "scale_r": N, "U": (N, 6 + D), "Ur": (N, 6 + D), "V": (N, N), "Vr": (N, N),
        "sigma": N, "sigma_r": N, "core": (N, N), "core_V": (N, N), "core_left": (N, N),
        "core_left_V": (N, N), "core_sigma": N, "free": (N, N + 6), "unserved": (N, N + 6),
        "y": D, "z": N, "left": N, "right": N, "unloaded": 6, "six": 6, "contacts": m,
        "six_columns": (m, 6),
    }  # fmt: skip
    whole = {"K_pivots", "node_pivots", "coupled", "loose", "counts", "place"}
    return ReactionWork(
        dofs=np.concatenate([[0], np.cumsum(dofs)]).astype(np.int64),
        rows=np.concatenate([[0], np.cumsum(rows)]).astype(np.int64),
        levers=np.ones((n, d)),
        **{name: np.zeros(s, np.int64 if name in whole else float) for name, s in shapes.items()},
    )


def solve_with_reactions(
    M_o: np.ndarray,
    h_o: np.ndarray,
    M: list[np.ndarray],
    h: list[np.ndarray],
    W_o: list[np.ndarray],
    W: list[np.ndarray],
    c: list[np.ndarray],
    reaction_o: list[np.ndarray] | None = None,
    reaction: list[np.ndarray] | None = None,
) -> NodeSolution:
    """Solve the constrained system by the node algorithm.

    Parameters and result are those of :func:`multiarm.dynamics.solver.dense.solve_dense`.

    Raises
    ------
    ValueError
        When an inertia matrix is not positive definite, or a number is not finite.
    """
    dofs, rows = [len(m) for m in M], [w.shape[1] for w in W]
    reaction = W if reaction is None else reaction
    work = make_reaction_work(dofs, rows)
    Wo = np.ascontiguousarray(np.hstack(W_o).T, dtype=float)
    Wr = Wo if reaction_o is None else np.ascontiguousarray(np.hstack(reaction_o).T, dtype=float)
    loads = np.array(h_o, float), np.concatenate(h).astype(float), np.concatenate(c).astype(float)
    q_o, q, force = np.zeros(6), np.zeros(sum(dofs)), np.zeros(sum(rows))
    for couple_all in (False, True):
        for i, (inertia, own, forces) in enumerate(zip(M, W, reaction, strict=True)):
            work.L[i, : dofs[i], : dofs[i]] = inertia
            work.Y[i, : dofs[i], : rows[i]] = own
            work.Yr[i, : dofs[i], : rows[i]] = forces
        failed = eliminate_with_reactions(work, Wo, Wr, np.array(M_o, float), couple_all)
        if failed >= 0:
            part = "the object" if failed == len(M) else f"arm {failed + 1}"
            raise ValueError(
                f"{part}: the inertia matrix is not positive definite, or a number is not finite"
            )
        residual = solve_for_reactions(work, Wo, Wr, *loads, q_o, q, force)
        left = np.abs(np.array(M_o) @ q_o - h_o - Wr.T @ force)
        if np.all(left <= IMBALANCE_BOUND * (np.abs(h_o) + np.abs(Wr).T @ np.abs(force))):
            break
    counts, bounds = work.counts, np.cumsum(rows)[:-1]
    free = work.free[: counts[FREE], : len(force)]
    return NodeSolution(
        object_acceleration=q_o,
        joint_accelerations=np.split(q, np.cumsum(dofs)[:-1]),
        contact_forces=np.split(force, bounds),
        unique=np.split(np.linalg.norm(free, axis=0) < PART_TOLERANCE, bounds),
        rank=len(force) - int(counts[ROWS] - counts[RANK]),
        motion_unique=not counts[MOVING],
        loose_arms=tuple(np.flatnonzero(work.loose).tolist()),
        residual=float(residual),
    )
