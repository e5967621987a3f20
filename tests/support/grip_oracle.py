"""Impacts without restitution from textbook equations, in decimals of 50 digits.

Inertias and Jacobians of robots are Pinocchio's (``crba``, ``getFrameJacobian``), those of objects
are Newton's and Euler's; a joint asks that two frames move alike.  Velocities are the twists of the
objects (of the centre of mass, world axes), then the rates of the robots.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from matrix_systems import exactly, solve_exactly
from scipy.linalg import block_diag
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

import multiarm as ma

DIGITS = 50
# Rows whose part beyond the others is smaller than this in the metric of the inertia depend on
# them: entries are rounded to 1e-16, of which the square is taken.
DEPENDENT = Decimal("1e-24")


@dataclass(frozen=True)
class Momentum:
    """A system at a state: its inertia and velocity, and where its bodies are.

    Attributes
    ----------
    M : ndarray, shape (n, n)
    v : ndarray, shape (n,)
    """

    system: ma.System
    state: ma.State
    M: np.ndarray
    v: np.ndarray

    @classmethod
    def of(cls, system: ma.System, state: ma.State) -> Momentum:
        blocks, v = [], []
        for name, body in system.scene.all_objects.items():
            motion = state.objects[name]
            R = Rotation.from_quat(motion.quaternion_xyzw).as_matrix()
            blocks += [body.mass * np.eye(3), R @ body.inertia_matrix() @ R.T]
            v.append(motion.twist)
        for name, robot in system.arms.items():
            model, data = robot.model, robot.model.createData()
            q = robot.configuration(state.joint_positions[name])
            upper = np.triu(pin.crba(model, data, q))
            blocks.append(upper + np.triu(upper, 1).T)
            v.append(state.joint_velocities[name])
        return cls(system, state, block_diag(*blocks), np.concatenate(v))

    def jacobian(self, body: str, point: np.ndarray) -> np.ndarray:
        """Twist of a point of a body for velocities, shape (6, n): object, arm (its tip), world."""
        J, first = np.zeros((6, self.v.size)), 0
        for name in self.system.scene.all_objects:
            if name == body:
                lever = point - self.state.objects[name].position
                J[:, first : first + 6] = np.eye(6)
                J[:3, first + 3 : first + 6] = -pin.skew(lever)
            first += 6
        for name, robot in self.system.arms.items():
            if name == body:
                model, data = robot.model, robot.model.createData()
                q = robot.configuration(self.state.joint_positions[name])
                frame = robot.tip.frame_id
                pin.computeJointJacobians(model, data, q)
                pin.updateFramePlacements(model, data)
                local = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                J[:, first : first + robot.dof] = local
                lever = point - data.oMf[frame].translation
                J[:3, first : first + robot.dof] -= pin.skew(lever) @ local[3:]
            first += robot.dof
        return J

    def tip(self, arm: str) -> np.ndarray:
        """Origin of an arm's tip [m]."""
        robot = self.system.arms[arm]
        data = robot.model.createData()
        pin.framesForwardKinematics(
            robot.model, data, robot.configuration(self.state.joint_positions[arm])
        )
        return data.oMf[robot.tip.frame_id].translation.copy()

    def closed(self, first: str, second: str, point: np.ndarray, turns=()) -> np.ndarray:
        """Rows of a joint at a point: how the second body moves against the first one.

        ``turns``: axes about which it may turn; three of them for a ball.
        """
        rows = self.jacobian(second, point) - self.jacobian(first, point)
        if not len(turns):
            return rows
        kept = np.linalg.svd(np.array(turns))[2][len(turns) :]
        return np.vstack([rows[:3], kept @ rows[3:]])

    @property
    def energy(self) -> float:
        """Kinetic energy [J]."""
        return 0.5 * float(self.v @ self.M @ self.v)


class ExactImpact(NamedTuple):
    """The velocities after an impact, impulses of the rows and the energy that is lost [J].

    Impulses of rows that depend on others are zero.
    """

    velocity: np.ndarray
    impulses: np.ndarray
    energy_lost: float


def stop_rates(momentum: Momentum, rows: np.ndarray) -> ExactImpact:
    """``M (v+ - v) = W p`` and ``W^T v+ = 0``, with ``rows`` the matrix ``W^T``."""
    with localcontext() as context:
        context.prec = DIGITS
        M, W, v = exactly(momentum.M), exactly(rows.T), exactly(momentum.v)
        moved = solve_exactly(M, W)
        F = W.T @ moved
        kept = independent(F)
        p = np.array([Decimal(0)] * len(F), dtype=object)
        p[kept] = -solve_exactly(F[np.ix_(kept, kept)], (W.T @ v)[kept][:, None])[:, 0]
        after = v + moved @ p
        lost = (v @ M @ v - after @ M @ after) / 2
        return ExactImpact(after.astype(float), p.astype(float), float(lost))


def independent(F: np.ndarray) -> list[int]:
    """Columns of a positive semidefinite matrix on which the others depend (pivoted Cholesky)."""
    F, order, left = F.copy(), [], list(range(len(F)))
    sizes = [F[k, k] for k in left]
    while left:
        best = max(left, key=lambda k: F[k, k] / sizes[k] if sizes[k] else Decimal(0))
        if not F[best, best] > DEPENDENT * sizes[best]:
            break
        left.remove(best)
        order.append(best)
        F -= np.outer(F[:, best], F[best]) / F[best, best]
    return order


def stop_approach(momentum: Momentum, rows: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Velocities nearest to those before with ``W^T v = 0`` and rates of the normals >= 0.

    In the metric of the inertia (J.J. Moreau); by trying all sets of normals that push.
    """
    L = np.linalg.cholesky(momentum.M)
    best, nearest = momentum.v, np.inf
    for number in range(2 ** len(normals)):
        pushing = [bool(number >> k & 1) for k in range(len(normals))]
        A = np.linalg.solve(L, np.vstack([rows, normals[pushing]]).T)
        w = L.T @ momentum.v
        v = np.linalg.solve(L.T, w - A @ np.linalg.lstsq(A, w, rcond=1e-12)[0])
        distance = float(np.linalg.norm(L.T @ (v - momentum.v)))
        if np.all(normals @ v >= -1e-10) and distance < nearest:
            best, nearest = v, distance
    return best


def unexplained(
    change: np.ndarray,
    after: np.ndarray,
    rows: np.ndarray,
    normals: np.ndarray,
    tangents: np.ndarray,
    mu: float,
) -> float:
    """Part of a momentum's change (n,) that no impulses of joints and contacts explain.

    Contacts that are closed after the impact push within their cones, those that slip on the edge
    against the slip.  ``tangents`` (k, 2, n) belong to ``normals`` (k, n).
    """
    forces = [rows.T, -rows.T]
    for normal, pair in zip(normals, tangents, strict=True):
        slip = pair @ after
        speed = float(np.linalg.norm(slip))
        if normal @ after > 1e-9:
            continue
        angles = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        if speed > 1e-9:
            directions = -slip[None] / speed
        forces.append((normal + mu * directions @ pair).T)
    matrix = np.hstack(forces)
    sizes = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, sizes > 0.0] / sizes[sizes > 0.0]
    return nnls(matrix, change, maxiter=100 * matrix.shape[1])[1] / float(np.linalg.norm(change))
