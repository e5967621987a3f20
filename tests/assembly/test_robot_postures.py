"""Claims about postures of robots with several tips, by Pinocchio's kinematics and closed forms."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_structures import pinocchio_model, random_parents, random_structure
from refusals import refused
from scipy.spatial.transform import Rotation
from tree_scenes import gripper_loops

import multiarm as ma
from multiarm.assembly import postures as postures_module
from multiarm.assembly.arm_postures import STARTS
from multiarm.assembly.inverse_kinematics import TreeKinematics
from multiarm.assembly.kinematic_tree import Coupling, LinkFrame, Ranges, Target
from multiarm.assembly.reaching import REACHED
from multiarm.assembly.robot_postures import ALL_WRITTEN, RobotPostureSearch
from multiarm.assembly.robots import load_robots
from multiarm.errors import SceneError
from multiarm.robots.robot import Robot, RobotFiles
from multiarm.robots.terms import TreeStructure
from multiarm.scene import ObjectSpec, Scene, parse_scene
from multiarm.scene.robots import find_robot
from multiarm.spatial import quaternion_to_matrix

FAR_OFF = ObjectSpec(mass=1.0, shape={"sphere": 1e-3}, pose={"xyz": [0, 0, 50.0]})
X, Y, Z = np.eye(3)
YAW_LAST = (X, Y, Z)  # slides along x and y, then a hinge about z
# Errors are within REACHED, lengths over half a metre or half a robot; the largest has 3.5 m.
CLOSED = 4.0 * REACHED


@dataclass(frozen=True)
class Tree:
    """A tree with limits, and the frames that it may hold something with."""

    structure: TreeStructure
    limits: np.ndarray
    tips: tuple[LinkFrame, ...]
    base_joints: int = 0

    def poses(self, q: np.ndarray) -> list[np.ndarray]:
        """Of all joints in the world, by Pinocchio; those of the base at last, as joint -1."""
        model = pinocchio_model(self.structure, np.zeros(3))
        data = model.createData()
        pin.forwardKinematics(model, data, np.array(q))
        return [*(X.homogeneous.copy() for X in data.oMi.tolist()[1:]), np.eye(4)]

    def places(self, q: np.ndarray) -> list[np.ndarray]:
        """Of the tips in the world."""
        return [self.poses(q)[tip.joint] @ tip.pose for tip in self.tips]

    def search(self, targets: Sequence[Target], **more) -> RobotPostureSearch:
        return RobotPostureSearch(
            **{
                "structure": self.structure,
                "targets": {f"tip{k}": target for k, target in enumerate(targets)},
                "limits": self.limits,
                "written": np.zeros(len(self.limits)),
                "base": np.eye(4),
                "base_joints": self.base_joints,
                "bodies": [FAR_OFF],
                **more,
            }
        )

    def holds(self, places: Sequence[np.ndarray], free: tuple[int, ...] = ()) -> list[Target]:
        return [
            Target(tip, LinkFrame(-1, place), free)
            for tip, place in zip(self.tips, places, strict=True)
        ]

    def draw(self, rng: np.random.Generator) -> np.ndarray:
        """A posture anywhere within the limits; within a turn, or 3 m, where there are none."""
        endless = np.where(self.structure.slides, 3.0, np.pi)[:, None] * [-1.0, 1.0]
        return rng.uniform(*np.where(np.isfinite(self.limits), self.limits, endless).T)


def model(name: str, *tips: str) -> Tree:
    """A known model whose joints on the way to some links move."""
    urdf = find_robot(name).urdf
    whole = pin.buildModelFromUrdf(str(urdf))
    ways = [whole.supports[whole.frames[whole.getFrameId(tip)].parentJoint] for tip in tips]
    moved = {joint for way in ways for joint in way}
    locked = {whole.names[k]: 0.0 for k in range(1, whole.njoints) if k not in moved}
    arm = Robot("robot", RobotFiles(urdf, (), np.eye(4), {tip: tip for tip in tips}, locked))
    frames = [arm.model.frames[arm.model.getFrameId(tip)] for tip in tips]
    return Tree(
        arm.structure(),
        arm.position_limits,
        tuple(LinkFrame(f.parentJoint - 1, f.placement.homogeneous) for f in frames),
    )


def on_moving_base(robot: Tree) -> Tree:
    """The robot on joints x, y and yaw without limits."""
    tree = robot.structure
    base = TreeStructure(*(np.zeros((3, *part.shape[1:]), part.dtype) for part in tree))
    both = TreeStructure(*map(np.concatenate, zip(base, tree, strict=True)))
    both.parents[:] = np.concatenate([[-1, 0, 1], np.where(tree.parents < 0, 2, tree.parents + 3)])
    both.slides[:2] = True
    both.axes[:3], both.rotations[:3], both.masses[:3] = YAW_LAST, np.eye(3), 1.0
    limits = np.vstack([np.full((3, 2), [-np.inf, np.inf]), robot.limits])
    tips = tuple(replace(tip, joint=tip.joint + 3) for tip in robot.tips)
    return Tree(both, limits, tips, base_joints=3)


def random_robot(rng: np.random.Generator, joints: int = 14) -> Tree:
    """Two branches of a random tree with a frame at the end of each."""
    parents = np.concatenate([[-1, 0], [1, 2, 3, 4, 5, 6], [1, 8, 9, 10, 11, 12]])[:joints]
    structure = random_structure(rng, parents)
    middle, half = rng.uniform(-1.0, 1.0, joints), rng.uniform(0.5, 2.0, joints)
    tips = tuple(LinkFrame(joint, random_pose(rng, 0.2)) for joint in (7, joints - 1))
    return Tree(structure, np.column_stack([middle - half, middle + half]), tips)


def random_pose(rng: np.random.Generator, size: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = rng.uniform(-size, size, 3)
    return pose


def gap(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Shift and rotation vector from a pose to another, in the axes of the second (6,)."""
    between = np.linalg.solve(second, first)
    return np.concatenate([between[:3, 3], Rotation.from_matrix(between[:3, :3]).as_rotvec()])


def planar(lengths: Sequence[float], parents: Sequence[int]) -> TreeStructure:
    """Bars in a plane that turn about z; each begins at the end of its parent, along x."""
    n, along = len(parents), np.array([[lengths[p] if p >= 0 else 0.0, 0, 0] for p in parents])
    return TreeStructure(
        parents=np.array(parents, dtype=np.int64),
        slides=np.zeros(n, dtype=bool),
        floats=np.zeros(n, dtype=bool),
        axes=np.tile(Z, (n, 1)),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        translations=along,
        masses=np.ones(n),
        centres=np.zeros((n, 3)),
        inertias=np.tile(np.eye(3), (n, 1, 1)),
        armature=np.zeros(n),
    )


def end_of_bar(joint: int, length: float) -> LinkFrame:
    pose = np.eye(4)
    pose[0, 3] = length
    return LinkFrame(joint, pose)


# --- the kernel -----------------------------------------------------------------------------------


def test_poses_and_jacobians_of_trees_are_pinocchios(rng):
    """Of a frame at rest and of one seen from another link; some joints follow others."""
    for _ in range(4):
        parents = random_parents(rng, 9)
        robot = Tree(random_structure(rng, parents), np.zeros((9, 2)), ())
        couplings = [Coupling(2, 7, -0.7, 0.3), Coupling(7, 4, 2.0, -0.1), Coupling(1, 8, 1.0)]
        first, second = (LinkFrame(int(k), random_pose(rng, 0.3)) for k in rng.choice(9, 2, False))
        targets = [Target(first, LinkFrame(-1)), Target(first, second)]
        ranges = Ranges.of_joints(np.full((9, 2), [-9.0, 9.0]), robot.structure.slides, True)
        search = TreeKinematics(robot.structure, targets, ranges, couplings)

        def posture(x, couplings=couplings):
            q = np.insert(np.array(x), [1, 1, 5], 0.0)  # those of 1, 2 and 7
            for coupling in reversed(couplings[:2]):
                q[coupling.joint] = coupling.multiplier * q[coupling.leader] + coupling.offset
            q[1] = q[8]
            return q

        x, h = rng.uniform(-1.0, 1.0, 6), 1e-6
        for number, target in enumerate(targets):
            pose, J = search.pose(posture(x), number)
            poses = robot.poses(posture(x))
            np.testing.assert_allclose(pose, poses[first.joint] @ first.pose, atol=1e-13)
            place = poses[target.second.joint] @ target.second.pose
            for k in range(6):
                ends = []
                for sign in (1.0, -1.0):
                    moved = robot.poses(posture(x + sign * h * np.eye(6)[k]))
                    there = moved[target.second.joint] @ target.second.pose
                    ends.append(gap(moved[first.joint] @ first.pose, there))
                column = place[:3, :3].T @ J[:, k].reshape(2, 3).T
                change = (ends[0] - ends[1]) / (2 * h)
                np.testing.assert_allclose(change[:3], column[:, 0], atol=1e-8)
            # rotation vectors of one turn from the pose here
            turned = [robot.poses(posture(x + s * h * np.eye(6)[0])) for s in (1.0, -1.0)]
            R = [
                (m[target.second.joint] @ target.second.pose)[:3, :3].T
                @ (m[first.joint] @ first.pose)[:3, :3]
                for m in turned
            ]
            spin = Rotation.from_matrix(R[0] @ R[1].T).as_rotvec() / (2 * h)
            np.testing.assert_allclose(spin, place[:3, :3].T @ J[3:, 0], atol=1e-8)


# --- what is found --------------------------------------------------------------------------------

ROBOTS = [
    pytest.param("baxter", ("left_gripper", "right_gripper"), False, id="baxter"),
    pytest.param("talos", ("gripper_left_base_link", "gripper_right_base_link"), False, id="talos"),
    pytest.param("tiago", ("hand_tool_link",), True, id="tiago on wheels"),
    pytest.param("tiago_dual", ("hand_left_tool_link", "hand_right_tool_link"), True, id="dual"),
]


@pytest.mark.parametrize(("name", "tips", "wheels"), ROBOTS)
def test_real_robots_hold_all_places_that_they_can(name, tips, wheels, rng):
    robot = on_moving_base(model(name, *tips)) if wheels else model(name, *tips)
    for _ in range(5):
        places = robot.places(robot.draw(rng))
        search = robot.search(robot.holds(places))
        q = search.best()
        for here, there in zip(robot.places(q), places, strict=True):
            assert np.max(np.abs(gap(here, there))) < CLOSED
        assert np.all((robot.limits[:, 0] <= q) & (q <= robot.limits[:, 1]))
        assert np.array_equal(search.best(), q)


@pytest.mark.parametrize("free", [(), (5,), (3, 4, 5), (0, 4)])
def test_random_trees_hold_both_places(free, rng):
    """Of fourteen joints with narrow ranges; what is free need not agree."""
    for _ in range(6):
        robot = random_robot(rng)
        places = robot.places(robot.draw(rng))
        q = robot.search(robot.holds(places, free)).best()
        assert q is not None
        for here, there in zip(robot.places(q), places, strict=True):
            assert np.max(np.abs(np.delete(gap(here, there), free))) < CLOSED
        assert np.all((robot.limits[:, 0] <= q) & (q <= robot.limits[:, 1]))


def test_a_hand_holds_a_ball_with_all_fingers(rng):
    tips = [f"link_{k}.0_tip" for k in (3, 7, 11, 15)]
    hand = model("allegro_right_hand", *tips)
    places = hand.places(hand.draw(rng))
    q = hand.search(hand.holds(places, (3, 4, 5))).best()
    for here, there in zip(hand.places(q), places, strict=True):
        np.testing.assert_allclose(here[:3, 3], there[:3, 3], atol=CLOSED)


def test_two_hands_meet_and_one_of_them_holds_on_to_the_world(rng):
    """An inner loop beside a place at rest."""
    robot = model("baxter", "left_gripper", "right_gripper")
    q = robot.draw(rng)
    poses, (left, right) = robot.poses(q), robot.tips
    grip = np.linalg.solve(poses[right.joint], poses[left.joint] @ left.pose)
    targets = [*robot.holds(robot.places(q))[:1], Target(left, LinkFrame(right.joint, grip))]
    poses = robot.poses(robot.search(targets).best())
    for target in targets:
        first, second = (poses[part.joint] @ part.pose for part in (target.first, target.second))
        assert np.max(np.abs(gap(first, second))) < CLOSED


def test_a_four_bar_linkage_closes_within_the_ranges_of_its_joints():
    """Closed form: of a crank, a coupler and a rocker; the law of cosines tells the diagonal."""
    crank, coupler, rocker, ground = 0.2, 0.5, 0.4, 0.45
    tree = planar([crank, coupler, rocker], [-1, 0, -1])
    tree.translations[2] = [ground, 0, 0]
    loop = Target(end_of_bar(1, coupler), end_of_bar(2, rocker), free=(5,))
    limits = np.array([[0.5, 1.2], [-np.pi, np.pi], [0.1, np.pi]])
    q = Tree(tree, limits, ()).search([loop]).best()
    assert np.all((limits[:, 0] <= q) & (q <= limits[:, 1]))
    diagonal = np.sqrt(crank**2 + ground**2 - 2 * crank * ground * np.cos(q[0]))
    # angle between ground and rocker at the rocker's pivot, by both triangles on the diagonal
    to_crank = np.arcsin(crank * np.sin(q[0]) / diagonal)
    to_coupler = np.arccos((diagonal**2 + rocker**2 - coupler**2) / (2 * diagonal * rocker))
    angles = [np.pi - to_crank - to_coupler, np.pi - to_crank + to_coupler]
    assert min(abs(np.mod(q[2] - angle + 1.0, 2 * np.pi) - 1.0) for angle in angles) < 1e-6


def test_joints_that_follow_others_do_and_keep_their_own_limits():
    """Closed form: three equal bars, of which each turns as far as the one before, make an arc."""
    tree = planar([0.3, 0.3, 0.3], [-1, 0, 1])
    couplings = (Coupling(2, 1, 1.0), Coupling(1, 0, 1.0, 0.2))
    limits = np.array([[-2.0, 2.0], [-2.0, 2.0], [-0.3, 1.0]])
    angle, tip = 0.5, end_of_bar(2, 0.3)
    turns = np.cumsum([angle, angle + 0.2, angle + 0.2])
    place = np.eye(4)
    place[:3, :3] = Rotation.from_rotvec(turns[-1] * Z).as_matrix()
    place[:2, 3] = 0.3 * np.sum([np.cos(turns), np.sin(turns)], axis=1)
    robot = Tree(tree, limits, (tip,))
    q = robot.search(robot.holds([place]), couplings=couplings).best()
    np.testing.assert_allclose(q, [angle, angle + 0.2, angle + 0.2], atol=CLOSED)
    for joint, most in ((0, 0.4), (1, 0.6), (2, 0.6)):  # less than the bar has to turn
        narrow = limits.copy()
        narrow[joint, 1] = most
        search = replace(robot, limits=narrow).search(robot.holds([place]), couplings=couplings)
        assert search.best() is None


def test_joints_that_move_no_connection_stay_as_they_are_written(rng):
    robot = model("baxter", "left_gripper", "right_gripper")
    written = robot.draw(rng)
    (left, _), held = robot.tips, replace(robot, tips=robot.tips[:1])
    q = held.search(held.holds(held.places(robot.draw(rng))), written=written).best()
    moves, k = np.zeros(14, dtype=bool), left.joint
    while k >= 0:
        moves[k], k = True, robot.structure.parents[k]
    assert moves.sum() == 7
    assert np.array_equal(q[~moves], written[~moves]) and not np.any(q[moves] == written[moves])


def test_a_base_without_limits_goes_as_far_as_it_must(rng):
    robot = on_moving_base(model("tiago_dual", "hand_left_tool_link", "hand_right_tool_link"))
    posture = robot.draw(rng)
    posture[:3] = [40.0, -25.0, 2.0]
    places = robot.places(posture)
    q = robot.search(robot.holds(places)).best()
    assert np.linalg.norm(q[:2] - posture[:2]) < 4.0
    for here, there in zip(robot.places(q), places, strict=True):
        assert np.max(np.abs(gap(here, there))) < CLOSED


# --- the best of many -----------------------------------------------------------------------------


def test_the_posture_is_among_the_best_of_many(rng):
    """Dexterity and room as Pinocchio's Jacobians have them, against postures from anywhere."""
    robot = model("baxter", "left_gripper", "right_gripper")
    places = robot.places(0.5 * robot.draw(rng))
    search = robot.search(robot.holds(places))
    tree = pinocchio_model(robot.structure, np.zeros(3))
    half = 0.5 * np.diff(robot.limits, axis=1)[:, 0] - 0.05

    def quality(q):
        rows = []
        for tip in robot.tips:
            data = tree.createData()
            pin.computeJointJacobians(tree, data, q)
            J = pin.getJointJacobian(tree, data, tip.joint + 1, pin.ReferenceFrame.LOCAL)
            J = pin.SE3(tip.pose).toActionMatrixInverse() @ J
            rows.append(np.vstack([J[:3] / 0.5, J[3:]]))
        room = np.min((np.min(np.abs(robot.limits - q[:, None]), axis=1) - 0.05) / half)
        return np.linalg.svd(np.vstack(rows), compute_uv=False)[-1] * min(1.0, 2.0 * room)

    kinematics, _ = search._searches()[0]
    same = np.random.default_rng(0)
    drawn = [quality(course[0]) for course in kinematics.courses([ALL_WRITTEN], same, STARTS)]
    assert len(drawn) > 20
    assert quality(search.best()) == pytest.approx(max(drawn))


def test_a_mechanism_in_a_plane_prefers_postures_far_from_singular_ones():
    """Two bars that hold a point: the elbow is bent by a right angle where the trunk can turn."""
    tree = planar([1.0, 1.0, 1.0, 1.0], [-1, 0, 1, 2])
    place = np.eye(4)
    place[:2, 3] = 0.9, 1.3
    robot = Tree(tree, np.full((4, 2), [-3.0, 3.0]), (end_of_bar(3, 1.0),))
    search = robot.search(robot.holds([place], (3, 4, 5)))
    kinematics, _ = search._searches()[-1]
    assert kinematics.rank == 2
    q = search.best()
    model = pinocchio_model(tree, np.zeros(3))
    J = pin.computeFrameJacobian(
        model, model.createData(), q, model.addFrame(
            pin.Frame("tip", 4, 0, pin.SE3(robot.tips[0].pose), pin.FrameType.OP_FRAME)
        ), pin.ReferenceFrame.LOCAL,
    )  # fmt: skip
    assert np.linalg.svd(J[:2], compute_uv=False)[-1] > 0.5


def test_links_keep_off_the_object(rng):
    """Two arms on one trunk reach around a plate between them; it has to stand beside it."""
    robot = on_moving_base(model("tiago_dual", "hand_left_tool_link", "hand_right_tool_link"))
    size, middle, places = np.array([0.8, 0.4, 0.2]), np.array([0, 0, 0.9]), []
    for side in (1.0, -1.0):
        place = np.eye(4)
        place[:3, :3] = Rotation.from_euler("z", -0.5 * np.pi * side).as_matrix()
        place[:3, 3] = middle + [0.0, 0.22 * side, 0.0]
        places.append(place)
    body = ObjectSpec(mass=1.0, shape={"box": size.tolist()}, pose={"xyz": middle.tolist()})
    q = robot.search(robot.holds(places), bodies=[body]).best()
    origins, parents = np.array([X[:3, 3] for X in robot.poses(q)]), robot.structure.parents[4:]
    for part in np.linspace(0.0, 1.0, 9):
        points = (1.0 - part) * origins[parents] + part * origins[4:-1]
        assert np.all(np.any(np.abs(points - middle) > 0.5 * size, axis=1))


# --- where there is none --------------------------------------------------------------------------


def test_what_a_robot_reaches_is_never_called_out_of_reach(rng):
    for name, tips, wheels in (mark.values for mark in ROBOTS):
        robot = on_moving_base(model(name, *tips)) if wheels else model(name, *tips)
        for free in ((), (0, 4)):
            for _ in range(40):
                targets = robot.holds(robot.places(robot.draw(rng)), free)
                assert robot.search(targets).out_of_reach() is None


@pytest.mark.parametrize("part", [0.999, 1.001])
def test_places_that_two_stretched_arms_just_reach_or_not(part):
    """Closed form: bars of 0.4 m and 0.3 m from both ends of a beam of 0.5 m on a trunk."""
    tree = planar([0.0, 0.4, 0.3, 0.4, 0.3], [-1, 0, 1, 0, 3])
    tree.translations[[1, 3]] = [0.25, 0, 0], [-0.25, 0, 0]
    limits = np.full((5, 2), [-np.inf, np.inf])
    robot = Tree(tree, limits, (end_of_bar(2, 0.3), end_of_bar(4, 0.3)))
    places = []
    for side in (1.0, -1.0):
        place = np.eye(4)
        place[0, 3] = side * part * (0.25 + 0.7)
        places.append(place)
    search = robot.search(robot.holds(places, (5,)))
    assert (search.out_of_reach() is None) == (part < 1.0)
    assert (search.best() is None) == (part > 1.0)
    apart = on_moving_base(robot)
    text = apart.search(apart.holds(places, (5,))).out_of_reach()
    assert (text is None) == (part < 1.0)
    assert text is None or (f"{1.9 * part:.3f} m apart" in text and "1.900 m" in text)


def test_where_nothing_is_found_the_message_tells_the_gaps_and_what_to_do():
    """A bar that cannot turn out of its plane: its end is 0.1 m below its place at the best."""
    robot = Tree(planar([0.5, 0.5], [-1, 0]), np.full((2, 2), [-2.0, 2.0]), (end_of_bar(1, 0.5),))
    place = np.eye(4)
    place[:3, 3] = [0.6, 0.2, 0.1]
    search = robot.search(robot.holds([place], (3, 4, 5)))
    assert search.best() is None and search.out_of_reach() is None
    text = search.why_none()
    assert "leaves 0.100 m at 'tip0'" in text and "move the base by [0.000, 0.000, 0.100]" in text
    moved = np.eye(4)
    moved[2, 3] = 0.1
    robot.structure.translations[0] += moved[:3, 3]
    assert robot.search(robot.holds([place], (3, 4, 5)), base=moved).best() is not None


# --- in scenes ------------------------------------------------------------------------------------

BAXTER = {"robot": "baxter", "tips": {"left": "left_gripper", "right": "right_gripper"}}
BAR = {"mass": 2.0, "shape": {"box": [0.1, 0.5, 0.1]}, "pose": {"xyz": [0.65, 0.0, 0.2]}}


def sides(**left) -> list[dict]:
    """Welds to both ends of the bar, grippers pointing inwards, their axes z."""
    ends = {"left": (0.25, [np.pi / 2, 0, 0]), "right": (-0.25, [-np.pi / 2, 0, 0])}
    joints = [
        {"arm": f"b/{tip}", "kind": "weld", "at": {"xyz": [0, y, 0], "rpy": rpy}}
        for tip, (y, rpy) in ends.items()
    ]
    return [{**joints[0], **left}, joints[1]]


def robot_scene(joints: list[dict], body: dict = BAR, **robot) -> Scene:
    return parse_scene({"object": body, "robots": {"b": {**BAXTER, **robot}}, "joints": joints})


def posture_in(scene: Scene) -> tuple[Robot, np.ndarray]:
    robots = load_robots(scene)
    return robots.by_name["b"], robots.postures["b"]


@pytest.mark.parametrize("posture", [{"posture": "solve"}, {}], ids=["asked for", "by default"])
def test_a_robot_holds_an_object_with_both_tips(posture):
    base = {"xyz": [0.0, 0.1, -0.1], "rpy": [0.0, 0.0, 0.2]}
    arm, q = posture_in(robot_scene(sides(), base=base, **posture))
    for tip, y, angle in (("left", 0.25, np.pi / 2), ("right", -0.25, -np.pi / 2)):
        there = pin.SE3(pin.rpy.rpyToMatrix(angle, 0.0, 0.0), np.array([0.65, y, 0.2]))
        np.testing.assert_allclose(arm.tip_pose(q, tip), there.homogeneous, atol=1e-7)


def test_connections_with_the_world_and_between_links_are_closed_too():
    """The left tip holds on to the world; the right one turns about an axis of the left hand."""
    joints = [
        {"between": ["b/left", "world"], "kind": "ball", "at": {"xyz": [0.7, 0.3, 0.1]},
         "at_first": {"xyz": [0, 0, 0.05]}},
        {"between": ["b/right", "b/left"], "kind": "revolute", "at": {"xyz": [0, 0, 0.2]},
         "axis": [1, 0, 0]},
        {"arm": "b/right", "kind": "weld"},
    ]  # fmt: skip
    arm, q = posture_in(robot_scene(joints, posture="solve"))
    left, right = (arm.tip_pose(q, tip) for tip in ("left", "right"))
    np.testing.assert_allclose(left @ [0, 0, 0.05, 1], [0.7, 0.3, 0.1, 1], atol=1e-7)
    between = np.linalg.solve(left, right)
    np.testing.assert_allclose(between[:3, 3], [0, 0, 0.2], atol=1e-7)
    np.testing.assert_allclose(between[:3, 0], X, atol=1e-7)


def test_a_gripper_of_linkages_closes_on_what_it_holds():
    """Closed form: its loops are closed, and its drivers agree, where all joints turn equally.

    The right pad slides on its plane: its place is beside where it can be.
    """
    name, position = "four_bar_gripper", 0.3
    whole = pin.buildModelFromUrdf(str(find_robot(name).urdf))
    data = whole.createData()
    pin.framesForwardKinematics(whole, data, np.full(6, position))
    places = {side: data.oMf[whole.getFrameId(f"{side}_pad")] for side in ("left", "right")}
    beside = pin.SE3(np.eye(3), np.array([0.004, -0.006, 0.0]))
    places["right"] = places["right"] * beside
    joints = [
        {
            "arm": f"b/{side}",
            "kind": kind,
            "at": {
                "xyz": places[side].translation.tolist(),
                "quaternion_xyzw": pin.Quaternion(places[side].rotation).coeffs().tolist(),
            },
        }
        for side, kind in (("left", "weld"), ("right", "planar"))
    ]
    body = {"mass": 0.1, "shape": {"sphere": 0.001}}
    tips = {"left": "left_pad", "right": "right_pad"}
    scene = robot_scene([*joints, *gripper_loops("b")], body, robot=name, tips=tips)
    _, q = posture_in(scene)
    np.testing.assert_allclose(q, np.full(6, position), atol=1e-6)


def two_arms_in_a_plane(folder) -> Path:
    """Bars of 0.5, 0.5 and 0.1 m on either side of a base; ranges prefer elbows turned inwards."""
    text = "<link name='base'/>"
    for side, sign in (("l", 1), ("r", -1)):
        ranges = ([-1.8, 1.8], sorted([-2.2 * sign, 2.9 * sign]), [-3.0, 3.0])
        for k, length in enumerate((0.5, 0.5, 0.1)):
            lower, upper = ranges[k]
            text += (
                f"<link name='{side}{k}'><inertial><mass value='1'/><inertia ixx='1' iyy='1' "
                f"izz='1' ixy='0' ixz='0' iyz='0'/></inertial><collision><origin "
                f"xyz='{length / 2} 0 0'/><geometry><box size='{length} 0.04 0.04'/></geometry>"
                f"</collision></link><joint name='{side}_{k}' type='revolute'>"
                f"<parent link='{f'{side}{k - 1}' if k else 'base'}'/><child link='{side}{k}'/>"
                f"<origin xyz='{0.5 if k else 0} {0 if k else 0.25 * sign} 0'/><axis xyz='0 0 1'/>"
                f"<limit lower='{lower}' upper='{upper}' effort='1' velocity='1'/></joint>"
            )
    path = folder / "arms.urdf"
    path.write_text(f"<robot name='arms'>{text}</robot>")
    return path


def test_links_on_two_branches_keep_off_each_other(tmp_path):
    """Closed form: with both elbows inwards, as ranges prefer, the forearms cross."""
    tip = {"kind": "weld", "at_first": {"xyz": [0.1, 0, 0]}}
    joints = [
        {**tip, "arm": "b/left", "at": {"xyz": [0, 0.2, 0]}},
        {**tip, "arm": "b/right", "at": {"xyz": [0, -0.2, 0]}},
    ]
    body = {"mass": 1.0, "shape": {"sphere": 0.01}, "pose": {"xyz": [0.7, 0.0, 0.0]}}
    urdf = two_arms_in_a_plane(tmp_path)
    robot = {"urdf": urdf, "tips": {"left": "l2", "right": "r2"}, "posture": "solve"}
    scene = parse_scene({"object": body, "robots": {"b": robot}, "joints": joints})
    arm, q = posture_in(scene)
    elbows = {name: arm.skeleton(q)[k, 1] for k, name in enumerate(arm.joint_names)}
    inwards = elbows["l_1"] < 0.0, elbows["r_1"] > 0.0
    assert inwards != (True, True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postures_module, "OVERLAP", 1.0)
        arm, q = posture_in(scene)
    elbows = {name: arm.skeleton(q)[k, 1] for k, name in enumerate(arm.joint_names)}
    assert elbows["l_1"] < 0.0 < elbows["r_1"]


def test_a_robot_that_cannot_hold_its_places_hears_why():
    far = sides(at={"xyz": [0.0, 4.0, 0.0]})
    with refused(SceneError, "$.robots.b.posture") as caught:
        posture_in(robot_scene(far))
    (text,) = caught.value.faults
    assert "'b/left'" in text and "$.joints[0].at, $.joints[1].at" in text
    assert "move the base by" not in text  # no shift brings places together that are apart
    with refused(SceneError, "$.robots.b.posture") as caught:
        posture_in(robot_scene([{"arm": "b/left", "kind": "weld"}], posture="solve"))
    assert "$.joints[0].at" in caught.value.faults[0]


def two_arms_hand_in_hand(quarter: float, half: float) -> Scene:
    """They hold a box, and each other; angles of a right angle and of two as they are written."""
    arms = {
        "left": {"robot": "ur5", "base": {"xyz": [-0.9, 0, 0]}, "posture": "solve"},
        "right": {"robot": "ur5", "base": {"xyz": [0.9, 0, 0], "rpy": [0, 0, half]}},
    }
    middle = {"xyz": [0, 0, 0.3]}
    joints = [
        {"arm": "left", "kind": "weld", "at": {"xyz": [-0.3, 0, 0], "rpy": [0, quarter, 0]}},
        {"arm": "right", "kind": "ball", "at": {"xyz": [0.3, 0, 0], "rpy": [0, -quarter, 0]}},
        {"between": ["left", "right"], "kind": "weld", "at_first": middle,
         "at": {**middle, "rpy": [half, 0, 0]}},
    ]  # fmt: skip
    body = {"mass": 5.0, "shape": {"box": [0.6, 0.4, 0.3]}, "pose": {"xyz": [0, 0, 0.5]}}
    return parse_scene({"object": body, "arms": arms, "joints": joints})


def test_angles_that_are_rounded_are_told_from_places_out_of_reach():
    """Held twice, a robot has no posture where angles with five digits contradict each other."""
    with refused(SceneError, "$.arms.right.posture") as caught:
        ma.compile_system(two_arms_hand_in_hand(1.5708, 3.14159))
    gaps = [float(gap) for gap in re.findall(r"([0-9.e-]+) m at", caught.value.faults[0])]
    assert gaps and all(REACHED < gap < 1e-5 for gap in gaps)
    system = ma.compile_system(two_arms_hand_in_hand(0.5 * np.pi, np.pi))
    assert max(system.start_report.gaps.values()) < CLOSED


def test_robots_in_a_ring_hear_which_posture_to_write():
    cart = {"robot": "dual_arm_cart", "tips": {"left": "left_tool", "right": "right_tool"}}
    robots = {
        name: {**cart, "base": {"xyz": [x, y, 0]}, "posture": "solve"}
        for name, x, y in (("a", 0.6, 0.0), ("b", -0.3, 0.5), ("c", -0.3, -0.5))
    }
    pairs = [("a", "b"), ("b", "c"), ("c", "a")]
    joints = [{"between": [f"{one}/left", f"{two}/right"], "kind": "ball"} for one, two in pairs]
    joints.append({"between": ["object", "world"], "kind": "weld"})
    body = {"mass": 5.0, "shape": {"sphere": 0.1}}
    with refused(SceneError, *(f"$.robots.{name}.posture" for name in robots)) as caught:
        ma.compile_system(parse_scene({"object": body, "robots": robots, "joints": joints}))
    assert "'b/right': give $.joints[0].at" in str(caught.value)


@pytest.mark.parametrize("there", [[-1.6, 0.0, 0.0], [0.2, 0.0, -1.5]])
def test_a_robot_that_is_told_to_move_reaches_its_places_from_there(there):
    with refused(SceneError, "$.robots.b.posture") as caught:
        posture_in(robot_scene(sides(), base={"xyz": there}))
    shift = caught.value.faults[0].split("move the base by [")[1].split("]")[0].split(", ")
    nearer = {"xyz": (np.array(there) + np.array(shift, dtype=float)).tolist()}
    system = ma.compile_system(robot_scene(sides(), base=nearer))
    assert max(system.start_report.gaps.values()) < CLOSED


def test_a_posture_that_is_written_stays():
    arm, q = posture_in(robot_scene(sides(), posture={"left_s0": 0.1}))
    assert np.array_equal(q, 0.1 * (np.array(arm.joint_names) == "left_s0"))


def test_a_robot_on_wheels_drives_to_an_object_and_stands_closed():
    """Compiled as a scene: nothing is left to assemble, wherever its base is written."""
    tips = {"left": "hand_left_tool_link", "right": "hand_right_tool_link"}
    wheels = {"xyz": [-3.0, 1.0, 0.0], "rpy": [0, 0, 0.7], "moves": ["x", "y", "yaw"]}
    scene = robot_scene(sides(), robot="tiago_dual", tips=tips, base=wheels)
    system = ma.compile_system(scene)
    report = system.start_report
    assert max(report.gaps.values()) < CLOSED and report.joint_change < 10.0 * CLOSED
    again = ma.compile_system(scene).initial_state()
    assert np.array_equal(again.position, system.initial_state().position)


# --- bases that are found -------------------------------------------------------------------------

TWO_BALLS = [
    {"arm": "tiago/left", "kind": "ball", "at": {"xyz": [0.0, 0.2, 0.0]}},
    {"arm": "tiago/right", "kind": "ball", "at": {"xyz": [0.0, -0.2, 0.0]}},
]


@pytest.mark.parametrize("moves", [(), "free"])
def test_a_base_is_found_in_the_directions_that_vary(moves):
    """Along and about the axes of the pose that is written; the start is closed by Pinocchio."""
    written = {"xyz": [0.4, -0.3, 0.1], "rpy": [0.0, 0.0, 2.0]}
    base = written | {"solve": ["yaw", "x", "y"], **({"moves": moves} if moves else {})}
    tips = {"left": "arm_left_7_link", "right": "arm_right_7_link"}
    box = {"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 5.0, "pose": {"xyz": [3.0, 2.0, 1.1]}}
    scene = parse_scene(
        {
            "object": box,
            "robots": {"tiago": {"robot": "tiago_pro", "base": base, "tips": tips}},
            "joints": TWO_BALLS,
        }
    )
    system = ma.compile_system(scene)
    state, found = system.initial_state(), system.scene.robots["tiago"].base
    assert found.solve == () and found.moves == moves
    assert found.xyz[2] == written["xyz"][2]
    assert np.allclose(found.rotation()[2], [0.0, 0.0, 1.0], rtol=0.0, atol=1e-15)
    distance = np.linalg.norm(np.subtract(found.xyz[:2], box["pose"]["xyz"][:2]))
    assert 0.3 < distance < 1.2  # it stands before the box
    for tip, y in (("left", 0.2), ("right", -0.2)):
        place = state.object_position + quaternion_to_matrix(state.object_quaternion_xyzw)[:, 1] * y
        robot, base_of = system.arms["tiago"], state.bases.get("tiago")
        held = robot.tip_pose(state.joint_positions["tiago"], tip, base_of)[:3, 3]
        assert np.allclose(held, place, rtol=0.0, atol=1e-9)


FOUND = {"robot": "ur5", "tips": {"hand": "tool0"}, "base": {"solve": ["x", "y"]}}


@pytest.mark.parametrize(
    "joints",
    [
        [],
        [{"arm": "r/hand", "kind": "ball"}],
        [{"arm": "r/hand", "kind": "ball", "at": {"xyz": [0.0, 0.0, 30.0]}}],
    ],
)
def test_bases_that_are_not_found_are_refused_where_they_are_sought(joints):
    box = {"shape": {"box": [0.4, 0.3, 0.2]}, "mass": 5.0}
    scene = parse_scene({"object": box, "robots": {"r": FOUND}, "joints": joints})
    with refused(SceneError, "$.robots.r.base.solve") as caught:
        ma.compile_system(scene)
    assert len(caught.value.faults) == 1


# --- what another system has too ------------------------------------------------------------------

HANDED = [0.3, -1.2, 1.4, 0.3, 0.4, 0.2]


def test_a_joint_without_at_is_where_its_robot_is_found_beside_another_system():
    """The posture of a robot that is found depends on others, however equal its own is written."""
    arms = {
        "a": {"robot": "ur5", "base": {"xyz": [-0.6, 0, 0]}, "posture": HANDED},
        "b": {"robot": "ur5", "base": {"xyz": [0.6, 0, 0]}, "posture": "solve"},
    }
    box = {"shape": {"box": [0.3, 0.2, 0.1]}, "mass": 2.0, "pose": {"xyz": [0, 0.3, 0.6]}}
    shake = {"between": ["b", "a"], "kind": "weld", "name": "shake", "at": {"xyz": [0, 0.1, 0.1]}}
    joints = [{"between": ["b", "object"], "kind": "ball"}, shake]  # found by its second joint
    scene = parse_scene({"object": box, "arms": arms, "joints": joints})
    other = scene.replace({"arms.a.posture": [*HANDED[:5], 0.6]})
    alone = ma.compile_system(other)
    beside = ma.compile_system(other, like=ma.compile_system(scene))
    assert max(beside.start_report.gaps.values()) < CLOSED
    expected, found = (system.model.joints["b-object"].frame for system in (alone, beside))
    assert np.array_equal(found.on_object, expected.on_object)
    again = ma.compile_system(other, like=alone)
    assert again.model.joints["b-object"] is alone.model.joints["b-object"]
