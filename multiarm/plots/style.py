"""Colours and type of all figures, and figures as part of an HTML page."""

from __future__ import annotations

import io
import re
import warnings
from typing import Any

import matplotlib
from matplotlib.figure import Figure

INK, GRID = "#2b3440", "#d9dee5"
"""Colours of text and axes, and of the grid."""
RED, GREEN, BLUE, ORANGE, PINK = "#d1495b", "#2f9e67", "#3b7dd8", "#d9822b", "#c2417c"
"""Colours of lines; they are readable on light and on dark ground."""
AXIS_COLOURS = (RED, GREEN, BLUE)
"""Of x, y and z, as in every viewer."""
PALETTE = (
    BLUE, RED, GREEN, ORANGE, "#8a5cc2", "#0f9aa8", PINK, "#8c7a2b",
    "#5a6b7d", "#a0522d", "#5fa8d3", "#93b83a",
)  # fmt: skip
"""Colours of lines that have no meaning of their own."""
DASHES: tuple[tuple[float, ...], ...] = ((), (5, 1.6), (1.2, 1.4), (6, 1.6, 1.2, 1.6))
"""Dashes of lines that have no meaning of their own: lines of one place are told apart too."""
ROLES = {"kinetic": ORANGE, "potential": BLUE, "work": GREEN, "balance": PINK}
"""Colours of the parts of the energy."""
STYLE: dict[Any, Any] = {
    "axes.edgecolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.5,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlepad": 8,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.formatter.limits": (-4, 5),
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
    "font.family": "sans-serif",
    "font.size": 9,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "lines.solid_joinstyle": "round",
    "text.color": INK,
    "text.usetex": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
}
"""Settings of matplotlib under which all figures are drawn."""


def inline_svg(figure: Figure, prefix: str) -> str:
    """The figure as inline SVG, on no ground and in the colours and the font of the page's theme.

    Parameters
    ----------
    figure : Figure
    prefix : str
        Of all ids in it, so that they are unique on a page.
    """
    buffer = io.StringIO()
    with (
        matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": prefix}),
        warnings.catch_warnings(),
    ):
        # The page's fonts draw the names, whatever their script.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure.savefig(
            buffer, format="svg", facecolor="none", metadata={"Date": None, "Creator": None}
        )
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(\sid="|url\(#|href="#)', rf"\g<1>{prefix}", text)
    text = re.sub(r'(<svg [^>]*?)width="[^"]*" height="[^"]*"', r"\1", text)
    text = re.sub(r"(font: [^;\"]*?)(?:'[^']*'|sans-serif)[^;\"]*", r"\1var(--font)", text)
    return text.replace(INK, "var(--ink)").replace(GRID, "var(--grid)")
