"""Failures of compiled code reach the user with their reason where contacts come and go."""

from __future__ import annotations

import numpy as np
import pytest
from event_scenes import AS_WRITTEN, arm, ball, on_floor, run, scene

import multiarm as ma
from multiarm.errors import SolverError
from multiarm.events.evaluation import enter_mode_at
from multiarm.events.kernels import start_guards
from multiarm.events.modes import Modes

RADIUS = 0.05  # [m]
WORN_OUT = 0.02  # [m] from the surface, where it fails
UNILATERAL = {"unilateral_contacts": {"start": "as_written", "contacts": ["below"]}}


@pytest.mark.parametrize("height", [0.0, 1.0], ids=["touching", "open"])
def test_a_mode_that_cannot_be_evaluated_is_told_with_the_reason(height):
    system = ma.compile_system(on_floor(ball(height=height)))
    with system.borrow() as data:
        data.model.constants.object_inertias[:] *= -1.0
        with pytest.raises(SolverError, match=r"^the node matrix of the objects is not positive"):
            enter_mode_at(data, 0.0, system.initial_state())


def distance_from_a_worn_ball(p):
    distance = distance_from_a_ball(p)
    if distance < WORN_OUT:
        raise ValueError("worn out")
    return distance


def distance_from_a_ball(p):
    return np.linalg.norm(p) - RADIUS


def worn_ball_above_a_tip(**effects):
    """The object, a ball whose surface fails where it is near, moves down to the tip of an arm.

    The tip of another arm stays on top of it, on a surface that does not fail.
    """
    surfaces = {"below": distance_from_a_worn_ball, "above": distance_from_a_ball}
    contacts = {
        name: [
            {
                "arm": {"sphere": {"radius": 0.01}},
                "object": {"surface": {"distance": distance, "length": RADIUS}},
            }
        ]
        for name, distance in surfaces.items()
    }
    all_effects = {**UNILATERAL, **effects}
    above = arm("z", velocity=[-1.0], base={"xyz": [0, 0, 0.2 + 2.0 * RADIUS + 0.01]})
    falling = ball(RADIUS, 0.2, twist=[0, 0, -1.0, 0, 0, 0])
    return scene(falling, {"below": arm("z"), "above": above}, contacts, all_effects, [0, 0, 0])


SPRING = {"contact_compliance": {"stiffness": 1e4, "contacts": ["below"]}}


@pytest.mark.parametrize("effects", [{}, SPRING], ids=["rigid", "compliant"])
def test_a_surface_that_fails_while_its_contact_is_open_ends_the_run_with_its_error(effects):
    trajectory = run(worn_ball_above_a_tip(**effects), duration=0.5)
    assert trajectory.status == "failed"
    assert "worn out" in trajectory.message


def test_a_surface_that_fails_while_its_contact_is_open_is_told_by_an_evaluation():
    system = ma.compile_system(worn_ball_above_a_tip())
    state = system.initial_state()
    state.object_position[2] -= 0.19
    state.joint_positions["above"][:] = -0.19
    with pytest.raises(ma.MultiarmError, match="worn out"):
        ma.evaluate(system, 0.0, state)


class WearsOut:
    """The distance from a ball, which fails at one of its calls, and counts them."""

    def __init__(self, last: int) -> None:
        self.calls, self.last = 0, last

    def __call__(self, p):
        self.calls += 1
        if self.calls == self.last:
            raise ValueError("worn out")
        return distance_from_a_ball(p)


def test_no_failure_of_a_surface_is_overlooked_by_an_evaluation():
    """At whichever call it fails: its error is told, or the contact was found on another way."""
    surface = WearsOut(0)
    contact = {
        "arm": {"sphere": {"radius": 0.01}},
        "object": {"surface": {"distance": surface, "length": RADIUS}},
        "mu": 0.3,
    }
    sliding = ball(0.05, 0.01, twist=[1.0, 0, 0, 0, 0, 0])
    pushed = {"kind": "constant", "torques": {"below": [20.0]}}
    effects = {"unilateral_contacts": {"start": "as_written"}}
    system = ma.compile_system(
        scene(sliding, {"below": arm("z")}, {"below": [contact]}, effects, control=pushed)
    )

    def forces() -> np.ndarray | None:
        surface.calls = 0
        try:
            evaluation = ma.evaluate(system)
        except ma.MultiarmError as error:
            assert "worn out" in str(error)
            return None
        assert evaluation.contact_states["below"] == ("sliding",)
        return evaluation.contact_forces["below"]

    right = forces()
    count, told = surface.calls, 0
    for surface.last in range(1, count + 1, max(1, count // 200)):
        result = forces()
        told += result is None
        assert result is None or np.array_equal(result, right)
    assert told > 100
    surface.last = 0
    assert np.array_equal(forces(), right)


@pytest.mark.parametrize(
    ("room", "call", "start"),
    [
        ("events.consistent_mode", ma.evaluate, 1),
        ("events.consistent_mode", ma.simulate, 1),
        ("simulation.event_handling", ma.simulate, 1),
        ("events.consistent_mode", ma.simulate, 2),
    ],
    ids=["evaluation", "mode of a start", "begin of a run", "event"],
)
def test_a_surface_that_fails_where_guards_are_started_is_told(monkeypatch, room, call, start):
    """At the first start of guards, and at the one that decides the mode after an event."""
    starts, fails = 0, False

    def distance(p):
        if fails:
            raise ValueError("worn out")
        return distance_from_a_ball(p)

    def failing_start(struct):
        nonlocal starts, fails
        starts += 1
        fails = starts == start
        status = start_guards(struct)
        fails = False
        return status

    def contradicted(modes):
        assert starts < start, "guards that could not be started were judged"
        return judge(modes)

    judge = Modes.contradicted.fget
    monkeypatch.setattr(Modes, "contradicted", property(contradicted))
    monkeypatch.setattr(f"multiarm.{room}.start_guards", failing_start)
    contact = {
        "arm": {"sphere": {"radius": 0.01}},
        "object": {"surface": {"distance": distance, "length": RADIUS}},
    }
    falling = ball(RADIUS, 0.1, twist=[0, 0, -1.0, 0, 0, 0])
    effects = {"unilateral_contacts": AS_WRITTEN}
    system = ma.compile_system(
        scene(falling, {"below": arm("z")}, {"below": [contact]}, effects, [0, 0, 0])
    )
    if start == 1:
        with pytest.raises(ma.MultiarmError, match="worn out"):
            call(system)
    else:
        trajectory = ma.simulate(system, 1.0, accuracy=1e-6, certificate=False)
        assert trajectory.status == "failed" and "worn out" in trajectory.message
    assert starts == start
