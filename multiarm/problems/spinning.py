"""Bodies that spin: fast, about their centre of mass, or about an axis of hardly any inertia."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from multiarm.problems.building import DOWN, GRAVITY, HALF_BAR, held_between, tip_pose
from multiarm.problems.case import (
    Criterion,
    HardCase,
    largest,
    sound,
    turned_apart,
)
from multiarm.problems.ring import RING_POSTURE
from multiarm.scene import Scene

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

ACCURACY = 1e-6
_RUN = {"duration": 0.5, "accuracy": ACCURACY}
_AXIAL = 1e-9  # [kg m^2]
_SPIN = 12.0  # [rad/s]
# Unsymmetric body, thrown about its middle axis.
TUMBLING_INERTIA = (0.02, 0.05, 0.06)
TUMBLING_RATE = (3.0, 40.0, 2.0)  # [rad/s]
ROTOR_RATE = 300.0  # [rad/s]


def tiny_inertia_scene() -> Scene:
    """A rod, spinning about itself, between two balls on its axis."""
    across = 1.0 * 0.6**2 / 12.0
    rod = {
        "shape": {"box": [0.6, 0.01, 0.01]},
        "mass": 1.0,
        "inertia": [_AXIAL, across, across],
        "twist": [0.0, 0.0, 0.0, _SPIN, 0.0, 0.0],
    }
    joints = [
        {"arm": arm, "kind": "ball", "at": {"xyz": [end, 0.0, 0.0]}}
        for arm, end in (("left", -HALF_BAR), ("right", HALF_BAR))
    ]
    return held_between("thin rod between two balls", RING_POSTURE, rod, joints, run=_RUN)


def free_spin_scene() -> Scene:
    """An unsymmetric body, held by a ball at its centre of mass: the arm cannot turn it."""
    x, y, z = tip_pose("ur5", "tool0", RING_POSTURE)[:3, 3]
    return Scene(
        name="a body tumbles about its centre of mass",
        gravity=DOWN,
        object={
            "shape": {"box": [0.5, 0.3, 0.2]},
            "mass": 2.0,
            "inertia": list(TUMBLING_INERTIA),
            "pose": {"xyz": [float(x), float(y), float(z)]},
            "twist": [0.0, 0.0, 0.0, *TUMBLING_RATE],
        },
        arms={"arm": {"robot": "ur5", "tip": "tool0", "posture": list(RING_POSTURE)}},
        joints=[{"arm": "arm", "kind": "ball", "at": {}}],
        effects={"joint_damping": 5.0},
        run={"duration": 2.0, "accuracy": ACCURACY},
    )


def fast_spin_scene() -> Scene:
    """A rotor between two hinges, at 300 rad/s, while the arms sink."""
    rotor = {
        "shape": {"box": [0.6, 0.2, 0.2]},
        "mass": 4.0,
        "inertia": [0.02, 0.012, 0.012],
        "twist": [0.0, 0.0, 0.0, ROTOR_RATE, 0.0, 0.0],
    }
    tip = tip_pose("ur5", "tool0", RING_POSTURE)[:3, :3]
    joints = []
    for arm, sign in (("left", 1.0), ("right", -1.0)):
        axis = (np.diag([sign, sign, 1.0]) @ tip).T @ np.array([1.0, 0.0, 0.0])
        # z of the joint's frame along x of the rotor
        at = {"xyz": [-HALF_BAR * sign, 0.0, 0.0], "rpy": [0.0, 0.5 * np.pi, 0.0]}
        at_tip = {"quaternion_xyzw": _towards(axis)}
        joints.append({"arm": arm, "kind": "revolute", "at": at, "at_tip": at_tip})
    return held_between("rotor between two hinges", RING_POSTURE, rotor, joints, run=_RUN)


def _towards(axis: np.ndarray) -> list[float]:
    """A rotation that takes the z axis to ``axis``, as a quaternion (scalar last)."""
    half = np.array([0.0, 0.0, 1.0]) + axis
    half /= np.linalg.norm(half)
    return [*np.cross([0.0, 0.0, 1.0], half).tolist(), float(half[2])]


def _rotations(run: Trajectory) -> np.ndarray:
    """Rotation matrices of the object, shape (K, 3, 3)."""
    from multiarm.spatial import quaternion_to_matrix

    return np.array([quaternion_to_matrix(q) for q in run.object_quaternion_xyzw])


def _spin_changed(rate: float) -> Callable[[Trajectory, System], float]:
    """Relative change of the rate of turn about the object's own x axis."""

    def measure(run: Trajectory, system: System) -> float:
        axes = _rotations(run)[:, :, 0]
        return largest(np.sum(axes * run.object_twist[:, 3:], axis=1) / rate - 1.0)

    return measure


def _momentum_changed(run: Trajectory, system: System) -> float:
    """Relative change of the angular momentum about the centre of mass, a constant vector."""
    R, rates = _rotations(run), run.object_twist[:, 3:]
    in_body = np.einsum("kji,kj->ki", R, rates) * TUMBLING_INERTIA
    momentum = np.einsum("kij,kj->ki", R, in_body)
    return largest(momentum - momentum[0]) / largest(momentum[0])


def _turned_from_euler(run: Trajectory, system: System) -> float:
    """Angle [rad] between the body and the solution of Euler's equations."""
    return turned_apart(run.object_quaternion_xyzw, tumbling(run.time))


def tumbling(times: np.ndarray) -> np.ndarray:
    """Quaternions (scalar last) of the free body, from Euler's equations in body axes, (K, 4)."""
    from scipy.integrate import solve_ivp

    inertia = np.array(TUMBLING_INERTIA)

    def rates(_, y):
        w, (x, y_, z, s) = y[:3], y[3:]
        turn = 0.5 * np.array(
            [
                s * w[0] + y_ * w[2] - z * w[1],
                s * w[1] + z * w[0] - x * w[2],
                s * w[2] + x * w[1] - y_ * w[0],
                -x * w[0] - y_ * w[1] - z * w[2],
            ]
        )
        return np.concatenate([np.cross(inertia * w, w) / inertia, turn])

    start = np.array([*TUMBLING_RATE, 0.0, 0.0, 0.0, 1.0])
    span = (times[0], times[-1])
    solution = solve_ivp(rates, span, start, "DOP853", times, rtol=1e-13, atol=1e-13)
    return (solution.y[3:] / np.linalg.norm(solution.y[3:], axis=0)).T


# The time from one turn-over to the next depends on how far the motion is from the one that turns
# over only once, which is the square of the disturbance relative to the spin: errors of the momenta
# are magnified by its inverse.
_TUMBLED = ACCURACY / (TUMBLING_RATE[0] / TUMBLING_RATE[1]) ** 2
# A ball is on the rod's axis to the gap that counts as closed, 2e-14 m for each metre of the scene.
# With the rod's weight that is a moment about its axis, which has half a second to change the spin.
_SPIN_CHANGED = 2e-14 * GRAVITY * 0.5 / (_AXIAL * _SPIN)
_ROTOR_ENERGY = 0.5 * 0.02 * ROTOR_RATE**2

CASES = (
    HardCase(
        "tiny_inertia",
        "A thin rod spinning between two balls",
        "The rod's moment about itself is 1e-9 kg m^2, 3e-8 of that across: where it is lost in "
        "roundings the spin, which nothing can change, runs away.",
        tiny_inertia_scene,
        (
            *sound(ACCURACY),
            Criterion("relative change of the spin", _SPIN_CHANGED, "1", _spin_changed(_SPIN)),
        ),
    ),
    HardCase(
        "free_spin",
        "An unsymmetric body tumbles about its centre of mass",
        "Thrown about its middle axis at 40 rad/s it turns over again and again; each time a "
        "missing gyroscopic term or a sloppy quaternion tips it the wrong way.",
        free_spin_scene,
        (
            *sound(ACCURACY),
            Criterion("relative change of angular momentum", 10 * ACCURACY, "1", _momentum_changed),
            Criterion("angle from Euler's equations", _TUMBLED, "rad", _turned_from_euler),
        ),
    ),
    HardCase(
        "fast_spin",
        "A rotor at 300 rad/s between two arms",
        "Centripetal terms of 1e4 to 1e5 m/s^2 in every contact of the hinges: a slip in dW/dt or "
        "an object that turns much within a step shows at once.",
        fast_spin_scene,
        (
            *sound(
                ACCURACY,
                scale=_ROTOR_ENERGY,
                named="energy of the spin",
                closed_rate=ROTOR_RATE * 1e-10,
            ),
            Criterion("relative change of the spin", 10 * ACCURACY, "1", _spin_changed(ROTOR_RATE)),
        ),
    ),
)
