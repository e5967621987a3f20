r"""The blocks of a scene: what the equations of motion eliminate one by one.

On a base that is fixed, the inertia of a robot is block diagonal by the branches that begin at
its base:

.. math:: M = \operatorname{blkdiag}(M_1, \dots, M_b), \qquad
    W_o^T \dot v_o + \sum_k W_k^T \ddot q_k = c .

A *block* is a range of a robot's joints that shares no inertia and no row of W with its other
joints.  So are the fingers of a hand, each as cheap as an arm of its own.  Joints stay together

- that are on one branch, such as everything that a torso carries,
- that move one connection: two links that meet each other,
- of which one copies the other, or that move a base on wheels,

with the joints between them in Pinocchio's order.

Robots that are joined to each other are one block, with all their joints.

The rows of a block's joints (stops, dry friction, couplings, wheels) follow the contacts of its
only connection where a robot has several blocks, as those of an arm do; else their owner is the
robot.  Since the rows of an owner stand together, blocks with such rows but without a connection of
their own, or with several, are one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.contacts.table import JointRow, WheelRow
from multiarm.dynamics.connections import Connection
from multiarm.robots.robot import Robot


class RobotPart(NamedTuple):
    """The joints that a block has of a robot."""

    robot: str
    joints: range  # of the robot, counted from 0
    owner: str  # of the rows of these joints


class Block(NamedTuple):
    """Joints of a robot, or of robots that are joined to each other, and their connections."""

    parts: tuple[RobotPart, ...]
    connections: tuple[str, ...]

    @property
    def joint_count(self) -> int:
        """Number of its joints."""
        return sum(len(part.joints) for part in self.parts)

    @property
    def owners(self) -> list[str]:
        """The owners of its rows in their order, of which some may have none."""
        return list(dict.fromkeys((*self.connections, *(part.owner for part in self.parts))))


def robots_together(names: Iterable[str], pairs: Iterable[Collection[str]]) -> list[list[str]]:
    """Groups of robots that are joined to each other, most of them alone, in the order of names.

    ``pairs`` are the robots of each connection, none, one or two.
    """
    group_of = {name: [name] for name in names}
    for pair in pairs:
        groups = {id(group_of[name]): group_of[name] for name in pair}
        union = [name for group in groups.values() for name in group]
        group_of.update(dict.fromkeys(union, union))
    order = list(group_of)
    groups = {id(group): sorted(group, key=order.index) for group in group_of.values()}
    return list(groups.values())


def blocks_of_group(
    robots: Mapping[str, Robot],
    connections: Sequence[Connection],
    of_joints: Mapping[str, Iterable[JointRow | WheelRow]],
    with_rows: Mapping[str, Collection[int]],
) -> list[Block]:
    """The blocks of robots that are joined to each other, or of a robot alone.

    Parameters
    ----------
    robots : mapping of str to Robot
    connections : sequence of Connection
        Those in which one of them takes part, in any order.
    of_joints : mapping of iterable of JointRow or WheelRow
        By robot, of joints that copy others, and of wheels.
    with_rows : mapping of collection of int
        By robot, joints that have rows of their own, counted from 0.
    """
    if len(robots) == 1:
        ((name, robot),) = robots.items()
        return _blocks_of_robot(robot, connections, of_joints[name], with_rows[name])
    parts = [RobotPart(name, range(robot.dof), name) for name, robot in robots.items()]
    return [Block(tuple(parts), tuple(connection.name for connection in connections))]


def _blocks_of_robot(
    arm: Robot,
    connections: Sequence[Connection],
    of_joints: Iterable[JointRow | WheelRow],
    with_rows: Collection[int],
) -> list[Block]:
    """The blocks of a robot in the order of its joints."""
    bounds = branch_bounds(arm, connections, of_joints)
    while True:
        blocks = [
            _block(arm, range(*ends), connections, whole=len(bounds) == 2)
            for ends in pairwise(bounds)
        ]
        parts = [block.parts[0] for block in blocks]
        of_robot = [
            k
            for k, part in enumerate(parts)
            if part.owner == arm.name and any(joint in part.joints for joint in with_rows)
        ]
        if len(of_robot) < 2:
            return blocks
        bounds = [*bounds[: of_robot[0] + 1], *bounds[of_robot[-1] + 1 :]]


def branch_bounds(
    arm: Robot, connections: Iterable[Connection], of_joints: Iterable[JointRow | WheelRow]
) -> list[int]:
    """First joint of every part that shares no inertia and no row with others, and last n."""
    if arm.floats:  # its inertia joins everything
        return [0, arm.dof]
    groups = [joints_of_connection(arm, connection) for connection in connections]
    groups += [list(row.joints) for row in of_joints]
    groups += [[joint, parent] for joint, parent in enumerate(arm.parents) if parent >= 0]
    divides = np.ones(arm.dof + 1, dtype=bool)
    for joints in groups:
        if joints:
            divides[min(joints) + 1 : max(joints) + 1] = False
    divides[[0, -1]] = True
    return np.flatnonzero(divides).tolist()


def joints_of_connection(arm: Robot, connection: Connection) -> list[int]:
    """The robot's joints that move a body of a connection, counted from 0."""
    bodies = [body for body in (connection.first, connection.second) if body.robot == arm.name]
    return [int(joint) for body in bodies for joint in arm.tips[body.tip].chain]


def _block(arm: Robot, joints: range, connections: Sequence[Connection], whole: bool) -> Block:
    """The block of a range of joints; ``whole`` where it has all joints of its robot."""
    names = []
    for connection in connections:
        moving = joints_of_connection(arm, connection)
        # one between a link of the base and another body moves with no joint
        if (moving[0] if moving else 0) in joints:
            names.append(connection.name)
    owner = names[0] if len(names) == 1 and not whole else arm.name
    return Block((RobotPart(arm.name, joints, owner),), tuple(names))
