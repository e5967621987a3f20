"""Settings of a study, and the ladders that it climbs.

A *setting* says how a run is done; a *ladder* is the settings of one method from coarse to fine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from multiarm.notation import short
from multiarm.studies.peers import Peer
from multiarm.tableaus import ADAPTIVE_INTEGRATORS, FIXED_STEP_INTEGRATORS, METHODS, VARIATIONAL

OURS = "multiarm"
BY_ACCURACY = "accuracy"
"""The method of settings that name an accuracy only: the program chooses the rest."""
STABILIZATIONS = ("projection", "feedback", "none")
ACCURACIES = tuple(float(f"1e-{k}") for k in range(1, 13))
TOLERANCES = tuple(float(f"1e-{k}") for k in range(2, 14))
HALVINGS = 24
"""Most halvings of a step; time limit and rounding errors end a ladder long before."""
COARSEST = 8.0
"""The first fixed step, at most, in units of the reference's average step."""


class Setting(NamedTuple):
    """How a run is done."""

    solver: str  # multiarm, or a peer with what matters of its options
    method: str  # integrator; BY_ACCURACY where the program chooses it
    stabilization: str  # empty where there is none to choose
    knob: str  # what is varied: step, tolerance, accuracy
    value: float  # [s] for a step

    @property
    def series(self) -> str:
        """The method in words: what all settings of a ladder have in common."""
        if self.solver != OURS:
            return f"{self.solver}, {self.method}"
        if self.method == BY_ACCURACY:
            return "chosen by accuracy"
        return f"{self.method}, {self.stabilization}" if self.stabilization else self.method

    @property
    def knob_text(self) -> str:
        """``step 0.0025 s``"""
        return f"{self.knob} {short(self.value)}{' s' if self.knob == 'step' else ''}"

    @property
    def text(self) -> str:
        """The setting in words."""
        return f"{self.series}, {self.knob_text}"

    @property
    def key(self) -> str:
        """The setting as one word, different for different settings."""
        parts = (self.solver, self.method, self.stabilization, f"{self.knob}={self.value:.12g}")
        return "/".join(parts)

    def advice(self, used: str) -> str:
        """The setting as advice, ``accuracy 1e-5 (dop853, projection)``; ``used`` is the integrator
        where the program chose it."""
        if self.solver != OURS:
            return f"{self.knob_text} ({self.solver}, {self.method})"
        if self.method == BY_ACCURACY:
            return f"{self.knob_text} ({used}, projection)"
        kind = "no stabilization" if self.stabilization == "none" else self.stabilization
        return f"{self.knob_text} ({', '.join(filter(None, (self.method, kind)))})"

    @property
    def options(self) -> dict[str, Any]:
        """The setting as options of ``simulate``."""
        chosen = {} if self.method == BY_ACCURACY else {"integrator": self.method}
        stabilization = self.stabilization or "projection"
        return {self.knob: self.value, **chosen, "stabilization": stabilization}


Ladder = tuple[Setting, ...]
"""Settings of one method, from coarse to fine."""


def our_ladders(output_step: float, duration: float, average: float) -> list[Ladder]:
    """All methods of this program, with each stabilisation that goes with them.

    Parameters
    ----------
    output_step, duration : float
        [s]
    average : float
        Average step of the reference [s], from which the fixed steps follow.
    """
    ladders = [_ladder(OURS, BY_ACCURACY, "", "accuracy", ACCURACIES)]
    steps = halved_steps(output_step, min(COARSEST * average, duration / 4.0))
    for names, knob, values in (
        (ADAPTIVE_INTEGRATORS, "tolerance", TOLERANCES),
        (FIXED_STEP_INTEGRATORS, "step", steps),
    ):
        for name in names:
            # a variational method keeps the joints closed itself
            for kind in ("",) if METHODS[name].kind == VARIATIONAL else STABILIZATIONS:
                ladders.append(_ladder(OURS, name, kind, knob, values))
    return ladders


def peer_ladders(peers: Mapping[str, Peer], interval: float, average: float) -> list[Ladder]:
    """The settings of all methods of peers by name; steps divide the time between two outputs."""
    steps = halved_steps(interval, min(COARSEST * average, interval))
    values = {"step": steps, "tolerance": TOLERANCES}
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


def _ladder(solver: str, method: str, kind: str, knob: str, values: Sequence[float]) -> Ladder:
    return tuple(Setting(solver, method, kind, knob, value) for value in values)
