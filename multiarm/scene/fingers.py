"""A hand of rigid fingers, given by its fingertips: a tool that needs no URDF file.

Such hands are small and made for one object, as the corner grippers of the thesis (2.2.3): each rod
leads from a palm to a spherical fingertip.  A scene's hand becomes the text of a URDF, so that
hands are tools like all others.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np
from pydantic import field_validator

from multiarm.scene.faults import invalid
from multiarm.scene.spec import Spec
from multiarm.scene.values import Pose, Positive, Vec3, roll_pitch_yaw

# The palm stands at this part of the way from the mount to the corner.
PALM = 0.3
# Radii relative to that of a fingertip, and never thicker than the palm.
ROD, STEM, KNUCKLE = 0.65, 2.6, 3.0
# Part of the mass in the palm with its stem; rods share most of the rest by their lengths.
IN_PALM, IN_TIPS = 0.5, 0.1
_LOOKS = {
    "graphite": "0.20 0.22 0.25 1",
    "ivory": "0.93 0.91 0.86 1",
    "amber": "0.95 0.62 0.18 1",
    "steel": "0.66 0.69 0.73 1",
    "rubber": "0.13 0.13 0.15 1",
}


class FingersSpec(Spec):
    """Rigid fingers on a palm. Their links: ``palm``, ``corner``, ``fingertip_1``, ..."""

    tips: tuple[Vec3, ...]
    """Centres of the fingertips [m] in the frame ``corner``."""
    radius: Positive = 0.01
    """Of the spherical fingertips [m]."""
    corner: Pose = Pose(xyz=(0.0, 0.0, 0.15))
    """The frame ``corner`` in the frame of the mount: where the hand meets the object."""
    mass: Positive = 0.5
    """Of the whole hand [kg]."""

    @field_validator("tips")
    @classmethod
    def _not_empty(cls, tips: tuple[Vec3, ...]) -> tuple[Vec3, ...]:
        if not tips:
            raise invalid("a hand needs at least one fingertip")
        return tips


def urdf_text(spec: FingersSpec) -> str:
    """The hand as a URDF robot with the root link ``palm``."""
    corner = spec.corner.matrix()
    tips = [corner[:3, :3] @ tip + corner[:3, 3] for tip in np.array(spec.tips)]
    knuckle = PALM * corner[:3, 3]
    palm = [_visual(_cylinder(np.zeros(3), knuckle, STEM * spec.radius), "ivory")]
    palm += [_visual(f"{_origin(knuckle)}{_sphere(KNUCKLE * spec.radius)}", "amber")]
    palm += [_visual(_cylinder(knuckle, tip, ROD * spec.radius), "steel") for tip in tips]
    looks = [
        f'<material name="{look}"><color rgba="{rgba}"/></material>'
        for look, rgba in _LOOKS.items()
    ]
    parts = [*looks, f'<link name="palm">{_inertial(spec, knuckle, tips)}{"".join(palm)}</link>']
    parts += ['<link name="corner"/>', _fixed("corner", "palm", spec.corner.xyz, spec.corner)]
    ball = f'<origin xyz="0 0 0"/>{_sphere(spec.radius)}'
    for number, tip in enumerate(spec.tips, start=1):
        link = f"fingertip_{number}"
        parts += [f'<link name="{link}">{_visual(ball, "rubber")}</link>']
        parts += [_fixed(link, "corner", tip, Pose())]
    return "\n".join(['<?xml version="1.0"?>', '<robot name="hand">', *parts, "</robot>", ""])


def _inertial(spec: FingersSpec, knuckle: np.ndarray, tips: list[np.ndarray]) -> str:
    """The whole hand: a ball at the knuckle, thin rods, points at the tips."""
    lengths = np.array([np.linalg.norm(tip - knuckle) for tip in tips])
    shares = lengths / np.sum(lengths) if np.any(lengths) else np.full(len(tips), 1.0 / len(tips))
    rods = (1.0 - IN_PALM - IN_TIPS) * spec.mass * shares
    masses = [IN_PALM * spec.mass, *rods, *[IN_TIPS * spec.mass / len(tips)] * len(tips)]
    places = [knuckle, *[0.5 * (knuckle + tip) for tip in tips], *tips]
    centre = np.average(places, axis=0, weights=masses)
    inertia = 0.4 * masses[0] * (KNUCKLE * spec.radius) ** 2 * np.eye(3)
    for mass, tip in zip(rods, tips, strict=True):
        inertia += _about(mass / 12.0, tip - knuckle)
    for mass, at in zip(masses, places, strict=True):
        inertia += _about(mass, at - centre)
    entries = " ".join(
        f'i{a}{b}="{float(inertia["xyz".index(a), "xyz".index(b)])!r}"'
        for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    return (
        f'<inertial>{_origin(centre)}<mass value="{spec.mass!r}"/><inertia {entries}/></inertial>'
    )


def _about(mass: float, arm: np.ndarray) -> np.ndarray:
    """Inertia of a point mass at the end of an arm."""
    return mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))


def _fixed(child: str, parent: str, xyz: tuple[float, ...], pose: Pose) -> str:
    rpy = roll_pitch_yaw(pose.matrix()[:3, :3])
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    origin = f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/>'
    return f'<joint name="{child}_joint" type="fixed">{ends}{origin}</joint>'


def _visual(shape: str, look: str) -> str:
    return f"<visual>{shape}<material name={quoteattr(look)}/></visual>"


def _cylinder(begin: np.ndarray, end: np.ndarray, radius: float) -> str:
    """A cylinder from one point to another."""
    way = end - begin
    length = float(np.linalg.norm(way))
    rpy = (
        0.0,
        float(np.arctan2(np.hypot(way[0], way[1]), way[2])),
        float(np.arctan2(way[1], way[0])),
    )
    size = f'<cylinder radius="{radius!r}" length="{max(length, 1e-6)!r}"/>'
    middle = _text(0.5 * (begin + end))
    return f'<origin xyz="{middle}" rpy="{_text(rpy)}"/><geometry>{size}</geometry>'


def _sphere(radius: float) -> str:
    return f'<geometry><sphere radius="{radius!r}"/></geometry>'


def _origin(xyz: np.ndarray) -> str:
    return f'<origin xyz="{_text(xyz)}"/>'


def _text(numbers: np.ndarray | tuple[float, ...]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
