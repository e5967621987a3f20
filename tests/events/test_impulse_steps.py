"""Impulse steps: closed forms, and runs that go on in them alone."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from event_scenes import (
    AS_WRITTEN,
    AWAY,
    AWAY_HEIGHT,
    GRAVITY,
    arm,
    ball,
    box,
    on_floor,
    response_of_rod,
    rod,
    run,
    scene,
)

import multiarm as ma
from multiarm.dynamics.data import Data
from multiarm.events import consistent_mode
from multiarm.events.impulse_steps import ImpulseStepper
from multiarm.events.modes import Modes
from multiarm.scene import parse_scene
from multiarm.simulation import event_handling
from multiarm.simulation.impulse_phase import point_of


def jammed(angle: float, speed: float) -> np.ndarray:
    """Twist after the impulse that ends the slip of the rod's lower end, by hand (m = L = 1)."""
    c, s = math.cos(angle), math.sin(angle)
    # the end's velocity along x and z, by the twist along x, z and about y: J M^-1 J^T p = -J v
    J = np.array([[1.0, 0.0, -s / 2], [0.0, 1.0, c / 2]])
    inverse = np.diag([1.0, 1.0, 12.0])
    before = np.array([speed, 0.0, 0.0])
    impulse = np.linalg.solve(J @ inverse @ J.T, -J @ before)
    assert impulse[1] > 0.0
    return before + inverse @ J.T @ impulse


@pytest.mark.parametrize("angle", [0.8, 1.0, 1.2])
def test_a_rod_that_jams_has_the_impulse_that_ends_its_slip(angle):
    assert response_of_rod(angle, 2.0) < 0.0
    trajectory = run(rod(angle, 2.0, -3.0), 0.05)
    assert trajectory.events[0]["kind"] == "jams" and trajectory.events[0]["time"] == 0.0
    found = trajectory.object_twist[0, [0, 2, 4]]
    np.testing.assert_allclose(found, jammed(angle, -3.0), atol=1e-8)
    work = trajectory.energy_balance
    assert np.ptp(work) < 1e-6


def test_by_choice_a_rod_that_jams_stops_the_run():
    jamming = rod(1.0, 2.0, -3.0)
    stopping = jamming.run.model_copy(update={"painleve": "stop"})
    with pytest.raises(ma.errors.SolverError, match="Painleve"):
        run(jamming.model_copy(update={"run": stopping}), 0.05)


@pytest.fixture
def without_modes(monkeypatch):
    """No mode ever holds: from its first event on a run makes impulse steps only."""
    hold_modes_from(math.inf, monkeypatch)


def hold_modes_from(time: float, monkeypatch) -> None:
    """No mode holds before a time [s]."""
    contradicted = Modes.contradicted.fget

    def early(modes):
        return modes.bilateral.arrays.time.now < time

    def enter(modes, decision, ended=None):
        found, holds = consistent_mode.enter_consistent_mode(modes, decision, ended)
        return found, holds and not early(modes)

    monkeypatch.setattr(event_handling, "enter_consistent_mode", enter)
    monkeypatch.setattr(
        Modes, "contradicted", property(lambda modes: early(modes) or contradicted(modes))
    )


def slide(accuracy: float):
    """A box that falls 1 mm, slides, and comes to rest."""
    body = box(height=1e-3, twist=[0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    return run(on_floor(body, mu=0.2), 0.4, accuracy=accuracy)


def test_a_box_slides_to_rest_in_impulse_steps_alone(without_modes):
    fall = math.sqrt(2 * 1e-3 / GRAVITY)
    hit = math.sqrt(2 * 1e-3 * GRAVITY)
    speed = 0.4 - 0.2 * hit  # friction acts in the impact, too
    end = 0.4 * fall + speed**2 / (2 * 0.2 * GRAVITY)
    errors = []
    for accuracy in (1e-4, 1e-6):
        trajectory = slide(accuracy)
        assert trajectory.status == "completed" and trajectory.statistics["impulse_steps"] > 20
        np.testing.assert_allclose(trajectory.object_twist[-1], 0.0, atol=1e-9)
        errors.append(abs(trajectory.object_position[-1, 0] - end))
        assert np.all(trajectory.contact_forces["floor"][:, 0::3] >= 0.0)
    assert errors[0] < 1e-4 and errors[1] < min(1e-6, errors[0])


def test_a_box_bounces_in_impulse_steps_alone(without_modes):
    drop, e = 0.02, 0.5
    trajectory = run(on_floor(box(height=drop), e), 0.16, accuracy=1e-5)
    assert trajectory.status == "completed" and trajectory.statistics["impulse_steps"] > 20
    fall = math.sqrt(2 * drop / GRAVITY)
    hits = fall * np.array([1.0, 1.0 + 2.0 * e, 1.0 + 2.0 * e + 2.0 * e**2])
    after = np.searchsorted(hits, trajectory.time)
    assert set(after) == {0, 1, 2, 3}
    since = trajectory.time - np.concatenate([[0.0], hits])[after]
    up = np.array([0.0, *np.sqrt(2 * GRAVITY * drop) * e ** np.arange(1, 4)])[after]
    start = np.array([drop, 0.0, 0.0, 0.0])[after]
    height = start + up * since - 0.5 * GRAVITY * since**2
    np.testing.assert_allclose(trajectory.object_position[:, 2] - 0.1, height, atol=2e-5)


DROP, MASS = 0.02, 2.0


def steps_of(a_scene, h: float, number: int):
    """Points of equal impulse steps from the start of a scene, without error control."""
    system = ma.compile_system(a_scene)
    modes = Modes(Data(system.model), 1e-9)
    modes.bilateral.set_state(0.0, system.initial_state())
    stepper = ImpulseStepper(modes, frozenset(), frozenset())
    point = point_of(modes.bilateral, 0.0, np.zeros(modes.bilateral.arrays.effects.power.size))
    points = [point]
    for _ in range(number):
        point = stepper.step(point, h).end
        points.append(point)
    return points


def flight(t: np.ndarray, e: float) -> np.ndarray:
    """Height of a body that falls from rest and bounces up to four times [m], by hand."""
    fall = math.sqrt(2 * DROP / GRAVITY)
    hits = fall * (1.0 + np.cumsum([0.0, 2.0 * e, 2.0 * e**2, 2.0 * e**3]))
    after = np.searchsorted(hits, t)
    assert np.max(after) < 4
    since = t - np.concatenate([[0.0], hits])[after]
    up = np.concatenate([[0.0], GRAVITY * fall * e ** np.arange(1, 4)])[after]
    return np.where(after == 0, DROP, 0.0) + up * since - 0.5 * GRAVITY * since**2


@pytest.mark.parametrize(("e", "duration", "hits"), [(0.5, 0.17, 3), (1.0, 0.25, 2)])
def test_a_box_bounces_with_the_speed_before_the_hit(e, duration, hits):
    """Newton's law in the step of the hit, whichever half of it the hit is in."""
    speed = math.sqrt(2 * GRAVITY * DROP)
    for number in (200, 400, 800, 1600):
        h = duration / number
        points = steps_of(on_floor(box(mass=MASS, height=DROP), e), h, number)
        height = np.array([point.configuration[2] - 0.1 for point in points])
        error = height - flight(np.array([point.t for point in points]), e)
        # first order: a hit is at most half a step early or late
        assert np.max(np.abs(error)) < hits * 0.5 * (1.0 + e) * speed * h
        v = np.array([point.velocity[2] for point in points])
        hit = np.flatnonzero((v[:-1] < 0.0) & (v[1:] > 0.0))
        assert hit.size == hits
        np.testing.assert_allclose(v[hit + 1], -e * v[hit], rtol=1e-12)
        energy = MASS * (0.5 * v**2 + GRAVITY * height)
        assert np.all(np.diff(energy) <= 1e-14)


def test_a_phase_says_how_often_and_how_hard_contacts_hit(monkeypatch):
    """The second and the third bounce of a box on its four corners are in a phase."""
    hold_modes_from(0.165, monkeypatch)
    trajectory = run(on_floor(box(mass=MASS, height=DROP), 0.5), 0.17, accuracy=1e-5)
    assert trajectory.status == "completed"
    chatters = [event for event in trajectory.events if event["kind"] == "chatters"]
    assert [event["after"]["hits"] for event in chatters] == [8]
    speed = 0.5 * math.sqrt(2 * GRAVITY * DROP)
    of_corner = MASS * 1.5 * speed / 4
    assert chatters[0]["after"]["largest_impulse_N_s"] == pytest.approx(of_corner, rel=1e-3)


def test_friction_and_impacts_do_their_own_works(without_modes):
    trajectory = slide(1e-6)
    works = trajectory.effect_works
    hit = math.sqrt(2 * 1e-3 * GRAVITY)
    speed = 0.4 - 0.2 * hit  # what friction does in the impact at the first event is the impact's
    lost = 0.5 * MASS * (hit**2 + 0.4**2 - speed**2)
    assert works["contact_friction"][-1] == pytest.approx(-0.5 * MASS * speed**2, rel=1e-6)
    assert works["impacts"][-1] == pytest.approx(-lost, rel=1e-6)
    assert np.ptp(trajectory.energy_balance) < 1e-6


def test_dry_friction_of_a_joint_does_the_work_that_stops_it():
    cart = arm("x", velocity=[0.3], mass=1.5, base={"xyz": [0, 0, AWAY_HEIGHT]})
    friction = {"torque": 2.0, "model": "set_valued"}
    effects = {"unilateral_contacts": AS_WRITTEN, "joint_friction": friction}
    points = steps_of(
        scene(ball(), {"cart": cart}, {"cart": [AWAY]}, effects, gravity=[0, 0, 0]), 1e-3, 300
    )
    assert abs(points[-1].velocity[-1]) < 1e-12
    # of the joint's friction, of impacts, and of both
    expected = -0.5 * 1.5 * 0.3**2 * np.array([1.0, 0.0, 1.0])
    np.testing.assert_allclose(points[-1].works, expected, atol=1e-12)


def test_a_contact_that_stays_closed_does_not_hit(monkeypatch):
    hold_modes_from(0.1, monkeypatch)
    chatters = [event for event in slide(1e-6).events if event["kind"] == "chatters"]
    assert [event["after"] for event in chatters] == [{"hits": 0}]


def test_a_phase_that_was_left_too_early_comes_back_twice_as_long(monkeypatch):
    """After every phase the run is made to chatter again at its next event."""
    lengths = []
    ended = event_handling.EventHandler._end_phase

    def end(handler, run, phase):
        lengths.append((phase.begin, run.clock.t, phase.least))
        ended(handler, run, phase)

    monkeypatch.setattr(event_handling.EventHandler, "_end_phase", end)
    monkeypatch.setattr(
        event_handling.EventHandler, "_accumulate", lambda handler, t, changed: True
    )
    body = box(height=1e-4, twist=[0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    trajectory = run(on_floor(body, 0.5, mu=0.2), 0.05, accuracy=1e-5)
    assert trajectory.status == "completed" and len(lengths) > 2
    soon = [(a, b) for a, b in pairwise(lengths) if b[2] > 0.0]
    assert soon
    for (begin, end_, _), (_, _, least) in soon:
        assert least <= 2.0 * (end_ - begin)
    for begin, end_, least in lengths:
        assert end_ - begin >= least


def test_hits_of_different_bodies_are_no_chatter_however_fast_they_follow():
    """24 balls fly to a floor without gravity, 1.5 ms after each other, and bounce once each."""
    restitution, times = 0.8, 4.0 + 1.5e-3 * np.arange(24)
    objects = {f"ball_{k}": ball(0.05, height=float(t)) for k, t in enumerate(times)}
    for k, body in enumerate(objects.values()):
        body["pose"]["xyz"][0], body["twist"] = 0.5 * k, [0.0, 0.0, -1.0, 0.0, 0.0, 0.0]
    away = arm("x", base={"xyz": [0, 0, 50.0]})
    table = {
        "gravity": None,
        "objects": objects,
        "arms": {"away": away},
        "joints": [{"arm": "away", "object": "ball_0", "kind": "contacts", "contacts": [AWAY]}],
        "effects": {"unilateral_contacts": AS_WRITTEN, "floor": {"restitution": restitution}},
    }
    system = ma.compile_system(parse_scene(table))
    trajectory = ma.simulate(system, 5.0, accuracy=1e-6, output_step=5.0, certificate=False)
    assert [event["kind"] for event in trajectory.events] == ["bounces"] * len(times)
    heights = [motion.position[-1, 2] for motion in trajectory.objects.values()]
    np.testing.assert_allclose(heights, 0.05 + restitution * (5.0 - times), rtol=0, atol=1e-12)
