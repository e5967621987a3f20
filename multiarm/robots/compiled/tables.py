"""Constants and workspace of compiled robots, trees of :mod:`multiarm.robots.chain`.

Branches are batched by four (:mod:`multiarm.robots.compiled.branches`), one in each lane of a SIMD
pack.  A *block* is as long as the longest of its branches; shorter ones are padded at their
beginning with joints without motion and mass.  A lane without a branch repeats the first branch of
its block; what it computes is not used.

Results of a block stand in *leaves*, lanes each.  Those of a block of plain arms are arranged as
an arm's terms are, and are transposed to them; from other groups every number goes where it belongs
by a list of *moves*.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import BodyMotion
from multiarm.jit.kernels import inlined, kernel
from multiarm.jit.rows import Axes, Number, Pair, Symmetric, Vector, lanes_of, offset_of, width
from multiarm.jit.simd import LANES, aligned_zeros
from multiarm.jit.structs import (
    Flag,
    Floats1,
    Floats2,
    Int,
    Ints1,
    Ints2,
    Numbers,
    count_entries,
    view,
)
from multiarm.robots.chain import ChainJoint
from multiarm.robots.terms import FACTOR_WIDTH, JointFactor, LinkPose

# At what the branches of a block begin.
FIXED_BASE, FLOATING_BASE, LINK = 0, 1, 2
# Robots with more joints between base and a link are left to Pinocchio.
MOST_JOINTS = 16


class LinkSweep(NamedTuple):
    """Results of the outward sweep for a joint and its link, about the base.

    From ``mass`` on, the sums over what branches from the link are added inwards.
    """

    column: Pair
    mass: Number
    moment: Vector  # first moment
    second: Symmetric  # second moments
    force: Pair  # that moves the link


class TurnSweep(NamedTuple):
    """Results of the outward sweep for Coriolis forces; from ``momentum`` on as in LinkSweep."""

    column_rate: Pair
    momentum: Vector  # linear
    turning: Axes  # the matrix G


class ArticulatedBody(NamedTuple):
    """Inertia of the body that begins at a link and is articulated beyond it, about the base.

    A twist (v, omega) has the momentum ``linear v + coupling omega``, and about the base
    ``coupling^T v + angular omega``.
    """

    linear: Symmetric
    coupling: Axes  # by columns
    angular: Symmetric


class FrameSweep(NamedTuple):
    """Where the outward sweep stands: frame and motion of a joint, about the base."""

    axes: Axes
    origin: Vector
    twist: Pair
    rate: Pair  # of the twist


class JacobianColumn(NamedTuple):
    """The column of a joint about the world's origin."""

    column: Pair


JACOBIAN_WIDTH = width(JacobianColumn)
JOINT_LANES, LINK_LANES, TURN_LANES, FRAME_LANES, JACOBIAN_LANES, POSE_LANES, BODY_LANES = (
    LANES * width(kind)
    for kind in (ChainJoint, LinkSweep, TurnSweep, FrameSweep, JacobianColumn, LinkPose, BodyMotion)
)
ARTICULATED_LANES, FACTOR_LANES = LANES * width(ArticulatedBody), LANES * FACTOR_WIDTH
# Where the numbers begin that are summed inwards.
LINK_SUMS, TURN_SUMS = offset_of(LinkSweep, "mass"), offset_of(TurnSweep, "momentum")
# Where the parts of a frame begin.
FRAME_AXES, FRAME_ORIGIN, FRAME_TWIST, FRAME_RATE = (
    offset_of(FrameSweep, name) for name in ("axes", "origin", "twist", "rate")
)
open_joint, open_link, open_turn = lanes_of(ChainJoint), lanes_of(LinkSweep), lanes_of(TurnSweep)
open_frame, open_jacobian, open_pose, open_body = (
    lanes_of(FrameSweep), lanes_of(JacobianColumn), lanes_of(LinkPose), lanes_of(BodyMotion)
)  # fmt: skip
open_articulated, open_factor = lanes_of(ArticulatedBody), lanes_of(JointFactor)


class Wanted(Numbers):
    """What the sweeps write beside what every evaluation needs."""

    gravity_torque: Flag
    poses: Flag  # of all links
    factors: Flag  # of the inertias of robots that are no plain arms
    inertias: Flag  # themselves; those of plain arms always are


class TermOffsets(NamedTuple):
    """Where the terms of a robot are among those of all, in numbers; a row of int64.

    Of its inertia (n, n), the lower triangle by rows; Jacobian (n, 6), a row a joint; bias and
    gravity torque (n,); potential energy, the sum of so many numbers; poses of all links (l, 12);
    factors of the inertia (n, 13), which plain arms do without.
    A floating base has six of the n numbers of a velocity, and one of the l links.
    """

    joints: Number  # n
    links: Number
    inertia: Number
    stride: Number  # of the inertia
    jacobian: Number
    bias: Number
    gravity_torque: Number
    energy: Number
    energies: Number
    poses: Number
    factors: Number  # 0 for plain arms


class Moves(NamedTuple):
    """Where the leaves of each group go; lanes without a place go to the last four numbers.

    quads, places : int64 (m,), (m, 4)
        Four packs that follow each other in the leaves, and a place for each lane's four numbers.
    sources, targets : int64 (k,)
        Single numbers of the leaves, and their places.
    first_quad, first_single : int64 (g + 1,)
        The first ones of each group.
    """

    quads: Ints1
    places: Ints2
    sources: Ints1
    targets: Ints1
    first_quad: Ints1
    first_single: Ints1


class Motions(NamedTuple):
    """Bodies of each group: the first numbers of a lane of leaves, and of a row of the bodies.

    first : int64 (g + 1,)
        The first one of each group.
    """

    sources: Ints1
    targets: Ints1
    first: Ints1


class Blocks(NamedTuple):
    """The ``b`` blocks; a *place* is a lane of a row of scratch, four times the row plus the lane.

    joints, first_joint : int64 (b,)
        Number of joints; the first one among those of all blocks.
    ancestors, lineage, first_ancestor : int64 (b,), (a, 4), (b,)
        How many joints are before the longest way of a lane's branch; the places of each lane's,
        from the base on, and the block's first one.  Shorter ways repeat their first one.
    start : int64 (b,)
        At what its branches begin: ``FIXED_BASE``, ``FLOATING_BASE`` (the block is that of these
        bases), or ``LINK``.
    base_columns : int64 (b,)
        Columns of its inertia for a floating base, 6 or 0.
    base, base_rate : int64 (b, 4)
        Number of each lane's floating base, and of the first of its rates.
    parents : int64 (b, 4)
        Place of the link at which each lane's branch begins.
    branches : int64 (b,)
        Number of lanes that have one.
    first_link : int64 (b,)
        Its first row of scratch; copies of the ancestors are before the joints.
    inertia, jacobian, bias, gravity_torque, energy, poses, factors, motions : int64 (b,)
        Offsets in a lane's leaves: with n joints, a ancestors and b columns of a floating base,
        inertia (n, b + a + n), motions of the links that take part in connections; the rest as in
        :class:`TermOffsets`.
    """

    joints: Ints1
    first_joint: Ints1
    ancestors: Ints1
    lineage: Ints2
    first_ancestor: Ints1
    start: Ints1
    base_columns: Ints1
    base: Ints2
    base_rate: Ints2
    parents: Ints2
    branches: Ints1
    first_link: Ints1
    inertia: Ints1
    jacobian: Ints1
    bias: Ints1
    gravity_torque: Ints1
    energy: Ints1
    poses: Ints1
    factors: Ints1
    motions: Ints1


class Groups(NamedTuple):
    """The ``g`` groups.

    first_block : int64 (g + 1,)
        Of each group among all blocks.
    plain, floats : int64 (g,)
        Whether it is a block of plain arms, which has no moves; whether its bases float, so that
        the first block is that of these bases.
    first_term, term_count : int64 (g,)
        Of plain arms: offset of the terms of the first one; their number, the same for each.
    bodies : int64 (g, 4)
        Of plain arms: rows of the bodies.
    terms, gravity_torques, inertias, factors, poses, coriolis : Moves
        To the terms: those of all evaluations, and those that are not always wanted; to the
        matrices of Coriolis forces.
    motions : Motions
        To the bodies.
    """

    first_block: Ints1
    plain: Ints1
    floats: Ints1
    first_term: Ints1
    term_count: Ints1
    bodies: Ints2
    terms: Moves
    gravity_torques: Moves
    inertias: Moves
    factors: Moves
    poses: Moves
    coriolis: Moves
    motions: Motions


class Sizes(NamedTuple):
    """Rows of scratch and leaves of the largest group; terms of all robots, four numbers more."""

    rows: Int
    leaves: Int
    terms: Int


class RobotTables(NamedTuple):
    """Constants of compiled robots; ``b`` blocks, ``J`` joints in all of them, four lanes each.

    robots : int64 (robots, 11)
        The :class:`TermOffsets` of each robot.
    energies : int64 (e,)
        Offsets of all potential energies.
    sources : int64 (4 J,)
        Each lane's joint in the stacked vectors.
    divides : int64 (J,)
        Whether branches begin at a joint's link.
    carries : int64 (J,)
        Number of the joint's link among those of its block that take part in connections, or -1.
    turns : (4 J,)
        1 for revolute joints, else 0.
    constants : (34 * 4 J,)
        Of every :class:`multiarm.robots.chain.ChainJoint`, lanes each.
    bases : (b, 12)
        Positions of the robots' first joints in the world [m], lanes each, where they are fixed.
    gravity : (3,)
    sizes : Sizes
    wanted : Wanted
    """

    blocks: Blocks
    groups: Groups
    robots: Ints2
    energies: Ints1
    sources: Ints1
    divides: Ints1
    carries: Ints1
    turns: Floats1
    constants: Floats1
    bases: Floats2
    gravity: Floats1
    sizes: Sizes
    wanted: Wanted


class RobotWork(NamedTuple):
    """State and workspace of compiled robots.

    angles, rates : (joints,)
        Positions and velocities of the system's joints.
    base_poses : (B, 7)
        Poses of the system's floating bases.
    bodies : (24 B,)
        Motion of the links that take part in connections, see
        :class:`multiarm.contacts.motion.BodyMotion`.
    angle, rate, sine, cosine : (4 J,)
        Of every lane's joint.
    links, link_turns, frames, articulated : (4 w r,)
        Scratch of a group, rows of w lanes: every :class:`LinkSweep`, :class:`TurnSweep` and, where
        branches begin, :class:`FrameSweep` and :class:`ArticulatedBody`.
    origins : (b, 12)
        Points about which moments are [m], lanes each: of floating bases where they are.
    start, link_sum, turn_sum, articulated_sum : (4 w,)
        Scratch of a block: where its lanes begin; what they add to the links where they begin.
    leaves : (4 l,)
        Scratch of a group: its blocks' terms and bodies, lanes each.
    terms, coriolis : (t,)
        Every robot's terms, see :class:`TermOffsets`; matrices of Coriolis forces by columns, at
        the offsets of the inertias.
    """

    angles: Floats1
    rates: Floats1
    base_poses: Floats2
    bodies: Floats1
    angle: Floats1
    rate: Floats1
    sine: Floats1
    cosine: Floats1
    links: Floats1
    link_turns: Floats1
    frames: Floats1
    articulated: Floats1
    origins: Floats2
    start: Floats1
    link_sum: Floats1
    turn_sum: Floats1
    articulated_sum: Floats1
    leaves: Floats1
    terms: Floats1
    coriolis: Floats1


_open_tables, _open_work = view(RobotTables), view(RobotWork, count_entries(RobotTables))


@inlined
def open_robots(struct):
    """Views ``tables, work`` of the struct of compiled robots."""
    return _open_tables(struct), _open_work(struct)


@kernel
def energy_of_robots(struct):
    """Potential energy of all compiled robots [J] at the state of the last sweep."""
    tables, work = open_robots(struct)
    energy = 0.0
    for k in range(tables.energies.size):
        energy += work.terms[tables.energies[k]]
    return energy


def make_terms(tables: RobotTables) -> np.ndarray:
    """Allocate one number for every term of all robots."""
    return aligned_zeros(tables.sizes.terms)


def make_work(
    tables: RobotTables, angles: np.ndarray, rates: np.ndarray, base_poses: np.ndarray,
    bodies: np.ndarray, terms: np.ndarray, coriolis: np.ndarray,
) -> RobotWork:  # fmt: skip
    """Allocate the workspace; the other arrays are given."""
    lanes, rows = [aligned_zeros(tables.sources.size) for _ in range(4)], tables.sizes.rows
    return RobotWork(
        angles=angles,
        rates=rates,
        base_poses=base_poses,
        bodies=bodies.reshape(-1),
        angle=lanes[0],
        rate=lanes[1],
        sine=lanes[2],
        cosine=lanes[3],
        links=aligned_zeros(LINK_LANES * rows),
        link_turns=aligned_zeros(TURN_LANES * rows),
        frames=aligned_zeros(FRAME_LANES * rows),
        articulated=aligned_zeros(ARTICULATED_LANES * rows),
        origins=tables.bases.copy(),
        start=aligned_zeros(FRAME_LANES),
        link_sum=aligned_zeros(LINK_LANES),
        turn_sum=aligned_zeros(TURN_LANES),
        articulated_sum=aligned_zeros(ARTICULATED_LANES),
        leaves=aligned_zeros(LANES * tables.sizes.leaves),
        terms=terms,
        coriolis=coriolis,
    )
