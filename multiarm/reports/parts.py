"""Building blocks of HTML pages: numbers with units, tables, inline figures, the style sheet."""

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
    """The figure as inline SVG with unique ids, in the colours of the page's theme."""
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


CSS = """
:root {
  color-scheme: light dark;
  --font: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  --mono: ui-monospace, "SF Mono", "Cascadia Mono", Menlo, Consolas, monospace;
  --page: #f4f6f8; --card: #ffffff; --ink: #2b3440; --soft: #66727f; --line: #e1e6eb;
  --grid: #d9dee5; --good: #1f8a54; --warn: #b7791f; --bad: #c53b3b;
}
@media (prefers-color-scheme: dark) {
  :root {
    --page: #14181d; --card: #1c2229; --ink: #dfe5eb; --soft: #96a3b0; --line: #2d3640;
    --grid: #323c47; --good: #4cc38a; --warn: #e2b04a; --bad: #f07b7b;
  }
  figure svg { filter: brightness(1.25); }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--page); color: var(--ink);
  font: 16px/1.55 var(--font); -webkit-font-smoothing: antialiased;
}
main { max-width: 62rem; margin: 0 auto; padding: 3rem 1.5rem 4rem; }
h1 { font-size: 2.1rem; line-height: 1.2; letter-spacing: -0.02em; margin: 0.2rem 0 0.9rem; }
h2 { font-size: 1.05rem; letter-spacing: -0.005em; margin: 0 0 0.9rem; }
.kicker { margin: 0; color: var(--soft); font-size: 0.85rem; }
header { --tone: var(--good); }
header.interrupted { --tone: var(--warn); }
header.failed { --tone: var(--bad); }
.status { margin: 0; }
.status span {
  display: inline-block; padding: 0.15rem 0.75rem; border-radius: 99px;
  border: 1px solid var(--tone); color: var(--tone); font-weight: 600; font-size: 0.9rem;
}
.status span::before { content: "●"; margin-right: 0.5em; font-size: 0.75em; }
.message {
  margin: 1rem 0 0; padding: 0.1rem 0 0.1rem 1rem; border-left: 3px solid var(--tone);
  white-space: pre-line; overflow-wrap: anywhere;
}
.cards {
  display: grid; grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); gap: 0.8rem;
  list-style: none; margin: 2rem 0 1.6rem; padding: 0;
}
.cards li, section {
  background: var(--card); border: 1px solid var(--line); border-radius: 10px;
}
.cards li { padding: 0.9rem 1rem; }
.cards h2 { margin: 0; font-size: 0.8rem; font-weight: 500; color: var(--soft); }
.cards .value {
  margin: 0.15rem 0 0; font-size: 1.4rem; font-weight: 620; letter-spacing: -0.015em;
  font-variant-numeric: tabular-nums; white-space: nowrap;
}
.cards .note { margin: 0; font-size: 0.8rem; color: var(--soft); overflow-wrap: anywhere; }
section { margin-top: 1rem; padding: 1.3rem 1.5rem; overflow-x: auto; }
figure { margin: 0; overflow-x: auto; }
figure svg { display: block; width: 100%; min-width: 36rem; height: auto; }
figcaption {
  position: sticky; left: 0; margin-top: 0.7rem; font-size: 0.85rem; color: var(--soft);
}
table { border-collapse: collapse; width: 100%; font-size: 0.92rem; }
th, td { padding: 0.4rem 0; border-top: 1px solid var(--line); vertical-align: top; }
tr:first-child > * { border-top: 0; }
th { text-align: left; font-weight: 400; color: var(--soft); padding-right: 2rem; }
td { text-align: right; font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
.grid { margin-top: 1.1rem; }
.grid thead th { text-align: right; font-size: 0.8rem; padding-right: 0; }
.grid thead th:first-child { text-align: left; }
.grid th:not(:first-child), .grid td { padding-left: 1.2rem; }
.grid tbody tr:first-child > * { border-top: 1px solid var(--line); }
.certificate figure { margin-top: 1.1rem; }
.certificate .note { margin: 1rem 0 0; font-size: 0.85rem; color: var(--soft); }
.verdict { --tone: var(--good); }
.verdict.interrupted { --tone: var(--warn); }
section > .note { margin: 0; font-size: 0.85rem; color: var(--soft); }
.events td, .events .grid thead th { text-align: left; }
.events th:first-child { white-space: nowrap; }
.events tr { break-inside: avoid; }
section:has(.events) { break-inside: auto; }
summary { cursor: pointer; font-weight: 600; font-size: 1.05rem; }
pre { margin: 1rem 0 0; font: 0.82rem/1.5 var(--mono); white-space: pre-wrap; }
footer { margin-top: 2rem; color: var(--soft); font-size: 0.8rem; }
footer h2 { font-size: 0.85rem; margin-bottom: 0.4rem; }
footer dl { display: flex; flex-wrap: wrap; gap: 0.2rem 1.6rem; margin: 0; }
footer div { display: flex; gap: 0.5em; }
footer dd { margin: 0; color: var(--ink); overflow-wrap: anywhere; }
@media print {
  :root {
    --page: #fff; --card: #fff; --ink: #1d242c; --soft: #55606b; --line: #d5dbe1;
    --grid: #dfe4e9; --good: #1f8a54; --warn: #96620f; --bad: #b52f2f;
  }
  @page { margin: 14mm; }
  body { font-size: 10.5pt; }
  main { max-width: none; padding: 0; }
  section { border: 0; padding: 0.6rem 0; }
  section, .cards li, tr { break-inside: avoid; }
  section:has(details) { break-inside: auto; }
  figure svg { filter: none; min-width: 0; }
}
"""
