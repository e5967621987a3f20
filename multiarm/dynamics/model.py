"""Model: the constants of a compiled scene.

A :class:`Model` does not change after it has been built, so that any number of threads share it.
The model of a scene with unilateral contacts has all rows that can ever be closed; simulations use
models with the closed ones (:meth:`Model.select`).  The variables are in
:mod:`multiarm.dynamics.data`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from multiarm.contacts.joint import FrameRow, Joint, JointFrame
from multiarm.contacts.table import (
    Code,
    ContactTable,
    Record,
    count_parts,
    empty_table,
    is_of_joints,
    make_joint_rows,
    select_joint_rows,
    select_rows,
)
from multiarm.contacts.unilateral import TimedJoint, UnilateralConstraints
from multiarm.dynamics.arrays import COUPLED, Constants
from multiarm.dynamics.callbacks import PythonControl
from multiarm.dynamics.connections import Connection
from multiarm.dynamics.control_laws import NO_CONTROL, ControlLaw, are_differentiable
from multiarm.dynamics.effect_kernels import EffectProgram
from multiarm.dynamics.guards import Guard
from multiarm.dynamics.held_control import Sampling, with_held_control
from multiarm.dynamics.layout import Layout
from multiarm.errors import ModelError
from multiarm.geometry.records import Contact, SmoothShape
from multiarm.jit.kernels import Kernel
from multiarm.jit.rows import fields_of
from multiarm.public import public_names
from multiarm.robots.backends import Backends
from multiarm.robots.robot import AT_REST, Robot, Tip
from multiarm.scene import ResolvedRobot


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

    robots: dict[str, Robot]
    resolved_robots: dict[str, ResolvedRobot]  # their files and starts
    connections: dict[str, Connection]  # of bodies, by name: the joints of the scene
    joints: dict[str, Joint]  # of the connections
    backends: Backends  # they compute the terms of the robots; every Data takes a copy
    layout: Layout
    # of each owner of rows but the surroundings; the first body's geometry in its tip frame
    contacts: dict[str, list[Contact]]
    # all rows of W, the geometry on links in the frame of the joint that moves the link
    records: tuple[Record, ...]
    surfaces: tuple[SmoothShape, ...]  # user-defined surfaces; every Data takes copies
    frames: dict[str, JointFrame]  # each connection's frame on both bodies, its free motions
    constants: Constants  # for kernels
    effects: EffectProgram
    effect_links: tuple[
        tuple[int, int], ...
    ]  # robot and joint of every link that an effect acts on
    levers: tuple[np.ndarray, ...]  # ``NodeWork.levers`` of each block
    # blocks that are eliminated as trees: the number before each one in a velocity, or -1
    trees: Mapping[int, np.ndarray]
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

    # --- names ----------------------------------------------------------------------------------

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the robots in the order of the stacked vectors."""
        return self.layout.names

    @cached_property
    def base_origins(self) -> np.ndarray:
        """Where the robots stand, world axes, shape (n, 3) [m]."""
        return np.reshape([robot.files.base[:3, 3] for robot in self.robots.values()], (-1, 3))

    @property
    def calls_user(self) -> bool:
        """Whether steps call user functions ``f(t, state)``: a controller, effects, moments."""
        controller = self.python_control is not None and self.sampling is None
        moments = self.unilateral is not None and self.unilateral.has_functions
        return controller or self.effects.calls_user or moments

    @property
    def calls_python(self) -> bool:
        """Whether evaluations or samples call Python, which runs one thread at a time."""
        pinocchio = any(backend == "pinocchio" for backend in self.backends.by_robot.values())
        user = self.calls_user or self.python_control is not None
        return bool(user or self.surfaces or self.constants.dense or pinocchio)

    @property
    def contacts_with_states(self) -> dict[str, tuple[str, ...]] | None:
        """Names of the unilateral contacts by their owners; None where there is none."""
        if self.unilateral is None:
            return None
        return {owner: self.unilateral.contacts_of(owner) for owner in self.layout.owners}

    @property
    def blocks(self) -> list[str]:
        """The robots of each block by name; for the surroundings the owners of their rows."""
        layout = self.layout
        last = [layout.owners[c] for c in layout.owners_of_block(layout.block_count - 1)]
        return [
            " and ".join(layout.robots_of_block(i)) or ", ".join(last)
            for i in range(layout.block_count)
        ]

    def owner(self, row: int) -> tuple[str, Record]:
        """Owner and record of a row of W."""
        return self.layout.owners[self.layout.owner_of_contact(row)], self.records[row]

    @cached_property
    def contacts_of_object(self) -> tuple[int, ...]:
        """Rows of the contacts of the objects' connections."""
        rows: list[int] = []
        for name, connection in self.connections.items():
            of_owner = self.layout.contacts_of(self.layout.owners.index(name))
            if connection.of_object:
                rows += range(of_owner.start, of_owner.stop)
        return tuple(row for row in rows if isinstance(self.records[row], Contact))

    @property
    def world_number(self) -> int:
        """The world among the bodies (:mod:`multiarm.dynamics.connections`), the last one."""
        return len(self.backends.links) + self.layout.frames

    def bodies_of(self, connection: str) -> tuple[int, int]:
        """First and second body of a connection, in the order of ``BodyVariables.motion``."""
        c, pairs = self.layout.owners.index(connection), self.constants.connections
        return int(pairs.first[c]), int(pairs.second[c])

    def tip_of(self, connection: str) -> Tip:
        """The tip that is a connection's first body; a frame at rest where that is the world."""
        body = self.connections[connection].first
        return self.robots[body.robot].tips[body.tip] if body.robot else AT_REST

    def frames_on_bodies(self, connection: str) -> FrameRow:
        """A connection's frame on its first and its second body, in the frames of these bodies.

        The frame of a link is that of the joint that moves it.
        """
        c = self.layout.owners.index(connection)
        return fields_of(FrameRow, self.constants.joint_frames[c])

    def joint_name(self, joint: int) -> str:
        """Name of a joint, given by its index in the stacked vectors."""
        i = self.layout.robot_of_joint(joint)
        return self.robots[self.arm_names[i]].velocity_names[joint - self.layout.first_joint[i]]

    @property
    def reads_inertias(self) -> bool:
        """Whether every evaluation reads the inertias of blocks, so that factors are of no use."""
        by_laws = any(law.reads_inertias for law in self.laws)
        return self.constants.dense or self.unilateral is not None or by_laws

    @property
    def joint_names(self) -> list[str]:
        """All joints as ``robot/joint``, in the order of the stacked vectors.

        The six of a floating base have names of their own.
        """
        robots = self.robots.items()
        return [f"{name}/{joint}" for name, robot in robots for joint in robot.velocity_names]

    @property
    def joint_units(self) -> list[str]:
        """Unit of every joint's coordinate, ``"rad"`` or ``"m"``."""
        return [unit for robot in self.robots.values() for unit in robot.velocity_units]

    @cached_property
    def position_limits(self) -> np.ndarray:
        """Ends of the range of every joint in the stacked vectors, shape (n, 2) [rad, m]."""
        limits = np.full((self.layout.rate_count, 2), [-np.inf, np.inf])
        for i, robot in enumerate(self.robots.values()):
            limits[self.layout.tree_joints(i)] = robot.position_limits
        return limits

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
        """The same model with control that :meth:`multiarm.dynamics.data.Data.hold` can hold."""
        if self.sampling is not None:
            return self
        differentiable = self.python_control is None and are_differentiable(self.laws)
        constants = with_held_control(self.constants, self.constants.control, differentiable)
        return replace(self, constants=constants)

    def with_constants(self, **changes: Any) -> Model:
        """The same model with other constants for kernels."""
        return replace(self, constants=self.constants._replace(**changes))

    @property
    def timed_joints(self) -> tuple[TimedJoint, ...]:
        """The joints that hold for some of the time."""
        return () if self.unilateral is None else self.unilateral.timed

    def require_joints_as_written(self, t: float, what: str) -> None:
        """Refuse timed joints that do not hold at a time [s] where the scene's start has them.

        Raises
        ------
        ModelError
            ``what`` takes the joints as the scene has them.
        """
        for joint in self.timed_joints:
            interval = joint.interval_at(t)
            latest = 0.0 if joint.located else t  # when it began to hold, at the latest
            begin = np.inf if interval is None else interval.begin
            if not (isinstance(begin, float) and begin <= latest):
                raise ModelError(
                    f"{what}: joint '{joint.connection}' does not hold at t = {t:g} s as it does "
                    "at the scene's start; take a time at which it does, or a scene without it"
                )

    def with_contacts_closed(self, holding: Set[int] | None = None) -> Model:
        """The same model with all contacts of its joints closed, as bilateral constraints.

        It is without friction, compliance, joint stops and surroundings; joints with dry friction
        move freely.  Without unilateral contacts it is the model itself.  ``holding``: of the timed
        joints these only.
        """
        return self if self.unilateral is None else self._closed(self.unilateral.model, holding)

    def of_laws(self, holding: Set[int] | None = None) -> Model:
        """The model that control laws see: with all contacts closed, those that grip stick.

        ``holding``: of the timed joints these only.
        """
        return self if self.unilateral is None else self._closed(self.unilateral.of_laws, holding)

    def counting_friction(self) -> Model:
        """The same model for control that counts the friction of contacts that only push."""
        if self.unilateral is None:
            return self
        return replace(self, unilateral=self.unilateral.counting_friction())

    def _closed(self, rows: Sequence[int], holding: Set[int] | None) -> Model:
        """The model with these rows as bilateral constraints; of timed joints ``holding`` ones."""
        if holding is not None and self.unilateral is not None:
            rows = self.unilateral.rows_held_by(holding, rows)
        effects = self.effects.with_contacts_closed()
        model = replace(self.select(rows), effects=effects, unilateral=None)
        return model.with_constants(**effect_constants(effects))

    def select(self, rows: Sequence[int] | np.ndarray) -> Model:
        """The same bodies and effects with some of the rows, given in increasing order."""
        chosen, before = np.array(rows, dtype=np.int64), self.layout.first_contact
        bounds = tuple(np.searchsorted(chosen, before).tolist())
        layout = replace(self.layout, first_contact=bounds)
        numbers = chosen.tolist()
        contacts = {
            name: [records[row - before[c]] for row in numbers[bounds[c] : bounds[c + 1]]]
            for c, (name, records) in enumerate(self.contacts.items())
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


def require_one_object(model: Model, why: str) -> None:
    """Refuse a model with several objects; ``why`` is a clause.

    Raises
    ------
    ModelError
    """
    objects = model.layout.objects
    if len(objects) > 1:
        raise ModelError(f"there are {len(objects)} objects, {', '.join(objects)}: {why}")


def row_constants(table: ContactTable, layout: Layout) -> dict[str, Any]:
    """Constants of the rows of a contact table."""
    of_joints = is_of_joints(fields_of(Code, table.codes[: layout.contacts]).kind)
    joint_rows = make_joint_rows(int(np.count_nonzero(of_joints)))
    of_blocks = np.array(layout.first_of_block), np.array(layout.first_joint_of_block)
    select_joint_rows(table.codes, *of_blocks, joint_rows)
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
