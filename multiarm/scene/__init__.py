"""What a user writes: scenes, their parts, and the robots they may name."""

from multiarm.scene.arm_spec import ArmSpec, ToolSpec
from multiarm.scene.base import Pose
from multiarm.scene.contact_spec import ContactSpec
from multiarm.scene.control import (
    AccuracySpec,
    ComputedTorqueControl,
    ConstantControl,
    ControlSpec,
    GravityCompensationControl,
    HarmonicControl,
    JointPDControl,
    NoControl,
    ObjectImpedanceControl,
    RunSpec,
    StabilizationSpec,
    Waypoint,
)
from multiarm.scene.effects import EffectsSpec
from multiarm.scene.functions import function_text
from multiarm.scene.geometry import (
    ConeGeometry,
    CylinderGeometry,
    EllipsoidGeometry,
    Geometry,
    PatchSpec,
    PlaneGeometry,
    SphereGeometry,
    SurfaceGeometry,
    TorusGeometry,
)
from multiarm.scene.joint_effects import (
    ActuatorLag,
    JointFriction,
    damping_of,
    effort_limit_of,
    friction_of,
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
    WrenchesJoint,
)
from multiarm.scene.loader import dump_scene, load_scene, parse_scene
from multiarm.scene.loads import (
    Drag,
    ExternalWrench,
    Pulse,
    Sinusoid,
)
from multiarm.scene.object_control import ObjectGain
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
from multiarm.scene.wrench_table import WrenchTable, read_wrench_table

__all__ = [
    "AccuracySpec",
    "ActuatorLag",
    "ArmSpec",
    "BallJoint",
    "ComputedTorqueControl",
    "ConeGeometry",
    "ConstantControl",
    "ContactSpec",
    "ContactsJoint",
    "ControlSpec",
    "CornerGripperJoint",
    "Cylinder",
    "CylinderGeometry",
    "CylindricalJoint",
    "Drag",
    "EffectsSpec",
    "EllipsoidGeometry",
    "ExternalWrench",
    "Geometry",
    "GravityCompensationControl",
    "HarmonicControl",
    "JointBase",
    "JointFriction",
    "JointOutline",
    "JointPDControl",
    "JointSpec",
    "Mesh",
    "NoControl",
    "ObjectGain",
    "ObjectImpedanceControl",
    "ObjectSpec",
    "PatchSpec",
    "PlanarJoint",
    "PlaneGeometry",
    "PointOnCylinderJoint",
    "PointOnPlaneJoint",
    "PointOnSphereJoint",
    "Pose",
    "PrismaticJoint",
    "Pulse",
    "ResolvedArm",
    "RevoluteJoint",
    "RobotEntry",
    "RunSpec",
    "Scene",
    "Shape",
    "Sinusoid",
    "SphereGeometry",
    "StabilizationSpec",
    "SurfaceGeometry",
    "ToolSpec",
    "TorusGeometry",
    "UniversalJoint",
    "UrdfOutline",
    "Waypoint",
    "WeldJoint",
    "WrenchTable",
    "WrenchesJoint",
    "available_robots",
    "damping_of",
    "dump_scene",
    "effort_limit_of",
    "find_robot",
    "friction_of",
    "function_text",
    "gain_vector",
    "joint_vector",
    "load_scene",
    "parse_scene",
    "read_urdf",
    "read_wrench_table",
    "resolve_arm",
    "resolve_mesh",
    "resolve_package_dirs",
]
