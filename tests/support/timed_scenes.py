"""Scenes whose joints hold for some of the time, with known motion: carts on rails, pendulums."""

from __future__ import annotations

from typing import Any

import numpy as np
from event_scenes import arm

import multiarm as ma
from multiarm.scene import parse_scene

Table = dict[str, Any]

EXACT: Table = {"tolerance": 1e-12, "integrator": "dop853"}
"""Options of runs that are compared with closed forms."""
AFTER = 1e-6 * np.array([1.0, 2.0, 3.0])
"""Times after an event from which a quantity at it is extrapolated [s]."""


def simulate(table: Table, duration: float, times: Any = None, **more: Any) -> ma.Trajectory:
    """A completed run; ``times`` are those of the samples."""
    more = {**EXACT, **more}
    if "accuracy" in more:
        more = {key: value for key, value in more.items() if key not in EXACT}
    if times is not None:
        more["output_times"] = times
    trajectory = ma.simulate(ma.compile_system(parse_scene(table)), duration, **more)
    assert trajectory.status == "completed", trajectory.message
    return trajectory


def at_event(samples: np.ndarray) -> np.ndarray:
    """A quantity at an event from its samples at :data:`AFTER`, in front of others or alone.

    The parabola through them errs by their third difference, here below 1e-15 of the quantity.
    """
    return 3.0 * samples[0] - 3.0 * samples[1] + samples[2]


def switches(trajectory: ma.Trajectory) -> list[Table]:
    """Events at which joints take hold or let go."""
    return [e for e in trajectory.events if e["kind"] in ("attached", "detached")]


def held_never(table: Table, *names: str) -> Table:
    """A scene in which the joints of some names, or of some arms, do not hold at any time."""
    joints = []
    for joint in table["joints"]:
        if {joint.get("name"), joint.get("arm")} & set(names):
            joint = {key: value for key, value in joint.items() if key != "until"}
            joint |= {"from": "never"}
        joints.append(joint)
    return table | {"joints": joints}


def last_state(system: ma.System, trajectory: ma.Trajectory) -> ma.State:
    """The state at the last sample of a run."""
    return system.state(
        objects={
            name: {
                "position": motion.position[-1],
                "quaternion_xyzw": motion.quaternion_xyzw[-1],
                "twist": motion.twist[-1],
            }
            for name, motion in trajectory.objects.items()
        },
        joint_positions={name: trajectory.joint_positions[name][-1] for name in system.arms},
        joint_velocities={name: trajectory.joint_velocities[name][-1] for name in system.arms},
    )


# --- carts on a rail along x ----------------------------------------------------------------------


def carts(object_speed: float, rails: dict[str, Table], **more: Any) -> Table:
    """Arms of one slide along x, all of whose mass is in their tip, and an object of 3 kg.

    ``rails``: mass, velocity [m/s] and place [m] of each, and the rest of its joint.
    """
    arms, joints = {}, []
    for name, rail in rails.items():
        arms[name] = arm(
            "x", velocity=[rail["velocity"]], mass=rail["mass"], base={"xyz": [rail["x"], 0.0, 0.0]}
        )
        joints.append({"arm": name, "kind": "weld", **rail.get("joint", {})})
    body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 3.0, "pose": {"xyz": [0.0, 0.0, 0.0]},
            "twist": [object_speed, 0, 0, 0, 0, 0]}  # fmt: skip
    return {"gravity": None, "object": body, "arms": arms, "joints": joints, **more}


def objects_on_rails(masses: list[float], speeds: list[float], coupling: Table) -> Table:
    """Two objects that slide along x, each on a joint with the world, and their coupling."""
    objects, joints = {}, []
    for k, (mass, speed) in enumerate(zip(masses, speeds, strict=True)):
        x = 1.0 * k
        objects[f"cart{k}"] = {
            "mass": mass, "inertia": [0.1, 0.2, 0.15], "pose": {"xyz": [x, 0.0, 0.0]},
            "twist": [speed, 0, 0, 0, 0, 0],
        }  # fmt: skip
        joints.append({"between": [f"cart{k}", "world"], "name": f"rail{k}", "kind": "prismatic",
                       "axis": [1, 0, 0], "at": {"xyz": [x, 0.0, 0.0]}})  # fmt: skip
    joints.append({"between": ["cart0", "cart1"], "name": "coupling", **coupling})
    return {"gravity": None, "objects": objects, "joints": joints}


# --- pendulums ------------------------------------------------------------------------------------

# Of a pendulum about y at the origin: mass [kg], from pivot to centre [m], moment about the centre
# [kg m^2], gravity [m/s^2].
BOB, LENGTH, MOMENT, FALL = 2.0, 0.6, 0.05, 9.81
ABOUT_PIVOT = MOMENT + BOB * LENGTH**2


def pendulum(angle: float, rate: float, arms: Table, joints: list[Table], **more: Any) -> Table:
    """An object on a hinge about y with the world, at an angle from hanging."""
    along = np.array([np.sin(angle), 0.0, np.cos(angle)])
    across = np.array([np.cos(angle), 0.0, -np.sin(angle)])
    body = {
        "mass": BOB, "inertia": [0.03, MOMENT, 0.04],
        "pose": {"xyz": (-LENGTH * along).tolist(), "rpy": [0.0, angle, 0.0]},
        "twist": [*(-LENGTH * rate * across).tolist(), 0.0, rate, 0.0],
    }  # fmt: skip
    pivot = {"between": ["object", "world"], "name": "pivot", "kind": "revolute",
             "axis": [0, 1, 0], "at": {}, "at_first": {"xyz": [0.0, 0.0, LENGTH]}}  # fmt: skip
    return {"gravity": [0, 0, -FALL], "object": body, "arms": arms,
            "joints": [pivot, *joints], **more}  # fmt: skip
