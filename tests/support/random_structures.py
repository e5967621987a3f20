"""Random trees of links: as URDF, as structures, and as Pinocchio's models of the structures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from multiarm.robots.terms import TreeStructure


def random_parents(rng, joints: int, branching: float = 0.4) -> list[int]:
    """Parents of a tree's joints, as :class:`multiarm.robots.terms.TreeStructure` has them.

    A branch is complete before the next one begins: Pinocchio relies on this order.
    """
    parents = [-1]
    for k in range(1, joints):
        parent = k - 1
        while parent >= 0 and rng.random() < branching:
            parent = parents[parent]
        parents.append(parent)
    return parents


def random_tree(rng, parents: Sequence[int], massless: float = 0.2) -> str:
    """A URDF of hinges and slides about any axes, some of whose inner links have no mass.

    Joint ``j{k + 1}`` carries link ``l{k + 1}``; its parent is link ``l{parents[k] + 1}``, ``l0``
    the root.  The frame ``tip`` is fixed on the last link.
    """
    text, joints = "<link name='l0'/>", len(parents)
    numbers = lambda size, count: words(rng.uniform(-size, size, count))  # noqa: E731
    for k, parent in enumerate(parents):
        heavy = k not in parents or rng.random() > massless
        kind = rng.choice(["revolute", "continuous", "prismatic"])
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else rng.standard_normal(3)
        text += (
            f"<link name='l{k + 1}'>{random_inertial(rng) if heavy else ''}</link>"
            f"<joint name='j{k + 1}' type='{kind}'><parent link='l{parent + 1}'/>"
            f"<child link='l{k + 1}'/><origin xyz='{numbers(0.5, 3)}' rpy='{numbers(3.0, 3)}'/>"
            f"<axis xyz='{words(axis)}'/><limit lower='-9' upper='9' effort='9' velocity='9'/>"
            "</joint>"
        )
    text += (
        f"<link name='tip'/><joint name='to_tip' type='fixed'><parent link='l{joints}'/>"
        "<child link='tip'/><origin xyz='0.1 0 0.2' rpy='0.3 0 0.5'/></joint>"
    )
    return f"<robot name='tree'>{text}</robot>"


def random_inertial(rng) -> str:
    axes = Rotation.random(random_state=rng).as_matrix()
    arms = rng.uniform(0.02, 0.3, 3)
    mass = 10.0 ** rng.uniform(-2, 2)
    moments = axes @ np.diag(mass * (np.sum(arms**2) - arms**2)) @ axes.T
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    entries = zip(names, moments[np.triu_indices(3)], strict=True)
    return (
        f"<inertial><origin xyz='{words(rng.uniform(-0.3, 0.3, 3))}'/><mass value='{mass!r}'/>"
        f"<inertia {' '.join(f'{name}={str(float(v))!r}' for name, v in entries)}/></inertial>"
    )


def words(numbers) -> str:
    return " ".join(repr(float(x)) for x in numbers)


def random_structure(rng, parents: Sequence[int]) -> TreeStructure:
    joints = len(parents)
    axes = rng.standard_normal((joints, 3))
    moments = []
    for _ in range(joints):
        turn, size = Rotation.random(random_state=rng).as_matrix(), rng.uniform(0.05, 0.2, 3)
        moments.append(turn @ np.diag(np.sum(size**2) - size**2) @ turn.T)
    return TreeStructure(
        parents=np.array(parents, dtype=np.int64),
        slides=rng.random(joints) < 0.4,
        floats=np.zeros(joints, dtype=bool),
        axes=axes / np.linalg.norm(axes, axis=1)[:, None],
        rotations=Rotation.random(joints, random_state=rng).as_matrix(),
        translations=rng.uniform(-0.4, 0.4, (joints, 3)),
        masses=rng.uniform(0.1, 5.0, joints),
        centres=rng.uniform(-0.2, 0.2, (joints, 3)),
        inertias=np.array(moments),
        armature=rng.uniform(0.0, 0.3, joints),
    )


def pinocchio_model(tree: TreeStructure, gravity: np.ndarray) -> pin.Model:
    """The tree in Pinocchio; its joints keep their order, counted from 1 as Pinocchio does."""
    model = pin.Model()
    for k, parent in enumerate(tree.parents):
        motion = (
            pin.JointModelPrismaticUnaligned if tree.slides[k] else pin.JointModelRevoluteUnaligned
        )
        place = pin.SE3(tree.rotations[k], tree.translations[k])
        joint = model.addJoint(int(parent) + 1, motion(tree.axes[k]), place, f"joint_{k}")
        link = pin.Inertia(tree.masses[k], tree.centres[k], tree.inertias[k])
        model.appendBodyToJoint(joint, link, pin.SE3.Identity())
    model.gravity.linear = gravity
    model.armature = tree.armature
    return model


def link_frames(tree: TreeStructure, q) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotation and origin of every link in the world, as a textbook draws them."""
    frames = []
    for k, parent in enumerate(tree.parents):
        R, p = frames[parent] if parent >= 0 else (np.eye(3), np.zeros(3))
        p, R = p + R @ tree.translations[k], R @ tree.rotations[k]
        if tree.slides[k]:
            p = p + R @ (q[k] * tree.axes[k])
        else:
            R = R @ Rotation.from_rotvec(q[k] * tree.axes[k]).as_matrix()
        frames.append((R, p))
    return frames
