"""Claims about figures of a sweep: what they draw is what the table says, however many runs."""

from __future__ import annotations

import io
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pandas
import pytest
from refusals import refused

from multiarm.errors import SweepError
from multiarm.plots.sweep_figures import (
    PARTS,
    bands,
    cells,
    sweep_overview,
    variable,
)
from multiarm.sweeps.result import LEVELS

UNITS = {"gap": "m", "force": "N", "never": "J"}
MASSES, DRAGS = [5.0, 10.0, 20.0], [0.01, 0.1, 1.0, 10.0]


def grid_row(run: int):
    """Three masses, four drags, two words and a number at random; gap = mass * drag + noise."""
    rng, k = np.random.default_rng(run), run - 1
    values = {
        "object.mass": MASSES[k % 3], "effects.drag": DRAGS[k // 3 % 4],
        "control.kind": ["$none_", "joint_pd"][k // 12 % 2], "$x.odd_": float(rng.normal()),
    }  # fmt: skip
    gap = values["object.mass"] * values["effects.drag"] * (1.0 + 0.1 * float(rng.normal()))
    return values, gap, -gap, run % 17 != 0


def sweep_of(count, row=grid_row):
    """What a figure takes of a sweep: its path, the names of its columns, and its table."""
    rows = [row(run) for run in range(1, count + 1)]
    paths = list(row(1)[0])
    table = pandas.DataFrame([values for values, *_ in rows], columns=paths)
    done = pandas.Series([row[3] for row in rows], dtype=bool)
    table["status"] = np.where(done, "completed", "failed")
    for name, k in (("gap", 1), ("force", 2)):
        numbers = pandas.Series([row[k] for row in rows], dtype="Float64")
        table[name] = numbers.where(done)
    table["never"] = pandas.Series([pandas.NA] * count, dtype="Float64")
    table.attrs["units"] = UNITS
    return SimpleNamespace(path="s.sweep", paths=paths, quantities=[*UNITS], table=table)


@pytest.fixture(scope="module")
def sweep():
    return sweep_of(600)


def panel_of(figure, x, y):
    (panel,) = [own for own in figure.axes if (own.get_xlabel(), own.get_ylabel()) == (x, y)]
    return panel


def median_line(panel):
    (line,) = [line for line in panel.lines if line.get_label() == "median"]
    return np.array(line.get_xydata())


def test_a_curve_is_the_median_at_each_value_of_a_grid(sweep):
    panel = panel_of(sweep_overview(sweep), "effects.drag", "gap [m]")
    table = sweep.table.dropna(subset="gap")
    expected = [
        (drag, np.median(table.loc[table["effects.drag"] == drag, "gap"].astype(float)))
        for drag in DRAGS
    ]
    np.testing.assert_allclose(median_line(panel), expected, rtol=1e-14)
    assert [label.get_text() for label in panel.get_xticklabels()] == ["0.01", "0.1", "1", "10"]
    assert (panel.get_xscale(), panel.get_yscale()) == ("log", "log")


def test_bands_are_quantiles_of_the_runs_there(sweep):
    table = sweep.table
    axis = variable("object.mass", table["object.mass"].to_numpy())
    places, quantiles = bands(axis, table["gap"].to_numpy(float, na_value=np.nan))
    assert places.tolist() == MASSES
    for mass, band in zip(MASSES, quantiles.to_numpy(), strict=True):
        there = table.loc[table["object.mass"] == mass, "gap"].dropna().astype(float)
        np.testing.assert_allclose(band, np.quantile(there, LEVELS))


def test_a_value_that_always_differs_is_cut_into_parts_of_equally_many_runs(sweep):
    axis = variable("x", sweep.table["$x.odd_"].to_numpy())
    parts = [np.flatnonzero(axis.part == part) for part in np.unique(axis.part)]
    sizes = [len(runs) for runs in parts]
    assert len(sizes) == PARTS and max(sizes) - min(sizes) <= 1
    assert sorted(run for runs in parts for run in runs) == list(range(600))
    ends = [(axis.at[runs].min(), axis.at[runs].max()) for runs in parts]
    assert all(high <= low for (_, high), (low, _) in pairwise(ends))
    panel = panel_of(sweep_overview(sweep), "$x.odd_", "force [N]")
    dots = [line for line in panel.lines if line.get_marker() == "."]
    assert len(dots[0].get_xdata()) == (sweep.table["status"] == "completed").sum()


def test_a_map_shows_the_median_of_every_pair(sweep):
    figure = sweep_overview(sweep)
    maps = [own for own in figure.axes if own.get_ylabel() == "effects.drag"]
    (mesh,) = maps[0].collections
    assert maps[0].get_xticks().tolist() == MASSES and maps[0].get_yticks().tolist() == DRAGS
    runs, table = sweep.table, np.array(mesh.get_array()).reshape(4, 3)
    np.testing.assert_allclose(table, np.outer(DRAGS, MASSES), rtol=0.1)
    for i, drag in enumerate(DRAGS):
        for k, mass in enumerate(MASSES):
            there = runs[(runs["object.mass"] == mass) & (runs["effects.drag"] == drag)]
            assert table[i, k] == there["gap"].dropna().median()
    borders = np.array(mesh.get_coordinates())[:, 0, 1]
    assert all(
        low < drag < high for low, drag, high in zip(borders, DRAGS, borders[1:], strict=False)
    )


def test_a_pair_without_runs_is_empty_and_a_map_without_a_grid_shows_the_runs(sweep):
    x = variable("x", np.array([1.0, 2.0, 2.0]))
    y = variable("y", np.array([1.0, 1.0, 3.0]))
    np.testing.assert_array_equal(
        cells(x, y, np.array([7.0, np.nan, 9.0])), [[7.0, np.nan], [np.nan, 9.0]]
    )
    paths = ("$x.odd_", "object.mass")

    def two(run):
        values, *numbers = grid_row(run)
        return {path: values[path] for path in paths}, *numbers

    figure = sweep_overview(sweep_of(600, two))
    (dots,) = next(own for own in figure.axes if own.get_ylabel() == "object.mass").collections
    assert len(dots.get_offsets()) == (sweep.table["status"] == "completed").sum()


@pytest.mark.slow
def test_the_overview_has_every_quantity_over_every_value_and_a_map(sweep):
    figure = sweep_overview(sweep)
    panels = [panel for panel in figure.axes if panel.get_xlabel()]
    assert len(panels) == 2 * (len(grid_row(1)[0]) + 1), "the third quantity has no number"
    for kind in ("png", "svg", "pdf"):
        figure.savefig(io.BytesIO(), format=kind)


def test_what_cannot_be_drawn_is_said():
    with refused(SweepError, "s.sweep"):
        sweep_overview(sweep_of(0))
    named = sweep_of(60, lambda run: ({"name": f"n{run}"}, *grid_row(run)[1:]))
    with refused(SweepError, "s.sweep"):
        sweep_overview(named)
