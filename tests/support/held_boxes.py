"""Scenes of two boxes and two UR5s that hold one of them, or one each."""

from __future__ import annotations

from typing import Any

import numpy as np

import multiarm as ma
from multiarm.assembly.start import project_start
from multiarm.dynamics.coordinates import retract
from multiarm.dynamics.state import State
from multiarm.scene import parse_scene

WELD = {"between": ["plate", "beam"], "kind": "weld", "at": {"xyz": [0.1, 0.0, 0.06]}}
"""The plate on the beam."""
ON_HINGE = {
    "between": ["plate", "beam"], "kind": "revolute", "axis": [0, 1, 0],
    "at": {"xyz": [0.3, 0.0, 0.06]}, "at_first": {"xyz": [0.2, 0.0, 0.0]},
}  # fmt: skip
"""The plate, which swings about its edge."""
TO_WORLD = {
    "between": ["beam", "world"], "kind": "revolute", "axis": [0, 1, 0],
    "at": {"xyz": [0, 0, 0.5]},
}  # fmt: skip
"""The beam on a hinge of the world."""
LEFT, RIGHT = (
    {"at": {"xyz": [side * 0.6, 0, 0], "rpy": [0, -side * np.pi / 2, 0]}} for side in (-1, 1)
)


def two_boxes(*joints: dict[str, Any], **parts: Any) -> dict[str, Any]:
    """Two UR5s at a beam, a plate above it, and further joints."""
    return {
        "gravity": [0.0, 0.0, -9.81],
        "objects": {
            "beam": {
                "shape": {"box": [1.2, 0.1, 0.1]}, "mass": 8.0, "pose": {"xyz": [0, 0, 0.5]},
            },
            "plate": {
                "shape": {"box": [0.4, 0.3, 0.02]}, "mass": 2.0, "pose": {"xyz": [0.1, 0, 0.56]},
            },
        },
        "arms": _arms(0.95),
        "joints": [
            {"arm": "left", "object": "beam", "kind": "weld", **LEFT},
            {"arm": "right", "object": "beam", "kind": "weld", **RIGHT},
            *joints,
        ],
        **parts,
    }  # fmt: skip


def box_in_each_hand(*joints: dict[str, Any], **parts: Any) -> dict[str, Any]:
    """A box in the hand of each of two UR5s, 0.2 m apart, and further joints."""
    size = {"shape": {"box": [0.2, 0.1, 0.1]}, "mass": 3.0}
    grip = {"kind": "weld", "size": 0.05}
    hands = [
        {"arm": arm, "object": name, **grip,
         "at": {"xyz": [side * 0.1, 0, 0], "rpy": [0, -side * np.pi / 2, 0]}}
        for arm, name, side in (("left", "first", -1), ("right", "second", 1))
    ]  # fmt: skip
    return {
        "gravity": [0.0, 0.0, -9.81],
        "objects": {
            "first": {**size, "pose": {"xyz": [-0.2, 0, 0.5]}},
            "second": {**size, "pose": {"xyz": [0.2, 0, 0.5]}},
        },
        "arms": _arms(0.8),
        "joints": [*hands, *joints],
        **parts,
    }


SLIDE = {
    "between": ["first", "second"], "name": "slide", "kind": "cylindrical", "axis": [1, 0, 0],
    "at": {"xyz": [-0.2, 0, 0]}, "at_first": {"xyz": [0.2, 0, 0]}, "size": 0.05,
}  # fmt: skip
"""The first box slides along x in the second, and turns about x."""


def _arms(away: float) -> dict[str, Any]:
    left, right = (
        {"robot": "ur5", "base": {"xyz": [side * away, 0, 0], **turn}, "posture": "solve"}
        for side, turn in ((-1, {}), (1, {"rpy": [0, 0, np.pi]}))
    )
    return {"left": left, "right": right}


def compiled(scene: dict[str, Any], **parts: Any) -> ma.System:
    """The system of a scene with further parts."""
    return ma.compile_system(parse_scene({**scene, **parts}))


def moving_state(system: ma.System, seed: int) -> State:
    """A state off the start, with velocities that the joints allow."""
    rng, start = np.random.default_rng(seed), system.initial_state()
    layout = start.layout
    position = retract(layout, start.position, 0.004 * rng.standard_normal(layout.nv))
    state = State(position, 0.2 * rng.standard_normal(layout.nv), layout)
    with system.borrow() as data:
        return project_start(data, system.scene, state)[0]
