"""Extreme ratios of mass, sizes, places and damping."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING

import numpy as np

from multiarm.problems.building import (
    DOWN,
    GRAVITY,
    TEXTBOOK_BASES,
    TEXTBOOK_POSTURES,
    joint_pd,
    own_urdf,
    two_arms,
    two_ur5_and_box,
)
from multiarm.problems.case import (
    Criterion,
    HardCase,
    apart,
    distance_from,
    largest,
    reference_run,
    sound,
)
from multiarm.problems.linkages import OneFreedom
from multiarm.problems.loops import WELDED_ARMS, two_joint_arms_scene, welded_arms_motion
from multiarm.scene import Scene

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

ACCURACY = 1e-6
_UR5_MASS = 21.0  # [kg], of all links that move
LIGHT = 2 * _UR5_MASS * 1e-6
HEAVY = 2 * _UR5_MASS * 1e6
FAR = (1200.0, -1600.0, 700.0)  # [m]
STIFF = 1e5  # [N m s/rad]
_PUSH = 3e4  # [N m]
SMALLER = 1e-3


def box_of_mass(mass: float, name: str, **more) -> Scene:
    """Two UR5 arms swing a box of any mass, its inertia in proportion, without gravity."""
    data = two_ur5_and_box(gravity=None)
    data["object"] |= {"mass": mass, **more}
    torques = [8.0, 8.0, 8.0, 2.0, 2.0, 2.0]
    return Scene(
        **data,
        name=name,
        control={"kind": "harmonic", "frequency": 1.0, "amplitude": {"left": torques}},
        effects={"joint_damping": 5.0},
        run={"duration": 1.0, "accuracy": ACCURACY},
    )


@cache
def stiff_motion() -> OneFreedom:
    """The creeping arms; the coordinate is the left arm's first angle, which the torque turns."""
    free = welded_arms_motion()

    def damping(s: float) -> float:
        rates = joint_rates(s)
        return STIFF * float(rates @ rates)

    return replace(free, force=lambda s: -_PUSH, damping=damping)


def joint_rates(s: float) -> np.ndarray:
    """Rates of the four joints of the welded arms for a unit rate of the coordinate."""
    step = 1e-40
    parts = WELDED_ARMS.directions(complex(s, step))
    crank, coupler, rocker = (
        (np.real(u) * np.imag(v) - np.real(v) * np.imag(u)) / step for u, v in parts
    )
    return np.array([crank, coupler - crank, rocker, coupler - rocker])


def carried_scene(origin: tuple[float, float, float], name: str) -> Scene:
    """Two UR5 arms carry a box along a path; everything is moved to ``origin``."""
    data = two_ur5_and_box()
    shift = np.array(origin)

    def moved(xyz):
        return (np.array(xyz) + shift).tolist()

    data["object"]["pose"]["xyz"] = moved(data["object"]["pose"]["xyz"])
    for arm in data["arms"].values():
        arm["base"]["xyz"] = moved(arm["base"]["xyz"])
    stiffness = [2000.0, 2000.0, 2000.0, 300.0, 300.0, 300.0]
    damping = [200.0, 200.0, 200.0, 15.0, 15.0, 15.0]
    path = [{"time": 1.0, "xyz": moved([0.0, 0.0, 0.6]), "rpy": [0.0, 0.0, 0.2]}]
    return Scene(
        **data,
        name=name,
        control=joint_pd(stiffness, damping, path=path),
        run={"duration": 1.0, "accuracy": ACCURACY},
    )


def hanging_block(scale: float, robot: str, name: str) -> Scene:
    """Two textbook arms and a block on balls, released; of any size, of the same materials."""
    bases = [(scale * x, scale * y, heading) for x, y, heading in TEXTBOOK_BASES]
    arms = two_arms(bases, TEXTBOOK_POSTURES, urdf=own_urdf(robot), tip="tool")
    duration = 0.3 * scale**0.5
    return Scene(
        name=name,
        gravity=DOWN,
        object={
            "shape": {"box": [0.6 * scale, 0.5 * scale, 0.4 * scale]},
            "mass": 15.0 * scale**3,
            "pose": {"xyz": [0.0, 0.0, 0.6 * scale]},
        },
        arms=arms,
        joints=[{"arm": arm, "kind": "ball", "size": 0.1 * scale} for arm in arms],
        run={"duration": duration, "accuracy": ACCURACY, "output_step": duration / 30.0},
    )


def _velocity_changed(run: Trajectory, system: System) -> float:
    """Change of the object's velocity [m/s]."""
    velocity = run.object_twist[:, :3]
    return largest(velocity - velocity[0])


def _apart_from_origin(run: Trajectory, system: System) -> float:
    near = reference_run(carried_scene, (0.0, 0.0, 0.0), "at the origin")
    return apart(run.object_position - np.array(FAR), near.object_position)


def _apart_from_large(run: Trajectory, system: System) -> float:
    """Distance from the run of the large arms, at their scale [m]."""
    large = reference_run(hanging_block, 1.0, "textbook_6r", "the same, of a metre")
    return apart(run.object_position / SMALLER, large.object_position)


def _crept(run: Trajectory, system: System) -> float:
    """Distance of the left arm's first joint from the creeping motion [rad]."""
    angles = run.joint_positions["left"][:, 0]
    exact = stiff_motion().motion(float(angles[0]), 0.0, run.time)
    return apart(angles, exact)


# Coordinates of 2 km have roundings of 2.3e-13 m, and so have all gaps: a hundred are closed.
_FAR_CLOSED = 200 * 2.2e-16 * 2200.0

CASES = (
    HardCase(
        "light_object",
        "An object a million times lighter than the arms",
        "The object's inertia is negligible compared with the arms' share; two arms that are in "
        "truth one chain must push against each other through almost nothing.",
        partial(box_of_mass, LIGHT, "light object"),
        (
            *sound(ACCURACY),
            # what a mass does to the motion is in proportion to it: a millionth of the path of
            # about 1 m, on top of what the two runs are off
            distance_from(
                "a massless object", 3 * ACCURACY, box_of_mass, 1e-3 * LIGHT, "lighter still"
            ),
        ),
    ),
    HardCase(
        "heavy_object",
        "An object a million times heavier than the arms",
        "The arms are dragged along by 42 000 t; their own motion is lost in the roundings of a "
        "system that is not scaled.",
        # it drifts, and takes the arms along
        partial(box_of_mass, HEAVY, "heavy object", twist=[0.05, 0.03, 0.04, 0.02, -0.03, 0.05]),
        (
            *sound(ACCURACY),
            # arms of a millionth of the mass change the speed by a millionth of the speeds, up to
            # some m/s, that they reach themselves
            Criterion("change of the object's velocity", 1e-5, "m/s", _velocity_changed),
        ),
    ),
    HardCase(
        "stiff_damping",
        "Joints in dampers of 1e5 N m s/rad",
        "What disturbs the creeping motion dies within microseconds: explicit methods are stable "
        "with steps of that length only, although nothing seems to move.",
        partial(
            two_joint_arms_scene,
            name="arms in stiff dampers",
            effects={"joint_damping": STIFF},
            control={"kind": "constant", "torques": {"left": [-_PUSH, 0.0]}},
            run={"duration": 0.2, "accuracy": ACCURACY},
        ),
        (
            *sound(ACCURACY, scale=0.01 * _PUSH, named="work of the torque"),
            Criterion("distance from the creeping motion", 10 * ACCURACY, "rad", _crept),
        ),
    ),
    HardCase(
        "far_origin",
        "Two kilometres from the world's origin",
        "Coordinates of 2 km leave 2e-13 m of resolution: tolerances that are meant for 1 m are "
        "never reached, or moments about the origin drown the others.",
        partial(carried_scene, FAR, "far from the origin"),
        (
            *sound(
                ACCURACY,
                scale=20.0 * GRAVITY * 0.1,
                named="work of lifting the box",
                closed=_FAR_CLOSED,
            ),
            # the same steps, so that only roundings and what counts as closed come between
            Criterion(
                "distance from the run at the origin", 10 * _FAR_CLOSED, "m", _apart_from_origin
            ),
        ),
    ),
    HardCase(
        "millimetre_robots",
        "Arms of a millimetre",
        "Inertias of 1e-16 kg m^2 and forces of micronewtons: any threshold with a unit in it is "
        "wrong by many powers of ten.",
        partial(hanging_block, SMALLER, "millimetre_6r", "arms of a millimetre"),
        (
            *sound(ACCURACY, closed=1e-15, closed_rate=1e-12),
            # similar motions, lengths by a thousandth and times by its root; the joints, which
            # place the block, are requested to 1e-6 rad: 1e-6 m at the scale of the large arms
            Criterion(
                "distance from the large arms, at scale", 10 * ACCURACY, "m", _apart_from_large
            ),
        ),
    ),
)
