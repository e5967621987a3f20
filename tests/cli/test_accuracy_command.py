"""Claims about ``multiarm accuracy``: what it prints, keeps and refuses; its page in a browser."""

from __future__ import annotations

import copy
import io
import json
import math
import re
import sys

import commands
import numpy as np
import pytest
from commands import finite_json, promised_keys
from page_reader import brightness, shown, sticks_out
from repository import SCENES
from rich.console import Console
from study_samples import sample_accuracy

from multiarm.cli import accuracy as command
from multiarm.notation import number
from multiarm.plots.style import PALETTE
from multiarm.results.files import save_page
from multiarm.studies.peers import PEERS
from multiarm.studies.work_precision import study as studies
from multiarm.studies.work_precision.page import comparison, described, recommendation, render
from multiarm.studies.work_precision.points import (
    BY_ACCURACY,
    OURS,
    Setting,
    our_ladders,
    short,
)
from multiarm.studies.work_precision.results import Results, all_series, decades, read_results
from multiarm.terminal.progress import Progress

accuracy = commands.command("accuracy")
command_module = sys.modules["multiarm.cli.accuracy"]
SCENE = SCENES / "ring_weld.yaml"
# thorough, since what is dominated depends on times
SHORT = (SCENE, "--duration", "0.05", "--no-peers", "--thorough")


@pytest.fixture(scope="module")
def results() -> Results:
    return sample_accuracy()


@pytest.fixture
def study_file(results, tmp_path):
    kept = copy.copy(results)
    kept._path = tmp_path / "study.json"
    kept.write()
    return kept._path


# --- the command ----------------------------------------------------------------------------------


@pytest.fixture
def two_ladders(monkeypatch):
    """The study has two short ladders, first runs by accuracy, and no repetitions."""
    ladders = [
        tuple(Setting(OURS, "rk4", kind, "step", step) for step in (0.01, 0.005))
        for kind in ("projection", "none")
    ]
    monkeypatch.setattr(studies, "our_ladders", lambda *_: ladders)
    monkeypatch.setattr(studies, "REPEATS", 1)
    return ladders


@pytest.mark.slow
def test_a_scene_is_studied_kept_and_drawn(two_ladders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = accuracy(*SHORT, "--html", "page.html", "--plot", "plot.svg", "--json", "figures.json")
    assert result.exit_code == 0, result.output
    assert "For errors below" in result.stdout
    assert "Reference: dop853 at 1e-14; checked by the dense solver" in result.stdout
    kept = read_results(tmp_path / "ring_weld.accuracy.json")
    found = [item.setting for item in kept.points.values() if item.setting.method != BY_ACCURACY]
    assert found[:2] == [ladder[0] for ladder in two_ladders]
    assert {*found[2:]} == {ladder[1] for ladder in two_ladders}
    assert kept.planned is None
    assert "First results" in result.stderr
    assert "A checked reference will replace it" in result.stderr
    assert kept.about["scene"]["duration_s"] == 0.05
    assert "<svg" in (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert "rk4, none" in (tmp_path / "page.html").read_text(encoding="utf-8")
    finite_json((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "figures.json", "page.html", "plot.svg", "ring_weld.accuracy.json",
    ]  # fmt: skip


@pytest.mark.slow
def test_compiled_arms_have_a_study_of_their_own(two_ladders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    used, begin = [], studies.compile_system

    def compiling(scene):
        used.append(begin(scene))
        return used[-1]

    monkeypatch.setattr(studies, "compile_system", compiling)
    for more in ((), ("--arms", "compiled")):
        assert accuracy(*SHORT, *more).exit_code == 0
    assert [set(system.arm_terms.values()) for system in used] == [{"pinocchio"}, {"compiled"}]
    one, other = (
        read_results(tmp_path / f"ring_weld{kind}.accuracy.json") for kind in ("", ".compiled")
    )
    assert one.points.keys() & other.points.keys() >= {
        setting.key for ladder in two_ladders for setting in ladder
    }
    for key in one.points.keys() & other.points.keys():
        point, same = one.points[key], other.points[key]
        if point.setting.method != BY_ACCURACY:  # those are near the digits
            expected = pytest.approx(point.errors["position"], rel=1e-3)
            assert same.errors["position"] == expected


@pytest.mark.slow
def test_a_second_call_measures_nothing_and_redo_measures_anew(two_ladders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert accuracy(*SHORT).exit_code == 0
    first = read_results(tmp_path / "ring_weld.accuracy.json")
    monkeypatch.setattr(studies, "run_ours", None)
    monkeypatch.setattr(studies, "make_reference", None)
    assert accuracy(*SHORT).exit_code == 0
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(studies, "our_ladders", lambda *_: two_ladders)
    monkeypatch.setattr(studies, "REPEATS", 1)
    assert accuracy(*SHORT, "--fresh").exit_code == 0
    again = read_results(tmp_path / "ring_weld.accuracy.json")
    assert {*again.points} >= {s.key for ladder in two_ladders for s in ladder}
    assert [p.wall_time_s for p in again.points.values()] != [
        p.wall_time_s for p in first.points.values()
    ]


@pytest.mark.slow
def test_a_study_of_another_scene_is_kept_unless_it_may_be_replaced(two_ladders, study_file):
    other = (*SHORT, "--out", study_file)
    before = study_file.read_bytes()
    result = accuracy(*other)
    assert result.exit_code == 2
    assert "holds another study (the scene has changed)" in " ".join(result.stderr.split())
    assert study_file.read_bytes() == before
    assert accuracy(*other, "--fresh").exit_code == 0
    assert len(read_results(study_file).points) >= 4 + 2


def test_a_file_that_is_no_study_is_left_alone(tmp_path):
    path = tmp_path / "precious.json"
    path.write_text('{"mine": 1}', encoding="utf-8")
    result = accuracy(SCENE, "--out", path)
    assert result.exit_code == 2
    assert "is not the file of an accuracy study" in result.stderr
    assert path.read_text(encoding="utf-8") == '{"mine": 1}'


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_measured(two_ladders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run, seen = studies.run_ours, []

    def interrupted(system, setting, limit_s):
        seen.append(setting)
        if setting == two_ladders[1][0]:
            raise KeyboardInterrupt
        return run(system, setting, limit_s)

    monkeypatch.setattr(studies, "run_ours", interrupted)
    result = accuracy(*SHORT)
    assert result.exit_code == 1
    kept = read_results(tmp_path / "ring_weld.accuracy.json").points
    assert f"interrupted; {len(kept)} points are in 'ring_weld.accuracy.json'" in result.stderr
    assert two_ladders[0][0].key in kept
    monkeypatch.setattr(studies, "run_ours", run)
    assert accuracy(*SHORT).exit_code == 0
    again = read_results(tmp_path / "ring_weld.accuracy.json")
    assert list(again.points)[: len(kept)] == list(kept)
    assert len(again.points) == len(kept) + 3


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


@pytest.mark.slow
def test_files_are_there_early_and_are_written_again(two_ladders, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command_module, "REWRITE", 0.0)
    monkeypatch.setattr(command_module, "SHARE", math.inf)
    pages, reference = [], studies.make_reference

    def late(*words):
        pages.append((tmp_path / "page.html").read_text(encoding="utf-8"))
        assert (tmp_path / "plot.svg").stat().st_size > 0
        return reference(*words)

    monkeypatch.setattr(studies, "make_reference", late)
    names = ("--html", "page.html", "--plot", "plot.svg")
    assert accuracy(*SHORT, *names).exit_code == 0
    (early,) = pages
    pages.append((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert "First reference: " in early
    assert [bool(re.search(r"\d+ of \d+ points measured", page)) for page in pages] == [True, False]


@pytest.mark.slow
def test_a_study_is_looked_at_without_measuring(study_file, monkeypatch, tmp_path):
    monkeypatch.setattr(studies, "run_study", None)
    result = accuracy("--from", study_file, "--plot", tmp_path / "plot.pdf")
    assert result.exit_code == 0, result.output
    assert "arms & <disc>" in result.stdout
    assert "rk4, projection" in result.stdout
    assert "MuJoCo: not installed: pip install mujoco" in result.stdout
    assert "0.5 s" not in result.stdout, "points are shown on demand"
    assert (tmp_path / "plot.pdf").read_bytes().startswith(b"%PDF")


def test_all_points_are_printed_on_demand(study_file, results):
    result = accuracy("--from", study_file, "--all")
    assert result.exit_code == 0
    for key in results.points:
        assert results.points[key].setting.text in result.stdout
    assert "failed: it went <apart>" in result.stdout


def test_the_table_is_that_of_the_decades(study_file, results):
    stdout = accuracy("--from", study_file).stdout
    for decade in decades(results):
        wall = number(decade.ours.wall_time_s, "s")
        row = (short(decade.level), described(decade.ours), wall)
        assert re.search(r"\s+".join(re.escape(cell) for cell in row), stdout), row


def test_another_quantity_is_ranked_on_demand(study_file, results):
    stdout = accuracy("--from", study_file, "--error", "force").stdout
    assert "contact forces [N]" in stdout
    assert "peer/ours" not in stdout, "no peer tells its forces"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "name a scene to measure, or '--from FILE.json'"),
        ((SCENE, "--from", "x.json"), "name a scene to measure, or '--from FILE.json'"),
        ((SCENE, "--plot", "x.gif"), "--plot: 'x.gif' ends in none of .png, .svg, .pdf"),
        (("--from", "nowhere.json"), "cannot read 'nowhere.json'"),
        ((SCENE, "--html", "nowhere/page.html"), "--html: cannot write"),
        ((SCENE, "--duration", "-1"), "duration"),
    ],
)
def test_bad_input_is_named_before_the_work(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = accuracy(*words)
    assert result.exit_code == 2, result.output
    assert message in " ".join(result.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_help_promises_the_keys_of_the_json(study_file, tmp_path):
    target = tmp_path / "figures.json"
    assert accuracy("--from", study_file, "--json", target).exit_code == 0
    found = finite_json(target.read_text(encoding="utf-8"))
    assert promised_keys(command) == set(found)
    assert found["cheapest"][0]["level"] == 0.1


# --- the page -------------------------------------------------------------------------------------


@pytest.fixture(params=["light", "dark"])
def page(request, browser, results, tmp_path):
    """The page in a browser without a network."""
    target = tmp_path / "page.html"
    save_page(render(results), target)
    with shown(browser, target, request.param) as page:
        yield page


def marks(page, figure: str = "over-time") -> int:
    return page.locator(f"#{figure} circle.hit").count()


@pytest.mark.slow
def test_every_point_with_an_error_has_a_mark_in_both_diagrams(page, results):
    completed = sum(point.completed for point in results.points.values())
    assert marks(page) == marks(page, "over-evaluations") == completed
    best = {decade.ours.setting.key for decade in decades(results)}
    assert page.locator("#over-time circle.best").count() == len(best)


@pytest.mark.slow
def test_marks_are_where_their_numbers_are_on_logarithmic_axes(page, results):
    found = []
    for point in next(x for x in all_series(results) if x.name == "rk4, none").points[1:]:
        mark = page.locator(f'#over-time circle.hit[data-key="{point.setting.key}"]')
        place = [float(mark.get_attribute(name)) for name in ("cx", "cy")]
        found.append([np.log10(point.wall_time_s), np.log10(point.error("motion")), *place])
    found = np.array(found)
    for column, place in ((0, 2), (1, 3)):
        slope = np.diff(found[:, place]) / np.diff(found[:, column])
        assert slope == pytest.approx(np.full(len(slope), slope[0]), rel=1e-6)
    assert slope[0] < 0.0, "small errors are at the bottom"


@pytest.mark.slow
def test_pointing_at_a_mark_tells_its_values(page, results):
    assert not page.locator("#tip").is_visible()
    point = next(x for x in results.points.values() if x.setting.text == "rk4, none, step 0.005 s")
    page.locator(f'#over-time circle.hit[data-key="{point.setting.key}"]').hover(force=True)
    text = page.locator("#tip").inner_text()
    assert text.startswith("rk4, none, step 0.005 s")
    for value in ("1.9×10⁻⁹ m", "1.4 ms", "800", "6.3×10⁻¹¹ m"):  # noqa: RUF001
        assert value in text
    assert page.locator("#over-time g.dim").count() == len(all_series(results)) - 1
    page.mouse.move(5, 5)
    assert not page.locator("#tip").is_visible()
    assert page.locator("#over-time g.dim").count() == 0


@pytest.mark.slow
def test_a_click_in_the_legend_hides_a_method_and_shows_it_again(page, results):
    before = marks(page)
    button = page.locator(".legend button", has_text="rk4, none")
    assert button.get_attribute("aria-pressed") == "true"
    button.click()
    assert button.get_attribute("aria-pressed") == "false"
    assert marks(page) == before - 6
    button.click()
    assert marks(page) == before


@pytest.mark.slow
def test_ours_and_peers_can_be_looked_at_alone(page):
    for which, count in (("ours", 13), ("peers", 6), ("all", 19)):
        page.locator(f"button[data-show={which}]").click()
        assert marks(page) == count


@pytest.mark.slow
def test_another_quantity_redraws_diagram_tables_and_advice(page, results):
    advice = page.locator("p.said:visible").inner_text()
    page.locator("#quantity").select_option("force")
    assert marks(page) == 13, "no peer tells its forces"
    assert page.locator("p.said:visible").count() == 1
    assert page.locator("p.said:visible").inner_text() != advice
    rows = page.locator("div[data-quantity=force]:visible tbody tr").count()
    assert rows == len(decades(results, "force")) + len(all_series(results))


@pytest.mark.slow
def test_nothing_on_the_page_overlaps_or_sticks_out(page):
    assert sticks_out(page) <= 0
    boxes = page.locator("#over-time svg text:not([transform])").all()
    places = [box.bounding_box() for box in boxes]
    for k, one in enumerate(places):
        for other in places[k + 1 :]:
            apart = (
                one["x"] + one["width"] <= other["x"] + 1
                or other["x"] + other["width"] <= one["x"] + 1
                or one["y"] + one["height"] <= other["y"] + 1
                or other["y"] + other["height"] <= one["y"] + 1
            )
            assert apart, (boxes[k].inner_text(), one, other)


@pytest.mark.slow
def test_tables_fit_on_the_page(page):
    tables = page.locator(".scroll:visible").all()
    assert len(tables) == 3, "cheapest, methods, refusals"
    for table in tables:
        assert table.evaluate("e => e.scrollWidth <= e.clientWidth")


def test_the_page_begins_with_the_ranked_quantity_and_says_what_the_terminal_says(results):
    text = render(results, "force")
    assert re.findall(r'<option value="(\w+)" selected>', text) == ["force"]
    assert json.loads(re.search(r'id="data">(.*?)</script>', text, re.S)[1])["quantity"] == "force"
    plain = text.replace("\N{NON-BREAKING HYPHEN}", "-")
    for sentence in (recommendation(results, "motion"), comparison(results, "motion")):
        assert sentence in plain


def test_every_method_and_every_peer_has_a_colour_of_its_own():
    ours = [ladder[0].method for ladder in our_ladders(0.01, 1.0, 0.005)]
    assert len({*ours, *PEERS}) <= len(set(PALETTE)) == len(PALETTE)


@pytest.mark.slow
def test_ink_stands_out_from_the_page(page):
    paper, ink = (
        brightness(page, "section", "backgroundColor"),
        brightness(page, "#over-time text", "fill"),
    )
    assert abs(paper - ink) > 120


def test_names_on_the_page_are_no_markup_and_its_data_are_json(results):
    text = render(results)
    assert "<title>arms &amp; &lt;disc&gt; · multiarm accuracy</title>" in text
    assert "a &lt;fast&gt; one" in text
    assert "it went &lt;apart&gt;" in text
    data = re.search(r'id="data">(.*?)</script>', text, re.S)[1]
    found = finite_json(data)
    assert [item["name"] for item in found["series"]] == [s.name for s in all_series(results)]
