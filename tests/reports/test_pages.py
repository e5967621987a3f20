"""Claims about all pages: what a template must be given, what it escapes, where a page fits."""

import ast
import re
from pathlib import Path

import jinja2
import pytest
from page_reader import Page, brightness, shown, sticks_out
from sample_run import record
from study_samples import sample_accuracy, sample_ledger

import multiarm
from multiarm.reports import pages
from multiarm.reports.report import render as run_page
from multiarm.results.sinks import MemorySink
from multiarm.studies.effect_costs_page import render as effects_page
from multiarm.studies.hard_cases import SuiteResult
from multiarm.studies.tables import TextTable
from multiarm.studies.work_precision_page import render as accuracy_page

MARKUP = re.compile(r"</?(a|div|head|html|li|p|script|section|span|style|su[bp]|t[dhr])\b[^<]*>")
SOURCES = [*Path(multiarm.__file__).parent.rglob("*.py")]


@pytest.fixture(scope="module", params=["report", "accuracy", "effects"])
def target(request, tmp_path_factory):
    texts = {
        "report": lambda: run_page(record(MemorySink())),
        "accuracy": lambda: accuracy_page(sample_accuracy()),
        "effects": lambda: effects_page(sample_ledger()),
    }
    path = tmp_path_factory.mktemp("pages") / f"{request.param}.html"
    path.write_text(texts[request.param](), encoding="utf-8")
    return path


@pytest.mark.slow
def test_no_module_has_markup_in_its_strings():
    strings = [
        (path.name, node.value)
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    ]
    assert len(strings) > 1000
    assert [found for found in strings if MARKUP.search(found[1])] == []


def test_values_are_escaped_and_one_that_is_not_given_is_an_error():
    machine = {**sample_ledger().machine, "processor": "a <quiet> machine"}
    given = {"suite": SuiteResult((), machine, 1.0), "cases": [], "simulated_s": 1.0}
    given |= {"overview": TextTable("", (), (), ()), "shown_events": 12}
    assert "a &lt;quiet&gt; machine" in pages.render("stability.html", **given)
    del given["cases"]
    with pytest.raises(jinja2.UndefinedError, match="'cases' is undefined"):
        pages.render("stability.html", **given)


def test_pages_are_whole_and_load_nothing(target):
    page = Page(target.read_text(encoding="utf-8"))
    assert page.sources == []
    assert len(page.ids) > 0
    assert page.tags.count("h1") == 1


@pytest.mark.slow
def test_pages_are_readable_in_light_and_in_the_dark_and_fit_on_screen_telephone_and_paper(
    browser, target
):
    with shown(browser, target) as page:
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            ground = brightness(page, "body", "backgroundColor")
            assert (ground > 128) == (scheme == "light")
            for selector, name in (
                ("body", "color"), ("td", "color"), ("figure svg text", "fill")
            ):  # fmt: skip
                assert abs(ground - brightness(page, selector, name)) > 90, (scheme, selector)
        for width, media in ((1300, "screen"), (400, "screen"), (794, "print")):
            page.set_viewport_size({"width": width, "height": 1000})
            page.emulate_media(media=media)
            assert sticks_out(page) <= 0, (width, media)
