"""The same system in Pinocchio: its closed-loop algorithm, and the motion by an integrator.

Each joint of a scene is one or two rigid constraints between a tip and the object: a weld has 6
rows, a ball 3, and a hinge, for which Pinocchio has none, is written as two balls on its axis (6
rows, one of them redundant).

``constraintDynamics`` needs care: with a regularisation of zero, which it has as shipped, it
returns NaN or unconverged numbers without an exception when rows are redundant.

Motions are integrated in Python, as Pinocchio has no integrator.  For its best performance it gets
as few coordinates as possible: the object is attached to the last arm by one of Pinocchio's joints
(a weld makes it part of that arm's last link, a hinge and a ball add their own coordinates), and
only the other arms' joints are rigid constraints.  On two welded UR5s this takes two thirds of the
time of a free object with two welds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
from scipy.integrate import DOP853

from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.studies.peers import (
    Clock,
    Drive,
    Grid,
    Link,
    Peer,
    Sample,
    joint_ends,
    links,
    tip_frame,
)
from multiarm.studies.timing import OutOfTime

SETTINGS = (1e-10, 1e-10, 1e-10, 10)
"""Absolute and relative accuracy, regularisation, iterations."""
FREE = "free"
# The object's joint; a weld makes the object a part of the last link.
_OBJECT_JOINTS = {
    "ball": pin.JointModelSpherical,
    "revolute": pin.JointModelRZ,
    FREE: pin.JointModelFreeFlyer,
}
_ALIGNED = {
    True: (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
    False: (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
}
Slope = Callable[[float, np.ndarray], np.ndarray]
Course = Iterator[tuple[float, np.ndarray]]
"""Times and coordinates."""


class PinocchioPeer(Peer):
    """A system as one Pinocchio model, whose loops are closed by rigid constraints.

    Its coordinates ``y`` are Pinocchio's configuration and velocity: one number a joint, then those
    of the object's joint.  They are not projected onto the constraints.

    Parameters
    ----------
    system : System
    holder : str, optional
        The arm on whose last link the object hangs, the last one if left out; empty for a free
        object.
    """

    methods: ClassVar = {"RK4": "step", "SciPy DOP853": "tolerance"}

    def __init__(self, system: System, holder: str | None = None):
        super().__init__(system)
        holder = system.arm_names[-1] if holder is None else holder
        joints = {joint.arm: joint for joint in system.scene.joints}
        parts = {name: _rigid_parts(joint) for name, joint in joints.items()}
        self.model = pin.Model()
        self.model.gravity.linear = system.model.constants.gravity
        tips = {name: self._add_arm(name) for name in system.arm_names}
        frames = {name: pin.SE3(system.frames[name].on_object) for name in system.arm_names}
        self._kind = joints[holder].kind if holder else FREE
        self._last, self._tip = tips.get(holder, (0, pin.SE3.Identity()))
        self._on_object = frames.get(holder, pin.SE3.Identity())
        self._body, base = self._last, self._tip
        if self._kind in _OBJECT_JOINTS:
            joint = _OBJECT_JOINTS[self._kind]()
            self._body = self.model.addJoint(self._last, joint, self._tip, "object")
            base = pin.SE3.Identity()
        self._object = base * self._on_object.inverse()
        plant = system.model.constants
        inertia = pin.Inertia(plant.object_masses[0], np.zeros(3), plant.object_inertias[0])
        self.model.appendBodyToJoint(self._body, inertia, self._object)
        self.constraints = pin.StdVec_RigidConstraintModel()
        for name in joints:
            link, on_link = tips[name]
            on_body = self._object * frames[name]
            for kind, part in parts[name] if name != holder else ():
                self.constraints.append(
                    pin.RigidConstraintModel(
                        kind, self.model, link, on_link * part, self._body, on_body * part,
                        pin.ReferenceFrame.LOCAL,
                    )
                )  # fmt: skip
        self.data, self.constraint_data = self.model.createData(), self.new_constraint_data()
        pin.initConstraintDynamics(self.model, self.data, self.constraints, self.constraint_data)

    def _add_arm(self, name: str) -> tuple[int, pin.SE3]:
        """Its links and joints; the last joint, and the joint frame to the object there."""
        before, arm = self.model.njoints - 1, self.system.arms[name]
        for number, link in enumerate(links(arm), start=1):
            parent = before + link.parent if link.parent else 0
            label = f"{name}/{number}"
            joint = self.model.addJoint(parent, _joint(link), link.placement, label)
            self.model.appendBodyToJoint(joint, link.inertia, pin.SE3.Identity())
        return before + arm.tip.joint, pin.SE3(tip_frame(self.system, name))

    def new_constraint_data(self) -> pin.StdVec_RigidConstraintData:
        """What the algorithms keep for each constraint, as made anew."""
        data = pin.StdVec_RigidConstraintData()
        for constraint in self.constraints:
            data.append(constraint.createData())
        return data

    def solver(self) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """Accelerations by configuration, velocity and forces, with nothing in between."""
        model, data, dynamics = self.model, self.data, pin.constraintDynamics
        constraints, constraint_data = self.constraints, self.constraint_data
        settings = pin.ProximalSettings(*SETTINGS)
        return lambda q, v, tau: dynamics(
            model, data, q, v, tau, constraints, constraint_data, settings
        )

    def follow(
        self, clock: Clock, grid: Grid, start: State, method: str, value: float, drive: Drive
    ) -> Iterator[Sample]:
        """Integrate to every output (:meth:`.peers.Peer.follow`)."""
        slope, y = self.slope(clock, drive), self.coordinates(start)
        integrate = self._fixed if method == "RK4" else self._adaptive
        yield Sample(0.0, start)
        for t, row in integrate(clock, grid, slope, y, value):
            yield Sample(t, self.state(row))

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
        """DOP853, whose dense output meets the outputs within its tolerance.

        Steps that end at the outputs cost more: with one every 10 ms, 1.6 times as many evaluations
        for an error of 1e-11, and 12 times as many for 1e-3.
        """
        left = grid.times[1:]
        with clock:
            solver = DOP853(f, 0.0, y, left[-1], rtol=tolerance, atol=tolerance)
        while solver.status == "running":
            with clock:
                fault = solver.step()
            if solver.status == "failed":
                raise ArithmeticError(fault)
            clock.steps += 1
            with clock:
                due, left = left[left <= solver.t], left[left > solver.t]
                rows = solver.dense_output()(due).T if due.size else []
            yield from zip(due, rows, strict=True)

    def slope(self, clock: Clock, drive: Drive) -> Slope:
        """``dy/dt`` as a function of time and ``y``; it counts its calls and watches the clock."""
        model, solve, state, n = self.model, self.solver(), self.state, self.damping.size
        nq, end, flat = model.nq, model.nq + model.nv, model.nq == model.nv
        force, damping, damped = np.zeros(model.nv), self.damping, bool(np.any(self.damping))
        deadline = time.perf_counter() + clock.limit_s

        def f(t: float, y: np.ndarray) -> np.ndarray:
            clock.evaluations += 1
            if time.perf_counter() > deadline:
                raise OutOfTime
            q, v = y[:nq], y[nq:end]
            torque = drive(t, partial(state, y))
            force[:n] = torque - damping * v[:n] if damped else torque
            rate = v if flat else pin.tangentMapProduct(model, q, v)
            return np.concatenate([rate, solve(q, v, force)])

        return f

    def coordinates(self, state: State) -> np.ndarray:
        """``y`` of a state, shape (nq + nv,)."""
        n, data = self.damping.size, self.data
        q, v = pin.neutral(self.model), np.zeros(self.model.nv)
        q[:n] = state.layout.joint_positions(state.position)
        v[:n] = state.layout.joint_rates(state.velocity)
        pin.forwardKinematics(self.model, data, q, v)
        world_object = pin.XYZQUATToSE3(state.layout.poses(state.position)[0])
        turned = world_object.rotation.T
        twist = pin.Motion(turned @ state.object_twist[:3], turned @ state.object_twist[3:])
        relative = (data.oMi[self._last] * self._tip).actInv(world_object * self._on_object)
        tip_twist = self._tip.actInv(data.v[self._last])
        slip = self._on_object.actInv(twist) - relative.actInv(tip_twist)
        pose = pin.SE3ToXYZQUAT(relative)
        if self._kind == "revolute":
            pose[6] = 2.0 * math.atan2(pose[5], pose[6])
        q[n:] = pose[7 - (q.size - n) :]
        v[n:] = slip.vector[6 - (v.size - n) :]
        return np.concatenate([q, v])

    def state(self, y: np.ndarray) -> State:
        """The state of ``y``, its quaternion made a unit again."""
        data, n, nq = self.data, self.damping.size, self.model.nq
        q, v = pin.normalize(self.model, y[:nq]), y[nq : nq + self.model.nv]
        pin.forwardKinematics(self.model, data, q, v)
        pose = data.oMi[self._body] * self._object
        twist = self._object.actInv(data.v[self._body])
        return State(
            np.concatenate([pin.SE3ToXYZQUAT(pose), q[:n]]),
            np.concatenate([pose.rotation @ twist.linear, pose.rotation @ twist.angular, v[:n]]),
            self.system.model.layout,
        )


def _joint(link: Link) -> Any:
    """Pinocchio's joint of a link; those about or along a coordinate axis are the fastest."""
    for aligned, axis in zip(_ALIGNED[link.turns], np.eye(3), strict=True):
        if np.array_equal(link.axis, axis):
            return aligned()
    unaligned = pin.JointModelRevoluteUnaligned if link.turns else pin.JointModelPrismaticUnaligned
    return unaligned(*link.axis)


def _rigid_parts(joint: Any) -> list[tuple[pin.ContactType, pin.SE3]]:
    """The rigid constraints of a joint, placed in its frame, whose z axis is a hinge's axis."""
    ends = joint_ends(joint, "Pinocchio has no rigid constraint")
    kind = pin.ContactType.CONTACT_6D if joint.kind == "weld" else pin.ContactType.CONTACT_3D
    return [(kind, pin.SE3(np.eye(3), np.array([0.0, 0.0, end]))) for end in ends]
