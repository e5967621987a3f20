"""Scenes of :mod:`random_friction_scenes` once more, from their tables, in NumPy and Pinocchio.

Bodies are the world, the objects and the tips of the arms.  A contact is between a point or a
sphere of one body and a plane of another; its frame has the plane's normal and two tangents, and
forces are those on the body of the point.  Nothing here calls the package but for the files of
robots.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from random_friction_scenes import Table, box_corners
from scipy.spatial.transform import Rotation

from multiarm.scene import find_robot

WORLD = "world"


class WrittenContact(NamedTuple):
    """A contact as the scene has it, and where results have it."""

    channel: str  # key of `contact_forces`
    index: int  # among the contacts of the channel
    body: str
    point: np.ndarray  # (3,) or the centre of a sphere, in the body's frame [m]
    radius: float  # [m]
    base: str  # the body of the plane
    place: np.ndarray  # (3,) of the plane, in its body's frame [m]
    frame: np.ndarray  # (3, 3) normal out of the plane's body and two tangents, in its frame
    mu: float | None
    restitution: float
    pushes_base: bool  # whether results have the force on the plane's body


def contacts_of(table: Table) -> list[WrittenContact]:
    """The contacts of all joints with ``contacts`` and of the floor."""
    effects = table["effects"]
    unilateral = effects.get("unilateral_contacts", {})
    friction = effects.get("contact_friction")
    objects = objects_of(table)
    found = []
    for joint in table["joints"]:
        if joint["kind"] != "contacts":
            continue
        if "arm" in joint:
            ends = joint["arm"], joint.get("object", next(iter(objects)))
            channel = joint["arm"]
        else:
            ends = tuple(joint["between"])
            channel = joint.get("name", "-".join(ends))
        for k, contact in enumerate(joint["contacts"]):
            first, plane = contact["arm"], contact["object"]["plane"]
            sphere = first.get("sphere")
            found.append(WrittenContact(
                channel, k, ends[0],
                np.array(first["point"] if sphere is None else sphere["center"]),
                0.0 if sphere is None else sphere["radius"],
                ends[1], np.array(plane["point"]), _frame_of(plane["normal"]),
                None if friction is None else friction["mu"],
                unilateral.get("restitution", 0.0), True,
            ))  # fmt: skip
    floor = effects.get("floor")
    if floor is not None:
        for name in [floor["object"]] if "object" in floor else objects:
            points = floor.get("points", box_corners(objects[name]["shape"]["box"]))
            for k, point in enumerate(np.array(points)):
                found.append(WrittenContact(
                    f"floor/{name}" if len(objects) > 1 else "floor", k, name, point, 0.0, WORLD,
                    np.array(floor.get("at", {}).get("xyz", [0.0, 0.0, 0.0])),
                    _frame_of([0.0, 0.0, 1.0]), floor.get("mu"), floor.get("restitution", 0.0),
                    False,
                ))  # fmt: skip
    return found


def _frame_of(normal: Any) -> np.ndarray:
    """A unit normal and two tangents, shape (3, 3)."""
    n = np.array(normal, dtype=float)
    first = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    first /= np.linalg.norm(first)
    return np.array([n, first, np.cross(n, first)])


def objects_of(table: Table) -> dict[str, Table]:
    return table["objects"] if "objects" in table else {"object": table["object"]}


class State(NamedTuple):
    """Poses and twists of the objects, positions and rates of the joints."""

    positions: np.ndarray  # (F, 3) [m]
    rotations: np.ndarray  # (F, 3, 3)
    joints: list[np.ndarray]  # of each arm [rad]
    velocity: np.ndarray  # (6 F + n,) twists in world axes, then rates


class Body(NamedTuple):
    """Pose and motion of a body in world axes."""

    rotation: np.ndarray
    origin: np.ndarray
    jacobian: np.ndarray  # (6, nv) of the origin, linear and angular
    bias: np.ndarray  # (6,) acceleration of the origin (classical) without that of the coordinates


class Mechanism(NamedTuple):
    """What the equations of motion of one state need."""

    bodies: dict[str, Body]
    inverse_inertia: np.ndarray  # (nv, nv)
    force: np.ndarray  # (nv,) everything but contacts, drives and dry friction


def skew(r: np.ndarray) -> np.ndarray:
    """Matrices of cross products with vectors, shape (..., 3, 3)."""
    S = np.zeros((*r.shape, 3))
    S[..., 2, 1], S[..., 0, 2], S[..., 1, 0] = r[..., 0], r[..., 1], r[..., 2]
    S[..., 1, 2], S[..., 2, 0], S[..., 0, 1] = -r[..., 0], -r[..., 1], -r[..., 2]
    return S


@cache
def _model(robot: str) -> pin.Model:
    return pin.buildModelFromUrdf(str(find_robot(robot).urdf))


class _Arm:
    """An arm's model, whose world is the scene's."""

    def __init__(self, name: str, table: Table, first: int, gravity: Any) -> None:
        base = table["base"]
        turn = Rotation.from_euler("xyz", base.get("rpy", [0.0, 0.0, 0.0])).as_matrix()
        X = pin.SE3(turn, np.array(base["xyz"], dtype=float))
        self.model = _model(table["robot"]).copy()
        for frame in self.model.frames:
            if frame.parentJoint == 0:
                frame.placement = X * frame.placement
        for joint in range(1, self.model.njoints):
            if self.model.parents[joint] == 0:
                self.model.jointPlacements[joint] = X * self.model.jointPlacements[joint]
        self.model.gravity.linear = np.array(gravity, dtype=float)
        self.data = self.model.createData()
        self.name, self.start = name, np.array(table["posture"], dtype=float)
        self.tip = self.model.getFrameId(table["tip"])
        self.columns = slice(first, first + self.model.nv)


class Oracle:
    """Equations of motion of a table."""

    def __init__(self, table: Table) -> None:
        self.table = table
        self.objects = objects_of(table)
        gravity = table["gravity"] or [0.0, 0.0, 0.0]
        self.arms: list[_Arm] = []
        first = 6 * len(self.objects)
        for name, arm in table.get("arms", {}).items():
            self.arms.append(_Arm(name, arm, first, gravity))
            first = self.arms[-1].columns.stop
        self.nv, self.gravity = first, np.array(gravity, dtype=float)
        self.masses = np.array([body["mass"] for body in self.objects.values()])
        sizes = np.array([body["shape"]["box"] for body in self.objects.values()])
        squares = sizes**2
        self.moments = self.masses[:, None] / 12.0 * (np.sum(squares, axis=1)[:, None] - squares)
        self.contacts = contacts_of(table)
        self.control = table.get("control", {"kind": "none"})
        self.damping = table["effects"].get("joint_damping", 0.0)
        self.wrenches = table["effects"].get("external_wrenches", [])
        self.held = np.zeros(self.nv)

    def start(self) -> State:
        """As the table has it."""
        poses = [body.get("pose", {}) for body in self.objects.values()]
        twists = [body.get("twist", [0.0] * 6) for body in self.objects.values()]
        rates = [np.zeros(arm.model.nv) for arm in self.arms]
        return State(
            np.array([pose.get("xyz", [0.0, 0.0, 0.0]) for pose in poses], dtype=float),
            np.array([
                Rotation.from_euler("xyz", pose.get("rpy", [0.0, 0.0, 0.0])).as_matrix()
                for pose in poses
            ]),
            [arm.start.copy() for arm in self.arms],
            np.concatenate([*np.array(twists, dtype=float), *rates]),
        )  # fmt: skip

    @property
    def follows(self) -> bool:
        """Whether :meth:`drives` knows the torques of the control.

        Compensation of gravity depends on the contacts by which welds and hinges are idealised, and
        with several objects on how forces and moments are weighed that contacts cannot carry.
        """
        if not self.control.get("gravity_compensation", False):
            return True
        kinds = {joint["kind"] for joint in self.table["joints"]}
        return kinds == {"contacts"} and len(self.objects) == 1

    def hold(self, torques: Mapping[str, np.ndarray]) -> None:
        """Let a control that holds the start have these torques there, of each arm."""
        if self.control.get("hold", False):
            self.held, state = np.zeros(self.nv), self.start()
            at_start = self.drives(0.0, state, self.mechanism(0.0, state).bodies)
            for arm in self.arms:
                self.held[arm.columns] = torques[arm.name] - at_start[arm.columns]

    def drives(self, t: float, state: State, bodies: dict[str, Body]) -> np.ndarray:
        """Torques of the control, shape (nv,)."""
        control, found = self.control, self.held.copy()
        for arm, q in zip(self.arms, state.joints, strict=True):
            torque = found[arm.columns]
            if control["kind"] == "joint_pd":
                torque += control["stiffness"] * (arm.start - q)
                torque -= control["damping"] * state.velocity[arm.columns]
            elif control["kind"] == "constant":
                torque += control["torques"][arm.name]
            elif control["kind"] == "harmonic":
                angle = 2.0 * math.pi * control["frequency"] * t
                phase = np.array(control["phase"][arm.name])
                torque += np.array(control["amplitude"][arm.name]) * np.sin(angle + phase)
            else:
                assert control["kind"] == "none"
        if control.get("gravity_compensation", False):
            found += self._carrying(state, bodies)
        return found

    def _carrying(self, state: State, bodies: dict[str, Body]) -> np.ndarray:
        """Torques that carry the arms, and the objects by the smallest normal forces.

        Those of all contacts of joints, open ones too; of what these cannot carry, what is nearest.
        """
        assert self.follows
        found, free = np.zeros(self.nv), 6 * len(self.objects)
        for arm, q in zip(self.arms, state.joints, strict=True):
            found[arm.columns] = pin.computeGeneralizedGravity(arm.model, arm.data, q)
        rows = np.vstack([
            contact_motion(contact, bodies, state.velocity).jacobian[0]
            for contact in self.contacts
            if contact.pushes_base
        ])  # fmt: skip
        weight = np.zeros((len(self.objects), 6))
        weight[:, :3] = -self.masses[:, None] * self.gravity
        force = np.linalg.lstsq(rows[:, :free].T, weight.ravel(), rcond=1e-9)[0]
        found[free:] -= rows[:, free:].T @ force
        return found

    def mechanism(self, t: float, state: State) -> Mechanism:
        """Inertia, forces and the motion of all bodies at a state."""
        bodies = {WORLD: Body(np.eye(3), np.zeros(3), np.zeros((6, self.nv)), np.zeros(6))}
        inverse, force = np.zeros((self.nv, self.nv)), np.zeros(self.nv)
        links: dict[str, Body] = {}
        for k, name in enumerate(self.objects):
            R, own = state.rotations[k], slice(6 * k, 6 * k + 6)
            spin = state.velocity[own][3:]
            J = np.zeros((6, self.nv))
            J[:, own] = np.eye(6)
            bodies[name] = Body(R, state.positions[k], J, np.zeros(6))
            I = R @ np.diag(self.moments[k]) @ R.T
            inverse[own, own][:3, :3] = np.eye(3) / self.masses[k]
            inverse[own, own][3:, 3:] = R @ np.diag(1.0 / self.moments[k]) @ R.T
            force[own][:3] += self.masses[k] * self.gravity
            force[own][3:] -= skew(spin) @ (I @ spin)
        for arm, q in zip(self.arms, state.joints, strict=True):
            model, data, own = arm.model, arm.data, arm.columns
            rates = state.velocity[own]
            pin.computeAllTerms(model, data, q, rates)
            M = np.triu(data.M) + np.triu(data.M, 1).T
            inverse[own, own] = np.linalg.inv(M)
            force[own] -= data.nle + self.damping * rates
            pin.forwardKinematics(model, data, q, rates, np.zeros(model.nv))
            pin.updateFramePlacements(model, data)
            bodies[arm.name] = self._frame(arm, arm.tip)
            for wrench in self.wrenches:
                on, _, link = wrench["on"].partition("/")
                if on == arm.name and link:
                    links[wrench["on"]] = self._frame(arm, model.getFrameId(link))
        for wrench in self.wrenches:
            body = links.get(wrench["on"]) or bodies[wrench["on"]]
            point = body.rotation @ np.array(wrench.get("at", [0.0, 0.0, 0.0]))
            assert wrench["axes"] == "world" and set(wrench) <= _WRENCH_KEYS
            pull = np.array(wrench["force"], dtype=float)
            if "sinusoid" in wrench:
                pull = pull * math.sin(2.0 * math.pi * wrench["sinusoid"]["frequency"] * t)
            force += body.jacobian.T @ np.concatenate([pull, skew(point) @ pull])
        return Mechanism(bodies, inverse, force)

    def _frame(self, arm: _Arm, frame: int) -> Body:
        J, axes = np.zeros((6, self.nv)), pin.LOCAL_WORLD_ALIGNED
        J[:, arm.columns] = pin.getFrameJacobian(arm.model, arm.data, frame, axes)
        bias = pin.getFrameClassicalAcceleration(arm.model, arm.data, frame, axes)
        X = arm.data.oMf[frame]
        return Body(X.rotation.copy(), X.translation.copy(), J, bias.vector.copy())


_WRENCH_KEYS = {"on", "at", "axes", "force", "sinusoid"}


class ContactMotion(NamedTuple):
    """Motion of one contact.

    ``jacobian`` (3, nv) is of the velocity of the point's body relative to the plane's, along the
    normal and two tangents; ``bias`` what its rate, and that of the gap's rate, has besides the
    accelerations of the coordinates.
    """

    gap: float
    jacobian: np.ndarray
    bias: np.ndarray
    frame: np.ndarray  # (3, 3) normal and tangents, world
    point: np.ndarray  # (3,) world


def contact_motion(
    contact: WrittenContact, bodies: dict[str, Body], velocity: np.ndarray
) -> ContactMotion:
    """Gap, Jacobian and bias of a contact; the tangents are fixed in the plane's body."""
    A, B = bodies[contact.body], bodies[contact.base]
    frame = contact.frame @ B.rotation.T
    n = frame[0]
    to_centre = A.rotation @ contact.point
    centre = A.origin + to_centre
    gap = float(n @ (centre - B.origin - B.rotation @ contact.place)) - contact.radius
    r_A, c = to_centre - contact.radius * n, centre - contact.radius * n
    r_B = c - B.origin
    across_A, across_B = -skew(r_A), -skew(r_B)  # w x r = across w
    J = frame @ (A.jacobian[:3] + across_A @ A.jacobian[3:])
    J -= frame @ (B.jacobian[:3] + across_B @ B.jacobian[3:])
    v_A, v_B = A.jacobian @ velocity, B.jacobian @ velocity
    W_A, W_B = skew(v_A[3:]), skew(v_B[3:])
    r_A_rate = W_A @ to_centre - contact.radius * (W_B @ n)
    r_B_rate = v_A[:3] + r_A_rate - v_B[:3]
    slip = v_A[:3] + W_A @ r_A - v_B[:3] - W_B @ r_B
    bias = (
        A.bias[:3] + across_A @ A.bias[3:] + W_A @ r_A_rate
        - B.bias[:3] - across_B @ B.bias[3:] - W_B @ r_B_rate
    )  # fmt: skip
    # the frame turns with B
    return ContactMotion(gap, J, frame @ bias + (W_B @ frame.T).T @ slip, frame, c)
