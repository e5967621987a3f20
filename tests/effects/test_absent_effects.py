"""Claims about scenes without effects: nothing of an absent effect is imported, kept or called."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter

import pinocchio
import pytest
from mechanics import (
    data_of,
)
from repository import ROOT, SCENES
from timing import slope_burst

import multiarm as ma
from multiarm.dynamics.arrays import EFFECTS

RING = ma.load_scene(SCENES / "ring_weld.yaml")
BARE = RING.replace(gravity=None, control={"kind": "none"})


class Counting:
    """Pinocchio, whose functions are counted when they are called."""

    def __init__(self) -> None:
        self.calls: Counter[str] = Counter()

    def __getattr__(self, name: str):
        value = getattr(pinocchio, name)
        if isinstance(value, type) or not callable(value):
            return value

        def counted(*arguments):
            self.calls[name] += 1
            return value(*arguments)

        return counted


@pytest.fixture
def pinocchio_calls(monkeypatch):
    """Function ``scene, count -> calls``: Pinocchio's functions in so many evaluations."""
    counting = Counting()
    monkeypatch.setattr("multiarm.robots.backends.pin", counting)

    def calls(scene: ma.Scene, count: int) -> Counter[str]:
        system = ma.compile_system(scene)
        ma.evaluate(system)
        burst = slope_burst(data_of(system))
        counting.calls.clear()
        burst(count)
        return counting.calls.copy()

    return calls


def array_count(system: ma.System) -> int:
    return len(data_of(system).struct) // 4


def test_a_scene_without_effects_has_no_piece_and_no_array_of_one():
    system = ma.compile_system(BARE)
    assert len(system.model.constants.effects) == 0
    constants = system.model.constants
    assert constants.passive_end == constants.actuator_end == constants.applied_end == 0
    assert array_count(system) == EFFECTS
    assert data_of(system).arrays.effects.states.size == 0
    assert data_of(system).arrays.effects.power.size == 1, "of the control"
    assert set(data_of(system).callbacks) == {
        "pinocchio",
        "dense",
        "coupled",
        "decomposed",
        "near_singular",
        "solve_again",
        "general_rows",
        "command",
    }
    run = ma.simulate(system, 0.02)
    assert not [name for name in run.channels if name.startswith("effects/")]


def test_an_effect_has_its_arrays_and_no_other_one_has():
    system = ma.compile_system(BARE.replace(effects={"joint_damping": 1.0}))
    assert array_count(system) == EFFECTS + 2
    assert (
        data_of(system).effect("joint_damping").coefficients.tolist()
        == [1.0] * system.model.layout.rate_count
    )


def test_an_evaluation_calls_of_pinocchio_what_the_effects_need(pinocchio_calls):
    bare = pinocchio_calls(BARE, 10)
    assert bare == {"crba": 10, "nonLinearEffects": 10}, "all arms are one model"
    assert pinocchio_calls(BARE.replace(effects={"joint_damping": 1.0}), 10) == bare
    held = BARE.replace(gravity=[0, 0, -9.81], control={"kind": "gravity_compensation"})
    assert pinocchio_calls(held, 10) == {**bare, "computeGeneralizedGravity": 10}


def test_runs_with_and_without_the_key_do_the_same_work_to_the_last_digit():
    runs = [
        ma.simulate(ma.compile_system(scene), 0.1) for scene in (BARE, BARE.replace(effects={}))
    ]
    for key in ("steps", "rejected_steps", "evaluations", "projections"):
        assert runs[0].statistics[key] == runs[1].statistics[key]
    assert (runs[0].object_position == runs[1].object_position).all()


@pytest.mark.slow
def test_of_all_effects_only_those_of_the_scene_are_imported():
    code = (
        "import json, sys, pkgutil, multiarm as ma, multiarm.effects\n"
        f"scene = ma.load_scene({str(SCENES / 'ring_weld.yaml')!r})\n"
        f"ma.simulate(ma.compile_system(scene.replace(effects={{'joint_damping': 1.0}})), 0.02)\n"
        "known = set(type(scene.effects).model_fields)\n"
        "names = {module.name for module in pkgutil.iter_modules(multiarm.effects.__path__)}\n"
        "loaded = {n for n in names if f'multiarm.effects.{n}' in sys.modules}\n"
        "print(json.dumps([sorted(known & loaded), sorted(loaded - known)]))"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    ours, rest = json.loads(result.stdout)
    assert ours == ["joint_damping"]
    assert rest == ["building", "unilateral"]
