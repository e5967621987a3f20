"""Constants and workspace of compiled arms.

A link's frame is rotated so that its joint's axis is z; the axes of its URDF are kept as well.  The
first joint's origin is the base, to which all positions are relative.

Arms are batched by four, one in each lane of a SIMD pack.  A *block* is as long as the longest of
its arms; shorter ones are padded at the base with joints without motion and mass.  A lane without
an arm repeats the first arm of its block, and writes the same numbers to the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.arms.terms import ArmStructure
from multiarm.contacts.kernel import BODY_WIDTH
from multiarm.geometry.screws import skew
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.simd import LANES
from multiarm.jit.structs import Floats1, Floats2, Ints1, Ints2, view

# Arms with more joints are left to Pinocchio.
MOST_JOINTS = 16

# Columns of ArmTables.blocks: number of joints; first joint among those of all blocks; offset of
# the first arm's terms; offsets of Jacobian, bias, gravity torque, potential energy and poses in an
# arm's terms, and their size; the four arms' numbers in the scene.
JOINTS, FIRST, TERMS, JACOBIAN, BIAS, GRAVITY_TORQUE, ENERGY, POSES, WIDTH, PLACES = range(10)
BLOCK_COLUMNS = PLACES + LANES

# Constants of a joint, lanes each: axes (by columns) and origin of its frame in that of the joint
# before, centre, mass and inertia of its link, whether it turns and whether it slides, inertia of
# its drive, the link's URDF axes (by columns).
AXES, OFFSET, CENTRE, MASS, INERTIA, TURNS, SLIDES, ARMATURE, URDF_AXES = (
    0, 9, 12, 15, 16, 22, 23, 24, 25
)  # fmt: skip
JOINT_WIDTH = 34
# Results of the outward sweep for a joint, lanes each: its column, its link's inertia about the
# base (mass, first moment, second moments), the force that moves the link.
COLUMN, LINK_INERTIA, FORCE, LINK_WIDTH = 0, 6, 16, 22
# Results of the outward sweep for Coriolis forces, lanes each: rate of the column; momentum and
# matrix of :mod:`multiarm.arms.compiled.coriolis`.
COLUMN_RATE, MOMENTUM, MATRIX, TURN_WIDTH = 0, 6, 9, 18

# Entries of ArmTables.wanted.
WITH_GRAVITY_TORQUE, WITH_POSES, WANTED = range(3)


class ArmTables(NamedTuple):
    """Constants of compiled arms; ``J`` joints in all blocks, four lanes each.

    blocks : int64 (b, 13)
    sources : int64 (4 J,)
        Each lane's joint in the stacked vectors.
    joints, energies : int64 (arms,)
        Number of joints of each arm; offset of its potential energy in all terms.
    turns : (4 J,)
        1 for revolute joints, else 0.
    constants : (34 * 4 J,)
    bases : (b, 12)
        Positions of the arms' first joints in the world [m], lanes each.
    gravity : (3,)
    wanted : int64 (2,)
        Flags: write gravity torques, write poses of all links.
    """

    blocks: Ints2
    sources: Ints1
    joints: Ints1
    energies: Ints1
    turns: Floats1
    constants: Floats1
    bases: Floats2
    gravity: Floats1
    wanted: Ints1


class ArmWork(NamedTuple):
    """State and workspace of compiled arms.

    angles, rates : (joints,)
        Positions and velocities of the system's joints.
    bodies : (24 arms,)
        Motion of the links that carry the tips, see :mod:`multiarm.contacts.kernel`.
    angle, rate, sine, cosine : (4 J,)
        Of every lane's joint.
    links : (22 * 4 n,), link_turns : (18 * 4 n,), leaves : (4 w,)
        Scratch of one block: results of the outward sweeps; its arms' terms and bodies, lanes each.
    terms, coriolis : (4 w b,)
        Every arm's terms, see :func:`_block_columns`; matrices of Coriolis forces by columns, at
        the offsets of the inertias.
    """

    angles: Floats1
    rates: Floats1
    bodies: Floats1
    angle: Floats1
    rate: Floats1
    sine: Floats1
    cosine: Floats1
    links: Floats1
    link_turns: Floats1
    leaves: Floats1
    terms: Floats1
    coriolis: Floats1


_open_tables, _open_work = view(ArmTables), view(ArmWork, len(ArmTables._fields))


@inlined
def open_arms(struct):
    """Views ``tables, work`` of the struct of compiled arms."""
    return _open_tables(struct), _open_work(struct)


@kernel
def energy_of_arms(struct):
    """Potential energy of all compiled arms [J] at the state of the last sweep."""
    tables, work = open_arms(struct)
    energy = 0.0
    for k in range(tables.energies.size):
        energy += work.terms[tables.energies[k]]
    return energy


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
        Its first joint in the stacked vectors.
    gravity : ndarray, shape (3,)
    """
    blocks, sources, constants, bases = [], [], [], []
    energies = np.zeros(len(structures), dtype=np.int64)
    first = terms = 0
    for arms in _blocks([arm.masses.size for arm in structures]):
        joints = structures[arms[0]].masses.size
        block = _block_columns(joints)
        block[FIRST], block[TERMS] = first, terms
        block[PLACES : PLACES + LANES] = [places[arm] for arm in arms]
        for lane, arm in enumerate(arms[: len(set(arms))]):
            energies[arm] = terms + lane * block[WIDTH] + block[ENERGY]
        blocks.append(block)
        packed = [_packed(structures[arm], joints) for arm in arms]
        constants.append(np.stack(packed, axis=-1))
        bases.append(np.stack([structures[arm].translations[0] for arm in arms], axis=-1).ravel())
        sizes = [structures[arm].masses.size for arm in arms]
        sources.append(_sources(sizes, [first_joints[arm] for arm in arms]))
        first, terms = first + joints, terms + LANES * block[WIDTH]
    every = np.concatenate(constants)  # (J, 34, 4)
    return ArmTables(
        blocks=np.array(blocks),
        sources=np.concatenate(sources),
        joints=np.array([arm.masses.size for arm in structures]),
        energies=energies,
        turns=np.ascontiguousarray(every[:, TURNS]).ravel(),
        constants=every.ravel(),
        bases=np.array(bases),
        gravity=np.array(gravity, dtype=float),
        wanted=np.zeros(WANTED, dtype=np.int64),
    )


def make_terms(tables: ArmTables) -> np.ndarray:
    """Allocate one number for every term of all arms."""
    return np.zeros(LANES * int(np.sum(tables.blocks[:, WIDTH])))


def make_work(
    tables: ArmTables, angles: np.ndarray, rates: np.ndarray, bodies: np.ndarray,
    terms: np.ndarray, coriolis: np.ndarray,
) -> ArmWork:  # fmt: skip
    """Allocate the workspace; the other arrays are given."""
    longest, width = (int(np.max(tables.blocks[:, column])) for column in (JOINTS, WIDTH))
    lanes = np.zeros((4, tables.sources.size))
    return ArmWork(
        angles=angles,
        rates=rates,
        bodies=bodies.reshape(-1),
        angle=lanes[0],
        rate=lanes[1],
        sine=lanes[2],
        cosine=lanes[3],
        links=np.zeros(LANES * LINK_WIDTH * longest),
        link_turns=np.zeros(LANES * TURN_WIDTH * longest),
        leaves=np.zeros(LANES * (width + BODY_WIDTH)),
        terms=terms,
        coriolis=coriolis,
    )


def _block_columns(joints: int) -> np.ndarray:
    """Columns of a block of ``joints`` joints, except ``FIRST``, ``TERMS`` and ``PLACES``.

    The terms of an arm are its inertia (n, n), of which the lower triangle by rows is written;
    Jacobian (n, 6), a row a joint; bias (n,), gravity torque (n,); potential energy (1,); poses
    (n, 12), axes by columns and origin.
    """
    columns, n = np.zeros(BLOCK_COLUMNS, dtype=np.int64), joints
    columns[JOINTS], columns[JACOBIAN], columns[BIAS] = n, n * n, n * n + 6 * n
    columns[GRAVITY_TORQUE], columns[ENERGY] = n * n + 7 * n, n * n + 8 * n
    columns[POSES] = _rounded_up(n * n + 8 * n + 1)
    columns[WIDTH] = columns[POSES] + _rounded_up(12 * n)
    return columns


def _rounded_up(count: int) -> int:
    """The next multiple of the number of lanes."""
    return -(-count // LANES) * LANES


def _blocks(joints: Sequence[int]) -> list[list[int]]:
    """Four arms each, those with most joints first; the first of a block fills its free lanes."""
    order = sorted(range(len(joints)), key=lambda arm: -joints[arm])
    blocks = [order[k : k + LANES] for k in range(0, len(order), LANES)]
    return [block + [block[0]] * (LANES - len(block)) for block in blocks]


def _sources(joints: Sequence[int], first_joints: Sequence[int]) -> np.ndarray:
    """Joints of a block's lanes in the stacked vectors; padding reads an arm's first joint."""
    within_arm = np.arange(joints[0])[:, None] - (joints[0] - np.array(joints))
    return (np.maximum(within_arm, 0) + np.array(first_joints)).ravel().astype(np.int64)


def _packed(arm: ArmStructure, joints: int) -> np.ndarray:
    """Constants of one lane, shape (joints, 34), padded with joints without motion and mass."""
    packed = np.zeros((joints, JOINT_WIDTH))
    packed[:, [AXES, AXES + 4, AXES + 8, URDF_AXES, URDF_AXES + 4, URDF_AXES + 8]] = 1.0
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
        row[URDF_AXES : URDF_AXES + 9] = turned.ravel()
        before = turned
    return packed


def _turned_to_z(axis: np.ndarray) -> np.ndarray:
    """A rotation that takes z to the axis."""
    x = skew(np.eye(3)[np.argmin(np.abs(axis))]) @ axis
    x /= np.linalg.norm(x)
    return np.column_stack([x, skew(axis) @ x, axis])
