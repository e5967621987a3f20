"""Claims about results of runs in which joints take hold and let go."""

from __future__ import annotations

import numpy as np
import pytest
from box_between_arms import from_, two_arms
from event_scenes import arm

import multiarm as ma
from multiarm.results.event_kinds import LOST, MADE, family_of
from multiarm.scene import parse_scene

RATE = 2.0  # [rad/s], at which the right hand turns about z
LIMITS = [-0.3, 0.3]
TIMES = from_([[0.1, 0.2], [0.4, 0.9]])


def turning_hand(**joint) -> ma.Trajectory:
    """A hand that turns freely in a hinge, which holds for two stretches of time."""
    turning = arm("xyzXYZ", posture=[0, 0, 0.1, 0, 0, 0], velocity=[0, 0, 0, 0, 0, RATE])
    data = two_arms(control="none", right=turning, **TIMES)
    data |= {"gravity": None, "effects": {}}
    data["joints"][1] |= {"kind": "revolute", "limits": LIMITS, **joint}
    system = ma.compile_system(parse_scene(data))
    return ma.simulate(system, 1.0, accuracy=1e-6, certificate=False)


@pytest.fixture(scope="module")
def located() -> ma.Trajectory:
    return turning_hand()


def events_of(run: ma.Trajectory) -> list[tuple[float, str]]:
    return [(pytest.approx(event["time"], abs=1e-8), event["kind"]) for event in run.events]


def test_ranges_count_from_where_a_joint_takes_hold_and_while_it_holds(located):
    """The angle begins at 0 where the joint takes hold; the range is left once, 0.15 s later."""
    assert events_of(located) == [
        (0.1, "attached"),
        (0.2, "detached"),
        (0.4, "attached"),
        (0.55, "passes its limit"),
        (0.9, "detached"),
    ]
    angle = located.relative_position["right"][:, 0]
    for begin, end in ((0.1, 0.2), (0.4, 0.9)):
        held = (located.time > begin) & (located.time < end)
        np.testing.assert_allclose(angle[held], RATE * (located.time[held] - begin), atol=1e-8)


def test_a_joint_that_takes_hold_beyond_its_range_says_so():
    """With a place of its own it counts from there: it is in range at 0.1 s and not at 0.4 s."""
    assert events_of(turning_hand(at={"xyz": [0, 0, 0]})) == [
        (0.1, "attached"),
        (0.15, "passes its limit"),
        (0.2, "detached"),
        (0.4, "attached"),
        (0.4, "passes its limit"),
        (0.9, "detached"),
    ]


def test_events_say_where_a_joint_has_taken_hold(located):
    for event in located.events:
        if event["kind"] != "attached":
            assert "at" not in event
            continue
        np.testing.assert_allclose(event["where"], [0, 0, 0.1], atol=1e-9)
        half = 0.5 * RATE * event["time"]
        expected = [0, 0, np.sin(half), np.cos(half)]
        np.testing.assert_allclose(event["at"]["quaternion_xyzw"], expected, atol=1e-8)
        np.testing.assert_allclose(event["at"]["xyz"], 0.0, atol=1e-9)


def test_a_place_is_that_of_a_scene_whose_axis_is_not_z():
    """A joint with the place of the event as its ``at`` closes there without a gap."""
    right = arm("xyzXYZ", posture=[0.3, 0.1, 0.2, 0.3, -0.2, 0.4])
    data = two_arms(control="none", right=right, **from_(0.05))
    data |= {"gravity": None, "effects": {}}
    data["joints"][1] |= {"kind": "revolute", "axis": [1, 2, 2], "at_tip": {"xyz": [0.1, 0, 0]}}
    run = ma.simulate(ma.compile_system(parse_scene(data)), 0.1, certificate=False)
    (event,) = run.events
    del data["joints"][1]["from"]
    data["joints"][1]["at"] = event["at"]
    report = ma.compile_system(parse_scene(data)).start_report
    assert report.gaps["right"] < 1e-12


def test_stored_results_have_what_joints_did(located, tmp_path):
    located.save(tmp_path / "run.h5")
    again = ma.load_trajectory(tmp_path / "run.h5")
    assert again.events == located.events
    assert again.scene.joints[1].intervals == located.scene.joints[1].intervals
    assert len(again.events[0]["impulse"]) == 6


def test_figures_and_replays_show_them_as_contacts_made_and_lost(located, tmp_path):
    assert [family_of(kind) for kind in ("attached", "detached")] == [MADE, LOST]
    ma.replay(located, tmp_path / "replay.html")
    ma.report(located, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "attached" in text and "detached" in text


def test_gaps_are_those_of_the_joints_that_hold(located):
    assert located.position_drift.max() < 1e-10


def test_forces_of_a_joint_that_does_not_hold_are_zero():
    run = ma.simulate(
        ma.compile_system(parse_scene(two_arms(**from_([[0.03, 0.06]])))),
        0.1, output_step=0.01, certificate=False,
    )  # fmt: skip
    held = (run.time > 0.031) & (run.time < 0.059)
    away = (run.time < 0.029) | (run.time > 0.061)
    assert np.abs(run.wrenches["right"][held]).max(axis=1).min() > 1.0
    assert not run.wrenches["right"][away].any()
