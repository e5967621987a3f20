"""Claims about the box that goes from arm to arm, beside MuJoCo's welds."""

from __future__ import annotations

import pytest

import multiarm as ma
from multiarm.scene import parse_scene

pytest.importorskip("mujoco", reason="MuJoCo is not installed")

import hand_over

STEPS = (2e-3, 1e-3)


@pytest.fixture(scope="module")
def system(tmp_path_factory):
    table = tmp_path_factory.mktemp("hand_over") / "references.csv"
    return ma.compile_system(parse_scene(hand_over.scene(table)))


@pytest.fixture(scope="module")
def rows(system):
    """Figures of both programs, by program and step."""
    return {(row["program"], row["step"]): row for row in hand_over.compare(system, STEPS, 1)}


def test_the_certificate_is_met_and_not_below_the_error(system, rows):
    run = ma.simulate(system, accuracy=hand_over.ACCURACY)
    ours = rows[hand_over.OURS, None]
    assert run.certificate["met"]
    assert ours["error_m"] < run.certificate["estimated_error"]["position_m"]
    assert ours["error_rad"] < run.certificate["estimated_error"]["rotation_rad"]


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


def test_the_cost_of_a_switch_is_measured(system):
    costs = hand_over.switch_costs(system)
    assert costs.keys() == {"take hold", "let go"} and min(costs.values()) > 0.0
