"""Pictures of a grasp: the body with its contacts, and a face with the region of the last contact.

Both return a matplotlib `Figure` that belongs to no window; save it with `figure.savefig` as PNG,
SVG or PDF.  Each gripper has its colour, in both pictures the same.

The body is seen from far away, so that parallel edges stay parallel: with the azimuth a and the
elevation s of the eye, a point x is drawn at

.. math::  (r \\cdot x, \\; u \\cdot x), \\qquad r = (-\\sin a, \\cos a, 0), \\quad u = e \times r ,

where e is the direction to the eye.  Faces that look away from it are drawn first, then what is on
them, then the faces in front; that is the right order for convex bodies and a fair one for others.
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
from matplotlib.patches import FancyArrowPatch, PathPatch

from multiarm.grasp.seventh_contact import seventh_contact_region
from multiarm.plots.face_figure import draw_face
from multiarm.plots.grasp_theme import DARK, LIGHT, Theme, colours_of, path_of
from multiarm.plots.style import family

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multiarm.grasp.face import Face
    from multiarm.grasp.grasp import Grasp

__all__ = ["draw_face", "draw_grasp"]

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
    """From where a body is seen.

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
    """From where the last contact is best seen, then most of the others."""
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
        style: dict[str, Any] = {"ha": "center", "va": "center", "alpha": strength}
        axes.text(
            beyond[0], beyond[1], str(j + 1), color=colour, fontweight="bold", fontsize=11, **style
        )


def _dress(axes: Axes, grasp: Grasp, theme: Theme) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.autoscale_view()
    keys = [
        Line2D([], [], color=family(k, 1)[0], lw=2, label=_told(gripper.name, gripper.contacts))
        for k, gripper in enumerate(grasp.grippers)
    ]
    axes.legend(
        handles=keys, loc="upper left", bbox_to_anchor=(0.0, 0.0), ncols=len(keys),
        frameon=False, fontsize=9.5, labelcolor=theme.ink,
    )  # fmt: skip
    verdict = "form closure" if grasp.closure else "no form closure"
    axes.set_title(f"{len(grasp.contacts)} contacts: {verdict}")


def _told(name: str, numbers: Sequence[int]) -> str:
    return f"{name}: contacts " + ", ".join(str(j + 1) for j in numbers)
