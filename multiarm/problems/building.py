"""Small parts that the scenes of hard cases share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from multiarm.scene import Scene, find_robot

GRAVITY = 9.81  # [m/s^2]
DOWN = [0.0, 0.0, -GRAVITY]
# Linkages stand upright in the x-y plane.
DOWN_IN_PLANE = [0.0, -GRAVITY, 0.0]
# From the tips to the centre of what is held between two UR5 arms.
HALF_BAR = 0.3  # [m]
# Two UR5 arms, 2.2 m apart and face to face, hold the ends of a box 1.2 m long at this posture.
UR5_AT_BOX = (-0.264381, -1.509346, 1.788302, 2.862637, -1.306415, 0.0)

# Two textbook_6r arms at opposite corners of a block of 0.6 x 0.5 x 0.4 m, 0.6 m high: places and
# headings of their bases, and postures.
TEXTBOOK_BASES = ((-0.81, -0.36, 0.632749), (1.07, 0.56, -2.516108))  # [m, m, rad]
TEXTBOOK_POSTURES = (
    (-1.2662300194725, -0.3234842676447, 1.5072171181333)
    + (0.9466317385773, 1.6744926743206, 0.4019501324399),
    (-0.6216544586442, 1.0158661605253, 1.7411739925575)
    + (-0.6517442310392, -1.8941694112518, -1.2883621994469),
)


def own_urdf(name: str) -> str:
    """File of one of the project's own models."""
    return str(find_robot(name).urdf)


def tip_pose(
    robot: str,
    tip: str,
    posture: Sequence[float] | np.ndarray,
    lock: Mapping[str, float] | None = None,
) -> np.ndarray:
    """Pose of a robot's tip in its base, shape (4, 4), with some joints locked."""
    from multiarm.robots.robot import Robot, RobotFiles

    arm = Robot(
        "arm", RobotFiles(find_robot(robot).urdf, (), np.eye(4), {"": tip}, dict(lock or {}))
    )
    return arm.tip_pose(np.array(posture))


def pose(xyz: Sequence[float] | np.ndarray, R: np.ndarray) -> dict:
    """A place [m] and a rotation matrix as a scene has them."""
    from multiarm.spatial import matrix_to_quaternion

    return {"xyz": np.asarray(xyz).tolist(), "quaternion_xyzw": matrix_to_quaternion(R).tolist()}


def rod_inertia(mass: float, length: float, width: float = 0.0) -> list[float]:
    """Principal moments of a square bar along x about its centre [kg m^2]; thin by default."""
    across = mass * (length**2 + width**2) / 12.0
    # a thin rod has next to no moment about itself, but an object needs some
    along = mass * (2.0 * (width or 0.02) ** 2) / 12.0
    return [along, across, across]


def two_arms(bases: Sequence, postures: Sequence, **robot) -> dict[str, dict]:
    """Arms of one robot, left and right, on the ground at (x [m], y [m], heading [rad])."""
    return {
        arm: {
            **robot,
            "base": {"xyz": [x, y, 0.0], "rpy": [0.0, 0.0, heading]},
            "posture": list(posture),
        }
        for arm, (x, y, heading), posture in zip(("left", "right"), bases, postures, strict=True)
    }


def facing_ur5(x: float, y: float, posture: Sequence[float]) -> dict[str, dict]:
    """Two UR5 arms in one posture: half a turn about the z axis takes the left one to the right."""
    bases = ((x, y, 0.0), (-x, -y, np.pi))
    return two_arms(bases, (posture, posture), robot="ur5", tip="tool0")


def two_ur5_and_box(**changes) -> dict:
    """Data of the scene in which two UR5 arms, face to face, are welded to the ends of a box."""
    data = {
        "gravity": DOWN,
        "object": {"shape": {"box": [1.2, 0.6, 0.4]}, "mass": 20.0, "pose": {"xyz": [0, 0, 0.5]}},
        "arms": facing_ur5(-1.1, 0, UR5_AT_BOX),
        "joints": [{"arm": "left", "kind": "weld"}, {"arm": "right", "kind": "weld"}],
    }
    return {**data, **changes}


def held_between(
    name: str, posture: Sequence[float], object_: dict, joints: list[dict], **changes
) -> Scene:
    """Two UR5 arms in one posture with an object between their tips, in damped free fall.

    Half a turn about the z axis takes one arm to the other; the object's centre is on that axis,
    and the tips are ``HALF_BAR`` from it along the x axis.
    """
    x, y, z = tip_pose("ur5", "tool0", posture)[:3, 3].tolist()
    data = {
        "name": name,
        "gravity": DOWN,
        "object": {"pose": {"xyz": [0.0, 0.0, z]}, **object_},
        "arms": facing_ur5(-HALF_BAR - x, -y, posture),
        "joints": joints,
        "effects": {"joint_damping": 5.0},
        **changes,
    }
    return Scene(**data)


def joint_pd(stiffness: list[float], damping: list[float], **more) -> dict:
    """Joint PD control, with the same gains for both arms."""
    return {
        "kind": "joint_pd",
        "stiffness": {"left": stiffness, "right": stiffness},
        "damping": {"left": damping, "right": damping},
        **more,
    }


def grips_on_box() -> dict[str, dict]:
    """Where the tips of the consistent posture are on the box, by arm."""
    tip = tip_pose("ur5", "tool0", UR5_AT_BOX)
    grips: dict[str, dict] = {}
    for arm, sign in (("left", 1.0), ("right", -1.0)):
        X_WB = np.diag([sign, sign, 1.0, 1.0])
        X_WB[0, 3] = -1.1 * sign
        X_WT = X_WB @ tip
        grips[arm] = pose(X_WT[:3, 3] - [0.0, 0.0, 0.5], X_WT[:3, :3])
    return grips
