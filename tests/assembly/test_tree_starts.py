"""Claims about starts of robots with several tips: couplings, inner loops, the world.

Oracle: the equations of the connections and couplings by Pinocchio (``tree_oracle``).
"""

from __future__ import annotations

import copy

import numpy as np
import pytest
from random_trees import FAMILIES, draw_trees
from scipy.spatial.transform import Rotation
from tree_models import TreeState, read_tree_scene, robot_tables
from tree_oracle import Motions, collect, worst_gap
from tree_scenes import (
    cart_scene,
    coupled_hand,
    floating_scene,
    gripper_scene,
    hinge_urdf,
    link_urdf,
    satellite_scene,
    together,
    two_finger_scene,
)

import multiarm as ma
from multiarm.errors import ModelError, SceneError, SolverError
from multiarm.scene import parse_scene

# Gaps are closed to 100 roundings of the scene's size, which is a few metres at most.
CLOSED = 1e-12


def start_state(system) -> TreeState:
    start = system.initial_state()
    held = {
        "position": start.object_position,
        "quaternion_xyzw": start.object_quaternion_xyzw,
        "twist": start.object_twist,
    }
    return TreeState({"object": held}, dict(start.joint_positions), dict(start.joint_velocities))


def gap_rates(trees, state) -> np.ndarray:
    """Rates of all equations of connections and couplings [m/s, rad/s]."""
    motions = Motions(trees, state)
    n, rates = motions.coordinates.size, motions.coordinates.rates
    v = np.concatenate([motions.models[name].velocity for name in motions.names])
    return collect(trees, motions.frame, n, rates).A @ v


def shaken(scene, rng, joints=0.01, place=0.0, rates=0.1):
    """The scene with other postures, another pose of the object, and other velocities."""
    scene = copy.deepcopy(scene)
    for spec in robot_tables(scene).values():
        n = len(spec["posture"])
        spec["posture"] = (spec["posture"] + joints * rng.uniform(-1.0, 1.0, n)).tolist()
        velocity = np.array(spec.get("velocity", np.zeros(n)))
        spec["velocity"] = (velocity + rates * rng.uniform(-1.0, 1.0, n)).tolist()
    pose = scene["object"]["pose"]
    pose["xyz"] = (pose["xyz"] + place * rng.uniform(-1.0, 1.0, 3)).tolist()
    return scene


@pytest.mark.parametrize("family", FAMILIES)
def test_postures_and_velocities_are_put_on_all_connections(family, tmp_path):
    rng = np.random.default_rng(3)
    drawn = draw_trees(family, rng, tmp_path)
    scene = shaken(drawn.scene, rng)
    trees = read_tree_scene(scene)
    system = ma.compile_system(parse_scene(scene))
    state = start_state(system)
    assert worst_gap(trees, state) < CLOSED
    assert np.max(np.abs(gap_rates(trees, state))) < CLOSED * 10.0  # of terms of some m/s
    report = system.start_report
    owners = [*drawn.trees.robots, *(connection.name for connection in trees.connections)]
    assert set(report.gaps) <= set(owners)
    assert report.joint_changes.keys() == drawn.trees.robots.keys()
    assert max(report.gaps.values()) > 1e-4
    assert max(report.gaps_left.values()) < CLOSED


def test_the_object_is_put_where_the_world_holds_it():
    """A cart could follow the object anywhere; the plane that the object is on decides."""
    scene = cart_scene()
    at = copy.deepcopy(scene["object"]["pose"])
    scene["joints"].append({"between": ["object", "world"], "kind": "planar", "at": at})
    scene["object"]["pose"]["xyz"][2] += 0.01
    system = ma.compile_system(parse_scene(scene))
    state = start_state(system)
    assert not system.start_report.object_held
    assert worst_gap(read_tree_scene(scene), state) < CLOSED
    assert state.object_position[2] == pytest.approx(at["xyz"][2], abs=CLOSED)


def test_a_leader_written_alone_moves_its_followers():
    """A gripper's linkages and couplings follow the crank; the couplings are exact."""
    scene = gripper_scene()
    scene["joints"] = scene["joints"][2:] + [{"between": ["object", "world"], "kind": "weld"}]
    scene["joints"][-1]["at"] = scene["object"]["pose"]
    scene["robots"]["gripper"]["posture"][0] += 0.1
    system = ma.compile_system(parse_scene(scene))
    state = start_state(system)
    assert worst_gap(read_tree_scene(scene), state) < CLOSED
    moved = state.joint_positions["gripper"] - 0.3
    assert np.min(np.abs(moved)) > 0.02  # all six share the correction
    assert system.start_report.object_held


def test_starts_too_far_off_are_refused_with_the_connections_that_are():
    scene = gripper_scene()
    scene["robots"]["gripper"]["posture"][1] += 0.9
    with pytest.raises(SceneError) as error:
        ma.compile_system(parse_scene(scene))
    text = str(error.value)
    assert "gripper" in text and "left_loop" in text
    scene = cart_scene()
    scene["object"]["pose"]["xyz"][0] += 1.5
    with pytest.raises(SceneError, match="cart/left"):
        ma.compile_system(parse_scene(scene))


def test_a_start_that_is_too_far_off_hears_whether_a_posture_can_be_sought():
    scene = satellite_scene()
    scene["joints"][0]["at"] = {"xyz": [0, 0, 0]}
    scene["object"]["pose"]["xyz"][0] += 1.5

    def refusal() -> str:
        with pytest.raises(SceneError) as caught:
            ma.compile_system(parse_scene(scene))
        return str(caught.value)

    asked = "let `posture: solve` find a posture, with the base where it is written"
    assert asked in refusal()
    del scene["robots"]["sat"]["posture"]
    assert asked in refusal()
    scene["robots"]["sat"]["posture"] = "solve"
    assert "find a posture" not in refusal()
    scene["robots"]["sat"] = {"robot": "ur5", "tips": {"hand": "tool0"}, "posture": [0.1] * 6}
    assert "let `posture: solve` find a posture" in refusal()
    system = ma.compile_system(parse_scene(scene), assemble=False)
    with pytest.raises(ModelError) as caught:  # a posture is not what is wrong with a state
        ma.simulate(system, 0.1, state=system.initial_state())
    assert "does not satisfy" in str(caught.value) and "solve" not in str(caught.value)


def scene_size_at_start(scene) -> float:
    from multiarm.assembly.linkage import scene_size
    from multiarm.dynamics.contact_geometry import place_state

    system = ma.compile_system(parse_scene(scene))
    with system.borrow() as data:
        place_state(data, 0.0, system.initial_state())
        return scene_size(data)


def test_the_size_of_a_scene_does_not_depend_on_where_its_base_has_gone():
    """Gaps up to a tenth of the size are assembled: 3 m are none of a cart 40 m away."""
    sizes = []
    for away in (0.0, 40.0):
        scene = cart_scene()
        scene["object"]["pose"]["xyz"][0] += away
        scene["robots"]["cart"]["posture"][0] += away
        sizes.append(scene_size_at_start(scene))
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-12)


def test_the_size_of_a_hand_with_a_coupling_does_not_depend_on_where_it_stands(tmp_path):
    """The coupling's row has no place; roundings are 50 m times 1e-16 of some tenths of a metre."""
    sizes = [scene_size_at_start(coupled_hand(tmp_path, away=away)) for away in (0.0, 50.0)]
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-12)


@pytest.mark.parametrize("fingers", [(2,), (2, 2, 2)], ids=["one block", "a block a finger"])
def test_couplings_are_closed_from_as_far_on_a_finger_as_on_a_whole_robot(fingers, tmp_path):
    scene = coupled_hand(tmp_path, fingers, off=0.3)
    system = ma.compile_system(parse_scene(scene))
    assert max(system.start_report.gaps.values()) == pytest.approx(0.3)
    assert worst_gap(read_tree_scene(scene), start_state(system)) < CLOSED
    with pytest.raises(SceneError, match=r"couplings of the joints of robot 'hand'.* rad"):
        ma.compile_system(parse_scene(coupled_hand(tmp_path, fingers, off=0.9)))


def test_a_coupling_that_cannot_be_closed_is_no_contradiction_of_contacts(tmp_path):
    """The world holds the object, which holds the finger where its joints are not alike."""
    scene = coupled_hand(tmp_path, (2, 2), off=0.3, kind="weld")
    scene["joints"].append({"between": ["object", "world"], "kind": "weld"})
    with pytest.raises(SceneError, match=r"couplings of hand: 0\.3 rad") as error:
        ma.compile_system(parse_scene(together(scene)))
    assert "contradict" not in str(error.value)


# --- what holds where a joint is closed ----------------------------------------------------------

HALF_TURN = "3.141592653589793 0 0"


@pytest.mark.parametrize("order", [["hand/thumb", "hand/end"], ["hand/end", "hand/thumb"]])
def test_a_tip_that_is_turned_against_its_link_is_welded_the_right_way_round(order, tmp_path):
    """Without ``at`` the joint is where the first tip is: both its frames coincide."""
    joint = {"between": order, "kind": "weld"}
    scene = two_finger_scene(tmp_path / "hand.urdf", "0 0 0.1", HALF_TURN, joint)
    system = ma.compile_system(parse_scene(scene))
    assert max(system.start_report.gaps.values()) < CLOSED


@pytest.mark.parametrize("order", [["hand/thumb", "hand/end"], ["hand/end", "hand/thumb"]])
def test_a_weld_between_links_that_is_upside_down_is_refused(order, tmp_path):
    """At one place and half a turn apart, so that all distances of a weld vanish."""
    at = {"at": {}, "at_first": {}}
    joint = {"between": order, "kind": "weld", **at}
    scene = two_finger_scene(tmp_path / "hand.urdf", "0 0 0", HALF_TURN, joint)
    scene["robots"]["hand"]["posture"] = [0.2, 0.2]
    with pytest.raises(SceneError, match=r"joint 'loop' the wrong way round.*by 180 degrees"):
        ma.compile_system(parse_scene(scene))


# --- floating bases ------------------------------------------------------------------------------


def test_the_report_has_what_a_floating_base_moved_apart_from_the_joints():
    scene = satellite_scene()
    scene["object"]["pose"]["xyz"][0] += 0.01
    scene["robots"]["sat"]["base"]["twist"] = [0.0] * 6
    scene["object"]["twist"] = [0.1, 0.0, 0.0, 0.0, 0.2, 0.0]
    parsed = parse_scene(scene)
    system = ma.compile_system(parsed)
    report, start = system.start_report, system.initial_state()
    written = ma.compile_system(parsed, assemble=False).initial_state()
    base, before = start.bases["sat"], written.bases["sat"]
    turn = (
        Rotation.from_quat(base.quaternion_xyzw) * Rotation.from_quat(before.quaternion_xyzw).inv()
    )
    twist = base.twist - before.twist
    joints = np.abs(start.joint_positions["sat"] - written.joint_positions["sat"])
    assert report.base_shifts["sat"] == pytest.approx(
        np.linalg.norm(base.position - before.position), abs=CLOSED
    )
    assert report.base_turns["sat"] == pytest.approx(turn.magnitude(), abs=CLOSED)
    assert report.joint_changes["sat"] == report.joint_change == pytest.approx(joints.max())
    assert report.base_velocity_changes["sat"] == pytest.approx(np.linalg.norm(twist[:3]))
    assert report.base_spin_changes["sat"] == pytest.approx(np.linalg.norm(twist[3:]))
    rates = np.abs(start.joint_velocities["sat"] - written.joint_velocities["sat"])
    assert report.joint_velocity_change == pytest.approx(rates.max())
    assert min(report.base_shifts["sat"], report.base_turns["sat"]) > 1e-6
    told = "; ".join(report.lines())
    assert f"the base of sat moved by {report.base_shifts['sat']:.3g} m" in told
    assert f"base of sat {report.base_velocity_changes['sat']:.3g} m/s" in told


def test_a_base_without_joints_is_all_that_moves(tmp_path):
    """Nothing is said of joints; limits of joints are those of none."""
    scene = floating_scene(
        tmp_path / "sat.urdf", link_urdf("root"), "root", [], effects={"joint_limits": {}}
    )
    scene["joints"][0] |= {"at": {"xyz": [0.0, 0.01, -1.0]}, "at_first": {}}
    report = ma.compile_system(parse_scene(scene)).start_report
    assert report.joint_change == 0.0 and not report.joint_changes
    assert report.base_shifts["sat"] == pytest.approx(0.01, abs=CLOSED)
    (line,) = report.lines()
    assert line.startswith("the base of sat moved by 0.01 m and ")


def test_a_floating_base_without_mass_can_get_its_own(tmp_path):
    links = "<link name='root'/>" + link_urdf("arm") + hinge_urdf("arm")
    scene = floating_scene(tmp_path / "sat.urdf", links, "arm", [0.1])
    with pytest.raises(SolverError, match=r"robot 'sat'.*base: {mass: \.\.\., inertia: \.\.\.}"):
        ma.compile_system(parse_scene(scene))
    scene["robots"]["sat"]["base"] |= {"mass": 1.0, "inertia": [0.1, 0.1, 0.1]}
    ma.compile_system(parse_scene(scene))


# --- names ---------------------------------------------------------------------------------------


def test_a_robot_is_no_arm_whatever_its_joints_are_called(tmp_path):
    joint = {"between": ["hand/thumb", "hand/end"], "kind": "weld"}
    scene = two_finger_scene(tmp_path / "hand.urdf", "0 0 0.1", HALF_TURN, joint)
    system = ma.compile_system(parse_scene(scene))
    assert "robots hand; 2 joints" in str(system.model.layout)
    with pytest.raises(ModelError, match="unknown robot 'grip'; robots are hand"):
        system.state(joint_positions={"grip": [0.0]})
    with pytest.raises(ModelError, match="robot 'hand': no frame 'nail'"):
        system.arms["hand"].link("nail")


def test_a_state_of_another_system_is_told_by_its_joints_without_bases(tmp_path):
    links = link_urdf("root") + link_urdf("arm") + hinge_urdf("arm")
    with_joint = floating_scene(tmp_path / "one.urdf", links, "arm", [0.1])
    without = floating_scene(tmp_path / "none.urdf", link_urdf("root"), "root", [])
    state = ma.compile_system(parse_scene(with_joint)).initial_state()
    with pytest.raises(ModelError, match=r"robots sat \(1 joint\)"):
        ma.evaluate(ma.compile_system(parse_scene(without)), 0.0, state)


def test_what_the_world_holds_is_no_floor():
    scene = cart_scene()
    at = copy.deepcopy(scene["object"]["pose"])
    scene["joints"].append({"between": ["object", "world"], "kind": "planar", "at": at})
    model = ma.compile_system(parse_scene(scene)).model
    assert model.blocks == ["cart", "object-world"]
