r"""A block in form closure, held by fingers that slide along its faces, or nearly so.

Every finger is one slide and ends in a plane on a point of the block.  A finger that slides along
its face cannot move along its contact at all: ``K = W^T M^-1 W`` is a rounding.  The block stays
where it is, the contact forces are those of statics, and the fingers fall along the faces.

Slides that are tilted by a small angle towards the normal take the block along.  With
:math:`s` its sine, ``n`` fingers of mass ``m`` on one side of the block of mass ``M``, and gravity
:math:`g_n` along the normal into the block, :math:`g_s` along the slides, their forces ``f`` and
the acceleration ``a`` of the block along the normal obey

.. math::
    M a = n f + M g_n, \qquad m \ddot q = m g_s - s f, \qquad a = s \ddot q
    \quad\Rightarrow\quad
    f = \frac{M (s g_s - g_n)}{n + s^2 M / m}.

They are constant: the contacts stay where they are on the block, and a block that is held evenly
does not turn.  Without a tilt they are those of statics.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from multiarm.problems.building import GRAVITY, own_urdf, pose, tip_pose
from multiarm.problems.case import (
    CLOSED,
    Criterion,
    HardCase,
    apart,
    largest,
    reference_run,
    sound,
)
from multiarm.scene import Scene

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

ACCURACY = 1e-9
MASS, FINGER_MASS = 10.0, 1.0  # [kg]
SIZE = (0.6, 0.5, 0.4)  # [m]
# Tilts of slides [rad]: what roundings leave of none; a tenth of what counts as a constraint of its
# own, 1e-6, and ten times that.
ALIGNED, NEARLY, WEDGED = 3e-16, 1e-7, 1e-5
# Directions of gravity in the block: every contact is pushed.
_PULL = np.array([1.0, 2.0, -3.0]) / np.sqrt(14.0)
# Points on the block in half sizes, and the axis across the face, from outside to inside.
_SIDES = (((0.6, 1, 0), 1), ((-0.6, 1, 0), 1), ((1, 0, 0), 0))
_THREE_BELOW = (((0.8, 0, -1), 2), ((-0.8, 0.8, -1), 2), ((-0.8, -0.8, -1), 2))
_FOUR_BELOW = tuple(((x, y, -1), 2) for x in (0.8, -0.8) for y in (0.8, -0.8))
# No axis of the block is one of the world's: what is zero in the block is a rounding there.
_TURN = np.array([0.2, -0.3, 0.5, 0.7])
_ACROSS, _ROLL = 0.7, 0.4  # [rad]
# Two planar arms touch the sides that no finger does, and start along them [rad, rad/s].
_FREE_SIDES = (((0, -1, 0), 1), ((-1, 0, 0), 0))
_POSTURE = (0.6, -1.4)
_RATE = 0.3
_ELBOW = 0.5  # [m], length of the first link


def _touches(count: int) -> tuple:
    return (*(_THREE_BELOW if count == 6 else _FOUR_BELOW), *_SIDES)


@dataclass(frozen=True)
class Fall:
    """The motion of fingers and block.

    Attributes
    ----------
    forces, slides : ndarray, shape (count,)
        Contact forces, the smallest where there are seven [N]; accelerations of the fingers.
    block : ndarray, shape (3,)
        Acceleration of the block, in its axes [m/s^2].
    """

    forces: np.ndarray
    slides: np.ndarray
    block: np.ndarray


def fall(count: int, tilt: float) -> Fall:
    """Solution in closed form; six fingers, which do not hold evenly, without a tilt only.

    All sides push at the height of the centre and in pairs, those below at equal distances.
    """
    shares = ([0.5, 0.25, 0.25] if count == 6 else [0.25] * 4) + [0.5, 0.5, 1.0]
    forces, slides, block = [], [], np.zeros(3)
    for (place, axis), share in zip(_touches(count), shares, strict=True):
        normal = _inwards(np.array(place), axis)
        slide = np.cos(tilt) * _along(normal) + np.sin(tilt) * normal
        g_n, g_s = GRAVITY * _PULL @ normal, GRAVITY * _PULL @ slide
        s = np.sin(tilt)
        force = MASS * (s * g_s - g_n) / (1.0 / share + s**2 * MASS / FINGER_MASS)
        forces.append(force)
        slides.append(g_s - s * force / FINGER_MASS)
        block[axis] = s * slides[-1] * normal[axis]
    return Fall(np.array(forces), np.array(slides), block)


def closure_scene(count: int, tilt: float = ALIGNED, free: bool = False) -> Scene:
    """The block held by fingers; with ``free`` two planar arms move along the other two sides."""
    turn = _turn()
    arms, joints = {}, []
    for k, (place, axis) in enumerate(_touches(count), start=1):
        arm, joint = _finger(np.array(place), axis, tilt, turn)
        arms[f"finger_{k}"] = arm
        joints.append({"arm": f"finger_{k}", **joint})
    for k, (place, axis) in enumerate(_FREE_SIDES if free else (), start=1):
        arm, joint = _planar_arm(np.array(place), axis, turn)
        arms[f"free_{k}"] = arm
        joints.append({"arm": f"free_{k}", **joint})
    tilted = f", tilted by {tilt:g} rad" if tilt > ALIGNED else ""
    return Scene(
        name=f"{count} sliding fingers{tilted}{' and two free arms' if free else ''}",
        gravity=(GRAVITY * turn @ _PULL).tolist(),
        object={"shape": {"box": list(SIZE)}, "mass": MASS, "pose": pose(np.zeros(3), turn)},
        arms=arms,
        joints=joints,
        run={"duration": 0.3, "accuracy": ACCURACY},
    )


def _finger(place: np.ndarray, axis: int, tilt: float, turn: np.ndarray) -> tuple[dict, dict]:
    """A slide along the face, and its plane on a point of the block."""
    normal = _inwards(place, axis)
    along = _along(normal)
    slide = np.cos(tilt) * along + np.sin(tilt) * normal
    side = np.cross(normal, along)
    across = np.cross(slide, side)
    second = np.cos(_ROLL) * side + np.sin(_ROLL) * across
    frame = np.column_stack([slide, second, np.cross(slide, second)])
    point = 0.5 * place * SIZE
    tip = {"plane": {"point": [0, 0, 0], "normal": (frame.T @ normal).tolist()}}
    arm = {"urdf": own_urdf("slide"), "tip": "tip", "base": pose(turn @ point, turn @ frame)}
    return arm, _contact(tip, {"point": [0, 0, 0]}, pose(point, frame))


def _planar_arm(place: np.ndarray, axis: int, turn: np.ndarray) -> tuple[dict, dict]:
    """A planar arm whose tip moves along the face, in the plane of the normal."""
    normal = _inwards(place, axis)
    along = np.roll(normal, 1)
    frame = np.column_stack([normal, along, np.cross(normal, along)])
    point = 0.5 * place * SIZE
    tip = tip_pose("planar_2r", "tip", _POSTURE)
    base = turn @ (point - frame @ tip[:3, 3])
    _, y = tip[:2, 3] - _ELBOW * np.array([np.cos(_POSTURE[0]), np.sin(_POSTURE[0])])
    arm = {
        "robot": "planar_2r",
        "tip": "tip",
        "base": pose(base, turn @ frame),
        "posture": list(_POSTURE),
        # the tip's velocity along the normal, -y of base and elbow times their rates, is zero
        "velocity": [_RATE, -_RATE * tip[1, 3] / y],
    }
    face = {"plane": {"point": [0, 0, 0], "normal": [-1, 0, 0]}}
    return arm, _contact({"point": [0, 0, 0]}, face, pose(point, frame))


def _contact(arm: dict, block: dict, at: dict) -> dict:
    return {"kind": "contacts", "at": at, "contacts": [{"arm": arm, "object": block}]}


def _turn() -> np.ndarray:
    from multiarm.spatial import quaternion_to_matrix

    return quaternion_to_matrix(_TURN / np.linalg.norm(_TURN))


def _inwards(place: np.ndarray, axis: int) -> np.ndarray:
    normal = np.zeros(3)
    normal[axis] = -np.sign(place[axis])
    return normal


def _along(normal: np.ndarray) -> np.ndarray:
    """Direction of the slides on a side: none of its edges."""
    return np.cos(_ACROSS) * np.roll(normal, 1) + np.sin(_ACROSS) * np.roll(normal, 2)


# --- criteria ------------------------------------------------------------------------------------


def _fingers(run: Trajectory, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Values of all fingers, shape (K, fingers)."""
    return np.hstack([value for arm, value in values.items() if arm.startswith("finger")])


def _forces_off(count: int, tilt: float, run: Trajectory, system: System) -> float:
    """Largest difference of the contact forces from those in closed form, over the weight."""
    forces = _fingers(run, run.contact_forces)
    return largest(forces - fall(count, tilt).forces) / (MASS * GRAVITY)


def _slides_off(count: int, tilt: float, run: Trajectory, system: System) -> float:
    """Largest distance of a finger from where it should be [m]."""
    slid = 0.5 * run.time[:, None] ** 2 * fall(count, tilt).slides
    return largest(_fingers(run, run.joint_positions) - slid)


def _block_off(count: int, tilt: float, run: Trajectory, system: System) -> float:
    """Largest distance of the block from where it should be [m]."""
    carried = 0.5 * run.time[:, None] ** 2 * (_turn() @ fall(count, tilt).block)
    return largest(run.object_position - carried)


def _forces_apart(run: Trajectory, system: System) -> float:
    reference = reference_run(closure_scene, 6, ALIGNED, True, solver="dense")
    forces = (_fingers(r, r.contact_forces) for r in (run, reference))
    return apart(*forces) / (MASS * GRAVITY)


def _rank(expected: int) -> Criterion:
    return Criterion("rank off", 0.0, "1", lambda run, system: largest(run.rank - expected))


def _held(count: int, tilt: float, rank: int, block: float, forces: float) -> tuple[Criterion, ...]:
    """Criteria of a run in closed form; with bounds for the block [m] and the forces."""
    return (
        *sound(ACCURACY),
        _rank(rank),
        Criterion("block off", block, "m", partial(_block_off, count, tilt)),
        Criterion("fingers off", ACCURACY, "m", partial(_slides_off, count, tilt)),
        Criterion("forces off / weight", forces, "1", partial(_forces_off, count, tilt)),
    )


# Elimination leaves eleven digits of the forces; a hundred times that.
_FORCES = 1e-9
# Of seven fingers at 1e-5 one force is determined by the slides alone: the roundings of a row, some
# 1e-16, times the weight of a finger, over the square of the tilt, is 1e-5 N; ten times that.
_WEDGED_FORCES = 1e-6

CASES = (
    HardCase(
        "six_sliding_fingers",
        "Six fingers hold a block and slide along its faces",
        "No finger can move along its contact: what its inertia divides by is a rounding, and the "
        "forces on the block are those of statics alone.",
        partial(closure_scene, 6),
        _held(6, ALIGNED, 6, CLOSED, _FORCES),
    ),
    HardCase(
        "seven_sliding_fingers",
        "Seven fingers hold a block and slide along its faces",
        "One contact more than it takes, and no finger moves along any: roundings look like a "
        "seventh constraint, whose force is without bound.",
        partial(closure_scene, 7),
        _held(7, ALIGNED, 6, CLOSED, _FORCES),
    ),
    HardCase(
        "nearly_sliding_fingers",
        "Seven fingers slide along faces but for 1e-7 rad",
        "The seventh constraint contributes a tenth of what counts as one: taken for one, its "
        "force is a rounding over the square of the tilt.",
        partial(closure_scene, 7, NEARLY),
        _held(7, NEARLY, 6, ACCURACY, _FORCES),
    ),
    HardCase(
        "wedged_fingers",
        "Seven fingers wedge a block at 1e-5 rad",
        "The fingers give way by a tilt of their slides: the seventh constraint counts, and K is "
        "1e-10 of what other arms have.",
        partial(closure_scene, 7, WEDGED),
        _held(7, WEDGED, 7, ACCURACY, _WEDGED_FORCES),
    ),
    HardCase(
        "closure_and_free_arms",
        "Two arms slide along a block that six fingers hold",
        "Arms that move along their contacts together with arms that cannot: the block's node "
        "matrix is not to be filled with roundings of the latter.",
        partial(closure_scene, 6, ALIGNED, True),
        (
            *sound(ACCURACY),
            _rank(8),
            Criterion("block off", CLOSED, "m", partial(_block_off, 6, ALIGNED)),
            # both runs meet their requested accuracy
            Criterion("forces off the dense solver's / weight", 1e-6, "1", _forces_apart),
        ),
    ),
)
