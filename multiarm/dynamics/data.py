"""Data: the variables of the evaluations of a model, and what compiled code needs of them.

Each thread needs its own :class:`Data`.  For compiled code, a struct
(:mod:`multiarm.dynamics.arrays`) contains its arrays and the constants of its model.  Python
functions that the code calls (Pinocchio, user functions, the dense solver) are callbacks of the
Data.
"""

from __future__ import annotations

from collections.abc import Collection
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol
from weakref import WeakSet

import numpy as np

from multiarm.contacts.kernel import ContactRow
from multiarm.contacts.surfaces import user_surface_callback
from multiarm.dynamics.arrays import FUNCTIONS, STATUS, Constants, system_struct
from multiarm.dynamics.callbacks import DenseSolver, UserCallback
from multiarm.dynamics.effect_kernels import EffectData
from multiarm.dynamics.guards import Guards, make_guards, reset_guards
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import Model
from multiarm.dynamics.references import Reference
from multiarm.dynamics.solver.node import NodeWork, make_work
from multiarm.dynamics.solver.singular import CoupledWork, make_coupled
from multiarm.dynamics.solver.tree_tables import use_factors
from multiarm.dynamics.state import State, require_same_joints
from multiarm.dynamics.status import CALLBACK_FAILED
from multiarm.dynamics.variables import (
    ALWAYS,
    HELD,
    ONCE,
    Functions,
    Pointers,
    SamplingStatus,
    Sizes,
    Status,
    Variables,
    make_rows,
    make_variables,
)
from multiarm.geometry.records import SmoothShape
from multiarm.jit.lazy import LazyFunction
from multiarm.jit.pointers import GuardedCall, PythonCallback, address_of
from multiarm.jit.rows import fields_of
from multiarm.jit.structs import struct_of
from multiarm.public import public_names
from multiarm.robots.backends import Ground
from multiarm.robots.joined import JoinedMatrix, JoinedTerms, MatrixCopy, table_of_copies
from multiarm.robots.terms import Coriolis, MatrixAddress, TermAddresses


class Evaluated(Protocol):
    """Results of an evaluation: a Data, or copies of some of its arrays.

    ``arrays`` has these of the ``Variables``, ``work`` of the ``NodeWork``.
    """

    @property
    def model(self) -> Model:
        """Of these results."""

    @property
    def arrays(self) -> Any:
        """Its variables."""

    @property
    def work(self) -> Any:
        """The workspace of its solver."""


class SharedData:
    """What a Data has in common with its views: the state, motion of the bodies, effects, forces.

    Attributes
    ----------
    arrays : Variables
        Those of the first Data; views replace rows and functions.
    effects : list of EffectData
        What every effect kernel reads and writes.
    surfaces : list of SmoothShape
        User-defined surfaces.
    guards : Guards
        The table of those that only report.
    callbacks : dict of str to GuardedCall
        Those of Pinocchio and of surfaces, and functions that are compiled when first called.
    calls : set of GuardedCall
        All callbacks of all views, as long as a view has them.
    """

    def __init__(self, model: Model) -> None:
        constants, layout = model.constants, model.layout
        self._backends, self._ground = model.backends.copy(), Ground()
        self._joined: list[JoinedTerms | JoinedMatrix] = []  # of blocks of several robots
        self.effects = model.effects.make_data()
        self.surfaces = [copy(surface) for surface in model.surfaces]
        self.guards = make_guards(model.guards, range(layout.contacts))
        states = model.contacts_with_states or {}
        sizes = Sizes(
            layout=layout,
            parts=len(constants.contacts.codes) - layout.contacts,
            pairs=len(constants.contacts.shapes),
            pinocchio_configuration=self._backends.configuration,
            works=len(model.effects.works),
            states=model.effects.states,
            passive=constants.passive_end > 0,
            contact_states=[len(states.get(owner, ())) for owner in layout.owners],
        )
        terms, copies = self._term_addresses(layout, self._factored_blocks(model))
        pointers = Pointers(
            terms=terms,
            bases=self._backends.pointers[list(layout.floating_robots)],
            copies=copies,
            links=self._backends.link_pointers,
            poses=[self._backends.pose_address(*link) for link in model.effect_links],
        )
        self.arrays = v = make_variables(sizes, pointers)
        v.control.sampling.mode = mode_of_samples(model)
        functions = self._backends.connect(
            v.state.joint_positions,
            v.state.joint_rates,
            v.state.base_poses,
            v.bodies.pinocchio_configuration,
            v.bodies.pinocchio_velocity,
            v.bodies.links,
            v.status,
        )
        self.callbacks: dict[str, GuardedCall] = {**functions.callbacks}
        self.calls: WeakSet[GuardedCall] = WeakSet(self.callbacks.values())
        compiled = {name: address_of(function) for name, function in model.functions.items()}
        for name, address in (functions.addresses | compiled).items():
            setattr(v.functions, name, address)
        for name, function in model.lazy_functions.items():
            place, flag = (FUNCTIONS, Functions.place(name)), (STATUS, Status.place("failed"))
            self._add_callback(name, LazyFunction(function, place, flag, CALLBACK_FAILED))
        if self.surfaces:
            answer = user_surface_callback(self.surfaces, v.search.query)
            self.callbacks["surface"] = surface = PythonCallback(answer, v.status)
            self.calls.add(surface)
            v.search.user.callback = surface.address

    def _factored_blocks(self, model: Model) -> set[int]:
        """The blocks that are eliminated by factors, which are wanted from now on.

        None where every evaluation reads their inertias.
        """
        if model.reads_inertias:
            return set()
        with_factors = fields_of(TermAddresses, self._backends.pointers).factors.tolist()
        blocks = [
            i
            for i, parts in enumerate(model.layout.parts_of_blocks)
            if parts and all(with_factors[part.robot] for part in parts)
        ]
        factored = set(model.trees).intersection(blocks)
        if factored:
            others = set(model.layout.blocks_of_robots) - factored
            parts = [part for i in others for part in model.layout.parts_of_blocks[i]]
            self._backends.want_factors(any(with_factors[part.robot] for part in parts))
        return factored

    def _term_addresses(
        self, layout: Layout, factored: Collection[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """``BodyVariables.pointers``, ``copies``; the surroundings are a robot without joints.

        Blocks that are eliminated by their entries have no addresses of factors.
        """
        copies: list[MatrixCopy] = []
        robots, of_blocks = [TermAddresses(*row) for row in self._backends.pointers.tolist()], []
        for i, parts in enumerate(layout.parts_of_blocks):
            terms = [robots[part.robot].from_joint(part.first) for part in parts]
            if i not in factored:
                terms = [term._replace(factors=0) for term in terms]
            if len(parts) > 1:
                block = JoinedTerms(terms, [part.joints for part in parts])
                self._joined.append(block)
                terms, copies = [block.addresses], copies + block.copies
            of_blocks += terms or [self._ground.addresses]
        return np.array(of_blocks, dtype=np.int64), table_of_copies(copies)

    def _add_callback(self, name: str, callback: GuardedCall) -> None:
        self.callbacks[name] = callback
        self.calls.add(callback)
        setattr(self.arrays.functions, name, callback.address)

    def coriolis(self, layout: Layout) -> tuple[Coriolis, GuardedCall | None]:
        """See :meth:`multiarm.robots.backends.Backends.coriolis`; the matrices are of blocks."""
        coriolis, call = self._backends.coriolis(self.arrays.status)
        robots, of_blocks = [MatrixAddress(*row) for row in coriolis.matrices.tolist()], []
        copies: list[MatrixCopy] = []
        for parts in layout.parts_of_blocks:
            matrices = [robots[part.robot].from_joint(part.first) for part in parts]
            if len(parts) > 1:
                block = JoinedMatrix(matrices, [part.joints for part in parts])
                self._joined.append(block)
                matrices, copies = [block.address], copies + block.copies
            of_blocks += matrices or [MatrixAddress(at=0, stride=0)]
        table = np.array(of_blocks, dtype=np.int64)
        return Coriolis(coriolis.calls, table, table_of_copies(copies)), call


@dataclass(frozen=True, eq=False)
class RowData:
    """What belongs to the rows of a model: the model itself, variables, workspaces.

    Attributes
    ----------
    model : Model
    arrays : Variables
        Rows and functions are those of one Data, all others are shared.
    work, coupled : NodeWork, CoupledWork
        Workspace of the node algorithm, and of its coupled system.
    cache : dict
        Objects of other packages that live as long as these arrays.
    """

    model: Model
    arrays: Variables
    work: NodeWork
    coupled: CoupledWork
    cache: dict[object, Any]

    @cached_property
    def contact_rows(self) -> ContactRow:
        """Views of the kinematics of all rows."""
        return fields_of(ContactRow, self.arrays.rows.kinematics)


class HasRowData(Protocol):
    """A :class:`RowData`, or what makes its parts when they are asked for."""

    @property
    def model(self) -> Model:
        """The model with these rows."""

    @property
    def arrays(self) -> Variables:
        """The variables."""

    @property
    def work(self) -> NodeWork:
        """Workspace of the node algorithm."""

    @property
    def coupled(self) -> CoupledWork:
        """Workspace of the coupled system."""

    @property
    def cache(self) -> dict[object, Any]:
        """Objects of other packages."""

    @property
    def contact_rows(self) -> ContactRow:
        """Views of the kinematics of all rows."""


class Data:
    """Variables of the evaluations of a model, for one thread.

    Parameters
    ----------
    model : Model
    viewed : Data, optional
        Of the same bodies and effects: these data are a view of it, see :meth:`view`.

    Attributes
    ----------
    shared : SharedData
        What views have in common.
    model : Model
    arrays : Variables
    work, coupled : NodeWork, CoupledWork
        Workspace of the node algorithm, and of its coupled system.
    cache : dict
        See :class:`RowData`, which has these five.
    law_works : list of tuple
        What every control law writes; empty for one without work.
    callbacks : dict of str to GuardedCall
        Python functions that compiled code calls.
    """

    __dir__ = public_names

    def __repr__(self) -> str:
        return f"Data({self.model.layout})"

    def __init__(self, model: Model, viewed: Data | None = None) -> None:
        self._of_laws: Data | None = None
        if viewed is None:
            self.shared = SharedData(model)
            self.callbacks = dict(self.shared.callbacks)
            self._rows: HasRowData = with_rows(model, self.shared.arrays)
        else:
            self.shared = viewed.shared
            self.callbacks = dict(viewed.callbacks)
            self._rows = rows_of_view(model, viewed)
        self.add_callback("dense", PythonCallback(DenseSolver(self), self.arrays.status))
        if viewed is None or model.python_control is not viewed.model.python_control:
            self._connect_control()
        self.law_works: list[Any] = [
            () if law.work is None else law.work.of(self) for law in model.laws
        ]
        self._struct = self._make_struct()
        if viewed is None:
            self._connect_effects()

    # --- what belongs to the rows -----------------------------------------------------------------

    @property
    def model(self) -> Model:
        """Its constants."""
        return self._rows.model

    @property
    def arrays(self) -> Variables:
        """The variables."""
        return self._rows.arrays

    @property
    def work(self) -> NodeWork:
        """Workspace of the node algorithm."""
        return self._rows.work

    @property
    def coupled(self) -> CoupledWork:
        """Workspace of the coupled system."""
        return self._rows.coupled

    @property
    def cache(self) -> dict[object, Any]:
        """Objects of other packages that live as long as the arrays."""
        return self._rows.cache

    @property
    def contact_rows(self) -> ContactRow:
        """Kinematics of all rows: views, an entry of each field for every row."""
        return self._rows.contact_rows

    # --- what is shared ---------------------------------------------------------------------------

    @property
    def effects(self) -> list[EffectData]:
        """What every effect kernel reads and writes."""
        return self.shared.effects

    @property
    def surfaces(self) -> list[SmoothShape]:
        """User-defined surfaces."""
        return self.shared.surfaces

    @property
    def guards(self) -> Guards:
        """The table of those of the model, which only report."""
        return self.shared.guards

    # --- views ------------------------------------------------------------------------------------

    def view(self, model: Model) -> Data:
        """Data of a model with the same bodies and effects, which shares state and bodies' motion.

        Where the model has other rows, it has its own arrays with an entry for every row; where
        its control is sampled otherwise, its own samples.  Contacts of two surfaces are found from
        the same places.
        """
        return Data(model, self)

    @property
    def closed(self) -> Data:
        """The view of :meth:`Model.with_contacts_closed`."""
        return self if self.model.unilateral is None else self._closed

    @cached_property
    def _closed(self) -> Data:
        return self.view(self.model.with_contacts_closed())

    @property
    def of_laws(self) -> Data:
        """The data in which control laws are evaluated.

        The view of :meth:`Model.of_laws`, unless others have been set.
        """
        if self._of_laws is None:
            unilateral = self.model.unilateral
            if unilateral is None:
                return self
            same = unilateral.of_laws == unilateral.model
            self._of_laws = self.closed if same else self.view(self.model.of_laws())
        return self._of_laws

    @of_laws.setter
    def of_laws(self, data: Data) -> None:
        self._of_laws = data

    # --- compiled code ----------------------------------------------------------------------------

    def _make_struct(self, constants: Constants | None = None) -> np.ndarray:
        further = [effect.struct for effect in self.effects]
        for law, work in zip(self.model.laws, self.law_works, strict=True):
            further += [law.struct, struct_of(work)] if work else [law.struct]
        constants = self.model.constants if constants is None else constants
        return system_struct(constants, self.arrays, self.work, self.coupled, self.guards, further)

    def _connect_control(self) -> None:
        if self.model.python_control is not None:
            timed = [joint.connection for joint in self.model.timed_joints]
            control = self.model.python_control.connect(self.model.layout, self.arrays, timed)
            self.add_callback("control", control)

    def _connect_effects(self) -> None:
        for kernel, effect in zip(self.model.effects.kernels, self.effects, strict=True):
            if kernel.connect is not None:
                callbacks = kernel.connect(self, effect.arrays)
                self.callbacks.update(callbacks)
                self.shared.calls.update(callbacks.values())

    def add_callback(self, name: str, callback: GuardedCall) -> None:
        """Let compiled code call a function, by its address among the ``Functions``."""
        self.callbacks[name] = callback
        self.shared.calls.add(callback)
        setattr(self.arrays.functions, name, callback.address)

    def replace_arrays(
        self, constants: Constants | None = None, work: NodeWork | None = None, **changes: Any
    ) -> None:
        """Replace some of the arrays, for compiled code those of the model too."""
        self._rows = RowData(
            model=self.model,
            arrays=self.arrays._replace(**changes),
            work=self.work if work is None else work,
            coupled=self.coupled,
            cache={},
        )
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
            For a state of a system with other robots.
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
            sampling.mode = mode_of_samples(self.model)
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
        """The Coriolis matrices of all blocks, and the functions that update them."""
        coriolis, callback = self.shared.coriolis(self.model.layout)
        if callback is not None:
            self.callbacks["coriolis"] = callback
            self.shared.calls.add(callback)
        return coriolis

    # --- exceptions in callbacks ----------------------------------------------------------------

    def reraise(self) -> None:
        """Raise the exception of a callback, of these data or another view, and clear the flag."""
        self.arrays.status.failed = False
        for call in (*self.callbacks.values(), *self.shared.calls):
            call.reraise()

    def forgive(self) -> None:
        """Ignore the exceptions of callbacks, and clear the flag.

        Only of class ``Exception``: a Ctrl-C, say, is raised.
        """
        self.arrays.status.failed = False
        errors = [call.error for call in self.shared.calls]
        for call in self.shared.calls:
            call.error = None
        for error in errors:
            if error is not None and not isinstance(error, Exception):
                raise error


def with_rows(model: Model, variables: Variables) -> RowData:
    """Variables with the rows of a model, and workspaces for them."""
    joints, contacts = model.layout.joint_counts, model.layout.contact_counts
    work = make_work(joints, contacts, model.levers, model.layout.node, model.trees)
    use_factors(work.trees, fields_of(TermAddresses, variables.bodies.pointers).factors)
    return RowData(
        model=model,
        arrays=variables,
        work=work,
        coupled=make_coupled(joints, contacts, model.layout.node),
        cache={},
    )


def rows_of_view(model: Model, viewed: Data) -> RowData:
    """Those of a view: where the model has the rows of the Data, arrays and workspaces are shared.

    Functions are the view's own, and so are samples of a control that is sampled otherwise.
    """
    arrays = viewed.arrays._replace(functions=viewed.arrays.functions.copy())
    if model.sampling != viewed.model.sampling:
        sampling = SamplingStatus(mode=mode_of_samples(model))
        held = np.zeros_like(arrays.control.held_torques)
        control = arrays.control._replace(sampling=sampling, held_torques=held)
        arrays = arrays._replace(control=control)
    if model.constants.contacts is viewed.model.constants.contacts:
        return RowData(model, arrays, viewed.work, viewed.coupled, {})
    rows = make_rows(model.layout, len(model.constants.contacts.codes) - model.layout.contacts)
    sample = arrays.sample._replace(forces=rows.force)
    return with_rows(model, arrays._replace(rows=rows, sample=sample))


def mode_of_samples(model: Model) -> int:
    """What becomes of ``SamplingStatus.due`` at a start, and at a sample."""
    return ALWAYS if model.sampling is None else ONCE
