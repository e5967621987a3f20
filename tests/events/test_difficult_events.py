"""Where runs with events are likely to break: redundant contacts, edges of tables, bad starts."""

from __future__ import annotations

import math

import numpy as np
import pytest
from event_scenes import (
    AS_WRITTEN,
    GRAVITY,
    arm,
    ball,
    ball_on_plate,
    box,
    on_floor,
    run,
    scene,
    times,
)
from mechanics import G

import multiarm as ma
from multiarm.errors import MultiarmError
from multiarm.scene import parse_scene

WEIGHT = 2.0 * GRAVITY


# --- more contacts than there are freedoms -------------------------------------------------------


def shaken_block(points=None):
    """A block welded to two slides, its corners on a rough floor, pushed ever harder along x."""
    rod = arm("xz", mass=0.5, base={"xyz": [0, 0, 0.05]})
    block = {"shape": {"box": [0.2, 0.2, 0.1]}, "mass": 1.0, "pose": {"xyz": [0, 0, 0.05]}}
    floor = {"mu": 0.4} if points is None else {"mu": 0.4, "points": points}
    shake = {"rod": [1.3 * 0.4 * 1.5 * GRAVITY, 0.0]}
    return parse_scene(
        {
            "gravity": G,
            "object": block,
            "arms": {"rod": rod},
            "joints": [{"arm": "rod", "kind": "weld"}],
            "effects": {"floor": floor},
            "control": {"kind": "harmonic", "amplitude": shake, "frequency": 1.0, "hold": False},
        }
    )


def test_corners_beside_a_weld_slip_when_a_single_foot_would():
    """Weld and corners share the load, so that no law says how; the motion is one all the same."""
    corners = run(shaken_block(), 0.45)
    foot = run(shaken_block([[0, 0, -0.05]]), 0.45)
    assert corners.status == "completed"
    begin = math.asin(1 / 1.3) / (2 * math.pi)
    assert times(foot, "slides")[0] == pytest.approx(begin, abs=1e-9)
    np.testing.assert_allclose(corners.object_position, foot.object_position, atol=1e-7)


def test_a_block_on_a_tilting_plate_slips_at_the_angle_of_friction():
    mu, rate = 0.5, 0.3
    corners = [[x, y, -0.1] for x in (0.2, -0.2) for y in (0.15, -0.15)]
    contacts = [{"arm": {"plane": {"normal": [0, 0, 1]}}, "object": {"point": p}} for p in corners]
    plate = arm("Y", mass=10.0, inertia=1e5, velocity=[rate])
    body = box(twist=[0.1 * rate, 0, 0, 0, rate, 0])
    effects = {"unilateral_contacts": AS_WRITTEN, "contact_friction": mu}
    tilting = scene(body, {"plate": plate}, {"plate": contacts}, effects)
    trajectory = run(tilting, 1.7, 1e-7)
    assert trajectory.status == "completed"
    # along the plate m g sin, across it m (g cos - rate^2 height): the box turns with the plate
    angle = trajectory.joint_positions["plate"][:, 0]
    drag, load = np.sin(angle), np.cos(angle) - rate**2 * 0.1 / GRAVITY
    holds = drag < mu * load
    place = np.einsum(
        "ki,ki->k",
        trajectory.object_position,
        np.column_stack([np.cos(angle), 0 * angle, -np.sin(angle)]),
    )
    np.testing.assert_allclose(place[holds], 0.0, atol=1e-6)
    assert place[-1] > 1e-3
    assert trajectory.statistics["evaluations"] < 20000


@pytest.mark.parametrize(("share", "mu_finger"), [(0.2, 0.5), (0.4, 0.2), (0.4, 0.5)])
def test_a_rough_finger_pushes_a_box_over_a_rough_floor(share, mu_finger):
    finger = arm("x", mass=1.0, base={"xyz": [-0.25, 0, 0.1]})
    face = {"plane": {"point": [-0.2, 0, 0], "normal": [-1, 0, 0]}}
    contacts = {"finger": [{"arm": {"sphere": {"radius": 0.05}}, "object": face}]}
    effects = {
        "unilateral_contacts": AS_WRITTEN, "floor": {"mu": 0.3}, "contact_friction": mu_finger
    }  # fmt: skip
    control = {"kind": "constant", "torques": {"finger": [share * WEIGHT]}}
    trajectory = run(scene(box(), {"finger": finger}, contacts, effects, control=control), 0.3)
    assert trajectory.status == "completed"
    moved = trajectory.object_position[-1, 0]
    # the finger may carry a part of the weight or press the box down: by mu times its force
    lift = mu_finger * share * WEIGHT
    most, least = (0.5 * 0.09 / 3.0 * max(0.0, share * WEIGHT - 0.3 * (WEIGHT + sign * lift))
                   for sign in (-1, 1))  # fmt: skip
    assert least - 1e-9 <= moved <= most + 1e-9


def test_a_rough_finger_hits_a_box_on_a_rough_floor():
    finger = arm("x", mass=1.0, velocity=[1.0], base={"xyz": [-0.35, 0, 0.1]})
    face = {"plane": {"point": [-0.2, 0, 0], "normal": [-1, 0, 0]}}
    contacts = {"finger": [{"arm": {"sphere": {"radius": 0.05}}, "object": face}]}
    effects = {"unilateral_contacts": AS_WRITTEN, "floor": {"mu": 0.3}, "contact_friction": 0.4}
    trajectory = run(scene(box(), {"finger": finger}, contacts, effects), 0.3)
    assert trajectory.status == "completed"
    assert times(trajectory)[0] == pytest.approx(0.1, abs=1e-9)
    assert trajectory.object_position[-1, 0] > 1e-3
    assert np.max(np.diff(trajectory.energy)) < 1e-9


@pytest.mark.parametrize(("restitution", "mu"), [(0.3, None), (0.3, 0.4), (0.5, 0.2), (0.0, 0.4)])
def test_a_box_thrown_on_the_floor_comes_to_rest_without_clatter(restitution, mu):
    """Landing corners throw each other up; hops that nobody could see are not followed."""
    thrown = box(rpy=(0.3, 0.2, 0.1), height=0.5, twist=[0.5, 0.2, 0, 1, 2, 1])
    trajectory = run(on_floor(thrown, restitution, mu), 3.0, 1e-7)
    assert trajectory.status == "completed"
    assert len(times(trajectory)) < 300
    assert trajectory.statistics["evaluations"] < 30000
    assert trajectory.object_position[-1, 2] == pytest.approx(0.1, abs=1e-6)
    assert np.max(np.diff(trajectory.energy)) < 1e-7


def test_a_flat_landing_with_friction_ends_alike_for_all_accuracies_and_masses():
    """Four corners land at once: which impulses share the blow is left to roundings."""
    ends = []
    for accuracy, mass in ((1e-6, 2.0), (1e-8, 2.0), (1e-8, 2e-3)):
        thrown = box(mass=mass, rpy=(0.6, 0.5, 0.1), height=0.5, twist=[2, 0.2, 0, 5, 2, 1])
        ends.append(run(on_floor(thrown, 0.0, 0.4), 1.2, accuracy).object_position[-1])
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-3)
    np.testing.assert_allclose(ends[2], ends[1], atol=1e-3)


# --- the edge of a table -------------------------------------------------------------------------


def test_a_ball_slides_off_a_table_and_falls_from_its_edge():
    trajectory = run(on_floor(ball(twist=[1, 0, 0, 0, 0, 0]), floor={"size": [1.0, 1.0]}), 0.8)
    assert times(trajectory) == pytest.approx([0.5], abs=1e-9)
    t = np.maximum(trajectory.time - 0.5, 0.0)
    np.testing.assert_allclose(
        trajectory.object_position[:, 2], 0.05 - 0.5 * GRAVITY * t**2, atol=1e-8
    )


def test_a_ball_thrown_past_a_table_does_not_bounce_beside_it():
    thrown = ball(height=0.3, twist=[3, 0, 0, 0, 0, 0])
    trajectory = run(on_floor(thrown, 0.5, floor={"size": [1.0, 1.0]}), 0.5)
    assert not trajectory.events
    assert trajectory.object_position[-1, 2] == pytest.approx(0.35 - 0.125 * GRAVITY, abs=1e-9)


# --- starts --------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [1e-3, 0.04])
def test_a_start_inside_the_floor_is_refused_and_says_how_deep(depth):
    with pytest.raises(MultiarmError, match=r"floor"):
        run(on_floor(ball(height=-depth)), 0.1)


def bead(ends, force: float, posture: float = 0.0):
    """A bead on a slide with a range."""
    effects = {"joint_limits": {"range": {"arm": {"j1": ends}}}}
    return ma.Scene(
        object={"shape": {"sphere": 0.05}, "mass": 1.0, "pose": {"xyz": [posture, 0, 0]}},
        arms={"arm": arm("x", mass=1.0, posture=[posture])},
        joints=[{"arm": "arm", "kind": "ball"}],
        effects=effects,
        control={"kind": "constant", "torques": {"arm": [force]}},
    )


def test_a_start_beyond_a_limit_is_refused():
    with pytest.raises(MultiarmError, match="j1"):
        run(bead([-1.0, -0.1], 0.0), 0.1)


@pytest.mark.parametrize(("force", "moves"), [(3.0, False), (-3.0, True)])
def test_a_joint_may_start_at_its_limit(force, moves):
    trajectory = run(bead([-1.0, 0.0], force), 0.3)
    assert trajectory.status == "completed"
    end = 0.5 * force / 2.0 * 0.09 if moves else 0.0
    assert trajectory.joint_positions["arm"][-1, 0] == pytest.approx(end, abs=1e-9)


# --- one evaluation ------------------------------------------------------------------------------


def test_an_evaluation_holds_only_what_touches():
    flying = ma.evaluate(ma.compile_system(ball_on_plate(arm("x"), ball(height=0.5), mu=0.3)))
    np.testing.assert_allclose(flying.object_acceleration, [0, 0, -GRAVITY, 0, 0, 0], atol=1e-12)
    resting = ma.evaluate(ma.compile_system(on_floor(box(), mu=0.3)))
    np.testing.assert_allclose(resting.object_acceleration, 0.0, atol=1e-12)
    falling = ma.evaluate(ma.compile_system(on_floor(box(height=0.3), mu=0.3)))
    np.testing.assert_allclose(falling.object_acceleration, [0, 0, -GRAVITY, 0, 0, 0], atol=1e-12)
