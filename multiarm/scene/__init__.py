"""What a user writes: scenes, their parts, and the robots they may name."""

from multiarm.scene.arm_spec import ArmSpec, ToolSpec
from multiarm.scene.base import Pose
from multiarm.scene.control import (
    ConstantControl,
    ControlSpec,
    EffectsSpec,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    NoControl,
    RunSpec,
    StabilizationSpec,
    Waypoint,
)
from multiarm.scene.geometry import (
    ContactSpec,
    CylinderGeometry,
    Geometry,
    PlaneGeometry,
    SphereGeometry,
)
from multiarm.scene.joints import (
    BallJoint,
    ContactsJoint,
    CornerGripperJoint,
    CylindricalJoint,
    JointBase,
    JointSpec,
    PlanarJoint,
    PointOnCylinderJoint,
    PointOnPlaneJoint,
    PointOnSphereJoint,
    PrismaticJoint,
    RevoluteJoint,
    UniversalJoint,
    WeldJoint,
)
from multiarm.scene.loader import dump_scene, load_scene, parse_scene
from multiarm.scene.object_spec import Cylinder, Mesh, ObjectSpec, Shape
from multiarm.scene.resolve import ResolvedArm, resolve_arm
from multiarm.scene.robots import (
    RobotEntry,
    available_robots,
    find_robot,
    resolve_mesh,
    resolve_package_dirs,
)
from multiarm.scene.schema import Scene
from multiarm.scene.urdf import JointOutline, UrdfOutline, read_urdf
from multiarm.scene.values import gain_vector, joint_vector

__all__ = [
    "ArmSpec",
    "BallJoint",
    "ConstantControl",
    "ContactSpec",
    "ContactsJoint",
    "ControlSpec",
    "CornerGripperJoint",
    "Cylinder",
    "CylinderGeometry",
    "CylindricalJoint",
    "EffectsSpec",
    "Geometry",
    "GravityCompensationControl",
    "HarmonicControl",
    "JointBase",
    "JointOutline",
    "JointPDControl",
    "JointSpec",
    "Mesh",
    "NoControl",
    "ObjectSpec",
    "PlanarJoint",
    "PlaneGeometry",
    "PointOnCylinderJoint",
    "PointOnPlaneJoint",
    "PointOnSphereJoint",
    "Pose",
    "PrismaticJoint",
    "ResolvedArm",
    "RevoluteJoint",
    "RobotEntry",
    "RunSpec",
    "Scene",
    "Shape",
    "SphereGeometry",
    "StabilizationSpec",
    "ToolSpec",
    "UniversalJoint",
    "UrdfOutline",
    "Waypoint",
    "WeldJoint",
    "available_robots",
    "dump_scene",
    "find_robot",
    "gain_vector",
    "joint_vector",
    "load_scene",
    "parse_scene",
    "read_urdf",
    "resolve_arm",
    "resolve_mesh",
    "resolve_package_dirs",
]
