"""Scenes of robots with several tips or on floating bases, as plain tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from event_scenes import arm
from random_trees import close_joints, random_hand
from tree_models import pose_of, read_tree_scene, start_of
from tree_oracle import least_change

DOWN = [0.0, 0.0, -9.81]
# Torso [m], then each arm [rad]: hands 1.1 m above the floor, one in front of each shoulder.
CART_ARM = [0.0, 0.6, -1.5, 0.0, 0.9, 0.0]
CART_POSTURE = [0.0, 0.0, 0.0, 0.15, *CART_ARM, *CART_ARM]


def together(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene with its joints, where they have no ``at``, at the frames of the FIRST bodies."""
    here = pin.SE3.Identity()
    close_joints(scene, start_of(scene, read_tree_scene(scene)), lambda joint: (here, here))
    return scene


def gripper_loops(name: str) -> list[dict[str, Any]]:
    """The hinges that close the two linkages of a ``four_bar_gripper``."""
    return [
        {
            "between": [f"{name}/{side}_follower_end", f"{name}/{side}_coupler"],
            "kind": "revolute",
            "name": f"{side}_loop",
            "at": pose_of(pin.SE3.Identity()),
            "at_first": pose_of(pin.SE3.Identity()),
        }
        for side in ("left", "right")
    ]


def gripper_scene(position: float = 0.3) -> dict[str, Any]:
    """A four-bar gripper above a box, which its left pad holds and its right pad touches."""
    pads = {"left": "left_pad", "right": "right_pad"}
    scene = {
        "name": "four-bar gripper",
        "gravity": DOWN,
        "object": {
            "shape": {"box": [0.04, 0.05, 0.08]},
            "mass": 0.4,
            "inertia": [0.4 / 12.0 * square for square in (0.0089, 0.0080, 0.0041)],
            "pose": {"xyz": [0.0, 0.0, 0.34]},
        },
        "robots": {
            "gripper": {
                "robot": "four_bar_gripper",
                "base": {"xyz": [0.0, 0.0, 0.5], "rpy": [np.pi, 0.0, 0.0]},
                "tips": pads,
                "posture": [position] * 6,
            }
        },
        "joints": [
            {"arm": "gripper/left", "kind": "weld"},
            {"arm": "gripper/right", "kind": "planar"},
            *gripper_loops("gripper"),
        ],
        "control": {"kind": "constant", "torques": {"gripper": [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]}},
    }
    return together(scene)


def cart_scene() -> dict[str, Any]:
    """A cart that moves in the plane and holds a box with both hands."""
    moves = {"moves": ["x", "y", "yaw"], "mass": 10.0, "inertia": [0.5, 0.5, 0.8]}
    return together(
        {
            "name": "cart with a box",
            "gravity": DOWN,
            "object": {
                "shape": {"box": [0.3, 0.5, 0.2]},
                "mass": 3.0,
                "inertia": [0.0725, 0.0325, 0.085],
                "pose": {"xyz": [0.8, 0.0, 1.1]},
            },
            "robots": {
                "cart": {
                    "robot": "dual_arm_cart",
                    "base": moves,
                    "tips": {"left": "left_tool", "right": "right_tool"},
                    "posture": list(CART_POSTURE),
                }
            },
            "joints": [
                {"arm": "cart/left", "kind": "weld"},
                {"arm": "cart/right", "kind": "weld"},
            ],
            "control": {
                "kind": "constant",
                "torques": {"cart": [1.0, -2.0, 0.5, 320.0, *[0.5] * 12]},
            },
        }
    )


def satellite_scene(gravity: list[float] | None = None, **changes: Any) -> dict[str, Any]:
    """A robot that floats and holds a box, all of it in motion."""
    moments = [3.0, 3.0, 2.0, 0.0]
    base = {
        "moves": "free", "xyz": [0.1, -0.2, 0.3], "rpy": [0.3, -0.4, 0.5], "mass": 40.0,
        "inertia": moments[:3], "twist": [0.1, -0.2, 0.05, 0.2, 0.1, -0.3],
    }  # fmt: skip
    hand = {"hand": "tool0"}
    return together(
        {
            "name": "satellite",
            "gravity": gravity,
            "object": {
                "shape": {"box": [0.2, 0.3, 0.1]},
                "mass": 2.0,
                "inertia": [0.0167, 0.0083, 0.0217],
                "pose": {"xyz": [0.5, 0.1, 0.4]},
            },
            "robots": {
                "sat": {
                    "robot": "ur5", "base": base, "tips": hand,
                    "posture": [0.2, -1.0, 1.2, 0.3, 0.5, -0.2],
                }
            },
            "joints": [{"arm": "sat/hand", "kind": "weld"}],
            "control": {
                "kind": "harmonic",
                "hold": False,
                "frequency": 0.5,
                "amplitude": {"sat": [4.0, -6.0, 5.0, 0.8, 0.6, -0.4]},
            },
            **changes,
        }
    )  # fmt: skip


def hanging_scene(**changes: Any) -> dict[str, Any]:
    """The satellite at rest, its base on a ball joint in the world, its joints on springs."""
    base = {"between": ["sat/base_link", "world"], "kind": "ball"}
    springs = {"stiffness": 200.0, "damping": 50.0, "gravity_compensation": False}
    joints, control = [{"arm": "sat/hand", "kind": "weld"}, base], {"kind": "joint_pd", **springs}
    scene = satellite_scene(DOWN, **{"joints": joints, "control": control, **changes})
    del scene["robots"]["sat"]["base"]["twist"]
    return scene


def humanoid_scene() -> dict[str, Any]:
    """A humanoid robot with both hands on a box and both feet on the ground."""
    feet = {"left_foot": "left_ankle_roll_link", "right_foot": "right_ankle_roll_link"}
    hands = {"left": "left_rubber_hand", "right": "right_rubber_hand"}
    return together(
        {
            "name": "humanoid with a box",
            "gravity": DOWN,
            "object": {
                "shape": {"box": [0.2, 0.3, 0.2]},
                "mass": 3.0,
                "inertia": [0.0325, 0.02, 0.0325],
                "pose": {"xyz": [0.3, 0.0, 1.0]},
            },
            "robots": {
                "g1": {
                    "robot": "g1_29dof_rev_1_0",
                    "base": {"moves": "free", "xyz": [0.0, 0.0, 0.79], "rpy": [0.02, 0.05, 0.1]},
                    "tips": {**hands, **feet},
                }
            },
            "joints": [
                *[{"arm": f"g1/{tip}", "kind": "weld"} for tip in hands],
                *[{"between": [f"g1/{tip}", "world"], "kind": "weld"} for tip in feet],
            ],
        }
    )


def quadruped_scene(drop: float) -> dict[str, Any]:
    """A quadruped robot with a box on its back, whose feet are ``drop`` [m] above the ground."""
    feet = {"fl": "FL_FOOT", "fr": "FR_FOOT", "hl": "HL_FOOT", "hr": "HR_FOOT"}
    below = 0.2447495  # [m], of the feet in this posture
    up = drop + below
    contact = {"kind": "point_on_plane", "mu": 0.8, "at": {}, "at_first": {}}
    return {
        "name": "quadruped",
        "gravity": DOWN,
        "object": {
            "shape": {"box": [0.1, 0.1, 0.05]},
            "mass": 0.5,
            "inertia": [0.00052, 0.00052, 0.00083],
            "pose": {"xyz": [0.0, 0.0, up + 0.1]},
        },
        "robots": {
            "solo": {
                "robot": "solo12",
                "base": {"moves": "free", "xyz": [0.0, 0.0, up]},
                "tips": {"back": "base_link", **feet},
                "posture": [*[0.0, 0.7, -1.4] * 2, *[0.0, -0.7, 1.4] * 2],
            }
        },
        "joints": [
            {"arm": "solo/back", "kind": "weld"},
            *[{"between": [f"solo/{foot}", "world"], **contact} for foot in feet],
        ],
        "effects": {"unilateral_contacts": {"start": "as_written"}},
        "control": {
            "kind": "joint_pd",
            "stiffness": 20.0,
            "damping": 0.5,
            "gravity_compensation": False,
        },
    }


def turned_gripper(moves: tuple[str, ...] = ()) -> dict[str, Any]:
    """A moving four-bar gripper in general position that carries a box with its left pad.

    Four rows hold its hinges in their planes, which they are in anyway: these rows are zero but for
    roundings.
    """
    base, count = {"xyz": [0.1, 0.2, 0.5], "rpy": [0.3, 0.5, 0.7]}, len(moves)
    scene = gripper_scene()
    gripper = scene["robots"]["gripper"]
    gripper["base"] = {**base, "moves": list(moves)} if moves else base
    gripper["posture"] = [0.1] * count + [0.3] * 6
    gripper["velocity"] = [0.2] * count + [0.8] * 6
    torques = [0.1] * count + [0.5, 0.0, 0.0, 0.0, 0.0, 0.0]
    scene["control"] = {"kind": "constant", "torques": {"gripper": torques}}
    scene["joints"] = [{"arm": "gripper/left", "kind": "weld"}, *gripper_loops("gripper")]
    scene = together(scene)
    trees = read_tree_scene(scene)
    state = least_change(trees, start_of(scene, trees))
    scene["object"]["twist"] = state.object_twist.tolist()
    gripper["velocity"] = state.joint_velocities["gripper"].tolist()
    return scene


def coupled_hand(
    folder: Path,
    fingers: tuple[int, ...] = (2, 2, 2),
    away: float = 0.0,
    off: float = 0.0,
    kind: str = "ball",
) -> dict[str, Any]:
    """A hand that holds an object with its fingers, and whose second joint copies its first one.

    All of it is ``away`` [m] from the world's origin, along x.  The copy is ``off`` [rad] at the
    start, where the joints of this ``kind`` are closed.
    """
    path = folder / "hand.urdf"
    random_hand(np.random.default_rng(4), path, list(fingers), copies=False)
    tips = {f"tip_{k}": f"link_{end}" for k, end in enumerate(np.cumsum(fingers))}
    return together(
        {
            "gravity": None,
            "object": {
                "mass": 1.0,
                "inertia": [0.004, 0.004, 0.004],
                "pose": {"xyz": [away + 0.3, 0.0, 0.0]},
            },
            "robots": {
                "hand": {
                    "urdf": str(path),
                    "base": {"xyz": [away, 0.0, 0.0]},
                    "tips": tips,
                    "posture": [0.2, 0.2 + off, *[0.2] * (sum(fingers) - 2)],
                    "mimic": {"joint_2": {"of": "joint_1"}},
                }
            },
            "joints": [{"arm": f"hand/{tip}", "kind": kind} for tip in tips],
        }
    )


def arm_joined_twice(**more: Any) -> dict[str, Any]:
    """An arm of two hinges, with ranges of 2 rad to both sides, with two joints to the object."""
    return {
        "gravity": None,
        "object": {"shape": {"sphere": 0.1}, "mass": 1.0},
        "arms": {"left": arm("ZY", posture=[0.1, 0.3], ends=2.0)},
        "joints": [
            {"arm": "left", "kind": "ball"},
            {"between": ["left", "object"], "kind": "weld"},
        ],
        **more,
    }


def link_urdf(name: str, mass: float = 1.0) -> str:
    """A link with a centre of mass at its origin [kg]."""
    moments = " ".join(f"{name}='{0.1 * mass}'" for name in ("ixx", "iyy", "izz"))
    inertia = f"<inertia {moments} ixy='0' ixz='0' iyz='0'/>"
    inertial = f"<mass value='{mass}'/>{inertia}"
    return f"<link name='{name}'><inertial>{inertial}</inertial></link>"


def hinge_urdf(child: str) -> str:
    """A hinge about z that carries a link on the link ``root``."""
    limit = "<limit lower='-2' upper='2' effort='9' velocity='9'/>"
    return (
        f"<joint name='{child}_hinge' type='revolute'><parent link='root'/><child link='{child}'/>"
        f"<axis xyz='0 0 1'/>{limit}</joint>"
    )


def two_finger_scene(path: Path, xyz: str, rpy: str, joint: dict[str, Any]) -> dict[str, Any]:
    """A hand whose thumb carries the object; behind its finger a fixed joint carries the tip.

    ``joint`` is between thumb and tip; the URDF is written to ``path``.
    """
    fixed = f"<parent link='finger'/><child link='end'/><origin xyz='{xyz}' rpy='{rpy}'/>"
    parts = [link_urdf(name) for name in ("root", "thumb", "finger")]
    parts += ["<link name='end'/>", hinge_urdf("thumb"), hinge_urdf("finger")]
    parts.append(f"<joint name='fixed' type='fixed'>{fixed}</joint>")
    path.write_text(f"<robot name='hand'>{''.join(parts)}</robot>")
    hand = {"urdf": str(path), "tips": {"thumb": "thumb", "end": "end"}, "posture": [0.2, -0.3]}
    return {
        "name": "two fingers",
        "object": {"mass": 1.0, "inertia": [0.1, 0.1, 0.1], "pose": {"xyz": [0.0, 0.0, 1.0]}},
        "robots": {"hand": hand},
        "joints": [
            {"between": ["hand/thumb", "object"], "kind": "weld", "name": "grip"},
            {"name": "loop", **joint},
        ],
    }


def floating_scene(path: Path, links: str, tip: str, posture: list[float], **more: Any):
    """A robot that floats and holds the object with a link; the URDF is written to ``path``."""
    path.write_text(f"<robot name='sat'>{links}</robot>")
    robot = {"urdf": str(path), "base": {"moves": "free"}, "tips": {"tip": tip}, "posture": posture}
    return {
        "name": "floating",
        "object": {"mass": 1.0, "inertia": [0.1, 0.1, 0.1], "pose": {"xyz": [0.0, 0.0, 1.0]}},
        "robots": {"sat": robot},
        "joints": [{"arm": "sat/tip", "kind": "weld"}],
        **more,
    }
