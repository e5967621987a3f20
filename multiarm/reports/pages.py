"""HTML pages from templates, and how texts are written on them.

A page is one file that loads nothing: its template in ``templates/`` takes in the style sheet.
Templates escape every value that they show, so that a name from a
scene is never markup; only figures, which are drawn here, are put in as they are.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from multiarm.notation import count_of, number, value_text


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
        "number": number,
        "unbroken": unbroken,
        "value_text": value_text,
    }
    return environment


def heading(key: str) -> str:
    """A key as a heading: `wall_time_s` is `Wall time s`."""
    text = key.replace("_", " ")
    return text[:1].upper() + text[1:]


def unbroken(text: str) -> str:
    """The text with hyphens in numbers at which no line is broken: `1e-6`."""
    return re.sub(r"(?<=\de)-(?=\d)", "\N{NON-BREAKING HYPHEN}", text)
