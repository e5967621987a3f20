"""Friction of single contacts and joints (``mu``), and of contacts that hold both ways.

Oracles: Newton's equations of a bead and its sledge with the friction ``mu |N|``; the drawer that
jams; closed forms of sliding, sticking and impacts.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from event_scenes import GRAVITY, arm, ball, box, run, scene, times
from mechanics import ur5_pair
from scipy.integrate import solve_ivp

import multiarm as ma
from multiarm.errors import SceneError
from multiarm.scene import parse_scene

MASS, SIZE = 2.0, 0.2  # [kg] of the drawer, [m] between its contacts


# --- a bead in a groove that also holds it from within --------------------------------------------

RADIUS, SLEDGE, BEAD = 0.5, 3.0, 0.7  # [m], [kg], [kg]


def bead(mu: float, velocity: tuple[float, float, float]):
    """A bead on a cylinder across a sledge's way, from the lowest place."""
    body = ball(0.02, -RADIUS - 0.02, BEAD, inertia=[1e-3] * 3, twist=[*velocity, 0, 0, 0])
    groove = {"cylinder": {"axis": [0, 1, 0], "radius": RADIUS, "inside": True}}
    contact = {"arm": groove, "object": {"point": [0, 0, 0]}, "bilateral": True, "mu": mu}
    return scene(body, {"sledge": arm("x", mass=SLEDGE)}, {"sledge": [contact]}, {})


def force_on_bead(mu: float, y: np.ndarray) -> tuple[float, np.ndarray]:
    """Normal force, positive towards the axis, and force on the bead; y: ways, then speeds."""
    way, x, _, z = y[:4]
    speed = y[5:8] - [y[4], 0.0, 0.0]
    inward = np.array([way - x, 0.0, -z]) / RADIUS
    slip = speed - inward * (inward @ speed)
    slip /= np.linalg.norm(slip)
    bend = np.sum(np.cross(inward, [0, 1, 0]) * speed) ** 2 / RADIUS
    for side in (1.0, -1.0):
        pull = inward - side * mu * slip
        mobility = inward @ pull / BEAD + inward[0] * pull[0] / SLEDGE
        normal = (bend + GRAVITY * inward[2]) / mobility
        if side * normal >= 0.0:
            break
    return normal, normal * pull


@pytest.mark.parametrize(
    ("mu", "velocity", "duration", "changes"),
    [
        (0.2, (5.0, 0.5, 0.0), 1.0, 2),
        (0.3, (1.0, 0.5, 0.0), 0.5, 0),
        (0.8, (6.0, 0.5, 0.0), 1.0, 0),
    ],
)
def test_a_bead_slides_with_the_magnitude_of_its_normal_force(mu, velocity, duration, changes):
    trajectory = run(bead(mu, velocity), duration)

    def rates(_, y):
        _, force = force_on_bead(mu, y)
        return [*y[4:], -force[0] / SLEDGE, *(force / BEAD - [0.0, 0.0, GRAVITY])]

    def slip(_, y):
        return np.linalg.norm([y[5] - y[4], y[6], y[7]]) - 1e-5

    slip.terminal = True
    start = [0.0, 0.0, 0.0, -RADIUS, 0.0, *velocity]
    found = solve_ivp(
        rates, (0.0, duration), start, "DOP853", trajectory.time,
        events=slip, rtol=1e-11, atol=1e-12,
    )  # fmt: skip
    k = len(found.t)
    np.testing.assert_allclose(trajectory.object_position[:k], found.y[1:4].T, atol=1e-9)
    normal = np.array([force_on_bead(mu, y)[0] for y in found.y.T])
    np.testing.assert_allclose(trajectory.contact_forces["sledge"][:k, 0], normal, atol=1e-7)
    assert np.sum(np.diff(np.sign(normal)) != 0) == changes
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-9
    stops = found.t_events[0]
    assert times(trajectory, "sticks") == pytest.approx(stops, abs=3e-5)  # slower than 1e-5 m/s
    assert len(trajectory.events) == len(stops)  # changes of the side are none


# --- the drawer that jams -------------------------------------------------------------------------


def drawer(mu: float | None, wrenches: list[dict], kind: str = "prismatic", **more):
    """A box on a rail along z, which only x is left to move; no gravity."""
    body = box((0.2, 0.2, 0.2), MASS, -0.1, inertia=[0.02, 0.03, 0.04], **more.pop("body", {}))
    joint = {"arm": "rail", "kind": kind, "size": SIZE, **({} if mu is None else {"mu": mu})}
    effects = {"external_wrenches": wrenches} if wrenches else {}
    effects |= more.pop("effects", {})
    data = {"object": body, "arms": {"rail": arm("x", mass=4.0)}, "joints": [joint]}
    return parse_scene({**data, "effects": effects, "gravity": [0, 0, 0], **more})


@pytest.mark.parametrize("offset", [0.1, -0.3, 0.33])
@pytest.mark.parametrize("mu", [0.1, 0.3])
def test_a_drawer_jams_where_it_is_pulled_far_from_its_rail(mu, offset):
    pull = 10.0
    wrench = {"on": "object", "force": [0, 0, pull], "at": [offset, 0, 0]}
    trajectory = run(drawer(mu, [wrench]), 0.4)
    normal = pull * abs(offset) / SIZE  # of the two contacts that carry the moment
    left = max(pull - 2.0 * mu * normal, 0.0)
    assert trajectory.object_position[-1, 2] == pytest.approx(0.5 * left / MASS * 0.4**2, abs=1e-9)
    forces = trajectory.contact_forces["rail"][-1].reshape(5, 3)
    np.testing.assert_allclose(np.abs(forces[3:, 0]), normal, rtol=1e-9)
    assert forces[3, 0] == pytest.approx(-forces[4, 0])  # one pushes, the other one pulls
    friction = np.sum(np.hypot(forces[:, 1], forces[:, 2]))
    assert friction == pytest.approx(min(2.0 * mu * normal, pull))
    works = trajectory.channel("effects/contact_friction/work")[-1]
    assert works == pytest.approx(-(pull - left) * trajectory.object_position[-1, 2], abs=1e-9)


def test_a_pressed_drawer_begins_to_slide_when_the_growing_pull_exceeds_its_friction():
    mu, pressing, pull = 0.3, 12.0, 40.0  # [], [N], [N]
    swing = {"on": "object", "force": [0, 0, pull], "sinusoid": {"frequency": 0.5}}
    trajectory = run(drawer(mu, [{"on": "object", "force": [0, pressing, 0]}, swing]), 0.5)
    begins = math.asin(mu * pressing / pull) / math.pi
    assert times(trajectory, "slides")[0] == pytest.approx(begins, abs=1e-6)

    def rates(t, y):  # pressed beyond the rail, one end of it pulls
        friction = mu * pressing * max(1.0, abs(y[0]) / (0.5 * SIZE))
        return [y[1], (pull * math.sin(math.pi * t) - friction) / MASS]

    slides = trajectory.time > begins
    assert np.max(np.abs(trajectory.object_position[~slides])) < 1e-12
    t = trajectory.time[slides]
    found = solve_ivp(rates, (begins, 0.5), [0, 0], "DOP853", t, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(trajectory.object_position[slides, 2], found.y[0], atol=1e-8)
    assert t[-1] == 0.5


def test_friction_follows_a_force_that_changes_sides():
    mu, speed = 0.2, 3.0
    shake = {"on": "object", "force": [0, 30.0, 0], "sinusoid": {"frequency": 10.0}}
    moving = {"body": {"twist": [0, 0, speed, 0, 0, 0]}}
    trajectory = run(drawer(mu, [shake], **moving), 0.25)

    def rates(t, y):
        press = abs(30.0 * math.sin(20.0 * math.pi * t)) * max(1.0, abs(y[0]) / (0.5 * SIZE))
        return [y[1], -mu * press / MASS]

    t, changes = trajectory.time, np.arange(0.0, 0.26, 0.05)
    y = [np.array([0.0, speed])]
    for begin, end in itertools.pairwise(changes):
        span = solve_ivp(rates, (begin, end), y[-1], "DOP853", rtol=1e-12, atol=1e-13)
        y.append(span.y[:, -1])
    at = np.searchsorted(t, changes - 1e-12)
    np.testing.assert_allclose(trajectory.object_position[at, 2], [p for p, _ in y], atol=1e-9)
    assert not trajectory.events and np.max(np.abs(trajectory.energy_balance)) < 1e-9


def test_an_impact_off_the_rail_is_braked_by_the_impulses_in_it():
    mu, speed, offset, bounce = 0.25, 1.5, 0.15, 0.5
    body = {"twist": [0, 0, -speed, 0, 0, 0]}
    floor = {"at": {"xyz": [0, 0, -0.15]}, "points": [[offset, 0, -0.1]], "restitution": bounce}
    trajectory = run(drawer(mu, [], body=body, effects={"floor": floor}), 0.1)
    hit = trajectory.events[0]
    assert hit["time"] == pytest.approx(0.05 / speed, abs=1e-9)
    assert hit["after"]["gap_rate_m_s"] == pytest.approx(bounce * speed, rel=1e-9)
    impulse = MASS * (1.0 + bounce) * speed / (1.0 - 2.0 * mu * offset / SIZE)
    assert hit["after"]["impulse_N_s"] == pytest.approx(impulse, rel=1e-9)
    assert trajectory.object_twist[-1, 2] == pytest.approx(bounce * speed, rel=1e-9)


# --- which coefficient counts ---------------------------------------------------------------------

LIFTED = [(0.1, 0.0), (-0.1, 0.1), (-0.1, -0.1)]


def puck(own: list[float | None], joint: float | None, effects: dict, bilateral: bool):
    """A puck with three feet that slides along x on a plate."""
    contacts = [
        {
            "arm": {"plane": {"normal": [0, 0, 1]}},
            "object": {"point": [x, y, -0.05]},
            "bilateral": bilateral,
            **({} if mu is None else {"mu": mu}),
        }
        for (x, y), mu in zip(LIFTED, own, strict=True)
    ]
    body = {**box((0.3, 0.3, 0.1), MASS, twist=[1.0, 0, 0, 0, 0, 0])}
    kind = {"arm": "plate", "kind": "contacts", "contacts": contacts}
    data = {"object": body, "arms": {"plate": arm("z", mass=4.0)}, "effects": effects}
    joints = [kind if joint is None else {**kind, "mu": joint}]
    return parse_scene({**data, "joints": joints, "gravity": [0, 0, -GRAVITY]})


@pytest.mark.parametrize("bilateral", [False, True])
@pytest.mark.parametrize(
    ("own", "joint", "effect", "expected"),
    [
        ([0.1, None, None], 0.2, 0.3, [0.1, 0.2, 0.2]),
        ([None, 0.1, None], None, 0.3, [0.3, 0.1, 0.3]),
        ([0.4, 0.1, 0.0], None, None, [0.4, 0.1, 0.0]),
        ([None] * 3, 0.2, None, [0.2] * 3),
        ([0.0, 0.0, 0.3], 0.2, 0.3, [0.0, 0.0, 0.3]),
    ],
)
def test_the_nearest_coefficient_counts(own, joint, effect, expected, bilateral):
    effects = {"external_wrenches": [{"on": "object", "force": [0, 0, -30.0]}]}
    if effect is not None:
        effects["contact_friction"] = {"mu": effect, "contacts": ["plate"]}
    system = ma.compile_system(puck(own, joint, effects, bilateral))
    forces = ma.evaluate(system).contact_forces["plate"]
    for mu in expected:
        rows = 3 if mu or not bilateral else 1  # a contact that holds both ways slides by itself
        normal, *friction = forces[:rows]
        assert np.linalg.norm(friction) == pytest.approx(mu * normal, rel=1e-9)
        forces = forces[rows:]
    assert not len(forces) and normal > 1.0


def test_friction_of_the_scene_leaves_contacts_that_hold_both_ways_alone_unless_it_names_them():
    def states(effects):
        return ma.evaluate(ma.compile_system(puck([None] * 3, None, effects, True))).contact_states

    assert not states({"contact_friction": 0.3})
    named = states({"contact_friction": {"mu": 0.3, "contacts": ["plate/contact 2"]}})
    assert named == {"plate": ("sliding",)}


# --- laws in multi-arm scenes ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("left", "right", "slips"),
    [
        ({"kind": "cylindrical", "axis": [0, 1, 0], "mu": 0.2}, {"kind": "weld"}, False),
        ({"kind": "planar", "mu": 0.1}, {"kind": "ball", "mu": 0.5}, True),
        (
            {"kind": "universal", "mu": 0.3},
            {"kind": "revolute", "axis": [1, 0, 0], "mu": 0.3},
            True,
        ),
        (
            {"kind": "prismatic", "axis": [0, 1, 0], "mu": 0.05},
            {"kind": "revolute", "mu": 0.2},
            True,
        ),
    ],
)
def test_the_friction_of_two_robots_joints_obeys_coulombs_law(left, right, slips):
    trajectory = run(ur5_pair(left, right), 0.15, accuracy=1e-7)
    assert trajectory.time[-1] == 0.15
    for name, joint in (("left", left), ("right", right)):
        if "mu" in joint:
            forces = trajectory.contact_forces[name]
            normal, first, second = (forces[:, k::3] for k in range(3))
            excess = np.hypot(first, second) - joint["mu"] * np.abs(normal)
            assert np.max(excess) <= 1e-8 * np.max(np.abs(forces))
    work = trajectory.channel("effects/contact_friction/work")
    assert np.all(np.diff(work) <= 1e-12) and (work[-1] < -1e-6) == slips
    assert np.max(np.abs(trajectory.energy_balance)) < 1e-7


@pytest.mark.parametrize("duration", [0.05, 0.07, 0.0767])
def test_redundant_contacts_with_friction_pass_their_events_with_any_steps(duration):
    """Forces are not unique: with other steps, roundings choose other ones at the events."""
    left, right = {"kind": "prismatic", "axis": [0, 1, 0], "mu": 0.05}, {"kind": "revolute"}
    trajectory = run(ur5_pair(left, {**right, "mu": 0.2}), duration, accuracy=1e-7)
    assert trajectory.status == "completed", trajectory.message


def test_a_weld_does_not_feel_its_friction():
    free, rough = (
        run(ur5_pair({"kind": "weld", **more}, {"kind": "ball"}), 0.1) for more in ({}, {"mu": 0.4})
    )
    np.testing.assert_allclose(rough.object_position, free.object_position, atol=1e-9)
    assert set(ma.evaluate(ma.compile_system(rough.scene)).contact_states["left"]) == {"touching"}


# --- faults ---------------------------------------------------------------------------------------

FLAT = {"arm": {"sphere": {"radius": 0.01}}, "object": {"plane": {"normal": [0, 0, 1]}}}


@pytest.mark.parametrize(
    ("joint", "effects", "message"),
    [
        ({"kind": "contacts", "contacts": [{**FLAT, "rolling": True, "mu": 0.1}]}, {}, "rolls"),
        ({"kind": "contacts", "contacts": [{**FLAT, "mu": -0.1}]}, {}, r"contacts\[0\].mu"),
        ({"kind": "weld", "mu": "much"}, {}, r"joints\[0\].mu"),
        ({"kind": "wrenches", "wrenches": [[0, 0, 0, 0, 0, 1]], "mu": 0.1}, {}, "a difference of"),
        ({"kind": "planar", "mu": 0.1}, {"contact_compliance": 1e5}, "needs a rigid contact"),
    ],
)
def test_friction_that_cannot_be_is_refused(joint, effects, message):
    data = {"object": box(), "arms": {"a": arm("xyzXYZ")}, "joints": [{"arm": "a", **joint}]}
    with pytest.raises(SceneError, match=message):
        ma.compile_system(parse_scene({**data, "effects": effects}))


def test_the_variational_method_knows_no_friction():
    variational = {"integrator": "variational", "step": 1e-3}
    with pytest.raises(SceneError, match="'mu'"):
        run(drawer(0.2, []), 0.1, **variational)
    with pytest.raises(SceneError, match=r"run.integrator: .* 'mu'"):
        drawer(0.2, [], run=variational)


def test_a_rolling_contact_keeps_rolling_in_a_joint_with_friction():
    contacts = [{**FLAT, "rolling": True}]
    joint = {"arm": "a", "kind": "contacts", "contacts": contacts, "mu": 0.3}
    base = {"xyz": [0, 0, 0.11]}
    data = {"object": box(), "arms": {"a": arm("xyzXYZ", base=base)}, "joints": [joint]}
    assert not ma.evaluate(ma.compile_system(parse_scene(data))).contact_states


def test_pushing_contacts_with_friction_of_their_own_open():
    lifted = {"external_wrenches": [{"on": "object", "force": [0, 0, 40.0]}]}
    trajectory = run(puck([0.1, 0.1, 0.1], None, lifted, False), 0.05)
    np.testing.assert_allclose(trajectory.contact_forces["plate"], 0.0)
    risen = trajectory.object_position[-1, 2] - trajectory.object_position[0, 2]
    assert risen == pytest.approx(0.5 * (40.0 / MASS - GRAVITY) * 0.05**2, abs=1e-9)
