"""Linkages that pass positions in which two of their motions cross, on their closed forms."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

import multiarm as ma
from multiarm.problems import HARD_CASES, loops

STEP = 1e-40


# Scene, motion, number of the object among its bodies, rates [rad/s] that pass the flat position.
LINKAGES = {
    "four_bar": (loops.four_bar_scene, loops.four_bar_motion, 1, (5.0, 12.0)),
    "parallelogram": (
        HARD_CASES["parallelogram"].scene, lambda: loops.parallelogram_motion(2), 2, (3.0, 12.0),
    ),
}  # fmt: skip


@cache
def compiled(name):
    return ma.compile_system(LINKAGES[name][0]())


def state_on(name, coordinate, rate):
    """State of a linkage on its closed form."""
    system, motion, body = compiled(name), LINKAGES[name][1](), LINKAGES[name][2]
    poses = motion.poses(complex(coordinate, STEP))
    angles = [math.atan2(np.real(R[1, 0]), np.real(R[0, 0])) for _, R in poses]
    spins = [float((np.imag(R) @ np.real(R).T)[1, 0] / STEP * rate) for _, R in poses]
    arms = [k for k in range(len(poses)) if k != body]
    named = lambda values: {  # noqa: E731
        arm: [values[k]] for arm, k in zip(system.arm_names, arms, strict=True)
    }
    return system.state(
        object_position=np.real(poses[body][0]),
        object_quaternion_xyzw=[0, 0, math.sin(0.5 * angles[body]), math.cos(0.5 * angles[body])],
        object_twist=[*(np.imag(poses[body][0]) / STEP * rate), 0.0, 0.0, spins[body]],
        joint_positions=named(angles),
        joint_velocities=named(spins),
    )
