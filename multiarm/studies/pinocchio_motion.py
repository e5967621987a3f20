"""The motion of a system by Pinocchio's ``constraintDynamics`` and an integrator in Python.

Pinocchio has no integrator.  For its best performance it gets as few coordinates as possible: the
object is attached to the last arm by one of Pinocchio's joints (a weld makes it part of that arm's
last link, a hinge and a ball add their own coordinates), and only the other arms' joints are rigid
constraints.  On two welded UR5s this takes two thirds of the time of a free object with two welds.

The state is ``y``: one number a joint, the object's own coordinates, all velocities.  It is not
projected onto the constraints.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from multiarm.arms.arm import named_with_prefix
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.studies.observables import Sinusoid
from multiarm.studies.peers import rigid_parts
from multiarm.studies.time_series import Grid, OutOfTime, TimeSeries

METHODS = {"RK4": "step", "SciPy DOP853": "tolerance"}
"""Integrators, and what sets their accuracy."""
_SETTINGS = (1e-10, 1e-10, 1e-10, 10)  # accuracies, regularisation, iterations

Slope = Callable[[float, np.ndarray], np.ndarray]


class PinocchioMotion:
    """A system as one Pinocchio model in which the object hangs on the last arm.

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

    def __init__(self, system: System, damping: np.ndarray):
        from scipy.integrate import solve_ivp  # it takes its time, which is not that of a run

        self._solve_ivp = solve_ivp
        self.system, self.damping = system, damping
        model = pin.Model()
        for arm in system.arms.values():
            model = pin.appendModel(model, named_with_prefix(arm), 0, pin.SE3.Identity())
        self._places = {joint.arm: self._place(joint.arm) for joint in system.scene.joints}
        parts = {joint.arm: rigid_parts(joint) for joint in system.scene.joints}
        last = system.arm_names[-1]
        self._kind = next(joint.kind for joint in system.scene.joints if joint.arm == last)
        self._last, tip, on_object = self._places[last]
        plant = system.model.constants
        inertia = pin.Inertia(float(plant.object_mass), np.zeros(3), plant.object_inertia)
        hanging = {"ball": pin.JointModelSpherical, "revolute": pin.JointModelRZ}.get(self._kind)
        if hanging is None:
            self._body, base = self._last, tip
        else:
            self._body = model.addJoint(self._last, hanging(), tip, "object")
            base = pin.SE3.Identity()
        self._object = base * on_object.inverse()
        model.appendBodyToJoint(self._body, inertia, self._object)
        model.gravity.linear = plant.gravity
        self.model = model
        self._circular = np.concatenate([arm.circular for arm in system.arms.values()]).astype(bool)
        self._split = system.model.layout.joints + {"ball": 4, "revolute": 1}.get(self._kind, 0)
        self.constraints = pin.StdVec_RigidConstraintModel()
        for name, (joint, on_tip, at) in self._places.items():
            for kind, place in parts[name] if name != last else ():
                self.constraints.append(
                    pin.RigidConstraintModel(
                        kind, model, joint, on_tip * place, self._body, self._object * at * place,
                        pin.ReferenceFrame.LOCAL,
                    )
                )  # fmt: skip
        self.data, self._constraint_data = model.createData(), pin.StdVec_RigidConstraintData()
        for constraint in self.constraints:
            self._constraint_data.append(constraint.createData())
        pin.initConstraintDynamics(model, self.data, self.constraints, self._constraint_data)

    def _place(self, name: str) -> tuple[int, pin.SE3, pin.SE3]:
        """An arm's last joint, and the frame of its joint to the object there and on the object."""
        system = self.system
        arm, frame = system.arms[name], system.frames[name]
        first = system.model.layout.dofs[system.model.layout.names.index(name)]
        on_tip = pin.SE3(arm.tip_rotation, arm.tip_translation) * pin.SE3(frame.on_tip)
        return first + arm.tip_joint, on_tip, pin.SE3(frame.on_object)

    def follow(
        self,
        series: TimeSeries,
        grid: Grid,
        start: State,
        method: str,
        value: float,
        drive: Sinusoid | Callable[[float, State], np.ndarray],
    ) -> None:
        """Integrate to every output and record the motion.

        ``method`` is one of ``METHODS``, ``value`` its step [s] or its tolerance, ``drive`` the
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

    def slope(
        self, series: TimeSeries, drive: Sinusoid | Callable[[float, State], np.ndarray]
    ) -> Slope:
        """``dy/dt`` as a function of time and ``y``; it counts its calls and watches the clock."""
        model, data = self.model, self.data
        constraints, constraint_data = self.constraints, self._constraint_data
        settings, dynamics = pin.ProximalSettings(*_SETTINGS), pin.constraintDynamics
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
        model, data, settings = self.model, self.data, pin.ProximalSettings(*_SETTINGS)
        constraints, constraint_data = self.constraints, self._constraint_data
        run = pin.constraintDynamics

        def call() -> np.ndarray:
            return run(model, data, q, v, forces, constraints, constraint_data, settings)

        return call

    def _torques(self, drive: Sinusoid | Callable[[float, State], np.ndarray]) -> Slope:
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
        _, tip, on_object = self._places[self.system.arm_names[-1]]
        R_A = (data.oMi[self._last] * tip).rotation
        R_B = pin.XYZQUATToSE3(state.position[:7]).rotation @ on_object.rotation
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
