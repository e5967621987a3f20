"""Scenes as YAML text: reading with every fault at its place, and writing back.

Three habits of YAML 1.1 that bite are mended on reading: ``1e-6`` is a number (not text), ``on`` is
a word (not true), and a key that stands twice in one table is a fault (not a silent loss of the
first).
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import yaml

from multiarm.errors import SceneError
from multiarm.scene.schema import Scene

__all__ = ["dump_scene", "load_scene", "parse_scene", "parse_yaml"]


def load_scene(path: Path | str, code: bool = True) -> Scene:
    """Read a scene file; nothing that it names is loaded or run.

    Parameters
    ----------
    path : path
        A YAML file. Relative paths in it start at its folder.
    code : bool
        Whether :func:`multiarm.compile_system` may load the functions and effects of packages that
        it names; without, it refuses a scene that names any.

    Returns
    -------
    Scene
        Named after the file if it has no name of its own.

    Raises
    ------
    SceneError
        If the file cannot be read, or naming every fault in it.
    """
    path = Path(path).expanduser()
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise SceneError(f"no scene file at {path}{_neighbours(path)}") from None
    except UnicodeDecodeError:
        raise SceneError(f"{path} is not a text file; a scene is YAML in UTF-8") from None
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror}") from None
    try:
        data = parse_yaml(text)
        if isinstance(data, Mapping):
            data = {"name": path.stem.replace("_", " "), **data}
        return Scene.from_mapping(data, path.resolve().parent, from_file=True, code=code)
    except SceneError as error:
        raise SceneError(error.faults, source=str(path)) from None


def parse_scene(
    source: str | Mapping[str, Any],
    folder: Path | str | None = None,
    stored: bool = False,
    code: bool | None = None,
) -> Scene:
    """Return the scene that a YAML text or a table describes.

    Parameters
    ----------
    source : str or mapping
        The text, or what it stands for.
    folder : path, optional
        Where relative paths start; the current folder by default.
    stored : bool
        It is that of a run, to be looked at: effects of one's own need not be there.
    code : bool, optional
        Whether :func:`multiarm.compile_system` may load the code that it names; not, when left out,
        if it is ``stored``.

    Raises
    ------
    SceneError
        Naming every fault.
    """
    data = parse_yaml(source) if isinstance(source, str) else source
    return Scene.from_mapping(data, folder, stored, code=code)


def dump_scene(scene: Scene) -> str:
    """Return the scene as YAML text with absolute paths; it loads again to an equal scene."""
    data = scene.model_dump(mode="json", exclude_defaults=True)
    # A run that names nothing aims at the default accuracy: write what holds.
    data["run"] = scene.run.model_dump(mode="json", exclude_none=True)
    return yaml.safe_dump(
        data, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100
    )


def parse_yaml(text: str) -> Any:
    """Return what a YAML text stands for, with the habits above.

    Raises
    ------
    SceneError
        When it is not YAML, or a key stands twice.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise SceneError(f"{where}{error.problem or error.context}; this is not YAML") from None
    except yaml.YAMLError as error:
        raise SceneError(f"this is not YAML: {error}") from None


_MERGE, _TRUTH = "tag:yaml.org,2002:merge", "tag:yaml.org,2002:bool"


class _Loader(yaml.SafeLoader):
    """YAML with ``1e-6`` as a number, ``on`` as a word, and without repeated keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """Refuse keys that stand twice."""
        seen: set[Hashable] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen and key_node.tag != _MERGE:
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key!r} stands twice in one table", key_node.start_mark
                )
            seen.add(key if isinstance(key, Hashable) else str(key))
        return super().construct_mapping(node, deep=deep)


# of the truth values, only those of YAML 1.2
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in known if first in "tTfF" or tag != _TRUTH]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?[0-9]+(?:\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def _neighbours(path: Path) -> str:
    found = sorted(p.name for p in path.parent.glob("*.y*ml")) if path.parent.is_dir() else []
    return f"; scenes in that folder: {', '.join(found[:8])}" if found else ""
