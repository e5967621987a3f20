"""Claims about arms from MJCF files: they are those of MuJoCo, and of the same arms in URDF."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from commands import multiarm
from refusals import refused
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.assembly.robots import robot_files
from multiarm.errors import SceneError
from multiarm.robots.robot import Robot
from multiarm.scene import ArmSpec, dump_scene, parse_scene, resolve_arm

POSTURE = [0.3, -0.4, 0.5, 0.9, -0.6, 0.2]
BASE = {"xyz": [0.3, -0.2, 0.1], "rpy": [0.4, -0.3, 1.2]}


def words(values: object) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def both_files(rng: np.random.Generator, kinds: str, folder: Path) -> tuple[Path, Path]:
    """A chain of hinges (h) and slides (s) with full inertias, as URDF and as MJCF."""
    links, bodies = "<link name='l0'/>", ""
    for k, kind in enumerate(kinds, start=1):
        place, rpy, axis = rng.uniform(-0.4, 0.4, 3), rng.uniform(-1.5, 1.5, 3), rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        mass, centre = rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1, 3)
        root = rng.normal(size=(3, 3))
        xx, xy, xz, _, yy, yz, _, _, zz = (0.01 * np.ravel(root @ root.T + np.eye(3))).tolist()
        # the sum of two principal moments exceeds the third
        xx, yy, zz = (moment + 0.2 for moment in (xx, yy, zz))
        links += (
            f"<link name='l{k}'><inertial><origin xyz='{words(centre)}'/><mass value='{mass!r}'/>"
            f"<inertia ixx='{xx!r}' ixy='{xy!r}' ixz='{xz!r}' iyy='{yy!r}' iyz='{yz!r}' "
            f"izz='{zz!r}'/></inertial></link>"
            f"<joint name='j{k}' type='{'revolute' if kind == 'h' else 'prismatic'}'>"
            f"<parent link='l{k - 1}'/><child link='l{k}'/><axis xyz='{words(axis)}'/>"
            f"<origin xyz='{words(place)}' rpy='{words(rpy)}'/>"
            f"<limit lower='-1.5' upper='2.5' effort='30' velocity='1'/>"
            f"<dynamics damping='0.3' friction='0.2'/></joint>"
        )
        quaternion = np.roll(Rotation.from_euler("xyz", rpy).as_quat(), 1)
        bodies += (
            f"<body name='l{k}' pos='{words(place)}' quat='{words(quaternion)}'>"
            f"<joint name='j{k}' type='{'hinge' if kind == 'h' else 'slide'}' axis='{words(axis)}' "
            f"range='-1.5 2.5' damping='0.3' frictionloss='0.2' actuatorfrcrange='-30 30'/>"
            f"<inertial pos='{words(centre)}' mass='{mass!r}' "
            f"fullinertia='{words([xx, yy, zz, xy, xz, yz])}'/>"
        )
    tip, n = rng.uniform(-0.2, 0.2, 3), len(kinds)
    links += (
        f"<link name='tcp'/><joint name='tcp_fixed' type='fixed'><parent link='l{n}'/>"
        f"<child link='tcp'/><origin xyz='{words(tip)}'/></joint>"
    )
    bodies += f"<site name='tcp' pos='{words(tip)}'/>" + n * "</body>"
    urdf, mjcf = folder / "arm.urdf", folder / "arm.xml"
    urdf.write_text(f"<robot name='r'>{links}</robot>", encoding="utf-8")
    mjcf.write_text(model_text(bodies), encoding="utf-8")
    return urdf, mjcf


def model_text(bodies: str, parts: str = "", compiler: str = "angle='radian'") -> str:
    return f"<mujoco><compiler {compiler}/>{parts}<worldbody>{bodies}</worldbody></mujoco>"


def arm_of(**spec: object) -> Robot:
    own = ArmSpec(**{"base": BASE, **spec})
    return Robot("arm", robot_files(own, resolve_arm(own)))


@pytest.mark.parametrize("kinds", ["hhh", "hhhhhh", "shhsh"])
@pytest.mark.parametrize("lock", [{}, {"j2": 0.3}])
def test_the_same_arm_in_mjcf_and_urdf_has_the_same_outline_and_terms(kinds, lock, tmp_path, rng):
    urdf, mjcf = both_files(rng, kinds, tmp_path)
    first, second = (
        resolve_arm(ArmSpec(lock=lock, **own)) for own in ({"urdf": urdf}, {"mjcf": mjcf})
    )
    assert first.tip == second.tip == "tcp" and first.locked == second.locked
    for ours, theirs in zip(first.joints, second.joints, strict=True):
        np.testing.assert_allclose(ours.axis, theirs.axis, atol=1e-15)
        same = ("name", "kind", "child", "lower", "upper", "effort_limit", "damping", "friction")
        assert [getattr(ours, key) for key in same] == [getattr(theirs, key) for key in same]
    arms = arm_of(urdf=urdf, lock=lock), arm_of(mjcf=mjcf, lock=lock)
    for _ in range(5):
        q, v = rng.uniform(-1.0, 1.0, (2, arms[0].dof))
        expected, found = (arm.terms(q, v) for arm in arms)
        for name in ("M", "bias", "J", "tip_position", "tip_rotation", "tip_twist", "drift"):
            ours, theirs = getattr(found, name), getattr(expected, name)
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12, err_msg=name)


HARD = """
<body name="stand" pos="0.1 0.2 0.3" quat="0.9 0.1 0.2 0.3">
  <body name="shoulder" pos="0 0 0.1" euler="10 20 30">
    <joint name="j1" class="big" axis="0 1 1" pos="0.01 0.02 0.03"/>
    <inertial pos="0.1 0.05 0.02" mass="2" fullinertia="0.03 0.04 0.05 0.001 0.002 0.003"/>
    <body name="elbow" pos="0.4 0 0" axisangle="1 0 0 30" childclass="small">
      <joint name="j2" axis="1 0 0" range="-60 60"/>
      <inertial pos="0.1 0 0.01" quat="0.7 0.1 0.3 0.2" mass="1.1" diaginertia="0.01 0.015 0.02"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0.3 0.1 0" size="0.03"/>
      <body name="wrist" xyaxes="1 1 0 -1 1 0">
        <joint name="j3" axis="0 0 1" class="tiny"/>
        <inertial pos="0 0 0.1" mass="0.5" diaginertia="0.001 0.001 0.001"/>
        <site name="tcp" pos="0.2 0 0" euler="0 90 20"/>
      </body>
    </body>
  </body>
</body>
"""
DEFAULTS = "<default><joint armature='0.2'/><default class='small'><joint armature='0.02' "
DEFAULTS += "damping='0.4'/><default class='tiny'><joint frictionloss='0.3'/></default></default>"
DEFAULTS += "<default class='big'><joint armature='0.5' "
DEFAULTS += "range='-90 90'/></default></default>"


@pytest.fixture
def hard(tmp_path):
    path = tmp_path / "hard.xml"
    path.write_text(model_text(HARD, DEFAULTS, "angle='degree'"), encoding="utf-8")
    return path


def test_poses_inertia_and_bias_are_those_of_mujoco(hard, rng):
    """With the pose of the first body, defaults, armature and all forms of orientation."""
    arm = arm_of(mjcf=hard, base={})
    model = mujoco.MjModel.from_xml_path(str(hard))
    data = mujoco.MjData(model)
    np.testing.assert_allclose(arm.position_limits[:2], model.jnt_range[:2], atol=1e-15)
    joints = resolve_arm(ArmSpec(mjcf=hard)).joints
    np.testing.assert_array_equal([joint.damping for joint in joints], model.dof_damping)
    np.testing.assert_array_equal([joint.friction for joint in joints], model.dof_frictionloss)
    assert not np.isfinite(arm.position_limits[2]).any()
    for _ in range(5):
        data.qpos[:], data.qvel[:] = rng.uniform(-1.0, 1.0, (2, 3))
        mujoco.mj_forward(model, data)
        inertia = np.zeros((3, 3))
        mujoco.mj_fullM(model, data, inertia)
        found = arm.terms(data.qpos, data.qvel)
        np.testing.assert_allclose(found.M, inertia, atol=1e-13)
        np.testing.assert_allclose(found.bias, data.qfrc_bias, atol=1e-12)
        np.testing.assert_allclose(found.tip_position, data.site("tcp").xpos, atol=1e-14)
        np.testing.assert_allclose(found.tip_rotation.ravel(), data.site("tcp").xmat, atol=1e-14)


def test_its_shapes_are_where_mujoco_has_them(hard):
    arm = arm_of(mjcf=hard, base={})
    (shape,) = arm.visual_model().geometryObjects
    model = mujoco.MjModel.from_xml_path(str(hard))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3
    mujoco.mj_forward(model, data)
    joint, R, place = arm.link("tcp")  # a site
    assert joint == arm.tip.joint
    np.testing.assert_array_equal(R, arm.tip.rotation)
    np.testing.assert_array_equal(place, arm.tip.translation)
    own = arm.model.createData()
    pin.forwardKinematics(arm.model, own, data.qpos)
    pose = own.oMi[shape.parentJoint] * shape.placement
    np.testing.assert_allclose(pose.translation, data.geom("rod").xpos, atol=1e-14)


@pytest.mark.parametrize("arms", ["pinocchio", "compiled"])
def test_scenes_with_it_evaluate_as_with_urdf_and_load_again(arms, tmp_path, rng):
    files = dict(zip(("urdf", "mjcf"), both_files(rng, "hhhhhh", tmp_path), strict=True))
    found = {}
    for key, path in files.items():
        scene = ma.Scene(
            object={"shape": {"box": [0.3, 0.2, 0.1]}, "mass": 2.0},
            arms={"left": {key: str(path), "base": BASE, "posture": POSTURE}},
            joints=[{"arm": "left", "kind": "ball"}],
            effects={"joint_damping": 0.5},
            run={"arms": arms},
        )
        again = parse_scene(dump_scene(scene))
        found[key] = ma.evaluate(ma.compile_system(again))
    np.testing.assert_allclose(
        found["mjcf"].object_acceleration, found["urdf"].object_acceleration, atol=1e-11
    )
    np.testing.assert_allclose(
        found["mjcf"].joint_accelerations["left"],
        found["urdf"].joint_accelerations["left"],
        atol=1e-10,
    )


@pytest.mark.parametrize("lock", [{}, {"fj": 0.1}])
def test_a_tool_may_have_a_joint_of_its_own(lock, tmp_path, rng):
    """The joint leads to the tip, or is locked; drives of the arm keep their inertia."""
    urdf, mjcf = both_files(rng, "hhh", tmp_path)
    mjcf.write_text(mjcf.read_text().replace("<joint ", "<joint armature='0.3' "))
    link = (
        "<link name='{}'><inertial><mass value='0.5'/>"
        "<inertia ixx='1' ixy='0' ixz='0' iyy='1' iyz='0' izz='1'/></inertial></link>"
    )
    tool = tmp_path / "tool.urdf"
    tool.write_text(
        f"<robot name='t'>{link.format('palm')}{link.format('finger')}"
        "<joint name='fj' type='revolute'><parent link='palm'/><child link='finger'/>"
        "<axis xyz='0 1 0'/><limit lower='-1' upper='1' effort='5' velocity='1'/></joint></robot>"
    )
    more = {"tool": {"urdf": tool, "mount": "l3"}, "tip": "finger", "lock": lock}
    arms = [arm_of(**{key: path}, **more) for key, path in (("urdf", urdf), ("mjcf", mjcf))]
    q = rng.normal(size=arms[0].dof)
    plain, driven = (arm.terms(q, np.zeros(q.size)).M for arm in arms)
    armature = [0.3, 0.3, 0.3, 0.0][: q.size]
    np.testing.assert_allclose(driven, plain + np.diag(armature), atol=1e-12)


ONE = "<body name='a'><joint name='j' axis='0 0 1'/>{}</body>"
MASS = "<inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>"


@pytest.mark.parametrize(
    "text",
    [
        "<robot/>",
        "<mujoco",
        model_text(ONE.format(MASS).replace("name='a'", "name='a' pos='a b'")),
        model_text(""),
        model_text(2 * ONE.format(MASS)),
        model_text(ONE.format(MASS).replace("name='j'", "")),
        model_text(ONE.format(MASS).replace("axis=", "limited='false' axis=")),
        model_text(ONE.format(f"{MASS}<site name='s' axisangle='1 1 0 1'/>")),
        model_text(ONE.format(MASS), "<default><joint pos='0 0 1'/></default>"),
        model_text(f"<body name='a'><freejoint/>{MASS}</body>"),
        model_text(f"<body name='a'><joint type='ball'/>{MASS}</body>"),
        model_text(ONE.format(f"<joint name='k'/>{MASS}")),
        model_text(ONE.format(MASS), "<equality><weld body1='a'/></equality>"),
        model_text(ONE.format(f"{MASS}<frame/>")),
        model_text(ONE.format(f"<include file='b.xml'/>{MASS}")),
        model_text(ONE.format(f"<site name='a'/>{MASS}")),
        model_text(
            f"<body name='a' childclass='p'><joint class='q'/>{MASS}</body>",
            "<default><default class='p'/><default class='q'/></default>",
        ),
        model_text(ONE.format(MASS), compiler="eulerseq='XYZ'"),
        model_text(ONE.format(MASS), compiler="settotalmass='3'"),
        model_text(f"<body name='a'><joint type='slide' range='-1 1'/>{MASS}</body>", "", ""),
        model_text(ONE.format("<geom size='1'/>")),
        model_text(f"<body name='s' euler='1 0 0'>{ONE.format(MASS)}</body>"),
        model_text(ONE.format(MASS), "<default><joint stiffness='3'/></default>"),
    ],
)
def test_what_would_be_another_arm_in_mujoco_is_refused(text, tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(text, encoding="utf-8")
    with refused(SceneError, "arm.mjcf"):
        resolve_arm(ArmSpec(mjcf=path))


def test_a_file_is_shown_like_a_robot(hard):
    result = multiarm("robots", hard, columns=100)
    assert result.exit_code == 0, result.output
    assert "tip" in result.stdout and "tcp (3 joints)" in result.stdout
    assert f"    mjcf: {hard}" in result.stdout


@pytest.mark.parametrize("path", ["~nosuchuser/arm.xml", "a\0b.xml"])
@pytest.mark.parametrize("place", ["urdf", "mjcf", "tool.urdf"])
def test_the_path_of_no_file_is_told_at_its_place(place, path):
    source = {place: path}
    if place == "tool.urdf":
        source = {"robot": "ur5", "tool": {"urdf": path, "mount": "tool0"}}
    with pytest.raises(SceneError, match=rf"ArmSpec\.{place}: "):
        ArmSpec(**source)


def test_an_arm_has_one_source(hard):
    with refused(SceneError, "'mjcf'"):
        ArmSpec(robot="ur5", mjcf=hard)
    with refused(SceneError):
        resolve_arm(ArmSpec(mjcf=hard.with_name("none.xml")))
