r"""Inverse dynamics: the joint torques for a wanted motion and wanted internal forces.

The motion is given by the object's acceleration and by the rates of the relative rates
:math:`\alpha` that the joints leave free.  With the motion space T of its joint (thesis, 3.5 -
3.8), each gripper accelerates with

.. math::
    \dot v_m = G\dot v_o + G_1 v_o + H_o T\dot\alpha + (H_o\dot T + G_2 H_o T)\,\alpha

(:func:`multiarm.contacts.matrices.gripper_acceleration`), the joints with
:math:`J\ddot q = \dot v_m - \dot J\dot q`, and the contacts must carry

.. math:: W_o\lambda = I_o\dot v_o + h_o, \qquad \lambda = W_o^+ f_o + A_o\mu_I .

Then :math:`\tau = M\ddot q + b - W\lambda`, less what the effects do by themselves: the thesis's
(3.10) in joint space, where it also holds for arms of more or fewer than six joints and in singular
postures.  An arm with joints to spare moves, of all ways that there are, in the one nearest to a
posture acceleration, in the metric of its kinetic energy.

Reference: S.Y. Ho, Analysis and Design of Multi-Arm Robotic Systems Manipulating Large Objects,
CUHK 1995, section 3.10.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from multiarm.contacts.internal_forces import InternalForces, distribute
from multiarm.contacts.matrices import gripper_acceleration, relative_wrenches
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_analysis import relative_motion_of
from multiarm.dynamics.dense_callback import read_inertia
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.evaluation import Evaluation, Residuals, evaluate
from multiarm.dynamics.model import Data, Model
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System, checked_vector
from multiarm.dynamics.user_callback import NO_CONTROL
from multiarm.errors import ModelError, SolverError
from multiarm.spatial import quaternion_to_matrix

# Singular values of an arm's scaled Jacobian below this fraction of the largest count as zero.
RANK_TOLERANCE = 1e-10
# What is left of a wanted motion or wrench, relative to it, when it counts as impossible.
IMPOSSIBLE = 1e-7


@dataclass(frozen=True)
class InverseDynamics:
    """Torques for a wanted motion.

    Attributes
    ----------
    torques : mapping arm -> ndarray, shape (n_i,)
        [N m, N]
    contact_forces : mapping arm -> ndarray, shape (N_i,)
        Magnitudes that go with them [N]; positive pushes the object.
    joint_accelerations : mapping arm -> ndarray, shape (n_i,)
        [rad/s^2, m/s^2]
    residuals : Residuals
        The result put into the equations of motion.  The residual of the constraints does not use
        the motion space: it also tells a state that is not on the joints.
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
    """Joint torques with which the system moves as wanted (thesis, 3.10).

    Parameters
    ----------
    system : System
        Its control is left out of account, its effects (joint damping, ...) are compensated.
        Unilateral contacts of the joints are closed, those with a floor are open.
    state : State
        On the constraints, positions and velocities.
    object_acceleration : array-like, shape (6,)
        Of the centre of mass (classical) and angular, world axes [m/s^2, rad/s^2].
    relative_acceleration : mapping arm -> array-like (m_i,) or None, optional
        Rates of the arm's relative rates, in the order of ``system.frames[arm].free``
        [m/s^2, rad/s^2]; ``None`` leaves them to the arm.  Arms that are not named: zero.
    internal_forces : array-like, shape (k,), optional
        Coordinates of the internal forces in ``basis`` [N]; none when left out.
    t : float
        Time [s].
    basis : "orthonormal", "nonnegative", "echelon" or InternalForces
        What the coordinates mean, see :mod:`multiarm.contacts.internal_forces`.
    posture_acceleration : mapping arm -> array-like (n_i,), optional
        What arms with joints to spare come as near to as they can; zero when left out.

    Raises
    ------
    SolverError
        When an arm cannot move as wanted.
    GraspError
        When the contacts cannot put the wanted wrench on the object, there is no basis of the
        wanted form, or the internal forces do not fit it.
    ModelError
        For an unknown arm or a wrong shape.
    """
    wanted = checked_vector("object_acceleration", object_acceleration, 6)
    relative = _relative_accelerations(system.model, relative_acceleration or {})
    posture = _posture_accelerations(system.model, posture_acceleration or {})
    with system.borrow() as own:
        data = _uncontrolled(own)
        ev = evaluate(data, t, state)
        return _solve(data, ev, wanted, relative, posture, internal_forces, basis)


def _solve(
    data: Data,
    ev: Evaluation,
    wanted: np.ndarray,
    relative: Mapping[str, np.ndarray | None],
    posture: Mapping[str, np.ndarray],
    internal_forces: np.ndarray | None,
    basis: str | InternalForces,
) -> InverseDynamics:
    """Torques for a wanted motion, at a state that has just been evaluated."""
    b, layout = data.arrays, data.model.layout
    free, h_o, c = b.h.copy(), b.h_o.copy(), b.c.copy()
    if update_kinematics(data.struct) != OK:
        data.reraise()
    force = _contact_forces(ev, b.inertia @ wanted - h_o, internal_forces, basis)
    qdd, torque, faults = np.zeros(layout.joints), np.zeros(layout.joints), []
    residuals = np.zeros(2)
    for i, name in enumerate(layout.names):
        d, r = (slice(at[i], at[i + 1]) for at in (layout.dofs, layout.rows))
        M, W = read_inertia(b.pointers[i], d.stop - d.start), _own_W(data, i)
        A, a = _wanted_motion(data.model, name, ev, wanted, relative[name])
        qdd[d], left = _nearest(M, A, a, posture[name])
        if left > IMPOSSIBLE * (1.0 + np.max(np.abs(a), initial=0.0)):
            faults.append(f"arm '{name}' ({len(M)} joints) misses it by {left:.3g} m/s^2, rad/s^2")
        torque[d] = M @ qdd[d] - free[d] - W @ force[r]
        balance = M @ qdd[d] - free[d] - torque[d] - W @ force[r]
        gap = b.Wo[r] @ wanted + W.T @ qdd[d] - c[r]
        residuals = np.maximum(residuals, [np.max(np.abs(balance)), np.max(np.abs(gap))])
    if faults:
        raise SolverError(_impossible(faults))
    on_object = b.inertia @ wanted - h_o - b.Wo.T @ force
    return InverseDynamics(
        torques=layout.split_joints(torque),
        contact_forces=layout.split_contacts(force),
        joint_accelerations=layout.split_joints(qdd),
        residuals=Residuals(
            float(residuals[0]), float(np.max(np.abs(on_object))), float(residuals[1])
        ),
    )


def _wanted_motion(
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
    relative, space = relative_motion_of(model, state, name), ev.motion_space(name)
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
    closed = data.with_contacts_closed()
    return closed.view(closed.model.with_constants(control=NO_CONTROL, dense=True))


def _own_W(data: Data, i: int) -> np.ndarray:
    """Constraint matrix (n_i, N_i) of arm ``i`` at the kinematics in the buffers."""
    work = data.work
    return work.Y[i, : work.dofs[i + 1] - work.dofs[i], : work.rows[i + 1] - work.rows[i]].copy()


def _contact_forces(
    ev: Evaluation,
    wrench: np.ndarray,
    coordinates: np.ndarray | None,
    basis: str | InternalForces,
) -> np.ndarray:
    """Contact forces (N,) for a wrench on the object, world axes, and wanted internal forces."""
    W_o = np.hstack([terms.W_o for terms in ev.contact_terms.values()])
    R = quaternion_to_matrix(ev.state.object_quaternion_xyzw)
    form = ev.internal_forces(basis) if isinstance(basis, str) else basis
    own = np.concatenate([R.T @ wrench[:3], R.T @ wrench[3:]])
    return distribute(W_o, own, coordinates, form)


def _nearest(
    M: np.ndarray, A: np.ndarray, a: np.ndarray, preferred: np.ndarray
) -> tuple[np.ndarray, float]:
    """Joint accelerations with ``A q'' = a`` nearest to ``preferred``, and what is left over."""
    L = np.linalg.cholesky(M)
    B = np.linalg.solve(L, A.T).T
    size = np.linalg.norm(B, axis=1)
    scale = 1.0 / np.where(size > 0.0, size, 1.0)
    y = np.linalg.lstsq(scale[:, None] * B, scale * (a - A @ preferred), rcond=RANK_TOLERANCE)[0]
    qdd = preferred + np.linalg.solve(L.T, y)
    return qdd, float(np.max(np.abs(A @ qdd - a), initial=0.0))


def _impossible(faults: list[str]) -> str:
    return (
        "the wanted motion is not possible: " + "; ".join(faults) + "; leave the relative motion "
        "of such an arm free (`relative_acceleration={arm: None}`), or ask for another motion"
    )


def _relative_accelerations(
    model: Model, given: Mapping[str, np.ndarray | None]
) -> dict[str, np.ndarray | None]:
    """The wanted rates of the relative rates of every arm; None: left to the arm."""
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


def _require_arms(model: Model, what: str, given: Mapping[str, object]) -> None:
    for arm in given:
        if arm not in model.arms:
            names = ", ".join(model.arm_names)
            raise ModelError(f"{what}: unknown arm {arm!r}; arms are {names}")
