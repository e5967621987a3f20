"""YAML text, without three habits of YAML 1.1 that bite.

``1e-6`` is a number (not text), ``on`` is a word (not true), and a key that stands twice in one
table is a fault (not a silent loss of the first).
"""

from __future__ import annotations

import re
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

import yaml

from multiarm.errors import SceneError


def parse_yaml(text: str) -> Any:
    """The content of a YAML text, without the habits above.

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


def with_values(text: str, values: Mapping[Sequence[str], str]) -> str:
    """A YAML text with other values in tables, its comments and all else as they are.

    Parameters
    ----------
    text : str
    values : mapping
        Keys from the outermost table to the value -> the value as YAML on one line.  The table that
        has the value must be there and have an entry; a key that it lacks is added at its end.

    Raises
    ------
    SceneError
        Where two tables are one by an alias, or a value is taken over from another table.
    """
    root = yaml.compose(text, Loader=_Loader)
    edits: list[tuple[int, int, str]] = []
    tables_at: dict[int, Sequence[str]] = {}
    for (*tables, key), written in values.items():
        node = root
        for name in tables:
            node = _entries(node)[name]
        entries = _entries(node)
        if key in entries:
            old = entries[key]
            edits.append((old.start_mark.index, _end(old), written))
        elif node.flow_style:
            end = node.value[-1][1].end_mark.index
            edits.append((end, end, f", {key}: {written}"))
        else:
            line = text.find("\n", _end(node))
            at = len(text) if line < 0 else line
            edits.append((at, at, f"\n{' ' * node.start_mark.column}{key}: {written}"))
        if tables_at.setdefault(edits[-1][0], tables) != tables:
            raise SceneError("two tables are one by an alias '*'; write them out")
    edits.sort(key=lambda edit: edit[0])
    for begin, end, written in reversed(edits):
        text = text[:begin] + written + text[end:]
    return text


def without_entry(text: str, path: Sequence[str]) -> str:
    """A YAML text without one entry of a table that has others, its comments as they are."""
    *tables, name = path
    node = yaml.compose(text, Loader=_Loader)
    for table in tables:
        node = _entries(node)[table]
    number = next(k for k, (key, _) in enumerate(node.value) if key.value == name)
    key, value = node.value[number]
    begin, end = key.start_mark.index, _end(value)
    if not node.flow_style:
        end += len(text[end:]) - len(text[end:].lstrip(" "))  # to a comment, or to the line's end
        if text[end : end + 1] in ("\n", ""):
            begin, end = text.rfind("\n", 0, begin) + 1, end + 1
    elif number > 0:  # with the comma before it
        begin = _end(node.value[number - 1][1])
    else:
        end = node.value[1][0].start_mark.index
    return text[:begin] + text[end:]


def _end(node: yaml.Node) -> int:
    """Where a value ends; the mark of a block is where the next thing begins."""
    if isinstance(node, yaml.ScalarNode) or node.flow_style or not node.value:
        return node.end_mark.index
    last = node.value[-1]
    return _end(last[1] if isinstance(last, tuple) else last)


def _entries(node: yaml.Node) -> dict[str, yaml.Node]:
    if any(key.tag == _MERGE for key, _ in node.value):
        raise SceneError("a table takes entries over by '<<'; write them out")
    return {key.value: value for key, value in node.value}


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
