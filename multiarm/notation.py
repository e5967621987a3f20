"""How numbers and counts are written for people: on terminals, on pages, in figures, in messages.

Numbers have three digits, or four where several stand together, and their unit; the same number
looks the same everywhere.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from enum import Enum
from numbers import Integral
from typing import Any


class Word(str, Enum):
    """One of some words, which is shown, stored and compared as the word."""

    __str__ = str.__str__
    __repr__ = str.__repr__


NOTHING = "\N{EN DASH}"
"""What stands where there is no number."""
PLAIN = 1e6
"""Numbers below this have no power of ten, unless they are small."""
ROUNDING, LEAST = 1e-9, 1e-12
"""Of several numbers, those below this part of the largest, or below the least, are roundings."""


def number(value: float | None, unit: str = "", digits: int = 3) -> str:
    """A number and its unit: ``2.5e-09 m``, ``1,234 steps``; a dash for None."""
    if value is None:
        return NOTHING
    if isinstance(value, Integral):
        text = f"{value:,}"
    else:
        text = f"{value + 0.0:.{digits}g}"
        if "e+" in text and abs(value) < PLAIN:
            text = f"{float(text):.0f}"
    return f"{text} {unit}".rstrip()


def numbers(
    values: Iterable[float], unit: str = "", digits: int = 4, rounding: float = ROUNDING
) -> str:
    """Comma-separated numbers and their unit: ``0, 0, 9.81 m/s^2``.

    Those below ``rounding`` times the largest, or below ``LEAST``, are written as 0.
    """
    values = [float(value) for value in values]
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    zero = max(rounding * largest, LEAST)
    shown = [0.0 if abs(value) < zero else value for value in values]
    return f"{', '.join(number(value, digits=digits) for value in shown)} {unit}".rstrip()


def short(value: float) -> str:
    """A number as one would type it: ``1e-6``, ``0.0025``."""
    if value and (abs(value) < 1e-3 or abs(value) >= 1e5):
        mantissa, exponent = f"{value:.6e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.7g}"


def count_of(number: int, noun: str, plural: str | None = None) -> str:
    """The number and its noun: ``1 joint``, ``1,234 joints``, ``2 bodies``.

    Parameters
    ----------
    number : int
    noun : str
        In the singular; may have words before it.
    plural : str, optional
        Where it is not the noun with an s.
    """
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def value_text(value: Any) -> str:
    """A value of a JSON file as people write it: ``yes``, ``0.25``, ``left: ur5, right: panda``."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None or isinstance(value, int):
        return number(value)
    if isinstance(value, float):
        return number(value, digits=6)
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {value_text(item)}" for key, item in value.items()) or NOTHING
    if isinstance(value, list | tuple):
        if value and all(isinstance(item, float) for item in value):
            return numbers(value, digits=6)
        return ", ".join(map(value_text, value)) or NOTHING
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
