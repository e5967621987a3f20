"""HTML pages from templates, and how numbers are written on them.

A page is one file that loads nothing: its template in ``templates/`` takes in the style sheet and,
where there is one, the script.  Templates escape every value that they show, so that a name from a
scene is never markup; only figures, which are drawn here, are put in as they are.
"""

from __future__ import annotations

import json
import re
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from multiarm.plots.style import PREFIXES

NOTHING = "\N{EN DASH}"
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def render(template: str, **values: Any) -> str:
    """The page that a template makes of values.

    Raises
    ------
    jinja2.UndefinedError
        The template names a value that it was not given.
    """
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("multiarm.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "heading": heading,
        "number": number,
        "quantity": quantity,
        "scientific": scientific,
        "thousands": "{:,}".format,
        "unbroken": unbroken,
    }
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False}
    return environment


def quantity(value: float | None, unit: str) -> str:
    """A number of three digits with the prefix that suits it: `quantity(2e-9, "m")` is `2 nm`."""
    if value is None:
        return NOTHING
    value = float(f"{value:.3g}")  # 0.9999 m is 1 m, not 1000 mm
    if value == 0 or abs(value) >= 1e4 or abs(value) < 1e-15:
        return f"{value:.3g} {unit}"
    scale = next(own for own in PREFIXES if own <= 1 and abs(value) >= own)
    return f"{value / scale:.4g} {PREFIXES[scale]}{unit}"


def scientific(value: float | None) -> str:
    """A number of two or three digits, with a power of ten: `2.3×10⁻¹⁴`."""
    if value is None:
        return NOTHING
    if value == 0 or 1e-2 <= abs(value) < 1e4:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    mantissa = mantissa.removesuffix(".0")
    power = power_of_ten(int(exponent))
    return power if mantissa == "1" else f"{mantissa}\N{MULTIPLICATION SIGN}{power}"


def power_of_ten(exponent: int) -> str:
    """`power_of_ten(-14)` is `10⁻¹⁴`."""
    return f"10{str(exponent).translate(_SUPERSCRIPTS)}"


def number(value: Any) -> str:
    """A JSON value as text."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list) and all(isinstance(item, int | float) for item in value):
        return ", ".join(number(item) for item in value)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def heading(key: str) -> str:
    """A key as a heading: `wall_time_s` is `Wall time s`."""
    text = key.replace("_", " ")
    return text[:1].upper() + text[1:]


def unbroken(text: str) -> str:
    """The text with hyphens in numbers at which no line is broken: `1e-6`."""
    return re.sub(r"(?<=\de)-(?=\d)", "\N{NON-BREAKING HYPHEN}", text)
