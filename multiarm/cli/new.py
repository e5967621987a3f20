"""``multiarm new``: a commented scene to start from."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from multiarm.cli.files import check_targets
from multiarm.cli.options import FILES, option, switch
from multiarm.cli.schema import schema_text
from multiarm.errors import MultiarmError
from multiarm.results.files import write_text
from multiarm.terminal.console import print_written

SCHEMA = "scene.schema.json"


class Solid(str, Enum):
    """Shapes of the object."""

    box = "box"
    sphere = "sphere"
    cylinder = "cylinder"


def new(
    file: Annotated[
        Path, typer.Argument(help="The scene to be written, a YAML file.", metavar="[FILE]")
    ] = Path("scene.yaml"),
    robot: Annotated[
        list[str] | None,
        option(
            "The robot of one arm, multiarm robots lists them; again for each further arm.",
            "NAME",
            default="two ur5",
        ),
    ] = None,
    joint: Annotated[
        str,
        option(
            "The joint between each arm and the object; multiarm joints shows all kinds.", "KIND"
        ),
    ] = "weld",
    solid: Annotated[Solid, typer.Option("--object", help="The shape of the object.")] = Solid.box,
    force: Annotated[bool, switch("--force", "Replace an earlier file.", FILES)] = False,
) -> None:
    """Write a scene to start from, every line explained, for robots that are installed.

    The arms stand on the floor around the object, hold it at the start, lift it and set it down
    again. The schema of scenes is written beside it, by which editors complete and explain what is
    written there.
    """
    check_targets({"FILE": file})
    if file.exists() and not force:
        raise MultiarmError(f"'{file}' exists; name another file, or replace it with --force")
    from multiarm.problems.first_scene import first_scene

    text = first_scene(robot or ["ur5", "ur5"], joint, solid.value)
    head = f"# yaml-language-server: $schema={SCHEMA}\n# Look at it: multiarm check {file.name}. "
    head += f"Run it: multiarm run {file.name} --replay\n"
    write_text(file, head + text, "FILE")
    print_written("scene", file)
    schema = file.with_name(SCHEMA)
    if force or not schema.exists():
        write_text(schema, schema_text("scene")[0], "FILE")
        print_written("schema", schema)
