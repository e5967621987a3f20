"""UR5 arms in singular postures, from starts that are off, and over long times."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from multiarm.problems.building import (
    GRAVITY,
    HALF_BAR,
    UR5_AT_BOX,
    grips_on_box,
    held_between,
    joint_pd,
    two_ur5_and_box,
)
from multiarm.problems.case import (
    CLOSED,
    CLOSED_RATE,
    Criterion,
    HardCase,
    completed,
    distance_from,
    energy_error,
    largest,
    position_drift,
    sound,
    velocity_drift,
)
from multiarm.scene import Scene

if TYPE_CHECKING:
    from multiarm.dynamics.system import System
    from multiarm.results.trajectory import Trajectory

ACCURACY = 1e-6
# Elbow angle 0: upper arm, forearm and wrist in one line, leaning forward; the wrist is bent.
STRETCHED = (0.0, -0.9, 0.0, -0.6, 1.2, 0.0)
NEARLY_STRETCHED = (0.0, -0.9, 0.25, -0.85, 1.2, 0.0)
_STRAIGHT = "two UR5 arms with straight elbows", STRETCHED
_ELBOW = 2
# Written start of `inconsistent_start`: joints off by so much [rad] and rates [rad/s].
_OFF = (0.004, -0.006, 0.005, 0.003, -0.004, 0.002)
_RATES = (0.2, -0.1, 0.15, 0.1, 0.05, -0.1)


def leaning_arms(name: str, posture: tuple[float, ...], **changes) -> Scene:
    """Two UR5 arms that lean towards each other and hold a bar, which only turns about z."""
    return held_between(
        name,
        posture,
        {"shape": {"box": [2.0 * HALF_BAR, 0.1, 0.1]}, "mass": 5.0},
        [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "weld"}],
        run={"duration": 1.0, "accuracy": ACCURACY},
        **changes,
    )


def stretched_and_released_scene() -> Scene:
    """Torques drive both elbows from one side through the straight posture to the other."""
    torques = [0.0, 0.0, -40.0, 0.0, 0.0, 0.0]
    return leaning_arms(
        "two UR5 arms drive their elbows through",
        NEARLY_STRETCHED,
        gravity=None,
        control={"kind": "constant", "torques": {"left": torques, "right": torques}},
    )


def inconsistent_start_scene() -> Scene:
    """The postures miss the box by some millimetres and move against each other."""
    scene = two_ur5_and_box()
    places = grips_on_box()
    for joint in scene["joints"]:
        joint["at"] = places[joint["arm"]]
    for arm, sign in (("left", 1.0), ("right", -0.7)):
        posture = np.array(UR5_AT_BOX) + sign * np.array(_OFF)
        scene["arms"][arm]["posture"] = posture.tolist()
        scene["arms"][arm]["velocity"] = (sign * np.array(_RATES)).tolist()
    return Scene(
        **scene,
        name="two UR5 arms that start next to their grips",
        effects={"joint_damping": 5.0},
        run={"duration": 1.0, "accuracy": ACCURACY},
    )


def undamped_swing_scene() -> Scene:
    """No control, no damping: the box hangs on two passive arms and swings for 100 s."""
    return Scene(
        **two_ur5_and_box(),
        name="two UR5 arms swing for 100 s",
        run={"duration": 100.0, "accuracy": ACCURACY, "output_step": 0.1},
    )


def long_carry_scene() -> Scene:
    """The arms carry the box to and fro along a slow path for 1000 s; settings by default."""
    stiffness = [2000.0, 2000.0, 2000.0, 300.0, 300.0, 300.0]
    damping = [100.0, 100.0, 100.0, 5.0, 5.0, 5.0]
    path = [
        {"time": 250.0, "xyz": [0.0, 0.0, 0.6]},
        {"time": 500.0, "xyz": [0.0, 0.05, 0.55], "rpy": [0.0, 0.0, 0.2]},
        {"time": 1000.0, "xyz": [0.0, 0.0, 0.5]},
    ]
    return Scene(
        **two_ur5_and_box(),
        name="two UR5 arms carry a box for 1000 s",
        control=joint_pd(stiffness, damping, path=path),
        run={"duration": 1000.0, "output_step": 1.0},
    )


def _off_axis(run: Trajectory, system: System) -> float:
    """How far the object leaves the axis of symmetry [m], and how far it tilts [rad]."""
    sides = run.object_position[:, :2]
    return max(largest(sides), 2.0 * largest(run.object_quaternion_xyzw[:, :2]))


def _highest_elbow_at_end(run: Trajectory, system: System) -> float:
    return float(max(run.joint_positions[arm][-1, _ELBOW] for arm in run.arm_names))


def _apart_from_dense(build: Callable[..., Scene], *arguments: Any) -> Criterion:
    """Distance of the object from a run in which the whole linear system is solved at once [m]."""
    return distance_from("the dense solver", 2 * ACCURACY, build, *arguments, solver="dense")


def _object_moved(run: Trajectory, system: System) -> float:
    """How far assembling moved the object [m, rad]: the arms alone can close the gaps."""
    report = system.start_report
    return max(report.object_shift, report.object_turn)


def _off_posture(run: Trajectory, system: System) -> float:
    """Distance of the assembled start from the posture that holds the box [rad]."""
    starts = [run.joint_positions[arm][0] for arm in run.arm_names]
    return largest(np.array(starts) - UR5_AT_BOX)


def _far_from_target(run: Trajectory, system: System) -> float:
    """Distance of the box from the end of its path at the end of the run [m]."""
    return float(np.linalg.norm(run.object_position[-1] - [0.0, 0.0, 0.5]))


# Half a turn maps the equations onto themselves: only roundings (1e-16) break the symmetry.  The
# swing of two arms magnifies what is off about a hundredfold a second; a thousand roundings of
# 1e-16 may so become 1e-11 within a second.
_SYMMETRIC = Criterion("off the axis of symmetry", 1e-10, "m, rad", _off_axis)
# The errors of all steps, a hundredth of the accuracy each and some tens of steps a second, on a
# single surface of constant energy, if none cancels another: 100 s at 100 steps a second.
_LONG_SWING = 1e4 * 0.01 * ACCURACY
# Six joints that hold the object's end have no other posture nearby: the one from which the start
# was put off is found again, to the roundings of a closed gap (1e-13 m) over the smallest singular
# value of the arm's Jacobian (0.1 m, with room down to 1e-3 m).
_ASSEMBLED = 1e-10
# Raising a box of 20 kg by 0.1 m.
_LIFT = 20.0 * GRAVITY * 0.1

CASES = (
    HardCase(
        "straight_elbow",
        "Two arms that start with straight elbows",
        "A straight arm cannot give way along its own reach: K of both arms is singular at the "
        "very first evaluation, which eliminations by arm divide by.",
        partial(leaning_arms, *_STRAIGHT),
        (*sound(ACCURACY), _SYMMETRIC, _apart_from_dense(leaning_arms, *_STRAIGHT)),
        hardest=0.0,
        events=True,
    ),
    HardCase(
        "stretched_and_released",
        "Two arms drive their elbows through the straight posture",
        "On the way both arms lose a direction for an instant and have it again: a solver that "
        "pivots, damps or regularises there leaves the motion or stops.",
        stretched_and_released_scene,
        (
            *sound(ACCURACY),
            _SYMMETRIC,
            _apart_from_dense(stretched_and_released_scene),
            Criterion("elbows at the end, they began at 0.25", -0.1, "rad", _highest_elbow_at_end),
        ),
        hardest=0.075,
        events=True,
    ),
    HardCase(
        "inconsistent_start",
        "Positions some millimetres off, velocities against each other",
        "The written start satisfies neither the joints nor their rates; integrated as it is, it "
        "drifts apart, and pulled together by springs it shakes.",
        inconsistent_start_scene,
        (
            *sound(ACCURACY),
            Criterion("assembling moved the object", CLOSED, "m, rad", _object_moved),
            Criterion("distance from the posture meant", _ASSEMBLED, "rad", _off_posture),
        ),
    ),
    HardCase(
        "undamped_swing_100s",
        "A box swings on two passive arms for 100 s",
        "Nothing damps: errors of energy add up for 100 s while the motion, which is chaotic, "
        "passes near singular postures at speed.",
        undamped_swing_scene,
        (
            completed(),
            position_drift(),
            velocity_drift(10 * CLOSED_RATE),
            energy_error(None, _LONG_SWING),
        ),
        hardest=0.497,
        events=True,
    ),
    HardCase(
        "long_carry_1000s",
        "Two arms carry a box for 1000 s",
        "Any residue of a step, in the joints or in the unit quaternion, has a hundred "
        "thousand steps to add up.",
        long_carry_scene,
        (
            *sound(ACCURACY, scale=_LIFT, named="work of lifting the box"),
            Criterion("distance from the path's end", 10 * ACCURACY, "m", _far_from_target),
        ),
    ),
)
