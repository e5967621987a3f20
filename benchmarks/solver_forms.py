r"""The solvers that the study of the thesis's section 4.4 compares, on one set of matrices.

Each takes the :class:`Coefficients` of

.. math::
    M_o a_o = f_o + \sum_i W_{oi} \lambda_i, \qquad M_i a_i = f_i + W_i \lambda_i, \qquad
    W_{oi}^T a_o + W_i^T a_i = c_i

and returns accelerations and contact forces.  They share nothing but these matrices: the node
algorithm of thesis 4.2 as a plain loop; that of K. W. Lilly and D. E. Orin (J. Dyn. Sys. Meas.
Control 116, 1994; thesis 4.1 - 4.6), which works in the arms' operational space with orthonormal
constraint directions; that of S. McMillan, P. Sadayappan and D. E. Orin (ICRA 1992; thesis 4.7,
4.8), which solves for the forces of some arms together, or of none; and direct elimination of the
whole matrix by LAPACK, with and without use of its symmetry.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, lapack

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.spatial import quaternion_to_matrix


class Coefficients(NamedTuple):
    """The system's matrices; ``n`` arms of ``d`` joints and ``N`` contacts each.

    M_o, f_o : (6, 6), (6,)
        The object's inertia and right-hand side.
    M, f_j : (n, d, d), (n, d)
    W_o, W, c : (n, 6, N), (n, d, N), (n, N)
    J : (n, 6, d)
        Jacobians of the tips, world axes.
    wrench : (n, 6, N)
        The contacts' wrenches on the object, about the tip: ``W = -J^T wrench``.
    G : (n, 6, 6)
        Takes the object's motion to the tip: ``W_o = G^T wrench``.
    """

    M_o: np.ndarray
    f_o: np.ndarray
    M: np.ndarray
    f_j: np.ndarray
    W_o: np.ndarray
    W: np.ndarray
    c: np.ndarray
    J: np.ndarray
    wrench: np.ndarray
    G: np.ndarray


class Solution(NamedTuple):
    """Accelerations of object (6,) and joints (n, d), and contact forces (n, N)."""

    a_o: np.ndarray
    q: np.ndarray
    force: np.ndarray


def build(system: System, state: State) -> Coefficients:
    """The coefficients by plain Python: Pinocchio arm by arm, everything else in NumPy.

    For arms without torques, each of which touches a face of the object with its tip (the joint
    ``point_on_plane``).  With ``e`` the normal into the object and ``r`` from the object's centre
    of mass to the tip, the gap is ``-e^T r`` plus a constant; differentiated twice it gives
    ``c = e^T a_tip + 2 (omega x e)^T (v_tip - v) + (omega x (omega x e))^T r``.
    """
    x, twist = state.object_position, state.object_twist
    v, omega = twist[:3], twist[3:]
    R = quaternion_to_matrix(state.object_quaternion_xyzw)
    rows = []
    for name, arm in system.arms.items():
        terms = arm.terms(state.joint_positions[name], state.joint_velocities[name])
        e = -R @ system.frames[name].on_object[:3, 2]
        r = terms.tip_position - x
        turning = np.cross(omega, e)
        c = (
            e @ terms.drift[:3]
            + 2.0 * turning @ (terms.tip_twist[:3] - v)
            + np.cross(omega, turning) @ r
        )
        wrench = np.concatenate([e, np.zeros(3)])[:, None]
        G = np.eye(6)
        G[:3, 3:] = [[0.0, r[2], -r[1]], [-r[2], 0.0, r[0]], [r[1], -r[0], 0.0]]  # -[r]x
        rows.append(
            (terms.M, -terms.bias, G.T @ wrench, -terms.J.T @ wrench, [c], terms.J, wrench, G)
        )
    plant = system.model.constants
    inertia = R @ plant.object_inertias[0] @ R.T
    M_o = np.zeros((6, 6))
    M_o[:3, :3], M_o[3:, 3:] = plant.object_masses[0] * np.eye(3), inertia
    f_o = np.concatenate(
        [plant.object_masses[0] * plant.gravity, -np.cross(omega, inertia @ omega)]
    )
    return Coefficients(M_o, f_o, *(np.array(column) for column in zip(*rows, strict=True)))


def node_loop(s: Coefficients) -> Solution:
    """The node algorithm (thesis, 4.10 - 4.12) arm by arm, as one writes it in NumPy."""
    A, b = s.M_o.copy(), s.f_o.copy()
    arms = []
    for M, f_j, W_o, W, c in zip(s.M, s.f_j, s.W_o, s.W, s.c, strict=True):
        Y = np.linalg.solve(M, np.column_stack([W, f_j]))  # M^-1 [W, f_j]
        KY = W.T @ Y
        K, r = KY[:, :-1], c - KY[:, -1]
        Z = np.linalg.solve(K, np.column_stack([W_o.T, r]))  # K^-1 [W_o^T, r]
        A += W_o @ Z[:, :6]
        b += W_o @ Z[:, 6]
        arms.append((Y, Z))
    a_o = np.linalg.solve(A, b)
    force = [Z[:, 6] - Z[:, :6] @ a_o for _, Z in arms]
    q = [Y[:, -1] + Y[:, :-1] @ f for (Y, _), f in zip(arms, force, strict=True)]
    return Solution(a_o, np.array(q), np.array(force))


def lilly_orin(s: Coefficients) -> Solution:
    """Thesis (4.1) - (4.6): operational space, orthonormal constraint directions.

    The tips' accelerations are taken without their drift, which is in ``c``.
    """
    A, b = s.M_o.copy(), s.f_o.copy()
    arms = []
    for M, f_j, c, J, wrench, G in zip(s.M, s.f_j, s.c, s.J, s.wrench, s.G, strict=True):
        W_hat, triangle = np.linalg.qr(wrench)  # W_hat^T W_hat = 1
        a_c = -np.linalg.solve(triangle.T, c)  # constrained relative acceleration
        L = np.linalg.cholesky(M)
        X = np.linalg.solve(L, np.column_stack([J.T, f_j]))
        inverse = X[:, :6].T @ X  # [inverse operational space inertia, free acceleration]
        across = W_hat.T @ inverse[:, :6] @ W_hat
        P = np.linalg.solve(across, a_c - W_hat.T @ inverse[:, 6])
        B = np.linalg.solve(across, W_hat.T @ G)
        A += G.T @ W_hat @ B
        b -= G.T @ W_hat @ P
        arms.append((M, f_j, J, wrench, W_hat, P, B))
    a_o = np.linalg.solve(A, b)
    q, force = [], []
    for M, f_j, J, wrench, W_hat, P, B in arms:
        f_m = W_hat @ (P + B @ a_o)  # wrench on the arm
        q.append(np.linalg.solve(M, f_j + J.T @ f_m))
        force.append(-np.linalg.lstsq(wrench, f_m, rcond=None)[0])
    return Solution(a_o, np.array(q), np.array(force))


def mcmillan(s: Coefficients, together: int | None = None) -> Solution:
    """Thesis (4.7), (4.8): the forces of the first arms, by default of half, are solved together.

    With ``S`` the object's inertia and the other arms' share, ``F_ij = W_oi^T S^-1 W_oj + delta_ij
    K_i``; an arm whose ``K`` is singular is no obstacle as long as ``F`` is regular.  With no arm
    solved together it is the node algorithm over all arms at once, in NumPy's stacked operations.
    """
    (n, _, N), split = s.W.shape, len(s.W) // 2 if together is None else together
    Y = np.linalg.solve(s.M, np.concatenate([s.W, s.f_j[:, :, None]], axis=2))  # (n, d, N + 1)
    KY = s.W.transpose(0, 2, 1) @ Y
    K, r = KY[:, :, :-1], s.c - KY[:, :, -1]  # K f + W_o^T a_o = r
    W_o, right = s.W_o[split:], s.W_o[split:].transpose(0, 2, 1)
    Z = np.linalg.solve(K[split:], np.concatenate([right, r[split:, :, None]], axis=2))
    shares = np.sum(W_o @ Z, axis=0)  # (6, 7)
    S, b = s.M_o + shares[:, :6], s.f_o + shares[:, 6]
    force = np.empty((n, N))
    if split:
        C = np.concatenate(s.W_o[:split], axis=1)  # (6, split N)
        F = C.T @ np.linalg.solve(S, C) + block_diag(*K[:split])
        forces = np.linalg.solve(F, r[:split].ravel() - C.T @ np.linalg.solve(S, b))
        force[:split] = forces.reshape(split, N)
        b = b + C @ forces
    a_o = np.linalg.solve(S, b)
    force[split:] = Z[:, :, 6] - Z[:, :, :6] @ a_o
    q = Y[:, :, -1] + (Y[:, :, :-1] @ force[:, :, None])[:, :, 0]
    return Solution(a_o, q, force)


def assemble(s: Coefficients) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right-hand side of thesis (4.9), unknowns ``a_o, q, mu = -lambda``; symmetric."""
    n, d, N = s.W.shape
    size = 6 + n * d
    matrix = np.zeros((size + n * N, size + n * N), order="F")
    matrix[:6, :6] = s.M_o
    for i in range(n):
        joints = slice(6 + i * d, 6 + (i + 1) * d)
        contacts = slice(size + i * N, size + (i + 1) * N)
        matrix[joints, joints] = s.M[i]
        matrix[joints, contacts], matrix[contacts, joints] = s.W[i], s.W[i].T
        matrix[:6, contacts], matrix[contacts, :6] = s.W_o[i], s.W_o[i].T
    return matrix, np.concatenate([s.f_o, s.f_j.ravel(), s.c.ravel()])


def solve_lu(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """LU with partial pivoting (LAPACK's ``dgesv``)."""
    x, info = lapack.dgesv(matrix, right)[2:]
    return _accepted(x, info)


def solve_ldl(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Symmetric indefinite factorisation (LAPACK's ``dsysv``), in blocks of 64 columns."""
    x, info = lapack.dsysv(matrix, right, lwork=64 * len(right), lower=1)[2:]
    return _accepted(x, info)


def unpack(x: np.ndarray, s: Coefficients) -> Solution:
    """Unknowns of :func:`assemble`'s matrix by name."""
    n, d, N = s.W.shape
    size = 6 + n * d
    return Solution(x[:6], x[6:size].reshape(n, d), -x[size:].reshape(n, N))


def _accepted(x: np.ndarray, info: int) -> np.ndarray:
    if info != 0:
        raise SolverError("the matrix of the study is singular: an arm is in a singular posture")
    return x
