"""Some rows of a Data at a time: the contacts that are closed now.

The addresses in the struct of a :class:`RowSelection` stay, with whatever refers to it: a run and
its steps.  Its arrays have room for all rows.  Where rows are selected, a kernel writes the sizes
of the arrays, a few small tables, and zeros into what earlier rows have left.  Rows are never
selected while compiled code runs: it may have read the sizes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import replace
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from multiarm.contacts.kernel import CONTACT_WIDTH, ContactRow
from multiarm.contacts.table import (
    Code,
    JointRows,
    count_parts,
    empty_table,
    is_of_joints,
    select_joint_rows,
    select_rows,
)
from multiarm.dynamics.arrays import Constants, Shapes, open_system, row_places
from multiarm.dynamics.data import Data
from multiarm.dynamics.layout import Layout
from multiarm.dynamics.model import Model
from multiarm.dynamics.solver.node import (
    NodeWork,
    group_order,
    group_shapes,
    make_work,
    work_shapes,
    write_groups,
)
from multiarm.dynamics.solver.singular import CoupledWork, coupled_shapes
from multiarm.dynamics.variables import Variables, row_shapes
from multiarm.jit.kernels import INTS, clear, copy, kernel
from multiarm.jit.rows import fields_of

# Selections whose tables and caches are kept.
MOST_RECENT = 32
# Of each row of a system.
SELECTED, TANGENT_SELECTED = 1, 2


class RowSelection(Data):
    """Data of those rows of another one that were selected last, at first of none.

    Its ``model, arrays, work, coupled`` are made for the selected rows where Python asks for them.

    Parameters
    ----------
    full : Data
        Of all rows.
    variables : optional
        Arrays in place of those of ``full``, by name.

    Attributes
    ----------
    rows : int64 (m,)
        The selected rows, increasing.
    counts : list of int
        How many each block has of them.
    tangents : RowSelection, optional
        With the tangents of those that slide, see :mod:`multiarm.dynamics.sliding`; they are
        selected before the rows.
    """

    def __init__(self, full: Data, **variables: Any) -> None:
        model, layout = full.model, full.model.layout
        super().__init__(replace(model.select(range(layout.contacts)), unilateral=None), full)
        self.tangents: RowSelection | None = None
        self._full, self._room = full, self._make_room(variables)
        self._places = row_places(*_shapes(layout, layout.contact_counts, 0, model.trees))
        codes = fields_of(Code, model.constants.contacts.codes[: layout.contacts])
        of_joints = is_of_joints(codes.kind)
        tables = partial(_tables, layout, of_joints, model.trees)
        self._tables = lru_cache(MOST_RECENT)(tables)
        self._models = lru_cache(MOST_RECENT)(partial(_selected_model, model))
        # what is made for some rows stays right for them: their arrays are where they were
        selected_rows = partial(SelectedRows, model, self._room, self._models)
        self._selections = lru_cache(MOST_RECENT)(selected_rows)
        self.select(np.zeros(0, dtype=np.int64))

    def _make_room(self, variables: dict[str, Any]) -> Room:
        """Replace the arrays by some with room for any rows; the struct has their addresses."""
        layout, constants = self.model.layout, self.model.constants
        table = constants.contacts
        parts = count_parts(table.codes, layout.contacts)
        # blocks with more contacts than joints are in no group
        joints, contacts = layout.joint_counts, layout.contact_counts
        fewer = np.minimum(joints, contacts).tolist()
        groups = make_work(joints, fewer, node=layout.node, parents=self.model.trees).groups
        constants = constants._replace(contacts=empty_table(layout.contacts + parts, table.shapes))
        self.replace_arrays(
            constants=constants,
            work=self.work._replace(groups=groups),
            rows=self.arrays.rows._replace(parts=np.zeros((parts, CONTACT_WIDTH))),
            **variables,
        )
        return Room(constants, self.arrays, self.work, self.coupled)

    def forget(self) -> None:
        """Make the models of some rows anew: their geometry has changed."""
        self._models.cache_clear()

    def select(self, rows: np.ndarray) -> None:
        """Select rows, given in increasing order."""
        selected = np.zeros(self._full.model.layout.contacts, dtype=np.uint8)
        selected[rows] = SELECTED
        tables = self._tables(selected.tobytes())
        self.struct[self._places] = tables.sizes
        write_selection(
            self.struct, self._full.struct, rows, tables.of_owners, tables.of_blocks, tables.order
        )
        self.rows, self.counts = rows, tables.counts
        if self.tangents is not None:
            selected[self.tangents.rows] = TANGENT_SELECTED
        self._rows = self._selections(selected.tobytes())


class Room(NamedTuple):
    """Arrays with room for any rows of a system, as the struct has them."""

    constants: Constants
    arrays: Variables
    work: NodeWork
    coupled: CoupledWork


class SelectedRows:
    """A :class:`~multiarm.dynamics.data.RowData` of selected rows, made as it is asked for.

    Parameters
    ----------
    full : Model
        With all rows.
    room : Room
        The beginnings of these arrays are those of the selected rows.
    models : callable
        Models with selected rows, as long as their geometry stays.
    selected : bytes
        Of each row, whether it is ``SELECTED``, or ``TANGENT_SELECTED``.
    """

    def __init__(
        self, full: Model, room: Room, models: Callable[[bytes], Model], selected: bytes
    ) -> None:
        self._full, self._room, self._models, self._selected = full, room, models, selected
        self.cache: dict[object, Any] = {}

    @property
    def model(self) -> Model:
        """The model with the selected rows."""
        return self._models(self._selected)

    @cached_property
    def arrays(self) -> Variables:
        """The variables of the selected rows."""
        rows = beginnings(
            self._room.arrays.rows,
            row_shapes(self._selected.count(SELECTED), self._full.layout.node),
        )
        return self._room.arrays._replace(rows=rows)

    @cached_property
    def work(self) -> NodeWork:
        """The workspace for the selected rows."""
        work = beginnings(self._room.work, work_shapes(*self._sizes, self._full.layout.node))
        shapes = group_shapes(*self._sizes, self._full.trees)
        return work._replace(groups=beginnings(work.groups, shapes))

    @cached_property
    def coupled(self) -> CoupledWork:
        """The workspace of the coupled system for the selected rows."""
        return beginnings(self._room.coupled, coupled_shapes(*self._sizes, self._full.layout.node))

    @cached_property
    def contact_rows(self) -> ContactRow:
        """Views of the kinematics of the selected rows."""
        return fields_of(ContactRow, self.arrays.rows.kinematics)

    @cached_property
    def _sizes(self) -> tuple[list[int], list[int]]:
        layout = self._full.layout
        blocks = range(layout.block_count)
        counts = [self._selected[layout.contacts_of_block(i)].count(SELECTED) for i in blocks]
        return layout.joint_counts, counts


def _selected_model(full: Model, selected: bytes) -> Model:
    rows = np.flatnonzero(np.frombuffer(selected, dtype=np.uint8) == SELECTED)
    return replace(full.select(rows), unilateral=None)


class _Tables(NamedTuple):
    """What belongs to some rows: their first ones, sizes of arrays, order of groups."""

    of_owners: np.ndarray  # (C + 1,) first row of each owner
    of_blocks: np.ndarray  # (n + 1,)
    counts: list[int]  # of the blocks
    sizes: np.ndarray
    order: np.ndarray


def _tables(
    layout: Layout, of_joints: np.ndarray, trees: Collection[int], selected: bytes
) -> _Tables:
    rows = np.flatnonzero(np.frombuffer(selected, dtype=np.uint8))
    of_owners, of_blocks = (
        np.searchsorted(rows, bounds) for bounds in (layout.first_contact, layout.first_of_block)
    )
    joints, counts = layout.joint_counts, np.diff(of_blocks).tolist()
    shapes = _shapes(layout, counts, int(np.count_nonzero(of_joints[rows])), trees)
    sizes = [size for part in shapes for shape in part.values() for size in shape]
    return _Tables(
        of_owners, of_blocks, counts, np.array(sizes), group_order(joints, counts, trees)
    )


def _shapes(
    layout: Layout, counts: list[int], of_joints: int, trees: Collection[int]
) -> tuple[Shapes, ...]:
    """Shapes of constants, variables and workspaces for numbers of rows."""
    joints = layout.joint_counts
    return (
        dict.fromkeys(JointRows._fields, (of_joints,)),
        row_shapes(sum(counts), layout.node),
        work_shapes(joints, counts, layout.node),
        group_shapes(joints, counts, trees),
        coupled_shapes(joints, counts, layout.node),
    )


def beginnings(holder: Any, shapes: Shapes) -> Any:
    """A ``NamedTuple`` with some arrays of smaller shapes, at the beginning of their memory."""
    arrays = {
        name: getattr(holder, name).reshape(-1)[: math.prod(shape)].reshape(shape)
        for name, shape in shapes.items()
    }
    return holder._replace(**arrays)


@kernel
def write_selection(
    struct: INTS, full: INTS, rows: INTS, of_owners: INTS, of_blocks: INTS, order: INTS
):
    """Write the tables of some rows of the system ``full``, for arrays that have their sizes.

    ``of_owners`` (C + 1,) and ``of_blocks`` (n + 1,) are the first rows of each owner and of each
    block among them, ``order`` that of the groups.
    """
    constants, _, _ = open_system(full)
    model, data, work = open_system(struct)
    copy(of_owners, data.rows.first)
    copy(of_blocks, work.first_contact)
    work.status.block_by_block = False
    select_rows(constants.contacts, rows, model.contacts)
    select_joint_rows(model.contacts.codes, work.first_contact, work.first_joint, model.joint_rows)
    write_groups(order, work)
    # no result of other rows is left; columns of W beyond a block's rows are zero
    for k in range(rows.size):
        clear(data.rows.kinematics[k])
        clear(data.rows.W_o[k])
    for k in range(data.rows.block_wrenches.shape[0]):
        clear(data.rows.block_wrenches[k])
    for k in range(data.rows.parts.shape[0]):
        clear(data.rows.parts[k])
    clear(data.rows.c)
    clear(data.rows.force)
    clear(data.rows.static_force)
    for i in range(work.W.shape[0]):
        for j in range(work.W.shape[1]):
            clear(work.W[i, j])
