"""Settings of a run, and the ladders of them that a study climbs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from multiarm.studies.peers import Peer
from multiarm.tableaus import (
    ADAPTIVE_INTEGRATORS,
    FIXED_STEP_INTEGRATORS,
    METHODS,
    VARIATIONAL,
)

OURS = "multiarm"
BY_ACCURACY = "accuracy"
"""The method of settings that name an accuracy only: the program chooses the rest."""
STABILIZATIONS = ("projection", "feedback", "none")
DECADES_OF_ACCURACY = range(1, 13)
DECADES_OF_TOLERANCE = range(2, 14)
HALVINGS = 24
"""Most halvings of a step; time limit and rounding errors end a ladder long before."""
COARSEST = 8.0
"""The first fixed step, at most, in units of the reference's average step."""
UNITS = {"step": "s", "tolerance": "", "accuracy": ""}


@dataclass(frozen=True)
class Setting:
    """How a run is done.

    Attributes
    ----------
    solver : str
        The program: ``multiarm``, or a peer with what matters of its options.
    method : str
        Integrator; ``accuracy`` where the program chooses it.
    stabilization : str
        Empty where there is none to choose.
    knob : {"step", "tolerance", "accuracy"}
        What is varied.
    value : float
        [s] for a step.
    """

    solver: str
    method: str
    stabilization: str
    knob: str
    value: float

    @property
    def ours(self) -> bool:
        """Whether it is a setting of this program."""
        return self.solver == OURS

    @property
    def series(self) -> str:
        """The method in words: what all settings of a ladder have in common."""
        if not self.ours:
            return f"{self.solver}, {self.method}"
        if self.method == BY_ACCURACY:
            return "chosen by accuracy"
        return f"{self.method}, {self.stabilization}" if self.stabilization else self.method

    @property
    def knob_text(self) -> str:
        """``step 0.0025 s``"""
        return f"{self.knob} {short(self.value)} {UNITS[self.knob]}".rstrip()

    @property
    def text(self) -> str:
        """The setting in words."""
        return f"{self.series}, {self.knob_text}"

    @property
    def key(self) -> str:
        """The setting as one word, different for different settings."""
        parts = (self.solver, self.method, self.stabilization, f"{self.knob}={self.value:.12g}")
        return "/".join(parts)

    @property
    def options(self) -> dict[str, Any]:
        """The setting as options of ``simulate``."""
        options: dict[str, Any] = {self.knob: self.value}
        if self.method != BY_ACCURACY:
            options["integrator"] = self.method
        return {**options, "stabilization": self.stabilization or "projection"}


@dataclass(frozen=True)
class Ladder:
    """Settings of one method, from coarse to fine."""

    settings: tuple[Setting, ...]

    @property
    def series(self) -> str:
        """The method in words."""
        return self.settings[0].series


def our_ladders(output_step: float, duration: float, average: float) -> list[Ladder]:
    """All methods of this program, with each stabilisation that goes with them.

    Parameters
    ----------
    output_step, duration : float
        [s]
    average : float
        Average step of the reference [s], from which the fixed steps follow.
    """
    ladders = [_ladder(OURS, BY_ACCURACY, "", "accuracy", _powers(DECADES_OF_ACCURACY))]
    tolerances = _powers(DECADES_OF_TOLERANCE)
    steps = halved_steps(output_step, min(COARSEST * average, duration / 4.0))
    for names, knob, values in (
        (ADAPTIVE_INTEGRATORS, "tolerance", tolerances),
        (FIXED_STEP_INTEGRATORS, "step", steps),
    ):
        for name in names:
            # a variational method keeps the joints closed itself
            for kind in ("",) if METHODS[name].kind == VARIATIONAL else STABILIZATIONS:
                ladders.append(_ladder(OURS, name, kind, knob, values))
    return ladders


def peer_ladders(peers: Mapping[str, Peer], interval: float, average: float) -> list[Ladder]:
    """The settings of all methods of peers by name; steps divide the time between two outputs.

    ``average`` is the reference's average step [s].
    """
    steps = halved_steps(interval, min(COARSEST * average, interval))
    values = {"step": steps, "tolerance": _powers(DECADES_OF_TOLERANCE)}
    return [
        _ladder(name, method, "", knob, values[knob])
        for name, peer in peers.items()
        for method, knob in peer.methods.items()
    ]


def halved_steps(output_step: float, coarsest: float) -> tuple[float, ...]:
    """The output step, doubled or halved to at most ``coarsest``, and then halved again and again.

    Every step that is not longer than the output step divides it.
    """
    first = math.floor(math.log2(coarsest / output_step) + 1e-9)
    return tuple(math.ldexp(output_step, first - k) for k in range(HALVINGS))


def short(value: float) -> str:
    """A number as one would type it: ``1e-6``, ``0.0025``."""
    if value and (abs(value) < 1e-3 or abs(value) >= 1e5):
        mantissa, exponent = f"{value:.6e}".split("e")
        mantissa = mantissa.rstrip("0").rstrip(".")
        return f"{mantissa}e{int(exponent)}"
    return f"{value:.7g}"


def _powers(decades: range) -> tuple[float, ...]:
    return tuple(float(f"1e-{k}") for k in decades)


def _ladder(solver: str, method: str, kind: str, knob: str, values: tuple[float, ...]) -> Ladder:
    return Ladder(tuple(Setting(solver, method, kind, knob, value) for value in values))
