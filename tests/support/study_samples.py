"""Results of studies with chosen numbers, for tests of commands and of pages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from commands import MACHINE

from multiarm.problems import ring_of_arms
from multiarm.results.outcome import Outcome
from multiarm.results.sinks import MemoryStore
from multiarm.results.trajectory import Trajectory
from multiarm.studies.effect_costs import (
    CANDIDATE,
    FORCE,
    JOINTS,
    PATH,
    PRESENT,
    SETTING,
    TURN,
    Change,
    Entry,
    Estimate,
    Ledger,
)
from multiarm.studies.reference import QUANTITIES, Reference
from multiarm.studies.settings import BY_ACCURACY, OURS, Setting
from multiarm.studies.work_precision import COMPLETED, FAILED, Point, Study


def law(solver: str, method: str, kind: str, order: int, cost: float) -> list[Point]:
    """Points of a method of some order; its cost is that of a step, in seconds."""
    found = []
    for k in range(6):
        step = 0.02 / 2**k
        error = step**order
        errors = {"position": error, "rotation": 2 * error, "joints": 3 * error}
        errors["force"] = None if solver != OURS else 100 * error
        found.append(
            Point(
                Setting(solver, method, kind, "step", step), COMPLETED, wall_time_s=cost / step,
                steps=round(1 / step), evaluations=4 * round(1 / step), errors=errors,
                gap_m=error / 10, gap_rate_m_per_s=None, energy_J=None if solver != OURS else error,
            )
        )  # fmt: skip
    return found


def no_samples() -> Trajectory:
    """A run that recorded nothing."""
    store = MemoryStore((), np.empty((0, 0)), {})
    return Trajectory(store, Outcome("completed", ""))


def sample_accuracy() -> Study:
    """A study with two methods of ours, a peer's, a failed setting and a peer that is not there."""
    study = Study.of(ring_of_arms(2).replace(name="arms & <disc>"))
    check = {"solver": "dense", "integrator": "dopri5", "tolerance": 1e-13}
    about = {"integrator": "dop853", "tolerance": 1e-14, "check": check}
    digits = dict.fromkeys(QUANTITIES, 1e-13)
    study.reference = Reference(no_samples(), {}, digits, 0.01, 0.01, about)
    by_accuracy = Setting(OURS, BY_ACCURACY, "", "accuracy", 1e-9)
    first = law(OURS, "rk4", "projection", 4, 1e-5)
    points = (
        replace(
            first[0], setting=by_accuracy, used="dop853", errors=dict.fromkeys(QUANTITIES, 0.0)
        ),
        *first,
        *law(OURS, "rk4", "none", 4, 0.7e-5),
        *law("MuJoCo", "Euler", "", 1, 2e-5),
        Point(Setting(OURS, "rk4", "none", "step", 0.5), FAILED, "it went <apart>"),
    )
    study.points = {point.setting.key: point for point in points}
    study.machine, study.finished = MACHINE, True
    study.refusals = {"MuJoCo": "not installed: pip install mujoco"}
    return study


def sample_ledger() -> Ledger:
    """Effects of every sort, with chosen numbers."""

    def entry(name, kind, share, path, **more) -> Entry:
        force = more.pop("force", 0.0)
        changes = {PATH: Change(path, 0.7), FORCE: Change(force, 0.1, "left & <right>")}
        cost = Estimate(share, 0.01)
        return Entry(
            name, kind, "added as {mu: 0.3}" if kind == CANDIDATE else "left out",
            milliseconds=cost.scaled(10.0), share=cost, evaluations=120, changes=changes, **more
        )  # fmt: skip

    return Ledger(
        scene={"name": "arms & <disc>", "duration_s": 1.0, "output_step_s": 0.1, "text": "a: <b>"},
        asked={PATH: 1e-3, TURN: 1e-3, JOINTS: 1e-3, "slides": 1e-3, FORCE: 1.0},
        asked_by_scene=True,
        run={
            "status": "completed", "integrator": "dop853", "stabilization": "projection",
            "evaluations": 1000, "milliseconds": 10.0, "certificate": "met", "certified": True,
            "repeats": 9,
        },
        entries=(
            entry("joint_damping", PRESENT, 0.03, 0.041),
            entry("drag", PRESENT, 0.02, 2e-5),
            entry("friction", PRESENT, 0.005, 0.0, force=3.25),
            entry("limits", PRESENT, -0.05, 2.0),
            entry("doubtful", PRESENT, 0.02, 2e-5, certified=False),
            Entry("floor", PRESENT, "left out", trouble="the object <falls>"),
            entry("rotor_inertia", CANDIDATE, 0.2, 0.5),
            entry("lag", CANDIDATE, 0.2, 1e-6),
            entry("recording", SETTING, 0.3, 0.0),
            Entry("certificate", SETTING, "1 more run, to check the first",
                  milliseconds=Estimate(12.0, 0.0), share=Estimate(1.2, 0.0), evaluations=900),
        ),
        machine=MACHINE,
        wall_time_s=1.5,
    )  # fmt: skip
