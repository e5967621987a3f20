"""The compiled side of the solver study: what the time loop does, on given coefficients."""

from __future__ import annotations

import numpy as np

from multiarm.dynamics.arrays import OK, open_data
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.batched import solve_batched
from multiarm.dynamics.solver.node import ELIMINATED, make_work
from multiarm.errors import SolverError
from multiarm.jit.kernels import kernel
from multiarm.jit.pointers import call_cfunc
from multiarm.studies.bursts import Burst
from multiarm.studies.solver_forms import Coefficients, Solution, assemble


class CompiledNode:
    """The node algorithm of the time loop (``dynamics.solver.batched``) on coefficients."""

    def __init__(self, s: Coefficients) -> None:
        n, d, N = s.W.shape
        self._work = make_work([d] * n, [N] * n)
        self._given = tuple(
            np.ascontiguousarray(array)
            for array in (
                s.M, s.W, s.W_o.transpose(0, 2, 1).reshape(n * N, 6), s.M_o, s.h_o,
                s.h.ravel(), s.c.ravel(),
            )
        )  # fmt: skip
        self._found = np.zeros(6), np.zeros(n * d), np.zeros(n * N)
        self._shape = n, d, N

    def burst(self, count: int) -> None:
        """Eliminate and solve that many times."""
        if _node_often(self._work, *self._given, *self._found, count) != ELIMINATED:
            raise SolverError("an arm of the study is singular; put it in a regular posture")

    def solve(self) -> Solution:
        """Accelerations and forces."""
        self.burst(1)
        n, d, N = self._shape
        q_o, q, force = (array.copy() for array in self._found)
        return Solution(q_o, q.reshape(n, d), force.reshape(n, N))


def build_burst(data: Data) -> Burst:
    """The coefficients of (4.9) at the state in the data, with ``W`` and all forces."""
    struct = data.struct

    def burst(count: int) -> None:
        if _build_often(struct, count) != OK:
            data.reraise()
            raise SolverError("the coefficients of the study cannot be built")

    return burst


def assembly_burst(s: Coefficients) -> Burst:
    """Filling the whole matrix and its right-hand side."""
    matrix, right = (np.zeros_like(array) for array in assemble(s))
    matrix = np.ascontiguousarray(matrix)  # it is symmetric

    def burst(count: int) -> None:
        _assemble_often(s.M_o, s.h_o, s.M, s.h, s.W_o, s.W, s.c, matrix, right, count)

    return burst


@kernel
def _build_often(struct, count):
    """Coefficients of the system in the struct: Pinocchio, contacts, forces."""
    functions = open_data(struct).functions
    status = OK
    for _ in range(count):
        status = call_cfunc(functions.kinematics, struct, 0.0, 0.0)
        if status == OK:
            status = call_cfunc(functions.forces, struct, 0.0, 0.0)
        if status != OK:
            return status
    return status


@kernel
def _node_often(work, M, W, Wo, M_o, h_o, h, c, q_o, q, force, count):
    """Load, eliminate, solve."""
    status = ELIMINATED
    for _ in range(count):
        for i in range(M.shape[0]):
            for a in range(M.shape[1]):
                for b in range(a + 1):
                    work.L[i, a, b] = M[i, a, b]
                for b in range(W.shape[2]):
                    work.Y[i, a, b] = W[i, a, b]
        status = solve_batched(work, Wo, M_o, h_o, h, c, q_o, q, force)
        if status != ELIMINATED:
            return status
    return status


@kernel
def _assemble_often(M_o, h_o, M, h, W_o, W, c, matrix, right, count):
    """What :func:`multiarm.studies.solver_forms.assemble` does."""
    n, d, m = W.shape
    for _ in range(count):
        for a in range(matrix.shape[0]):
            for b in range(matrix.shape[1]):
                matrix[a, b] = 0.0
        for a in range(6):
            right[a] = h_o[a]
            for b in range(6):
                matrix[a, b] = M_o[a, b]
        for i in range(n):
            j0, r0 = 6 + i * d, 6 + n * d + i * m
            for a in range(d):
                right[j0 + a] = h[i, a]
                for b in range(d):
                    matrix[j0 + a, j0 + b] = M[i, a, b]
            for k in range(m):
                right[r0 + k] = c[i, k]
                for a in range(d):
                    matrix[j0 + a, r0 + k] = matrix[r0 + k, j0 + a] = W[i, a, k]
                for a in range(6):
                    matrix[a, r0 + k] = matrix[r0 + k, a] = W_o[i, a, k]
