"""One scene, five joints: a hinge written in three ways, an egg that slides and one that rolls.

Shows that a joint is a set of contacts: the three hinges move alike to rounding error, whatever
they are made of, and a curved pad on a flat face needs no more than the two shapes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import multiarm as ma
from multiarm.spatial import matrix_to_quaternion

SCENE = Path(__file__).parent / "scenes" / "hinged_box.yaml"

# In the frame of the tip, whose y axis is vertical and whose z axis points into the box.
PIN = {"point": [0, 0, 0], "axis": [0, 1, 0], "radius": 0.04}
END_OF_PIN = {"point": [0, 0.05, 0], "normal": [0, 1, 0]}
POINTS = [[0.04, 0.05, 0], [0, 0.05, 0.04], [0.04, -0.05, 0], [0, -0.05, 0.04]]
EGG = {"ellipsoid": {"center": [0, 0, -0.05], "semi_axes": [0.06, 0.04, 0.05]}}
END_FACE = {"plane": {"point": [0.6, 0, 0], "normal": [1, 0, 0]}}


def joints(tip_on_box: dict) -> dict[str, dict]:
    """Joints of the right arm; ``tip_on_box`` is the pose of its tip in the box at the start."""
    contacts = [{"arm": {"point": p}, "object": {"cylinder": PIN}} for p in POINTS]
    contacts.append({"arm": {"point": [0, 0.05, 0]}, "object": {"plane": END_OF_PIN}})
    all_but_turning_about_y = np.eye(6)[[0, 1, 2, 3, 5]].tolist()
    return {
        "hinge": {"kind": "revolute", "axis": [0, 1, 0]},
        "hinge of contacts": {"kind": "contacts", "at": tip_on_box, "contacts": contacts},
        "hinge of wrenches": {"kind": "wrenches", "wrenches": all_but_turning_about_y},
        "egg that slides": {"kind": "contacts", "contacts": [{"arm": EGG, "object": END_FACE}]},
        "egg that rolls": {
            "kind": "contacts",
            "contacts": [{"arm": EGG, "object": END_FACE, "rolling": True}],
        },
    }


def main() -> None:
    """Swing the box by the same torques, without gravity, with each of the joints."""
    written = ma.load_scene(SCENE)
    start = ma.compile_system(written)
    pose = start.frames["right"].on_object @ np.linalg.inv(start.frames["right"].on_tip)
    turn = matrix_to_quaternion(np.ascontiguousarray(pose[:3, :3]))
    tip_on_box = {"xyz": pose[:3, 3].tolist(), "quaternion_xyzw": turn.tolist()}
    control = {"kind": "harmonic", "frequency": 1.0, "amplitude": {"left": 8.0, "right": 4.0}}
    hinge = None
    for name, joint in joints(tip_on_box).items():
        scene = written.replace(
            gravity=None,
            joints=[{"arm": "left", "kind": "weld"}, {"arm": "right", **joint}],
            control=control,
            effects={"joint_damping": 5.0},
        )
        system = ma.compile_system(scene)
        run = ma.simulate(system, duration=1.0, accuracy=1e-8)
        free = ", ".join(run.relative_motion_labels["right"])
        print(f"{name}: {len(system.contacts['right'])} rows; free: {free}")
        gap = run.position_drift.max()
        print(f"  {run.status}, largest gap {gap:.0e} m", end="")
        if name.startswith("hinge"):
            hinge = hinge or run
            apart = abs(run.object_position - hinge.object_position).max()
            print(f", turned by {run.relative_position['right'][-1, 0]:+.6f} rad", end="")
            print(f", box {apart:.0e} m from the first hinge", end="")
        print()


if __name__ == "__main__":
    main()
