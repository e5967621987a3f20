r"""Inspection: what a scene compiles to, in numbers, without a run.

The parts (F objects and all joints) have :math:`6 F + \sum n_i` degrees of freedom.  The contacts
remove as many as the rank of the stacked constraint matrix :math:`[W_o; W]`,

.. math:: \text{mobility} = 6 F + \sum n_i - \operatorname{rank} [W_o; W],

and contacts beyond the rank are redundant: the motion does not determine their forces.  A joint by
itself leaves the motions free that its own rows do not constrain, given in the axes of its frame.
The distance of an arm from a singular posture is the smallest relative pivot of
:math:`K_i = W_i^T M_i^{-1} W_i`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from multiarm.assembly.start import held_at_start
from multiarm.contacts.joint import FrameRow, JointFrame, limits_of, write_relative
from multiarm.contacts.table import JointRow, WheelRow
from multiarm.contacts.unilateral import DRY_JOINT, LIMIT, Constraint
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics, write_inertias
from multiarm.dynamics.evaluation import (
    ContactTerms,
    Evaluation,
    Residuals,
    constraint_matrix,
    contact_terms,
)
from multiarm.dynamics.failures import require_ok
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.system import StartReport, System
from multiarm.events.evaluation import evaluate
from multiarm.geometry.screws import free_motions, wrenches_in_frame
from multiarm.jit.rows import fields_of
from multiarm.notation import count_of
from multiarm.results.outcome import plain
from multiarm.scene import (
    ArmSpec,
    JointSpec,
    NamedCode,
    ObjectSpec,
    ResolvedRobot,
    RobotSpec,
    RunSpec,
    Scene,
    ToolSpec,
)
from multiarm.scene.resolution import MimicCoupling
from multiarm.scene.timed_joints import times_in_words
from multiarm.simulation.holding import Carrying, carrying_capacity
from multiarm.simulation.setup import method_and_tolerance
from multiarm.spatial import matrix_to_quaternion

# A relative pivot is the squared sine of an angle: below half a degree contact directions are
# nearly dependent, at roundings there is a direction in which the arm does not move at all.
GOOD_PIVOT, ROUNDING_PIVOT = 1e-4, 1e-12


@dataclass(frozen=True)
class ObjectFacts:
    """An object."""

    shape: str
    mass: float  # [kg]
    inertia: list[list[float]]  # [kg m^2], about the centre of mass in object axes
    position: list[float]  # [m], at the start
    quaternion_xyzw: list[float]


@dataclass(frozen=True)
class ArmFacts:
    """One arm."""

    robot: str  # name, or URDF file
    urdf: str
    tool: str | None  # name, or URDF file
    tip: str
    base_position: list[float]  # [m], of the root link in the world
    base_quaternion_xyzw: list[float]
    joints: dict[str, str]  # name -> "rad" or "m", base to tip
    posture: list[float]  # [rad, m], at the (assembled) start
    locked: dict[str, float]  # [rad, m]
    passive: list[str]  # joints without a drive
    terms: str  # backend of the dynamics: "compiled" or "pinocchio"
    not_compiled: str | None  # why not, although the scene asks for it
    conditioning: float | None  # smallest relative pivot; None with the dense solver
    verdict: str | None  # "good", "near singular" or "cannot follow"
    lost_motions: list[str]  # motions of its joint that the arm cannot follow


@dataclass(frozen=True)
class RobotFacts:
    """One robot with tips; fields of the same names as those of an arm have the same meaning."""

    robot: str
    urdf: str
    tips: dict[str, str]  # name -> link
    base_position: list[float]
    base_quaternion_xyzw: list[float]
    base_joints: list[str]  # the first of the joints
    base: str  # "fixed", "moves", "wheels" or "floats"
    joints: dict[str, str]  # in the order of its vectors
    posture: list[float]
    mimic: list[MimicCoupling]
    locked: dict[str, float]
    passive: list[str]
    terms: str
    not_compiled: str | None
    conditioning: float | None  # of all rows of its connections and couplings
    verdict: str | None  # "good", "near singular" or "dependent rows"
    lost_motions: list[str]


@dataclass(frozen=True)
class LimitFacts:
    """Limits of a joint's coordinate [rad, m], and its value at the start."""

    coordinate: str
    unit: str
    low: float
    high: float
    start: float


@dataclass(frozen=True)
class JointFacts:
    """One joint of the scene by itself, at the start."""

    connection: str  # its name in results
    arm: str | None  # where it is written so
    first: str  # the bodies that it connects; forces act on the second one
    second: str
    kind: str
    name: str | None
    rows: list[str]  # names of its constraint rows
    rank: int
    redundant_rows: list[str]  # rows that depend on each other
    # of the first body, seen from the second one, in the axes of the joint's frame
    free_motions: list[str]
    coordinates: list[str]  # components that are recorded
    limits: list[LimitFacts]
    times: str  # when it holds, such as "from 2 s until 4 s"; empty: all the time


@dataclass(frozen=True)
class Freedom:
    """Degrees of freedom of the system at its start."""

    degrees_of_freedom: int  # of the parts: 6 of every object and floating base, one a joint
    objects: int
    floating_bases: int
    constraints: int  # rows of the connections, of couplings, of wheels
    couplings: int  # of joints that copy others, a row each
    wheels: int  # bases that do not slip sideways, a row each
    rank: int
    mobility: int
    redundant_rows: list[str]  # contacts that depend on each other
    # relative singular values on both sides of the rank decision
    smallest_kept: float | None
    largest_dropped: float | None


@dataclass(frozen=True)
class RunFacts:
    """Settings of a run."""

    duration: float  # [s]
    integrator: str
    accuracy: float | dict[str, float] | None
    tolerance: float | None  # [m, rad; m/s, rad/s], of one step
    step: float | None  # [s]
    stabilization: str
    output_step: float  # [s]
    solver: str


@dataclass(frozen=True)
class Inspection:
    """Result of :func:`inspect_system`.

    Where contacts need code that was not loaded, all fields "or None" are None, ``joints`` are the
    other joints, and postures are as written.
    """

    scene: str
    gravity: list[float] | None  # [m/s^2]
    object: ObjectFacts | None  # None where the scene has 'objects'
    objects: dict[str, ObjectFacts]  # by name
    arms: dict[str, ArmFacts]
    robots: dict[str, RobotFacts]
    joints: list[JointFacts]
    # all contacts closed of the joints that hold at the start, those with a floor open
    freedom: Freedom | None
    coming_and_going: list[str]  # unilateral constraints
    effects: dict[str, Any]  # active ones, and gravity, with their parameters
    control: str
    run: RunFacts
    start: StartReport | None  # gaps of the written start, and its correction
    position_residual: float | None  # [m], largest gap of the assembled start
    velocity_residual: float | None  # [m/s]
    residuals: Residuals | None  # of the equations of motion at the start
    carrying: Carrying | None  # None also when the control does not carry the object
    warnings: list[str]
    not_looked_at: list[str]  # parts that need code that was not loaded

    def as_dict(self) -> dict[str, Any]:
        """In types of JSON, under the names above; numbers that are not finite are None."""
        return plain(asdict(self))


def inspect_system(system: System, unloaded: Sequence[NamedCode] = ()) -> Inspection:
    """Describe a compiled system and its start.

    Parameters
    ----------
    unloaded : sequence of NamedCode
        Code that :func:`multiarm.assembly.compilation.compile_for_inspection` left out.

    Raises
    ------
    SolverError
        When the equations of motion cannot be solved at the start.
    """
    scene = system.scene
    unknown_joints = {code.arm for code in unloaded}.difference([None])  # of these connections
    evaluation = None if unknown_joints else evaluate(system)
    with system.borrow() as data:
        closed = data.closed
        _place_at_start(closed, system)
        terms = contact_terms(closed) if evaluation is None else evaluation.contact_terms
        coordinates = _joint_coordinates(closed)
        if unknown_joints:
            freedom = None
        else:
            held = held_at_start(data)
            _place_at_start(held, system)
            freedom = count_freedom(held)
    joints = {joint.connection: joint for joint in scene.joints}
    return Inspection(
        scene=scene.name,
        gravity=None if scene.gravity is None else list(scene.gravity),
        object=None if scene.object is None else _object_facts(scene.object),
        objects={name: _object_facts(body) for name, body in (scene.objects or {}).items()},
        arms={name: _arm_facts(system, name, evaluation) for name in scene.arms},
        robots={name: _robot_facts(system, name, evaluation) for name in scene.robots},
        joints=[
            _joint_facts(system, joints[name], terms[name], coordinates[name])
            for name in system.model.connections
            if name not in unknown_joints
        ],
        freedom=freedom,
        coming_and_going=[] if unknown_joints else coming_and_going(system),
        effects=active_effects(scene),
        control=scene.control.kind,
        run=resolve_run(scene.run),
        start=None if unknown_joints else system.start_report,
        position_residual=None if evaluation is None else evaluation.position_residual,
        velocity_residual=None if evaluation is None else evaluation.velocity_residual,
        residuals=None if evaluation is None else evaluation.residuals,
        carrying=None if evaluation is None else carrying_capacity(system, evaluation),
        warnings=system.warnings,
        not_looked_at=[_not_looked_at(code, scene) for code in unloaded],
    )


def _not_looked_at(code: NamedCode, scene: Scene) -> str:
    """Code that an inspection does not load, and which part it leaves out therefore."""
    left_out = "it is left out"
    if code.arm is not None:
        joint = f"joint of arm {code.arm!r}" if code.arm in scene.arms else f"joint {code.arm!r}"
        left_out = f"the {joint}, the start, rank and mobility are left out"
    return f"{code.place}: {code.what} is not loaded by a check: {left_out}"


def count_freedom(data: Data) -> Freedom:
    """Degrees of freedom, constraints, their rank and the mobility at the kinematics in ``data``.

    All rows are closed, see :meth:`multiarm.dynamics.data.Data.closed`.
    """
    write_inertias(data.struct)
    matrix = constraint_matrix(data)  # (6 F + n, N)
    space = null_space(matrix)
    rank, singular = space.rank, space.singular
    names = [f"{arm}: {c.name}" for arm, contacts in data.model.contacts.items() for c in contacts]
    return Freedom(
        degrees_of_freedom=matrix.shape[0],
        objects=data.model.layout.frames,
        floating_bases=len(data.model.layout.floating_robots),
        constraints=matrix.shape[1],
        couplings=sum(
            isinstance(record, JointRow) and record.leader >= 0 for record in data.model.records
        ),
        wheels=sum(isinstance(record, WheelRow) for record in data.model.records),
        rank=rank,
        mobility=matrix.shape[0] - rank,
        redundant_rows=[
            name for name, unique in zip(names, space.untouched, strict=True) if not unique
        ],
        smallest_kept=float(singular[rank - 1]) if rank else None,
        largest_dropped=float(singular[rank]) if rank < singular.size else None,
    )


def coming_and_going(system: System) -> list[str]:
    """The unilateral constraints of a system, counted by owner and kind."""
    if system.model.unilateral is None:
        return []
    constraints = system.model.unilateral.constraints
    counts = Counter((one.owner, _constraint_words(one)) for one in constraints)
    lines = [f"{owner}: {words} ({count})" for (owner, words), count in counts.items()]
    springs = system.model.unilateral.compliant
    soft = 0 if springs is None else len(springs.rows)
    return lines + ([f"springs in place of contacts ({soft})"] if soft else [])


def _constraint_words(constraint: Constraint) -> str:
    if constraint.kind == LIMIT:
        return "ends of joints' ranges"
    if constraint.kind == DRY_JOINT:
        return "joints with dry friction"
    if constraint.tangents:
        return "contacts with friction"
    return "contacts that give way" if constraint.compliant else "contacts"


def active_effects(scene: Scene) -> dict[str, Any]:
    """The effects that the scene models, gravity [m/s^2] among them, with their parameters."""
    gravity = {"gravity": scene.gravity} if scene.gravity is not None and any(scene.gravity) else {}
    return gravity | scene.effects.model_dump(mode="json", exclude_none=True)


def resolve_run(spec: RunSpec) -> RunFacts:
    """Method and tolerances of a run with these settings."""
    integrator, tolerance = method_and_tolerance(spec)
    return RunFacts(
        duration=spec.duration,
        integrator=integrator,
        accuracy=None if spec.accuracy is None else spec.accuracy.written,
        tolerance=None if tolerance is None else tolerance.smallest,
        step=spec.step,
        stabilization=spec.stabilization.kind,
        output_step=spec.output_step,
        solver=spec.solver,
    )


def _object_facts(spec: ObjectSpec) -> ObjectFacts:
    (position, quaternion), solid = _placement(spec.pose.matrix()), spec.shape.solid
    return ObjectFacts(
        shape="no shape" if solid is None else solid.words,
        mass=spec.mass,
        inertia=spec.inertia_matrix().tolist(),
        position=position,
        quaternion_xyzw=quaternion,
    )


def _arm_facts(system: System, name: str, evaluation: Evaluation | None) -> ArmFacts:
    spec, arm = system.scene.arms[name], system.arms[name]
    position, quaternion = _placement(spec.base.matrix())
    pivot = None if evaluation is None else evaluation.conditioning.get(name)
    siblings = [sibling for sibling in system.scene.group_of(name).arms if sibling != name]
    moved = {joint for sibling in siblings for joint in system.arms[sibling].joint_names}
    return ArmFacts(
        robot=_model_name(spec),
        urdf=str(arm.files.urdf),
        tool=None if spec.tool is None else _model_name(spec.tool),
        tip=arm.files.tips[""],
        base_position=position,
        base_quaternion_xyzw=quaternion,
        joints=dict(arm.joint_units),
        posture=system.initial_state().joint_positions[name].tolist(),
        locked={joint: q for joint, q in arm.files.locked.items() if joint not in moved},
        passive=list(spec.passive),
        terms=system.arm_terms[name],
        not_compiled=system.not_compiled.get(name),
        conditioning=pivot,
        verdict=_verdict(pivot),
        lost_motions=[] if evaluation is None else list(evaluation.lost_motions.get(name, ())),
    )


def _robot_facts(system: System, name: str, evaluation: Evaluation | None) -> RobotFacts:
    spec, robot = system.scene.robots[name], system.arms[name]
    position, quaternion = _placement(spec.base.matrix())
    pivot = None if evaluation is None else evaluation.conditioning.get(name)
    return RobotFacts(
        robot=_model_name(spec),
        urdf=str(robot.files.urdf),
        tips=dict(spec.tips),
        base_position=position,
        base_quaternion_xyzw=quaternion,
        base_joints=[joint.name for joint in robot.files.base_joints],
        base=_kind_of_base(system.model.resolved_robots[name]),
        joints=dict(robot.joint_units),
        posture=system.initial_state().joint_positions[name].tolist(),
        mimic=list(system.model.resolved_robots[name].mimic),
        locked=dict(robot.files.locked),
        passive=list(spec.passive),
        terms=system.arm_terms[name],
        not_compiled=system.not_compiled.get(name),
        conditioning=pivot,
        verdict=_verdict(pivot, "dependent rows"),
        lost_motions=[] if evaluation is None else list(evaluation.lost_motions.get(name, ())),
    )


def _kind_of_base(robot: ResolvedRobot) -> str:
    if robot.base_floats:
        return "floats"
    if robot.on_wheels:
        return "wheels"
    return "moves" if robot.base_joints else "fixed"


def _verdict(pivot: float | None, singular: str = "cannot follow") -> str | None:
    if pivot is None:
        return None
    if pivot < ROUNDING_PIVOT:
        return singular
    return "good" if pivot >= GOOD_PIVOT else "near singular"


def _model_name(spec: ArmSpec | RobotSpec | ToolSpec) -> str:
    if spec.robot is not None:
        return spec.robot
    if isinstance(spec, ToolSpec) and spec.fingers is not None:
        return f"hand of {count_of(len(spec.fingers.tips), 'finger')}"
    assert spec.file is not None, "a model has a name or a file"
    return spec.file.name


def _joint_facts(
    system: System, joint: JointSpec, terms: ContactTerms, coordinates: np.ndarray
) -> JointFacts:
    name, frame = joint.connection, system.frames[joint.connection]
    names = [contact.name for contact in system.model.joints[name].contacts]
    row = system.model.layout.owners.index(name)
    frames = fields_of(FrameRow, system.model.constants.joint_frames[row])
    on_second = np.eye(4)  # in the frame in which the terms are, of a link not that of the tip
    on_second[:3, :3], on_second[:3, 3] = frames.on_object, frames.origin_on_object
    motions = free_motions(wrenches_in_frame(on_second, terms.W_o))
    return JointFacts(
        connection=name,
        arm=joint.arm or None,
        first=str(joint.first),
        second=str(joint.second),
        kind=joint.kind,
        name=joint.name,
        rows=names,
        rank=motions.rank,
        redundant_rows=[
            name for name, alone in zip(names, motions.independent, strict=True) if not alone
        ],
        free_motions=motions.words(),
        coordinates=list(frame.labels),
        limits=_limit_facts(joint, frame, coordinates),
        times=times_in_words(joint),
    )


def _limit_facts(joint: JointSpec, frame: JointFrame, coordinates: np.ndarray) -> list[LimitFacts]:
    places = dict(zip(frame.free, frame.places, strict=True))
    return [
        LimitFacts(
            coordinate=limit.motion,
            unit=limit.unit,
            low=limit.low,
            high=limit.high,
            start=float(coordinates[places.get(limit.component, limit.component)]),
        )
        for limit in limits_of(joint)
    ]


def _joint_coordinates(data: Data) -> dict[str, np.ndarray]:
    """What :func:`write_relative` writes, of each connection."""
    model, coordinates = data.model, {}
    for c, owner in enumerate(model.layout.owners):
        if owner in model.connections:
            coordinates[owner] = np.zeros(9)
            first, second = (data.arrays.bodies.motion[body] for body in model.bodies_of(owner))
            frame = model.constants.joint_frames[c]
            write_relative(frame, first, second, np.zeros(6), coordinates[owner])
    return coordinates


def _placement(matrix: np.ndarray) -> tuple[list[float], list[float]]:
    quaternion = matrix_to_quaternion(matrix[:3, :3])
    return matrix[:3, 3].tolist(), np.asarray(quaternion).tolist()


def _place_at_start(data: Data, system: System) -> None:
    """Write the kinematics of the start into the data."""
    data.set_state(0.0, system.initial_state())
    require_ok(data, update_kinematics(data.struct))
