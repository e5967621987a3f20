"""The outline of an MJCF file, MuJoCo's XML, as Pinocchio reads it.

Pinocchio passes over what it does not know, such as a ``<frame>`` with all bodies in it, and over
the pose of a first body without a joint; some of the rest it reads otherwise than MuJoCo.  So a
file is refused if something in it would make the arm another one there, and that pose is read here.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from multiarm.errors import ModelError
from multiarm.scene.faults import listed
from multiarm.scene.urdf import JointOutline, RobotOutline, read_xml, root_link
from multiarm.scene.values import Pose

if TYPE_CHECKING:
    import pinocchio as pin

# What Pinocchio reads, and what does not change how an arm moves on its own.
_PARTS = {"actuator", "asset", "compiler", "contact", "custom", "default", "keyframe", "option"}
_PARTS |= {"sensor", "size", "statistic", "visual", "worldbody"}
_IN_BODIES = {"body", "camera", "geom", "inertial", "joint", "light", "site"}
# Attributes that Pinocchio does not read, or reads otherwise.
_MISREAD = {
    "body": ("gravcomp", "mocap"),
    "compiler": ("balanceinertia", "inertiafromgeom", "settotalmass"),
    "joint": ("ref", "springref", "stiffness"),
}
_ORIENTATIONS = ("axisangle", "euler", "xyaxes", "zaxis")


def read_mjcf(path: Path) -> RobotOutline:
    """Read the outline of an MJCF file; its links are the bodies and sites.

    Raises
    ------
    ModelError
        If the file cannot be read, or something in it cannot be simulated as it is meant.
    """
    try:
        return _read(path, path.stat().st_mtime_ns)
    except OSError:
        raise ModelError(f"no MJCF file at {path}") from None


def mjcf_model(path: Path) -> tuple[pin.Model, Pose]:
    """Pinocchio's model of a file without the pose of a first body that has no joint; this pose.

    Raises
    ------
    ModelError
        As :func:`read_mjcf`.
    """
    import pinocchio as pin

    first = _checked(path)
    try:
        place = {
            key: [float(number) for number in first.get(key, "").split()] for key in ("pos", "quat")
        }
        model = pin.buildModelFromMJCF(str(path))
    except (ValueError, RuntimeError) as error:
        raise ModelError(f"Pinocchio cannot read {path}: {error}") from None
    if first.find("joint") is not None:
        return model, Pose()
    w, *xyz = place["quat"] or [1.0, 0.0, 0.0, 0.0]
    return model, Pose(xyz=place["pos"] or [0.0] * 3, quaternion_xyzw=[*xyz, w])


@lru_cache(maxsize=32)
def _read(path: Path, _stamp: int) -> RobotOutline:
    import pinocchio as pin

    model, _ = mjcf_model(path)
    links, joints = ["world"], []
    for number, frame in enumerate(model.frames[1:], start=1):
        if frame.type not in (pin.FrameType.BODY, pin.FrameType.OP_FRAME):
            continue
        above, moved = model.frames[number].parentFrame, None
        while above and model.frames[above].type != pin.FrameType.BODY:
            if model.frames[above].type == pin.FrameType.JOINT:
                moved = model.frames[above].parentJoint
            above = model.frames[above].parentFrame
        parent = model.frames[above].name if above else "world"
        joints.append(_joint(model, moved, parent, frame.name, path))
        links.append(frame.name)
    root = root_link(tuple(links), tuple(joints), path)
    return RobotOutline(path, tuple(links), tuple(joints), (), root, sorted_by_name=False)


def _joint(
    model: pin.Model, number: int | None, parent: str, child: str, path: Path
) -> JointOutline:
    """A joint, or what fixes a body or a site to its parent."""
    if number is None:
        ends = (-math.inf, math.inf, math.inf, math.inf)
        return JointOutline(f"{child}_fixed", "fixed", parent, child, (1.0, 0.0, 0.0), *ends)
    joint, name = model.joints[number], model.names[number]
    if joint.nq != 1:
        raise ModelError(f"{path}: body {child!r} has several joints; put bodies between them")
    data = joint.createData()
    joint.calc(data, model.referenceConfigurations["qpos0"][joint.idx_q : joint.idx_q + 1])
    slide, turn = data.S.reshape(2, 3).tolist()
    lower, upper = (
        float(limits[joint.idx_q])
        for limits in (model.lowerPositionLimit, model.upperPositionLimit)
    )
    kind = "prismatic" if any(slide) else "revolute" if math.isfinite(lower) else "continuous"
    x, y, z = slide if any(slide) else turn
    at = joint.idx_v
    return JointOutline(
        name=name,
        kind=kind,
        parent=parent,
        child=child,
        axis=(x, y, z),
        lower=lower,
        upper=upper,
        velocity_limit=float(model.velocityLimit[at]),
        effort_limit=float(model.effortLimit[at]),
        damping=float(model.damping[at]),
        friction=float(model.friction[at]),
    )


def _checked(path: Path) -> ElementTree.Element:
    """The first body of a file, of which Pinocchio makes the same arm as MuJoCo."""
    root = read_xml(path)
    if root.tag != "mujoco":
        raise ModelError(f"{path} is not an MJCF file: its root element is <{root.tag}>")
    bodies = root.findall("worldbody/body")
    try:
        reasons = list(_reasons(root))
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from None
    if len(bodies) != 1:
        reasons.append(f"<worldbody> has {len(bodies)} bodies; an arm hangs on one")
    if reasons:
        raise ModelError(f"{path} cannot be read as it is meant: {'; '.join(reasons)}")
    return bodies[0]


def _reasons(root: ElementTree.Element) -> Iterator[str]:
    """Why MuJoCo would simulate another arm than Pinocchio."""
    unknown_tags = {part.tag for part in root} - _PARTS
    unknown_tags |= {part.tag for body in root.iter("body") for part in body} - _IN_BODIES
    unknown_tags |= {part.tag for part in root.findall("worldbody/*")} - _IN_BODIES
    unknown_tags |= {part.tag for part in root.iter("include")}
    if unknown_tags:
        yield f"it has {listed(sorted(unknown_tags))}, which Pinocchio does not read"
    for tag, keys in _MISREAD.items():
        used = sorted({key for part in root.iter(tag) for key in keys if key in part.attrib})
        if used:
            yield f"<{tag}> has {listed(used)}, which Pinocchio does not read as MuJoCo does"
    compilers = {key: value for part in root.iter("compiler") for key, value in part.items()}
    if compilers.get("eulerseq", "xyz") != "xyz":
        yield "Pinocchio reads Euler angles in the sequence 'xyz' only"
    slides = any(joint.get("type") == "slide" for joint in root.iter("joint"))
    if slides and compilers.get("angle") != "radian":
        yield "Pinocchio takes the limits of slides as degrees; write <compiler angle='radian'/>"
    for part in root.iter():
        axis = [float(number) for number in part.get("axisangle", "1 0 0 0").split()[:3]]
        if abs(math.hypot(*axis) - 1.0) > 1e-6:
            yield f"the axis of axisangle='{part.get('axisangle')}' must have the length 1"
    yield from _reasons_of_joints(root)
    yield from _reasons_of_bodies(root)


def _reasons_of_joints(root: ElementTree.Element) -> Iterator[str]:
    for joint in root.iter("joint"):
        name = joint.get("name", "")
        if joint.get("type", "hinge") not in ("hinge", "slide"):
            yield f"joint {name!r} is a {joint.get('type')}; arms move by hinges and slides"
        if joint.get("limited") == "false":
            yield f"joint {name!r} has limited='false'; leave its range out"
    for part in (*root.iterfind(".//default/joint"), *root.iterfind(".//default/site")):
        placed = sorted({"pos", "quat", "type", *_ORIENTATIONS} & part.attrib.keys())
        if placed:
            yield f"<{part.tag}> in a <default> has {listed(placed)}; write it where it counts"


def _reasons_of_bodies(root: ElementTree.Element) -> Iterator[str]:
    for part in (*root.iterfind(".//body"), *root.iterfind(".//body/joint")):
        if not part.get("name"):
            yield f"a <{part.tag}> has no name"
    for body in root.iter("body"):
        if body.find("geom") is not None and body.find("inertial") is None:
            yield f"body {body.get('name', '')!r} has a shape but no <inertial>"
    families = {
        family.get("class", "main"): {
            below.get("class", "main") for below in family.iter("default")
        }
        for family in root.iter("default")
    }
    for body in root.findall("worldbody/body"):
        turned = [key for key in _ORIENTATIONS if key in body.attrib]
        if turned and body.find("joint") is None:
            yield f"the orientation of the first body is a {turned[0]}; write it as 'quat'"
        yield from _mixed_defaults(body, None, families)


def _mixed_defaults(
    part: ElementTree.Element, inherited: str | None, families: dict[str, set[str]]
) -> Iterator[str]:
    """Parts with another class than their body's: Pinocchio takes defaults from both."""
    name = part.get("class") or part.get("childclass")
    if inherited and name and name not in families.get(inherited, ()):
        yield f"class {name!r} inside of 'childclass' {inherited!r} is none of its own classes"
    for below in part:
        yield from _mixed_defaults(below, part.get("childclass", inherited), families)
