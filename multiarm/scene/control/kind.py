"""Base classes of control kinds: what a kind says about itself, and keys that many share."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, ClassVar

from pydantic import AfterValidator, ConfigDict, model_validator
from typing_extensions import Self

from multiarm.scene.faults import fault
from multiarm.scene.registry import OwnKind
from multiarm.scene.text import parse_yaml
from multiarm.scene.values import Faults, KnownArm, NonNegative, Pose, Positive, below, gain_faults


class ControlKind(OwnKind):
    """Base class of control kinds; their laws are in :mod:`multiarm.control`.

    Attributes
    ----------
    picture : str
        What it does, in a sentence of everyday words.
    example : str
        The control in YAML, as a scene has it.
    by_joint : tuple of str
        Fields with values by arm and joint, which are checked against the arms.
    """

    by_joint: ClassVar[tuple[str, ...]] = ()

    kind: str

    @property
    def compensates_gravity(self) -> bool:
        """Whether its torques carry the arms, whose gravity forces it needs at every evaluation."""
        return False

    @property
    def carries(self) -> bool:
        """Whether its torques carry arms and object at the start."""
        return self.compensates_gravity

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Faults with respect to the arms: their places in the control, and texts."""
        found = ((key, gain_faults(getattr(self, key), arms)) for key in self.by_joint)
        return [one for key, faults in found for one in below((key,), faults)]

    @classmethod
    def sample(cls) -> Self:
        """The control of the example."""
        entry = parse_yaml(cls.example)["control"]
        return cls.model_validate({"kind": entry} if isinstance(entry, str) else entry)


class SampledControl(ControlKind):
    """Keys of all control that changes with time or state."""

    sample_time: Positive | None = None
    """The torques are computed every ``sample_time`` [s] only, from the state at that time, and
    held in between, as by a digital controller. Absent: they are computed all the time."""
    sample_delay: bool = False
    """Torques act one sample later; those of the start act until the second sample."""

    @model_validator(mode="after")
    def _delay_belongs_to_samples(self) -> Self:
        if self.sample_delay and self.sample_time is None:
            raise fault("'sample_delay' needs 'sample_time' [s], of which it is the delay")
        return self


class UnloadedControl(SampledControl):
    """A control of a class that is not loaded, with its parameters as they are written."""

    model_config = ConfigDict(extra="allow")


# --- paths of the object --------------------------------------------------------------------------


class Waypoint(Pose):
    """A pose of the object to be passed at ``time`` [s]."""

    time: NonNegative
    """The time in seconds at which the pose is passed."""


def _ordered(path: tuple[Waypoint, ...] | None) -> tuple[Waypoint, ...] | None:
    if path is None:
        return None
    if not path:
        raise fault("'path' is empty; list poses with their times or leave the key out")
    times = [waypoint.time for waypoint in path]
    for number, (before, after) in enumerate(pairwise(times), start=1):
        if after <= before:
            raise fault(
                f"the times of 'path' must increase, but waypoint {number} comes at "
                f"{after:g} s after {before:g} s"
            )
    if times == [0.0]:
        raise fault("'path' has one pose at time 0 and leads nowhere; add a later pose")
    return path


ObjectPath = Annotated[tuple[Waypoint, ...] | None, AfterValidator(_ordered)]
