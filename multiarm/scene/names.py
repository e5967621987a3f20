"""The public names of :mod:`multiarm.scene`."""

# ruff: noqa: F401

from multiarm.scene.arms import ArmSpec, BaseSpec, ToolSpec, resolve_arm
from multiarm.scene.bodies import WORLD, BodyName, object_named
from multiarm.scene.changes import parse_path, value_at
from multiarm.scene.code import function_text
from multiarm.scene.control import CONTROLS, Waypoint, register_control
from multiarm.scene.effects import EFFECTS, EffectsSpec, register_effect
from multiarm.scene.effects.drives import damping_of, effort_limit_of, friction_of
from multiarm.scene.effects.loads import ExternalWrench, read_wrench_table
from multiarm.scene.joint_values import gain_vector, joint_vector
from multiarm.scene.joints import JOINTS, JointSpec, register_joint
from multiarm.scene.joints.contacts import ContactsJoint, ContactSpec
from multiarm.scene.joints.fingertips import (
    CornerGripperJoint,
    PointOnCylinderJoint,
    PointOnPlaneJoint,
    PointOnSphereJoint,
)
from multiarm.scene.joints.kind import Joint
from multiarm.scene.joints.pairs import (
    BallJoint,
    CylindricalJoint,
    PlanarJoint,
    PrismaticJoint,
    RevoluteJoint,
    UniversalJoint,
    WeldJoint,
)
from multiarm.scene.joints.wrenches import WrenchesJoint
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
from multiarm.scene.meshes import resolve_mesh
from multiarm.scene.object import ObjectSpec
from multiarm.scene.resolution import MimicCoupling, ResolvedRobot
from multiarm.scene.robot_spec import MimicSpec, RobotBaseSpec, RobotSpec, resolve_robot
from multiarm.scene.robots import (
    RobotEntry,
    available_robots,
    find_robot,
    resolve_package_dirs,
)
from multiarm.scene.run import STEPS_CHOSEN_BY, AccuracySpec, RunSpec, StabilizationSpec
from multiarm.scene.schema import Scene, changed_scenes
from multiarm.scene.settings import ARM_TERMS
from multiarm.scene.shapes import Shape
from multiarm.scene.surfaces import SURFACES, Geometry, Surface, register_surface
from multiarm.scene.urdf import JointOutline, RobotOutline, read_urdf
from multiarm.scene.values import Pose
