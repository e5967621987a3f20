"""The base class of effects: what an effect says about itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from multiarm.scene.values import Faults, KnownArm, Spec

if TYPE_CHECKING:
    from multiarm.scene.object import ObjectSpec


class EffectKind(Spec):
    """Base class of the parameters of our effects.

    What each one does to the model stands in ``multiarm/effects/<name>.py``.

    Attributes
    ----------
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

    picture: ClassVar[str] = ""
    example: ClassVar[str] = ""
    usual: ClassVar[Any] = None
    can_open: ClassVar[bool] = False
    has_states: ClassVar[bool] = False
    of_pushing: ClassVar[bool] = False

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

    def faults(self, _arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms."""
        return []

    def warnings(self, _arms: Mapping[str, KnownArm]) -> Faults:
        """Warnings about probable mistakes."""
        return []
