"""What interactive sessions show of public objects: completions, and tables in notebooks."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from xml.etree.ElementTree import Element, SubElement, tostring


def public_names(self: object) -> list[str]:
    """Names without a leading underscore; a class has it as its ``__dir__``."""
    return [name for name in object.__dir__(self) if not name.startswith("_")]


def facts_html(title: str, facts: Mapping[str, object]) -> str:
    """A table of names and facts for a notebook; empty facts are left out."""
    table = Element("table")
    SubElement(table, "caption").text = title
    for name, fact in facts.items():
        if fact != "":
            row = SubElement(table, "tr")
            for tag, text in (("th", name), ("td", fact)):
                SubElement(row, tag, style="text-align: left").text = str(text)
    return tostring(table, encoding="unicode", method="html")


def in_notebook() -> bool:
    """Whether this is the session of a Jupyter notebook, which can show HTML."""
    if "IPython" not in sys.modules:
        return False
    session = sys.modules["IPython"].get_ipython()
    return hasattr(session, "kernel")
