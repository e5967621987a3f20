"""Claims about random scenes whose joints take hold and let go at random times.

Oracle: what holds without knowing the motion: energy, momentum and closed gaps.
"""

from __future__ import annotations

import pytest
from random_schedules import FAMILIES, SWITCH, draw, judge

ACCURACY, GAP = 1e-4, 1e-12
# Of 1,000 such scenes the energy rose by 1e-6 at the most, and the momentum changed by 1e-7.
RISE, MOMENTUM = 1e-5, 1e-6


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("family", FAMILIES)
def test_a_random_schedule_gains_no_energy_and_keeps_what_holds_closed(family, seed):
    verdict = judge(draw(family, seed), ACCURACY)
    assert verdict.end != "failed", verdict.message
    assert verdict.gained <= SWITCH
    assert verdict.driven or verdict.risen < RISE
    assert verdict.unbalanced < ACCURACY
    assert verdict.gap < GAP
    assert verdict.momentum < MOMENTUM
