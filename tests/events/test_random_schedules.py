"""Claims about random scenes whose joints take hold and let go at random times.

Oracle: what holds without knowing the motion: energy, momentum and closed gaps.
"""

from __future__ import annotations

import pytest
from random_schedules import FAMILIES, draw, judge

ACCURACY = 1e-4


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("family", FAMILIES)
def test_a_random_schedule_gains_no_energy_and_keeps_what_holds_closed(family, seed):
    verdict = judge(draw(family, seed), ACCURACY)
    assert verdict.faults(ACCURACY) == []
    assert verdict.unbalanced < ACCURACY


@pytest.mark.slow
def test_a_run_whose_control_counts_on_open_contacts_says_so():
    """Gravity compensation throws the box: it carries it with contacts that have opened."""
    verdict = judge(draw("pads", 23), ACCURACY)
    assert verdict.end == "lost grip", verdict.message
    assert "by 'left', 'right'," in verdict.message
