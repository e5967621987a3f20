"""From the structure of arms to the tables of their sweeps.

A link's frame is turned so that its joint's axis is z; the axes that its model names are kept
beside.  The first joint's origin stands for the base: all positions are relative to it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multiarm.arms.compiled.arrays import (
    ARMATURE,
    AXES,
    CENTRE,
    ENERGY,
    FIRST,
    INERTIA,
    JOINT_WIDTH,
    MASS,
    NAMED_AXES,
    OFFSET,
    PLACES,
    SLIDES,
    TERMS,
    TURNS,
    WANTED,
    WIDTH,
    ArmTables,
    block_columns,
)
from multiarm.arms.terms import ArmStructure
from multiarm.jit.simd import LANES
from multiarm.spatial import skew

# More joints an arm are left to Pinocchio.
MOST_JOINTS = 16


def make_tables(
    structures: Sequence[ArmStructure],
    places: Sequence[int],
    first_joints: Sequence[int],
    gravity: np.ndarray,
) -> ArmTables:
    """Tables of compiled arms.

    Parameters
    ----------
    structures : sequence of ArmStructure
    places : sequence of int
        Each arm's number among all arms of the scene.
    first_joints : sequence of int
        Where its joints begin in the stacked vectors.
    gravity : ndarray, shape (3,)
    """
    blocks, sources, constants, bases = [], [], [], []
    energies = np.zeros(len(structures), dtype=np.int64)
    first = terms = 0
    for arms in _blocks([own.masses.size for own in structures]):
        joints = structures[arms[0]].masses.size
        block = block_columns(joints)
        block[FIRST], block[TERMS] = first, terms
        block[PLACES : PLACES + LANES] = [places[arm] for arm in arms]
        for lane, arm in enumerate(arms[: len(set(arms))]):
            energies[arm] = terms + lane * block[WIDTH] + block[ENERGY]
        blocks.append(block)
        packed = [_packed(structures[arm], joints) for arm in arms]
        constants.append(np.stack(packed, axis=-1))
        bases.append(np.stack([structures[arm].translations[0] for arm in arms], axis=-1).ravel())
        own = [structures[arm].masses.size for arm in arms]
        sources.append(_sources(own, [first_joints[arm] for arm in arms]))
        first, terms = first + joints, terms + LANES * block[WIDTH]
    every = np.concatenate(constants)  # (J, 34, 4)
    return ArmTables(
        blocks=np.array(blocks),
        sources=np.concatenate(sources),
        joints=np.array([own.masses.size for own in structures]),
        energies=energies,
        turns=np.ascontiguousarray(every[:, TURNS]).ravel(),
        constants=every.ravel(),
        bases=np.array(bases),
        gravity=np.array(gravity, dtype=float),
        wanted=np.zeros(WANTED, dtype=np.int64),
    )


def lane_of(tables: ArmTables, place: int) -> tuple[np.ndarray, int]:
    """Block and lane of the arm with a number among all arms."""
    for block in tables.blocks:
        found = np.flatnonzero(block[PLACES : PLACES + LANES] == place)
        if found.size:
            return block, int(found[0])
    raise AssertionError("an arm that is not compiled has no lane")


def _blocks(joints: Sequence[int]) -> list[list[int]]:
    """Four arms at a time, those with most joints first; the first fills what is left over."""
    order = sorted(range(len(joints)), key=lambda arm: -joints[arm])
    blocks = [order[k : k + LANES] for k in range(0, len(order), LANES)]
    return [block + [block[0]] * (LANES - len(block)) for block in blocks]


def _sources(joints: Sequence[int], first_joints: Sequence[int]) -> np.ndarray:
    """Joints of a block's lanes in the stacked vectors; those that stand before read the first."""
    own = np.arange(joints[0])[:, None] - (joints[0] - np.array(joints))
    return (np.maximum(own, 0) + np.array(first_joints)).ravel().astype(np.int64)


def _packed(arm: ArmStructure, joints: int) -> np.ndarray:
    """Constants of one lane, shape (joints, 34), joints without motion and mass before its own."""
    packed = np.zeros((joints, JOINT_WIDTH))
    packed[:, [AXES, AXES + 4, AXES + 8, NAMED_AXES, NAMED_AXES + 4, NAMED_AXES + 8]] = 1.0
    before = np.eye(3)
    for k, row in enumerate(packed[joints - arm.masses.size :]):
        turned = _turned_to_z(arm.axes[k])
        axes = before.T @ arm.rotations[k] @ turned
        inertia = turned.T @ arm.inertias[k] @ turned
        row[AXES : AXES + 9] = axes.T.ravel()
        row[OFFSET : OFFSET + 3] = before.T @ arm.translations[k] if k > 0 else 0.0
        row[CENTRE : CENTRE + 3] = turned.T @ arm.centres[k]
        row[MASS], row[ARMATURE] = arm.masses[k], arm.armature[k]
        row[INERTIA : INERTIA + 6] = inertia[np.triu_indices(3)]
        row[TURNS], row[SLIDES] = not arm.slides[k], arm.slides[k]
        row[NAMED_AXES : NAMED_AXES + 9] = turned.ravel()
        before = turned
    return packed


def _turned_to_z(axis: np.ndarray) -> np.ndarray:
    """A rotation that takes z to the axis."""
    x = skew(np.eye(3)[np.argmin(np.abs(axis))]) @ axis
    x /= np.linalg.norm(x)
    return np.column_stack([x, skew(axis) @ x, axis])
