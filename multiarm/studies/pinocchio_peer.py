"""The same system in Pinocchio: its closed-loop algorithms, and the motion by an integrator.

Each joint of a scene is one or two rigid constraints between a tip and the object: a weld has 6
rows, a ball 3, and a hinge, for which Pinocchio has none, is written as two balls on its axis (6
rows, one of them redundant).

:class:`PinocchioForest` has the object as a free-flyer beside all arms.  Its algorithms need care:
with a regularisation of zero, which is what ``constraintDynamics`` has as shipped, they return NaN
or unconverged numbers without an exception when rows are redundant, and ``lcaba`` keeps state in
its ``Data`` between calls.

:class:`PinocchioMotion` integrates ``constraintDynamics`` in Python, as Pinocchio has no
integrator.  For its best performance it gets as few coordinates as possible: the object is attached
to the last arm by one of Pinocchio's joints (a weld makes it part of that arm's last link, a hinge
and a ball add their own coordinates), and only the other arms' joints are rigid constraints.  On
two welded UR5s this takes two thirds of the time of a free object with two welds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import ClassVar

import numpy as np
import pinocchio as pin

from multiarm.arms.arm import named_with_prefix
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.studies.observables import Sinusoid
from multiarm.studies.peers import Drive, joint_ends, tip_frame
from multiarm.studies.time_series import Grid, OutOfTime, TimeSeries

_ALGORITHMS = {
    "constraintDynamics": (1e-14, 1e-14, 1e-10, 50),
    "constraintDynamics as shipped": (),
    "lcaba": (1e-12, 1e-12, 1e-3, 100),
}
# Accuracies, regularisation, iterations.  All but the shipped ones were chosen, among four, as the
# most precise on two welded UR5s, folded and straight; other systems may want others.
_FAST = (1e-10, 1e-10, 1e-10, 10)
"""The same where an algorithm is timed or integrated."""

Slope = Callable[[float, np.ndarray], np.ndarray]


class _Loops:
    """Arms as one Pinocchio model, and the rigid constraints that close them at the object."""

    def __init__(self, system: System):
        self.system, self.model = system, pin.Model()
        for arm in system.arms.values():
            self.model = pin.appendModel(self.model, named_with_prefix(arm), 0, pin.SE3.Identity())
        self.model.gravity.linear = system.model.constants.gravity
        self._joints = {joint.arm: joint for joint in system.scene.joints}
        self._parts = {name: _rigid_parts(joint) for name, joint in self._joints.items()}

    def _place(self, name: str) -> tuple[int, pin.SE3, pin.SE3]:
        """An arm's last joint, and the frame of its joint to the object there and on the object."""
        system = self.system
        first = system.model.layout.dofs[system.model.layout.names.index(name)]
        frame = pin.SE3(system.frames[name].on_object)
        return first + system.arms[name].tip_joint, pin.SE3(tip_frame(system, name)), frame

    def _add_object(self, joint: int, at: pin.SE3) -> None:
        plant = self.system.model.constants
        inertia = pin.Inertia(float(plant.object_mass), np.zeros(3), plant.object_inertia)
        self.model.appendBodyToJoint(joint, inertia, at)

    def _close(self, body: int, at: pin.SE3, without: str = "") -> None:
        """Constrain the tips of all arms but one to the object, which is at ``at`` on a joint."""
        self.constraints = pin.StdVec_RigidConstraintModel()
        for name, parts in self._parts.items():
            if name == without:
                continue
            joint, on_tip, on_object = self._place(name)
            for kind, part in parts:
                self.constraints.append(
                    pin.RigidConstraintModel(
                        kind, self.model, joint, on_tip * part, body, at * on_object * part,
                        pin.ReferenceFrame.LOCAL,
                    )
                )  # fmt: skip
        self.data, self.constraint_data = self.model.createData(), self._constraint_data()
        pin.initConstraintDynamics(self.model, self.data, self.constraints, self.constraint_data)

    def _constraint_data(self):
        data = pin.StdVec_RigidConstraintData()
        for constraint in self.constraints:
            data.append(constraint.createData())
        return data

    def _call(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> Callable[[], np.ndarray]:
        """A function without arguments that runs ``constraintDynamics`` once."""
        return partial(
            pin.constraintDynamics, self.model, self.data, q, v, tau, self.constraints,
            self.constraint_data, pin.ProximalSettings(*_FAST),
        )  # fmt: skip


class PinocchioForest(_Loops):
    """The system as one Pinocchio model whose loops are closed by rigid constraints.

    Parameters
    ----------
    system : System
        Welds, balls and hinges only.

    Raises
    ------
    ModelError
        For a joint that Pinocchio has no rigid constraint for.
    """

    def __init__(self, system: System):
        super().__init__(system)
        body = self.model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "object")
        self._add_object(body, pin.SE3.Identity())
        self._close(body, pin.SE3.Identity())

    def coordinates(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Pinocchio's configuration and velocity of a state."""
        q = [arm.configuration(state.joint_positions[n]) for n, arm in self.system.arms.items()]
        rotation = _se3(state.position).rotation
        twist = state.object_twist
        local = np.concatenate([rotation.T @ twist[:3], rotation.T @ twist[3:]])
        return (
            np.concatenate([*q, state.position[:7]]),
            np.concatenate([*state.joint_velocities.values(), local]),
        )

    def torques(self, torque: np.ndarray) -> np.ndarray:
        """Generalised forces of joint torques."""
        return np.concatenate([torque, np.zeros(6)])

    def accelerations(
        self, state: State, torque: np.ndarray, algorithm: str = "constraintDynamics"
    ) -> tuple[np.ndarray, np.ndarray]:
        """Object's classical acceleration in world axes (6,) and the joints' (n,).

        ``algorithm`` is ``constraintDynamics``, ``constraintDynamics as shipped`` or ``lcaba``.
        What it returns is passed on as it is, NaN too.
        """
        q, v = self.coordinates(state)
        settings = pin.ProximalSettings(*_ALGORITHMS[algorithm])
        if algorithm == "lcaba":
            data, constraint_data = self.model.createData(), self._constraint_data()
            pin.computeJointMinimalOrdering(self.model, data, self.constraints)
            run = pin.lcaba
        else:
            data, constraint_data = self.data, self.constraint_data
            run = pin.constraintDynamics
        a = run(
            self.model, data, q, v, self.torques(torque), self.constraints, constraint_data,
            settings,
        )  # fmt: skip
        rotation, local = _se3(state.position).rotation, v[-6:]
        linear = rotation @ (a[-6:-3] + np.cross(local[3:], local[:3]))
        return np.concatenate([linear, rotation @ a[-3:]]), a[:-6].copy()

    def constraint_dynamics_call(self, state: State, torque: np.ndarray):
        """A function without arguments that runs ``constraintDynamics`` once."""
        return self._call(*self.coordinates(state), self.torques(torque))

    def lcaba_call(self, state: State, torque: np.ndarray, mu: float = 1e-6):
        """A function without arguments that runs ``lcaba`` once."""
        data, constraint_data = self.model.createData(), self._constraint_data()
        pin.computeJointMinimalOrdering(self.model, data, self.constraints)
        return partial(
            pin.lcaba, self.model, data, *self.coordinates(state), self.torques(torque),
            self.constraints, constraint_data, pin.ProximalSettings(1e-10, 1e-10, mu, 10),
        )  # fmt: skip


class PinocchioMotion(_Loops):
    """A system as one Pinocchio model in which the object hangs on the last arm.

    The state is ``y``: one number a joint, the object's own coordinates, all velocities.  It is not
    projected onto the constraints.

    Parameters
    ----------
    system : System
        Welds, balls and hinges only.
    damping : ndarray, shape (n,)
        Of the joints [N m s/rad, N s/m].

    Raises
    ------
    ModelError
        For a joint that Pinocchio has no rigid constraint for.
    """

    methods: ClassVar = {"RK4": "step", "SciPy DOP853": "tolerance"}

    def __init__(self, system: System, damping: np.ndarray):
        from scipy.integrate import solve_ivp  # it takes its time, which is not that of a run

        super().__init__(system)
        self._solve_ivp, self.damping = solve_ivp, damping
        last = system.arm_names[-1]
        self._kind = self._joints[last].kind
        self._last, self._tip, on_object = self._place(last)
        self._on_object = on_object.rotation
        hanging = {"ball": pin.JointModelSpherical, "revolute": pin.JointModelRZ}.get(self._kind)
        if hanging is None:
            self._body, base = self._last, self._tip
        else:
            self._body = self.model.addJoint(self._last, hanging(), self._tip, "object")
            base = pin.SE3.Identity()
        self._object = base * on_object.inverse()
        self._add_object(self._body, self._object)
        self._close(self._body, self._object, without=last)
        self._circular = np.concatenate([arm.circular for arm in system.arms.values()]).astype(bool)
        self._split = system.model.layout.joints + {"ball": 4, "revolute": 1}.get(self._kind, 0)

    def follow(
        self,
        series: TimeSeries,
        grid: Grid,
        start: State,
        method: str,
        value: float,
        drive: Drive,
    ) -> None:
        """Integrate to every output and record the motion.

        ``method`` is one of ``methods``, ``value`` its step [s] or its tolerance, ``drive`` the
        torques, of time alone or of time and state.
        """
        slope, y = self.slope(series, drive), self.coordinates(start)
        found = (self._fixed if method == "RK4" else self._adaptive)(series, grid, slope, y, value)
        for y in found:
            if not np.all(np.isfinite(y)):
                return
            series.positions.append(self.state(y).position)

    def _fixed(self, series: TimeSeries, grid: Grid, f: Slope, y: np.ndarray, h: float):
        count, found = grid.steps(h), [y]
        for k in range(grid.intervals):
            series.start()
            for i in range(count):
                t = k * grid.interval + i * h
                a = f(t, y)
                b = f(t + 0.5 * h, y + (0.5 * h) * a)
                c = f(t + 0.5 * h, y + (0.5 * h) * b)
                d = f(t + h, y + h * c)
                y = y + (h / 6.0) * (a + 2.0 * (b + c) + d)
            series.steps += count
            series.stop()
            found.append(y)
        return found

    def _adaptive(self, series: TimeSeries, grid: Grid, f: Slope, y: np.ndarray, tolerance: float):
        times = grid.times
        series.start()
        run = self._solve_ivp(
            f, (0.0, times[-1]), y, "DOP853", t_eval=times, rtol=tolerance, atol=tolerance
        )
        series.stop()
        series.steps = (series.evaluations - 2) // 12  # rejected ones too; more for its output
        return run.y.T

    def slope(self, series: TimeSeries, drive: Drive) -> Slope:
        """``dy/dt`` as a function of time and ``y``; it counts its calls and watches the clock."""
        model, data = self.model, self.data
        constraints, constraint_data = self.constraints, self.constraint_data
        settings, dynamics = pin.ProximalSettings(*_FAST), pin.constraintDynamics
        n, split, width = self.system.model.layout.joints, self._split, self._split + model.nv
        plain, configuration = not self._circular.any(), self._configuration
        torque, damping = np.zeros(model.nv), self.damping
        torques = self._torques(drive)
        damped, ball, hinge = bool(np.any(damping)), self._kind == "ball", self._kind == "revolute"
        deadline = time.perf_counter() + series.limit_s

        def f(t: float, y: np.ndarray) -> np.ndarray:
            series.evaluations += 1
            if time.perf_counter() > deadline:
                raise OutOfTime
            v = y[split:]
            tau = torques(t, y)
            torque[:n] = tau - damping * v[:n] if damped else tau
            out = np.empty(width)
            out[:n] = v[:n]
            if ball:
                out[n:split] = _quaternion_rate(y[n:split].tolist(), v[n:].tolist())
            elif hinge:
                out[n] = v[n]
            q = y[:split] if plain else configuration(y)
            out[split:] = dynamics(
                model, data, q, v, torque, constraints, constraint_data, settings
            )
            return out

        return f

    def acceleration_call(self, state: State, torque: np.ndarray) -> Callable[[], np.ndarray]:
        """A function without arguments that runs ``constraintDynamics`` once."""
        y = self.coordinates(state)
        q = self._configuration(y) if self._circular.any() else y[: self._split].copy()
        v = y[self._split :].copy()
        forces = np.concatenate([torque, np.zeros(v.size - torque.size)])
        return self._call(q, v, forces)

    def _torques(self, drive: Drive) -> Slope:
        """Torques as a function of time and ``y``."""
        if not isinstance(drive, Sinusoid):
            return lambda t, y: drive(t, self.state(y))
        rate, constant, sine, cosine = drive.rate, drive.constant, drive.sine, drive.cosine
        if drive.is_constant:
            return lambda t, y: constant

        def swinging(t: float, _y: np.ndarray) -> np.ndarray:
            return constant + math.sin(rate * t) * sine + math.cos(rate * t) * cosine

        return swinging

    def _configuration(self, y: np.ndarray) -> np.ndarray:
        """Pinocchio's configuration vector: two numbers for a joint that turns without end."""
        angles = y[: self.system.model.layout.joints]
        parts = np.column_stack([np.where(self._circular, np.cos(angles), angles), np.sin(angles)])
        keep = np.column_stack([np.ones_like(self._circular), self._circular])
        return np.concatenate([parts[keep], y[angles.size : self._split]])

    def coordinates(self, state: State) -> np.ndarray:
        """``y`` of a state, shape (m + nv,)."""
        n, split = self.system.model.layout.joints, self._split
        y = np.zeros(split + self.model.nv)
        y[:n], y[split : split + n] = state.position[7:], state.velocity[6:]
        if split == n:
            return y
        data, turn, rate = self.data, y[n:split], y[split + n :]
        turn[-1] = 1.0 if self._kind == "ball" else 0.0
        pin.forwardKinematics(self.model, data, self._configuration(y), y[split:])
        R_A = (data.oMi[self._last] * self._tip).rotation
        R_B = _se3(state.position).rotation @ self._on_object
        tip_turns = data.oMi[self._last].rotation @ data.v[self._last].angular
        turning, relative = R_B.T @ (state.object_twist[3:] - tip_turns), R_A.T @ R_B
        if self._kind == "ball":
            turn[:], rate[:] = pin.Quaternion(relative).coeffs(), turning
        else:
            turn[0], rate[0] = math.atan2(relative[1, 0], relative[0, 0]), turning[2]
        return y

    def state(self, y: np.ndarray) -> State:
        """The state of ``y``, its quaternion made a unit again."""
        model, data, n = self.model, self.data, self.system.model.layout.joints
        y = y.copy()
        if self._kind == "ball":
            y[n : self._split] /= np.linalg.norm(y[n : self._split])
        v = y[self._split :]
        pin.forwardKinematics(model, data, self._configuration(y), v)
        pose = data.oMi[self._body] * self._object
        twist = self._object.actInv(data.v[self._body])
        return State(
            np.concatenate([pin.SE3ToXYZQUAT(pose), y[:n]]),
            np.concatenate([pose.rotation @ twist.linear, pose.rotation @ twist.angular, v[:n]]),
            self.system.model.layout,
        )


def _quaternion_rate(q: list[float], w: list[float]) -> tuple[float, float, float, float]:
    """``dq/dt`` of a quaternion xyzw, the angular velocity in the moving axes."""
    x, y, z, s = q
    a, b, c = w
    return (
        0.5 * (s * a + y * c - z * b),
        0.5 * (s * b + z * a - x * c),
        0.5 * (s * c + x * b - y * a),
        -0.5 * (x * a + y * b + z * c),
    )


def _rigid_parts(joint) -> list[tuple[pin.ContactType, pin.SE3]]:
    """The rigid constraints of a joint, placed in its frame, whose z axis is a hinge's axis."""
    ends = joint_ends(joint, "Pinocchio has no rigid constraint")
    kind = pin.ContactType.CONTACT_6D if joint.kind == "weld" else pin.ContactType.CONTACT_3D
    return [(kind, pin.SE3(np.eye(3), np.array([0.0, 0.0, end]))) for end in ends]


def _se3(position: np.ndarray) -> pin.SE3:
    return pin.XYZQUATToSE3(np.asarray(position[:7], dtype=float))
