"""Errors in tests: a test says their class and the places that they name.

Their wording stands in one file, ``tests/data/messages.txt``, into which

    python -m pytest tests/scene --write-messages

writes what the tests of these files see, without what depends on the machine: folders, addresses,
numbers with decimals.
"""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from repository import DATA, ROOT

MESSAGES = DATA / "messages.txt"
SEEN: dict[str, list[str]] = {}
"""Messages that the tests of this process saw, by test; filled when they are to be written."""
WRITING = "MULTIARM_WRITE_MESSAGES"


def _read() -> dict[str, list[str]]:
    stored: dict[str, list[str]] = {}
    _, *parts = re.split(r"^== (.+)\n", MESSAGES.read_text(encoding="utf-8"), flags=re.MULTILINE)
    for test, message in zip(parts[::2], parts[1::2], strict=True):
        stored.setdefault(test, []).append(message.rstrip("\n"))
    return stored


STORED = _read()


@contextmanager
def refused(error: type[Exception], *places: str) -> Iterator[pytest.ExceptionInfo]:
    """The block raises such an error, which names these places in the words of the file."""
    with pytest.raises(error) as caught:
        yield caught
    message = str(caught.value)
    for place in places:
        assert place in message, f"{place!r} is not named in: {message}"
    assert_wording(message)


def assert_wording(message: str) -> None:
    """The file has this message for the test that runs."""
    test = os.environ["PYTEST_CURRENT_TEST"].rpartition(" (")[0].removeprefix("tests/")
    message = _on_any_machine(message)
    if WRITING in os.environ:
        SEEN.setdefault(test, []).append(message)
        return
    expected = STORED.get(test, [])
    remedy = "`python -m pytest FILE --write-messages` writes it"
    assert message in expected, f"{MESSAGES.name} has another wording ({remedy}): {expected}"


def _on_any_machine(message: str) -> str:
    for pattern, text in (
        (r"\S*/(site|dist)-packages/\S*/", "INSTALLED/"),
        (re.escape(str(ROOT)), "ROOT"),  # before the next: it may be in such a folder
        (rf"{re.escape(tempfile.gettempdir())}[-\w./]*/", "FOLDER/"),
        (r"FOLDER/(test_[a-zA-Z_]*)\d+\b", r"FOLDER/\1N"),  # pytest counts them by worker
        (r"0x[0-9a-f]+", "ADDRESS"),
        (r"code_of_(\w+)_[0-9a-f]{8}\b", r"code_of_\1"),
        (r"worker \S+:\d+", "worker HOST:PROCESS"),
        (r"robots are [^;]*", "robots are ..."),  # of the packages that are installed
        (r"\(step \d+\)", "(step N)"),
        (r"-?\d+\.\d+(e[-+]?\d+)?|\d+e-\d+", "0.0"),
    ):
        message = re.sub(pattern, text, message)
    return message


def write_seen(tests: set[str]) -> None:
    """Replace what the file has for some tests, or all those of some files, by what they saw."""
    others = {
        test: texts for test, texts in STORED.items() if not {test, test.partition("::")[0]} & tests
    }
    lines = [
        f"== {test}\n{message}\n"
        for test, messages in sorted((others | SEEN).items())
        for message in dict.fromkeys(messages)
    ]
    MESSAGES.write_text("\n".join(lines), encoding="utf-8")
