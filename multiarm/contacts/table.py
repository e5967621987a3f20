"""The tables that the kernel reads: contact records, and rows of joints, packed as arrays.

Besides the rows of contact records (:mod:`multiarm.geometry.records`) W has *joint rows*: one joint
of an arm, at a limit of its range or held by its friction; the object takes no part in them.  The
kernel is :mod:`multiarm.contacts.kernel`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from multiarm.geometry.records import CYLINDER, PLANE, SPHERE, Contact, SmoothShape, Surface
from multiarm.jit.kernels import plain
from multiarm.jit.structs import Ints1

# Kinds of row: a tip on a plane, sphere or cylinder has the surface's kind; these have their own.
CURVED, PAIR, TANGENT, COMBINED, JOINT = range(7, 12)
# Columns of ContactTable.codes: of all rows; of curved surfaces and pairs; of tangents; of combined
# rows; of joints.
KIND, SURFACE_BODY, CODE_WIDTH = 0, 1, 4
FIRST_SHAPE = 2
TANGENT_NUMBER, NORMAL_PART = 2, 3
FIRST_PART, PARTS = 2, 3
JOINT_NUMBER = 2
# Columns of .geometry: of contacts; of tangents, in place of origin and axis; of joints.
POINT, ORIGIN, AXIS, GUIDE_RADIUS, SIDE, TIP_RADIUS, WEIGHT, GEOMETRY_WIDTH = (
    0, 3, 6, 9, 10, 11, 12, 13,
)  # fmt: skip
SECOND_DIRECTION, FIRST_DIRECTION = ORIGIN, AXIS
BOUND, HAS_BOUND = GUIDE_RADIUS, WEIGHT
# Columns of .shapes.
SHAPE_KIND, SHAPE_AXES, SHAPE_ORIGIN, SHAPE_SIZES = 0, 1, 10, 13
SHAPE_SIDE, SHAPE_FUNCTION, SHAPE_WIDTH = 16, 17, 18


@dataclass(frozen=True)
class JointRow:
    """One row of W that belongs to a joint of an arm; the object takes no part.

    Attributes
    ----------
    name : str
        Shown in messages and results.
    joint : int
        Number of the joint in its arm.
    side : float
        1: the force moves the joint forward, the gap is ``q - bound``; -1: backward, ``bound - q``.
    bound : float or None
        Position of zero gap [rad, m]; None: the row constrains velocities only.
    """

    name: str
    joint: int
    side: float = 1.0
    bound: float | None = None
    tangent: int = 0
    pushes_only: bool = False

    def moved_on_arm(self, rotation: np.ndarray, translation: np.ndarray) -> JointRow:
        """The same row, which has no geometry."""
        return self


class ContactTable(NamedTuple):
    """Records packed for the kernel.

    codes : int64 (N + P, 4)
        The N rows of W, arm after arm, then the P parts of the combined rows.  Columns: kind; the
        body that carries the guiding surface; then by kind the first row in ``shapes``; the number
        of the tangent and, where it does not follow its normal row, of a copy of that among the
        parts; the first part and how many there are; the number of the joint in its arm.
    geometry : float64 (N + P, 13)
        Tip's centre (3); the guide's origin (3), axis (3), radius, side (+1 outer, -1 hollow); tip
        radius; weight.  Of a tangent, axis and origin are two directions of the guide's body: the
        first tangent is orthogonal to the first one (near its poles: to the second).
    shapes : float64 (S, 18)
        All other surfaces: kind, axes (9, row by row), origin (3), sizes (3), side, number of the
        user function.  A pair has two, the guide first.
    functions : list of SmoothShape
    """

    codes: np.ndarray
    geometry: np.ndarray
    shapes: np.ndarray
    functions: list[SmoothShape]


def pack(contacts: Sequence[Contact | JointRow]) -> ContactTable:
    """Pack records for the kernel."""
    codes: list[list[int]] = []
    geometry: list[np.ndarray] = []
    parts: list[Contact] = []
    shapes: list[np.ndarray] = []
    functions: list[SmoothShape] = []
    for k, contact in enumerate(contacts):
        if isinstance(contact, JointRow):
            codes.append([JOINT, 0, contact.joint, 0])
        elif contact.is_combined:
            pieces = [replace(contact, minus=None, weight=1.0)]
            pieces += [] if contact.minus is None else [contact.minus]
            first = len(contacts) + len(parts)
            codes.append([COMBINED, contact.surface_body, first, len(pieces)])
            parts += pieces
        elif contact.tangent:
            normal_part = 0
            if not _follows_its_normal(contact, contacts, k):
                normal_part = len(contacts) + len(parts)
                parts.append(replace(contact, tangent=0))
            codes.append([TANGENT, contact.surface_body, contact.tangent, normal_part])
        else:
            codes.append(_contact_codes(contact, shapes, functions))
        geometry.append(_geometry_row(contact))
    for part in parts:
        codes.append(_contact_codes(part, shapes, functions))
        geometry.append(_geometry_row(part))
    return ContactTable(
        np.array(codes, dtype=np.int64).reshape(-1, CODE_WIDTH),
        np.array(geometry).reshape(-1, GEOMETRY_WIDTH),
        np.array(shapes).reshape(-1, SHAPE_WIDTH),
        functions,
    )


def count_parts(codes: np.ndarray, count: int) -> int:
    """The most parts that some of the ``count`` rows of a table can have.

    A tangent without its normal row has a copy of it among the parts.
    """
    alone = (codes[:count, KIND] == TANGENT) & (codes[:count, NORMAL_PART] == 0)
    return len(codes) - count + np.count_nonzero(alone)


@plain
def select_rows(codes, geometry, rows, selected_codes, selected_geometry):
    """Write the table of some rows, in increasing order; returns the number of its parts.

    The other surfaces, to which codes refer, are those of the whole table.
    """
    count, parts = rows.size, 0
    for k in range(count):
        row = rows[k]
        copy_record(codes, geometry, row, k, selected_codes, selected_geometry)
        kind = codes[row, KIND]
        if kind == COMBINED:
            first = codes[row, FIRST_PART]
            selected_codes[k, FIRST_PART] = count + parts
            for piece in range(first, first + codes[row, PARTS]):
                copy_record(
                    codes, geometry, piece, count + parts, selected_codes, selected_geometry
                )
                parts += 1
        elif kind == TANGENT:
            number, part = codes[row, TANGENT_NUMBER], codes[row, NORMAL_PART]
            at, normal = k - number, part if part > 0 else row - number
            if part > 0 or at < 0 or rows[at] != normal:
                selected_codes[k, NORMAL_PART] = count + parts
                copy_record(
                    codes, geometry, normal, count + parts, selected_codes, selected_geometry
                )
                parts += 1
    return parts


@plain
def copy_record(codes, geometry, source, k, selected_codes, selected_geometry):
    """Copy one record of a table to place ``k`` of another one."""
    for column in range(CODE_WIDTH):
        selected_codes[k, column] = codes[source, column]
    for column in range(GEOMETRY_WIDTH):
        selected_geometry[k, column] = geometry[source, column]


class JointRows(NamedTuple):
    """The rows of W that belong to a joint of an arm, (r,) numbers each."""

    arm: Ints1
    row: Ints1
    joint: Ints1


def make_joint_rows(count: int) -> JointRows:
    """Allocate for a number of rows."""
    return JointRows(*np.zeros((3, count), dtype=np.int64))


@plain
def select_joint_rows(codes, rows, dofs, joint_rows):
    """Write the rows that belong to joints.

    ``rows`` and ``dofs`` (n + 1,) are the first ones of each arm.
    """
    count = 0
    for i in range(rows.size - 1):
        for row in range(rows[i], rows[i + 1]):
            if codes[row, KIND] == JOINT:
                joint_rows.arm[count], joint_rows.row[count] = i, row
                joint_rows.joint[count] = dofs[i] + codes[row, JOINT_NUMBER]
                count += 1


def _follows_its_normal(tangent: Contact, contacts: Sequence[Contact | JointRow], k: int) -> bool:
    normal = contacts[k - tangent.tangent] if k >= tangent.tangent else None
    return (
        isinstance(normal, Contact)
        and not normal.tangent
        and (_same(normal.arm, tangent.arm) and _same(normal.object, tangent.object))
    )


def _same(a: Surface, b: Surface) -> bool:
    """Whether two records describe one surface."""
    return a is b or (
        (a.kind, a.sizes, a.inside, a.function) == (b.kind, b.sizes, b.inside, b.function)
        and np.array_equal(a.origin, b.origin)
        and np.array_equal(a.axes, b.axes)
    )


def _contact_codes(contact: Contact, shapes: list, functions: list) -> list[int]:
    guide, follower = contact.guide, contact.follower
    if follower.is_tip and guide.kind in (PLANE, SPHERE, CYLINDER):
        return [guide.kind, contact.surface_body, -1, 0]
    first = len(shapes)
    shapes.append(_shape_row(guide, functions))
    if follower.is_tip:
        return [CURVED, contact.surface_body, first, 0]
    shapes.append(_shape_row(follower, functions))
    return [PAIR, contact.surface_body, first, 0]


def _geometry_row(contact: Contact | JointRow) -> np.ndarray:
    row = np.zeros(GEOMETRY_WIDTH)
    if isinstance(contact, JointRow):
        row[SIDE], row[HAS_BOUND] = contact.side, float(contact.bound is not None)
        row[BOUND] = contact.bound or 0.0
        return row
    guide, follower = contact.guide, contact.follower
    row[POINT : POINT + 3] = follower.origin
    row[ORIGIN : ORIGIN + 3] = guide.origin
    row[AXIS : AXIS + 3] = guide.axes[:, 2]
    if contact.tangent:
        # two directions orthogonal to the first tangent; a plane's normal cannot be one
        first, second = (0, 1) if guide.kind == PLANE else (2, 0)
        row[FIRST_DIRECTION : FIRST_DIRECTION + 3] = guide.axes[:, first]
        row[SECOND_DIRECTION : SECOND_DIRECTION + 3] = guide.axes[:, second]
    row[GUIDE_RADIUS] = guide.sizes[0]
    row[SIDE] = -1.0 if guide.inside else 1.0
    row[TIP_RADIUS] = follower.sizes[0] if follower.is_tip else 0.0
    row[WEIGHT] = contact.weight
    return row


def _shape_row(surface: Surface, functions: list) -> np.ndarray:
    row = np.zeros(SHAPE_WIDTH)
    row[SHAPE_KIND] = surface.kind
    row[SHAPE_AXES : SHAPE_AXES + 9] = surface.axes.ravel()
    row[SHAPE_ORIGIN : SHAPE_ORIGIN + 3] = surface.origin
    row[SHAPE_SIZES : SHAPE_SIZES + 3] = surface.sizes
    row[SHAPE_SIDE] = -1.0 if surface.inside else 1.0
    row[SHAPE_FUNCTION] = -1.0
    if surface.function is not None:
        row[SHAPE_FUNCTION] = len(functions)
        functions.append(surface.function)
    return row
