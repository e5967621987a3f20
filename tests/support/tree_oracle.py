r"""Forward dynamics of scenes whose robots are trees, by dense algebra, in two ways.

*Minimal coordinates.*  Pinocchio's inertia, bias and frame Jacobians of each robot and of each
object as a free body; the equations of the joints as rows ``A``.

*Maximal coordinates.*  Every link is a free body under Newton's and Euler's laws; the joints of the
robots are equations too, and the rates of the joints are coordinates without inertia, on which
drives and mimic couplings act.  Of Pinocchio this uses where the links are and how they move only.

Both solve

.. math:: M a - A^T \lambda = f, \qquad A a = -\gamma

with the multipliers of least norm among connections, mimic couplings and wheels.  The origin of a
base on wheels has no velocity along the base's y axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from joint_equations import Equation, FrameMotion, displacement, joint_equations, skew
from scipy.linalg import block_diag
from tree_models import WORLD, BodyFrame, Mimic, TreeScene, TreeState, joint_motion, only

# Singular values of `A` below this part of the largest count as zero.
RANK_TOLERANCE = 1e-7
# Part of a wrench that internal forces may change where it counts as determined.
UNIQUE_TOLERANCE = 1e-7


@dataclass(frozen=True)
class TreeSolution:
    """Accelerations and wrenches of a scene.

    Attributes
    ----------
    object_accelerations : dict object -> ndarray, shape (6,)
        Of the centre of mass (classical), and angular acceleration, world axes.
    joint_accelerations : dict robot -> ndarray, shape (n,)
    base_accelerations : dict robot -> ndarray, shape (6,)
        As those of objects, of the origin of a floating base.
    wrenches : dict connection -> ndarray, shape (6,)
        On the SECOND body, about the origin of the joint frame on SECOND, world axes.
    origins : dict connection -> ndarray, shape (3,)
        Those origins.
    unique : dict connection -> bool
        Whether the equations determine the wrench.
    mimic_torques : dict (robot, follower) -> float
        Torque of a mimic coupling on its follower.
    wheel_forces : dict robot -> float
        On the base along its y axis; those that the equations determine.
    rank, rows : int
        Independent equations of connections, mimic couplings and wheels, and all of them.
    """

    object_accelerations: dict[str, np.ndarray]
    joint_accelerations: dict[str, np.ndarray]
    base_accelerations: dict[str, np.ndarray]
    wrenches: dict[str, np.ndarray]
    origins: dict[str, np.ndarray]
    unique: dict[str, bool]
    mimic_torques: dict[tuple[str, str], float]
    wheel_forces: dict[str, float]
    rank: int
    rows: int

    @property
    def object_acceleration(self) -> np.ndarray:
        """Of the only object."""
        return only(self.object_accelerations)

    def wrench(self, connection: str, about: np.ndarray) -> np.ndarray:
        """The wrench on SECOND about another point."""
        force, moment = np.split(self.wrenches[connection], 2)
        return np.concatenate([force, moment + np.cross(self.origins[connection] - about, force)])


def disagreement(solution: TreeSolution, peer: TreeSolution) -> float:
    """Largest difference of accelerations and of determined wrenches, by the largest of each."""
    pairs = _accelerations(solution, peer)
    wrenches = [
        (wrench, peer.wrench(name, solution.origins[name]))
        for name, wrench in solution.wrenches.items()
        if solution.unique[name]
    ]
    return max(_relative_difference(pairs), _relative_difference(wrenches))


def _accelerations(solution: TreeSolution, peer: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of accelerations of a solution and of another or an ``ma.Evaluation``."""
    kinds = ("object_accelerations", "joint_accelerations", "base_accelerations")
    return [
        (acceleration, getattr(peer, kind)[name])
        for kind in kinds
        for name, acceleration in getattr(solution, kind).items()
    ]


def centres_of_seconds(trees: TreeScene, state: TreeState) -> dict[str, np.ndarray]:
    """Centres (3,) of the objects on which connections act, by the connection."""
    return {
        connection.name: state.objects[connection.second.body]["position"]
        for connection in trees.connections
        if connection.second.body in trees.objects
    }


def evaluation_errors(
    solution: TreeSolution, evaluation: Any, about: dict[str, np.ndarray]
) -> float:
    """Largest error of an ``ma.Evaluation``, as :func:`disagreement` measures it, and of wheels.

    Its wrenches act on SECOND, about a point ``about`` (3,) [m] of the connection; about the origin
    of the joint's frame on SECOND where there is none.
    """
    pairs = _accelerations(solution, evaluation)
    wrenches = [
        (
            solution.wrench(name, about.get(name, solution.origins[name])),
            evaluation.wrenches[name],
        )
        for name, unique in solution.unique.items()
        if unique
    ]
    for name, force in solution.wheel_forces.items():
        wrenches.append((np.array([force]), evaluation.contact_forces[name][-1:]))
    return max(_relative_difference(pairs), _relative_difference(wrenches))


def _relative_difference(pairs: list[tuple[np.ndarray, np.ndarray]]) -> float:
    if not pairs:
        return 0.0
    left, right = (np.concatenate(part) for part in zip(*pairs, strict=True))
    return float(np.max(np.abs(left - right), initial=0.0) / max(np.max(np.abs(left)), 1.0))


class Couplings(NamedTuple):
    """Rows of all connections, then of mimic couplings, then of wheels.

    A : (m, n), by generalised velocities; gamma : (m,), second derivatives at zero accelerations
    on_second : dict connection -> (6, rows), wrench on SECOND by multipliers
    origins : dict connection -> (3,)
    rows : dict connection -> slice
    values : (m,), of the equations themselves
    """

    A: np.ndarray
    gamma: np.ndarray
    on_second: dict[str, np.ndarray]
    origins: dict[str, np.ndarray]
    rows: dict[str, slice]
    values: np.ndarray


class Equations(NamedTuple):
    """M a - A^T lambda = f, A a = -gamma; ``internal`` rows hold the robots' links together."""

    M: np.ndarray
    f: np.ndarray
    internal: np.ndarray
    internal_gamma: np.ndarray
    couplings: Couplings


class Coordinates(NamedTuple):
    """Where the coordinates of each body, and the rates of each robot's joints, are."""

    bodies: dict[str, slice]
    rates: dict[str, slice]
    size: int


# --- solutions -----------------------------------------------------------------------------------


def solve_minimal(
    trees: TreeScene, state: TreeState, torques: dict[str, np.ndarray]
) -> TreeSolution:
    """In joint coordinates, from Pinocchio's inertias and Jacobians."""
    motions = Motions(trees, state)
    blocks = [motions.models[name] for name in motions.names]
    M, f = block_diag(*[block.inertia for block in blocks]), [-block.bias for block in blocks]
    for k, name in enumerate(motions.names):
        if name in torques:
            f[k][f[k].size - torques[name].size :] += torques[name]
    n = motions.coordinates.size
    couplings = collect(trees, motions.frame, n, motions.coordinates.rates)
    equations = Equations(M, np.concatenate(f), np.zeros((0, n)), np.zeros(0), couplings)
    a, multipliers, loose = solve_equations(equations)
    free = {name: motions.frame(on_body) for name, on_body in free_frames(trees).items()}
    accelerations = {name: frame.jacobian @ a + frame.bias for name, frame in free.items()}
    rates = {name: a[motions.coordinates.rates[name]] for name in trees.robots}
    return _solution(trees, accelerations, rates, couplings, multipliers, loose)


def solve_maximal(
    trees: TreeScene, state: TreeState, torques: dict[str, np.ndarray]
) -> TreeSolution:
    """With every link a free body, and every joint an equation."""
    links = Links(trees, state)
    n = links.coordinates.size
    M, f = np.zeros((n, n)), np.zeros(n)
    for (name, i), place in links.places.items():
        M[place, place], f[place] = newton_euler(
            links.inertia(name, i), links.motion(name, i), trees.gravity
        )
    for name, row in torques.items():
        f[links.coordinates.rates[name]] = row
    internal = [links.joint_rows(name, i) for name, i in links.places]
    rows, gamma = (np.concatenate(part) for part in zip(*internal, strict=True))
    couplings = collect(trees, links.frame, n, links.coordinates.rates)
    a, multipliers, loose = solve_equations(Equations(M, f, rows, gamma, couplings))
    rates = {name: a[links.coordinates.rates[name]] for name in trees.robots}
    accelerations = {name: a[links.places[name, 1]] for name in free_frames(trees)}
    return _solution(trees, accelerations, rates, couplings, multipliers, loose)


def free_frames(trees: TreeScene) -> dict[str, BodyFrame]:
    """The frames of objects and of floating bases, by the body."""
    floating = [name for name, robot in trees.robots.items() if robot.floats]
    return {name: BodyFrame(name, 1, pin.SE3.Identity()) for name in (*trees.objects, *floating)}


def _solution(trees, accelerations, rates, couplings, multipliers, loose) -> TreeSolution:
    objects = {name: accelerations[name] for name in trees.objects}
    bases = {name: a for name, a in accelerations.items() if name not in objects}
    wrenches, unique = {}, {}
    for name, rows in couplings.rows.items():
        wrenches[name] = couplings.on_second[name] @ multipliers[rows]
        change = np.linalg.norm(couplings.on_second[name] @ loose[rows])
        unique[name] = bool(change < UNIQUE_TOLERANCE)
    mimics = [(name, mimic.joint) for name, mimic in mimics_of(trees)]
    wheels = [name for name, robot in trees.robots.items() if robot.wheels is not None]
    first_wheel = multipliers.size - len(wheels)
    first = first_wheel - len(mimics)
    determined = np.linalg.norm(loose[first_wheel:], axis=1) < UNIQUE_TOLERANCE
    wheel_forces = {
        name: float(force)
        for name, force, unique in zip(wheels, multipliers[first_wheel:], determined, strict=True)
        if unique
    }
    return TreeSolution(
        objects, rates, bases, wrenches, couplings.origins, unique,
        dict(zip(mimics, multipliers[first:first_wheel].tolist(), strict=True)), wheel_forces,
        multipliers.size - loose.shape[1], multipliers.size,
    )  # fmt: skip


def solve_equations(equations: Equations) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Accelerations, multipliers of the couplings of least norm, and what may be added to them.

    Accelerations follow in the null space of all rows, multipliers from the balance that is left.

    Returns
    -------
    a : ndarray, shape (n,)
    multipliers : ndarray, shape (m,)
    loose : ndarray, shape (m, k)
        Orthonormal multipliers that balance each other.
    """
    M, f, internal, internal_gamma, couplings = equations
    A = np.vstack([internal, couplings.A])
    gamma = np.concatenate([internal_gamma, couplings.gamma])
    U, values, Vt = np.linalg.svd(A)
    rank = int(np.sum(values > RANK_TOLERANCE * max(np.max(values, initial=0.0), 1.0)))
    N, row_space = Vt[rank:].T, Vt[:rank].T
    a = -row_space @ ((U[:, :rank].T @ gamma) / values[:rank])
    a = a + N @ np.linalg.solve(N.T @ M @ N, N.T @ (f - M @ a))
    every = U[:, :rank] @ ((row_space.T @ (M @ a - f)) / values[:rank])
    left = U[len(internal) :, rank:]  # multipliers of couplings that balance each other
    multipliers = every[len(internal) :]
    loose = np.linalg.qr(left)[0] if left.size else left
    return a, multipliers - loose @ (loose.T @ multipliers), loose


def worst_gap(trees: TreeScene, state: TreeState) -> float:
    """Largest value of an equation of the connections and mimic couplings [m, or a cosine]."""
    motions = Motions(trees, state)
    couplings = collect(trees, motions.frame, motions.coordinates.size, motions.coordinates.rates)
    gaps = [
        positions[joints.index(mimic.joint)]
        - mimic.multiplier * positions[joints.index(mimic.leader)]
        - mimic.offset
        for name, mimic in mimics_of(trees)
        for positions, joints in [(state.joint_positions[name], trees.robots[name].joints)]
    ]
    return float(np.max(np.abs([*couplings.values, *gaps]), initial=0.0))


def least_change(trees: TreeScene, state: TreeState) -> TreeState:
    """The state with the nearest velocities that keep connections and mimic couplings."""
    motions = Motions(trees, state)
    n, rates = motions.coordinates.size, motions.coordinates.rates
    A = collect(trees, motions.frame, n, rates).A
    v = np.concatenate([motions.models[name].velocity for name in motions.names])
    v = v - np.linalg.pinv(A, rcond=RANK_TOLERANCE) @ (A @ v)
    free = {name: motions.frame(on_body) for name, on_body in free_frames(trees).items()}
    objects, bases = (
        {name: {**frame, "twist": free[name].jacobian @ v} for name, frame in frames.items()}
        for frames in (state.objects, state.bases)
    )
    velocities = {name: v[rates[name]] for name in trees.robots}
    return TreeState(objects, state.joint_positions, velocities, bases)


# --- rows of connections -------------------------------------------------------------------------


def mimics_of(trees: TreeScene) -> list[tuple[str, Mimic]]:
    return [(name, mimic) for name, robot in trees.robots.items() for mimic in robot.mimics]


def collect(trees: TreeScene, frame, n: int, rates: dict[str, slice]) -> Couplings:
    """Rows of connections, mimic couplings, wheels; ``frame`` gives the motion of a BodyFrame."""
    A, gamma, values, on_second, origins, rows = [], [], [], {}, {}, {}
    for connection in trees.connections:
        first, second = frame(connection.first), frame(connection.second)
        equations = joint_equations(connection.joint, first, second)
        rows[connection.name] = slice(len(A), len(A) + len(equations))
        origins[connection.name] = second.origin
        on_second[connection.name] = np.array([e.by_second for e in equations]).T
        for equation in equations:
            row, bias = row_of(equation, first, second)
            A.append(row)
            gamma.append(bias)
            values.append(equation.value)
    for name, mimic in mimics_of(trees):
        row, joints = np.zeros(n), trees.robots[name].joints
        at = np.arange(n)[rates[name]]
        row[at[joints.index(mimic.joint)]] += 1.0
        row[at[joints.index(mimic.leader)]] -= mimic.multiplier
        A.append(row)
        gamma.append(0.0)
    for robot in trees.robots.values():
        if robot.wheels is not None:
            base = frame(robot.wheels)
            sideways, (velocity, spin) = base.rotation[:, 1], np.split(base.twist, 2)
            A.append(sideways @ base.jacobian[:3])
            gamma.append(sideways @ base.bias[:3] + np.cross(spin, sideways) @ velocity)
    return Couplings(
        np.array(A).reshape(-1, n), np.array(gamma), on_second, origins, rows, np.array(values)
    )


def row_of(equation: Equation, first: FrameMotion, second: FrameMotion) -> tuple[np.ndarray, float]:
    """The equation by generalised velocities, and its second derivative at zero accelerations."""
    row = equation.by_first @ first.jacobian + equation.by_second @ second.jacobian
    bias = equation.bias + equation.by_first @ first.bias + equation.by_second @ second.bias
    return row, float(bias)


def resting(n: int, X: pin.SE3) -> FrameMotion:
    return FrameMotion(X.rotation, X.translation, np.zeros(6), np.zeros((6, n)), np.zeros(6))


# --- minimal coordinates -------------------------------------------------------------------------


class ModelMotion(NamedTuple):
    """A Pinocchio model at a state: inertia (n, n), bias and velocity (n,), position (nq,)."""

    model: pin.Model
    inertia: np.ndarray
    bias: np.ndarray
    velocity: np.ndarray
    position: np.ndarray


class Motions:
    """The motion of frames in generalised coordinates: of the objects, then of the robots."""

    def __init__(self, trees: TreeScene, state: TreeState):
        self.names = (*trees.objects, *trees.robots)
        self.models = {
            name: _moved(model, *_free_motion(state.objects[name]))
            for name, model in trees.objects.items()
        }
        for name, robot in trees.robots.items():
            q, rates = state.joint_positions[name], state.joint_velocities[name]
            if robot.floats:
                pose, twist = _free_motion(state.bases[name])
                q, rates = np.concatenate([pose, q]), np.concatenate([twist, rates])
            self.models[name] = _moved(robot.model, q, rates)
        ends = np.cumsum([0, *[self.models[name].velocity.size for name in self.names]]).tolist()
        places = {
            name: slice(*bounds)
            for name, *bounds in zip(self.names, ends[:-1], ends[1:], strict=True)
        }
        rates = {
            name: slice(places[name].stop - len(robot.joints), places[name].stop)
            for name, robot in trees.robots.items()
        }
        self.coordinates = Coordinates(places, rates, ends[-1])

    def frame(self, on_body: BodyFrame) -> FrameMotion:
        n = self.coordinates.size
        if on_body.body == WORLD:
            return resting(n, on_body.placement)
        moved, axes = self.models[on_body.body], pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        model, v = moved.model.copy(), moved.velocity
        end = pin.Frame("end", on_body.joint, on_body.placement, pin.FrameType.OP_FRAME)
        at = model.addFrame(end, False)
        data = model.createData()
        pin.forwardKinematics(model, data, moved.position, v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        J = np.zeros((6, n))
        J[:, self.coordinates.bodies[on_body.body]] = pin.computeFrameJacobian(
            model, data, moved.position, at, axes
        ).reshape(6, -1)
        return FrameMotion(
            data.oMf[at].rotation.copy(),
            data.oMf[at].translation.copy(),
            pin.getFrameVelocity(model, data, at, axes).vector.copy(),
            J,
            pin.getFrameClassicalAcceleration(model, data, at, axes).vector.copy(),
        )


def _free_motion(frame: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Configuration (7,) and velocity (6,) of Pinocchio's free flyer, whose axes are its own."""
    pose = np.concatenate([frame["position"], frame["quaternion_xyzw"]])
    R, twist = pin.XYZQUATToSE3(pose).rotation, frame["twist"]
    return pose, np.concatenate([R.T @ twist[:3], R.T @ twist[3:]])


def _moved(model: pin.Model, q: np.ndarray, v: np.ndarray) -> ModelMotion:
    data = model.createData()
    M = np.triu(pin.crba(model, data, q))
    bias = pin.nonLinearEffects(model, data, q, v).copy()
    return ModelMotion(model, M + np.triu(M, 1).T, bias, v, q)


# --- maximal coordinates -------------------------------------------------------------------------


def newton_euler(
    inertia: pin.Inertia, motion: FrameMotion, gravity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Inertia (6, 6) and force (6,) of a free body in the twist of its frame, world axes.

    With ``c`` from the frame's origin to the centre of mass,
    ``m (a + dw x c + w x (w x c)) = m g`` and ``I dw + w x I w = 0`` about that centre.
    """
    R, w = motion.rotation, motion.twist[3:]
    c, moments = R @ inertia.lever, R @ inertia.inertia @ R.T
    to_centre = np.eye(6)
    to_centre[:3, 3:] = -skew(c)
    M = to_centre.T @ block_diag(inertia.mass * np.eye(3), moments) @ to_centre
    force = inertia.mass * (gravity - np.cross(w, np.cross(w, c)))
    return M, to_centre.T @ np.concatenate([force, -np.cross(w, moments @ w)])


class Links:
    """Links as free bodies: six coordinates a link, then the rates of all joints."""

    def __init__(self, trees: TreeScene, state: TreeState):
        self.models = dict(trees.objects)
        self.models |= {name: robot.model for name, robot in trees.robots.items()}
        self._minimal = Motions(trees, state)
        keys = [(name, i) for name, model in self.models.items() for i in range(1, model.njoints)]
        self.places = {key: slice(6 * k, 6 * k + 6) for k, key in enumerate(keys)}
        rates, end = {}, 6 * len(keys)
        for name, robot in trees.robots.items():
            rates[name] = slice(end, end := end + len(robot.joints))
        self.coordinates = Coordinates({}, rates, end)
        self._floating = free_frames(trees)

    def inertia(self, name: str, i: int) -> pin.Inertia:
        return self.models[name].inertias[i]

    def motion(self, name: str, i: int) -> FrameMotion:
        """Of the frame of a link."""
        if i == 0:
            return resting(self.coordinates.size, pin.SE3.Identity())
        pose = self._minimal.frame(BodyFrame(name, i, pin.SE3.Identity()))
        J = np.zeros((6, self.coordinates.size))
        J[:, self.places[name, i]] = np.eye(6)
        return pose._replace(jacobian=J, bias=np.zeros(6))

    def frame(self, on_body: BodyFrame) -> FrameMotion:
        link = (
            resting(self.coordinates.size, pin.SE3.Identity())
            if on_body.body == WORLD
            else self.motion(on_body.body, on_body.joint)
        )
        return link.placed(on_body.placement.homogeneous)

    def joint_rows(self, name: str, i: int) -> tuple[np.ndarray, np.ndarray]:
        """Five rows that hold link ``i`` on its parent, and one that is the rate of the joint."""
        model = self.models[name]
        if i == 1 and name in self._floating:
            return np.zeros((0, self.coordinates.size)), np.zeros(0)
        child = self.motion(name, i)
        parent = self.motion(name, model.parents[i]).placed(model.jointPlacements[i].homogeneous)
        slides, axis = joint_motion(model.joints[i])
        kind = "prismatic" if slides else "revolute"
        held = joint_equations({"kind": kind, "axis": axis}, child, parent)
        if slides:
            along = displacement(child, parent, axis)
        else:  # w_C - w_P = s rate: the turning of s adds (w_P x s) . s rate = 0
            s = np.concatenate([np.zeros(3), parent.rotation @ axis])
            along = Equation(0.0, s, -s, 0.0)
        rows = [row_of(equation, child, parent) for equation in [*held, along]]
        A, gamma = np.array([row for row, _ in rows]), np.array([bias for _, bias in rows])
        first = 2 if name in self._floating else 1
        A[-1, self.coordinates.rates[name].start + i - first] = -1.0
        return A, gamma
