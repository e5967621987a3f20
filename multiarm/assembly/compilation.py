"""Compilation: from a scene to a system.

:func:`compile_system` is the sequence of its steps.  Arms, joints and arm dynamics are constants:
those that another system (``like``) has too are shared with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from multiarm.arms.arm import Arm, ArmFiles
from multiarm.arms.backends import ArmBackends
from multiarm.assembly.bases import Standing, find_bases
from multiarm.assembly.paths import joint_path
from multiarm.assembly.postures import find_postures
from multiarm.assembly.start import assemble as close_start
from multiarm.assembly.start import check_patches, check_unilateral, unassembled
from multiarm.contacts.joint import COMPONENTS, FRAME_WIDTH, Joint, JointFrame
from multiarm.contacts.table import ContactTable, make_joint_rows, pack
from multiarm.contacts.unilateral import UnilateralConstraints, unilateral_constraints
from multiarm.control.laws import control_program
from multiarm.control.program import (
    ControlContext,
    ControlProgram,
    JointPath,
    needs_gravity_torque,
)
from multiarm.dynamics.arrays import COUPLED, Constants, FreeMotions
from multiarm.dynamics.callbacks import ControlFunction
from multiarm.dynamics.contact_geometry import free_components, joint_wrenches, locate_pairs
from multiarm.dynamics.control_laws import NO_CONTROL, law_table
from multiarm.dynamics.equations import (
    kinematics,
    right_hand_sides,
    solve,
    solve_deficient,
    write_general_row,
)
from multiarm.dynamics.held_control import with_held_control
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import Data, Model, with_effects, with_rows
from multiarm.dynamics.solver.dense import null_space
from multiarm.dynamics.solver_monitor import compare_solution, record_solution
from multiarm.dynamics.state import State
from multiarm.dynamics.system import StartReport, System, require_control
from multiarm.effects.building import (
    BuildContext,
    effect_program,
    joint_numbers,
)
from multiarm.effects.unilateral import unilateral_kernels
from multiarm.errors import ModelError, SceneError
from multiarm.integration.explicit import explicit_step
from multiarm.integration.near_singular import evaluate_near_singular
from multiarm.integration.reporting_guards import reporting_guards
from multiarm.integration.step import write_slope
from multiarm.integration.time_loop import advance
from multiarm.jit.ahead import compile_ahead
from multiarm.scene import (
    ARM_TERMS,
    ArmSpec,
    JointSpec,
    NamedCode,
    ResolvedArm,
    Scene,
    Waypoint,
    friction_of,
    resolve_arm,
    with_code,
    without_code,
)
from multiarm.scene.faults import shown
from multiarm.scene.joints import BUILT_IN
from multiarm.scene.values import SOLVE, SURROUNDINGS
from multiarm.spatial import matrix_to_quaternion

# Functions of an evaluation: compiled at once, and when first called.
FUNCTIONS = {
    "kinematics": kinematics,
    "forces": right_hand_sides,
    "solve": solve,
    "project": solve,
    "record": record_solution,
    "compare": compare_solution,
}
LAZY_FUNCTIONS = {
    "coupled": solve_deficient,
    "row": write_general_row,
    "near_singular": evaluate_near_singular,
}


def compile_system(
    scene: Scene,
    control: ControlFunction | None = None,
    *,
    sample_time: float | None = None,
    sample_delay: bool = False,
    arms: str | None = None,
    like: System | None = None,
    code: bool | None = None,
    assemble: bool = True,
) -> System:
    """Build the system that a scene describes; only what the scene names is in it.

    Parameters
    ----------
    scene : Scene
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control; arms that it leaves out
        get no torque.
    sample_time, sample_delay
        Of ``control``: it is called every ``sample_time`` [s] only, see
        :meth:`multiarm.System.with_control`.  A control of the scene has keys of these names.
    arms : {"pinocchio", "compiled"}, optional
        Backend of the arm dynamics, in place of ``run.arms`` of the scene.
    like : System, optional
        Of a similar scene: equal arms and joints are shared, and their URDFs are not read again.
        The result is the same.
    code : bool, optional
        Whether functions and effects of packages that the scene names may be loaded, which runs
        their code.  By default as the scene was read: allowed for scene files, unless
        ``load_scene`` forbade it, and not for stored results.
    assemble : bool
        False: the start is as written, gaps and all, and postures are not sought.  Such a system
        can be evaluated; runs need a ``state`` that satisfies the joints.

    Raises
    ------
    SceneError
        When the start does not satisfy the joints and is too far from doing so; when the scene
        names code and may not load any.
    ModelError
        When a robot cannot be used, a function cannot be loaded, or a compiled arm is not the
        robot's.
    ControlError
        When ``sample_time`` cannot be used.
    """
    require_control(control, sample_time, sample_delay)
    if not isinstance(scene, Scene):
        raise SceneError(
            f"a scene is needed, got {shown(scene)}; read its file with ma.load_scene(path), or "
            "make a table a scene: ma.Scene(**table)"
        )
    scene = with_code(_with_arms(scene, arms), code)
    scene = with_bases(scene) if assemble else scene  # where arms stand, if that is to be found
    # a run needs them: the first time they are compiled in the background
    compile_ahead(advance, explicit_step, write_slope)
    robots = load_robots(scene, like, assemble)  # URDF -> arms with tips and limits
    joints = scene_joints(scene, robots, like)  # contact records of every joint
    rows = contact_rows(scene, robots, joints)  # all rows of W, unilateral ones too
    backends = arm_backends(scene, robots, like)  # Pinocchio or compiled copies
    draft = draft_model(scene, robots, joints, rows, backends)  # bodies, rows, effects
    data = draft.data()
    written = written_start(scene, robots, rows.layout)
    if assemble:
        start, report = assembled_start(scene, data, written)
        frames = joint_frames(scene, data, start)  # with the motions that each joint leaves free
    else:
        data.model = replace(draft, pair_places=locate_pairs(data, written))
        data.set_state(0.0, written)
        start, report, frames = written, unassembled(data), draft.frames
    law = control_law(scene, data, start) if control is None else None
    model = finished_model(draft, data, frames, law)
    system = System(scene, model, report, start)
    system.keep(data.view(model))
    return system if control is None else system.with_control(control, sample_time, sample_delay)


def compile_for_inspection(scene: Scene, arms: str | None = None) -> tuple[System, list[NamedCode]]:
    """Build a system without the code that the scene names, and list that code.

    Where joints lack contacts without it, the start is as written, not assembled, the free motions
    of joints are those that their kinds fix, and there is no control.

    Raises
    ------
    SceneError, ModelError
        See :func:`compile_system`.
    """
    scene, left = without_code(_with_arms(scene, arms))
    if not any(code.arm for code in left):
        return compile_system(scene), left
    return geometry_of(scene), left


def geometry_of(scene: Scene, start: Mapping[str, Any] | None = None) -> System:
    """Build what says where a scene's arms and contacts are: without control, not assembled.

    The free motions of joints are those that their kinds fix.

    Parameters
    ----------
    scene : Scene
        With its functions loaded, or without what needs them.
    start : mapping, optional
        Arguments of :meth:`multiarm.System.state`, in place of the start as written, for which
        missing postures are sought.
    """
    scene = with_bases(scene)
    robots = load_robots(scene, seek=start is None)
    joints = scene_joints(scene, robots)
    rows = contact_rows(scene, robots, joints)
    draft = draft_model(scene, robots, joints, rows, arm_backends(scene, robots))
    system = System(scene, draft, StartReport(), written_start(scene, robots, rows.layout))
    state = system.state(**start or {})
    model = replace(draft, pair_places=locate_pairs(draft.data(), state))
    return System(scene, model, StartReport(), state)


def _with_arms(scene: Scene, arms: str | None) -> Scene:
    """The scene with another backend of the arm dynamics."""
    if arms is None:
        return scene
    if arms not in ARM_TERMS:
        raise ModelError(f"unknown arms {arms!r}; arms are {', '.join(map(repr, ARM_TERMS))}")
    return scene.model_copy(update={"run": scene.run.model_copy(update={"arms": arms})})


# --- robots ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Robots:
    """The arms of a scene."""

    resolved: dict[str, ResolvedArm]
    arms: dict[str, Arm]
    shared: tuple[str, ...] = ()  # arms that another system has too


def with_bases(scene: Scene) -> Scene:
    """The scene with the bases that it leaves to the program; the postures there are to be found.

    Raises
    ------
    SceneError
        Naming every arm for which there is no place.
    """
    if not any(spec.open_base for spec in scene.arms.values()):
        return scene
    arms, standing = {}, {}
    for name, spec in scene.arms.items():
        resolved = resolve_arm(spec, scene.folder)
        arm = _make_arm(name, scene, resolved)
        if spec.open_base:
            arms[name] = arm
        elif spec.posture not in (None, SOLVE):
            standing[name] = Standing(arm, resolved.posture)
    specs = {
        name: scene.arms[name].model_copy(update={"base": base, "posture": SOLVE})
        for name, base in find_bases(scene, arms, standing).items()
    }
    return scene.model_copy(update={"arms": {**scene.arms, **specs}})


def load_robots(scene: Scene, like: System | None = None, seek: bool = True) -> Robots:
    """The arms of a scene; equal ones of ``like`` are shared, missing postures sought."""
    shared: tuple[str, ...] = ()
    if like is not None and scene.effects.rotor_inertia == like.scene.effects.rotor_inertia:
        theirs = like.scene.arms
        shared = tuple(
            name
            for name, spec in scene.arms.items()
            if theirs.get(name) == spec
            and like.scene.robot_of(name).lock == scene.robot_of(name).lock
        )
    resolved, arms = {}, {}
    for name, spec in scene.arms.items():
        if like is not None and name in shared:
            resolved[name], arms[name] = like.model.robots[name], like.arms[name]
        else:
            locked = spec.model_copy(update={"lock": scene.robot_of(name).lock | spec.lock})
            resolved[name] = resolve_arm(locked, scene.folder)
            arms[name] = _make_arm(name, scene, resolved[name])
    if seek:
        written = {name: arm.posture for name, arm in resolved.items()}
        for name, posture in find_postures(scene, arms, written).items():
            resolved[name] = replace(resolved[name], posture=posture)
    return Robots(resolved, arms, shared)


def arm_files(spec: ArmSpec, resolved: ResolvedArm) -> ArmFiles:
    """Files and frames of an arm of a scene."""
    tool = spec.tool
    return ArmFiles(
        urdf=resolved.urdf,
        package_dirs=resolved.package_dirs,
        base=spec.base.matrix(),
        tip=resolved.tip,
        locked=resolved.locked,
        tool_urdf=resolved.tool_urdf,
        tool_package_dirs=resolved.tool_package_dirs,
        mount=tool.mount if tool is not None else None,
        tool_placement=tool.at.matrix() if tool is not None else None,
        mjcf=resolved.mjcf,
    )


def _make_arm(name: str, scene: Scene, resolved: ResolvedArm) -> Arm:
    spec, rotors = scene.arms[name], scene.effects.rotor_inertia
    inertia = None
    if rotors is not None:
        from multiarm.effects.rotor_inertia import of_arm

        inertia = of_arm(rotors, name, resolved.joint_names)
    arm = Arm(name, arm_files(spec, resolved), spec.color, inertia)
    if arm.joint_names != resolved.joint_names:
        raise ModelError(
            f"arm '{name}': Pinocchio orders its joints {arm.joint_names}, the URDF's chain is "
            f"{resolved.joint_names}; give the chain's joints names in order"
        )
    return arm


def arm_backends(scene: Scene, robots: Robots, like: System | None = None) -> ArmBackends:
    """Backends of the arm dynamics; shared where ``like`` has equal arms."""
    gravity, with_torque = _gravity(scene), needs_gravity_torque(scene)
    if like is not None and list(robots.shared) == list(scene.arms) == list(like.scene.arms):
        theirs = like.scene
        same = scene.gravity == theirs.gravity and scene.run.arms == theirs.run.arms
        if same and with_torque == needs_gravity_torque(theirs):
            return like.model.backends
    return ArmBackends(robots.arms, gravity, with_torque, scene.run.arms == "compiled")


def _gravity(scene: Scene) -> np.ndarray:
    return np.array(scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0))


# --- rows of W ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rows:
    """All rows of W of a scene."""

    layout: Layout
    records: Mapping[str, list]  # of every arm, in its tip's frame, and of the surroundings
    on_links: dict[str, list]  # the same, in the frame of the link that carries the tip
    table: ContactTable
    unilateral: UnilateralConstraints | None


def scene_joints(scene: Scene, robots: Robots, like: System | None = None) -> dict[str, Joint]:
    """The joints of a scene by arm; equal ones of ``like`` are shared.

    Raises
    ------
    ModelError
        Naming the joint that cannot be made.
    """
    shared = {}
    if like is not None:
        # a joint without ``at`` is where the tip meets the object
        moved = scene.object.pose != like.scene.object.pose
        theirs = {joint.arm: joint for joint in like.scene.joints}
        for joint in scene.joints:
            placed = joint.at is not None or not moved
            if joint.arm in robots.shared and joint == theirs[joint.arm] and placed:
                shared[joint.arm] = like.model.joints[joint.arm]
    specs = {joint.arm: joint for joint in scene.joints}
    return {
        name: shared.get(name)
        or _make_joint(specs[name], scene, arm, robots.resolved[name].posture)
        for name, arm in robots.arms.items()
    }


def _make_joint(joint: Any, scene: Scene, arm: Arm, posture: np.ndarray) -> Joint:
    """Contacts, frame and limits of a joint; without ``at`` it is where the tip is at the start."""
    try:
        if joint.at is not None:
            pose = joint.at.matrix()
        else:
            frame = arm.tip_pose(posture) @ joint.at_tip.matrix() @ joint.start_shift()
            pose = np.linalg.solve(scene.object.pose.matrix(), frame)
        contacts, (on_tip, on_object) = joint.placed(pose), joint.frames(pose)
    except ModelError as error:
        raise ModelError(f"joint of arm '{joint.arm}': {error}") from error
    frame = JointFrame(on_tip, on_object, joint.free or ())
    return Joint(contacts, frame, joint.free_limits)


def contact_rows(scene: Scene, robots: Robots, joints: Mapping[str, Joint]) -> Rows:
    """All rows that can be active, and which of them are unilateral."""
    arms = robots.arms
    contacts = {name: joint.contacts for name, joint in joints.items()}
    unilateral = _unilateral(scene, robots, contacts)
    records: Mapping[str, list] = contacts if unilateral is None else unilateral.records
    around = records.get(SURROUNDINGS, [])
    owners = [*arms, *([SURROUNDINGS] if around else [])]
    layout = Layout(
        names=tuple(arms),
        dofs=_bounds([arms[name].dof if name in arms else 0 for name in owners]),
        rows=_bounds([len(records[name]) for name in owners]),
    )
    on_links = {}
    for name, arm in arms.items():
        on_tip = arm.tip_rotation, arm.tip_translation
        on_links[name] = [record.moved_on_arm(*on_tip) for record in records[name]]
    if around:
        on_links[SURROUNDINGS] = around
    table = pack([record for on_link in on_links.values() for record in on_link])
    return Rows(layout, records, on_links, table, unilateral)


def _unilateral(
    scene: Scene, robots: Robots, contacts: Mapping[str, list]
) -> UnilateralConstraints | None:
    effects = scene.effects
    has_friction = any(contact.mu for of_joint in contacts.values() for contact in of_joint)
    if not (effects.with_events or has_friction):
        return None
    limits = {
        name: dict(zip(arm.joint_names, map(tuple, arm.position_limits), strict=True))
        for name, arm in robots.arms.items()
    }
    dry = None
    if "joint_friction" in effects.with_events and effects.joint_friction is not None:
        outlines = {name: arm.joints for name, arm in robots.resolved.items()}
        dry = joint_numbers(effects.joint_friction.torque, outlines, friction_of)
    return unilateral_constraints(scene, contacts, limits, dry)


# --- model ----------------------------------------------------------------------------------------


def draft_model(
    scene: Scene,
    robots: Robots,
    joints: Mapping[str, Joint],
    rows: Rows,
    backends: ArmBackends,
) -> Model:
    """The model without what depends on the assembled start."""
    arms, layout, unilateral = robots.arms, rows.layout, rows.unilateral
    outlines = {name: arm.joints for name, arm in robots.resolved.items()}
    context = BuildContext(scene, arms, layout, outlines)
    effects = effect_program(context, unilateral_kernels(unilateral, layout.joints))
    bilateral = rows.on_links if unilateral is None else {name: [] for name in arms}
    limits = {name: joint.limits for name, joint in joints.items()}
    levers = [arms[name].levers(joints[name].frame.on_tip[:3, 3]) for name in arms]
    levers += [np.zeros(0)] * (len(layout.dofs) - 1 - len(arms))
    constants = Constants(
        q_slots=backends.q_slots,
        circular=np.concatenate([arm.circular for arm in arms.values()]).astype(np.int64),
        codes=rows.table.codes,
        geometry=rows.table.geometry,
        shapes=rows.table.shapes,
        joint_frames=np.zeros((len(arms), FRAME_WIDTH)),
        tip_frames=np.array(
            [np.append(arm.tip_rotation, arm.tip_translation) for arm in arms.values()]
        ),
        free=FreeMotions(np.zeros(len(arms) + 1, np.int64), *np.zeros((2, 0), np.int64)),
        object_mass=float(scene.object.mass),
        object_inertia=np.ascontiguousarray(scene.object.inertia_matrix()),
        gravity=_gravity(scene),
        control=NO_CONTROL,
        sampled=NO_CONTROL,
        sample_delay=False,
        effects=np.zeros((0, 3), dtype=np.int64),
        passive_end=0,
        actuator_end=0,
        applied_end=0,
        control_reach=COUPLED,
        local_effects=True,
        state_joints=np.zeros(0, dtype=np.int64),
        joint_rows=make_joint_rows(0),
        dense=scene.run.solver == "dense",
        calls_user=bool(rows.table.functions) or effects.calls_user,
    )
    return Model(
        arms=arms,
        robots=robots.resolved,
        joints=dict(joints),
        backends=backends,
        layout=layout,
        contacts={name: rows.records[name] for name in arms},
        records=tuple(record for on_link in rows.on_links.values() for record in on_link),
        surfaces=tuple(rows.table.functions),
        frames={name: joint.frame for name, joint in joints.items()},
        constants=with_rows(
            with_effects(constants, effects), rows.table.codes, rows.table.geometry, layout
        ),
        effects=effects,
        links=tuple(context.links),
        levers=tuple(levers),
        functions=FUNCTIONS,
        lazy_functions=LAZY_FUNCTIONS,
        breakpoints=effects.breakpoints,
        pair_places=np.zeros((len(rows.table.shapes), 3)),
        unilateral=unilateral,
        guards=reporting_guards(bilateral, limits, layout, effects.watched),
    )


def _free_motions(frames: dict[str, JointFrame]) -> FreeMotions:
    """The motions that are recorded of each joint."""

    free = [pair for f in frames.values() for pair in zip(f.free, f.places, strict=True)]
    numbers = np.array(free, dtype=np.int64).reshape(-1, 2)
    bounds = np.array(_bounds([len(frame.free) for frame in frames.values()]))
    return FreeMotions(bounds, component=numbers[:, 0].copy(), coordinate=numbers[:, 1].copy())


def finished_model(
    draft: Model, data: Data, frames: dict[str, JointFrame], law: ControlProgram | None
) -> Model:
    """The model with joint frames, contact places and control at the assembled start."""
    packed = [
        frame.packed(draft.arms[name].tip_rotation, draft.arms[name].tip_translation)
        for name, frame in frames.items()
    ]
    constants = draft.constants._replace(
        joint_frames=np.array(packed),
        free=_free_motions(frames),
    )
    breakpoints, sampling, span = draft.breakpoints, None, None
    if law is not None:
        laws = law_table(law.laws, draft.effects.end)
        constants = constants._replace(control=laws, control_reach=law.reach)
        breakpoints = np.union1d(breakpoints, law.breakpoints)
        sampling, span = law.sampling, law.span
    if law is not None and sampling is not None:
        constants = with_held_control(constants, constants.control, sampling.delay)
    model = replace(
        draft,
        frames=frames,
        constants=constants,
        breakpoints=breakpoints,
        laws=() if law is None else law.laws,
        sampling=sampling,
        control_span=span,
        pair_places=data.model.pair_places,
    )
    python = None if law is None else law.python
    return model if python is None else model.with_python_control(python, sampling)


# --- start ----------------------------------------------------------------------------------------


def written_start(scene: Scene, robots: Robots, layout: Layout) -> State:
    """The start as written in the scene, before it is assembled."""
    pose, resolved = scene.object.pose.matrix(), robots.resolved.values()
    position = [
        pose[:3, 3],
        matrix_to_quaternion(pose[:3, :3]),
        *(r.posture for r in resolved),
    ]
    twist = np.zeros(6) if scene.object.twist is None else np.array(scene.object.twist)
    velocity = [twist, *(r.velocity for r in resolved)]
    return State(np.concatenate(position), np.concatenate(velocity), layout)


def assembled_start(scene: Scene, data: Data, written: State) -> tuple[State, StartReport]:
    """The start, assembled on the contacts that are closed there.

    Also locates the contacts of two surfaces, in the model of ``data``.
    """
    unilateral, closed = data.model.unilateral, data
    if unilateral is not None:
        closed = data.view(data.model.select(unilateral.assembled))
    places = locate_pairs(closed, written)
    data.model = replace(data.model, pair_places=places)
    closed.model = replace(closed.model, pair_places=places, unilateral=None)
    closed.set_state(0.0, written)
    start, report = close_start(closed, scene)
    check_patches(closed, start)
    if unilateral is not None:
        check_unilateral(data, start)
    return start, report


def joint_frames(scene: Scene, data: Data, start: State) -> dict[str, JointFrame]:
    """The frame of every joint, with its free motions, by arm."""
    closed, frames = data.with_contacts_closed(), {}
    for joint in scene.joints:
        frame = closed.model.frames[joint.arm]
        if joint.free is None:
            frame = replace(frame, free=free_components(closed, joint.arm, start))
        elif joint.kind not in BUILT_IN:
            _check_free(joint, closed, start)
        frames[joint.arm] = frame
    return {name: frames[name] for name in closed.model.arm_names}


def _check_free(joint: JointSpec, data: Data, start: State) -> None:
    """Raise unless the components that a kind calls free are coordinates of its free motions."""
    free = free_components(data, joint.arm, start)
    space = null_space(joint_wrenches(data, joint.arm)).basis  # (6, m)
    parts = space[list(joint.free or ())]
    if len(parts) != len(free) or np.linalg.matrix_rank(parts, 1e-6) < len(free):
        motions = ", ".join(COMPONENTS[k] for k in free) or "no motion"
        raise ModelError(
            f"joint of arm '{joint.arm}': joint kind {joint.kind!r} says free = {joint.free}, but "
            f"its contacts leave {motions} free; correct it, or leave it out"
        )


def control_law(scene: Scene, data: Data, start: State) -> ControlProgram:
    """The scene's control, for which all contacts of the joints are closed."""
    closed = data.with_contacts_closed()

    def path(waypoints: tuple[Waypoint, ...]) -> JointPath:
        return joint_path(scene, closed, start, waypoints, compile_system)

    return control_program(ControlContext(scene, closed, start, path))


def _bounds(sizes: list[int]) -> tuple[int, ...]:
    return (0, *(int(n) for n in np.cumsum(sizes)))
