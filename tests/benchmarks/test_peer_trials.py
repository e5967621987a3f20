"""Claims about other programs on hard cases: what they are asked, and what their answers say."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import peer_trials
import pytest
from mechanics import planar_pair, ur5_pair
from peer_trials import OURS, SOLVERS

import multiarm as ma
from multiarm.studies.peers import NOT_INSTALLED

RUN = {"duration": 0.2, "accuracy": 1e-8}
MUJOCO_IS_HERE = importlib.util.find_spec("mujoco") is not None
HARMONIC = {
    "kind": "harmonic", "frequency": 4.0,
    "amplitude": {arm: [9.0, 9.0, 9.0, 3.0, 3.0, 3.0] for arm in ("left", "right")},
}  # fmt: skip


def pair(left: str, right: str, **more):
    """Two UR5s that fall with a box."""
    return ma.compile_system(ur5_pair({"kind": left}, {"kind": right}, run=RUN, **more))


def answers_of(system, time=0.1):
    answers = peer_trials.all_answers(system, *peer_trials.state_at(system, time))
    assert [answer.solver for answer in answers] == [OURS, *SOLVERS]
    return {answer.solver: answer for answer in answers}


@pytest.fixture(scope="module")
def welded():
    return pair("weld", "weld")


@pytest.fixture(scope="module")
def answers(welded):
    """Solver -> its answer about two moving welded arms."""
    return answers_of(welded)


def test_solvers_agree_where_nothing_is_hard(answers):
    hinged = pair("revolute", "revolute", control=HARMONIC, effects={"joint_damping": 5.0})
    allowed = {OURS: 1e-11, "constraintDynamics": 1e-10, "lcaba": 1e-8}
    if MUJOCO_IS_HERE:
        allowed["MuJoCo"] = 1e-6  # hardened springs
    for of_case in (answers, answers_of(hinged)):
        for solver, tolerance in allowed.items():
            answer = of_case[solver]
            assert max(answer.object_error, answer.joint_error) < tolerance, solver
        assert of_case["MuJoCo"].refusal == ("" if MUJOCO_IS_HERE else NOT_INSTALLED)


def test_mujoco_as_shipped_is_soft(answers):
    answer = answers["MuJoCo as shipped"]
    if MUJOCO_IS_HERE:  # largest impedance 0.95: some percent of the force are missing
        assert answer.joint_error > 1e-3
    else:
        assert answer.refusal == NOT_INSTALLED


def test_a_joint_that_peers_have_not_is_refused_in_words():
    ours, *peers = answers_of(pair("weld", "point_on_plane")).values()
    assert ours.joint_error < 1e-11
    for answer in peers:
        if answer.refusal != NOT_INSTALLED:
            assert answer.refusal.startswith("cannot express it: ")
            assert "point_on_plane" in answer.refusal
        assert answer.joint_error is None


def test_without_mujoco_the_remedy_is_told(welded, monkeypatch):
    monkeypatch.delitem(sys.modules, "mujoco_solver", raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert answers_of(welded)["MuJoCo"].refusal == "not installed: pip install mujoco"


@pytest.mark.slow
def test_pinocchio_as_tuned_is_right_on_redundant_rows():
    # planar arms of two joints welded to a body: six rows for three motions, exactly dependent
    scene = planar_pair("planar_2r", [0.4, -0.8], {"kind": "weld"})
    answers = answers_of(ma.compile_system(scene.replace(run={**RUN, "solver": "dense"})))
    # at one state roundings decide: a pivot is zero, or is not
    assert answers["constraintDynamics as shipped"].accelerations in ("", "NaN")
    assert answers["constraintDynamics"].joint_error < 1e-8


def test_what_a_peer_returns_or_raises_is_told_and_never_ends_the_benchmark():
    def broken():
        raise RuntimeError("the tree is broken\nsecond line")

    reference = np.linspace(-3.0, 2.0, 18)
    answer = peer_trials.answer_of("peer", broken, reference)
    assert answer.accelerations == "the tree is broken"
    answer = peer_trials.answer_of("peer", lambda: np.full(18, np.nan), reference)
    assert (answer.accelerations, answer.object_error) == ("NaN", None)
    answer = peer_trials.answer_of("peer", lambda: reference * (1.0 + 1e-3), reference)
    assert answer.joint_error == pytest.approx(1e-3, rel=1e-9)
    assert peer_trials.answer_of("peer", lambda: reference, None).joint_error is None


def test_the_state_is_that_of_the_hardest_moment(welded):
    hardest = 0.0712345
    time, state = peer_trials.state_at(welded, hardest)
    again = ma.simulate(welded, duration=hardest)
    assert time == hardest
    assert state.object_position == pytest.approx(again.object_position[-1], abs=1e-9)
    time, state = peer_trials.state_at(welded, 0.0)
    assert np.array_equal(state.position, welded.initial_state().position)


def test_a_peer_is_spared_what_would_take_all_memory(welded, monkeypatch):
    monkeypatch.setattr(peer_trials, "MOST_MEMORY", 1e3)
    answers = answers_of(welded)
    for name in peer_trials.PINOCCHIO:
        assert answers[name].refusal.startswith("not run: Pinocchio's Data for it takes about ")
