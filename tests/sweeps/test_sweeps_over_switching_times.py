"""Claims about runs of one scene with other times at which joints take hold and let go.

Oracle: two carts that couple go on with the speed that their momentum gives them.
"""

from __future__ import annotations

import numpy as np
import pytest
from timed_scenes import carts

import multiarm as ma
from multiarm.scene import parse_scene

SPEED, OTHER, DURATION = 0.4, -0.7, 0.6
CARRIED, MASS = 4.0, 2.0  # [kg] of the object with its cart, of the other one


def coupling(**times):
    rails = {
        "a": {"mass": 1.0, "velocity": SPEED, "x": -0.3},
        "b": {"mass": MASS, "velocity": OTHER, "x": 0.5, "joint": times},
    }
    return parse_scene(carts(SPEED, rails))


def place_at_end(couples):
    """Where the object is."""
    after = (CARRIED * SPEED + MASS * OTHER) / (CARRIED + MASS)
    return SPEED * couples + after * (DURATION - couples)


@pytest.mark.parametrize(
    "axis", [{"linspace": [0.1, 0.3, 3]}, [0.1, 0.25], {"uniform": [0.1, 0.4]}]
)
def test_a_sweep_over_a_time(axis, tmp_path):
    over = {"joints[1].from": axis}
    sweep = ma.sweep(
        coupling(**{"from": 0.3, "until": 0.55}), over, out=tmp_path / "s.sweep", keep=["final_x"],
        workers=1, duration=DURATION, repeat=1 + ("uniform" in axis),
    )  # fmt: skip
    times, ends = sweep.table["joints[1].from"], sweep.table["final_x"]
    assert len(set(times)) == len(times) > 1
    np.testing.assert_allclose(ends, [place_at_end(t) for t in times], atol=1e-9)


def test_a_sweep_over_kinds_of_times(tmp_path):
    """Times, never, several times; and when it lets go, as an axis beside it."""
    over = {
        "joints[1].from": [0.2, [[0.2, 0.3], [0.5, "never"]], "never"],
        "joints[1].until": [None],
    }
    sweep = ma.sweep(
        coupling(**{"from": 0.3}), over, out=tmp_path / "s.sweep", keep=["final_x"], workers=1,
        duration=DURATION,
    )  # fmt: skip
    ends = sweep.table["final_x"]
    expected = [place_at_end(0.2), place_at_end(0.2), place_at_end(DURATION)]
    np.testing.assert_allclose(ends, expected, atol=1e-9)


def test_many_runs_with_other_times():
    system = ma.compile_system(coupling(**{"from": 0.3, "until": 0.55}))
    times = [{"joints[1].from": 0.1}, {"joints[1].from": 0.45, "joints[1].until": 0.5}]
    runs = ma.simulate_many(system, parameters=times, duration=DURATION)
    ends = [run.object_position[-1, 0] for run in runs]
    np.testing.assert_allclose(ends, [place_at_end(0.1), place_at_end(0.45)], atol=1e-9)
