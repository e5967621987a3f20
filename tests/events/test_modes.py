"""Modes of one Data: what stays while they change, and what they cost in memory."""

from __future__ import annotations

import tracemalloc

import pytest
from event_scenes import ball, box, on_floor

import multiarm as ma
from multiarm.events.modes import Modes
from multiarm.simulation.event_handling import EventHandler


def tumbling_box():
    """A box that bounces, slides and sticks on its corners."""
    body = box(height=0.6, twist=[1.0, 0.3, 0.0, 2.0, 3.0, 5.0])
    return ma.compile_system(on_floor(body, 0.5, 0.4))


def observe_events(monkeypatch, look) -> None:
    """Call ``look(handler, run)`` after every event."""
    cross = EventHandler.cross

    def crossed(handler, run):
        fault = cross(handler, run)
        look(handler, run)
        return fault

    monkeypatch.setattr(EventHandler, "cross", crossed)


def test_a_run_keeps_its_data_and_its_step_across_modes(monkeypatch):
    seen, rows = set(), set()

    def look(handler, run):
        data, stepping = run.data, run.stepping
        seen.add((id(data), id(data.struct), id(stepping), stepping.struct.tobytes()))
        rows.add(tuple(handler.mode.arrays.held))
        assert data is handler.modes.data and handler.mode.data is data
        assert data.model.layout.contacts == len(handler.mode.arrays.held) == data.arrays.force.size

    observe_events(monkeypatch, look)
    run = ma.simulate(tumbling_box(), 2.0, accuracy=1e-6, certificate=False)
    assert run.status == "completed" and len(rows) > 3
    assert len(seen) == 1


def test_memory_does_not_grow_with_the_events(monkeypatch):
    """That of a bouncing ball after 100 events is that after 20, but for the event log."""
    taken, count = {}, 0
    log = tracemalloc.Filter(False, "*/events/transition.py")  # it makes the entries
    ours = [tracemalloc.Filter(True, f"*/multiarm/{room}/*") for room in ("dynamics", "events")]

    def look(_handler, _run):
        nonlocal count
        count += 1
        if count in (20, 100):
            files = tracemalloc.take_snapshot().filter_traces([log, *ours]).statistics("filename")
            taken[count] = sum(file.size for file in files)

    system = ma.compile_system(on_floor(ball(height=0.5), 0.97))
    observe_events(monkeypatch, look)
    tracemalloc.start()
    try:
        ma.simulate(system, 40.0, accuracy=1e-6, certificate=False, max_step=1.0)
    finally:
        tracemalloc.stop()
    assert taken[100] - taken[20] < 10_000  # [bytes], less than one mode has


@pytest.mark.parametrize("speed", [1e-9, 1e-3])
def test_fixed_selections_have_the_rows_that_their_names_say(speed):
    modes = Modes(tumbling_box().model.data(), speed)
    unilateral = modes.unilateral
    counts = [data.model.layout.contacts for data in (modes.closed, modes.bare, modes.loose)]
    assert counts == [len(unilateral.model), len(unilateral.bilateral), 0]
    assert all(data.arrays.modes.active for data in (modes.data, modes.bare, modes.loose))
    assert not (modes.full.arrays.modes.active or modes.closed.arrays.modes.active)
