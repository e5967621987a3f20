"""From a scene to a compiled system: arms, contacts, programs of control and effects, a start.

Systems that have something in common share what no evaluation writes.  A *twin* of a system is the
same one with arrays of its own, so that two threads can work at once; a system of another scene may
take the arms and joints in which the two scenes agree.  Both are made by the steps by which any
system is made, and give the same numbers, bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from multiarm.arms.arm import Arm, ArmFiles
from multiarm.arms.backends import ArmBackends, Ground
from multiarm.assembly import StartReport, assemble
from multiarm.assembly.contact_checks import check_patches, choose_free, locate_pairs
from multiarm.assembly.joints import Parts, make_joints, on_link
from multiarm.assembly.likeness import same_arms, same_backends, same_joints, shared
from multiarm.assembly.system import System
from multiarm.contacts.catalogue import FREE
from multiarm.contacts.frames import FRAME_WIDTH
from multiarm.contacts.kernel import RELATIVE_WIDTH
from multiarm.contacts.records import ContactTable, pack
from multiarm.contacts.surfaces import answering
from multiarm.contacts.unilateral import (
    SURROUNDINGS,
    UnilateralConstraints,
    unilateral_constraints,
)
from multiarm.control.laws import (
    NO_PROGRAM,
    ControlFunction,
    control_program,
    needs_gravity_torque,
)
from multiarm.dynamics.arrays import (
    CALL_CONTROL,
    CALL_COUNT,
    CALL_DENSE,
    CALL_FUNCTION,
    CALL_SURFACE,
    Plant,
    make_buffers,
)
from multiarm.dynamics.dense_callback import dense_call
from multiarm.dynamics.equations import connect_functions
from multiarm.dynamics.solver.singular import make_coupled
from multiarm.dynamics.solver.work import make_work
from multiarm.dynamics.state import Layout, State
from multiarm.effects.building import build_pieces
from multiarm.effects.piece import Piece, Pieces, Site, joint_numbers
from multiarm.errors import ModelError
from multiarm.events.beginning import check_beginning
from multiarm.events.selection import joint_rows, link_springs, select
from multiarm.integration.monitors import WATCH_WIDTH, make_watches
from multiarm.integration.near_singular import connect_crossing
from multiarm.jit.pointers import GuardedCall, PythonCallback
from multiarm.scene import (
    ARM_TERMS,
    ArmSpec,
    NamedCode,
    ResolvedArm,
    Scene,
    friction_of,
    resolve_arm,
    with_code,
    without_code,
)
from multiarm.spatial import matrix_to_quaternion


def compile_system(
    scene: Scene,
    control: ControlFunction | None = None,
    *,
    arms: str | None = None,
    like: System | None = None,
    code: bool | None = None,
) -> System:
    """Build the system that a scene describes; only what the scene names is in it.

    Parameters
    ----------
    scene : Scene
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control; arms that it leaves out
        get no torque.
    arms : {"pinocchio", "compiled"}, optional
        Who computes the arms' terms, in place of ``run.arms`` of the scene.
    like : System, optional
        Of a similar scene: arms and joints that are written alike are not made anew, and no URDF
        of such an arm is read again.  The result is the same; the two may serve different threads.
    code : bool, optional
        Whether the functions and the effects of packages that the scene names may be loaded, which
        is where their code is run first.  When left out, as the scene was read: scene files may,
        unless ``load_scene`` was told otherwise, and stored results may not.

    Raises
    ------
    SceneError
        When the start does not satisfy the joints and is too far from doing so; when the scene
        names code and may not load any.
    ModelError
        When a robot cannot be used, a function cannot be loaded, or a compiled arm is not the
        robot's.
    """
    scene = with_code(_with_arms(scene, arms), code)
    known = same_arms(scene, like)
    resolved = {
        name: known[name][0] if name in known else resolve_arm(spec, scene.folder)
        for name, spec in scene.arms.items()
    }
    made = {
        name: known[name][1].twin() if name in known else _make_arm(name, scene, resolved[name])
        for name in scene.arms
    }
    joints = make_joints(scene, made, resolved, same_joints(scene, known, like))
    system = _unassembled(scene, Parts(resolved, joints), made, same_backends(scene, known, like))
    if system.unilateral is not None:
        return _with_unilateral(system, control)
    return _controlled(_with_free_motions(_at_start(system)), control)


def compile_for_a_look(scene: Scene, arms: str | None = None) -> tuple[System, list[NamedCode]]:
    """Build a system of what a scene has without the code that it names, and tell what that is.

    Where joints lack contacts, the start is the one that is written, not assembled, the free
    motions of joints are those of the catalogue only, and there is no control.

    Raises
    ------
    SceneError, ModelError
        See :func:`compile_system`.
    """
    scene, left = without_code(_with_arms(scene, arms))
    if not any(code.arm for code in left):
        return compile_system(scene), left
    resolved = {name: resolve_arm(spec, scene.folder) for name, spec in scene.arms.items()}
    made = {name: _make_arm(name, scene, resolved[name]) for name in scene.arms}
    joints = make_joints(scene, made, resolved, {})
    system = _unassembled(scene, Parts(resolved, joints), made)
    return replace(system, _places=locate_pairs(system, system.initial_state())), left


def twin(system: System) -> System:
    """The same system with arrays of its own, for another thread.

    Arms, joints and constants are shared; what effects and contacts remember is not.  It begins
    like a system that has just been compiled.
    """
    scene, parts = system.scene, system.parts
    arms = {name: arm.twin() for name, arm in system.arms.items()}
    joints = make_joints(scene, arms, parts.arms, shared(parts.joints, arms))
    fresh = _unassembled(scene, Parts(parts.arms, joints), arms, system._backends.twin())
    fresh = replace(
        fresh,
        plant=_with_control_of(fresh.plant, system.plant),
        frames=system.frames,
        breakpoints=system.breakpoints,
        start_report=system.start_report,
        _start=system._start,
        _places=system._places,
    )
    control = system.python_control
    return fresh if control is None else fresh.with_control(control)


def _with_arms(scene: Scene, arms: str | None) -> Scene:
    """The scene with another choice of who computes the arms' terms."""
    if arms is None:
        return scene
    if arms not in ARM_TERMS:
        raise ModelError(f"unknown arms {arms!r}; arms are {', '.join(map(repr, ARM_TERMS))}")
    return scene.model_copy(update={"run": scene.run.model_copy(update={"arms": arms})})


def _with_unilateral(full: System, control: ControlFunction | None) -> System:
    """A system with unilateral constraints: what holds of its model, its start and its control."""
    unilateral = full.unilateral
    assert unilateral is not None, "a system with unilateral constraints"
    start = _at_start(replace(select(full, unilateral.assembled), unilateral=None))
    check_beginning(full, start.initial_state())
    model = replace(select(full, unilateral.model), unilateral=None, _start=start._start)
    model = _controlled(_with_free_motions(model), control)
    plant = _with_control_of(full.plant, model.plant)
    plant.calls[CALL_CONTROL] = model.plant.calls[CALL_CONTROL]
    return replace(
        full,
        plant=plant,
        calls={**model.calls, **full.calls},
        frames=model.frames,
        breakpoints=model.breakpoints,
        start_report=start.start_report,
        _start=start._start,
    )


def _with_control_of(plant: Plant, other: Plant) -> Plant:
    """A plant with another one's control and free motions."""
    taken = ("control", "parameters", "frames", "free", "free_bounds")
    return plant._replace(**{name: getattr(other, name) for name in taken})


def _at_start(system: System) -> System:
    """A system at its start, on its contacts."""
    written = system.initial_state()
    system = replace(system, _places=locate_pairs(system, written))
    start, report = assemble(system, written)
    system = replace(system, _start=start, start_report=report)
    check_patches(system)
    return system


def _controlled(system: System, control: ControlFunction | None) -> System:
    """A system with its control."""
    if control is not None:
        return system.with_control(control)
    program = control_program(system)
    plant = system.plant._replace(
        control=program.laws,
        parameters=np.concatenate([system.plant.parameters, program.parameters]),
    )
    breakpoints = np.union1d(system.pieces.breakpoints, program.breakpoints)
    return replace(system, plant=plant, breakpoints=breakpoints)


def _unassembled(
    scene: Scene, parts: Parts, arms: dict[str, Arm], backends: ArmBackends | None = None
) -> System:
    """The system without control, its start as it is written; ``backends`` is made if not given."""
    joints = parts.joints
    outlines = {name: own.joints for name, own in parts.arms.items()}
    contacts = {name: joint.contacts for name, joint in joints.items()}
    unilateral = _unilateral(scene, arms, contacts, outlines)
    records: Mapping[str, list] = contacts if unilateral is None else unilateral.records
    around = records.get(SURROUNDINGS, [])
    owners = [*arms, *([SURROUNDINGS] if around else [])]
    layout = Layout(
        names=tuple(arms),
        dofs=_bounds([arms[name].dof if name in arms else 0 for name in owners]),
        rows=_bounds([len(records[name]) for name in owners]),
    )
    on_links = {name: on_link(arms[name], records[name]) for name in arms}
    if around:
        on_links[SURROUNDINGS] = around
    gravity = np.array(scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0))
    backends = backends or ArmBackends(
        arms, gravity, needs_gravity_torque(scene), scene.run.arms == "compiled"
    )
    every_row = [record for own in on_links.values() for record in own]
    table = pack(every_row)
    site = Site(scene, arms, layout, outlines, backends)
    pieces = build_pieces(site, _unilateral_pieces(unilateral))
    watched = on_links if unilateral is None else {name: [] for name in arms}
    limits = {name: joint.limits for name, joint in joints.items()}
    watches = make_watches(watched, limits, layout, pieces.watched)
    plant = _plant(scene, arms, table, backends, gravity, pieces)._replace(watches=watches)
    plant = plant._replace(joint_rows=joint_rows(table, layout))
    ground = Ground(gravity) if around else None
    if ground is not None:
        plant = plant._replace(pointers=np.vstack([plant.pointers, ground.pointers]))
    buffers = make_buffers(
        plant, layout.contacts, backends.configuration, len(pieces.works), pieces.states
    )
    sizes = np.diff(layout.dofs).tolist(), np.diff(layout.rows).tolist()
    levers = [arms[name].levers(joints[name].frame.on_tip[:3, 3]) for name in arms]
    levers += [np.zeros(0)] * (len(owners) - len(arms))
    work, coupled = make_work(*sizes, levers), make_coupled(*sizes)
    calls: dict[str, GuardedCall] = {**backends.connect(buffers, plant.calls)}
    dense = PythonCallback(dense_call(plant.pointers, buffers, work), buffers.flag)
    calls["dense"], plant.calls[CALL_DENSE] = dense, dense.address
    for name, call in pieces.connect(buffers).items():
        calls[name] = call
        plant.calls[CALL_FUNCTION] = call.address
    calls |= {**connect_functions(plant.calls), **connect_crossing(plant.calls)}
    if table.functions:
        answer = answering(table.functions, buffers.query[RELATIVE_WIDTH:])
        calls["surface"] = PythonCallback(answer, buffers.flag)
        plant.calls[CALL_SURFACE] = calls["surface"].address
    system = System(
        scene=scene,
        arms=arms,
        contacts={name: records[name] for name in arms},
        frames={name: joint.frame for name, joint in joints.items()},
        layout=layout,
        breakpoints=pieces.breakpoints,
        plant=plant,
        buffers=buffers,
        work=work,
        coupled=coupled,
        pieces=pieces,
        start_report=StartReport(),
        surfaces=tuple(table.functions),
        records=tuple(every_row),
        unilateral=unilateral,
        parts=parts,
        _start=_written_start(scene, parts.arms, layout),
        _backends=backends,
        _ground=ground,
        _places=np.zeros_like(buffers.places),
        calls=calls,
    )
    if unilateral is not None and unilateral.compliant is not None:
        link_springs(system, unilateral.compliant)
    return system


def _unilateral_pieces(unilateral: UnilateralConstraints | None) -> list[Piece]:
    """What unilateral constraints add to an evaluation; only they import its kernels."""
    if unilateral is None:
        return []
    from multiarm.effects.dry_friction import friction_pieces
    from multiarm.events.compliance import compliance_pieces

    return [*friction_pieces(unilateral), *compliance_pieces(unilateral.compliant)]


def _unilateral(
    scene: Scene, arms: dict[str, Arm], contacts: Mapping[str, list], outlines: Mapping
) -> UnilateralConstraints | None:
    """The unilateral constraints of a scene; None: it has none."""
    effects = scene.effects
    if not effects.with_events:
        return None
    limits = {
        name: dict(zip(arm.joint_names, map(tuple, arm.position_limits), strict=True))
        for name, arm in arms.items()
    }
    dry = None
    if "joint_friction" in effects.with_events and effects.joint_friction is not None:
        dry = joint_numbers(effects.joint_friction.torque, outlines, friction_of)
    return unilateral_constraints(scene, contacts, limits, dry)


def arm_files(spec: ArmSpec, resolved: ResolvedArm) -> ArmFiles:
    """Where an arm of a scene comes from, once its robot has been looked up."""
    tool = spec.tool
    return ArmFiles(
        urdf=resolved.urdf,
        package_dirs=resolved.package_dirs,
        base=spec.base.matrix(),
        tip=spec.tip,
        locked=resolved.locked,
        tool_urdf=resolved.tool_urdf,
        tool_package_dirs=resolved.tool_package_dirs,
        mount=tool.mount if tool is not None else None,
        tool_placement=tool.at.matrix() if tool is not None else None,
    )


def _make_arm(name: str, scene: Scene, resolved: ResolvedArm) -> Arm:
    spec, rotors = scene.arms[name], scene.effects.rotor_inertia
    own = None
    if rotors is not None:
        from multiarm.effects.rotor_inertia import of_arm

        own = of_arm(rotors, name, resolved.joint_names)
    arm = Arm(name, arm_files(spec, resolved), spec.color, own)
    if arm.joint_names != resolved.joint_names:
        raise ModelError(
            f"arm '{name}': Pinocchio orders its joints {arm.joint_names}, the URDF's chain is "
            f"{resolved.joint_names}; give the chain's joints names in order"
        )
    return arm


def _with_free_motions(system: System) -> System:
    """The system with the free motions of every joint chosen, and recorded."""
    frames = {}
    for joint in system.scene.joints:
        frame = system.frames[joint.arm]
        if FREE[joint.kind] is None:
            frame = replace(frame, free=choose_free(system, joint.arm))
        frames[joint.arm] = frame
    frames = {name: frames[name] for name in system.arm_names}
    free = [pair for f in frames.values() for pair in zip(f.free, f.places, strict=True)]
    packed = [
        frame.packed(system.arms[name].tip_rotation, system.arms[name].tip_translation)
        for name, frame in frames.items()
    ]
    plant = system.plant._replace(
        frames=np.array(packed),
        free_bounds=np.array(_bounds([len(frame.free) for frame in frames.values()])),
        free=np.array(free, dtype=np.int64).reshape(-1, 2),
    )
    return replace(system, frames=frames, plant=plant)


def _plant(
    scene: Scene,
    arms: dict[str, Arm],
    table: ContactTable,
    backends: ArmBackends,
    gravity: np.ndarray,
    pieces: Pieces,
) -> Plant:
    """Everything constant but the control; the callbacks' addresses are filled in later."""
    effects, phases = pieces.program()
    return Plant(
        pointers=backends.pointers,
        q_slots=backends.q_slots,
        circular=np.concatenate([arm.circular for arm in arms.values()]).astype(np.int64),
        codes=table.codes,
        geometry=table.geometry,
        shapes=table.shapes,
        frames=np.zeros((len(arms), FRAME_WIDTH)),
        free_bounds=np.zeros(len(arms) + 1, dtype=np.int64),
        free=np.zeros((0, 2), dtype=np.int64),
        watches=np.zeros((0, WATCH_WIDTH)),
        object_mass=np.array([float(scene.object.mass)]),
        object_inertia=np.ascontiguousarray(scene.object.inertia_matrix()),
        gravity=gravity,
        control=NO_PROGRAM,
        effects=effects,
        phases=phases,
        parameters=np.zeros(0),
        calls=np.zeros(CALL_COUNT, dtype=np.int64),
        dense=np.array([scene.run.solver == "dense"], dtype=np.int64),
        joint_rows=np.zeros((0, 3), dtype=np.int64),
        links=np.zeros(0, dtype=np.int64),
    )


def _written_start(scene: Scene, resolved: Mapping, layout: Layout) -> State:
    """The start as the scene has it, before it is assembled."""
    pose = scene.object.pose.matrix()
    position = [
        pose[:3, 3],
        matrix_to_quaternion(np.ascontiguousarray(pose[:3, :3])),
        *(r.posture for r in resolved.values()),
    ]
    twist = np.zeros(6) if scene.object.twist is None else np.array(scene.object.twist)
    velocity = [twist, *(r.velocity for r in resolved.values())]
    return State(np.concatenate(position), np.concatenate(velocity), layout)


def _bounds(sizes: list[int]) -> tuple[int, ...]:
    return (0, *(int(n) for n in np.cumsum(sizes)))
