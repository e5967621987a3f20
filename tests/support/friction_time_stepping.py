r"""An independent time stepping of scenes with contacts and dry friction (Moreau, Jean).

With the velocities :math:`v` at the start of a step and :math:`v^+` at its end,

.. math::
    M (v^+ - v) = h f(q, v) + J^T p, \qquad q^+ = q \oplus h v^+,

the impulses :math:`p` obey the laws of contact with :math:`u = J v^+` at the contacts whose gaps
would be closed in the middle of the step: :math:`0 \le p_n \perp u_n + e u_n^- \ge 0`,
:math:`p_t \in \mu p_n \mathbb{D}` against :math:`u_t`; of dry joints :math:`|p| \le h c` against
the rate.  They are found by projected Gauss-Seidel iterations, the disk exact.  Welds, balls and
hinges are bilateral.  The error is of first order in the step.  Where restitution together with
friction would add energy, it is halved until it does not (J. J. Moreau, Unilateral contact and
dry friction in finite freedom dynamics, 1988; M. Jean, The non-smooth contact dynamics method,
1999).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from friction_oracle import Body, Oracle, State, skew
from scipy.spatial.transform import Rotation

SOLVED = 1e-10
"""Change of the scaled impulses in a sweep, of the largest, with which iterations end."""
SWEEPS = 20000
# Work of the impulses of an impact that counts as none, as a part of all of it.
ADDED = 1e-3
# Rate of a gap of contacts that rest [m/s].
RESTS = 1e-9
# Part of a bilateral joint's gap that a step closes.
CLOSED = 0.1
# Rows of a joint in the tip's axes: three translations, three rotations.
BILATERAL = {"weld": (0, 1, 2, 3, 4, 5), "ball": (0, 1, 2), "revolute": (0, 1, 2, 3, 4)}


class Stepped(NamedTuple):
    """The end of a run."""

    state: State
    residual: float  # largest change of the last sweep of any step
    sweeps: int  # of all steps


@numba.njit(cache=True)
def _rate(D, b, impulse, row):  # pragma: no cover
    total = b[row]
    for column in range(impulse.size):
        total += D[row, column] * impulse[column]
    return total


@numba.njit(cache=True)
def solve_impulses(D, b, mu, p, bounds, x, tolerance, most):  # pragma: no cover
    """Projected Gauss-Seidel from ``p`` and ``x``; the last change and the sweeps.

    D, b : (3 N + B,) rows of N contacts, normal first, then of B bounded impulses ``x``
    """
    contacts, change, largest = mu.size, 0.0, 0.0
    impulse = np.concatenate((p, x))
    sweeps = 0
    while sweeps < most:
        sweeps += 1
        change, largest = 0.0, 0.0
        for k in range(contacts):
            n = 3 * k
            u = _rate(D, b, impulse, n)
            new = max(0.0, impulse[n] - u / D[n, n])
            change = max(change, abs(new - impulse[n]))
            impulse[n] = new
            largest = max(largest, new)
            radius = mu[k] * new
            # the largest eigenvalue of the block of the tangents
            half = 0.5 * (D[n + 1, n + 1] - D[n + 2, n + 2])
            size = 0.5 * (D[n + 1, n + 1] + D[n + 2, n + 2])
            size += math.sqrt(half * half + D[n + 1, n + 2] ** 2)
            first = impulse[n + 1] - _rate(D, b, impulse, n + 1) / size
            second = impulse[n + 2] - _rate(D, b, impulse, n + 2) / size
            length = math.sqrt(first * first + second * second)
            if length > radius:
                first, second = first * radius / length, second * radius / length
            change = max(change, abs(first - impulse[n + 1]), abs(second - impulse[n + 2]))
            impulse[n + 1], impulse[n + 2] = first, second
        for j in range(bounds.size):
            row = 3 * contacts + j
            new = impulse[row] - _rate(D, b, impulse, row) / D[row, row]
            new = min(bounds[j], max(-bounds[j], new))
            change = max(change, abs(new - impulse[row]))
            largest = max(largest, abs(new))
            impulse[row] = new
        if change <= tolerance * largest:
            break
    p[:], x[:] = impulse[: 3 * contacts], impulse[3 * contacts :]
    return change / max(largest, 1e-300), sweeps


class _Bilateral(NamedTuple):
    """A joint that is closed at the start and stays so."""

    tip: str
    body: str
    rows: tuple[int, ...]
    place: np.ndarray  # the tip's frame in the body
    turn: np.ndarray


def _bilateral_joints(oracle: Oracle, bodies: dict[str, Body]) -> list[_Bilateral]:
    found = []
    for joint in oracle.table["joints"]:
        if joint["kind"] == "contacts":
            continue
        assert set(joint) <= {"arm", "kind", "object"}, "frames of joints are those of the tips"
        name = joint.get("object", next(iter(oracle.objects)))
        tip, body = bodies[joint["arm"]], bodies[name]
        found.append(_Bilateral(
            joint["arm"], name, BILATERAL[joint["kind"]],
            body.rotation.T @ (tip.origin - body.origin), body.rotation.T @ tip.rotation,
        ))  # fmt: skip
    return found


def _bilateral_rows(joint: _Bilateral, bodies: dict[str, Body]) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian and gaps of a joint."""
    tip, body = bodies[joint.tip], bodies[joint.body]
    r = body.rotation @ joint.place
    axes = tip.rotation.T
    gap = np.concatenate([
        axes @ (tip.origin - body.origin - r),
        Rotation.from_matrix((body.rotation @ joint.turn).T @ tip.rotation).as_rotvec(),
    ])  # fmt: skip
    J = np.vstack([
        axes @ (tip.jacobian[:3] - body.jacobian[:3] + skew(r) @ body.jacobian[3:]),
        axes @ (tip.jacobian[3:] - body.jacobian[3:]),
    ])  # fmt: skip
    rows = list(joint.rows)
    return J[rows], gap[rows]


def _moved(oracle: Oracle, state: State, v: np.ndarray, h: float) -> State:
    """The state after a time ``h`` with the velocities ``v``."""
    count = len(oracle.objects)
    twists = v[: 6 * count].reshape(count, 6)
    turns = Rotation.from_rotvec(h * twists[:, 3:]).as_matrix()
    joints = [q + h * v[arm.columns] for arm, q in zip(oracle.arms, state.joints, strict=True)]
    return State(state.positions + h * twists[:, :3], turns @ state.rotations, joints, v)


class _Problem(NamedTuple):
    """The impulses of a step: rows of contacts, normal first, then of bounded impulses."""

    D: np.ndarray
    free: np.ndarray  # rates without impulses
    before: np.ndarray  # rates
    mu: np.ndarray
    restitution: np.ndarray
    bounds: np.ndarray

    def solve(self, p: np.ndarray, x: np.ndarray) -> tuple[float, int]:
        """The impulses into ``p`` and ``x``; the last change and the sweeps.

        Restitution is halved until impacts add no energy.
        """
        normals, sweeps = slice(0, p.size, 3), 0
        hits = self.restitution * np.minimum(self.before[normals], 0.0)
        while True:
            b = self.free.copy()
            b[normals] += hits
            change, count = solve_impulses(self.D, b, self.mu, p, self.bounds, x, SOLVED, SWEEPS)
            sweeps += count
            impulse = np.concatenate([p, x])
            after = self.free + self.D @ impulse
            work = impulse[: p.size] * (self.before + after)[: p.size]
            # loads between impacts add a little of their own
            if np.sum(work) <= ADDED * np.sum(np.abs(work)) or not np.any(hits):
                return change, sweeps
            hits = np.where(np.abs(hits) > RESTS, 0.5 * hits, 0.0)


class _Contacts:
    """Contacts of a scene in arrays: gaps of all, Jacobians of some."""

    def __init__(self, oracle: Oracle) -> None:
        self.all = oracle.contacts
        self.names = list(dict.fromkeys(n for c in self.all for n in (c.body, c.base)))
        self.body = np.array([self.names.index(c.body) for c in self.all], dtype=int)
        self.base = np.array([self.names.index(c.base) for c in self.all], dtype=int)
        self.point = np.array([c.point for c in self.all], dtype=float).reshape(-1, 3)
        self.place = np.array([c.place for c in self.all], dtype=float).reshape(-1, 3)
        self.frame = np.array([c.frame for c in self.all]).reshape(-1, 3, 3)
        self.radius = np.array([c.radius for c in self.all])
        self.mu = np.array([c.mu or 0.0 for c in self.all])
        self.restitution = np.array([c.restitution for c in self.all])

    def place_all(self, bodies: dict[str, Body]) -> np.ndarray:
        """Gaps of all contacts; keeps what the rows need."""
        if not self.all:
            return np.zeros(0)
        R = np.array([bodies[name].rotation for name in self.names])
        x = np.array([bodies[name].origin for name in self.names])
        self._J = np.array([bodies[name].jacobian for name in self.names])
        axes = self.frame @ np.swapaxes(R[self.base], 1, 2)
        to_centre = np.einsum("kij,kj->ki", R[self.body], self.point)
        n = axes[:, 0]
        centre = x[self.body] + to_centre
        from_base = centre - x[self.base]
        plane = np.einsum("kij,kj->ki", R[self.base], self.place)
        self._axes = axes
        self._r_A = to_centre - self.radius[:, None] * n
        self._r_B = from_base - self.radius[:, None] * n
        return np.einsum("ki,ki->k", n, from_base - plane) - self.radius

    def jacobians(self) -> np.ndarray:
        """Rows of all contacts, (N, 3, nv)."""
        axes = self._axes

        def rows(body: np.ndarray, r: np.ndarray) -> np.ndarray:
            J = self._J[body]
            return axes @ (J[:, :3] - skew(r) @ J[:, 3:])

        return rows(self.body, self._r_A) - rows(self.base, self._r_B)


def _closed(
    contacts: _Contacts, bodies: dict[str, Body], v: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which contacts are closed in the middle of the step, and their rows."""
    gap = contacts.place_all(bodies)
    if not gap.size:
        return np.zeros(0, dtype=bool), np.zeros((0, v.size))
    J = contacts.jacobians()
    closed = gap + 0.5 * h * (J[:, 0] @ v) <= 0.0
    return closed, J[closed].reshape(-1, v.size)


def _dry_friction(oracle: Oracle) -> tuple[np.ndarray, np.ndarray]:
    """Columns of the joints with dry friction, and their largest torques."""
    friction = oracle.table["effects"].get("joint_friction")
    if friction is None:
        return np.zeros(0, dtype=int), np.zeros(0)
    torque = np.zeros(oracle.nv)
    for arm in oracle.arms:
        torque[arm.columns] = friction["torque"][arm.name]
    columns = np.flatnonzero(torque)
    return columns, torque[columns]


def step_through(oracle: Oracle, duration: float, h: float = 1e-5) -> Stepped:
    """Step from the start of a scene, under its control."""
    contacts = _Contacts(oracle)
    dry, torque = _dry_friction(oracle)
    state = oracle.start()
    joints = _bilateral_joints(oracle, oracle.mechanism(0.0, state).bodies)
    p, x = np.zeros((len(contacts.all), 3)), np.zeros(dry.size)
    residual, sweeps = 0.0, 0
    for k in range(round(duration / h)):
        t, v = k * h, state.velocity
        mechanism = oracle.mechanism(t, state)
        inverse, bodies = mechanism.inverse_inertia, mechanism.bodies
        free = v + h * (inverse @ (mechanism.force + oracle.drives(t, state, bodies)))
        if joints:
            rows, gaps = zip(*(_bilateral_rows(j, bodies) for j in joints), strict=True)
            J, gap = np.vstack(rows), np.concatenate(gaps)
            to_rows = inverse @ J.T
            K = J @ to_rows
            free -= to_rows @ np.linalg.solve(K, J @ free + CLOSED / h * gap)
            inverse = inverse - to_rows @ np.linalg.solve(K, to_rows.T)
        closed, J = _closed(contacts, bodies, v, h)
        p[~closed] = 0.0
        new = free
        if np.any(closed) or dry.size:
            J = np.vstack([J, np.eye(oracle.nv)[dry]])
            to_v = inverse @ J.T
            problem = _Problem(
                J @ to_v, J @ free, J @ v, contacts.mu[closed], contacts.restitution[closed],
                h * torque,
            )  # fmt: skip
            part = p[closed].ravel()
            change, count = problem.solve(part, x)
            p[closed] = part.reshape(-1, 3)
            residual, sweeps = max(residual, change), sweeps + count
            new = free + to_v @ np.concatenate([part, x])
        state = _moved(oracle, state, new, h)
    return Stepped(state, residual, sweeps)
