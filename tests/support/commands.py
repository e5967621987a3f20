"""How tests call the commands, and what they read of the answers."""

from __future__ import annotations

import json
import re
import sys
from functools import cache
from pathlib import Path

from typer.main import get_command
from typer.testing import CliRunner, Result

from multiarm.cli import app

MACHINE = {
    "processor": "a <fast> one", "platform": "here", "version": "1", "python": "3",
    "dependencies": {"numpy": "2"}, "created_utc": "2000-01-01",
}  # fmt: skip


@cache
def program():
    """The program with all its commands.

    Typer's own runner builds them at every call, which takes longer than most commands do.
    """
    return get_command(app)


def multiarm(*words: object, columns: int | None = None) -> Result:
    """Call the program in this process, on a terminal of that width."""
    runner, code, exception = CliRunner(), 0, None
    size = {} if columns is None else {"COLUMNS": str(columns)}
    with runner.isolation(env=size) as streams:
        try:
            program().main([str(word) for word in words], prog_name="multiarm")
        except SystemExit as end:
            code = end.code or 0
            exception = end if code else None
        except Exception as error:
            code, exception = 1, error
        sys.stdout.flush()
        sys.stderr.flush()
        out, err, both = (stream.getvalue() for stream in streams)
    return Result(runner, out, err, both, None, code, exception)


def command(name: str, columns: int = 200):
    """A function that calls a command in this process, on a terminal of that width."""

    def call(*words: object) -> Result:
        return multiarm(name, *words, columns=columns)

    return call


def finite_json(text: str):
    """JSON in which every number is finite."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in the JSON")

    return json.loads(text, parse_constant=refuse)


def promised_keys(function) -> set[str]:
    """The keys of its JSON that a command's help names."""
    help_text = re.sub(r"\([^)]*\)", "", function.__doc__)
    promise = re.search(r"The JSON has the keys (.*?)(;|\.\s+Numbers)", help_text, re.S)
    return {*re.split(r"[,\s]+(?:and\s+)?", promise[1].strip())}


def figures(path: Path) -> dict:
    """JSON of a file, in which every number is finite."""
    return finite_json(path.read_text(encoding="utf-8"))
