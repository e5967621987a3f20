"""The arms of a scene written as one robot with several tips, which moves as they do.

The robot's file has the files of all arms below one root link at the world's origin, with names
``<arm>_<name>``, and no shapes.  The connection of arm ``left`` is then ``all/left``.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation
from tree_models import placement

import multiarm as ma
from multiarm.scene import dump_scene, find_robot

ROBOT = "all"


def as_one_robot(system: ma.System, folder: Path) -> dict[str, Any]:
    """The scene of a system, whose arms have no tools, as a table with one robot.

    It starts where the system starts.  Control is constant or none; effects name arms, contacts,
    or ranges of joints.
    """
    table = yaml.safe_load(dump_scene(system.scene))
    arms, root = table.pop("arms"), ElementTree.Element("robot", name=ROBOT)
    ElementTree.SubElement(root, "link", name="root")
    start, robot = system.initial_state(), {"tips": {}, "posture": {}, "velocity": {}, "lock": {}}
    for arm, spec in arms.items():
        path = Path(spec["urdf"]) if "urdf" in spec else find_robot(spec["robot"]).urdf
        _append(root, ElementTree.parse(path).getroot(), arm, spec.get("base"))
        robot["tips"][arm] = f"{arm}_{spec['tip']}"
        for k, name in enumerate(system.arms[arm].joint_names):
            robot["posture"][f"{arm}_{name}"] = float(start.joint_positions[arm][k])
            robot["velocity"][f"{arm}_{name}"] = float(start.joint_velocities[arm][k])
        robot["lock"] |= {f"{arm}_{name}": q for name, q in spec.get("lock", {}).items()}
    file = folder / "all.urdf"
    ElementTree.ElementTree(root).write(file)
    table["robots"] = {ROBOT: {"urdf": str(file), **robot}}
    table["joints"] = [{**joint, "arm": f"{ROBOT}/{joint['arm']}"} for joint in table["joints"]]
    quaternion = start.object_quaternion_xyzw.tolist()
    pose = {"xyz": start.object_position.tolist(), "quaternion_xyzw": quaternion}
    table["object"] |= {"pose": pose, "twist": start.object_twist.tolist()}
    effects = copy.deepcopy(table.get("effects") or {})
    for effect in effects.values():
        if isinstance(effect, dict) and effect.get("contacts"):
            effect["contacts"] = [f"{ROBOT}/{name}" for name in effect["contacts"]]
    limits = effects.get("joint_limits")
    if limits and limits["range"] != "urdf":
        ranges = limits["range"].items()
        limits["range"] = {
            ROBOT: {f"{arm}_{j}": ends for arm, js in ranges for j, ends in js.items()}
        }
    table["effects"] = effects
    torques = (table.get("control") or {}).get("torques")
    if torques:
        table["control"]["torques"] = {ROBOT: _stacked(system, torques)}
    return table


def joints_by_arm(system: ma.System, values: np.ndarray) -> dict[str, np.ndarray]:
    """Joint numbers of the robot, shape (..., n), by the arm from which each joint is."""
    names = system.arms[ROBOT].joint_names
    arms = system.arms[ROBOT].tips
    return {
        arm: values[..., [k for k, name in enumerate(names) if name.startswith(f"{arm}_")]]
        for arm in arms
    }


def _stacked(system: ma.System, torques: dict[str, Any]) -> dict[str, float]:
    stacked = {}
    for arm, numbers in torques.items():
        names = system.arms[arm].joint_names
        rows = numbers if isinstance(numbers, list) else [numbers] * len(names)
        stacked |= {f"{arm}_{name}": row for name, row in zip(names, rows, strict=True)}
    return stacked


def _append(root: ElementTree.Element, robot: ElementTree.Element, arm: str, base: Any) -> None:
    """Append the links and joints of a file, its root link at a base."""
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}
    for link in robot.findall("link"):
        name = link.get("name")
        if name not in children:
            X = placement(base)
            joint = ElementTree.SubElement(root, "joint", name=f"{arm}_mount", type="fixed")
            ElementTree.SubElement(joint, "parent", link="root")
            ElementTree.SubElement(joint, "child", link=f"{arm}_{name}")
            rpy = Rotation.from_matrix(X.rotation).as_euler("xyz")
            xyz = " ".join(repr(float(x)) for x in X.translation)
            turn = " ".join(repr(float(x)) for x in rpy)
            ElementTree.SubElement(joint, "origin", xyz=xyz, rpy=turn)
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
        link.set("name", f"{arm}_{name}")
        root.append(link)
    for joint in robot.findall("joint"):
        joint.set("name", f"{arm}_{joint.get('name')}")
        for end in ("parent", "child"):
            element = joint.find(end)
            element.set("link", f"{arm}_{element.get('link')}")
        if joint.find("mimic") is not None:
            joint.find("mimic").set("joint", f"{arm}_{joint.find('mimic').get('joint')}")
        root.append(joint)
