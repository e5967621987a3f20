"""The kinds of control of a scene: ours, and users'.

A kind is one class: its parameters, its checks, and what people read about it.  Its law is in
:mod:`multiarm.control`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    model_validator,
)
from typing_extensions import Self

from multiarm.scene.code import UserFunction
from multiarm.scene.faults import Faults, below, invalid, listed, shown, unknown
from multiarm.scene.joint_values import (
    Gain,
    KnownRobots,
    PerArm,
    gain_faults,
    unknown_connection,
    unknown_robot,
)
from multiarm.scene.registry import AnyClass, Registry, UserKind
from multiarm.scene.spec import FilePath, Spec
from multiarm.scene.text import parse_yaml
from multiarm.scene.values import (
    NonNegative,
    Number,
    Pose,
    Positive,
    WorldAxes,
    finite_number,
    list_of,
)


class ControlKind(UserKind):
    """Base class of control kinds.

    Attributes
    ----------
    picture : str
        What it does, in a sentence of everyday words.
    example : str
        The control in YAML, as a scene has it.
    by_joint : tuple of str
        Fields with values by arm and joint, which are checked against the arms.
    """

    class_sort = "control"
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

    def paths(self, _objects: Sequence[str]) -> dict[str, tuple[Waypoint, ...]]:
        """Of the objects of a scene those that it moves, and the poses that each is to pass.

        No poses where an object is to stay.
        """
        return {}

    def faults(self, arms: KnownRobots) -> Faults:
        """Faults with respect to the arms: their places in the control, and texts."""
        return [
            fault
            for key in self.by_joint
            for fault in below((key,), gain_faults(getattr(self, key), arms))
        ]

    def faults_of_object(self, _objects: Sequence[str]) -> Faults:
        """What is wrong with the objects that it names, some of those of the scene."""
        return []

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
            raise invalid("'sample_delay' needs 'sample_time' [s], of which it is the delay")
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
        raise invalid("'path' is empty; list poses with their times or leave the key out")
    times = [waypoint.time for waypoint in path]
    for number, (before, after) in enumerate(pairwise(times), start=1):
        if after <= before:
            raise invalid(
                f"the times of 'path' must increase, but waypoint {number} comes at "
                f"{after:g} s after {before:g} s"
            )
    if times == [0.0]:
        raise invalid("'path' has one pose at time 0 and leads nowhere; add a later pose")
    return path


def _or_stay(path: Any) -> Any:
    """No poses, in a table of paths, are an empty entry."""
    return None if path in ([], ()) else path


ObjectPath = Annotated[tuple[Waypoint, ...] | None, AfterValidator(_ordered)]
PathInTable = Annotated[ObjectPath, BeforeValidator(_or_stay, json_schema_input_type=ObjectPath)]


class _OneObject(SampledControl):
    """Keys of control that moves one object."""

    object: str | None = None
    path: ObjectPath = None

    def paths(self, objects: Sequence[str]) -> dict[str, tuple[Waypoint, ...]]:
        """That of the object that it names, or of the only one."""
        return {self.object or objects[0]: self.path or ()}

    def faults_of_object(self, objects: Sequence[str]) -> Faults:
        """An object that is not there, or not named among several."""
        if self.object is not None and self.object not in objects:
            return [(("object",), unknown("object", self.object, objects))]
        if self.object is None and len(objects) > 1:
            text = f"which one does it move? Write 'object: ...', of {listed(objects)}"
            return [(("object",), text)]
        return []


class _SomeObjects(_OneObject):
    """Keys of control that moves one object or several."""

    objects: dict[str, PathInTable] | None = None

    @model_validator(mode="after")
    def _one_way_to_name_objects(self) -> Self:
        if self.objects is None:
            return self
        if not self.objects:
            raise invalid("'objects' is empty; write 'object: path', or leave the key out")
        for key in ("object", "path"):
            if getattr(self, key) is not None:
                raise invalid(f"'objects' names objects and their paths; leave '{key}' out")
        return self

    def paths(self, objects: Sequence[str]) -> dict[str, tuple[Waypoint, ...]]:
        """Those of the objects that it names, or of the only one."""
        if self.objects is None:
            return super().paths(objects)
        return {name: self.objects[name] or () for name in objects if name in self.objects}

    def faults_of_object(self, objects: Sequence[str]) -> Faults:
        """Objects that are not there, or not named among several."""
        if self.objects is None:
            return super().faults_of_object(objects)
        names = (name for name in self.objects if name not in objects)
        return [(("objects", name), unknown("object", name, objects)) for name in names]


# --- laws of the joints ---------------------------------------------------------------------------


class NoControl(ControlKind):
    """The joints are free: no torque."""

    picture = "drives switched off: the arms hang from the object and swing with it"
    example = "control: none"

    kind: Literal["none"] = "none"


class ConstantControl(ControlKind):
    """Constant torques [N m] or forces [N]; arms and joints that are not named get none."""

    picture = "every drive pushes with a torque of its own that never changes"
    example = "control: {kind: constant, torques: {left: {elbow_joint: -20}}}  # [N m]"
    by_joint = ("torques",)

    kind: Literal["constant"] = "constant"
    torques: PerArm
    """A table 'arm: torques'."""


FrictionMargin = Annotated[float, Field(ge=0.0, lt=1.0), BeforeValidator(finite_number)]


class _Carrying(SampledControl):
    """Keys of control that carries the object: how fingertips hold it by friction."""

    friction_margin: FrictionMargin | None = None
    """Count the friction of contacts that only push: forces stay within its cones, and this part of
    each coefficient of friction is not used. Absent: friction is not counted."""
    squeeze: NonNegative = 0.0
    """With ``friction_margin``: how hard fingertips press an object without weight, in the root of
    the mean square [N]; 0: a tenth of their share of the weight."""

    @model_validator(mode="after")
    def _squeeze_by_friction(self) -> Self:
        if self.squeeze > 0.0 and self.friction_margin is None:
            raise invalid(
                "'squeeze' belongs to fingertips whose friction is counted; name "
                "'friction_margin', the part of it that is not to be used, such as 0.2"
            )
        return self


class GravityCompensationControl(_Carrying):
    """The arms carry themselves and the object: torques that hold the whole system still."""

    picture = "arms and object float: a push by hand moves them, and nothing falls"
    example = "control: gravity_compensation"

    kind: Literal["gravity_compensation"] = "gravity_compensation"

    @property
    def compensates_gravity(self) -> bool:
        """Always."""
        return True


class JointPDControl(_SomeObjects, _Carrying):
    """Joint springs and dampers about a reference, which may follow paths of objects.

    Attributes
    ----------
    object : str, optional
        The one that is to follow ``path``, where there are several.
    path : list of Waypoint, optional
        Poses of the object that the reference passes. A path that does not begin at time 0 begins
        with the start pose. Absent: the reference is the start.
    objects : table of lists of Waypoint, optional
        In place of both, with several objects: a table 'object: path'. An empty entry keeps its
        object where it is.
    """

    picture = (
        "a robot that holds or follows joint angles, as with springs and dampers in its joints"
    )
    example = """
control:
  kind: joint_pd
  stiffness: 2000   # [N m/rad]
  damping: 200      # [N m s/rad]
  path: [{time: 2.5, xyz: [0, 0, 0.65]}]   # where the object goes"""
    by_joint = ("stiffness", "damping")

    kind: Literal["joint_pd"] = "joint_pd"
    stiffness: Gain
    """[N m/rad] or [N/m]: one for all joints, one per joint, or a table by arm."""
    damping: Gain
    """[N m s/rad] or [N s/m]: one for all joints, one per joint, or a table by arm."""
    gravity_compensation: bool = True
    """Add the torques that hold the whole system, arms and object, still."""

    @model_validator(mode="after")
    def _friction_carries(self) -> Self:
        if self.friction_margin is not None and not self.gravity_compensation:
            raise invalid(
                "'friction_margin' is of the forces that carry the object; leave it out, or "
                "'gravity_compensation: false'"
            )
        return self

    @property
    def compensates_gravity(self) -> bool:
        """Where ``gravity_compensation`` says so."""
        return self.gravity_compensation

    def paths(self, objects: Sequence[str]) -> dict[str, tuple[Waypoint, ...]]:
        """Those of the objects that it names, or of the only one; none without any."""
        return super().paths(objects) if self.path or self.objects else {}

    def faults_of_object(self, objects: Sequence[str]) -> Faults:
        """Objects that are not there, or a path without one among several."""
        if self.object is not None and self.path is None:
            return [(("object",), "names what follows 'path'; write a path, or leave it out")]
        names_none = self.path is None and self.objects is None
        return [] if names_none else super().faults_of_object(objects)


class HarmonicControl(SampledControl):
    """Torques offset + amplitude * sin(2 pi frequency t + phase)."""

    picture = "a shaker: torques swing as sines, such as for a test of vibrations"
    example = """
control:
  kind: harmonic
  amplitude: {left: 20}   # [N m], of every joint of this arm
  frequency: 0.5          # [Hz]"""
    by_joint = ("amplitude", "phase", "offset")

    kind: Literal["harmonic"] = "harmonic"
    amplitude: PerArm
    """A table 'arm: amplitudes', [N m] or [N]. Arms and joints that are not named get none."""
    frequency: Positive
    """Of the swing [Hz]."""
    phase: PerArm = Field(default_factory=dict)
    """[rad], 0 where it is not named."""
    offset: PerArm = Field(default_factory=dict)
    """Constant torques [N m] or forces [N], 0 where it is not named."""
    hold: bool = True
    """Add the constant torques that would hold the start at rest."""

    @property
    def carries(self) -> bool:
        """Where it holds the start."""
        return self.hold


class RecordedControl(SampledControl):
    """Torques, or references of joint springs and dampers, from a table over time."""

    picture = "a measurement is played back: torques, or joint angles to be followed, from a table"
    example = """
control:
  kind: recorded
  file: swing.csv   # columns: time [s], left/elbow_joint [N m], ..."""
    by_joint = ("stiffness", "damping")

    kind: Literal["recorded"] = "recorded"
    file: FilePath
    """A table in CSV, Parquet or HDF5: a column of times [s], which increase, and one column for
    each joint. Joints without a column get no torque, or are referred to the start."""
    time: str = "time"
    """Name of the column with the times."""
    columns: dict[str, str] | None = None
    """The columns to be used. Absent: all of them, and each is named as its joint."""
    quantity: Literal["torque", "position"] = "torque"
    """What the columns are: torques [N m, N], or positions [rad, m] to which springs and dampers
    pull."""
    interpolation: Literal["linear", "cubic", "hold"] = "linear"
    """Between two rows: a line, a spline with continuous second derivatives, or the earlier value.
    """
    outside: Literal["error", "hold", "zero"] | None = None
    """Before the first row and after the last one: a run that comes there is refused; the nearest
    row holds, at rest; there is no torque. Absent: 'error' for torques, 'hold' for positions."""
    stiffness: Gain | None = None
    """Of the springs that pull to positions [N m/rad], as with joint_pd."""
    damping: Gain | None = None
    """Of the dampers beside the springs [N m s/rad], as with joint_pd."""
    gravity_compensation: bool | None = None
    """Of positions only: add the torques that hold the whole system, arms and object, still."""

    @model_validator(mode="after")
    def _gains_belong_to_positions(self) -> Self:
        gains = {"stiffness": self.stiffness, "damping": self.damping}
        settings = {**gains, "gravity_compensation": self.gravity_compensation}
        if self.quantity == "torque":
            named = [key for key, value in settings.items() if value is not None]
            if named:
                raise invalid(f"'{named[0]}' belongs to 'quantity: position', not to torques")
            return self
        missing = [key for key, value in gains.items() if value is None]
        if missing:
            raise invalid(f"'quantity: position' needs '{missing[0]}', of the springs and dampers")
        if self.outside == "zero":
            raise invalid("'outside: zero' belongs to torques; positions are held, or end the run")
        return self

    @model_validator(mode="after")
    def _some_columns(self) -> Self:
        if self.columns is not None and not self.columns:
            raise invalid(
                "'columns' is empty; name columns as 'arm/joint: column', or leave it out"
            )
        return self

    @property
    def where_no_rows_are(self) -> str:
        """``outside`` with its default."""
        return self.outside or ("error" if self.quantity == "torque" else "hold")

    @property
    def compensates_gravity(self) -> bool:
        """``gravity_compensation`` with its default."""
        return self.quantity == "position" and self.gravity_compensation is not False

    def faults(self, arms: KnownRobots) -> Faults:
        """Gains, and columns of joints that no arm has."""
        faults = super().faults(arms)
        for address in self.columns or ():
            text = _address_fault(address, arms)
            if text:
                faults.append((("columns", address), text))
        return faults


def _address_fault(address: str, arms: KnownRobots) -> str:
    """Why ``arm/joint`` is no joint of the scene; empty when it is one."""
    arm, _, joint = address.partition("/")
    if not joint:
        return f"must be 'arm/joint', got {shown(address)}"
    if arm not in arms:
        return unknown_robot(arm, arms)
    names = arms[arm].joint_names
    return "" if names is None or joint in names else unknown("joint", joint, names)


class FunctionControl(SampledControl):
    """A controller in Python; ``kind`` may be left out."""

    picture = "your own controller: a Python function of time and state that returns torques"
    example = """
control:
  function: "controllers.py:hold"   # def hold(t, state): return {"left": [...]}
  sample_time: 0.001                # [s]; without it, called at every evaluation"""

    kind: Literal["function"] = "function"
    function: UserFunction
    """f(t, state) -> {arm: torques}, arms that it leaves out get none: a Python function, or its
    name as 'file.py:name' or 'package.module:name'."""


# --- laws of the object ---------------------------------------------------------------------------


class ObjectGain(Spec):
    """Gains for the shift and for the turn of the object, along and about the world's axes."""

    translation: WorldAxes
    """Of the shift: a number for all axes, or one each for x, y, z of the world."""
    rotation: WorldAxes
    """Of the turn: a number for all axes, or one each for x, y, z of the world."""

    def vector(self) -> np.ndarray:
        """Gains of shift and turn, shape (6,)."""
        return np.array([*self.translation, *self.rotation])


_world_axes = TypeAdapter(WorldAxes).validate_python


def _from_number(value: Any) -> Any:
    """Let one number stand for the gains of shift and turn, where both have one unit."""
    if isinstance(value, (Mapping, ObjectGain)):
        return value
    if isinstance(value, (list, tuple)):
        raise invalid(
            f"must be a number or a table (translation: ..., rotation: ...), got {shown(value)}"
        )
    gain = _world_axes(value)
    return {"translation": gain, "rotation": gain}


def _in_two_units(value: Any) -> Any:
    if isinstance(value, (Mapping, ObjectGain)):
        return value
    raise invalid(
        "must be a table (translation: ..., rotation: ...), for shift and turn have different "
        f"units, got {shown(value)}"
    )


_EITHER = BeforeValidator(_from_number, json_schema_input_type=ObjectGain | WorldAxes)
_TABLE = BeforeValidator(_in_two_units, json_schema_input_type=ObjectGain)
ContactForces = Annotated[
    tuple[Number, ...], list_of("must be a list of forces [N], one for each contact", least=1)
]


class _Hold(SampledControl):
    """Keys of both control laws: how the arms hold what they move."""

    relative_damping: NonNegative = 10.0
    """Rate at which motions of the arms that the object does not need die out [1/s]."""
    relative_stiffness: NonNegative = 0.0
    """How firmly the arms keep their place on the object where their joints leave them free, such
    as fingertips that could slide [1/s^2]; 0: nothing draws them back. With a quarter of the square
    of ``relative_damping`` they come back without overshoot."""
    squeeze: NonNegative = 0.0
    """How hard the arms press the object between them [N]: fingertips, which can only push, press
    so hard in the mean; arms with idealised joints each press so hard towards the middle of all
    grips. Of several objects, each that is moved. Where friction is counted, fingertips press so
    hard without a load, in the root of the mean square, and harder as the load needs it; 0: a tenth
    of their share of the weight."""
    friction_margin: FrictionMargin | None = None
    """Count the friction of contacts that only push: forces stay within its cones, and this part of
    each coefficient of friction is not used. Absent: friction is counted, with 0.2, where contacts
    cannot put every wrench on the object without it."""
    internal_forces: dict[str, ContactForces] | None = None
    """A table 'arm: forces' [N], one for each contact of the arm's joint, or of another by its
    name; the part that is not internal is removed."""

    def faults(self, arms: KnownRobots) -> Faults:
        """Internal forces of joints that are none."""
        return [
            (("internal_forces", name), text)
            for name in self.internal_forces or ()
            if (text := unknown_connection(name, arms))
        ]


class ComputedTorqueControl(_SomeObjects, _Hold):
    """Inverse dynamics: the object follows its path, with errors that die out at given rates.

    The object's acceleration is commanded as that of the path, plus damping times the error of the
    velocity, plus stiffness times the error of the pose. Of several objects, those that it does not
    name follow as their joints want; what the joints leave open is damped.

    Attributes
    ----------
    object : str, optional
        The one that follows ``path``, where there are several.
    path : list of Waypoint, optional
        Poses of the object, reached at rest. A path that does not begin at time 0 begins with
        the start pose. Absent: the object is held where it is.
    objects : table of lists of Waypoint, optional
        In place of both, with several objects: a table 'object: path'. An empty entry holds its
        object where it is.
    """

    picture = "an exact model drives the object along its path, whatever arms and object weigh"
    example = """
control:
  kind: computed_torque
  path: [{time: 2.0, xyz: [0, 0, 0.65]}]   # where the object goes
  stiffness: 100   # [1/s^2]
  damping: 20      # [1/s]"""

    kind: Literal["computed_torque"] = "computed_torque"
    stiffness: Annotated[ObjectGain, _EITHER] = ObjectGain(translation=100.0, rotation=100.0)
    """[1/s^2]"""
    damping: Annotated[ObjectGain, _EITHER] = ObjectGain(translation=20.0, rotation=20.0)
    """[1/s]; twice the root of the stiffness lets errors die out without overshoot."""

    @property
    def carries(self) -> bool:
        """Always: inverse dynamics takes the weight into account."""
        return True


class ObjectImpedanceControl(_OneObject, _Hold):
    """An object on a spring and a damper; robots and objects carry their own weight.

    Attributes
    ----------
    object : str, optional
        The one that the spring pulls, where there are several.
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
    stiffness: Annotated[ObjectGain, _TABLE]
    """A table {translation: [N/m], rotation: [N m/rad]}, each a number or 3 for world axes."""
    damping: Annotated[ObjectGain, _TABLE]
    """A table {translation: [N s/m], rotation: [N m s/rad]}, in the same forms."""

    @property
    def compensates_gravity(self) -> bool:
        """Always: the spring would give way under the weight."""
        return True


# --- all kinds ------------------------------------------------------------------------------------


_OURS: tuple[type[ControlKind], ...] = (
    NoControl,
    ConstantControl,
    GravityCompensationControl,
    JointPDControl,
    HarmonicControl,
    ComputedTorqueControl,
    ObjectImpedanceControl,
    RecordedControl,
    FunctionControl,
)
BUILT_IN = {control.kind_name(): control for control in _OURS}
"""Our kinds by name."""
CONTROLS: Registry[ControlKind] = Registry(
    "control", "control kind", "kinds", BUILT_IN, UnloadedControl
)
"""User kinds of control; what the class must offer says :class:`multiarm.Control`."""


def register_control(control: AnyClass) -> AnyClass:
    """Let scenes name a user kind of control, a subclass of :class:`multiarm.Control`; a decorator.

    Defined and registered once more, as notebooks do, it replaces the former one.

    Raises
    ------
    ModelError
        The class cannot be used, or another kind has its name.
    """
    return CONTROLS.add(control)


def _with_kind(value: Any) -> Any:
    """Write out ``control: gravity_compensation`` and ``control: {function: ...}``."""
    if value is None or isinstance(value, str):
        return {"kind": "none" if value is None else value}
    if isinstance(value, Mapping) and "function" in value and "kind" not in value:
        return {"kind": "function", **value}
    return value


if TYPE_CHECKING:
    ControlSpec = ControlKind
else:
    _Kinds = CONTROLS.by_kind()
    _WORDS = tuple(
        kind
        for kind, control in BUILT_IN.items()
        if not any(field.is_required() for field in control.model_fields.values())
    )
    ControlSpec = Annotated[
        _Kinds,
        BeforeValidator(
            _with_kind, json_schema_input_type=_Kinds | FunctionControl | Literal[_WORDS] | None
        ),
    ]
