"""Scenes of robots that hold each other, whose motion is known.

A block that the world holds is the object; no robot has to do with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from event_scenes import arm
from object_scenes import DOWN, SLED
from tree_models import placement, pose_of, read_tree_scene, start_of
from tree_oracle import Motions
from tree_scenes import together

from multiarm.problems.building import DOWN_IN_PLANE, own_urdf
from multiarm.problems.linkages import Body, FourBar, OneFreedom
from multiarm.problems.loops import WELDED_START

BLOCK = {"mass": 1.0, "inertia": [0.01, 0.01, 0.01], "pose": {"xyz": [0.0, 0.0, 5.0]}}
ASIDE = {"between": ["block", "world"], "kind": "weld", "name": "aside"}


def joined_scene(joints: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    """The scene without gravity, if none is written; joints without ``at`` are where tips are."""
    scene = {"name": "joined", "gravity": None, "objects": {"block": dict(BLOCK)}, **more}
    return together({**scene, "joints": [*joints, dict(ASIDE)]})


# --- two satellites ------------------------------------------------------------------------------

POSTURES = {"left": [0.2, -1.0, 1.2, 0.3, 0.5, -0.2], "right": [-0.4, -1.3, 0.9, -0.5, 0.8, 0.3]}


def satellites(joint: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Two UR5s on bases that float, hand in hand; ``joint`` is between ``left`` and ``right``."""
    robots = {}
    for name, side in (("left", 1.0), ("right", -1.0)):
        base = {
            "moves": "free", "xyz": [-0.6 * side, 0.1, 0.3], "rpy": [0.3, -0.4, 0.5 * side],
            "mass": 40.0 - 10.0 * side, "inertia": [3.0, 3.0, 2.0],
        }  # fmt: skip
        robots[name] = {
            "robot": "ur5", "base": base, "tips": {"hand": "tool0"}, "posture": POSTURES[name],
        }  # fmt: skip
    shake = {"between": ["left/hand", "right/hand"], "name": "shake", **joint}
    return joined_scene([shake], robots=robots, **more)


# --- two arms of two joints ----------------------------------------------------------------------

# The second links of both are one coupler.
WELDED = FourBar(crank=0.5, coupler=0.8, rocker=0.5, ground=0.9, side=1)


def welded_motion() -> OneFreedom:
    """Two planar_2r arms welded to each other; the coordinate is the left arm's first angle."""
    link = Body(3.0, np.diag([0.0013, 0.0629, 0.0634]))
    half = np.diag([0.000717333333, 0.026933333333, 0.027117333333])
    away = 2.0 * (0.4 - 0.2) ** 2 * np.diag([0.0, 1.0, 1.0])
    coupler = Body(4.0, 2.0 * (half + away))
    return OneFreedom(
        (link, coupler, link),
        lambda s: WELDED.poses(s, 0.25, 0.4, 0.25),
        np.array(DOWN_IN_PLANE),
        (-2.0, -0.6),
        degree=80,
    )


def welded_arms() -> dict[str, Any]:
    """At rest; the arms are joined by their names."""
    angle = WELDED_START
    phi, psi = WELDED.angles(angle)
    base = {"xyz": [WELDED.ground, 0.0, 0.0]}
    crank = {"urdf": own_urdf("planar_2r"), "tip": "tip"}
    arms = {
        "left": {**crank, "posture": [angle, phi - angle]},
        "right": {**crank, "base": base, "posture": [psi, phi + np.pi - psi]},
    }
    at = {"rpy": [0.0, 0.0, np.pi]}
    joint = {"between": ["left", "right"], "kind": "weld", "at": at, "at_first": {}}
    return joined_scene([joint], arms=arms, gravity=DOWN_IN_PLANE)


# --- contacts that only push ---------------------------------------------------------------------


def load_on_sled(speed: float) -> dict[str, Any]:
    """A load that slides along x on a sled: tips of two robots of slides, as ``object_scenes``."""
    m, mu = SLED.values()
    arms = {
        "load": arm("zx", velocity=[0.0, speed], mass=m[0]),
        "sled": arm("x", mass=m[1]),
    }
    foot = {
        "between": ["load", "sled"], "kind": "point_on_plane", "mu": mu, "at": {}, "at_first": {},
    }  # fmt: skip
    effects = {"unilateral_contacts": {"start": "as_written"}}
    return joined_scene([foot], arms=arms, gravity=DOWN, effects=effects)


BLOW = {"m": (0.4, 2.0), "height": 0.1}


def hammer_and_anvil(speed: float, restitution: float) -> dict[str, Any]:
    """A hammer that flies along -z at an anvil at rest, each on a slide."""
    m, height = BLOW.values()
    arms = {
        "hammer": arm("z", posture=[height], velocity=[-speed], mass=m[0]),
        "anvil": arm("z", mass=m[1]),
    }
    contact = {
        "between": ["hammer", "anvil"], "name": "blow", "kind": "point_on_plane", "at": {},
        "at_first": {},
    }  # fmt: skip
    effects = {"unilateral_contacts": {"start": "as_written", "restitution": restitution}}
    return joined_scene([contact], arms=arms, effects=effects)


def colliding_satellites(speed: float, gap: float, **contact: float) -> dict[str, Any]:
    """The hand of one satellite flies at a plane that the other carries on its hand, which turns.

    speed : of the hand along the normal of the plane [m/s]
    gap : between both [m]
    contact : ``restitution``, and ``mu`` of the joint
    """
    effects = {
        "unilateral_contacts": {"start": "as_written", "restitution": contact.pop("restitution")}
    }
    scene = satellites({"kind": "point_on_plane", **contact}, effects=effects)
    trees = read_tree_scene(scene)
    joint = scene["joints"][0]
    hand = Motions(trees, start_of(scene, trees)).frame(trees.connections[0].first)
    away = pin.SE3(np.eye(3), np.array([0.0, 0.0, -gap]))
    joint["at"] = pose_of(placement(joint["at"]) * away)
    velocity = -speed * hand.rotation[:, 2] + 0.3 * speed * hand.rotation[:, 0]
    scene["robots"]["left"]["base"]["twist"] = [*velocity.tolist(), 0.0, 0.0, 0.0]
    return scene
