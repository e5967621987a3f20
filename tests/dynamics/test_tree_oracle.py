"""Claims about the reference for robots that are trees, which judges the solvers of the package.

Two ways of solving agree, the equations of joints are what textbooks say, and models of robots are
Pinocchio's.  On scenes of arms the package agrees with it.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np
import pinocchio as pin
import pytest
from joint_equations import FINGERTIPS, LOWER_PAIRS, FrameMotion, joint_equations
from random_trees import (
    ALL_FAMILIES,
    REAL_ROBOTS,
    ROWS,
    WELL_CONDITIONED,
    draw_trees,
    free_displacement,
    random_kind,
    random_pose,
    random_tree,
)
from scipy.spatial.transform import Rotation
from tree_models import as_robots, constant_torques, read_robot, read_tree_scene, start_of
from tree_oracle import (
    Motions,
    centres_of_seconds,
    collect,
    disagreement,
    evaluation_errors,
    solve_maximal,
    solve_minimal,
    worst_gap,
)
from tree_scenes import cart_scene, gripper_loops, gripper_scene

import multiarm as ma
from multiarm.scene import find_robot, parse_scene

EPS = float(np.finfo(float).eps)
# Rounding times the square of the condition of the equations, for sums of some tens of terms: 1e-9.
AGREEMENT = 40.0 * EPS / WELL_CONDITIONED**2
PER_FAMILY = 3
KINDS = (*LOWER_PAIRS, *FINGERTIPS)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Scenes by family and seed, each drawn once."""
    scenes = {}

    def draw(family: str, seed: int):
        if (family, seed) not in scenes:
            folder = tmp_path_factory.mktemp("robots")
            scenes[family, seed] = draw_trees(family, np.random.default_rng(seed), folder)
        return scenes[family, seed]

    return draw


# --- two ways of solving -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("family", ALL_FAMILIES)
def test_minimal_and_maximal_coordinates_agree(family, drawn):
    for seed in range(PER_FAMILY):
        _, trees, state, torques = drawn(family, seed)
        minimal = solve_minimal(trees, state, torques)
        maximal = solve_maximal(trees, state, torques)
        assert disagreement(minimal, maximal) < AGREEMENT, f"seed {seed}"
        assert minimal.rank == maximal.rank
        assert minimal.unique == maximal.unique
        # both choose the multipliers of least norm, so those that are not determined agree too
        for name, wrench in minimal.wrenches.items():
            size = max(np.max(np.abs(w)) for w in minimal.wrenches.values())
            np.testing.assert_allclose(maximal.wrenches[name], wrench, atol=AGREEMENT * size)
        for mimic, torque in minimal.mimic_torques.items():
            assert maximal.mimic_torques[mimic] == pytest.approx(torque, rel=1e-7, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "arms"), [("node", "pinocchio"), ("dense", "pinocchio"), ("node", "compiled")]
)
@pytest.mark.parametrize("family", ALL_FAMILIES)
def test_evaluations_agree(family, solver, arms, drawn):
    for seed in range(4):
        scene, trees, state, torques = drawn(family, seed)
        scene = {**scene, "run": {**scene.get("run", {}), "solver": solver}}
        system = ma.compile_system(parse_scene(scene), arms=arms)
        assert all(backend == arms for backend in system.arm_terms.values())
        evaluation = ma.evaluate(system)
        solution = solve_minimal(trees, state, torques)
        about = centres_of_seconds(trees, state)
        assert evaluation_errors(solution, evaluation, about) < AGREEMENT, f"seed {seed}"
        assert evaluation.rank == solution.rank
        assert list(evaluation.object_accelerations) == list(trees.objects)
        forces = evaluation.contact_forces_unique
        unique = {name: bool(np.all(forces[name])) for name in solution.unique}
        assert unique == solution.unique, f"seed {seed}"


def test_arms_written_as_robots_are_the_same(drawn):
    scene, trees, state, torques = drawn("arms_only", 0)
    as_arms = solve_minimal(trees, state, torques)
    written = as_robots(scene)
    trees = read_tree_scene(written)
    solution = solve_minimal(trees, start_of(written, trees), constant_torques(written, trees))
    for name, accelerations in as_arms.joint_accelerations.items():
        np.testing.assert_array_equal(solution.joint_accelerations[name], accelerations)
        np.testing.assert_array_equal(solution.wrenches[f"{name}/tip"], as_arms.wrenches[name])


@pytest.mark.parametrize("family", ALL_FAMILIES)
def test_scenes_start_closed_and_with_velocities_that_keep_them_closed(family, drawn):
    scene, trees, state, _ = drawn(family, 0)
    assert worst_gap(trees, state) < 1e-12
    written = start_of(scene, read_tree_scene(scene))
    motions = Motions(trees, written)
    n, rates = motions.coordinates.size, motions.coordinates.rates
    v = np.concatenate([motions.models[name].velocity for name in motions.names])
    assert np.max(np.abs(v)) > 0.1
    np.testing.assert_allclose(collect(trees, motions.frame, n, rates).A @ v, 0.0, atol=1e-11)


def test_families_reach_what_they_are_for(drawn):
    """Redundant rows, moving bases, couplings, several tips on the object, two robots."""
    scenes = [drawn(family, seed) for family in ALL_FAMILIES for seed in range(2)]
    robots = [robot for scene in scenes for robot in scene.trees.robots.values()]
    assert any("base_yaw" in robot.joints for robot in robots)
    assert any(robot.mimics for robot in robots)
    assert any(len(robot.tips) > 2 for robot in robots)
    ends = {
        tuple(end.partition("/")[0] for end in joint.get("between", ()))
        for scene in scenes
        for joint in scene.scene["joints"]
    }
    assert ("linkage", "linkage") in ends
    assert ("crane", "world") in ends
    assert any({"beam", "plate"} == set(pair) for pair in ends)


def test_families_of_several_objects_reach_what_they_are_for(drawn):
    """Redundant joints between objects, loops of objects, the world, an object that nothing holds,
    a robot whose tips hold two objects.
    """
    scenes = [drawn("objects_alone", seed) for seed in range(12)]
    joints = [[joint["between"] for joint in scene.scene["joints"]] for scene in scenes]
    of_objects = [
        [{*pair} for pair in pairs if {*pair} <= {*scene.trees.objects}]
        for pairs, scene in zip(joints, scenes, strict=True)
    ]
    assert any(pair == other for pairs in of_objects for pair, other in combinations(pairs, 2))
    assert any(
        _has_loop(scene.trees.objects, pairs)
        for scene, pairs in zip(scenes, of_objects, strict=True)
    )
    held = [{body for pair in pairs for body in pair} for pairs in joints]
    assert any({*scene.trees.objects} - bodies for scene, bodies in zip(scenes, held, strict=True))
    assert any(["box", "world"] in pairs or ["beam", "world"] in pairs for pairs in joints)
    tips = drawn("several_objects", 0).scene["joints"][:2]
    assert tips[0]["arm"].startswith("porter/") and tips[1]["arm"].startswith("porter/")
    assert tips[0]["object"] != tips[1]["object"]


def _has_loop(objects: Iterable[str], pairs: list[set[str]]) -> bool:
    """Whether different joints among three objects or more close a loop."""
    cluster = {name: name for name in objects}
    for first, second in {tuple(sorted(pair)) for pair in pairs}:
        if cluster[first] == cluster[second]:
            return True
        joined = cluster[second]
        cluster = {k: cluster[first] if v == joined else v for k, v in cluster.items()}
    return False


# --- equations of joints -------------------------------------------------------------------------


def moving_frame(X: pin.SE3, twist: np.ndarray, acceleration: np.ndarray, t: float) -> FrameMotion:
    """A frame at constant acceleration of its origin, with w(t) to second order of its rotation."""
    angle = twist[3:] * t + 0.5 * acceleration[3:] * t * t
    turn = Rotation.from_rotvec(angle).as_matrix()
    origin = X.translation + twist[:3] * t + 0.5 * acceleration[:3] * t * t
    return FrameMotion(
        turn @ X.rotation, origin, twist + t * acceleration, np.zeros((6, 0)), np.zeros(6)
    )


@pytest.mark.parametrize("kind", KINDS)
def test_rates_and_second_derivatives_of_joint_equations_are_those_of_their_values(kind, rng):
    joint = kind_of(rng, kind)
    poses = [random_pose(rng, 0.5) for _ in range(2)]
    motions = rng.uniform(-1.0, 1.0, (2, 2, 6))
    h = 1e-4  # errors h^2 of third and fourth derivatives, EPS / h^2 of rounding

    def at(t: float):
        frames = [moving_frame(X, *motion, t) for X, motion in zip(poses, motions, strict=True)]
        return joint_equations(joint, *frames), frames

    (now, frames), (after, _), (before, _) = at(0.0), at(h), at(-h)
    for e, later, earlier in zip(now, after, before, strict=True):
        rate = (later.value - earlier.value) / (2.0 * h)
        assert e.rate(*frames) == pytest.approx(rate, abs=1e-6)
        second = (later.value - 2.0 * e.value + earlier.value) / h**2
        along = e.by_first @ motions[0, 1] + e.by_second @ motions[1, 1]
        assert along + e.bias == pytest.approx(second, abs=1e-6)


def kind_of(rng, kind):
    while (joint := random_kind(rng))["kind"] != kind:
        pass
    return joint


@pytest.mark.parametrize("kind", KINDS)
def test_joints_leave_their_free_displacements_and_forces_are_opposite(kind, rng):
    joint = kind_of(rng, kind)
    S = random_pose(rng, 0.5)
    F = S * free_displacement(rng, joint)
    first, second = (
        FrameMotion(X.rotation, X.translation, np.zeros(6), np.zeros((6, 0)), np.zeros(6))
        for X in (F, S)
    )
    equations = joint_equations(joint, first, second)
    np.testing.assert_allclose([e.value for e in equations], 0.0, atol=1e-14)
    on_second = np.array([e.by_second for e in equations])
    assert np.linalg.matrix_rank(on_second, 1e-9) == len(equations) == ROWS[kind]
    shift = first.origin - second.origin
    for e in equations:
        force, moment = np.split(e.by_first, 2)
        about_second = np.concatenate([force, moment + np.cross(shift, force)])
        np.testing.assert_allclose(about_second, -e.by_second, atol=1e-14)


# --- models of robots ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(REAL_ROBOTS))
def test_models_of_robots_are_pinocchios(name, rng):
    """Joints, inertia and gravity of the model that Pinocchio reduces by itself, base fixed."""
    tips = REAL_ROBOTS[name]
    robot = read_robot("r", {"robot": name, "tips": tips}, set())
    whole = pin.buildModelFromUrdf(str(find_robot(name).urdf))
    fixed = [i for i in range(1, whole.njoints) if whole.names[i] not in robot.joints]
    q_rest = pin.neutral(whole)
    for i in fixed:
        joint = whole.joints[i]
        if joint.nq == 1:
            limits = whole.lowerPositionLimit[joint.idx_q], whole.upperPositionLimit[joint.idx_q]
            q_rest[joint.idx_q] = np.clip(0.0, *limits)
    model = pin.buildReducedModel(whole, fixed, q_rest)
    assert tuple(model.names)[1:] == robot.joints
    angles = rng.uniform(-1.0, 1.0, len(robot.joints))
    pairs = [
        [np.cos(a), np.sin(a)] if joint.nq == 2 else [a]
        for a, joint in zip(angles, model.joints.tolist()[1:], strict=True)
    ]
    q, M = np.concatenate(pairs), []
    for pinocchio_model, configuration in ((model, q), (robot.model, angles)):
        M.append(np.triu(pin.crba(pinocchio_model, pinocchio_model.createData(), configuration)))
    np.testing.assert_allclose(M[1], M[0], atol=1e-11 * np.max(M[0]))
    gravity = [
        pin.computeGeneralizedGravity(m, m.createData(), x)
        for m, x in ((model, q), (robot.model.copy(), angles))
    ]
    assert np.max(np.abs(gravity[0])) > 1e-3
    np.testing.assert_allclose(gravity[1], gravity[0], atol=1e-10 * np.max(np.abs(gravity[0])))


def test_the_mass_of_a_base_is_added_to_the_root_link(tmp_path, rng):
    """All translations of a locked robot have its total mass; yaw has the base's inertia too."""
    path = tmp_path / "tree.urdf"
    random_tree(rng, path, 4)
    lock = {f"joint_{k}": 0.2 for k in range(1, 5)}
    base = {"moves": ["x", "y", "z", "yaw"], "mass": 7.0, "inertia": [1.0, 2.0, 3.0]}
    table = {"urdf": str(path), "tips": {"tip": "link_4"}, "lock": lock}
    plain, heavy = (
        read_robot("r", {**table, "base": {**base, **more}}, set()).model
        for more in ({"mass": None, "inertia": None}, {})
    )
    q = rng.uniform(-1.0, 1.0, 4)
    difference = pin.crba(heavy, heavy.createData(), q) - pin.crba(plain, plain.createData(), q)
    total = pin.computeTotalMass(pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer()))
    assert list(heavy.names)[1:] == ["base_x", "base_y", "base_z", "base_yaw"]
    assert pin.crba(plain, plain.createData(), q)[0, 0] == pytest.approx(total)
    np.testing.assert_allclose(difference, np.diag([7.0, 7.0, 7.0, 3.0]), atol=1e-12)


# --- the project's robots with several tips ------------------------------------------------------


def test_a_gripper_of_four_bar_linkages_has_one_degree_of_freedom():
    """All joints of the gripper turn alike, so one equation of motion remains of six."""
    scene = gripper_scene(0.3)
    scene["joints"] = gripper_loops("gripper")
    speed = 0.8
    scene["robots"]["gripper"]["velocity"] = [speed] * 6
    trees = read_tree_scene(scene)
    state, torques = start_of(scene, trees), constant_torques(scene, trees)
    assert worst_gap(trees, state) < 1e-12
    model = trees.robots["gripper"].model
    alike = np.ones(6)
    M = np.triu(pin.crba(model, model.createData(), 0.3 * alike))
    M = M + np.triu(M, 1).T
    bias = pin.nonLinearEffects(model, model.createData(), 0.3 * alike, speed * alike)
    acceleration = alike @ (torques["gripper"] - bias) / (alike @ M @ alike)
    solution = solve_minimal(trees, state, torques)
    assert (solution.rank, solution.rows) == (5, 11)
    np.testing.assert_allclose(
        solution.joint_accelerations["gripper"], acceleration * alike, rtol=1e-10
    )


@pytest.mark.parametrize("scene_of", [gripper_scene, cart_scene])
def test_scenes_of_our_robots_agree_in_both_coordinates(scene_of):
    scene = scene_of()
    trees = read_tree_scene(scene)
    state, torques = start_of(scene, trees), constant_torques(scene, trees)
    assert worst_gap(trees, state) < 1e-12
    minimal = solve_minimal(trees, state, torques)
    assert disagreement(minimal, solve_maximal(trees, state, torques)) < AGREEMENT


def test_a_gripper_that_holds_a_box_is_rigid_and_carries_its_weight():
    """The left pad's weld, the right pad's face and the coupling leave no motion."""
    scene = gripper_scene()
    trees = read_tree_scene(scene)
    state, torques = start_of(scene, trees), constant_torques(scene, trees)
    solution = solve_minimal(trees, state, torques)
    np.testing.assert_allclose(solution.object_acceleration, 0.0, atol=1e-9)
    sum_of_wrenches = sum(
        solution.wrench(f"gripper/{side}", state.object_position) for side in ("left", "right")
    )
    weight = scene["object"]["mass"] * 9.81
    np.testing.assert_allclose(sum_of_wrenches, [0, 0, weight, 0, 0, 0], atol=1e-9)
    squeeze = solution.wrenches["gripper/left"][0]
    assert abs(squeeze) > 1.0
