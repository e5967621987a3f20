"""Tables of compiled robots: lanes, rows of scratch and places of their branches and terms.

What the tables are is said in :mod:`multiarm.robots.compiled.tables`.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from multiarm.contacts.motion import BODY_WIDTH
from multiarm.jit.rows import fields_of
from multiarm.jit.simd import LANES, aligned_zeros
from multiarm.robots.chain import ChainJoint, chain_joints, joints_at_rest
from multiarm.robots.compiled.branches import Branch, Group, make_groups
from multiarm.robots.compiled.tables import (
    FIXED_BASE,
    FLOATING_BASE,
    JACOBIAN_WIDTH,
    LINK,
    Blocks,
    Groups,
    Motions,
    Moves,
    RobotTables,
    Sizes,
    TermOffsets,
    Wanted,
)
from multiarm.robots.terms import BASE_DOF, FACTOR_WIDTH, POSE_WIDTH, TreeStructure

Pairs = list[tuple[int, int]]


class BodyLink(NamedTuple):
    """A link whose motion is written to a row of the bodies.

    robot : int
        Number among the compiled robots.
    joint : int
        The joint of its structure that moves it, counted from 0.
    row : int
    """

    robot: int
    joint: int
    row: int


class PlacedBlock(NamedTuple):
    """Up to four branches, and where they are in scratch and leaves of their group."""

    branches: tuple[Branch, ...]
    joints: int  # of the longest branch
    ancestors: int  # of the branch that has most
    first_link: int
    leaves: TermOffsets
    motions: int
    end: int  # of its leaves
    carries: tuple[int, ...]  # joints of the block whose links take part in connections
    start: int  # at what its branches begin
    base_columns: int  # of its part of the inertia

    @property
    def columns(self) -> int:
        """Columns of its part of the inertia."""
        return self.leaves.stride

    @property
    def rows(self) -> int:
        """Rows of scratch up to its end."""
        return self.first_link + self.ancestors + self.joints

    def padding(self, branch: Branch) -> int:
        """Joints at rest before those of a branch."""
        return self.joints - len(branch.joints)

    def row(self, branch: Branch, k: int) -> int:
        """Row of scratch of joint number ``k`` of a branch."""
        return self.first_link + self.ancestors + self.padding(branch) + k

    def filled(self) -> tuple[Branch, ...]:
        """The branch of each lane: free lanes repeat the first one."""
        return self.branches + self.branches[:1] * (LANES - len(self.branches))

    def columns_of(self, branch: Branch) -> dict[int, int]:
        """Column of each joint of a branch and each ancestor."""
        first = self.base_columns + self.ancestors - len(branch.ancestors)
        before = {joint: first + k for k, joint in enumerate(branch.ancestors)}
        first = self.base_columns + self.ancestors + self.padding(branch)
        return before | {joint: first + k for k, joint in enumerate(branch.joints)}


class PlacedGroup(NamedTuple):
    """The blocks of a group."""

    plain: bool
    floats: bool
    blocks: tuple[PlacedBlock, ...]

    def places(self) -> dict[tuple[int, int], int]:
        """Place in scratch of each robot's joints: four times the row plus the lane."""
        return {
            (branch.robot, joint): LANES * block.row(branch, k) + lane
            for block in self.blocks
            for lane, branch in enumerate(block.branches)
            for k, joint in enumerate(branch.joints)
        }


def make_tables(
    structures: Sequence[TreeStructure],
    first_joints: Sequence[int],
    links: Sequence[BodyLink],
    gravity: np.ndarray,
    bases: Sequence[int],
) -> RobotTables:
    """Tables of compiled robots.

    Parameters
    ----------
    structures : sequence of TreeStructure
    first_joints : sequence of int
        The first joint of each robot in the stacked vectors.
    links : sequence of BodyLink
    gravity : ndarray, shape (3,)
    bases : sequence of int
        Number of the floating base of each robot among those of the system; of no use where it is
        fixed.
    """
    carriers = [[link.joint for link in links if link.robot == k] for k in range(len(structures))]
    groups = [_placed(group, carriers) for group in make_groups(structures, carriers)]
    blocks = [block for group in groups for block in group.blocks]
    first_terms, terms = _first_terms(groups)
    robots = _robot_offsets(groups, first_terms)
    rows = max(group.blocks[-1].rows for group in groups)
    constants = np.concatenate([_constants(block, structures) for block in blocks])  # (J, 34, 4)
    turns = fields_of(ChainJoint, constants.swapaxes(1, 2)).turns
    origins = [
        np.stack([structures[branch.robot].translations[0] for branch in block.filled()], axis=-1)
        for block in blocks
    ]
    return RobotTables(
        blocks=_block_table(groups, first_joints, bases),
        groups=_group_table(groups, first_terms, terms, robots, links, structures),
        robots=np.array(robots, dtype=np.int64),
        energies=np.concatenate([robot.energy + np.arange(robot.energies) for robot in robots]),
        sources=_integers(
            np.concatenate([_sources(block, structures, first_joints) for block in blocks])
        ),
        divides=_integers([flag for group in groups for flag in _divides(group)]),
        carries=_integers([slot for block in blocks for slot in _slots(block)]),
        turns=np.ascontiguousarray(turns).ravel(),
        constants=_aligned(constants),
        bases=np.array(origins).reshape(len(blocks), -1),
        gravity=np.array(gravity, dtype=float),
        sizes=Sizes(rows, max(group.blocks[-1].end for group in groups), terms),
        wanted=Wanted(inertias=True),
    )


# --- places ---------------------------------------------------------------------------------------


def _placed(group: Group, carriers: Sequence[Sequence[int]]) -> PlacedGroup:
    """The blocks of a group, one after the other in scratch and leaves."""
    blocks: list[PlacedBlock] = []
    for branches in group.blocks:
        start = FIXED_BASE if branches[0].parent < 0 else LINK
        if group.floats and start == FIXED_BASE:
            start = FLOATING_BASE
        base_columns = BASE_DOF if group.floats and start == LINK else 0
        joints = max(len(branch.joints) for branch in branches)
        ancestors = max(len(branch.ancestors) for branch in branches)
        numbers, columns = joints, base_columns + ancestors + joints
        if start == FLOATING_BASE:
            numbers = columns = BASE_DOF
        before = blocks[-1].end if blocks else 0
        leaves, motions = _offsets(before, numbers, joints, columns, plain=group.plain)
        block = PlacedBlock(
            branches, joints, ancestors, blocks[-1].rows if blocks else 0, leaves, motions, 0, (),
            start, base_columns,
        )  # fmt: skip
        carries = {
            block.padding(branch) + k
            for branch in branches
            for k, joint in enumerate(branch.joints)
            if joint in carriers[branch.robot]
        }
        # matrices of Coriolis forces begin at the inertia and need more room
        end = max(motions + BODY_WIDTH * len(carries), leaves.inertia + block.columns**2)
        blocks.append(block._replace(carries=tuple(sorted(carries)), end=_rounded_up(end)))
    return PlacedGroup(group.plain, group.floats, tuple(blocks))


def _offsets(
    at: int, joints: int, links: int, columns: int, energies: int = 1, plain: bool = False
) -> tuple[TermOffsets, int]:
    """Offsets of the terms of so many joints from one place on, and their end."""
    jacobian = at + joints * columns
    bias = jacobian + JACOBIAN_WIDTH * joints
    energy = bias + 2 * joints
    poses = _rounded_up(energy + energies)
    end = poses + _rounded_up(POSE_WIDTH * links)
    terms = TermOffsets(
        joints, links, at, columns, jacobian, bias, bias + joints, energy, energies, poses,
        0 if plain else end,
    )  # fmt: skip
    return terms, end if plain else end + _rounded_up(FACTOR_WIDTH * joints)


def _rounded_up(count: int) -> int:
    """The next multiple of the number of lanes."""
    return -(-count // LANES) * LANES


def _first_terms(groups: Sequence[PlacedGroup]) -> tuple[dict[int, int], int]:
    """Offset of the terms of each robot, and the number of all terms."""
    first: dict[int, int] = {}
    end = 0
    for group in groups:
        if group.plain:
            (block,) = group.blocks
            for lane, branch in enumerate(block.branches):
                first[branch.robot] = end + lane * block.motions
            end += LANES * block.motions
            continue
        for robot in dict.fromkeys(x.robot for block in group.blocks for x in block.branches):
            first[robot] = end
            _, end = _offsets(end, *_sizes_of(group, robot))
    return first, end + LANES  # for what has no place


def _sizes_of(group: PlacedGroup, robot: int) -> tuple[int, int, int, int]:
    """Numbers of a robot's velocity, its links, columns of its inertia, energies."""
    branches = [x for block in group.blocks for x in block.branches if x.robot == robot]
    links = sum(len(x.joints) for x in branches)
    joints = links + (BASE_DOF - 1 if group.floats else 0)
    return joints, links, joints, sum(x.level == 0 for x in branches)


def _robot_offsets(groups: Sequence[PlacedGroup], first_terms: dict[int, int]) -> list[TermOffsets]:
    """Where the terms of each robot are."""
    robots: dict[int, TermOffsets] = {}
    for group in groups:
        for block in group.blocks:
            for x in block.branches:
                first, padding = first_terms[x.robot], block.padding(x)
                if not group.plain:
                    robots[x.robot], _ = _offsets(first, *_sizes_of(group, x.robot))
                    continue
                at, _ = _offsets(first, block.joints, block.joints, block.joints, plain=True)
                robots[x.robot] = at._replace(
                    joints=len(x.joints),
                    links=len(x.joints),
                    inertia=at.inertia + padding * (block.joints + 1),
                    jacobian=at.jacobian + JACOBIAN_WIDTH * padding,
                    bias=at.bias + padding,
                    gravity_torque=at.gravity_torque + padding,
                    poses=at.poses + POSE_WIDTH * padding,
                )
    return [robots[k] for k in range(len(robots))]


# --- tables ---------------------------------------------------------------------------------------


def _block_table(
    groups: Sequence[PlacedGroup], first_joints: Sequence[int], bases: Sequence[int]
) -> Blocks:
    blocks = [block for group in groups for block in group.blocks]
    lineage: list[list[int]] = []
    parents, first_ancestor = [], []
    for group in groups:
        places = group.places()
        for block in group.blocks:
            first_ancestor.append(len(lineage))
            lanes = []
            for x in block.filled():
                way = [places[x.robot, joint] for joint in x.ancestors]
                lanes.append((way[:1] or [0]) * (block.ancestors - len(way)) + way)
            lineage += np.transpose(lanes).astype(int).tolist()
            parents.append([places.get((x.robot, x.parent), 0) for x in block.filled()])
    joints = [block.joints for block in blocks]
    return Blocks(
        joints=_integers(joints),
        first_joint=_integers(_starts(joints)[:-1]),
        ancestors=_integers([block.ancestors for block in blocks]),
        lineage=_integers(lineage).reshape(-1, LANES),
        first_ancestor=_integers(first_ancestor),
        start=_integers([block.start for block in blocks]),
        base_columns=_integers([block.base_columns for block in blocks]),
        base=_integers([[bases[x.robot] for x in block.filled()] for block in blocks]),
        base_rate=_integers([[first_joints[x.robot] for x in block.filled()] for block in blocks]),
        parents=_integers(parents),
        branches=_integers([len(block.branches) for block in blocks]),
        first_link=_integers([block.first_link for block in blocks]),
        inertia=_integers([block.leaves.inertia for block in blocks]),
        jacobian=_integers([block.leaves.jacobian for block in blocks]),
        bias=_integers([block.leaves.bias for block in blocks]),
        gravity_torque=_integers([block.leaves.gravity_torque for block in blocks]),
        energy=_integers([block.leaves.energy for block in blocks]),
        poses=_integers([block.leaves.poses for block in blocks]),
        factors=_integers([block.leaves.factors for block in blocks]),
        motions=_integers([block.motions for block in blocks]),
    )


def _group_table(
    groups: Sequence[PlacedGroup],
    first_terms: dict[int, int],
    terms: int,
    robots: Sequence[TermOffsets],
    links: Sequence[BodyLink],
    structures: Sequence[TreeStructure],
) -> Groups:
    rows = {(link.robot, link.joint): link.row for link in links}
    runs = [_runs(group, robots, structures) for group in groups]
    motions = [_motions(group, links) for group in groups]
    spare = terms - LANES
    plain = np.array([group.plain for group in groups])
    first = [group.blocks[0] for group in groups]
    bodies = [
        [rows[x.robot, x.joints[-1]] if group.plain else 0 for x in block.filled()]
        for group, block in zip(groups, first, strict=True)
    ]
    return Groups(
        first_block=_integers(_starts([len(group.blocks) for group in groups])),
        plain=_integers(plain),
        floats=_integers([group.floats for group in groups]),
        first_term=np.where(plain, [first_terms[block.branches[0].robot] for block in first], 0),
        term_count=np.where(plain, [block.motions for block in first], 0),
        bodies=_integers(bodies),
        terms=_moves([group.terms for group in runs], spare),
        gravity_torques=_moves([group.gravity_torques for group in runs], spare),
        inertias=_moves([group.inertias for group in runs], spare),
        factors=_moves([group.factors for group in runs], spare),
        poses=_moves([group.poses for group in runs], spare),
        coriolis=_moves([group.coriolis for group in runs], spare),
        motions=Motions(
            sources=_integers([source for group in motions for source, _ in group]),
            targets=_integers([target for group in motions for _, target in group]),
            first=_integers(_starts([len(group) for group in motions])),
        ),
    )


class Run(NamedTuple):
    """Numbers of a lane that follow each other in the leaves, and where they go."""

    leaf: int
    lane: int
    target: int
    size: int


class GroupRuns(NamedTuple):
    """Where the leaves of a group go."""

    terms: list[Run]
    gravity_torques: list[Run]
    inertias: list[Run]
    factors: list[Run]
    poses: list[Run]
    coriolis: list[Run]


def _runs(
    group: PlacedGroup, robots: Sequence[TermOffsets], structures: Sequence[TreeStructure]
) -> GroupRuns:
    runs, roots = GroupRuns([], [], [], [], [], []), [0] * len(robots)
    if group.plain:
        return runs
    for block in group.blocks:
        for lane, branch in enumerate(block.branches):
            leaves, terms = block.leaves, robots[branch.robot]
            if branch.level == 0:
                place = terms.energy + roots[branch.robot]
                runs.terms.append(Run(leaves.energy, lane, place, 1))
                roots[branch.robot] += 1
            structure, at_base = structures[branch.robot], block.start == FLOATING_BASE
            for first, joint, count in _in_order(branch.joints):
                k, number = block.padding(branch) + first, structure.number_of(joint)
                numbers = BASE_DOF if at_base else count
                for name, size, into in (
                    ("jacobian", JACOBIAN_WIDTH, runs.terms),
                    ("bias", 1, runs.terms),
                    ("gravity_torque", 1, runs.gravity_torques),
                    ("factors", FACTOR_WIDTH, runs.factors),
                ):
                    leaf, place = getattr(leaves, name), getattr(terms, name)
                    run = Run(leaf + size * k, lane, place + size * number, size * numbers)
                    into.append(run)
                leaf, place = leaves.poses + POSE_WIDTH * k, terms.poses + POSE_WIDTH * joint
                runs.poses.append(Run(leaf, lane, place, POSE_WIDTH * count))
            if at_base:
                runs.inertias.extend(_base_runs(leaves.inertia, lane, terms))
                continue
            inertia, coriolis = _matrix_runs(block, lane, branch, terms, structure)
            runs.inertias.extend(inertia)
            runs.coriolis.extend(coriolis)
    return runs


def _base_runs(leaf: int, lane: int, terms: TermOffsets) -> list[Run]:
    """Runs of the rows of a floating base of the inertia."""
    return [
        Run(leaf + BASE_DOF * k, lane, terms.inertia + terms.stride * k, k + 1)
        for k in range(BASE_DOF)
    ]


def _matrix_runs(
    block: PlacedBlock, lane: int, branch: Branch, terms: TermOffsets, structure: TreeStructure
) -> tuple[list[Run], list[Run]]:
    """Runs of the rows of a branch of the inertia; those and columns of Coriolis forces."""
    inertia, coriolis, leaf = [], [], block.leaves.inertia
    columns, number_of = block.columns_of(branch), structure.number_of
    for k, joint in enumerate(branch.joints, block.padding(branch)):
        row, number = block.ancestors + k, number_of(joint)
        first = terms.inertia + terms.stride * number
        if block.base_columns:
            inertia.append(Run(leaf + block.columns * k, lane, first, block.base_columns))
        for _, before, count in _in_order(branch.ancestors):
            source, target = leaf + columns[before], first + number_of(before)
            inertia.append(Run(source + block.columns * k, lane, target, count))
            coriolis.append(Run(source + block.columns * row, lane, target, count))
        for before in branch.ancestors:
            source, target = leaf + block.columns * columns[before], terms.inertia + number
            coriolis.append(Run(source + row, lane, target + terms.stride * number_of(before), 1))
        for _, before, count in _in_order(branch.joints):
            source, target = leaf + columns[before], first + number_of(before)
            coriolis.append(Run(source + block.columns * row, lane, target, count))
            if before <= joint:  # the numbers above the diagonal mean nothing
                size = min(count, _rounded_up(joint + 1 - before))
                inertia.append(Run(source + block.columns * k, lane, target, size))
    return inertia, coriolis


def _in_order(joints: Sequence[int]) -> list[tuple[int, int, int]]:
    """Joints that are numbered in order: place of the first, its number, how many."""
    if not joints:
        return []
    starts = [0, *(np.flatnonzero(np.diff(joints) != 1) + 1), len(joints)]
    return [(int(a), int(joints[a]), int(b - a)) for a, b in pairwise(starts)]


def _moves(groups: Sequence[Sequence[Run]], spare: int) -> Moves:
    """The moves of runs: by four where that many follow each other."""
    quads: list[tuple[int, list[int]]] = []
    singles: Pairs = []
    sizes: Pairs = []
    for runs in groups:
        by_four: dict[int, list[int]] = {}
        count = len(singles)
        for run in sorted(runs, key=lambda run: -run.size):
            if run.size < LANES:
                singles += [
                    (LANES * (run.leaf + k) + run.lane, run.target + k) for k in range(run.size)
                ]
                continue
            for leaf in _quads_of(run, by_four):
                places = by_four.setdefault(leaf, [spare] * LANES)
                assert places[run.lane] == spare, "a number has one place"
                places[run.lane] = run.target + leaf - run.leaf
        quads += sorted(by_four.items())
        sizes.append((len(by_four), len(singles) - count))
    return Moves(
        quads=_integers([LANES * leaf for leaf, _ in quads]),
        places=_integers([places for _, places in quads]).reshape(-1, LANES),
        sources=_integers([source for source, _ in singles]),
        targets=_integers([target for _, target in singles]),
        first_quad=_integers(_starts([quad for quad, _ in sizes])),
        first_single=_integers(_starts([single for _, single in sizes])),
    )


def _quads_of(run: Run, shared: Container[int]) -> list[int]:
    """The leaves at which four numbers of a run begin, which may overlap.

    They are those of runs in other lanes, ``shared``, where these serve.
    """
    leaves, end = [], run.leaf + run.size
    at = run.leaf
    while at < end:
        before = range(min(at, end - LANES), max(run.leaf, at - LANES + 1) - 1, -1)
        leaves.append(next((leaf for leaf in before if leaf in shared), before[0]))
        at = leaves[-1] + LANES
    return leaves


def _motions(group: PlacedGroup, links: Sequence[BodyLink]) -> list[tuple[int, int]]:
    """The first number of each motion of a link in the leaves, and in the bodies."""
    places = {} if group.plain else group.places()
    motions = []
    for block in group.blocks:
        for slot, k in enumerate(block.carries):
            row = block.first_link + block.ancestors + k
            source = LANES * (block.motions + BODY_WIDTH * slot)
            for link in links:
                place = places.get((link.robot, link.joint), -1)
                if place // LANES == row:
                    motions.append((source + place % LANES, BODY_WIDTH * link.row))
    return motions


def _divides(group: PlacedGroup) -> list[bool]:
    """Whether branches begin at the link of each joint of the group's blocks."""
    rows = {
        group.places()[x.robot, x.parent] // LANES
        for block in group.blocks for x in block.branches if x.parent >= 0
    }  # fmt: skip
    return [
        block.first_link + block.ancestors + k in rows
        for block in group.blocks
        for k in range(block.joints)
    ]


def _slots(block: PlacedBlock) -> list[int]:
    """Number of each joint among those of the block that carry links of connections, or -1."""
    return [block.carries.index(k) if k in block.carries else -1 for k in range(block.joints)]


def _sources(
    block: PlacedBlock, structures: Sequence[TreeStructure], first_joints: Sequence[int]
) -> np.ndarray:
    """Each lane's joints in the stacked vectors, shape (4 n,); padding reads any of its robot."""
    lanes = [
        [
            first_joints[x.robot] + structures[x.robot].number_of(joint)
            for joint in (*[0] * block.padding(x), *x.joints)
        ]
        for x in block.filled()
    ]
    return np.transpose(lanes).ravel()


def _constants(block: PlacedBlock, structures: Sequence[TreeStructure]) -> np.ndarray:
    """Constants of the lanes of a block, shape (n, 34, 4)."""
    lanes = [
        np.vstack([
            joints_at_rest(block.padding(x)), chain_joints(structures[x.robot])[list(x.joints)]
        ])
        for x in block.filled()
    ]  # fmt: skip
    return np.stack(lanes, axis=-1)


def _aligned(numbers: np.ndarray) -> np.ndarray:
    aligned = aligned_zeros(numbers.size)
    aligned[:] = numbers.ravel()
    return aligned


def _starts(counts: Sequence[int]) -> list[int]:
    """Where each of parts with so many entries begins, and the end."""
    return list(accumulate(counts, initial=0))


def _integers(values: Sequence | np.ndarray) -> np.ndarray:
    return np.array(values, dtype=np.int64)
