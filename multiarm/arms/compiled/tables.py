"""Constants and workspace of compiled arms, chains of :mod:`multiarm.arms.chain`.

Arms are batched by four, one in each lane of a SIMD pack.  A *block* is as long as the longest of
its arms; shorter ones are padded at the base with joints without motion and mass.  A lane without
an arm repeats the first arm of its block, and writes the same numbers to the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiarm.arms.chain import ChainJoint, chain_joints, joints_at_rest
from multiarm.arms.terms import POSE_WIDTH, ArmStructure, LinkPose
from multiarm.contacts.motion import BODY_WIDTH, BodyMotion
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.rows import Axes, Number, Pair, Symmetric, Vector, fields_of, lanes_of, width
from multiarm.jit.simd import LANES
from multiarm.jit.structs import Flag, Floats1, Floats2, Ints1, Ints2, Numbers, view

# Arms with more joints are left to Pinocchio.
MOST_JOINTS = 16


class LinkSweep(NamedTuple):
    """Results of the outward sweep for a joint and its link, about the base."""

    column: Pair
    mass: Number
    moment: Vector  # first moment
    second: Symmetric  # second moments
    force: Pair  # that moves the link


class TurnSweep(NamedTuple):
    """Results of the outward sweep for Coriolis forces."""

    column_rate: Pair
    momentum: Vector  # linear
    turning: Axes  # the matrix G


class JacobianColumn(NamedTuple):
    """The column of a joint about the world's origin."""

    column: Pair


JACOBIAN_WIDTH = width(JacobianColumn)
JOINT_LANES, LINK_LANES, TURN_LANES, JACOBIAN_LANES, POSE_LANES = (
    LANES * width(kind) for kind in (ChainJoint, LinkSweep, TurnSweep, JacobianColumn, LinkPose)
)
open_joint, open_link, open_turn = lanes_of(ChainJoint), lanes_of(LinkSweep), lanes_of(TurnSweep)
open_jacobian, open_pose, open_body = (
    lanes_of(JacobianColumn), lanes_of(LinkPose), lanes_of(BodyMotion)
)  # fmt: skip


class Wanted(Numbers):
    """What the sweeps write beside what every evaluation needs."""

    gravity_torque: Flag
    poses: Flag  # of all links


class ArmTables(NamedTuple):
    """Constants of compiled arms; ``b`` blocks, ``J`` joints in all of them, four lanes each.

    block_joints, first_joint : int64 (b,)
        Number of joints of each block; its first joint among those of all blocks.
    arms : int64 (b, 4)
        Numbers in the scene of a block's arms.
    first_term, term_count : int64 (b,)
        Offset of the terms of a block's first arm; their number, the same for each of its arms.
    jacobian, bias, gravity_torque, energy, poses : int64 (b,)
        Offsets in an arm's terms, which are its inertia (n, n), of which the lower triangle by rows
        is written; Jacobian (n, 6), a row a joint; bias (n,), gravity torque (n,); potential energy
        (1,); poses (n, 12).
    sources : int64 (4 J,)
        Each lane's joint in the stacked vectors.
    joints, energies : int64 (arms,)
        Number of joints of each arm; offset of its potential energy in all terms.
    turns : (4 J,)
        1 for revolute joints, else 0.
    constants : (34 * 4 J,)
        Of every :class:`multiarm.arms.chain.ChainJoint`, lanes each.
    bases : (b, 12)
        Positions of the arms' first joints in the world [m], lanes each.
    gravity : (3,)
    wanted : Wanted
    """

    block_joints: Ints1
    first_joint: Ints1
    arms: Ints2
    first_term: Ints1
    term_count: Ints1
    jacobian: Ints1
    bias: Ints1
    gravity_torque: Ints1
    energy: Ints1
    poses: Ints1
    sources: Ints1
    joints: Ints1
    energies: Ints1
    turns: Floats1
    constants: Floats1
    bases: Floats2
    gravity: Floats1
    wanted: Wanted


class ArmWork(NamedTuple):
    """State and workspace of compiled arms.

    angles, rates : (joints,)
        Positions and velocities of the system's joints.
    bodies : (24 arms,)
        Motion of the links that carry the tips, see :class:`multiarm.contacts.motion.BodyMotion`.
    angle, rate, sine, cosine : (4 J,)
        Of every lane's joint.
    links : (22 * 4 n,), link_turns : (18 * 4 n,), leaves : (4 w,)
        Scratch of one block: every :class:`LinkSweep` and :class:`TurnSweep`; its arms' terms and
        bodies, lanes each.
    terms, coriolis : (4 w b,)
        Every arm's terms, see :class:`ArmTables`; matrices of Coriolis forces by columns, at the
        offsets of the inertias.
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
    in_blocks = _blocks([arm.masses.size for arm in structures])
    joints = np.array([structures[arms[0]].masses.size for arms in in_blocks])
    offsets = _term_offsets(joints)
    first_term = LANES * np.cumsum([0, *offsets["term_count"][:-1]])
    sources, constants, bases = [], [], []
    energies = np.zeros(len(structures), dtype=np.int64)
    for b, arms in enumerate(in_blocks):
        for lane, arm in enumerate(arms[: len(set(arms))]):
            energies[arm] = first_term[b] + lane * offsets["term_count"][b] + offsets["energy"][b]
        padded = [_padded(structures[arm], joints[b]) for arm in arms]
        constants.append(np.stack(padded, axis=-1))
        bases.append(np.stack([structures[arm].translations[0] for arm in arms], axis=-1).ravel())
        sizes = [structures[arm].masses.size for arm in arms]
        sources.append(_sources(sizes, [first_joints[arm] for arm in arms]))
    every = np.concatenate(constants)  # (J, 34, 4)
    turns = fields_of(ChainJoint, every.swapaxes(1, 2)).turns
    return ArmTables(
        block_joints=joints,
        first_joint=np.cumsum([0, *joints[:-1]]),
        arms=np.array([[places[arm] for arm in arms] for arms in in_blocks]),
        first_term=first_term,
        **offsets,
        sources=np.concatenate(sources),
        joints=np.array([arm.masses.size for arm in structures]),
        energies=energies,
        turns=np.ascontiguousarray(turns).ravel(),
        constants=every.ravel(),
        bases=np.array(bases),
        gravity=np.array(gravity, dtype=float),
        wanted=Wanted(),
    )


def make_terms(tables: ArmTables) -> np.ndarray:
    """Allocate one number for every term of all arms."""
    return np.zeros(LANES * int(np.sum(tables.term_count)))


def make_work(
    tables: ArmTables, angles: np.ndarray, rates: np.ndarray, bodies: np.ndarray,
    terms: np.ndarray, coriolis: np.ndarray,
) -> ArmWork:  # fmt: skip
    """Allocate the workspace; the other arrays are given."""
    longest, terms_of_arm = int(np.max(tables.block_joints)), int(np.max(tables.term_count))
    lanes = np.zeros((4, tables.sources.size))
    return ArmWork(
        angles=angles,
        rates=rates,
        bodies=bodies.reshape(-1),
        angle=lanes[0],
        rate=lanes[1],
        sine=lanes[2],
        cosine=lanes[3],
        links=np.zeros(LINK_LANES * longest),
        link_turns=np.zeros(TURN_LANES * longest),
        leaves=np.zeros(LANES * (terms_of_arm + BODY_WIDTH)),
        terms=terms,
        coriolis=coriolis,
    )


def _term_offsets(n: np.ndarray) -> dict[str, np.ndarray]:
    """Offsets in the terms of arms with so many joints, and their number."""
    ends = np.cumsum([n * n, JACOBIAN_WIDTH * n, n, n, np.ones_like(n)], axis=0)
    poses = _rounded_up(ends[4])
    return {
        "jacobian": ends[0],
        "bias": ends[1],
        "gravity_torque": ends[2],
        "energy": ends[3],
        "poses": poses,
        "term_count": poses + _rounded_up(POSE_WIDTH * n),
    }


def _rounded_up(count: np.ndarray) -> np.ndarray:
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


def _padded(arm: ArmStructure, joints: int) -> np.ndarray:
    """Constants of one lane, shape (joints, 34), padded at the base."""
    return np.vstack([joints_at_rest(joints - arm.masses.size), chain_joints(arm)])
