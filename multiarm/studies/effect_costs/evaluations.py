"""The cost of each effect in one evaluation: time, arrays, states, rows, calls into Python.

The scene is compiled once more without each of its effects, and evaluations of all these systems at
the start are timed in interleaved bursts.  The differences are the costs of the effects.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from multiarm.assembly.compilation import compile_system
from multiarm.dynamics.system import System
from multiarm.events.evaluation import evaluate_data, mode_at
from multiarm.events.modes import Mode
from multiarm.simulation.inspection import EffectFacts
from multiarm.studies.effect_costs.entries import paired_difference
from multiarm.studies.effect_costs.variants import left_out
from multiarm.studies.evaluation_costs import slope_burst
from multiarm.studies.records import error_text
from multiarm.studies.timing import Burst, measure, one_thread

TURNS = 40
"""Bursts of about a millisecond, of every system."""
OUTSIDE_EVALUATIONS = {"pinocchio_energy", "coriolis"}
"""Functions in Python that samples or one method call, evaluations never."""


def effects_of_evaluation(system: System, turns: int = TURNS) -> dict[str, EffectFacts]:
    """Measure what each effect of a system adds to an evaluation at its start.

    Parameters
    ----------
    system : System
    turns : int
        Bursts of each, at most.

    Returns
    -------
    dict of str to EffectFacts
        By effect, gravity among them; empty for a scene that has none.
    """
    others: dict[str, System] = {}
    found: dict[str, EffectFacts] = {}
    bursts: dict[str, Burst] = {}
    variants = left_out(system.scene)
    for variant in variants:
        try:
            other = compile_system(variant.scene())
            bursts[variant.name] = _burst_at_start(other)
            others[variant.name] = other
        except Exception as error:  # one that fails must not hide the others
            found[variant.name] = EffectFacts(trouble=f"not without it: {error_text(error)}")
    if not others:
        return found
    bursts[""] = _burst_at_start(system)
    with one_thread():
        times = measure(bursts, turns)
    own = _Size.of(system)
    for name, other in others.items():
        turns_of_both = min(len(times[""]), len(times[name]))
        cost = paired_difference(times[""][:turns_of_both], times[name][:turns_of_both])
        less = _Size.of(other)
        found[name] = EffectFacts(
            microseconds=1e6 * cost.value,
            uncertainty_microseconds=1e6 * cost.uncertainty,
            bytes=own.bytes - less.bytes,
            states=own.states - less.states,
            rows=own.rows - less.rows,
            callbacks=own.callbacks - less.callbacks,
        )
    return {variant.name: found[variant.name] for variant in variants}


def _burst_at_start(system: System) -> Burst:
    """Evaluations at the start; with unilateral contacts, in the contact mode of the start."""
    data, start = system.model.data(), system.initial_state()
    evaluate_data(data, 0.0, start)
    if system.model.unilateral is None:
        return slope_burst(data)
    mode = mode_at(data, 0.0, start)
    return partial(_in_mode, mode, slope_burst(mode.data))


def _in_mode(_mode: Mode, burst: Burst, count: int) -> None:
    """Call a burst; the mode is here to stay alive, since kernels reach it by its address."""
    burst(count)


@dataclass(frozen=True)
class _Size:
    """What a system has."""

    bytes: int
    states: int
    rows: int
    callbacks: int

    @classmethod
    def of(cls, system: System) -> _Size:
        data = system.model.data()
        holders = (system.model.constants, data.arrays, data.work, data.coupled, *data.effects)
        arrays = [a for holder in holders for a in holder if isinstance(a, np.ndarray)]
        return cls(
            # some arrays have two names
            bytes=sum({id(array): array.nbytes for array in arrays}.values()),
            states=system.model.effects.states,
            rows=system.model.layout.contacts,
            callbacks=len(data.callbacks.keys() - OUTSIDE_EVALUATIONS),
        )
