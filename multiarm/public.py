"""What interactive sessions show of public objects: completions, and tables in notebooks."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from html import escape


def public_names(self: object) -> list[str]:
    """Names without a leading underscore; a class has it as its ``__dir__``."""
    return [name for name in object.__dir__(self) if not name.startswith("_")]


def facts_html(title: str, facts: Mapping[str, object]) -> str:
    """A table of names and facts for a notebook; empty facts are left out."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        f"<td style='text-align:left'>{escape(str(fact))}</td></tr>"
        for name, fact in facts.items()
        if fact != ""
    )
    return f"<table><caption><b>{escape(title)}</b></caption>{rows}</table>"


def in_notebook() -> bool:
    """Whether this is the session of a Jupyter notebook, which can show HTML."""
    if "IPython" not in sys.modules:
        return False
    session = sys.modules["IPython"].get_ipython()
    return hasattr(session, "kernel")
