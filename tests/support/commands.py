"""How tests call the commands, and what they read of the answers."""

from __future__ import annotations

import json
import re
from pathlib import Path

from typer.testing import CliRunner

from multiarm.cli import app

MACHINE = {
    "processor": "a <fast> one", "platform": "here", "version": "1", "python": "3",
    "dependencies": {"numpy": "2"}, "created_utc": "2000-01-01",
}  # fmt: skip


def command(name: str, columns: int = 200):
    """A function that calls a command in this process, on a terminal of that width."""

    def call(*words: object):
        runner = CliRunner(env={"COLUMNS": str(columns)})
        return runner.invoke(app, [name, *(str(word) for word in words)])

    return call


def finite_json(text: str):
    """JSON in which every number is finite."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in the JSON")

    return json.loads(text, parse_constant=refuse)


def promised_keys(function) -> set[str]:
    """The keys of its JSON that a command's help names."""
    promise = re.search(r"The JSON has the keys (.*?)(;|\. Numbers)", function.__doc__, re.S)
    return {key.strip() for key in promise[1].split(",")}


def multiarm(*words: object):
    """Call the command line in this process."""
    return CliRunner().invoke(app, [str(word) for word in words])


def figures(path: Path) -> dict:
    """JSON of a file, in which every number is finite."""
    return finite_json(path.read_text(encoding="utf-8"))
