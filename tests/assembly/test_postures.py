"""Claims about postures that the program finds, by Pinocchio's kinematics and SciPy's rotations."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yaml
from commands import multiarm
from event_scenes import arm as plain_arm
from event_scenes import box
from refusals import refused
from repository import SCENES
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.assembly.arm_postures import PostureSearch
from multiarm.assembly.bases import StandSearch
from multiarm.assembly.inverse_kinematics import BASE_JOINTS, InverseKinematics
from multiarm.assembly.postures import overlapping_links
from multiarm.assembly.reaching import REACHED, write_step
from multiarm.assembly.robots import load_robots, robot_files, with_bases
from multiarm.assembly.start_warnings import start_warnings
from multiarm.errors import SceneError
from multiarm.robots.robot import Robot
from multiarm.scene import ArmSpec, ObjectSpec, Pose, Scene, parse_scene, resolve_arm

UR5 = {"robot": "ur5", "tip": "tool0"}
PANDA = {"robot": "panda", "tip": "panda_hand"}
FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
DOWN = {"xyz": [0.0, 0.0, 0.1], "rpy": [np.pi, 0.0, 0.0]}


def robot(**spec) -> Robot:
    own = ArmSpec.model_validate(spec)
    return Robot("arm", robot_files(own, resolve_arm(own)))


ROBOTS = [
    pytest.param(UR5, id="ur5"),
    pytest.param({**PANDA, "lock": FINGERS}, id="panda"),
    pytest.param(plain_arm("xZyYX"), id="slides and hinges"),
]


@pytest.mark.parametrize("spec", ROBOTS)
def test_pose_and_jacobian_are_pinocchios(spec, rng):
    arm, frame = robot(**spec), pin.SE3.Random().homogeneous
    search = InverseKinematics(arm, frame=frame)
    for _ in range(5):
        q = rng.uniform(search.lower, search.upper)
        pose, J = search.pose(q)
        terms = arm.terms(q, np.zeros(arm.dof))
        np.testing.assert_allclose(pose, arm.tip_pose(q) @ frame, atol=1e-14)
        lever = pose[:3, 3] - terms.tip_position
        np.testing.assert_allclose(J[3:], terms.J[3:], atol=1e-14)
        np.testing.assert_allclose(
            J[:3], terms.J[:3] - np.cross(lever, terms.J[3:].T).T, atol=1e-13
        )


@pytest.mark.parametrize("spec", ROBOTS)
@pytest.mark.parametrize("free", [(), (5,), (0, 4)])
def test_postures_bring_the_tip_to_places_that_exist(spec, free, rng):
    arm = robot(**spec)
    search, found = InverseKinematics(arm, free), 0
    for _ in range(10):
        place = arm.tip_pose(rng.uniform(search.lower, search.upper))
        reach = search.search([place], rng, 40)
        if reach is None:
            continue
        found += 1
        (q,) = reach.postures
        assert np.all((search.lower <= q) & (q <= search.upper))
        here = arm.tip_pose(q)
        shift = place[:3, :3].T @ (here[:3, 3] - place[:3, 3])
        turn = Rotation.from_matrix(place[:3, :3].T @ here[:3, :3]).as_rotvec()
        error = np.delete(np.concatenate([shift, turn]), free)
        assert np.max(np.abs(error)) < REACHED
    assert found >= 8


def scene(arms: dict, joints: list[dict], **more):
    body = box((0.4, 0.3, 0.2), height=0.4)
    return parse_scene({"object": body, "arms": arms, "joints": joints, **more})


@pytest.mark.parametrize("kind", ["weld", "ball", "revolute", "planar", "point_on_plane"])
@pytest.mark.parametrize("posture", [{"posture": "solve"}, {}], ids=["asked for", "by default"])
def test_a_scene_needs_no_posture(kind, posture):
    base = {"xyz": [0.5, 0.2, 0.0]}
    built = scene({"a": {**UR5, "base": base, **posture}}, [{"arm": "a", "kind": kind, "at": DOWN}])
    system = ma.compile_system(built)
    q = system.initial_state().joint_positions["a"]
    shift = built.joints[0].start_shift()
    there = built.object.pose.matrix() @ built.joints[0].at.matrix()
    np.testing.assert_allclose(system.arms["a"].tip_pose(q) @ shift, there, atol=1e-7)
    limits = system.arms["a"].position_limits
    assert np.all((limits[:, 0] + 0.04 < q) & (q < limits[:, 1] - 0.04))
    assert np.min(system.arms["a"].skeleton(q)[2:-1, 2]) > 0.05  # above its base
    again = ma.compile_system(built, like=system).initial_state()
    assert np.array_equal(again.position, system.initial_state().position)


def test_a_motion_that_the_joint_leaves_free_may_be_used():
    """Three slides and a hinge about x cannot turn about the axis z of the joint."""
    turned = {"xyz": [0, 0, 0.1], "rpy": [0.0, 0.0, 0.7]}
    arms, joint = {"a": {**plain_arm("xyzX"), "posture": "solve"}}, {"arm": "a", "at": turned}
    system = ma.compile_system(scene(arms, [{**joint, "kind": "revolute"}]))
    np.testing.assert_allclose(
        system.initial_state().joint_positions["a"], [0, 0, 0.6, 0], atol=1e-8
    )
    with refused(SceneError, "arms.a.posture"):
        ma.compile_system(scene(arms, [{**joint, "kind": "weld"}]))


def test_an_arm_that_is_too_far_away_hears_where_to_go():
    joints = [{"arm": "a", "kind": "ball", "at": DOWN}]
    with refused(SceneError, "$.arms.a.posture") as caught:
        ma.compile_system(scene({"a": {**UR5, "base": {"xyz": [1.6, 0, 0]}}}, joints))
    (text,) = caught.value.faults
    shift = np.array(text.split("move the base by [")[1].split("]")[0].split(", "), dtype=float)
    nearer = {"xyz": list(np.array([1.6, 0, 0]) + shift)}
    ma.compile_system(scene({"a": {**UR5, "base": nearer}}, joints))


@pytest.mark.parametrize("name", ["talos_arm", "ur5_limited", "panda", "kinova", "so101"])
def test_a_posture_near_the_limits_is_found(name, rng):
    """Places that only postures reach of which joints are almost at their limits."""
    arm = robot(robot=name)
    lower, upper = whole_ranges(arm)
    for _ in range(8):
        q = rng.uniform(lower, upper)
        pressed = rng.integers(0, arm.dof, 2)
        q[pressed] = np.where(rng.random(2) < 0.5, lower[pressed] + 0.003, upper[pressed] - 0.003)
        there = arm.tip_pose(q)
        posture = posture_search(arm, there).best()
        low, high = arm.position_limits.T
        assert np.all((low <= posture) & (posture <= high))
        np.testing.assert_allclose(arm.tip_pose(posture), there, atol=1e-7)


def test_sliding_joints_are_sought_as_far_as_they_go_and_however_short_they_are(tmp_path):
    """Travels of 9 m and of 2 cm; a turn either way, or a margin, would leave nothing of them."""
    arm = gantry(tmp_path, ("1 0 0", 9.0), ("0 1 0", 0.02))
    q = np.array([8.7, 0.017])
    np.testing.assert_allclose(posture_search(arm, arm.tip_pose(q)).best(), q, atol=1e-7)


def test_frames_that_cannot_coincide_are_sought_up_to_the_limits_where_no_other_posture_is_allowed(
    tmp_path,
):
    """Two slides along x, below their place; the joint slides along z."""
    arm = gantry(tmp_path, ("1 0 0", 1.0), ("1 0 0", 1.0))
    there = arm.tip_pose(np.array([0.9, 0.9]))
    there[2, 3] += 0.1
    posture = posture_search(arm, there, free=(2,)).best(lambda q: q[0] > 0.97)
    assert posture is not None and posture[0] > 0.97
    assert posture.sum() == pytest.approx(1.8, abs=1e-7)


def gantry(folder, *slides: tuple[str, float]) -> Robot:
    """Slides on each other, each with its axis and its travel [m]."""
    joints = "".join(
        f"<joint name='j{k}' type='prismatic'><parent link='l{k}'/><child link='l{k + 1}'/>"
        f"<axis xyz='{axis}'/><limit lower='0' upper='{travel}' effort='1' velocity='1'/></joint>"
        for k, (axis, travel) in enumerate(slides)
    )
    links = "".join(
        f"<link name='l{k}'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' "
        f"ixz='0' iyz='0'/></inertial></link>"
        for k in range(len(slides) + 1)
    )
    path = folder / "gantry.urdf"
    path.write_text(f"<robot name='gantry'>{links}{joints}</robot>")
    return robot(urdf=path, tip=f"l{len(slides)}")


def whole_ranges(arm: Robot) -> np.ndarray:
    endless = ~np.isfinite(arm.position_limits)
    return np.where(endless, [-np.pi, np.pi], arm.position_limits).T


def posture_search(
    arm: Robot, there: np.ndarray, body: ObjectSpec | None = None, free: tuple[int, ...] = ()
) -> PostureSearch:
    body = body or ObjectSpec(mass=1.0, shape={"sphere": 1e-3}, pose=pose_table(far_off(there)))
    return PostureSearch(arm, np.eye(4), there, free, body)


def far_off(there: np.ndarray) -> np.ndarray:
    """A pose from which an object is in nobody's way."""
    pose = np.eye(4)
    pose[:3, 3] = there[:3, 3] + [50.0, 0.0, 0.0]
    return pose


@pytest.mark.parametrize("name", ["ur5", "panda", "so101", "tiago"])
@pytest.mark.parametrize("free", [(), (3, 4, 5), (0, 3, 4, 5)])
def test_what_an_arm_reaches_is_never_called_out_of_reach(name, free, rng):
    arm = robot(robot=name)
    search = InverseKinematics(arm, free, to_limits=True)
    for q in rng.uniform(*whole_ranges(arm), (200, arm.dof)):
        assert search.farther_than_it_reaches(arm.tip_pose(q)) is None


def test_a_place_beyond_the_stretched_arm_is_called_out_of_reach():
    """Closed form: three bars of 0.5 m in a plane."""
    arm = robot(robot="planar_3r")
    stretched = float(np.sum(arm.levers(np.zeros(3))[:1]))
    search = InverseKinematics(arm, to_limits=True)
    place = arm.tip_pose(np.zeros(3))
    first = arm.skeleton(np.zeros(3))[0]
    way = (place[:3, 3] - first) / np.linalg.norm(place[:3, 3] - first)
    for part, beyond in ((0.999, False), (1.001, True)):
        place[:3, 3] = first + part * stretched * way
        distance_and_reach = search.farther_than_it_reaches(place)
        assert (distance_and_reach is not None) == beyond
        if beyond:
            np.testing.assert_allclose(distance_and_reach, [part * stretched, stretched])


def test_where_nothing_is_found_the_message_says_how_hard_it_was_tried():
    """Within the length of the arm, but turned as it cannot be."""
    turned = {"xyz": [0, 0, 0.1], "rpy": [0.0, 0.0, 0.7]}
    arms = {"a": {**plain_arm("xyzX"), "posture": "solve"}}
    with refused(SceneError, "arms.a.posture") as caught:
        ma.compile_system(scene(arms, [{"arm": "a", "kind": "weld", "at": turned}]))
    assert "move the base by" not in str(caught.value)  # no shift of the base turns the arm


def test_a_step_that_is_not_finite_is_not_the_shortest():
    one, error = np.ones(1), np.array([np.nan])
    longest = write_step(error, np.ones((1, 1)), -one, one, 0 * one, 1.0, np.ones((1, 1)), one, one)
    assert np.isnan(longest)


def test_every_arm_that_cannot_be_placed_is_named():
    arms = {name: {**UR5, "base": {"xyz": [x, 0, 0]}} for name, x in (("a", 3.0), ("b", -3.0))}
    arms["c"] = {**UR5, "posture": "solve"}
    joints = [{"arm": name, "kind": "weld", "at": DOWN} for name in "ab"]
    with pytest.raises(SceneError) as caught:
        ma.compile_system(scene(arms, [*joints, {"arm": "c", "kind": "weld"}]))
    assert [fault.partition(".posture")[0] for fault in caught.value.faults] == [
        "$.arms.a", "$.arms.b", "$.arms.c",
    ]  # fmt: skip
    assert "give $.joints[2].at" in caught.value.faults[2]


def test_a_written_posture_stays():
    near = [0.0, 0.0, 0.6, 0.0]
    arms = {"a": {**plain_arm("xyzX"), "posture": near}}
    system = ma.compile_system(
        scene(arms, [{"arm": "a", "kind": "ball", "at": {"xyz": [0, 0, 0.1]}}])
    )
    assert np.array_equal(system.initial_state().joint_positions["a"], near)


# --- links in the way -----------------------------------------------------------------------------


def ring_scene(tmp_path, **arms) -> Scene:
    """Two UR5 arms hold a ring, a mesh, at opposite sides."""
    path = tmp_path / "ring.stl"
    trimesh.creation.annulus(0.25, 0.4, 0.08).export(path)
    sides = {"left": (-0.4, [0, np.pi / 2, 0]), "right": (0.4, [0, -np.pi / 2, 0])}
    return parse_scene(
        {
            "object": {
                "shape": {"mesh": {"file": str(path)}},
                "mass": 4.0,
                "inertia": [0.2, 0.2, 0.4],
                "pose": {"xyz": [0, 0, 0.5]},
            },
            "arms": {name: {**UR5, **arms[name]} for name in sides},
            "joints": [
                {"arm": name, "kind": "weld", "at": {"xyz": [x, 0, 0], "rpy": rpy}}
                for name, (x, rpy) in sides.items()
            ],
        }
    )


def overlap(system: ma.System) -> float:
    """The deepest overlap of links with the object's hull, or with another arm's links [m].

    By Pinocchio's collision pairs; the last link of each arm holds the object.
    """
    ring = trimesh.load_mesh(system.scene.object.shape.mesh.file)
    hull = trimesh.convex.convex_hull(ring)
    state, models, loader = system.initial_state(), {}, coal.MeshLoader()
    for name, arm in system.arms.items():
        geometry = arm.collision_model()
        data = geometry.createData()
        q = arm.configuration(state.joint_positions[name])
        pin.updateGeometryPlacements(arm.model, arm.model.createData(), geometry, data, q)
        models[name] = [
            (
                loader.load(item.meshPath, item.meshScale).vertices() @ pose.rotation.T
                + pose.translation,
                item.parentJoint,
            )
            for item, pose in zip(geometry.geometryObjects, data.oMg.tolist(), strict=True)
            if isinstance(item.geometry, coal.BVHModelBase)
        ]
    pose = system.scene.object.pose.matrix()
    depth = 0.0
    for name, links in models.items():
        for points, joint in links:
            if joint < system.arms[name].tip.joint:
                inside = hull.contains((points - pose[:3, 3]) @ pose[:3, :3])
                depth = max(depth, float(inside.any()))
        for other in models.keys() - {name}:
            for points, _ in models[other]:
                solid = trimesh.convex.convex_hull(points)
                depth = max(depth, *(float(solid.contains(p).any()) for p, _ in links))
    return depth


@pytest.mark.slow
def test_bases_and_postures_keep_off_a_mesh_and_off_each_other(tmp_path):
    open_base = {"base": {"solve": ["x", "y", "yaw"]}}
    system = ma.compile_system(ring_scene(tmp_path, left=open_base, right=open_base))
    assert overlap(system) == 0.0 and not start_warnings(system)


def test_postures_keep_off_a_mesh_where_the_best_ones_do_not(tmp_path):
    """Bases under the ring: the best posture without regard to it goes through."""
    under = {name: {"base": {"xyz": [x, 0.1, 0]}} for name, x in (("left", -0.2), ("right", 0.2))}
    built = ring_scene(tmp_path, **under)
    system = ma.compile_system(built)
    arms = system.arms
    careless = {j.arm: PostureSearch.of_joint(built, j, arms[j.arm]).best() for j in built.joints}
    assert overlapping_links(built, arms, careless)
    assert overlap(system) == 0.0 and not start_warnings(system)


def test_a_posture_that_is_in_no_ones_way_stays(tmp_path):
    beside = {name: {"base": {"xyz": [x, 0, 0]}} for name, x in (("left", -1.0), ("right", 1.0))}
    built = ring_scene(tmp_path, **beside)
    system = ma.compile_system(built)
    for joint in built.joints:
        careless = PostureSearch.of_joint(built, joint, system.arms[joint.arm]).best()
        assert np.array_equal(load_robots(built, system).postures[joint.arm], careless)


def test_links_that_cannot_keep_off_are_told(tmp_path):
    """Both arms on one spot: their shoulders are in each other."""
    spot = {"base": {"xyz": [0.0, -0.5, 0]}}
    turned = {"base": {"xyz": [0.0, -0.5, 0], "rpy": [0, 0, 0.1]}}
    system = ma.compile_system(ring_scene(tmp_path, left=spot, right=turned))
    (text, *_) = [text for text in start_warnings(system) if "overlaps" in text]
    assert text.startswith("$.arms.left.posture: link ") and "arm 'right' by" in text


# --- places to stand ------------------------------------------------------------------------------


@pytest.mark.parametrize("components", [(0, 1, 5), (2, 3, 4), (5,), (0, 1, 2, 3, 4, 5)])
def test_joints_below_an_arm_move_it_as_its_base_does(components, rng):
    numbers = rng.uniform(-1.0, 1.0, 6)
    arm = robot(**UR5, base={"xyz": [0.1, -0.2, 0.3], "rpy": [0.2, 0.5, -0.4]})
    base = Pose(xyz=numbers[:3].tolist(), rpy=numbers[3:].tolist())
    moving = InverseKinematics(arm).on_moving_base(base, dict.fromkeys(components, (-1.0, 1.0)))
    q = rng.uniform(-1.0, 1.0, 6)
    order = [k for k in BASE_JOINTS if k in components]
    pose, _ = moving.pose(np.concatenate([numbers[order], q]))
    there = robot(**UR5, base={"xyz": numbers[:3].tolist(), "rpy": numbers[3:].tolist()})
    np.testing.assert_allclose(pose, there.tip_pose(q), atol=1e-13)


@pytest.mark.parametrize("solve", [["yaw"], ["x", "y"]])
def test_a_base_is_found_from_which_only_few_postures_reach(solve, rng):
    """Of an arm with five joints: bases that are drawn never suffice."""
    place = {"x": 0.3, "y": 0.2, "z": 0.1, "roll": 0.0, "pitch": 0.0, "yaw": 0.7}
    xyz, rpy = np.split(np.array(list(place.values())), 2)
    arm = robot(robot="so101", base={"xyz": xyz, "rpy": rpy})
    there = arm.tip_pose(rng.uniform(*whole_ranges(arm)))
    xyz, rpy = np.split(np.array(list({**place, **dict.fromkeys(solve, 0.0)}.values())), 2)
    base, body = {"xyz": xyz, "rpy": rpy, "solve": solve}, far_off(there)
    at = pose_table(np.linalg.solve(body, there))
    built = parse_scene(
        {
            "object": {"mass": 1.0, "shape": {"sphere": 1e-3}, "pose": pose_table(body)},
            "arms": {"a": {"robot": "so101", "base": base}},
            "joints": [{"arm": "a", "kind": "weld", "at": at}],
        }
    )
    robots = load_robots(with_bases(built))
    np.testing.assert_allclose(robots.by_name["a"].tip_pose(robots.postures["a"]), there, atol=1e-7)


def test_a_stand_holds_its_mount_as_the_arm_that_stands_there_does(rng):
    """Whatever base the arm of the search has; what is asked of a clearance is in the world."""
    turned = {"xyz": [0.3, -0.2, 0.4], "rpy": [0.5, -0.3, 1.0]}
    pose, mount = (pin.SE3.Random().homogeneous for _ in range(2))
    hold, seen = pose @ mount, []

    def clear(base, points, there):
        assert np.array_equal(there, pose)
        seen.append((base, points))
        return 1.0

    places = []
    for shift in rng.uniform(-0.5, 0.5, (12, 3)):
        base = pin.SE3.Random().homogeneous
        base[:3, 3] = hold[:3, 3] + shift
        places.append((base, mount, 1.0))
    search = StandSearch(InverseKinematics(robot(**UR5, base=turned)), [pose], clear, rng)
    stand = search.best(places)
    (q,) = stand.reach.postures
    there = robot(**UR5, base=pose_table(stand.base))
    np.testing.assert_allclose(there.tip_pose(q), hold, atol=1e-7)
    base, points = seen[-1]
    assert min(np.linalg.norm(b - stand.base) for b, _ in seen) == 0.0
    np.testing.assert_allclose(points[0], (base @ [0, 0, 0.089159, 1])[:3], atol=1e-9)
    poorer = [(b, m, 1e-6 if np.array_equal(b, stand.base) else 1.0) for b, m, _ in places]
    assert not np.array_equal(search.best(poorer).base, stand.base)


def pose_table(X: np.ndarray) -> dict:
    return {"xyz": X[:3, 3], "quaternion_xyzw": Rotation.from_matrix(X[:3, :3]).as_quat()}


@pytest.mark.slow
def test_a_base_is_found_where_the_arm_holds_its_place_well():
    """Better than from almost all places that a quick look from elsewhere finds."""
    joints = [{"arm": "a", "kind": "weld", "at": DOWN}, {"arm": "b", "kind": "ball", "at": DOWN}]
    arms = {
        "a": {**UR5, "base": {"xyz": [0, 0, 0.1], "solve": ["x", "y", "yaw"]}},
        "b": {**UR5, "base": {"xyz": [0.6, 0.3, 0.0]}},
    }
    built = scene(arms, joints)
    system = ma.compile_system(built)
    base = system.scene.arms["a"].base
    assert base.xyz[2] == 0.1 and base.rpy[:2] == (0.0, 0.0) and base.solve == ()
    assert np.array_equal(np.round([*base.xyz, *base.rpy], 3), [*base.xyz, *base.rpy])
    q = system.initial_state().joint_positions["a"]
    there = built.object.pose.matrix() @ built.joints[0].at.matrix()
    np.testing.assert_allclose(system.arms["a"].tip_pose(q), there, atol=1e-7)
    assert np.linalg.norm(np.subtract(base.xyz[:2], [0.6, 0.3])) > 0.25  # beside the other arm
    again = ma.compile_system(built)
    assert again.scene.arms["a"].base == base
    assert np.array_equal(again.initial_state().position, system.initial_state().position)
    dexterity, others = _dexterity(system.arms["a"], q), []
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        for distance in (0.3, 0.5, 0.7):
            xyz = [distance * np.cos(angle), distance * np.sin(angle), 0.1]
            arm = robot(**UR5, base={"xyz": xyz})
            reach = InverseKinematics(arm).search([there], np.random.default_rng(1), 8)
            others.append(0.0 if reach is None else _dexterity(arm, reach.postures[0]))
    assert np.mean(dexterity > np.array(others)) > 0.6


def _dexterity(arm: Robot, q: np.ndarray) -> float:
    return np.linalg.svd(arm.terms(q, np.zeros(6)).J, compute_uv=False)[-1]


@pytest.mark.parametrize(
    ("base", "more"),
    [
        ({"solve": ["z"], "xyz": [9, 0, 0]}, {}),
        ({"solve": ["x", "x"]}, {}),
        ({"solve": ["u"]}, {}),
        ({"solve": ["yaw"], "quaternion_xyzw": [0, 0, 0, 1]}, {}),
        ({"solve": ["x"]}, {"posture": 6 * [0.1]}),
    ],
    ids=["out of reach", "twice", "unknown", "quaternion", "posture"],
)
def test_a_base_that_cannot_be_found_is_refused(base, more):
    with refused(SceneError, "arms.a.base"):
        ma.compile_system(
            scene({"a": {**UR5, "base": base, **more}}, [{"arm": "a", "kind": "weld", "at": DOWN}])
        )


def test_a_base_needs_a_place_to_be_found_for():
    with refused(SceneError, "$.joints[0].at"):
        ma.compile_system(
            scene({"a": {**UR5, "base": {"solve": ["x"]}}}, [{"arm": "a", "kind": "weld"}])
        )


# --- as the command prints them -------------------------------------------------------------------

RING = SCENES / "three_makes_ring.yaml"


def with_printed_arms(path):
    """The system of a scene in which the arms have what `multiarm pose` prints of them."""
    shown = multiarm("pose", path)
    assert shown.exit_code == 0
    arms = yaml.safe_load(shown.output)
    changes = {f"arms.{name}.{key}": v for name, arm in arms.items() for key, v in arm.items()}
    return arms, ma.compile_system(ma.load_scene(path).replace(changes))


def same_start(system, expected):
    for name, posture in expected.initial_state().joint_positions.items():
        np.testing.assert_allclose(system.scene.arms[name].posture, posture, atol=1e-8)


@pytest.mark.slow
def test_postures_are_printed_as_a_scene_has_them():
    arms, system = with_printed_arms(RING)
    assert [*arms.values()] == [{"posture": [*arm.posture]} for arm in system.scene.arms.values()]
    same_start(system, ma.compile_system(ma.load_scene(RING)))


@pytest.mark.slow
def test_bases_are_printed_whole(tmp_path):
    path, text = tmp_path / "ring.yaml", RING.read_text()
    text = text.replace("base: {xyz: [0.95, 0, 0]}", "base: {solve: [x, y, yaw]}").replace(
        "base: {xyz: [-0.5, 0.75, 0]}",
        "base: {solve: [x, y], xyz: [0, 0, 0.1], rpy: [0, 0, 0.3]}",
    )
    path.write_text(text)
    expected = ma.compile_system(ma.load_scene(path))
    arms, system = with_printed_arms(path)
    assert [*map(len, arms.values())].count(1) == 1, "one arm stands where it is written"
    for name, arm in expected.scene.arms.items():
        found = system.scene.arms[name].base.matrix()
        np.testing.assert_allclose(found, arm.base.matrix(), atol=1e-8)
    same_start(system, expected)


def test_a_scene_in_which_all_is_written_leaves_nothing_to_find(tmp_path):
    path = tmp_path / "ring.yaml"
    path.write_text(RING.read_text().replace("posture: solve", "posture: {}"))
    again = multiarm("pose", path)
    assert again.exit_code == 2 and "gives every arm a posture" in again.stderr
