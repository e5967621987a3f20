"""Claims about the system in Drake, where Drake is installed."""

from __future__ import annotations

import drake_peer
import pytest
from repository import SCENES

import multiarm as ma

pytest.importorskip("pydrake", reason="Drake is not installed")


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["ring_weld", "ring_ball"])
def test_drake_is_of_order_one(scene):
    system = ma.compile_system(
        ma.load_scene(SCENES / f"{scene}.yaml").replace(run={"duration": 0.1})
    )
    coarse, fine = drake_peer.motions(system, (2e-3, 1e-3), rounds=1)
    assert coarse["error"] / fine["error"] == pytest.approx(2.0, rel=0.15)
    assert fine["error"] < 5e-3
