"""Claims about bad inputs: whatever a program is given, it has one clear answer, and soon."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter

import pytest
from judge_inputs import shortcomings
from malformed_inputs import Case, all_cases
from repository import SUPPORT

SAMPLE = {
    "call": 2, "command line": 3, "command on a stored run": 4, "mesh of a body": 4,
    "mesh of a robot": 6, "mesh of the object": 6, "robot": 2, "scene at random": 2,
    "scene value": 2, "sweep text": 3,
}  # fmt: skip
"""Of these kinds, which take longer, every so many; of the others every one but the heavy ones."""


@pytest.fixture(scope="module")
def by_kind() -> dict[str, list[Case]]:
    cases: dict[str, list[Case]] = {}
    for case in all_cases():
        cases.setdefault(case.kind, []).append(case)
    return {
        kind: [case for case in own if not case.heavy][:: SAMPLE.get(kind, 1)]
        for kind, own in cases.items()
    }


def test_a_name_says_which_input_it_is():
    names = Counter(str(case) for case in all_cases())
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.parametrize("kind", sorted({case.kind for case in all_cases()}))
def test_every_input_has_one_clear_answer(kind, by_kind, tmp_path):
    failed = {}
    for number, case in enumerate(by_kind[kind]):
        folder = tmp_path / str(number)
        folder.mkdir()
        found = shortcomings(case, folder)
        if found:
            failed[str(case)] = found
    assert not failed, "\n".join(f"{name}: {'; '.join(found)}" for name, found in failed.items())


@pytest.mark.slow
def test_an_input_that_could_exhaust_the_machine_is_answered_within_its_limits():
    program = [sys.executable, str(SUPPORT / "judge_inputs.py"), "--heavy"]
    done = subprocess.run(program, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout
