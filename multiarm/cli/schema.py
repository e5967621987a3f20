"""``multiarm schema``: what scene and sweep files may hold, for editors and checkers."""

from __future__ import annotations

import json
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from multiarm.cli.files import check_targets
from multiarm.cli.options import file_option, switch
from multiarm.results.files import write_text
from multiarm.terminal.console import print_warnings, print_written


class Sort(str, Enum):
    """The files that have a schema."""

    scene = "scene"
    sweep = "sweep"


def schema(
    sort: Annotated[Sort, typer.Argument(help="The files that it describes.")] = Sort.scene,
    out: Annotated[
        Path | None,
        file_option("Write it to a file.", "FILE.schema.json", default="standard output"),
    ] = None,
    built_in: Annotated[
        bool,
        switch(
            "--built-in",
            "Leave out the effects, joints, surfaces and controls of installed packages.",
        ),
    ] = False,
) -> None:
    """Write the JSON Schema of scenes or sweeps: editors complete, explain and check with it.

    It follows draft 2020-12. Editors with a YAML language server find it by the first line of a
    scene: # yaml-language-server: $schema=scene.schema.json
    """
    check_targets({"--out": out})
    text, faults = schema_text(sort.value, built_in)
    print_warnings(faults)
    if out is None:
        typer.echo(text, nl=False)
        return
    write_text(out, text, "--out")
    print_written("schema", out)


def schema_text(sort: str, built_in: bool = False) -> tuple[str, list[str]]:
    """The schema of a sort of files, and why user classes are not in it."""
    from multiarm.scene import REGISTRIES, Scene
    from multiarm.scene.json_schema import json_schema

    if sort == Sort.sweep.value:
        from multiarm.sweeps.spec import SweepSpec

        schema, faults = json_schema(SweepSpec), []
    else:
        schema = json_schema(Scene, built_in)
        sorts = () if built_in else REGISTRIES
        faults = [fault for registry in sorts for fault in registry.classes()[1]]
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n", faults
