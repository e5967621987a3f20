"""Scenes with several objects: in hands, on hinges, free, and on a floor."""

from __future__ import annotations

from typing import Any

import numpy as np

GRAVITY = np.array([0.0, 0.0, -9.81])
START, TWIST = np.array([0.4, 0.9, 2.0]), np.array([0.3, -0.2, 0.5, 0.4, -1.1, 0.7])
HINGE, ON_PLATE = np.array([0.0, 0.0, 0.05]), np.array([0.15, 0.0, -0.05])
ARM = {"robot": "textbook_6r", "tip": "tool", "base": {"xyz": [-0.9, 0.0, 0.0]}}


def box(sides: list[float], mass: float, place: list[float], **more: Any) -> dict[str, Any]:
    return {"shape": {"box": sides}, "mass": mass, "pose": {"xyz": place}, **more}


def thrown_ball() -> dict[str, Any]:
    """A ball that nothing holds, beside a beam in the hand of an arm with a plate on a hinge."""
    ball = {
        "shape": {"sphere": 0.1}, "mass": 0.7, "pose": {"xyz": START.tolist()},
        "twist": TWIST.tolist(),
    }  # fmt: skip
    return {
        "name": "a ball beside a beam with a plate",
        "gravity": GRAVITY.tolist(),
        "objects": {
            "beam": box([0.4, 0.1, 0.1], 1.0, [0.0, 0.0, 0.6]),
            "ball": ball,
            "plate": box([0.3, 0.2, 0.02], 0.5, [-0.15, 0.0, 0.7], color="#33aa55"),
        },
        "arms": {"left": ARM},
        "joints": [
            {"arm": "left", "object": "beam", "kind": "weld", "at": {"xyz": [-0.2, 0.0, 0.0]}},
            {
                "between": ["plate", "beam"], "kind": "revolute", "axis": [0.0, 1.0, 0.0],
                "at": {"xyz": HINGE.tolist()}, "at_first": {"xyz": ON_PLATE.tolist()},
            },
        ],
        "effects": {"joint_damping": 0.5},
        "run": {"duration": 0.3, "accuracy": 1e-6, "output_step": 0.05},
    }  # fmt: skip


def boxes_on_a_floor() -> dict[str, Any]:
    """A light and a heavy box at rest on a floor, beside one that an arm holds."""
    return {
        "name": "boxes on a floor",
        "gravity": GRAVITY.tolist(),
        "objects": {
            "held": box([0.2, 0.1, 0.1], 1.0, [0.0, 0.0, 0.6]),
            "light": box([0.2, 0.2, 0.2], 2.0, [0.5, 0.8, 0.1]),
            "heavy": box([0.3, 0.3, 0.1], 5.0, [1.0, 0.8, 0.05]),
        },
        "arms": {"left": ARM},
        "joints": [{"arm": "left", "object": "held", "kind": "weld", "at": {"xyz": [-0.1, 0, 0]}}],
        "effects": {"floor": {"mu": 0.4}},
        "run": {"duration": 0.05, "integrator": "dop853", "tolerance": 1e-8},
    }
