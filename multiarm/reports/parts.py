"""What the parts of a report share: numbers in words and units, figures as inline SVG."""

from __future__ import annotations

import io
import json
import re
import warnings
from collections.abc import Sequence
from html import escape
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from multiarm import plots

NOTHING = "\N{EN DASH}"
_PREFIXES = ((1, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"), (1e-15, "f"))


def quantity(value: float | None, unit: str) -> str:
    """A number of three digits with the prefix that suits it: `quantity(2e-9, "m")` is `2 nm`."""
    if value is None:
        return NOTHING
    value = float(f"{value:.3g}")  # 0.9999 m is 1 m, not 1000 mm
    if value == 0 or abs(value) >= 1e4 or abs(value) < 1e-15:
        return f"{value:.3g} {unit}"
    scale, prefix = next(pair for pair in _PREFIXES if abs(value) >= pair[0])
    return f"{value / scale:.4g} {prefix}{unit}"


def inline_svg(figure: Figure, prefix: str) -> str:
    """The figure as inline SVG: own names for its parts, ink and grid of the page's theme."""
    buffer = io.StringIO()
    with (
        matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": prefix}),
        warnings.catch_warnings(),
    ):
        # The page's fonts draw the names, whatever their script.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(\sid="|url\(#|href="#)', rf"\g<1>{prefix}", text)
    text = re.sub(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"', r"\1", text)
    text = re.sub(r"(font: [^;\"]*?)(?:'[^']*'|sans-serif)[^;\"]*", r"\1var(--font)", text)
    return text.replace(plots.INK, "var(--ink)").replace(plots.GRID, "var(--grid)")


def grid(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table with a heading for each column; empty without rows. All texts are escaped."""
    if not rows:
        return ""
    head = "".join(f"<th scope='col'>{escape(text)}</th>" for text in heads)
    body = "".join(
        f"<tr><th scope='row'>{escape(row[0])}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    )
    return f"<table class='grid'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def words(key: str) -> str:
    """A key as a heading: `wall_time_s` is `Wall time s`."""
    text = key.replace("_", " ")
    return text[:1].upper() + text[1:]


def number(value: Any) -> str:
    """Any value that JSON knows, as a reader wants to see it."""
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
