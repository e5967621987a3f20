"""Whether the parts of a scene fit together: names, frames, counts.

The check works on whatever parts are sound by themselves, so that a scene with a mistyped number
*and* a mistyped arm hears of both at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
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
    RunSpec,
)
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.object_spec import ObjectSpec
from multiarm.scene.per_joint import KnownArm, gain_faults
from multiarm.scene.resolve import Examination, examine_arm
from multiarm.scene.words import listed, place, unknown

__all__ = ["Findings", "SceneParts", "check", "method_fault"]

PUSHING = {"contacts", "corner_gripper", "point_on_cylinder", "point_on_plane", "point_on_sphere"}
"""Kinds of joints with contacts that only push."""


Looked = dict[str, tuple[ArmSpec, Examination]]
"""Arms by name, with what was found out about them."""


@dataclass
class Findings:
    """Faults and warnings, each one complete line; the arms as they were looked at."""

    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    arms: Looked = field(default_factory=dict)


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
    joint_kinds : tuple
        Kind of every joint, None where it has none.
    object, control, effects, run
        None where unsound.
    """

    arm_names: list[str] | None
    arms: dict[str, ArmSpec]
    joint_arms: list[tuple[int, Any]]
    joints_readable: bool
    joint_kinds: tuple[Any, ...]
    object: ObjectSpec | None
    control: Any
    effects: EffectsSpec | None
    run: RunSpec | None

    @classmethod
    def of(cls, data: Mapping[str, Any], folder: Path, load: bool = True) -> SceneParts:
        """Save what can be saved from ``data``, which may hold instances or plain tables.

        Effects of packages are loaded only where ``load`` says so.
        """
        arms = data.get("arms")
        sound = {}
        for name, arm in (arms if isinstance(arms, Mapping) else {}).items():
            spec = _sound(ArmSpec, arm)
            if spec is not None:
                sound[str(name)] = spec.located(folder)
        joints = data.get("joints")
        listing = list(joints) if isinstance(joints, (list, tuple)) else []
        named = [(i, _entry(joint, "arm")) for i, joint in enumerate(listing)]
        thing = _sound(ObjectSpec, data.get("object"))
        effects = _sound(EffectsSpec, data.get("effects", {}), {"load": load})
        return cls(
            arm_names=[str(name) for name in arms] if isinstance(arms, Mapping) else None,
            arms=sound,
            joint_arms=[(i, arm) for i, arm in named if arm is not None],
            joints_readable=isinstance(joints, (list, tuple))
            and all(arm is not None for _, arm in named),
            joint_kinds=tuple(_entry(joint, "kind") for joint in listing),
            object=None if thing is None else thing.located(folder),
            control=_sound(ControlSpec, data.get("control")),
            effects=None if effects is None else effects.located(folder),
            run=_sound(RunSpec, data.get("run")),
        )


def check(parts: SceneParts, looked: Looked | None = None) -> Findings:
    """Return all faults and warnings about how the parts fit together.

    Arms that were ``looked`` at already, and are written as they were, are not again.
    """
    findings = Findings()
    if parts.arm_names is not None:
        _check_connections(parts, findings)
    known = _check_arms(parts, findings, looked or {})
    _check_object(parts.object, findings)
    if parts.arm_names is not None:
        arms = {name: known.get(name, KnownArm(None, None)) for name in parts.arm_names}
        _check_control(parts, arms, findings)
        _check_effects(parts, arms, findings)
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


def _check_arms(parts: SceneParts, findings: Findings, looked: Looked) -> dict[str, KnownArm]:
    """Check every sound arm, and return what is known of it."""
    known = {}
    for name, spec in parts.arms.items():
        before, found = looked.get(name, (None, None))
        if found is None or before != spec:
            found = examine_arm(spec)
        findings.arms[name] = spec, found
        known[name] = KnownArm(found.joints, found.links, found.moving)
        for where, text in found.faults:
            findings.faults.append(f"{place(('arms', name, *where))}: {text}")
        for text in found.warnings:
            findings.warnings.append(f"{place(('arms', name))}: {text}")
    return known


def _check_object(thing: ObjectSpec | None, findings: Findings) -> None:
    mesh = None if thing is None else thing.shape.mesh
    if mesh is not None and not mesh.file.is_file():
        findings.warnings.append(
            f"$.object.shape.mesh.file: no file at {mesh.file}; the motion is not affected, the "
            "replay shows a stand-in"
        )


def _check_control(parts: SceneParts, arms: dict[str, KnownArm], findings: Findings) -> None:
    fields: dict[type, tuple[str, ...]] = {
        ConstantControl: ("torques",),
        JointPDControl: ("stiffness", "damping"),
        HarmonicControl: ("amplitude", "phase"),
    }
    for key in fields.get(type(parts.control), ()):
        for where, text in gain_faults(getattr(parts.control, key), arms):
            findings.faults.append(f"{place(('control', key, *where))}: {text}")
    if isinstance(parts.control, (ComputedTorqueControl, ObjectImpedanceControl)):
        for arm in parts.control.internal_forces or {}:
            if arm not in arms:
                path = place(("control", "internal_forces", arm))
                findings.faults.append(f"{path}: {unknown('arm', arm, arms)}")


def _check_effects(parts: SceneParts, arms: dict[str, KnownArm], findings: Findings) -> None:
    if parts.effects is None:
        return
    for where, text in parts.effects.faults(arms):
        findings.faults.append(f"{place(('effects', *where))}: {text}")
    for where, text in parts.effects.warnings(arms):
        findings.warnings.append(f"{place(('effects', *where))}: {text}")
    if parts.run is not None:
        message = method_fault(
            parts.run.integrator, parts.effects.with_states, parts.effects.with_events
        )
        if message:
            findings.faults.append(f"$.run.integrator: {message}")
    _check_pushing(parts, findings)


def _check_pushing(parts: SceneParts, findings: Findings) -> None:
    """Tell effects of contacts that only push where no joint has any."""
    effects = parts.effects
    assert effects is not None
    if not parts.joint_kinds or None in parts.joint_kinds or PUSHING & {*parts.joint_kinds}:
        return
    for name in ("unilateral_contacts", "contact_friction"):
        if getattr(effects, name) is not None:
            findings.warnings.append(
                f"$.effects.{name}: adds nothing, since no joint has contacts that only push; such "
                f"joints are {listed(sorted(PUSHING))}"
            )


def method_fault(
    integrator: str | None, with_states: Sequence[str], with_events: Sequence[str] = ()
) -> str:
    """Say why a method cannot carry effects that have states or events of their own.

    Empty when it can.
    """
    if integrator == "variational" and with_events:
        return (
            f"'variational' takes its steps as wholes and knows no events of "
            f"{listed(with_events)}; use another method, such as 'dop853' or 'rk4', or leave the "
            f"effect out"
        )
    if integrator != "variational" or not with_states:
        return ""
    return (
        f"'variational' knows positions and velocities only, no states of {listed(with_states)}; "
        f"use another method, such as 'dop853' or 'rk4', or leave the effect out"
    )


def _sound(kind: Any, data: Any, context: dict[str, Any] | None = None) -> Any:
    if data is None:
        return None
    try:
        return TypeAdapter(kind).validate_python(data, context=context)
    except ValidationError:
        return None


def _entry(joint: Any, key: str) -> Any:
    return joint.get(key) if isinstance(joint, Mapping) else getattr(joint, key, None)
