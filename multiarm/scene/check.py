"""Whether the parts of a scene fit together: names, frames, counts.

The check works on whatever parts are sound by themselves, so that a scene with a mistyped number
*and* a mistyped arm hears of both at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from multiarm.scene.arm_spec import ArmSpec
from multiarm.scene.control import (
    ComputedTorqueControl,
    ConstantControl,
    ControlSpec,
    HarmonicControl,
    JointPDControl,
    ObjectImpedanceControl,
)
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.object_spec import ObjectSpec
from multiarm.scene.resolve import examine_arm
from multiarm.scene.values import joint_value_faults
from multiarm.scene.words import place, unknown

__all__ = ["Findings", "SceneParts", "check"]


@dataclass
class Findings:
    """Faults and warnings, each one complete line."""

    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class SceneParts:
    """The parts of a scene that are sound by themselves.

    Attributes
    ----------
    arm_names : list of str
        All arms that are written, sound or not.
    arms : dict
        The sound ones.
    joint_arms : list of (int, object)
        Position in the list and arm of every joint that names one.
    joints_readable : bool
        Whether every joint names an arm, so that unconnected arms can be told.
    object, control, effects
        None where unsound.
    """

    arm_names: list[str] | None
    arms: dict[str, ArmSpec]
    joint_arms: list[tuple[int, Any]]
    joints_readable: bool
    object: ObjectSpec | None
    control: Any
    effects: EffectsSpec | None

    @classmethod
    def of(cls, data: Mapping[str, Any], folder: Path) -> SceneParts:
        """Save what can be saved from ``data``, which may hold instances or plain tables."""
        arms = data.get("arms")
        sound = {}
        for name, arm in (arms if isinstance(arms, Mapping) else {}).items():
            spec = _sound(ArmSpec, arm)
            if spec is not None:
                sound[str(name)] = spec.located(folder)
        joints = data.get("joints")
        listing = list(joints) if isinstance(joints, (list, tuple)) else []
        named = [(i, _arm_of(joint)) for i, joint in enumerate(listing)]
        thing = _sound(ObjectSpec, data.get("object"))
        return cls(
            arm_names=[str(name) for name in arms] if isinstance(arms, Mapping) else None,
            arms=sound,
            joint_arms=[(i, arm) for i, arm in named if arm is not None],
            joints_readable=isinstance(joints, (list, tuple))
            and all(arm is not None for _, arm in named),
            object=None if thing is None else thing.located(folder),
            control=_sound(ControlSpec, data.get("control")),
            effects=_sound(EffectsSpec, data.get("effects", {})),
        )


def check(parts: SceneParts) -> Findings:
    """Return all faults and warnings about how the parts fit together."""
    findings = Findings()
    if parts.arm_names is not None:
        _check_connections(parts, findings)
    joint_names = _check_arms(parts, findings)
    _check_object(parts.object, findings)
    _check_control(parts, joint_names, findings)
    if parts.effects is not None:
        damping = parts.effects.joint_damping
        _check_gain(damping, ("effects", "joint_damping"), parts, joint_names, findings)
    return findings


def _check_connections(parts: SceneParts, findings: Findings) -> None:
    names = parts.arm_names
    assert names is not None
    if not names:
        findings.faults.append("$.arms: a scene needs at least one arm, such as {left: {...}}")
        return
    for index, arm in parts.joint_arms:
        if arm not in names:
            text = unknown("arm", arm, names)
            findings.faults.append(f"{place(('joints', index, 'arm'))}: {text}")
    counts = Counter(arm for _, arm in parts.joint_arms if isinstance(arm, str))
    for name in names:
        if counts[name] == 0 and parts.joints_readable:
            findings.faults.append(
                f"$.joints: arm {name!r} is connected by no joint; add one, such as "
                f"{{arm: {name}, kind: weld}}, or remove the arm"
            )
        if counts[name] > 1:
            findings.faults.append(
                f"$.joints: arm {name!r} has {counts[name]} joints; one joint per arm is "
                "possible, list their contacts in one joint of kind 'contacts'"
            )


def _check_arms(parts: SceneParts, findings: Findings) -> dict[str, tuple[str, ...] | None]:
    """Check every sound arm, and return the movable joints of those whose chain is known."""
    joint_names = {}
    for name, spec in parts.arms.items():
        found = examine_arm(spec)
        joint_names[name] = found.joint_names
        for where, text in found.faults:
            findings.faults.append(f"{place(('arms', name, *where))}: {text}")
        for text in found.warnings:
            findings.warnings.append(f"{place(('arms', name))}: {text}")
    return joint_names


def _check_object(thing: ObjectSpec | None, findings: Findings) -> None:
    mesh = None if thing is None else thing.shape.mesh
    if mesh is not None and not mesh.file.is_file():
        findings.warnings.append(
            f"$.object.shape.mesh.file: no file at {mesh.file}; the motion is not affected, the "
            "replay shows a stand-in"
        )


def _check_control(
    parts: SceneParts, joint_names: dict[str, tuple[str, ...] | None], findings: Findings
) -> None:
    fields: dict[type, tuple[str, ...]] = {
        ConstantControl: ("torques",),
        JointPDControl: ("stiffness", "damping"),
        HarmonicControl: ("amplitude", "phase"),
    }
    for key in fields.get(type(parts.control), ()):
        value = getattr(parts.control, key)
        _check_gain(value, ("control", key), parts, joint_names, findings)
    if isinstance(parts.control, (ComputedTorqueControl, ObjectImpedanceControl)):
        for arm in parts.control.internal_forces or {}:
            if parts.arm_names is not None and arm not in parts.arm_names:
                where = place(("control", "internal_forces", arm))
                findings.faults.append(f"{where}: {unknown('arm', arm, parts.arm_names)}")


def _check_gain(
    value: Any,
    where: tuple[str, ...],
    parts: SceneParts,
    joint_names: dict[str, tuple[str, ...] | None],
    findings: Findings,
) -> None:
    """Check a value for all arms, or a table by arm, against the arms' movable joints."""
    if value is None or parts.arm_names is None:
        return
    by_arm = value if isinstance(value, Mapping) else dict.fromkeys(parts.arm_names, value)
    for arm, own in by_arm.items():
        here = (*where, arm) if isinstance(value, Mapping) else where
        if arm not in parts.arm_names:
            findings.faults.append(f"{place(here)}: {unknown('arm', arm, parts.arm_names)}")
            continue
        names = joint_names.get(arm)
        for below, text in joint_value_faults(own, names) if names is not None else ():
            subject = "" if isinstance(value, Mapping) else f"arm {arm!r}: "
            findings.faults.append(f"{place((*here, *below))}: {subject}{text}")


def _sound(kind: Any, data: Any) -> Any:
    if data is None:
        return None
    try:
        return TypeAdapter(kind).validate_python(data)
    except ValidationError:
        return None


def _arm_of(joint: Any) -> Any:
    return joint.get("arm") if isinstance(joint, Mapping) else getattr(joint, "arm", None)
