"""Rows of a Data that are selected in place are those of a Data that is made for them."""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import arm, scene

import multiarm as ma
from multiarm.contacts.table import JOINT, PAIR, TANGENT, Code
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import evaluate_state, update_kinematics
from multiarm.dynamics.row_selection import RowSelection
from multiarm.dynamics.status import OK
from multiarm.jit.rows import fields_of

HALF = [0.3, 0.2, 0.1]  # [m] of the box


def held_box():
    """A box between two arms, with rows of every kind: 2 arms, stops, friction and the floor."""
    egg = {"ellipsoid": {"center": [0, 0, 0], "semi_axes": [0.03, 0.04, 0.05]}}
    bowl = {"ellipsoid": {"center": [0.35, 0, 0], "semi_axes": [0.05, 0.06, 0.07]}}
    face = {"plane": {"point": [-HALF[0], 0, 0], "normal": [-1, 0, 0]}}
    tips = [
        {"sphere": {"center": [-0.02, y, z], "radius": 0.02}} for y, z in ((0.05, 0.0), (0, 0.05))
    ]
    contacts = {
        "left": [{"arm": tip, "object": face, "mu": 0.5} for tip in tips],
        "right": [{"arm": egg, "object": bowl, "mu": 0.3}],
    }
    arms = {
        "left": arm("xyzXY", base={"xyz": [-0.3, 0, 0.3]}),
        "right": arm("xyzZ", base={"xyz": [0.43, 0, 0.3]}),
    }
    effects = {
        "unilateral_contacts": {"start": "as_written"},
        "joint_limits": {"range": {"left": {"j1": [-0.5, 0.5]}, "right": {"j4": [-1.0, 1.0]}}},
        "joint_friction": {"torque": {"right": {"j2": 1.0}}, "model": "set_valued"},
        "floor": {"mu": 0.4},
    }
    body = {"shape": {"box": [2 * h for h in HALF]}, "mass": 2.0, "pose": {"xyz": [0, 0, 0.3]}}
    return scene(body, arms, contacts, effects)


@pytest.fixture(scope="module")
def full() -> Data:
    system = ma.compile_system(held_box(), assemble=False)
    data = Data(system.model)
    rng = np.random.default_rng(5)
    state = system.initial_state()
    state.velocity[:] = rng.uniform(-1.0, 1.0, state.velocity.size)
    data.set_state(0.0, state)
    assert update_kinematics(data.struct) == OK
    assert {PAIR, TANGENT, JOINT} <= set(fields_of(Code, data.model.constants.contacts.codes).kind)
    return data


def subsets(full: Data, count: int) -> list[np.ndarray]:
    """Rows of random modes, few and many; without the floor some are solved four arms at a time."""
    rng, layout = np.random.default_rng(3), full.model.layout
    ends = layout.surroundings.start, layout.contacts
    return [np.flatnonzero(rng.random(ends[k % 2]) < rng.uniform(0.0, 0.7)) for k in range(count)]


def test_selected_rows_are_those_of_the_table_that_was_packed(full):
    """Directions, gaps, rates and columns of W, tangents without their normal row included."""
    selection, alone = RowSelection(full), 0
    layout = full.model.layout
    bounds, dofs = layout.first_of_block, layout.first_joint_of_block
    for rows in subsets(full, 40):
        selection.select(rows)
        assert update_kinematics(selection.struct) == OK
        codes = fields_of(Code, selection.model.constants.contacts.codes[: len(rows)])
        alone += np.count_nonzero((codes.kind == TANGENT) & (codes.normal_part > 0))
        np.testing.assert_array_equal(selection.arrays.rows.W_o, full.arrays.rows.W_o[rows])
        np.testing.assert_array_equal(
            selection.arrays.rows.kinematics, full.arrays.rows.kinematics[rows]
        )
        for k, row in enumerate(rows):
            i = int(np.searchsorted(bounds, row, side="right")) - 1
            column = selection.work.W[
                i, : dofs[i + 1] - dofs[i], k - selection.work.first_contact[i]
            ]
            expected = full.work.W[i, : dofs[i + 1] - dofs[i], row - bounds[i]]
            np.testing.assert_allclose(column, expected, rtol=1e-14, atol=1e-15)
    assert alone > 0


def test_a_selection_solves_as_data_that_is_made_for_its_rows(full):
    """In any order, bit by bit: nothing of the rows before is left."""
    selection, grouped = RowSelection(full), 0
    for rows in subsets(full, 40):
        selection.select(rows)
        results = []
        for data in (full.view(selection.model), selection):
            assert evaluate_state(data.struct, 2.0, 3.0) == OK
            results.append((data.arrays.accelerations.a.copy(), data.arrays.rows.force.copy()))
        grouped += len(selection.work.groups.group)
        np.testing.assert_array_equal(*(acceleration for acceleration, _ in results))
        np.testing.assert_array_equal(*(force for _, force in results))
    assert grouped > 10


def test_a_selection_keeps_its_struct_and_the_addresses_in_it(full):
    selection = RowSelection(full)
    struct = selection.struct
    addresses = struct[::4].copy()
    for rows in subsets(full, 5):
        selection.select(rows)
        assert selection.struct is struct
        np.testing.assert_array_equal(struct[::4], addresses)


def test_a_selection_whose_geometry_has_moved_has_a_new_model_and_the_same_arrays(full):
    selection, geometry = RowSelection(full), full.model.constants.contacts.geometry
    rows, written = subsets(full, 1)[0], geometry.copy()
    selection.select(rows)
    arrays, before = selection.arrays, selection.model.constants.contacts.geometry.copy()
    try:
        geometry += 0.5
        selection.forget()
        selection.select(rows)
        np.testing.assert_array_equal(selection.model.constants.contacts.geometry, before + 0.5)
        assert selection.arrays is arrays
    finally:
        geometry[:] = written
