"""What drives the arms, and how the run is carried out."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from typing_extensions import Self

from multiarm.scene.accuracy import DEFAULT_ACCURACY, Accuracy, AccuracySpec
from multiarm.scene.base import Spec
from multiarm.scene.object_control import (
    ComputedTorqueControl,
    ObjectImpedanceControl,
    ObjectPath,
    Waypoint,
)
from multiarm.scene.values import Gain, NonNegative, PerArm, Positive, fault

__all__ = [
    "ADAPTIVE_INTEGRATORS",
    "ARM_TERMS",
    "DEFAULT_ACCURACY",
    "FIXED_STEP_INTEGRATORS",
    "STEPS_CHOSEN_BY",
    "AccuracySpec",
    "ComputedTorqueControl",
    "ConstantControl",
    "ControlSpec",
    "GravityCompensationControl",
    "HarmonicControl",
    "JointPDControl",
    "NoControl",
    "ObjectImpedanceControl",
    "RunSpec",
    "StabilizationSpec",
    "Waypoint",
]

FIXED_STEP_INTEGRATORS = ("semi_implicit_euler", "variational", "rk4")
ADAPTIVE_INTEGRATORS = ("dopri5", "dop853", "rodas5p")
STEPS_CHOSEN_BY = ("accuracy", "integrator", "step", "tolerance")
"""Settings of a run that say together how long its steps are."""
ARM_TERMS = ("pinocchio", "compiled")
"""Who computes inertia, forces and motion of the arms."""


class NoControl(Spec):
    """The joints are free: no torque."""

    kind: Literal["none"] = "none"


class ConstantControl(Spec):
    """Constant torques [N m] or forces [N]; arms and joints that are not named get none."""

    kind: Literal["constant"] = "constant"
    torques: PerArm = Field(description="a table 'arm: torques'")


class GravityCompensationControl(Spec):
    """The arms carry themselves and the object: torques that hold the whole system still."""

    kind: Literal["gravity_compensation"] = "gravity_compensation"


class JointPDControl(Spec):
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


class HarmonicControl(Spec):
    """Torques amplitude * sin(2 pi frequency t + phase).

    Attributes
    ----------
    amplitude : table 'arm: values'
        [N m] or [N]; arms and joints that are not named get none.
    frequency : float
        [Hz]
    phase : table 'arm: values'
        [rad], 0 where it is not named.
    hold : bool
        Add the constant torques that would hold the start at rest.
    """

    kind: Literal["harmonic"] = "harmonic"
    amplitude: PerArm = Field(description="a table 'arm: amplitudes'")
    frequency: Positive = Field(description="in Hz")
    phase: PerArm = Field(default_factory=dict)
    hold: bool = True


def _from_name(value: Any) -> Any:
    """Let ``control: gravity_compensation`` stand for ``control: {kind: ...}``."""
    return {"kind": value} if isinstance(value, str) else value


def _control(value: Any) -> Any:
    return {"kind": "none"} if value is None else _from_name(value)


ControlSpec = Annotated[
    NoControl
    | ConstantControl
    | GravityCompensationControl
    | JointPDControl
    | HarmonicControl
    | ComputedTorqueControl
    | ObjectImpedanceControl,
    Field(discriminator="kind"),
    BeforeValidator(_control),
]


class StabilizationSpec(Spec):
    """How the joints are kept closed although integration errors add up.

    Attributes
    ----------
    kind : 'projection', 'feedback' or 'none'
        ``projection`` returns position and velocity to the constraints after each step;
        ``feedback`` adds -2 alpha W^T v - beta^2 phi to the constraint accelerations.
    alpha, beta : float, optional
        Gains of the feedback [1/s]; absent: chosen from the step.
    """

    kind: Literal["projection", "feedback", "none"] = "projection"
    alpha: NonNegative | None = None
    beta: NonNegative | None = None

    @model_validator(mode="after")
    def _gains_belong_to_feedback(self) -> Self:
        if self.kind != "feedback" and (self.alpha is not None or self.beta is not None):
            raise fault(f"'alpha' and 'beta' belong to kind 'feedback', not {self.kind!r}")
        return self


class RunSpec(Spec):
    """How long and how exactly the motion is computed.

    Attributes
    ----------
    duration : float
        [s]
    accuracy : AccuracySpec or float, optional
        Largest error of the whole run at the worst output time: a number [m and rad], or a table
        ``{position: [m], rotation: [rad], force: [N]}`` of what is asked. The program chooses
        method and steps, checks the result against a tightened rerun and repeats the run with
        smaller tolerances if need be. 1e-6 when nothing else is asked for.
    integrator : str, optional
        ``semi_implicit_euler``, ``variational`` or ``rk4`` with ``step``; ``dopri5``, ``dop853``
        or ``rodas5p`` with ``tolerance`` (per step) or ``accuracy``.  Absent: chosen, and exchanged
        for ``rodas5p`` where the scene turns out to be stiff.
    step : float, optional
        Fixed step [s].
    tolerance : float, optional
        Error tolerance per step of an adaptive integrator.
    stabilization : StabilizationSpec or its kind
        How drift off the joints is prevented.
    output_step : float
        Time between stored samples [s].
    most_steps : float
        Steps for one second of simulated time (for the whole run, if that is shorter): a run that
        needs more at the pace of its last thousands of steps, rejected ones and events counted,
        fails instead of going on for hours.
    solver : 'node' or 'dense'
        The node algorithm, or the whole linear system at once (for comparison).
    arms : 'pinocchio' or 'compiled'
        Who computes inertia, forces and motion of the arms: Pinocchio, or compiled code, which is
        several times as fast and verified against Pinocchio whenever the scene is compiled.  An arm
        that cannot be compiled stays with Pinocchio and says so.
    """

    duration: Positive = 1.0
    accuracy: Accuracy | None = None
    integrator: (
        Literal["semi_implicit_euler", "variational", "rk4", "dopri5", "dop853", "rodas5p"] | None
    ) = None
    step: Positive | None = None
    tolerance: Positive | None = None
    stabilization: Annotated[StabilizationSpec, BeforeValidator(_from_name)] = StabilizationSpec()
    output_step: Positive = 0.01
    most_steps: Positive = 1e8
    solver: Literal["node", "dense"] = "node"
    arms: Literal["pinocchio", "compiled"] = "pinocchio"

    @model_validator(mode="before")
    @classmethod
    def _default_accuracy(cls, data: Any) -> Any:
        if isinstance(data, dict) and all(data.get(key) is None for key in STEPS_CHOSEN_BY):
            return {**data, "accuracy": DEFAULT_ACCURACY}
        return data

    @model_validator(mode="after")
    def _one_way_to_choose_the_steps(self) -> Self:
        message = self._step_fault()
        if message:
            raise fault(message)
        return self

    def _step_fault(self) -> str | None:
        if self.accuracy is not None and self.step is not None:
            return "'accuracy' and 'step' exclude each other; keep the one that you mean"
        if self.accuracy is not None and self.tolerance is not None:
            return "'accuracy' and 'tolerance' exclude each other; keep the one that you mean"
        if self.integrator is None and self.step is not None:
            return f"'step' needs an integrator of fixed step: {_or(FIXED_STEP_INTEGRATORS)}"
        if self.integrator is None and self.tolerance is not None:
            return f"'tolerance' needs an adaptive integrator: {_or(ADAPTIVE_INTEGRATORS)}"
        if self.integrator == "variational" and self.stabilization.kind == "feedback":
            return "'variational' keeps the joints closed itself; remove 'stabilization: feedback'"
        if self.integrator in FIXED_STEP_INTEGRATORS:
            return self._fixed_step_fault()
        if self.step is not None:
            return (
                f"{self.integrator!r} chooses its own steps; remove 'step' or use "
                f"{_or(FIXED_STEP_INTEGRATORS)}"
            )
        return None

    def _fixed_step_fault(self) -> str | None:
        if self.accuracy is not None or self.tolerance is not None:
            return (
                f"{self.integrator!r} has a fixed step and cannot aim at 'accuracy' or "
                f"'tolerance'; give 'step' instead, or use {_or(ADAPTIVE_INTEGRATORS)}"
            )
        if self.step is None:
            return f"{self.integrator!r} has a fixed step: add 'step', for example 'step: 0.001'"
        if self.step > self.duration:
            return f"'step' is {self.step:g} s, longer than the run of {self.duration:g} s"
        return None


def _or(names: tuple[str, ...]) -> str:
    return " or ".join(repr(name) for name in names)
