"""Random scenes: arms, object, joints, control, effects, duration and accuracy, all drawn.

The bases are put where the arms' tips are on the object, so that every scene is assembled, whatever
was drawn. Some of them are tame, others fall freely or swing: what is common to them is only that
no author chose them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from multiarm.problems.building import DOWN, pose, tip_pose
from multiarm.scene import Scene

KINDS = (
    ("weld", "ball", "revolute", "prismatic", "cylindrical", "universal", "planar")
    + ("point_on_plane", "point_on_cylinder", "point_on_sphere")
)  # fmt: skip
CONTROLS = ("none", "constant", "gravity_compensation", "joint_pd", "harmonic")


@dataclass(frozen=True)
class _Robot:
    """A robot with a posture that is far from singular, and by how much it may be changed."""

    name: str
    tip: str
    posture: tuple[float, ...]
    torque: float
    lock: dict[str, float] = field(default_factory=dict)


_UR = (-0.26, -1.51, 1.79, 2.86, -1.31, 0.2)
_ROBOTS = (
    _Robot("ur3", "tool0", _UR, 1.0),
    _Robot("ur5", "tool0", _UR, 3.0),
    _Robot("ur10", "tool0", _UR, 6.0),
    _Robot(
        "panda", "panda_hand_tcp", (0.1, -0.4, 0.1, -2.36, 0.1, 2.75, 0.79), 3.0,
        {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
    ),
    _Robot("xarm7", "link_eef", (0.1, -0.4, 0.1, 1.2, 0.1, 1.4, 0.1), 3.0),
    _Robot(
        "textbook_6r", "tool", (-1.266, -0.323, 1.507, 0.947, 1.674, 0.402), 1.0,
    ),
)  # fmt: skip


def random_scene(rng: np.random.Generator) -> Scene:
    """A scene of two to four arms that hold one object, drawn at random; always assembled.

    Durations are 0.3 to 2 s and accuracies 1e-3 to 1e-10; every fourth scene requests an accuracy
    of its contact forces too.
    """
    count = int(rng.integers(2, 5))
    X_WO = _placement(rng)
    body, size = _object(rng, X_WO)
    arms, joints, torques = {}, [], {}
    first = rng.uniform(0.0, 2.0 * math.pi)
    for i in range(count):
        robot = _ROBOTS[rng.integers(len(_ROBOTS))]
        azimuth = first + 2.0 * math.pi * i / count + rng.uniform(-0.3, 0.3)
        outward = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        grip = X_WO[:3, 3] + size * outward + [0.0, 0.0, rng.uniform(-0.1, 0.1)]
        name, posture = f"arm{i}", np.array(robot.posture)
        posture += rng.uniform(-0.2, 0.2, posture.size)
        X_WT, base = _stand(robot, posture, grip, azimuth)
        arms[name] = {
            "robot": robot.name, "tip": robot.tip, "posture": posture.tolist(),
            "base": base, **({"lock": robot.lock} if robot.lock else {}),
        }  # fmt: skip
        joints.append({"arm": name, **_joint(rng, np.linalg.solve(X_WO, X_WT))})
        torques[name] = (robot.torque * rng.uniform(-1.0, 1.0, posture.size)).tolist()
    return Scene(
        name=f"{count} arms at random",
        gravity=DOWN if rng.random() < 0.8 else None,
        object=body,
        arms=arms,
        joints=joints,
        control=_control(rng, torques),
        effects={"joint_damping": float(10.0 ** rng.uniform(-1, 1))} if rng.random() < 0.6 else {},
        run={
            "duration": round(float(rng.uniform(0.3, 2.0)), 3),
            "output_step": 0.02,
            "accuracy": _accuracy(rng),
        },
    )


def _placement(rng: np.random.Generator) -> np.ndarray:
    """Pose of the object, about 0.6 m high."""
    from multiarm.spatial import quaternion_to_matrix

    X = np.eye(4)
    X[:3, 3] = [0.0, 0.0, rng.uniform(0.4, 0.8)]
    quaternion = rng.standard_normal(4)
    X[:3, :3] = quaternion_to_matrix(quaternion / np.linalg.norm(quaternion))
    return X


def _object(rng: np.random.Generator, X_WO: np.ndarray) -> tuple[dict[str, Any], float]:
    """The object and how far from its centre it is held [m]."""
    size = float(rng.uniform(0.15, 0.4))
    shapes: tuple[dict[str, Any], ...] = (
        {"box": (size * rng.uniform(0.7, 2.0, 3)).tolist()},
        {"sphere": size},
        {"cylinder": {"radius": size, "height": size * float(rng.uniform(0.3, 2.0))}},
    )
    return {
        "shape": shapes[rng.integers(3)],
        "mass": float(10.0 ** rng.uniform(-0.3, 1.6)),
        "pose": pose(X_WO[:3, 3], X_WO[:3, :3]),
        "twist": rng.uniform(-0.2, 0.2, 6).tolist() if rng.random() < 0.4 else [0.0] * 6,
    }, size


def _stand(
    robot: _Robot, posture: np.ndarray, grip: np.ndarray, azimuth: float
) -> tuple[np.ndarray, dict[str, Any]]:
    """Pose of the tip in the world, at ``grip``, and the upright base that puts it there."""
    X_BT = tip_pose(robot.name, robot.tip, posture, robot.lock)
    yaw = azimuth + math.pi - math.atan2(X_BT[1, 3], X_BT[0, 3])
    X_WB = np.eye(4)
    X_WB[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    X_WB[:3, 3] = grip - X_WB[:3, :3] @ X_BT[:3, 3]
    return X_WB @ X_BT, {"xyz": X_WB[:3, 3].tolist(), "rpy": [0.0, 0.0, yaw]}


def _joint(rng: np.random.Generator, X_OT: np.ndarray) -> dict[str, Any]:
    """A joint at the arm's tip, whose pose in the object is ``X_OT``."""
    kind = KINDS[rng.integers(len(KINDS))]
    joint: dict[str, Any] = {"kind": kind}
    if kind in ("point_on_cylinder", "point_on_sphere"):
        joint["radius"] = float(rng.uniform(0.1, 0.4))
        joint["at"] = pose(X_OT[:3, 3] - joint["radius"] * X_OT[:3, 0], X_OT[:3, :3])
    if kind in ("revolute", "prismatic", "cylindrical", "point_on_plane"):
        joint["normal" if kind == "point_on_plane" else "axis"] = rng.standard_normal(3).tolist()
    return joint


def _control(rng: np.random.Generator, torques: dict[str, list[float]]) -> dict[str, Any]:
    kind = CONTROLS[rng.integers(len(CONTROLS))]
    if kind == "constant":
        return {"kind": kind, "torques": torques}
    if kind == "joint_pd":
        return {
            "kind": kind,
            "stiffness": float(10.0 ** rng.uniform(1, 3)),
            "damping": float(10.0 ** rng.uniform(0, 2)),
            "gravity_compensation": bool(rng.random() < 0.7),
        }
    if kind == "harmonic":
        phase = {arm: rng.uniform(0, 6, len(values)).tolist() for arm, values in torques.items()}
        frequency = float(rng.uniform(0.5, 5.0))
        return {"kind": kind, "amplitude": torques, "frequency": frequency, "phase": phase}
    return {"kind": kind}


def _accuracy(rng: np.random.Generator) -> float | dict[str, float]:
    number = float(f"{10.0 ** rng.uniform(-10, -3):.1e}")
    if rng.random() < 0.75:
        return number
    return {"position": number, "rotation": 3 * number, "force": 1e3 * number}
