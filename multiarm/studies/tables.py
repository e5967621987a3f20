"""Tables of the studies as people read them: the same texts on terminals and on pages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import pandas

from multiarm.notation import NOTHING

TEXT, NUMBER, REMARK = "t", "n", "e"
"""Kinds of columns, as the pages' style sheet names them; terminals print remarks below a table."""


class Column(NamedTuple):
    """A column of a table."""

    head: str
    kind: str  # TEXT, NUMBER, REMARK
    write: Callable[[Any], str]  # its text, of a row


class TextTable(NamedTuple):
    """A table of texts.

    Attributes
    ----------
    title : str
    kinds : tuple of str
        Of each column: TEXT, NUMBER, REMARK.
    heads : tuple of str
        The first column names the rows.
    rows : tuple of tuple of str
    """

    title: str
    kinds: tuple[str, ...]
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def text_table(title: str, rows: Iterable[Any], columns: Sequence[Column]) -> TextTable:
    """The texts of rows."""
    heads, kinds, writers = zip(*columns, strict=True)
    return TextTable(title, kinds, heads, tuple(tuple(w(row) for w in writers) for row in rows))


def written(value: Any, write: Callable[[Any], str]) -> str:
    """A value of a table as text; a dash where it is missing."""
    return NOTHING if pandas.isna(value) else write(value)


def attribute(name: str, write: Callable[[Any], str] = str) -> Callable[[Any], str]:
    """What writes an attribute of a row."""
    return lambda row: written(getattr(row, name), write)
