"""Claims about the box that goes from arm to arm, beside MuJoCo's welds."""

from __future__ import annotations

import pytest

import multiarm as ma
from multiarm.scene import parse_scene

pytest.importorskip("mujoco", reason="MuJoCo is not installed")

import hand_over

STEPS = (2e-3, 1e-3)


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Figures of both programs, by program and step."""
    table = tmp_path_factory.mktemp("hand_over") / "references.csv"
    system = ma.compile_system(parse_scene(hand_over.scene(table)))
    return {(row["program"], row["step"]): row for row in hand_over.compare(system, STEPS, 1)}


def test_ours_has_its_accuracy_and_no_gaps(rows):
    ours = rows[hand_over.OURS, None]
    assert ours["gap_m"] < 1e-12
    assert ours["gap_rad"] < 1e-12
    assert max(ours["error_m"], ours["error_rad"]) < hand_over.ACCURACY
    assert ours["jump_error_N_s"] < 1e-6


@pytest.mark.parametrize("program", ["MuJoCo, solref 2 dt", "MuJoCo, hardened, RK4"])
def test_mujoco_tends_to_our_motion(rows, program):
    coarse, fine = (rows[program, step] for step in STEPS)
    for figure in ("gap_m", "error_m", "error_rad", "jump_error_N_s"):
        assert fine[figure] < 0.7 * coarse[figure], figure
    assert fine["error_m"] < 1e-3


def test_mujoco_as_shipped_gives_way(rows):
    shipped = [rows["MuJoCo as shipped", step] for step in STEPS]
    assert all(row["gap_m"] > 1e-3 for row in shipped)
