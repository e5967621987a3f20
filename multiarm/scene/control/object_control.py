"""Control laws in terms of the object's path and stiffness."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, TypeAdapter

from multiarm.scene.control.kind import ObjectPath, SampledControl
from multiarm.scene.faults import fault, shown, unknown
from multiarm.scene.values import (
    ArmName,
    Faults,
    KnownArm,
    NonNegative,
    Number,
    Spec,
    WorldAxes,
    list_of,
)


class ObjectGain(Spec):
    """Gains for the shift and for the turn of the object, along and about the world's axes."""

    translation: WorldAxes
    """A number for all axes, or one each for x, y, z of the world."""
    rotation: WorldAxes
    """A number for all axes, or one each for x, y, z of the world."""

    def vector(self) -> np.ndarray:
        """Gains of shift and turn, shape (6,)."""
        return np.array([*self.translation, *self.rotation])


_world_axes = TypeAdapter(WorldAxes).validate_python


def _from_number(value: Any) -> Any:
    """Let one number stand for the gains of shift and turn, where both have one unit."""
    if isinstance(value, (Mapping, ObjectGain)):
        return value
    if isinstance(value, (list, tuple)):
        raise fault(
            f"must be a number or a table (translation: ..., rotation: ...), got {shown(value)}"
        )
    gain = _world_axes(value)
    return {"translation": gain, "rotation": gain}


def _in_two_units(value: Any) -> Any:
    if isinstance(value, (Mapping, ObjectGain)):
        return value
    raise fault(
        "must be a table (translation: ..., rotation: ...), for shift and turn have different "
        f"units, got {shown(value)}"
    )


ContactForces = Annotated[
    tuple[Number, ...], list_of("must be a list of forces [N], one for each contact", least=1)
]


class _ObjectControl(SampledControl):
    """Keys of both control laws."""

    path: ObjectPath = None
    relative_damping: NonNegative = 10.0
    """Rate at which motions of the arms that the object does not need die out [1/s]."""
    relative_stiffness: NonNegative = 0.0
    """How firmly the arms keep their place on the object where their joints leave them free, such
    as fingertips that could slide [1/s^2]; 0: nothing draws them back. With a quarter of the square
    of ``relative_damping`` they come back without overshoot."""
    squeeze: NonNegative = 0.0
    """How hard the arms press the object between them [N]: fingertips, which can only push, press
    so hard in the mean; arms with idealised joints each press so hard towards the middle of all
    grips."""
    internal_forces: dict[ArmName, ContactForces] | None = None
    """A table 'arm: forces' [N], one for each contact of the arm's joint; the part that is not
    internal is removed."""

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Internal forces of arms that are none."""
        return [
            (("internal_forces", arm), unknown("arm", arm, arms))
            for arm in self.internal_forces or ()
            if arm not in arms
        ]


class ComputedTorqueControl(_ObjectControl):
    """Inverse dynamics: the object follows its path, with errors that die out at given rates.

    The object's acceleration is commanded as that of the path, plus damping times the error of the
    velocity, plus stiffness times the error of the pose.

    Attributes
    ----------
    path : list of Waypoint, optional
        Poses of the object, reached at rest. A path that does not begin at time 0 begins with
        the start pose. Absent: the object is held where it is.
    """

    picture = "an exact model drives the object along its path, whatever arms and object weigh"
    example = """
control:
  kind: computed_torque
  path: [{time: 2.0, xyz: [0, 0, 0.65]}]   # where the object goes
  stiffness: 100   # [1/s^2]
  damping: 20      # [1/s]"""

    kind: Literal["computed_torque"] = "computed_torque"
    stiffness: Annotated[ObjectGain, BeforeValidator(_from_number)] = ObjectGain(
        translation=100.0, rotation=100.0
    )
    """[1/s^2]"""
    damping: Annotated[ObjectGain, BeforeValidator(_from_number)] = ObjectGain(
        translation=20.0, rotation=20.0
    )
    """[1/s]; twice the root of the stiffness lets errors die out without overshoot."""


class ObjectImpedanceControl(_ObjectControl):
    """The object on a spring and a damper; arms and object carry their own weight.

    Attributes
    ----------
    path : list of Waypoint, optional
        Where the spring pulls to. A path that does not begin at time 0 begins with the start
        pose. Absent: the start pose.
    """

    picture = "the object hangs on a spring and a damper, and gives way when something pushes it"
    example = """
control:
  kind: object_impedance
  stiffness: {translation: 2000, rotation: 200}   # [N/m], [N m/rad]
  damping: {translation: 400, rotation: 40}       # [N s/m], [N m s/rad]"""

    kind: Literal["object_impedance"] = "object_impedance"
    stiffness: Annotated[ObjectGain, BeforeValidator(_in_two_units)]
    """A table {translation: [N/m], rotation: [N m/rad]}, each a number or 3 for world axes."""
    damping: Annotated[ObjectGain, BeforeValidator(_in_two_units)]
    """A table {translation: [N s/m], rotation: [N m s/rad]}, in the same forms."""

    @property
    def compensates_gravity(self) -> bool:
        """Always: the spring would give way under the weight."""
        return True
