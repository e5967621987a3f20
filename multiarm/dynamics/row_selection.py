"""Some rows of a Data at a time: the contacts that are closed now.

The addresses in the struct of a :class:`RowSelection` stay, with whatever refers to it: a run and
its steps.  Where rows are selected, the sizes in the struct and the contents of a few small tables
are written, and the variables of the rows are cleared.  Rows are never selected while compiled code
runs: it may have read the sizes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from multiarm.contacts.kernel import CONTACT_WIDTH
from multiarm.contacts.table import CODE_WIDTH, GEOMETRY_WIDTH, KIND, TANGENT
from multiarm.dynamics.arrays import row_shapes, row_sizes
from multiarm.dynamics.model import Data, Model
from multiarm.dynamics.solver.node import NodeWork, group_tables, work_shapes
from multiarm.dynamics.solver.singular import CoupledWork, coupled_shapes
from multiarm.jit.simd import aligned_zeros

Shapes = Mapping[str, tuple[int, ...]]
# Constants with an entry for every row.
CONSTANTS = "codes", "geometry", "joint_rows"
# Selections of which all is known that selecting them again needs.
MOST_RECENT = 32


class Room:
    """Memory for arrays of changing shapes, allocated once for the largest ones."""

    def __init__(self, largest: Mapping[str, np.ndarray]) -> None:
        self._memory = {name: array.reshape(-1) for name, array in largest.items()}

    def arrays(self, shapes: Shapes) -> dict[str, np.ndarray]:
        """Arrays of these shapes, at the beginning of the memory, as it is."""
        return {
            name: self._memory[name][: math.prod(shape)].reshape(shape)
            for name, shape in shapes.items()
        }


class Selected(NamedTuple):
    """What some rows make of a Data, apart from the contents of its memory."""

    model: Model
    variables: dict[str, np.ndarray]
    work: NodeWork
    coupled: CoupledWork
    contents: list[tuple[np.ndarray, np.ndarray]]  # arrays, and what they contain
    cache: dict[object, Any]  # of the Data: what is made for these rows stays right for them
    places: np.ndarray  # of the sizes in the struct
    sizes: np.ndarray


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
        self._tables = Room({**constants, **tables, "rows": self.data.work.rows})
        self._variables = _room(self.data.arrays, shapes)
        self._work = _room(self.data.work, work_shapes(self._dofs, rows.tolist()))
        self._coupled = _room(self.data.coupled, coupled_shapes(self._dofs, rows.tolist()))
        self._prepared = lru_cache(MOST_RECENT)(self._prepare)
        self.select(np.zeros(0, dtype=np.int64))

    def select(self, rows: np.ndarray) -> None:
        """Select rows, given in increasing order."""
        data = self.data
        selected = self._prepared(tuple(rows.tolist()))
        # no result of other rows is left; columns of W beyond an arm's rows are zero
        for array in (*selected.variables.values(), selected.work.W):
            array.fill(0.0)
        for array, content in selected.contents:
            array[:] = content
        data.struct[selected.places] = selected.sizes
        data.work.by_arm[0] = 0
        data.take_rows(
            selected.model, selected.variables, selected.work, selected.coupled, selected.cache
        )

    def _prepare(self, rows: tuple[int, ...]) -> Selected:
        data, dofs = self.data, self._dofs
        model = replace(self._full.model.select(rows), unilateral=None)
        constants, counts = model.constants, np.diff(model.layout.rows).tolist()
        tables, size = group_tables(dofs, counts, data.work.levers)
        tables |= {name: getattr(constants, name) for name in CONSTANTS}
        tables["rows"] = np.array(model.layout.rows)
        shapes = {name: table.shape for name, table in tables.items()}
        copies = self._tables.arrays({**shapes, "packs": (size,)})
        variables = self._variables.arrays(row_shapes(constants, model.layout))
        work: dict[str, Any] = self._work.arrays(work_shapes(dofs, counts))
        coupled: dict[str, Any] = self._coupled.arrays(coupled_shapes(dofs, counts))
        contents = [(copies[name], table) for name, table in tables.items()]
        of_model = {name: copies.pop(name) for name in CONSTANTS}
        work |= copies
        return Selected(
            model,
            variables,
            data.work._replace(**work),
            data.coupled._replace(**coupled),
            contents,
            {},
            *row_sizes(of_model, variables, work, coupled),
        )


def _room(arrays: Any, shapes: Shapes) -> Room:
    return Room({name: getattr(arrays, name) for name in shapes})
