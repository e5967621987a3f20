"""The same system in Pinocchio: its closed-loop algorithm, and the motion by an integrator.

Each joint of a scene is one or two rigid constraints between a tip and the object: a weld has 6
rows, a ball 3, and a hinge, for which Pinocchio has none, is written as two balls on its axis (6
rows, one of them redundant).

``constraintDynamics`` needs care: with a regularisation of zero, which it has as shipped, it
returns NaN or unconverged numbers without an exception when rows are redundant.

Motions are integrated in Python, as Pinocchio has no integrator.  For its best performance
:class:`PinocchioTree` gets as few coordinates as possible: the object is attached to the last arm
by one of Pinocchio's joints (a weld makes it part of that arm's last link, a hinge and a ball add
their own coordinates), and only the other arms' joints are rigid constraints.  On two welded UR5s
this takes two thirds of the time of a free object with two welds.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import ClassVar

import numpy as np
import pinocchio as pin
from scipy.integrate import DOP853

from multiarm.arms.arm import named_with_prefix
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.studies.peers import (
    Clock,
    Drive,
    Grid,
    Peer,
    Sample,
    Sinusoid,
    joint_ends,
    tip_frame,
)
from multiarm.studies.timing import OutOfTime

Settings = tuple[float, ...]
"""Absolute and relative accuracy, regularisation, iterations; empty: as shipped."""
FREE = "free"
# the object's joint and its coordinates; a weld makes the object a part of the last link
_OBJECT_JOINTS = {
    "ball": (pin.JointModelSpherical, 4),
    "revolute": (pin.JointModelRZ, 1),
    FREE: (pin.JointModelFreeFlyer, 7),
}
Slope = Callable[[float, np.ndarray], np.ndarray]
Course = Iterator[tuple[float, np.ndarray]]
"""Times and coordinates."""
Solve = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Accelerations by configuration, velocity and generalised forces."""


class PinocchioLoops(Peer):
    """A system as one Pinocchio model, whose loops are closed by rigid constraints.

    The state is ``y``: one number a joint, the object's own coordinates, all velocities, and the
    work of torques and damping where the object is free.  It is not projected onto the constraints.

    Parameters
    ----------
    system : System
    holder : str
        The arm on whose last link the object hangs; empty for a free object.
    """

    methods: ClassVar = {"RK4": "step", "SciPy DOP853": "tolerance"}
    fast: ClassVar[Settings] = (1e-10, 1e-10, 1e-10, 10)
    """Where an algorithm is timed."""
    precise: ClassVar[Settings] = fast
    """For accelerations, and for motions."""
    every_step: ClassVar[bool] = False
    """Samples of adaptive runs are after every step, not at the times of the grid."""

    def __init__(self, system: System, holder: str):
        super().__init__(system)
        self.model = pin.Model()
        for arm in system.arms.values():
            self.model = pin.appendModel(self.model, named_with_prefix(arm), 0, pin.SE3.Identity())
        self.model.gravity.linear = system.model.constants.gravity
        self._joints = {joint.arm: joint for joint in system.scene.joints}
        self._parts = {name: _rigid_parts(joint) for name, joint in self._joints.items()}
        self._attach_object(holder)
        self._close_loops(holder)
        self._circular = np.concatenate([arm.circular for arm in system.arms.values()]).astype(bool)

    def _attach_object(self, holder: str) -> None:
        """Make the object a part of the holder's last link, or a body on a joint of its own."""
        world = 0, pin.SE3.Identity(), pin.SE3.Identity()
        self._kind = self._joints[holder].kind if holder else FREE
        self._last, self._tip, on_object = self._place(holder) if holder else world
        self._on_object = on_object.rotation
        joint, coordinates = _OBJECT_JOINTS.get(self._kind, (None, 0))
        self._split = self.system.model.layout.joints + coordinates
        self._body, base = self._last, self._tip
        if joint is not None:
            self._body = self.model.addJoint(self._last, joint(), self._tip, "object")
            base = pin.SE3.Identity()
        self._object = base * on_object.inverse()
        plant = self.system.model.constants
        inertia = pin.Inertia(float(plant.object_mass), np.zeros(3), plant.object_inertia)
        self.model.appendBodyToJoint(self._body, inertia, self._object)

    def _place(self, name: str) -> tuple[int, pin.SE3, pin.SE3]:
        """An arm's last joint, and the frame of its joint to the object there and on the object."""
        system = self.system
        first = system.model.layout.dofs[system.model.layout.names.index(name)]
        frame = pin.SE3(system.frames[name].on_object)
        return first + system.arms[name].tip_joint, pin.SE3(tip_frame(system, name)), frame

    def _close_loops(self, holder: str) -> None:
        """Constrain the tips of all arms but the holder to the object."""
        self.constraints = pin.StdVec_RigidConstraintModel()
        for name, parts in self._parts.items():
            if name == holder:
                continue
            joint, on_tip, on_object = self._place(name)
            for kind, part in parts:
                self.constraints.append(
                    pin.RigidConstraintModel(
                        kind, self.model, joint, on_tip * part, self._body,
                        self._object * on_object * part, pin.ReferenceFrame.LOCAL,
                    )
                )  # fmt: skip
        self.data, self.constraint_data = self.model.createData(), self.new_constraint_data()
        pin.initConstraintDynamics(self.model, self.data, self.constraints, self.constraint_data)

    def new_constraint_data(self) -> pin.StdVec_RigidConstraintData:
        """What the algorithms keep for each constraint, as made anew."""
        data = pin.StdVec_RigidConstraintData()
        for constraint in self.constraints:
            data.append(constraint.createData())
        return data

    def evaluation(self, state: State, torque: np.ndarray) -> Callable[[], np.ndarray]:
        """A function without arguments, to be timed, that runs the algorithm once."""
        return self.call(*self.arguments(state, torque), self.fast)

    def arguments(
        self, state: State, torque: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pinocchio's configuration, velocity and generalised forces."""
        y, n = self.coordinates(state), torque.size
        v, tau = y[self._split :][: self.model.nv].copy(), np.zeros(self.model.nv)
        tau[:n] = torque - self.damping * v[:n]
        return self._configuration(y), v, tau

    def call(
        self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, settings: Settings
    ) -> Callable[[], np.ndarray]:
        """A function without arguments that runs the algorithm once."""
        return partial(
            pin.constraintDynamics, self.model, self.data, q, v, tau, self.constraints,
            self.constraint_data, pin.ProximalSettings(*settings),
        )  # fmt: skip

    def _solver(self) -> Solve:
        """The algorithm as a function, for motions.

        It raises where there is NaN, on which integrators with error control would try for ever.
        """

        def solve(q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
            accelerations = self.call(q, v, tau, self.precise)()
            if not np.all(np.isfinite(accelerations)):
                raise FloatingPointError("NaN")
            return accelerations

        return solve

    def follow(
        self, clock: Clock, grid: Grid, start: State, method: str, value: float, drive: Drive
    ) -> Iterator[Sample]:
        """Integrate to every output (:meth:`.peers.Peer.follow`)."""
        slope, y = self.slope(clock, drive), self.coordinates(start)
        integrate = self._fixed if method == "RK4" else self._adaptive
        for t, row in itertools.chain([(0.0, y)], integrate(clock, grid, slope, y, value)):
            yield Sample(t, self.state(row), float(row[-1]) if self._kind == FREE else None)

    def _fixed(self, clock: Clock, grid: Grid, f: Slope, y: np.ndarray, h: float) -> Course:
        count, interval = grid.steps(h), grid.interval
        for k in range(grid.intervals):
            with clock:
                for i in range(count):
                    t = k * interval + i * h
                    a = f(t, y)
                    b = f(t + 0.5 * h, y + (0.5 * h) * a)
                    c = f(t + 0.5 * h, y + (0.5 * h) * b)
                    d = f(t + h, y + h * c)
                    y = y + (h / 6.0) * (a + 2.0 * (b + c) + d)
            clock.steps += count
            yield (k + 1) * interval, y

    def _adaptive(
        self, clock: Clock, grid: Grid, f: Slope, y: np.ndarray, tolerance: float
    ) -> Course:
        """DOP853; its dense output, which is less accurate than its steps, meets the outputs."""
        left = grid.times[1:]
        with clock:
            solver = DOP853(f, 0.0, y, left[-1], rtol=tolerance, atol=tolerance)
        while solver.status == "running":
            with clock:
                fault = solver.step()
                due, left = left[left <= solver.t], left[left > solver.t]
                if self.every_step:
                    due, rows = [solver.t], [solver.y]
                else:
                    rows = solver.dense_output()(due).T if due.size else []
            if solver.status == "failed":
                raise ArithmeticError(fault)
            clock.steps += 1
            yield from zip(due, rows, strict=True)

    def slope(self, clock: Clock, drive: Drive) -> Slope:
        """``dy/dt`` as a function of time and ``y``; it counts its calls and watches the clock."""
        n, split, width = self.damping.size, self._split, self._split + self.model.nv
        plain, configuration = not self._circular.any(), self._configuration
        solve, torques = self._solver(), self._torques(drive)
        torque, damping = np.zeros(self.model.nv), self.damping
        deadline = time.perf_counter() + clock.limit_s
        damped, hinge, free = bool(np.any(damping)), self._kind == "revolute", self._kind == FREE
        turning = self._kind in (FREE, "ball")

        def f(t: float, y: np.ndarray) -> np.ndarray:
            clock.evaluations += 1
            if time.perf_counter() > deadline:
                raise OutOfTime
            v = y[split:width]
            tau = torques(t, y)
            torque[:n] = tau - damping * v[:n] if damped else tau
            out = np.empty(y.size)
            out[:n] = v[:n]
            if turning:
                rates = _quaternion_rate(y[split - 4 : split].tolist(), v[-3:].tolist())
                out[split - 4 : split] = rates
            elif hinge:
                out[n] = v[n]
            if free:
                out[n : n + 3] = _se3(y[n:split]).rotation @ v[n : n + 3]
                out[width] = torque[:n] @ v[:n]
            out[split:width] = solve(y[:split] if plain else configuration(y), v, torque)
            return out

        return f

    def _torques(self, drive: Drive) -> Slope:
        """Torques as a function of time and of ``y``, which sinusoids do not look at."""
        if not isinstance(drive, Sinusoid):
            return lambda t, y: drive(t, self.state(y))
        rate, constant, sine, cosine = drive.rate, drive.constant, drive.sine, drive.cosine
        if drive.is_constant:
            return lambda t, _: constant
        return lambda t, _: constant + math.sin(rate * t) * sine + math.cos(rate * t) * cosine

    def _configuration(self, y: np.ndarray) -> np.ndarray:
        """Pinocchio's configuration vector: two numbers for a joint that turns without end."""
        angles = y[: self._circular.size]
        parts = np.column_stack([np.where(self._circular, np.cos(angles), angles), np.sin(angles)])
        keep = np.column_stack([np.ones_like(self._circular), self._circular])
        return np.concatenate([parts[keep], y[angles.size : self._split]])

    def coordinates(self, state: State) -> np.ndarray:
        """``y`` of a state, shape (m + nv,), or (m + nv + 1,) of a free object."""
        n, split = self.damping.size, self._split
        y = np.zeros(split + self.model.nv + (self._kind == FREE))
        y[:n] = state.layout.joint_positions(state.position)
        y[split : split + n] = state.layout.joint_rates(state.velocity)
        data, pose, rate = self.data, y[n:split], y[split + n :]
        object_pose = state.layout.poses(state.position)[0]
        R_O, twist = _se3(object_pose).rotation, state.object_twist
        if self._kind == FREE:
            pose[:], rate[:3], rate[3:6] = object_pose, R_O.T @ twist[:3], R_O.T @ twist[3:]
        if self._kind not in ("ball", "revolute"):
            return y
        pose[-1] = 1.0 if self._kind == "ball" else 0.0
        pin.forwardKinematics(self.model, data, self._configuration(y), y[split:])
        R_A, R_B = (data.oMi[self._last] * self._tip).rotation, R_O @ self._on_object
        tip_turns = data.oMi[self._last].rotation @ data.v[self._last].angular
        turning, relative = R_B.T @ (twist[3:] - tip_turns), R_A.T @ R_B
        if self._kind == "ball":
            pose[:], rate[:] = pin.Quaternion(relative).coeffs(), turning
        else:
            pose[0], rate[0] = math.atan2(relative[1, 0], relative[0, 0]), turning[2]
        return y

    def state(self, y: np.ndarray) -> State:
        """The state of ``y``, its quaternion made a unit again."""
        data, n, split = self.data, self.damping.size, self._split
        y = y.copy()
        if self._kind in (FREE, "ball"):
            y[split - 4 : split] /= np.linalg.norm(y[split - 4 : split])
        v = y[split:][: self.model.nv]
        pin.forwardKinematics(self.model, data, self._configuration(y), v)
        pose = data.oMi[self._body] * self._object
        twist = self._object.actInv(data.v[self._body])
        return State(
            np.concatenate([pin.SE3ToXYZQUAT(pose), y[:n]]),
            np.concatenate([pose.rotation @ twist.linear, pose.rotation @ twist.angular, v[:n]]),
            self.system.model.layout,
        )


class PinocchioTree(PinocchioLoops):
    """``constraintDynamics`` on as few coordinates as possible: the object is on the last arm."""

    def __init__(self, system: System):
        super().__init__(system, holder=system.arm_names[-1])

    def _solver(self) -> Solve:
        """The same with nothing in between, since this motion is timed."""
        model, data, dynamics = self.model, self.data, pin.constraintDynamics
        constraints, constraint_data = self.constraints, self.constraint_data
        settings = pin.ProximalSettings(*self.fast)
        return lambda q, v, tau: dynamics(
            model, data, q, v, tau, constraints, constraint_data, settings
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


def _se3(pose: np.ndarray) -> pin.SE3:
    return pin.XYZQUATToSE3(np.asarray(pose, dtype=float))
