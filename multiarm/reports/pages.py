"""HTML pages from templates, and how numbers are written on them.

A page is one file that loads nothing: its template in ``templates/`` takes in the style sheet and,
where there is one, the script.  Templates escape every value that they show, so that a name from a
scene is never markup; only figures, which are drawn here, are put in as they are.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from multiarm.notation import NOTHING, count_of, number, value_text

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
        "count_of": count_of,
        "heading": heading,
        "number": number,
        "scientific": scientific,
        "thousands": "{:,}".format,
        "unbroken": unbroken,
        "value_text": value_text,
    }
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "ensure_ascii": False}
    return environment


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


def heading(key: str) -> str:
    """A key as a heading: `wall_time_s` is `Wall time s`."""
    text = key.replace("_", " ")
    return text[:1].upper() + text[1:]


def unbroken(text: str) -> str:
    """The text with hyphens in numbers at which no line is broken: `1e-6`."""
    return re.sub(r"(?<=\de)-(?=\d)", "\N{NON-BREAKING HYPHEN}", text)
