"""What a scene says of a robot, resolved: its files, the joints that move, and where it starts.

The joints on the way from the root to a tip move, each by ONE number; all others are held fixed.
An arm is a robot with one tip: its joints are those of :func:`multiarm.scene.arms.examine_arm`, the
joints of other robots those of :func:`multiarm.scene.robot_spec.examine_robot`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from multiarm.errors import ModelError, SceneError
from multiarm.notation import count_of
from multiarm.scene.faults import Faults, counted, listed, unknown
from multiarm.scene.joint_values import SOLVE, KnownRobot, joint_value_faults, joint_vector
from multiarm.scene.meshes import resolve_mesh
from multiarm.scene.model_files import ModelSource, RobotModel
from multiarm.scene.robots import resolve_package_dirs
from multiarm.scene.urdf import CHAIN_JOINTS, JointOutline, Mimic, RobotOutline
from multiarm.scene.values import angle_fault


@dataclass(frozen=True)
class MimicCoupling:
    """position of ``joint`` = multiplier * (position of ``leader``) + offset; both move."""

    joint: str
    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class ResolvedRobot:
    """Files, moving joints and start of one arm or robot.

    Attributes
    ----------
    urdf : Path
        The robot's file: a URDF, or with ``mjcf`` a MuJoCo file.
    package_dirs : tuple of Path
        Where ``package://`` addresses of the robot are looked for, in order.
    tool_urdf : Path, str or None
        The tool's file, or the text of its URDF where the scene describes it.
    tool_package_dirs : tuple of Path
        The same for the tool.
    tips : dict of str to str
        The links that joints of the scene may connect: of an arm that of its only tip, by the name
        ``""``; of a robot those of its tips by name, and further links of joints by their own.
    joints : tuple of JointOutline, length n
        The moving joints: those of the base, then those of the file in the order of Pinocchio's
        model (:meth:`multiarm.scene.urdf.RobotOutline.in_model_order`); of an arm from base to tip.
    posture, velocity : ndarray, shape (n,)
        Start [rad] or [m], [rad/s] or [m/s].
    locked : dict of str to float
        Joints held fixed, of the robot and of the tool, with their positions.
    base_joints : tuple of JointOutline
        The first of ``joints``: those that move the root link in the frame of the base, ``base_x``,
        ``base_y``, ``base_z``, ``base_yaw`` or some of these.
    base_floats : bool
        Whether the root link floats.
    base_mass : float
        Added to the root link at the base's origin [kg].
    base_inertia : ndarray, shape (3, 3)
        Added to the root link: about the base's origin, base axes [kg m^2].
    mimic : tuple of MimicCoupling
        Of joints that move and copy others.
    on_wheels : bool
        The base has the joints ``base_x``, ``base_y``, ``base_yaw`` and does not slip sideways.
    passive : tuple of str
        Moving joints without a drive.
    """

    urdf: Path
    package_dirs: tuple[Path, ...]
    tool_urdf: Path | str | None
    tool_package_dirs: tuple[Path, ...]
    tips: dict[str, str]
    joints: tuple[JointOutline, ...]
    posture: np.ndarray
    velocity: np.ndarray
    locked: dict[str, float]
    mjcf: bool = False
    base_joints: tuple[JointOutline, ...] = ()
    base_floats: bool = False
    base_mass: float = 0.0
    base_inertia: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    mimic: tuple[MimicCoupling, ...] = ()
    on_wheels: bool = False
    passive: tuple[str, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def tip(self) -> str:
        """The link of the only tip of an arm."""
        return self.tips[""]


@dataclass
class Examination(KnownRobot):
    """The facts of one arm or robot.

    Attributes
    ----------
    resolved : ResolvedRobot or None
        None where there are faults.
    urdf : Path or None
        The robot's file.
    robot_joints : set of str
        All joints of the robot; its tool's are not among them.
    way : tuple of str
        Movable joints of the robot on the way to a tip, locked ones too.
    resting : dict of str to float
        Joints that are not on the way and that 'lock' does not name, with their positions.
    faults : list of (place within the arm or robot, text)
    warnings : list of str
    """

    resolved: ResolvedRobot | None = None
    urdf: Path | None = None
    robot_joints: set[str] = field(default_factory=set)
    way: tuple[str, ...] = ()
    resting: dict[str, float] = field(default_factory=dict)
    faults: Faults = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def add_fault(self, *where: str | int, text: str) -> None:
        """Note a fault."""
        self.faults.append((where, text))


def outline_of(
    model: ModelSource, examination: Examination, *where: str | int
) -> RobotOutline | None:
    """The outline of the model that stands at a place; None, and a fault, where there is none."""
    try:
        return model.read()
    except (SceneError, ModelError) as error:
        key = "robot" if model.file is None else "urdf"
        if isinstance(model, RobotModel) and model.mjcf is not None:
            key = "mjcf"
        examination.add_fault(*where, key, text=str(error))
        return None


def way_to(
    model: ModelSource,
    outline: RobotOutline | None,
    link: str | None,
    examination: Examination,
    *where: str | int,
) -> list[JointOutline] | None:
    """All joints from the root to a link, fixed ones too; None, and a fault, without the link."""
    if outline is None or link is None:
        return None
    try:
        return list(outline.chain(link))
    except ModelError as error:
        remedy = "" if outline.text else f"; '{model.shown_by}' shows them all"
        examination.add_fault(*where, text=f"{error}{remedy}")
        return None


def check_kind(joint: JointOutline, tip: str, examination: Examination) -> None:
    """Note a joint on the way to a tip that moves by more than one number."""
    if joint.kind not in CHAIN_JOINTS:
        examination.add_fault(
            text=f"joint {joint.name!r} on the way to {tip!r} is {joint.kind}; arms move "
            f"by {listed(CHAIN_JOINTS)} joints (or lock it: lock: {{{joint.name}: 0.0}})"
        )


def check_passive(
    passive: Sequence[str], moving: Sequence[JointOutline], examination: Examination
) -> None:
    """Note joints without a drive that do not move."""
    names = [joint.name for joint in moving]
    for name in passive:
        if name not in names:
            examination.add_fault("passive", text=unknown("moving joint", name, names))


def locked_positions(
    lock: Mapping[str, float],
    joints: Mapping[str, JointOutline],
    moving: Sequence[JointOutline],
    examination: Examination,
) -> dict[str, float]:
    """Position of every movable joint of a file that is no coordinate."""
    for name, position in lock.items():
        if name in joints:
            _check_angle(joints[name], position, ("lock", name), examination)
    names = {joint.name for joint in moving}
    fixed = [joint for joint in joints.values() if joint.movable and joint.name not in names]
    locked = {joint.name: joint.neutral for joint in fixed} | {
        name: value for name, value in lock.items() if name in joints
    }
    for joint in fixed:
        chain = [joint]  # each mimics the next
        while (mimic := chain[-1].mimic) and chain[-1].name not in lock:
            if mimic.joint not in locked or joints[mimic.joint] in chain:
                break
            chain.append(joints[mimic.joint])
        for leader, follower in pairwise(reversed(chain)):
            assert follower.mimic is not None
            position = follower.mimic.multiplier * locked[leader.name] + follower.mimic.offset
            locked[follower.name] = position
        if chain[-1].name not in lock:
            examination.resting[joint.name] = locked[joint.name]
    examination.held = {
        name: f"is locked at {position:g} by 'lock' and takes no value here; keep one of both"
        if name in lock
        else f"does not move, it is held at {position:g}, and takes no value"
        for name, position in locked.items()
    }
    return locked


def resting_warning(resting: Mapping[str, float], way: str) -> str:
    """The warning that joints are held fixed; ``way`` says which way they are not on."""
    positions = [f"{joint}: {q:g}" for joint, q in resting.items()]
    return (
        f"joints that are {way} are locked at {{{counted(positions, 4)}}}; "
        "'lock' chooses other positions"
    )


def start_of(
    model: RobotModel, moving: Sequence[JointOutline], examination: Examination
) -> tuple[np.ndarray, np.ndarray]:
    """Posture and velocity at the start, (n,) each; joints that copy others follow these."""
    names = [joint.name for joint in moving]
    neutral = np.array([joint.neutral for joint in moving])
    vectors = []
    for key, default in (("posture", neutral), ("velocity", np.zeros(len(moving)))):
        values = getattr(model, key)
        if values == SOLVE:
            values = None
        faults = joint_value_faults(values, names, examination.held)
        for where, text in faults:
            examination.add_fault(key, *where, text=text)
        vector = default if faults else joint_vector(values, names, default)
        if values is None or isinstance(values, dict):
            _follow(vector, moving, values or {}, 1.0 if key == "posture" else 0.0)
        vectors.append(vector)
    for k, (joint, position) in enumerate(zip(moving, vectors[0], strict=True)):
        where = "posture", joint.name if isinstance(model.posture, dict) else k
        outside = not joint.lower <= position <= joint.upper
        if _check_angle(joint, position, where, examination) and outside:
            examination.warnings.append(
                f"posture of {joint.name!r} is {position:g}, outside its limits "
                f"{joint.lower:g} to {joint.upper:g}"
            )
    return vectors[0], vectors[1]


def _follow(
    vector: np.ndarray,
    moving: Sequence[JointOutline],
    named: Mapping[str, float],
    offsets: float,
) -> None:
    """Let joints that copy others, and are not named, follow them; ``offsets`` times the offset."""
    index = {joint.name: k for k, joint in enumerate(moving)}
    left = {j.name: j.mimic for j in moving if j.mimic and j.name not in named}
    while ready := [(name, mimic) for name, mimic in left.items() if mimic.joint not in left]:
        name, mimic = ready[0]
        del left[name]
        if mimic.joint in index:
            vector[index[name]] = (
                mimic.multiplier * vector[index[mimic.joint]] + offsets * mimic.offset
            )


def _check_angle(
    joint: JointOutline, position: float, where: tuple[str | int, ...], examination: Examination
) -> bool:
    """Whether a position is no angle beyond a turn; where limits allow turns, that is a warning."""
    text = angle_fault(position) if joint.kind in ("revolute", "continuous") else ""
    if text and joint.lower <= position <= joint.upper:
        examination.warnings.append(
            f"{where[0]} of {joint.name!r} is {position:g} rad, more than a turn; positions are in "
            "radians"
        )
    elif text:
        examination.add_fault(*where, text=text)
    return not text


def mesh_folders(
    model: ModelSource | None, outline: RobotOutline, examination: Examination
) -> tuple[Path, ...]:
    """Where the meshes of a model are looked for; a warning if some are not there."""
    if model is None or outline.text is not None:
        return ()
    folders = resolve_package_dirs(outline.path, model.package_dirs)
    missing = [m for m in outline.meshes if resolve_mesh(m, outline.path, folders) is None]
    if missing:
        examination.warnings.append(
            f"missing of {outline.path.name}: {len(missing)} of "
            f"{count_of(len(outline.meshes), 'mesh', 'meshes')} (first: {missing[0]}); the motion "
            "is not affected, the replay shows stand-ins; 'package_dirs' says where to look"
        )
    return folders


def couplings_of(moving: Sequence[JointOutline]) -> tuple[MimicCoupling, ...]:
    """The couplings among joints that all move."""
    couplings: list[tuple[str, Mimic]] = [(j.name, j.mimic) for j in moving if j.mimic is not None]
    return tuple(
        MimicCoupling(name, mimic.joint, mimic.multiplier, mimic.offset)
        for name, mimic in couplings
    )
