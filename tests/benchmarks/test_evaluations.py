"""Claims about the benchmark of evaluations, and about what every benchmark writes."""

from __future__ import annotations

import json
import subprocess
import sys

import contact_rows
import evaluations
import numpy as np
import output
import pytest
from repository import ROOT

BENCHMARKS = ROOT / "benchmarks"
TABLES = (
    "evaluations", "hands", "efficiency", "contact_rows", "peer_trials", "drake_peer",
)  # fmt: skip


@pytest.fixture(scope="module")
def costs():
    """Two sizes of one ring, measured once."""
    return evaluations.evaluation_costs((2, 3), ("weld",), rounds=1)


def test_peers_and_ours_have_the_accelerations_of_the_dense_solution(costs):
    for row in costs["rows"]:
        errors = row["relative_error"]
        assert errors["multiarm"] < 1e-11
        assert errors["compiled"] < 1e-11
        assert errors["constraintDynamics"] < 1e-10
        assert errors["tree"] < 1e-10
        assert errors["lcaba"] < 1e-6  # as regularised
        assert set(row["microseconds"]) == set(evaluations.METHODS)


def test_ours_is_compared_with_the_cheapest_peer():
    cost = {
        "multiarm": 2.0, "compiled": 1.5, "constraintDynamics": 12.0, "tree": 9.0, "lcaba": 6.0,
        "terms": 1.0, "dense": 50.0,
    }  # fmt: skip
    assert evaluations.ratio_to_best_peer(cost) == 3.0
    assert evaluations.ratio_to_best_peer(cost, "compiled") == 4.0
    assert evaluations.ratio_to_best_peer({**cost, "lcaba": None}) == 4.5


def test_hinges_are_measured_on_request():
    costs = evaluations.evaluation_costs((2,), ("revolute",), 1)
    assert costs["rows"][0]["relative_error"]["constraintDynamics"] < 1e-6
    assert costs["exponents"]["revolute"]["multiarm"] is None, "one point has no slope"
    assert costs["growth"]["revolute"] is None


def test_what_would_take_all_memory_is_left_out_with_the_reason(monkeypatch):
    monkeypatch.setattr(evaluations, "free_memory", lambda: 1e5)
    (row,) = evaluations.evaluation_costs((2,), ("ball",), 1)["rows"]
    assert row["microseconds"]["lcaba"] is None
    assert row["microseconds"]["multiarm"] > 0.0
    assert row["ratio_to_best_peer"] == {"multiarm": None, "compiled": None}
    assert row["remarks"]["lcaba"].startswith("not run: Pinocchio's Data would take")


def test_memory_is_that_of_the_machine():
    assert evaluations.free_memory() > 1e6
    assert evaluations.too_large_for_pinocchio(12, 1e9) == ""
    assert evaluations.too_large_for_pinocchio(384, 4e9).endswith("3.8 of 4.0 GB free")


@pytest.mark.slow
def test_the_script_writes_its_table_figure_and_numbers(tmp_path):
    names = {kind: tmp_path / f"e.{kind}" for kind in ("csv", "svg", "json")}
    words = ["--arms", "2", "--kind", "ball", "--rounds", "1", "--csv", names["csv"],
             "--figure", names["svg"], "--json", names["json"]]  # fmt: skip
    script = BENCHMARKS / "evaluations.py"
    done = subprocess.run([sys.executable, script, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(names["json"].read_text())
    assert set(numbers) == {"machine", "rounds", "wall_time_s", "waited", "evaluations"}
    (row,) = numbers["evaluations"]["rows"]
    assert (row["kind"], row["arms"]) == ("ball", 2)
    assert names["csv"].read_text().startswith("# ")
    assert names["svg"].read_text().startswith("<?xml")


@pytest.mark.parametrize("words", [("--arms", "1,2"), ("--arms", "2,x"), ("--rounds", "0")])
def test_options_that_cannot_be_meant_are_refused_before_anything_is_measured(words, capsys):
    with pytest.raises(SystemExit):
        evaluations.main(words)
    assert words[0] in capsys.readouterr().err


@pytest.mark.parametrize("name", TABLES)
def test_the_committed_tables_name_their_machine_and_date(name):
    rows, about = output.read(name)
    assert len(rows) > 0
    processor, date, versions = about.split("; ")
    assert "processors" in processor and date.count("-") == 2 and "pin " in versions


def test_every_kind_of_row_has_a_cost():
    costs = contact_rows.measure_rows(rounds=1)
    assert list(costs["row"]) == list(contact_rows.row_kinds())
    assert np.all(costs["microseconds"] > 0.0)
