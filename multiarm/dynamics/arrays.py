"""The arrays of kernels in one struct: constants of the model, variables of an evaluation.

In calls between compiled functions, a struct (:mod:`multiarm.jit.structs`) contains both and the
solver's workspace.  :func:`open_system` returns its views ``model, data, work`` with named fields.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from multiarm.contacts.table import ContactTable, JointRows
from multiarm.dynamics.connections import Connections, Links
from multiarm.dynamics.guards import Guards, open_guards
from multiarm.dynamics.solver.node import BlockGroups, NodeWork
from multiarm.dynamics.solver.singular import CoupledWork
from multiarm.dynamics.status import CALLBACK_FAILED, KERNEL_FAILED, OK, SINGULAR
from multiarm.dynamics.variables import Rows, Variables
from multiarm.jit.kernels import inlined
from multiarm.jit.pointers import call_cfunc
from multiarm.jit.rows import Rotation, Vector, row_of
from multiarm.jit.structs import (
    Flag,
    Floats1,
    Floats2,
    Floats3,
    Int,
    Ints1,
    Ints2,
    count_entries,
    place_of,
    referenced,
    size_places,
    struct_of,
    view,
)


class CalledFunction(NamedTuple):
    """A row of ``Constants.control``, ``sampled`` or ``effects``; addresses are 0 for none.

    Those of derivatives are written where they are first taken, since most runs need none
    (:func:`multiarm.dynamics.force_derivatives.prepare_derivatives`).
    """

    address: int
    numbers_at: int = 0  # index of its first number or array in the system's struct
    derivative: int = 0  # address
    share_derivative: int = 0  # of a law: address of that at fixed multipliers
    state_alone: bool = False  # it is an effect of a user, who knows the state alone


ADDRESS, NUMBERS_AT, DERIVATIVE, SHARE_DERIVATIVE, STATE_ALONE = range(5)


def table_of(functions: Iterable[CalledFunction]) -> np.ndarray:
    """The functions as a table of whole numbers, shape (k, 5)."""
    return np.array([*functions], dtype=np.int64).reshape(-1, len(CalledFunction._fields))


# What the torques of an arm's drives depend on: the time, also the state of this arm, also the
# multipliers of the last law, anything.
OPEN_LOOP, LOCAL, CARRYING, COUPLED = range(4)


class FreeComponents(NamedTuple):
    """The m recorded components of the relative motions in the joint frames."""

    bounds: Ints1  # (C + 1,) first one of each owner of rows
    component: Ints1  # (m,) of the relative rates
    coordinate: Ints1  # (m,) its coordinate among those of the relative motion


class FloatingBases(NamedTuple):
    """The B floating bases of robots."""

    robot: Ints1  # (B,)
    # (B,) of its pose in Pinocchio's configuration: position, quaternion xyzw; -1: compiled
    slot: Ints1


class TipFrame(NamedTuple):
    """The frame of a tip in the link that carries it."""

    rotation: Rotation
    origin: Vector  # [m]


open_tip_frame = row_of(TipFrame)


class Constants(NamedTuple):
    """Constants of all evaluations of a scene."""

    # of each joint: index in Pinocchio's configuration, -1 for compiled arms and floating bases;
    # whether cosine and sine stand there
    q_slots: Ints1
    circular: Ints1
    first_joint: Ints1  # (R + 1,) of each robot; last the number of all joints
    floating_bases: FloatingBases
    undriven: Ints1  # joints without drives: the six of each floating base, then passive ones
    contacts: ContactTable  # geometry on links is in the frame of the joint that moves the link
    links: Links
    connections: Connections  # the C owners of rows
    joint_frames: Floats2  # (C, 24), see multiarm.contacts.joint
    tip_frames: Floats2  # (C, 12), of :class:`TipFrame`, of the first bodies
    free: FreeComponents
    object_masses: Floats1  # (F,) [kg]
    object_inertias: Floats3  # (F, 3, 3) about the centres of mass, object axes [kg m^2]
    gravity: Floats1  # (3,) world axes [m/s^2]
    # (k, 5) the control laws, see :class:`CalledFunction` and multiarm.dynamics.control_laws
    control: Ints2
    # (k, 5) the laws of a control that is sampled; whether its torques act one sample later, see
    # multiarm.dynamics.held_control
    sampled: Ints2
    sample_delay: Flag
    # (k, 5) the effects in the order of the phases, and the end of each phase, see
    # multiarm.dynamics.effect_kernels
    effects: Ints2
    passive_end: Int
    actuator_end: Int
    applied_end: Int
    # what the torques of an arm depend on, see ``OPEN_LOOP``; whether effects act within each arm,
    # and on the object, from its own state only
    control_reach: Int
    local_effects: Flag
    state_joints: Ints1  # joint to which each state of local effects belongs; -1: of another effect
    joint_rows: JointRows
    dense: Flag  # solve by the dense reference instead of the node algorithm
    calls_user: Flag  # there are user functions: a controller, surfaces, effects


def system_struct(
    constants: Constants,
    variables: Variables,
    work: NodeWork,
    coupled: CoupledWork,
    guards: Guards,
    further: Sequence[np.ndarray] = (),
) -> np.ndarray:
    """Struct of a system; :func:`open_system`, :func:`open_coupled`, :func:`open_reports` open it.

    ``further`` are the structs of the effects, from index ``EFFECTS`` on, then of control laws.
    """
    return np.concatenate([struct_of(constants, variables, work, coupled, guards), *further])


_PARTS = (Constants, Variables, NodeWork, CoupledWork, Guards)
_FIRST = [sum(map(count_entries, _PARTS[:k])) for k in range(len(_PARTS) + 1)]
_open_constants, _open_variables, _open_work = (
    view(part, at) for part, at in zip(_PARTS[:3], _FIRST[:3], strict=True)
)
# Views of the coupled system's arrays in a system's struct.
open_coupled = view(CoupledWork, _FIRST[3])
# View of the guards that only report.
open_reports = view(Guards, _FIRST[4])

# Indices of two fields in the struct of a system, and of the first of the effects' arrays.
FUNCTIONS = _FIRST[1] + place_of(Variables, "functions")
STATUS = _FIRST[1] + place_of(Variables, "status")
EFFECTS = _FIRST[5]


Shapes = Mapping[str, tuple[int, ...]]


def row_places(
    joint_rows: Shapes, rows: Shapes, work: Shapes, groups: Shapes, coupled: Shapes
) -> np.ndarray:
    """Places in a system's struct of the sizes of arrays, in the order of their shapes.

    The arrays are some of ``JointRows``, ``Rows``, ``NodeWork``, its ``BlockGroups`` and
    ``CoupledWork``.
    """
    joint_rows_at = _FIRST[0] + place_of(Constants, "joint_rows")
    rows_at = _FIRST[1] + place_of(Variables, "rows")
    groups_at = _FIRST[2] + place_of(NodeWork, "groups")
    return np.concatenate(
        [
            size_places(JointRows, joint_rows_at, joint_rows),
            size_places(Rows, rows_at, rows),
            size_places(NodeWork, _FIRST[2], work),
            size_places(BlockGroups, groups_at, groups),
            size_places(CoupledWork, _FIRST[3], coupled),
        ]
    )


@inlined
def open_system(struct):
    """Views ``model, data, work`` of a system's struct: constants, variables, solver workspace."""
    return _open_constants(struct), _open_variables(struct), _open_work(struct)


@inlined
def open_data(struct):
    """The view ``data`` alone."""
    return _open_variables(struct)


@inlined
def guards_of_mode(data):
    """The guards of the mode, where there are unilateral contacts."""
    return open_guards(referenced(data.modes.mode))


# --- functions that are called by address ---------------------------------------------------------


@inlined
def call_listed(table, k, struct, data):
    """Call function ``k`` of ``Constants.control``, ``sampled``, ``effects``; returns a status."""
    at = float(table[k, NUMBERS_AT])
    answer = call_cfunc(table[k, ADDRESS], struct, at, data.time.now)
    return OK if answer == OK else failure_of_kernel(table[k, ADDRESS], answer, data)


@inlined
def call_derivative(table, k, column, struct, data):
    """Call the derivative of function ``k`` in a column; returns a status."""
    at = float(table[k, NUMBERS_AT])
    answer = call_cfunc(table[k, column], struct, at, data.time.now)
    if answer in (OK, SINGULAR):
        return answer
    return failure_of_kernel(table[k, column], answer, data)


@inlined
def failure_of_kernel(address, answer, data):
    """The status that stands for an answer which is not ``OK``.

    It is noted, unless a Python function failed, or a law that this one calls and that is noted.
    """
    if answer == CALLBACK_FAILED and data.status.failed:
        return answer
    if answer == KERNEL_FAILED and data.status.kernel != 0:
        return answer
    data.status.kernel, data.status.answer = address, answer
    return KERNEL_FAILED
