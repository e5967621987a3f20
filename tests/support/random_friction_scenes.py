"""Random scenes with unilateral contacts and dry friction, as plain tables in the form of files.

All contacts are between a point or a sphere of one body and a plane of another, so that gaps and
slips follow from the written geometry alone.  Scenes may be drawn that rigid bodies with friction
cannot follow (Painleve's paradox): only in the family ``thrown``, where mu goes up to 3, are they
to be expected.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from mechanics import UR5_POSTURE

from multiarm.problems.building import tip_pose

Table = dict[str, Any]

DOWN = [0.0, 0.0, -9.81]
# Radius of a fingertip, and of the circle of the fingertips of a hand [m].
FINGERTIP, HAND = 0.02, 0.06
# A point far above the scene: a scene without robots needs a joint.
CEILING = 50.0  # [m]
HANDS = {"left": -1.0, "right": 1.0}
"""Hands, and the side along x on which they are."""
UR5_EFFORT = np.array([3.0, 10.0, 8.0, 1.0, 1.0, 0.5])
"""Sizes of torques with which the joints of a UR5 begin to move a box of some kilograms [N m]."""


def draw(family: str, seed: int) -> Table:
    """A scene of a family; the same for the same seed."""
    rng = np.random.default_rng([list(FAMILIES).index(family), seed])
    scene = FAMILIES[family](rng)
    scene["name"] = f"{family} {seed}"
    duration = round(float(rng.uniform(0.2, 0.5)), 2)
    return scene | {"run": {"duration": duration, "output_step": 0.005}}


# --- parts ----------------------------------------------------------------------------------------


def _number(rng: np.random.Generator, low: float, high: float) -> float:
    """Three digits, so that scenes can be read."""
    return float(f"{rng.uniform(low, high):.3g}")


def _restitution(rng: np.random.Generator) -> float:
    return float(rng.choice([0.0, 0.0, 0.3, _number(rng, 0.0, 1.0), 1.0]))


def box_corners(sizes: Any) -> np.ndarray:
    """Corners about the centre, shape (8, 3)."""
    return np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * np.array(sizes)


@cache
def _tip() -> np.ndarray:
    """Pose of the tip of a UR5 in its base, the arm before it."""
    return tip_pose("ur5", "tool0", tuple(UR5_POSTURE))


def hand(side: float, face: np.ndarray) -> Table:
    """A UR5 whose tip is at a point of a face that looks along ``side`` x."""
    x, y, z = _tip()[:3, 3]
    turn = 0.0 if side < 0.0 else math.pi
    base = face + side * np.array([x, y, 0.0]) - [0.0, 0.0, z]
    return {
        "robot": "ur5", "tip": "tool0", "posture": list(UR5_POSTURE),
        "base": {"xyz": base.tolist(), "rpy": [0.0, 0.0, turn]},
    }  # fmt: skip


def _on_tip(points: np.ndarray) -> np.ndarray:
    """Vectors in the base's axes, shape (k, 3), in the tip's axes."""
    return points @ _tip()[:3, :3]


def fingertips(count: int, side: float, half: float, first: float) -> list[Table]:
    """Spherical fingertips on a circle that touch the face of an object at ``side * half``."""
    angles = first + 2.0 * math.pi * np.arange(count) / count
    ring = np.column_stack([0.0 * angles, np.cos(angles), np.sin(angles)]) * HAND
    centres = _on_tip(ring - [FINGERTIP, 0.0, 0.0])
    face = {"plane": {"point": [side * half, 0.0, 0.0], "normal": [side, 0.0, 0.0]}}
    return [
        {"arm": {"sphere": {"center": centre.tolist(), "radius": FINGERTIP}}, "object": face,
         "name": f"f{k}"}
        for k, centre in enumerate(centres)
    ]  # fmt: skip


def corners_on_plane(sizes: Any, point: Any, normal: Any, prefix: str = "c") -> list[Table]:
    """Contacts of all corners of a box with a plane of the other body."""
    plane = {"plane": {"point": list(point), "normal": list(normal)}}
    return [
        {"arm": {"point": corner.tolist()}, "object": plane, "name": f"{prefix}{k}"}
        for k, corner in enumerate(box_corners(sizes))
    ]


def bottom_on_top(sizes: Any, height: float) -> list[Table]:
    """Contacts of the lower corners of a box with the upper face of another, at a height."""
    contacts = corners_on_plane(sizes, [0.0, 0.0, height], [0.0, 0.0, 1.0])
    return [contact for contact in contacts if contact["arm"]["point"][2] < 0.0]


def _press(forces: dict[str, float]) -> list[Table]:
    """Forces along x on the last links of the hands, against the object."""
    return [
        {"on": f"{name}/wrist_3_link", "axes": "world", "force": [-HANDS[name] * force, 0.0, 0.0]}
        for name, force in forces.items()
    ]


def _springs(rng: np.random.Generator) -> Table:
    return {
        "kind": "joint_pd",
        "stiffness": _number(rng, 200.0, 1500.0),
        "damping": _number(rng, 5.0, 40.0),
        "gravity_compensation": bool(rng.random() < 0.6),
    }


def _ceiling(name: str) -> Table:
    """A joint with something that an object does not reach."""
    above = {"plane": {"point": [0.0, 0.0, CEILING], "normal": [0.0, 0.0, -1.0]}}
    contact = {"arm": {"point": [0.0, 0.0, 0.0]}, "object": above}
    return {"between": [name, "world"], "name": "ceiling", "kind": "contacts",
            "contacts": [contact]}  # fmt: skip


def _turned(rng: np.random.Generator) -> list[float]:
    return [round(float(angle), 3) for angle in rng.uniform(-math.pi, math.pi, 3)]


def _lowest(sizes: Any, rpy: Any, along: Any = (0.0, 0.0, 1.0)) -> float:
    """How far the corners of a turned box reach against a direction [m]."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_euler("xyz", rpy).as_matrix()
    return float(-np.min(box_corners(sizes) @ turn.T @ np.array(along)))


def _box(sizes: Any, mass: float, xyz: Any, rpy: Any = (0, 0, 0), twist: Any = None) -> Table:
    table = {
        "shape": {"box": [float(size) for size in sizes]}, "mass": mass,
        "pose": {"xyz": [float(x) for x in xyz], "rpy": [float(x) for x in rpy]},
    }  # fmt: skip
    return table if twist is None else table | {"twist": [float(x) for x in twist]}


# --- families -------------------------------------------------------------------------------------


def fingertips_scene(rng: np.random.Generator) -> Table:
    """Two hands of one to four spherical fingertips press a box."""
    counts = rng.integers(1, 5, 2)
    half = _number(rng, 0.3, 0.6)
    height = 0.5
    press = _number(rng, 40.0, 120.0)
    arms, joints = {}, []
    for (name, side), count in zip(HANDS.items(), counts, strict=True):
        arms[name] = hand(side, np.array([side * half, 0.0, height]))
        first = float(rng.choice([0.0, 0.5 * math.pi, _number(rng, 0.0, 2.0 * math.pi)]))
        contacts = fingertips(int(count), side, half, first)
        joints.append({"arm": name, "kind": "contacts", "contacts": contacts})
    effects: Table = {
        "external_wrenches": _press(dict.fromkeys(HANDS, press)),
        "unilateral_contacts": {"restitution": float(rng.choice([0.0, 0.0, 0.3]))},
        "contact_friction": {"mu": _number(rng, 0.3, 0.9)},
    }
    if rng.random() < 0.7:
        effects["joint_damping"] = _number(rng, 0.2, 2.0)
    return {
        "gravity": DOWN,
        "object": _box([2 * half, 0.6, 0.4], _number(rng, 4.0, 8.0), [0, 0, height]),
        "arms": arms,
        "joints": joints,
        "control": _springs(rng),
        "effects": effects,
    }


def corner_scene(rng: np.random.Generator) -> Table:
    """A box is thrown or lies in a corner of a floor and one or two walls."""
    sizes = [_number(rng, 0.1, 0.5) for _ in range(3)]
    walls = {"wall_x": [1.0, 0.0, 0.0], "wall_y": [0.0, 1.0, 0.0]}
    if rng.random() < 0.5:
        del walls["wall_y"]
    lies = rng.random() < 0.4
    rpy = [0.0, 0.0, 0.0] if lies else _turned(rng)
    apart = np.zeros(3) if lies else rng.uniform(0.0, 0.15, 3)
    xyz = [_lowest(sizes, rpy, axis) + gap for axis, gap in zip(np.eye(3), apart, strict=True)]
    twist = [0.0] * 6 if lies else [*(rng.uniform(-2, 0, 3)), *rng.uniform(-4, 4, 3)]
    mass, restitution = _number(rng, 0.5, 5.0), _restitution(rng)
    effects: Table = {
        "unilateral_contacts": {"restitution": restitution, "start": "as_written"},
        "contact_friction": {"mu": _number(rng, 0.0, 1.0)},
        "floor": {"restitution": restitution, "mu": _number(rng, 0.0, 1.0)},
    }
    if lies or rng.random() < 0.5:
        force = mass * np.append(rng.uniform(-15.0, 3.0, 2), rng.uniform(-3.0, 12.0))
        effects["external_wrenches"] = [
            {"on": "box", "axes": "world", "force": force.round(2).tolist(),
             "at": (rng.uniform(-0.5, 0.5, 3) * sizes).round(3).tolist()}
        ]  # fmt: skip
    return {
        "gravity": DOWN,
        "objects": {"box": _box(sizes, mass, xyz, rpy, np.round(twist, 3))},
        "joints": [
            {"between": ["box", "world"], "name": name, "kind": "contacts",
             "contacts": corners_on_plane(sizes, [0, 0, 0], normal)}
            for name, normal in walls.items()
        ],
        "effects": effects,
    }  # fmt: skip


def _stack(rng: np.random.Generator, count: int) -> tuple[dict[str, Table], list[Table], list]:
    """Boxes on each other, their joints, and the sizes of all."""
    objects: dict[str, Table] = {}
    joints, below, height, all_sizes = [], None, 0.0, []
    for k in range(count):
        sizes = [_number(rng, 0.25, 0.4), _number(rng, 0.2, 0.3), _number(rng, 0.1, 0.2)]
        name = f"box{k}"
        aside = rng.uniform(-0.03, 0.03, 2).round(3) if k else np.zeros(2)
        objects[name] = _box(sizes, _number(rng, 0.5, 4.0), [*aside, height + 0.5 * sizes[2]])
        if below is not None:
            bottom = bottom_on_top(sizes, 0.5 * all_sizes[-1][2])
            joints.append({"between": [name, below], "kind": "contacts", "contacts": bottom})
        below, height = name, height + sizes[2]
        all_sizes.append(sizes)
    return objects, joints, all_sizes


def stack_scene(rng: np.random.Generator) -> Table:
    """Two or three boxes on a floor; hands hold one of them loosely, or it is pushed."""
    objects, joints, sizes = _stack(rng, int(rng.integers(2, 4)))
    mu = _number(rng, 0.1, 0.9)
    effects: Table = {
        "unilateral_contacts": {"restitution": float(rng.choice([0.0, 0.0, 0.4])),
                                "start": "as_written"},
        "contact_friction": {"mu": _number(rng, 0.1, 0.9)},
        "floor": {"mu": mu, "object": "box0"},
    }  # fmt: skip
    scene: Table = {"gravity": DOWN, "objects": objects, "joints": joints, "effects": effects}
    held = int(rng.integers(len(objects)))
    name, body = f"box{held}", objects[f"box{held}"]
    if rng.random() < 0.7:
        arms, press = {}, {}
        for arm, side in list(HANDS.items())[: 1 if rng.random() < 0.3 else 2]:
            half = 0.5 * sizes[held][0]
            arms[arm] = hand(side, np.array(body["pose"]["xyz"]) + [side * half, 0.0, 0.0])
            contacts = fingertips(int(rng.integers(1, 4)), side, half, 0.5 * math.pi)
            joints.append({"arm": arm, "object": name, "kind": "contacts", "contacts": contacts})
            press[arm] = _number(rng, 1.0, 30.0)
        effects["external_wrenches"] = _press(press)
        scene |= {"arms": arms, "control": _springs(rng) | {"gravity_compensation": False}}
        scene["effects"]["joint_damping"] = _number(rng, 0.2, 2.0)
    else:
        weight = 9.81 * sum(body["mass"] for body in objects.values())
        push = weight * rng.uniform(-0.6, 0.6, 3) * [1.0, 1.0, 0.3]
        effects["external_wrenches"] = [
            {"on": name, "axes": "world", "force": push.round(2).tolist(),
             "at": [0.0, 0.0, round(0.5 * sizes[held][2] * float(rng.uniform(-1, 1)), 3)]}
        ]  # fmt: skip
        if rng.random() < 0.5:
            body["twist"] = [*rng.uniform(-0.5, 0.5, 2).round(3), 0.0, 0.0, 0.0, 0.0]
    return scene


def dry_joints_scene(rng: np.random.Generator) -> Table:
    """Two UR5s with dry joints that hold a box by welds, a ball or a hinge."""
    half, height = 0.3, 0.5
    arms = {name: hand(side, np.array([side * half, 0, height])) for name, side in HANDS.items()}
    kinds = ["weld", str(rng.choice(["weld", "weld", "ball", "revolute"]))]
    joints = [{"arm": name, "kind": kind} for name, kind in zip(HANDS, kinds, strict=True)]
    scale = _number(rng, 0.2, 3.0)
    friction = (scale * UR5_EFFORT * rng.uniform(0.3, 1.0, 6)).round(3).tolist()
    effects: Table = {
        "joint_friction": {"torque": dict.fromkeys(HANDS, friction), "model": "set_valued"}
    }
    if rng.random() < 0.5:
        effects["joint_damping"] = _number(rng, 0.2, 3.0)
    control = str(rng.choice(["harmonic", "none", "joint_pd", "constant"]))
    torques = {name: (UR5_EFFORT * rng.uniform(-4.0, 4.0, 6)).round(3).tolist() for name in HANDS}
    scene: Table = {
        "gravity": DOWN,
        "object": _box([2 * half, 0.3, 0.3], _number(rng, 1.0, 8.0), [0, 0, height]),
        "arms": arms,
        "joints": joints,
        "effects": effects,
    }
    if control == "harmonic":
        phase = {name: rng.uniform(0, 6, 6).round(2).tolist() for name in HANDS}
        scene["control"] = {
            "kind": control, "amplitude": torques, "phase": phase,
            "frequency": _number(rng, 1.0, 6.0), "hold": bool(rng.random() < 0.5),
        }  # fmt: skip
    elif control == "constant":
        scene["control"] = {"kind": control, "torques": torques}
    elif control == "joint_pd":
        scene["control"] = _springs(rng)
        effects["external_wrenches"] = [
            {"on": "object", "axes": "world", "force": rng.uniform(-80, 80, 3).round(1).tolist(),
             "sinusoid": {"frequency": _number(rng, 1.0, 6.0)}}
        ]  # fmt: skip
    return scene


def thrown_scene(rng: np.random.Generator) -> Table:
    """A box or a rod that bounces, rocks or slides on a floor, with mu up to 3."""
    mass, mu, restitution = _number(rng, 0.2, 5.0), _number(rng, 0.0, 1.2), _restitution(rng)
    floor: Table = {"restitution": restitution}
    sort = str(rng.choice(["box", "rocking", "rod", "flat"]))
    if sort == "rod":
        mu = _number(rng, 0.0, 3.0)
        length = _number(rng, 0.4, 1.2)
        sizes = [length, 0.02, 0.02]
        ends = np.array([[-0.5 * length, 0.0, 0.0], [0.5 * length, 0.0, 0.0]])
        floor["points"] = ends.tolist()
        lean = _number(rng, 0.2, 1.4)
        rpy = [0.0, lean, _number(rng, -3.0, 3.0)]
        above = float(rng.choice([0.0, 0.0, _number(rng, 0.01, 0.2)]))
        xyz = [0.0, 0.0, 0.5 * length * math.sin(lean) + above]
        spin = 0.0 if above == 0.0 else float(rng.uniform(-4, 4))
        along = rng.uniform(-3.0, 3.0)
        # the lower end slides: no velocity along z where it touches
        twist = [along * math.cos(rpy[2]), along * math.sin(rpy[2]), 0.0,
                 -spin * math.sin(rpy[2]), spin * math.cos(rpy[2]), 0.0]  # fmt: skip
    else:
        sizes = [_number(rng, 0.1, 0.6) for _ in range(3)]
        rpy = _turned(rng)
        above, twist = _number(rng, 0.0, 0.3), [*rng.uniform(-2, 2, 3), *rng.uniform(-5, 5, 3)]
        if sort == "rocking":
            rpy = [0.0, _number(rng, 0.05, 0.5), 0.0]
            above, twist = 0.0, [0.0] * 6
        elif sort == "flat":
            rpy, above = [0.0, 0.0, 0.0], float(rng.choice([0.0, 0.05]))
            twist = [*rng.uniform(-2, 2, 2), 0.0, 0.0, 0.0, float(rng.uniform(-6, 6))]
        xyz = [0.0, 0.0, _lowest(sizes, rpy) + above]
    return {
        "gravity": DOWN,
        "objects": {"box": _box(sizes, mass, xyz, rpy, np.round(twist, 3))},
        "joints": [_ceiling("box")],
        "effects": {"unilateral_contacts": {"start": "as_written"},
                    "floor": floor | {"mu": mu}},
    }  # fmt: skip


def mixed_scene(rng: np.random.Generator) -> Table:
    """Hands with dry joints press a box that lies on a floor or is held above it, with a load."""
    scene = fingertips_scene(rng)
    effects = scene["effects"]
    body = scene.pop("object")
    half_height = 0.5 * body["shape"]["box"][2]
    lies = rng.random() < 0.6
    height = body["pose"]["xyz"][2] - half_height
    effects["floor"] = {
        "at": {"xyz": [0.0, 0.0, height if lies else height - _number(rng, 0.005, 0.05)]},
        "mu": _number(rng, 0.0, 1.0), "restitution": _restitution(rng), "object": "box",
    }  # fmt: skip
    effects["unilateral_contacts"]["start"] = "as_written"
    if rng.random() < 0.5:
        friction = (0.5 * UR5_EFFORT * rng.uniform(0.0, 1.0, 6)).round(3).tolist()
        effects["joint_friction"] = {
            "torque": dict.fromkeys(HANDS, friction),
            "model": "set_valued",
        }
    scene["objects"] = {"box": body}
    for joint in scene["joints"]:
        joint["object"] = "box"
    if rng.random() < 0.5:
        sizes = [_number(rng, 0.1, 0.25) for _ in range(3)]
        above = body["pose"]["xyz"][2] + half_height
        scene["objects"]["load"] = _box(sizes, _number(rng, 0.2, 2.0),
                                        [0.02, 0.01, above + 0.5 * sizes[2]])  # fmt: skip
        bottom = bottom_on_top(sizes, half_height)
        scene["joints"].append({"between": ["load", "box"], "kind": "contacts", "contacts": bottom})
    return scene


FAMILIES: dict[str, Callable[[np.random.Generator], Table]] = {
    "fingertips": fingertips_scene,
    "corner": corner_scene,
    "stack": stack_scene,
    "dry_joints": dry_joints_scene,
    "thrown": thrown_scene,
    "mixed": mixed_scene,
}
