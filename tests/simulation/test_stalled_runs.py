"""Claims about runs that hardly get on: they end, say why in a short message, and keep their data.

What counts as hardly getting on is a number of steps for a second, ``run.most_steps``: no scene of
this suite and none of the hard cases comes near its default.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from event_scenes import ball, on_floor
from refusals import refused
from repository import SCENES

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.results.event_kinds import EventKind
from multiarm.results.event_log import MOST_LISTED, EventLog, RunEvent
from multiarm.scene import RunSpec
from multiarm.simulation.driver import BUDGET, EVENT_STEPS, JUDGED_STEPS, Pace
from multiarm.simulation.event_handling import EventHandler
from multiarm.simulation.run import MESSAGE_LENGTH

FAST, SLOW = 1e9, 0.5  # [Hz]
# A look at the pace may come late by the steps of one budget of evaluations, of at least 6 each.
MOST_TRIED = JUDGED_STEPS + BUDGET // 6
TOO_SLOW = "steps became so short that the run hardly got on"


def shaken(frequency: float = FAST, effects=None, **run):
    """Three arms around a disc whose torques oscillate, in compiled code."""
    scene = ma.load_scene(SCENES / "ring_weld.yaml")
    amplitude = {arm: [200.0] * 6 for arm in scene.arms}
    control = {"kind": "harmonic", "frequency": frequency, "amplitude": amplitude}
    run = {"duration": 1.0, "accuracy": 1e-8, "arms": "compiled", **run}
    return scene.replace(control=control, effects=effects or {}, run=run)


def tried(trajectory) -> int:
    return trajectory.statistics["steps"] + trajectory.statistics["rejected_steps"]


def assert_given_up(trajectory):
    assert trajectory.status == "failed"
    assert TOO_SLOW in trajectory.message and "`run.most_steps`" in trajectory.message
    assert "at t = " in trajectory.message and "(step " in trajectory.message
    assert len(trajectory.message) <= MESSAGE_LENGTH
    assert len(trajectory) >= 1 and np.isfinite(trajectory.object_position).all()
    assert trajectory.statistics["simulated_s"] >= trajectory.time[-1]
    assert len(trajectory.events) <= MOST_LISTED + 1


def test_torques_that_oscillate_too_fast_end_the_run(tmp_path):
    run = ma.simulate(ma.compile_system(shaken()), out=tmp_path / "run.h5")
    assert_given_up(run)
    assert tried(run) <= MOST_TRIED
    assert ma.load_trajectory(tmp_path / "run.h5").message == run.message


@pytest.mark.slow
def test_a_larger_bound_lets_the_same_run_go_further():
    base, more = (
        ma.simulate(ma.compile_system(shaken(duration=1e-5, most_steps=most)), certificate=False)
        for most in (1e4, 1e8)
    )
    assert_given_up(base)
    assert more.status == "completed" and tried(more) > tried(base)


def test_slower_torques_of_the_same_size_complete():
    assert ma.simulate(ma.compile_system(shaken(SLOW)), certificate=False).status == "completed"


@pytest.mark.slow
def test_a_controller_that_answers_at_random_ends_the_run(free_block_system, monkeypatch):
    """Steps are then as short as keeps the error of a jump within the tolerance."""
    monkeypatch.setattr("multiarm.simulation.driver.JUDGED_STEPS", 500)

    def noise(t, state):
        return {"one": 300.0 * np.sin(1e15 * t + np.arange(6.0) ** 3)}

    run = ma.simulate(free_block_system, 1.0, accuracy=1e-6, control=noise)
    assert_given_up(run)
    assert tried(run) <= 500 + BUDGET // 6


@pytest.mark.slow
def test_a_run_that_goes_on_with_the_method_for_stiff_scenes_ends_too(monkeypatch):
    monkeypatch.setattr("multiarm.simulation.driver.JUDGED_STEPS", 500)

    def control(t, state):
        frequency = SLOW if t < 0.1 else FAST
        return {"arm0": np.full(6, 200.0 * np.sin(2.0 * np.pi * frequency * t))}

    scene = shaken(effects={"joint_damping": 1e6}, duration=0.2)
    run = ma.simulate(ma.compile_system(scene), control=control, certificate=False)
    assert_given_up(run)
    assert "rodas5p took over" in run.message and run.time[-1] > 0.09
    assert tried(run) <= 2 * 500 + BUDGET // 6


@pytest.mark.parametrize(
    ("steps", "rejected", "stops"),
    [(JUDGED_STEPS, 0, 0), (0, JUDGED_STEPS, 0), (0, 0, JUDGED_STEPS // EVENT_STEPS)],
)
def test_steps_rejected_steps_and_events_count(steps, rejected, stops):
    settings = SimpleNamespace(adaptive=True, longest_step=np.inf, begin=0.0)
    clock = SimpleNamespace(t=0.0, h=0.0, steps=0, rejected=0)
    run = SimpleNamespace(settings=settings, clock=clock)
    pace, event_stops = Pace(run, RunSpec(duration=10.0)), 0
    for got_on, verdict in ((2e-8, False), (0.5e-8, True)):  # [s] a step, of 1e-8 s allowed
        clock.t += got_on * JUDGED_STEPS
        clock.steps, clock.rejected = clock.steps + steps, clock.rejected + rejected
        event_stops += stops
        stall = pace.stall(run, event_stops)
        assert (stall is not None) is verdict
        assert not stall or stall.steps == JUDGED_STEPS
        assert pace.stall(run, event_stops) is None, "until as many steps have been made again"


@pytest.mark.parametrize(
    "settings",
    [{"integrator": "rk4", "step": 1e-9}, {"accuracy": 1e-6, "max_step": 1e-9}],
    ids=["fixed step", "longest step"],
)
def test_steps_that_are_asked_for_are_never_too_short(settings):
    system = ma.compile_system(shaken(SLOW))

    def progress(t):
        if t > 1.5 * JUDGED_STEPS * 1e-9:
            raise KeyboardInterrupt

    run = ma.simulate(system, progress=progress, certificate=False, **settings)
    assert run.status == "interrupted"
    assert run.statistics["steps"] > JUDGED_STEPS


# --- events without end --------------------------------------------------------------------------


@pytest.fixture
def endless_events(monkeypatch):
    """An event engine that is broken: the first event is followed by others, every nanosecond."""
    kinds = EventKind.BOUNCES, EventKind.SLIDES, EventKind.STICKS

    def cross(self, run):
        t = run.clock.t
        events = [RunEvent(t, kind, arm="floor") for kind in kinds]
        self._log.add(*events)
        self.count += len(events)
        run.clock.stop = t + 1e-9

    monkeypatch.setattr(EventHandler, "cross", cross)


@pytest.mark.parametrize("settings", [{}, {"integrator": "rk4", "step": 1e-3}])
def test_events_that_follow_each_other_without_end_end_the_run(endless_events, settings):
    scene = on_floor(ball(height=0.05), restitution=0.5)
    run = ma.simulate(ma.compile_system(scene), 1.0, certificate=False, **settings)
    assert_given_up(run)
    assert run.time[-1] > 0.05  # [s] from before the first event, at 0.1 s
    assert run.statistics["steps"] <= JUDGED_STEPS / EVENT_STEPS
    dropped = run.statistics["contact_events"] - MOST_LISTED
    assert dropped > 0
    assert f"not listed: {dropped:,} events from t = 0.1" in run.message
    assert run.events[-1]["kind"] == "not listed"
    assert "times 'slides' (floor)" in run.events[-1]["text"]


# --- certified, many, swept ----------------------------------------------------------------------


def test_the_rerun_of_a_certified_run_has_the_same_bound(monkeypatch):
    """The run ends before its pace is judged; the rerun takes more steps."""
    first = ma.simulate(ma.compile_system(shaken(SLOW)), certificate=False)
    monkeypatch.setattr("multiarm.simulation.driver.BUDGET", 50)
    monkeypatch.setattr("multiarm.simulation.driver.JUDGED_STEPS", tried(first) + 1)
    # the rerun's longest step follows from the run's, and is not much longer than its own steps
    monkeypatch.setattr("multiarm.simulation.driver.SHORT_SHARE", 1.0)
    held = ma.simulate(ma.compile_system(shaken(SLOW, most_steps=tried(first) + 1)))
    certificate = held.certificate
    run, rerun = certificate["attempts"][:2]
    assert run["steps"] == first.statistics["steps"]
    assert run["steps"] < rerun["steps"] <= tried(first) + 50
    assert certificate["reason"] == "rounding" and TOO_SLOW in certificate["text"]


@pytest.mark.slow
def test_many_runs_and_sweeps_carry_the_failure_on(tmp_path):
    system = ma.compile_system(shaken(SLOW, duration=0.1))
    many = ma.simulate_many(
        system, parameters=[{"control.frequency": f} for f in (SLOW, FAST)], threads=2
    )
    assert [run.status for run in many] == ["completed", "failed"]
    assert_given_up(many[1])
    sweep = ma.sweep(
        system.scene, {"control.frequency": [SLOW, FAST]}, out=tmp_path / "s.sweep", workers=1
    )
    assert sweep.status_counts == {"completed": 1, "failed": 1}


def test_the_bound_is_a_positive_number():
    with refused(SceneError, "$.run.most_steps"):
        shaken(most_steps=0)


# --- the log of events ---------------------------------------------------------------------------


def test_a_log_counts_what_it_does_not_list():
    log, count = EventLog(), 23_140
    kinds = (
        EventKind.LOSES_DIRECTION,
        EventKind.REGAINS_DIRECTION,
        EventKind.RANK_FALLS,
        EventKind.RANK_RISES,
    )
    for k in range(MOST_LISTED + count):
        arm = "left" if k % 4 < 2 else ""
        log.add(RunEvent(1e-9 * k, kinds[k % 4], "no motion along z", arm))
    events = log.entries()
    assert len(events) == MOST_LISTED + 1
    assert [event["time"] for event in events] == sorted(event["time"] for event in events)
    text = events[-1]["text"]
    assert text.startswith("not listed: 23,140 events from t = 1e-06 s to 2.414e-05 s: ")
    assert "5,785 times 'loses a direction' (left)" in text and text.endswith("and 1 more")
    assert text in log.remarks(MESSAGE_LENGTH)
    assert log.dropped.total() == count


@pytest.mark.parametrize("room", [600, 200, 0, -50])
def test_what_happened_fits_into_the_message(room):
    log = EventLog()
    log.add(*(RunEvent(0.0, EventKind.PULLS, arm=f"{k}: {'tip ' * 80}") for k in range(9)))
    (summary,) = log.remarks(room)
    assert len(summary) <= max(room, 60)
    assert summary.endswith("... (see `events`)")
    assert EventLog().remarks(room) == []
