"""Files that commands read and write: checked before the long work, written in one step."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from multiarm.errors import MultiarmError
from multiarm.results.files import resolved, target_fault, write_text
from multiarm.terminal.console import print_loaded, print_warnings

if TYPE_CHECKING:
    from multiarm.scene import Scene

PLOTS = ("png", "svg", "pdf")


def check_targets(targets: Mapping[str, Path | None], source: Path | None = None) -> None:
    """Check that every file can be written, before any work is done.

    Parameters
    ----------
    targets : mapping of str to path or None
        Option -> the file that it names; None where it was not given.
    source : path, optional
        The file that the command reads; it is never written to.

    Raises
    ------
    MultiarmError
        A folder is missing or closed, the place is not a file, two options name one file, or
        the ending of a figure's file is no known format.
    """
    plot = targets.get("--plot")
    if plot is not None and plot.suffix.lower().lstrip(".") not in PLOTS:
        raise MultiarmError(f"--plot: '{plot}' ends in none of .{', .'.join(PLOTS)}")
    taken = {} if source is None else {resolved(source): "the file that is read"}
    for option, path in targets.items():
        if path is None:
            continue
        try:
            target = resolved(path)
        except MultiarmError as error:
            raise MultiarmError(f"{option}: {error}") from None
        if target in taken:
            raise MultiarmError(f"{option}: '{path}' is {taken[target]}; name another file")
        taken[target] = f"already written by {option}"
        fault = target_fault(target)
        if fault:
            raise MultiarmError(f"{option}: cannot write '{path}': {fault}")


def refuse_targets(targets: Mapping[str, Path | None], reason: str) -> None:
    """Refuse the options of files that a command would not write, with the reason.

    Raises
    ------
    MultiarmError
        One of them was given.
    """
    for option, path in targets.items():
        if path is not None:
            raise MultiarmError(f"{option}: '{path}' would not be written: {reason}")


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write figures as JSON, complete or not at all.

    Raises
    ------
    MultiarmError
        The file cannot be written.
    """
    from multiarm.results.outcome import plain

    text = json.dumps(plain(data), allow_nan=False, ensure_ascii=False, indent=2)
    write_text(path, text + "\n", "--json")


def scene_to_run(path: Path, no_code: bool) -> Scene:
    """Read a scene to compile, and print which code it names.

    Raises
    ------
    SceneError
        The scene cannot be read; there is code, and ``no_code`` refuses it.
    """
    from multiarm.scene import load_scene, named_code, refuse_code

    scene = load_scene(path, code=not no_code)
    print_warnings(scene.warnings)
    named = named_code(scene)
    if no_code:
        refuse_code(named)
    print_loaded(named)
    return scene
