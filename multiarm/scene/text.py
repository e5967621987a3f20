"""YAML text: read from files of any content within bounds, without habits of YAML 1.1 that bite.

Numbers are those of YAML 1.2: ``1e-6`` is one (not text), ``010`` is ten (not eight), ``1:30`` and
``1_0`` are words (not 90 and 10).  ``on`` and ``2024-01-31`` are words too (not true, not a date),
and a key that stands twice in one table is a fault (not a silent loss of the first).  Tags beyond
those of YAML 1.2 (``!!set``, ``!!python/...``) are refused.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from multiarm.errors import SceneError
from multiarm.scene.faults import path_fault, shown

MOST_BYTES = 4_000_000
"""Of a text: some hundred times the longest scene that people write."""
DEEPEST = 50
"""Tables and lists within each other; scenes need ten."""
MOST_VALUES = 1_000_000
"""Of a text, those of an alias counted each time that it stands for them."""
_LONGEST_INTEGER = 400  # characters; floats end at 1e308


def read_text(path: str | os.PathLike, noun: str) -> str:
    """The text of a file that people write, ``noun`` such as "scene".

    Raises
    ------
    SceneError
        When there is none, with the files beside it; when it is no ordinary file, cannot be read,
        is larger than any such file, or is not text.
    """
    fault = path_fault(os.fspath(path))
    if fault:
        raise SceneError(fault)
    file = Path(path).expanduser()
    try:
        status = file.stat()
        if not stat.S_ISREG(status.st_mode):
            what = "a folder" if stat.S_ISDIR(status.st_mode) else "no ordinary file"
            raise SceneError(f"cannot read {path}: it is {what}; name the file of a {noun}")
        if status.st_size > MOST_BYTES:
            raise SceneError(
                f"{path} has {status.st_size:,} bytes; a {noun} has at most {MOST_BYTES:,}: put "
                "long lists of numbers into files of their own"
            )
        return file.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        near = sorted(p.name for p in file.parent.glob("*.y*ml")) if file.parent.is_dir() else []
        also = f"; {noun}s in that folder: {', '.join(near[:8])}" if near else ""
        raise SceneError(f"no {noun} file at {path}{also}") from None
    except UnicodeDecodeError:
        raise SceneError(f"{path} is not a text file; a {noun} is YAML in UTF-8") from None
    except OSError as error:
        raise SceneError(f"cannot read {path}: {error.strerror or error}") from None


def parse_yaml(text: str) -> Any:
    """The content of a YAML text, without the habits above.

    Raises
    ------
    SceneError
        When it is not YAML, a key stands twice, or it exceeds the bounds of this module.
    """
    if len(text) > MOST_BYTES:
        raise SceneError(f"this text has {len(text):,} characters; at most {MOST_BYTES:,} are read")
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        also = "" if isinstance(error, yaml.constructor.ConstructorError) else "; this is not YAML"
        raise SceneError(f"{where}{error.problem or error.context}{also}") from None
    except yaml.reader.ReaderError as error:
        place = f"character {error.position + 1}"
        raise SceneError(
            f"{place}: U+{error.character:04X} cannot stand in a text; this is not YAML"
        ) from None
    except OverflowError:  # an escape such as \UFFFFFFFF
        raise SceneError("an escape '\\U...' names no character; this is not YAML") from None


def written_yaml(data: Any) -> str:
    """Plain data as YAML that :func:`parse_yaml` reads back: short lists and tables on one line."""
    return yaml.dump(
        data,
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=None,
        allow_unicode=True,
        width=100,
    )


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


_TAGS = "tag:yaml.org,2002:"
_MERGE = f"{_TAGS}merge"


class _Loader(yaml.SafeLoader):
    """YAML within bounds: of depth, of what aliases expand to, of numbers and tags."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth, self._values = 0, 0
        self._sizes: dict[yaml.Node, int] = {}  # of nodes with an anchor that are complete

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Refuse what is too deep, too much, or contains itself, before it is made."""
        event, before = self.peek_event(), self._values
        self._depth += 1
        if self._depth > DEEPEST:
            raise _fault(f"tables and lists are more than {DEEPEST} deep here", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, yaml.AliasEvent):
            self._values += 1
            if event.anchor is not None:
                self._sizes[node] = self._values - before
        elif node in self._sizes:
            self._values += self._sizes[node]
        else:
            raise _fault(f"'*{event.anchor}' stands within '&{event.anchor}' itself", event)
        if self._values > MOST_VALUES:
            raise _fault(f"there are more than {MOST_VALUES:,} values, those of '*' counted", event)
        return node

    def construct_mapping(self, node: yaml.Node, deep: bool = False) -> dict:
        """Refuse keys that stand twice."""
        seen: set[Hashable] = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen and key_node.tag != _MERGE:
                raise _fault(f"key {shown(key)} stands twice in one table", key_node)
            seen.add(key if isinstance(key, Hashable) else shown(key))
        return super().construct_mapping(node, deep=deep)

    def construct_merge(self, node: yaml.Node) -> None:
        """Refuse '<<' where there is nothing to take over."""
        raise _fault("'<<' stands for the entries of tables: write '<<: *name'", node)

    def construct_undefined(self, node: yaml.Node) -> None:
        """Refuse a tag that has no meaning here."""
        tag = node.tag.replace(_TAGS, "!!")
        raise _fault(f"the tag {shown(tag)} has no meaning here; leave it out", node)


def _fault(text: str, at: yaml.Node | yaml.Event) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, text, at.start_mark)


def _checked(sort: str, read: Callable[[Any, yaml.Node], Any]) -> Callable[[Any, yaml.Node], Any]:
    """The reader of one sort of values, with a fault at its place where it fails."""

    def construct(loader: _Loader, node: yaml.Node) -> Any:
        if sort == "int" and isinstance(node, yaml.ScalarNode):
            digits = len(node.value)
            if digits > _LONGEST_INTEGER:
                raise _fault(f"a number of {digits:,} digits is beyond all numbers here", node)
        try:
            return read(loader, node)
        except (ValueError, LookupError):
            raise _fault(f"{shown(node.value)} is nothing that '!!{sort}' means", node) from None

    return construct


# The core schema of YAML 1.2, and a sign before hexadecimal and octal digits.
_INTEGER = re.compile(r"[-+]?(?:[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$")
_FLOAT = re.compile(
    r"[-+]?(?:(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|\.(?:inf|Inf|INF))$"
    r"|\.(?:nan|NaN|NAN)$"
)


def _integer(loader: _Loader, node: yaml.Node) -> int:
    text = loader.construct_scalar(node)
    if not _INTEGER.match(text):
        raise ValueError
    return int(text, 16 if "x" in text else 8 if "o" in text else 10)


def _float(loader: _Loader, node: yaml.Node) -> float:
    if not _FLOAT.match(loader.construct_scalar(node)):
        raise ValueError
    return loader.construct_yaml_float(node)


def _table(loader: _Loader, node: yaml.Node) -> Any:
    if not isinstance(node, yaml.MappingNode):
        raise _fault(f"'!!map' stands for a table, not for {shown(node.value)}", node)
    return loader.construct_yaml_map(node)


_Loader.yaml_constructors = {
    f"{_TAGS}map": _table,
    f"{_TAGS}merge": _Loader.construct_merge,
    None: _Loader.construct_undefined,
    f"{_TAGS}int": _checked("int", _integer),
    f"{_TAGS}float": _checked("float", _float),
    f"{_TAGS}bool": _checked("bool", yaml.SafeLoader.construct_yaml_bool),
} | {
    f"{_TAGS}{sort}": yaml.SafeLoader.yaml_constructors[f"{_TAGS}{sort}"]
    for sort in ("null", "str", "seq")
}
# no dates, and of the truth values only those of YAML 1.2
_Loader.yaml_implicit_resolvers = {
    first: [
        (tag, pattern)
        for tag, pattern in known
        if tag not in {f"{_TAGS}{sort}" for sort in ("timestamp", "int", "float")}
        and (first in "tTfF" or tag != f"{_TAGS}bool")
    ]
    for first, known in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


class _Dumper(yaml.SafeDumper):
    """Quotes the words that YAML 1.1 or :class:`_Loader` would read as something else."""


for _kind in (_Loader, _Dumper):  # an integer is also a float: the first pattern counts
    _kind.add_implicit_resolver(f"{_TAGS}int", _INTEGER, list("-+0123456789"))
    _kind.add_implicit_resolver(f"{_TAGS}float", _FLOAT, list("-+.0123456789"))
