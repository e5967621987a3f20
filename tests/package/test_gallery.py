"""Robots can do what the scenes that we show do: no drive, speed or range is beyond its limit."""

from __future__ import annotations

import pytest
from repository import ROOT

import multiarm as ma
from multiarm.results.limit_use import joint_uses, limit_warnings, peaks

SHOWN = sorted(
    path for folder in ("scenes", "solved") for path in (ROOT / "examples" / folder).glob("*.yaml")
)


@pytest.mark.slow
@pytest.mark.parametrize("scene", SHOWN, ids=lambda path: path.stem)
def test_scenes_that_are_shown_stay_within_the_limits_of_their_robots(scene):
    run = ma.simulate(ma.compile_system(ma.load_scene(scene)), certificate=False)
    largest = peaks(joint_uses(run))
    assert run.status == "completed"
    assert limit_warnings(largest) == []
    assert largest["speed"] is not None, "this scene has limits to keep"
