"""From a scene to a compiled system: arms, contacts, programs of control and effects, a start.

A :class:`System` is frozen.  It owns the arrays that its evaluations write, so one system serves
one thread; the siblings that :meth:`System.with_control` and :meth:`System.with_solver` make share
them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from multiarm.arm import Arm, ArmFiles, ArmGroup, group_arms
from multiarm.assembly import StartReport, assemble
from multiarm.contacts.catalogue import joint_contacts, surface_offset
from multiarm.contacts.records import Contact, pack
from multiarm.control import PYTHON
from multiarm.dense_call import dense_call
from multiarm.errors import ControlError, ModelError
from multiarm.lowlevel import CallBack
from multiarm.node.regular import NodeWork, make_work
from multiarm.plant import (
    BUSY,
    CALL_CONTROL,
    CALL_DENSE,
    CALL_POTENTIAL,
    CALL_TERMS,
    Buffers,
    Plant,
    make_buffers,
    system_book,
)
from multiarm.programs import (
    NO_PROGRAM,
    ControlFunction,
    control_call,
    control_program,
    effects_program,
    needs_gravity_torque,
)
from multiarm.scene import Scene, resolve_arm
from multiarm.spatial import matrix_to_quaternion
from multiarm.state import Layout, State


@dataclass(frozen=True, eq=False)
class System:
    """A scene, compiled.

    Attributes
    ----------
    scene : Scene
    arms : dict of str to Arm
    contacts : dict of str to list of Contact
        Records of each arm's joint; the arm's geometry in the tip frame.
    layout : Layout
        Where each arm's joints and contacts are in stacked vectors.
    start_report : StartReport
        How far the scene's start was from satisfying the joints, and what was corrected.
    breakpoints : ndarray
        Times at which the control is not smooth; steps end there.
    plant, buffers, work : Plant, Buffers, NodeWork
        What the kernels read and write.
    calls : dict of str to CallBack
        What they call in Python: terms, dense, potential, and control when that is in Python.
    """

    scene: Scene
    arms: dict[str, Arm]
    contacts: dict[str, list[Contact]]
    layout: Layout
    breakpoints: np.ndarray
    plant: Plant = field(repr=False)
    buffers: Buffers = field(repr=False)
    work: NodeWork = field(repr=False)
    start_report: StartReport = field(repr=False)
    _start: State = field(repr=False)
    _groups: list[ArmGroup] = field(repr=False)
    calls: dict[str, CallBack] = field(repr=False)

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms in the order of the stacked vectors."""
        return self.layout.names

    def book(self) -> np.ndarray:
        """Address book of this system for the time loop; valid while the system lives."""
        return system_book(self.plant, self.buffers, self.work)

    @property
    def constraint_count(self) -> int:
        """Number of contacts of all joints together."""
        return self.layout.contacts

    def initial_state(self) -> State:
        """The scene's start, on the constraints, as a fresh copy."""
        return self._start.copy()

    def state(
        self,
        object_position=None,
        object_quaternion_xyzw=None,
        joint_positions: Mapping[str, np.ndarray] | None = None,
        object_twist=None,
        joint_velocities: Mapping[str, np.ndarray] | None = None,
    ) -> State:
        """A state from plain arrays; what is not given is taken from the start.

        Nothing is projected: the state may violate the joints.

        Raises
        ------
        ModelError
            An unknown arm, a wrong shape, a number that is not finite, a zero quaternion.
        """
        state = self.initial_state()
        if object_position is not None:
            state.position[:3] = _vector("object_position", object_position, 3)
        if object_quaternion_xyzw is not None:
            quaternion = _vector("object_quaternion_xyzw", object_quaternion_xyzw, 4)
            norm = np.linalg.norm(quaternion)
            if not norm > 1e-12:
                raise ModelError("object_quaternion_xyzw has length zero")
            state.position[3:7] = quaternion / norm
        if object_twist is not None:
            state.velocity[:6] = _vector("object_twist", object_twist, 6)
        self._fill(state.joint_positions, joint_positions, "joint_positions")
        self._fill(state.joint_velocities, joint_velocities, "joint_velocities")
        return state

    def with_control(self, control: ControlFunction) -> System:
        """The same system driven by a Python function ``f(t, state) -> {arm: torques}``.

        Arms that the function leaves out get no torque.  It may evaluate another system, compiled
        for it, but not this one: the two share their arrays.
        """
        call = CallBack(control_call(control, self.layout, self.buffers), self.buffers.flag)
        calls = self.plant.calls.copy()
        calls[CALL_CONTROL] = call.address
        program = np.array([[PYTHON, 0]], dtype=np.int64)
        plant = self.plant._replace(control=program, calls=calls)
        return replace(
            self,
            plant=plant,
            breakpoints=np.zeros(0),
            calls={**self.calls, "control": call},
        )

    def with_solver(self, solver: str) -> System:
        """The same system solved by ``"node"`` or by the dense reference ``"dense"``."""
        if solver not in ("node", "dense"):
            raise ModelError(f"unknown solver {solver!r}; solvers are 'node', 'dense'")
        return replace(
            self, plant=self.plant._replace(dense=np.array([solver == "dense"], dtype=np.int64))
        )

    def potential_energy(self) -> float:
        """Potential energy of arms and object [J] at the state in the buffers, origin = zero."""
        gravity = self.plant.gravity
        energy = -float(self.plant.object_mass[0]) * float(gravity @ self.buffers.position[:3])
        at = 0
        for group in self._groups:
            energy += group.potential_energy(self.buffers.q[at : at + group.model.nq])
            at += group.model.nq
        return energy

    def set_state(self, t: float, state: State) -> None:
        """Write a state into the buffers.

        Raises
        ------
        ModelError
            For a state of a system with other arms.
        ControlError
            When called from within a controller of this system.
        """
        if state.layout != self.layout:
            raise ModelError(
                f"this state belongs to a system with arms {', '.join(state.layout.names)} "
                f"({state.layout.joints} joints), not to this one; make it with `system.state(...)`"
            )
        b = self.buffers
        if b.flag[BUSY]:
            raise ControlError(
                "the controller evaluates the very system that it drives, whose arrays are in use; "
                "compile a second one for it: `model = multiarm.compile_system(scene)`"
            )
        b.time[0] = t
        b.position[:] = state.position[:7]
        b.angles[:] = state.position[7:]
        b.twist[:] = state.velocity[:6]
        b.v[:] = state.velocity[6:]
        b.torque[:] = 0.0  # another system's control may have left its torques here

    def get_state(self) -> State:
        """A copy of the state in the buffers."""
        b = self.buffers
        return State(
            np.concatenate([b.position, b.angles]), np.concatenate([b.twist, b.v]), self.layout
        )

    def reraise(self) -> None:
        """Raise what a callback ran into, and lower the flag."""
        self.buffers.flag[0] = 0
        for call in self.calls.values():
            call.reraise()

    def forgive(self) -> None:
        """Forget what a callback ran into, and lower the flag."""
        self.buffers.flag[0] = 0
        for call in self.calls.values():
            call.error = None

    def _fill(self, views, given, what: str) -> None:
        for arm, values in (given or {}).items():
            if arm not in views:
                raise ModelError(f"{what}: unknown arm {arm!r}; arms are {', '.join(views)}")
            views[arm][:] = _vector(f"{what}[{arm!r}]", values, views[arm].size)


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


def _vector(what: str, values, size: int) -> np.ndarray:
    try:
        vector = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ModelError(f"{what}: expected {size} numbers, got {values!r}") from None
    if vector.shape != (size,):
        raise ModelError(f"{what}: expected shape ({size},), got {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise ModelError(f"{what}: a number is not finite: {vector.tolist()}")
    return vector
