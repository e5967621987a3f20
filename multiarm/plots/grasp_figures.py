"""Figures of a grasp: the body with its contacts, and a face with the region of the last contact.

Both functions return a matplotlib `Figure` without a window; save it with `figure.savefig` as PNG,
SVG or PDF.  Each gripper has the same colour in both figures.

The body is drawn in parallel projection: with the azimuth a and the elevation s of the eye, a point
x is drawn at

.. math::  (r \\cdot x, \\; u \\cdot x), \\quad r = (-\\sin a, \\cos a, 0), \\quad u = e \\times r,

where e is the direction to the eye.  Back faces and their contacts are drawn first, then front
faces; that order is right for convex bodies and fair for others.

The region of the last contact is open: its border is drawn as the dashed lines of the half-planes,
extended over the face.  Contacts on the face are dots; the others, projected along its normal, are
rings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch, PathPatch
from matplotlib.path import Path

from multiarm.grasp.seventh_contact import seventh_contact_region
from multiarm.plots.style import GRID, INK, STYLE, family

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multiarm.grasp.contacts import Contacts
    from multiarm.grasp.face import Face
    from multiarm.grasp.grasp import Grasp
    from multiarm.grasp.seventh_contact import ContactRegion


@dataclass(frozen=True)
class Theme:
    """Colours of paper, ink, thin lines, a face and a region."""

    paper: str
    ink: str
    grid: str
    face: str
    region: str

    @property
    def style(self) -> dict[Any, Any]:
        """Settings of matplotlib."""
        inked = [key for key in STYLE if str(STYLE[key]) == INK]
        own = dict.fromkeys(inked, self.ink) | {"axes.grid": False}
        return STYLE | own | {"figure.facecolor": self.paper, "savefig.facecolor": self.paper}


LIGHT = Theme("#ffffff", INK, GRID, "#8fa3b8", "#2f9e67")
DARK = Theme("#151a21", "#e4e8ee", "#3a4450", "#6f87a0", "#46c98b")


def colours_of(count: int, grippers: Sequence[Sequence[int]]) -> list[str]:
    """A colour for each contact: that of its gripper."""
    colours = [family(0, 1)[0]] * count
    for k, numbers in enumerate(grippers):
        for j in numbers:
            if j < count:  # the last contact is not yet among those of a region
                colours[j] = family(k, 1)[0]
    return colours


def path_of(outline: np.ndarray, holes: Sequence[np.ndarray]) -> Path:
    """A path around a polygon (K, 2) and its holes."""
    rings = [Path(np.vstack([ring, ring[:1]]), closed=True) for ring in (outline, *holes)]
    return Path.make_compound_path(*rings)


ELEVATION = 24.0
"""Of the eye over the horizon [deg]."""
ARROW = 0.13
"""Length of the arrow of a contact, in sizes of the body."""
HIDDEN = 0.5
"""Strength of what is behind the body."""
FORESHORTENED = 0.35
"""A face that looks so far toward the eye, as a cosine, is seen well enough."""


@dataclass(frozen=True)
class Eye:
    """The direction from which a body is seen.

    Attributes
    ----------
    axes : ndarray, shape (3, 3)
        Rows: to the right, up, and toward the eye.
    """

    axes: np.ndarray

    @classmethod
    def at(cls, azimuth: float) -> Eye:
        """At an azimuth, in degrees."""
        a, s = np.deg2rad([azimuth, ELEVATION])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        toward = np.array([np.cos(s) * np.cos(a), np.cos(s) * np.sin(a), np.sin(s)])
        return cls(np.array([right, np.cross(toward, right), toward]))

    def places(self, points: Any) -> np.ndarray:
        """Where points (..., 3) are drawn, shape (..., 2)."""
        return np.asarray(points) @ self.axes[:2].T

    def sees(self, face: Face) -> bool:
        """Whether a face looks toward the eye."""
        return bool(face.normal @ self.axes[2] > 0.0)


def draw_grasp(grasp: Grasp, *, regions: bool = True, dark: bool = False) -> Figure:
    """The body with the contacts of all grippers, and the region of the last contact.

    Parameters
    ----------
    grasp : Grasp
    regions : bool
        Show where the last contact may be, given the others.
    dark : bool
        For a dark page.
    """
    theme, eye = DARK if dark else LIGHT, _best_eye(grasp)
    with matplotlib.rc_context(theme.style):
        figure = Figure(figsize=(7.2, 6.2), layout=ConstrainedLayoutEngine(w_pad=0.15, h_pad=0.15))
        axes = figure.add_subplot()
        for front in (False, True):
            _draw_faces(axes, grasp, eye, front, theme)
            if regions:
                _draw_region(axes, grasp, eye, front, theme)
            _draw_edges(axes, grasp, eye, front, theme)
            _draw_contacts(axes, grasp, eye, front, theme)
        _dress(axes, grasp, theme)
    return figure


def _best_eye(grasp: Grasp) -> Eye:
    """The eye that sees the last contact best, then most of the others."""
    outward = -grasp.contacts.normals
    outward = np.vstack([outward, outward[-1:], outward[-1:]])

    def seen(eye: Eye) -> float:
        return float(np.minimum(outward @ eye.axes[2], FORESHORTENED).sum())

    return max((Eye.at(azimuth) for azimuth in np.arange(-178.0, 180.0, 5.0)), key=seen)


def _draw_faces(axes: Axes, grasp: Grasp, eye: Eye, front: bool, theme: Theme) -> None:
    for face in grasp.body.faces:
        if eye.sees(face) == front:
            path = path_of(eye.places(face.vertices), [eye.places(hole) for hole in face.holes])
            light = 0.10 + 0.12 * float(face.normal @ eye.axes[2]) if front else 0.05
            axes.add_patch(PathPatch(path, facecolor=theme.face, alpha=light, lw=0))


def _draw_region(axes: Axes, grasp: Grasp, eye: Eye, front: bool, theme: Theme) -> None:
    face = grasp.body.faces[grasp.faces[-1]]
    if eye.sees(face) != front:
        return
    others = grasp.contacts.subset(range(len(grasp.contacts) - 1))
    region = seventh_contact_region(others, face)
    for outline, holes in zip(region.outlines, region.holes, strict=True):
        path = path_of(eye.places(face.at(outline)), [eye.places(face.at(hole)) for hole in holes])
        strength = 0.38 if front else 0.38 * HIDDEN
        axes.add_patch(PathPatch(path, facecolor=theme.region, alpha=strength, lw=0))


def _draw_edges(axes: Axes, grasp: Grasp, eye: Eye, front: bool, theme: Theme) -> None:
    style: dict[str, Any] = {"color": theme.ink, "solid_capstyle": "round"}
    style |= {"lw": 1.3} if front else {"lw": 0.8, "ls": (0, (4, 3)), "alpha": HIDDEN}
    for (u, v), sides in grasp.body.edges.items():
        if any(eye.sees(grasp.body.faces[k]) for k in sides) == front:
            axes.plot(*eye.places(grasp.body.vertices[[u, v]]).T, **style)


def _draw_contacts(axes: Axes, grasp: Grasp, eye: Eye, front: bool, theme: Theme) -> None:
    """Arrows that end at the contacts, from outside, with their numbers."""
    colours = colours_of(len(grasp.contacts), [g.contacts for g in grasp.grippers])
    back = ARROW * grasp.body.size * grasp.contacts.normals
    for j, (point, colour) in enumerate(zip(grasp.contacts.points, colours, strict=True)):
        if eye.sees(grasp.body.faces[grasp.faces[j]]) != front:
            continue
        tip, tail, beyond = (eye.places(point - s * back[j]) for s in (0.0, 1.0, 1.2))
        strength = 1.0 if front else 0.5 * (1.0 + HIDDEN)
        arrow = FancyArrowPatch(
            tuple(tail), tuple(tip), arrowstyle="-|>", mutation_scale=15 if front else 12,
            color=colour, lw=2.0 if front else 1.4, alpha=strength, shrinkA=0, shrinkB=1.5,
        )  # fmt: skip
        axes.add_patch(arrow)
        axes.plot(*tip, "o", ms=4.5, color=colour, alpha=strength)
        axes.text(
            beyond[0], beyond[1], str(j + 1), color=colour, fontweight="bold", fontsize=11,
            ha="center", va="center", alpha=strength,
        )  # fmt: skip


def _dress(axes: Axes, grasp: Grasp, theme: Theme) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.autoscale_view()
    keys = []
    for k, gripper in enumerate(grasp.grippers):
        numbers = ", ".join(str(j + 1) for j in gripper.contacts)
        label = f"{gripper.name}: contacts {numbers}"
        keys.append(Line2D([], [], color=family(k, 1)[0], lw=2, label=label))
    axes.legend(
        handles=keys, loc="upper left", bbox_to_anchor=(0.0, 0.0), ncols=len(keys),
        frameon=False, fontsize=9.5, labelcolor=theme.ink,
    )  # fmt: skip
    verdict = "form closure" if grasp.closure else "no form closure"
    axes.set_title(f"{len(grasp.contacts)} contacts: {verdict}")


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
        Position of the last contact.  It is marked with the circle in which it may slip, and with
        its least distance D_x from another contact on the face, along the line through both.
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
        path = path_of(face.outline, [face.coordinates(hole) for hole in face.holes])
        axes.add_patch(PathPatch(path, facecolor=theme.face, alpha=0.16, lw=0, zorder=0.5))
        axes.add_patch(PathPatch(path, fill=False, edgecolor=theme.ink, lw=1.1, zorder=2))
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
        _dress_face(axes, region, theme)
    return figure


def _sheet(face: Face) -> tuple[float, float]:
    """Size of the figure [in]: the face's proportions, within limits."""
    wide, high = np.ptp(face.outline, axis=0)
    return 7.0, float(np.clip(6.4 * high / wide + 1.2, 3.0, 8.0))


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
    axes: Axes, face: Face, contacts: Contacts, on: np.ndarray, colours: list[str], theme: Theme
) -> None:
    """Contacts of the face as dots, others on or near it as rings."""
    places = face.coordinates(contacts.points)
    low, high = face.outline.min(axis=0), face.outline.max(axis=0)
    margin = 0.12 * float((high - low).max())
    for j, (place, colour) in enumerate(zip(places, colours, strict=True)):
        if np.any(place < low - margin) or np.any(place > high + margin):
            continue
        if on[j]:
            axes.plot(*place, "o", zorder=4, mfc=colour, mec=theme.paper, ms=9, mew=1.2)
            _name(axes, j + 1, place, fontsize=9.5, fontweight="bold", alpha=1.0)
        else:
            axes.plot(*place, "o", zorder=4, mfc=theme.paper, mec=colour, ms=7, mew=1.2)
            _name(axes, j + 1, place, fontsize=8.5, fontweight="normal", alpha=0.75)


def _name(axes: Axes, number: int, place: np.ndarray, **style: Any) -> None:
    """Write the number of a contact beside its dot."""
    at = tuple(place)
    axes.annotate(str(number), at, (7, 6), textcoords="offset points", zorder=5, **style)


def _last(
    axes: Axes, region: ContactRegion, last: np.ndarray, others: np.ndarray, theme: Theme
) -> None:
    """The last contact, the circle in which it may slip, and D_x from another contact."""
    face = region.face
    place, depth = face.coordinates(last), float(region.depth(last))
    if depth > 0.0:
        axes.add_patch(Circle(tuple(place), depth, fill=False, ec=theme.region, lw=1.2, zorder=3))
    axes.plot(*place, "o", ms=9, mfc=theme.region, mec=theme.paper, mew=1.2, zorder=5)
    _name(axes, region.contacts.count + 1, place, fontweight="bold")
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
    box = {"facecolor": theme.paper, "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
    axes.annotate(
        f"{name} = {length:.4g} m", tuple(0.5 * (start + end) + across), (0, -4),
        textcoords="offset points", ha="center", va="top", bbox=box, zorder=6,
    )  # fmt: skip


def _dress_face(axes: Axes, region: ContactRegion, theme: Theme) -> None:
    low, high = region.face.outline.min(axis=0), region.face.outline.max(axis=0)
    margin = 0.08 * float((high - low).max())
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_xlabel("x in the face [m]")
    axes.set_ylabel("y in the face [m]")
    part = region.area / region.face.area
    share = f"{100 * part:.3g} % of the face" if region else "nowhere: the region is empty"
    number = region.contacts.count + 1
    axes.set_title(f"Where contact {number} closes the grasp on {region.face.name}", pad=20)
    style: dict[str, Any] = {"ha": "left", "va": "bottom", "fontsize": 9, "color": theme.ink}
    axes.text(0.0, 1.01, share, transform=axes.transAxes, alpha=0.8, **style)
