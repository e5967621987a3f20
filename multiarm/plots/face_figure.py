"""A face in its own coordinates, with the region where the last contact closes the grasp.

The border is not in the region: it is drawn as the dashed lines of the half-planes, which go on
over the face.  Contacts on the face are dots; the others, projected along its normal, are rings.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path

from multiarm.plots.grasp_theme import DARK, LIGHT, Theme, colours_of, path_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multiarm.grasp.contacts import Contacts
    from multiarm.grasp.face import Face
    from multiarm.grasp.seventh_contact import ContactRegion

ON_PLANE = 1e-6
"""A contact is on the plane of a face when it is off by no more than this part of the face."""
STRAIGHT = 1e-6
"""A dimension is along x when its direction is off by no more than this [rad]."""


def draw_face(
    region: ContactRegion,
    contacts: Contacts | None = None,
    *,
    last: Any = None,
    grippers: Sequence[Sequence[int]] = (),
    dark: bool = False,
) -> Figure:
    """A face in its own coordinates, with the region where the last contact closes the grasp.

    Parameters
    ----------
    region : ContactRegion
    contacts : Contacts, optional
        What to mark: contacts on the face as dots, others, projected along its normal, as rings;
        those of the region otherwise.
    last : array-like, shape (3,), optional
        Place of the last contact.  It is marked with the circle in which it may slip, and with its
        least distance D_x from another contact on the face, along the line that joins them.
    grippers : sequence of sequences of int
        Which contacts have a common colour.
    dark : bool
        For a dark page.
    """
    theme, face = DARK if dark else LIGHT, region.face
    marked = region.contacts if contacts is None else contacts
    with matplotlib.rc_context(theme.style):
        figure = Figure(figsize=_sheet(face), layout="constrained")
        axes = figure.add_subplot()
        _fill(axes, path_of(face.outline, [face.coordinates(h) for h in face.holes]), theme)
        for outline, holes in zip(region.outlines, region.holes, strict=True):
            patch = PathPatch(path_of(outline, holes), facecolor=theme.region, alpha=0.3, lw=0)
            axes.add_patch(patch)
        _border_lines(axes, region, theme)
        own = np.abs((marked.points - face.centre) @ face.normal)
        on = own <= ON_PLANE * np.sqrt(face.area)
        on &= marked.normals @ face.normal < 0.0
        _dots(axes, face, marked, on, colours_of(len(marked), grippers), theme)
        if last is not None:
            _last(axes, region, np.asarray(last, dtype=float), marked.points[on], theme)
        _dress(axes, region, theme)
    return figure


def _sheet(face: Face) -> tuple[float, float]:
    """Size of the figure [in]: the face's proportions, within limits."""
    wide, high = np.ptp(face.outline, axis=0)
    return 7.0, float(np.clip(6.4 * high / wide + 1.2, 3.0, 8.0))


def _fill(axes: Axes, path: Path, theme: Theme) -> None:
    axes.add_patch(PathPatch(path, facecolor=theme.face, alpha=0.16, lw=0, zorder=0.5))
    axes.add_patch(PathPatch(path, fill=False, edgecolor=theme.ink, lw=1.1, zorder=2))


def _border_lines(axes: Axes, region: ContactRegion, theme: Theme) -> None:
    """The lines of the half-planes that bound the region, across the face."""
    size = float(np.ptp(region.face.outline, axis=0).max())
    corners = np.vstack([np.empty((0, 2)), *region.outlines])
    for a, b, level in region.half_planes:
        rooms = np.abs(corners @ [a, b] - level)
        if np.sum(rooms <= 1e-9 * size) >= 2:
            at = level * np.array([a, b])
            axes.axline(tuple(at), tuple(at + [-b, a]), color=theme.region, lw=1.1, ls=(0, (5, 3)))


def _dots(
    axes: Axes,
    face: Face,
    contacts: Contacts,
    on: np.ndarray,
    colours: list[str],
    theme: Theme,
) -> None:
    """Contacts of the face as dots, others as rings where they are on or beside it."""
    places = face.coordinates(contacts.points)
    low, high = face.outline.min(axis=0), face.outline.max(axis=0)
    margin = 0.12 * float((high - low).max())
    for j, (place, colour) in enumerate(zip(places, colours, strict=True)):
        if np.any(place < low - margin) or np.any(place > high + margin):
            continue
        fill, edge = (colour, theme.paper) if on[j] else (theme.paper, colour)
        dot: dict[str, Any] = {"mfc": fill, "mec": edge, "ms": 9 if on[j] else 7, "mew": 1.2}
        axes.plot(*place, "o", zorder=4, **dot)
        axes.annotate(
            str(j + 1),
            tuple(place),
            xytext=(7, 6),
            textcoords="offset points",
            fontsize=9.5 if on[j] else 8.5,
            fontweight="bold" if on[j] else "normal",
            alpha=1.0 if on[j] else 0.75,
            zorder=5,
        )


def _last(
    axes: Axes, region: ContactRegion, last: np.ndarray, others: np.ndarray, theme: Theme
) -> None:
    """The last contact, the circle in which it may slip, and D_x from a contact beside it."""
    face = region.face
    place, depth = face.coordinates(last), float(region.depth(last))
    if depth > 0.0:
        axes.add_patch(Circle(tuple(place), depth, fill=False, ec=theme.region, lw=1.2, zorder=3))
    axes.plot(*place, "o", ms=9, mfc=theme.region, mec=theme.paper, mew=1.2, zorder=5)
    number = f"{region.contacts.count + 1}"
    axes.annotate(
        number, tuple(place), xytext=(7, 6), textcoords="offset points", fontweight="bold", zorder=5
    )
    for other in face.coordinates(others)[:1]:
        way = place - other
        bound = _entry(region, other, way / np.linalg.norm(way))
        if bound is not None:
            _dimension(axes, other, other + bound * way / np.linalg.norm(way), bound, theme)


def _entry(region: ContactRegion, start: np.ndarray, way: np.ndarray) -> float | None:
    """Where a ray enters the half-planes of a region, from outside; None if it never does."""
    slopes, levels = region.half_planes[:, :2] @ way, region.half_planes[:, 2]
    rooms = levels - region.half_planes[:, :2] @ start
    entries = [room / slope for room, slope in zip(rooms, slopes, strict=True) if slope < -1e-12]
    return max(entries) if entries and max(entries) > 0.0 else None


def _dimension(axes: Axes, start: np.ndarray, end: np.ndarray, length: float, theme: Theme) -> None:
    """A dimension line below two points: D_x when it is along x."""
    low, high = axes.get_ylim()
    across = np.array([start[1] - end[1], end[0] - start[0]]) / length
    across *= -np.sign(across[1] or 1.0) * 0.05 * (high - low)
    for point in (start, end):
        axes.plot(*np.column_stack([point, point + 1.3 * across]), color=theme.ink, lw=0.6)
    arrow = {"arrowstyle": "<->", "color": theme.ink, "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", tuple(end + across), tuple(start + across), arrowprops=arrow)
    name = "$D_x$" if abs(end[1] - start[1]) <= STRAIGHT * length else "$D$"
    axes.annotate(
        f"{name} = {length:.4g} m",
        tuple(0.5 * (start + end) + across),
        xytext=(0, -4),
        textcoords="offset points",
        ha="center",
        va="top",
        bbox={"facecolor": theme.paper, "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
        zorder=6,
    )


def _dress(axes: Axes, region: ContactRegion, theme: Theme) -> None:
    low, high = region.face.outline.min(axis=0), region.face.outline.max(axis=0)
    margin = 0.08 * float((high - low).max())
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x in the face [m]")
    axes.set_ylabel("y in the face [m]")
    part = region.area / region.face.area
    told = f"{100 * part:.3g} % of the face" if region else "nowhere: the region is empty"
    number = region.contacts.count + 1
    axes.set_title(f"Where contact {number} closes the grasp on {region.face.name}", pad=20)
    style: dict[str, Any] = {"ha": "left", "va": "bottom", "fontsize": 9, "color": theme.ink}
    axes.text(0.0, 1.01, told, transform=axes.transAxes, alpha=0.8, **style)
