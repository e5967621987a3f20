"""Claims about trees of links: their structure and their table of joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from random_structures import (
    link_frames,
    pinocchio_model,
    random_parents,
    random_structure,
    random_tree,
)
from refusals import refused
from scipy.spatial.transform import Rotation

from multiarm.errors import ModelError
from multiarm.jit.rows import fields_of
from multiarm.robots.chain import ChainJoint, chain_joints, require_chain
from multiarm.robots.robot import Robot, RobotFiles

GRAVITY = np.array([1.0, -2.0, -9.0])


def tables_of(tree) -> ChainJoint:
    return fields_of(ChainJoint, chain_joints(tree))


def poses_from_table(tree, q) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poses of the links by the table of joints: z turned or slid, by the parent."""
    joints, frames, z = tables_of(tree), [], np.array([0.0, 0.0, 1.0])
    for k, parent in enumerate(tree.parents):
        R, p = frames[parent] if parent >= 0 else (np.eye(3), tree.translations[0])
        p, R = p + R @ joints.offset[k], R @ joints.axes[k]
        p = p + joints.slides[k] * q[k] * R @ z
        R = R @ Rotation.from_rotvec(joints.turns[k] * q[k] * z).as_matrix()
        frames.append((R, p))
    return [(R @ link_axes, p) for (R, p), link_axes in zip(frames, joints.link_axes, strict=True)]


def test_structure_is_that_of_the_urdf(tmp_path, rng):
    parents = [-1, 0, 1, 1, 3, 0, -1, 6]
    (tmp_path / "tree.urdf").write_text(random_tree(rng, parents))
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.random(random_state=rng).as_matrix(), [0.3, -0.1, 2.0]
    arm = Robot("tree", RobotFiles(tmp_path / "tree.urdf", (), base, {"": "tip"}, {}))
    tree, numbers = arm.structure(), [int(name[1:]) - 1 for name in arm.joint_names]
    assert sorted(numbers) == list(range(len(parents)))
    before = [numbers[parent] if parent >= 0 else -1 for parent in tree.parents]
    assert before == [parents[number] for number in numbers]
    q, data = rng.uniform(-2, 2, arm.dof), arm.model.createData()
    pin.forwardKinematics(arm.model, data, arm.configuration(q))
    for (R, p), X in zip(link_frames(tree, q), data.oMi.tolist()[1:], strict=True):
        np.testing.assert_allclose(R, X.rotation, atol=1e-13)
        np.testing.assert_allclose(p, X.translation, atol=1e-13)


@pytest.mark.parametrize("joints", [1, 2, 5, 12])
def test_table_of_joints_places_the_links_as_pinocchio_does(joints, rng):
    for _ in range(5):
        tree = random_structure(rng, random_parents(rng, joints))
        q, model = rng.uniform(-2, 2, joints), pinocchio_model(tree, GRAVITY)
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        for (R, p), X in zip(poses_from_table(tree, q), data.oMi.tolist()[1:], strict=True):
            np.testing.assert_allclose(R, X.rotation, atol=1e-13)
            np.testing.assert_allclose(p, X.translation, atol=1e-13)


def test_table_does_not_depend_on_where_the_tree_stands(rng):
    """Offsets are exact far from the world's origin: 2 ** 40 m and quarters are."""
    tree = random_structure(rng, [-1, 0, -1, 2, 0])
    tree.translations[[0, 2]] = [[0.25, 0.5, 0.0], [-0.75, 0.0, 1.25]]
    away = tree._replace(translations=tree.translations.copy())
    away.translations[[0, 2]] += 2.0**40
    np.testing.assert_array_equal(chain_joints(away), chain_joints(tree))


@pytest.mark.parametrize(
    ("parents", "tip_joint"), [([-1, 0, 0], 3), ([-1, -1], 2), ([-1, 0, 1, 1], 4), ([-1, 0, 1], 2)]
)
def test_what_is_no_chain_to_its_tip_is_refused(parents, tip_joint, rng):
    with refused(ModelError):
        require_chain(random_structure(rng, parents), tip_joint)


def test_a_chain_to_its_tip_is_passed_on(rng):
    chain = random_structure(rng, [-1, 0, 1])
    assert require_chain(chain, 3) is chain
