"""Model and Data: what is constant of a compiled scene, and what its evaluations read and write.

A :class:`Model` is never written after it has been built, so that any number of threads share it.
The rows of a model may be selected: a scene with unilateral contacts has all rows that can ever be
closed, and is simulated with those that are (:meth:`Model.select`).

One :class:`Data` serves one thread; :meth:`Model.data` makes one.  Compiled code sees it as a
struct (:mod:`multiarm.dynamics.arrays`) together with the constants of its model.  What the code
calls in Python (Pinocchio, user functions, the dense solver) are callbacks of the Data.
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
from multiarm.contacts.kernel import RELATIVE_WIDTH
from multiarm.contacts.records import (
    COUNT,
    JOINT,
    KIND,
    LINK,
    PAIR,
    TANGENT,
    Contact,
    ContactTable,
    JointRow,
    SmoothShape,
    pack,
)
from multiarm.contacts.surfaces import user_surface_callback
from multiarm.contacts.unilateral import SURROUNDINGS, UnilateralConstraints
from multiarm.dynamics.arrays import (
    CALLBACK_FAILED,
    FUNCTIONS,
    STATUS,
    Constants,
    Functions,
    Status,
    Variables,
    make_variables,
    row_variables,
    system_struct,
)
from multiarm.dynamics.dense_callback import dense_call
from multiarm.dynamics.effect_kernels import EffectProgram
from multiarm.dynamics.solver.singular import CoupledWork, make_coupled
from multiarm.dynamics.solver.work import NodeWork, make_work
from multiarm.dynamics.state import Layout, State
from multiarm.dynamics.user_callback import PythonControl, UserCallback
from multiarm.errors import ModelError
from multiarm.jit.kernels import Kernel
from multiarm.jit.lazy import LazyFunction
from multiarm.jit.pointers import GuardedCall, PythonCallback, address_of
from multiarm.scene import ResolvedArm


@dataclass(frozen=True, eq=False)
class Model:
    """Constants of a compiled scene.

    Attributes
    ----------
    arms : dict of str to Arm
    robots : dict of str to ResolvedArm
        What the scene says of each arm, once its robot has been looked up.
    joints : dict of str to Joint
        The joints as the scene has them.
    backends : ArmBackends
        Who computes the terms of each arm; every Data takes a copy.
    layout : Layout
        Where each arm's joints and rows are in stacked vectors.
    contacts : dict of str to list of Contact
        Records of each arm's rows; the arm's geometry in the tip frame.
    records : tuple of Contact or JointRow
        All rows of W, the arms' geometry in the frame of the link that carries the tip.
    surfaces : tuple of SmoothShape
        User-defined surfaces; every Data takes copies.
    frames : dict of str to JointFrame
        Each joint's frame on both bodies, and the motions that it leaves free.
    constants : Constants
        What kernels read.
    effects : EffectProgram
        What the scene's effects add to an evaluation.
    links : tuple of (int, int)
        Arm and joint of every link that an effect acts on.
    levers : tuple of ndarray
        See :func:`multiarm.dynamics.solver.work.make_work`.
    functions, lazy_functions : mapping of str to Kernel
        The compiled functions in :class:`multiarm.dynamics.arrays.Functions`; the lazy ones are
        compiled when they are first called.
    breakpoints : ndarray
        Times at which control or effects are not smooth; steps end there [s].
    pair_places : ndarray, shape (S, 3)
        Where the contacts of two surfaces are at the start, see ``Variables.places``.
    python_control : PythonControl or None
        A controller in Python, which has taken the place of the scene's control.
    unilateral : UnilateralConstraints or None
        Which rows can open, slide and stick.  Such a model has all rows that can ever be closed,
        and is never solved as it is.
    """

    arms: dict[str, Arm]
    robots: dict[str, ResolvedArm]
    joints: dict[str, Joint]
    backends: ArmBackends
    layout: Layout
    contacts: dict[str, list[Contact]]
    records: tuple[Contact | JointRow, ...]
    surfaces: tuple[SmoothShape, ...]
    frames: dict[str, JointFrame]
    constants: Constants
    effects: EffectProgram
    links: tuple[tuple[int, int], ...]
    levers: tuple[np.ndarray, ...]
    functions: Mapping[str, Kernel]
    lazy_functions: Mapping[str, Kernel]
    breakpoints: np.ndarray = field(default_factory=lambda: np.zeros(0))
    pair_places: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    python_control: PythonControl | None = None
    unilateral: UnilateralConstraints | None = None

    def data(self) -> Data:
        """What evaluations of this model read and write; one for every thread."""
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
        return self.python_control is not None or self.effects.calls_user

    @property
    def calls_python(self) -> bool:
        """Whether every evaluation enters Python, where one thread works at a time."""
        pinocchio = any(backend == "pinocchio" for backend in self.backends.by_arm.values())
        return bool(self.calls_user or self.surfaces or self.constants.dense or pinocchio)

    @property
    def contacts_with_states(self) -> dict[str, tuple[str, ...]] | None:
        """Names of the unilateral contacts by their owners; None where there is none."""
        if self.unilateral is None:
            return None
        owners = [*self.arm_names, SURROUNDINGS]
        return {owner: self.unilateral.contacts_of(owner) for owner in owners}

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

    @property
    def joint_units(self) -> list[str]:
        """Unit of every joint's coordinate, ``"rad"`` or ``"m"``."""
        return [unit for arm in self.arms.values() for unit in arm.joint_units.values()]

    # --- models of the same bodies --------------------------------------------------------------

    def with_constants(self, **changes: Any) -> Model:
        """The same model with other constants that kernels read."""
        return replace(self, constants=self.constants._replace(**changes))

    def with_solver(self, solver: str) -> Model:
        """The same model solved by ``"node"`` or by the dense reference ``"dense"``."""
        return self.with_constants(dense=solver == "dense")

    def with_contacts_closed(self) -> Model:
        """The same model with all contacts of its joints closed, as if they could not open.

        Friction, compliance, joint stops and the surroundings are not in it; joints with dry
        friction move freely.  Without unilateral contacts it is the model itself.
        """
        if self.unilateral is None:
            return self
        effects = self.effects.with_contacts_closed()
        model = replace(self.select(self.unilateral.model), effects=effects, unilateral=None)
        return replace(model, constants=with_effects(model.constants, effects))

    def select(self, rows: Sequence[int] | np.ndarray) -> Model:
        """The same bodies and effects with some of the rows, given in increasing order."""
        chosen = np.array(rows, dtype=np.int64)
        bounds = tuple(int(np.searchsorted(chosen, bound)) for bound in self.layout.rows)
        layout = replace(self.layout, rows=bounds)
        contacts = {
            name: [self.contacts[name][row - first] for row in chosen if first <= row < last]
            for name, first, last in zip(
                self.layout.names, self.layout.rows[:-1], self.layout.rows[1:], strict=False
            )
        }
        records = [self.records[row] for row in chosen]
        table = pack(records)
        constants = with_rows(self.constants, table, layout)
        user = self.calls_user or bool(table.functions)
        constants = constants._replace(calls_user=user)
        places = np.zeros((len(table.shapes), 3))
        for own, source in self.pairs(chosen, constants):
            places[own] = self.pair_places[source]
        return replace(
            self,
            layout=layout,
            contacts=contacts,
            records=tuple(records),
            surfaces=tuple(table.functions),
            constants=constants,
            pair_places=places,
        )

    def pairs(self, rows: np.ndarray, constants: Constants) -> list[tuple[int, int]]:
        """Contacts of two surfaces among selected rows: their places there, and here."""
        found = []
        for own, row in enumerate(rows):
            code = constants.codes[own]
            if code[KIND] == TANGENT and code[COUNT] > 0:
                normal, source = (
                    constants.codes[code[COUNT]],
                    self.constants.codes[row - code[LINK]],
                )
            else:
                normal, source = code, self.constants.codes[row]
            if normal[KIND] == PAIR:
                found.append((int(normal[LINK]), int(source[LINK])))
        return found


def with_rows(constants: Constants, table: ContactTable, layout: Layout) -> Constants:
    """Constants with another contact table."""
    joint_rows = []
    for row in np.flatnonzero(table.codes[: layout.contacts, KIND] == JOINT):
        arm = int(np.searchsorted(layout.rows, row, side="right")) - 1
        joint_rows.append([arm, row, layout.dofs[arm] + table.codes[row, LINK]])
    return constants._replace(
        codes=table.codes,
        geometry=table.geometry,
        shapes=table.shapes,
        joint_rows=np.array(joint_rows, dtype=np.int64).reshape(-1, 3),
    )


def with_effects(constants: Constants, effects: EffectProgram) -> Constants:
    """Constants with the kernels of other effects."""
    kernels, (passive, actuator, applied) = effects.program()
    return constants._replace(
        effects=kernels, passive_end=passive, actuator_end=actuator, applied_end=applied
    )


class Evaluated(Protocol):
    """What results of an evaluation are read from: a Data, or copies of its arrays."""

    model: Model
    arrays: Variables
    work: NodeWork
    coupled: CoupledWork


class Data:
    """What the evaluations of a model read and write.

    Attributes
    ----------
    model : Model
    arrays : Variables
    work, coupled : NodeWork, CoupledWork
        Workspace of the node algorithm, and of its system with deficient arms.
    effects : list of tuple of ndarray
        Arrays of every effect kernel, the slots first.
    callbacks : dict of str to GuardedCall
        What compiled code calls in Python.
    surfaces : list of SmoothShape
        User-defined surfaces.
    cache : dict
        What others keep together with these arrays.
    """

    model: Model
    arrays: Variables
    work: NodeWork
    coupled: CoupledWork

    def __init__(self, model: Model) -> None:
        self.model, self._backends = model, model.backends.copy()
        self._base: Data | None = None
        self.effects = model.effects.make_arrays()
        self._surfaces = {id(surface): copy(surface) for surface in model.surfaces}
        self._ground = Ground(model.constants.gravity)
        arrays = make_variables(
            model.constants,
            self._pointers(),
            rows=model.layout.contacts,
            configuration=self._backends.configuration,
            works=len(model.effects.works),
            states=model.effects.states,
        )
        poses = [self._backends.pose_address(*link) for link in model.links]
        shown = arrays.shown
        if model.unilateral is not None:
            shown = np.zeros(model.layout.contacts + len(model.unilateral.contacts))
        self.arrays = arrays._replace(link_poses=np.array(poses, dtype=np.int64), shown=shown)
        b = self.arrays
        arms = self._backends.connect(b.angles, b.v, b.q, b.arms, b.status)
        self.callbacks: dict[str, GuardedCall] = {**arms.callbacks}
        self.cache: dict[object, Any] = {}
        self._set_addresses(arms.addresses)
        self._set_addresses({name: address_of(f) for name, f in model.functions.items()})
        for name, function in model.lazy_functions.items():
            place, flag = (FUNCTIONS, Functions.place(name)), (STATUS, Status.place("failed"))
            self._add_callback(name, LazyFunction(function, place, flag, CALLBACK_FAILED))
        self._connect_rows()
        self._connect_user_functions()

    def view(self, model: Model) -> Data:
        """Data of a model with the same bodies and effects, which shares state and bodies' motion.

        What has an entry for every row is its own where the model has other rows.
        """
        other = copy(self)
        other._base = self  # kernels reach its arrays by their addresses
        other.model, other.cache, other.callbacks = model, {}, dict(self.callbacks)
        arrays = self.arrays._replace(functions=self.arrays.functions.copy())
        same_rows = model.constants.codes is self.model.constants.codes
        if same_rows:
            other.arrays = arrays
            other._struct = other._make_struct()
        else:
            rows: dict[str, Any] = row_variables(model.constants, model.layout.contacts)
            other.arrays = arrays._replace(**rows)
            other._connect_rows()
        if model.python_control is not self.model.python_control:
            other._connect_user_functions()
        return other

    def with_contacts_closed(self) -> Data:
        """Data of :meth:`Model.with_contacts_closed`."""
        if self.model.unilateral is None:
            return self
        if "closed" not in self.cache:
            self.cache["closed"] = self.view(self.model.with_contacts_closed())
        return self.cache["closed"]

    def _connect_rows(self) -> None:
        """Workspace, surfaces and dense solver for the rows of the model."""
        model, b = self.model, self.arrays
        sizes = np.diff(model.layout.dofs).tolist(), np.diff(model.layout.rows).tolist()
        self.work, self.coupled = make_work(*sizes, model.levers), make_coupled(*sizes)
        dense = dense_call(b, self.work)
        self._add_callback("dense", PythonCallback(dense, b.status))
        self.surfaces = [self._surfaces[id(surface)] for surface in model.surfaces]
        if self.surfaces:
            answer = user_surface_callback(self.surfaces, b.query[RELATIVE_WIDTH:])
            self._add_callback("surface", PythonCallback(answer, b.status))
        self._struct = self._make_struct()

    def _pointers(self) -> np.ndarray:
        """``Variables.pointers``; the surroundings are an arm without joints."""
        owners, pointers = len(self.model.layout.dofs) - 1, self._backends.pointers
        if owners == len(pointers):
            return pointers
        return np.vstack([pointers, self._ground.pointers])

    def _make_struct(self) -> np.ndarray:
        own = [array for arrays in self.effects for array in arrays]
        return system_struct(self.model.constants, self.arrays, self.work, self.coupled, own)

    def _connect_user_functions(self) -> None:
        if self.model.python_control is not None:
            control = self.model.python_control.connect(self.model.layout, self.arrays)
            self._add_callback("control", control)
        for kernel, (_, *arrays) in zip(self.model.effects.kernels, self.effects, strict=True):
            if kernel.connect is not None:
                self.callbacks.update(kernel.connect(self, arrays))

    def _add_callback(self, name: str, callback: GuardedCall) -> None:
        self.callbacks[name] = callback
        self._set_addresses({name: callback.address})

    def _set_addresses(self, addresses: dict[str, int]) -> None:
        for name, address in addresses.items():
            setattr(self.arrays.functions, name, address)

    def replace_arrays(self, **changes: Any) -> None:
        """Use other arrays in place of some of its own."""
        self.arrays = self.arrays._replace(**changes)
        self._struct = self._make_struct()

    def replace_dense_solver(self, reactions: tuple[np.ndarray, np.ndarray]) -> None:
        """Let the dense solver have forces act along other rows, see :func:`dense_call`."""
        dense = dense_call(self.arrays, self.work, reactions)
        self._add_callback("dense", PythonCallback(dense, self.arrays.status))

    @property
    def struct(self) -> np.ndarray:
        """Struct for compiled code; valid while this lives."""
        return self._struct

    def effect(self, name: str) -> tuple[np.ndarray, ...]:
        """Arrays of an effect's kernel, without the slots; of several of one name, of the first."""
        kernels = zip(self.model.effects.kernels, self.effects, strict=True)
        return next(arrays[1:] for kernel, arrays in kernels if kernel.name == name)

    @property
    def user_callbacks(self) -> list[UserCallback]:
        """The user functions ``f(t, state)``: a controller, effects."""
        return [call for call in self.callbacks.values() if isinstance(call, UserCallback)]

    # --- state ----------------------------------------------------------------------------------

    def set_state(self, t: float, state: State) -> None:
        """Begin at a state: nothing is known of any other one.

        Raises
        ------
        ModelError
            For a state of a system with other arms.
        """
        if not state.layout.same_joints(self.model.layout):
            raise ModelError(
                f"this state belongs to a system with arms {', '.join(state.layout.names)} "
                f"({state.layout.joints} joints), not to this one; make it with `system.state(...)`"
            )
        b = self.arrays
        b.time.now, b.time.latest = t, np.inf
        self.move_to(state)
        b.torque[:] = 0.0  # another control may have left its torques here
        b.inner[:] = b.inner_rate[:] = 0.0
        b.places[:] = self.model.pair_places
        b.coordinates[:] = np.nan
        b.margins[:] = np.nan
        b.event_count[0] = 0
        b.status.rank = b.status.coupled_arms = 0
        b.status.residual = b.status.imbalance = 0.0
        b.status.position_change = b.status.velocity_change = 0.0
        b.lost[:] = 0
        b.signs[:] = 0.0
        for surface in self.surfaces:
            surface.reset()

    def move_to(self, state: State) -> None:
        """Write positions and velocities; what is known of the state before is kept."""
        b = self.arrays
        b.position[:], b.angles[:] = state.position[:7], state.position[7:]
        b.twist[:], b.v[:] = state.velocity[:6], state.velocity[6:]

    def get_state(self) -> State:
        """A copy of the state."""
        b = self.arrays
        return State(
            np.concatenate([b.position, b.angles]),
            np.concatenate([b.twist, b.v]),
            self.model.layout,
        )

    def effect_states(self) -> np.ndarray:
        """The effects' own states at the start of a run, which has just been evaluated."""
        parts = [np.zeros(0)]
        for kernel, (_, *arrays) in zip(self.model.effects.kernels, self.effects, strict=True):
            if kernel.start is not None:
                parts.append(kernel.start(arrays))
            else:
                parts.append(np.zeros(kernel.states))
        return np.concatenate(parts)

    # --- energy, Coriolis -----------------------------------------------------------------------

    def potential_energy(self) -> float:
        """Potential energy of arms and object [J] at the state, zero at the origin."""
        constants = self.model.constants
        height = float(constants.gravity @ self.arrays.position[:3])
        return -constants.object_mass * height + self._backends.potential_energy()

    def coriolis(self) -> Coriolis:
        """What updates the arms' matrices of Coriolis forces, and where they are.

        Valid while this lives; they are made once.
        """
        found, call = self._backends.coriolis(self.arrays.status)
        if call is not None:
            self.callbacks["coriolis"] = call
        return found

    # --- exceptions in callbacks ----------------------------------------------------------------

    def reraise(self) -> None:
        """Raise the exception that a callback ran into, and clear the flag."""
        self.arrays.status.failed = False
        for call in self.callbacks.values():
            call.reraise()

    def forgive(self) -> None:
        """Forget the exception that a callback ran into, and clear the flag."""
        self.arrays.status.failed = False
        for call in self.callbacks.values():
            call.error = None
