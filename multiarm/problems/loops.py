"""Linkages with one degree of freedom, compared with their motion in closed form.

They are the hardest systems of all for a solver of many arms: an arm of one or two joints can give
way to almost none of its contacts, the hinges of a planar loop hold it in its plane several times
over, and some linkages pass positions in which two motions cross.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from multiarm.problems.building import DOWN_IN_PLANE, GRAVITY, own_urdf, pose, rod_inertia
from multiarm.problems.case import Criterion, HardCase, apart, largest, sound
from multiarm.problems.linkages import (
    BRICARD_BASES,
    Body,
    FourBar,
    OneFreedom,
    bricard_poses,
    parallel_crank_poses,
)
from multiarm.scene import Scene

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

ACCURACY = 1e-6
# The benchmark's own limit for Bricard's loop is 1e-9 of the energy; a tenth of that in accuracy.
FINE = 1e-10

# Crank-coupler-rocker with crank + ground = coupler + rocker: flat at a crank angle of pi.
CHANGE_POINT = FourBar(crank=0.5, coupler=1.0, rocker=1.0, ground=1.5, flat=True)
_CHANGE_POINT_START = 0.5 * np.pi, 8.0  # [rad], [rad/s]
# Two arms of two joints, welded to a bar: their second links and the bar are one coupler.
WELDED_ARMS = FourBar(crank=0.5, coupler=1.2, rocker=0.5, ground=1.4, side=1)
WELDED_START = -1.0  # [rad]
# All links 1 m; the parallelogram starts 1 rad above its flat position.
_PARALLELOGRAM_START = 1.0, -2.0
# As in problem A02 of the IFToMM library of multibody benchmarks: upright, tips at 1 m/s.
_DOUBLE_START = 0.5 * np.pi, -1.0
_GRAVITY = np.array(DOWN_IN_PLANE)
_ROD = Body(1.0, np.diag(rod_inertia(1.0, 1.0)))
_SQUARE = Body(1.0, np.diag(rod_inertia(1.0, 1.0, 0.1)))


@cache
def four_bar_motion() -> OneFreedom:
    """The change-point four-bar along its smooth motion; the coordinate is the crank angle."""
    return OneFreedom(
        (_ROD, _ROD, _ROD),
        lambda s: CHANGE_POINT.poses(s, 0.5, 0.5, 0.5),
        _GRAVITY,
        (0.0, 4.0 * np.pi),
        periodic=True,
    )


@cache
def parallelogram_motion(cranks: int) -> OneFreedom:
    """Parallel cranks; the coordinate is their common angle."""
    length = float(cranks - 1)
    coupler = Body(length, np.diag(rod_inertia(length, length)))
    return OneFreedom(
        (_ROD,) * cranks + (coupler,),
        lambda s: parallel_crank_poses(s, cranks, 1.0, 1.0),
        _GRAVITY,
        (0.0, 2.0 * np.pi),
        periodic=True,
        degree=60,
    )


@cache
def bricard_motion() -> OneFreedom:
    """Bricard's loop; the coordinate is that of its closed curve."""
    span = (0.0, 2.0 * np.pi)
    return OneFreedom((_SQUARE,) * 5, bricard_poses, _GRAVITY, span, periodic=True)


@cache
def welded_arms_motion() -> OneFreedom:
    """Two planar_2r arms welded to a bar of 2 kg; the coordinate is the left arm's first angle."""
    link = Body(3.0, np.diag([0.0013, 0.0629, 0.0634]))
    return OneFreedom(
        (link, _welded_coupler(), link),
        lambda s: WELDED_ARMS.poses(s, 0.25, 0.6, 0.25),
        _GRAVITY,
        (-2.0, -0.8),
        degree=80,
    )


def _welded_coupler() -> Body:
    """The second links of both arms, 0.2 m from its ends, and the bar in its middle."""
    link = np.diag([0.000717333333, 0.026933333333, 0.027117333333])
    away = 2.0 * (0.6 - 0.2) ** 2 * np.diag([0.0, 1.0, 1.0])
    bar = np.diag(rod_inertia(2.0, 0.4))
    return Body(2.0 + 2.0 + 2.0, bar + 2.0 * (link + away))


def crank(base: float, angle: float, rate: float, tip: str = "tip") -> dict:
    """A crank arm whose hinge is at (base, 0, 0)."""
    return {
        "urdf": own_urdf("crank"),
        "tip": tip,
        "base": {"xyz": [base, 0.0, 0.0]},
        "posture": [angle],
        "velocity": [rate],
    }


def hinge(arm: str, place: float, **more) -> dict:
    """A hinge along z at (place, 0, 0) of the object."""
    return {"arm": arm, "kind": "revolute", "at": {"xyz": [place, 0.0, 0.0]}, **more}


def rod(mass: float, length: float, centre, angle: float = 0.0, **more) -> dict:
    """A thin rod along x as the object, its centre and direction in the x-y plane."""
    return {
        "shape": {"box": [length, 0.04, 0.02]},
        "mass": mass,
        "inertia": rod_inertia(mass, length),
        "pose": {"xyz": [*centre, 0.0], "rpy": [0.0, 0.0, angle]},
        **more,
    }


def four_bar_scene() -> Scene:
    """Crank, coupler and rocker; the crank turns on and on through the flat position."""
    angle, rate = _CHANGE_POINT_START
    phi, psi = CHANGE_POINT.angles(angle)
    (_, u), (c, R), (_, w) = four_bar_motion().poses(complex(angle, 1e-40))
    spin = [float(np.imag(M[1, 0]) / np.real(M[0, 0]) * 1e40 * rate) for M in (u, R, w)]
    speed = (np.imag(c) * 1e40 * rate).tolist()
    return Scene(
        name="four-bar through its flat position",
        gravity=DOWN_IN_PLANE,
        object=rod(1.0, 1.0, np.real(c[:2]).tolist(), phi, twist=[*speed, 0.0, 0.0, spin[1]]),
        arms={
            "crank": crank(0.0, angle, rate, "middle"),
            "rocker": crank(CHANGE_POINT.ground, psi, spin[2]),
        },
        joints=[hinge("crank", -0.5), hinge("rocker", 0.5)],
        run={"duration": 3.0, "accuracy": ACCURACY},
    )


def parallel_cranks(name: str, cranks: int, start: tuple[float, float], duration: float) -> Scene:
    """Parallel cranks of 1 m, 1 m apart, and one coupler over all of them."""
    angle, rate = start
    length = float(cranks - 1)
    speed = [-rate * np.sin(angle), rate * np.cos(angle), 0.0]
    centre = [0.5 * length + np.cos(angle), np.sin(angle)]
    return Scene(
        name=name,
        gravity=DOWN_IN_PLANE,
        object=rod(length, length, centre, twist=[*speed, 0.0, 0.0, 0.0]),
        arms={f"crank{i}": crank(float(i), angle, rate) for i in range(cranks)},
        joints=[hinge(f"crank{i}", i - 0.5 * length) for i in range(cranks)],
        run={"duration": duration, "accuracy": ACCURACY},
    )


def bricard_scene() -> Scene:
    """Two arms of two rods and a rod between them, five rods of 1 m and 1 kg, at rest."""
    arms = {}
    places = ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    turns = (0.5 * np.pi, -0.5 * np.pi)
    for name, place, base, turn in zip(
        ("first", "last"), places, BRICARD_BASES, turns, strict=True
    ):
        arms[name] = {
            "urdf": own_urdf("crossed_2r"),
            "tip": "tip",
            "base": pose(place, base),
            "posture": [0.0, turn],
        }
    last = {"xyz": [-0.5, 0.0, 0.0], "rpy": [-0.5 * np.pi, 0.0, 0.0]}
    return Scene(
        name="Bricard's loop",
        gravity=DOWN_IN_PLANE,
        object={
            "shape": {"box": [1.0, 0.1, 0.1]},
            "mass": 1.0,
            "pose": {"xyz": [1.0, -1.0, 0.5], "rpy": [0.0, 0.5 * np.pi, 0.0]},
        },
        arms=arms,
        joints=[hinge("first", 0.5), {"arm": "last", "kind": "revolute", "at": last}],
        run={"duration": 10.0, "accuracy": FINE},
    )


def two_joint_arms_scene(**changes) -> Scene:
    """Two planar_2r arms welded to a bar of 0.4 m and 2 kg."""
    angle = WELDED_START
    phi, psi = WELDED_ARMS.angles(angle)
    centre, _ = WELDED_ARMS.poses(complex(angle), 0.25, 0.6, 0.25)[1]
    arms = {
        "left": {"robot": "planar_2r", "tip": "tip", "posture": [angle, phi - angle]},
        "right": {
            "robot": "planar_2r",
            "tip": "tip",
            "base": {"xyz": [WELDED_ARMS.ground, 0.0, 0.0]},
            "posture": [psi, phi + np.pi - psi],
        },
    }
    data = {
        "name": "two arms of two joints, welded",
        "gravity": DOWN_IN_PLANE,
        "object": rod(2.0, 0.4, np.real(centre[:2]).tolist(), phi),
        "arms": arms,
        "joints": [
            {"arm": "left", "kind": "weld", "at": {"xyz": [-0.2, 0.0, 0.0]}},
            {"arm": "right", "kind": "weld", "at": {"xyz": [0.2, 0.0, 0.0], "rpy": [0, 0, np.pi]}},
        ],
        "run": {"duration": 3.0, "accuracy": ACCURACY},
    }
    return Scene(**{**data, **changes})


def follows(
    motion: Callable[[], OneFreedom], start: float, rate: float, body: int, bound: float
) -> Criterion:
    """Object's largest distance from the closed-form motion [m]."""

    def measure(run: Trajectory, system: System) -> float:
        exact = motion()
        return apart(run.object_position, exact.centres(body, exact.motion(start, rate, run.time)))

    return Criterion("distance from the closed form", bound, "m", measure)


def _not_parallel(run: Trajectory, system: System) -> float:
    """Largest angle between two cranks [rad]."""
    angles = np.concatenate([run.joint_positions[arm] for arm in run.arm_names], axis=1)
    return largest(angles - angles[:, :1])


# A closed form gives the mechanism's position at each time: the error of the run as a whole, which
# `accuracy` aims at; ten times that because the flat and upright positions magnify what is off.
_FOLLOWED = 10.0

CASES = (
    HardCase(
        "four_bar",
        "Four-bar through its flat position",
        "Crank and ground together are as long as coupler and rocker: once in a turn all links lie "
        "on a line, the constraints lose a rank, and two motions cross. Solvers stop there, or "
        "leave on the wrong one.",
        four_bar_scene,
        (
            *sound(ACCURACY),
            follows(four_bar_motion, *_CHANGE_POINT_START, 1, _FOLLOWED * ACCURACY),
        ),
        hardest=0.1908,
        events=True,
    ),
    HardCase(
        "parallelogram",
        "Parallelogram through its flat position",
        "Flat, the parallel motion crosses that of the anti-parallelogram, and the constraints "
        "alone do not say which to follow: the velocity does.",
        partial(
            parallel_cranks, "parallelogram through its flat position", 2, _PARALLELOGRAM_START, 5.0
        ),
        (
            *sound(ACCURACY),
            Criterion("angle between the cranks", ACCURACY, "rad", _not_parallel),
            follows(
                partial(parallelogram_motion, 2), *_PARALLELOGRAM_START, 2, _FOLLOWED * ACCURACY
            ),
        ),
        hardest=0.3039,
        events=True,
    ),
    HardCase(
        "double_four_bar",
        "Double four-bar mechanism (Bayo; IFToMM benchmark A02)",
        "Three cranks on one coupler hold it once too often everywhere and once more where they "
        "lie flat, which the mechanism passes again and again for 10 s. The coupler is one piece "
        "here; on the motion that is followed the benchmark's two halves move alike.",
        partial(parallel_cranks, "double four-bar mechanism", 3, _DOUBLE_START, 10.0),
        (
            *sound(ACCURACY),
            Criterion("angle between the cranks", ACCURACY, "rad", _not_parallel),
            follows(partial(parallelogram_motion, 3), *_DOUBLE_START, 3, _FOLLOWED * ACCURACY),
        ),
        hardest=0.7144,
        events=True,
    ),
    HardCase(
        "bricard",
        "Bricard's loop of six hinges (IFToMM benchmark A04)",
        "Six hinges leave a loop no freedom by count; these, perpendicular to one another, leave "
        "one: a constraint is redundant in every position, and no one in particular.",
        bricard_scene,
        (
            *sound(FINE, scale=GRAVITY, named="m g L of a rod"),
            follows(bricard_motion, 0.0, 0.0, 2, _FOLLOWED * FINE),
        ),
        events=True,
    ),
    HardCase(
        "two_joint_arms",
        "Two arms of two joints, welded to a bar",
        "Each arm gives way to two of its weld's six constraints: the forces along the other four "
        "are statically undetermined, and an arm by arm elimination divides by zero.",
        two_joint_arms_scene,
        (
            *sound(ACCURACY),
            follows(welded_arms_motion, WELDED_START, 0.0, 1, _FOLLOWED * ACCURACY),
        ),
        events=True,
    ),
)
