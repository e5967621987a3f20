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
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Any, NoReturn

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
            raise _yaml_error(f"tables and lists are more than {DEEPEST} deep here", event)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, yaml.AliasEvent):
            self._values += 1
            if event.anchor is not None:
                self._sizes[node] = self._values - before
        elif node in self._sizes:
            self._values += self._sizes[node]
        else:
            raise _yaml_error(f"'*{event.anchor}' stands within '&{event.anchor}' itself", event)
        if self._values > MOST_VALUES:
            raise _yaml_error(
                f"there are more than {MOST_VALUES:,} values, those of '*' counted", event
            )
        return node

    def compose_mapping_node(self, anchor: str | None) -> yaml.MappingNode:
        """Refuse keys that stand twice, and put what '<<' takes over among a table's entries.

        Of two entries with one key the table's own counts, then that of the first table named.
        """
        node = super().compose_mapping_node(anchor)
        entries: dict[Hashable, tuple[yaml.Node, yaml.Node]] = {}
        taken_over: dict[Hashable, tuple[yaml.Node, yaml.Node]] = {}
        for key_node, value_node in node.value:
            if key_node.tag == _MERGE:
                several = isinstance(value_node, yaml.SequenceNode)
                for table in value_node.value if several else [value_node]:
                    if not isinstance(table, yaml.MappingNode):
                        self.construct_merge(key_node)
                    for entry in table.value:
                        taken_over.setdefault(self._key(entry[0]), entry)
                continue
            key = self._key(key_node)
            if key in entries:
                raise _yaml_error(f"key {shown(key)} stands twice in one table", key_node)
            entries[key] = key_node, value_node
        node.value = [*{**taken_over, **entries}.values()]
        return node

    def _key(self, node: yaml.Node) -> Hashable:
        key = self.construct_object(node, deep=True)
        if not isinstance(key, Hashable):
            raise _yaml_error(f"a key is a text or a number, got {shown(key)}", node)
        return key

    def construct_merge(self, node: yaml.Node) -> NoReturn:
        """Refuse '<<' where there is nothing to take over."""
        raise _yaml_error("'<<' stands for the entries of tables: write '<<: *name'", node)

    def construct_undefined(self, node: yaml.Node) -> None:
        """Refuse a tag that has no meaning here."""
        tag = node.tag.replace(_TAGS, "!!")
        raise _yaml_error(f"the tag {shown(tag)} has no meaning here; leave it out", node)


def _yaml_error(text: str, at: yaml.Node | yaml.Event) -> yaml.MarkedYAMLError:
    return yaml.constructor.ConstructorError(None, None, text, at.start_mark)


def _checked(sort: str, read: Callable[[Any, yaml.Node], Any]) -> Callable[[Any, yaml.Node], Any]:
    """The reader of one sort of values, with a fault at its place where it fails."""

    def construct(loader: _Loader, node: yaml.Node) -> Any:
        if sort == "int" and isinstance(node, yaml.ScalarNode):
            digits = len(node.value)
            if digits > _LONGEST_INTEGER:
                raise _yaml_error(f"a number of {digits:,} digits is beyond all numbers here", node)
        try:
            return read(loader, node)
        except (ValueError, LookupError):
            raise _yaml_error(
                f"{shown(node.value)} is nothing that '!!{sort}' means", node
            ) from None

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
        raise _yaml_error(f"'!!map' stands for a table, not for {shown(node.value)}", node)
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
