"""How accurate a run shall be: one number, or one each for positions, rotations and forces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer, model_validator
from typing_extensions import Self

from multiarm.scene.base import Spec
from multiarm.scene.values import Positive, fault, positive
from multiarm.scene.words import shown

__all__ = ["DEFAULT_ACCURACY", "Accuracy", "AccuracySpec"]

DEFAULT_ACCURACY = 1e-6
"""Aimed at in positions [m] and rotations [rad] when nothing else is asked for."""


class AccuracySpec(Spec):
    """Largest error of the whole run, at the worst output time; what is not named is not asked.

    A single number in place of the table is meant for position and rotation alike, and the two
    forms compare equal: ``AccuracySpec(position=1e-6, rotation=1e-6) == 1e-6``.

    Attributes
    ----------
    position : float, optional
        Of the object's centre of mass and of sliding joints [m].
    rotation : float, optional
        Of the object's orientation and of turning joints [rad].
    force : float, optional
        Of every contact force that the equations determine [N].
    """

    position: Positive | None = None
    rotation: Positive | None = None
    force: Positive | None = None

    @model_validator(mode="after")
    def _something_is_asked(self) -> Self:
        if self.position is None and self.rotation is None and self.force is None:
            raise fault("asks for nothing; name 'position' [m], 'rotation' [rad] or 'force' [N]")
        return self

    @property
    def smallest(self) -> float:
        """The smaller one of position and rotation; 1e-6 where only a force is asked."""
        lengths = [value for value in (self.position, self.rotation) if value is not None]
        return min(lengths, default=DEFAULT_ACCURACY)

    @property
    def written(self) -> float | dict[str, float]:
        """As a scene would say it: one number where that is enough, else a table."""
        if self.force is None and self.position is not None and self.position == self.rotation:
            return self.position
        values = {"position": self.position, "rotation": self.rotation, "force": self.force}
        return {name: value for name, value in values.items() if value is not None}

    def __eq__(self, other: object) -> bool:
        if isinstance(other, AccuracySpec):
            return self.written == other.written
        return self.written == other if isinstance(other, (int, float, Mapping)) else NotImplemented

    def __hash__(self) -> int:
        written = self.written
        return hash(tuple(written.items()) if isinstance(written, dict) else written)


def _accuracy(value: Any) -> Any:
    """Let a number stand for a table in which it is both position and rotation."""
    if value is None or isinstance(value, (Mapping, AccuracySpec)):
        return value
    if isinstance(value, (str, list, tuple, bool)):
        raise fault(
            f"must be a number [m, rad] or a table with 'position', 'rotation', 'force', got "
            f"{shown(value)}"
        )
    number = positive(value)
    return {"position": number, "rotation": number}


Accuracy = Annotated[
    AccuracySpec,
    BeforeValidator(_accuracy),
    PlainSerializer(lambda accuracy: accuracy.written),
]
