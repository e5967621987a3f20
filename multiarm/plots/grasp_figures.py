"""The figure of a grasp: the body with its numbered contacts and the region of the last one.

The body is drawn in parallel projection: with the azimuth a and the elevation s of the eye, a point
x is drawn at

.. math::  (r \\cdot x, \\; u \\cdot x), \\quad r = (-\\sin a, \\cos a, 0), \\quad u = e \\times r,

where e is the direction to the eye.  Back faces and their contacts are drawn first, then front
faces; that order is right for convex bodies and fair for others.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, PathPatch
from matplotlib.path import Path

from multiarm.grasp.seventh_contact.contact_region import seventh_contact_region
from multiarm.notation import count_of
from multiarm.plots.style import INK, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from multiarm.grasp.body.face import Face
    from multiarm.grasp.grasp import Grasp


PAPER, FACE, REGION = "#ffffff", "#8fa3b8", "#2f9e67"
"""Colours of the ground, of a face and of the region."""
HUES = (0.579, 0.059, 0.399, 0.859, 0.709, 0.479, 0.969, 0.129)
"""Of the grippers; further ones are shifted a little."""


def colour_of(gripper: int) -> str:
    """The colour of the gripper of some number, and of its contacts."""
    rounds, place = divmod(gripper, len(HUES))
    return to_hex(colorsys.hls_to_rgb((HUES[place] + 0.035 * rounds) % 1, 0.464, 0.66))


def path_of(outline: np.ndarray, holes: Sequence[np.ndarray]) -> Path:
    """A path around a polygon (K, 2) and its holes."""
    rings = [Path(np.vstack([ring, ring[:1]]), closed=True) for ring in (outline, *holes)]
    return Path.make_compound_path(*rings)


ELEVATION = 24.0
"""Of the eye over the horizon [deg]."""
ARROW = 0.13
"""Length of the arrow of a contact, in sizes of the body."""
LETTER = 0.045
"""Room for a number, in sizes of the body."""
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


def draw_grasp(grasp: Grasp) -> Figure:
    """The body with the contacts of all grippers, and where the last one may be, given the others.

    Contacts have their numbers in the grasp, from 1 on.
    """
    eye = _best_eye(grasp)
    style = {"axes.grid": False, "figure.facecolor": PAPER, "savefig.facecolor": PAPER}
    taken: list[np.ndarray] = []
    with matplotlib.rc_context(STYLE | style):
        figure = Figure(figsize=(7.2, 6.2), layout=ConstrainedLayoutEngine(w_pad=0.15, h_pad=0.15))
        axes = figure.add_subplot()
        for front in (False, True):
            _draw_faces(axes, grasp, eye, front)
            _draw_region(axes, grasp, eye, front)
            _draw_edges(axes, grasp, eye, front)
            _draw_contacts(axes, grasp, eye, front, taken)
        _dress(axes, grasp)
    return figure


def _best_eye(grasp: Grasp) -> Eye:
    """The eye that sees the last contact best, then most of the others."""
    outward = -grasp.contacts.normals
    outward = np.vstack([outward, outward[-1:], outward[-1:]])

    def seen(eye: Eye) -> float:
        return float(np.minimum(outward @ eye.axes[2], FORESHORTENED).sum())

    return max((Eye.at(azimuth) for azimuth in np.arange(-178.0, 180.0, 5.0)), key=seen)


def _draw_faces(axes: Axes, grasp: Grasp, eye: Eye, front: bool) -> None:
    for face in grasp.body.faces:
        if eye.sees(face) == front:
            path = path_of(eye.places(face.vertices), [eye.places(hole) for hole in face.holes])
            light = 0.10 + 0.12 * float(face.normal @ eye.axes[2]) if front else 0.05
            axes.add_patch(PathPatch(path, facecolor=FACE, alpha=light, lw=0))


def _draw_region(axes: Axes, grasp: Grasp, eye: Eye, front: bool) -> None:
    face = grasp.body.faces[grasp.faces[-1]]
    if eye.sees(face) != front:
        return
    six_contacts = grasp.contacts.subset(range(len(grasp.contacts) - 1))
    region = seventh_contact_region(six_contacts, face)
    for outline, holes in zip(region.outlines, region.holes, strict=True):
        path = path_of(eye.places(face.at(outline)), [eye.places(face.at(hole)) for hole in holes])
        strength = 0.38 if front else 0.38 * HIDDEN
        axes.add_patch(PathPatch(path, facecolor=REGION, alpha=strength, lw=0))


def _draw_edges(axes: Axes, grasp: Grasp, eye: Eye, front: bool) -> None:
    style: dict[str, Any] = {"color": INK, "solid_capstyle": "round"}
    style |= {"lw": 1.3} if front else {"lw": 0.8, "ls": (0, (4, 3)), "alpha": HIDDEN}
    for (u, v), sides in grasp.body.edges.items():
        if any(eye.sees(grasp.body.faces[k]) for k in sides) == front:
            axes.plot(*eye.places(grasp.body.vertices[[u, v]]).T, **style)


def _draw_contacts(
    axes: Axes, grasp: Grasp, eye: Eye, front: bool, taken: list[np.ndarray]
) -> None:
    """Arrows that end at the contacts, from outside; numbers keep off those at ``taken`` places."""
    step = LETTER * grasp.body.size
    gripper_of = {j: k for k, gripper in enumerate(grasp.grippers) for j in gripper.contacts}
    back = ARROW * grasp.body.size * grasp.contacts.normals
    for j, point in enumerate(grasp.contacts.points):
        if eye.sees(grasp.body.faces[grasp.faces[j]]) != front:
            continue
        tip, tail, beyond = (eye.places(point - s * back[j]) for s in (0.0, 1.0, 1.2))
        strength = 1.0 if front else 0.5 * (1.0 + HIDDEN)
        colour = colour_of(gripper_of.get(j, 0))
        arrow = FancyArrowPatch(
            tuple(tail), tuple(tip), arrowstyle="-|>", mutation_scale=15 if front else 12,
            color=colour, lw=2.0 if front else 1.4, alpha=strength, shrinkA=0, shrinkB=1.5,
        )  # fmt: skip
        axes.add_patch(arrow)
        axes.plot(*tip, "o", ms=4.5, color=colour, alpha=strength)
        while any(np.linalg.norm(beyond - number) < step for number in taken):
            beyond = beyond + [step, 0.0]
        taken.append(beyond)
        axes.text(
            beyond[0], beyond[1], str(j + 1), color=colour, fontweight="bold", fontsize=11,
            ha="center", va="center", alpha=strength,
        )  # fmt: skip


def _dress(axes: Axes, grasp: Grasp) -> None:
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.autoscale_view()
    keys = []
    for k, gripper in enumerate(grasp.grippers):
        numbers = ", ".join(str(j + 1) for j in gripper.contacts)
        label = f"{gripper.name}: contacts {numbers}"
        keys.append(Line2D([], [], color=colour_of(k), lw=2, label=label))
    axes.legend(
        handles=keys, loc="upper left", bbox_to_anchor=(0.0, 0.0), ncols=len(keys),
        frameon=False, fontsize=9.5,
    )  # fmt: skip
    verdict = "form closure" if grasp.closure else "no form closure"
    axes.set_title(f"{count_of(len(grasp.contacts), 'contact')}: {verdict}")
