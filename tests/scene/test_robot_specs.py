"""Claims about robots with several tips: their joints, their bases, couplings, what joints name."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from refusals import refused

from multiarm.errors import SceneError
from multiarm.scene import (
    WORLD,
    ArmSpec,
    BodyName,
    MimicCoupling,
    RobotSpec,
    Scene,
    available_robots,
    consistency,
    dump_scene,
    find_robot,
    load_scene,
    object_named,
    parse_scene,
    read_urdf,
    resolve_arm,
    resolve_robot,
)
from multiarm.scene.mjcf import read_mjcf
from multiarm.scene.robot_spec import examine_robot
from multiarm.scene.robots import _example_files

BRANCHED = (
    "tiago", "tiago_dual", "tiago_pro", "talos", "talos_full_v2", "baxter", "g1_29dof_rev_1_0",
    "g1_29dof_with_hand_rev_1_0", "allegro_left_hand", "romeo", "pr2", "centauro",
)  # fmt: skip
TIPS = {"left": "arm_left_7_link", "right": "arm_right_7_link"}
ARMS = [f"arm_{side}_{k}_joint" for side in ("left", "right") for k in range(1, 8)]
PLANE = {"moves": ["x", "y", "yaw"]}

# A leader j1 with followers on two branches; j4 copies the follower j2, and k a joint beside them.
HAND = """<robot name='hand'><link name='palm'/>{0}</robot>"""
JOINT = """<link name='{1}'/><joint name='{0}' type='revolute'><parent link='{2}'/>
<child link='{1}'/><axis xyz='0 0 1'/><limit lower='-1' upper='1' effort='1' velocity='1'/>{3}
</joint>"""


def mimic(joint: str, multiplier: float = 1.0, offset: float = 0.0) -> str:
    return f"<mimic joint='{joint}' multiplier='{multiplier}' offset='{offset}'/>"


@pytest.fixture
def hand(tmp_path):
    joints = [
        ("j1", "a1", "palm", ""),
        ("j4", "a2", "a1", mimic("j2", 2.0)),
        ("j2", "b1", "palm", mimic("j1", -0.5, 0.1)),
        ("j3", "b2", "b1", ""),
        ("side", "c1", "palm", ""),
        ("k", "b3", "b2", mimic("side", 1.0, 0.2)),
    ]
    path = tmp_path / "hand.urdf"
    path.write_text(HAND.format("".join(JOINT.format(*joint) for joint in joints)))
    return path


def tiago(**more) -> dict:
    return {"robot": "tiago_pro", "tips": TIPS, **more}


def scene_with(robots: dict, *joints: dict, **more) -> Scene:
    body = {"shape": {"box": [0.6, 0.5, 0.4]}, "mass": 5.0}
    return parse_scene({"object": body, "robots": robots, "joints": list(joints), **more})


def weld(*between: str, **more) -> dict:
    return {"between": list(between), "kind": "weld", **more}


# --- the joints that move -------------------------------------------------------------------------


@pytest.mark.parametrize("name", BRANCHED)
def test_joints_stand_in_the_order_of_pinocchios_model(name):
    path = _example_files().get(name) or find_robot(name).urdf
    model = pin.buildModelFromUrdf(str(path))
    joints = [joint.name for joint in read_urdf(path).in_model_order() if joint.movable]
    assert joints == list(model.names)[1:]


def test_all_robots_that_are_installed_stand_in_the_order_of_pinocchios_model():
    entries = available_robots().values()
    assert len(entries) > 20
    for entry in entries:
        model = pin.buildModelFromUrdf(str(entry.urdf))
        joints = [joint.name for joint in entry.outline.in_model_order() if joint.movable]
        assert joints == list(model.names)[1:], entry.name


def test_joints_of_mjcf_stand_in_the_order_of_the_file(tmp_path):
    body = "<body name='{0}'><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>{1}{2}</body>"
    turn = "<joint name='{0}' type='hinge' axis='0 0 1'/>"
    first = body.format("z", turn.format("jz"), body.format("y", turn.format("jy"), ""))
    path = tmp_path / "tree.xml"
    tree = body.format("base", "", first + body.format("a", turn.format("ja"), ""))
    path.write_text(f"<mujoco><worldbody>{tree}</worldbody></mujoco>")
    joints = [joint.name for joint in read_mjcf(path).in_model_order() if joint.movable]
    assert joints == list(pin.buildModelFromMJCF(str(path)).names)[1:] == ["jz", "jy", "ja"]
    spec = RobotSpec(mjcf=path, tips={"one": "y", "two": "a"}, lock={"jz": 0.1})
    assert resolve_robot(spec).joint_names == ("jy", "ja")


def test_the_joints_on_the_way_to_any_tip_move_and_the_rest_is_locked():
    resolved = resolve_robot(RobotSpec(**tiago()))
    assert resolved.joint_names == ("torso_lift_joint", *ARMS) and resolved.tips == TIPS
    movable = {joint.name for joint in find_robot("tiago_pro").outline.joints if joint.movable}
    assert resolved.locked.keys() == movable - {*resolved.joint_names}
    scene = scene_with(
        {"tiago": tiago()}, weld("tiago/left", "object"), weld("tiago/right", "world")
    )
    (warning,) = scene.warnings
    assert warning.startswith("$.robots.tiago: ") and "'lock' chooses" in warning


def test_reduced_models_of_pinocchio_have_the_same_joints():
    spec = RobotSpec(**tiago(lock={"arm_left_3_joint": 0.4}))
    resolved = resolve_robot(spec, ["head_2_link"])
    full = pin.buildModelFromUrdf(str(resolved.urdf))
    held = [full.getJointId(name) for name in resolved.locked]
    reduced = pin.buildReducedModel(full, held, pin.neutral(full))
    assert resolved.joint_names == tuple(reduced.names)[1:]
    assert "head_2_joint" in resolved.joint_names and resolved.locked["arm_left_3_joint"] == 0.4


def test_a_robot_with_one_tip_has_the_joints_and_the_start_of_an_arm():
    common = {"robot": "ur5", "posture": {"elbow_joint": 0.4}, "lock": {"wrist_1_joint": -0.3}}
    robot = resolve_robot(RobotSpec(tips={"tool": "tool0"}, **common))
    arm = resolve_arm(ArmSpec(tip="tool0", **common))
    assert (robot.joints, robot.locked) == (arm.joints, arm.locked)
    assert np.array_equal(robot.posture, arm.posture) and arm.tips == {"": robot.tips["tool"]}


def test_every_joint_moves_of_a_robot_without_tips():
    """As many as Pinocchio's model of the file has; the last link of each limb is a tip."""
    spec = RobotSpec(robot="talos", base={"moves": "free"})
    resolved = resolve_robot(spec)
    full = pin.buildModelFromUrdf(str(resolved.urdf))
    assert resolved.joint_names == tuple(full.names)[1:] and resolved.locked == {}
    carriers = {full.frames[full.getFrameId(link)].parentJoint for link in resolved.tips.values()}
    assert carriers == {i for i in range(1, full.njoints) if not len(full.children[i])}
    assert len(resolved.tips) == len(carriers)
    # where a joint of the scene names a link, that is what moves
    ends = resolve_robot(spec, ["arm_left_7_link"]).joint_names
    assert ends[-1] == "arm_left_7_joint" and len(ends) == 9


def test_links_that_joints_name_move_as_tips_do():
    scene = scene_with({"tiago": tiago()}, weld("tiago/head_2_link", "world"))
    assert scene.links_in_joints("tiago") == ("head_2_link",)
    resolved = resolve_robot(scene.robots["tiago"], scene.links_in_joints("tiago"))
    assert resolved.joint_names[-2:] == ("head_1_joint", "head_2_joint")
    assert resolved.tips == {**TIPS, "head_2_link": "head_2_link"}
    apart = scene.replace(joints=[weld("tiago/left", "world")])
    assert apart.links_in_joints("tiago") == ()


# --- the base -------------------------------------------------------------------------------------


def test_the_joints_of_the_base_come_first_in_the_order_x_y_z_yaw():
    base = {**PLANE, "limits": {"x": [-1, 2]}, "effort": {"yaw": 30}, "mass": 20}
    spec = RobotSpec(**tiago(base=base, posture={"base_x": 0.3, "torso_lift_joint": 0.1}))
    resolved = resolve_robot(spec)
    assert resolved.joints[:3] == resolved.base_joints
    x, y, yaw = resolved.base_joints
    assert [joint.name for joint in (x, y, yaw)] == ["base_x", "base_y", "base_yaw"]
    assert [joint.kind for joint in (x, y, yaw)] == ["prismatic", "prismatic", "continuous"]
    assert (x.axis, y.axis, yaw.axis) == ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    assert (x.lower, x.upper, y.upper, yaw.effort_limit) == (-1.0, 2.0, np.inf, 30.0)
    assert list(resolved.posture[:4]) == [0.3, 0.0, 0.0, 0.1]
    assert resolved.base_mass == 20.0 and not resolved.base_inertia.any()


def test_wheels_have_the_joints_of_a_base_that_slides():
    base = {"moves": "differential", "limits": {"x": [-1, 2]}, "effort": {"yaw": 30}}
    resolved = resolve_robot(RobotSpec(**tiago(base=base)))
    sliding = resolve_robot(RobotSpec(**tiago(base={**base, **PLANE})))
    assert resolved.base_joints == sliding.base_joints
    assert resolved.on_wheels and not sliding.on_wheels
    scene = scene_with({"tiago": tiago(base=base)}, {"arm": "tiago/left", "kind": "weld"})
    assert parse_scene(dump_scene(scene)).robots["tiago"].base.moves == "differential"


def test_every_link_of_a_robot_on_a_moving_base_moves():
    robots = {"cart": {"robot": "tiago_pro", "base": PLANE, "tips": {"plate": "base_link"}}}
    scene = scene_with(robots, weld("cart/plate", "object"))
    resolved = resolve_robot(scene.robots["cart"])
    assert resolved.joint_names == ("base_x", "base_y", "base_yaw")
    inertia = {"inertia": [1, 2, 2.5]}
    turned = scene.replace({"robots.cart.base": {**PLANE, **inertia}})
    added = resolve_robot(turned.robots["cart"]).base_inertia
    np.testing.assert_array_equal(added, np.diag([1, 2, 2.5]))


@pytest.mark.parametrize(
    ("base", "place"),
    [
        ({"moves": "free", "limits": {"x": [0, 1]}}, "$.robots.tiago.base"),
        ({"moves": "differential", "limits": {"z": [0, 1]}}, "$.robots.tiago.base"),
        ({"moves": "x"}, "$.robots.tiago.base.moves"),
        ({"moves": ["yaw", "x", "y"]}, "$.robots.tiago.base"),
        ({"moves": ["x", "x"]}, "$.robots.tiago.base"),
        ({"moves": ["roll"]}, "$.robots.tiago.base.moves"),
        ({"moves": ["x"], "limits": {"y": [0, 1]}}, "$.robots.tiago.base"),
        ({"moves": ["x"], "limits": {"x": [1, 0]}}, "$.robots.tiago.base.limits.x"),
        ({"moves": ["x"], "effort": {"x": 0}}, "$.robots.tiago.base.effort.x"),
        ({"moves": ["x"], "inertia": [1, 1, 3]}, "$.robots.tiago.base.inertia"),
        ({"mass": 3}, "$.robots.tiago.base"),
        ({"solve": ["roll"]}, "$.robots.tiago.base.solve[0]"),
        ({"solve": ["x", "x"]}, "$.robots.tiago.base"),
        ({"solve": ["x"], "moves": ["x", "y"]}, "$.robots.tiago.base"),
        ({"solve": ["x"], "moves": "differential"}, "$.robots.tiago.base"),
    ],
)
def test_bases_that_cannot_be_are_refused_and_nothing_else(base, place):
    with refused(SceneError, place) as caught:
        scene_with({"tiago": tiago(base=base)}, {"arm": "tiago/left", "kind": "weld"})
    assert len(caught.value.faults) == 1


def test_a_base_that_is_found_has_no_posture_of_its_own():
    with refused(SceneError, "$.robots.tiago.base.solve") as caught:
        spec = tiago(base={"solve": ["x", "yaw"]}, posture=15 * [0.0])
        scene_with({"tiago": spec}, {"arm": "tiago/left", "kind": "weld"})
    assert len(caught.value.faults) == 1


@pytest.mark.parametrize("moves", [["x", "y", "yaw"], ["y"], "differential", "free"])
@pytest.mark.parametrize("key", ["lock", "mimic"])
def test_joints_of_the_base_are_neither_locked_nor_coupled(key, moves):
    value = {"lock": 0.1, "mimic": {"of": "torso_lift_joint"}}[key]
    with refused(SceneError, f"$.robots.tiago.{key}.base_x") as caught:
        scene_with({"tiago": tiago(base={"moves": moves}, **{key: {"base_x": value}})})
    assert len(caught.value.faults) == 1
    assert "unknown" not in str(caught.value)


def test_limits_of_a_base_that_move_it_from_its_pose_are_told():
    base = {"moves": ["x", "yaw"], "limits": {"x": [0.2, 0.5], "yaw": [-1, -0.25]}}
    joint = {"arm": "tiago/left", "kind": "weld"}

    def warnings(**more) -> list[str]:
        robot = {"robot": "tiago_pro", "tips": {"left": TIPS["left"]}, "base": base, **more}
        texts = scene_with({"tiago": robot}, joint).warnings
        return [text for text in texts if "does not start where its pose is written" in text]

    along, about = warnings()
    assert "'base_x', 0.2 to 0.5 m" in along and "starts at 0.2 m" in along
    assert "'base_yaw', -1 to -0.25 rad" in about and "starts at -0.25 rad" in about
    assert warnings(posture={"base_x": 0.4}) == [about]
    assert warnings(posture="solve") == warnings(posture=[0.3, -0.5] + 8 * [0.1]) == []


# --- joints that copy others ----------------------------------------------------------------------


def test_followers_move_with_their_leaders_and_start_where_these_put_them(hand):
    tips = {"a": "a2", "b": "b2"}
    resolved = resolve_robot(
        RobotSpec(urdf=hand, tips=tips, posture={"j1": 0.4}, velocity={"j1": 2})
    )
    assert resolved.joint_names == ("j1", "j4", "j2", "j3")
    followers = {MimicCoupling("j2", "j1", -0.5, 0.1), MimicCoupling("j4", "j2", 2.0, 0.0)}
    assert {*resolved.mimic} == followers
    np.testing.assert_allclose(resolved.posture, [0.4, -0.2, -0.1, 0.0], atol=1e-15)
    np.testing.assert_allclose(resolved.velocity, [2.0, -2.0, -1.0, 0.0], atol=1e-15)


def test_followers_are_held_where_their_leaders_are(hand):
    tips = {"a": "a2", "b": "b2"}
    spec = RobotSpec(urdf=hand, tips=tips, lock={"j1": 0.6}, base={"moves": ["x"]})
    resolved = resolve_robot(spec)
    assert resolved.joint_names == ("base_x", "j3") and resolved.mimic == ()
    assert resolved.locked == pytest.approx(
        {"j1": 0.6, "j2": -0.2, "j4": -0.4, "side": 0, "k": 0.2}
    )
    alone = resolve_robot(RobotSpec(urdf=hand, tips=tips, lock={"j2": 0.3}))
    assert alone.joint_names == ("j1", "j3") and alone.locked["j4"] == 0.6


def test_a_follower_whose_leader_lies_beside_the_way_is_held_and_told(hand):
    scene = scene_with({"hand": {"urdf": hand, "tips": {"b": "b3"}}})
    assert resolve_robot(scene.robots["hand"]).locked["k"] == 0.2
    assert any("'k' copies 'side'" in text for text in scene.warnings)
    both = scene_with({"hand": {"urdf": hand, "tips": {"b": "b3", "c": "c1"}}})
    assert not any("'k' copies" in text for text in both.warnings)


def test_the_scene_adds_couplings_and_replaces_those_of_the_file(hand):
    mimic = {"j2": {"of": "j3", "multiplier": 3.0}, "k": {"of": "j1", "offset": 0.5}}
    scene = scene_with({"hand": {"urdf": hand, "tips": {"a": "a1", "b": "b3"}, "mimic": mimic}})
    resolved = resolve_robot(scene.robots["hand"])
    assert resolved.joint_names == ("j1", "j2", "j3", "k")
    assert {*resolved.mimic} == {
        MimicCoupling("j2", "j3", 3.0, 0.0), MimicCoupling("k", "j1", 1.0, 0.5)
    }  # fmt: skip
    idle = scene_with({"hand": {"urdf": hand, "tips": {"a": "a1"}, "mimic": {"j3": {"of": "j1"}}}})
    assert any("no effect on 'j3'" in text for text in idle.warnings)


@pytest.mark.parametrize(
    ("mimic", "place"),
    [
        ({"j9": {"of": "j1"}}, "$.robots.hand.mimic.j9"),
        ({"j3": {"of": "j9"}}, "$.robots.hand.mimic.j3.of"),
        ({"j3": {"of": "j3"}}, "$.robots.hand.mimic.j3"),
        ({"j1": {"of": "j4"}}, "$.robots.hand.mimic.j1"),
        ({"locked": {"of": "j1"}}, "$.robots.hand.mimic.locked"),
        ({"j3": {}}, "$.robots.hand.mimic.j3.of"),
    ],
)
def test_couplings_that_cannot_be_are_refused(hand, mimic, place):
    lock = {}
    if "locked" in mimic:  # a joint that is held cannot copy another
        mimic, lock, place = {"j3": mimic["locked"]}, {"j3": 0.1}, "$.robots.hand.mimic.j3"
    robot = {"urdf": hand, "tips": {"a": "a2", "b": "b3"}, "mimic": mimic, "lock": lock}
    with refused(SceneError, place) as caught:
        scene_with({"hand": robot})
    assert len(caught.value.faults) == 1


def test_a_file_whose_joint_copies_one_that_it_lacks_is_refused(tmp_path):
    path = tmp_path / "hand.urdf"
    path.write_text(HAND.format(JOINT.format("j1", "a1", "palm", mimic("nobody"))))
    with refused(SceneError, "$.robots.hand"):
        scene_with({"hand": {"urdf": path, "tips": {"a": "a1"}}})
    held = {"urdf": path, "tips": {"a": "a1"}, "lock": {"j1": 0.0}, "base": PLANE}
    assert resolve_robot(RobotSpec(**held)).joint_names == ("base_x", "base_y", "base_yaw")


# --- joints that are held, and tips ---------------------------------------------------------------


@pytest.mark.parametrize("key", ["posture", "velocity"])
def test_a_value_of_a_joint_that_is_held_hears_that_it_is_held(key):
    lock, left = {"arm_left_1_joint": 0.3}, {"arm": "tiago/left", "kind": "weld"}
    values = {"arm_left_1_joint": 0.1, "head_1_joint": 0.2, "arm_left_2_joint": 0.1}
    places = [f"$.robots.tiago.{key}.{joint}" for joint in list(values)[:2]]
    with refused(SceneError, *places) as caught:
        scene_with({"tiago": tiago(lock=lock, **{key: values})}, left)
    locked, resting = map(str, caught.value.faults)
    assert "locked at 0.3" in locked and "held at 0" in resting


def test_gains_and_postures_of_arms_hear_that_a_joint_is_locked():
    arm = {"robot": "ur5", "lock": {"elbow_joint": 1.2}, "posture": {"elbow_joint": 0.5}}
    effects = {"joint_damping": {"left": {"elbow_joint": 2.0}}}
    with refused(SceneError, "$.arms.left.posture.elbow_joint", "joint_damping.left") as caught:
        scene_with({}, {"arm": "left", "kind": "weld"}, arms={"left": arm}, effects=effects)
    assert all("locked at 1.2" in str(fault) for fault in caught.value.faults)


def test_a_tip_at_no_link_is_one_fault_whatever_names_the_joints_of_its_arm():
    tips = {**TIPS, "left": "arm_left_7_lik"}
    joints = {f"arm_left_{k}_joint": 0.1 for k in range(1, 8)}
    wrench = {"on": "tiago/arm_left_5_link", "force": [0, 0, 1]}
    with refused(SceneError, "$.robots.tiago.tips.left") as caught:
        scene_with(
            {"tiago": tiago(tips=tips, posture=joints, velocity=15 * [0.0])},
            {"arm": "tiago/left", "kind": "weld"},
            control={"kind": "joint_pd", "stiffness": {"tiago": joints}, "damping": 1.0},
            effects={"joint_damping": {"tiago": 15 * [1.0]}, "external_wrenches": [wrench]},
        )
    assert len(caught.value.faults) == 1


HEAD = {**TIPS, "head": "head_2_link"}


def idle(*joints: dict, tips: dict = HEAD, **more) -> list[str]:
    texts = scene_with({"tiago": tiago(tips=tips)}, *joints, **more).warnings
    return [text for text in texts if "names this tip" in text]


def test_tips_that_nothing_uses_are_told_with_the_joints_that_they_move():
    both = [{"arm": "tiago/left", "kind": "weld"}, weld("tiago/right", "world")]
    (head,) = idle(*both)
    assert head.startswith("$.robots.tiago.tips.head: ")
    assert "'head_1_joint', 'head_2_joint':" in head and "torso" not in head
    left, head = idle(both[1])
    assert "'arm_left_1_joint'" in left and "torso" not in left
    (second,) = idle(*both, tips={**TIPS, "second": TIPS["left"]})
    assert second.startswith("$.robots.tiago.tips.second: ") and "alone" not in second


@pytest.mark.parametrize(
    "use",
    [
        {"joints": [weld("tiago/head_2_link", "world")]},
        {"effects": {"external_wrenches": [{"on": "tiago/head_2_link", "force": [0, 0, 1]}]}},
        {"effects": {"joint_damping": {"tiago": {"head_1_joint": 0.1}}}},
        {
            "control": {
                "kind": "joint_pd",
                "damping": 1,
                "stiffness": {"tiago": {"head_2_joint": 9}},
            }
        },
    ],
    ids=["joint at its link", "wrench", "effect on its joints", "control of its joints"],
)
def test_tips_that_joints_effects_or_control_use_are_not(use):
    both = [{"arm": "tiago/left", "kind": "weld"}, weld("tiago/right", "world")]
    joints = [*both, *use.pop("joints", [])]
    assert idle(*joints, **use) == []


def test_two_tips_may_stand_for_one_link():
    tips = {**TIPS, "again": TIPS["left"]}
    joints = [{"arm": f"tiago/{tip}", "kind": "weld"} for tip in ("left", "again", "right")]
    scene = scene_with({"tiago": tiago(tips=tips)}, *joints)
    assert resolve_robot(scene.robots["tiago"]).tips == tips
    assert [joint.connection for joint in scene.joints] == [
        "tiago/left",
        "tiago/again",
        "tiago/right",
    ]
    with refused(SceneError, "$.joints[2].between"):
        scene_with({"tiago": tiago(tips=tips)}, *joints[::2], weld("tiago/left", "tiago/again"))


# --- what joints connect --------------------------------------------------------------------------


def test_joints_name_their_bodies_and_themselves():
    arms = {"helper": {"robot": "ur5"}}
    joints = [
        {"arm": "tiago/left", "kind": "weld", "name": "a grip"},
        weld("tiago/right", "world", at_first={"xyz": [0, 0, 0.1]}),
        weld("tiago/left", "object", name="second grip"),
        weld("object", "world"),
        weld("tiago/torso_lift_link", "tiago/right"),
        {"arm": "helper", "kind": "ball"},
        weld("helper", "world"),
    ]
    scene = scene_with({"tiago": tiago()}, *joints, arms=arms)
    left, right = BodyName("tiago", "left"), BodyName("tiago", "right")
    bodies = [(joint.connection, joint.first, joint.second) for joint in scene.joints]
    assert bodies == [
        ("tiago/left", left, object_named("object")),
        ("tiago/right-world", right, WORLD),
        ("second grip", left, object_named("object")),
        ("object-world", object_named("object"), WORLD),
        ("tiago/torso_lift_link-tiago/right", BodyName("tiago", "torso_lift_link"), right),
        ("helper", BodyName("helper", ""), object_named("object")),
        ("helper-world", BodyName("helper", ""), WORLD),
    ]
    assert scene.joints[1].on_first.xyz == (0.0, 0.0, 0.1)
    assert scene.joints[1].frames(np.eye(4))[0][2, 3] == 0.1
    assert parse_scene(dump_scene(scene)) == scene
    assert "tiago (tiago_pro, weld, weld, weld, weld)" in repr(scene)


@pytest.mark.parametrize(
    ("joint", "place"),
    [
        ({"arm": "tiago", "kind": "weld"}, "$.joints[0].arm"),
        ({"arm": "tiago/lft", "kind": "weld"}, "$.joints[0].arm"),
        ({"arm": "tiago/head_2_link", "kind": "weld"}, "$.joints[0].arm"),
        ({"arm": "tiagi/left", "kind": "weld"}, "$.joints[0].arm"),
        ({"arm": "helper/tool0", "kind": "weld"}, "$.joints[0].arm"),
        ({"kind": "weld"}, "$.joints[0]"),
        ({"arm": "tiago/left", **weld("tiago/left", "world")}, "$.joints[0]"),
        (weld("tiago/left", "world", at_first={}, at_tip={}), "$.joints[0]"),
        (weld("tiago/left"), "$.joints[0].between"),
        (weld("tiago/left", 3), "$.joints[0].between[1]"),
        (weld("tiago/lft", "object"), "$.joints[0].between[0]"),
        (weld("tiago", "object"), "$.joints[0].between[0]"),
        (weld("box", "world"), "$.joints[0].between[0]"),
        (weld("/object", "world"), "$.joints[0].between[0]"),
        (weld("helper/", "world"), "$.joints[0].between[0]"),
        (weld("helper/tool0", "world"), "$.joints[0].between[0]"),
        (weld("object", "tiago/left"), "$.joints[0].between"),
        (weld("world", "object"), "$.joints[0].between"),
        (weld("world", "world"), "$.joints[0].between"),
        (weld("tiago/left", "tiago/left"), "$.joints[0].between"),
        (weld("tiago/left", "tiago/arm_left_7_link"), "$.joints[0].between"),
        (weld("tiago/base_link", "world"), "$.joints[0].between"),
        (weld("tiago/left", "world", name="floor"), "$.joints[0].name"),
        (weld("tiago/left", "world", name="tiago"), "$.joints[0].name"),
        (weld("tiago/left", "world", name="helper"), "$.joints[0].name"),
    ],
)
def test_joints_between_what_cannot_be_joined_are_refused(joint, place):
    held = {"arm": "helper", "kind": "weld"}
    with refused(SceneError, place) as caught:
        scene_with({"tiago": tiago()}, joint, held, arms={"helper": {"robot": "ur5"}})
    assert len(caught.value.faults) == 1


def test_one_machine_is_joined_across_its_links_only_where_a_joint_moves_between_them():
    robots = {"tiago": tiago(lock={"arm_left_7_joint": 0.0})}
    held = weld("tiago/left", "tiago/arm_left_6_link")  # which only the locked joint separates
    with refused(SceneError, "$.joints[0].between"):
        scene_with(robots, held)
    scene_with(robots, weld("tiago/left", "tiago/arm_left_5_link"))


@pytest.mark.parametrize(
    ("joints", "count"),
    [
        ([{"arm": "tiago/left", "kind": "weld"}] * 2, 1),
        ([weld("tiago/left", "world")] * 2, 1),
        ([weld("tiago/left", "world"), weld("tiago/left", "world", name="second")], 0),
        ([{"arm": "tiago/left", "kind": "weld"}, weld("tiago/left", "object")], 0),
        ([{"arm": "tiago/left", "kind": "weld"}, weld("object", "world", name="tiago/left")], 1),
    ],
)
def test_joints_have_names_of_their_own(joints, count):
    if not count:
        assert len(scene_with({"tiago": tiago()}, *joints).joints) == 2
        return
    with refused(SceneError, "$.joints") as caught:
        scene_with({"tiago": tiago()}, *joints)
    assert len(caught.value.faults) == count


# --- the rest of a scene --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robots", "place"),
    [
        ({}, "$.arms"),
        ({"world": tiago()}, "$.robots.world"),
        ({"floor": tiago()}, "$.robots.floor"),
        ({"a/b": tiago()}, "$.robots['a/b']"),
        (
            {"slide": {"robot": "planar_2r", "lock": {"joint_1": 0, "joint_2": 0}}},
            "$.robots.slide.lock",
        ),
        ({"tiago": tiago(tips={"a/b": "arm_left_7_link"})}, "$.robots.tiago.tips['a/b']"),
        ({"tiago": tiago(tips={"left": "arm_left_8_link"})}, "$.robots.tiago.tips.left"),
        ({"tiago": tiago(tips={"base_link": "arm_left_7_link"})}, "$.robots.tiago.tips.base_link"),
        ({"tiago": tiago(tips={"foot": "base_link"})}, "$.robots.tiago.tips.foot"),
        ({"tiago": tiago(lock={"torso": 0})}, "$.robots.tiago.lock.torso"),
        ({"tiago": tiago(posture={"base_x": 0})}, "$.robots.tiago.posture.base_x"),
        ({"tiago": tiago(robot="tiago_por")}, "$.robots.tiago.robot"),
        ({"legs": {"robot": "romeo", "tips": {"l": "l_sole"}, "tip": "x"}}, "$.robots.legs.tip"),
    ],
)
def test_robots_with_a_fault_are_refused_at_its_place(robots, place):
    with refused(SceneError, place) as caught:
        scene_with(robots)
    assert len(caught.value.faults) == 1


@pytest.mark.parametrize("joint", [{"arm": "r"}, {"between": ["r", "object"]}])
def test_a_robot_without_tips_is_joined_by_its_links(joint):
    with refused(SceneError, "$.joints[0]") as caught:
        scene_with({"r": {"robot": "ur5"}}, joint | {"kind": "ball"})
    assert len(caught.value.faults) == 1
    assert scene_with({"r": {"robot": "ur5"}}, weld("r/tool0", "object")).joints


def test_arms_and_robots_have_different_names():
    with refused(SceneError, "$.robots.left"):
        held = {"arm": "left", "kind": "weld"}
        scene_with({"left": tiago()}, held, arms={"left": {"robot": "ur5"}})


EFFECTS = {
    "joint_damping": {"tiago": {"base_x": 3.0, "torso_lift_joint": 4.0}, "helper": 2.0},
    "torque_limits": {"tiago": [10.0] * 18},
    "joint_limits": {"range": {"tiago": {"base_y": [-1, 1]}}},
    "contact_friction": {"mu": 0.3, "contacts": ["tiago/left", "grip/weld 1", "helper"]},
    "external_wrenches": [{"on": "tiago/head_1_link", "force": [0, 0, 1]}],
}
WRONG = {
    "joint_damping": ({"tiago": {"base_z": 1}}, ".tiago.base_z"),
    "torque_limits": ({"tiago": [1.0]}, ".tiago"),
    "joint_limits": ({"range": {"tiga": {}}}, ".range.tiga"),
    "contact_friction": ({"mu": 0.3, "contacts": ["tiago/lft"]}, ".contacts[0]"),
    "external_wrenches": ([{"on": "tiago/head", "force": [0, 0, 1]}], "[0].on"),
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_and_control_address_the_joints_of_robots(effect):
    robots, arms = {"tiago": tiago(base=PLANE)}, {"helper": {"robot": "ur5"}}
    joints = [
        {"arm": "helper", "kind": "weld"},
        {"arm": "tiago/left", "kind": "weld"},
        weld("tiago/head_1_link", "object", name="grip"),
    ]
    robots["tiago"]["lock"] = {"head_1_joint": 0.0}
    scene_with(robots, *joints, arms=arms, effects={effect: EFFECTS[effect]})
    value, place = WRONG[effect]
    with refused(SceneError, f"$.effects.{effect}{place}") as caught:
        scene_with(robots, *joints, arms=arms, effects={effect: value})
    assert len(caught.value.faults) == 1


@pytest.mark.parametrize(
    ("control", "place"),
    [
        ({"kind": "constant", "torques": {"tiago": {"base_x": 20}}}, ""),
        ({"kind": "constant", "torques": {"tiago": {"base_z": 20}}}, ".torques.tiago.base_z"),
        ({"kind": "recorded", "file": "a.csv", "columns": {"tiago/base_x": "x"}}, ""),
        (
            {"kind": "recorded", "file": "a.csv", "columns": {"tiago/base_z": "x"}},
            ".columns['tiago/base_z']",
        ),
        ({"kind": "computed_torque", "stiffness": 4, "internal_forces": {"tiago/left": [1]}}, ""),
        (
            {"kind": "computed_torque", "stiffness": 4, "internal_forces": {"tiago": [1]}},
            ".internal_forces.tiago",
        ),
    ],
)
def test_controls_address_the_joints_of_robots(control, place):
    parts = {"tiago": tiago(base=PLANE)}, {"arm": "tiago/left", "kind": "weld"}
    if not place:
        scene_with(*parts, control=control)
        return
    with refused(SceneError, f"$.control{place}"):
        scene_with(*parts, control=control)


def test_robots_are_changed_by_path_and_looked_at_again_only_then(monkeypatch):
    looked = []

    def examine(spec, links):
        looked.append(links)
        return examine_robot(spec, links)

    monkeypatch.setattr(consistency, "examine_robot", examine)
    scene = scene_with({"tiago": tiago(base=PLANE)}, {"arm": "tiago/left", "kind": "weld"})
    assert looked == [()]
    assert scene.replace({"object.mass": 3.0}).robots == scene.robots and looked == [()]
    moved = scene.replace({"robots.tiago.base.xyz": [0, 0, 0.1], "robots.tiago.posture": "solve"})
    assert moved.robots["tiago"].base.xyz == (0, 0, 0.1) and len(looked) == 2
    moved.replace(joints=[weld("tiago/head_2_link", "world")])
    assert looked[2:] == [("head_2_link",)]
    with refused(SceneError, "$.robots.tiago.tips.left"):
        scene.replace({"robots.tiago.tips.left": "nothing"})


def test_relative_files_of_robots_start_at_the_folder_of_the_scene(hand):
    text = "object: {shape: {sphere: 0.1}, mass: 1}\njoints: []\n"
    text += "robots: {hand: {urdf: hand.urdf, tips: {a: a1}}}\n"
    path = hand.with_name("scene.yaml")
    path.write_text(text)
    assert load_scene(path).robots["hand"].urdf == hand
