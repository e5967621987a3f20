"""Control laws: torques by joint, and laws in terms of the object's path and stiffness."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, model_validator
from typing_extensions import Self

from multiarm.scene.faults import fault, shown
from multiarm.scene.values import (
    ArmName,
    Gain,
    NonNegative,
    Number,
    PerArm,
    Pose,
    Positive,
    Spec,
    WorldAxes,
    list_of,
)


class Waypoint(Pose):
    """A pose of the object to be passed at ``time`` [s]."""

    time: NonNegative = Field(description="the time in seconds at which the pose is passed")


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


class SampledControl(Spec):
    """Keys of all control that changes with time or state.

    Attributes
    ----------
    sample_time : float, optional
        The torques are computed every ``sample_time`` [s] only, from the state at that time, and
        held in between, as by a digital controller. Absent: they are computed all the time.
    sample_delay : bool
        Torques act one sample later; those of the start act until the second sample.
    """

    sample_time: Positive | None = None
    sample_delay: bool = False

    @model_validator(mode="after")
    def _delay_belongs_to_samples(self) -> Self:
        if self.sample_delay and self.sample_time is None:
            raise fault("'sample_delay' needs 'sample_time' [s], of which it is the delay")
        return self


class NoControl(Spec):
    """The joints are free: no torque."""

    kind: Literal["none"] = "none"


class ConstantControl(Spec):
    """Constant torques [N m] or forces [N]; arms and joints that are not named get none."""

    kind: Literal["constant"] = "constant"
    torques: PerArm = Field(description="a table 'arm: torques'")


class GravityCompensationControl(SampledControl):
    """The arms carry themselves and the object: torques that hold the whole system still."""

    kind: Literal["gravity_compensation"] = "gravity_compensation"


class JointPDControl(SampledControl):
    """Joint springs and dampers about a reference, which may follow a path of the object.

    Attributes
    ----------
    stiffness : number, list or table
        [N m/rad] or [N/m]: one for all joints, one per joint, or a table by arm.
    damping : number, list or table
        [N m s/rad] or [N s/m], in the same forms.
    gravity_compensation : bool
        Add the torques that hold the whole system, arms and object, still.
    path : list of Waypoint, optional
        Poses of the object that the reference passes. A path that does not begin at time 0
        begins with the start pose. Absent: the reference is the start.
    """

    kind: Literal["joint_pd"] = "joint_pd"
    stiffness: Gain = Field(description="N m/rad: a number, a list or a table by arm")
    damping: Gain = Field(description="N m s/rad: a number, a list or a table by arm")
    gravity_compensation: bool = True
    path: ObjectPath = None


class HarmonicControl(SampledControl):
    """Torques offset + amplitude * sin(2 pi frequency t + phase).

    Attributes
    ----------
    amplitude : table 'arm: values'
        [N m] or [N]; arms and joints that are not named get none.
    frequency : float
        [Hz]
    phase : table 'arm: values'
        [rad], 0 where it is not named.
    offset : table 'arm: values'
        Constant torques [N m] or forces [N], 0 where it is not named.
    hold : bool
        Add the constant torques that would hold the start at rest.
    """

    kind: Literal["harmonic"] = "harmonic"
    amplitude: PerArm = Field(description="a table 'arm: amplitudes'")
    frequency: Positive = Field(description="in Hz")
    phase: PerArm = Field(default_factory=dict)
    offset: PerArm = Field(default_factory=dict)
    hold: bool = True


class ObjectGain(Spec):
    """Gains for the shift and for the turn of the object, along and about the world's axes.

    Attributes
    ----------
    translation, rotation : number or 3 numbers
        One for all axes, or one each for x, y, z of the world.
    """

    translation: WorldAxes = Field(description="a number, or 3 for the world's axes")
    rotation: WorldAxes = Field(description="a number, or 3 for the world's axes")

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
    relative_stiffness: NonNegative = 0.0
    squeeze: NonNegative = 0.0
    internal_forces: dict[ArmName, ContactForces] | None = None


class ComputedTorqueControl(_ObjectControl):
    """Inverse dynamics: the object follows its path, with errors that die out at given rates.

    The object's acceleration is commanded as that of the path, plus damping times the error of the
    velocity, plus stiffness times the error of the pose.

    Attributes
    ----------
    path : list of Waypoint, optional
        Poses of the object, reached at rest. A path that does not begin at time 0 begins with
        the start pose. Absent: the object is held where it is.
    stiffness : number or {translation, rotation}
        [1/s^2]
    damping : number or {translation, rotation}
        [1/s]; twice the root of the stiffness lets errors die out without overshoot.
    relative_damping : number
        Rate at which motions of the arms that the object does not need die out [1/s].
    relative_stiffness : number
        How firmly the arms keep their place on the object where their joints leave them free, such
        as fingertips that could slide [1/s^2]; 0: nothing draws them back. With a quarter of the
        square of ``relative_damping`` they come back without overshoot.
    squeeze : number
        How hard the arms press the object between them [N]: fingertips, which can only push,
        press so hard in the mean; arms with idealised joints each press so hard towards the
        middle of all grips.
    internal_forces : table 'arm: forces'
        [N], one for each contact of the arm's joint; the part that is not internal is removed.
    """

    kind: Literal["computed_torque"] = "computed_torque"
    stiffness: Annotated[ObjectGain, BeforeValidator(_from_number)] = ObjectGain(
        translation=100.0, rotation=100.0
    )
    damping: Annotated[ObjectGain, BeforeValidator(_from_number)] = ObjectGain(
        translation=20.0, rotation=20.0
    )


class ObjectImpedanceControl(_ObjectControl):
    """The object on a spring and a damper; arms and object carry their own weight.

    Attributes
    ----------
    stiffness : {translation, rotation}
        [N/m] and [N m/rad], along and about the world's axes.
    damping : {translation, rotation}
        [N s/m] and [N m s/rad].
    path : list of Waypoint, optional
        Where the spring pulls to. A path that does not begin at time 0 begins with the start
        pose. Absent: the start pose.
    relative_damping : number
        Rate at which motions of the arms that the object does not need die out [1/s].
    relative_stiffness, squeeze, internal_forces
        As with computed torque.
    """

    kind: Literal["object_impedance"] = "object_impedance"
    stiffness: Annotated[ObjectGain, BeforeValidator(_in_two_units)] = Field(
        description="a table (translation: N/m, rotation: N m/rad), a number or 3 each"
    )
    damping: Annotated[ObjectGain, BeforeValidator(_in_two_units)] = Field(
        description="a table (translation: N s/m, rotation: N m s/rad), a number or 3 each"
    )


class RecordedControl(SampledControl):
    """Torques, or references of joint springs and dampers, from a table over time.

    Attributes
    ----------
    file : path
        A table in CSV, Parquet or HDF5: a column of times [s], which increase, and one column for
        each joint. Joints without a column get no torque, or are referred to the start.
    time : str
        Name of the column with the times.
    columns : table 'arm/joint: column', optional
        The columns to be used. Absent: all of them, and each is named as its joint.
    quantity : 'torque' or 'position'
        What the columns are: torques [N m, N], or positions [rad, m] to which springs and dampers
        pull.
    interpolation : 'linear', 'cubic' or 'hold'
        Between two rows: a line, a spline with continuous second derivatives, or the earlier value.
    outside : 'error', 'hold' or 'zero', optional
        Before the first row and after the last one: a run that comes there is refused; the nearest
        row holds, at rest; there is no torque. Absent: 'error' for torques, 'hold' for positions.
    stiffness, damping : number, list or table
        Of positions only: [N m/rad], [N m s/rad], as with joint_pd.
    gravity_compensation : bool
        Of positions only: add the torques that hold the whole system, arms and object, still.
    """

    kind: Literal["recorded"] = "recorded"
    file: Path = Field(description="a table in CSV, Parquet or HDF5")
    time: str = "time"
    columns: dict[str, str] | None = None
    quantity: Literal["torque", "position"] = "torque"
    interpolation: Literal["linear", "cubic", "hold"] = "linear"
    outside: Literal["error", "hold", "zero"] | None = None
    stiffness: Gain | None = None
    damping: Gain | None = None
    gravity_compensation: bool | None = None

    @model_validator(mode="after")
    def _gains_belong_to_positions(self) -> Self:
        gains = {"stiffness": self.stiffness, "damping": self.damping}
        given = {**gains, "gravity_compensation": self.gravity_compensation}
        if self.quantity == "torque":
            named = [key for key, value in given.items() if value is not None]
            if named:
                raise fault(f"'{named[0]}' belongs to 'quantity: position', not to torques")
            return self
        missing = [key for key, value in gains.items() if value is None]
        if missing:
            raise fault(f"'quantity: position' needs '{missing[0]}', of the springs and dampers")
        if self.outside == "zero":
            raise fault("'outside: zero' belongs to torques; positions are held, or end the run")
        return self

    @model_validator(mode="after")
    def _some_columns(self) -> Self:
        if self.columns is not None and not self.columns:
            raise fault("'columns' is empty; name columns as 'arm/joint: column', or leave it out")
        return self

    @property
    def where_no_rows_are(self) -> str:
        """``outside`` with its default."""
        return self.outside or ("error" if self.quantity == "torque" else "hold")

    @property
    def compensates_gravity(self) -> bool:
        """``gravity_compensation`` with its default."""
        return self.quantity == "position" and self.gravity_compensation is not False


def _by_name(value: Any) -> Any:
    """Let ``control: gravity_compensation`` stand for ``control: {kind: ...}``."""
    name = "none" if value is None else value
    return {"kind": name} if isinstance(name, str) else value


ControlSpec = Annotated[
    NoControl
    | ConstantControl
    | GravityCompensationControl
    | JointPDControl
    | HarmonicControl
    | ComputedTorqueControl
    | ObjectImpedanceControl
    | RecordedControl,
    Field(discriminator="kind"),
    BeforeValidator(_by_name),
]
