"""Claims about names of anybody's: what steers a terminal or a page never reaches one."""

from __future__ import annotations

import unicodedata
import warnings
from html.parser import HTMLParser
from io import StringIO

import pytest
import yaml
from commands import multiarm
from rich.table import Table
from rich.text import Text
from sample_run import rows_of
from study_samples import sample_accuracy

import multiarm as ma
from multiarm.cli.studies import draw_files
from multiarm.results.files import printable, printable_texts
from multiarm.results.sinks import MemorySink
from multiarm.scene import parse_scene
from multiarm.studies import work_precision_page as accuracy_page
from multiarm.terminal import console as terminal

STEERING = "\x1b[31m\x07\r\x9b2J\x7f\u202e\u2066\u200f\u2028"
MARKUP = "[red] [/] [/nothing] :smile: [link=x]"
SCRIPT = "</script><script>alert(1)</script></title><img src=x onerror=alert(2)>"
HOSTILE = f"name {STEERING} {MARKUP} {SCRIPT} {{{{viewer}}}} $\\bad$ end"
SCENE = {
    "name": HOSTILE,
    "object": {"shape": {"box": [0.8, 0.3, 0.2]}, "mass": 6.0, "pose": {"xyz": [0, 0, 0.9]}},
    "arms": {
        "left": {"robot": "textbook_6r", "base": {"xyz": [-0.9, 0, 0.1]}, "tip": "tool",
                 "posture": [0.1, 0.4, 0.9, 0.0, 0.5, 0.0]},
    },
    "joints": [{"arm": "left", "kind": "weld", "name": HOSTILE}],
    "run": {"duration": 0.02, "step": 0.01, "integrator": "rk4", "output_step": 0.01},
}  # fmt: skip
SWEEP = {"over": {"object.mass": [5.0, 6.0]}, "certificate": False}


def steering(text: str) -> set[str]:
    """What of a text a terminal acts on, or readers do not see."""
    seen = {c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp")}
    return seen - {"\n", "\t"}


def without_breaks(text: str) -> str:
    return "".join(text.split())


NAME = without_breaks(printable(HOSTILE))


def said(*words: object, code: int = 0) -> str:
    """All that the program says on both streams; it ends with this code."""
    result = multiarm(*words, columns=300)
    assert result.exit_code == code, result.output
    text = result.stdout + result.stderr
    assert steering(text) == set()
    return text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder whose name is hostile, with a scene and a sweep."""
    path = tmp_path_factory.mktemp("hostile") / f"{STEERING} {MARKUP}"
    path.mkdir(parents=True)  # a slash is part of it
    (path / "scene.yaml").write_text(yaml.safe_dump(SCENE), encoding="utf-8")
    (path / "sweep.yaml").write_text(yaml.safe_dump(SWEEP), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def foreign(folder):
    """A result whose message and events another program wrote."""
    run = ma.simulate(ma.compile_system(parse_scene(SCENE)))
    sink, channels = MemorySink(), list(run.channels.values())
    sink.open(channels, run.provenance)
    sink.append(rows_of(channels, {name: run.read(name) for name in run.channels}))
    event = {"time": 0.01, "kind": HOSTILE, "text": HOSTILE, "arm": HOSTILE, "contact": HOSTILE}
    made = sink.finish("failed", HOSTILE, {HOSTILE: HOSTILE}, [event])
    return made.save(folder / "foreign.h5")


class Page(HTMLParser):
    """Its tags, and the texts in all but scripts."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[str] = []
        self.words = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)

    def handle_data(self, data):
        if self.tags[-1:] != ["script"]:
            self.words += data


CODES = [0x00, 0x07, 0x0D, 0x1B, 0x7F, 0x85, 0x9B, 0x61C, 0x200F, 0x2028, 0x202E, 0x2066, 0xDCFF]


@pytest.mark.parametrize("code", CODES)
def test_what_steers_is_written_out(code):
    shown = printable(f"a{chr(code)}b")
    assert shown in (f"a\\x{code:02x}b", f"a\\u{code:04x}b", "a\\rb")
    assert printable(shown) == shown


def test_what_does_not_steer_stays():
    text = "Füße, 関節\tx\n\u202f[red] </script> \\x1b 👩\u200d🔧"
    assert printable(text) == text
    assert printable_texts({"a": ("\x1b", [1, None])}) == {"a": ["\\x1b", [1, None]]}


@pytest.mark.slow
def test_check_run_and_sweep_show_a_hostile_scene_as_it_is(folder):
    assert NAME in without_breaks(said("check", folder / "scene.yaml"))
    result = folder / "run.h5"
    assert NAME in without_breaks(said("run", folder / "scene.yaml", "--out", result))
    sweep = folder / "s.sweep"
    words = ("sweep", folder / "scene.yaml", "--over", folder / "sweep.yaml", "--workers", 1)
    assert NAME in without_breaks(said(*words, "--out", sweep))
    page = folder / "replay.html"
    assert printable(str(page)) in said("replay", sweep, "--run", 1, "--html", page)


@pytest.mark.slow
def test_pages_of_a_hostile_result_have_its_names_as_texts_only(folder, foreign):
    report, replay = folder / "report.html", folder / "replay.html"
    assert printable(HOSTILE) in said("report", foreign, "--html", report)
    assert printable(HOSTILE) in said("replay", foreign, "--html", replay)
    shown = Page(report.read_text(encoding="utf-8"))
    assert steering(report.read_text(encoding="utf-8")) == set()
    assert {"script", "img"}.isdisjoint(shown.tags)
    assert shown.words.count(printable(HOSTILE)) >= 4  # title, heading, message, event
    shown = Page(replay.read_text(encoding="utf-8"))
    assert steering(replay.read_text(encoding="utf-8")) == set()
    assert shown.tags.count("script") == 3
    assert "img" not in shown.tags
    assert shown.words.strip().startswith(f"{printable(HOSTILE)}\n")  # the title, and no viewer


@pytest.mark.slow
def test_errors_and_warnings_show_hostile_paths_as_they_are(folder, tmp_path):
    absent = tmp_path / f"{STEERING}{MARKUP}.yaml"
    assert printable(str(absent)) in said("check", absent, code=2)
    assert "unexpected extra argument" in said("check", absent, absent, code=2)
    mesh = {"file": str(tmp_path / f"{STEERING}{MARKUP}.stl")}
    body = {"shape": {"mesh": mesh}, "mass": 6.0, "inertia": [1, 0, 0, 1, 0, 1]}
    scene = {**SCENE, "object": {**SCENE["object"], **body}}
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(scene), encoding="utf-8")
    words = ("run", tmp_path / "scene.yaml", "--out", tmp_path / "run.h5")
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        text = said(*words, "--replay-html", tmp_path / "replay.html")
    assert f"warning: cannot read the object's mesh {printable(mesh['file'])}" in text


def test_a_terminal_gets_no_codes_but_those_of_styles():
    console = terminal._Terminal(force_terminal=True, width=2000, file=StringIO())
    console.print(Text("x", "red"))
    assert console.file.getvalue() == "\x1b[31mx\x1b[0m\n"
    console = terminal._Terminal(
        force_terminal=True, color_system=None, width=2000, file=StringIO()
    )
    table = Table(title=HOSTILE)
    table.add_column(HOSTILE)
    table.add_row(HOSTILE)
    table.add_row(Text(HOSTILE))
    for part in (HOSTILE, Text(HOSTILE), terminal.facts(HOSTILE, {HOSTILE: HOSTILE})):
        console.print(part)
    assert console.file.getvalue().count(f"\\u2028 {MARKUP} {SCRIPT}") == 5
    console.print(table)
    assert steering(console.file.getvalue()) == set()


def test_names_on_a_page_of_a_study_are_no_markup(tmp_path, monkeypatch):
    monkeypatch.setattr(accuracy_page, "inline_svg", lambda *_: "")  # figures have none of them
    study = sample_accuracy()
    study.scene = {**study.scene, "name": HOSTILE, "text": HOSTILE}
    study.refusals = {HOSTILE: HOSTILE}
    draw_files(accuracy_page, study, plot=None, html=tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert steering(text) == set()
    assert Page(text).tags.count("script") == 0
    assert without_breaks(Page(text).words).count(NAME) == 5, "title, heading, program, why, scene"
