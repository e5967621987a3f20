r"""What a scene compiles to, in numbers: the answers that one wants before a long run.

The parts (the object and all joints) have :math:`6 + \sum n_i` degrees of freedom.  The contacts
take away as many as the stacked constraint matrix :math:`[W_o; W]` has rank,

.. math:: \text{mobility} = 6 + \sum n_i - \operatorname{rank} [W_o; W],

and contacts beyond the rank are redundant: their forces are not determined by the motion.  A joint
by itself leaves free the motions across its own rows, told in the axes of its frame.  How near
an arm is to a singular posture is its smallest relative pivot of :math:`K_i = W_i^T M_i^{-1} W_i`.

Nothing here prints; the command ``multiarm check`` shows what :func:`inspect_system` returns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from multiarm.contacts.joint import axis_travel, limits_of
from multiarm.contacts.screws import free_motions, wrenches_in_frame
from multiarm.contacts.unilateral import CONTACT, DRY_JOINT, LIMIT, Constraint
from multiarm.control.laws import needs_gravity_torque
from multiarm.dynamics.arrays import OK
from multiarm.dynamics.contact_geometry import constraint_matrix, contact_terms
from multiarm.dynamics.diagnosis import failure_text
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.evaluation import ContactTerms, Evaluation
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.dense import RANK_TOLERANCE, null_space
from multiarm.dynamics.state import State
from multiarm.dynamics.system import System
from multiarm.errors import SolverError
from multiarm.events.evaluation import evaluate
from multiarm.scene import ArmSpec, JointSpec, NamedCode, ObjectSpec, RunSpec, Scene, ToolSpec
from multiarm.simulation.inspection import (
    ArmFacts,
    Carrying,
    Freedom,
    Inspection,
    JointFacts,
    LimitFacts,
    ObjectFacts,
    RunFacts,
)
from multiarm.simulation.setup import method_and_tolerance
from multiarm.spatial import matrix_to_quaternion, quaternion_to_matrix

__all__ = [
    "active_effects",
    "carrying_capacity",
    "coming_and_going",
    "count_freedom",
    "inspect_system",
    "resolve_run",
]

# Relative pivot below which an arm is called near singular: its contact directions are within about
# half a degree of being dependent (the pivot is the squared sine of that angle).
NEAR_SINGULAR = 1e-4
# ... and below which there is a direction in which it does not move at all.
SINGULAR = 1e-12
# A weight whose unbalanced part is a smaller fraction than this is carried.
CARRIED = 1e-6


def inspect_system(system: System, left: Sequence[NamedCode] = ()) -> Inspection:
    """Describe a compiled system and judge its start.

    Parameters
    ----------
    system : System
    left : sequence of NamedCode
        What :func:`multiarm.assembly.compilation.compile_for_inspection` left out of it.

    Raises
    ------
    SolverError
        When the equations of motion cannot be solved at the start.
    """
    scene = system.scene
    away = {code.arm for code in left}.difference([None])
    evaluation = None if away else evaluate(system)
    with system.borrow() as data:
        closed = data.with_contacts_closed()
        _place_at_start(closed, system)
        terms = contact_terms(closed) if evaluation is None else evaluation.contact_terms
        freedom = None if away else count_freedom(closed)
        carries = _carries(scene) and not away
        carrying = carrying_capacity(closed, scene) if carries else None
    return Inspection(
        scene=scene.name,
        gravity=None if scene.gravity is None else list(scene.gravity),
        object=_object_facts(scene.object),
        arms={name: _arm_facts(system, name, evaluation) for name in system.arm_names},
        joints=[
            _joint_facts(system, joint, terms[joint.arm])
            for joint in sorted(scene.joints, key=lambda j: system.arm_names.index(j.arm))
            if joint.arm not in away
        ],
        freedom=freedom,
        coming_and_going=[] if away else coming_and_going(system),
        effects=dict.fromkeys(active_effects(scene)),
        control=scene.control.kind,
        run=resolve_run(scene.run),
        start=None if away else system.start_report,
        position_residual=None if evaluation is None else evaluation.position_residual,
        velocity_residual=None if evaluation is None else evaluation.velocity_residual,
        residuals=None if evaluation is None else evaluation.residuals,
        carrying=carrying,
        warnings=scene.warnings,
        not_looked_at=[_not_looked_at(code) for code in left],
    )


def _not_looked_at(code: NamedCode) -> str:
    """What a look leaves out for want of code, and why."""
    what = "it is left out"
    if code.arm is not None:
        what = f"the joint of arm {code.arm!r}, the start, rank and mobility are left out"
    return (
        f"{code.place}: {what}, since {code.what} is not loaded by a look; if you trust its "
        "author, allow it with --code"
    )


def count_freedom(data: Data) -> Freedom:
    """Degrees of freedom, constraints, their rank and the mobility at the kinematics in ``data``.

    All rows are held, see :meth:`multiarm.dynamics.model.Data.with_contacts_closed`.
    """
    matrix = constraint_matrix(data)  # (6 + n, N)
    space = null_space(matrix)
    rank, singular = space.rank, space.singular
    names = [f"{arm}: {c.name}" for arm, own in data.model.contacts.items() for c in own]
    return Freedom(
        degrees_of_freedom=matrix.shape[0],
        constraints=matrix.shape[1],
        rank=rank,
        mobility=matrix.shape[0] - rank,
        redundant_rows=[n for n, own in zip(names, space.untouched, strict=True) if not own],
        smallest_kept=float(singular[rank - 1]),
        largest_dropped=float(singular[rank]) if rank < singular.size else None,
    )


def carrying_capacity(data: Data, scene: Scene) -> Carrying:
    r"""How well contact forces can carry the object at rest: :math:`W_o \lambda = [-m g; 0]`."""
    weight = np.zeros(6)
    weight[:3] = -scene.object.mass * np.array(scene.gravity)
    W_o = data.arrays.Wo.T  # (6, N)
    reach = max(float(np.max(np.linalg.norm(W_o[3:], axis=0))), 1e-3)  # [m]
    scale = np.array([1.0] * 3 + [1.0 / reach] * 3)  # moments as forces at that distance
    forces = np.linalg.lstsq(scale[:, None] * W_o, scale * weight, rcond=RANK_TOLERANCE)[0]
    left = W_o @ forces - weight
    size = float(np.linalg.norm(weight))
    return Carrying(
        possible=float(np.linalg.norm(scale * left)) <= CARRIED * size,
        force_residual=float(np.linalg.norm(left[:3])),
        moment_residual=float(np.linalg.norm(left[3:])),
        largest_force=float(np.max(np.abs(forces))),
    )


def coming_and_going(system: System) -> list[str]:
    """What comes and goes in a system, counted by what it belongs to."""
    if system.model.unilateral is None:
        return []
    counts = Counter((unit.arm, _unit_words(unit)) for unit in system.model.unilateral.constraints)
    lines = [f"{arm}: {words} ({count})" for (arm, words), count in counts.items()]
    springs = system.model.unilateral.compliant
    soft = 0 if springs is None else len(springs.rows)
    return lines + ([f"springs in place of contacts ({soft})"] if soft else [])


def _unit_words(unit: Constraint) -> str:
    words = {LIMIT: "ends of joints' ranges", DRY_JOINT: "joints with dry friction"}
    if unit.kind != CONTACT:
        return words[unit.kind]
    return "contacts" + (" with friction" if unit.tangents else " that give way" * unit.compliant)


def active_effects(scene: Scene) -> list[str]:
    """Names of the effects that the scene models; what is not here costs nothing."""
    gravity = ["gravity"] if scene.gravity is not None and any(scene.gravity) else []
    return gravity + list(scene.effects.named)


def resolve_run(spec: RunSpec) -> RunFacts:
    """The method and the tolerances that a run with these settings will have."""
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
    position, quaternion = _placement(spec.pose.matrix())
    return ObjectFacts(
        shape=_shape_words(spec),
        mass=spec.mass,
        inertia=spec.inertia_matrix().tolist(),
        position=position,
        quaternion_xyzw=quaternion,
    )


def _shape_words(spec: ObjectSpec) -> str:
    shape = spec.shape
    if shape.box is not None:
        return f"box {' x '.join(f'{edge:g}' for edge in shape.box)} m"
    if shape.sphere is not None:
        return f"sphere of radius {shape.sphere:g} m"
    if shape.cylinder is not None:
        return f"cylinder of radius {shape.cylinder.radius:g} m, height {shape.cylinder.height:g} m"
    if shape.hull is not None:
        return f"convex polyhedron of {len(shape.hull)} corners"
    assert shape.mesh is not None, "a shape is one of five"
    return f"mesh {shape.mesh.file.name}"


def _arm_facts(system: System, name: str, evaluation: Evaluation | None) -> ArmFacts:
    spec, arm = system.scene.arms[name], system.arms[name]
    position, quaternion = _placement(spec.base.matrix())
    pivot = None if evaluation is None else evaluation.conditioning.get(name)
    return ArmFacts(
        robot=_model_name(spec),
        urdf=str(arm.files.urdf),
        tool=None if spec.tool is None else _model_name(spec.tool),
        tip=spec.tip,
        base_position=position,
        base_quaternion_xyzw=quaternion,
        joints=dict(arm.joint_units),
        posture=system.initial_state().joint_positions[name].tolist(),
        locked=dict(arm.files.locked),
        terms=system.arm_terms[name],
        not_compiled=system.not_compiled.get(name),
        conditioning=pivot,
        verdict=_verdict(pivot),
        lost_motions=[] if evaluation is None else list(evaluation.lost_motions.get(name, ())),
    )


def _verdict(pivot: float | None) -> str | None:
    if pivot is None:
        return None
    if pivot < SINGULAR:
        return "cannot follow"
    return "good" if pivot >= NEAR_SINGULAR else "near singular"


def _model_name(spec: ArmSpec | ToolSpec) -> str:
    if spec.robot is not None:
        return spec.robot
    if isinstance(spec, ToolSpec) and spec.fingers is not None:
        return f"hand of {len(spec.fingers.tips)} fingers"
    assert spec.urdf is not None, "a model has a name or a file"
    return spec.urdf.name


def _joint_facts(system: System, joint: JointSpec, terms: ContactTerms) -> JointFacts:
    frame, names = system.frames[joint.arm], _row_names(system, joint.arm)
    motions = free_motions(wrenches_in_frame(frame.on_object, terms.W_o))
    return JointFacts(
        arm=joint.arm,
        kind=joint.kind,
        name=joint.name,
        rows=names,
        rank=motions.rank,
        redundant_rows=[n for n, own in zip(names, motions.independent, strict=True) if not own],
        free_motions=motions.words(),
        coordinates=list(frame.labels),
        limits=_limit_facts(system, joint, system.initial_state()),
    )


def _limit_facts(system: System, joint: JointSpec, state: State) -> list[LimitFacts]:
    frame, object_pose = system.frames[joint.arm], np.eye(4)
    object_pose[:3, :3] = quaternion_to_matrix(state.object_quaternion_xyzw)
    object_pose[:3, 3] = state.object_position
    tip_pose = system.arms[joint.arm].tip_pose(state.joint_positions[joint.arm])
    turn, slide = axis_travel(
        (object_pose @ frame.on_object)[None], (tip_pose @ frame.on_tip)[None]
    )
    return [
        LimitFacts(
            coordinate=limit.motion,
            unit=limit.unit,
            low=limit.low,
            high=limit.high,
            start=float((turn if limit.turns else slide)[0]),
        )
        for limit in limits_of(joint)
    ]


def _row_names(system: System, arm: str) -> list[str]:
    return [contact.name for contact in system.model.joints[arm].contacts]


def _placement(matrix: np.ndarray) -> tuple[list[float], list[float]]:
    quaternion = matrix_to_quaternion(np.ascontiguousarray(matrix[:3, :3]))
    return matrix[:3, 3].tolist(), np.asarray(quaternion).tolist()


def _carries(scene: Scene) -> bool:
    """Whether the control applies the torques that carry the object, and no floor does."""
    control = scene.control
    holds = control.kind == "harmonic" and control.hold
    weighs = scene.gravity is not None and any(scene.gravity)
    return weighs and scene.effects.floor is None and (holds or needs_gravity_torque(scene))


def _place_at_start(data: Data, system: System) -> None:
    """Bring the kinematics of the start into the data."""
    data.set_state(0.0, system.initial_state())
    status = update_kinematics(data.struct)
    if status != OK:
        data.reraise()
        raise SolverError(failure_text(data, status))
