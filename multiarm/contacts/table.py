r"""The tables that the kernel reads: contact records, and rows of joints, packed as arrays.

Besides the rows of contact records (:mod:`multiarm.geometry.records`) W has rows of joints, in
which the object takes no part.  *Joint rows*: one joint of an arm, at a limit of its range or held
by its friction.  *Wheels*: a base on joints x, y and yaw does not slip sideways.  Its lateral
velocity is

.. math::
    \dot\psi = -\sin\theta\,\dot x + \cos\theta\,\dot y = 0, \qquad
    W = (-\sin\theta, \cos\theta, 0)^T, \qquad
    \ddot\psi\,|_0 = -(\cos\theta\,\dot x + \sin\theta\,\dot y)\,\dot\theta

with the yaw :math:`\theta`; it constrains velocities only.  The kernels are
:mod:`multiarm.contacts.kernel` and :func:`multiarm.dynamics.kinematics.write_joint_rows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from multiarm.geometry.records import (
    CYLINDER,
    PLANE,
    SPHERE,
    SURFACE_ON_OBJECT,
    Contact,
    Placement,
    SmoothShape,
    Surface,
)
from multiarm.jit.kernels import copy, plain
from multiarm.jit.rows import Number, Rotation, Vector, as_row, field_of, fields_of, row_of, width
from multiarm.jit.structs import Floats2, Ints1, Ints2


class RowKind(IntEnum):
    """Kinds of row of W."""

    # a tip on a surface: on those in closed form, on any other
    ON_PLANE = 0
    ON_SPHERE = 1
    ON_CYLINDER = 2
    ON_SURFACE = 3
    PAIR = 4  # two surfaces, neither of them a tip
    TANGENT = 5  # no slip
    COMBINED = 6
    JOINT = 7
    WHEELS = 8  # a base does not slip sideways


# Numba reads them as constants.
ON_PLANE = int(RowKind.ON_PLANE)
ON_SPHERE = int(RowKind.ON_SPHERE)
ON_CYLINDER = int(RowKind.ON_CYLINDER)
ON_SURFACE = int(RowKind.ON_SURFACE)
PAIR = int(RowKind.PAIR)
TANGENT = int(RowKind.TANGENT)
COMBINED = int(RowKind.COMBINED)
JOINT = int(RowKind.JOINT)
WHEELS = int(RowKind.WHEELS)

_CLOSED_FORMS = {PLANE: ON_PLANE, SPHERE: ON_SPHERE, CYLINDER: ON_CYLINDER}


class Code(NamedTuple):
    """Kind of a row, the body with its guiding surface, and by kind what else describes it."""

    kind: Number  # a :class:`RowKind`
    surface_body: Number
    shape: Number = -1  # the first one in ``shapes``, of curved surfaces and pairs
    # tangents: which of the two, and a copy of their normal row among the parts, where they do not
    # follow it
    tangent: Number = 0
    normal_part: Number = 0
    first_part: Number = 0  # of combined rows, and how many there are
    parts: Number = 0
    joint: Number = -1  # its number in the block, of joints; of wheels that of x
    leader: Number = -1  # the joint that it copies; -1: none


class ContactGeometry(NamedTuple):
    """Geometry of a contact, and of a combined row."""

    tip: Vector  # centre [m]
    origin: Vector  # of the guide [m]
    axis: Vector
    radius: Number  # of the guide [m]
    side: Number  # 1 outer, -1 hollow
    tip_radius: Number  # [m]
    weight: Number


class TangentGeometry(NamedTuple):
    """Directions of the guide's body: the first tangent is orthogonal to the first one (near its
    poles: to the second).
    """

    first: Vector
    second: Vector


class JointGeometry(NamedTuple):
    """Numbers of a :class:`JointRow`."""

    side: Number
    bound: Number  # [rad, m]
    has_bound: Number
    multiplier: Number


class Shape(NamedTuple):
    """A surface that is not in closed form."""

    kind: Number
    axes: Rotation
    origin: Vector  # [m]
    sizes: Vector  # [m]; of a cone sine and cosine of its half angle
    side: Number  # 1 outer, -1 hollow
    function: Number  # of a user; -1: none


GEOMETRY_WIDTH = width(ContactGeometry)
open_code, open_shape = row_of(Code), row_of(Shape)
open_geometry, open_tangent, open_joint = map(
    row_of, (ContactGeometry, TangentGeometry, JointGeometry)
)


@dataclass(frozen=True)
class JointRow:
    """One row of W that belongs to a joint of a robot; the object takes no part.

    Attributes
    ----------
    name : str
        Shown in messages and results.
    joint : int
        Number of the joint in its robot.
    side : float
        1: the force moves the joint forward, the gap is ``q - bound``; -1: backward, ``bound - q``.
    bound : float or None
        Position of zero gap [rad, m]; None: the row constrains velocities only.
    leader : int
        Number of a joint that it copies; -1: none.  Then ``q`` is what its position has more than
        ``multiplier`` times that of its leader.
    multiplier : float
    """

    name: str
    joint: int
    side: float = 1.0
    bound: float | None = None
    leader: int = -1
    multiplier: float = 0.0
    tangent: int = 0
    pushes_only: bool = False

    @property
    def joints(self) -> tuple[int, ...]:
        """Numbers in its robot of all joints that take part."""
        return (self.joint,) if self.leader < 0 else (self.joint, self.leader)

    def moved_on_bodies(self, _first: Placement | None, _second: Placement | None) -> JointRow:
        """The same row, which has no geometry."""
        return self


@dataclass(frozen=True)
class WheelRow:
    """One row of W: a robot on wheels does not slip sideways.

    Attributes
    ----------
    name : str
        Shown in messages and results.
    joint : int
        Number in its robot of the joint that moves the base along x; those along y and about z
        follow.
    """

    name: str
    joint: int
    tangent: int = 0
    pushes_only: bool = False

    @property
    def joints(self) -> tuple[int, ...]:
        """Numbers in its robot of all joints that take part."""
        return self.joint, self.joint + 1, self.joint + 2

    def moved_on_bodies(self, _first: Placement | None, _second: Placement | None) -> WheelRow:
        """The same row, which has no geometry."""
        return self


Record = Contact | JointRow | WheelRow
"""One row of W."""


class ContactTable(NamedTuple):
    """Records packed for the kernel."""

    # (N + P, 9) :class:`Code` of the N rows of W, arm after arm, then of the P parts of the
    # combined rows
    codes: Ints2
    # (N + P, 13) by kind :class:`ContactGeometry`, :class:`TangentGeometry`, :class:`JointGeometry`
    geometry: Floats2
    # (S, 18) :class:`Shape` of the surfaces that are not in closed form; a pair has two, the guide
    # first
    shapes: Floats2


class PackedContacts(NamedTuple):
    """The table of some records, and the surfaces of users to which its shapes refer."""

    table: ContactTable
    surfaces: list[SmoothShape]


def empty_table(records: int, shapes: np.ndarray) -> ContactTable:
    """Allocate for a number of records, whose shapes are among these."""
    codes = np.zeros((records, width(Code)), dtype=np.int64)
    return ContactTable(codes, np.zeros((records, GEOMETRY_WIDTH)), shapes)


@plain
def is_in_closed_form(kind):
    """Whether a row is that of a tip on a plane, a sphere or a cylinder."""
    return kind in (ON_PLANE, ON_SPHERE, ON_CYLINDER)


@plain
def is_of_joints(kind):
    """Whether a row belongs to joints alone: it has no place; of arrays, entry by entry."""
    return (kind == JOINT) | (kind == WHEELS)


@plain
def rolls(kind):
    """Whether a row constrains velocities only, not positions; of arrays, entry by entry."""
    return (kind == TANGENT) | (kind == WHEELS)


def pack(contacts: Sequence[Record]) -> PackedContacts:
    """Pack records for the kernel."""
    codes: list[Code] = []
    geometry: list[np.ndarray] = []
    parts: list[Contact] = []
    shapes: list[np.ndarray] = []
    functions: list[SmoothShape] = []
    for k, contact in enumerate(contacts):
        if isinstance(contact, JointRow):
            codes.append(Code(JOINT, 0, joint=contact.joint, leader=contact.leader))
        elif isinstance(contact, WheelRow):
            codes.append(Code(WHEELS, 0, joint=contact.joint))
        elif contact.is_combined:
            pieces = [replace(contact, minus=None, weight=1.0)]
            pieces += [] if contact.minus is None else [contact.minus]
            first = len(contacts) + len(parts)
            codes.append(Code(COMBINED, contact.surface_body, first_part=first, parts=len(pieces)))
            parts += pieces
        elif contact.tangent:
            normal_part = 0
            if not _follows_its_normal(contact, contacts, k):
                normal_part = len(contacts) + len(parts)
                parts.append(replace(contact, tangent=0))
            codes.append(
                Code(
                    TANGENT, contact.surface_body, tangent=contact.tangent, normal_part=normal_part
                )
            )
        else:
            codes.append(_code(contact, shapes, functions))
        geometry.append(_geometry_row(contact))
    for part in parts:
        codes.append(_code(part, shapes, functions))
        geometry.append(_geometry_row(part))
    table = ContactTable(
        np.array(codes, dtype=np.int64).reshape(-1, width(Code)),
        np.array(geometry).reshape(-1, GEOMETRY_WIDTH),
        np.array(shapes).reshape(-1, width(Shape)),
    )
    return PackedContacts(table, functions)


def count_parts(codes: np.ndarray, count: int) -> int:
    """The most parts that some of the ``count`` rows of a table can have.

    A tangent without its normal row has a copy of it among the parts.
    """
    of_rows = fields_of(Code, codes[:count])
    alone = (of_rows.kind == TANGENT) & (of_rows.normal_part == 0)
    return len(codes) - count + np.count_nonzero(alone)


@plain
def select_rows(table, rows, selected):
    """Write the table of some rows, in increasing order; returns the number of its parts.

    The shapes, to which codes refer, are those of the whole table.
    """
    count, parts = rows.size, 0
    for k in range(count):
        row = rows[k]
        copy_record(table, row, selected, k)
        code, copied = open_code(table.codes[row]), open_code(selected.codes[k])
        if code.kind == COMBINED:
            copied.first_part = count + parts
            for piece in range(code.first_part, code.first_part + code.parts):
                copy_record(table, piece, selected, count + parts)
                parts += 1
        elif code.kind == TANGENT:
            at, normal = k - code.tangent, row - code.tangent
            if code.normal_part > 0 or at < 0 or rows[at] != normal:
                copied.normal_part = count + parts
                normal = code.normal_part if code.normal_part > 0 else normal
                copy_record(table, normal, selected, count + parts)
                parts += 1
    return parts


@plain
def copy_record(table, record, selected, k):
    """Copy a record of a table to place ``k`` of another one."""
    copy(table.codes[record], selected.codes[k])
    copy(table.geometry[record], selected.geometry[k])


def records_of(table: ContactTable, rows: Sequence[int]) -> np.ndarray:
    """Numbers of the records of some rows: the rows', then those of their parts, row by row.

    That of a tangent is its normal, so that there are as many in any table of these rows.
    """
    parts: list[int] = []
    for row, numbers in zip(rows, table.codes[list(rows)].tolist(), strict=True):
        code = Code(*numbers)
        if code.kind == COMBINED:
            parts += range(code.first_part, code.first_part + code.parts)
        elif code.kind == TANGENT:
            parts.append(code.normal_part if code.normal_part > 0 else row - code.tangent)
    return np.array([*rows, *parts], dtype=np.int64)


class OnObject(NamedTuple):
    """What of some rows has a place on the object: numbers of records, and of shapes."""

    guides: Ints1  # records whose guide is
    tips: Ints1  # whose tip is
    tangents: Ints1
    shapes: Ints1


def on_object(table: ContactTable, rows: Sequence[int]) -> OnObject:
    """What of some rows has a place on the object."""
    records = records_of(table, rows)
    codes = fields_of(Code, table.codes[records])
    guide_is, is_tangent = codes.surface_body == SURFACE_ON_OBJECT, codes.kind == TANGENT
    has_tip = ~(is_tangent | is_of_joints(codes.kind))
    is_pair = codes.kind == PAIR
    # the guide's comes first
    of_guides = codes.shape[guide_is & (is_pair | (codes.kind == ON_SURFACE))]
    of_others = codes.shape[~guide_is & is_pair] + 1
    return OnObject(
        records[has_tip & guide_is],
        records[has_tip & ~guide_is],
        records[is_tangent & guide_is],
        np.concatenate([of_guides, of_others]),
    )


def move_on_object(
    written: ContactTable, moved: OnObject, place: Placement, table: ContactTable
) -> None:
    """Write into a table what another one has on the object, ``p -> turn p + shift``."""
    turn, shift = place
    fields = [
        (ContactGeometry, "origin", moved.guides, shift),
        (ContactGeometry, "axis", moved.guides, 0.0),
        (ContactGeometry, "tip", moved.tips, shift),
        (TangentGeometry, "first", moved.tangents, 0.0),
        (TangentGeometry, "second", moved.tangents, 0.0),
    ]
    for kind, name, at, translation in fields:
        if at.size:
            before, now = (field_of(kind, name, part.geometry) for part in (written, table))
            now[at] = before[at] @ turn.T + translation
    if moved.shapes.size:
        at = moved.shapes
        source, target = (fields_of(Shape, part.shapes) for part in (written, table))
        target.origin[at] = source.origin[at] @ turn.T + shift
        target.axes[at] = turn @ source.axes[at]


class JointRows(NamedTuple):
    """The rows of W that belong to joints of a robot, (r,) numbers each."""

    kind: Ints1  # ``JOINT`` or ``WHEELS``
    block: Ints1
    row: Ints1
    joint: Ints1  # among all joints; of wheels that along x, which y and yaw follow
    leader: Ints1  # the joint that it copies; -1: none


def make_joint_rows(count: int) -> JointRows:
    """Allocate for a number of rows."""
    return JointRows(*np.zeros((len(JointRows._fields), count), dtype=np.int64))


@plain
def select_joint_rows(codes, rows, dofs, joint_rows):
    """Write the rows that belong to joints.

    ``rows`` and ``dofs`` (n + 1,) are the first ones of each block.
    """
    count = 0
    for i in range(rows.size - 1):
        for row in range(rows[i], rows[i + 1]):
            code = open_code(codes[row])
            if is_of_joints(code.kind):
                joint_rows.kind[count] = code.kind
                joint_rows.block[count], joint_rows.row[count] = i, row
                joint_rows.joint[count] = dofs[i] + code.joint
                joint_rows.leader[count] = dofs[i] + code.leader if code.leader >= 0 else -1
                count += 1


def _follows_its_normal(tangent: Contact, contacts: Sequence[Record], k: int) -> bool:
    normal = contacts[k - tangent.tangent] if k >= tangent.tangent else None
    return (
        isinstance(normal, Contact)
        and not (normal.tangent or normal.is_combined)
        and (_same(normal.arm, tangent.arm) and _same(normal.object, tangent.object))
    )


def _same(a: Surface, b: Surface) -> bool:
    """Whether two records describe one surface."""
    return a is b or (
        (a.kind, a.sizes, a.inside, a.function) == (b.kind, b.sizes, b.inside, b.function)
        and np.array_equal(a.origin, b.origin)
        and np.array_equal(a.axes, b.axes)
    )


def _code(contact: Contact, shapes: list, functions: list) -> Code:
    guide, follower = contact.guide, contact.follower
    if follower.is_tip and guide.kind in _CLOSED_FORMS:
        return Code(_CLOSED_FORMS[guide.kind], contact.surface_body)
    first = len(shapes)
    shapes.append(_shape_row(guide, functions))
    if follower.is_tip:
        return Code(ON_SURFACE, contact.surface_body, shape=first)
    shapes.append(_shape_row(follower, functions))
    return Code(PAIR, contact.surface_body, shape=first)


def _geometry_row(contact: Record) -> np.ndarray:
    row = np.zeros(GEOMETRY_WIDTH)
    if isinstance(contact, WheelRow):
        return row
    fields = as_row(_geometry(contact))
    row[: fields.size] = fields
    return row


def _geometry(contact: Contact | JointRow) -> ContactGeometry | TangentGeometry | JointGeometry:
    if isinstance(contact, JointRow):
        has_bound = contact.bound is not None
        return JointGeometry(contact.side, contact.bound or 0.0, has_bound, contact.multiplier)
    guide, follower = contact.guide, contact.follower
    if contact.tangent:
        # two directions orthogonal to the first tangent; a plane's normal cannot be one
        first, second = (0, 1) if guide.kind == PLANE else (2, 0)
        return TangentGeometry(guide.axes[:, first], guide.axes[:, second])
    return ContactGeometry(
        tip=follower.origin,
        origin=guide.origin,
        axis=guide.axes[:, 2],
        radius=guide.sizes[0],
        side=-1.0 if guide.inside else 1.0,
        tip_radius=follower.sizes[0] if follower.is_tip else 0.0,
        weight=contact.weight,
    )


def _shape_row(surface: Surface, functions: list) -> np.ndarray:
    function = -1
    if surface.function is not None:
        function = len(functions)
        functions.append(surface.function)
    side = -1.0 if surface.inside else 1.0
    return as_row(
        Shape(surface.kind, surface.axes, surface.origin, np.array(surface.sizes), side, function)
    )
