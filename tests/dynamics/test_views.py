"""Views of a Data: what they share, and what is their own."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest
from event_scenes import box, on_floor
from repository import SCENES

import multiarm as ma
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import evaluate_state
from multiarm.dynamics.status import OK
from multiarm.dynamics.variables import ALWAYS, ONCE


@pytest.fixture(scope="module")
def system() -> ma.System:
    return ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))


def test_a_view_shares_the_state_and_has_rows_functions_and_results_in_them_of_its_own(system):
    data = Data(system.model)
    alike, some = data.view(system.model), data.view(system.model.select([0, 2, 3]))
    for view in (alike, some):
        assert view.shared is data.shared
        assert view.arrays.state is data.arrays.state and view.arrays.forces is data.arrays.forces
        assert view.arrays.functions is not data.arrays.functions and view.struct is not data.struct
    assert alike.work is data.work and alike.arrays.rows is data.arrays.rows
    assert some.work is not data.work and some.arrays.rows.force.shape == (3,)
    assert some.arrays.sample.forces is some.arrays.rows.force


def test_a_view_with_sampled_control_leaves_the_samples_of_the_data_as_they_are(system):
    data = Data(system.model)
    sampled = system.with_control(lambda t, state: {}, sample_time=0.01)
    view = data.view(sampled.model)
    assert view.arrays.control.sampling.mode == ONCE
    assert data.arrays.control.sampling.mode == ALWAYS
    again = view.view(replace(sampled.model))
    assert again.arrays.control.sampling is view.arrays.control.sampling


def test_an_exception_of_one_view_is_raised_by_every_view_once():
    """As laws are evaluated, and can fail, in data with other rows than those of the run."""
    full = Data(ma.compile_system(on_floor(box(), 0.5, 0.4)).model)
    mode = full.view(replace(full.model.select([0, 1, 2]), unilateral=None))
    for view, failing in ((mode, full.closed), (full, mode), (full.closed, full)):
        failing.callbacks["dense"].error = LookupError("a row")
        with pytest.raises(LookupError, match="a row"):
            view.reraise()
        view.reraise()
    full.closed.callbacks["dense"].error = LookupError("a row")
    mode.forgive()
    full.reraise()


def test_a_view_outlives_the_data_of_which_it_is_one(system):
    """The dense solver, too, has the arrays of the view."""
    dense = system.with_solver("dense")

    def view_of(data: Data) -> Data:
        return data.view(dense.model)

    view, data = view_of(Data(dense.model)), Data(dense.model)
    gc.collect()
    accelerations = []
    for each in (view, data):
        each.set_state(0.0, dense.initial_state())
        assert evaluate_state(each.struct, 0.0, 0.0) == OK
        accelerations.append(each.arrays.accelerations.a.copy())
    np.testing.assert_array_equal(*accelerations)
