"""Tables of the studies as people read them: the same texts on terminals and on pages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import pandas

from multiarm.notation import NOTHING


class TextTable(NamedTuple):
    """A table of texts.

    Attributes
    ----------
    title : str
    kinds : str
        A letter for each column, as the pages' style sheet names them: n number, t text, e remark;
        terminals print remarks below a table.
    heads : tuple of str
        The first column names the rows.
    rows : tuple of tuple of str
    """

    title: str
    kinds: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def text_table(
    title: str, rows: Iterable[Any], kinds: str, columns: Mapping[str, Callable[[Any], str]]
) -> TextTable:
    """The texts of rows; ``columns`` are heads, and what each writes of a row."""
    assert len(kinds) == len(columns), "a kind for each column"
    texts = tuple(tuple(write(row) for write in columns.values()) for row in rows)
    return TextTable(title, kinds, tuple(columns), texts)


def written(value: Any, write: Callable[[Any], str]) -> str:
    """A value of a table as text; a dash where it is missing."""
    return NOTHING if pandas.isna(value) else write(value)


def column(name: str, write: Callable[[Any], str] = str) -> Callable[[Any], str]:
    """What writes an attribute of a row."""
    return lambda row: written(getattr(row, name), write)
