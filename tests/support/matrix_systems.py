"""Constrained systems as matrices: random, of the worked examples, of a compiled scene.

And their solution: by the node algorithm on these matrices, and by elimination in decimals.
"""

from __future__ import annotations

from decimal import Decimal
from types import SimpleNamespace

import numpy as np
from hypothesis import strategies as st
from mechanics import (
    plain_arm,
)
from repository import WORKED
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.node import eliminate_blocks, make_work
from multiarm.dynamics.solver.singular import (
    couple,
    make_coupled,
    solve_coupled,
)
from multiarm.dynamics.status import DEFICIENT, OK

seeds = st.integers(0, 2**32 - 1)


def solve_by_node(system):
    """The node algorithm on the same data as :func:`multiarm.dynamics.solver.dense.solve_dense`."""
    dofs, rows = [m.shape[0] for m in system.M], [w.shape[1] for w in system.W]
    work = make_work(dofs, rows)
    for i, (M, W) in enumerate(zip(system.M, system.W, strict=True)):
        work.M[i, : dofs[i], : dofs[i]] = M
        work.W[i, : dofs[i], : rows[i]] = W
    W_o = np.ascontiguousarray(np.hstack(system.W_o).T)
    a_o, q, force = np.zeros(6), np.zeros(sum(dofs)), np.zeros(sum(rows))
    f_j, c = np.concatenate(system.f_j), np.concatenate(system.c)
    failed = solve_batched(work, W_o, system.M_o, system.f_o, f_j, c, a_o, q, force)
    if failed == DEFICIENT:
        coupled = make_coupled(dofs, rows)
        assert eliminate_blocks(work, W_o) == (OK, 0)
        assert couple(work, coupled, W_o, system.M_o, False) > 0.0
        solve_coupled(work, coupled, system.f_o, f_j, c, a_o, q, force)
    return SimpleNamespace(failed=failed, pivot=work.pivot, x=np.concatenate([a_o, q]), force=force)


def spd(rng, n, scale):
    """A random inertia: eigenvalues over two decades."""
    Q, _ = np.linalg.qr(rng.standard_normal((n, n)))
    M = scale * (Q * 10.0 ** rng.uniform(-1, 1, n)) @ Q.T
    return (M + M.T) / 2


def random_system(rng, shapes, ratio=1.0):
    """Arms of the given (joints, contacts); the object is ``ratio`` times as heavy as an arm."""
    normal = rng.standard_normal
    return SimpleNamespace(
        M_o=spd(rng, 6, ratio),
        f_o=normal(6),
        M=[spd(rng, n, 1.0) for n, _ in shapes],
        f_j=[normal(n) for n, _ in shapes],
        W_o=[normal((6, m)) for _, m in shapes],
        W=[normal((n, m)) for n, m in shapes],
        c=[normal(m) for _, m in shapes],
    )


def stacked(system):
    """Inertia, right-hand side and constraints of the whole system."""
    from scipy.linalg import block_diag

    M, W = block_diag(system.M_o, *system.M), block_diag(*system.W)
    return (
        M,
        np.concatenate([system.f_o, *system.f_j]),
        np.vstack([np.hstack(system.W_o), W]),
        np.concatenate(system.c),
    )


def worked_system(name):
    data = WORKED[name]["inputs"]
    array = lambda key: [np.array(arm[key]) for arm in data["arms"]]  # noqa: E731
    system = SimpleNamespace(
        M_o=np.array(data["Mo"]), f_o=np.array(data["ho"]), M=array("M"), f_j=array("h"),
        W_o=array("Wo"), W=array("W"), c=array("c"),
    )  # fmt: skip
    return system, {"reaction_o": array("Wot"), "reaction": array("Wt")}, WORKED[name]["expected"]


def exactly(array):
    """The same numbers as decimals."""
    return np.vectorize(Decimal, otypes=[object])(np.asarray(array, dtype=float))


def solve_exactly(A, B):
    """``A^-1 B`` for a regular A, by Gaussian elimination with pivoting."""
    A, B = A.copy(), B.copy()
    n = len(A)
    for k in range(n):
        best = max(range(k, n), key=lambda r, k=k: abs(A[r, k]))
        A[[k, best]], B[[k, best]] = A[[best, k]], B[[best, k]]
        for r in range(k + 1, n):
            factor = A[r, k] / A[k, k]
            A[r, k:] -= factor * A[k, k:]
            B[r] -= factor * B[k]
    for k in range(n - 1, -1, -1):
        B[k] = (B[k] - A[k, k + 1 :] @ B[k + 1 :]) / A[k, k]
    return B


def system_matrices(system, evaluation):
    """M, f_j, W, c from the arms' Jacobians and the contact wrenches."""
    state, scene = evaluation.state, system.scene
    R = Rotation.from_quat(state.object_quaternion_xyzw).as_matrix()
    inertia = R @ scene.object.inertia_matrix() @ R.T
    omega = state.object_twist[3:]
    gravity = np.array(scene.gravity or (0.0, 0.0, 0.0))
    M, W_o, W, c = [block_diag(scene.object.mass * np.eye(3), inertia)], [], [], []
    f_j = [scene.object.mass * gravity, -np.cross(omega, inertia @ omega)]
    for name in system.arm_names:
        q, v = state.joint_positions[name], state.joint_velocities[name]
        terms, contact = system.arms[name].terms(q, v), evaluation.contact_terms[name]
        inertia, load = plain_arm(system.arms[name], q, v, gravity)
        M.append(inertia)
        f_j.append(evaluation.joint_torques[name] + load)
        W_o.append(np.kron(np.eye(2), R) @ contact.W_o)
        W.append(terms.J.T @ np.kron(np.eye(2), terms.tip_rotation) @ contact.W_m)
        c.append(contact.c)
    stack = np.vstack([np.hstack(W_o), block_diag(*W)])
    return block_diag(*M), np.concatenate(f_j), stack, np.concatenate(c)
