"""Modes of one Data: what stays while they change, and what they cost in memory."""

from __future__ import annotations

import gc
import tracemalloc

import numpy as np
import pytest
from event_scenes import ball, box, on_floor

import multiarm as ma
from multiarm.dynamics.data import Data
from multiarm.dynamics.row_selection import MOST_RECENT
from multiarm.events.mode import Mode
from multiarm.events.modes import Modes
from multiarm.results.contact_states import ContactState
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
        rows.add(tuple(data.rows))
        assert data is handler.modes.data
        assert data.model.layout.contacts == len(data.rows) == data.arrays.rows.force.size

    observe_events(monkeypatch, look)
    run = ma.simulate(tumbling_box(), 2.0, accuracy=1e-6, certificate=False)
    assert run.status == "completed" and len(rows) > 3
    assert len(seen) == 1


def test_memory_does_not_grow_with_the_events(monkeypatch):
    """That of a bouncing ball after 100 events is that after 20, but for the event log."""
    taken, count = {}, 0
    log = tracemalloc.Filter(False, "*/events/decision_events.py")  # it makes the entries
    ours = [tracemalloc.Filter(True, f"*/multiarm/{room}/*") for room in ("dynamics", "events")]

    def look(_handler, _run):
        nonlocal count
        count += 1
        if count in (20, 100):
            gc.collect()
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


def test_memory_does_not_grow_with_the_modes():
    """That after 1000 modes of which each is new is that after 64, with the same ones in caches."""
    modes, rng = Modes(Data(tumbling_box().model), 1e-3), np.random.default_rng(1)
    first = modes.mode
    states = (ContactState.OPEN, ContactState.STICKING, ContactState.SLIDING)
    constraints = [one for one in modes.unilateral.constraints if one.tangents]

    def new_mode() -> Mode:
        chosen = dict(zip(constraints, rng.choice(3, len(constraints)), strict=True))
        rows = [c.row for c, k in chosen.items() if k > 0]
        rows += [t for c, k in chosen.items() if k == 1 for t in c.tangents]
        every = tuple(states[chosen.get(c, 0)] for c in modes.unilateral.constraints)
        directions = {u: np.array([0.6, 0.8]) for u in range(len(every))}
        return Mode(every, tuple(sorted(rows)), directions=directions)

    def enter(mode: Mode) -> None:
        modes.enter(mode)
        rows = len(mode.rows)
        assert modes.data.arrays.rows.force.size == rows == modes.data.model.layout.contacts

    ours = [tracemalloc.Filter(True, f"*/multiarm/{room}/*") for room in ("dynamics", "events")]
    few, many = 2 * MOST_RECENT, 1000
    sizes, last = [], [new_mode() for _ in range(MOST_RECENT)]
    tracemalloc.start()
    try:
        for count in (few, many - few):
            for _ in range(count):
                enter(new_mode())
            for mode in last:
                enter(mode)
            modes.enter(first)
            gc.collect()
            files = tracemalloc.take_snapshot().filter_traces(ours).statistics("filename")
            sizes.append(sum(file.size for file in files))
    finally:
        tracemalloc.stop()
    # a few bytes a mode: buffers that NumPy uses again are not seen
    assert sizes[1] - sizes[0] < 4 * (many - few)


def test_the_signs_of_determinants_do_not_outlive_their_rows():
    """A posture is not singular because the rows of an arm have changed."""
    modes = Modes(Data(tumbling_box().model), 1e-3)
    contact = next(c for c in modes.unilateral.constraints if c.tangents)
    states = [ContactState.OPEN] * len(modes.unilateral.constraints)
    states[modes.unilateral.constraints.index(contact)] = ContactState.STICKING
    modes.data.arrays.last_step.determinant_signs[:] = 1.0
    modes.enter(modes.mode)
    assert np.all(modes.data.arrays.last_step.determinant_signs == 1.0)
    modes.enter(Mode(tuple(states), (contact.row, *contact.tangents)))
    assert np.all(modes.data.arrays.last_step.determinant_signs == 0.0)


@pytest.mark.parametrize("speed", [1e-9, 1e-3])
def test_fixed_selections_have_the_rows_that_their_names_say(speed):
    modes = Modes(Data(tumbling_box().model), speed)
    unilateral = modes.unilateral
    fixed = modes.bilateral, modes.unconstrained
    counts = [data.model.layout.contacts for data in (modes.closed, *fixed)]
    assert counts == [len(unilateral.model), len(unilateral.bilateral), 0]
    assert all(data.arrays.modes.active for data in (modes.data, *fixed))
    assert not (modes.full.arrays.modes.active or modes.closed.arrays.modes.active)
