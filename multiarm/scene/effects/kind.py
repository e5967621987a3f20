"""The base class of effects: what an effect says about itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from pydantic import BeforeValidator

from multiarm.scene.faults import Faults, unknown
from multiarm.scene.joint_values import KnownRobots
from multiarm.scene.parameters import summary_of
from multiarm.scene.spec import Spec

if TYPE_CHECKING:
    from multiarm.scene.object import ObjectSpec


class EffectKind(Spec):
    """Base class of the parameters of our effects.

    What each one does to the model stands in ``multiarm/effects/<name>.py``.

    Attributes
    ----------
    name : str
        Key of the effect in scenes.
    reads : BeforeValidator, optional
        Lets other values, of its ``json_schema_input_type``, stand for the table in a scene.
    picture : str
        What it adds, in a sentence of everyday words.
    example : str
        The effect in YAML, as a scene has it.
    usual : number, str or dict, optional
        Typical parameters, where they are the same in all scenes.
    can_open : bool
        Whether it always has events, see :attr:`has_events`.
    has_states : bool
        Whether it has states besides positions and velocities.
    of_pushing : bool
        Whether it acts on contacts that only push, and on nothing else.
    """

    name: ClassVar[str] = ""
    reads: ClassVar[BeforeValidator | None] = None
    picture: ClassVar[str] = ""
    example: ClassVar[str] = ""
    usual: ClassVar[Any] = None
    can_open: ClassVar[bool] = False
    has_states: ClassVar[bool] = False
    of_pushing: ClassVar[bool] = False

    @classmethod
    def entry(cls) -> Any:
        """The type of what a scene has below the name."""
        if cls.reads is None:
            return cls
        written = cls.reads.json_schema_input_type | cls
        return Annotated[cls, replace(cls.reads, json_schema_input_type=written)]

    @classmethod
    def meaning(cls) -> str:
        """What people read about the name."""
        return summary_of(cls)

    @property
    def has_events(self) -> bool:
        """Whether contacts and joints open, close, slide, stop or give way by it."""
        return self.can_open

    @classmethod
    def typical(cls, _body: ObjectSpec) -> Any:
        """Typical parameters, as in a scene, to estimate its influence; None if there are none.

        They are first guesses, and do not replace measured parameters.
        """
        return cls.usual

    def faults(self, _arms: KnownRobots) -> Faults:
        """Faults with respect to the arms."""
        return []

    def warnings(self, _arms: KnownRobots) -> Faults:
        """Warnings about probable mistakes."""
        return []


class OfObjects(EffectKind):
    """An effect of the objects of a scene, or of one of them."""

    object: str | None = None
    """The object that it is of; absent: every object."""

    def is_of(self, name: str) -> bool:
        """Whether it is of the object with this name."""
        return self.object in (None, name)

    def faults(self, arms: KnownRobots) -> Faults:
        """An object that is none."""
        if self.object is None or self.object in arms.objects:
            return []
        return [(("object",), unknown("object", self.object, arms.objects))]


def or_only(key: str, written: Any, *further_keys: str) -> BeforeValidator:
    """Let the value of one key, which may be a table itself, stand for the effect's table.

    A table with ``key`` or one of the ``further_keys`` is the effect's; ``written`` is the type of
    the key's value.
    """

    def table(value: Any) -> Any:
        if value is None or isinstance(value, EffectKind):
            return value
        if isinstance(value, Mapping) and set(value) & {key, *further_keys}:
            return value
        return {key: value}

    return BeforeValidator(table, json_schema_input_type=written)
