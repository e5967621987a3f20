"""Claims about what an arm cannot do, in words.

Oracle: the tip's Jacobian.  A lost direction is a wrench without power at any joint velocities, and
there are as many as the rank of ``J^T W`` is short of.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from mechanics import (
    PANDA_FINGERS,
    PANDA_POSTURE,
    chain_urdf,
    panda_trio,
    scene_of,
    single_arm,
    two_arm_block_twice,
)
from scipy.spatial.transform import Rotation

import multiarm as ma
from multiarm.dynamics.contact_geometry import contact_terms
from multiarm.dynamics.data import Data
from multiarm.dynamics.diagnosis import (
    LITTLE,
    LONGEST,
    describe,
    lost_directions,
    lost_motions,
)
from multiarm.dynamics.equations import update_kinematics
from multiarm.dynamics.status import OK

WELD, BALL = {"kind": "weld"}, {"kind": "ball"}
STRETCHED = [0.2, -1.0, 0.0, -0.7, -1.3, 0.4]  # a UR5's elbow
WRIST_ALIGNED = [0.2, -1.0, 1.2, 0.5, 0.0, 0.4]
HEALTHY = [0.2, -1.0, 1.2, 0.5, 1.0, 0.4]


def placed(scene):
    """A Data with the kinematics of the scene's start."""
    system = ma.compile_system(scene)
    data = Data(system.model)
    data.set_state(0.0, system.initial_state())
    assert update_kinematics(data.struct) == OK
    return data


def one_arm(robot, tip, posture, joint, **more):
    return placed(single_arm(robot, tip, posture, joint, run={"solver": "dense"}, **more))


def ur5(posture, joint=WELD):
    return one_arm("ur5", "tool0", posture, joint)


def tip_terms(data, arm="arm"):
    q = data.get_state().joint_positions[arm]
    return data.model.robots[arm].terms(q, np.zeros(q.size))


def torques_of(data, lost, arm="arm"):
    """Joint torques that a lost wrench is felt as, by the tip's Jacobian."""
    terms = tip_terms(data, arm)
    moment = lost.moment + np.cross(lost.place - terms.tip_position, lost.force)
    return terms.J.T @ np.concatenate([lost.force, moment])


def angle_between(a, b):
    """Of two lines [degrees]."""
    return math.degrees(math.acos(min(abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b), 1.0)))


# --- robots --------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [WELD, BALL], ids=["weld", "ball"])
def test_a_regular_arm_has_lost_nothing(joint):
    data = ur5(HEALTHY, joint)
    assert lost_motions(data) == {"arm": ()}
    assert lost_directions(data, "arm") == ()


def test_a_stretched_elbow_cannot_move_along_its_reach():
    data = ur5(STRETCHED)
    assert lost_motions(data) == {"arm": ("no motion along its own reach",)}
    (lost,) = lost_directions(data, "arm")
    # the only wrench that no joint feels
    J = tip_terms(data).J
    null = np.linalg.svd(J)[0][:, -1]
    moment = lost.moment + np.cross(lost.place - tip_terms(data).tip_position, lost.force)
    wrench = np.concatenate([lost.force, moment])
    assert abs(wrench @ null) == pytest.approx(np.linalg.norm(wrench), rel=1e-12)
    assert lost.share < 1e-12
    # shoulder to wrist: the UR5's first two axes meet 0.089159 m above its base
    upper, fore, offset = 0.425, 0.39225, 0.10915
    heading, lift = STRETCHED[0], STRETCHED[1]
    along = (upper + fore) * math.cos(lift)
    reach = np.array([along, offset, -(upper + fore) * math.sin(lift)])
    reach[:2] = Rotation.from_rotvec([0, 0, heading]).as_matrix()[:2, :2] @ reach[:2]
    assert angle_between(lost.force, reach) < 5.0


def test_a_spherical_wrist_on_a_stretched_elbow_loses_exactly_the_line_from_the_shoulder():
    data = one_arm("textbook_6r", "tool", [0.1, 0.5, 0.0, 0.3, 0.8, 0.2], WELD)
    assert lost_motions(data)["arm"] == ("no motion along its own reach",)
    (lost,) = lost_directions(data, "arm")
    assert lost.force @ lost.moment == pytest.approx(0.0, abs=1e-12)  # a force along a line
    shoulder = np.array([0.0, 0.0, 0.4])
    np.testing.assert_allclose(np.cross(lost.place - shoulder, lost.force), -lost.moment, atol=1e-9)


def test_an_aligned_wrist_is_told_by_the_line_that_it_cannot_push_along():
    """All axes but the first and the fifth are parallel: the line along them that meets these."""
    data = ur5(WRIST_ALIGNED)
    (words,) = lost_motions(data)["arm"]
    (lost,) = lost_directions(data, "arm")
    axis = tip_terms(data).J[3:, 1]
    assert angle_between(lost.force, axis) < 1e-6
    x, y, z = np.round(-axis, 2)
    assert words.startswith(f"no motion along ({x:.2f}, {y:.2f}, {z + 0.0:.2f}) ")
    beside = np.linalg.norm(lost.moment) / np.linalg.norm(lost.force)
    assert words.endswith(f" {beside:.2f} m off the tip")


def test_a_screw_is_told_with_its_pitch():
    data = ur5([0.2, -1.0, 0.0, 0.5, -0.6, 0.4])
    (lost,) = lost_directions(data, "arm")
    pitch = lost.force @ lost.moment / (lost.force @ lost.force)
    x, y, z = lost.force * np.sign(lost.force[0]) / np.linalg.norm(lost.force)
    assert abs(pitch) > 0.1
    assert lost.words == f"no screw along ({x:.2f}, {y:.2f}, {z:.2f}), {pitch:.2f} m a radian"


def test_near_a_singular_posture_little_motion_is_left():
    shares = []
    for bend in (1e-2, 1e-3, 1e-4):
        (lost,) = lost_directions(ur5([*STRETCHED[:2], bend, *STRETCHED[3:]]), "arm")
        assert lost.words == "little motion along its own reach"
        shares.append(lost.share)
    np.testing.assert_allclose(np.divide(shares[:2], shares[1:]), 10.0, rtol=0.05)
    assert lost_motions(ur5([*STRETCHED[:2], 0.1, *STRETCHED[3:]])) == {"arm": ()}


def test_a_planar_arm_of_three_joints_has_no_motion_out_of_its_plane():
    """Three constraints, three joints, and none of them helps."""
    data = one_arm("planar_3r", "tip", [0.3, 0.5, 0.4], {"kind": "planar", "normal": [0, 0, 1]})
    assert lost_motions(data)["arm"] == (
        "no motion along world z",
        "no turn about world x",
        "no turn about world y",
    )


@pytest.mark.parametrize(
    ("joint", "posture", "words"),
    [
        (WELD, [0.3, 0.8], ("its 2 joints leave 4 of 6 directions without motion",)),
        (BALL, [0.3, 0.8], ("its 2 joints leave 1 of 3 directions without motion",)),
        (
            BALL,
            [0.3, 0.0],
            (
                "its 2 joints leave 2 of 3 directions without motion",
                "no motion along its own reach",
            ),
        ),
    ],
    ids=["weld", "ball", "stretched, ball"],
)
def test_too_few_joints_are_counted_against_the_directions(joint, posture, words):
    data = one_arm("planar_2r", "tip", posture, joint)
    assert lost_motions(data) == {"arm": words}


def test_one_joint_is_spoken_of_as_one(tmp_path):
    words = lost_motions(placed(chain_scene(tmp_path, "z", WELD)))["arm"]
    assert words == ("its 1 joint leaves 5 of 6 directions without motion",)


def test_contacts_that_say_the_same_twice_are_named():
    data = placed(two_arm_block_twice())
    names = {arm: [c.name for c in data.model.contacts[arm]] for arm in data.model.arm_names}
    for arm, words in lost_motions(data).items():
        count = len(names[arm])
        first, last = names[arm][0], names[arm][-1]
        assert words == (f"1 of {count} contacts too many among '{first}', '{last}'",)
        combination = np.zeros((count, 1))
        combination[[0, -1], 0] = [1.0, -1.0]
        assert describe(data, arm, combination) == ("contacts that say the same twice",)


def test_only_the_arms_asked_for_are_looked_at():
    data = placed(panda_trio(WELD))
    assert list(lost_motions(data)) == list(data.model.arm_names)
    assert list(lost_motions(data, [data.model.arm_names[1]])) == [data.model.arm_names[1]]
    assert not any(lost_motions(data).values())


# --- words for given directions ------------------------------------------------------------------


def test_words_for_a_null_vector_are_those_of_the_lost_direction():
    data = ur5(STRETCHED)
    W = data.work.W[0, :6, :6]
    combination = np.linalg.svd(W)[2][-1:].T
    assert describe(data, "arm", combination) == lost_motions(data)["arm"]
    assert describe(data, "arm", -3.0 * combination) == lost_motions(data)["arm"]


def test_several_directions_are_described_by_named_axes_among_them():
    """Whatever basis of the lost directions is handed over, the words are of the same axes."""
    data = one_arm("planar_3r", "tip", [0.3, 0.5, 0.4], {"kind": "planar", "normal": [0, 0, 1]})
    turned = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    assert describe(data, "arm", turned) == lost_motions(data)["arm"]


def test_numbers_that_are_not_finite_get_words_too():
    data = ur5(STRETCHED)
    assert len(describe(data, "arm", np.full((6, 2), np.nan))) == 2


# --- any arm -------------------------------------------------------------------------------------


def chain_scene(folder, kinds, joint):
    path = folder / f"{kinds}.urdf"
    path.write_text(chain_urdf(kinds))
    arm = {"urdf": str(path), "tip": "tip", "posture": [0.2 * (k + 1) for k in range(len(kinds))]}
    return scene_of({"arm": arm}, [{"arm": "arm", **joint}], run={"solver": "dense"})


@pytest.mark.parametrize(
    "kinds", ["z", "u", "uv", "zu", "uvw", "xyz", "zyyzX", "zuyxyz", "zyyxyxz"]
)
@pytest.mark.parametrize(
    "joint",
    [WELD, BALL, {"kind": "revolute"}, {"kind": "prismatic"}, {"kind": "universal"}],
    ids=lambda joint: joint["kind"],
)
def test_lost_directions_have_no_power_and_none_is_missing(tmp_path, kinds, joint):
    """Slides, hinges, massless links, one joint to seven."""
    data = placed(chain_scene(tmp_path, kinds, joint))
    lost = lost_directions(data, "arm")
    words = lost_motions(data)["arm"]
    assert all(len(text) <= LONGEST for text in (*words, *(one.words for one in lost)))
    term, terms = contact_terms(data)["arm"], tip_terms(data)
    R = terms.tip_rotation
    felt = terms.J.T @ np.kron(np.eye(2), R) @ term.W_m  # (n, N) joint torques of every contact
    assert len(lost) == np.linalg.matrix_rank(term.W_m, 1e-9) - np.linalg.matrix_rank(felt, 1e-9)
    assert bool(words) == bool(lost)
    for one in lost:
        size = np.linalg.norm(np.concatenate([one.force, one.moment]))
        np.testing.assert_allclose(torques_of(data, one), 0.0, atol=1e-9 * size)
        # it is a wrench that the joint can transmit
        moment = one.moment + np.cross(one.place - terms.tip_position, one.force)
        wrench = np.concatenate([R.T @ one.force, R.T @ moment])
        left = wrench - term.W_m @ np.linalg.lstsq(term.W_m, wrench, rcond=None)[0]
        np.testing.assert_allclose(left, 0.0, atol=1e-9 * size)


@pytest.mark.parametrize("size", [0.02, 2.0])
def test_how_a_joint_is_made_of_contacts_does_not_matter(size):
    """The contacts of a weld stand far apart or close together."""
    bend = [*STRETCHED[:2], 1e-3, *STRETCHED[3:]]
    (usual,) = lost_directions(ur5(bend), "arm")
    (other,) = lost_directions(ur5(bend, {**WELD, "size": size}), "arm")
    assert other.words == usual.words
    assert other.share == pytest.approx(usual.share, rel=1e-6)


def test_the_reach_is_the_arms_own_wherever_the_arm_stands():
    for turn in ([0.0, 0.0, 0.0], [0.5, -0.8, 2.0]):
        base = {"xyz": [1.0, -2.0, 0.5], "rpy": turn}
        arm = {"robot": "ur5", "tip": "tool0", "posture": STRETCHED, "base": base}
        body = {"shape": {"box": [0.2, 0.3, 0.1]}, "mass": 2.0}
        scene = scene_of(
            {"arm": arm}, [{"arm": "arm", **WELD}], object=body, run={"solver": "dense"}
        )
        assert lost_motions(placed(scene)) == {"arm": ("no motion along its own reach",)}


def test_a_regular_posture_is_far_from_the_tolerance():
    """A redundant arm in its usual posture: ten times the tolerance and more."""
    joints = {"tip": "panda_hand_tcp", "posture": PANDA_POSTURE, "lock": PANDA_FINGERS}
    scene = scene_of(
        {"arm": {"robot": "panda", **joints}}, [{"arm": "arm", **WELD}],
        object={"shape": {"sphere": 0.1}, "mass": 1.0},
    )  # fmt: skip
    data = placed(scene)
    W = data.work.W[0, :7, :6]
    weakest = np.linalg.svd(W)[2][-1:].T
    assert lost_motions(data) == {"arm": ()}
    assert np.linalg.norm(W @ weakest) > 0.0
    singular = np.linalg.svd(tip_terms(data).J, compute_uv=False)
    assert singular[-1] / singular[0] > 10 * LITTLE
