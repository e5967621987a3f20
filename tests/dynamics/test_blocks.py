"""Claims about the blocks of robots: branches on a base that does not move are eliminated alone.

The oracles: the same fingers written as arms, whose equations are those of the robot; and what the
joints of a robot share, read off its tree.
"""

from __future__ import annotations

import numpy as np
import pytest
from random_trees import FAMILIES, draw_trees, random_hand
from scipy.optimize import approx_fprime

import multiarm as ma
from multiarm.assembly.blocks import RobotPart, blocks_of_group, robots_together
from multiarm.contacts.table import JointRow
from multiarm.dynamics.connections import Connection
from multiarm.dynamics.data import Data
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.status import OK
from multiarm.robots.robot import Robot, RobotFiles
from multiarm.scene import parse_scene
from multiarm.scene.bodies import BodyName, object_named

FINGERS = (3, 2, 1, 3)  # less than ten joints: Pinocchio orders them by name
ENDS = np.cumsum(FINGERS).tolist()
EPS = float(np.finfo(float).eps)
# Rounding times the condition of K and S, which are those of both ways of writing.
AS_ARMS = 1e6 * EPS


@pytest.fixture
def hand_file(rng, tmp_path):
    path = tmp_path / "hand.urdf"
    random_hand(rng, path, list(FINGERS), copies=False)
    return path


@pytest.fixture
def hand(hand_file):
    tips = {f"tip_{k}": f"link_{end}" for k, end in enumerate(ENDS)}
    return Robot("hand", RobotFiles(hand_file, (), np.eye(4), tips, {}))


def held_by(*tips: int) -> list[Connection]:
    return [
        Connection(f"hand/tip_{k}", BodyName("hand", f"tip_{k}"), object_named("object"))
        for k in tips
    ]


def blocks_of(hand, connections, of_joints, with_rows):
    return blocks_of_group({"hand": hand}, connections, {"hand": of_joints}, {"hand": with_rows})


def ranges(blocks) -> list[tuple[int, int]]:
    return [(part.joints.start, part.joints.stop) for block in blocks for part in block.parts]


def owners(blocks) -> list[str]:
    return [part.owner for block in blocks for part in block.parts]


# --- what belongs together -----------------------------------------------------------------------


def test_fingers_are_blocks(hand):
    blocks = blocks_of(hand, held_by(3, 1, 0, 2), (), ())
    assert ranges(blocks) == [(0, 3), (3, 5), (5, 6), (6, 9)]
    assert [block.connections for block in blocks] == [(f"hand/tip_{k}",) for k in range(4)]


def test_a_connection_between_fingers_joins_them_and_those_between(hand):
    pinch = Connection("pinch", BodyName("hand", "tip_0"), BodyName("hand", "tip_2"))
    blocks = blocks_of(hand, [*held_by(0, 1, 2, 3), pinch], (), ())
    assert ranges(blocks) == [(0, 6), (6, 9)]


def test_a_joint_that_copies_one_of_another_finger_joins_them(hand):
    coupling = JointRow("copies", 5, leader=4, multiplier=0.5)
    blocks = blocks_of(hand, held_by(0, 1, 2, 3), [coupling], {5})
    assert ranges(blocks) == [(0, 3), (3, 6), (6, 9)]
    assert owners(blocks)[1] == "hand"


def test_rows_of_joints_follow_the_only_connection_of_their_block(hand):
    blocks = blocks_of(hand, held_by(0, 1, 2, 3), (), range(9))
    assert owners(blocks) == [f"hand/tip_{k}" for k in range(4)]


def test_blocks_with_rows_and_no_connection_are_one(hand):
    """The rows that the robot owns stand together."""
    blocks = blocks_of(hand, held_by(1, 3), (), range(9))
    assert ranges(blocks) == [(0, 6), (6, 9)]  # fingers 0 and 2, and the one between
    assert owners(blocks) == ["hand/tip_1", "hand/tip_3"]
    free = blocks_of(hand, held_by(3), (), {0, 5})
    assert ranges(free) == [(0, 6), (6, 9)]
    assert owners(free) == ["hand", "hand/tip_3"]
    assert ranges(blocks_of(hand, held_by(3), (), {0})) == [(0, 3), (3, 5), (5, 6), (6, 9)]


def test_robots_that_are_joined_are_one_block_with_all_their_joints(hand):
    held = held_by(0, 3)
    shake = Connection("shake", BodyName("hand", "tip_1"), BodyName("other", "tip_2"))
    nothing = {"hand": (), "other": ()}
    (block,) = blocks_of_group({"hand": hand, "other": hand}, [*held, shake], nothing, nothing)
    assert block.parts == tuple(RobotPart(n, range(9), n) for n in ("hand", "other"))
    assert block.connections == ("hand/tip_0", "hand/tip_3", "shake")
    assert (block.joint_count, block.owners[-2:]) == (18, ["hand", "other"])


def test_robots_in_a_chain_or_ring_are_together_in_the_order_of_the_scene():
    names, chain = "abcdef", [{"d", "b"}, {"e"}, set(), {"f", "d"}]
    together = [["a"], ["b", "d", "f"], ["c"], ["e"]]
    assert robots_together(names, chain) == together
    assert robots_together(names, [*chain, {"b", "f"}]) == together
    assert robots_together(names, [{"a", "f"}, {"b", "c"}, {"c", "f"}]) == [
        list("abcf"),
        ["d"],
        ["e"],
    ]


@pytest.mark.parametrize("family", FAMILIES)
def test_joints_of_different_blocks_share_no_inertia_and_no_row(family, tmp_path):
    for seed in range(3):
        drawn = draw_trees(family, np.random.default_rng(seed), tmp_path)
        system = ma.compile_system(parse_scene(drawn.scene))
        layout, data = system.model.layout, Data(system.model)
        ma_state = system.initial_state()
        data.set_state(0.0, ma_state)
        rows = constraint_rows(system, ma_state)
        for i, name in enumerate(layout.names):
            inertia = (
                system.arms[name]
                .terms(
                    ma_state.joint_positions[name],
                    ma_state.joint_velocities[name],
                    next(iter(system.arms[name].tips)),
                )
                .M
            )
            for block in layout.blocks_of(i):
                joints = layout.joints_of_block(block)
                of_robot = np.arange(joints.start, joints.stop) - layout.first_joint[i]
                others = np.setdiff1d(np.arange(len(inertia)), of_robot)
                assert not inertia[np.ix_(of_robot, others)].any()
                contacts = layout.contacts_of_block(block)
                outside = np.setdiff1d(np.arange(layout.contacts), np.r_[contacts])
                assert np.max(np.abs(rows[np.ix_(outside, np.r_[joints])]), initial=0.0) < 1e-6
        assert layout.first_of_block[-1] == layout.contacts


def constraint_rows(system, state) -> np.ndarray:
    """Derivatives of all gaps by the joint positions, (N, n), by differences."""
    data = Data(system.model)

    def gaps(positions: np.ndarray) -> np.ndarray:
        moved = state.copy()
        moved.layout.joint_positions(moved.position)[:] = positions
        data.set_state(0.0, moved)
        assert update_kinematics(data.struct) == OK
        return data.contact_rows.gap.copy()

    return approx_fprime(state.layout.joint_positions(state.position), gaps, 1e-7)


# --- a hand is its fingers -----------------------------------------------------------------------

KINDS = ({"kind": "ball"}, {"kind": "point_on_plane"}, {"kind": "point_on_plane"}, {"kind": "ball"})


def both_ways(path, rng, **more):
    """A hand as one robot, and its fingers as arms."""
    angles = rng.uniform(-1.0, 1.0, ENDS[-1])
    base = {"xyz": [0.1, 0.2, 0.3], "rpy": [0.4, 0.2, 1.0]}
    tips = {f"tip_{k}": f"link_{end}" for k, end in enumerate(ENDS)}
    box = {"mass": 2.0, "inertia": [0.05, 0.06, 0.07], "twist": [0.1, 0.2, -0.1, 0.3, -0.2, 0.1]}
    scene = {"gravity": [0.0, 0.0, -9.81], "object": box, **more}
    robot = {"urdf": str(path), "base": base, "tips": tips, "posture": angles.tolist()}
    held = [{"arm": f"hand/{tip}", **kind} for tip, kind in zip(tips, KINDS, strict=True)]
    arms, first = {}, 0
    for (tip, link), end in zip(tips.items(), ENDS, strict=True):
        posture = angles[first:end].tolist()
        arms[tip] = {"urdf": str(path), "base": base, "tip": link, "posture": posture}
        first = end
    of_arms = [{"arm": tip, **kind} for tip, kind in zip(tips, KINDS, strict=True)]
    return (
        {**scene, "robots": {"hand": robot}, "joints": held},
        {**scene, "arms": arms, "joints": of_arms},
    )


@pytest.mark.parametrize("arms", ["pinocchio", "compiled"])
def test_a_hand_moves_as_its_fingers_written_as_arms(hand_file, rng, arms):
    as_robot, as_arms = (
        ma.compile_system(parse_scene(scene), arms=arms) for scene in both_ways(hand_file, rng)
    )
    states = [system.initial_state() for system in (as_robot, as_arms)]
    np.testing.assert_allclose(states[0].velocity, states[1].velocity, atol=1e-12)
    states[1].position[:], states[1].velocity[:] = states[0].position, states[0].velocity
    robot, fingers = (
        ma.evaluate(system, 0.0, state)
        for system, state in zip((as_robot, as_arms), states, strict=True)
    )
    size = np.max(np.abs(fingers.accelerations))
    np.testing.assert_allclose(
        robot.accelerations, fingers.accelerations, rtol=0.0, atol=AS_ARMS * size
    )
    for k in range(len(FINGERS)):
        forces = robot.contact_forces[f"hand/tip_{k}"]
        np.testing.assert_allclose(forces, fingers.contact_forces[f"tip_{k}"], rtol=1e-9, atol=1e-9)
    assert robot.conditioning["hand"] == pytest.approx(min(fingers.conditioning.values()))


JOINTS = {
    f"tip_{k}": [f"joint_{j}" for j in range(end - count + 1, end + 1)]
    for k, (count, end) in enumerate(zip(FINGERS, ENDS, strict=True))
}
STOP = (-1.3, 1.3)
PUSH = {"force": [3.0, 2.0, 1.0], "torque": [0.1, 0.2, 0.3], "at": [0.1, 0.0, 0.0]}
RUNS = {
    "matrix method": ({"integrator": "rodas5p", "tolerance": 1e-9}, {"joint_damping": 0.3}),
    "variational": ({"integrator": "variational", "step": 1e-3}, {"joint_damping": 0.3}),
    "dry friction": ({"accuracy": 1e-8}, {"joint_friction": {"torque": 4.0}}),
    "stops": ({"accuracy": 1e-8}, {"joint_limits": {"restitution": 0.3}}),
    "wrench on a link": ({"integrator": "rodas5p", "tolerance": 1e-9}, {"external_wrenches": [{}]}),
}


def effects_by_name(effects, joints: dict[str, list[str]], link: str):
    """The effects with what names a robot or an arm."""
    if "joint_limits" in effects:
        ends = {name: dict.fromkeys(of_robot, STOP) for name, of_robot in joints.items()}
        return {"joint_limits": {**effects["joint_limits"], "range": ends}}
    if "external_wrenches" in effects:
        return {"external_wrenches": [{"on": link, **PUSH}]}
    return effects


@pytest.mark.slow
@pytest.mark.parametrize("what", RUNS)
def test_a_hand_runs_as_its_fingers_written_as_arms(what, hand_file, rng):
    settings, effects = RUNS[what]
    run = {"duration": 0.3, "output_step": 0.1, **settings}
    as_robot, as_arms = both_ways(hand_file, rng, run=run)
    every = [joint for joints in JOINTS.values() for joint in joints]
    as_robot["effects"] = effects_by_name(effects, {"hand": every}, "hand/link_8")
    as_arms["effects"] = effects_by_name(effects, JOINTS, "tip_3/link_8")
    robot, fingers = (
        ma.simulate(ma.compile_system(parse_scene(scene), arms="compiled"))
        for scene in (as_robot, as_arms)
    )
    np.testing.assert_allclose(
        robot.joint_positions["hand"][-1],
        np.concatenate([positions[-1] for positions in fingers.joint_positions.values()]),
        atol=1e-9,  # roundings, which events and the choice of steps magnify
    )
    np.testing.assert_allclose(robot.object_position[-1], fingers.object_position[-1], atol=1e-9)
    if what in ("stops", "dry friction"):
        assert len(robot.events) == len(fingers.events) > 2
