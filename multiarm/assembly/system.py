"""A scene, compiled: frozen, with the arrays and callbacks that its evaluations use.

A :class:`System` is frozen.  It owns the arrays that its evaluations write, so one system serves
one thread; the siblings that :meth:`System.with_control` and :meth:`System.with_solver` make share
them.  Another thread takes a twin (:func:`multiarm.assembly.compilation.twin`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.backends import ArmBackends, Ground
from multiarm.arms.terms import Coriolis
from multiarm.assembly import StartReport
from multiarm.assembly.joints import Parts
from multiarm.contacts.frames import COMPONENTS, UNITS, JointFrame
from multiarm.contacts.records import Contact, JointRow, SmoothShape
from multiarm.contacts.unilateral import SURROUNDINGS, UnilateralConstraints
from multiarm.control.laws import (
    ControlFunction,
    control_call,
)
from multiarm.control.torques import python_control
from multiarm.dynamics.arrays import (
    BUSY,
    CALL_CONTROL,
    CALL_FUNCTION,
    CALL_SURFACE,
    CALL_TERMS,
    Buffers,
    Plant,
    system_struct,
)
from multiarm.dynamics.solver.singular import CoupledWork
from multiarm.dynamics.solver.work import NodeWork
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.user_callback import Asked
from multiarm.effects.piece import Pieces
from multiarm.errors import ControlError, ModelError
from multiarm.jit.pointers import GuardedCall, address_of
from multiarm.results.channels import Channel, trajectory_channels
from multiarm.scene import Scene


@dataclass(frozen=True, eq=False)
class System:
    """A scene, compiled.

    Attributes
    ----------
    scene : Scene
    arms : dict of str to Arm
    contacts : dict of str to list of Contact
        Records of each arm's joint; the arm's geometry in the tip frame.
    frames : dict of str to JointFrame
        Each joint's frame on both bodies, and the motions that it leaves free.
    layout : Layout
        Where each arm's joints and contacts are in stacked vectors.
    start_report : StartReport
        How far the scene's start was from satisfying the joints, and what was corrected.
    breakpoints : ndarray
        Times at which the control is not smooth; steps end there.
    plant, buffers, work, coupled : Plant, Buffers, NodeWork, CoupledWork
        What the kernels read and write.
    records : tuple of Contact or JointRow
        All rows of W, the arms' geometry in the frame of the link that carries the tip.
    unilateral : UnilateralConstraints or None
        Which rows are active at some times only.  The system itself then has all rows that may be
        active at some time, and is simulated a mode at a time.
    pieces : Pieces
        What the scene's effects add to an evaluation.
    surfaces : tuple of SmoothShape
        Surfaces of the user's.
    parts : Parts
        What it was made of, so that similar systems can be made of the same.
    calls : dict of str to GuardedCall
        What they call in Python: terms, dense, potential, surface, functions of effects, and
        control when that is in Python.
    """

    scene: Scene
    arms: dict[str, Arm]
    contacts: dict[str, list[Contact]]
    frames: dict[str, JointFrame]
    layout: Layout
    breakpoints: np.ndarray
    plant: Plant = field(repr=False)
    buffers: Buffers = field(repr=False)
    work: NodeWork = field(repr=False)
    coupled: CoupledWork = field(repr=False)
    pieces: Pieces = field(repr=False)
    start_report: StartReport = field(repr=False)
    surfaces: tuple[SmoothShape, ...] = field(repr=False)
    records: tuple[Contact | JointRow, ...] = field(repr=False)
    parts: Parts = field(repr=False)
    _start: State = field(repr=False)
    _backends: ArmBackends = field(repr=False)
    _ground: Ground | None = field(repr=False)
    _places: np.ndarray = field(repr=False)
    calls: dict[str, GuardedCall] = field(repr=False)
    unilateral: UnilateralConstraints | None = field(repr=False, default=None)

    @property
    def arm_terms(self) -> dict[str, str]:
        """Who computes the terms of each arm: ``"compiled"`` code or ``"pinocchio"``."""
        return self._backends.by_arm

    @property
    def not_compiled(self) -> dict[str, str]:
        """Why an arm stays with Pinocchio although the scene wants compiled ones, by arm."""
        return self._backends.reasons

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms in the order of the stacked vectors."""
        return self.layout.names

    def struct(self) -> np.ndarray:
        """Struct of this system for the time loop; valid while the system lives."""
        return self._struct

    @cached_property
    def _struct(self) -> np.ndarray:
        return system_struct(self.plant, self.buffers, self.work, self.coupled, self.pieces.arrays)

    @property
    def asked(self) -> list[Asked]:
        """The user's functions ``f(t, state)``: a controller, wrenches from outside."""
        return [call for call in self.calls.values() if isinstance(call, Asked)]

    @property
    def python_control(self) -> ControlFunction | None:
        """The user's controller, where it has taken the place of the scene's control."""
        call = self.calls.get("control")
        return call.function if isinstance(call, Asked) else None

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """What a run records."""
        around = self.records[self.layout.surroundings]
        return trajectory_channels(
            {name: arm.joint_units for name, arm in self.arms.items()},
            {name: [contact.name for contact in own] for name, own in self.contacts.items()},
            {name: {COMPONENTS[k]: UNITS[k] for k in f.free} for name, f in self.frames.items()},
            self.pieces.works,
            self.contacts_with_states,
            [record.name for record in around],
        )

    @property
    def contacts_with_states(self) -> dict[str, tuple[str, ...]] | None:
        """Names of the unilateral contacts, by their owners; None where all are bilateral."""
        if self.unilateral is None:
            return None
        owners = [*self.arm_names, SURROUNDINGS]
        return {owner: self.unilateral.contacts_of(owner) for owner in owners}

    @property
    def calls_python(self) -> bool:
        """Whether every evaluation enters Python, where one thread works at a time."""
        places = (CALL_TERMS, CALL_CONTROL, CALL_SURFACE, CALL_FUNCTION)
        asks = self.plant.dense[0] == 1 or bool(self.asked)
        return asks or any(self.plant.calls[place] != 0 for place in places)

    @cached_property
    def bases(self) -> np.ndarray:
        """Where the arms stand, world axes, shape (n, 3) [m]."""
        return np.array([arm.files.base[:3, 3] for arm in self.arms.values()])

    @property
    def constraint_count(self) -> int:
        """Number of contacts of all joints together."""
        return self.layout.contacts

    def owner(self, row: int) -> tuple[str, Contact | JointRow]:
        """Arm (or surroundings) and record of a row of W."""
        i = int(np.searchsorted(self.layout.rows, row, side="right")) - 1
        if i >= len(self.arm_names):
            return SURROUNDINGS, self.records[row]
        return self.arm_names[i], self.records[row]

    def joint_name(self, joint: int) -> str:
        """Name of a joint, given by its place in the stacked vectors."""
        i = int(np.searchsorted(self.layout.dofs, joint, side="right")) - 1
        return self.arms[self.arm_names[i]].joint_names[joint - self.layout.dofs[i]]

    def joint_unit(self, joint: int) -> str:
        """Unit of a joint's coordinate, ``"rad"`` or ``"m"``, given by its place."""
        units = [unit for arm in self.arms.values() for unit in arm.joint_units.values()]
        return units[joint]

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
            state.position[:3] = checked_vector("object_position", object_position, 3)
        if object_quaternion_xyzw is not None:
            quaternion = checked_vector("object_quaternion_xyzw", object_quaternion_xyzw, 4)
            norm = np.linalg.norm(quaternion)
            if not norm > 1e-12:
                raise ModelError("object_quaternion_xyzw has length zero")
            state.position[3:7] = quaternion / norm
        if object_twist is not None:
            state.velocity[:6] = checked_vector("object_twist", object_twist, 6)
        self._fill(state.joint_positions, joint_positions, "joint_positions")
        self._fill(state.joint_velocities, joint_velocities, "joint_velocities")
        return state

    def with_control(self, control: ControlFunction) -> System:
        """The same system driven by a Python function ``f(t, state) -> {arm: torques}``.

        Arms that the function leaves out get no torque.  It may evaluate another system, compiled
        for it, but not this one: the two share their arrays.  Where many runs go on at once
        (:func:`multiarm.simulate_many`), all threads call this one function.
        """
        call = control_call(control, self.layout, self.buffers)
        calls = self.plant.calls.copy()
        calls[CALL_CONTROL] = call.address
        program = np.array([[address_of(python_control), 0]], dtype=np.int64)
        plant = self.plant._replace(control=program, calls=calls)
        return replace(
            self,
            plant=plant,
            breakpoints=self.pieces.breakpoints,
            calls={**self.calls, "control": call},
        )

    def with_solver(self, solver: str) -> System:
        """The same system solved by ``"node"`` or by the dense reference ``"dense"``."""
        if solver not in ("node", "dense"):
            raise ModelError(f"unknown solver {solver!r}; solvers are 'node', 'dense'")
        if solver == self.scene.run.solver and self.plant.dense[0] == (solver == "dense"):
            return self
        run = self.scene.run.model_copy(update={"solver": solver})
        return replace(
            self,
            scene=self.scene.model_copy(update={"run": run}),
            plant=self.plant._replace(dense=np.array([solver == "dense"], dtype=np.int64)),
        )

    def coriolis(self) -> Coriolis:
        """What updates the arms' matrices of Coriolis forces, and where they are.

        Valid while the system lives; they are made once.
        """
        found, call = self._backends.coriolis(self.buffers)
        if call is not None:
            self.calls["coriolis"] = call  # asked what it ran into, like the others
        return found

    def potential_energy(self) -> float:
        """Potential energy of arms and object [J] at the state in the buffers, origin = zero."""
        gravity = self.plant.gravity
        energy = -float(self.plant.object_mass[0]) * float(gravity @ self.buffers.position[:3])
        return energy + self._backends.potential_energy(self.buffers)

    def set_state(self, t: float, state: State) -> None:
        """Write a state into the buffers.

        Raises
        ------
        ModelError
            For a state of a system with other arms.
        ControlError
            When called from within a controller of this system, or a function of a wrench, or from
            ``progress`` of its run.
        """
        if not state.layout.same_joints(self.layout):
            raise ModelError(
                f"this state belongs to a system with arms {', '.join(state.layout.names)} "
                f"({state.layout.joints} joints), not to this one; make it with `system.state(...)`"
            )
        b = self.buffers
        if b.flag[BUSY]:
            raise ControlError(
                "the controller (or a wrench's function, or `progress`) evaluates the very system "
                "that runs, whose arrays are in use; compile a second one for it: "
                "`model = multiarm.compile_system(scene)`"
            )
        b.time[0] = t
        b.position[:] = state.position[:7]
        b.angles[:] = state.position[7:]
        b.twist[:] = state.velocity[:6]
        b.v[:] = state.velocity[6:]
        b.torque[:] = 0.0  # another system's control may have left its torques here
        b.time[1] = np.inf
        b.inner[:] = b.inner_rate[:] = 0.0
        b.places[:] = self._places
        b.coordinates[:] = np.nan
        b.margins[:] = np.nan
        b.event_count[0] = 0
        b.solved[:] = 0.0
        b.lost[:] = 0
        b.signs[:] = 0.0
        for surface in self.surfaces:
            surface.reset()

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
            views[arm][:] = checked_vector(f"{what}[{arm!r}]", values, views[arm].size)


def checked_vector(what: str, values, size: int) -> np.ndarray:
    """A vector of the right size whose numbers are finite, or a ModelError that says ``what``."""
    try:
        vector = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ModelError(f"{what}: expected {size} numbers, got {values!r}") from None
    if vector.shape != (size,):
        raise ModelError(f"{what}: expected shape ({size},), got {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise ModelError(f"{what}: a number is not finite: {vector.tolist()}")
    return vector
