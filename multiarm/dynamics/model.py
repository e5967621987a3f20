"""Model and Data: the constants of a compiled scene, and the variables of its evaluations.

A :class:`Model` does not change after it has been built, so that any number of threads share it.
The model of a scene with unilateral contacts has all rows that can ever be closed; simulations use
models with the closed ones (:meth:`Model.select`).

Each thread needs its own :class:`Data`, which :meth:`Model.data` makes.  For compiled code, a
struct (:mod:`multiarm.dynamics.arrays`) contains its arrays and the constants of its model.  Python
functions that the code calls (Pinocchio, user functions, the dense solver) are callbacks of the
Data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from multiarm.arms.arm import Arm
from multiarm.arms.backends import ArmBackends, Ground
from multiarm.arms.terms import Coriolis
from multiarm.contacts.joint import Joint, JointFrame
from multiarm.contacts.kernel import ContactRow
from multiarm.contacts.surfaces import user_surface_callback
from multiarm.contacts.table import (
    JOINT,
    Code,
    ContactTable,
    JointRow,
    count_parts,
    empty_table,
    make_joint_rows,
    select_joint_rows,
    select_rows,
)
from multiarm.contacts.unilateral import UnilateralConstraints
from multiarm.dynamics.arrays import COUPLED, FUNCTIONS, STATUS, Constants, system_struct
from multiarm.dynamics.callbacks import DenseSolver, PythonControl, UserCallback
from multiarm.dynamics.control_laws import NO_CONTROL, ControlLaw, are_differentiable
from multiarm.dynamics.effect_kernels import EffectProgram
from multiarm.dynamics.guards import Guard, make_guards, reset_guards
from multiarm.dynamics.held_control import Sampling, with_held_control
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.references import Reference
from multiarm.dynamics.solver.node import NodeWork, make_work
from multiarm.dynamics.solver.singular import CoupledWork, make_coupled
from multiarm.dynamics.state import State, require_same_joints
from multiarm.dynamics.status import CALLBACK_FAILED
from multiarm.dynamics.variables import (
    ALWAYS,
    HELD,
    ONCE,
    Functions,
    Sizes,
    Status,
    Variables,
    make_rows,
    make_variables,
)
from multiarm.geometry.records import Contact, SmoothShape
from multiarm.jit.kernels import Kernel
from multiarm.jit.lazy import LazyFunction
from multiarm.jit.pointers import GuardedCall, PythonCallback, address_of
from multiarm.jit.rows import fields_of
from multiarm.jit.structs import struct_of
from multiarm.public import public_names
from multiarm.scene import ResolvedArm
from multiarm.scene.values import SURROUNDINGS


@dataclass(frozen=True)
class ControlSpan:
    """Times at which a control is defined, that of a table."""

    what: str  # the table, for messages
    begin: float  # [s]
    end: float  # [s]
    outside: str  # what happens at other times; "error": a run must not come there


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """Constants of a compiled scene."""

    arms: dict[str, Arm]
    robots: dict[str, ResolvedArm]  # each arm of the scene with its robot
    joints: dict[str, Joint]
    backends: ArmBackends  # they compute the terms of the arms; every Data takes a copy
    layout: Layout
    contacts: dict[str, list[Contact]]  # of each arm; the arm's geometry in the tip frame
    # all rows of W, the arms' geometry in the frame of the link that carries the tip
    records: tuple[Contact | JointRow, ...]
    surfaces: tuple[SmoothShape, ...]  # user-defined surfaces; every Data takes copies
    frames: dict[str, JointFrame]  # each joint's frame on both bodies, and its free motions
    constants: Constants  # for kernels
    effects: EffectProgram
    links: tuple[tuple[int, int], ...]  # arm and joint of every link that an effect acts on
    levers: tuple[np.ndarray, ...]  # ``NodeWork.levers`` of each arm
    # the compiled functions in ``Functions``; the lazy ones are compiled at their first call
    functions: Mapping[str, Kernel]
    lazy_functions: Mapping[str, Kernel]
    # times at which control or effects are not smooth, so that steps end there [s]
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    # ``StepEnd.points`` at the start, (S, 3)
    pair_places: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    laws: tuple[ControlLaw, ...] = ()  # of a compiled control
    python_control: PythonControl | None = None  # None: control is compiled
    sampling: Sampling | None = None  # None: control is evaluated all the time
    control_span: ControlSpan | None = None  # None: control is defined at all times
    # Which rows can open, slide and stick.  Such a model has all rows that can ever be closed; only
    # models with selected rows are solved.
    unilateral: UnilateralConstraints | None = None
    # those that only report: limits, patches, drives; in a run that opens contacts its modes have
    # further ones
    guards: tuple[Guard, ...] = ()

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Model({self.layout})"

    def data(self) -> Data:
        """Variables of evaluations; each thread needs its own."""
        return Data(self)

    # --- names ----------------------------------------------------------------------------------

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the arms in the order of the stacked vectors."""
        return self.layout.names

    @cached_property
    def bases(self) -> np.ndarray:
        """Where the arms stand, world axes, shape (n, 3) [m]."""
        return np.array([arm.files.base[:3, 3] for arm in self.arms.values()])

    @property
    def calls_user(self) -> bool:
        """Whether evaluations call user functions ``f(t, state)``: a controller, effects."""
        controller = self.python_control is not None and self.sampling is None
        return controller or self.effects.calls_user

    @property
    def calls_python(self) -> bool:
        """Whether evaluations or samples call Python, which runs one thread at a time."""
        pinocchio = any(backend == "pinocchio" for backend in self.backends.by_arm.values())
        user = self.calls_user or self.python_control is not None
        return bool(user or self.surfaces or self.constants.dense or pinocchio)

    @property
    def contacts_with_states(self) -> dict[str, tuple[str, ...]] | None:
        """Names of the unilateral contacts by their owners; None where there is none."""
        if self.unilateral is None:
            return None
        return {owner: self.unilateral.contacts_of(owner) for owner in self.owners}

    @property
    def owners(self) -> list[str]:
        """Who has rows of W: the arms, and the surroundings where they have any."""
        return [*self.arm_names, SURROUNDINGS][: self.layout.owner_count]

    def owner(self, row: int) -> tuple[str, Contact | JointRow]:
        """Arm (or surroundings) and record of a row of W."""
        return self.owners[self.layout.owner_of_contact(row)], self.records[row]

    def joint_name(self, joint: int) -> str:
        """Name of a joint, given by its index in the stacked vectors."""
        i = self.layout.arm_of_joint(joint)
        return self.arms[self.arm_names[i]].joint_names[joint - self.layout.first_joint[i]]

    @property
    def joint_names(self) -> list[str]:
        """All joints as ``arm/joint``, in the order of the stacked vectors."""
        return [f"{name}/{joint}" for name, arm in self.arms.items() for joint in arm.joint_names]

    @property
    def joint_units(self) -> list[str]:
        """Unit of every joint's coordinate, ``"rad"`` or ``"m"``."""
        return [unit for arm in self.arms.values() for unit in arm.joint_units.values()]

    @property
    def controlled(self) -> bool:
        """Whether there is a control, or torques that a caller holds."""
        return len(self.constants.control) > 0

    @property
    def coordinate_units(self) -> list[str]:
        """Units of a displacement: of shift and turn of each frame, and of every joint."""
        return (["m"] * 3 + ["rad"] * 3) * self.layout.frames + self.joint_units

    # --- models of the same bodies --------------------------------------------------------------

    def with_python_control(self, control: PythonControl, sampling: Sampling | None) -> Model:
        """The same model driven by a controller in Python."""
        model = replace(
            self,
            laws=(),
            python_control=control,
            sampling=sampling,
            control_span=None,
            breakpoints=self.effects.breakpoints,
        )
        user = model.calls_user or bool(self.surfaces)
        constants = self.constants._replace(calls_user=user, control_reach=COUPLED)
        if sampling is None:
            constants = constants._replace(control=control.laws, sampled=NO_CONTROL)
        else:
            constants = with_held_control(constants, control.laws, False, sampling.delay)
        return replace(model, constants=constants)

    def with_held_control(self) -> Model:
        """The same model with control that can be held, see :meth:`Data.hold`."""
        if self.sampling is not None:
            return self
        differentiable = self.python_control is None and are_differentiable(self.laws)
        constants = with_held_control(self.constants, self.constants.control, differentiable)
        return replace(self, constants=constants)

    def with_constants(self, **changes: Any) -> Model:
        """The same model with other constants for kernels."""
        return replace(self, constants=self.constants._replace(**changes))

    def with_contacts_closed(self) -> Model:
        """The same model with all contacts of its joints closed, as bilateral constraints.

        It is without friction, compliance, joint stops and surroundings; joints with dry friction
        move freely.  Without unilateral contacts it is the model itself.
        """
        if self.unilateral is None:
            return self
        effects = self.effects.with_contacts_closed()
        model = replace(self.select(self.unilateral.model), effects=effects, unilateral=None)
        return model.with_constants(**effect_constants(effects))

    def select(self, rows: Sequence[int] | np.ndarray) -> Model:
        """The same bodies and effects with some of the rows, given in increasing order."""
        chosen, before = np.array(rows, dtype=np.int64), self.layout.first_contact
        bounds = tuple(np.searchsorted(chosen, before).tolist())
        layout = replace(self.layout, first_contact=bounds)
        numbers = chosen.tolist()
        contacts = {
            name: [self.contacts[name][row - before[i]] for row in numbers[first:last]]
            for i, (name, first, last) in enumerate(
                zip(layout.names, bounds[:-1], bounds[1:], strict=False)
            )
        }
        table = self.constants.contacts
        parts = count_parts(table.codes, self.layout.contacts)
        selected = empty_table(len(chosen) + parts, table.shapes)
        size = len(chosen) + select_rows(table, chosen, selected)
        codes, geometry = selected.codes[:size].copy(), selected.geometry[:size].copy()
        table = ContactTable(codes, geometry, table.shapes)
        return replace(
            self,
            layout=layout,
            contacts=contacts,
            records=tuple(self.records[row] for row in chosen),
            constants=self.constants._replace(**row_constants(table, layout)),
        )


def row_constants(table: ContactTable, layout: Layout) -> dict[str, Any]:
    """Constants of the rows of a contact table."""
    of_joints = fields_of(Code, table.codes[: layout.contacts]).kind == JOINT
    joint_rows = make_joint_rows(int(np.count_nonzero(of_joints)))
    first_contact, first_joint = np.array(layout.first_contact), np.array(layout.first_joint)
    select_joint_rows(table.codes, first_contact, first_joint, joint_rows)
    return {"contacts": table, "joint_rows": joint_rows}


def effect_constants(effects: EffectProgram) -> dict[str, Any]:
    """Constants of the kernels of effects."""
    kernels, (passive, actuator, applied) = effects.program()
    return {
        "effects": kernels,
        "passive_end": passive,
        "actuator_end": actuator,
        "applied_end": applied,
        "local_effects": effects.local,
        "state_joints": effects.state_joints,
    }


class Evaluated(Protocol):
    """Results of an evaluation: a Data, or copies of some of its arrays.

    ``arrays`` has these of the ``Variables``, ``work`` of the ``NodeWork``.
    """

    model: Model
    arrays: Any
    work: Any


class Data:
    """Variables of the evaluations of a model, for one thread.

    Attributes
    ----------
    model : Model
    arrays : Variables
    work, coupled : NodeWork, CoupledWork
        Workspace of the node algorithm, and of its coupled system.
    guards : Guards
        The table of those of the model, which only report.
    effects : list of EffectData
        What every effect kernel reads and writes.
    law_works : list of tuple
        What every control law writes; empty for one without work.
    callbacks : dict of str to GuardedCall
        Python functions that compiled code calls.
    surfaces : list of SmoothShape
        User-defined surfaces.
    cache : dict
        Objects of other packages that live as long as these arrays.
    """

    model: Model
    arrays: Variables
    work: NodeWork
    coupled: CoupledWork

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Data({self.model.layout})"

    def __init__(self, model: Model) -> None:
        self.model, self._backends = model, model.backends.copy()
        self._base: Data | None = None
        self._of_laws: Data | None = None
        self.effects = model.effects.make_data()
        self.surfaces = [copy(surface) for surface in model.surfaces]
        self._ground = Ground(model.constants.gravity)
        self.guards = make_guards(model.guards, range(model.layout.contacts))
        constants = model.constants
        sizes = Sizes(
            layout=model.layout,
            parts=len(constants.contacts.codes) - model.layout.contacts,
            pairs=len(constants.contacts.shapes),
            tips=len(constants.tip_frames),
            pinocchio_configuration=self._backends.configuration,
            works=len(model.effects.works),
            states=model.effects.states,
            passive=constants.passive_end > 0,
            contact_states=[
                len((model.contacts_with_states or {}).get(owner, ())) for owner in model.owners
            ],
        )
        link_poses = [self._backends.pose_address(*link) for link in model.links]
        self.arrays = b = make_variables(sizes, self._pointers(), link_poses)
        arms = self._backends.connect(
            b.state.joint_positions,
            b.state.joint_rates,
            b.bodies.pinocchio_configuration,
            b.bodies.links,
            b.status,
        )
        self.callbacks: dict[str, GuardedCall] = {**arms.callbacks}
        self.cache: dict[object, Any] = {}
        self._set_addresses(arms.addresses)
        self._set_addresses({name: address_of(f) for name, f in model.functions.items()})
        for name, function in model.lazy_functions.items():
            place, flag = (FUNCTIONS, Functions.place(name)), (STATUS, Status.place("failed"))
            self.add_callback(name, LazyFunction(function, place, flag, CALLBACK_FAILED))
        if self.surfaces:
            answer = user_surface_callback(self.surfaces, b.search.query)
            self.callbacks["surface"] = surface = PythonCallback(answer, b.status)
            b.search.user.callback = surface.address
        self._connect_rows()
        self._connect_control()
        for kernel, effect in zip(model.effects.kernels, self.effects, strict=True):
            if kernel.connect is not None:
                self.callbacks.update(kernel.connect(self, effect.arrays))
        self.hold(None)

    @property
    def contact_rows(self) -> ContactRow:
        """Kinematics of all rows: views, an entry of each field for every row."""
        return fields_of(ContactRow, self.arrays.rows.kinematics)

    def view(self, model: Model) -> Data:
        """Data of a model with the same bodies and effects, which shares state and bodies' motion.

        Where the model has other rows, it has its own arrays with an entry for every row.  Contacts
        of two surfaces are found from the same places.
        """
        view = copy(self)
        view._share(self, model)
        return view

    def _share(self, base: Data, model: Model) -> None:
        """Become the view of a model on ``base``, of which this is a copy."""
        self._of_laws = None
        self._base = base  # keeps alive the arrays whose addresses are in the struct
        self.model, self.cache, self.callbacks = model, {}, dict(base.callbacks)
        arrays = base.arrays._replace(functions=base.arrays.functions.copy())
        if model.constants.contacts is base.model.constants.contacts:
            self.arrays = arrays
            if model.laws is not base.model.laws:
                self._connect_laws()
            self._struct = self._make_struct()
        else:
            count = model.layout.contacts
            rows = make_rows(count, len(model.constants.contacts.codes) - count)
            sample = arrays.sample._replace(forces=rows.force)
            self.arrays = arrays._replace(rows=rows, sample=sample)
            self._connect_rows()
        if model.python_control is not base.model.python_control:
            self._connect_control()
        if model.sampling != base.model.sampling:
            self.hold(None)

    def with_contacts_closed(self) -> Data:
        """Data of :meth:`Model.with_contacts_closed`."""
        if self.model.unilateral is None:
            return self
        if "closed" not in self.cache:
            self.cache["closed"] = self.view(self.model.with_contacts_closed())
        return self.cache["closed"]

    @property
    def of_laws(self) -> Data:
        """The data in which control laws are evaluated: these, unless others have been set."""
        return self if self._of_laws is None else self._of_laws

    @of_laws.setter
    def of_laws(self, closed: Data) -> None:
        self._of_laws = closed

    def _connect_rows(self) -> None:
        """Make workspace and dense solver for the rows of the model, and the work of the laws."""
        model, b = self.model, self.arrays
        sizes = model.layout.joint_counts, model.layout.contact_counts
        self.work, self.coupled = make_work(*sizes, model.levers), make_coupled(*sizes)
        self.add_callback("dense", PythonCallback(DenseSolver(self), b.status))
        self._connect_laws()
        self._struct = self._make_struct()

    def _connect_laws(self) -> None:
        """Make the work of the control laws."""
        laws = self.model.laws
        self.law_works = [() if law.work is None else law.work.of(self) for law in laws]

    def _pointers(self) -> np.ndarray:
        """``Variables.bodies.pointers``; the surroundings are an arm without joints."""
        pointers = self._backends.pointers
        if self.model.layout.owner_count == len(pointers):
            return pointers
        return np.vstack([pointers, self._ground.pointers])

    def _make_struct(self, constants: Constants | None = None) -> np.ndarray:
        further = [effect.struct for effect in self.effects]
        for law, work in zip(self.model.laws, self.law_works, strict=True):
            further += [law.struct, struct_of(work)] if work else [law.struct]
        constants = self.model.constants if constants is None else constants
        return system_struct(constants, self.arrays, self.work, self.coupled, self.guards, further)

    def _connect_control(self) -> None:
        if self.model.python_control is not None:
            control = self.model.python_control.connect(self.model.layout, self.arrays)
            self.add_callback("control", control)

    def add_callback(self, name: str, callback: GuardedCall) -> None:
        """Let compiled code call a function, by its address among the ``Functions``."""
        self.callbacks[name] = callback
        self._set_addresses({name: callback.address})

    def _set_addresses(self, addresses: dict[str, int]) -> None:
        for name, address in addresses.items():
            setattr(self.arrays.functions, name, address)

    def replace_arrays(
        self, constants: Constants | None = None, work: NodeWork | None = None, **changes: Any
    ) -> None:
        """Replace some of the arrays, for compiled code those of the model too."""
        self.arrays = self.arrays._replace(**changes)
        self.work = self.work if work is None else work
        self._struct = self._make_struct(constants)

    @property
    def struct(self) -> np.ndarray:
        """Struct for compiled code; valid while this lives."""
        return self._struct

    @property
    def reference(self) -> Reference:
        """The struct for numbers of other kernels, which keep it and this alive."""
        return Reference(self.struct, self)

    def effect(self, name: str) -> Any:
        """Numbers and arrays of an effect's first kernel."""
        kernels = zip(self.model.effects.kernels, self.effects, strict=True)
        return next(effect.arrays for kernel, effect in kernels if kernel.name == name)

    @property
    def user_callbacks(self) -> list[UserCallback]:
        """The user functions ``f(t, state)``: a controller, effects."""
        return [call for call in self.callbacks.values() if isinstance(call, UserCallback)]

    # --- state ----------------------------------------------------------------------------------

    def set_state(self, t: float, state: State) -> None:
        """Start at a state; all memory of other states is deleted.

        Raises
        ------
        ModelError
            For a state of a system with other arms.
        """
        require_same_joints(state, self.model.layout)
        b = self.arrays
        b.time.now = t
        self.move_to(state)
        b.control.torque[:] = b.control.object_wrench[:] = 0.0  # those of another control
        b.rows.static_force[:] = 0.0
        b.control.sampling.due, b.control.sampling.samples = b.control.sampling.mode, 0
        b.effects.states[:] = b.effects.state_rates[:] = 0.0
        b.last_step.points[:] = self.model.pair_places
        b.last_step.coordinates[:] = np.nan
        b.sample.tips[:] = 0.0
        reset_guards(self.guards)
        b.solution.forget()
        b.last_step.solution.known = False
        b.status.kernel = b.status.answer = 0
        b.status.position_change = b.status.velocity_change = 0.0
        b.last_step.lost_directions[:] = 0
        b.last_step.determinant_signs[:] = 0.0
        for surface in self.surfaces:
            surface.reset()

    def move_to(self, state: State) -> None:
        """Write positions and velocities; memory of the previous state is kept."""
        b = self.arrays
        b.state.configuration[:], b.state.velocity[:] = state.position, state.velocity

    def hold(self, torques: np.ndarray | None) -> None:
        """Hold torques (n,) from now on, in a model whose control can be held.

        None: its laws compute them, from the next sample or start on.
        """
        sampling = self.arrays.control.sampling
        if torques is not None:
            sampling.mode = sampling.due = HELD
            self.arrays.control.held_torques[:] = torques
        else:
            sampling.mode = ALWAYS if self.model.sampling is None else ONCE
            sampling.samples = 0

    def get_state(self) -> State:
        """A copy of the state."""
        b = self.arrays
        return State(b.state.configuration.copy(), b.state.velocity.copy(), self.model.layout)

    def effect_states(self) -> np.ndarray:
        """States of the effects at the start of a run, which has just been evaluated."""
        parts = [np.zeros(0)]
        for kernel, effect in zip(self.model.effects.kernels, self.effects, strict=True):
            if kernel.start is not None:
                parts.append(kernel.start(effect.arrays))
            else:
                parts.append(np.zeros(kernel.states))
        return np.concatenate(parts)

    # --- Coriolis -------------------------------------------------------------------------------

    def coriolis(self) -> Coriolis:
        """The arms' Coriolis matrices, and the functions that update them."""
        coriolis, callback = self._backends.coriolis(self.arrays.status)
        if callback is not None:
            self.callbacks["coriolis"] = callback
        return coriolis

    # --- exceptions in callbacks ----------------------------------------------------------------

    def reraise(self) -> None:
        """Raise the exception of a callback, and clear the flag."""
        self.arrays.status.failed = False
        for call in self.callbacks.values():
            call.reraise()
        if self._base is not None:  # whose rows the time loop evaluates, too
            self._base.reraise()

    def forgive(self) -> None:
        """Ignore the exception of a callback, and clear the flag."""
        self.arrays.status.failed = False
        for call in self.callbacks.values():
            call.error = None
        if self._base is not None:
            self._base.forgive()
