"""Some rows of a Data at a time: the contacts that are closed now.

The addresses in the struct of a :class:`RowSelection` stay, with whatever refers to it: a run and
its steps.  Where rows are selected, only the sizes in the struct and the contents of a few small
tables are written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from multiarm.contacts.kernel import CONTACT_WIDTH
from multiarm.contacts.table import CODE_WIDTH, GEOMETRY_WIDTH, KIND, TANGENT
from multiarm.dynamics.arrays import row_shapes, write_row_sizes
from multiarm.dynamics.model import Data
from multiarm.dynamics.solver.node import group_tables, work_shapes
from multiarm.dynamics.solver.singular import coupled_shapes
from multiarm.jit.simd import aligned_zeros

Shapes = Mapping[str, tuple[int, ...]]


class Room:
    """Memory for arrays of changing shapes, allocated once for the largest ones."""

    def __init__(self, largest: Mapping[str, np.ndarray]) -> None:
        self._memory = {name: array.reshape(-1) for name, array in largest.items()}

    def zeros(self, shapes: Shapes) -> dict[str, np.ndarray]:
        """Arrays of these shapes, at the beginning of the memory."""
        arrays = {}
        for name, shape in shapes.items():
            size = 1
            for count in shape:
                size *= count
            memory = self._memory[name][:size]
            memory[:] = 0
            arrays[name] = memory.reshape(shape)
        return arrays

    def copies(self, tables: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Copies of arrays, at the beginning of the memory."""
        arrays = {}
        for name, table in tables.items():
            arrays[name] = self._memory[name][: table.size].reshape(table.shape)
            arrays[name][:] = table
        return arrays


class RowSelection:
    """The rows of a Data, or any of them.

    Parameters
    ----------
    full : Data
        Of all rows.
    variables : optional
        Arrays in place of those of ``full``, by name.

    Attributes
    ----------
    data : Data
        Of the rows that were selected last, at first of none; its struct stays.
    """

    def __init__(self, full: Data, **variables: Any) -> None:
        self._full = full
        model, layout = full.model, full.model.layout
        self._dofs = np.diff(layout.dofs).tolist()
        self.data = full.view(replace(model.select(range(layout.contacts)), unilateral=None))
        b, levers = self.data.arrays, self.data.work.levers
        # a tangent without its normal row has a copy of it among the parts
        kinds = model.constants.codes[: layout.contacts, KIND]
        parts = len(b.parts) + np.count_nonzero(kinds == TANGENT)
        constants: dict[str, Any] = {
            "codes": np.zeros((layout.contacts + parts, CODE_WIDTH), dtype=np.int64),
            "geometry": np.zeros((layout.contacts + parts, GEOMETRY_WIDTH)),
            "joint_rows": np.zeros_like(model.constants.joint_rows),
        }
        # arms with more contacts than joints are in no group
        rows = np.diff(layout.rows)
        fewer = np.minimum(self._dofs, rows).tolist()
        tables, size = group_tables(self._dofs, fewer, levers)
        tables["packs"] = aligned_zeros(max(size, self.data.work.packs.size))
        self.data.replace_arrays(
            constants=self.data.model.constants._replace(**constants),
            work=self.data.work._replace(**tables),
            parts=np.zeros((parts, CONTACT_WIDTH)),
            **variables,
        )
        shapes = row_shapes(self.data.model.constants, layout)
        self._constants, self._tables = Room(constants), Room(tables)
        self._variables = _room(self.data.arrays, shapes)
        self._work = _room(self.data.work, work_shapes(self._dofs, rows.tolist()))
        self._coupled = _room(self.data.coupled, coupled_shapes(self._dofs, rows.tolist()))
        self.select(np.zeros(0, dtype=np.int64))

    def select(self, rows: np.ndarray) -> None:
        """Select rows, given in increasing order."""
        data, dofs = self.data, self._dofs
        model = replace(self._full.model.select(rows), unilateral=None)
        new, bounds = model.constants, model.layout.rows
        counts = np.diff(bounds).tolist()
        constants = self._constants.copies(
            {"codes": new.codes, "geometry": new.geometry, "joint_rows": new.joint_rows}
        )
        variables = self._variables.zeros(row_shapes(new, model.layout))
        tables, size = group_tables(dofs, counts, data.work.levers)
        work = {
            **self._work.zeros(work_shapes(dofs, counts)),
            **self._tables.copies(tables),
            **self._tables.zeros({"packs": (size,)}),
        }
        coupled: dict[str, Any] = self._coupled.zeros(coupled_shapes(dofs, counts))
        data.work.rows[:] = bounds
        data.work.factored[0] = 0
        write_row_sizes(data.struct, constants, variables, work, coupled)
        data.take_rows(
            model, variables, data.work._replace(**work), data.coupled._replace(**coupled)
        )


def _room(arrays: Any, shapes: Shapes) -> Room:
    return Room({name: getattr(arrays, name) for name in shapes})
