"""Wrenches over time: tables in a scene, or in a file."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec
from multiarm.scene.values import fault, number_list
from multiarm.scene.words import shown

__all__ = ["WrenchTable", "read_wrench_table"]

COLUMNS = ("t", "fx", "fy", "fz", "mx", "my", "mz")
"""Of a file: time [s], force [N], torque [N m]."""


def _times(times: tuple[float, ...] | None) -> tuple[float, ...] | None:
    if times is not None:
        message = time_fault(times)
        if message:
            raise fault(message)
    return times


def time_fault(times: tuple[float, ...]) -> str:
    """What is wrong with the times of a table; empty when nothing is."""
    if len(times) < 2:
        return f"a table needs at least 2 times, got {len(times)}"
    for number, (before, after) in enumerate(pairwise(times), start=2):
        if not after > before:
            return f"times must increase, but row {number} has {after:g} s after {before:g} s"
    return ""


def _numbers(value: Any) -> Any:
    if value is None:
        return None
    value = value.tolist() if hasattr(value, "tolist") else value
    if not isinstance(value, (list, tuple)):
        raise fault(f"must be a list of numbers, got {shown(value)}")
    return tuple(number_list(value))


Numbers = Annotated[tuple[float, ...] | None, BeforeValidator(_numbers)]


class WrenchTable(Spec):
    """Values over time, interpolated smoothly and without overshoot (PCHIP); zero outside.

    Attributes
    ----------
    times : list of numbers, optional
        [s], increasing.
    values : list of numbers, optional
        Factors on ``force`` and ``torque``, one for each time.
    file : path, optional
        Instead of these: a CSV file with the columns t, fx, fy, fz, mx, my, mz ([s], [N], [N m]),
        which is the wrench itself.
    """

    times: Annotated[Numbers, AfterValidator(_times)] = None
    values: Numbers = None
    file: Path | None = None

    @model_validator(mode="after")
    def _one_table(self) -> Self:
        written = (self.times, self.values)
        if self.file is not None and written != (None, None):
            raise fault("gives both 'file' and 'times' or 'values'; keep one of them")
        if self.file is not None:
            return self
        if self.times is None or self.values is None:
            raise fault("needs 'times' and 'values', or a 'file'")
        if len(self.times) != len(self.values):
            raise fault(f"has {len(self.times)} times and {len(self.values)} values; give as many")
        return self


def read_wrench_table(path: Path) -> tuple[list[list[float]], str]:
    """Return the rows of a CSV file of wrenches, 7 numbers each, and what is wrong with it."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return [], f"no file at {path}"
    except UnicodeDecodeError:
        return [], f"{path} is not a text file"
    except OSError as error:
        return [], f"cannot read {path}: {error.strerror}"
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() or (number == 1 and tuple(cells) == COLUMNS):
            continue
        message = _row_fault(cells)
        if message:
            return [], f"{path}, line {number}: {message}"
        rows.append([float(cell) for cell in cells])
    message = time_fault(tuple(row[0] for row in rows))
    return (rows, "") if not message else ([], f"{path}: {message}")


def _row_fault(cells: list[str]) -> str:
    if len(cells) != len(COLUMNS):
        return f"has {len(cells)} columns; they are {', '.join(COLUMNS)}"
    for name, cell in zip(COLUMNS, cells, strict=True):
        try:
            if float(cell) in (float("inf"), -float("inf")) or float(cell) != float(cell):
                raise ValueError
        except ValueError:
            return f"{name} must be a finite number, got {shown(cell)}"
    return ""
