r"""Inverse dynamics: the joint torques for a desired motion and desired internal forces.

The motion is given by the object's acceleration and by :math:`\dot\alpha`, with the rates
:math:`\alpha` of the free motions of the joints.  With the motion space T of its joint (thesis,
3.5 - 3.8), each gripper accelerates with

.. math::
    \dot v_m = G\dot v_o + G_1 v_o + H_o T\dot\alpha + (H_o\dot T + G_2 H_o T)\,\alpha

(:func:`multiarm.contacts.matrices.gripper_acceleration`), the joints with
:math:`J\ddot q = \dot v_m - \dot J\dot q`, and the contacts must carry

.. math:: W_o\lambda = w, \qquad w = I_o\dot v_o - f_o, \qquad \lambda = W_o^+ w + A_o\mu_I .

Then :math:`\tau = M\ddot q + b - W\lambda`, less the torques of the effects: (3.10) of the thesis
in joint space, where it also holds for arms with more or fewer than six joints and in singular
postures.  A redundant arm has the accelerations nearest to a posture acceleration, in the metric of
its kinetic energy.

Reference: S.Y. Ho, Analysis and Design of Multi-Arm Robotic Systems Manipulating Large Objects,
CUHK 1995, section 3.10.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from multiarm.contacts.matrices import gripper_acceleration, relative_wrenches
from multiarm.dynamics.contact_geometry import relative_motion
from multiarm.dynamics.control_laws import NO_CONTROL
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.evaluation import Evaluation, Residuals, evaluate, residuals_of
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.forces.internal_forces import InternalForces, distribute
from multiarm.dynamics.kinematics import read_inertia
from multiarm.dynamics.model import Model
from multiarm.dynamics.solver.bounds import ARM_RANK_TOLERANCE, MISSED_MOTION
from multiarm.dynamics.state import State, checked_vector
from multiarm.dynamics.system import System, require_system, require_time
from multiarm.errors import ModelError, SolverError
from multiarm.notation import count_of
from multiarm.scene.faults import shown
from multiarm.spatial import quaternion_to_matrix


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """Torques for a desired motion.

    Attributes
    ----------
    torques : mapping arm -> ndarray, shape (n_i,)
        [N m, N]
    contact_forces : mapping arm -> ndarray, shape (N_i,)
        The resulting magnitudes [N]; positive pushes the object.
    joint_accelerations : mapping arm -> ndarray, shape (n_i,)
        [rad/s^2, m/s^2]
    residuals : Residuals
        Of the equations of motion.  The residual of the constraints does not use the motion space:
        it is also large at a state that violates the joints.
    """

    torques: Mapping[str, np.ndarray]
    contact_forces: Mapping[str, np.ndarray]
    joint_accelerations: Mapping[str, np.ndarray]
    residuals: Residuals


def inverse_dynamics(
    system: System,
    state: State,
    object_acceleration: np.ndarray,
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
    object_acceleration : array-like, shape (6,)
        Of the centre of mass (classical) and angular, world axes [m/s^2, rad/s^2].
    relative_acceleration : mapping arm -> array-like (m_i,) or None, optional
        Rates of ``alpha``, in the order of ``system.frames[arm].free`` [m/s^2, rad/s^2]; ``None``
        leaves the relative motion undetermined.  Arms that are left out: zero.
    internal_forces : array-like, shape (k,), optional
        Coordinates of the internal forces in ``basis`` [N]; none when left out.
    t : float
        Time [s].
    basis : "orthonormal", "nonnegative", "echelon" or InternalForces
        Basis of the coordinates, see :mod:`multiarm.dynamics.forces.internal_forces`.
    posture_acceleration : mapping arm -> array-like (n_i,), optional
        Preferred joint accelerations of redundant arms; zero when left out.

    Raises
    ------
    SolverError
        When an arm cannot have the desired motion.
    GraspError
        When the contacts cannot put the desired wrench on the object, there is no basis of the
        desired form, or the internal forces do not fit it.
    ModelError
        For an unknown arm or a wrong shape.
    """
    system = require_system(system, "ma.inverse_dynamics(system, state, acceleration)")
    t, state = require_time(t), system.checked(state)
    desired = checked_vector("object_acceleration", object_acceleration, 6)
    relative = _relative_accelerations(
        system.model, {} if relative_acceleration is None else relative_acceleration
    )
    posture = _posture_accelerations(
        system.model, {} if posture_acceleration is None else posture_acceleration
    )
    with system.borrow() as controlled:
        data = _uncontrolled(controlled)
        ev = evaluate(data, t, state)
        return _solve(data, ev, desired, relative, posture, internal_forces, basis)


def _solve(
    data: Data,
    ev: Evaluation,
    desired: np.ndarray,
    relative: Mapping[str, np.ndarray | None],
    posture: Mapping[str, np.ndarray],
    internal_forces: np.ndarray | None,
    basis: str | InternalForces,
) -> InverseDynamics:
    """Torques for a desired motion, at a state that has just been evaluated."""
    b, layout = data.arrays, data.model.layout
    free, f_o, c = b.forces.f_j.copy(), b.forces.f_o.copy(), b.rows.c.copy()
    require_ok(data, update_kinematics(data.struct))
    force = _contact_forces(ev, b.bodies.object_inertia @ desired - f_o, internal_forces, basis)
    a_j, torque, faults = np.zeros(layout.joints), np.zeros(layout.joints), []
    for i, name in enumerate(layout.names):
        d, r = layout.joints_of(i), layout.contacts_of(i)
        M = read_inertia(b.bodies.pointers[i], d.stop - d.start)
        W = data.work.W[i, : d.stop - d.start, : r.stop - r.start]
        A, a = _desired_motion(data.model, name, ev, desired, relative[name])
        a_j[d], left = _nearest(M, A, a, posture[name])
        if left > MISSED_MOTION * (1.0 + np.max(np.abs(a), initial=0.0)):
            faults.append(
                f"arm '{name}' ({count_of(len(M), 'joint')}) misses it by {left:.3g} m/s^2, rad/s^2"
            )
        torque[d] = M @ a_j[d] - free[d] - W @ force[r]
    if faults:
        raise SolverError(
            "the wanted motion is not possible: " + "; ".join(faults) + "; leave the relative "
            "motion of such an arm free (`relative_acceleration={arm: None}`), or ask for another "
            "motion"
        )
    acceleration, forces = np.append(desired, a_j), np.append(f_o, free + torque)
    return InverseDynamics(
        torques=layout.split_joints(torque),
        contact_forces=layout.split_contacts(force),
        joint_accelerations=layout.split_joints(a_j),
        residuals=residuals_of(data, acceleration, forces, force, c),
    )


def _desired_motion(
    model: Model,
    name: str,
    ev: Evaluation,
    object_acceleration: np.ndarray,
    rates: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """``A`` and ``a`` of the equations ``A q'' = a`` for the joint accelerations of one arm."""
    state = ev.state
    arm = model.arms[name].terms(state.joint_positions[name], state.joint_velocities[name])
    R = quaternion_to_matrix(state.object_quaternion_xyzw)
    relative, space = relative_motion(model, state, name), ev.motion_space(name)
    alpha = space.rates(relative.twist)
    alpha_dot = np.zeros(alpha.size) if rates is None else rates
    vdot = gripper_acceleration(
        R, state.object_twist, object_acceleration, relative, space.acceleration(alpha, alpha_dot)
    )
    if rates is not None:
        return arm.J, vdot - arm.drift
    across = (np.kron(np.eye(2), R) @ relative_wrenches(ev.contact_terms[name], relative)[0]).T
    return across @ arm.J, across @ (vdot - arm.drift)


def _uncontrolled(data: Data) -> Data:
    """Data of the model without control, all contacts of its joints closed, for the dense solver.

    The dense solver also answers where an arm is singular.
    """
    closed = data.closed
    return closed.view(closed.model.with_constants(control=NO_CONTROL, dense=True))


def _contact_forces(
    ev: Evaluation,
    wrench: np.ndarray,
    coordinates: np.ndarray | None,
    basis: str | InternalForces,
) -> np.ndarray:
    """Contact forces (N,) for a wrench on the object, world axes, and internal forces."""
    R = quaternion_to_matrix(ev.state.object_quaternion_xyzw)
    form = ev.internal_forces(basis) if isinstance(basis, str) else basis
    in_object_axes = np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]])
    return distribute(ev.W_o, in_object_axes, coordinates, form)


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
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    y = np.linalg.lstsq(scale[:, None] * B, scale * (a - A @ preferred), rcond=ARM_RANK_TOLERANCE)[
        0
    ]
    a_j = preferred + np.linalg.solve(L.T, y)
    return a_j, float(np.max(np.abs(A @ a_j - a), initial=0.0))


def _relative_accelerations(
    model: Model, given: Mapping[str, np.ndarray | None]
) -> dict[str, np.ndarray | None]:
    """The desired rates of ``alpha`` of every arm; None: undetermined."""
    _require_arms(model, "relative_acceleration", given)
    rates: dict[str, np.ndarray | None] = {}
    for arm, frame in model.frames.items():
        values = given.get(arm, np.zeros(len(frame.free)))
        what = f"relative_acceleration[{arm!r}] ({', '.join(frame.labels) or 'nothing is free'})"
        rates[arm] = None if values is None else checked_vector(what, values, len(frame.free))
    return rates


def _posture_accelerations(model: Model, given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    _require_arms(model, "posture_acceleration", given)
    return {
        name: checked_vector(f"posture_acceleration[{name!r}]", given.get(name, np.zeros(n)), n)
        for name, n in ((name, arm.dof) for name, arm in model.arms.items())
    }


def _require_arms(model: Model, what: str, given: Any) -> None:
    if not isinstance(given, Mapping):
        raise ModelError(f"{what}: must be a dict with numbers by arm, got {shown(given)}")
    for arm in given:
        if arm not in model.arms:
            names = ", ".join(model.arm_names)
            raise ModelError(f"{what}: unknown arm {arm!r}; arms are {names}")
