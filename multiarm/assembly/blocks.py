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

The rows of a block's joints (stops, dry friction, couplings, wheels) follow the contacts of its
only connection where a robot has several blocks, as those of an arm do; else their owner is the
robot.  Since the rows of an owner stand together, blocks with such rows but without a connection of
their own, or with several, are one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.contacts.table import JointRow, WheelRow
from multiarm.dynamics.connections import Connection
from multiarm.robots.robot import Robot


class Block(NamedTuple):
    """A range of a robot's joints, and its rows of W."""

    robot: str
    joints: range  # of the robot, counted from 0
    connections: tuple[str, ...]
    owner: str  # of the rows of its joints


def robot_blocks(
    arm: Robot,
    connections: Sequence[Connection],
    of_joints: Iterable[JointRow | WheelRow],
    with_rows: Collection[int],
) -> list[Block]:
    """The blocks of a robot in the order of its joints.

    Parameters
    ----------
    arm : Robot
    connections : sequence of Connection
        Those in which the robot takes part, in any order.
    of_joints : iterable of JointRow or WheelRow
        Of joints that copy others, and of wheels.
    with_rows : collection of int
        Joints that have rows of their own, counted from 0.
    """
    bounds = branch_bounds(arm, connections, of_joints)
    while True:
        blocks = [
            _block(arm, range(*ends), connections, whole=len(bounds) == 2)
            for ends in pairwise(bounds)
        ]
        of_robot = [
            k
            for k, block in enumerate(blocks)
            if block.owner == arm.name and any(joint in block.joints for joint in with_rows)
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
    return Block(arm.name, joints, tuple(names), owner)
