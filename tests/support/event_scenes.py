"""Scenes with unilateral contacts: plain arms made of slides and hinges, balls, boxes, plates."""

from __future__ import annotations

import atexit
import math
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
from mechanics import UR5_POSTURE, G

import multiarm as ma
from multiarm.problems.building import tip_pose
from multiarm.scene import find_robot, parse_scene

GRAVITY = -G[2]
AS_WRITTEN = {"start": "as_written"}
# What an arm that is of no interest touches the object with, and how far above it is [m].
AWAY_HEIGHT = 5.0
AWAY = {"arm": {"sphere": {"radius": 0.01}}, "object": {"sphere": {"radius": 0.01}}}

_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


@cache
def _folder() -> Path:
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    return Path(folder.name)


def chain(kinds: str, mass: float = 1.0, inertia: float = 0.1, ends: float = 1e3) -> str:
    """File of an arm of slides ``x y z`` and hinges ``X Y Z``, all of its mass in the last link.

    The ends of all ranges are at plus and minus ``ends``.
    """
    parts = ['<robot name="chain"><link name="base"/>']
    for k, kind in enumerate(kinds):
        parent, last = "base" if k == 0 else f"link{k}", k == len(kinds) - 1
        child = "tip" if last else f"link{k + 1}"
        tensor = " ".join(f'{a}="{inertia if a[1] == a[2] else 0!r}"' for a in _TENSOR)
        body = f'<inertial><mass value="{mass!r}"/><inertia {tensor}/></inertial>' if last else ""
        parts.append(
            f'<link name="{child}">{body}</link><joint name="j{k + 1}" '
            f'type="{"prismatic" if kind in _AXES else "revolute"}"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{_AXES[kind.lower()]}"/>'
            f'<limit lower="{-ends!r}" upper="{ends!r}" effort="1e9" velocity="1e9"/></joint>'
        )
    text = "".join([*parts, "</robot>"])
    path = _folder() / f"{kinds}_{mass!r}_{inertia!r}_{ends!r}.urdf"
    path.write_text(text)
    return str(path)


_TENSOR = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def arm(kinds: str, posture=None, velocity=None, base=None, **more) -> dict:
    """An arm of :func:`chain` as a scene has it."""
    data = {"urdf": chain(kinds, **more), "tip": "tip", "posture": posture or [0.0] * len(kinds)}
    if velocity is not None:
        data["velocity"] = velocity
    return data if base is None else {**data, "base": base}


def scene(body: dict, arms: dict, contacts: dict, effects: dict, gravity=G, **more):
    """A scene; ``contacts`` are those of each arm's joint."""
    joints = [{"arm": a, "kind": "contacts", "contacts": list(c)} for a, c in contacts.items()]
    data = {"object": body, "arms": arms, "joints": joints, "effects": effects}
    return parse_scene({"gravity": gravity, **data, **more})


def ball(radius: float = 0.05, height: float = 0.0, mass: float = 1.0, **more) -> dict:
    """A ball whose lowest point is at a height."""
    pose = {"xyz": [0, 0, height + radius]}
    return {"shape": {"sphere": radius}, "mass": mass, "pose": pose, **more}


def ball_on_plate(
    plate: dict, body: dict, restitution=0.0, mu=None, normal=(0, 0, 1), effects=None, **more
):
    """A ball above a plane that an arm carries."""
    radius = body["shape"]["sphere"]
    contact = {"arm": {"plane": {"normal": list(normal)}}, "object": {"sphere": {"radius": radius}}}
    all_effects = {"unilateral_contacts": {**AS_WRITTEN, "restitution": restitution}}
    if mu is not None:
        all_effects["contact_friction"] = mu
    return scene(
        body, {"plate": plate}, {"plate": [contact]}, {**all_effects, **(effects or {})}, **more
    )


def on_floor(body: dict, restitution=0.0, mu=None, floor=None, **more):
    """An object above the floor, and an arm that has nothing to do with it."""
    ground = {"restitution": restitution, **({} if mu is None else {"mu": mu}), **(floor or {})}
    effects = {"unilateral_contacts": AS_WRITTEN, "floor": ground, **more.pop("effects", {})}
    away = arm("x", base={"xyz": [0, 0, AWAY_HEIGHT]})
    return scene(body, {"away": away}, {"away": [AWAY]}, effects, **more)


def box(sizes=(0.4, 0.3, 0.2), mass=2.0, height=0.0, rpy=(0, 0, 0), twist=None, **more) -> dict:
    """A box whose centre is at half its height above ``height``, turned about its centre."""
    pose = {"xyz": [0, 0, height + 0.5 * sizes[2]], "rpy": list(rpy)}
    data = {"shape": {"box": list(sizes)}, "mass": mass, "pose": pose, **more}
    return data if twist is None else {**data, "twist": list(twist)}


def rod(angle: float, mu: float, speed: float):
    """A thin rod whose lower end slides; it leans towards +x by ``angle`` above the floor."""
    half = np.array([math.cos(angle), 0.0, math.sin(angle)]) / 2
    body = {
        "shape": {"box": [1.0, 0.02, 0.02]}, "mass": 1.0, "inertia": [1e-3, 1 / 12, 1 / 12],
        "pose": {"xyz": half.tolist(), "rpy": [0, -angle, 0]}, "twist": [speed, 0, 0, 0, 0, 0],
    }  # fmt: skip
    return on_floor(body, mu=mu, floor={"points": [[-0.5, 0, 0]]})


def response_of_rod(angle: float, mu: float) -> float:
    """Upward acceleration of the sliding end to a unit load (m = L = 1), by hand."""
    return 1 + 3 * math.cos(angle) * (math.cos(angle) - mu * math.sin(angle))


def run(a_scene, duration: float, accuracy: float = 1e-8, **more):
    """Simulate without a certificate."""
    if "integrator" not in more or more["integrator"] in ("dopri5", "dop853", "rodas5p"):
        more.setdefault("accuracy", accuracy)
    more.setdefault("certificate", False)
    return ma.simulate(ma.compile_system(a_scene), duration, **more)


def times(trajectory, *kinds: str) -> np.ndarray:
    """Times of all events, or of those of some kinds."""
    return np.array([e["time"] for e in trajectory.events if not kinds or e["kind"] in kinds])


def fall_time(height: float) -> float:
    """Of a body that falls from rest [s]."""
    return math.sqrt(2.0 * height / GRAVITY)


# --- hands ----------------------------------------------------------------------------------------

# Two UR5s hold a box between fingertips.
MASS, SQUEEZE, RADIUS = 2.0, 40.0, 0.01  # [kg], [N], [m]
# Fingertips of a hand, in a plane that stands upright [m].
PADS = [(0.02, 0.0), (-0.01, 0.017), (-0.01, -0.017)]


def held_box(mu: float):
    """A box between the pads of two UR5s, which press on its ends."""
    tip = tip_pose("ur5", "tool0", tuple(UR5_POSTURE))
    half = 1.1 - tip[0, 3] - RADIUS
    arms, joints = {}, []
    for name, side in (("left", -1.0), ("right", 1.0)):
        base = {"xyz": [side * 1.1, side * tip[1, 3], 0]}
        if side > 0.0:
            base["rpy"] = [0, 0, math.pi]
        arms[name] = {"robot": "ur5", "tip": "tool0", "posture": UR5_POSTURE, "base": base}
        face = {"plane": {"point": [side * half, 0, 0], "normal": [side, 0, 0]}}
        contacts = [
            {"arm": {"sphere": {"center": (tip[:3, :3].T @ [0, *pad]).tolist(), "radius": RADIUS}},
             "object": face}
            for pad in PADS
        ]  # fmt: skip
        joints.append({"arm": name, "kind": "contacts", "contacts": contacts})
    return parse_scene(
        {
            "gravity": G,
            "object": {
                "shape": {"box": [2 * half, 0.3, 0.3]}, "mass": MASS,
                "pose": {"xyz": [0, 0, tip[2, 3]]},
            },
            "arms": arms,
            "joints": joints,
            "effects": {"unilateral_contacts": AS_WRITTEN, "contact_friction": mu},
        }
    )  # fmt: skip


def lifting(rise: float):
    """Each arm carries itself and half of the box, presses, and follows its posture stiffly.

    The tips are pushed up with ``rise`` [N] more than the box weighs.
    """
    model = pin.buildModelFromUrdf(str(find_robot("ur5").urdf))
    data, tool = model.createData(), model.getFrameId("tool0")
    push = np.array([SQUEEZE, 0, 0.5 * (MASS * GRAVITY + rise), 0, 0, 0])

    def torques(t, state):
        found = {}
        for name in ("left", "right"):
            q, v = state.joint_positions[name], state.joint_velocities[name]
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            J = pin.getFrameJacobian(model, data, tool, pin.LOCAL_WORLD_ALIGNED)
            carried = pin.computeGeneralizedGravity(model, data, q)
            found[name] = carried + J.T @ push - 20.0 * v
        return found

    return torques
