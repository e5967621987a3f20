"""Claims about what a notebook shows of results, and about their table for pandas."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pandas
import pytest
from page_reader import Page
from repository import SCENES

import multiarm as ma
from multiarm.viewer import InlineReplay


@pytest.fixture(scope="module")
def system():
    return ma.compile_system(ma.load_scene(SCENES / "two_ur5_box.yaml"))


@pytest.fixture(scope="module")
def run(system):
    return ma.simulate(system, duration=0.1)


def test_tables_of_results_name_what_one_looks_for(system, run):
    grasp = ma.grasp.design_grasp(ma.grasp.Polyhedron.box([1.2, 0.8, 0.6]), gripper_size=0.25)
    shown = {
        system: ["two UR5s carry a box", "20 kg", "6 joints, joined by weld", "joint_pd"],
        ma.evaluate(system): [
            "wrench of right",
            "contact forces of right",
            "rank",
            "12",
            "residuals",
        ],
        run: ["completed", "11, 0 to 0.1 s", "met: estimated error", "largest gap"],
        grasp: ["Grasp", "7 by 2 grippers", "faces"],
        grasp.closure: ["Form closure", grasp.closure.message],
    }
    for thing, words in shown.items():
        text = Page(thing._repr_html_()).text
        assert [word for word in words if word not in text] == [], text


def test_a_system_shows_the_controller_that_drives_it(system):
    shown = Page(system.with_control(lambda t, state: {})._repr_html_()).text
    assert "a function in Python" in shown and "joint_pd" not in shown


def test_names_in_tables_are_text_and_no_markup(system):
    named = ma.compile_system(system.scene.replace(name="<script>alert(1)</script>"))
    assert "<script>" not in named._repr_html_()


def test_a_table_for_pandas_has_every_number_with_its_unit(run):
    table = run.to_pandas()
    assert isinstance(table, pandas.DataFrame) and table.index.name == "time"
    np.testing.assert_array_equal(table.index, run.time)
    columns = [name for name in table if name.startswith("arms/left/joint_position/")]
    np.testing.assert_array_equal(table[columns], run.joint_positions["left"])
    assert len(table.columns) == sum(c.width for c in run.channels.values()) - 1
    units = table.attrs["units"]
    assert set(units) == set(table.columns) and {units[name] for name in columns} == {"rad"}


@pytest.mark.slow
def test_a_notebook_shows_the_replay_below_the_cell(run, monkeypatch, tmp_path):
    session = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=None))
    monkeypatch.setitem(sys.modules, "IPython", session)
    shown = ma.replay(run, meshes=False)
    assert isinstance(shown, InlineReplay)
    written = ma.replay(run, tmp_path / "run.html", meshes=False)
    (frame,) = (value for name, value in Page(shown._repr_html_()).attributes if name == "srcdoc")
    assert frame == shown.page and "two UR5s carry a box" in Page(frame).text
    assert abs(len(frame) / len(written.read_text(encoding="utf-8")) - 1.0) < 0.01
