r"""Robots through Pinocchio: from a URDF to inertia, bias, Jacobian and tip motion.

A robot is one reduced Pinocchio model: its tool appended, locked joints removed, its base placed in
the world.  It obeys

.. math:: M(q)\,\ddot q + b(q, \dot q) = \tau + J^T f_m

with ``b`` the Coriolis, centrifugal and gravity forces.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from multiarm.errors import ModelError
from multiarm.geometry.frame_motion import FrameMotion
from multiarm.notation import count_of
from multiarm.robots.terms import BASE_DOF, RobotTerms, TipKinematics, TreeStructure
from multiarm.scene.meshes import ShapeMesh, shapes_without_meshes
from multiarm.scene.mjcf import mjcf_model
from multiarm.scene.urdf import JointOutline
from multiarm.spatial import matrix_to_quaternion

BASE_VELOCITY = ("base_x", "base_y", "base_z", "base_turn_x", "base_turn_y", "base_turn_z")
"""Names of the first numbers of a velocity of a robot with a floating base, in messages."""
BASE_UNITS = ["m"] * 3 + ["rad"] * 3
"""Units of the displacements that belong to them."""


@dataclass(frozen=True)
class RobotFiles:
    """URDFs of a robot and its tool, folders of their meshes, mounting, tips and locked joints.

    ``tips`` are links by their names, "" for the only tip of an arm.  ``tool_urdf`` is a path, or
    the text of a URDF; with ``mjcf`` the robot's file is MuJoCo's.  ``base_joints`` move the root
    link from where ``base`` places it, or it floats (``base_floats``); ``base_mass`` [kg] at the
    base's origin and ``base_inertia`` (3, 3) about it [kg m^2] are added to the root link then.
    """

    urdf: Path
    package_dirs: tuple[Path, ...]
    base: np.ndarray
    tips: dict[str, str]
    locked: dict[str, float]
    tool_urdf: Path | str | None = None
    tool_package_dirs: tuple[Path, ...] = ()
    mount: str | None = None
    tool_placement: np.ndarray | None = None
    mjcf: bool = False
    base_joints: tuple[JointOutline, ...] = ()
    base_floats: bool = False
    base_mass: float = 0.0
    base_inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, eq=False)
class Tip:
    """A frame on a link of a robot that takes part in connections.

    Attributes
    ----------
    frame_id, joint : int
        Pinocchio's numbers of the frame, and of the joint that carries it (0: the base).
    rotation, translation : ndarray, shapes (3, 3) and (3,)
        The frame in that joint's frame; of a link of the base, in the world.
    chain : int64 ndarray
        The numbers of a velocity of the robot that move it, counted from 0, from base to tip: those
        of its joints, and the six of a floating base.
    """

    frame_id: int
    joint: int
    rotation: np.ndarray
    translation: np.ndarray
    chain: np.ndarray


AT_REST = Tip(0, 0, np.eye(3), np.zeros(3), np.zeros(0, dtype=np.int64))
"""The frame of the object or the world as a first body."""


class Robot:
    """One robot: a tree of links on a base, with one tip (an arm) or several.

    The base is fixed in the world or *floats*.  A velocity of the robot has then, before the rates
    of its joints, six more numbers: the twist of its base frame, that of the root link, in world
    axes.  Methods take the motion of the base; it rests where the scene places it if it is None.

    Attributes
    ----------
    name : str
    model : pinocchio.Model
        Tool appended, locked joints removed, base placed; joints keep their URDF names.  Its
        ``armature`` is the inertia of the drives reflected to the joints, part of M.
    joint_names : tuple of str
        Movable joints, each after those before it on its way from the base; all joint vectors are
        in this order, one number a joint (an angle in rad also for continuous joints, metres for
        prismatic ones).
    joint_units : dict joint -> "rad" or "m"
    floats : bool
        Whether the base floats.
    base_pose : ndarray, shape (7,)
        Of a floating base, as written: position [m], quaternion xyzw.
    dof : int
        Numbers of a velocity.
    velocity_names : tuple of str
        Of these, in messages: those of the joints after those of a floating base.
    velocity_units : list of str
        "rad" or "m", of the coordinates of these.
    tips : dict of str to Tip
        By name; that of an arm is "".
    position_limits : ndarray, shape (n, 2)
        From the URDF; infinite for continuous joints.
    effort_limits, velocity_limits : ndarray, shape (n,)
        From the URDF; infinite where it gives none.
    """

    def __init__(
        self,
        name: str,
        files: RobotFiles,
        color: tuple[float, ...] | None = None,
        rotor_inertia: np.ndarray | None = None,
    ):
        self.name = name
        self.files = files
        self.color = color
        try:
            self.model, _ = _assemble(self.text, files)
        except ValueError as error:  # such as a joint and a link of one name
            raise ModelError(
                f"{self.text}: Pinocchio cannot put {files.urdf} together: {error}"
            ) from error
        if rotor_inertia is not None:
            # `crba` adds it to the diagonal of M
            of_joints = np.zeros(self.model.nv)
            of_joints[self.model.nv - rotor_inertia.size :] = rotor_inertia
            self.model.armature = self.model.armature + of_joints
        self.dof, self.floats = self.model.nv, files.base_floats
        self.base_pose = _quaternion_pose(_placed_base(files)) if self.floats else np.zeros(7)
        joints = list(self.model.joints)[self._first_joint :]
        self.joint_names = tuple(list(self.model.names)[self._first_joint :])
        self.circular = np.array([j.nq == 2 for j in joints], dtype=bool)
        if any(j.nv != 1 for j in joints):
            raise ModelError(
                f"{self.text}: only revolute, continuous and prismatic joints are supported; "
                f"lock the others (`lock: {{joint: value}}`)"
            )
        prismatic = [j.shortname().startswith("JointModelP") for j in joints]
        self.joint_units = {
            joint: "m" if slides else "rad"
            for joint, slides in zip(self.joint_names, prismatic, strict=True)
        }
        base_names, base_units = (BASE_VELOCITY, BASE_UNITS) if self.floats else ((), [])
        self.velocity_names = (*base_names, *self.joint_names)
        self.velocity_units = [*base_units, *self.joint_units.values()]
        self.tips = {tip: self._make_tip(link) for tip, link in files.tips.items()}
        q_first = np.array([j.idx_q for j in joints], dtype=int)
        lower = self.model.lowerPositionLimit[q_first]
        upper = self.model.upperPositionLimit[q_first]
        free = self.circular | (lower >= upper)
        self.position_limits = np.column_stack(
            [np.where(free, -np.inf, lower), np.where(free, np.inf, upper)]
        )
        self.effort_limits = _positive_or_infinite(self.model.effortLimit[self.base_dof :])
        self.velocity_limits = _positive_or_infinite(self.model.velocityLimit[self.base_dof :])

    def __repr__(self) -> str:
        tips = ", ".join(map(repr, self.files.tips.values()))
        return f"Robot({self.name!r}, {count_of(len(self.joint_names), 'joint')}, tip {tips})"

    @property
    def base_dof(self) -> int:
        """How many velocities of a floating base stand before those of the joints."""
        return self.dof - len(self.joint_names)

    @property
    def noun(self) -> str:
        """What it is in messages: ``arm``, whose only tip has no name, or ``robot``."""
        return "arm" if "" in self.files.tips else "robot"

    @property
    def text(self) -> str:
        """It and its name in messages: ``arm 'left'``, ``robot 'cart'``."""
        return f"{self.noun} '{self.name}'"

    @property
    def _first_joint(self) -> int:
        """Pinocchio's number of the first joint that is none of a floating base."""
        return 3 if self.floats else 1

    def _make_tip(self, link: str) -> Tip:
        frame_id = _frame_id(self.model, link, self.text)
        frame = self.model.frames[frame_id]
        return Tip(
            frame_id=frame_id,
            joint=frame.parentJoint,
            rotation=frame.placement.rotation.copy(),
            translation=frame.placement.translation.copy(),
            chain=self.chain_of(frame.parentJoint),
        )

    def chain_of(self, joint: int) -> np.ndarray:
        """The joints from the base to a joint that Pinocchio counts from 1, counted from 0.

        They are numbers of a velocity: a floating base has the first six.
        """
        joints = (self.model.joints[before] for before in self.model.supports[joint] if before > 0)
        chain = [of_joint.idx_v + k for of_joint in joints for k in range(of_joint.nv)]
        return np.array(chain, dtype=np.int64)

    @property
    def parents(self) -> np.ndarray:
        """Number of the joint before each joint, counted from 0; -1: the base; int64 (n,)."""
        return np.array(self.model.parents[1:], dtype=np.int64) - 1

    @property
    def parent_numbers(self) -> np.ndarray:
        """The number before each one of a velocity on its way from the base, or -1; (dof,)."""
        parents = np.full(self.dof, -1, dtype=np.int64)
        for joint in range(1, self.model.njoints):
            chain = self.chain_of(joint)
            parents[chain[1:]] = chain[:-1]
        return parents

    @property
    def tip(self) -> Tip:
        """The tip of an arm."""
        (tip,) = self.tips.values()
        return tip

    def configuration(self, angles: np.ndarray, base: FrameMotion | None = None) -> np.ndarray:
        """Pinocchio's configuration vector ``(nq,)`` of one number per joint ``(n,)``."""
        angles = np.asarray(angles, dtype=float)
        parts = list(self.base_pose if base is None else base.pose) if self.floats else []
        for angle, circular in zip(angles, self.circular, strict=True):
            parts += [np.cos(angle), np.sin(angle)] if circular else [angle]
        return np.array(parts)

    def levers(self, place: np.ndarray, tip: str = "") -> np.ndarray:
        """Longest lever arm of each number of a velocity on contacts at a tip, shape (dof,) [m].

        The length of the chain from the joint to the contacts at ``place`` (3,) in the tip's frame
        [m], and no less than a tenth of the longest; 1 for prismatic joints, and for those that do
        not move the tip.
        """
        end, levers = self.tips[tip], np.ones(self.dof)
        joints = [k for k in self.model.supports[end.joint] if k > 0]
        if not joints:
            return levers
        ends = [self.model.jointPlacements[k].translation for k in joints[1:]]
        ends.append(end.translation + end.rotation @ place)
        lengths = np.cumsum(np.linalg.norm(ends, axis=1)[::-1])[::-1]
        if lengths[0] > 0.0:
            longest = np.maximum(lengths, 0.1 * lengths[0])
            levers[end.chain] = np.repeat(longest, [self.model.joints[k].nv for k in joints])
        return np.where(np.array(self.velocity_units) == "m", 1.0, levers)

    def link(self, name: str) -> tuple[int, np.ndarray, np.ndarray]:
        """Joint that carries a link; the link's rotation and origin [m] in its frame."""
        kind = pin.FrameType.BODY
        if not self.model.existFrame(name, kind):  # a site of an MJCF file
            kind = pin.FrameType.OP_FRAME
        frame = self.model.frames[_frame_id(self.model, name, self.text, kind)]
        place = frame.placement
        return frame.parentJoint, place.rotation.copy(), place.translation.copy()

    def _velocity(
        self, rates: np.ndarray, base: FrameMotion | None, turn: np.ndarray
    ) -> np.ndarray:
        """Pinocchio's velocity, for which ``turn`` (6 + n, 6 + n) yields that in world axes."""
        if not self.floats:
            return np.array(rates, dtype=float)
        twist = np.zeros(6) if base is None else base.twist
        return turn.T @ np.concatenate([twist, rates])

    def turn(self, q: np.ndarray) -> np.ndarray:
        """World axes in place of the base's for its angular velocity, shape (dof, dof)."""
        turn = np.eye(self.dof)
        if self.floats:
            turn[3:6, 3:6] = pin.Quaternion(q[3:7]).toRotationMatrix()
        return turn

    def terms(
        self,
        angles: np.ndarray,
        velocity: np.ndarray,
        tip: str = "",
        base: FrameMotion | None = None,
    ) -> RobotTerms:
        """Terms of the equations of motion at joint positions [rad or m] and velocities, (n,)."""
        q = self.configuration(angles, base)
        turn = self.turn(q)
        v = self._velocity(velocity, base, turn)
        model, data = self.model, self.model.createData()
        inertia = pin.crba(model, data, q, pin.Convention.WORLD)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        bias = pin.nonLinearEffects(model, data, q, v).copy()
        if self.floats:
            inertia, bias = turn @ inertia @ turn.T, turn @ bias
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        motion, axes = self._motion_of(tip, data, q), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        drift = pin.getFrameClassicalAcceleration(model, data, self.tips[tip].frame_id, axes)
        return RobotTerms(
            M=inertia,
            bias=bias,
            J=motion.jacobian,
            tip_position=motion.position,
            tip_rotation=motion.rotation,
            tip_twist=motion.twist,
            drift=drift.vector.copy(),
        )

    def tip_kinematics(
        self,
        angles: np.ndarray,
        velocity: np.ndarray,
        tip: str = "",
        base: FrameMotion | None = None,
    ) -> TipKinematics:
        """Motion of a tip at joint positions [rad or m] and velocities, (n,)."""
        q, data = self.configuration(angles, base), self.model.createData()
        v = self._velocity(velocity, base, self.turn(q))
        pin.forwardKinematics(self.model, data, q, v)
        return self._motion_of(tip, data, q)

    def _motion_of(self, tip: str, data: pin.Data, q: np.ndarray) -> TipKinematics:
        """Motion of a tip, where ``data`` has that of the joints at ``q``."""
        model, frame = self.model, self.tips[tip].frame_id
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        pose = pin.updateFramePlacement(model, data, frame)
        twist = pin.getFrameVelocity(model, data, frame, axes).vector
        jacobian = np.array(pin.computeFrameJacobian(model, data, q, frame, axes))
        jacobian = jacobian.reshape(6, model.nv)
        return TipKinematics(
            position=pose.translation.copy(),
            rotation=pose.rotation.copy(),
            twist=twist.copy(),
            jacobian=jacobian @ self.turn(q).T if self.floats else jacobian,
            joint_names=self.joint_names,
        )

    def tip_pose(
        self, angles: np.ndarray, tip: str = "", base: FrameMotion | None = None
    ) -> np.ndarray:
        """Homogeneous pose ``X_WT``, shape (4, 4), of a tip in the world."""
        return self._frames(angles, base).oMf[self.tips[tip].frame_id].homogeneous.copy()

    def skeleton(self, angles: np.ndarray, base: FrameMotion | None = None) -> np.ndarray:
        """Origins of all n joints and of the t tips in the world, shape (n + t, 3) [m]."""
        data = self._frames(angles, base)
        first = self._first_joint
        joints = [data.oMi[k].translation for k in range(first, self.model.njoints)]
        tips = [data.oMf[tip.frame_id].translation for tip in self.tips.values()]
        return np.array([*joints, *tips])

    def _frames(self, angles: np.ndarray, base: FrameMotion | None) -> pin.Data:
        """Poses of all joints and frames."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.configuration(angles, base))
        return data

    def gravity_torque(
        self, angles: np.ndarray, gravity: np.ndarray, base: FrameMotion | None = None
    ) -> np.ndarray:
        """Joint torques that hold the unloaded robot still, after a wrench on a floating base.

        Shape (dof,); the wrench is about the base's origin, world axes.
        """
        model = self.model.copy()
        model.gravity.linear = np.asarray(gravity, dtype=float)
        q = self.configuration(angles, base)
        torque = np.array(pin.computeGeneralizedGravity(model, model.createData(), q))
        return self.turn(q) @ torque if self.floats else torque

    def structure(self) -> TreeStructure:
        """Geometry and masses of the robot, as copies.

        Raises
        ------
        ModelError
            When a joint turns and slides at once.
        """
        model, first = self.model, self._first_joint
        motions = [_motion(joint) for joint in list(model.joints)[first:]]
        if self.floats:
            first, motions = first - 1, [np.eye(BASE_DOF)[-1], *motions]
        links, moves = range(first, model.njoints), np.array(motions)
        turns, slides = (np.any(moves[:, part] != 0.0, axis=1) for part in (slice(3, 6), slice(3)))
        if np.any(turns & slides):
            names = ", ".join(np.array(model.names)[first:][turns & slides])
            raise ModelError(f"{names} turns and slides at once")
        return TreeStructure(
            parents=np.maximum(np.array(model.parents)[first:] - first, -1),
            slides=slides,
            floats=np.array([self.floats, *[False] * (len(links) - 1)]),
            axes=np.where(slides[:, None], moves[:, :3], moves[:, 3:]),
            rotations=np.array([model.jointPlacements[k].rotation for k in links]),
            translations=np.array([model.jointPlacements[k].translation for k in links]),
            masses=np.array([model.inertias[k].mass for k in links]),
            centres=np.array([model.inertias[k].lever for k in links]),
            inertias=np.array([model.inertias[k].inertia for k in links]),
            armature=np.array(model.armature)[-len(links) :],
        )

    def visual_model(self) -> pin.GeometryModel:
        """The visual geometry of robot and tool, placed consistently with :attr:`model`.

        Files of meshes are not read here: a shape that is a mesh has the type ``BVHModelBase``,
        and its path and scale.
        """
        return _assemble(self.text, self.files, pin.GeometryType.VISUAL)[1]

    def collision_model(self) -> pin.GeometryModel:
        """The collision geometry as :meth:`visual_model`; of a file without any, its visual one."""
        return _assemble(self.text, self.files, pin.GeometryType.COLLISION)[1]


def _motion(joint: pin.JointModel) -> np.ndarray:
    """Velocity of a joint's frame for a unit rate, linear and angular, in its own axes."""
    data = joint.createData()
    joint.calc(data, np.concatenate([np.zeros(joint.idx_q), [1.0, 0.0][: joint.nq]]))
    return np.array(data.S).ravel()


def _positive_or_infinite(values: np.ndarray) -> np.ndarray:
    values = np.array(values, dtype=float)
    return np.where((values > 0) & np.isfinite(values) & (values < 1e300), values, np.inf)


def _frame_id(model: pin.Model, frame: str, robot: str, *kind: pin.FrameType) -> int:
    if not model.existFrame(frame, *kind):
        names = ", ".join(f.name for f in model.frames if f.type == pin.FrameType.BODY)
        raise ModelError(f"{robot}: no frame '{frame}'; links are {names}")
    return model.getFrameId(frame, *kind)


def _from_urdf(robot: str, urdf: Path | str) -> pin.Model:
    """The model of a URDF, which nobody may write: robots of one file share it."""
    try:
        return _read(urdf, urdf.stat().st_mtime_ns if isinstance(urdf, Path) else 0)
    except (OSError, ValueError, RuntimeError) as error:
        raise ModelError(f"{robot}: Pinocchio cannot read {urdf}: {error}") from error


@lru_cache(maxsize=16)
def _read(urdf: Path | str, _stamp: int) -> pin.Model:
    build = pin.buildModelFromXML if isinstance(urdf, str) else pin.buildModelFromUrdf
    return build(str(urdf))


def _assemble(
    robot: str, files: RobotFiles, kind: pin.GeometryType | None = None
) -> tuple[pin.Model, pin.GeometryModel]:
    """Robot, tool, locked joints, base: the model and, if wanted, its geometry of a kind."""
    base = _placed_base(files)
    model = mjcf_model(files.urdf)[0] if files.mjcf else _from_urdf(robot, files.urdf)
    geometry, tool_geometry = pin.GeometryModel(), pin.GeometryModel()
    if kind is not None:
        geometry = _geometry(model, files.urdf, files.package_dirs, kind, files.mjcf)
    armature = dict(zip(model.names[1:], model.armature, strict=False))
    if files.tool_urdf is not None:
        assert files.mount is not None, "a tool has a mount"
        tool = _from_urdf(robot, files.tool_urdf)
        if kind is not None:
            tool_geometry = _geometry(tool, files.tool_urdf, files.tool_package_dirs, kind)
        mount = _frame_id(model, files.mount, robot)
        placement = pin.SE3(files.tool_placement)
        armature |= dict(zip(tool.names[1:], tool.armature, strict=False))
        model, geometry = pin.appendModel(model, tool, geometry, tool_geometry, mount, placement)
    if files.locked:
        reference = pin.neutral(model)
        ids = []
        for joint, value in files.locked.items():
            if not model.existJointName(joint):
                raise ModelError(f"{robot}: no joint '{joint}' to lock")
            ids.append(model.getJointId(joint))
            at, size = model.joints[ids[-1]].idx_q, model.joints[ids[-1]].nq
            reference[at : at + size] = [np.cos(value), np.sin(value)] if size == 2 else value
        model, geometry = pin.buildReducedModel(model, geometry, ids, reference)
    below, foot, place = _moving_base(files, base)
    model, geometry = pin.appendModel(below, model, pin.GeometryModel(), geometry, foot, place)
    if files.mjcf:  # appending leaves it out
        of_joints = [armature.get(joint, 0.0) for joint in model.names[1:]]
        sizes = [joint.nv for joint in model.joints[1:]]
        model.armature = np.repeat(of_joints, sizes)
    return model, geometry


def _placed_base(files: RobotFiles) -> pin.SE3:
    """Pose of the root link in the world; of one that moves, at zero positions."""
    base = pin.SE3(files.base)
    return base * pin.SE3(mjcf_model(files.urdf)[1].matrix()) if files.mjcf else base


def _quaternion_pose(pose: pin.SE3) -> np.ndarray:
    """Position [m] and quaternion xyzw of a pose, shape (7,)."""
    return np.concatenate([pose.translation, matrix_to_quaternion(pose.rotation)])


def _moving_base(files: RobotFiles, base: pin.SE3) -> tuple[pin.Model, int, pin.SE3]:
    """The joints below a robot's root link, the frame that carries it, and its pose there."""
    model, carrier, place = pin.Model(), 0, base
    if files.base_floats:  # its configuration is its pose in the world
        place = _IDENTITY
        for kind in (pin.JointModelTranslation(), pin.JointModelSpherical()):
            name = "base_shift" if carrier == 0 else "base_turn"
            carrier = model.addJoint(carrier, kind, place, name)
    for joint in files.base_joints:
        axis = "XYZ"[int(np.argmax(joint.axis))]
        kind = getattr(pin, f"JointModel{'P' if joint.kind == 'prismatic' else 'R'}{axis}")
        limits = (
            np.array([x])
            for x in (joint.effort_limit, joint.velocity_limit, joint.lower, joint.upper)
        )
        carrier, place = model.addJoint(carrier, kind(), place, joint.name, *limits), _IDENTITY
    if not carrier:
        return model, 0, base
    added = pin.Inertia(files.base_mass, np.zeros(3), files.base_inertia)
    model.appendBodyToJoint(carrier, added, _IDENTITY)
    foot = pin.Frame("moving base", carrier, 0, _IDENTITY, pin.FrameType.OP_FRAME)
    return model, model.addFrame(foot), _IDENTITY


_IDENTITY = pin.SE3.Identity()


def _geometry(
    model: pin.Model,
    urdf: Path | str,
    package_dirs: tuple[Path, ...],
    kind: pin.GeometryType,
    mjcf: bool = False,
) -> pin.GeometryModel:
    """The shapes of a file; none, and a warning, where Pinocchio cannot read them."""
    role, without = _ROLES[kind]
    meshes: dict[str, ShapeMesh] = {}
    try:
        if mjcf:
            geometry = pin.buildGeomFromMJCF(model, str(urdf), kind)
        else:
            text = urdf
            if isinstance(urdf, Path):
                text, meshes = shapes_without_meshes(urdf, package_dirs, role)
            geometry = pin.buildGeomFromUrdfString(model, text, kind)
    except (ValueError, RuntimeError):
        name = "a tool's URDF" if isinstance(urdf, str) else urdf
        warnings.warn(f"the shapes of {name} cannot be read: {without}", stacklevel=2)
        return pin.GeometryModel()
    if kind == pin.GeometryType.COLLISION and not geometry.ngeoms:
        return _geometry(model, urdf, package_dirs, pin.GeometryType.VISUAL, mjcf)
    for item in geometry.geometryObjects:
        if item.name in meshes:
            item.geometry = coal.BVHModelOBBRSS()
            item.meshPath = meshes[item.name].path
            item.meshScale = np.array(meshes[item.name].scale)
    return geometry


# The tag of shapes in a URDF, and what a warning says where they cannot be read.
_ROLES = {
    pin.GeometryType.VISUAL: ("visual", "the replay shows bars"),
    pin.GeometryType.COLLISION: ("collision", "postures are found without regard to them"),
}


def named_with_prefix(robot: Robot) -> pin.Model:
    """A copy of the robot's model whose joints and frames are named ``robot/...``."""
    model = robot.model.copy()
    for i in range(1, model.njoints):
        model.names[i] = f"{robot.name}/{model.names[i]}"
    for i in range(1, model.nframes):
        model.frames[i].name = f"{robot.name}/{model.frames[i].name}"
    return model
