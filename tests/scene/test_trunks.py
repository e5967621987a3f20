"""Claims about two arms on one trunk: one robot, by Pinocchio's model of the whole of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import yaml
from commands import multiarm
from mechanics import scene_of
from refusals import refused
from repository import SCENES
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.robots import robot as robot_module
from multiarm.scene import find_robot, load_scene, parse_scene, read_urdf
from multiarm.viewer.animate import animate, lowest
from multiarm.viewer.robot_bodies import WHITE

EXAMPLE = SCENES / "two_arms_one_trunk.yaml"
TORSO = {"torso_lift_joint": 0.15}
JOINTS = [{"arm": name, "kind": "weld"} for name in ("left", "right")]


def tiago(side: str, **more) -> dict:
    return {"robot": "tiago_pro", "tip": f"arm_{side}_tool_link", "lock": TORSO, **more}


def pair(left: dict, right: dict):
    return scene_of({"left": left, "right": right}, JOINTS)


@pytest.fixture(scope="module")
def moving():
    """The example, whose box is pushed and turned at the start; no torques."""
    scene = load_scene(EXAMPLE)
    body = scene.object.model_copy(update={"twist": (0.1, -0.2, 0.1, 0.3, 0.1, -0.2)})
    return ma.compile_system(scene.replace(object=body, control={"kind": "none"}))


class Whole:
    """Pinocchio's model of the robot, in which only the joints of the arms move."""

    def __init__(self, system):
        self.system = system
        full = pin.buildModelFromUrdf(str(find_robot("tiago_pro").urdf))
        self.names = [n for arm in system.arms.values() for n in arm.joint_names]
        locked = system.arms["left"].files.locked
        at, held = pin.neutral(full), [n for n in full.names[1:] if n not in self.names]
        for name in held:
            joint = full.joints[full.getJointId(name)]
            q = locked[name]
            at[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(q), np.sin(q)][: joint.nq]
            if joint.nq == 1:
                at[joint.idx_q] = q
        self.model = pin.buildReducedModel(full, [full.getJointId(n) for n in held], at)
        self.model.gravity.linear = np.array(system.scene.gravity)
        self.order = [self.model.joints[self.model.getJointId(n)].idx_v for n in self.names]
        self.data = self.model.createData()

    def vector(self, parts) -> np.ndarray:
        """Values by arm, in Pinocchio's order."""
        whole = np.empty(self.model.nv)
        whole[self.order] = np.concatenate([parts[name] for name in self.system.arm_names])
        return whole


def test_accelerations_and_forces_are_those_of_the_whole_robot(moving):
    whole, state, body = Whole(moving), moving.initial_state(), moving.scene.object
    model, data, axes = whole.model, whole.data, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    q, v = whole.vector(state.joint_positions), whole.vector(state.joint_velocities)
    assert np.linalg.norm(v) > 0.3
    n, size = model.nv, model.nv + 18
    A, b = np.zeros((size, size)), np.zeros(size)
    upper = np.triu(pin.crba(model, data, q))
    A[:n, :n], b[:n] = upper + np.triu(upper, 1).T, -pin.nonLinearEffects(model, data, q, v)
    pose = body.pose.matrix()
    inertia = pose[:3, :3] @ body.inertia_matrix() @ pose[:3, :3].T
    omega = state.object_twist[3:]
    A[n : n + 3, n : n + 3], A[n + 3 : n + 6, n + 3 : n + 6] = body.mass * np.eye(3), inertia
    b[n : n + 6] = *(body.mass * model.gravity.linear), *(-np.cross(omega, inertia @ omega))
    pin.forwardKinematics(model, data, q, v, np.zeros(n))
    for k, arm in enumerate(moving.arms.values()):
        tip = model.getFrameId(arm.files.tips[""])
        J = pin.computeFrameJacobian(model, data, q, tip, axes)
        place = data.oMf[tip].translation.copy()
        drift = pin.getFrameClassicalAcceleration(model, data, tip, axes).vector
        r, rows = place - state.object_position, slice(n + 6 + 6 * k, n + 12 + 6 * k)
        G = np.eye(6)  # velocity of the tip as a part of the box
        G[:3, 3:] = -np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
        A[rows, :n], A[rows, n : n + 6] = J, -G
        A[:n, rows], A[n : n + 6, rows] = J.T, -G.T
        b[rows] = [*np.cross(omega, np.cross(omega, r)), 0, 0, 0] - drift
    found, ev = np.linalg.solve(A, b), ma.evaluate(moving)
    scale = np.max(np.abs(found[: n + 6]))
    ours = whole.vector(ev.joint_accelerations)
    np.testing.assert_allclose(ours, found[:n], atol=1e-10 * scale, rtol=0)
    np.testing.assert_allclose(ev.object_acceleration, found[n : n + 6], atol=1e-10 * scale, rtol=0)
    for k, arm in enumerate(moving.arms):
        wrench = found[n + 6 + 6 * k : n + 12 + 6 * k]
        pushes = ev.contact_forces[arm][:, None] * ev.contact_normals[arm]
        tip = moving.arms[arm].tip_pose(state.joint_positions[arm])[:3, 3]
        moment = np.cross(ev.contact_points[arm] - tip, pushes).sum(axis=0)
        total = np.concatenate([pushes.sum(axis=0), moment])
        np.testing.assert_allclose(total, wrench, atol=1e-10 * np.max(np.abs(wrench)), rtol=0)


def test_tip_jacobians_are_columns_of_that_of_the_whole_robot(moving):
    whole, state = Whole(moving), moving.initial_state()
    model, data, axes = whole.model, whole.data, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    q = whole.vector(state.joint_positions)
    for arm, tip in moving.kinematics().tips.items():
        frame = model.getFrameId(moving.arms[arm].files.tips[""])
        J = pin.computeFrameJacobian(model, data, q, frame, axes)
        columns = [model.joints[model.getJointId(name)].idx_v for name in tip.joint_names]
        np.testing.assert_allclose(tip.jacobian, J[:, columns], atol=1e-12)
        np.testing.assert_allclose(np.delete(J, columns, axis=1), 0.0, atol=1e-15)
        np.testing.assert_allclose(tip.position, data.oMf[frame].translation, atol=1e-12)
        assert not set(tip.joint_names) & set(TORSO)


def test_energy_counts_each_arm_once_and_the_trunk_never(moving):
    run = ma.simulate(moving, duration=0.02, accuracy=1e-6, certificate=False)
    whole, body = Whole(moving), moving.scene.object
    for k in (0, -1):
        q, v = (
            whole.vector({name: values[k] for name, values in parts.items()})
            for parts in (run.joint_positions, run.joint_velocities)
        )
        kinetic = pin.computeKineticEnergy(whole.model, whole.data, q, v)
        linear, angular = np.split(run.object_twist[k], 2)
        turned = Rotation.from_quat(run.object_quaternion_xyzw[k]).inv().apply(angular.copy())
        kinetic += 0.5 * body.mass * linear @ linear
        kinetic += 0.5 * turned @ body.inertia_matrix() @ turned
        assert run.kinetic_energy[k] == pytest.approx(kinetic, rel=1e-12)
        potential = pin.computePotentialEnergy(whole.model, whole.data, q)
        potential -= body.mass * whole.model.gravity.linear @ run.object_position[k]
        assert run.potential_energy[k] == pytest.approx(potential, rel=1e-12)


def test_a_file_is_read_once(monkeypatch):
    reads, read = [], pin.buildModelFromUrdf
    monkeypatch.setattr(
        robot_module.pin, "buildModelFromUrdf", lambda f: reads.append(f) or read(f)
    )
    robot_module._read.cache_clear()
    ma.compile_system(load_scene(EXAMPLE))
    assert len(reads) == 1


@pytest.mark.slow
def test_a_replay_shows_every_link_once_and_the_trunk_in_its_own_colours(moving):
    run = ma.simulate(moving, duration=0.02, accuracy=1e-6, certificate=False)
    animation = animate(run, fps=100, speed=1, meshes=True)
    bodies = [b for b in animation.bodies if "/" in b.name]
    trunk = [b for b in bodies if b.name.startswith("arms/left+right/")]
    assert trunk and animation.floor == min(0.0, *map(lowest, trunk))
    shown = [b.name.rpartition("/")[2] for b in bodies if b.name.startswith("arms/")]
    visuals = moving.arms["left"].visual_model().geometryObjects
    assert sorted(shown) == sorted(item.name for item in visuals)
    outline = read_urdf(find_robot("tiago_pro").urdf)
    for part in bodies:
        owner, link = part.name.split("/")[1], part.name.rpartition("/")[2].rpartition("_")[0]
        carriers = [
            name for name, arm in moving.arms.items() if link in outline.carried_by(arm.joint_names)
        ]
        assert owner == (carriers[0] if carriers else "left+right")
        assert np.array_equal(part.color, WHITE) == (not carriers)
        assert (np.ptp(part.quaternion_xyzw, axis=0).max() == 0.0) == (not carriers)


# --- which arms are one robot ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ({}, {"lock": {}}),
        ({}, {"lock": {"torso_lift_joint": 0.2}}),
        ({"lock": {**TORSO, "head_1_joint": 0.1}}, {"lock": {**TORSO, "head_1_joint": 0.2}}),
    ],
    ids=["one arm holds it", "held at two positions", "head at two positions"],
)
def test_arms_of_one_robot_have_to_agree_on_the_rest(left, right):
    with refused(SceneError, "$.arms") as caught:
        pair(tiago("left", **left), tiago("right", **right))
    assert len(caught.value.faults) == 1


def test_other_bases_and_equal_chains_are_groups_of_their_own():
    apart = pair(tiago("left"), tiago("right", lock={}, base={"xyz": [0, 2, 0]}))
    equal = pair(*({"robot": "planar_3r", "tip": "tip", "posture": [0.3, q, 0.2]} for q in (1, 2)))
    assert [g.arms for s in (apart, equal) for g in s.arm_groups] == 2 * [("left",), ("right",)]
    same = {"xyz": [0, 0, 0.1], "rpy": [0, 0, 0.5]}
    turned = {"xyz": [0, 0, 0.1], "quaternion_xyzw": [0, 0, np.sin(0.25), np.cos(0.25)]}
    one = pair(tiago("left", base=same), tiago("right", base=turned))
    assert [g.arms for g in one.arm_groups] == [("left", "right")]


def test_what_one_arm_says_of_the_rest_holds_for_the_robot():
    head, finger = {"head_1_joint": 0.3}, {"gripper_left_finger_joint": 0.4}
    scene = pair(tiago("left"), tiago("right", lock={**TORSO, **head, **finger}))
    system = ma.compile_system(scene)
    for arm in system.arms.values():
        assert arm.files.locked["head_1_joint"] == 0.3
        assert arm.files.locked["gripper_left_inner_finger_left_joint"] == 0.4  # copies the finger
    (warning,) = scene.warnings
    # of its four wheels and of seven others: head_2_joint, and six of the right gripper
    assert "wheel_front_right_joint: 0" in warning and "joint: 0 and 7 more};" in warning
    for name in ("head_1_joint", "arm_right_1_joint", "arm_left_1_joint", "gripper_left"):
        assert name not in warning
    turned = scene.replace(
        arms=dict(scene.arms) | {"right": tiago("right", lock={**TORSO, "head_1_joint": -0.2})}
    )
    again = ma.compile_system(turned, like=system)
    assert again.arms["left"].files.locked["head_1_joint"] == -0.2


def test_a_lock_of_a_joint_that_the_other_arm_moves_is_told_to_be_idle():
    scene = pair(tiago("left", lock={**TORSO, "arm_right_2_joint": 0.5}), tiago("right"))
    assert any(
        text == "$.arms.left: 'lock' has no effect on 'arm_right_2_joint', which arm 'right' moves"
        for text in scene.warnings
    )


# --- a trunk that moves ---------------------------------------------------------------------------

LIFT, LEFT, RIGHT = "torso_lift_joint", "arm_left_2_joint", "arm_right_2_joint"
GROUP, DOWN = "left_and_right", [0, 0, -1]


def loose(side: str, **more) -> dict:
    return tiago(side, **{"lock": {}, **more})


def one_robot(joints: list[dict], **more):
    tips = {side: f"arm_{side}_tool_link" for side in ("left", "right")}
    robots = {GROUP: {"robot": "tiago_pro", "tips": tips, **more}}
    return scene_of({}, joints, robots=robots)


WELDS = [{"arm": f"{GROUP}/{side}", "kind": "weld"} for side in ("left", "right")]


def test_arms_whose_trunk_moves_are_one_robot_with_their_names_as_tips():
    """A box that moves, damping in all joints: as the robot that the arms are, to the last bit."""
    base = {"xyz": [0.1, 0.0, 0.05], "rpy": [0.0, 0.0, 0.2]}
    head, twist = {"head_1_joint": 0.3}, [0.1, 0.0, -0.1, 0.2, 0.1, 0.0]
    arms = pair(
        loose("left", base=base, posture=[0.1, 0.2, *6 * [0.3]], lock=head, velocity={LEFT: 0.1}),
        loose("right", base=base, posture={LIFT: 0.1, RIGHT: -0.4}),
    )
    left = {LIFT: 0.1, **{f"arm_left_{k}_joint": 0.3 for k in range(1, 8)}, "arm_left_1_joint": 0.2}
    robot = one_robot(
        WELDS, base=base, lock=head, posture={**left, RIGHT: -0.4}, velocity={LEFT: 0.1}
    )
    scenes = [
        scene.replace({"object.pose": {"xyz": [0.6, 0, 0.9]}, "object.twist": twist})
        .replace(effects={"joint_damping": 2.0})
        for scene in (arms, robot)
    ]  # fmt: skip
    systems = [ma.compile_system(scene) for scene in scenes]
    starts = [system.initial_state() for system in systems]
    assert np.array_equal(starts[0].position, starts[1].position)
    assert np.array_equal(starts[0].velocity, starts[1].velocity) and starts[0].velocity.any()
    ours, theirs = map(ma.evaluate, systems)
    assert np.array_equal(ours.object_acceleration, theirs.object_acceleration)
    assert np.array_equal(ours.joint_accelerations[GROUP], theirs.joint_accelerations[GROUP])
    for side in ("left", "right"):
        forces = ours.contact_forces[side], theirs.contact_forces[f"{GROUP}/{side}"]
        assert np.array_equal(*forces) and forces[0].any()
    assert list(systems[0].kinematics().tips) == [f"{GROUP}/left", f"{GROUP}/right"]
    for warnings in (arms.warnings, systems[0].warnings):
        assert any(f"robot {GROUP!r}" in text and LIFT in text for text in warnings)
    again = ma.compile_system(arms, like=ma.compile_system(arms))
    assert again.arms[GROUP].joint_names[0] == LIFT


def test_joints_keep_their_names_where_arms_are_one_robot():
    joints = [*JOINTS, {"between": ["left", "world"], "kind": "ball", "at": {}}]
    scene = scene_of({side: loose(side) for side in ("left", "right")}, joints)
    connections = ma.compile_system(scene, assemble=False).model.connections
    assert list(connections) == ["left", "right", "left-world"]
    assert [str(pair.first) for pair in connections.values()] == [
        f"{GROUP}/{side}" for side in ("left", "right", "left")
    ]


def test_arms_that_are_one_robot_hold_the_objects_that_they_name():
    bodies = {
        name: {"shape": {"box": [0.3, 0.4, 0.1]}, "mass": 1.0, "pose": {"xyz": [0.6, 0.0, z]}}
        for name, z in (("tray", 0.8), ("lid", 0.9))
    }
    joints = [
        {"arm": "left", "object": "tray", "kind": "weld"},
        {"arm": "right", "object": "lid", "kind": "ball"},
    ]
    arms = {side: loose(side) for side in ("left", "right")}
    system = ma.compile_system(parse_scene({"objects": bodies, "arms": arms, "joints": joints}))
    connections = system.model.connections
    assert {name: str(pair.second) for name, pair in connections.items()} == {
        "left": "tray", "right": "lid"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("left", "right", "more", "place"),
    [
        ({"posture": {LIFT: 0.1}}, {"posture": {LIFT: 0.2}}, {}, "$.arms.right.posture"),
        ({"posture": "solve"}, {"posture": {LIFT: 0.2}}, {}, "$.arms.right.posture"),
        ({"velocity": {LIFT: 0.1}}, {"velocity": {LIFT: 0.0}}, {}, "$.arms.right.velocity"),
        (
            {},
            {},
            {"control": {"kind": "joint_pd", "stiffness": {"left": 9.0}, "damping": 1.0}},
            "$.control.stiffness.left",
        ),
        (
            {},
            {},
            {"effects": {"external_wrenches": [{"on": "right/arm_right_4_link", "force": DOWN}]}},
            "$.effects.external_wrenches[0].on",
        ),
    ],
    ids=["positions", "sought", "velocities", "gains of one arm", "a wrench on its link"],
)
def test_what_arms_of_one_robot_cannot_say_alone_is_refused(left, right, more, place):
    with refused(SceneError, place) as caught:
        scene_of({"left": loose("left", **left), "right": loose("right", **right)}, JOINTS, **more)
    assert len(caught.value.faults) == 1


def test_arms_with_tools_are_no_robot():
    tool = {"robot": "corner_gripper", "mount": "arm_left_tool_link"}
    with refused(SceneError, "$.arms.right"):
        pair(loose("left", tip="corner", tool=tool), loose("right"))


def test_a_fault_of_an_arm_on_a_trunk_is_told_alone():
    with refused(SceneError, "$.arms.left.posture.elbow") as caught:
        pair(loose("left", posture={"elbow": 0.1}), loose("right"))
    assert len(caught.value.faults) == 1


def test_pose_prints_the_postures_of_arms_that_are_one_robot(tmp_path):
    parts = yaml.safe_load(EXAMPLE.read_text())
    for arm in parts["arms"].values():
        arm["lock"] = {joint: q for joint, q in arm["lock"].items() if joint != LIFT}
    path = tmp_path / "scene.yaml"
    path.write_text(yaml.safe_dump({**parts, "control": "none", "run": {"duration": 1.0}}))
    result = multiarm("pose", path)
    assert result.exit_code == 0, result.output
    lines = [yaml.safe_load(line) for line in result.stdout.splitlines() if "posture:" in line]
    found = {name: posture for line in lines for name, posture in line.items()}
    arms = {name: {**arm, **found[name]} for name, arm in parts["arms"].items()}
    path.write_text(yaml.safe_dump({**parts, "arms": arms, "control": "none", "run": {}}))
    report = ma.compile_system(load_scene(path)).start_report
    assert list(found) == ["left", "right"] and max(report.gaps.values()) < 1e-6
