"""The bodies of a scene by name: objects, the world, and links of robots.

A joint is written as ``arm: NAME``, between the tip of an arm or robot and an object, or as
``between: [first, second]``.  Forces of the joint act on the second body, the first takes the
opposite.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True)
class BodyName:
    """A body, as a joint names it.

    Attributes
    ----------
    robot : str
        The arm or robot whose link it is; empty for objects and for the world.
    tip : str
        The tip, or the link, of a robot; empty for the only tip of an arm; where there is no robot,
        the name of the object, or ``world``.
    """

    robot: str
    tip: str

    def __str__(self) -> str:
        return f"{self.robot}/{self.tip}" if self.robot and self.tip else self.robot or self.tip

    @property
    def is_link(self) -> bool:
        """Whether it is a link of an arm or robot."""
        return bool(self.robot)

    @property
    def is_object(self) -> bool:
        """Whether it is an object."""
        return not self.robot and self != WORLD


WORLD = BodyName("", "world")
OBJECT_NAME = "object"
"""The object of a scene that has one, below its key ``object``."""


def object_named(name: str) -> BodyName:
    """The object with this name."""
    return BodyName("", name)


def body_named(text: str, objects: Collection[str]) -> BodyName:
    """The body with this name in ``between``; ``objects`` are the names of the scene's objects."""
    if text == str(WORLD):
        return WORLD
    return object_named(text) if text in objects else tip_named(text)


def tip_named(text: str) -> BodyName:
    """The tip with this name in ``arm``: ``arm``, or ``robot/tip``."""
    robot, slash, tip = text.partition("/")
    if slash and not (robot and tip):  # no arm or robot has a name with a slash
        return BodyName(text, "")
    return BodyName(robot, tip)


def connection_name(arm: str, between: tuple[str, str] | None, name: str | None) -> str:
    """The name of a joint's contact rows in results: its tip's, else its own, else its bodies'."""
    if between is None:
        return arm
    return name or "-".join(between)
