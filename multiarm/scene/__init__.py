"""The scene file: its schema, loading and checks, and the robots that it may name.

A name is imported from its module when it is first used, so that the settings of a run, from which
the options of the commands derive, are known without what reads geometry.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiarm.scene.arms import ArmSpec, ResolvedArm, ToolSpec, resolve_arm
    from multiarm.scene.changes import changed, changed_scenes, parse_path, value_at
    from multiarm.scene.control import CONTROLS, register_control
    from multiarm.scene.control.kind import Waypoint
    from multiarm.scene.effects import EFFECTS, EffectsSpec, register_effect
    from multiarm.scene.effects.drives import damping_of, effort_limit_of, friction_of
    from multiarm.scene.effects.loads import ExternalWrench, read_wrench_table
    from multiarm.scene.functions import function_text
    from multiarm.scene.joints import (
        JOINTS,
        BallJoint,
        ContactsJoint,
        CornerGripperJoint,
        CylindricalJoint,
        Joint,
        JointSpec,
        PlanarJoint,
        PointOnCylinderJoint,
        PointOnPlaneJoint,
        PointOnSphereJoint,
        PrismaticJoint,
        RevoluteJoint,
        UniversalJoint,
        WeldJoint,
        WrenchesJoint,
        register_joint,
    )
    from multiarm.scene.joints.contacts import SURFACES, ContactSpec, Geometry, register_surface
    from multiarm.scene.loading import (
        REGISTRIES,
        NamedCode,
        dump_scene,
        load_scene,
        named_code,
        parse_scene,
        refuse_code,
        with_code,
        without_code,
    )
    from multiarm.scene.object import Mesh, ObjectSpec, Shape
    from multiarm.scene.robots import (
        JointOutline,
        available_robots,
        find_robot,
        read_urdf,
        resolve_mesh,
        resolve_package_dirs,
    )
    from multiarm.scene.run import (
        ARM_TERMS,
        STEPS_CHOSEN_BY,
        AccuracySpec,
        RunSpec,
        StabilizationSpec,
    )
    from multiarm.scene.schema import Scene
    from multiarm.scene.surfaces import Surface
    from multiarm.scene.values import Pose, gain_vector, joint_vector

# Module -> the names that it gives this package.
_HOMES = {
    "arms": "ArmSpec ResolvedArm ToolSpec resolve_arm",
    "changes": "changed changed_scenes parse_path value_at",
    "control": "CONTROLS register_control",
    "control.kind": "Waypoint",
    "effects": "EFFECTS EffectsSpec register_effect",
    "effects.drives": "damping_of effort_limit_of friction_of",
    "effects.loads": "ExternalWrench read_wrench_table",
    "functions": "function_text",
    "joints": "JOINTS BallJoint ContactsJoint CornerGripperJoint CylindricalJoint Joint JointSpec "
    "PlanarJoint PointOnCylinderJoint PointOnPlaneJoint PointOnSphereJoint PrismaticJoint "
    "RevoluteJoint UniversalJoint WeldJoint WrenchesJoint register_joint",
    "joints.contacts": "SURFACES ContactSpec Geometry register_surface",
    "loading": "REGISTRIES NamedCode dump_scene load_scene named_code parse_scene refuse_code "
    "with_code without_code",
    "object": "Mesh ObjectSpec Shape",
    "robots": "JointOutline available_robots find_robot read_urdf resolve_mesh "
    "resolve_package_dirs",
    "run": "ARM_TERMS STEPS_CHOSEN_BY AccuracySpec RunSpec StabilizationSpec",
    "schema": "Scene",
    "surfaces": "Surface",
    "values": "Pose gain_vector joint_vector",
}
_MODULES = {name: module for module, names in _HOMES.items() for name in names.split()}

__all__ = [
    "ARM_TERMS",
    "CONTROLS",
    "EFFECTS",
    "JOINTS",
    "REGISTRIES",
    "STEPS_CHOSEN_BY",
    "SURFACES",
    "AccuracySpec",
    "ArmSpec",
    "BallJoint",
    "ContactSpec",
    "ContactsJoint",
    "CornerGripperJoint",
    "CylindricalJoint",
    "EffectsSpec",
    "ExternalWrench",
    "Geometry",
    "Joint",
    "JointOutline",
    "JointSpec",
    "Mesh",
    "NamedCode",
    "ObjectSpec",
    "PlanarJoint",
    "PointOnCylinderJoint",
    "PointOnPlaneJoint",
    "PointOnSphereJoint",
    "Pose",
    "PrismaticJoint",
    "ResolvedArm",
    "RevoluteJoint",
    "RunSpec",
    "Scene",
    "Shape",
    "StabilizationSpec",
    "Surface",
    "ToolSpec",
    "UniversalJoint",
    "Waypoint",
    "WeldJoint",
    "WrenchesJoint",
    "available_robots",
    "changed",
    "changed_scenes",
    "damping_of",
    "dump_scene",
    "effort_limit_of",
    "find_robot",
    "friction_of",
    "function_text",
    "gain_vector",
    "joint_vector",
    "load_scene",
    "named_code",
    "parse_path",
    "parse_scene",
    "read_urdf",
    "read_wrench_table",
    "refuse_code",
    "register_control",
    "register_effect",
    "register_joint",
    "register_surface",
    "resolve_arm",
    "resolve_mesh",
    "resolve_package_dirs",
    "value_at",
    "with_code",
    "without_code",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'multiarm.scene' has no attribute {name!r}")
    value = getattr(import_module(f"multiarm.scene.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
