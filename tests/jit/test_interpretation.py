"""Claims about interpreted kernels: with NUMBA_DISABLE_JIT=1 they compute what compiled ones do.

The interpreted results are those of another process (``tests/support/both_ways.py``).
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import both_ways
import golden
import pytest
from commands import command
from repository import ROOT, SUPPORT


@pytest.fixture(scope="module")
def interpreted() -> dict:
    """Results of another process, by name."""
    process = subprocess.run(
        [sys.executable, "-W", "error", SUPPORT / "both_ways.py"],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    return dict(json.loads(line) for line in process.stdout.splitlines())


@pytest.fixture(scope="module")
def frozen() -> dict:
    return golden.load()


@pytest.mark.slow
@pytest.mark.parametrize("name", both_ways.COMPUTATIONS)
def test_interpreted_kernels_compute_what_compiled_ones_do(name, interpreted):
    compiled = json.loads(both_ways.as_json(both_ways.COMPUTATIONS[name]()))
    expected = {
        quantity: {"value": value}
        if isinstance(value, (str, int))
        else {"value": value, "tolerance": golden.TOLERANCE}
        for quantity, value in compiled.items()
    }
    outcome = golden.compared(name, expected, interpreted[name])
    assert not outcome.faults, outcome.faults


@pytest.mark.slow
@pytest.mark.parametrize("name", [case.name for case in both_ways.evaluated_cases()])
def test_interpreted_evaluations_are_the_frozen_ones(name, interpreted, frozen):
    """Compiled ones are, too: ``tests/package/test_golden.py``."""
    expected = {
        quantity: entry
        for quantity, entry in frozen[name]["results"].items()
        if not quantity.startswith("run/")
    }
    outcome = golden.compared(name, expected, interpreted[name])
    assert not outcome.faults, outcome.faults


@pytest.mark.slow
@pytest.mark.parametrize("name", ["number_after_the_last", "lanes_after_the_last"])
def test_an_index_out_of_range_raises(name, interpreted):
    assert interpreted[name] == "IndexError"


@pytest.mark.slow
def test_a_debugger_sees_the_lines_of_kernels(interpreted):
    assert all(share > 0.9 for share in interpreted["lines_of_kernels"].values())
    assert len(interpreted["lines_of_kernels"]) == 3


def fenced(text: str, language: str) -> str:
    """The only block of a language in a section of a page."""
    (block,) = re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return block


@pytest.mark.slow
def test_the_debugger_answers_as_the_page_for_contributors_says(tmp_path):
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = page.partition("## Step through a kernel")[2].partition("\n## ")[0]
    script, session = tmp_path / "look.py", fenced(section, "text")
    script.write_text(fenced(section, "python"), encoding="utf-8")
    commands = re.findall(r"^\(Pdb\) (.*)", session, re.MULTILINE)
    process = subprocess.run(
        [sys.executable, "-m", "pdb", script],
        input="".join(f"{command}\n" for command in commands),
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [answer.strip().splitlines() for answer in process.stdout.split("(Pdb) ")]
    lines = [line for answer in answers[1:] for line in answer if line[0] not in ">B"]
    assert lines == [line for line in session.splitlines()[1:] if not line.startswith("(Pdb)")]


def test_warmup_of_interpreted_kernels_is_refused(monkeypatch):
    monkeypatch.setattr("multiarm.jit.interpretation.INTERPRETED", True)
    outcome = command("warmup")()
    assert outcome.exit_code != 0 and "NUMBA_DISABLE_JIT" in outcome.output
