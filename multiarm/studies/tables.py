"""Tables of the studies: one description, from which terminal and pages are both written.

A column says what its values are and how they are written.  A row has values, or cells where a tone
or a note goes with one; a row without numbers ends early, with a remark in their place.

What a study found is shown by its page module: ``texts`` (the tables and lines that a command
prints), ``figure``, ``render`` (the HTML page) and ``figures`` (all numbers, for JSON).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from multiarm.notation import NOTHING

NUMBER, TEXT, REMARK = "n", "t", "e"
"""Kinds of column, as the pages' style sheet names them; terminals print remarks below a table."""


@dataclass(frozen=True)
class Column:
    """A column.

    Attributes
    ----------
    head : str
        In one or two lines.
    kind : {"n", "t", "e"}
        NUMBER, TEXT or REMARK.
    write : callable
        A value as text; texts stay as they are.
    on_page : callable, optional
        The same on a page, where numbers need not be typed again.
    about : str
        What is explained below the table; empty where the head says enough.
    wide : bool
        Only a page has room for it.
    """

    head: str
    kind: str = NUMBER
    write: Callable[[Any], str] = str
    on_page: Callable[[Any], str] | None = None
    about: str = ""
    wide: bool = False


class Cell(NamedTuple):
    """A value with a tone (empty, strong, good, bad or pale) and what a page notes below it."""

    value: Any
    tone: str = ""
    note: str = ""


class Line(NamedTuple):
    """A line of text beside tables, with a tone: strong, warn, pale or verdict."""

    text: str
    tone: str = ""


class Written(NamedTuple):
    """A cell as text, of its column's kind; ``span`` columns wide."""

    text: str
    kind: str
    tone: str = ""
    note: str = ""
    span: int = 1


@dataclass(frozen=True)
class Table:
    """A table and what is to be said about it.

    Attributes
    ----------
    title : str
    columns : tuple of Column
        The first one names the rows.
    rows : tuple of tuple
        Values, None where there is none, and cells.
    remarks : tuple of str
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Any, ...], ...]
    remarks: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the columns are, in one line, and the remarks."""
        about = [f"{column.head}: {column.about}." for column in self.columns if column.about]
        return (*([" ".join(about)] if about else []), *self.remarks)

    def written(self, on_page: bool) -> list[list[Written]]:
        """The cells of all rows as texts, on a page or on a terminal."""
        return [self._written(row, on_page) for row in self.rows]

    def _written(self, row: tuple[Any, ...], on_page: bool) -> list[Written]:
        found, count = [], len(self.columns)
        for k, (value, column) in enumerate(zip(row, self.columns, strict=False), start=1):
            cell = value if isinstance(value, Cell) else Cell(value)
            span = 1 + count - k if k == len(row) else 1
            if column.wide and span == 1 and not on_page:
                continue
            if cell.value is None:
                text = NOTHING
            elif isinstance(cell.value, str):
                text = cell.value
            else:
                text = ((on_page and column.on_page) or column.write)(cell.value)
            kind = column.kind if span == 1 else REMARK
            found.append(Written(text, kind, cell.tone, cell.note, span))
        return found
