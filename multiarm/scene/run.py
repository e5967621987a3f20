"""How a run is carried out: how long, how accurately, by which method."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PlainSerializer, TypeAdapter, model_validator
from typing_extensions import Self

from multiarm.scene.faults import invalid, shown
from multiarm.scene.settings import (
    MEANINGS,
    ArmTerms,
    Integrator,
    Painleve,
    SolverName,
    Stabilization,
)
from multiarm.scene.spec import Spec, shorthand
from multiarm.scene.values import NonNegative, Positive
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS

STEPS_CHOSEN_BY = ("accuracy", "integrator", "step", "tolerance")
"""Settings of a run that say together how long its steps are."""
DEFAULT_ACCURACY = 1e-6
"""Aimed at in positions [m] and rotations [rad] by default."""

LONGEST_RUN, MOST_SAMPLES, MOST_FIXED_STEPS = 1e9, 1e8, 1e11
"""Simulated time [s], samples and fixed steps of a run: more of them would never end."""

_positive = TypeAdapter(Positive).validate_python


class AccuracySpec(Spec):
    """Largest error of the whole run, at the worst output time; other errors are not bounded.

    A single number in place of the table is meant for position and rotation alike, and the two
    forms compare equal: ``AccuracySpec(position=1e-6, rotation=1e-6) == 1e-6``.
    """

    position: Positive | None = None
    """Of the object's centre of mass and of sliding joints [m]."""
    rotation: Positive | None = None
    """Of the object's orientation and of turning joints [rad]."""
    force: Positive | None = None
    """Of every contact force that the equations determine [N]."""

    @model_validator(mode="after")
    def _bounds_something(self) -> Self:
        if self.position is None and self.rotation is None and self.force is None:
            raise invalid("is empty; name 'position' [m], 'rotation' [rad] or 'force' [N]")
        return self

    @property
    def smallest(self) -> float:
        """The smaller one of position and rotation; 1e-6 where only a force is named."""
        lengths = [value for value in (self.position, self.rotation) if value is not None]
        return min(lengths, default=DEFAULT_ACCURACY)

    @property
    def written(self) -> float | dict[str, float]:
        """As in a scene: one number where that is enough, else a table."""
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
        raise invalid(
            f"must be a number [m, rad] or a table with 'position', 'rotation', 'force', got "
            f"{shown(value)}"
        )
    number = _positive(value)
    return {"position": number, "rotation": number}


Accuracy = Annotated[
    AccuracySpec,
    BeforeValidator(_accuracy, json_schema_input_type=AccuracySpec | Positive),
    PlainSerializer(lambda accuracy: accuracy.written),
]


class StabilizationSpec(Spec):
    """How the joints are kept closed although integration errors add up."""

    kind: Stabilization = "projection"
    """One of :data:`STABILIZATIONS`."""
    alpha: NonNegative | None = None
    """Gain of the rates of the gaps, -2 alpha W^T v [1/s]; absent: chosen from the step."""
    beta: NonNegative | None = None
    """Gain of the gaps, -beta^2 phi [1/s]; absent: chosen from the step."""

    @model_validator(mode="after")
    def _gains_belong_to_feedback(self) -> Self:
        if self.kind != "feedback" and (self.alpha is not None or self.beta is not None):
            raise invalid(f"'alpha' and 'beta' belong to kind 'feedback', not {self.kind!r}")
        return self


class RunSpec(Spec):
    """How long and how exactly the motion is computed, and by which method."""

    duration: Positive = Field(1.0, description=MEANINGS["duration"])
    accuracy: Accuracy | None = Field(
        None,
        description=MEANINGS["accuracy"].replace(
            "[m and rad]",
            "[m and rad], or a table {position: [m], rotation: [rad], force: [N]}, some of them",
        ),
    )
    integrator: Integrator | None = Field(None, description=MEANINGS["integrator"])
    step: Positive | None = Field(None, description=MEANINGS["step"])
    tolerance: Positive | None = Field(None, description=MEANINGS["tolerance"])
    stabilization: Annotated[
        StabilizationSpec, shorthand("kind", StabilizationSpec | Stabilization, str)
    ] = Field(StabilizationSpec(), description=MEANINGS["stabilization"])
    output_step: Positive = Field(0.01, description=MEANINGS["output_step"])
    most_steps: Positive = Field(1e8, description=MEANINGS["most_steps"])
    painleve: Painleve = Field("impact", description=MEANINGS["painleve"])
    solver: SolverName = Field("node", description=MEANINGS["solver"])
    arms: ArmTerms = Field("pinocchio", description=MEANINGS["arms"])

    @model_validator(mode="before")
    @classmethod
    def _default_accuracy(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and all(data.get(key) is None for key in STEPS_CHOSEN_BY):
            return {**data, "accuracy": DEFAULT_ACCURACY}
        return data

    @model_validator(mode="after")
    def _one_way_to_choose_the_steps(self) -> Self:
        message = self._step_fault()
        if message:
            raise invalid(message)
        return self

    @model_validator(mode="after")
    def _comes_to_an_end(self) -> Self:
        sizes = (
            ("duration", self.duration, LONGEST_RUN, "s of simulated time", "shorten the run"),
            (
                "output_step", self.duration / self.output_step, MOST_SAMPLES, "samples",
                "store fewer by a longer 'output_step', or shorten the run",
            ),
            (
                "step", self.duration / (self.step or self.duration), MOST_FIXED_STEPS, "steps",
                "take a longer 'step', or shorten the run",
            ),
        )  # fmt: skip
        for name, size, most, noun, remedy in sizes:
            if size > most:
                raise invalid(
                    f"{name!r} makes {size:.3g} {noun}, at most {most:.0e} are possible; {remedy}"
                )
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
