"""Claims about the schedule of joints that hold for some of the time."""

from __future__ import annotations

from box_between_arms import from_, two_arms

import multiarm as ma
from multiarm.contacts.unilateral import CONTACT, LIMIT
from multiarm.scene import parse_scene
from multiarm.simulation.joint_schedule import JointSchedule


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
