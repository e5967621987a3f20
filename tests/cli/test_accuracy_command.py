"""Claims about ``multiarm accuracy``: what it prints, writes and refuses."""

from __future__ import annotations

import math
import re
import sys

import commands
import pytest
from commands import finite_json, promised_keys
from page_reader import Page
from repository import SCENES
from study_samples import sample_accuracy

from multiarm.cli import accuracy as command
from multiarm.studies import work_precision, work_precision_page
from multiarm.studies.reference import QUANTITIES
from multiarm.studies.settings import OURS, Setting
from multiarm.studies.work_precision_page import (
    comparison,
    decade_table,
    point_table,
    recommendation,
    render,
)

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


def test_the_page_has_every_quantity_and_the_ranked_one_first(monkeypatch):
    monkeypatch.setattr(work_precision_page, "inline_svg", lambda *_: "")
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
