r"""Inverse dynamics: the joint torques for a desired motion and desired internal forces.

The motion is given by the object's acceleration and by :math:`\dot\alpha`, with the rates
:math:`\alpha` of the free motions of the joints.  With the motion space T of its joint (thesis,
3.5 - 3.8), each gripper on the object accelerates with

.. math::
    \dot v_m = G\dot v_o + G_1 v_o + H_o T\dot\alpha + (H_o\dot T + G_2 H_o T)\,\alpha

(:func:`multiarm.contacts.matrices.gripper_acceleration`), the joints with
:math:`J\ddot q = \dot v_m - \dot J\dot q`, and the contacts of the object must carry

.. math:: W_o\lambda = w, \qquad w = I_o\dot v_o - f_o, \qquad \lambda = W_o^+ w + A_o\mu_I .

Then :math:`\tau = M\ddot q + b - W\lambda`, less the torques of the effects: (3.10) of the thesis
in joint space, where it also holds for arms with more or fewer than six joints and in singular
postures.  A redundant arm has the accelerations nearest to a posture acceleration, in the metric of
its kinetic energy.

*Several objects* may each have an acceleration of their own.  Those of the others, :math:`a_u`, are
the smallest, in the metric of their kinetic energy, with which joints without a robot keep closed
and contacts need not exert what they cannot,

.. math:: W_{ok}^T a = c_k, \qquad Z^T (I_o a - f_o) = 0, \quad Z^T W_o = 0 ,

as a plate on a hinge swings by itself.

The accelerations of a robot with several tips satisfy these equations for all its connections at
once: with the object, with the world, where :math:`\dot v_o` is zero, and of its links with each
other, where it is that of the second link.  They keep its couplings and wheels too.  Contacts that
do not act on the object carry nothing, nor do wheels: the drives do.

*A floating base* has no drives: with its rows :math:`M_b, b_b, W_b` of the equations, and of its
contacts those with the world and with other robots apart, whose forces are :math:`\nu`,

.. math:: M_b\ddot q + b_b - W_b\lambda = W_{b\nu}\,\nu, \qquad
    Z^T (M_b\ddot q + b_b - W_b\lambda) = 0, \qquad Z^T W_{b\nu} = 0 .

The second equation is one more for the accelerations: it says how the base moves in directions in
which no such joint holds it.  The first one has the forces of least norm of these joints.

*Passive joints* have no drives: contact forces on the objects take the place of their torques,

.. math:: W_p\lambda = M_p\ddot q + b_p, \qquad W_o\lambda = w ,

with the smallest change of :math:`\lambda`.  Where no contact force acts on a passive joint, these
are equations for its acceleration.

Reference: S.Y. Ho, Analysis and Design of Multi-Arm Robotic Systems Manipulating Large Objects,
CUHK 1995, section 3.10.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from multiarm.contacts.matrices import gripper_acceleration, relative_wrenches
from multiarm.contacts.motion import BodyMotion
from multiarm.contacts.table import JointRow, WheelRow
from multiarm.dynamics.connections import Connection
from multiarm.dynamics.contact_geometry import block_inertias, force_directions, relative_motion
from multiarm.dynamics.control_laws import NO_CONTROL
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.evaluation import Evaluation, Residuals, evaluate, residuals_of
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.internal_forces import InternalForces, distribute, internal_forces
from multiarm.dynamics.layout import TWIST, Layout
from multiarm.dynamics.model import Model
from multiarm.dynamics.solver.bounds import BLOCK_RANK_TOLERANCE, IMMOVABLE, MISSED_MOTION
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver.factors import rank_of
from multiarm.dynamics.state import State, checked_vector
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import ModelError, SolverError
from multiarm.geometry.records import Contact
from multiarm.geometry.screws import lever_arm, row_scale, skew
from multiarm.jit.rows import fields_of
from multiarm.notation import count_of
from multiarm.robots.robot import Robot
from multiarm.scene.bodies import WORLD, BodyName
from multiarm.scene.faults import shown
from multiarm.spatial import quaternion_to_matrix


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Torques for a desired motion.

    Attributes
    ----------
    torques : mapping robot -> ndarray, shape (n_i,)
        [N m, N]
    contact_forces : mapping connection -> ndarray, shape (N_i,)
        The resulting magnitudes [N]; positive pushes the object.  Zero for connections that do not
        act on it, but those that hold a floating base: these carry what no drive can.
    joint_accelerations : mapping robot -> ndarray, shape (n_i,)
        [rad/s^2, m/s^2]
    base_accelerations : mapping robot -> ndarray, shape (6,)
        Of floating bases, world axes [m/s^2, rad/s^2].
    residuals : Residuals
        Of the equations of motion.  The residual of the constraints does not use the motion space:
        it is also large at a state that violates the joints.
    """

    torques: Mapping[str, np.ndarray]
    contact_forces: Mapping[str, np.ndarray]
    joint_accelerations: Mapping[str, np.ndarray]
    base_accelerations: Mapping[str, np.ndarray]
    residuals: Residuals


def inverse_dynamics(
    system: System,
    state: State,
    object_acceleration: np.ndarray | Mapping[str, np.ndarray],
    relative_acceleration: Mapping[str, np.ndarray | None] | None = None,
    internal_forces: np.ndarray | None = None,
    t: float = 0.0,
    basis: str | InternalForces = "orthonormal",
    posture_acceleration: Mapping[str, np.ndarray] | None = None,
) -> InverseDynamics:
    """Joint torques for a desired motion of the system (thesis, 3.10).

    Parameters
    ----------
    system : System
        Its control is ignored, its effects (joint damping, ...) are compensated.  Unilateral
        contacts of the joints are closed, those with a floor are open.
    state : State
        On the constraints, positions and velocities.
    object_acceleration : array-like, shape (6,), or mapping object -> array-like (6,)
        Of the centre of mass (classical) and angular, world axes [m/s^2, rad/s^2].  Of several
        objects a mapping; those that it leaves out follow as their joints want.
    relative_acceleration : mapping connection -> array-like (m_i,) or None, optional
        Rates of ``alpha``, in the order of ``system.frames[name].free`` [m/s^2, rad/s^2]; ``None``
        leaves the relative motion undetermined.  Left out: zero for connections with the object,
        undetermined for the others.
    internal_forces : array-like, shape (k,), optional
        Coordinates of the internal forces in ``basis`` [N]; none when left out.
    t : float
        Time [s].
    basis : "orthonormal", "nonnegative", "echelon" or InternalForces
        Basis of the coordinates, see :mod:`multiarm.dynamics.forces.internal_forces`.
    posture_acceleration : mapping robot -> array-like (n_i,), optional
        Preferred joint accelerations of redundant robots; zero when left out.

    Raises
    ------
    SolverError
        When a robot, or an object on its joints with others and the world, cannot have the desired
        motion.
    GraspError
        When the contacts cannot put the desired wrench on the object, there is no basis of the
        desired form, or the internal forces do not fit it.
    ModelError
        For an unknown robot, connection or object, or a wrong shape.
    """
    system = require_system(system, "ma.inverse_dynamics(system, state, acceleration)")
    _require_drives(system.model)
    t, state = require_time(t), system.checked(state)
    desired = _desired_accelerations(system.model, object_acceleration)
    relative = _relative_accelerations(
        system.model, {} if relative_acceleration is None else relative_acceleration
    )
    posture = _posture_accelerations(
        system.model, {} if posture_acceleration is None else posture_acceleration
    )
    with system.borrow() as controlled:
        controlled.model.require_joints_as_written(t, "inverse dynamics")
        data = _uncontrolled(controlled)
        ev = evaluate(data, t, state)
        return _solve(data, ev, desired, relative, posture, internal_forces, basis)


def _solve(
    data: Data,
    ev: Evaluation,
    desired_of: Mapping[str, np.ndarray],
    relative: Mapping[str, np.ndarray | None],
    posture: Mapping[str, np.ndarray],
    internal_forces: np.ndarray | None,
    basis: str | InternalForces,
) -> InverseDynamics:
    """Torques for a desired motion, at a state that has just been evaluated."""
    b, layout = data.arrays, data.model.layout
    free, f_o, c = b.forces.f_j.copy(), b.forces.f_o.copy(), b.rows.c.copy()
    require_ok(data, update_kinematics(data.struct))
    desired = _object_accelerations(data, f_o, c, desired_of)
    force = _contact_forces(data, b.bodies.object_inertia @ desired - f_o, internal_forces, basis)
    a_j, torque = np.zeros(layout.rate_count), np.zeros(layout.rate_count)
    missed = _missed_by_objects(data, c, desired)
    inertias, directions = block_inertias(data), force_directions(data)
    accelerations = dict(zip(layout.objects, np.reshape(desired, (-1, TWIST)), strict=True))
    for robots in layout.robot_groups:
        group = _Group.of(layout, robots, inertias, directions)
        d, r, names = group.joints, group.rows, [layout.names[i] for i in robots]
        A, a = _desired_motion(data, group, ev, accelerations, relative)
        A, a = _with_idle_joints(data.model, group, free[d], A, a)
        base = _BaseBalance.of(data, group)
        other = free[d][base.rows] + group.W[base.rows] @ force[r]
        A = np.vstack([A, base.across @ group.M[base.rows]])
        a = np.append(a, base.across @ other)
        preferred = np.concatenate([posture[name] for name in names])
        a_j[d], left = _nearest(group.M, A, a, preferred)
        force[r][base.carriers] = base.forces(group.M[base.rows] @ a_j[d] - other)
        if left > MISSED_MOTION * (1.0 + np.max(np.abs(a), initial=0.0)):
            robots_in_words = " and ".join(
                f"{_noun(data.model, name)} '{name}' ({_freedom(data.model.robots[name])})"
                for name in names
            )
            verb = "miss" if len(names) > 1 else "misses"
            missed.append(f"{robots_in_words} {verb} it by {left:.3g} m/s^2, rad/s^2")
        torque[d] = group.M @ a_j[d] - free[d] - group.W @ force[r]
    if not missed and layout.passive_joints:
        missed = _carry_passive_joints(data.model, directions, force, torque)
    if missed:
        key = "arm" if set(data.model.connections) == set(data.model.robots) else "connection"
        raise SolverError(
            "the wanted motion is not possible: " + "; ".join(missed) + "; leave the relative "
            f"motion of such an arm free (`relative_acceleration={{{key}: None}}`), or ask for "
            "another motion"
        )
    acceleration, forces = np.append(desired, a_j), np.append(f_o, free + torque)
    return InverseDynamics(
        torques=layout.split_joints(torque),
        contact_forces=layout.split_contacts(force),
        joint_accelerations=layout.split_joints(a_j),
        base_accelerations=layout.split_bases(a_j),
        residuals=residuals_of(data, acceleration, forces, force, c),
    )


def _require_drives(model: Model) -> None:
    layout = model.layout
    if layout.passive_joints and layout.floating_robots:
        raise ModelError(
            f"inverse dynamics: the joint {model.joint_names[layout.passive_joints[0]]!r} is "
            f"passive and the base of {layout.names[layout.floating_robots[0]]!r} floats; torques "
            "are computed where one of both is so"
        )


def _with_idle_joints(
    model: Model, group: _Group, free: np.ndarray, A: np.ndarray, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The equations of a group's accelerations, with those of joints that no force can drive.

    ``free`` (n,) are the joints' forces without drives and contacts.
    """
    joints, rows = group.joints, group.rows
    passive = [
        joint - joints.start
        for joint in model.layout.passive_joints
        if joints.start <= joint < joints.stop
    ]
    if not passive:
        return A, a
    of_objects = model.contacts_of_object
    carrying = [row - rows.start for row in of_objects if rows.start <= row < rows.stop]
    u, singular, _ = np.linalg.svd(group.W[np.ix_(passive, carrying)])
    across = u[:, rank_of(singular, BLOCK_RANK_TOLERANCE) :].T
    return np.vstack([A, across @ group.M[passive]]), np.append(a, across @ free[passive])


def _carry_passive_joints(
    model: Model, directions: np.ndarray, force: np.ndarray, torque: np.ndarray
) -> list[str]:
    """Let contact forces (N,) take over the torques (n,) of passive joints; what is left, in words.

    The wrenches on the objects stay.  ``directions`` are those of all contact forces.
    """
    layout = model.layout
    rows, passive = list(model.contacts_of_object), list(layout.passive_joints)
    directions = directions[:, rows]
    idle = directions[layout.of_joints][passive]
    stacked = np.vstack([directions[layout.of_frames], idle])
    sizes = np.linalg.norm(stacked, axis=1)
    scale = 1.0 / np.where(sizes > 0.0, sizes, 1.0)
    wanted = np.append(np.zeros(layout.node), torque[passive])
    change = np.linalg.lstsq(scale[:, None] * stacked, scale * wanted, BLOCK_RANK_TOLERANCE)[0]
    force[rows] += change
    torque -= directions[layout.of_joints] @ change
    size = MISSED_MOTION * (1.0 + np.max(np.abs(wanted)))
    missed = [
        f"the passive joint {model.joint_names[joint]!r} would need {torque[joint]:.3g} "
        f"{'N' if model.joint_units[joint] == 'm' else 'N m'}"
        for joint in passive
        if abs(torque[joint]) > size
    ]
    if not missed:
        torque[passive] = 0.0
    return missed


def _freedom(robot: Robot) -> str:
    joints = count_of(len(robot.joint_names), "joint")
    return f"{joints}; its base floats" if robot.floats else joints


class _Group(NamedTuple):
    """Robots that are joined to each other, or one alone."""

    first: dict[str, int]  # of the joints of each robot among those of the group
    joints: slice  # among all joints
    rows: slice  # among all rows
    M: np.ndarray  # (n, n)
    W: np.ndarray  # (n, N)

    @classmethod
    def of(
        cls,
        layout: Layout,
        robots: range,
        inertias: Sequence[np.ndarray],
        directions: np.ndarray,
    ) -> _Group:
        """``inertias`` are those of all blocks, ``directions`` those of all contact forces."""
        blocks = slice(layout.blocks_of(robots[0]).start, layout.blocks_of(robots[-1]).stop)
        firsts, rows = layout.first_joint_of_block, layout.first_of_block
        joints = slice(firsts[blocks.start], firsts[blocks.stop])
        contacts = slice(rows[blocks.start], rows[blocks.stop])
        first = {layout.names[i]: layout.first_joint[i] - joints.start for i in robots}
        M = np.zeros((joints.stop - joints.start,) * 2)
        for begin, inertia in zip(firsts[blocks], inertias[blocks], strict=True):
            part = slice(begin - joints.start, begin - joints.start + len(inertia))
            M[part, part] = inertia
        return cls(first, joints, contacts, M, directions[layout.of_joints][joints, contacts])


class _BaseBalance(NamedTuple):
    """The equations of floating bases, which the world or other robots hold or do not hold.

    They are divided by the inertia of the bases, so that all are accelerations.
    """

    rows: np.ndarray  # (6 b,) of the bases among the joints of the group
    carriers: np.ndarray  # the rows of these joints among those of the group
    scale: np.ndarray  # (6 b,) one over the inertia
    directions: np.ndarray  # (6 b, k) accelerations by unit forces of these rows
    across: np.ndarray  # (6 b - r, 6 b) of forces, along which none of these rows acts

    @classmethod
    def of(cls, data: Data, group: _Group) -> _BaseBalance:
        robots = data.model.robots
        firsts = [first for name, first in group.first.items() if robots[name].floats]
        carriers = _carriers(data.model, group) if firsts else np.zeros(0, dtype=int)
        rows = np.add.outer(np.array(firsts, dtype=int), np.arange(TWIST)).ravel()
        scale = 1.0 / np.diag(group.M)[rows]
        directions = scale[:, None] * group.W[np.ix_(rows, carriers)]
        u, singular, _ = np.linalg.svd(directions)
        across = u[:, rank_of(singular, BLOCK_RANK_TOLERANCE) :].T * scale
        return cls(rows, carriers, scale, directions, across)

    def forces(self, wanted: np.ndarray) -> np.ndarray:
        """Forces of least norm of the joints that hold the bases, for wrenches (6 b,) on these."""
        return np.linalg.lstsq(self.directions, self.scale * wanted, rcond=BLOCK_RANK_TOLERANCE)[0]


def _carriers(model: Model, group: _Group) -> np.ndarray:
    """Rows of a group, counted from its first one, that carry floating bases.

    They are those of its joints with the world, and of those between its robots.
    """
    layout, rows, first = model.layout, [], group.rows.start
    for name, pair in model.connections.items():
        of_pair = layout.contacts_of(layout.owners.index(name))
        holds = WORLD in (pair.first, pair.second) or len(pair.robots) > 1
        if holds and group.first.keys() & pair.robots:
            records = zip(range(of_pair.start, of_pair.stop), model.records[of_pair], strict=True)
            rows += [k - first for k, record in records if isinstance(record, Contact)]
    return np.array(rows, dtype=int)


def _noun(model: Model, robot: str) -> str:
    return "arm" if "" in model.robots[robot].tips else "robot"


def _object_accelerations(
    data: Data, f_o: np.ndarray, c: np.ndarray, desired: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Accelerations of all objects (6 F,): the desired ones, and of the others the smallest."""
    model, W_o = data.model, data.arrays.rows.W_o
    objects, inertia = model.layout.objects, data.arrays.bodies.object_inertia
    accelerations = np.zeros((len(objects), TWIST))
    follows = np.repeat([name not in desired for name in objects], TWIST)
    for name, acceleration in desired.items():
        accelerations[objects.index(name)] = acceleration
    a = accelerations.ravel()
    if not np.any(follows):
        return a
    alone = [name for name, pair in model.connections.items() if not pair.robots]
    rows = [np.r_[model.layout.contacts_of(model.layout.owners.index(name))] for name in alone]
    passive = np.concatenate([np.zeros(0, dtype=int), *rows])
    scale = np.tile(row_scale(lever_arm(W_o.T)), len(objects))
    Z = scale[:, None] * null_space(W_o * scale, BLOCK_RANK_TOLERANCE).basis
    E, e = np.vstack([W_o[passive], Z.T @ inertia]), np.concatenate([c[passive], Z.T @ f_o])
    left = e - E[:, ~follows] @ a[~follows]
    of_followers = inertia[np.ix_(follows, follows)]
    a[follows], _ = _nearest(of_followers, E[:, follows], left, np.zeros(len(of_followers)))
    return a


def _missed_by_objects(data: Data, c: np.ndarray, desired: np.ndarray) -> list[str]:
    """What of the objects' accelerations their joints without a robot forbid, in words."""
    model, missed = data.model, []
    for name, pair in model.connections.items():
        if pair.robots:
            continue
        rows = model.layout.contacts_of(model.layout.owners.index(name))
        against = np.abs(data.arrays.rows.W_o[rows] @ desired - c[rows])
        if np.max(against) > MISSED_MOTION * (1.0 + np.max(np.abs(desired))):
            missed.append(f"the joint '{name}' misses it by {np.max(against):.3g} m/s^2")
    return missed


def _desired_motion(
    data: Data,
    group: _Group,
    ev: Evaluation,
    object_accelerations: Mapping[str, np.ndarray],
    relative: Mapping[str, np.ndarray | None],
) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``a`` of the equations ``A q'' = a`` for the joint accelerations of a group."""
    model = data.model
    equations = [
        _motion_of_first(model, pair, ev, group, object_accelerations, relative[name])
        for name, pair in model.connections.items()
        if group.first.keys() & pair.robots
    ]
    of_joints = [isinstance(record, JointRow | WheelRow) for record in model.records[group.rows]]
    bias = data.contact_rows.gap_bias[group.rows]
    equations.append((group.W[:, of_joints].T, -bias[of_joints]))
    A, a = zip(*equations, strict=True)
    return np.vstack(A), np.concatenate(a)


class _Frame(NamedTuple):
    """A frame of a connection, by the joint accelerations of its robots, world axes."""

    rotation: np.ndarray  # (3, 3)
    twist: np.ndarray  # (6,)
    J: np.ndarray  # (6, n)
    drift: np.ndarray  # (6,) acceleration without joint accelerations


def _frame(
    model: Model,
    body: BodyName,
    group: _Group,
    ev: Evaluation,
    object_accelerations: Mapping[str, np.ndarray],
) -> _Frame:
    state = ev.state
    still = np.zeros((6, len(group.M)))
    if body.is_link:
        name, robot = body.robot, model.robots[body.robot]
        rates, base = state.joint_velocities[name], state.bases.get(name)
        tip, first = (
            robot.terms(state.joint_positions[name], rates, body.tip, base),
            group.first[name],
        )
        J = still.copy()
        J[:, first : first + robot.dof] = tip.J
        return _Frame(tip.tip_rotation, tip.tip_twist, J, tip.drift)
    if body.is_object:
        moving = state.objects[body.tip]
        R = quaternion_to_matrix(moving.quaternion_xyzw)
        return _Frame(R, moving.twist, still, object_accelerations[body.tip])
    return _Frame(np.eye(3), np.zeros(6), still, np.zeros(6))


def _motion_of_first(
    model: Model,
    pair: Connection,
    ev: Evaluation,
    group: _Group,
    object_accelerations: Mapping[str, np.ndarray],
    rates: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``a`` of one connection; without ``rates``, across its free motions only."""
    first, second = (
        _frame(model, body, group, ev, object_accelerations) for body in (pair.first, pair.second)
    )
    relative, space = relative_motion(model, ev.state, pair.name), ev.motion_space(pair.name)
    alpha = space.rates(relative.twist)
    alpha_dot = np.zeros(alpha.size) if rates is None else rates
    vdot = gripper_acceleration(
        second.rotation, second.twist, second.drift, relative, space.acceleration(alpha, alpha_dot)
    )
    carried = second.J.copy()  # the first frame moves with the second body
    carried[:3] -= skew(second.rotation @ relative.translation) @ second.J[3:]
    A, a = first.J - carried, vdot - first.drift
    if rates is not None:
        return A, a
    wrenches = relative_wrenches(ev.contact_terms[pair.name], relative)[0]
    across = (np.kron(np.eye(2), second.rotation) @ wrenches).T
    return across @ A, across @ a


def _uncontrolled(data: Data) -> Data:
    """Data of the model without control, all contacts of its joints closed, for the dense solver.

    The dense solver also answers where an arm is singular.
    """
    closed = data.closed
    return closed.view(closed.model.with_constants(control=NO_CONTROL, dense=True))


def _contact_forces(
    data: Data,
    wrench: np.ndarray,
    coordinates: np.ndarray | None,
    basis: str | InternalForces,
) -> np.ndarray:
    """Contact forces (N,) for wrenches on the objects, world axes, and internal forces."""
    model, force = data.model, np.zeros(data.model.layout.contacts)
    rows = list(model.contacts_of_object)
    names = ["/".join((owner, record.name)) for owner, record in map(model.owner, rows)]
    rotations = fields_of(BodyMotion, data.arrays.bodies.objects).rotation
    to_object = np.zeros((model.layout.node,) * 2)  # block diagonal
    for o, R in enumerate(rotations):
        part = slice(TWIST * o, TWIST * o + TWIST)
        to_object[part, part] = np.kron(np.eye(2), R.T)
    W_o = to_object @ data.arrays.rows.W_o[rows].T
    form = internal_forces(W_o, basis, None, names) if isinstance(basis, str) else basis
    force[rows] = distribute(W_o, to_object @ wrench, coordinates, form)
    return force


def _nearest(
    M: np.ndarray, A: np.ndarray, a: np.ndarray, preferred: np.ndarray
) -> tuple[np.ndarray, float]:
    """Joint accelerations with ``A q'' = a`` nearest to ``preferred``, and the residual.

    By singular values, which show a loss of rank: the normal equations that control laws solve
    (:func:`multiarm.control.null_space.nearest_accelerations`) leave half the digits.
    """
    L = np.linalg.cholesky(M)
    B = np.linalg.solve(L, A.T).T
    size = np.linalg.norm(B, axis=1)
    largest = np.max(size, initial=0.0) or 1.0
    # a row of roundings, as those across the plane of a linkage, is not scaled up
    scale = 1.0 / np.where(size > IMMOVABLE * largest, size, largest)
    y = np.linalg.lstsq(
        scale[:, None] * B, scale * (a - A @ preferred), rcond=BLOCK_RANK_TOLERANCE
    )[0]
    a_j = preferred + np.linalg.solve(L.T, y)
    return a_j, float(np.max(np.abs(A @ a_j - a), initial=0.0))


def _desired_accelerations(model: Model, wanted: Any) -> dict[str, np.ndarray]:
    """The desired accelerations by object."""
    key, objects = "object_acceleration", model.layout.objects
    if not isinstance(wanted, Mapping):
        if len(objects) > 1:
            raise ModelError(
                f"{key}: there are {len(objects)} objects, {', '.join(objects)}; give a dict with "
                f"six numbers of each that is to be moved, such as {{{objects[0]!r}: ...}}"
            )
        return {objects[0]: checked_vector(key, wanted, TWIST)}
    _require_known(key, wanted, objects, "object")
    return {name: checked_vector(f"{key}[{name!r}]", a, TWIST) for name, a in wanted.items()}


def _relative_accelerations(
    model: Model, wanted: Mapping[str, np.ndarray | None]
) -> dict[str, np.ndarray | None]:
    """The desired rates of ``alpha`` of every connection of a robot; None: undetermined."""
    key, of_robots = "relative_acceleration", [n for n, c in model.connections.items() if c.robots]
    _require_known(
        key, wanted, of_robots, "arm" if of_robots == list(model.robots) else "connection"
    )
    rates: dict[str, np.ndarray | None] = {}
    for name in of_robots:
        frame = model.frames[name]
        default = np.zeros(len(frame.free)) if model.connections[name].on_object else None
        values = wanted.get(name, default)
        what = f"{key}[{name!r}] ({', '.join(frame.labels) or 'nothing is free'})"
        rates[name] = None if values is None else checked_vector(what, values, len(frame.free))
    return rates


def _posture_accelerations(model: Model, wanted: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    arms_alone = all(_noun(model, name) == "arm" for name in model.robots)
    _require_known("posture_acceleration", wanted, model.robots, "arm" if arms_alone else "robot")
    accelerations = {}
    for name, arm in model.robots.items():
        n, what = len(arm.joint_names), f"posture_acceleration[{name!r}]"
        of_joints = checked_vector(what, wanted.get(name, np.zeros(n)), n)
        accelerations[name] = np.append(np.zeros(arm.base_dof), of_joints)
    return accelerations


def _require_known(key: str, wanted: Any, names: Iterable[str], noun: str) -> None:
    if not isinstance(wanted, Mapping):
        raise ModelError(f"{key}: must be a dict with numbers by {noun}, got {shown(wanted)}")
    for name in wanted:
        if name not in names:
            raise ModelError(f"{key}: unknown {noun} {name!r}; {noun}s are {', '.join(names)}")
