"""Where the parts of a system are in the vectors that stack them.

With F floating frames, the objects, B robots whose base floats, and n numbers of joints, to which
the robots with floating bases add six each, before those of their joints:

.. code-block:: text

    configuration              poses (F, 7): position, quaternion xyzw; base poses (B, 7);
      (7 F + 7 B + n)            joint positions (n,), zero for the six of a base
    velocity (6 F + n)         twists (F, 6), world axes; joint velocities (n,), the six of a base
                                 its twist, world axes
    contact forces (N)         of each owner of rows
    chart (12 F + 2 n + e + w) of the integrator: displacement, velocity, states of effects, works
    columns (12 F + 2 n)       of derivatives by the state: by displacements of the frames, their
                               twists, joint positions, joint velocities; others may follow

Displacements, accelerations and generalised forces have the order of a velocity: of a frame six
numbers, linear (3) and angular (3).  :class:`ChartPlaces` and :class:`StateColumns` say where the
parts begin, in Python as in kernels; the frames are first in both.
:mod:`multiarm.dynamics.coordinates` moves on configurations.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from multiarm.notation import count_of
from multiarm.scene.values import of_surroundings

TWIST = 6
"""Numbers of a twist, the velocity of a frame."""
NAMED_ARMS = 4
"""More arms are counted where an object shows itself in a line."""

STATE = ("object_pose", "object_twist", "joint_positions", "joint_velocities")
"""Names of the columns of derivatives by the state, in their order."""


class ChartPlaces(NamedTuple):
    """Where the parts of a chart's vector begin; the displacements of the frames begin at zero."""

    joints: int  # joint positions, or what a vector like a velocity has of the joints
    velocity: int  # numbers of a velocity
    rates: int  # joint velocities
    states: int  # of effects
    works: int


def places_in_chart(velocities, joints, states):
    """The places for numbers of velocities, of joints among them, and of states of effects."""
    end = 2 * velocities  # of the velocity
    return ChartPlaces(velocities - joints, velocities, end - joints, end, end + states)


class BlockPart(NamedTuple):
    """The joints that a block has of one robot."""

    robot: int
    first: int  # counted from the robot's first joint
    joints: int


class StateColumns(NamedTuple):
    """First columns of derivatives by a state; by displacements of the frames they begin at zero.

    Whatever has columns beside these has the same first three fields.
    """

    twists: int
    positions: int  # of joints
    rates: int
    end: int


def columns_of_state(velocities, joints):
    """The columns for numbers of velocities, and of joints among them."""
    frames = velocities - joints
    return StateColumns(frames, 2 * frames, 2 * frames + joints, 2 * velocities)


def column_of_displacement(columns, l):
    """The column of entry ``l`` of a displacement."""
    return l if l < columns.twists else columns.positions + l - columns.twists


def column_of_velocity(columns, l):
    """The column of entry ``l`` of a velocity."""
    return columns.twists + l if l < columns.twists else columns.rates + l - columns.twists


@dataclass(frozen=True)
class Layout:
    """Where frames, joints and contacts are in stacked vectors.

    Joints of robot ``i`` are ``first_joint[i]`` to ``first_joint[i + 1]``.  The equations are
    solved by *blocks*: ranges of joints that share neither inertia nor rows of W with others, such
    as the fingers of a hand on a fixed base, or robots that are joined to each other, and last the
    surroundings where they have rows (:mod:`multiarm.assembly.blocks`).  Rows of W have *owners*: a
    connection of two bodies, a robot for rows that belong to its joints (those of an arm, or of a
    finger with one connection, follow the contacts of the connection), and last the surroundings.
    Rows of owner ``c`` are ``first_contact[c]`` to ``first_contact[c + 1]``; the owners of a block
    stand together, and so do the blocks of a robot.

    Attributes
    ----------
    names : tuple of str
        The robots.
    first_joint : tuple of int
        Of the robots; last the number of all joints.
    first_joint_of_block : tuple of int
        Of the blocks; the surroundings have no joints; last the number of all joints.
    owners : tuple of str
        The owners of rows.
    first_contact : tuple of int
        Of the owners; last the number of all rows.
    block_of : tuple of int
        The block of each owner.
    objects : tuple of str
        The objects: the floating frames without the bases of robots.
    floating_robots : tuple of int
        Robots whose base floats: their first six joints are the base's displacement and twist.
    passive_joints : tuple of int
        Joints without a drive, beside the six of each floating base.
    noun : str
        What the robots are called together: ``arms``, or ``robots`` where one names its tips.
    """

    names: tuple[str, ...]
    first_joint: tuple[int, ...]
    first_joint_of_block: tuple[int, ...]
    owners: tuple[str, ...]
    first_contact: tuple[int, ...]
    block_of: tuple[int, ...]
    objects: tuple[str, ...] = ("object",)
    floating_robots: tuple[int, ...] = ()
    passive_joints: tuple[int, ...] = ()
    noun: str = "arms"

    def __str__(self) -> str:
        count, noun = len(self.names), self.noun
        robots = f"{noun} {', '.join(self.names)}" if count <= NAMED_ARMS else f"{count} {noun}"
        if not count:
            robots = count_of(self.frames, "object")
        joints, contacts = self.tree_joint_count, self.contacts
        return f"{robots}; {count_of(joints, 'joint')}, {count_of(contacts, 'contact')}"

    # --- sizes ----------------------------------------------------------------------------------

    @property
    def rate_count(self) -> int:
        """Numbers of joint velocities of all robots, n: one a joint, and six a floating base."""
        return self.first_joint[-1]

    @property
    def tree_joint_count(self) -> int:
        """Number of joints of all robots, without floating bases."""
        return self.rate_count - TWIST * len(self.floating_robots)

    @property
    def frames(self) -> int:
        """Number of objects, F."""
        return len(self.objects)

    @property
    def node(self) -> int:
        """Unknowns of the node, the accelerations of all objects: 6 F."""
        return TWIST * self.frames

    @property
    def contacts(self) -> int:
        """Number of contacts of all owners, N."""
        return self.first_contact[-1]

    @property
    def nq(self) -> int:
        """Numbers of a configuration, 7 F + 7 B + n."""
        return self._first_position + self.rate_count

    @property
    def _first_position(self) -> int:
        """Where joint positions begin in a configuration."""
        return 7 * (self.frames + len(self.floating_robots))

    @property
    def nv(self) -> int:
        """Numbers of a velocity, 6 F + n."""
        return TWIST * self.frames + self.rate_count

    @property
    def surroundings(self) -> slice:
        """Contacts of the objects with their surroundings, the last owners' where there are any."""
        around = sum(map(of_surroundings, self.owners))
        return slice(self.first_contact[len(self.owners) - around], self.contacts)

    @property
    def owners_of_robots(self) -> tuple[str, ...]:
        """The owners of rows without the surroundings."""
        return self.owners[: bisect_left(self.block_of, len(self.blocks_of_robots))]

    @property
    def block_count(self) -> int:
        """Number of blocks: those of the robots, and the surroundings where they have rows."""
        return len(self.first_joint_of_block) - 1

    @cached_property
    def parts_of_blocks(self) -> tuple[tuple[BlockPart, ...], ...]:
        """What each block has of the robots, in their order; the surroundings have nothing."""
        return tuple(
            tuple(
                BlockPart(robot, begin - first, end - begin)
                for robot, (first, last) in enumerate(pairwise(self.first_joint))
                if (begin := max(first, block[0])) < (end := min(last, block[1]))
            )
            for block in pairwise(self.first_joint_of_block)
        )

    def robots_of_block(self, i: int) -> tuple[str, ...]:
        """The robots that have joints of a block, by name; none for the surroundings."""
        return tuple(self.names[part.robot] for part in self.parts_of_blocks[i])

    @property
    def splits_robots(self) -> bool:
        """Whether some robot has several blocks."""
        return any(len(blocks) > 1 for blocks in self.blocks_by_robot.values())

    @property
    def blocks_of_robots(self) -> range:
        """The blocks without the surroundings."""
        return range(sum(map(bool, self.parts_of_blocks)))

    @cached_property
    def robot_groups(self) -> tuple[range, ...]:
        """The robots in groups of neighbours that are joined to each other; most are alone."""
        first = {blocks[0].robot: blocks[-1].robot + 1 for blocks in self.parts_of_blocks if blocks}
        return tuple(range(robot, end) for robot, end in first.items())

    @property
    def joint_counts(self) -> list[int]:
        """Number of joints of each block; the surroundings have none."""
        return np.diff(self.first_joint_of_block).tolist()

    @property
    def contact_counts(self) -> list[int]:
        """Number of contacts of each block."""
        return np.diff(self.first_of_block).tolist()

    @cached_property
    def first_of_block(self) -> tuple[int, ...]:
        """First contact of each block; last the number of all."""
        owners = np.searchsorted(self.block_of, range(self.block_count + 1))
        return tuple(self.first_contact[owner] for owner in owners)

    def joints_of(self, i: int) -> slice:
        """Joints of a robot among all joints; the first six may be those of its base."""
        return slice(self.first_joint[i], self.first_joint[i + 1])

    def blocks_of(self, i: int) -> range:
        """The blocks that have joints of a robot."""
        firsts, joints = self.first_joint_of_block, self.joints_of(i)
        return range(bisect_right(firsts, joints.start) - 1, bisect_left(firsts, joints.stop))

    @property
    def blocks_by_robot(self) -> dict[str, range]:
        """The blocks of each robot by its name."""
        return {name: self.blocks_of(i) for i, name in enumerate(self.names)}

    def joints_of_block(self, i: int) -> slice:
        """Joints of a block among all joints."""
        return slice(self.first_joint_of_block[i], self.first_joint_of_block[i + 1])

    def contacts_of(self, owner: int) -> slice:
        """Contacts of an owner among all contacts."""
        return slice(self.first_contact[owner], self.first_contact[owner + 1])

    def contacts_of_block(self, i: int) -> slice:
        """Contacts of a block among all contacts."""
        return slice(self.first_of_block[i], self.first_of_block[i + 1])

    def owners_of_block(self, i: int) -> range:
        """The owners of the rows of a block."""
        return range(bisect_left(self.block_of, i), bisect_right(self.block_of, i))

    def contacts_of_blocks_of(self, i: int) -> slice:
        """Contacts of a robot's blocks, and so of robots joined to it, among all contacts."""
        blocks = self.blocks_of(i)
        return slice(self.first_of_block[blocks.start], self.first_of_block[blocks.stop])

    def owners_of_blocks_of(self, i: int) -> range:
        """The owners of the rows of a robot's blocks, and so of robots joined to it."""
        blocks = self.blocks_of(i)
        firsts = [bisect_left(self.block_of, block) for block in (blocks.start, blocks.stop)]
        return range(*firsts)

    def robot_of_joint(self, joint: int) -> int:
        """Index of the robot that has a joint."""
        return bisect_right(self.first_joint, joint) - 1

    def block_of_joint(self, joint: int) -> int:
        """Index of the block that has a joint."""
        return bisect_right(self.first_joint_of_block, joint) - 1

    def block_of_contact(self, contact: int) -> int:
        """Index of the block that has a contact."""
        return bisect_right(self.first_of_block, contact) - 1

    def chain_in_block(self, robot: int, chain: np.ndarray) -> tuple[int, np.ndarray]:
        """The block of joints from the base to a link, and these counted from its first one.

        ``chain`` counts them from the robot's first joint; a link of the base has none.
        """
        block = self.blocks_of(robot)[0]
        if chain.size:
            block = self.block_of_joint(self.first_joint[robot] + int(chain[0]))
        return block, chain + self.first_joint[robot] - self.first_joint_of_block[block]

    def owner_of_contact(self, contact: int) -> int:
        """Index of the owner of a contact."""
        return bisect_right(self.first_contact, contact) - 1

    def same_joints(self, layout: Layout) -> bool:
        """Whether frames and joints are the same; the contacts may differ."""
        joints = layout.names, layout.first_joint, layout.objects, layout.floating_robots
        return (self.names, self.first_joint, self.objects, self.floating_robots) == joints

    # --- parts of configurations and velocities -------------------------------------------------

    def poses(self, configuration: np.ndarray) -> np.ndarray:
        """Poses of the frames: position [m], quaternion xyzw; a view, shape (..., F, 7)."""
        return configuration[..., : 7 * self.frames].reshape(
            *configuration.shape[:-1], self.frames, 7
        )

    def quaternions(self, configuration: np.ndarray) -> np.ndarray:
        """Orientations of the frames, quaternions xyzw; a view, shape (..., F, 4)."""
        return self.poses(configuration)[..., 3:]

    def joint_positions(self, configuration: np.ndarray) -> np.ndarray:
        """Positions of all joints [rad or m]; a view, shape (..., n)."""
        return configuration[..., self._first_position :]

    def base_poses(self, configuration: np.ndarray) -> np.ndarray:
        """Poses of the floating bases, as those of the frames; a view, shape (..., B, 7)."""
        of_bases = configuration[..., 7 * self.frames : self._first_position]
        return of_bases.reshape(*configuration.shape[:-1], len(self.floating_robots), 7)

    def base_twists(self, velocity: np.ndarray) -> list[np.ndarray]:
        """What a vector like a velocity has of each floating base: views, shape (..., 6)."""
        return list(self.split_bases(self.joint_rates(velocity)).values())

    @property
    def first_of_bases(self) -> list[int]:
        """First of the six joints of each floating base."""
        return [self.first_joint[i] for i in self.floating_robots]

    def twists(self, velocity: np.ndarray) -> np.ndarray:
        """What a vector like a velocity has of the frames; a view, shape (..., F, 6)."""
        return velocity[..., self.of_frames].reshape(*velocity.shape[:-1], self.frames, TWIST)

    def joint_rates(self, velocity: np.ndarray) -> np.ndarray:
        """What a vector like a velocity has of all joints; a view, shape (..., n)."""
        return velocity[..., self.of_joints]

    @property
    def turns(self) -> list[slice]:
        """The angular part of each frame in a velocity; of a displacement, its rotation vector."""
        first = [TWIST * f for f in range(self.frames)]
        first += [TWIST * self.frames + joint for joint in self.first_of_bases]
        return [slice(at + 3, at + TWIST) for at in first]

    @property
    def of_frames(self) -> slice:
        """The frames in a velocity."""
        return slice(TWIST * self.frames)

    @property
    def of_joints(self) -> slice:
        """All joints in a velocity."""
        return slice(TWIST * self.frames, self.nv)

    def of_robot(self, i: int) -> slice:
        """The joints of a robot in a velocity."""
        first, joints = TWIST * self.frames, self.joints_of(i)
        return slice(first + joints.start, first + joints.stop)

    def of_block(self, i: int) -> slice:
        """The joints of a block in a velocity."""
        first, joints = TWIST * self.frames, self.joints_of_block(i)
        return slice(first + joints.start, first + joints.stop)

    def split_joints(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Views ``robot -> vector[..., its joints]``, without those of floating bases."""
        return {name: vector[..., self.tree_joints(i)] for i, name in enumerate(self.names)}

    def split_bases(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Views ``robot -> vector[..., its base's six numbers]`` of a vector of all joints."""
        firsts = zip(self.floating_robots, self.first_of_bases, strict=True)
        return {self.names[i]: vector[..., first : first + TWIST] for i, first in firsts}

    def tree_joints(self, i: int) -> slice:
        """Joints of a robot among all joints, without the six of a floating base."""
        first = self.first_joint[i] + (TWIST if i in self.floating_robots else 0)
        return slice(first, self.first_joint[i + 1])

    @property
    def driven_joints(self) -> np.ndarray:
        """Numbers among all joints of those that have drives."""
        return np.setdiff1d(np.arange(self.rate_count), self.undriven_joints)

    @property
    def undriven_joints(self) -> np.ndarray:
        """Numbers of joints without drives: those of floating bases, then passive ones."""
        bases = [np.arange(first, first + TWIST) for first in self.first_of_bases]
        return np.concatenate([*bases, np.array(self.passive_joints, dtype=np.int64)])

    def split_contacts(self, vector: np.ndarray) -> dict[str, np.ndarray]:
        """Views ``owner -> vector[..., its contacts]``, without the surroundings."""
        return {
            name: vector[..., self.contacts_of(c)]
            for c, name in enumerate(self.owners)
            if not of_surroundings(name)
        }

    # --- columns of derivatives -----------------------------------------------------------------

    @property
    def columns(self) -> dict[str, slice]:
        """Where the columns of derivatives by the state are."""
        first = (0, *columns_of_state(self.nv, self.rate_count))
        pairs = zip(STATE, first[:-1], first[1:], strict=True)
        return {name: slice(begin, end) for name, begin, end in pairs}

    @property
    def displacement_columns(self) -> np.ndarray:
        """The columns of a displacement, in the order of a velocity, shape (6 F + n,)."""
        columns = columns_of_state(self.nv, self.rate_count)
        return np.array([column_of_displacement(columns, l) for l in range(self.nv)])

    @property
    def velocity_columns(self) -> np.ndarray:
        """The columns of a velocity, shape (6 F + n,)."""
        columns = columns_of_state(self.nv, self.rate_count)
        return np.array([column_of_velocity(columns, l) for l in range(self.nv)])
