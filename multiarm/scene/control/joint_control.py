"""Control laws of the joints: torques, springs and dampers, tables, and Python functions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from multiarm.scene.control.kind import ControlKind, ObjectPath, SampledControl
from multiarm.scene.faults import fault, shown, unknown
from multiarm.scene.functions import UserFunction
from multiarm.scene.values import Faults, FilePath, Gain, KnownArm, PerArm, Positive


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


class GravityCompensationControl(SampledControl):
    """The arms carry themselves and the object: torques that hold the whole system still."""

    picture = "arms and object float: a push by hand moves them, and nothing falls"
    example = "control: gravity_compensation"

    kind: Literal["gravity_compensation"] = "gravity_compensation"

    @property
    def compensates_gravity(self) -> bool:
        """Always."""
        return True


class JointPDControl(SampledControl):
    """Joint springs and dampers about a reference, which may follow a path of the object."""

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
    path: ObjectPath = None
    """Poses of the object that the reference passes. A path that does not begin at time 0 begins
    with the start pose. Absent: the reference is the start."""

    @property
    def compensates_gravity(self) -> bool:
        """Where ``gravity_compensation`` says so."""
        return self.gravity_compensation


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
    """Of positions only: [N m/rad], [N m s/rad], as with joint_pd."""
    damping: Gain | None = None
    """Of positions only: [N m/rad], [N m s/rad], as with joint_pd."""
    gravity_compensation: bool | None = None
    """Of positions only: add the torques that hold the whole system, arms and object, still."""

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

    def faults(self, arms: Mapping[str, KnownArm]) -> Faults:
        """Gains, and columns of joints that no arm has."""
        found = super().faults(arms)
        for address in self.columns or ():
            text = _address_fault(address, arms)
            if text:
                found.append((("columns", address), text))
        return found


def _address_fault(address: str, arms: Mapping[str, KnownArm]) -> str:
    """Why ``arm/joint`` is no joint of the scene; empty when it is one."""
    arm, _, joint = address.partition("/")
    if not joint:
        return f"must be 'arm/joint', got {shown(address)}"
    if arm not in arms:
        return unknown("arm", arm, arms)
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
