r"""What is asked of a robot's posture: frames that come together, couplings and ranges of joints.

:class:`Target` names two frames, :class:`Coupling` a joint that follows another, :class:`Ranges`
where joints are sought.  :func:`kinematic_tree` makes the arrays of the kernel of them
(:mod:`multiarm.assembly.reaching`).

Joints that follow others, :math:`q_k = a_k q_l + b_k`, are no unknowns: the numbers ``x`` that are
sought are the positions of the joints that follow none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from multiarm.assembly.reaching import Tree
from multiarm.jit.rows import fields_of
from multiarm.robots.chain import ChainJoint, chain_joints, joints_at_rest
from multiarm.robots.terms import TreeStructure

# Joints without limits are sought within a turn either way, all others this far inside them [rad].
TURN, MARGIN = math.pi, 0.05


@dataclass(frozen=True)
class LinkFrame:
    """A frame on a link.

    Attributes
    ----------
    joint : int
        The joint that moves the link, from 0; -1: the robot's base, or the world.
    pose : ndarray, shape (4, 4)
        In the joint's frame, or in the world.
    """

    joint: int
    pose: np.ndarray = field(default_factory=lambda: np.eye(4))


@dataclass(frozen=True)
class Target:
    """Two frames that a connection brings together.

    Attributes
    ----------
    first : LinkFrame
    second : LinkFrame or None
        None: at rest, at a place in the world that the search is told.
    free : tuple of int
        Components that need not agree, in the axes of the second frame: 0 to 2 are shifts along, 3
        to 5 turns about x, y, z.
    """

    first: LinkFrame
    second: LinkFrame | None = None
    free: tuple[int, ...] = ()

    @property
    def counted(self) -> np.ndarray:
        """Components that must agree."""
        return np.setdiff1d(np.arange(6), self.free)


@dataclass(frozen=True)
class Coupling:
    """A joint that follows another: ``q_joint = multiplier * q_leader + offset``.

    Attributes
    ----------
    joint, leader : int
        From 0; the leader may follow a third joint.
    multiplier : float
    offset : float
        [rad or m]
    """

    joint: int
    leader: int
    multiplier: float
    offset: float = 0.0


@dataclass(frozen=True)
class Ranges:
    """Where joints are sought.

    Attributes
    ----------
    lower, upper : ndarray, shape (n,)
        Bounds [rad or m].
    limited : ndarray of bool, shape (n,)
        Joints that should keep away from their bounds.
    margin : float
        How far the bounds are inside the limits [rad or m].
    """

    lower: np.ndarray
    upper: np.ndarray
    limited: np.ndarray
    margin: float

    @classmethod
    def of_joints(cls, limits: np.ndarray, slides: np.ndarray, to_limits: bool) -> Ranges:
        """Within limits (n, 2), infinite where there are none.

        Parameters
        ----------
        slides : ndarray of bool, shape (n,)
        to_limits : bool
            Whether joints may come up to their limits, as far as sliding joints go.
        """
        endless = ~np.isfinite(limits).all(axis=1)
        low, high = np.where(endless, 0.0, limits.T)
        middle = 0.5 * (low + high)
        margin = 0.0 if to_limits else MARGIN
        half = np.where(endless, TURN, 0.5 * (high - low) - margin)
        farthest = np.where(slides, np.inf, TURN) if to_limits else TURN
        half = np.minimum(np.maximum(half, 0.0), farthest)
        return cls(middle - half, middle + half, ~endless, margin)

    def of_independent(self, tree: Tree, rest: np.ndarray | None = None) -> Ranges:
        """Of the numbers ``x`` of a tree, which also keep the joints that follow in their ranges.

        Parameters
        ----------
        rest : ndarray, shape (n,), optional
            Where joints stay that move no target; in the middle of their ranges, if not given.
        """
        d = tree.independent.size
        lower, upper = np.full(d, -np.inf), np.full(d, np.inf)
        limited, moves = np.zeros(d, dtype=bool), np.zeros(d, dtype=bool)
        for k, (leader, factor) in enumerate(zip(tree.leaders, tree.multipliers, strict=True)):
            moves[leader] |= bool(np.any(tree.moves[:, k] != 0.0))
            if factor != 0.0:
                ends = np.array([self.lower[k], self.upper[k]])
                low, high = np.sort((ends - tree.offsets[k]) / factor)
                lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
                limited[leader] |= self.limited[k]
        upper = np.maximum(lower, upper)
        still = 0.5 * (lower + upper) if rest is None else rest[tree.independent]
        lower, upper = (np.where(moves, bound, still) for bound in (lower, upper))
        return Ranges(lower, upper, limited & moves, self.margin)


def kinematic_tree(
    structure: TreeStructure, targets: Sequence[Target], couplings: Sequence[Coupling] = ()
) -> Tree:
    """The arrays of the kernel; frames of targets at rest are at the world's origin."""
    frames: list[LinkFrame] = []
    for target in targets:
        frames += [target.first, target.second or LinkFrame(-1)]
    n = structure.parents.size
    table = np.vstack([chain_joints(structure), joints_at_rest(len(frames))])
    joints = fields_of(ChainJoint, table)
    at_base = np.flatnonzero(structure.parents < 0)
    joints.offset[at_base] = structure.translations[at_base]
    for number, frame in enumerate(frames, n):
        turned = np.eye(3) if frame.joint < 0 else joints.link_axes[frame.joint]
        joints.axes[number] = turned @ frame.pose[:3, :3]
        joints.offset[number] = turned @ frame.pose[:3, 3]
    carriers = np.array([frame.joint for frame in frames], dtype=np.int64)
    moves = np.zeros((len(targets), n))
    for row, target in zip(moves, targets, strict=True):
        row[way_to(structure.parents, target.first.joint)] += 1.0
        if target.second is not None:
            row[way_to(structure.parents, target.second.joint)] -= 1.0
    return Tree(
        joints=table,
        parents=np.concatenate([structure.parents, carriers]),
        first=np.arange(n, n + len(frames), 2),
        second=np.arange(n + 1, n + len(frames), 2),
        counted=np.concatenate([6 * c + target.counted for c, target in enumerate(targets)]),
        moves=moves,
        **_following(n, couplings)._asdict(),
    )


def with_places(tree: Tree, rows: np.ndarray, places: np.ndarray) -> Tree:
    """The tree with frames at rest, ``rows`` of its joints, at places (..., 4, 4) in the world."""
    table = tree.joints.copy()
    joints, poses = fields_of(ChainJoint, table), places.reshape(-1, 4, 4)
    joints.axes[rows], joints.offset[rows] = poses[:, :3, :3], poses[:, :3, 3]
    return tree._replace(joints=table)


def way_to(parents: np.ndarray, joint: int) -> list[int]:
    """The joints that move the link of a joint, from the base."""
    return [*_towards_base(parents, joint)][::-1]


def _towards_base(parents: np.ndarray, joint: int) -> Iterator[int]:
    while joint >= 0:
        yield joint
        joint = int(parents[joint])


class _Following(NamedTuple):
    """Fields of :class:`multiarm.assembly.reaching.Tree`."""

    independent: np.ndarray
    leaders: np.ndarray
    multipliers: np.ndarray
    offsets: np.ndarray


def _following(n: int, couplings: Sequence[Coupling]) -> _Following:
    """Which joint that follows none each joint follows, through joints between them."""
    leaders, multipliers, offsets = np.arange(n), np.ones(n), np.zeros(n)
    by_joint = {coupling.joint: coupling for coupling in couplings}
    for joint in by_joint:
        while leaders[joint] in by_joint:
            coupling = by_joint[int(leaders[joint])]
            offsets[joint] += multipliers[joint] * coupling.offset
            multipliers[joint] *= coupling.multiplier
            leaders[joint] = coupling.leader
            assert leaders[joint] != joint, "no joint follows itself"
    independent = np.setdiff1d(np.arange(n), [*by_joint])
    return _Following(independent, np.searchsorted(independent, leaders), multipliers, offsets)
