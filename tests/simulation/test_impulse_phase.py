"""Claims about the steps of an impulse phase, with a stepper that only moves the time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from multiarm.events.impulse_steps import ImpulseStep, Point
from multiarm.events.mode import Mode
from multiarm.simulation.impulse_phase import ImpulsePhase


class _OnlyTime:
    def step(self, start: Point, h: float) -> ImpulseStep:
        nothing = np.zeros(0)
        point = Point(start.t + h, nothing, nothing, nothing, nothing)
        return ImpulseStep(point, 0.0, {}, frozenset(), solved=None)


def test_a_phase_lasts_its_least_time():
    phase = ImpulsePhase(_OnlyTime(), 0.003, ended=Mode((), ()), begin=1.0, least=0.25)
    assert phase.lasts(1.2) and not phase.lasts(1.25)


@pytest.mark.parametrize("sample", range(1, 60))
def test_steps_end_just_at_the_samples(sample):
    nothing = np.zeros(0)
    start = Point(0.005 * (sample - 1), nothing, nothing, nothing, nothing)
    run = SimpleNamespace(
        clock=SimpleNamespace(evaluations=0, step=1.0),
        settings=SimpleNamespace(adaptive=False),
    )
    phase = ImpulsePhase(_OnlyTime(), 0.003, ended=Mode((), ()), begin=0.0)
    step = phase.step(run, start, until=0.005 * sample)
    assert step.end.t < 0.005 * sample
    assert phase.step(run, step.end, until=0.005 * sample).end.t == 0.005 * sample
