"""Connections: pairs of bodies between which rows act, and the links that take part.

The forces of a connection act on its second body; the first one takes the opposite.  The bodies are
the links of robots that carry tips, the objects and the world, in this order in
``BodyVariables.motion``.  A row's column of W is not zero for the joints of the *chain* of its link
only, those between the base and the link.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiarm.dynamics.layout import Layout
from multiarm.geometry.records import Placement
from multiarm.jit.structs import Ints1, Ints2
from multiarm.robots.robot import AT_REST, Robot, Tip
from multiarm.scene.bodies import WORLD, BodyName, object_named
from multiarm.scene.values import floor_owner


@dataclass(frozen=True)
class Connection:
    """Two bodies that are connected; forces act on the second one."""

    name: str
    first: BodyName
    second: BodyName

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots whose links take part: none, one or two."""
        return tuple(dict.fromkeys(body.robot for body in (self.first, self.second) if body.robot))

    @property
    def recorded_with(self) -> str:
        """The robot among whose results it is recorded, the first body's; empty without robots."""
        return next(iter(self.robots), "")

    @property
    def on_object(self) -> bool:
        """Whether its second body is an object."""
        return self.second.is_object

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects among its bodies."""
        return tuple(body.tip for body in (self.first, self.second) if body.is_object)

    @property
    def of_object(self) -> bool:
        """Whether an object is one of its bodies."""
        return bool(self.objects)


class Links(NamedTuple):
    """The L links that carry tips, robot after robot."""

    block: Ints1  # (L,) of the joints that move a link
    chain: Ints2  # (L, d) these joints, counted from the block's first
    length: Ints1  # (L,) of the chain


class Connections(NamedTuple):
    """The C owners of rows; those that are no connection have the world as both bodies."""

    block: Ints1  # (C,)
    first: Ints1  # (C,) bodies
    second: Ints1
    # (C,) whether the chain of the first body is the whole block, and no second one has columns
    serial: Ints1
    # (C,) the robot among whose results they are recorded; the number of robots where there is none
    robot: Ints1


def surroundings_of(objects: Sequence[str]) -> dict[str, Connection]:
    """Connections of the objects with their surroundings, by the owners of their rows."""
    owners = {name: floor_owner(name, objects) for name in objects}
    return {o: Connection(o, WORLD, object_named(name)) for name, o in owners.items()}


class BodyTable:
    """Numbers of the bodies of a scene.

    Parameters
    ----------
    robots : mapping of str to Robot
    links : sequence of (int, int)
        See ``Backends.links``.
    layout : Layout
    """

    def __init__(
        self, robots: Mapping[str, Robot], links: Sequence[tuple[int, int]], layout: Layout
    ) -> None:
        self.robots, self._names, self._links = robots, list(robots), list(links)
        self._layout = layout

    @property
    def count(self) -> int:
        """Number of bodies."""
        return len(self._links) + self._layout.frames + 1

    def number(self, body: BodyName) -> int:
        """Place of a body among all."""
        if body.is_link:
            joint = self.tip(body).joint
            return self._links.index((self._names.index(body.robot), joint))
        objects = self._layout.objects
        return len(self._links) + (objects.index(body.tip) if body.is_object else len(objects))

    def tip(self, body: BodyName) -> Tip:
        """The tip of a link; a frame at rest for another body."""
        return self.robots[body.robot].tips[body.tip] if body.is_link else AT_REST

    def placement(self, body: BodyName) -> Placement:
        """The frame of a body's tip in that of the joint that moves it."""
        tip = self.tip(body)
        return tip.rotation, tip.translation

    def links(self) -> Links:
        """The links with their chains."""
        layout, count = self._layout, len(self._links)
        chains = np.zeros((count, max(layout.joint_counts)), dtype=np.int64)
        block, length = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
        robots = list(self.robots.values())
        for k, (robot, joint) in enumerate(self._links):
            chain = next(t.chain for t in robots[robot].tips.values() if t.joint == joint)
            block[k], chain = layout.chain_in_block(robot, chain)
            chains[k, : chain.size], length[k] = chain, chain.size
        return Links(block, chains, length)

    def connections(self, pairs: Mapping[str, Connection]) -> Connections:
        """The table of the owners of rows."""
        layout, owners = self._layout, self._layout.owners
        world = self.number(WORLD)
        numbers = np.full((5, len(owners)), world, dtype=np.int64)
        table = Connections(*numbers)
        table.block[:], table.serial[:], table.robot[:] = layout.block_of, 0, len(self._names)
        for c, owner in enumerate(owners):
            if owner not in pairs:
                if owner in self._names:
                    table.robot[c] = self._names.index(owner)
                continue
            pair = pairs[owner]
            if pair.recorded_with:
                table.robot[c] = self._names.index(pair.recorded_with)
            table.first[c], table.second[c] = self.number(pair.first), self.number(pair.second)
            if pair.first.is_link and not pair.second.is_link:
                chain, joints = self.tip(pair.first).chain, layout.joint_counts[layout.block_of[c]]
                table.serial[c] = int(chain.size == joints)
        return table
