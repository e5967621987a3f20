"""From a scene to a compiled system: arms, contacts, programs of control and effects, a start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from multiarm.arm import Arm, ArmFiles, ArmGroup, group_arms
from multiarm.assembly import StartReport, assemble
from multiarm.contacts.catalogue import joint_contacts, surface_offset
from multiarm.contacts.records import Contact, pack
from multiarm.dense_call import dense_call
from multiarm.errors import ModelError
from multiarm.lowlevel import CallBack
from multiarm.node.regular import make_work
from multiarm.plant import (
    CALL_DENSE,
    CALL_POTENTIAL,
    CALL_TERMS,
    Buffers,
    Plant,
    make_buffers,
)
from multiarm.programs import (
    NO_PROGRAM,
    ControlFunction,
    control_program,
    effects_program,
    needs_gravity_torque,
)
from multiarm.scene import Scene, resolve_arm
from multiarm.spatial import matrix_to_quaternion
from multiarm.state import Layout, State
from multiarm.system import System


def compile_system(scene: Scene, control: ControlFunction | None = None) -> System:
    """Build the system that a scene describes; only what the scene names is in it.

    Parameters
    ----------
    scene : Scene
    control : callable, optional
        ``f(t, state) -> {arm: torques}`` in place of the scene's control; arms that it leaves out
        get no torque.

    Raises
    ------
    SceneError
        When the start does not satisfy the joints and is too far from doing so.
    ModelError
        When a robot cannot be used.
    """
    resolved = {name: resolve_arm(spec, scene.folder) for name, spec in scene.arms.items()}
    arms = {name: _make_arm(name, scene.arms[name], resolved[name]) for name in scene.arms}
    joints = {joint.arm: joint for joint in scene.joints}
    contacts = {
        name: _contacts(joints[name], scene, arm, resolved[name].posture)
        for name, arm in arms.items()
    }
    layout = Layout(
        names=tuple(arms),
        dofs=_bounds([arm.dof for arm in arms.values()]),
        rows=_bounds([len(contacts[name]) for name in arms]),
    )
    gravity = np.array(scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0))
    groups = group_arms(list(arms.values()), gravity, needs_gravity_torque(scene))
    buffers = make_buffers(
        len(arms), layout.joints, layout.contacts, sum(g.model.nq for g in groups)
    )
    work = make_work(list(np.diff(layout.dofs)), list(np.diff(layout.rows)))
    calls = {"terms": CallBack(_terms_call(groups, buffers), buffers.flag)}
    plant = _plant(scene, arms, contacts, groups, gravity)
    plant.calls[CALL_TERMS] = calls["terms"].address
    calls["dense"] = CallBack(dense_call(plant.pointers, buffers, work), buffers.flag)
    plant.calls[CALL_DENSE] = calls["dense"].address
    start = _written_start(scene, resolved, layout)
    system = System(
        scene=scene,
        arms=arms,
        contacts=contacts,
        layout=layout,
        breakpoints=np.zeros(0),
        plant=plant,
        buffers=buffers,
        work=work,
        start_report=StartReport(),
        _start=start,
        _groups=groups,
        calls=calls,
    )
    if np.any(gravity):
        calls["potential"] = CallBack(_potential_call(system), buffers.flag)
        plant.calls[CALL_POTENTIAL] = calls["potential"].address
    start, report = assemble(system, start)
    system = replace(system, _start=start, start_report=report)
    if control is not None:
        return system.with_control(control)
    program = control_program(system)
    plant = plant._replace(
        control=program.codes, parameters=np.concatenate([plant.parameters, program.parameters])
    )
    return replace(system, plant=plant, breakpoints=program.breakpoints)


def _make_arm(name: str, spec, resolved) -> Arm:
    tool = spec.tool
    files = ArmFiles(
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
    arm = Arm(name, files, spec.color)
    if arm.joint_names != resolved.joint_names:
        raise ModelError(
            f"arm '{name}': Pinocchio orders its joints {arm.joint_names}, the URDF's chain is "
            f"{resolved.joint_names}; give the chain's joints names in order"
        )
    return arm


def _contacts(joint, scene: Scene, arm: Arm, posture: np.ndarray) -> list[Contact]:
    """Contact records of one joint; without ``at`` its frame is where the tip is at the start."""
    if joint.at is not None:
        return joint_contacts(joint, joint.at.matrix())
    offset = np.eye(4)
    offset[:3, 3] = surface_offset(joint)
    frame = arm.tip_pose(posture) @ joint.at_tip.matrix() @ offset
    return joint_contacts(joint, np.linalg.solve(scene.object.pose.matrix(), frame))


def _plant(
    scene: Scene,
    arms: dict[str, Arm],
    contacts: dict[str, list[Contact]],
    groups: list[ArmGroup],
    gravity: np.ndarray,
) -> Plant:
    """Everything constant but the control; the callbacks' addresses are filled in later."""
    records = [
        contact.moved_on_arm(arm.tip_rotation, arm.tip_translation)
        for name, arm in arms.items()
        for contact in contacts[name]
    ]
    table = pack(records)
    first_q = np.cumsum([0] + [g.model.nq for g in groups[:-1]])
    effects = effects_program(scene, arms)
    return Plant(
        pointers=np.vstack([g.pointers for g in groups]),
        q_slots=np.concatenate([g.q_slots + q for g, q in zip(groups, first_q, strict=True)]),
        circular=np.concatenate([arm.circular for arm in arms.values()]).astype(np.int64),
        codes=table.codes,
        geometry=table.geometry,
        object_mass=np.array([float(scene.object.mass)]),
        object_inertia=np.ascontiguousarray(scene.object.inertia_matrix()),
        gravity=gravity,
        control=NO_PROGRAM,
        effects=effects.codes,
        parameters=effects.parameters,
        calls=np.zeros(4, dtype=np.int64),
        dense=np.array([scene.run.solver == "dense"], dtype=np.int64),
    )


def _written_start(scene: Scene, resolved: dict, layout: Layout) -> State:
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


def _terms_call(groups: list[ArmGroup], buffers: Buffers) -> Callable[[], None]:
    """One function that lets Pinocchio update the terms of all groups."""
    updates = []
    q = v = 0
    for group in groups:
        updates.append(
            group.bind(buffers.q[q : q + group.model.nq], buffers.v[v : v + group.model.nv])
        )
        q, v = q + group.model.nq, v + group.model.nv
    if len(updates) == 1:
        return updates[0]

    def update_all() -> None:
        for update in updates:
            update()

    return update_all


def _potential_call(system: System) -> Callable[[], None]:
    def update() -> None:
        system.buffers.energy[1] = system.potential_energy()

    return update


def _bounds(sizes: list[int]) -> tuple[int, ...]:
    return (0, *(int(n) for n in np.cumsum(sizes)))
