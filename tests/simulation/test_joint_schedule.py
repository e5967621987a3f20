"""Claims about the schedule of joints that hold for some of the time."""

from __future__ import annotations

from box_between_arms import from_, two_arms

import multiarm as ma
from multiarm.contacts.unilateral import CONTACT, LIMIT
from multiarm.scene import parse_scene
from multiarm.simulation.joint_schedule import JointSchedule


def timed(*pairs):
    """The constraints of a scene whose left arm has a joint with these pairs."""
    data = two_arms({}, **from_([*pairs]))
    return ma.compile_system(parse_scene(data)).model.unilateral


def falls(t, state):
    return -1.0


def test_a_run_that_begins_in_an_interval_after_one_that_never_began():
    unilateral = timed([{"when": falls}, 1], [1.2, 2])
    for begin in (0.5, 1.1, 1.5, 2.5):
        assert JointSchedule(unilateral, begin).holding == unilateral.holding_at(begin)
    assert JointSchedule(unilateral, 1.5).next_time(1.5) == 2.0


def test_moments_at_which_a_run_has_switched():
    """After an interval that ended before its function fell, and one that has begun already."""
    unilateral = timed([{"when": falls}, 1], [1.2, {"when": falls}], [1.5, 3])
    schedule = JointSchedule(unilateral, 0.0)
    assert [schedule.pass_switch(0, t) for t in (1.2, 1.7, 1.7, 3.0)] == [2, 3, 4, 5]
    schedule = JointSchedule(unilateral, 0.0)
    assert [schedule.pass_switch(0, t) for t in (0.9, 1.0, 1.2)] == [0, 1, 2]


def test_a_stop_of_an_arm_is_no_contact_of_its_joint():
    """Stops have the arm's name, as its contacts have; only contacts are waited for."""
    effects = {"unilateral_contacts": {}, "joint_limits": {"range": {"left": {"j1": [-1, 1]}}}}
    data = two_arms(effects, **from_({"touching": "left"}))
    fingertip = {"sphere": {"radius": 0.01}}
    side = {"plane": {"point": [0, 0, -0.11], "normal": [0, 0, 1]}}
    contact = {"arm": fingertip, "object": side}
    data["joints"][0] |= {"kind": "contacts", "contacts": [contact]}
    unilateral = ma.compile_system(parse_scene(data)).model.unilateral
    of_kind = {
        kind: [u for u, one in enumerate(unilateral.constraints) if one.kind == kind]
        for kind in (CONTACT, LIMIT)
    }
    assert len(of_kind[LIMIT]) == 2
    schedule = JointSchedule(unilateral, 0.0)
    schedule.touched(of_kind[LIMIT])
    assert schedule.due == set()
    schedule.touched(of_kind[CONTACT])
    assert schedule.due == {0}
