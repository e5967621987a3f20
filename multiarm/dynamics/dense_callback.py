"""The dense reference as a solver of the time loop: Python reads the same terms and solves them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np

from multiarm.arms.terms import M_AT, M_STRIDE
from multiarm.dynamics.arrays import Variables
from multiarm.dynamics.solver.dense import solve_dense
from multiarm.dynamics.solver.work import NodeWork
from multiarm.errors import SolverError


def dense_call(
    b: Variables,
    work: NodeWork,
    reactions: tuple[np.ndarray, np.ndarray] | None = None,
) -> Callable[[], None]:
    """Function without arguments that solves for ``q_o, qdd, force`` in ``b``.

    ``reactions`` are the object's rows (N, 6) and the arms' matrices (n, d, m) where forces act
    along other directions than the constraints.
    """
    dofs, rows = work.dofs, work.rows
    arms = range(len(dofs) - 1)

    def solve() -> None:
        inertias = [read_inertia(b.pointers[i], dofs[i + 1] - dofs[i]) for i in arms]
        _require_usable(inertias, (b.h, b.c, b.h_o, work.Y))
        solution = solve_dense(
            M_o=b.inertia,
            h_o=b.h_o,
            M=inertias,
            h=[b.h[dofs[i] : dofs[i + 1]] for i in arms],
            W_o=[b.Wo[rows[i] : rows[i + 1]].T for i in arms],
            W=[work.Y[i, : dofs[i + 1] - dofs[i], : rows[i + 1] - rows[i]] for i in arms],
            c=[b.c[rows[i] : rows[i + 1]] for i in arms],
            **_reactions(reactions, dofs, rows),
        )
        b.q_o[:] = solution.object_acceleration
        b.qdd[:] = np.concatenate(solution.joint_accelerations)
        b.force[:] = np.concatenate(solution.contact_forces)
        b.status.rank, b.status.coupled_arms = solution.rank, 0

    return solve


def _reactions(given: tuple[np.ndarray, np.ndarray] | None, dofs, rows) -> dict:
    if given is None:
        return {}
    on_object, on_arms = given
    arms = range(len(dofs) - 1)
    return {
        "reaction_o": [on_object[rows[i] : rows[i + 1]].T for i in arms],
        "reaction": [on_arms[i, : dofs[i + 1] - dofs[i], : rows[i + 1] - rows[i]] for i in arms],
    }


def _require_usable(inertias: list[np.ndarray], terms: tuple[np.ndarray, ...]) -> None:
    if not all(np.all(np.isfinite(term)) for term in (*terms, *inertias)):
        raise SolverError(
            "the equations of motion are not finite; take smaller steps, or check the controller"
        )
    for number, inertia in enumerate(inertias, start=1):
        if not np.all(np.diag(inertia) > 0.0):
            raise SolverError(
                f"a joint of arm {number} moves links without mass or inertia; give them some in "
                f"the URDF, or lock the joint"
            )


def read_inertia(pointers: np.ndarray, n: int) -> np.ndarray:
    """The arm's inertia as it is now, symmetric, copied, shape (n, n)."""
    if n == 0:  # the surroundings
        return np.zeros((0, 0))
    stride = int(pointers[M_STRIDE])
    size = (n - 1) * stride + n
    numbers = (ctypes.c_double * size).from_address(int(pointers[M_AT]))
    flat = np.frombuffer(memoryview(numbers), dtype=float)
    lower = np.lib.stride_tricks.as_strided(flat, (n, n), (8 * stride, 8))
    return np.tril(lower) + np.tril(lower, -1).T
