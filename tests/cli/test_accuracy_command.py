"""Claims about ``multiarm accuracy``: what it prints, writes and refuses."""

from __future__ import annotations

import io
import math
import re
import sys
from dataclasses import replace

import commands
import pytest
from commands import finite_json, promised_keys
from page_reader import Page
from repository import SCENES
from rich.console import Console
from study_samples import sample_accuracy

from multiarm.cli import accuracy as command
from multiarm.plots.style import PALETTE
from multiarm.studies import work_precision, work_precision_page
from multiarm.studies.peers import PEERS
from multiarm.studies.reference import QUANTITIES
from multiarm.studies.settings import OURS, Setting, our_ladders
from multiarm.studies.work_precision_page import (
    comparison,
    decade_table,
    figure,
    figures,
    point_table,
    recommendation,
    render,
)
from multiarm.terminal.progress import Progress

accuracy = commands.command("accuracy")
command_module = sys.modules["multiarm.cli.accuracy"]
SCENE = SCENES / "ring_weld.yaml"
SHORT = (SCENE, "--duration", "0.05", "--no-peers")


@pytest.fixture
def two_ladders(monkeypatch):
    """The study has two short ladders, first runs by accuracy, and no repetitions."""
    ladders = [
        tuple(Setting(OURS, "rk4", kind, "step", step) for step in (0.01, 0.005))
        for kind in ("projection", "none")
    ]
    monkeypatch.setattr(work_precision, "our_ladders", lambda *_: ladders)
    monkeypatch.setattr(work_precision, "REPEATS", 1)
    return ladders


@pytest.mark.slow
def test_a_scene_is_studied_drawn_and_written(two_ladders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command_module, "REWRITE", math.inf)  # one early page, and the last one
    monkeypatch.setattr(work_precision_page, "inline_svg", lambda *_: "<svg></svg>")  # below
    early, make_reference = [], work_precision.make_reference

    def late(*words):
        early.append((tmp_path / "page.html").read_text(encoding="utf-8"))
        return make_reference(*words)

    monkeypatch.setattr(work_precision, "make_reference", late)
    files = ("--html", "page.html", "--plot", "plot.svg", "--json", "figures.json")
    result = accuracy(*SHORT, *files, "--all")
    assert result.exit_code == 0, result.output
    assert "First results" in result.stderr
    assert "A checked reference will replace it" in result.stderr
    assert "Reference: dop853 at 1e-14; checked by the dense solver" in result.stdout
    assert "For errors below" in result.stdout
    written = finite_json((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert promised_keys(command) == set(written)
    assert written["scene"]["duration_s"] == 0.05
    assert not written["left_out"]
    measured = [Setting(**point["setting"]) for point in written["points"]]
    for ladder in two_ladders:
        assert set(ladder) <= set(measured)
        for setting in ladder:
            assert setting.text in result.stdout
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert [bool(re.search(r"\d+ of \d+ points measured", text)) for text in (*early, page)] == [
        True, False,
    ]  # fmt: skip
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {"page.html", "plot.svg", "figures.json"}


@pytest.mark.slow
def test_ctrl_c_prints_and_writes_what_was_measured(two_ladders, tmp_path, monkeypatch):
    run = work_precision.run_ours

    def interrupted(system, setting, limit_s):
        if setting == two_ladders[1][1]:
            raise KeyboardInterrupt
        return run(system, setting, limit_s)

    monkeypatch.setattr(work_precision, "run_ours", interrupted)
    result = accuracy(*SHORT, "--json", tmp_path / "figures.json")
    assert result.exit_code == 1
    written = finite_json((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert written["left_out"]
    count = len(written["points"])
    assert f"interrupted; {count} of {count + 1} points measured" in result.stderr
    assert "For errors below" in result.stdout


def test_a_terminal_shows_the_recommendation_so_far(monkeypatch):
    text = io.StringIO()
    terminal = Console(file=text, force_terminal=True, width=120)
    monkeypatch.setattr("multiarm.terminal.console.messages", lambda: terminal)
    with Progress() as progress:
        progress(3.0, 40.0, "rk4, step 0.01 s")
        progress.note("For errors below 1e-6 take [anything]")
        progress.print("First results")
        progress(4.0, 40.0, "rk4, step 0.005 s")
    shown = text.getvalue()
    assert shown.index("First results") < shown.rindex("rk4, step 0.005 s")
    assert "For errors below 1e-6 take [anything]" in shown[shown.rindex("rk4, step 0.005 s") :]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "Missing argument 'SCENE'"),
        ((SCENE, "--plot", "x.gif"), "--plot: 'x.gif' ends in none of .png, .svg, .pdf"),
        ((SCENE, "--duration", "-1"), "duration"),
    ],
)
def test_bad_input_is_named_before_the_work(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = accuracy(*words)
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_the_page_has_every_quantity_and_the_ranked_one_first():
    study = sample_accuracy()
    page = Page(render(study, "force").replace("\N{NON-BREAKING HYPHEN}", "-"))
    places = [page.text.index(f"Error over work: {about.what}") for about in QUANTITIES.values()]
    assert min(places) == places[list(QUANTITIES).index("force")]
    for name in QUANTITIES:
        for sentence in filter(None, (recommendation(study, name), comparison(study, name))):
            assert sentence in page.text
    for table in (decade_table(study, "motion"), point_table(study)):
        for text in (text for row in table.rows for text in row):
            assert " ".join(text.split()) in page.text


def test_figures_rank_the_quantity_that_is_asked_for():
    study = sample_accuracy()
    assert all(row["peer"] is None for row in figures(study, "force")["cheapest"]), "none tells it"
    first = figures(study)["cheapest"][0]
    assert (first["level"], first["peer"]) == (0.1, "MuJoCo/Euler//step=0.02")


def test_every_method_and_every_peer_has_a_colour_of_its_own():
    ours = [ladder[0].method for ladder in our_ladders(0.01, 1.0, 0.005)]
    assert len({*ours, *PEERS}) <= len(set(PALETTE)) == len(PALETTE)


def test_a_reference_without_digits_has_a_figure_with_a_finite_axis():
    study = sample_accuracy()
    study.reference = replace(study.reference, digits=dict.fromkeys(QUANTITIES, 0.0))
    low, high = figure(study).axes[0].get_ylim()
    assert 0.0 < low < high < 1e3
