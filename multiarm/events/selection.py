"""A system with some of the rows of another: the same bodies, state and effects, other contacts.

All selections of one system share the arrays of the state, of the bodies' motion and of the joints.
What has a row for every contact they have for themselves, so that each is evaluated, projected and
watched like the system of a scene that has these contacts and no others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multiarm.assembly.system import System
from multiarm.contacts.kernel import CONTACT_WIDTH, RELATIVE_WIDTH
from multiarm.contacts.records import (
    COUNT,
    JOINT,
    KIND,
    LINK,
    PAIR,
    TANGENT,
    ContactTable,
    pack,
)
from multiarm.contacts.surfaces import answering
from multiarm.contacts.unilateral import CompliantContacts
from multiarm.dynamics.arrays import CALL_DENSE, CALL_SURFACE
from multiarm.dynamics.dense_callback import dense_call
from multiarm.dynamics.solver.singular import make_coupled
from multiarm.dynamics.solver.work import make_work
from multiarm.dynamics.state import Layout
from multiarm.jit.pointers import PythonCallback


def select(full: System, chosen: Sequence[int] | np.ndarray) -> System:
    """The system that holds some rows of ``full``, given by their numbers in increasing order."""
    rows = np.array(chosen, dtype=np.int64)
    layout = _layout(full.layout, rows)
    records = [full.records[row] for row in rows]
    contacts = {
        name: [full.contacts[name][row - first] for row in rows if first <= row < last]
        for name, first, last in zip(
            full.layout.names, full.layout.rows[:-1], full.layout.rows[1:], strict=False
        )
    }
    table = pack(records)
    plant = full.plant._replace(
        codes=table.codes,
        geometry=table.geometry,
        shapes=table.shapes,
        joint_rows=joint_rows(table, layout),
        calls=full.plant.calls.copy(),
    )
    buffers = _row_buffers(full, table, len(rows))
    sizes = np.diff(layout.dofs).tolist(), np.diff(layout.rows).tolist()
    work, coupled = make_work(*sizes, list(full.work.levers)), make_coupled(*sizes)
    calls = {
        **full.calls,
        "dense": PythonCallback(dense_call(plant.pointers, buffers, work), buffers.flag),
    }
    plant.calls[CALL_DENSE] = calls["dense"].address
    if table.functions:
        answer = answering(table.functions, buffers.query[RELATIVE_WIDTH:])
        calls["surface"] = PythonCallback(answer, buffers.flag)
        plant.calls[CALL_SURFACE] = calls["surface"].address
    selection = replace(
        full,
        layout=layout,
        contacts=contacts,
        records=tuple(records),
        plant=plant,
        buffers=buffers,
        work=work,
        coupled=coupled,
        calls=calls,
        surfaces=tuple(table.functions),
        _places=np.zeros_like(buffers.places),
    )
    take_places(full, selection, rows)
    return selection


def held_model(system: System) -> System:
    """The system with all contacts of its joints active, as if they were bilateral.

    Friction of contacts, ends of joints' ranges and the surroundings are not in it; joints with dry
    friction move freely.  A system without unilateral constraints is its own model.
    """
    if system.unilateral is None:
        return system
    gone = system.scene.effects.with_events
    every = [replace(p, kernel=None) if p.name in gone else p for p in system.pieces.every]
    effects, phases = replace(system.pieces, every=tuple(every)).program()
    model = select(system, system.unilateral.model)
    plant = model.plant._replace(effects=effects, phases=phases)
    return replace(model, plant=plant, unilateral=None)


def link_springs(full: System, springs: CompliantContacts) -> None:
    """Give the springs of a system their rows, with which all its modes reckon."""
    rows = select(full, springs.rows)
    struct = rows.struct()
    springs.kept[:] = rows, struct
    springs.links[:] = struct.ctypes.data, struct.size


def take_places(full: System, selection: System, rows: np.ndarray) -> None:
    """Let contacts of two surfaces begin their search where those of ``full`` are."""
    for own, row in enumerate(rows):
        code = selection.plant.codes[own]
        if code[KIND] == TANGENT and code[COUNT] > 0:
            normal = selection.plant.codes[code[COUNT]]
            source = full.plant.codes[row - code[LINK]]
        else:
            normal, source = code, full.plant.codes[row]
        if normal[KIND] == PAIR:
            selection.buffers.places[normal[LINK]] = full.buffers.places[source[LINK]]
            selection._places[normal[LINK]] = full._places[source[LINK]]


def joint_rows(table: ContactTable, layout: Layout) -> np.ndarray:
    """``Plant.joint_rows`` of a contact table."""
    found = []
    for row in np.flatnonzero(table.codes[: layout.contacts, KIND] == JOINT):
        arm = int(np.searchsorted(layout.rows, row, side="right")) - 1
        found.append([arm, row, layout.dofs[arm] + table.codes[row, LINK]])
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def _layout(full: Layout, rows: np.ndarray) -> Layout:
    bounds = tuple(int(np.searchsorted(rows, bound)) for bound in full.rows)
    return Layout(full.names, full.dofs, bounds)


def _row_buffers(full: System, table: ContactTable, rows: int):
    shapes, force = table.shapes.shape[0], np.zeros(rows)
    return full.buffers._replace(
        contacts=np.zeros((rows, CONTACT_WIDTH)),
        parts=np.zeros((table.codes.shape[0] - rows, CONTACT_WIDTH)),
        places=np.zeros((shapes, 3)),
        located=np.zeros((shapes, 3)),
        Wo=np.zeros((rows, 6)),
        wrench=np.zeros((6, rows)),
        c=np.zeros(rows),
        force=force,
        shown=force,
        static_force=np.zeros(rows),
    )
